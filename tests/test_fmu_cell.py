"""A cell of units in an importer: whoever stops by the arm's own bound does not reach the person."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from fmu_cell import CYCLE, EDGE, IMPORTERS, WALK, cell
from stopset.fmu.build import native

pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = pytest.mark.skipif(native() is None, reason="no FMU binaries for this platform")


PACKAGES = {"fmpy": "fmpy", "Ecos": "ecospy", "libcosim": "libcosimpy"}


@pytest.mark.parametrize("importer", IMPORTERS)
def test_the_person_is_not_reached_and_with_a_text_book_s_distance_she_is(tmp_path: Path, importer: str) -> None:
    if importlib.util.find_spec(PACKAGES[importer]) is None:
        pytest.skip(f"{PACKAGES[importer]} is not installed")
    if importer == "Ecos" and not list(Path(sys.prefix).glob("lib/libtbb.so.12")):
        pytest.skip("the library tbb, which Ecos needs, is not installed")
    run = IMPORTERS[importer]
    proved, textbook = run(cell(tmp_path, False)), run(cell(tmp_path, True))
    for r in (proved, textbook):
        assert r.walked[r.gap < 0.1].min(initial=np.inf) >= WALK, "she is there before the arm"
        assert r.stop.max() == 1 and abs(r.dq[-1]) < 1e-9
        assert r.dq[np.argmax(r.stop)] > 1.2, "asked for at full speed"
    assert 0.0 < proved.gap.min() < 0.3, "not reached, and not stopped far away"
    assert textbook.gap.min() < -0.05
    asked = np.argmax(proved.stop)
    assert proved.q.max() <= proved.ahead[asked] <= EDGE + 0.05


def test_importers_agree_on_the_cell(tmp_path: Path) -> None:
    """But for when in a cycle they read."""
    pytest.importorskip("libcosimpy")
    ssp = cell(tmp_path, False)
    one, other = IMPORTERS["fmpy"](ssp), IMPORTERS["libcosim"](ssp)
    assert abs(one.q.max() - other.q.max()) < 1e-12
    assert abs(one.t[np.argmax(one.stop)] - other.t[np.argmax(other.stop)]) < 1.5 * CYCLE
