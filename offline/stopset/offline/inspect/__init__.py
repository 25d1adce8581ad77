"""What a recording offers for identification, what it lacks, and what is wrong with it."""

from stopset.offline.inspect.finding import Finding
from stopset.offline.inspect.inspection import Inspection, inspect_recordings

__all__ = ["Finding", "Inspection", "inspect_recordings"]
