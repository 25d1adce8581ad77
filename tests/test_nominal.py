"""The nominal model: what is recovered, what is kept, and the traps that a naive fit walks into."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfiltfilt

from nominal_cases import (
    F_C,
    F_V,
    JOINTS,
    ROTOR,
    Truth,
    arm,
    campaign,
    fresh_torque,
    moving,
    poses,
    shaken,
    wrong_cad,
)
from stopset.errors import EffectError, ModelFileError, RecordingError
from stopset.offline.nominal import Preprocessing, accumulate, identify_nominal, residuals, solve_nominal
from stopset.offline.nominal.filters import ORDER, lag, low_pass
from stopset.offline.nominal.physical import consistent, pseudo_inertia, solve_consistent
from stopset.offline.nominal.preprocess import motions
from stopset.recording import Meta, Recordings
from stopset.robot.rigid import torques


def rms(x: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(x**2, axis=0))


@pytest.fixture(scope="module")
def found():  # type: ignore[no-untyped-def]
    """(truth, CAD, recordings, nominal model) of the arm whose CAD is wrong."""
    true, cad = wrong_cad()
    data = campaign(Truth(true))
    return Truth(true), cad, data, identify_nominal(cad, data)


def test_friction_rotor_and_torque_are_recovered(found) -> None:  # type: ignore[no-untyped-def]
    _truth, _cad, _, nominal = found
    std = nominal.std
    for j, joint in enumerate(JOINTS):
        # five standard errors as the fit states them, and those within 3 % of the value: neither may be empty words
        for value, true, error in (
            (nominal.value("coulomb", joint)["F_c"], F_C[j], std[f"coulomb:{joint}.F_c"]),
            (nominal.value("viscous", joint)["F_v"], F_V[j], std[f"viscous:{joint}.F_v"]),
            (nominal.rotor[j], ROTOR[j], std[f"{joint}.rotor"]),
        ):
            assert abs(value - true) < 5 * error
            assert error < 0.1 * true
        assert nominal.value("coulomb", joint)["F_c"] == pytest.approx(F_C[j], rel=0.03)
    assert np.all(nominal.rms < 1.3 * np.array([0.15, 0.2, 0.1]))  # the torque noise itself, low-passed, is below one
    assert np.all(nominal.rms_heldout < 1.2 * nominal.rms)


def test_wrong_cad_is_corrected_not_believed(found) -> None:  # type: ignore[no-untyped-def]
    truth, cad, _, nominal = found
    want, believed = fresh_torque(truth, cad)
    _, identified = fresh_torque(truth, nominal.robot(cad))
    before, after = rms(believed - want), rms(identified - want)
    assert np.all(after[1:] < 0.25 * before[1:]), (before, after)  # joints that carry gravity
    assert np.all(nominal.rms_before[1:] > 1.5 * nominal.rms[1:])


def test_what_no_motion_tells_stays_at_the_cad_and_is_said(found) -> None:  # type: ignore[no-untyped-def]
    _, cad, _, nominal = found
    # the mass of the first link, turning about the vertical, is in no joint's torque: it moves with its inertia's prior, by next to
    # nothing of its own doubt
    moved = abs(nominal.pi[0, 0] - cad.pi[0, 0])
    assert moved < 1e-4 * nominal.std[f"{JOINTS[0]}.m"] and nominal.std[f"{JOINTS[0]}.m"] > 0.05 * cad.pi[0, 0]
    still = identify_nominal(cad, Recordings(Meta(joints=JOINTS), tuple(poses(Truth(arm()), 30, 5))))
    said = " ".join(still.undetermined)
    for joint in JOINTS:
        assert f"{joint}: no sample in motion" in said
    np.testing.assert_allclose(still.rotor, cad.rotor, rtol=1e-9)


def test_every_link_is_a_possible_body() -> None:
    # little noise-free information and a CAD of thin rods: the free optimum has negative inertias
    true = arm()
    data = campaign(Truth(true, noise=np.full(3, 3.0)), seconds=4.0, static=5)
    from stopset.offline.nominal.prior import Tolerance

    nominal = identify_nominal(true, data, tolerance=Tolerance(mass=1.0, centre=0.2, inertia=20.0, rotor=1.0))
    assert "possible" in " ".join(nominal.notes) or "bodies can have" in " ".join(nominal.notes)  # the limit was needed
    for p in nominal.pi:
        assert np.linalg.eigvalsh(pseudo_inertia(p))[0] > 0


def test_p13_delay_is_found_first_and_a_naive_fit_pays_for_it() -> None:
    true = arm()
    late = Truth(true, delay=0.012)
    data = campaign(late)
    nominal = identify_nominal(true, data)
    # the column is late: the lag that puts it right is negative
    assert nominal.delay_applied == pytest.approx(-0.012, abs=0.001)
    assert nominal.delay.common_std < 0.001
    naive = identify_nominal(true, data, delay=0.0)
    assert np.all(naive.rms > 1.5 * nominal.rms)
    error, blind = np.abs(nominal.rotor - ROTOR), np.abs(naive.rotor - ROTOR)
    assert blind.sum() > 3 * error.sum()


def test_one_late_drive_does_not_move_the_common_clock() -> None:
    true = arm()
    trials = []
    for r in campaign(Truth(true)):
        tau = r.tau.copy()
        if r.phase != "static":
            tau[:, 1] = np.interp(r.t - 0.04, r.t, tau[:, 1])
        trials.append(replace(r, tau=tau))
    nominal = identify_nominal(true, Recordings(Meta(joints=JOINTS), tuple(trials)))
    assert np.all(np.abs(nominal.delay_applied[[0, 2]]) < 0.002)
    assert nominal.delay_applied[1] == pytest.approx(-0.04, abs=0.002)  # its own lag is taken out for it alone
    assert any(note.startswith("shoulder: its torque is") for note in nominal.notes)
    assert nominal.value("viscous", "shoulder")["F_v"] == pytest.approx(F_V[1], rel=0.02)
    assert nominal.rotor[1] == pytest.approx(ROTOR[1], rel=0.03)


def test_p10_polynomial_friction_never_pushes_on_its_range() -> None:
    true = arm()

    def bent(dq: np.ndarray, load: np.ndarray) -> np.ndarray:  # resists up to 1.2 rad/s, but hardly at the top
        return np.array([0.5, 0.5, 0.5]) * np.sign(dq) + 4.0 * dq - 2.76 * dq**3

    data = campaign(Truth(true, friction=bent, noise=np.full(3, 0.8)), seconds=6.0)
    nominal = identify_nominal(true, data, ("coulomb", "viscous", "cubic_viscous"))
    for j, joint in enumerate(JOINTS):
        s = np.linspace(-nominal.s_max[j], nominal.s_max[j], 4001)
        v1, v3 = nominal.value("viscous", joint)["F_v"], nominal.value("cubic_viscous", joint)["v_3"]
        assert np.min(v1 + v3 * s**2) >= -1e-9 * abs(v1)
        assert nominal.s_max[j] > 1.0
    # the naive optimum, from the same sums, does push
    free = naive_optimum(nominal)
    worst = min(
        free[nominal.names.index(f"viscous:{j}.F_v")] + free[nominal.names.index(f"cubic_viscous:{j}.v_3")] * s**2
        for j, s in zip(JOINTS, nominal.s_max, strict=True)
    )
    assert worst < 0


def naive_optimum(nominal):  # type: ignore[no-untyped-def]
    """Least squares without limits, joint by joint over friction, links and rotor as identified."""
    from stopset.offline.nominal.delay import joint_reduced, lag_weights

    data, theta = nominal.data, nominal.theta.copy()
    for j in range(len(JOINTS)):
        index = data.layout.index(j)
        G = joint_reduced(data.moving[:, j].sum(axis=0), lag_weights(nominal.delay_applied[j]))
        head = 10 * len(JOINTS) + 1
        A, b = G[head:-1, head:-1], G[head:-1, -1] - G[head:-1, :head] @ theta[index[:head]]
        theta[index[head:]] = np.linalg.solve(A, b)
    return theta


def test_load_dependent_friction_in_all_quadrants() -> None:
    true = arm()

    def loaded(dq: np.ndarray, load: np.ndarray) -> np.ndarray:
        lifting = np.sign(load) * np.sign(dq) > 0
        return (F_C + np.where(lifting, 0.12, 0.05) * np.abs(load)) * np.sign(dq) + F_V * dq

    nominal = identify_nominal(arm(mass=0.97), campaign(Truth(true, friction=loaded)), ("coulomb", "viscous", "load_coulomb"))
    for joint in ("shoulder", "elbow"):
        k = nominal.value("load_coulomb", joint)
        std = nominal.std
        assert k["k_lift"] == pytest.approx(0.12, abs=max(0.015, 4 * std[f"load_coulomb:{joint}.k_lift"]))
        assert k["k_lower"] == pytest.approx(0.05, abs=max(0.015, 4 * std[f"load_coulomb:{joint}.k_lower"]))
    assert any("load_coulomb:base" in u for u in nominal.undetermined)  # no gravity load on a vertical axis


def test_stiction_at_standstill_is_left_out() -> None:
    true = arm()
    rng = np.random.default_rng(0)
    trials = list(poses(Truth(true), 30, 1))
    for k in range(4):
        r = moving(Truth(true), k, 8.0, 0.8, 7)
        hold = 500  # two seconds of standing with a torque anywhere inside the stiction band
        q = np.vstack([r.q, np.tile(r.q[-1], (hold, 1))])
        stuck = r.tau[-1] * 0 + np.array([3.0, 0.0, 0.0]) + rng.uniform(-0.2, 0.2, (hold, 3))
        tau = np.vstack([r.tau, stuck])
        t = np.arange(len(q)) * r.t[1]
        trials.append(replace(r, t=t, q=q, dq=np.vstack([r.dq, np.zeros((hold, 3))]), tau=tau))
    data = Recordings(Meta(joints=JOINTS), tuple(trials))
    good = identify_nominal(true, data)
    bad = identify_nominal(true, data, settings=Preprocessing(still=1e-9))
    wrong = [abs(n.value("coulomb", "base")["F_c"] - F_C[0]) for n in (good, bad)]
    assert wrong[0] < 0.02 * F_C[0]
    assert wrong[1] > 5 * wrong[0]


def test_the_load_is_that_of_the_identified_arm_not_of_the_cad() -> None:
    true, cad = arm(), arm(mass=0.7)  # a third of the load is not in the CAD

    def loaded(dq: np.ndarray, load: np.ndarray) -> np.ndarray:
        return (F_C + 0.12 * np.abs(load)) * np.sign(dq) + F_V * dq

    data = campaign(Truth(true, friction=loaded))
    effects = ("coulomb", "viscous", "load_coulomb")
    once = identify_nominal(cad, iter(data), effects)  # nothing can be read again: the CAD's load is all there is
    again = identify_nominal(cad, lambda: iter(data), effects)
    np.testing.assert_array_equal(again.theta, identify_nominal(cad, data, effects).theta)
    for joint in ("shoulder", "elbow"):
        # half the difference of the two is the same torque as a scale of gravity, which the CAD's prior decides; the mean is told
        k, naive = (np.mean(list(n.value("load_coulomb", joint).values())) for n in (again, once))
        assert k == pytest.approx(0.12, abs=0.01)
        assert naive > 0.15


def test_friction_goes_through_the_filter_of_the_torque() -> None:
    """A step of friction that only the torque's filter rounds off would be left over at every reversal."""
    true = arm(sheet=True)
    quiet = Truth(true, noise=np.zeros(3), encoder=0.0)
    data = Recordings(Meta(joints=JOINTS), (*poses(quiet, 20, 1), *(moving(quiet, k, 8.0, 1.0, 7) for k in range(4))))
    nominal = identify_nominal(true, data)
    near: list[list[float]] = [[], [], []]
    for r in data.phase("closed_loop"):
        (rest,) = residuals(nominal, true, r)
        turning = (np.abs(rest.dq) < 0.1) & ~rest.moving  # within the filter's ringing of a reversal
        for j in range(3):
            near[j] += rest.left[turning[:, j], j].tolist()
    for j in range(3):
        assert len(near[j]) > 40
        # unfiltered columns leave 17 to 22 % of F_c here; what is left is the band where the sign is ramped, 5 to 8 %
        assert np.sqrt(np.mean(np.square(near[j]))) < 0.12 * F_C[j]


