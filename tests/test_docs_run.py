"""What a page tells its reader to type is typed: in order, in a folder that holds the files that the line names and nothing else.

README, docs/** and deploy/**: every line of a `sh` block, and every whole command in running text. It is run here, with `HERE` for
what no other machine has; or another test types it (`WHOLE_PAGES`, `ELSEWHERE`); or `NOT_HERE` says why nothing can.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import re
import shlex
import shutil
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import can
import numpy as np
import pytest

from monitor_arm import motion
from monitor_process import Ear, environment, free_port, listens, running
from patience import wait
from stopset.artifact.signature import new_key, sign
from stopset.cli.main import commands, parser_of
from stopset.monitor.layout import State
from stopset.recording import read_recordings
from test_can import recorded
from test_docs import PAGES
from test_hidden_effects import ARM
from test_rollout import DELIVER, cells

ROOT = Path(__file__).resolve().parents[1]
PIECE = re.compile(
    r"^```(\w*)[^\n]*\n(.*?)^```$|(?<!`)`([^`]+)`(?!`)", re.S | re.M
)  # language and block, or what is said in between
COMMAND = re.compile(r"(stopset|python3?|uv|gcc|candump|systemctl|docker|podman|\./run|\S+\.sh) \S")
LOOPBACK = "tcp/127.0.0.1:"

# ---- what is not typed here ------------------------------------------------------------------------------------------

WHOLE_PAGES = {  # their blocks; what they say in between is typed here
    "docs/how-to/deploy.md": "test_install.py::test_the_page_from_a_clone_to_a_cell_runs_as_written",
    "docs/tutorials/simulated-cell.md": "test_docs.py::test_the_tutorial_runs_as_written",
}
ELSEWHERE = {
    "./run demo": "test_demo.py::test_the_drill",
    "./run identify --help": "test_docs_run.py::test_the_run_script_passes_a_command_on",
    "python benchmarks/reference_pages.py --tutorial": "test_docs.py::test_the_tutorial_runs_as_written",
    "python benchmarks/example_pages.py --run": "test_examples.py::test_every_cell_of_every_notebook_runs",
    "python benchmarks/effect_pages.py": "test_effect_pages.py::test_the_pages_are_up_to_date",
    "python benchmarks/fmu_cell.py docs/pictures/fmu-cell.svg": "test_fmu_cell.py::test_importers_agree_on_the_cell",
    "upgrade.sh /opt/stopset-NEW new.model.json": "test_deploy.py::test_a_model_goes_and_comes_back_with_its_version",
    "checks/upgrade.sh /opt/stopset-NEW": "test_install.py::test_the_page_from_a_clone_to_a_cell_runs_as_written",
}
MINUTES = "measures for minutes: only its options are looked at"
NOT_HERE = {  # line: reason, and the file or program whose absence is it
    "./run test": ("runs this test", ""),
    "candump -l can0": ("hears a real CAN interface", "/sys/class/net/can0"),
    "systemctl reload stopset": ("asks systemd as the first process", "/run/systemd/system"),
    "systemctl --failed": ("asks systemd as the first process", "/run/systemd/system"),
    "uv pip compile pyproject.toml --extra monitor --generate-hashes --no-header --no-annotate --python-version 3.11": (
        "asks a package index for the newest versions", "",
    ),
    "gcc -O1 '-DFMUSIM_VERSION=\"0\"' -DSUN_COMM_NULL=NULL -D_GNU_SOURCE -I. -I../include -I/usr/include/libxml2 -I/usr/include/minizip": (
        "part of how others' sources are built; test_fmu_fmusim.py runs what comes of it", "",
    ),
    "python benchmarks/as_found.py": (MINUTES, ""),
    "python benchmarks/diagnosis.py --healthy 24 --seed 901": (MINUTES, ""),
    "python benchmarks/diagnosis_speed.py": (MINUTES, ""),
    "python benchmarks/found_outside.py": (MINUTES, ""),
    "python benchmarks/found_pairs.py": (MINUTES, ""),
    "python benchmarks/found_limits.py": (MINUTES, ""),
    "python benchmarks/healthy_again.py": (MINUTES, ""),
    "python benchmarks/one_answer.py": (MINUTES, ""),
    "python benchmarks/one_answer.py simulated lwa4p ROBOT --seed 171000 --drawn 24 --out FOLDER": (MINUTES, ""),
    "python benchmarks/real_robots.py FOLDER --markdown TABLE.md": (MINUTES, ""),
    "python benchmarks/revisions.py --robot lwa4p --data open_loop.parquet": (MINUTES, ""),
    "python benchmarks/violation_classes.py": (MINUTES, ""),
}  # fmt: skip
SAYS_NO = ("stopset compare arm.model.json --data other.parquet --report compare.html",)  # an effect is missing: exit code 1

ONCE = (
    "stopset identify-fleet arms --out models --workers 8",
    "python benchmarks/reference_pages.py",
)  # on several pages, and dear


# ---- what a page says ------------------------------------------------------------------------------------------------


def whole(line: str) -> bool:
    """Whether a reader could type it: not the name of a command with one of its options, as in `stopset stops --path`."""
    words = shlex.split(line)
    if words[0] != "stopset" or words[1] not in commands():
        return words[0] != "stopset"
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        try:
            parser_of(words[1]).parse_args(words[2:])
        except SystemExit:
            known = {o for a in parser_of(words[1])._actions for o in a.option_strings}
            assert {w for w in words if w.startswith("--")} <= known, f"{line}: {said.getvalue()}"
            return False
    return len(words) > 2


def typed(page: Path) -> list[str]:
    """The commands of a page in its order, each once, without comments."""
    found: list[str] = []
    for language, block, between in PIECE.findall(page.read_text(encoding="utf-8")):
        lines = [re.sub(r"\s+", " ", x.split(" #")[0]).strip() for x in block.replace("\\\n", " ").splitlines()]
        if language == "sh" and page.relative_to(ROOT).as_posix() not in WHOLE_PAGES:
            found += [x for x in lines if x and not x.startswith("#")]
        elif block and not language:
            found += [x for x in lines if COMMAND.match(x)]
        elif between and COMMAND.match(x := re.sub(r"\s+", " ", between).strip()) and whole(x):
            found.append(x)
    return list(dict.fromkeys(found))


LINES = {page.relative_to(ROOT).as_posix(): typed(page) for page in PAGES}
ALL = {line for lines in LINES.values() for line in lines}


def run_here(page: str) -> list[str]:
    before = {x for p in list(LINES)[: list(LINES).index(page)] for x in LINES[p] if x in ONCE}
    return [x for x in LINES[page] if x not in ELSEWHERE and x not in NOT_HERE and x not in before]


def promised(words: list[str]) -> list[str]:
    """The files that a command says it writes."""
    if words[:2] == ["stopset", "sign"]:
        key = words[words.index("--new-key") + 1] if "--new-key" in words else ""
        made = [key, f"{key}.pub"] if key else [f"{words[2]}.sig"]
    else:
        made = [f"{words[-1]}/stopset_state.{suffix}" for suffix in ("h", "st")] if "stopset.monitor.plc" in words else []
    return made + [b for a, b in itertools.pairwise(words) if a in ("--out", "--report", "--csv", "--record")]


# ---- what is there before a page begins ------------------------------------------------------------------------------


@dataclass
class Place:
    """A reader's folder and what runs beside it; ``kit``: files that several pages name, made once."""

    kit: Path
    folder: Path
    stack: contextlib.ExitStack
    page: str = ""
    ports: dict[str, int] = field(default_factory=dict)  # by configuration, and of the router
    monitored: set[str] = field(default_factory=set)
    replays: list[subprocess.Popen[str]] = field(default_factory=list)

    def port(self, name: str) -> int:
        return self.ports.setdefault(name, free_port())

    def take(self, name: str) -> None:
        """Put the file ``name`` here, unless the page has made it itself."""
        if not (self.folder / name).exists():
            FILES[name](self, name)


