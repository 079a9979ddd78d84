"""Time integration in plain NumPy and 80-bit numbers, written from the publications alone.

The methods share only Eq. (1) with the package. Arrays may have axes before the axis of the grains,
one entry for each of several chains; differences of their results are derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from helpers.forcing import Curve
from numpy.typing import NDArray
from scipy.integrate import DOP853

from lmpchain import Scene
from lmpchain.integrators.methods import Splitting

WIDE = np.longdouble
Array = NDArray[np.longdouble]
# A function of time (s), derivative order, and a time that selects the piece.
Course = Callable[..., Any]


class Column(NamedTuple):
    """Properties of N grains: masses (..., N), contact constants and forces (..., N+1)."""

    masses: Array
    constants: Array
    forces: Array
    displacement: Array
    velocity: Array
    drive: Array  # Amplitude and frequency of the forcing, or its samples (..., P).
    scene: Scene


def column_of(scene: Scene) -> Column:
    """Return the properties of a scene in extended precision."""
    chain = scene.chain
    excitation = scene.excitation
    above, below = chain.wall_constants
    constants = np.array([above, *chain.contact_constants, below], dtype=WIDE)
    carried = WIDE(chain.top_load) + WIDE(chain.gravity) * np.append(
        WIDE(0), np.cumsum(chain.masses.astype(WIDE))
    )
    u, v = (field.astype(WIDE) for field in scene.initial())
    drive: Any = []
    if excitation.does_work and excitation.times is not None:
        drive = getattr(excitation, excitation.strength[1])
    elif excitation.does_work:
        half = excitation.frequency is None
        drive = [excitation.amplitude, 0.5 / excitation.duration if half else excitation.frequency]
    masses = chain.masses.astype(WIDE)
    return Column(
        masses,
        constants,
        np.where(constants > 0, carried, 0),
        u,
        v,
        np.array(drive, dtype=WIDE),
        scene,
    )


def course_of(excitation: Any, drive: Array) -> Course | None:
    """Return the imposed motion or force as a function of time."""
    if not excitation.does_work:
        return None
    if excitation.times is not None:
        rows = drive.reshape(-1, drive.shape[-1])
        curves = [Curve(excitation, row, WIDE) for row in rows]
        knots = curves[0].knots
        pieces = np.array([curve.pieces[::-1] for curve in curves])
        pieces = pieces.reshape(*drive.shape[:-1], 4, knots.size - 1)

        def spline(t: Any, order: int, inside: Any = None) -> Any:
            piece = min(max(int(np.searchsorted(knots, t, side="right")) - 1, 0), knots.size - 2)
            s = t - knots[piece]
            (a, b, c, d) = np.moveaxis(pieces[..., piece], -1, 0)
            return (3 * a * s + 2 * b) * s + c if order else ((a * s + b) * s + c) * s + d

        return spline
    turn = 8 * np.arctan(WIDE(1))
    size = drive[..., 0]
    omega = turn * drive[..., 1]
    cycles = excitation.cycles
    end = WIDE(np.inf) if cycles is None else WIDE(cycles) / WIDE(excitation.frequency)
    if excitation.frequency is None:
        end = WIDE(excitation.duration)

    def sine(t: Any, order: int, inside: Any = None) -> Any:
        if (t if inside is None else inside) >= end:
            return 0 * size
        wave = size * np.sin(omega * t)
        rate = size * omega * np.cos(omega * t)
        if cycles is None:
            return rate if order else wave
        slow = omega / (2 * WIDE(cycles))
        hann = np.sin(slow * t) ** 2
        slope = slow * np.sin(2 * slow * t)
        return rate * hann + wave * slope if order else wave * hann

    return sine


class Motion:
    """Eq. (1) of a column: accelerations, and the motion of driven bodies."""

    def __init__(self, made: Column):
        excitation = made.scene.excitation
        chain = made.scene.chain
        self.x = made.displacement
        self.v = made.velocity
        self.masses = made.masses
        self.constants = made.constants
        self.carried = made.forces
        self.delta = WIDE(chain.exponent)
        self.pressed = made.scene.chain.contacts.pressed
        positive = np.where(made.constants > 0, made.constants, 1)
        overlap = np.where(self.pressed, made.forces / positive, 1) ** (1 / self.delta)
        self.length = np.where(self.pressed, overlap, 1)
        self.course = course_of(excitation, made.drive)
        self.wall = self.course is not None and excitation.kind == "drive" and excitation.grain == 0
        self.driven = (
            self.course is not None and excitation.kind == "drive" and excitation.grain == 1
        )
        self.pushed = (
            excitation.grain if self.course is not None and excitation.kind == "force" else 0
        )
        # Time that selects the branch of the forcing; None for the current time.
        self.inside: Any = None
        # Force of a ground on every grain, N, as a function of displacements and time.
        self.ground: Callable[[Array, Any], Array] | None = None
        self.mobile = np.ones(chain.grains, dtype=WIDE)
        self.mobile[chain.movable :] = 0
        if self.driven:
            self.mobile[0] = 0
            self.v = self.v.copy()
            self.v[..., 0] = 0

    def closer(self, x: Array, t: Any) -> Array:
        """Return the decrease of distances between bodies from rest, (..., N+1) m."""
        bodies = np.zeros((*x.shape[:-1], x.shape[-1] + 2), dtype=WIDE)
        bodies[..., 1:-1] = x
        if self.wall or self.driven:
            bodies[..., int(self.driven)] = self.course(t, 0, self.inside)
        return bodies[..., :-1] - bodies[..., 1:]

    def contact_forces(self, x: Array, t: Any) -> Array:
        """Return the contact forces minus the forces at rest, (..., N+1) N."""
        r = self.closer(x, t)
        s = r / self.length
        shut = s > -1
        held = np.where(shut, np.expm1(self.delta * np.log1p(np.where(shut, s, 0))), -1)
        loose = self.constants * np.maximum(r, 0) ** self.delta
        return np.where(self.pressed, self.carried * held, loose)

    def acceleration(self, x: Array, t: Any) -> Array:
        """Return x'' (..., N); it is 0 for a fixed or driven grain."""
        force = self.contact_forces(x, t)
        pull = force[..., :-1] - force[..., 1:]
        if self.pushed:
            pull[..., self.pushed - 1] += self.course(t, 0, self.inside)
        if self.ground:
            pull = pull - self.ground(x, t)
        return self.mobile * pull / self.masses

    def seen(self, x: Array, v: Array, t: Any) -> Array:
        """Return displacements and velocities (2, ..., N) of all grains."""
        state = np.array([x, v])
        if self.driven:
            state[0, ..., 0] = self.course(t, 0)
            state[1, ..., 0] = self.course(t, 1)
        return state


def by_splitting(motion: Motion, method: Splitting, steps: Iterable[Any]) -> Array:
    """Return the states (K+1, 2, ..., N) after steps of these lengths, s."""
    x = motion.x
    v = motion.v
    t = WIDE(0)
    states = [motion.seen(x, v, t)]
    for h in steps:
        reach = WIDE(0)
        for kick, drift in zip(method.kicks, (*method.drifts, 0.0), strict=True):
            v = v + WIDE(kick) * h * motion.acceleration(x, t + reach * h)
            x = x + WIDE(drift) * h * v
            reach = reach + WIDE(drift)
        t = t + h
        states.append(motion.seen(x, v, t))
    return np.array(states)


class DormandPrinceStep(NamedTuple):
    """The changes of displacement and velocity (N,) in a step, with two error estimates.

    The error estimates are of orders 5 and 3.
    """

    x: Array
    v: Array
    errors: Array  # Shape (2, 2, N): both orders, displacement and velocity.


def dormand_prince_step(motion: Motion, x: Array, v: Array, t: Any, h: Any) -> DormandPrinceStep:
    """Return a step of DOP853 for y' = f(t, y) with y = (x, v)."""
    slopes_x, slopes_v = np.zeros((2, 12, x.size), dtype=WIDE)
    for stage in range(12):
        inner = DOP853.A[stage, :stage].astype(WIDE)
        slopes_x[stage] = motion.mobile * (v + h * inner @ slopes_v[:stage])
        slopes_v[stage] = motion.acceleration(
            x + h * inner @ slopes_x[:stage], t + DOP853.C[stage] * h
        )
    weights = DOP853.B.astype(WIDE)
    errors = [[h * e[:12] @ slopes_x, h * e[:12] @ slopes_v] for e in (DOP853.E5, DOP853.E3)]
    return DormandPrinceStep(h * weights @ slopes_x, h * weights @ slopes_v, np.array(errors))


