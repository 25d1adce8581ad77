"""Sets per temperature band: narrower where temperature matters, and true for everything recorded in the band."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import Model, load_model, save_model
from stopset.cli.main import main
from stopset.errors import RecordingError
from stopset.offline.campaign.survey import on_grid, survey
from stopset.offline.compare.compare import compare
from stopset.offline.conform.bands import Bands, cut, narrower
from stopset.offline.conform.envelope import Deviations
from stopset.offline.identify.constants import settings_sha256
from stopset.offline.identify.pipeline import Identification, Settings, identify
from stopset.reach.flowpipe import deviation_tube
from stopset.recording import Recording, stream_recordings
from stopset.sets import Box
from synthetic import arm, columns, lag, meta, names, save, torques

JOINTS = names(2)
J, v = (1.0, 0.5), (4.0, 2.0)
DT = 0.004
SHARED = Path(__file__).resolve().parents[2] / "shared" / "data" / "hidden_effect" / "d01"


def warming(
    path: Path, *, seed: int, hottest: float = 45.0, slope: float = 0.02, temperatures: bool = True, suites: int = 3,
    trials: int = 8, rough: Mapping[int, float] | None = None,
) -> list[Recording]:  # fmt: skip
    """Two lags with a torque that rises by ``slope`` [N m/K] as they warm; saved to ``path``.

    ``rough``: suite -> size of its other disturbance [N m], 0.05 where none is given.
    """
    rng = np.random.default_rng(seed)
    N = 250
    out = []
    for s in range(suites):
        u, q0 = torques(rng, N, 2, 6.0), rng.uniform(-0.5, 0.5, 2)
        for k in range(trials):
            temp = 20.0 + (hottest - 20.0) * k / (trials - 1) + rng.uniform(-0.5, 0.5, (N, 2))
            hidden = (rough or {}).get(s, 0.05) * np.repeat(rng.uniform(-1, 1, (N // 10 + 1, 2)), 10, axis=0)[:N] + slope * (
                temp.mean() - 30.0
            )
            q, dq = np.empty((N, 2)), np.empty((N, 2))
            for j in range(2):
                q[:, j], dq[:, j] = lag(J[j], v[j], DT, q0[j], 0.0, u[:, j] + hidden[:, j])
            q += rng.uniform(-1e-5, 1e-5, q.shape)
            dq += rng.uniform(-1e-3, 1e-3, dq.shape)
            out.append(Recording("open_loop", s, k, s * trials + k, DT * np.arange(N), q, dq, u.copy(), temp))
    table = columns(out, JOINTS)
    if temperatures:
        table |= {f"temp_{j}": np.concatenate([r.temp[:, i] for r in out if r.temp is not None]) for i, j in enumerate(JOINTS)}
    save(path, table, meta(JOINTS))
    return out


def enclosed(model: Model, path: Path) -> dict[str, int]:
    """Trials per band whose every sample in the band is followed by readings inside the band's tube; fails on any other."""
    found = survey(lambda: stream_recordings([path], model.robot))
    counts: dict[str, int] = {}
    bands = {name: (s, deviation_tube(model.abstraction, s)) for name, s in model.sets.items() if s.temp is not None}
    for r in stream_recordings([path], model.robot):
        if r.phase != found.phase:
            continue
        g = on_grid(r, model.powered.dt)
        u = model.input(g.q, g.dq, g.tau, g.temp, found.warm(r), g.t)
        assert g.temp is not None
        somewhere = np.zeros(len(g.t), bool)
        for name, (s, tube) in bands.items():
            assert s.temp is not None
            inside = s.temp.covers(g.temp)
            somewhere |= inside
            if not inside.any():
                continue
            env = Deviations(model.abstraction, s.dt, len(tube.ages) - 1, s.windows).of(g, u)
            last = env.steps
            assert np.all(env.hi[: last + 1] <= tube.hi[: last + 1]) and np.all(env.lo[: last + 1] >= tube.lo[: last + 1]), (
                name,
                r.label,
            )
            counts[name] = counts.get(name, 0) + 1
        assert somewhere.all(), f"{r.label}: a recorded temperature lies in no band"
    return counts


