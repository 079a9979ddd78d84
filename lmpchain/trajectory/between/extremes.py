"""Largest values and wave fronts of grains, between their samples too, compiled."""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

import numpy as np

from ...util.compilation import compiled_once
from ...util.lazy import listed
from .derivatives import NEWS
from .hermite import (
    BUMP,
    PARTS,
    STEEPEST,
    VELOCITY,
    compiled,
    derive,
    highest,
    inlined,
    path,
    polynomial,
    root,
    sampled,
    size,
    slope,
    sure_bend,
    turns,
    value,
)

__dir__ = listed(__name__)

SMALLEST = sys.float_info.min  # of a top that has all of its digits


@inlined
def _hidden(p, i):
    """Return a bound on what hides between sample i and the next, or -1 if nothing does."""
    if p.ceiling.size == 0 or p.ceiling[i] < 0.0:
        return -1.0
    if p.kind == VELOCITY:
        return p.ceiling[i]
    return (size(p.u[i], p.kind) + size(p.u[i + 1], p.kind) + p.h * p.ceiling[i]) / 2


@inlined
def _steady(p, i, tilt):
    """Say whether a velocity surely rises or falls by more than so much from sample i to the next."""
    one, other, h = p.a[i], p.a[i + 1], p.h
    if p.kind != VELOCITY or one * other <= 0.0:
        return False
    # the acceleration: the cubic through a and j at both ends, and what the change of velocity and errors add to it
    missed = p.v[i + 1] - p.v[i] - h * ((one + other) / 2 + h * (1 / 12) * (p.j[i] - p.j[i + 1]))
    bend = h * h * (4 / 27) * (abs(p.j[i]) + abs(p.j[i + 1])) + 1.875 * abs(missed)
    return h * min(abs(one), abs(other)) > bend + STEEPEST / BUMP * p.error[i] + h * tilt


@compiled
def _peak(p):
    """Return the largest value at any time, and between what it lies."""
    y, kind = sampled(p), p.kind
    low = high = best = highest(y, kind)
    for i in range(y.size - 1):
        limit = _hidden(p, i)
        if limit >= 0.0:
            high = max(high, limit)
        elif p.reach[i] + p.error[i] > high and not (
            _steady(p, i, 0.0) and max(size(y[i], kind), size(y[i + 1], kind)) + p.error[i] <= high
        ):
            polynomial(p, i)
            top = max(size(y[i], kind), size(y[i + 1], kind))
            for k in range(turns(p)):
                top = max(top, size(value(p.c, p.places[k]), kind))
            best, low, high = (
                max(best, top),
                max(low, top - p.error[i]),
                max(high, top + p.error[i]),
            )
    return best, low, high


@compiled
def _crossing(p, sign, level, i, s, step):
    """Return when sign times the value first falls to a level, from the place s in an interval on.

    `step` is 1 for later, -1 for earlier. Also the largest error of the polynomials looked at.
    """
    goal, error = 1.0 if step > 0 else 0.0, 0.0
    here, y = s, sampled(p)
    while 0 <= i < p.error.size:
        swing = p.reach[i] - max(size(y[i], p.kind), size(y[i + 1], p.kind))
        if min(sign * y[i], sign * y[i + 1]) - swing < level:
            break
        i, here = i + step, 1.0 - goal
    while 0 <= i < p.error.size:
        polynomial(p, i)
        count, error = turns(p), max(error, p.error[i])
        p.c[:] *= sign
        begin = here
        for part in range(1, PARTS + 1):
            there = begin + (goal - begin) * part / PARTS
            for k in range(count):  # it may have dipped below the level in between
                place = p.places[k]
                if (place - here) * (there - place) > 0.0 and value(p.c, place) < level:
                    there = place
            if value(p.c, there) < level:
                return (i + root(p.c, level, min(here, there), max(here, there))) * p.h, error
            here = there
        i, here = i + step, 1.0 - goal
    return np.nan, np.nan


@inlined
def _as_large(p, s, sign, away, level):
    """Say whether sign times the polynomial exceeds a level so far away from a place, in its interval."""
    before, after = s - away, s + away
    return (before >= 0.0 and sign * value(p.c, before) > level) or (
        after <= 1.0 and sign * value(p.c, after) > level
    )


