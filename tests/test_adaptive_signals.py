"""Recordings added to a model from its kept signals: the model of all recordings read together, old files gone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stopset.artifact import Model, load_model, model_text, save_model
from stopset.cli.main import main
from stopset.effects.base import Fitted
from stopset.errors import ModelFileError, RecordingError
from stopset.offline.identify import signals_file
from stopset.offline.identify.pipeline import Settings, identify
from stopset.offline.identify.signals_file import RetainedSignals
from stopset.offline.update.update import load_state, save_state, update
from stopset.recording import Recording, stream_recordings, write_recordings
from stopset.robot import Robot
from stopset.simulation import prepare
from synthetic import arm, names, recordings, save_trials, urdf
from test_adaptive import stops
from test_bands import warming

JOINTS = names(2)
J, v = (1.0, 0.5), (4.0, 2.0)
ROBOT = arm(JOINTS)
SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def body(model: Model) -> dict[str, Any]:
    """The whole model file but its history: every number to the last digit, notes and guarantee word by word."""
    whole = json.loads(model_text(model))
    return {k: x for k, x in whole.items() if k not in ("sha256", "revisions")}


def updated(folder: Path, robot: Robot, old: list[Path], new: list[Path], settings: Settings | None = None) -> Model:
    """Identified from ``old``, kept, old files removed, and updated with ``new``."""
    found = identify(robot, old, settings, keep="signals")
    model = save_model(found.model, folder / "old.model.json")
    assert isinstance(found.retained, RetainedSignals)
    save_state(folder / "old.state", found.retained, model)
    away = [p.rename(p.with_suffix(".away")) for p in old]
    try:
        return update(load_model(folder / "old.model.json"), load_state(folder / "old.state", model), new).model
    finally:
        for p in away:
            p.rename(p.with_suffix(".parquet"))


def check(folder: Path, robot: Robot, old: list[Path], new: list[Path], settings: Settings | None = None) -> Model:
    after = updated(folder, robot, old, new, settings)
    assert body(after) == body(identify(robot, [*old, *new], settings).model)
    return after


def test_an_update_is_the_model_of_all_recordings(tmp_path: Path) -> None:
    """Another friction, longer trials, a wider disturbance: nominal model, sets, margin, guarantee must all move."""
    old = save_trials(tmp_path / "old.parquet", recordings(J, v, 9), JOINTS)
    new = save_trials(
        tmp_path / "new.parquet", recordings(J, (5.0, 2.5), 4, 5, 1.4, spread=0.5, noise=(2e-5, 2e-3), seed=7), JOINTS
    )
    after, before = check(tmp_path, ROBOT, [old], [new]), load_model(tmp_path / "old.model.json")
    assert np.all(after.abstraction.viscous > 1.05 * before.abstraction.viscous), "the nominal model does not stay"
    assert after.guarantee.motions == 3 and before.guarantee.motions == 2
    first, last = after.revisions
    assert first == before.revisions[0] and last.before == first.after and last.after != first.after
    assert last.added == "recordings new.parquet" and "old.parquet" in last.note


def test_a_whole_campaign_of_motor_torque_with_poses_stops_and_an_effect(tmp_path: Path) -> None:
    """The simulated arm's campaign in two halves; the effect's numbers are estimated from both."""
    scenario = prepare(ROBOT, ["thermal_viscous:axis_1"], 4, "short", "easy", "wrong")
    trials = list(scenario.recordings())
    halves = [tmp_path / "old.parquet", tmp_path / "new.parquet"]
    for k, path in enumerate(halves):
        write_recordings(path, scenario.meta, (r for r in trials if (r.suite if r.phase == "open_loop" else r.trial) % 2 == k))
    after = check(tmp_path, scenario.robot, halves[:1], halves[1:], Settings(effects=("thermal_viscous:axis_1",)))
    before = load_model(tmp_path / "old.model.json")
    own = [next(f.values for f in m.effects if f.effect == "thermal_viscous") for m in (before, after)]
    assert own[0] != own[1] and any(x.startswith("STOP 1:") for x in after.notes)


@pytest.mark.parametrize(
    "settings", [Settings(conform="position", margin=1.2, bands=2), Settings(shape="zonotope"), Settings(windows="start")]
)
def test_bands_zonotopes_and_every_other_choice_are_kept(tmp_path: Path, settings: Settings) -> None:
    warming(tmp_path / "old.parquet", seed=1)
    warming(tmp_path / "new.parquet", seed=2, hottest=60.0)
    check(tmp_path, ROBOT, [tmp_path / "old.parquet"], [tmp_path / "new.parquet"], settings)


def test_nonlinear_models_are_updated_too(tmp_path: Path) -> None:
    old, new = (
        save_trials(tmp_path / name, recordings(J, v, 2, 2, seconds=1.2, bias=0.0, seed=seed), JOINTS, effort="motor_torque")
        for name, seed in (("old.parquet", 81), ("new.parquet", 82))
    )
    check(tmp_path, ROBOT, [old], [new], Settings(model=2, order=3))


def test_file_by_file_is_at_once(tmp_path: Path) -> None:
    """Each update keeps anew; stops alone can be added; the last state knows all of them."""
    save_trials(tmp_path / "a.parquet", recordings(J, v, 3, seed=71), JOINTS, effort="motor_torque")
    save_trials(tmp_path / "b.parquet", stops("stop1", 10, 1), JOINTS, effort="motor_torque")
    save_trials(tmp_path / "c.parquet", recordings(J, v, 2, seed=72), JOINTS, effort="motor_torque")
    paths = [tmp_path / f"{x}.parquet" for x in "abc"]
    found, model = identify(ROBOT, paths[:1], keep="signals"), None
    for path in [*paths[1:], None]:
        model = save_model(
            found.model if model is None else replace(found.model, revisions=found.model.revisions), tmp_path / "m"
        )
        assert isinstance(found.retained, RetainedSignals)
        save_state(tmp_path / "m.state", found.retained, model)
        if path is not None:
            found = update(model, load_state(tmp_path / "m.state", model), [path])
    assert model is not None and body(model) == body(identify(ROBOT, paths).model)
    assert [r.number for r in model.revisions] == [0, 1, 2]
    state = load_state(tmp_path / "m.state", model)
    assert isinstance(state, RetainedSignals)
    for retained, read in zip(state.campaign.trials(), stream_recordings(paths, ROBOT), strict=True):
        exact(retained, read)


def exact(a: Recording, b: Recording) -> None:
    assert (a.key, a.place, a.file) == (b.key, b.place, b.file)
    for name in ("t", "q", "dq", "tau", "temp", "stop_trigger"):
        x, y = getattr(a, name), getattr(b, name)
        assert (x is None) == (y is None), name
        assert x is None or (x.dtype == y.dtype and np.array_equal(x, y) and x.flags.c_contiguous), name


def test_what_is_read_back_is_what_was_kept_to_the_last_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials across batches, with and without temperature and trigger, numbers of every size."""
    monkeypatch.setattr(signals_file, "GROUP_ROWS", 64)
    rng = np.random.default_rng(0)
    trials = []
    for k, rows in enumerate((3, 64, 200, 61, 64)):
        x = rng.standard_normal((4, rows, 2)) * 10.0 ** rng.integers(-300, 300, (4, rows, 2))
        trigger = rng.random(rows) > 0.5 if k % 2 else None
        t = np.cumsum(rng.random(rows))
        trials.append(
            Recording("stop1", k // 2, k, k, t, *x[:3], temp=x[3] if k in (1, 2) else None, stop_trigger=trigger, file=k // 3)
        )
    old = save_trials(tmp_path / "old.parquet", recordings(J, v, 2), JOINTS)
    found = identify(ROBOT, [old], keep="signals")
    assert isinstance(found.retained, RetainedSignals)
    retained = replace(found.retained, campaign=replace(found.retained.campaign, trials=lambda: iter(trials)))
    save_state(tmp_path / "s", retained, found.model)
    back = load_state(tmp_path / "s", found.model)
    assert isinstance(back, RetainedSignals) and back.campaign.meta == retained.campaign.meta and back.places == retained.places
    for a, b in zip(back.campaign.trials(), trials, strict=True):
        exact(a, b)


def test_numbers_of_an_effect_that_were_given_are_given_again(tmp_path: Path) -> None:
    """So a model of ``stopset add`` was identified; estimating them anew would be another model."""
    old = save_trials(tmp_path / "old.parquet", recordings(J, v, 3, seconds=1.5, bias=0.0), JOINTS, effort="motor_torque")
    new = save_trials(tmp_path / "new.parquet", recordings(J, v, 2, seconds=1.5, bias=0.0, seed=5), JOINTS, effort="motor_torque")
    given = (Fitted("spring", "axis_2", {"k": 0.2, "c": 0.1}, {}),)
    settings = Settings(effects=("spring:axis_2",))
    found = identify(ROBOT, [old], settings, known=given, keep="signals")
    assert isinstance(found.retained, RetainedSignals)
    model = save_model(found.model, tmp_path / "m")
    save_state(tmp_path / "s", found.retained, model)
    after = update(model, load_state(tmp_path / "s", model), [new]).model
    assert body(after) == body(identify(ROBOT, [old, new], settings, known=given).model)
    assert [f for f in after.effects if f.effect == "spring"] == list(given)


def test_the_command_needs_no_old_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "arm.urdf").write_text(urdf(JOINTS))
    old = save_trials(tmp_path / "old.parquet", recordings(J, v, 3), JOINTS)
    new = save_trials(tmp_path / "new.parquet", recordings(J, v, 2, seed=9), JOINTS)
    robot = ["identify", "--robot", str(tmp_path / "arm.urdf"), "--out"]
    assert main([*robot, str(tmp_path / "both"), "--data", str(old), str(new)]) == 0
    assert main([*robot, str(tmp_path / "m"), "--data", str(old), "--keep", str(tmp_path / "s")]) == 0
    old.unlink()
    words = ["identify", "--update", str(tmp_path / "m"), "--state", str(tmp_path / "s"), "--data", str(new), "--out"]
    # the state may take the place of the one it continues
    assert main([*words, str(tmp_path / "m2"), "--keep", str(tmp_path / "s")]) == 0
    assert body(load_model(tmp_path / "m2")) == body(load_model(tmp_path / "both"))
    capsys.readouterr()
    for bad, why in (
        ([*words, str(tmp_path / "m3")], "belongs to the model"),
        ([*words, str(tmp_path / "m3"), "--keep-as", "sums"], "--keep-as cannot be given with --update"),
    ):
        assert main(bad) == 2
        err = capsys.readouterr().err
        assert why in err and "Traceback" not in err and not (tmp_path / "m3").exists()


