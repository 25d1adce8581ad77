"""Which two recordings of the UR10e to fit and three of other days to test give the figures known for this arm; ours on all splits.

    python benchmarks/ur10e_splits.py FOLDER [--json FILE]

The known figures (`ur10e.py`) come without their split.  Here a plain ladder, weighted least squares with one effect after the
other on rows of an arm in motion, is fitted to every pair of recordings and tested on every three of other days; sums of squares
per recording make that cheap.  Printed are the splits that give every known figure within `NEAR`, with the held-out error of
stopset on the same recordings (its own rows of an arm in motion, friction of the paper), and how stopset does on all splits.
"""

from __future__ import annotations

import argparse
import json
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import ur10e
from scipy.signal import butter, filtfilt

from stopset.offline.description import load_robot
from stopset.offline.nominal import Preprocessing, accumulate, solve_nominal
from stopset.offline.nominal.delay import joint_reduced, lag_weights
from stopset.offline.nominal.normal_equations import moving_rows
from stopset.offline.nominal.preprocess import motions
from stopset.offline.nominal.unidentifiable import base_directions, parameter_scale
from stopset.recording import Recording, read_recordings
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques, regressors

# recordings of one day, by suite: their dates are in the names of the files they were published as
DAYS = ((0,), (1, 2, 3), (4,), (7,), (8, 9), (10, 11), (12, 13), (14, 15), (16,))
KNOWN = (87.2, 33.6, 10.45, 10.15, 9.86, 8.29)  # [N m] summed over joints, rung by rung
KNOWN_23 = ((3.92, 1.65), (2.86, 1.16))  # [N m] joints 2 and 3 without and with load dependence
NEAR = 0.05
PERIOD, CUTOFF = 0.01, 10.0  # [s], [Hz] of the plain ladder
TARGET = 8.22
SHORT = frozenset({0, 1, 2, 3})  # recordings of a few seconds: one motion, too little to identify an arm from

Sums = tuple[np.ndarray, int]  # (6, c, c) normal matrices with the torque last, and their rows


def plain_sums(robot: Robot, r: Recording, V: np.ndarray) -> Sums:
    """Normal matrices of ``[base parameters | viscous | Coulomb | rotor | cubic | load-dependent Coulomb | torque]``."""
    t = np.arange(r.t[0], r.t[-1], PERIOD)
    b, a = butter(4, 2 * CUTOFF * PERIOD)
    q, tau = (filtfilt(b, a, np.column_stack([np.interp(t, r.t, c) for c in x.T]), axis=0) for x in (r.q, r.tau))
    dq = np.gradient(q, PERIOD, axis=0)
    ddq = np.gradient(dq, PERIOD, axis=0)
    use = np.abs(dq).max(axis=1) > ur10e.MOVING
    q, dq, ddq, tau = (x[use] for x in (q, dq, ddq, tau))
    load = np.abs(gravity_torques(robot.chain, robot.pi, np.ascontiguousarray(q)))
    Y = regressors(robot.chain, q, dq, ddq) @ V
    out, base = [], V.shape[1]
    for j in range(robot.n):
        X = np.zeros((len(q), base + 5 * robot.n + 1))
        X[:, :base], X[:, -1] = Y[:, j], tau[:, j]
        for k, x in enumerate((dq, np.sign(dq), ddq, dq**3, np.sign(dq) * load)):
            X[:, base + k * robot.n + j] = x[:, j]
        out.append(X.T @ X)
    return np.array(out), len(q)


def fitted(A: np.ndarray, columns: int) -> np.ndarray:
    """Weighted least squares with the first ``columns`` columns; weights from the residuals, three rounds."""
    at = np.arange(columns)
    w = np.ones(len(A))
    for _ in range(4):
        H, b = np.tensordot(w, A[:, at][:, :, at], 1), np.tensordot(w, A[:, at, -1], 1)
        d = 1 / np.sqrt(np.diag(H) + 1e-9)
        theta = d * np.linalg.lstsq(d[:, None] * H * d, d * b, rcond=1e-11)[0]
        w = 1 / squares(A, theta)
    return theta


