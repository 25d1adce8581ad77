"""Every constant that a model file rests on besides the user's settings, by a name of its own, and the hash over both (trap P18).

Names belong to the constants, not to the files they stand in: moving a file changes an import here and no hash.  What is not a
number that a result rests on (words, formats, budgets of memory) stays out; a test holds a reason for each of those.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from types import ModuleType
from typing import Any

import numpy as np

from stopset.effects import base, bound, get, selection, signals
from stopset.effects.registry import catalogue
from stopset.offline.abstraction import choose, forms, grid, identified, metrics, models, swift
from stopset.offline.brakes import bands as spread_bands
from stopset.offline.brakes import controlled, impulse, judge, power_off, stops, timing
from stopset.offline.campaign import calibration, hold_out, independence, noise, reading_error, session, survey
from stopset.offline.campaign.settings import Settings
from stopset.offline.conform import (
    bands,
    corners,
    guarantee,
    linear_program,
    monotone_sets,
    nonlinear,
    nonlinear_sets,
    program,
    tightness,
    zonotopes,
)  # fmt: skip
from stopset.offline.diagnose import compensated, plays, thresholds
from stopset.offline.diagnose.columns import elasticity, structure
from stopset.offline.diagnose.evidence import baseline, candidate, engine, evidence, hypothesis, priors, uncertainty
from stopset.offline.diagnose.rows import noise as row_noise
from stopset.offline.diagnose.rows import prepare, rows, sampling
from stopset.offline.diagnose.search import lag_form, moment_arms, refine, ripple, settled, structures, wanted
from stopset.offline.identify import absurd, unseen
from stopset.offline.nominal import (
    delay,
    filters,
    fit,
    floor,
    friction,
    friction_choice,
    low_pass,
    nominal,
    normal_equations,
    open_loop,
    output_error,
    pair_choice,
    parameter_uncertainty,
    physical,
    preprocess,
    prior,
    qp,
    rotors,
    scale,
    stamps,
    unidentifiable,
)  # fmt: skip
from stopset.reach import nonlinear as flow
from stopset.reach.stops import bounds, brakes, failed, gravity, ramp, split, tube, tubes, windows
from stopset.reach.stops import friction as stop_friction
from stopset.recording import clock as recorded_clock
from stopset.recording import ends, held, polled, reader, repetition, spikes
from stopset.recording import rows as recorded_rows
from stopset.ring import interval
from stopset.robot import drives, generic

SCHEMA = 2  # of the hash: counted up when a name changes or the way values are written

# (name of the group, module its constants stand in today, their names)
TABLE: tuple[tuple[str, ModuleType, str], ...] = (
    ("reading", reader, "PLAUSIBLE_ANGLE PLAUSIBLE_SPEED"),
    ("reading", recorded_clock, "FEWEST_STAMPS PRINTED ROUGH WIDE PAUSE SLOWER"),
    ("reading", recorded_rows, "UNREAD"),
    ("spikes", spikes, "FEWEST RARE OUT SEEN FLAT LEVEL BESIDE MOVING ANSWER AROUND ANSWERED"),
    ("polled readings", polled, "FEWEST_READINGS STEADY LEAST MOST LONGEST WHOLE AROUND REST PLAIN BETTER ITS"),
    ("held readings", held, "FEWEST_READINGS TWICE EVENLY TOGETHER SIGNALS MOST LATE OF_ROWS FOLLOWS"),
    ("bent ends", ends, "SLOPE EDGE FEWEST OFF USUAL FADES MOSTLY"),
    ("robot", drives, "STANDARD_GRAVITY"),
    ("rigid body", generic, "_SNAP"),
    ("interval", interval, "_ULPS _TWO_PI"),
    ("effects", base, "REFERENCE_TEMPERATURE"),
    ("effect signals", signals, "_STEP"),
    ("survey", survey, "JITTER DRIFT KEEP STOPS"),
    ("repetition", repetition, "POWERED COMPARED ANOTHER MOVES"),
    ("session", session, "REPEATED"),
    (
        "independence",
        independence,
        "OVERLAP FEWEST NOISES ALIKE VARIES SEAM FEWEST_JOINTS SEAM_ANGLE SEAM_SPEED SEAM_ACCELERATION MOVING READINGS",
    ),
    ("hold-out", hold_out, "FOLDS FEWEST_MOTIONS BLOCK GUARD SHORTEST"),
    ("preprocessing", filters, "ORDER"),
    ("stamps", stamps, "FOLLOW NEAR GOLDEN"),
    ("preprocessing", preprocess, "IRREGULAR GAP SLOWEST LOWEST CLEAR ABOVE SEAM RINGING"),
    ("normal equations", normal_equations, "GROUPS TOGETHER DELAYS STILL_PHASES BRAKED_PHASES"),
    ("recorded low-pass", low_pass, "QUIET CUTOFFS FINER KNOWN FILTER_LOWERS SECONDS PIECE TELLING_ROWS RELATIVE"),
    ("delay", delay, "LEAST_STD BLUNT CLOSE OWN FEW SIDES SURE FALLS FINE"),
    ("inertia floor", floor, "FASTEST WEAK POSES"),
    ("shared motors", pair_choice, "LOWERED LOOKED_AT"),
    ("friction laws", friction_choice, "GAINS LOADS NEVER"),
    ("fit", fit, "ROUNDS FELT FEW_GROUPS MOST_INFLATION ASSUMED_SPREAD ASSUMED_FREEDOM COVERED RIDGE WIDEST_PRIOR CLEARLY"),
    ("friction", friction, "CREEP DRY ENDS DENSE"),
    ("nominal", nominal, "DELAY_TRUSTED LOAD_PASSES"),
    ("open loop", open_loop, "DIRECTION_WIDTH SPEED_LIMIT"),
    ("output error", output_error, "VELOCITY_TIME ITERATIONS STARTS FEW FAR PROGRESS UNDETERMINED NOT_FELT USUAL_TIME"),
    ("parameter uncertainty", parameter_uncertainty, "DIGITS ERRORS FELT SHARE STATES SPAN"),
    ("physical", physical, "MARGIN SMALL FAR FEASIBLE NEAR"),
    ("prior", prior, "IDENTIFICATION LIGHT CARRIED CARRIED_AT"),
    ("quadratic program", qp, "TOLERANCE"),
    ("rotors", rotors, "POSES FAR"),
    ("scale", scale, "SHARE PULL"),
    ("unidentifiable", unidentifiable, "OPEN NOTABLE UNSEEN RANK"),
    ("abstraction choice", choose, "WINDOWS TIE"),
    ("swift inputs", swift, "LOWERS"),
    ("abstraction forms", forms, "ROUNDING"),
    ("abstraction identified", identified, "HORIZON ORDERS LADDER WORTH"),
    ("abstraction models", models, "ORDERS ROUNDING"),
    ("flow", flow, "STEP _TERMS"),
    ("readings", noise, "WINDOW COVERAGE TELLING FLOAT32_STEP _WEIGHTS"),
    ("reading error", reading_error, "SMOOTH FEWEST"),
    ("tightness", tightness, "AGES NAMES JUDGED WIDE LIMIT WINDOWS"),
    ("absurd", absurd, "LATE MOVES RANGES"),
    ("drive gain", baseline, "POSES"),
    ("temperature bands", bands, "MOST"),
    ("corners", corners, "BUDGET CUTS RUNAWAY"),
    ("guarantee", calibration, "HELD_OUT_EVERY FEWEST_MOTIONS"),
    ("guarantee", guarantee, "CONFIDENCE FOLDS TOUCHING"),
    ("parts left out", unseen, "STRETCHES FEWEST SHORTEST RISK USUAL FREEDOM NOTHING"),
    ("linear program", linear_program, "AGES"),
    ("program", program, "SOLVER_SLACK ROUNDS FIRST MORE CHARGE"),
    ("program", metrics, "STOP_TIME"),
    ("monotone sets", monotone_sets, "ROUNDS SETTLED LARGEST"),
    ("windows of nonlinear sets", grid, "GRID"),
    ("windows of nonlinear sets", nonlinear, "WINDOWS AGES NEAREST"),
    ("nonlinear sets", nonlinear_sets, "KEEP MOST_LEFT_OUT TOLERANCE"),
    ("zonotopes", zonotopes, "POSES SAME REACH"),
    ("figures", metrics, "AVERAGING KINDS LONGEST"),
    ("spread of stops", spread_bands, "RISK TIMES TORQUES WIDEN WIDENINGS DOUBLINGS"),
    ("ramps", controlled, "KINDS START SOFT CONTROL"),
    ("impulses", impulse, "SLIDING SHORTEST"),
    ("judge of stops", judge, "BEFORE SLOW PIECES"),
    ("brakes", power_off, "LEAST TAIL ENOUGH SIGMAS USUALLY OWN_LAG ROUNDS STRAY TYPICAL TYPICAL_U LEAST_TORQUE USUAL_RISE"),
    ("stops", stops, "HELD FEW REST"),
    ("brake timing", timing, "GRID RISES TORQUE_PRIOR FADING EARLY SIGNIFICANT SHARP TELLING CREDIBLE MISFIT"),
    ("stop bounds", bounds, "SWEEPS FEW"),
    ("cut intervals", split, "TRIALS REWARD BLURRED"),
    ("failed stops", failed, "SLICES FAST_SLICES NARROW TUBES TABLE_TUBES SLICE ANGLE_WEIGHT"),
    ("effects in a stop", bound, "SIGMAS"),
    ("stop brakes", brakes, "BRAKE_TOLERANCE"),
    ("stop friction", stop_friction, "FRICTION_TOLERANCE BEYOND ROUNDING"),
    ("stop ramp", ramp, "KNOTS STILL NEVER"),
    ("stop gravity", gravity, "GRID OUTWARD"),
    ("stop tube", tube, "PASSES RECENTRE ENERGY_CLAIMS ENERGY_ROUNDING RATE_ROUNDING"),
    (
        "stop tubes",
        tubes,
        "KNOTS ENERGY_KNOTS FAST_KNOTS FAST_ENERGY_KNOTS FAST_ALIKE_KNOTS FAST_WINDOWS REGIONS COARSE PATIENCE MORE_PATIENCE",
    ),
    ("stop windows", windows, "WIDTH TINY"),
    ("diagnosis", thresholds, " ".join(t.name for t in thresholds.SETTLED)),
    ("diagnosis rows", prepare, "KERNEL LIGHT ROW_STEP WIDER ONE_DIRECTION"),
    ("diagnosis poses", rows, "DEPENDENT"),
    ("diagnosis noise", row_noise, "ORDER"),
    ("diagnosis elasticity", elasticity, "SWING_ROUNDS RATHER_NOT SUBSTEPS"),
    ("diagnosis ripple", ripple, "STEP RIPPLES"),
    ("diagnosis candidate", candidate, "HELD"),
    ("diagnosis engine", engine, "EMPTY"),
    ("diagnosis engine", hypothesis, "GIVEN ROUNDS"),
    ("diagnosis evidence", evidence, "RIDGES REPEATED"),
    ("diagnosis uncertainty", uncertainty, "STEP TWO_SIDES"),
    ("diagnosis rows", sampling, "ROUNDING"),
    ("diagnosis refinement", refine, "FINEST_LAG"),
    ("diagnosis structure", structure, "SHORT STEP"),
    ("diagnosis structure", structures, "RATES LIGHTLY ANGLES FEET NEAR WORTH STEPS FINEST ROUNDS DAMPED"),
    ("diagnosis lag", lag_form, "FINEST SETTLED"),
    ("diagnosis settlement", settled, "PARTS"),
    ("diagnosis settlement", moment_arms, "SEARCHES ALONG CLIMB FALLS"),
    ("diagnosis wanted", wanted, "LAGS"),
    ("diagnosis play", plays, "PART FEWEST SOFT CROSSING STILL"),
    ("diagnosis open loop", compensated, "STEP SCREENING FINALISTS"),
)

# what the hash calls a constant whose name in the code has changed: a better word is no other model
HASHED_AS = {
    "independence.MOVING": "independence.UNDER_WAY",
    "brakes.OWN_LAG": "brakes.APART",
    "stamps.FOLLOW": "diagnosis sampling.FOLLOW",
    "stamps.GOLDEN": "diagnosis rows.GOLDEN",
    "diagnosis.RIPPLE_SEPARATION": "diagnosis.RIPPLES_APART",
    "diagnosis.NAMED_BESIDE": "diagnosis.TOLD_TOO",
    "diagnosis rows.ONE_DIRECTION": "diagnosis rows.ONE_WAY",
}


def constants() -> dict[str, Any]:
    """``group.NAME`` -> value, as written in the code of this version; the name is the one that is hashed."""
    named = {f"{group}.{name}": getattr(module, name) for group, module, names in TABLE for name in names.split()}
    out = {HASHED_AS.get(name, name): value for name, value in named.items()}
    known = priors.Known(np.zeros((0, 2)), np.zeros((0, 2)))
    return out | {
        "preprocessing defaults": preprocess.Preprocessing(),
        "description tolerance": prior.Tolerance(),
        "laws tried": {"always": selection.base(), "joints": selection.usual(), "pairs": selection.usual("pair")},
        "changes since": {f: getattr(known, f) for f in ("gain", "spread", "scales")},
    }


def ranges(effects: tuple[str, ...]) -> dict[str, Any]:
    """Admissible ranges, usual sizes and start values of base friction and of the ``effects`` asked for."""
    asked = {name.partition(":")[0] for name in effects} | {e.name for e in catalogue().values() if e.base}
    return {name: (get(name).terms, get(name).shapes, get(name).states) for name in sorted(asked)}


def settings_sha256(settings: Settings) -> str:
    """What a model rests on besides its recordings and its robot: settings, constants, ranges of its effects."""
    return digest({"settings": settings, "constants": constants(), "effects": ranges(settings.effects)})


def digest(values: Mapping[str, Any], schema: int = SCHEMA) -> str:
    """SHA-256 of named values, whatever their order; arrays by their numbers, to the last bit."""
    text = json.dumps({"schema": schema, "values": plain(values)}, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def plain(value: Any) -> Any:
    """``value`` as JSON has it. Raises `TypeError` for what has no such form."""
    if isinstance(value, np.ndarray):
        return {"shape": list(value.shape), "numbers": [plain(x) for x in value.ravel().tolist()]}
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, frozenset):
        return sorted(map(plain, value))
    if isinstance(value, (tuple, list)):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        return value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"{value!r} is no number, text or collection of these")
