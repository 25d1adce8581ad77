"""The core as a library: what it is made from, what it leans on, what a call costs, what happens without a compiler."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import timeit
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from conftest import current
from stopset.core import build
from stopset.core.library import ffi, lib, view

ASKS_THE_PROCESSOR = b"\x0f\x01\xd0"  # the instruction xgetbv, which nothing else in the core has

ROOT = Path(__file__).parents[1]


def test_the_library_is_made_from_the_sources_as_they_are() -> None:
    assert ffi.string(lib.stopset_sources()).decode() == build.sources_hash()
    assert current()


@pytest.mark.skipif(sys.platform != "linux" or shutil.which("nm") is None, reason="reads the symbols of an ELF file with nm")
def test_it_needs_nothing_of_the_platforms_mathematics_and_never_allocates() -> None:
    done = subprocess.run(
        ["nm", "-D", "--undefined-only", build.HERE / build.library_name()], capture_output=True, text=True, check=True
    )
    needed = {line.split()[-1].split("@")[0] for line in done.stdout.splitlines()}
    assert needed <= {
        "memcmp",
        "memcpy",
        "memset",
        "memmove",
        "_ITM_deregisterTMCloneTable",
        "_ITM_registerTMCloneTable",
        "__cxa_finalize",
        "__gmon_start__",
        "__stack_chk_fail",
    }


def test_flags_keep_the_order_of_operations() -> None:
    assert "-ffp-contract=off" in build.FLAGS
    assert not [f for f in build.FLAGS if "fast" in f or "march" in f or "unsafe" in f or "associative" in f]


def test_a_call_costs_no_more_than_three_of_numpys_smallest() -> None:
    """With the pointers at hand, as the monitor has them: less than a microsecond where numpy's takes half of one. Both in one run, the best of
    several, for machines differ and may be busy."""
    from stopset.offline.description import load_robot
    from stopset.robot.rigid import arm_struct

    arm = load_robot("lwa4p")
    struct = arm_struct(arm.chain, arm.pi)
    none = view(np.zeros(0))
    call, x = lib.stopset_gravity_torques, np.zeros(4)

    def cost(one: Callable[[], object]) -> float:
        return min(timeit.repeat(one, number=2000, repeat=20))

    assert cost(lambda: call(struct, 0, none, none)) < 3.0 * cost(lambda: np.add(x, x, x))


@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="ziglang is not installed")
@pytest.mark.skipif(platform.machine() != "x86_64" or sys.platform != "linux", reason="runs what it compiles for linux-x86_64")
def test_zig_makes_the_same_bits_as_the_systems_compiler(tmp_path: Path) -> None:
    """Two compilers, one result: as many numbers as a regressor and a mass matrix have, all equal."""
    from stopset.offline.description import load_robot
    from stopset.robot.rigid import arm_struct, mass_matrices, regressors

    theirs = ffi.dlopen(str(build.compile_core(tmp_path, "linux-x86_64")))
    assert ffi.string(theirs.stopset_sources()).decode() == build.sources_hash()
    arm = load_robot("lwa4p")
    q, dq, ddq = np.random.default_rng(5).normal(size=(3, 50, arm.n))
    Y, M = np.empty((50, arm.n, 10 * arm.n)), np.empty((50, arm.n, arm.n))
    theirs.stopset_regressors(arm_struct(arm.chain, arm.pi), 50, view(q), view(dq), view(ddq), view(Y))
    theirs.stopset_mass_matrices(arm_struct(arm.chain, arm.pi), 50, view(q), view(M))
    assert np.array_equal(Y, regressors(arm.chain, q, dq, ddq)) and np.array_equal(M, mass_matrices(arm.chain, arm.pi, q))
    made = (tmp_path / build.library_name()).read_bytes()
    assert ASKS_THE_PROCESSOR in made  # else it would run the narrow loops wherever it is installed


@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="ziglang is not installed")
@pytest.mark.skipif(not Path("/proc/cpuinfo").exists() or platform.machine() != "x86_64", reason="needs x86-64 Linux")
def test_zigs_clones_are_chosen_by_what_the_processor_has(tmp_path: Path) -> None:
    """A clone each for four numbers at a time and for two, and the one that the loader takes."""
    (tmp_path / "main.c").write_text(
        '__attribute__((target_clones("avx2", "default"))) int twice(int x) { return 2 * x; }\n'
        "extern struct { unsigned vendor, type, subtype, features[1]; } __cpu_model;\n"
        "int main(void) { return twice(__cpu_model.features[0] >> 10 & 1); }\n"
    )
    target, program = build.TARGETS["linux-x86_64"][0], str(tmp_path / "main")
    subprocess.run([*build.zig(), "-target", target, str(tmp_path / "main.c"), str(build.PROCESSOR), "-o", program], check=True)
    has = "avx2" in Path("/proc/cpuinfo").read_text().split("flags", 1)[1].split("\n", 1)[0].split()
    assert subprocess.run([program], check=False).returncode == 2 * has


def test_without_any_compiler_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build.shutil, "which", lambda name: None)
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RuntimeError, match="pip install ziglang"):
        build.compiler()


def test_the_wheels_build_asks_for_zig_only_where_it_is_needed() -> None:
    """The hook itself, in a process whose PATH holds a compiler or none."""
    pytest.importorskip("hatchling")
    code = (
        "import importlib.util as u; s = u.spec_from_file_location('h', 'hatch_build.py'); m = u.module_from_spec(s);"
        "s.loader.exec_module(m); print(m.CustomBuildHook.dependencies(None))"
    )
    for path, target, want in (
        ("/usr/bin:/bin", "", "[]"),
        ("/nowhere", "", "ziglang"),
        ("/usr/bin:/bin", "macos-arm64", "ziglang"),
    ):
        if want == "[]" and build.system_compiler() is None:
            continue
        env = {**os.environ, "PATH": path, "STOPSET_TARGET": target}
        done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=env, capture_output=True, text=True, check=True)
        assert want in done.stdout
