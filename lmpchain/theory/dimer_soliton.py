"""Solitary waves of dimer chains in the sonic vacuum, which exist only at certain mass ratios.

Heavy and light grains alternate, and all contacts are equal. The mass ratios are the antiresonances
of K. R. Jayaprakash, Y. Starosvetsky and A. F. Vakakis, Phys. Rev. E 83, 036606 (2011). At other
mass ratios the light grains oscillate behind a pulse, which therefore loses energy.

A contact with a heavy grain behind it has the overlap A(x), and the other contacts have A(-x), with
x = n + 1/2 - c t in grains. The equation of A is ``c^2 A'' = N(A(1 - x)) / M - N(A(x)) (1/M + 1/m)
+ N(A(-1 - x)) / m``. Newton's method computes A, as a Fourier series, together with the mass m of
the light grains. The units are M = 1 and contact constants 1, as in `lmpchain.theory.soliton`.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from ..chain.chain import Chain
from ..errors import InputError
from ..scene.excitation import Profile
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish
from ..util.progress import ProgressBar
from ..util.tabular import Tabular
from .domain import real, require

__dir__ = listed(__name__)


@dataclass(frozen=True)
class Grid:
    """Sizes of the Fourier series and parameters of the searches.

    Attributes
    ----------
    period : float
        Period of the series, in grains.
    points : int
        Number of points in a period.
    lightest : float
        Smallest mass ratio of a scan.
    spacing : float
        Distance of the starting points of searches in a scan, in 1 / sqrt(ratio).
    """

    period: float = 12.0
    points: int = 256
    lightest: float = 0.03
    spacing: float = 0.35


GRID = Grid()


@dataclass(frozen=True, eq=False, repr=False)
class DimerSoliton(Shown, Tabular):
    """A solitary wave in a chain of alternating heavy and light grains.

    Attributes
    ----------
    delta : float
        Exponent of the contact force.
    mass_ratio : float
        Mass ratio of light to heavy grains at the antiresonance.
    speed : float
        Speed c, grains per unit of time.
    place : (K,) array
        Positions x, in grains.
    values : (K,) array
        Overlaps A at these positions.
    """

    _units: ClassVar[dict[str, str]] = {"place": "", "values": ""}

    delta: float
    mass_ratio: float
    speed: float
    place: Array
    values: Array

    def overlap(self, x: ArrayLike, light_behind: bool = False) -> Array:
        """Return the overlap of a contact at x, by whether the grain after it is heavy or light."""
        return self._series(-real(x, "x") if light_behind else real(x, "x"), 0)

    def displacement(self, x: ArrayLike, light: bool = False) -> Array:
        """Return the displacement of a heavy or a light grain at x, 0 far ahead of the wave."""
        return self._ahead(x, light, 0)

    def velocity(self, x: ArrayLike, light: bool = False) -> Array:
        """Return the velocity of a heavy or a light grain at x, positive in travel direction."""
        return -self.speed * self._ahead(x, light, 1)

    def on(self, chain: Chain, grain: float) -> Profile:
        """Return this wave on a chain at the time when it passes a grain downward.

        Displacements and velocities are in SI units. The largest velocity of heavy grains, in m/s,
        is the velocity given to `solve`.

        Raises
        ------
        InputError
            If the chain is not a dimer of this mass ratio in a sonic vacuum, or if it is too short.
        """
        require(("grains", chain.grains > 1, "must be two or more, heavy and light in turn"))
        mass = chain.masses
        constant = chain.contact_constants
        heavy = np.arange(chain.grains) % 2 == int(mass[0] < mass[1])
        heaviest = mass[heavy][0]
        alternating = np.where(heavy, heaviest, self.mass_ratio * heaviest)
        low = 1 + GRID.period / 2
        high = chain.movable - GRID.period / 2
        exponent = f"must have the exponent {self.delta:g} of the wave"
        masses = np.abs(mass / alternating - 1) < 1e-9
        ratio = f"must alternate in the ratio {self.mass_ratio:.12g}"
        fits = f"must lie from {low:g} to {high:g} for the wave to fit the chain"
        require(
            ("chain", chain.law.power == self.delta, exponent),
            ("chain.ground", chain.ground is None, "must be left out: it would change the wave"),
            ("chain", not chain.compressed, "must be in a sonic vacuum: no gravity, no load"),
            ("masses", masses, ratio),
            ("contact_constants", np.ptp(constant) < 1e-9 * constant[0], "must be equal"),
            ("grain", low <= grain <= high, fits),
        )
        unit = (heaviest / constant[0]) ** (1 / (1 + self.delta))
        x = np.arange(1, chain.grains + 1) - grain
        u = np.where(heavy, self.displacement(x), self.displacement(x, light=True))
        v = np.where(heavy, self.velocity(x), self.velocity(x, light=True))
        return Profile(displacement=u * unit, velocity=v)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the velocities of heavy and light grains and the overlaps, and return the axes."""
        ax = chart(ax, "x − ct (grains)", "units of heavy mass and contact")
        x = np.linspace(-GRID.period / 3, GRID.period / 3, 401)
        for name, light in (("heavy", False), ("light", True)):
            ax.plot(x, self.velocity(x, light), label=f"velocity of {name} grains")
            ax.plot(x, self.overlap(x, light), "--", lw=1, label=f"overlap ahead of {name} grains")
        ratio = f"mass ratio {self.mass_ratio:.8g}"
        return finish(ax, f"δ = {self.delta:g}, {ratio}, speed {self.speed:.7g}")

    def _series(self, x: Array, derivative: int) -> Array:
        """Return A or A' from its Fourier series; 0 outside the interval."""
        size = self.place.size
        k = 2 * np.pi * np.fft.rfftfreq(size, GRID.period / size)
        # All wave numbers except 0 represent two terms of the complex series.
        twice = np.where(k == 0, 1, 2)
        weight = np.fft.rfft(self.values) * (1j * k) ** derivative * twice / size
        angle = np.multiply.outer(x - self.place[0], k)
        inside = np.abs(x) < GRID.period / 2
        return np.where(inside, (np.exp(1j * angle) @ weight).real, 0.0)

    def _ahead(self, x: ArrayLike, light: bool, derivative: int) -> Array:
        """Return the sum over all contacts ahead of a grain, alternating between both kinds."""
        x = real(x, "x")
        far = GRID.period / 2
        number = np.ceil(np.maximum(-far - x - 0.5, 0.0))[..., None] + np.arange(GRID.period + 2)
        at = x[..., None] + 0.5 + number
        forward = self._series(at, derivative)
        backward = self._series(-at, derivative) * (-1) ** derivative
        return np.where((number + light) % 2 == 1, backward, forward).sum(-1)


