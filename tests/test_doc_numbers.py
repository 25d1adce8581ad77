"""Numbers are said once: what a page says of a constant is what the code has."""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path
from typing import Any

import pytest

from stopset.offline.campaign import calibration, session
from stopset.offline.conform import guarantee
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.engine import FOLDS
from stopset.offline.diagnose.rows import prepare
from stopset.offline.identify import constants
from stopset.offline.nominal import parameter_uncertainty, prior
from stopset.offline.update import staleness
from stopset.reach.stops import failed, tubes

ROOT = Path(__file__).parents[1]
# page, what it says, the numbers in it
SAID: tuple[tuple[str, str, tuple[float, ...]], ...] = (
    ("diagnosis", "One Gaussian kernel ({:g} ms)", (1e3 * prepare.KERNEL,)),
    ("diagnosis", "one row per {:g} ms", (1e3 * prepare.ROW_STEP,)),
    ("diagnosis", "Rows slower than {:g} rad/s", (limit.CREEP,)),
    (
        "diagnosis",
        "position error by {:g} %, and by {:g} % in each half",
        (100 * limit.OPEN_LOOP_CLAIM, 100 * limit.OPEN_LOOP_HALVES),
    ),
    ("diagnosis", "explains {:g} times as much as the best one alone", (limit.TOGETHER,)),
    ("diagnosis", "falls by {:g} % over the arm or by {:g} % at its own joint", (100 * limit.HELPS, 100 * limit.HELPS_THERE)),
    ("diagnosis", "A lag of less than {:g} ms is none", (1e3 * limit.SHORTEST_LAG,)),
    ("stops", "steps of 1/{:g} of the expected stop", (tubes.KNOTS.stop,)),
    ("uncertainty-sets", "differ by more than {:g} % of the torque error", (100 * staleness.SHARE,)),
    ("uncertainty-sets", "more than {:g} times that on the old ones", (staleness.GROWN,)),
    ("uncertainty-sets", "bound at {:g} %", (100 * guarantee.CONFIDENCE,)),
    ("uncertainty-sets", "nominal torque at {:g} % of", (100 * parameter_uncertainty.SHARE,)),
)
WORDS = {2: "two", 4: "four", 5: "five", 6: "six", 8: "eight", 10: "ten", 12: "twelve"}
# the same where the number is a word
IN_WORDS: tuple[tuple[str, str, float], ...] = (
    ("diagnosis", "with fewer than {} motions on every", FOLDS),
    ("diagnosis", "(of {} seconds, where", limit.PART),
    ("diagnosis", "it takes {} as much", prior.IDENTIFICATION),
    ("stops", "is cut into {} windows", tubes.FAST_WINDOWS),
    ("stops", "a monitored ramp into {} slices, or", failed.FAST_SLICES),
    ("stops", "into {} where the energy has to help", failed.SLICES),
    ("uncertainty-sets", "With fewer than {} motions it is calibrated", calibration.FEWEST_MOTIONS),
    ("uncertainty-sets", "never narrower than {} the standard error", parameter_uncertainty.ERRORS),
)


