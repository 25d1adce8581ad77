"""The house itself: layers, names, sources and requirements hold together."""

from __future__ import annotations

import ast
import keyword
import re
import subprocess
import sys
from collections.abc import Collection, Iterator, Mapping
from functools import cache
from pathlib import Path

import pytest

from stopset.cli.main import commands

ROOT = Path(__file__).parents[1]
PARTS = ("model", "offline", "monitor", "fmu")
# who may use whom: only those further down (offline, monitor and fmu never each other)
LAYERS = (
    ("cli",), ("offline", "monitor", "fmu"), ("simulation",), ("reach",), ("artifact",), ("recording",), ("effects",), ("robot",),
    ("sets",), ("ring",), ("core",), ("serving",), ("unpacked",), ("files",), ("progress",), ("notebook",), ("words",), ("errors",), ("types",),
)  # fmt: skip
LEVEL = {name: k for k, layer in enumerate(LAYERS) for name in layer}
# what the monitor's host must not need
HEAVY = (
    "numba",
    "llvmlite",
    "scipy",
    "plotly",
    "pinocchio",
    "osqp",
    "cvxpy",
    "clarabel",
    "toppra",
    "matplotlib",
    "fmpy",
    "pandas",
)


@cache
def modules() -> dict[str, Path]:
    """Every module of the project by its dotted name."""
    out = {}
    for part in PARTS:
        for path in sorted((ROOT / part).rglob("*.py")):
            names = list(path.relative_to(ROOT / part).with_suffix("").parts)
            out[".".join(names[:-1] if names[-1] == "__init__" else names)] = path
    return out


@cache
def tree(name: str) -> ast.Module:
    return ast.parse(modules()[name].read_text(encoding="utf-8"))


def imports(name: str, everywhere: bool) -> Iterator[str]:
    """Modules of the project that a module imports (``everywhere``: inside functions and for types alone too)."""
    todo: list[ast.AST] = list(tree(name).body)
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            assert node.level == 0, f"{name}: relative import"
            for a in node.names:
                yield f"{base}.{a.name}" if f"{base}.{a.name}" in modules() else base
        elif everywhere:
            todo += list(ast.iter_child_nodes(node))
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        elif isinstance(node, (ast.If, ast.Try, ast.With)):
            todo += [n for n in ast.iter_child_nodes(node) if isinstance(n, ast.stmt)]


def test_the_namespace_has_no_file_of_its_own() -> None:
    """One `stopset/__init__.py` would hide the other three parts, or be overwritten by another package's."""
    assert not [p for part in PARTS for p in (ROOT / part / "stopset").glob("__init__.py")]
    for part in PARTS:
        assert [p.name for p in (ROOT / part).iterdir() if p.is_dir() and p.name != "__pycache__"] == ["stopset"]


def test_types_are_shipped_and_written_once() -> None:
    """``py.typed`` for those who check their own code against ours; one alias for arrays; no module that `import` cannot name."""
    assert (ROOT / "model" / "stopset" / "py.typed").is_file()
    written = [m for m, p in modules().items() if re.search(r"^Array\b.*=", p.read_text(encoding="utf-8"), re.MULTILINE)]
    assert written == ["stopset.types"]
    assert not [m for m in modules() if any(keyword.iskeyword(part) for part in m.split("."))]


def test_imports_go_down_only() -> None:
    wrong = []
    for name in modules():
        mine = name.split(".")[1]
        for other in imports(name, everywhere=True):
            if other.startswith("stopset.") and other in modules():
                yours = other.split(".")[1]
                if yours != mine and LEVEL[mine] >= LEVEL[yours]:
                    wrong.append(f"{name} imports {other}")
    assert not wrong


@cache
def imported() -> dict[str, set[str]]:
    """What each module imports of the project, inside functions and for types alone too."""
    return {m: {i for i in imports(m, everywhere=True) if i in modules() and i != m} for m in modules()}


def circle(graph: Mapping[str, Collection[str]]) -> list[str]:
    """Names that lead back to the first of them; empty where none does."""
    done: set[str] = set()

    def visit(name: str, path: list[str]) -> list[str]:
        if name in path:
            return [*path[path.index(name) :], name]
        if name in done:
            return []
        found = next((c for other in sorted(graph[name]) if (c := visit(other, [*path, name]))), [])
        done.add(name)
        return found

    return next((c for name in graph if (c := visit(name, []))), [])


