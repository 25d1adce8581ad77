"""Profiles of other drives: several joints a node, frames on change, another SYNC, and the check that says what does not fit."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_arm import DT, motion
from stopset.cli.main import main
from stopset.errors import BusError
from stopset.monitor.links import bus
from stopset.monitor.links.batch import Frame
from stopset.monitor.links.canopen_map import Encoder
from stopset.monitor.links.decoder import Cycle, Decoder
from stopset.monitor.profile import SIGNALS, Profile, load_profile, shipped_profiles
from stopset.monitor.profile_check import against_log, bits, check_profile
from stopset.monitor.replay import signal_rows
from stopset.monitor.source import sample_of

MILLI = 1.7453292519943296e-05
ELMO = Path(__file__).parents[1] / "deploy" / "profiles" / "elmo-gold" / "monitor.toml"


def eds(folder: Path, axes: int, status_on_change: bool) -> Path:
    """A drive with ``axes`` axes: TPDO 2i+1 position and speed, 2i+2 torque, both after SYNC; statuswords on change or beside torque."""
    text = ["[DeviceInfo]", "BaudRate_1000=1", f"NrOfTXPDO={3 * axes}", ""]

    def variable(index: int, kind: int, value: str = "") -> None:
        text.extend([f"[{index:04X}]", f"ParameterName=x{index:X}", "ObjectType=0x7", f"DataType={kind:#x}", "AccessType=ro",
                     f"DefaultValue={value}", "PDOMapping=1", ""])  # fmt: skip

    def record(index: int, subs: list[tuple[int, str]]) -> None:
        text.extend([f"[{index:04X}]", f"ParameterName=r{index:X}", "ObjectType=0x9", f"SubNumber={len(subs)}", ""])
        for sub, (kind, value) in enumerate(subs):
            text.extend([f"[{index:04X}sub{sub:X}]", f"ParameterName=s{sub}", "ObjectType=0x7", f"DataType={kind:#x}",
                         "AccessType=rw", f"DefaultValue={value}", "PDOMapping=0", ""])  # fmt: skip

    number = 0
    for a in range(axes):
        o = 0x800 * a
        for index, kind in ((0x6064, 4), (0x606C, 4), (0x6077, 3), (0x6041, 6)):
            variable(index + o, kind, "0")
        slow = [f"0x{0x6041 + o:X}0010"]
        pdos = [([f"0x{0x6064 + o:X}0020", f"0x{0x606C + o:X}0020"], 1), ([f"0x{0x6077 + o:X}0010"], 1)]
        pdos = [*pdos, (slow, 255)] if status_on_change else [pdos[0], (pdos[1][0] + slow, 1)]
        for mapped, kind in pdos:
            cob = (0x180, 0x280, 0x380, 0x480)[number % 4] + 0x40 * (number // 4)
            record(0x1800 + number, [(5, "2"), (7, f"$NODEID+0x{cob:X}"), (5, str(kind))])
            record(0x1A00 + number, [(5, str(len(mapped))), *((7, m) for m in mapped)])
            number += 1
    path = folder / "drive.eds"
    path.write_text("\n".join(text))
    return path


def profile(folder: Path, axes: int = 2, on_change: bool = True, more: str = "") -> Profile:
    eds(folder, axes, on_change)
    joints = [f"j{k + 1}" for k in range(6)]
    nodes = "\n".join(f"{j} = {{node = {3 + k // axes}, axis = {k % axes}}}" for k, j in enumerate(joints))
    signals = "\n".join(
        f"[signals.{name}]\nobject = {index}\nscale = {scale}"
        for name, index, scale in (("q", 0x6064, MILLI), ("dq", 0x606C, MILLI), ("tau", 0x6077, 0.01), ("status", 0x6041, 1.0))
    )
    path = folder / "arm.toml"
    path.write_text(f'dcf = "drive.eds"\nbitrate = 1_000_000\ncycle_s = {DT}\n{more}\n[nodes]\n{nodes}\n{signals}\n')
    return load_profile(path)


def heard(p: Profile, samples: int = 60) -> tuple[np.ndarray[Any, Any], list[Frame]]:
    """Frames that drives of this profile send for a motion."""
    rows, encoder = signal_rows(motion(1, samples)), Encoder(p)
    frames = [
        Frame(cob, data, DT * k + 20e-6 * i)
        for k, values in enumerate(rows)
        for i, (cob, data) in enumerate(encoder.frames(values))
    ]
    return rows, frames


def decoded(p: Profile, frames: list[Frame]) -> Iterator[Cycle]:
    d = Decoder(p)
    for f in frames:
        if (c := d.frame(f.cob_id, f.data, f.t)) is not None:
            yield c


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("on_change", [True, False])
def test_what_was_sent_is_read_whatever_the_nodes_carry(axes: int, on_change: bool, tmp_path: Path) -> None:
    p = profile(tmp_path, axes, on_change, "sync_id = 0x0F0\nsync_overflow = 240")
    rows, frames = heard(p)
    assert {f.cob_id for f in frames} >= {0x0F0} and 0x080 not in {f.cob_id for f in frames}
    cycles = list(decoded(p, frames))
    # what changes with the first cycle comes after its other frames
    assert len(cycles) == len(rows)
    for cycle, values in zip(cycles[1:], rows[1:], strict=True):
        for name in ("q", "dq", "tau"):
            row = SIGNALS.index(name)
            assert np.all(np.abs(cycle.values[row] - values[row]) <= p.quantum(name) * (1 + 1e-9) + 1e-15), name
    assert sample_of(cycles[-1], 0).powered
    if on_change:
        sent = [f for f in frames if f.cob_id in {m.cob_id for m in Decoder(p).maps.values() if not m.synchronous}]
        assert len(sent) == 6, "once per joint"


def test_a_status_that_changes_is_in_force_and_one_never_heard_is_no_operation(tmp_path: Path) -> None:
    p = profile(tmp_path)
    _, frames = heard(p)
    slow = {m.cob_id for m in Decoder(p).maps.values() if not m.synchronous}
    quiet = [f for f in frames if f.cob_id not in slow]
    assert not any(sample_of(c, 0).powered for c in decoded(p, quiet))
    at = next(i for i, f in enumerate(frames) if f.t > 0.1)
    off = Frame(min(slow), (0x40).to_bytes(2, "little"), frames[at].t)
    states = [sample_of(c, 0).powered for c in decoded(p, [*frames[:at], off, *frames[at:]])]
    assert states[10] and not states[-1]


def test_a_position_that_comes_on_change_is_refused(tmp_path: Path) -> None:
    p = profile(tmp_path)
    text = p.dcf.read_text()
    p.dcf.write_text(text.replace("[1800sub2]\nParameterName=s2\nObjectType=0x7\nDataType=0x5\nAccessType=rw\nDefaultValue=1",
                                  "[1800sub2]\nParameterName=s2\nObjectType=0x7\nDataType=0x5\nAccessType=rw\nDefaultValue=255"))  # fmt: skip
    assert p.dcf.read_text() != text
    with pytest.raises(BusError, match=r"q, dq of j1 is in no synchronous TPDO .* have the master map"):
        Decoder(p)


@pytest.mark.parametrize(
    ("nodes", "word"),
    [("j1 = {node = 3, axis = 9}", "axis 9"), ("j1 = 3\nj2 = {node = 3, axis = 0}", "axes of one node"), ("j1 = {id = 3}", "unknown key")],
)  # fmt: skip
def test_places_that_cannot_be_are_refused(nodes: str, word: str, tmp_path: Path) -> None:
    profile(tmp_path)
    path = tmp_path / "arm.toml"
    path.write_text(re.sub(r"\[nodes\]\n(?:j.*\n)+", f"[nodes]\n{nodes}\n", path.read_text()))
    with pytest.raises(BusError, match=word):
        load_profile(path)


def test_a_tpdo_of_which_nobody_says_how_much_it_maps_is_passed_over(tmp_path: Path) -> None:
    """As makers' files leave those that are not in use; it must not cost the others, nor stand for what it may map."""
    profile(tmp_path, axes=1)
    path = tmp_path / "drive.eds"
    text, unsaid = path.read_text(), "[1A02sub0]\nParameterName=s0\nObjectType=0x7\nDataType=0x5\nAccessType=rw\nDefaultValue="
    assert unsaid + "1" in text
    path.write_text(text.replace(unsaid + "1", unsaid))
    with pytest.raises(BusError, match="status of j1 is in no TPDO"):
        Decoder(load_profile(tmp_path / "arm.toml"))
    whole = (tmp_path / "arm.toml").read_text()
    (tmp_path / "arm.toml").write_text(whole[: whole.index("[signals.status]")])
    assert not check_profile(load_profile(tmp_path / "arm.toml")).wrong


