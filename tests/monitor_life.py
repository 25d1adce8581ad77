"""What happens in a daemon's life, once each and then several times, with the collector off: what is left for it, and what is imported.

``python tests/monitor_life.py`` prints, as JSON, per event the objects that only the collector would free and the modules that were
imported while samples waited. In a process of its own, as one that has run tests has imported everything.
"""

from __future__ import annotations

import gc
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

import numpy as np
from msgspec import structs

import stopset.monitor.service  # noqa: F401 - whatever the daemon has imported when its loop begins
from monitor_arm import DT, known_model, motion
from stopset.artifact import load_model, save_model
from stopset.errors import BusError, NotCovered
from stopset.monitor.clearing import REACTION
from stopset.monitor.config import Bus, Config, Publish, Records, Stops
from stopset.monitor.daemon import Beside, Daemon
from stopset.monitor.evidence.overheard import Overheard
from stopset.monitor.evidence.recorder import Recorder
from stopset.monitor.evidence.trace import Trace
from stopset.monitor.journal import Journal
from stopset.monitor.journal_file import FileStore
from stopset.monitor.latch import Latch, Record
from stopset.monitor.opening import Opening
from stopset.monitor.sample import Quantum, Sample

TIMES = 3
LONGEST = 60.0  # [s] that a model is waited for


class Wire:
    """Takes what is said; ``handlers`` by key."""

    def __init__(self) -> None:
        self.handlers: dict[str, Callable[[str, bytes], None]] = {}

    def fast(self, name: str) -> Callable[[bytes], None]:
        return lambda data: None

    def put(self, name: str, data: bytes | str, *, must_arrive: bool = False) -> None:
        """Gone."""

    def subscribe(self, name: str, handler: Callable[[str, bytes], None]) -> None:
        self.handlers[name] = handler

    serve = alive = lambda *_: None


