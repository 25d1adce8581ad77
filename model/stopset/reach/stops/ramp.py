"""STOP 1 and STOP 2: a ramp that works (nominal), and what remains if it does not (guaranteed).

Nominal: each joint's speed falls from ``v0`` to rest in a fixed time, or with a fixed deceleration, after the control's
delay, within tracking errors.  Guaranteed: the ramp fails, and power is taken after a fixed time (SS1-t) or when the
monitored ramp is left (SS1-r); see `failed`.

Source: IEC 61800-5-2 for SS1-t, SS1-r, SS2; stop notes of the project.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from stopset.artifact import Model
from stopset.effects.bound import parameter
from stopset.errors import NotCovered
from stopset.reach.stops.payload import effect_of
from stopset.reach.stops.tube import Tube
from stopset.sets import Box
from stopset.types import Array

KEY = "stop1_ramp"  # in a model's provenance
KNOTS = 60
STILL = 0.01  # [rad/s] a controlled joint that stays slower than this is at rest
LONGEST = 60.0  # [s] no ramp and no time until power-off is longer
STEEPEST, QUICKEST = 1e4, 10.0  # [rad/s^2] of a ramp; share of its speed that a failed drive can reach


@dataclass(frozen=True, slots=True)
class Ramp:
    """How the drives brake on request. ``kind`` 'time': ``value`` [s] from the speed to rest; 'deceleration': [rad/s^2].

    ``value``, ``control``: (n,) boxes, the latter the delay [s] from request to the ramp's start; ``q_error`` [rad],
    ``dq_error`` [rad/s]: (n,) tracking errors. ``off_after`` [s]: power is taken this long after the request whatever
    happens (SS1-t); ``monitored``: whether the speed is compared with the ramp (SS1-r), and a violation found within
    ``reaction`` [s] at ``tolerance`` (share of the speed at the request) above it. ``window`` [rad] and ``creep`` [rad/s]:
    standstill window of STOP 2 and the speed at which leaving it is noticed. ``share``: largest speed a failed ramp can
    reach, as a share of the speed at the request (above 1: drives may accelerate); ``together``: whether all joints then
    keep the same share, as when the whole controller fails, else each its own. ``pace`` (lo, hi) [1/s]: the ramp slows
    down the programmed motion, which may itself be changing its speeds at the request, by this share per second of motion.
    ``standstill`` (n,) [rad/s]: a joint that stays slower is at rest, by default `STILL`; ``settle`` [s]: how long after the
    ramp's end the last joint comes to rest at the latest, None where nothing says it. ``fastest`` (n,) [rad/s]: the largest speeds from
    which the stops were recorded that the tracking errors are those of, None where none were, or an older model does not say.
    """

    kind: Literal["time", "deceleration"]
    value: Box
    control: Box
    q_error: Array
    dq_error: Array
    off_after: float | None = None
    monitored: bool = False
    reaction: float = 0.024
    tolerance: float = 0.1
    share: float = 1.0
    together: bool = False
    window: float = 0.01
    creep: float = 0.05
    pace: tuple[float, float] = (0.0, 0.0)
    source: str = "stated"
    notes: tuple[str, ...] = field(default=())
    settle: float | None = None
    standstill: Array | None = None
    fastest: Array | None = None

    @property
    def band(self) -> Array:
        """(n,) [rad/s] of standstill."""
        return np.full(self.value.dim, STILL) if self.standstill is None else self.standstill

    @property
    def after(self) -> float | None:
        """[s] from the ramp's end until every joint is at rest for good; None where that is not known."""
        return 0.0 if bool(np.all(self.dq_error <= self.band)) else self.settle

    def as_dict(self) -> dict[str, Any]:
        """For the model file's provenance, under `KEY`."""
        return {
            "kind": self.kind, "value": [self.value.lo.tolist(), self.value.hi.tolist()],
            "control": [self.control.lo.tolist(), self.control.hi.tolist()], "q_error": self.q_error.tolist(),
            "dq_error": self.dq_error.tolist(), "off_after": self.off_after, "monitored": self.monitored,
            "reaction": self.reaction, "tolerance": self.tolerance, "share": self.share, "together": self.together,
            "window": self.window, "creep": self.creep, "pace": list(self.pace), "source": self.source, "notes": list(self.notes),
            "settle": self.settle, "standstill": None if self.standstill is None else self.standstill.tolist(),
            "fastest": None if self.fastest is None else self.fastest.tolist(),
        }  # fmt: skip

    @classmethod
    def from_dict(cls, d: Mapping[str, Any]) -> Ramp:
        """From the model file's provenance."""
        rest = {k: d[k] for k in ("off_after", "monitored", "reaction", "tolerance", "share", "window", "creep", "source")}
        rest["together"] = d.get("together", False)
        rest["pace"] = tuple(d.get("pace", (0.0, 0.0)))
        rest["settle"] = d.get("settle")  # an older file does not say when the arm rests
        rest |= {k: None if d.get(k) is None else np.array(d[k], float) for k in ("standstill", "fastest")}
        return cls(
            kind=d["kind"], value=Box.of(*d["value"]), control=Box.of(*d["control"]), q_error=np.array(d["q_error"], float),
            dq_error=np.array(d["dq_error"], float), notes=tuple(d["notes"]), **rest,
        )  # fmt: skip

    @classmethod
    def stated(cls, n: int, *, time: float | None = None, deceleration: float | None = None, control: float = 0.024) -> Ramp:
        """A ramp as a data sheet states it: exactly one of ``time`` [s] and ``deceleration`` [rad/s^2], no tracking error.

        What happens if it fails is said with `failing`. Raises `NotCovered` for numbers that are no ramp.
        """
        given, most = (time, LONGEST) if time is not None else (deceleration, STEEPEST)
        if (time is None) == (deceleration is None) or given is None or not 0.0 < given <= most:
            raise NotCovered(
                f"a ramp of time {time} s and deceleration {deceleration} rad/s^2; expected exactly one positive number, at most "
                f"{LONGEST:g} s or {STEEPEST:g} rad/s^2: state the drives' ramp"
            )
        if not 0.0 <= control <= LONGEST:
            raise NotCovered(
                f"a start of the ramp {control:g} s after the request; expected 0 to {LONGEST:g} s: state the drives' delay"
            )
        zero = np.zeros(n)
        return cls(
            "time" if time is not None else "deceleration", Box.point(np.full(n, given)),
            Box.of(zero, np.full(n, control)), zero, zero,
        )  # fmt: skip

    def failing(
        self, off_after: float | None = None, *, monitored: bool = False, share: float = 1.0, together: bool = False
    ) -> Ramp:
        """The same ramp with what happens if it fails, see `Ramp`; what is not given stays as it was, but for ``share``.

        Raises `NotCovered` for no such numbers.
        """
        if off_after is not None and not 0.0 <= off_after <= LONGEST:
            raise NotCovered(
                f"an SS1-t time of {off_after:g} s; expected 0 to {LONGEST:g} s, not negative: state when power is taken"
            )
        if not 0.0 <= share <= QUICKEST:
            raise NotCovered(
                f"a failed ramp that reaches {100 * share:g} % of the speed at the request; expected 0 to {100 * QUICKEST:g} %, not "
                "negative: state what the drives can reach"
            )
        return replace(
            self, off_after=self.off_after if off_after is None else off_after, monitored=self.monitored or monitored,
            share=share, together=self.together or together,
        )  # fmt: skip


