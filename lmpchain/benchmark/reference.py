"""Reference solution of Eq. (1) by Taylor series in extended precision, apart from all engines."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..chain.equilibrium import force_at_rest
from ..errors import RunFailed
from ..scene.scene import Scene, check_scene
from ..util.arrays import EPSILON, Array
from ..util.lazy import listed

__dir__ = listed(__name__)

Long = np.longdouble
Longs = NDArray[np.longdouble]
EXTENDED = float(np.finfo(Long).eps)  # Spacing of the numbers of the reference near 1.
# Smaller motion counts as rest; a smaller relative step would not advance the time.
NEGLIGIBLE = 1e-6 * EXTENDED
# Relative tolerances of the reference for laws by formula, and of the run that shows its error.
SCIPY_TOLERANCES = (1e-13, 1e-12)
# Longest step of SciPy's reference in radians of the fastest motion.
MOST_RADIANS = 1.0
# Cost of SciPy's reference: force evaluations per radian, s per evaluation, and s per grain in it.
SCIPY_EVALUATIONS = 100
SCIPY_CALL_S = 1e-4
SCIPY_GRAIN_S = 2e-7
# Error that both runs have in common: equilibrium, rounded steps, and rounding of the result.
SHARED = 50 * EXTENDED + EPSILON


class TaylorSettings(NamedTuple):
    """Settings of the Taylor method: order of the power series in time, local error of a step."""

    order: int
    tolerance: float


ANSWER = TaylorSettings(32, 0.1 * EXTENDED)
# A second run with other steps estimates the error.
CHECK = TaylorSettings(24, 10 * EXTENDED)


@dataclass(frozen=True)
class ReferenceCost:
    """Cost model of a reference; its constants are from analysis/calibration/reference_cost.py.

    Attributes
    ----------
    smooth, broken : float
        Usual step while all contacts stay closed; usual step if contacts open. The unit is the
        scene's unit of time.
    step_s, grain_s : float
        Computing time of a step, s; additional time for each grain, s.
    """

    smooth: float = 0.4
    broken: float = 0.06
    step_s: float = 0.6e-3
    grain_s: float = 7e-6


COST = ReferenceCost()


# SciPy's solution is looked at so often, between samples too, for its largest motion: at most so
# many values of displacements.
LOOKS_A_RADIAN = 4
LOOK_VALUES = 2**20


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference solution and its own error.

    Attributes
    ----------
    time : (T,) array
        Times, s.
    displacement, velocity : (T, N) arrays
        Displacement of every grain (recorded or not) from equilibrium, positive downward, m;
        velocity of every grain, m/s.
    error : float
        Error of the reference, as defined for `lmpchain.trajectory.record.ErrorEstimate`.
    method : str
        Description of the method.
    largest : (2,) array, optional
        Largest displacement and speed of any grain at any time, m and m/s; by default the largest
        at the samples.
    """

    time: Array
    displacement: Array
    velocity: Array
    error: float
    method: str
    largest: Array | None = None

    @property
    def scale(self) -> Array:
        """Scales of relative errors, (2,): the largest displacement, m, and speed, m/s, or 1."""
        sampled = np.array([np.abs(self.displacement).max(), np.abs(self.velocity).max()])
        largest = sampled if self.largest is None else self.largest
        return np.where(largest > 0, largest, 1.0)


