"""Many arms at once: each identified and diagnosed as alone, here or on a Dask cluster."""

from stopset.offline.fleet.arms import ArmAnswer, ArmFolder, find_arms
from stopset.offline.fleet.spread import answers

__all__ = ["ArmAnswer", "ArmFolder", "answers", "find_arms"]
