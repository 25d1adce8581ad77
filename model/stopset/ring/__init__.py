"""The number kinds a physical law is evaluated over: arrays, intervals, tapes, Taylor forms.

A law calls the functions below and ``+ - * / **`` with an integer exponent; which number comes in decides what comes
out: arrays give torques, `Interval` a bound over a box, `Tape` the steps that
the compiled core plays, here, in the monitor and in the FMU.  A number kind is any class with the operators and methods of these names; a
kind that cannot honour one (a Taylor form at a ``sign``) refuses with a sentence.
"""

from stopset.ring.functions import absolute, cos, exp, maximum, minimum, sign, sin, sqrt, square, tanh
from stopset.ring.interval import Interval
from stopset.ring.tape import Tape

__all__ = [
    "Interval",
    "Tape",
    "absolute",
    "cos",
    "exp",
    "maximum",
    "minimum",
    "sign",
    "sin",
    "sqrt",
    "square",
    "tanh",
]
