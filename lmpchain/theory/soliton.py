"""Solitary waves of the lattice, for any exponent, in the sonic vacuum and under a load.

Let r(x) be the overlap in excess of rest of a contact at x = n + 1/2 - c t, in grains, and N(r) its
force in excess of rest. Then ``c^2 r(x) = integral of (1 - |s|) N(r(x + s)) over -1 < s < 1``;
J. M. English and R. L. Pego, Proc. Am. Math. Soc. 133, 1763 (2005). This is equivalent to the
advance-delay equation ``c^2 r'' = N(r(x - 1)) - 2 N(r(x)) + N(r(x + 1))``. Its kernel is positive,
so that log r exists. Newton's method computes log r as a Chebyshev series, which makes relative
errors small in the tails, too. Far from the middle log r falls as ``-delta^|x|`` in the sonic
vacuum, and as ``-kappa |x|`` with ``sinh(kappa/2) = c kappa/2`` under a load.

Units. Under a load, the units are the overlap at rest, the mass of a grain, and the time tau of the
paper, in which sound travels one grain. In the sonic vacuum masses and contact constants are 1, and
the unit of velocity is arbitrary.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import roots_legendre

from ..chain.chain import Chain
from ..scene.excitation import Profile
from ..util.arrays import Array, check_flags
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish
from .domain import real, require
from .soliton_series import (
    SolitonSeries,
    coste_speed,
    kdv_overlap,
    law,
    long_wave_speed,
    nesterenko_overlap,
    nesterenko_speed,
    rows,
    sen_displacement,
    solve_series,
)

__all__ = [
    "Soliton",
    "coste_speed",
    "kdv_overlap",
    "nesterenko_overlap",
    "nesterenko_speed",
    "sen_displacement",
    "solve",
    "struck",
]

__dir__ = listed(__name__)

SLOWEST = 1.0001  # Smallest Mach number.
# Largest exponent; for larger ones contacts are so short that a series converges slowly.
HARDEST = 6.0


@dataclass(frozen=True, eq=False, repr=False)
class Soliton(Shown):
    """A solitary wave as a function of the distance x ahead of its middle, in grains.

    Attributes
    ----------
    delta : float
        Exponent of the contact force.
    loaded : bool
        Whether the chain is compressed at rest. The units depend on it, see the module.
    speed : float
        Speed c, grains per unit of time; under a load, the speed over the speed of sound.
    height : float
        Overlap by which exp(series) is multiplied.
    reach : float
        Largest ``|x|`` that the series covers.
    series : (K,) array
        Coefficients of log(overlap / height), see `lmpchain.theory.soliton_series`.
    residual : float
        Largest residual of the equation between the collocation points, over the largest overlap.
        In the tails it is at most 1e-8 of the local overlap.

    Examples
    --------
    >>> wave = solve(delta=1.5, velocity=1.0)
    >>> f"{wave.speed:.10f} {wave.width:.6f}", bool(wave.residual < 1e-12)
    ('0.9074700784 1.579137', True)
    """

    delta: float
    loaded: bool
    speed: float
    height: float
    reach: float
    series: Array
    residual: float

    def overlap(self, x: ArrayLike) -> Array:
        """Return the overlap in excess of rest of a contact at x; it is even in x."""
        logarithm = rows(real(x, "x"), self.series.size, self.reach, self.delta, self.loaded)
        return self.height * np.exp(logarithm @ self.series)

    def force(self, x: ArrayLike) -> Array:
        """Return the force in excess of rest of a contact at x."""
        return law(self.delta, self.loaded).force_change(self.overlap(x))

    def velocity(self, x: ArrayLike) -> Array:
        """Return the velocity of a grain at x, positive in the travel direction and even in x."""
        # The velocity is the integral of the force over one grain.
        s, weight = roots_legendre(96)
        return self.force(real(x, "x")[..., None] + s / 2) @ weight / (2 * self.speed)

    def displacement(self, x: ArrayLike) -> Array:
        """Return the displacement of a grain at x: 0 far ahead of the wave, largest behind it."""
        x = real(x, "x")
        far = np.ceil(self.reach) + 1
        # Contacts further behind are at rest again.
        nearest = x + 0.5 + np.ceil(np.maximum(-far - x - 0.5, 0.0))
        return self.overlap(nearest[..., None] + np.arange(2 * far + 2)).sum(-1)

    @property
    def energy(self) -> float:
        """Kinetic and contact energy in excess of rest."""
        grains = self._grains
        contact = law(self.delta, self.loaded).energy(self.overlap(grains + 0.5))
        return float((self.velocity(grains) ** 2 / 2 + contact).sum())

    @property
    def momentum(self) -> float:
        """Momentum of all grains."""
        return float(self.velocity(self._grains).sum())

    @property
    def width(self) -> float:
        """Full width at half maximum of the velocity, in grains."""
        half = float(self.velocity(0.0)) / 2
        return 2 * brentq(lambda x: float(self.velocity(x)) - half, 0.0, self.reach, xtol=1e-14)

    @property
    def _grains(self) -> Array:
        far = np.ceil(self.reach) + 1
        return np.arange(-far, far + 1)

    def on(self, chain: Chain, grain: float, downward: bool = True) -> Profile:
        """Return this wave on a chain at the time when it passes a grain, in SI units.

        In the sonic vacuum the largest grain velocity, in m/s, is the velocity given to `solve`.

        Parameters
        ----------
        chain : Chain
            A chain without gravity that is uniform around the wave.
        grain : float
            Position of the middle of the wave; 10.5 is between grains 10 and 11.
        downward : bool
            Whether the wave travels downward.

        Raises
        ------
        InputError
            If the chain has another exponent, gravity or a ground, if only the wave or only the
            chain is under a load, or if the chain is not uniform around the wave or too short.

        Examples
        --------
        >>> chain = Chain(grains=60, diameter=1e-3, gravity=0.0, top_load=1.0)
        >>> profile = solve(speed=1.2).on(chain, 30)
        >>> f"{profile.velocity.max():.4f} m/s"
        '5.2186 m/s'
        """
        # The grain and the contact at the wave define the units of mass, length and time.
        check_flags(downward=downward)
        first = self._first_contact(chain, grain)
        mass = float(chain.masses[first])
        contact = chain.contacts.of(first)
        if self.loaded:
            length = float(contact.overlap)
            time = np.sqrt(mass / float(contact.stiffness))
        else:
            # The unit of velocity is 1 m/s.
            length = (mass / float(contact.constant)) ** (1 / (1 + self.delta))
            time = length
        x = (np.arange(1, chain.grains + 1) - grain) * (1 if downward else -1)
        displacement = self.displacement(x) * length
        velocity = self.velocity(x) * (length / time)
        if not downward:
            # Grains below the wave do not move, because one of them may be fixed.
            displacement = self.displacement(-2 * self.reach) * length - displacement
            velocity = -velocity
        # Fixed grains do not follow the tail of the wave.
        displacement[chain.movable :] = 0.0
        velocity[chain.movable :] = 0.0
        return Profile(displacement=displacement, velocity=velocity)

    def _first_contact(self, chain: Chain, grain: float) -> int:
        """Return the number of the first contact in the wave if it fits the chain."""
        exponent = f"must have the exponent {self.delta:g} of the wave"
        gravity = "must be 0: contacts that stiffen with depth change a wave"
        load = "must be above 0 for a wave under a load, else 0"
        require(
            ("chain", chain.law.power == self.delta, exponent),
            ("chain.ground", chain.ground is None, "must be left out: it would change the wave"),
            ("gravity", chain.gravity == 0, gravity),
            ("top_load", chain.compressed == self.loaded, load),
        )
        # One grain beyond the point where the overlap is 1e-10 of the largest.
        highest = float(self.overlap(0.0))
        far = 1 + brentq(lambda x: float(self.overlap(x)) / highest - 1e-10, 0.0, 2 * self.reach)
        # Grains that only touch do not take part in a wave under a load.
        low = 1 + far + chain.loose_grains
        high = chain.movable - far
        fits = f"must lie from {low:.1f} to {high:.1f} for the wave to fit the chain"
        require(("grain", low <= grain <= high, fits))
        first = int(grain - far)
        last = int(np.ceil(grain + far))
        masses = chain.masses[first - 1 : last]
        constants = chain.contact_constants[first - 1 : last - 1]
        uneven = max(np.ptp(x) / x[0] for x in (masses, constants))
        uniform = f"must be uniform from grain {first} to {last}, where the wave is"
        require(("chain", uneven < 1e-9, uniform))
        return first

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw relative overlap, velocity and displacement against x; return the axes."""
        ax = chart(ax, "x − ct (grains)", "over the largest value")
        half = min(self.reach, 3.2 * self.width)
        x = np.linspace(-half, half, 401)
        for name in ("overlap", "velocity", "displacement"):
            values = getattr(self, name)(x)
            ax.plot(x, values / values.max(), label=f"{name}, at most {values.max():.5g}")
        formula = kdv_overlap if self.loaded else nesterenko_overlap
        name = "Korteweg-de Vries" if self.loaded else "Nesterenko"
        limit = formula(x, self.speed, self.delta) / self.overlap(0.0)
        ax.plot(x, limit, color="0.4", lw=1, ls="--", label=f"overlap, {name}")
        unit = " times sound" if self.loaded else ""
        return finish(ax, f"δ = {self.delta:g}, speed {self.speed:.7g}{unit}")


