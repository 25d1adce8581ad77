"""Zonotopes: set operations, and the torque set as a zonotope where joints are disturbed together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from plain_sets import boxed, contains, of_box, volume
from read_anew import from_scratch
from set_problems import problem
from stopset.artifact import Abstraction, UncertaintySets, load_model, save_model
from stopset.errors import ModelFileError, NotConformant, NotCovered, RecordingError
from stopset.offline.abstraction.grid import Trial
from stopset.offline.campaign.reading_error import ReadingError
from stopset.offline.compare.compare import compare
from stopset.offline.conform.envelope import Deviations, Envelope
from stopset.offline.conform.linear_program import FittedSets, fit_sets
from stopset.offline.conform.linear_sets import BOX, enclosing
from stopset.offline.conform.zonotopes import Template, generators, template, torque_deviations
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import Identification, Settings, identify
from stopset.offline.update.sums_file import load_sums as load_state
from stopset.offline.update.update import save_state, update
from stopset.reach.flowpipe import along_joints, deviation_tube
from stopset.recording import Recording, read_recordings
from stopset.sets import Box, Zonotope
from synthetic import arm as robot_of
from synthetic import names, recordings, save_trials

numbers = st.floats(-10, 10, allow_subnormal=False)


@st.composite
def zonotopes(draw: st.DrawFn) -> Zonotope:
    d, m = draw(st.integers(1, 3)), draw(st.integers(1, 6))
    return Zonotope(draw(arrays.arrays(float, d, elements=numbers)), draw(arrays.arrays(float, (d, m), elements=numbers)))


def samples(Z: Zonotope, number: int = 200) -> np.ndarray:
    """Points inside, corners of the generators' cube among them."""
    b = np.random.default_rng(0).uniform(-1, 1, (number, Z.generators.shape[1]))
    return Z.centre + np.vstack([b, np.sign(b)]) @ Z.generators.T


@settings(max_examples=100, deadline=None)
@given(zonotopes(), st.integers(0, 10**6))
def test_nothing_is_lost(Z: Zonotope, seed: int) -> None:
    rng = np.random.default_rng(seed)
    L = rng.normal(size=(6, Z.dim))
    x = samples(Z)
    assert np.all(x @ L.T <= Z.support(L))
    assert contains(Z.box, x)
    E = rng.normal(size=(2, Z.dim))
    slack = 1e-12 * (1 + np.abs(Z.generators).sum() + np.abs(Z.centre).sum())  # rounding of the samples themselves
    assert np.all(x @ E.T @ np.ones(2) <= Z.mapped(E).support(np.ones(2)) + slack)
    assert np.allclose((Z + Z).width(L), 2 * Z.width(L))
    for order in (1, 2):
        small = Z.reduced(order)
        assert small.generators.shape[1] <= max(order * Z.dim, Z.generators.shape[1] * (Z.generators.shape[1] <= order * Z.dim))
        assert np.all(small.support(L) >= Z.support(L) - slack)


def test_containment_volume_and_box() -> None:
    slanted = Zonotope(np.array([1.0, 0.0]), np.array([[1.0, 0.5], [1.0, -0.5]]))  # a rectangle on its corner
    assert volume(slanted) == pytest.approx(4.0)
    assert contains(slanted, samples(slanted))
    assert not contains(slanted, np.array([1.0 + 1.4, -1.4]))  # in the box around it, not in the set
    assert contains(slanted.box, np.array([1.0 + 1.4, -1.4]))
    assert not contains(Zonotope(slanted.centre, 0.99 * slanted.generators), samples(slanted))
    box = Box.of([-1, 0, 2], [1, 1, 5])
    assert volume(of_box(box)) == pytest.approx(6.0)
    assert of_box(box).box.encloses(box)
    assert not contains(Zonotope(np.zeros(2), np.array([[1.0], [1.0]])), np.zeros(2))  # flat: says no rather than guess
    with pytest.raises(ValueError, match="expected"):
        Zonotope(np.zeros(2), np.zeros((3, 1)))


DT, NOISE = 0.02, Box.symmetric([1e-4, 1e-4, 2e-3, 2e-3])


def arm() -> Abstraction:
    return Abstraction(1, 1, np.linalg.inv(np.array([[2.0, 0.5], [0.5, 0.8]])), np.array([[8.0], [4.0]]))


