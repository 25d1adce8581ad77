"""Who may clear a latched violation: orders signed by a key, each good once, for one arm, and now; the log holds the key's name."""

from __future__ import annotations

import time
from pathlib import Path

import msgspec
import pytest

from monitor_arm import known_model, meta, motion, with_torque_scaled
from monitor_process import DATA_ID, Ear, free_port, running, write_config
from stopset.artifact import save_model
from stopset.artifact.signature import new_key
from stopset.cli.main import main
from stopset.monitor.config import Operator
from stopset.monitor.layout import unpack
from stopset.monitor.operators import LIVES, WRAP, Moment, Operators, about, look, signed
from stopset.monitor.orders import Reset, parse_reset
from stopset.recording import write_recordings

NOW = Moment(data_id=7, boot_id=2**63 + 5, seq=10_000)
ORDER = Reset.of("whoever", "hose refitted")


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    for name in ("smith", "stranger"):
        new_key(tmp_path / name)
    return tmp_path


def people(keys: Path) -> Operators:
    return Operators.of([Operator("A. Smith", str(keys / "smith.pub"))])


def test_a_signed_order_is_good_once_and_in_the_keys_name(keys: Path) -> None:
    who, order = people(keys), signed(ORDER, NOW, keys / "smith")
    later = msgspec.structs.replace(order)
    assert parse_reset(order.text()) == order, "nothing is lost on the way"
    now = Moment(NOW.data_id, NOW.boot_id, NOW.seq + 3)
    assert who.refused(order, now) == "" and who.name(order) == "A. Smith"
    assert "obeyed already" in who.refused(later, Moment(NOW.data_id, NOW.boot_id, NOW.seq + 50))
    fresh = signed(ORDER, Moment(NOW.data_id, NOW.boot_id, NOW.seq + 40), keys / "smith")
    assert who.refused(fresh, Moment(NOW.data_id, NOW.boot_id, NOW.seq + 50)) == "", "the next one is taken again"


def test_the_count_of_messages_may_begin_anew(keys: Path) -> None:
    who, seen = people(keys), Moment(7, 1, WRAP - 2)
    order = signed(ORDER, seen, keys / "smith")
    assert who.refused(order, Moment(7, 1, 1 + WRAP)) == "" and "obeyed already" in who.refused(order, Moment(7, 1, 9 + WRAP))


@pytest.mark.parametrize("proven", [True, False])
def test_an_order_clears_no_violation_after_the_message_it_is_about(keys: Path, proven: bool) -> None:
    who = people(keys) if proven else Operators()
    seen, now = Moment(7, 1, WRAP - 2), Moment(7, 1, 5 + WRAP)
    order = signed(ORDER, seen, keys / "smith") if proven else about(ORDER, seen)
    for violated in (now.seq, WRAP - 1):
        assert "after the message" in who.refused(order, now, violated)
    assert who.refused(order, now, WRAP - 2) == "", "this one was told in the message that was seen"


def test_an_unsigned_order_that_names_a_message_is_good_once_and_now(keys: Path) -> None:
    who = Operators()
    assert who.refused(ORDER, NOW, NOW.seq) == "", "it names none: whatever is latched when it comes"
    order = about(ORDER, NOW)
    assert "earlier life" in who.refused(order, Moment(NOW.data_id, NOW.boot_id + 1, NOW.seq))
    assert who.refused(order, NOW) == "" and "obeyed already" in who.refused(order, NOW)


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("unsigned", "not signed"), ("stranger", "no operator's"), ("reason", "not what A. Smith signed"), ("name", "not what A. Smith"),
        ("seq", "not what A. Smith"), ("arm", "another arm"), ("life", "earlier life"), ("old", "long ago"), ("ahead", "long ago"),
        ("rubbish", "not what A. Smith"), ("stolen name", "no operator's"),
    ],
)  # fmt: skip
def test_what_is_no_order_of_an_operator_is_refused(keys: Path, what: str, said: str) -> None:
    who, order, seen = people(keys), signed(ORDER, NOW, keys / "smith"), NOW
    if what == "unsigned":
        order = ORDER
    elif what in ("stranger", "stolen name"):
        order = signed(Reset.of("A. Smith", "x"), NOW, keys / "stranger")
    elif what in ("reason", "name"):
        order = msgspec.structs.replace(order, **{what: "something else"})
    elif what == "seq":
        order = msgspec.structs.replace(order, seq=order.seq + 1)
    elif what == "arm":
        seen = Moment(8, NOW.boot_id, NOW.seq)
    elif what == "life":
        seen = Moment(7, NOW.boot_id + 1, NOW.seq)
    elif what == "old":
        seen = Moment(7, NOW.boot_id, NOW.seq + LIVES + 1)
    elif what == "ahead":
        seen = Moment(7, NOW.boot_id, NOW.seq - 1)
    else:
        order = msgspec.structs.replace(order, signature="\N{SNOWMAN}")
    assert said in who.refused(order, seen)


