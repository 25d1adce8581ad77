"""Diagnose labelled data sets and count right answers: effect and joint, pairs, healthy sets, causes outside the catalogue.

FOLDER holds labels.json and, per set, recording.parquet, robot.urdf and robot.json.
Run: python benchmarks/diagnosis_labelled.py FOLDER --out ANSWERS
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

from stopset.offline.description import load_robot
from stopset.offline.diagnose import diagnose
from stopset.recording import read_recordings

SAME = {"asym_coulomb": "asymmetric_coulomb"}  # names of the labels that differ from the catalogue's


def right(label: dict[str, Any], verdict: str, ranked: list[tuple[str, tuple[str, ...]]]) -> bool:
    """Verdict as labelled, and every true effect among the first entries, at a true joint where it has one."""
    if verdict != label["verdict"]:
        return False
    for true in label["effects"] if verdict == "missing" else ():
        name, joints = SAME.get(true["effect"], true["effect"]), set(true["joints"])
        first = ranked[: len(label["effects"]) + max(len(joints), 1) - 1]
        if not any(effect == name and (not at or joints & set(at)) for effect, at in first):
            return False
    return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, help="write the answers here, one JSON per set")
    args = parser.parse_args()
    labels = json.loads((args.folder / "labels.json").read_text())
    count: dict[str, list[bool]] = {}
    for name, label in sorted(labels.items()):
        robot = load_robot(args.folder / name / "robot.urdf")
        start = time.process_time()
        found = diagnose(robot, read_recordings(args.folder / name / "recording.parquet", robot))
        ok = right(label, found.verdict, [(r.effect, r.joints) for r in found.ranked])
        count.setdefault(f"{label['verdict']}, {len(label['effects'])} hidden", []).append(ok)
        words = ", ".join(r.label for r in found.ranked) or "-"
        words += "" if found.structure is None else f"; a structure at {' or '.join(found.structure.may_sit_at)}"
        print(f"{name}: {'right' if ok else 'WRONG'}: {found.verdict} {words}, {time.process_time() - start:.1f} s", flush=True)
        if args.out:
            args.out.mkdir(parents=True, exist_ok=True)
            (args.out / f"{name}.json").write_text(json.dumps(found.as_json()))
    for kind, answers in sorted(count.items()):
        print(f"{kind}: {sum(answers)} of {len(answers)} right")


if __name__ == "__main__":
    main()
