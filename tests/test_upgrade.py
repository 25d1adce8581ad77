"""Two versions of the product, each from a wheel of its own, take each other's place under a running cell: `deploy/checks/upgrade.sh`."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from monitor_arm import known_model, meta, motion
from monitor_process import free_port, running, write_config
from stopset.artifact import save_model
from stopset.recording import write_recordings

ROOT = Path(__file__).resolve().parents[1]
UPGRADE = ROOT / "deploy/checks/upgrade.sh"
SOURCES = ("model", "offline", "monitor", "fmu", "pyproject.toml", "hatch_build.py", "README.md", "LICENSE")
# the next version reads models of another schema, and those alone
NEXT = (
    ("pyproject.toml", r'^version = ".*"', 'version = "999.0"'),
    ("model/stopset/artifact/model.py", r"^SCHEMA_VERSION = \d+", "SCHEMA_VERSION = 999"),
    ("model/stopset/artifact/store.py", r"^    1,$", "    999,"),
)
# what systemd does of it here: ends the daemon, waits until it is gone, and starts what the link leads to
CTL = """#!/bin/sh
if [ -f {pid} ]; then
  kill "$(cat {pid})" 2> /dev/null
  while grep -q '^State:.[^ZX]' "/proc/$(cat {pid})/status" 2> /dev/null; do sleep 0.05; done
fi
{link}/bin/stopset monitor --config {config} > {log} 2>&1 &
echo $! > {pid}
"""


@dataclass(frozen=True)
class Machine:
    """A machine's program link, configuration and daemon, in a folder."""

    folder: Path

    @property
    def link(self) -> Path:
        return self.folder / "stopset"

    @property
    def pid(self) -> int:
        return int((self.folder / "pid").read_text())

    def upgrade(self, *words: Path | str) -> subprocess.CompletedProcess[str]:
        own = {"STOPSET_LINK": self.link, "STOPSET_CONFIG": self.folder / "monitor.toml", "SYSTEMCTL": self.folder / "ctl"}
        given = {**os.environ, **{k: str(v) for k, v in own.items()}, "PATIENCE": "12", "PAUSE": "0"}
        return subprocess.run(["sh", UPGRADE, *words], env=given, capture_output=True, text=True, check=False)

    def runs(self) -> str:
        """The version whose compiled core the daemon has open."""
        (folder,) = set(re.findall(r"(\S+)/lib/\S+/stopset_core\.so", Path(f"/proc/{self.pid}/maps").read_text()))
        return Path(folder).name


def installed(folder: Path, changes: tuple[tuple[str, str, str], ...]) -> Path:
    """A version in ``folder``: its sources with ``changes``, made into a wheel, installed beside this Python's other packages."""
    sources = folder / "sources"
    sources.mkdir(parents=True)
    for name in SOURCES:
        kind = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        kind(ROOT / name, sources / name)
    for name, pattern, words in changes:
        text, n = re.subn(pattern, words, (sources / name).read_text(), flags=re.MULTILINE)
        assert n == 1, name
        (sources / name).write_text(text)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    made = subprocess.run(
        [*pip, "wheel", "--no-deps", "--wheel-dir", folder, sources], capture_output=True, text=True, check=False
    )
    if made.returncode and "No matching distribution found for hatchling" in made.stderr:
        pytest.skip("no package index answers: no wheel can be made")
    assert made.returncode == 0, made.stderr[-2000:]
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    (there,) = (p for p in Path(sys.prefix).glob("lib/python3*/site-packages"))
    (here,) = folder.glob("lib/python3*/site-packages")
    for entry in there.iterdir():
        if "stopset" not in entry.name:
            (here / entry.name).symlink_to(entry)
    (wheel,) = folder.glob("*.whl")
    subprocess.run([*pip, "--python", folder / "bin/python", "install", "--no-deps", "--no-index", wheel], check=True)
    return folder


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[Machine]:
    made = Machine(tmp_path)
    yield made
    with suppress(OSError, ValueError):
        os.kill(made.pid, signal.SIGTERM)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="the daemon's version is read from /proc")
def test_two_versions_take_each_others_place_and_the_wrong_model_brings_the_old_one_back(machine: Machine) -> None:
    tmp = machine.folder
    old, new = installed(tmp / "old", ()), installed(tmp / "new", NEXT)
    save_model(known_model(), tmp / "arm.model.json")
    write_recordings(tmp / "rec.parquet", meta(), [motion(s, 500, s) for s in range(2)])
    bus, port = free_port(), free_port()
    source, patient = f'[bus]\nlink = "hub:{bus}"\nwait_s = 60', "valid_for_ms = 1000\nstale_ms = 2000"
    config = write_config(tmp, tmp / "arm.model.json", source, port, publish=patient)
    made = "from monitor_arm import known_model; from stopset.artifact import save_model; save_model(known_model(), r'{}')"
    words = [new / "bin/python", "-c", made.format(tmp / "new.model.json")]
    subprocess.run(words, env={**os.environ, "PYTHONPATH": str(ROOT / "tests")}, check=True)
    machine.link.symlink_to(old)
    (tmp / "ctl").write_text(CTL.format(pid=tmp / "pid", link=machine.link, config=config, log=tmp / "log"))
    (tmp / "ctl").chmod(0o755)
    subprocess.run([tmp / "ctl", "restart"], check=True)
    before = (tmp / "arm.model.json").read_text()
    with running("replay", str(tmp / "rec.parquet"), "--to", f"hub:{bus}", "--wait", "1", "--loop"):
        # it does not read the model of today
        done = machine.upgrade(new)
        assert done.returncode == 1 and "old is back" in done.stderr, done.stdout + done.stderr + (tmp / "log").read_text()
        assert machine.link.resolve() == old and machine.runs() == "old"
        # with a model of its own it takes over
        done = machine.upgrade(new, tmp / "new.model.json")
        assert done.returncode == 0, done.stdout + done.stderr + (tmp / "log").read_text()
        assert machine.runs() == "new" and '"schema": 999' in (tmp / "arm.model.json").read_text()
        # and gives its place back, by the words that it said
        done = machine.upgrade(*done.stdout.rpartition("back with: upgrade.sh ")[2].split())
        assert done.returncode == 0, done.stdout + done.stderr + (tmp / "log").read_text()
        assert machine.runs() == "old" and (tmp / "arm.model.json").read_text() == before
