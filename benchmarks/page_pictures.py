"""Pictures of every page, from the files of `stopset demo`: reports, workbench, and the live view of real processes on loopback.

    stopset demo --out DEMO ; python benchmarks/page_pictures.py DEMO OUT

Needs Debian's chromium and chromium-driver and the package selenium. Writes OUT/<page>-<desktop|phone>.png.
"""

from __future__ import annotations

import base64
import contextlib
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from selenium import webdriver

from stopset.offline.workbench import Loop, Server

WIDTHS = {"desktop": 1250, "phone": 390}
TALLEST = 1700  # [px] of a picture; what is below the fold of a long report is not shown
REPORTS = ("compare-first", "compare-second", "diagnosis", "history", "stops")


@contextlib.contextmanager
def chrome() -> Iterator[Any]:
    """A browser without a screen."""
    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for word in ("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-dev-shm-usage"):
        options.add_argument(word)
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(executable_path=shutil.which("chromedriver")))
    try:
        yield browser
    finally:
        browser.quit()


def picture(browser: Any, url: str, where: Path, wait: float = 1.0) -> None:
    """One page at every width."""
    for name, width in WIDTHS.items():
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        browser.get(url)
        time.sleep(wait)
        tall = min(TALLEST, browser.execute_script("return document.documentElement.scrollHeight"))
        clip = {"x": 0, "y": 0, "width": width, "height": tall, "scale": 0.8}
        shot = browser.execute_cdp_cmd("Page.captureScreenshot", {"captureBeyondViewport": True, "clip": clip})
        file = where.with_name(f"{where.name}-{name}.png")
        file.write_bytes(base64.b64decode(shot["data"]))
        print(f"{file}  {width} x {tall}")
    browser.get("about:blank")


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


@contextlib.contextmanager
def running(*words: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([sys.executable, "-m", "stopset.cli.main", *words], stdout=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(timeout=20)


def live(browser: Any, demo: Path, out: Path, name: str) -> None:
    """The live view while a recording is replayed, and after the monitor was killed."""
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        shutil.copy(demo / f"{name}.parquet", here / f"{name}.parquet")
        shutil.copy(demo / "first.model.json", here / "arm.model.json")
        hub, port, page = free_port(), free_port(), free_port()
        text = (demo / "arm.toml").read_text().partition("[signed]")[0]
        text = re.sub(r'"hub:\d+"', f'"hub:{hub}"', re.sub(r"127\.0\.0\.1:\d+", f"127.0.0.1:{port}", text))
        (here / "c.toml").write_text(text)
        with (
            running("replay", str(here / f"{name}.parquet"), "--to", f"hub:{hub}", "--wait", "1", "--loop"),
            running("monitor", "--config", str(here / "c.toml")) as monitor,
        ):
            time.sleep(5.0)
            with running("watch", "--config", str(here / "c.toml"), "--port", str(page)):
                time.sleep(6.0)
                picture(browser, f"http://127.0.0.1:{page}/", out / f"live-{name}", 2.0)
                monitor.kill()
                time.sleep(1.5)
                picture(browser, f"http://127.0.0.1:{page}/", out / f"live-{name}-killed", 1.0)


def workbench(browser: Any, demo: Path, out: Path) -> None:
    """Compared, diagnosed, and with the first effect added."""
    with tempfile.TemporaryDirectory() as folder:
        loop = Loop(demo / "first.model.json", [demo / "changed" / "recording.parquet"], folder)
        server = Server(loop, "127.0.0.1", 0)
        server.start()
        for action in ("compare", "diagnose"):
            loop.start(action)
            while loop.busy:
                time.sleep(0.2)
        found = loop.snapshot()["models"][-1]["answers"]["diagnose"]["ranked_effects"]
        if found:
            loop.start("add", effect=found[0]["effect"], joint=found[0]["joint"], force=True)
            while loop.busy:
                time.sleep(0.2)
        picture(browser, server.url, out / "workbench", 2.0)
        server.shutdown()
        server.server_close()


def main() -> None:
    demo, out = Path(sys.argv[1]), Path(sys.argv[2])
    out.mkdir(parents=True, exist_ok=True)
    with chrome() as browser:
        for name in REPORTS:
            if (demo / f"{name}.html").exists():
                picture(browser, (demo / f"{name}.html").absolute().as_uri(), out / name)
        live(browser, demo, out, "healthy")
        live(browser, demo, out, "changed")
        workbench(browser, demo, out)


if __name__ == "__main__":
    main()
