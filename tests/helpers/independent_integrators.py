"""Two reference integrators that share only Eq. (1) with the package.

Both take a scene and return ``(u, v, error)``: displacement (T, N) m and velocity (T, N) m/s of
every grain at the recorded times, positive downward, and the `relative_error` of a second, looser
run. They compute the equilibrium themselves and integrate displacements in units of the strike, so
that weak waves keep all digits. The displacement of a driven grain is set at every evaluation of
the force, and its knots end a step. Times are those of ``scene.time``.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from helpers.forcing import Array, Curve, Sine, below_load
from helpers.taylor_series import reference
from numpy.typing import NDArray
from scipy.integrate import DOP853

if TYPE_CHECKING:
    from lmpchain import Scene

Reference = tuple[NDArray[np.float64], NDArray[np.float64], float]


class Motion:
    """Eq. (1) of one scene in units of `length` and `time`, in the precision `kind`.

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
        self.opens = np.where(pressed, -1, 0)  # Closeness at which each contact opens.
        overlap = np.where(pressed, force / np.where(pressed, stiffness, 1), 0) ** (1 / self.delta)
        self.acting, self.body = _acting(scene, kind)
        self.driven = self.acting if self.body == 1 and scene.excitation.kind == "drive" else None
        u, v = (np.asarray(a, dtype=kind) for a in scene.initial())
        farthest, fastest = (
            self.acting.largest() if self.acting else (np.abs(u).max(), np.abs(v).max())
        )
        self.pushes = scene.excitation.kind == "force"
        if self.pushes:  # Motion of a free grain in about a period.
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
        """Return the state (2, N) with a driven grain at its position at this time."""
        if self.driven:
            u, v = self.driven(t * self.time)
            state = state.copy()
            state[:, 0] = u / self.length, v * (self.time / self.length)
        return state

    def size(self, t: np.floating[Any], state: Array) -> Array:
        """Return the largest displacement and velocity in a state (2, N), and of a moving wall."""
        largest = np.abs(state).max(axis=1)
        if self.acting and self.body == 0:  # The wall moves before any grain does.
            u, v = self.acting(t * self.time)
            largest = np.maximum(largest, np.abs([u / self.length, v * (self.time / self.length)]))
        return largest

    def closeness(self, t: np.floating[Any], x: Array) -> Array:
        """Return the compression of contacts (N+1,) beyond rest, relative to rest."""
        bodies = np.zeros(x.size + 2, dtype=x.dtype)  # A wall, or nothing, is at either end.
        bodies[1:-1] = x
        if self.acting and not self.pushes:
            bodies[self.body] = self.acting(t * self.time)[0] / self.length
        return (bodies[:-1] - bodies[1:]) * self.closer

    def acceleration(self, t: np.floating[Any], x: Array) -> Array:
        """Return x'' (N,) for displacements x (N,) at time t; 0 for fixed and driven grains."""
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
        """Yield begin and end of every smooth time interval, and whether it ends at a sample."""
        for begin, end in pairwise(self.instants):
            inside = self.knots[(self.knots > begin) & (self.knots < end)]
            for left, right in pairwise([begin, *inside, end]):
                yield left, right, right == end

    def in_si(self, states: list[Array]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Convert (2, N) states to displacement and velocity (T, N) in m and m/s."""
        x = np.array(states)
        return (x[:, 0] * self.length).astype(float), (x[:, 1] * (self.length / self.time)).astype(
            float
        )


def _acting(scene: Scene, kind: type[np.floating[Any]]) -> tuple[Sine | Curve | None, int]:
    """Return the forcing after t = 0, or None, and its body; body 0 is the wall above grain 1."""
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
    """Return the larger of the relative errors max|x - x_ref| / max|x_ref| of both fields."""
    pairs = ((u, u_ref), (v, v_ref))
    return max(float(np.abs(np.asarray(x) - ref).max() / np.abs(ref).max()) for x, ref in pairs)


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
                step = solver.h_abs  # The next step, if it were not cut at the sample.
            state = motion.at(end, solver.y.reshape(2, grains))
            y = state.ravel()
            if sampled:
                states.append(state)
        return motion.in_si(states)

    u, v = run(3e-14)
    return u, v, relative_error(*run(1e-12), u, v)


def extended_reference(scene: Scene, tolerance: float = 1e-19) -> Reference:
    """Integrate with Taylor series in extended precision, to this error tolerance per step.

    The error given is the distance to a looser solution of another order; see `taylor_series`.
    """
    found, error = reference(scene, tolerance)
    return found.displacement, found.velocity, error
