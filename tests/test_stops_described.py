"""Arms of many descriptions and mountings: where stopped arms are, by another way than the product's, lies within every number in space."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stop_described import Drawn, draw
from stop_published import failed_ramp, power_off, working_ramp
from stopset.artifact import Model
from stopset.offline.description import robot_from_text
from stopset.reach.stops import Category, Ramp, StopBound, StopBounds
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torque, link_frames, mass_matrix
from stopset.types import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms_wide import arm_model

SMALL, STEP = 2e-6, 1e-6  # [m] of the simulation; of differences
DRAWN = [(n, seed) for n in (1, 2, 2, 3, 4, 5, 6) for seed in (0, 1, 2)]
RATED = 2.0  # [kg]


def robot_of(d: Drawn) -> Robot:
    return robot_from_text(d.urdf, {"locked": d.locked, "gravity": d.gravity.tolist(), "tip": "palm"})


def model_of(robot: Robot, payload_com: Array, rng: np.random.Generator) -> Model:
    """Brakes that hold twice of what gravity can ask with the rated payload, rotors from light to heavy."""
    pi = robot.pi.copy()
    pi[-1, :4] += RATED * np.r_[1.0, payload_com]
    asked = np.abs([gravity_torque(robot.chain, pi, rng.uniform(-np.pi, np.pi, robot.n)) for _ in range(300)]).max(axis=0)
    brake = 2.5 * np.maximum(asked, 0.1 * asked.max()) + 4.0
    inertia = np.mean([np.diag(mass_matrix(robot.chain, pi, rng.uniform(-3, 3, robot.n))) for _ in range(30)], axis=0)
    rotor = rng.uniform(0.3, 1.5) * inertia + 0.02
    return arm_model(robot, rotor, brake, 0.05 * brake, 0.02 * brake, 0.01 * brake, RATED, np.full(robot.n, 1.5))


@pytest.mark.parametrize(("n", "seed"), sorted(set(DRAWN)))
def test_a_description_is_read_as_its_numbers_say(n: int, seed: int) -> None:
    """Joints, tool point, kinetic energy and the potential's slope, of all bodies one by one."""
    d, rng = draw(n, seed), np.random.default_rng([n, seed, 7])
    robot = robot_of(d)
    assert list(robot.joints) == d.turning
    for _ in range(3):
        q, v = rng.uniform(-2, 2, n), rng.uniform(-1, 1, n)
        R, o = link_frames(robot.chain, q)
        at, ahead, behind = d.frames(q), d.bodies(q + STEP * v), d.bodies(q - STEP * v)
        assert np.allclose([at[f"l{i}"][1] for i in range(n)], o, atol=1e-9)
        assert np.allclose(at["palm"][1], o[-1] + R[-1] @ robot.tip, atol=1e-9)
        energy, potential = 0.0, 0.0
        fore, back = d.frames(q + STEP * v), d.frames(q - STEP * v)
        names = [str(e.get("name")) for e in d.root.findall("link")]
        for name, (m, c, I), (_, c1, _), (_, c0, _) in zip(names, d.bodies(q), ahead, behind, strict=True):  # noqa: E741
            spin = (fore[name][0] - back[name][0]) / (2 * STEP) @ at[name][0].T
            w, pace = np.array([spin[2, 1], spin[0, 2], spin[1, 0]]), (c1 - c0) / (2 * STEP)
            energy += 0.5 * m * pace @ pace + 0.5 * w @ I @ w
            potential -= m * d.gravity @ pace
            assert m > 0.0 and c.shape == (3,)
        assert 0.5 * v @ mass_matrix(robot.chain, robot.pi, q) @ v == pytest.approx(energy, rel=1e-5)
        assert v @ gravity_torque(robot.chain, robot.pi, q) == pytest.approx(potential, rel=1e-5, abs=1e-6)


def sticks_out(b: StopBound, points: Array) -> float:
    """[m] how far the farthest of ``points`` (m, 3) is from all capsules that are swept."""
    assert b.capsules is not None
    rows = b.capsules.reshape(-1, 7)
    begin, along = rows[:, :3], rows[:, 3:6] - rows[:, :3]
    d = points[:, None] - begin
    s = np.clip(np.einsum("mpx,px->mp", d, along) / np.maximum((along**2).sum(axis=1), 1e-15), 0.0, 1.0)
    return float((np.linalg.norm(d - s[..., None] * along, axis=2) - rows[:, 6]).min(axis=1).max())


def beyond(d: Drawn, b: StopBound, tool: Array, q: Array, seed: int) -> set[str]:
    """Which numbers of space the way ``q`` (T, n) contradicts; the tool is at ``tool`` (3,) [m] in the last link."""
    at = np.unique(np.linspace(0, len(q) - 1, 25).astype(int))
    poses = [d.frames(x) for x in q[at]]
    n, out = len(d.turning), set()
    last = [f"l{n - 1}" for _ in poses]
    held = np.array([p[x][1] + p[x][0] @ tool for p, x in zip(poses, last, strict=True)])
    moved = held - held[0]
    ends = np.array([[*(p[f"l{i}"][1] for i in range(1, n)), p["palm"][1]] for p in poses])
    directions = np.vstack([np.eye(3), -np.eye(3), np.random.default_rng(3).normal(size=(4, 3))])
    checks = {
        "tcp": np.linalg.norm(moved, axis=1).max() <= b.tcp + SMALL,
        "box": np.all(moved <= b.tcp_box[:, 1] + SMALL) and np.all(moved >= b.tcp_box[:, 0] - SMALL),
        "links": np.all(np.linalg.norm(ends - ends[0], axis=2).max(axis=0) <= b.links + SMALL),
        "directed": all((moved @ x / np.linalg.norm(x)).max() <= b.directed_distance(x) + SMALL for x in directions),
        "capsules": all(
            sticks_out(b, np.vstack(d.surface(x, np.random.default_rng(seed)))) <= SMALL for x in q[at[::4]]
        ),
    }  # fmt: skip
    out |= {name for name, good in checks.items() if not good}
    return out


CATEGORY: tuple[Category, ...] = ("0", "1 guaranteed", "1")


@pytest.mark.parametrize(("n", "seed"), sorted(set(DRAWN)))
def test_stops_of_described_arms_stay_within_what_is_said_of_space(n: int, seed: int) -> None:
    """Stops in three categories, a payload up to the rated one off the flange; every surface of every link within what is swept."""
    d, rng, told = draw(n, seed), np.random.default_rng([n, seed, 9]), 0
    robot = robot_of(d)
    tool = robot.tip + rng.uniform(-0.1, 0.1, 3)
    ramp = Ramp.stated(n, time=0.25).failing(0.1)
    bounds = StopBounds.of(model_of(robot, tool, rng), (0.0, RATED), tool, ramp, fast=True)
    working = replace(bounds, ramp=replace(ramp, off_after=None))
    for k in range(6):
        q, dq = rng.uniform(-2.5, 2.5, n), rng.uniform(-1.4, 1.4, n)
        category, box = CATEGORY[k % 3], (np.full(n, 0.01 * (k % 2)), np.full(n, 0.05 * (k % 2)))
        b = (working if category == "1" else bounds).bound(q, dq, category, *box)
        if b.time is None:
            continue
        told += 1
        lasts = float(b.time.max())
        if category == "1":
            stops = working_ramp(bounds, q, dq, box, 0.0, 5, k)
        else:
            stops = {"0": power_off, "1 guaranteed": failed_ramp}[category](bounds, q, dq, box, lasts, 5, k)
        for x in stops:
            assert beyond(d, b, tool, x.q, k) == set()
    assert told >= 4
