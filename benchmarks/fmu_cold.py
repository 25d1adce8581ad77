"""First exports of a model, each with no cache at all: ``python benchmarks/fmu_cold.py MODEL.model.json [--runs 2] [--fmi 3] [--tree FOLDER]``.

Every run has a folder, a cache and a name of the unit's file of its own, as on another machine. Prints how long it took, the longest time
without a word of progress, and the SHA-256 of the unit, which is to be the same one. ``--tree``: of another clone of this repository,
whose core is compiled there. 1 where two units differ.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PACKAGES = ("model", "offline", "monitor", "fmu")


def exported(model: Path, folder: Path, fmi: str, tree: Path | None) -> tuple[str, list[float], float]:
    """SHA-256 of the unit, moments of the words on the way [s], and seconds of processor time."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache"), "TMPDIR": str(folder)}
    environment.pop("ZIG_GLOBAL_CACHE_DIR", None)
    environment.pop("ZIG_LOCAL_CACHE_DIR", None)
    if tree is not None:
        environment["PYTHONPATH"] = os.pathsep.join(str(tree / p) for p in PACKAGES)
    (folder / "cache").mkdir()
    unit = folder / f"{folder.name}.fmu"
    begin, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-m", "stopset.cli.main", "export-fmu", str(model), "--out", str(unit), "--fmi", fmi]
    with subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        said = []
        for line in process.stderr:
            said.append(time.monotonic() - begin)
            print(f"  {said[-1]:6.1f} s  {line.rstrip()}", flush=True)
    said.append(time.monotonic() - begin)
    if process.returncode:
        sys.exit(f"the export ended with {process.returncode}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return hashlib.sha256(unit.read_bytes()).hexdigest(), said, spent


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--fmi", choices=("2", "3"), default="3")
    parser.add_argument("--tree", type=Path)
    args = parser.parse_args()
    seen = set()
    for k in range(args.runs):
        with tempfile.TemporaryDirectory(prefix=f"cold-{k}-") as name:
            sha256, said, spent = exported(args.model, Path(name), args.fmi, args.tree)
        silence = max(b - a for a, b in itertools.pairwise([0.0, *said]))
        print(
            f"run {k + 1}: {said[-1]:.0f} s, {spent:.0f} s of processor time, at most {silence:.0f} s silent, SHA-256 {sha256}",
            flush=True,
        )
        seen.add(sha256)
    return int(len(seen) > 1)


if __name__ == "__main__":
    sys.exit(main())
