"""Wave fronts of grains: choice among the maxima, errors and widths, compiled."""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

import numpy as np

from ...util.arrays import Array
from .derivatives import SampledBlock, compiled, compiled_measure
from .hermite import ERROR, FLAT, PLACES, C, bound, fill_polynomial, roots, scratch
from .maxima import EVENT, HIDDEN, HIGH, LOW, MAXIMUM, NONE, SHOULDER, VALUE, fill_path

SMALLEST = sys.float_info.min  # Smallest maximum with full precision.


class Rules(NamedTuple):
    """Definition of a front, and the errors of the motion.

    A size is the magnitude of a displacement, m, or of a velocity, m/s.

    Attributes
    ----------
    fraction : float
        Smallest height of the front, relative to the largest size.
    error : float
        Error of all sizes at samples, in addition to the error of interpolation.
    fall : float
        Smallest decrease of the size after the front.
    frequency : float
        Highest frequency of the errors at samples, rad/s.
    step : float
        Time between two samples, s.
    duration : float
        Duration of the whole motion, s.
    kind : int
        DISPLACEMENT or VELOCITY, the field of the front.
    width : bool
        Whether widths are computed.
    """

    fraction: float
    error: float
    fall: float
    frequency: float
    step: float
    duration: float
    kind: int
    width: bool


@compiled
def _first(events, lowest, fall, share):
    """Return the first maximum above a size that is followed by a sufficient decrease, or -1."""
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
def _choose(events, largest, start, rules):
    """Return the event of a grain that is its front, or -1; `start` is the size at t = 0."""
    enough = rules.fraction * largest
    if largest <= rules.error or largest < SMALLEST or start >= enough:
        return -1
    # A decrease within the error may be an artefact.
    return _first(events, enough, rules.fall, 1.0)


@compiled
def _spread(event, rules):
    """Return the error of the time of a maximum due to the errors of slope or height."""
    top = abs(event.height)
    # Errors of slope and curvature for an error of the highest frequency.
    swift = rules.frequency * rules.error
    bend = event.bend - rules.frequency * swift
    if bend > 0.0:
        # The slope is 0 at the maximum, and its rate of change is the curvature.
        return (event.tilt + swift) / bend
    if event.bend > 0.0:
        # Time within which the size stays within its error: twice the root for a parabola.
        return min(3.0 * math.sqrt((event.off + rules.error) / event.bend), rules.duration)
    # In nearly free flight the size stays within its error for long.
    flat = max(event.until - event.when, rules.step)
    return min(flat + swift * rules.step**2 / (FLAT * top), rules.duration)


@compiled
def _earlier(events, when, lowest, late, rules):
    """Return the earliest time at which the rise before `when` may have turned, and the size there.

    If the rise cannot have turned more than `late` before `when`, `when` and 0 are returned.
    """
    begin = when
    height = 0.0
    swift = rules.frequency * rules.error
    for k in range(events.size):
        event = events[k]
        if event.kind != SHOULDER or event.when >= when or abs(event.height) < lowest:
            continue
        # Error of the slope, which increases from its minimum with the square of the time.
        slack = event.tilt + swift
        if slack >= 0.0:
            start = max(event.when - math.sqrt(2.0 * slack / event.bend), 0.0)
            if when - start > late and start < begin:
                begin = start
                height = abs(event.height)
    return begin, height


@compiled
def _farther(event, front, late, apart, rules):
    """Return the errors of time and height, raised to the distances of another maximum.

    The distances include the errors of the other maximum. Heights have a sign, because the two
    maxima may be on different sides of rest.
    """
    other = abs(event.when - front.when) + _spread(event, rules)
    return max(late, other), max(apart, abs(event.height - front.height) + event.off + rules.error)


