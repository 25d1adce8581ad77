"""Signed models: what is refused, each in one sentence, by the commands, the daemon's configuration, and its helper process."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_arm import known_model
from stopset.artifact import Revision, load_model, save_model
from stopset.artifact.signature import Accepted, NotTrusted, SigningKeyError, load_trusted, new_key, sign, signature_path
from stopset.cli.main import main
from stopset.errors import ModelFileError, OutputError
from stopset.monitor.config import load_config
from stopset.monitor.service import trusted
from stopset.sets import Box


def revised(number: int) -> Any:
    return dataclasses.replace(known_model(), revisions=tuple(Revision(k, "", {}, {}) for k in range(number + 1)))


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """A folder with a signed model of revision 2, the key that signed it, and another key."""
    new_key(tmp_path / "release")
    new_key(tmp_path / "foreign")
    save_model(revised(2), tmp_path / "m.json")
    sign(tmp_path / "m.json", tmp_path / "release")
    return tmp_path


def accepted(cell: Path, name: str = "release", least: int = 0) -> Accepted:
    return Accepted.of([cell / f"{name}.pub"], least)


def test_a_signed_model_is_taken_as_it_is(cell: Path) -> None:
    assert load_trusted(cell / "m.json", accepted(cell)).sha256 == load_model(cell / "m.json").sha256
    assert load_trusted(cell / "m.json", accepted(cell, least=2)).n == 6
    both = Accepted.of([cell / "foreign.pub", cell / "release.pub"])
    assert load_trusted(cell / "m.json", both).n == 6


def unsigned(cell: Path) -> None:
    signature_path(cell / "m.json").unlink()


def foreign(cell: Path) -> None:
    sign(cell / "m.json", cell / "foreign")


def one_byte(cell: Path) -> None:
    """In the file, where its meaning does not even change."""
    (cell / "m.json").write_bytes((cell / "m.json").read_bytes() + b"\n")


def wider(cell: Path) -> None:
    """U a thousandfold with a recomputed hash: the file is whole in itself, and a monitor would never see a violation."""
    model = load_model(cell / "m.json")
    wide = dataclasses.replace(model.powered, U=Box(1000 * model.powered.U.lo, 1000 * model.powered.U.hi))
    save_model(dataclasses.replace(model, sets={"powered": wide}), cell / "m.json")
    assert load_model(cell / "m.json").powered.U.hi[0] > 100


def older(cell: Path) -> None:
    save_model(revised(1), cell / "m.json")
    sign(cell / "m.json", cell / "release")


def claimed(cell: Path) -> None:
    """The signature's own words changed to fit a changed file."""
    wider(cell)
    import hashlib

    p = signature_path(cell / "m.json")
    body = json.loads(p.read_text())
    body["file_sha256"] = hashlib.sha256((cell / "m.json").read_bytes()).hexdigest()
    p.write_text(json.dumps(body))


def renamed_key(cell: Path) -> None:
    """Signed by the foreign key under the accepted one's name."""
    wanted = json.loads(signature_path(cell / "m.json").read_text())["key"]
    foreign(cell)
    p = signature_path(cell / "m.json")
    p.write_text(json.dumps(json.loads(p.read_text()) | {"key": wanted}))


def of_another_model(cell: Path) -> None:
    old = signature_path(cell / "m.json").read_bytes()
    save_model(revised(3), cell / "m.json")
    signature_path(cell / "m.json").write_bytes(old)


def rubbish(cell: Path) -> None:
    signature_path(cell / "m.json").write_bytes(b"[" * 50_000)


def cut(cell: Path) -> None:
    p = signature_path(cell / "m.json")
    p.write_text(p.read_text()[:-30])


SPOILS: dict[str, tuple[Callable[[Path], None], str]] = {
    "unsigned": (unsigned, "is not signed"), "foreign key": (foreign, "signed by the key"),
    "a changed byte": (one_byte, "not the file that was signed"),
    "sets widened, hash made anew": (wider, "not the file that was signed"),
    "older revision": (older, "is revision 1; expected at least 2"),
    "the signature's words changed": (claimed, "does not hold what the key"), "under another's name": (renamed_key, "does not hold what the key"),
    "of another model": (of_another_model, "not the file that was signed"), "rubbish": (rubbish, "no signature"), "cut": (cut, "no signature"),
}  # fmt: skip


