"""What stop bounds rest on, and why there is none, in sentences."""

from __future__ import annotations

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
BY_ENERGY = (
    "fall-back: one tube of joint speeds could not be closed, the kinetic energy bounds part of the stop; proved, but looser"
)


def ramp_assumptions(ramp: Ramp, category: Category) -> tuple[str, ...]:
    """What the bound of a ramp rests on."""
    unit = "s" if ramp.kind == "time" else "rad/s^2"
    out = [
        f"ramp ({ramp.source}): fixed {ramp.kind} {ramp.value.lo.min():.4g} to {ramp.value.hi.max():.4g} {unit}, starts "
        f"{1e3 * ramp.control.lo.min():.3g} to {1e3 * ramp.control.hi.max():.3g} ms after the request, tracked within "
        f"{ramp.q_error.max():.3g} rad and {ramp.dq_error.max():.3g} rad/s"
    ]
    if any(ramp.pace):
        lo, hi = ramp.pace
        out.append(f"at the request the programmed motion changes its speeds by {lo:.2g} to {hi:.2g} of themselves per second")
    else:
        out.append("at the request the programmed motion keeps its speeds")
    if category == "1":
        out.append("the ramp works, and the brakes have engaged before power is taken")
    if category == "1 guaranteed":
        out.append(_failure(ramp))
    if category == "2":
        out.append(f"the ramp works and the drives hold within {ramp.window:g} rad")
    return tuple(out)


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
    return (
        f"the ramp fails, {who}: 0 to {ramp.share:g} of the speed at the request, in its direction, until power is taken {when}"
    )


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
