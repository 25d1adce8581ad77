"""The C keeps house: every function says what goes in and out, every file what it rests on, and nothing is kept between two calls."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from stopset.core import build
from stopset.core.library import lib

FMU = Path(__file__).parents[1] / "fmu" / "stopset" / "fmu" / "core"
# what no paper, lemma or law is behind: the face of a standard, tables, and how one file calls the next
PLUMBING = {
    "sources.c", "arrays.c", "core.c", "fmi.c", "fmi2.c", "fmi3.c", "prepare.c", "ramp.c", "sample.c", "stops.c", "windows.c",
    "nonlinear.c",
}  # fmt: skip
# of the compiler's own libraries
FOREIGN = re.compile(r"__\w+|completed\.\d+|_DYNAMIC|_GLOBAL_OFFSET_TABLE_")
NUMBERS = r"(?:double|int8_t|uint8_t|int32_t|int64_t|uint32_t) \*"


def code_of(text: str) -> str:
    """C without comments and strings; lines stay."""
    return re.sub(r'/\*.*?\*/|"(?:\\.|[^"\\\n])*"', lambda m: re.sub(r"[^\n]", " ", m.group()), text, flags=re.DOTALL)


def explained(header: str) -> Iterator[tuple[str, str, str]]:
    """(name, what it takes and gives, the comment above it or above the group it stands in) of every exported function."""
    comment = ""
    for part in re.finditer(
        r"/\*.*?\*/|STOPSET_API ([^;()]*?)(stopset_\w+)\(([^;]*)\);|\n\s*\n|^\}", header, re.DOTALL | re.MULTILINE
    ):
        if part.group().startswith("/*"):
            comment = "" if part.group().startswith("/* ----") else part.group()
        elif part.group(2) is None:
            comment = ""
        else:
            yield part.group(2), f"{part.group(1)}({part.group(3)})", comment


def silent(header: str) -> list[str]:
    """What functions do not say: anything at all, the shape of numbers in a row, the unit of a real number."""
    wrong = []
    for name, face, comment in explained(header):
        if not comment:
            wrong.append(f"{name} says nothing")
        elif re.search(NUMBERS, face) and not re.search(r"\([^()]*\w[^()]*,[^()]*\)|`\w+`|bytes", comment):
            wrong.append(f"{name} gives no shape")
        elif "double" in face and not re.search(r"\[[^\]]+\]", comment):
            wrong.append(f"{name} gives no unit; [1]: without one, [any]: the caller's")
    return wrong


def test_every_function_of_the_header_says_shapes_and_units() -> None:
    header = (build.SOURCES / "stopset.h").read_text(encoding="utf-8")
    found = list(explained(header))
    assert len(found) == len(re.findall(r"^STOPSET_API (?!extern)", header, re.MULTILINE)) > 90
    assert not silent(header)
    assert silent("STOPSET_API int stopset_a(double x);") == ["stopset_a says nothing"]
    assert silent("/* Of x. */\nSTOPSET_API int stopset_a(double x);") == [
        "stopset_a gives no unit; [1]: without one, [any]: the caller's"
    ]
    assert silent("/* Of x [m]. */\nSTOPSET_API int stopset_a(const double *x);") == ["stopset_a gives no shape"]


def test_every_file_says_what_it_rests_on() -> None:
    for path in (*build.c_files(), *sorted(FMU.glob("*.c"))):
        text = path.read_text(encoding="utf-8")
        assert text.startswith("/* "), f"{path.name} begins without saying what it is"
        rests = re.search(r"\bSource: |\bLemmas? \d", text) is not None
        assert rests or path.name in PLUMBING, (
            f"{path.name} names no source: a paper, a lemma of docs/stops.md, or the law it is made from"
        )


def changing(text: str) -> list[str]:
    """Lines that declare memory which outlives a call and can be written."""
    lines = code_of(text).splitlines()
    return [x.strip() for x in lines if re.match(r"\s*(static|_Thread_local|extern)\b(?!.*\bconst\b)[^(]*[;=]", x)]


def test_no_source_declares_memory_that_outlives_a_call() -> None:
    for path in (*build.c_files(), *sorted(build.SOURCES.rglob("*.h")), *sorted(FMU.glob("*.[ch]"))):
        assert not changing(path.read_text(encoding="utf-8")), path.name
    assert changing("static int seen;\n    static double last[3] = {0};\nextern int there;") != []
    assert changing("static const int three = 3;\nstatic int two(void) { return 2; }\n/* static int no; */") == []


def long_functions(text: str) -> dict[str, int]:
    """Functions that do not fit on a screen, and their lines: from the first line of the head to the brace that closes it."""
    found: dict[str, int] = {}
    head = 0
    for k, line in enumerate(code_of(text).splitlines()):
        if re.match(r"[A-Za-z_].*\w\(", line):
            head = k
        if line == "}" and k - head >= 70:
            found[text.splitlines()[head]] = k - head + 1
    return found


def test_functions_in_c_fit_on_a_screen() -> None:
    for path in (*build.c_files(), *sorted(FMU.glob("*.c"))):
        assert not long_functions(path.read_text(encoding="utf-8")), path.name
    body = "    x += 1;\n"
    assert long_functions(f"int f(int x,\n      int y) {{\n{body * 68}}}\n") == {"int f(int x,": 71}
    assert not long_functions(f"int f(int x,\n      int y) {{\n{body * 67}}}\nint g(int z) {{\n}}\n")


MOST = 7  # arguments of a function


def crowded(text: str) -> dict[str, int]:
    """Functions that take more than `MOST` arguments, and how many; those of FMI's own face take what the standard says."""
    head = r"^[A-Za-z_][\w \*]*?[ \*](\w+)\(((?:[^;{}()]|\([^()]*\))*)\)\s*[{;]"
    found = {
        name: re.sub(r"\([^()]*\)", "", given).count(",") + 1 for name, given in re.findall(head, code_of(text), re.MULTILINE)
    }
    return {name: count for name, count in found.items() if count > MOST and not re.match(r"fmi[23][A-Z]", name)}


