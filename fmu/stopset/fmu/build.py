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
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from platform import machine

from stopset.errors import OutputError
from stopset.files import cache_folder, write_bytes
from stopset.fmu.sources import CORE
from stopset.progress import Progress


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
# of the core, for zig on the platforms where the core's loops choose their instructions; nothing here could run them on macOS
PROCESSOR = "processor.c"
# units of the core that take as long as a library, for which the compiler makes its own libraries where it has not yet
LINKING = 15
CLONED = ("x86_64-linux", "x86_64-windows")


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


def _objects(
    folder: Path, units: Sequence[str], platform: Platform, flags: Sequence[str], done: Callable[[int], None] = lambda _: None
) -> list[str]:
    """One object for each unit; their names. ``done``: told how many there are."""
    out = [f"{unit.removesuffix('.c')}-{platform.name}.o" for unit in units]
    for k, (unit, name) in enumerate(zip(units, out, strict=True)):
        _run([*compiler(), "cc", "-target", platform.target, *FLAGS, *flags, "-I.", "-c", unit, "-o", name], folder, platform)
        done(k + 1)
    return out


def _compile_core(folder: Path, units: Sequence[str], platform: Platform, done: Callable[[int], None]) -> bytes:
    """What does not depend on the model, as an archive."""
    out = f"core-{platform.name}.a"
    flags = ["-fPIC"] if platform.suffix == ".so" else []
    if platform.name in CLONED:
        units, flags = [*units, PROCESSOR], [*flags, "-DSTOPSET_PROCESSOR"]
    objects = _objects(folder, units, platform, flags, done)
    # appended, as files of two folders have one name; without times and owners
    _run([*compiler(), "ar", "qcsD", out, *objects], folder, platform)
    return (folder / out).read_bytes()


def _link(folder: Path, units: Sequence[str], platform: Platform, identifier: str, core: bytes) -> bytes:
    """The shared library: the model's own units compiled, with the core."""
    out, given = f"{identifier}-{platform.name}{platform.suffix}", f"core-{platform.name}.a"
    (folder / given).write_bytes(core)
    # names relative to the folder, so that no path of this machine gets into the binary
    if platform.suffix == ".dll":
        _link_windows(folder, units, platform, given, out)
    else:
        start = [*compiler(), "cc", "-target", platform.target, *FLAGS, *LINK, "-I."]
        extra = ["-fPIC", "-lm"] if platform.suffix == ".so" else [f"-Wl,-install_name,@rpath/{identifier}.dylib"]
        _run([*start, *units, given, *extra, "-o", out], folder, platform)
    return (folder / out).read_bytes()


def _link_windows(folder: Path, units: Sequence[str], platform: Platform, core: str, out: str) -> None:
    """Against msvcrt.dll alone: see core/windows.c."""
    objects = [*_objects(folder, units, platform, ()), *_objects(folder, ["windows.c"], platform, ["-fno-builtin"])]
    _run([*compiler(), "dlltool", "-m", "i386:x86-64", "-d", "msvcrt.def", "-l", "msvcrt.a"], folder, platform)
    start = [*compiler(), "cc", "-target", platform.target, *LINK, "-nostdlib", "-Wl,--entry=DllMainCRTStartup"]
    _run([*start, *objects, core, "msvcrt.a", "-o", out], folder, platform)
    code = bytearray((folder / out).read_bytes())
    header = int.from_bytes(code[0x3C:0x40], "little")
    code[header + 8 : header + 12] = bytes(4)  # the time of linking: the same sources give the same bytes
    (folder / out).write_bytes(code)


def _cached(sources: Mapping[str, str], names: Sequence[str], platform: Platform, make: Callable[[], bytes]) -> bytes:
    """What ``make`` compiles of ``sources``, from the user's cache if it was compiled before; ``names``: what else it depends on."""
    cache = cache_folder()
    everything = [version("ziglang"), Path(__file__).read_text(), repr(platform), *names]  # how it is made is written here
    everything += [f"{name}\n{sources[name]}" for name in sorted(sources)]
    place = cache / "fmu" / hashlib.sha256("\0".join(everything).encode()).hexdigest() if cache else None
    if place is not None and place.is_file():
        return place.read_bytes()
    made = make()
    if place is not None:
        place.parent.mkdir(exist_ok=True)
        write_bytes(place, made)
    return made


class _Parts:
    """How much of all platforms is compiled: each unit of the core counts alike, and a library as `LINKING` of them."""

    def __init__(self, units: int, platforms: Sequence[Platform], say: Progress) -> None:
        self._whole, self._say, self._lock = units + LINKING, say, threading.Lock()
        self._done = dict.fromkeys((p.name for p in platforms), 0)
        self(platforms[0], 0)

    def __call__(self, platform: Platform, parts: int) -> None:
        """So many are there of one platform."""
        with self._lock:
            self._done[platform.name] = min(parts, self._whole)
            done, total = sum(self._done.values()), self._whole * len(self._done)
            ready = sum(x == self._whole for x in self._done.values())
            self._say(f"compiling: {done} of {total} parts, {ready} of {len(self._done)} libraries", done / total)


def binaries(
    sources: Mapping[str, str], units: Sequence[str], platforms: Sequence[Platform], identifier: str, say: Progress
) -> dict[str, bytes]:
    """Platform name -> library; two compilers at a time. What was compiled before is taken from the user's cache, the core for every
    model.

    ``say``: told how far it is whenever a part is there.
    """
    if not platforms:
        return {}
    compiler()  # refuses early where there is none
    own = resources.files("stopset.fmu") / "core"
    sources = {**sources, **{name: (own / name).read_text() for name in WINDOWS}}
    sources[PROCESSOR] = (resources.files("stopset.core") / PROCESSOR).read_text()
    core = {name: text for name, text in sources.items() if name.startswith(f"{CORE}/") or name == PROCESSOR}
    shared = [unit for unit in units if unit in core]
    out: dict[str, bytes] = {}
    parts = _Parts(len(shared), platforms, say)
    with tempfile.TemporaryDirectory(prefix="stopset-fmu-") as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(text)

        def make(platform: Platform) -> bytes:
            made = _cached(
                core, ["core"], platform, lambda: _compile_core(folder, shared, platform, lambda k: parts(platform, k))
            )
            parts(platform, len(shared))
            rest = [unit for unit in units if unit not in core]
            library = _cached(sources, [identifier], platform, lambda: _link(folder, rest, platform, identifier, made))
            parts(platform, len(shared) + LINKING)
            return library

        with ThreadPoolExecutor(2) as pool:
            for platform, library in zip(platforms, pool.map(make, platforms), strict=True):
                out[platform.name] = library
    return out


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