def test_a_joint_that_stands_may_hold_any_torque_within_its_friction() -> None:
    true = arm()
    data = campaign(Truth(true))
    nominal = identify_nominal(true, data)
    r = moving(Truth(true), 3, 8.0, 0.8, 7)
    hold = 500
    held = torques(true.chain, true.pi, r.q[-1:], 0 * r.q[-1:], 0 * r.q[-1:])
    for share, inside in ((0.6, True), (-0.6, True), (1.5, False)):
        q, dq = np.vstack([r.q, np.tile(r.q[-1], (hold, 1))]), np.vstack([r.dq, np.zeros((hold, 3))])
        tau = np.vstack([r.tau, np.tile(held + share * F_C, (hold, 1))])
        (rest,) = residuals(nominal, true, replace(r, t=np.arange(len(q)) * r.t[1], q=q, dq=dq, tau=tau))
        still = rest.t > r.t[-1] + 0.5
        assert np.all(np.abs(rest.left[still]) > 0.5 * F_C)  # one number for a set is wrong wherever it is put
        excess = np.zeros(3) if inside else 0.5 * F_C
        np.testing.assert_allclose(rest.beyond[still], np.tile(excess, (still.sum(), 1)), atol=0.05 * F_C.max())
        np.testing.assert_array_equal(rest.beyond[rest.moving], rest.left[rest.moving])


