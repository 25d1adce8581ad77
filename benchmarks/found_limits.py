"""Of drawn cases (`found_pairs.py`) that are answered without the hidden effect's name: what its own law, looked for alone, says there.

Two numbers decide whether recordings show an effect: its score, of which a claim needs `THRESHOLD`, and the share of the torque error on
motions that were not fitted that it takes away at its joint, of which a claim needs `LOWERED` (a free rigid body's effects need not).
Beside them the law of the highest score at that joint, which is another one where recordings do not tell the two apart.

    python benchmarks/found_limits.py ARM --seeds 109105 109147 [--weeks] [--healthy]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import found_pairs

from stopset.errors import RobotError
from stopset.offline.description import load_robot
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.scores import scores
from stopset.offline.diagnose.examination import examine
from stopset.offline.diagnose.question import question
from stopset.offline.diagnose.search.held_out import held_out
from stopset.offline.diagnose.search.predicts import judged
from stopset.offline.diagnose.search.refine import refined
from stopset.offline.diagnose.search.settled import refitted
from stopset.offline.diagnose.search.wanted import wanted


def said(path: str, seed: int, *, weeks: bool, healthy: bool) -> dict[str, Any]:
    """What the hidden effect's own law says in one case; ``healthy``: of the same arm and motions without it."""
    case = found_pairs.drawn(seed, load_robot(path).n)
    case = found_pairs.weeks_later(case, seed) if weeks else case
    robot, model, data, _ = found_pairs.made(path, replace(case, effect="") if healthy else case, seed)
    q = question(model, data)
    x = examine(q.robot, q.asked, q.fitted, q.before, names=[case.effect])
    joint, now = found_pairs.joint_of(robot, case.place), x.already
    everyone = now.engine.add_all(wanted(now.engine))
    hyper, _ = now.fit()
    asked = scores(now, everyone, hyper)
    here = [s for s in asked if case.place == "arm" or not s.candidate.joints or joint in s.candidate.joints]
    mine = [s for s in here if s.candidate.effect.name == case.effect]
    own = next(iter(refined(now, mine, hyper)), mine[0])
    fit = refitted(now, own, hyper)
    taken = judged(now, fit.candidate, held_out(now, hyper), held_out(fit.now, fit.hyper), fit.hyper, [])
    before, after = (float(e[joint]) for e in taken.stated)
    return {
        "case": case.name, "score": own.score, "of": limit.THRESHOLD, "before": before, "after": after,
        "shapes": dict(own.candidate.shapes), "theta": own.theta.tolist(), "highest": (here[0].candidate.effect.name, here[0].score),
        "noise": x.found.excess[joint], "why": taken.why,
    }  # fmt: skip


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("arm")
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--weeks", action="store_true", help="cases with what weeks and loggers add")
    parser.add_argument(
        "--healthy", action="store_true", help="the same without the effect: what its law says where it is not there"
    )
    args = parser.parse_args(argv)
    try:
        load_robot(args.arm)
    except RobotError as e:
        parser.error(str(e))
    for seed in args.seeds:
        a = said(args.arm, seed, weeks=args.weeks, healthy=args.healthy)
        name, most = a["highest"]
        print(
            f"{seed} {a['case']}: score {a['score']:.1f} of {a['of']:g}, held-out error {a['before']:.4g} -> {a['after']:.4g} N m "
            f"({1 - a['after'] / a['before']:.1%}); residual over noise {a['noise']:.2f}; highest there {name} {most:.0f}; {a['shapes']} "
            f"{[round(v, 5) for v in a['theta']]}",
            flush=True,
        )


if __name__ == "__main__":
    main()
