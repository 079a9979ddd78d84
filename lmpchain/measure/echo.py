"""Pulses that pass a sensor downward and upward, and the time of flight of an echo.

The power that passes a grain is the force in the grain above rest times its velocity. The power is
positive in downward waves and negative in upward waves, both of compression and of tension. Its
sign therefore distinguishes an echo from the outgoing pulse.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline

from ..errors import InputError
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array, whole_numbers
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import COLOURS, Axes, chart, finish, prefixed
from ..util.tabular import Tabular
from .bodies import motion
from .contact import sensor
from .flight import arrival
from .motion import motion_of

__dir__ = listed(__name__)

FINER = 8  # Number of times per sampling interval at which the power is interpolated.


class Pulse(NamedTuple):
    """A pulse at the time when it passes a grain.

    Attributes
    ----------
    time : float
        Time of the largest power, s.
    error : float
        Uncertainty of the time by sampling, s.
    downward : bool
        Whether the pulse travels downward.
    force : float
        Force in the grain at `time` minus the force at rest, N; negative in a wave of tension.
    energy : float
        Energy that passes the grain, J; negative for an upward pulse.
    energy_error : float
        Uncertainty of the energy by sampling and by the error of the trajectory, J.
    """

    time: float
    error: float
    downward: bool
    force: float
    energy: float
    energy_error: float


@dataclass(frozen=True, eq=False, repr=False)
class Echo(Shown, Tabular):
    """The pulses that pass a grain, and the time of flight of the first echo.

    Attributes
    ----------
    grain : int
        Number of the grain.
    seconds : float
        Time from the first pulse to the next pulse, which travels in the other direction, s.
    error : float
        Uncertainty of this time by sampling, s. If the samples do not show which pulses exceed
        `least`, the error includes the distance to the other pulse.
    distance : float
        Distance at rest from the centre of the grain to the reflector and back, m.
    share, share_error : float
        Energy of the echo relative to the energy of the first pulse, and its uncertainty, which
        includes the same doubt.
    inverted : bool
        Whether compression returns as tension, or tension as compression.
    pulses : list of Pulse
        All pulses in the order of time; successive pulses travel in opposite directions.
    time : (T,) array
        Times, s.
    power : (T,) array
        Power through the grain, W, positive downward.
    """

    _units: ClassVar[Mapping[str, str]] = {"time": "s", "power": "W"}

    grain: int
    seconds: float
    error: float
    distance: float
    share: float
    share_error: float
    inverted: bool
    pulses: list[Pulse]
    time: Array
    power: Array

    @property
    def speed(self) -> float:
        """Mean speed on the way to the reflector and back, m/s."""
        return self.distance / self.seconds

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the power through the grain over time, and mark the pulses; return the axes."""
        ax = chart(ax, "time [s]", "power through the grain [W]")
        ax.plot(self.time, self.power, color="0.3", lw=1)
        for downward, mark, colour in (
            (True, "v", COLOURS["blue"]),
            (False, "^", COLOURS["vermilion"]),
        ):
            times = [pulse.time for pulse in self.pulses if pulse.downward == downward]
            label = "pulse that goes down" if downward else "pulse that goes up"
            ax.plot(times, np.interp(times, self.time, self.power), mark, color=colour, label=label)
        title = f"Grain {self.grain}: echo after {prefixed(self.seconds, 's', 6)}"
        return finish(ax, title)


def find(
    trajectory: Trajectory, grain: int, reflector: int | None = None, least: float = 0.02
) -> Echo:
    """Measure the time of flight of a pulse from a grain to a reflector and back.

    Experiments infer the stiffness of a specimen below a chain from this time for a solitary wave;
    see Sensors 20, 3016 (2020).

    Parameters
    ----------
    trajectory : Trajectory
        Run until the echo has passed the grain; the grain and its neighbours must be recorded.
    grain : int
        Number of the grain with the sensor.
    reflector : int, optional
        Number of the grain or wall (0 or N + 1) that reflects the pulse; by default the wall or
        last grain at the end to which the first pulse travels.
    least : float
        Smallest power of a pulse relative to the largest one. Weaker motion, such as the tail of a
        dispersing pulse, is ignored.

    Returns
    -------
    Echo

    Raises
    ------
    InputError
        If the grain or a neighbour was not recorded, or no pulse returns.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=40, diameter=5e-3, gravity=0.0, bottom="wall")
    >>> strike = lmpchain.Impulse(velocity=0.1)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=8e-4, samples=1601)
    >>> echo = find(lmpchain.simulate(scene, engine="native", tolerance=1e-8), 20)
    >>> f"{1e6 * echo.seconds:.2f} us, {echo.share:.3f} of the energy"
    '499.22 us, 0.997 of the energy'
    """
    number = int(whole_numbers(grain, "grain"))
    if not 0 < least < 1:
        raise InputError.at("least", f"must be between 0 and 1 (got {least})")
    change = sensor(trajectory, number).change
    velocity = motion(trajectory, np.array([number]))[1][:, 0]
    known = motion_of(trajectory)
    part = 2 * known.known_error("velocity") / max(known.sampled[1], 1e-300)
    power, rough = (_Power(trajectory.time, change, velocity, stride) for stride in (1, 2))
    pulses = _pulses(power, rough, least, part)
    if len(pulses) < 2:
        passed = f"no echo passes grain {number} (got {len(pulses)} pulses)"
        raise InputError.at("duration", f"{passed}: record longer, or choose a smaller least")
    out, back = pulses[:2]
    chain = trajectory.scene.chain
    end = reflector
    if end is None:
        ends = (chain.movable + 1, chain.bottom) if out.downward else (0, chain.top)
        # A free end reflects at its last grain.
        end = ends[0] if ends[1] != "free" else (chain.grains if out.downward else 1)
    place = int(whole_numbers(end, "reflector"))
    if not 0 <= place <= chain.grains + 1 or place == number:
        raise InputError.at("reflector", f"must be another grain or a wall (got {reflector})")
    seconds, share = _first_echo(pulses)
    # The largest sample of a wave reaches at least this fraction of its height.
    seen = math.cos(min(trajectory.scene.sampling_phase, math.pi) / 2)
    doubt = np.zeros(2)
    for curve in (power, rough):
        for level in (least * seen, least, least / max(seen, least)):
            other = _first_echo(_pulses(curve, rough, level, part))
            doubt = np.maximum(doubt, np.abs(np.subtract(other, (seconds, share))))
    return Echo(
        grain=number,
        seconds=seconds,
        error=out.error + back.error + float(doubt[0]),
        distance=2 * _distance(trajectory, number, place),
        share=share,
        share_error=(back.energy_error + share * out.energy_error) / abs(out.energy)
        + float(doubt[1]),
        inverted=out.force * back.force < 0,
        pulses=pulses,
        time=trajectory.time,
        power=change * velocity,
    )


