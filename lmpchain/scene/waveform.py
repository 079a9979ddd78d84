"""Waveforms of forces and motions: sine, Hann tone burst, half-sine, curve through points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..util.arrays import EPSILON, Array, numbers

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

Interpolation = Literal["pchip", "linear", "spline"]
ROUNDED = 4 * EPSILON  # of a time, by which sample times may be off
# Largest speed that frequencies above the highest one of a curve may have, over its largest speed.
NEGLIGIBLE_SPEED = 1e-3
# Most samples whose spectrum is computed.
SPECTRUM_SAMPLES = 2**20


def curve_through(times: Array, values: Array, interpolation: Interpolation, holds: bool) -> PPoly:
    """Return the piecewise cubic through points, and what comes before and after them.

    Before the first point it is 0; if that is no 0, it gets there within the time to the second
    point, or since t = 0. After the last point a motion holds still, and a force falls to 0 within
    the time between the last two points.

    Parameters
    ----------
    times : (P,) array
        s, from 0 on, increasing.
    values : (P, ...) array
    interpolation : "pchip", "linear" or "spline"
        Monotone from point to point (Fritsch and Carlson, SIAM J. Numer. Anal. 17, 238 (1980)), by
        straight lines, or a cubic spline (not-a-knot), which may leave the range of the points.
    holds : bool
        Whether it holds its last value.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator, PPoly

    if interpolation == "linear":
        curve = _straight(times, values)
    else:
        make = PchipInterpolator if interpolation == "pchip" else CubicSpline
        curve = make(times, values)
    # a sample at the last point is one of the curve, also where rounding made it a little later
    behind = times[-1] * (1 + ROUNDED)
    last = curve(behind)[None]
    # the last piece goes on for ever, so that it is constant
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
    """Return what comes before a first point that is later than t = 0: rest, and a rise to it."""
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
        A.
    omega, envelope : float
        w and e, rad/s; without an envelope, 0, the second factor is left out.
    end : float
        s; infinite if it goes on.
    spline : PPoly, optional
        In place of all that, a piecewise cubic.
    holds : bool
        Whether a piecewise cubic is a motion, which holds its last value, and not a force.
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
        """Return a motion at constant speed after a smooth start, whose acceleration is a hat."""
        from scipy.interpolate import PPoly

        half = rise / 2
        jerk = 4 * velocity / rise**2
        # cubic, square, linear and constant terms of rise, second half of it, and constant speed
        pieces = [
            [jerk / 6, 0.0, 0.0, 0.0],
            [-jerk / 6, velocity / rise, velocity / 2, velocity * rise / 12],
            [0.0, 0.0, velocity, velocity * half],
        ]
        # the last piece goes on for ever
        return cls(spline=PPoly(np.transpose(pieces), [0.0, half, rise, 2 * rise]))

    def at(self, t: float | Array, order: int = 0) -> Array:
        """Return its values at these times, s, or its derivatives of order 1 to 3."""
        t = numbers(t, "t")
        if self.spline is not None:
            return self.spline(t, order)
        value = self._burst(t, order) if self.envelope else self._sine(t, order)
        return value if np.isinf(self.end) else np.where(t < self.end, value, 0.0)

    def _sine(self, t: Array, order: int) -> Array:
        """Return ``A sin(w t)``, or a derivative of it."""
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
        # of h, the first two derivatives; the third is -4 e^2 of the first
        hann = np.sin(e * t) ** 2
        slope = e * np.sin(2 * e * t)
        bend = 2 * e**2 * np.cos(2 * e * t)
        first = w * cos * hann + sin * slope
        second = -(w**2) * sin * hann + 2 * w * cos * slope + sin * bend
        third = -(w**2) * cos * hann - 3 * w * sin * slope + 3 * cos * bend
        third = third * w - 4 * e**2 * sin * slope
        return self.amplitude * (sin * hann, first, second, third)[order]

    def integral(self, t: float | Array) -> Array:
        """Return its integral from 0 to these times, s."""
        t = numbers(t, "t")
        if self.spline is not None:
            return np.asarray(self.spline.antiderivative()(t))
        until = np.minimum(t, self.end)
        # 1 - cos x in this form keeps its digits; a side band of one cycle has no frequency
        parts = [2 * a / w * np.sin(w * until / 2) ** 2 for a, w in self.sines if w]
        return np.asarray(sum(parts, np.zeros(until.shape)))

    @property
    def sines(self) -> tuple[tuple[float, float], ...]:
        """Amplitude and frequency, rad/s, of the sines that it is the sum of up to its end."""
        a = self.amplitude
        w = self.omega
        e = self.envelope
        # the product of a sine and sin^2 is the carrier and its two side bands
        return ((a / 2, w), (-a / 4, w + 2 * e), (-a / 4, w - 2 * e)) if e else ((a, w),)

    @property
    def corners(self) -> tuple[float, ...]:
        """Times, s, after which another formula holds: its end, or the knots of a spline."""
        if self.spline is not None:
            return tuple(self.spline.x.tolist())
        return () if np.isinf(self.end) else (self.end,)

    def smooth_until(self, duration: float) -> bool:
        """Return whether it has no corners up to a time, s, but one at which a step can end."""
        return self.spline is None or bool(self.spline.x[1] >= duration)

    @property
    def fastest(self) -> float:
        """Highest frequency that a step must resolve, rad/s."""
        if self.spline is not None:
            return self._band_edge
        # the upper side band of a burst
        return float(self.omega + 2 * self.envelope)

    @cached_property
    def _band_edge(self) -> float:
        """The highest frequency of a piecewise cubic, rad/s: one over the least time between knots.

        If the knots are denser than the motion needs, it is the lowest frequency, by halving that
        one, above which the spectrum adds less than `NEGLIGIBLE_SPEED` to the speed: that of a
        motion, or that of a free mass under a force.
        """
        assert self.spline is not None
        edge = 1 / self.corner_spacing
        # a curve holds its last value, or is 0, in its last piece
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
    def corner_spacing(self) -> float:
        """Least time between corners, at which adaptive steps end, s; infinite if it has none."""
        return self.end if self.spline is None else float(np.diff(self.spline.x).min())

    def largest(self, order: int = 0) -> float:
        """Return the largest value or derivative: of a burst a bound, of a spline nearly."""
        if self.spline is not None:
            return float(np.abs(self.at(self._dense, order)).max())
        return float(abs(self.amplitude) * (self.omega + self.envelope) ** order)

    @property
    def range(self) -> tuple[float, float]:
        """Smallest and largest value of a curve through points, nearly."""
        values = self.at(self._dense)
        return float(values.min()), float(values.max())

    @property
    def gained(self) -> float:
        """Largest size of its integral from 0 on, of a burst a bound, of a spline nearly so."""
        if self.spline is not None:
            return float(np.abs(self.spline.antiderivative()(self._dense)).max())
        return 2 * abs(self.amplitude) / self.omega

    def area(self, duration: float) -> float:
        """Bound the integral of its size up to a time, s; infinite for a spline."""
        if self.spline is not None:
            return np.inf
        until = min(duration, self.end)
        if self.envelope:
            # the mean of sin^2 is 1/2 over the whole burst, and below 1 over a beginning of it
            return abs(self.amplitude) * until / 2 * (1 if until == self.end else 2)
        # each arch of a sine has the area 2 A/w; round-off must not begin another one
        arches = np.ceil(self.omega * until / np.pi * (1 - 1e-12))
        return float(abs(self.amplitude) * min(2 * arches / self.omega, until))

    def path(self, duration: float) -> float:
        """Bound the integral of its absolute derivative up to a time, s."""
        if self.spline is not None:
            return np.inf
        until = min(duration, self.end)
        # four quarters a period, one that may have begun, and the rise and fall of an envelope
        quarters = 1 + 4 * self.omega / (2 * np.pi) * until + (2 if self.envelope else 0)
        return float(abs(self.amplitude) * quarters)

    @property
    def _dense(self) -> Array:
        """Eight times from knot to knot."""
        assert self.spline is not None
        knots = self.spline.x
        return np.interp(np.arange(8 * len(knots)) / 8, np.arange(len(knots)), knots)
