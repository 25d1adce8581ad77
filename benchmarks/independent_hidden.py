"""What can be hidden in the independent arm: an effect of a size, and between which sizes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import independent_plant as plant
from independent_arm import Array
from independent_plant import FC_POS
from independent_sets import Truth


def put(truth: Truth, j: int, **values: float) -> Truth:
    T = truth.T.copy()
    for name, value in values.items():
        T[j, getattr(plant, name)] = value
    return replace(truth, T=T)


def replaced(x: Array, j: int, value: float) -> Array:
    out = x.copy()
    out[j] = value
    return out


@dataclass(frozen=True)
class Hidden:
    """``apply(truth, joint, x, u)``: the truth with the effect of size ``x`` at a joint; ``u`` (4,) fixed draws in 0..1."""

    apply: Callable[[Truth, int, float, Array], Truth]
    lo: Callable[[Truth, int], float]
    hi: Callable[[Truth, int], float]
    mask: str = "all"
    fit: str = "b"
    whole_arm: bool = False
    pair: bool = False  # acts at joints j and j + 1


def between(lo: float, hi: float) -> tuple[Callable[[Truth, int], float], Callable[[Truth, int], float]]:
    return (lambda t, j: lo), (lambda t, j: hi)


def of_friction(lo: float, hi: float) -> tuple[Callable[[Truth, int], float], Callable[[Truth, int], float]]:
    """Limits as shares of the joint's Coulomb friction."""
    return (lambda t, j: lo * float(t.T[j, FC_POS])), (lambda t, j: hi * float(t.T[j, FC_POS]))


def fault(truth: Truth, name: str, j: int, value: float) -> Truth:
    return replace(truth, faults=truth.faults | {name: replaced(truth.fault(name), j, value)})
