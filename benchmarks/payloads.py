"""Is a payload's interval true: masses weighed by diagnosis against those mounted, on real and on simulated recordings.

    python benchmarks/payloads.py [FOLDER MASS] [--parts] [--simulated N] [--arm lwa4p|URDF ...]

FOLDER holds ``robot.urdf``, ``identification.parquet`` without a load, and one or more ``payload_*.parquet`` with MASS [kg] mounted.
Simulated: an arm whose description is 2 to 5 % off in mass, whose drives report up to 10 % too much or too little torque, is
identified without a load, and weighs one of 0.5 to 4 kg another day.

Each load is weighed in two ways: *pair*, against a model from recordings without it, and *alone*, where the loaded recording is all
there is and the robot's description is all it can be held against.  Real recordings are few, so ``--parts`` asks theirs: models of
every third free recording, and halves of the loaded ones.  Parts of one recording share what is wrong with it; they are counted apart.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stopset.artifact import Model
from stopset.offline.campaign.source import Campaign
from stopset.offline.description import load_robot
from stopset.offline.diagnose import diagnose_model
from stopset.offline.identify.pipeline import Settings, identified
from stopset.recording import Recording, Recordings, read_recordings
from stopset.robot import Robot
from stopset.simulation.campaign import Schedule, make
from stopset.simulation.cell import build_cell, wrong_cad
from stopset.simulation.hidden import Hidden, healthy
from stopset.simulation.plant import healthy_plant
from stopset.simulation.scenario import complete_robot
from stopset.simulation.sizing import inject

SIDES = 1.96  # standard deviations to either side of a 95 % interval
THIRDS = 3


@dataclass(frozen=True, slots=True)
class Weighed:
    """A load of ``mass`` [kg] and what was said of it: mass and standard deviation; None where no payload is named."""

    kind: str
    name: str
    mass: float
    said: tuple[float, float] | None

    @property
    def inside(self) -> bool:
        return self.said is not None and abs(self.said[0] - self.mass) <= SIDES * self.said[1]

    @property
    def row(self) -> str:
        if self.said is None:
            return f"| {self.kind} | {self.name} | {self.mass:.3f} | no payload named | | no |"
        m, std = self.said
        half = SIDES * std
        return (
            f"| {self.kind} | {self.name} | {self.mass:.3f} | {m:.2f}, {m - half:.2f} to {m + half:.2f} | {m / self.mass - 1:+.1%} | "
            f"{'yes' if self.inside else 'no'} |"
        )


def mass_of(model: Model, data: Recordings) -> tuple[float, float] | None:
    """Mass and its standard deviation [kg]; None where no payload is found."""
    claims = diagnose_model(model, data, ["payload"])[0].claims
    m = next((c.parameters["m"] for c in claims if c.effect == "payload"), None)
    return None if m is None or m.std is None else (m.value, m.std)


def model_of(robot: Robot, data: Recordings) -> Model:
    return identified(robot, Campaign(data.meta, lambda: iter(data.trials)), Settings()).model


def part(data: Recordings, trials: tuple[Recording, ...], name: str) -> Recordings:
    """Some ``trials`` of a recording, under a digest of their own: a model of other parts is one of other recordings."""
    return replace(data, trials=trials, meta=replace(data.meta, sources=((name, name),)))


def halves(data: Recordings) -> Iterator[tuple[str, Recordings]]:
    """The first and the second half of the time of a recording of one trial."""
    (r,) = data.trials
    middle = len(r.t) // 2
    for name, lo, hi in (("first half", 0, middle), ("second half", middle, len(r.t))):
        yield name, part(data, (r.cut(lo, hi),), name)


def real(folder: Path, mass: float, *, parts: bool) -> Iterator[Weighed]:
    robot = load_robot(folder / "robot.urdf")
    free = read_recordings(folder / "identification.parquet", robot)
    loaded = [(p.stem, read_recordings(p, robot)) for p in sorted(folder.glob("payload_*.parquet"))]
    model = model_of(robot, free)
    for name, data in loaded:
        yield Weighed("real pair", name, mass, mass_of(model, data))
        yield Weighed("real, alone", name, mass, mass_of(model_of(robot, data), data))
    if not parts:
        return
    thirds = [part(free, free.trials[k::THIRDS], f"third {k + 1}") for k in range(THIRDS)]
    for which, m in [("all", model), *((t.meta.sources[0][0], model_of(robot, t)) for t in thirds)]:
        for name, data in loaded:
            whole = [] if m is model else [("whole", data)]
            for piece, rows in [*whole, *halves(data)]:
                yield Weighed("parts of real pairs", f"{name}, {piece}; free: {which}", mass, mass_of(m, rows))


def simulated(robot: Robot, seed: int) -> Iterator[Weighed]:
    rng = np.random.default_rng([seed, 9])
    arm, mass, gain = complete_robot(robot, seed), float(rng.uniform(0.5, 4.0)), float(rng.uniform(0.9, 1.1))
    plant = healthy_plant(arm, np.random.default_rng([seed, 1]))._replace(pi=wrong_cad(arm, np.random.default_rng([seed, 3])))
    made = []
    for name, offset in (("free", 0), ("loaded", 100_000)):
        cell = build_cell(arm, healthy(plant), seed + offset)
        if offset:
            cell, _ = inject(cell, [Hidden("payload", None, mass)])
        trials = tuple(replace(r, tau=gain * r.tau) for r in make(cell, Schedule(poses=0), {"closed_loop"}))
        made.append(Recordings(replace(cell.meta, sources=((name, name),)), trials))
    free, loaded = made
    said = f"{robot.n} joints, seed {seed}, gain {gain:.3f}"
    yield Weighed("simulated pair", said, mass, mass_of(model_of(arm, free), loaded))
    yield Weighed("simulated, alone", said, mass, mass_of(model_of(arm, loaded), loaded))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("mass", nargs="?", type=float)
    parser.add_argument("--parts", action="store_true", help="parts of the real recordings, too")
    parser.add_argument("--simulated", type=int, default=0)
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--arm", nargs="+", default=["lwa4p"])
    args = parser.parse_args()
    print("| weighed | recordings | mounted [kg] | said, 95 % [kg] | off | inside |\n|---|---|---|---|---|---|", flush=True)
    rows: list[Weighed] = []
    arms = [load_robot(a) for a in args.arm]
    sources = [real(args.folder, args.mass, parts=args.parts)] if args.folder else []
    sources += [simulated(arms[k % len(arms)], args.first + k) for k in range(args.simulated)]
    for source in sources:
        for row in source:
            rows.append(row)
            print(row.row, flush=True)
    print("\n| weighed | loads | inside 95 % | largest error | median half-width |\n|---|---|---|---|---|")
    for kind in dict.fromkeys(r.kind for r in rows):
        mine = [r for r in rows if r.kind == kind]
        off = [abs(r.said[0] / r.mass - 1) for r in mine if r.said]
        wide = [SIDES * r.said[1] / r.mass for r in mine if r.said]
        worst, median = (f"{max(off):.1%}", f"{np.median(wide):.1%}") if off else ("", "")
        print(f"| {kind} | {len(mine)} | {sum(r.inside for r in mine)} | {worst} | {median} |")


if __name__ == "__main__":
    main()