def run(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    programs = {"stopset": ["-m", "stopset.cli.main"], "python": []}
    assert words[0] in programs, f"{words[0]}: not to be run here; name its test in ELSEWHERE, or the reason in NOT_HERE"
    words = programs[words[0]] + words[1:]
    return subprocess.run([sys.executable, *words], cwd=folder, env=environment(), capture_output=True, text=True, timeout=600)


def made(name: str, line: str = "") -> Callable[[Place, str], None]:
    """The file ``name`` of the kit, made by ``line`` if it is not there yet."""

    def put(place: Place, target: str) -> None:
        if not (place.kit / name).exists():
            here, words = Place(place.kit, place.kit, place.stack), shlex.split(line)
            for word in (w for w in words if w in FILES and w != name):
                here.take(word)
            done = run(words, place.kit)
            assert done.returncode == 0, f"{line}: {done.stderr}"
        copy = shutil.copytree if (place.kit / name).is_dir() else shutil.copy
        if (to := place.folder / target) != place.kit / name:
            copy(place.kit / name, to)

    return put


def lies(name: str, *beside: str) -> Callable[[Place, str], None]:
    """A file in a folder of the kit."""

    def put(place: Place, target: str) -> None:
        Place(place.kit, place.kit, place.stack).take(name.split("/")[0].removesuffix(".pub"))
        shutil.copy(place.kit / name, place.folder / target)
        for other in beside:
            place.take(other)

    return put


def arm(place: Place, target: str) -> None:
    (place.folder / target).write_text(
        ARM.replace('"turn"', '"joint_1"').replace('"lift"', '"joint_2"').replace('"bend"', '"joint_3"')
    )


def arms(place: Place, target: str) -> None:
    """Two arms, one of which was recorded again later."""
    for name in ("left", "right"):
        there = Place(place.kit, place.folder / target / name, place.stack)
        (there.folder / "later").mkdir(parents=True)
        FILES["arm.urdf"](there, "robot.urdf")
        FILES["recordings.parquet"](there, "recordings.parquet")
    FILES["other.parquet"](there, "later/other.parquet")


def configuration(place: Place, target: str, more: str = "") -> None:
    place.take("arm.model.json")
    (place.folder / target).write_text(
        f'model = "arm.model.json"\ndata_id = 7\n[joint_states]\nkey = "js"\ncycle_s = 0.004\n[zenoh]\nlisten = ["{LOOPBACK}{place.port(target)}"]\n'
        f"[publish]\nvalid_for_ms = 1000\nstale_ms = 2000\n{more}"
    )


def profile(place: Place, target: str) -> None:
    shipped = ROOT / "monitor/stopset/monitor/profiles/lwa4p"
    shutil.copy(shipped / "monitor.toml", place.folder / target)
    shutil.copy(shipped / "monitor.dcf", place.folder)


def tree(place: Place, target: str) -> None:
    """The scripts, and the pages that they write."""
    for name in (target, "docs"):
        shutil.copytree(ROOT / name, place.folder / name, ignore=shutil.ignore_patterns("__pycache__"))


def log(place: Place, target: str) -> None:
    with can.Logger(str(place.folder / target)) as out:
        for f in recorded([motion(0, 500)]).frames:
            out.on_message_received(
                can.Message(arbitration_id=f.cob_id, data=f.data, timestamp=1.7e9 + f.t, is_extended_id=False, channel="can0")
            )


def numbered(place: Place, target: str) -> None:
    """A trial as another tool writes it: a table with numbered columns."""
    place.take("run1.parquet")
    r = read_recordings(place.folder / "run1.parquet").trials[0]
    columns = {"time": r.t} | {
        f"{kind}{k + 1}": x[:, k] for kind, x in (("q", r.q), ("dq", r.dq), ("tau", r.tau)) for k in range(3)
    }
    rows = np.column_stack(list(columns.values()))
    np.savetxt(place.folder / target, rows, "%.9g", ",", header=",".join(columns), comments="")


three = made("arm.model.json", "stopset identify --robot arm.urdf --data recordings.parquet --out arm.model.json")
six = made("six.model.json", "stopset identify --robot lwa4p --data open_loop.parquet --out six.model.json")
SIX_JOINTS = ("docs/how-to/risk-assessment.md",)  # it names six angles
SIMULATE = "stopset simulate --plan short --seed 1"
FILES: dict[str, Callable[[Place, str], None]] = {
    "three.urdf": arm,
    "healthy": made("healthy", f"{SIMULATE} --robot three.urdf --hide none --out healthy"),
    "altered": made("altered", f"{SIMULATE} --robot three.urdf --hide thermal_viscous:joint_2 --size large --out altered"),
    "paper": made("paper", f"{SIMULATE} --hide warm_up:arm_4_joint --out paper"),
    "arm.urdf": lies("healthy/robot.urdf", "robot.json"),
    "robot.json": lies("healthy/robot.json"),
    "recordings.parquet": lies("healthy/recording.parquet"),
    "run1.parquet": lies("healthy/recording.parquet"),
    "run2.parquet": lies("altered/recording.parquet"),
    "other.parquet": lies("altered/recording.parquet"),
    "open_loop.parquet": lies("paper/recording.parquet"),
    "arm.model.json": lambda place, target: (six if place.page in SIX_JOINTS else three)(place, target),
    "arm1.model.json": lambda place, target: three(place, target),
    "arm2.model.json": made(
        "arm2.model.json", "stopset add arm.model.json thermal_viscous:joint_2 --data other.parquet --out arm2.model.json"
    ),
    "log.csv": numbered,
    "release": made("release", "stopset sign --new-key release"),
    "release.pub": lies("release.pub"),
    "arms": arms,
    "cell.toml": configuration,
    "arm.toml": configuration,
    "my.toml": profile,
    "candump.log": log,
    "benchmarks": tree,
    "deploy/plc": lambda place, target: (place.folder / target).mkdir(parents=True),
}


# ---- what runs beside it ---------------------------------------------------------------------------------------------


def replay(place: Place, recording: str, endpoint: str, key: str) -> None:
    place.take(recording)
    process = place.stack.enter_context(running("replay", recording, "--to", f"zenoh:{endpoint}", "--key", key, "--loop"))
    place.replays.append(process)


def monitored(place: Place, name: str = "cell.toml", more: str = "") -> str:
    """Where a monitor whose arm has left its model is heard; the monitor is started unless the page has started it."""
    if name not in place.monitored:
        if not (place.folder / name).exists():
            configuration(place, name, more)
        endpoint = f"{LOOPBACK}{place.port(name)}"
        if not listens(place.port(name)):
            place.stack.enter_context(running("monitor", "--config", name))
        with Ear(place.port(name)) as ear:
            replay(place, "other.parquet", endpoint, "js")
            assert ear.wait(lambda: State.VIOLATION in ear.states), ear.twins[-1:]
        place.monitored.add(name)
    return f"{LOOPBACK}{place.port(name)}"


def hall(place: Place) -> str:
    """Where the router of two cells listens, whose arms, those of docs/fleet.md, have left their model."""
    endpoint = f"{LOOPBACK}{place.port('router')}"
    if "router" not in place.monitored:
        place.monitored.add("router")
        new_key(place.folder / "release")
        for name in ("arm1.model.json", "arm2.model.json"):
            place.take(name)
            sign(place.folder / name, place.folder / "release")
        (place.folder / "deliver.sh").write_text(DELIVER)
        (place.folder / "deliver.sh").chmod(0o755)
        place.take("other.parquet")
        arms = ("hall3/cell1/arm", "hall3/cell2/arm")
        fleet = cells(place.stack, place.folder, endpoint, arms, "arm1.model.json", "other.parquet")
        assert wait(lambda: [row["word"] for row in fleet.rows()] == ["VIOLATION"] * 2), fleet.rows()
    return endpoint


def scheduler(place: Place) -> str:
    """The address of a Dask cluster of one worker."""
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address=None,
        silence_logs=50,
    )
    return str(place.stack.enter_context(cluster).scheduler_address)


