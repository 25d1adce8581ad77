"""An arm identified while it was healthy and recorded again weeks later: what changed, where, by how much, or nothing."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import Model
from stopset.effects import Fitted, get
from stopset.errors import RecordingError
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.source import Campaign
from stopset.offline.campaign.survey import survey
from stopset.offline.compare.known import rows_left
from stopset.offline.description import load_robot, robot_from_text
from stopset.offline.diagnose import Diagnosis, diagnose_model
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.answer import Parameter, Ranked
from stopset.offline.diagnose.changes import Change, changes
from stopset.offline.diagnose.diagnose import SINCE, _with_changes, answered
from stopset.offline.diagnose.evidence.candidate import Candidate, Scored
from stopset.offline.diagnose.evidence.priors import Known
from stopset.offline.diagnose.examination import examine
from stopset.offline.diagnose.levels import ColumnLevel, level_changes
from stopset.offline.diagnose.levels import _friction as friction_levels
from stopset.offline.diagnose.page import page
from stopset.offline.diagnose.question import question
from stopset.offline.diagnose.remainder import accounts_for
from stopset.offline.diagnose.search.search import Claim
from stopset.offline.identify.asked_effects import asked_effects
from stopset.offline.identify.pipeline import Settings, identified
from stopset.offline.nominal.nominal import taken_out_in_words
from stopset.progress import silent
from stopset.recording import Recording, Recordings, read_recordings
from stopset.simulation import Scenario, prepare
from stopset.simulation.plant import SimulatedPlant
from test_hidden_effects import ARM

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
import as_found
from found_pairs import ONLY_ASKED

LATER = 103  # other motions, other noise, other scatter of friction
WORN, DRAGGING = (0, 2), 1  # joints whose friction rises, and one whose brake does not open wholly
RISE, DRAG = 1.3, 3.0  # times, [N m]


@dataclass(frozen=True, slots=True)
class Pair:
    """A cell and the model of its arm as it was."""

    scenario: Scenario
    model: Model

    def weeks_later(self, change: Callable[[SimulatedPlant], SimulatedPlant]) -> Diagnosis:
        s = self.scenario
        truth = replace(s.cell.truth, plant=change(s.cell.truth.plant))
        found, against = diagnose_model(self.model, recorded(replace(s, cell=replace(s.cell, truth=truth, seed=LATER))))
        assert against == "identified model"
        return found


def recorded(s: Scenario) -> Recordings:
    return Recordings(replace(s.meta, sources=((f"{s.cell.seed}.parquet", f"{s.cell.seed}"),)), tuple(s.recordings()))


@pytest.fixture(scope="module")
def pair() -> Pair:
    healthy = prepare(robot_from_text(ARM), ["none"], 3, "short", cad="wrong")
    recordings = recorded(healthy)
    campaign = Campaign(recordings.meta, lambda: iter(recordings.trials))
    return Pair(healthy, identified(healthy.robot, campaign, ONLY_ASKED, silent, None, (), None).model)


def test_of_a_healthy_arm_nothing_is_said(pair: Pair) -> None:
    found = pair.weeks_later(lambda plant: plant)
    assert found.verdict == "none" and not found.ranked and not found.changed


@pytest.mark.parametrize("wet", [False, True], ids=["dry", "dry and viscous"])
def test_more_friction_and_a_dragging_brake_are_changes_with_their_joints_and_sizes(pair: Pair, wet: bool) -> None:
    more = np.ones(3)
    more[list(WORN)] = RISE
    drag = DRAG * (np.arange(3) == DRAGGING)

    def worn(plant: SimulatedPlant) -> SimulatedPlant:
        return plant._replace(fc=plant.fc * more + drag, fv=plant.fv * (more if wet else 1.0))

    found = pair.weeks_later(worn)
    assert found.verdict == "changed"
    before, joints = pair.scenario.cell.truth.plant, pair.model.joints
    after = worn(before)
    wanted = {("coulomb", joints[j]): (before.fc[j], after.fc[j]) for j in range(3)}
    wanted |= {("viscous", joints[j]): (before.fv[j], after.fv[j]) for j in WORN if wet}
    assert {(c.effect, c.joint) for c in found.changed} == set(wanted)
    for c in found.changed:
        true = wanted[c.effect, c.joint]
        assert c.after - c.before == pytest.approx(true[1] - true[0], abs=4 * c.std)  # of five numbers each, two cases
        assert c.after == pytest.approx(true[1], rel=0.05) and c.std < 0.03 * c.after
        assert c.error_after < 0.8 * c.error_before
    shown = found.as_json()["ranked_effects"]
    assert all({"before", "after", "std", "since"} == set(r["change"]) for r in shown) and len(shown) == len(wanted)


def test_a_load_and_a_drives_gain_are_named_with_what_the_model_said_of_them(pair: Pair) -> None:
    found = pair.weeks_later(lambda plant: plant._replace(gain=np.array([1.0, 1.06, 1.0])))
    assert found.verdict == "missing" and [r.label for r in found.ranked] == ["torque_gain:lift"]


@pytest.fixture(scope="module")
def program() -> Pair:
    """Identified from six motions of a production program, which hardly tell dry friction from viscous."""
    healthy = prepare(robot_from_text(ARM), ["none"], 7, "short", cad="wrong")
    recordings = _logged(healthy, 107)
    campaign = Campaign(recordings.meta, lambda: iter(recordings.trials))
    return Pair(healthy, identified(healthy.robot, campaign, ONLY_ASKED, silent, None, (), None).model)


def _logged(s: Scenario, seed: int, late: float = 0.0) -> Recordings:
    made = as_found.recorded(s, as_found.PROGRAM, 125.0, as_found.Trouble(late=late), seed)
    return replace(made, meta=replace(made.meta, sources=((f"{seed}.parquet", f"{seed}"),)))


def _rough(made: Recordings, size: float) -> Recordings:
    """With friction of ``size`` [N m] that differs from pose to pose, as real gears' does, in no catalogue."""

    def rubbed(r: Recording) -> Recording:
        at = 3 * np.roll(r.q, -1, axis=1) + 2 * r.q
        return replace(r, tau=r.tau + size * np.tanh(r.dq / 0.05) * np.sin(at))

    return replace(made, trials=tuple(map(rubbed, made.trials)))


