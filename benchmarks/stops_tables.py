"""Single-axis STOP 0 tables at full extension, as vendors print them, beside what a simulated stop does.

    python benchmarks/stops_tables.py

For the PRBT-like arm with its stated uncertainty: angle [deg] and time [ms] of a nominal stop, of the slowest corner of all
intervals, and the certified bound; then the shape figures that the published tables of other arms can be compared by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from stop_arms import prbt_like

from stopset.offline.stops.poses import Poses
from stopset.offline.stops.sampling import DT
from stopset.reach.stops import StopBounds
from stopset.reach.stops.setting import Setting
from stopset.simulation.stop import StoppingArm, simulate_stop
from stopset.types import Array

SHARES = (0.33, 0.66, 1.0)
TOP = 1.26


@dataclass(frozen=True, slots=True)
class Cell:
    """Angle [rad] and time [s] of the nominal stop, of the slow corner, and the bound (nan where none)."""

    nominal: tuple[float, float]
    slow: tuple[float, float]
    bound: tuple[float, float]
    layer: str


def _simulated(s: Setting, q: Array, dq: Array, slow: bool, joint: int) -> tuple[float, float]:
    """One simulated stop, of middle parameters or of the slowest with the disturbance pushing along: angle, last motion."""
    p = s.plant
    along = np.sign(dq[joint])

    def pick(name: str) -> Array:
        lo, hi = getattr(p, f"{name}_lo"), getattr(p, f"{name}_hi")
        late = name in ("delay", "rise")
        return np.asarray((hi if late else lo) if slow else 0.5 * (lo + hi))

    u = np.zeros((1, len(q)))
    v0 = dq.copy()
    if slow:
        u[0, joint] = p.u_hi[joint] if along > 0 else p.u_lo[joint]
        v0[joint] += along * s.noise.radius[len(q) + joint]
    pi = p.pi + p.pi_half if slow else p.pi
    steps = int(0.4 / DT)
    qs, vs = simulate_stop(
        StoppingArm(p.chain, pi, p.rotor, pick("coulomb"), pick("viscous"), pick("brake"), pick("delay"), pick("rise")),
        q,
        v0,
        DT,
        steps,
        u,
    )
    moving = np.any(np.abs(vs) > 1e-3, axis=1)
    return float(np.abs(qs[:, joint] - q[joint]).max()), DT * (len(moving) - 1 - int(np.argmax(moving[::-1])))


def table(payload: tuple[float, float], pieces: int = 64) -> dict[tuple[int, float], Cell]:
    """Cells by (joint, share of the speed), the worse direction of each, at full extension where gravity loads it most."""
    model = prbt_like((0.0, 3.1))
    bounds = StopBounds.of(model, payload, pieces=pieces)
    s = bounds.setting
    assert s is not None
    poses = Poses.of(model.robot, model.robot.tip, model.domain.q)
    out = {}
    for joint in (0, 1, 2):
        q = poses.worst_for(joint, 1.0, s.plant.pi)
        for share in SHARES:
            cells = []
            for sign in (1.0, -1.0):
                dq = np.zeros(model.n)
                dq[joint] = sign * share * TOP
                b = bounds.bound(q, dq)
                angle, time = (float("nan"),) * 2
                if b.angle is not None and b.time is not None:
                    angle, time = float(b.angle[joint]), float(b.time.max())
                cells.append(Cell(_simulated(s, q, dq, False, joint), _simulated(s, q, dq, True, joint), (angle, time), b.layer))
            out[joint, share] = max(cells, key=lambda c: c.slow[0])
    return out


def main() -> None:
    for payload in ((0.23, 0.25), (3.0, 3.1)):
        cells = table(payload)
        print(f"PRBT-like arm, full extension, {payload[0]:g} to {payload[1]:g} kg: nominal | slow corner | certified bound")
        for joint in (0, 1, 2):
            row = [
                " | ".join(f"{np.rad2deg(a):.2f} deg {1e3 * t:.0f} ms" for a, t in (c.nominal, c.slow, c.bound)) + f" ({c.layer})"
                for c in (cells[joint, share] for share in SHARES)
            ]
            print(f"  J{joint + 1}  33 %: {row[0]}   66 %: {row[1]}   100 %: {row[2]}")
        full = [cells[j, 1.0] for j in range(3)]
        ratio = full[1].bound[0] / full[0].bound[0]
        shape = ", ".join(f"J{j + 1} {c.bound[0] / (TOP * c.bound[1]):.2f}" for j, c in enumerate(full))
        power = ", ".join(
            f"J{j + 1} {np.log(cells[j, 1.0].bound[0] / cells[j, 0.33].bound[0]) / np.log(1 / 0.33):.2f}" for j in range(3)
        )
        print(f"  J2 down over J1: {ratio:.2f}; s/(v t): {shape}; angle grows with speed to the power {power}")


if __name__ == "__main__":
    main()
