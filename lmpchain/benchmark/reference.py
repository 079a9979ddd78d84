"""Reference solution of Eq. (1): Taylor series in extended precision, independent of all engines."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RunFailed
from ..scene.scene import Scene
from ..scene.strike import first_overlaps
from ..util.arrays import EPSILON, Array
from ..util.lazy import listed

__dir__ = listed(__name__)

Long = np.longdouble
Longs = NDArray[np.longdouble]
EXTENDED = float(np.finfo(Long).eps)  # spacing of the numbers of the reference at 1
ORDER, TRUNCATION = 32, 0.1 * EXTENDED  # order of the series, and local error of a step
LOWER, LOOSER = 24, 10 * EXTENDED  # of a second run, whose difference shows the error
SHARED = (
    50 * EXTENDED + EPSILON
)  # error that both runs share: equilibrium and steps, rounding of the result
WITHIN = (
    np.arange(1, 17, dtype=Long)[:, None] / 16
)  # of a step: where the largest motion is looked for
REST = 1e-6 * EXTENDED  # motion below it counts as rest
SHORTEST = 1e-6 * EXTENDED  # shorter steps would not advance the time
TINY = 1e-200  # negligible beside any number that occurs
SEARCH = 60  # most iterations for a root; if they do not converge, the step ends before it
# analysis/calibration/reference_cost.py
# cost model: usual steps while all contacts stay closed and where some open; time of a step, and of a grain in it
SMOOTH, BROKEN, STEP_S, GRAIN_S = 0.4, 0.06, 0.6e-3, 7e-6


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference solution and its own error.

    Attributes
    ----------
    time : (T,) array
        s.
    displacement, velocity : (T, N) arrays
        Of every grain, recorded or not; from equilibrium, positive downward; m and m/s.
    error : float
        Its own error, as defined for `lmpchain.trajectory.record.ErrorEstimate`.
    method : str
        Description of the method.
    largest : (2,) array, optional
        Largest displacement and speed of any grain at any time, m and m/s; where it is not known, that at the samples
        is taken.
    """

    time: Array
    displacement: Array
    velocity: Array
    error: float
    method: str
    largest: Array | None = None

    @property
    def scale(self) -> Array:
        """Largest displacement and speed, to which errors are relative, (2,) m and m/s; 1 where that is 0."""
        sampled = np.array([np.abs(self.displacement).max(), np.abs(self.velocity).max()])
        largest = sampled if self.largest is None else self.largest
        return np.where(largest > 0, largest, 1.0)


def reference(scene: Scene) -> Reference:
    """Solve Eq. (1) by Taylor series in time, in NumPy's long double.

    The series of a force follows term by term from that of the overlap, ``y (y^delta)' = delta y' y^delta``. It
    converges until a contact opens or closes, where the force is once differentiable at best; its last terms estimate
    how far. So the adaptive step size shrinks towards an opening, the last step ends there, at a root of the series of
    the overlap, and steps grow again after a closing: the order is never lost. Lengths are in units of the largest
    excursion and forces are computed as differences from equilibrium, ``F_n expm1(delta log1p(s))``: weak waves keep
    all their digits. Grains that the wave has not reached are left out.

    Its error is the difference to a run of order 24 at a hundred times the tolerance, so with other steps, plus what
    both share: they begin with the same digits and end in double precision. It is some 4e-16 in all
    unless the scene is chaotic, and 1e-14 to 1e-12 where long double is no better than double.

    Jorba and Zou, Experimental Mathematics 14, 99 (2005), for the steps.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Reference
        Displacement and velocity of all recorded grains, and how far off these are.

    Raises
    ------
    RunFailed
        If steps become too short to continue.
    """
    motion = _Motion(scene)
    solution, largest = motion.solve(ORDER, TRUNCATION)
    found = Reference(scene.time, solution[0], solution[1], math.nan, "", largest)
    apart = np.abs(motion.solve(LOWER, LOOSER)[0] - solution).max((1, 2))
    error = float((apart / found.scale).max()) + SHARED
    digits = np.finfo(Long).precision
    method = f"Taylor series of order {ORDER} with {digits} digits, steps ending where contacts open and close"
    if digits == np.finfo(float).precision:
        method += "; long double is no better than double here"
    return replace(found, error=error, method=method)


