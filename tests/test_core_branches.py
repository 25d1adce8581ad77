"""Turns of the core's C that ordinary arms never take: sizes it refuses, damping beyond a step, directions, numbers at an edge.

`.ci/coverage` holds the files that decide a verdict or a stop bound to every branch.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from monitor_arm import known_model
from stopset.artifact import Abstraction
from stopset.artifact.model import TorqueZonotope, UncertaintySets
from stopset.core.library import ffi, flags, given, integers, lib, view
from stopset.effects.base import Fitted
from stopset.effects.memory import stepped
from stopset.monitor.inputs import Inputs
from stopset.monitor.watch import Quantum
from stopset.offline.description import robot_from_text
from stopset.reach.flowpipe import deviation_tube, discretise, responses
from stopset.reach.nonlinear import dynamics, joint_struct
from stopset.reach.stops.cartesian import slices
from stopset.reach.stops.tube import OK, Tube
from stopset.robot.rigid import arm_struct, torques
from stopset.sets import Box
from stopset.types import Array
from test_description import serial

SIZED = (
    "stopset_torques", "stopset_bent_torques", "stopset_gravity_torques", "stopset_mass_matrices", "stopset_regressors",
    "stopset_moment_arms", "stopset_link_frames", "stopset_point", "stopset_expand", "stopset_inertia_box", "stopset_point_sets",
    "stopset_swept_capsules", "stopset_power_off", "stopset_working_ramp", "stopset_failed_ramp", "stopset_power_excess",
    "stopset_ramp_torque",
    "stopset_energy_after", "stopset_speed_bounds", "stopset_friction_over", "stopset_path_stop",
    "stopset_stop_tube", "stopset_largest_energy", "stopset_acceleration_bounds", "stopset_discretise",
    "stopset_linear_step", "stopset_responses", "stopset_along", "stopset_sim_mass_and_bias", "stopset_sim_torques",
)  # fmt: skip


def argument(kind: ffi.CType, n: int) -> object:
    """Nothing of its ``kind``, but an arm of ``n`` joints where one is in it."""
    if kind.kind == "primitive":
        return n if kind.cname == "int" else 0
    made = ffi.NULL
    if kind.kind == "pointer" and kind.item.kind == "struct":
        made = ffi.new(f"{kind.item.cname} *")
        inner = made
        while inner is not None:
            fields = (
                dict(ffi.typeof(inner).item.fields or ())
                if ffi.typeof(inner).kind == "pointer"
                else dict(ffi.typeof(inner).fields)
            )
            if "n" in fields:
                inner.n = n
            inner = next((getattr(inner, name) for name in ("arm", "plant") if name in fields), None)
    return made


@pytest.mark.parametrize("n", [-1, 0, 33, 1000])
@pytest.mark.parametrize("name", SIZED)
def test_an_arm_of_no_size_is_refused_before_anything_is_touched(name: str, n: int) -> None:
    """By its code, whatever else is handed over: here nothing at all."""
    function = getattr(lib, name)
    kinds = ffi.typeof(function).args
    code = function(*(argument(kind, n) for kind in kinds))
    assert abs(code) == lib.STOPSET_TOO_MANY_JOINTS


# ---- the linear model's step, responses and tube


def coupled(damping: float, n: int = 2) -> Abstraction:
    M = np.array([[2.0, 0.5], [0.5, 1.0]])[:n, :n]
    return Abstraction(1, 1, np.linalg.inv(M), np.full((n, 1), damping))


@pytest.mark.parametrize("damping", [0.1, 30.0, 3e3, -4.0])
def test_a_step_is_the_exponential_however_fast_speeds_decay(damping: float) -> None:
    a, h = coupled(damping), 0.05
    Ad, Bd = discretise(a, h)
    A = np.zeros((6, 6))
    A[:2, 2:4] = np.eye(2)
    A[2:4, 2:4] = -a.Minv * damping
    A[2:4, 4:] = a.Minv
    want = expm(A * h)
    assert pytest.approx(want[:4, :4], rel=1e-11, abs=1e-13) == Ad and pytest.approx(want[:4, 4:], rel=1e-11, abs=1e-13) == Bd


def test_what_is_without_end_stays_visible() -> None:
    """An infinite coefficient ends the halvings; what comes out is not taken for a step."""
    Ad, _ = discretise(replace(coupled(1.0), viscous=np.full((2, 1), np.inf)), 0.01)
    assert not np.isfinite(Ad[2:, 2:]).all()


def sets_of(**more: object) -> UncertaintySets:
    U = Box.of([-1.0, -2.0], [1.5, 2.0])
    given = {"X0": Box.symmetric(np.full(4, 1e-3)), "U": U, "V": Box.symmetric(np.full(4, 1e-4)), "dt": 0.01, "horizon": 0.2}
    return UncertaintySets(**{**given, **more})  # type: ignore[arg-type]


def sampled(a: Abstraction, pushes: list[Array], dt: float, steps: int, start: Array) -> Array:
    """(steps + 1, 2n) the largest states that torques held over steps make from ``start``."""
    Ad, Bd = discretise(a, dt)
    rng, far = np.random.default_rng(3), np.zeros((steps + 1, 4))
    for _ in range(200):
        x = start * rng.choice([-1.0, 1.0], 4)
        for k in range(steps + 1):
            far[k] = np.maximum(far[k], x)
            x = Ad @ x + Bd @ pushes[rng.integers(len(pushes))]
    return far


@pytest.mark.parametrize("damping", [0.5, -6.0])
def test_tubes_of_boxes_and_of_zonotopes_hold_what_their_corners_do(damping: float) -> None:
    a, plain = coupled(damping), sets_of()
    G, c = np.array([[1.0, 0.3, 0.0], [-0.5, 0.8, 0.2]]), np.array([0.2, -0.1])
    z = TorqueZonotope(c, G, np.eye(2))
    shaped = replace(plain, U=z.set.box, zonotope=z)
    signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    for sets, pushes in (
        (plain, [np.array(p) for p in ((-1.0, -2.0), (1.5, -2.0), (-1.0, 2.0), (1.5, 2.0))]),
        (shaped, [c + G @ s for s in signs]),
    ):
        tube = deviation_tube(a, sets)
        far = sampled(a, pushes, sets.dt, len(tube.ages) - 1, sets.X0.hi)
        assert np.all(far + sets.V.hi <= tube.hi) and np.all(far[-1, 2:] > 0.3 * tube.hi[-1, 2:])
        # looked at along a direction it is no wider than along the joints, and the joints' own directions are the joints
        across = np.vstack([np.eye(2), [[0.6, -0.8]]])
        looked = deviation_tube(a, sets, across)
        assert looked.hi[:, [0, 1, 3, 4]] == pytest.approx(tube.hi, rel=1e-9)
        assert np.all(looked.hi[:, 2] <= tube.hi[:, 0] * 0.6 - tube.lo[:, 1] * 0.8 + 1e-12)


def test_nothing_is_promised_about_speeds_where_positions_alone_were_held() -> None:
    both, alone = deviation_tube(coupled(0.5), sets_of()), deviation_tube(coupled(0.5), sets_of(conform="position"))
    assert (
        np.array_equal(alone.hi[:, :2], both.hi[:, :2])
        and np.all(alone.hi[:, 2:] == np.inf)
        and np.all(alone.lo[:, 2:] == -np.inf)
    )


def test_responses_of_a_joint_that_keeps_its_sign_are_exact() -> None:
    """Decoupled and damped: the response from zero, by hand."""
    a = Abstraction(1, 1, np.diag([0.5, 2.0]), np.full((2, 1), 0.3))
    R, rate = responses(a, 0.02, 10), 0.3 * np.array([0.5, 2.0])
    for k, t in enumerate(0.02 * np.arange(11)):
        assert np.diag(R.plus[k, 2:]) == pytest.approx((1 - np.exp(-rate * t)) / 0.3, rel=1e-10, abs=1e-15)
        assert not R.minus[k].any()


# ---- predictions of nonlinear models


def test_a_march_is_powers_of_its_step() -> None:
    A, x = np.array([[1.0, 0.1], [0.0, 0.9]]), np.zeros((4, 2))
    x[0] = 1.0, -2.0
    x[1:] = 0.5  # pushes, to be added to
    want = [x[0].copy()]
    for k in range(3):
        want.append(A @ want[k] + 0.5)
    lib.stopset_march(2, view(A), 4, view(x))
    assert x == pytest.approx(np.array(want))


@pytest.mark.parametrize("v", [0.0, 1e-6, 1.3])
def test_the_corners_sensitivity_is_its_derivative(v: float) -> None:
    """With no damping in the middle of a step (a series there), and with some."""
    w, (joint, _held) = np.array([0.4, -0.2, 0.1]), joint_struct(np.array([0.0, 0.7]), 0.01, 4)

    def end(q: float, v: float, more: float) -> Array:
        out = np.empty((4, 2))
        lib.stopset_corner(joint, q, v, 3, view(w + more), view(out))
        return out[-1]

    S, q, at = np.zeros((2, 3)), ffi.new("double *", 0.2), ffi.new("double *", v)
    lib.stopset_corner_sensitivity(joint, q, at, 3, view(w), view(S))
    d = 1e-5
    up, down = ([end(0.2 + s * e[0], v + s * e[1], s * e[2]) for e in np.eye(3)] for s in (d, -d))
    by_difference = (np.transpose(up) - np.transpose(down)) / (2 * d)
    assert [q[0], at[0]] == pytest.approx(end(0.2, v, 0.0)) and pytest.approx(by_difference, rel=1e-3, abs=1e-7) == S


def test_responses_to_what_is_not_a_number_are_none() -> None:
    n, H = 2, 3
    J_x, J_u = np.zeros((H + 1, n, 2 * n)), np.zeros((H + 1, n, n))
    J_u[1:3, 0, 0] = np.nan
    E1, plus, minus, work = np.empty((H + 1, 4, 4)), np.empty((H + 1, 4, 2)), np.empty((H + 1, 4, 2)), np.empty(3 * H * 8)
    found = ffi.new("StopsetResponses *", (H + 1, 4, 4, 2, view(E1), view(plus), view(minus)))
    assert lib.stopset_along(n, H, view(J_x), view(J_u), 0.01, found, view(work)) == lib.STOPSET_OK
    assert np.isnan(plus[-1, 0, 0]) and np.isnan(minus[-1, 2, 0]) and np.isfinite(plus[:, 1, 1]).all()


def test_an_envelope_along_directions_is_that_of_what_they_see() -> None:
    """A joint, one counted backward, and a mixture of two: against the windows one by one."""
    n, N, rng = 2, 9, np.random.default_rng(8)
    across, Ad, residual = (
        np.array([[1.0, 0.0], [0.0, -1.0], [0.6, -0.8]]),
        rng.normal(scale=0.5, size=(4, 4)),
        rng.normal(size=(4, N)),
    )
    ages, k = 4, len(across)
    hi, lo, at, work = (
        np.full((ages, 2 * k), -np.inf),
        np.full((ages, 2 * k), np.inf),
        np.zeros((2, ages, 2 * k, 2), np.int64),
        np.empty(9 * N),
    )
    env = ffi.new("StopsetEnvelope *", (ages, 2 * k, 0, view(hi), view(lo), integers(at[0]), integers(at[1])))
    step = ffi.new("StopsetLooked *", (n, k, view(Ad), view(across)))
    lib.stopset_widen_coupled(env, step, N, view(residual), N, view(work))
    look = np.kron(np.eye(2), across)
    for h in range(1, ages):
        seen = []
        for start in range(N - h + 1):
            e = np.zeros(4)
            for j in range(h):
                e = Ad @ e + residual[:, start + j]
            seen.append(look @ e)
        assert hi[h] == pytest.approx(np.max(seen, axis=0)) and lo[h] == pytest.approx(np.min(seen, axis=0))
        assert at[0, h, :, 1].tolist() == np.argmax(seen, axis=0).tolist()


def test_a_memory_goes_on_along_a_recording_as_step_by_step() -> None:
    """Held inputs, also none; it starts anew where a trial does."""
    b, a, dt = np.array([1.0, 1.0, 0.5, 0.0, 2.0]), np.array([-2.0, 0.0, -1.0, -3.0, 0.0]), np.full(5, 0.1)
    first, z = np.array([True, False, False, True, False]), np.empty(5)
    lib.stopset_remember(5, view(b), view(a), view(dt), flags(first), 0.25, view(z))
    want = [0.25]
    for k in range(1, 5):
        want.append(0.25 if first[k] else float(stepped(np.array(want[-1]), b[k - 1], a[k - 1], 0.1)))
    assert z.tolist() == pytest.approx(want, rel=1e-14)


def test_a_model_without_polynomials_is_its_damping() -> None:
    """Model 2 whose Coriolis torque is nil; and where a reading may be at once, after no step: where it was, give or take the sets."""
    a = replace(coupled(3.0), kind=2)
    struct, work = dynamics(a)
    q, dq, out = np.array([0.3, -0.2]), np.array([0.5, -0.7]), np.empty(2)
    lib.stopset_drag(struct, view(q), view(dq), view(work), view(out))
    assert out == pytest.approx(3.0 * dq, rel=1e-15)
    X = [np.array([side * size] * 4) for size in (1e-3, 0.5, 1e-4) for side in (-1.0, 1.0)]
    sets, path, room = (
        ffi.new("StopsetSets *", (*map(view, X), 0)),
        np.concatenate([q, dq]),
        np.empty(lib.stopset_ahead_room(struct, 0)),
    )
    lo, hi = np.empty(4), np.empty(4)
    nominal = ffi.new("StopsetNominal *", (0, view(path), ffi.NULL, 0.01))
    assert lib.stopset_ahead(struct, sets, nominal, view(room), view(lo), view(hi)) == 0
    assert lo == pytest.approx(path - 1.1e-3, abs=1e-12) and hi == pytest.approx(path + 1.1e-3, abs=1e-12)
    struct.n = lib.STOPSET_JOINTS + 1
    try:
        assert lib.stopset_ahead(struct, sets, nominal, ffi.NULL, view(lo), view(hi)) == lib.STOPSET_TOO_MANY_JOINTS
    finally:
        struct.n = 2


def test_a_message_is_rounded_and_sealed_twice_in_its_place() -> None:
    """Two numbers, checks from byte 20 on, what is written between, checks from 48 on; made twice in the same place."""
    data, numbers, side = bytearray(56), np.array([0.1, -0.1]), ffi.new("int8_t[]", [1, -1])
    message = ffi.new("StopsetMessage *", {
        "bytes": ffi.from_buffer("uint8_t[]", data), "numbers": view(numbers), "side": side, "count": 2, "first": 8,
    })  # fmt: skip
    for begin in (b"12345678", b"abcdefgh"):
        data[:8] = begin
        lib.stopset_message(message, 20)
        low, high = struct.unpack("<ff", data[8:16])
        assert low >= 0.1 and high <= -0.1 and abs(low - 0.1) < 1e-8 and abs(high + 0.1) < 1e-8
        data[28:48] = b"more" + 16 * begin[:1]
        lib.stopset_seal(message, 48)
        for end in (20, 48):
            castagnoli = lib.stopset_crc32c(end + 4, ffi.from_buffer("uint8_t[]", data))
            assert struct.unpack("<II", data[end : end + 8]) == (zlib.crc32(data[:end]), castagnoli)


def test_polynomials_and_their_slopes_are_sums_of_monomials() -> None:
    """1, x, y, x^2, x y, x^2 y, each from its parent; two polynomials of them."""
    parent, variable = integers(np.array([0, 0, 0, 1, 1, 3])), integers(np.array([0, 0, 1, 0, 1, 1]))
    rng = np.random.default_rng(9)
    C, z, work = rng.normal(size=(6, 2)), rng.normal(size=(5, 2)), np.empty((6, 3))
    value, slope = np.empty((5, 2)), np.empty((5, 2, 2))
    p = ffi.new("StopsetPolynomials *", (6, 2, 2, parent, variable, view(C)))
    lib.stopset_polynomials(p, 5, view(z), view(work), view(value))
    lib.stopset_polynomial_slopes(p, 5, view(z), view(work), view(slope))
    x, y, none, one = z[:, 0], z[:, 1], np.zeros(5), np.ones(5)
    assert value == pytest.approx(np.stack([one, x, y, x * x, x * y, x * x * y], axis=1) @ C)
    by_x, by_y = np.stack([none, one, none, 2 * x, y, 2 * x * y], axis=1), np.stack([none, none, one, none, x, x * x], axis=1)
    assert slope == pytest.approx(np.stack([by_x @ C, by_y @ C], axis=2))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_how_far_readings_lie_beyond_a_corner_is_found_at_every_age(sign: float) -> None:
    """Against one solution at a time; what runs away the wrong way encloses nothing, the right way it is let go."""
    rng, N, horizon, limit = np.random.default_rng(12), 30, 12, (0.02, 0.05)
    x, w, starts = 0.05 * rng.normal(size=(N, 2)), rng.normal(size=N), np.array([0, 5, 20, 29])
    joint, _held = joint_struct(np.array([0.4, 0.1]), 0.01, 2)

    def excess(runaway: float, w: Array) -> tuple[Array, Array, Array]:
        best, at, outside = (
            np.full((horizon + 1, 2), -np.inf),
            np.zeros((horizon + 1, 2, 2), np.int64),
            np.zeros(len(starts), bool),
        )
        corner = ffi.new("StopsetCorner *", (joint[0], 0.001, -0.002, sign, runaway, horizon, limit))
        trial = ffi.new("StopsetTrial *", (3, N, view(x), view(w), len(starts), integers(starts)))
        lib.stopset_corner_excess(
            corner, trial, ffi.new("StopsetExcess *", (view(best), integers(at.reshape(-1)), flags(outside)))
        )
        return best, at, outside

    best, at, outside = excess(1e3, w)
    want, bad = np.full((horizon + 1, 2), -np.inf), np.zeros(len(starts), bool)
    for k, start in enumerate(starts):
        steps, path = min(horizon, N - 1 - start), np.empty((horizon + 1, 2))
        lib.stopset_corner(joint, x[start, 0] + 0.001, x[start, 1] - 0.002, steps, view(w[start:].copy()), view(path))
        e = sign * (x[start : start + steps + 1] - path[: steps + 1])[1:]
        want[1 : steps + 1] = np.maximum(want[1 : steps + 1], e)
        bad[k] = bool(np.any(e > np.array(limit)))
    assert best == pytest.approx(want) and np.array_equal(outside, bad) and 0 < bad.sum() < len(starts)
    assert np.all(at[1:, :, 0] == 3) and np.all(np.isin(at[1:, :, 1], starts))
    # thrown upward: no bound from above (sign 1) is left behind, and one from below (sign -1) encloses nothing
    gone, _, left = excess(0.3, w + 1e3)
    assert np.isinf(gone[1]).all() and (gone[1, 0] > 0) == (sign < 0) and left[:3].all() == (sign < 0)


def test_responses_along_a_motion_are_signed_parts_of_the_whole() -> None:
    """Many steps of a model whose torques turn their sign: the parts add up to the response to a torque that is always there."""
    n, H, dt, rng = 2, 90, 0.02, np.random.default_rng(13)
    J_x, J_u = np.zeros((H + 1, n, 2 * n)), np.zeros((H + 1, n, n))
    J_x[:, :, :n], J_x[:, :, n:] = -20.0 * np.eye(n), -3.0 * np.eye(n) + 0.2 * rng.normal(size=(H + 1, n, n))
    J_u[:] = np.sin(0.3 * np.arange(H + 1))[:, None, None] * np.eye(n) + 0.1
    E1, plus, minus = np.empty((H + 1, 4, 4)), np.empty((H + 1, 4, n)), np.empty((H + 1, 4, n))
    found = ffi.new("StopsetResponses *", (H + 1, 4, 4, n, view(E1), view(plus), view(minus)))
    assert lib.stopset_along(n, H, view(J_x), view(J_u), dt, found, view(np.empty(3 * H * 8))) == 0
    E, R = np.eye(4), np.zeros((4, n))
    for k in range(H):
        A, B = np.zeros((6, 6)), np.zeros((4, n))
        A[:n, n : 2 * n], A[n : 2 * n, : 2 * n] = np.eye(n), 0.5 * (J_x[k] + J_x[k + 1])
        B[n:] = 0.5 * (J_u[k] + J_u[k + 1])
        A[:4, 4:] = B
        step = expm(A * dt)
        E, R = step[:4, :4] @ E, step[:4, :4] @ R + step[:4, 4:]
    assert E1[-1] == pytest.approx(E, rel=1e-9, abs=1e-12) and (plus + minus)[-1] == pytest.approx(R, rel=1e-6, abs=1e-9)
    assert np.all(plus >= 0.0) and np.all(minus <= 0.0) and minus[-1].min() < -1e-3


# ---- torques, inputs and stretches of time


def test_a_bent_joint_is_that_pose() -> None:
    arm = robot_from_text(serial("revolute", "revolute"))
    x, bend = np.random.default_rng(5).normal(size=(3, 4, 2)), np.random.default_rng(6).normal(size=(3, 4))
    tau, struct = np.empty((4, 2)), arm_struct(arm.chain, arm.pi)
    bent = ffi.new("StopsetBend *", (1, 0, *(view(b) for b in bend)))
    lib.stopset_bent_torques(struct, 4, *(view(given(r)) for r in x), bent, view(tau))
    x[:, :, 1] += bend
    assert tau == pytest.approx(torques(arm.chain, arm.pi, *x), rel=1e-13)


@pytest.mark.parametrize("samples", [1, 3])
def test_a_law_of_no_steps_gives_nothing(samples: int) -> None:
    """Of one sample alone, and of several."""
    out, none = np.ones(samples), np.zeros(samples * lib.STOPSET_SIGNALS)
    lib.stopset_law(ffi.new("StopsetProgram *", (0, ffi.NULL, ffi.NULL)), samples, view(none), view(out))
    assert not out.any()


def test_products_of_series_end_at_their_order_and_at_the_room_there_is() -> None:
    """1 + x + x^2 times itself, up to each degree; what has no room, or no degree, is refused."""
    shift, powers, ones = 8, np.arange(3), np.ones(3)
    key, slot = integers(np.array([(k << shift) + k for k in powers])), np.empty(16, np.int64)

    terms = ffi.new("StopsetTaylor *", (3, key, view(ones)))

    def product(order: int, room: int, size: int = 16) -> tuple[int, Array]:
        keys, values = np.empty(16, np.int64), np.empty(16)
        table = ffi.new("StopsetProduct *", (room, size, integers(slot), integers(keys), view(values)))
        made = lib.stopset_taylor_multiply(terms, terms, order, shift, table)
        return made, values[: max(made, 0)][np.argsort(keys[: max(made, 0)])]

    for order, want in ((0, [1]), (1, [1, 2]), (2, [1, 2, 3]), (3, [1, 2, 3, 2]), (63, [1, 2, 3, 2, 1])):
        made, values = product(order, 16)
        assert made == len(want) and values.tolist() == want
    assert product(4, 5)[0] == 5 and product(4, 4)[0] == -1 and product(-1, 16)[0] == -1 and product(64, 16)[0] == -1
    assert product(4, 8, 8)[1].tolist() == [1, 2, 3, 2, 1]  # keys that share a place


def test_an_envelope_names_the_last_window_too() -> None:
    """The extremes are found wherever they are, the first and the last of many windows among them."""
    n, N = 1, 21
    for where in (0, 9, N - 1):
        residual = np.zeros((2, N))
        residual[0, where], residual[1, where] = 1.0, -1.0
        hi, lo, at, work = np.zeros((2, 2)), np.zeros((2, 2)), np.full((2, 2, 2, 2), -1), np.empty(2 * N)
        env = ffi.new("StopsetEnvelope *", (2, 2, 7, view(hi), view(lo), integers(at[0]), integers(at[1])))
        lib.stopset_widen_decoupled(env, n, view(np.zeros(4)), N, view(residual), N, view(work))
        assert hi[1].tolist() == [1.0, 0.0] and lo[1].tolist() == [0.0, -1.0]
        assert at[0, 1, 0].tolist() == [7, where] and at[1, 1, 1].tolist() == [7, where]


@pytest.mark.parametrize("joint", [-1, 2, 7])
def test_a_joint_that_is_none_is_not_bent(joint: int) -> None:
    arm = robot_from_text(serial("revolute", "revolute"))
    x, tau = np.random.default_rng(5).normal(size=(3, 4, 2)), np.empty((4, 2))
    more = np.full(4, 0.3)
    bent = ffi.new("StopsetBend *", (joint, 0, view(more), view(more), view(more)))
    struct = arm_struct(arm.chain, arm.pi)
    assert lib.stopset_bent_torques(struct, 4, *(view(given(r)) for r in x), bent, view(tau)) == lib.STOPSET_OK
    assert np.array_equal(tau, torques(arm.chain, arm.pi, *x))


def test_inputs_of_many_samples_with_a_memory_are_each_samples() -> None:
    """Blocks of samples are computed together: the memory goes along from block to block."""
    model = known_model()
    model = replace(model, effects=(Fitted("hysteresis", model.joints[0], {"F_h": 12.0, "delta": 0.02}, {}),))
    rng, N = np.random.default_rng(6), 500
    q, dq, tau = rng.normal(size=(3, N, model.n))
    state = rng.uniform(-1, 1, N)
    together = model.input(q, dq, tau, memories={0: (state,)})
    alone = [model.input(q[k : k + 1], dq[k : k + 1], tau[k : k + 1], memories={0: (state[k : k + 1],)})[0] for k in range(N)]
    assert (
        np.array_equal(together, alone)
        and np.ptp(together[:, 0] - model.input(q, dq, tau, memories={0: (0 * state,)})[:, 0]) > 1.0
    )


def test_inputs_without_any_memory_need_none() -> None:
    """A caller that has no states hands none over."""
    model = known_model()
    map_ = Inputs.of(model, Quantum.none(model.n), (0.0, 0.0)).struct.map
    q, dq, tau = (given(x) for x in np.random.default_rng(7).normal(size=(3, 40, model.n)))
    u = np.empty((40, model.n))
    samples = ffi.new("StopsetSamples *", {"q": view(q), "dq": view(dq), "tau": view(tau)})
    assert lib.stopset_inputs(map_, 40, samples, view(u)) == lib.STOPSET_OK
    assert np.array_equal(u, model.input(q, dq, tau))


def test_a_tube_is_cut_into_no_more_stretches_than_it_has_steps() -> None:
    tube = simple_tube(3)
    cut = slices(tube, 10)
    assert len(cut.d_lo) == 3 and cut.t.tolist() == tube.t.tolist()
    assert len(slices(tube, 1).d_lo) == 1


def simple_tube(steps: int) -> Tube:
    """Two joints that move on at 1 and 2 rad/s."""
    t = 0.1 * np.arange(steps + 1)
    d, v = t[:, None] * [1.0, 2.0], np.tile([1.0, 2.0], (steps + 1, 1))
    none, free = [0 * v[1:]] * 4, np.full_like(v, np.inf)
    return Tube(OK, t, d, d, v, v, v[1:], v[1:], *none, np.zeros(2), False, free, np.full(steps, np.inf))


# ---- numbers at an edge of their type


@pytest.mark.parametrize("x", [0.0, -0.0, 1e-60, -1e-60, 0.1, -0.1, 0.7, -0.7, 1e39, -1e39, np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("side", [1, 0, -1])
def test_numbers_go_outward_to_a_neighbour(x: float, side: int) -> None:
    bits = np.zeros(1, np.uint32)
    lib.stopset_outward(1, view(np.array([x])), ffi.new("int8_t *", side), ffi.cast("uint32_t *", bits.ctypes.data))
    out = float(bits.view(np.float32)[0])
    if np.isnan(x):
        assert np.isnan(out) if side == 0 else out == side * np.inf
        return
    with np.errstate(over="ignore"):
        assert (out >= x, np.isclose(out, np.float32(x), rtol=1e-6) or abs(x) > 1e38 or abs(x) < 1e-40, out <= x)[1 - side]
