"""A campaign to order: which arm, what is hidden in it, how large, and the record of the truth."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stopset.errors import EffectError
from stopset.recording import Meta, Recording
from stopset.robot import Robot
from stopset.robot.arm import robot_of
from stopset.simulation.campaign import PLANS, Schedule, make
from stopset.simulation.cell import Cell, build_cell, wrong_cad
from stopset.simulation.compensated import PHASES, compensated
from stopset.simulation.hidden import BASE, Parameters, healthy, kinds, parse_hidden
from stopset.simulation.plant import healthy_plant, rotor_inertia
from stopset.simulation.sizing import RATIOS, Sized, closed_loop, inject, residual_rms, size_effect

CADS = ("exact", "wrong")


@dataclass(frozen=True, slots=True)
class Scenario:
    """A cell ready to be measured; ``truth`` (JSON) tells what is hidden, ``robot`` is what the data sheet says."""

    robot: Robot
    cell: Cell
    plan: Schedule
    truth: dict[str, Any]

    @property
    def compensated(self) -> bool:
        """Whether the drives show compensated torque: what is hidden is in what they forget to take off."""
        return bool(self.cell.truth.left_gravity.any())

    @property
    def meta(self) -> Meta:
        return replace(self.cell.meta, effort="compensated_torque") if self.compensated else self.cell.meta

    @property
    def count(self) -> int:
        """Number of recordings."""
        return sum(n for phase, n in self.plan.counts.items() if phase in PHASES or not self.compensated)

    def recordings(self) -> Iterator[Recording]:
        """Make the recordings one after the other, the same ones every time."""
        if not self.compensated:
            return make(self.cell, self.plan)
        made = make(self.cell, self.plan, PHASES)
        return (compensated(r, self.cell.cad, self.cell.truth) for r in made)

    @property
    def datasheet(self) -> str:
        """Text of ``robot.json``: what is written beside the URDF."""
        return json.dumps(self.robot.datasheet, indent=1) + "\n"


def complete_robot(robot: Robot, seed: int) -> Robot:
    """``robot`` with a data sheet that leaves nothing open: gaps filled with what is assumed of the simulated drives."""
    plant = healthy_plant(robot, np.random.default_rng([seed, 1]))
    rotor = rotor_inertia(robot)
    rows: dict[str, dict[str, Any]] = {}
    given = robot.datasheet.get("joints", {})
    for i, joint in enumerate(robot.joints):
        row = dict(given.get(joint, {}))
        if not np.isfinite(robot.drives[i].rotor_inertia):
            row["reflected_motor_inertia_kgm2"] = round(float(rotor[i]), 6)
        row.setdefault("torque_limit_Nm", round(float(plant.limit[i]), 3))
        row.setdefault("brake_torque_nominal_Nm", round(float(plant.brake_torque[i]), 3))
        row.setdefault("brake_delay_s", [0.015, 0.025])
        row.setdefault("brake_rise_s", [0.015, 0.025])
        row.setdefault("brake_tolerance", 0.1)
        rows[joint] = row
    return robot_of(robot.arm, robot.urdf, {**robot.datasheet, "robot": robot.name, "joints": rows})


def prepare(
    robot: Robot, hide: Sequence[str] = (), seed: int = 1, plan: str = "compact", size: str = "easy", cad: str = "exact",
    *, link_encoder: bool = False,
) -> Scenario:  # fmt: skip
    """A campaign on ``robot`` with the effects ``hide`` (``"stribeck"``, ``"stribeck:joint"``, ``"none"``) in it.

    ``size``: ``easy`` raises the residual of the joint to about 3.2 times its floor, ``hard`` to 1.4 times; ``cad``:
    ``exact`` masses, or ``wrong`` by 2 to 5 %; ``link_encoder``: angles behind the gears are recorded, too.
    The same arguments give the same recordings.  Raises `EffectError`.
    """
    for name, value, allowed in (("plan", plan, PLANS), ("size", size, RATIOS), ("cad", cad, CADS)):
        if value not in allowed:
            raise EffectError(f"--{name} {value}: unknown; expected one of {', '.join(allowed)}")
    wanted = parse_hidden(hide, robot, np.random.default_rng([seed, 2]))
    robot = complete_robot(robot, seed)
    plant = healthy_plant(robot, np.random.default_rng([seed, 1]))
    if cad == "wrong":
        plant = plant._replace(pi=wrong_cad(robot, np.random.default_rng([seed, 3])))
    base = build_cell(robot, healthy(plant), seed)
    measured = Schedule()  # sizes do not depend on how much is measured in the end
    sound = closed_loop(base, measured)
    floor = residual_rms(base, sound)
    sized = [size_effect(base, measured, sound, effect, joint, RATIOS[size]) for effect, joint in wanted]
    cell, parameters = inject(base, [s.hidden for s in sized])
    asked = {"plan": plan, "size": size, "urdf_exact": cad == "exact"}
    truth = _truth(base, cell, sized, parameters, floor, asked)
    return Scenario(robot, replace(cell, link_encoder=link_encoder), PLANS[plan], truth)


def _truth(
    base: Cell, cell: Cell, sized: Sequence[Sized], parameters: Sequence[Parameters], floor: np.ndarray, asked: Mapping[str, Any]
) -> dict[str, Any]:
    """What is hidden, as ``truth.json`` says it; ``asked``: what the campaign was made for."""
    joints, plant = cell.cad.joints, cell.truth.plant
    outside = any(kinds()[s.hidden.effect].outside for s in sized)
    missing = any(kinds()[s.hidden.effect].fixed != BASE for s in sized)
    effects = []
    for s, said in zip(sized, parameters, strict=True):
        joint = None if s.hidden.joint is None else joints[s.hidden.joint]
        partner = said.get("partner")
        where = [j for j in (joint, partner if kinds()[s.hidden.effect].both else None) if j is not None]
        effects.append({
            "effect": s.hidden.effect, "joint": joint, "joints": where, "joint_scored": kinds()[s.hidden.effect].scope == "joint",
            "level": asked["size"], "ratio_wanted": round(s.wanted, 3), "ratio_achieved": round(s.ratio, 3),
            "ratios": dict(zip(joints, s.ratios.round(3).tolist(), strict=True)), "note": s.note,
            "params": {k: v if isinstance(v, str) else float(v) for k, v in said.items()},
        })  # fmt: skip
    return {
        "robot": cell.cad.name, "seed": cell.seed, **asked,
        "verdict": "unknown" if outside else "missing" if missing else "none",
        "effects": effects,
        "floor_rms_Nm": dict(zip(joints, floor.round(4).tolist(), strict=True)),
        "torque_noise_Nm": dict(zip(joints, cell.torque_noise.round(4).tolist(), strict=True)),
        "truth": {
            j: {
                "fc_Nm": float(base.truth.plant.fc[i]), "fv_Nms_per_rad": float(base.truth.plant.fv[i]),
                "rotor_inertia_kgm2": float(plant.rotor[i]), "brake_torque_Nm": float(plant.brake_torque[i]),
                "brake_delay_s": float(plant.brake_delay[i]), "brake_rise_s": float(plant.brake_rise[i]),
                "mass_kg": float(base.truth.plant.pi[i, 0]),
                "com_m": (base.truth.plant.pi[i, 1:4] / base.truth.plant.pi[i, 0]).tolist(),
            }
            for i, j in enumerate(joints)
        },
    }  # fmt: skip
