"""Sets: boxes, and what one may do with them without losing a point."""

from stopset.sets.box import Box

__all__ = ["Box"]
