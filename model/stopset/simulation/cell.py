"""The simulated arm in its cell: controller, instruments, warming, and how one recording is made there.

Instruments: encoder of 2^-14 rad, velocity 0.003 rad/s, torque noise growing with the rated torque (0.07 to 0.3 N m),
thermometer 0.1 K in steps of 0.25 K; control at 1 kHz, recording at 250 Hz.  Dry and viscous friction of every joint
differ by 2 % from trial to trial.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stopset.core.library import lib, view
from stopset.errors import RobotError
from stopset.recording import Meta, Recording
from stopset.robot import Robot
from stopset.robot.arm import standard_parameters
from stopset.robot.rigid import mass_matrix
from stopset.simulation.arm import Script, run, start
from stopset.simulation.dynamics import motor_torques
from stopset.simulation.hidden import Truth
from stopset.simulation.motions import Space, Trajectory, space_of
from stopset.simulation.plant import SimulatedPlant
from stopset.types import Array

TICK = 0.001  # [s] of the control loop; the torque is held in between
EVERY = 4  # ticks are recorded: 250 Hz, so that a recorded torque is that of its sample, not of the next
STEPS_PER_TICK = 2  # of 0.5 ms
RESOLUTION = 2.0**-14  # [rad]
LINK_RESOLUTION = 2 * np.pi / 2**19  # [rad] of encoders behind the gears, where the cell has them
SPEED_NOISE = 0.003  # [rad/s]
SPEED_STEP, TORQUE_STEP, TEMP_STEP = 2.0**-11, 2.0**-6, 0.25  # [rad/s], [N m], [K] of what goes over the bus
FRICTION_SPREAD = 0.02
AMBIENT = 23.0  # [degC]
RISE = 22.0  # [K] over ambient in the end
COOLING = 1.0 / 900.0  # [1/s] of a joint's housing
WORK_BETWEEN = 1800.0  # [s] of work between the recordings, in all
STATIC_WORK = 0.1  # of it before a static pose, compared with other recordings
REST = (8.0, 20.0)  # [s] a drive rests between its work and a recording
RUN_UP = 0.1  # [s] before a stop request
RAN_AWAY = 12.0  # [rad]
SATURATED = 0.1  # share of a recording at the torque limit that makes it useless
RAMP = 0.35  # [s] of a nominal STOP 1
HOLD = 0.2  # [s] after it: the brakes close after 0.06 s, power goes off 0.07 s later, the recording ends
BRAKES_AFTER, CUT_AFTER = 0.06, 0.13
BELIEVED = 0.9  # share of the true friction that the controller's feedforward knows
BANDWIDTH, DAMPING = 10.0, 0.9  # [rad/s], [-] of the joint controllers


@dataclass(frozen=True, slots=True)
class Measurement:
    """One recording to be made; ``progress`` its place in the campaign, 0 first, 1 last."""

    phase: str
    suite: int
    trial: int
    motion: Trajectory
    progress: float = 0.0
    feedforward: Array | None = None  # open loop: the torques to replay


@dataclass(frozen=True, slots=True)
class Cell:
    """What is true, what the controller believes, and the seed of everything random; see `build_cell`."""

    cad: Robot
    truth: Truth
    seed: int
    space: Space  # where campaigns move
    kp: Array  # (n,) [N m/rad]
    kd: Array  # (n,) [N m s/rad]
    warmth: Array  # (n,) rise over ambient under steady work [K]
    link_encoder: bool = False  # behind every gear, beside the motor's

    def random(self, *what: object) -> np.random.Generator:
        """Random numbers of their own for every purpose, so that one more draw here changes nothing there."""
        return np.random.default_rng([self.seed, zlib.crc32(repr(what).encode())])

    @property
    def torque_noise(self) -> Array:
        """(n,) standard deviation [N m]."""
        return 0.015 * np.sqrt(self.truth.plant.limit)

    @property
    def meta(self) -> Meta:
        return Meta(self.cad.joints, robot=self.cad.name, effort="motor_torque", rate_hz=1.0 / (EVERY * TICK))


def build_cell(cad: Robot, truth: Truth, seed: int) -> Cell:
    """A cell around ``cad`` (with complete drive data): controllers tuned to the mean inertia of each joint."""
    space = space_of(cad)
    rng = np.random.default_rng(0)
    poses = rng.uniform(space.box[:, 0], space.box[:, 1], (30, cad.n))
    inertia = np.mean([np.diag(mass_matrix(cad.chain, cad.pi, q)) for q in poses], axis=0) + cad.rotor
    warmth = RISE * np.random.default_rng([seed, 0]).uniform(0.8, 1.2, cad.n)
    # light joints: stiff enough that dry friction alone is no more than 0.05 rad of error
    kp = np.maximum(inertia * BANDWIDTH**2, truth.plant.fc / 0.05)
    return Cell(cad, truth, seed, space, kp, 2 * DAMPING * BANDWIDTH * inertia, warmth)


def temperatures(cell: Cell, progress: float) -> Array:
    """(n,) true temperatures [degC] at a place of the campaign: first order from ambient under the work in between."""
    share = 1.0 - np.exp(-COOLING * WORK_BETWEEN * progress)
    return np.asarray(AMBIENT + cell.warmth * share)


def feedforward(cell: Cell, job: Measurement) -> Array:
    """(K, n) torque [N m] the controller's own model asks for: CAD, data sheet, and about the right friction."""
    plant, cad = cell.truth.plant, cell.cad
    q, dq, ddq = job.motion
    out = motor_torques(cad.chain, cad.pi, cad.rotor, q, dq, ddq)
    friction = BELIEVED * (plant.fc * np.tanh(dq / 0.05) + plant.fv * dq)
    if job.phase == "static":  # creeping in, with the friction of that direction to the very end
        friction = np.broadcast_to(BELIEVED * plant.fc * np.sign(dq[0]), q.shape)
    out += friction
    return out


