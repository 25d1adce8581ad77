"""The hash of settings: every constant that a model rests on is in it by a name of its own, and nothing else is."""

from __future__ import annotations

import ast
import dataclasses
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import grimp
import numpy as np
import pytest

from stopset.effects.registry import catalogue
from stopset.offline.campaign.settings import Settings
from stopset.offline.diagnose import thresholds
from stopset.offline.identify import constants as table
from stopset.offline.identify.constants import TABLE, digest, settings_sha256
from stopset.offline.nominal import prior

START = "stopset.offline.identify.pipeline"  # and all it imports is what stands between recordings and model file
HOUSE = (
    "stopset.offline", "stopset.reach", "stopset.artifact", "stopset.effects", "stopset.robot", "stopset.sets", "stopset.ring",
    "stopset.recording", "stopset.simulation",
)  # fmt: skip
GATE = "decides whether recordings are taken, not what is made of them"
WORDS = "words for people"
FORMAT = "how a file is written"
BUDGET = "how work is divided or memory bounded; results are the same to the last bit"
CODES = "places in a table, return codes"
ROLES = "names of effects: what an effect is belongs to its own file and law"
SHOWN = "what pages show of it"
REFUSED = "bounds what is taken from a user, not what is made of it"
# constants that no number of a model rests on: module (or its last name and a star), names, why
LEFT_OUT = (
    ("stopset.artifact.abstraction", "_PROGRAMS", BUDGET),
    ("stopset.artifact.inputs", "BODY IN_ABSTRACTION LEFT_TO_U GAIN ENTRIES", ROLES),
    ("stopset.artifact.model", "SCHEMA_VERSION", FORMAT),
    ("stopset.artifact.store", "FORMAT FIRST_SCHEMA LAGS ARM", FORMAT),
    ("stopset.artifact.contents", "MOST_STEPS MOST_NUMBERS LARGEST SLOWEST CORNER_SPEED", REFUSED),
    ("stopset.artifact.polynomial", "MOST_POWER", REFUSED),
    ("stopset.artifact.taped", "SIGNALS TILT TIP MEMORY RIGID", CODES),
    ("stopset.effects.base", "LOOSE", ROLES),
    ("stopset.effects.bound", "ACTING", ROLES),
    ("stopset.effects.registry", "GROUP", FORMAT),
    ("stopset.recording.seen", "SIGNALS", FORMAT),
    ("stopset.recording.files", "LOGS", FORMAT),
    ("stopset.offline.description.reduce", "LINK", FORMAT),
    *(("stopset.unpacked", name, REFUSED) for name in ("RATIO", "FREE", "PIECE", "TOTAL", "MESSAGE")),
    ("stopset.offline.nominal.physical", "_UPPER", CODES),
    ("stopset.offline.campaign.map_reduce", "PER_WORKER CONNECT FEWEST A B", BUDGET),
    ("stopset.offline.campaign.trials", "MOST", BUDGET),
    ("stopset.offline.campaign.hold_out", "OTHER_MOTIONS OTHER_REPETITIONS", WORDS),
    ("stopset.offline.diagnose.search.structures", "ADVICE", WORDS),
    ("stopset.offline.diagnose.search.structures", "LOGARITHMIC", CODES),
    ("stopset.offline.abstraction.metrics", "TOGETHER", BUDGET),
    ("stopset.offline.conform.corners", "Q_LO V_LO Q_HI V_HI NOISE_LO NOISE_HI U_LO U_HI", CODES),
    ("stopset.offline.conform.guarantee", "GIVEN OTHER_MOTIONS REPETITIONS SAME_MOTION NO_REPETITION", WORDS),
    ("stopset.offline.conform.linear_sets", "T BOX", WORDS),
    ("stopset.offline.conform.nonlinear", "BATCH", BUDGET),
    ("stopset.offline.identify.pipeline", "PASSES", BUDGET),
    ("stopset.offline.diagnose.levels", "FEW", "what changed since is no part of a model"),
    ("stopset.offline.identify.signals_file", "*", FORMAT),
    ("stopset.offline.identify.pipeline", "FITTING", WORDS),
    ("stopset.offline.identify.absurd", "BEHIND_GEARS", WORDS),
    ("stopset.offline.conform.nonlinear_sets", "TOGETHER", BUDGET),
    ("stopset.offline.conform.program", "BEYOND UNSOLVED", WORDS),
    ("stopset.offline.diagnose.columns.laws", "RIGID TRANSMITTED MOVING", ROLES),
    ("stopset.offline.diagnose.compensated", "CARRIED", CODES),
    ("stopset.offline.diagnose.diagnose", "ALREADY OF_ALL SINCE SINGLE", WORDS),
    ("stopset.offline.diagnose.examination", "INNER WHILE_MOVING", WORDS),
    ("stopset.offline.diagnose.load", "CARRIED_BY_LINKS WEIGHED_ALONE NO_SUCH_BODY", WORDS),
    ("stopset.offline.diagnose.plays", "UNREAD ONE_SIDED", WORDS),
    ("stopset.offline.diagnose.standing", "MOVE USUAL_TORQUE", "of an arm that does not move no model is made"),
    ("stopset.offline.diagnose.evidence.engine", "CACHED RECENT PLACES", BUDGET),
    ("stopset.offline.diagnose.side_by_side", "A B", BUDGET),
    ("stopset.offline.diagnose.evidence.baseline", "DESCRIBED", WORDS),
    ("stopset.offline.diagnose.evidence.uncertainty", "BY_ROWS", CODES),
    ("stopset.offline.diagnose.explain.identifiable",
     "LOADS UNRECORDED EVEN STILL UNLOADED TRACELESS IMITATED NOISE REMEDIES", WORDS),
    ("stopset.offline.diagnose.explain.partial", "POINTS", SHOWN),
    ("stopset.offline.diagnose.explain.residual", "BINS FEW_BINS BLOCK", SHOWN),
    ("stopset.offline.diagnose.search.held_out", "WHOLE BLOCKS", WORDS),
    ("stopset.offline.diagnose.thresholds", "SETTLED TABLE", SHOWN),
    ("stopset.offline.diagnose.thresholds", " ".join(t.name for t in thresholds.LATER) + " LATER", "asked of a finished model only"),
    ("stopset.offline.diagnose.levels", "PARTS", ROLES),
    ("stopset.offline.diagnose.changes", "RIDGE STEPS", "asked of a finished model only"),
    ("stopset.offline.identify.constants", "SCHEMA TABLE HASHED_AS", "the table itself"),
    ("stopset.offline.update.update", "WIDEST", REFUSED),
    ("stopset.offline.description.agreement", "STATES AGREES FAST", GATE),
    ("stopset.offline.description.complete", "FREE PRODUCTS TURNING", FORMAT),
    ("stopset.offline.description.enclose", "ROUND OUTWARD", "how tightly a link's shape is enclosed; that it is, is checked after"),
    ("stopset.offline.description.outline", "TURNS", "kinds of joints in a URDF"),
    ("stopset.offline.campaign.settings", "HORIZON", "the default of a setting, which is hashed as chosen"),
    ("stopset.offline.inspect.*", "*", GATE),
    ("stopset.offline.nominal.fit", "ANOTHER_ARM", WORDS),
    ("stopset.offline.nominal.preprocess", "T", BUDGET),
    ("stopset.offline.nominal.scale", "LAWS", WORDS),
    ("stopset.offline.identify.rests", "STANDS MOSTLY", SHOWN),
    ("stopset.offline.nominal.fit", "NOTABLY_OFF", WORDS),
    ("stopset.offline.nominal.low_pass", "TURNS_OVER", WORDS),
    ("stopset.offline.abstraction.nominal_part", "NO_TRACE", WORDS),
    ("stopset.offline.nominal.nominal", "LOW_PASS LAG", WORDS),
    ("stopset.offline.nominal.normal_equations_file", "SCHEMA ARRAYS", FORMAT),
    ("stopset.offline.nominal.unidentifiable", "PARAMETERS", WORDS),
    ("stopset.offline.stops.*", "*", "shows recorded stops"),
    ("stopset.offline.update.*", "*", FORMAT),
    ("stopset.reach.nonlinear", "_DYNAMICS FASTEST FAR NEAR MARGIN", BUDGET),
    ("stopset.reach.stops.bounds", "FASTEST", REFUSED),
    ("stopset.reach.stops.cartesian", "SLICES", "in the workspace only, which no model file holds"),
    ("stopset.reach.stops.friction", "RUBS RUBS_VISCOUS DRY VISCOUS PUSH", CODES),
    ("stopset.reach.stops.friction", "UNBOUNDED", WORDS),
    ("stopset.reach.stops.laws", "ROLES ROAMING", CODES),
    ("stopset.reach.stops.parts", "ALL_PARTS", CODES),
    ("stopset.reach.stops.setting", "OUTSIDE", WORDS),
    ("stopset.offline.abstraction.metrics", "REPEATED", "which scatters between repetitions are reported"),
    ("stopset.reach.stops.start", "NONE", "no extrapolation at all: what is known at the start as it is"),
    ("stopset.reach.stops.payload", "SAME_PLACE", REFUSED),
    ("stopset.reach.stops.setting", "HEAVIEST FARTHEST", REFUSED),
    ("stopset.reach.stops.setting", "NEXT_TO_NOTHING", WORDS),
    ("stopset.reach.stops.ramp", "KEY", FORMAT),
    ("stopset.reach.stops.ramp", "LONGEST STEEPEST QUICKEST", REFUSED),
    ("stopset.reach.stops.split", "FIELDS", CODES),
    ("stopset.reach.stops.tube", "OK ENDLESS UNBOUNDED _ROWS", CODES),
    ("stopset.reach.stops.types", "LAYERS CATEGORIES", WORDS),
    ("stopset.reach.stops.words", "*", WORDS),
    ("stopset.recording.csv_table", "LINES LONGEST", BUDGET),
    ("stopset.recording.files", "BATCH_ROWS", BUDGET),
    ("stopset.recording.files", "TICKS", "what a unit of time means"),
    ("stopset.recording.types", "PHASES UNCOUNTED EFFORTS", FORMAT),
    ("stopset.recording.writer", "GROUP_ROWS", FORMAT),
    ("stopset.ring.tape", "*", CODES),
    ("stopset.ring.taylor", "MEMORY_LIMIT _KEY_BITS _TERM_BYTES _WORK_BYTES", BUDGET),
    ("stopset.ring.tape", "*", CODES),
    ("stopset.robot.rigid", "_ARM", CODES),
    ("stopset.robot.drives", "_KNOWN", "names of a data sheet's fields"),
    ("stopset.robot.drives", "ON_EARTH LATEST STRONGEST", REFUSED),
)  # fmt: skip


