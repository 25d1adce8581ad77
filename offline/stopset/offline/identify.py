"""Identify: from recordings to the model file, in the order of the house: nominal model, abstraction, sets, guarantee."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Abstraction, Brakes, Domain, Model, Revision, UncertaintySets
from stopset.artifact.inputs import input_map
from stopset.effects.base import Fitted
from stopset.errors import EffectError, NotCovered, RecordingError
from stopset.offline.abstraction.identified import best_order
from stopset.offline.algorithm import constants
from stopset.offline.brakes import identify_stops, with_stops
from stopset.offline.conform.bands import Bands, band_sets, cut
from stopset.offline.conform.bands import name as band_name
from stopset.offline.conform.guarantee import split
from stopset.offline.conform.nonlinear import GRID, coarser
from stopset.offline.conform.nonlinear_sets import conform_nonlinear
from stopset.offline.conform.program import STOP_TIME
from stopset.offline.conform.sets import Conformance, Gathered, Options, Pairs, conform, few_motions, gather
from stopset.offline.conform.zonotopes import Template, template
from stopset.offline.effect_names import find, matches, parse_effect
from stopset.offline.errors import Figures, joint_figures
from stopset.offline.known import described, plain
from stopset.offline.motions import Suite
from stopset.offline.output_error import fit_joint
from stopset.offline.parts import Range, in_parts, within
from stopset.offline.rollout import EffectTerm, RollOut, joint_batches
from stopset.offline.survey import Source, Survey, Tally, on_grid, survey, tallied
from stopset.recording import Meta, Recording, Recordings, read_meta, stream_recordings
from stopset.robot import Robot
from stopset.robot.rigid import mass_matrix
from stopset.sets import Box

Array = NDArray[np.float64]
Tell = Callable[[str], None]

STOPS = ("stop0", "stop1")
HORIZON = 5.0  # [s] the paper's test suites are "up to 5 seconds long" (sec. V-B)


@dataclass(frozen=True, slots=True)
class Settings:
    """What the user chose; its hash, with the constants of the algorithm, goes into the model file (trap P18)."""

    model: int = 1
    order: int | None = None
    effects: tuple[str, ...] = ()
    conform: str = "all"
    windows: str = "sliding"
    margin: float | None = None
    horizon: float = HORIZON
    bands: int = 0  # temperature bands beside the whole; 0: none
    shape: str = "box"  # or "zonotope": of the torque set

    @property
    def sha256(self) -> str:
        # what was not asked for leaves the hash of earlier models as it was
        later = {"bands": 0, "shape": "box"}
        kept = {k: v for k, v in asdict(self).items() if k not in later or v != later[k]} | constants()
        return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Identification:
    """The model and what was found on the way to it, for the command's printout and the report."""

    model: Model
    conformance: Conformance
    survey: Survey
    settings: Settings
    kept: Kept | None = None  # what later recordings can be added to, where that was asked for


@dataclass(frozen=True, slots=True)
class Kept:
    """All that an update needs of recordings that are read no more, for one nominal model."""

    tally: Tally
    sums: Sums
    nominal: NominalPart
    meta: Meta
    learnt: frozenset[Suite]  # suites the nominal model was fitted to
    session: tuple[int, int]  # most repeats and trials: what it counts warming in
    dt: float  # [s] the sets' grid
    bands: Bands | None
    template: Template | None  # of zonotopes
    motion: dict[Suite, int]
    fitted_files: int  # how many of the files the nominal model was fitted to
    stops: tuple[Recording, ...] = ()  # brakes and ramps do not fold: their recordings, which are short, are kept whole


@dataclass(frozen=True, slots=True)
class Sums:
    """What the heavy pass leaves: running envelopes, and errors trial by trial."""

    gathered: Gathered
    figures: Figures

    def merge(self, later: Sums) -> Sums:
        """Both together; ``later`` holds trials that come after this one's."""
        return Sums(self.gathered.merge(later.gathered), self.figures.merge(later.figures))


