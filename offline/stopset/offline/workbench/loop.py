"""What the workbench does: one model at a time, one job at a time, every result kept.

The loop calls what the commands of the same names call and adds nothing to them. It knows no network; the server shows it.
"""

from __future__ import annotations

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
from stopset.offline.compare.compare import answer, check_effort, compare
from stopset.offline.compare.page import page as compare_page
from stopset.offline.diagnose import diagnose_model
from stopset.offline.diagnose.page import page as diagnose_page
from stopset.offline.report.page import DISCLAIMER, Page
from stopset.offline.revise.page import FIGURES
from stopset.offline.revise.page import page as history_page
from stopset.offline.revise.revise import add
from stopset.recording import read_recordings, stream_recordings

Answer = dict[str, Any]


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
            self._job = job = Job(" ".join((action, *(str(v) for v in options.values() if v))), time.monotonic())
        threading.Thread(target=self._run, args=(job, ACTIONS[action], options), daemon=True, name=action).start()
        return True

    def _run(self, job: Job, do: Callable[..., None], options: dict[str, Any]) -> None:
        error = ""
        try:
            do(self, job, **options)
        except StopsetError as e:
            error = str(e)
        except Exception:  # noqa: BLE001 -- a fault of ours: the whole of it belongs on the page, not into a lost thread
            error = traceback.format_exc()
        with self._lock:
            job.error, job.seconds = error, time.monotonic() - job.started

    def report(self, name: str) -> str | None:
        """The self-contained page of an answer as HTML; None where there is none."""
        with self._lock:
            page = self._pages.get(name)
        return None if page is None else page.html()

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
                job = {"what": j.what, "says": j.says, "running": j.seconds is None, "seconds": round(took, 1), "error": j.error}
            return {
                "robot": self._models[-1][1].robot.name,
                "joints": list(self._models[-1][1].joints),
                "data": [str(p) for p in self.data],
                "effects": names(),
                "figures": [{"key": key, "title": title} for key, title in FIGURES],
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
        self._keep("compare", answer(model, found), compare_page(model, found, self.data))

    def _diagnose(self, job: Job) -> None:
        job.says = "trying every effect of the catalogue at every joint"
        model = self._models[-1][1]
        found, against = diagnose_model(model, read_recordings(self.data, model.robot), None)
        self._keep("diagnose", found.as_json() | {"against": against}, diagnose_page(model, found, against))

    def _add(self, job: Job, effect: str = "", joint: str | None = None, force: bool = False) -> None:
        def tell(text: str) -> None:
            job.says = text

        target = writable(self._next_file())
        done = add(self._models[-1][1], effect, joint or None, self.data, force, tell)
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
            self._pages["history"] = self.history()

    def _keep(self, action: str, found: Answer, page: Page | None = None) -> None:
        with self._lock:
            number = len(self._models) - 1
            self._answers[number][action] = found
            if page is not None:
                self._pages[f"{action}-{number}"] = page

    def _next_file(self) -> Path:
        path, model = self._models[-1]
        number = model.revisions[-1].number + 1 if model.revisions else 1
        name = path.name.removesuffix(".json").removesuffix(".model")
        target = self.folder / f"{name.removesuffix(f'.r{number - 1}')}.r{number}.model.json"
        if target.exists():
            raise OutputError(
                f"{target} exists already; expected a place for revision {number}: choose another folder with --out"
            )
        return target


ACTIONS: dict[str, Callable[..., None]] = {"compare": Loop._compare, "diagnose": Loop._diagnose, "add": Loop._add}


def _revisions(model: Model) -> list[Answer]:
    return [
        {"number": r.number, "added": r.added, "note": r.note, "before": dict(r.before), "after": dict(r.after)}
        for r in model.revisions
    ]