def solve(delta: float = 1.5, speed: float | None = None, velocity: float | None = None) -> Soliton:
    """Return the solitary wave of a speed (with load) or of a velocity (in the sonic vacuum).

    Parameters
    ----------
    delta : float
        Exponent of the contact force, above 1 and at most 6.
    speed : float
        Speed of a wave under a load over the speed of sound, 1.0001 or more. Weaker waves agree
        with `kdv_overlap` to 1 part in 4000.
    velocity : float
        Largest velocity of a grain in the sonic vacuum, in units in which mass and contact constant
        are 1. `Soliton.on` uses this number in m/s.

    Returns
    -------
    Soliton
        The wave as a function of position.

    Raises
    ------
    InputError
        If an argument is out of range, if not exactly one of speed and velocity is given, or if the
        wave cannot be resolved.

    Examples
    --------
    >>> f"{float(solve(delta=1.5, speed=1.1).overlap(0.0)):.8f}"
    '1.42131540'
    """
    single = (speed is None) != (velocity is None)
    fast = speed is None or 1 < speed < np.inf
    positive = velocity is None or 0 < velocity < np.inf
    require(
        _solvable(delta),
        ("speed", single, "must be given under a load, or velocity in the sonic vacuum"),
        ("speed", fast, f"must be above 1, that of sound (got {speed!r})"),
        ("velocity", positive, f"must be above 0 (got {velocity!r})"),
    )
    series = solve_series(float(delta), None if speed is None else float(speed))
    wave = _make_soliton(float(delta), speed is not None, series)
    if velocity is None:
        return wave
    # Waves of all velocities in the sonic vacuum are rescaled copies of the wave of speed 1.
    speed = (velocity / float(wave.velocity(0.0))) ** ((delta - 1) / (delta + 1))
    return replace(wave, speed=speed, height=speed ** (2 / (delta - 1)))


