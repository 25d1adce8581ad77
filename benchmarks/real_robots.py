"""Real robots as found: what inspect, identify, compare and diagnose make of recordings that nobody prepared.

    python benchmarks/real_robots.py FOLDER [--json FILE] [--markdown FILE]

FOLDER holds one folder per robot with a ``robot.urdf`` (and ``robot.json``, if there is one) and recordings ``*.parquet``; a file
``only.txt`` may hold options for ``stopset identify`` (``--tip LINK``, ``--lock J,K``, ``--robot NAME`` of a shipped arm).  A robot without
description is inspected only.  Nothing is fetched.  Robots that the JSON FILE has are not asked again, so a run may be broken off.

A robot with one recording is identified from the first 60 % of its time and judged on the rest; one with several from all but every
third recording.  The held-out error is that of the filtered torque over all samples at which the arm moves, summed over the joints:
of stopset at its first try, and of least squares on the same rows with base parameters, rotor inertia, Coulomb and viscous friction
and an offset per joint, without and with load-dependent and cubic friction.  Where identification finds that the torque was low-passed
before it was recorded, stopset's model passes that filter; least squares is given both ways.  Where the torque is compensated (there is
nothing to regress), even repetitions are fitted, odd ones judge, and the error is that of the position simulated from each trial's start
for 5 s, root of the mean square over the joints.  Coverage: how many blocks of 2.5 s of what was
not fitted leave the identified sets.

What `diagnose` names of the fitted part is added by `stopset add`, one after another: the error on what was not fitted, before and after
each, at its joints and of the whole arm, says what the name is worth.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stopset.artifact import Model, load_model
from stopset.offline.campaign.hold_out import blocks
from stopset.offline.compare.known import left_over
from stopset.offline.nominal import Preprocessing
from stopset.offline.nominal.preprocess import motions
from stopset.offline.nominal.unidentifiable import base_directions, parameter_scale
from stopset.recording import Recording, Recordings, read_recordings, write_recordings
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques, regressors

FITTED = 0.6  # of the time of a single recording
MOVING = 0.02  # [rad/s] the arm moves when some joint is faster
LOAD_AND_CUBIC = 2  # columns per joint beyond the plain law


def divided(recordings: Recordings) -> tuple[list[Recording], list[Recording]]:
    """What is fitted and what judges."""
    trials = [r for r in recordings if r.phase != "static" and np.ptp(r.q, axis=0).max() > MOVING]
    if recordings.meta.effort == "compensated_torque":
        return [r for r in trials if r.repetition % 2 == 0], [r for r in trials if r.repetition % 2 == 1]
    if len(trials) == 1:
        cut = round(FITTED * len(trials[0].t))
        return [trials[0].cut(0, cut)], [trials[0].cut(cut, len(trials[0].t))]
    return [r for k, r in enumerate(trials) if k % 3 != 2], [r for k, r in enumerate(trials) if k % 3 == 2]


Columns = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def rows(trials: Sequence[Recording], columns: Columns, cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    """``columns`` of filtered ``q, dq, ddq``, and filtered torque, where the arm moves; ``cutoff`` [Hz]: the columns pass it as the torque did."""
    X, y = [], []
    for r in trials:
        for m in motions(r, Preprocessing(low_pass=cutoff)):
            k = m.retained[np.abs(m.dq[m.retained]).max(axis=1) > MOVING]
            at = slice(None) if m.narrow else k
            found = columns(*(np.ascontiguousarray(x[at]) for x in (m.q, m.dq, m.ddq)))
            X.append(m.smooth(found)[k] if m.narrow else found)
            y.append(m.tau[k])
    return np.concatenate(X), np.concatenate(y)


def least_squares(
    robot: Robot, fit: Sequence[Recording], test: Sequence[Recording], more: bool, cutoff: float = 0.0
) -> np.ndarray:
    """(n,) held-out error [N m] of weighted least squares with base parameters and friction per joint."""
    V = base_directions(robot) * parameter_scale(robot)[:, None]

    def columns(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        n, load = robot.n, np.abs(gravity_torques(robot.chain, robot.pi, q))
        laws = [ddq, np.sign(dq), dq, np.ones_like(dq), *([np.sign(dq) * load, dq**3] if more else [])]
        X = np.zeros((len(q), n, V.shape[1] + len(laws) * n))
        X[:, :, : V.shape[1]] = regressors(robot.chain, q, dq, ddq) @ V
        for c, x in enumerate(laws):
            for j in range(n):
                X[:, j, V.shape[1] + c * n + j] = x[:, j]
        return X

    X, y = rows(fit, columns, cutoff)
    w = np.ones(robot.n)
    for _ in range(4):
        A, b = (X * w[:, None]).reshape(-1, X.shape[2]), (y * w).ravel()
        d = 1 / np.maximum(np.linalg.norm(A, axis=0), 1e-9)
        theta = d * np.linalg.lstsq(A * d, b, rcond=1e-9)[0]
        w = 1 / np.maximum(np.sqrt(np.mean((y - X @ theta) ** 2, axis=0)), 1e-9)
    X, y = rows(test, columns, cutoff)
    return np.sqrt(np.mean((y - X @ theta) ** 2, axis=0))


def ours(model: Model, test: Sequence[Recording]) -> np.ndarray:
    """(n,) held-out error [N m] of a model's rigid body, friction and effects in full; all of it passes the filter that the torque went through."""
    out = []
    for r in test:
        for m in motions(r, Preprocessing(low_pass=filtered_at(model))):
            q, dq, ddq = (np.ascontiguousarray(x) for x in (m.q, m.dq, m.ddq))
            whole = Recording("closed_loop", 0, 0, 0, m.t, q, dq, m.raw_tau)
            u = model.input(q, dq, m.raw_tau, m.temp, 0.0, m.t)
            left = left_over(model, whole, u, float("nan"), ddq, window=1)
            left = m.raw_tau - m.smooth(m.raw_tau - left) if m.narrow else m.smooth(left)
            out.append(left[m.retained[np.abs(dq[m.retained]).max(axis=1) > MOVING]])
    return np.sqrt(np.mean(np.concatenate(out) ** 2, axis=0))


