"""One pass over the recordings for all that must be known before the sets: grid, domain, noise, motions, a sample of trials."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stopset.errors import RecordingError
from stopset.offline.conform.guarantee import split
from stopset.offline.conform.noise import NoiseEstimate
from stopset.offline.motions import Suite, independent_motions
from stopset.recording import Recording
from stopset.sets import Box

Array = NDArray[np.float64]
Source = Callable[[], Iterable[Recording]]  # gives the trials anew at every call

KEEP = 256  # trials kept for fits that need them in memory
REPEATED = 6  # repetitions of one suite from which on the repetition, not the place in the session, is the time of warming
# which phases the powered sets rest on, best first: open loop lets the states diverge as a prediction does
POWERED = ("open_loop", "closed_loop")


@dataclass(frozen=True, slots=True)
class Survey:
    """What one pass found; ``sample``: at most `KEEP` trials of the phase the sets rest on, evenly over the campaign."""

    phase: str
    dt: float
    trials: int
    samples: int
    longest: float  # [s]
    places: int  # trials of the whole campaign, all phases: what `warm` is counted in
    motion: dict[Suite, int]
    noise: Box
    q: Box
    dq: Box
    tau: Box
    temp: Box | None
    sample: tuple[Recording, ...]
    irregular: bool
    repeats: int  # most trials of one suite

    @property
    def held_out(self) -> frozenset[Suite]:
        """Suites of the motions that nothing is fitted to: on them the sets are judged."""
        held = split(sorted(set(self.motion.values()))).held
        return frozenset(s for s, m in self.motion.items() if m in held)

    def warm(self, r: Recording) -> float:
        """How long the drives have been running, 0 to 1: the variable of warming where no temperature is recorded.

        The repetition within a suite where suites are repeated (each starts anew), else the place in the session.
        """
        if self.repeats >= REPEATED:
            return min(r.trial / (self.repeats - 1), 1.0)
        return r.place / max(self.places - 1, 1)


def on_grid(r: Recording, dt: float) -> Recording:
    """The recording on the grid ``k dt``, linearly interpolated; itself if it is there already."""
    if np.abs(np.diff(r.t) - dt).max() <= 0.05 * dt:
        return r
    t = np.arange(r.t[0], r.t[-1] + 1e-9, dt)

    def sampled(x: Array | None) -> Array | None:
        return None if x is None else np.column_stack([np.interp(t, r.t, c) for c in x.T])

    trigger = None if r.stop_trigger is None else np.interp(t, r.t, r.stop_trigger.astype(float)) > 0.5
    q, dq, tau = sampled(r.q), sampled(r.dq), sampled(r.tau)
    assert q is not None and dq is not None and tau is not None
    return replace(r, t=t, q=q, dq=dq, tau=tau, temp=sampled(r.temp), current=sampled(r.current), stop_trigger=trigger)


def survey(source: Source) -> Survey:
    """Read all trials once. Raises `RecordingError` if no trial has powered motion."""
    chosen = _phase(source)
    kept: list[Recording] = []
    stride, seen, places, samples, longest = 1, 0, 0, 0, 0.0
    torques: dict[Suite, Array] = {}
    repeats: dict[Suite, int] = {}
    steps: list[float] = []
    irregular = False
    noise = NoiseEstimate()
    hulls: dict[str, Box] = {}
    for r in source():
        places = max(places, r.place + 1)
        noise.add(r)
        if r.phase != chosen or len(r.t) < 3:
            continue
        for name, x in (("q", r.q), ("dq", r.dq), ("tau", r.tau), ("temp", r.temp)):
            if x is not None:
                hulls[name] = hulls[name] | Box.hull(x) if name in hulls else Box.hull(x)
        torques.setdefault(r.motion, r.tau)
        repeats[r.motion] = repeats.get(r.motion, 0) + 1
        steps.append(float(np.median(np.diff(r.t))))
        irregular |= bool(np.abs(np.diff(r.t) - steps[-1]).max() > 0.05 * steps[-1])
        samples += len(r.t)
        longest = max(longest, float(r.t[-1] - r.t[0]))
        if seen % stride == 0:
            kept.append(r)
            if len(kept) > KEEP:
                kept, stride = kept[::2], 2 * stride
        seen += 1
    if not seen:
        raise RecordingError("no trial has three samples of powered motion; expected phase open_loop or closed_loop")
    motion = independent_motions(torques)
    held = split(sorted(set(motion.values()))).held
    return Survey(
        phase=chosen, dt=round(float(np.median(steps)), 6), trials=seen, samples=samples, longest=longest, places=places,
        motion=motion, noise=noise.box(without={s for s, m in motion.items() if m in held}),
        q=hulls["q"], dq=hulls["dq"], tau=hulls["tau"],
        temp=hulls.get("temp"), sample=tuple(kept), irregular=irregular, repeats=max(repeats.values()),
    )  # fmt: skip


def _phase(source: Source) -> str:
    """The best phase there is; reading stops as soon as that is known."""
    found: set[str] = set()
    for r in source():
        found.add(r.phase)
        if r.phase == POWERED[0]:
            break
    for phase in POWERED:
        if phase in found:
            return phase
    raise RecordingError(
        f"only phases {', '.join(sorted(found)) or 'none'} are recorded; the sets need open_loop (best) or closed_loop trials"
    )
