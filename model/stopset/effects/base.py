"""What a physical effect is: one law, its parameters with units and ranges, and the story around it.

A law gives the *columns* of its effect: the joint torque is ``sum(theta_k * column_k)``, linear in the terms' values
``theta`` and free in the shapes.  It is written once over `stopset.ring` numbers, so the same lines give the torque
(arrays), the regressor (the columns themselves), a bound (intervals), a Taylor form, and the steps that the compiled core plays.

Sign: ``rigid(q, dq, ddq) + J_rotor ddq + friction + effects = tau``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, Literal

from stopset.errors import EffectError
from stopset.ring import sign

Number = Any  # a float, an array, an Interval, a Taylor form or a tape: whatever stopset.ring computes with
Entry = Literal["compensation", "inertia", "damping", "input_gain", "input_delay", "state"]
Role = Literal["friction", "torque", "arm or drive", "plant", "reading", "input", "swing", "play"]
Acting = Literal["", "later", "through a lag"]
Part = Literal["", "dry friction", "damping", "constant torque", "torque scale", "load"]
# roles that add a motion which a rigid arm does not have, and why no stop is bounded with them
LOOSE = {"swing": "it swings in a way that a rigid arm does not have", "play": "its link is loose within a gap"}
REFERENCE_TEMPERATURE = 30.0  # [degC]; "temp" is counted from here, so that base friction means friction at 30 degC


@dataclass(frozen=True, slots=True)
class Term:
    """A parameter the torque is linear in, or a state. ``lo``, ``hi``: the admissible range, in ``unit``.

    ``typical``: its usual size where that is known beforehand; else the diagnosis expects a third of the joint's friction.
    Of a state: its value where a recording begins; else the middle of its range.
    ``share``: how large its part of the law's torque is expected to be, of the usual size.
    """

    symbol: str
    unit: str
    means: str
    lo: float = float("-inf")
    hi: float = float("inf")
    typical: float = float("nan")
    share: float = 1.0


@dataclass(frozen=True, slots=True)
class Shape:
    """A parameter the law is nonlinear in; ``grid`` are start values for the search, refined between ``lo`` and
    ``hi``."""

    symbol: str
    unit: str
    means: str
    lo: float
    hi: float
    grid: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Signals:
    """What a law may look at, for one joint, sample by sample (any `stopset.ring` numbers, all of one shape).

    Of the joint: ``q, dq, ddq`` [rad, rad/s, rad/s^2]; ``given_direction``: direction of motion, ``sign(dq)`` unless given (a
    simulator
    gives ``tanh(dq / w)``); ``temp``: temperature above `REFERENCE_TEMPERATURE` [K]; ``warm``: place in the campaign (0
    first trial of the session, 1 last), for where no temperature is recorded; ``t`` [s]; ``memory``: the effect's
    states.
    From the rigid-body model: ``load``: gravity torque [N m]; ``tau``: torque of the joint without this effect [N m];
    ``dtau``: its rate [N m/s]; ``link``: the links' part of ``tau`` [N m], without rotor and friction; ``tip``:
    derivatives of
    the joint torque by the last link's ten standard parameters; ``tilt``: by the gravity direction's two angles [N
    m/rad];
    ``stiff``: by the joint's own position [N m/rad]; ``inertia``: ``M_jj`` [kg m^2]; ``coriolis`` [N m].
    Of the partner of a pair: ``dq_other, ddq_other`` [rad/s, rad/s^2].
    """

    q: Number = 0.0
    dq: Number = 0.0
    ddq: Number = 0.0
    given_direction: Number = None
    load: Number = 0.0
    tau: Number = 0.0
    dtau: Number = 0.0
    link: Number = 0.0
    temp: Number = 0.0
    warm: Number = 0.0
    t: Number = 0.0
    memory: tuple[Number, ...] = ()
    tip: tuple[Number, ...] = (0.0,) * 10
    tilt: tuple[Number, ...] = (0.0, 0.0)
    stiff: Number = 0.0
    inertia: Number = 0.0
    coriolis: Number = 0.0
    dq_other: Number = 0.0
    ddq_other: Number = 0.0

    @property
    def direction(self) -> Number:
        """Direction of motion, -1 to 1."""
        return sign(self.dq) if self.given_direction is None else self.given_direction


Law = Callable[[Signals, Mapping[str, Number]], Sequence[Number]]
Reading = Callable[[Signals, Mapping[str, Number]], tuple[Sequence[Number], Sequence[Number]]]


@dataclass(frozen=True, slots=True)
class Effect:
    """A physical effect at one joint (``scope='joint'``), between two (``'pair'``) or of the whole arm (``'arm'``).

    ``says``: one plain sentence; ``look_at``: the variable its residual depends on, e.g. ``"temp * dq"``;
    ``looks_like``: names of effects it is easily taken for; ``distinguished_by``: the experiment that separates them;
    ``enters``: where it goes in the reachset model; ``law``: see the module; ``needs``: the fields of `Signals` the law
    reads; ``flow``: derivative of the states per second (same arguments as the law); ``source``: key in
    docs/references.bib; ``instead_of``: a signal it does without, so it is looked for only where that is not recorded.
    Effects with ``scope`` ``arm`` and ``pair`` give their columns for each joint they act on, with the same parameters.

    ``carried``: its terms are the ten standard parameters of a body that the last link carries, in their order;
    ``essential``: its first term is what makes it, and where that is not known it is another law;
    ``power``: of the speed, where the law is that alone: then the abstraction's damping may hold it.

    ``role``: how it acts on the arm in a stop, its drives off (`stopset.effects.bound`):
    ``friction``: rubs; all friction of a joint together never drives it, and its law is zero where the joint stands;
    ``torque``: acts whoever moves the joint, in any direction; what of it opposes the motion is found in the law;
    ``arm or drive``: like it, but may be the drive's own: it is counted with and without;
    ``plant``: is in the rigid body and the rotors of the model already; ``input``: is in the reading of the motor's torque, and
    no motor gives any; ``reading``: the encoder's, ``reading`` gives each term's columns of true minus recorded position and
    of true minus recorded speed over speed; ``swing``: adds a motion that a rigid arm does not have: no stop is bounded;
    ``play``: its link is loose within a gap, the first term: likewise, and only an angle that is read behind the gear shows it.

    What others ask of it, so that none of them knows its name.  ``part``: the number of a plain arm that it changes, at most one
    effect each; ``usual``: its place among the laws that identification tries at every joint unasked, 0: not among them;
    ``adjacent``: of a pair, that its joints follow each other; ``periodic``: over the joint's turn, its shape the cycles per turn;
    ``absorbed``: a free rigid body takes up what it does, so held-out errors do not show it; ``within_friction``: its first term is
    a part of its joint's dry friction; ``effort``: the kind of recorded torque it is part of, where it is of one alone;
    ``simulated``: what of the simulated arm it is seen in (`stopset.simulation.hidden`);
    ``refines``: plainer laws without shapes that it is a finer form of: one that explains as good as all is named instead;
    ``acting``: of an effect that enters as a delay, how the torque that acted follows from the recorded one, its first term [s] given:
    read so much later, or through a lag of first order with that time constant;
    ``loaded``: it is there to carry weight, so it is looked for only where gravity loads the joint.
    """

    name: str
    says: str
    look_at: str
    terms: tuple[Term, ...]
    law: Law
    enters: Entry
    source: str
    needs: tuple[str, ...]
    shapes: tuple[Shape, ...] = ()
    looks_like: tuple[str, ...] = ()
    distinguished_by: str = ""
    scope: Literal["joint", "pair", "arm"] = "joint"
    states: tuple[Term, ...] = ()
    flow: Law | None = None
    base: bool = False  # part of every model from the start: friction that each drive has
    instead_of: str = ""
    role: Role = "torque"
    reading: Reading | None = None
    power: int = 0
    carried: bool = False
    essential: bool = False
    part: Part = ""
    usual: int = 0
    adjacent: bool = False
    periodic: bool = False
    absorbed: bool = False
    within_friction: bool = False
    effort: str = ""
    simulated: str = ""
    refines: tuple[str, ...] = ()
    acting: Acting = ""
    loaded: bool = False

    @property
    def moment_arms(self) -> bool:
        """Whether it carries weight by a place and levers of its own."""
        return self.loaded and bool(self.shapes)

    def compensated(self, degree: int = 1) -> bool:
        """Whether its torque is taken off the measured one, beside an abstraction whose damping has ``degree`` terms.

        Else it is part of the abstraction (its damping, its inertia) or of the recorded torque's scale; or it stays in the
        torque set U, as no torque of the measured state can take it off: a link's swing, a torque that is reported late.
        """
        if self.enters in ("damping", "inertia", "input_gain", "input_delay") or self.role in LOOSE:
            return False
        return not 0 < self.power <= degree

    def acts_on(self, joint: str | None, joints: Sequence[str]) -> tuple[int, ...]:
        """The places in ``joints`` it acts on when fitted at ``joint`` (`Fitted.joint`); a pair named by one joint alone
        is that joint and the next.

        Raises `EffectError` for a joint that is not there.
        """
        names = joint.split("+") if joint else []
        unknown = [name for name in names if name not in joints]
        if unknown or not (names or self.scope == "arm"):
            raise EffectError(f"effect {self.name} at {joint}; expected one of {', '.join(joints)}")
        if self.scope == "arm":
            return tuple(range(len(joints)))
        i = joints.index(names[0])
        if self.scope == "joint":
            return (i,)
        return i, joints.index(names[1]) if len(names) > 1 else min(i + 1, len(joints) - 1)

    def columns(self, s: Signals, shapes: Mapping[str, Number] | None = None) -> tuple[Number, ...]:
        """One column per term, for the signals of one joint; ``shapes`` default to the middle of each grid.

        Raises `EffectError` if the law does not give one column per term.
        """
        out = tuple(self.law(s, self.shape_values(shapes) if self.shapes else {}))
        if len(out) != len(self.terms):
            raise EffectError(f"effect {self.name}: its law gives {len(out)} columns for {len(self.terms)} terms; mend it")
        return out

    def torque(self, s: Signals, values: Mapping[str, Number]) -> Number:
        """The effect's joint torque [N m] for the values of all its terms and shapes."""
        symbols = [t.symbol for t in self.terms] + [p.symbol for p in self.shapes]
        missing = [symbol for symbol in symbols if symbol not in values]
        if missing:
            raise EffectError(f"effect {self.name}: no value for {', '.join(missing)}; expected one for every parameter")
        columns = self.columns(s, values)
        total = columns[0] * values[self.terms[0].symbol]
        for term, column in zip(self.terms[1:], columns[1:], strict=True):
            total = total + column * values[term.symbol]
        return total

    def rates(self, s: Signals, values: Mapping[str, Number]) -> tuple[Number, ...]:
        """Derivatives of the states [1/s times their units]; ``s.memory`` holds the states."""
        return tuple(self.flow(s, self.shape_values(values))) if self.flow else ()

    @property
    def at_start(self) -> tuple[float, ...]:
        """The states where a recording begins and nothing is known of what came before."""
        return tuple(x.typical if isfinite(x.typical) else 0.5 * (x.lo + x.hi) for x in self.states)

    def shape_values(self, values: Mapping[str, Number] | None) -> dict[str, Number]:
        """The shapes' values out of ``values``, the middle of the grid where it says nothing."""
        given = values or {}
        return {p.symbol: given.get(p.symbol, p.grid[len(p.grid) // 2]) for p in self.shapes}


@dataclass(frozen=True, slots=True)
class Fitted:
    """An effect with numbers: values of terms and shapes, standard deviations; ``joint`` is None for the whole arm, and
    ``"a+b"`` for the pair of joints a and b."""

    effect: str
    joint: str | None
    values: Mapping[str, float]
    std: Mapping[str, float] = field(default_factory=dict)

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints named: none, one or two."""
        return tuple(self.joint.split("+")) if self.joint else ()

    @property
    def label(self) -> str:
        return self.effect if self.joint is None else f"{self.effect}:{self.joint}"