ONE = '[[operators]]\nname = "A"\nkey = "smith.pub"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[[operators]]\nname = "A"\n', "lacks key"), ('[[operators]]\nkey = "smith.pub"\n', "lacks name"),
        ("[[operators]]\n", "lacks key, name"), (ONE + 'role = "boss"\n', "unknown key role"),
        ('[operators]\nname = "A"\nkey = "smith.pub"\n', "each headed [[operators]]"), ('operators = "A"\n', "expected a list"),
        ('operators = ["A"]\n', "expected a table"), ("operators = []\n", "operators is empty"),
        (ONE.replace('"A"', '" "'), "1 to 200 letters"), (ONE.replace('"A"', f'"{"x" * 201}"'), "1 to 200 letters"),
        (ONE.replace('"A"', '"A\\u001b[31m"'), "control characters"), (ONE.replace('"A"', "3"), "expected str"),
        (ONE + ONE.replace('"A"', '"A "').replace("smith", "stranger"), "each once"),
        (ONE + ONE.replace('"A"', '"B"'), "have one key"), (ONE + ONE.replace('"A"', '"B"').replace("smith", "copy"), "have one key"),
        (ONE.replace("smith", "nobody"), "no such file"), (ONE.replace("smith.pub", "smith"), "no public key"),
        (ONE.replace("smith.pub", ""), "no public key"), (ONE.replace("smith.pub", "rubbish"), "no public key"),
        (ONE.replace("smith.pub", "."), "no public key"), (ONE.replace('"smith.pub"', '["smith.pub"]'), "expected str"),
    ],
)  # fmt: skip
def test_operators_that_are_none_are_refused(keys: Path, text: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    """By the monitor itself, before it hears anything: one sentence, and 2."""
    (keys / "copy.pub").write_bytes((keys / "smith.pub").read_bytes())
    (keys / "rubbish").write_text("rubbish")
    save_model(known_model(), keys / "m")
    top, tables = (text, "") if text.startswith("operators") else ("", text)
    config = keys / "c.toml"
    config.write_text(f'model = "m"\ndata_id = 1\n{top}[bus]\nlink = "hub:1"\n{tables}[zenoh]\nlisten = []\n')
    assert main(["monitor", "--config", str(config), "--seconds", "0.1"]) == 2
    reported = capsys.readouterr().err.strip()
    assert said in reported and "\n" not in reported and "Traceback" not in reported


def test_a_real_monitor_is_cleared_by_a_key_alone(keys: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Daemon and replay are processes; an order that was overheard clears nothing again."""
    model, recording, port = keys / "arm.model.json", keys / "rec.parquet", free_port()
    save_model(known_model(), model)
    write_recordings(recording, meta(), [with_torque_scaled(motion(s, 200, s), 2, 1.5) for s in range(2)])
    source = f'[[operators]]\nname = "A. Smith"\nkey = "{keys / "smith.pub"}"\n[joint_states]\nkey = "js"\ncycle_s = 0.004'
    config = write_config(keys, model, source, port)
    to = f"tcp/127.0.0.1:{port}"
    overheard: list[bytes] = []
    with running("monitor", "--config", str(config)), Ear(port) as ear:
        ear.link.subscribe("reset", lambda _, data: overheard.append(data))
        with running("replay", str(recording), "--to", f"zenoh:{to}", "--key", "js"):
            assert ear.wait(lambda: ear.twins and ear.twins[-1]["violation_latched"])
            assert ear.wait(lambda: ear.twins[-1]["samples"] >= 390)
        assert main(["reset", "--connect", to, "--name", "A. Smith", "--reason", "I say so"]) == 1
        assert "the order is not signed" in capsys.readouterr().out
        time.sleep(1.1)  # refusals are told once a second
        assert main(["reset", "--connect", to, "--key", str(keys / "stranger"), "--reason", "me too"]) == 1
        assert "no operator's" in capsys.readouterr().out
        assert ear.twins[-1]["violation_latched"]
        assert (
            main(["reset", "--connect", to, "--key", str(keys / "smith"), "--name", "Somebody", "--reason", "hose refitted"]) == 0
        )
        assert "by A. Smith: hose refitted" in capsys.readouterr().out
        assert ear.wait(lambda: any(e["kind"] == "reset" for e in list(ear.events)))  # it comes by another key than the answer
        (event,) = [e for e in ear.events if e["kind"] == "reset"]
        assert event["name"] == "A. Smith" and event["proven"] is True and len(event["key"]) == 16
        assert ear.wait(lambda: not ear.twins[-1]["violation_latched"])
        ear.events.clear()
        time.sleep(1.1)
        ear.link.put("reset", overheard[-1])
        assert ear.wait(lambda: any("obeyed already" in e.get("why", "") for e in ear.events), 5.0)
        assert unpack(ear.raw[-1])["data_id"] == DATA_ID and not [e for e in ear.events if e["kind"] == "reset"]


@pytest.mark.parametrize("proven", [True, False])
def test_an_order_under_way_when_another_violation_comes_clears_neither(keys: Path, proven: bool) -> None:
    """A person sees a violation and orders; before the order is there the arm leaves its model again, which nobody has seen."""
    model, recording, port = keys / "arm.model.json", keys / "rec.parquet", free_port()
    save_model(known_model(), model)
    write_recordings(recording, meta(), [with_torque_scaled(motion(0, 200), 2, 1.5)])
    source = '[joint_states]\nkey = "js"\ncycle_s = 0.004'
    people = f'[[operators]]\nname = "A. Smith"\nkey = "{keys / "smith.pub"}"\n' if proven else ""
    config = write_config(keys, model, people + source, port)

    def ordered(seen: Moment) -> bytes:
        return (signed(ORDER, seen, keys / "smith") if proven else about(ORDER, seen)).text()

    with running("monitor", "--config", str(config)), Ear(port) as ear:
        counts: list[int] = []
        for _ in range(2):
            with running("replay", str(recording), "--to", f"zenoh:tcp/127.0.0.1:{port}", "--key", "js") as replay:
                replay.wait(timeout=600)
            assert ear.wait(lambda: ear.twins and ear.twins[-1]["violation_count"] > sum(counts))
            counts.append(unpack(ear.raw[-1])["violation_count"])
            if len(counts) == 1:
                seen = look(ear.link)
        ear.link.put("reset", ordered(seen))
        assert ear.wait(lambda: any("reset" in e["kind"] for e in list(ear.events)))
        refused = next(e for e in ear.events if "reset" in e["kind"])
        assert refused["kind"] == "reset_refused" and "after the message" in refused["why"]
        assert unpack(ear.raw[-1])["violation_count"] >= counts[-1], "nothing is forgotten"
        time.sleep(1.1)  # refusals are told once a second
        ear.link.put("reset", ordered(look(ear.link)))
        assert ear.wait(lambda: not ear.twins[-1]["violation_latched"])


def test_nobody_named_is_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reset", "--reason", "x"]) == 2
    assert "neither --name nor --key" in capsys.readouterr().err
