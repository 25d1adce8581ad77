"""What is asked of uncertainty sets: of which abstraction, read how exactly, on which grid, how far ahead, and in which form."""

from __future__ import annotations

from dataclasses import dataclass, replace

from stopset.artifact import Abstraction
from stopset.offline.campaign.reading_error import ReadingError
from stopset.offline.conform.zonotopes import Template
from stopset.reach.flowpipe import Responses, responses
from stopset.sets import Box


@dataclass(frozen=True, slots=True)
class Options:
    """How the sets are asked for. ``margin`` None: calibrated; else the factor itself."""

    conform: str = "all"  # states that must be enclosed, or "position" alone
    windows: str = "sliding"  # predictions restart at every sample, or "start": at each trial's start only
    margin: float | None = None


@dataclass(frozen=True, slots=True)
class SetProblem:
    """One problem of uncertainty sets, whatever the recordings it is solved on.

    ``readings`` (2n,): their error over (q, dq); ``dt`` [s] of the grid, ``horizon`` [s] ahead; ``template``: of the torque set
    where it is a zonotope.
    """

    abstraction: Abstraction
    joints: tuple[str, ...]
    readings: ReadingError
    dt: float
    horizon: float
    options: Options = Options()
    template: Template | None = None

    @property
    def steps(self) -> int:
        """The horizon in steps of the grid."""
        return round(self.horizon / self.dt)

    def asking(self, conform: str) -> SetProblem:
        """The same with other states enclosed."""
        return replace(self, options=replace(self.options, conform=conform))

    def reading(self, V: Box) -> SetProblem:
        """The same with ``V`` given, no choice left."""
        return replace(self, readings=ReadingError.exact(V))

    def responses(self) -> Responses:
        """To the inputs and in the directions of a zonotope's template, or to each joint's torque in each state."""
        if self.template is None:
            return responses(self.abstraction, self.dt, self.steps)
        return responses(self.abstraction, self.dt, self.steps, self.template.torques, self.template.rows)
