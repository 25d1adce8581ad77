"""What a physical effect is: one law, its parameters with units and ranges, and the story around it.

A law gives the *columns* of its effect: the joint torque is ``sum(theta_k * column_k)``, linear in the terms' values
``theta`` and free in the shapes.  It is written once over `stopset.ring` numbers, so the same lines give the torque
(arrays), the regressor (the columns themselves), a bound (intervals), a Taylor form, and C text for the FMU.

Sign: ``rigid(q, dq, ddq) + J_rotor ddq + friction + effects = tau``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

Number = Any  # a float, an array, an Interval, a Taylor form or C text: whatever stopset.ring computes with
Entry = Literal["compensation", "inertia", "viscous", "input_gain", "input_delay", "state"]


@dataclass(frozen=True, slots=True)
class Term:
    """A parameter the torque is linear in. ``lo``, ``hi``: the admissible range, in ``unit``."""

    symbol: str
    unit: str
    means: str
    lo: float = float("-inf")
    hi: float = float("inf")


@dataclass(frozen=True, slots=True)
class Shape:
    """A parameter the law is nonlinear in; ``grid`` are start values for the search, refined between ``lo`` and ``hi``."""

    symbol: str
    unit: str
    means: str
    lo: float
    hi: float
    grid: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Signals:
    """What a law may look at, for one joint, sample by sample (any `stopset.ring` numbers, all of one shape).

    ``q, dq, ddq`` [rad, rad/s, rad/s^2]; ``load``: modelled rigid-body gravity torque of the joint [N m]; ``tau``: modelled torque
    of the joint without this effect [N m]; ``temp``: temperature above the reference [K]; ``warm``: place in the campaign
    (0 first trial of the session, 1 last) where no temperature is recorded; ``t`` [s]; ``memory``: states of the effect.
    """

    q: Number
    dq: Number
    ddq: Number = 0.0
    load: Number = 0.0
    tau: Number = 0.0
    dtau: Number = 0.0
    temp: Number = 0.0
    warm: Number = 0.0
    t: Number = 0.0
    memory: tuple[Number, ...] = ()


Law = Callable[[Signals, Mapping[str, Number]], Sequence[Number]]


@dataclass(frozen=True, slots=True)
class Effect:
    """A physical effect at one joint (``scope='joint'``) or of the whole arm (``scope='arm'``).

    ``says``: one plain sentence; ``look_at``: the variable its residual depends on, e.g. ``"temp * dq"``;
    ``looks_like``: names of effects it is easily taken for; ``tell_apart``: the experiment that separates them;
    ``enters``: where it goes in the reachset model; ``law``: see the module; ``flow``: derivative of the memory
    variables per second; ``source``: key in docs/references.bib.
    """

    name: str
    says: str
    look_at: str
    terms: tuple[Term, ...]
    law: Law | None
    enters: Entry
    source: str
    shapes: tuple[Shape, ...] = ()
    looks_like: tuple[str, ...] = ()
    tell_apart: str = ""
    scope: Literal["joint", "arm"] = "joint"
    needs: tuple[str, ...] = ()  # signals beyond motion and torque, e.g. "temp"
    states: tuple[Term, ...] = ()
    flow: Law | None = None


@dataclass(frozen=True, slots=True)
class Fitted:
    """An effect with numbers: terms' values and covariance, shapes' values; ``joint`` is None for the whole arm."""

    effect: str
    joint: str | None
    values: Mapping[str, float]
    std: Mapping[str, float]

    @property
    def label(self) -> str:
        return self.effect if self.joint is None else f"{self.effect}:{self.joint}"