def test_a_foreign_or_damaged_file_or_a_recording_twice_is_refused(tmp_path: Path) -> None:
    old = save_trials(tmp_path / "old.parquet", recordings(J, v, 9, 8), JOINTS)
    found = identify(ROBOT, [old], keep="signals")
    model = save_model(found.model, tmp_path / "m")
    assert isinstance(found.retained, RetainedSignals)
    save_state(tmp_path / "s", found.retained, model)
    whole = (tmp_path / "s").read_bytes()
    (tmp_path / "cut").write_bytes(whole[: len(whole) // 2])
    flipped = bytearray(whole)
    flipped[len(whole) // 3] ^= 0xFF
    (tmp_path / "flipped").write_bytes(flipped)
    for name in ("cut", "absent", "old.parquet", "flipped"):
        with pytest.raises(ModelFileError, match="identify again"):
            state = load_state(tmp_path / name, model)
            assert isinstance(state, RetainedSignals)
            list(state.campaign.trials())
    fresh = save_trials(tmp_path / "fresh.parquet", recordings(J, v, 1, seed=51), JOINTS)
    newer = replace(model, provenance={**model.provenance, "settings": {**model.provenance["settings"], "colour": "red"}})
    with pytest.raises(ModelFileError, match=r"does not have \(colour\)"):
        update(newer, load_state(tmp_path / "s", newer), [fresh])
    with pytest.raises(ModelFileError, match="belongs to the model"):
        load_state(tmp_path / "s", replace(model, sha256="0" * 64))
    copy = tmp_path / "copy.parquet"
    copy.write_bytes(old.read_bytes())
    with pytest.raises(RecordingError, match=r"copy.parquet .* is part of this model already, as old.parquet"):
        update(model, load_state(tmp_path / "s", model), [copy])
    other = save_trials(tmp_path / "motor.parquet", recordings(J, v, 1, seed=52), JOINTS, effort="motor_torque")
    with pytest.raises(RecordingError, match="hold motor_torque, the model was identified from compensated_torque"):
        update(model, load_state(tmp_path / "s", model), [other])
