"""The exact propagator of the linearised chain as a sum of Chebyshev polynomials.

For ``phi'' = -L phi`` and any ``w`` of at least the highest frequency, with ``T_k`` the Chebyshev polynomials of
``1 - 2 L / w^2`` and ``W_k`` the sums ``T_0 + 2 (T_1 + ... + T_k)``,

    phi(t) = J_0 phi + sum J_2k 2 T_k phi + (2/w) sum J_(2k+1) W_k v
    v(t)   = J_0 v   + sum J_2k 2 T_k v   - w J_1 phi + (w/2) sum (J_(2k-1) - J_(2k+1)) 2 T_k phi

with Bessel functions of w t, which is Eq. (19) of the paper for any chain and both kinds of initial data. ``2 T_(k+1) =
2 T_k - (4/w^2) L W_k`` and ``W_(k+1) = W_k + 2 T_(k+1)``: a leapfrog of steps 2/w, so each term reaches one grain
further and grains outside the light cone are never touched. Tal-Ezer and Kosloff, J. Chem. Phys. 81, 3967 (1984), for
the idea.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from ...util.compilation import compiled_once
from .contact_forces import compiled

NEWS = "the Chebyshev series", 8
NEGLIGIBLE = 1e-25  # of the largest: grains that move less are not yet reached
LEAST = 1e-18  # a polynomial with a smaller weight changes nothing
CHUNK = 64  # polynomials that are held at a time
SPAN = 10.0  # w t for which one series serves all times in between
TINY = 1e-20  # J_0 of less is 1, and all others make no difference


@compiled
def _largest(x):
    """Return the largest |x| of an array in one dimension."""
    largest = 0.0
    for n in range(x.size):
        largest = max(largest, abs(x[n]))
    return largest


@compiled_once(*NEWS)
def terms(z):
    """Return how many polynomials are needed for ``w t = z``; what is left out is below 1e-16."""
    return math.ceil(z / 2 + 5.4 * z ** (1 / 3) + 6)


@compiled_once(*NEWS, error_model="numpy")
def bessel(z, orders):
    """Return J_0(z) ... J_(orders-1)(z), (orders, T), by Miller's backward recurrence.

    More orders than the largest z.
    """
    start = orders + int(20 + 10 * _largest(z) ** (1 / 3))
    start += start % 2
    values = np.zeros((orders, z.size))
    above, here, total, place = (
        np.zeros(z.size),
        np.full(z.size, 1e-300),
        np.zeros(z.size),
        np.empty(z.size),
    )
    for i in range(z.size):
        place[i] = max(z[i], TINY)
    for n in range(start, 0, -1):
        if n < orders:
            for i in range(z.size):
                values[n, i] = here[i]
        if n % 2 == 0:
            for i in range(z.size):
                total[i] += 2 * here[i]
        largest = 0.0
        for i in range(z.size):
            below = 2 * n / place[i] * here[i] - above[i]
            above[i], here[i] = here[i], below
            largest = max(largest, abs(below))
        if largest > 1e250:
            for i in range(z.size):
                if abs(here[i]) > 1e200:
                    above[i], here[i], total[i] = (
                        above[i] * 1e-250,
                        here[i] * 1e-250,
                        total[i] * 1e-250,
                    )
                    for order in range(n, orders):
                        values[order, i] *= 1e-250
    for i in range(z.size):
        values[0, i], total[i] = here[i], total[i] + here[i]
    for n in range(orders):
        for i in range(z.size):
            values[n, i] /= total[i]
    return values


@compiled_once(*NEWS, error_model="numpy", fastmath={"nnan", "ninf", "nsz"})
def series(x, stiffness, mobility, oscillator, scale, of_t, of_w, reach):
    """Return sums of ``T_0 x, 2 T_1 x ...`` with weights of_t (S, K), of ``W_0 x, W_1 x ...`` with of_w.

    Parameters
    ----------
    x : (n,) array, zero but for reach[0] ... reach[1]-1
    stiffness, mobility : (n+1,) and (n,) arrays, N/m and 1/kg
    oscillator : square of the frequency of the first grain, 1/s2, 0 if it is none
    scale : w, 1/s
    """
    grains, orders = x.size, of_t.shape[1]
    first, last = reach
    tiny = NEGLIGIBLE * _largest(x)
    double, total = (
        np.empty(grains),
        np.zeros(grains + 2),
    )  # 2 T_k x, and W_k x between two grains that stand still
    most, pull = min(orders, CHUNK), np.empty(grains)
    ts, ws = np.zeros((most, grains)), np.zeros((most, grains))
    for n in range(grains):
        double[n], total[n + 1], ts[0, n], ws[0, n] = 2 * x[n], x[n], x[n], x[n]
        pull[n] = 4 / (scale * scale) * mobility[n]
    sum_t, sum_w = np.zeros((of_t.shape[0], grains)), np.zeros((of_w.shape[0], grains))
    for k in range(orders):
        here = k % most
        if (
            k > 0
        ):  # one grain further, but not beyond all motion, where numbers are so small that they are slow
            first, last = max(first - 1, 0), min(last + 1, grains)
            double[0] -= 4 * oscillator / (scale * scale) * total[1]
            d, w, t = double[first:last], total[first : last + 2], ts[here, first:last]
            p, q = pull[first:last], stiffness[first : last + 1]
            for n in range(d.size):
                d[n] -= p[n] * (q[n] * (w[n + 1] - w[n]) - q[n + 1] * (w[n + 2] - w[n + 1]))
                t[n] = d[n]
            s = ws[here, first:last]
            for n in range(d.size):
                w[n + 1] += d[n]
                s[n] = w[n + 1]
            while last > first and abs(double[last - 1]) < tiny and abs(total[last]) < tiny:
                last -= 1
                double[last], total[last + 1] = 0.0, 0.0
            while last > first and abs(double[first]) < tiny and abs(total[first + 1]) < tiny:
                double[first], total[first + 1] = 0.0, 0.0
                first += 1
        if here == most - 1 or k == orders - 1:
            sum_t += np.ascontiguousarray(of_t[:, k - here : k + 1]) @ ts[: here + 1]
            if of_w.shape[0]:
                sum_w += np.ascontiguousarray(of_w[:, k - here : k + 1]) @ ws[: here + 1]
            ts[:], ws[:] = 0.0, 0.0
    return sum_t, sum_w


@compiled_once(*NEWS)
def moving(u, v):
    """Return the first and the one after the last grain that moves, and put those beyond to rest."""
    least_u, least_v = NEGLIGIBLE * _largest(u), NEGLIGIBLE * _largest(v)
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


@compiled_once(*NEWS, error_model="numpy")
def _weights(scale, times, now):
    """Return weights of ``T_k phi``, (2 T, K+1), and of ``W_k v``, (T, K+1).

    The first are those in phi and, below these, those in v; the second are in phi.
    """
    z = np.empty(times.size)
    for i in range(times.size):
        z[i] = scale * (times[i] - now)
    table = bessel(z, 2 * terms(z[-1]) + 2)
    orders = table.shape[0]
    while orders > 4 and max(_largest(table[orders - 2]), _largest(table[orders - 1])) < LEAST:
        orders -= 2
    many, of_t, of_w = (
        times.size,
        np.empty((2 * times.size, orders // 2)),
        np.empty((times.size, orders // 2)),
    )
    for k in range(orders // 2):
        for i in range(many):
            of_t[i, k], of_w[i, k] = table[2 * k, i], 2 / scale * table[2 * k + 1, i]
            if k == 0:
                of_t[many + i, k] = -scale * table[1, i]
            else:
                of_t[many + i, k] = scale / 2 * (table[2 * k - 1, i] - table[2 * k + 1, i])
    return of_t, of_w


@compiled_once(*NEWS, error_model="numpy")
def _march(u, v, stiffness, mobility, oscillator, squares, reach, times, us, vs, reached):
    """Move u and v (n,) through the times and keep them in us and vs (T, n); return the terms it took."""
    first, last = reach
    now, begin, spent = 0.0, 0, 0
    while begin < times.size:
        a, b, end, scale = first, last, begin, -1.0
        while b > a:  # a wider reach may hold stiffer contacts, which take more terms
            needed = max(math.sqrt(_largest(squares[a:b])), 1e-300)
            if needed <= scale:
                break
            scale, end = needed, begin + 1
            while end < times.size and scale * (times[end] - now) < SPAN:
                end += 1
            of_t, of_w = _weights(scale, times[begin:end], now)
            count = of_w.shape[1] - 1
            a, b = max(first - count, 0), min(last + count, u.size)
        if b == a:
            return spent
        chain = stiffness[a : b + 1], mobility[a:b], (oscillator if a == 0 else 0.0), scale
        new_v, new_u = series(v[a:b], *chain, of_t[: end - begin], of_w, (first - a, last - a))
        if _largest(u[first:last]) > 0.0:
            more, _ = series(u[a:b], *chain, of_t, of_w[:0], (first - a, last - a))
            for i in range(end - begin):
                for n in range(b - a):
                    new_u[i, n] += more[i, n]
                    new_v[i, n] += more[end - begin + i, n]
        for i in range(end - begin):
            for n in range(b - a):
                us[begin + i, a + n], vs[begin + i, a + n] = new_u[i, n], new_v[i, n]
            reached[begin + i, 0], reached[begin + i, 1] = a, b
        for n in range(a, b):
            u[n], v[n] = us[end - 1, n], vs[end - 1, n]
        now, begin = times[end - 1], end
        first, last = moving(u[a:b], v[a:b])
        first, last = first + a, last + a
        spent += count
    return spent


class Propagator:
    """A linear chain that is moved forward.

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
        # grain 1, if driven, is an oscillator that pulls the others and is not pulled
        squares = (
            2 * (stiffness[:-1] + stiffness[1:]) * mobility
        )  # bounds on frequencies (Gershgorin)
        squares[0] = max(squares[0], drive**2)
        self._chain = (
            np.array(stiffness),
            mobility,
            drive**2,
            squares,
        )  # loops for what is read-only are others
        self.u, self.v = u, v
        self.terms = 0
        self._reach = moving(u, v)

    def advance(self, times: Array) -> tuple[Array, Array, NDArray[np.intp]]:
        """Move forward by these times, (T,) s, 0 or later and later ones.

        Returns
        -------
        displacements and velocities then, (T, N), and the first and the one after the last grain that moves, (T, 2)
        """
        us, vs = np.zeros((2, times.size, self.u.size))
        reached = np.zeros((times.size, 2), np.intp)
        self.terms += _march(self.u, self.v, *self._chain, self._reach, times, us, vs, reached)
        self._reach = moving(self.u, self.v)
        return us, vs, reached
