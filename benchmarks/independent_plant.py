"""Plant of the independent arm: motor and link apart where a gear is elastic, friction and disturbances by joint.

Linearly implicit in the friction's slope, so that a Coulomb step 3 mrad/s wide is stable at 1 ms.
"""

from __future__ import annotations

import numpy as np
from independent_arm import frames, mass_matrix, newton_euler
from numba import njit

SUBSTEPS = 4  # of 1 ms in a sample of 4 ms
DT = 0.004  # [s] a sample
STICTION = 0.003  # [rad/s] width of the Coulomb law's step
T_REF = 30.0  # [degC]

# columns of the friction table, one row per joint
FC_POS, FC_NEG, FV, CUBIC, STICK, V_S, BETA, MOTOR_LOAD, BRAKE_LOAD, DAHL, RIPPLE, RIPPLE_N, RIPPLE_PHASE = range(13)
SPRING, SPRING_Q0, STIFF, DAMP, BUMP, BUMP_AT, BUMP_WIDTH, RESONANCE, RES_AT, RES_WIDTH = range(13, 23)
CROSS, CROSS_JOINT, WEAVE, WEAVE_JOINT, WEAVE_N, UNEVEN, UNEVEN_Q0 = range(23, 30)
THIN, THIN_V, STICK_P, LUGRE, BOUC, STIFFEN, HARDEN, ROUGH, ROUGH_N, CHATTER, CHATTER_HZ, SNAG, SNAG_Q0 = range(30, 43)
LOAD_2, GAS, GAS_Q0, GAS_R, OFFSET, PLAY, ROCKS, ROCKS_ABOUT, COLUMNS = range(43, 52)


@njit(cache=True)
def solve(M, x):  # type: ignore[no-untyped-def]
    """``x`` becomes M^-1 x; ``M`` becomes its Cholesky factor."""
    n = len(x)
    for i in range(n):
        for j in range(i + 1):
            s = M[i, j]
            for m in range(j):
                s -= M[i, m] * M[j, m]
            M[i, j] = np.sqrt(s) if i == j else s / M[j, j]
    for i in range(n):
        for m in range(i):
            x[i] -= M[i, m] * x[m]
        x[i] /= M[i, i]
    for i in range(n - 1, -1, -1):
        for m in range(i + 1, n):
            x[i] -= M[m, i] * x[m]
        x[i] /= M[i, i]


@njit(cache=True)
def friction(row, v, q, dT, load, sc, sv, F):  # type: ignore[no-untyped-def]
    """Torque against motion of one joint and its slope in v; ``F``: Dahl's state."""
    s = np.tanh(v / STICTION)
    fc = row[FC_POS] if v > 0 else row[FC_NEG]
    fc += row[STICK] * np.exp(-((abs(v) / row[V_S]) ** (2.0 if row[STICK_P] == 0 else row[STICK_P])))
    fc += (row[MOTOR_LOAD] if v * load > 0 else row[BRAKE_LOAD]) * abs(load)
    fc += row[LOAD_2] * load * load
    fc += row[RESONANCE] * np.exp(-(((abs(v) - row[RES_AT]) / row[RES_WIDTH]) ** 2))
    fc += row[UNEVEN] * np.tanh((q - row[UNEVEN_Q0]) / 0.05) + row[ROUGH] * np.sin(row[ROUGH_N] * q)
    fv = row[FV] * np.exp(-row[BETA] * dT) * sv
    out = fv * v + row[CUBIC] * v**3
    slope = fv + 3 * row[CUBIC] * v**2
    if row[THIN] > 0:  # a share of the viscous torque thins: linear when slow, logarithmic when fast
        out += row[THIN] * fv * (row[THIN_V] * np.arcsinh(v / row[THIN_V]) - v)
        slope -= row[THIN] * fv * (1 - 1 / np.sqrt(1 + (v / row[THIN_V]) ** 2))
    if row[DAHL] > 0:
        out += sc * F
        if row[LUGRE] > 0:  # bristles that are damped while they bend
            damped = row[LUGRE] * (1 - F * s / row[FC_POS])
            out += sc * damped * v
            slope += sc * damped
    else:
        out += sc * fc * s
        slope += sc * fc * (1 - s * s) / STICTION
    return out, max(slope, 0.0)


@njit(cache=True)
def position_torque(row, q):  # type: ignore[no-untyped-def]
    """Torque of springs, ripple and bumps that the motor has to overcome."""
    d = q - row[SPRING_Q0]
    out = row[RIPPLE] * np.sin(row[RIPPLE_N] * q + row[RIPPLE_PHASE]) + row[SPRING] * d * (1 + row[HARDEN] * d * d)
    out += row[SNAG] * max(0.0, q - row[SNAG_Q0])
    turn = q - row[GAS_Q0]  # a gas spring's force is all but the same at any length, the longer lever is 1
    out += row[GAS] * np.sin(turn) / np.sqrt(1 + row[GAS_R] ** 2 + 2 * row[GAS_R] * np.cos(turn))
    return out + row[BUMP] * np.exp(-0.5 * ((q - row[BUMP_AT]) / row[BUMP_WIDTH]) ** 2)


