"""One identification's material: the arm, its recordings, what one pass over them found, and what is asked of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from stopset.offline.campaign.settings import Settings
from stopset.offline.campaign.survey import Survey
from stopset.offline.campaign.trials import Source
from stopset.recording import Meta
from stopset.robot import Robot


@dataclass(frozen=True, slots=True)
class Run:
    """What travels together through an identification; ``trials`` are read anew at every call."""

    robot: Robot
    meta: Meta
    trials: Source
    survey: Survey
    settings: Settings

    @property
    def learning(self) -> Run:
        """The run of what may shape the nominal model: what is held out to judge the sets must not have."""
        held, trials = self.survey.held_out, self.trials
        learnt = replace(self.survey, sample=tuple(r for r in self.survey.sample if r.suite_key not in held))
        return replace(self, trials=lambda: (r for r in trials() if r.suite_key not in held), survey=learnt)

    @property
    def motions(self) -> int:
        """How many independent motions were recorded."""
        return len(set(self.survey.motion.values()))

    @property
    def horizon(self) -> float:
        """How far ahead [s] is predicted: as asked, but not beyond the longest trial."""
        return self.survey.within(self.settings.horizon)
