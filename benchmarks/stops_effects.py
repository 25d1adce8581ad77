"""Every effect hidden in a stopped arm: does every sampled stop stay in the tube of a model that holds the effect?

The arm is stopped by `stopset.simulation.stop`, which shares no line with the bound; the effect acts in it by its law at the
state the arm is in, its parameters, friction's drift, temperature, warmth and memory drawn at the ends of what the model
allows.  What counts is every sample of every stop, not where it ends.

    python benchmarks/stops_effects.py --states 40 --stops 50 [--effect spring] [--json out.json]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms import prbt_like

from stop_sampling import ANGLE_ERROR, SPEED_ERROR, tube_at
from stopset.artifact import Brakes, Model, load_model
from stopset.cli.main import main as cli
from stopset.effects.base import REFERENCE_TEMPERATURE, Effect, Fitted, Signals
from stopset.effects.registry import get
from stopset.effects.signals import Samples, arm_signals
from stopset.errors import NotCovered
from stopset.files import write_text
from stopset.offline.description import load_robot
from stopset.reach.stops import StopBounds
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Tube
from stopset.reach.stops.tubes import tubes_of
from stopset.recording import write_recordings
from stopset.robot.rigid import Chain, torques
from stopset.sets import Box
from stopset.simulation import prepare
from stopset.simulation.arm import Script, start
from stopset.simulation.arm import run as simulate
from stopset.simulation.scenario import Scenario
from stopset.simulation.stop import StoppingArm, simulate_stop
from stopset.types import Array
from synthetic import with_payload

PIECE, STEPS = 1e-3, 2  # [s] an effect's torque is held constant over a piece, of so many steps of the simulation
HELD = 4.0  # times as much as the stepping's own error: the torque of an effect is held over a piece
WARM, COLD = 20.0, -10.0  # [K] about the reference temperature
TOP = 1.26  # [rad/s]


def cases(joints: Sequence[str]) -> dict[str, tuple[Fitted, ...]]:
    """Effects large enough to matter on the PRBT-like arm, with small standard deviations; by name."""

    def one(effect: str, joint: int | str | None, share: float = 0.02, **values: float) -> Fitted:
        name = joints[joint] if isinstance(joint, int) else joint
        terms = [t.symbol for t in get(effect).terms]
        return Fitted(effect, name, values, {k: share * abs(values[k]) for k in terms})

    pair = f"{joints[2]}+{joints[3]}"
    out = {
        "asymmetric_coulomb": (one("asymmetric_coulomb", 2, F_o=-4.0),),
        "backlash": (one("backlash", 1, gap=9e-4),),
        "base_tilt": (one("base_tilt", None, roll=0.1, pitch=-0.05),),
        "coriolis": (one("coriolis", None, x=0.8),),
        "coulomb": (),
        "coupled_wrist": (one("coupled_wrist", f"{joints[4]}+{joints[5]}", J=0.1, c=0.5, F=1.0),),
        "coupling": (one("coupling", pair, c=4.0),),
        "cubic_viscous": (one("cubic_viscous", 1, v_3=-2.5),),
        "delay": (one("delay", 1, d=0.01),),
        "drive_lag": (one("drive_lag", 1, T=0.01),),
        "elasticity": (Fitted("elasticity", joints[1], {"share": 1.0, "K": 5e3, "D": 5.0}),),
        "encoder_eccentricity": (one("encoder_eccentricity", 1, a=0.015, b=-0.01),),
        "encoder_offset": (one("encoder_offset", 1, e=0.1),),
        "hysteresis": (one("hysteresis", 2, F_h=8.0, delta=0.01),),
        "load_coulomb": tuple(one("load_coulomb", j, k_lift=0.12, k_lower=0.06) for j in range(4)),
        "residual_gravity": (one("residual_gravity", 2, k_g=0.5), one("residual_gravity", 1, k_g=-0.2)),
        "rotor_inertia": (one("rotor_inertia", 1, dJ=0.5),),
        "self_heating": (one("self_heating", 1, k_v=-1.0, k_c=-4.0, tau_w=5.0),),
        "spring": (one("spring", 3, k=6.0, c=3.0),),
        "stribeck": (one("stribeck", 0, F_s=6.0, v_s=0.06),),
        "thermal_coulomb": (one("thermal_coulomb", 1, k_C=-0.3),),
        "thermal_viscous": (one("thermal_viscous", 1, k_T=-0.15, b=0.025),),
        "torque_gain": (one("torque_gain", 1, e=0.2),),
        "torque_ripple": (one("torque_ripple", 2, a=3.0, b=-3.0, n=40.0),),
        "viscous": (),
        "quadratic_load": tuple(one("quadratic_load", j, k_2=0.004) for j in range(4)),
        "cable": (one("cable", 3, k=3.0, k_2=-1.0, k_3=2.0, c=1.0),),
        "counterbalance": (one("counterbalance", 1, k_b=10.0, P=-25.0, q_0=2.0, r=0.4),),
        "warm_up": (one("warm_up", 1, k_v=-2.0, k_c=-6.0),),
        "opposed_wrist": (one("opposed_wrist", f"{joints[4]}+{joints[5]}", J=0.1, c=0.5, F=1.0),),
        "payload": (one("payload", None, m=2.0, mx=0.0, my=0.0, mz=0.2, Ixx=0.02, Ixy=0.0, Iyy=0.02, Ixz=0.0, Iyz=0.0, Izz=0.0),),
    }
    out["base_tilt + load_coulomb + stribeck"] = out["base_tilt"] + out["load_coulomb"] + out["stribeck"]
    out["spring + coupling + thermal_coulomb + hysteresis"] = (
        out["spring"] + out["coupling"] + out["thermal_coulomb"] + out["hysteresis"]
    )
    return out


def hiding(effects: Sequence[Fitted]) -> Model:
    """The PRBT-like arm with ``effects``, its brakes and disturbance known well, so that the effects are what matters."""
    arm = prbt_like((0.0, 1.0), TOP)
    torque, late = arm.brakes.torque.centre, np.full(arm.n, 0.02)  # type: ignore[union-attr]
    sharp = Brakes(Box.of(0.97 * torque, 1.03 * torque), Box.of(0.95 * late, late), Box.of(0.95 * late, late), "assumed")
    pi = arm.robot.pi.copy()
    for f in effects:
        if f.effect == "payload":  # the model's body holds what it was identified with
            pi[-1] += [f.values[t.symbol] for t in get("payload").terms]
    own = replace(arm.powered, U=Box.symmetric([0.3, 0.3, 0.3, 0.1, 0.1, 0.1]))
    temp = Box.of(np.full(arm.n, REFERENCE_TEMPERATURE + COLD), np.full(arm.n, REFERENCE_TEMPERATURE + WARM))
    domain = replace(arm.domain, q=Box.symmetric(np.full(arm.n, 2.5)), temp=temp)
    friction = tuple(replace(f, std={k: 0.03 * v for k, v in f.values.items()}) for f in arm.effects)
    return replace(
        arm, robot=arm.robot.with_parameters(pi), brakes=sharp, domain=domain, sets={"powered": own}, effects=(*friction, *effects)
    )  # fmt: skip


@dataclass(frozen=True)
class Batch:
    """``N`` stopped arms, each its own: true start, body, brakes, disturbance, friction's drift, and what the laws are given."""

    q: Array
    dq: Array
    pi: Array
    brake: Array
    delay: Array
    rise: Array
    u: Array  # (N, 4, n), each for a quarter of the stop
    drift: Array
    temp: Array
    warm: Array


