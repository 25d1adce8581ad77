"""Stamps and rows: an uneven clock, lost and repeated samples, a rate that is not the stated one."""

from __future__ import annotations

import numpy as np

from stopset.offline.inspect.finding import Finding
from stopset.offline.inspect.tally import EVEN, SignalSums
from stopset.recording.types import Meta

NOTABLE_GAPS = 1e-4  # share of missing samples
SLOW = 1 / 60  # [s] of a period: the filters of identification need ten samples per period of 6 Hz
TOO_SLOW = 0.5  # [s] between samples: nothing of a motion is left
OFF_RATE = 0.01  # relative: rates further off than this are told


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
    out += _steps(t) if dq_sound else []
    if t.rounded:
        out.append(
            Finding("stamp_digits", "warning", None, f"stamps are printed to {t.rounded * 1e3:.3g} ms at a period of {period * 1e3:.3g} ms",
                    "stamps finer than a tenth of the period",
                    "they lie on an even clock within that, which is what is used; print more digits", t.rounded)
        )  # fmt: skip
    out += _rows(t) + _ends(t)
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


def polled(again: int, skipped: int) -> list[Finding]:
    """Readings of a logger that asked at its own pace, see `on_its_clock`: written ``again`` and left out, and ``skipped``."""
    if not again + skipped:
        return []
    return [
        Finding("repeated_samples", "warning", None,
                f"in mid-motion {again} samples repeat their predecessor and {skipped} were passed over, under even stamps",
                "a new sample at every stamp", "a logger that asks at its own pace writes so: what it wrote again is left out, what it passed "
                "over is a gap, and stamps are those of the robot's clock, in every command; log every message with its own stamp",
                again + skipped)
    ]  # fmt: skip


def held(rows: float) -> list[Finding]:
    """Readings that stood in several ``rows`` each, see `each_once`."""
    if rows <= 1.0:
        return []
    return [
        Finding("held_readings", "warning", None,
                f"each reading of the robot stands in {rows:.3g} rows", "a row per reading",
                "the logger writes faster than the robot answers: every command takes each reading once, at the robot's pace, and derives a dq "
                "that was made from such rows anew; log every message once, with its own stamp", rows)
    ]  # fmt: skip


def _steps(t: SignalSums) -> list[Finding]:
    """Steps of q of nearly two periods of dq: of samples that were lost, or of readings that are not as old as their stamps say."""
    if t.jumps <= max(2, NOTABLE_GAPS * t.samples):
        return []
    if t.lost_under_stamps:
        return [
            Finding("dropped_samples", "error" if t.jumps > 0.005 * t.samples else "warning", None,
                    f"{t.jumps} steps of q are whole multiples of what dq gives over one period",
                    "steps of one period", "samples were lost and the stamps made up: record with real stamps", t.jumps)
        ]  # fmt: skip
    return [
        Finding("uneven_readings", "warning", None,
                f"{t.jumps} steps of q are nearly two periods of dq long and the others short of one, so that none is missing",
                "readings as old as their stamps say",
                "the logger takes what the robot told last, and the robot tells it at a pace of its own: a reading is up to a period off its "
                "stamp, which the sets hold; log every message with its own stamp", t.jumps)
    ]  # fmt: skip


def _ends(t: SignalSums) -> list[Finding]:
    """Where trials begin or end in what a filter made of them."""
    out = []
    if t.settling:
        out.append(
            Finding("start_transient", "warning", None, f"dq does not follow q in the first {t.settling:.3g} s of a trial",
                    "dq = dq/dt from the first sample on", "a filter settles there: begin recording before the motion, or cut it off",
                    t.settling)
        )  # fmt: skip
    return out + [
        Finding(kind, "warning", None, f"in the {which} {seconds:.3g} s of a trial dq contradicts q", "dq = dq/dt throughout",
                "a filter's own start or end is no motion: that part is left out by every command", seconds)
        for kind, which, seconds in (("start_transient", "first", t.bent[0]), ("end_transient", "last", t.bent[1])) if seconds
    ]  # fmt: skip


def _rate(t: SignalSums, meta: Meta) -> list[Finding]:
    """A rate on average that is not the stated one, or not the same in all trials."""
    out = []
    mean = np.array(t.mean_period or t.period)
    usual = float(np.median(mean))
    stated = np.isfinite(meta.rate_hz) and t.held == 1.0  # held readings have a rate of their own
    if stated and abs(usual * meta.rate_hz - 1) > OFF_RATE:
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


def _rows(t: SignalSums) -> list[Finding]:
    """Rows that the reader left out."""
    out = []
    if t.unread:
        out.append(Finding("unread_samples", "warning", None, f"{t.unread} rows hold what is no number", "numbers in every row",
                           "they were left out, as lost samples; look what the logger writes there", t.unread))  # fmt: skip
    if t.twice:
        out.append(Finding("rows_twice", "note", None, f"{t.twice} rows repeat the one before, its stamp too", "each sample once",
                           "they were left out; a logger that listens twice writes so", t.twice))  # fmt: skip
    return out
