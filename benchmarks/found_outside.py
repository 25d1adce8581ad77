"""Recordings as found, as somebody else's simulator makes them: other plants, controllers, sensors, motions and arms than `found_pairs.py` has.

Arms, cells and files are those of `outside_cell`: 100 or 125 Hz, 30 s, torque constants off one by one; weeks later friction is off by some percent.

    python benchmarks/found_outside.py ask --seed 117000 --count 14 --out OUT [--healthy | --others]
    python benchmarks/found_outside.py rate --out OUT
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from found_pairs import FRICTION, NONE, Case, judged, rate
from independent_arm import Array
from independent_effects import EFFECTS
from independent_hidden import Hidden, between, put
from independent_outside import OUTSIDE
from independent_plant import FC_NEG, FC_POS, FV
from independent_sets import Truth
from outside_cell import ARMS, CONTROLLERS, KINDS, Cell, described, recorded, truth_of

from stopset.errors import StopsetError
from stopset.offline.campaign.source import Campaign
from stopset.offline.description import load_robot
from stopset.offline.diagnose import diagnose_model
from stopset.offline.identify.pipeline import Settings, identified
from stopset.progress import silent
from stopset.recording import Recordings, read_recordings

HEALTHY, PAIR, ODDS, PEDESTALS = 0.35, 0.6, 0.35, 0.15
WARM = ("self_heating", "warm_up")  # what warms is no false name of that


# hardware sizes for the independent simulator's own laws: of (truth, joint, u in 0..1)
SIZES: dict[str, Callable[[Truth, int, float], float]] = {
    "stribeck": lambda t, j, u: (0.25 + 0.35 * u) * float(t.T[j, FC_POS]),
    "load_coulomb": lambda t, j, u: 0.06 + 0.08 * u,
    "asymmetric_coulomb": lambda t, j, u: 0.1 + 0.15 * u,
    "payload": lambda t, j, u: (0.06 + 0.08 * u) * float(t.arm.pi[:, 0].sum()) * 0.6,
    "elasticity": lambda t, j, u: 1 / ((30 + 50 * u) * float(t.arm.limit[j])),
    "torque_ripple": lambda t, j, u: (0.15 + 0.2 * u) * float(t.T[j, FC_POS]),
    "hysteresis": lambda t, j, u: 0.008 + 0.012 * u,
    "torque_gain": lambda t, j, u: 0.08 + 0.08 * u,
    "delay": lambda t, j, u: 0.01 + 0.012 * u,
    "base_tilt": lambda t, j, u: 0.025 + 0.03 * u,
    "spring": lambda t, j, u: (0.25 + 0.35 * u) * float(t.T[j, FC_POS]),
    "coupling": lambda t, j, u: (0.2 + 0.2 * u) * float(t.T[j, FC_POS]),
}


def _worn(t: Truth, j: int, x: float, u: Array) -> Truth:
    return put(t, j, **{k: x * float(t.T[j, c]) for k, c in (("FC_POS", FC_POS), ("FC_NEG", FC_NEG), ("FV", FV))})


def _much(t: Truth, j: int, u: float) -> float:
    return 1.25 + 0.3 * u


WORN = Hidden(_worn, lambda t, j: 1.2, lambda t, j: 1.6)


def _play(t: Truth, j: int, x: float, u: Array) -> Truth:
    K = 800.0 * float(t.arm.limit[j])
    return put(t, j, PLAY=x, STIFF=K, DAMP=0.4 * np.sqrt(K * t.arm.rotor[j]))


def _hidden(apply: Callable[[Truth, int, float, Array], Truth]) -> Hidden:
    return Hidden(apply, *between(0.0, 1.0))


# what `SIZES` lack, as ``--others`` draws them: law and size
OTHERS: dict[str, tuple[Hidden, Callable[[Truth, int, float], float]]] = {
    "counterbalance": (
        _hidden(lambda t, j, x, u: put(t, j, GAS=x, GAS_Q0=2.0 + 2.2 * u[0], GAS_R=0.2 + 0.3 * u[1])),
        lambda t, j, u: (0.1 + 0.15 * u) * float(t.arm.limit[j])),
    "cable": (
        _hidden(lambda t, j, x, u: put(t, j, SPRING=x, SPRING_Q0=0.6 * (u[0] - 0.5), HARDEN=1.5)),
        lambda t, j, u: (0.25 + 0.35 * u) * float(t.T[j, FC_POS])),
    "quadratic_load": (
        _hidden(lambda t, j, x, u: put(t, j, LOAD_2=x)), lambda t, j, u: (0.06 + 0.08 * u) / (0.2 * float(t.arm.limit[j]))),
    "cubic_viscous": (EFFECTS["cubic_viscous"], lambda t, j, u: 0.25 + 0.35 * u),
    "offset": (_hidden(lambda t, j, x, u: put(t, j, OFFSET=x * (1 if u[0] < 0.5 else -1))), lambda t, j, u: (0.2 + 0.3 * u) * float(t.T[j, FC_POS])),
    "play": (_hidden(_play), lambda t, j, u: 1e-3 * (0.6 + 1.2 * u)),
    "bump": (OUTSIDE["bump"], lambda t, j, u: (0.3 + 0.4 * u) * float(t.T[j, FC_POS])),
    "uneven": (OUTSIDE["uneven"], lambda t, j, u: (0.2 + 0.2 * u) * float(t.T[j, FC_POS])),
    "pedestal": (
        _hidden(lambda t, j, x, u: put(t, 0, ROCKS=x, ROCKS_ABOUT=3.14 * u[0])), lambda t, j, u: 5.0 + 7.0 * u),
}  # fmt: skip
LOADED = ("load_coulomb", "torque_gain", "elasticity", "counterbalance", "quadratic_load", "play")
SAYS = {"offset": ("asymmetric_coulomb",)}  # a constant torque
NAMELESS = {
    "play": ("none", "unknown"),
    "pedestal": ("none", "unknown"),
    "bump": ("unknown",),
    "uneven": ("unknown",),
    "offset": ("missing", "changed", "none"),
}


def drawn(seed: int, healthy: bool = False, others: bool = False) -> tuple[Truth, Truth, Cell, Cell, Case, int]:
    """An arm, the same one changed, cells of the first and of the later file, what is right, and the joint."""
    rng = np.random.default_rng([seed, 5])
    name = str(rng.choice(list(ARMS)))
    truth = truth_of(name, seed)
    n, fc = truth.arm.n, truth.T[:, FC_POS]
    on, pair = rng.random(8) < ODDS, bool(rng.random() < PAIR)
    gain = 1 + 0.04 * rng.normal() * on[0] + 0.02 * rng.normal(size=n) * on[1]
    lsb = fc * (0.05 if on[2] else 0.005)
    cell = Cell(
        str(rng.choice(CONTROLLERS)), str(rng.choice(KINDS)), float(rng.choice([100.0, 125.0])),
        float(10 ** rng.uniform(-5, -3.7)), lsb, 20.0 * on[3], gain, 1e-3 * float(rng.random()) * on[4],
        0.04 * float(rng.random()) * on[5], float(rng.uniform(0.05, 0.15)) * on[6], np.zeros(n), (0.03 + 0.04 * rng.random()) * fc,
    )  # fmt: skip
    drift = float(rng.uniform(0.05, 0.15)) * on[7] * (np.arange(n) == rng.integers(n)) * fc
    says = ("delay", "drive_lag") if cell.cut and not pair else ()
    joint, u = int(rng.integers(n)), rng.random(4)
    later = replace(cell, kind=str(rng.choice(KINDS)))
    T = truth.T.copy()
    if pair:
        T[:, [FC_POS, FC_NEG]] *= np.exp(rng.normal(0, 0.03, (n, 1)))
        T[:, FV] *= np.exp(rng.normal(0, 0.03, n))
    aged = replace(truth, T=T)
    words = f"{name} {cell.controller} {cell.kind}{f' {later.kind}' * pair}"
    words += f"{' filtered' * bool(cell.cut)}{' warms' * bool(cell.warms)}{' steps' * bool(on[2])}{' one by one' * bool(on[1])}"
    if healthy or (not others and rng.random() < HEALTHY):
        later = replace(later, drift=drift)
        right = ("none", "unknown", *(("missing",) if cell.warms else ())) if drift.any() or cell.warms else NONE
        right = (*right, "missing") if says else right
        return truth, aged, cell, later, Case(f"{'later ' * pair}healthy, {words}", pair, verdicts=right, says=says), joint
    choice = str(rng.choice([*OTHERS][:-1] if others else [*SIZES, *["worn"] * (3 if pair else 0)]))
    choice = [*OTHERS][-1] if others and np.random.default_rng([seed, 7]).random() < PEDESTALS else choice
    where = int(np.argmax(truth.arm.limit)) + 1 if choice in LOADED else joint
    kind, size_of, at = (*OTHERS[choice], where) if others else (EFFECTS.get(choice, WORN), SIZES.get(choice, _much), joint)
    size = size_of(aged, at, float(rng.random()))
    joint = min(where, n - 2) if kind.pair else where
    changed = kind.apply(aged, joint, size, u)
    says = (*(FRICTION if choice == "worn" else SAYS.get(choice, () if choice in NAMELESS else (choice,))), *says)
    place = "arm" if kind.whole_arm else str(joint)
    effect = "" if choice == "worn" or choice in NAMELESS else choice
    told = ("missing", "changed")
    verdicts = told if pair and choice == "offset" else NAMELESS.get(choice, told)
    case = Case(
        f"{'later ' * pair}{choice} at {place} of {size:.3g}, {words}",
        pair,
        effect=effect,
        place=place,
        verdicts=verdicts,
        says=says,
    )
    return truth, changed, cell, later, case, joint


def files(seed: int, healthy: bool, folder: Path, others: bool = False) -> tuple[Path, Path, Path | None, Case, int]:
    """Description, first file, and the later one of a pair."""
    truth, changed, cell, later, case, joint = drawn(seed, healthy, others)
    rng = np.random.default_rng([seed, 6])
    urdf_path = described(truth, folder)
    if not case.pair:
        return urdf_path, recorded(changed, later, folder, "first", rng), None, case, joint
    first = recorded(truth, cell, folder, "first", rng)
    return urdf_path, first, recorded(changed, later, folder, "later", rng), case, joint


def made(seed: int, healthy: bool, folder: Path, others: bool = False) -> tuple[Any, Any, Recordings, Case, int]:
    """Robot, model, what is diagnosed, what is right, and the joint."""
    urdf_path, first_path, later_path, case, joint = files(seed, healthy, folder, others)
    robot = load_robot(urdf_path)
    first = read_recordings(first_path, robot)
    model = identified(robot, Campaign(first.meta, lambda: iter(first.trials)), Settings(), silent, None, (), None).model
    return robot, model, first if later_path is None else read_recordings(later_path, robot), case, joint


def asked(seed: int, healthy: bool = False, others: bool = False) -> dict[str, Any]:
    """The answer to one set, and whether it is right."""
    with tempfile.TemporaryDirectory() as name:
        try:
            robot, model, data, case, joint = made(seed, healthy, Path(name), others)
            found, _ = diagnose_model(model, data)
        except StopsetError as error:  # a refusal is an answer, too
            case = drawn(seed, healthy, others)[4]
            return {"case": case.name, "right": False, "false": [], "verdict": f"{type(error).__name__}: {error}", "named": []}
    answer: dict[str, Any] = judged(found, case, robot, joint)
    # what all joints do is no false name: warm up, or weigh by constants that are off one by one, of which a model of the same arm says nothing
    true = (*(WARM * (" warms" in case.name)), *("torque_gain:",) * (" one by one" in case.name and not case.pair))
    answer["false"] = [x for x in answer["false"] if not x.startswith(true)]
    return answer


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("ask", "rate"))
    parser.add_argument("--seed", type=int, default=117000)
    parser.add_argument("--count", type=int, default=14)
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--healthy", action="store_true", help="healthy arms, no other")
    kind.add_argument("--others", action="store_true", help="gas springs, cables, offsets, play and what else `SIZES` lacks")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args(argv)
    if args.command == "ask":
        args.out.mkdir(parents=True, exist_ok=True)
    for seed in range(args.seed, args.seed + args.count) if args.command == "ask" else ():
        file = args.out / f"{seed}{'_healthy' * args.healthy}{'_others' * args.others}.json"
        if not file.exists():
            file.write_text(json.dumps(asked(seed, args.healthy, args.others), default=str))
        answer = json.loads(file.read_text())
        print("right" if answer["right"] else "WRONG", file.stem, answer["case"], answer["verdict"], answer["named"], flush=True)
    rate(args.out)


if __name__ == "__main__":
    main()
