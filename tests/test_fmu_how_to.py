"""The how-to's programs run as they stand there, on one arm, and all say the same."""

from __future__ import annotations

import ctypes
import importlib.util
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stopset.fmu import Contents, export
from stopset.fmu.build import native
from test_fmu_stops import braked

pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytest.importorskip("matplotlib").use("Agg")
pytestmark = pytest.mark.skipif(native() is None, reason="no FMU binaries for this platform")
PAGE = Path(__file__).resolve().parents[1] / "docs" / "how-to" / "fmu.md"


def programs() -> dict[str, str]:
    """By the title above each."""
    parts = re.split(r"^### ", PAGE.read_text(), flags=re.M)[1:]
    return {p.split("\n")[0]: found[1] for p in parts if (found := re.search(r"```python\n(.*?)```", p, re.S))}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("how-to")
    for fmi, name in ((3, "arm"), (2, "arm2")):
        export(braked(8.0, 3), out / f"{name}.fmu", Contents(fmi, (str(native()),)))
    return out


@pytest.mark.parametrize(("title", "needs"), [("fmpy", "fmpy"), ("Ecos", "ecospy"), ("libcosim", "libcosimpy")])
def test_the_program_shows_the_arm_stop_below_its_bound(folder: Path, title: str, needs: str, monkeypatch: Any) -> None:
    import matplotlib.pyplot as plt

    tbb = next(Path(sys.prefix).glob("lib/libtbb.so.12"), None)
    if importlib.util.find_spec(needs) is None or (needs == "ecospy" and tbb is None):
        pytest.skip(f"{needs} is not installed")
    if needs == "ecospy":
        ctypes.CDLL(str(tbb), mode=ctypes.RTLD_GLOBAL)
    monkeypatch.chdir(folder)
    plt.close("all")
    exec(compile(programs()[title].replace("arm_1_joint", "axis_1").replace("0.004", "0.01").replace("4_000_000", "10_000_000")
                 .replace("range(150)", "range(60)").replace("k == 50", "k == 20").replace("[50]", "[20]"), title, "exec"), {})  # fmt: skip
    assert (folder / f"{title.lower()}.png").stat().st_size > 5000
    curve, bound = plt.gca().lines
    q, limit = np.asarray(curve.get_ydata(), float), float(np.asarray(bound.get_ydata(), float)[0])
    assert len(q) >= 60 and abs(q[-1] - q[-5]) < 1e-9, "at rest"
    assert 0.05 < q[-1] <= limit < q[-1] + 0.1