def reference(scene: Scene) -> Reference:
    """Solve Eq. (1) by Taylor series in time, in NumPy's long double; other laws by SciPy.

    The series of a force follows term by term from the series of the overlap,
    ``y (y^delta)' = delta y' y^delta``. A term of a viscous force follows from the next term of
    this series. The series converges until a contact opens or closes, where the force has at most
    one derivative.
    The last terms of the series estimate its radius of convergence, so that the adaptive step
    shrinks towards an opening. The last step ends at the opening, at a root of the series of the
    overlap, and steps grow again after a closing. The order is therefore never lost. Lengths are in
    units of the largest excursion, and forces are computed as differences from equilibrium,
    ``F_n expm1(delta log1p(s))``, so that weak waves keep their relative accuracy. Grains that the
    wave has not reached are left out.

    The error is the difference from a run of order 24 with other steps, at a hundred times the
    tolerance, plus the rounding error that both runs share: they start from the same numbers and
    end in double precision. The error is about 4e-16 unless the scene is chaotic, and 1e-14 to
    1e-12 on machines whose long double is no better than double.

    The steps follow Jorba and Zou, Experimental Mathematics 14, 99 (2005).

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Reference
        Displacement and velocity of all grains, and their error.

    Raises
    ------
    RunFailed
        If steps become too short to continue.
    """
    check_scene(scene)
    if _needs_scipy(scene):
        return _solve_by_scipy(scene)
    motion = _Motion(scene)
    solution, largest = motion.solve(ANSWER)
    answer = Reference(scene.time, solution[0], solution[1], math.nan, "", largest)
    difference = np.abs(motion.solve(CHECK)[0] - solution).max((1, 2))
    digits = np.finfo(Long).precision
    series = f"Taylor series of order {ANSWER.order} with {digits} digits"
    method = f"{series}, steps ending where contacts open and close"
    if digits == np.finfo(float).precision:
        method += "; long double is no better than double here"
    error = float((difference / answer.scale).max()) + SHARED
    return replace(answer, error=error, method=method)


def _needs_scipy(scene: Scene) -> bool:
    """Return whether no power series follows from a recurrence: formulas and ground forces."""
    return scene.chain.law.power is None or scene.chain.ground is not None


def expected_seconds(scene: Scene) -> float:
    """Return the expected time of `reference`, s.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    float
        Expected time, s.
    """
    check_scene(scene)
    if _needs_scipy(scene):
        evaluations = 2 * SCIPY_EVALUATIONS * (1 + scene.total_phase)
        return evaluations * (SCIPY_CALL_S + SCIPY_GRAIN_S * scene.chain.grains)
    motion = _Motion(scene)
    moving = np.flatnonzero(motion.start.any(axis=0))
    duration = float(motion.instants[-1])
    width = (np.ptp(moving) if moving.size else 0) + ANSWER.order + duration
    grains = min(scene.chain.grains, width)
    # Strong damping shortens the steps.
    duration *= float(scene.chain.damping.fastest_rate(1 / float(motion.time)) * motion.time)
    steps = duration / (COST.smooth if scene.strike_number < 1 else COST.broken) + 1
    # Steps end at every point of a sampled force or drive.
    steps += np.count_nonzero(motion.knots < motion.instants[-1])
    return 2 * steps * (COST.step_s + COST.grain_s * float(grains))


def _solve_by_scipy(scene: Scene) -> Reference:
    """Solve Eq. (1) with the law of a formula by SciPy's DOP853, in double precision.

    The error is ten times the difference from a run at ten times the tolerance, because both runs
    lose the order of the method at kinks of the force.
    """
    runs = [_integrate(scene, tolerance) for tolerance in SCIPY_TOLERANCES]
    (u, v, largest), (coarse_u, coarse_v, _) = runs
    method = f"SciPy's DOP853 at a relative tolerance of {SCIPY_TOLERANCES[0]:g}"
    answer = Reference(scene.time, u, v, math.nan, method, largest)
    difference = [np.abs(u - coarse_u).max(), np.abs(v - coarse_v).max()]
    error = 10 * float((np.array(difference) / answer.scale).max()) + SCIPY_TOLERANCES[0]
    return replace(answer, error=error)


def _equations(scene: Scene) -> Callable[[float, Array], Array]:
    """Return the right-hand side: a function of time, s, and state, (2N,) m and m/s."""
    chain = scene.chain
    excitation = scene.excitation
    wave = excitation.waveform
    contacts = chain.contacts
    grains = chain.grains
    driven = bool(excitation.driven)
    body = scene.drive.body(chain) if scene.drive else 0
    moves = (np.arange(grains) < chain.movable) & (np.arange(grains) >= driven)

    def rates(t: float, state: Array) -> Array:
        u, v = state.reshape(2, grains).copy()
        wall, base = np.zeros((2, 2))
        push = np.zeros(grains)
        if wave is not None:
            imposed = np.array([wave.at(t, 0), wave.at(t, 1)])
            if 1 <= body <= grains:
                u[body - 1], v[body - 1] = imposed
            elif body:
                base = imposed
            elif excitation.wall is not None:
                wall = imposed
            else:
                push[excitation.acts_on - 1] = imposed[0]
        closer = contacts.closer(u, wall[0], base[0])
        force = contacts.force_change(closer)
        if chain.damped:
            overlap = contacts.overlap + closer
            # Laws by formula have forces in open contacts. The power of a negative overlap is no
            # number, and an open spring has no stiffness.
            powers = chain.law.power is not None
            stiffness = contacts.stiffness_at(np.maximum(overlap, 0.0) if powers else overlap)
            stiffness = np.where(overlap > 0, stiffness, 0.0) if powers else stiffness
            viscosity = chain.contact_viscosity * stiffness
            force = force + viscosity * contacts.closer(v, wall[1], base[1])
        pull = chain.ground.force(u, t) if chain.ground else 0.0
        acceleration = (push - pull - np.diff(force)) / chain.masses - chain.drag * v
        return np.concatenate((moves * v, moves * acceleration))

    return rates