def expected_seconds(scene: Scene) -> float:
    """Return about how long `reference` will take, s.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    float
        s.
    """
    motion = _Motion(scene)
    moving = np.flatnonzero(motion.start.any(axis=0))
    reached = min(
        scene.chain.grains,
        (np.ptp(moving) if moving.size else 0) + ORDER + float(motion.instants[-1]),
    )
    steps = float(motion.instants[-1]) / (SMOOTH if scene.strike_number < 1 else BROKEN) + 1
    return 2 * steps * (STEP_S + GRAIN_S * float(reached))


class _Motion:
    """Eq. (1) for one scene, with `length` and `time` as units.

    Contact n lies between grains n and n + 1, contact 0 between grain 1 and a wall above, contact N between grain N
    and a wall below. The overlap y of a contact is in units of that at rest, or of `length` where that is none.
    """

    def __init__(self, scene: Scene):
        chain = scene.chain
        given = scene.excitation
        self.wave, self.delta = given.waveform, Long(chain.exponent)
        self.driven, self.walled = bool(given.driven), given.wall is not None
        self.pushed = None if self.wave is None or scene.drive else given.reach(chain)[0] - 1
        self.sines = _exact_sines(given)
        mass, constant = chain.masses.astype(Long), chain.contacts.constant.astype(Long)
        carried = Long(chain.top_load) + Long(chain.gravity) * np.append(Long(0), np.cumsum(mass))
        pressed = (constant > 0) & (carried > 0)
        overlap = np.where(pressed, carried / np.where(pressed, constant, 1), 0) ** (1 / self.delta)
        deepest = first_overlaps(chain, given).astype(Long)
        heavier = np.maximum(np.append(mass[0], mass), np.append(mass, mass[-1]))
        fastest = np.sqrt((self.delta * constant * deepest ** (self.delta - 1) / heavier).max())
        self.time = 1 / fastest if fastest else Long(scene.duration)
        u, v = (x.astype(Long) for x in given.largest(chain))
        self.length = max(np.abs(u).max(), np.abs(v).max() * self.time) or Long(1)

        self.at_rest = pressed.astype(Long)
        self.closer = self.length / np.where(pressed, overlap, self.length)
        self.strength = np.where(pressed, carried, constant * self.length**self.delta)
        self.mobility = self.time**2 / (mass * self.length)
        self.mobility[chain.movable :] = 0
        if self.driven:
            self.mobility[0] = 0
        self.push = self.strength * np.maximum(
            np.append(0, self.mobility), np.append(self.mobility, 0)
        )

        u, v = (x.astype(Long) for x in scene.initial())
        self.start = np.array([u / self.length, v * (self.time / self.length)])
        self.units = np.array([self.length, self.length / self.time])[:, None, None]
        self.instants = scene.time.astype(Long) / self.time
        self.knots = np.array(self.wave.corners if self.wave else (), dtype=Long) / self.time

    def solve(self, order: int, tolerance: float) -> tuple[Array, Array]:
        """Return displacement and velocity, (2, T, N), and the largest at any time, (2,); m and m/s.

        By series of this order, with this error a step.
        """
        solution = np.zeros((2, self.instants.size, self.start.shape[1]))
        solution[:, :1] = self.start[:, None] * self.units
        largest = np.abs(self.start).max(axis=1)
        state, here = self.start.copy(), slice(0, self.start.shape[1])
        knots = self.knots[(self.knots > 0) & (self.knots < self.instants[-1])]
        t, done = Long(0), 1
        for stop in (*knots, self.instants[-1]):
            while t < stop:
                here = self._reached(state, here, order)
                x, y = self._series(t, state[:, here], here, order, tolerance)
                step = self._step(x, y, here, stop - t, tolerance)
                if not step > SHORTEST:
                    raise RunFailed(
                        f"the reference gave up at t = {float(t * self.time):.4g} s: its steps vanish"
                    )
                end = stop if step == stop - t else t + step
                now = int(np.searchsorted(self.instants, end, side="right"))
                solution[:, done:now, here] = (
                    _motion_at(x, self.instants[done:now, None] - t) * self.units
                )
                within = _motion_at(x, WITHIN * step)
                largest = np.maximum(largest, np.abs(within).max(axis=(1, 2)))
                moved = within[:, -1]
                state[:, here] = np.where(np.abs(moved) <= REST, 0, moved)
                t, done = end, now
        return solution, np.asarray(largest * self.units[:, 0, 0], dtype=float)

    def _reached(self, state: Longs, before: slice, order: int) -> slice:
        """Return the grains that move, widened on either side by the reach of a series of this order."""
        places = before.start + np.flatnonzero(state[:, before].any(axis=0))
        if self.wave:  # a grain that is acted on counts even while it rests
            places = np.union1d(places, self.pushed or 0).astype(int)
        first, last = (places[0], places[-1]) if places.size else (0, 0)
        return slice(max(0, first - order // 2), min(state.shape[1], last + 1 + order // 2))

    def _shut(self, overlap: Longs, here: slice, tolerance: float) -> NDArray[np.bool_]:
        """Return which contacts push noticeably; others may be neglected for one unit of time."""
        return self.push[_contacts(here)] * np.maximum(overlap, 0) ** self.delta > tolerance

    def _series(
        self, t: Long, state: Longs, here: slice, order: int, tolerance: float
    ) -> tuple[Longs, Longs]:
        """Return the coefficients of displacements and overlaps, (order + 1, n) and (order + 1, n + 1)."""
        closer, at_rest, strength = (
            a[_contacts(here)] for a in (self.closer, self.at_rest, self.strength)
        )
        x, y, power = (
            np.zeros((order + 1, n), dtype=Long) for n in (state.shape[1], closer.size, closer.size)
        )
        x[:2] = state
        driven, wall, outside = (
            self.driven and here.start == 0,
            np.zeros(order + 1, dtype=Long),
            np.zeros_like(x),
        )
        if driven:
            x[:, 0] = self._imposed(t, order) / self.length
        elif self.walled and here.start == 0:
            wall = self._imposed(t, order) / self.length
        elif self.pushed is not None:
            outside[:, self.pushed - here.start] = self._imposed(t, order)
        k = np.arange(order + 1, dtype=Long)
        for i in range(order + 1):
            y[i] = -np.diff(x[i], prepend=wall[i], append=Long(0)) * closer
            if i > order - 2:
                continue
            if i == 0:
                s, y[0] = y[0].copy(), at_rest + y[0]
                shut = self._shut(y[0], here, tolerance)
                pressed, whole = shut & (at_rest > 0), np.where(shut, y[0], 1)
                power[0] = shut * whole**self.delta
                exact = np.expm1(self.delta * np.log1p(np.where(pressed, s, 0)))
                change = np.where(pressed, exact, power[0] - at_rest)
            else:
                weight = (self.delta + 1) * k[1 : i + 1] - i
                total = np.einsum("j,jn,jn->n", weight, y[1 : i + 1], power[i - 1 :: -1])
                change = power[i] = shut * total / (i * whole)
            force = strength * change
            pull = (force[:-1] - force[1:] + outside[i]) * self.mobility[here]
            x[i + 2, driven:] = (pull / ((i + 1) * (i + 2)))[driven:]
        return x, y

    def _imposed(self, t: Long, order: int) -> Longs:
        """Return the coefficients of what is imposed, in m or N, (order + 1,)."""
        wave, k = self.wave, np.arange(order + 1, dtype=Long)
        assert wave
        series = np.zeros_like(k)
        if wave.spline is None:
            if self.knots.size == 0 or t < self.knots[0]:
                quarter, factorial = 2 * np.arctan(Long(1)), np.cumprod(np.maximum(k, 1))
                for amplitude, omega in self.sines:
                    scaled = omega * self.time
                    series += amplitude * scaled**k * np.sin(scaled * t + k * quarter) / factorial
            return series
        piece = min(int(np.searchsorted(self.knots, t, side="right")), self.knots.size - 1) - 1
        c, z = wave.spline.c[::-1, piece].astype(Long) * self.time ** k[:4], t - self.knots[piece]
        series[:4] = [
            sum(math.comb(j, m) * c[j] * z ** (j - m) for j in range(m, 4)) for m in range(4)
        ]
        return series

    def _step(self, x: Longs, y: Longs, here: slice, most: Long, tolerance: float) -> Long:
        """Return how long the series converge to this error, and until a contact opens or closes."""
        step, order = most, len(x) - 1
        for k in (order - 1, order):
            if (
                last := np.abs(x[k]).max()
            ) > 0:  # the terms of this power, in displacement and in velocity
                step = min(
                    step,
                    (tolerance / last) ** (1 / Long(k)),
                    (tolerance / (k * last)) ** (1 / Long(k - 1)),
                )
        push, shut = self.push[_contacts(here)], self._shut(y[0], here, tolerance)
        change = _at(np.abs(y), step) - np.abs(y[0])
        felt = push * (np.abs(y[0]) + change) ** self.delta * step > tolerance
        for contact in np.flatnonzero(felt & (np.where(shut, y[0], -y[0]) <= change)):
            overlap = y[:, contact]
            if shut[contact]:
                step = min(step, _first_root(overlap, step))
            elif (root := _first_root(-overlap, step)) < step:
                step = root + self._unfelt(overlap, root, step - root, push[contact], tolerance)
        return step

    def _unfelt(self, overlap: Longs, root: Long, most: Long, push: Long, tolerance: float) -> Long:
        """Return how long, at most `most`, ignoring a contact closing at `root` keeps the error below this."""
        depth, rate = (np.maximum(_at(series, root), 0) for series in (overlap, _slope(overlap)))
        after = most
        while True:
            deepest = depth + after * (rate + after * _bend(overlap, root + after) / 2)
            if push * deepest**self.delta * after <= tolerance:
                return after
            after /= 2


def _exact_sines(excitation: Any) -> list[tuple[Long, Long]]:
    """Return the sines that are imposed: amplitudes, and frequencies as exact as in the scene, rad/s."""
    wave = excitation.waveform
    if wave is None or wave.spline is not None:
        return []
    half = 4 * np.arctan(Long(1))
    exact = (
        half / Long(excitation.duration)
        if excitation.frequency is None
        else 2 * half * Long(excitation.frequency)
    )
    return [
        (Long(amplitude), Long(omega) * (exact / Long(wave.omega)))
        for amplitude, omega in wave.sines
    ]


def _contacts(here: slice) -> slice:
    """Return the contacts of these grains, on both sides of each."""
    return slice(here.start, here.stop + 1)


def _first_root(gap: Longs, end: Long) -> Long:
    """Return a lower bound of the first root of a polynomial: the root itself, or at least `end`.

    Newton's method with a bound of the second derivative, so that it never steps over a root.
    """
    slope, bend, at = _slope(gap), _bend(gap, end), Long(0)
    for _ in range(SEARCH):
        height, rate = np.maximum(_at(gap, at), 0), _at(slope, at)
        root = np.sqrt(rate**2 + 2 * bend * height)  # of height + rate z - bend z^2 / 2
        ahead = (rate + root) / bend if rate > 0 else 2 * height / ((root - rate) or 1)
        at += ahead
        if at >= end or ahead <= 2 * EXTENDED * at:
            break
    return at


def _slope(series: Longs) -> Longs:
    """Return the derivative of power series."""
    return series[1:] * np.arange(1, len(series)).reshape(-1, *[1] * (series.ndim - 1))


def _bend(series: Longs, end: Long) -> Long:
    """Return an upper bound, above 0, of the second derivative between 0 and `end`."""
    return _at(np.abs(_slope(_slope(series))), end) + TINY


def _at(series: Longs, tau: Longs | Long) -> Any:
    """Evaluate power series at tau."""
    total = series[-1]
    for term in series[-2::-1]:
        total = term + tau * total
    return total


def _motion_at(x: Longs, tau: Longs | Long) -> Longs:
    """Return displacements and velocities after tau."""
    return np.array([_at(x, tau), _at(_slope(x), tau)])