def heard(place: Place) -> str:
    return hall(place) if place.page == "docs/fleet.md" else monitored(place)


def operators(place: Place) -> str:
    (block,) = (b for _, b, _ in PIECE.findall((ROOT / place.page).read_text(encoding="utf-8")) if "[[operators]]" in b)
    return monitored(place, "signed.toml", block)


HERE: dict[str, Callable[[Place], str]] = {  # what a line says, and what stands for it on this machine
    "tcp/router:7447": heard,
    "tcp://scheduler:8786": scheduler,
    "/srv/stopset": lambda place: "srv",
    "--watch-s 3600": lambda place: "--watch-s 2 --each-s 1",
}
LISTENS = re.compile(r"stopset (watch|reset|fleet|rollout) (?!.*--(connect|config))")  # on a port that is everybody's
BESIDE = re.compile(
    r"stopset (monitor|watch|reset|fleet|rollout) |.* --scheduler"
)  # what needs, or is, something that goes on running
SERVES = re.compile(r"stopset (workbench|fleet|watch(?!.*--check))\b")


def words_here(place: Place, line: str) -> list[str]:
    """The line as it can be typed here, with what it names in place."""
    if LISTENS.match(line):
        line += f" --connect {operators(place) if '--key' in line else heard(place)}"
    for said, stands in HERE.items():
        if said in line:
            line = line.replace(said, stands(place))
    if SERVES.match(line):
        line += f" --port {free_port()}"
    words = shlex.split(line)
    for name in FILES:
        if name not in promised(words) and any(name in (w, w.split("/")[0]) for w in words):
            place.take(name)
    if "watch" in words and "--config" in words:
        monitored(place, words[words.index("--config") + 1])
    return words


