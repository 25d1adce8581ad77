"""What the workbench does: one model at a time, one job at a time, every result kept.

The loop calls what the commands of the same names call and adds nothing to them. It knows no network; the server shows it.
"""

from __future__ import annotations

import os
import re
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stopset.artifact import Model, load_model, save_model
from stopset.effects import names
from stopset.errors import OutputError, StopsetError
from stopset.files import writable
from stopset.offline.campaign.source import campaign_of
from stopset.offline.compare.compare import Comparison, answer, check_effort, compare, inputs
from stopset.offline.compare.dependence import Explained, explained, partial_residual
from stopset.offline.compare.page import page as compare_page
from stopset.offline.compare.verdict import verdict
from stopset.offline.diagnose import diagnose_model
from stopset.offline.diagnose.page import page as diagnose_page
from stopset.offline.report.page import DISCLAIMER, Page
from stopset.offline.report.thin import spread
from stopset.offline.revise.page import FIGURES, floor
from stopset.offline.revise.page import page as history_page
from stopset.offline.revise.revise import add, description
from stopset.offline.workbench.scene import listed, scene
from stopset.recording import read_recordings, stream_recordings

Answer = dict[str, Any]
REVISION = re.compile(r"\.r\d+(-\d+)?$")  # what this adds to a file's name
TRIES = 100
POINTS = 800  # drawn of a partial residual


@dataclass(slots=True)
class Job:
    """The running job, or the last one: what, how far, and why it ended without an answer."""

    what: str
    started: float  # [s] monotonic clock
    says: str = ""
    seconds: float | None = None  # None while it runs
    error: str = ""


