"""The worker's side of the workbench: what the commands of the same names do, its answers told piece by piece."""

from __future__ import annotations

import os
import signal
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from stopset.artifact import Model, save_model
from stopset.errors import OutputError, StopsetError
from stopset.files import writable, write_text
from stopset.offline.campaign.conditions import tagged
from stopset.offline.campaign.source import campaign_of
from stopset.offline.compare.compare import answer, compare, inputs
from stopset.offline.compare.dependence import explained
from stopset.offline.compare.page import page as compare_page
from stopset.offline.compare.scene import listed
from stopset.offline.compare.verdict import verdict
from stopset.offline.description.older import load_model
from stopset.offline.diagnose import diagnose_model
from stopset.offline.diagnose.answer import Ranked
from stopset.offline.diagnose.page import page as diagnose_page
from stopset.offline.plan import Wishes, design, write_plan
from stopset.offline.plan.page import page as plan_page
from stopset.offline.report.thin import spread
from stopset.offline.revise.revise import add
from stopset.offline.workbench.jobs import Answer, Answered, Compared, Ended, Export, Message, Order, RevisionWritten, Says
from stopset.recording import read_recordings

OFTEN = 0.1  # [s] between two words about the same step
DOTS = 400  # drawn of a claim's evidence
Send = Callable[[Message], None]


def serve(line: Connection, export: Export | None) -> None:
    """Do orders until the other side has gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal: the page's process decides what ends
    try:
        while True:
            order: Order = line.recv()
            line.send(_done(order, line.send, export))
    except (EOFError, OSError):
        return


def _done(order: Order, send: Send, export: Export | None) -> Ended:
    try:
        model = load_model(order.model)
        if order.action == "fmu":
            _fmu(order, model, send, export)
        else:
            {"compare": _compare, "diagnose": _diagnose, "add": _add, "plan": _plan}[order.action](order, model, send)
    except StopsetError as e:
        return Ended(str(e))
    except OSError as e:
        if isinstance(e, BrokenPipeError):
            raise
        return Ended(f"{e.filename or order.action}: {e.strerror or e}; expected a file that may be used: mend its rights")
    except Exception as e:  # noqa: BLE001 -- a fault of ours: it belongs on the page, not into a lost process
        if os.environ.get("STOPSET_DEBUG"):
            traceback.print_exception(e)
        return Ended(f"{type(e).__name__}: {e}", defect=True)
    return Ended()


class _StepSender:
    """Sends every step, and of a counted one as many as somebody can read."""

    def __init__(self, send: Send) -> None:
        self._send, self._last = send, 0.0

    def __call__(self, text: str, share: float | None = None) -> None:
        now = time.monotonic()
        if share is None or now - self._last > OFTEN:
            self._send(Says(text, share))
            self._last = now


def _compare(order: Order, model: Model, send: Send) -> None:
    progress = _StepSender(send)
    progress("reading the recordings")
    found = compare(model, order.data, progress)
    said = verdict(found)
    light = replace(found, survey=replace(found.survey, sample=()))
    send(Compared(light))
    send(Answered("recordings", {"listed": listed(found)}))
    send(Answered("verdict", {"text": said.text, "kind": said.kind}))
    send(Answered("compare", answer(model, found)))
    progress("looking for what the error depends on")
    shares = explained(model, inputs(model, found.trials, found.survey, model.powered.dt), found.survey)
    send(Compared(light, shares))
    send(Answered("dependence", {"variables": list(shares.variables), "share": shares.share.tolist()}))
    progress("drawing the page")
    send(Answered("compare", answer(model, found), compare_page(model, found, order.data, shares).html()))


def _diagnose(order: Order, model: Model, send: Send) -> None:
    progress = _StepSender(send)
    progress("reading the recordings")
    found, against = diagnose_model(model, read_recordings(order.data, model.robot), None, progress)
    content = found.as_json() | {"against": against, "evidence": [_evidence(r) for r in found.ranked]}
    send(Answered("diagnose", content))
    progress("drawing the page")
    send(Answered("diagnose", content, diagnose_page(model, found, against, order.data).html()))


def _evidence(r: Ranked) -> Answer | None:
    """The dots of a claim without and with its effect; None where a simulation was judged, which has none."""
    p = r.points
    if p is None:
        return None
    keep = spread(p.x, p.without, DOTS)

    def short(x: Any) -> list[float]:
        return [float(f"{v:.4g}") for v in np.asarray(x)[keep]]

    return {
        "joint": p.joint,
        "axis": p.axis,
        "x": short(p.x),
        "without": short(p.without),
        "with": short(p.left),
        "slope": p.slope,
    }


def _add(order: Order, model: Model, send: Send) -> None:
    effect, joint, force = (order.options.get(k) for k in ("effect", "joint", "force"))
    assert order.target is not None
    progress = _StepSender(send)
    target = writable(order.target)
    name = f"{effect or ''}:{joint}" if joint else str(effect or "")
    campaign = tagged(campaign_of(model.robot.as_described, order.data), order.conditions, order.data)
    done = add(model, [name], campaign, force=bool(force), progress=progress)
    row = {
        "effect": effect, "joint": joint or None, "helps": done.helps, "before": done.before, "after": done.after,
        "judged_on": done.judged_on, "why": "; ".join(x for j in done.judged if (x := j.why or j.stays)),
        "file": None if done.model is None else str(target),
    }  # fmt: skip
    if done.model is None:
        send(Answered("add", row))
        return
    saved = save_model(done.model, target)
    send(RevisionWritten(target))
    send(Answered("add", row))
    _compare(order, saved, send)


def _plan(order: Order, model: Model, send: Send) -> None:
    """The experiments that decide, as files: the whole campaign, with the sentence of the diagnosis on top."""
    assert order.target is not None
    folder, progress = order.target, _StepSender(send)
    progress("designing the experiments")
    plan = design(model.robot.as_described, Wishes(), read_recordings(order.data, model.robot), progress)
    try:
        folder.mkdir()
    except OSError as e:
        raise OutputError(f"{folder} cannot be made ({e.strerror}); start the workbench with another --out") from e
    files: Sequence[Path] = write_plan(plan, folder)
    decides = str(order.options.get("decides") or "")
    if decides:
        write_text(folder / "decides.txt", decides + "\n")
    minutes = sum(p.seconds for p in plan.parts) / 60.0
    content = {
        "folder": str(folder),
        "files": len(files),
        "minutes": minutes,
        "decides": decides,
        "warnings": list(plan.warnings),
    }
    send(Answered("plan", content, plan_page(plan).html()))


def _fmu(order: Order, model: Model, send: Send, export: Export | None) -> None:
    if export is None:
        raise OutputError("this workbench was started without FMUs; expected the part fmu: `stopset export-fmu` writes one")
    assert order.target is not None
    export(model, writable(order.target), _StepSender(send))
    send(Answered("fmu", {"file": str(order.target), "size": order.target.stat().st_size}))