def test_no_import_cycle() -> None:
    """No hidden one either: what is imported in a function, or for its types alone, is read together all the same."""
    assert circle({"a": ["b"], "b": ["c"], "c": ["b"]}) == ["b", "c", "b"]
    assert not circle(imported()), " -> ".join(circle(imported()))


def test_folders_form_no_circle() -> None:
    """The rooms of a folder can be read one after the other: no two of them need each other, however many files are between."""
    folders = {m.rpartition(".")[0] for m in modules()} - {"stopset", ""}
    for folder in sorted(folders):

        def room(m: str, within: str = folder) -> str:
            """The file or folder within the folder that a module stands in; nothing where it stands elsewhere."""
            return m.removeprefix(f"{within}.").partition(".")[0] if m.startswith(f"{within}.") else ""

        rooms: dict[str, set[str]] = {}
        for m, others in imported().items():
            if room(m):
                rooms.setdefault(room(m), set()).update({room(o) for o in others} - {"", room(m)})
        assert not circle(rooms), f"{folder}: {' -> '.join(circle(rooms))}"


# in data order: nobody uses what comes after (tests above: nor the other way around by a third)
STAGES = (
    "report", "description", "campaign", "nominal", "inspect", "abstraction", "conform", "brakes", "stops", "plan", "compare",
    "diagnose", "identify", "revise", "update", "fleet", "workbench", "notebook",
)  # fmt: skip


def test_stages_of_the_offline_half_stand_in_data_order() -> None:
    """Recordings, nominal model, abstraction, sets; then what is made of a model file."""
    found = {m.split(".")[2] for m in modules() if m.startswith("stopset.offline.")}
    assert found == set(STAGES)
    wrong = [
        f"{m} imports {o}" for m, others in imported().items() for o in others
        if m.startswith("stopset.offline.") and o.startswith("stopset.offline.")
        and STAGES.index(m.split(".")[2]) < STAGES.index(o.split(".")[2])
    ]  # fmt: skip
    assert not wrong


def test_descriptions_are_read_in_one_place() -> None:
    """The model file holds the arm: no one but the offline part's first stage parses a URDF, or needs pinocchio for it."""
    tools = ("xml", "lxml", "pinocchio", "coal", "hppfcl")
    readers = {m for m in modules() for i in imports(m, everywhere=True) if i.partition(".")[0] in tools}
    writers = {"stopset.fmu.description", "stopset.fmu.terminals"}  # of the FMU's own description
    assert writers <= readers and not any(
        re.search(r"fromstring|parse\(", modules()[w].read_text(encoding="utf-8")) for w in writers
    )
    assert all(m.startswith("stopset.offline.description.") for m in readers - writers), readers
    asked = {m for m in modules() for i in imports(m, everywhere=True) if i.startswith("stopset.offline.description")}
    assert all(m.split(".")[1] in ("offline", "cli") for m in asked), asked


def test_import_linter_agrees() -> None:
    pytest.importorskip("importlinter")
    script = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]


