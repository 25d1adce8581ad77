"""Every number that decides an answer of the diagnosis: its value, what it means, and what it was set by
(*chosen* where nothing measured stands behind it).

`TABLE` is the table of docs/diagnosis.md, made from here by ``python benchmarks/doc_tables.py``.  No other module of the diagnosis
compares anything with a number of its own (tested); numbers that only set how finely is looked (kernels, grids, budgets of a search)
stay where they are used.
"""

from __future__ import annotations

from math import log
from typing import Any, NamedTuple

THRESHOLD = 25.0  # of twice the log Bayes factor
FORMS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3)  # of a law's torque
DEGREE = 3
SAME_LAW = 0.02  # of a law's torque
LOWERED = 0.02  # of a joint's torque error
LOWERED_MORE = 0.05  # of a joint's torque error
LOWERED_SWING = 0.10  # of a joint's torque error
STANDS_OUT = 0.10  # of a joint's torque error
MAX_CLAIMS = 12
CONTENDERS = 4
HANDFUL = 5
SHORTEST_LAG = 0.004  # [s]
LAG_PRICE = 2 * log(40.0)
NOISE_KNOWN = 0.10  # of the torque noise's variance
SWING_PRICE = 2 * log(1000.0)
BUILT_UP = 2.0  # friction torques
FAR_OVER_NOISE = 2.0  # variance over the sensors' noise
SWINGS = (4.0, 70.0)  # [rad/s]
SWING_JOINTS = 3
BEGINNINGS = 12  # rows
AT_REST = 0.04  # [rad/s]
ACCELERATED = 0.01  # of the square of what the joints accelerate at
DROWNED = 0.1  # of an acceleration's whitened sum of squares
TRAVEL = 0.2  # [rad]
STRAIGHT = 1.34  # [rad]
FEWEST_ROWS = 50
RIPPLE_SEPARATION = 4.0  # [cycles per turn]

CREEP = 0.02  # [rad/s]
FEWEST_SAMPLES = 20
FEW_POSES = 12
EVEN = 0.1  # of a period
GAP = 1.5  # periods
UNEVEN = 0.5  # of the trials
STAMPS = 0.5  # of a sample

SURE = 2.0  # standard deviations
WHOLE = 0.15  # of a gear's swing
EDGE = 1e-3  # relative
FEW_TRIALS = 20
PART = 10.0  # [s]

TELLING = 0.5  # of a joint's leftover
SENSORS = 1.25  # variance over the sensors' noise
QUIET = 2.5  # variance over the sensors' noise
WANDER = 2.5  # variance over the sensors' noise
PATTERN = 100.0  # gain in twice the log likelihood
PATTERN_SHARE = 0.2  # of the claims' score
PATTERN_SIZE = 0.02
PATTERN_ROWS = 100
TOGETHER = 1.5  # times the best variable alone
NAMED_BESIDE = 0.5  # of the best variable's share
VARIABLES = 3
FRICTION_SCATTER = 0.06  # relative
SCATTERS = (0.002, 0.005, 0.01, 0.014, 0.02, 0.03, 0.045, 0.07, 0.12, 0.2)  # relative
USUAL_SCATTER = 0.02  # relative
SCATTERED = 3  # trials
STANDING = 0.02  # [rad]
STANDING_FRICTION = 0.05  # of the torque limit
PUSHED = 0.02  # of the torque limit
ODD = 0.01  # of the samples

GAIN = (0.5, 2.0)  # recorded over described torque
LOADED = 1e-3  # of the most loaded joint's torque

TAKEN_UP = 0.9  # of an effect's torque
FLAT = 0.05  # of a joint's friction
WARMER = 3.0  # [K]

OPEN_LOOP_CLAIM = 0.10  # of the held-out RMS error
OPEN_LOOP_HALVES = 0.05  # of the held-out RMS error
OPEN_LOOP_RIVAL = 0.03  # of the best effect's error
OPEN_LOOP_CLAIMS = 3  # per joint
OPEN_LOOP_TRIALS = 3
OPEN_LOOP_LOAD = 1e-6  # [N m]
SURE_RISE = 2.0  # standard errors
RISES = 0.02  # of the held-out torque error

