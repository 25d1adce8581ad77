"""CAN logs (candump, ASC, BLF, TRC, also .gz): played back as far as drives have said it, or decoded into recordings."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from stopset.errors import RecordingError
from stopset.monitor.links.canopen_map import frame_maps
from stopset.monitor.links.decoder import Decoder
from stopset.monitor.links.logfile import LOG_SUFFIXES, log_suffix, read_log
from stopset.monitor.nodes import EMCY, HEARTBEAT
from stopset.monitor.profile import Profile
from stopset.monitor.sample import Sample
from stopset.monitor.source import CycleCount, sample_of
from stopset.recording import Meta, Recording

__all__ = ["LOG_SUFFIXES", "log_meta", "log_suffix", "play_log", "said_by_drives", "trials_of_log"]
SHORTEST = 10  # samples; a shorter run between two gaps is not a trial
LONGEST_PAUSE = 3600.0  # [s] of the log without a frame that is played; a longer one is two logs in one file, or a damaged stamp


def said_by_drives(profile: Profile) -> frozenset[int]:
    """COB-IDs that may be played onto a bus: SYNC, and PDOs, emergencies and heartbeats of the profile's nodes.

    Commands (NMT, SDO, RPDO) of a log would move a real arm, or stop it.
    """
    nodes = profile.nodes.values()
    return frozenset({profile.sync_id, *frame_maps(profile), *(EMCY + n for n in nodes), *(HEARTBEAT + n for n in nodes)})


def play_log(
    path: Path,
    send: Callable[[int, bytes], None],
    speed: float,
    profile: Profile,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> tuple[int, int]:
    """Send what the drives of ``profile`` say in a log, at its times / ``speed``; returns how many frames, and how many not.

    Raises `RecordingError` for a log that cannot be read, or pauses for over `LONGEST_PAUSE`.
    """
    start: tuple[float, float] | None = None
    count, withheld, allowed, before = 0, 0, said_by_drives(profile), math.inf
    for frame in read_log(path):
        if frame.cob_id not in allowed:
            withheld += 1
            continue
        if frame.t - before > LONGEST_PAUSE:
            raise RecordingError(
                f"{path}: no frame for {frame.t - before:.4g} s of its time after {count} frames; expected one recording without such a "
                "pause: cut the log there"
            )
        now, before = clock(), frame.t
        if start is None:
            start = (frame.t, now)
        wait = start[1] + (frame.t - start[0]) / speed - now
        if wait > 0:
            sleep(wait)
        send(frame.cob_id, bytes(frame.data))
        count += 1
    return count, withheld


def trials_of_log(path: Path, profile: Profile, cycle_s: float, suite: int = 0) -> Iterator[Recording]:
    """Every unbroken run of powered cycles as one trial; time is the cycle count, because SYNC is the clock of the samples.

    Raises `RecordingError` when the log holds no run, or no torque.
    """
    decoder, count = Decoder(profile, cycle_s), CycleCount(cycle_s, profile.sync_overflow)
    run: list[Sample] = []
    trial = 0
    for frame in read_log(path):
        cycle = decoder.frame(frame.cob_id, frame.data, frame.t)
        if cycle is None:
            continue
        sample = sample_of(cycle, count(cycle))
        if run and (sample.k != run[-1].k + 1 or not sample.powered):
            if len(run) >= SHORTEST:
                yield _recording(run, suite, trial, cycle_s)
                trial += 1
            run = []
        if sample.powered:
            run.append(sample)
    if len(run) >= SHORTEST:
        yield _recording(run, suite, trial, cycle_s)
        trial += 1
    if not trial:
        raise RecordingError(
            f"{path}: {len(run)} samples in a row at most, {decoder.incomplete} incomplete cycles, {decoder.unknown} frames of "
            f"others; expected SYNC and the PDOs of profile {profile.name}: check profile, node ids and cycle"
        )


def _recording(run: list[Sample], suite: int, trial: int, cycle_s: float) -> Recording:
    if any(s.tau is None for s in run):
        raise RecordingError("the log carries no torque; expected a profile that maps it, such as lwa4p/monitor")
    temp = np.array([s.temp for s in run]) if all(s.temp is not None for s in run) else None
    t = np.asarray(cycle_s * np.arange(len(run)), dtype=np.float64)
    q, dq, tau = (np.array([getattr(s, name) for s in run]) for name in ("q", "dq", "tau"))
    return Recording("closed_loop", suite, trial, trial, t, q, dq, tau, temp=temp)


def log_meta(profile: Profile, cycle_s: float, effort: str) -> Meta:
    """Metadata of recordings made from a log; ``effort`` must be said by who knows the drives."""
    return Meta(
        joints=profile.joints, robot=profile.name, effort=effort, velocity="measured", clock="recorded", rate_hz=1 / cycle_s
    )