def written_in(module: str) -> Iterator[str]:
    """Upper-case names that a module gives a value at its top level."""
    spec = find_spec(module)
    assert spec is not None and spec.origin is not None
    for node in ast.parse(Path(spec.origin).read_text(encoding="utf-8")).body:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        for name in (n for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)):
            if name.id.isupper():
                yield name.id


@cache
def pipeline() -> tuple[str, ...]:
    graph = grimp.build_graph(*HOUSE, cache_dir=None)
    return tuple(sorted({START, *graph.find_upstream_modules(START)}))


def left_out(module: str, name: str) -> bool:
    return any(
        name in names.split() or names == "*"
        for where, names, _ in LEFT_OUT
        if module == where or (where.endswith("*") and module.startswith(where.removesuffix("*")))
    )


def test_every_constant_of_the_pipeline_is_in_the_hash_or_left_out_for_a_reason() -> None:
    hashed = {(module.__name__, name) for _, module, names in TABLE for name in names.split()}
    assert len(pipeline()) > 100
    missing = [
        f"{module}.{name}" for module in pipeline() for name in written_in(module)
        if (module, name) not in hashed and not left_out(module, name)
    ]  # fmt: skip
    assert not missing, f"{missing}: add to stopset.offline.identify.constants.TABLE, or here with a reason"
    assert not [f"{m}.{n}" for m, n in hashed if left_out(m, n)]
    assert all(why for *_, why in LEFT_OUT)


