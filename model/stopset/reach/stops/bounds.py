"""How far, how long, where to, if the arm is stopped now: for tables and for every cycle of the monitor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from stopset.artifact import Model
from stopset.core.library import lib
from stopset.errors import NotCovered
from stopset.reach.stops.cartesian import SLICES, Reached, reached, slices, swept_capsules
from stopset.reach.stops.compiled import ramp_torque
from stopset.reach.stops.directed import PointSets
from stopset.reach.stops.expansion import expand
from stopset.reach.stops.failed import TUBES, failed_stops
from stopset.reach.stops.friction import ROUNDING
from stopset.reach.stops.ramp import Ramp, drive_limit, gear_limit, infeasible, of_the_arm, ramp_of, ramp_time, ramp_tube
from stopset.reach.stops.setting import OUTSIDE, Setting, beyond_domain, setting_of
from stopset.reach.stops.start import NONE, Extrapolation, Start
from stopset.reach.stops.swiftness import swiftness
from stopset.reach.stops.tube import OK, Tube
from stopset.reach.stops.tubes import fastest, stopped_after, tubes_of
from stopset.reach.stops.types import CATEGORIES, Category, StopBound
from stopset.reach.stops.words import (
    BY_ENERGY,
    NO_BRAKES,
    NO_POWER_OFF,
    NO_RAMP,
    NO_REST,
    REST,
    UNSEEN,
    early_cut,
    end_stops,
    no_certificate,
    out_of_budget,
    ramp_assumptions,
)  # fmt: skip
from stopset.robot.rigid import gravity_torque, link_frames
from stopset.sets import Box
from stopset.types import Array

SWEEPS = 4  # capsules per link and tube
FASTEST = 100.0  # [rad/s] of a joint: beyond, a unit was mistaken
FEW = 2  # pieces of a STOP 0 that follows a STOP 2


@dataclass(frozen=True, slots=True)
class StopBounds:
    """Stop bounds of one model, prepared: ``StopBounds.of(model)`` once, then ``bound(q, dq)`` every cycle.

    Not for several threads at once: what is prepared for the core is shared.

    ``setting`` is None when the model knows no brakes: then no STOP 0 can be proved. ``ramp``: for categories 1 and 2;
    ``pieces``: how many tubes a hard case may be cut into (64 for tables); ``fast``: for a loop, some milliseconds each;
    ``tubes``: the budget of a failed ramp outside a loop, see `stopset.reach.stops.failed`.
    """

    model: Model
    setting: Setting | None
    ramp: Ramp | None
    pieces: int = 1
    fast: bool = False
    extrapolate_state: bool = False
    tubes: tuple[int, int] = TUBES
    parts: tuple[Setting, ...] = ()  # of the payload's range, in a loop: see `_tubes_from`

    @classmethod
    def of(
        cls, model: Model, payload: tuple[float, float] | None = None, payload_com: Array | None = None,
        ramp: Ramp | None = None, pieces: int = 1, *, extrapolate: Extrapolation = NONE, fast: bool = False,
    ) -> StopBounds:  # fmt: skip
        """Prepare the bounds; ``payload`` [kg] range and ``payload_com`` (3,) [m] as in `setting_of`.

        ``ramp``: default what the model holds from stop1 recordings; ``extrapolate``: what identification has not seen and gets
        numbers all the same, marked and not certified, instead of "not covered".
        """
        setting = setting_of(model, payload, payload_com, extrapolate=extrapolate.payload)
        parts = setting.parts if fast and setting is not None else ()
        return cls(model, setting, ramp or ramp_of(model), pieces, fast, extrapolate.state, parts=parts)

    def bound(
        self, q: ArrayLike, dq: ArrayLike, category: Category = "0", q_radius: Array | None = None, dq_radius: Array | None = None
    ) -> StopBound:
        """The stop from the measured state ``q`` [rad], ``dq`` [rad/s], (n,) each.

        ``q_radius``, ``dq_radius`` (n,): the bound holds for every measured state that lies no farther away than these and in
        the model's domain.  Outside the domain there are no numbers, or marked ones where states are to be extrapolated.
        Raises `NotCovered` for a state outside the robot's limits, of the wrong size, or radii that are none.
        """
        if category not in CATEGORIES:
            raise NotCovered(f"stop category {category!r}; expected one of {', '.join(CATEGORIES)}: choose one of them")
        q, dq, more_q, more_dq = self._checked(q, dq, q_radius, dq_radius)
        if self.setting is None:
            return StopBound(category, certified=False, why=NO_BRAKES)
        if category != "0" and self.ramp is None:
            return StopBound(category, certified=False, why=NO_RAMP, assumptions=self.setting.assumptions)
        beyond = beyond_domain(self.model, q, dq, more_q, more_dq)
        if beyond and not self.extrapolate_state:
            return StopBound(
                category, certified=False, why=f"not covered: {beyond}; {UNSEEN}", assumptions=self.setting.assumptions
            )
        n, start = self.model.n, self.setting.start if category == "0" else self.setting.truth
        box = Start(q + start.centre[:n], dq + start.centre[n:], start.radius[:n] + more_q, start.radius[n:] + more_dq)
        if category == "0":
            bound = self._power_off(box)
        elif category == "1 guaranteed":
            bound = self._failed_ramp(box)
        else:
            bound = self._working_ramp(box, category)
        return self.marked(self.near_end_stops(bound, q, more_q), beyond)

    def near_end_stops(self, bound: StopBound, q: Array, radius: Array) -> StopBound:
        """The bound, saying which joints may run into the ends of their range, which the arm's range ``q +- radius`` (n,) [rad] and the bound
        itself tell: no joint limit on the way is an assumption of it."""
        assert self.setting is not None
        if bound.forward is None or bound.back is None:
            return bound
        noise, limit = self.setting.noise.take(slice(0, self.model.n)), self.model.robot.q_limit
        off = radius + np.maximum(np.abs(noise.lo), np.abs(noise.hi))
        reached = (q + off + bound.forward > limit[:, 1]) | (q - off - bound.back < limit[:, 0])
        if not np.any(reached):
            return bound
        struck = tuple(j for j, x in zip(self.model.joints, reached, strict=True) if x)
        return replace(bound, end_stops=struck, why="; ".join(x for x in (bound.why, end_stops(struck)) if x))

    def marked(self, bound: StopBound, beyond: str | None) -> StopBound:
        """The bound, not certified and marked where its payload is one that no recording carried or its state lies ``beyond`` them."""
        assert self.setting is not None
        marks = [self.setting.extrapolated] if self.setting.extrapolated else []
        here: tuple[str, ...] = ()
        if beyond:
            marks.append(f"{OUTSIDE}: {beyond}")
            here = (f"{marks[-1]}; there the rigid body is computed, and friction and U are taken not to change",)
        if not marks:
            return bound
        said = "; ".join(marks)
        why = "; ".join(x for x in (bound.why, said) if x)
        return replace(bound, certified=False, why=why, extrapolated=said, assumptions=(*bound.assumptions, *here), here=here)

    def _checked(
        self, q: ArrayLike, dq: ArrayLike, q_radius: ArrayLike | None = None, dq_radius: ArrayLike | None = None
    ) -> tuple[Array, Array, Array, Array]:
        robot, n = self.model.robot, self.model.n
        q, dq = np.array(q, float), np.array(dq, float)
        if q.shape != (n,) or dq.shape != (n,) or not (np.all(np.isfinite(q)) and np.all(np.isfinite(dq))):
            raise NotCovered(
                f"a state of {q.size} angles and {dq.size} speeds; expected {n} finite numbers each: give one per joint"
            )
        radii = [np.zeros(n) if r is None else np.array(r, float) for r in (q_radius, dq_radius)]
        for name, r in zip(("angles", "speeds"), radii, strict=True):
            if r.shape != (n,) or not np.all((r >= 0.0) & (r < np.inf)):
                raise NotCovered(
                    f"half-widths {np.array2string(r, precision=3, threshold=8)} of the {name}; expected {n} finite numbers of at least "
                    "0: give one per joint"
                )
        if not np.all(np.abs(dq) <= FASTEST):
            j = int(np.argmax(np.abs(dq)))
            raise NotCovered(f"{robot.joints[j]} at {dq[j]:.4g} rad/s; expected at most {FASTEST:g} rad/s: give speeds in rad/s")
        out = (q < robot.q_limit[:, 0]) | (q > robot.q_limit[:, 1])
        if np.any(out):
            i = int(np.argmax(out))
            raise NotCovered(
                f"{robot.joints[i]} at {q[i]:.4g} rad is beyond its limits [{robot.q_limit[i, 0]:.4g}, "
                f"{robot.q_limit[i, 1]:.4g}] rad; give a pose within them"
            )
        return q, dq, radii[0], radii[1]

    def _power_off(self, start: Start) -> StopBound:
        assert self.setting is not None
        tubes = self._tubes_from(start)
        if tubes[-1].end != OK:
            return self._refused("0", no_certificate(self.model.joints, self.margin(start.q), self._reach()), start.q)
        margin = np.min([t.margin for t in tubes], axis=0)
        time = np.max([stopped_after(t) for t in tubes], axis=0)
        return self._bound_of("0", tubes, time, start, margin, (*self.setting.assumptions, REST))

    def _tubes_from(self, start: Start) -> list[Tube]:
        """Tubes of a STOP 0. A payload is one mass throughout a stop, so it lies in one of two parts of its range: where the kinetic energy has to
        bound the heaviest and the lightest arm at once, several times too far for each, those of both parts hold it, too; of payloads that
        are alike they are asked where there is no other bound."""
        assert self.setting is not None
        whole = tubes_of(self.setting, start, self.pieces, fast=self.fast)
        proven = whole[-1].end == OK
        alike = self.setting.payloads == lib.STOPSET_ALIKE_PAYLOADS
        if not self.parts or (proven and (alike or not any(t.energetic for t in whole))):
            return whole
        far, found = self._tool_travel(whole, start) if proven else np.inf, list[Tube]()
        for part in self.parts:
            tubes = tubes_of(part, start, self.pieces, fast=self.fast)
            if tubes[-1].end != OK or self._tool_travel(tubes, start) >= far:
                return whole
            found += tubes
        return found

    def _tool_travel(self, tubes: list[Tube], start: Start) -> float:
        """[m] how far the tool gets."""
        assert self.setting is not None
        return max(self._reached(t, start, [self.model.n - 1], [self.setting.payload_com])[0].far for t in tubes)

    def _reached(self, tube: Tube, start: Start, links: list[int], points: list[Array]) -> list[Reached]:
        """Where points of links get in one tube."""
        swift = None if tube.plant is None else np.array([swiftness(tube.plant, *x) for x in zip(links, points, strict=True)])
        return reached(self.model.robot.chain, start.q, start.q_radius, slices(tube, SLICES), links, points, swift)

    def refused_for(self, category: Category, margin: Array, q: Array) -> StopBound:
        """No number, as brakes and dry friction do not surely hold the arm: their margins (n,) [N m] are at most 0."""
        return self._refused(category, no_certificate(self.model.joints, margin, self._reach()), q)

    def _refused(self, category: Category, why: str, q: Array) -> StopBound:
        """No number, and why."""
        assert self.setting is not None
        ramp = () if category == "0" or self.ramp is None else ramp_assumptions(self.ramp, category)
        return StopBound(
            category, certified=False, why=why, holding_margin=self.margin(q), assumptions=(*self.setting.assumptions, *ramp)
        )  # fmt: skip

    def _working_ramp(self, start: Start, category: Category) -> StopBound:
        assert self.setting is not None and self.ramp is not None
        q, q_radius, at, speeds = start.q, start.q_radius, start.angles, start.speeds
        ramp = of_the_arm(self.ramp, self.setting.shares)
        tube = ramp_tube(ramp, speeds.lo, speeds.hi)
        swept = Box(at.lo + tube.d_lo.min(axis=0), at.hi + tube.d_hi.max(axis=0))
        plant = self.setting.near(self.setting.plant, swept, fastest(tube))
        assumptions = (*self.setting.assumptions, *ramp_assumptions(ramp, category))
        time = ramp_time(ramp, speeds.lo, speeds.hi)
        if time is None:
            return self._refused(category, NO_REST, q)
        early = early_cut(ramp, float(time.max())) if category == "1" else None
        if early is not None:
            return self._refused(category, early, q)
        extra = plant.coulomb_hi + plant.viscous_hi * fastest(tube) + np.maximum(np.abs(plant.u_lo), np.abs(plant.u_hi))
        most = gear_limit(self.model, self.setting.torques.gear)
        have = np.minimum(drive_limit(self.model) - extra, most)
        refusal = infeasible(self.model, ramp_torque(self.setting, plant, self.ramp, start, tube, have), extra, most)
        if refusal:
            return self._refused(category, refusal, q)
        if category == "2":
            after = (tube.t > 0)[:, None] * ramp.window
            tube = tube._replace(d_lo=tube.d_lo - after, d_hi=tube.d_hi + after)
        end, half = 0.5 * (tube.d_lo[-1] + tube.d_hi[-1]), 0.5 * (tube.d_hi[-1] - tube.d_lo[-1])
        margin = np.minimum(self.margin(q, q_radius), self.margin(q + end, q_radius + half))
        fallback = None
        if category == "2":
            fallback = self._fallback(q, q_radius, tube)
            then = "what that adds is told beside" if fallback else "for which no bound is proved here"
            assumptions = (
                *assumptions,
                f"if the window is left, power is taken within {1e3 * ramp.reaction:.3g} ms and no joint is faster than {ramp.creep:g} "
                f"rad/s until then; the STOP 0 that follows: {then}",
            )
        else:
            if margin.min() <= 0:
                return self.refused_for(category, margin, q)
        return replace(self._bound_of(category, [tube], time, start, margin, assumptions), fallback=fallback)

    def _fallback(self, q: Array, q_radius: Array, tube: Tube) -> tuple[float, float] | None:
        """Angle [rad] and time [s] added when the standstill window of a STOP 2 is left: creeping until the power is taken, then a
        STOP 0 from there with what the drives still give."""
        assert self.setting is not None and self.ramp is not None
        ramp, residual = self.ramp, self.setting.residual
        crept = ramp.reaction * ramp.creep
        middle, radius = 0.5 * (tube.d_lo[-1] + tube.d_hi[-1]), 0.5 * (tube.d_hi[-1] - tube.d_lo[-1]) + q_radius + crept
        # where the ramp has led is a wide box of poses: cutting the brakes' intervals many times over would not close it
        pieces = min(self.pieces, FEW)
        start = Start(q + middle, residual.centre, radius, ramp.creep + residual.radius)
        tubes = tubes_of(self.setting, start, pieces, fast=self.fast)
        if tubes[-1].end != OK:
            return None
        angle = max(float(np.maximum(t.d_hi.max(), -t.d_lo.min())) for t in tubes)
        return crept + angle, ramp.reaction + max(float(stopped_after(t).max()) for t in tubes)

    def _failed_ramp(self, start: Start) -> StopBound:
        assert self.setting is not None and self.ramp is not None
        ramp, setting, q = of_the_arm(self.ramp, self.setting.shares), self.setting, start.q
        found = failed_stops(setting, ramp, start, self.tubes, fast=self.fast)
        if found is None:
            return self._refused("1 guaranteed", NO_POWER_OFF, q)
        tubes: list[Tube] = []
        time = np.zeros(self.model.n)
        margin = np.full(self.model.n, np.inf)
        for cell, _, part in found.parts:
            lo, hi, _, _ = cell.boxes(start, ramp)
            if part.end != OK:
                return self.refused_for("1 guaranteed", self.margin(q + 0.5 * (lo + hi)), q)
            time = np.maximum(time, cell.time + stopped_after(part))
            margin = np.minimum(margin, part.margin)
            # displacement since the request; what was passed before power-off lies in the starts of these boxes
            tubes.append(part._replace(d_lo=part.d_lo + lo, d_hi=part.d_hi + hi))
        assumptions = (*setting.assumptions, *ramp_assumptions(ramp, "1 guaranteed"))
        bound = self._bound_of("1 guaranteed", tubes, time, start, margin, assumptions)
        return replace(bound, why=out_of_budget(found.loose, len(found.parts), found.tried)) if found.loose else bound

    def _bound_of(
        self, category: Category, tubes: list[Tube], time: Array, start: Start, margin: Array, assumptions: tuple[str, ...]
    ) -> StopBound:
        """The bound in words of joints and space, over all ``tubes`` of displacement since the stop request."""
        assert self.setting is not None
        q, q_radius = start.q, start.q_radius
        robot, n = self.model.robot, self.model.n
        chain, tool = robot.chain, self.setting.payload_com
        ends = [chain.p[i + 1] if i + 1 < n else robot.tip for i in range(n)]
        at, points = [*range(n), n - 1], [*ends, tool]
        tcp, tcp_speed, box, links = 0.0, 0.0, np.zeros((3, 2)), np.zeros((n, 2))
        sets, swept = [], []
        for tube in tubes:
            *out, tip = self._reached(tube, start, at, points)
            tcp, tcp_speed = max(tcp, tip.far), max(tcp_speed, tip.fast)
            box[:, 0], box[:, 1] = np.minimum(box[:, 0], tip.box[:, 0]), np.maximum(box[:, 1], tip.box[:, 1])
            links = np.maximum(links, [x[:2] for x in out])
            sets.append(tip[3:])
            swept.append(swept_capsules(chain, q, q_radius, tube, robot.arm.capsules, SWEEPS))
        by_energy = any(t.energetic for t in tubes)
        R, o = link_frames(chain, q)
        layer = "ramp" if category in ("1", "2") else "energy" if by_energy else "pieces" if len(tubes) > 1 else "tube"
        return StopBound(
            category, certified=True, why=BY_ENERGY if by_energy else "", time=time,
            forward=np.maximum(np.max([t.d_hi.max(axis=0) for t in tubes], axis=0), 0.0),
            back=np.maximum(-np.min([t.d_lo.min(axis=0) for t in tubes], axis=0), 0.0),
            speed=np.max([fastest(t) for t in tubes], axis=0),
            tcp=tcp, tcp_speed=tcp_speed, tcp_box=box, links=links[:, 0], link_speed=links[:, 1],
            holding_margin=margin, assumptions=assumptions, layer=layer,
            motion=PointSets(
                o[-1] + R[-1] @ tool, self._reach() * float(q_radius.sum()),
                *(np.concatenate([x[k] for x in sets]) for k in range(4)),
            ),
            capsules=np.concatenate(swept),
        )  # fmt: skip

    def _reach(self) -> float:
        """[m] no point of the axes or the tool is farther from the first joint."""
        assert self.setting is not None
        chain = self.model.robot.chain
        return float(np.linalg.norm(chain.p[1:], axis=1).sum() + np.linalg.norm(self.setting.payload_com))

    def margin(self, q: Array, radius: Array | None = None) -> Array:
        """(n,) [N m]: what brakes and dry friction surely leave over when holding the arm anywhere in ``q +- radius``."""
        assert self.setting is not None
        wide = np.zeros(self.model.n) if radius is None else radius
        p = self.setting.near(self.setting.plant, Box(q - wide, q + wide), np.zeros(self.model.n))
        g = [gravity_torque(p.chain, p.pi + s * p.pi_half, q) for s in (-1.0, 1.0)]
        least, most = np.minimum(*g), np.maximum(*g)
        if radius is not None:
            E = expand(p.chain, p.pi, p.pi_half, p.rotor, q)
            more = (np.abs(E.dg) + np.abs(E.dgp)) @ radius + 0.5 * np.einsum("ikl,k,l->i", p.curvature.g, radius, radius)
            # in a wide box slopes say more than what gravity can ask in any pose
            load = p.curvature.load * (1.0 + ROUNDING)
            least, most = np.minimum(np.maximum(least - more, -load), least), np.maximum(np.minimum(most + more, load), most)
        low, high = least - p.u_hi, most - p.u_lo
        out: Array = p.brake_lo + p.coulomb_lo - np.maximum(np.abs(low), np.abs(high))
        return out


def stop(model: Model, q: ArrayLike, dq: ArrayLike, category: Category = "0") -> StopBound:
    """The bound of one stop from a measured state; for many states prepare `StopBounds` once."""
    return StopBounds.of(model).bound(q, dq, category)
