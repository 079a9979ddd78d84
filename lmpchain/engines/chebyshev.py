"""The exact propagator of the linearised chain as a sum of Chebyshev polynomials, without eigenvectors.

For ``phi'' = -L phi`` and any ``w`` of at least the highest frequency, with ``T_k`` the Chebyshev polynomials of
``1 - 2 L / w^2`` and ``W_k`` the sums ``T_0 + 2 (T_1 + ... + T_k)``,

    phi(t) = J_0 phi + sum J_2k 2 T_k phi + (2/w) sum J_(2k+1) W_k v
    v(t)   = J_0 v   + sum J_2k 2 T_k v   - (2/w) sum J_(2k+1) W_k L phi            (Bessel functions of w t)

which is Eq. (19) of the paper for any chain and both kinds of initial data. ``2 T_(k+1) = 2 T_k - (4/w^2) L W_k`` and
``W_(k+1) = W_k + 2 T_(k+1)``: a leapfrog of steps 2/w, so each term reaches one grain further and grains outside the
light cone are never touched. Tal-Ezer and Kosloff, J. Chem. Phys. 81, 3967 (1984), for the idea.
"""

from __future__ import annotations

import math

import numpy as np

from ..compiling import compiled_once
from ..fields import Array

NEWS = "the Chebyshev series", 5
NEGLIGIBLE = 1e-25  # of the largest: grains that move less are not yet reached


def terms(z: float) -> int:
    """Return how many polynomials are needed for ``w t = z``; what is left out is below 1e-16."""
    return math.ceil(z / 2 + 5.4 * z ** (1 / 3) + 6)


@compiled_once(*NEWS)
def bessel(z, orders):
    """Return J_0(z) ... J_(orders-1)(z) by Miller's backward recurrence, whose sum rule gives the scale."""
    start = orders + int(20 + 10 * z ** (1 / 3) + max(0.0, z - orders))
    start += start % 2
    values = np.zeros(orders)
    above, here, total = 0.0, 1e-300, 0.0
    for n in range(start, 0, -1):
        if n < orders:
            values[n] = here
        if n % 2 == 0:
            total += 2 * here
        above, here = here, 2 * n / z * here - above
        if abs(here) > 1e250:
            above, here, total = above * 1e-250, here * 1e-250, total * 1e-250
            values *= 1e-250
    values[0] = here
    return values / (total + here)


