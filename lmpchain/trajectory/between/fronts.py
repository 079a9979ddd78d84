"""Wave fronts of grains: which of their maxima they are, their errors and widths, compiled."""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

import numpy as np

from ...util.compilation import compiled_once
from .derivatives import NEWS, compiled, series_of
from .hermite import FLAT, highest, path, polynomial, roots, sampled
from .maxima import EVENT, HIDDEN, MAXIMUM, SHOULDER, Largest, Log, Window, follow, hidden

SMALLEST = sys.float_info.min  # maximum that has all of its digits


class Rules(NamedTuple):
    """Definition of a front, and the errors of the motion.

    Attributes
    ----------
    fraction : float
        Of the largest size, that the front has at least.
    error : float
        Of all values, besides that of the polynomials.
    fall : float
        By which the size falls at least after the front.
    frequency : float
        Highest one of these errors, rad/s.
    step, duration : float
        Time between two samples, and of the whole motion, s.
    """

    fraction: float
    error: float
    fall: float
    frequency: float
    step: float
    duration: float


class Peak(NamedTuple):
    """Largest size of a grain, and the bounds between which it lies."""

    value: float
    low: float
    high: float


@compiled
def _first(events, lowest, fall, share):
    """Return the first maximum of a size that falls by so much and a share of its error, or -1."""
    first = -1
    for k in range(events.size):
        event = events[k]
        top = abs(event.height)
        if event.kind != MAXIMUM or top < lowest or top - event.since <= fall + share * event.off:
            continue
        if first < 0 or event.when < events[first].when:
            first = k
    return first


@compiled
def choose(events, largest, start, rules):
    """Return which event of a grain is its front, or -1; `start` is the size at t = 0."""
    enough = rules.fraction * largest
    if largest <= rules.error or largest < SMALLEST or start >= enough:
        return -1
    # what falls by no more than its error may turn where nothing does
    return _first(events, enough, rules.fall, 1.0)


@compiled
def spread(event, rules):
    """Return the error of the time of a maximum by the errors of its slope, or of its height."""
    top = abs(event.height)
    # errors of slope and curvature that an error of the highest frequency has
    swift = rules.frequency * rules.error
    bend = event.bend - rules.frequency * swift
    if bend > 0.0:
        # the slope is 0 at the maximum, and changes by the curvature times the time
        return (event.tilt + swift) / bend
    if event.bend > 0.0:
        # so long it is as large within its error: twice the root for a parabola
        return min(3.0 * math.sqrt((event.off + rules.error) / event.bend), rules.duration)
    # where a grain flies freely, or nearly so, it is of that size for long
    flat = max(event.until - event.when, rules.step)
    return min(flat + swift * rules.step**2 / (FLAT * top), rules.duration)


@compiled
def _earlier(events, when, lowest, late, rules):
    """Return since when the rise before a time may have turned, for it is slow, and the size there.

    That is more than `late` before; else the time itself and 0.
    """
    begin = when
    height = 0.0
    swift = rules.frequency * rules.error
    for k in range(events.size):
        event = events[k]
        if event.kind != SHOULDER or event.when >= when or abs(event.height) < lowest:
            continue
        # error of the slope, which grows from its least with the square of the time
        slack = event.tilt + swift
        if slack >= 0.0:
            start = max(event.when - math.sqrt(2.0 * slack / event.bend), 0.0)
            if when - start > late and start < begin:
                begin = start
                height = abs(event.height)
    return begin, height


@compiled
def doubt_choice(events, at, late, peak, rules):
    """Return the errors of time and height of a front, for other maxima may be the front.

    Parameters
    ----------
    events : (E,) array of EVENT
        Of a grain.
    at : int
        Which of them is the front.
    late : float
        Least error of its time, s.
    peak : Peak
    rules : Rules

    Returns
    -------
    (float, float)
        s, and in the unit of the size; 0 if no other maximum may be the front.
    """
    front = events[at]
    when = front.when
    top = abs(front.height)
    off = front.off + rules.error
    enough = rules.fraction * peak.value
    # what a front has at least, if all errors lie on one side or on the other
    lower = rules.fraction * (peak.low - rules.error) - off
    upper = rules.fraction * (peak.high + rules.error) + off
    apart = 0.0
    # the rise may have turned before
    begin, height = _earlier(events, when, lower, late, rules)
    if begin < when:
        late = when - begin
        apart = abs(top - height)
    # an earlier maximum may be high enough
    other = _first(events, lower, 0.0, 0.0)
    if other >= 0 and events[other].when < when:
        late = max(late, when - events[other].when)
        apart = max(apart, abs(abs(events[other].height) - top))
    end = rules.duration - when
    fall = rules.fall + 2.0 * rules.error
    # this one may be too low, or not fall enough: then it is a later one
    if top < upper or top - front.since <= fall + 2.0 * front.off:
        other = _first(events, upper, fall, 2.0)
        late = max(late, abs(events[other].when - when) if other >= 0 else end)
        apart = max(apart, abs(abs(events[other].height) - top) if other >= 0 else peak.high)
    for k in range(events.size):
        event = events[k]
        if event.kind == HIDDEN and event.when <= when and event.height >= enough:
            apart = peak.high
            late = max(late, when - event.when, event.until - when if top >= upper else end)
    return late, apart


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def arrivals(events, bounds, peaks, start, rules):
    """Return when the front passes each of G grains, and the error of that, (2, G) s.

    Both are NaN where none passes.

    Parameters
    ----------
    events : (E,) array of EVENT
        Sorted by grain.
    bounds : (G+1,) array
        Where those of each grain begin.
    peaks : Largest
        Sizes.
    start : (G,) array
        Sizes at t = 0.
    rules : Rules
    """
    out = np.full((2, start.size), np.nan)
    for g in range(start.size):
        of_grain = events[bounds[g] : bounds[g + 1]]
        at = choose(of_grain, peaks.value[g], start[g], rules)
        if at >= 0:
            peak = Peak(peaks.value[g], peaks.low[g], peaks.high[g])
            late, _ = doubt_choice(of_grain, at, spread(of_grain[at], rules), peak, rules)
            out[0, g] = of_grain[at].when
            out[1, g] = late
    return out


