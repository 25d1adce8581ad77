"""How often the diagnosis is right on data sets of an independent simulator that nothing was set on.

ARMS holds folders with ``robot.urdf`` and ``robot.json``: templates of which every set gets a random relative, often of other
size or with a joint more.  Every effect of `independent_effects` is hidden, easy (residual of its joint threefold) and hard
(1.4-fold), beside healthy sets, causes outside the catalogue and pairs.  ``--seed`` decides everything.  Sets that are made and
answers that are there stay: `make` and `ask` go on where they were ended (answers of other code want another folder).

    python benchmarks/diagnosis_unseen.py make ARMS SETS --seed 20000 --rounds 1 --healthy 8 --outside 8 --pairs 5
    python benchmarks/diagnosis_unseen.py ask SETS --out ANSWERS
    python benchmarks/diagnosis_unseen.py rate SETS ANSWERS
    python benchmarks/diagnosis_unseen.py wander SETS     (what healthy joints leave in half-second sums)
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from diagnosis_labelled import right
from independent_arm import Arm, read_arm
from independent_effects import EFFECTS, OTHER_LAWS
from independent_outside import OUTSIDE
from independent_sets import Truth, random_truth, write_set
from independent_sizing import RATIO, hide
from scipy.stats import beta

from stopset.files import write_text
from stopset.offline.description import load_robot
from stopset.offline.diagnose import diagnose
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hypothesis
from stopset.offline.diagnose.explain.residual import slow_excess
from stopset.recording import read_recordings

ENOUGH = {"easy": 2.0, "hard": 1.25}  # ratio below which another joint is drawn: there the effect can't be made that large
CHANCES = 6
KINDS = EFFECTS | OTHER_LAWS | OUTSIDE
OTHER_ARM = 0.4  # share of sets whose arm is no near relative of a template


class NoTraceError(Exception):
    """An effect that can't be made large enough to be hidden in this arm: a planar arm's tilt is its first encoder's offset."""


def templates(folder: Path) -> list[Arm]:
    """One arm of each name in ``folder``."""
    arms = {a.name: a for f in sorted(folder.iterdir()) if (f / "robot.urdf").exists() for a in [read_arm(f)]}
    return list(arms.values())


def make(arms: Sequence[Arm], wanted: Sequence[tuple[str, str]], seed: int, folder: Path) -> dict[str, Any]:
    """One set with the ``wanted`` (effect, level) hidden in one arm; its label."""
    rng = np.random.default_rng([seed, 0])
    weights = np.array([3.0 if a.n > 2 else 1.0 for a in arms])
    healthy = random_truth(arms[rng.choice(len(arms), p=weights / weights.sum())], seed, bool(rng.random() < OTHER_ARM))
    truth, effects, free = healthy, [], list(range(healthy.arm.n))
    for name, level in wanted:
        kind = KINDS[name]
        count = 2 if not kind.whole_arm and not kind.pair and len(wanted) == 1 and name in EFFECTS and rng.random() < 0.25 else 1
        for _ in range(count):
            best: tuple[float, float, int, Truth] | None = None
            for _chance in range(CHANCES):
                joint = int(rng.choice([j for j in free if not kind.pair or j + 1 in free] or free))
                joint = min(joint, healthy.arm.n - 2) if kind.pair else joint
                made, size, ratio = hide(truth, kind, joint, level, rng.random(4))
                if best is None or ratio > best[0]:
                    best = (ratio, size, joint, made)
                if ratio > ENOUGH[level]:
                    break
            if best is None or best[0] < ENOUGH["hard"]:
                raise NoTraceError(f"{name} leaves no trace at any joint drawn")
            ratio, size, joint, truth = best
            at = [joint, joint + 1] if kind.pair else [joint]
            free = [j for j in free if j not in at]
            names = [] if kind.whole_arm else [healthy.arm.joints[j] for j in at]
            effect, _, law = name.partition("~")
            effects.append({"effect": effect, "law": law, "joints": names, "level": level, "size": size, "ratio": ratio})
    write_set(truth, folder)
    outside = any(e["effect"] in OUTSIDE for e in effects)
    merged: list[dict[str, Any]] = []
    for e in effects:
        same = [m for m in merged if m["effect"] == e["effect"]]
        if same:
            same[0]["joints"] += e["joints"]
            same[0]["ratio"] = min(same[0]["ratio"], e["ratio"])
        else:
            merged.append(e)
    return {
        "verdict": "unknown" if outside else "missing" if effects else "none", "effects": merged, "seed": seed,
        "arm": healthy.arm.name, "exact": healthy.described is healthy.arm,
    }  # fmt: skip