def test_static_poses_need_both_directions() -> None:
    true = arm()
    one = Recordings(Meta(joints=JOINTS), (*poses(Truth(true), 20, 2, sides=1), moving(Truth(true), 0, 8.0, 1.0, 1)))
    nominal = identify_nominal(true, one)
    assert nominal.data.poses == 0
    assert any("one side only" in n for n in nominal.notes)


def test_irregular_stamps_are_resampled_not_believed_even() -> None:
    true = arm()
    steady = [moving(Truth(true), k, 12.0, 1.0, 4, rate=100.0) for k in range(3)]
    real = [shaken(r, 0.6) for r in steady]
    handled = identify_nominal(true, Recordings(Meta(joints=JOINTS), tuple(real)))
    even = [replace(r, t=s.t) for r, s in zip(real, steady, strict=True)]  # the naive reading: stamps thrown away
    naive = identify_nominal(true, Recordings(Meta(joints=JOINTS), tuple(even)))
    plain = identify_nominal(true, Recordings(Meta(joints=JOINTS), tuple(steady)))
    assert np.all(handled.rms < 1.5 * plain.rms)
    assert naive.rms.sum() > 1.3 * handled.rms.sum()


def test_update_by_addition_equals_reading_everything() -> None:
    true, cad = wrong_cad()
    data = campaign(Truth(true), seconds=6.0)
    trials = data.trials
    old, new = accumulate(cad, trials[:82]), accumulate(cad, trials[82:])
    together = solve_nominal(cad, old + new)
    again = solve_nominal(cad, accumulate(cad, trials))
    # sums of the same numbers in another order: rounding times the condition of the normal matrix
    np.testing.assert_allclose(together.theta, again.theta, rtol=1e-6, atol=1e-8)
    assert together.data.poses + together.data.recordings == again.data.poses + again.data.recordings


