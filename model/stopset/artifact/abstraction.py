"""The simple dynamics that stand for the arm: ``ddq = P(dq, sin q, cos q, u)``, a polynomial of some order.

Model 1 keeps only ``M^-1(q_a)`` and a viscous polynomial per joint; models 2 and 3 carry polynomials in
``(dq, sin q, cos q, u)`` too.  Source: Liu & Althoff (2018), eq. (13)-(16).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from weakref import WeakKeyDictionary

import numpy as np

from stopset.artifact.polynomial import Polynomial, Program, compiled, evaluate
from stopset.types import Array

__all__ = ["Abstraction", "Polynomial"]


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Abstraction:
    """``ddq = Minv (u - viscous(dq) - coriolis(dq, s, c))`` (models 1, 2) or ``ddq = acceleration(dq, s, c, u)`` (model
    3).

    ``Minv``: (n, n) [1/(kg m^2)], the inverse of ``M(q_a) + J_rotor``; ``viscous``: (n, r) coefficients of
    ``dq, dq^2, ..., dq^r`` [N m (s/rad)^k]; ``coriolis``: n polynomials in ``(dq, sin q, cos q)`` (3n variables), empty
    in model 1; ``acceleration``: n polynomials in ``(dq, sin q, cos q, u)`` (4n variables), only in model 3.
    ``offset``: (n,) constant torque [N m] taken off the input by `stopset.artifact.inputs.InputMap` (empty: none);
    ``swift``: so is Coriolis and centrifugal torque at the measured speed (model 1 of motor torque).
    """

    kind: int
    order: int
    Minv: Array
    viscous: Array
    coriolis: tuple[Polynomial, ...] = ()
    acceleration: tuple[Polynomial, ...] = ()
    offset: Array = field(default_factory=lambda: np.zeros(0))
    standstill: Array = field(default_factory=lambda: np.zeros(0))
    swift: bool = False

    def __post_init__(self) -> None:
        """A polynomial without terms, which a file holds without its variables, is one of them all the same."""
        for name, variables in (("coriolis", 3 * self.n), ("acceleration", 4 * self.n)):
            whole = (
                p if p.exponent.size else replace(p, exponent=np.zeros((0, variables), np.int64)) for p in getattr(self, name)
            )
            object.__setattr__(self, name, tuple(whole))

    @property
    def n(self) -> int:
        return int(self.Minv.shape[0])

    @property
    def linear(self) -> bool:
        """Whether the dynamics are ``x' = A x + B u`` exactly."""
        return self.kind == 1 and not np.any(self.viscous[:, 1:])

    @property
    def A(self) -> Array:
        """(2n, 2n) state matrix over ``x = (q, dq)``, linearised at rest."""
        n = self.n
        A = np.zeros((2 * n, 2 * n))
        A[:n, n:] = np.eye(n)
        A[n:, n:] = -self.Minv * self.viscous[:, 0]
        return A

    @property
    def B(self) -> Array:
        """(2n, n) input matrix."""
        return np.vstack([np.zeros((self.n, self.n)), self.Minv])

    @property
    def decoupled(self) -> bool:
        """Whether every joint is a system of its own (``Minv`` diagonal)."""
        return self.kind == 1 and not np.any(self.Minv - np.diag(np.diag(self.Minv)))

    @property
    def program(self) -> Program:
        """The polynomials of model 2 or 3, compiled for evaluation (once per abstraction); model 1 has none."""
        if self not in _PROGRAMS:
            _PROGRAMS[self] = compiled(self.acceleration if self.kind == 3 else self.coriolis)
        return _PROGRAMS[self]

    def ddq(self, q: Array, dq: Array, u: Array) -> Array:
        """Accelerations at rows of ``q, dq, u`` (N, n) -> (N, n) [rad/s^2]."""
        if self.kind == 3:
            return evaluate(self.program, np.hstack([dq, np.sin(q), np.cos(q), u]))
        friction = sum(self.viscous[:, k] * dq ** (k + 1) for k in range(self.viscous.shape[1]))
        if self.coriolis:
            friction = friction + evaluate(self.program, np.hstack([dq, np.sin(q), np.cos(q)]))
        return (u - friction) @ self.Minv.T


# a frozen, slotted value has no room for a cache of its own; entries go when the abstraction goes
_PROGRAMS: WeakKeyDictionary[Abstraction, Program] = WeakKeyDictionary()
