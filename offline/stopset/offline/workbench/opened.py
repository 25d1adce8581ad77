"""A model at hand in the workbench, with what was found out about it so far."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from stopset.artifact import Model
from stopset.offline.compare.compare import Comparison
from stopset.offline.compare.dependence import Explained
from stopset.offline.workbench.jobs import Answer


@dataclass(slots=True)
class Opened:
    """``answers`` and ``pages`` by what was asked; ``left_alone``: what is not to be tried again without being asked."""

    path: Path
    model: Model
    answers: dict[str, Answer] = field(default_factory=dict)
    pages: dict[str, str] = field(default_factory=dict)
    found: Comparison | None = None
    shares: Explained | None = None
    left_alone: set[str] = field(default_factory=set)

    def shown(self) -> Answer:
        """As the page shows it."""
        m = self.model
        return {
            "file": str(self.path), "sha256": m.sha256, "guarantee": m.guarantee.text, "answers": dict(self.answers),
            "revisions": [
                {"number": r.number, "added": r.added, "note": r.note, "before": dict(r.before), "after": dict(r.after)}
                for r in m.revisions
            ],
        }  # fmt: skip
