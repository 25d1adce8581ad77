"""``stopset demo``: the whole story on a simulated arm, with the commands a user would type."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import io
import json
import shlex
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Self

import numpy as np

from stopset.cli.common import say

HELP = "the whole story on a simulated arm: no file, no hardware, no network; a few minutes"

HIDDEN = "spring:arm_4_joint"  # a dress pack that nobody told the model about
ARM = "demo/cell/arm"
SPEED = 1.0  # of the replay, times real time: bounds are computed as fast as on a real cell, not faster
TRIALS = 2  # replayed, twice over
DATA_ID = 4711  # of the simulated arm's messages: a consumer knows its source by it
# the controller of the simulated cell ramps down in 0.35 s; its safety relay takes the power after 0.5 s whatever happens (SS1-t)
RAMP_S, OFF_AFTER_S = 0.35, 0.5
SCALED, FACTOR = 2, 1.5  # joint (from 0) whose torque is scaled in the altered replay, and by how much


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("--out", type=Path, default=Path("stopset-demo"), help="where pages and files go (default stopset-demo)")


def _answer(line: str) -> bool:
    """What a comparison says first: whether the sets hold, and where the model fails."""
    return "the predicted sets" in line and not line.startswith(" ")


Lines = Callable[[str], bool]  # of the lines that a command printed


class Story:
    """Runs commands as a user would, telling which and how long each took."""

    def __init__(self, out: Path) -> None:
        self.out, self.start, self.step = out, time.monotonic(), 0

    def chapter(self, text: str) -> None:
        self.step += 1
        say(f"\n[{time.monotonic() - self.start:5.1f} s] {self.step}. {text}")

    def do(self, *words: str, keep: Lines = lambda _: False, good: tuple[int, ...] = (0,)) -> None:
        """Run one command in this process, its chatter hidden except the lines that ``keep`` wants."""
        from stopset.cli.main import main

        say("    $ stopset " + shlex.join(words))
        printed, reported = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(reported):
            code = main(list(words))
        _ended(words[0], code, good, reported.getvalue())
        _show(printed.getvalue(), keep)

    def collect(self, begun: Future[str], keep: Lines = lambda _: False) -> None:
        """What a command printed that was begun `Asides` others, as far as ``keep`` wants it."""
        _show(begun.result(), keep)


class Asides:
    """Commands that run one after another in processes of their own, behind whatever else the machine has to do."""

    def __init__(self) -> None:
        self._line = ThreadPoolExecutor(1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._line.shutdown(cancel_futures=kind is not None)

    def begin(self, *words: str, good: tuple[int, ...] = (0,)) -> Future[str]:
        """Run this once those before it have ended; gives what it printed."""
        say("    $ stopset " + shlex.join(words) + " &")
        return self._line.submit(_aside, words, good)


def _aside(words: tuple[str, ...], good: tuple[int, ...]) -> str:
    behind = ["nice"] if shutil.which("nice") else []
    done = subprocess.run(
        [*behind, sys.executable, "-m", "stopset.cli.main", *words], capture_output=True, text=True, check=False
    )
    _ended(words[0], done.returncode, good, done.stderr)
    return done.stdout


def _ended(command: str, code: int, good: tuple[int, ...], reported: str) -> None:
    from stopset.errors import StopsetError

    if code not in good:
        kind = StopsetError if code in (1, 2) else RuntimeError  # a defect of a step is one of the whole
        raise kind(f"`stopset {command}` ended with {code}: {reported.strip().splitlines()[-1:]}")


def _show(printed: str, keep: Lines) -> None:
    for line in printed.splitlines():
        if keep(line):
            say("      " + line)


def run(args: argparse.Namespace) -> int:
    """Tell the story; every file stays in ``--out``."""
    from stopset.errors import OutputError

    out: Path = args.out
    if out.exists() and not out.is_dir():
        raise OutputError(f"--out {out} is a file; expected a directory: choose another name")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise OutputError(f"--out {out} cannot be created ({e.strerror}); choose another place") from e
    story, second = Story(out), str(out / "second.model.json")
    _modelled(story, second)
    data = str(out / "recording.parquet")
    from stopset.fmu.build import native

    with Asides() as beside:  # what only computes, while the arm moves in its own time
        story.chapter(
            "Compared again, revisions side by side, and how far it goes when it is stopped (tables as ISO 10218-1 asks)."
        )
        again = beside.begin("compare", second, "--data", data, "--report", str(out / "compare-second.html"), good=(0, 1))
        beside.begin("history", second, "--report", str(out / "history.html"))
        beside.begin("stops", second, "--report", str(out / "stops.html"), "--json", str(out / "stops.json"))
        story.chapter("The model leaves the house as an FMU.")
        exported = beside.begin("export-fmu", second, "--out", str(out / "arm.fmu"), "--platform", str(native()))
        _monitored(story, out, second)
        story.chapter("What was computed meanwhile:")
        story.collect(again, keep=_answer)
        story.collect(exported)
    _closing(out, time.monotonic() - story.start)
    return 0


def _modelled(story: Story, second: str) -> None:
    """From the simulated cell's recordings to a model with the effect that was missing."""
    out = story.out
    robot, data, first = (str(out / name) for name in ("robot.urdf", "recording.parquet", "first.model.json"))
    story.chapter("A Schunk LWA-4P in a simulated cell is measured. Something pulls at one of its joints; the model is not told.")
    hidden = ("--hide", HIDDEN, "--size", "large", "--plan", "motions", "--seed", "3")
    story.do("simulate", "--robot", "lwa4p", *hidden, "--out", str(out), keep=lambda x: "recordings" in x)
    story.chapter("A reachset-conformant model is identified from the recordings.")
    story.do("identify", "--robot", robot, "--data", data, "--out", first, keep=lambda x: x.startswith(("sum of U", "All ")))
    with Asides() as beside:
        story.chapter("Model and measurements are compared: where does it fail?")
        fails = beside.begin("compare", first, "--data", data, "--report", str(out / "compare-first.html"), good=(0, 1))
        answer = out / "diagnosis.json"
        story.chapter("Which physical effect is missing?")
        story.do("diagnose", first, "--data", data, "--json", str(answer), "--report", str(out / "diagnosis.html"), good=(0, 1))
        story.collect(fails, keep=_answer)
    found = json.loads(answer.read_text())
    for row in found["ranked_effects"][:3]:
        say(f"      {row['effect']} at {row['joint']}: {row['says']}")
    story.chapter("It is added, and the errors fall.")
    if not found["ranked_effects"]:
        from stopset.errors import StopsetError

        raise StopsetError(f"the diagnosis names nothing ({found['verdict']}); expected the hidden spring: please report this")
    best = found["ranked_effects"][0]
    where = ("--joint", best["joint"]) if best["joint"] else ()
    story.do(
        "add", first, best["effect"], *where, "--data", data, "--out", second,
        keep=lambda x: "->" in x or x.startswith(("at ", "over ", "revision")),
    )  # fmt: skip


