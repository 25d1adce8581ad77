"""The container's root, built by the Dockerfile's own commands in a chroot (`.ci/image`), and the daemon and its health check run in it."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest

from monitor_arm import known_model, meta, motion
from monitor_process import free_port, write_config
from stopset.artifact import save_model
from stopset.recording import write_recordings

ROOT = Path(__file__).resolve().parents[1]
CANNOT = 77
# what is said on one line each; health NAME: the health check's exit code, "red" for all that is not 0
INSIDE = r"""
health() { if {check} > /tmp/health 2>&1; then echo "$1 green"; else echo "$1 red: $(tail -1 /tmp/health)"; fi; }
grep -E "^(CapEff|CapBnd|NoNewPrivs)" /proc/self/status
id -u
touch /opt/stopset/x 2>/dev/null || echo "the root is read only"
touch /etc/stopset/x 2>/dev/null || echo "the configuration is read only"
echo "tools:" $(find /opt/stopset -name "pip" -o -name "pip-*" -o -name "pip3*" -o -name "setuptools" -o -name "*-gcc*")
health gone
{entry} > /tmp/monitor 2>&1 &
monitor=$!
for _ in 1 2 3 4 5 6; do health waiting > /tmp/said; grep -q INIT /tmp/said && break; done
cat /tmp/said
stopset replay /etc/stopset/rec.parquet --to zenoh:tcp/127.0.0.1:{port} --key js --loop > /tmp/replay 2>&1 &
replay=$!
for _ in 1 2 3 4 5 6 7 8 9 10; do health running > /tmp/said; grep -q green /tmp/said && break; done
cat /tmp/said
ls /var/lib/stopset
kill $replay; wait $replay
sleep 4
health silent
kill $monitor; wait $monitor
echo "the daemon ended with $?"
cat /opt/stopset/stopset.cdx.json
"""


@pytest.mark.slow
def test_the_image_that_the_dockerfile_makes_watches_an_arm(tmp_path: Path) -> None:
    """As compose.yaml runs it; the base is this machine's root, so what the base brings is not looked at."""
    etc = tmp_path / "etc"
    etc.mkdir()
    save_model(known_model(), etc / "arm.model.json")
    write_recordings(etc / "rec.parquet", meta(), [motion(s, 500, s) for s in range(2)])
    port, text = free_port(), (ROOT / "deploy/container/Dockerfile").read_text()
    source = '[joint_states]\nkey = "js"\ncycle_s = 0.004'
    made = write_config(etc, Path("arm.model.json"), source, port, publish="valid_for_ms = 1000\nstale_ms = 2000")
    made.rename(etc / "arm.toml")
    (check,) = re.findall(r"HEALTHCHECK.*?CMD \[(.*?)\]", text, re.DOTALL)
    (entry,) = re.findall(r"ENTRYPOINT \[(.*?)\]", text)
    script = INSIDE
    for name, value in (("check", check), ("entry", entry)):
        script = script.replace(f"{{{name}}}", " ".join(re.findall(r'"([^"]+)"', value)))
    words = [ROOT / ".ci/image", "--etc", etc, "/bin/sh", "-c", script.replace("{port}", str(port))]
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True, check=False)
    if done.returncode == CANNOT:
        pytest.skip(done.stderr.strip())
    assert done.returncode == 0, done.stderr[-3000:] + done.stdout[:2000]
    reported, _, bill = done.stdout.partition("{")
    said = reported.splitlines()
    assert said[:3] == ["CapEff:\t0000000000000000", "CapBnd:\t0000000000000000", "NoNewPrivs:\t1"] and said[3] == "10001", said
    assert said[4:7] == ["the root is read only", "the configuration is read only", "tools:"], said
    assert said[7].startswith("gone red") and "Traceback" not in said[7], said
    assert said[8].startswith("waiting red: INIT") and said[9] == "running green" and "arm.latch" in said, said
    assert any(line.startswith("silent red") for line in said) and "the daemon ended with 0" in said, done.stdout[:3000]
    locked = re.findall(
        r"^([a-z0-9][\w.-]*)(?:\[[\w,]+\])?==(\S+)", (ROOT / "deploy/container/requirements.lock").read_text(), re.M
    )
    listed = {(c["name"].lower().replace("_", "-"), c["version"]) for c in json.loads("{" + bill)["components"]}
    assert {(n.replace("_", "-"), v) for n, v in locked} <= listed and "stopset" in {n for n, _ in listed}
