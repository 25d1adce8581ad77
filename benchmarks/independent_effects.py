"""What is hidden in the independent arm, and how large: a base model's residual is raised threefold (easy) or by 1.4 (hard).

The base model is a rigid body with rotor, Coulomb and viscous friction, fitted to the closed-loop trials after a zero-phase
low-pass at 10 Hz; with its link parameters free (fit b), or fixed as described (fit a) for shifted masses, rotors and gains
that a free fit would take up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import independent_plant as plant
import numpy as np
from independent_arm import Array, about_origin, regressor, turned
from independent_plant import BUMP, BUMP_AT, BUMP_WIDTH, DT, FC_POS, FV
from independent_sets import Columns, Truth, closed_loop
from scipy.ndimage import minimum_filter1d
from scipy.signal import butter, filtfilt

RATIO = {"easy": float(np.sqrt(10)), "hard": float(np.sqrt(2))}
SLOW = 0.15  # [rad/s] Stribeck's curve and hysteresis are sized on rows slower than this
NEAR = 10  # samples about a reversal that are left out
TRIES = 6


def _set(truth: Truth, j: int, **values: float) -> Truth:
    T = truth.T.copy()
    for name, value in values.items():
        T[j, getattr(plant, name)] = value
    return replace(truth, T=T)


def _put(x: Array, j: int, value: float) -> Array:
    out = x.copy()
    out[j] = value
    return out


@dataclass(frozen=True)
class Hidden:
    """``apply(truth, joint, x, u)``: the truth with the effect of size ``x`` at a joint; ``u`` (4,) fixed draws in 0..1."""

    apply: Callable[[Truth, int, float, Array], Truth]
    lo: Callable[[Truth, int], float]
    hi: Callable[[Truth, int], float]
    mask: str = "all"
    fit: str = "b"
    whole_arm: bool = False
    pair: bool = False  # acts at joints j and j + 1


def _fixed(lo: float, hi: float) -> tuple[Callable[[Truth, int], float], Callable[[Truth, int], float]]:
    return (lambda t, j: lo), (lambda t, j: hi)


def _share(lo: float, hi: float) -> tuple[Callable[[Truth, int], float], Callable[[Truth, int], float]]:
    """Limits as shares of the joint's Coulomb friction."""
    return (lambda t, j: lo * float(t.T[j, FC_POS])), (lambda t, j: hi * float(t.T[j, FC_POS]))


def _asymmetric(t: Truth, j: int, x: float, u: Array) -> Truth:
    fc, way = float(t.T[j, FC_POS]), 1.0 if u[0] < 0.5 else -1.0
    return _set(t, j, FC_POS=fc * (1 + way * x), FC_NEG=fc * (1 - way * x))


def _cubic(t: Truth, j: int, x: float, u: Array) -> Truth:
    fv, way = float(t.T[j, FV]), -1.0 if u[0] < 0.6 else 1.0
    return _set(t, j, CUBIC=way * x * fv)


def _payload(t: Truth, j: int, x: float, u: Array) -> Truth:
    pi = t.arm.pi.copy()
    c = np.array([0.04 * (u[0] - 0.5), 0.06 * (u[1] - 0.5), 0.04 + 0.1 * u[2]])
    pi[-1] += about_origin(x, c, x * 0.02**2 * np.eye(3))
    return replace(t, arm=replace(t.arm, pi=pi))


def _rotor(t: Truth, j: int, x: float, u: Array) -> Truth:
    told = replace(t.told, rotor=_put(t.told.rotor, j, t.arm.rotor[j] * (1 - x if u[0] < 0.7 else 1 + x)))
    return replace(t, told=told)


def _elastic(t: Truth, j: int, x: float, u: Array) -> Truth:
    return _set(t, j, STIFF=1 / x, DAMP=(0.06 + 0.06 * u[0]) * (1 / x) ** 0.5)


def _gain(t: Truth, j: int, x: float, u: Array) -> Truth:
    return replace(t, gain=_put(t.gain, j, 1 + x if u[0] < 0.5 else 1 - x))


def _delay(t: Truth, j: int, x: float, u: Array) -> Truth:
    return replace(t, delay=_put(t.delay, j, x if u[0] < 0.7 else -x))


def _tilt(t: Truth, j: int, x: float, u: Array) -> Truth:
    return replace(t, arm=turned(t.arm, x * np.cos(2 * np.pi * u[0]), x * np.sin(2 * np.pi * u[0])))


def _coupling(t: Truth, j: int, x: float, u: Array) -> Truth:
    C = t.C.copy()
    C[j, j + 1] = C[j + 1, j] = x
    return replace(t, C=C)


