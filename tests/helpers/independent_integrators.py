"""References that the engines did not make: two integrators that share nothing
with the package but Eq. (1).

Both take a scene and return ``(u, v, error)``: displacement (T, N) m and velocity (T, N) m/s of
every grain at the recorded times, positive downward, and how far a second, looser run came out, in
the sense of `relative_error`. They find the equilibrium from masses and the constants of contacts
and walls themselves and integrate displacements in units of the strike, so weak waves keep all
their digits. A driven grain is put where its motion says, at every evaluation of the force, and its
knots end a step. Times are those of ``scene.time``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853
from scipy.interpolate import CubicSpline, PchipInterpolator

if TYPE_CHECKING:
    from lmpchain import Scene

Array = NDArray[np.floating[Any]]
Reference = tuple[NDArray[np.float64], NDArray[np.float64], float]


def below_load(chain: Any) -> NDArray[np.bool_]:
    """Return which contacts (N+1,) the load presses: with load on grain 1, that
    with a wall above it, too.
    """
    return np.arange(chain.grains + 1) >= (chain.load_grain if chain.load_grain > 1 else 0)


class Motion:
    """Eq. (1) for one scene: lengths in units of `length`, times in units of
    `time`, in the precision `kind`.

    ``x_n'' = [f_(n-1) - f_n] / m_n`` where f_n is the force of contact n minus its equilibrium
    value; contact 0 is with a wall above grain 1 and contact N with one below grain N. It is found
    as ``F_n expm1(delta log1p(s))`` with ``s = (phi_n - phi_(n+1)) / eps_n``, which does not
    cancel, as ``-F_n`` once the contact is open, and as ``K_n max(r, 0)^delta`` where nothing
    presses the two together.
    """

    def __init__(self, scene: Scene, kind: type[np.floating[Any]]):
        chain = scene.chain
        mass = np.asarray(chain.masses, dtype=kind)
        above, below = chain.wall_constants
        above = above * (chain.top == "wall")
        below = below * (chain.bottom == "wall")
        stiffness = np.concatenate(([above], chain.contact_constants, [below])).astype(kind)
        self.delta = kind(chain.exponent)
        force = kind(chain.gravity) * np.append(0, np.cumsum(mass))
        force = force + kind(chain.top_load) * below_load(chain)
        pressed = (stiffness > 0) & (force > 0)
        self.compressed = bool(pressed.any())
        self.loose = np.flatnonzero((stiffness > 0) & ~pressed)
        self.opens = np.where(pressed, -1, 0)  # closeness at which each contact does
        overlap = np.where(pressed, force / np.where(pressed, stiffness, 1), 0) ** (1 / self.delta)
        self.acting, self.body = _acting(scene, kind)
        self.driven = self.acting if self.body == 1 and scene.excitation.kind == "drive" else None
        u, v = (np.asarray(a, dtype=kind) for a in scene.initial())
        farthest, fastest = (
            self.acting.largest() if self.acting else (np.abs(u).max(), np.abs(v).max())
        )
        self.pushes = scene.excitation.kind == "force"
        if self.pushes:  # what a free grain would do in a period or so
            fastest = farthest * self.acting.unit / mass[self.body - 1]
            farthest = fastest * self.acting.unit
        typical = overlap.max()
        if typical == 0:
            typical = max(
                farthest, (mass.min() * fastest**2 / stiffness.max()) ** (1 / (self.delta + 1))
            )
        self.time = np.sqrt(
            mass.min() / (self.delta * stiffness.max() * typical ** (self.delta - 1))
        )
        self.length = max(farthest, fastest * self.time)
        self.strength = np.where(pressed, force, stiffness * self.length**self.delta)
        self.closer = np.where(pressed, self.length / np.where(pressed, overlap, 1), 1)
        self.mobility = self.time**2 / (mass * self.length)
        if chain.bottom == "fixed":
            self.mobility[-1] = 0
        if self.driven:
            self.mobility[0] = 0
        self.instants = np.asarray(scene.time, dtype=kind) / self.time
        self.knots = self.acting.knots / self.time if self.acting else np.empty(0, dtype=kind)
        self.start = self.at(
            self.instants[0], np.array([u / self.length, v * (self.time / self.length)])
        )

    def at(self, t: np.floating[Any], state: Array) -> Array:
        """Return the state (2, N) with a driven grain where it is at this time."""
        if self.driven:
            u, v = self.driven(t * self.time)
            state = state.copy()
            state[:, 0] = u / self.length, v * (self.time / self.length)
        return state

    def size(self, t: np.floating[Any], state: Array) -> Array:
        """Return the largest displacement and velocity of all grains in a state (2,
        N), and of a wall that moves.
        """
        largest = np.abs(state).max(axis=1)
        if self.acting and self.body == 0:  # it moves before any grain does
            u, v = self.acting(t * self.time)
            largest = np.maximum(largest, np.abs([u / self.length, v * (self.time / self.length)]))
        return largest

    def closeness(self, t: np.floating[Any], x: Array) -> Array:
        """Return how much closer than at rest contacts (N+1,) are, over their
        overlap at rest if they have one.
        """
        bodies = np.zeros(x.size + 2, dtype=x.dtype)  # a wall, or nothing, at either end
        bodies[1:-1] = x
        if self.acting and not self.pushes:
            bodies[self.body] = self.acting(t * self.time)[0] / self.length
        return (bodies[:-1] - bodies[1:]) * self.closer

    def changes(
        self, t: np.floating[Any], state: Array, step: np.floating[Any], later: Array
    ) -> bool:
        """Return whether a contact that presses at time t, in a state (2, N), is open
        a step later, or the reverse.
        """
        before, after = (
            self.closeness(*at) > self.opens for at in ((t, state[0]), (t + step, later[0]))
        )
        return bool(((before != after) & (self.strength > 0)).any())

    def acceleration(self, t: np.floating[Any], x: Array) -> Array:
        """Return x'' (N,) of the displacements x (N,) at time t; 0 for a
        grain that is held or driven.
        """
        s = self.closeness(t, x)
        if self.compressed:
            shut = s > -1
            change = np.where(shut, np.expm1(self.delta * np.log1p(np.where(shut, s, 0))), -1)
            change[self.loose] = np.maximum(s[self.loose], 0) ** self.delta
        else:
            change = np.maximum(s, 0) ** self.delta
        force = self.strength * change
        pull = force[:-1] - force[1:]
        if self.pushes:
            pull[self.body - 1] += self.acting(t * self.time)[0]
        return pull * self.mobility

    def stretches(self) -> Iterator[tuple[np.floating[Any], np.floating[Any], bool]]:
        """Yield begin and end of every stretch of time that is smooth, and whether
        a sample is taken at its end.
        """
        for begin, end in pairwise(self.instants):
            inside = self.knots[(self.knots > begin) & (self.knots < end)]
            for left, right in pairwise([begin, *inside, end]):
                yield left, right, right == end

    def in_si(self, states: list[Array]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return displacement and velocity (T, N) in m and m/s from (2, N) states."""
        x = np.array(states)
        return (x[:, 0] * self.length).astype(float), (x[:, 1] * (self.length / self.time)).astype(
            float
        )