def made(arms: Sequence[Arm], wanted: Sequence[tuple[str, str]], seed: int, folder: Path) -> dict[str, Any]:
    """`make`, on another arm and, for a pair, with others of the easy effects, as long as one leaves no trace."""
    rng = np.random.default_rng([seed, 7])
    for attempt in range(20):
        try:
            return make(arms, wanted, seed + 1000 * attempt, folder)
        except NoTraceError:
            if len(wanted) > 1:
                wanted = [(str(name), "easy") for name in rng.choice(list(EFFECTS), len(wanted), replace=False)]
    raise NoTraceError(f"{wanted} leaves no trace in any of 20 arms")


def cases(
    rounds: int,
    healthy: int,
    outside: int,
    pairs: int,
    seed: int,
    walks: int = 0,
    others: int = 0,
    level: str = "easy",
    each: int = 0,
) -> list[list[tuple[str, str]]]:
    """What each set hides; ``each``: every effect so often, easy or hard by chance; ``level``: of causes outside the catalogue."""
    rng = np.random.default_rng([seed, 9])
    out = [[(name, level)] for _ in range(rounds) for level in RATIO for name in EFFECTS]
    out += [[(name, str(rng.choice(list(RATIO))))] for _ in range(each) for name in EFFECTS]
    out += [[] for _ in range(healthy)]
    out += [[(list(OUTSIDE)[k % len(OUTSIDE)], level)] for k in range(outside)]
    for _ in range(pairs):
        a, b = rng.choice(list(EFFECTS), 2, replace=False)
        out.append([(str(a), "easy"), (str(b), "easy")])
    out += [[("walk", "hard")]] * walks
    return out + [
        [(list(OTHER_LAWS)[k % len(OTHER_LAWS)], "hard" if k // len(OTHER_LAWS) % 2 else "easy")] for k in range(others)
    ]


def interval(good: int, of: int) -> tuple[float, float]:
    """Clopper and Pearson's 95 % interval of a rate."""
    lo = float(beta.ppf(0.025, good, of - good + 1)) if good else 0.0
    return lo, float(beta.ppf(0.975, good + 1, of - good)) if good < of else 1.0


def kind_of(label: dict[str, Any]) -> str:
    """What a set counts as in the table."""
    if label["verdict"] != "missing":
        return "healthy" if label["verdict"] == "none" else f"outside the catalogue, {label['effects'][0]['level']}"
    first = label["effects"][0]
    return "pair" if len(label["effects"]) > 1 else f"{first['level']}{', another law' if first.get('law') else ''}"


def ask(folder: Path, out: Path, only: Sequence[str]) -> None:
    """Diagnose the sets of ``folder``, write one answer each, and print the rates of all answers."""
    labels = json.loads((folder / "labels.json").read_text())
    out.mkdir(parents=True, exist_ok=True)
    for name, label in sorted(labels.items()):
        if (only and name not in only) or (out / f"{name}.json").exists():
            continue
        robot = load_robot(folder / name / "robot.urdf")
        start = time.process_time()
        found = diagnose(robot, read_recordings(folder / name / "recording.parquet", robot))
        true = " ".join(f"{e['effect']}:{'+'.join(e['joints'])} {e['level']} x{e['ratio']:.2f}" for e in label["effects"])
        words = ", ".join(f"{r.label} {r.score:.0f}" for r in (found.ranked or found.claims)) or "-"
        spent = time.process_time() - start
        print(f"{name} [{true}] {found.verdict}: {words} {list(found.depends_on)} {spent:.1f} s", flush=True)
        write_text(out / f"{name}.json", json.dumps(found.as_json()))
    rate(folder, out)


def rate(folder: Path, answers: Path) -> None:
    """Rates of the answers that are there, and what the wrong ones said.

    *first*: the first entry is a true effect at a true joint; *all*: every true effect among the first entries, one more for
    each further joint (as `diagnosis_labelled` counts).
    """
    labels = json.loads((folder / "labels.json").read_text())
    count: dict[str, list[bool]] = {}
    for name, label in sorted(labels.items()):
        if not (answers / f"{name}.json").exists():
            continue
        answer = json.loads((answers / f"{name}.json").read_text())
        ranked = [(e["effect"], _places(e["joint"])) for e in answer["ranked_effects"]]
        kind, ok = kind_of(label), right(label, answer["verdict"], ranked)
        count.setdefault(f"{kind}, all", []).append(ok)
        if label["verdict"] == "missing":
            first = answer["verdict"] == "missing" and any(
                (e, bool(set(at) & set(x["joints"])) or not x["joints"]) == (x["effect"], True)
                for e, at in ranked[:1] for x in label["effects"]
            )  # fmt: skip
            count.setdefault(f"{kind}, first", []).append(first)
            ok = ok and first
        if not ok:
            hidden = ", ".join(f"{e['effect']}:{'+'.join(e['joints'])} x{e['ratio']:.2f}" for e in label["effects"])
            print(f"{name}: hidden {hidden or 'nothing'}; said {answer['verdict']} {ranked}")
    for kind, values in sorted(count.items()):
        lo, hi = interval(sum(values), len(values))
        print(f"{kind}: {sum(values)} of {len(values)} right (95 % interval {lo:.2f} to {hi:.2f})")


def _places(joint: str | list[str] | None) -> tuple[str, ...]:
    return () if joint is None else (joint,) if isinstance(joint, str) else tuple(joint)


def wander(folder: Path) -> None:
    """Leftover variance, and that of its half-second sums, at every joint of the healthy sets and of those with a walk."""
    labels = json.loads((folder / "labels.json").read_text())
    for name, label in sorted(labels.items()):
        walks = [e for e in label["effects"] if e["effect"] == "walk"]
        if label["effects"] and not walks:
            continue
        robot = load_robot(folder / name / "robot.urdf")
        now = Hypothesis(Engine.build(robot, read_recordings(folder / name / "recording.parquet", robot)))
        hyper, p = now.fit()
        joints = range(now.engine.data.n)
        slow = [round(slow_excess(now, p.theta, hyper, j), 2) for j in joints]
        rows = [round(now.excess(j, p.theta, hyper.sigma[j], 1.0), 2) for j in joints]
        true = " ".join(f"walk at {'+'.join(e['joints'])} {e['level']} x{e['ratio']:.2f}" for e in walks) or "healthy"
        print(f"{name} {label['arm']} {true}: half-second sums {slow}, rows {rows}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    m = commands.add_parser("make")
    m.add_argument("arms", type=Path)
    m.add_argument("sets", type=Path)
    m.add_argument("--seed", type=int, default=10000)
    for name, default in (("rounds", 1), ("healthy", 8), ("outside", 8), ("pairs", 5), ("walks", 0), ("others", 0), ("each", 0)):
        m.add_argument(f"--{name}", type=int, default=default)
    m.add_argument("--level", choices=tuple(RATIO), default="easy", help="of the causes outside the catalogue")
    a = commands.add_parser("ask")
    a.add_argument("sets", type=Path)
    a.add_argument("--out", type=Path, required=True)
    a.add_argument("--only", default="", help="comma-separated names of sets")
    r = commands.add_parser("rate")
    r.add_argument("sets", type=Path)
    r.add_argument("answers", type=Path)
    w = commands.add_parser("wander")
    w.add_argument("sets", type=Path)
    args = parser.parse_args()
    if args.command == "rate":
        return rate(args.sets, args.answers)
    if args.command == "wander":
        return wander(args.sets)
    if args.command == "ask":
        return ask(args.sets, args.out, [x for x in args.only.split(",") if x])
    listed = args.sets / "labels.json"
    arms, labels = templates(args.arms), json.loads(listed.read_text()) if listed.exists() else {}
    chosen = cases(args.rounds, args.healthy, args.outside, args.pairs, args.seed, args.walks, args.others, args.level, args.each)
    for k, first in enumerate(chosen):
        name, start = f"s{k:03d}", time.process_time()
        if name in labels:
            continue
        labels[name] = made(arms, first, args.seed + k, args.sets / name)
        print(name, labels[name], f"{time.process_time() - start:.1f} s", flush=True)
        write_text(listed, json.dumps(labels, indent=1))
    return None


if __name__ == "__main__":
    main()
