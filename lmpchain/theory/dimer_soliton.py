"""Solitary waves of dimer chains in the sonic vacuum, which exist at certain mass ratios only.

Heavy and light grains alternate, with like contacts. Between these mass ratios, the antiresonances of Jayaprakash,
Starosvetsky and Vakakis, Phys. Rev. E 83, 036606 (2011), light grains rattle behind a pulse, which so loses its energy.
A contact whose grain behind is heavy has the overlap A(x), the others A(-x), x = n + 1/2 - c t in grains, with
``c^2 A'' = N(A(1 - x)) / M - N(A(x)) (1/M + 1/m) + N(A(-1 - x)) / m``.
Newton's method on a Fourier series finds A together with the mass m of the light grains; M = 1 and contact constants 1
are the units, as in `lmpchain.theory.soliton`.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from ..chain.chain import Chain
from ..errors import InputError
from ..scene.excitation import Profile
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import axes_in_units, legend, set_title
from ..util.progress import ProgressBar
from .domain import real, require

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__dir__ = listed(__name__)

LIGHTEST, APART = (
    0.03,
    0.35,
)  # the least mass ratio of a scan, and how far apart its searches begin in 1 / sqrt(ratio)
PERIOD, POINTS = 12.0, 256  # grains, and points in them
GRAINS, CONTACT, UNTIL = 50, 28, 60.0  # of the chain that is struck for an approximation
ALIKE = 1e-9  # relative differences of masses and constants that count as none


@dataclass(frozen=True, eq=False, repr=False)
class DimerSoliton(Shown):
    """A solitary wave in a chain of heavy and light grains in turn.

    Attributes
    ----------
    delta : float
    mass_ratio : float
        Of light to heavy grains, the antiresonance.
    speed : float
        c, grains a unit of time.
    place, values : (K,) arrays
        A at these x.
    """

    delta: float
    mass_ratio: float
    speed: float
    place: Array
    values: Array

    def overlap(self, x: ArrayLike, light_behind: bool = False) -> Array:
        """Return the overlap of a contact at x, where the grain behind it is heavy or light."""
        return self._series(-real(x) if light_behind else real(x), 0)

    def displacement(self, x: ArrayLike, light: bool = False) -> Array:
        """Return the displacement of a heavy or a light grain at x: 0 far ahead of the wave."""
        return self._ahead(x, light, 0)

    def velocity(self, x: ArrayLike, light: bool = False) -> Array:
        """Return the velocity of a heavy or a light grain at x, in the direction in which the wave travels."""
        return -self.speed * self._ahead(x, light, 1)

    def on(self, chain: Chain, grain: float) -> Profile:
        """Return this wave on a chain, as it passes a grain downward.

        Displacements and velocities are in SI units; the largest velocity of heavy grains is that for which it was
        solved, in m/s.

        Raises
        ------
        InputError
            If the chain is no such dimer in a sonic vacuum, or too short.
        """
        require(("grains", chain.grains > 1, "must be two or more, heavy and light in turn"))
        mass, constant = chain.masses, chain.contact_constants
        heavy = np.arange(chain.grains) % 2 == int(mass[0] < mass[1])
        own = np.where(heavy, mass[heavy][0], self.mass_ratio * mass[heavy][0])
        low, high = 1 + PERIOD / 2, chain.movable - PERIOD / 2
        require(
            (
                "chain",
                chain.exponent == self.delta,
                f"must have the exponent {self.delta:g} of the wave",
            ),
            ("chain", not chain.compressed, "must be in a sonic vacuum: no gravity, no load"),
            (
                "masses",
                np.abs(mass / own - 1) < ALIKE,
                f"must alternate in the ratio {self.mass_ratio:.12g}",
            ),
            ("contact_constants", np.ptp(constant) < ALIKE * constant[0], "must be equal"),
            (
                "grain",
                low <= grain <= high,
                f"must lie from {low:g} to {high:g} for the wave to fit the chain",
            ),
        )
        unit = (own[heavy][0] / constant[0]) ** (1 / (1 + self.delta))
        x = np.arange(1, chain.grains + 1) - grain
        u, v = (np.where(heavy, f(x), f(x, light=True)) for f in (self.displacement, self.velocity))
        return Profile(displacement=u * unit, velocity=v)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the velocities of heavy and light grains against x, and the overlaps; returns the axes."""
        ax = axes_in_units(ax, "", "")
        x = np.linspace(-PERIOD / 3, PERIOD / 3, 401)
        for name, light in (("heavy", False), ("light", True)):
            ax.plot(x, self.velocity(x, light), label=f"velocity of {name} grains")
            ax.plot(x, self.overlap(x, light), "--", lw=1, label=f"overlap ahead of {name} grains")
        ax.set(xlabel="x − ct (grains)", ylabel="units of heavy mass and contact")
        set_title(
            ax, f"δ = {self.delta:g}, mass ratio {self.mass_ratio:.8g}, speed {self.speed:.7g}"
        )
        legend(ax)
        return ax

    def _series(self, x: Array, derivative: int) -> Array:
        """Return A or A' by its Fourier series, 0 beyond."""
        k = 2 * np.pi * np.fft.rfftfreq(self.place.size, PERIOD / self.place.size)
        weight = (
            np.fft.rfft(self.values)
            * (1j * k) ** derivative
            * np.where(k == 0, 1, 2)
            / self.place.size
        )
        angle = np.multiply.outer(x - self.place[0], k)
        return np.where(np.abs(x) < PERIOD / 2, (np.exp(1j * angle) @ weight).real, 0.0)

    def _ahead(self, x: ArrayLike, light: bool, derivative: int) -> Array:
        """Return the sum over all contacts ahead of a grain, each of the other kind than the last."""
        x, far = real(x), PERIOD / 2
        first = np.ceil(np.maximum(-far - x - 0.5, 0.0))[..., None] + np.arange(PERIOD + 2)
        at = x[..., None] + 0.5 + first
        behind = (first + light) % 2 == 1
        return np.where(
            behind, self._series(-at, derivative) * (-1) ** derivative, self._series(at, derivative)
        ).sum(-1)


