"""What a part's install weighs: every package that ``stopset[PART]`` brings, by what it takes on disk here, largest first.

From the metadata of what is installed, so nothing is fetched; compiled Python (``__pycache__``) is not counted.
Run: python benchmarks/install_size.py [PART]   (monitor if left out; "" for the base)
"""

from __future__ import annotations

import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

HEAVY = (
    "numba",
    "llvmlite",
    "scipy",
    "pin",
    "cvxpy",
    "toppra",
    "plotly",
    "matplotlib",
    "pandas",
)  # what the daemon's must not have


def closure(part: str) -> dict[str, Distribution]:
    """Packages of ``stopset[part]`` by name, those they need included; raises `PackageNotFoundError` for one that is not here."""
    found: dict[str, Distribution] = {}
    done: set[tuple[str, str]] = set()
    todo = [("stopset", part)]
    while todo:
        name, extra = todo.pop()
        if (name, extra) in done:
            continue
        done.add((name, extra))
        found.setdefault(name, distribution(name))
        for line in found[name].requires or ():
            need = Requirement(line)
            if need.marker is None or need.marker.evaluate({"extra": extra}):
                todo += [(canonicalize_name(need.name), e) for e in ("", *need.extras)]
    return found


def size(package: Distribution) -> float:
    """MB of a package's files, each once."""
    files = {Path(str(package.locate_file(f))) for f in package.files or () if "__pycache__" not in str(f)}
    return sum(f.stat().st_size for f in files if f.is_file()) / 1e6


def own() -> float:
    """MB of stopset itself, which is installed by a link where it is worked on."""
    root = Path(__file__).resolve().parents[1]
    parts = (p for part in ("model", "offline", "monitor", "fmu") for p in (root / part).rglob("*"))
    return sum(p.stat().st_size for p in parts if p.is_file() and "__pycache__" not in p.parts) / 1e6


def main() -> None:
    part = sys.argv[1] if len(sys.argv) > 1 else "monitor"
    try:
        found = closure(part)
    except PackageNotFoundError as e:
        raise SystemExit(f"install_size: {e}; expected all of stopset[{part}] here: pip install -e '.[{part}]'") from e
    rows = sorted(((own() if name == "stopset" else size(d), name, d.version) for name, d in found.items()), reverse=True)
    print("| package | version | MB |\n|---|---|---|")
    for mb, name, version in rows:
        print(f"| {name} | {version} | {mb:.1f} |")
    print(f"| **{len(rows)} packages** | | **{sum(mb for mb, *_ in rows):.0f}** |")
    heavy = sorted(set(found) & set(HEAVY))
    if part == "monitor" and heavy:
        raise SystemExit(f"install_size: the daemon's install has {', '.join(heavy)}")


if __name__ == "__main__":
    main()
