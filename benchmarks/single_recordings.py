"""Whether the sets of one recording hold for its rest: the blocks of the rest that leave, and how tight the sets are.

    python benchmarks/single_recordings.py [FOLDER] [--simulated N] [--margin 1]

FOLDER holds one folder per robot with ``robot.urdf``, one recording ``*.parquet`` and maybe ``only.txt``, as for `real_robots.py`; the first
60 % of the time are identified, the rest judges in blocks of 2.5 s.  Simulated: arms of a wrong description along one motion of 40 s, the
first half identified.  ``--margin 1`` is what sets were before parts of a recording were left out in turn.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import as_found
import real_robots

from stopset.offline.campaign.hold_out import blocks
from stopset.offline.compare.compare import compare
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import Settings, identify
from stopset.recording import Meta, Recording, read_recordings, write_recordings
from stopset.robot import Robot
from stopset.simulation import prepare

SECONDS, SHARE = 40.0, 0.5  # of a simulated recording: length, and what of it is identified


class Single(NamedTuple):
    """One recording, cut into what is identified and what judges."""

    name: str
    robot: Robot
    meta: Meta
    fit: list[Recording]
    test: list[Recording]


def real(folder: Path) -> Iterator[Single]:
    """Robots of which there is one recording."""
    for path in sorted(p.parent for p in folder.glob("*/robot.urdf")):
        options = (path / "only.txt").read_text().split() if (path / "only.txt").exists() else []
        given = dict(zip(options[::2], options[1::2], strict=True))
        lock = tuple(given["--lock"].split(",")) if "--lock" in given else ()
        robot = load_robot(path / "robot.urdf", tip=given.get("--tip"), lock=lock)
        read = read_recordings(sorted(path.glob("*.parquet")), robot)
        if len(read.trials) == 1:
            yield Single(path.name, robot, replace(read.meta, joints=robot.joints), *real_robots.divided(read))


def simulated(seed: int) -> Single:
    """An arm with nothing hidden, its description off."""
    scenario = prepare(load_robot("lwa4p"), ["none"], seed, "short", cad="wrong")
    read = as_found.recorded(scenario, (SECONDS,), 100.0, as_found.Trouble(), seed + 100)
    r = read.trials[0]
    cut = round(SHARE * len(r.t))
    meta = replace(read.meta, joints=scenario.robot.joints)
    return Single(f"simulated {seed}", scenario.robot, meta, [r.cut(0, cut)], [r.cut(cut, len(r.t))])


def judged(one: Single, margin: float | None, folder: Path) -> tuple[str, int, int]:
    """A row, the blocks that judge, and those that leave."""
    rest = [replace(b, suite=k, trial=0, phase="closed_loop") for k, b in enumerate(b for r in one.test for b in blocks(r, 0.0))]
    write_recordings(folder / "fit.parquet", one.meta, [replace(r, phase="closed_loop") for r in one.fit])
    write_recordings(folder / "test.parquet", one.meta, rest)
    found = identify(one.robot, [folder / "fit.parquet"], Settings(margin=margin))
    rows = compare(found.model, [folder / "test.parquet"]).rows
    left = [r for r in rows if r.violation is not None]
    inside = sum(r.inside_domain for r in left), sum(r.inside_domain for r in rows)
    wide = f"{found.tightness.median:.2f}, {found.model.powered.U.width.sum():.0f}"
    said = f"{len(left)} of {len(rows)} | {inside[0]} of {inside[1]} | {found.model.powered.margin:.2f} | {wide}"
    return f"| {one.name} | {said} |", len(rows), len(left)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--simulated", type=int, default=0, metavar="N")
    parser.add_argument("--margin", type=float)
    args = parser.parse_args()
    print(
        "| recording | blocks that leave | of those within the domain | margin | tightness at 0.1 s, U [N m] |\n"
        + "|---" * 5
        + "|"
    )
    tried = left = 0
    with tempfile.TemporaryDirectory() as work:
        for one in [*(real(args.folder) if args.folder else ()), *map(simulated, range(1, args.simulated + 1))]:
            row, here, out = judged(one, args.margin, Path(work))
            tried, left = tried + here, left + out
            print(row, flush=True)
    print(f"{left} of {tried} blocks leave")


if __name__ == "__main__":
    main()