def test_update_refuses_other_settings() -> None:
    true = arm()
    r = [moving(Truth(true), 0, 5.0, 1.0, 1)]
    with pytest.raises(RecordingError, match="same"):
        accumulate(true, r) + accumulate(true, r, ("coulomb",))
    with pytest.raises(RecordingError, match="same"):
        accumulate(true, r) + accumulate(true, r, settings=Preprocessing(cutoff=9.0))


def test_memory_does_not_grow_with_the_campaign() -> None:
    true = arm()
    a = accumulate(true, [moving(Truth(true), 0, 5.0, 1.0, 1)])
    b = accumulate(true, (moving(Truth(true), k, 5.0, 1.0, 1) for k in range(6)))
    assert a.moving.nbytes + a.still.nbytes == b.moving.nbytes + b.still.nbytes
    assert b.recordings == 6


def test_compensated_torque_holds_no_gravity_and_no_coulomb() -> None:
    true = arm()

    def viscous(dq: np.ndarray, load: np.ndarray) -> np.ndarray:
        return F_V * dq - load  # u of eq. (11): motor torque less Coulomb friction and gravity

    data = campaign(Truth(true, friction=viscous), static=0)
    nominal = identify_nominal(true, data, effort="compensated_torque")
    for j, joint in enumerate(JOINTS):
        assert nominal.value("viscous", joint)["F_v"] == pytest.approx(F_V[j], rel=0.03)
        assert nominal.value("coulomb", joint) == {}


def test_no_usable_sample_is_one_sentence() -> None:
    true = arm()
    short = moving(Truth(true), 0, 0.1, 1.0, 1)
    with pytest.raises(RecordingError, match=r"no usable sample.*expected"):
        identify_nominal(true, Recordings(Meta(joints=JOINTS), (short,)))


def test_effects_of_the_whole_arm_are_refused() -> None:
    true = arm()
    with pytest.raises(EffectError, match="single joints"):
        identify_nominal(true, campaign(Truth(true), seconds=3.0), ("coulomb", "payload"))