@dataclass(frozen=True, slots=True)
class NominalPart:
    """Everything that must be known before the sets."""

    robot: Robot
    rotor: Array
    effects: tuple[Fitted, ...]
    abstraction: Abstraction
    notes: tuple[str, ...]


def identify(
    robot: Robot, paths: Sequence[str | Path], settings: Settings | None = None, tell: Tell = lambda _: None,
    scheduler: str | None = None, known: tuple[Fitted, ...] = (), keep: bool = False,
) -> Identification:  # fmt: skip
    """Identify a reachset-conformant model of ``robot`` from the recordings in ``paths``.

    ``tell`` is told each step; ``scheduler``: address of a Dask scheduler to run the heavy pass on; ``keep``: keep what
    later recordings can be added to (`stopset.offline.adaptive`); ``known``: numbers of those of ``settings.effects``
    that were estimated before (motor torque only).

    Raises `RecordingError`, `NotConformant`.
    """
    chosen = settings or Settings()
    meta = common_meta(paths)

    def source() -> Iterator[Recording]:
        return stream_recordings(paths, robot)

    tell("reading the recordings")
    tally = tallied(source)
    found = tally.survey()
    tell(f"{found.trials} {found.phase} trials, {found.samples} samples; fitting the nominal model")
    # what is held out to judge the sets must not have shaped the nominal model either
    held = found.held_out
    learnt = replace(found, sample=tuple(r for r in found.sample if r.motion not in held))

    def learning() -> Iterator[Recording]:
        return (r for r in source() if r.motion not in held)

    numbers = known_effects(robot, meta, learning, chosen, known)
    nominal = fit_nominal(robot, meta, learning, learnt, chosen, numbers)
    if chosen.model != 1 or chosen.order not in (None, 1):
        nominal = _abstracted(nominal, learnt, chosen, meta.effort)
    if chosen.shape == "zonotope" and not nominal.abstraction.linear:
        raise NotCovered(
            f"zonotopes are found for the linear model only, this is model {nominal.abstraction.kind} of order "
            f"{nominal.abstraction.order}; leave --shape out, or take --model 1 --order 1"
        )
    if keep and not nominal.abstraction.linear:
        raise NotCovered(
            f"model {chosen.model} of order {nominal.abstraction.order} does not fold: its windows are looked at together; leave --keep "
            "out, or take the linear model (--model 1 --order 1)"
        )
    out = _with_sets(robot, meta, source, found, nominal, chosen, tell, scheduler, tally if keep else None)
    return stopped(out, [r for r in source() if r.phase in STOPS], tell)


def stopped(found: Identification, stops: Sequence[Recording], tell: Tell) -> Identification:
    """With brakes and ramps from recorded stops, where there are any; else the data sheet's brakes stay, as an assumption."""
    kept = None if found.kept is None else replace(found.kept, stops=tuple(stops))
    if not stops or found.model.effort == "compensated_torque":
        return replace(found, kept=kept)
    tell(f"brakes and ramps from {len(stops)} recorded stops")
    return replace(found, model=with_stops(found.model, identify_stops(found.model, stops)), kept=kept)


def fit_nominal(
    robot: Robot, meta: Meta, source: Source, found: Survey, settings: Settings, known: tuple[Fitted, ...] = ()
) -> NominalPart:
    """Everything that must be known before the sets, from all trials of ``source``."""
    if meta.effort == "compensated_torque":
        return _compensated(robot, found, settings)
    return _motor(robot, source, found, settings, known)


def known_effects(
    robot: Robot, meta: Meta, source: Source, settings: Settings, known: tuple[Fitted, ...] = ()
) -> tuple[Fitted, ...]:
    """Numbers of the effects that ``settings`` ask for beyond base friction, estimated from the motor torque of ``source``.

    ``known`` ones are kept.  Raises `EffectError` for an effect that these recordings show no trace of.
    """
    if meta.effort == "compensated_torque":
        return ()  # fitted with everything else, by output error
    out = list(known)
    for name in settings.effects:
        effect, _ = parse_effect(name, robot)
        if effect.base or any(matches(f, name) for f in out):
            continue
        trials = Recordings(replace(meta, joints=robot.joints), tuple(source()))
        found = find(robot, trials, tuple(out), effect.name, name.partition(":")[2] or None)
        if found is None:
            raise EffectError(f"{name}: these recordings show no trace of it, so its numbers cannot be estimated; leave it out")
        out.append(found)
    return tuple(out)


