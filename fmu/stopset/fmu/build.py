"""From C to shared libraries for five platforms, with one compiler that comes as a wheel.

The compiler is zig's clang from the package ``ziglang`` on every machine, also where another compiler is installed: the
same sources then give the same bytes everywhere, and a fresh machine without a compiler can export too.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from platform import machine

from stopset.errors import OutputError
from stopset.files import cache_folder, write_bytes


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


def native() -> str | None:
    """The platform this process runs on, if it is one of ours."""
    system = {"linux": "linux", "win32": "windows", "darwin": "darwin"}.get(sys.platform, "")
    processor = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine().lower(), machine().lower())
    name = f"{processor}-{system}"
    return name if name in PLATFORMS else None


def chosen(platforms: Sequence[str] | None) -> list[Platform]:
    """Platforms by name, all if none is named; raises `OutputError` for an unknown one."""
    names = list(dict.fromkeys(platforms)) if platforms else list(PLATFORMS)
    unknown = [p for p in names if p not in PLATFORMS]
    if unknown:
        raise OutputError(f"platform {', '.join(unknown)} is not known; expected {', '.join(PLATFORMS)}")
    return [PLATFORMS[p] for p in names]


# no contraction to fused multiply-add: every platform rounds alike, and like Python
FLAGS = (
    "-std=c11", "-O3", "-g0", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden",
)  # fmt: skip
LINK = ("-shared", "-s")
WINDOWS = ("windows.c", "msvcrt.def")


def compiler() -> list[str]:
    """The compiler's command; raises `OutputError` where the extra ``fmu`` is not installed."""
    if importlib.util.find_spec("ziglang") is None:
        raise OutputError("the C compiler (package ziglang) is not installed; install stopset[fmu] and export again")
    return [sys.executable, "-m", "ziglang"]


def _environment(scratch: Path) -> dict[str, str]:
    out = dict(os.environ)
    out.setdefault("ZIG_GLOBAL_CACHE_DIR", str((cache_folder() or scratch) / "zig"))
    out.setdefault("ZIG_LOCAL_CACHE_DIR", out["ZIG_GLOBAL_CACHE_DIR"])
    return out


def _run(arguments: Sequence[str], folder: Path, platform: Platform) -> None:
    done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, env=_environment(folder), check=False)
    if done.returncode:
        first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip()[-300:])
        raise OutputError(
            f"compiling the FMU for {platform.name} failed ({first.strip() or f'exit code {done.returncode}'}); "
            f"leave the platform out with --platform, or check that the disk is not full"
        )


def compile_library(folder: Path, units: Sequence[str], platform: Platform, identifier: str) -> bytes:
    """The shared library of the C files ``units`` in ``folder`` for one platform."""
    out = f"{identifier}-{platform.name}{platform.suffix}"
    start = [*compiler(), "cc", "-target", platform.target]
    # names relative to the folder, so that no path of this machine gets into the binary
    if platform.suffix == ".dll":
        _link_windows(folder, units, platform, start, out)
    else:
        extra = ["-fPIC", "-lm"] if platform.suffix == ".so" else [f"-Wl,-install_name,@rpath/{identifier}.dylib"]
        _run([*start, *FLAGS, *LINK, "-I.", *units, *extra, "-o", out], folder, platform)
    return (folder / out).read_bytes()


def _link_windows(folder: Path, units: Sequence[str], platform: Platform, start: Sequence[str], out: str) -> None:
    """Against msvcrt.dll alone: see core/windows.c."""
    objects = []
    for unit in (*units, "windows.c"):
        plain = ["-fno-builtin"] if unit == "windows.c" else []
        objects.append(unit.removesuffix(".c") + ".obj")
        _run([*start, *FLAGS, *plain, "-I.", "-c", unit, "-o", objects[-1]], folder, platform)
    _run([*compiler(), "dlltool", "-m", "i386:x86-64", "-d", "msvcrt.def", "-l", "msvcrt.a"], folder, platform)
    entry = "-Wl,--entry=DllMainCRTStartup"
    _run([*start, *LINK, "-nostdlib", entry, *objects, "msvcrt.a", "-o", out], folder, platform)
    code = bytearray((folder / out).read_bytes())
    header = int.from_bytes(code[0x3C:0x40], "little")
    code[header + 8 : header + 12] = bytes(4)  # the time of linking: the same sources give the same bytes
    (folder / out).write_bytes(code)


def _key(sources: Mapping[str, str], platform: Platform, identifier: str) -> str:
    """Hash of everything a library depends on."""
    everything = [version("ziglang"), identifier, repr(platform), repr(FLAGS), repr(LINK)]
    everything += [f"{name}\n{sources[name]}" for name in sorted(sources)]
    return hashlib.sha256("\0".join(everything).encode()).hexdigest()


def binaries(
    sources: Mapping[str, str], units: Sequence[str], platforms: Sequence[Platform], identifier: str,
    say: Callable[[str], None],
) -> dict[str, bytes]:  # fmt: skip
    """Platform name -> library; two compilers at a time. What was compiled before is taken from the user's cache.

    ``say``: told of each library when it is there.
    """
    if not platforms:
        return {}
    compiler()  # refuses early where there is none
    core = resources.files("stopset.fmu") / "core"
    sources = {**sources, **{name: (core / name).read_text() for name in WINDOWS}}
    cache = cache_folder()
    out: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory(prefix="stopset-fmu-") as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(text)

        def make(platform: Platform) -> bytes:
            place = cache / "fmu" / _key(sources, platform, identifier) if cache else None
            if place is not None and place.is_file():
                return place.read_bytes()
            library = compile_library(folder, units, platform, identifier)
            if place is not None:
                place.parent.mkdir(exist_ok=True)
                write_bytes(place, library)
            return library

        start = time.monotonic()
        with ThreadPoolExecutor(2) as pool:
            jobs = {pool.submit(make, platform): platform for platform in platforms}
            for count, job in enumerate(as_completed(jobs), start=1):
                out[jobs[job].name] = job.result()
                say(f"{count} of {len(jobs)} libraries after {time.monotonic() - start:.0f} s: {jobs[job].name}")
    return {platform.name: out[platform.name] for platform in platforms}


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
