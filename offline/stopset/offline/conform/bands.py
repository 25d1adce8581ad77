"""Sets per temperature band: warm and cold friction no longer share one set, so each is narrower than the whole.

Bands are cut by warmth (`stopset.artifact.TemperatureBand`) at quantiles of the trials' means.  A trial counts in every
band that one of its samples lies in, so that whatever was recorded at a temperature is enclosed by that temperature's sets.
The linear program and the margin are those of the whole, and a band's trials are some of the whole's: what the program
minimises, the width of the tube, is then never larger than the whole's.  A single set may be, where another one shrank.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from stopset.artifact import Abstraction, Model, TemperatureBand, UncertaintySets
from stopset.errors import RecordingError
from stopset.offline.conform import guarantee as g
from stopset.offline.conform.linear_program import fit_sets
from stopset.offline.conform.linear_sets import Gathered, divided, enclosing
from stopset.offline.conform.problem import SetProblem
from stopset.offline.conform.program import age_weights
from stopset.reach.flowpipe import deviation_tube
from stopset.recording import Recording
from stopset.sets import Box
from stopset.types import Array

MOST = 20  # bands


@dataclass(frozen=True, slots=True)
class Bands:
    """Where warmth is cut: ``inner`` edges between the bands, in the warmth of ``reference`` (n,) [degC]."""

    reference: Box
    inner: tuple[float, ...]

    @property
    def number(self) -> int:
        return len(self.inner) + 1

    def of(self, r: Recording) -> range:
        """Numbers of the bands that samples of a trial lie in; all where its temperature is not known."""
        if r.temp is None:
            return range(self.number)
        warmth = TemperatureBand(self.reference, 0.0, 1.0).warmth(r.temp)
        # a sample on an edge belongs to both sides
        first = int(np.searchsorted(self.inner, warmth.min(), "left"))
        return range(first, int(np.searchsorted(self.inner, warmth.max(), "right")) + 1)

    def band(self, k: int, seen: Box) -> TemperatureBand:
        """Band ``k``; the outermost ones end with the temperatures ``seen`` (n,) [degC]."""
        ends = TemperatureBand(self.reference, 0.0, 1.0).warmth(np.vstack([seen.lo, seen.hi]))
        edges = [float(ends[0]), *self.inner, float(ends[1])]
        return TemperatureBand(self.reference, edges[k], edges[k + 1])


def cut(means: Array | None, temp: Box | None, number: int) -> Bands:
    """``number`` bands of about as many trials each; ``means``: (trials, n) mean temperatures, ``temp``: hull of all [degC].

    Raises `RecordingError` if no temperature was measured or the trials' differ too little.
    """
    if means is None or temp is None:
        raise RecordingError(
            "temperature bands need measured temperatures, these recordings have no temp_ column; leave --bands out"
        )
    if not np.any(temp.width > 0):
        raise RecordingError(
            f"the temperatures never move from {temp.lo.max():.1f} degC: there is nothing to divide; leave --bands out"
        )
    warmth = TemperatureBand(temp, 0.0, 1.0).warmth(means)
    edges = np.quantile(warmth, np.arange(number + 1) / number)
    if np.any(np.diff(edges) <= 0):
        raise RecordingError(
            f"{len(np.unique(warmth))} different temperatures of {len(warmth)} trials do not make {number} bands; ask for fewer (--bands)"
        )
    return Bands(temp, tuple(edges[1:-1].tolist()))


def band_sets(
    found: Gathered, bands: Bands, seen: Box, factors: Array, problem: SetProblem, learnt: Collection[int] = ()
) -> dict[str, UncertaintySets]:
    """Sets of every band by name; ``factors`` (n,): margin of the whole; ``seen``: hull of temperatures (n,) [degC].

    Motions held out from the whole are held out here too, then enclosed.
    """
    R = problem.responses()
    used = divided(found.parts, learnt).used
    out = {}
    for k, parts in sorted(found.bands.items()):
        everything = g.union(list(parts.values()))
        fitted = g.union([parts[m] for m in parts if m in used] or list(parts.values()))
        fit = fit_sets(fitted, R, problem.asking("all"))
        if problem.options.conform == "position":
            fit = fit_sets(fitted, R, problem.reading(fit.V))
        final = enclosing(fit.inflated(factors), R, everything, decoupled=problem.abstraction.decoupled)
        out[name(k)] = UncertaintySets(
            X0=final.X0, U=final.U, V=final.V, dt=problem.dt, horizon=everything.steps * problem.dt, conform=final.conform,
            windows=problem.options.windows, margin=float(factors.max()), active=final.active, temp=bands.band(k, seen),
            zonotope=final.zonotope,
        )  # fmt: skip
    return out


def name(k: int) -> str:
    """The regime's name of band ``k``, counted from 1."""
    return f"powered, band {k + 1}"


@dataclass(frozen=True, slots=True)
class Narrower:
    """How the sets of a band compare with the whole's: sum of U widths [N m] and mean width of the position tube [rad]."""

    band: str
    at: str  # mean temperature of the joints at its edges
    torque: float
    torque_share: float
    tube: float | None  # None where the tube depends on the motion
    tube_share: float | None


def narrower(model: Model) -> list[Narrower]:
    """Every band beside the whole; tubes up to the horizon they share, ages weighted as in the sets' cost, joints added."""
    rows = []
    for title, s in model.sets.items():
        if s.temp is None:
            continue
        reference = s.temp.reference
        at = [float((reference.lo + w * reference.width).mean()) for w in (s.temp.lo, s.temp.hi)]
        tube = whole = None
        if model.abstraction.linear:
            steps = round(min(s.horizon, model.powered.horizon) / s.dt)
            tube, whole = (_tube_width(model.abstraction, x, steps) for x in (s, model.powered))
        torque, all_torque = float(s.U.width.sum()), float(model.powered.U.width.sum())
        share = None if tube is None or whole is None else tube / whole
        rows.append(Narrower(title, f"{at[0]:.1f} to {at[1]:.1f} degC", torque, torque / max(all_torque, 1e-300), tube, share))
    return rows


def _tube_width(abstraction: Abstraction, sets: UncertaintySets, steps: int) -> float:
    tube = deviation_tube(abstraction, sets)
    width = (tube.hi - tube.lo)[1 : steps + 1, : abstraction.n].sum(axis=1)
    return float(age_weights(steps, sets.dt) @ width)
