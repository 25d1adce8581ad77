"""The model file: what is saved is loaded, and whatever is not a sound model file is refused with its reason."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import typing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from stopset.artifact import Abstraction, Domain, Model, load_model, model_text, save_model
from stopset.artifact.polynomial import Polynomial
from stopset.artifact.store import _build
from stopset.effects.base import Fitted
from stopset.errors import ModelFileError
from stopset.sets import Box


def alike(a: object, b: object, where: str = "model") -> None:
    """Equal to the last bit, through dataclasses, arrays and containers."""
    if isinstance(a, Box):
        alike(a.lo, b.lo, where)  # type: ignore[attr-defined]
        alike(a.hi, b.hi, where)  # type: ignore[attr-defined]
    elif dataclasses.is_dataclass(a):
        for f in dataclasses.fields(a):
            alike(getattr(a, f.name), getattr(b, f.name), f"{where}.{f.name}")
    elif isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, b, err_msg=where)
    elif isinstance(a, dict):
        assert set(a) == set(b), where  # type: ignore[call-overload]
        for k in a:
            alike(a[k], b[k], f"{where}.{k}")  # type: ignore[index]
    elif isinstance(a, (tuple, list)):
        assert len(a) == len(b), where  # type: ignore[arg-type]
        for k, (x, y) in enumerate(zip(a, b, strict=True)):  # type: ignore[call-overload]
            alike(x, y, f"{where}[{k}]")
    elif isinstance(a, float) and np.isnan(a):
        assert np.isnan(b), where  # type: ignore[call-overload]
    else:
        assert a == b, where


def test_saved_and_loaded_to_the_last_bit(planar, tmp_path: Path) -> None:
    model: Model = planar[2].model
    saved = save_model(model, tmp_path / "m.json")
    loaded = load_model(tmp_path / "m.json")
    assert saved.sha256 == loaded.sha256 != ""
    for f in dataclasses.fields(Model):
        if f.name != "robot":
            a, b = getattr(saved, f.name), getattr(loaded, f.name)
            alike(json.loads(json.dumps(a)) if f.name in ("errors", "provenance") else a, b, f.name)
    np.testing.assert_array_equal(saved.robot.pi, loaded.robot.pi)
    np.testing.assert_array_equal(saved.robot.chain.R, loaded.robot.chain.R)
    assert saved.robot.joints == loaded.robot.joints
    assert model_text(loaded) == (tmp_path / "m.json").read_text()  # and once more the same file


@pytest.mark.parametrize("shape", [tuple[int, ...], typing.Any])
def test_numbers_stay_real_however_numpy_writes_its_types(shape: object) -> None:
    """Up to numpy 2.2 an array's type says `tuple[int, ...]` of its shape: every number of every model had been cut to a whole one."""
    real, whole = (np.ndarray[shape, np.dtype[kind]] for kind in (np.float64, np.int64))  # type: ignore[valid-type]
    assert _build(real, [0.5, 1.5], "x").tolist() == [0.5, 1.5]
    assert _build(whole, [1, 2], "x").dtype == np.int64
    assert (
        _build(NDArray[np.int64], [1, 2], "x").dtype == np.int64 and _build(NDArray[np.float64], [1, 2], "x").dtype == np.float64
    )


def test_everything_optional_survives(planar, tmp_path: Path) -> None:
    model: Model = planar[2].model
    cubic = Polynomial(np.array([[1, 0, 0, 0, 0, 0], [0, 2, 0, 0, 1, 0]]), np.array([1.5, -2.25e-7]))
    rich = dataclasses.replace(
        model,
        abstraction=Abstraction(2, 3, model.abstraction.Minv, np.hstack([model.abstraction.viscous] * 3), (cubic, cubic)),
        domain=Domain(
            model.domain.q, model.domain.dq, Box.of([-np.inf] * 2, [np.inf] * 2), Box.of([20.0] * 2, [40.0] * 2), (0.0, 3.0)
        ),
        effects=(Fitted("coulomb", "axis_1", {"F_c": 1.0}, {"F_c": 0.1}), Fitted("base_tilt", None, {"a": 0.1}, {})),
    )  # fmt: skip
    save_model(rich, tmp_path / "m.json")
    loaded = load_model(tmp_path / "m.json")
    alike(loaded.abstraction.coriolis, rich.abstraction.coriolis)
    alike(loaded.domain, rich.domain)
    alike(loaded.effects, rich.effects)


