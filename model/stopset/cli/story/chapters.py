"""The drill: an arm changes, and everything that must happen then does, with processes killed on the way.

Each chapter runs the commands of one stage and holds what must be true at its end; the first sentence that is not ends the story.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import time
from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stopset.artifact import load_model
from stopset.cli.story.cell import ARM, MonitoredCell, Subscriber, sig
from stopset.cli.story.telling import Asides, Story, hold, process, show, until
from stopset.monitor.layout import State
from stopset.recording import Recording, read_meta, read_recordings, write_recordings

LIKELY = 0.2  # probability with which a new motion may leave the sets, at most
ROUND, CHANGED = 2, 4  # motions that are replayed of the healthy arm (twice over), and of the changed one
HOLDS = 6.0  # [s] it must stay good afterwards
SILENT = 1.0  # [s] between two messages while a model is rolled out, at most: what a message is valid for in this cell
PART = 0.5  # of what it was without the effect: torque error, open-loop error and width of U at its joint, at most
CLOSER = 0.9  # of the stop bound without the effect, at most


@dataclass(frozen=True, slots=True)
class Episode:
    """What happens in this story: to which arm (a name `stopset simulate` knows, or a URDF), what, and at which of its joints."""

    robot: str
    effect: str
    joint: str
    seed: int

    @property
    def hide(self) -> str:
        """As `stopset simulate` is told."""
        return f"{self.effect}:{self.joint}"

    @property
    def on_can(self) -> bool:
        """Whether a bus profile that ships knows the arm."""
        return self.robot == "lwa4p"


def simulated(episode: Episode, out: Path, effect: str) -> tuple[str, ...]:
    """The command that records the arm with ``effect`` in it, nobody being told."""
    return (
        "simulate",
        "--robot",
        episode.robot,
        "--hide",
        effect,
        "--size",
        "large",
        "--plan",
        "motions",
        "--seed",
        str(episode.seed),
        "--out",
        str(out),
    )


def identified(story: Story, episode: Episode, cell: MonitoredCell, beside: Asides) -> tuple[Path, Future[str]]:
    """The healthy arm's model, signed and in the monitor's place; its promise on new motions means something.

    Gives the model's file, and the recordings of the arm as it will be later, which are simulated meanwhile.
    """
    story.chapter(
        "An arm in a simulated cell is measured; a reachset-conformant model is identified from the recordings, and signed."
    )
    healthy, first = story.out / "healthy", story.out / "first.model.json"
    changed = beside.begin(*simulated(episode, story.out / "changed", episode.hide))
    story.do(*simulated(episode, healthy, "none"), keep=lambda x: "recordings" in x)
    words = ("identify", "--robot", str(healthy / "robot.urdf"), "--data", str(healthy / "recording.parquet"))
    promise = story.ask("identified", *words, "--out", str(first), "--accept-wide", good=(0,))["guarantee"]
    most = promise["upper_bound"]
    hold(promise["violated"] == 0 and most <= LIKELY, f"a new motion leaves the sets with at most {LIKELY:.0%}: {most:.1%}")
    if not (story.out / "release").exists():
        story.do("sign", "--new-key", str(story.out / "release"))
    story.do("sign", str(first), "--key", str(story.out / "release"))
    cell.put_in_place(first)
    story.step(
        f"of {promise['motions']} motions held out none leaves the sets; a new one does with probability of at most {most:.1%}"
    )
    return first, changed


def unexplained(story: Story, episode: Episode, beside: Asides) -> tuple[Path, Future[str]]:
    """What one gets by identifying the changed arm anew without naming what changed: the model's file, once the command has ended."""
    plain, data = story.out / "unexplained.model.json", str(story.out / "changed" / "recording.parquet")
    words = ("--robot", str(story.out / "healthy" / "robot.urdf"), "--data", data, "--friction", "plain", "--accept-wide")
    return plain, beside.begin("identify", *words, "--out", str(plain))


