"""Rigid body of the independent arm: an arm simulator that shares no code with stopset.

What the diagnosis is measured on must not be made by its own laws.  A serial arm from a URDF: recursive Newton-Euler in the
links' frames, mass matrix from composite bodies.  Run this file with a folder of ``robot.urdf`` and ``robot.json`` to compare it
with Pinocchio.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from stopset.types import Array


@dataclass(frozen=True)
class Arm:
    """Kinematics ``R0`` (n, 3, 3), ``p, axis`` (n, 3); ``pi`` (n, 10) m, m c, inertia xx xy xz yy yz zz about the link's
    origin; ``rotor`` (n,) reflected; ``limit`` (n,) torque; ``gear`` ratios; ``gravity`` (3,)."""

    name: str
    joints: tuple[str, ...]
    R0: Array
    p: Array
    axis: Array
    pi: Array
    rotor: Array
    limit: Array
    gear: Array
    gravity: Array

    @property
    def n(self) -> int:
        return len(self.joints)


def _rpy(r: float, p: float, y: float) -> Array:
    cr, sr, cp, sp, cy, sy = np.cos(r), np.sin(r), np.cos(p), np.sin(p), np.cos(y), np.sin(y)
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])  # fmt: skip


def _numbers(text: str | None, default: str = "0 0 0") -> Array:
    return np.array([float(x) for x in (text or default).split()])


def about_origin(m: float, c: Array, I: Array) -> Array:  # noqa: E741
    """(10,) parameters about the link's origin from mass, centre and inertia (3, 3) about the centre."""
    J = I + m * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([m, *(m * c), J[0, 0], J[0, 1], J[0, 2], J[1, 1], J[1, 2], J[2, 2]])


def centred(pi: Array) -> tuple[float, Array, Array]:
    """Mass, centre, inertia about the centre of (10,) parameters."""
    m, c = pi[0], pi[1:4] / pi[0]
    J = np.array([[pi[4], pi[5], pi[6]], [pi[5], pi[7], pi[8]], [pi[6], pi[8], pi[9]]])
    return float(m), c, J - m * (c @ c * np.eye(3) - np.outer(c, c))


def read_arm(folder: Path) -> Arm:
    """The arm of ``folder/robot.urdf`` and ``robot.json``: a chain of revolute joints from the first link on."""
    root = ET.parse(folder / "robot.urdf").getroot()
    drives = json.loads((folder / "robot.json").read_text())
    link = {e.get("name"): e for e in root.findall("link")}
    names, R0, p, axis, pi, rotor, limit, gear = [], [], [], [], [], [], [], []
    for joint in root.findall("joint"):
        if joint.get("type") != "revolute":
            continue
        origin, inertial = joint.find("origin"), link[joint.find("child").get("link")].find("inertial")  # type: ignore[union-attr]
        names.append(str(joint.get("name")))
        R0.append(_rpy(*_numbers(origin.get("rpy"))))  # type: ignore[union-attr]
        p.append(_numbers(origin.get("xyz")))  # type: ignore[union-attr]
        axis.append(_numbers(joint.find("axis").get("xyz")))  # type: ignore[union-attr]
        t = {k: float(v) for k, v in inertial.find("inertia").attrib.items()}  # type: ignore[union-attr]
        I = np.array([  # noqa: E741
            [t["ixx"], t["ixy"], t["ixz"]], [t["ixy"], t["iyy"], t["iyz"]], [t["ixz"], t["iyz"], t["izz"]],
        ])  # fmt: skip
        mass = float(inertial.find("mass").get("value"))  # type: ignore[union-attr]
        pi.append(about_origin(mass, _numbers(inertial.find("origin").get("xyz")), I))  # type: ignore[union-attr]
        d = drives["joints"][names[-1]]
        rotor.append(d["motor_inertia_kgm2"] * d["gear_ratio"] ** 2)
        limit.append(d["torque_limit_Nm"])
        gear.append(d["gear_ratio"])
    return Arm(
        str(root.get("name")), tuple(names), np.array(R0), np.array(p), np.array(axis), np.array(pi), np.array(rotor),
        np.array(limit), np.array(gear), np.array([0.0, 0.0, -9.81]),
    )  # fmt: skip


@njit(cache=True)
def _cross(a, b, out):  # type: ignore[no-untyped-def]
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def _turn(R, x, out):  # type: ignore[no-untyped-def]
    for r in range(3):
        out[r] = R[r, 0] * x[0] + R[r, 1] * x[1] + R[r, 2] * x[2]


