"""The other process of a stop desk: certifies boxes of states, each category in a thread of its own.

The proofs run in the compiled core, which lets the other threads go on meanwhile: a category that takes long keeps none waiting.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any, cast

import numpy as np

from stopset.artifact import load_model
from stopset.errors import ModelFileError, StopsetError
from stopset.monitor.certificates import Certificate, Numbers
from stopset.monitor.config import Masses, Stops
from stopset.reach.stops import Category, StopBound, StopBounds
from stopset.reach.stops.ramp import Ramp
from stopset.types import Array

SWITCH_S = 1e-4  # [s] a category may keep the others from running; a proof's Python parts last milliseconds
PARENT_S = 0.5  # [s] between looks whether the daemon still lives


def work(
    model_path: str, sha256: str, payload: Masses | None, stops: Stops, categories: tuple[str, ...], pipe: Connection
) -> None:  # fmt: skip
    """Answer requests ``(category, lo, hi)`` until None comes or the daemon is gone; the first word says that it is ready.

    ``sha256``: of the model that is watched; a file that holds another one by now bounds nothing.
    """
    prepared, refusal = prepare(model_path, payload, stops, sha256)
    sending = threading.Lock()
    requests: dict[str, queue.SimpleQueue[tuple[Array, Array]]] = {c: queue.SimpleQueue() for c in categories}

    def certify(category: str) -> None:
        spent = time.thread_time()
        while True:
            lo, hi = requests[category].get()
            refused = Certificate(category, lo, hi, Numbers.none(len(lo) // 2, refusal), 0.0, 0.0)
            answer = refused if prepared is None else answer_for(prepared, category, lo, hi)
            before, spent = spent, time.thread_time()
            answer = replace(answer, cpu=spent - before)  # what sending the last one has cost is in it
            with sending, contextlib.suppress(OSError):  # the daemon is gone: the main thread sees it too
                pipe.send(answer)

    sys.setswitchinterval(SWITCH_S)
    for c in categories:
        threading.Thread(target=certify, args=(c,), daemon=True, name=f"stop-{c}").start()
    pipe.send(None)
    for category, lo, hi in asked(pipe):
        requests[category].put((lo, hi))


def asked(pipe: Connection) -> Iterator[Any]:
    """What the daemon asks a process of its own, until it says None or is gone."""
    began = multiprocessing.parent_process()  # which may be gone already
    parent = os.getppid() if began is None else began.pid
    while True:
        while not pipe.poll(PARENT_S):
            if os.getppid() != parent:
                return
        try:
            request = pipe.recv()
        except (EOFError, OSError):
            return
        if request is None:
            return
        yield request


def prepare(model_path: str, payload: Masses | None, stops: Stops, sha256: str = "") -> tuple[StopBounds | None, str]:
    """The bounds of a model, with this ``sha256`` if given, with the ramp that is stated; or None and why there are none."""
    try:
        return _prepared(model_path, payload, stops, sha256), ""
    except (
        StopsetError
    ) as e:  # a payload that the model does not cover, a file that is gone: consumers must hear it from every message
        return None, str(e)


def _prepared(model_path: str, payload: Masses | None, stops: Stops, sha256: str) -> StopBounds:
    model, ramp = load_model(model_path), None
    if stops.ramp_time_s or stops.ramp_deceleration:
        ramp = Ramp.stated(
            model.n, time=stops.ramp_time_s or None, deceleration=stops.ramp_deceleration or None, control=stops.ramp_control_s
        ).failing(stops.ramp_off_after_s or None, monitored=stops.ramp_monitored)
    if sha256 and model.sha256 != sha256:
        raise ModelFileError(
            f"{model_path} is another model now (SHA-256 {model.sha256[:16]}...) than the one that is watched ({sha256[:16]}...); "
            "have the monitor read it anew (SIGHUP), or restore it"
        )
    return StopBounds.of(model, payload, ramp=ramp, fast=True)


def answer_for(prepared: StopBounds, category: str, lo: Array, hi: Array) -> Certificate:
    """The bound for every measured state ``lo <= (q, dq) <= hi``, (2n,) each; whatever goes wrong is its reason to have none."""
    begin, spent, n = time.monotonic(), time.thread_time(), len(lo) // 2
    middle = 0.5 * (lo + hi)
    # the halves round: what they leave out of the box is put back
    radius = np.nextafter(np.maximum(hi - middle, middle - lo), np.inf)
    try:
        bound = prepared.bound(middle[:n], middle[n:], cast(Category, category), radius[:n], radius[n:])
        numbers = numbers_of(bound, n)
    except StopsetError as e:
        numbers = Numbers.none(n, str(e))
    except Exception as e:  # noqa: BLE001 - a thread that died would leave its category without a word for ever
        numbers = Numbers.none(n, f"the bound failed: {type(e).__name__}: {e}")
    return Certificate(category, lo, hi, numbers, time.monotonic() - begin, time.thread_time() - spent)


def numbers_of(bound: StopBound, n: int) -> Numbers:
    """A `StopBound` in the monitor's form."""
    margin = -np.inf if bound.holding_margin is None else float(np.min(bound.holding_margin))
    if not bound.certified or bound.time is None or bound.forward is None or bound.back is None:
        return Numbers.none(n, bound.why, margin)
    tcp = np.inf if bound.tcp is None else float(bound.tcp)
    swept = None if bound.capsules is None else bound.capsules.reshape(-1, 7)
    return Numbers(bound.time, bound.forward, bound.back, tcp, np.ones(n, bool), bound.why, margin, swept, bound.end_stops)
