"""The FMU called in any order with any values, under the sanitizers and under valgrind."""

from __future__ import annotations

import os
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from stopset.artifact import Model
from stopset.fmu import Contents, archive
from stopset.offline.abstraction import build
from test_fmu import EFFECTS, friction
from test_fmu_stops import braked, braking


def whole() -> Model:
    """Model 3 of two joints, with a law of the pose."""
    model = braked(8.0, 2, effects=[friction("spring", "axis_2", k=2.0, c=0.1)])
    return replace(model, abstraction=build(3, 2, model.robot, model.rotor, model.abstraction.viscous))


LASTING = (*EFFECTS[:2], friction("hysteresis", "axis_1", F_h=2.0, delta=0.01))
MODELS = {
    "linear": braking(),
    "effects": braked(8.0, 3, effort="motor_torque", effects=LASTING),
    "cubic": braked(8.0, 2, cubic=0.2),
    "model 3": whole(),
}
CALLS = 100  # runs of 60 calls each
CALLS_SLOW = 12  # under valgrind, which takes some forty times as long


SOURCE = {2: "fmu_fuzz2.c", 3: "fmu_fuzz.c"}


def fuzzer(folder: Path, model: Model, fmi: int, *options: str) -> list[str]:
    """The command of the unit's own sources with calls in any order, but for seed and number of runs behind the token."""
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("gcc is not installed")
    pytest.importorskip("fmpy")
    (folder / "u.fmu").write_bytes(archive(model, Contents(fmi, source_only=True, reference=False)))
    with zipfile.ZipFile(folder / "u.fmu") as z:
        z.extractall(folder)
    named = "guid" if fmi == 2 else "instantiationToken"
    token = (folder / "modelDescription.xml").read_text().split(f'{named}="')[1].split('"')[0]
    units = sorted(str(p) for p in (folder / "sources").rglob("*.c"))
    command = [gcc, "-std=c11", "-O1", "-g", "-ffp-contract=off", *options, "-I", str(folder / "sources")]
    source = str(Path(__file__).with_name(SOURCE[fmi]))
    subprocess.run([*command, source, *units, "-lm", "-o", str(folder / "fuzz")], check=True, timeout=600)
    return [str(folder / "fuzz"), token]


@pytest.mark.parametrize("fmi", SOURCE)
@pytest.mark.parametrize("name", MODELS)
def test_no_order_of_calls_and_no_value_breaks_it(tmp_path: Path, name: str, fmi: int) -> None:
    """Under the address and undefined-behaviour sanitizers; that of leaks comes with the first."""
    sanitize = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer"]
    command = [*fuzzer(tmp_path, MODELS[name], fmi, *sanitize), "1", str(CALLS)]
    leaks = {**os.environ, "ASAN_OPTIONS": "detect_leaks=1"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, env=leaks)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    words = done.stdout.split()
    assert words[0] == "ok"
    errors, covered, certified = int(words[1]), int(words[3]), int(words[6])
    assert errors > 100 and covered > 100 and certified > 100, f"every promise was looked at often: {words}"


@pytest.mark.slow
@pytest.mark.parametrize("fmi", SOURCE)
@pytest.mark.parametrize("name", MODELS)
def test_valgrind_finds_nothing_and_nothing_is_lost(tmp_path: Path, name: str, fmi: int) -> None:
    """What no sanitizer sees: numbers that were never set, where they decide."""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        pytest.skip("valgrind is not installed")
    command = [valgrind, "-q", "--error-exitcode=9", "--leak-check=full", "--show-leak-kinds=all", "--errors-for-leak-kinds=all"]
    command += [*fuzzer(tmp_path, MODELS[name], fmi), "1", str(CALLS_SLOW)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1200, check=False)
    assert done.returncode == 0 and done.stdout.startswith("ok"), done.stdout[-2000:] + done.stderr[-4000:]