def test_what_a_model_leaves_of_its_own_recordings_too_is_no_change() -> None:
    """Real friction differs from pose to pose, which no law here explains: a program run again leaves as much, and nothing has changed.

    A joint that rubs more weeks later is told all the same: of it the model leaves far more than of its own recordings.
    """
    s = prepare(robot_from_text(ARM), ["none"], 1, "short", cad="wrong")
    first = _rough(_logged(s, 101), 1.0)
    model = identified(s.robot, Campaign(first.meta, lambda: iter(first.trials)), ONLY_ASKED, silent, None, (), None).model
    again = _rough(_logged(s, 201), 1.0)
    asked = question(model, again)
    assert asked.known is not None and asked.known.as_before.all()
    found, _ = diagnose_model(model, again)
    assert found.verdict == "none" and not found.ranked and not found.changed
    assert any("at most 1.25 times the torque that it left of its own recordings" in x for x in found.notes)
    plant = s.cell.truth.plant
    worn = replace(s.cell.truth, plant=plant._replace(fc=plant.fc * np.array([2.0, 1.0, 1.0])))
    changed, _ = diagnose_model(model, _rough(_logged(replace(s, cell=replace(s.cell, truth=worn)), 201), 1.0))
    assert changed.verdict == "changed" and {r.joints for r in changed.ranked} == {("turn",)}


def test_of_a_healthy_real_arm_no_change_is_told(shared_data: Callable[[str], Path]) -> None:
    """Of one day of a UR10e a viscous friction of the pan "changed" and a cubic one was "missing" against a model of four other motions."""
    file = shared_data("ur10e/identification.parquet")
    robot = load_robot(file.with_name("robot.urdf"))
    day = read_recordings([file], robot)

    def of(name: str, motions: Sequence[int]) -> Recordings:
        return Recordings(replace(day.meta, sources=((name, name),)), tuple(day.trials[k] for k in motions))

    first = of("first", (4, 7, 10, 8))
    model = identified(robot, Campaign(first.meta, lambda: iter(first.trials)), ONLY_ASKED, silent, None, (), None).model
    for motions in ((11, 6, 1), (2, 13, 3)):
        found, _ = diagnose_model(model, of("later", motions))
        assert not found.ranked and not found.changed