@compiled
def _crossing(p, sign, level, when, step):
    """Return when sign times the value falls to a level, after a time (step 1) or before it (-1).

    The largest error of the polynomials on the way comes with it; both are NaN if it does not fall.
    """
    last = p.error.size - 1
    i = min(int(when / p.h), last)
    here = when / p.h - i
    error = 0.0
    while 0 <= i <= last:
        error = max(error, p.error[i])
        polynomial(p, i)
        for k in range(p.c.size):
            p.c[k] = sign * p.c[k] - level
        count = roots(p.c, p.places)
        for k in range(count):
            place = p.places[k if step > 0 else count - 1 - k]
            if step * (place - here) > 0.0:
                return (i + place) * p.h, error
        i += step
        # in the intervals that follow, any place lies on the way
        here = -1.0 if step > 0 else 2.0
    return np.nan, np.nan


class FrontPassage(NamedTuple):
    """Time of a maximum, s, its height with its sign, and the error of that, by the polynomials."""

    when: float
    height: float
    off: float


@compiled
def _last_as_large(p, front, rules):
    """Return how long before or after a maximum the size is the same within its error."""
    sign = math.copysign(1.0, front.height)
    level = abs(front.height) - 2.0 * (front.off + rules.error)
    begin, _ = _crossing(p, sign, level, front.when, -1)
    end, _ = _crossing(p, sign, level, front.when, 1)
    before = front.when - begin if math.isfinite(begin) else front.when
    after = (end if math.isfinite(end) else rules.duration) - front.when
    return max(before, after)


@compiled
def _width(p, front, apart, rules):
    """Return the full width at half maximum of a front, and its error, s; NaN if unknown."""
    sign = math.copysign(1.0, front.height)
    top = abs(front.height)
    before, one = _crossing(p, sign, top / 2, front.when, -1)
    after, other = _crossing(p, sign, top / 2, front.when, 1)
    width = after - before
    if not math.isfinite(width):
        return np.nan, np.nan
    # another maximum may be the front, of any width
    if apart > 0.0:
        return width, rules.duration
    error = 0.0
    off = (3.0 * rules.error + front.off) / 2 + max(one, other)
    for level in (top / 2 - off, top / 2 + off):
        left, _ = _crossing(p, sign, level, front.when, -1)
        right, _ = _crossing(p, sign, level, front.when, 1)
        changed = right - left
        if not math.isfinite(changed):
            return width, rules.duration
        error = max(error, abs(changed - width))
    return width, error


@compiled
def front_of(p, width, rules):
    """Return time, height and width of the front of a body and their errors, NaN if there is none.

    Parameters
    ----------
    p : Path
    width : bool
        Whether the width is asked for.
    rules : Rules

    Returns
    -------
    (6,) array
    """
    out = np.full(6, np.nan)
    y = sampled(p)
    last = p.error.size
    top = highest(y, 0, last + 1, p.kind)
    # half of what a front has at least: smaller maxima are none, whatever the errors
    enough = rules.fraction * max(top - rules.error, 0.0) / 2
    begin = 0
    while begin < last and p.reach[begin] + p.error[begin] < enough and hidden(p, begin) < 0.0:
        begin += 1
    peaks = Largest(np.full(1, top), np.full(1, top), np.full(1, top))
    latest = np.zeros(1, EVENT)
    latest[0].when = begin * p.h
    latest[0].until = begin * p.h
    latest[0].height = y[begin]
    latest[0].since = abs(y[begin])
    log = follow(p, Window(0, begin, last), peaks, latest, 0, Log(np.empty(0, EVENT), 0))
    events = np.empty(log.used + 1, EVENT)
    events[: log.used] = log.events[: log.used]
    events[log.used] = latest[0]
    at = choose(events, peaks.value[0], abs(y[0]), rules)
    if at < 0:
        return out
    # copied, for a record does not keep the array of which it is
    front = FrontPassage(events[at].when, events[at].height, events[at].off)
    late = min(_last_as_large(p, front, rules), spread(events[at], rules))
    peak = Peak(peaks.value[0], peaks.low[0], peaks.high[0])
    late, apart = doubt_choice(events, at, late, peak, rules)
    out[0] = front.when
    out[1] = front.height
    out[3] = late
    out[4] = max(front.off + rules.error, apart)
    if width:
        out[2], out[5] = _width(p, front, apart, rules)
    return out


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def fronts(block, grains, derived, ceiling, kind, width, rules):
    """Return time, height and width of the fronts of G grains and their errors, (G, 6).

    Parameters
    ----------
    block : Block
        All samples.
    grains : (G,) array
        Their numbers.
    derived : (G+1, 3, R) array
        See `derivatives.derive`.
    ceiling : (G, R-1) or (1, 0) array
        See `hermite.Path`.
    kind : int
        VELOCITY or DISPLACEMENT.
    width : bool
        Whether the width is asked for.
    rules : Rules
    """
    bounds = np.empty((2, block.u.shape[1] - 1))
    out = np.empty((grains.size, 6))
    for g in range(grains.size):
        series = series_of(block, derived, g, grains[g])
        p = path(series, kind, block.h, ceiling[g if ceiling.size else 0], bounds)
        out[g] = front_of(p, width, rules)
    return out