@pytest.fixture(scope="module")
def warmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Identification]:
    path = tmp_path_factory.mktemp("bands") / "warm.parquet"
    warming(path, seed=3)
    return path, identify(arm(JOINTS), [path], Settings(bands=3))


def test_bands_are_narrower_where_the_torque_depends_on_temperature(warmed: tuple[Path, Identification]) -> None:
    """25 K move the torque by 0.5 N m, the rest by 0.1: a third of the range leaves 0.27 of 0.6 N m, and some overlap."""
    _, found = warmed
    rows = narrower(found.model)
    assert [b.band for b in rows] == ["powered, band 1", "powered, band 2", "powered, band 3"]
    for b in rows:
        assert b.tube_share is not None and b.tube_share < 0.7 and b.torque_share < 0.7
    # the centres of U move the way the torque does
    centres = [found.model.sets[b.band].U.centre for b in rows]
    assert np.all(centres[0] < centres[1]) and np.all(centres[1] < centres[2])


def test_what_was_recorded_in_a_band_is_enclosed_by_its_sets(warmed: tuple[Path, Identification]) -> None:
    path, found = warmed
    counts = enclosed(found.model, path)
    assert len(counts) == 3 and min(counts.values()) >= 6 and sum(counts.values()) >= 24


def test_a_bands_sets_are_not_those_of_other_temperatures(warmed: tuple[Path, Identification]) -> None:
    """The check above can fail: cold trials leave the warm band's tube."""
    path, found = warmed
    m = found.model
    s = m.sets["powered, band 3"]
    tube = deviation_tube(m.abstraction, s)
    r = next(iter(stream_recordings([path], m.robot)))
    env = Deviations(m.abstraction, s.dt, len(tube.ages) - 1, s.windows).of(r, m.input(r.q, r.dq, r.tau, r.temp, 0.0, r.t))
    assert np.any(env.lo < tube.lo[: len(env.lo)])


def test_compare_holds_recordings_against_the_sets_of_their_temperature(warmed: tuple[Path, Identification]) -> None:
    """What the whole's sets let pass, a band's may not: with the warm band's sets in the cold band's place cold trials leave."""
    path, found = warmed
    m = found.model
    bands = compare(m, [path]).bands
    assert list(bands) == [f"powered, band {k}" for k in (1, 2, 3)]
    assert all(out == 0 for _, out in bands.values()) and min(held for held, _ in bands.values()) >= 3
    cold, warm = m.sets["powered, band 1"], m.sets["powered, band 3"]
    swapped = replace(m, sets={**m.sets, "powered, band 1": replace(warm, temp=cold.temp)})
    again = compare(swapped, [path])
    assert again.bands["powered, band 1"][1] > 0 and not again.violations


def test_the_whole_is_what_it_was_without_bands(warmed: tuple[Path, Identification]) -> None:
    path, found = warmed
    plain = identify(arm(JOINTS), [path])
    for name, s in plain.model.sets.items():
        other = found.model.sets[name]
        assert np.array_equal(s.U.lo, other.U.lo) and np.array_equal(s.V.hi, other.V.hi) and np.array_equal(s.X0.lo, other.X0.lo)
        assert other.temp is None
    assert plain.model.guarantee == found.model.guarantee
    assert settings_sha256(plain.settings) != settings_sha256(found.settings)