@pytest.mark.parametrize("what", SPOILS)
def test_what_is_not_trusted_is_refused_in_one_sentence(cell: Path, what: str, capsys: pytest.CaptureFixture[str]) -> None:
    spoil, says = SPOILS[what]
    spoil(cell)
    with pytest.raises(NotTrusted, match=says):
        load_trusted(cell / "m.json", accepted(cell, least=2))
    words = ["verify", str(cell / "m.json"), "--key", str(cell / "release.pub"), "--least-revision", "2"]
    assert main([*words, "--json", str(cell / "a.json"), "--report", str(cell / "a.html")]) == 1
    reported = capsys.readouterr()
    assert says in reported.out and len(reported.out.strip().splitlines()) == 1 and not reported.err
    answer = json.loads((cell / "a.json").read_text())
    assert answer["trusted"] is False and says in answer["why"] and "Monitoring aid" in (cell / "a.html").read_text()


CONFIG = """
model = "m.json"
data_id = 7
[joint_states]
key = "a/b"
cycle_s = 0.004
[signed]
keys = ["release.pub"]
least_revision = 2
"""


@pytest.mark.parametrize("what", SPOILS)
def test_the_daemon_takes_what_its_configuration_accepts_and_nothing_else(cell: Path, what: str) -> None:
    (cell / "c.toml").write_text(CONFIG)
    load = trusted(load_config(cell / "c.toml"))
    assert load().n == 6
    SPOILS[what][0](cell)
    with pytest.raises(NotTrusted, match=SPOILS[what][1]):
        load()  # as on SIGHUP


def test_without_keys_everything_is_as_before_but_for_the_revision(cell: Path) -> None:
    unsigned(cell)
    (cell / "c.toml").write_text(CONFIG.replace('keys = ["release.pub"]\n', ""))
    assert trusted(load_config(cell / "c.toml"))().n == 6
    save_model(revised(0), cell / "m.json")
    with pytest.raises(NotTrusted, match="is revision 0"):
        trusted(load_config(cell / "c.toml"))()


def test_the_stop_bounds_are_of_the_model_that_is_watched(cell: Path) -> None:
    """The file may change between the daemon's look and its helper's, or before the helper is started again."""
    import threading
    from multiprocessing import Pipe

    from stopset.monitor.config import Stops
    from stopset.monitor.stopworker import work

    watched = load_model(cell / "m.json").sha256
    wider(cell)
    mine, theirs = Pipe()
    args = (str(cell / "m.json"), watched, 0.0, Stops(("0",)), ("0",), theirs)
    worker = threading.Thread(target=work, args=args)
    worker.start()
    assert mine.recv() is None, "ready"
    mine.send(("0", np.full(12, -0.01), np.full(12, 0.01)))
    numbers = mine.recv().numbers
    mine.send(None)
    worker.join()
    assert not numbers.provable.any() and "another model now" in numbers.why


def test_keys_and_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_model(known_model(), tmp_path / "m.json")
    before = (tmp_path / "m.json").read_bytes()
    assert main(["sign", str(tmp_path / "m.json"), "--new-key", str(tmp_path / "k"), "--json", str(tmp_path / "a.json")]) == 0
    assert (tmp_path / "m.json").read_bytes() == before, "the model itself is not touched"
    assert (tmp_path / "k").stat().st_mode & 0o777 == 0o600 and b"PRIVATE" in (tmp_path / "k").read_bytes()
    assert main(["verify", str(tmp_path / "m.json"), "--key", str(tmp_path / "k.pub")]) == 0
    assert json.loads((tmp_path / "a.json").read_text())["revision"] == 0
    with pytest.raises(OutputError, match="exists already"):
        new_key(tmp_path / "k")
    (tmp_path / "k").chmod(0o640)
    with pytest.raises(SigningKeyError, match="chmod 600"):
        sign(tmp_path / "m.json", tmp_path / "k")
    for argv, says in (
        (["sign", str(tmp_path / "m.json")], "--key FILE are needed"),
        (["sign", str(tmp_path / "none.json"), "--key", str(tmp_path / "k")], "no such file"),
        (["sign", str(tmp_path / "m.json"), "--key", str(tmp_path / "m.json")], "is no secret key"),
        (["sign", str(tmp_path / "m.json"), "--key", str(tmp_path / "k.pub")], "is no secret key"),
        (["verify", str(tmp_path / "m.json"), "--key", str(tmp_path / "k")], "is no public key"),
        (["verify", str(tmp_path / "m.json"), "--key", str(tmp_path / "no.pub")], "no such file"),
        (["verify", str(tmp_path / "none.json"), "--key", str(tmp_path / "k.pub")], "no such file"),
    ):
        capsys.readouterr()
        assert main(argv) == 2
        err = capsys.readouterr().err
        assert says in err and len(err.strip().splitlines()) == 1


