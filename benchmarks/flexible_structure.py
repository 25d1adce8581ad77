"""Arms on a pedestal that rocks, and arms with a link that bends: what does the diagnosis name?

No joint has a part in it: a pedestal gives about two level axes at its foot, a link about an axis across it, half way along.  The
simulated arm has these as further joints, with a spring and no motor, and nothing of them is recorded.  Frequencies of 4 to 12 Hz with all
joints at 0.7 rad, damping of 2 to 5 %.  A gear that is named in such an arm is a false name, as is any other effect.  Beside them soft gears,
healthy arms and causes outside the catalogue, of which no structure may be told.

    python benchmarks/flexible_structure.py --seeds 8 [--arm URDF] [--kinds pedestal,link,gear,healthy,bump,walk]
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import dataclass, replace
from unittest.mock import patch

import numpy as np

from stopset.offline.description import load_robot
from stopset.offline.diagnose import Diagnosis, diagnose
from stopset.recording import Recordings
from stopset.robot import Robot
from stopset.robot.arm import standard_parameters
from stopset.robot.rigid import Chain, gravity_torque, mass_matrix
from stopset.simulation import arm as simulated
from stopset.simulation import cell as simulated_cell
from stopset.simulation import prepare
from stopset.simulation.plant import SimulatedPlant
from stopset.types import Array

FREQUENCY, DAMPING = (4.0, 12.0), (0.02, 0.05)  # [Hz]; of critical
POSE = 0.7  # [rad] of all joints
FOOT, PEDESTAL = (0.3, 0.8), (20.0, 60.0)  # [m] below the arm's base; [kg]
ENDS = {
    "spring": 0.0,
    "brake_rise": 1.0,
    "stribeck_speed": 1.0,
    "bump_width": 1.0,
    "resonance_speed": 1.0,
    "film_time": 1.0,
    "gain": 1.0,
    "limit": 1.0,
}


@dataclass(frozen=True)
class Structure:
    """Passive joints put into a chain before joint ``at``: their axes (k, 3); the arm's joint goes on ``rest`` [m] behind them.

    ``first`` [m]: the place of the first of them; ``body`` (10,) of the last one.
    """

    at: int
    axes: Array
    first: Array
    rest: Array
    body: Array
    frequency: float
    damping: float

    @property
    def passive(self) -> list[int]:
        return list(range(self.at, self.at + len(self.axes)))

    def chain(self, c: Chain) -> Chain:
        k, at = len(self.axes), self.at
        R = np.insert(c.R, [at] * k, np.eye(3), axis=0)
        p, axis = np.insert(c.p, [at] * k, 0.0, axis=0), np.insert(c.axis, [at] * k, self.axes, axis=0)
        p[at], p[at + k] = self.first, self.rest
        return Chain(R, p, axis, c.gravity)

    def bodies(self, pi: Array) -> Array:
        out = np.insert(pi, [self.at] * len(self.axes), 0.0, axis=0)
        out[self.passive[-1]] = self.body
        return out

    def wider(self, x: Array, value: float = 0.0) -> Array:
        """An array with a last axis of joints, with ``value`` for the passive ones."""
        return np.ascontiguousarray(np.insert(x, [self.at] * len(self.axes), value, axis=-1))


def pedestal(c: Chain, rng: np.random.Generator) -> Structure:
    foot, mass = rng.uniform(*FOOT), rng.uniform(*PEDESTAL)
    body = standard_parameters(mass, np.array([0.0, 0.0, 0.5 * foot]), np.eye(3) * mass * foot**2 / 12)
    return Structure(
        0, np.eye(3)[:2], np.zeros(3), c.p[0] + [0.0, 0.0, foot], body, rng.uniform(*FREQUENCY), rng.uniform(*DAMPING)
    )


def link(c: Chain, rng: np.random.Generator) -> Structure:
    """Of the longest link behind the first joint, across it."""
    at = 2 + int(np.argmax(np.linalg.norm(c.p[2:], axis=1)))
    across = np.cross(c.p[at], rng.normal(size=3))
    body = standard_parameters(0.1, np.zeros(3), np.eye(3) * 1e-4)
    axis = across[None] / np.linalg.norm(across)
    return Structure(at, axis, 0.5 * c.p[at], 0.5 * c.p[at], body, rng.uniform(*FREQUENCY), rng.uniform(*DAMPING))


def run(
    s: Structure, plant: SimulatedPlant, script: simulated.Script, state: simulated.ArmState, heating: Array, *rest: float
) -> tuple[Array, ...]:
    """`stopset.simulation.arm.run` of the arm with its structure; logs of its own joints."""
    chain, pi = s.chain(plant.chain), s.bodies(plant.pi)
    arrays = {name: s.wider(value, ENDS.get(name, 0.0)) for name, value in plant._asdict().items() if name not in ("chain", "pi")}
    q = s.wider(state.x[: len(plant.fc)])
    M = np.diag(mass_matrix(chain, pi, s.wider(np.full(len(plant.fc), POSE))))[
        s.passive
    ]  # one stiffness, whatever it begins with
    w = 2 * np.pi * s.frequency
    arrays["spring"][s.passive], arrays["fv"][s.passive] = w**2 * M, 2 * s.damping * w * M
    for _ in range(5):  # the structure carries the arm already
        q[s.passive] = -gravity_torque(chain, pi, q)[s.passive] / (w**2 * M)
    whole = SimulatedPlant(chain=chain, pi=pi, **arrays)
    wide = {
        name: s.wider(getattr(script, name)) for name in ("feedforward", "q", "dq", "kp", "kd", "q_noise", "dq_noise", "walk")
    }
    begun = simulated.start(whole, q, s.wider(state.v[: len(plant.fc)]), s.wider(state.temp, 30.0))
    begun.film[:] = s.wider(state.film)
    logs = simulated.run(whole, script._replace(**wide), begun, s.wider(heating), *rest)
    return tuple(np.delete(x, s.passive, axis=1) for x in logs)


def asked(robot: Robot, kind: str, seed: int) -> tuple[Structure, Diagnosis]:
    """What is said of the arm of a seed, described with rigid structure."""
    rng = np.random.default_rng(seed)
    s = STRUCTURES[kind](robot.chain, rng)
    return s, diagnosed(robot, s, seed)


def diagnosed(robot: Robot, s: Structure | None, seed: int, hide: str = "none") -> Diagnosis:
    """What is said of an arm on this structure, None: a rigid one, or with something hidden in it."""
    scenario = prepare(robot, [hide], seed, "short", cad="wrong" if seed % 2 else "exact")
    whole = simulated_cell.run if s is None else lambda plant, *rest: run(s, plant, *rest)
    with patch.object(simulated_cell, "run", whole):
        made = tuple(scenario.recordings())
    return diagnose(scenario.robot, Recordings(replace(scenario.meta, sources=()), made))


STRUCTURES = {"pedestal": pedestal, "link": link}
OTHERS = {"gear": "elasticity", "healthy": "none", "bump": "outside_bump", "walk": "outside_walk"}


def right(robot: Robot, kind: str, s: Structure | None, found: Diagnosis) -> str:
    """What becomes of an answer: named wrongly, told where it sits (first, or among others), told elsewhere, told where none is, or nothing."""
    told = found.structure
    if s is None:
        names = {r.effect for r in found.ranked}
        wrong = names - ({"elasticity"} if kind == "gear" else set())
        return "told where none is" if told else "named wrongly" if wrong else found.verdict
    if found.ranked:
        return "named wrongly"
    if told is None:
        return found.verdict
    where = "the base" if kind == "pedestal" else f"the link before {robot.joints[s.at]}"
    return "told" if told.may_sit_at[0] == where else "told among others" if where in told.may_sit_at else "told elsewhere"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arm", default="lwa4p")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--kinds", default="pedestal,link")
    args = parser.parse_args()
    robot, kinds = load_robot(args.arm), args.kinds.split(",")
    count: dict[str, Counter[str]] = {}
    for k in range(args.seeds):
        kind, seed = kinds[k % len(kinds)], args.seed + k
        start = time.process_time()
        if kind in STRUCTURES:
            s, found = asked(robot, kind, seed)
        else:
            s, found = None, diagnosed(robot, None, seed, OTHERS[kind])
        took, answer = time.process_time() - start, right(robot, kind, s, found)
        count.setdefault(kind, Counter())[answer] += 1
        of = "" if s is None else f" of {s.frequency:.1f} Hz"
        left = {j: x for j, x in found.excess.items() if x > 1.25}
        named, told = ", ".join(r.label for r in found.ranked) or "-", found.structure
        told_of = f"{' or '.join(told.may_sit_at)}, {told.hertz:.1f} Hz, {told.explains:.0%} of what is left" if told else "-"
        print(
            f"{seed}, {kind}{of}: {answer}; {found.verdict} {named}; structure {told_of}; left {left}; {took:.0f} s", flush=True
        )
    for kind, answers in count.items():
        print(f"{kind}: " + ", ".join(f"{answer} {n} of {answers.total()}" for answer, n in answers.most_common()))


if __name__ == "__main__":
    main()