def antiresonances(
    least: float = 0.1, delta: float = 1.5, *, progress: bool = False
) -> tuple[float, ...]:
    """Return the mass ratios at which a dimer chain carries a solitary wave, from 1 downward.

    A light grain oscillates while a pulse passes it, at a rate proportional to
    ``s = 1 / sqrt(ratio)``. From one antiresonance to the next it completes one more oscillation,
    so that antiresonances are evenly spaced in s, about 0.8 apart. Searches start at less than half
    of this distance, and each antiresonance is found from several starting points.

    Parameters
    ----------
    least : float
        Smallest mass ratio of light to heavy grains, 0.03 or more.
    delta : float
        Exponent of the contact force, above 1 and at most 3.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    tuple of float
        Mass ratios in descending order, all below 1, the ratio of equal grains.

    Raises
    ------
    InputError
        If an argument is out of range.

    Examples
    --------
    >>> [round(ratio, 9) for ratio in antiresonances(0.3)]  # doctest: +SKIP
    [0.342845781]
    """
    lightest = GRID.lightest
    require(
        ("least", lightest <= least < 1, f"must be from {lightest:g} to 1 (got {least!r})"),
        ("delta", 1 < delta <= 3, f"must be above 1, and 3 or less (got {delta!r})"),
    )
    spacing = GRID.spacing
    beginnings = 1 / np.arange(1 + spacing, 1 / np.sqrt(least) + 2 * spacing, spacing) ** 2
    ratios: set[float] = set()
    with ProgressBar(beginnings.size, "antiresonances", shown=progress) as bar:
        for near in beginnings.tolist():
            # An error means that no antiresonance is near.
            with suppress(InputError):
                ratios.add(round(_solve(near, float(delta))[0], 10))
            bar.advance()
    return tuple(sorted((ratio for ratio in ratios if least <= ratio < 1), reverse=True))


def solve(near: float, delta: float = 1.5, velocity: float = 1.0) -> DimerSoliton:
    """Return the solitary wave at the antiresonance near a mass ratio.

    Parameters
    ----------
    near : float
        Mass ratio of light to heavy grains. The antiresonance that is found may not be the nearest
        one.
    delta : float
        Exponent of the contact force, above 1 and at most 3.
    velocity : float
        Largest velocity of heavy grains.

    Returns
    -------
    DimerSoliton
        The wave as a function of position.

    Raises
    ------
    InputError
        If an argument is out of range, or if no antiresonance is found near this ratio.

    Examples
    --------
    >>> f"{solve(0.35).mass_ratio:.9f}"
    '0.342845781'
    """
    require(
        ("near", 0 < near < 1, f"must be between 0 and 1 (got {near!r})"),
        ("delta", 1 < delta <= 3, f"must be above 1, and 3 or less (got {delta!r})"),
        ("velocity", 0 < velocity < np.inf, f"must be above 0 (got {velocity!r})"),
    )
    ratio, x, values = _solve(float(near), float(delta))
    wave = DimerSoliton(delta, ratio, 1.0, x, values)
    # Points 1e-4 apart miss the largest velocity by less than 1e-8 of it.
    coarse = np.linspace(-2, 2, 201)
    fine = coarse[wave.velocity(coarse).argmax()] + np.linspace(-0.02, 0.02, 401)
    fastest = float(wave.velocity(fine).max())
    speed = (velocity / fastest) ** ((delta - 1) / (delta + 1))
    return DimerSoliton(delta, ratio, speed, x, values * speed ** (2 / (delta - 1)))