def antiresonances(
    least: float = 0.1, delta: float = 1.5, *, progress: bool = False
) -> tuple[float, ...]:
    """Return the mass ratios at which a dimer chain carries a solitary wave, from 1 downward.

    A light grain that a pulse passes oscillates at a rate that goes as ``s = 1 / sqrt(ratio)``, and from one of them to
    the next it does so once more, so that they are evenly spread in s, some 0.8 apart. Searches begin half of that
    apart, and every one is found from several beginnings.

    Parameters
    ----------
    least : float
        The least mass ratio, of light to heavy grains, 0.03 or more.
    delta : float
        As for `solve`.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    tuple of float
        In falling order, all below 1, where all grains are alike.

    Raises
    ------
    InputError
        If these are out of range.

    Examples
    --------
    >>> [round(ratio, 9) for ratio in antiresonances(0.3)]
    [0.342845781]
    """
    require(
        ("least", LIGHTEST <= least < 1, f"must be from {LIGHTEST:g} to 1 (got {least!r})"),
        ("delta", 1 < delta <= 3, f"must be above 1, and 3 or less (got {delta!r})"),
    )
    beginnings = 1 / np.arange(1 + APART, 1 / np.sqrt(least) + 2 * APART, APART) ** 2
    found: set[float] = set()
    with ProgressBar(beginnings.size, "antiresonances", shown=progress) as bar:
        for near in beginnings.tolist():
            with suppress(InputError):  # which says that none is near
                found.add(round(_solved(near, float(delta))[0], 10))
            bar.advance()
    return tuple(sorted((ratio for ratio in found if least <= ratio < 1), reverse=True))


