"""``stopset demo``: the whole story on a simulated arm, with the commands a user would type; each of its sentences is held."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from stopset.cli.common import say

if TYPE_CHECKING:
    from stopset.cli.story.cell import MonitoredCell, Subscriber
    from stopset.cli.story.chapters import Episode
    from stopset.cli.story.telling import Story

HELP = "the whole story on a simulated arm: no file, no hardware, no network; a minute or two"
HIDDEN = "spring:arm_4_joint"  # a dress pack that is laid one day


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("--out", type=Path, default=Path("stopset-demo"), help="where pages and files go (default stopset-demo)")
    parser.add_argument(
        "--robot", default="lwa4p", help="another simulated arm: what `stopset simulate --robot` takes (default %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=3, help="of the simulated motions and readings (default %(default)s)")
    parser.add_argument("--hide", default=HIDDEN, metavar="EFFECT:JOINT", help="what happens to it (default %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Play the story; every file stays in ``--out``, every step in its events.jsonl. Exit code 1: a sentence of it did not hold."""
    from stopset.cli.story.cell import MonitoredCell, Subscriber
    from stopset.cli.story.chapters import Episode
    from stopset.cli.story.telling import FailedError, Story
    from stopset.errors import OutputError, StopsetError

    out: Path = args.out
    effect, _, joint = args.hide.partition(":")
    if not effect or not joint:
        raise StopsetError(f"--hide {args.hide!r}; expected EFFECT:JOINT, like {HIDDEN}: write it so")
    if out.exists() and not out.is_dir():
        raise OutputError(f"--out {out} is a file; expected a directory: choose another name")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise OutputError(f"--out {out} cannot be created ({e.strerror}); choose another place") from e
    story, episode = Story(out), Episode(args.robot, effect, joint, args.seed)
    cell = MonitoredCell.built(out, can=episode.on_can)
    ear = Subscriber(cell)
    try:
        _played(story, episode, cell, ear)
    except FailedError as e:
        sys.stderr.write(
            f"stopset: the demonstration failed: it did not hold that {e} (the monitor says {': '.join(ear.view.word())})\n"
        )
        return 1
    finally:
        ear.close()
        events = sorted([*story.steps, *ear.events], key=lambda e: e["t_ns"])
        (out / "events.jsonl").write_text("".join(json.dumps(e) + "\n" for e in events))
    _closing(out, time.monotonic() - story.start)
    return 0


def _played(story: Story, episode: Episode, cell: MonitoredCell, ear: Subscriber) -> None:
    from stopset.cli.story.chapters import cleared, explained, identified, smaller, unexplained, watched
    from stopset.cli.story.telling import Asides, show
    from stopset.fmu.build import native

    out = story.out
    with Asides() as beside:  # what only computes, while the arm moves in its own time
        first, changed = identified(story, episode, cell, beside)
        changed.result()
        plain, without = unexplained(story, episode, beside)
        bundle = watched(story, episode, cell, ear)
        second = explained(story, episode, first, bundle, beside)
        without.result()
        story.chapter("Compared again, revisions side by side, how far it goes when it is stopped (ISO 10218-1), and an FMU.")
        model, data = str(second), str(out / "changed" / "recording.parquet")
        stops = beside.begin("stops", model, "--report", str(out / "stops.html"), "--json", str(out / "stops.json"))
        unit = beside.begin("export-fmu", model, "--out", str(out / "arm.fmu"), "--platform", str(native()))
        again = beside.begin("compare", model, "--data", data, "--report", str(out / "compare-second.html"), good=(0, 1))
        history = beside.begin("history", model, "--report", str(out / "history.html"))
        cleared(story, cell, ear, (first, second, plain))
        smaller(story, episode, plain, second)
        story.chapter("What was computed meanwhile:")
        show(again.result(), lambda line: "the predicted sets" in line and not line.startswith(" "))
        for done in (stops, unit, history):
            done.result()


PAGES = {
    "compare-first.html": "the healthy arm's model against the changed arm: where it fails",
    "diagnosis.html": "which effect is missing, and why",
    "compare-second.html": "the model with the effect added",
    "history.html": "how each revision lowered the errors",
    "stops.html": "stop distances and times, speed x payload x extension",
    "second.model.json": "the model file that monitor and FMU know the arm from; its signature is beside it",
    "arm.toml": "the monitor's configuration",
    "arm.record": "what the monitor recorded: evidence of the violation, and the journal",
    "events.jsonl": "every step, and every event of the monitor",
    "arm.fmu": "the FMU; simulate it with any FMI 3 tool",
}


def _closing(out: Path, seconds: float) -> None:
    say(f"\nDone in {seconds:.0f} s. Open:")
    for name, what in PAGES.items():
        if (out / name).exists():
            say(f"  {out / name!s:<38} {what}")
    say("Monitoring aid, not a certified safety function: see the README before you rely on a number.")