def filtered_at(model: Model) -> float:
    """Cut-off [Hz] of the low-pass that identification found the recorded torque to have gone through; 0: none."""
    return next((out["value"] for out in model.provenance.get("taken_out", ()) if out["unit"] == "Hz"), 0.0)


def stopset(*words: str) -> tuple[int, str, float]:
    """Exit code, all that was said, and seconds of processor time of a command: a shared machine's clock says little."""
    start = used()
    done = subprocess.run([sys.executable, "-m", "stopset.cli.main", *words], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr, used() - start


def used() -> float:
    """Processor time [s] of all children so far."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def median(said: str) -> str:
    """The median tightness that `identify` printed."""
    found = re.search(r"after 0\.1 s: ([\d.]+)", said)
    return found[1] if found else "-"


def judge(folder: Path, work: Path) -> dict[str, Any]:
    """One robot through all commands."""
    from stopset.offline.description import load_robot

    options = (folder / "only.txt").read_text().split() if (folder / "only.txt").exists() else []
    given = dict(zip(options[::2], options[1::2], strict=True))
    lock = tuple(given["--lock"].split(",")) if "--lock" in given else ()
    urdf = given.pop("--robot", str(folder / "robot.urdf"))
    options = [word for pair in given.items() for word in pair]
    files = sorted(folder.glob("*.parquet"))
    if urdf == str(folder / "robot.urdf") and not Path(urdf).exists():
        return {"robot": folder.name, **inspected(files, work), "identify": "no description beside it", "identify seconds": 0}
    robot = load_robot(urdf, tip=given.get("--tip"), lock=lock)
    recordings = read_recordings(files, robot)
    fit, test = divided(recordings)
    compensated = recordings.meta.effort == "compensated_torque"
    out: dict[str, Any] = {"robot": folder.name, "seconds recorded": round(sum(float(r.t[-1] - r.t[0]) for r in recordings))}
    paths = {name: work / f"{folder.name}.{name}.parquet" for name in ("fit", "test")}
    for name, part in (("fit", fit), ("test", test)):
        pieces = part if name == "fit" or compensated else [b for r in part for b in blocks(r, 0.0)]
        own = pieces if compensated else [replace(r, suite=k, trial=0, phase="closed_loop") for k, r in enumerate(pieces)]
        write_recordings(paths[name], replace(recordings.meta, joints=robot.joints), own)
    out |= inspected(files, work, "--robot", urdf, *options)
    model = work / f"{folder.name}.model.json"
    code, text, seconds = stopset("identify", "--robot", urdf, *options, "--data", str(paths["fit"]), "--out", str(model))
    out["identify"], out["identify seconds"] = f"exit {code}" if code < 2 else text.strip().splitlines()[-1], round(seconds)
    if compensated:
        return out | by_position(model, paths, work, text)
    out["least squares"] = least_squares(robot, fit, test, more=False).round(3).tolist()
    out["least squares, load and cubic"] = least_squares(robot, fit, test, more=True).round(3).tolist()
    if not model.exists():
        return out
    out["stopset"] = ours(load_model(model), test).round(3).tolist()
    if cutoff := filtered_at(load_model(model)):
        out["filtered at"] = cutoff
        out["least squares, filtered"] = least_squares(robot, fit, test, more=True, cutoff=cutoff).round(3).tolist()
    out |= compared(model, paths["test"], work)[0] | {"tightness": median(text)} | diagnosed(model, paths["fit"], work)

    def error(path: Path) -> np.ndarray:
        return ours(load_model(path), test)

    return out | {"added": added(model, out["effects"], paths["fit"], error)}


def inspected(files: Sequence[Path], work: Path, *options: str) -> dict[str, Any]:
    """What `inspect` says of the files: exit code, kinds of findings, seconds."""
    answer = work / "inspect.json"
    answer.unlink(missing_ok=True)
    code, _, seconds = stopset("inspect", *map(str, files), *options, "--json", str(answer))
    said = json.loads(answer.read_text()) if answer.exists() else {}
    worst = [f["kind"] for file in said.get("files", []) for f in file["findings"] if f["severity"] != "note"]
    return {"inspect": f"exit {code}: {', '.join(dict.fromkeys(worst)) or 'nothing'}", "inspect seconds": seconds}


def compared(model: Path, test: Path, work: Path) -> tuple[dict[str, Any], float]:
    """What of the recordings that judge leaves the sets, the sets' width and the seconds; and the simulated position's error [rad]."""
    answer = work / "compare.json"
    answer.unlink(missing_ok=True)
    _, _, seconds = stopset("compare", str(model), "--data", str(test), "--json", str(answer))
    said = json.loads(answer.read_text()) if answer.exists() else {"joints": {}}
    left = f"{said.get('violations')}, {said.get('outside_domain')} of {said.get('recordings')}"
    error = [x["position_rmse"] for x in said["joints"].values() if x["position_rmse"] is not None]
    found = {"left": left, "U": float(load_model(model).powered.U.width.sum()), "compare seconds": seconds}
    return found, float(np.sqrt(np.mean(np.square(error)))) if error else float("nan")


def diagnosed(model: Path, fit: Path, work: Path) -> dict[str, Any]:
    """Verdict, effects and seconds."""
    answer = work / "diagnose.json"
    answer.unlink(missing_ok=True)
    code, text, seconds = stopset("diagnose", str(model), "--data", str(fit), "--json", str(answer))
    found = json.loads(answer.read_text()) if code == 0 else {"verdict": text.strip().splitlines()[-1], "ranked_effects": []}
    effects = [":".join(filter(None, (e["effect"], _at(e["joint"])))) for e in found["ranked_effects"]]
    return {"diagnosis": found["verdict"], "diagnose seconds": round(seconds), "effects": effects}


def _at(joint: str | Sequence[str] | None) -> str:
    """The joint of an effect, or all of them, as `add` is given them."""
    return joint if isinstance(joint, str) else "+".join(joint or ())


def by_position(model: Path, paths: dict[str, Path], work: Path, text: str) -> dict[str, Any]:
    """Compensated torque: the error of the simulated position on what judges, and what the other commands say."""
    found, error = compared(model, paths["test"], work)
    found |= diagnosed(model, paths["fit"], work) | {"tightness": median(text), "position": error}

    def simulated(path: Path) -> np.ndarray:
        return np.array([compared(path, paths["test"], work)[1]])

    return found | {"added": added(model, found["effects"], paths["fit"], simulated)}


def added(model: Path, effects: Sequence[str], fit: Path, error: Callable[[Path], np.ndarray]) -> list[dict[str, Any]]:
    """What was not fitted after each of ``effects`` more: error at its joints and, summed, of the whole arm; of a refused one why.

    ``error``: of a model file, (n,) at the joints or (1,) of the arm.
    """
    joints = load_model(model).joints
    steps, now, before = list[dict[str, Any]](), model, error(model)
    for k, label in enumerate(effects):
        new = model.with_suffix(f".{k}.json")
        code, text, _ = stopset("add", str(now), label, "--data", str(fit), "--out", str(new), "--quiet")
        if code or not new.exists():
            steps.append({"effect": label, "refused": text.strip().splitlines()[0] if text.strip() else f"exit {code}"})
            continue
        after = error(new)
        named = label.partition(":")[2].split("+")
        here = [joints.index(j) for j in named if j in joints and len(before) == len(joints)] or list(range(len(before)))
        there = [round(float(x[here].sum()), 4) for x in (before, after)]
        steps.append({"effect": label, "there": there, "all": [round(float(x.sum()), 4) for x in (before, after)]})
        now, before = new, after
    return steps


def worth(steps: Sequence[dict[str, Any]]) -> str:
    """What claims did to the error of what was not fitted, in words."""
    said = [
        f"{s['effect']} refused" if "refused" in s else f"{s['effect']} {s['there'][0]:.3g} to {s['there'][1]:.3g}" for s in steps
    ]
    taken = [s for s in steps if "all" in s]
    whole = [f"**all {taken[0]['all'][0]:.2f} to {taken[-1]['all'][1]:.2f}**"] if taken else []
    return "; ".join([*said, *whole]) or "-"


def table(results: Sequence[dict[str, Any]]) -> str:
    """As Markdown; errors in N m, summed over the joints."""
    head = (
        "robot",
        "inspect",
        "identify",
        "held-out error: least squares / with load, cubic / stopset",
        "tightness at 0.1 s, U [N m]",
        "held-out blocks that leave the sets, the domain",
        "diagnosis of the fitted part",
        "what was not fitted: error at its joints before and after each was added",
        "processor time [s]: inspect, identify, compare, diagnose",
    )
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for r in results:
        names = (
            "least squares",
            "least squares, load and cubic",
            *(("least squares, filtered",) if "filtered at" in r else ()),
            "stopset",
        )
        errors = [f"{sum(r[k]):.2f}" if k in r else "-" for k in names]
        held_out = f"{r['position']:.3f} rad" if "position" in r else " / ".join(errors)
        width = f"{r['U']:.0f}" if "U" in r else "-"
        cells = (
            r["robot"], r["inspect"], r["identify"], held_out, f"{r.get('tightness', '-')}, {width}", r.get("left", "-"),
            f"{r.get('diagnosis', '-')}: {', '.join(r.get('effects', [])) or '-'}", worth(r.get("added", ())),
            f"{r['inspect seconds']:.0f}, {r['identify seconds']:.0f}, {r.get('compare seconds', 0):.0f}, {r.get('diagnose seconds', 0):.0f}",
        )  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--markdown", type=Path)
    args = parser.parse_args()
    results = json.loads(args.json.read_text()) if args.json and args.json.exists() else []
    asked = {r["robot"] for r in results}
    with tempfile.TemporaryDirectory() as work:
        for folder in sorted({p.parent for p in args.folder.glob("*/*.parquet")}):
            if folder.name in asked:
                continue
            results.append(judge(folder, Path(work)))
            print(json.dumps(results[-1]), flush=True)
            if args.json:
                args.json.write_text(json.dumps(results, indent=1))
    text = table(results)
    print(text)
    if args.markdown:
        args.markdown.write_text(text + "\n")


if __name__ == "__main__":
    main()
