"""Largest values of grains and the maxima of their motion, interval by interval, compiled.

The same reduction is used for stored samples and during a run. It processes consecutive samples in
blocks of any size, and stores a few numbers for each grain. The error of an interval depends on the
misfits of the intervals before and after it. An interval can therefore be processed only when the
samples of the following interval are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...util.arrays import Array
from .derivatives import SampledBlock, compiled, compiled_measure, joined
from .hermite import (
    BEND,
    DISPLACEMENT,
    DOUBT,
    ERROR,
    FLAT,
    PLACES,
    RAISED,
    REACH,
    SHAPE,
    STEEP,
    TURNS,
    VELOCITY,
    A,
    C,
    D,
    J,
    U,
    V,
    bound,
    differentiate,
    fill_polynomial,
    highest,
    larger,
    roots,
    scratch,
    size,
    value,
)

# Kinds of events. A level may precede the first event; only maxima above it are searched.
MAXIMUM, SHOULDER, HIDDEN, LEVEL = range(4)
NO_FALL = 1e-12  # Fraction of the largest value; a smaller decrease is rounding.
ROOM = 32  # Least growth of a log of events, larger than the number of events in an interval.
# An event of a grain that may be its front, because its size exceeds all earlier sizes: a maximum
# of the size, a shoulder of its rise, or intervals that may hide a larger maximum.
EVENT = np.dtype([
    ("grain", int),  # Number in the reduction.
    ("kind", int),
    ("when", float),  # Time, s.
    ("height", float),  # Height with its sign; for a hidden event, a bound on the size.
    ("off", float),  # Error of the height.
    ("tilt", float),  # Error of the slope, 1/s, minus the slope of a shoulder.
    ("bend", float),  # Lower bound of the curvature, 1/s^2; of a shoulder's slope, 1/s^3.
    ("since", float),  # Smallest size until a larger one follows.
    ("until", float),  # Time until which the size is equal within its error, s.
])  # fmt: skip


class LargestRows(NamedTuple):
    """Rows of the largest sizes of G grains, (3, G): values, and lower and upper bounds."""

    value: int = 0
    low: int = 1
    high: int = 2


VALUE, LOW, HIGH = LargestRows()


class Missing(NamedTuple):
    """Rows in `derivatives.derive` for missing bodies: bodies at rest, and no body."""

    at_rest: int = -1
    none: int = -2


AT_REST, NONE = Missing()


class Window(NamedTuple):
    """Intervals of a block to process, from `begin` to before `end`.

    Attributes
    ----------
    first : int
        Number of the first sample of the block.
    begin : int
        First interval, counted from this sample.
    end : int
        Interval after the last one, counted from this sample.
    """

    first: int
    begin: int
    end: int


def estimate(largest: Array, error: float) -> tuple[Array, Array]:
    """Return largest sizes (3, G) as values and their errors, for samples with this error."""
    value, low, high = largest
    return value, np.maximum(high - value, value - low) + error


def events_of(values: Array) -> np.ndarray:
    """Return the events of the first samples of G grains."""
    events = np.zeros(values.size, EVENT)
    events["grain"] = np.arange(values.size)
    events["height"] = values
    events["since"] = np.abs(values)
    return events


def levels_of(values: Array) -> np.ndarray:
    """Return the levels above which the maxima of G grains are sought."""
    events = events_of(values)
    events["kind"] = LEVEL
    events["since"] = 0.0
    return events


@joined
def hidden(p, kind, h, ceiling, i):
    """Return a bound on the sizes after sample i; -1 if the polynomial shows all of them."""
    if ceiling.size == 0 or ceiling[i] < 0.0:
        return -1.0
    if kind == VELOCITY:
        return ceiling[i]
    return (size(p[U, i], kind) + size(p[U, i + 1], kind) + h * ceiling[i]) / 2


@compiled
def _log_hidden(events, used, last, limit, begin, end):
    """Log that a size up to a limit may be hidden between two times."""
    if limit < abs(last.height):
        return used
    # Consecutive intervals are one event.
    if used > 0:
        before = events[used - 1]
        if before.kind == HIDDEN and before.grain == last.grain and before.until == begin:
            before.height = max(before.height, limit)
            before.until = end
            return used
    events[used] = last
    event = events[used]
    event.kind = HIDDEN
    event.when = begin
    event.height = limit
    event.until = end
    return used + 1


@compiled
def _slope(c, count, s, work):
    """Return the derivative of a polynomial at a place."""
    differentiate(c, count, work[STEEP])
    return value(work[STEEP], count - 1, s)


@joined
def sure_bend(slopes, count, s, top, error, work):
    """Return h^2 times a lower bound of the curvature at a place; 0 if it may vanish."""
    bend = abs(_slope(slopes, count, s, work))
    return larger(bend - SHAPE.curvature * error - FLAT * top, 0.0)


@compiled
def _log_shoulders(p, i, h, t, count, stretch, last, events, used, work):
    """Log the local minima of the slope while the size rises above all earlier values."""
    slopes = work[D]
    bends = work[BEND]
    sign = 1.0 if slopes[0] + slopes[count - 2] > 0.0 else -1.0
    slower = 0
    while slower < count - 2 and sign * (slopes[slower + 1] - slopes[slower]) >= 0.0:
        slower += 1
    # Most rises never slow down and speed up again.
    if slower >= count - 3:
        return used
    differentiate(slopes, count - 1, bends)
    for k in range(roots(bends, count - 2, work[PLACES], work)):
        s = work[PLACES, k]
        if not stretch[0] < s < stretch[1]:
            continue
        height = value(work[C], count, s)
        sign = 1.0 if height > 0.0 else -1.0
        steep = sign * value(slopes, count - 1, s)
        bend = sign * _slope(bends, count - 2, s, work)
        if abs(height) > abs(last.height) and steep > 0.0 and bend > 0.0:
            events[used] = last
            event = events[used]
            event.kind = SHOULDER
            event.when = t + s * h
            event.height = height
            event.tilt = (SHAPE.slope * p[ERROR, i] - steep) / h
            event.bend = bend / h**3
            used += 1
    return used


@joined
def _has_fallen(last):
    """Return whether the size has fallen since the last maximum, by more than rounding errors."""
    return last.since < (1.0 - NO_FALL) * abs(last.height)


@compiled
def _exceed(last, before, error, h, t, s, height, bend):
    """Replace the last maximum by a larger size at place s.

    The interval begins at time t with the value `before`. `bend` is a lower bound on the curvature
    at the maximum, or 0 if the curvature may vanish.
    """
    top = abs(height)
    begin = abs(before)
    if bend == 0.0 and top > 0.0:
        # Possibly free flight: the maximum is at the start of the flight.
        flat = begin <= (1.0 + NO_FALL) * abs(last.height) and top <= begin + error
        if flat and not _has_fallen(last):
            # The size may have an error that the previous interval does not have.
            last.off = larger(last.off, error)
            last.tilt = larger(last.tilt, SHAPE.slope * error / h)
            return
        if begin >= (1.0 - NO_FALL) * top:
            s = 0.0
            if begin > top:
                # The previous interval, flat within its error, ended above the last maximum.
                height = before
                top = begin
                error = larger(error, last.off)
    last.when = t + s * h
    last.height = height
    last.off = error
    last.tilt = SHAPE.slope * error / h
    last.bend = bend
    last.since = top
    last.until = last.when


@compiled
def _turns_or_slows(p, kind, i, count, slopes):
    """Return whether a polynomial may turn after sample i, or slow down and speed up again."""
    top = slopes[0]
    low = slopes[0]
    for k in range(1, count - 1):
        top = max(top, slopes[k])
        low = min(low, slopes[k])
    row = J if kind == VELOCITY else A
    before = p[row, i]
    after = p[row, i + 1]
    # A derivative of constant sign has no turn; its own slope shows changes of speed.
    if top >= -low:
        return low < 0.0 or before < 0.0 < after
    return top > 0.0 or before > 0.0 > after


@compiled
def _begin(last, t, height):
    """Set the last maximum to the size at a sample."""
    last.kind = MAXIMUM
    last.when = t
    last.until = t
    last.height = height
    last.since = abs(height)


@joined
def _log_maxima(p, interval, ends, counts, last, events, used, work):
    """Process the turning points and the end of an interval; return the number of events.

    `ends` contains the values at the two ends of the interval. `counts` contains the number of
    coefficients of its polynomial and the number of its turning points. The first number is 0 if
    the polynomial neither turns nor slows down.
    """
    i, t, h = interval
    count, turns = counts
    before, after = ends
    error = p[ERROR, i]
    here = before
    begin = 0.0
    # The size is monotonic between turning points.
    for k in range(turns + 1):
        s = work[TURNS, k] if k < turns else 1.0
        there = value(work[C], count, s) if k < turns else after
        if here * there < 0.0:
            last.since = 0.0
        if abs(there) >= abs(last.height):
            if _has_fallen(last):
                events[used] = last
                used += 1
            if count > 0:
                stretch = (begin, s)
                used = _log_shoulders(p, i, h, t, count, stretch, last, events, used, work)
            bend = 0.0
            if k < turns:
                bend = sure_bend(work[D], count - 1, s, abs(there), error, work) / h**2
            _exceed(last, before, error, h, t, s, there, bend)
        last.since = min(last.since, abs(there))
        here = there
        begin = s
    # The errors of both sizes may have opposite signs.
    if last.since >= abs(last.height) - 2.0 * last.off:
        last.until = t + h
    return used


@compiled
def follow(p, kind, h, window, ceiling, largest, latest, n, events, used, work):
    """Process intervals of a body until the log of events is full.

    Return the first interval that is not processed, or the end of the window, and the number of
    events.

    Parameters
    ----------
    p : (8, R) array
        Path of the body in the layout of `hermite.PathRows`.
    kind : int
        DISPLACEMENT, VELOCITY or RAISED, the size that is followed.
    h : float
        Time between two samples, s.
    window : Window
        Intervals to process.
    ceiling : (R-1,) or (0,) array
        Upper bound on the speed in each interval, m/s. It is negative, or the array is empty, if
        the polynomial shows the speed.
    largest : (3, G) array
        Largest sizes and their bounds; column n is updated.
    latest : (G,) or (0,) array of EVENT
        Last maximum of each grain that exceeds all earlier sizes; element n is updated. No event is
        logged if the array is empty.
    n : int
        Index of the grain or contact in `largest` and `latest`.
    events : array of EVENT
        Log of events; filled.
    used : int
        Number of events in the log.
    work : array
        Work array, as `scratch` returns it.
    """
    y = p[V if kind == VELOCITY else U]
    slopes = p[A if kind == VELOCITY else V]
    c = work[C]
    d = work[D]
    turning = work[TURNS]
    bound(p, kind, h)
    # Intervals below the largest sample need no search.
    top = highest(y, window.begin, window.end + 1, kind)
    for k in range(3):
        largest[k, n] = larger(largest[k, n], top)
    for i in range(window.begin, window.end):
        if latest.size and used + ROOM > events.size:
            return i, used
        before = y[i]
        after = y[i + 1]
        error = p[ERROR, i]
        reach = p[REACH, i] + error
        limit = hidden(p, kind, h, ceiling, i)
        seen = limit < 0.0
        exceeds = seen and reach > largest[LOW, n]
        rises = False
        dips = False
        if latest.size:
            height = abs(latest[n].height)
            # An interval below the last maximum matters only if it dips, unless the size was 0
            # before.
            rises = seen and reach >= height
            dips = seen and reach < height and latest[n].since > 0.0
            dips = dips and slopes[i] * before < 0.0 < slopes[i + 1] * after
        count = 0
        turns = 0
        if exceeds or rises or dips:
            count = fill_polynomial(p, kind, h, i, work)
            if dips or _turns_or_slows(p, kind, i, count, d):
                turns = roots(d, count - 1, turning, work)
            else:
                count = 0
        if exceeds:
            top = larger(size(before, kind), size(after, kind))
            for k in range(turns):
                top = larger(top, size(value(c, count, turning[k]), kind))
            largest[VALUE, n] = larger(largest[VALUE, n], top)
            largest[LOW, n] = larger(largest[LOW, n], top - error)
            largest[HIGH, n] = larger(largest[HIGH, n], top + error)
        elif not seen:
            largest[HIGH, n] = larger(largest[HIGH, n], limit)
        if latest.size and (rises or not seen or latest[n].kind != LEVEL):
            t = (window.first + i) * h
            if latest[n].kind == LEVEL:
                # Maxima are searched from here.
                _begin(latest[n], t, before)
            if not seen:
                used = _log_hidden(events, used, latest[n], limit, t, t + h)
            interval = (i, t, h)
            ends = (before, after)
            counts = (count, turns)
            used = _log_maxima(p, interval, ends, counts, latest[n], events, used, work)
    return window.end, used


@compiled
def _add_row(row, sign, values):
    """Add the values of a body at its samples, times a sign, to a row."""
    for i in range(row.size):
        row[i] += sign * values[i]


@compiled
def _add_body(p, sign, block, derived, place, n):
    """Add the motion of a body to a path; its derivatives are in a row of `derived`, unless -1."""
    column = block.column[n]
    if n == block.imposed.wall_body:
        # This wall has an imposed motion, which is 0 of a wall that rests.
        for k in range(4):
            _add_row(p[k], sign, block.imposed.wall[k])
        _add_row(p[DOUBT], 1.0, block.imposed.doubt)
    elif column >= 0:
        _add_row(p[U], sign, block.u[column])
        _add_row(p[V], sign, block.v[column])
    if place >= 0:
        for k in range(2):
            _add_row(p[A + k], sign, derived[place, k])
        _add_row(p[DOUBT], 1.0, derived[place, 2])


@compiled
def fill_path(p, block, derived, body, row, lower):
    """Fill in the motion of a body, or relative to the body below it; return whether it moves.

    `row` and `lower` are the rows of the body and of the body below it in `derived`, see
    `table_of`.
    """
    for k in range(5):
        for i in range(p.shape[1]):
            p[k, i] = 0.0
    # A loop makes the compiler emit the code for a body only once.
    for side in range(2 if lower >= AT_REST else 1):
        _add_body(p, 1.0 - 2.0 * side, block, derived, lower if side else row, body + side)
    moves = False
    for i in range(p.shape[1]):
        moves |= (p[U, i] != 0.0) | (p[V, i] != 0.0)
    return moves


def table_of(grains: np.ndarray, kinds: Sequence[int], contacts: Sequence[int]) -> np.ndarray:
    """Return the table for `reduce`, (F, 5) integers, with a row per grain size or contact.

    The columns of the table are the number of a body, its row in the result of
    `derivatives.derive`, the row of the body below it, or NONE unless the approach of the two
    bodies is followed, the kind of size, and the index of its largest value.
    """
    table = np.empty((len(kinds) * grains.size + len(contacts), 5), dtype=np.int64)
    count = np.arange(grains.size)
    for place, kind in enumerate(kinds):
        part = table[place * grains.size :][: grains.size]
        part[:, 0] = grains
        part[:, 1] = part[:, 4] = count
        part[:, 2] = NONE
        part[:, 3] = kind
    row = dict(zip(grains.tolist(), range(grains.size), strict=True)) if contacts else {}
    for place, n in enumerate(contacts):
        lower = row.get(n + 1, AT_REST)
        table[len(kinds) * grains.size + place] = n, row.get(n, AT_REST), lower, RAISED, place
    return table


def reduce(
    block: SampledBlock,
    table: np.ndarray,
    derived: Array,
    ceiling: Array,
    window: Window,
    largest: Sequence[Array],
    tracked: int,
    latest: np.ndarray,
    events: np.ndarray,
) -> np.ndarray:
    """Process some intervals of the motion of grains and contacts; return the events so far.

    Parameters
    ----------
    block : SampledBlock
        Samples of the motion.
    table : (F, 5) array of int
        Sizes to follow, as `table_of` returns them.
    derived : (G, 3, R) array
        Accelerations, jerks and errors, as `derivatives.derive` returns them.
    ceiling : (G, R-1) or (1, R-1) or (1, 0) array
        Upper bounds on speeds, as in `follow`: for each grain or contact, for all together, or
        none.
    window : Window
        Intervals to process.
    largest : three (3, G) or (3, P) arrays
        Largest displacements and speeds of grains, and largest approaches of contacts from rest,
        with their bounds; updated.
    tracked : int
        DISPLACEMENT or VELOCITY, the size whose events are logged.
    latest : (G,) or (0,) array of EVENT
        Last maximum of each grain, as in `follow`; updated.
    events : (E,) array of EVENT
        Events so far.
    """
    work = np.zeros((8, block.u.shape[1])), scratch()
    used = events.size
    rest = window
    while len(table):
        # Doubling the size keeps the cost of copies below that of the events.
        events = np.concatenate((events[:used], np.zeros(used + ROOM, EVENT)))
        maxima = tuple(largest), tracked, latest, (events, used)
        done, begin, used = _reduce(block, table, derived, ceiling, rest, window, *maxima, work)
        table = table[done:]
        rest = window._replace(begin=begin)
    return events[:used]


@compiled_measure()
def _reduce(block, table, derived, ceiling, rest, window, sizes, tracked, latest, log, work):
    """Do the work of `reduce` until the log is full; for the first row, do only `rest`.

    Return the number of rows of the table that are complete, the first interval of the next row
    that is not processed, and the number of events.
    """
    far, fast, closest = sizes
    events, used = log
    path, places = work
    for f in range(table.shape[0]):
        kind = table[f, 3]
        n = table[f, 4]
        moves = fill_path(path, block, derived, table[f, 0], table[f, 1], table[f, 2])
        if moves or kind == RAISED:
            limits = ceiling[n if ceiling.shape[0] > 1 else 0]
            largest = fast if kind == VELOCITY else (far if kind == DISPLACEMENT else closest)
            few = latest if kind == tracked else latest[:0]
            left = window if f > 0 else rest
            begin, used = follow(
                path, kind, block.h, left, limits, largest, few, n, events, used, places
            )
            if begin < window.end:
                return f, begin, used
    return table.shape[0], window.begin, used