class Sine:
    """A sin(2 pi f t), for as many cycles under a Hann window, or for its first half period."""

    def __init__(
        self,
        amplitude: float,
        frequency: float,
        kind: type[np.floating[Any]],
        cycles: float | None,
        half: bool,
    ):
        self.amplitude = kind(amplitude)
        self.omega = 8 * np.arctan(kind(1)) * kind(frequency)
        self.unit = 1 / self.omega
        self.cycles = cycles
        self.half = half
        ends = (
            [kind(cycles) / kind(frequency)]
            if cycles
            else [1 / kind(2 * frequency)]
            if half
            else []
        )
        self.knots = np.array(ends, dtype=kind)

    def __call__(self, t: np.floating[Any]) -> tuple[np.floating[Any], np.floating[Any]]:
        """Return displacement, m, and velocity, m/s; or a force, N, and its rate."""
        if self.knots.size and t >= self.knots[0]:
            return 0 * self.omega, 0 * self.omega
        a = self.amplitude
        w = self.omega
        value = a * np.sin(w * t)
        rate = a * w * np.cos(w * t)
        if not self.cycles:
            return value, rate
        # the square of its sine keeps the digits that 1 - cos loses at first
        half = w * t / (2 * self.cycles)
        hann = np.sin(half) ** 2
        slope = np.sin(half) * np.cos(half) * w / self.cycles
        return value * hann, rate * hann + value * slope

    def largest(self) -> tuple[np.floating[Any], np.floating[Any]]:
        """Return the largest value and rate, about."""
        return abs(self.amplitude), abs(self.amplitude) * self.omega