def test_a_constant_with_a_better_name_keeps_the_one_it_is_hashed_by() -> None:
    """Renaming is no other setting: the old name stays in the hash, and is nobody else's."""
    written = {f"{group}.{name}" for group, _, names in TABLE for name in names.split()}
    assert table.HASHED_AS.keys() <= written and not set(table.HASHED_AS.values()) & written
    assert set(table.HASHED_AS.values()) <= table.constants().keys() and not table.HASHED_AS.keys() & table.constants().keys()


def test_what_effects_run_is_part_of_it() -> None:
    """`identify --effects` runs the diagnosis; array constants count too."""
    names = table.constants()
    assert {"diagnosis.THRESHOLD", "diagnosis rows.KERNEL", "diagnosis ripple.RIPPLES", "normal equations.DELAYS"} <= names.keys()
    assert len(names) == sum(len(n.split()) for *_, n in TABLE) + 4
    assert settings_sha256(Settings(effects=("stribeck",))) != settings_sha256(Settings())


def other(value: Any) -> Any:
    """Another value of the same kind."""
    if isinstance(value, np.ndarray):
        out = value.copy()
        out.flat[-1] += 1e-12 * (1.0 + abs(out.flat[-1]))
        return out
    if isinstance(value, tuple):
        return (*value[:-1], other(value[-1]))
    return value + "x" if isinstance(value, str) else np.nextafter(value, np.inf) if isinstance(value, float) else value + 1


