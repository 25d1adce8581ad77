"""Effects that can be hidden in the simulated arm: each changes the truth, none is told to the data sheet.

A size is one number per effect, zero meaning healthy; `stopset.simulation.sizing` chooses it so that the torque
residual of the joint grows by a wanted factor.  Names are those of the catalogue of `stopset.effects`; the four that start with
``outside_`` are in no catalogue, and the right answer to them is "unknown".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType

import numpy as np

from stopset.effects import catalogue
from stopset.errors import EffectError
from stopset.robot import Robot
from stopset.robot.arm import standard_parameters
from stopset.simulation.motions import space_of
from stopset.simulation.plant import SimulatedPlant, largest_gravity
from stopset.types import Array

Parameters = dict[str, float | str]


@dataclass(frozen=True, slots=True)
class Truth:
    """The true arm and its true instruments; joint arrays (n,)."""

    plant: SimulatedPlant
    delay: Array  # [s] the reported torque lags the true one (negative: leads)
    unlogged_coriolis: Array  # [-] share of the Coriolis torque the drive adds below the reported torque
    run_in: Array  # [-] share of friction lost over the campaign, not told by any temperature
    wander: Array  # [N m] standard deviation of dry friction's slow wander
    wander_time: Array  # [s] its correlation time
    left_gravity: Array  # [-] share of gravity that the drives forget to take off; not zero: they show compensated torque
    thermometer: bool = True  # is temperature recorded?


@dataclass(frozen=True, slots=True)
class Hidden:
    """One hidden effect: ``joint`` None for the whole arm; ``size`` in the effect's own measure (see `HiddenKind`)."""

    effect: str
    joint: int | None
    size: float


# (truth, robot, joint, size, its own random numbers) -> changed truth, parameters to report
Inject = Callable[[Truth, Robot, int, float, np.random.Generator], tuple[Truth, Parameters]]


@dataclass(frozen=True, slots=True)
class HiddenKind:
    """How an effect is hidden: ``guess`` is a size to start from, ``most`` the largest that makes physical sense."""

    inject: Inject
    guess: float
    most: float
    scope: str = "joint"
    top: float = float("inf")  # [rad/s] its residual is looked at below this speed
    where: str = "any"  # joints chosen when none is named: "any", "loaded" (by gravity)
    joints: int = 1  # that the arm must have
    both: bool = False  # whether the cause sits at both joints of a pair, or at the first alone
    outside: bool = False  # a cause that no effect of the catalogue is
    fixed: str = ""  # why the size is `guess` whatever factor is wanted; empty where it is chosen for the factor


def _plant(truth: Truth, joint: int, **values: float) -> Truth:
    """``truth`` with some of the plant's entries of one joint changed."""
    changed = {}
    for name, value in values.items():
        array = getattr(truth.plant, name).copy()
        array[joint] = value
        changed[name] = array
    return replace(truth, plant=truth.plant._replace(**changed))


def _entry(array: Array, joint: int, value: float) -> Array:
    out = array.copy()
    out[joint] = value
    return out


