"""The files of deploy/: units that systemd takes, an image pinned and without a compiler, certificates that end, an upgrade that goes back."""

from __future__ import annotations

import json
import os
import re
import shutil
import stat
import subprocess
import sys
import time
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

import pytest

from monitor_arm import known_model, meta, motion, with_torque_scaled
from monitor_process import environment, free_port
from stopset.artifact import save_model
from stopset.errors import BusError
from stopset.monitor.links.zenoh_link import ZenohLink
from stopset.recording import write_recordings

DEPLOY = Path(__file__).resolve().parents[1] / "deploy"
UNITS = ("stopset.service", "stopset-expiry.service", "stopset-router.service")
EXPOSED = 2.0


def sh(*words: object, **more: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(w) for w in words], capture_output=True, text=True, check=False, env={**os.environ, **more})


def image_builder() -> ModuleType:
    """`.ci/image`, a script without a suffix."""
    loader = SourceFileLoader("image_builder", str(DEPLOY.parent / ".ci/image"))
    spec = spec_from_loader(loader.name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    loader.exec_module(module)
    return module


@pytest.fixture
def units(tmp_path: Path) -> Path:
    """The units, their programs replaced by one that is there: systemd asks for that."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not on this machine")
    for file in (DEPLOY / "systemd").iterdir():
        text = re.sub(r"^(Exec\w+=)/(?:opt|usr/bin/zenohd)\S*", r"\1/bin/true", file.read_text(), flags=re.MULTILINE)
        (tmp_path / file.name).write_text(text)
    return tmp_path


def test_systemd_takes_the_units(units: Path) -> None:
    files = [units / name for name in (*UNITS, "stopset-expiry.timer", "stopset.slice")]
    done = sh("systemd-analyze", "verify", "--man=no", "--recursive-errors=no", *files)
    reported = [line for line in done.stderr.splitlines() if "stopset" in line]
    assert reported == [] and done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", UNITS)
def test_the_units_are_shut_in(units: Path, name: str) -> None:
    done = sh("systemd-analyze", "security", "--offline=true", "--json=short", units / name)
    if done.returncode != 0 and "unrecognized" in done.stderr:
        pytest.skip("this systemd-analyze looks at running units only")
    said = sh("systemd-analyze", "security", "--offline=true", units / name).stdout
    level = re.search(r"exposure level for \S+: ([\d.]+)", said)
    assert json.loads(done.stdout) and level is not None and float(level.group(1)) <= EXPOSED, said[-300:]


def test_the_image_is_pinned_without_a_compiler_and_nobodys_root() -> None:
    """Read by a parser; built from the same commands by tests/test_image.py."""
    text = (DEPLOY / "container/Dockerfile").read_text()
    build, final = image_builder().stages(text)
    assert re.search(r"^ARG BASE$", text.partition("FROM")[0], re.MULTILINE), "a base without a default, so none without a digest"
    assert build[0] == ("FROM", "${BASE} AS build") and final[0] == ("FROM", "${BASE}")
    installs = " ".join(rest for word, rest in build if word == "RUN")
    assert installs.count("pip install") == installs.count("--require-hashes") + installs.count("--no-deps --no-index") == 3
    assert "cyclonedx-py" in installs
    shipped = " ".join(rest for word, rest in final if word == "RUN")
    assert not re.search(r"gcc|pip|apt-get|compiler", shipped)
    assert [rest for word, rest in final if word == "USER"] == ["10001"]
    health = next(rest for word, rest in final if word == "HEALTHCHECK")
    assert '"--check"' in health and '"--config"' in health


def test_the_container_runs_shut_in_and_is_begun_again() -> None:
    yaml = pytest.importorskip("yaml")
    (service,) = yaml.safe_load((DEPLOY / "container/compose.yaml").read_text())["services"].values()
    assert service["read_only"] is True and service["cap_drop"] == ["ALL"] and "cap_add" not in service
    assert "privileged" not in service and service["security_opt"] == ["no-new-privileges:true"]
    assert service["user"] == "10001" and service["restart"] == "always" and service["image"].startswith("${STOPSET_IMAGE:?")
    assert "/etc/stopset:/etc/stopset:ro" in service["volumes"] and any(
        v.endswith(":/var/lib/stopset") for v in service["volumes"]
    )
    assert service["ulimits"] == {"memlock": -1, "rtprio": 40} and service["network_mode"] == "host"
    assert (
        service["mem_limit"] == service["memswap_limit"] == "1g" and service["pids_limit"] == 128 and service["cpuset"] == "2-3"
    )
    unit = (DEPLOY / "systemd/stopset.service").read_text().splitlines()
    assert {"MemoryMax=1G", "MemorySwapMax=0", "TasksMax=128", "Restart=always"} <= set(unit)
    assert "AllowedCPUs=2-3" in (DEPLOY / "systemd/stopset.slice").read_text().splitlines()


@pytest.mark.parametrize("wheel", ["nothing.whl", "numpy-2.0-py3-none-any.whl", "stopset-1.0.tar.gz", ""])
def test_what_is_no_wheel_of_stopset_is_not_installed(tmp_path: Path, wheel: str) -> None:
    (tmp_path / "numpy-2.0-py3-none-any.whl").write_text("")
    (tmp_path / "stopset-1.0.tar.gz").write_text("")
    done = sh(DEPLOY / "install.sh", *([tmp_path / wheel] if wheel else []))
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and done.stdout == ""


@pytest.mark.parametrize(
    ("name", "holds"),
    [
        ("requirements", {"numpy", "eclipse-zenoh", "python-can", "canopen", "msgspec", "cryptography", "pyarrow"}),
        ("build", {"hatchling", "cffi", "cyclonedx-bom"}),
    ],
)
def test_every_package_of_the_image_has_a_hash(name: str, holds: set[str]) -> None:
    lock = (DEPLOY / f"container/{name}.lock").read_text()
    entries = re.findall(r"^([a-z0-9][\w.-]*(?:\[[\w,]+\])?)==\S+((?: \\\n    --hash=sha256:[0-9a-f]{64})+)", lock, re.MULTILINE)
    assert len(entries) == len(re.findall(r"^\S+==", lock, re.MULTILINE)) > 10
    assert holds <= {package.partition("[")[0] for package, _ in entries}
    assert not re.search(r"http|^\s*--(?!hash)", lock, re.MULTILINE), "no place is named: whoever builds says where from"


def test_the_build_is_sent_what_it_needs_and_no_more() -> None:
    sent = image_builder().context()
    tops = {file.split("/")[0] for file in sent}
    assert tops == {"LICENSE", "README.md", "deploy", "fmu", "hatch_build.py", "model", "monitor", "offline", "pyproject.toml"}
    assert {f for f in sent if f.startswith("deploy/")} == {f"deploy/container/{n}.lock" for n in ("requirements", "build")}
    assert "model/stopset/core/c/stopset.h" in sent and not [f for f in sent if f.endswith((".so", ".pyc"))]


@pytest.mark.parametrize(
    "base", ["python:3.11-slim", "python@sha256:12", "python:3.11-slim@sha256:" + "g" * 64, "sha256:" + "a" * 64]
)
def test_a_base_without_a_digest_is_refused(base: str) -> None:
    done = sh(DEPLOY / "container/build.sh", base, "tag", DOCKER="/bin/echo")
    assert done.returncode == 2 and "names no digest" in done.stderr and done.stdout == ""
    good = sh(DEPLOY / "container/build.sh", "python:3.11-slim@sha256:" + "a" * 64, "tag", DOCKER="/bin/echo")
    assert good.returncode == 0 and f"BASE=python:3.11-slim@sha256:{'a' * 64}" in good.stdout


@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl to make certificates with")
def test_certificates_that_end_are_told_and_renewed_by_the_same_authority(tmp_path: Path) -> None:
    pki = DEPLOY / "zenoh/pki"
    assert sh(pki / "make-certs.sh", tmp_path, "localhost", "stopset-daemon").returncode == 0
    assert sh(pki / "expiry.sh", tmp_path).returncode == 0
    late = sh(pki / "expiry.sh", tmp_path, 800)  # they were made for 730 days
    assert late.returncode == 1 and "router.pem ends within 800 days" in late.stdout and "ca.pem" not in late.stdout
    before = (tmp_path / "stopset-daemon.pem").read_bytes()
    assert sh(pki / "renew-certs.sh", tmp_path, "localhost", "stopset-daemon").returncode == 0
    assert (tmp_path / "stopset-daemon.pem").read_bytes() != before == (tmp_path / "stopset-daemon.pem.old").read_bytes()
    assert sh("openssl", "verify", "-CAfile", tmp_path / "ca.pem", tmp_path / "stopset-daemon.pem").returncode == 0
    (tmp_path / "odd.pem").write_text("rubbish")
    assert sh(pki / "expiry.sh", tmp_path).returncode == 1
    assert sh(pki / "expiry.sh", tmp_path / "nowhere").returncode == 2
    (tmp_path / "ca.key").unlink()
    assert sh(pki / "renew-certs.sh", tmp_path, "localhost").returncode == 2


@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl to make certificates with")
def test_a_certificate_that_has_ended_opens_nothing_until_it_is_renewed(tmp_path: Path) -> None:
    """Real sessions by the shipped files: the look at certificates is red before anybody is shut out, and renewing opens again."""
    zenoh, pki, port, name = DEPLOY / "zenoh", tmp_path / "pki", free_port(), "stopset-plc"
    assert sh(zenoh / "pki/make-certs.sh", pki, "localhost", name).returncode == 0
    for file in ("router", "plc"):
        text = (zenoh / f"{file}.json5").read_text().replace("/etc/stopset/zenoh/pki", str(pki))
        text = text.replace("0.0.0.0:7447", f"127.0.0.1:{port}").replace("router.cell.local:7447", f"localhost:{port}")
        (tmp_path / f"{file}.json5").write_text(text)
    router = ZenohLink(file=tmp_path / "router.json5")
    try:
        ZenohLink(file=tmp_path / "plc.json5").close()
        (pki / "ended.ext").write_text(f"subjectAltName=DNS:{name}\nextendedKeyUsage=serverAuth,clientAuth\n")
        request = ("openssl", "req", "-new", "-key", pki / f"{name}.key", "-subj", f"/CN={name}", "-out", pki / "ended.csr")
        ended = ("openssl", "x509", "-req", "-in", pki / "ended.csr", "-CA", pki / "ca.pem", "-CAkey", pki / "ca.key", "-CAcreateserial",
                 "-days", "0", "-extfile", pki / "ended.ext", "-out", pki / f"{name}.pem")  # fmt: skip
        assert sh(*request).returncode == 0 == sh(*ended).returncode
        time.sleep(1.5)
        done = sh(zenoh / "pki/expiry.sh", pki)
        assert done.returncode == 1 and f"{name}.pem ends within 30 days" in done.stdout
        with pytest.raises(BusError, match="no zenoh session with"):
            ZenohLink(file=tmp_path / "plc.json5")
        assert sh(zenoh / "pki/renew-certs.sh", pki, "localhost", name).returncode == 0
        ZenohLink(file=tmp_path / "plc.json5").close()
    finally:
        router.close()


def version(folder: Path, healthy: bool) -> Path:
    program = folder / "bin/stopset"
    program.parent.mkdir(parents=True)
    program.write_text(f"#!/bin/sh\nexit {int(not healthy)}\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return folder


def test_an_upgrade_that_is_not_healthy_goes_back(tmp_path: Path) -> None:
    """The script is the shipped one; the versions are programs that answer the health check well or not."""
    old, good, bad = (version(tmp_path / n, h) for n, h in (("old", True), ("good", True), ("bad", False)))
    link = tmp_path / "stopset"
    link.symlink_to(old)
    restarts = tmp_path / "restarts"
    ctl = tmp_path / "systemctl"
    ctl.write_text(f'#!/bin/sh\necho "$@" >> {restarts}\n')
    ctl.chmod(0o755)
    words = {"STOPSET_LINK": str(link), "SYSTEMCTL": str(ctl), "PATIENCE": "2", "PAUSE": "0"}
    done = sh(DEPLOY / "checks/upgrade.sh", bad, **words)
    assert done.returncode == 1 and link.resolve() == old and "is back" in done.stderr
    assert restarts.read_text() == "restart stopset.service\n" * 2
    assert sh(DEPLOY / "checks/upgrade.sh", good, **words).returncode == 0 and link.resolve() == good
    for wrong in (good, tmp_path / "nowhere"):
        assert sh(DEPLOY / "checks/upgrade.sh", wrong, **words).returncode == 2 and link.resolve() == good


def test_a_model_goes_and_comes_back_with_its_version(tmp_path: Path) -> None:
    """A version that reads another schema brings its model; the old one comes back with the old version, each with its signature."""
    old, good, bad = (version(tmp_path / n, h) for n, h in (("old", True), ("good", True), ("bad", False)))
    (tmp_path / "stopset").symlink_to(old)
    (tmp_path / "arm.toml").write_text('site = "s"\nmodel = "arm.model.json"  # of this arm\n[bus]\nmodel = "none"\n')
    model, before = tmp_path / "arm.model.json", tmp_path / "arm.model.json.before"
    for name in ("arm", "new"):
        (tmp_path / f"{name}.model.json").write_text(name)
    (tmp_path / "arm.model.json.sig").write_text("signs arm")
    model.chmod(0o640)
    words = {"STOPSET_LINK": str(tmp_path / "stopset"), "STOPSET_CONFIG": str(tmp_path / "arm.toml"), "SYSTEMCTL": "true"}
    words |= {"PATIENCE": "1", "PAUSE": "0"}

    def there() -> tuple[str, str]:
        sig = tmp_path / "arm.model.json.sig"
        return model.read_text(), sig.read_text() if sig.exists() else ""

    upgrade = DEPLOY / "checks/upgrade.sh"
    assert sh(upgrade, bad, tmp_path / "new.model.json", **words).returncode == 1 and there() == ("arm", "signs arm")
    done = sh(upgrade, good, tmp_path / "new.model.json", **words)
    assert done.returncode == 0 and there() == ("new", "") and before.read_text() == "arm"
    assert stat.S_IMODE(model.stat().st_mode) == 0o640
    back = done.stdout.rpartition("back with: upgrade.sh ")[2].split()
    assert sh(upgrade, *back, **words).returncode == 0 and there() == ("arm", "signs arm") and before.read_text() == "new"
    assert sh(upgrade, good, tmp_path / "nowhere", **words).returncode == 2 and there() == ("arm", "signs arm")
    assert not list(tmp_path.glob("*.coming*")) + list(tmp_path.glob("*.new"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("torque", "profile"), [(1.0, ("lwa4p/monitor",)), (1.0, ()), (1.5, ())], ids=["CAN", "joint_states", "changed"]
)
def test_the_smoke_check_passes_a_sound_cell_and_no_other(tmp_path: Path, torque: float, profile: tuple[str, ...]) -> None:
    """The shipped script: a real daemon, a bus on loopback, the daemon stopped for a while; an arm that left its model fails it."""
    save_model(known_model(), tmp_path / "arm.model.json")
    write_recordings(tmp_path / "rec.parquet", meta(), [with_torque_scaled(motion(s, 500, s), 2, torque) for s in range(2)])
    program = tmp_path / "bin/stopset"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m stopset.cli.main "$@"\n')
    program.chmod(0o755)
    path = f"{program.parent}{os.pathsep}{os.environ['PATH']}"
    words = (tmp_path / "arm.model.json", tmp_path / "rec.parquet", *profile)
    done = sh(DEPLOY / "checks/smoke.sh", *words, **{**environment(), "PATH": path})
    if torque == 1.0:
        assert done.returncode == 0 and done.stdout.endswith("passed\n"), done.stdout + done.stderr
    else:
        assert done.returncode == 1 and "FAILED: " in done.stdout, done.stdout + done.stderr