def drawn(model: Model, q: Array, dq: Array, com: Array, rng: np.random.Generator) -> Batch:
    """Arms behind the measured states ``q, dq`` (N, n), at the ends of every interval; a third of the arms slow in everything."""
    N, n = q.shape
    brakes = model.brakes
    assert brakes is not None
    slow = np.where(rng.random((N, 1)) < 0.3, True, rng.random((N, n)) < 0.5)

    def end(box: Box, low: NDArray[np.bool_]) -> Array:
        return np.where(low, box.lo, box.hi)

    one = with_payload(model.robot, 1.0, com).pi - model.robot.pi
    load = rng.integers(0, 2, N)[:, None, None] * model.domain.payload[1]
    V = model.powered.V
    along = np.sign(dq) * np.where(slow, 1.0, -1.0)
    u = np.where(rng.random((N, 4, 1)) < 0.7, along[:, None, :], rng.choice([-1.0, 1.0], (N, 4, n))) > 0
    temp = np.where(rng.random((N, n)) < 0.5, COLD, WARM) + REFERENCE_TEMPERATURE
    return Batch(
        q + rng.choice([-1.0, 1.0], (N, n)) * V.radius[:n], dq + along * V.radius[n:], model.robot.pi + load * one,
        end(brakes.torque, slow), end(brakes.delay, ~slow), end(brakes.rise, ~slow), np.where(u, model.powered.U.hi, model.powered.U.lo),
        np.where(slow, 0.75, 1.25), temp, rng.integers(0, 2, N).astype(float),
    )  # fmt: skip


