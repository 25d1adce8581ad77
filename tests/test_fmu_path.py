"""A unit with a path: the stop along it has the bits of `stopset stops --path`, and there is none for an arm that is elsewhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as File

import numpy as np
import pytest

from fmu_models import arm_model
from fmu_unit import Unit, unit
from stopset.artifact import Model, save_model
from stopset.cli.main import main
from stopset.effects.base import Fitted
from stopset.errors import NotCovered
from stopset.fmu import Contents, export
from stopset.fmu.build import native
from stopset.fmu.stops import bounds_of
from stopset.offline.stops.table import Question, along_path
from stopset.reach.stops.path import Path, path_stop
from stopset.types import Array
from test_fmu_stops import braking, effects_of_pose, equals, ramped, silent

pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = pytest.mark.skipif(native() is None, reason="no FMU binaries for this platform")


def rows(n: int) -> Array:
    """(6, n) [rad] a path that turns round in some joints."""
    k = np.arange(6)[:, None]
    return 0.25 * k * np.cos(0.5 * k + np.arange(n)) * np.linspace(1.0, 0.5, n)


def posed() -> Model:
    """Effects of pose and speed, and a ramp."""
    return replace(effects_of_pose(), provenance={"stop1_ramp": ramped(3).as_dict()})


def misread() -> Model:
    """A joint whose zero is 0.1 rad off: on its path the arm is elsewhere than it reads."""
    model = braking()
    return replace(model, effects=(*model.effects, Fitted("encoder_offset", model.joints[1], {"e": 0.1}, {"e": 0.002})))


def grazing() -> Model:
    """A range that ends where the path turns round, but for half the tracking error."""
    model, s = misread(), np.linspace(0.0, 5.0, 5001)
    limit = model.robot.q_limit.copy()
    limit[2, 0] = Path.through(rows(model.n)).p(s, 0)[:, 2].min() - 1e-3
    return replace(model, robot=replace(model.robot, q_limit=limit))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Model, File]]:
    folder, out = tmp_path_factory.mktemp("path"), {}
    for name, model in (("linear", braking()), ("of pose", posed()), ("misread", misread()), ("grazing", grazing())):
        path = Path.through(rows(model.n))
        contents = Contents(3, (str(native()),), reference=False, path=path)
        out[name] = model, export(model, folder / f"{name.replace(' ', '_')}.fmu", contents)
    return out


def follow(u: Unit, model: Model, path: Path, row: float, rate: float, off: float = 0.0) -> None:
    """The measured arm on its path, ``off`` [rad] from it."""
    at = np.array([row])
    u.state(model, path.p(at, 0)[0] + off, path.p(at, 1)[0] * rate)
    u.set({"path_row": row, "path_rate": rate})


ASKED = ((0.0, 0.3), (0.7, 0.8), (1.4, 1.5), (2.0, 0.05), (3.3, 1.1), (2.5, 2.5))


@pytest.mark.parametrize("name", ["linear", "of pose", "misread", "grazing"])
def test_a_stop_along_the_path_has_the_bits_of_python(made: dict[str, tuple[Model, File]], name: str) -> None:
    model, fmu = made[name]
    bounds, path, proved, struck = bounds_of(model), Path.through(rows(model.n)), 0, set()
    with unit(fmu) as u:
        u.begin()
        for row, rate in ASKED:
            follow(u, model, path, row, rate)
            try:
                want = path_stop(bounds, path, row, rate).bound
            except NotCovered:
                assert silent(u, model, "path_stop")
                continue
            assert equals(u, model, want, "path_stop"), (row, rate)
            assert u.get("path_stop_end_stop") == bool(want.end_stops)
            struck.add(bool(want.end_stops))
            # it is the path that tells, not where beside it the arm reads to be
            follow(u, model, path, row, rate, 1e-3)
            assert not want.certified or u.get("path_stop_end_stop") == bool(want.end_stops)
            proved += want.certified
    assert proved >= (2 if name == "grazing" else 4) and struck == ({False, True} if name == "grazing" else {False})


def test_the_bits_are_those_of_the_command_for_the_same_payload(tmp_path: File) -> None:
    model = replace(braking(), domain=replace(braking().domain, payload=(0.0, 0.0)))
    path = Path.through(rows(model.n))
    fmu = export(model, tmp_path / "F.fmu", Contents(3, (str(native()),), reference=False, path=path))
    want = along_path(model, rows(model.n), 0.7, 0.8, Question(None, ("1",), None, None, None))[1]["1"]
    assert want.certified
    with unit(fmu) as u:
        u.begin()
        follow(u, model, path, 0.7, 0.8)
        assert equals(u, model, want, "path_stop")


def test_an_arm_that_is_elsewhere_has_no_stop_along_the_path(made: dict[str, tuple[Model, File]]) -> None:
    model, fmu = made["linear"]
    path = Path.through(rows(model.n))
    with unit(fmu) as u:
        u.begin()
        assert silent(u, model, "path_stop"), "no path is followed yet"
        follow(u, model, path, 0.7, 0.8)
        assert u.get("path_stop_certified") == 1
        for row, rate, off in (
            (0.7, 0.8, 0.1),
            (0.7, 30.0, 0.0),
            (4.999, 1.0, 0.0),
            (0.7, 0.0, 0.0),
            (-1.0, 0.8, 0.0),
            (9.0, 0.8, 0.0),
        ):
            follow(u, model, path, row, rate, off)
            assert silent(u, model, "path_stop"), (row, rate, off)
        follow(u, model, path, 0.7, 0.8)
        u.set({"path_row": float("nan")})
        assert silent(u, model, "path_stop")
        follow(u, model, path, 0.7, 0.8)
        u.set({"path_rate": 0.9})
        assert silent(u, model, "path_stop"), "not as fast as the path says"


def test_a_path_stop_is_computed_when_asked_for(made: dict[str, tuple[Model, File]]) -> None:
    """Once it is, it stands for that row alone."""
    model, fmu = made["linear"]
    path = Path.through(rows(model.n))
    with unit(fmu) as u:
        u.set({"stop_every": 0})
        u.begin()
        follow(u, model, path, 0.7, 0.8)
        assert silent(u, model, "path_stop")
        u.set({"evaluate_stop": True})
        assert u.get("path_stop_certified") == 1
        u.set({"evaluate_stop": False})
        assert u.get("path_stop_certified") == 1
        follow(u, model, path, 0.71, 0.8)
        assert silent(u, model, "path_stop")


def test_the_command_takes_the_file_that_stops_takes(tmp_path: File, capsys: pytest.CaptureFixture[str]) -> None:
    model = braking()
    save_model(model, tmp_path / "m.json")
    csv = tmp_path / "p.csv"
    head = [",".join(model.joints), *(",".join(map(repr, r)) for r in rows(model.n).tolist())]
    csv.write_text("\n".join(head))
    asked = ["export-fmu", str(tmp_path / "m.json"), "--out", str(tmp_path / "F.fmu"), "--source-only", "--path", str(csv)]
    assert main(asked) == 0 and (tmp_path / "F.fmu").stat().st_size > 0
    save_model(arm_model(), tmp_path / "none.json")
    (tmp_path / "F.fmu").unlink()
    for model_file, text, word in (
        ("m.json", "1,2\n3,4\n", "expected 3 angles"), ("m.json", "\n".join(head[:2] * 3), "are not 3 numbers"),
        ("m.json", "\n".join([*head, head[-1]]), "are the same"), ("none.json", "\n".join(head), "expected"),
    ):  # fmt: skip
        csv.write_text(text)
        capsys.readouterr()
        assert main([asked[0], str(tmp_path / model_file), *asked[2:]]) == 2
        said = capsys.readouterr().err
        assert word in said and said.count("\n") == 1
    assert not (tmp_path / "F.fmu").exists()
