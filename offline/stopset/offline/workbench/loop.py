"""What the workbench does: one model at a time, one job at a time, every result kept.

The loop orders what the commands of the same names do and adds nothing to them. It knows no network; the server shows it.
"""

from __future__ import annotations

import contextlib
import re
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stopset.effects import names
from stopset.errors import OutputError, RecordingError, StopsetError
from stopset.files import writable
from stopset.offline.compare.compare import check_effort
from stopset.offline.compare.dependence import partial_residual
from stopset.offline.compare.scene import Scene, scene
from stopset.offline.description.older import load_model
from stopset.offline.report.page import DISCLAIMER
from stopset.offline.report.thin import spread
from stopset.offline.revise.page import FIGURES, floors
from stopset.offline.revise.page import page as history_page
from stopset.offline.workbench.jobs import Answer, Answered, Compared, Ended, Export, Job, Message, Order, RevisionWritten, Says
from stopset.offline.workbench.opened import Opened
from stopset.offline.workbench.worker import Worker
from stopset.recording import stream_recordings

ACTIONS = ("compare", "diagnose", "add", "plan", "fmu", "undo", "stop")
ITSELF = ("compare", "diagnose")  # done without being asked
REVISION = re.compile(r"\.r\d+(-\d+)?$")  # what this adds to a file's name
CONDITION = re.compile(r"[^=,@]+=[^=,@]+")
TRIES = 100
POINTS = 800  # drawn of a partial residual
SCENES = 4  # recordings held whole


