"""What ready-made parts would bring in place of those that are kept by hand: packages, MB on disk, CPU time to be loaded.

Each alternative is installed into a throw-away environment, and loaded there in fresh processes; beside it what is here now.
Run: python benchmarks/parts.py
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TIMES = 5  # loads, the quickest counts
# (what for, what is installed, what is loaded; the first of each is what is here now)
PARTS: tuple[tuple[str, tuple[str, ...], str], ...] = (
    ("pages: http.server", (), "http.server"),
    ("pages: starlette and uvicorn", ("starlette", "uvicorn"), "starlette.applications, starlette.responses, uvicorn"),
    ("configuration: tomllib and dataclasses", (), "tomllib, dataclasses, typing"),
    ("configuration: msgspec", ("msgspec",), "msgspec.toml"),
    ("configuration: pydantic-settings", ("pydantic-settings",), "pydantic_settings"),
    ("drawing an arm: viser", ("viser",), "viser"),
)
WEIGH = """
import json, sys
from importlib.metadata import distributions
found = [d for d in distributions() if d.metadata["Name"] not in ("pip", "setuptools")]
size = sum(f.locate().stat().st_size for d in found for f in d.files or () if "__pycache__" not in str(f) and f.locate().is_file())
print(json.dumps([len(found), size / 1e6]))
"""
LOAD = "import time; a = time.process_time(); import {}; print(time.process_time() - a)"


def weighed(packages: tuple[str, ...], modules: str, folder: Path) -> tuple[int, float, float]:
    """Packages, their MB, and CPU seconds to load ``modules`` where they are installed."""
    venv.create(folder, with_pip=True)
    python = str(folder / "bin" / "python")
    if packages:
        subprocess.run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages], check=True)

    def said(code: str) -> str:
        return subprocess.run([python, "-c", code], check=True, capture_output=True, text=True).stdout

    count, mb = json.loads(said(WEIGH))
    said(LOAD.format(modules))  # compiles
    return count, mb, min(float(said(LOAD.format(modules))) for _ in range(TIMES))


def main() -> None:
    print("| part | packages | MB | ms of CPU to load |\n|---|---|---|---|")
    for what, packages, modules in PARTS:
        with tempfile.TemporaryDirectory() as folder:
            count, mb, seconds = weighed(packages, modules, Path(folder))
        print(f"| {what} | {count} | {mb:.1f} | {1e3 * seconds:.0f} |", flush=True)
    for name in ("model/stopset/serving/server.py", "model/stopset/serving/arm.js"):
        text = (ROOT / name).read_text(encoding="utf-8")
        print(f"{name}: {len(text.splitlines())} lines, {len(text) / 1e3:.1f} kB")


if __name__ == "__main__":
    sys.exit(main())
