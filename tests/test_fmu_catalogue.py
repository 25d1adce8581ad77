"""Every effect, of the catalogue and from outside: in the unit, or refused with a sentence that names it."""

from __future__ import annotations

import io
import zipfile

import pytest

from stopset.artifact import Model
from stopset.effects import Fitted, catalogue
from stopset.errors import EffectError, NotCovered
from stopset.fmu import Contents, archive
from stopset.fmu.stops import stop_refusal
from test_fmu_stops import braked

pytest.importorskip("fmpy")
SOURCES = Contents(3, source_only=True, reference=False)


def fitted(name: str) -> Fitted:
    """At the second joint, or where its scope says, with small numbers in their ranges."""
    e = catalogue()[name]
    values = {p.symbol: min(max(0.1, p.lo), p.hi) for p in e.terms} | {p.symbol: p.grid[len(p.grid) // 2] for p in e.shapes}
    return Fitted(name, None if e.scope == "arm" else "axis_2", values, {})


def described(model: Model) -> str:
    with zipfile.ZipFile(io.BytesIO(archive(model, SOURCES))) as z:
        return z.read("modelDescription.xml").decode()


def test_every_effect_is_exported_with_its_numbers_and_bounds_stops_or_says_why_not(own_effect: object) -> None:
    """Alone on an arm with brakes; none is refused, and whose stop is not bounded is named."""
    refused = {}
    for name in sorted(catalogue()):
        model = braked(8.0, 3, effort="motor_torque", effects=[fitted(name)])
        try:
            text = described(model)
        except (EffectError, NotCovered) as e:
            refused[name] = str(e)
            continue
        compensated = catalogue()[name].compensated()  # all others are in the inertia, the damping, the gain or U
        assert not compensated or f'name="{name}_' in text, name
        if why := stop_refusal(model):
            assert name in why, why
    assert "relaxing_hose" in catalogue() and refused == {}