def answers(port: int) -> bool:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=5) as reply:
            return b"<html" in reply.read().lower()
    except (urllib.error.URLError, ConnectionError, TimeoutError):
        return False


def written(place: Place, words: list[str]) -> bool:
    return all((place.folder / file).exists() for file in promised(words))


def type_line(place: Place, line: str) -> None:
    words = words_here(place, line)
    if words[:2] == ["stopset", "monitor"]:
        place.stack.enter_context(running(*words[1:]))
        assert wait(lambda: listens(place.port(words[-1]))), f"{line}: never listened"
        return
    if SERVES.match(line):
        with running(*words[1:]) as process:
            wait(lambda: (answers(int(words[-1])) and written(place, words)) or process.poll() is not None)
            assert process.poll() is None, f"{line}: {process.communicate()[1]}"
            assert answers(int(words[-1])), f"{line}: its page does not answer"
        assert process.returncode == 0, f"{line} ended with {process.returncode}"
    else:
        if words[:2] == ["stopset", "reset"]:  # each sample that leaves the model is a violation of its own
            for process in place.replays:
                process.terminate()
                process.wait(timeout=60)
        done = run(words, place.folder)
        assert done.returncode == (line in SAYS_NO), (
            f"{line} ended with {done.returncode}: {done.stdout[-500:]}{done.stderr[-1000:]}"
        )
    assert written(place, words), f"{line} did not write all of {promised(words)}"