class Found(NamedTuple):
    """The first maximum of some size: interval (-1 for none), place in it, and size.

    Also how far it had fallen when that was seen, and in which interval; the largest value at which an earlier one
    turned; and the first interval in which one may be hidden, or -1.
    """

    at: int
    place: float
    top: float
    fell: float
    seen: int
    missed: float
    hidden: int


@compiled
def _find(p, enough, fall):
    """Look for the first maximum of a size after which the value falls by so much."""
    y, last, begin = sampled(p), p.error.size, 0
    while begin < last and p.reach[begin] + p.error[begin] < enough / 2 and _hidden(p, begin) < 0.0:
        begin += 1
    top, at, place, missed, hidden = abs(y[min(begin, last)]), -1, 0.0, 0.0, -1
    for i in range(begin, last):
        count, limit = 0, _hidden(p, i)
        if limit >= 0.0:
            hidden = i if hidden < 0 and limit >= enough else hidden
        elif (p.reach[i] + p.error[i] >= enough or top >= enough) and not _steady(p, i, 0.0):
            polynomial(p, i)
            count = turns(p)
        for k in range(count + 1):
            s = p.places[k] if k < count else 1.0
            now = abs(value(p.c, s)) if k < count else abs(y[i + 1])
            if now < top:
                if top >= enough and top - now > fall:
                    return Found(at, place, top, top - now, i, missed, hidden)
                missed = max(missed, top)
            if now >= top or top < enough:
                top, at, place = now, i, s
    return Found(-1, 0.0, 0.0, 0.0, last - 1, missed, hidden)


@compiled
def _flat(p, least, at, place, tilt):
    """Return when the value may have turned before a maximum, for it hardly rises, and its size.

    Looked at is what exceeds a size; `tilt` is the error of the slope, besides that of the polynomials. The time is
    that at which the part of an interval begins where it may turn.
    """
    for i in range(at + 1):
        if p.reach[i] + p.error[i] < least or (_steady(p, i, tilt) and p.v[i] * p.a[i] > 0.0):
            continue
        polynomial(p, i)
        derive(p)
        slack = STEEPEST / BUMP * p.error[i] + tilt * p.h
        sign, end = math.copysign(1.0, value(p.c, 0.5)), place if i == at else 1.0
        rise, bend = sign * value(p.d, 0.0), sign * slope(p.d, 0.0)
        for part in range(PARTS):
            s, width = end * part / PARTS, end / PARTS
            rise_next, bend_next = sign * value(p.d, s + width), sign * slope(p.d, s + width)
            dip = 0.0
            if (
                bend < 0.0 < bend_next and rise > slack
            ):  # the least rise is above the meeting point of its tangents
                dip = min(
                    max((rise_next - rise - bend_next * width) / (bend - bend_next), 0.0), width
                )
            now = abs(value(p.c, s + dip))
            if now >= least and rise + bend * dip <= slack:
                return max(i + s - (width if dip == 0.0 else 0.0), 0.0) * p.h, now
            rise, bend = rise_next, bend_next
    return (at + place) * p.h, 0.0


