"""How the C core is compiled: by the system's C compiler, else by zig; run by the wheel's build and by ``python -m stopset.core.build``.

The flags are what makes the results the same bits on every machine: IEEE double precision, no contraction of a product
and a sum into one rounding, no reordering; no function of the platform's mathematical library is called.  Nothing here
imports the rest of stopset: the build of the wheel runs this file by itself.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
SOURCES = HERE / "c"
PROCESSOR = HERE / "processor.c"  # for zig and these targets: its own library would always choose the narrow loops
CLONED = ("linux-x86_64", "windows-x86_64")
FLAGS = ("-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden")
# name in a release -> what zig calls it, wheel tag
TARGETS = {
    "linux-x86_64": ("x86_64-linux-gnu.2.17", "manylinux2014_x86_64.manylinux_2_17_x86_64"),
    "linux-aarch64": ("aarch64-linux-gnu.2.17", "manylinux2014_aarch64.manylinux_2_17_aarch64"),
    "windows-x86_64": ("x86_64-windows-gnu", "win_amd64"),
    "macos-x86_64": ("x86_64-macos.11.0", "macosx_11_0_x86_64"),
    "macos-arm64": ("aarch64-macos.11.0", "macosx_11_0_arm64"),
}


def library_name(target: str = sys.platform) -> str:
    """File name of the library on a platform (of ``sys.platform``, or of `TARGETS`)."""
    return "stopset_core" + (
        ".dll" if target.startswith("win") else ".dylib" if target.startswith(("darwin", "macos")) else ".so"
    )


def c_files() -> list[Path]:
    """All C sources, in the order they are compiled."""
    return sorted(SOURCES.rglob("*.c"))


def sources_hash() -> str:
    """Of everything that decides the library's bits: sources, headers, flags."""
    h = hashlib.sha256(" ".join(FLAGS).encode())
    for path in sorted(SOURCES.rglob("*.[ch]")):
        h.update(path.name.encode() + b"\0" + path.read_bytes())
    return h.hexdigest()[:16]


def system_compiler() -> list[str] | None:
    """The system's C compiler, if there is one that can link."""
    for name in ("cc", "gcc", "clang"):
        if found := shutil.which(name):
            return [found]
    return None


def compiler() -> list[str]:
    """The C compiler to call; raises `RuntimeError` where there is none."""
    if found := system_compiler():
        return found
    if importlib.util.find_spec("ziglang"):
        return zig()
    raise RuntimeError("no C compiler was found (cc, gcc, clang); expected one, or zig: pip install ziglang, then build again")


def zig() -> list[str]:
    """zig's C compiler, from the package ``ziglang``; without its own checks, which are not for the product."""
    return [sys.executable, "-m", "ziglang", "cc", "-fno-sanitize=all", "-g0"]


def compile_core(out: Path, target: str | None = None) -> Path:
    """Compile the library into the folder ``out``, for this machine or one of `TARGETS`; returns its path."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / library_name(target or sys.platform)
    if target is None:
        command = [*compiler(), *([] if sys.platform == "win32" else ["-fPIC"])]
    else:
        # without symbols: they carry the time of day on Windows, and the same sources are to give the same bytes
        command = [*zig(), "-target", TARGETS[target][0], "-s", *([] if target.startswith("windows") else ["-fPIC"])]
    # a reader never sees half a library; compiled under its own name, which libraries of some platforms carry inside
    half = out / f"half-{os.getpid()}"
    half.mkdir(exist_ok=True)
    stamp = f'-DSTOPSET_SOURCES="{sources_hash()}"'
    files, chosen = ([*c_files(), PROCESSOR], ["-DSTOPSET_PROCESSOR"]) if target in CLONED else (c_files(), [])
    command += [*FLAGS, *chosen, stamp, "-shared", *map(str, files), "-o", path.name]
    try:
        done = subprocess.run(command, cwd=half, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"the C core does not compile with {command[0]}: {done.stderr.strip()[-1500:]}")
        (half / path.name).replace(path)
    finally:
        shutil.rmtree(half, ignore_errors=True)
    return path


def declarations() -> str:
    """The part of the header between its marks, without what only a C compiler understands."""
    text = (SOURCES / "stopset.h").read_text(encoding="utf-8")
    found = re.search(r"/\* cffi begin \*/(.*)/\* cffi end \*/", text, re.DOTALL)
    assert found
    return re.sub(r"\bSTOPSET_API\b", "", found.group(1))


def write_binding(out: Path) -> Path:
    """``_binding.py``: the header's types for cffi, read once here so that nothing is parsed at start."""
    from cffi import FFI

    ffi = FFI()
    ffi.cdef(declarations())
    ffi.set_source("stopset.core._binding", None)
    path = out / "_binding.py"
    ffi.emit_python_code(str(path))
    return path


def build(target: str | None = None) -> list[Path]:
    """Library and binding, beside this file."""
    return [compile_core(HERE, target), write_binding(HERE)]


if __name__ == "__main__":
    print(*build(), sep="\n")  # noqa: T201 - a tool of its own
