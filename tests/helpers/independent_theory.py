"""Independent results for the theory: a general integrator, mpmath, and finite differences."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import mpmath as mp
import numpy as np
from numpy.polynomial import Chebyshev
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from lmpchain import Chain

Array = NDArray[np.float64]


def springs(kappa: Array, masses: Array | None = None) -> Chain:
    """Return a chain with linear stiffnesses kappa, unit masses and a fixed last grain."""
    grains = len(kappa) + 1
    return Chain(
        grains=grains,
        diameter=1e9,
        gravity=1e-6,
        exponent=1.0,
        masses=np.ones(grains) if masses is None else masses,
        contact_constants=kappa,
    )


def dense_modes(chain: Chain) -> tuple[Array, Array]:
    """Return the squared frequencies and vectors of the modes by a dense eigenvalue solver."""
    diagonal, coupling = chain.dynamical_matrix()
    return np.linalg.eigh(np.diag(diagonal) + np.diag(coupling, 1) + np.diag(coupling, -1))


def gravity_column(movable: int, delta: float = 1.5) -> Array:
    """Return kappa_1 ... kappa_M of Eq. (3)."""
    return np.arange(1.0, movable + 1) ** (1 - 1 / delta)


def integrate(
    kappa: Array, displacement: Array, velocity: Array, tau: Array, masses: Array | float = 1.0
) -> tuple[Array, Array]:
    """Solve Eq. (3) with the last grain fixed; return displacement and velocity (T, M) to 1e-12."""
    count = len(kappa)

    def rate(_: float, y: Array) -> Array:
        force = np.zeros(count + 1)
        force[1:count] = kappa[:-1] * (y[1:count] - y[: count - 1])
        force[count] = -kappa[-1] * y[count - 1]
        return np.concatenate((y[count:], (force[1:] - force[:-1]) / masses))

    start = np.concatenate((np.broadcast_to(displacement, count), np.broadcast_to(velocity, count)))
    done = solve_ivp(rate, (0, tau[-1]), start, method="DOP853", t_eval=tau, rtol=3e-14, atol=1e-16)
    return done.y[:count].T, done.y[count:].T


def unit(count: int, k: int) -> Array:
    """Return an array (count,) with 1 at grain k and 0 elsewhere."""
    return (np.arange(1, count + 1) == k).astype(float)


def largest(function: Callable[[Array], Array], low: float, high: float) -> float:
    """Return the largest value of a smooth function between two places.

    The function is interpolated by a polynomial through 21 points.
    """
    fit = Chebyshev.interpolate(function, 20, (low, high))
    turns = fit.deriv().roots()
    inside = turns[(abs(turns.imag) < 1e-9) & (turns.real > low) & (turns.real < high)].real
    return float(fit(inside).max())


def derivatives(
    function: Callable[[Array], Array], x: float, step: float
) -> tuple[complex, complex]:
    """Return the first two derivatives by differences of eighth order."""
    samples = function(x + step * np.arange(-4, 5))
    first = np.array([3, -32, 168, -672, 0, 672, -168, 32, -3]) / 840
    second = np.array([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9]) / 5040
    return first @ samples / step, second @ samples / step**2


def residual_of_27(
    phi: Callable[[Array, Array], Array], h: float, tau: float, delta: float, step: float = 0.02
) -> float:
    """Return the residual of phi(h, tau) in Eq. (27), relative to its largest term."""
    xi = 1 - 1 / delta
    slope, bend = derivatives(lambda x: phi(x, np.array(tau)), h, step)
    _, push = derivatives(lambda t: phi(np.array(h), t), tau, step)
    terms = h**xi * bend, xi * h ** (xi - 1) * slope, -push
    return abs(sum(terms)) / max(map(abs, terms))


def superposition(h: float, tau: float, delta: float, power: float) -> complex:
    """Return Eq. (31) for A = lambda^-power by mpmath along the imaginary axis."""
    with mp.workdps(20):
        d = mp.mpf(delta)
        h = mp.mpf(h)
        tau = mp.mpf(tau)
        power = mp.mpf(power)
        nu = 1 / (1 + d)
        chi = 2 / (1 + 1 / d) * h ** ((1 + 1 / d) / 2)

        # The substitution y = x^20 removes the singularity at 0.
        def integrand(x: mp.mpf) -> mp.mpf:
            y = x**20
            return 20 * x**19 * y**-power * mp.besselk(nu, chi * y) * mp.exp(-tau * y)

        # The integrand is positive, and smooth except at 0, so a few nodes give full precision.
        nodes, weights = np.polynomial.legendre.leggauss(24)
        total = mp.quad(integrand, [0, 0.5])
        for low, high in pairwise((0.5, 0.65, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3)):
            places = (low + high + (high - low) * nodes) / 2
            values = [integrand(mp.mpf(x)) for x in places]
            total += (high - low) / 2 * mp.fdot(weights, values)
        return complex(
            h ** (1 / (2 * d)) * 2 / mp.pi * mp.exp(-0.5j * mp.pi * (nu + power)) * total
        )