@pytest.mark.parametrize("motions", [1, 3, 12])
def test_stated_errors_are_honest(motions: int) -> None:
    """Friction differs from motion to motion by 2 %: twice the stated error covers it, however few motions there were."""
    true = arm()
    z = []
    for seed in range(8):
        rng = np.random.default_rng([seed, 7])
        trials = poses(Truth(true), 20, seed)
        for k in range(motions):
            c, v = F_C * (1 + 0.02 * rng.normal(size=3)), F_V * (1 + 0.02 * rng.normal(size=3))
            law = lambda dq, load, c=c, v=v: c * np.sign(dq) + v * dq  # noqa: E731
            trials.append(moving(Truth(true, friction=law), k + 100 * seed, 6.0, (1.2, 0.4, 0.8)[k % 3], seed))
        nominal = identify_nominal(true, Recordings(Meta(joints=JOINTS), tuple(trials)))
        std = nominal.std
        for j, joint in enumerate(JOINTS):
            z.append((nominal.value("coulomb", joint)["F_c"] - F_C[j]) / std[f"coulomb:{joint}.F_c"])
            z.append((nominal.value("viscous", joint)["F_v"] - F_V[j]) / std[f"viscous:{joint}.F_v"])
    covered = float(np.mean(np.abs(z) < 2.0))
    # 48 numbers, 24 of them independent: fewer than 19 of 24 inside has a chance below 1 % if 95 % are meant to be
    assert covered >= 19 / 24, covered
    assert float(np.sqrt(np.mean(np.square(z)))) > 0.25  # nor is everything called unknown


def test_residuals_of_a_trial_match_the_stated_error(found) -> None:  # type: ignore[no-untyped-def]
    _, cad, data, nominal = found
    rest = [x for r in data.phase("closed_loop") for x in residuals(nominal, cad, r)]
    left = np.concatenate([x.left for x in rest])
    use = np.concatenate([x.moving for x in rest])
    for j in range(3):
        assert np.sqrt(np.mean(left[use[:, j], j] ** 2)) == pytest.approx(nominal.rms[j], rel=1e-6)


def test_p24_current_counts_through_its_torque_constant(tmp_path) -> None:  # type: ignore[no-untyped-def]
    from stopset.recording import read_recordings, write_recordings

    true = arm()
    constant = np.array([11.0, 13.0, 9.0])
    data = campaign(Truth(true), seconds=6.0)
    meta = Meta(joints=JOINTS, effort="motor_current", torque_constant=tuple(constant))
    # the torque column is what a drive without calibration would have written: it must not be looked at
    trials = [replace(r, current=r.tau / constant, tau=0 * r.tau) for r in data]
    write_recordings(tmp_path / "current.parquet", meta, trials)
    nominal = identify_nominal(true, read_recordings(tmp_path / "current.parquet", true))
    for j, joint in enumerate(JOINTS):
        assert nominal.value("coulomb", joint)["F_c"] == pytest.approx(F_C[j], rel=0.03)


def test_sums_survive_a_file_and_take_new_recordings_in(tmp_path) -> None:  # type: ignore[no-untyped-def]
    from stopset.offline.nominal import load_sums, sums_bytes

    true, cad = wrong_cad()
    trials = campaign(Truth(true), seconds=5.0).trials
    old, new = accumulate(cad, trials[:82], reference=cad.pi), accumulate(cad, trials[82:], reference=cad.pi)
    path = tmp_path / "model.sums"
    path.write_bytes(sums_bytes(old))
    back = load_sums(path, cad)
    np.testing.assert_array_equal(back.moving, old.moving)  # to the last bit
    np.testing.assert_array_equal(back.still, old.still)
    np.testing.assert_array_equal(solve_nominal(cad, back + new).theta, solve_nominal(cad, old + new).theta)
    for damage in (b"", path.read_bytes()[:-300], b"PK" + bytes(200)):
        path.write_bytes(damage)
        with pytest.raises(ModelFileError):
            load_sums(path, cad)
    path.write_bytes(sums_bytes(old))
    other = arm()
    with pytest.raises(ModelFileError, match="joints"):
        load_sums(path, replace(other, joints=("a", "b", "c")))


def test_two_joints_whose_lags_differ_share_none() -> None:
    """The median of two lies between them, near neither: their weighted mean was 0 / 0."""
    from stopset.offline.nominal import delay

    common, std = delay._common(np.array([0.0258, 0.0009]), np.array([0.0034, 0.0012]))
    assert common == pytest.approx(0.01335) and std == np.inf


