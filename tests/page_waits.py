"""Waiting for pages: as long as they get on, not for so many seconds; a busy machine is no failure, standing still is."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

IDLE, MOST = 120.0, 900.0  # [s] without any progress, and at all


def until(holds: Callable[[], Any], progress: Callable[[], Any] = lambda: None) -> Any:
    """What ``holds`` gives once it is true; fails when ``progress`` stays the same for `IDLE`."""
    began = moved = time.monotonic()
    seen = progress()
    while not (found := holds()):
        now, at = progress(), time.monotonic()
        if now != seen:
            seen, moved = now, at
        assert at - moved < IDLE and at - began < MOST, f"never; last seen: {seen}"
        time.sleep(0.05)
    return found


def shows(browser: Any, holds: Callable[[], Any]) -> Any:
    """`until` of a page in a browser, which gets on as long as its words change."""
    return until(holds, lambda: str(browser.execute_script("return document.body ? document.body.innerText : ''"))[:400])