def test_a_second_family_of_drives_is_read_to_half_a_count() -> None:
    p = load_profile(ELMO)
    assert not check_profile(p).wrong
    rows, frames = heard(p)
    cycles = list(decoded(p, frames))
    assert len(cycles) > 50
    for k, c in enumerate(cycles):
        for name in ("q", "dq", "tau"):
            i = SIGNALS.index(name)
            assert np.all(np.abs(c.values[i] - rows[k][i]) <= p.quantum(name) * (1 + 1e-6))
    assert not set(p.joints) & set(load_profile("lwa4p/monitor").joints), "an example's numbers fit no model"


# ---- the check


@pytest.mark.parametrize("name", shipped_profiles())
def test_shipped_profiles_pass_their_check(name: str) -> None:
    assert not check_profile(load_profile(name)).wrong


def test_the_longest_frame_is_that_of_the_standard() -> None:
    assert bits(8) == 135 and bits(0) == 55


def test_a_log_shows_what_does_not_fit(tmp_path: Path) -> None:
    p = profile(tmp_path, more="sync_overflow = 240")
    _, frames = heard(p, 200)

    def wrong(other: Profile, log: list[Frame]) -> str:
        out = check_profile(other)
        against_log(out, other, log)
        return "; ".join(out.wrong)

    assert not wrong(p, frames)
    assert "every 4 ms; expected cycle_s = 10 ms" in wrong(replace(p, cycle_s=0.010), frames)
    assert "0 SYNC on 0x0F0" in wrong(replace(p, sync_id=0x0F0), frames)
    assert "nothing was heard on 0x185" in wrong(p, [f for f in frames if f.cob_id != 0x185])
    dq = p.signals["dq"]
    degrees = replace(p, signals={**p.signals, "dq": replace(dq, scale=dq.scale * np.array([1, 1, -1, 1, 1, 1]))})
    assert "j3 turns by -1 times what its speed says" in wrong(degrees, frames)


