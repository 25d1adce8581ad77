"""Taylor forms: a law evaluated over them gives its Taylor polynomial, by nothing but ``+ - * /`` on polynomials.

A form is a sparse polynomial in the deviations ``z_1 .. z_d`` from the expansion point, cut at total degree ``p``.  A
monomial is one integer: the total degree in the top bits, then one field per variable.  Multiplying monomials adds
their integers, and sorting by them sorts by degree, so a product loops exactly over the pairs whose degree survives the
cut.

Written here instead of taken from a library because the forms of an arm are sparse and of low order: the compiled
product below needs no table over all monomials, so its memory grows with what is in the polynomial, not with what could
be.

Source: Liu & Althoff (2018), Sec. III-A and Def. 3; Berz (1999), Modern Map Methods in Particle Beam Physics, ch. 2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from stopset.core.library import ffi, integers, lib, view
from stopset.errors import StopsetError
from stopset.types import Array

MonomialKeys = NDArray[np.int64]
MEMORY_LIMIT = 2 << 30  # [bytes] what one construction may need at most
_KEY_BITS = 63
_TERM_BYTES = 16  # a key and a coefficient
_WORK_BYTES = 64  # hash table at half load, sorting, per term of a product


class TaylorError(StopsetError):
    """A Taylor form cannot be made: the law is not smooth there, or the polynomial would not fit into memory."""


def monomials(variables: int, order: int) -> int:
    """How many monomials of total degree <= ``order`` there are in so many variables."""
    return math.comb(variables + order, order)


def _terms(key: MonomialKeys, value: Array) -> Any:
    """``StopsetTaylor``, which lives no longer than the arrays."""
    return ffi.new("StopsetTaylor *", (len(key), integers(key), view(value)))


def _multiply(
    ka: MonomialKeys, a: Array, kb: MonomialKeys, b: Array, order: int, shift: int, room: int
) -> tuple[MonomialKeys, Array]:
    """Terms of the product up to ``order``, unsorted; ``room``: a bound of their number."""
    size = 16
    while size < 2 * room:
        size *= 2
    slot, key, value = np.empty(size, np.int64), np.empty(room, np.int64), np.empty(room)
    product = ffi.new("StopsetProduct *", (room, size, integers(slot), integers(key), view(value)))
    used = lib.stopset_taylor_multiply(_terms(ka, a), _terms(kb, b), order, shift, product)
    if used < 0:
        raise TaylorError(f"a product of {len(ka)} and {len(kb)} terms has more than the {room} that fit; lower the order")
    return key[:used], value[:used]


def _add(ka: MonomialKeys, a: Array, kb: MonomialKeys, b: Array, factor: float) -> tuple[MonomialKeys, Array]:
    """Sorted terms of ``a + factor * b``."""
    key, value = np.empty(len(ka) + len(kb), np.int64), np.empty(len(ka) + len(kb))
    m = lib.stopset_taylor_add(_terms(ka, a), _terms(kb, b), factor, integers(key), view(value))
    return key[:m], value[:m]


@dataclass(frozen=True, slots=True)
class Algebra:
    """Taylor forms in ``variables`` deviations up to total degree ``order``.

    ``live``: about how many full polynomials the computation holds at once; with it the memory is predicted *before*
    anything is computed, and a size that would not fit into ``limit`` bytes is refused (a general library dies there
    without a word). ``sparse``: a bound of the terms of any polynomial in the computation, where its structure gives a
    lower one than counting.
    """

    variables: int
    order: int
    live: int = 1
    sparse: int | None = None
    limit: int = MEMORY_LIMIT

    def __post_init__(self) -> None:
        need = self.predicted_bytes
        if need > self.limit:
            raise TaylorError(
                f"Taylor forms of order {self.order} in {self.variables} variables have {self.terms:,} "
                f"monomials, about {need / 2**30:.1f} GiB for {self.live} of them; allowed are "
                f"{self.limit / 2**30:.1f} GiB: "
                "lower the order, or use the structure (linear in u, free of the first joint's angle) to save variables"
            )
        if self.bits * (self.variables + 1) > _KEY_BITS:
            raise TaylorError(
                f"order {self.order} in {self.variables} variables needs {self.bits * (self.variables + 1)} bits per "
                f"monomial; expected at most {_KEY_BITS}: lower the order or the number of variables"
            )

    @property
    def bits(self) -> int:
        """Width of one exponent's field."""
        return max(1, self.order.bit_length())

    @property
    def terms(self) -> int:
        """Most terms a polynomial can have."""
        full = monomials(self.variables, self.order)
        return full if self.sparse is None else min(full, self.sparse)

    @property
    def predicted_bytes(self) -> int:
        return self.terms * (_TERM_BYTES * self.live + _WORK_BYTES)

    def constant(self, x: float) -> Taylor:
        return self.from_terms(np.zeros(1, np.int64), np.array([float(x)]))

    def variable(self, i: int, at: float = 0.0) -> Taylor:
        """The number ``at + z_i``."""
        if self.order == 0:
            return self.constant(at)
        key = (1 << self._shift) | (1 << (self.bits * i))
        return self.from_terms(np.array([0, key], np.int64), np.array([float(at), 1.0]))

    def from_terms(self, key: MonomialKeys, value: Array) -> Taylor:
        """A form from sorted, distinct monomials."""
        keep = value != 0.0
        return Taylor(self, key[keep], value[keep])

    def from_exponents(self, exponent: MonomialKeys, value: Array) -> Taylor:
        """A form from monomials in any order, equal ones added up and those above the order cut; ``exponent``: (m, d)."""
        degree = exponent.sum(axis=1)
        keep = degree <= self.order
        fields = np.arange(self.variables, dtype=np.int64) * self.bits
        key = (degree[keep] << self._shift) | (exponent[keep] << fields).sum(axis=1)
        distinct, where = np.unique(key, return_inverse=True)
        total = np.zeros(distinct.size)
        np.add.at(total, where.ravel(), value[keep])
        return self.from_terms(distinct, total)

    @property
    def _shift(self) -> int:
        return self.bits * self.variables