@dataclass
class Life:
    """A daemon with a recorder and a journal in ``folder``, its stop process beside it, and the arm's samples by script."""

    folder: Path
    script: list[Sample | type[Exception]] = field(default_factory=list)
    quantum: Quantum = field(default_factory=lambda: Quantum.none(6))
    dropped: int = 0
    k: int = 0

    def __post_init__(self) -> None:
        path, self.wire, self.motion = self.folder / "arm.model.json", Wire(), motion(0, 4000)
        self.model = save_model(known_model(horizon=0.1), path)
        config = Config(
            str(path),
            Bus("hub:1"),
            data_id=7,
            stops=Stops(("0",)),
            publish=Publish(valid_for_ms=5000, json_hz=1e9),
            sha256="ab" * 32,
        )
        records = Records(continuous=True, folder=str(self.folder), file_s=0.0, keep_mb=1.0)  # another file at every turn
        self.recorder = Recorder(Trace(6), records, self.folder, DT, pause=lambda: None)
        latch = Latch(Journal(FileStore(self.folder / "latch.journal", Record())))
        beside = Beside(latch=latch, load=lambda: load_model(path), recorder=self.recorder)
        self.daemon = Daemon(config, self.model, self, Overheard(self.wire, self.recorder), DT, beside)

    def next(self, timeout: float) -> Sample | None:
        """The source's: a sample, or the error that is due; at the end the daemon shall stop."""
        if not self.script:
            self.daemon.stopping = True
            return None
        if isinstance(self.script[0], Sample):
            return structs.replace(self.script.pop(0), t=time.time())  # type: ignore[type-var]
        raise self.script.pop(0)("as it happens")  # type: ignore[operator]

    def counters(self) -> dict[str, int]:
        return {}

    def complaints(self) -> list[str]:
        return []

    def heard(self, first: float, last: float) -> list[tuple[float, int, bytes]]:
        return [(first, 0x181, b"\0" * 8)]

    def close(self) -> None:
        """The source's."""

    def samples(self, count: int, off: float = 0.0) -> list[Sample]:
        out, r = [], self.motion
        for _ in range(count):
            i = self.k % len(r.t)
            out.append(Sample(self.k, 0.0, r.q[i] + off, r.dq[i], r.tau[i]))
            self.k += 1
        return out

    def live(self, *script: Sample | type[Exception]) -> None:
        self.script.extend(script)
        self.daemon.stopping, self.daemon._next_health = False, 0.0
        self.daemon.run(lambda: self)
        self.recorder.turn()

    # ---- what happens

    def quiet(self) -> None:
        self.live(*self.samples(20))

    def gap(self) -> None:
        self.k += 20
        self.live(*self.samples(5))

    def violation_and_reset(self) -> None:
        self.live(*self.samples(200), *self.samples(170, 0.3))
        assert self.daemon.latch.latched
        self.recorder.turn(last=True)
        self.k += 2000  # nothing is predicted across so long a gap
        self.live(*self.samples(5))
        time.sleep(REACTION)  # nobody orders sooner
        self.wire.handlers["reset"]("reset", b'{"name": "A. Person", "reason": "seen"}')
        self.live(*self.samples(5))
        assert not self.daemon.latch.latched

    def refused_orders(self) -> None:
        for data in (b"", b'{"name": "\xff"}', b"[" * 5000):
            self.wire.handlers["reset"]("reset", data)
            self.live(*self.samples(2))

    def challenge(self) -> None:
        self.wire.handlers["challenge"]("challenge", b"12345678")
        self.live(*self.samples(2))

    def error_in_the_loop(self) -> None:
        self.live(ValueError, *self.samples(3))

    def error_in_the_check(self) -> None:
        first, *rest = self.samples(3)
        self.live(structs.replace(first, q=np.zeros(7)), *rest)

    def lost_bus(self) -> None:
        self.live(BusError, *self.samples(3))

    def bus_that_does_not_open(self) -> None:
        answers: list[Life | None] = [None, self]

        def begin() -> Life:
            if (answer := answers.pop(0)) is None:
                error = BusError("not there")
                error.args = (*error.args, error)  # as drivers leave circles
                raise error
            return answer

        self.script.extend([BusError, *self.samples(3)])
        self.daemon.stopping = False
        self.daemon.run(Opening(begin).turn)
        assert not answers

    def another_model(self) -> None:
        before, end = self.daemon.desk, time.monotonic() + LONGEST
        self.daemon.reloading.asked = True
        while self.daemon.desk is before and time.monotonic() < end:
            self.live(*self.samples(2))
        assert self.daemon.desk is not before
        time.sleep(0.3)  # the old one ends beside the loop

    def refused_model(self) -> None:
        def none() -> None:
            raise NotCovered("not this one")

        reloading = self.daemon.reloading
        load, reloading.load, reloading.asked = reloading.load, none, True  # type: ignore[assignment]
        while reloading.asked or reloading._working:
            self.live(*self.samples(2))
        reloading.load = load


EVENTS = (
    Life.quiet, Life.gap, Life.violation_and_reset, Life.refused_orders, Life.challenge, Life.error_in_the_loop,
    Life.error_in_the_check, Life.lost_bus, Life.bus_that_does_not_open, Life.another_model, Life.refused_model,
)  # fmt: skip


def left_over(life: Life) -> Iterator[tuple[str, dict[str, object]]]:
    """By event: what only the collector freed after `TIMES` of it, and what was imported from its first time on."""
    for event in EVENTS:
        before = set(sys.modules)
        gc.collect()
        gc.disable()
        for _ in range(TIMES):
            event(life)
        yield event.__name__, {"circles": gc.collect(), "modules": sorted(set(sys.modules) - before)}
        gc.enable()


def main() -> None:
    with tempfile.TemporaryDirectory() as place, redirect_stderr(StringIO()):
        life = Life(Path(place))
        found = dict(left_over(life))
        life.daemon.close()
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main()