def _integrate(scene: Scene, tolerance: float) -> tuple[Array, Array, Array]:
    """Return displacements and velocities, (T, N) m and m/s, and their maxima at any time, (2,)."""
    # Only this reference needs SciPy's integrators, whose import takes a tenth of a second.
    from scipy.integrate import solve_ivp

    grains = scene.chain.grains
    rates = _equations(scene)
    state = np.concatenate(scene.initial())
    u, v = np.abs(state).reshape(2, grains).max(axis=1)
    farthest, fastest = np.maximum((u, v), scene.imposed)
    speed = max(fastest, farthest * scene.fastest_motion)
    size = np.repeat([speed / scene.highest_frequency, speed], grains)
    rows = [state[np.newaxis]]
    peaks = [(u, v)]
    begin = 0.0
    for end in (*scene.kinks, scene.duration):
        times = scene.time[(scene.time > begin) & (scene.time <= end)]
        run = solve_ivp(
            rates,
            (begin, end),
            state,
            method="DOP853",
            rtol=tolerance,
            atol=tolerance * size + 1e-300,
            t_eval=np.union1d(times, _look_times(scene, begin, end)),
            max_step=MOST_RADIANS / scene.highest_frequency,
        )
        if run.status:
            raise RunFailed(f"the reference by SciPy stopped: {run.message}")
        state = run.y[:, -1]
        rows.append(run.y.T[np.isin(run.t, times)])
        peaks.append(np.abs(run.y.reshape(2, grains, -1)).max(axis=(1, 2)))
        begin = end
    solution = np.concatenate(rows).reshape(-1, 2, grains).swapaxes(0, 1).copy()
    wave = scene.excitation.waveform
    body = scene.drive.body(scene.chain) if scene.drive else 0
    if 1 <= body <= grains and wave is not None:
        solution[:, :, body - 1] = wave.at(scene.time, 0), wave.at(scene.time, 1)
        looks = np.union1d(scene.time, _look_times(scene, 0.0, scene.duration))
        peaks.append(tuple(np.abs(wave.at(looks, order)).max() for order in (0, 1)))
    return solution[0], solution[1], np.max(peaks, axis=0)


def _look_times(scene: Scene, begin: float, end: float) -> Array:
    """Return times from `begin` to `end`, s, at which to search for the largest motion."""
    phase = (end - begin) * scene.highest_frequency
    most = LOOK_VALUES // scene.chain.grains
    return np.linspace(begin, end, 2 + int(min(LOOKS_A_RADIAN * phase, most)))


