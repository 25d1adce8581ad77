"""One pass over the recordings for all that must be known before the sets: grid, domain, noise, motions, a sample of trials."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from stopset.errors import RecordingError
from stopset.offline.campaign.calibration import split
from stopset.offline.campaign.independence import Ends, independent_motions
from stopset.offline.campaign.noise import NoiseEstimate
from stopset.offline.campaign.reading_error import ReadingError
from stopset.offline.campaign.session import Session
from stopset.offline.campaign.trials import Source
from stopset.recording import Recording, SuiteKey
from stopset.recording.repetition import POWERED
from stopset.recording.types import Spike
from stopset.sets import Box
from stopset.types import Array

JITTER = 0.05  # of a step: stamps this near to their neighbour's plus a step count as even
DRIFT = 0.5  # steps: a clock that has run off the grid by more is resampled, however even its stamps are
KEEP = 256  # trials kept for fits that need them in memory
STOPS = ("stop0", "stop1")


@dataclass(frozen=True, slots=True)
class Survey:
    """What one pass found; ``sample``: at most `KEEP` trials of the phase the sets rest on, evenly over the campaign."""

    phase: str
    dt: float
    trials: int
    samples: int
    longest: float  # [s]
    places: int  # trials of the whole campaign, all phases
    motion: dict[SuiteKey, int]
    readings: ReadingError
    late: Array  # (n,) [s] by which velocities come after the slope of their positions
    q: Box
    dq: Box
    tau: Box
    temp: Box | None
    sample: tuple[Recording, ...]
    irregular: bool
    session: Session  # what warming is counted in: that of the nominal model where one is given
    learnt: frozenset[SuiteKey] = frozenset()  # suites that a nominal model that is given was fitted to
    low_pass: float = 0.0  # [Hz] of the filter that the recorded torque went through; 0: none was found, or looked for
    means: Array | None = None  # (trials, n) mean temperature [degC] of each trial of the phase where it is measured
    polled: tuple[int, int] = (0, 0)  # readings that a logger wrote again, and passed over, see `on_its_clock`; as `spikes`
    held: float = 1.0  # rows in which a reading stood, at most, see `each_once`
    spikes: tuple[tuple[str, Spike], ...] = ()  # trial and torque, for which the reader left a sample out; of all phases

    @property
    def learnt_motions(self) -> frozenset[int]:
        """Motions that a given nominal model was fitted to: they can judge nothing."""
        return frozenset(self.motion[s] for s in self.learnt if s in self.motion)

    @property
    def held_out(self) -> frozenset[SuiteKey]:
        """Suites of the motions that nothing is fitted to: on them the sets are judged."""
        return _held(self.motion, self.learnt)

    def within(self, horizon: float) -> float:
        """How far ahead [s] is predicted at most: as asked, but not beyond the longest trial."""
        return min(horizon, self.longest)

    def warm(self, r: Recording) -> float:
        """How long the drives have been running, 0 to 1 (see `Session`)."""
        return self.session.warm(r)


def on_grid(r: Recording, dt: float) -> Recording:
    """The recording on the grid ``k dt``, linearly interpolated; itself if it is there already."""
    if np.abs(np.diff(r.t) - dt).max() <= JITTER * dt and np.abs(r.t - r.t[0] - dt * np.arange(len(r.t))).max() <= DRIFT * dt:
        return r
    t = np.arange(r.t[0], r.t[-1] + 1e-9, dt)

    def sampled(x: Array | None) -> Array | None:
        return None if x is None else np.column_stack([np.interp(t, r.t, c) for c in x.T])

    trigger = None if r.stop_trigger is None else np.interp(t, r.t, r.stop_trigger.astype(float)) > 0.5
    q, dq, tau = sampled(r.q), sampled(r.dq), sampled(r.tau)
    assert q is not None and dq is not None and tau is not None
    return replace(
        r,
        t=t,
        q=q,
        dq=dq,
        tau=tau,
        temp=sampled(r.temp),
        current=sampled(r.current),
        q_link=sampled(r.q_link),
        stop_trigger=trigger,
    )


def _held(motion: dict[SuiteKey, int], learnt: frozenset[SuiteKey]) -> frozenset[SuiteKey]:
    fitted = {motion[s] for s in learnt if s in motion}
    held = split(sorted(set(motion.values()))).held
    return frozenset(s for s, m in motion.items() if m in held and m not in fitted)


@dataclass(slots=True)
class Tally:
    """What a survey counts, fed trial by trial in campaign order; later recordings can be added to it."""

    phase: str
    torques: dict[SuiteKey, Array] = field(default_factory=dict)  # of one trial of each suite
    ends: dict[SuiteKey, Ends] = field(default_factory=dict)
    repeats: dict[SuiteKey, int] = field(default_factory=dict)
    steps: list[float] = field(default_factory=list)  # median step of each trial [s]
    means: list[Array] = field(default_factory=list)
    hulls: dict[str, Box] = field(default_factory=dict)
    noise: NoiseEstimate = field(default_factory=NoiseEstimate)
    places: int = 0
    samples: int = 0
    longest: float = 0.0
    irregular: bool = False
    conditions: set[str] = field(default_factory=set)
    spikes: list[tuple[str, Spike]] = field(
        default_factory=list
    )  # see `Survey`; of what this one was fed, no kept state has them
    polled: tuple[int, int] = (0, 0)
    held: float = 1.0
    retained: list[Recording] = field(default_factory=list)
    stride: int = 1

    def add(self, r: Recording) -> None:
        """Take one trial in."""
        self.places = max(self.places, r.place + 1)
        self.conditions.add(r.condition)
        self.spikes += [(r.label, x) for x in r.spikes]
        self.polled = (self.polled[0] + r.again, self.polled[1] + r.skipped)
        self.held = max(self.held, r.held)
        if r.phase != self.phase or len(r.t) < 3:
            self.noise.add(r)
            return
        self.steps.append(float(np.median(np.diff(r.t))))
        grid = on_grid(r, self.steps[-1])
        self.irregular |= grid is not r
        self.noise.add(grid, self.steps[-1])
        for name, x in (("q", r.q), ("dq", r.dq), ("tau", r.tau), ("temp", r.temp)):
            if x is not None:
                self.hulls[name] = self.hulls[name] | Box.hull(x) if name in self.hulls else Box.hull(x)
        if r.temp is not None:
            self.means.append(r.temp.mean(axis=0))
        self.torques.setdefault(r.suite_key, r.tau)
        ends = Ends.of(r)
        self.ends[r.suite_key] = self.ends[r.suite_key].until(ends) if r.suite_key in self.ends else ends
        self.repeats[r.suite_key] = self.repeats.get(r.suite_key, 0) + 1
        if (len(self.steps) - 1) % self.stride == 0:
            self.retained.append(r)
            if len(self.retained) > KEEP:
                self.retained, self.stride = self.retained[::2], 2 * self.stride
        self.samples += len(r.t)
        self.longest = max(self.longest, float(r.t[-1] - r.t[0]))

    def survey(
        self, learnt: frozenset[SuiteKey] = frozenset(), session: Session | None = None, dt: float | None = None
    ) -> Survey:
        """What was found; the arguments come with a nominal model that is given, see `Survey`.

        Raises `RecordingError` if no trial has powered motion.
        """
        if not self.steps:
            raise RecordingError("no trial has three samples of powered motion; expected phase open_loop or closed_loop")
        motion = independent_motions(self.torques, self.ends)
        held = _held(motion, learnt)
        return Survey(
            phase=self.phase, dt=round(float(np.median(self.steps)), 6) if dt is None else dt, trials=len(self.steps),
            samples=self.samples, longest=self.longest, places=self.places, motion=motion,
            readings=self.noise.error(held), late=self.noise.late(held), q=self.hulls["q"], dq=self.hulls["dq"], tau=self.hulls["tau"],
            temp=self.hulls.get("temp"), sample=tuple(self.retained), irregular=self.irregular,
            session=session or Session(max(self.repeats.values()), self.places), learnt=learnt, means=np.array(self.means) if self.means else None,
            spikes=tuple(self.spikes),
            polled=self.polled, held=self.held,
        )  # fmt: skip


def survey(source: Source) -> Survey:
    """Read all trials once. Raises `RecordingError` if no trial has powered motion."""
    return tallied(source)[0].survey()


def tallied(source: Source) -> tuple[Tally, list[Recording]]:
    """The counts of a survey, and the stops, which are short and needed whole.

    Raises `RecordingError` if no phase has powered motion.
    """
    tally, stops = Tally(_phase(source)), []
    for r in source():
        tally.add(r)
        if r.phase in STOPS:
            stops.append(r)
    return tally, stops


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