@njit(cache=True)
def _back(R, x, out):  # type: ignore[no-untyped-def]
    for r in range(3):
        out[r] = R[0, r] * x[0] + R[1, r] * x[1] + R[2, r] * x[2]


@njit(cache=True)
def frames(R0, axis, q, out):  # type: ignore[no-untyped-def]
    """(n, 3, 3) rotations child to parent into ``out`` (Rodrigues)."""
    K = np.zeros((3, 3))
    for i in range(len(q)):
        s, c, a = np.sin(q[i]), np.cos(q[i]), axis[i]
        K[0, 1], K[0, 2], K[1, 0], K[1, 2], K[2, 0], K[2, 1] = -a[2], a[1], a[2], -a[0], -a[1], a[0]
        for r in range(3):
            for k in range(3):
                total = 0.0
                for m in range(3):
                    turn = c * (m == k) + s * K[m, k] + (1 - c) * a[m] * a[k]
                    total += R0[i, r, m] * turn
                out[i, r, k] = total


@njit(cache=True)
def newton_euler(R, p, axis, pi, gravity, dq, ddq, tau, W):  # type: ignore[no-untyped-def]
    """Joint torques (n,) into ``tau``; the base accelerates against gravity.  ``W`` (10 + 2 n, 3): room to work in."""
    n = len(dq)
    w, dw, a, w2, dw2, b, t1, t2, J1, J2 = W[0], W[1], W[2], W[3], W[4], W[5], W[6], W[7], W[8], W[9]
    for r in range(3):
        w[r] = dw[r] = 0.0
        a[r] = -gravity[r]
    for i in range(n):
        F, N, x = W[10 + i], W[10 + n + i], pi[i]
        _cross(w, p[i], t1)
        _cross(w, t1, t2)
        _cross(dw, p[i], t1)
        for r in range(3):
            b[r] = a[r] + t1[r] + t2[r]
        _back(R[i], b, a)
        _back(R[i], w, w2)
        _back(R[i], dw, dw2)
        _cross(w2, axis[i], t1)
        for r in range(3):
            dw[r] = dw2[r] + t1[r] * dq[i] + axis[i, r] * ddq[i]
            w[r] = w2[r] + axis[i, r] * dq[i]
        h = x[1:4]
        _cross(w, h, t1)
        _cross(w, t1, t2)
        _cross(dw, h, t1)
        for r in range(3):
            F[r] = x[0] * a[r] + t1[r] + t2[r]
        J1[0] = x[4] * dw[0] + x[5] * dw[1] + x[6] * dw[2]
        J1[1] = x[5] * dw[0] + x[7] * dw[1] + x[8] * dw[2]
        J1[2] = x[6] * dw[0] + x[8] * dw[1] + x[9] * dw[2]
        J2[0] = x[4] * w[0] + x[5] * w[1] + x[6] * w[2]
        J2[1] = x[5] * w[0] + x[7] * w[1] + x[8] * w[2]
        J2[2] = x[6] * w[0] + x[8] * w[1] + x[9] * w[2]
        _cross(w, J2, t1)
        _cross(h, a, t2)
        for r in range(3):
            N[r] = J1[r] + t1[r] + t2[r]
    f, k, f2, k2 = W[0], W[1], W[2], W[3]
    for r in range(3):
        f[r] = k[r] = 0.0
    for i in range(n - 1, -1, -1):
        for r in range(3):
            f2[r] = f[r] + W[10 + i, r]
            k2[r] = k[r] + W[10 + n + i, r]
        tau[i] = axis[i, 0] * k2[0] + axis[i, 1] * k2[1] + axis[i, 2] * k2[2]
        _turn(R[i], f2, f)
        _turn(R[i], k2, k)
        _cross(p[i], f, t1)
        for r in range(3):
            k[r] += t1[r]