def by_dormand_prince(motion: Motion, steps: Iterable[Any]) -> Array:
    """Return the states (K+1, 2, N) after steps of these lengths, s."""
    x = motion.x
    v = motion.v
    t = WIDE(0)
    states = [motion.seen(x, v, t)]
    for h in steps:
        step = dormand_prince_step(motion, x, v, t, h)
        x = x + step.x
        v = v + step.v
        t = t + h
        states.append(motion.seen(x, v, t))
    return np.array(states)


PASCAL = np.array(
    [[1, 1, 1, 1, 1], [0, 1, 2, 3, 4], [0, 0, 1, 3, 6], [0, 0, 0, 1, 4], [0, 0, 0, 0, 1]],
    dtype=WIDE,
)
# Coefficients of Gear's method for x'' = a(x).
CORRECTIONS = np.array([WIDE(19) / 120, WIDE(3) / 4, 1, WIDE(1) / 2, WIDE(1) / 12])


def _gear_start(motion: Motion, x: Array, v: Array, t: Any, h: Any) -> Array:
    """Return x^(k) h^k / k!, (5, N), from accelerations one step before and after.

    Half a step after stands for that before if contacts are open then that are not now.
    """
    motion.inside = t + WIDE(1e-9) * h
    now = motion.acceleration(x, t)

    def moved(side: Any) -> tuple[Array, Any]:
        return x + side * h * v + (side * h) ** 2 / 2 * now, t + side * h

    open_now, open_before = (
        motion.closer(*at) <= -motion.length * motion.pressed for at in ((x, t), moved(-1))
    )
    after = motion.acceleration(*moved(1))
    if ((open_now == open_before) | (motion.constants == 0)).all():
        before = motion.acceleration(*moved(-1))
        slope = (after - before) / 2
        bend = before - 2 * now + after
    else:
        half = motion.acceleration(*moved(WIDE(0.5)))
        slope = 4 * half - after - 3 * now
        bend = 4 * (after - 2 * half + now)
    motion.inside = None
    return np.array([x, h * v, h**2 * now / 2, h**2 * slope / 6, h**2 * bend / 24])


def by_gear(motion: Motion, steps: Iterable[Any]) -> Array:
    """Return the states (K+1, 2, N); the method restarts when the step changes."""
    x = motion.x
    v = motion.v
    t = WIDE(0)
    before = None
    states = [motion.seen(x, v, t)]
    for h in steps:
        if before is None or abs(h - before) > 1e-9 * h:
            table = _gear_start(motion, x, v, t, h)
        table = PASCAL @ table
        off = h**2 / 2 * motion.acceleration(table[0], t + h) - table[2]
        table = table + np.multiply.outer(CORRECTIONS, off)
        if motion.driven:  # The position follows from the forcing.
            table[:, 0] = 0
            table[0, 0] = motion.course(t + h, 0)
        x = table[0]
        v = table[1] / h
        t = t + h
        before = h
        states.append(motion.seen(x, v, t))
    return np.array(states)
