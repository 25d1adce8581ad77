"""The true arm of a simulation: every physical parameter it has, hidden effects among them.

The laws of its friction and gears, in the core's ``simulation/arm.c``, are deliberately *not* those of `stopset.effects`: a
viscosity curve instead of a straight line, Maxwell slip elements instead of Dahl, a rational Stribeck curve instead of a
Gaussian, a tooth load from the transmitted torque instead of gravity.  A diagnosis that only recognises its own formulas
would be worth nothing on a real arm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stopset.robot import Robot
from stopset.robot.rigid import Chain, gravity_torques, mass_matrix
from stopset.types import Array

ELEMENTS = 4  # spring-slider elements in parallel, each with its share of the friction


class SimulatedPlant(NamedTuple):
    """All true parameters of an arm; joint arrays are (n,), link side, SI. Zero means: this arm does not have it."""

    chain: Chain
    pi: Array  # (n, 10)
    rotor: Array  # [kg m^2]
    fc: Array  # [N m] at 30 degC
    fv: Array  # [N m s/rad] at 30 degC
    limit: Array  # [N m] the drive saturates here
    brake_torque: Array  # [N m]
    brake_delay: Array  # [s]
    brake_rise: Array  # [s]
    fv_slope: Array  # [1/K] relative fall of fv at 30 degC
    fc_slope: Array  # [1/K] relative fall of fc there
    breakaway: Array  # [N m] friction at rest above fc
    stribeck_speed: Array  # [rad/s]
    tooth: Array  # [-] friction per transmitted torque
    skew: Array  # [-] friction (1 + skew) forward, (1 - skew) backward
    thinning_speed: Array  # [rad/s] above it viscous friction grows with asinh only
    ripple: Array  # [N m]
    ripple_order: Array  # [1/rev]
    ripple_phase: Array  # [rad]
    stiffness: Array  # [N m/rad] of the gear; encoder, friction and brake sit on the motor's side
    twist_damping: Array  # [N m s/rad]
    presliding: Array  # [rad] friction builds up over this displacement
    gain: Array  # [-] true torque over reported torque
    spring: Array  # [N m/rad]
    spring_centre: Array  # [rad]
    drag: Array  # [N m s/rad] on this joint from the partner's speed and on the partner from this one's
    partner: NDArray[np.int64]
    encoder_offset: Array  # [rad] reading minus truth
    eccentricity: Array  # [rad]
    eccentricity_phase: Array  # [rad]
    bump: Array  # [N m] outside the catalogue: torque at one place only
    bump_centre: Array  # [rad]
    bump_width: Array  # [rad]
    resonance: Array  # [N m] outside the catalogue: friction peak at one speed only
    resonance_speed: Array  # [rad/s]
    weave: Array  # [N m s/rad] outside the catalogue: sin(3 q) times the partner's speed
    film_heat: Array  # [1/W] friction falls as 1 / (1 + film); this is the film's rise under a steady loss, per watt
    film_time: Array  # [s] the film's time constant
    tooth_square: Array  # [1/(N m)] friction per square of the transmitted torque
    counter: Array  # [N m] force of a balancing gas spring times its shorter lever, where it is as long as its longer lever
    counter_ratio: Array  # [-] of its levers
    counter_centre: Array  # [rad] where the levers are stretched out
    cable: Array  # [N m] a cable pack that stretches: torque cable sinh((q - centre) / 0.6 rad)
    cable_centre: Array  # [rad]
    gap: Array  # [rad] backlash of an elastic gear
    lag: Array  # [s] the drive gives what it is told to through 1 / (lag s + 1)


def healthy_plant(robot: Robot, rng: np.random.Generator) -> SimulatedPlant:
    """An arm that is what its CAD says, with friction and brakes drawn at random around what such drives have.

    Where the data sheet is silent: see `torque_limit` and `rotor_inertia`; brake 1.5 times the largest gravity torque.
    """
    n = robot.n
    limit = torque_limit(robot)
    # harmonic drives from 20 to 400 N m: Coulomb friction grows with the root of the torque they are built for
    fc = 0.75 * np.sqrt(limit) * rng.uniform(0.8, 1.2, n)
    top = np.minimum(np.where(robot.dq_limit > 0, robot.dq_limit, 1.2), 3.0)
    fv = fc * rng.uniform(1.0, 1.6, n) * 1.2 / top
    nominal = np.array([d.brake_torque for d in robot.drives])
    nominal = np.where(np.isfinite(nominal), nominal, np.maximum(1.5 * largest_gravity(robot), limit / 2))
    delay, rise = (np.array([getattr(d, name) for d in robot.drives]) for name in ("brake_delay", "brake_rise"))
    delay = np.where(np.isfinite(delay), delay, [0.015, 0.025])
    rise = np.where(np.isfinite(rise), rise, [0.015, 0.025])
    none, far = np.zeros(n), np.full(n, 1.0)
    return SimulatedPlant(
        chain=robot.chain, pi=robot.pi.copy(), rotor=rotor_inertia(robot), fc=fc, fv=fv, limit=limit,
        brake_torque=nominal * rng.uniform(0.95, 1.05, n),
        brake_delay=_inside(delay, rng), brake_rise=_inside(rise, rng),
        fv_slope=none, fc_slope=none, breakaway=none, stribeck_speed=far, tooth=none, skew=none, thinning_speed=none,
        ripple=none, ripple_order=none, ripple_phase=none, stiffness=none, twist_damping=none, presliding=none,
        gain=np.ones(n), spring=none, spring_centre=none, drag=none, partner=np.zeros(n, np.int64),
        encoder_offset=none, eccentricity=none, eccentricity_phase=none, bump=none, bump_centre=none, bump_width=far,
        resonance=none, resonance_speed=far, weave=none, film_heat=none, film_time=far,
        tooth_square=none, counter=none, counter_ratio=none, counter_centre=none, cable=none, cable_centre=none, gap=none, lag=none,
    )  # fmt: skip


def _inside(interval: Array, rng: np.random.Generator) -> Array:
    """A value of each row's interval (n, 2), away from its ends: a data sheet's interval is meant to hold the truth."""
    return np.asarray(interval[:, 0] + (interval[:, 1] - interval[:, 0]) * rng.uniform(0.3, 0.7, len(interval)))


def largest_gravity(robot: Robot) -> Array:
    """(n,) largest gravity torque [N m] over a fixed set of poses."""
    poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (400, robot.n))
    return np.asarray(np.abs(gravity_torques(robot.chain, robot.pi, poses)).max(axis=0))


def rotor_inertia(robot: Robot) -> Array:
    """(n,) reflected rotor inertia [kg m^2]; where the data sheet is silent, half of the joint's mean own inertia.

    At least what lets the drive reach 200 rad/s^2 under its torque limit: geared drives are not quicker than that.
    """
    poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (50, robot.n))
    own = np.mean([np.diag(mass_matrix(robot.chain, robot.pi, q)) for q in poses], axis=0)
    return np.where(robot.rotor > 0, robot.rotor, np.maximum(0.5 * own, torque_limit(robot) / 200.0))


def torque_limit(robot: Robot) -> Array:
    """(n,) [N m]; three times the largest gravity torque, at least 5, where neither data sheet nor URDF tells."""
    given = np.where(np.isfinite(robot.torque_limit), robot.torque_limit, 0.0)
    return np.where(given > 0, given, np.maximum(3.0 * largest_gravity(robot), 5.0))


COLUMNS = 44  # joint arrays, in the order of the fields of Plant after `pi`: the core reads them by their place


def table(plant: SimulatedPlant) -> Array:
    """(n, COLUMNS) the plant's joint arrays side by side."""
    return np.column_stack([np.asarray(x, float) for x in plant[2:]])
