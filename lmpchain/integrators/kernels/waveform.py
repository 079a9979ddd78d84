"""The imposed motion or force over time, compiled on first use, separately from the marches."""

from __future__ import annotations

import math
from functools import cache

import numba
import numpy as np
from numba import types

from .compiling import STRICT, address_of, caller, compiled_filler
from .layout import WAVE

_WAVE = numba.from_dtype(WAVE)
_KNOTS = types.float64[::1]
_PIECES = types.float64[:, ::1]
_COURSE = types.float64(_WAVE, _KNOTS, _PIECES, types.float64, types.int64, types.float64)
_KINK = types.float64(_WAVE, _KNOTS, types.float64, types.float64, types.float64)
_kept = compiled_filler(fastmath=STRICT)


@_kept
def _course(wave, knots, pieces, t, order, inside):
    """Return the imposed motion or force at time t, or its derivative of some order.

    If t is a kink, the branch on the side of the time `inside` is evaluated. The motion or force is
    a sine, with or without an envelope, or a cubic spline.
    """
    if wave.knots == 0:
        size = wave.amplitude
        omega = wave.omega
        envelope = wave.envelope
        if inside >= wave.end:
            return 0.0
        if envelope == 0.0:
            if order == 2:
                return -size * omega * omega * math.sin(omega * t)
            return size * math.sin(omega * t) if order == 0 else size * omega * math.cos(omega * t)
        window = math.sin(envelope * t)
        if order == 0:
            return size * math.sin(omega * t) * (window * window)
        if order == 2:
            # The first and second derivatives of the squared window.
            first = envelope * math.sin(2.0 * envelope * t)
            second = 2.0 * envelope * envelope * math.cos(2.0 * envelope * t)
            bend = (second - omega * omega * window * window) * math.sin(omega * t)
            return size * (bend + 2.0 * omega * first * math.cos(omega * t))
        slope = 2.0 * envelope * math.cos(envelope * t) * math.sin(omega * t)
        return size * window * (omega * math.cos(omega * t) * window + slope)
    knots = knots[: wave.knots]
    # The derivative may jump at a knot, so `inside` selects the piece.
    at = t if order == 0 else inside
    piece = min(max(np.searchsorted(knots, at, "right") - 1, 0), knots.size - 2)
    s = t - knots[piece]
    a = pieces[0, piece]
    b = pieces[1, piece]
    c = pieces[2, piece]
    d = pieces[3, piece]
    if order == 2:
        return 6 * a * s + 2 * b
    return ((a * s + b) * s + c) * s + d if order == 0 else (3 * a * s + 2 * b) * s + c


@_kept
def _kink(wave, knots, t, end, resolution):
    """Return the time to the next kink before `end`, or 1e300 without one."""
    if wave.knots > 0:
        knots = knots[: wave.knots]
        following = np.searchsorted(knots, t + resolution, "right")
        if following < knots.size and knots[following] < end - resolution:
            return knots[following] - t
    elif t + resolution < wave.end < end - resolution:
        return wave.end - t
    # The compiler flags assume finite numbers, so infinity is not allowed.
    return 1e300


@cache
def addresses() -> tuple[int, ...]:
    """Return the memory addresses of the compiled functions `_course` and `_kink`."""
    return address_of(_course, _COURSE), address_of(_kink, _KINK)


call_course = caller(_COURSE)
call_kink = caller(_KINK)
