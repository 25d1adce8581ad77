"""Two wrist joints that share a motor: named whichever way their angles are counted, and only with numbers that one motor can have."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.offline.description import robot_from_text
from stopset.offline.diagnose import Diagnosis, diagnose
from stopset.offline.nominal.pair_choice import coupled
from stopset.recording import Recording, Recordings
from stopset.simulation import Scenario, prepare
from test_hidden_effects import ARM

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from as_found import PROGRAM, Trouble, recorded

LIFT, BEND = 1, 2
RATE, SEED = 125.0, 71


@pytest.fixture(scope="module")
def program() -> tuple[Scenario, Recordings]:
    """A healthy arm of three joints along a production program."""
    scenario = prepare(robot_from_text(ARM), ["none"], SEED, "short", cad="exact")
    return scenario, recorded(scenario, PROGRAM, RATE, Trouble(), SEED + 100)


def shared(data: Recordings, J: float, c: float, F: float, ratio: int) -> Recordings:
    """With the torque of a motor that turns with w = dq_lift + ratio dq_bend: J [kg m^2], c [N m s/rad], F [N m]; written out here."""

    def with_motor(r: Recording) -> Recording:
        w, tau = r.dq[:, LIFT] + ratio * r.dq[:, BEND], r.tau.copy()
        torque = J * np.gradient(w, r.t) + c * w + F * np.sign(w)
        tau[:, LIFT] += torque
        tau[:, BEND] += ratio * torque
        return replace(r, tau=tau)

    return replace(data, trials=tuple(with_motor(r) for r in data))


def asked(program: tuple[Scenario, Recordings], data: Recordings) -> Diagnosis:
    return diagnose(program[0].robot, data)


@pytest.mark.parametrize(("ratio", "name"), [(1, "coupled_wrist"), (-1, "opposed_wrist")])
def test_a_shared_motor_is_named_whichever_way_the_joints_are_counted(
    program: tuple[Scenario, Recordings], ratio: int, name: str
) -> None:
    """R-1510: with one joint's axis turned round the same wrist was a drag of -2.5 N m s/rad, more than half of its torque left over."""
    answer = asked(program, shared(program[1], 0.05, 1.0, 2.0, ratio))
    assert answer.verdict == "missing" and [r.label for r in answer.ranked] == [f"{name}:lift+bend"]
    said = answer.ranked[0].parameters
    for symbol, true in (("J", 0.05), ("c", 1.0), ("F", 2.0)):
        assert said[symbol].value == pytest.approx(true, rel=0.2)


@pytest.mark.parametrize(("J", "c"), [(-0.1, 1.0), (0.1, -1.0)])
def test_numbers_of_opposite_sign_are_no_motors(program: tuple[Scenario, Recordings], J: float, c: float) -> None:
    """R-1511: one ratio stands before inertia and both frictions, so all have its sign; such numbers were named, J of -0.094 +- 0.006."""
    data, trials = program[1], []
    for r in data:
        tau, w = r.tau.copy(), np.sign(r.dq[:, LIFT] + r.dq[:, BEND])
        for here, there in ((LIFT, BEND), (BEND, LIFT)):
            tau[:, here] += J * np.gradient(r.dq[:, there], r.t) + c * r.dq[:, there] + 2.0 * w
        trials.append(replace(r, tau=tau))
    answer = asked(program, replace(data, trials=tuple(trials)))
    assert not {r.effect for r in answer.ranked} & {"coupled_wrist", "opposed_wrist"}


@pytest.mark.parametrize(("ratio", "name"), [(1, "coupled_wrist"), (-1, "opposed_wrist")])
@pytest.mark.parametrize("F", [0.0, 6.0])
def test_identification_takes_one_law_of_a_pair(program: tuple[Scenario, Recordings], ratio: int, name: str, F: float) -> None:
    """R-1512: the one that its signs say, also where no dry friction tells the two apart."""
    robot, healthy = program[0].robot, program[1].trials
    assert coupled(robot, lambda: healthy, healthy) == ()
    trials = shared(program[1], 0.2, 4.0, F, ratio).trials
    (found,) = coupled(robot, lambda: trials, trials)
    assert found.name == f"{name}:lift+bend"