def test_the_nearest_possible_body_is_the_nearest() -> None:
    """The free solution has a negative mass: no possible body costs less than the one found, along any line to another one."""
    robot = arm()
    rng = np.random.default_rng(3)
    d = 10.0 ** rng.uniform(-2.0, 2.0, 30)  # parameters of very different weight
    X = rng.normal(size=(60, 30)) * d
    H, aim = X.T @ X, robot.pi.ravel().copy()
    aim[20] = -1.0
    none = np.zeros(0)
    theta = solve_consistent(H, H @ aim, np.zeros((0, 30)), none, none, robot.pi)
    assert consistent(theta.reshape(3, 10), robot.pi) and not consistent(aim.reshape(3, 10), robot.pi)
    slope = H @ (theta - aim)
    cost = 0.5 * (theta - aim) @ slope
    for other in (robot.pi.ravel(), 2.0 * robot.pi.ravel(), 0.5 * (robot.pi.ravel() + theta)):
        assert slope @ (other - theta) >= -1e-6 * cost


def test_a_regressor_passes_scipys_filter_to_rounding_and_lags_are_exact_for_cubics() -> None:
    m = next(m for r in campaign(Truth(wrong_cad()[0])).trials for m in motions(r, Preprocessing()))
    rng = np.random.default_rng(1)
    for shape in ((len(m.t),), (len(m.t), 6), (len(m.t), 6, 3)):
        x = np.cumsum(rng.normal(size=shape), axis=0)
        want = sosfiltfilt(m.sos, x, axis=0, padtype="odd", padlen=min(len(x) - 1, 24 * ORDER))
        # the last bit with scipy 1.17; 1.18 sums in another order
        assert np.abs(m.smooth(x) - want).max() <= 1e-12 * np.abs(want).max()
    for relative in np.concatenate([rng.uniform(0.001, 0.2, 200), rng.uniform(0.001, 0.1, 200).round(9)]).tolist():
        assert np.array_equal(low_pass(relative), butter(ORDER, 2 * relative, output="sos"))
    noise = rng.normal(size=(300, 7))
    assert np.array_equal(lag(0.93, noise), lfilter([1.0], [1.0, -0.93], noise, axis=0))
    z, lags = m.t / m.t[-1], np.array([-0.0307, -0.006, 0.0, 0.0042, 0.06])
    found = m.delayed(np.column_stack([z, z**3]), lags)
    late = z[m.retained][:, None] - lags / m.t[-1]
    inside = (late.min(axis=1) > z[3]) & (late.max(axis=1) < z[-4])
    assert inside.sum() > 10
    for k, power in enumerate((1, 3)):
        assert np.abs(found[inside, k] - late[inside] ** power).max() < 1e-12
    # at the ends the last sample repeats
    assert np.abs(m.delayed(m.q, np.array([1e3]))[:, :, 0] - m.q[0]).max() < 1e-12


def test_rounding_decides_nothing() -> None:
    """Columns that are zero but for rounding tell nothing of how correlated errors are: a change of 1e-13 of the positions changes no more."""
    true, cad = wrong_cad()
    data, moved = campaign(Truth(true)), np.random.default_rng(5)
    again = tuple(replace(r, q=r.q * (1 + 1e-13 * moved.normal(size=r.q.shape))) for r in data.trials)
    once, other = identify_nominal(cad, data), identify_nominal(cad, replace(data, trials=again))
    assert np.abs(other.inflation / once.inflation - 1).max() < 1e-8
    assert np.abs(other.theta - once.theta).max() < 1e-6 * np.abs(once.theta).max()


def test_a_heavy_arms_rotors_do_not_contradict_its_description() -> None:
    """A KR 300's drives have up to 840 kg m^2 behind their gears; without a data sheet such an arm's description was called 30 times off."""
    links = arm(mass=150.0)
    rotors = np.array([160.0, 160.0, 90.0])
    drives = tuple(replace(d, rotor_inertia=float(x)) for d, x in zip(links.drives, rotors, strict=True))
    truth = Truth(
        replace(links, drives=drives), friction=lambda dq, load: 40.0 * np.sign(dq) + 200.0 * dq, noise=np.full(3, 30.0)
    )
    nominal = identify_nominal(arm(mass=150.0, sheet=False), campaign(truth))
    np.testing.assert_allclose(nominal.rotor, rotors, rtol=0.02)
    assert not any("contradicted" in note for note in nominal.notes)