# ---- the tests -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kit")


@pytest.fixture
def place(kit: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Place]:
    monkeypatch.chdir(tmp_path)
    with contextlib.ExitStack() as stack:
        yield Place(kit, tmp_path, stack)


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in LINES if run_here(p)])
def test_every_command_of_a_page_runs(page: str, place: Place) -> None:
    place.page = page
    lines = run_here(page)
    for k, line in enumerate(lines):
        type_line(place, line)
        if not any(map(BESIDE.match, lines[k + 1 :])):
            place.stack.close()


@pytest.mark.slow
def test_a_command_that_is_broken_is_noticed(place: Place) -> None:
    for line, says in (
        ("stopset identify --robot arm.urdf --data recording.parquet --out arm.model.json", "ended with 2"),
        ("stopset inspect recordings.parquet --out summary.txt", "ended with 2"),
        ("python benchmarks/no_such_script.py", "ended with 2"),
        ("ip link set can0 up", "the reason in NOT_HERE"),
    ):
        with pytest.raises(AssertionError, match=says):
            type_line(place, line)


@pytest.mark.parametrize("line", NOT_HERE)
def test_what_is_not_run_cannot_be(line: str) -> None:
    """Its page still says it; what it lacks is not here; and a script that is only long takes the options it is given."""
    reason, lacking = NOT_HERE[line]
    assert line in ALL, f"no page says {line}: take it from the list"
    if lacking and (Path(lacking).exists() or shutil.which(lacking)):
        pytest.skip(f"{lacking} is here, but is not ours to try: {reason}")
    if reason == MINUTES:
        words = shlex.split(line)
        helped = run(["python", str(ROOT / words[1]), "--help"], ROOT)
        assert helped.returncode == 0, helped.stderr
        assert all(w in helped.stdout for w in words if w.startswith("--")), helped.stdout


def test_what_another_test_types_has_that_test() -> None:
    assert set(ELSEWHERE) <= ALL and set(WHOLE_PAGES) <= set(LINES)
    for test in {*ELSEWHERE.values(), *WHOLE_PAGES.values()}:
        file, name = test.split("::")
        assert f"def {name}(" in (ROOT / "tests" / file).read_text(encoding="utf-8"), test


def test_the_run_script_passes_a_command_on(tmp_path: Path) -> None:
    """In a clone that `./run test` has set up: nothing is installed again, by a package index that nobody may reach."""
    script = (ROOT / "run").read_text(encoding="utf-8")
    for name in ("run", "pyproject.toml", "hatch_build.py"):
        shutil.copy(ROOT / name, tmp_path)
    shutil.copytree(ROOT / "model", tmp_path / "model", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / ".venv").mkdir()
    (tmp_path / ".venv/bin").symlink_to(Path(sys.executable).parent)
    installed = re.findall(r"^sum=.*", script, re.M)[0] + '; : > ".venv/installed-all,test-$sum"'
    subprocess.run(["sh", "-c", installed], cwd=tmp_path, check=True)
    words = ["sh", "-x", "run", "identify", "--help"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0 and "--robot" in done.stdout and "-m pip" not in done.stderr, done.stderr
