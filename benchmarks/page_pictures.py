"""Pictures of every page, from the files of `stopset demo`: reports, workbench, and live view and fleet of real processes on loopback.

    stopset demo --out DEMO ; python benchmarks/page_pictures.py DEMO OUT [--only NAME...] [--docs docs/pictures]

Writes OUT/<page>-<desktop|phone>.png, and OUT/<page>-print.pdf with its sheets as pictures where pdftoppm is installed;
``--docs``: also the first screen of each, as the documentation shows it.  Needs Debian's chromium, chromium-driver and the package selenium.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from fleet import arms as simulated_arms
from fleet import router
from selenium import webdriver

from stopset.monitor.layout import State
from stopset.offline.workbench import Loop, Server

WIDTHS = {"desktop": 1250, "phone": 390}
TALLEST = 6000  # [px] of a picture
SCREEN = 1000  # [px] of a page that the documentation shows
PATIENCE = 90.0  # [s] for a page to show what it is pictured for, on a busy machine
REPORTS = ("compare-first", "compare-second", "diagnosis", "history", "stops")
# reports that the demonstration does not write: the command that does, its files within those of the demonstration, what it writes besides
COMMANDS = {
    "inspection": ("inspect changed/recording.parquet --robot changed/robot.urdf", ""),
    "identification": ("identify --robot healthy/robot.urdf --data healthy/recording.parquet --accept-wide", "m.model.json"),
    "added": ("add first.model.json spring --joint arm_4_joint --data changed/recording.parquet", "m.model.json"),
    "plan": ("plan --robot healthy/robot.urdf", "plan"),
}
DRAWN = "[...document.querySelectorAll('.plot')].every(d => d.classList.contains('js-plotly-plot'))"
HALL = 14  # arms of the fleet
LEFT = "a measurement was outside its prediction (arm_4_joint: dq above its prediction of 0.032 s ago); reset with a name and a reason"


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


class Camera:
    """Takes every page at every width and in print."""

    def __init__(self, browser: Any, out: Path, docs: Path | None) -> None:
        self.browser, self.out, self.docs = browser, out, docs

    def take(self, url: str, name: str, shows: str = DRAWN) -> None:
        """``shows``: an expression that holds once the page shows what it is pictured for."""
        for size, width in WIDTHS.items():
            self._look(url, width, shows)
            tall = min(TALLEST, self.browser.execute_script("return document.documentElement.scrollHeight"))
            (self.out / f"{name}-{size}.png").write_bytes(self._shot(width, tall, 0.8, "png"))
            wide = self.browser.execute_script("return document.documentElement.scrollWidth")
            print(f"{name}-{size}  {wide} x {tall}" + ("  WIDER THAN THE SCREEN" if wide > width else ""), flush=True)
            if self.docs and size == "desktop":
                (self.docs / f"{name}.webp").write_bytes(self._shot(width, min(tall, SCREEN), 1.0, "webp"))
        self._look(url, WIDTHS["desktop"], shows)
        self._print(self.out / f"{name}-print.pdf")
        self.browser.get("about:blank")

    def _look(self, url: str, width: int, shows: str) -> None:
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        self.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        self.browser.get(url)
        until(lambda: self.browser.execute_script(f"return {shows}"), f"{url} shows {shows}")
        self.browser.execute_async_script(
            "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done()))"
        )

    def _shot(self, width: int, tall: int, scale: float, kind: str) -> bytes:
        clip = {"x": 0, "y": 0, "width": width, "height": tall, "scale": scale}
        how = {"captureBeyondViewport": True, "clip": clip, "format": kind} | ({"quality": 80} if kind == "webp" else {})
        return base64.b64decode(self.browser.execute_cdp_cmd("Page.captureScreenshot", how)["data"])

    def _print(self, file: Path) -> None:
        sheet = self.browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True, "printBackground": False})
        file.write_bytes(base64.b64decode(sheet["data"]))
        if shutil.which("pdftoppm"):
            subprocess.run(["pdftoppm", "-r", "50", "-png", str(file), str(file.with_suffix(""))], check=True)


def until(holds: Callable[[], Any], what: str) -> None:
    end = time.monotonic() + PATIENCE
    while not holds():
        if time.monotonic() > end:
            raise SystemExit(f"not within {PATIENCE:.0f} s: {what}")
        time.sleep(0.1)


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


def reports(camera: Camera, demo: Path, name: str) -> None:
    """A page that the demonstration wrote."""
    camera.take((demo / f"{name}.html").absolute().as_uri(), name)


def made(camera: Camera, demo: Path, name: str) -> None:
    """A page of a command that the demonstration runs without one, or not at all."""
    words, out = COMMANDS[name]
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / f"{name}.html"
        besides = ["--out", str(Path(folder) / out)] if out else []
        command = [sys.executable, "-m", "stopset.cli.main", *words.split(), *besides, "--report", str(page)]
        subprocess.run(command, cwd=demo, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        camera.take(page.as_uri(), name)


def live(camera: Camera, demo: Path, name: str, word: str) -> None:
    """The live view while a recording is replayed, once the state is ``word``; and after the monitor was killed."""
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        shutil.copy(demo / f"{name}.parquet", here / f"{name}.parquet")
        shutil.copy(demo / "first.model.json", here / "arm.model.json")
        hub, port, page = free_port(), free_port(), free_port()
        text = (demo / "arm.toml").read_text().partition("[signed]")[0]
        text = re.sub(r'"hub:\d+"', f'"hub:{hub}"', re.sub(r"127\.0\.0\.1:\d+", f"127.0.0.1:{port}", text))
        (here / "c.toml").write_text(text)
        url, says = f"http://127.0.0.1:{page}/", "document.getElementById('word')?.textContent == "
        with (
            running("replay", str(here / f"{name}.parquet"), "--to", f"hub:{hub}", "--wait", "1", "--loop"),
            running("monitor", "--config", str(here / "c.toml")) as monitor,
        ):
            until(lambda: listens(port), "the monitor")
            with running("watch", "--config", str(here / "c.toml"), "--port", str(page), "--reset-as", "A. Smith"):
                until(lambda: listens(page), "the live page")
                camera.take(
                    url,
                    f"live-{name}",
                    f"{says}'{word}' && document.querySelectorAll('#stops tr').length > 1 && past.length > 30",
                )
                monitor.kill()
                camera.take(url, f"live-{name}-killed", f"{says}'NO DATA'")


def listens(port: int) -> bool:
    with socket.socket() as s:
        return s.connect_ex(("127.0.0.1", port)) == 0


def workbench(camera: Camera, demo: Path) -> None:
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
        camera.take(
            server.url,
            "workbench",
            "document.querySelectorAll('.heat button').length && !document.getElementById('stage').hidden && scene",
        )
        server.shutdown()
        server.server_close()


def fleet(camera: Camera) -> None:
    """An overview of a hall of arms: one has left its model, another one's monitor is gone."""
    import multiprocessing

    context = multiprocessing.get_context("spawn")
    port, page, used = free_port(), free_port(), context.Value("d", 0.0)
    processes = [context.Process(target=router, args=(port, used), daemon=True)]
    processes[0].start()
    until(lambda: listens(port), "the router")
    for first, count, *says in ((0, HALL - 2), (HALL - 2, 1, State.VIOLATION, LEFT), (HALL - 1, 1)):
        ready = context.Event()
        processes.append(context.Process(target=simulated_arms, args=(port, first, count, ready, *says), daemon=True))
        processes[-1].start()
        ready.wait(PATIENCE)
    with running("fleet", "--connect", f"tcp/127.0.0.1:{port}", "--port", str(page)):
        until(lambda: listens(page), "the fleet's page")
        url, seen = f"http://127.0.0.1:{page}/", "document.querySelectorAll('article.{}').length == {}"
        camera.browser.get(url)
        until(lambda: camera.browser.execute_script("return " + seen.format("OK", HALL - 1)), "all arms on the page")
        processes[-1].kill()
        camera.take(url, "fleet", f"{seen.format('OK', HALL - 2)} && {seen.format('NO-DATA', 1)}")
    for process in processes[::-1]:
        process.kill()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--docs", type=Path)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    with chrome() as browser:
        camera = Camera(browser, asked.out, asked.docs)
        pages: dict[str, Callable[[], None]] = {name: partial(reports, camera, asked.demo, name) for name in REPORTS}
        pages |= {name: partial(made, camera, asked.demo, name) for name in COMMANDS}
        pages["live-healthy"] = partial(live, camera, asked.demo, "healthy", "OK")
        pages["live-changed"] = partial(live, camera, asked.demo, "changed", "VIOLATION")
        pages["workbench"] = partial(workbench, camera, asked.demo)
        pages["fleet"] = partial(fleet, camera)
        for name in asked.only or pages:
            pages[name]()


if __name__ == "__main__":
    main()
