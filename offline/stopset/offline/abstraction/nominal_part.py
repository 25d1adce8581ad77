"""The nominal part of a model: arm, rotors, effects and abstraction, all that must be known before the sets."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stopset.artifact import Abstraction, Model
from stopset.artifact.inputs import BODY, compensated, input_map
from stopset.effects.base import Effect, Fitted, Signals
from stopset.effects.registry import get
from stopset.effects.selection import base, matches, of_part, parse_effect
from stopset.errors import EffectError
from stopset.offline.campaign.noise import TELLING
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.survey import Survey, on_grid
from stopset.offline.campaign.trials import Pairs, Source
from stopset.offline.inspect.gate import check_torque
from stopset.offline.nominal.friction_choice import Choice, Gain, choose
from stopset.offline.nominal.known_effects import described, plain
from stopset.offline.nominal.nominal import Nominal, identify_nominal, solve_nominal
from stopset.offline.nominal.normal_equations import NormalEquations, accumulate
from stopset.offline.nominal.open_loop import EffectTerm, RollOut, joint_batches
from stopset.offline.nominal.output_error import fit_joint
from stopset.offline.nominal.parameter_uncertainty import left_open, of_lags, of_regression
from stopset.offline.nominal.preprocess import Preprocessing
from stopset.offline.nominal.rotors import inertia_std, rotors_shown, unseen_rotors, with_scales
from stopset.recording import Recording
from stopset.robot import Robot
from stopset.robot.rigid import mass_matrix
from stopset.types import Array

NO_TRACE = "these recordings show no trace of it, so its numbers cannot be estimated; leave it out"


@dataclass(frozen=True, slots=True)
class NominalPart:
    """Everything that must be known before the sets; ``data``: the sums it was regressed from, where it was.

    ``uncertain_torque`` (n,) [N m]: torque that the recordings leave open, see `stopset.offline.nominal.parameter_uncertainty`.
    ``unseen``: factor by which sets must be larger than the recordings, where nothing else tells it (`stopset.offline.identify.unseen`).
    """

    robot: Robot
    rotor: Array
    effects: tuple[Fitted, ...]
    abstraction: Abstraction
    notes: tuple[str, ...]
    data: NormalEquations | None = None
    uncertain_torque: Array = field(default_factory=lambda: np.zeros(1))
    chosen: tuple[Gain, ...] = ()  # laws of friction that nobody asked for, by evidence
    limited: tuple[str, ...] = ()  # those of the notes that say what a limit decided
    taken_out: tuple[dict[str, Any], ...] = ()  # off the recordings before the fit, see `Nominal.taken_out`
    friction_covariance: dict[str, dict[str, Any]] = field(default_factory=dict)  # see `Nominal.friction_covariance`
    left_open: Array = field(default_factory=lambda: np.zeros((0, 0)))  # see `parameter_uncertainty.left_open`
    left_of_own: tuple[float | None, ...] | None = None  # (n,) [N m] that it leaves of what it was fitted to; None: not asked yet
    excess_of_own: tuple[float, ...] = ()  # (n,) and its variance over that of the sensors' noise, in the rows of a diagnosis
    inertia_std: Array | None = None  # (n,) see `Model`
    rotors_shown: bool = True
    unseen: float | None = None


def fit_nominal(run: Run, known: tuple[Fitted, ...] = ()) -> NominalPart:
    """Everything that must be known before the sets, from all trials of ``run``; numbers of the ``known`` effects are kept."""
    return _compensated(run, known) if run.meta.effort == "compensated_torque" else _motor(run, known)


def regressed(effect: Effect) -> bool:
    """Whether an effect is friction that the nominal regression can hold: at one joint, of speed and load, linear, no memory."""
    return effect.scope == "joint" and not effect.states and not effect.shapes and set(effect.needs) <= {"dq", "load"}


def _compensated(run: Run, known: Sequence[Fitted]) -> NominalPart:
    """Torque that already is ``u``: one lag per joint with its effects, by output error; numbers that are ``known`` stay."""
    robot, found = run.robot, run.survey
    sample = [g for g in (on_grid(r, found.dt) for r in found.sample) if len(g.t) >= 3]
    batches = joint_batches(robot, sample, [found.warm(r) for r in sample], found.dt)
    asked = [e for e in run.settings.effects if e not in base() and not any(matches(f, e) for f in known)]
    wanted = [parse_effect(e, robot) for e in asked]
    expected = np.diag(mean_inertia(robot, robot.rotor, found))
    fits = []
    for joint, batch, J in zip(robot.joints, batches, expected, strict=True):
        terms = [EffectTerm.known(f) for f in known if f.joint == joint]
        terms += [EffectTerm(e, e.shape_values(None)) for e, joints in wanted if joint in joints]
        fits.append(fit_joint(batch, joint, terms, float(J)))
    inertia, damping = np.array([f.inertia for f in fits]), np.array([f.damping for f in fits])
    abstraction = Abstraction(1, 1, np.diag(1.0 / inertia), damping[:, None].copy(), offset=np.array([f.offset for f in fits]))
    law, symbol = of_part("damping").name, of_part("damping").terms[0].symbol
    viscous = tuple(Fitted(law, j, {symbol: f.damping}, {symbol: f.std[1]}) for j, f in zip(robot.joints, fits, strict=True))
    notes = (
        "compensated torque: inertia, damping and offset per joint by output error; Coulomb friction and gravity were taken "
        "off before recording and are not known to this model",
        *(
            f"undetermined: inertia and damping of {j}, which moves over {np.ptp(b.q[b.inside > 0]):.2f} rad only; kept near the "
            "description's inertia and a usual damping: record motions that move it"
            for j, b, f in zip(robot.joints, batches, fits, strict=True)
            if not f.determined
        ),
    )
    uncertain_torque = of_lags(np.array([f.std for f in fits]), sample)
    return NominalPart(
        robot,
        robot.rotor,
        (*viscous, *known, *(e for f in fits for e in f.effects if not any(matches(k, e.label) for k in known))),
        abstraction,
        notes,
        uncertain_torque=uncertain_torque,
        inertia_std=np.array([f.std[0] for f in fits]),
    )


def _motor(run: Run, known: tuple[Fitted, ...]) -> NominalPart:
    """Motor torque: rigid body, rotors and friction by regression, laws of friction by evidence."""
    robot, found, settings = run.robot, run.survey, run.settings
    cad = described(robot, known)
    asked = [e for e in settings.effects if regressed(parse_effect(e, robot)[0]) and not any(matches(f, e) for f in known)]

    def of(arm: Robot) -> Source:
        """The trials without what is known, as the laws of ``arm`` say it."""
        return lambda: (plain(r, arm, known, found.warm(r)) for r in run.trials())

    prepared = Preprocessing(low_pass=found.low_pass)
    arm = _weighed(cad, cad, of, known, (*base(), *asked), prepared)
    chosen: tuple[Gain, ...] = ()
    if settings.friction == "evidence":
        barred = [e for e in settings.effects if e not in asked] + [f.label for f in known] + [e for e in asked if ":" in e]
        everywhere = [e for e in asked if ":" not in e]
        choice = Choice(everywhere, barred, settings.friction_among, settings.friction_retained)
        chosen = choose(cad, of(arm), len(set(found.motion.values())), choice, prepared)
    laws = tuple(dict.fromkeys((*base(), *asked, *(g.name for g in chosen))))
    nominal = _at_load(cad, _weighed(cad, arm, of, known, laws, prepared), of, laws, prepared)
    strange = check_torque(cad, run.meta, nominal.data, nominal.delay, found.sample)
    for name in asked:
        if not any(_shows(f) for f in nominal.friction if matches(f, name)):
            raise EffectError(f"{name}: {NO_TRACE}")
    notes = (*strange, *(g.says for g in chosen))
    return replace(_regressed(robot, cad, nominal, found, known, notes), chosen=chosen)


def refitted(run: Run, known: tuple[Fitted, ...], like: NominalPart) -> NominalPart:
    """The laws of ``like``, their numbers from other trials; those of the ``known`` effects are kept."""
    if like.data is None:
        return _compensated(run, known)
    robot, found = run.robot, run.survey
    cad = described(robot, known)
    own = tuple(run.trials())

    def of(arm: Robot) -> Source:
        trials = [plain(r, arm, known, found.warm(r)) for r in own]
        return lambda: iter(trials)

    laws, prepared = like.data.layout.effects, like.data.settings
    nominal = _at_load(cad, _weighed(cad, cad, of, known, laws, prepared), of, laws, prepared)
    return _regressed(robot, cad, nominal, found, known, ())


def _weighed(
    cad: Robot, arm: Robot, of: Callable[[Robot], Source], known: Sequence[Fitted], laws: Sequence[str], prepared: Preprocessing
) -> Robot:
    """The arm whose laws say what is ``known``: as these recordings weigh it, where a known torque depends on what links weigh.

    A model says such a torque with the links it was identified with.  Taken off with the load of a description that is a third off, it
    leaves that third to be fitted by everything else, and then comes back whole.  ``arm``: to begin with; ``of``: the trials of an arm.
    """
    if not any(get(f.effect).compensated() and BODY & set(get(f.effect).needs) for f in known):
        return cad
    return identify_nominal(cad, of(arm), laws, settings=prepared).robot(cad)


def _at_load(cad: Robot, arm: Robot, of: Callable[[Robot], Source], laws: Sequence[str], prepared: Preprocessing) -> Nominal:
    """The nominal model with all load that laws are of, known or not, as the ``arm`` says it; ``cad`` itself: as a first fit says it."""
    if arm is cad:
        return identify_nominal(cad, of(cad), laws, settings=prepared)
    return solve_nominal(cad, accumulate(cad, of(arm)(), laws, prepared, arm.pi))


def _regressed(
    robot: Robot, cad: Robot, nominal: Nominal, found: Survey, known: tuple[Fitted, ...], notes: tuple[str, ...]
) -> NominalPart:
    """Model 1 with the mean inertia of the poses seen; ``cad``: the arm as described, with what is known of it."""
    arm = nominal.robot(cad)
    # M(q_a) of the paper with the mean over the poses seen in place of one pose's: measured on healthy arms, the sum of
    # U widths falls by a third against the diagonal of the same matrix, and by up to 40 % against M(0)
    inertia = mean_inertia(arm, nominal.rotor, found) + shared_inertia(robot, known)
    law = of_part("damping")
    damping = np.array([nominal.value(law.name, j).get(law.terms[0].symbol, 0.0) for j in robot.joints])
    still = TELLING * found.readings.least.hi[robot.n :]
    abstraction = Abstraction(
        1, 1, np.asarray(np.linalg.inv(inertia), float), np.maximum(damping, 0.0)[:, None], standstill=still
    )
    seen = rotors_shown(nominal.theta, nominal.covariance, robot.n)
    notes = (
        *notes,
        *nominal.notes,
        *(f"undetermined: {u}" for u in nominal.undetermined),
        *([] if seen else [unseen_rotors(cad)]),
    )
    return NominalPart(
        arm, nominal.rotor, (*nominal.friction, *known), abstraction, notes, nominal.data, of_regression(cad, nominal, found.sample),
        limited=nominal.limited, taken_out=nominal.taken_out(), friction_covariance=nominal.friction_covariance(),
        left_open=left_open(cad, nominal, found.sample),
        inertia_std=with_scales(inertia_std(cad, nominal.covariance, nominal.span), arm, nominal.rotor, known, nominal.span),
        rotors_shown=seen,
    )  # fmt: skip


def mean_inertia(robot: Robot, rotor: Array, found: Survey) -> Array:
    """(n, n) [kg m^2]: ``M(q) + rotor`` in the mean over the poses seen."""
    poses = np.vstack([r.q[:: max(1, len(r.q) // 20)] for r in found.sample])
    mean: Array = np.mean([mass_matrix(robot.chain, robot.pi, q) for q in poses], axis=0) + np.diag(rotor)
    return mean


def shared_inertia(robot: Robot, effects: Sequence[Fitted]) -> Array:
    """(n, n) [kg m^2]: inertia of motors that turn with two joints, beside the diagonal."""
    out = np.zeros((robot.n, robot.n))
    for f in effects:
        effect = get(f.effect)
        if "ddq_other" in effect.needs and len(f.joints) == 2:
            i, j = map(robot.joints.index, f.joints)
            out[i, j] = out[j, i] = effect.torque(Signals(ddq_other=1.0), f.values)
    return out


def _shows(fitted: Fitted) -> bool:
    """Whether some number of an effect is larger than twice its standard error."""
    return any(abs(fitted.values[k]) > 2 * std for k, std in fitted.std.items())


def pairs_of(source: Source, found: Survey, nominal: NominalPart, effort: str) -> Pairs:
    """(motion, trial on the grid, input) of the surveyed phase, anew at every call."""
    to_input = input_map(nominal.robot, nominal.effects, effort, nominal.abstraction)

    def pairs() -> Iterator[tuple[int, Recording, Array]]:
        for r in source():
            if r.phase == found.phase and len(r.t) >= 3:
                g = on_grid(r, found.dt)
                if len(g.t) < 3:  # samples closer than the grid
                    continue
                yield found.motion[r.suite_key], g, to_input(g.q, g.dq, g.tau, g.temp, found.warm(r), g.t)

    return pairs


def roller(nominal: NominalPart | Model, effort: str, found: Survey) -> RollOut | None:
    """Open-loop simulation with effects at the simulated state, for compensated torque; None: the abstraction alone says it."""
    abstraction = nominal.abstraction
    if effort != "compensated_torque" or not abstraction.decoupled or not compensated(nominal.effects, abstraction):
        return None
    return RollOut(nominal.robot, abstraction, nominal.effects, found.warm)