@dataclass(frozen=True, slots=True, eq=False)
class Taylor:
    """One Taylor polynomial: sorted monomials ``key`` (m,) and their coefficients ``value`` (m,)."""

    algebra: Algebra
    key: MonomialKeys
    value: Array
    __array_ufunc__ = None  # numpy scalars and arrays hand over to the operators below

    @property
    def constant(self) -> float:
        """Value at the expansion point."""
        return float(self.value[0]) if self.key.size and self.key[0] == 0 else 0.0

    @property
    def exponents(self) -> MonomialKeys:
        """(m, d) exponents of the monomials."""
        bits, d = self.algebra.bits, self.algebra.variables
        fields = np.arange(d, dtype=np.int64) * bits
        return np.asarray((self.key[:, None] >> fields) & ((1 << bits) - 1), dtype=np.int64)

    @property
    def degrees(self) -> MonomialKeys:
        """(m,) total degrees of the monomials."""
        return np.asarray(self.key >> self.algebra._shift, dtype=np.int64)

    def __call__(self, z: Array) -> Array:
        """Values at the rows of ``z`` (N, d): deviations from the expansion point."""
        return np.asarray(np.prod(np.asarray(z, float)[:, None, :] ** self.exponents, axis=2) @ self.value)

    def _plus(self, other: Any, factor: float) -> Taylor:
        b = other if isinstance(other, Taylor) else self.algebra.constant(float(other))
        if b.algebra != self.algebra:
            raise ValueError(f"Taylor forms of different kinds: {self.algebra} and {b.algebra}; expected one")
        return Taylor(self.algebra, *_add(self.key, self.value, b.key, b.value, factor))

    def __add__(self, other: Any) -> Taylor:
        return self._plus(other, 1.0)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Taylor:
        return self._plus(other, -1.0)

    def __neg__(self) -> Taylor:
        return Taylor(self.algebra, self.key, -self.value)

    def __rsub__(self, other: Any) -> Taylor:
        return (-self)._plus(other, 1.0)

    def __mul__(self, other: Any) -> Taylor:
        if not isinstance(other, Taylor):
            x = float(other)
            return Taylor(self.algebra, self.key, x * self.value) if x != 0.0 else self.algebra.constant(0.0)
        if other.algebra != self.algebra:
            raise ValueError(f"Taylor forms of different kinds: {self.algebra} and {other.algebra}; expected one")
        room = max(1, min(self.key.size * other.key.size, monomials(self.algebra.variables, self.algebra.order)))
        key, value = _multiply(self.key, self.value, other.key, other.value, self.algebra.order, self.algebra._shift, room)
        rank = np.argsort(key)
        return self.algebra.from_terms(key[rank], value[rank])

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Taylor:
        return self.__mul__(other.reciprocal() if isinstance(other, Taylor) else 1.0 / float(other))

    def __rtruediv__(self, other: Any) -> Taylor:
        return self.reciprocal().__mul__(other)

    def __pow__(self, n: int) -> Taylor:
        if not isinstance(n, int) or n < 0:
            raise ValueError(f"power {n!r} of a Taylor form; expected an integer >= 0")
        out = self.algebra.constant(1.0)
        for _ in range(n):
            out = out * self
        return out

    def _compose(self, series: Sequence[float]) -> Taylor:
        """``sum_k series[k] * (self - constant)^k``, the outer function's own Taylor series put in by Horner's rule."""
        e = self - self.constant
        out = self.algebra.constant(series[-1])
        for a in reversed(series[:-1]):
            out = out * e + a
        return out

    def reciprocal(self) -> Taylor:
        """``1 / x``."""
        a = self.constant
        if a == 0.0:
            raise TaylorError("division by a Taylor form that is 0 at the expansion point; choose another expansion point")
        return self._compose([(-1.0) ** k / a ** (k + 1) for k in range(self.algebra.order + 1)])

    def exp(self) -> Taylor:
        """Exponential."""
        return self._compose([math.exp(self.constant) / math.factorial(k) for k in range(self.algebra.order + 1)])

    def sin(self) -> Taylor:
        """Sine; derivatives repeat every four."""
        a = self.constant
        turn = (math.sin(a), math.cos(a), -math.sin(a), -math.cos(a))
        return self._compose([turn[k % 4] / math.factorial(k) for k in range(self.algebra.order + 1)])

    def cos(self) -> Taylor:
        """Cosine."""
        return (self + math.pi / 2).sin()

    def tanh(self) -> Taylor:
        """Hyperbolic tangent, from ``t' = 1 - t^2``."""
        t = [math.tanh(self.constant)]
        for k in range(self.algebra.order):
            t.append(((k == 0) - sum(t[i] * t[k - i] for i in range(k + 1))) / (k + 1))
        return self._compose(t)

    def sqrt(self) -> Taylor:
        """Square root at a positive expansion point."""
        a = self.constant
        if a <= 0.0:
            raise TaylorError(f"square root of a Taylor form that is {a:g} at the expansion point; expected a positive number")
        c = [math.sqrt(a)]
        for k in range(self.algebra.order):
            c.append(c[-1] * (0.5 - k) / ((k + 1) * a))
        return self._compose(c)

    def square(self) -> Taylor:
        """``x * x``."""
        return self * self

    def _not_smooth(self, what: str) -> NoReturn:
        raise TaylorError(f"{what} has a jump or a kink and no Taylor form; keep it inside the input u, eq. (11)")

    def sign(self) -> NoReturn:
        """Refused: not smooth."""
        self._not_smooth("sign(x)")

    def absolute(self) -> NoReturn:
        """Refused: not smooth."""
        self._not_smooth("|x|")

    def minimum(self, _other: Any) -> NoReturn:
        """Refused: not smooth."""
        self._not_smooth("min(x, y)")

    def maximum(self, _other: Any) -> NoReturn:
        """Refused: not smooth."""
        self._not_smooth("max(x, y)")

    def derivative(self, i: int) -> Taylor:
        """Partial derivative in variable ``i``; exact to one order less than the form itself."""
        bits = self.algebra.bits
        e = (self.key >> (bits * i)) & ((1 << bits) - 1)
        keep = e > 0
        one = (1 << self.algebra._shift) | (1 << (bits * i))
        key = self.key[keep] - one  # taking one variable off every monomial keeps their order
        return self.algebra.from_terms(key, self.value[keep] * e[keep])

    def cut(self, order: int) -> Taylor:
        """Only the terms up to total degree ``order``."""
        keep = self.degrees <= order
        return Taylor(self.algebra, self.key[keep], self.value[keep])
