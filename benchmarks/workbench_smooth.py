"""Whether the workbench stutters on one recording of fifteen minutes, six joints, 250 Hz.

    stopset demo --out DEMO ; python benchmarks/workbench_smooth.py DEMO [--minutes 15]

The recording is simulated (the demo's altered arm, 225,000 rows) and opened beside the demo's first model in headless Chromium, by real
input: playing, dragging the time, going closer with the wheel and out again, another joint.  A frame's length is what the browser's own
clock says between two of its frames; of them what the page's own work held up (tasks over 50 ms, as browsers count them) is said beside,
because a machine with other work also drops frames.  Needs Debian's chromium, chromium-driver and the package selenium.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import urllib.parse
import urllib.request
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from page_pictures import chrome, until
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import Select

from stopset.offline.description import load_robot
from stopset.offline.workbench import Loop, Server
from stopset.recording import write_recordings
from stopset.simulation.cell import TICK, Measurement, record, temperatures
from stopset.simulation.motions import fourier
from stopset.simulation.scenario import prepare

SEED = 3
WATCH = """
window.frames = []; window.tasks = []; let last = performance.now();
const beat = now => { window.frames.push(now - last); last = now; requestAnimationFrame(beat); };
requestAnimationFrame(now => { last = now; requestAnimationFrame(beat); });
new PerformanceObserver(l => l.getEntries().forEach(e => window.tasks.push(e.duration))).observe({type: 'longtask'});
"""
DRAG = """
const done = arguments[0], s = document.getElementById('time'); let k = 0;
const step = () => {
  s.value = Math.round((k % 100) / 100 * s.max); s.dispatchEvent(new Event('input'));
  ++k < 200 ? requestAnimationFrame(step) : done();
};
requestAnimationFrame(step);
"""


def recorded(file: Path, minutes: float) -> int:
    """Write one recording of the demo's altered arm; its rows."""
    scenario = prepare(load_robot("lwa4p"), ("spring:arm_4_joint",), SEED, "motions", "large")
    cell = scenario.cell
    motion = fourier(cell.space, 60.0 * minutes, 1.0, TICK, cell.random("quarter of an hour"))
    r = record(cell, Measurement("closed_loop", 0, 0, motion, 0.5), temperatures(cell, 0.5))
    write_recordings(file, cell.meta, [r])
    return len(r.t)


def play(browser: Any) -> None:
    button = browser.find_element(By.ID, "play")
    button.click()
    time.sleep(5.0)
    button.click()


def wheel(browser: Any, by: int) -> None:
    """Turn it twelve times, and wait each time until the stretch asked for is drawn."""
    place = ScrollOrigin.from_element(browser.find_element(By.ID, "tube"))
    for _ in range(12):
        browser.execute_script("window.was = scene;")
        ActionChains(browser, duration=0).scroll_from_origin(place, 0, by).perform()
        until(lambda: browser.execute_script("return scene !== window.was;"), "another stretch")


def joints(browser: Any) -> None:
    shown = Select(browser.find_element(By.ID, "shownjoint"))
    for k in range(len(shown.options)):
        shown.select_by_index(k)


def measured(browser: Any, what: str, do: Callable[[], object]) -> None:
    browser.execute_script("window.frames = []; window.tasks = [];")
    begun = time.perf_counter()
    do()
    took = time.perf_counter() - begun
    time.sleep(0.3)
    frames, tasks = (np.asarray(browser.execute_script(f"return window.{x};"), float) for x in ("frames", "tasks"))
    late = 100.0 * np.mean(frames > 50.0)
    print(
        f"{what:<28}{took:8.2f} {np.median(frames):12.1f} {np.percentile(frames, 99):8.1f} {frames.max():9.1f} {late:10.1f}"
        f" {len(tasks):10d} {tasks.max(initial=0.0):9.0f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path)
    parser.add_argument("--minutes", type=float, default=15.0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, chrome() as browser:
        file = Path(folder) / "quarter.parquet"
        rows = recorded(file, args.minutes)
        loop = Loop(args.demo / "first.model.json", [file], folder)
        server = Server(loop, "127.0.0.1", 0)
        server.start()
        loop.attend()
        begun = time.perf_counter()
        browser.set_window_size(1250, 900)
        browser.get(server.url)
        until(lambda: browser.execute_script("return scene !== null;"), f"the recording ({loop.job()})")
        print(
            f"{rows} rows, {file.stat().st_size / 1e6:.0f} MB; compared and drawn {time.perf_counter() - begun:.1f} s after the page was opened"
        )
        loop.start("stop")
        until(lambda: not loop.busy, "rest")
        label = json.loads(urllib.request.urlopen(server.url + "state").read())["models"][0]["answers"]["recordings"]["listed"][
            0
        ]["label"]
        begun = time.perf_counter()
        got = urllib.request.urlopen(f"{server.url}scene/{urllib.parse.quote(label, safe='')}/0/inf/-").read()
        print(f"a stretch of it: {len(got) / 1e3:.0f} kB in {time.perf_counter() - begun:.3f} s\n")
        print(
            f"{'':<28}{'seconds':>8} {'frame median':>12} {'99 %':>8} {'longest':>9} {'>50 ms [%]':>10} {'own tasks':>10} {'longest':>9}  (ms)"
        )
        browser.execute_script(WATCH)
        browser.execute_script("document.getElementById('stage').scrollIntoView();")
        measured(browser, "playing for 5 s", partial(play, browser))
        measured(browser, "time dragged, 200 places", lambda: browser.execute_async_script(DRAG))
        measured(browser, "12 times closer", partial(wheel, browser, -120))
        measured(browser, "12 times wider", partial(wheel, browser, 120))
        measured(browser, "each joint in turn", partial(joints, browser))
        server.shutdown()
        server.server_close()
        loop.close()


if __name__ == "__main__":
    main()
