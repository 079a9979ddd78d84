"""Localisation and density of states of long random linear chains by transfer matrices.

In the chain m_n u_n'' = k_(n-1) (u_(n-1) - u_n) - k_n (u_n - u_(n+1)), Eq. (3) without its ends,
the ratio of the force below a grain to its displacement, z_n = k_n (u_n - u_(n+1)) / (m_n u_n),
follows from the ratio of the grain above. At the frequency omega

    u_(n+1) / u_n = 1 - z_n / a_n,    z_(n+1) = omega^2 + b_n z_n / (a_n - z_n),    a_n = k_n / m_n,
    b_n = k_n / m_(n+1)

so that no quantity grows with the length of the chain. The mean of log|u_(n+1) / u_n| is the
Lyapunov exponent, the inverse of the localisation length. The fraction of negative ratios is the
integrated density of states (F. J. Dyson, Phys. Rev. 92, 1331, 1953; H. Schmidt, Phys. Rev. 105,
425, 1957).

In a chain shorter than its localisation length, all waves end with about the same phase, log|u| and
number of nodes, so that the bias of the means would exceed their scatter. Therefore, at both ends,
the amplitude and the phase of the wave in the mean chain replace u and the number of nodes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..util.arrays import EPSILON, Array, numbers
from ..util.compilation import compiled_once
from ..util.notebook import Shown
from ..util.plotting import ERROR_BARS, Axes, chart
from ..util.progress import ProgressBar
from ..util.tabular import Tabular
from .draws import check, fault_of_whole

PIECE = 2**16  # Number of grains drawn at a time.
# Initial fraction of each chain that is ignored, because its ratios still depend on the top grain
# (analysis/calibration/transfer_matrices.py).
WARM_UP = 0.1
# Range of 2 - 2 cos(q), from rest to just below the band edge; q is the wave number in the mean
# chain.
EDGES = (1e-300, 3.96)


class Distribution(Protocol):
    """A frozen distribution of `scipy.stats`."""

    def rvs(self, *, size: int, random_state: np.random.Generator) -> Any:
        """Return `size` random values."""


@dataclass(frozen=True, eq=False, repr=False)
class Localisation(Shown, Tabular):
    """Lyapunov exponent of the waves in a random chain against frequency.

    Attributes
    ----------
    frequency : (F,) array
        Frequencies, rad/s.
    exponent, error : (F,) arrays
        Mean growth of log|u| from grain to grain; its standard error.
    """

    _units: ClassVar[dict[str, str]] = {"frequency": "rad/s", "exponent": "", "error": ""}

    frequency: Array
    exponent: Array
    error: Array

    @property
    def length(self) -> Array:
        """Localisation length, the inverse of the exponent, (F,) grains."""
        with np.errstate(divide="ignore"):
            return 1 / self.exponent

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the Lyapunov exponent with bars of two standard errors, and return the axes."""
        ax = chart(ax, "frequency (rad/s)", "Lyapunov exponent per grain", "xy")
        ax.errorbar(self.frequency, self.exponent, 2 * self.error, **ERROR_BARS)
        return ax