@compiled
def _doubt_choice(events, at, late, largest, rules):
    """Return the errors of time and height of a front that follow from other possible fronts.

    Parameters
    ----------
    events : (E,) array of EVENT
        Events of the grain.
    at : int
        Index of the event that is the front.
    late : float
        Error of the time of this maximum, s, which is the smallest error returned.
    largest : (3,) array
        Largest size of the grain, and its lower and upper bounds.
    rules : Rules
        Definition of a front.

    Returns
    -------
    (float, float)
        Error of the time, s, and of the height, in the unit of the size. If no other maximum may be
        the front, these are `late` and 0.
    """
    front = events[at]
    when = front.when
    top = abs(front.height)
    off = front.off + rules.error
    enough = rules.fraction * largest[VALUE]
    # Lowest and highest threshold of a front, given all errors.
    lower = rules.fraction * (largest[LOW] - rules.error) - off
    upper = rules.fraction * (largest[HIGH] + rules.error) + off
    apart = 0.0
    # The rise may have turned earlier.
    begin, height = _earlier(events, when, lower, late, rules)
    if begin < when:
        late = when - begin
        apart = abs(top - height)
    # An earlier maximum may be high enough.
    other = _first(events, lower, 0.0, 0.0)
    if other >= 0 and events[other].when < when:
        late, apart = _farther(events[other], front, late, apart, rules)
    end = rules.duration - when
    fall = rules.fall + 2.0 * rules.error
    # This maximum may be too low, or may not decrease enough; then a later one is the front.
    if top < upper or top - front.since <= fall + 2.0 * front.off:
        other = _first(events, upper, fall, 2.0)
        if other >= 0:
            late, apart = _farther(events[other], front, late, apart, rules)
        else:
            late, apart = max(late, end), top + largest[HIGH]
    for k in range(events.size):
        event = events[k]
        if event.kind == HIDDEN and event.when <= when and event.height >= enough:
            apart = top + largest[HIGH]
            late = max(late, when - event.when, event.until - when if top >= upper else end)
    return late, apart


@compiled
def _events_of_grain(events, begin, latest, few):
    """Fill in the events of a grain, from `begin`, and the latest one; return their number."""
    count = 0
    while begin + count < events.size and events[begin + count].grain == latest.grain:
        few[count] = events[begin + count]
        count += 1
    few[count] = latest
    return count + 1


@compiled_measure()
def _fill_arrivals(events, latest, largest, start, rules, few, out):
    """Fill in the results of `arrivals`."""
    begin = 0
    for g in range(latest.size):
        count = _events_of_grain(events, begin, latest[g], few)
        begin += count - 1
        of_grain = few[:count]
        at = _choose(of_grain, largest[g, VALUE], start[g], rules)
        if at >= 0:
            late = _spread(of_grain[at], rules)
            late, _ = _doubt_choice(of_grain, at, late, largest[g], rules)
            out[0, g] = of_grain[at].when
            out[1, g] = late


def arrivals(
    events: np.ndarray, latest: np.ndarray, largest: Array, start: Array, rules: Rules
) -> Array:
    """Return the arrival time of the front at each of G grains, and its error, (2, G) s.

    Both are NaN for a grain without a front.

    Parameters
    ----------
    events : (E,) array of EVENT
        Events of all grains, sorted by grain; see `maxima.reduce`.
    latest : (G,) array of EVENT
        Last event of each grain, see `maxima.reduce`.
    largest : (3, G) array
        Largest sizes, and their lower and upper bounds.
    start : (G,) array
        Sizes at t = 0.
    rules : Rules
        Definition of a front.
    """
    out = np.full((2, latest.size), np.nan)
    few = np.zeros(events.size + 1, EVENT)
    _fill_arrivals(events, latest, largest.T.copy(), start, rules, few, out)
    return out


