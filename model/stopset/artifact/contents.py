"""What a model's contents may be: shapes that fit the robot's joints, numbers where numbers must be, and work that ends.

The hash says only that a file is as it was written. Whoever reads one gets a model that can be computed with, or one sentence.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from stopset.artifact.model import Brakes, Model, UncertaintySets
from stopset.artifact.polynomial import MOST_POWER, Polynomial
from stopset.core.library import lib
from stopset.errors import ModelFileError

MOST_STEPS = 100_000  # of a horizon; of one joint's integration over a horizon, its steps cut into parts
MOST_NUMBERS = 50_000_000  # of the tables that a tube is made of
LARGEST = 1e12  # [SI] of any number: products of some of them are numbers too
SLOWEST = 10.0  # [s] until a brake holds: beyond, a unit was mistaken
CORNER_SPEED = 2.0  # [rad/s] by which a corner of a set may be faster than what was recorded


def check_contents(m: Model, path: Path) -> None:
    """Raises `ModelFileError` for contents that nobody can compute with; ``path``: the file that the sentence names."""
    if not 1 <= m.n <= lib.STOPSET_JOINTS:
        raise ModelFileError(f"{path}: an arm of {m.n} joints; expected 1 to {lib.STOPSET_JOINTS}: restore it or identify again")
    if wrong := _misshapen(m):
        raise ModelFileError(f"{path}: {', '.join(wrong)} does not fit the robot's {m.n} joints; identify again")
    if wrong := _no_numbers(m):
        raise ModelFileError(f"{path}: {', '.join(wrong)} holds what is no number there; restore it or identify again")
    _check_work(m, path)


def _fits(sets: UncertaintySets, n: int) -> bool:
    """Whether a zonotope has the robot's joints, and ``U`` is around it."""
    z = sets.zonotope
    if z is None:
        return True
    shapes = z.centre.shape == (n,) and z.generators.ndim == z.directions.ndim == 2
    return shapes and len(z.generators) == z.directions.shape[1] == n and sets.U.encloses(z.set.box)


def _of(polynomials: tuple[Polynomial, ...], variables: int) -> bool:
    """Whether they are polynomials in so many variables, of powers that there are."""
    shapes = all(p.coefficient.ndim == 1 and p.exponent.shape == (len(p.coefficient), variables) for p in polynomials)
    return shapes and all(bool(np.all((p.exponent >= 0) & (p.exponent <= MOST_POWER))) for p in polynomials)


def _misshapen(m: Model) -> list[str]:
    n, a = m.n, m.abstraction
    return [
        name
        for name, ok in (
            ("rotor", m.rotor.shape == (n,)),
            ("inertia_std", m.inertia_std is None or m.inertia_std.shape == (n,)),
            ("robot.gravity", m.robot.chain.gravity.shape == (3,)),
            ("abstraction.kind", a.kind in (1, 2, 3)),
            ("abstraction.Minv", a.Minv.shape == (n, n)),
            ("abstraction.viscous", a.viscous.ndim == 2 and len(a.viscous) == n and a.viscous.size > 0),
            ("abstraction.coriolis", len(a.coriolis) in (0, n) and _of(a.coriolis, 3 * n)),
            ("abstraction.acceleration", len(a.acceleration) == (n if a.kind == 3 else 0) and _of(a.acceleration, 4 * n)),
            ("abstraction.offset", a.offset.size in (0, n)),
            ("abstraction.standstill", a.standstill.size in (0, n)),
            ("brakes", m.brakes is None or {m.brakes.torque.dim, m.brakes.delay.dim, m.brakes.rise.dim} == {n}),
            ("brakes.lag", m.brakes is None or m.brakes.lag is None or m.brakes.lag.shape == (n,)),
            ("effects", all(f.joint is None or set(f.joint.split("+")) <= set(m.joints) for f in m.effects)),
            ("domain", {x.dim for x in (m.domain.q, m.domain.dq, m.domain.u, m.domain.temp) if x is not None} == {n}),
            *((f"sets.{k}", s.X0.dim == 2 * n and s.U.dim == n and s.V.dim == 2 * n) for k, s in m.sets.items()),
            *((f"sets.{k}.zonotope", _fits(s, n)) for k, s in m.sets.items()),
            ("sets.powered", "powered" in m.sets),
        )
        if not ok
    ]