SCALES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)  # of `Tolerance`
ROTOR_SCALES = (0.3, 0.6, 1.0)  # of `Tolerance`
DRIVES = 0.058  # of recorded over true torque
ROTOR_SHIFT = 0.3  # of the inertia stated
PRIOR_SHARE = 0.3  # of a joint's friction, or of the gravity that loads it
MANY = 4  # terms
SIZES = (10.0, 3.0, 1.0, 0.3, 0.1, 0.03)  # of such a law's prior
SAME_DRIVES = 0.01  # of recorded over true torque
DRIFT = 0.15  # relative
KNOWN_SCALES = (0.1, 0.3)  # of `Tolerance`
AS_BEFORE = 1.25  # of the torque that a model leaves of its own recordings

# asked of a finished model: what changed since, and whether `add` takes an effect
CHANGE_LOWERED = 0.05  # of a joint's torque error
PLAY_SURE = 4.0  # standard errors
PLAY_LOWERED = 0.05  # of the held-out error of the angle behind the gear
PLAY_CROSSING = 0.1  # of the link's torque, root mean square
PLAY_ROWS = 20
PLAY_BEND = 0.01  # of the gear's bend, root mean square
CHANGE_SURE = 4.0  # standard errors
DAILY = 0.10  # of its level
LEAST_GAIN = 0.02  # of the torque
LEAST_MASS = 0.05  # [kg]
LOADED_GAIN = 1.0  # of a joint's friction
ALIKE = 0.98  # of the best change's gain
CHANGE_TRIALS = 6
CHANGES = 8
CHANGE_ONSET = 0.1  # of what a change explains
CHANGE_BLOCKS = 2
HELPS, HELPS_THERE = 0.02, 0.05  # of the held-out error
WIDER = 0.10  # of the widths of U


class Threshold(NamedTuple):
    """One line of the table; ``unit``: how the value is printed (%, ms or what else follows a plain number)."""

    name: str
    meaning: str
    unit: str
    calibration: str

    @property
    def value(self) -> Any:
        return globals()[self.name]

    @property
    def shown(self) -> str:
        """The value in its unit."""
        values = self.value if isinstance(self.value, tuple) else (self.value,)
        factor, unit = {"%": (100.0, " %"), "ms": (1e3, " ms"), "": (1.0, "")}.get(self.unit, (1.0, f" {self.unit}"))
        return ", ".join(f"{factor * v:.3g}" for v in values) + unit


