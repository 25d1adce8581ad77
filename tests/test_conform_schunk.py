"""The paper's real recordings: every trial enclosed, by a simulation and a hull that share no code with the project.

The lag's written-out solution (all windows) and a Runge-Kutta solver (random windows) give the nominal motion, quadrature
of the response gives the hull; only the numbers of the model file are taken over.
"""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.integrate import quad, solve_ivp

from stopset.artifact import Model
from stopset.offline.identify.pipeline import Identification
from synthetic import lag

pytestmark = pytest.mark.shared

# a solver with rtol 1e-10 on q < 10 rad over 1100 steps leaves less than this; the noise set is ten times wider
SOLVER = 1e-8
# maths.md section 6: the paper's definition on this data, measured before this project existed
SUM_U_WIDTH = 20.9
Q_RMSE = (0.042, 0.055, 0.138, 0.047, 0.039, 0.064)
DQ_RMSE = (0.027, 0.067, 0.109, 0.039, 0.026, 0.038)
# our own Table II on this data, widths of U in N m, no margin: the optimum of a linear program, so any exact solver gives
# these digits. The paper's definition agrees with maths.md section 6 for all states; position only is smaller there
# because zero need not be inside (trap P7).
TABLE_II = {
    "start, all, no noise set": (2.41, 10.52, 4.32, 1.79, 0.74, 1.15),
    "start, position, no noise set": (1.43, 3.48, 2.54, 1.09, 0.37, 0.64),
}
DIGITS = 0.006  # half a unit of the last digit, and the solver's own tolerance


class Trial:
    """One trial straight from the file."""

    def __init__(self, rows: dict[str, np.ndarray], joints: tuple[str, ...]) -> None:
        self.t = rows["t"].astype(float)
        self.q, self.dq, self.u = (
            np.column_stack([rows[f"{name}_{j}"] for j in joints]).astype(float) for name in ("q", "dq", "tau")
        )


@pytest.fixture(scope="module")
def trials(schunk_file) -> list[Trial]:
    table = pq.read_table(schunk_file).to_pydict()
    joints = tuple(c[2:] for c in table if c.startswith("q_"))
    rows = {k: np.array(v) for k, v in table.items()}
    key = rows["suite"] * 1000 + rows["trial"]
    return [Trial({k: v[key == i] for k, v in rows.items()}, joints) for i in np.unique(key)]


