"""C text: the same law, written out as a C99 expression in double precision for the FMU.

Needs the core's ``stopset.h``, for functions with the same bits everywhere, and the lines of `PRELUDE`. Powers are written as
products, so that C and Python round alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

PRELUDE = """#include <math.h>
#include "stopset.h"
static double stopset_sign(double x) { return (double)((x > 0.0) - (x < 0.0)); }
static double stopset_square(double x) { return x * x; }
"""


def _text(x: Any) -> str:
    if isinstance(x, CText):
        return x.text
    value = float(x)
    if value != value or value in (float("inf"), float("-inf")):
        raise ValueError(f"{value} cannot be written as a C constant; expected a finite number")
    return repr(value) if value >= 0 else f"({value!r})"


@dataclass(frozen=True, slots=True)
class CText:
    """A C expression; ``CText("dq")`` is the variable ``dq``."""

    text: str
    __array_ufunc__ = None

    def __str__(self) -> str:
        return self.text

    def _binary(self, op: str, other: Any, swap: bool = False) -> CText:
        a, b = (_text(other), self.text) if swap else (self.text, _text(other))
        return CText(f"({a} {op} {b})")

    def __add__(self, other: Any) -> CText:
        return self._binary("+", other)

    def __radd__(self, other: Any) -> CText:
        return self._binary("+", other, swap=True)

    def __sub__(self, other: Any) -> CText:
        return self._binary("-", other)

    def __rsub__(self, other: Any) -> CText:
        return self._binary("-", other, swap=True)

    def __mul__(self, other: Any) -> CText:
        return self._binary("*", other)

    def __rmul__(self, other: Any) -> CText:
        return self._binary("*", other, swap=True)

    def __truediv__(self, other: Any) -> CText:
        return self._binary("/", other)

    def __rtruediv__(self, other: Any) -> CText:
        return self._binary("/", other, swap=True)

    def __neg__(self) -> CText:
        return CText(f"(-{self.text})")

    def __pow__(self, n: int) -> CText:
        if not isinstance(n, int) or n < 0:
            raise ValueError(f"power {n!r} in C text; expected an integer >= 0")
        return CText("(" + " * ".join([self.text] * n) + ")") if n else CText("1.0")

    def _call(self, name: str, *more: Any) -> CText:
        return CText(f"{name}({', '.join([self.text, *map(_text, more)])})")

    def sin(self) -> CText:
        """``stopset_sin`` of the core."""
        return self._call("stopset_sin")

    def cos(self) -> CText:
        """``stopset_cos`` of the core."""
        return self._call("stopset_cos")

    def exp(self) -> CText:
        """``stopset_exp`` of the core."""
        return self._call("stopset_exp")

    def tanh(self) -> CText:
        """``stopset_tanh`` of the core."""
        return self._call("stopset_tanh")

    def sqrt(self) -> CText:
        """``sqrt``."""
        return self._call("sqrt")

    def absolute(self) -> CText:
        """``fabs``."""
        return self._call("fabs")

    def sign(self) -> CText:
        """``stopset_sign`` of the prelude."""
        return self._call("stopset_sign")

    def square(self) -> CText:
        """``stopset_square`` of the prelude."""
        return self._call("stopset_square")

    def minimum(self, other: Any) -> CText:
        """``fmin``."""
        return self._call("fmin", other)

    def maximum(self, other: Any) -> CText:
        """``fmax``."""
        return self._call("fmax", other)
