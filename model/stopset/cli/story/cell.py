"""A cell on loopback: the arm's recordings are replayed as if it moved, a monitor watches it, a consumer believes what it may."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from stopset.cli.story.telling import PATIENCE, process, until
from stopset.monitor.config import load_config
from stopset.monitor.consumer import Expected
from stopset.monitor.layout import State, unpack
from stopset.monitor.links.zenoh_link import ZenohLink
from stopset.monitor.viewer import View

ARM = "demo/cell/arm"
DATA_ID = 4711  # of the simulated arm's messages: a consumer knows its source by it
CYCLE_S = 0.004
# the controller of the simulated cell ramps down in 0.35 s; its safety relay takes the power after 0.5 s whatever happens (SS1-t)
RAMP_S, OFF_AFTER_S = 0.35, 0.5


@dataclass(frozen=True, slots=True)
class MonitoredCell:
    """Its configuration file, the monitor's address, and how the arm's states reach the monitor (``to``: options of replay)."""

    out: Path
    config: Path
    endpoint: str
    to: tuple[str, ...]

    @classmethod
    def built(cls, out: Path, *, can: bool) -> MonitoredCell:
        """Signed models alone; the arm on a CAN bus, or as joint states on zenoh where no bus profile knows it."""
        hub, port = _free_port(), _free_port()
        endpoint, key = f"tcp/127.0.0.1:{port}", f"{ARM}/joint_states"
        source = f'[bus]\nlink = "hub:{hub}"\nwait_s = 600\n' if can else f'[joint_states]\nkey = "{key}"\ncycle_s = {CYCLE_S}\n'
        site, cell, arm = ARM.split("/")
        config = out / "arm.toml"
        config.write_text(
            f'model = "arm.model.json"\nsite = "{site}"\ncell = "{cell}"\narm = "{arm}"\ndata_id = {DATA_ID}\n\n{source}\n'
            f'[zenoh]\nlisten = ["{endpoint}"]\n\n'
            # a demonstration shares its machine with everything else; a daemon's own machine is held to 30 ms
            "[publish]\nvalid_for_ms = 1000\nstale_ms = 2000\n\n"
            f"[stops]\nramp_time_s = {RAMP_S}\nramp_off_after_s = {OFF_AFTER_S}\n\n"
            '[signed]\nkeys = ["release.pub"]\nleast_revision = 0\n'
        )
        # of an earlier demonstration in this folder; a journal that is gone while what remembers it stands is a latched violation
        for old in (out / "arm.latch", *out.glob(".arm.latch.*"), *(out / "arm.record").glob("violation-*")):
            old.unlink(missing_ok=True)
        to = ("--to", f"hub:{hub}", "--wait", "1") if can else ("--to", f"zenoh:{endpoint}", "--key", key)
        return cls(out, config, endpoint, to)

    @contextlib.contextmanager
    def moving(self, name: str, *more: str) -> Iterator[None]:
        """The arm moves as it was recorded, until the block ends."""
        with process("replay", str(self.out / f"{name}.parquet"), *self.to, *more):
            yield

    def put_in_place(self, model: Path, signature: Path | None = None) -> None:
        """A model and its signature (or another's) under the monitor's name: the signature first, each whole."""
        place = self.out / "arm.model.json"
        for source, target in ((signature or sig(model), sig(place)), (model, place)):
            new = target.with_name(target.name + ".new")
            new.write_bytes(source.read_bytes())
            new.replace(target)

    @property
    def evidence(self) -> list[Path]:
        """Files that violations left on the disk."""
        return sorted((self.out / "arm.record").glob("violation-*.mcap"))


def sig(model: Path) -> Path:
    """Where the signature of a model file stands."""
    return Path(f"{model}.sig")


@dataclass(frozen=True, slots=True)
class Heard:
    """One state message: when it came [s], of which life of the monitor, and its number there."""

    at: float
    state: State
    life: int
    seq: int


class Subscriber:
    """What a consumer of the monitor hears and believes."""

    def __init__(self, cell: MonitoredCell) -> None:
        c = load_config(cell.config)
        self.endpoint = cell.endpoint
        self.view = View(expected=Expected(c.data_id, None, int(c.sha256[:16], 16), None))  # whichever model is rolled out
        self.events: list[dict[str, Any]] = []
        self.states: list[Heard] = []
        self.samples: list[Counter[str]] = []  # by the state that was published of them, as the monitor counts
        self.link: ZenohLink | None = None

    def listen(self) -> None:
        """As soon as the monitor can be reached; anew after it was killed."""
        self.close()
        self.samples, begun = [], time.monotonic()
        until(self._reachable, "the monitor listens", 2.0 * PATIENCE)
        self.link = link = ZenohLink(f"{ARM}/stopset", mode="client", connect=[self.endpoint])
        self.view.ask = lambda nonce: link.put("challenge", nonce)
        link.subscribe("state", self._state)
        link.subscribe("state/json", self._words)
        link.subscribe("event", lambda _, data: self.events.append(json.loads(data)))
        until(lambda: self.states and self.states[-1].at > begun, "the monitor publishes its state")
        self.events += self.not_heard()  # what it had said before anybody could listen

    def _reachable(self) -> bool:
        host, _, port = self.endpoint.removeprefix("tcp/").rpartition(":")
        with contextlib.suppress(OSError), socket.create_connection((host, int(port)), timeout=1):
            return True
        return False

    def _state(self, key: str, data: bytes) -> None:
        m = unpack(data)
        self.states.append(Heard(time.monotonic(), State(m["state"]), m["boot_id"], m["seq"]))
        self.view.take_state(key, data)

    def _words(self, key: str, data: bytes) -> None:
        self.samples.append(Counter(json.loads(data)["states"]))
        self.view.take_json(key, data)

    def says(self, word: str) -> bool:
        """Whether that is what may be believed now."""
        return self.view.word()[0] == word

    @property
    def life(self) -> int:
        """Of the monitor that is heard now."""
        return self.states[-1].life

    def event(self, kind: str) -> dict[str, Any] | None:
        """The first of its kind."""
        return next((e for e in list(self.events) if e["kind"] == kind), None)

    def said(self, life: int, after: float, before: float = float("inf")) -> list[State]:
        """States of a life's messages numbered above ``after``, up to ``before``."""
        return [h.state for h in list(self.states) if h.life == life and after < h.seq <= before]

    def longest_silence(self, first: int, last: int | None = None) -> float:
        """Between two messages of this life of the monitor [s], of those heard from number ``first`` on up to ``last``."""
        heard = [h.at for h in self.states[max(first - 1, 0) : last] if h.life == self.life]
        return max((b - a for a, b in pairwise(heard)), default=0.0)

    def counted(self, first: int, last: int) -> Counter[str]:
        """Of the samples from number ``first`` up to ``last`` of the monitor's life, how many were published in which state."""
        seen = [Counter(), *self.samples]
        begin, end = ([c for c in seen if c.total() <= n][-1] for n in (first, last))
        return end - begin

    def not_heard(self) -> list[dict[str, Any]]:
        """Events that the monitor itself remembers, and gives to whoever asks, but that never came."""
        assert self.link is not None
        heard = {(e["kind"], e["t_ns"]) for e in self.events}
        remembered = [e for _, data in self.link.get("event") for e in json.loads(data)]
        return [e for e in remembered if (e["kind"], e["t_ns"]) not in heard]

    def close(self) -> None:
        """Listen no more."""
        if self.link is not None:
            self.link.close()


def _free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])