@compiled
def _front(p, fraction, known_error, certain, frequency, width, peak, out):
    """Fill out, (6,), with time, height and width of the front and their errors, or NaN."""
    (largest, low, high), y, end = peak, sampled(p), p.h * p.error.size
    enough = fraction * largest
    if largest <= known_error or largest < SMALLEST or abs(y[0]) >= enough:
        return
    found = _find(p, enough, certain)
    at, s = found.at, found.place
    if at < 0:
        return
    off = max(p.error[at], _hidden(p, at) - abs(y[at + 1])) + known_error
    polynomial(p, at)
    height = y[at + 1] if s == 1.0 else value(p.c, s)
    sign, top, when = math.copysign(1.0, height), abs(height), (at + s) * p.h
    bend = sure_bend(p, s, top, off - known_error) / p.h**2 - frequency**2 * known_error
    # what the errors of the slope make of it, but at most for how long the value is as large as that within its error
    tilt = STEEPEST / BUMP * (off - known_error) / p.h + frequency * known_error
    late = tilt / bend if bend > 0.0 else end
    if not _as_large(p, s, sign, late / p.h, top - 2 * off):
        spread = 0.0
        for step in (-1, 1):
            edge, _ = _crossing(p, sign, top - 2 * off, at, s, step)
            spread = max(
                spread,
                abs(edge - when) if math.isfinite(edge) else (when if step < 0 else end - when),
            )
        late = min(late, spread)
    # which other maxima it may be, if values are off by their errors, and how far apart these are
    apart = 0.0
    least, most = fraction * (low - known_error) - off, fraction * (high + known_error) + off
    begin, low_top = _flat(p, least, at, s, frequency * known_error)
    if when - begin > late:
        late, apart = when - begin, abs(top - low_top)
    if found.missed >= least:
        other = _find(p, least, 0.0)
        if other.at >= 0:
            late = max(late, abs((other.at + other.place) * p.h - when))
            apart = max(apart, abs(other.top - top))
    if top < most or found.fell <= certain + 2 * off:
        other = _find(p, most, certain + 2 * off)
        late = max(
            late, abs((other.at + other.place) * p.h - when) if other.at >= 0 else end - when
        )
        apart = max(apart, abs(other.top - top) if other.at >= 0 else high)
    if found.hidden >= 0:
        apart = high
        late = max(
            late, when - found.hidden * p.h, ((found.seen + 1) * p.h if top >= most else end) - when
        )
    out[0], out[1], out[3], out[4] = when, height, late, max(off, apart)
    if not width:
        return
    before, one = _crossing(p, sign, top / 2, at, s, -1)
    after, other = _crossing(p, sign, top / 2, at, s, 1)
    out[2] = after - before
    if not math.isfinite(out[2]):
        return
    if apart > 0.0:
        out[5] = end
        return
    out[5] = 0.0
    for change in (-1.0, 1.0):  # the width at a level that is off by the errors
        level = top / 2 + change * (known_error + off / 2 + max(one, other))
        left, right = (
            _crossing(p, sign, level, at, s, -1)[0],
            _crossing(p, sign, level, at, s, 1)[0],
        )
        width_there = right - left
        out[5] = max(out[5], abs(width_there - out[2])) if math.isfinite(width_there) else end


@compiled
def _quiet_peak(motion, g, kind):
    """Return the largest value of a quiet grain at the samples, which is within the error, and bounds."""
    most = highest(motion[1, g] if kind == VELOCITY else motion[0, g], kind)
    return most, most, 2.0 * most


@inlined
def _uncertain(peak, known_error):
    """Return the largest value, and how far off it may be, of one and its bounds."""
    most, low, high = peak
    return most, max(high - most, most - low) + known_error


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def peaks(motion, quiet, columns, count, h, kind, ceiling, known_error):
    """Return the largest values of grains at any time and their errors, (C, 2).

    Of so many columns these are those of the G grains that move.
    """
    out, intervals = np.zeros((count, 2)), motion.shape[2] - 1
    reach, error, c, d, places = (
        np.empty(intervals),
        np.empty(intervals),
        np.zeros(8),
        np.zeros(8),
        np.zeros(PARTS),
    )
    out[:, 1] = known_error
    for g in range(columns.size):
        if quiet[g]:
            peak = _quiet_peak(motion, g, kind)
        else:
            peak = _peak(path(motion, g, h, kind, ceiling, reach, error, c, d, places))
        out[columns[g]] = _uncertain(peak, known_error)
    return out


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def fronts(
    motion,
    quiet,
    columns,
    count,
    h,
    kind,
    ceiling,
    fraction,
    known_error,
    certain,
    frequency,
    width,
):
    """Return what `_front` finds at G grains, (C, 6), and their `peaks`; widths only if asked for."""
    out, tops, intervals = np.full((count, 6), np.nan), np.zeros((count, 2)), motion.shape[2] - 1
    reach, error, c, d, places = (
        np.empty(intervals),
        np.empty(intervals),
        np.zeros(8),
        np.zeros(8),
        np.zeros(PARTS),
    )
    tops[:, 1] = known_error
    for g in range(columns.size):
        if quiet[g]:
            tops[columns[g]] = _uncertain(_quiet_peak(motion, g, kind), known_error)
            continue
        grain = path(motion, g, h, kind, ceiling, reach, error, c, d, places)
        peak = _peak(grain)
        tops[columns[g]] = _uncertain(peak, known_error)
        _front(grain, fraction, known_error, certain, frequency, width, peak, out[columns[g]])
    return out, tops
