"""The nominal model: one call from recordings to link parameters, rotors, friction, delay, and how sure each is.

Source: Liu & Althoff (2018), sec. IV-A and appendix; Gautier & Khalil (1990) for base parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stopset.effects import Effect, Fitted
from stopset.effects.selection import base
from stopset.errors import RecordingError
from stopset.offline.nominal.delay import OWN, Delay, estimate_delay, has_own_lag, joint_reduced, lag_weights, moved_in_words
from stopset.offline.nominal.fit import Fit, fit, leave_out
from stopset.offline.nominal.floor import floor_of
from stopset.offline.nominal.low_pass import KNOWN, in_words
from stopset.offline.nominal.normal_equations import Column, NormalEquations, accumulate
from stopset.offline.nominal.preprocess import Preprocessing
from stopset.offline.nominal.prior import Prior, Tolerance, prior_of
from stopset.offline.nominal.rotors import contradicted, far_below
from stopset.offline.nominal.unidentifiable import base_count, undetermined
from stopset.recording.types import Recording, Recordings
from stopset.robot import Robot
from stopset.types import Array
from stopset.words import many

DELAY_TRUSTED = 0.002  # [s] a common delay with a larger standard error is applied only where it is far larger than that
LOW_PASS = "low-pass of the recorded torque, without phase"
LAG = "lag of the recorded torque against the motion, as its stamps were moved"
LOAD_PASSES = 1  # fits whose gravity the next one's load is computed with


@dataclass(frozen=True, slots=True)
class Nominal:
    """The identified rigid body, rotors and friction of an arm with ``n`` joints.

    ``pi`` (n, 10) standard parameters; ``rotor`` (n,) reflected rotor inertia [kg m^2]; ``friction``: one `Fitted` per
    effect and joint; ``names``, ``covariance``: of all parameters in one vector (10 n links, n rotors, friction);
    ``rms``, ``rms_heldout`` (n,) [N m] torque residual after filtering, on all motions and on motions left out of the
    fit (nan with fewer than two); ``rms_before`` (n,): of the CAD model with friction fitted alone; ``s_max`` (n,)
    [rad/s]: friction is not to be predicted beyond; ``load_max`` (n,) [N m]; ``span`` (n, 2) [rad]; ``delay``: torque
    against motion, see `Delay`; ``delay_applied`` (n,) [s]; ``undetermined``: what the data leave open; ``notes``: what was
    done; ``inflation`` (n,): how many filtered samples are worth one independent one; ``data``: the sums, to fold later
    recordings in with `solve_nominal(robot, old + new)`.
    """

    joints: tuple[str, ...]
    pi: Array
    rotor: Array
    friction: tuple[Fitted, ...]
    names: tuple[str, ...]
    covariance: Array
    rms: Array
    rms_heldout: Array
    rms_before: Array
    s_max: Array
    load_max: Array
    span: Array
    delay: Delay
    delay_applied: Array
    inflation: Array
    base_parameters: int
    undetermined: tuple[str, ...]
    notes: tuple[str, ...]
    limited: tuple[str, ...]  # those of the notes that say what a limit decided
    data: NormalEquations
    prior: Prior  # as it counted: a description that the recordings contradict counts for less
    off: float  # times its tolerance that the description is off, at least 1

    @property
    def theta(self) -> Array:
        """All parameters in one vector, in the order of ``names``."""
        friction = [f.values[c.symbol] for f, c in self._terms()]
        return np.concatenate([self.pi.ravel(), self.rotor, friction])

    def _terms(self) -> list[tuple[Fitted, Column]]:
        by = {(f.effect, f.joint): f for f in self.friction}
        return [(by[c.effect.name, self.joints[j]], c) for j, cs in enumerate(self.data.layout.columns) for c in cs]

    @property
    def std(self) -> dict[str, float]:
        """Standard error of each parameter by name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def robot(self, robot: Robot) -> Robot:
        """The arm with identified links and rotors in place of CAD and data sheet."""
        drives = tuple(replace(d, rotor_inertia=float(r)) for d, r in zip(robot.drives, self.rotor, strict=True))
        return replace(robot.with_parameters(self.pi), drives=drives)

    def taken_out(self) -> tuple[dict[str, Any], ...]:
        """What was taken off the recordings before the fit: the lag of the torque, common (``joint`` None) or of single joints (`lag_entry`)."""
        lag, out = self.delay, list[tuple[str | None, float, float]]()
        own = [j for j in range(len(self.joints)) if self.delay_applied[j] != lag.common]
        if len(own) < len(self.joints):
            out.append((None, float(lag.common), float(lag.common_std)))
        out += [(self.joints[j], float(self.delay_applied[j]), float(lag.std[j])) for j in own]
        late = tuple(lag_entry(*x) for x in out if x[1] != 0.0)
        cutoff = self.data.settings.low_pass
        return (
            late
            if cutoff == 0.0
            else ({"what": LOW_PASS, "joint": None, "value": cutoff, "std": KNOWN * cutoff, "unit": "Hz"}, *late)
        )

    def friction_covariance(self) -> dict[str, dict[str, Any]]:
        """Of each joint the numbers of its friction, ``of`` as [effect, symbol], and the ``covariance`` of their errors: some err
        against each other, and how much friction there is at the recorded speeds is known far better than any of them."""
        layout, head = self.data.layout, 10 * len(self.joints) + 1
        out = {}
        for j, (joint, columns) in enumerate(zip(self.joints, layout.columns, strict=True)):
            at = layout.index(j)[head:]
            of = [[c.effect.name, c.symbol] for c in columns]
            out[joint] = {"of": of, "covariance": self.covariance[np.ix_(at, at)].tolist()}
        return out

    def value(self, effect: str, joint: str) -> dict[str, float]:
        """Parameters of one effect at one joint; empty if it is not part of the model."""
        return next((dict(f.values) for f in self.friction if f.effect == effect and f.joint == joint), {})