def _no_numbers(m: Model) -> list[str]:
    """A tube with a hole where a number is missing would hold nothing against a sample."""
    a, chain, d = m.abstraction, m.robot.chain, m.domain
    numbers = {
        "rotor": m.rotor, "robot.pi": m.robot.pi, "robot.gravity": chain.gravity, "robot.arm.R": chain.R, "robot.arm.p": chain.p,
        "robot.arm.axis": chain.axis, "robot.arm.tip": m.robot.tip, "abstraction.Minv": a.Minv, "abstraction.viscous": a.viscous,
        "abstraction.offset": a.offset, "abstraction.standstill": a.standstill, "domain.payload": np.array(d.payload),
        **{f"effects {f.label}": np.array(list(f.values.values())) for f in m.effects},
        **{f"abstraction.coriolis[{i}]": p.coefficient for i, p in enumerate(a.coriolis)},
        **{f"abstraction.acceleration[{i}]": p.coefficient for i, p in enumerate(a.acceleration)},
    }  # fmt: skip
    boxes = {f"sets.{k}.{name}": x for k, s in m.sets.items() for name, x in (("X0", s.X0), ("U", s.U), ("V", s.V))}
    boxes |= {f"domain.{name}": x for name, x in (("q", d.q), ("dq", d.dq), ("temp", d.temp)) if x is not None}
    numbers |= {name: np.concatenate([x.lo, x.hi]) for name, x in boxes.items()}
    wrong = [name for name, x in numbers.items() if not bool(np.all(np.abs(x) <= LARGEST))]
    limits = {"robot.arm.q_limit": m.robot.q_limit, "robot.arm.dq_limit": m.robot.dq_limit}  # infinite where there is none
    wrong += [name for name, x in limits.items() if np.isnan(x).any()]
    if m.inertia_std is not None and not bool(np.all((m.inertia_std >= 0.0) & (m.inertia_std <= LARGEST))):
        wrong.append("inertia_std")
    wrong += [f"brakes.{name}" for name in _bad_brakes(m.brakes)] if m.brakes is not None else []
    return wrong + [f"sets.{k}" for k, s in m.sets.items() if not (0.0 < s.dt <= s.horizon <= MOST_STEPS * s.dt < math.inf)]


def _bad_brakes(b: Brakes) -> list[str]:
    """What of them would begin before the order, or never end."""
    most = {"torque": (b.torque, LARGEST), "delay": (b.delay, SLOWEST), "rise": (b.rise, SLOWEST)}
    times = {"lag": b.lag, "apart": b.delay_spread}
    wrong = [name for name, (x, end) in most.items() if not bool(np.all((x.lo >= 0.0) & (x.hi <= end)))]
    return wrong + [
        k for k, x in times.items() if x is not None and not bool(np.all((np.asarray(x) >= 0.0) & (np.asarray(x) <= SLOWEST)))
    ]


def _check_work(m: Model, path: Path) -> None:
    """A prediction over the horizon ends soon, and has room."""
    for k, s in m.sets.items():
        steps = round(s.horizon / s.dt)
        if not m.abstraction.linear:
            if not (total := steps * _parts(m, s.dt)) <= MOST_STEPS:
                raise ModelFileError(
                    f"{path}: sets.{k} asks for {total:.3g} steps of integration over its horizon of {s.horizon:g} s, as damping is up to "
                    f"{np.abs(m.abstraction.viscous).max():g} N m s/rad; expected at most {MOST_STEPS}: restore it or identify again"
                )
            continue
        z, n = s.zonotope, m.n
        rows, inputs = (2 * n, n) if z is None else (2 * max(n, len(z.directions)), n + z.generators.shape[1])
        if not (total := (steps + 1) * rows * (2 * n + 2 * inputs)) <= MOST_NUMBERS:
            raise ModelFileError(
                f"{path}: sets.{k} asks for tables of {total:.3g} numbers, {steps} steps for {inputs} torques; expected at most "
                f"{MOST_NUMBERS:.3g}: restore it or identify again"
            )


def _parts(m: Model, dt: float) -> float:
    """Into how many parts a step is cut at the fastest that was recorded, see `stopset.reach.nonlinear.parts`; inf where no number says."""
    a, v = m.abstraction, float(max(np.abs(m.domain.dq.lo).max(), np.abs(m.domain.dq.hi).max())) + CORNER_SPEED
    if not a.decoupled:
        return 1.0
    powers = np.arange(a.viscous.shape[1])
    with np.errstate(over="ignore", invalid="ignore"):
        rate = float(np.max(np.diag(a.Minv) * (np.abs(a.viscous) @ ((powers + 1) * v**powers))))
    return max(1.0, dt * rate / float(lib.stopset_corner_step)) if math.isfinite(rate) else math.inf
