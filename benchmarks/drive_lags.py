"""Slow drives and stamps that are apart, of hardware size: which of the two is named, and how far off is the time constant?

A shipped arm plays a production program, or one trajectory of it, and a logger of some rate writes it (`as_found`).  Of one joint the
drive follows its torque as 1 / (T s + 1), or the torque is stamped early by as much.

    python benchmarks/drive_lags.py --arm lwa4p --seed 40 --seeds 2
"""

from __future__ import annotations

import argparse
from dataclasses import replace

from as_found import ONE, PROGRAM, Trouble, recorded

from stopset.errors import RobotError
from stopset.offline.description import load_robot
from stopset.offline.diagnose import Diagnosis, diagnose
from stopset.simulation import Scenario, prepare
from stopset.simulation.cell import TICK
from stopset.simulation.hidden import Hidden
from stopset.simulation.sizing import inject

TIMES = (0.005, 0.008, 0.012, 0.018)  # [s]
RATES = (100.0, 500.0)  # [Hz]
LENGTHS = {"program": PROGRAM[:6], "one trajectory": ONE}


def asked(s: Scenario, effect: str, joint: int, time: float, rate: float, lengths: tuple[float, ...]) -> Diagnosis:
    size = time if effect == "drive_lag" else -time
    cell, _ = inject(s.cell, [Hidden(effect, joint, size)])
    return diagnose(s.robot, recorded(replace(s, cell=cell), lengths, rate, Trouble(), s.cell.seed + 100))


def outcome(found: Diagnosis, effect: str, joint: str) -> str:
    """``right``, ``either`` where both forms are named, ``silent`` where none is, else ``false``."""
    told = [r for r in found.ranked if r.joints == (joint,) and {"delay", "drive_lag"} & {x.partition(":")[0] for x in r.one_of}]
    if not told:
        return "silent"
    if len(told[0].one_of) > 1:
        return "either"
    return "right" if told[0].effect == effect else "false"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arm", default="lwa4p")
    parser.add_argument("--seed", type=int, default=40)
    parser.add_argument("--seeds", type=int, default=2)
    args = parser.parse_args()
    try:
        robot = load_robot(args.arm)
    except RobotError as e:
        parser.error(str(e))
    count: dict[tuple[str, float, str, float], list[str]] = {}
    for seed in range(args.seed, args.seed + args.seeds):
        s = prepare(robot, ["none"], seed, "short", cad="wrong" if seed % 2 == 0 else "exact")
        for k, (effect, time, rate) in enumerate((e, t, r) for e in ("drive_lag", "delay") for t in TIMES for r in RATES):
            for lengths in LENGTHS:
                joint = (seed + k) % robot.n
                found = asked(s, effect, joint, time, rate, tuple(LENGTHS[lengths]))
                got = outcome(found, effect, robot.joints[joint])
                count.setdefault((effect, time, lengths, rate), []).append(got)
                off = next((r.parameters["T"] for r in found.ranked if r.effect == "drive_lag"), None)
                error = (
                    ""
                    if off is None or off.std is None
                    else f", {1e3 * (off.value - time - TICK / 2):+.1f} +- {1e3 * off.std:.1f} ms"
                )
                print(
                    f"{effect} of {1e3 * time:g} ms at {robot.joints[joint]}, {lengths} at {rate:g} Hz: {got}{error}", flush=True
                )
    for effect in ("drive_lag", "delay"):
        of = [x for key, x in count.items() if key[0] == effect]
        flat = [y for x in of for y in x]
        print(effect, {word: flat.count(word) for word in ("right", "either", "silent", "false")}, "of", len(flat))


if __name__ == "__main__":
    main()
