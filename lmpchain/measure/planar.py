"""Waves of a dispersive shock at one x / t, and the planar ODE whose closed orbits they are.

Near one x / t an old dispersive shock is a periodic wave r(z), z = n - c t, of overlaps. It obeys
``m c^2 r'' = D F(r)`` with the mass m, the force F and the second difference D. The first two terms
of the inverse, ``1 / D = 1 / d^2 - 1 / 12 + ...`` with the derivative d, give a planar ODE:

    r' = p,   p' = 12 (r - (F(r) + A) / (m c^2))

Its orbits are closed and run between a trough and a crest; the orbit of the leading edge is
homoclinic. The phase speed c, the trough and the crest of a wave determine the constant A and the
orbit, and thus the distance from crest to crest and the mean overlap. The reduction follows Chong,
Herrmann and Kevrekidis, arXiv:2206.06413, who reduce dispersive shocks of lattices to a planar ODE.
The ODE here is derived from the equation of motion of the chain, and may differ from the form in
that paper. A second planar ODE uses the first terms of D instead of the inverse, with s = F(r):

    s'' = 12 (m c^2 r(s) - s - A)

The result for the lattice is between the results of the two ODEs. Their difference is used as the
error of the reduction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from ..errors import InputError
from ..theory.shock import Medium
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish
from ..util.tabular import Tabular
from .shock import find, medium_of, wave_of

__dir__ = listed(__name__)

# Fraction of the path at which the waves are measured, and half the distance for their speed.
PLACE = 0.7
HALF_DISTANCE = 4
LEAST_HEIGHT = 0.05  # Smallest height of a measured wave, trough to crest, relative to the jump.
DRAWN = 6  # Number of orbits in a picture.
ORBIT_COLUMNS = (
    "self_similar",
    "phase_speed",
    "crest",
    "trough",
    "spacing",
    "spacing_error",
    "mean",
    "mean_error",
    "orbit_spacing",
    "orbit_spacing_error",
    "orbit_mean",
    "orbit_mean_error",
)
ORBIT_POINTS = 201  # Number of points of an orbit from crest to trough.


class ClosedOrbit(NamedTuple):
    """A closed orbit of a planar ODE, from a crest to the next trough.

    Attributes
    ----------
    place : (P,) array
        Distance from the crest, grains.
    overlap : (P,) array
        Overlap, m.
    slope : (P,) array
        Derivative of the overlap, m per grain.
    spacing : float
        Distance from crest to crest, grains.
    mean : float
        Mean overlap, m.
    """

    place: Array
    overlap: Array
    slope: Array
    spacing: float
    mean: float


@dataclass(frozen=True, eq=False, repr=False)
class PlanarOrbits(Shown, Tabular):
    """Waves of a dispersive shock beside the orbits of the planar ODE, from the leading edge on.

    Attributes
    ----------
    contact : int
        The contact at which the waves were measured.
    self_similar : (W,) array
        Distance of each wave from the source divided by the age of the shock, grains/s.
    phase_speed : (W,) array
        Phase speed c of each wave, grains/s.
    crest, trough : (W,) arrays
        Overlaps at the crests, m, and at the trough between them, m.
    spacing : (W,) array
        Distance from crest to crest, grains: the period times the phase speed.
    spacing_error : (W,) array
        Error of the spacing, grains: its changes if the speed is measured over twice the distance
        or with the first crest alone, and the difference of the two crest heights.
    mean, mean_error : (W,) arrays
        Mean overlap over a period, m, and its error: the difference of the two crest heights.
    orbit_spacing, orbit_mean : (W,) arrays
        Distance from crest to crest, grains, and mean overlap, m, of the closed orbit between the
        same trough and crest.
    orbit_spacing_error, orbit_mean_error : (W,) arrays
        Differences from the results of the second planar ODE.
    orbits : tuple of ClosedOrbit
        Closed orbit of each wave.
    """

    _units: ClassVar[Mapping[str, str]] = {
        "self_similar": "grains/s",
        "phase_speed": "grains/s",
        "crest": "m",
        "trough": "m",
        "spacing": "grains",
        "orbit_spacing": "grains",
        "mean": "m",
        "orbit_mean": "m",
    }

    contact: int
    self_similar: Array
    phase_speed: Array
    crest: Array
    trough: Array
    spacing: Array
    spacing_error: Array
    mean: Array
    mean_error: Array
    orbit_spacing: Array
    orbit_spacing_error: Array
    orbit_mean: Array
    orbit_mean_error: Array
    orbits: tuple[ClosedOrbit, ...]
    _measured: tuple[tuple[Array, Array], ...]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw measured waves as dots and orbits as lines, in the plane of overlap and slope."""
        ax = chart(ax, "overlap [m]", "change of overlap a grain [m]")
        drawn = np.unique(np.linspace(0, len(self.orbits) - 1, DRAWN).astype(int))
        for number, color in zip(drawn, (f"C{k}" for k in range(DRAWN)), strict=False):
            orbit = self.orbits[number]
            overlap = np.append(orbit.overlap, orbit.overlap[::-1])
            slope = np.append(orbit.slope, -orbit.slope[::-1])
            label = f"x/t = {self.self_similar[number]:.4g} grains/s"
            ax.plot(overlap, slope, color=color, lw=1, label=label)
            ax.plot(*self._measured[number], ".", color=color, ms=4)
        title = f"waves at contact {self.contact}, and orbits of the planar ODE"
        return finish(ax, title, below=0.18, ncols=2)


