"""Effects of the catalogue that are hidden in the independent arm, by laws of its own.

`EFFECTS` have the labelled sets' laws.  `OTHER_LAWS` are the same causes by laws of another form, as a real drive may have them;
their names are the effect's, a ``~`` and the law's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from independent_arm import Array, about_origin, turned
from independent_hidden import Hidden, between, fault, of_friction, put, replaced
from independent_plant import FC_POS, FV
from independent_sets import Truth, jittered


def _asymmetric(t: Truth, j: int, x: float, u: Array) -> Truth:
    fc, side = float(t.T[j, FC_POS]), 1.0 if u[0] < 0.5 else -1.0
    return put(t, j, FC_POS=fc * (1 + side * x), FC_NEG=fc * (1 - side * x))


def _cubic(t: Truth, j: int, x: float, u: Array) -> Truth:
    fv, side = float(t.T[j, FV]), -1.0 if u[0] < 0.6 else 1.0
    return put(t, j, CUBIC=side * x * fv)


def _payload(t: Truth, j: int, x: float, u: Array) -> Truth:
    pi = t.arm.pi.copy()
    c = np.array([0.04 * (u[0] - 0.5), 0.06 * (u[1] - 0.5), 0.04 + 0.1 * u[2]])
    pi[-1] += about_origin(x, c, x * 0.02**2 * np.eye(3))
    return replace(t, arm=replace(t.arm, pi=pi))


def _rotor(t: Truth, j: int, x: float, u: Array) -> Truth:
    described = replace(t.described, rotor=replaced(t.described.rotor, j, t.arm.rotor[j] * (1 - x if u[0] < 0.7 else 1 + x)))
    return replace(t, described=described)


def _elastic(t: Truth, j: int, x: float, u: Array) -> Truth:
    return put(t, j, STIFF=1 / x, DAMP=(0.06 + 0.06 * u[0]) * (1 / x) ** 0.5)


def _gain(t: Truth, j: int, x: float, u: Array) -> Truth:
    return replace(t, gain=replaced(t.gain, j, 1 + x if u[0] < 0.5 else 1 - x))


def _delay(t: Truth, j: int, x: float, u: Array) -> Truth:
    return replace(t, delay=replaced(t.delay, j, x if u[0] < 0.7 else -x))


def _tilt(t: Truth, j: int, x: float, u: Array) -> Truth:
    return replace(t, arm=turned(t.arm, x * np.cos(2 * np.pi * u[0]), x * np.sin(2 * np.pi * u[0])))


def _coupling(t: Truth, j: int, x: float, u: Array) -> Truth:
    C = t.C.copy()
    C[j, j + 1] = C[j + 1, j] = x
    return replace(t, C=C)


EFFECTS: dict[str, Hidden] = {
    "thermal_viscous": Hidden(lambda t, j, x, u: put(t, j, BETA=x), *between(1e-4, 0.15)),
    "stribeck": Hidden(lambda t, j, x, u: put(t, j, STICK=x, V_S=0.03 + 0.07 * u[0]), *of_friction(0.01, 0.5), mask="slow"),
    "load_coulomb": Hidden(
        lambda t, j, x, u: put(t, j, MOTOR_LOAD=x, BRAKE_LOAD=x * (0.3 + 0.3 * u[0])), *between(1e-3, 0.8)),
    "asymmetric_coulomb": Hidden(_asymmetric, *between(2e-3, 0.4)),
    "cubic_viscous": Hidden(_cubic, *between(1e-3, 0.22)),
    "payload": Hidden(_payload, *between(1e-3, 8.0), fit="a", whole_arm=True),
    "rotor_inertia": Hidden(_rotor, *between(0.01, 0.9), fit="a"),
    "elasticity": Hidden(_elastic, lambda t, j: 1 / (1000 * t.arm.limit[j]), lambda t, j: 1 / (6 * t.arm.limit[j])),
    "torque_ripple": Hidden(
        lambda t, j, x, u: put(t, j, RIPPLE=x, RIPPLE_N=round(20 + 110 * u[0]), RIPPLE_PHASE=6.28 * u[1]), *of_friction(1e-3, 1.0)),
    "hysteresis": Hidden(
        lambda t, j, x, u: put(t, j, DAHL=float(t.T[j, FC_POS]) / x), *between(4e-4, 0.03), mask="slow"),
    "torque_gain": Hidden(_gain, *between(2e-3, 0.5), fit="a"),
    "delay": Hidden(_delay, *between(2e-3, 0.045)),
    "base_tilt": Hidden(_tilt, *between(1e-4, 0.3), whole_arm=True),
    "spring": Hidden(lambda t, j, x, u: put(t, j, SPRING=x, SPRING_Q0=1.2 * (u[0] - 0.5)), *of_friction(1e-3, 2.0)),
    "coupling": Hidden(_coupling, *of_friction(1e-3, 2.0), pair=True),
}  # fmt: skip


def _thin(t: Truth, j: int, x: float, u: Array) -> Truth:
    return put(t, j, THIN=x, THIN_V=0.1 + 0.3 * u[0])


def _lugre(t: Truth, j: int, x: float, u: Array) -> Truth:
    fc = float(t.T[j, FC_POS])
    return put(t, j, DAHL=fc / x, LUGRE=(0.5 + u[0]) * float(t.T[j, FV]))


def _bouc(t: Truth, j: int, x: float, u: Array) -> Truth:
    return put(t, j, DAHL=float(t.T[j, FC_POS]) / x, BOUC=1.5 + u[0])


def _hardening(t: Truth, j: int, x: float, u: Array) -> Truth:
    soft = _elastic(t, j, x, u)
    bend = t.arm.limit[j] * 0.3 * x  # the bend at a third of the torque limit, where the stiffness has doubled
    return put(soft, j, STIFFEN=1 / max(bend, 1e-4) ** 2)


def _payload_on_wrong(t: Truth, j: int, x: float, u: Array) -> Truth:
    """The description is wrong besides, the same way for every size."""
    described = jittered(t.arm, np.random.default_rng([t.seed, 7]), 0.0, 0.0, 0.04, wrong=True)
    return replace(_payload(t, j, x, u), described=described)


OTHER_LAWS: dict[str, Hidden] = {
    "cubic_viscous~asinh": Hidden(_thin, *between(0.02, 1.0)),
    "stribeck~exp": Hidden(
        lambda t, j, x, u: put(t, j, STICK=x, V_S=0.03 + 0.07 * u[0], STICK_P=1.0), *of_friction(0.01, 0.8), mask="slow"),
    "stribeck~root": Hidden(
        lambda t, j, x, u: put(t, j, STICK=x, V_S=0.02 + 0.04 * u[0], STICK_P=0.6), *of_friction(0.01, 1.0), mask="slow"),
    "hysteresis~lugre": Hidden(_lugre, *between(4e-4, 0.03), mask="slow"),
    "hysteresis~bouc_wen": Hidden(_bouc, *between(3e-3, 0.06), mask="slow"),
    "elasticity~hardening": Hidden(_hardening, lambda t, j: 1 / (1000 * t.arm.limit[j]), lambda t, j: 1 / (4 * t.arm.limit[j])),
    "thermal_viscous~slow_sensor": Hidden(
        lambda t, j, x, u: fault(put(t, j, BETA=x), "slow_sensor", j, 0.5), *between(1e-4, 0.15)),
    "delay~lag": Hidden(lambda t, j, x, u: fault(t, "lag", j, x), *between(2e-3, 0.06)),
    "torque_gain~saturation": Hidden(lambda t, j, x, u: fault(t, "saturation", j, x), *between(1e-2, 0.9), fit="a"),
    "spring~hardening": Hidden(
        lambda t, j, x, u: put(t, j, SPRING=x, SPRING_Q0=1.2 * (u[0] - 0.5), HARDEN=0.15), *of_friction(1e-3, 2.0)),
    "payload~wrong": Hidden(_payload_on_wrong, *between(1e-3, 8.0), fit="a", whole_arm=True),
}  # fmt: skip