def _pieces(
    chain: Chain, pi: Array, rotor: Array, fc: Array, brake: Array, delay: Array, rise: Array, q: Array, dq: Array, u: Array
) -> None:
    for k in range(q.shape[0]):
        arm = StoppingArm(chain, pi[k], rotor, fc[k], np.zeros(q.shape[1]), brake[k], delay[k], rise[k])
        x, v = simulate_stop(arm, q[k], dq[k], PIECE / STEPS, STEPS, u[k : k + 1])
        q[k], dq[k] = x[STEPS], v[STEPS]


class Laws:
    """The effects of a model as they act on a batch: true parameters at the ends of their uncertainty, states that go along."""

    def __init__(self, model: Model, batch: Batch, rng: np.random.Generator) -> None:
        self.model, self.batch = model, batch
        N = len(batch.q)
        self.rows: list[tuple[Effect, int, int, dict[str, Array], list[Array]]] = []
        for f in model.effects:
            effect = get(f.effect)
            if effect.role in ("plant", "input", "reading"):
                continue
            ends = {k: v + 3.0 * f.std.get(k, 0.0) * rng.choice([-1.0, 1.0], N) for k, v in f.values.items()}
            if effect.role == "arm or drive":  # it may be the drive's own, and then the arm has nothing of it
                mine = rng.integers(0, 2, N)
                ends = {k: v * mine for k, v in ends.items()}
            for i in effect.acts_on(f.joint, model.joints):
                partner = next((j for j in effect.acts_on(f.joint, model.joints) if j != i), i)
                top = {"w": TOP}
                states = [rng.uniform(max(x.lo, -TOP), min(x.hi, top.get(x.symbol, 1.0)), N) for x in effect.states]
                self.rows.append((effect, i, partner, ends, states))
        whose = (np.flatnonzero(np.all(batch.pi == pi, axis=(1, 2))) for pi in np.unique(batch.pi, axis=0))
        self.alike = [(at, model.robot.with_parameters(batch.pi[at[0]]), [self._at(r[3], at) for r in self.rows]) for at in whose]

    @staticmethod
    def _at(values: dict[str, Array], at: Array) -> dict[str, Array]:
        return {k: np.asarray(v)[at] if np.ndim(v) else v for k, v in values.items()}

    def __call__(self, q: Array, dq: Array, ddq: Array, braked: Array) -> tuple[Array, Array]:
        """Dry friction (N, n) [N m] and torque on the arm (N, n) at a state; memories go on by one piece."""
        b = self.batch
        dry, push = np.zeros_like(q), np.zeros_like(q)
        rubs = np.zeros((2, *q.shape))  # friction against the motion, and against the other direction
        ahead_of = np.where(dq == 0.0, 1.0, np.sign(dq))
        for at, body, mine in self.alike:
            v, temp, warm = dq[at], b.temp[at], b.warm[at]
            signals = arm_signals(body, Samples(q[at], v, temp=temp))
            gear = torques(body.chain, body.pi, q[at], v, ddq[at]) + braked[at] * np.sign(v)
            for (effect, i, partner, _, states), values in zip(self.rows, mine, strict=True):
                load = gear[:, i] if effect.role == "friction" else signals[i].load
                s = replace(signals[i], warm=warm, dq_other=v[:, partner], memory=tuple(x[at] for x in states), load=load)
                direction = ahead_of[at, i]
                ahead, back = (self._torque(effect, s, w, values) for w in (direction, -direction))
                if effect.role == "friction":
                    rubs[0, at, i] += b.drift[at, i] * direction * ahead
                    rubs[1, at, i] -= b.drift[at, i] * direction * back
                else:
                    dry[at, i] += 0.5 * direction * (ahead - back)
                    push[at, i] -= 0.5 * (ahead + back)
                if states:
                    for x, rate in zip(states, effect.rates(replace(s, given_direction=direction), values), strict=True):
                        x[at] += PIECE * rate
        rubs = np.maximum(rubs, 0.0)  # in no direction does the friction of a joint as a whole drive it
        dry += 0.5 * (rubs[0] + rubs[1])
        push -= 0.5 * ahead_of * (rubs[0] - rubs[1])
        return np.maximum(dry, 0.0), push + np.where(dry < 0.0, -dry * np.sign(dq), 0.0) * self._drives()

    def _drives(self) -> float:
        """Friction as a whole takes energy; other effects may give it."""
        return float(any(e.role != "friction" for e, *_ in self.rows))

    @staticmethod
    def _torque(effect: Effect, s: Signals, direction: Array, values: dict[str, Array]) -> Array:
        return np.asarray(effect.torque(replace(s, given_direction=direction, dq=np.abs(s.dq) * direction), values))