@compiled
def _crossings(p, front, level, rules, work):
    """Return the level crossings of a size before and after a front, and the largest error.

    A time is NaN if there is no crossing. The error is the largest interpolation error between the
    two crossings.
    """
    when, height, _ = front
    h = rules.step
    sign = math.copysign(1.0, height)
    last = p.shape[1] - 2
    begin = np.nan
    end = np.nan
    error = 0.0
    for step in range(-1, 2, 2):
        i = min(int(when / h), last)
        here = when / h - i
        crossed = np.nan
        while 0 <= i <= last and math.isnan(crossed):
            error = max(error, p[ERROR, i])
            count = fill_polynomial(p, rules.kind, h, i, work)
            for k in range(count):
                work[C, k] = sign * work[C, k] - level
            found = roots(work[C], count, work[PLACES], work)
            for k in range(found):
                place = work[PLACES, k if step > 0 else found - 1 - k]
                if step * (place - here) > 0.0 and math.isnan(crossed):
                    crossed = (i + place) * h
            i += step
            # In the intervals that follow, every position counts.
            here = -1.0 if step > 0 else 2.0
        if step < 0:
            begin = crossed
        else:
            end = crossed
    return begin, end, error


@compiled
def _last_as_large(p, front, rules, work):
    """Return the largest distance in time from a maximum with the same size within the error."""
    when, height, off = front
    level = abs(height) - 2.0 * (off + rules.error)
    begin, end, _ = _crossings(p, front, level, rules, work)
    before = when - begin if math.isfinite(begin) else when
    after = (end if math.isfinite(end) else rules.duration) - when
    return max(before, after)


@compiled
def _width(p, front, apart, rules, work):
    """Return the full width at half maximum of a front, and its error, s; NaN if unknown."""
    _, height, off = front
    half = abs(height) / 2
    before, after, error = _crossings(p, front, half, rules, work)
    width = after - before
    if not math.isfinite(width):
        return np.nan, np.nan
    # Another maximum, of unknown width, may be the front.
    if apart > 0.0:
        return width, rules.duration
    unsure = (3.0 * rules.error + off) / 2 + error
    error = 0.0
    for side in range(-1, 2, 2):
        left, right, _ = _crossings(p, front, half + side * unsure, rules, work)
        changed = right - left
        if not math.isfinite(changed):
            return width, rules.duration
        error = max(error, abs(changed - width))
    return width, error


@compiled_measure()
def _fill_fronts(block, grains, derived, events, latest, largest, start, rules, few, p, work, out):
    """Fill in the results of `fronts`."""
    begin = 0
    for g in range(grains.size):
        count = _events_of_grain(events, begin, latest[g], few)
        begin += count - 1
        of_grain = few[:count]
        at = _choose(of_grain, largest[g, VALUE], start[g], rules)
        if at < 0:
            continue
        fill_path(p, block, derived, grains[g], g, NONE)
        bound(p, rules.kind, block.h)
        event = of_grain[at]
        front = (event.when, event.height, event.off)
        late = min(_spread(event, rules), _last_as_large(p, front, rules, work))
        late, apart = _doubt_choice(of_grain, at, late, largest[g], rules)
        out[g, 0] = event.when
        out[g, 1] = event.height
        out[g, 3] = late
        out[g, 4] = max(event.off + rules.error, apart)
        if rules.width:
            out[g, 2], out[g, 5] = _width(p, front, apart, rules, work)


def fronts(
    block: SampledBlock,
    grains: np.ndarray,
    derived: Array,
    events: np.ndarray,
    latest: np.ndarray,
    largest: Array,
    start: Array,
    rules: Rules,
) -> Array:
    """Return the time, height and width of the fronts of G grains and their errors, (G, 6).

    Parameters
    ----------
    block : SampledBlock
        All samples of the motion.
    grains : (G,) array
        Numbers of the grains.
    derived : (G, 3, R) array
        Accelerations, jerks and errors, as `derivatives.derive` returns them.
    events, latest, largest, start, rules
        Events, largest sizes, sizes at t = 0 and definition of a front, as in `arrivals`.
    """
    out = np.full((grains.size, 6), np.nan)
    few = np.zeros(events.size + 1, EVENT)
    path = np.zeros((8, block.u.shape[1]))
    motion = (block, grains, derived)
    maxima = (events, latest, largest.T.copy(), start, rules)
    _fill_fronts(*motion, *maxima, few, path, scratch(), out)
    return out