class Curve:
    """The curve through points, what comes before and after them, in the precision `kind`.

    The slopes at the points are SciPy's; from point to point there is the cubic with these slopes,
    or a straight line.
    """

    def __init__(self, given: Any, values: Array, kind: type[np.floating[Any]]):
        times = given.times
        straight = given.interpolation == "linear"
        slopes = 0 * np.asarray(values, dtype=kind)
        if given.interpolation == "pchip":
            slopes = PchipInterpolator(times, np.asarray(values, dtype=float))(times, 1)
        elif given.interpolation == "spline":
            # linear in the values, which may have more digits than a double
            slopes = CubicSpline(times, np.eye(len(times)))(times, 1) @ np.asarray(values, kind)
        knots, y, slope = (np.asarray(a, dtype=kind) for a in (times, values, slopes))
        length = np.diff(knots)
        mean = np.diff(y) / length
        bend = (3 * mean - 2 * slope[:-1] - slope[1:]) / length
        twist = (slope[:-1] + slope[1:] - 2 * mean) / length**2
        rates = (mean, 0 * mean, 0 * mean) if straight else (slope[:-1], bend, twist)
        pieces = (y[:-1], *rates)
        # a force falls to 0 in the time between the last two points, a drive holds still
        fall = -y[-1] / length[-1] if given.kind == "force" else kind(0)
        rest = y[-1] if given.kind == "drive" else kind(0)
        behind = np.array([[y[-1], fall, 0, 0], [rest, 0, 0, 0]], dtype=kind).T
        self.pieces = np.append(np.array(pieces), behind, axis=1)
        # the last point is one of the curve, also where its time is rounded up
        begins = np.append(knots[:-1], knots[-1] * (1 + kind(4 * 2.0**-52)))
        self.knots = np.append(begins, begins[-1] + length[-1] * np.arange(1, 3))
        if knots[0] > 0:
            begin = max(knots[0] - length[0], kind(0))
            rise = [[0, y[0] / (knots[0] - begin), 0, 0]]
            before = [*([[0, 0, 0, 0]] if begin > 0 else []), *rise]
            self.pieces = np.append(np.array(before, dtype=kind).T, self.pieces, axis=1)
            self.knots = np.append(([kind(0)] if begin > 0 else []) + [begin], self.knots)
        self.unit = np.diff(self.knots).min()

    def __call__(self, t: np.floating[Any]) -> tuple[np.floating[Any], np.floating[Any]]:
        """Return displacement, m, and velocity, m/s."""
        piece = min(
            max(int(np.searchsorted(self.knots, t, side="right")) - 1, 0), self.knots.size - 2
        )
        s = t - self.knots[piece]
        y, slope, bend, twist = self.pieces[:, piece]
        return y + s * (slope + s * (bend + s * twist)), slope + s * (2 * bend + 3 * s * twist)

    def largest(self) -> tuple[np.floating[Any], np.floating[Any]]:
        """Return about the largest displacement and speed."""
        dense = (self.knots[:-1, None] + np.diff(self.knots)[:, None] * np.arange(8) / 8).ravel()
        u, v = np.abs([self(t) for t in [*dense, self.knots[-1]]]).max(axis=0)
        return u, v


def _acting(scene: Scene, kind: type[np.floating[Any]]) -> tuple[Sine | Curve | None, int]:
    """Return what acts after t = 0, if anything does, and the body: 0 is the wall above grain 1."""
    given = scene.excitation
    if given.kind not in ("drive", "force"):
        return None, 0
    if given.times is not None:
        values = given.force if given.kind == "force" else given.displacement
        return Curve(given, values, kind), given.grain
    half = given.kind == "force" and given.shape == "half-sine"
    frequency = 0.5 / given.duration if half else given.frequency
    return Sine(given.amplitude, frequency, kind, given.cycles, half), given.grain


def relative_error(u: Array, v: Array, u_ref: Array, v_ref: Array) -> float:
    """Max over displacement and velocity of max|x - x_ref| / max|x_ref|
    over all samples and grains.
    """
    pairs = ((u, u_ref), (v, v_ref))
    return max(float(np.abs(np.asarray(x) - ref).max() / np.abs(ref).max()) for x, ref in pairs)


def _twice(
    run: Callable[[float], tuple[Array, Array]], tolerance: float, looser: float
) -> Reference:
    """Run at both tolerances; the error is the distance between them, so that of the looser one."""
    u, v = run(tolerance)
    return u, v, relative_error(*run(looser), u, v)


