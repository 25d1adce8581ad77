"""The rules of the FMI standard as INTO-CPS wrote them down formally (FMI-VDM), run on units as they are exported.

Its checkers are not part of this project: STOPSET_VDMCHECK2 and STOPSET_VDMCHECK3 name the scripts VDMCheck2.sh and VDMCheck3.sh of a
release of FMI-VDM-Model, which need Java. docs/fmu.md says how they are built from source.
"""

from __future__ import annotations

import os
import subprocess
import zipfile
from pathlib import Path

import pytest

from stopset.fmu import Contents, export
from stopset.fmu.build import native
from test_fmu_fuzz import MODELS

pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(native() is None, reason="no FMU binaries for this platform")]


def said(fmi: int, unit: Path) -> str:
    script = os.environ.get(f"STOPSET_VDMCHECK{fmi}")
    if script is None:
        pytest.skip(f"VDMCheck{fmi}.sh is not here; build it as docs/fmu.md says and set STOPSET_VDMCHECK{fmi}")
    done = subprocess.run([script, str(unit)], capture_output=True, text=True, timeout=300, check=False)
    return done.stdout + done.stderr


@pytest.mark.parametrize(
    ("name", "fmi", "clocks"),
    [
        ("linear", 2, False), ("linear", 3, True), ("effects", 2, False), ("effects", 3, False), ("cubic", 2, False), ("cubic", 3, False),
        ("model 3", 3, False), ("from outside", 2, False), ("from outside", 3, True),
    ],
)  # fmt: skip
def test_no_rule_of_the_standard_is_broken(tmp_path: Path, name: str, fmi: int, clocks: bool, own_effect: object) -> None:
    unit = export(MODELS[name](), tmp_path / "F.fmu", Contents(fmi, (str(native()),), reference=False, clocks=clocks))
    assert said(fmi, unit).strip() == "No errors found."


@pytest.mark.parametrize(
    ("fmi", "right", "wrong"),
    [
        (2, "</Outputs>", '<Unknown index="1"/></Outputs>'),
        (3, "</ModelStructure>", '<Output valueReference="0"/></ModelStructure>'),
    ],
)
def test_a_broken_rule_is_said(tmp_path: Path, fmi: int, right: str, wrong: str) -> None:
    """Time is no output."""
    unit, broken = (
        export(MODELS["cubic"](), tmp_path / "F.fmu", Contents(fmi, (str(native()),), reference=False)),
        tmp_path / "G.fmu",
    )
    with zipfile.ZipFile(unit) as z, zipfile.ZipFile(broken, "w") as out:
        for name in z.namelist():
            text = z.read(name)
            if name == "modelDescription.xml":
                assert text.decode().count(right) == 1
                text = text.decode().replace(right, wrong).encode()
            out.writestr(name, text)
    assert "No errors found." not in said(fmi, broken)