@pytest.mark.parametrize("seed", [1, 5])
def test_what_a_model_left_open_of_itself_is_no_load(seed: int) -> None:
    """Masses of a description that is half wrong, and one short slow motion: others show what was wrong, and nothing hangs at the flange."""
    s = prepare(robot_from_text(ARM), ["none"], seed, "short", cad="wrong")
    wrong = s.robot.with_parameters(s.robot.pi * np.array([1.0, 1.5, 0.6])[:, None])
    first = as_found.recorded(s, (8.0,), 100.0, as_found.Trouble(speed=0.3), seed + 100)
    first = replace(first, meta=replace(first.meta, sources=(("first.parquet", "first"),)))
    model = identified(wrong, Campaign(first.meta, lambda: iter(first.trials)), ONLY_ASKED, silent, None, (), None).model
    later = as_found.recorded(s, as_found.ONE, 100.0, as_found.Trouble(), seed + 200)
    asked = question(model, replace(later, meta=replace(later.meta, sources=(("later.parquet", "later"),))))
    assert asked.known is not None and asked.known.left_open.shape[0] == 13 * model.n
    found = answered(examine(asked.robot, asked.asked, asked.fitted, asked.before))
    assert found.verdict == "none"
    silent_model = replace(asked.before, known=replace(asked.known, left_open=np.zeros((0, 0))))
    assert (
        answered(examine(asked.robot, asked.asked, asked.fitted, silent_model)).ranked[0].effect == "payload"
    )  # the trouble it has


def test_of_changes_beside_what_is_missing_a_handful_is_told(program: Pair) -> None:
    """Of a small real arm with a load seven levels "changed" beside it, the scale of all torque by a third: the load in other words."""
    asked = question(program.model, _logged(program.scenario, LATER))
    x = examine(asked.robot, asked.asked, asked.fitted, asked.before)
    x.engine.as_before = np.zeros(program.model.n, bool)
    load = Ranked("payload", (), 100.0, 1.0, 0.5, {"m": Parameter(2.0, "kg", 0.1)}, "", "")
    levels = [Change("coulomb", j, "F_c", "N m", 1.0, 2.0, 0.1, 1.0, 0.5, j) for j in program.model.joints]
    scale = Change("torque_gain", None, "e", "1", 0.0, 0.3, 0.01, 1.0, 0.5, program.model.joints[0])
    told = _with_changes(x, replace(answered(x), verdict="missing", ranked=(load,)), [scale, *levels, *levels]).changed
    assert len(told) == limit.HANDFUL - 1 and all(c.joint for c in told)


def test_worn_gears_are_told_from_a_program_of_few_speeds(program: Pair) -> None:
    """Neither part of the friction is certain there; how much of it there is, is."""
    s, joints = program.scenario, program.model.joints
    assert diagnose_model(program.model, _logged(s, LATER))[0].verdict == "none"
    more = np.where(np.isin(np.arange(3), WORN), RISE, 1.0)
    plant = s.cell.truth.plant
    worn = replace(
        s, cell=replace(s.cell, truth=replace(s.cell.truth, plant=plant._replace(fc=plant.fc * more, fv=plant.fv * more)))
    )
    found = diagnose_model(program.model, _logged(worn, LATER))[0]
    assert found.verdict == "changed" and {r.joints[0] for r in found.ranked} == {joints[j] for j in WORN}
    assert {r.effect for r in found.ranked} <= {"coulomb", "viscous"}


def test_a_lag_of_all_joints_that_identification_took_out_is_told_and_no_name(program: Pair) -> None:
    late = _logged(program.scenario, 107, late=0.012)
    campaign = Campaign(late.meta, lambda: iter(late.trials))
    model = identified(program.scenario.robot, campaign, ONLY_ASKED, silent, None, (), None).model
    found, _ = diagnose_model(model, late)
    assert found.verdict == "none" and not found.claims
    (out,) = found.taken_out
    assert out["joint"] is None and out["value"] == pytest.approx(-0.012, abs=0.002)
    # a `delay` of as much has the other sign: people are told which it is
    assert re.search(r"recorded torque 1[0-3]\.\d \+- \d\.\d ms behind the motion \(all joints\)", taken_out_in_words(out))
    assert "before the motion" in taken_out_in_words({**out, "value": -out["value"]})