@njit(cache=True)
def mass_matrix(R, p, axis, pi, M, W, B):  # type: ignore[no-untyped-def]
    """Mass matrix (n, n) into ``M``: everything beyond a joint as one body.  ``B`` (n, 10): room for these bodies."""
    n = len(axis)
    f, k, f2, k2, h, RJ = W[0], W[1], W[2], W[3], W[4], W[5:8]
    B[:] = pi
    for i in range(n - 1, 0, -1):
        x, y, m, o = B[i], B[i - 1], B[i, 0], p[i]
        _turn(R[i], x[1:4], h)
        J = ((x[4], x[5], x[6]), (x[5], x[7], x[8]), (x[6], x[8], x[9]))
        for r in range(3):
            for c in range(3):
                RJ[r, c] = R[i, r, 0] * J[0][c] + R[i, r, 1] * J[1][c] + R[i, r, 2] * J[2][c]
        both = 2 * (h[0] * o[0] + h[1] * o[1] + h[2] * o[2]) + m * (o[0] ** 2 + o[1] ** 2 + o[2] ** 2)
        at = 4
        for r in range(3):
            for c in range(r, 3):
                v = RJ[r, 0] * R[i, c, 0] + RJ[r, 1] * R[i, c, 1] + RJ[r, 2] * R[i, c, 2]
                y[at] += v + both * (r == c) - h[r] * o[c] - o[r] * h[c] - m * o[r] * o[c]
                at += 1
        y[0] += m
        for r in range(3):
            y[1 + r] += h[r] + m * o[r]
    for i in range(n):
        a, x = axis[i], B[i]
        _cross(a, x[1:4], f)
        k[0] = x[4] * a[0] + x[5] * a[1] + x[6] * a[2]
        k[1] = x[5] * a[0] + x[7] * a[1] + x[8] * a[2]
        k[2] = x[6] * a[0] + x[8] * a[1] + x[9] * a[2]
        for j in range(i, -1, -1):
            M[i, j] = M[j, i] = axis[j, 0] * k[0] + axis[j, 1] * k[1] + axis[j, 2] * k[2]
            _turn(R[j], f, f2)
            _turn(R[j], k, k2)
            _cross(p[j], f2, h)
            for r in range(3):
                f[r], k[r] = f2[r], k2[r] + h[r]


@njit(cache=True)
def rnea(R0, p, axis, pi, gravity, q, dq, ddq):  # type: ignore[no-untyped-def]
    """(K, n) torques of a rigid body at K states."""
    out, R, W = np.empty_like(q), np.empty_like(R0), np.empty((10 + 2 * q.shape[1], 3))
    for k in range(len(q)):
        frames(R0, axis, q[k], R)
        newton_euler(R, p, axis, pi, gravity, dq[k], ddq[k], out[k], W)
    return out


@njit(cache=True)
def regressor(R0, p, axis, gravity, q, dq, ddq):  # type: ignore[no-untyped-def]
    """(K, n, 10 n): torque per unit of each link parameter."""
    K, n = q.shape
    out = np.empty((K, n, 10 * n))
    unit, tau, R, W = np.zeros((n, 10)), np.empty(n), np.empty_like(R0), np.empty((10 + 2 * n, 3))
    for k in range(K):
        frames(R0, axis, q[k], R)
        for c in range(10 * n):
            unit[c // 10, c % 10] = 1.0
            newton_euler(R, p, axis, unit, gravity, dq[k], ddq[k], tau, W)
            out[k, :, c] = tau
            unit[c // 10, c % 10] = 0.0
    return out


def turned(arm: Arm, roll: float, pitch: float) -> Arm:
    """The arm on a tilted base."""
    return replace(arm, gravity=_rpy(roll, pitch, 0.0).T @ arm.gravity)


def torques(arm: Arm, q: Array, dq: Array, ddq: Array) -> Array:
    """(K, n) rigid-body torques with rotors."""
    return np.asarray(rnea(arm.R0, arm.p, arm.axis, arm.pi, arm.gravity, q, dq, ddq)) + arm.rotor * ddq


def check_against_pinocchio(folder: Path) -> float:
    """Largest difference of torques [N m] and mass matrices [kg m^2] from Pinocchio's at random states."""
    import pinocchio as pin

    arm = read_arm(folder)
    model: Any = pin.buildModelFromUrdf(str(folder / "robot.urdf"))
    data = model.createData()
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, 50, arm.n))
    ours = torques(replace(arm, rotor=np.zeros(arm.n)), q, v, a)
    theirs = np.array([pin.rnea(model, data, *x) for x in zip(q, v, a, strict=True)])
    worst = float(np.abs(ours - theirs).max())
    R, M, W, B = np.empty_like(arm.R0), np.empty((arm.n, arm.n)), np.empty((10 + 2 * arm.n, 3)), np.empty((arm.n, 10))
    for x in q:
        frames(arm.R0, arm.axis, x, R)
        mass_matrix(R, arm.p, arm.axis, arm.pi, M, W, B)
        full = pin.crba(model, data, x)
        worst = max(worst, float(np.abs(np.triu(M) - np.triu(full)).max()))
    return worst


if __name__ == "__main__":
    import sys

    print(f"largest difference from Pinocchio: {check_against_pinocchio(Path(sys.argv[1])):.2e}")
