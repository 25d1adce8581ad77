"""One recording of many arms, through a real router: nothing of an event is missing, and what is missing is said."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader

from monitor_process import free_port, listens, running
from patience import rest, wait
from stopset.cli.main import main
from stopset.monitor.evidence.rotation import Rotation
from stopset.monitor.fleet import Fleet, central, terminal
from stopset.monitor.fleet.central import Central
from stopset.monitor.links.zenoh_link import ZenohLink

ARMS = [f"hall/cell{k}/arm" for k in range(3)]


def read(folder: Path) -> list[tuple[str, dict[str, object]]]:
    """Topic and message of all files, in order."""
    found = []
    for path in sorted(folder.glob("record-*.mcap")):
        with path.open("rb") as f:
            found += [(c.topic, json.loads(m.data)) for _, c, m in make_reader(f).iter_messages()]
    return found


def state(word: str) -> bytes:
    return json.dumps({"state": word, "why": "", "stops": {}}).encode()


def test_events_of_all_arms_and_every_change_of_state_are_recorded(tmp_path: Path) -> None:
    """The command as a process would run it; a state that stays is thinned to one a second, never its changes."""
    import threading

    port = free_port()
    router = ZenohLink(mode="router", listen=[f"tcp/127.0.0.1:{port}"])
    try:
        links = [ZenohLink(f"{arm}/stopset", mode="client", connect=[f"tcp/127.0.0.1:{port}"]) for arm in ARMS]
        stop = threading.Event()

        def speak() -> None:
            k = 0
            while not stop.wait(0.02):
                for link in links:
                    link.put("state/json", state("VIOLATION" if k % 50 == 49 else "OK"))
                k += 1
                if k == 100:
                    for n in range(20):
                        for link in links:
                            link.put("event", json.dumps({"kind": "step", "t_ns": n}), must_arrive=True)

        speaker = threading.Thread(target=speak)
        speaker.start()
        words = ["fleet", "--connect", f"tcp/127.0.0.1:{port}", "--port", "0", "--seconds", "5", "--record", str(tmp_path / "r")]
        assert main([*words, "--json", str(tmp_path / "f.json")]) == 0
        stop.set()
        speaker.join()
        for link in links:
            link.close()
    finally:
        router.close()
    said = read(tmp_path / "r")
    for arm in ARMS:
        assert [m["t_ns"] for topic, m in said if topic == f"{arm}/event"] == list(range(20))
        states = [m["state"] for topic, m in said if topic == f"{arm}/state"]
        assert states.count("VIOLATION") >= 2 and len(states) < 20, states
    report = json.loads((tmp_path / "f.json").read_text())["record"]
    assert report["written"] == len(said) and report["lost"] == 0 == report["garbled"] and report["files"] == 1


def test_what_is_ended_as_a_service_is_leaves_a_whole_recording(tmp_path: Path) -> None:
    """SIGTERM within the first chunk of a file, of which nothing is on the disk until it is closed."""
    port, page = free_port(), free_port()
    router = ZenohLink(mode="router", listen=[f"tcp/127.0.0.1:{port}"])
    words = ("fleet", "--connect", f"tcp/127.0.0.1:{port}", "--port", str(page), "--record", str(tmp_path))
    try:
        with running(*words) as fleet:
            assert wait(lambda: listens(page) or fleet.poll() is not None) and fleet.poll() is None
            for k in range(20):
                router.put(f"{ARMS[0]}/stopset/event", json.dumps({"kind": "step", "t_ns": k}), must_arrive=True)
                router.put(f"{ARMS[0]}/stopset/state/json", state("OK"))
                rest(0.05)
        assert fleet.returncode == 0
    finally:
        router.close()
    events = [m["t_ns"] for topic, m in read(tmp_path) if topic.endswith("event")]
    assert events[-1] == 19 and events == list(range(events[0], 20))


def test_a_disk_that_refuses_costs_what_has_no_room_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(central, "WAITING", 5)
    monkeypatch.setattr("stopset.monitor.evidence.rotation.RETRY", 0.3)
    (tmp_path / "r").write_text("no folder")
    c = Central(tmp_path / "r")
    fleet = Fleet(notice=lambda: c.notice)
    for n in range(4):
        c.take(f"{ARMS[0]}/stopset/event", json.dumps({"kind": "early", "n": n}).encode())
    assert wait(lambda: "stands still" in fleet.snapshot()["notice"])
    begin = time.monotonic()
    for n in range(20):
        c.take(f"{ARMS[0]}/stopset/event", json.dumps({"kind": "late", "n": n}).encode())
    assert time.monotonic() - begin < 0.1, "who speaks is never held up"
    (tmp_path / "r").unlink()
    assert wait(lambda: c.written > 0)
    c.close()
    said = read(tmp_path / "r")
    assert [m["n"] for topic, m in said if topic.endswith("/event")] == [15, 16, 17, 18, 19], "the newest are kept"
    assert c.lost == 19 and "19 messages before this one are missing" in str(dict(said)["fleet/log"])
    assert "lacks 19 messages" in fleet.snapshot()["notice"] and terminal(fleet) is not None


def test_names_are_in_order_over_a_full_second_and_a_clock_set_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Seconds and nanoseconds of two readings are a second apart when one ends between them; then the newest file went first."""
    files = Rotation(tmp_path, 0.0, 1.0, "fleet", dict)
    now = [1_800_000_000 * 10**9 + 999_999_990]

    def tick() -> int:
        now[0] += 7  # [ns]
        return now[0]

    monkeypatch.setattr(time, "time_ns", tick)
    real = time.gmtime
    monkeypatch.setattr(time, "gmtime", lambda s=None: real(tick() // 10**9 if s is None else s))
    for k in range(5):
        if k == 4:
            now[0] -= 3 * 10**9
        before = set(tmp_path.iterdir())
        files.write(lambda _: None)
        (new,) = set(tmp_path.iterdir()) - before
        assert new == max(tmp_path.iterdir()), (k, new)
    files.close()


def test_the_oldest_hour_goes_first_and_strangers_words_are_counted(tmp_path: Path) -> None:
    c = Central(tmp_path, file_s=0.0, keep_mb=0.002)
    for n in range(12):
        c.take(f"{ARMS[0]}/stopset/event", json.dumps({"kind": "x", "n": n}).encode())
        assert wait(lambda n=n: c.written == n + 1)
    for spoiled in (b"\xff", b"[" * 5000, b"[1]", b"x" * (1 << 21)):
        c.take(f"{ARMS[0]}/stopset/event", spoiled)
    c.take(f"{ARMS[0]}/stopset/state", b"binary")
    c.close()
    left = [m["n"] for topic, m in read(tmp_path) if topic.endswith("/event")]
    assert left == list(range(left[0], 12)) and 0 < left[0] < 11
    assert c.garbled == 4 and c.lost == 0 and c.files == 12


@pytest.mark.parametrize(("more", "says"), [(["--keep-mb", "0"], "--keep-mb 0"), (["--keep-mb", "nan"], "--keep-mb nan")])
def test_what_cannot_be_kept_is_one_sentence(
    more: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fleet", "--record", str(tmp_path), *more]) == 2
    said = capsys.readouterr().err
    assert says in said and said.count("\n") == 1
