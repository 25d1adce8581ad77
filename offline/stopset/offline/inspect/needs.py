"""What each part of an identification needs from the recordings, and which of it is not there."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from stopset.offline.campaign.calibration import FEWEST_MOTIONS, HELD_OUT_EVERY, split
from stopset.offline.inspect.tally import MOVING
from stopset.types import Array

POSES = 20  # static poses from both sides: three times the gravity parameters of a usual arm
SLOW, FAST = 0.15, 0.6  # of the speed limit: friction wants both ends of its curve
REPEATS = 3  # trials of one suite, to see what does not repeat
MOTIONS_1_PERCENT = 299  # clean held-out motions for a bound of 1 % at 95 % confidence


@dataclass(frozen=True, slots=True)
class Need:
    """Something identification wants that these recordings do not have."""

    part: str
    lacking: str
    do: str

    @property
    def says(self) -> str:
        return f"{self.part}: {self.lacking}; {self.do}"


def upper_bound(motions: int, confidence: float = 0.95) -> float:
    """Clopper-Pearson bound on the share of violating motions when none of ``motions`` held-out ones violated."""
    return 1.0 if motions == 0 else 1.0 - (1.0 - confidence) ** (1.0 / motions)


@dataclass(frozen=True, slots=True)
class Inventory:
    """What recordings hold, as far as identification wants it."""

    phases: Collection[str]
    paired_poses: int  # approached from both sides
    speed: Array  # (n, 2) [rad/s] lowest and highest of each joint in motion
    limit: Array | None  # (n,) [rad/s] of the robot if known
    temperature: bool
    effort: str
    repeats: int  # most trials of an open-loop suite
    motions: int  # independent ones in open loop, of which suites may be several starts


def needs(r: Inventory) -> list[Need]:
    """What identification wants and these recordings do not have, in the order of the identification."""
    out: list[Need] = []
    phases, motions = r.phases, r.motions
    if r.effort == "compensated_torque":
        out.append(
            Need(
                "gravity, Coulomb friction",
                "the torque is already compensated (u of eq. 11)",
                "record motor torque to identify them",
            )
        )
    elif r.paired_poses < POSES:
        seen = f"{r.paired_poses} static poses approached from both sides, {POSES} wanted"
        out.append(
            Need("gravity", seen, "add phase static: each pose once from below, once from above; friction cancels in the mean")
        )
    moving = [p for p in ("closed_loop", "open_loop") if p in phases]
    if not moving or not (r.speed[:, 1] > MOVING).any():
        out.append(
            Need("inertia, friction", "no recording in motion", "add phase closed_loop: excitation and PTP, slow and fast")
        )
    elif r.limit is not None:
        out += _speeds(r.speed, r.limit)
    if motions == 0:
        out.append(
            Need(
                "uncertainty sets X0, U",
                "no open-loop suite",
                "add phase open_loop: equal start and torques, several trials per suite",
            )
        )
    else:
        if r.repeats < REPEATS:
            seen = f"at most {r.repeats} trial{'s' if r.repeats != 1 else ''} per open-loop suite, {REPEATS} wanted"
            out.append(Need("what does not repeat", seen, "repeat each suite from the same start with the same torques"))
        held = len(split(range(motions)).held)
        if held < MOTIONS_1_PERCENT:
            seen = f"{motions} independent open-loop motion{'s' if motions != 1 else ''}"
            bound = f"of which {held} are held out: if none violates the sets, at most {100 * upper_bound(held):.1f} % may (95 %)"
            none = f"too few to hold any out and promise something of others; {FEWEST_MOTIONS} begin to"
            do = f"record more motions: {MOTIONS_1_PERCENT} held out and clean, of {HELD_OUT_EVERY * MOTIONS_1_PERCENT}, make it 1 %"
            out.append(Need("guarantee", f"{seen}, {bound if held else none}", do))
    for phase, what in (("stop0", "brake delay, rise and torque; sets of STOP 0"), ("stop1", "sets of STOP 1")):
        if phase not in phases:
            out.append(Need(what, f"no {phase} recording", f"add phase {phase}: stops at several speeds, with stop_trigger"))
    if not r.temperature:
        out.append(
            Need(
                "thermal friction", "no joint temperatures", "record temp_<joint>; warming then shows only over the trial number"
            )
        )
    return out


def _speeds(speed: Array, limit: Array) -> list[Need]:
    slow = [j for j in range(len(limit)) if speed[j, 0] > SLOW * limit[j]]
    fast = [j for j in range(len(limit)) if speed[j, 1] < FAST * limit[j]]
    out = []
    for which, name in ((slow, f"no sample in motion under {100 * SLOW:.0f} %"), (fast, f"no speed above {100 * FAST:.0f} %")):
        if which:
            joints = ", ".join(str(j + 1) for j in which)
            out.append(
                Need(
                    "friction over speed",
                    f"joint {joints}: {name} of the limit",
                    "add PTP motions slow and fast (`stopset plan`)",
                )
            )
    return out