def _solvable(delta: float) -> tuple[str, bool, str]:
    """Return the rule that an exponent has solitary waves, and that a series resolves them."""
    fault = f"must be above 1, where waves are linear, and {HARDEST:g} or less (got {delta!r})"
    return "delta", 1 < delta <= HARDEST, fault


def struck(velocity: float, delta: float = 1.5) -> Soliton:
    """Return the solitary wave under a load whose largest grain velocity is given.

    Parameters
    ----------
    velocity : float
        Largest velocity of a grain, in overlaps at rest per unit of tau.
    delta : float
        Exponent of the contact force, above 1 and at most 6.

    Returns
    -------
    Soliton
        The wave as a function of position.

    Raises
    ------
    InputError
        If the velocity or delta is out of range.

    Examples
    --------
    >>> wave = struck(0.1)
    >>> f"{wave.speed:.6f} {float(wave.velocity(0.0)):.12f}"
    '1.008121 0.100000000000'
    """
    small = "is too small: use the Korteweg-de Vries limit"
    require(
        ("velocity", 0 < velocity < np.inf, f"must be above 0 (got {velocity!r})"),
        ("velocity", velocity > 0.1 * (SLOWEST - 1), small),
        _solvable(delta),
    )

    def excess(r: float) -> float:
        return r * float(long_wave_speed(real(r, "r"), delta)) - velocity

    # The long-wave speed of that overlap is close enough for Newton's method.
    # A strong wave has a speed of about the overlap to the power (delta - 1) / 2.
    lowest = 1e-4 * min(velocity, velocity ** (2 / (delta + 1)))
    overlap = brentq(excess, lowest, velocity)
    near = float(long_wave_speed(real(overlap, "overlap"), delta))
    require(("velocity", near > SLOWEST, small))
    return _make_soliton(float(delta), True, solve_series(float(delta), near, float(velocity)))


def _make_soliton(delta: float, loaded: bool, series: SolitonSeries) -> Soliton:
    return Soliton(
        delta,
        loaded,
        speed=series.speed,
        height=1.0,
        reach=series.reach,
        series=series.coefficients,
        residual=series.residual,
    )
