"""From C to shared libraries for five platforms, with one compiler that comes as a wheel.

The compiler is zig's clang from the package ``ziglang`` on every machine, also where another compiler is installed: the
same sources then give the same bytes everywhere, and a fresh machine without a compiler can export too.
"""

from __future__ import annotations

import importlib.util
import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from stopset.errors import OutputError


@dataclass(frozen=True, slots=True)
class Platform:
    """A platform tuple of FMI 3; ``target``: the compiler's name; ``fmi2``: the folder FMI 2 gives it."""

    name: str
    target: str
    suffix: str
    fmi2: str


# glibc 2.17 of 2012, macOS 11: binaries run on machines older than the one that exports
PLATFORMS = {
    p.name: p
    for p in (
        Platform("x86_64-linux", "x86_64-linux-gnu.2.17", ".so", "linux64"),
        Platform("aarch64-linux", "aarch64-linux-gnu.2.17", ".so", "aarch64-linux"),
        Platform("x86_64-windows", "x86_64-windows-gnu", ".dll", "win64"),
        Platform("x86_64-darwin", "x86_64-macos.11.0", ".dylib", "darwin64"),
        Platform("aarch64-darwin", "aarch64-macos.11.0", ".dylib", "darwin64"),
    )
}

def chosen(platforms: Sequence[str] | None) -> list[Platform]:
    """Platforms by name, all if none is named; raises `OutputError` for an unknown one."""
    names = list(dict.fromkeys(platforms)) if platforms else list(PLATFORMS)
    unknown = [p for p in names if p not in PLATFORMS]
    if unknown:
        raise OutputError(f"platform {', '.join(unknown)} is not known; expected {', '.join(PLATFORMS)}")
    return [PLATFORMS[p] for p in names]


# no contraction to fused multiply-add: every platform rounds alike, and like Python
FLAGS = (
    "-std=c99", "-O2", "-g0", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden",
    "-shared", "-s",
)  # fmt: skip


def compiler() -> list[str]:
    """The command of the C compiler; raises `OutputError` where the extra ``fmu`` is not installed."""
    if importlib.util.find_spec("ziglang") is None:
        raise OutputError("the C compiler (package ziglang) is not installed; install stopset[fmu] and export again")
    return [sys.executable, "-m", "ziglang", "cc"]


def _environment(scratch: Path) -> dict[str, str]:
    """The compiler's cache lies in the user's cache folder, or in the scratch folder where that cannot be written."""
    out = dict(os.environ)
    if "ZIG_GLOBAL_CACHE_DIR" not in out:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stopset" / "zig"
        try:
            cache.mkdir(parents=True, exist_ok=True)
            writable = os.access(cache, os.W_OK)
        except OSError:
            writable = False
        out["ZIG_GLOBAL_CACHE_DIR"] = str(cache if writable else scratch / "cache")
    out.setdefault("ZIG_LOCAL_CACHE_DIR", out["ZIG_GLOBAL_CACHE_DIR"])
    return out


def compile_library(folder: Path, units: Sequence[str], platform: Platform, identifier: str) -> bytes:
    """The shared library of the C files ``units`` in ``folder`` for one platform."""
    out = folder / f"{identifier}-{platform.name}{platform.suffix}"
    # names relative to the folder, so that no path of this machine gets into the binary
    extra = ["-fPIC", "-lm"] if platform.suffix == ".so" else []
    if platform.suffix == ".dylib":
        extra = [f"-Wl,-install_name,@rpath/{identifier}.dylib"]
    command = [*compiler(), "-target", platform.target, *FLAGS, "-I.", *units, *extra, "-o", out.name]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=_environment(folder), check=False)
    if done.returncode or not out.exists():
        first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip()[-300:])
        raise OutputError(
            f"compiling the FMU for {platform.name} failed ({first.strip() or f'exit code {done.returncode}'}); "
            f"leave the platform out with --platform, or check that the disk is not full"
        )
    return out.read_bytes()


def binaries(
    sources: Mapping[str, str], units: Sequence[str], platforms: Sequence[Platform], identifier: str
) -> dict[str, bytes]:
    """Platform name -> library; two compilers at a time."""
    with tempfile.TemporaryDirectory(prefix="stopset-fmu-") as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).write_text(text)
        with ThreadPoolExecutor(2) as pool:
            made = pool.map(lambda p: compile_library(folder, units, p, identifier), platforms)
            return {p.name: library for p, library in zip(platforms, made, strict=True)}


def universal(slices: Mapping[str, bytes]) -> bytes:
    """One macOS library of both processors (FMI 2 has one folder for them); a single slice is returned as it is."""
    cpu = {"x86_64-darwin": (0x01000007, 3), "aarch64-darwin": (0x0100000C, 0)}
    if len(slices) == 1:
        return next(iter(slices.values()))
    align = 14  # 16 KiB pages of the arm64 kernel
    at, header, body = 1 << align, [], b""
    for name in sorted(slices):
        code = slices[name]
        header.append(struct.pack(">5I", *cpu[name], at + len(body), len(code), align))
        body += code + b"\0" * (-len(code) % (1 << align))
    head = struct.pack(">2I", 0xCAFEBABE, len(slices)) + b"".join(header)
    return head.ljust(at, b"\0") + body
