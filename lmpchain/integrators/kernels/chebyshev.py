"""The exact propagator of the linearised chain as a sum of Chebyshev polynomials.

The equation of motion is ``phi'' = -L phi``, and w is the highest frequency or an upper bound on
it, rad/s. With the Chebyshev polynomials ``T_k`` of the matrix ``1 - 2 L / w^2``, and the sums
``W_k = T_0 + 2 (T_1 + ... + T_k)``, the displacements and velocities at time t are

    phi(t) = J_0 phi + sum J_2k 2 T_k phi + (2/w) sum J_(2k+1) W_k v
    v(t)   = J_0 v   + sum J_2k 2 T_k v   - w J_1 phi + (w/2) sum (J_(2k-1) - J_(2k+1)) 2 T_k phi

with Bessel functions of w t and the initial values phi and v. These formulas extend Eq. (19) of the
paper to any chain and any initial values.

The recurrence ``2 T_(k+1) = 2 T_k - (4/w^2) L W_k``, ``W_(k+1) = W_k + 2 T_(k+1)`` is a leapfrog
scheme with steps 2/w. Each term reaches one grain further, so that grains outside the light cone
are never computed.

Source: Tal-Ezer and Kosloff, J. Chem. Phys. 81, 3967 (1984).
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from ...util.compilation import compiled_once
from .compiling import STRICT, compiled

SPAN = 10.0  # Largest w t covered by one series.


class SeriesLimits(NamedTuple):
    """Thresholds below which terms of a series are negligible, and its block size.

    Attributes
    ----------
    motion : float
        Fraction of the largest motion below which the motion of a grain is set to 0.
    weight : float
        Weight below which a polynomial is negligible.
    argument : float
        Argument below which J_0 is 1 and all other Bessel functions are negligible.
    chunk : int
        Number of polynomials that are stored at a time.
    """

    motion: float = 1e-25
    weight: float = 1e-18
    argument: float = 1e-20
    chunk: int = 64


SERIES_LIMITS = SeriesLimits()
compiled_series = partial(compiled_once, "the Chebyshev series", 8, error_model="numpy")


class LinearChain(NamedTuple):
    """Grains n and the contacts around them, n+1.

    Attributes
    ----------
    stiffness : (n+1,) array
        Stiffness of every contact, including walls, N/m.
    mobility : (n,) array
        Inverse mass of every grain, 1/kg; 0 for a grain that is held or driven.
    oscillator : float
        Square of the angular frequency of a driven first grain, 1/s2; 0 if it is not driven.
    """

    stiffness: Array
    mobility: Array
    oscillator: float


class Answers(NamedTuple):
    """Displacements and velocities at T times, (T, N), and the range of grains reached, (T, 2)."""

    u: Array
    v: Array
    reached: NDArray[np.intp]


@compiled
def _largest(x):
    """Return the largest |x| of an array in one dimension."""
    largest = 0.0
    for n in range(x.size):
        largest = max(largest, abs(x[n]))
    return largest


@compiled_series()
def terms(z):
    """Return the number of polynomials that sum to 1e-16 for ``w t = z``."""
    return math.ceil(z / 2 + 5.4 * z ** (1 / 3) + 6)


@compiled_series()
def bessel(z, orders):
    """Return J_0(z) ... J_(orders-1)(z), (orders, T), by Miller's backward recurrence.

    T is the number of arguments z, (T,). `orders` must exceed the largest argument.
    """
    # The recurrence starts at an order far beyond the largest argument, so that its arbitrary
    # initial values are negligible at the first order returned.
    start = orders + int(20 + 10 * _largest(z) ** (1 / 3))
    start += start % 2
    values = np.zeros((orders, z.size))
    above = np.zeros(z.size)
    current = np.full(z.size, 1e-300)
    total = np.zeros(z.size)
    for n in range(start, 0, -1):
        if n < orders:
            for i in range(z.size):
                values[n, i] = current[i]
        if n % 2 == 0:
            for i in range(z.size):
                total[i] += 2 * current[i]
        largest = 0.0
        for i in range(z.size):
            below = 2 * n / max(z[i], SERIES_LIMITS.argument) * current[i] - above[i]
            above[i] = current[i]
            current[i] = below
            largest = max(largest, abs(below))
        # The recurrence grows without bounds, and only ratios matter, so all values are scaled
        # down.
        if largest > 1e250:
            for i in range(z.size):
                if abs(current[i]) > 1e200:
                    above[i] *= 1e-250
                    current[i] *= 1e-250
                    total[i] *= 1e-250
                    for order in range(n, orders):
                        values[order, i] *= 1e-250
    # Normalise such that J_0 + 2 (J_2 + J_4 + ...) = 1.
    for i in range(z.size):
        values[0, i] = current[i]
        total[i] += current[i]
    for n in range(orders):
        for i in range(z.size):
            values[n, i] /= total[i]
    return values


@compiled_series(fastmath=STRICT)
def series(x, chain, scale, of_t, of_w, reach):
    """Return sums of ``T_0 x, 2 T_1 x ...`` weighted by of_t (S, K), and of ``W_0 x ...`` by of_w.

    Parameters
    ----------
    x : (n,) array
        Displacement or velocity of every grain, 0 outside of reach[0] ... reach[1]-1.
    chain : LinearChain
        Stiffnesses and inverse masses.
    scale : float
        Upper bound w on the highest frequency, rad/s.
    of_t : (S, K) array
        Weights of ``T_0 x, 2 T_1 x, ...`` in each of S sums.
    of_w : (S, K) array
        Weights of ``W_0 x, W_1 x, ...`` in each of S sums.
    reach : pair of int
        First grain that moves, from 0, and the grain after the last one that moves.
    """
    grains = x.size
    orders = of_t.shape[1]
    first, last = reach
    tiny = SERIES_LIMITS.motion * _largest(x)
    double = np.empty(grains)  # 2 T_k x
    total = np.zeros(grains + 2)  # W_k x between two grains at rest
    chunk = min(orders, SERIES_LIMITS.chunk)
    pull = np.empty(grains)
    ts = np.zeros((chunk, grains))
    ws = np.zeros((chunk, grains))
    for n in range(grains):
        double[n] = 2 * x[n]
        total[n + 1] = ts[0, n] = ws[0, n] = x[n]
        pull[n] = 4 / (scale * scale) * chain.mobility[n]
    sum_t = np.zeros((of_t.shape[0], grains))
    sum_w = np.zeros((of_w.shape[0], grains))
    for k in range(orders):
        row = k % chunk
        if k > 0:
            # Each term reaches one grain further. Grains with negligible motion are skipped,
            # because subnormal numbers are slow.
            first = max(first - 1, 0)
            last = min(last + 1, grains)
            double[0] -= 4 * chain.oscillator / (scale * scale) * total[1]
            d = double[first:last]
            w = total[first : last + 2]
            t = ts[row, first:last]
            p = pull[first:last]
            q = chain.stiffness[first : last + 1]
            for n in range(d.size):
                d[n] -= p[n] * (q[n] * (w[n + 1] - w[n]) - q[n + 1] * (w[n + 2] - w[n + 1]))
                t[n] = d[n]
            s = ws[row, first:last]
            for n in range(d.size):
                w[n + 1] += d[n]
                s[n] = w[n + 1]
            while last > first and abs(double[last - 1]) < tiny and abs(total[last]) < tiny:
                last -= 1
                double[last] = total[last + 1] = 0.0
            while last > first and abs(double[first]) < tiny and abs(total[first + 1]) < tiny:
                double[first] = total[first + 1] = 0.0
                first += 1
        # A product of matrices is faster than adding one polynomial at a time.
        if row == chunk - 1 or k == orders - 1:
            sum_t += np.ascontiguousarray(of_t[:, k - row : k + 1]) @ ts[: row + 1]
            if of_w.shape[0]:
                sum_w += np.ascontiguousarray(of_w[:, k - row : k + 1]) @ ws[: row + 1]
            ts[:] = 0.0
            ws[:] = 0.0
    return sum_t, sum_w


@compiled_series()
def moving(u, v):
    """Set grains that hardly move to rest; return the first other grain, and one after the last."""
    still_u = SERIES_LIMITS.motion * _largest(u)
    still_v = SERIES_LIMITS.motion * _largest(v)
    first = 0
    last = u.size
    while first < last and abs(u[first]) <= still_u and abs(v[first]) <= still_v:
        first += 1
    while last > first and abs(u[last - 1]) <= still_u and abs(v[last - 1]) <= still_v:
        last -= 1
    u[:first] = 0.0
    v[:first] = 0.0
    u[last:] = 0.0
    v[last:] = 0.0
    return first, last


@compiled_series()
def _weights(scale, times, now):
    """Return weights of ``T_k phi``, (2 T, K+1), and of ``W_k v``, (T, K+1).

    The first array contains the weights of ``T_k phi`` in phi(t), followed by those in v(t). The
    second array contains the weights of ``W_k v`` in phi(t).
    """
    # Times ascend, so the last time needs the most terms.
    z = np.empty(times.size)
    for i in range(times.size):
        z[i] = scale * (times[i] - now)
    table = bessel(z, 2 * terms(z[-1]) + 2)
    orders = table.shape[0]
    while (
        orders > 4
        and max(_largest(table[orders - 2]), _largest(table[orders - 1])) < SERIES_LIMITS.weight
    ):
        orders -= 2
    count = times.size
    of_t = np.empty((2 * count, orders // 2))
    of_w = np.empty((count, orders // 2))
    for k in range(orders // 2):
        for i in range(count):
            of_t[i, k] = table[2 * k, i]
            of_w[i, k] = 2 / scale * table[2 * k + 1, i]
            if k == 0:
                of_t[count + i, k] = -scale * table[1, i]
            else:
                of_t[count + i, k] = scale / 2 * (table[2 * k - 1, i] - table[2 * k + 1, i])
    return of_t, of_w


@compiled_series()
def _march(u, v, chain, squares, reach, times, answers):
    """Advance u and v (n,) through the times and store the answers; return the number of terms."""
    us, vs, reached = answers
    first, last = reach
    now = 0.0
    begin = 0
    spent = 0
    while begin < times.size:
        a = first
        b = last
        end = begin
        scale = -1.0
        # A wider range may contain stiffer contacts, which need more terms.
        while b > a:
            needed = max(math.sqrt(_largest(squares[a:b])), 1e-300)
            if needed <= scale:
                break
            scale = needed
            end = begin + 1
            while end < times.size and scale * (times[end] - now) < SPAN:
                end += 1
            of_t, of_w = _weights(scale, times[begin:end], now)
            count = of_w.shape[1] - 1
            a = max(first - count, 0)
            b = min(last + count, u.size)
        if b == a:
            return spent
        oscillator = chain.oscillator if a == 0 else 0.0
        links = LinearChain(chain.stiffness[a : b + 1], chain.mobility[a:b], oscillator)
        moves = first - a, last - a
        new_v, new_u = series(v[a:b], links, scale, of_t[: end - begin], of_w, moves)
        # Directly after an impulse all displacements are 0.
        if _largest(u[first:last]) > 0.0:
            summand, _ = series(u[a:b], links, scale, of_t, of_w[:0], moves)
            for i in range(end - begin):
                for n in range(b - a):
                    new_u[i, n] += summand[i, n]
                    new_v[i, n] += summand[end - begin + i, n]
        for i in range(end - begin):
            for n in range(b - a):
                us[begin + i, a + n] = new_u[i, n]
                vs[begin + i, a + n] = new_v[i, n]
            reached[begin + i, 0] = a
            reached[begin + i, 1] = b
        for n in range(a, b):
            u[n] = us[end - 1, n]
            v[n] = vs[end - 1, n]
        now = times[end - 1]
        begin = end
        first, last = moving(u[a:b], v[a:b])
        first = first + a
        last = last + a
        spent += count
    return spent


class Propagator:
    """A linear chain that is advanced in time.

    Parameters
    ----------
    stiffness : (N+1,) array
        Stiffness of every contact, including walls, N/m.
    mobility : (N,) array
        Inverse mass of every grain, 1/kg; 0 for a grain that is held or driven.
    drive : float
        Angular frequency of grain 1 if it is driven, rad/s, else 0.
    u : (N,) array
        Displacement of every grain, m; changed in place.
    v : (N,) array
        Velocity of every grain, m/s; changed in place.
    """

    def __init__(self, stiffness: Array, mobility: Array, drive: float, u: Array, v: Array):
        # Bounds on squared frequencies (Gershgorin). A driven grain 1 is an oscillator that pulls
        # its neighbours and is not pulled by them.
        self._squares = 2 * (stiffness[:-1] + stiffness[1:]) * mobility
        self._squares[0] = max(self._squares[0], drive**2)
        # The stiffness is copied, because a read-only array would need another compilation.
        self._chain = LinearChain(np.array(stiffness), mobility, drive**2)
        self.u = u
        self.v = v
        self.terms = 0
        self._reach = moving(u, v)

    def advance(self, times: Array) -> Answers:
        """Advance the chain to these times, (T,) s after the current time, in ascending order.

        The field `reached` of the result contains, for each time, the first grain that moves and
        the grain after the last one that moves.
        """
        us, vs = np.zeros((2, times.size, self.u.size))
        answers = Answers(us, vs, np.zeros((times.size, 2), np.intp))
        chain = self._chain
        squares = self._squares
        self.terms += _march(self.u, self.v, chain, squares, self._reach, times, answers)
        self._reach = moving(self.u, self.v)
        return answers