def test_every_bit_of_the_file_counts(cell: Path) -> None:
    """A flip of any of some bits over the whole file, and over the whole signature."""
    keys = accepted(cell)
    for path in (cell / "m.json", signature_path(cell / "m.json")):
        data = path.read_bytes()
        for at in range(0, len(data), max(1, len(data) // 60)):
            spoiled = bytearray(data)
            spoiled[at] ^= 1 << (at % 7)
            path.write_bytes(bytes(spoiled))
            if path.suffix == ".sig":
                try:  # white space in the signature's file is no part of what it says
                    same = json.loads(spoiled) == json.loads(data)
                except ValueError:
                    same = False
                if same:
                    continue
            with pytest.raises(ModelFileError):
                load_trusted(cell / "m.json", keys)
        path.write_bytes(data)


def test_a_key_with_a_passphrase_signs_with_it_alone(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whoever has the file alone signs nothing; each mistake is one sentence, and no signature is written."""
    (cell / "word").write_text("hose and cable\nsecond line\n")
    (cell / "wrong").write_text("guessed\n")
    (cell / "empty").write_text("\n")
    signature_path(cell / "m.json").unlink()
    assert main(["sign", "--new-key", str(cell / "locked"), "--passphrase", str(cell / "word")]) == 0
    assert b"ENCRYPTED" in (cell / "locked").read_bytes()
    asked = ["sign", str(cell / "m.json"), "--key"]
    for key, more, says in (
        ("locked", [], "asks for a passphrase"), ("locked", ["--passphrase", str(cell / "wrong")], "not its passphrase"),
        ("release", ["--passphrase", str(cell / "word")], "has no passphrase"), ("locked", ["--passphrase", str(cell / "none")], "cannot be read"),
        ("locked", ["--passphrase", str(cell / "empty")], "is empty"),
    ):  # fmt: skip
        assert main([*asked, str(cell / key), *more]) == 2
        assert says in capsys.readouterr().err and not signature_path(cell / "m.json").exists()
    # one wrong passphrase in some hundred unpacks the key to what another error is raised for, as a damaged file does
    lines = (cell / "locked").read_text().splitlines(keepends=True)
    (cell / "damaged").write_text("".join([*lines[:-2], lines[-2].swapcase(), lines[-1]]))
    assert main([*asked, str(cell / "damaged"), "--passphrase", str(cell / "word")]) == 2
    assert "not its passphrase, or the file is damaged" in capsys.readouterr().err
    assert main([*asked, str(cell / "locked"), "--passphrase", str(cell / "word")]) == 0
    assert load_trusted(cell / "m.json", accepted(cell, "locked")).n == 6


def test_the_page_of_a_signature_is_the_model_card(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whoever releases a model reads where it holds, what it consists of and what was seen of it, of that model."""
    model = load_model(cell / "m.json")
    assert main(["sign", str(cell / "m.json"), "--key", str(cell / "release"), "--report", str(cell / "card.html")]) == 0
    capsys.readouterr()
    said = " ".join(re.sub(r"<[^>]+>", " ", (cell / "card.html").read_text(encoding="utf-8")).replace("\u00a0", " ").split())
    assert model.sha256 in said and model.guarantee.text in said and "Not a safety function" in said
    for k, joint in enumerate(model.joints):
        assert f"{joint} {model.domain.q.lo[k]:.4g} to {model.domain.q.hi[k]:.4g}" in said
    for e in model.effects:
        assert all(f"{name} {value:.4g}" in said for name, value in e.values.items())
    assert "released by" in said and "signature" in said
