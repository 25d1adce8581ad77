"""The paper's Table I on our arm: mean velocity error of every abstraction against the exact forward dynamics.

    python benchmarks/table1.py [--robot lwa4p] [--trajectories 20] [--json FILE]

Two families of motions: "near" moves to and fro across the expansion point q = 0 (up to about 1.1 rad from it),
"anywhere" starts up to 1 rad away from it and goes on from there (up to 2.6 rad).  Each trajectory is five seconds of
point-to-point motion whose axes reach the top speed (slow 0.4, fast 1.2 rad/s); the input u is what moves the exact
model along it, and every model gets that same u, open loop, from the same state.  A model that leaves every bound is
reported as divergent (inf), with how many of the trajectories did.

The paper's own parameters are not public.  Masses and geometry are those of the shipped arm, friction is of the size
identified on the paper's own recordings (see FRICTION), so the columns compare with the paper in order of magnitude
only.

Source: Liu & Althoff (2018), Sec. V-A and Table I.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stopset.artifact import Abstraction
from stopset.offline.abstraction import ORDERS, build
from stopset.offline.abstraction.forms import coriolis_degree, dynamics
from stopset.offline.description import load_robot
from stopset.robot import Robot
from stopset.robot.rigid import Chain, mass_matrices, torques
from stopset.types import Array

# v1 [N m s/rad]: per-joint model 1 fitted to the paper's open-loop recordings; v3 = CUBIC * v1: a friction curve that
# flattens by a tenth at 1 rad/s, a common size; v2 = 0 (no preferred direction). An arm of other size gets these too,
# cyclically.
FRICTION = (12.6, 30.8, 8.5, 8.1, 3.5, 4.0)
CUBIC = -0.1
TOP_SPEED = {"slow": 0.4, "fast": 1.2}  # [rad/s]
SECONDS, MOVES = 5.0, 2
FAMILIES = ("near", "anywhere")
STEP = 0.01  # [s] of the fourth-order Runge-Kutta integration; its own error is measured by halving
DIVERGED = 20.0  # [rad/s] far beyond any joint
PAPER = {
    "slow": {1: (0.0040, 0.0034, None, None), 2: (0.0040, 0.0042, 0.0026, 0.0025), 3: (0.0040, np.inf, 0.0031, None)},
    "fast": {1: (0.0408, 0.0243, None, None), 2: (0.0408, 0.0294, 0.0161, 0.0162), 3: (0.0408, np.inf, np.inf, None)},
}

Flow = Callable[[Array, Array, Array], Array]  # ddq of q, dq, u


class Degrees(NamedTuple):
    """Maximal polynomial degrees: from which order on a model no longer changes."""

    model_1: int  # of the viscous friction
    model_2: int  # of the Coriolis torques as the algorithm composes them (the paper's 12)
    model_2_reduced: int  # the same after sin^2 + cos^2 = 1, as `build` uses them


def degrees(robot: Robot, viscous: Array) -> Degrees:
    """Maximal degrees of models 1 and 2 (the paper: 3 and 12); model 3 has none, its dynamics are rational."""
    used = np.flatnonzero(np.any(np.asarray(viscous).reshape(robot.n, -1) != 0.0, axis=0))
    friction = int(used.max(initial=0)) + 1
    composed, reduced = (coriolis_degree(dynamics(robot, np.zeros(robot.n), as_composed=plain)) for plain in (True, False))
    return Degrees(friction, max(friction, composed), max(friction, reduced))


def exact_ddq(chain: Chain, pi: Array, rotor: Array, viscous: Array, q: Array, dq: Array, u: Array) -> Array:
    """``M_m(q)^-1 (u - c(q, dq) - tau_nu(dq))`` at the rows of ``q, dq, u`` (N, n), eq. (10); gravity is inside u."""
    rest = u - torques(chain._replace(gravity=np.zeros(3)), pi, q, dq, np.zeros_like(q))
    for j in range(viscous.shape[1]):
        rest = rest - viscous[:, j] * dq ** (j + 1)
    return np.asarray(np.linalg.solve(mass_matrices(chain, pi, q) + np.diag(rotor), rest[:, :, None])[:, :, 0])


def motion(rng: np.random.Generator, n: int, top: float, N: int, family: str) -> Callable[[float], tuple[Array, Array, Array]]:
    """``t -> q, dq, ddq`` (N, n): N random trajectories of quintic point-to-point moves, every axis reaching ``top`` in each."""
    T = SECONDS / MOVES
    length = top * T / 1.875  # a quintic's top speed is 1.875 times its mean speed
    direction = rng.choice([-1.0, 1.0], (N, n))
    start = rng.uniform(-1.0, 1.0, (N, n)) if family == "anywhere" else rng.uniform(-0.3, 0.3, (N, n)) - 0.5 * length * direction
    # moves alternate, so that the arm keeps to the middle of its range
    turn = [direction * (-1) ** k for k in range(MOVES)]

    def at(t: float) -> tuple[Array, Array, Array]:
        k = min(int(t / T), MOVES - 1)
        x = t / T - k
        here = start + length * sum(turn[:k], np.zeros((N, n)))
        s = x**3 * (10 - 15 * x + 6 * x * x)
        ds = 30 * x * x * (1 - x) ** 2 / T
        dds = 60 * x * (1 - x) * (1 - 2 * x) / T**2
        return here + length * turn[k] * s, length * turn[k] * ds, length * turn[k] * dds

    return at


def simulate(flow: Flow, q: Array, dq: Array, u: list[Array], h: float) -> Array:
    """Velocities (steps + 1, N, n) under the input ``u`` given every half step; from divergence on they are inf."""
    out = [dq]
    for k in range(len(u) // 2):
        a, b, c = u[2 * k : 2 * k + 3]
        k1 = flow(q, dq, a)
        k2 = flow(q + h / 2 * dq, dq + h / 2 * k1, b)
        k3 = flow(q + h / 2 * dq + h * h / 4 * k1, dq + h / 2 * k2, b)
        k4 = flow(q + h * dq + h * h / 2 * k2, dq + h * k3, c)
        q = q + h * dq + h * h / 6 * (k1 + k2 + k3)
        dq = dq + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        gone = ~np.all(np.abs(dq) < DIVERGED, axis=1)
        dq = np.where(gone[:, None], DIVERGED, dq)  # parked there: it counts as divergent already
        q = np.where(gone[:, None], 0.0, q)
        out.append(np.where(gone[:, None], np.inf, dq))
        dq = np.where(gone[:, None], 0.0, dq)
    v = np.array(out)
    return np.where(np.maximum.accumulate(np.isinf(v), axis=0), np.inf, v)


def inputs(robot: Robot, rotor: Array, viscous: Array, at: Callable, times: Array) -> list[Array]:
    """``u = M_m ddq + c + tau_nu`` (N, n) along the motion at ``times``."""
    chain = robot.chain._replace(gravity=np.zeros(3))
    out = []
    for t in times:
        q, dq, ddq = at(float(t))
        u = torques(chain, robot.pi, q, dq, ddq) + rotor * ddq
        out.append(u + sum(viscous[:, k] * dq ** (k + 1) for k in range(viscous.shape[1])))
    return out


def table(
    robot: Robot, trajectories: int, family: str = "near", seed: int = 1, orders: tuple[int, ...] = ORDERS, cubic: float = CUBIC
) -> dict[str, object]:
    """All cells of one family of motions: mean absolute velocity error [rad/s] over time, joints and trajectories."""
    n = robot.n
    rotor = robot.rotor
    v1 = np.resize(FRICTION, n)
    viscous = np.column_stack([v1, 0 * v1, cubic * v1])
    d = degrees(robot, viscous)
    answer: dict[str, object] = {
        "robot": robot.name,
        "family": family,
        "unit": "rad/s",
        "trajectories": trajectories,
        "viscous_Nms_per_rad": viscous[:, 0].tolist(),
        "cubic_Nms3_per_rad3": viscous[:, 2].tolist(),
        "maximal_degrees": d._asdict(),
        "cells": [],
    }
    cells: list[dict[str, object]] = []
    cells_of: list[tuple[int, int, Abstraction, float]] = []
    for kind in (1, 2, 3):
        for p in (*orders, d.model_2) if kind == 2 else orders:
            began = time.perf_counter()
            cells_of.append((kind, p, build(kind, p, robot, rotor, viscous), time.perf_counter() - began))
    for name, top in TOP_SPEED.items():
        at = motion(np.random.default_rng(seed), n, top, trajectories, family)
        fine = np.arange(2 * round(SECONDS / STEP) + 1) * (STEP / 2)
        u = inputs(robot, rotor, viscous, at, fine)
        truth = np.array([at(float(t))[1] for t in fine[::2]])
        q0, dq0, _ = at(0.0)

        def exact(q: Array, dq: Array, u: Array) -> Array:
            return exact_ddq(robot.chain, robot.pi, rotor, viscous, q, dq, u)

        cells.append(_cell(name, "exact", None, simulate(exact, q0, dq0, u, STEP), truth, 0.0, 0.0))
        for kind, p, model, seconds in cells_of:
            began = time.perf_counter()
            v = simulate(model.ddq, q0, dq0, u, STEP)
            cells.append(_cell(name, f"model {kind}", p, v, truth, seconds, time.perf_counter() - began))
    answer["cells"] = cells
    return answer


def _cell(name: str, model: str, order: int | None, v: Array, truth: Array, built: float, simulated: float) -> dict[str, object]:
    error = np.abs(v - truth).mean(axis=(0, 2))  # per trajectory
    gone = int(np.isinf(error).sum())
    return {
        "speed": name,
        "model": model,
        "order": order,
        "error": float(error.mean()),
        "diverged": gone,
        "error_of_the_rest": float(error[np.isfinite(error)].mean()) if gone < len(error) else None,
        "construction_s": built,
        "simulation_s": simulated,
    }


def text(answer: dict) -> str:
    """The table as Markdown, the paper's figure in brackets."""
    cells = {(c["speed"], c["model"], c["order"]): c for c in answer["cells"]}
    orders = sorted({c["order"] for c in answer["cells"] if c["order"]})
    columns = [(m, s) for m in (1, 2, 3) for s in ("slow", "fast")]
    lines = ["| p | " + " | ".join(f"model {m} {s}" for m, s in columns) + " |", "|---|" + "---|" * len(columns)]
    for p in orders:
        row = []
        for m, s in columns:
            c = cells.get((s, f"model {m}", p))
            paper = PAPER[s][m][ORDERS.index(p)] if p in ORDERS else None
            paper_says = "" if paper is None else f" [{'∞' if np.isinf(paper) else f'{paper:.4f}'}]"
            if c is None:
                row.append("--" + paper_says)
            elif c["diverged"]:
                row.append(f"∞ ({c['diverged']} of {answer['trajectories']})" + paper_says)
            else:
                row.append(f"{c['error']:.2g}" + paper_says if c["error"] < 5e-5 else f"{c['error']:.4f}" + paper_says)
        lines.append(f"| {p} | " + " | ".join(row) + " |")
    exact = ", ".join(f"{s} {cells[(s, 'exact', None)]['error']:.1e}" for s in ("slow", "fast"))
    d = answer["maximal_degrees"]
    lines += ["", f"exact model: {exact} rad/s; maximal degrees: model 1: {d['model_1']}, model 2: {d['model_2']} [3, 12] "]
    lines[-1] += f"({d['model_2_reduced']} once sin² + cos² = 1 is used)"
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", default="lwa4p", help="a shipped arm or a URDF")
    parser.add_argument("--trajectories", type=int, default=20)
    parser.add_argument("--cubic", type=float, default=CUBIC, help=f"v3 over v1 of the friction curve (default {CUBIC})")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    answers = []
    for family in FAMILIES:
        answers.append(table(load_robot(args.robot), args.trajectories, family, cubic=args.cubic))
        print(f"\n{family}: mean |velocity error| in rad/s over {args.trajectories} motions [the paper's figure]\n")
        print(text(answers[-1]), flush=True)
    if args.json:
        args.json.write_text(json.dumps(answers, indent=1))


if __name__ == "__main__":
    main()