def _monitored(story: Story, out: Path, model: str) -> None:
    """Replay onto CAN, monitor, and watch from a third process, once as recorded and once altered."""
    from stopset.recording import read_meta, read_recordings, write_recordings

    whole = read_recordings(out / "recording.parquet").phase("open_loop")
    trials = whole.trials[:TRIALS]
    meta = read_meta(out / "recording.parquet")
    scaled = np.ones(len(meta.joints))
    scaled[SCALED] = FACTOR
    # a cell repeats its motions: the second time round the stop bounds of the first are there
    again = [dataclasses.replace(r, trial=max(t.trial for t in trials) + 1 + k) for k, r in enumerate(trials)]
    write_recordings(out / "healthy.parquet", meta, [*trials, *again])
    write_recordings(out / "altered.parquet", meta, (dataclasses.replace(r, tau=r.tau * scaled) for r in trials))
    for name, says in (
        ("healthy", "as recorded, twice over"),
        ("altered", f"with the torque of {meta.joints[SCALED]} scaled by {FACTOR}"),
    ):
        story.chapter(f"The monitor listens on CAN and publishes on zenoh; the arm moves {says}.")
        last = _session(out, name, model)
        say(f"      {last['word']}: {last['text']}")


def _session(out: Path, name: str, model: str) -> dict[str, Any]:
    """Three processes on loopback; returns the last state another process saw on zenoh."""
    from stopset.errors import BusError
    from stopset.monitor.links.zenoh_link import ZenohLink

    hub, port = _free_port(), _free_port()
    config = out / f"{name}.toml"
    site, cell, arm = ARM.split("/")
    config.write_text(
        f'model = "{Path(model).name}"\nsite = "{site}"\ncell = "{cell}"\narm = "{arm}"\ndata_id = {DATA_ID}\n\n'
        f'[bus]\nlink = "hub:{hub}"\ntime_scale = {SPEED}\n\n[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]\n\n'
        # a demonstration shares its machine with everything else; a daemon's own machine is held to 30 ms
        "[publish]\nvalid_for_ms = 1000\nstale_ms = 2000\n\n"
        f"[stops]\nramp_time_s = {RAMP_S}\nramp_off_after_s = {OFF_AFTER_S}\n"
    )
    (out / f"{name}.latch").unlink(missing_ok=True)  # of an earlier demonstration in this folder
    seconds = 60
    twin: dict[str, Any] = {}
    counts: list[dict[str, int]] = []  # of samples by the state that was told of them
    with contextlib.ExitStack() as stack:
        words = ("replay", str(out / f"{name}.parquet"), "--to", f"hub:{hub}", "--speed", str(SPEED), "--wait", "1")
        replay = stack.enter_context(_process(*words))
        monitor = stack.enter_context(_process("monitor", "--config", str(config), "--seconds", str(seconds)))
        deadline = time.monotonic() + seconds
        link = None
        while link is None and time.monotonic() < deadline and monitor.poll() is None:
            try:
                link = ZenohLink(f"{ARM}/stopset", mode="client", connect=[f"tcp/127.0.0.1:{port}"])
            except BusError:
                time.sleep(0.1)
        if link is None:
            raise BusError(f"the monitor did not start: {_said(monitor)}")

        def take(_key: str, data: bytes) -> None:
            new = json.loads(data)
            counts.append(new.get("states", {}))
            # once the replay ends the bus falls silent and the state is FAULT, as it must be; what held before is told
            twin.update(new | ({"state": twin["state"]} if new["state"] == "FAULT" and "state" in twin else {}))

        link.subscribe("state/json", take)
        # a violation is latched: nothing that comes after it changes what is told
        while time.monotonic() < deadline and not any(p.poll() is not None for p in (replay, monitor)) and not latched(twin):
            time.sleep(0.05)
        time.sleep(1.0)  # for the last state to arrive
        link.close()
    return _outcome(twin, counts)