@compiled_once(*NEWS, error_model="numpy", fastmath={"nnan", "ninf", "nsz"})
def series(x, stiffness, mobility, oscillator, scale, weights, reach):
    """Return ``cos(sqrt(L) t) x`` and ``sin(sqrt(L) t) / sqrt(L) x`` for grains whose neighbours do not move.

    Parameters
    ----------
    x : (n,) array, zero but for reach[0] ... reach[1]-1
    stiffness, mobility : (n+1,) and (n,) arrays, N/m and 1/kg
    oscillator : square of the frequency of the first grain, 1/s2, 0 if it is none
    scale : w, 1/s
    weights : (2K+1,) array, J_0(w t) ... J_2K(w t)
    """
    count = x.size
    first, last = reach
    tiny = NEGLIGIBLE * np.abs(x).max()
    double, total = 2 * x, np.zeros(count + 2)  # 2 T_k x, and W_k x between two grains that stand still
    total[1:-1] = x
    cos, sin = weights[0] * x, weights[1] * x
    pull = 4 / (scale * scale) * mobility
    for k in range(1, weights.size // 2 + 1):
        even, odd = weights[2 * k], weights[2 * k + 1] if 2 * k + 1 < weights.size else 0.0
        # one grain further, but no further than there is motion: beyond are numbers so small that they are slow
        first, last = max(first - 1, 0), min(last + 1, count)
        double[0] -= 4 * oscillator / (scale * scale) * total[1]
        d, w, c, s = double[first:last], total[first : last + 2], cos[first:last], sin[first:last]
        p, q = pull[first:last], stiffness[first : last + 1]
        for n in range(d.size):
            d[n] -= p[n] * (q[n] * (w[n + 1] - w[n]) - q[n + 1] * (w[n + 2] - w[n + 1]))
            c[n] += even * d[n]
        for n in range(d.size):
            w[n + 1] += d[n]
            s[n] += odd * w[n + 1]
        while last > first and abs(double[last - 1]) < tiny and abs(total[last]) < tiny:
            last -= 1
            double[last], total[last + 1] = 0.0, 0.0
        while last > first and abs(double[first]) < tiny and abs(total[first + 1]) < tiny:
            double[first], total[first + 1] = 0.0, 0.0
            first += 1
    return cos, 2 / scale * sin


@compiled_once(*NEWS, error_model="numpy")
def _forward(u, v, stiffness, mobility, oscillator, scale, weights, reach):
    """Move u and v (n,) forward in place and return between which grains there is motion then."""
    moved = u.any()
    cos, sin = series(v, stiffness, mobility, oscillator, scale, weights, reach)
    if moved:
        cos_u, sin_u = series(u, stiffness, mobility, oscillator, scale, weights, reach)
        pull = np.empty(u.size)  # L sin_u
        above = stiffness[0] * sin_u[0]
        for n in range(u.size):
            ahead = sin_u[n + 1] if n + 1 < u.size else 0.0
            below = stiffness[n + 1] * (ahead - sin_u[n])
            pull[n] = mobility[n] * (above - below)
            above = below
        pull[0] += oscillator * sin_u[0]
        cos, sin = cos - pull, sin + cos_u
    u[:], v[:] = sin, cos
    return moving(u, v)


@compiled_once(*NEWS)
def moving(u, v):
    """Return the first and the one after the last grain that moves, and put those beyond to rest."""
    least_u, least_v = NEGLIGIBLE * np.abs(u).max(), NEGLIGIBLE * np.abs(v).max()
    first, last = 0, u.size
    while first < last and abs(u[first]) <= least_u and abs(v[first]) <= least_v:
        first += 1
    while last > first and abs(u[last - 1]) <= least_u and abs(v[last - 1]) <= least_v:
        last -= 1
    u[:first] = 0.0
    v[:first] = 0.0
    u[last:] = 0.0
    v[last:] = 0.0
    return first, last


class Propagator:
    """A linear chain that is moved forward by any time at once.

    Parameters
    ----------
    stiffness : (N+1,) array
        Of every contact, walls included, N/m.
    mobility : (N,) array
        1/m of every grain, 0 for one that is held or driven, 1/kg.
    drive : float
        Frequency of grain 1 if it is driven, rad/s, else 0.
    u, v : (N,) arrays
        Displacement and velocity, m and m/s; changed in place.
    """

    def __init__(self, stiffness: Array, mobility: Array, drive: float, u: Array, v: Array):
        self._stiffness, self._mobility = stiffness, mobility
        self._drive = drive  # grain 1 is then an oscillator that pulls the others and is not pulled
        self._squares = 2 * (stiffness[:-1] + stiffness[1:]) * mobility  # bounds on frequencies (Gershgorin)
        self._squares[0] = max(self._squares[0], drive**2)
        self.u, self.v = u, v
        self.terms = 0
        self.first, self.last = moving(u, v)
        nothing = np.zeros(1)  # only compiles, so that it is not timed as work
        _forward(nothing, nothing.copy(), np.zeros(2), nothing, 0.0, 1.0, bessel(1.0, 3), (0, 0))

    def advance(self, dt: float) -> None:
        """Move forward by dt, s."""
        if self.last <= self.first:
            return
        count, first, last = 0, self.first, self.last
        while True:  # a wider reach may hold stiffer contacts, which take more terms
            scale = math.sqrt(self._squares[first:last].max()) or 1.0
            needed = terms(scale * dt)
            if needed <= count:
                break
            count = needed
            first, last = max(self.first - count, 0), min(self.last + count, self.u.size)
        here = slice(first, last)
        reached = _forward(
            self.u[here],
            self.v[here],
            self._stiffness[first : last + 1],
            self._mobility[here],
            self._drive**2 if first == 0 else 0.0,
            scale,
            bessel(scale * dt, 2 * count + 1),
            (self.first - first, self.last - first),
        )
        self.first, self.last = first + reached[0], first + reached[1]
        self.terms += count