def watched(story: Story, episode: Episode, cell: MonitoredCell, ear: Subscriber) -> Path:
    """OK while it is healthy; the moment it changes VIOLATION, with its class and a file of evidence. Gives that file."""
    how = "on CAN" if episode.on_can else "on zenoh"
    story.chapter(
        f"The monitor listens {how}; the healthy arm moves, then it changes: {_what(episode)}. Nobody tells the monitor."
    )
    config = str(cell.config)
    with process("monitor", "--config", config):
        rounds = _played(story.out, episode.joint)
        ear.listen()
        with cell.moving("cell"):
            until(lambda: ear.says("OK"), "the healthy arm is OK")
            until(lambda: ear.event("violation"), "the changed arm is a VIOLATION")
            cause = until(lambda: ear.event("bundle"), "the violation is classed")["cause"]
        bundle: Path = until(lambda: cell.evidence, "evidence is on the disk")[0]
        second = ear.counted(rounds, 2 * rounds)
        counts = ", ".join(f"{n} {state}" for state, n in second.most_common())
        story.step(
            f"healthy, the second time round: {counts} (where one recorded motion ends and the next begins, OK is earned anew)"
        )
        violation = ear.event("violation")
        assert violation is not None
        hold(State.OK not in ear.said(ear.life, violation["seq"]), "nothing is OK after the violation")
        story.step(f"changed: VIOLATION, class {cause['kind']}: {cause['says']}; evidence {bundle.name}")
    return bundle


def _what(episode: Episode) -> str:
    return f"a {episode.effect} pulls at {episode.joint}"


def _played(out: Path, joint: str) -> int:
    """What the replays play, of the motions in which the joint goes farthest; the number of samples of a healthy round."""
    meta = read_meta(out / "healthy" / "recording.parquet")
    j = meta.joints.index(joint)

    def chosen(name: str, n: int) -> list[Recording]:
        whole = read_recordings(out / name / "recording.parquet").phase("open_loop")
        return sorted(whole.trials, key=lambda r: -float(np.ptp(r.q[:, j])))[:n]

    healthy, changed = chosen("healthy", ROUND), chosen("changed", CHANGED)
    # a cell repeats its motions: the second time round the stop bounds of the first are there
    write_recordings(out / "cell.parquet", meta, _numbered([*healthy, *healthy, *changed]))
    write_recordings(out / "healthy.parquet", meta, _numbered(healthy))
    write_recordings(out / "changed.parquet", meta, _numbered(changed))
    return sum(len(r.q) for r in healthy)


def _numbered(trials: list[Recording]) -> Iterable[Recording]:
    return (dataclasses.replace(r, trial=k) for k, r in enumerate(trials))


def explained(story: Story, episode: Episode, first: Path, bundle: Path, beside: Asides) -> Path:
    """The revision with the effect that the diagnosis names, and how its errors fell."""
    out, data = story.out, str(story.out / "changed" / "recording.parquet")
    second = out / "second.model.json"
    story.chapter("The arm is measured anew. Where does the model fail, and which physical effect is missing?")
    pages = ("--report", str(out / "compare-first.html"))
    fails = beside.begin("compare", str(first), "--data", data, *pages, good=(0, 1))
    evidence = beside.begin("compare", str(first), "--data", str(bundle), good=(0, 1))
    found = story.ask("diagnosis", "diagnose", str(first), "--data", data, "--report", str(out / "diagnosis.html"))
    show(fails.result(), lambda line: "the predicted sets" in line and not line.startswith(" "))
    evidence.result()
    ranked = [(r["effect"], r["joint"]) for r in found["ranked_effects"]]
    for row in found["ranked_effects"][:3]:
        story.step(f"{row['effect']} at {row['joint']}: {row['says']}")
    named = ", ".join(":".join(filter(None, r)) for r in ranked) or "nothing"
    hold(ranked[:1] == [(episode.effect, episode.joint)], f"the diagnosis names {episode.hide} first, it said {named}")
    story.chapter("It is added, and the errors fall.")
    where = ("--joint", episode.joint, "--data", data, "--out", str(second))
    judged = story.ask("added", "add", str(first), episode.effect, *where, good=(0,), keep=_table)
    for key, what in (("torque", "torque error"), ("position", "open-loop error")):
        a, b = (judged[when][f"held_out_{key}_rmse:{episode.joint}"] for when in ("before", "after"))
        hold(b <= PART * a, f"the {what} of {episode.joint} is at least halved: {a:.3g} -> {b:.3g}")
    return second


def _table(line: str) -> bool:
    return "->" in line or line.startswith(("at ", "over ", "revision"))


