"""How often is something named that changed nothing: healthy arms whose model knows little, or whose friction no law explains.

    python benchmarks/healthy_again.py [--recording FILE.parquet --robot ROBOT.urdf]

*Half wrong*: identified from 8 s of slow motion beside a description whose second and third link are 1.5 and 0.6 times as heavy, then
another motion asked, with what the model left open of itself and without.  *Rough*: a production program of an arm with friction of 1 N m
that follows the pose, and the same again on other paths.  *Real*: of one day's motions of a real arm four identified, three others asked,
four draws of them and three questions each.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from as_found import ONE, PROGRAM, Trouble, recorded

from stopset.artifact import Model
from stopset.offline.campaign.source import Campaign
from stopset.offline.description import load_robot, robot_from_text
from stopset.offline.diagnose import Diagnosis, diagnose_model
from stopset.offline.diagnose.diagnose import answered
from stopset.offline.diagnose.examination import examine
from stopset.offline.diagnose.question import question
from stopset.offline.identify.pipeline import Settings, identified
from stopset.progress import silent
from stopset.recording import Recording, Recordings, read_recordings
from stopset.robot import Robot
from stopset.simulation import prepare

WRONG = (1.0, 1.5, 0.6)  # times as heavy as described
ROUGH = 1.0  # [N m]
MOVES = 0.2  # [rad] that some joint turns


def model_of(robot: Robot, first: Recordings) -> Model:
    """The model identified from these recordings."""
    return identified(robot, Campaign(first.meta, lambda: iter(first.trials)), Settings(), silent, None, (), None).model


def named(name: str, made: Recordings, change: Callable[[Recording], Recording] = lambda r: r) -> Recordings:
    """The recordings as a file of that ``name``, each with a ``change``."""
    return replace(made, meta=replace(made.meta, sources=((name, name),)), trials=tuple(map(change, made.trials)))


def half_wrong(text: str, seed: int) -> tuple[str, str]:
    """The answers with and without what the model left open of itself."""
    s = prepare(robot_from_text(text), ["none"], seed, "short", cad="wrong")
    wrong = s.robot.with_parameters(s.robot.pi * np.array(WRONG)[:, None])
    model = model_of(wrong, named("first", recorded(s, (8.0,), 100.0, Trouble(speed=0.3), seed + 100)))
    asked = question(model, named("later", recorded(s, ONE, 100.0, Trouble(), seed + 200)))
    assert asked.known is not None
    without = replace(asked.before, known=replace(asked.known, left_open=np.zeros((0, 0))))
    both = (answered(examine(asked.robot, asked.asked, asked.fitted, before)) for before in (asked.before, without))
    first, second = (said(found) for found in both)
    return first, second


def rough(text: str, seed: int) -> str:
    """The answer to a program run again."""
    s = prepare(robot_from_text(text), ["none"], seed, "short", cad="wrong")

    def rubbed(r: Recording) -> Recording:
        return replace(r, tau=r.tau + ROUGH * np.tanh(r.dq / 0.05) * np.sin(3 * np.roll(r.q, -1, axis=1) + 2 * r.q))

    first, later = (named(f"{k}", recorded(s, PROGRAM, 100.0, Trouble(), seed + k), rubbed) for k in (100, 200))
    return said(diagnose_model(model_of(s.robot, first), later)[0])


def real(robot: Robot, day: Recordings, draws: int = 4) -> list[str]:
    """The answers to motions of one day against models of four others."""
    good, out = [k for k, r in enumerate(day.trials) if np.ptp(r.q, axis=0).max() > MOVES], []

    def of(name: str, motions: Sequence[int]) -> Recordings:
        return named(name, replace(day, trials=tuple(day.trials[k] for k in motions)))

    for draw in range(draws):
        rng = np.random.default_rng(draw)
        first = [int(k) for k in rng.choice(good, size=4, replace=False)]
        rest = [k for k in good if k not in first]
        rng.shuffle(rest)
        model = model_of(robot, of("first", first))
        out += [said(diagnose_model(model, of("later", rest[3 * g : 3 * g + 3]))[0]) for g in range(3)]
    return out


def said(found: Diagnosis) -> str:
    """The answer in short."""
    return " ".join([found.verdict, *(r.label for r in found.ranked)])


def main() -> None:
    import sys
    from pathlib import Path

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recording", type=Path)
    parser.add_argument("--robot", type=Path)
    args = parser.parse_args()
    for path in (args.recording, args.robot):
        if path is not None and not path.is_file():
            parser.error(f"{path}: no such file; expected a recording and the arm's URDF")
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
    from test_hidden_effects import ARM

    pairs = [half_wrong(ARM, seed) for seed in range(1, 9)]
    for title, k in (("half wrong, with what was left open", 0), ("half wrong, without", 1)):
        print(f"{title}: {dict(Counter(p[k] for p in pairs))}", flush=True)
    print(f"rough: {dict(Counter(rough(ARM, seed) for seed in range(1, 13)))}", flush=True)
    if args.recording and args.robot:
        robot = load_robot(args.robot)
        print(f"real: {dict(Counter(real(robot, read_recordings([args.recording], robot))))}")


if __name__ == "__main__":
    main()
