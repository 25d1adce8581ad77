"""The drill: something changes at an arm, and everything that must happen then does, with processes killed on the way.

    python deploy/checks/drill.py OUT [--robot arm.urdf] [--hide spring:bend]

A healthy arm is identified and watched: OK. Then it changes: VIOLATION, kept through a killed monitor, with a file of evidence. The
diagnosis names the effect, it is added, the sets shrink below what they would be without it, the signed revision is rolled out while
the monitor runs (an unsigned one is refused), a person clears the latch, and it is OK again. Every step is a command as anybody would
type it; what the monitor said stands in OUT/events.jsonl. Ends with 0, or with the sentence that did not hold.
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

from stopset.artifact import load_model
from stopset.monitor.config import load_config
from stopset.monitor.consumer import Expected
from stopset.monitor.layout import State, unpack
from stopset.monitor.links.zenoh_link import ZenohLink
from stopset.monitor.viewer import View
from stopset.recording import read_meta, read_recordings, write_recordings

TRIALS = 6  # replayed


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
        self.states: list[tuple[float, State, int]] = []  # when, which, of which life
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
        told = unpack(data)
        self.states.append((time.monotonic(), State(told["state"]), told["boot_id"]))
        self.view.take_state(key, data)

    def says(self, word: str) -> bool:
        """Whether that is what may be believed now."""
        return self.view.word()[0] == word

    def kinds(self) -> list[str]:
        return [str(e["kind"]) for e in self.events]

    def close(self) -> None:
        if self.link is not None:
            self.link.close()


def recorded(out: Path, robot: str, hide: str) -> None:
    """The arm before and after something changed, and a few of its motions to replay."""
    for name, effect in (("healthy", "none"), ("altered", hide)):
        words = ("--hide", effect, "--plan", "compact", "--size", "large", "--seed", "1", "--quiet")
        run("simulate", "--robot", robot, *words, "--out", str(out / name))
        data = out / name / "recording.parquet"
        trials = read_recordings(data).phase("open_loop").trials[:TRIALS]
        write_recordings(out / f"{name}.parquet", read_meta(data), trials)


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


def drill(out: Path, robot: str, hide: str, tell: Callable[[str], None] = print) -> list[str]:
    """The whole story; the kinds of the monitor's events in their order."""
    out.mkdir(parents=True, exist_ok=True)
    recorded(out, robot, hide)
    first, second, plain = (out / f"{name}.model.json" for name in ("first", "second", "unexplained"))
    healthy, altered = (str(out / name / "recording.parquet") for name in ("healthy", "altered"))
    run(
        "identify",
        "--robot",
        str(out / "healthy" / "robot.urdf"),
        "--data",
        healthy,
        "--out",
        str(first),
        "--accept-wide",
        "--quiet",
    )
    run("sign", "--new-key", str(out / "release"))
    run("sign", str(first), "--key", str(out / "release"))
    put_in_place(out, first)
    tell("identified and signed")
    ear = Ear(configured(out))
    try:
        _lived(out, ear, tell, hide, (first, second, plain), altered)
    except Failed as e:
        raise Failed(f"{e} (the monitor says {': '.join(ear.view.word())})") from e
    finally:
        ear.close()
        (out / "events.jsonl").write_text("".join(json.dumps(e) + "\n" for e in ear.events))
    return ear.kinds()


