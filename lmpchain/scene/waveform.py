"""Waveforms of forces and motions: sine, Hann tone burst, half-sine, curve through points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..util.arrays import EPSILON, Array, numbers
from ..util.lazy import cached_property

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

Interpolation = Literal["pchip", "linear", "spline"]
TIME_ROUNDING = 4 * EPSILON  # Relative rounding error of sample times.
# Largest speed of a curve by frequencies above the band edge, relative to its largest speed.
NEGLIGIBLE_SPEED = 1e-3
# Longest record, in samples, for which a spectrum is computed.
SPECTRUM_SAMPLES = 2**20


def curve_through(times: Array, values: Array, interpolation: Interpolation, holds: bool) -> PPoly:
    """Return the piecewise cubic through points, continued before and after them.

    Before the first point the curve is 0. If the first value is not 0, the curve rises to it
    linearly, within a time equal to the first sampling interval, but not before t = 0. After the
    last point a motion keeps its value, and a force falls linearly to 0 within a time equal to the
    last sampling interval.

    Parameters
    ----------
    times : (P,) array
        Times of the points, s, increasing and not negative.
    values : (P, ...) array
        Values at the points.
    interpolation : "pchip", "linear" or "spline"
        The curve between points: monotone (Fritsch and Carlson, SIAM J. Numer. Anal. 17, 238
        (1980)), straight lines, or a cubic spline (not-a-knot), which may leave the range of the
        points.
    holds : bool
        Whether the curve keeps its last value.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator, PPoly

    if interpolation == "linear":
        curve = _straight(times, values)
    else:
        make = PchipInterpolator if interpolation == "pchip" else CubicSpline
        curve = make(times, values)
    # A sample at the last point belongs to the curve, even if rounding shifted it slightly later.
    behind = times[-1] * (1 + TIME_ROUNDING)
    last = curve(behind)[None]
    # The last piece is extrapolated without end, so it must be constant.
    ends = behind + (times[-1] - times[-2]) * np.arange(2 if holds else 3)
    rest = [last, last] if holds else [last, 0 * last, 0 * last]
    pieces = [
        *_rise(times, values),
        PPoly(curve.c, np.append(times[:-1], behind)),
        _straight(ends, np.concatenate(rest)),
    ]
    begins = np.concatenate([piece.x[:-1] for piece in pieces])
    coefficients = np.concatenate([piece.c for piece in pieces], axis=1)
    return PPoly(coefficients, np.append(begins, ends[-1]))


def _rise(times: Array, values: Array) -> list[PPoly]:
    """Return the pieces before a first point later than t = 0: rest, and a linear rise."""
    if times[0] == 0:
        return []
    begin = max(2 * times[0] - times[1], 0.0)
    first = values[:1]
    if begin == 0:
        return [_straight(np.array([0.0, times[0]]), np.concatenate([0 * first, first]))]
    path = np.concatenate([0 * first, 0 * first, first])
    return [_straight(np.array([0.0, begin, times[0]]), path)]


def _straight(times: Array, values: Array) -> PPoly:
    """Return the straight lines through points as cubics."""
    from scipy.interpolate import PPoly

    gaps = np.diff(times).reshape(-1, *[1] * (values.ndim - 1))
    slopes = np.diff(values, axis=0) / gaps
    return PPoly(np.array([0 * slopes, 0 * slopes, slopes, values[:-1]]), times)


