"""Is a payload's interval true on small arms that nobody prepared: poor descriptions, drives that are off one by one, one trajectory each.

    python benchmarks/payloads_poor.py [--count 20] [--first 1] [--good]
    python benchmarks/payloads_poor.py --real FOLDER MASS

Drawn: an arm of four joints and 3 to 6 kg, whose description has each link's mass off by a factor (one standard deviation 50 %) and whose
drives report torque that is off by 15 % one by one (one standard deviation each), identified from one trajectory of 30 s, and a load of
0.2 to 1 kg weighed another day, when each joint's friction is another by 10 %.  What all drives are off by alike no recording of one arm
tells, so the mean of their scales is 1.  ``--good``: a description that is 2 to 5 % off and drives that are right, for what an interval
costs where nothing is wrong.  ``--real``: recordings as `payloads.py` takes them, against models of all and of the first third of the free
ones.  Stated are the intervals that hold the load, each as `diagnose` says it and as it would be without regard to how the joints agree on
it, and names beside it of what is not there.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import payloads
from as_found import ONE, Trouble, recorded

from stopset.artifact import Model
from stopset.offline.campaign.source import Campaign
from stopset.offline.description import load_robot, robot_from_text
from stopset.offline.diagnose.diagnose import answered
from stopset.offline.diagnose.evidence.uncertainty import deviations
from stopset.offline.diagnose.examination import examine
from stopset.offline.diagnose.question import question
from stopset.offline.identify.pipeline import Settings, identified
from stopset.recording import Recordings, read_recordings
from stopset.simulation import Scenario
from stopset.simulation.campaign import SHORT
from stopset.simulation.cell import build_cell, wrong_cad
from stopset.simulation.hidden import Hidden, healthy
from stopset.simulation.plant import healthy_plant
from stopset.simulation.scenario import complete_robot
from stopset.simulation.sizing import inject

SIDES = 1.96  # standard deviations to either side of a 95 % interval
MASSES, DRIVES, FRICTION = 0.5, 0.15, 0.1  # relative, one standard deviation
LOADS = (0.2, 1.0)  # [kg]
LINKS = ((0.9, 0.1, 0.12, "0 0 1"), (1.1, 0.11, 0.24, "0 1 0"), (0.7, 0.12, 0.26, "0 1 0"), (0.5, 0.05, 0.1, "1 0 0"))


def urdf(scale: float) -> str:
    """A small arm whose masses are ``scale`` times the usual ones: turn, lift, bend and a wrist that turns across the forearm."""
    text = ['<robot name="small"><link name="base"/>']
    parent, reach = "base", 0.1
    for k, (mass, centre, length, axis) in enumerate(LINKS):
        m, long, thin = mass * scale, mass * scale * length**2 / 8, mass * scale * 0.03**2
        text.append(
            f'<joint name="j{k}" type="revolute"><parent link="{parent}"/><child link="l{k}"/><origin xyz="0 0 {reach}"/><axis xyz="{axis}"/>'
            f'<limit lower="-2.6" upper="2.6" effort="{(20, 20, 15, 5)[k]}" velocity="2.0"/></joint><link name="l{k}"><inertial>'
            f'<origin xyz="0.01 0 {centre}"/><mass value="{m}"/><inertia ixx="{long}" iyy="{long}" izz="{thin}" ixy="0" ixz="0" iyz="0"/>'
            "</inertial></link>"
        )
        parent, reach = f"l{k}", length
    return "".join([*text, f'<joint name="f" type="fixed"><parent link="{parent}"/><child link="tool"/><origin xyz="0 0 {reach}"/></joint>',
                    '<link name="tool"/></robot>'])  # fmt: skip


@dataclass(frozen=True, slots=True)
class Weighed:
    """A load of ``mass`` [kg]: what is said of it, mass and standard deviation, (None: it is not named), the same ``plain``, and names beside it."""

    mass: float
    said: tuple[float, float] | None
    plain: tuple[float, float] | None
    beside: tuple[str, ...]


def inside(mass: float, said: tuple[float, float] | None) -> bool:
    return said is not None and abs(said[0] - mass) <= SIDES * said[1]


def pair(seed: int, *, good: bool) -> tuple[Model, Recordings, float]:
    """A model of the empty arm, a recording with a load, and what it weighs [kg]."""
    rng = np.random.default_rng([seed, 11])
    arm = complete_robot(robot_from_text(urdf(float(rng.uniform(0.9, 1.8)))), seed)
    mass = float(rng.uniform(*LOADS))
    plant = healthy_plant(arm, np.random.default_rng([seed, 1]))._replace(pi=wrong_cad(arm, np.random.default_rng([seed, 3])))
    gains = np.exp((0.0 if good else DRIVES) * rng.normal(size=arm.n))
    gains /= gains.mean()
    described = arm.with_parameters(arm.pi * np.exp((0.0 if good else MASSES) * rng.normal(size=(arm.n, 1))))
    worn = {k: getattr(plant, k) * np.exp(FRICTION * rng.normal(size=arm.n)) for k in ("fc", "fv")}
    made = list[Recordings]()
    for name, body in (("free", plant), ("loaded", plant._replace(**worn))):
        cell = build_cell(arm, healthy(body), seed + 1000 * len(made))
        if made:
            cell, _ = inject(cell, [Hidden("payload", None, mass)])
        r = recorded(Scenario(arm, cell, SHORT, {}), ONE, 100.0, Trouble(), seed + 2000 * len(made))
        trials = tuple(replace(x, tau=x.tau * gains) for x in r.trials)
        made.append(replace(r, trials=trials, meta=replace(r.meta, sources=((name, name),))))
    free, loaded = made
    return identified(described, Campaign(free.meta, lambda: iter(free.trials)), Settings()).model, loaded, mass


def weighed(model: Model, loaded: Recordings, mass: float) -> Weighed:
    """What `diagnose` says, and what it would say if all joints were taken to agree."""
    q = question(model, loaded)
    x = examine(q.robot, q.asked, q.fitted, q.before)
    ranked = answered(x).ranked
    m = next((r.parameters["m"] for r in ranked if r.effect == "payload"), None)
    plain = None
    for claim in x.found.claims:
        c = claim.scored.candidate
        if m is not None and c.effect.name == "payload":
            std = deviations(x.found.now, x.left.hyper, x.left.theta, [c])[0]["m"]
            plain = (float(claim.scored.theta[0]), std)
    said = None if m is None or m.std is None else (m.value, m.std)
    return Weighed(mass, said, plain, tuple(r.label for r in ranked if r.effect != "payload"))


def real(folder: Path, mass: float) -> Iterator[tuple[Model, Recordings, float]]:
    """Loaded recordings against a model of all free ones, and their halves against one of a third of these."""
    robot = load_robot(folder / "robot.urdf")
    free = read_recordings(folder / "identification.parquet", robot)
    loaded = [read_recordings(p, robot) for p in sorted(folder.glob("payload_*.parquet"))]
    model = payloads.model_of(robot, free)
    yield from ((model, data, mass) for data in loaded)
    model = payloads.model_of(robot, payloads.part(free, free.trials[:: payloads.THIRDS], "third 1"))
    yield from ((model, half, mass) for data in loaded for _, half in payloads.halves(data))


def row(seed: int, w: Weighed) -> str:
    def interval(said: tuple[float, float] | None) -> str:
        if said is None:
            return "not named | |"
        return f"{said[0]:.2f}, {said[0] - SIDES * said[1]:.2f} to {said[0] + SIDES * said[1]:.2f} | {'yes' if inside(w.mass, said) else 'no'} |"

    return f"| {seed} | {w.mass:.2f} | {interval(w.said)} {interval(w.plain)} {', '.join(w.beside)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--good", action="store_true", help="descriptions and drives that are right")
    parser.add_argument("--real", nargs=2, metavar=("FOLDER", "MASS"), help="recordings, and the load that is mounted [kg]")
    args = parser.parse_args()
    if args.count < 1:
        parser.error(f"--count {args.count}: no arm is drawn; expected at least 1")
    if args.real and not args.real[1].replace(".", "", 1).isdigit():
        parser.error(f"--real FOLDER {args.real[1]}: expected a mass in kg")
    if args.real and not (Path(args.real[0]) / "robot.urdf").is_file():
        parser.error(f"--real {args.real[0]}: no robot.urdf there; expected the folder of a robot and its recordings")
    print(
        "| seed | load [kg] | said, 95 % [kg] | inside | all joints taken to agree | inside | beside it |\n|---|---|---|---|---|---|---|"
    )
    seeds = range(args.first, args.first + args.count)
    pairs = real(Path(args.real[0]), float(args.real[1])) if args.real else (pair(seed, good=args.good) for seed in seeds)
    rows = []
    for k, drawn in enumerate(pairs):
        rows.append(weighed(*drawn))
        print(row(args.first + k, rows[-1]), flush=True)
    named = [w for w in rows if w.said and w.plain]
    print(f"\n{len(named)} of {len(rows)} loads named")
    for title, said in (("as said", [w.said for w in named]), ("all joints taken to agree", [w.plain for w in named])):
        held = sum(inside(w.mass, s) for w, s in zip(named, said, strict=True))
        wide = float(np.median([SIDES * s[1] / w.mass for w, s in zip(named, said, strict=True) if s])) if named else float("nan")
        off = float(np.median([abs(s[0] / w.mass - 1) for w, s in zip(named, said, strict=True) if s])) if named else float("nan")
        print(
            f"{title}: {held} of {len(named)} intervals hold it, median half-width {wide:.1%} of the load, median error {off:.1%}"
        )
    wider = float(np.median([w.said[1] / w.plain[1] for w in named if w.said and w.plain])) if named else float("nan")
    print(f"as said over all joints taken to agree, median of the widths: {wider:.2f}")
    print(f"names beside it: {dict(Counter(e.partition(':')[0] for w in rows for e in w.beside))}")


if __name__ == "__main__":
    main()
