"""Largest values of grains and the maxima of their motion, interval by interval, compiled.

One reduction for stored samples and for those of a run: it takes in consecutive samples, in blocks
of any size, and keeps a few numbers a grain. An interval is taken in when the sample behind the
next one is known, for the misfits of its neighbours tell of its error, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...util.arrays import Array
from ...util.compilation import compiled_once
from .derivatives import NEWS, BodySeries, compiled, joined, series_of
from .hermite import (
    DISPLACEMENT,
    RAISED,
    SHAPE,
    VELOCITY,
    highest,
    larger,
    path,
    polynomial,
    roots,
    sampled,
    size,
    slope,
    sure_bend,
    turns_or_slows,
    value,
)

# kinds of events
MAXIMUM, SHOULDER, HIDDEN = range(3)
NO_FALL = 1e-12  # of a largest value: a fall by less is rounding
ROOM = 32  # events by which a log grows, at least
# An event of a grain that may be its front, as its size exceeds all sizes before: a maximum of the
# size, a shoulder of its rise, or intervals in which a larger one may be hidden.
EVENT = np.dtype([
    ("grain", int),  # number in the reduction
    ("kind", int),
    ("when", float),  # s
    ("height", float),  # with its sign; a bound on the size if hidden
    ("off", float),  # error of the height
    ("tilt", float),  # error of the slope there, 1/s, less the slope of a shoulder
    ("bend", float),  # least curvature, 0 if unsure, 1/s^2; of the slope of a shoulder, 1/s^3
    ("since", float),  # least size until a larger one follows
    ("until", float),  # s, until when the size is the same within its error
])  # fmt: skip


class Largest(NamedTuple):
    """Largest sizes of G grains so far, and the bounds between which they lie, (G,) each."""

    value: Array
    low: Array
    high: Array

    def estimate(self, error: float) -> tuple[Array, Array]:
        """Return the values and their errors, for samples with this error."""
        return self.value, np.maximum(self.high - self.value, self.value - self.low) + error


class Window(NamedTuple):
    """Intervals of a block to take in, from `begin` to before `end`.

    Attributes
    ----------
    first : int
        Number of the first sample of the block.
    begin, end : int
        Of the intervals, counted from that sample.
    """

    first: int
    begin: int
    end: int


class Log(NamedTuple):
    """Events so far: so many of them as `used` says in `events`."""

    events: np.ndarray
    used: int


def lowest(count: int, bound: float = 0.0) -> Largest:
    """Return largest values before any interval."""
    return Largest(*np.full((3, count), bound))


def events_of(values: Array) -> np.ndarray:
    """Return the events that the first samples of G grains are."""
    events = np.zeros(values.size, EVENT)
    events["grain"] = np.arange(values.size)
    events["height"] = values
    events["since"] = np.abs(values)
    return events


@joined
def hidden(p, i):
    """Return a bound on the sizes behind sample i; -1 where the polynomial shows all of them."""
    if p.ceiling.size == 0 or p.ceiling[i] < 0.0:
        return -1.0
    if p.kind == VELOCITY:
        return p.ceiling[i]
    u = p.series.u
    return (size(u[i], p.kind) + size(u[i + 1], p.kind) + p.h * p.ceiling[i]) / 2


@compiled
def _append(log, event):
    """Append an event; return the log."""
    events = log.events
    if log.used == events.size:
        # twice as many, so that the copies cost no more than the events
        events = np.empty(2 * log.used + ROOM, EVENT)
        events[: log.used] = log.events
    events[log.used] = event
    return Log(events, log.used + 1)


@compiled
def _log_hidden(log, last, limit, begin, end):
    """Log that a size up to a limit may be hidden from one time to another."""
    if limit < abs(last.height):
        return log
    # intervals that follow one another are one event
    if log.used > 0:
        before = log.events[log.used - 1]
        if before.kind == HIDDEN and before.grain == last.grain and before.until == begin:
            before.height = max(before.height, limit)
            before.until = end
            return log
    log = _append(log, last)
    event = log.events[log.used - 1]
    event.kind = HIDDEN
    event.when = begin
    event.height = limit
    event.until = end
    return log


@joined
def _log_shoulders(p, i, t, stretch, last, log):
    """Log where a rise beyond all sizes before is slowest for a while, within a stretch of it."""
    sign = 1.0 if p.d[0] + p.d[p.d.size - 1] > 0.0 else -1.0
    slower = 0
    while slower < p.d.size - 1 and sign * (p.d[slower + 1] - p.d[slower]) >= 0.0:
        slower += 1
    # most rises are never slower and then faster
    if slower >= p.d.size - 2:
        return log
    bent = (p.d.size - 1) * (p.d[1:] - p.d[:-1])
    places = np.empty(8)
    for k in range(roots(bent, places)):
        s = places[k]
        if not stretch[0] < s < stretch[1]:
            continue
        height = value(p.c, s)
        sign = 1.0 if height > 0.0 else -1.0
        steep = sign * value(p.d, s)
        bend = sign * slope(bent, s)
        if abs(height) > abs(last.height) and steep > 0.0 and bend > 0.0:
            log = _append(log, last)
            event = log.events[log.used - 1]
            event.kind = SHOULDER
            event.when = t + s * p.h
            event.height = height
            event.tilt = (SHAPE.slope * p.error[i] - steep) / p.h
            event.bend = bend / p.h**3
    return log


@joined
def _has_fallen(last):
    """Return whether the size has fallen since the last maximum, by more than rounding."""
    return last.since < (1.0 - NO_FALL) * abs(last.height)


@joined
def _exceed(last, p, i, t, s, height, bend):
    """Let a size at place s, that exceeds all before, take the place of the last maximum.

    The interval from sample i on begins at t; the curvature `bend` is 0 if unsure.
    """
    top = abs(height)
    begin = abs(sampled(p)[i])
    error = p.error[i]
    if bend == 0.0 and top > 0.0:
        # in free flight, maybe: the maximum is where that began
        flat = begin <= (1.0 + NO_FALL) * abs(last.height) and top <= begin + error
        if flat and not _has_fallen(last):
            # or it is higher, by an error that the interval before need not have
            last.off = larger(last.off, error)
            last.tilt = larger(last.tilt, SHAPE.slope * error / p.h)
            return
        s = 0.0 if begin >= (1.0 - NO_FALL) * top else s
    last.when = t + s * p.h
    last.height = height
    last.off = error
    last.tilt = SHAPE.slope * error / p.h
    last.bend = bend
    last.since = top
    last.until = last.when


@joined
def _end(last, p, i, t):
    """Take in the size at the end of the interval from sample i and time t on."""
    height = sampled(p)[i + 1]
    if abs(height) >= abs(last.height):
        _exceed(last, p, i, t, 1.0, height, 0.0)
    last.since = min(last.since, abs(height))
    # both sizes may be off, to opposite sides
    if last.since >= abs(last.height) - 2.0 * last.off:
        last.until = t + p.h


@joined
def _dips(p, i):
    """Return whether a size falls and rises again from sample i to the next."""
    slopes = p.series.a if p.kind == VELOCITY else p.series.v
    y = sampled(p)
    return slopes[i] * y[i] < 0.0 < slopes[i + 1] * y[i + 1]


@joined
def _rises_or_dips(p, k, last):
    """Return whether behind sample k the last maximum is exceeded, or the size dips below it."""
    y = sampled(p)
    # it stays below: only a dip counts, unless the size has been 0 before
    if p.reach[k] + p.error[k] < abs(last.height):
        return last.since > 0.0 and _dips(p, k)
    fallen = y[k] * y[k + 1] < 0.0 or _has_fallen(last)
    return (abs(y[k + 1]) >= abs(last.height) and fallen) or turns_or_slows(p, k)


@joined
def _pass_calm(p, i, window, peaks, latest, n):
    """Take in intervals from i on as long as nothing turns in one; return the first other."""
    y = sampled(p)
    for k in range(i, window.end):
        if hidden(p, k) >= 0.0:
            return k
        exceeds = p.reach[k] + p.error[k] > peaks.low[n]
        if latest.size and _rises_or_dips(p, k, latest[n]):
            return k
        if exceeds:
            if turns_or_slows(p, k):
                return k
            top = larger(size(y[k], p.kind), size(y[k + 1], p.kind))
            peaks.high[n] = larger(peaks.high[n], top + p.error[k])
        if latest.size:
            last = latest[n]
            if y[k] * y[k + 1] < 0.0:
                last.since = 0.0
            _end(last, p, k, (window.first + k) * p.h)
    return window.end


@joined
def _pass_turns(p, i, t, turns, limit, last, log):
    """Take in the interval from sample i and time t on but for its end; return the log.

    The polynomial turns so often in it, unless a size up to a limit from 0 on is hidden there.
    """
    if limit >= 0.0:
        log = _log_hidden(log, last, limit, t, t + p.h)
    before = sampled(p)[i]
    begin = 0.0
    # from turn to turn the size only rises or only falls
    for k in range(turns + 1):
        s = p.places[k] if k < turns else 1.0
        height = value(p.c, s) if k < turns else sampled(p)[i + 1]
        if before * height < 0.0:
            last.since = 0.0
        if abs(height) >= abs(last.height):
            if _has_fallen(last):
                log = _append(log, last)
            if limit < 0.0:
                log = _log_shoulders(p, i, t, (begin, s), last, log)
            if k < turns:
                bend = sure_bend(p, s, abs(height), p.error[i]) / p.h**2
                _exceed(last, p, i, t, s, height, bend)
        if k < turns:
            last.since = min(last.since, abs(height))
        before = height
        begin = s
    return log


@joined
def _pass_any(p, i, t, peaks, latest, n, log):
    """Take in the interval from sample i and time t on; return the log."""
    y = sampled(p)
    limit = hidden(p, i)
    turns = 0
    if limit >= 0.0:
        peaks.high[n] = larger(peaks.high[n], limit)
    else:
        polynomial(p, i)
        turns = roots(p.d, p.places)
        top = larger(size(y[i], p.kind), size(y[i + 1], p.kind))
        for k in range(turns):
            top = larger(top, size(value(p.c, p.places[k]), p.kind))
        peaks.value[n] = larger(peaks.value[n], top)
        peaks.low[n] = larger(peaks.low[n], top - p.error[i])
        peaks.high[n] = larger(peaks.high[n], top + p.error[i])
    if latest.size:
        last = latest[n]
        log = _pass_turns(p, i, t, turns, limit, last, log)
        _end(last, p, i, t)
    return log


@compiled
def follow(p, window, peaks, latest, n, log):
    """Take in some intervals of a body; return the log of its events.

    Parameters
    ----------
    p : Path
    window : Window
    peaks : Largest
        Raised at n.
    latest : (G,) or (0,) array of EVENT
        The last maximum that exceeds all before, changed at n; no event is logged if it is empty.
    n : int
    log : Log
    """
    # samples first: what stays below them need not be looked at
    top = highest(sampled(p), window.begin, window.end + 1, p.kind)
    peaks.value[n] = larger(peaks.value[n], top)
    peaks.low[n] = larger(peaks.low[n], top)
    peaks.high[n] = larger(peaks.high[n], top)
    i = window.begin
    while i < window.end:
        i = _pass_calm(p, i, window, peaks, latest, n)
        if i < window.end:
            log = _pass_any(p, i, (window.first + i) * p.h, peaks, latest, n, log)
        i += 1
    return log


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def reduce(block, grains, derived, ceiling, window, sizes, latest, log):
    """Take in some intervals of the displacements and velocities of G grains; return the log.

    Parameters
    ----------
    block : Block
    grains : (G,) array
        Their numbers.
    derived : (G+1, 3, R) array
        See `derivatives.derive`.
    ceiling : (G, R-1) or (1, 0) array
        See `hermite.Path`.
    window : Window
    sizes : pair of Largest
        Displacements and speeds, of G grains, or of none if not asked for.
    latest : (G,) or (0,) array of EVENT
        See `follow`: of the speeds.
    log : Log
    """
    far, fast = sizes
    bounds = np.empty((2, block.u.shape[1] - 1))
    for g in range(grains.size):
        series = series_of(block, derived, g, grains[g])
        # at rest
        if not (series.u.any() or series.v.any()):
            continue
        limits = ceiling[g if ceiling.size else 0]
        if fast.value.size:
            p = path(series, VELOCITY, block.h, limits, bounds)
            log = follow(p, window, fast, latest, g, log)
        if far.value.size:
            p = path(series, DISPLACEMENT, block.h, limits, bounds)
            follow(p, window, far, latest[:0], g, log)
    return log


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def approach(block, contact, derived, rows, ceiling, window, closest):
    """Take in some intervals of how much closer than at rest the two bodies of a contact are.

    Parameters
    ----------
    block : Block
    contact : int
        Its number.
    derived : (G+1, 3, R) array
        See `derivatives.derive`.
    rows : (int, int)
        Of the two bodies in `derived`, -1 for one at rest.
    ceiling : (R-1,) or (0,) array
        Bounds on the relative speed between samples; see `hermite.Path`.
    window : Window
    closest : Largest
        Of this contact, with its sign.
    """
    above = series_of(block, derived, rows[0], contact)
    below = series_of(block, derived, rows[1], contact + 1)
    relative = BodySeries(
        above.u - below.u, above.v - below.v, above.a - below.a, above.j - below.j,
        above.doubt + below.doubt,
    )  # fmt: skip
    p = path(relative, RAISED, block.h, ceiling, np.empty((2, block.u.shape[1] - 1)))
    none = np.empty(0, EVENT)
    follow(p, window, closest, none, 0, Log(none, 0))
