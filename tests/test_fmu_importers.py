"""Other people's importers, other processors, other systems; and what the command refuses."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import re
import shutil
import struct
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fmu_models import arm_model
from fmu_unit import unit
from stopset.artifact import Model, save_model
from stopset.artifact.abstraction import Polynomial
from stopset.cli.main import main
from stopset.effects import get
from stopset.errors import EffectError, NotCovered, OutputError
from stopset.fmu import PLATFORMS, Contents, archive, build, export
from stopset.fmu.check import check_fmu
from stopset.fmu.description import base_unit, build_description
from stopset.fmu.sources import fmi_headers
from stopset.fmu.variables import variables
from stopset.reach.predict import predict
from test_fmu import AGREE, DT, EFFECTS, HERE, friction
from test_fmu_stops import braked

pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = pytest.mark.skipif(HERE is None, reason="no FMU binaries for this platform")
INCLUDE = fmi_headers()
STEPS = 1000
ASKS_THE_PROCESSOR = b"\x0f\x01\xd0"  # the instruction xgetbv, which nothing else in a unit has
NAN = "7ff8000000000000"  # of fmu_player.c


@pytest.fixture(scope="module")
def everywhere(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """One model for all platforms, FMI 2 and 3 (the libraries are the same and compiled once)."""
    folder = tmp_path_factory.mktemp("all")
    return {fmi: export(arm_model(), folder / f"F{fmi}.fmu", Contents(fmi)) for fmi in (3, 2)}


def torque(k: int, n: int) -> NDArray[np.float64]:
    """The torque of step ``k`` in tests/fmu_importer.c."""
    return 0.1 * (np.arange(n) + 1) * ((k // 10) % 7 - 3)


def final_positions() -> NDArray[np.float64]:
    model = arm_model()
    u = np.array([torque(k, model.n) for k in range(STEPS + 1)])
    return predict(model.abstraction, DT, np.zeros(2 * model.n), u)[-1, : model.n]


RUNNERS = {
    "x86_64-linux": [],
    "aarch64-linux": ["qemu-aarch64-static", "-L", "/usr/aarch64-linux-gnu"],
    "x86_64-windows": ["/usr/lib/wine/wine64"],
}


def needed(runner: list[str]) -> list[str]:
    if runner and not shutil.which(runner[0]):
        pytest.skip(f"{runner[0]} is not installed")
    return runner


def runs(platform: str) -> list[str]:
    """What programs of a platform are called with here; skips where there is nothing."""
    if "windows" in platform and not os.environ.get("STOPSET_TEST_WINDOWS"):
        pytest.skip("building a Windows program takes minutes the first time; set STOPSET_TEST_WINDOWS=1")
    return needed([] if platform == HERE else RUNNERS[platform])


def compiled(source: str, platform: str, folder: Path) -> Path:
    """A C program of this folder for a platform."""
    program = folder / f"{Path(source).stem}-{platform}.exe"
    libraries = [] if "windows" in platform else ["-lm", "-ldl"]
    flags = ["-target", PLATFORMS[platform].target, "-O1", "-g", "-Wall", "-Wextra", "-Werror", "-I", str(INCLUDE)]
    given = str(Path(__file__).with_name(source))
    subprocess.run([*build.compiler(), "cc", *flags, given, *libraries, "-o", str(program)], check=True)
    return program


@pytest.mark.parametrize("platform", [HERE, "valgrind", *(p for p in RUNNERS if p != HERE)])
def test_a_c_program_uses_the_library(everywhere: dict[int, Path], tmp_path: Path, platform: str) -> None:
    """Instances, states, reset, serialisation, sentences, and the same end as in Python, without Python in the process."""
    memory = platform == "valgrind"
    name = str(HERE) if memory else platform
    runner = needed(["valgrind", "-q", "--leak-check=full", "--error-exitcode=9"]) if memory else runs(name)
    program = compiled("fmu_importer.c", name, tmp_path)
    with zipfile.ZipFile(everywhere[3]) as z:
        library = z.extract(f"binaries/{name}/stopset_test_arm{PLATFORMS[name].suffix}", tmp_path)
        xml = z.read("modelDescription.xml").decode()
    token = xml.split('instantiationToken="')[1].split('"')[0]
    v = variables(arm_model())
    arguments = [token, str(STEPS), str(DT), "6", str(v.reference("tau_axis_1")), str(v.reference("q_axis_1"))]
    environment = {**os.environ, "WINEDEBUG": "-all"}
    done = subprocess.run(
        [*runner, str(program), library, *arguments], capture_output=True, text=True, env=environment, timeout=600, check=False
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    *numbers, ok = done.stdout.split()
    assert ok == "ok"
    assert np.abs(np.array(numbers, float) - final_positions()).max() < AGREE


def played(unit: Path, platform: str, script: str, folder: Path) -> list[str]:
    """The numbers that the library of a platform says to the calls of a script (fmu_player.c), as bits."""
    runner, program = runs(platform), compiled("fmu_player.c", platform, folder)
    with zipfile.ZipFile(unit) as z:
        library = z.extract(next(n for n in z.namelist() if n.startswith(f"binaries/{platform}/")), folder)
        token = z.read("modelDescription.xml").decode().split('instantiationToken="')[1].split('"')[0]
    done = subprocess.run(
        [*runner, str(program), library, token], input=script, capture_output=True, text=True, timeout=600, check=False,
        env={**os.environ, "WINEDEBUG": "-all"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-500:] + done.stderr[-500:]
    return done.stdout.split()


def calls(model: Model, states: int) -> str:
    """Bounds of a STOP 0 at measured states, then as many steps of the nominal motion with their bounds."""
    v, rng, lines = variables(model), np.random.default_rng(5), []

    def put(**given: NDArray[np.float64]) -> None:
        for stem, x in given.items():
            lines.extend(f"r {v.reference(f'{stem}_{j}')} {y!r}" for j, y in zip(model.joints, x.tolist(), strict=True))

    def ask(*stems: str) -> None:
        lines.extend(f"get {v.reference(f'{stem}_{model.joints[0]}')} {model.n}" for stem in stems)

    lines.append(f"b {v.reference('measured')} 1")
    for _ in range(states):
        put(q_measured=0.8 * rng.uniform(-1, 1, model.n), dq_measured=0.8 * rng.uniform(-1, 1, model.n))
        ask("stop_time", "stop_forward", "stop_back", "stop_angle")
    lines.append(f"b {v.reference('measured')} 0")
    for k in range(states):
        put(tau=20.0 * rng.normal(size=model.n))
        lines.append(f"step {k * DT!r} {DT!r}")
        ask("q", "dq", "q_lo", "dq_hi")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("platform", [p for p in RUNNERS if p != HERE])
def test_every_platform_says_the_same_bits(tmp_path: Path, platform: str) -> None:
    """Motion, its bounds and stop bounds of an arm with effects of load, pose and speed, by other instructions or fewer at a time."""
    model = braked(8.0, 3, effort="motor_torque", effects=EFFECTS[:6])
    runs(platform)
    unit, script = export(model, tmp_path / "F.fmu", Contents(3, (str(HERE), platform))), calls(model, 12)
    here = played(unit, str(HERE), script, tmp_path)
    assert len(here) == 12 * 8 * 3 and NAN not in here and len(set(here)) > 200
    assert played(unit, platform, script, tmp_path) == here


def test_every_platform_gets_its_kind_of_binary(everywhere: dict[int, Path]) -> None:
    elf, pe, macho, fat = b"\x7fELF", b"MZ", struct.pack("<I", 0xFEEDFACF), struct.pack(">I", 0xCAFEBABE)
    machine = {"x86_64-linux": 62, "aarch64-linux": 183}
    kinds = {"x86_64-linux": elf, "aarch64-linux": elf, "x86_64-windows": pe, "x86_64-darwin": macho, "aarch64-darwin": macho}
    with zipfile.ZipFile(everywhere[3]) as z:
        for name, kind in kinds.items():
            code = z.read(f"binaries/{name}/stopset_test_arm{PLATFORMS[name].suffix}")
            assert code.startswith(kind)
            assert b"fmi3DoStep" in code
            assert b"fmi2DoStep" in code
            assert str(Path.home()).encode() not in code
            assert (ASKS_THE_PROCESSOR in code) == (name in build.CLONED), "else it would always run the narrow loops"
            if name in machine:
                assert int.from_bytes(code[18:20], "little") == machine[name]
    with zipfile.ZipFile(everywhere[2]) as z:
        folders = {p.split("/")[1] for p in z.namelist() if p.startswith("binaries/")}
        assert folders == {"linux64", "aarch64-linux", "win64", "darwin64"}
        both = z.read("binaries/darwin64/stopset_test_arm.dylib")
    assert both.startswith(fat)
    for k in range(2):  # each processor's part lies on a page of its own and is a whole library
        _, _, at, size, align = struct.unpack(">5I", both[8 + 20 * k : 28 + 20 * k])
        assert at % (1 << align) == 0
        assert both[at : at + 4] == macho
        assert at + size <= len(both)


def test_fmuloader_runs_fmi_3(everywhere: dict[int, Path]) -> None:
    fmi3 = pytest.importorskip("fmuloader.fmi3")
    v = variables(arm_model())
    xml = zipfile.ZipFile(everywhere[3]).read("modelDescription.xml").decode()
    slave = fmi3.Fmi3Slave(everywhere[3], model_identifier="stopset_test_arm")
    slave.instantiate_co_simulation("a", instantiation_token=xml.split('instantiationToken="')[1].split('"')[0])
    slave.enter_initialization_mode(0.0)
    slave.exit_initialization_mode()
    tau, q = ([v.reference(f"{s}_axis_{j}") for j in range(1, 7)] for s in ("tau", "q"))
    for k in range(STEPS):
        slave.set_float64(tau, torque(k, 6).tolist())
        slave.do_step(k * DT, DT)
    assert np.abs(np.array(slave.get_float64(q)) - final_positions()).max() < AGREE
    slave.terminate()
    slave.free_instance()


def test_libcosimpy_runs_fmi_2(everywhere: dict[int, Path]) -> None:
    pytest.importorskip("libcosimpy")
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    v = variables(arm_model())
    execution = CosimExecution.from_step_size(round(DT * 1e9))
    index = execution.add_local_slave(CosimLocalSlave(str(everywhere[2]), "arm"))
    observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
    execution.add_observer(observer)
    execution.add_manipulator(manipulator)
    tau, q = ([v.reference(f"{s}_axis_{j}") for j in range(1, 7)] for s in ("tau", "q"))
    for k in range(STEPS):
        manipulator.slave_real_values(index, tau, torque(k, 6).tolist())
        execution.step()
    assert np.abs(np.array(observer.last_real_values(index, q)) - final_positions()).max() < AGREE


@pytest.mark.parametrize("fmi", [2, 3])
def test_ecos_runs_both_bit_for_bit_as_fmpy(everywhere: dict[int, Path], fmi: int) -> None:
    tbb = next(Path(sys.prefix).glob("lib/libtbb.so.12"), None)
    if importlib.util.find_spec("ecospy") is None or tbb is None:
        pytest.skip("ecospy or its library tbb is not installed")
    ctypes.CDLL(str(tbb), mode=ctypes.RTLD_GLOBAL)
    from ecospy import EcosSimulation, EcosSimulationStructure

    joints = [f"axis_{j}" for j in range(1, 7)]
    with EcosSimulationStructure() as structure:
        structure.add_model("arm", everywhere[fmi])
        with EcosSimulation(structure=structure, step_size=DT) as simulation:
            simulation.init()
            simulation.set_real("arm::tau_axis_1", 3.0)
            simulation.step(200)
            got = [simulation.get_real(f"arm::q_{j}") for j in joints]
    with unit(everywhere[3]) as u:
        u.begin()
        u.set({"tau_axis_1": 3.0})
        for _ in range(200):
            u.step(DT)
        want = u.joints("q", joints)
    assert want[0] != 0.0 and got == want.tolist()


@pytest.mark.parametrize("fmi", [2, 3])
def test_sources_alone_become_the_same_unit_by_another_compiler(tmp_path: Path, fmi: int) -> None:
    """Built as the unit's own description says, and then it is what it was where it was exported, stop bounds to the last bit."""
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("gcc is not installed")
    plain, built, folder = tmp_path / "plain.fmu", tmp_path / "built.fmu", tmp_path / "sources"
    export(braked(8.0, 3), plain, Contents(fmi, source_only=True))
    with zipfile.ZipFile(plain) as z:
        names = z.namelist()
        z.extractall(tmp_path, [p for p in names if p.startswith("sources/")])
        built_as = z.read("sources/buildDescription.xml").decode()
        xml = built_as if fmi == 3 else z.read("modelDescription.xml").decode()
    assert not any(p.startswith("binaries/") for p in names)
    units = dict.fromkeys(re.findall(r'<(?:Source)?File name="([^"]+)"', xml))
    options = re.findall(r'compilerOptions="([^"]+)"', built_as)
    command = [gcc, "-shared", "-fPIC", "-O2", *options[0].split(), *units, "-lm", "-o", "unit.so"]
    subprocess.run(command, cwd=folder, check=True, timeout=600)
    place = "x86_64-linux" if fmi == 3 else "linux64"
    with zipfile.ZipFile(plain) as old, zipfile.ZipFile(built, "w") as new:
        for name in names:
            new.writestr(name, old.read(name))
        new.write(folder / "unit.so", f"binaries/{place}/stopset_test_arm.so")
    checked = check_fmu(built)
    assert checked.good and checked.stops == checked.equal == 12