class Loop:
    """A model, its recordings, and the answers about it so far.

    ``folder`` takes the new revisions (``<name>.r<revision>.model.json``); nothing there is ever overwritten.
    Raises what `load_model` raises; `RecordingError` where the recordings are of another kind; `OutputError` where the folder
    cannot be written.
    """

    def __init__(self, model: str | Path, data: Sequence[str | Path], folder: str | Path) -> None:
        self.data = tuple(Path(p) for p in data)
        self.folder = Path(folder)
        self._lock = threading.Lock()
        self._models: list[tuple[Path, Model]] = [(Path(model), load_model(model))]
        self._answers: list[dict[str, Answer]] = [{}]  # per model: action -> answer
        self._pages: dict[str, Page] = {}
        self._shares: Explained | None = None  # of the model at hand
        self._found: Comparison | None = None  # likewise
        self._usual: dict[str, float] = {}  # [s] what each action took last
        self._job: Job | None = None
        check_effort(self._models[0][1], self.data)
        for path in self.data:  # what cannot be read is refused now, not at the first click
            next(stream_recordings(path, self._models[0][1].robot))
        writable(self._next_file())

    @property
    def busy(self) -> bool:
        return self._job is not None and self._job.seconds is None

    def start(self, action: str, **options: Any) -> bool:
        """Begin an action of `ACTIONS` in the background; False while another one runs."""
        with self._lock:
            if self.busy:
                return False
            said = " ".join(str(v) for v in options.values() if v and v is not True)
            self._job = job = Job(f"{action} {said}".strip(), time.monotonic())
        threading.Thread(target=self._run, args=(job, ACTIONS[action], options), daemon=True, name=action).start()
        return True

    def _run(self, job: Job, do: Callable[..., None], options: dict[str, Any]) -> None:
        error = ""
        try:
            do(self, job, **options)
        except StopsetError as e:
            error = str(e)
        except Exception as e:  # noqa: BLE001 -- a fault of ours: it belongs on the page, not into a lost thread
            if os.environ.get("STOPSET_DEBUG"):
                traceback.print_exception(e)
            error = (
                f"{job.what} failed inside ({type(e).__name__}: {e}); this is a defect of stopset, not an answer: start the workbench "
                "with STOPSET_DEBUG=1 in the environment and report what it prints"
            )
        with self._lock:
            job.error, job.seconds = error, time.monotonic() - job.started
            if not error:
                self._usual[job.what.partition(" ")[0]] = job.seconds

    def report(self, name: str) -> str | None:
        """The self-contained page of an answer as HTML; None where there is none."""
        with self._lock:
            page = self._pages.get(name)
        return None if page is None else page.html()

    def model_text(self, number: str) -> str | None:
        """The model file of a revision made or opened here, by its place in the list; None where there is none."""
        with self._lock:
            at = int(number) if number.isascii() and number.isdecimal() and len(number) < 6 else -1
            path = self._models[at][0] if 0 <= at < len(self._models) else None
        return None if path is None else path.read_text(encoding="utf-8")

    def partial(self, joint: str, variable: str) -> Answer | None:
        """Torque error of a joint over a variable, what the next best one explains taken off; None where it is unknown."""
        with self._lock:
            shares, joints = self._shares, self._models[-1][1].joints
        if shares is None or joint not in joints or variable not in shares.variables:
            return None
        p = partial_residual(shares, joints.index(joint), shares.variables.index(variable))
        keep = spread(p.x, p.y, POINTS)
        return {
            "joint": joint, "variable": p.variable, "other": p.other, "x": p.x[keep].tolist(), "y": p.y[keep].tolist(),
            "line": p.line.tolist(),
        }  # fmt: skip

    def scene(self, label: str) -> Answer | None:
        """What there is to see of a recording; None where it is unknown or nothing was compared yet."""
        with self._lock:
            found, model = self._found, self._models[-1][1]
        return None if found is None else scene(model, found, self.data, label)

    def history(self) -> Page:
        """The waterfall of the last model's revisions."""
        return history_page(self._models[-1][1])

    def snapshot(self) -> Answer:
        """Everything the page shows, as plain data."""
        with self._lock:
            job = None
            if self._job is not None:
                j = self._job
                took = time.monotonic() - j.started if j.seconds is None else j.seconds
                job = {"what": j.what, "says": j.says, "running": j.seconds is None, "seconds": round(took, 1), "error": j.error,
                       "usual": self._usual.get(j.what.partition(" ")[0])}  # fmt: skip
            return {
                "robot": self._models[-1][1].robot.name,
                "joints": list(self._models[-1][1].joints),
                "data": [str(p) for p in self.data],
                "effects": names(),
                "figures": [{"key": key, "title": title} for key, title in FIGURES],
                "floor": floor(self._models[-1][1]),
                "models": [
                    {
                        "file": str(path),
                        "sha256": m.sha256,
                        "guarantee": m.guarantee.text,
                        "revisions": _revisions(m),
                        "answers": a,
                    }
                    for (path, m), a in zip(self._models, self._answers, strict=True)
                ],
                "reports": sorted(self._pages),
                "job": job,
                "notice": DISCLAIMER,
            }

    def _compare(self, job: Job) -> None:
        job.says = "comparing the model with every recording"
        model = self._models[-1][1]
        found = compare(model, self.data)
        job.says = "looking for what the error depends on"
        shares = explained(model, inputs(model, self.data, found.survey, model.powered.dt), found.survey)
        said = verdict(found)
        with self._lock:
            self._shares, self._found = shares, found
        self._keep("recordings", {"listed": listed(found)})
        self._keep("dependence", {"variables": list(shares.variables), "share": shares.share.tolist()})
        self._keep("verdict", {"text": said.text, "kind": said.kind})
        self._keep("compare", answer(model, found), compare_page(model, found, self.data, shares))

    def _undo(self, job: Job) -> None:
        """Back to the model before; the revision's file stays, nothing is deleted."""
        with self._lock:
            if len(self._models) == 1:
                raise OutputError("nothing was added here yet; expected a revision to go back from: add an effect first")
            number = len(self._models) - 1
            path, _ = self._models.pop()
            self._answers.pop()
            self._shares = self._found = None
            for name in [n for n in self._pages if n.endswith(f"-{number}")]:
                del self._pages[name]
            self._pages["history"] = self.history()
        job.says = f"back to {self._models[-1][0]}; {path} stays where it is"

    def _diagnose(self, job: Job) -> None:
        job.says = "trying every effect of the catalogue at every joint"
        model = self._models[-1][1]
        found, against = diagnose_model(model, read_recordings(self.data, model.robot), None)
        self._keep("diagnose", found.as_json() | {"against": against}, diagnose_page(model, found, against, self.data))

    def _add(self, job: Job, effect: str = "", joint: str | None = None, force: bool = False) -> None:
        def tell(text: str) -> None:
            job.says = text

        target = writable(self._next_file())
        model = self._models[-1][1]
        name = f"{effect}:{joint}" if joint else effect
        done = add(model, [name], campaign_of(description(model), self.data), force=force, tell=tell)
        row = {
            "effect": effect, "joint": joint or None, "helps": done.helps, "before": done.before, "after": done.after,
            "judged_on": done.judged_on, "why": "; ".join(j.why for j in done.judged if j.why), "file": None if done.model is None else str(target),
        }  # fmt: skip
        if done.model is None:
            self._keep("add", row)
            return
        saved = save_model(done.model, target)
        with self._lock:
            self._models.append((target, saved))
            self._answers.append({"add": row})
            self._shares = self._found = None
            self._pages["history"] = self.history()
        self._compare(job)

    def _keep(self, action: str, found: Answer, page: Page | None = None) -> None:
        with self._lock:
            number = len(self._models) - 1
            self._answers[number][action] = found
            if page is not None:
                self._pages[f"{action}-{number}"] = page

    def _next_file(self) -> Path:
        """A name that is free: what an earlier session left, or an undone revision, stays."""
        path, model = self._models[-1]
        number = model.revisions[-1].number + 1 if model.revisions else 1
        stem = REVISION.sub("", path.name.removesuffix(".json").removesuffix(".model"))
        tries = (f"{stem}.r{number}{f'-{k}' if k else ''}.model.json" for k in (0, *range(2, TRIES)))
        target = next((t for t in (self.folder / name for name in tries) if not t.exists()), None)
        if target is None:
            raise OutputError(
                f"{self.folder} holds {TRIES - 1} files for revision {number}; expected a free name: choose another folder with --out"
            )
        return target


ACTIONS: dict[str, Callable[..., None]] = {
    "compare": Loop._compare, "diagnose": Loop._diagnose, "add": Loop._add, "undo": Loop._undo,
}  # fmt: skip


def _revisions(model: Model) -> list[Answer]:
    return [
        {"number": r.number, "added": r.added, "note": r.note, "before": dict(r.before), "after": dict(r.after)}
        for r in model.revisions
    ]
