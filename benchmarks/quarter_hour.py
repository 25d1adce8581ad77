"""What each command takes on fifteen minutes of six joints at 100 Hz, and the longest time it says nothing.

The recordings are played again and again, each time with other sensor noise, until they are that long: fewer motions than fifteen
minutes would hold, as many rows.  Processor time is that of the command and all its processes; silence is the longest time between two of its
words, by its processor time (what a machine with nothing else to do would show, or less where it works in parallel) and by the clock.
Answers are kept in WORK, so a run may be broken off and taken up again.  Linux: processor time is read from /proc.

    python benchmarks/quarter_hour.py ROBOT RECORDINGS... --work WORK [--only COMMAND,...]
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import select
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stopset.offline.description import load_robot
from stopset.recording import Recording, read_recordings, write_recordings

SECONDS = 900.0
NOISE = (1e-5, 1e-3, 0.05)  # q [rad], dq [rad/s], tau [N m]
COMMANDS = ("inspect", "identify", "identify --model 2", "compare", "diagnose", "add")


def lengthened(trials: Sequence[Recording]) -> list[Recording]:
    """The trials again and again until `SECONDS`, numbered anew as suites of one trial."""
    rng, out, seconds = np.random.default_rng(0), list[Recording](), 0.0
    while seconds < SECONDS:
        for r in trials:
            noisy = (x + size * rng.normal(size=x.shape) for x, size in zip((r.q, r.dq, r.tau), NOISE, strict=True))
            q, dq, tau = noisy if out and len(out) >= len(trials) else (r.q, r.dq, r.tau)
            out.append(replace(r, suite=len(out), trial=0, repetition=0, q=q, dq=dq, tau=tau))
            seconds += float(r.t[-1] - r.t[0])
            if seconds >= SECONDS:
                break
    return out


def used(pid: int) -> float:
    """Processor time [s] of a process and all that it started, so far."""
    times, children = dict[int, float](), dict[int, list[int]]()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):  # it has just ended
            continue
        one = int(stat.parent.name)
        times[one] = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")  # its own and that of children that have ended
        children.setdefault(int(fields[1]), []).append(one)
    total, rest = 0.0, [pid]
    while rest:
        one = rest.pop()
        total += times.get(one, 0.0)
        rest += children.get(one, [])
    return total


def asked(words: Sequence[str]) -> dict[str, Any]:
    """Exit code, processor and wall time and the longest silence [s] of a command."""
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "stopset.cli.main", *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, bufsize=0
    )
    assert process.stdout is not None
    heard, silence, last = begun, 0.0, b""
    worked, idle, between = (
        0.0,
        0.0,
        ("start", "start"),
    )  # processor time at the last word, longest without one, and between which words
    while True:
        select.select([process.stdout], [], [])
        said = os.read(process.stdout.fileno(), 65536)
        now, work = time.monotonic(), used(process.pid)
        silence, heard = max(silence, now - heard), now
        if work - worked > idle:
            idle, between = work - worked, (last.decode(errors="replace")[-80:], said.decode(errors="replace")[:80])
        worked = work
        if not said:
            break
        last = said
    code = process.wait()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    total = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    out: dict[str, Any] = {
        "exit": code,
        "processor s": round(total, 1),
        "wall s": round(now - begun, 1),
        "silent, processor s": round(idle, 1),
        "silent, wall s": round(silence, 1),
        "silent between": between,
    }
    return out if code < 2 else out | {"said": last.decode(errors="replace")[-300:]}


def words_of(command: str, robot: str, data: str, work: Path) -> list[str] | None:
    """The command line; None where there is nothing to ask."""
    model, answer = str(work / "1.model.json"), work / "diagnosis.json"
    if command == "inspect":
        return ["inspect", data, "--robot", robot]
    if command.startswith("identify"):
        out = model if command == "identify" else str(work / "2.model.json")
        return [*command.split(), "--robot", robot, "--data", data, "--out", out]
    if command == "compare":
        return ["compare", model, "--data", data]
    if command == "diagnose":
        return ["diagnose", model, "--data", data, "--json", str(answer)]
    named = json.loads(answer.read_text())["ranked_effects"]
    if not named:
        return None
    joint = named[0]["joint"]
    where = "" if joint is None else ":" + (joint if isinstance(joint, str) else "+".join(joint))
    return ["add", model, named[0]["effect"] + where, "--data", data, "--out", str(work / "3.model.json")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot")
    parser.add_argument("recordings", nargs="+")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--only", default="", help="commands, comma-separated")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    data, answers = args.work / "fifteen.parquet", args.work / "answers.json"
    if not data.exists():
        recordings = read_recordings(args.recordings, load_robot(args.robot))
        write_recordings(data, recordings.meta, lengthened([r for r in recordings if r.phase != "static"]))
    found: dict[str, Any] = json.loads(answers.read_text()) if answers.exists() else {}
    for command in (c for c in COMMANDS if not args.only or c in args.only.split(",")):
        if command not in found:
            words = words_of(command, args.robot, str(data), args.work)
            found[command] = asked(words) if words else "nothing is named"
            answers.write_text(json.dumps(found, indent=1))
        print(f"{command:<20} {found[command]}", flush=True)


if __name__ == "__main__":
    main()
