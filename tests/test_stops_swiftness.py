"""No point of a body is faster than the arm's energy can move that body."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from stop_sampling import sample_stops
from stopset.reach.stops import StopBounds
from stopset.reach.stops.cartesian import SLICES, reached, slices
from stopset.reach.stops.compiled import CompiledStops
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.start import Start
from stopset.reach.stops.swiftness import swiftness
from stopset.reach.stops.tubes import march_box
from stopset.robot.arm import standard_parameters
from stopset.robot.rigid import Chain, link_frames, mass_matrix
from stopset.types import Array

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from stop_arms_wide import arms

HEAVY = "random arm of 7 joints, 1"


def setting(name: str, least: float) -> tuple[Setting, Array]:
    model, top = arms()[name]
    rated = model.domain.payload[1]
    found = StopBounds.of(model, (least * rated, rated)).setting
    assert found is not None
    return found, top


def jacobian(chain: Chain, q: Array, link: int, at: Array) -> Array:
    """(3, n) [m] of a point of a link, by cross products."""
    R, o = link_frames(chain, q)
    J, p = np.zeros((3, len(q))), o[link] + R[link] @ at
    for i in range(link + 1):
        J[:, i] = np.cross(R[i] @ chain.axis[i], p - o[i])
    return J


@pytest.mark.parametrize("name", [HEAVY, "UR10e-like", "random arm of 2 joints, 0"])
def test_no_point_is_swifter_than_told_and_some_motion_of_a_free_body_is_as_swift(name: str) -> None:
    """Of all speeds of one energy the fastest a point can have, by the arm's own inertia, in random poses; rotors left out."""
    s, _ = setting(name, 0.5)
    p, rng, nearest = s.plant, np.random.default_rng(3), 0.0
    for link in range(len(p.rotor)):
        at = rng.uniform(-0.2, 0.2, 3) if link else np.array([0.0, 0.0, 0.1])
        told = swiftness(p, link, at)
        assert told > 0.0
        for share in (-1.0, 1.0):
            for _ in range(200):
                q = rng.uniform(-np.pi, np.pi, len(p.rotor))
                J, M = jacobian(p.chain, q, link, at), mass_matrix(p.chain, p.pi + share * p.pi_half, q)
                fastest = np.sqrt(np.linalg.eigvalsh(J @ np.linalg.solve(M, J.T))[-1])
                nearest = max(nearest, fastest / told)
                assert fastest <= told
    assert nearest > 0.3


def test_the_swiftness_of_a_point_mass_is_that_of_its_mass() -> None:
    s, _ = setting(HEAVY, 1.0)
    m = s.plant.pi[-1, 0]
    centre = s.plant.pi[-1, 1:4] / m
    assert swiftness(s.plant, 6, centre) == pytest.approx(1.0 / np.sqrt(m), rel=2e-4)
    assert swiftness(s.plant, 6, centre + 0.1) > 1.01 / np.sqrt(m)


def test_what_no_body_can_be_says_nothing() -> None:
    s, _ = setting(HEAVY, 0.5)
    for link, changed in ((0, {0: -0.1}), (3, {4: -1.0}), (6, {9: 0.0}), (2, {0: 0.0})):
        pi = s.plant.pi.copy()
        for k, x in changed.items():
            pi[link, k] = x
        assert swiftness(s.plant._replace(pi=pi), 6, s.payload_com) == 0.0
    weightless = s.plant.pi.copy()
    weightless[6] = 0.0
    bare = s.plant._replace(pi=weightless, pi_half=0.0 * s.plant.pi_half)
    assert swiftness(bare, 6, s.payload_com) == 0.0 < swiftness(bare, 5, np.zeros(3))
    point = s.plant.pi.copy()
    point[6] = standard_parameters(2.0, np.array([0.1, 0.0, 0.2]), np.zeros((3, 3)))  # it turns as fast as it likes
    assert swiftness(s.plant._replace(pi=point, pi_half=0.0 * s.plant.pi_half), 6, s.payload_com) == 0.0
    assert swiftness(s.plant._replace(pi_half=-s.plant.pi_half), 6, s.payload_com) == 0.0
    assert swiftness(s.plant, -1, s.payload_com) == swiftness(s.plant, 7, s.payload_com) == 0.0
    with pytest.raises(ValueError, match="a point"):
        swiftness(s.plant, 6, np.zeros(2))


def test_the_energy_holds_the_tool_where_wrists_go_far_and_no_stop_gets_out() -> None:
    """On the arm on which joints tell least of the tool: its way is less than 0.75 times, its speed less than a tenth of what joints alone tell."""
    s, top = setting(HEAVY, 1.0)
    rng, n, ratios, pace = np.random.default_rng(5), s.model.n, [], []
    for k in range(3):
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * top
        start = Start(q, dq, s.noise.radius[:n], s.noise.radius[n:])
        tube = march_box(s, s.plant, start, energetic=True)
        ask = s.plant.chain, q, start.q_radius, slices(tube, SLICES), [n - 1], [s.payload_com]
        joints, paid = reached(*ask)[0], reached(*ask, np.array([swiftness(s.plant, len(q) - 1, s.payload_com)]))[0]
        ratios.append(paid.far / joints.far)
        pace.append(paid.fast / joints.fast)
        found = sample_stops(s.plant, q, dq, start.q_radius, start.dq_radius, s.payload_com, tube, 60, k)
        assert found.escaped == 0 and found.tcp <= paid.far
    assert max(ratios) < 0.75 and max(pace) < 0.1


def test_a_loop_and_the_core_count_with_the_same_swiftness() -> None:
    """Where the energy bounds the stop and swiftness decides: of a load that is known, and of parts of a range."""
    model, top = arms()[HEAVY]
    rated, rng, n = model.domain.payload[1], np.random.default_rng(2), model.n
    for least in (1.0, 0.5):
        bounds = StopBounds.of(model, (least * rated, rated), fast=True)
        assert bounds.setting is not None
        core = CompiledStops.of(bounds.setting)
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * top
        a, b = core.bound(q, dq), bounds.bound(q, dq)
        assert a is not None and b.tcp is not None and b.layer == "energy"
        assert a.tool[0] == b.tcp and a.tool[1] == b.tcp_speed
