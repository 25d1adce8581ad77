"""What is wrong with a recording: each detector one function, each finding what was seen, expected, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from stopset.offline.inspect.tally import EVEN, LAGS, MOVING, SignalSums
from stopset.offline.nominal.fit import ANOTHER_ARM, NOTABLY_OFF, another_arm
from stopset.offline.nominal.low_pass import TURNS_OVER
from stopset.recording.types import Meta
from stopset.types import Array

Severity = Literal["error", "warning", "note"]
NOTABLE_GAPS = 1e-4  # share of missing samples
RATIOS = {  # dq over the derivative of q -> what it means
    180 / np.pi: "dq is in deg/s, q in rad",
    np.pi / 180: "q is in degrees, dq in rad/s",
    1000.0: "dq is in mrad/s or t in ms",
    1e6: "t is in microseconds",
    1e9: "t is in nanoseconds",
    0.001: "t is in ms or dq in rad/ms",
    60 / (2 * np.pi): "dq is in rpm",
    -1.0: "dq has the wrong sign",
}
AGREES = 0.1  # relative: a scale within this of 1 is right, within it of a ratio above is explained
CORRELATED = 0.9  # below it dq does not follow q at all
CLEAR = 0.9985  # above it neither noise of q nor a filter that dq went through changes the scale by as much as `OFF_RATE`
STILL = 6.0  # steps of the encoder per window, root mean square: noise makes less
ALIKE = 0.005  # scales of all joints this near to each other have one cause
RIGHT = (0.4, 2.5)  # measured over modelled torque: payload, drive gain and CAD errors live here
RIGHT_TORN = (0.1, 10.0)  # the same where samples were lost and stamps made up, so that accelerations are wrong
OWN_DELAY = 0.01  # [s] of one joint against the others: below, unmodelled friction looks alike
SAME = 3  # trials in which a signal stops at the very same value below its largest
SLOW = 1 / 60  # [s] of a period: the filters of identification need ten samples per period of 6 Hz
TOO_SLOW = 0.5  # [s] between samples: nothing of a motion is left
OFF_RATE = 0.01  # relative: rates further off than this are told
FEWEST_TURNS = 4  # reversals of a joint from which on their scatter is known at all
TURNED = 3.5  # standard deviations below zero: by chance in one of 4000 joints whose sign is right and that have no friction
DELAY = 0.003  # [s] of torque against motion that friction and inertia would swallow
DELAY_COMPENSATED = 0.015  # [s] of compensated torque, in which stiction and errors of the compensation look like delay


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong or strange; ``kind`` is the word for programs, the rest for people."""

    kind: str
    severity: Severity
    joint: str | None
    seen: str
    expected: str
    do: str
    value: float | None = None

    @property
    def says(self) -> str:
        where = f"{self.joint}: " if self.joint else ""
        return f"{where}{self.seen}; expected {self.expected}: {self.do}"


