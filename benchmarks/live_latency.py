"""How soon the live page shows what the monitor says: VIOLATION after its first message, NO DATA after the monitor was killed.

    stopset demo --out DEMO ; python benchmarks/live_latency.py DEMO [--times 10]

Real processes on loopback: replay, monitor, `stopset watch`, headless Chromium.  The page's own clock stamps the moment its word
changes; the message is stamped where a subscriber of its own gets it, the kill where it is sent.
"""

from __future__ import annotations

import argparse
import re
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from page_pictures import chrome, free_port, listens, running, until

from stopset.monitor.layout import State, unpack
from stopset.monitor.links.zenoh_link import ZenohLink

# the moment [ms] at which the word first reads each of its values
STAMPS = """
window.stamps = {};
const note = () => { const w = document.getElementById('word').textContent; if (!(w in window.stamps)) window.stamps[w] = Date.now(); };
new MutationObserver(note).observe(document.getElementById('word'), {childList: true, characterData: true, subtree: true}); note();
"""


def once(browser: Any, demo: Path) -> tuple[float, float]:
    """Seconds from message to word, and from kill to word, of one life of a monitor."""
    with tempfile.TemporaryDirectory() as folder:
        here, hub, port, page = Path(folder), free_port(), free_port(), free_port()
        shutil.copy(demo / "changed.parquet", here / "changed.parquet")
        shutil.copy(demo / "first.model.json", here / "arm.model.json")
        text = (demo / "arm.toml").read_text().partition("[signed]")[0]
        text = re.sub(r'"hub:\d+"', f'"hub:{hub}"', re.sub(r"127\.0\.0\.1:\d+", f"127.0.0.1:{port}", text))
        (here / "c.toml").write_text(text)
        heard: list[float] = []

        def listen(_: str, data: bytes) -> None:
            if not heard and unpack(data)["state"] == State.VIOLATION:
                heard.append(time.time())

        with running("monitor", "--config", str(here / "c.toml")) as monitor:
            until(lambda: listens(port), "the monitor")
            link = ZenohLink("demo/cell/arm/stopset", connect=[f"tcp/127.0.0.1:{port}"])
            link.subscribe("state", listen)
            with running("watch", "--config", str(here / "c.toml"), "--port", str(page)):
                until(lambda: listens(page), "the live page")
                browser.get(f"http://127.0.0.1:{page}/")
                browser.execute_script(STAMPS)
                with running("replay", str(here / "changed.parquet"), "--to", f"hub:{hub}", "--wait", "1", "--loop"):
                    stamp = lambda word: browser.execute_script(f"return window.stamps['{word}'] || 0") / 1e3  # noqa: E731
                    until(lambda: heard and stamp("VIOLATION"), "VIOLATION")
                    time.sleep(1.0)
                    browser.execute_script("delete window.stamps['NO DATA']")
                    killed = time.time()
                    monitor.kill()
                    until(lambda: stamp("NO DATA"), "NO DATA")
                    return stamp("VIOLATION") - heard[0], stamp("NO DATA") - killed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path)
    parser.add_argument("--times", type=int, default=10)
    args = parser.parse_args()
    with chrome() as browser:
        found = np.array([once(browser, args.demo) for _ in range(args.times)])
    for name, column in (("VIOLATION on the page after its message", found[:, 0]), ("NO DATA after the kill", found[:, 1])):
        print(f"{name}: median {1e3 * np.median(column):.0f} ms, longest of {len(column)} {1e3 * column.max():.0f} ms")


if __name__ == "__main__":
    main()
