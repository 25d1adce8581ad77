"""Readings that are none: angles that jump, signals that clip or never change, dq that is not the derivative of q, numbers that lie."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from stopset.offline.inspect.finding import Finding
from stopset.offline.inspect.findings_clock import OFF_RATE
from stopset.offline.inspect.tally import IDLE, LAGS, SignalSums
from stopset.recording.types import Meta, SuiteKey, suite_label

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
ALIKE = 0.005  # scales of all joints this near to each other have one cause
SAME = 3  # trials in which a signal stops at the very same value below its largest
FEWEST_LEVELS = 10  # sizes of torque from which on resting at the largest one says something


def unrepeated(motions: Iterable[SuiteKey]) -> list[Finding]:
    """Open-loop suites whose trials do not repeat one motion; elsewhere a suite is any grouping."""
    held: dict[tuple[int, str, int], int] = {}
    for file, phase, suite, other in motions:
        if phase == "open_loop":
            held[file, phase, suite] = max(held.get((file, phase, suite), 0), other + 1)
    return [
        Finding("suite_of_many", "note", None, f"{suite_label((*suite, 0))} holds {count} motions that do not repeat one another",
                "trials of a suite that start alike and get the same torques", "give every motion a suite of its own; here each "
                "counts as its own, and only what does repeat as a repetition", float(count))
        for suite, count in held.items() if count > 1
    ]  # fmt: skip


def _coarse(t: SignalSums) -> NDArray[np.bool_]:
    """(n,) joints whose torque takes so few values that it rests at the largest one by itself."""
    return np.asarray(t.moved & (t.levels > 1) & (t.levels < FEWEST_LEVELS))


def saturation(t: SignalSums, joints: Sequence[str], meta: Meta) -> list[Finding]:
    """Signals that stop at one value for many samples, and torque of too few digits for that to be told.

    A derived velocity that stays at one value clips nothing: the arm moves evenly.
    """
    coarse = _coarse(t)
    out = [
        Finding("coarse_torque", "warning", joints[j], f"the torque takes {int(t.levels[j])} sizes only", f"{FEWEST_LEVELS} or more",
                "what lies between is unknown and widens the sets: record more digits", float(t.levels[j]))
        for j in range(t.n) if coarse[j]
    ]  # fmt: skip
    top = {"tau": np.abs(t.range_tau).max(axis=1), "dq": np.abs(t.range_dq).max(axis=1)}
    at: dict[tuple[str, int, float], list[int]] = {}
    for name, j, value, run in t.plateaus:
        at.setdefault((name, j, float(f"{value:.5g}")), []).append(run)
    seen: dict[tuple[str, int], tuple[float, int]] = {}
    for (name, j, value), runs in at.items():
        if (name == "tau" and coarse[j]) or (name == "dq" and meta.velocity == "derived"):
            continue
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
    moved = t.moved
    for name, span, moves in (("tau", t.range_tau, moved), ("q", t.range_q, np.abs(t.range_dq).max(axis=1) > IDLE)):
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
    moved = t.moved
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
        if t.moved[j] and np.isfinite(grain) and grain > 1e-4 and rms < 0.1 * grain and t.speed2[j] > 0:
            names.append(joint)
    if not names:
        return []
    return [
        Finding("velocity_derived", "warning", None, f"dq of {', '.join(names)} is a difference of neighbouring q",
                "a measured velocity, as the metadata says", 'set velocity to "derived" in the metadata')
    ]  # fmt: skip