def test_changing_any_value_changes_the_hash() -> None:
    values = table.constants()
    found, expected = {digest(values)}, 1
    for key, value in values.items():
        plain = dataclasses.asdict(value) if dataclasses.is_dataclass(value) and not isinstance(value, type) else value
        parts = list(plain) if isinstance(plain, dict) else [None]
        found |= {digest({**values, key: other(plain) if p is None else {**plain, p: other(plain[p])}}) for p in parts}
        expected += len(parts)
    assert len(found) == expected


@pytest.mark.parametrize("where", [(m, n) for _, m, names in TABLE for n in names.split()[:1]], ids=lambda w: w[0].__name__)
def test_the_module_says_it_not_a_copy(where: tuple[Any, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The first constant of each group, changed where it stands."""
    before = settings_sha256(Settings())
    module, name = where
    monkeypatch.setattr(module, name, other(getattr(module, name)))
    assert settings_sha256(Settings()) != before


def test_settings_tolerances_and_effect_ranges_count(monkeypatch: pytest.MonkeyPatch) -> None:
    before = settings_sha256(Settings())
    assert settings_sha256(Settings(bands=2)) != before
    monkeypatch.setattr(prior.Tolerance.__init__, "__defaults__", (0.5, *(prior.Tolerance.__init__.__defaults__ or ())[1:]))
    assert settings_sha256(Settings()) != before
    monkeypatch.undo()
    stribeck = catalogue()["stribeck"]
    with_it = settings_sha256(Settings(effects=("stribeck:axis_1",)))
    shape = dataclasses.replace(stribeck.shapes[0], hi=2 * stribeck.shapes[0].hi)
    monkeypatch.setattr(
        table, "get", lambda n: dataclasses.replace(stribeck, shapes=(shape,)) if n == "stribeck" else catalogue()[n]
    )
    assert settings_sha256(Settings(effects=("stribeck:axis_1",))) != with_it
    assert settings_sha256(Settings()) == before


def test_the_hash_knows_names_and_values_only() -> None:
    """Golden: no path of a module, no order, no kind of container that holds the same numbers."""
    values = {
        "b.STEP": 0.1,
        "a.GRID": np.array([[0.0, 0.5], [1.0, 1.5]]),
        "a.NAMES": frozenset({"y", "x"}),
        "c.PAIR": (1, None, True),
    }
    golden = "5d9031ff46bdbc423e63662cbea3888757278e27e603b2375c246cbf35f45ad7"
    assert digest(values, schema=1) == golden
    assert digest(dict(reversed(values.items())), schema=1) == golden
    assert digest(values, schema=2) != golden
    text = str([f"{group}.{name}" for group, _, names in TABLE for name in names.split()])
    assert "stopset" not in text and "offline" not in text
    with pytest.raises(TypeError, match="no number"):
        digest({"a": object()})
