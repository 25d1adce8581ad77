"""What a stop that began now would leave to the limits, and how fast the arm may be for it to leave enough."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

from stopset.artifact import Model
from stopset.monitor.certificates import Numbers
from stopset.monitor.config import Config, StopLimits
from stopset.monitor.margins import exceeded, margins
from stopset.monitor.override import Advisor
from stopset.monitor.sample import Quantum, Sample
from stopset.reach.stops.setting import readings_of
from stopset.sets import Box

OLD = 3  # times as far apart as advice is asked for: older advice is none, who gives it hangs


@dataclass(slots=True)
class Remaining:
    """``margins`` and ``override`` as of the last `measure`, None before it or where there is none."""

    model: Model
    limits: StopLimits
    advisor: Advisor | None
    margins: dict[str, Any] | None = None
    override: dict[str, Any] | None = None
    _begins: Box = field(init=False)  # (n,) [rad] where the stop's angles begin, less those that are read

    def __post_init__(self) -> None:
        noise, start = readings_of(self.model)
        self._begins = (start if self.limits.category == "0" else Box(-noise.hi, -noise.lo)).take(slice(0, self.model.n))

    @classmethod
    def of(cls, config: Config, model: Model) -> Self:
        """A process is started where an override is asked for."""
        return cls(model, config.limits, Advisor(config, model.sha256) if config.limits.override else None)

    def measure(self, now: float, s: Sample, stops: dict[str, Numbers], quantum: Quantum) -> list[str]:
        """At ``now`` [s]; which limits a stop by these numbers would not keep."""
        numbers = stops.get(self.limits.category)
        if numbers is None:
            return []
        self.margins = margins(self.model.robot, self.limits, s.q + self._begins.centre, numbers, quantum.q + self._begins.radius)
        if self.advisor is not None:
            self.advisor.offer(now, s, quantum)
            said, oldest = self.advisor.said, OLD * self.limits.override_every_s
            if said is not None and abs(s.t - said[0]) <= oldest:
                self.override = {"percent": 100.0 * said[1], "category": self.limits.category, "t_ns": round(said[0] * 1e9)}
            else:
                self.override = None
        return exceeded(self.margins)

    def close(self) -> None:
        """End the process."""
        if self.advisor is not None:
            self.advisor.close()
