"""The identified model of one arm: everything the monitor and the FMU know, frozen.

Nothing in it is ever executed; `stopset.artifact.store` reads and writes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stopset.artifact.abstraction import Abstraction
from stopset.artifact.inputs import InputMap, input_map
from stopset.effects.base import Fitted
from stopset.notebook import shown
from stopset.robot import Robot
from stopset.sets import Box, Zonotope
from stopset.types import Array

# 2: torque sets as zonotopes; 3: brakes that lie apart in time, each less its own lag; 4: swift inputs; 5: the arm itself, not its URDF alone
SCHEMA_VERSION = 6


@dataclass(frozen=True, slots=True)
class ActiveBound:
    """What fixes one side of a set: the recording, time and state whose deviation touches it."""

    bound: str  # e.g. "U[arm_1_joint].hi"
    recording: str  # e.g. "open_loop suite 0 trial 19"
    start_s: float  # start of the window within the recording [s]
    age_s: float  # prediction age [s]
    state: str  # "q" or "dq" of which joint, e.g. "q_arm_1_joint"


@dataclass(frozen=True, slots=True)
class TemperatureBand:
    """Where the sets of a temperature band hold: the arm's warmth lies in ``[lo, hi]``.

    Warmth is the mean over the joints of ``(T - reference.lo) / (reference.hi - reference.lo)``; ``reference``: (n,)
    coldest and hottest reading of each joint [degC] when the bands were drawn (joints whose reading never moved are left
    out).
    """

    reference: Box
    lo: float
    hi: float

    def warmth(self, temp: Array) -> Array:
        """Warmth (N,) of temperatures (N, n) [degC]."""
        span = self.reference.width
        moving = span > 0
        return np.asarray(((temp - self.reference.lo)[:, moving] / span[moving]).mean(axis=1))

    def covers(self, temp: Array) -> NDArray[np.bool_]:
        """Row by row, whether temperatures (N, n) [degC] lie in the band; shape (N,)."""
        w = self.warmth(temp)
        return np.asarray((w >= self.lo) & (w <= self.hi))


@dataclass(frozen=True, slots=True)
class TorqueZonotope:
    """The torque set as ``centre + generators b``, every ``b`` in [-1, 1]: joints that are not all disturbed at once [N m].

    ``centre``: (n,), ``generators``: (n, m); ``directions``: (k, n) in the joints along which its tube encloses what was
    recorded, positions [rad] and speeds [rad/s], the joints themselves first.
    """

    centre: Array
    generators: Array
    directions: Array

    @property
    def set(self) -> Zonotope:
        return Zonotope(self.centre, self.generators)


@dataclass(frozen=True, slots=True)
class UncertaintySets:
    """Sets of one regime (powered, stop0, stop1), and how they were found (trap P18: the runtime must do the same).

    A measured state at age ``a`` after a measured state ``x_m`` lies in
    ``x*(a) + e^{Aa} X0 + hull of the U convolution + V``: ``X0, V``: (2n,) boxes over (q, dq); ``U``: (n,) box [N m].
    Where there is a ``zonotope``, that is the torque set, and ``U`` the box around it, for whoever takes boxes.
    """

    X0: Box
    U: Box
    V: Box
    dt: float  # [s] step of the prediction grid
    horizon: float  # [s] longest age covered
    conform: str = "all"  # or "position"
    windows: str = "sliding"  # or "start"
    margin: float = 1.0
    active: tuple[ActiveBound, ...] = ()
    temp: TemperatureBand | None = None  # None: at every temperature of the domain
    zonotope: TorqueZonotope | None = None


@dataclass(frozen=True, slots=True)
class Brakes:
    """Brakes per joint, intervals: dynamic torque [N m], delay from power-off to first torque [s], rise time [s].

    ``delay_spread`` [s]: the times at which the brakes of one stop engage, each less its joint's ``lag``, lie apart by no more than
    this, as when one power stage cuts all brakes; None where nothing is known of it. ``lag``: (n,) [s] by how much a joint's
    brake is always later; None: no brake is.
    """

    torque: Box
    delay: Box
    rise: Box
    source: str = "assumed"  # "assumed" | "data sheet" | "identified from ..."
    delay_spread: float | None = field(default=None, metadata={"key": "apart"})
    lag: Array | None = None


@dataclass(frozen=True, slots=True)
class Domain:
    """Where the model was seen to hold (trap P25): hulls over the identification data; outside the answer is "not covered"."""

    q: Box
    dq: Box
    u: Box
    temp: Box | None = None
    payload: tuple[float, float] = (0.0, 0.0)  # [kg] on top of what ``robot.pi`` holds

    def covers(self, q: Array, dq: Array, u: Array | None = None, temp: Array | None = None) -> NDArray[np.bool_]:
        """Row by row, whether samples (N, n) lie inside; shape (N,)."""
        ok = np.all((q >= self.q.lo) & (q <= self.q.hi) & (dq >= self.dq.lo) & (dq <= self.dq.hi), axis=1)
        if u is not None:
            ok &= np.all((u >= self.u.lo) & (u <= self.u.hi), axis=1)
        if temp is not None and self.temp is not None:
            ok &= np.all((temp >= self.temp.lo) & (temp <= self.temp.hi), axis=1)
        return np.asarray(ok, dtype=bool)


@dataclass(frozen=True, slots=True)
class Guarantee:
    """What held-out motions say (trap P8: the independent unit is the motion): Clopper-Pearson bound, and in words."""

    motions: int
    violated: int
    upper_bound: float
    confidence: float
    text: str
    calibration_motions: int = 0
    scenario_bound: float | None = None


@dataclass(frozen=True, slots=True)
class Revision:
    """One step in the model's history: what was added, and the figures before and after."""

    number: int
    added: str  # "" for the first identification, else an effect's label
    before: Mapping[str, float]
    after: Mapping[str, float]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Model:
    """A reachset-conformant model of one arm.

    ``robot`` carries the identified standard parameters and geometry: ``robot.pi`` holds what the arm carried when it was
    recorded, a payload found as an effect included, and ``domain.payload`` comes on top of it; so nobody adds an effect of
    role ``plant`` again; ``rotor``: (n,) identified reflected inertia [kg m^2]; ``inertia_std``: (n,) [kg m^2] standard error of the
    inertia about each axis, rotor and links, as far as no set holds it at a stop's decelerations (0 where brakes and sets are those of
    recorded stops), None in files of versions that did not say; not ``rotors_shown``: the torque is one without rotors, as behind the gears;
    ``effects``: friction and other effects with numbers; ``effort``: the kind of torque the data held
    (``compensated_torque``: it already is ``u`` of eq. (11)); ``sets`` by regime name.
    """

    robot: Robot
    rotor: Array
    effort: str
    effects: tuple[Fitted, ...]
    abstraction: Abstraction
    sets: Mapping[str, UncertaintySets]
    domain: Domain
    guarantee: Guarantee
    brakes: Brakes | None = None
    errors: Mapping[str, Any] = field(default_factory=dict)  # joint -> figures of the identification data
    provenance: Mapping[str, Any] = field(default_factory=dict)
    revisions: tuple[Revision, ...] = ()
    notes: tuple[str, ...] = ()
    sha256: str = ""
    inertia_std: Array | None = None
    rotors_shown: bool = True

    @property
    def joints(self) -> tuple[str, ...]:
        return self.robot.joints

    def _repr_html_(self) -> str:
        last = self.revisions[-1] if self.revisions else None
        head = ("joint", "U from [N m]", "to [N m]", "torque error [N m]", "floor [N m]")
        errors = [self.errors.get(j, {}) for j in self.joints]
        rows = [
            (j, lo, hi, e.get("torque_rmse"), e.get("torque_rmse_floor"))
            for j, lo, hi, e in zip(self.joints, self.powered.U.lo, self.powered.U.hi, errors, strict=True)
        ]
        what = f"revision {last.number}, {last.added or 'first identification'}" if last else "no revision"
        return shown(f"{self.robot.name}: {what}, SHA-256 {self.sha256[:16] or 'not saved'}", self.guarantee.text, head, rows)

    @property
    def n(self) -> int:
        return self.robot.n

    @property
    def input(self) -> InputMap:
        """Measured torque to the abstraction's input ``u``, the one way for everyone."""
        return input_map(self.robot, self.effects, self.effort, self.abstraction)

    @property
    def powered(self) -> UncertaintySets:
        return self.sets["powered"]