def trials(G: np.ndarray, number: int = 12, N: int = 120, seed: int = 0) -> list[Trial]:
    """Trials of the linear arm under torques ``G b`` that jump between corners of the cube of b."""
    model, rng = arm(), np.random.default_rng(seed)
    Ad, Bd = _step(model)
    out = []
    for k in range(number):
        t = np.arange(N) * DT
        u = np.column_stack([3 * np.sin(t * (1 + k % 3)), np.cos(t + k)])
        push = rng.choice([-1.0, 1.0], (N // 15 + 1, G.shape[1])).repeat(15, axis=0)[:N] @ G.T
        x = np.zeros((N, 4))
        for i in range(N - 1):
            x[i + 1] = Ad @ x[i] + Bd @ (u[i] + push[i])
        out.append((x + rng.uniform(-1, 1, x.shape) * NOISE.hi, u))
    return out


def _step(model: Abstraction) -> tuple[np.ndarray, np.ndarray]:
    """Many small Euler steps; independent of the code under test."""
    A, B, h, E, S = model.A, model.B, DT / 4000, np.eye(4), np.zeros((4, 2))
    for _ in range(4000):
        S = S + h * (E @ B)
        E = E + h * (A @ E)
    return E, S


ACROSS = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2)
TOGETHER = np.array([[1.0, 0.05], [0.6, -0.08]])  # both joints are pushed the same way


def seen(data: list[Trial], model: Abstraction, l: np.ndarray, steps: int = 60) -> Envelope:  # noqa: E741
    """Envelope of all trials along ``l``, and of every window start."""
    deviations = Deviations(model, DT, steps, "sliding", l)
    envelope = deviations.empty()
    for k, (x, u) in enumerate(data):
        t = np.arange(len(x)) * DT
        deviations.add(envelope, Recording("open_loop", 0, k, k, t, x[:, :2], x[:, 2:], u), u)
    return envelope


def fits(data: list[Trial], model: Abstraction) -> dict[str, FittedSets]:
    l = np.vstack([np.eye(2), ACROSS])  # noqa: E741
    envelope = seen(data, model, l)
    shapes = {"box": np.eye(2), "zonotope": generators(torque_deviations(data, model, DT), model)}
    out = {}
    for name, G in shapes.items():
        T = Template(G, l)
        asked = problem(model, ReadingError.exact(NOISE), DT, 60, template=T)
        R = asked.responses()
        out[name] = enclosing(fit_sets(envelope, R, asked), R, envelope, decoupled=False)
    return out


def of(fit: FittedSets) -> Zonotope:
    assert fit.zonotope is not None
    return fit.zonotope.set


def test_a_zonotope_is_smaller_where_joints_are_disturbed_together() -> None:
    got = fits(trials(TOGETHER), arm())
    assert got["zonotope"].cost < 0.85 * got["box"].cost
    assert volume(of(got["zonotope"])) < 0.5 * volume(of(got["box"]))
    # and it is about the set that made the data
    true = Zonotope(np.zeros(2), TOGETHER)
    assert np.all(of(got["zonotope"]).width(ACROSS) < 1.25 * true.width(ACROSS) + 0.05)


def test_a_zonotope_is_never_worse_than_a_box() -> None:
    for G in (np.diag([1.0, 0.3]), TOGETHER, np.array([[0.5, 0.2, 0.1], [-0.1, 0.4, 0.3]])):
        got = fits(trials(G, 6), arm())
        assert got["zonotope"].cost <= got["box"].cost * (1 + 1e-6)


def sets_of(fit: FittedSets) -> UncertaintySets:
    return UncertaintySets(fit.X0, fit.U, fit.V, DT, 60 * DT, zonotope=fit.zonotope)


def test_the_tube_encloses_the_data_and_new_solutions_and_shrinking_breaks_it() -> None:
    model, l = arm(), np.vstack([np.eye(2), ACROSS])  # noqa: E741
    data = trials(TOGETHER)
    fit = fits(data, model)["zonotope"]
    sets = sets_of(fit)
    every, tube = seen(data, model, l), deviation_tube(model, sets, l)
    assert np.all(every.hi[1:] <= tube.hi[1:]) and np.all(every.lo[1:] >= tube.lo[1:])
    # new solutions under torques anywhere in U, from readings with any noise
    rng = np.random.default_rng(9)
    Ad, Bd = _step(model)
    project = along_joints(l)
    e = rng.uniform(fit.X0.lo, fit.X0.hi, (500, 4))
    U = of(fit)
    for h in range(1, 61):
        w = U.centre + np.sign(rng.uniform(-1, 1, (500, U.generators.shape[1]))) @ U.generators.T
        e = e @ Ad.T + w @ Bd.T
        x = e @ project.T
        assert np.all(x <= tube.hi[h]) and np.all(x >= tube.lo[h])
    assert sets.zonotope is not None
    small = replace(sets, zonotope=replace(sets.zonotope, generators=0.9 * sets.zonotope.generators))
    less = deviation_tube(model, small, l)
    assert not (np.all(every.hi[1:] <= less.hi[1:]) and np.all(every.lo[1:] >= less.lo[1:]))


def test_whoever_takes_the_box_around_it_is_never_narrower() -> None:
    """Stops and FMU know boxes only: the hull of the zonotope, in every direction and at every age."""
    model, l = arm(), np.vstack([np.eye(2), ACROSS])  # noqa: E741
    sets = sets_of(fits(trials(TOGETHER), model)["zonotope"])
    exact, box = deviation_tube(model, sets, l), deviation_tube(model, boxed(sets), l)
    assert np.all(box.hi >= exact.hi - 1e-12) and np.all(box.lo <= exact.lo + 1e-12)
    assert (box.hi - box.lo)[-1].sum() > 1.2 * (exact.hi - exact.lo)[-1].sum()


def test_impossible_data_are_refused() -> None:
    model, T = arm(), Template(np.eye(2), np.eye(2))
    broken = seen(trials(TOGETHER, 2), model, T.directions, 20)
    broken.hi[5] = np.nan
    asked = problem(model, ReadingError.exact(NOISE), DT, 20, template=T)
    with pytest.raises((NotConformant, ValueError)):
        fit_sets(broken, asked.responses(), asked)


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Identification]:
    """Two joints that are pushed the same way, through the whole of `stopset identify --shape zonotope`."""
    folder = tmp_path_factory.mktemp("together")
    trials = recordings((1.0, 0.5), (4.0, 2.0), 3, 6, spread=0.05, seed=3)
    rng = np.random.default_rng(5)
    out = []
    for r in trials:
        N = len(r.t)
        push = rng.uniform(-1.0, 1.0, (N // 60 + 1, 1)).repeat(60, axis=0)[:N] * np.array([[0.4, 0.2]])
        out.append(replace(r, tau=r.tau - push))
    path = save_trials(folder / "r.parquet", out, names(2))
    robot = replace(robot_of(names(2)), tip=np.array([0.4, 0.0, 0.0]))  # a tool that both joints move
    return path, identify(robot, [path], Settings(shape="zonotope"), keep="sums")


def test_from_recordings_to_the_model_file_and_back(together: tuple[Path, Identification], tmp_path: Path) -> None:
    path, found = together
    powered = found.model.powered
    assert powered.zonotope is not None and powered.U.encloses(powered.zonotope.set.box)
    assert found.conformance.table["all"].cost < 0.95 * found.conformance.table[BOX].cost
    saved = save_model(found.model, tmp_path / "m.json")
    again = load_model(tmp_path / "m.json")
    z = again.powered.zonotope
    assert z is not None and again.sha256 == saved.sha256
    assert np.array_equal(z.generators, powered.zonotope.generators) and np.array_equal(z.directions, powered.zonotope.directions)
    # held against the recordings it was made from, in all its directions: none leaves; a tenth less lets some out
    assert not compare(again, [path]).violations
    less = replace(powered, zonotope=replace(z, generators=0.5 * z.generators))
    leaving = compare(replace(again, sets={**again.sets, "powered": less}), [path]).violations
    assert leaving


def test_a_box_that_is_not_around_its_zonotope_is_refused(together: tuple[Path, Identification], tmp_path: Path) -> None:
    model = together[1].model
    narrow = replace(model.powered, U=Box(0.5 * model.powered.U.lo, 0.5 * model.powered.U.hi))
    save_model(replace(model, sets={**model.sets, "powered": narrow}), tmp_path / "m.json")
    with pytest.raises(ModelFileError, match="zonotope"):
        load_model(tmp_path / "m.json")


def test_a_file_without_zonotopes_has_none(together: tuple[Path, Identification], tmp_path: Path) -> None:
    model = together[1].model
    plain = replace(model, sets={k: boxed(s) for k, s in model.sets.items()})
    save_model(plain, tmp_path / "m.json")
    assert load_model(tmp_path / "m.json").powered.zonotope is None


def test_the_monitor_checks_with_the_zonotopes_own_tube(together: tuple[Path, Identification]) -> None:
    """Every recording it was made from is conformant, sample by sample."""
    from stopset.monitor.sample import Sample
    from stopset.monitor.verdict import Conformance
    from stopset.monitor.watch import Watch

    path, found = together
    watch = Watch(replace(found.model, domain=replace(found.model.domain, temp=None)))
    r = next(iter(read_recordings(path, found.model.robot)))
    verdicts = [watch.step(Sample(k, t, r.q[k], r.dq[k], r.tau[k])) for k, t in enumerate(r.t)]
    assert {v.conformance for v in verdicts[2:]} == {Conformance.CONFORMANT}


def test_updates_keep_the_template_and_give_the_bits_of_all_read_together(
    together: tuple[Path, Identification], tmp_path: Path
) -> None:
    path, found = together
    model = save_model(found.model, tmp_path / "m.json")
    assert found.retained is not None
    save_state(tmp_path / "m.state", found.retained, model)
    new = save_trials(tmp_path / "new.parquet", recordings((1.0, 0.5), (4.0, 2.0), 1, 4, spread=0.3, seed=9), names(2))
    added = update(model, load_state(tmp_path / "m.state", model), [new])
    whole = from_scratch(model, load_state(tmp_path / "m.state", model), [path, new])
    a, b = added.model.powered.zonotope, whole.model.powered.zonotope
    assert a is not None and b is not None and np.array_equal(a.generators, b.generators) and np.array_equal(a.centre, b.centre)


def test_a_nonlinear_model_has_no_zonotope(together: tuple[Path, Identification]) -> None:
    with pytest.raises((NotCovered, RecordingError), match="--model 1"):
        identify(robot_of(names(2)), [together[0]], Settings(shape="zonotope", model=2, order=3))


@pytest.mark.shared
def test_on_the_real_arm_a_zonotope_is_narrower_at_the_tool() -> None:
    """Schunk LWA-4P, the paper's own recordings: per-joint model 1 with the reference inertias and damping."""
    path = Path(__file__).resolve().parents[2] / "shared" / "data" / "schunk_lwa4p" / "open_loop.parquet"
    if not path.exists():
        pytest.skip("../shared/data is not here")
    robot = load_robot("lwa4p")
    inertia, damping = np.array([1.89, 12.4, 1.93, 1.82, 0.55, 0.43]), np.array([12.6, 30.8, 8.5, 8.1, 3.5, 4.0])
    model = Abstraction(1, 1, np.diag(1.0 / inertia), damping[:, None])
    trials, coarse = list(read_recordings(path, robot)), []
    for r in trials:
        steps = (len(r.t) - 1) // 5
        mean = r.tau[: steps * 5].reshape(steps, 5, -1).mean(axis=1)
        x = np.hstack([r.q, r.dq])[: steps * 5 + 1 : 5]
        u = np.vstack([mean, mean[-1:]])
        coarse.append((replace(r, t=r.t[: steps * 5 + 1 : 5], q=x[:, :6], dq=x[:, 6:], tau=u), u))
    T = template([(np.hstack([r.q, r.dq]), u) for r, u in coarse], model, robot, 0.02)
    deviations = Deviations(model, 0.02, 50, "sliding", T.directions)
    envelope = deviations.empty()
    for r, u in coarse:
        deviations.add(envelope, r, u)
    noise = ReadingError.exact(
        Box.symmetric(np.repeat([1e-4, 5e-3], 6))
    )  # about the encoder's resolution and the velocity's scatter
    got = {}
    for name, shape in (("box", Template(np.eye(6), T.directions)), ("zonotope", T)):
        asked = problem(model, noise, 0.02, 50, template=shape)
        R = asked.responses()
        got[name] = enclosing(fit_sets(envelope, R, asked), R, envelope, decoupled=False)
    assert got["zonotope"].cost < 0.9 * got["box"].cost
    assert volume(of(got["zonotope"])) < 0.5 * volume(of(got["box"]))