@pytest.mark.slow
def test_fmpy_s_own_project_of_the_sources_becomes_the_same_unit(tmp_path: Path) -> None:
    """Of CMake; its target is the model's name, which so must be the identifier."""
    from fmpy.util import create_cmake_project

    if shutil.which("cmake") is None or shutil.which("cc") is None:
        pytest.skip("cmake or a C compiler is not installed")
    plain, project = export(braked(8.0, 3), tmp_path / "plain.fmu", Contents(3, source_only=True)), tmp_path / "project"
    project.mkdir()
    create_cmake_project(str(plain), str(project))
    for words in (
        ["-S", str(project), "-B", str(tmp_path / "build"), "-DCMAKE_BUILD_TYPE=Release"],
        ["--build", str(tmp_path / "build")],
    ):
        done = subprocess.run(["cmake", *words], capture_output=True, text=True, timeout=600, check=False)
        assert done.returncode == 0, done.stdout[-1000:] + done.stderr[-1000:]
    checked = check_fmu(project / "stopset_test_arm.fmu")
    assert checked.good and checked.stops == checked.equal == 12


def test_compiler_options_say_whose_they_are() -> None:
    """The FMI-VDM rule validCompilerOptions."""
    assert 'compiler="gcc" compilerOptions="-std=c11 -ffp-contract=off"' in build_description("a", ["a.c"])