def clock(t: SignalSums, meta: Meta, *, dq_sound: bool = True) -> list[Finding]:
    """Irregular stamps, missing, repeated and jumped samples, and a rate that is not the stated one.

    ``dq_sound``: dq is the derivative of q, so that jumps of q against it tell of lost samples.
    """
    out: list[Finding] = []
    if not t.period:
        return out
    period, jitter = float(np.median(t.period)), float(np.max(t.jitter))
    if jitter > EVEN:
        out.append(
            Finding("clock_jitter", "warning", None, f"the period of {period * 1e3:.3g} ms spreads by {100 * jitter:.1f} %",
                    f"at most {100 * EVEN:.0f} %", "identification resamples; record with the controller's own stamps", jitter)
        )  # fmt: skip
    lost = t.missing / max(t.samples + t.missing, 1)
    if lost > NOTABLE_GAPS:
        out.append(
            Finding("dropped_samples", "error" if lost > 0.02 else "warning", None,
                    f"{t.missing} samples ({100 * lost:.2g} %) missing in {t.gaps} gaps, at most {t.longest_gap * 1e3:.3g} ms",
                    "none", "trials are split at long gaps; record again if a motion is lost in them", lost)
        )  # fmt: skip
    if t.pauses:
        often = f" at most, {len(t.pauses)} times" if len(t.pauses) > 1 else ""
        out.append(
            Finding("pauses", "error", None, f"nothing was recorded for {max(t.pauses):.3g} s{often}", "samples throughout a trial",
                    "nothing is known of the time between: make two trials of it", max(t.pauses))
        )  # fmt: skip
    if t.repeated > max(2, NOTABLE_GAPS * t.samples):
        out.append(
            Finding("repeated_samples", "error" if t.repeated > 0.005 * t.samples else "warning", None,
                    f"{t.repeated} samples repeat their predecessor in mid-motion",
                    "a new sample at every stamp", "the logger filled lost samples: record again or leave gaps", t.repeated)
        )  # fmt: skip
    if dq_sound and t.jumps > max(2, NOTABLE_GAPS * t.samples):
        out.append(
            Finding("dropped_samples", "error", None,
                    f"{t.jumps} steps of q are whole multiples of what dq gives over one period",
                    "steps of one period", "samples were lost and the stamps made up: record with real stamps", t.jumps)
        )  # fmt: skip
    if t.rounded:
        out.append(
            Finding("stamp_digits", "warning", None, f"stamps are printed to {t.rounded * 1e3:.3g} ms at a period of {period * 1e3:.3g} ms",
                    "stamps finer than a tenth of the period",
                    "they lie on an even clock within that, which is what is used; print more digits", t.rounded)
        )  # fmt: skip
    out += _ends(t)
    if period > TOO_SLOW:
        out.append(
            Finding("slow_rate", "error", None, f"samples lie {period:.3g} s apart", f"at most {TOO_SLOW:.3g} s",
                    "is t in ms? write it in seconds; else record faster", 1 / period)
        )  # fmt: skip
    elif period > SLOW:
        out.append(
            Finding("slow_rate", "warning", None, f"{1 / period:.3g} Hz", f"at least {1 / SLOW:.0f} Hz",
                    "reversals of friction, gears and delays lie between such samples: a model of rigid body and friction is all they "
                    "can give; record faster", 1 / period)
        )  # fmt: skip
    out += _rate(t, meta)
    if meta.clock == "assumed":
        out.append(
            Finding("clock_assumed", "note", None, "the stamps are assumed, not recorded", "recorded stamps",
                    "jitter and lost samples can only be seen in the motion itself")
        )  # fmt: skip
    return out


def _ends(t: SignalSums) -> list[Finding]:
    """Where trials begin or end in what a filter made of them."""
    out = []
    if t.settling:
        out.append(
            Finding("start_transient", "warning", None, f"dq does not follow q in the first {t.settling * 1e3:.3g} ms of a trial",
                    "dq = dq/dt from the first sample on", "a filter settles there: begin recording before the motion, or cut it off",
                    t.settling)
        )  # fmt: skip
    return out + [
        Finding(kind, "warning", None, f"in the {which} {seconds * 1e3:.3g} ms of a trial dq contradicts q", "dq = dq/dt throughout",
                "a filter's own start or end is no motion: that part is left out by every command", seconds)
        for kind, which, seconds in (("start_transient", "first", t.bent[0]), ("end_transient", "last", t.bent[1])) if seconds
    ]  # fmt: skip


def _rate(t: SignalSums, meta: Meta) -> list[Finding]:
    """A rate on average that is not the stated one, or not the same in all trials."""
    out = []
    mean = np.array(t.mean_period or t.period)
    usual = float(np.median(mean))
    if np.isfinite(meta.rate_hz) and abs(usual * meta.rate_hz - 1) > OFF_RATE:
        why = "is t in ms? correct it" if abs(np.log10(usual * meta.rate_hz)) > 1 else "correct t"
        out.append(
            Finding("rate", "warning", None, f"stamps come at {1 / usual:.4g} Hz on average",
                    f"{meta.rate_hz:.4g} Hz as the metadata says", f"{why}, or the metadata", 1 / usual)
        )  # fmt: skip
    spread = float(mean.max() / mean.min() - 1)
    if spread > OFF_RATE and np.max(t.jitter) <= EVEN:  # an irregular clock has been told already
        out.append(
            Finding("clock_drift", "warning", None,
                    f"trials come at {1 / mean.max():.4g} to {1 / mean.min():.4g} Hz, {100 * spread:.1f} % apart",
                    f"one rate to {100 * OFF_RATE:.0f} %", "identification resamples them to one grid; look for two clocks", spread)
        )  # fmt: skip
    return out


