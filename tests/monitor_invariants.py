"""What holds in every life of the monitor, whatever happens around it: one function per promise, over a `World` that was lived.

Each yields sentences about what broke it; none is the promise kept.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from itertools import pairwise

from monitor_arm import DT
from monitor_world import BUS_OFF, LOOK, RECOVER, VALID, Published, World
from stopset.monitor.daemon import PATIENCE
from stopset.monitor.layout import Flag, State

GOOD = (State.OK, State.DEGRADED)
HEARTBEAT = PATIENCE + 2 * DT + 0.02  # [s] longest silence of a daemon that is allowed to run
SLACK = 20 * LOOK  # [s] from the look at the clock to the message


def lives(world: World) -> Iterator[list[Published]]:
    """The messages of each start."""
    for life in range(1, world.life + 1):
        if published := [t for t in world.published if t.life == life]:
            yield published


def nothing_comes_out_of_the_daemon(world: World) -> Iterator[str]:
    yield from world.errors


def nothing_fails_inside(world: World) -> Iterator[str]:
    """The daemon tells an error of its own as FAULT and lives on: not of anything that happens here."""
    for event in map(json.loads, world.slow.get("event", [])):
        if event["kind"] == "fault" and event["why"] != BUS_OFF:
            yield f"{event['t_ns']}: {event['why']}"


def never_ok_on_old_data(world: World) -> Iterator[str]:
    for t in world.published:
        if t.m["state"] in GOOD and t.at - t.sampled > VALID + SLACK + t.stood:
            yield f"{t.at:.3f}: {State(t.m['state']).name} on data {t.at - t.sampled:.3f} s old"


def no_consumer_believes_old_data(world: World) -> Iterator[str]:
    for at, state, sampled in world.believed:
        if state in GOOD and at - sampled > VALID + SLACK:
            yield f"{at:.3f}: a consumer believes {state.name} on data {at - sampled:.3f} s old"


def never_ok_when_a_drive_is_not_good(world: World) -> Iterator[str]:
    for before, t in pairwise(world.published):
        # the word of the drive came a whole cycle before, to a daemon that was listening
        if not before.drives_good and before.life == t.life and t.m["state"] in GOOD and t.at - before.at < 1.0:
            known = [x for x in world.published if not x.drives_good and x.life == t.life]
            if t.at - known[0].at > 5 * DT + VALID:
                yield f"{t.at:.3f}: {State(t.m['state']).name} with a drive in an emergency or stopped"


def heartbeat_is_never_late(world: World) -> Iterator[str]:
    for published in lives(world):
        for a, b in pairwise(published):
            if b.at - a.at > HEARTBEAT + b.stood:
                yield f"{b.at:.3f}: silent for {b.at - a.at:.3f} s"


def messages_are_numbered(world: World) -> Iterator[str]:
    for published in lives(world):
        if [t.m["seq"] for t in published] != list(range(len(published))) or len({t.m["boot_id"] for t in published}) != 1:
            yield f"life {published[0].life}: numbers or boot id are not those of one life"


def the_latch_is_never_lost(world: World) -> Iterator[str]:
    latched, cleared = False, 0
    for a, t in pairwise(world.published):
        latched |= bool(a.m["flags"] & Flag.VIOLATION_LATCHED)
        if latched and not t.m["flags"] & Flag.VIOLATION_LATCHED and t.resets > cleared:
            latched, cleared = False, t.resets
        if latched and not t.m["flags"] & Flag.VIOLATION_LATCHED:
            yield f"{t.at:.3f}: the latch is gone"
        if t.m["flags"] & Flag.VIOLATION_LATCHED and t.m["state"] not in (State.VIOLATION, State.FAULT, State.SHUTDOWN):
            yield f"{t.at:.3f}: {State(t.m['state']).name} while latched"


def the_count_never_goes_back(world: World) -> Iterator[str]:
    """Not by a kill either; a loss of power may take up to a second of it, a reset all."""
    if world.torn or world.faults.disk_error:
        return
    for a, t in pairwise(world.published):
        cleared = t.resets and not t.m["flags"] & Flag.VIOLATION_LATCHED
        if t.m["violation_count"] < a.m["violation_count"] and not cleared:
            yield f"{t.at:.3f}: {t.m['violation_count']} violations after {a.m['violation_count']}"


def a_good_arm_is_not_accused(world: World) -> Iterator[str]:
    if world.torn or world.faults.disk_error:  # what the disk never got may have been a violation
        return
    for t in world.published:
        if t.m["flags"] & Flag.VIOLATION_LATCHED and t.at < world.altered_at:
            yield f"{t.at:.3f}: a violation, and the arm is as it was identified"
            return


def ok_comes_back_only_after_good_cycles(world: World) -> Iterator[str]:
    for published in lives(world):
        since = published[0].at
        for t in published:
            if t.m["state"] not in GOOD and not t.m["flags"] & Flag.RECOVERING:
                since = t.at
            if t.m["state"] == State.OK and t.at - since < RECOVER - SLACK:
                yield f"{t.at:.3f}: OK {t.at - since:.3f} s after {since:.3f}"


def numbers_are_withdrawn(world: World) -> Iterator[str]:
    for t in world.published:
        if t.m["stop0_provable"] and t.m["state"] not in (*GOOD, State.UNKNOWN):
            yield f"{t.at:.3f}: proven numbers in state {State(t.m['state']).name}"


INVARIANTS: tuple[Callable[[World], Iterator[str]], ...] = (
    nothing_comes_out_of_the_daemon, nothing_fails_inside, never_ok_on_old_data, no_consumer_believes_old_data, never_ok_when_a_drive_is_not_good,
    heartbeat_is_never_late, messages_are_numbered, the_latch_is_never_lost, the_count_never_goes_back,
    a_good_arm_is_not_accused, ok_comes_back_only_after_good_cycles, numbers_are_withdrawn,
)  # fmt: skip


def broken(world: World) -> list[str]:
    """All that was broken, with the names of the promises."""
    return [f"seed {world.seed}: {f.__name__}: {words}" for f in INVARIANTS for words in list(f(world))[:3]]
