"""Arrival times of signals, and times of flight between sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ..errors import InputError
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array, numbers
from ..util.lazy import listed
from .contact import Signal, sensor
from .crests import summit

__dir__ = listed(__name__)

# Relative error of a height above which a maximum counts as unresolved: the change with every
# second sample. For random signals with at least 3 samples per wave, 0.06 misses no largest
# maximum; with 2.6 samples, 0.25 misses one in 40.
UNRESOLVED = 0.25
# A signal has passed if its last sample, or the mean of its last tenth, is below this fraction of
# its maximum.
PASSED = 0.2


@dataclass(frozen=True)
class Arrival:
    """The largest maximum of a signal: time, s, height, and uncertainty by sampling, s."""

    time: float
    height: float
    error: float


class _Peak(NamedTuple):
    """A maximum of a signal, with the errors of its time, s, and of its height."""

    time: float
    height: float
    error: float
    unresolved: float


@dataclass(frozen=True)
class Flight:
    """Time of flight between two sensors.

    Attributes
    ----------
    grains : int
        Distance between the sensors in grains.
    distance : float
        Distance between the centres of the two grains at rest, m.
    seconds : float
        Time of flight, s.
    error : float
        Uncertainty of the time by sampling, s.
    """

    grains: int
    distance: float
    seconds: float
    error: float

    @property
    def speed(self) -> float:
        """Speed in m/s."""
        return self.distance / self.seconds

    @property
    def grains_per_second(self) -> float:
        """Speed in grains, 1/s."""
        return self.grains / self.seconds


def arrival(time: Array, values: Array, name: str = "signal") -> Arrival:
    """Return the largest maximum of a signal, by a quintic spline through the samples around it.

    The error is the shift of the maximum when only every second sample is used; if the signal is
    smooth and well sampled, the true error is about 1/60 of this shift. If the samples do not show
    which of several maxima is the largest, the error includes the distance to the other maxima. The
    error of the trajectory is not included.

    Parameters
    ----------
    time : (T,) array
        Times, s.
    values : (T,) array
        Values of the signal in any unit.
    name : str
        Name of the signal in messages.

    Returns
    -------
    Arrival

    Raises
    ------
    InputError
        If the largest value is the first or the last one, or not every time has a finite value.

    Examples
    --------
    >>> time = np.linspace(0, 1, 21)
    >>> peak = arrival(time, np.exp(-20 * (time - 0.512) ** 2))
    >>> round(peak.time, 5), round(peak.height, 5)
    (0.512, 1.0)
    """
    time = numbers(time, "time")
    values = numbers(values, "values")
    if values.shape != time.shape or not np.isfinite(values).all():
        raise InputError.at("values", "must be finite numbers, one for each time")
    top = int(np.argmax(values))
    last = len(values) - 1
    if not 0 < top < last:
        longer = "record for longer, and end the push if it still grows"
        cure = longer if top else "it has no later maximum"
        raise InputError.at(
            "duration", f"the {name} is largest in the {'last' if top else 'first'} sample: {cure}"
        )
    peaks = [_peak(time, values, k) for k in _candidates(values)]
    best = max(peaks, key=lambda peak: peak.height)
    # Maxima whose heights the samples cannot distinguish.
    rivals = [
        peak
        for peak in peaks
        if peak is not best and peak.height + peak.unresolved >= best.height - best.unresolved
    ]
    far = (abs(peak.time - best.time) + peak.error for peak in rivals)
    return Arrival(best.time, best.height, max(best.error, *far, 0.0))


def _candidates(values: Array) -> np.ndarray:
    """Return the numbers of the samples next to which the largest maximum may be."""
    inner = values[1:-1]
    before = inner - values[:-2]
    after = inner - values[2:]
    # A wave of three samples or more rises above its largest sample by less than the drop to either
    # side.
    reach = inner + np.maximum(before, after)
    return 1 + np.flatnonzero((before >= 0) & (after >= 0) & (reach >= values.max()))


def _peak(time: Array, values: Array, k: int) -> _Peak:
    """Return the maximum next to a sample."""
    when, height = summit(time, values, k, 1)
    # Near an end, where every second sample cannot be used, the maximum may be a sample away.
    if not 2 <= k <= len(values) - 3:
        drop = values[k] - min(values[k - 1], values[k + 1])
        return _Peak(when, height, float(time[k + 1] - time[k]), float(drop))
    rougher, rougher_height = summit(time, values, k, 2)
    unresolved = UNRESOLVED * abs(height - rougher_height)
    return _Peak(when, height, abs(when - rougher), unresolved)


def time_of_flight(
    trajectory: Trajectory, first: int, second: int, method: Literal["peak", "correlation"] = "peak"
) -> Flight:
    """Return the time of flight between sensors in two grains, which gives the wave speed.

    An echo may be mistaken for the wave, so end the recording before the echo arrives.

    Parameters
    ----------
    trajectory : Trajectory
    first, second : int
        Numbers of the grains with the sensors. Time and speed are negative if the wave reaches the
        second grain first.
    method : str
        "peak" measures the time between the largest maxima of the two signals. "correlation"
        measures the shift with the largest correlation, and the error then includes the change of
        this shift if every second sample of the signals is used. It requires that the force in both
        grains has returned to its value at rest, which is not the case behind a piston.

    Returns
    -------
    Flight

    Raises
    ------
    InputError
        If the grains are equal, a grain or its neighbours were not recorded, the method is unknown,
        or the wave has not passed a sensor.
    """
    if first == second or method not in ("peak", "correlation"):
        raise InputError.at(
            "second", 'choose two different grains, and the method "peak" or "correlation"'
        )
    one = sensor(trajectory, first)
    two = sensor(trajectory, second)
    if method == "peak":
        begin, end = (arrival(s.time, s.change, f"force in grain {s.grain}") for s in (one, two))
        seconds = end.time - begin.time
        error = begin.error + end.error
    else:
        for signal in (one, two):
            _check_passed(signal)
        best = _lag(one.time, one.change, two.change)
        seconds = best.time
        # The integrals over time depend on the sampling as well. Both results have the same end.
        last = one.time.size - (one.time.size + 1) % 2
        fine, coarse = (
            _lag(one.time[:last:n], one.change[:last:n], two.change[:last:n]) for n in (1, 2)
        )
        error = best.error + abs(fine.time - coarse.time)
    depths = trajectory.scene.chain.depths
    distance = abs(float(depths[second - 1] - depths[first - 1]))
    return Flight(abs(second - first), distance, seconds, error)


def _lag(time: Array, first: Array, second: Array) -> Arrival:
    """Return the shift of the second signal with the largest correlation, (T,) each."""
    # Importing SciPy's signal package takes longer than most measurements.
    from scipy.signal import correlate

    # The second signal may lag or lead by the whole recording.
    shifts = np.concatenate((-time[:0:-1], time))
    # The ends of the common interval count half, as in the trapezoidal rule.
    ends = np.concatenate(
        (
            second[0] * first[:0:-1] + first[-1] * second[:-1],
            first[0] * second + second[-1] * first[::-1],
        )
    )
    products = correlate(second, first) - ends / 2
    return arrival(shifts, products, "correlation of the two forces")


def _check_passed(signal: Signal) -> None:
    """Raise `InputError` if the force in a grain has not returned to its value at rest."""
    size = np.abs(signal.change)
    late = min(size[-1], abs(signal.change[-1 - size.size // 10 :].mean()))
    if size.argmax() == size.size - 1 or late > PASSED * size.max():
        cure = 'record for longer, or use method = "peak" if the push lasts'
        raise InputError.at(
            "duration", f"the wave has not passed grain {signal.grain} at the end: {cure}"
        )
