"""References that the engines did not make: two integrators that share nothing with the package but Eq. (1).

Both take a scene and return ``(u, v, error)``: displacement (T, N) m and velocity (T, N) m/s of every grain at the
recorded times, positive downward, and how far a second, looser run came out, in the sense of `relative_error`. They
find the equilibrium from masses and contact constants themselves and integrate displacements in units of the strike,
so weak waves keep all their digits. Times are those of ``scene.time``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

if TYPE_CHECKING:
    from lmpchain import Chain, Scene

Array = NDArray[np.floating[Any]]
Reference = tuple[NDArray[np.float64], NDArray[np.float64], float]


class Motion:
    """Eq. (1) for one scene: lengths in units of `length`, times in units of `time`, in the precision `kind`.

    ``x_n'' = [f_(n-1) - f_n] / m_n`` where f_n is the force of contact n minus its equilibrium value. It is found
    as ``F_n expm1(delta log1p(s))`` with ``s = (phi_n - phi_(n+1)) / eps_n``, which does not cancel, as ``-F_n`` once
    the contact is open, and as ``K_n max(r, 0)^delta`` where nothing presses the grains together.
    """

    def __init__(self, scene: Scene, kind: type[np.floating[Any]]):
        chain = scene.chain
        if chain.top != "free" or chain.bottom not in ("fixed", "free"):
            raise NotImplementedError("the references know a free top and a fixed or free bottom")
        u, v = (np.asarray(a, dtype=kind) for a in scene.initial())
        mass, stiffness = (np.asarray(a, dtype=kind) for a in (chain.masses, chain.contact_constants))
        self.delta = kind(chain.exponent)
        force = kind(chain.top_load) + kind(chain.gravity) * np.cumsum(mass[:-1])
        overlap = (force / stiffness) ** (1 / self.delta)
        self.compressed = bool(force[0] > 0)
        self.time, self.length = _scales(chain, u, v, overlap, kind)
        self.start = np.array([u / self.length, v * (self.time / self.length)])
        self.strength = force if self.compressed else stiffness * self.length**self.delta
        self.closer = self.length / overlap if self.compressed else np.ones_like(overlap)
        self.mobility = self.time**2 / (mass * self.length)
        if chain.bottom == "fixed":
            self.mobility[-1] = 0
        self.instants = np.asarray(scene.time, dtype=kind) / self.time

    def acceleration(self, x: Array) -> Array:
        """Return x'' (N,) of the displacements x (N,)."""
        s = (x[:-1] - x[1:]) * self.closer
        if self.compressed:
            shut = s > -1
            change = np.where(shut, np.expm1(self.delta * np.log1p(np.where(shut, s, 0))), -1)
        else:
            change = np.maximum(s, 0) ** self.delta
        force = np.zeros(x.size + 1, dtype=x.dtype)
        force[1:-1] = self.strength * change
        return (force[:-1] - force[1:]) * self.mobility

    def in_si(self, states: list[Array]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return displacement and velocity (T, N) in m and m/s from (2, N) states."""
        x = np.array(states)
        return (x[:, 0] * self.length).astype(float), (x[:, 1] * (self.length / self.time)).astype(float)


def _scales(
    chain: Chain, u: Array, v: Array, overlap: Array, kind: type[np.floating[Any]]
) -> tuple[np.floating[Any], np.floating[Any]]:
    """Return the time of the fastest contact, s, and the amplitude that the strike has in that time, m."""
    mass, stiffness, delta = kind(chain.masses.min()), kind(chain.contact_constants.max()), kind(chain.exponent)
    fastest, farthest = np.abs(v).max(), np.abs(u).max()
    typical = overlap.max()
    if typical == 0:
        typical = max(farthest, (mass * fastest**2 / stiffness) ** (1 / (delta + 1)))
    time = np.sqrt(mass / (delta * stiffness * typical ** (delta - 1)))
    return time, max(farthest, fastest * time)


def relative_error(u: Array, v: Array, u_ref: Array, v_ref: Array) -> float:
    """Max over displacement and velocity of max|x - x_ref| / max|x_ref| over all samples and grains."""
    pairs = ((u, u_ref), (v, v_ref))
    return max(float(np.abs(np.asarray(x) - ref).max() / np.abs(ref).max()) for x, ref in pairs)


def _twice(run: Callable[[float], tuple[Array, Array]], tolerance: float, looser: float) -> Reference:
    """Run at both tolerances; the error is the distance between them, so that of the looser one."""
    u, v = run(tolerance)
    return u, v, relative_error(*run(looser), u, v)