def solve(near: float, delta: float = 1.5, velocity: float = 1.0) -> DimerSoliton:
    """Return the solitary wave at the antiresonance near a mass ratio.

    Parameters
    ----------
    near : float
        Mass of a light over that of a heavy grain; the ratio that is found may be another than the nearest.
    delta : float
        Above 1, at most 3.
    velocity : float
        The largest one of heavy grains.

    Returns
    -------
    DimerSoliton

    Raises
    ------
    InputError
        If these are out of range, or there is none near that ratio.

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
    ratio, place, values = _solved(float(near), float(delta))
    wave = DimerSoliton(delta, ratio, 1.0, place, values)
    fastest = float(wave.velocity(np.linspace(-2, 2, 4001)).max())
    speed = (velocity / fastest) ** ((delta - 1) / (delta + 1))
    return DimerSoliton(delta, ratio, speed, place, values * speed ** (2 / (delta - 1)))


@cache
def _solved(near: float, delta: float) -> tuple[float, Array, Array]:
    """Return mass ratio, places and values of A for speed 1."""
    x = (np.arange(POINTS) - POINTS // 2) * PERIOD / POINTS
    k = 2 * np.pi * np.fft.fftfreq(POINTS, PERIOD / POINTS)
    inverse = np.where(
        k == 0, 0.0, -1 / np.where(k == 0, 1.0, k) ** 2
    )  # of the second derivative, but for the mean
    fourier = np.fft.fft(np.eye(POINTS), axis=0)

    def operator(symbol: Array) -> Array:
        return np.fft.ifft(symbol[:, None] * fourier, axis=0).real

    mirror = np.eye(POINTS)[-np.arange(POINTS) % POINTS]
    alone = operator(inverse)
    heavy, light = (
        operator(inverse * np.exp(shift * 1j * k)) @ mirror - alone for shift in (-1, 1)
    )
    slope = operator(1j * k * (np.arange(POINTS) != POINTS // 2))[0]
    values, inertia = _approximate(near, delta, x), 1 / near
    matrix = np.zeros((POINTS + 1, POINTS + 1))
    matrix[-1, :-1] = slope
    for _ in range(60):
        overlap = np.maximum(values, 0.0)
        force, stiffness = overlap**delta, delta * overlap ** (delta - 1)
        off = values - values.mean() - heavy @ force - inertia * (light @ force) + values[0]
        matrix[:-1, :-1] = np.eye(POINTS) - 1 / POINTS - (heavy + inertia * light) * stiffness
        matrix[:-1, 0] += 1
        matrix[:-1, -1] = -light @ force
        change = np.linalg.solve(matrix, np.append(off, slope @ values))
        size = max(np.abs(change[:-1]).max() / values.max(), abs(change[-1]) / inertia)
        change *= min(1.0, 0.2 / size)
        values, inertia = values - change[:-1], inertia - change[-1]
        if size < 1e-7:  # the next change is its square
            return float(1 / inertia), x, values
    raise InputError(
        [
            (
                "near",
                f"there is no wave that does not radiate near the mass ratio {near:g}: try another",
            )
        ]
    )


def _approximate(ratio: float, delta: float, x: Array) -> Array:
    """Return A for speed 1 from the pulse behind a strike, with the tail that it leaves cut off."""
    mass = np.where(np.arange(GRAINS) % 2 == 0, 1.0, ratio)

    def rate(_: float, state: Array) -> Array:
        force = np.maximum(-np.diff(state[:GRAINS]), 0.0) ** delta
        return np.append(state[GRAINS:], -np.diff(force, prepend=0.0, append=0.0) / mass)

    start = np.zeros(2 * GRAINS)
    start[GRAINS] = 1.0
    time = np.linspace(0, UNTIL, 3001)
    moved = solve_ivp(rate, (0, UNTIL), start, "DOP853", t_eval=time, rtol=1e-8, atol=1e-10).y[
        :GRAINS
    ]
    overlap = -np.diff(moved, axis=0)

    def centre(contact: int) -> float:
        force = np.maximum(overlap[contact], 0.0) ** delta
        begins = int(np.argmax(force > 0.3 * force.max()))
        pulse = slice(max(0, begins - 150), begins + 250)
        return float(force[pulse] @ time[pulse] / force[pulse].sum())

    first, second, fifth = (centre(CONTACT + n) for n in (0, 1, 4))
    speed = 4 / (fifth - first)
    middle = (first + second) / 2 - 1 / (2 * speed)  # A and its mirror image, half a grain apart
    place = speed * (middle - time)
    near = np.abs(x) < PERIOD / 4
    values = CubicSpline(place[::-1], overlap[CONTACT][::-1])(np.where(near, x, 0.0)) / speed ** (
        2 / (delta - 1)
    )
    return np.where(near, np.maximum(values, 0.0), 0.0)