def _first_echo(pulses: list[Pulse]) -> tuple[float, float]:
    """Return the time between the first two pulses, s, and the ratio of their energies.

    Both are infinite if there are fewer pulses.
    """
    if len(pulses) < 2:
        return math.inf, math.inf
    out, back = pulses[:2]
    return back.time - out.time, abs(back.energy / out.energy)


class _Power:
    """Power through a grain between the samples, from splines of its two factors.

    Where both factors change sign, the power may be negative for less than a sampling interval.

    Parameters
    ----------
    time, change, velocity : (T,) arrays
        Samples: times, s, force above rest, N, and velocity, m/s.
    stride : int
        Distance between the samples that are used.
    """

    def __init__(self, time: Array, change: Array, velocity: Array, stride: int):
        samples = np.append(np.arange(0, len(time) - 1, stride), len(time) - 1)
        # The degree of the splines is odd, and lower for few samples.
        degree = max(1, min(5, (samples.size - 1) // 2 * 2 - 1))
        self.force, speed = (
            make_interp_spline(time[samples], x[samples], degree) for x in (change, velocity)
        )
        intervals = FINER * (len(time) - 1)
        self.time: Array = np.linspace(time[0], time[-1], intervals + 1)
        self.values: Array = self.force(self.time) * speed(self.time)
        # Energy that has passed up to each time.
        self.passed: Array = CubicSpline(self.time, self.values).antiderivative()(self.time)


def _pulses(power: _Power, rough: _Power, least: float, part: float) -> list[Pulse]:
    """Return the pulses whose power exceeds a fraction of the largest; `part` is its error."""
    time = power.time
    values = power.values
    strong = np.flatnonzero(np.abs(values) > least * np.abs(values).max())
    if not strong.size:
        return []
    signs = np.sign(values[strong])
    # Strong values of equal sign form runs, with weak values between the runs.
    begins = np.append(0, 1 + np.flatnonzero(signs[1:] != signs[:-1]))
    ends = np.append(begins[1:], strong.size) - 1
    pulses = []
    start = 0
    # Between two times the energy is stationary at a time up to which the nearer value counts.
    step = time[1] - time[0]
    for number, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        low = 0 if number == 0 else int(strong[ends[number - 1]]) + 1
        last = number == len(begins) - 1
        high = len(time) if last else int(strong[begins[number + 1]])
        sign = float(signs[begin])
        # The energy that has passed is largest between a pulse and the next one.
        after = sign * power.passed[strong[end] : high]
        stop = high - 1 if last else int(strong[end] + after.argmax())
        energy = float(power.passed[stop] - power.passed[start])
        error = abs(energy - float(rough.passed[stop] - rough.passed[start])) + part * abs(energy)
        error += step * (abs(values[start]) + abs(values[stop]))
        start = stop
        inside = sign * values[low:high]
        # Otherwise the pulse is not complete.
        if 0 < inside.argmax() < len(inside) - 1:
            peak = arrival(time[low:high], inside, "power")
            # The same pulse, from every second sample.
            other = time[low + int((sign * rough.values[low:high]).argmax())]
            late = peak.error + abs(float(other) - peak.time)
            there = float(power.force(peak.time))
            pulses.append(Pulse(peak.time, late, sign > 0, there, energy, error))
    return pulses


def _distance(trajectory: Trajectory, grain: int, place: int) -> float:
    """Return the distance at rest between the centres of grains, or from a grain to a wall, m."""
    chain = trajectory.scene.chain
    depths = chain.depths
    radii = chain.diameters / 2
    if place == 0:
        return float(depths[grain - 1] - depths[0] + radii[0])
    if place > chain.grains:
        return float(depths[-1] - depths[grain - 1] + radii[-1])
    return float(abs(depths[place - 1] - depths[grain - 1]))
