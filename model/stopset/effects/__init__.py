"""The catalogue of physical effects: one file, one law each; others register in the entry-point group
``stopset.effects``."""

from stopset.effects.base import REFERENCE_TEMPERATURE, Effect, Fitted, Shape, Signals, Term
from stopset.effects.registry import catalogue, check, get, names

__all__ = [
    "REFERENCE_TEMPERATURE", "Effect", "Fitted", "Shape", "Signals", "Term", "catalogue", "check", "get", "names",
]  # fmt: skip
