"""Recordings added to a model from its kept sums, the nominal model kept: the bits of all recordings read together, and refusals in one sentence."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from read_anew import from_scratch
from stopset.artifact import Model, load_model, save_model
from stopset.cli.main import main
from stopset.errors import ModelFileError, RecordingError
from stopset.offline.conform.gather import RetainedSums
from stopset.offline.identify.pipeline import Identification, Settings, identify
from stopset.offline.nominal import identify_nominal, solve_nominal
from stopset.offline.update import staleness
from stopset.offline.update.sums_file import ENVELOPE
from stopset.offline.update.sums_file import load_sums as load_state
from stopset.offline.update.update import save_state, update
from stopset.recording import Recording, stream_recordings
from synthetic import arm, names, recordings, save_trials

JOINTS = names(2)
J, v = (1.0, 0.5), (4.0, 2.0)
ROBOT = arm(JOINTS)


@dataclass(frozen=True)
class Campaign:
    """Old recordings with their model and state on disk, and new ones."""

    folder: Path
    old: Path
    model: Model
    state: Path

    def retained(self, model: Model | None = None) -> RetainedSums:
        return load_state(self.state, model or self.model)

    def write(self, name: str, trials: list[Recording]) -> Path:
        return save_trials(self.folder / name, trials, JOINTS)


def campaign(folder: Path, suites: int, settings: Settings | None = None, **more: Any) -> Campaign:
    old = save_trials(folder / "old.parquet", recordings(J, v, suites, **more), JOINTS)
    found = identify(ROBOT, [old], settings, keep="sums")
    model = save_model(found.model, folder / "old.model.json")
    assert isinstance(found.retained, RetainedSums)
    save_state(folder / "old.state", found.retained, model)
    return Campaign(folder, old, model, folder / "old.state")


@pytest.fixture(scope="module")
def nine(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    return campaign(tmp_path_factory.mktemp("nine"), 9)


def body(model: Model) -> dict[str, Any]:
    """All that recordings tell, as written, to the last digit; history and notes aside."""
    from stopset.artifact import model_text

    whole = json.loads(model_text(model))
    return {k: x for k, x in whole.items() if k not in ("sha256", "revisions", "notes")}


def same(a: Identification, b: Identification) -> None:
    assert body(a.model) == body(b.model)
    assert np.array_equal(a.conformance.margins, b.conformance.margins)
    assert a.conformance.influence == b.conformance.influence
    for name, fit in a.conformance.table.items():
        other = b.conformance.table[name]
        assert np.array_equal(fit.U.lo, other.U.lo) and np.array_equal(fit.U.hi, other.U.hi), name
        assert fit.active == other.active and fit.cost == other.cost


def check(c: Campaign, new: list[Path]) -> Identification:
    added = update(c.model, c.retained(), new)
    same(added, from_scratch(c.model, c.retained(), [c.old, *new]))
    return added


def test_new_motions_give_the_bits_of_all_recordings_read_together(nine: Campaign) -> None:
    """Longer trials, other noise and a wider disturbance than before: every set, the horizon and the domain must move."""
    new = nine.write("new.parquet", recordings(J, v, 4, 5, 1.4, spread=0.5, noise=(2e-5, 2e-3), seed=7))
    added = check(nine, [new])
    sets, before = added.model.powered, nine.model.powered
    assert sets.horizon > before.horizon + 0.3
    assert np.all(sets.U.width > before.U.width)
    assert added.model.guarantee.motions == 3 and nine.model.guarantee.motions == 2
    assert added.survey.trials == 9 * 4 + 4 * 5
    assert added.model.provenance["settings_sha256"] == nine.model.provenance["settings_sha256"]
    assert set(added.model.provenance["data"]) == {"old.parquet", "new.parquet"}
    old, last = nine.model.revisions[-1], added.model.revisions[-1]
    assert (last.number, last.added) == (1, "recordings new.parquet") and last.before == old.after and "old.parquet" in last.note
    # the nominal model is the one that was given
    assert np.array_equal(added.model.abstraction.Minv, nine.model.abstraction.Minv)


def test_one_by_one_equals_at_once(nine: Campaign) -> None:
    first = nine.write("first.parquet", recordings(J, v, 2, seed=11))
    second = nine.write("second.parquet", recordings(J, v, 2, seed=12))
    step = update(nine.model, nine.retained(), [first])
    model = save_model(step.model, nine.folder / "step.model.json")
    assert isinstance(step.retained, RetainedSums)
    save_state(nine.folder / "step.state", step.retained, model)
    twice = update(load_model(nine.folder / "step.model.json"), load_state(nine.folder / "step.state", model), [second])
    same(twice, update(nine.model, nine.retained(), [first, second]))
    assert [r.number for r in twice.model.revisions] == [0, 1, 2]
    assert sum(x.startswith("updated: ") for x in twice.model.notes) == 1


def test_a_later_start_of_an_old_motion_is_not_a_new_one(nine: Campaign) -> None:
    later = [
        replace(r.cut(60, len(r.t)), suite=0, trial=k)
        for k, r in enumerate(recordings(J, v, 9)[:4])
    ]  # fmt: skip
    new = nine.write("later.parquet", [replace(r, t=r.t - r.t[0]) for r in later])
    added = check(nine, [new])
    assert len(set(added.survey.motion.values())) == 9
    assert added.model.guarantee.motions == nine.model.guarantee.motions


def test_two_old_motions_that_prove_to_be_one_are_merged(tmp_path: Path) -> None:
    long = recordings(J, v, 1, 4, 3.0, seed=5)
    rest = recordings(J, v, 4, seed=6)
    pieces = [(0, 300), (450, 750)]  # share nothing until the whole is seen
    old = [replace(r.cut(a, b), suite=k, t=r.t[: b - a]) for k, (a, b) in enumerate(pieces) for r in long]
    old += [replace(r, suite=r.suite + 2) for r in rest]
    path = save_trials(tmp_path / "old.parquet", old, JOINTS)
    found = identify(ROBOT, [path], keep="sums")
    assert len(set(found.survey.motion.values())) == 6
    model = save_model(found.model, tmp_path / "m.json")
    assert isinstance(found.retained, RetainedSums)
    save_state(tmp_path / "s.state", found.retained, model)
    c = Campaign(tmp_path, path, model, tmp_path / "s.state")
    bridge = c.write("bridge.parquet", long)
    added = check(c, [bridge])
    assert len(set(added.survey.motion.values())) == 5


def test_what_shaped_the_nominal_model_never_judges_it(tmp_path: Path) -> None:
    """Six motions, all fitted to, and six new ones: of twelve the 4th, 8th and 12th would be held out, the 4th is known."""
    c = campaign(tmp_path, 6)
    assert c.model.guarantee.motions == 0
    added = check(c, [c.write("new.parquet", recordings(J, v, 6, seed=8))])
    assert added.model.guarantee.motions == 2
    held = added.survey.held_out
    assert held and all(file >= 1 for file, *_ in held)


def test_bands_positions_and_a_fixed_margin_are_updated_too(tmp_path: Path) -> None:
    from test_bands import warming

    settings = Settings(conform="position", margin=1.2, bands=2)
    old = tmp_path / "old.parquet"
    warming(old, seed=1)
    found = identify(ROBOT, [old], settings, keep="sums")
    model = save_model(found.model, tmp_path / "m.json")
    assert isinstance(found.retained, RetainedSums)
    save_state(tmp_path / "s.state", found.retained, model)
    new = tmp_path / "new.parquet"
    warming(new, seed=2, hottest=60.0)
    added = check(Campaign(tmp_path, old, model, tmp_path / "s.state"), [new])
    cold, hot = added.model.sets["powered, band 1"].temp, added.model.sets["powered, band 2"].temp
    assert cold is not None and hot is not None
    assert cold.hi == hot.lo == model.sets["powered, band 1"].temp.hi, "the edges stay"  # type: ignore[union-attr]
    assert hot.hi > 1.2, "the last band ends with the hottest reading"


def stops(phase: str, count: int, seed: int) -> list[Recording]:
    """Two joints slowed down by constant brakes, or by a ramp, from a request at the tenth sample on; then at rest."""
    rng, dt, N = np.random.default_rng(seed), 0.004, 160
    out = []
    for k in range(count):
        v0, slowing = rng.uniform(-1.0, 1.0, 2), rng.uniform(3.6, 4.0)
        age = np.maximum(dt * (np.arange(N) - 10), 0.0)[:, None]
        dq = np.sign(v0) * np.maximum(np.abs(v0) - slowing * np.maximum(age - 0.02, 0.0), 0.0)
        q = np.cumsum(dq, axis=0) * dt + rng.uniform(-1e-5, 1e-5, dq.shape)
        trigger = np.arange(N) >= 10
        noisy = dq + rng.uniform(-1e-3, 1e-3, dq.shape)
        out.append(Recording(phase, 0, k, k, dt * np.arange(N), q, noisy, np.zeros_like(q), stop_trigger=trigger))
    return out


def test_stops_are_folded_in_with_the_bits_of_all_read_together(tmp_path: Path) -> None:
    """Ramps, the noise at rest and the guarantee line rest on old and new stops alike; stops alone can be added too."""
    moving = recordings(J, v, 3, seed=71)
    old = save_trials(tmp_path / "old.parquet", [*moving, *stops("stop1", 10, 1)], JOINTS, effort="motor_torque")
    found = identify(ROBOT, [old], keep="sums")
    assert isinstance(found.retained, RetainedSums) and len(found.retained.stops) == 10
    model = save_model(found.model, tmp_path / "m.json")
    save_state(tmp_path / "s.state", found.retained, model)
    retained = load_state(tmp_path / "s.state", model)
    for a, b in zip(retained.stops, found.retained.stops, strict=True):
        assert a.key == b.key and a.place == b.place and a.stop_trigger is not None and b.stop_trigger is not None
        assert np.array_equal(a.q, b.q) and np.array_equal(a.dq, b.dq) and np.array_equal(a.stop_trigger, b.stop_trigger)
    both = save_trials(
        tmp_path / "both.parquet", [*recordings(J, v, 1, seed=72), *stops("stop1", 6, 2)], JOINTS, effort="motor_torque"
    )
    alone = save_trials(tmp_path / "alone.parquet", stops("stop1", 8, 3), JOINTS, effort="motor_torque")
    for new, count in ((both, 16), (alone, 18)):
        added, whole = update(model, retained, [new]), from_scratch(model, retained, [old, new])
        same(added, whole)
        line = [x for x in added.model.notes if x.startswith("STOP 1:")]
        assert len(line) == 1 and line == [x for x in whole.model.notes if x.startswith("STOP 1:")]
        assert line != [x for x in model.notes if x.startswith("STOP 1:")], "it rests on more stops than before"
        assert isinstance(added.retained, RetainedSums) and len(added.retained.stops) == count
        assert f"{count - 10} stops added to 10" in added.model.revisions[-1].note


@pytest.fixture(scope="module")
def motor(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder = tmp_path_factory.mktemp("motor")
    old = save_trials(folder / "old.parquet", recordings(J, v, 6, seconds=2.0, bias=0.0, seed=81), JOINTS, effort="motor_torque")
    found = identify(ROBOT, [old], keep="sums")
    model = save_model(found.model, folder / "m.json")
    assert isinstance(found.retained, RetainedSums)
    save_state(folder / "s.state", found.retained, model)
    return Campaign(folder, old, model, folder / "s.state")


def test_the_nominal_models_sums_fold_to_those_of_all_recordings(motor: Campaign) -> None:
    """Solved again they are the nominal model of all recordings read together, so the difference that is told is the true one."""
    new = save_trials(
        motor.folder / "more.parquet", recordings(J, v, 3, seconds=2.0, bias=0.0, seed=82), JOINTS, effort="motor_torque"
    )
    retained = motor.retained()
    assert retained.nominal.data is not None
    # of what was kept alone it is the model's own nominal model
    assert np.all(staleness.torque_difference(retained.nominal.data, ROBOT, motor.model) < 1e-6)
    added = update(motor.model, retained, [new])
    assert isinstance(added.retained, RetainedSums) and added.retained.nominal.data is not None
    held = added.survey.held_out
    read = [r for r in stream_recordings([motor.old, new], ROBOT) if r.suite_key not in held]
    whole = identify_nominal(ROBOT, read)
    again = solve_nominal(ROBOT, added.retained.nominal.data)
    spread = np.sqrt(np.diag(whole.covariance))
    assert np.all(np.abs(whole.theta - again.theta) <= 1e-6 * spread + 1e-9)
    assert added.retained.nominal.data.recordings == retained.nominal.data.recordings + len(read) - 24


@pytest.mark.parametrize(("friction", "due"), [((4.0, 2.0), False), ((6.0, 3.0), True)])
def test_an_update_says_when_the_nominal_model_is_out_of_date(motor: Campaign, friction: tuple[float, float], due: bool) -> None:
    trials = recordings(J, friction, 4, seconds=2.0, bias=0.0, seed=83)
    new = save_trials(motor.folder / f"drift_{due}.parquet", trials, JOINTS, effort="motor_torque")
    note = update(motor.model, motor.retained(), [new]).model.revisions[-1].note
    assert "a nominal model of all recordings would differ by" in note
    assert (staleness.DUE in note) == due, note


def test_an_update_of_compensated_torque_compares_errors(nine: Campaign) -> None:
    for friction, due in ((v, False), ((6.0, 3.0), True)):
        new = nine.write(f"drift_{due}.parquet", recordings(J, friction, 2, seed=84))
        note = update(nine.model, nine.retained(), [new]).model.revisions[-1].note
        assert "times that on the old ones" in note and "a nominal model of all" not in note
        assert (staleness.DUE in note) == due, note


def test_the_command_keeps_updates_and_keeps_again(nine: Campaign, capsys: pytest.CaptureFixture[str]) -> None:
    from synthetic import urdf

    d = nine.folder
    (d / "arm.urdf").write_text(urdf(JOINTS))
    new = nine.write("cli.parquet", recordings(J, v, 2, seed=21))
    old = ["identify", "--robot", str(d / "arm.urdf"), "--data", str(nine.old), "--out", str(d / "c.json")]
    assert main([*old, "--keep", str(d / "c.state"), "--keep-as", "sums"]) == 0
    words = [
        "identify",
        "--update",
        str(d / "c.json"),
        "--state",
        str(d / "c.state"),
        "--data",
        str(new),
        "--out",
        str(d / "c2.json"),
    ]
    assert main([*words, "--keep", str(d / "c2.state")]) == 0
    assert "the nominal model stays that of old.parquet" in capsys.readouterr().out
    model = load_model(d / "c2.json")
    assert len(model.revisions) == 2
    # what --keep costs is memory, never a different model
    assert main([*old[:-1], str(d / "plain.json")]) == 0
    assert (d / "plain.json").read_text() == (d / "c.json").read_text()
    again = [
        "identify",
        "--update",
        str(d / "c2.json"),
        "--state",
        str(d / "c2.state"),
        "--data",
        str(new),
        "--out",
        str(d / "c3.json"),
    ]
    for bad, why in (
        (again, "is part of this model already"),
        ([*words[:-1], str(d / "c3.json"), "--conform", "position"], "--conform cannot be given with --update"),
        ([*words[:3], *words[5:-1], str(d / "c3.json")], "expected --state"),
        ([*old[:-1], str(d / "c3.json"), "--state", str(d / "c.state")], "only read by --update"),
        (["identify", "--data", str(new), "--out", str(d / "c3.json")], "no robot is named"),
        (
            [*old[:-1], str(d / "c3.json"), "--model", "2", "--order", "1", "--keep", str(d / "x.state")],
            "needs the arm's inertias",
        ),
    ):
        capsys.readouterr()
        assert main(bad) == 2, why
        err = capsys.readouterr().err
        assert why in err and "Traceback" not in err and not (d / "c3.json").exists()


def test_the_same_recording_twice_is_refused_under_any_name(nine: Campaign) -> None:
    copy = nine.folder / "copy.parquet"
    copy.write_bytes(nine.old.read_bytes())
    with pytest.raises(RecordingError, match=r"copy.parquet .* is part of this model already, as old.parquet"):
        update(nine.model, nine.retained(), [copy])
    new = nine.write("pair.parquet", recordings(J, v, 1, seed=31))
    with pytest.raises(RecordingError, match="the same recording, byte for byte"):
        update(nine.model, nine.retained(), [new, new])


def test_new_files_of_an_old_name_are_told_apart(nine: Campaign) -> None:
    folder = nine.folder / "later"
    folder.mkdir()
    path = save_trials(folder / "old.parquet", recordings(J, v, 1, seed=41), JOINTS)
    data = check(nine, [path]).model.provenance["data"]
    assert set(data) == {"old.parquet", "old.parquet (2)"} and len(set(data.values())) == 2


def test_recordings_that_widen_the_sets_or_are_of_another_condition_are_refused(nine: Campaign) -> None:
    """A load told or not told: neither ends in the torque sets of the arm without it."""
    loaded = nine.write("loaded.parquet", recordings(J, v, 3, bias=6.0, spread=0.5, seed=21))
    with pytest.raises(RecordingError, match=r"would grow from .* to .* N m in sum.*--accept-wide"):
        update(nine.model, nine.retained(), [loaded])
    assert (
        update(nine.model, nine.retained(), [loaded], wide=True).model.powered.U.width.sum()
        > 4 * nine.model.powered.U.width.sum()
    )
    table = pq.read_table(loaded)
    told = nine.folder / "condition.parquet"
    pq.write_table(table.append_column("condition", pa.array(["payload=2.8"] * table.num_rows)), told)
    with pytest.raises(RecordingError, match=r"2 conditions \(none stated; payload=2.8\)"):
        update(nine.model, nine.retained(), [told])


def test_recordings_without_powered_motion_or_of_another_torque_are_refused(nine: Campaign) -> None:
    still = nine.write("static.parquet", [replace(r, phase="static") for r in recordings(J, v, 1, seed=51)])
    with pytest.raises(RecordingError, match=r"hold only static trials .*; expected open_loop trials or stops"):
        update(nine.model, nine.retained(), [still])
    other = save_trials(nine.folder / "motor.parquet", recordings(J, v, 1, seed=52), JOINTS, effort="motor_torque")
    with pytest.raises(RecordingError, match="hold motor_torque, the model was identified from compensated_torque"):
        update(nine.model, nine.retained(), [other])


def test_a_foreign_damaged_or_hostile_state_is_refused(nine: Campaign, tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="belongs to the model"):
        nine.retained(replace(nine.model, sha256="0" * 64))
    changed = dict(nine.model.provenance["settings"]) | {"conform": "position"}
    with pytest.raises(ModelFileError, match="other settings"):
        nine.retained(replace(nine.model, provenance={**nine.model.provenance, "settings": changed}))
    whole = nine.state.read_bytes()
    with np.load(io.BytesIO(whole)) as file:
        arrays = {k: file[k] for k in file.files}
    head = json.loads(arrays["head"].tobytes())

    def written(**more: Any) -> Path:
        np.savez(tmp_path / "bad.npz", **(arrays | more))
        return tmp_path / "bad.npz"

    def headed(**more: Any) -> Path:
        return written(head=np.frombuffer(json.dumps(head | more).encode(), np.uint8))

    flipped = bytearray(whole)
    with zipfile.ZipFile(io.BytesIO(whole)) as packed:  # in the middle of what is stored, not of a name
        largest = max(packed.infolist(), key=lambda member: member.compress_size)
    flipped[largest.header_offset + largest.compress_size // 2 + 100] ^= 0xFF
    (tmp_path / "flipped").write_bytes(flipped)
    (tmp_path / "cut").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text").write_text("no zip")
    wrong = {f"part_0_{ENVELOPE[0]}": arrays["part_0_hi"][:-1]}
    bad = [tmp_path / "flipped", tmp_path / "cut", tmp_path / "text", tmp_path / "absent"]
    for path in bad:
        with pytest.raises(ModelFileError, match="identify again"):
            load_state(path, nine.model)
    for make in (
        lambda: headed(schema=99), lambda: headed(format="other"), lambda: headed(tally=3), lambda: written(**wrong),
        lambda: written(torques=arrays["torques"][:-1]), lambda: written(head=np.array([{"a": print}], dtype=object)),
    ):  # fmt: skip
        with pytest.raises(ModelFileError):
            load_state(make(), nine.model)


def test_what_belongs_to_the_nominal_model_survives_an_update(motor: Campaign) -> None:
    """Its errors decide stop bounds and what `diagnose` tells of a change: a model that takes new recordings in must not lose them."""
    trials = recordings(J, v, 3, seconds=2.0, bias=0.0, seed=84)
    new = save_trials(motor.folder / "later.parquet", trials, JOINTS, effort="motor_torque")
    added = update(motor.model, motor.retained(), [new]).model
    assert motor.model.inertia_std is not None and added.inertia_std is not None
    assert np.array_equal(added.inertia_std, motor.model.inertia_std)
    for key in ("chosen", "taken_out", "friction_covariance"):
        assert added.provenance[key] == motor.model.provenance[key]
    assert added.provenance["friction_covariance"]