def nominal_figures(
    robot: Robot, paths: Sequence[str | Path], settings: Settings, train: Callable[[Recording], bool],
    held: Callable[[Recording], bool], known: tuple[Fitted, ...] = (),
) -> dict[str, dict[str, Any]]:  # fmt: skip
    """Errors per joint on the ``held`` trials of a nominal model fitted to the ``train`` trials alone."""
    meta = common_meta(paths)
    everything = survey(lambda: stream_recordings(paths, robot))

    def part(keep: Callable[[Recording], bool]) -> Source:
        # poses at rest belong to no motion: both halves may know them
        return lambda: (r for r in stream_recordings(paths, robot) if r.phase == "static" or keep(r))

    found = replace(survey(part(train)), repeats=everything.repeats, places=everything.places)
    nominal = fit_nominal(robot, meta, part(train), found, settings, known)
    judged = replace(survey(part(held)), repeats=everything.repeats, places=everything.places)
    pairs = _pairs(part(held), judged, nominal, meta.effort)
    return joint_figures(pairs, nominal.abstraction, robot.joints, found.dt, roller(nominal, meta.effort, judged))


def common_meta(paths: Sequence[str | Path]) -> Meta:
    metas = [read_meta(p) for p in paths]
    kinds = {m.effort for m in metas}
    if len(kinds) != 1:
        raise RecordingError(f"the recordings hold {' and '.join(sorted(kinds))}; one identification takes one kind of torque")
    return replace(
        metas[0], sources=tuple(s for m in metas for s in m.sources), warnings=tuple(w for m in metas for w in m.warnings)
    )


def _compensated(robot: Robot, found: Survey, settings: Settings) -> NominalPart:
    """Torque that already is ``u``: one lag per joint with its effects, by output error."""
    sample = [g for g in (on_grid(r, found.dt) for r in found.sample) if len(g.t) >= 3]
    batches = joint_batches(robot, sample, [found.warm(r) for r in sample], found.dt)
    wanted = [parse_effect(e, robot) for e in settings.effects if e not in ("coulomb", "viscous")]
    fits = []
    for joint, batch in zip(robot.joints, batches, strict=True):
        terms = [EffectTerm(e, e.shape_values(None)) for e, joints in wanted if joint in joints]
        fits.append(fit_joint(batch, joint, terms))
    inertia, damping = np.array([f.inertia for f in fits]), np.array([f.damping for f in fits])
    abstraction = Abstraction(1, 1, np.diag(1.0 / inertia), damping[:, None].copy(), offset=np.array([f.offset for f in fits]))
    viscous = tuple(Fitted("viscous", j, {"F_v": f.damping}, {"F_v": f.std[1]}) for j, f in zip(robot.joints, fits, strict=True))
    notes = (
        "compensated torque: inertia, damping and offset per joint by output error; Coulomb friction and gravity were taken "
        "off before recording and are not known to this model",
    )
    return NominalPart(robot, robot.rotor, (*viscous, *(e for f in fits for e in f.effects)), abstraction, notes)


