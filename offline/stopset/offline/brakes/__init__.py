"""Brakes and ramps from recorded stops: what power-off and a controlled stop really do, with intervals and a guarantee."""

from stopset.offline.brakes.judge import StopVerdict, judge_stop0, judge_stop1
from stopset.offline.brakes.stops import StopFit, divide, identify_stops, sheet_held, with_stops

__all__ = ["StopFit", "StopVerdict", "divide", "identify_stops", "judge_stop0", "judge_stop1", "sheet_held", "with_stops"]
