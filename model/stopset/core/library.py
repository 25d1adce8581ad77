"""The loaded core, and how arrays go in and out of it."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from stopset.core.build import HERE, library_name
from stopset.errors import StopsetError
from stopset.types import Array, Index, Mask

try:
    from stopset.core import _binding
except ImportError as e:  # a clone that was never installed
    raise ImportError(
        "the compiled core of stopset is missing beside stopset/core; expected it from the installation: "
        "run pip install -e . (or python -m stopset.core.build) in the clone"
    ) from e

ffi: Any = _binding.ffi
# another library in its place: one compiled with sanitizers, for tests
lib: Any = ffi.dlopen(os.environ.get("STOPSET_CORE") or str(HERE / library_name()))
_DOUBLES, _INTEGERS, _FLAGS = (ffi.typeof(f"{kind}[]") for kind in ("double", "int64_t", "uint8_t"))
REASONS = {
    lib.STOPSET_OUT_OF_RANGE: "a place outside its array; expected one within: please report this",
    lib.STOPSET_TOO_MANY_JOINTS: f"the arm has too many joints; expected 1 to {lib.STOPSET_JOINTS}: "
    "describe the chain that is monitored alone",
}


def view(x: Array) -> Any:
    """The memory of ``x`` for a call: C-contiguous doubles, seen and not copied (what is not is refused by cffi)."""
    if x.dtype != np.float64:
        raise TypeError(f"array of {x.dtype}; expected float64")
    return ffi.from_buffer(_DOUBLES, x)


def integers(x: Index) -> Any:
    """`view` of whole numbers."""
    if x.dtype != np.int64:
        raise TypeError(f"array of {x.dtype}; expected int64")
    return ffi.from_buffer(_INTEGERS, x)


def flags(x: Mask) -> Any:
    """`view` of true and false."""
    if x.dtype != np.bool_:
        raise TypeError(f"array of {x.dtype}; expected bool")
    return ffi.from_buffer(_FLAGS, x)


def given(x: Array) -> Array:
    """``x`` as contiguous doubles, copied only if it is not."""
    return np.ascontiguousarray(x, np.float64)


def check(code: int) -> None:
    """Raise `StopsetError` for a code that is not 0."""
    if code:
        raise StopsetError(REASONS[code])
