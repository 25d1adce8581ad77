"""The uncertainty sets of a linear model: an exact linear program over the envelope, solved, re-checked, repaired outward.

Unknowns are the bounds of ``X0``, ``U`` and ``V`` themselves.  ``U`` is found directly (trap P6), centres are free (trap
P7).  ``V`` holds the noise, and more where that is cheaper than a torque at all times, but never more than readings were seen
to be apart from each other (`stopset.offline.campaign.reading_error`): it has no room for an error of the model.
A start state is a reading too, so ``X0`` lies in ``-V`` (trap P12) and cannot hide stiction.  With a decoupled model and
boxes every joint is a program of its own.  Source: Liu & Althoff (2018), eq. (17)-(21) as corrected there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import ActiveBound, TorqueZonotope
from stopset.offline.abstraction.metrics import STOP_TIME
from stopset.offline.conform.envelope import Envelope, state_names
from stopset.offline.conform.problem import SetProblem
from stopset.offline.conform.program import Bounds, age_weights, cheapest, price, sides, tight
from stopset.offline.conform.zonotopes import Template
from stopset.reach.flowpipe import Responses
from stopset.sets import Box
from stopset.types import Array

AGES = 160  # of a zonotope's program, evenly in the logarithm: its rows couple all joints; what is checked is every age


@dataclass(frozen=True, slots=True)
class FittedSets:
    """The sets, the cost they were chosen by (mean tube width, rad), and what fixes each bound.

    ``inputs``: the torque set in the coordinates of the responses' inputs: the box ``U`` itself, or of a ``template`` the
    centre (n,) and the lengths of its generators (m,).
    """

    X0: Box
    inputs: Box
    V: Box
    cost: float
    active: tuple[ActiveBound, ...]
    conform: str = "all"
    template: Template | None = None

    @property
    def zonotope(self) -> TorqueZonotope | None:
        """The torque set where it is a zonotope; generators of no length left out."""
        if self.template is None:
            return None
        n = len(self.template.generators)
        length = self.inputs.hi[n:]
        used = length > 1e-9 * max(float(length.max(initial=0.0)), 1e-300)
        # what is left out is shared among the axes: nothing is lost, however little
        rest = np.abs(self.template.generators[:, ~used]) @ length[~used]
        generators = np.hstack([self.template.generators[:, used] * length[used], np.diag(rest)[:, rest > 0.0]])
        return TorqueZonotope(self.inputs.centre[:n], generators, self.template.directions)

    @property
    def U(self) -> Box:
        """The torque set as a box [N m], the smallest around a zonotope."""
        z = self.zonotope
        return self.inputs if z is None else z.set.box

    def inflated(self, factors: Array | float) -> FittedSets:
        """All sets grown about their centres, by one factor or one per joint (joints of a zonotope share the largest)."""
        f = np.broadcast_to(factors, self.X0.dim // 2)
        if np.all(f <= 1.0):
            return self
        both = np.concatenate([f, f])
        inputs = self.inputs.inflated(f if self.template is None else float(f.max()))
        return replace(self, X0=self.X0.inflated(both), inputs=inputs, V=self.V.inflated(both))


@dataclass(frozen=True, slots=True)
class _Block:
    """One linear program: rows ``G z >= h`` of states xs, inputs us, and where each row comes from."""

    xs: list[int]
    us: list[int]
    bounds: Bounds
    G: Array
    h: Array
    cost: Array
    age: NDArray[np.int64]
    state: NDArray[np.int64]
    upper: NDArray[np.bool_]


def _block(
    env: Envelope, R: Responses, wanted: list[int], xs: list[int], us: list[int], bounds: Bounds, *, dense: bool
) -> _Block:
    last = env.steps
    paper = not bounds.capped
    importance = np.full(last, 1.0 / last) if paper else age_weights(last, R.dt)
    positions = R.E1.shape[1] // 2
    weight = np.array([1.0 if i < positions or paper else STOP_TIME for i in wanted])
    E, P, N = R.E1[:, wanted][:, :, xs], R.plus[:, wanted][:, :, us], R.minus[:, wanted][:, :, us]
    L, count = E[0], len(wanted)
    ages = np.arange(1, last + 1) if dense else np.unique(np.geomspace(1, last, AGES).astype(np.int64))
    G, h, age, state, upper = [], [], [], [], []
    for i in range(count):
        up, down = sides(E[ages, i], np.tile(L[i], (len(ages), 1)), P[ages, i], N[ages, i])
        G += [up, down]
        h += [env.hi[ages, wanted[i]], -env.lo[ages, wanted[i]]]
        age += [ages] * 2
        state += [np.full(2 * len(ages), wanted[i])]
        upper += [np.full(len(ages), True), np.full(len(ages), False)]
    every = slice(1, last + 1)
    cost = price(E[every], L, P[every], N[every], importance, weight)
    return _Block(
        xs, us, bounds, np.vstack(G), np.concatenate(h), cost, np.concatenate(age), np.concatenate(state), np.concatenate(upper)
    )


def fit_sets(env: Envelope, R: Responses, problem: SetProblem, *, capped: bool = True) -> FittedSets:
    """Smallest sets ``X0`` (2n,), ``U`` (n,), ``V`` (2n,) whose tube encloses the envelope at every age.

    ``R``: the problem's responses.  Positions alone say nothing of velocity readings: give those exactly.
    ``capped=False`` is the paper's program: ``X0`` is free, so stiction may hide in it, and every edge at every age costs the
    same (eq. 21).  With a template, ages between those of the program are left to the caller's check.
    Raises `NotConformant` when no such sets exist.
    """
    joints, template, conform = problem.joints, problem.template, problem.options.conform
    n = problem.abstraction.n
    rows = R.E1.shape[1]
    names = state_names(joints, rows // 2)
    wanted = list(range(rows if conform == "all" else rows // 2))
    inputs = n if template is None else n + template.generators.shape[1]
    alone = problem.abstraction.decoupled and template is None
    blocks = [([j], [j, n + j]) for j in range(n)] if alone else [(list(range(inputs)), list(range(2 * n)))]
    lo = {name: np.zeros(inputs if name == "U" else 2 * n) for name in ("X0", "V", "U")}
    hi = {name: np.zeros_like(x) for name, x in lo.items()}
    cost = 0.0
    active: list[ActiveBound] = []
    for us, xs in blocks:
        bounds = Bounds(problem.readings.take(xs), len(us), capped, None if template is None else n)
        mine = [i for i in wanted if i in xs] if alone else wanted
        block = _block(env, R, mine, xs, us, bounds, dense=template is None)
        who = "joint " + ", ".join(joints[j] for j in us if j < n)
        z = _repaired(block, bounds.tidy(cheapest(block.G, block.h, block.cost, bounds, who)))
        lo["X0"][xs], hi["X0"][xs], lo["V"][xs], hi["V"][xs], lo["U"][us], hi["U"][us] = bounds.split(z)
        cost += float(block.cost @ z)
        active += _active(block, z, env, names, joints)
    return FittedSets(
        Box(lo["X0"], hi["X0"]), Box(lo["U"], hi["U"]), Box(lo["V"], hi["V"]), cost, tuple(active), conform, template
    )  # fmt: skip


def _repaired(block: _Block, z: Array) -> Array:
    """Widen ``V``, by what each row still lacks in floating point, until every row holds with a margin above rounding."""
    z = z.copy()
    _, _, v_lo, v_hi, _, _ = block.bounds.split(z)  # views into z
    m = block.bounds.m
    rounding = 2.0**-48 * (np.abs(block.G) @ np.abs(z) + np.abs(block.h))
    short = np.maximum(block.h + rounding - block.G @ z, 0.0)
    reads = np.abs(block.G[:, 2 * m : 4 * m])  # a row along one state reads one bound of V, a row across joints several
    most = reads.argmax(axis=1)
    wider = np.zeros(2 * m)
    np.maximum.at(wider, most, short / reads[np.arange(len(most)), most])
    v_lo -= wider[:m]
    v_hi += wider[m:]
    assert float((block.h - block.G @ z).max()) <= 0.0
    return z


def _active(block: _Block, z: Array, env: Envelope, names: Sequence[str], joints: tuple[str, ...]) -> list[ActiveBound]:
    """For each bound of U and V, the tightest row in which it takes part: which recording, time and state fix it."""
    n, m, k = len(joints), len(block.xs), len(block.us)
    states = state_names(joints, n)
    inputs = [f"U[{joints[j]}]" if j < n else f"U generator {j - n + 1}" for j in block.us]
    labels = [f"V[{states[i]}].{s}" for s in ("lo", "hi") for i in block.xs] + [f"{u}.{s}" for s in ("lo", "hi") for u in inputs]
    rows = tight(block.G, block.h, z, block.bounds)
    return [
        env.where(label, int(block.age[r]), int(block.state[r]), "hi" if block.upper[r] else "lo", names)
        for v, label in zip(range(2 * m, 4 * m + 2 * k), labels, strict=True)
        if (r := rows.get(v)) is not None
    ]