def scipy_reference(scene: Scene) -> Reference:
    """Integrate with SciPy's DOP853 in double precision, restarted at every sample.

    rtol is 3e-14 (SciPy allows no less than 2.3e-14) and atol 1e-17 of the strike. The error given is the distance to
    a run at rtol 1e-12. Where no contact opens it is pessimistic, by up to the ratio of the two. Where contacts open
    the step control of either run stumbles by chance and the distance bounds nothing: trust some 1e-11 there and
    compare with `extended_reference`.
    """
    motion = Motion(scene, np.float64)
    grains = motion.start.shape[1]

    def slope(_: float, y: Array) -> Array:
        return np.concatenate((y[grains:], motion.acceleration(y[:grains])))

    def run(rtol: float) -> tuple[Array, Array]:
        y, step, states = motion.start.ravel(), None, [motion.start]
        for begin, end in zip(motion.instants[:-1], motion.instants[1:], strict=True):
            first = None if step is None else min(step, end - begin)
            solver = DOP853(slope, begin, y, end, rtol=rtol, atol=1e-17, first_step=first)
            while solver.status == "running":
                if message := solver.step():
                    raise ArithmeticError(f"DOP853: {message}")
                step = solver.h_abs  # what it would take next, not cut at the sample
            y = solver.y
            states.append(y.reshape(2, grains))
        return motion.in_si(states)

    return _twice(run, 3e-14, 1e-12)


def extended_reference(scene: Scene, tolerance: float = 1e-18) -> Reference:
    """Integrate with extrapolated Stoermer steps in extended precision (80 bits where the machine has them).

    Every step is divided into 1, 2, 3 ... equal parts and extrapolated to none at all, until two columns agree to
    `tolerance` of the largest displacement and velocity; where ten columns do not, as where a contact opens and the
    force is only once differentiable, the step shrinks. Hairer, Norsett and Wanner, Solving Ordinary Differential
    Equations I, section II.14. The error given is the distance to a run with a tolerance ten times looser, so
    pessimistic. `tolerance` is that of one step, not of the whole run: errors add up and grow with the motion, by
    some 1e4 in a strong strike.
    """
    motion = Motion(scene, np.longdouble)
    tolerance = max(tolerance, 9 * float(np.finfo(np.longdouble).eps))

    def run(loose: float) -> tuple[Array, Array]:
        state, states = motion.start, [motion.start]
        peak = np.abs(state).max(axis=1)
        step = np.longdouble(0.01)
        for begin, end in zip(motion.instants[:-1], motion.instants[1:], strict=True):
            left = end - begin
            while left > 0:
                parts = np.ceil(left / step)
                tried = left / parts
                proposal, columns = _extrapolate(motion.acceleration, state, tried, loose, peak)
                if proposal is None:
                    step = 0.4 * tried
                    if step < 1e-12:
                        raise ArithmeticError(f"no step is short enough for a tolerance of {loose:g}")
                    continue
                state = proposal
                left = left - tried if parts > 1 else 0
                peak = np.maximum(peak, np.abs(state).max(axis=1))
                if columns >= 9:
                    step = 0.8 * tried
                elif columns <= 7:
                    step = max(step, 1.5 * tried)
            states.append(state)
        return motion.in_si(states)

    return _twice(run, tolerance, 10 * tolerance)


def _extrapolate(
    acceleration: Callable[[Array], Array], state: Array, step: Array, tolerance: float, peak: Array
) -> tuple[Array | None, int]:
    """Return the state one step on and the columns it took, or None where ten were too few."""
    push = acceleration(state[0])
    row: list[Array] = []
    for parts in range(1, 11):
        above, row = row, [_stoermer(acceleration, state, push, step, parts)]
        for k in range(1, parts):
            ratio = np.longdouble(parts) / (parts - k)
            row.append(row[k - 1] + (row[k - 1] - above[k - 1]) / (ratio**2 - 1))
        if parts > 2:
            size = np.maximum(peak, np.abs(row[-1]).max(axis=1))
            if (np.abs(row[-1] - row[-2]).max(axis=1) <= tolerance * size).all():
                return row[-1], parts
    return None, 10


def _stoermer(acceleration: Callable[[Array], Array], state: Array, push: Array, step: Array, parts: int) -> Array:
    """Advance x'' = a(x) by `parts` leapfrog steps; the error holds only even powers of their length."""
    h = step / parts
    x, gain = state[0], push * (h / 2)
    for _ in range(parts):
        x = x + h * (state[1] + gain)  # summing the gain in velocity keeps its digits
        push = acceleration(x)
        gain = gain + h * push
    return np.array([x, state[1] + (gain - push * (h / 2))])