def _today(cell: Cell, job: Measurement, rng: np.random.Generator) -> SimulatedPlant:
    """The plant of one trial: friction differs between trials, brakes between stops, and run-in goes on."""
    p, n = cell.truth.plant, cell.cad.n
    varied = job.phase in ("stop0", "stop1") and job.suite == 1
    spread = FRICTION_SPREAD * (3.0 if varied else 1.0)
    lost = cell.truth.run_in * (1 - np.exp(-3 * job.progress)) / (1 - np.exp(-3.0))
    friction = (1 + spread * rng.standard_normal((2, n))) * (1 - lost)
    brake = rng.uniform(0.85, 1.1, n) if varied else 1 + 0.02 * rng.standard_normal(n)
    late = 1 + 0.03 * rng.standard_normal(n)
    if job.trial < 0:  # the master run of an open-loop suite
        friction = np.tile(1 - lost, (2, 1))
    return p._replace(
        fc=p.fc * friction[0],
        fv=p.fv * friction[1],
        brake_torque=p.brake_torque * brake,
        brake_delay=p.brake_delay * late,
    )


def _wander(cell: Cell, ticks: int, rng: np.random.Generator) -> Array:
    """(ticks, n) slow random wander of dry friction [N m]: an Ornstein-Uhlenbeck path, stationary from the start."""
    if not cell.truth.wander.any():
        return np.zeros((ticks, cell.cad.n))
    return _first_order(rng.standard_normal((ticks, cell.cad.n)), np.exp(-TICK / cell.truth.wander_time)) * cell.truth.wander


def _first_order(kick: Array, a: Array) -> Array:
    """Rows of a process of first order, each ``a`` times the one before it and a ``kick`` (K, n) that keeps its size."""
    out = np.sqrt(1 - a * a) * kick
    out[0] = kick[0]
    lib.stopset_march(out.shape[1], view(np.eye(out.shape[1]) * a), len(out), view(out))
    return out


class Log(NamedTuple):
    """What happened at every control tick, (K, n) each; see `stopset.simulation.arm.run`."""

    q: Array
    dq: Array
    tau: Array
    temp: Array
    link: Array
    speed: Array


def play(cell: Cell, job: Measurement, temp: Array, rng: np.random.Generator) -> Log:
    """Let the arm do a job, starting at joint temperatures ``temp`` [degC]; raises `RobotError` if it cannot."""
    n, K = cell.cad.n, len(job.motion.q)
    plant = _today(cell, job, rng)
    kp, kd = cell.kp, cell.kd
    q0, v0 = job.motion.q[0], job.motion.dq[0]
    torque = feedforward(cell, job) if job.feedforward is None else job.feedforward
    noise = rng.normal(0, SPEED_NOISE, (K, n)) * (job.trial >= 0)
    if job.feedforward is not None:
        kp, kd, q0 = np.zeros(n), np.zeros(n), q0 + rng.normal(0, 0.0005, n)
    if job.phase == "static":  # stiff, so that an unknown load does not push it back; already under way
        kp, kd = 4 * kp, 2 * kd
        q0 = q0 - np.sign(v0) * (1 - BELIEVED) * plant.fc / kp
    brake_at = cut_at = K
    if job.phase == "stop0":
        brake_at = cut_at = round(RUN_UP / TICK)
    elif job.phase == "stop1":
        brake_at, cut_at = K - round((HOLD - BRAKES_AFTER) / TICK), K - round((HOLD - CUT_AFTER) / TICK)
    script = Script(
        TICK, torque, job.motion.q, job.motion.dq, kp, kd, brake_at, cut_at,
        np.zeros((K, n)), noise, RESOLUTION, _wander(cell, K, cell.random("wander", job.phase, job.suite, job.trial)),
    )  # fmt: skip
    state = start(plant, _motor_angle(plant, q0), v0, temp)
    # the friction power of steady work at half speed heats by `Cell.warmth` in the end
    half = 0.5 * cell.space.speed
    power = half * (plant.fc + plant.fv * half)
    heating = COOLING * cell.warmth / power
    if plant.film_heat.any():  # what steady work has left of the film's warmth after a rest of its own length
        rest = cell.random("rest", job.phase, job.suite, job.trial).uniform(*REST)
        state.film[:] = plant.film_heat * power * np.exp(-rest / plant.film_time)
    log = Log(*run(plant, script, state, heating, AMBIENT, COOLING, STEPS_PER_TICK))
    _check(cell, job, log.link, log.tau)
    return log


