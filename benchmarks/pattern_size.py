"""How large a pattern claims leave beside what they took away: of laws whose form is a little off, and of impostors.

What `PATTERN_SIZE` of the diagnosis' thresholds stands between.  A three-joint arm hides a dress pack that stiffens by 15 % at 1 rad
(named *spring*, which is straight), and causes outside the catalogue, which some effect imitates.  One row per joint with claims: the
largest of its patterns by evidence, its variance over what the claims took away, its gain over their score, and the verdict.

    python benchmarks/pattern_size.py [--only CASE,...]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

from stopset.offline.description import load_robot
from stopset.offline.diagnose.examination import examine
from stopset.offline.diagnose.remainder import pattern_size, verdict_of
from stopset.recording import Recordings
from stopset.simulation import Scenario, prepare
from stopset.simulation.hidden import Hidden
from stopset.simulation.sizing import inject

ROBOT = "lwa4p"
STIFFENS, SEEDS = (1.5, 3.0, 8.0), (3, 4)  # [N m/rad] or, as the simulation says, in the joint's friction
OUTSIDE = ("outside_bump", "outside_resonance", "outside_weave")


def cases() -> Iterator[tuple[str, Scenario]]:
    """What is hidden, by name."""
    robot = load_robot(ROBOT)
    for size, seed in product(STIFFENS, SEEDS):
        scenario = prepare(robot, ["none"], seed, "short", cad="wrong" if seed % 2 else "exact")
        cell, _ = inject(scenario.cell, [Hidden("spring", 0, size)])
        yield f"stiffening spring {size:g} seed {seed}", replace(scenario, cell=cell)
    for effect, seed in product(OUTSIDE, SEEDS):
        yield f"{effect} seed {seed}", prepare(robot, [f"{effect}:{robot.joints[1]}"], seed, "short", "easy", "exact")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="cases whose name begins so, comma-separated")
    only = tuple(parser.parse_args().only.split(","))
    for name, scenario in cases():
        if not name.startswith(only):
            continue
        recordings = Recordings(replace(scenario.meta, sources=()), tuple(scenario.recordings()))
        x = examine(scenario.robot, recordings)
        for j, joint in enumerate(scenario.robot.joints):
            claims = [c for c in x.found.claims if not c.joints or j in c.joints]
            if claims and x.left.ranking[j]:
                rest, score = x.left.ranking[j][0], sum(c.score for c in claims)
                names = ", ".join(c.scored.candidate.effect.name for c in claims)
                size = pattern_size(rest, x.found, j)
                verdict = verdict_of(x.found, x.left)
                print(
                    f"{name}, {joint}: {names}; size {size:.2g}, gain {rest.gain:.0f} = {rest.gain / score:.2g} of the score; {verdict}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
