"""Compare a model with recordings: where it fails, per joint and per motion, and which recordings leave its sets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from stopset.artifact import Model
from stopset.errors import RecordingError
from stopset.notebook import shown
from stopset.offline.abstraction.metrics import AVERAGING, Figures, torque_error
from stopset.offline.abstraction.nominal_part import roller
from stopset.offline.campaign.survey import Survey, on_grid, survey
from stopset.offline.campaign.trials import ReadOnce, Source
from stopset.offline.compare.known import left_over
from stopset.offline.compare.restored import restored
from stopset.offline.conform.envelope import Deviations, Envelope, state_names
from stopset.offline.conform.nonlinear import WINDOWS, starts_in, stride_of
from stopset.offline.conform.nonlinear_sets import thinned, worst_excess
from stopset.offline.conform.tightness import Along, Tightness, of_tube
from stopset.offline.inspect.gate import left_out, unsound
from stopset.offline.nominal.low_pass import recorded_low_pass
from stopset.progress import Progress, silent
from stopset.reach.flowpipe import DeviationTube, deviation_tube
from stopset.reach.nonlinear import predicted_tube
from stopset.reach.predict import predict
from stopset.recording import Meta, Recording, read_meta, sources_of, stream_recordings
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Violation:
    """One recording that leaves the sets: its worst excess, where and when."""

    recording: str
    state: str
    side: str  # "above" | "below"
    start_s: float
    age_s: float
    excess: float  # [rad] or [rad/s]
    relative: float  # in half-widths of the tube there

    @property
    def unit(self) -> str:
        """Of the excess."""
        return "rad/s" if self.state.startswith("dq_") else "rad"


@dataclass(frozen=True, slots=True)
class Row:
    """One recording in the comparison; errors are RMS torque [N m] per joint (n,), ``misfit`` their worst against the floor."""

    label: str
    motion: int
    place: int
    torque_rms: Array
    inside_domain: bool
    violation: Violation | None


@dataclass(frozen=True, slots=True)
class Comparison:
    """What `compare` found; ``figures``: joint -> torque_rmse, torque_rmse_floor, torque_rmse_known, velocity_rmse, position_rmse."""

    figures: dict[str, dict[str, Any]]
    rows: tuple[Row, ...]
    survey: Survey
    trials: Source = field(repr=False)  # that were compared, for whoever looks at them again
    tube: DeviationTube
    tightness: Tightness
    bands: dict[str, tuple[int, int]] = field(default_factory=dict)  # temperature band -> recordings in it, those that leave it
    said: tuple[str, ...] = ()  # sentences: what the monitors that wrote these files took their violations for
    unsound: tuple[str, ...] = ()  # sentences: readings that are none, see `stopset inspect`
    left_out: tuple[str, ...] = ()  # sentences: what of the recordings was not compared

    @property
    def violations(self) -> tuple[Violation, ...]:
        return tuple(r.violation for r in self.rows if r.violation is not None)

    @property
    def outside_domain(self) -> int:
        return sum(not r.inside_domain for r in self.rows)

    def _repr_html_(self) -> str:
        keys = ("torque_rmse", "torque_rmse_floor", "velocity_rmse", "position_rmse")
        said = f"{len(self.violations)} of {len(self.rows)} recordings leave the sets, {self.outside_domain} the domain."
        head = ("joint", "torque [N m]", "floor [N m]", "velocity [rad/s]", "position [rad]")
        return shown("Model and measurements, RMS", said, head, [(j, *(row[k] for k in keys)) for j, row in self.figures.items()])


def inputs(model: Model, trials: Source, found: Survey, dt: float) -> Iterator[tuple[int, Recording, Array]]:
    """Trials of the surveyed phase on the model's grid with their input ``u``, as (motion, trial, u)."""
    # a nonlinear model's sets live on a coarser grid; its inputs are means over the steps
    every = _every(model, found, dt)
    for r in _on_grid(trials, found, dt / every):
        u = model.input(r.q, r.dq, r.tau, r.temp, found.warm(r), r.t)
        g, u = (r, u) if every == 1 else thinned(r, u, every)
        yield found.motion[r.suite_key], g, u


def _every(model: Model, found: Survey, dt: float) -> int:
    return 1 if model.abstraction.linear else max(1, round(dt / found.dt))


def _on_grid(trials: Source, found: Survey, dt: float) -> Iterator[Recording]:
    for r in trials():
        if r.phase == found.phase and len(r.t) >= 3 and len((g := on_grid(r, dt)).t) >= 3:
            yield g