def _other(t: Truth, j: int, u: float) -> int:
    others = [k for k in range(t.arm.n) if k != j]
    return others[int(u * len(others))]


EFFECTS: dict[str, Hidden] = {
    "thermal_viscous": Hidden(lambda t, j, x, u: _set(t, j, BETA=x), *_fixed(1e-4, 0.15)),
    "stribeck": Hidden(lambda t, j, x, u: _set(t, j, STICK=x, V_S=0.03 + 0.07 * u[0]), *_share(0.01, 0.5), mask="slow"),
    "load_coulomb": Hidden(
        lambda t, j, x, u: _set(t, j, MOTOR_LOAD=x, BRAKE_LOAD=x * (0.3 + 0.3 * u[0])), *_fixed(1e-3, 0.8)),
    "asymmetric_coulomb": Hidden(_asymmetric, *_fixed(2e-3, 0.4)),
    "cubic_viscous": Hidden(_cubic, *_fixed(1e-3, 0.22)),
    "payload": Hidden(_payload, *_fixed(1e-3, 8.0), fit="a", whole_arm=True),
    "rotor_inertia": Hidden(_rotor, *_fixed(0.01, 0.9), fit="a"),
    "elasticity": Hidden(_elastic, lambda t, j: 1 / (1000 * t.arm.limit[j]), lambda t, j: 1 / (6 * t.arm.limit[j])),
    "torque_ripple": Hidden(
        lambda t, j, x, u: _set(t, j, RIPPLE=x, RIPPLE_N=round(20 + 110 * u[0]), RIPPLE_PHASE=6.28 * u[1]), *_share(1e-3, 1.0)),
    "hysteresis": Hidden(
        lambda t, j, x, u: _set(t, j, DAHL=float(t.T[j, FC_POS]) / x), *_fixed(4e-4, 0.03), mask="slow"),
    "torque_gain": Hidden(_gain, *_fixed(2e-3, 0.5), fit="a"),
    "delay": Hidden(_delay, *_fixed(2e-3, 0.045)),
    "base_tilt": Hidden(_tilt, *_fixed(1e-4, 0.3), whole_arm=True),
    "spring": Hidden(lambda t, j, x, u: _set(t, j, SPRING=x, SPRING_Q0=1.2 * (u[0] - 0.5)), *_share(1e-3, 2.0)),
    "coupling": Hidden(_coupling, *_share(1e-3, 2.0), pair=True),
}  # fmt: skip
OUTSIDE: dict[str, Hidden] = {
    "bump": Hidden(
        lambda t, j, x, u: _set(t, j, BUMP=x, BUMP_AT=(u[0] - 0.5) * t.reach[j], BUMP_WIDTH=0.08 + 0.12 * u[1]), *_share(1e-3, 2.0),
        mask="window"),
    "walk": Hidden(lambda t, j, x, u: replace(t, walk=_put(t.walk, j, np.array([x, 3 + 15 * u[0]]))), *_share(1e-3, 2.0)),  # type: ignore[arg-type]
    "resonance": Hidden(
        lambda t, j, x, u: _set(t, j, RESONANCE=x, RES_AT=0.25 + 0.4 * u[0], RES_WIDTH=0.05 + 0.07 * u[1]), *_share(1e-3, 2.0)),
    "cross_friction": Hidden(lambda t, j, x, u: _set(t, j, CROSS=x, CROSS_JOINT=_other(t, j, u[0])), *_share(1e-3, 2.0)),
    "weave": Hidden(
        lambda t, j, x, u: _set(t, j, WEAVE=x, WEAVE_N=3.0, WEAVE_JOINT=_other(t, j, u[0])), *_share(1e-3, 3.0)),
    "uneven": Hidden(lambda t, j, x, u: _set(t, j, UNEVEN=x, UNEVEN_Q0=0.6 * (u[0] - 0.5)), *_share(1e-3, 1.0)),
}  # fmt: skip