class _Motion:
    """Eq. (1) for one scene, with `length` and `time` as units.

    Contact n is between grains n and n + 1, contact 0 between grain 1 and a wall above it, and
    contact N between grain N and a wall below it. The unit of the overlap y of a contact is its
    overlap at rest, or `length` if this overlap is 0.
    """

    def __init__(self, scene: Scene):
        chain = scene.chain
        excitation = scene.excitation
        self.wave = excitation.waveform
        self.delta = Long(chain.law.power_of("the reference solution"))
        self.driven = bool(excitation.driven)
        self.walled = excitation.wall is not None
        self.from_below = excitation.from_below
        self.held = chain.bottom == "fixed"
        self.pushed = None
        if self.wave is not None and not scene.drive:
            self.pushed = excitation.acts_on - 1
        self.sines = _exact_sines(excitation)
        mass = chain.masses.astype(Long)
        constant = chain.contacts.constant.astype(Long)
        weight = Long(chain.gravity) * np.cumsum(mass)
        carried = force_at_rest(weight, chain.top_load, chain.load_grain)
        pressed = (constant > 0) & (carried > 0)
        overlap = np.where(pressed, carried / np.where(pressed, constant, 1), 0) ** (1 / self.delta)
        deepest = scene.first_overlaps.astype(Long)
        heavier = np.maximum(np.append(mass[0], mass), np.append(mass, mass[-1]))
        stiffness = self.delta * constant * deepest ** (self.delta - 1)
        fastest = np.sqrt((stiffness / heavier).max())
        self.time = 1 / fastest if fastest else Long(scene.duration)
        u, v = (x.astype(Long) for x in excitation.largest(chain))
        self.length = max(np.abs(u).max(), np.abs(v).max() * self.time) or Long(1)

        self.at_rest = pressed.astype(Long)
        self.closer = self.length / np.where(pressed, overlap, self.length)
        self.strength = np.where(pressed, carried, constant * self.length**self.delta)
        self.mobility = self.time**2 / (mass * self.length)
        self.mobility[chain.movable :] = 0
        if self.driven:
            self.mobility[0] = 0
        lighter = np.maximum(np.append(0, self.mobility), np.append(self.mobility, 0))
        self.push = self.strength * lighter
        self.viscosity = chain.contact_viscosity.astype(Long) / self.time
        self.drag = chain.drag.astype(Long) * self.time

        u, v = (x.astype(Long) for x in scene.initial())
        self.start = np.array([u / self.length, v * (self.time / self.length)])
        self.units = np.array([self.length, self.length / self.time])[:, None, None]
        self.instants = scene.time.astype(Long) / self.time
        self.knots = np.array(self.wave.kinks if self.wave else (), dtype=Long) / self.time

    def solve(self, series: TaylorSettings) -> tuple[Array, Array]:
        """Return the displacement and velocity, (2, T, N), and their maxima at any time, (2,).

        The units are m and m/s.
        """
        solution = np.zeros((2, self.instants.size, self.start.shape[1]))
        solution[:, :1] = self.start[:, None] * self.units
        largest = np.abs(self.start).max(axis=1)
        state = self.start.copy()
        moving = slice(0, self.start.shape[1])
        # Fractions of a step at which the largest motion is sampled.
        within = np.arange(1, 17, dtype=Long)[:, None] / 16
        knots = self.knots[(self.knots > 0) & (self.knots < self.instants[-1])]
        t = Long(0)
        done = 1
        for stop in (*knots, self.instants[-1]):
            while t < stop:
                moving = self._moving(state, moving, series.order)
                x, y = self._series(t, state[:, moving], moving, series)
                step = self._step(x, y, moving, stop - t, series.tolerance)
                if not step > NEGLIGIBLE:
                    time = float(t * self.time)
                    raise RunFailed(f"the reference stopped at t = {time:.4g} s: its steps vanish")
                end = stop if step == stop - t else t + step
                now = int(np.searchsorted(self.instants, end, side="right"))
                samples = _motion_at(x, self.instants[done:now, None] - t)
                solution[:, done:now, moving] = samples * self.units
                motion = _motion_at(x, within * step)
                largest = np.maximum(largest, np.abs(motion).max(axis=(1, 2)))
                last = motion[:, -1]
                state[:, moving] = np.where(np.abs(last) <= NEGLIGIBLE, 0, last)
                t = end
                done = now
        return solution, np.asarray(largest * self.units[:, 0, 0], dtype=float)

    def _moving(self, state: Longs, before: slice, order: int) -> slice:
        """Return the grains that move, widened on either side by the reach of a series."""
        moving = before.start + np.flatnonzero(state[:, before].any(axis=0))
        if self.wave:
            # A grain with an applied force counts as moving even while it rests.
            first = state.shape[1] - 1 if self.from_below else self.pushed or 0
            moving = np.union1d(moving, first).astype(int)
        first, last = (moving[0], moving[-1]) if moving.size else (0, 0)
        # The motion reaches one more grain with every two orders of the series, or with every order
        # if forces depend on velocities.
        reach = order if self.viscosity.any() else order // 2
        return slice(max(0, first - reach), min(state.shape[1], last + 1 + reach))

    def _shut(self, overlap: Longs, grains: slice, tolerance: float) -> NDArray[np.bool_]:
        """Return a mask of contacts whose force is not negligible for one unit of time."""
        contacts = _contacts(grains)
        impulse = self.push[contacts] * (1 + self.viscosity[contacts])
        return impulse * np.maximum(overlap, 0) ** self.delta > tolerance

    def _series(
        self, t: Long, state: Longs, grains: slice, series: TaylorSettings
    ) -> tuple[Longs, Longs]:
        """Return coefficients of displacements (order + 1, n) and overlaps (..., n + 1)."""
        order = series.order
        contacts = _contacts(grains)
        closer = self.closer[contacts]
        at_rest = self.at_rest[contacts]
        strength = self.strength[contacts]
        viscosity = self.viscosity[contacts]
        drag = self.drag[grains]
        x = np.zeros((order + 1, state.shape[1]), dtype=Long)
        y = np.zeros((order + 1, closer.size), dtype=Long)
        power = np.zeros_like(y)
        x[:2] = state
        wall, base = np.zeros((2, order + 1), dtype=Long)
        # The columns of grains that move by the equation of motion; a drive imposes the others.
        free = slice(None)
        outside = np.zeros_like(x)
        if self.driven and grains.start == 0:
            x[:, 0] = self._imposed(t, order) / self.length
            free = slice(1, None)
        elif self.from_below and grains.stop == self.drag.size:
            base = self._imposed(t, order) / self.length
            if self.held:
                x[:, -1] = base
                free = slice(-1)
        elif self.walled and grains.start == 0:
            wall = self._imposed(t, order) / self.length
        elif self.pushed is not None:
            outside[:, self.pushed - grains.start] = self._imposed(t, order)
        k = np.arange(order + 1, dtype=Long)
        change = np.zeros_like(y)
        for i in range(order + 1):
            y[i] = -np.diff(x[i], prepend=wall[i], append=base[i]) * closer
            if i == order:
                break
            if i == 0:
                strain = y[0].copy()
                y[0] = at_rest + y[0]
                shut = self._shut(y[0], grains, series.tolerance)
                pressed = shut & (at_rest > 0)
                overlap = np.where(shut, y[0], 1)
                power[0] = shut * overlap**self.delta
                exact = np.expm1(self.delta * np.log1p(np.where(pressed, strain, 0)))
                change[0] = np.where(pressed, exact, power[0] - at_rest)
                continue
            # The recursion follows from the identity y (y^delta)' = delta y' y^delta.
            weight = (self.delta + 1) * k[1 : i + 1] - i
            total = np.einsum("j,jn,jn->n", weight, y[1 : i + 1], power[i - 1 :: -1])
            change[i] = power[i] = shut * total / (i * overlap)
            # The viscous force contains the next power of the elastic force.
            force = strength * (change[i - 1] + viscosity * i * change[i])
            pull = (force[:-1] - force[1:] + outside[i - 1]) * self.mobility[grains]
            following = pull / (i * (i + 1)) - drag * x[i] / (i + 1)
            x[i + 1, free] = following[free]
        return x, y

    def _imposed(self, t: Long, order: int) -> Longs:
        """Return the series coefficients of the imposed motion, m, or force, N, (order + 1,)."""
        wave = self.wave
        k = np.arange(order + 1, dtype=Long)
        assert wave
        series = np.zeros_like(k)
        if wave.spline is None:
            if self.knots.size == 0 or t < self.knots[0]:
                quarter = 2 * np.arctan(Long(1))
                factorial = np.cumprod(np.maximum(k, 1))
                for amplitude, omega in self.sines:
                    scaled = omega * self.time
                    series += amplitude * scaled**k * np.sin(scaled * t + k * quarter) / factorial
            return series
        piece = min(int(np.searchsorted(self.knots, t, side="right")), self.knots.size - 1) - 1
        c = wave.spline.c[::-1, piece].astype(Long) * self.time ** k[:4]
        z = t - self.knots[piece]
        series[:4] = [
            sum(math.comb(j, m) * c[j] * z ** (j - m) for j in range(m, 4)) for m in range(4)
        ]
        return series

    def _step(self, x: Longs, y: Longs, grains: slice, longest: Long, tolerance: float) -> Long:
        """Return the step within which the series converge and no contact opens or closes."""
        step = longest
        order = len(x) - 1
        for k in (order - 1, order):
            last = np.abs(x[k]).max()
            if last > 0:
                # These are the terms of this order in displacement and in velocity.
                displacement = (tolerance / last) ** (1 / Long(k))
                velocity = (tolerance / (k * last)) ** (1 / Long(k - 1))
                step = min(step, displacement, velocity)
        contacts = _contacts(grains)
        push = self.push[contacts]
        viscosity = self.viscosity[contacts]
        shut = self._shut(y[0], grains, tolerance)
        change = _at(np.abs(y), step) - np.abs(y[0])
        felt = push * (np.abs(y[0]) + change) ** self.delta * (step + viscosity) > tolerance
        for contact in np.flatnonzero(felt & (np.where(shut, y[0], -y[0]) <= change)):
            overlap = y[:, contact]
            if shut[contact]:
                step = min(step, _first_root(overlap, step))
            elif (root := _first_root(-overlap, step)) < step:
                strength = push[contact], viscosity[contact]
                step = root + self._unfelt(overlap, root, step - root, strength, tolerance)
        return step

    def _unfelt(
        self,
        overlap: Longs,
        root: Long,
        longest: Long,
        strength: tuple[Long, Long],
        tolerance: float,
    ) -> Long:
        """Return the time, up to `longest`, for which a contact closing at `root` is negligible.

        `strength` is the coefficient of the force of the contact and its relaxation time, in the
        units of `_Motion`.
        """
        push, viscosity = strength
        depth = np.maximum(_at(overlap, root), 0)
        rate = np.maximum(_at(_slope(overlap), root), 0)
        after = longest
        while True:
            deepest = depth + after * (rate + after * _bend(overlap, root + after) / 2)
            elastic = deepest**self.delta * after
            # The integral of A dF/dt over a time is A times the change of the force.
            viscous = viscosity * (deepest**self.delta - depth**self.delta)
            if push * (elastic + viscous) <= tolerance:
                return after
            after /= 2


