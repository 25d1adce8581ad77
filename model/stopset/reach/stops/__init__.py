"""Bounds on stops: STOP 0 by a certified tube, STOP 1 and 2 by ramps, and where points of the arm can get meanwhile."""

from stopset.reach.stops.bounds import StopBounds, stop
from stopset.reach.stops.ramp import Ramp, ramp_of
from stopset.reach.stops.types import CATEGORIES, Category, StopBound

__all__ = ["CATEGORIES", "Category", "Ramp", "StopBound", "StopBounds", "ramp_of", "stop"]
