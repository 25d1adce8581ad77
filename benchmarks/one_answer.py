"""One answer: do `diagnose`, `add`, `identify --effects` and `diagnose --effects` say the same of one recording?

Cases are those of `found_pairs` (simulated arms as found, alone and in pairs) and folders of real recordings.  Each is identified
and diagnosed; then every effect that is named is added, one by one and all in the order they are named in, is asked of an
identification, and of a diagnosis of these names only.  What contradicts what the diagnosis said is counted:

- *refused*: `add` takes no effect that the diagnosis names; *refused at identification*: `identify --effects` refuses what `add` takes;
- *subset*: a diagnosis of these names only says something else of them;
- *numbers*: an effect's numbers differ by more than a part in a million; *errors*: its held-out error before and after does.

    python benchmarks/one_answer.py simulated ARMS... --out OUT [--seed 300] [--only CASE,...]
    python benchmarks/one_answer.py simulated ARMS... --out OUT --seed 300 --drawn 24         (as `found_pairs.py ask --drawn 24 --weeks`)
    python benchmarks/one_answer.py real FOLDERS... --out OUT        (robot.urdf, identification.parquet, others *.parquet)
    python benchmarks/one_answer.py count --out OUT

Of other recordings than the model's own an identification is not asked: it has no model to measure them against.
Answers are kept in OUT, so a run may be broken off and taken up again.
Levels that have changed since identification (friction, scale) are no effects to add: they are not asked.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from stopset.artifact import Model
from stopset.errors import StopsetError
from stopset.offline.campaign.source import Campaign
from stopset.offline.description import load_robot
from stopset.offline.diagnose import Diagnosis, Ranked, diagnose_model
from stopset.offline.identify.pipeline import Settings, identified
from stopset.offline.revise.revise import Revised, add
from stopset.recording import Recordings, read_recordings
from stopset.robot import Robot

SAME = 1e-6  # relative


def differs(a: Mapping[str, float], b: Mapping[str, float]) -> bool:
    """Whether two sets of numbers of one effect are not the same."""
    return set(a) != set(b) or any(abs(a[k] - b[k]) > SAME * max(abs(a[k]), abs(b[k])) for k in a)


def campaign(data: Recordings) -> Campaign:
    return Campaign(data.meta, lambda: iter(data.trials))


def contradictions(robot: Robot, model: Model, data: Recordings, own: bool, most: int | None = None) -> dict[str, Any]:
    """What was named, and every contradiction of it in words, by kind; ``most``: so many of the names are asked for one by one."""
    found = diagnose_model(model, data)[0]
    named = [r for r in found.ranked if r.change is None]
    said: list[tuple[str, str]] = []
    taken = [r for r in named[:most] if _added(model, data, _whole(r, named), said, errors=r is named[0])]
    if len(named) > 1:
        _added(model, data, named, said, errors=True)
    for r in taken if own else ():
        _identified(robot, data, r, said)
    if named:
        _asked_alone(model, data, named, found, said)
    return {
        "verdict": found.verdict, "named": [r.label for r in named], "gains": [1 - r.error_after / r.error_before for r in named],
        "numbers": [dict(r.fitted.values) for r in named], "contradictions": said,
    }  # fmt: skip


def _whole(r: Ranked, named: Sequence[Ranked]) -> list[Ranked]:
    """An effect with those that it is said to be added with, as the diagnosis orders them."""
    return [x for x in named if x is r or x.label in r.together]


def _added(model: Model, data: Recordings, named: Sequence[Ranked], said: list[tuple[str, str]], errors: bool) -> bool:
    """Add effects in order: whether all were taken; ``errors``: these are the errors that the diagnosis told, each beside those before it."""
    labels = " ".join(r.label for r in named)
    try:
        done: Revised = add(model, [r.label for r in named], campaign(data))
    except StopsetError as error:
        said.append(("refused", f"{labels}: {error}"))
        return False
    said += [("refused", f"{j.name} of {labels}: {j.why}") for j in done.judged if j.why]
    if done.model is None or any(j.why for j in done.judged):
        return False
    values = {f.label: dict(f.values) for f in done.model.effects}
    for r, j in zip(named, done.judged, strict=True):
        if differs(r.fitted.values, values.get(r.label, {})):
            said.append(("numbers", f"{r.label}: {dict(r.fitted.values)} named, {values.get(r.label)} added"))
        if errors and not _same_errors(r, j.before, j.after):
            said.append(("errors", f"{r.label}: {r.error_before:.6g} -> {r.error_after:.6g} named, not so when added"))
    return True


def _same_errors(r: Ranked, before: Mapping[str, float], after: Mapping[str, float]) -> bool:
    """Whether the errors before and after are those of some joint."""
    key = "held_out_torque_rmse" if r.unit == "N m" else "held_out_position_rmse"
    pairs = [(before[k], after[k]) for k in before if k.startswith(f"{key}:")]
    return any(not differs({"b": b, "a": a}, {"b": r.error_before, "a": r.error_after}) for b, a in pairs)


def _identified(robot: Robot, data: Recordings, r: Ranked, said: list[tuple[str, str]]) -> None:
    try:
        model = identified(robot, campaign(data), Settings(effects=(r.label,))).model
    except StopsetError as error:
        said.append(("refused at identification", f"{r.label}: {error}"))
        return
    values = {f.label: dict(f.values) for f in model.effects}
    if differs(r.fitted.values, values.get(r.label, {})):
        said.append(("numbers", f"{r.label}: {dict(r.fitted.values)} named, {values.get(r.label)} identified"))


def _asked_alone(model: Model, data: Recordings, named: Sequence[Ranked], whole: Diagnosis, said: list[tuple[str, str]]) -> None:
    alone = diagnose_model(model, data, list(dict.fromkeys(r.effect for r in named)))[0]
    if alone.verdict != whole.verdict:
        said.append(("subset", f"{whole.verdict}, asked alone {alone.verdict}"))
    got = {r.label: r for r in alone.ranked if r.change is None}
    for r in named:
        if r.label not in got or differs(
            {"score": r.score, **r.fitted.values}, {"score": got[r.label].score, **got[r.label].fitted.values}
        ):
            said.append(("subset", f"{r.label} is named otherwise, or not"))


def simulated(arm: str, name: str, seed: int) -> dict[str, Any]:
    """A case of `found_pairs`, by its name or drawn."""
    from found_pairs import called, made

    robot, model, data, pair = made(arm, called(name, arm, seed), seed)
    return contradictions(robot, model, data, own=not pair)


def real(folder: Path, shipped: str, most: int | None, out: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """A robot's own recording, then every other one against its model, but for those that ``out`` has; ``shipped``: the arm where
    the folder has no description."""
    urdf, paths = folder / "robot.urdf", sorted(folder.glob("*.parquet"))
    robot = load_robot(urdf if urdf.exists() else shipped)
    first = next((p for p in paths if p.stem == "identification"), paths[0])
    open_ones = [p for p in paths if not answer_file(out, folder, "own" if p == first else p.stem).exists()]
    if not open_ones:
        return
    own = read_recordings(first, robot)
    model = identified(robot, campaign(own), Settings()).model
    for path in open_ones:
        if path == first:
            yield "own", contradictions(robot, model, own, own=True, most=most)
        else:
            yield path.stem, contradictions(robot, model, read_recordings(path, robot), own=False, most=most)


def answer_file(out: Path, folder: Path, name: str) -> Path:
    """Where the answer to one recording of a folder is kept."""
    return out / f"{folder.name}_{name}.json"


def count(out: Path) -> None:
    """Every contradiction, and how many of each kind."""
    kinds, named, asked = Counter[str](), 0, 0
    for file in sorted(out.glob("*.json")):
        a = json.loads(file.read_text())
        asked, named = asked + 1, named + len(a.get("named", ()))
        print(f"{file.stem}: {a['verdict']} {a.get('named', '')}")
        for kind, words in a.get("contradictions", ()):
            kinds[kind] += 1
            print(f"    {kind}: {words}")
    print(f"{asked} recordings, {named} effects named, {sum(kinds.values())} contradictions: {dict(kinds)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("simulated", "real", "count"))
    parser.add_argument("where", nargs="*")
    parser.add_argument("--seed", type=int, default=300)
    parser.add_argument("--arm", default="lwa4p", help="shipped arm of a real folder without robot.urdf")
    parser.add_argument("--most", type=int, help="names of a real recording asked for one by one (default: all)")
    parser.add_argument("--only", default="", help="cases whose name begins so, comma-separated")
    parser.add_argument(
        "--drawn", type=int, default=0, help="so many cases drawn at random instead, with what weeks and loggers add"
    )
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    if args.command == "simulated":
        from found_pairs import CASES

        only = tuple(args.only.split(","))
        names = args.drawn * ["weeks"] or [c.name for c in CASES if c.name.startswith(only)]
        for k, name in enumerate(names):
            arm, seed = args.where[k % len(args.where)], args.seed + 7 * k
            file = args.out / f"{Path(arm).stem}_{seed}_{name.replace(' ', '_')}.json"
            if file.exists():
                continue
            try:
                answer = simulated(arm, name, seed)
            except StopsetError as error:
                answer = {"verdict": f"{type(error).__name__}: {error}"}
            file.write_text(json.dumps(answer, default=str))
            print(file.stem, answer["verdict"], answer.get("named"), answer.get("contradictions"), flush=True)
    elif args.command == "real":
        for folder in map(Path, args.where):
            for name, answer in real(folder, args.arm, args.most, args.out):
                answer_file(args.out, folder, name).write_text(json.dumps(answer, default=str))
                print(folder.name, name, answer["verdict"], answer.get("named"), answer.get("contradictions"), flush=True)
    count(args.out)


if __name__ == "__main__":
    main()