def saturation(t: SignalSums, joints: Sequence[str]) -> list[Finding]:
    """Signals that stop at one value for many samples."""
    out = []
    top = {"tau": np.abs(t.range_tau).max(axis=1), "dq": np.abs(t.range_dq).max(axis=1)}
    at: dict[tuple[str, int, float], list[int]] = {}
    for name, j, value, run in t.plateaus:
        at.setdefault((name, j, float(f"{value:.5g}")), []).append(run)
    seen: dict[tuple[str, int], tuple[float, int]] = {}
    for (name, j, value), runs in at.items():
        if name not in top or value >= 0.999 * top[name][j] or len(runs) >= SAME:
            old = seen.get((name, j), (0.0, 0))
            seen[name, j] = (max(value, old[0]), old[1] + sum(runs))
    for (name, j), (value, run) in seen.items():
        what = {"tau": "torque", "dq": "speed", "i": "current"}[name]
        out.append(
            Finding("saturated", "error", joints[j], f"the {what} sits at {value:.5g} for {run} samples",
                    "a signal inside its range", "the drive or the logger clips: lower the demand or widen the range", value)
        )  # fmt: skip
    return out


def readings(t: SignalSums, joints: Sequence[str]) -> list[Finding]:
    """Readings that are none: angles that jump, signals that never change while the joint moves."""
    out = []
    for j, joint in enumerate(joints):
        jumps = [x for x in t.jumps_of_q if x.joint == j]
        if jumps:
            first = jumps[0]
            turn = abs(abs(first.size) / (2 * np.pi) - 1) < AGREES / 10
            seen = f"q jumps by {first.size:.3g} rad at {first.t:.4g} s of {first.label}" + (
                f", {len(jumps)} times in all" if len(jumps) > 1 else ""
            )
            do = "unwrap the angle" if turn else "remove such readings, or look whether an encoder was set anew"
            out.append(Finding("jump", "error", joint, seen, "a step that dq explains", do, first.size))
    moved = _moved(t)
    for name, span, moves in (("tau", t.range_tau, moved), ("q", t.range_q, np.abs(t.range_dq).max(axis=1) > MOVING)):
        for k in np.flatnonzero(moves & (span[:, 0] == span[:, 1])):
            out.append(
                Finding("frozen", "error", joints[int(k)], f"{name} is {span[k, 0]:.4g} throughout while the joint moves", "a reading",
                        "nobody recorded it: look for the channel", float(span[k, 0]))
            )  # fmt: skip
    return out


def velocity(t: SignalSums, joints: Sequence[str], meta: Meta) -> list[Finding]:
    """dq that is not the derivative of q: unit, sign, lag, unrelated; or derived though called measured."""
    out: list[Finding] = []
    aa, ab, bb = t.travel
    moved = _moved(t)
    period = float(np.median(t.period)) if t.period else float("nan")
    clear: dict[int, float] = {}
    for j, joint in enumerate(joints):
        if not moved[j] or aa[j] <= 0:
            continue
        k = ab[j] / aa[j]
        r = ab[j] / np.sqrt(aa[j] * bb[j]) if bb[j] > 0 else 0.0
        meaning = next((m for ratio, m in RATIOS.items() if abs(k / ratio - 1) < AGREES), None)
        if abs(r) < CORRELATED:
            seen = "dq is zero while q moves" if bb[j] == 0 else f"dq follows the motion of q with a correlation of {r:.2f}"
            out.append(
                Finding("dq_not_derivative", "error", joint, seen, "dq = dq/dt", "columns may be swapped: mend them", float(r))
            )
        elif abs(k - 1) > AGREES and (meaning or r < CLEAR):
            kind = "dq_scale" if not meaning else "wrong_unit" if k > 0 else "dq_not_derivative"
            seen = f"dq is {k:.4g} times the derivative of q" + (f" ({meaning})" if meaning else "")
            out.append(Finding(kind, "error", joint, seen, "1 (rad, rad/s, s)", "convert the columns to SI", float(k)))
        else:
            if r > CLEAR:
                clear[j] = float(k)
            out += _lag(t, j, joint, period)
    return out + _scaled(clear, joints) + _derived(t, joints, meta, period)


