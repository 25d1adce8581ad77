"""What the solver of the possible bodies decides of U, beside what another day's recordings do: ``python benchmarks/identify_solver.py``.

Link parameters that no body has are moved to the nearest possible ones by a conic program (`stopset.offline.nominal.physical`).  The same
recordings are identified as shipped, with the solver's tolerances a thousand times smaller, with links scaled in it as they once were, with
positions that are other by a part in 1e12 and by one in 1e6, and with columns of rounded zeros counted as once (and those positions again);
then recordings of the same simulated arm from another seed.  Prints the largest relative difference of U's widths to those as shipped.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import clarabel
import numpy as np

from stopset.offline.campaign.source import Campaign, campaign_of
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import Settings, identified
from stopset.offline.nominal import fit as fitting
from stopset.offline.nominal import physical
from stopset.types import Array

TIGHTER = 1e-3  # times the solver's tolerances
MOVED = (1e-12, 1e-6)  # parts by which positions are changed
FORMER_SMALL = 1e-9**0.5  # [m] `physical.SMALL`, as it was


def widths(folder: Path, moved: float = 0.0) -> Array:
    """(n,) [N m] of U from the recordings in ``folder``, each position ``moved`` by a part of this size."""
    robot = load_robot(str(folder / "robot.urdf"))
    read = campaign_of(robot, [folder / "recording.parquet"])
    rng = np.random.default_rng(1)
    trials = tuple(replace(r, q=r.q * (1.0 + moved * rng.normal(size=r.q.shape))) for r in read.trials())
    return identified(robot, Campaign(read.meta, lambda: trials), Settings()).model.powered.U.width


@contextlib.contextmanager
def tighter() -> Iterator[None]:
    """The solver goes on until it is nearer."""
    usual = clarabel.DefaultSettings

    def settings() -> clarabel.DefaultSettings:
        s = usual()
        for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
            setattr(s, name, TIGHTER * getattr(s, name))
        return s

    clarabel.DefaultSettings = settings
    try:
        yield
    finally:
        clarabel.DefaultSettings = usual


@contextlib.contextmanager
def scaled_as_before() -> Iterator[None]:
    """Links described as points count as points."""
    usual = physical.SMALL
    physical.SMALL = FORMER_SMALL
    try:
        yield
    finally:
        physical.SMALL = usual


@contextlib.contextmanager
def zeros_counted() -> Iterator[None]:
    """Columns that are zero but for rounding count as directions that the data determine."""
    usual = fitting.FELT
    fitting.FELT = 0.0
    try:
        yield
    finally:
        fitting.FELT = usual


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        days = [Path(name) / f"seed-{seed}" for seed in (1, 2)]
        for seed, day in enumerate(days, 1):
            words = ("simulate", "--plan", "short", "--seed", str(seed), "--out", str(day))
            subprocess.run([sys.executable, "-m", "stopset.cli.main", *words], check=True, capture_output=True)
        shipped = widths(days[0])
        print(f"U as shipped [N m]: {np.array2string(shipped, precision=4)}", flush=True)
        for what, changed in (("solved a thousand times nearer", tighter), ("scaled as before", scaled_as_before)):
            with changed():
                print(f"{what}: {np.abs(widths(days[0]) / shipped - 1.0).max():.1e} of it", flush=True)
        for part in MOVED:
            print(
                f"positions other by a part in {1 / part:.0e}: {np.abs(widths(days[0], part) / shipped - 1.0).max():.1e}",
                flush=True,
            )
        with zeros_counted():
            before = widths(days[0])
            print(f"rounded zeros counted, as before: {np.abs(before / shipped - 1.0).max():.1e} of it", flush=True)
            print(
                f"  and positions other by a part in {1 / MOVED[0]:.0e}: {np.abs(widths(days[0], MOVED[0]) / before - 1.0).max():.1e}"
            )
        print(f"recordings of another seed: {np.abs(widths(days[1]) / shipped - 1.0).max():.1e} of it")


if __name__ == "__main__":
    main()
