"""docs/how-to/deploy.md as it stands: its commands typed in a root of their own (`.ci/image --base`), the units' own commands run."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from monitor_arm import known_model, meta, motion
from monitor_process import free_port
from stopset.artifact import save_model
from stopset.artifact.signature import new_key
from stopset.cli.main import main
from stopset.recording import write_recordings

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/how-to/deploy.md"
CANNOT = 77
# no zenohd here: zenoh's own router, from Python, under its name and with its file
ZENOHD = """#!/opt/stopset/bin/python
import sys, time
from stopset.monitor.links.zenoh_link import ZenohLink
link = ZenohLink(file=sys.argv[2])
time.sleep(3600)
"""
# no systemd runs in a chroot: what it would start, as whom, from the installed unit
OFFLINE = """
export SYSTEMD_OFFLINE=1
systemctl() { for word; do shift; [ "$word" = --now ] || set -- "$@" "$word"; done; command systemctl "$@"; }
"""
START = r"""
started=""
install -d -o stopset -m 700 /var/lib/stopset  # StateDirectory=
unit() {
  setpriv --reuid=stopset --regid=stopset --clear-groups --no-new-privs --bounding-set=-all --inh-caps=-all \
    env STATE_DIRECTORY=/var/lib/stopset $(sed -n 's/^ExecStart=//p' "/etc/systemd/system/$1") > "/tmp/began-$1" 2>&1 &
  started="$started $!"
}
trap 'kill $started 2>/dev/null || true; tail -n 5 /tmp/began-* >&2' EXIT
"""


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.S | re.M)


def script(cell: Path, port: int, bus: int) -> str:
    """The page, step by step, with what a chroot lacks put in its place."""
    build, install, smoke, model, can, certificates, start, check, upgrade, renew = blocks("sh")
    (toml,) = blocks("toml")
    toml = toml.replace("socketcan:can0", f"hub:{bus}")  # no CAN interface here; frames and profile are the same
    unit = "sed -n 's/^ExecStart=//p' /etc/systemd/system/stopset-expiry.service"
    return "\n".join(
        [
            f"set -eu\n{OFFLINE}cd {ROOT}\ncp {cell}/* .\n",
            build, install, "realpath /opt/stopset\n", "id -un stopset\n",
            smoke, model,
            f"cat > /etc/stopset/arm.toml <<'END'\n{toml}\n[publish]\nvalid_for_ms = 1000\nstale_ms = 2000\nEND\n",
            can, certificates, "echo 127.0.0.1 router.cell.local >> /etc/hosts\n",
            # the page's own port is everybody's here
            f"sed -i 's/:7447/:{port}/' /etc/stopset/zenoh/*.json5\n",
            f"cat > /usr/bin/zenohd <<'END'\n{ZENOHD}END\nchmod 755 /usr/bin/zenohd\n",
            "cd /etc/systemd/system\nsystemd-analyze verify --man=no --recursive-errors=no stopset*.service stopset*.timer 2> /tmp/verify || true\n",
            f"grep stopset /tmp/verify || echo 'units verified'\ncd {ROOT}\n",
            start, "ls /etc/systemd/system/multi-user.target.wants /etc/systemd/system/timers.target.wants\n",
            START, "unit stopset-router.service\nsleep 3\nunit stopset.service\n",
            f"stopset replay recording.parquet --to hub:{bus} --wait 1 --loop > /tmp/began-replay 2>&1 &\nstarted=\"$started $!\"\n",
            check.replace("--check", "--check --seconds 60"), "echo checked\n",
            f"setpriv --reuid=stopset --regid=stopset --clear-groups $({unit}) && echo 'no certificate ends'\n",
            # a version that gives no message, in the folder that the page names
            "mkdir -p /opt/stopset-NEW/bin\nprintf '#!/bin/sh\\nexit 1\\n' > /opt/stopset-NEW/bin/stopset\nchmod 755 /opt/stopset-NEW/bin/stopset\n",
            "export PATIENCE=3 PAUSE=0\n", upgrade.strip() + " 2>&1 && exit 9 || echo \"upgrade ended with $?\"\n", "realpath /opt/stopset\n",
            renew, "echo renewed\nset +e\nkill $started\nwait\n",
        ]
    )  # fmt: skip


@pytest.mark.slow
def test_the_page_from_a_clone_to_a_cell_runs_as_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_model(known_model(), tmp_path / "arm.model.json")
    write_recordings(tmp_path / "recording.parquet", meta(), [motion(s, 500, s) for s in range(2)])
    keys = tmp_path / "keys"
    keys.mkdir()
    new_key(keys / "release")
    assert main(["sign", str(tmp_path / "arm.model.json"), "--key", str(keys / "release")]) == 0
    (tmp_path / "release.pub").write_bytes((keys / "release.pub").read_bytes())
    typed = tmp_path / "typed.sh"
    typed.write_text(script(tmp_path, free_port(), free_port()).replace(f"{tmp_path}/*", f"{tmp_path}/arm.* {tmp_path}/re*"))
    words = [str(ROOT / ".ci/image"), "--base", "/bin/sh", str(typed)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode == CANNOT:
        pytest.skip(done.stderr.strip())
    said, everything = done.stdout.splitlines(), done.stdout[-4000:] + done.stderr[-3000:]
    assert done.returncode == 0, everything
    version = re.search(r'^version = "(.*)"', (ROOT / "pyproject.toml").read_text(), re.M)
    assert version is not None and said.count(f"/opt/stopset-{version.group(1)}") == 2, everything
    for line in ("stopset", "passed", "units verified", "stopset.service", "stopset-expiry.timer", "checked", "no certificate ends",
                 "upgrade ended with 1", "renewed"):  # fmt: skip
        assert line in said, f"{line}: {everything}"
    assert any(re.match(r"(OK|DEGRADED|UNKNOWN)  ", line) for line in said), everything