def ramp_of(model: Model) -> Ramp | None:
    """The ramp identified from stop1 recordings, if the model holds one."""
    stored = model.provenance.get(KEY)
    return Ramp.from_dict(stored) if isinstance(stored, Mapping) else None


def ramp_tube(ramp: Ramp, v_lo: Array, v_hi: Array) -> Tube:
    """Displacement and speed bounds of the ramp from speeds ``[v_lo, v_hi]``, as knots that are monotone in between."""
    n = v_lo.shape[0]
    fast = np.maximum(np.abs(v_lo), np.abs(v_hi))
    lasts = ramp.value.hi if ramp.kind == "time" else fast / ramp.value.lo
    end = float(np.max(ramp.control.hi + lasts))
    # a motion that gets faster does so until the ramp begins: that moment is a knot
    t = np.linspace(0.0, end, KNOTS + 1)
    t = np.sort(np.r_[t, np.setdiff1d(ramp.control.hi, t)])
    curves = [_curve(ramp, v, t, slow=slow) for v in (v_lo, v_hi) for slow in (True, False)]
    run, braked = (np.array([c[k] for c in curves]) for k in range(2))
    d = np.array([v * _moved(x, pace) for x, v in zip(run, (v_lo, v_lo, v_hi, v_hi), strict=True) for pace in ramp.pace])
    least, most = run.min(axis=0), run.max(axis=0)
    # between a speed one way and one the other way lies one that is no sooner to brake than at rest
    if ramp.kind == "deceleration":
        least = np.where((v_lo < 0.0) & (v_hi > 0.0), np.minimum(t[:, None], ramp.control.lo), least)
    # what a ramp leaves of a speed and what a pace makes of it: a late ramp with a motion that gets slower has less than any of both ends
    share = np.maximum(np.array([1.0 + pace * x for pace in ramp.pace for x in (least, most)]), 0.0)
    v = np.array([a * b for a in (braked.min(axis=0), braked.max(axis=0)) for b in (share.min(axis=0), share.max(axis=0))])
    # tracking errors exist from the request on; the first knot is exact
    after = (t > 0)[:, None]
    # between knots a speed that bends leaves its chord by an eighth of its second derivative times the step squared
    bend = fast * max(map(abs, ramp.pace)) * 3.0 / np.maximum(_shortest(ramp, fast), 1e-3) * (end / KNOTS) ** 2 / 8.0
    d_lo, d_hi = d.min(axis=0) - after * ramp.q_error, d.max(axis=0) + after * ramp.q_error
    w_lo, w_hi = v.min(axis=0) - ramp.dq_error - bend, v.max(axis=0) + ramp.dq_error + bend
    nothing = np.zeros((len(t) - 1, n))
    return Tube(
        0, t, d_lo, d_hi, w_lo, w_hi, np.minimum(w_lo[:-1], w_lo[1:]), np.maximum(w_hi[:-1], w_hi[1:]),
        nothing, nothing, nothing, nothing, np.full(n, np.nan), energetic=False, travel_left=np.full((len(t), n), np.inf),
        energy=np.full(len(t) - 1, np.inf),
    )  # fmt: skip