def escapes(
    model: Model, tubes: Sequence[Tube], q: Array, dq: Array, batch: Batch, owner: Array, rng: np.random.Generator
) -> tuple[int, float]:
    """How many arms of ``batch`` leave the tube of their state (``owner``: its number) at any sample; and the worst by how much."""
    laws, chain, n = Laws(model, batch, rng), model.robot.chain, q.shape[1]
    here, v, a = batch.q.copy(), batch.dq.copy(), np.zeros_like(batch.q)
    longest = max(float(t.t[-1]) for t in tubes)
    count = int(np.ceil(longest / PIECE)) + 1
    times = PIECE * np.arange(count + 1)
    bounds = [np.stack(tube_at(t, np.minimum(times, t.t[-1]))) for t in tubes]
    out, worst = np.zeros(len(here), bool), 0.0
    for k in range(count + 1):
        for j, b in enumerate(bounds):
            mine = owner == j
            d = here[mine] - batch.q[mine]
            beyond = np.max([d - b[1, k] - HELD * ANGLE_ERROR, b[0, k] - d - HELD * ANGLE_ERROR], axis=0)
            quick = np.max([v[mine] - b[3, k] - HELD * SPEED_ERROR, b[2, k] - v[mine] - HELD * SPEED_ERROR], axis=0)
            worst = max(worst, float(np.max(beyond)), float(np.max(quick)))
            out[mine] |= np.any((beyond > 0.0) | (quick > 0.0), axis=1)
        share = np.clip((k * PIECE - batch.delay) / batch.rise, 0.0, 1.0)
        dry, push = laws(here, v, a, share * batch.brake)
        u = batch.u[:, min(4 * k // (count + 1), 3)] + push
        before = v.copy()
        _pieces(chain, batch.pi, model.rotor, dry, batch.brake, batch.delay - k * PIECE, batch.rise, here, v, u)
        a = (v - before) / PIECE
    assert here.shape[1] == n
    return int(out.sum()), worst


def run(effects: Sequence[Fitted], states: int, stops: int, seed: int, blind: bool = False) -> dict[str, Any]:
    """Stops of an arm that has ``effects``, against the bounds of a model that knows them, or is ``blind`` to them."""
    model, rng = hiding(effects), np.random.default_rng(seed)
    n = model.n
    bounds = StopBounds.of(hiding(()) if blind else model, (0.0, model.domain.payload[1]))
    s = bounds.setting
    assert s is not None
    tubes, qs, vs = [], [], []
    for _ in range(states):
        q, dq = rng.uniform(-2.3, 2.3, n), rng.uniform(-TOP, TOP, n) * rng.choice([1.0, 0.1], n, p=[0.8, 0.2])
        start = s.start
        tube = tubes_of(s, Start(q + start.centre[:n], dq + start.centre[n:], start.radius[:n], start.radius[n:]), 1)[-1]
        if tube.end == OK:
            tubes.append(tube)
            qs.append(q)
            vs.append(dq)
    owner = np.repeat(np.arange(len(tubes)), stops)
    q, dq = np.repeat(qs, stops, axis=0), np.repeat(vs, stops, axis=0)
    batch = drawn(model, q, dq, s.payload_com, rng)
    wrong, share = misread_by(model, batch.q, rng)
    batch = replace(batch, q=batch.q + wrong, dq=batch.dq * (1.0 + share))
    left, worst = escapes(model, tubes, q, dq, batch, owner, rng)
    return {"states": states, "certified": len(tubes), "stops": len(owner), "escapes": left, "excess": worst}


def misread_by(model: Model, q: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """True less recorded position, and speed per speed, of arms whose encoders read ``q``."""
    out = np.zeros_like(q), np.zeros_like(q)
    for f in model.effects:
        effect = get(f.effect)
        if effect.role == "reading" and effect.reading is not None:
            i = model.joints.index(str(f.joint))
            columns = effect.reading(Signals(q=q[:, i]), {})
            for total, each in zip(out, columns, strict=True):
                for term, c in zip(effect.terms, each, strict=True):
                    total[:, i] += c * (f.values[term.symbol] + f.std[term.symbol] * rng.uniform(-3, 3))
    return out


# what is really identified from simulated recordings, by the simulator's own laws, and then stopped
HIDDEN: tuple[tuple[str, ...], ...] = (
    ("base_tilt",), ("payload",), ("spring:turn",), ("load_coulomb",), ("asymmetric_coulomb",), ("torque_ripple",), ("coupling",),
    ("base_tilt", "load_coulomb"),
)  # fmt: skip


def identified(hide: Sequence[str], urdf: Path, folder: Path, seed: int = 1) -> tuple[Model, Scenario]:
    """A model from recordings of the simulated arm in which ``hide`` was hidden, told which effects to look for; its brakes are
    those of the truth within 3 %."""
    scenario = prepare(load_robot(urdf), list(hide), seed, "short", "easy", "exact")
    data, out = folder / "recording.parquet", folder / "m.model.json"
    write_recordings(data, scenario.meta, scenario.recordings())
    write_text(folder / "robot.urdf", scenario.robot.urdf)
    write_text(folder / "robot.json", scenario.datasheet)
    found = ["--effects", ",".join(e["effect"] + (f":{e['joint']}" if e["joint"] else "") for e in scenario.truth["effects"])]
    assert cli(["identify", "--robot", str(folder / "robot.urdf"), "--data", str(data), "--out", str(out), *found]) == 0
    model, p = load_model(out), scenario.cell.truth.plant

    def near(x: Array) -> Box:
        return Box.of(0.97 * x, 1.03 * x)

    return replace(model, brakes=Brakes(near(p.brake_torque), near(p.brake_delay), near(p.brake_rise))), scenario


def stopped(model: Model, scenario: Scenario, states: int, seed: int) -> dict[str, Any]:
    """Stops of the simulated arm, whatever is hidden in it, against the bounds of ``model``."""
    s, rng, n = StopBounds.of(model).setting, np.random.default_rng(seed), model.n
    assert s is not None
    truth, d, start_box = scenario.cell.truth.plant, model.domain, s.start
    none, escaped, certified, worst = np.zeros(n), 0, 0, 0.0
    for _ in range(states):
        q, dq = rng.uniform(d.q.lo, d.q.hi), rng.uniform(d.dq.lo, d.dq.hi)
        tube = tubes_of(
            s, Start(q + start_box.centre[:n], dq + start_box.centre[n:], start_box.radius[:n], start_box.radius[n:]), 4
        )[-1]
        if tube.end != OK:
            continue
        certified += 1
        plant = truth._replace(
            brake_torque=truth.brake_torque * rng.choice([0.97, 1.03], n), brake_delay=truth.brake_delay * rng.choice([0.97, 1.03], n),
            brake_rise=truth.brake_rise * rng.choice([0.97, 1.03], n),
        )  # fmt: skip
        K = int(np.ceil(tube.t[-1] / PIECE)) + 1
        zero = np.zeros((K, n))
        script = Script(PIECE, zero, zero, zero, none, none, 0, 0, zero, zero, 0.0, zero)
        temp = np.full(n, REFERENCE_TEMPERATURE) if d.temp is None else rng.choice([0.0, 1.0], n) * d.temp.width + d.temp.lo
        *_, link, speed = simulate(plant, script, start(plant, q, dq, temp), none, REFERENCE_TEMPERATURE, 0.0, 4)
        low, high, slow, fast = tube_at(tube, np.minimum(PIECE * np.arange(K), tube.t[-1]))
        moved = link - link[0]
        beyond = np.max([moved - high, low - moved], axis=0) - HELD * ANGLE_ERROR
        quick = np.max([speed - fast, slow - speed], axis=0) - HELD * SPEED_ERROR
        worst = max(worst, float(beyond.max()), float(quick.max()))
        escaped += bool(np.any(beyond > 0.0) or np.any(quick > 0.0))
    return {"states": states, "certified": certified, "escapes": escaped, "excess": worst}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=40)
    parser.add_argument("--stops", type=int, default=50, help="of each state")
    parser.add_argument("--effect", help="only this case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--blind", action="store_true", help="the bound does not know the effect: stops must leave it")
    parser.add_argument("--identify", type=Path, metavar="URDF", help="hide, identify and stop this arm instead")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    results: dict[str, Any] = {}
    for hide in HIDDEN if given.identify else ():
        with tempfile.TemporaryDirectory() as folder:
            results[" + ".join(hide)] = found = stopped(*identified(hide, given.identify, Path(folder)), given.states, given.seed)
        print(f"{hide}: {found}", flush=True)
    for name, effects in () if given.identify else cases(prbt_like().joints).items():
        if given.effect in (None, name):
            begun = time.process_time()
            try:
                results[name] = run(effects, given.states, given.stops, given.seed, given.blind)
            except NotCovered as e:
                results[name] = {"refused": str(e)}
            print(f"{name}: {results[name]} {time.process_time() - begun:.1f} s", flush=True)
    bound = [r for r in results.values() if "stops" in r]
    print(
        f"{sum(r['stops'] for r in bound)} stops, {sum(r['escapes'] for r in bound)} escapes, {len(results) - len(bound)} refused"
    )
    if given.json:
        given.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