# of what an identification may choose by, too: a model file rests on these
SETTLED = (
    Threshold("THRESHOLD", "score of a claim; of laws that look alike a simpler one is named unless it leaves as much", "",
              "odds of 2.7e5 to 1 by the model: hundreds to 1 that none of some hundred candidates passes by chance"),
    Threshold("FORMS", "how far a claimed law may be off its true form, one standard deviation; found by evidence", "%",
              "chosen: the grid that evidence chooses from. On the 28 labelled sets and on 64 of 65 generated ones that were looked at meanwhile "
              "it gives the names that fixed shares of 3 and 0.3 % of a claim's evidence gave"),
    Threshold("DEGREE", "degree of the curves that its form may be off by, over torque, position, speed, load and trial each", "",
              "chosen"),
    Threshold("SAME_LAW",
              "how far a plainer law may be off, one standard deviation, and still be named instead of a finer one that looks alike", "%",
              "at 2 to 5 % a dress pack a tenth stiffer at its ends is a spring; from 3 % on an offset of 0.41 N m beside a spring of "
              "0.06 N m/rad would be an offset alone"),
    Threshold("LOWERED", "held-out error a claim lowers", "%",
              "a cause that raises the residual by 1.4 lowers it by 29 %; false claims on development sets lowered it by -0.5 and "
              "0.7 % (delays with scores of 63 and 516). Not asked of what a free rigid body takes up (payload, rotor inertia, "
              "torque gain, base tilt, encoder offset), but against a model of a gain (or within motions), and beside other claims: there such false "
              "ones lowered it by -0.2 to 0.7 % on a real UR10e with a load, by 0.8 % at a healthy wrist"),
    Threshold("LOWERED_MORE", "the same of a claim at a joint that has one already", "%",
              "what the imperfect law of a first claim leaves: a needless cubic term after Stribeck friction lowered it by 3 %; true second "
              "causes by 12 % and more"),
    Threshold("LOWERED_SWING", "the same of an elastic gear, which readings of the motor's side alone show", "%",
              "true ones of labelled and generated sets lowered it by 30 to 77 %"),
    Threshold("STANDS_OUT", "the same where the joint keeps more than `QUIET` when all claims are known", "%",
              "real arms keep 5 to 20 times their sensors' noise: on a UR10e a torque gain of -13 % that was none lowered it by 4 %, a load's "
              "friction by 11 to 35 %"),
    Threshold("MAX_CLAIMS", "most claims", "", "chosen: a bound on the search"),
    Threshold("CONTENDERS", "best distinct effects and joints, refined and not found to be nothing, before one is claimed", "",
              "chosen: a bound on the search"),
    Threshold("HANDFUL", "claims that are named; the rest is told in sum", "",
              "chosen: later claims are mostly what the imperfect laws of the first ones leave, one after another"),
    Threshold("SHORTEST_LAG", "shortest lag; at least half a sample", "ms",
              "stamps half a sample apart look like a lag (1 to 3 ms on the two healthy sets looked at, with a score up to 1072): "
              "no effect"),
    Threshold("LAG_PRICE", "price of a lag, paid by contenders and claims alike", "", "half a millisecond found among 20"),
    Threshold("NOISE_KNOWN", "error of the torque noise's variance; a part of it a drive's lag takes off, which is counted against that", "%",
              "healthy joints leave 0.92 to 1.10 times their sensors' noise"),
    Threshold("SWING_PRICE", "the same of an elastic gear, and of levers where a gas spring must stand apart from a plainer one", "",
              "stiffness found to 1 %, damping to a tenth; a place and levers alike"),
    Threshold("BUILT_UP", "friction torques of the first fit, at the joint's usual speed, that hysteresis may build up", "",
              "chosen: hysteresis makes that first friction smaller, so more than one is possible"),
    Threshold("FAR_OVER_NOISE", "residual variance over noise from which a delay is looked for by shifting the record", "",
              "chosen: from here on the shifted record's own noise cannot pass for an effect"),
    Threshold("SWINGS", "how fast a gear's link may swing to be looked for", "rad/s",
              "chosen: periods from 0.1 to 1.5 s, which rows can show"),
    Threshold("SWING_JOINTS", "joints, the noisiest, at which swings are looked for that smoothing would hide", "",
              "chosen: a bound on the search"),
    Threshold("BEGINNINGS", "rows of a trial from which on the swing that it began with is told from friction and an offset", "",
              "chosen"),
    Threshold("AT_REST", "speed below which a trial begins with a gear that carries gravity alone", "rad/s",
              "chosen: twice the speed below which rows say nothing"),
    Threshold("ACCELERATED",
              "share that the position's noise may have in the square of what joints accelerate at (their median), before all is smoothed more", "%",
              "an inertia is short by that share: here less than any model knows. Motions at the usual speed: 0.04 to 0.4 %; at 0.15 of the "
              "limits 3 to 4 %, at 0.06 28 to 100 %"),
    Threshold("DROWNED", "share of the position's noise in a joint's acceleration from which on no inertia is told from it", "%",
              "it makes an inertia wrong by about that share, and a data sheet's is off by 10 to 30 %. Motions at the usual speed: below 1 %; at "
              "0.06 of the limits 27 to 100 % before more is smoothed: a rotor was named there that would leave its motor a quarter of its inertia"),
    Threshold("TRAVEL", "movement of a joint below which no constant torque is told from a law of the position", "rad",
              "a form that is 2 % off may bend by 10 % to either side within a claim's evidence: as much as what rests a radian away does over "
              "0.2 rad. Joints had moved by 0.025 and 0.11 rad where a cable pack and a gas spring were named as friction that differs between "
              "the directions"),
    Threshold("FEWEST_ROWS", "moving rows of a joint from which on it is asked at all", "",
              "chosen"),
    Threshold("RIPPLE_SEPARATION", "ripples of one joint that count as different", "cycles per turn",
              "chosen: a trial's motion hardly tells nearer ones apart"),
    Threshold("CREEP", "speed below which stiction makes the torque indeterminate", "rad/s",
              "30 times the smoothed speed's own noise"),
    Threshold("FEWEST_SAMPLES", "samples of a moving trial from which on it counts", "",
              "chosen: fewer do not tell their sensors' noise"),
    Threshold("FEW_POSES", "poses from which on their own scatter is told", "",
              "chosen"),
    Threshold("EVEN", "stamps no farther off an even clock, in its periods, are even", "",
              "chosen: as clocks are"),
    Threshold("GAP", "time between stamps, in periods, from which on samples were lost", "",
              "chosen: half way to one lost"),
    Threshold("UNEVEN", "share of trials with uneven stamps from which on their clock is that of all", "%",
              "chosen: the larger part"),
    Threshold("STAMPS", "how late stamps may be, in samples, one standard deviation", "",
              "a torque held over a sample acts half a sample later than its stamp"),
    Threshold("SURE", "standard deviations that some number of an effect must exceed, and none its range", "",
              "chosen: else the recordings give it no size"),
    Threshold("WHOLE", "how far a gear's swing may be off the size that its stiffness gives it, its error included", "%",
              "true gears of labelled, generated and hardware-size sets 1 to 10 %; what imitates one 22 % and more (a real UR10e's elbow, whose two "
              "halves of recordings contradict each other: 0.83 +- 0.07 in all, 0.64 +- 0.04 in one; play in the gear beside it)"),
    Threshold("EDGE", "a shape this near to the end of its range was stopped there, not found", "%",
              "chosen"),
    Threshold("FEW_TRIALS", "trials below which parts of them are taken as independent", "",
              "chosen"),
    Threshold("PART", "length of such a part", "s",
              "chosen: some motions"),
    Threshold("TELLING", "share of a joint's leftover one claim must explain, where something is left", "",
              "true causes with something left: 0.57 to 1.0 (elasticity 0.61 to 0.78); causes outside the catalogue: 0.03 to 0.47"),
    Threshold("SENSORS", "leftover variance up to which only the sensors' noise is left", "",
              "0.7 to 1.0 where friction is smooth within a trial"),
    Threshold("QUIET", "leftover variance", "",
              "friction wanders within a trial too, as real drives' does: healthy simulated arms reach 1.09 (LWA-4P, 6 campaigns, seeds 901 "
              "to 906) and 1.10 (UR10e, heavier joints, 4 campaigns, seeds 905 to 908), the 4 healthy labelled sets 0.92"),
    Threshold("WANDER", "leftover variance of half-second sums", "",
              "33 healthy joints of 6 unseen sets (below): 0.62 to 1.04, mean 0.77; our own healthy arms to 0.97; a wander as large as "
              "the noise 3, one that raises its joint's residual threefold 91; a test holds one that single rows do not show"),
    Threshold("PATTERN", "pattern left", "",
              "gain of a step function of one variable on held-out motions; healthy, the same campaigns: LWA-4P to 6.1, labelled sets to 19.3, "
              "UR10e to 18.5"),
    Threshold("PATTERN_SHARE", "share of its joint's claims' score from which on a pattern left contradicts them", "%",
              "a true law leaves below 1 %, an impostor a quarter and more"),
    Threshold("PATTERN_SIZE", "and its variance, in what the claims took away", "",
              "chosen; tests hold that what a stiffening dress pack leaves does not contradict a straight spring, and that what a bump in the "
              "torque leaves contradicts what is named of it; `benchmarks/pattern_size.py` prints both sides"),
    Threshold("PATTERN_ROWS", "moving rows of a joint from which on a pattern is looked for", "",
              "chosen: 24 steps of four rows"),
    Threshold("TOGETHER", "two variables are named together where their product explains so many times what either does alone", "",
              "chosen"),
    Threshold("NAMED_BESIDE", "share of the best variable's from which on another one is named beside it", "%",
              "chosen"),
    Threshold("VARIABLES", "most variables that are named of an unknown cause", "", "chosen"),
    Threshold("FRICTION_SCATTER", "friction scatter", "", "healthy: 0.02 to 0.03"),
    Threshold("SCATTERS", "how friction may scatter from trial to trial; found by evidence", "%",
              "chosen: the grid that evidence chooses from"),
    Threshold("USUAL_SCATTER", "the same before anything is known, and of too few trials", "%",
              "healthy: 2 to 3 %"),
    Threshold("SCATTERED", "trials from which on the scatter of friction between them is estimated; of fewer it is taken as 2 %", "",
              "chosen: one trial tells no scatter at all"),
    Threshold("STANDING", "a trial in which no joint leaves this range stands still", "rad",
              "chosen"),
    Threshold("STANDING_FRICTION", "friction of a joint that no model tells, of its torque limit", "%",
              "chosen"),
    Threshold("PUSHED", "torque beyond friction either way, of the joint's limit, from which on an arm that stands is pushed", "%",
              "chosen"),
    Threshold("ODD", "share of such a trial's samples, at either end, that say nothing of its torque's range", "%",
              "chosen: single readings may be wrong"),
    Threshold("GAIN", "identified over described gravity torque that passes for a scale of the drives' torque", "",
              "chosen: a torque constant is not off by more; beyond, the description is taken to be wrong, and that is said"),
    Threshold("LOADED", "gravity torque, of the most loaded joint's, below which a joint says nothing of that scale", "%",
              "chosen"),
    Threshold("TAKEN_UP", "share of an effect's torque that the base model can imitate, from which on it hides it", "%",
              "chosen"),
    Threshold("FLAT", "change of gravity over a joint's friction below which the joint counts as not loaded", "%",
              "chosen"),
    Threshold("WARMER", "temperature range that can tell something", "K", "chosen"),
    Threshold("OPEN_LOOP_CLAIM", "held-out position error a claim lowers (compensated torque)", "%",
              "between repetitions it scatters by some percent"),
    Threshold("OPEN_LOOP_HALVES", "the same in each half of the held-out trials", "%",
              "chosen: no handful of trials may carry a claim alone"),
    Threshold("OPEN_LOOP_RIVAL", "an effect this near to the best one's error is named as its rival (compensated torque)", "%",
              "chosen: within the scatter between repetitions"),
    Threshold("OPEN_LOOP_CLAIMS", "most claims of a joint (compensated torque)", "", "chosen: a bound on the search"),
    Threshold("OPEN_LOOP_TRIALS", "even and odd repetitions from which on one is fitted and the other judged", "",
              "chosen"),
    Threshold("SURE_RISE", "scatter of the mean over held-out trials by which a claim must raise the torque error to be dropped", "",
              "chosen: two standard errors"),
    Threshold("RISES", "share by which it must raise it besides (compensated torque), or friction what a model leaves, to be refused", "%",
              "chosen: what an effect must lower it by, to help"),
    Threshold("OPEN_LOOP_LOAD", "change of load below which it counts as none", "N m",
              "rounding"),
    Threshold("DRIVES", "scale of the recorded torque, all drives alike, one standard deviation", "%",
              "data sheets state torque constants to 10 %, 5.8 % in the mean square"),
    Threshold("SCALES", "how far a description may be off, in its tolerance; found by evidence", "",
              "chosen: the grid that evidence chooses from"),
    Threshold("ROTOR_SCALES", "the same of data-sheet inertias", "",
              "not beyond 1: more than the tolerance is a finding; a description that is off as a whole no longer excuses one rotor"),
    Threshold("ROTOR_SHIFT", "prior deviation of an inertia that is not the data sheet's, of the one stated", "%",
              "chosen"),
    Threshold("PRIOR_SHARE", "prior deviation of an effect's torque, of its joint's friction; of a gas spring's, of what gravity loads it with",
              "%", "chosen: neither tiny nor dominant"),
    Threshold("MANY", "terms from which on a law's prior may be wider or smaller as a whole, as a gas spring's may", "",
              "ten vague priors would cost a small payload 40 points"),
    Threshold("SIZES", "sizes of that prior; each is charged for the choice", "",
              "chosen: the grid that evidence chooses from; with none above 1 a load of 2.805 kg, asked of its own recording against the "
              "description, was 0.80 kg, at most 2.55 kg; numbers are never of one below 1"),
    Threshold("SAME_DRIVES", "scale of the recorded torque against a model of the same drives, one standard deviation", "%",
              "chosen"),
    Threshold("DRIFT", "drift of friction against a model from other recordings, one standard deviation", "%",
              "chosen"),
    Threshold("KNOWN_SCALES", "how far links may be off such a model, in the description's tolerance; found by evidence", "",
              "chosen: only what has changed is asked for; with 1 besides a real UR10e's load of 2.805 kg is 2.66 +- 0.21 and 3.05 +- 0.19 kg"),
    Threshold("AS_BEFORE", "torque that a model leaves of a joint, over what it leaves of its own recordings, up to which nothing changed there", "",
              "chosen: other motions of one real small arm leave 0.8 to 1.4 times as much"),
    Threshold("PLAY_SURE", "standard errors that a gear's play must exceed", "",
              "chosen: every joint with a second encoder is asked"),
    Threshold("PLAY_LOWERED", "held-out error of the angle behind the gear that its play lowers", "%",
              "chosen, as of one joint's torque"),
    Threshold("PLAY_CROSSING", "share of the link's torque within which its side is not certain", "%",
              "chosen: descriptions are off by as much"),
    Threshold("PLAY_BEND", "error of a gear's play by that of the link's torque, of the gear's bend", "%",
              "a UR10e-like elbow of 1e4 N m/rad, bent by 20 arcmin, on a description 2 to 5 % off: 0.15 to 0.18 arcmin too little "
              "(`benchmarks/backlash.py`)"),
    Threshold("PLAY_ROWS", "rows that are wanted of either side of the link's torque", "",
              "chosen: a second of a recording"),
)  # fmt: skip