def _exact_sines(excitation: Any) -> list[tuple[Long, Long]]:
    """Return amplitudes and frequencies, rad/s, of imposed sines, as exact as in the scene."""
    wave = excitation.waveform
    if wave is None or wave.spline is not None:
        return []
    pi = 4 * np.arctan(Long(1))
    frequency = excitation.frequency
    exact = pi / Long(excitation.duration) if frequency is None else 2 * pi * Long(frequency)
    return [
        (Long(amplitude), Long(omega) * (exact / Long(wave.omega)))
        for amplitude, omega in wave.sines
    ]


def _contacts(grains: slice) -> slice:
    """Return the slice of contacts on both sides of these grains."""
    return slice(grains.start, grains.stop + 1)


def _first_root(gap: Longs, end: Long) -> Long:
    """Return a lower bound of the first root of a polynomial: the root itself, or at least `end`.

    Newton's method uses a bound on the second derivative, so that it never steps over a root.
    """
    slope = _slope(gap)
    bend = _bend(gap, end)
    at = Long(0)
    # If 60 iterations do not converge, the step ends before the root.
    for _ in range(60):
        height = np.maximum(_at(gap, at), 0)
        rate = _at(slope, at)
        # This is the root of the lower bound height + rate z - bend z^2 / 2.
        root = np.sqrt(rate**2 + 2 * bend * height)
        ahead = (rate + root) / bend if rate > 0 else 2 * height / ((root - rate) or 1)
        at += ahead
        if at >= end or ahead <= 2 * EXTENDED * at:
            break
    return at


def _slope(series: Longs) -> Longs:
    """Return the coefficients of the derivative of power series."""
    return series[1:] * np.arange(1, len(series)).reshape(-1, *[1] * (series.ndim - 1))


def _bend(series: Longs, end: Long) -> Long:
    """Return a positive upper bound of the second derivative of a series between 0 and `end`."""
    # The constant 1e-200 avoids division by 0 and is negligible.
    return _at(np.abs(_slope(_slope(series))), end) + 1e-200


def _at(series: Longs, tau: Longs | Long) -> Any:
    """Evaluate power series at tau."""
    total = series[-1]
    for term in series[-2::-1]:
        total = term + tau * total
    return total


def _motion_at(x: Longs, tau: Longs | Long) -> Longs:
    """Return displacements and velocities at the time tau within a step, from their series."""
    return np.array([_at(x, tau), _at(_slope(x), tau)])