@pytest.mark.parametrize("what", ["monitor", "reach", "artifact", "robot", "recording", "cli"])
def test_what_the_monitors_host_imports_stays_light(what: str) -> None:
    """In a process of its own: nothing heavy comes along, however deep. (A command may need more when it runs.)"""
    names = [m for m in modules() if m.split(".")[1] == what]
    if what == "cli":
        names = ["stopset.cli.main"]
    code = (
        f"import sys, importlib\nsys.modules.update(dict.fromkeys({HEAVY!r}))\n"  # as if they were not installed
        f"for m in {names!r}:\n importlib.import_module(m)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-1500:]


def test_no_command_waits_for_parts_of_scipy_that_it_may_not_use() -> None:
    """A second of processor time before the first word: these are imported where they are called."""
    slow = ("scipy.stats", "scipy.optimize", "scipy.signal", "scipy.interpolate", "scipy.spatial")
    names = {"stopset.offline.identify.pipeline", "stopset.offline.diagnose.diagnose", "stopset.offline.inspect.inspection"}
    assert names <= set(modules())  # what commands load
    for name in modules():
        for node in tree(name).body:
            if isinstance(node, ast.ImportFrom):
                loaded = {node.module or "", *(f"{node.module}.{a.name}" for a in node.names)}
            else:
                loaded = {a.name for a in node.names} if isinstance(node, ast.Import) else set()
            assert not [x for x in loaded if x.startswith(slow)], name


def test_bus_libraries_stay_in_the_links_and_importers() -> None:
    """`can` and `zenoh` are imported where a bus is opened, and nowhere when a module is merely loaded."""
    for name in modules():
        if ".monitor.links" in name:
            continue
        top = {i.split(".")[0] for i in imports(name, everywhere=False)}
        assert not top & {"can", "zenoh", "canopen"}, name


def test_every_public_module_says_what_it_is() -> None:
    silent = [m for m in modules() if not m.split(".")[-1].startswith("_") and not ast.get_docstring(tree(m))]
    # a bare package marker has nothing to say
    assert not [m for m in silent if tree(m).body]


def test_modules_stay_readable() -> None:
    """About 200 lines are meant; 500 are too many."""
    assert not {m: n for m, p in modules().items() if (n := len(p.read_text(encoding="utf-8").splitlines())) > 500}


def functions(name: str) -> Iterator[tuple[str, int, int]]:
    """Every function of a module: its name, lines and arguments besides itself."""
    for f in ast.walk(tree(name)):
        if isinstance(f, (ast.FunctionDef, ast.AsyncFunctionDef)):
            given = [x.arg for x in (*f.args.posonlyargs, *f.args.args, *f.args.kwonlyargs)]
            yield (
                f"{name}.{f.name}".removeprefix("stopset."),
                (f.end_lineno or 0) - f.lineno + 1,
                len(given) - (given[:1] in (["self"], ["cls"])),
            )


def test_functions_fit_on_a_screen_and_take_few_arguments() -> None:
    found = [f for m in modules() if not m.endswith("._binding") for f in functions(m)]
    assert not {f: lines for f, lines, _ in found if lines > 70}
    assert not {f: given for f, _, given in found if given > 7}, "let what travels together be one type"


def rows_by_index(name: str) -> Iterator[str]:
    """Numbers beyond the second of a result, or of a row that is looped over, asked for by place: they have names, or are unpacked."""
    made = {"partition", "rpartition", "svd"}  # known by everyone
    looped = {
        x.id for n in ast.walk(tree(name)) if isinstance(n, (ast.comprehension, ast.For))
        for x in ast.walk(n.target) if isinstance(x, ast.Name)
    }  # fmt: skip
    for n in ast.walk(tree(name)):
        if not (isinstance(n, ast.Subscript) and isinstance(n.slice, ast.Constant) and isinstance(n.slice.value, int)):
            continue
        of, place = n.value, n.slice.value
        called = isinstance(of, ast.Call) and getattr(of.func, "attr", getattr(of.func, "id", "")) not in made
        if place > 1 and (called or (isinstance(of, ast.Name) and of.id in looped)):
            yield f"{name}:{n.lineno}: {ast.unparse(n)}"


def test_no_result_is_read_by_a_magic_index() -> None:
    found = [x for m in modules() for x in rows_by_index(m)]
    assert not found, "unpack it, or give its parts names"


SAYING = {"why", "says", "note", "notes", "text", "message", "what"}


def beginnings(name: str) -> Iterator[str]:
    """Decisions by how a sentence begins, ends or reads: on text with a blank or a colon in it, or of a field that holds a sentence."""
    for n in ast.walk(tree(name)):
        if not (isinstance(n, ast.Call) and isinstance(n.func, ast.Attribute)):
            continue
        if n.func.attr not in ("startswith", "endswith", "removeprefix", "removesuffix"):
            continue
        words = [c.value for a in n.args for c in ast.walk(a) if isinstance(c, ast.Constant) and isinstance(c.value, str)]
        of = getattr(n.func.value, "attr", getattr(n.func.value, "id", ""))
        if of in SAYING or any(" " in w.strip() or w.endswith(": ") for w in words):
            yield f"{name}:{n.lineno}: {ast.unparse(n)}"


def test_nothing_is_decided_by_how_a_sentence_begins() -> None:
    """Words are for people: whoever mends one must not change what the program does."""
    found = [x for m in modules() for x in beginnings(m)]
    assert not found, "give what is decided on a field of its own"


def types_named(name: str) -> Iterator[str]:
    """Classes of a module, and its names for types that are made of others."""
    for n in ast.walk(tree(name)):
        if isinstance(n, ast.ClassDef):
            yield n.name
    for n in tree(name).body:
        if isinstance(n, (ast.Assign, ast.AnnAssign)) and isinstance(n.value, (ast.Subscript, ast.BinOp)):
            targets = n.targets if isinstance(n, ast.Assign) else [n.target]
            yield from (t.id for t in targets if isinstance(t, ast.Name) and re.fullmatch(r"_?[A-Z][a-z]\w*", t.id))


def test_one_meaning_per_class_name() -> None:
    """A name read in one file means the same in the next."""
    homes: dict[str, list[str]] = {}
    for m in modules():
        for name in types_named(m):
            homes.setdefault(name, []).append(m)
    assert not {k: v for k, v in homes.items() if len(v) > 1}


# words that names were made of before the field's took their place (NOTATION.md), and what stands there now
REPLACED = {
    "told": "reported, stated, answer", "tell": "progress", "tells": "determines", "way": "direction, travel, distance, path",
    "ways": "travel", "kept": "retained, stored", "apart": "spread, separate, difference", "doubt": "fault, uncertainty",
    "doubts": "faults", "lever": "moment arm", "levers": "moment arms, gravity stiffness", "restless": "still moving",
    "loud": "noisy", "foretells": "predicts",
}  # fmt: skip


def words_of(identifier: str) -> set[str]:
    """The words of a name, however they are joined."""
    return {w.lower() for w in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", identifier)}


def identifiers(node: ast.AST) -> Iterator[str]:
    """Every name that a module gives or uses."""
    for n in ast.walk(node):
        if isinstance(n, ast.alias):
            yield from (n.name.rpartition(".")[2], n.asname or "")
        else:
            yield from (x for k in ("id", "attr", "arg", "name") if isinstance(x := getattr(n, k, None), str))


def identifiers_of_c(text: str) -> set[str]:
    return set(re.findall(r"[A-Za-z_]\w*", re.sub(r'/\*.*?\*/|"(?:\\.|[^"\\\n])*"', " ", text, flags=re.DOTALL)))


def test_names_are_made_of_the_words_of_the_field() -> None:
    """Whoever comes from robotics finds what they look for, in Python and in C."""
    assert words_of("toldTooWay_KEPT") == {"told", "too", "way", "kept"}
    named = {m: set(identifiers(tree(m))) for m in modules() if not m.endswith("._binding")}
    named |= {name: identifiers_of_c(text) for name, text in sources_in_c().items()}
    for path in (*modules(), *sources_in_c()):
        named[path] = named.get(path, set()) | {path.rpartition("/")[2].removesuffix(".c").removesuffix(".h").rpartition(".")[2]}
    wrong = {f"{m}: {x} ({REPLACED[w]})" for m, names in named.items() for x in names for w in words_of(x) & REPLACED.keys()}
    assert not wrong, sorted(wrong)


def test_nothing_is_left_to_do() -> None:
    marks = re.compile(r"\b(TODO|FIXME|XXX|HACK)\b")
    assert not [m for m, p in modules().items() if marks.search(p.read_text(encoding="utf-8"))]


# ---- sources


def bib_keys() -> set[str]:
    return set(re.findall(r"^@\w+\{([^,\s]+),", (ROOT / "docs" / "references.bib").read_text(encoding="utf-8"), re.MULTILINE))


@cache
def sources_in_c() -> dict[str, str]:
    """The C files of core and FMU, by name."""
    return {
        p.relative_to(ROOT).as_posix(): p.read_text(encoding="utf-8")
        for part in PARTS for p in sorted((ROOT / part).rglob("*.[ch]"))
    }  # fmt: skip


def explained() -> Iterator[tuple[str, str]]:
    """What docstrings and the comments of the C files say, with where it stands."""
    for m in modules():
        for node in ast.walk(tree(m)):
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
                yield m, ast.get_docstring(node) or ""
    for name, text in sources_in_c().items():
        for comment in re.findall(r"/\*(.*?)\*/", text, re.DOTALL):
            yield name, re.sub(r"^\s*\*", "", comment, flags=re.MULTILINE)


def cited() -> Iterator[tuple[str, str, str]]:
    """(module or C file, first surname in small letters, year) of every ``Source:``."""
    for where, text in explained():
        for found in re.finditer(r"Source:\s*(.*?)(?:\n\s*\n|\Z)", text, re.DOTALL):
            paragraph = " ".join(found.group(1).split())
            for part in re.split(r";", paragraph):
                for names, year in re.findall(r"((?:[A-Z][\w.'’-]*)[^;()]*?)\((\d{4})\)", part):
                    words = [w for w in re.findall(r"[A-Z][\w’'-]+", names) if not re.fullmatch(r"[A-Z]\.?", w)]
                    yield where, re.sub(r"[^a-z]", "", words[0].lower()), year


def test_every_source_in_a_docstring_is_in_the_bibliography() -> None:
    keys = bib_keys()
    seen = 0
    for m, surname, year in cited():
        seen += 1
        assert any(k.endswith(year) and surname.startswith(k[:-4]) for k in keys), f"{m}: {surname} ({year})"
    assert seen > 20


def test_every_effect_names_a_source_of_the_bibliography() -> None:
    from stopset.effects.registry import catalogue

    keys = bib_keys()
    for effect in catalogue().values():
        assert effect.source in keys, f"{effect.name}: {effect.source!r}"


def test_every_entry_of_the_bibliography_is_used() -> None:
    text = {m: p.read_text(encoding="utf-8") for m, p in modules().items()}
    used = {surname + year for _, surname, year in cited()} | set(re.findall(r'source="(\w+)"', "\n".join(text.values())))
    unused = {k for k in bib_keys() if not any(u.endswith(k[-4:]) and u.startswith(k[:-4]) for u in used)}
    assert not unused


def test_lemmas_that_the_code_rests_on_are_proved_in_the_docs() -> None:
    """Cited by number, and every one that is proved is used where it says."""
    proved = set(re.findall(r"\*\*Lemma (\d+) \(", (ROOT / "docs" / "stops.md").read_text(encoding="utf-8")))
    used: set[str] = set()
    nameless = []
    for where, text in explained():
        words = " ".join(text.split())
        used |= {n for list_ in re.findall(r"\bLemmas? (\d+(?:(?:,| and) \d+)*)", words) for n in re.findall(r"\d+", list_)}
        nameless += [f"{where}: {x}" for x in re.findall(r"(?i)\b[a-z]* lemma\b(?! \d)[^.]{0,40}", words)]
    assert used == proved, f"cited and not proved: {sorted(used - proved)}; proved and not cited: {sorted(proved - used)}"
    assert not nameless, "say which"


# called by name from what they are made for: servers, notebooks, the path planner, Python's streams, and links that fill a batch by
# themselves
CALLED_BY_OTHERS = re.compile(
    r"fill|dof|path_interval|do_[A-Z]+|log_message|send_error|handle_error|process_request\w*|_repr_html_|readable|readinto"
)
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


@cache
def names_of(module: str) -> dict[str, tuple[str, str]]:
    """What each name of a module stands for: a module (and nothing), or a module and a name in it."""
    out = {n.name: (module, n.name) for n in tree(module).body if isinstance(n, Definition)}
    for n in ast.walk(tree(module)):
        if isinstance(n, ast.Import):
            out |= {a.asname: (a.name, "") for a in n.names if a.asname}
        elif isinstance(n, ast.ImportFrom) and n.module in modules():
            for a in n.names:
                own = f"{n.module}.{a.name}"
                again = names_of(n.module) if modules()[n.module].name == "__init__.py" and n.module != module else {}
                # a folder hands on what a file in it defines, be it called like that file
                known = again.get(a.name) or ((own, "") if own in modules() else (n.module, a.name))
                out[a.asname or a.name] = known
    return out


def used_by(module: str) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """(module, name, definitions around the use) of every use of what a module of the project defines; methods by their name alone."""
    names = names_of(module)
    todo: list[tuple[ast.AST, tuple[str, ...]]] = [(tree(module), ())]
    while todo:
        node, around = todo.pop()
        inner = (*around, node.name) if isinstance(node, Definition) else around
        todo += [(child, inner) for child in ast.iter_child_nodes(node)]
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in names:
            yield (*names[node.id], around)
        elif isinstance(node, ast.Attribute):
            where, name = names.get(ast.unparse(node.value), ("", "-"))
            yield (where, node.attr, around) if not name else ("", node.attr, around)


def test_the_product_holds_nothing_that_only_tests_use() -> None:
    """Every function, class and method is used by the product, or promised to the reader of a page, or what a law may be written with."""
    uses: dict[tuple[str, str], set[tuple[str, tuple[str, ...]]]] = {}
    for m in modules():
        for where, name, around in used_by(m):
            uses.setdefault((where, name), set()).add((m, around))
    pages = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "docs").rglob("*.md") if p.name != "requirements.md")
    promised = {w for code in re.findall(r"`([^`\n]+)`|^from stopset.* import (.*)$", pages, re.MULTILINE)
                for w in re.findall(r"\w+", " ".join(code))}  # fmt: skip

    def alone(m: str, kind: str, name: str, within: tuple[str, ...]) -> bool:
        others = [1 for user, around in uses.get((kind, name), ()) if (user, around[: len(within)]) != (m, within)]
        return (
            not others
            and name not in promised | elementary
            and not name.startswith("__")
            and not CALLED_BY_OTHERS.fullmatch(name)
        )

    # what laws of any package are written with, each asked of the number by its name
    elementary = names_of("stopset.ring.functions").keys()
    entrances = {m for m in modules() if m.startswith("stopset.cli.")}  # commands are found by their file's name
    found = []
    for m in modules().keys() - entrances:
        for n in (x for x in tree(m).body if isinstance(x, Definition) and not m.endswith("._binding")):
            found += [f"{m}.{n.name}"] * alone(m, m, n.name, (n.name,))
            methods = [f for f in n.body if isinstance(f, Definition)] if isinstance(n, ast.ClassDef) else []
            found += [f"{m}.{n.name}.{f.name}" for f in methods if alone(m, "", f.name, (n.name, f.name))]
    assert not found, f"{sorted(found)}: move it to the tests, or delete it"