def test_it_is_plain_json_with_version_units_and_hash(planar, tmp_path: Path) -> None:
    save_model(planar[2].model, tmp_path / "m.json")
    body = json.loads((tmp_path / "m.json").read_text(), parse_constant=lambda c: pytest.fail(f"{c} is no JSON"))
    assert body["format"] == "stopset model"
    assert body["schema"] >= 1
    assert "rad" in body["units"]
    assert len(body["sha256"]) == 64
    assert body["provenance"]["data"]
    assert body["revisions"][0]["number"] == 0
    assert body["guarantee"]["text"]


def rewritten(path: Path, change: dict[str, object]) -> None:
    """Another body with a valid hash: what another version, not a disk, would make of it."""
    from stopset.artifact.store import _digest, _text

    body = json.loads(path.read_text()) | change
    body["sha256"] = _digest(body)
    path.write_text(_text(body))


@pytest.mark.parametrize(
    "change",
    [
        {"rotor": [1.0]},
        {"sets": {}},
        {"sets": []},
        {"abstraction": 7},
        {"surprise": 1},
        {"domain": {"q": [[1.0, 0.0]], "dq": [], "u": []}},
        {"robot": {"urdf": "<robot/>", "datasheet": {}, "pi": [], "gravity": [0, 0, 0]}},
        {"effects": [{"effect": "viscous"}]},
        {"brakes": {"torque": [[1.0, 2.0]], "delay": [[0.0, 1.0]], "rise": [[0.0, 1.0]]}},
        {"effects": [{"effect": "viscous", "joint": "elbow", "values": {}, "std": {}}]},
    ],
)
def test_contents_that_do_not_fit_are_refused(planar, tmp_path: Path, change: dict[str, object]) -> None:
    path = tmp_path / "m.json"
    save_model(planar[2].model, path)
    rewritten(path, change)
    with pytest.raises(ModelFileError, match=r"m\.json"):
        load_model(path)


def half_a_character(body: dict[str, Any]) -> None:
    body["notes"] = ["\ud800"]


def longer_limits(body: dict[str, Any]) -> None:
    body["robot"]["arm"]["dq_limit"] += [1.0]


def no_steps(body: dict[str, Any]) -> None:
    body["sets"]["powered"]["dt"] = -1.0


def endless_horizon(body: dict[str, Any]) -> None:
    body["sets"]["powered"]["horizon"] = math.inf


def no_number(body: dict[str, Any]) -> None:
    body["rotor"][0] = math.nan


def too_large(body: dict[str, Any]) -> None:
    body["rotor"][0] = 10**400


def no_friction_at_all(body: dict[str, Any]) -> None:
    body["abstraction"]["viscous"] = [[] for _ in body["abstraction"]["viscous"]]


def a_kind_that_is_none(body: dict[str, Any]) -> None:
    body["abstraction"]["kind"] = 2**63


def damping_that_takes_for_ever(body: dict[str, Any]) -> None:
    body["abstraction"]["viscous"] = [[x[0], 1e9] for x in body["abstraction"]["viscous"]]


def damping_that_no_whole_number_counts(body: dict[str, Any]) -> None:
    body["abstraction"]["viscous"] = [[x[0], 1e300] for x in body["abstraction"]["viscous"]]


def damping_at_any_speed(body: dict[str, Any]) -> None:
    body["abstraction"]["viscous"] = [[x[0], 1.0] for x in body["abstraction"]["viscous"]]
    body["domain"]["dq"][0] = ["-inf", "inf"]


def a_table_larger_than_memory(body: dict[str, Any]) -> None:
    s = body["sets"]["powered"]
    s["horizon"] = 90_000 * s["dt"]
    n, pieces = len(s["U"]), 200
    around = [0.5 * (lo + hi) for lo, hi in s["U"]]
    s["zonotope"] = {"centre": around, "generators": [[0.0] * pieces] * n, "directions": [[1.0] * n]}