@pytest.mark.parametrize("late", [-0.03, 0.04])
def test_torque_of_another_clock_than_the_models_is_said_and_no_name(program: Pair, late: float) -> None:
    """A logger that stamps torque and motion apart makes no delay of three drives, no worn gear, no friction that builds up slowly."""
    found, _ = diagnose_model(program.model, _logged(program.scenario, LATER, late=late))
    assert found.verdict == "none" and not found.claims and not found.changed
    (out,) = found.taken_out
    assert out["joint"] is None and out["value"] == pytest.approx(-late, abs=0.003)
    assert any(("behind" if late > 0 else "before") in note and "one clock" in note for note in found.notes)


def test_of_torque_farther_off_than_can_be_searched_nothing_is_named(program: Pair) -> None:
    with pytest.raises(RecordingError, match=r"all joints is more than 60 ms late .* one clock"):
        diagnose_model(program.model, _logged(program.scenario, LATER, late=0.1))


def test_recordings_of_two_clocks_are_asked_apart(program: Pair) -> None:
    """The mean of their lags is true of neither."""
    one, other = _logged(program.scenario, LATER), _logged(program.scenario, LATER + 1, late=0.04)
    meta = replace(one.meta, sources=(*one.meta.sources, *other.meta.sources))
    both = Recordings(meta, (*one.trials, *(replace(r, file=1) for r in other.trials)))
    with pytest.raises(RecordingError, match=r"nothing is named .* behind .* ask of each apart"):
        diagnose_model(program.model, both)


def test_a_shared_motor_that_leaves_no_trace_is_none(program: Pair) -> None:
    """One that was looked for, not asked for, may be missing beside all else."""
    r = _logged(program.scenario, 107)
    name = "coupled_wrist:" + "+".join(program.model.joints[:2])
    run = Run(program.scenario.robot, r.meta, lambda: iter(r.trials), survey(lambda: iter(r.trials)), Settings())
    assert asked_effects(run, (), [name]) == ()


def test_how_much_friction_there_is_does_not_depend_on_how_long_the_arm_stands(pair: Pair) -> None:
    """R-990: rows at rest are no slow ones: they made the usual speed, and with it a day's difference, half as large."""
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, 40, 3))
    at_rest = np.where(np.arange(80) < 40, 1.0, 1e-4)[:, None]  # readings of a joint at rest are not zero
    moving = np.arange(80)[:, None] + np.zeros(3) < 40
    alone = level_changes(pair.model, q, dq, ddq, moving[:40])
    resting = level_changes(pair.model, *(np.tile(x, (2, 1)) * at_rest for x in (q, dq, ddq)), moving)
    assert [c.levels for c in alone] == [c.levels for c in resting]
    for a, b in zip(alone, resting, strict=True):
        assert a.least == pytest.approx(b.least, rel=1e-12) and a.error == pytest.approx(b.error, rel=1e-12)
        if a.friction:
            assert not b.columns[40:].any() and not b.beside[40:].any()


def test_how_much_friction_there_is_is_known_better_than_its_parts(program: Pair) -> None:
    """R-991: a program of few speeds hardly tells dry friction from viscous, and the model says so; of their sum it is sure."""
    model = program.model
    v = np.random.default_rng(1).uniform(0.5, 1.0, (60, 3)) * np.where(np.arange(60) % 2, 1.0, -1.0)[:, None]

    def errors(of: Model) -> list[float]:
        found = level_changes(of, np.zeros_like(v), v, np.zeros_like(v), np.ones(v.shape, bool))
        dry = [c for c in found if c.friction and [x.effect for x in c.levels] == ["coulomb"]]
        return [float(c.error[0]) for c in dry]

    stated = model.provenance["friction_covariance"]
    for f in model.effects:
        if f.effect in ("coulomb", "viscous"):
            (symbol, std), of = next(iter(f.std.items())), stated[f.joint]
            k = of["of"].index([f.effect, symbol])
            assert np.sqrt(of["covariance"][k][k]) == pytest.approx(std, rel=1e-9)
    parts = [next(f.std["F_c"] for f in model.effects if (f.effect, f.joint) == ("coulomb", j)) for j in model.joints]
    assert all(e < 0.5 * p for e, p in zip(errors(model), parts, strict=True))
    # numbers that err apart from each other add up
    apart = {j: {**x, "covariance": np.diag(np.diag(x["covariance"])).tolist()} for j, x in stated.items()}
    wider = errors(replace(model, provenance={**model.provenance, "friction_covariance": apart}))
    assert all(e > p for e, p in zip(wider, parts, strict=True))


