"""A recording as live traffic: CANopen frames by a profile, or ``joint_states`` on zenoh, in real time or faster."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from stopset.errors import RecordingError
from stopset.monitor.jointstate import JointState, to_cdr, to_json
from stopset.monitor.links.bus import Talker
from stopset.monitor.links.canopen_map import Encoder
from stopset.monitor.profile import SIGNALS, Profile
from stopset.recording import Recording
from stopset.types import Array

PAUSE_CYCLES = 8  # silence between two trials: the arm jumps there, and the listener must see a gap
UNEVEN = 0.05  # of the period
OPERATION_ENABLED, QUICK_STOP, SWITCHED_OFF = 0x27, 0x07, 0x40


class Sink(Protocol):
    """Takes sample after sample. ``pause``: lets cycles pass unseen; ``stamped``: samples carry their stamps, which need not be even."""

    @property
    def stamped(self) -> bool: ...
    def sample(self, values: Array, stamp_ns: int) -> None: ...
    def pause(self, cycles: int) -> None: ...
    def close(self) -> None: ...


@dataclass(slots=True)
class CanSink:
    """SYNC and TPDOs on a CAN bus."""

    bus: Talker
    encoder: Encoder
    frames: int = 0

    @property
    def stamped(self) -> bool:
        """A SYNC says when, and comes in an even cycle."""
        return False

    @classmethod
    def of(cls, bus: Talker, profile: Profile) -> CanSink:
        return cls(bus, Encoder(profile))

    def sample(self, values: Array, stamp_ns: int) -> None:
        for cob_id, data in self.encoder.frames(values):
            self.bus.send(cob_id, data)
            self.frames += 1

    def pause(self, cycles: int) -> None:
        self.encoder.skip(cycles)

    def close(self) -> None:
        self.bus.close()


@dataclass(slots=True)
class JointStateSink:
    """``joint_states`` by a put function.

    The message has no word for drives that hold no torque: it then names none, as a driver should, and whoever listens judges nothing.
    """

    put: Callable[[bytes], None]
    joints: tuple[str, ...]
    cdr: bool = False
    frames: int = 0

    @property
    def stamped(self) -> bool:
        """A header says when."""
        return True

    def sample(self, values: Array, stamp_ns: int) -> None:
        q, dq, tau, _, status = (tuple(row.tolist()) for row in values)
        state = JointState(stamp_ns, self.joints, q, dq, tau if set(status) <= {OPERATION_ENABLED} else ())
        self.put(to_cdr(state) if self.cdr else to_json(state))
        self.frames += 1

    def pause(self, cycles: int) -> None:
        """Stamps show the gap."""

    def close(self) -> None:
        """The session belongs to the caller."""


def signal_rows(r: Recording) -> Array:
    """(N, signals, n) SI values of a trial in the order of `SIGNALS`, with the statusword its phase would show."""
    n = r.q.shape[1]
    out = np.full((len(r.t), len(SIGNALS), n), np.nan)
    out[:, 0], out[:, 1], out[:, 2] = r.q, r.dq, r.tau
    if r.temp is not None:
        out[:, 3] = r.temp
    out[:, 4] = OPERATION_ENABLED
    if r.stop_trigger is not None and r.phase in ("stop0", "stop1"):
        out[r.stop_trigger, 4] = SWITCHED_OFF if r.phase == "stop0" else QUICK_STOP
    return out


def steps_of(r: Recording, *, stamped: bool) -> Array:
    """(N,) time [s] from each sample of a trial to the next: its period, where that is even, else as the samples are ``stamped``.

    Raises `RecordingError` for uneven samples without stamps, because a bus cycle is even.
    """
    dt = np.diff(r.t)
    period = float(np.median(dt))
    worst = float(np.abs(dt - period).max())
    if worst <= UNEVEN * period:
        return np.full(len(r.t), period)
    if not stamped:
        raise RecordingError(
            f"{r.label} is sampled every {period * 1e3:.4g} ms but for {worst * 1e3:.3g} ms of difference; a bus needs an even "
            "cycle: resample it, or send it as joint_states (--to zenoh:ENDPOINT), which carry their stamps"
        )
    return np.append(dt, period)


def play(
    trials: Iterable[Recording],
    sink: Sink,
    speed: float = 1.0,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> tuple[int, float]:
    """Send every sample at its time / ``speed`` (``inf``: at once); returns samples sent and the worst lateness [s].

    A late sample is sent late and the rest keeps its rhythm from there: frames are never bunched to catch up. Stamps keep the
    recording's rhythm within a trial; each trial is stamped from when it begins, or what was late would stay late for ever.
    """
    sent, worst = 0, 0.0
    stamp = time.time_ns()
    due = clock()
    for r in trials:
        steps = steps_of(r, stamped=sink.stamped)
        if np.isfinite(speed):
            stamp = max(stamp, time.time_ns() + round(max(0.0, due - clock()) * 1e9))
        for values, step in zip(signal_rows(r), steps.tolist(), strict=True):
            wait = due - clock()
            if wait > 0:
                sleep(wait)
            elif sent and np.isfinite(speed):
                worst = max(worst, -wait)
                due = clock()
            sink.sample(values, stamp)
            sent += 1
            due += step / speed
            stamp += round(step * 1e9)
        sink.pause(PAUSE_CYCLES)
        due += PAUSE_CYCLES * steps[-1] / speed
        stamp += round(PAUSE_CYCLES * steps[-1] * 1e9)
    return sent, worst