@dataclass(frozen=True, eq=False, repr=False)
class DensityOfStates(Shown, Tabular):
    """Integrated density of states of a random chain.

    Attributes
    ----------
    frequency : (F,) array
        Frequencies, rad/s.
    integrated, error : (F,) arrays
        Fraction of the modes below each frequency; its standard error.
    """

    _units: ClassVar[dict[str, str]] = {"frequency": "rad/s", "integrated": "", "error": ""}

    frequency: Array
    integrated: Array
    error: Array

    @property
    def density(self) -> Array:
        """Fraction of the modes per rad/s between each frequency and the next, (F-1,) s."""
        return np.diff(self.integrated) / np.diff(self.frequency)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the integrated density of states with two standard errors, and return the axes."""
        ax = chart(ax, "frequency (rad/s)", "share of the modes below")
        ax.errorbar(self.frequency, self.integrated, 2 * self.error, **ERROR_BARS)
        return ax


def lyapunov(
    frequency: ArrayLike,
    stiffness: float | Distribution = 1.0,
    masses: float | Distribution = 1.0,
    *,
    ratios: Distribution | None = None,
    grains: int = 100_000,
    chains: int = 16,
    seed: int = 0,
    progress: bool = False,
) -> Localisation:
    """Return the Lyapunov exponent, the inverse localisation length, of a random linear chain.

    Parameters
    ----------
    frequency : (F,) array_like
        Angular frequencies, rad/s.
    stiffness, masses : float or distribution
        Stiffness of contacts, N/m, and masses of grains, kg: a number, or a frozen distribution of
        `scipy.stats` from which each value is drawn.
    ratios : distribution, optional
        Distribution of all k_n / m_n and k_n / m_(n+1), 1/s2, as in Dyson's exactly solvable chain.
        It replaces stiffness and masses.
    grains, chains : int
        Number of grains in each chain; number of chains, whose scatter gives the error.
    seed : int
        Seed of the random numbers, 0 or more; the same seed gives the same bits.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Localisation
        The exponent per grain at each frequency, with its error.

    Raises
    ------
    InputError
        If an option is wrong, or if a drawn stiffness or mass is not above 0.

    Examples
    --------
    Weak disorder localises waves over 8 <1/k> / (omega^2 Var(1/k)) grains; here Var(1/k) = 1/4 and
    <1/k> = 1:

    >>> from scipy.stats import gamma
    >>> waves = lyapunov([0.1], gamma(6, scale=1 / 5), chains=100, seed=1)
    >>> law = 0.1**2 * (1 / 4) / 8
    >>> bool(abs(waves.exponent[0] - law) < 3 * waves.error[0] < 0.2 * law)
    True
    """
    omega, growth, _ = _transfer(
        frequency, stiffness, masses, ratios, grains, chains, seed, progress
    )
    exponent, error = _mean(growth)
    # In chains far shorter than a localisation length the mean may scatter below 0.
    return Localisation(omega, np.maximum(exponent, 0.0), error)


def density_of_states(
    frequency: ArrayLike,
    stiffness: float | Distribution = 1.0,
    masses: float | Distribution = 1.0,
    *,
    ratios: Distribution | None = None,
    grains: int = 100_000,
    chains: int = 16,
    seed: int = 0,
    progress: bool = False,
) -> DensityOfStates:
    """Return the integrated density of states of a random linear chain.

    Arguments and errors are as for `lyapunov`.

    Parameters
    ----------
    frequency : (F,) array_like
        Angular frequencies, rad/s.
    stiffness, masses : float or distribution
        As for `lyapunov`.
    ratios : distribution, optional
        As for `lyapunov`.
    grains, chains, seed : int
        As for `lyapunov`.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    DensityOfStates
        The fraction of the modes below each frequency, with its error.

    Examples
    --------
    Dyson's chain with exponential ratios, compared with his exact result:

    >>> from scipy.stats import expon
    >>> from lmpchain.theory import dyson
    >>> states = density_of_states([1.0, 2.0], ratios=expon(), grains=20_000, seed=1)
    >>> bool((abs(states.integrated - dyson.integrated([1.0, 2.0], 1)) < 4 * states.error).all())
    True
    """
    omega, _, nodes = _transfer(
        frequency, stiffness, masses, ratios, grains, chains, seed, progress
    )
    share, error = _mean(nodes)
    return DensityOfStates(omega, np.clip(share, 0.0, 1.0), error)


def _transfer(
    frequency: ArrayLike,
    stiffness: float | Distribution,
    masses: float | Distribution,
    ratios: Distribution | None,
    grains: int,
    chains: int,
    seed: int,
    progress: bool,
) -> tuple[Array, Array, Array]:
    """Return frequencies (F,), and growth and nodes per grain of each chain, (R, F)."""
    omega = np.atleast_1d(numbers(frequency, "frequency"))
    valid = omega.ndim == 1 and omega.size and (omega >= 0).all() and np.isfinite(omega).all()
    check(
        None if valid else ("frequency", "must be finite numbers from 0, in rad/s"),
        fault_of_whole("grains", grains, 100),
        fault_of_whole("chains", chains, 2),
        fault_of_whole("seed", seed, 0),
    )
    warm_up = int(WARM_UP * grains)
    growth, nodes = np.zeros((2, chains, omega.size))
    with ProgressBar(chains * grains, "transfer matrices", " grains", shown=progress) as bar:
        for chain in range(chains):
            # The first grain is accelerated only by the force below it.
            z = omega**2
            begin = z
            position = 0
            slowness = 0.0
            rng = np.random.default_rng([seed, chain])
            for a, b in _pieces(stiffness, masses, ratios, grains, rng):
                slowness += (1 / a).sum()
                # Grains of the warm-up advance z, but their growth is discarded.
                skip = min(max(warm_up - position, 0), a.size)
                _pass(a[:skip], b[:skip], omega**2, z, np.empty(omega.size), np.empty(omega.size))
                if position <= warm_up < position + a.size:
                    begin = z.copy()
                _pass(a[skip:], b[skip:], omega**2, z, growth[chain], nodes[chain])
                position += a.size
                bar.reach(chain * grains + position)
            before, after = (_wave(x, omega**2, slowness / grains) for x in (begin, z))
            growth[chain] += after[0] - before[0]
            nodes[chain] += (after[1] - before[1]) / np.pi
    return omega, growth / (grains - warm_up), nodes / (grains - warm_up)


def _wave(z: Array, omega2: Array, slowness: float) -> tuple[Array, Array]:
    """Return log(A / |u|) and the phase phi of the wave in the mean chain.

    In the mean chain ``u_n = A cos(q n + phi)``, so that
    ``u_n^2 + t^2 - 2 cos(q) u_n t = A^2 sin(q)^2`` with ``t = u_(n+1)``.

    Parameters
    ----------
    z, omega2 : (F,) arrays
        Force below a grain divided by its mass and displacement, 1/s2; square of the frequency,
        1/s2.
    slowness : float
        Mean of m_n / k_n, s2.
    """
    # 2 - 2 cos(q) is limited to its value below the band edge; localised waves beyond it are short,
    # and their phase is irrelevant.
    turn = np.clip(omega2 * slowness, EDGES[0], EDGES[1])
    # The slope is 1 - t / u_n.
    slope = z * slowness
    amplitude = np.log(slope**2 + turn * (1 - slope)) / 2
    phase = np.arctan((slope - turn / 2) / np.sqrt(turn * (1 - turn / 4)))
    return amplitude, phase


def _pieces(
    stiffness: float | Distribution,
    masses: float | Distribution,
    ratios: Distribution | None,
    grains: int,
    rng: np.random.Generator,
) -> Iterator[tuple[Array, Array]]:
    """Yield k_n / m_n and k_n / m_(n+1) of a chain, piece by piece."""
    # The last grain of a piece is the first grain of the next piece.
    mass = _draw("masses", masses, 1, rng)
    for first in range(0, grains, PIECE):
        size = min(PIECE, grains - first)
        if ratios is not None:
            yield _draw("ratios", ratios, size, rng), _draw("ratios", ratios, size, rng)
            continue
        k = _draw("stiffness", stiffness, size, rng)
        mass = np.append(mass[-1], _draw("masses", masses, size, rng))
        yield k / mass[:-1], k / mass[1:]


def _draw(key: str, law: float | Distribution, size: int, rng: np.random.Generator) -> Array:
    """Return values of a number or a distribution, (size,)."""
    if isinstance(law, int | float | np.number):
        values = np.full(size, float(law))
    elif hasattr(law, "rvs"):
        values = np.asarray(law.rvs(size=size, random_state=rng), float)
    else:
        name = type(law).__name__
        message = f"must be a number or a distribution of scipy.stats (got a {name})"
        raise InputError.at(key, message)
    if not (values > 0).all() or not np.isfinite(values).all():
        message = "all values must be finite and above 0: use a positive number or distribution"
        raise InputError.at(key, message)
    return values


@compiled_once("transfer matrices", 2, error_model="numpy")
def _pass(a: Array, b: Array, omega2: Array, z: Array, growth: Array, nodes: Array) -> None:
    """Advance z through a piece of chain at every frequency, and add up growth and nodes."""
    for f in range(omega2.size):
        ratio = z[f]
        product = 1.0
        total = 0.0
        count = 0
        for n in range(a.size):
            step = 1.0 - ratio / a[n]
            # A node on a grain, within rounding errors.
            if abs(step) < EPSILON:
                step = EPSILON
            count += step < 0
            # One logarithm serves many factors, because a logarithm for each factor would dominate
            # the cost.
            product *= abs(step)
            if product > 1e100 or product < 1e-100:
                total += math.log(product)
                product = 1.0
            ratio = omega2[f] + b[n] / a[n] * ratio / step
        z[f] = ratio
        growth[f] += total + math.log(product)
        nodes[f] += count


def _mean(values: Array) -> tuple[Array, Array]:
    """Return the mean over chains and its standard error, (F,)."""
    return values.mean(0), values.std(0, ddof=1) / math.sqrt(len(values))
