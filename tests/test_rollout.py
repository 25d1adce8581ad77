"""A model for many arms, one first: real monitors behind a real router; a model that is too narrow gets no farther than the first."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from monitor_arm import known_model, meta, motion
from monitor_process import free_port, running, wait
from stopset.artifact import load_model, save_model
from stopset.artifact.signature import new_key, sign
from stopset.cli.main import main
from stopset.monitor.fleet import Fleet
from stopset.monitor.links.zenoh_link import ZenohLink
from stopset.recording import write_recordings
from stopset.sets import Box

ARMS = ("hall/cell1/arm", "hall/cell2/arm")
DELIVER = """#!/bin/sh
# new names first, then both in place, then read it
set -e
cp "$3" "$1/m.json.sig.new"; cp "$2" "$1/m.json.new"
mv "$1/m.json.sig.new" "$1/m.json.sig"; mv "$1/m.json.new" "$1/m.json"
kill -HUP "$(cat "$1/pid")"
"""


@dataclass
class Hall:
    """A folder per cell; ``words``: the roll-out of a model of that name, but for what a test adds."""

    folder: Path
    connect: str

    def words(self, name: str, *more: str) -> list[str]:
        deliver = f"{self.folder}/deliver.sh {self.folder}/{{cell}} {{model}} {{signature}}"
        seconds = ("--watch-s", "3", "--each-s", "1.5", "--connect", self.connect)
        model = str(self.folder / f"{name}.json")
        return ["rollout", model, "--canary", ARMS[0], "--arms", "hall/*/*", "--deliver", deliver, *seconds, *more]

    def rolled_out(self, name: str, *more: str) -> tuple[int, dict[str, Any]]:
        """Exit code and answer; asked again where the machine stood still meanwhile, for then an arm is silent and gets nothing."""
        answer = self.folder / "answer.json"
        for _ in range(3):
            code = main(self.words(name, "--json", str(answer), *more))
            said = json.loads(answer.read_text())
            if "it says nothing" not in (said["why"] or ""):
                break
        return code, said

    def models(self) -> list[str]:
        return [load_model(self.folder / arm.split("/")[1] / "m.json").sha256 for arm in ARMS]

    def sha256(self, name: str) -> str:
        return load_model(self.folder / f"{name}.json").sha256


def cells(stack: contextlib.ExitStack, folder: Path, connect: str, arms: tuple[str, ...], model: str, recording: str) -> Fleet:
    """A router, and for every arm a monitor with the signed ``model`` in a folder named as its cell, and the arm, moving as recorded."""
    router = ZenohLink(mode="router", listen=[connect])
    stack.callback(router.close)
    for arm in arms:
        site, cell, name = arm.split("/")
        there = folder / cell
        there.mkdir()
        for suffix in ("", ".sig"):
            (there / f"m.json{suffix}").write_bytes((folder / f"{model}{suffix}").read_bytes())
        (there / "c.toml").write_text(
            f'model = "m.json"\nsite = "{site}"\ncell = "{cell}"\narm = "{name}"\ndata_id = 7\n[joint_states]\nkey = "{arm}/joint_states"\n'
            f'cycle_s = 0.004\n[zenoh]\nmode = "client"\nlisten = []\nconnect = ["{connect}"]\n[publish]\nvalid_for_ms = 1000\nstale_ms = 2000\n'
            '[stops]\ncategories = ["0"]\n[signed]\nkeys = ["../release.pub"]\n'
        )
        monitor = stack.enter_context(running("monitor", "--config", str(there / "c.toml")))
        (there / "pid").write_text(str(monitor.pid))
        to = ("--to", f"zenoh:{connect}", "--key", f"{arm}/joint_states", "--loop")
        stack.enter_context(running("replay", str(folder / recording), *to))
    fleet = Fleet()
    router.subscribe("*/*/*/stopset/state/json", fleet.take_json)
    return fleet


@pytest.fixture
def hall(tmp_path: Path) -> Iterator[Hall]:
    port = free_port()
    connect, model = f"tcp/127.0.0.1:{port}", known_model(horizon=0.1)
    tiny = {k: Box.symmetric([1e-6] * n) for k, n in (("X0", 12), ("U", 6), ("V", 12))}
    narrow = replace(model, sets={"powered": replace(model.powered, **tiny)})
    new_key(tmp_path / "release")
    for name, m in (("old", model), ("new", replace(model, notes=("another file",))), ("narrow", narrow)):
        save_model(m, tmp_path / f"{name}.json")
        sign(tmp_path / f"{name}.json", tmp_path / "release")
    write_recordings(tmp_path / "motion.parquet", meta(), [replace(motion(seed, 500), trial=seed) for seed in (1, 2)])
    (tmp_path / "deliver.sh").write_text(DELIVER)
    (tmp_path / "deliver.sh").chmod(0o755)
    with contextlib.ExitStack() as stack:
        fleet = cells(stack, tmp_path, connect, ARMS, "old.json", "motion.parquet")
        assert wait(lambda: [r["word"] for r in fleet.rows()] == ["OK", "OK"], 60.0), fleet.rows()
        yield Hall(tmp_path, connect)


@pytest.mark.slow
def test_one_first_then_the_others_and_no_farther_than_the_first_that_gets_worse(
    hall: Hall, capsys: pytest.CaptureFixture[str]
) -> None:
    code, reported = hall.rolled_out("new")
    assert code == 0, capsys.readouterr().out
    assert reported["done"] and [t["arm"] for t in reported["taken"]] == list(ARMS) and not reported["not_asked"]
    assert hall.models() == [hall.sha256("new")] * 2
    back = ("--back", str(hall.folder / "new.json"))
    code, reported = hall.rolled_out("narrow", *back)
    assert (
        code == 1
        and "VIOLATION with the new model" in reported["why"]
        and reported["not_asked"] == [ARMS[1]]
        and not reported["back"][0]["why"]
    )
    assert hall.models() == [hall.sha256("new")] * 2, "the other arm was never asked, the first has its old model again"
    unsigned = hall.folder / "new.json"  # signed, and then another byte
    unsigned.write_text(unsigned.read_text() + " ")
    code, reported = hall.rolled_out("new")
    assert code == 1 and "refuses the model" in (why := reported["why"]) and "not the file that was signed" in why


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (["--canary", "hall/*/arm"], "one arm"), (["--arms", "hall"], "expected SITE/CELL/ARM"), (["--watch-s", "nan"], "expected seconds"),
        (["--deliver", "cp {nothing}"], "cannot be filled in"), (["--deliver", "cp 'a"], "cannot be filled in"),
        (["--connect", "tcp/127.0.0.1:1"], "127.0.0.1:1"),
    ],
)  # fmt: skip
def test_what_cannot_be_rolled_out_is_one_sentence(
    spoil: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_model(known_model(), tmp_path / "m.json")
    new_key(tmp_path / "release")
    words = ["rollout", str(tmp_path / "m.json"), "--canary", "a/b/c", "--deliver", "true", *spoil]
    assert main(words) == 2
    assert "is not signed" in capsys.readouterr().err or "--connect" not in spoil
    sign(tmp_path / "m.json", tmp_path / "release")
    assert main(words) == 2
    said = capsys.readouterr().err
    assert says in said and said.count("\n") == 1


def test_an_arm_that_nobody_heard_gets_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_model(known_model(), tmp_path / "m.json")
    new_key(tmp_path / "release")
    sign(tmp_path / "m.json", tmp_path / "release")
    port = free_port()
    router = ZenohLink(mode="router", listen=[f"tcp/127.0.0.1:{port}"])
    try:
        words = ["rollout", str(tmp_path / "m.json"), "--canary", "a/b/c", "--deliver", f"touch {tmp_path}/delivered"]
        assert main([*words, "--connect", f"tcp/127.0.0.1:{port}"]) == 1
    finally:
        router.close()
    assert "no monitor of that name was heard" in capsys.readouterr().out and not (tmp_path / "delivered").exists()