def lag_entry(joint: str | None, value: float, std: float) -> dict[str, Any]:
    """What a model file says of a lag that was taken out; ``joint`` None: of all.  ``value`` [s] is what the torque's stamps are moved by, below 0
    where it is late: the other sign than a `delay` has."""
    return {"what": LAG, "joint": joint, "value": value, "std": std, "unit": "s"}


def taken_out_in_words(out: Mapping[str, Any]) -> str:
    """An entry of `Nominal.taken_out` for people."""
    where = out["joint"] or "all joints"
    if out["unit"] != "s":
        return f"{out['what']}, {out['value']:.4g} +- {out['std']:.2g} {out['unit']} ({where})"
    return f"recorded torque {moved_in_words(out['value'], out['std'])} the motion ({where})"


def identify_nominal(
    robot: Robot,
    recordings: Recordings | Iterable[Recording] | Callable[[], Iterable[Recording]],
    effects: Sequence[str | Effect] | None = None,
    *,
    effort: str | None = None,
    settings: Preprocessing | None = None,
    tolerance: Tolerance | None = None,
    delay: float | None = None,
) -> Nominal:
    """Rigid body, rotors, friction and delay of an arm from raw recordings of any phases.

    ``effects``: effects of single joints, ``"name"`` (all joints), ``"name:joint"``, or `Effect`; left out: `base` friction.  ``effort``: kind of
    torque, taken from the recordings' metadata if they have one, else motor torque; currents arrive here already times
    their torque constant.  ``recordings``: an iterable is read once, a function is called for each pass.  ``tolerance``:
    how far the CAD may be off; ``delay`` [s]: known delay of torque against motion, else it is estimated first.
    Static poses count where both approach directions were recorded; stops are left out (the brake's torque is not in
    ``tau``).  With load-dependent effects the load is that of a first fit; where the recordings can be read only once, of the CAD.
    Raises `RecordingError` when no sample can be used; what the data leave open is kept at the CAD and listed.
    """
    effects = base() if effects is None else effects
    if effort is None:
        effort = recordings.meta.effort if isinstance(recordings, Recordings) else "motor_torque"
    compensated = effort == "compensated_torque"
    once = not callable(recordings) and not isinstance(recordings, Recordings)

    def trials() -> Iterable[Recording]:
        return recordings() if callable(recordings) else recordings

    reference = None
    if any("load" in _effect(e).needs for e in effects) and not once:
        for _ in range(LOAD_PASSES):
            first = accumulate(robot, trials(), effects, settings, reference, compensated=compensated)
            reference = solve_nominal(robot, first, tolerance=tolerance, delay=delay).pi
    data = accumulate(robot, trials(), effects, settings, reference, compensated=compensated)
    return solve_nominal(robot, data, tolerance=tolerance, delay=delay)


def _effect(item: str | Effect) -> Effect:
    from stopset.effects import get

    return get(item.partition(":")[0]) if isinstance(item, str) else item


def solve_nominal(
    robot: Robot, data: NormalEquations, *, tolerance: Tolerance | None = None, delay: float | None = None
) -> Nominal:
    """The nominal model from sums alone; ``solve_nominal(robot, old + new)`` equals reading everything again."""
    if data.rows_moving.sum() + data.rows_still.sum() == 0:
        fastest = float(np.abs(data.speed).max()) if data.recordings else 0.0
        if data.recordings and fastest < 2 * data.settings.still:
            raise RecordingError(
                f"no joint moves within any of these {data.recordings} recordings (fastest {fastest:.2g} rad/s; their poses are up to "
                f"{float(np.ptp(data.span, axis=1).max()):.2g} rad apart): held poses alone show neither friction nor inertia; expected motions "
                "of every joint: record some, and give the poses with them as phase static"
            )
        raise RecordingError(
            f"no usable sample: {data.recordings} moving trials, {data.poses} poses, left out {data.skipped or 'none'}; "
            "expected motor torque over at least one motion of a second, or poses approached from both sides"
        )
    prior = prior_of(robot, tolerance)
    late, moving, still, result = _fitted(robot, data, prior, delay)
    if far_below(prior, result):
        free = prior.without_rotors
        again = _fitted(robot, data, free, delay)
        if contradicted(prior, again[-1]):
            prior, (late, moving, still, result) = free, again
    heldout, covariance = leave_out(data, moving, still, prior, result)
    return _nominal(robot, data, prior, replace(result, covariance=covariance), heldout, late)


