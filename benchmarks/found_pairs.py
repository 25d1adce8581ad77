"""Recordings of hardware size as found, alone and in pairs: how often is the name right, and how often is one named that is not there?

Simulated arms (``ARMS``: URDF files or names of shipped arms) play a production program or one trajectory, and a logger of 100 or 125 Hz
writes it, with what goes wrong with such files (`as_found`).  *Alone*: identified and diagnosed from that file.  *Pair*: identified
from a healthy file, diagnosed from one of weeks later.  Effects have sizes of real arms, whatever trace they leave.  Answers are kept in
OUT, so a run may be broken off and taken up again.

    python benchmarks/found_pairs.py ask ARMS... --seed 300 --out OUT [--parallel 2]
    python benchmarks/found_pairs.py ask ARMS... --seed 300 --drawn 50 --out OUT      (cases drawn at random: any effect, joint, size, trouble)
    python benchmarks/found_pairs.py ask ARMS... --seed 300 --drawn 50 --weeks --out OUT      (and what weeks and loggers add, `weeks_later`)
    python benchmarks/found_pairs.py rate --out OUT
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from as_found import ONE, PROGRAM, Trouble, play_in_the_gear, recorded

from stopset.artifact import Model
from stopset.effects import get
from stopset.errors import StopsetError
from stopset.offline.campaign.source import Campaign
from stopset.offline.description import load_robot
from stopset.offline.diagnose import Diagnosis, diagnose_model
from stopset.offline.identify.pipeline import Settings, identified
from stopset.progress import silent
from stopset.recording import Recordings
from stopset.robot import Robot
from stopset.simulation import Scenario, prepare
from stopset.simulation.hidden import Hidden
from stopset.simulation.plant import SimulatedPlant, largest_gravity
from stopset.simulation.sizing import inject

RISE, DRAG = 1.3, 3.0  # friction of two joints, a brake that does not open wholly [N m]


@dataclass(frozen=True, slots=True)
class Case:
    """What is hidden at ``size`` (or made of the plant by ``change``), where, and which answers are right."""

    name: str
    pair: bool
    lengths: tuple[float, ...] = PROGRAM
    trouble: Trouble = field(default_factory=Trouble)
    effect: str = ""
    place: str = ""  # upright, loaded, wrist, arm
    size: Callable[[Robot, int], float] = lambda robot, joint: 0.0
    change: Callable[[SimulatedPlant, int], SimulatedPlant] | None = None
    verdicts: tuple[str, ...] = ("missing", "changed")
    says: tuple[str, ...] = ()  # effects that name it, any of them; its own, unless given
    before: Trouble = field(default_factory=Trouble)  # of the healthy file of a pair
    age: float = 0.0  # by what share a joint's friction differs weeks later, one standard deviation


def _of(x: float) -> Callable[[Robot, int], float]:
    return lambda robot, joint: x


def _worn(plant: SimulatedPlant, joint: int) -> SimulatedPlant:
    more = np.ones(len(plant.fc))
    more[[joint, (joint + 2) % len(more)]] = RISE
    return plant._replace(fc=plant.fc * more, fv=plant.fv * more)


def _dragging(plant: SimulatedPlant, joint: int) -> SimulatedPlant:
    return plant._replace(fc=plant.fc + DRAG * (np.arange(len(plant.fc)) == joint))


# where a model is only diagnosed its sets say nothing: so far ahead [s] they are found sooner
ONLY_ASKED = Settings(horizon=0.1)
FRICTION = ("coulomb", "viscous")
EFFECTS = (
    ("stribeck", "loaded", _of(0.4)), ("load_coulomb", "loaded", _of(0.08)), ("asymmetric_coulomb", "upright", _of(0.15)),
    ("asymmetric_coulomb", "wrist", _of(0.15)), ("cubic_viscous", "wrist", _of(3.0)), ("spring", "upright", _of(8.0)),
    ("cable", "upright", _of(0.8)), ("payload", "arm", _of(2.0)), ("torque_gain", "loaded", _of(0.1)),
    ("rotor_inertia", "upright", _of(0.6)), ("delay", "loaded", _of(0.012)), ("base_tilt", "arm", _of(0.03)),
    ("counterbalance", "loaded", lambda r, j: 0.4 * float(largest_gravity(r)[j])), ("elasticity", "loaded", _of(0.4)),
    ("torque_ripple", "wrist", _of(0.8)), ("hysteresis", "loaded", _of(0.015)),
)  # fmt: skip
NONE = ("none",)
CASES = (
    Case("healthy program", False, verdicts=NONE), Case("healthy one", False, ONE, verdicts=NONE),
    Case("gain of all", False, trouble=Trouble(gain=1.04), verdicts=NONE),
    Case("gain of all one", False, ONE, Trouble(gain=1.04), verdicts=NONE),
    Case("lost", False, trouble=Trouble(lost=0.03), verdicts=NONE), Case("jitter", False, trouble=Trouble(scatter=1e-3), verdicts=NONE),
    Case("drift one", False, ONE, Trouble(drift=1.0), verdicts=("unknown", "none")),
    Case("late", False, trouble=Trouble(late=0.012), verdicts=("missing", "none"), says=("delay",)),
    Case("late one", False, ONE, Trouble(late=0.012), verdicts=("missing", "none"), says=("delay",)),
    Case("backlash", False, trouble=Trouble(change=play_in_the_gear), verdicts=("none", "missing"), says=("backlash",)),
    Case("all at once", False, trouble=Trouble(gain=1.04, lost=0.03, scatter=1e-3), verdicts=NONE),
    *(Case(f"{e} {place}", False, effect=e, place=place, size=size) for e, place, size in EFFECTS),
    Case("later healthy", True, verdicts=NONE), Case("later healthy one", True, ONE, verdicts=NONE),
    Case("later all at once", True, trouble=Trouble(lost=0.03, scatter=1e-3), verdicts=NONE),
    Case("later worn", True, change=_worn, place="upright", says=FRICTION),
    Case("later worn one", True, ONE, change=_worn, place="upright", says=FRICTION),
    Case("later dragging", True, change=_dragging, place="loaded", says=FRICTION),
    Case("later dragging wrist", True, change=_dragging, place="wrist", says=FRICTION),
    *(Case(f"later {e} {place}", True, effect=e, place=place, size=size) for e, place, size in EFFECTS),
    Case("later payload one", True, ONE, effect="payload", place="arm", size=_of(2.0)),
)  # fmt: skip


DRAWN = (
    *EFFECTS, ("quadratic_load", "loaded", _of(2e-3)), ("coupling", "upright", _of(0.2)), ("encoder_offset", "loaded", _of(0.03)),
)  # fmt: skip
CREEPS, PLAYS, DRIFTS, AGE = (
    0.1,
    0.3,
    0.3,
    0.03,
)  # share of files of creeping motion; of healthy ones with play, drift; `Case.age`
FACTOR, HEALTHY, ODDS = 2.0, 0.25, 0.3  # how far a size is off its usual one, share of healthy arms, of files with each trouble


def drawn(seed: int, joints: int) -> Case:
    """A case of random effect, joint, size, motions and trouble."""
    rng = np.random.default_rng(seed)
    pair = bool(rng.random() < 0.5)
    lengths = (30.0,) if rng.random() < ODDS else tuple(float(x) for x in rng.uniform(4.0, 12.0, rng.integers(4, 12)))
    on = rng.random(4) < ODDS
    gain, drift = (1.0 if pair or not on[0] else float(rng.uniform(0.95, 1.05))), 0.0
    trouble = Trouble(
        gain, 0.05 * float(rng.random()) * on[1], 1.5e-3 * float(rng.random()) * on[2], drift, 0.012 * on[3] * (not pair)
    )
    late = ("delay",) if trouble.late else ()
    if rng.random() < HEALTHY:
        return Case(f"drawn{' later' * pair} healthy", pair, lengths, trouble, verdicts=NONE)
    effect, place, size = DRAWN[rng.integers(len(DRAWN))]
    factor = float(np.exp(rng.uniform(-1, 1) * np.log(FACTOR)))
    at = place if place in ("arm", "loaded") else str(rng.integers(joints))
    return Case(
        f"drawn{' later' * pair} {effect} at {at} times {factor:.2f}", pair, lengths, trouble, effect, at,
        lambda robot, joint: factor * size(robot, joint), says=(effect, *late),
    )  # fmt: skip


def weeks_later(case: Case, seed: int) -> Case:
    """What weeks, and a logger that stays the same one, add to a drawn case: friction that is another by a few percent at each joint,
    torque constants and a lag that both files have, a torque sensor that drifts, play in a gear, an arm that only creeps.

    No file of an arm that creeps need show what is hidden in it; none may show what is not.
    """
    rng = np.random.default_rng([seed, 1])
    gain, late, sort = (
        (1.0 if rng.random() > ODDS else float(rng.uniform(0.95, 1.05))),
        0.012 * (rng.random() < ODDS),
        rng.random(),
    )
    trouble, verdicts, says = case.trouble, case.verdicts, case.says or (case.effect,)
    if case.pair:
        trouble = replace(trouble, gain=gain, late=late)
    if sort < CREEPS:
        trouble, verdicts = replace(trouble, speed=0.06), (*verdicts, "none", "unknown")
    elif sort < CREEPS + PLAYS and not case.effect:
        trouble, says = replace(trouble, change=play_in_the_gear), (*says, "backlash")
        verdicts = ("none", "unknown", "missing")
    elif sort < CREEPS + PLAYS + DRIFTS and not case.effect:
        trouble, verdicts = replace(trouble, drift=float(rng.uniform(0.3, 1.0))), ("none", "unknown")
    before = replace(trouble, change=Trouble().change, drift=0.0, speed=0.8) if case.pair else Trouble()
    return replace(case, trouble=trouble, verdicts=verdicts, says=says, before=before, age=AGE * case.pair)


def joint_of(robot: Robot, place: str) -> int:
    """Where a case happens."""
    if place.isdigit():
        return int(place)
    return {"upright": 0, "loaded": 1, "wrist": robot.n - 2, "arm": robot.n - 1, "": 0}[place]


def asked(path: str, case: Case, seed: int) -> dict[str, Any]:
    """The answer to one case on one arm, and whether it is right."""
    robot, model, data, _ = made(path, case, seed, ONLY_ASKED)
    found, _ = diagnose_model(model, data)
    return judged(found, case, robot, joint_of(robot, case.place))


def made(path: str, case: Case, seed: int, settings: Settings = Settings()) -> tuple[Robot, Model, Recordings, bool]:  # noqa: B008
    """One case on one arm: its description, the model identified, what is diagnosed, and whether that is of another day."""
    robot = load_robot(path)
    rate = (100.0, 125.0)[seed % 2]
    scenario = prepare(robot, ["none"], seed, "short", cad="wrong" if seed % 3 else "exact")
    changed = _changed(scenario, case, joint_of(robot, case.place))
    if case.age:
        plant, rng = changed.cell.truth.plant, np.random.default_rng([seed, 2])
        worn = plant._replace(**{k: getattr(plant, k) * np.exp(rng.normal(0.0, case.age, robot.n)) for k in ("fc", "fv")})
        changed = replace(changed, cell=replace(changed.cell, truth=replace(changed.cell.truth, plant=worn)))
    arm, lengths, trouble = (scenario, PROGRAM, case.before) if case.pair else (changed, case.lengths, case.trouble)
    first = recorded(arm, lengths, rate, trouble, seed + 100)
    first = replace(first, meta=replace(first.meta, sources=(("first.parquet", "first"),)))
    campaign = Campaign(first.meta, lambda: iter(first.trials))
    model = identified(scenario.robot, campaign, settings, silent, None, (), None).model
    if not case.pair:
        return scenario.robot, model, first, False
    data: Recordings = recorded(changed, case.lengths, rate, case.trouble, seed + 200)
    return scenario.robot, model, replace(data, meta=replace(data.meta, sources=(("later.parquet", "later"),))), True


def _changed(scenario: Scenario, case: Case, joint: int) -> Scenario:
    cell = scenario.cell
    if case.effect:
        where = None if case.place == "arm" else joint
        cell, _ = inject(cell, [Hidden(case.effect, where, case.size(scenario.robot, joint))])
    if case.change:
        cell = replace(cell, truth=replace(cell.truth, plant=case.change(cell.truth.plant, joint)))
    return replace(scenario, cell=cell)


def judged(found: Diagnosis, case: Case, robot: Robot, joint: int) -> dict[str, Any]:
    """The answer in short, which names are false, and whether it is right."""
    named = [(r.effect, r.joints) for r in found.ranked]
    where = {robot.joints[joint]} if case.place not in ("arm", "") else set(robot.joints)
    if case.change is _worn:
        where |= {robot.joints[(joint + 2) % robot.n]}
    if case.effect and get(case.effect).scope == "pair":
        where |= {robot.joints[k] for k in (joint - 1, joint + 1) if 0 <= k < robot.n}
    effects = case.says or (case.effect,)
    false = [f"{e}:{'+'.join(at)}" for e, at in named if not (e in effects and (not at or set(at) <= where))]
    right = found.verdict in case.verdicts and not false
    if "none" not in case.verdicts and "unknown" not in case.verdicts:
        right = (
            found.verdict in case.verdicts
            and bool(named)
            and named[0][0] in effects
            and (not named[0][1] or set(named[0][1]) <= where)
        )
    return {
        "case": case.name, "right": right, "false": false, "verdict": found.verdict,
        "named": [f"{e}:{'+'.join(at)}" for e, at in named], "scores": [round(r.score) for r in found.ranked],
        "claims": [f"{r.label} {r.score:.0f} {r.objection}" for r in found.claims], "depends": list(found.depends_on),
        "parameters": [{k: (p.value, p.std) for k, p in r.parameters.items()} for r in found.ranked],
        "notes": list(found.notes), "taken_out": [dict(x) for x in found.taken_out],
        "unexplained": [(u.joint, u.size, u.depends_on, u.resembles) for u in found.unexplained],
        "excess": found.excess, "one_of": [list(r.one_of) for r in found.alternatives],
        "changed": [c.says for c in found.changed],
    }  # fmt: skip


def called(name: str, arm: str, seed: int) -> Case:
    """The case of a name; ``drawn``, ``weeks``: one drawn for an arm."""
    case = next((c for c in CASES if c.name == name), None) or drawn(seed, load_robot(arm).n)
    return weeks_later(case, seed) if name == "weeks" else case


def one(job: tuple[str, str, int, Path]) -> str:
    """Asks one case, unless its answer is kept; ``job``: arm, name of the case (``drawn``, ``weeks``: one of those), seed, and where."""
    path, name, seed, out = job
    file = out / f"{Path(path).parent.name or path}_{seed}_{name.replace(' ', '_')}.json"
    if not file.exists():
        try:
            answer = asked(path, called(name, path, seed), seed)
        except StopsetError as error:  # a refusal is an answer, too
            answer = {"case": name, "right": False, "false": [], "verdict": f"{type(error).__name__}: {error}", "named": []}
        file.write_text(json.dumps(answer, default=str))
    answer = json.loads(file.read_text())
    return f"{'right' if answer['right'] else 'WRONG'} {file.stem}: {answer['case']}: {answer['verdict']} {answer['named']}"


def rate(out: Path) -> None:
    """Counts over all answers in ``out``, and the wrong ones. Exits with 2 and a sentence where there are none: 0 of 0 is no figure."""
    answers = [(f.stem, json.loads(f.read_text())) for f in sorted(out.glob("*.json"))]
    if not answers:
        print(f"{out} holds no answers (*.json); expected those that `ask --out {out}` leaves: ask first", file=sys.stderr)
        raise SystemExit(2)
    for name, a in answers:
        if not a["right"] or a["false"]:
            print(
                f"{name}: {a['case']}: {a['verdict']} {a['named']} {a.get('scores', '')}"
                + (f" FALSE {a['false']}" if a["false"] else "")
            )
    for kind, chosen in (("alone", False), ("pairs", True)):
        mine = [a for _, a in answers if ("later" in a["case"]) == chosen]
        print(
            f"{kind}: {sum(a['right'] for a in mine)} of {len(mine)} right, {sum(bool(a['false']) for a in mine)} with a false name"
        )


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("ask", "rate"))
    parser.add_argument("arms", nargs="*")
    parser.add_argument("--seed", type=int, default=300)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--parallel", type=int, default=2)
    parser.add_argument("--drawn", type=int, default=0, help="so many cases drawn at random instead")
    parser.add_argument("--weeks", action="store_true", help="drawn cases with what weeks and loggers add")
    parser.add_argument("--only", default="", help="cases whose name begins so, comma-separated")
    args = parser.parse_args(argv)
    if args.weeks and not args.drawn:
        parser.error("--weeks adds to drawn cases; expected --drawn with how many")
    if args.command == "ask":
        args.out.mkdir(parents=True, exist_ok=True)
        only = tuple(args.only.split(",")) if args.only else ("",)
        jobs = [
            (arm, case.name, args.seed + 7 * k, args.out)
            for k, case in enumerate(CASES) for arm in (args.arms[k % len(args.arms)],) if case.name.startswith(only)
        ]  # fmt: skip
        if args.drawn:
            name = "weeks" if args.weeks else "drawn"
            jobs = [(args.arms[k % len(args.arms)], name, args.seed + 7 * k, args.out) for k in range(args.drawn)]
        with ProcessPoolExecutor(args.parallel) as pool:
            for line in pool.map(one, jobs):
                print(line, flush=True)
    rate(args.out)


if __name__ == "__main__":
    main()
