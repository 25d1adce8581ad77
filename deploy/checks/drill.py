"""The drill: something changes at an arm, and everything that must happen then does, with processes killed on the way.

    python deploy/checks/drill.py OUT [--robot arm.urdf] [--hide spring:turn]

A healthy arm is identified and watched: OK. Then it changes: VIOLATION, kept through a killed monitor, with a file of evidence. The
diagnosis names the effect, it is added, errors, sets and stop bound shrink below what they are without it, the signed revision is rolled
out while the monitor runs (an unsigned one is refused), a person clears the latch, and it is OK again, and stays so. Every step is a
command as anybody would type it; what was done and what the monitor said stand in OUT/events.jsonl. Ends with 0, or with the sentence
that did not hold.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from stopset.artifact import load_model
from stopset.monitor.config import load_config
from stopset.monitor.consumer import Expected
from stopset.monitor.layout import State, unpack
from stopset.monitor.links.zenoh_link import ZenohLink
from stopset.monitor.viewer import View
from stopset.recording import read_meta, read_recordings, write_recordings

TRIALS = 6  # replayed
LIKELY = 20.0  # [%] a new motion may leave the sets with, at most
HOLDS = 15.0  # [s] it must stay good afterwards: every replayed motion once
STAYS = 0.3  # of the messages, on a machine that is busy with everything else


class Failed(Exception):
    """A sentence of the story that did not hold."""


def hold(holds: object, sentence: str) -> None:
    """The story goes on only while it is true."""
    if not holds:
        raise Failed(sentence)


def until(holds: Callable[[], Any], sentence: str, seconds: float = 40.0) -> Any:
    """Wait for it."""
    end = time.monotonic() + seconds
    while not (found := holds()):
        hold(time.monotonic() < end, sentence)
        time.sleep(0.02)
    return found


def command(*words: str) -> list[str]:
    return [sys.executable, "-m", "stopset.cli.main", *words]


def run(*words: str, good: Sequence[int] = (0,)) -> str:
    """A command to its end; what it said."""
    done = subprocess.run(command(*words), capture_output=True, text=True, check=False)
    hold(done.returncode in good, f"stopset {words[0]} ended with {done.returncode}: {done.stderr.strip()[-300:]}")
    return done.stdout


@contextlib.contextmanager
def running(*words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A command until the block ends, killed without a chance to say goodbye."""
    process = subprocess.Popen(command(*words), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


class Ear:
    """What a consumer of the monitor hears and believes."""

    def __init__(self, config: Path) -> None:
        c = load_config(config)
        self.port = int(c.zenoh.listen[0].rpartition(":")[2])
        self.view = View(expected=Expected(c.data_id, None, int(c.sha256[:16], 16), None))  # whichever model is rolled out
        self.events: list[dict[str, Any]] = []
        self.states: list[tuple[float, State, int, int]] = []  # when, which, of which life, its number there
        self.link: ZenohLink | None = None

    def listen(self) -> None:
        """As soon as the monitor can be reached; anew after it was killed."""
        self.close()
        until(self._reachable, "the monitor listens")
        self.link = link = ZenohLink("site/cell/arm/stopset", mode="client", connect=[f"tcp/127.0.0.1:{self.port}"])
        self.view.ask = lambda nonce: link.put("challenge", nonce)
        link.subscribe("state", self._state)
        link.subscribe("state/json", self.view.take_json)
        link.subscribe("event", lambda _, data: self.events.append(json.loads(data)))

    def _reachable(self) -> bool:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), timeout=1):
            return True
        return False

    def _state(self, key: str, data: bytes) -> None:
        reported = unpack(data)
        self.states.append((time.monotonic(), State(reported["state"]), reported["boot_id"], reported["seq"]))
        self.view.take_state(key, data)

    def progress(self, text: str) -> None:
        """A step of the drill, among the monitor's own events."""
        self.events.append({"kind": "step", "t_ns": time.time_ns(), "why": text})

    def says(self, word: str) -> bool:
        """Whether that is what may be believed now."""
        return self.view.word()[0] == word

    def kinds(self) -> list[str]:
        return [str(e["kind"]) for e in list(self.events)]

    def of(self, kind: str) -> dict[str, Any]:
        """The first event of this kind."""
        return next(e for e in self.events if e["kind"] == kind)

    def said(self, life: int, after: float, before: float = float("inf")) -> list[State]:
        """States of a life's messages numbered above ``after``, up to ``before``."""
        return [s for _, s, boot, seq in list(self.states) if boot == life and after < seq <= before]

    def remembered(self) -> list[dict[str, Any]]:
        """The events that the monitor itself gives to whoever asks."""
        assert self.link is not None
        return [e for _, data in self.link.get("event") for e in json.loads(data)]

    def close(self) -> None:
        if self.link is not None:
            self.link.close()