def test_functions_in_c_take_few_arguments() -> None:
    """What travels together is one struct, which says what it is in the field."""
    for path in (*sorted(build.SOURCES.rglob("*.[ch]")), *sorted(FMU.glob("*.[ch]"))):
        assert not crowded(path.read_text(encoding="utf-8")), path.name
    many = ", ".join(f"const double *x{k}" for k in range(MOST))
    assert crowded(f"static int f({many},\n             int (*g)[3]) {{\n}}\nint *g({many}) {{ return 0; }}\n") == {"f": MOST + 1}
    assert not crowded("void f(int a, int b, void (*call)(int, int, int, int, int, int, int), int c);")
    assert crowded(f"void stopset_f({many}, int n);") == {"stopset_f": MOST + 1}
    assert not crowded(f"int fmi3DoStep({many}, int n) {{\n    return a(1, 2, 3, 4, 5, 6, 7, 8);\n}}\n")


def writable(library: Path) -> list[str]:
    """Objects of a library that lie where they can be written."""
    done = subprocess.run(["nm", "-f", "sysv", library], capture_output=True, text=True, check=True)
    rows = [[cell.strip() for cell in row.split("|")] for row in done.stdout.splitlines() if row.count("|") == 6]
    return [name for name, _, _, kind, *_, place in rows if kind == "OBJECT" and re.match(r"\.t?(data|bss)$", place)]


@pytest.mark.skipif(sys.platform != "linux" or not shutil.which("nm"), reason="needs nm for this platform's libraries")
def test_the_library_holds_no_writable_data(tmp_path: Path) -> None:
    """Whatever calls it, in however many threads: it remembers nothing. (Tables of constants are read-only after loading.)"""
    assert lib is not None
    assert not [x for x in writable(build.HERE / build.library_name()) if not FOREIGN.fullmatch(x)]
    compiler = build.system_compiler()
    if compiler is None:
        pytest.skip("no system compiler: that a library with a global would be found is not shown")
    source = tmp_path / "remembers.c"
    source.write_text("static int seen; int count(void) { return ++seen; } int shown = 1;")
    subprocess.run([*compiler, "-shared", "-fPIC", source, "-o", tmp_path / "remembers.so"], check=True)
    assert {x for x in writable(tmp_path / "remembers.so") if not FOREIGN.fullmatch(x)} == {"seen", "shown"}