@pytest.mark.parametrize("warnings", [["-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wno-sign-conversion"]])
def test_the_sources_compile_elsewhere(everywhere: dict[int, Path], tmp_path: Path, warnings: list[str]) -> None:
    """Whoever has another compiler can build the FMU's own sources with it."""
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("gcc is not installed")
    with zipfile.ZipFile(everywhere[3]) as z:
        z.extractall(tmp_path, [p for p in z.namelist() if p.startswith("sources/")])
    units = sorted(str(p.relative_to(tmp_path / "sources")) for p in (tmp_path / "sources").rglob("*.c"))
    command = [gcc, "-std=c11", "-O1", "-shared", "-fPIC", *warnings, *units, "-lm", "-o", "x.so"]
    done = subprocess.run(command, cwd=tmp_path / "sources", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("rad", {"rad": 1}),
        ("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        ("N m s/rad/K", {"kg": 1, "m": 2, "s": -1, "rad": -1, "K": -1}),
        ("rad/s2", {"rad": 1, "s": -2}),
        ("N m/(N m)", {}),
        ("degC", {"K": 1, "offset": 273.15}),
        ("furlong", None),
    ],
)
def test_units_in_base_units(unit: str, expected: dict[str, float] | None) -> None:
    assert base_unit(unit) == expected