def compare(model: Model, paths: Sequence[str | Path], progress: Progress = silent) -> Comparison:
    """Hold the recordings against the model over all window starts and ages; in memory what `ReadOnce` remembers.

    ``progress`` is given every trial, and how many leave the sets so far.

    Raises `RecordingError` if the recordings do not belong to the model's robot or hold another kind of torque.
    """
    metas = check_effort(model, paths)
    said = tuple(sentence for meta in metas for sentence in meta.causes)
    trials = ReadOnce(partial(stream_recordings, tuple(paths), model.robot))
    found = survey(trials)
    dt = model.powered.dt
    judge = _Linear(model) if model.abstraction.linear else _Along(model, _stride(model, trials, found))
    figures = Figures(model.abstraction, dt, roller(model, model.effort, found) if model.abstraction.linear else None)
    rows: list[Row] = []
    left, out = list[Array](), 0
    # a torque that was smoothed before it was recorded is held against the model smoothed alike
    cutoff = 0.0 if model.effort == "compensated_torque" else recorded_low_pass(model.robot, found.sample)
    for motion, r, u in inputs(model, trials, found, dt):
        share = min(1.0, len(rows) / max(found.trials, 1))
        progress(f"{len(rows)} of {found.trials} trials compared, {out} leave the sets so far", share)
        figures.add(r, u)
        if model.effort != "compensated_torque":
            left += _known(model, r, u, cutoff)
        e = torque_error(model.abstraction, dt, r.q, r.dq, u)
        covered = bool(model.domain.covers(r.q, r.dq, u, r.temp).all())
        rms = np.sqrt(np.mean(e**2, axis=0)) if len(e) else np.full(model.n, np.nan)
        rows.append(Row(r.label, motion, r.place, rms, covered, judge.violation(r, u)))
        out += rows[-1].violation is not None
    if not any(np.isfinite(r.torque_rms).all() for r in rows):
        longest = dt * max((len(r.t) for r in found.sample), default=0)
        raise RecordingError(
            f"the longest of {len(rows)} recordings lasts {longest:.3g} s; expected one of more than {AVERAGING:g} s, over which torque is "
            "averaged: give longer ones"
        )
    by_joint = figures.result(model.joints)
    known = np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0)) if sum(map(len, left)) else None
    for k, j in enumerate(model.joints):
        by_joint[j]["torque_rmse_known"] = None if known is None else float(known[k])
    wrong = tuple(f.says for f in unsound(model.robot, metas[0], trials()))
    without = left_out(model.robot, found.spikes, found.polled, found.held)
    return Comparison(by_joint, tuple(rows), found, trials, judge.tube, judge.tightness(), judge.bands, said, wrong, without)


def _known(model: Model, r: Recording, u: Array, cutoff: float) -> list[Array]:
    """Torque without explanation, see `left_over`; ``cutoff`` [Hz]: of the low-pass that the torque went through, 0: none."""
    if not cutoff:
        return [left_over(model, r, u, float(np.median(np.diff(r.t))))]
    pieces = restored(model, [r], cutoff)
    return [left_over(model, x, model.input(x.q, x.dq, x.tau, x.temp, 0.0, x.t), float(np.median(np.diff(x.t)))) for x in pieces]


class _Linear:
    """Trials against the tube of a linear model, the same for all of them, and against those of its temperature bands."""

    def __init__(self, model: Model) -> None:
        sets = model.powered
        across = None if sets.zonotope is None else sets.zonotope.directions
        self.tube = deviation_tube(model.abstraction, sets, across)
        self._deviations = Deviations(model.abstraction, sets.dt, len(self.tube.ages) - 1, sets.windows, across)
        self._all, self._n = self._deviations.empty(), model.n
        self._names = state_names(model.joints, len(self._deviations.across))
        self._banded = {
            k: (s.temp, deviation_tube(model.abstraction, s, across)) for k, s in model.sets.items() if s.temp is not None
        }
        self.bands = dict.fromkeys(self._banded, (0, 0))

    def violation(self, r: Recording, u: Array) -> Violation | None:
        env = self._deviations.of(r, u)
        self._all.absorb(env)
        for k, (band, of_band) in self._banded.items():
            if r.temp is not None and band is not None and band.covers(r.temp).all():
                held, out = self.bands[k]
                self.bands[k] = held + 1, out + (_worst(self._names, env, of_band, r.label) is not None)
        return _worst(self._names, env, self.tube, r.label)

    def tightness(self) -> Tightness:
        return of_tube(self.tube, self._all.hi, self._all.lo, self._n)


