"""Torque against friction and the robot's own rigid body: sign, unit, delay, mounting, another arm's description."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtr

from stopset.offline.inspect.finding import Finding
from stopset.offline.inspect.tally import SignalSums
from stopset.offline.nominal.fit import ANOTHER_ARM, NOTABLY_OFF, another_arm
from stopset.offline.nominal.low_pass import TURNS_OVER
from stopset.offline.nominal.scale import Rubbing
from stopset.recording.types import Spike
from stopset.types import Array

RIGHT = (0.4, 2.5)  # measured over modelled torque: payload, drive gain and CAD errors live here
RIGHT_TORN = (0.1, 10.0)  # the same where samples were lost and stamps made up, so that accelerations are wrong
OWN_DELAY = 0.01  # [s] of one joint against the others: below, unmodelled friction looks alike
FEWEST_TURNS = 4  # reversals of a joint from which on their scatter is known at all
TURNED = 3.5  # standard deviations below zero: by chance in one of 4000 joints whose sign is right and that have no friction
SHARES = {100.0: "per cent", 1000.0: "per mille"}  # of a drive's torque, as controllers report it
PUSHES = 5.0  # standard errors below zero that friction at a joint's usual speed must be to be none
OF_SPEED = 0.25  # of the torque, root mean square, that falls with speed; less is what a sensor behind a gear errs by
PEAK = 4.0  # a drive's torque limit over the rated torque that its reports count in, at most
LESS = 0.8  # measured over modelled torque below which neither a load nor a description that is off leaves it
SHOWN = 5  # moments that are told by their time
DELAY_COMPENSATED = 0.015  # [s] of compensated torque, in which stiction and errors of the compensation look like delay
DELAY = 0.003  # [s] of torque against motion that friction and inertia would swallow


def torque_sign(t: SignalSums, joints: Sequence[str], *, compensated: bool) -> list[Finding]:
    """Wrong sign of torque, from friction alone: against a joint that turns round, or ``compensated`` for that, in what it takes in."""
    return _by_power(t, joints) if compensated else _by_reversals(t, joints)


def _by_reversals(t: SignalSums, joints: Sequence[str]) -> list[Finding]:
    """Each joint by its own steps; where these together say it of the arm, every joint whose torque steps down."""
    judged = np.flatnonzero(t.moved & (t.turns[0] >= FEWEST_TURNS))
    count = t.turns[0, judged]
    step, error, sure = _steps(t.turns[:, judged])
    together = len(judged) > 1 and float(sure.sum()) < -TURNED * np.sqrt(len(judged)) and int((step < 0).sum()) * 2 > len(judged)
    do = "turn the sign of tau, of all joints as it seems" if together else "turn the sign of tau (or of q and dq)"
    return [
        Finding("wrong_sign", "error", joints[int(judged[k])],
                f"at {int(count[k])} reversals the torque steps by {2 * step[k]:.3g} +- {2 * error[k]:.2g} N m along the new direction",
                "a step up, as friction makes it in torque and motion of one clock", do, float(step[k]))
        for k in np.flatnonzero((step < 0) if together else sure < -TURNED)
    ]  # fmt: skip


def _steps(turns: Array) -> tuple[Array, Array, Array]:
    """Mean half step [N m] of each joint, its error, and how sure it is one up, in standard deviations; ``turns`` (3, k) as `SignalSums` has."""
    count, total, squares = turns
    step = total / count
    error = np.sqrt(np.maximum(squares / count - step**2, 0.0) / (count - 1))
    return step, error, ndtri(np.clip(stdtr(count - 1, step / np.maximum(error, 1e-9)), 1e-12, 1 - 1e-12))


def rises(turns: Array) -> NDArray[np.bool_]:
    """(n,) whether a joint's torque surely steps up where it turns round, as friction makes it where the sign is right."""
    out = np.asarray(turns[0] >= FEWEST_TURNS)
    _, _, sure = _steps(turns[:, out])
    out[out] = sure > TURNED
    return out


def balanced(f: Finding) -> Finding:
    """Of a torque that falls where the rigid body's rises, though friction shows that its sign is right."""
    return replace(
        f, kind="torque_scale", severity="warning", seen=f"{f.seen}, but it steps up where the joint turns round, as friction makes it",
        do="the sign is right: what balances the arm bears more than it weighs, or masses and centres are others: check them",
    )  # fmt: skip


def _by_power(t: SignalSums, joints: Sequence[str]) -> list[Finding]:
    out = []
    net, gross = t.power
    moved = t.moved
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
        if not np.isfinite(k) or not np.isfinite(std[j]) or std[j] > 0.1 * abs(k) or k == 0:
            continue  # the motion does not tell, or nobody recorded a torque
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