def _scaled(scale: dict[int, float], joints: Sequence[str]) -> list[Finding]:
    """A measured dq that is more or less than the derivative of q, by no unit's factor: of all joints alike it is the clock."""
    k = np.array(list(scale.values()))
    if len(k) > 1 and np.ptp(k) < ALIKE and abs(np.median(k) - 1) > OFF_RATE:
        ratio = float(np.median(k))
        seen = f"dq of all joints that move is {ratio:.4g} times the derivative of q: t runs {abs(ratio - 1):.1%} {'fast' if ratio > 1 else 'slow'}"
        return [Finding("clock_scale", "error", None, seen, "1", f"divide t by {ratio:.4g}, or correct dq", ratio)]
    return [
        Finding("dq_scale", "warning" if abs(v - 1) < AGREES else "error", joints[j],
                f"dq is {v:.4g} times the derivative of q", f"1 to {OFF_RATE:.0%}",
                "look for a gear ratio or a calibration of dq that is off", v)
        for j, v in scale.items()
        if abs(v - 1) > OFF_RATE
    ]  # fmt: skip


def _moved(t: SignalSums) -> NDArray[np.bool_]:
    """(n,) whether a joint went further than the steps of its encoder, and than many windows of noise at standstill add up to."""
    step = np.where(np.isfinite(t.resolution), t.resolution, 0.0)
    return np.asarray(t.travel[0] > np.maximum((30 * step) ** 2, t.windows * (STILL * step) ** 2))


def _lag(t: SignalSums, j: int, joint: str, period: float) -> list[Finding]:
    c = t.lagged[:, j]
    k = int(np.argmin(c))
    bend = c[max(k - 1, 0)] - 2 * c[k] + c[min(k + 1, len(c) - 1)]
    part = 0.5 * (c[k - 1] - c[k + 1]) / bend if 0 < k < len(c) - 1 and bend > 0 else 0.0
    lag = (k - LAGS + part) * period
    least = "at least " if k in (0, len(c) - 1) else ""
    # a lag counts when putting it right removes half of the difference
    if abs(k - LAGS + part) < 0.75 or c[k] > 0.5 * c[LAGS]:
        return []
    return [
        Finding("dq_lags", "warning", joint,
                f"dq is {least}{abs(lag) * 1e3:.1f} ms {'behind' if lag > 0 else 'ahead of'} the derivative of q",
                f"less than a sample, {period * 1e3:.3g} ms", "dq is filtered or stamped apart: record it raw", float(lag))
    ]  # fmt: skip


def _derived(t: SignalSums, joints: Sequence[str], meta: Meta, period: float) -> list[Finding]:
    """A velocity without noise of its own is a difference of q: dq = dq/dt then holds by construction, not by measurement."""
    if meta.velocity == "derived" or t.samples == 0:
        return []
    names = []
    for j, joint in enumerate(joints):
        grain = t.resolution[j] * 0.29 / period  # noise that the encoder's steps leave in a difference of q
        rms = np.sqrt(t.difference[:, j].min() / t.samples)
        if np.isfinite(grain) and grain > 1e-4 and rms < 0.1 * grain and t.speed2[j] > 0:
            names.append(joint)
    if not names:
        return []
    return [
        Finding("velocity_derived", "warning", None, f"dq of {', '.join(names)} is a difference of neighbouring q",
                "a measured velocity, as the metadata says", 'set velocity to "derived" in the metadata')
    ]  # fmt: skip


def torque_sign(t: SignalSums, joints: Sequence[str], *, compensated: bool) -> list[Finding]:
    """Wrong sign of torque, from friction alone: against a joint that turns round, or ``compensated`` for that, in what it takes in."""
    return _by_power(t, joints) if compensated else _by_reversals(t, joints)