def _lived(out: Path, ear: Ear, tell: Callable[[str], None], hide: str, models: tuple[Path, Path, Path], altered: str) -> None:
    first, second, plain = models
    config, to = str(out / "arm.toml"), f"zenoh:tcp/127.0.0.1:{ear.port}"

    def replayed(name: str) -> Any:
        return running("replay", str(out / f"{name}.parquet"), "--to", to, "--key", "drill/joint_states", "--loop")

    with running("monitor", "--config", config):
        ear.listen()
        with replayed("healthy"):
            until(lambda: ear.says("OK"), "the healthy arm is OK")
            tell("the healthy arm is OK")
        with replayed("altered"):  # the first replay was killed: the arm stood still, then moves as another one
            until(lambda: State.VIOLATION in [s for _, s, _ in ear.states], "the changed arm is a VIOLATION")
            latched = time.monotonic()
            until(lambda: "bundle" in ear.kinds(), "the violation is classed")
            found = next(e["cause"]["kind"] for e in ear.events if e["kind"] == "bundle")
            bundle = until(lambda: sorted((out / "arm.record").glob("violation-*.mcap")), "evidence is on the disk")[0]
            tell(f"VIOLATION, class {found}, evidence {bundle.name}")
    with contextlib.ExitStack() as stack:
        monitor = stack.enter_context(running("monitor", "--config", config))  # killed, and begun anew
        ear.listen()
        stack.enter_context(replayed("altered"))
        until(lambda: ear.says("VIOLATION"), "the violation outlives the killed monitor")
        tell("still VIOLATION after kill -9")
        _explained(out, bundle, hide, models, altered, tell)
        put_in_place(out, plain)  # the wrong one: nobody signed it
        Path(f"{out / 'arm.model.json'}.sig").write_bytes(Path(f"{first}.sig").read_bytes())
        os.kill(monitor.pid, signal.SIGHUP)
        until(lambda: "reload_refused" in ear.kinds(), "a model that nobody signed is refused")
        run("sign", str(second), "--key", str(out / "release"))
        put_in_place(out, second)
        before = len(ear.states)
        os.kill(monitor.pid, signal.SIGHUP)
        until(lambda: "reloaded" in ear.kinds(), "the signed revision is taken")
        time.sleep(0.5)
        window = [t for t, _, _ in ear.states[before - 1 :]]
        gap = max(b - a for a, b in pairwise(window))
        hold(gap < 1.0, f"the messages go on while a model is rolled out, the longest gap was {gap:.2f} s")
        hold(all(s is not State.OK for t, s, _ in ear.states if t > latched), "nothing is OK before a person has looked")
        tell(f"rolled out without a gap (longest {1000 * gap:.0f} ms), still not OK")
        words = (
            "--name",
            "A. Smith",
            "--reason",
            "a hose was laid, the model knows it now",
            "--connect",
            f"tcp/127.0.0.1:{ear.port}",
        )
        run("reset", *words)
        until(lambda: ear.says("OK"), "the arm with its new model is OK", 60.0)
        tell("OK again")


def _explained(
    out: Path, bundle: Path, hide: str, models: tuple[Path, Path, Path], altered: str, tell: Callable[[str], None]
) -> None:
    """From the evidence to a revision whose sets are smaller than what the effect would cost unexplained."""
    first, second, plain = models
    run("compare", str(first), "--data", str(bundle), "--quiet", good=(0, 1))
    run("diagnose", str(first), "--data", altered, "--quiet", "--json", str(out / "diagnosis.json"))
    ranked = json.loads((out / "diagnosis.json").read_text())["ranked_effects"]
    named = [f"{r['effect']}:{r['joint']}" if r["joint"] else r["effect"] for r in ranked]
    hold(named[:1] == [hide], f"the diagnosis names {hide} first, it said {', '.join(named) or 'nothing'}")
    told = run("add", str(first), hide, "--data", altered, "--out", str(second), "--quiet")
    hold("revision 1" in told, "the effect is added")
    robot = str(out / "healthy" / "robot.urdf")
    run("identify", "--robot", robot, "--data", altered, "--out", str(plain), "--friction", "plain", "--accept-wide", "--quiet")
    a, b = widths(plain), widths(second)
    hold(b < 0.7 * a, f"the sets shrink: U {b:.3g} N m with the effect, {a:.3g} N m without")
    tell(f"{hide} named and added: U {a:.3g} -> {b:.3g} N m")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--robot", default="lwa4p")
    parser.add_argument("--hide", default="spring:arm_4_joint")
    args = parser.parse_args()
    start = time.monotonic()

    def tell(text: str) -> None:
        print(f"[{time.monotonic() - start:5.1f} s] {text}", flush=True)

    try:
        drill(args.out, args.robot, args.hide, tell)
    except Failed as e:
        print(f"the drill failed: it did not hold that {e}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