# words of the code that are an effect's name and mean something else: module, words, why
OTHER_MEANINGS = (
    ("stopset.cli.demo", "spring", "what the demo hides, as a user would type it"),
    ("stopset.artifact", "inertia coriolis", "a signal that laws read"),
    ("stopset.reach.stops.laws", "coriolis", "a signal that laws read"),
    ("stopset.fmu.laws", "coriolis", "a signal that laws read"),
    ("stopset.offline.diagnose.columns", "coriolis", "a signal that laws read"),
    ("stopset.reach.stops", "viscous delay", "fields of a stop's numbers"),
    ("stopset.artifact.store", "delay", "a field of the model file"),
    ("stopset.artifact.contents", "delay", "a field of the model file"),
    ("stopset.offline.brakes.power_off", "delay", "the brakes'"),
    ("stopset.offline.identify.constants", "delay", "a stage of the identification"),
    ("stopset.fmu.variables", "viscous", "the damping of the abstraction"),
    ("stopset.monitor.rtde", "payload", "a column of the controller"),
)


def effects_named(name: str) -> set[str]:
    """Names of effects that a module writes as text of its own, docstrings aside."""
    from stopset.effects.registry import catalogue

    said = {id(n.value) for n in ast.walk(tree(name)) if isinstance(n, ast.Expr)}
    texts = (
        n.value for n in ast.walk(tree(name)) if isinstance(n, ast.Constant) and isinstance(n.value, str) and id(n) not in said
    )
    return {word for text in texts if (word := text.partition(":")[0]) in catalogue()}