def test_bands_survive_the_model_file_and_are_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from synthetic import urdf

    warming(tmp_path / "r.parquet", seed=4)
    (tmp_path / "arm.urdf").write_text(urdf(JOINTS))
    words = ["identify", "--robot", str(tmp_path / "arm.urdf"), "--data", str(tmp_path / "r.parquet"), "--bands", "2"]
    assert main([*words, "--out", str(tmp_path / "m.json"), "--report", str(tmp_path / "r.html")]) == 0
    out = capsys.readouterr().out
    assert "powered, band 1" in out and "of the whole's" in out
    assert "How much narrower the sets are" in (tmp_path / "r.html").read_text()
    model = load_model(tmp_path / "m.json")
    assert [s.temp is not None for s in model.sets.values()].count(True) == 2
    again = load_model(save_model(model, tmp_path / "n.json") and tmp_path / "n.json")
    a, b = model.sets["powered, band 2"].temp, again.sets["powered, band 2"].temp
    assert a is not None and b is not None and (a.lo, a.hi) == (b.lo, b.hi) and np.array_equal(a.reference.hi, b.reference.hi)


def test_bands_without_temperatures_are_one_sentence(tmp_path: Path) -> None:
    warming(tmp_path / "r.parquet", seed=5, temperatures=False)
    with pytest.raises(RecordingError, match="no temp_ column"):
        identify(arm(JOINTS), [tmp_path / "r.parquet"], Settings(bands=2))


def test_bands_need_temperatures_that_differ() -> None:
    with pytest.raises(RecordingError, match="never move"):
        cut(np.full((9, 2), 30.0), Box.point([30.0, 30.0]), 2)
    with pytest.raises(RecordingError, match="do not make 5 bands"):
        cut(np.repeat([[20.0, 20.0], [30.0, 30.0]], 4, axis=0), Box.of([20.0, 20.0], [30.0, 30.0]), 5)


def test_a_trial_belongs_to_every_band_it_touches() -> None:
    """Warmth is the mean of the joints that move; a reading on an edge belongs to both sides."""
    bands = Bands(Box.of([20.0, 20.0, 7.0], [40.0, 60.0, 7.0]), (0.25, 0.5))

    def of(*rows: tuple[float, float]) -> list[int]:
        temp = np.array([[a, b, 7.0] for a, b in rows])
        x = np.zeros((len(rows), 3))
        return list(bands.of(Recording("open_loop", 0, 0, 0, np.arange(len(rows)) * DT, x, x, x, temp)))

    assert of((20.0, 20.0)) == [0]
    assert of((20.0, 20.0), (28.0, 36.0)) == [0, 1]  # warmth 0.4
    assert of((25.0, 30.0)) == [0, 1]  # on the first edge
    assert of((10.0, 10.0), (50.0, 70.0)) == [0, 1, 2]
    x = np.zeros((2, 3))
    assert list(bands.of(Recording("open_loop", 0, 0, 0, np.arange(2) * DT, x, x, x))) == [0, 1, 2], "unknown temperature"
    ends = [bands.band(k, Box.of([10.0, 20.0, 7.0], [40.0, 80.0, 7.0])) for k in range(3)]
    assert [(b.lo, b.hi) for b in ends] == [(-0.25, 0.25), (0.25, 0.5), (0.5, 1.25)]


@pytest.mark.shared
def test_hidden_thermal_friction_makes_narrower_bands(tmp_path: Path) -> None:
    """Set d01 hides viscous friction that falls with temperature at two joints (thermal_viscous)."""
    if not SHARED.exists():
        pytest.skip("../shared/data/hidden_effect/d01 is not here")
    from stopset.offline.description import load_robot

    robot = load_robot(str(SHARED / "robot.urdf"))
    found = identify(robot, [SHARED / "recording.parquet"], Settings(bands=3))
    rows = narrower(found.model)
    for b in rows:
        assert b.tube_share is not None and b.tube_share < 0.95
    assert len(enclosed(found.model, SHARED / "recording.parquet")) == 3


def test_held_out_motions_are_enclosed_in_their_band_too(tmp_path: Path) -> None:
    """Nine motions, two of them held out and disturbed more than the others: the bands' sets are fitted without them."""
    path = tmp_path / "nine.parquet"
    warming(path, seed=6, suites=9, trials=4, rough={3: 0.15, 7: 0.15})
    found = identify(arm(JOINTS), [path], Settings(bands=2))
    assert found.model.guarantee.motions == 2
    counts = enclosed(found.model, path)
    assert sum(counts.values()) >= 36
