"""What these recordings cannot say: effects that would go unnoticed here, why, and which experiment would show them.

An effect of its usual size (a third of the joint's friction, or what its parameter says) is thought into the recordings: the
evidence it would then have needs no new fit, only what the base model leaves of its columns.  Where that stays below the
threshold of a claim the answer "nothing is missing" does not cover it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stopset.effects import Effect, catalogue
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.evidence import Projection, gain, project
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis

LOADS = frozenset({"load", "stiff", "tilt"})

UNRECORDED = "no temperature is recorded"
EVEN = f"the temperature varies by less than {limit.WARMER:g} K"
STILL = "the joint hardly moves"
UNLOADED = "gravity does not load the joint in these motions"
TRACELESS = "it leaves no trace in these motions"
IMITATED = "masses, centres of mass or plain friction would take up its torque"
NOISE = "at its usual size its torque is lost in the noise of these motions"
REMEDIES = {
    UNRECORDED: "Record the drives' temperatures, from a cold start until they are warm.",
    EVEN: "Measure the same motions cold and warm, at least 10 K apart.",
    UNLOADED: "Turn the arm so that gravity loads the joint; on an upright axis this effect does nothing.",
    STILL: "Move the joint through its whole range at several speeds.",
}  # for the other reasons the effect's own experiment is the remedy


@dataclass(frozen=True, slots=True)
class Blind:
    """One effect that would go unnoticed at ``joints`` (none: anywhere): why, and what would show it."""

    effect: str
    joints: tuple[str, ...]
    why: str
    experiment: str

    def __str__(self) -> str:
        where = ", ".join(f"{self.effect}:{j}" for j in self.joints) or self.effect
        return f"{where}: {self.why}. {self.experiment}"


def blind_spots(
    now: Hypothesis, hyper: Hyper, candidates: Sequence[Candidate], names: Sequence[str] | None = None
) -> tuple[Blind, ...]:
    """Effects of the catalogue (of ``names``) that these recordings would not show, one entry per effect and reason.

    ``candidates``: those whose columns the engine has already; the others are added with the middle of their shapes' grids.
    """
    engine = now.engine
    taken = {c.key for c in now.active}
    asked: list[tuple[str, tuple[int, ...]]] = []
    found: dict[tuple[str, str], list[str]] = {}
    for effect in catalogue().values():
        reason = _whole(engine, effect)
        if effect.base or reason == "" or (names is not None and effect.name not in names):
            continue
        if reason is not None:
            found[effect.name, reason] = []
        else:
            asked += [(effect.name, place) for place in places(engine, effect) if (effect.name, place) not in taken]
    candidates = [c for c in candidates if c.given is None]  # a shifted record holds noise that would pass for a trace
    tried = {c.key for c in candidates}
    more = [
        (catalogue()[name], place, catalogue()[name].shape_values(None)) for name, place in asked if (name, place) not in tried
    ]
    shown = _shown(now, hyper, [c for c in (*candidates, *engine.add_all(more)) if c.key in asked])
    for name, place in asked:
        effect = catalogue()[name]
        why = (
            NOISE if engine.drowned(effect, place) else _hidden(engine, place, shown.get((name, place)), frozenset(effect.needs))
        )
        if why:
            found.setdefault((name, why), []).append("+".join(engine.data.joints[j] for j in place))
    return tuple(
        Blind(name, tuple(where), why, REMEDIES.get(why, catalogue()[name].distinguished_by))
        for (name, why), where in found.items()
    )


def places(engine: Engine, effect: Effect) -> list[tuple[int, ...]]:
    """Where an effect may sit: the whole arm, neighbouring joints, or every joint."""
    n = engine.data.n
    if effect.scope == "arm":
        return [()]
    return [(j, j + 1) for j in range(n - 1)] if effect.scope == "pair" else [(j,) for j in range(n)]


def _whole(engine: Engine, effect: Effect) -> str | None:
    """Why an effect can't be seen at any joint; "" where the question does not arise, None where each joint is asked."""
    temp = engine.data.temp
    if effect.role == "play":
        return ""  # no torque shows it: see `plays`
    if "temp" in effect.needs:
        if temp is None:
            return UNRECORDED
        if float(np.ptp(temp, axis=0).max()) < limit.WARMER:
            return EVEN
    if effect.instead_of == "temp" and temp is not None:
        return ""  # the recorded temperature tells it better
    if effect.effort == "compensated_torque" and not engine.source.compensated:
        return ""  # the whole rigid body is in the base model
    return None


def _shown(
    now: Hypothesis, hyper: Hyper, candidates: Sequence[Candidate]
) -> dict[tuple[str, tuple[int, ...]], tuple[float, float]]:
    """Per effect and joints: the evidence it would have at its usual size, and the share of its torque hidden by the base."""
    if not candidates:
        return {}
    rest = np.unique(np.concatenate([c.cols for c in candidates]))
    place = np.full(now.engine.size, -1)
    place[rest] = np.arange(len(rest))
    G, _ = now.total(hyper)
    p = project(G, 0, now.nuisance, rest, now.precision(hyper), now.mean)
    out: dict[tuple[str, tuple[int, ...]], tuple[float, float]] = {}
    for c in candidates:
        ix = place[c.cols]
        evidence = _expected(p, ix, c)
        whole = np.diag(G)[c.cols] * c.sd**2
        k = int(np.argmax(whole))
        taken = 1.0 - float(p.S[ix[k], ix[k]] * c.sd[k] ** 2 / max(whole[k], 1e-300))
        if c.key not in out or evidence > out[c.key][0]:
            out[c.key] = (evidence, taken)
    return out


def _expected(p: Projection, ix: np.ndarray, c: Candidate) -> float:
    """Score of a candidate if one of its terms, the most telling one, had its usual size."""
    S = p.S[np.ix_(ix, ix)]
    return max(gain(S, S[:, k] * c.sd[k], 1.0 / c.sd**2)[0] for k in range(len(ix)))


def _hidden(engine: Engine, place: tuple[int, ...], shown: tuple[float, float] | None, needs: frozenset[str]) -> str:
    """Why an effect at a place would go unnoticed; empty where it would be seen."""
    if any(len(engine.rows[j].take) <= limit.FEWEST_ROWS for j in place):
        return STILL
    if shown is None:
        return UNLOADED if needs & LOADS and not engine.loaded(place) else TRACELESS
    evidence, taken = shown
    if evidence >= limit.THRESHOLD:
        return ""
    if taken > limit.TAKEN_UP:
        return IMITATED
    return NOISE