class Loop:
    """A model, its recordings, and the answers about it so far.

    ``folder`` takes the new revisions (``<name>.r<revision>.model.json``); nothing there is ever overwritten. ``export`` writes FMUs.
    Raises what `load_model` raises; `RecordingError` where the recordings are of another kind; `OutputError` where the folder
    cannot be written.
    """

    def __init__(
        self, model: str | Path, data: Sequence[str | Path], folder: str | Path, export: Export | None = None,
        conditions: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.files, self.folder = tuple(Path(p) for p in data), Path(folder)
        self._lock = threading.RLock()
        self._models = [Opened(Path(model), load_model(model))]
        self._usual: dict[str, float] = {}  # [s] what each action took last
        self._job: Job | None = None
        self._thread: threading.Thread | None = None
        self._worker = Worker(export)
        self._attends, self._version = False, 0
        self._scenes: dict[tuple[str, str], Scene] = {}
        check_effort(self._models[0].model, self.files)
        # what cannot be read is refused now, not at the first click
        first = [next(stream_recordings(path, self._models[0].model.robot)) for path in self.files]
        self._stated = [r.condition or "" for r in first]  # by the recordings themselves
        self._chosen = tuple(range(len(self.files)))
        self._conditions = _by_file(conditions, self.files)
        writable(self._free_name("model.json"))

    @property
    def busy(self) -> bool:
        return self._job is not None and self._job.seconds is None

    @property
    def data(self) -> tuple[Path, ...]:
        """The recordings chosen."""
        return tuple(self.files[k] for k in self._chosen)

    def attend(self) -> None:
        """From now on compare and diagnose whatever model is at hand without being asked."""
        self._attends = True
        self._next()

    def close(self) -> None:
        """End the worker; what it was doing is given up."""
        self._attends = False
        self._worker.stop()

    def start(self, action: str, *, automatic: bool = False, **options: Any) -> bool:
        """Begin an action of `ACTIONS` in the background; False while another one runs that somebody asked for.

        What runs by itself gives way.
        """
        with self._lock:
            job = self._job
            if action == "stop":
                self._stop()
                return True
            if self.busy and job is not None:
                if automatic or not job.automatic:
                    return False
                self._give_up()
            said = " ".join(str(v) for k, v in options.items() if v and v is not True and k != "decides")
            self._job = Job(f"{action} {said}".strip(), automatic)
            words = (self._job, self._thread, action, options)
            self._thread = threading.Thread(target=self._run, args=words, daemon=True, name=action)
            self._thread.start()
        return True

    def _stop(self) -> None:
        """As somebody wishes: what is stopped is not begun again without being asked."""
        if self.busy and self._job is not None:
            self._models[-1].left_alone.add(self._job.action)
        self._give_up()

    def _give_up(self) -> None:
        """End what runs, at once."""
        job = self._job
        if job is not None and job.seconds is None:
            job.stopped, job.seconds, job.says = True, time.monotonic() - job.started, "stopped"
            self._worker.stop()

    def _run(self, job: Job, earlier: threading.Thread | None, action: str, options: dict[str, Any]) -> None:
        if earlier is not None:
            earlier.join()
        try:
            end = Ended()
            if action == "undo":
                self._undo(job)
            else:
                end = self._worker.do(self._order(action, options), lambda m: self._take(job, m), lambda: job.stopped)
        except StopsetError as e:
            end = Ended(str(e))
        except Exception as e:  # noqa: BLE001 -- a fault of ours: it belongs on the page, not into a lost thread
            end = Ended(f"{type(e).__name__}: {e}", defect=True)
        if job.stopped:
            return
        error = end.error
        if end.defect:
            error = (
                f"{job.what} failed inside ({error}); this is a defect of stopset, not an answer: start the workbench with "
                "STOPSET_DEBUG=1 in the environment and report what it prints"
            )
        with self._lock:
            job.error, job.seconds = error, time.monotonic() - job.started
            self._version += 1
            if error:
                self._models[-1].left_alone.add(action)  # not tried again without being asked
            else:
                self._usual[action] = job.seconds
        self._next()

    def _next(self) -> None:
        """What is to be done without being asked, if anything."""
        with self._lock:
            at = self._models[-1]
            todo = next((a for a in ITSELF if a not in at.pages and a not in at.left_alone), None)
            if self._attends and not self.busy and todo is not None:
                self.start(todo, automatic=True)

    def _order(self, action: str, options: dict[str, Any]) -> Order:
        ending = {"add": "model.json", "fmu": "fmu", "plan": "plan"}.get(action)
        with self._lock:
            target = None if ending is None else self._free_name(ending)
            flags = [f"{c.strip()}@{self.files[k]}" for k in self._chosen for c in self._conditions[k].split(",") if c.strip()]
            return Order(action, self._models[-1].path, self.data, tuple(flags), target, options)

    def _take(self, job: Job, message: Message) -> None:
        with self._lock:
            if job.stopped:
                return
            at = self._models[-1]
            if isinstance(message, Says):
                job.report(message.text, message.share)
                return
            if isinstance(message, RevisionWritten):
                self._models.append(Opened(message.path, load_model(message.path)))
            elif isinstance(message, Compared):
                at.found, at.shares = message.found, message.shares
            elif isinstance(message, Answered):
                at.answers[message.name] = message.answer
                if message.page is not None:
                    at.pages[message.name] = message.page
            self._version += 1

    def _undo(self, job: Job) -> None:
        """Back to the model before; the revision's file stays, nothing is deleted."""
        with self._lock:
            if len(self._models) == 1:
                raise OutputError("nothing was added here yet; expected a revision to go back from: add an effect first")
            path = self._models.pop().path
        job.says = f"back to {self._models[-1].path}; {path} stays where it is"

    def choose(self, files: Sequence[int], conditions: Sequence[str]) -> None:
        """Take these of the recordings, by number, each file with its condition (``KEY=VALUE, ...`` or nothing); ask anew.

        Raises `RecordingError` for a choice of none, or a condition of another form.
        """
        chosen = tuple(sorted({k for k in files if 0 <= k < len(self.files)}))
        if not chosen or len(chosen) != len(set(files)):
            raise RecordingError(
                f"{len(chosen)} of {len(self.files)} recordings chosen; expected one or more of the list: mark one"
            )
        if len(conditions) != len(self.files):
            raise RecordingError(
                f"{len(conditions)} conditions for {len(self.files)} recordings; expected one each: reload the page"
            )
        wrong = next(
            (c for text in conditions for c in text.split(",") if c.strip() and not CONDITION.fullmatch(c.strip())), None
        )
        if wrong is not None:
            raise RecordingError(f"condition {wrong.strip()[:60]!r}; expected KEY=VALUE, like payload=2.8 kg, day=2: write it so")
        with self._lock:
            if self.busy and self._job is not None and not self._job.automatic:
                raise RecordingError(f"{self._job.what} is running on the present choice; expected it to end: wait, or stop it")
            self._give_up()
            self._chosen, self._conditions = chosen, [c.strip() for c in conditions]
            self._models = [Opened(m.path, m.model) for m in self._models]
            self._scenes.clear()
            self._version += 1
        self._next()

    def report(self, name: str) -> str | None:
        """The self-contained page of an answer (``<answer>-<place of the model>``, ``history``) as HTML; None where there is none."""
        if name == "history":
            return history_page(self._models[-1].model).html()
        action, _, number = name.rpartition("-")
        at = self._opened(number)
        return None if at is None else at.pages.get(action)

    def model_text(self, number: str) -> str | None:
        """The model file of a revision made or opened here, by its place in the list; None where there is none."""
        at = self._opened(number)
        return None if at is None else at.path.read_text(encoding="utf-8")

    def fmu(self, number: str) -> bytes | None:
        """The FMU written of a revision; None where none was."""
        at = self._opened(number)
        if at is None or "fmu" not in at.answers:
            return None
        with contextlib.suppress(OSError):
            return Path(at.answers["fmu"]["file"]).read_bytes()
        return None

    def _opened(self, number: str) -> Opened | None:
        with self._lock:
            at = int(number) if number.isascii() and number.isdecimal() and len(number) < 6 else -1
            return self._models[at] if 0 <= at < len(self._models) else None

    def partial(self, joint: str, variable: str) -> Answer | None:
        """Torque error of a joint over a variable, what the next best one explains taken off; None where it is unknown."""
        with self._lock:
            shares, joints = self._models[-1].shares, self._models[-1].model.joints
        if shares is None or joint not in joints or variable not in shares.variables:
            return None
        p = partial_residual(shares, joints.index(joint), shares.variables.index(variable))
        keep = spread(p.x, p.y, POINTS)
        return {
            "joint": joint, "variable": p.variable, "other": p.other, "x": p.x[keep].tolist(), "y": p.y[keep].tolist(),
            "line": p.line.tolist(),
        }  # fmt: skip

    def scene(self, label: str, begin: float = 0.0, end: float = float("inf"), beside: int | None = None) -> Answer | None:
        """What there is to see of a recording between two times [s]; None where it is unknown or nothing was compared yet.

        ``beside``: place of another model whose predictions are laid under those of the model at hand.
        """
        with self._lock:
            models = list(self._models)
        now = self._scene(models[-1], label)
        other = models[beside] if beside is not None and 0 <= beside < len(models) - 1 else None
        return None if now is None else now.window(begin, end, None if other is None else self._scene(other, label))

    def _scene(self, at: Opened, label: str) -> Scene | None:
        key = (at.model.sha256, label)
        if at.found is None:
            return None
        if key not in self._scenes and (made := scene(at.model, at.found, label)) is not None:
            with self._lock:
                self._scenes[key] = made
                while len(self._scenes) > SCENES:
                    del self._scenes[next(iter(self._scenes))]
        return self._scenes.get(key)

    def job(self) -> Answer:
        """How far the running job is, and ``version``: changes whenever `snapshot` does."""
        with self._lock:
            job = self._job
            return {"job": None if job is None else job.shown(self._usual.get(job.action)), "version": self._version}

    def snapshot(self) -> Answer:
        """Everything the page shows, as plain data."""
        with self._lock:
            model = self._models[-1].model
            recordings = [
                {"file": str(p), "chosen": k in self._chosen, "condition": self._conditions[k], "stated": self._stated[k]}
                for k, p in enumerate(self.files)
            ]
            return {
                "robot": model.robot.name,
                "joints": list(model.joints),
                "data": [str(p) for p in self.data],
                "recordings": recordings,
                "effects": names(),
                "figures": [{"key": key, "title": title} for key, title in FIGURES],
                "floors": floors(model),
                "models": [m.shown() for m in self._models],
                "reports": sorted(f"{name}-{k}" for k, m in enumerate(self._models) for name in m.pages),
                "notice": DISCLAIMER,
                **self.job(),
            }

    def _free_name(self, ending: str) -> Path:
        """A name that is free: what an earlier session left, or an undone revision, stays."""
        at = self._models[-1]
        number = at.model.revisions[-1].number if at.model.revisions else 0
        number += ending == "model.json"
        stem = REVISION.sub("", at.path.name.removesuffix(".json").removesuffix(".model"))
        tries = (f"{stem}.r{number}{f'-{k}' if k else ''}.{ending}" for k in (0, *range(2, TRIES)))
        target = next((t for t in (self.folder / name for name in tries) if not t.exists()), None)
        if target is None:
            raise OutputError(
                f"{self.folder} holds {TRIES - 1} files for revision {number}; expected a free name: choose another folder with --out"
            )
        return target


def _by_file(flags: Sequence[str], files: Sequence[Path]) -> list[str]:
    """What flags ``KEY=VALUE@FILE`` or ``KEY=VALUE`` say of each file. Raises `RecordingError` for a flag of another form."""
    out: list[list[str]] = [[] for _ in files]
    for flag in flags:
        text, _, name = flag.partition("@")
        which = [k for k, p in enumerate(files) if not name or name in (str(p), p.name)]
        if not CONDITION.fullmatch(text) or not which:
            raise RecordingError(
                f"--condition {flag}: expected KEY=VALUE@FILE of a recording of --data, or KEY=VALUE for all: write it so"
            )
        for k in which:
            out[k].append(text)
    return [", ".join(texts) for texts in out]