def _by_reversals(t: SignalSums, joints: Sequence[str]) -> list[Finding]:
    """Each joint by its own steps; where these together say it of the arm, every joint whose torque steps down."""
    judged = np.flatnonzero(_moved(t) & (t.turns[0] >= FEWEST_TURNS))
    count, total, squares = t.turns[:, judged]
    step = total / count
    error = np.sqrt(np.maximum(squares / count - step**2, 0.0) / (count - 1))
    sure = stats.norm.ppf(np.clip(stats.t.cdf(step / np.maximum(error, 1e-9), count - 1), 1e-12, 1 - 1e-12))
    together = len(judged) > 1 and float(sure.sum()) < -TURNED * np.sqrt(len(judged)) and int((step < 0).sum()) * 2 > len(judged)
    do = "turn the sign of tau, of all joints as it seems" if together else "turn the sign of tau (or of q and dq)"
    return [
        Finding("wrong_sign", "error", joints[int(judged[k])],
                f"at {int(count[k])} reversals the torque steps by {2 * step[k]:.3g} +- {2 * error[k]:.2g} N m along the new direction",
                "a step up, as friction makes it in torque and motion of one clock", do, float(step[k]))
        for k in np.flatnonzero((step < 0) if together else sure < -TURNED)
    ]  # fmt: skip


def _by_power(t: SignalSums, joints: Sequence[str]) -> list[Finding]:
    out = []
    net, gross = t.power
    moved = _moved(t)
    for j, joint in enumerate(joints):
        if moved[j] and net[j] < -0.15 * gross[j]:
            out.append(
                Finding("wrong_sign", "error", joint,
                        f"the torque takes energy out of the motion ({100 * net[j] / gross[j]:.0f} % net power)",
                        "energy put in, to feed friction", "turn the sign of tau (or of q and dq)", float(net[j] / gross[j]))
            )  # fmt: skip
    return out


def torque_scale(
    scale: Array, std: Array, joints: Sequence[str], gear: Array, constant: Array, right: tuple[float, float] = RIGHT
) -> list[Finding]:
    """Wrong unit or sign of torque against the robot's own model: ``scale`` (n,) measured over modelled rigid-body torque."""
    out = []
    for j, joint in enumerate(joints):
        k = float(scale[j])
        if not np.isfinite(k) or not np.isfinite(std[j]) or std[j] > 0.1 * abs(k):
            continue  # the motion does not tell
        if right[0] < k < right[1]:
            continue
        if k < 0 and right[0] < -k < right[1]:
            out.append(
                Finding("wrong_sign", "error", joint, f"the torque is {k:.3g} times what the rigid body needs", "about 1",
                        "turn the sign of tau", k)
            )  # fmt: skip
            continue
        known = {
            1e3: "it is in mN m", 1e-3: "it is in kN m", 1 / gear[j]: "it is motor side: times the gear ratio",
            1 / constant[j]: "it is in ampere: times the torque constant", 100.0: "it is in N cm",
        }  # fmt: skip
        near = min((abs(np.log(abs(k) / r)), m) for r, m in known.items() if np.isfinite(r) and r > 0)
        explained = near[0] < 0.4
        alike = np.isfinite(scale) & (np.abs(np.log(np.abs(np.where(scale == 0, 1e-12, scale)) / abs(k))) < np.log(3))
        seen = f"the torque is {k:.3g} times what the rigid body needs" + (f" ({near[1]})" if explained else "")
        # by a factor no unit explains, it is a payload, the CAD or a gain rather than a column in another unit
        sure = explained or (alike.sum() > 1 and not RIGHT_TORN[0] < abs(k) < RIGHT_TORN[1])
        do = "convert tau, or correct gear ratio and torque constant" if sure else "a payload, or a wrong CAD or gain: check them"
        out.append(Finding("wrong_unit" if sure else "torque_scale", "error" if sure else "warning", joint, seen,
                           "about 1, N m on the link side", do, k))  # fmt: skip
    return out