def residual(truth: Truth, fit: str, mask: str, joint: int, trials: list[tuple[int, int, Columns]] | None = None) -> Array:
    """(n,) residual RMS [N m] of the base model on the closed-loop trials; infinite where the arm can't be controlled."""
    b, a = butter(4, 10.0 / (0.5 / DT))
    told, parts = truth.told, []
    for _, _, c in trials or closed_loop(truth):
        q, tau = (filtfilt(b, a, c[k], axis=0) for k in ("q", "tau"))
        dq = np.gradient(q, DT, axis=0)
        inside = slice(25, -25, 5)
        clear = minimum_filter1d(np.abs(dq), 2 * NEAR + 1, axis=0)  # the low-pass smears a reversal over its neighbours
        parts.append([x[inside] for x in (q, dq, np.gradient(dq, DT, axis=0), tau, clear)])
    q, dq, ddq, tau, clear = (np.concatenate([p[k] for p in parts]) for k in range(5))
    if not all(np.isfinite(x).all() for x in (q, dq, ddq, tau)):
        return np.full(told.n, np.inf)  # so large that the controller lost the arm
    Y = np.asarray(regressor(told.R0, told.p, told.axis, told.gravity, q, dq, ddq))
    n = told.n
    moving = [clear[:, j] > 0.02 for j in range(n)]
    y = tau - np.einsum("knp,p->kn", Y, told.pi.ravel()) - told.rotor * ddq
    own = [np.stack([np.sign(dq[:, j]), dq[:, j], *([ddq[:, j]] if fit == "b" else [])], axis=1) for j in range(n)]
    wide, k = 10 * n if fit == "b" else 0, own[0].shape[1]
    A, target, joints = [], [], []
    for j in range(n):
        rows = np.zeros((int(moving[j].sum()), wide + n * k))
        if fit == "b":
            rows[:, :wide] = Y[moving[j], j]
        rows[:, wide + j * k : wide + (j + 1) * k] = own[j][moving[j]]
        A.append(rows / truth.noise[j])
        target.append(y[moving[j], j] / truth.noise[j])
        joints.append(np.full(len(rows), j))
    stack, rhs, of = np.concatenate(A), np.concatenate(target), np.concatenate(joints)
    scale = np.maximum(np.sqrt((stack**2).mean(axis=0)), 1e-9)
    G = (stack / scale).T @ (stack / scale) + 1e-6 * len(rhs) * np.eye(len(scale)) * 1e-3
    e = rhs - (stack / scale) @ np.linalg.solve(G, (stack / scale).T @ rhs)
    out = np.empty(n)
    for j in range(n):
        keep = np.ones(int(moving[j].sum()), bool)
        if j == joint and mask == "slow":
            keep = np.abs(dq[moving[j], j]) < SLOW
        if j == joint and mask == "window":
            keep = np.abs(q[moving[j], j] - truth.T[j, BUMP_AT]) < 2 * truth.T[j, BUMP_WIDTH]
        out[j] = truth.noise[j] * np.sqrt(np.mean(e[of == j][keep] ** 2))
    return out


def hide(truth: Truth, name: str, joint: int, level: str, u: Array) -> tuple[Truth, float, float]:
    """The truth with the effect at ``joint`` so large that the residual rises as ``level`` says; size, ratio reached.

    The residual's added variance goes with the square of the size, which a secant in the logarithm follows; a size at its
    limit stays there with the ratio it reaches.
    """
    kind = (EFFECTS | OUTSIDE)[name]
    lo, hi = kind.lo(truth, joint), kind.hi(truth, joint)
    x = float(np.sqrt(lo * hi))
    shaped = kind.apply(truth, joint, x, u)  # the window of a bump is where the bump is
    floor = residual(replace(shaped, T=_put(shaped.T, joint, _without_bump(shaped.T[joint]))), kind.fit, kind.mask, joint) \
        if kind.mask == "window" else residual(truth, kind.fit, kind.mask, joint)  # fmt: skip
    target = float(np.sqrt(RATIO[level] ** 2 - 1))
    where = list(range(truth.arm.n)) if kind.whole_arm else [joint, joint + 1] if kind.pair else [joint]
    tried: list[tuple[float, float, float, Truth]] = []
    for _ in range(TRIES):
        made = kind.apply(truth, joint, x, u)
        ratio = float((residual(made, kind.fit, kind.mask, joint) / floor)[where].max())
        added = float(np.sqrt(max(ratio**2 - 1, 1e-3)))
        tried.append((x, added, ratio, made))
        if abs(ratio / RATIO[level] - 1) < 0.04:
            break
        low = max((t[0] for t in tried if t[1] < target), default=lo)
        high = min((t[0] for t in tried if t[1] > target), default=hi)
        guess = x * (target / added if added > 0.1 else 3.0)
        new = float(np.clip(guess, low * 1.02, high / 1.02)) if low * 1.04 < high else x
        if low < high and not low < guess < high:
            new = float(np.sqrt(low * high))
        if abs(np.log(new / x)) < 0.01:
            break
        x = new
    x, _, ratio, made = min(tried, key=lambda t: abs(np.log(max(t[2], 1e-3) / RATIO[level])))
    if not np.isfinite(ratio):
        return truth, 0.0, 0.0  # a light link on a stiff gear swings faster than the simulation's steps
    return made, x, ratio


def _without_bump(row: Array) -> Array:
    out = row.copy()
    out[BUMP] = 0.0
    return out
