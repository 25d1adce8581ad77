"""A hundred lives of the monitor in a world where things go wrong, and every promise kept in each; more in a benchmark."""

from __future__ import annotations

from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path

import pytest

from monitor_arm import known_model
from monitor_invariants import broken
from monitor_world import World
from stopset.artifact import Model, load_model, save_model
from stopset.monitor import daemon, status
from stopset.monitor.journal import Journal
from stopset.monitor.latch import Latch
from stopset.monitor.layout import State
from stopset.monitor.nodes import Nodes
from stopset.monitor.status import Recovery

SEEDS = 100
SOME = (1, 6, 15, 26)  # seeds in which processes are killed, buses fail, violations are classed and reset
Live = Callable[[int], World]


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Live:
    path = tmp_path_factory.mktemp("world") / "arm.model.json"
    model: Model = save_model(known_model(horizon=0.1), path)
    return lambda seed: World(seed, path, model).live()


def test_a_hundred_lives_keep_every_promise(live: Live) -> None:
    seen: set[State] = set()
    for seed in range(SEEDS):
        world = live(seed)
        assert not (found := broken(world)), "\n".join(found)
        seen |= {State(t.m["state"]) for t in world.published}
    assert seen >= {State.OK, State.DEGRADED, State.UNKNOWN, State.VIOLATION, State.FAULT, State.INIT}, "the lives are not idle"


@pytest.mark.parametrize("seed", [611749, 611917, 660556, 800243])
def test_a_life_that_once_broke_a_promise_keeps_it(seed: int, live: Live) -> None:
    """An emergency said before the bus was lost was forgotten; a start between two late frames mixed two cycles;
    a clock set forward hid that a message came late; an order that was under way cleared an emergency that came after it."""
    assert not broken(live(seed))


Said = dict[int, list[tuple[str, float, bytes]]]


def said(path: Path, seeds: tuple[int, ...]) -> Said:
    """All that was said in the last of the lives of each seed, lived in this order; longer than a second, in which ``health`` comes again."""
    model = load_model(path)
    return {seed: World(seed, path, model, seconds=1.2).live().said for seed in seeds}


def test_a_seed_gives_the_same_bytes_first_later_and_in_a_new_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In processes with another hash seed each, the last with memory that is never zero before it is written."""
    path, again, spawn = tmp_path / "arm.model.json", (SOME[-1], *SOME), get_context("spawn")
    save_model(known_model(horizon=0.1), path)
    with spawn.Pool(1, maxtasksperchild=1) as pool:
        first = {seed: pool.apply(said, (path, (seed,)))[seed] for seed in SOME}
        later = [pool.apply(said, (path, SOME)), pool.apply(said, (path, again[::-1]))]
    monkeypatch.setenv("MALLOC_PERTURB_", "165")
    with spawn.Pool(1) as pool:
        later.append(pool.apply(said, (path, again)))
    for lived in (*later, said(path, SOME)):
        for seed in SOME:
            found = next((k for k, (a, b) in enumerate(zip(first[seed], lived[seed], strict=False)) if a != b), None)
            assert found is None, f"seed {seed}, {found} messages on: {first[seed][found]} and then {lived[seed][found]}"
            assert len(first[seed]) == len(lived[seed])
    assert {name for seed in SOME for name, _, _ in first[seed]} == {"state", "state/json", "health", "event", "echo"}
    assert len({tuple(x) for x in first.values()}) == len(SOME)


def ages_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    real = status.decide
    forget = {"age": 0.0, "since": 0.0, "stale": False, "late": False}
    monkeypatch.setattr(
        daemon,
        "decide",
        lambda s, limits: real(status.Situation(**{f: forget.get(f, getattr(s, f)) for f in s.__slots__}), limits),
    )


def no_recovery(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Recovery, "hold", lambda self, state, why, now, ahead: (state, 0, why))


def latch_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Latch, "save", lambda self, now: None)
    monkeypatch.setattr(Journal, "count", lambda self, counts: None)


def drives_unheard(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Nodes, "bad", lambda self, now: (0, ""))


def test_a_bus_that_comes_back_counts_anew(live: Live) -> None:
    """In this life the reopened bus numbers its first sample one above the last one before: 0.3 s lie between them."""
    assert not (found := broken(live(5475))), "\n".join(found)


def test_a_cycle_in_doubt_is_not_given_out_because_the_bus_ends(live: Live) -> None:
    """In this life a SYNC is lost, the next cycle's first frame completes the one before, and then the bus goes off."""
    assert not (found := broken(live(5466))), "\n".join(found)


def emergencies_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Latch, "hear", lambda self, emergencies: None)


@pytest.mark.parametrize(
    ("mutant", "promise"),
    [
        (ages_ignored, "never_ok_on_old_data"),
        (no_recovery, "ok_comes_back_only_after_good_cycles"),
        (latch_in_memory, "the_latch_is_never_lost"),
        (drives_unheard, "never_ok_when_a_drive_is_not_good"),
        (emergencies_in_memory, "never_ok_when_a_drive_is_not_good"),
    ],
)
def test_mutants_break_their_promise(
    live: Live, monkeypatch: pytest.MonkeyPatch, mutant: Callable[[pytest.MonkeyPatch], None], promise: str
) -> None:
    mutant(monkeypatch)
    assert any(promise in words for seed in (*range(60), 512, 912, 938) for words in broken(live(seed)))