@dataclass(frozen=True, eq=False)
class Waveform:
    """A function of time: ``A sin(w t) sin(e t)^2`` up to its end, or a piecewise cubic.

    Attributes
    ----------
    amplitude : float
        The amplitude A, m for a motion and N for a force.
    omega : float
        The frequency w of the sine, rad/s.
    envelope : float
        The frequency e of the envelope, rad/s. If e is 0, there is no envelope.
    end : float
        Time after which the function is 0, s; may be infinite.
    spline : PPoly, optional
        A piecewise cubic, in place of the sine.
    holds : bool
        Whether a piecewise cubic is a motion, which keeps its last value, and not a force.
    """

    amplitude: float = 0.0
    omega: float = 0.0
    envelope: float = 0.0
    end: float = np.inf
    spline: PPoly | None = None
    holds: bool = True

    @classmethod
    def sine(cls, amplitude: float, frequency: float, cycles: float | None = None) -> Waveform:
        """Return a sine, or a Hann burst ``A sin(2 pi f t) sin(pi f t / cycles)^2``."""
        omega = 2 * np.pi * frequency
        if cycles is None:
            return cls(amplitude, omega)
        return cls(amplitude, omega, omega / (2 * cycles), cycles / frequency)

    @classmethod
    def half_sine(cls, amplitude: float, duration: float) -> Waveform:
        """Return the positive half of a sine."""
        return cls(amplitude, np.pi / duration, 0.0, duration)

    @classmethod
    def through(
        cls, times: Array, values: Array, interpolation: Interpolation, holds: bool
    ) -> Waveform:
        """Return the waveform of `curve_through`."""
        return cls(spline=curve_through(times, values, interpolation, holds), holds=holds)

    @classmethod
    def piston(cls, velocity: float, rise: float) -> Waveform:
        """Return a motion at constant speed after a smooth start with a triangular acceleration."""
        from scipy.interpolate import PPoly

        half = rise / 2
        jerk = 4 * velocity / rise**2
        # Cubic, square, linear and constant terms of the first and second half of the rise, and of
        # the motion at constant speed.
        pieces = [
            [jerk / 6, 0.0, 0.0, 0.0],
            [-jerk / 6, velocity / rise, velocity / 2, velocity * rise / 12],
            [0.0, 0.0, velocity, velocity * half],
        ]
        # The last piece is extrapolated without end.
        return cls(spline=PPoly(np.transpose(pieces), [0.0, half, rise, 2 * rise]))

    def at(self, t: float | Array, order: int = 0) -> Array:
        """Return the values at these times, s, or derivatives of order 1 to 3."""
        t = numbers(t, "t")
        if self.spline is not None:
            return self.spline(t, order)
        value = self._burst(t, order) if self.envelope else self._sine(t, order)
        return value if np.isinf(self.end) else np.where(t < self.end, value, 0.0)

    def _sine(self, t: Array, order: int) -> Array:
        """Return ``A sin(w t)``, or its derivative."""
        w = self.omega
        value = self.amplitude * np.sin(w * t)
        slope = self.amplitude * w * np.cos(w * t)
        return (value, slope, -(w**2) * value, -(w**2) * slope)[order]

    def _burst(self, t: Array, order: int) -> Array:
        """Return ``A sin(w t) h`` with ``h = sin(e t)^2``, or a derivative by Leibniz's rule."""
        w = self.omega
        e = self.envelope
        sin = np.sin(w * t)
        cos = np.cos(w * t)
        # First two derivatives of h; the third derivative is -4 e^2 times the first.
        hann = np.sin(e * t) ** 2
        slope = e * np.sin(2 * e * t)
        bend = 2 * e**2 * np.cos(2 * e * t)
        first = w * cos * hann + sin * slope
        second = -(w**2) * sin * hann + 2 * w * cos * slope + sin * bend
        third = -(w**2) * cos * hann - 3 * w * sin * slope + 3 * cos * bend
        third = third * w - 4 * e**2 * sin * slope
        return self.amplitude * (sin * hann, first, second, third)[order]

    def integral(self, t: float | Array) -> Array:
        """Return the integral from 0 to these times, s."""
        t = numbers(t, "t")
        if self.spline is not None:
            return np.asarray(self.spline.antiderivative()(t))
        until = np.minimum(t, self.end)
        # This form of 1 - cos x avoids cancellation. A side band of a burst of one cycle has zero
        # frequency and adds nothing.
        parts = [2 * a / w * np.sin(w * until / 2) ** 2 for a, w in self.sines if w]
        return np.asarray(sum(parts, np.zeros(until.shape)))

    @property
    def sines(self) -> tuple[tuple[float, float], ...]:
        """Amplitude and frequency, rad/s, of the sines whose sum is the function before its end."""
        a = self.amplitude
        w = self.omega
        e = self.envelope
        # The product of a sine and sin^2 is the carrier and its two side bands.
        return ((a / 2, w), (-a / 4, w + 2 * e), (-a / 4, w - 2 * e)) if e else ((a, w),)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times, s, at which the formula changes: the end, or the knots of a spline."""
        if self.spline is not None:
            return tuple(self.spline.x.tolist())
        return () if np.isinf(self.end) else (self.end,)

    def smooth_until(self, duration: float) -> bool:
        """Return whether there is no kink before a time, s, except where a step can end."""
        return self.spline is None or bool(self.spline.x[1] >= duration)

    @property
    def fastest(self) -> float:
        """Highest frequency that a step must resolve, rad/s."""
        if self.spline is not None:
            return self._band_edge
        # Frequency of the upper side band of a burst.
        return float(self.omega + 2 * self.envelope)

    @cached_property
    def _band_edge(self) -> float:
        """Highest frequency of a piecewise cubic, rad/s.

        The result is the inverse of the smallest time between knots, halved repeatedly if the knots
        are denser than the motion requires. A halving is accepted if the frequencies above the new
        value add a fraction of less than `NEGLIGIBLE_SPEED` to the speed of the motion, or to the
        speed of a free mass under the force.
        """
        assert self.spline is not None
        edge = 1 / self.kink_spacing
        # In its last piece a curve is constant, so that piece is excluded.
        end = self.spline.x[-2]
        intervals = end * edge
        if not 1 < intervals < SPECTRUM_SAMPLES:
            return edge
        from scipy.fft import next_fast_len

        count = next_fast_len(int(np.ceil(intervals)), real=True)
        time, step = np.linspace(0.0, end, count + 1, retstep=True)
        curve = self.at(time)
        frequency = 2 * np.pi * np.fft.rfftfreq(count, step)
        if self.holds:
            speed = np.diff(curve) / step
            spectrum = np.fft.rfft(speed)
        else:
            speed = np.cumsum(curve) * step
            spectrum = np.fft.rfft(curve[:-1])
            spectrum[1:] /= frequency[1:]
        negligible = NEGLIGIBLE_SPEED * np.abs(speed).max()
        while edge > frequency[1]:
            beyond = np.fft.irfft(np.where(frequency > edge / 2, spectrum, 0), count)
            if not np.abs(beyond).max() < negligible:
                break
            edge /= 2
        return float(edge)

    @property
    def kink_spacing(self) -> float:
        """Smallest time between kinks, where adaptive steps end, s; infinite without kinks."""
        return self.end if self.spline is None else float(np.diff(self.spline.x).min())

    def largest(self, order: int = 0) -> float:
        """Return the largest value or derivative.

        It is an upper bound for a burst, and approximate for a spline.
        """
        if self.spline is not None:
            return float(np.abs(self.at(self._dense, order)).max())
        return float(abs(self.amplitude) * (self.omega + self.envelope) ** order)

    @property
    def range(self) -> tuple[float, float]:
        """Smallest and largest value of a curve through points, approximately."""
        values = self.at(self._dense)
        return float(values.min()), float(values.max())

    @property
    def gained(self) -> float:
        """Largest magnitude of the integral from 0.

        It is an upper bound for a burst, and approximate for a spline.
        """
        if self.spline is not None:
            return float(np.abs(self.spline.antiderivative()(self._dense)).max())
        return 2 * abs(self.amplitude) / self.omega

    def area(self, duration: float) -> float:
        """Return an upper bound on the integral of |f| up to a time, s; infinite for a spline."""
        if self.spline is not None:
            return np.inf
        until = min(duration, self.end)
        if self.envelope:
            # The mean of sin^2 is 1/2 over the whole burst, and less than 1 over a part of it.
            return abs(self.amplitude) * until / 2 * (1 if until == self.end else 2)
        # Each arch of a sine has the area 2 A/w; rounding errors must not add another arch.
        arches = np.ceil(self.omega * until / np.pi * (1 - 1e-12))
        return float(abs(self.amplitude) * min(2 * arches / self.omega, until))

    def path(self, duration: float) -> float:
        """Return an upper bound on the integral of the absolute derivative up to a time, s."""
        if self.spline is not None:
            return np.inf
        until = min(duration, self.end)
        # A period has four quarters; one more quarter may have begun, and an envelope adds a rise
        # and a fall.
        quarters = 1 + 4 * self.omega / (2 * np.pi) * until + (2 if self.envelope else 0)
        return float(abs(self.amplitude) * quarters)

    @property
    def _dense(self) -> Array:
        """Eight evenly spaced times between every two knots."""
        assert self.spline is not None
        knots = self.spline.x
        return np.interp(np.arange(8 * len(knots)) / 8, np.arange(len(knots)), knots)