def test_what_an_fmu_cannot_carry_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    model = arm_model(3)
    squared = Polynomial(np.eye(12, dtype=np.int64)[[9]] * 2, np.array([1.0]))
    with pytest.raises(NotCovered, match="not a straight line over torque"):
        archive(
            replace(model, abstraction=replace(model.abstraction, kind=3, acceleration=(squared,) * 3)), Contents(3, (str(HERE),))
        )
    late = replace(get("coulomb"), name="late", needs=("dtau",), law=lambda s, _: (s.dtau,))
    monkeypatch.setattr("stopset.fmu.laws.get", lambda name: late if name == "coulomb" else get(name))
    with pytest.raises(EffectError, match=r"coulomb:axis_1 looks at dtau \(.*\), .* without it"):
        archive(replace(model, effects=(friction("coulomb", "axis_1", F_c=1.0),)), Contents(3, (str(HERE),)))
    with pytest.raises(OutputError, match="expected x86_64-linux"):
        archive(model, Contents(3, ("pdp11",)))


def test_the_command_writes_all_or_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "m.model.json"
    save_model(arm_model(2, horizon=0.5), path)
    arguments = ["export-fmu", str(path), "--platform", str(HERE)]
    assert main([*arguments, "--out", str(tmp_path / "F.fmu"), "--json", str(tmp_path / "a.json")]) == 0
    made = {"F.fmu", "a.json", "m.model.json"}
    assert {p.name for p in tmp_path.iterdir()} == made
    bad: list[tuple[list[Any], str]] = [
        ([*arguments, "--out", tmp_path], "is a directory"),
        ([*arguments, "--out", tmp_path / "no" / "F.fmu"], "does not exist"),
        (["export-fmu", tmp_path / "none.json", "--out", tmp_path / "G.fmu"], "no such file"),
        (["export-fmu", path, "--out", tmp_path / "G.fmu", "--platform", "pdp11"], "is not known"),
    ]
    capsys.readouterr()
    for words, sentence in bad:
        assert main([str(w) for w in words]) == 2
        said = capsys.readouterr().err
        assert sentence in said
        assert said.count("\n") == 1
    assert {p.name for p in tmp_path.iterdir()} == made