def torque_delay(
    common: float, std: float, joint: Array, joint_std: Array, period: float, joints: Sequence[str], least: float = DELAY
) -> list[Finding]:
    """Torque stamped apart from the motion: all joints alike (clocks), or one apart from the rest (its drive)."""
    least = max(least, 0.6 * period)
    own = max(OWN_DELAY, least, 1.2 * period)

    def significant(d: float, s: float, limit: float) -> bool:
        return bool(np.isfinite(d) and np.isfinite(s) and abs(d) > max(limit, 4 * s))

    def finding(name: str | None, d: float, s: float, against: str, least: float) -> Finding:
        seen = f"the torque is {abs(d) * 1e3:.1f} +- {s * 1e3:.1f} ms {'late' if d < 0 else 'early'} against {against}"
        return Finding("torque_delay", "warning", name, seen, f"less than {least * 1e3:.1f} ms",
                       "identification takes a common delay out; look for different clocks or a filter", d)  # fmt: skip

    out = [finding(None, common, std, "the motion", least)] if significant(common, std, least) else []
    for j, name in enumerate(joints):
        d, s = float(joint[j] - common), float(np.hypot(joint_std[j], std))
        if significant(d, s, own):
            out.append(finding(name, d, s, "the other joints'", own))
    return out


def torque_beyond(end: float) -> list[Finding]:
    """All joints' torque farther from the motion than was searched, up to ``end`` [s]; 0: it is not."""
    if not end:
        return []
    return [
        Finding("torque_delay", "error", None, f"the torque of all joints is more than {abs(end) * 1e3:.0f} ms {'late' if end < 0 else 'early'} "
                "against the motion", "torque and motion of one clock", "put them on one: such a lag looks like friction and inertia", end)
    ]  # fmt: skip


def torque_smoothed(cutoff: float) -> list[Finding]:
    """A low-pass without phase that the torque went through before it was recorded, where one was found: ``cutoff`` [Hz] above 0."""
    if not cutoff:
        return []
    return [
        Finding("torque_smoothed", "warning", None,
                f"the torque went through a low-pass of about {cutoff:.2g} Hz, forwards and backwards, so that friction turns over "
                f"{TURNS_OVER / cutoff:.2g} s too slowly at every reversal",
                "torque as the drives report it", "record it unfiltered; identification passes its model through the same filter",
                cutoff)
    ]  # fmt: skip


def mounted(gravity: Array, angle: float, described: Array) -> list[Finding]:
    """The arm hangs or stands otherwise than described: ``gravity`` [m/s^2] (3,) that its torque asks for, ``angle`` [rad] from the ``described``."""

    def numbers(x: Array) -> str:
        return ", ".join(f"{v:.3g}" for v in np.round(x, 2) + 0.0)

    return [
        Finding("mounting", "error", None,
                f"the torque is that of an arm with gravity along [{numbers(gravity)}] m/s^2 in its base frame, {np.degrees(angle):.0f} degrees "
                "from the description's",
                f"gravity as described, [{numbers(described)}]",
                f'if the arm is mounted so, say "gravity": [{numbers(gravity)}] in robot.json; else look at zeros and axes of the joints', angle)
    ]  # fmt: skip


def description(off: float) -> list[Finding]:
    """Rigid body and friction ask for a description ``off`` by so many times its tolerance; what `identify` says, too."""
    if off <= NOTABLY_OFF:
        return []
    another = off >= ANOTHER_ARM
    return [
        Finding("description", "warning" if another else "note", None,
                f"the torque contradicts the robot's description: its masses, centres and inertias would be {off:.1f} times as far off as "
                "descriptions are",
                "the description of this arm, as it is mounted, with what it carries",
                f"look whether it is another arm's{another_arm(off)}" if another else "go on: identification believes it as much less",
                off)
    ]  # fmt: skip


def torque_limits(t: SignalSums, joints: Sequence[str], limit: Array) -> list[Finding]:
    """More torque than the drive has."""
    top = np.abs(t.range_tau).max(axis=1)
    return [
        Finding("wrong_unit", "error", joint, f"the torque reaches {top[j]:.4g}", f"at most the drive's {limit[j]:.4g} N m",
                "convert tau to N m on the link side, or correct the data sheet", float(top[j]))
        for j, joint in enumerate(joints)
        if np.isfinite(limit[j]) and np.isfinite(top[j]) and top[j] > 3 * limit[j]
    ]  # fmt: skip