def smaller(story: Story, episode: Episode, plain: Path, second: Path) -> None:
    """The sets and the stop bound, against what they are without the effect."""
    story.chapter("Against identifying anew without naming it: the sets and the stop bound are smaller.")
    models = (plain, second)
    a, b = (_width(m, episode.joint) for m in models)
    hold(b <= PART * a, f"U of {episode.joint} shrinks: {b:.3g} N m with the effect, {a:.3g} N m without")
    story.step(
        f"U of {episode.joint}, the torque that is left unexplained: {a:.3g} N m identified anew, {b:.3g} N m with the effect"
    )
    a, b = (_farthest(story, m, episode.joint) for m in models)
    hold(b <= CLOSER * a, f"the stop bound of {episode.joint} shrinks: {b:.3g} rad with the effect, {a:.3g} rad without")
    story.step(f"STOP 0 of {episode.joint} at half speed: at most {a:.3g} rad identified anew, {b:.3g} rad with the effect")


def _width(model: Path, joint: str) -> float:
    """Of U at the joint [N m]."""
    m = load_model(model)
    return float(m.powered.U.width[m.joints.index(joint)])


def _farthest(story: Story, model: Path, joint: str) -> float:
    """How far the joint goes on STOP 0 from the middle of what was recorded, at half its speed [rad]."""
    middle = ",".join(f"{x:.4f}" for x in load_model(model).domain.q.centre)
    name = f"stop-{model.name.partition('.')[0]}"
    rows = story.ask(name, "stops", str(model), f"--at={middle}", "--speed", "50%", "--category", "0")
    bound = next(r["angle_rad"] for r in rows if r["joint"] == joint)
    hold(bound is not None, f"STOP 0 of {joint} can be bounded at half speed with {model.name}")
    return float(bound)


def cleared(story: Story, cell: MonitoredCell, ear: Subscriber, models: tuple[Path, Path, Path]) -> None:
    """The latch outlives a kill, the unsigned model is refused, the signed one taken without a gap, a person clears: OK again."""
    first, second, plain = models
    story.chapter(
        "The monitor is killed and begun anew; the signed revision is rolled out while it runs; a person clears the latch."
    )
    with contextlib.ExitStack() as life:
        monitor = life.enter_context(process("monitor", "--config", str(cell.config)))
        ear.listen()
        life.enter_context(cell.moving("changed", "--loop"))
        until(lambda: sum(e["kind"] == "started" for e in list(ear.events)) > 1, "the monitor that was begun anew sees the arm")
        until(lambda: ear.says("VIOLATION"), "the violation outlives the killed monitor")
        story.step("still VIOLATION after kill -9")
        begin = len(ear.states)
        cell.put_in_place(plain, signature=sig(first))
        os.kill(monitor.pid, signal.SIGHUP)
        until(lambda: ear.event("reload_refused"), "a model that nobody signed is refused")
        story.step("a model under another's signature is refused")
        story.do("sign", str(second), "--key", str(story.out / "release"))
        cell.put_in_place(second)
        os.kill(monitor.pid, signal.SIGHUP)
        until(lambda: ear.event("reloaded"), "the signed revision is taken")
        time.sleep(0.5)
        gap, usual = ear.longest_silence(begin), ear.longest_silence(0, begin)
        # a machine that is busy with everything else makes gaps of its own
        hold(gap < max(SILENT, 3.0 * usual), f"the messages go on while a model is rolled out, the longest gap was {gap:.2f} s")
        story.step(f"rolled out without a gap (longest {1000 * gap:.0f} ms), still not OK")
        who = ("--name", "A. Smith", "--reason", f"{models[1].name} knows what changed")
        story.do("reset", *who, "--connect", cell.endpoint, "--arm", ARM)
        seq = until(lambda: ear.event("reset"), "the reset is published")["seq"]
        hold(State.OK not in ear.said(ear.life, -1, seq), "nothing is OK before a person has looked")
        until(lambda: ear.says("OK"), "the arm with its new model is OK")
        story.step("OK again")
        time.sleep(HOLDS)
        after = ear.said(ear.life, seq)
        hold(State.VIOLATION not in after[1:], "no VIOLATION comes back with the new model")
        lost = ear.not_heard()
        hold(not lost, f"every event that the monitor remembers was heard, not heard: {lost[:2]}")
        good = after.count(State.OK) / len(after)
        story.step(f"no VIOLATION within {HOLDS:g} s more, {good:.0%} of the messages OK, no event lost")
