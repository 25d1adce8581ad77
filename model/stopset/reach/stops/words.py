"""What stop bounds rest on, and why there is none, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stopset.reach.stops.ramp import Ramp
from stopset.reach.stops.types import Category

NO_BRAKES = (
    "no stop provable: the model holds no brake torque, delay and rise for every joint; give them in robot.json or identify "
    "them from stop0 recordings"
)
NO_RAMP = (
    "no ramp known: the model holds none from stop1 recordings; state its time (--ramp-time) or deceleration "
    "(--ramp-deceleration)"
)
NO_POWER_OFF = (
    "no stop provable: nothing says when power is taken if the ramp fails; state the SS1-t time (--off-after) or a monitored "
    "ramp (--monitored)"
)
NO_REST = (
    "no stop provable: the model's ramp is followed only within a speed error that is larger than a joint at rest may have, and "
    "nothing says when that ends; identify again from stop1 recordings, or state the ramp (--ramp-time, --ramp-deceleration)"
)
REST = "at rest means speed zero for good, with the brakes closed and holding"
UNSEEN = "choose a state that the recordings hold, record it, or accept a marked extrapolation (--extrapolate-state)"
BY_ENERGY = "the kinetic energy bounds part of the stop, no less a proof: tubes of joint speeds alone did not close, or let the arm go farther"


def out_of_budget(loose: int, boxes: int, tried: int) -> str:
    """That the coarser proof stands in for the finer one in a part of a failed ramp's stop."""
    return (
        f"fall-back: {loose} of {boxes} boxes of a failed ramp's states were not closed by the {tried} tubes of joint speeds that there "
        "is a budget for, the kinetic energy bounds these; proved, but looser"
    )


def end_stops(joints: Sequence[str]) -> str:
    """That a stop may lead ``joints`` to the ends of their range."""
    return f"{', '.join(joints)} can come to an end stop on the way: what the blow does to times and other joints is not covered"


def ramp_assumptions(ramp: Ramp, category: Category) -> tuple[str, ...]:
    """What the bound of a ramp rests on."""
    unit = "s" if ramp.kind == "time" else "rad/s^2"
    recorded = "" if ramp.fastest is None else f", from whatever speed: recorded from at most {_list(ramp.fastest)} rad/s"
    out = [
        f"ramp ({ramp.source}): fixed {ramp.kind} {ramp.value.lo.min():.4g} to {ramp.value.hi.max():.4g} {unit}, starts "
        f"{1e3 * ramp.control.lo.min():.3g} to {1e3 * ramp.control.hi.max():.3g} ms after the request, tracked within "
        f"{ramp.q_error.max():.3g} rad and {ramp.dq_error.max():.3g} rad/s{recorded}"
    ]
    if any(ramp.pace):
        lo, hi = ramp.pace
        out.append(f"at the request the programmed motion changes its speeds by {lo:.2g} to {hi:.2g} of themselves per second")
    else:
        out.append("at the request the programmed motion keeps its speeds")
    if category == "1 guaranteed":
        return (*out, _failure(ramp), REST)
    if ramp.after is not None:
        out.append(
            f"at rest means every joint slower for good than its standstill speed of {_list(ramp.band)} rad/s, at the latest "
            f"{1e3 * ramp.after:.4g} ms after its own ramp's end"
        )
    if category == "1":
        out.append("the ramp works, and the brakes have engaged before power is taken")
    else:
        out.append(f"the ramp works and the drives hold within {ramp.window:g} rad")
    return tuple(out)


def early_cut(ramp: Ramp, time: float) -> str | None:
    """Why there is no stop by a ramp that works where SS1-t takes the power before it has brought the arm to rest at ``time`` [s]."""
    if ramp.off_after is None or ramp.off_after >= time:
        return None
    return (
        f"no stop provable by the ramp alone: power is taken {ramp.off_after:g} s after the request, before the {time:.3g} s until it has "
        "brought the arm to rest are over; count with the guaranteed stop, or state a later time (--off-after)"
    )


def _list(x: np.ndarray) -> str:
    return f"{x.max():.3g}" if np.ptp(x) < 1e-12 else "[" + ", ".join(f"{a:.3g}" for a in x) + "]"


def _failure(ramp: Ramp) -> str:
    who = "all joints alike" if ramp.together else "each joint on its own"
    if not ramp.monitored and ramp.off_after is None:
        when = "at a time that nothing states"
    elif not ramp.monitored:
        when = f"{ramp.off_after} s after the request (SS1-t)"
    else:
        rising = "no drive accelerates meanwhile" if ramp.share <= 1.0 else "drives may accelerate up to that share meanwhile"
        when = (
            f"{1e3 * ramp.reaction:.3g} ms after a joint is {ramp.tolerance:.0%} of its speed above the monitored ramp, at the "
            f"latest when that has ended (SS1-r); {rising}"
        )
    speed = "the programmed motion's speed" if any(ramp.pace) else "the speed at the request"
    return f"the ramp fails, {who}: 0 to {ramp.share:g} of {speed}, in its direction, until power is taken {when}"


def no_certificate(joints: tuple[str, ...], margin: np.ndarray, reach: float) -> str:
    """Why there is no number, and what to count with instead; ``margin``: (n,) holding margins [N m], ``reach`` [m]."""
    worst = int(np.argmin(margin))
    instead = f"count with the arm's whole reach of {reach:.3g} m"
    if margin[worst] <= 0:
        return (
            f"no stop provable: brake and friction of {joints[worst]} hold {-margin[worst]:.3g} N m less than "
            f"gravity and disturbance can ask; {instead}"
        )
    return (
        f"no stop provable: on the way gravity can come to ask more than brake and friction surely hold, though "
        f"{joints[worst]} has {margin[worst]:.3g} N m left at this pose; {instead}"
    )
