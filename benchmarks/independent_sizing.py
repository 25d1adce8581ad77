"""How large something is hidden in the independent arm: a base model's residual is raised threefold (easy) or by 1.4 (hard).

The base model is a rigid body with rotor, Coulomb and viscous friction, fitted to the closed-loop trials after a zero-phase
low-pass at 10 Hz; with its link parameters free (fit b), or fixed as described (fit a) for shifted masses, rotors and gains
that a free fit would take up.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from independent_arm import Array, regressor
from independent_hidden import Hidden, replaced
from independent_plant import BUMP, BUMP_AT, BUMP_WIDTH, DT
from independent_sets import Columns, Truth, closed_loop
from scipy.ndimage import minimum_filter1d
from scipy.signal import butter, filtfilt

RATIO = {"easy": float(np.sqrt(10)), "hard": float(np.sqrt(2))}
SLOW = 0.15  # [rad/s] Stribeck's curve and hysteresis are sized on rows slower than this
NEAR = 10  # samples about a reversal that are left out
TRIES = 6


def residual(truth: Truth, fit: str, mask: str, joint: int, trials: list[tuple[int, int, Columns]] | None = None) -> Array:
    """(n,) residual RMS [N m] of the base model on the closed-loop trials; infinite where the arm can't be controlled."""
    b, a = butter(4, 10.0 / (0.5 / DT))
    described, parts = truth.described, []
    for _, _, c in trials or closed_loop(truth):
        q, tau = (filtfilt(b, a, c[k], axis=0) for k in ("q", "tau"))
        dq = np.gradient(q, DT, axis=0)
        inside = slice(25, -25, 5)
        clear = minimum_filter1d(np.abs(dq), 2 * NEAR + 1, axis=0)  # the low-pass smears a reversal over its neighbours
        parts.append([x[inside] for x in (q, dq, np.gradient(dq, DT, axis=0), tau, clear)])
    q, dq, ddq, tau, clear = (np.concatenate([p[k] for p in parts]) for k in range(5))
    if not all(np.isfinite(x).all() for x in (q, dq, ddq, tau)):
        return np.full(described.n, np.inf)  # so large that the controller lost the arm
    Y = np.asarray(regressor(described.R0, described.p, described.axis, described.gravity, q, dq, ddq))
    n = described.n
    moving = [clear[:, j] > 0.02 for j in range(n)]
    y = tau - np.einsum("knp,p->kn", Y, described.pi.ravel()) - described.rotor * ddq
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


def hide(truth: Truth, kind: Hidden, joint: int, level: str, u: Array) -> tuple[Truth, float, float]:
    """The truth with the effect at ``joint`` so large that the residual rises as ``level`` says; size, ratio reached.

    The residual's added variance goes with the square of the size, which a secant in the logarithm follows; a size at its
    limit stays there with the ratio it reaches.
    """
    lo, hi = kind.lo(truth, joint), kind.hi(truth, joint)
    x = float(np.sqrt(lo * hi))
    shaped = kind.apply(truth, joint, x, u)  # the window of a bump is where the bump is
    floor = residual(replace(shaped, T=replaced(shaped.T, joint, _without_bump(shaped.T[joint]))), kind.fit, kind.mask, joint) \
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