def _motor(robot: Robot, source: Source, found: Survey, settings: Settings, known: tuple[Fitted, ...]) -> NominalPart:
    """Motor torque: rigid body, rotors and friction by regression; model 1 with the mean inertia of the poses seen."""
    from stopset.offline.nominal import identify_nominal

    cad = described(robot, known)
    trials = (plain(r, cad, known, found.warm(r)) for r in source())
    nominal = identify_nominal(cad, trials, ("coulomb", "viscous"))
    arm = nominal.robot(cad)
    poses = np.vstack([r.q[:: max(1, len(r.q) // 20)] for r in found.sample])
    # M(q_a) of the paper with the mean over the poses seen in place of one pose's: measured on healthy arms, the sum of
    # U widths falls by a third against the diagonal of the same matrix, and by up to 40 % against M(0)
    inertia = np.mean([mass_matrix(arm.chain, arm.pi, q) for q in poses], axis=0) + np.diag(nominal.rotor)
    damping = np.array([nominal.value("viscous", j).get("F_v", 0.0) for j in robot.joints])
    abstraction = Abstraction(
        1, 1, np.linalg.inv(inertia), np.maximum(damping, 0.0)[:, None], standstill=found.noise.hi[robot.n :]
    )
    notes = (*nominal.notes, *(f"undetermined: {u}" for u in nominal.undetermined))
    return NominalPart(arm, nominal.rotor, (*nominal.friction, *known), abstraction, notes)


def _abstracted(nominal: NominalPart, found: Survey, settings: Settings, effort: str) -> NominalPart:
    """The nominal part with another abstraction; its order, if not asked for, by the error of predictions.

    An order is not fitted, so the motions the nominal model knows may choose it; those held out to judge the sets must not.
    """
    if effort == "compensated_torque":
        raise RecordingError(
            f"model {settings.model} of order {settings.order or 'any'} needs the arm's inertias, which compensated torque does not "
            "show; give recordings of motor torque, or take --model 1 --order 1"
        )
    poses = np.vstack([r.q[:: max(1, len(r.q) // 20)] for r in found.sample])
    every = max(1, round(GRID / found.dt))
    trials = [(np.hstack([r.q, r.dq]), u) for _, r, u in _pairs(lambda: found.sample, found, nominal, effort)()]
    standstill = nominal.abstraction.standstill
    chosen = best_order(
        nominal.robot, nominal.rotor, nominal.effects, settings.model, settings.order, poses, coarser(trials, every),
        every * found.dt, standstill if standstill.size else None,
    )  # fmt: skip
    return replace(nominal, abstraction=chosen.abstraction, notes=(*nominal.notes, chosen.note))


def _pairs(source: Source, found: Survey, nominal: NominalPart, effort: str) -> Pairs:
    """(motion, trial on the grid, input) of the surveyed phase, anew at every call."""
    to_input = input_map(nominal.robot, nominal.effects, effort, nominal.abstraction)

    def pairs() -> Iterator[tuple[int, Recording, Array]]:
        for r in source():
            if r.phase == found.phase and len(r.t) >= 3:
                g = on_grid(r, found.dt)
                if len(g.t) < 3:  # samples closer than the grid
                    continue
                yield found.motion[r.motion], g, to_input(g.q, g.dq, g.tau, g.temp, found.warm(r), g.t)

    return pairs


def _with_sets(
    robot: Robot, meta: Meta, source: Source, found: Survey, nominal: NominalPart, settings: Settings, tell: Tell,
    scheduler: str | None, tally: Tally | None,
) -> Identification:  # fmt: skip
    motions = len(set(found.motion.values()))
    horizon = min(settings.horizon, found.longest)
    bands = cut(found.means, found.temp, settings.bands) if settings.bands else None
    tell(f"{motions} independent motions; deviations of every prediction up to {horizon:.2f} s ahead")
    if nominal.abstraction.linear:
        zonotope = _template(found, nominal, meta.effort) if settings.shape == "zonotope" else None
        sums = sums_of(source, found, nominal, meta.effort, settings, bands, zonotope, tally is not None, scheduler)
        tell("identifying the sets")
        return concluded(robot, meta, found, nominal, settings, bands, zonotope, sums, tally)
    # its windows do not fold into an envelope: trials in memory, one process
    figures = Figures(nominal.abstraction, found.dt)
    pairs = _pairs(source, found, nominal, meta.effort)
    for _, r, u in pairs():
        figures.add(r, u)
    tell("identifying the sets along the nominal solutions")

    def sets_of(some: Pairs, margin: float | None) -> Conformance:
        options = Options(settings.conform, settings.windows, margin)
        return conform_nonlinear(
            some, nominal.abstraction, robot.joints, found.noise, found.dt, horizon, options, found.trials
        )  # fmt: skip

    result = sets_of(pairs, settings.margin)
    by_band = {}
    if bands is not None and found.temp is not None:
        for k in range(bands.number):
            sets = sets_of(_in_band(pairs, bands, k), float(result.margins.max())).sets
            by_band[band_name(k)] = replace(sets, temp=bands.band(k, found.temp))
    return _packed(robot, meta, found, nominal, settings, figures, result, by_band)


def _template(found: Survey, nominal: NominalPart, effort: str) -> Template:
    """What a zonotope is made of, from the trials in memory that judge nothing."""
    sample = [r for r in found.sample if r.motion not in found.held_out]
    trials = [(np.hstack([r.q, r.dq]), u) for _, r, u in _pairs(lambda: sample, found, nominal, effort)()]
    return template(trials, nominal.abstraction, nominal.robot, found.dt)


def _in_band(pairs: Pairs, bands: Bands, k: int) -> Pairs:
    return lambda: (p for p in pairs() if k in bands.of(p[1]))


def sums_of(
    source: Source, found: Survey, nominal: NominalPart, effort: str, settings: Settings, bands: Bands | None,
    zonotope: Template | None, keep: bool, scheduler: str | None = None,
) -> Sums:  # fmt: skip
    """The heavy pass over the trials of a linear model; ``keep``: all that any later recordings could ask for too."""
    found = replace(found, sample=())  # what a part needs, without the trials kept in memory
    horizon = settings.horizon if keep else min(settings.horizon, found.longest)
    halves = keep or few_motions(len(split(sorted(set(found.motion.values()))).used))

    def part(trials: Range) -> tuple[Gathered, Figures]:
        figures = Figures(nominal.abstraction, found.dt, roller(nominal, effort, found))

        def pairs() -> Iterator[tuple[int, Recording, Array]]:
            for motion, r, u in _pairs(within(source, trials), found, nominal, effort)():
                figures.add(r, u)
                yield motion, r, u

        in_bands = None if bands is None else bands.of
        return gather(pairs, nominal.abstraction, found.dt, horizon, settings.windows, halves, in_bands, zonotope), figures

    return Sums(*in_parts(part, found.places, scheduler))


def concluded(
    robot: Robot, meta: Meta, found: Survey, nominal: NominalPart, settings: Settings, bands: Bands | None,
    zonotope: Template | None, sums: Sums, tally: Tally | None = None,
) -> Identification:  # fmt: skip
    """Sets, guarantee and model file of a linear model from the sums of all its recordings; ``tally``: kept with them."""
    options = Options(settings.conform, settings.windows, settings.margin)
    horizon = min(settings.horizon, found.longest)
    steps = round(horizon / found.dt)
    gathered = sums.gathered.mapped(lambda env: env.upto(steps))
    shared = (nominal.abstraction, robot.joints, found.noise, found.dt, horizon, options)
    learnt = found.learnt_motions
    result = conform(gathered, *shared, found.trials, learnt, zonotope)
    by_band = {}
    if bands is not None and found.temp is not None:
        by_band = band_sets(gathered, bands, found.temp, result.margins, *shared, learnt, zonotope)
    out = _packed(robot, meta, found, nominal, settings, sums.figures, result, by_band)
    if tally is None:
        return out
    # what may judge the model later must stay what it was when the nominal model was fitted
    fitted = found.learnt or frozenset(found.motion) - found.held_out
    session = found.session or (found.repeats, found.places)
    nominal = replace(nominal, notes=(*robot.notes, *nominal.notes))
    files = len(meta.sources)
    kept = Kept(tally, sums, nominal, meta, fitted, session, found.dt, bands, zonotope, found.motion, files)
    return replace(out, kept=kept)


def _packed(
    robot: Robot, meta: Meta, found: Survey, nominal: NominalPart, settings: Settings, figures: Figures, result: Conformance,
    by_band: dict[str, UncertaintySets],
) -> Identification:  # fmt: skip
    errors, u_hull = figures.result(robot.joints), figures.u
    assert u_hull is not None
    total = {"sum_U_width": float(result.sets.U.width.sum())} | _sums(errors)
    notes = list(result.notes)
    if by_band:
        notes.append(
            "the sets of temperature bands have the margin of the whole and enclose all that was recorded at these temperatures; "
            "of motions not yet seen only the whole's sets promise anything"
        )
    model = Model(
        robot=nominal.robot, rotor=nominal.rotor, effort=meta.effort, effects=nominal.effects,
        abstraction=nominal.abstraction,
        sets={"powered": result.sets, f"powered, {result.other.conform}": result.other} | by_band, brakes=assumed_brakes(robot),
        domain=Domain(found.q, found.dq, u_hull, found.temp), guarantee=result.guarantee, errors=errors,
        provenance=_provenance(meta, found, settings), revisions=(Revision(0, "", {}, total),),
        notes=(*meta.warnings, *robot.notes, *nominal.notes, *notes),
    )  # fmt: skip
    return Identification(model, result, found, settings)


def roller(nominal: NominalPart | Model, effort: str, found: Survey) -> RollOut | None:
    """Open-loop simulation with effects at the simulated state, for compensated torque; None: the linear prediction."""
    if effort != "compensated_torque" or not nominal.abstraction.decoupled:
        return None
    return RollOut(nominal.robot, nominal.abstraction, nominal.effects, found.warm)


def _sums(errors: dict[str, dict[str, Any]]) -> dict[str, float]:
    keys = ("torque_rmse", "velocity_rmse", "position_rmse")
    return {f"sum_{k}": float(sum(row[k] for row in errors.values() if row[k] is not None)) for k in keys}


def _sources(meta: Meta) -> dict[str, str]:
    """File name -> SHA-256; files of one name in several folders are numbered."""
    out: dict[str, str] = {}
    for name, sha256 in meta.sources:
        again = sum(other == name or other.startswith(f"{name} (") for other in out)
        out[f"{name} ({again + 1})" if again else name] = sha256
    return out


def _provenance(meta: Meta, found: Survey, settings: Settings) -> dict[str, Any]:
    return {
        "tool": f"stopset {version('stopset')}",
        "settings": asdict(settings),
        "settings_sha256": settings.sha256,
        # rad and rad/s are not addable (trap P11): what a velocity was weighted by when widths were traded
        "cost": {"velocity_counts_for_s": STOP_TIME, "age_weight": f"1 / (age + {STOP_TIME} s)"},
        "data": _sources(meta),
        "phase": found.phase,
        "trials": found.trials,
        "samples": found.samples,
        "motions": len(set(found.motion.values())),
        "session_trials": found.places,
        "velocity": meta.velocity,
        "clock": "resampled to the grid" if found.irregular else meta.clock,
    }


def assumed_brakes(robot: Robot) -> Brakes | None:
    """Brakes from the data sheet, as an assumption until stops were recorded; None where the sheet gives no torque.

    Delay [5, 100] ms and rise [5, 30] ms cover servo brakes with fast and slow suppression: vendors give up to 100 ms until
    a brake holds; torque +-30 % covers wear, oil and temperature.
    """
    drives = robot.drives
    nominal = np.array([d.brake_torque for d in drives])
    if not np.all(np.isfinite(nominal)):
        return None

    def interval(rows: list[tuple[float, float]], default: tuple[float, float]) -> Box:
        given = [r if np.isfinite(r).all() else default for r in rows]
        return Box.of([r[0] for r in given], [r[1] for r in given])

    tolerance = np.array([d.brake_tolerance if np.isfinite(d.brake_tolerance) else 0.3 for d in drives])
    return Brakes(
        torque=Box(nominal * (1 - tolerance), nominal * (1 + tolerance)),
        delay=interval([d.brake_delay for d in drives], (0.005, 0.1)),
        rise=interval([d.brake_rise for d in drives], (0.005, 0.03)),
        source="data sheet and assumed tolerances",
    )