def squares(A: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """(6,) sums of squared residuals."""
    at, v = np.r_[0 : len(theta), A.shape[-1] - 1], np.append(theta, -1.0)
    return np.asarray(np.einsum("a,jab,b->j", v, A[:, at][:, :, at], v))


def our_sums(robot: Robot, r: Recording) -> tuple[Any, Sums]:
    """What stopset learns from a recording, and the sums that judge: rows of an arm in motion, torque at every lag."""
    data = accumulate(robot, [r], (ur10e.POLYNOMIAL, ur10e.QUADRANTS))
    G, rows = np.zeros((robot.n, *data.still.shape[1:])), 0
    for m in motions(r, Preprocessing()):
        X, _ = moving_rows(data, robot, m)
        arm = np.abs(m.dq[m.retained]).max(axis=1) > ur10e.MOVING
        G += np.array([x[arm].T @ x[arm] for x in X])
        rows += int(arm.sum())
    return data, (G, rows)


def our_squares(nominal: Any, G: np.ndarray) -> np.ndarray:
    out = []
    for j in range(len(G)):
        own = joint_reduced(G[j], lag_weights(float(nominal.delay_applied[j])))
        index = nominal.data.layout.index(j)
        at, v = np.r_[0 : len(index), len(own) - 1], np.append(nominal.theta[index], -1.0)
        out.append(v @ own[np.ix_(at, at)] @ v)
    return np.array(out)


def rms(parts: list[tuple[np.ndarray, int]]) -> np.ndarray:
    return np.asarray(np.sqrt(sum(s for s, _ in parts) / sum(m for _, m in parts)))


def search(robot: Robot, data: dict[int, Recording]) -> list[dict[str, Any]]:
    scale = parameter_scale(robot)
    V = base_directions(robot) * scale[:, None]
    plain = {k: plain_sums(robot, r, V) for k, r in data.items()}
    mine = {k: our_sums(robot, r) for k, r in data.items()}
    day = {k: d for d, suites in enumerate(DAYS) for k in suites}
    rungs = [V.shape[1] + robot.n * k for k in range(len(KNOWN))]
    out = []
    for fit in combinations(sorted(data), 2):
        nominal = solve_nominal(robot, mine[fit[0]][0] + mine[fit[1]][0])
        rest = [k for k in sorted(data) if day[k] not in {day[x] for x in fit}]
        ours = {k: (our_squares(nominal, mine[k][1][0]), mine[k][1][1]) for k in rest}
        thetas = [fitted(plain[fit[0]][0] + plain[fit[1]][0], c) for c in rungs]
        theirs = [{k: (squares(plain[k][0], x), plain[k][1]) for k in rest} for x in thetas]
        for test in combinations(rest, 3):
            ladder = np.array([rms([x[k] for k in test]) for x in theirs])
            ratios = np.concatenate([ladder.sum(axis=1) / KNOWN, (ladder[4:6, 1:3] / KNOWN_23).ravel()])
            out.append(
                {"fit": fit, "test": test, "off": float(np.abs(np.log(ratios)).max()), "plain": ladder.sum(axis=1).round(2).tolist(),
                 "joints_2_3": ladder[4:6, 1:3].round(2).tolist(), "stopset": float(rms([ours[k] for k in test]).sum())}
            )  # fmt: skip
    return sorted(out, key=lambda s: s["off"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    robot = load_robot(args.folder / "robot.urdf")
    data = {r.suite: r for r in read_recordings(args.folder / "identification.parquet", robot)}
    found = search(robot, data)
    near = [s for s in found if s["off"] < NEAR]
    print(
        f"known: {KNOWN}, joints 2, 3: {KNOWN_23}; {len(near)} of {len(found)} splits are within {100 * NEAR:.0f} % of all of it"
    )
    for s in near:
        print(
            f"  off {100 * s['off']:4.1f} %  fit {s['fit']}, test {s['test']}: plain {s['plain']}, stopset {s['stopset']:.2f} N m"
        )
    groups = {
        "near the known figures": near, "all": found,
        "none of the shortest recordings": [s for s in found if not SHORT & {*s["fit"], *s["test"]}],
    }  # fmt: skip
    answers = {}
    for name, some in groups.items():
        e = np.array([s["stopset"] for s in some])
        answers[name] = {
            "splits": len(e),
            "median": float(np.median(e)),
            "largest": float(e.max()),
            "at_most_known": int((e <= TARGET).sum()),
        }
        print(
            f"{name}: {len(e)} splits, median {np.median(e):.2f}, largest {e.max():.2f}, {int((e <= TARGET).sum())} at most {TARGET}"
        )
    if args.json:
        args.json.write_text(json.dumps({"groups": answers, "near": near}, indent=1))


if __name__ == "__main__":
    main()
