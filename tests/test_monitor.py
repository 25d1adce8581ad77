"""The pure check and the message: what holds is never flagged, what does not is named, doubt is never OK."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from float32 import outward
from monitor_arm import DT, NOISE, U, known_model, motion, with_torque_scaled
from state_messages import pack
from stopset.effects.base import Fitted
from stopset.errors import BusError, NotCovered, OutputError
from stopset.monitor import plc, status
from stopset.monitor.certificates import Numbers
from stopset.monitor.config import ConfigError, load_config
from stopset.monitor.evidence.cause import Cause, Kind
from stopset.monitor.journal import Journal, blank
from stopset.monitor.journal_file import FileStore
from stopset.monitor.latch import Latch, Record
from stopset.monitor.layout import FIELDS, LENGTH, Flag, State, crc32c, offsets, outward_all, unpack
from stopset.monitor.packer import Changing, Packer
from stopset.monitor.profile import load_profile
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.source import CycleCount
from stopset.monitor.status import OkConditions, Recovery, Situation, believable
from stopset.monitor.verdict import Conformance, Verdict
from stopset.monitor.watch import Watch, check_cycle
from stopset.recording import Recording

ROOT = Path(__file__).resolve().parents[1]


def samples(r: Recording, k0: int = 0) -> list[Sample]:
    return [Sample(k0 + k, r.t[k], r.q[k], r.dq[k], r.tau[k]) for k in range(len(r.t))]


def verdicts(watch: Watch, *runs: list[Sample]) -> list[Verdict]:
    return [watch.step(s) for run in runs for s in run]


# ---- the check ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_an_arm_inside_its_sets_is_never_flagged(seed: int) -> None:
    out = verdicts(Watch(known_model()), samples(motion(seed)))
    assert [v.conformance for v in out] == [Conformance.UNKNOWN] + [Conformance.CONFORMANT] * (len(out) - 1)
    room = np.min([v.room for v in out if v.room is not None], axis=0)
    assert room.min() < 0.1, "the tube is not idle: corner disturbances come close to it"


@pytest.mark.parametrize("joint", range(6))
def test_a_wrong_torque_names_its_joint_and_no_other(joint: int) -> None:
    out = verdicts(Watch(known_model()), samples(with_torque_scaled(motion(1), joint, 1.5)))
    named = {d.joint for v in out for d in v.deviations}
    assert named == {known_model().joints[joint]}


@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_the_tube_that_is_shown_is_the_one_that_is_judged_by(factor: float) -> None:
    """A sample is between its ends exactly where the verdict says so, in every state."""
    watch = Watch(known_model())
    flagged = 0
    for s in samples(with_torque_scaled(motion(1), 3, factor)):
        v = watch.step(s)
        ends = watch.tube(s)
        if v.room is None:
            assert ends is None
            continue
        assert ends is not None
        x, bad = np.concatenate([s.q, s.dq]), {(d.state, d.joint, d.side) for d in v.deviations}
        names = [(state, j) for state in ("q", "dq") for j in known_model().joints]
        assert bad == {
            (*names[i], side)
            for i in range(12)
            for side, out in (("above", x[i] > ends[1][i]), ("below", x[i] < ends[0][i]))
            if out
        }
        flagged += bool(bad)
    assert bool(flagged) == (factor != 1.0)


@pytest.mark.parametrize("shrink", [0.8])
def test_mutant_with_a_smaller_set_is_refuted(shrink: float) -> None:
    """The test above has teeth: with U a fifth smaller the same motions do leave the tube."""
    m = known_model()
    c, r = U.centre, U.radius * shrink
    small = replace(m, sets={"powered": replace(m.powered, U=replace(U, lo=c - r, hi=c + r))})
    assert any(v.deviations for seed in range(5) for v in verdicts(Watch(small), samples(motion(seed))))


@pytest.mark.parametrize(("kick", "side"), [(0.3, "above"), (-0.3, "below")])
@pytest.mark.parametrize(("state", "joint"), [("q", 0), ("dq", 4)])
def test_each_side_of_each_state_is_held(kick: float, side: str, state: str, joint: int) -> None:
    run = samples(motion(2, 30))
    moved = getattr(run[-1], state) + kick * np.eye(6)[joint]
    watch = Watch(known_model())
    *_, v = verdicts(watch, [*run[:-1], structs.replace(run[-1], **{state: moved})])
    (d,) = v.deviations
    assert (d.joint, d.state, d.side) == (known_model().joints[joint], state, side)
    assert d.measured == moved[joint] and abs(d.measured - d.bound) == pytest.approx(d.excess)
    assert 0.5 * abs(kick) < d.excess < abs(kick) and (d.measured > d.bound) == (side == "above")


def test_every_age_up_to_the_horizon_is_compared() -> None:
    watch = Watch(known_model(horizon=0.4))
    out = verdicts(watch, samples(motion(0, 150)))
    assert [v.compared for v in out[:101]] == list(range(101)) and out[-1].compared == 100
    assert out[-1].oldest == pytest.approx(0.4)


@pytest.mark.parametrize("seed", range(4))
def test_lost_cycles_neither_hide_an_altered_arm_nor_accuse_a_good_one(seed: int) -> None:
    """One cycle in ten is lost, and with it the next, as when a frame is late: predictions are led across."""
    rng = np.random.default_rng(seed)
    for r, joints in ((motion(seed, 400), set()), (with_torque_scaled(motion(seed, 400), 2, 1.5), {"arm_3_joint"})):
        lost = set(rng.choice(400, 40, replace=False).tolist())
        run = [s for s in samples(r) if s.k not in lost and s.k - 1 not in lost]
        out = verdicts(Watch(known_model()), run)
        assert {d.joint for v in out for d in v.deviations} == joints
        assert max(v.oldest for v in out) > 0.35, "predictions live on"
    assert all(v.conformance is Conformance.UNKNOWN for v, a, b in zip(out[1:], run, run[1:], strict=False) if b.k != a.k + 1)


def test_a_gap_drops_predictions_and_gives_no_verdict() -> None:
    watch = Watch(known_model())
    first, second = samples(motion(0, 50)), samples(motion(1, 50), k0=60)
    out = verdicts(watch, first, second)
    assert out[50].conformance is Conformance.UNKNOWN and "gap" in out[50].why and out[50].compared == 0
    assert all(v.conformance is Conformance.CONFORMANT for v in out[51:])
    # without the gap being seen, the jump between the motions would be a violation
    glued = verdicts(Watch(known_model()), first, samples(motion(1, 50), k0=50))
    assert glued[50].conformance is Conformance.VIOLATION


def test_sets_that_conform_from_the_start_are_used_from_the_start_only() -> None:
    """Trap P15: such sets promise nothing for a restart in the middle."""
    out = verdicts(Watch(known_model(windows="start")), samples(motion(0, 80)))
    assert {v.compared for v in out[1:]} == {1}


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"tau": None}, "torque"),
        ({"powered": False}, "powered"),
        ({"q": np.full(6, np.nan)}, "not a number, or beyond 1e+06: q_arm_1_joint, q_arm_2_joint"),
        ({"tau": np.array([1.0, np.inf, 0, 0, 0, 0])}, "not a number, or beyond 1e+06: tau_arm_2_joint; look at"),
    ],
)
def test_no_verdict_is_unknown_and_forgets(change: dict[str, Any], word: str) -> None:
    watch = Watch(known_model())
    run = samples(motion(0, 30))
    verdicts(watch, run[:20])
    v = watch.step(structs.replace(run[20], **change))
    assert v.conformance is Conformance.UNKNOWN and word in v.why
    assert watch.step(run[21]).compared == 0, "predictions across it are dropped"


def test_outside_the_domain_is_named_and_not_conformant() -> None:
    m = known_model()
    d = m.domain
    hi = d.q.hi.copy()
    r = motion(0, 100)
    hi[4] = r.q[:50, 4].max()
    watch = Watch(replace(m, domain=replace(d, q=replace(d.q, hi=hi))))
    out = verdicts(watch, samples(r))
    beyond = r.q[:, 4] > hi[4]
    assert beyond.any() and not beyond.all()
    for v, far in zip(out[1:], beyond[1:], strict=True):
        assert v.outside == (("q_arm_5_joint",) if far else ())
        assert v.conformance is (Conformance.UNKNOWN if far else Conformance.CONFORMANT)


def test_payload_beyond_the_identified_one_is_unknown() -> None:
    assert "payload" in Watch(known_model(), payload=(2.0, 2.0)).step(samples(motion(0, 2))[0]).why


def test_an_error_inside_is_fault_and_nothing_survives_it() -> None:
    watch = Watch(known_model())
    run = samples(motion(0, 30))
    verdicts(watch, run[:20])
    v = watch.step(structs.replace(run[20], q=np.zeros(5)))
    assert v.conformance is Conformance.FAULT and v.why.startswith("the check failed")
    assert watch.step(run[21]).conformance is Conformance.UNKNOWN


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(1e-6, 1e-2))
def test_rounding_of_the_bus_never_flags_a_conformant_arm(seed: int, count: float) -> None:
    """Whatever the counts are worth: the tube grows by exactly what rounding can do."""
    scale = {"q": count * 1e-2, "dq": count, "tau": 10 * count}
    r = motion(seed, 120)
    rounded = replace(
        r,
        q=np.round(r.q / scale["q"]) * scale["q"],
        dq=np.round(r.dq / scale["dq"]) * scale["dq"],
        tau=np.round(r.tau / scale["tau"]) * scale["tau"],
    )
    half = Quantum(*(np.full(6, 0.5 * s) for s in scale.values()))
    assert not any(v.deviations for v in verdicts(Watch(known_model(), half), samples(rounded)))


def test_the_place_in_the_session_is_covered_unless_it_is_told() -> None:
    """A model with a warm-up, an arm that is warm: enclosed without being told, refuted by the claim that it is cold."""
    m = known_model()
    gone = -8.0  # N m s/rad of joint 1's friction, from the first trial to the last
    effect = Fitted("warm_up", m.joints[0], {"k_v": gone, "k_c": 0.0}, {})
    r = motion(4, 200)
    tau = r.tau.copy()
    tau[:, 0] += gone * r.dq[:, 0]  # what the warm arm needs for the same motion
    warm = samples(replace(r, tau=tau))
    model = replace(m, effects=(effect,))
    for place, refuted in (((0.0, 1.0), False), ((1.0, 1.0), False), ((0.0, 0.0), True)):
        found = verdicts(Watch(model, warm=place), warm)
        assert any(v.deviations for v in found) is refuted, place
        assert {d.joint for v in found for d in v.deviations} <= {m.joints[0]}


def test_friction_that_turns_with_the_motion_is_covered_under_rounding() -> None:
    """Coulomb friction jumps where the speed changes sign; a bus that rounds the speed must not make that a violation."""
    m = known_model()
    effects = tuple(Fitted("coulomb", j, {"F_c": 3.0}, {}) for j in m.joints)
    model = replace(m, effects=effects)
    r = motion(5, 200)
    none = model.input(r.q, r.dq, np.zeros_like(r.tau))
    exact = replace(r, tau=r.tau - none)  # so that u is what moved the arm
    assert not any(v.deviations for v in verdicts(Watch(model), samples(exact)))
    step = {"q": 1e-4, "dq": 2e-2, "tau": 0.05}
    rounded = replace(exact, **{k: np.round(getattr(exact, k) / x) * x for k, x in step.items()})
    half = Quantum(*(np.full(6, 0.5 * x) for x in step.values()))
    assert not any(v.deviations for v in verdicts(Watch(model, half), samples(rounded)))
    blind = Quantum(half.q, half.dq * 0.0, half.tau)
    assert any(v.deviations for v in verdicts(Watch(model, blind), samples(rounded)))


def test_unknown_rounding_would_be_flagged() -> None:
    """Mutant: the same coarse torque without telling the monitor is a violation, so the widening above is needed."""
    r = motion(3)
    rounded = replace(r, tau=np.round(r.tau / 2.0) * 2.0)
    assert any(v.deviations for v in verdicts(Watch(known_model()), samples(rounded)))


def test_a_bus_with_another_cycle_is_refused() -> None:
    check_cycle(known_model(), DT)
    with pytest.raises(NotCovered, match=r"10 ms.*4 ms"):
        check_cycle(known_model(), 0.010)


def test_violations_stay_latched_and_are_classified() -> None:
    latch, watch = Latch(), Watch(known_model())
    good = samples(motion(0, 60))
    spike = [structs.replace(s, dq=s.dq + (np.eye(6)[5] * 0.5 if s.k == 30 else 0.0)) for s in good]
    new = [latch.take(s, watch.step(s)) for s in spike]
    assert latch.latched and latch.joints == ("arm_6_joint",)
    assert next(k for k, n in enumerate(new) if n) == 30
    entry = latch.entries[("arm_6_joint", "dq", "above")]
    assert entry.plain()["kind"] == "unclassed" and entry.worst.excess == pytest.approx(0.5, abs=0.1)
    assert latch.count == 1, "one bad sample counts once"
    assert latch.kind is Kind.UNCLASSED
    latch.classed(Cause(Kind.SPIKE, "one sample"), 0.0)
    for s in samples(with_torque_scaled(motion(1), 1, 1.5), k0=1000):
        latch.take(s, watch.step(s))
    assert latch.joints == ("arm_6_joint", "arm_2_joint"), "first-out first"
    latch.classed(Cause(Kind.MISSING_EFFECT, "another"), 0.0)
    assert {e.plain()["kind"] for e in latch.entries.values()} == {"spike", "missing_effect"}
    assert latch.kind is Kind.SPIKE, "first-out"
    latch.reset()
    assert not latch.latched and latch.count == 0


class Disk:
    """Two slots in memory; ``data`` may be spoilt."""

    settled = True
    astray = interrupted = notice = ""

    def __init__(self, record: Any) -> None:
        self.data, self.counts, self.full = bytearray(blank(record)), b"", False

    def read_counts(self) -> bytes:
        return self.counts

    def write_counts(self, data: bytes) -> None:
        self.counts = data

    def read(self) -> bytes:
        return bytes(self.data)

    def write(self, offset: int, data: bytes) -> None:
        if self.full:
            raise OSError(28, "No space left on device")
        self.data[offset : offset + len(data)] = data

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass


def test_a_journal_that_is_taken_away_is_no_first_start(tmp_path: Path) -> None:
    path = tmp_path / "arm.latch"

    def start() -> Latch:
        return Latch(Journal(FileStore(path, Record())))

    first = start()
    assert not first.latched
    first.close()
    again = start()
    assert not again.latched, "as it was left"
    again.close()
    for _ in range(2):  # and a start that finds it so does not make it good
        path.unlink()
        latch = start()
        assert latch.latched and "taken away" in latch.record.why
        latch.close()
    latch = start()
    assert latch.latched
    latch.reset("A. Person", "seen to", 0.0)
    latch.close()
    latch = start()
    assert not latch.latched
    latch.close()
    begun = tmp_path / ".arm.latch.begun"
    begun.unlink()  # as of an earlier version, or of a start that ended in between
    latch = start()
    assert not latch.latched and begun.exists()
    latch.close()
    path.write_bytes(bytes(path.stat().st_size))  # a start that ended before it had said so
    latch = start()
    assert latch.latched
    latch.close()


def test_a_torn_journal_never_forgets() -> None:
    """Power is lost at every point of the write that latches, sectors in any order: latched, or as before the violation."""
    before = Disk(Record())
    latch, watch = Latch(Journal(before)), Watch(known_model())
    old = bytes(before.data)
    for s in samples(with_torque_scaled(motion(1), 1, 1.5)):
        latch.take(s, watch.step(s), s.t)
        if latch.latched:
            break
    new = bytes(before.data)
    written = [i for i in range(len(new)) if new[i] != old[i]]
    rng = np.random.default_rng(0)
    for _ in range(200):
        torn = Disk(Record())
        torn.data[:] = old
        for i in rng.permutation(written)[: rng.integers(len(written) + 1)]:
            torn.data[i] = new[i]
        again = Latch(Journal(torn))
        assert again.latched or bytes(torn.data) == old
    whole = Disk(Record())
    whole.data[:] = new
    back = Latch(Journal(whole))
    assert back.record == latch.record and back.joints == ("arm_2_joint",)
    for spoilt in (b"", b"\0" * len(new), new[:-1], new + b"\0", b"x" * len(new)):
        whole.data[:] = spoilt
        assert Latch(Journal(whole)).latched
    whole.data[:] = new
    back = Latch(Journal(whole))
    back.reset("A. Person", "seen to", 0.0)
    assert not Latch(Journal(whole)).latched and Latch(Journal(whole)).record.reset["name"] == "A. Person"


def test_a_full_disk_is_said_and_tried_again() -> None:
    disk = Disk(Record())
    latch, watch = Latch(Journal(disk)), Watch(known_model())
    disk.full = True
    for s in samples(with_torque_scaled(motion(1), 1, 1.5)):
        latch.take(s, watch.step(s), s.t)
    assert latch.latched and "No space left" in latch.keep(10.0)
    disk.full = False
    assert latch.keep(12.0) == "" and Latch(Journal(disk)).count == latch.count


# ---- cycles and states ----------------------------------------------------------------------------------------------


def test_cycle_numbers_show_what_was_lost() -> None:
    from stopset.monitor.links.decoder import Cycle

    nothing = np.zeros((5, 6))
    count = CycleCount(0.004, 240)
    late = [count(Cycle(c, t, nothing, 0, True)) for c, t in ((238, 0.0), (239, 0.011), (240, 0.012), (1, 0.016), (4, 0.028))]
    assert late == [0, 1, 2, 3, 6], "late frames are no gap, lost cycles are"
    assert count(Cycle(5, 5.0, nothing, 0, True)) > 100, "half a round of the counter later it cannot be trusted"
    clock = CycleCount(0.004, 0)
    assert [clock(Cycle(None, t, nothing, 0, True)) for t in (0.0, 0.0041, 0.0079, 0.0160)] == [0, 1, 2, 4]


def numbers(provable: bool) -> dict[str, Numbers]:
    finite = Numbers(np.full(6, 0.1), np.full(6, 0.1), np.full(6, 0.1), 0.02, np.full(6, True))
    return {"0": finite if provable else Numbers.none(6, "no brakes known")}


def test_the_worst_known_decides_the_state() -> None:
    s = samples(motion(0, 2))[0]
    inside = Verdict(Conformance.CONFORMANT, "inside", oldest=0.2)
    good = Situation(True, "", False, False, "", 0.01, 0.01, s, inside, True, numbers(True))
    unknown = Verdict(Conformance.UNKNOWN, "gap: ...")
    limits = OkConditions(valid_for=0.03, ahead=0.004, evidence=0.1, recover=0.25)

    def decide(x: Situation) -> tuple[State, int, str]:
        return status.decide(x, limits)

    assert decide(good)[0] is State.OK
    assert decide(structs.replace(good, numbers=numbers(False)))[0] is State.DEGRADED
    assert decide(structs.replace(good, verdict=unknown))[0] is State.UNKNOWN
    assert decide(structs.replace(good, stale=True))[0] is State.FAULT
    assert decide(structs.replace(good, late=True))[0] is State.FAULT
    assert decide(structs.replace(good, latched="seen"))[0] is State.VIOLATION
    assert decide(structs.replace(good, latched="seen", stale=True))[0] is State.VIOLATION
    assert decide(structs.replace(good, fault="x", latched="seen"))[0] is State.FAULT
    for change in (
        {"age": 0.031},
        {"since": 0.031},
        {"age": -0.005},
        {"age": float("nan")},
        {"verdict": structs.replace(inside, oldest=0.09)},
    ):
        assert decide(structs.replace(good, **change))[0] is State.UNKNOWN, change
    assert (
        decide(structs.replace(good, sample=structs.replace(s, fault="the drive of arm_1_joint (node 3) is stopped")))[0]
        is State.UNKNOWN
    )
    assert decide(structs.replace(good, verdict=Verdict(Conformance.FAULT, "x")))[0] is State.FAULT
    assert decide(structs.replace(good, numbers={}))[1] and not believable(*decide(structs.replace(good, latched="seen"))[:2])
    outside = structs.replace(good, verdict=Verdict(Conformance.UNKNOWN, "outside", outside=("q_a",)))
    assert not believable(*decide(outside)[:2]), "no stop number outside the domain"


@pytest.mark.parametrize("by", [0.05, -0.05])
def test_after_its_clock_was_set_ok_is_not_said_at_once(by: float) -> None:
    """A consumer who gets the first message late by as much would take its data for new; a clock brought nearer slowly changes nothing."""
    r, now = Recovery(OkConditions(valid_for=0.03, ahead=0.004, evidence=0.1, recover=0.25)), 0.0
    for k in range(100):
        now = 0.01 * k
        slewed = 500e-6 * now
        reported = r.hold(State.OK, "", now, (slewed - 1e-3, slewed + 1e-3))
    assert reported[0] is State.OK
    after = [r.hold(State.OK, "", now + 0.01 * k, (by - 1e-3, by + 1e-3)) for k in range(1, 30)]
    assert [t[0] for t in after] == [State.UNKNOWN] * 25 + [State.OK] * 4
    assert after[0][1] == Flag.RECOVERING and "the clock was set by 4" in after[0][2]


def test_ok_comes_back_after_unbroken_good_cycles_and_worse_news_at_once() -> None:
    r = Recovery(OkConditions(valid_for=0.03, ahead=0.004, evidence=0.1, recover=0.25))
    reported: list[tuple[State, int, str]] = []

    def turns(count: int, state: State, start: float) -> float:
        reported.clear()
        reported.extend(r.hold(state, f"why {state.name}", start + 0.01 * k, (-1.0, -1.0)) for k in range(count))
        return start + 0.01 * count

    now = turns(30, State.OK, 0.0)
    assert [t[0] for t in reported] == [State.UNKNOWN] * 25 + [State.OK] * 5
    assert reported[10][1] == Flag.RECOVERING and "0.10 s of 0.25 s" in reported[10][2] and "the start" in reported[10][2]
    now = turns(1, State.DEGRADED, now)
    assert reported[0] == (State.DEGRADED, 0, "why DEGRADED"), "at once"
    now = turns(20, State.OK, now)
    assert {t[0] for t in reported} == {State.DEGRADED} and "why DEGRADED" in reported[-1][2], "no flicker"
    now = turns(10, State.OK, now)
    assert reported[-1][0] is State.OK
    now = turns(1, State.UNKNOWN, now)
    now = turns(26, State.OK, now)
    assert reported[0][0] is State.UNKNOWN and reported[-1][0] is State.OK
    turns(1, State.OK, now + 2.0)
    assert reported[0][0] is State.UNKNOWN and "stood still for 2010 ms" in reported[0][2], "stopped and continued"


# ---- the message ----------------------------------------------------------------------------------------------------


def message(**more: Any) -> bytes:
    return pack({"data_id": 7, "boot_id": 1, "state": int(State.OK), **more})


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2**32 - 1), st.floats(-1e9, 1e9)), min_size=1, max_size=5))
def test_a_message_made_in_place_is_the_one_made_anew(rows: list[tuple[int, int, float]]) -> None:
    same = {"model_hash": 6, "config_hash": 7, "valid_for_ms": 8, "cycle_us": 9, "joints": 6}
    blocks = [
        same | {"data_id": k, "stop0_time": np.full(6, 0.1 * k), "stop1_provable": k, "holding_margin_min": -0.1 * k}
        for k in range(3)
    ]
    packer = Packer()
    for k, seq, room in rows:
        now = Changing(seq, 1 + k, k, 2 + k, 3, seq, seq, abs(room), room, seq, seq)
        nonces = (seq, 0, 0, k)
        values = structs.asdict(now) | {"seq": seq, "boot_id": 5, "t_pub_ns": seq, "nonces": nonces}
        assert packer.again(now, (seq, 5, seq), nonces, blocks[k]) == pack({**blocks[k], **values})


def test_codes_differ_in_four_bits() -> None:
    codes = [s.value for s in State if s is not State.NEVER_SENT]
    assert min(bin(a ^ b).count("1") for a in codes for b in codes if a != b) >= 4
    assert crc32c(b"123456789") == 0xE3069283, "the check value of CRC-32C"


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_rounding_is_outward(x: float) -> None:
    assert outward(x, "up") >= x >= outward(x, "down")
    assert outward_all(np.array([x, x]), np.array([True, False])).tolist() == [outward(x, "up"), outward(x, "down")]
    for y in (outward(x, "up"), outward(x, "down")):
        assert struct.unpack("<f", struct.pack("<f", y))[0] == y, "a float32, nothing is rounded again on the way"


@settings(max_examples=50, deadline=None)
@given(st.integers(0, LENGTH * 8 - 1), st.integers(0, LENGTH * 8 - 1))
def test_damaged_messages_are_refused(a: int, b: int) -> None:
    data = bytearray(message())
    data[a // 8] ^= 1 << a % 8
    if a != b:
        data[b // 8] ^= 1 << b % 8
    with pytest.raises(BusError):
        unpack(bytes(data))


def test_headers_are_those_of_the_table() -> None:
    for name, text in plc.FILES.items():
        assert (ROOT / "deploy/plc" / name).read_text() == text(), f"run python -m stopset.monitor.plc: {name} is old"
    at = offsets()
    assert all(at[f.name] % {"u8": 1, "u16": 2, "u32": 4, "u64": 8, "f32": 4}[f.kind] == 0 for f in FIELDS)


# ---- configuration --------------------------------------------------------------------------------------------------


GOOD = 'model = "a.json"\ndata_id = 7\n[bus]\nlink = "hub:1"\n'


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (GOOD + 'profil = "x"', "profil"),
        ('model = "a.json"\ndata_id = 7', "exactly one"),
        ('model = "a.json"\ndata_id = 7\n[bus]\nlink = 3', "expected str"),
        (GOOD.replace("7", "-1"), "data_id"),
        (GOOD.replace("7", "0"), "data_id"),
        (GOOD.replace("data_id = 7", ""), "lacks data_id"),
        ('data_id = 7\n[bus]\nlink = "hub:1"', "lacks model"),
        ('site = "a/*"\n' + GOOD, "special"),
        ("model = ", "TOML"),
        (GOOD + "[fallback]\ntime_s = nan", "fallback.time_s is nan"),
        (GOOD + "[fallback]\nangle_rad = -0.1", "fallback.angle_rad is -0.1"),
        (GOOD + "[fallback]\ntcp_m = 0", "fallback.tcp_m is 0"),
        (GOOD + "[stops]\ncategories = []", "at least one"),
        (GOOD + '[stops]\ncategories = ["0", "0"]', "each once"),
        (GOOD + "[publish]\nvalid_for_ms = 2000", "valid_for_ms is 2000"),
        (GOOD + "[publish]\nvalid_for_ms = 0", "valid_for_ms is 0"),
        (GOOD + "[publish]\nrecover_s = nan", "recover_s is nan"),
        (GOOD + "[publish]\nevidence_min_s = 0.0", "evidence_min_s is 0.0; expected 0.02 to 10"),
        (GOOD + "[publish]\nrecover_s = 0", "recover_s is 0.0; expected 0.05 to 60"),
        ("payload_kg = nan\n" + GOOD, "payload_kg is nan"),
        (f"payload_kg = {'9' * 5000}\n" + GOOD, "TOML"),
        ('journal = "/"\n' + GOOD, "a folder"),
        ('journal = "."\n' + GOOD, "a folder"),
        ('journal = "a\\u0000b"\n' + GOOD, "control characters"),
        ('keys = "a\\u0000b"\n' + GOOD, "control characters"),
        (GOOD.replace("a.json", "a\\u0000b"), "control characters"),
    ],
)
def test_bad_configuration_gets_one_sentence(text: str, word: str, tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=word):
        load_config(path)


def test_a_journal_that_no_file_can_be_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    path = tmp_path / "c.toml"
    path.write_text(f'journal = "{"a" * 300}"\nkeys = "loop"\n' + GOOD)
    with pytest.raises(OutputError, match="cannot be written"):
        FileStore(Path(load_config(path).journal), Record())


@pytest.mark.parametrize("which", ["c.toml", "a.json", "arm.keys", "./a.json", "linked"])
def test_a_journal_that_is_another_file_of_the_cell_overwrites_nothing(which: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("a model")
    (tmp_path / "linked").symlink_to("a.json")
    path = tmp_path / "c.toml"
    path.write_text(f'journal = "{which}"\nkeys = "arm.keys"\n' + GOOD)
    with pytest.raises(ConfigError, match="a file of its own"):
        load_config(path)
    assert (tmp_path / "a.json").read_text() == "a model"


def test_example_configuration_is_valid() -> None:
    config = load_config(ROOT / "deploy/stopset.toml.example")
    assert config.bus is not None and load_profile(config.bus.profile).joints[0] == "arm_1_joint"
    assert config.sha256 and NOISE > 0