class _Along:
    """Trials against a nonlinear model's tube, which is another one along every trial; the one shown is the first trial's.

    The window starts are those of the identification, ``stride`` samples apart.
    """

    def __init__(self, model: Model, stride: int) -> None:
        self._model, self._stride, self._seen = model, stride, 0
        self.tube = DeviationTube(np.zeros(1), np.zeros((1, 2 * model.n)), np.zeros((1, 2 * model.n)))
        self.bands: dict[str, tuple[int, int]] = {}
        self._tight = Along(model.abstraction, model.powered)

    def tightness(self) -> Tightness:
        return self._tight.result()

    def violation(self, r: Recording, u: Array) -> Violation | None:
        model, sets, x = self._model, self._model.powered, np.hstack([r.q, r.dq])
        if not self._seen:
            self.tube = self._first(x, u)
        where = starts_in(self._seen, len(x), sets.windows, self._stride)
        self._seen += 1
        self._tight.add((x, u))
        e = worst_excess(model.abstraction, sets, (x, u), where)
        if e is None:
            return None
        name = f"{'q' if e.state < model.n else 'dq'}_{model.joints[e.state % model.n]}"
        side = "above" if e.above else "below"
        return Violation(r.label, name, side, e.start * sets.dt, e.age * sets.dt, e.size, e.size / e.half)

    def _first(self, x: Array, u: Array) -> DeviationTube:
        model, sets = self._model.abstraction, self._model.powered
        last = min(round(sets.horizon / sets.dt), len(x) - 1)
        lo, hi = predicted_tube(model, sets, x[0], u[:last])
        path = predict(model, sets.dt, x[0], u[: last + 1])
        return DeviationTube(np.asarray(sets.dt * np.arange(last + 1)), lo - path, hi - path)


def _stride(model: Model, trials: Source, found: Survey) -> int:
    """Distance of window starts, in steps of a nonlinear model's grid, over all trials of the surveyed phase."""
    every = _every(model, found, model.powered.dt)
    lengths = (len(r.t) for r in _on_grid(trials, found, model.powered.dt / every))
    return stride_of(sum((n - 1) // every for n in lengths), WINDOWS)


def check_effort(model: Model, paths: Sequence[str | Path]) -> list[Meta]:
    """What each file says of itself; refuses one given twice, and recordings of another kind of torque than the model was made from."""
    out = [read_meta(p) for p in paths]
    sources_of(out)
    for p, meta in zip(paths, out, strict=True):
        kinds = {meta.effort, model.effort}
        if len(kinds) > 1 and "compensated_torque" in kinds:
            raise RecordingError(
                f"{p} holds {meta.effort}, the model was identified from {model.effort}; give recordings of the same kind of torque"
            )
    return out


def _worst(names: Sequence[str], env: Envelope, tube: DeviationTube, label: str) -> Violation | None:
    """The furthest that one recording's envelope leaves a tube, if it does."""
    last = min(env.steps, len(tube.ages) - 1)
    above = env.hi[1 : last + 1] - tube.hi[1 : last + 1]
    below = tube.lo[1 : last + 1] - env.lo[1 : last + 1]
    half = np.maximum(0.5 * (tube.hi[1 : last + 1] - tube.lo[1 : last + 1]), 1e-12)
    excess = np.maximum(above, below)
    out = excess > 0  # never where nothing was promised: there the tube is unbounded
    if not out.any():
        return None
    relative = np.divide(excess, half, out=np.full_like(excess, -np.inf), where=out)
    age, state = np.unravel_index(int(np.argmax(relative)), excess.shape)
    side = "above" if above[age, state] >= below[age, state] else "below"
    at = env.where("", int(age) + 1, int(state), "hi" if side == "above" else "lo", names)
    worst = float(excess[age, state])
    return Violation(label, at.state, side, at.start_s, at.age_s, worst, worst / float(half[age, state]))


def answer(model: Model, found: Comparison) -> dict[str, Any]:
    """The machine-readable answer of ``stopset compare``, all SI."""
    n, s, promise = model.n, model.powered, model.guarantee
    return {
        "joints": found.figures,
        "recordings": len(found.rows),
        "violations": len(found.violations),
        "outside_domain": found.outside_domain,
        "said": list(found.said),
        "unsound": list(found.unsound),
        "left_out": list(found.left_out),
        "sets": {
            j: {
                "U": [float(s.U.lo[k]), float(s.U.hi[k])],
                "X0_q": [float(s.X0.lo[k]), float(s.X0.hi[k])],
                "X0_dq": [float(s.X0.lo[n + k]), float(s.X0.hi[n + k])],
                "V_q": [float(s.V.lo[k]), float(s.V.hi[k])],
                "V_dq": [float(s.V.lo[n + k]), float(s.V.hi[n + k])],
            }
            for k, j in enumerate(model.joints)
        },
        "guarantee": {
            "motions": promise.motions, "violated": promise.violated, "upper_bound": promise.upper_bound,
            "confidence": promise.confidence, "text": promise.text,
        },
        **found.tightness.answer(model.joints),
        "bands": {k: {"recordings": held, "violations": out} for k, (held, out) in found.bands.items()},
        "violating": [
            {"recording": v.recording, "state": v.state, "side": v.side, "start_s": v.start_s, "age_s": v.age_s, "excess": v.excess}
            for v in found.violations
        ],
        "domain": {
            j: {
                "q": [float(model.domain.q.lo[k]), float(model.domain.q.hi[k])],
                "dq": [float(model.domain.dq.lo[k]), float(model.domain.dq.hi[k])],
                "u": [float(model.domain.u.lo[k]), float(model.domain.u.hi[k])],
            }
            for k, j in enumerate(model.joints)
        },
    }  # fmt: skip