def recorded(out: Path, robot: str, hide: str) -> None:
    """The arm before and after something changed, and a few of its motions to replay: those in which the joint goes farthest."""
    for name, effect in (("healthy", "none"), ("altered", hide)):
        words = ("--hide", effect, "--plan", "motions", "--size", "large", "--seed", "1", "--quiet")
        run("simulate", "--robot", robot, *words, "--out", str(out / name))
        data = out / name / "recording.parquet"
        meta = read_meta(data)
        joint = meta.joints.index(hide.partition(":")[2])
        trials = sorted(read_recordings(data).phase("open_loop").trials, key=lambda r: -float(np.ptp(r.q[:, joint])))
        write_recordings(out / f"{name}.parquet", meta, trials[:TRIALS])


def configured(out: Path) -> Path:
    """The monitor's configuration: signed models alone, a source and an outlet on loopback."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    config = out / "arm.toml"
    config.write_text(
        'model = "arm.model.json"\ndata_id = 4711\n[joint_states]\nkey = "drill/joint_states"\ncycle_s = 0.004\n'
        f'[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]\n[publish]\nvalid_for_ms = 1000\nstale_ms = 2000\n'
        '[stops]\ncategories = ["0"]\n[signed]\nkeys = ["release.pub"]\nleast_revision = 0\n'
    )
    return config


def put_in_place(out: Path, model: Path) -> None:
    """A model and its signature under the monitor's name: the signature first, each whole."""
    for suffix in (".sig", ""):
        source, target = Path(f"{model}{suffix}"), Path(f"{out / 'arm.model.json'}{suffix}")
        if source.is_file():
            new = target.with_name(target.name + ".new")
            new.write_bytes(source.read_bytes())
            new.replace(target)


def widths(model: Path) -> float:
    """Sum of the widths of U [N m]."""
    return float(load_model(model).powered.U.width.sum())


def asked(name: str, out: Path, *words: str) -> Any:
    """A command's answer for machines."""
    file = out / f"{name}.json"
    run(*words, "--quiet", "--json", str(file), good=(0, 1))
    return json.loads(file.read_text())


def drill(out: Path, robot: str, hide: str, progress: Callable[[str], None] = print) -> list[dict[str, Any]]:
    """The whole story; the drill's steps and the monitor's events in their order."""
    out.mkdir(parents=True, exist_ok=True)
    recorded(out, robot, hide)
    ear = Ear(configured(out))

    def step(text: str) -> None:
        ear.progress(text)
        progress(text)

    try:
        first = identified(out, step)
        _lived(out, ear, step, hide, first)
    except Failed as e:
        raise Failed(f"{e} (the monitor says {': '.join(ear.view.word())})") from e
    finally:
        ear.close()
        (out / "events.jsonl").write_text("".join(json.dumps(e) + "\n" for e in ear.events))
    return ear.events