def _shortest(ramp: Ramp, fast: Array) -> Array:
    return ramp.value.lo if ramp.kind == "time" else fast / ramp.value.hi


def _curve(ramp: Ramp, v: Array, t: Array, *, slow: bool) -> tuple[Array, Array]:
    """Of one corner, latest start and gentlest ramp or the opposite, (T, n) each: time of the programmed motion that was run through [s], and
    what is left of the speed ``v`` (n,) [rad/s] without any pace."""
    begin = ramp.control.hi if slow else ramp.control.lo
    gentle = ramp.value.hi if slow == (ramp.kind == "time") else ramp.value.lo
    lasts = gentle if ramp.kind == "time" else np.abs(v) / gentle
    s = np.clip((t[:, None] - begin) / np.maximum(lasts, 1e-12), 0.0, 1.0)
    return np.minimum(t[:, None], begin) + lasts * (s - 0.5 * s * s), v * (1.0 - s)


def _moved(path_time: Array, pace: float) -> Array:
    """Displacement per speed [s] of a motion that gets faster by ``pace`` [1/s], or slower until it rests."""
    here = path_time + 0.5 * pace * path_time * path_time
    return np.where(1.0 + pace * path_time > 0.0, here, -0.5 / min(pace, -1e-12))


def ramp_time(ramp: Ramp, v_lo: Array, v_hi: Array) -> Array | None:
    """(n,) [s] from the request until each joint is at rest for good, slower than the ramp's `Ramp.band`; None if nothing says."""
    fast = np.maximum(np.abs(v_lo), np.abs(v_hi))
    if ramp.after is None:
        return None
    return ramp.control.hi + (ramp.value.hi if ramp.kind == "time" else fast / ramp.value.lo) + ramp.after


def of_the_arm(ramp: Ramp, shares: Array) -> Ramp:
    """The ramp with tracking errors of the arm itself, whose joints turn by ``shares`` (n,) more or less than they read."""
    return replace(ramp, q_error=ramp.q_error * (1.0 + shares), dq_error=ramp.dq_error * (1.0 + shares))


def drive_limit(model: Model) -> Array:
    """(n,) [N m] what a drive surely can give. One of which an effect says that it gives less than it tells, tells its limit no better."""
    out = np.array(model.robot.torque_limit, float)
    for f in model.effects:
        effect = effect_of(f)
        if effect.enters == "input_gain":
            most = 1.0 + sum(float(parameter([f], t).hi[0]) for t in effect.terms)
            for i in effect.acts_on(f.joint, model.joints):
                out[i] /= max(most, 1.0)
    return out


NEVER = 1e300  # [N m] of a gear whose load makes no friction


def gear_limit(model: Model, gear: Array) -> Array:
    """(n,) [N m] what links and rotors may ask of a drive in a ramp for its gear's load: friction that grows with that is known up to ``gear`` (n,)
    [N m]. A drive stronger than brakes and gravity could load it more, and then has less left beside that friction than was counted."""
    out = np.full(model.n, NEVER)
    for f in model.effects:
        effect = effect_of(f)
        if effect.role == "friction" and "load" in effect.needs:
            at = list(effect.acts_on(f.joint, model.joints))
            out[at] = gear[at]
    return out


def infeasible(model: Model, asked: Array, extra: Array, most: Array) -> str | None:
    """A sentence if a drive has not the torque (n,) [N m] that links and rotors have ``asked`` of it and what comes on top, ``extra`` (n,); or if
    that loads its gear by more than the ``most`` (n,) for which friction is known. None if all have."""
    over = np.flatnonzero(asked > most)
    if len(over):
        return (
            f"the ramp asks {asked[over[0]]:.3g} N m of the gear of {model.joints[over[0]]}, whose friction grows with its load and is known up to "
            f"{most[over[0]]:.3g} N m: not credible; use a gentler ramp or the guaranteed stop"
        )
    limit, asked = drive_limit(model), asked + extra
    worst = int(np.argmin(limit - asked))
    if asked[worst] <= limit[worst]:
        return None
    return (
        f"the ramp asks {asked[worst]:.3g} N m of {model.joints[worst]}, its drive has {limit[worst]:.3g} N m: not credible; use a "
        f"gentler ramp or the guaranteed stop"
    )