def record(cell: Cell, job: Measurement, temp: Array) -> Recording:
    """Make one recording, starting at joint temperatures ``temp`` [degC]."""
    rng = cell.random("trial", job.phase, job.suite, job.trial)
    log = play(cell, job, temp, rng)
    shown = reported(cell, log)[::EVERY]
    q, dq, warm = log.q[::EVERY], log.dq[::EVERY], log.temp[::EVERY]
    tau = shown + rng.normal(0, 1, shown.shape) * cell.torque_noise
    warm = warm + rng.normal(0, 0.1, shown.shape)
    dq, tau, warm = (np.round(x / step) * step for x, step in ((dq, SPEED_STEP), (tau, TORQUE_STEP), (warm, TEMP_STEP)))
    t = np.arange(len(q), dtype=np.float64) * (EVERY * TICK)
    asked = t >= RUN_UP - 0.5 * TICK if job.phase in ("stop0", "stop1") else np.zeros(len(t), bool)
    behind = np.round(log.link[::EVERY] / LINK_RESOLUTION) * LINK_RESOLUTION if cell.link_encoder else None
    whole = Recording(
        job.phase, job.suite, job.trial, 0, t, q, dq, tau, temp=warm if cell.truth.thermometer else None, q_link=behind,
        stop_trigger=asked,
    )  # fmt: skip
    if job.phase == "static":
        still = whole.cut(len(t) - 4, len(t))
        return replace(still, t=still.t - still.t[0])
    if job.phase == "stop0":  # until 0.1 s after the last motion
        moving = np.flatnonzero(np.abs(dq).max(axis=1) > 6 * SPEED_NOISE)
        return whole.cut(0, int(moving[-1]) + 1 + round(0.1 / (EVERY * TICK)))
    return whole


def _check(cell: Cell, job: Measurement, q: Array, tau: Array) -> None:
    """Raise `RobotError` where the arm ran away or its drives are too weak for it."""
    advice = "expected joints that their drives can hold: check inertias and torque limits of the robot"
    if not np.abs(q).max() < RAN_AWAY:
        raise RobotError(f"the simulated arm ran away in {job.phase} suite {job.suite}, beyond {RAN_AWAY} rad; {advice}")
    spent = (np.abs(tau) >= cell.truth.plant.limit).mean(axis=0)
    if job.phase == "closed_loop" and spent.max() > SATURATED:
        j = int(np.argmax(spent))
        raise RobotError(f"the drive of {cell.cad.joints[j]} is at its torque limit {spent[j]:.0%} of the time; {advice}")


def _motor_angle(plant: SimulatedPlant, reading: Array) -> Array:
    """(n,) where the motors are when the encoders say ``reading`` [rad]; the eccentricity is a mild contraction."""
    x = reading - plant.encoder_offset
    for _ in range(30):
        x = reading - plant.encoder_offset - plant.eccentricity * np.sin(x + plant.eccentricity_phase)
    return np.asarray(x)


def reported(cell: Cell, log: Log) -> Array:
    """(K, n) motor torque as the drives report it: late by its delay, without what their own Coriolis part adds."""
    t, p = cell.truth, cell.truth.plant
    out = log.tau.copy()
    if t.unlogged_coriolis.any():
        zero, rotor = np.zeros_like(log.link), np.zeros(cell.cad.n)
        c = motor_torques(p.chain, p.pi, rotor, log.link, log.speed, zero)
        out -= t.unlogged_coriolis * (c - motor_torques(p.chain, p.pi, rotor, log.link, zero, zero))
    ticks = np.arange(len(out), dtype=float)
    for j in np.flatnonzero(t.delay):
        out[:, j] = np.interp(ticks - t.delay[j] / TICK, ticks, out[:, j])
    return out


def wrong_cad(robot: Robot, rng: np.random.Generator) -> Array:
    """(n, 10) true standard parameters when the CAD is off by 2 to 5 % in mass and about 3 mm in the centre of mass."""
    out = robot.pi.copy()
    for i, P in enumerate(robot.pi):
        m, c = P[0], P[1:4] / P[0]
        xx, xy, yy, xz, yz, zz = P[4:]
        about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        inertia = about_origin - m * ((c @ c) * np.eye(3) - np.outer(c, c))
        scale = 1 + rng.uniform(0.02, 0.05) * rng.choice([-1.0, 1.0])
        out[i] = standard_parameters(scale * m, c + rng.normal(0, 0.003 / np.sqrt(3), 3), scale * inertia)
    return out
