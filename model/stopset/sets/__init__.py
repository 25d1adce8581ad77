"""Sets: boxes and zonotopes, and what one may do with them without losing a point."""

from stopset.sets.box import Box
from stopset.sets.zonotope import Zonotope

__all__ = ["Box", "Zonotope"]
