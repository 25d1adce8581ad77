"""Which cycle stamps keep, where they scatter by a large part of it: the line in their spectrum.

A stamp that is lost, late or out of its row takes one term out of a sum and moves nothing, so a line stands where the sender's cycle is, whatever
it is held up by, and it stands out of the noise long before the middle of the intervals is sure: whose error goes with the scatter itself, while
a line of a stamp's scatter s (in cycles) still has exp(-4 pi^2 s^2) of its power. Stamps without a cycle of their own have no narrow line.

Source: the averaged periodogram of Welch (1967), here of instants.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stopset.types import Array

STAMPS = 256  # of one spectrum; cycles that differ by one in as many are told apart
SPECTRA = 32  # that are averaged at most, each of `HOP` samples later
HOP = 64
WIDEST = 0.15  # of the model's step: so far a cycle is looked for; farther off the middle interval tells sooner
COARSE, FINE = 13, 12  # their product: frequencies that are looked at, half a line's width apart
LINE = 1.2  # widths of a line (one cycle in `STAMPS`): farther from its top little is left of it
STANDS_OUT = 3.0  # times all else: a line, and not the broad hill of stamps that are each late by what the one before was
CHANCE = 25.0  # -log of how likely noise of the same number of stamps comes to as much, at one frequency


@dataclass(slots=True)
class Rhythm:
    """Of stamps that should lie ``period`` [s] apart, or within ``tolerance`` (a part of it)."""

    period: float
    tolerance: float
    _spectra: Array = field(init=False)  # (SPECTRA, frequencies) a ring
    _taken: int = 0
    _frequencies: Array = field(init=False)  # in lines a period
    _coarse: Array = field(init=False)
    _fine: Array = field(init=False)

    def __post_init__(self) -> None:
        first, last = 1.0 / (1.0 + WIDEST), 1.0 / (1.0 - WIDEST)
        step = (last - first) / (COARSE * FINE - 1)
        self._frequencies = np.asarray(first + step * np.arange(COARSE * FINE), float)
        self._coarse, self._fine = self._frequencies[::FINE], np.asarray(step * np.arange(FINE), float)
        self._spectra = np.zeros((SPECTRA, COARSE * FINE))

    def forget(self) -> None:
        """What follows belongs to nothing before it."""
        self._taken = 0

    def take(self, stamps: Array) -> None:
        """The latest `STAMPS` stamps (STAMPS,) [s], `HOP` samples after those before."""
        with np.errstate(invalid="ignore"):
            x = 2.0 * math.pi / self.period * (stamps - stamps[0])
            coarse, fine = np.exp(1j * np.outer(self._coarse, x)), np.exp(1j * np.outer(self._fine, x))
            # not as a product of matrices: that wakes threads, and the loop, which is first in line, would wait for them
            sums: NDArray[np.complex128] = np.einsum("ck,fk->cf", coarse, fine)
            self._spectra[self._taken % SPECTRA] = np.abs(sums.reshape(-1)) ** 2 / len(stamps)  # 1 is noise
        self._taken += 1

    def other(self) -> float:
        """The cycle [s] that stamps surely keep, if that is not the one they should; else 0."""
        if not self._taken:
            return 0.0
        power = self._spectra[: min(self._taken, SPECTRA)].mean(axis=0)
        top = int(power.argmax())
        height, f = float(power[top]), self._frequencies
        if abs(1.0 / f[top] - 1.0) <= self.tolerance or not self._no_noise(height):
            return 0.0
        # nor may it be the slope of a line that is tolerated, or one among many
        elsewhere = (np.abs(f - f[top]) > LINE / STAMPS) | (np.abs(1.0 / f - 1.0) <= self.tolerance)
        return self.period / float(f[top]) if STANDS_OUT * float(power[elsewhere].max()) < height else 0.0

    def _no_noise(self, height: float) -> bool:
        """Chernoff's bound of a mean of exponentially distributed powers; spectra that overlap count for as many as do not."""
        independent = 1.0 + (min(self._taken, SPECTRA) - 1) * HOP / STAMPS
        return height > 1.0 and independent * (height - 1.0 - math.log(height)) > CHANCE