def latched(twin: dict[str, Any]) -> bool:
    """Whether a violation was seen, which stands until somebody takes it back."""
    return bool(twin.get("violation_latched"))


def _outcome(twin: dict[str, Any], counts: list[dict[str, int]]) -> dict[str, Any]:
    """What the other process saw, in words: the state that held longest the second time round, and what came between."""
    if latched(twin):
        text = f"a zenoh subscriber sees the violation, at {', '.join(twin['violating_joints'])}; stop numbers are withdrawn"
        return {"word": twin["state"], "text": text}
    totals = [sum(c.values()) for c in counts]
    if not totals or not totals[-1]:
        return {"word": "no state", "text": "nothing of the arm came over zenoh"}
    first = [{}, *(c for c, n in zip(counts, totals, strict=True) if 2 * n <= totals[-1])][-1]
    second = {k: v - first.get(k, 0) for k, v in counts[-1].items() if v > first.get(k, 0)}
    word = max(second, key=lambda k: second[k])
    said = ", ".join(f"{v} {k}" for k, v in sorted(second.items(), key=lambda x: -x[1]))
    text = f"a zenoh subscriber sees {twin['verdicts']['CONFORMANT']} conformant samples and no violation; the second time round {said}"
    if len(second) > 1:
        text += " (where one recorded motion ends and the next begins, OK has to be earned anew)"
    return {"word": word, "text": text}


@contextlib.contextmanager
def _process(*words: str) -> Iterator[subprocess.Popen[str]]:
    say("    $ stopset " + shlex.join(words))
    process = subprocess.Popen(
        [sys.executable, "-m", "stopset.cli.main", *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _said(process: subprocess.Popen[str]) -> str:
    return process.stdout.read().strip()[-300:] if process.stdout is not None else ""


def _free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


PAGES = {
    "compare-first.html": "the first model against the measurements: where it fails",
    "diagnosis.html": "which effect is missing, and why",
    "compare-second.html": "the model with the effect added",
    "history.html": "how each revision lowered the errors",
    "stops.html": "stop distances and times, speed x payload x extension",
    "second.model.json": "the model file that monitor and FMU know the arm from",
    "healthy.toml": "a monitor's configuration",
    "arm.fmu": "the FMU; simulate it with any FMI 3 tool",
    "truth.json": "what was hidden",
}


def _closing(out: Path, seconds: float) -> None:
    say(f"\nDone in {seconds:.0f} s. Open:")
    for name, what in PAGES.items():
        if (out / name).exists():
            say(f"  {out / name!s:<38} {what}")
    say("Monitoring aid, not a certified safety function: see the README before you rely on a number.")