def _thermal_viscous(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    law = "fv(T) = fv exp(slope (30 + 95)^2 (1 / (T + 95) - 1 / 125)), T in degC"
    return _plant(t, j, fv_slope=size), {"slope_per_K": size, "fv_at_30_degC": t.plant.fv[j], "law": law}


def _thermal_coulomb(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    law = "fc(T) = fc (0.4 + 0.6 exp(-slope (T - 30) / 0.6))"
    return _plant(t, j, fc_slope=size), {"slope_per_K": size, "fc_at_30_degC": t.plant.fc[j], "law": law}


def _warm_up(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    law = "friction falls by (1 - exp(-3 s)) / (1 - exp(-3)) of lost_share, s: place in the campaign, 0..1"
    return replace(t, run_in=_entry(t.run_in, j, size), thermometer=False), {"lost_share": size, "law": law}


def _self_heating(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    """``size``: the film's rise under steady work at half speed; friction then falls to 1 / (1 + size)."""
    half, time = 0.5 * float(space_of(r).speed[j]), float(g.uniform(2.0, 5.0))
    power = half * float(t.plant.fc[j] + t.plant.fv[j] * half)
    law = "friction falls as 1 / (1 + x), time_constant dx/dt = rise (friction loss / loss at half speed) - x"
    truth = _plant(t, j, film_heat=size / power, film_time=time)
    return replace(truth, thermometer=False), {"rise_at_half_speed": size, "time_constant_s": time, "law": law}


def _stribeck(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    speed, extra = float(g.uniform(0.04, 0.1)), size * float(t.plant.fc[j])
    truth = _plant(t, j, breakaway=extra, stribeck_speed=speed)
    return truth, {"breakaway_Nm": extra, "stribeck_speed_rad_per_s": speed, "law": "extra / (1 + (dq / speed)^2)"}


def _load_coulomb(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    return _plant(t, j, tooth=size), {"friction_per_load": size, "load": "whole torque the gear transmits to the links"}


def _asymmetric(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    skew = size * float(g.choice([-1.0, 1.0]))
    fc = float(t.plant.fc[j])
    return _plant(t, j, skew=skew), {"fc_forward_Nm": fc * (1 + skew), "fc_backward_Nm": fc * (1 - skew)}


def _cubic(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    """First the bend moves down to 0.4 of the top speed; from there on the oil gets thicker."""
    if size <= 0:
        return t, {}
    speed = float(space_of(r).speed[j])
    bend, thick = max(speed / size, 0.4 * speed), 1.0 + max(0.0, size - 2.5)
    fv = thick * float(t.plant.fv[j])
    law = "fv v0 asinh(dq / v0): cubic term -fv / (6 v0^2) at low speed"
    return _plant(t, j, thinning_speed=bend, fv=fv), {"v0_rad_per_s": bend, "fv_Nms_per_rad": fv, "law": law}


def _payload(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    com = r.tip + g.uniform(-0.03, 0.03, 3)
    body = standard_parameters(size, com, np.eye(3) * 0.4 * size * 0.05**2)  # a ball of 5 cm
    pi = t.plant.pi.copy()
    pi[-1] += body
    said: Parameters = {"mass_kg": size, **{f"com_{a}_m": float(c) for a, c in zip("xyz", com, strict=True)}}
    return replace(t, plant=t.plant._replace(pi=pi)), said


def _rotor(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    stated = float(t.plant.rotor[j])
    return _plant(t, j, rotor=stated * (1 + size)), {"true_kgm2": stated * (1 + size), "stated_kgm2": stated}


def _elasticity(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    if size <= 0:
        return t, {}
    K = 10.0 * float(t.plant.limit[j]) / size  # at size 1 the gear twists by 0.1 rad under its torque limit
    D = 0.1 * float(np.sqrt(K * t.plant.rotor[j]))
    said: Parameters = {"stiffness_Nm_per_rad": K, "damping_Nms_per_rad": D, "encoder": "motor side"}
    return _plant(t, j, stiffness=K, twist_damping=D), said


def _ripple(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    order, phase = float(g.integers(20, 110)), float(g.uniform(0, 2 * np.pi))
    said: Parameters = {
        "amplitude_Nm": size,
        "cycles_per_rev": order,
        "phase_rad": phase,
        "second_harmonic_share": 0.15,
    }
    return _plant(t, j, ripple=size, ripple_order=order, ripple_phase=phase), said


def _hysteresis(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    said: Parameters = {"displacement_rad": size, "law": "four Maxwell slip elements, 0.4 to 4 times the displacement"}
    return _plant(t, j, presliding=size), said


def _gain(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    gain = 1 + size * float(g.choice([-1.0, 1.0]))
    return _plant(t, j, gain=gain), {"true_over_reported": gain}


def _delay(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    return replace(t, delay=_entry(t.delay, j, size)), {"delay_s": size, "law": "the reported torque lags the true one"}


def _lag(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    return _plant(t, j, lag=size), {"lag_s": size, "law": "the torque that acts is the reported one through 1 / (lag s + 1)"}


def _tilt(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    azimuth = g.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    gravity = t.plant.chain.gravity
    c, s = np.cos(size), np.sin(size)
    turned = gravity * c - np.cross(axis, gravity) * s + axis * (axis @ gravity) * (1 - c)  # base turns, gravity stays
    chain = t.plant.chain._replace(gravity=turned)
    return replace(t, plant=t.plant._replace(chain=chain)), {"roll_rad": size * axis[0], "pitch_rad": size * axis[1]}


def _spring(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    centre = float(g.uniform(-0.5, 0.5))
    said: Parameters = {"stiffness_Nm_per_rad": size, "centre_rad": centre, "law": "k x (1 + 0.05 x^2), x = q - centre"}
    return _plant(t, j, spring=size, spring_centre=centre), said


def _square_load(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    said: Parameters = {"friction_per_load_squared": size, "load": "whole torque the gear transmits to the links"}
    return _plant(t, j, tooth_square=size), said


def _counterbalance(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    ratio, centre = float(g.uniform(0.3, 0.6)), float(g.uniform(-np.pi, np.pi))
    law = "force lever, the force 15 % less where the spring is one lever longer"
    said: Parameters = {"torque_Nm": size, "lever_ratio": ratio, "stretched_out_rad": centre, "law": law}
    return _plant(t, j, counter=size, counter_ratio=ratio, counter_centre=centre), said


def _cable(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    centre = float(g.uniform(-0.5, 0.5))
    return _plant(t, j, cable=size, cable_centre=centre), {
        "torque_Nm": size,
        "centre_rad": centre,
        "law": "sinh((q - centre) / 0.6)",
    }


def _coupling(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    other = neighbour(j, r.n)
    drag = size * float(np.sqrt(t.plant.fv[j] * t.plant.fv[other]))
    truth = _plant(t, j, drag=drag, partner=other)
    return truth, {
        "viscous_Nms_per_rad": drag,
        "partner": r.joints[other],
        "law": "on each joint, times the other's dq",
    }


def _encoder_offset(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    offset = size * float(g.choice([-1.0, 1.0]))
    return _plant(t, j, encoder_offset=offset), {"reading_minus_truth_rad": offset}


def _eccentricity(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    phase = float(g.uniform(0, 2 * np.pi))
    return _plant(t, j, eccentricity=size, eccentricity_phase=phase), {"amplitude_rad": size, "phase_rad": phase}


def _coriolis(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    share = size * float(g.choice([-1.0, 1.0]))
    law = "the drives add this share of the Coriolis torque below the torque they report"
    return replace(t, unlogged_coriolis=np.full(r.n, share)), {"share": share, "law": law}


def _outside_bump(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    lo, hi = space_of(r).box[j]
    centre, width = float(lo + (hi - lo) * g.uniform(0.35, 0.65)), float(g.uniform(0.1, 0.18))
    said: Parameters = {"torque_Nm": size, "centre_rad": centre, "width_rad": width, "depends_on": f"q_{r.joints[j]}"}
    return _plant(t, j, bump=size, bump_centre=centre, bump_width=width), said


def _outside_walk(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    time = float(g.uniform(6, 15))
    truth = replace(t, wander=_entry(t.wander, j, size), wander_time=_entry(t.wander_time, j, time))
    return truth, {"sigma_Nm": size, "correlation_time_s": time, "depends_on": "nothing that is recorded"}


def _outside_resonance(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    speed = float(space_of(r).speed[j] * g.uniform(0.3, 0.7))
    said: Parameters = {"friction_Nm": size, "at_rad_per_s": speed, "depends_on": f"dq_{r.joints[j]}"}
    return _plant(t, j, resonance=size, resonance_speed=speed), said


def _outside_weave(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    other = neighbour(j, r.n)
    said: Parameters = {
        "coefficient_Nms_per_rad": size, "law": "sin(3 q) times the partner's dq", "partner": r.joints[other],
        "depends_on": f"q_{r.joints[j]}, dq_{r.joints[other]}",
    }  # fmt: skip
    return _plant(t, j, weave=size, partner=other), said


def _coulomb(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    fc = (1 + size) * float(t.plant.fc[j])
    return _plant(t, j, fc=fc), {"fc_Nm": fc}


def _viscous(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    fv = (1 + size) * float(t.plant.fv[j])
    return _plant(t, j, fv=fv), {"fv_Nms_per_rad": fv}


def _residual_gravity(t: Truth, r: Robot, j: int, size: float, g: np.random.Generator) -> tuple[Truth, Parameters]:
    law = "the drives show torque less Coulomb friction and less (1 - share) of the described gravity"
    return replace(t, left_gravity=_entry(t.left_gravity, j, size)), {"share": size, "law": law}


BASE = "every model fits plain friction itself: nothing is missing"
# by what an effect calls `Effect.simulated`
SEEN: dict[str, HiddenKind] = {
    "more dry friction": HiddenKind(_coulomb, 0.5, 0.5, fixed=BASE),
    "more drag": HiddenKind(_viscous, 0.5, 0.5, fixed=BASE),
    "gravity left": HiddenKind(_residual_gravity, 0.3, 0.3, where="loaded", fixed="compensated torque has no such residual"),
    "oil thinning with heat": HiddenKind(_thermal_viscous, 0.02, 0.06),
    "seals softening with heat": HiddenKind(_thermal_coulomb, 0.01, 0.04),
    "running in": HiddenKind(_warm_up, 0.15, 0.6),
    "film heated by losses": HiddenKind(_self_heating, 0.3, 2.0),
    "breakaway": HiddenKind(_stribeck, 0.2, 0.8, top=0.15),
    "tooth friction": HiddenKind(_load_coulomb, 0.05, 0.4, where="loaded"),
    "skew": HiddenKind(_asymmetric, 0.05, 0.6),
    "thinning with speed": HiddenKind(_cubic, 1.5, 25.0),
    "body on the last link": HiddenKind(_payload, 0.2, 8.0, scope="arm"),
    "heavier rotor": HiddenKind(_rotor, 0.3, 4.0),
    "soft gear": HiddenKind(_elasticity, 1.0, 60.0, where="loaded"),
    "cogging": HiddenKind(_ripple, 0.5, 8.0),
    "presliding": HiddenKind(_hysteresis, 0.003, 0.06),
    "drive gain": HiddenKind(_gain, 0.05, 0.5, where="loaded"),
    "late torque": HiddenKind(_delay, 0.01, 0.06),
    "slow drive": HiddenKind(_lag, 0.01, 0.02),
    "tilted base": HiddenKind(_tilt, 0.02, 0.25, scope="arm"),
    "dress pack": HiddenKind(_spring, 1.0, 40.0),
    "cable at its end": HiddenKind(_cable, 0.3, 10.0),
    "gas spring": HiddenKind(_counterbalance, 1.0, 80.0, where="loaded"),
    "square tooth friction": HiddenKind(_square_load, 0.002, 0.02, where="loaded"),
    "drag by the neighbour": HiddenKind(_coupling, 0.1, 0.9, joints=2, both=True),
    "shifted encoder": HiddenKind(_encoder_offset, 0.03, 0.4, where="loaded"),
    "eccentric encoder": HiddenKind(_eccentricity, 0.01, 0.02, where="loaded"),
    "unlogged feed-forward": HiddenKind(_coriolis, 0.5, 1.5, scope="arm"),
}
OUTSIDE: dict[str, HiddenKind] = {
    "outside_bump": HiddenKind(_outside_bump, 1.0, 30.0, outside=True),
    "outside_walk": HiddenKind(_outside_walk, 0.5, 15.0, outside=True),
    "outside_resonance": HiddenKind(_outside_resonance, 1.0, 15.0, outside=True),
    "outside_weave": HiddenKind(_outside_weave, 1.0, 30.0, joints=2, outside=True),
}


@cache
def kinds() -> MappingProxyType[str, HiddenKind]:
    """What can be hidden, by the names users type: effects of the catalogue that this arm can show, and causes that are in none."""
    ours = {e.name: SEEN[e.simulated] for e in catalogue().values() if e.simulated in SEEN}
    return MappingProxyType(ours | OUTSIDE)


def neighbour(joint: int, n: int) -> int:
    """The joint that shares a cable or a differential with ``joint``: the next one, or the one before the last."""
    return joint + 1 if joint + 1 < n else max(joint - 1, 0)


def healthy(plant: SimulatedPlant) -> Truth:
    """``plant`` with perfect instruments."""
    z = np.zeros(len(plant.fc))
    return Truth(plant, delay=z, unlogged_coriolis=z, run_in=z, wander=z, wander_time=np.ones_like(z), left_gravity=z)


def parse_hidden(words: Sequence[str], robot: Robot, rng: np.random.Generator) -> list[tuple[str, int | None]]:
    """``["stribeck:elbow", "payload"]`` -> effect names and joint numbers; where no joint is named, one is drawn.

    Raises `EffectError` for an unknown effect or joint, a joint where none belongs, or the same twice.
    """
    words = [w for w in words if w != "none"]
    out: list[tuple[str, int | None]] = []
    for word in words:
        name, _, joint = word.partition(":")
        if name not in kinds():
            raise EffectError(f"--hide {word}: no effect {name!r}; expected none or one of {', '.join(kinds())}")
        kind = kinds()[name]
        if joint and kind.scope == "arm":
            raise EffectError(f"--hide {word}: {name} belongs to the whole arm, not to a joint; write --hide {name}")
        if joint and joint not in robot.joints:
            raise EffectError(f"--hide {word}: {robot.name} has no joint {joint!r}; expected one of {', '.join(robot.joints)}")
        if robot.n < kind.joints:
            raise EffectError(f"--hide {word}: {robot.name} has one joint; {name} needs two")
        where = None if kind.scope == "arm" else robot.joints.index(joint) if joint else _draw(kind, robot, rng)
        if (name, where) in out:
            raise EffectError(f"--hide {word}: {name} is already hidden there; name every effect and joint once")
        out.append((name, where))
    return out


def _draw(kind: HiddenKind, robot: Robot, rng: np.random.Generator) -> int:
    strength = largest_gravity(robot) if kind.where == "loaded" else np.ones(robot.n)
    # joints of at least a third of the strongest have the effect in a measurable size
    return int(rng.choice(np.flatnonzero(strength >= strength.max() / 3)))
