"""Is a payload's interval true: masses weighed by diagnosis against those mounted, on real and on simulated pairs of recordings.

    python benchmarks/payloads.py [FOLDER MASS] [--simulated N]

FOLDER holds ``robot.urdf``, ``identification.parquet`` without a load, and one or more ``payload_*.parquet`` with MASS [kg] mounted.
Simulated pairs: an arm whose description is 2 to 5 % off in mass, whose drives report up to 10 % too much or too little torque, is
identified without a load, and weighs one of 0.5 to 4 kg another day.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from stopset.artifact import Model
from stopset.offline.description import load_robot
from stopset.offline.diagnose import diagnose_model
from stopset.offline.identify.pipeline import identify
from stopset.recording import read_recordings, write_recordings
from stopset.robot import Robot
from stopset.simulation.campaign import Plan, make
from stopset.simulation.cell import build_cell, wrong_cad
from stopset.simulation.hidden import Hidden, healthy
from stopset.simulation.plant import healthy_plant
from stopset.simulation.scenario import complete_robot
from stopset.simulation.sizing import inject

SIDES = 1.96  # standard deviations to either side of a 95 % interval


def weighed(model: Model, path: Path) -> tuple[float, float] | None:
    """Mass and its standard deviation [kg]; None where no payload is found."""
    claims = diagnose_model(model, read_recordings(path), ["payload"])[0].claims
    m = next((c.parameters["m"] for c in claims if c.effect == "payload"), None)
    return None if m is None or m.std is None else (m.value, m.std)


def real(folder: Path, mass: float) -> Iterator[tuple[str, float, tuple[float, float] | None]]:
    model = identify(load_robot(folder / "robot.urdf"), [folder / "identification.parquet"]).model
    for path in sorted(folder.glob("payload_*.parquet")):
        yield path.stem, mass, weighed(model, path)


def simulated(robot: Robot, seed: int, folder: Path) -> tuple[str, float, tuple[float, float] | None]:
    rng = np.random.default_rng([seed, 9])
    arm, mass, gain = complete_robot(robot, seed), float(rng.uniform(0.5, 4.0)), float(rng.uniform(0.9, 1.1))
    plant = healthy_plant(arm, np.random.default_rng([seed, 1]))._replace(pi=wrong_cad(arm, np.random.default_rng([seed, 3])))
    model = None
    for name, offset in (("free", 0), ("loaded", 100_000)):
        cell = build_cell(arm, healthy(plant), seed + offset)
        if offset:
            cell, _ = inject(cell, [Hidden("payload", None, mass)])
        trials = (replace(r, tau=gain * r.tau) for r in make(cell, Plan(poses=0), {"closed_loop"}))
        write_recordings(folder / f"{name}.parquet", cell.meta, trials)
        if model is None:
            model = identify(arm, [folder / "free.parquet"]).model
    assert model is not None
    return f"simulated {seed}, gain {gain:.3f}", mass, weighed(model, folder / "loaded.parquet")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("mass", nargs="?", type=float)
    parser.add_argument("--simulated", type=int, default=0)
    args = parser.parse_args()
    rows = list(real(args.folder, args.mass)) if args.folder else []
    print("| pair | mounted [kg] | weighed [kg] | off | inside 95 % |\n|---|---|---|---|---|", flush=True)
    inside = 0
    with tempfile.TemporaryDirectory() as d:
        for k in range(len(rows) + args.simulated):
            name, mass, found = rows[k] if k < len(rows) else simulated(load_robot("lwa4p"), k - len(rows) + 1, Path(d))
            hit = found is not None and abs(found[0] - mass) <= SIDES * found[1]
            inside += hit
            said = "not found" if found is None else f"{found[0]:.3f} ± {found[1]:.3f} | {found[0] / mass - 1:+.1%}"
            print(f"| {name} | {mass:.3f} | {said} | {'yes' if hit else 'no'} |", flush=True)
    print(f"{inside} of {len(rows) + args.simulated} intervals hold the mounted mass")


if __name__ == "__main__":
    main()