def identified(out: Path, progress: Callable[[str], None]) -> Path:
    """The healthy arm's model, in place and signed; its promise on new motions means something."""
    first = out / "first.model.json"
    words = ("--robot", str(out / "healthy" / "robot.urdf"), "--data", str(out / "healthy" / "recording.parquet"))
    run("identify", *words, "--out", str(first), "--accept-wide", "--quiet")
    promise = asked("healthy", out, "compare", str(first), "--data", words[3])["guarantee"]
    most = 100.0 * promise["upper_bound"]
    hold(promise["violated"] == 0 and most <= LIKELY, f"a new motion leaves the sets with at most {LIKELY:g} %: {most:.1f} %")
    run("sign", "--new-key", str(out / "release"))
    run("sign", str(first), "--key", str(out / "release"))
    put_in_place(out, first)
    progress(
        f"identified and signed: of {promise['motions']} motions held out none leaves the sets, a new one with at most {most:.1f} %"
    )
    return first


def _lived(out: Path, ear: Ear, progress: Callable[[str], None], hide: str, first: Path) -> None:
    config, to = str(out / "arm.toml"), f"zenoh:tcp/127.0.0.1:{ear.port}"

    def replayed(name: str) -> Any:
        return running("replay", str(out / f"{name}.parquet"), "--to", to, "--key", "drill/joint_states", "--loop")

    with running("monitor", "--config", config):
        ear.listen()
        with replayed("healthy"):
            until(lambda: ear.says("OK"), "the healthy arm is OK")
            progress("the healthy arm is OK")
        with replayed("altered"):  # the first replay was killed: the arm stood still, then moves as another one
            until(lambda: "violation" in ear.kinds(), "the changed arm is a VIOLATION")
            until(lambda: "bundle" in ear.kinds(), "the violation is classed")
            found = ear.of("bundle")["cause"]["kind"]
            bundle = until(lambda: sorted((out / "arm.record").glob("violation-*.mcap")), "evidence is on the disk")[0]
            progress(f"VIOLATION, class {found}, evidence {bundle.name}")
        life = ear.states[-1][2]
        hold(State.OK not in ear.said(life, ear.of("violation")["seq"]), "nothing is OK after the violation")
    with contextlib.ExitStack() as stack:
        monitor = stack.enter_context(running("monitor", "--config", config))  # killed, and begun anew
        ear.listen()
        stack.enter_context(replayed("altered"))
        until(lambda: ear.says("VIOLATION"), "the violation outlives the killed monitor")
        progress("still VIOLATION after kill -9")
        second, plain = _explained(out, bundle, hide, first, progress)
        _rolled_out(out, ear, monitor.pid, progress, (first, second, plain))
        _cleared(ear, progress)


def _explained(out: Path, bundle: Path, hide: str, first: Path, progress: Callable[[str], None]) -> tuple[Path, Path]:
    """From the evidence to a revision whose errors, sets and stop are smaller than what the effect would cost unexplained."""
    altered, joint = str(out / "altered" / "recording.parquet"), hide.partition(":")[2]
    second, plain = out / "second.model.json", out / "unexplained.model.json"
    run("compare", str(first), "--data", str(bundle), "--quiet", good=(0, 1))
    ranked = asked("diagnosis", out, "diagnose", str(first), "--data", altered)["ranked_effects"]
    named = [f"{r['effect']}:{r['joint']}" if r["joint"] else r["effect"] for r in ranked]
    hold(named[:1] == [hide], f"the diagnosis names {hide} first, it said {', '.join(named) or 'nothing'}")
    run("add", str(first), hide, "--data", altered, "--out", str(second), "--quiet")
    before, after = (asked(m.name, out, "compare", str(m), "--data", altered)["joints"][joint] for m in (first, second))
    values = []
    for name, what, unit in (("torque_rmse", "torque error", "N m"), ("position_rmse", "open-loop error", "rad")):
        a, b = before[name], after[name]
        hold(b <= 0.5 * a, f"the {what} of {joint} is at least halved: {a:.3g} -> {b:.3g} {unit}")
        values.append(f"{what} {a:.3g} -> {b:.3g} {unit}")
    robot = str(out / "healthy" / "robot.urdf")
    run("identify", "--robot", robot, "--data", altered, "--out", str(plain), "--friction", "plain", "--accept-wide", "--quiet")
    a, b = widths(plain), widths(second)
    hold(b < 0.7 * a, f"the sets shrink: U {b:.3g} N m with the effect, {a:.3g} N m without")
    values.append(f"U without the effect {a:.3g}, with it {b:.3g} N m")
    a, b = (farthest(m, out, joint) for m in (plain, second))
    hold(b < 0.9 * a, f"the stop bound of {joint} shrinks: {b:.3g} rad with the effect, {a:.3g} rad without")
    progress(f"{hide} named and added: {', '.join(values)}, STOP 0 {a:.3g} and {b:.3g} rad")
    return second, plain