def polynomials(body: dict[str, Any], exponent: list[int], value: float = 1.0) -> None:
    n = len(body["rotor"])
    body["abstraction"] |= {"kind": 2, "coriolis": [{"exponent": [exponent], "coefficient": [value]} for _ in range(n)]}


def a_polynomial_of_other_variables(body: dict[str, Any]) -> None:
    polynomials(body, [1] * 50)


def a_power_of_300(body: dict[str, Any]) -> None:
    polynomials(body, [300] + [0] * (3 * len(body["rotor"]) - 1))


def a_power_below_zero(body: dict[str, Any]) -> None:
    polynomials(body, [-1] + [0] * (3 * len(body["rotor"]) - 1))


def a_coefficient_that_is_none(body: dict[str, Any]) -> None:
    polynomials(body, [1] + [0] * (3 * len(body["rotor"]) - 1), math.inf)


def brakes_before_the_order(body: dict[str, Any]) -> None:
    n = len(body["rotor"])
    body["brakes"] = {"torque": [[1.0, 2.0]] * n, "delay": [[-1.0, 0.1]] * n, "rise": [[0.0, 0.1]] * n}


def brakes_that_take_for_ever(body: dict[str, Any]) -> None:
    n = len(body["rotor"])
    body["brakes"] = {"torque": [[1.0, 2.0]] * n, "delay": [[0.1, 1e308]] * n, "rise": [[0.0, 0.1]] * n, "apart": 1e-9}


def brakes_apart_by_less_than_nothing(body: dict[str, Any]) -> None:
    n = len(body["rotor"])
    body["brakes"] = {"torque": [[1.0, 2.0]] * n, "delay": [[0.0, 0.1]] * n, "rise": [[0.0, 0.1]] * n, "apart": -1}


def a_lag_that_is_none(body: dict[str, Any]) -> None:
    n = len(body["rotor"])
    body["brakes"] = {"torque": [[1.0, 2.0]] * n, "delay": [[0.0, 0.1]] * n, "rise": [[0.0, 0.1]] * n, "lag": [None] * n}


def gravity_without_a_direction(body: dict[str, Any]) -> None:
    body["robot"]["gravity"] = [-9.81]


def a_set_without_an_end(body: dict[str, Any]) -> None:
    body["sets"]["powered"]["V"][0][1] = 1e308


def any_speed(body: dict[str, Any]) -> None:
    body["domain"]["dq"][0][1] = "inf"


SPOILT = [
    half_a_character, longer_limits, no_steps, endless_horizon, no_number, too_large, no_friction_at_all, a_kind_that_is_none,
    damping_that_takes_for_ever, damping_that_no_whole_number_counts, damping_at_any_speed, a_table_larger_than_memory,
    a_polynomial_of_other_variables, a_power_of_300, a_power_below_zero, a_coefficient_that_is_none, brakes_before_the_order,
    brakes_that_take_for_ever, brakes_apart_by_less_than_nothing, a_lag_that_is_none, gravity_without_a_direction, a_set_without_an_end,
    any_speed,
]  # fmt: skip


@pytest.mark.parametrize("spoil", SPOILT)
def test_what_a_fuzzer_found_in_files_whose_hash_is_right(spoil: Any, planar, tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    save_model(planar[2].model, path)
    body = json.loads(path.read_text())
    spoil(body)
    content = {k: v for k, v in body.items() if k != "sha256"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    body["sha256"] = hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()
    path.write_text(json.dumps(body))
    with pytest.raises(ModelFileError, match=r"m\.json"):
        load_model(path)


def test_a_number_of_more_digits_than_python_takes_is_refused(tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text('{"format": "stopset model", "schema": 5, "rotor": [' + "9" * 5000 + "]}")
    with pytest.raises(ModelFileError, match=r"m\.json"):
        load_model(tmp_path / "m.json")


def test_nothing_in_it_is_executed(planar, tmp_path: Path) -> None:
    """Effects are looked up by name in a table; a name that looks like code stays a name."""
    path = tmp_path / "m.json"
    save_model(planar[2].model, path)
    rewritten(path, {"notes": ["__import__('os').remove('m.json')", "{0.__class__}"]})
    assert load_model(path).notes[0].startswith("__import__")
    assert path.exists()
