"""The arm drawn from the side and from above: its links, its joints, the ones in question by name, and what a stop can sweep."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from markupsafe import escape

from stopset.artifact import Model
from stopset.robot.rigid import link_frames
from stopset.types import Array

SIZE = 320.0  # [px] of each view
LEAST = 0.05  # [m] drawn across: an arm of one axis has no extent of its own
POSES = 64  # looked at for one that tells most
EDGE = 26.0  # [px] around what is drawn, with the words below
WIDE = ("from the side", "from above")
Flat = Callable[[Array], Array]  # places in space [m] -> in the picture [px]
LINK, SWEPT, BAD = "#26323d", "#f0a202", "#b00020"


def drawn_arm(
    model: Model, q: Array, *, views: Sequence[str] = WIDE, marked: Sequence[str] = (), swept: Array | None = None, within: float = 0.0
) -> str:  # fmt: skip
    """SVG of the arm at ``q`` (n,) [rad].

    ``marked``: joints in question, drawn red and named; ``swept``: (P, 7) [m] capsules that a stop can sweep, both ends and radius;
    ``within``: [m] radius of a circle about the flange, drawn where no capsules are known.
    """
    points = model.robot.outline(q)
    bodies = _bodies(model, q)
    seen = [_seen(points, view) for view in views]
    spans = [_span(points @ p.T, np.zeros((0, 7)) if swept is None else swept, p, within) for p in seen]
    scale = (SIZE - 2 * EDGE) / max(LEAST, *(float((hi - lo).max()) for lo, hi in spans))
    parts = []
    for k, (view, p, (lo, hi)) in enumerate(zip(views, seen, spans, strict=True)):
        middle, shift = (lo + hi) / 2, np.array([SIZE * (k + 0.5), SIZE / 2 - 6])

        def at(x: Array, p: Array = p, middle: Array = middle, shift: Array = shift) -> Array:
            return np.asarray(shift + scale * (x @ p.T - middle) * np.array([1.0, -1.0]))

        if swept is not None and len(swept):
            parts.append(_capsules(swept, at, scale, SWEPT, "0.5"))
        elif within > 0:
            x, y = at(points[-1])
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{scale * within:.1f}" fill="{SWEPT}" fill-opacity=".5"/>')
        parts.append(_capsules(bodies, at, scale, "#9fb0be", "0.55"))
        parts += _joints(model, points, at, marked)
        words = f'text-anchor="middle" font-size="12" fill="#4d5866">{view}'
        parts.append(f'<text x="{SIZE * (k + 0.5):.0f}" y="{SIZE - 4:.0f}" {words}</text>')
    parts.append(_measure(scale))
    what = f" with {', '.join(marked)} marked" if marked else f" with the flange within {within:.3g} m" if within else ""
    label = escape(f"{model.robot.name}{what}")
    width = len(views) * SIZE
    return f'<svg viewBox="0 0 {width:.0f} {SIZE:.0f}" width="{width:.0f}" role="img" aria-label="{label}">{"".join(parts)}</svg>'


def telling_pose(model: Model) -> Array:
    """(n,) [rad] of the poses of the model's domain one in which the arm is neither folded nor stretched, to be looked at."""
    rng = np.random.default_rng(0)
    poses = rng.uniform(model.domain.q.lo, model.domain.q.hi, (POSES, model.n))

    def spread(q: Array) -> float:
        points = model.robot.outline(q)
        return float(np.ptp(points @ _seen(points, WIDE[0]).T, axis=0).min())

    return max(poses, key=spread)


def _seen(points: Array, view: str) -> Array:
    """(2, 3) what lies right and up in a view: from the side the arm's own plane, as far as it has one."""
    if view == "from above":
        return np.eye(3)[:2]
    flat = points[:, :2] - points[0, :2]
    along = np.linalg.svd(flat)[2][0]
    along = along * (1.0 if flat[-1] @ along >= 0 else -1.0)
    return np.array([[along[0], along[1], 0.0], [0.0, 0.0, 1.0]])


def _span(flat: Array, swept: Array, p: Array, within: float) -> tuple[Array, Array]:
    """Lower and upper corner (2,) [m] of what a view shows."""
    r = swept[:, 6:]
    ends = [
        flat,
        flat[-1:] - within,
        flat[-1:] + within,
        *(swept[:, s] @ p.T + sign * r for s in (slice(0, 3), slice(3, 6)) for sign in (-1, 1)),
    ]
    every = np.vstack(ends)
    return every.min(axis=0), every.max(axis=0)


def _bodies(model: Model, q: Array) -> Array:
    """(m, 7) [m] the capsules around the links in space; none of links whose shape is not known."""
    R, o = link_frames(model.robot.chain, np.ascontiguousarray(q, dtype=float))
    own = model.robot.arm.capsules
    ends = [o + np.einsum("nij,nj->ni", R, own[:, s]) for s in (slice(0, 3), slice(3, 6))]
    return np.asarray(np.hstack([*ends, own[:, 6:]])[own[:, 6] > 0])


def _capsules(capsules: Array, at: Flat, scale: float, colour: str, opacity: str) -> str:
    """Thick lines with round ends, which is what capsules look like; laid on together, so they are one volume."""
    ends = zip(at(capsules[:, :3]), at(capsules[:, 3:6]), np.ceil(2 * scale * capsules[:, 6]) + 1, strict=True)
    lines = dict.fromkeys(
        f'<path d="M{x:.0f} {y:.0f}L{u:.0f} {v:.0f}" stroke-width="{wide:.0f}"/>' for (x, y), (u, v), wide in ends
    )
    return f'<g fill="none" stroke="{colour}" stroke-linecap="round" opacity="{opacity}">{"".join(lines)}</g>'


def _joints(model: Model, points: Array, at: Flat, marked: Sequence[str]) -> list[str]:
    """The links' axes and the joints on them; the marked ones last, several may share a place."""
    flat = at(points)
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in flat)
    parts = [
        f'<polyline points="{line}" fill="none" stroke="{LINK}" stroke-width="6" stroke-linejoin="round" stroke-linecap="round"/>'
    ]
    parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#fff" stroke="{LINK}" stroke-width="2"/>' for x, y in flat[1:-1]]
    for name in marked:
        x, y = flat[1 + model.joints.index(name)]
        end, dx = ("start", 14) if x % SIZE < SIZE / 2 else ("end", -14)
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="9" fill="{BAD}" stroke="#fff" stroke-width="2"/>')
        parts.append(
            f'<text x="{x:.1f}" y="{y + 4:.1f}" text-anchor="middle" font-size="12" font-weight="700" fill="#fff">!</text>'
        )
        parts.append(
            f'<text x="{x + dx:.1f}" y="{y - 8:.1f}" text-anchor="{end}" font-size="13" font-weight="700" fill="{BAD}" '
            f'stroke="#fff" stroke-width="3" paint-order="stroke">{escape(name)}</text>'
        )
    return parts


def _measure(scale: float) -> str:
    """A bar of a round length [m]."""
    most = 0.3 * SIZE / scale
    length = next(x for x in (5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.0) if x <= most)
    return (
        f'<path d="M8 {SIZE - 8:.0f}h{scale * length:.1f}" stroke="#4d5866" stroke-width="3"/><text x="8" y="{SIZE - 13:.0f}" '
        f'font-size="11" fill="#4d5866">{length:.3g} m</text>'
    )