class Joint:
    """``J ddq + v dq = u - offset``: simulated by scipy, its hull by quadrature of the response."""

    def __init__(self, m: Model, j: int) -> None:
        a, s, n = m.abstraction, m.powered, m.n
        assert a.linear
        assert not np.any(a.Minv - np.diag(np.diag(a.Minv)))  # one joint at a time is the whole truth only then
        self.J, self.v, self.offset, self.dt = 1.0 / a.Minv[j, j], a.viscous[j, 0], a.offset[j], s.dt
        self.X0 = (s.X0.lo[[j, n + j]], s.X0.hi[[j, n + j]])
        self.V = (s.V.lo[[j, n + j]], s.V.hi[[j, n + j]])
        self.U = (s.U.lo[j], s.U.hi[j])
        self.ages = round(s.horizon / s.dt)
        self.tube = self._tube()

    def _tube(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (2, H+1, 2) of the deviation; the responses of a lag to start speed and torque are positive."""
        J, v, dt = self.J, self.v, self.dt
        lo, hi = np.zeros((self.ages + 1, 2)), np.zeros((self.ages + 1, 2))
        position = velocity = 0.0  # integrals of the responses to a torque
        for k in range(self.ages + 1):
            age = k * dt
            if k:
                position += quad(lambda s: (1 - np.exp(-v / J * s)) / v, age - dt, age, epsabs=1e-14)[0]
                velocity += quad(lambda s: np.exp(-v / J * s) / J, age - dt, age, epsabs=1e-14)[0]
            coast, fade = J / v * (1 - np.exp(-v / J * age)), np.exp(-v / J * age)
            for side, X0, V, U in ((lo, self.X0[0], self.V[0], self.U[0]), (hi, self.X0[1], self.V[1], self.U[1])):
                side[k] = X0[0] + coast * X0[1] + position * U + V[0], fade * X0[1] + velocity * U + V[1]
        return lo, hi

    def simulated(self, q0: float, dq0: float, u: np.ndarray) -> np.ndarray:
        """Nominal ``(q, dq)`` (N, 2) from a reading, the torque of each sample held until the next."""
        return np.column_stack(lag(self.J, self.v, self.dt, q0, dq0, u - self.offset))

    def integrated(self, q0: float, dq0: float, u: np.ndarray) -> np.ndarray:
        """The same by a Runge-Kutta solver."""

        def rate(t: float, x: np.ndarray, force: float) -> list[float]:
            return [x[1], (force - self.offset - self.v * x[1]) / self.J]

        x = np.empty((len(u), 2))
        x[0] = q0, dq0
        for k in range(len(u) - 1):
            step = solve_ivp(rate, (0.0, self.dt), x[k], args=(u[k],), method="RK45", rtol=1e-10, atol=1e-13)
            x[k + 1] = step.y[:, -1]
        return x

    def excess(self, trial: Trial, j: int, start: int, length: int) -> float:
        """How far the reading leaves the hull, worst over ages; negative inside."""
        end = min(start + length + 1, len(trial.t), start + self.ages + 1)
        x = self.integrated(trial.q[start, j], trial.dq[start, j], trial.u[start:end, j])
        d = np.column_stack([trial.q[start:end, j], trial.dq[start:end, j]]) - x
        lo, hi = self.tube
        return float(max((d[1:] - hi[1 : len(d)]).max(), (lo[1 : len(d)] - d[1:]).max()))


def linear_steps(joint: Joint, trial: Trial, j: int) -> np.ndarray:
    """Deviations of *all* windows of a trial, (starts, ages, 2), from one simulation by superposition.

    The nominal model is linear: a run from sample s differs from the run from sample 0 by the free response to the
    difference of their starts.
    """
    x = joint.simulated(trial.q[0, j], trial.dq[0, j], trial.u[:, j])
    return np.column_stack([trial.q[:, j], trial.dq[:, j]]) - x


def test_all_trials_are_enclosed_from_their_starts_and_from_every_later_sample(schunk: Identification, trials) -> None:
    m = schunk.model
    assert len(trials) == 100
    for j in range(m.n):
        joint = Joint(m, j)
        lo, hi = joint.tube
        ages = joint.dt * np.arange(joint.ages + 1)
        coast, fade = joint.J / joint.v * (1 - np.exp(-joint.v / joint.J * ages)), np.exp(-joint.v / joint.J * ages)
        for trial in trials:
            d = linear_steps(joint, trial, j)
            N = len(d)
            for start in range(N - 1):
                h = min(N - start, joint.ages + 1)
                e = d[start : start + h] - np.column_stack([d[start, 0] + coast[:h] * d[start, 1], fade[:h] * d[start, 1]])
                worst = max((e[1:] - hi[1:h]).max(), (lo[1:h] - e[1:]).max())
                assert worst <= SOLVER, f"{m.joints[j]}: {worst:.3g} outside from sample {start}"


def test_windows_from_random_starts_simulated_one_by_one(schunk: Identification, trials) -> None:
    m, rng = schunk.model, np.random.default_rng(7)
    joints = [Joint(m, j) for j in range(m.n)]
    for _ in range(40):
        trial, j = trials[rng.integers(len(trials))], int(rng.integers(m.n))
        start = int(rng.integers(len(trial.t) - 50))
        assert joints[j].excess(trial, j, start, 150) <= SOLVER


def test_sets_a_hundredth_smaller_let_trials_out(schunk_start: Identification, trials) -> None:
    """Without margin the sets are tight: the enclosure test can fail."""
    m = schunk_start.model
    out = 0
    for j in range(m.n):
        joint = Joint(m, j)
        centre = 0.5 * (joint.U[0] + joint.U[1])
        joint.U = (centre + 0.99 * (joint.U[0] - centre), centre + 0.99 * (joint.U[1] - centre))
        lo, hi = joint._tube()
        for trial in trials:
            d = linear_steps(joint, trial, j)[: joint.ages + 1]
            out += bool((d[1:] > hi[1 : len(d)] + SOLVER).any() or (d[1:] < lo[1 : len(d)] - SOLVER).any())
    assert out > 0


def test_the_reference_figures_are_met_on_their_own_definition(schunk_start: Identification) -> None:
    sets, errors = schunk_start.model.powered, schunk_start.model.errors
    assert (sets.conform, sets.windows, sets.margin) == ("all", "start", 1.0)
    assert sets.U.width.sum() <= SUM_U_WIDTH
    joints = schunk_start.model.joints
    assert all(round(errors[j]["position_rmse"], 3) <= bound for j, bound in zip(joints, Q_RMSE, strict=True))
    assert all(round(errors[j]["velocity_rmse"], 3) <= bound for j, bound in zip(joints, DQ_RMSE, strict=True))


def test_open_loop_errors_are_those_of_an_independent_simulation(schunk_start: Identification, trials) -> None:
    m = schunk_start.model
    for j, name in enumerate(m.joints):
        joint = Joint(m, j)
        d = np.vstack([linear_steps(joint, trial, j) for trial in trials])
        q, dq = np.sqrt(np.mean(d**2, axis=0))
        assert q == pytest.approx(m.errors[name]["position_rmse"], rel=1e-6)
        assert dq == pytest.approx(m.errors[name]["velocity_rmse"], rel=1e-6)


@pytest.mark.parametrize("case", TABLE_II)
def test_table_two_of_our_own(schunk_start: Identification, case: str) -> None:
    assert schunk_start.conformance.table[case].U.width == pytest.approx(TABLE_II[case], abs=DIGITS)


def test_the_noise_set_narrows_the_torque_and_sliding_windows_widen_it(
    schunk: Identification, schunk_start: Identification
) -> None:
    start, sliding = schunk_start.conformance.table, schunk.conformance.table
    width = {name: fit.U.width.sum() for name, fit in start.items()}
    assert width["start, all"] < width["start, all, no noise set"] <= SUM_U_WIDTH + 0.05
    assert width["start, position, no noise set"] < width["start, all, no noise set"]
    assert sliding["all"].U.width.sum() > width["start, all"]


def test_the_line_of_guarantee_promises_nothing_from_two_motions(schunk: Identification) -> None:
    g = schunk.model.guarantee
    assert (g.motions, g.upper_bound) == (0, 1.0)
    assert "All 100 recorded trials of 2 independent motions" in g.text
    assert "nothing statistical is promised" in g.text
