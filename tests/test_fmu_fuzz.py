"""The FMU called in any order with any values, under the address, undefined-behaviour and leak sanitizers."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from stopset.artifact import Model
from stopset.fmu import Contents, archive
from stopset.fmu.variables import KINDS, variables
from stopset.offline.abstraction import build
from test_fmu import EFFECTS, friction
from test_fmu_stops import braked, braking


def whole() -> Model:
    """Model 3 of two joints, with a law of the pose."""
    model = braked(8.0, 2, effects=[friction("spring", "axis_2", k=2.0, c=0.1)])
    return replace(model, abstraction=build(3, 2, model.robot, model.rotor, model.abstraction.viscous))


CALLS = 100  # runs of 60 calls each


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("linear", braking()),
        ("effects", braked(8.0, 3, effort="motor_torque", effects=(*EFFECTS[:2], friction("hysteresis", "axis_1", F_h=2.0, delta=0.01)))),
        ("cubic", braked(8.0, 2, cubic=0.2)),
        ("model 3", whole()),
    ],
)  # fmt: skip
def test_no_order_of_calls_and_no_value_breaks_it(tmp_path: Path, name: str, model: Model) -> None:
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("gcc is not installed")
    pytest.importorskip("fmpy")
    (tmp_path / "u.fmu").write_bytes(archive(model, Contents(3, source_only=True, reference=False)))
    with zipfile.ZipFile(tmp_path / "u.fmu") as z:
        z.extractall(tmp_path)
    token = (tmp_path / "modelDescription.xml").read_text().split('instantiationToken="')[1].split('"')[0]
    units = sorted(str(p) for p in (tmp_path / "sources").rglob("*.c"))
    sanitize = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer"]
    command = [gcc, "-std=c11", "-O1", "-g", "-ffp-contract=off", *sanitize, "-I", str(tmp_path / "sources")]
    source = str(Path(__file__).with_name("fmu_fuzz.c"))
    subprocess.run([*command, source, *units, "-lm", "-o", str(tmp_path / "fuzz")], check=True, timeout=600)
    v = variables(model)
    sizes = [len(v.of(kind)) for kind in KINDS]
    first = [v.reference(f"{stem}_axis_1") for stem in ("q_lo", "q_hi")]
    places = [*sizes, *first, model.n, v.reference("stop_time_axis_1"), v.reference("tcp_stop_speed"), v.reference("covered")]
    places += [v.reference("stop_certified"), v.reference("measured"), len(v.arrays)]
    arguments = [token, "1", str(CALLS), *map(str, places)]
    done = subprocess.run([str(tmp_path / "fuzz"), *arguments], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    words = done.stdout.split()
    assert words[0] == "ok"
    errors, covered, certified = int(words[1]), int(words[3]), int(words[6])
    assert errors > 100 and covered > 100 and certified > 100, f"every promise was looked at often: {words}"