@cache
def _solve(near: float, delta: float) -> tuple[float, Array, Array]:
    """Return the mass ratio, and the positions and values of A, for speed 1."""
    points = GRID.points
    x = (np.arange(points) - points // 2) * GRID.period / points
    k = 2 * np.pi * np.fft.fftfreq(points, GRID.period / points)
    # Inverse of the second derivative, except for the mean.
    inverse = np.zeros(points)
    inverse[1:] = -1 / k[1:] ** 2
    fourier = np.fft.fft(np.eye(points))

    def operator(symbol: NDArray[Any]) -> Array:
        return np.fft.ifft(symbol[:, None] * fourier, axis=0).real

    # The equation is divided by c^2 and integrated twice: A minus its mean is a sum of forces.
    mirror = np.eye(points)[-np.arange(points) % points]
    alone = operator(inverse)
    heavy = operator(inverse * np.exp(-1j * k)) @ mirror - alone
    light = operator(inverse * np.exp(1j * k)) @ mirror - alone
    slope = operator(1j * k)[0]
    values = _approximate(near, delta, x)
    # An additional row fixes the position of the wave; an additional column is for the light mass.
    inertia = 1 / near
    matrix = np.zeros((points + 1, points + 1))
    matrix[-1, :-1] = slope
    for _ in range(60):
        overlap = np.maximum(values, 0.0)
        force = overlap**delta
        stiffness = delta * overlap ** (delta - 1)
        residual = values - values.mean() - heavy @ force - inertia * (light @ force) + values[0]
        matrix[:-1, :-1] = np.eye(points) - 1 / points - (heavy + inertia * light) * stiffness
        matrix[:-1, 0] += 1
        matrix[:-1, -1] = -light @ force
        change = np.linalg.solve(matrix, np.append(residual, slope @ values))
        size = max(np.abs(change[:-1]).max() / values.max(), abs(change[-1]) / inertia)
        # Larger changes would lead to another wave, or to none.
        change *= min(1.0, 0.2 / size)
        values = values - change[:-1]
        inertia = inertia - change[-1]
        # Convergence is quadratic: the next change is the square of this one.
        if size < 1e-7:
            return float(1 / inertia), x, values
    message = f"there is no wave that does not radiate near the mass ratio {near:g}: try another"
    raise InputError.at("near", message)


def _approximate(ratio: float, delta: float, x: Array) -> Array:
    """Return A for speed 1 from the pulse after a strike, with its tail cut off."""
    # The wave passes this contact of a chain of 50 grains well before this time.
    grains = 50
    contact = 28
    until = 60.0
    mass = np.where(np.arange(grains) % 2 == 0, 1.0, ratio)

    def rate(_: float, state: Array) -> Array:
        force = np.maximum(-np.diff(state[:grains]), 0.0) ** delta
        return np.append(state[grains:], -np.diff(force, prepend=0.0, append=0.0) / mass)

    start = np.zeros(2 * grains)
    start[grains] = 1.0
    time = np.linspace(0, until, 3001)
    motion = solve_ivp(rate, (0, until), start, "DOP853", t_eval=time, rtol=1e-8, atol=1e-10)
    overlap = -np.diff(motion.y[:grains], axis=0)

    # The pulse passes a contact at the first peak, because light grains oscillate after it.
    def centre(number: int) -> float:
        force = np.maximum(overlap[number], 0.0) ** delta
        begin = int(np.argmax(force > 0.3 * force.max()))
        pulse = slice(max(0, begin - 150), begin + 250)
        return float(force[pulse] @ time[pulse] / force[pulse].sum())

    first = centre(contact)
    speed = 4 / (centre(contact + 4) - first)
    # A and its mirror image are half a grain apart.
    middle = (first + centre(contact + 1)) / 2 - 1 / (2 * speed)
    spline = CubicSpline((speed * (middle - time))[::-1], overlap[contact][::-1])
    near = np.abs(x) < GRID.period / 4
    values = spline(np.where(near, x, 0.0)) / speed ** (2 / (delta - 1))
    return np.where(near, np.maximum(values, 0.0), 0.0)
