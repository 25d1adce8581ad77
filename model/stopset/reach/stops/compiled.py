"""Whole stops by the core alone, as a loop asks for them and as an FMU computes them.

Python's own way to the same numbers, with more pieces and finer steps, is `stopset.reach.stops.bounds`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stopset.core.library import check, ffi, given, lib, view
from stopset.reach.stops.friction import torques_struct
from stopset.reach.stops.ramp import Ramp, drive_limit, gear_limit, of_the_arm
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import Plant, Tube, plant_struct
from stopset.reach.stops.types import Category
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Stopped:
    """A stop: ``time`` [s], ``forward``, ``back`` [rad], ``speed`` [rad/s], (n,) each; ``tool``: displacement [m], speed [m/s]."""

    time: Array
    forward: Array
    back: Array
    speed: Array
    tool: Array


@dataclass(frozen=True, slots=True)
class CompiledStops:
    """The core's bounds of whole stops, by category, of measured states in a box: those of `StopBounds.bound` with ``fast``. No
    domain is looked at."""

    setting: Setting
    ramp: Ramp | None
    struct: Any  # StopsetStops
    braking: Any  # StopsetRamp, or null
    _held: Any
    _work: Array

    @classmethod
    def of(cls, setting: Setting, ramp: Ramp | None = None) -> CompiledStops:
        """``ramp``: for categories 1 and 2."""
        s, n = setting, setting.model.n
        torques, effects = (ffi.NULL, None) if s.torques.settled else torques_struct(s.torques, s.free)
        plant, tool = plant_struct(s.plant), given(s.payload_com)
        lag = ffi.NULL if s.lag is None else view(given(s.lag))
        delay_spread = -1.0 if s.delay_spread is None else s.delay_spread
        struct = ffi.new("StopsetStops *", (plant[0][0], lag, delay_spread, view(tool), torques, s.payloads))
        braking, held = (ffi.NULL, None) if ramp is None else _ramp_struct(s, ramp)
        return cls(s, ramp, struct, braking, (plant, torques, effects, lag, tool, held), np.empty(lib.stopset_stop_room(n)))

    def bound(
        self, q: Array, dq: Array, category: Category = "0", q_radius: Array | None = None, dq_radius: Array | None = None
    ) -> Stopped | None:
        """The stop from all measured states in ``q +- q_radius, dq +- dq_radius``, (n,) each [rad, rad/s]; None: not provable."""
        n = self.setting.model.n
        start = self.setting.start if category == "0" else self.setting.truth
        more_q, more_dq = (np.zeros(n) if r is None else r for r in (q_radius, dq_radius))
        box = q + start.centre[:n], dq + start.centre[n:], start.radius[:n] + more_q, start.radius[n:] + more_dq
        if any(x.shape != (n,) for x in box):
            raise ValueError(f"a box of {[x.shape for x in box]} for {n} joints")
        out = [np.empty(k) for k in (n, n, n, n, 2)]
        held = [given(x) for x in box]
        states = ffi.new("StopsetStates *", tuple(view(x) for x in held))
        tail = states, view(self._work), ffi.new("StopsetBound *", tuple(view(x) for x in out))
        if category == "0":
            code = lib.stopset_power_off(self.struct, *tail)
        elif self.ramp is None:
            return None
        elif category == "1 guaranteed":
            code = lib.stopset_failed_ramp(self.struct, self.braking, *tail)
        else:
            code = lib.stopset_working_ramp(self.struct, self.braking, int(category == "2"), *tail)
        check(-min(code, 0))
        return None if code else Stopped(*out)


def ramp_fields(setting: Setting, ramp: Ramp) -> tuple[dict[str, Array], dict[str, Any]]:
    """A ramp by the names of the C struct: arrays (n,) and numbers."""
    ramp = of_the_arm(ramp, setting.shares)
    arrays = {
        "value_lo": ramp.value.lo, "value_hi": ramp.value.hi, "control_lo": ramp.control.lo, "control_hi": ramp.control.hi,
        "q_error": ramp.q_error, "dq_error": ramp.dq_error, "band": ramp.band, "limit": drive_limit(setting.model),
        "gear": gear_limit(setting.model, setting.torques.gear),
        "residual_lo": setting.residual.lo, "residual_hi": setting.residual.hi,
    }  # fmt: skip
    numbers: dict[str, Any] = {
        "timed": int(ramp.kind == "time"), "off_after": -1.0 if ramp.off_after is None else ramp.off_after,
        "monitored": int(ramp.monitored), "reaction": ramp.reaction, "tolerance": ramp.tolerance, "share": ramp.share,
        "window": ramp.window, "pace": list(ramp.pace), "settle": -1.0 if ramp.settle is None else ramp.settle,
    }  # fmt: skip
    return arrays, numbers


def _ramp_struct(setting: Setting, ramp: Ramp) -> tuple[Any, Any]:
    """``StopsetRamp``, and what must live as long."""
    arrays, numbers = ramp_fields(setting, ramp)
    held = {k: given(x) for k, x in arrays.items()}
    return ffi.new("StopsetRamp *", {k: view(x) for k, x in held.items()} | numbers), held


def ramp_torque(setting: Setting, plant: Plant, ramp: Ramp, start: Start, tube: Tube, have: Array) -> Array:
    """(n,) [N m] the largest torque of links and rotors that a ramp that works asks of each drive, from any state of ``start``: of all
    payloads, rotors, delays and values that are known as ranges; looked at closely where it is more than drives ``have`` (n,) [N m].
    ``tube``: the ramp's own from there."""
    braking, _stored = _ramp_struct(setting, ramp)
    struct, _held = plant_struct(plant)
    states = [given(x) for x in (start.q, start.dq, start.q_radius, start.dq_radius, have)]
    lines = {k: given(getattr(tube, k)) for k in ("t", "d_lo", "d_hi", "v_lo", "v_hi", "e_lo", "e_hi")}
    out, n = np.empty(len(plant.rotor)), len(plant.rotor)
    if any(x.shape != (n,) for x in states) or lines["d_lo"].shape != (len(tube.t), n):
        raise ValueError(f"a ramp of {lines['d_lo'].shape} from states {[x.shape for x in states]} for {n} joints")
    box = ffi.new("StopsetStates *", tuple(view(x) for x in states[:4]))
    its_tube = ffi.new("StopsetTube *", {k: view(x) for k, x in lines.items()})
    check(lib.stopset_ramp_torque(struct, braking, box, its_tube, len(tube.t) - 1, view(states[4]), view(out)))
    return out
