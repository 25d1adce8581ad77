"""A unit is signed as a model is: a changed byte, another key, an older revision or a model's signature are refused in one sentence."""

from __future__ import annotations

import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from fmu_models import arm_model
from stopset.artifact import Revision, load_model, save_model
from stopset.artifact.signature import ORIGIN, Accepted, NotTrusted, new_key, sign, signature_path, verified
from stopset.cli.main import main
from stopset.errors import ModelFileError
from stopset.fmu import Contents, export
from stopset.fmu.build import native

pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = pytest.mark.skipif(native() is None, reason="no FMU binaries for this platform")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A unit of revision 1, and two keys."""
    folder = tmp_path_factory.mktemp("signed")
    model = replace(arm_model(2, horizon=0.5), revisions=tuple(Revision(k, "", {}, {}) for k in range(2)))
    save_model(model, folder / "m.json")
    export(load_model(folder / "m.json"), folder / "F.fmu", Contents(3, (str(native()),)))
    for name in ("release", "foreign"):
        new_key(folder / name)
    return folder


@pytest.fixture
def cell(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "cell"))


def sentence(capsys: pytest.CaptureFixture[str]) -> str:
    said = capsys.readouterr()
    text = said.out + said.err
    assert text.count("\n") == 1
    return text


def test_a_unit_is_signed_and_verified_by_command(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fmu, key = str(cell / "F.fmu"), ["--key", str(cell / "release.pub")]
    assert main(["verify", fmu, *key]) == 1 and "is not signed" in sentence(capsys)
    assert main(["sign", fmu, "--key", str(cell / "release")]) == 0 and "revision 1 of test arm signed" in sentence(capsys)
    assert main(["verify", fmu, *key]) == 0 and "signed by an accepted key, unchanged" in sentence(capsys)
    assert main(["verify", fmu, "--key", str(cell / "foreign.pub")]) == 1 and "is signed by the key" in sentence(capsys)
    assert main(["verify", fmu, *key, "--least-revision", "2"]) == 1 and "an older unit is not taken back" in sentence(capsys)
    data = bytearray((cell / "F.fmu").read_bytes())
    data[len(data) // 2] ^= 1
    (cell / "F.fmu").write_bytes(data)
    assert main(["verify", fmu, *key]) == 1 and "is not the file that was signed" in sentence(capsys)


def test_a_signature_of_another_kind_is_none(cell: Path) -> None:
    """The statement of a model signed by the same key, put beside a unit with the same hash in it."""
    accepted = Accepted.of([cell / "release.pub"])
    sign(cell / "F.fmu", cell / "release")
    assert verified(cell / "F.fmu", accepted).robot == "test arm"
    renamed = cell / "F.bin"
    shutil.copy(cell / "F.fmu", renamed)
    shutil.copy(signature_path(cell / "F.fmu"), signature_path(renamed))
    with pytest.raises(NotTrusted, match="does not hold what the key"):
        verified(renamed, accepted)


def test_what_is_no_unit_is_not_signed(cell: Path) -> None:
    (cell / "G.fmu").write_bytes(b"PK\x05\x06 no archive")
    with pytest.raises(ModelFileError, match="no unit that says which model it is of"):
        sign(cell / "G.fmu", cell / "release")
    assert not signature_path(cell / "G.fmu").exists()


def test_a_unit_says_its_model_and_check_fmu_says_its_signature(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:

    with zipfile.ZipFile(cell / "F.fmu") as z:
        said = json.loads(z.read(ORIGIN))
    assert said["revision"] == 1 and said["robot"] == "test arm" and said["model_sha256"] == load_model(cell / "m.json").sha256
    fmu, wrong = str(cell / "F.fmu"), ["--key", str(cell / "foreign.pub")]
    assert main(["check-fmu", fmu]) == 0 and "signature: none" in capsys.readouterr().out
    assert main(["check-fmu", fmu, *wrong]) == 1 and "is not signed" in capsys.readouterr().out
    sign(cell / "F.fmu", cell / "release")
    assert main(["check-fmu", fmu]) == 0 and "signature: names the key" in capsys.readouterr().out
    assert main(["check-fmu", fmu, "--key", str(cell / "release.pub")]) == 0 and "by an accepted key" in capsys.readouterr().out
    assert main(["check-fmu", fmu, *wrong]) == 1 and "is signed by the key" in capsys.readouterr().out