def page(name: str) -> str:
    return " ".join((ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8").split())


@pytest.mark.parametrize(("name", "sentence", "numbers"), SAID, ids=lambda x: x if isinstance(x, str) and " " not in x else "")
def test_a_page_says_what_the_code_has(name: str, sentence: str, numbers: tuple[float, ...]) -> None:
    assert sentence.format(*numbers) in page(name)


@pytest.mark.parametrize(("name", "sentence", "number"), IN_WORDS, ids=lambda x: x if isinstance(x, str) and " " not in x else "")
def test_a_page_says_in_words_what_the_code_has(name: str, sentence: str, number: float) -> None:
    word = WORDS[round(number)]
    assert sentence.format(word) in page(name) or sentence.format({"two": "twice"}.get(word, word)) in page(name)


@pytest.fixture(scope="module")
def tables() -> Any:
    spec = importlib.util.spec_from_file_location("doc_tables", ROOT / "benchmarks" / "doc_tables.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_tables_are_up_to_date(tables: Any) -> None:
    stale = [p for p, text in tables.build().items() if (ROOT / p).read_text(encoding="utf-8") != text]
    assert not stale, f"{stale} differ from the code; run python benchmarks/doc_tables.py"


def test_a_changed_threshold_changes_the_table(tables: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    before = tables.build()
    monkeypatch.setattr(limit, "QUIET", 3.25)
    after = tables.build()
    assert "| leftover variance | 3.25 |" in after["docs/diagnosis.md"] and before != after


def test_every_threshold_has_a_meaning_and_a_calibration() -> None:
    written = [name for name in vars(limit) if name.isupper() and name not in ("TABLE", "SETTLED", "LATER")]
    assert sorted(t.name for t in limit.TABLE) == sorted(written)
    assert all(t.meaning and t.calibration for t in limit.TABLE)
    assert len({t.meaning for t in limit.TABLE}) == len(limit.TABLE)


# numbers of the diagnosis that decide nothing: module, names, why
FINENESS = (
    ("levels", "FEW", "rows on which torques are held side by side"),
    ("changes", "RIDGE STEPS", "rounding; how often joints are weighed by what is left of them"),
    ("columns/elasticity", "RATHER_NOT SUBSTEPS SWING_ROUNDS", "how finely a swing is integrated"),
    (
        "plays",
        "PART FEWEST STILL",
        "how a recording is cut, into how many pieces at least, and how friction behind a gear is fitted",
    ),
    ("plays", "SOFT CROSSING", "two widths of a gear's bend; rows beside a change of sides"),
    ("search/ripple", "STEP RIPPLES", "grid of a search"),
    ("compensated", "STEP SCREENING FINALISTS", "how finely is simulated, and how many are simulated to the end"),
    ("evidence/baseline", "POSES", "how many poses an average is taken over"),
    ("evidence/candidate", "HELD", "infinite"),
    ("evidence/engine", "EMPTY", "rounding"),
    ("evidence/engine", "RECENT CACHED PLACES", "how much is kept in memory"),
    ("evidence/evidence", "RIDGES REPEATED", "rounding"),
    ("evidence/hypothesis", "GIVEN ROUNDS", "none; how often an iteration goes round"),
    ("explain/partial", "POINTS", "how many are drawn"),
    ("explain/residual", "BINS FEW_BINS BLOCK", "how finely a pattern is drawn"),
    ("evidence/uncertainty", "STEP TWO_SIDES", "of a numerical derivative; of an interval"),
    ("rows/noise", "ORDER", "how far a prediction looks back"),
    ("rows/prepare", "KERNEL LIGHT ROW_STEP WIDER ONE_DIRECTION", "how rows are smoothed and thinned; rounding"),
    ("rows/rows", "DEPENDENT", "rounding"),
    ("rows/sampling", "ROUNDING", "rounding"),
    ("search/refine", "FINEST_LAG", "where a search ends"),
    ("columns/structure", "SHORT STEP", "where a structure is thought to give; of a numerical derivative"),
    (
        "search/structures",
        "RATES LIGHTLY ANGLES FEET NEAR WORTH STEPS FINEST ROUNDS DAMPED",
        "of a search: where it begins, how far and how finely it goes",
    ),
    ("search/lag_form", "FINEST SETTLED", "where a search ends, and a filter's memory"),
    ("search/settled", "PARTS", "how finely the slope of a torque over the position is looked at"),
    (
        "search/moment_arms",
        "SEARCHES ALONG CLIMB FALLS",
        "how often, from how many values, how long and whether at all is sought",
    ),
    ("search/wanted", "LAGS", "start values of a search"),
    ("standing", "USUAL_TORQUE", "stands in for a number that nobody stated"),
)
PLAIN = {0, 1, 2}  # none, one, either side: no threshold
# comparisons with twice something that is no threshold
TWICE = (
    ("search/ripple", "power[top] < 2 * np.log(len(RIPPLES))", "the logarithm of a likelihood, for its square"),
    ("rows/prepare", "len(g.t) > 2 * kernel.half + step", "a kernel's two sides"),
    ("standing", "swing > 2 * friction + limit.PUSHED * most", "friction to either side"),
)


def numbers(node: ast.AST) -> list[float]:
    """Numbers in a piece of code that are no plain ones, and those that something is multiplied by."""
    found = [x.value for x in ast.walk(node) if isinstance(x, ast.Constant) and type(x.value) in (int, float)]
    times = [s for x in ast.walk(node) if isinstance(x, ast.BinOp) and isinstance(x.op, ast.Mult) for s in (x.left, x.right)]
    twice = [x.value for x in times if isinstance(x, ast.Constant) and x.value == 2]
    return [x for x in found if x not in PLAIN] + twice


def own_numbers(text: str) -> set[str]:
    """What a module compares with a number of its own, and the numbers it names."""
    tree, named = ast.parse(text), set()
    for node in tree.body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None and any(
            isinstance(x, ast.Constant) and type(x.value) in (int, float) for x in ast.walk(node.value)
        ):  # fmt: skip
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            named |= {x.id for t in targets for x in ast.walk(t) if isinstance(x, ast.Name) and x.id.isupper()}
    compared = [n for n in ast.walk(tree) if isinstance(n, ast.Compare) and any(map(numbers, (n.left, *n.comparators)))]
    return named | {ast.unparse(n) for n in compared}


def test_no_module_of_the_diagnosis_has_a_threshold_of_its_own() -> None:
    folder = Path(limit.__file__).parent
    fine = {(module, name) for module, names, why in FINENESS for name in names.split() if why}
    fine |= {(module, comparison) for module, comparison, why in TWICE if why}
    own = {
        (path.relative_to(folder).with_suffix("").as_posix(), what)
        for path in folder.rglob("*.py")
        if path.name != "thresholds.py"
        for what in own_numbers(path.read_text(encoding="utf-8"))
    }
    assert own - fine == set(), "put it into thresholds.py with its meaning and calibration"
    assert fine - own == set()
    assert (
        own_numbers("if x.gain > 0.5 * best:\n    pass")
        and own_numbers("SURE = (2.0, 3)")
        and own_numbers("v > top + 2 * s")
        and not own_numbers("x[0] > limit.SURE")
    )


def test_one_tolerance_of_a_description() -> None:
    """Diagnosis and identification mean the same type; they differ by one factor that is said."""
    from stopset.offline import diagnose

    assert diagnose.Tolerance is prior.Tolerance
    wide = prior.Tolerance().times(prior.IDENTIFICATION)
    assert (wide.mass, wide.centre, wide.inertia, wide.rotor) == pytest.approx((0.072, 0.0036, 0.2, 0.06))
    assert wide.rotor_unknown == prior.Tolerance().rotor_unknown


def test_no_two_constants_of_the_pipeline_say_one_thing() -> None:
    """A name and a value found twice is one number written twice: import it, or say here why it is two."""
    two = {"FOLDS": "of the motions when friction laws are chosen, and when a claim is judged: each may change alone"}
    seen: dict[tuple[str, str], str] = {}
    double = []
    for key, value in constants.constants().items():
        group, _, name = key.rpartition(".")
        before = seen.setdefault((name, repr(value)), group)
        if before != group and name not in two:
            double.append(f"{name} = {value!r} of {before} and of {group}")
    assert not double, double


def test_warming_is_counted_by_one_rule() -> None:
    assert not hasattr(prepare, "REPEATED") and prepare.Session is session.Session