def scipy_reference(scene: Scene) -> Reference:
    """Integrate with SciPy's DOP853 in double precision, restarted at every sample.

    rtol is 3e-14 (SciPy allows no less than 2.3e-14) and atol 1e-17 of the strike. The error given
    is the distance to a run at rtol 1e-12. Where no contact opens it is pessimistic, by up to the
    ratio of the two. Where contacts open the step control of either run stumbles by chance and the
    distance bounds nothing: trust some 1e-10 there and compare with `extended_reference`.
    """
    motion = Motion(scene, np.float64)
    grains = motion.start.shape[1]

    def slope(t: float, y: Array) -> Array:
        return np.concatenate((y[grains:], motion.acceleration(t, y[:grains])))

    def run(rtol: float) -> tuple[Array, Array]:
        y = motion.start.ravel()
        step = None
        states = [motion.start]
        for begin, end, sampled in motion.stretches():
            first = None if step is None else min(step, end - begin)
            solver = DOP853(slope, begin, y, end, rtol=rtol, atol=1e-17, first_step=first)
            while solver.status == "running":
                if message := solver.step():
                    raise ArithmeticError(f"DOP853: {message}")
                step = solver.h_abs  # what it would take next, not cut at the sample
            state = motion.at(end, solver.y.reshape(2, grains))
            y = state.ravel()
            if sampled:
                states.append(state)
        return motion.in_si(states)

    return _twice(run, 3e-14, 1e-12)


def extended_reference(scene: Scene, tolerance: float = 1e-18) -> Reference:
    """Integrate with extrapolated Stoermer steps in extended precision (80 bits
    where the machine has them).

    Every step is divided into 1, 2, 3 ... equal parts and extrapolated to none at all, until two
    columns agree to `tolerance` of the largest displacement and velocity; where ten columns do not,
    the step shrinks. So it does where a contact opens or closes within it, for there columns may
    agree by chance: until what the force misses in a step so short, its power delta + 1, is no more
    than `tolerance`. Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section
    II.14. The error given is the distance to a run with a tolerance ten times looser, so
    pessimistic. `tolerance` is that of one step, not of the whole run: errors add up and grow with
    the motion, by some 1e4 in a strong strike.
    """
    motion = Motion(scene, np.longdouble)
    tolerance = max(tolerance, 9 * float(np.finfo(np.longdouble).eps))

    def run(loose: float) -> tuple[Array, Array]:
        state = motion.start
        states = [motion.start]
        peak = motion.size(motion.instants[0], state)
        step = np.longdouble(0.01)
        shortest = loose ** (1 / (motion.delta + 1))
        for begin, end, sampled in motion.stretches():
            left = end - begin
            while left > 0:
                parts = np.ceil(left / step)
                tried = left / parts
                proposal, columns = _extrapolate(motion, state, end - left, tried, loose, peak)
                if proposal is None or (
                    tried > shortest and motion.changes(end - left, state, tried, proposal)
                ):
                    step = 0.4 * tried
                    if step < 1e-12:
                        raise ArithmeticError(
                            f"no step is short enough for a tolerance of {loose:g}"
                        )
                    continue
                left = left - tried if parts > 1 else 0
                state = motion.at(end - left, proposal)
                peak = np.maximum(peak, motion.size(end - left, state))
                if columns >= 9:
                    step = 0.8 * tried
                elif columns <= 7:
                    step = max(step, 1.5 * tried)
            if sampled:
                states.append(state)
        return motion.in_si(states)

    return _twice(run, tolerance, 10 * tolerance)


def _extrapolate(
    motion: Motion, state: Array, begin: Array, step: Array, tolerance: float, peak: Array
) -> tuple[Array | None, int]:
    """Return the state one step on and the columns it took, or None where ten were too few."""
    push = motion.acceleration(begin, state[0])
    row: list[Array] = []
    for parts in range(1, 11):
        above = row
        row = [_stoermer(motion, state, push, begin, step, parts)]
        for k in range(1, parts):
            ratio = np.longdouble(parts) / (parts - k)
            row.append(row[k - 1] + (row[k - 1] - above[k - 1]) / (ratio**2 - 1))
        if parts > 2:
            size = np.maximum(peak, motion.size(begin + step, row[-1]))
            if (np.abs(row[-1] - row[-2]).max(axis=1) <= tolerance * size).all():
                return row[-1], parts
    return None, 10


def _stoermer(
    motion: Motion, state: Array, push: Array, begin: Array, step: Array, parts: int
) -> Array:
    """Advance x'' = a(t, x) by `parts` leapfrog steps; the error holds only
    even powers of their length.
    """
    h = step / parts
    x = state[0]
    gain = push * (h / 2)
    for part in range(1, parts + 1):
        x = x + h * (state[1] + gain)  # summing the gain in velocity keeps its digits
        push = motion.acceleration(begin + part * h, x)
        gain = gain + h * push
    return np.array([x, state[1] + (gain - push * (h / 2))])