# of a finished model: no model file rests on these
LATER = (
    Threshold("STRAIGHT", "movement of a joint below which no straight law of its position is told from a piece of a bent one", "rad",
              "a gas spring's sine about its rest is `SAME_LAW` off a straight line over 1.34 rad. Drawn trajectories of 30 s move a joint by 0.5 to "
              "1.2 rad, programs by 1.8 to 3.1"),
    Threshold("CHANGE_LOWERED", "held-out torque error that a change since identification lowers at a joint of its own", "%",
              "chosen"),
    Threshold("CHANGE_SURE", "standard errors by which a level must have changed", "",
              "chosen: some thirty levels are asked"),
    Threshold("DAILY", "share of its level by which friction must have changed", "%",
              "a real UR10e differs by 1.6 % (root mean square; at most 3.7 %) on six days of 28 s and more, by up to 15 % on two of fewer "
              "(`benchmarks/daily_friction.py`)"),
    Threshold("LEAST_GAIN", "change of a joint's torque scale", "%",
              "chosen: descriptions are off by as much"),
    Threshold("LEAST_MASS", "change of the load at the flange", "kg",
              "chosen"),
    Threshold("LOADED_GAIN", "torque of the rigid body over a joint's friction from which on its torque scale is asked for", "",
              "chosen: at a joint that carries nothing a scale is friction by another name"),
    Threshold("ALIKE", "share of the best change of a joint's friction from which on another one explains it as well", "%", "chosen"),
    Threshold("CHANGE_TRIALS", "trials, or of fewer ones blocks of time, from which on a change is asked for", "",
              "chosen: the scatter of fewer tells nothing"),
    Threshold("CHANGES", "changes that are told", "",
              "chosen"),
    Threshold("CHANGE_ONSET", "more that a change explains from a later trial on, so that it is said to begin there", "%",
              "chosen: friction differs from trial to trial by a few percent, whose sign is random"),
    Threshold("CHANGE_BLOCKS", "trials, or blocks of time, before it and after it that are wanted for that", "",
              "chosen: one trial alone may be odd"),
    Threshold("HELPS", "held-out error that an added effect lowers over all joints (compensated torque)", "%",
              "chosen"),
    Threshold("HELPS_THERE", "the same at its own joints", "%",
              "chosen: a single joint's error scatters more"),
    Threshold("WIDER", "share by which an added effect may widen U", "%",
              "sets of the same recordings differ by some percent with the nominal model under them"),
)  # fmt: skip
TABLE = (*SETTLED, *LATER)
