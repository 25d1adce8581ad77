"""The FMU called in any order with any values, under the sanitizers and under valgrind."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import Model
from stopset.fmu import Contents, archive
from stopset.fmu.stops import bounds_of, stop_refusal
from stopset.offline.abstraction import build
from stopset.reach.stops.compiled import CompiledStops
from stopset.reach.stops.path import Path as StopPath
from stopset.reach.stops.types import Category
from test_fmu import EFFECTS, friction
from test_fmu_catalogue import fitted
from test_fmu_path import posed, rows
from test_fmu_stops import braked, braking


def whole(kind: int) -> Model:
    """Model 2 or 3 of two joints, with a law of the pose."""
    model = braked(8.0, 2, effects=[friction("spring", "axis_2", k=2.0, c=0.1)])
    return replace(model, abstraction=build(kind, 2, model.robot, model.rotor, model.abstraction.viscous))


def from_outside() -> Model:
    """With the effect of the effects folder's README, which the fixture ``own_effect`` installs; no stop is bounded with it."""
    return braked(8.0, 2, effort="motor_torque", effects=[fitted("relaxing_hose"), friction("coulomb", "axis_1", F_c=2.0)])


LASTING = (*EFFECTS[:2], friction("hysteresis", "axis_1", F_h=2.0, delta=0.01))
MODELS: dict[str, Callable[[], Model]] = {  # each for a range of payloads
    "linear": braking,
    "effects": lambda: braked(8.0, 3, effort="motor_torque", effects=LASTING),
    "cubic": lambda: braked(8.0, 2, cubic=0.2),
    "model 2": lambda: whole(2),
    "model 3": lambda: whole(3),
    "from outside": from_outside,
    "with a path": posed,
}
PATHS = {"with a path": StopPath.through(rows(3))}
CALLS = 60  # runs of 60 calls each
CALLS_SLOW = 12  # under valgrind, which takes some forty times as long
SANITIZE = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer"]
VALGRIND = ["valgrind", "-q", "--error-exitcode=9", "--leak-check=full", "--show-leak-kinds=all", "--errors-for-leak-kinds=all"]
SOURCES = ("fmu_fuzz2.c", "fmu_fuzz.c")  # of FMI 2 and 3, which a unit's sources are both of


def compiled(command: list[str], unit: str, sources: Path, kept: Path) -> Path:
    """The object of a unit of ``sources``; one that is the same after the preprocessor, as the core is for all models, is compiled once."""
    whole = [*command, "-E", "-fno-working-directory", unit]  # where it lies is no difference
    text = subprocess.run(whole, cwd=sources, check=True, timeout=600, capture_output=True).stdout
    to = kept / f"{hashlib.sha256(repr(command).encode() + text).hexdigest()}.o"
    if not to.exists():
        own = to.with_suffix(f".{os.getpid()}.o")  # other workers compile, too
        subprocess.run([*command, "-c", unit, "-o", str(own)], cwd=sources, check=True, timeout=600)
        own.replace(to)
    return to


@pytest.fixture(scope="session")
def objects(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of compiled units that all workers share."""
    base = tmp_path_factory.getbasetemp()
    out = (base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base) / "fuzzed_objects"
    out.mkdir(exist_ok=True)
    return out


def fuzzers(folder: Path, objects: Path, model: Model, *options: str, path: StopPath | None = None) -> list[list[str]]:
    """Commands of the unit's own sources with calls in any order, but for seed and number of runs behind the token."""
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("gcc is not installed")
    pytest.importorskip("fmpy")
    (folder / "u.fmu").write_bytes(archive(model, Contents(3, source_only=True, reference=False, path=path)))
    with zipfile.ZipFile(folder / "u.fmu") as z:
        z.extractall(folder)
    token = (folder / "modelDescription.xml").read_text().split('instantiationToken="')[1].split('"')[0]
    sources = folder / "sources"
    command = [gcc, "-std=c11", "-O1", "-g", "-ffp-contract=off", *options, "-I", "."]
    units = [str(compiled(command, str(u.relative_to(sources)), sources, objects)) for u in sorted(sources.rglob("*.c"))]
    out = [str(folder / Path(name).stem) for name in SOURCES]
    for name, to in zip(SOURCES, out, strict=True):
        fuzzer = str(Path(__file__).with_name(name))
        subprocess.run([*command, fuzzer, *units, "-lm", "-o", to], cwd=sources, check=True, timeout=600)
    return [[program, token] for program in out]


CATEGORIES: tuple[Category, ...] = ("0", "1", "1 guaranteed", "2")  # by the unit's numbers


def held_against_python(model: Model, kept: Path) -> tuple[int, int]:
    """How many certified bounds of states that the fuzzer came through are Python's to the last bit, and how many there are."""
    bounds, n, lines = bounds_of(model), model.n, set(kept.read_text().splitlines())
    assert bounds.setting is not None
    equal, cores = 0, {}
    for line in lines:
        category, monitored, *hexadecimal = line.split()
        off_after, *numbers = map(float.fromhex, hexadecimal)
        when = bool(int(monitored)), off_after if off_after >= 0.0 else None
        if when not in cores:
            ramp = None if bounds.ramp is None else replace(bounds.ramp, monitored=when[0], off_after=when[1])
            cores[when] = CompiledStops.of(bounds.setting, ramp)
        q, dq, outputs = np.array(numbers[:n]), np.array(numbers[n : 2 * n]), np.array(numbers[2 * n :])
        want = cores[when].bound(q, dq, CATEGORIES[int(category)])
        if want is not None:
            angle = np.maximum(want.forward, want.back)
            equal += np.array_equal(outputs, np.concatenate([want.time, angle, want.forward, want.back, want.tool]))
    return equal, len(lines)


@pytest.mark.parametrize("name", MODELS)
def test_no_order_of_calls_and_no_value_breaks_it(tmp_path: Path, objects: Path, name: str, own_effect: object) -> None:
    """Under the address and undefined-behaviour sanitizers; that of leaks comes with the first."""
    leaks = {**os.environ, "ASAN_OPTIONS": "detect_leaks=1"}
    model = MODELS[name]()
    for command in fuzzers(tmp_path, objects, model, *SANITIZE, path=PATHS.get(name)):
        done = subprocess.run(
            [*command, "1", str(CALLS), str(tmp_path / "kept")],
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
            env=leaks,
        )
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
        words = done.stdout.split()
        assert words[0] == "ok"
        errors, covered, certified = int(words[1]), int(words[3]), int(words[6])
        assert errors > 100 and covered > 100, f"every promise was looked at often: {words}"
        assert certified == 0 if stop_refusal(model) else certified > 100, words
        if certified:
            equal, bounds = held_against_python(model, tmp_path / "kept")
            assert equal == bounds > 0, f"{equal} of {bounds} certified bounds are Python's"


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_valgrind_finds_nothing_and_nothing_is_lost(tmp_path: Path, objects: Path, name: str, own_effect: object) -> None:
    """What no sanitizer sees: numbers that were never set, where they decide."""
    if shutil.which("valgrind") is None:
        pytest.skip("valgrind is not installed")
    for program in fuzzers(tmp_path, objects, MODELS[name](), path=PATHS.get(name)):
        done = subprocess.run(
            [*VALGRIND, *program, "1", str(CALLS_SLOW)], capture_output=True, text=True, timeout=1200, check=False
        )
        assert done.returncode == 0 and done.stdout.startswith("ok"), done.stdout[-2000:] + done.stderr[-4000:]