def _fitted(
    robot: Robot, data: NormalEquations, prior: Prior, delay: float | None
) -> tuple[tuple[Delay, Array, list[str]], Array, Array, Fit]:
    """What `_delay` says, the sums of motions and of poses at these lags, and the fit to them."""
    late = _delay(data, prior, delay)
    moving, still = _at_lag(data, late[1])
    return late, moving, still, fit(data, moving, still, prior, floor_of(robot, data, prior), robot.pi)


def _at_lag(data: NormalEquations, applied: Array) -> tuple[Array, Array]:
    """Sums of motions and of poses with the torque of each joint taken at its lag ``applied`` (n,) [s]."""
    weights = [lag_weights(float(d)) for d in applied]
    moving = [joint_reduced(data.moving[:, j], w) for j, w in enumerate(weights)]
    return np.stack(moving, axis=1), np.array([joint_reduced(data.still[j], w) for j, w in enumerate(weights)])


def trusted(lag: Delay) -> bool:
    """Whether all joints' lag is known well enough to be taken out, or far larger than its error."""
    return bool(lag.common_std <= DELAY_TRUSTED or lag.sure)


def _delay(data: NormalEquations, prior: Prior, given: float | None) -> tuple[Delay, Array, list[str]]:
    """The delay found, that of each joint (n,) [s] that is taken out, and what is to be told of it."""
    lag, n = estimate_delay(data, prior), data.layout.n
    if given is not None:
        return lag, np.full(n, given), [f"delay of torque against motion {given * 1e3:.2f} ms as given"]
    if data.recordings == 0:
        return lag, np.zeros(n), []
    found = f"{lag.common * 1e3:.1f} +- {lag.common_std * 1e3:.1f} ms"
    if not trusted(lag):
        return lag, np.zeros(n), [f"delay of torque against motion undetermined ({found}): none is assumed"]
    held = (
        ""
        if abs(lag.common) < OWN
        else "; predictions get the torque as it comes, and the sets hold the lag: record both on one clock"
    )
    notes = [f"delay of torque against motion {found}, taken out (a held command alone: {lag.hold * 1e3:.1f} ms){held}"]
    own = has_own_lag(lag, data.period)
    notes += [
        f"{data.layout.joints[j]}: its torque is {lag.joint[j] * 1e3:.1f} +- {lag.std[j] * 1e3:.1f} ms apart from the motion, unlike the "
        "other joints'; that is taken out of the fit, but predictions get the torque as it comes"
        for j in np.flatnonzero(own)
    ]
    return lag, np.where(own, lag.joint, lag.common), notes


def _nominal(
    robot: Robot,
    data: NormalEquations,
    prior: Prior,
    result: Fit,
    heldout: Array,
    late: tuple[Delay, Array, list[str]],
) -> Nominal:
    """All that was found, under its names; ``late``: what `_delay` says."""
    n, layout, (lag, applied, notes) = robot.n, data.layout, late
    std = np.sqrt(np.diag(result.covariance))
    friction = []
    for j, columns in enumerate(layout.columns):
        places = layout.index(j)[10 * n + 1 :]
        for effect in dict.fromkeys(c.effect for c in columns):
            mine = [(c.symbol, int(p)) for c, p in zip(columns, places, strict=True) if c.effect is effect]
            shapes = effect.shape_values(None)
            friction.append(
                Fitted(
                    effect.name,
                    robot.joints[j],
                    {**{s: float(result.theta[p]) for s, p in mine}, **{k: float(v) for k, v in shapes.items()}},
                    {s: float(std[p]) for s, p in mine},
                )
            )
    through = data.settings.low_pass
    filtered = () if through == 0.0 else (in_words(through),)
    skipped = [f"{many(count, 'recording')} left out: {why}" for why, count in sorted(data.skipped.items())]
    return Nominal(
        joints=robot.joints,
        pi=result.theta[: 10 * n].reshape(n, 10),
        rotor=result.theta[10 * n : 11 * n],
        friction=tuple(friction),
        names=layout.names(),
        covariance=result.covariance,
        rms=result.rms,
        rms_heldout=heldout,
        rms_before=result.rms_before,
        s_max=_magnitude(data.speed),
        load_max=_magnitude(data.load),
        span=data.span,
        delay=lag,
        delay_applied=applied,
        inflation=result.inflation,
        base_parameters=base_count(robot),
        undetermined=undetermined(robot, data, prior, result),
        notes=(*filtered, *notes, *result.notes, *skipped),
        limited=result.limited,
        data=data,
        prior=replace(prior, precision=result.precision),
        off=result.off,
    )


def _magnitude(interval: Array) -> Array:
    size = np.abs(interval).max(axis=1)
    return np.where(np.isfinite(size), size, 0.0)
