"""The answer of a diagnosis: which effects, how sure, what is left, and its JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from stopset.effects import Fitted
from stopset.notebook import shown
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.changes import Change
from stopset.offline.diagnose.explain.identifiable import Blind
from stopset.offline.diagnose.explain.partial import Partial
from stopset.offline.diagnose.search.structures import Structure


@dataclass(frozen=True, slots=True)
class Parameter:
    """A value with unit and standard deviation (None where the recordings do not tell it)."""

    value: float
    unit: str
    std: float | None


@dataclass(frozen=True, slots=True)
class Ranked:
    """One missing effect: where, how sure, how large, what it changes."""

    effect: str
    joints: tuple[str, ...]
    score: float
    error_before: float  # [N m] held-out torque error of its joint (of the worst joint for the whole arm)
    error_after: float
    parameters: dict[str, Parameter]
    look_at: str
    says: str
    unit: str = "N m"  # of the errors: rad where a simulation is judged
    points: Partial | None = None  # to draw what it explains; None where a simulation is judged
    change: Change | None = None  # of a level that the model had
    objection: str = ""  # why it is no finding after all
    surplus: bool = False  # that it is one more than are named is all that speaks against it
    together: tuple[str, ...] = ()  # effects that it must be added with: one of these alone makes some error larger
    at: str = ""  # the joint that the errors are of, where it acts at several
    alternatives: tuple[str, ...] = ()  # effects that these recordings cannot tell from it at its joint: it is named with them
    alike: str = ""  # why they look alike
    telling: str = ""  # and what would tell them apart
    # of a law of the load: it is of all that the gear transmits, with the numbers of gravity's part
    transmitted: bool = False
    in_model: bool = False  # `identify` chose it by evidence already: what `add` then does is make it a revision of its own

    @property
    def label(self) -> str:
        return self.effect if not self.joints else f"{self.effect}:{'+'.join(self.joints)}"

    @property
    def one_of(self) -> tuple[str, ...]:
        """Its label and those of its alternatives."""
        return (self.label, *(self.label.replace(self.effect, other, 1) for other in self.alternatives))

    @property
    def whose(self) -> str:
        """Of which joint the errors are, where that is not said by where it acts."""
        return f" of {self.at}" if self.at and self.joints != (self.at,) else ""

    @property
    def errors(self) -> str:
        """The errors in words, and whose they are."""
        return f"held-out error{self.whose} {self.error_before:.3g} -> {self.error_after:.3g} {self.unit}"

    @property
    def fitted(self) -> Fitted:
        """As the model file holds it."""
        values = {k: p.value for k, p in self.parameters.items()}
        std = {k: p.std for k, p in self.parameters.items() if p.std is not None}
        return Fitted(self.effect, "+".join(self.joints) or None, values, std)


@dataclass(frozen=True, slots=True)
class Unexplained:
    """What is left of a joint: ``size`` [N m] held-out torque error, ``depends_on`` variables, ``resembles`` claims that are no
    finding, with the reason of each."""

    joint: str
    size: float
    depends_on: tuple[str, ...]
    resembles: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """``verdict``: missing, none or unknown; see ``interfaces``, diagnose --json."""

    verdict: str
    ranked: tuple[Ranked, ...]
    rivals: tuple[tuple[str, ...], ...]
    depends_on: tuple[str, ...]
    not_identifiable: tuple[Blind, ...]
    next_experiment: str | None
    excess: dict[str, float] = field(default_factory=dict)  # leftover variance over sensor noise, per joint
    friction_scatter: dict[str, float] = field(default_factory=dict)  # from trial to trial, relative
    trials: int = 0
    rows: int = 0
    claims: tuple[Ranked, ...] = ()  # what the evidence speaks for, also where more is missing than it explains
    notes: tuple[str, ...] = ()  # on what the recordings were measured against
    changed: tuple[Change, ...] = ()  # since identification, also beside what is missing
    taken_out: tuple[Mapping[str, Any], ...] = ()  # by identification, before anything was asked: see `Nominal.taken_out`
    alternatives: tuple[Ranked, ...] = ()  # of ``ranked`` those that are the plainest of several that look alike here
    unexplained: tuple[Unexplained, ...] = ()  # what is left of each joint's torque, where that is more than the sensors' noise
    structure: Structure | None = None  # one that gives, which may be the unknown cause

    def _repr_html_(self) -> str:
        rows = [(r.label, r.error_before, r.error_after, r.unit, r.says) for r in self.ranked]
        return shown(
            f"Diagnosis: {self.verdict}",
            self.next_experiment or "",
            ("effect", "error before", "after", "unit", "what it is"),
            rows,
        )

    def as_json(self) -> dict[str, Any]:
        """Plain data of the answer's fixed shape."""
        return {
            "verdict": self.verdict,
            "ranked_effects": [
                {
                    "effect": r.effect,
                    "joint": None if not r.joints else r.joints[0] if len(r.joints) == 1 else list(r.joints),
                    "score": round(r.score, 2),
                    "error_before": r.error_before,
                    "error_after": r.error_after,
                    "unit": r.unit,
                    "parameters": {k: {"value": p.value, "unit": p.unit, "std": p.std} for k, p in r.parameters.items()},
                    "look_at": r.look_at,
                    "says": r.says,
                    "in_model": r.in_model,
                    "together": list(r.together),
                }
                | ({} if r.change is None else {"change": {k: getattr(r.change, k) for k in ("before", "after", "std", "since")}})
                for r in self.ranked
            ],
            "rivals": [list(group) for group in (*(r.one_of for r in self.alternatives), *self.rivals)],
            "alternatives": [
                {
                    "one_of": list(r.one_of),
                    "why": r.alike,
                    "error_before": r.error_before,
                    "error_after": r.error_after,
                    "unit": r.unit,
                }
                for r in self.alternatives
            ],
            "depends_on": list(self.depends_on),
            "not_identifiable": [
                {"effect": b.effect, "joints": list(b.joints), "why": b.why, "experiment": b.experiment}
                for b in self.not_identifiable
            ],
            "unexplained": [
                {
                    "joint": u.joint,
                    "size": u.size,
                    "unit": "N m",
                    "depends_on": list(u.depends_on),
                    "resembles": list(u.resembles),
                }
                for u in self.unexplained
            ],
            "structure": None if self.structure is None else self.structure.as_json(),
            "changed": [c.says for c in self.changed],
            "taken_out": [dict(x) for x in self.taken_out],
            "next_experiment": self.next_experiment,
            "notes": list(self.notes),
            "excess": self.excess,
            "friction_scatter": self.friction_scatter,
            "threshold": limit.THRESHOLD,
            "trials": self.trials,
            "rows": self.rows,
        }