@njit(cache=True)
def _others(T, C, th, dth, t):  # type: ignore[no-untyped-def]
    """(n,) torques by other joints' motion (coupling, friction that another joint's speed changes, a product), by time: chatter."""
    out = C @ dth
    for i in range(len(th)):
        if T[i, CROSS] != 0:
            out[i] += T[i, CROSS] * np.tanh(dth[i] / STICTION) * abs(dth[int(T[i, CROSS_JOINT])])
        if T[i, WEAVE] != 0:
            out[i] += T[i, WEAVE] * np.sin(T[i, WEAVE_N] * th[i]) * dth[int(T[i, WEAVE_JOINT])]
        if T[i, CHATTER] != 0:
            out[i] += T[i, CHATTER] * np.sin(2 * np.pi * T[i, CHATTER_HZ] * t) * np.exp(-((dth[i] / 0.2) ** 2))
    return out


@njit(cache=True)
def simulate(R0, p, axis, pi, rotor, gravity, T, C, sc, sv, temp, extra, ff, qd, dqd, kp, kd, q0, dq0):  # type: ignore[no-untyped-def]
    """One trial of N samples: encoder positions (N, n), speeds and motor torques.

    ``T`` (n, COLUMNS), ``C`` (n, n) coupling; ``sc, sv`` (n,) this trial's friction scales; ``temp`` (N, n); ``extra`` (N, n)
    torque from outside; ``ff`` (N, n) torque given, to which ``kp, kd`` (n,) add feedback about ``qd, dqd``.
    """
    N, n = ff.shape
    h = DT / SUBSTEPS
    th, dth = q0.copy(), dq0.copy()
    q, dq = q0.copy(), dq0.copy()
    F = np.where(np.abs(dq0) > 0.05, np.sign(dq0) * T[:, FC_POS], 0.0)  # a trial cut out of a motion starts with its friction
    Q, V, U = np.empty((N, n)), np.empty((N, n)), np.empty((N, n))
    zero, bias, load, B = np.zeros(n), np.empty(n), np.zeros(n), np.empty((n, 10))
    elastic = T[:, STIFF] > 0
    loaded = np.any(T[:, MOTOR_LOAD] != 0) or np.any(T[:, BRAKE_LOAD] != 0) or np.any(elastic)
    R, W, M = np.empty_like(R0), np.empty((10 + 2 * n, 3)), np.empty((n, n))
    for k in range(N):
        for s in range(SUBSTEPS):
            w = s / SUBSTEPS
            m = min(k + 1, N - 1)
            tau = (1 - w) * ff[k] + w * ff[m]
            tau += kp * ((1 - w) * qd[k] + w * qd[m] - th) + kd * ((1 - w) * dqd[k] + w * dqd[m] - dth)
            frames(R0, axis, q, R)
            if (k == 0 and s == 0) or loaded:
                newton_euler(R, p, axis, pi, gravity, zero, zero, load, W)
            if k == 0 and s == 0:
                for i in range(n):
                    if elastic[i]:
                        d = load[i] / T[i, STIFF]
                        for _ in range(20):  # Newton's steps to where the gear carries the load at rest
                            d -= (T[i, STIFF] * d * (1 + T[i, STIFFEN] * d * d) - load[i]) / (
                                T[i, STIFF] * (1 + 3 * T[i, STIFFEN] * d * d)
                            )
                        q[i] = th[i] - d
            if s == 0:
                Q[k], V[k], U[k] = th, dth, tau
            newton_euler(R, p, axis, pi, gravity, dq, zero, bias, W)
            mass_matrix(R, p, axis, pi, M, W, B)
            drive = tau - extra[k] - _others(T, C, th, dth, (k + w) * DT)
            net = -bias
            for i in range(n):
                f, slope = friction(T[i], dth[i], th[i], temp[k, i] - T_REF, load[i], sc[i], sv[i], F[i])
                f += position_torque(T[i], th[i])
                if elastic[i]:
                    d = th[i] - q[i]
                    g = T[i, STIFF] * d * (1 + T[i, STIFFEN] * d * d) + T[i, DAMP] * (dth[i] - dq[i])
                    dth[i] += h * (drive[i] - f - g) / (rotor[i] + h * slope)
                    net[i] += g
                else:
                    net[i] += drive[i] - f
                    M[i, i] += rotor[i] + h * slope
            solve(M, net)
            for i in range(n):
                dq[i] += h * net[i]
                q[i] += h * dq[i]
                if elastic[i]:
                    th[i] += h * dth[i]
                else:
                    th[i], dth[i] = q[i], dq[i]
                if T[i, DAHL] > 0:
                    side = np.sign(dth[i])
                    fc = T[i, FC_POS]
                    if T[i, BOUC] > 0:  # Bouc and Wen's curve: stiff until close to sliding
                        F[i] += T[i, DAHL] * (1 - np.sign(F[i] * side) * (abs(F[i]) / fc) ** T[i, BOUC]) * dth[i] * h
                        F[i] = min(max(F[i], -fc), fc)
                    else:
                        F[i] = side * fc + (F[i] - side * fc) * np.exp(-T[i, DAHL] / fc * abs(dth[i]) * h)
    return Q, V, U