def test_how_steep_friction_is_at_a_creep_is_no_change_where_it_is_as_large() -> None:
    """Of an arm that creeps, viscous friction of 6.9 came out as 11.2 N m s/rad: 0.35 of 6 N m at 0.08 rad/s, less than a day's difference."""
    a, b = ColumnLevel("coulomb", "F_c", "N m", 5.5), ColumnLevel("viscous", "F_v", "N m s/rad", 6.9)
    v = 0.08 * np.where(np.arange(40) % 2, 1.0, -1.0)
    free = friction_levels(0, np.stack([np.sign(v), v], axis=1)[:, None], (a, 0.8), (b, 0.9), 0.7)[0]
    assert [x.effect for x in free.levels] == ["coulomb", "viscous"]
    most = limit.DAILY * (5.5 + 0.08 * 6.9)
    assert not free.enough(np.array([0.0, 4.34])) and not free.enough(np.array([0.99 * most, 0.0]))
    assert free.enough(np.array([0.0, 1.01 * most / 0.08])) and free.enough(np.array([0.9 * most, 0.2 * most / 0.08]))
    # rows from a later trial on count alone
    late = free.only(np.arange(40) >= 30)
    assert late.enough(np.array([1.01 * most, 0.0])) and not late.enough(np.array([0.99 * most, 0.0]))


def odd(s: Scenario, drag: float) -> Recordings:
    """Weeks later: a brake that drags, and at its joint what no catalogue has, 0.7 N m."""
    here = np.arange(3) == DRAGGING
    plant = s.cell.truth.plant._replace(fc=s.cell.truth.plant.fc + drag * here)
    later = recorded(replace(s, cell=replace(s.cell, truth=replace(s.cell.truth, plant=plant), seed=LATER)))

    def more(r: Recording) -> Recording:
        return replace(r, tau=r.tau + 1.4 * np.outer(np.sin(9 * r.q[:, 1]) * np.sin(7 * r.q[:, 0]), here))

    return replace(later, trials=tuple(map(more, later.trials)))


def test_a_level_accounts_for_a_joint_as_a_claim_must(pair: Pair) -> None:
    """R-993: where only noise is left any change will do; where more is, it must explain half of what is not noise."""
    q = question(pair.model, odd(pair.scenario, drag=0.0))
    x = examine(q.robot, q.asked, q.fitted, q.before)
    found, left = x.found, x.left
    assert DRAGGING in left.noisy and not {0, 2} & {*left.noisy, *left.depends}
    assert all(accounts_for(found, left, j, 0.99) for j in (0, 2))
    first = found.claims[0].excess_before[DRAGGING] if found.claims else found.excess[DRAGGING]
    enough = 1.0 - limit.TELLING * (first - 1.0) / first  # the largest share of the variance that may be left
    assert accounts_for(found, left, DRAGGING, enough - 1e-6) and not accounts_for(found, left, DRAGGING, enough + 1e-6)
    # a pattern in little variance is left as well, and no level explains a part of what is only noise
    calm = replace(found, claims=(), excess=(1.0, 0.99 * limit.SENSORS, 1.0))
    assert not accounts_for(calm, replace(left, noisy=(), depends={DRAGGING: []}), DRAGGING, 0.01)
    assert accounts_for(calm, replace(left, noisy=(), depends={}), DRAGGING, 0.99)
    # against what there was before anything was claimed
    claim = Claim(None, 100.0, (), (1.0, 9.0, 1.0), (1.0, 5.0, 1.0))  # type: ignore[arg-type]
    claimed = replace(found, claims=(claim,), excess=(1.0, 5.0, 1.0))
    noisy = replace(left, noisy=(DRAGGING,))
    assert accounts_for(claimed, noisy, DRAGGING, 0.55) and not accounts_for(replace(claimed, claims=()), noisy, DRAGGING, 0.61)
    assert not accounts_for(claimed, noisy, DRAGGING, 0.56)
    # what a claim took up that is no finding is left as well, where it was more than noise
    gear = Scored(Candidate(get("elasticity"), (DRAGGING,), {}, np.arange(1), np.ones(1)), 100.0, np.zeros(1), np.zeros((1, 1)))
    took, little = (Claim(gear, 100.0, (), (1.0, before, 1.0), (1.0, 1.0, 1.0)) for before in (3.0, 0.99 * limit.SENSORS))
    quiet = replace(left, noisy=(), depends={})
    for refused, joint, right in [(took, DRAGGING, False), (took, 0, True), (little, DRAGGING, True)]:
        assert accounts_for(replace(found, claims=(refused,)), quiet, joint, 0.73, [refused]) == right
    assert accounts_for(replace(found, claims=(took,)), quiet, DRAGGING, 0.5, [took])