def orbits(trajectory: Trajectory, direction: Literal["down", "up"] = "down") -> PlanarOrbits:
    """Return the waves of a dispersive shock and the orbits of the planar ODE beside them.

    Parameters
    ----------
    trajectory, direction
        See `shock.find`; the wave must be a dispersive shock.

    Returns
    -------
    PlanarOrbits

    Raises
    ------
    InputError
        For the reasons given in `shock.find`, or if the wave is not a dispersive shock with two or
        more crests.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=300, diameter=1e-3, gravity=0.0, top_load=1.0, top="wall")
    >>> speed = 0.3 * float(chain.equilibrium_overlap[0]) / chain.time_scale
    >>> piston = lmpchain.Drive(shape="piston", velocity=speed, rise=1e-6, grain=0)
    >>> duration = 270 * chain.time_scale
    >>> scene = lmpchain.Scene(chain=chain, excitation=piston, duration=duration, samples=1201)
    >>> waves = orbits(lmpchain.simulate(scene, "native"))
    >>> off = abs(waves.orbit_spacing - waves.spacing)
    >>> bool((off <= waves.spacing_error + waves.orbit_spacing_error).all())
    True
    """
    shock = find(trajectory, direction)
    if shock.kind != "dispersive shock":
        raise InputError.at("trajectory", f"must be of a dispersive shock, not of a {shock.kind}")
    gas = medium_of(trajectory)
    wave = wave_of(trajectory, direction == "up", gas)
    number = wave.source + int(PLACE * (wave.reached - wave.source))
    curve, crests, heights = _crests(wave.time, wave.overlap[:, number])
    neighbours = {
        lag: _crests(wave.time, wave.overlap[:, number + lag])[1]
        for each in (HALF_DISTANCE // 2, HALF_DISTANCE)
        for lag in (-each, each)
    }
    jump = shock.behind.overlap - shock.ahead.overlap
    count = min(crests.size, *(each.size for each in neighbours.values())) - 1
    rows = []
    closed: list[ClosedOrbit] = []
    measured = []
    for k in range(count):
        begin, end = crests[k : k + 2]
        inside = np.linspace(begin, end, ORBIT_POINTS)
        overlap = curve(inside)
        trough = float(overlap.min())
        crest = float(heights[k : k + 2].mean())
        if crest - trough < LEAST_HEIGHT * jump:
            break
        speeds = [_phase_speed(neighbours, lag, k) for lag in neighbours if lag > 0]
        speed = speeds[0]
        first = _orbit(gas, speed, trough, crest, _of_overlaps)
        second = _orbit(gas, speed, trough, crest, _of_forces)
        if first is None or second is None:
            continue
        difference = float(abs(np.diff(heights[k : k + 2])[0]))
        spacing = speed * (end - begin)
        varies = abs(_phase_speed(neighbours, HALF_DISTANCE, k, (0,)) - speed) / speed
        spread = abs(speeds[1] - speed) / speed + varies + difference / (crest - trough) / 2
        mean = float(np.mean((overlap[1:] + overlap[:-1]) / 2))
        age = (begin + end) / 2 - wave.start
        rows.append(
            (
                (number - wave.source) / age,
                speed,
                crest,
                trough,
                spacing,
                spacing * spread,
                mean,
                difference,
                first.spacing,
                abs(first.spacing - second.spacing),
                first.mean,
                abs(first.mean - second.mean),
            )
        )
        closed.append(first)
        measured.append((overlap[::4], -curve(inside, 1)[::4] / speed))
    if not rows:
        few = "the wave has fewer than two crests that are high enough: record longer"
        raise InputError.at("duration", few)
    columns = dict(zip(ORBIT_COLUMNS, np.array(rows).T, strict=True))
    return PlanarOrbits(
        contact=int(shock.contact[number]),
        orbits=tuple(closed),
        _measured=tuple(measured),
        **columns,
    )


def _crests(time: Array, overlap: Array) -> tuple[CubicSpline, Array, Array]:
    """Return a curve through samples, and times and heights of its maxima from the highest on."""
    curve = CubicSpline(time, overlap)
    turns = curve.derivative().roots(extrapolate=False)
    tops = turns[curve(turns, 2) < 0]
    heights = curve(tops)
    first = int(heights.argmax())
    return curve, tops[first:], heights[first:]


def _phase_speed(
    neighbours: Mapping[int, Array], lag: int, number: int, ends: tuple[int, ...] = (0, 1)
) -> float:
    """Return the speed, grains/s, of the crests at either end of a wave, in the mean."""
    late, early = neighbours[lag], neighbours[-lag]
    return float(np.mean([2 * lag / (late[number + end] - early[number + end]) for end in ends]))


# The second derivative of a variable without the constant A, and the ends of the orbit.
Bend = tuple[Callable[[Array], Array], Array]


def _of_overlaps(gas: Medium, inertia: float, ends: Array) -> Bend:
    """Return r'' without A as a function of r, and the ends of r."""
    return lambda r: 12 * (r - gas.constant * r**gas.exponent / inertia), ends


def _of_forces(gas: Medium, inertia: float, ends: Array) -> Bend:
    """Return s'' without A as a function of s = F(r), and the ends of s."""

    def bend(s: Array) -> Array:
        overlap = (s / gas.constant) ** (1 / gas.exponent)
        return np.asarray(12 * (inertia * overlap - s))

    return bend, gas.constant * ends**gas.exponent


def _orbit(
    gas: Medium,
    speed: float,
    trough: float,
    crest: float,
    ode: Callable[[Medium, float, Array], Bend],
) -> ClosedOrbit | None:
    """Return the orbit of a planar ODE between a trough and a crest, or None if there is none."""
    bend, (low, high) = ode(gas, gas.mass * speed**2, np.array([trough, crest]))
    # The constant A makes the integral of the bend over the way vanish.
    x, weight = leggauss(64)
    force = float(weight @ bend((high + low) / 2 + (high - low) / 2 * x)) / 2
    size = high - low

    def rates(_: float, state: Array) -> list[float]:
        return [state[1], (float(bend(low + size * state[0])) - force) / size]

    if not rates(0.0, np.ones(2))[1] < 0 < rates(0.0, np.zeros(2))[1]:
        return None

    def turns(_: float, state: Array) -> float:
        return state[1]

    turns.terminal, turns.direction = True, 1  # type: ignore[attr-defined]
    run = solve_ivp(
        rates, (0.0, 100.0), [1.0, 0.0], events=turns, rtol=1e-10, atol=1e-12, dense_output=True
    )
    if not run.t_events[0].size:
        return None
    half = float(run.t_events[0][0])
    place = np.linspace(0.0, half, ORBIT_POINTS)
    value, slope = low + size * run.sol(place)[0], size * run.sol(place)[1]
    if ode is _of_forces:
        overlap = (value / gas.constant) ** (1 / gas.exponent)
        slope = slope / (gas.exponent * gas.constant * overlap ** (gas.exponent - 1))
    else:
        overlap = value
    mean = float(np.mean((overlap[1:] + overlap[:-1]) / 2))
    return ClosedOrbit(place, overlap, slope, 2 * half, mean)