def farthest(model: Path, out: Path, joint: str) -> float:
    """How far the joint goes on STOP 0 from the middle of what was recorded, at half its speed [rad]."""
    middle = ",".join(f"{x:.4f}" for x in load_model(model).domain.q.centre)
    rows = asked(f"stop-{model.name}", out, "stops", str(model), f"--at={middle}", "--speed", "50%", "--category", "0")
    return float(next(r["angle_rad"] for r in rows if r["joint"] == joint))


def _rolled_out(out: Path, ear: Ear, monitor: int, progress: Callable[[str], None], models: tuple[Path, Path, Path]) -> None:
    """A model that nobody signed is refused, the signed one taken; the messages go on, none says OK."""
    first, second, plain = models
    put_in_place(out, plain)  # under another's signature
    Path(f"{out / 'arm.model.json'}.sig").write_bytes(Path(f"{first}.sig").read_bytes())
    begin = len(ear.states)
    os.kill(monitor, signal.SIGHUP)
    until(lambda: "reload_refused" in ear.kinds(), "a model that nobody signed is refused")
    run("sign", str(second), "--key", str(out / "release"))
    put_in_place(out, second)
    os.kill(monitor, signal.SIGHUP)
    until(lambda: "reloaded" in ear.kinds(), "the signed revision is taken")
    time.sleep(0.5)
    gap = max(b - a for a, b in pairwise([t for t, *_ in ear.states[begin - 1 :]]))
    hold(gap < 1.0, f"the messages go on while a model is rolled out, the longest gap was {gap:.2f} s")
    progress(f"rolled out without a gap (longest {1000 * gap:.0f} ms), still not OK")


def _cleared(ear: Ear, progress: Callable[[str], None]) -> None:
    """A person clears it; from then on it is OK and stays so, before it never was; no event was lost."""
    words = ("--name", "A. Smith", "--reason", "a hose was laid, the model knows it now")
    run("reset", *words, "--connect", f"tcp/127.0.0.1:{ear.port}")
    cleared = until(lambda: "reset" in ear.kinds() and ear.of("reset"), "the reset is told")["seq"]
    life = ear.states[-1][2]
    hold(State.OK not in ear.said(life, -1, cleared), "nothing is OK before a person has looked")
    until(lambda: ear.says("OK"), "the arm with its new model is OK", 60.0)
    progress("OK again")
    time.sleep(HOLDS)
    after = ear.said(life, cleared)
    hold(State.VIOLATION not in after[1:], "no VIOLATION comes back with the new model")
    good = after.count(State.OK) / len(after)  # where one recorded motion ends and the next begins, OK has to be earned anew
    hold(good > STAYS, f"it stays OK in {STAYS:.0%} of the messages, it was {good:.0%}")
    heard = {(e["kind"], e["t_ns"]) for e in ear.events}
    lost = [e for e in ear.remembered() if (e["kind"], e["t_ns"]) not in heard]
    hold(not lost, f"every event the monitor remembers was heard, not heard: {lost[:2]}")
    progress(f"no VIOLATION within {HOLDS:g} s, {good:.0%} of the messages OK, no event lost")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--robot", default="lwa4p")
    parser.add_argument("--hide", default="spring:arm_4_joint", metavar="EFFECT:JOINT")
    args = parser.parse_args()
    start = time.monotonic()

    def progress(text: str) -> None:
        print(f"[{time.monotonic() - start:5.1f} s] {text}", flush=True)

    try:
        drill(args.out, args.robot, args.hide, progress)
    except Failed as e:
        print(f"the drill failed: it did not hold that {e}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