def test_what_a_changed_level_leaves_is_told_beside_it(pair: Pair) -> None:
    """R-992: a brake that drags, and something that no catalogue has: the change with its size, and the rest with its own."""
    joint = pair.model.joints[DRAGGING]
    found = diagnose_model(pair.model, odd(pair.scenario, drag=DRAG))[0]
    assert found.verdict == "changed" and [c.label for c in found.changed] == [f"coulomb:{joint}"]
    (c,), (left,) = found.changed, found.unexplained
    assert left.joint == joint and left.size == c.error_after and left.size == pytest.approx(1.4 / 2, rel=0.2)
    assert left.depends_on
    assert any("beside what changed" in note and joint in note for note in found.notes)
    assert found.next_experiment and found.next_experiment.startswith(SINCE) and len(found.next_experiment) > len(SINCE)
    # no command is told that would refuse: every model has friction
    text = page(pair.model, found, "identified model").html()
    assert "stopset identify" in text and "stopset add" not in text


def test_since_when_is_told_where_the_change_is_in_the_recordings(pair: Pair) -> None:
    """A brake that begins to drag in the middle of the recordings: its joint, its torque, and from which trial on."""
    s, dragging = pair.scenario, np.array([0.0, DRAG, 0.0])

    def day(change: Callable[[SimulatedPlant], SimulatedPlant]) -> Recordings:
        truth = replace(s.cell.truth, plant=change(s.cell.truth.plant))
        return recorded(replace(s, cell=replace(s.cell, truth=truth, seed=LATER)))

    good, worn = day(lambda plant: plant), day(lambda plant: plant._replace(fc=plant.fc + dragging))
    moving = [k for k, r in enumerate(good.trials) if r.phase != "static"]
    begins = moving[len(moving) // 2]
    mixed = replace(good, trials=(*good.trials[:begins], *worn.trials[begins:]))
    found, _ = diagnose_model(pair.model, mixed)
    assert {(c.effect, c.joint) for c in found.changed} == {("coulomb", pair.model.joints[DRAGGING])}
    (c,) = found.changed
    assert c.after - c.before == pytest.approx(DRAG, abs=4 * c.std)
    assert c.since == worn.trials[begins].label and c.since in c.says
    # and where all recordings show it, that is what is said
    (whole,) = diagnose_model(pair.model, worn)[0].changed
    assert whole.since == "" and "before the first of these recordings" in whole.says


def test_a_model_that_does_not_know_how_friction_is_shared_names_nothing_for_that(pair: Pair) -> None:
    """R-980: a viscous friction that a fit held at zero is not known to be zero: the model says how far it may be off."""
    joint = pair.model.joints[0]
    wet = next(f.values["F_v"] for f in pair.model.effects if (f.effect, f.joint) == ("viscous", joint))
    off = {"coulomb": (0.6 * wet, 0.6 * wet), "viscous": (-wet, wet)}  # as much friction at 0.6 rad/s

    def unsure(f: Fitted) -> Fitted:
        if f.joint != joint or f.effect not in off:
            return f
        (symbol, value), (shift, std) = next(iter(f.values.items())), off[f.effect]
        return replace(f, values={symbol: value + shift}, std={symbol: std})

    alone = {k: v for k, v in pair.model.provenance.items() if k != "friction_covariance"}  # as models had it before
    model = replace(pair.model, effects=tuple(map(unsure, pair.model.effects)), provenance=alone)
    s = pair.scenario
    found = diagnose_model(model, recorded(replace(s, cell=replace(s.cell, seed=LATER))))[0]
    assert found.verdict == "none" and not found.claims and not found.changed
    assert max(found.excess.values()) < 1.5


def test_friction_that_came_to_grow_with_the_load_is_no_level_that_changed(pair: Pair) -> None:
    """R-981: a law that looks like a level, and leaves less, is what changed; the level beside it is not."""
    s, joint, load = pair.scenario, pair.model.joints[DRAGGING], 0.2
    plant = s.cell.truth.plant._replace(tooth=load * (np.arange(3) == DRAGGING))
    later = recorded(replace(s, cell=replace(s.cell, truth=replace(s.cell.truth, plant=plant), seed=LATER)))
    slight = Fitted("load_coulomb", joint, {"k_lift": 0.0, "k_lower": 0.0}, {"k_lift": 0.01, "k_lower": 0.01})
    for model in (pair.model, replace(pair.model, effects=(*pair.model.effects, slight))):  # whether it has that law or not
        told = changes(model, [r for r in later.trials if r.phase != "static"])
        assert [(c.effect, c.symbol, c.at) for c in told] == [("load_coulomb", k, joint) for k in ("k_lift", "k_lower")]
        # by gravity's load; the simulated gear's is the whole torque
        assert [c.after for c in told] == pytest.approx([load, load], rel=0.1)
    found = diagnose_model(pair.model, later)[0]
    assert [r.label for r in found.ranked] == [f"load_coulomb:{joint}"] and not found.changed  # told once


def test_an_offset_at_one_joint_leaves_those_of_the_others_to_be_told(pair: Pair) -> None:
    """Offsets read alike at all joints: the first one told, or asked and found to be none, was the last one asked."""
    later = recorded(replace(pair.scenario, cell=replace(pair.scenario.cell, seed=LATER)))
    off = np.array([0.0, 4.0, 3.0])
    moved = [replace(r, tau=r.tau + off) for r in later.trials]
    told = {c.joint: c.after for c in changes(pair.model, moved) if c.effect == "asymmetric_coulomb"}
    assert set(told) == set(pair.model.joints[1:])
    assert [told[j] for j in pair.model.joints[1:]] == pytest.approx(off[1:], rel=0.1)


def test_what_explains_more_than_a_models_own_recordings_held_beside_their_noise_is_new() -> None:
    """A model file that does not say how much that was may have held anything."""
    one = np.ones(3)
    said = Known(np.ones((3, 2)), np.ones((3, 2)), own=one, now=1.2 * one, own_excess=np.array([0.8, 1.2, 5.0]))
    assert said.as_before.all() and said.hidden_before == pytest.approx([limit.SENSORS - 1.0, limit.SENSORS - 1.0, 4.0])
    assert np.isinf(replace(said, own_excess=np.zeros(0)).hidden_before).all()


def test_a_law_is_held_against_the_torque_behind_the_filter_that_the_torque_passed(program: Pair) -> None:
    """A ripple of 10 Hz is not in rows of 6 Hz: to take it off there puts it in with the other sign."""
    model = program.model
    first, *_ = _logged(program.scenario, LATER).trials
    q = 1.5 * np.sin(0.8 * first.t)[:, None] * np.ones(model.n)
    said = Fitted("torque_ripple", model.joints[0], {"a": 5.0, "b": 0.0, "n": 60.0})
    at = replace(first, q=q, dq=1.2 * np.cos(0.8 * first.t)[:, None] * np.ones(model.n))
    u = [replace(model, effects=(*model.effects, *x)).input(at.q, at.dq, at.tau, None, 0.0, at.t) for x in ((), (said,))]
    rippling = replace(at, tau=at.tau + (u[0] - u[1]))
    told = replace(model, effects=(*model.effects, said))
    (without,), (with_it,) = (list(rows_left(m, r, filtered=True)) for m, r in ((model, at), (told, rippling)))
    np.testing.assert_allclose(with_it.left[:, 0], without.left[:, 0], atol=0.25)
    (unfiltered,) = rows_left(told, rippling)
    assert np.nanmax(np.abs(unfiltered.left - without.left)[:, 0]) > 2.0
