"""Linear filters along the first axis: a low-pass without phase, and a lag of first order; the loops are the core's.

`scipy.signal` gives the same bits (a test holds them); to import it takes longer than to filter a campaign.
Source: Oppenheim & Schafer, Discrete-Time Signal Processing (Butterworth's poles, the bilinear transform).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from stopset.core.library import given, lib, view
from stopset.types import Array

ORDER = 4  # of the Butterworth low-pass, run forwards and backwards: no phase, -6 dB at the cut-off


@lru_cache(maxsize=64)
def low_pass(relative: float) -> Array:
    """(ORDER / 2, 6) sections of Butterworth's low-pass for a cut-off relative to the sampling rate, its worst poles last."""
    warped = 4.0 * np.tan(np.pi * relative)  # the bilinear transform at a sampling rate of 2 bends frequencies
    analog = warped * -np.exp(1j * np.pi * np.arange(-ORDER + 1, ORDER, 2) / (2 * ORDER))
    poles = (4.0 + analog) / (4.0 - analog)
    upper, lower = (np.sort_complex(poles[s * poles.imag > 0]) for s in (1, -1))
    pairs = 0.5 * (upper + lower.conj())
    sos = np.tile([1.0, 2.0, 1.0, 1.0, 0.0, 0.0], (len(pairs), 1))
    sos[:, 4:] = [np.real(np.poly([p, p.conj()]))[1:] for p in pairs[np.argsort(-np.abs(1 - np.abs(pairs)))]]
    sos[0, :3] *= warped**ORDER * np.real(1.0 / np.prod(4.0 - analog))
    return sos


@lru_cache(maxsize=64)
def _at_rest(sections: bytes) -> Array:
    """State (sections, 2) of a filter that has seen ones for ever."""
    out, gain = [], 1.0
    for b0, b1, b2, _, a1, a2 in np.frombuffer(sections).reshape(-1, 6).tolist():
        out.append(gain * np.linalg.solve([[1.0 + a1, -1.0], [a2, 1.0]], [b1 - a1 * b0, b2 - a2 * b0]))
        gain *= (b0 + b1 + b2) / (1.0 + a1 + a2)
    return np.array(out)


def _run(sos: Array, state: Array, x: Array) -> None:
    """``x`` (N, columns) through the filter, in place, from ``state`` (sections, 2, columns) on."""
    lib.stopset_filter(*x.shape, len(sos), view(sos), view(state), view(x))


def zero_phase(sos: Array, x: Array) -> Array:
    """``x`` (N, ...) forwards and backwards through a filter, with odd ends: no phase, twice its attenuation."""
    pad = min(len(x) - 1, 3 * ORDER * 8)
    flat = np.reshape(x, (len(x), -1))
    y = np.concatenate([2 * flat[:1] - flat[pad:0:-1], flat, 2 * flat[-1:] - flat[-2 : -pad - 2 : -1]])
    rest = _at_rest(sos.tobytes())[:, :, None]
    for _ in range(2):
        _run(sos, rest * y[0], y)
        y = np.ascontiguousarray(y[::-1])
    return np.reshape(y[pad : len(y) - pad], x.shape)


def lag(decay: float, x: Array) -> Array:
    """``y(k) = decay y(k-1) + x(k)`` of every column of ``x`` (N, columns), from rest."""
    y = given(x).copy()
    _run(np.array([[1.0, 0.0, 0.0, 1.0, -decay, 0.0]]), np.zeros((1, 2, y.shape[1])), y)
    return y


def first_order(x: Array, time: float) -> Array:
    """``x`` (N, columns) through 1 / (``time`` s + 1), ``time`` in samples, begun at rest: bilinear, so without a hold's half sample."""
    mean = 0.5 * (x + np.concatenate([x[:1], x[:-1]])) - x[:1]
    return np.asarray(x[:1] + lag((time - 0.5) / (time + 0.5), mean / (time + 0.5)))