def test_the_command_answers_with_its_exit_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.json"
    assert main(["profile", "check", "lwa4p/monitor", "--json", str(out), "--report", str(tmp_path / "r.html")]) == 0
    said = json.loads(out.read_text())
    assert said["usable"] and len(said["frames"]) == 12 and 0.5 < said["bus_load"] < 1.0
    profile(tmp_path)
    log = tmp_path / "empty.log"
    log.write_text("(1.000000) can0 123#00\n")
    assert main(["profile", "check", str(tmp_path / "arm.toml"), "--log", str(log)]) == 1
    assert "wrong: the log holds 0 SYNC" in capsys.readouterr().out
    assert main(["profile", "check", str(tmp_path / "none.toml")]) == 2


# ---- links from outside


class Outside:
    """A link of another package: what is talked is heard."""

    def __init__(self) -> None:
        self.sent: list[Frame] = []

    def listen(self, channel: str) -> Any:
        return self

    def talk(self, channel: str) -> Any:
        return self

    def send(self, cob_id: int, data: bytes) -> None:
        self.sent.append(Frame(cob_id, data, 0.0))

    def recv(self, timeout: float) -> Frame | None:
        return self.sent.pop(0) if self.sent else None

    def close(self) -> None:
        pass


LINK = Outside()


def registered(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.setattr(bus, "entry_points", lambda group: [EntryPoint(name, value, group)])
    bus.registered.cache_clear()


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    yield
    bus.registered.cache_clear()


def test_a_link_from_outside_is_one_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    registered(monkeypatch, "telepathy", f"{__name__}:LINK")
    bus.talk("telepathy:here").send(0x80, b"\x01")
    frame = bus.listen("telepathy:here").recv(0.0)
    assert frame is not None and frame.cob_id == 0x80
    assert bus.may_hold_a_robot("telepathy:here"), "who knows what is behind it"


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [("hub", f"{__name__}:LINK", "name of another"), ("x", f"{__name__}:DT", "no link"), ("x", "nowhere:X", "cannot be loaded")],
)
def test_links_that_cannot_be_used_are_named(name: str, value: str, word: str, monkeypatch: pytest.MonkeyPatch) -> None:
    registered(monkeypatch, name, value)
    with pytest.raises(BusError, match=word):
        bus.parse("x:1")
