"""A gear's stiffness told by a second encoder: against the hidden one, over stiffness and seed, and of rigid gears whose encoders err.

    python benchmarks/bends.py [--robot URDF] [--joint J] [--seeds N] [--first SEED]

An arm of three joints, or another (``--robot``), with a soft gear at one joint, along a program of six motions of 8 s at 100 Hz, its description
2 to 5 % off in mass.  Second encoders of 19 bit at every joint, mounted by up to 0.2 rad off zero, with an error of 20 arcsec once per turn.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from as_found import PROGRAM, Trouble, geared, recorded
from backlash import asked

from stopset.offline.diagnose.evidence.uncertainty import TWO_SIDES
from stopset.offline.diagnose.plays import plays
from stopset.recording import Recordings
from stopset.simulation import prepare
from stopset.simulation.cell import LINK_RESOLUTION

ONCE = np.deg2rad(20 / 3600)  # [rad] by which an encoder errs once per turn


def mounted(data: Recordings, seed: int) -> Recordings:
    """The recordings with second encoders that are off zero and err once per turn."""
    rng = np.random.default_rng(seed)
    n = len(data.meta.joints)
    off, phase = rng.uniform(-0.2, 0.2, n), rng.uniform(0, 2 * np.pi, n)
    return replace(data, trials=tuple(replace(r, q_link=r.q_link + off + ONCE * np.sin(r.q_link + phase)) for r in data))


def main() -> None:
    args, robot = asked(__doc__ or "", 40)
    print(
        "| stiffness [N m/rad] | named, of | 95 % intervals that hold it | largest error | elsewhere, or play |\n|---|---|---|---|---|"
    )
    for stiffness in (0.0, 1e5, 3e4, 1e4, 2e3):
        named, inside, off, false = 0, 0, 0.0, 0
        for seed in range(args.first, args.first + args.seeds):
            s = prepare(robot, ["none"], seed, "short", cad="wrong")
            trouble = (
                Trouble(change=geared(args.joint, stiffness, 0.0), behind=LINK_RESOLUTION)
                if stiffness
                else Trouble(behind=LINK_RESOLUTION)
            )
            found = plays(s.robot, mounted(recorded(s, PROGRAM, 100.0, trouble, seed + 100), seed))
            false += len(found.ranked)
            for r in found.bends:
                p = r.parameters["K"]
                if r.joints != (robot.joints[args.joint],) or not stiffness:
                    false += 1
                    continue
                error = abs(p.value - stiffness)
                named, off = named + 1, max(off, error / stiffness)
                inside += p.std is not None and error <= TWO_SIDES * p.std
        print(f"| {stiffness or 'rigid'} | {named} of {args.seeds} | {inside} of {named} | {off:.1%} | {false} |", flush=True)


if __name__ == "__main__":
    main()