def torque_shares(scale: Array, std: Array, joints: Sequence[str], limit: Array) -> list[Finding]:
    """Torque in shares of what each drive has: ``scale`` (n,) measured over modelled, the smaller the larger the drive's ``limit`` (n,) [N m].

    A load makes a scale larger, most at the small joints, and looks like this; nothing makes it smaller, so one joint must show less
    torque than the bare arm needs.
    """
    with np.errstate(invalid="ignore"):
        sure = np.flatnonzero((scale > 0) & (std < 0.1 * scale) & np.isfinite(limit) & (limit > 0))
    if len(sure) < 2:
        return []
    k, share = scale[sure], scale[sure] * limit[sure]
    spread = float(share.max() / share.min())
    if (k + 2 * std[sure]).min() > LESS or spread > 2 or k.max() / k.min() < 2 * spread:
        return []
    middle = float(np.sqrt(share.max() * share.min()))
    unit = next((u for full, u in SHARES.items() if 0.5 * full < middle < PEAK * full), None)
    if unit is None:
        return []
    seen = ", ".join(f"{joints[j]} {scale[j]:.3g} ({limit[j]:.3g} N m)" for j in sure.tolist())
    return [
        Finding("wrong_unit", "error", None,
                f"the torque over what the rigid body needs falls with what the drives have: {seen}; it is in {unit} of it",
                "about 1, N m on the link side", f"convert tau: times the drive's rated torque over {100 if unit == 'per cent' else 1000}", middle)
    ]  # fmt: skip


def spikes(seen: Sequence[tuple[str, Spike]], joints: Sequence[str]) -> list[Finding]:
    """Samples left out for a torque that is none; ``seen``: with the labels of their trials."""
    return [
        Finding("torque_spike", "warning", joints[x.joint], f"{_stands_out(seen, x)}, in the middle of a motion that goes on as before",
                "a torque that moves the arm", "those samples were left out, as lost ones, by every command; look at the bus or the logger",
                x.size)
        for x in _largest(seen)
    ]  # fmt: skip


def torque_peaks(seen: Sequence[tuple[str, Spike]], joints: Sequence[str]) -> list[Finding]:
    """Torques of one sample that have a reason in the motion, or may have."""
    return [
        Finding("torque_peak", "note", joints[x.joint], f"{_stands_out(seen, x)}, where a joint stands or speed or torque go on otherwise",
                "a motion that is led to rest and samples that show what a torque does in between",
                "look what happens there, a programme that is broken off or a blow: the sets enclose it and are as wide as it is; leave it out "
                "only if the arm never does it", x.size)
        for x in _largest(seen)
    ]  # fmt: skip


def _largest(seen: Sequence[tuple[str, Spike]]) -> list[Spike]:
    return [max((x for _, x in seen), key=lambda x: abs(x.size))] if seen else []


def _stands_out(seen: Sequence[tuple[str, Spike]], largest: Spike) -> str:
    at = list(dict.fromkeys(f"{x.t:.4g} s of {label}" for label, x in seen))
    more = f" and {len(at) - SHOWN} more times" if len(at) > SHOWN else ""
    return f"at {', '.join(at[:SHOWN])}{more} a torque stands out for one sample, by up to {abs(largest.size):.3g} N m from both beside it"


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


def misplaced(joints: Sequence[str], better: float, *, motion: bool) -> list[Finding]:
    """Columns of ``joints`` that stand in each other's place, of torque alone or with the ``motion``; ``better``: log of all joints' errors."""
    names = " and ".join(joints) if len(joints) == 2 else "all joints"
    turned = "exchanged" if len(joints) == 2 else "in reverse order"
    what = "angles, speeds and torques" if motion else "torques"
    return [
        Finding("joint_order", "error", None,
                f"{what} of {names} stand in each other's place: {turned}, they are what the robot's rigid body needs",
                "columns under the names of their own joints",
                "exchange them, in all recordings: drivers list joints in an order of their own (ROS: by `name`, not by number)", better)
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


def pushed(seen: Rubbing, joints: Sequence[str]) -> list[Finding]:
    """Torque that steps up where a joint turns round and falls with speed to the other side of zero: no friction does."""
    with np.errstate(invalid="ignore"):
        pushes = -(seen.dry + seen.wet)
        sure = (seen.dry > 0) & (pushes > PUSHES * seen.std) & (-seen.wet > OF_SPEED * seen.size)
    return [
        Finding("torque_lacks_part", "error", joints[j],
                f"whatever the links weigh, the torque falls by {-seen.slope[j]:.3g} N m per rad/s of its speed, so that friction would push "
                f"by {pushes[j]:.3g} +- {seen.std[j]:.1g} N m",
                "a torque that rises with speed, as friction makes it",
                "a part of what drives this joint is not in tau, such as a feed-forward of its speed: record the drive's own torque or current",
                float(seen.slope[j]))
        for j in np.flatnonzero(sure).tolist()
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
