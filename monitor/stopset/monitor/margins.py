"""How much is left: to joint limits, to planes the arm must not pass, to the stop time and distance that somebody wants.

A stop moves a point of the arm by no more than ``sum R_i s_i``: ``s_i`` is what joint i turns, ``R_i`` how far the point can get from
its axis meanwhile. Every point of a link's axis is at all times the same mixture of its ends, so a plane holds for the whole link
when it holds for both ends.

Source: stop notes of the project, section on Cartesian bounds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stopset.monitor.certificates import Numbers
from stopset.robot import Robot
from stopset.robot.rigid import link_frames
from stopset.types import Array

if TYPE_CHECKING:
    from stopset.monitor.config import StopLimits


def ends(robot: Robot, q: Array) -> tuple[Array, Array, Array]:
    """Of the pose ``q`` (n,): the ends of all links, which are the origins of joints 2 to n and the flange (n, 3) [m]; axes
    (n, 3) and their origins (n, 3), all in base coordinates."""
    R, p = link_frames(robot.chain, q[None])
    R, p = R[0], p[0]
    axes = np.einsum("nij,nj->ni", R, robot.chain.axis)
    return np.vstack([p[1:], p[-1] + R[-1] @ robot.tip]), axes, p


def travels(robot: Robot, q: Array, s: Array) -> tuple[Array, Array]:
    """Ends of the links (n, 3) [m], and how far each can get (n,) [m] while joint i turns by no more than ``s`` (n,) [rad]."""
    points, axes, origins = ends(robot, q)
    out = np.zeros(robot.n)
    for link, point in enumerate(points):  # the end of link number `link` is moved by joints 0 to link
        reach = 0.0
        for i in range(link, -1, -1):
            radius = float(np.linalg.norm(np.cross(axes[i], point - origins[i])))
            # by as much as the joints behind have moved the point already, it may be farther from this axis
            reach += (radius + reach) * s[i]
        out[link] = reach
    return points, out


def margins(robot: Robot, limits: StopLimits, q: Array, numbers: Numbers, slack: Array) -> dict[str, Any]:
    """What is left at the pose ``q`` (n,) if a stop with these bounds began now; negative: it is not kept, None: not known.

    ``slack`` (n,) [rad]: how far from ``q`` the true pose may be.
    """
    if not numbers.provable.all():
        return {"certified": False, "why": numbers.why}
    forward, back = numbers.forward + slack, numbers.back + slack
    room = np.minimum(robot.q_limit[:, 1] - q - forward, q - back - robot.q_limit[:, 0])
    out: dict[str, Any] = {
        "certified": True,
        "joint_limits_rad": {j: _finite(x) for j, x in zip(robot.joints, room, strict=True)},
        "time_s": _finite(limits.time_s - float(numbers.time.max())),
        "angle_rad": _finite(limits.angle_rad - float(np.maximum(numbers.forward, numbers.back).max())),
        "tcp_m": _finite(limits.tcp_m - numbers.tcp),
    }
    if limits.planes:
        points, far = travels(robot, q, np.maximum(forward, back))
        out["planes_m"] = {}
        for plane in limits.planes:
            normal = np.asarray(plane.normal) / np.linalg.norm(plane.normal)
            left = points @ normal - far - plane.offset - limits.radius_m
            out["planes_m"][plane.name] = _finite(float(left.min()))
    return out


def exceeded(found: dict[str, Any]) -> list[str]:
    """Names of the margins that are not kept."""
    flat = {f"joint limit of {j}": x for j, x in found.get("joint_limits_rad", {}).items()}
    flat |= {f"plane {name}": x for name, x in found.get("planes_m", {}).items()}
    flat |= {f"limits.{name}": found.get(name) for name in ("time_s", "angle_rad", "tcp_m")}
    return [name for name, x in flat.items() if x is not None and x < 0.0]


def _finite(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None
