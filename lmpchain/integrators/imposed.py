"""Derivatives of an imposed motion or force by its amplitude and frequency, or its samples."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from ..scene.acting import Drive, Force
from ..scene.waveform import curve_through
from ..util.arrays import Array
from ..util.caching import cached_property


class ImposedCourse:
    """A motion or a force over time as a function of amplitude and frequency, or of its samples.

    Attributes
    ----------
    size : int
        2, or the number of samples, or 1 for the speed of a piston.
    """

    def __init__(self, excitation: Drive | Force):
        self.waveform = excitation.waveform
        self.frequency = excitation.frequency
        self.excitation = excitation
        self.size = excitation.numbers.size

    @cached_property
    def _basis(self) -> Any:
        """The curve through 1 at one sample and 0 at the others, for each of them."""
        drive = self.excitation
        if drive.times is None:
            # of a piston: its motion for a speed of 1
            unit = drive.replace(velocity=1.0).waveform.spline
            return PPoly(unit.c[..., None], unit.x)
        return curve_through(drive.times, np.eye(self.size), drive.interpolation, drive.holds)

    def _pieces(self, time: Array, order: int) -> tuple[NDArray[np.intp], Array]:
        """Return the piece of the spline at each time, and powers for its coefficients, (4, T)."""
        knots = self._basis.x
        piece = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, knots.size - 2)
        s = time - knots[piece]
        ones = np.ones_like(s)
        return piece, np.array(
            [s**3, s**2, s, ones] if order == 0 else [3 * s**2, 2 * s, ones, 0 * s]
        )

    def _sine(self, time: Array, order: int) -> Array:
        """Return derivatives by amplitude and frequency, (2, ...)."""
        wave = self.waveform
        # of A sin(w t) by w: t / w times its rate
        by_frequency = time * wave.at(time, order + 1) + (wave.at(time, 1) if order else 0.0)
        return np.array(
            [
                replace(wave, amplitude=1.0).at(time, order),
                by_frequency / (self.frequency or np.inf),
            ]
        )

    def pull(self, time: Array, weight: Array, order: int) -> Array:
        """Return derivatives (P,) of the sum of weight times value, or rate (order 1), at times."""
        time = time.ravel()
        weight = weight.ravel()
        if self.waveform.spline is None:
            return self._sine(time, order) @ weight
        piece, powers = self._pieces(time, order)
        # summed by pieces first: of coefficients there are as many as samples squared
        count = self._basis.x.size - 1
        by_piece = np.array([np.bincount(piece, weight * power, count) for power in powers])
        return np.tensordot(by_piece, self._basis.c, 2)

    def push(self, time: Array, change: Array, order: int) -> Array:
        """Return changes (D, ...) of value, or rate (order 1), at times, for changes (D, P)."""
        if self.waveform.spline is None:
            return np.tensordot(change, self._sine(time, order), 1)
        piece, powers = self._pieces(time, order)
        # (D, 4, P-1)
        coefficients = np.tensordot(change, self._basis.c, (1, 2))
        return np.einsum("k...,dk...->d...", powers, coefficients[:, :, piece])
