"""A job of the workbench, and what goes between the page's process and the one that does it: orders there, messages back."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stopset.artifact import Model
from stopset.offline.compare.compare import Comparison
from stopset.offline.compare.dependence import Explained
from stopset.progress import Progress, left

Answer = dict[str, Any]
Export = Callable[[Model, Path, Progress], None]  # writes a model as FMU; comes from above, this part knows no FMU
STEPS = 40  # kept of what a job said


@dataclass(frozen=True, slots=True)
class Order:
    """What to do with which model and recordings; ``target``: the file or folder it may write; ``options``: of the action."""

    action: str
    model: Path
    data: tuple[Path, ...]
    conditions: tuple[str, ...]
    target: Path | None
    options: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Says:
    """How far it is, as `Progress` is given it."""

    text: str
    share: float | None


@dataclass(frozen=True, slots=True)
class Answered:
    """A part of the answer, and its page as HTML where it has one."""

    name: str
    answer: Answer
    page: str | None = None


@dataclass(frozen=True, slots=True)
class Compared:
    """What later questions about recordings are answered from."""

    found: Comparison
    shares: Explained | None = None


@dataclass(frozen=True, slots=True)
class RevisionWritten:
    """A new revision was written; what follows is about it."""

    path: Path


@dataclass(frozen=True, slots=True)
class Ended:
    """The last message of a job; ``error``: why there is no answer; ``defect``: it is a fault of ours."""

    error: str = ""
    defect: bool = False


Message = Says | Answered | Compared | RevisionWritten


@dataclass(slots=True)
class Job:
    """The running job, or the last one: what, how far, what it said on the way, and why it ended without an answer."""

    what: str
    automatic: bool = False  # nobody asked for it: it gives way to who does
    started: float = field(default_factory=time.monotonic)
    says: str = ""
    share: float | None = None
    steps: list[str] = field(default_factory=list)
    step_began: float = field(default_factory=time.monotonic)
    seconds: float | None = None  # None while it runs
    error: str = ""
    stopped: bool = False

    @property
    def action(self) -> str:
        return self.what.partition(" ")[0]

    def report(self, text: str, share: float | None = None) -> None:
        """As `Progress`: a step without a share is one of its own, counted ones follow each other."""
        if share is None or self.share is None or share < self.share:
            self.step_began = time.monotonic()
        if share is None:
            self.steps = [*self.steps, text][-STEPS:]
        self.says, self.share = text, share

    def shown(self, usual: float | None) -> Answer:
        """As the page shows it; ``usual``: seconds that this took last."""
        now = time.monotonic()
        running = self.seconds is None
        remaining = left(now - self.step_began, self.share) if running else None
        return {
            "what": self.what, "says": self.says, "running": running, "automatic": self.automatic, "stopped": self.stopped,
            "seconds": round(now - self.started if self.seconds is None else self.seconds, 1), "error": self.error,
            "share": self.share, "left": None if remaining is None else round(remaining, 1), "usual": usual, "steps": list(self.steps),
        }  # fmt: skip