def test_no_effect_is_named_outside_its_folder() -> None:
    """What others must know of an effect is an attribute of it: one from outside is then treated as ours are."""
    named = {m: effects_named(m) for m in modules() if not m.startswith("stopset.effects")}
    wrong = {
        f"{m}: {word}" for m, words in named.items() for word in words
        if not any((m == where or m.startswith(f"{where}.")) and word in other.split() for where, other, _ in OTHER_MEANINGS)
    }  # fmt: skip
    assert not wrong, f"{sorted(wrong)}: ask the effect (stopset.effects.base.Effect), or say here what else the word means"


# ---- the command line


def test_the_overview_lists_every_command() -> None:
    done = subprocess.run([sys.executable, "-m", "stopset.cli.main", "--help"], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    for c in commands():
        assert re.search(rf"^  {c} +\S", done.stdout, re.MULTILINE), c
    assert "not a certified safety function" in done.stdout


@pytest.mark.parametrize(
    "command", [c for c in commands() if c not in ("demo", "fleet", "monitor", "renew", "replay", "reset", "watch")]
)
def test_every_command_that_answers_takes_json_and_report(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    from stopset.cli.main import main

    with pytest.raises(SystemExit):
        main([command, "--help"])
    shown = capsys.readouterr().out
    assert "--json FILE" in shown and "--report FILE.html" in shown


@pytest.mark.parametrize("command", commands())
def test_every_command_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    from stopset.cli.main import main

    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    said = capsys.readouterr().out
    assert f"stopset {command}" in said
    assert "Monitoring aid" in said


# ---- requirements


@cache
def existing_tests() -> frozenset[str]:
    out = set()
    for path in (ROOT / "tests").glob("test_*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                out.add(f"{path.name}::{node.name}")
    return frozenset(out)


def requirement_rows() -> list[list[str]]:
    text = (ROOT / "docs" / "requirements.md").read_text(encoding="utf-8")
    rows = [re.split(r"(?<!\\)\|", line.strip().strip("|")) for line in text.splitlines() if re.match(r"\| *(R|P)-?\d", line)]
    return [[cell.strip() for cell in row] for row in rows]


def test_every_requirement_is_verified_by_tests_that_exist() -> None:
    rows = requirement_rows()
    assert len(rows) > 40
    assert len({r[0] for r in rows}) == len(rows)  # numbered once
    missing = []
    for row in rows:
        named = re.findall(r"`(test_\w+\.py)::(test_\w+)`", row[-1])
        if not named:
            missing.append(f"{row[0]} names no test")
        missing += [f"{row[0]}: {f}::{t}" for f, t in named if f"{f}::{t}" not in existing_tests()]
    assert not missing


def test_every_trap_has_a_row() -> None:
    traps = {row[0] for row in requirement_rows() if row[0].startswith("P")}
    assert traps == {f"P{k}" for k in range(1, 27) if k != 14}


def test_every_equation_of_the_paper_has_a_row_and_every_row_a_test() -> None:
    text = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
    tables = text[: text.index("## Its numbers")]
    rows = [line.strip("| ").split(" | ") for line in tables.splitlines() if line.startswith("| ") and "shown by" not in line]
    numbered: set[int] = set()
    for first, *_ in rows:
        spans = re.findall(r"(?<!\w)\((\d+)\)(?:-\((\d+)\))?", first)
        numbered |= {k for a, b in spans for k in range(int(a), int(b or a) + 1)}
    assert numbered == set(range(1, 22))
    traps = {row[0] for row in requirement_rows()}
    assert not [
        row for row in rows if not re.search(r"`test_\w+\.py::test_\w+`", row[-1]) and not {*row[-1].split(", ")} <= traps
    ]


def test_every_test_that_a_page_names_exists() -> None:
    pages = [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    named = {(p.name, t) for p in pages for t in re.findall(r"(test_\w+\.py::test_\w+)", p.read_text(encoding="utf-8"))}
    assert len(named) > 100
    assert not {(page, test) for page, test in named if test not in existing_tests()}


def test_symbols_of_the_code_are_in_the_notation() -> None:
    text = (ROOT / "NOTATION.md").read_text(encoding="utf-8")
    for symbol in (
        "q",
        "dq",
        "ddq",
        "tau",
        "u",
        "M",
        "Minv",
        "A",
        "B",
        "E1",
        "X0",
        "U",
        "V",
        "Ad",
        "Bd",
        "pi",
        "dt",
        "horizon",
        "warm",
    ):
        assert re.search(rf"^\| `{symbol}`", text, re.MULTILINE), symbol
    rows = [r for r in text.splitlines() if r.startswith("| `")]
    names = [n for r in rows for n in re.findall(r"`([^`]+)`", r.split("|")[1])]
    assert len(names) == len(set(names))  # never two meanings for one symbol
