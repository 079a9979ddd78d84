"""The truth to compare with: Eq. (1) solved by an integrator and a force that no engine shares."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .errors import RunFailed
from .excitation import first_overlaps
from .fields import Array
from .scene import Scene

RTOL, LOOSER = 3e-14, 1e-12  # SciPy takes no less than 2.2e-14
OPENINGS = 6e-10  # the most that openings were seen to leave, whatever the tolerance
STEP = 0.4  # usual step times the highest frequency, as far as the estimate of the time goes


@dataclass(frozen=True, eq=False)
class Reference:
    """What other answers are measured against.

    Attributes
    ----------
    time : (T,) array
        s.
    displacement, velocity : (T, N) arrays
        Of every grain, recorded or not; from equilibrium, positive downward; m and m/s.
    error : float
        How far it may itself be off, as defined for `lmpchain.trajectory.ErrorEstimate`.
    method : str
        How it was found.
    """

    time: Array
    displacement: Array
    velocity: Array
    error: float
    method: str


def reference(scene: Scene) -> Reference:
    """Solve Eq. (1) with SciPy's DOP853, restarted at every sample (and at every point of a sampled drive).

    Lengths are in units of the largest excursion and times in units of the fastest contact, so weak waves keep all
    their digits; forces are found as differences from equilibrium, ``F_n expm1(delta log1p(s))``, which do not
    cancel. Its error is measured as the difference to a run at rtol 1e-12: about 1e-12 while contacts stay closed.
    Where contacts open, the force is only once differentiable, the step control stumbles and two runs may agree by
    chance: the error is then about 1e-10, at times 6e-10, and 6e-10 is added.

    Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section II.5.

    Raises
    ------
    RunFailed
        If the integrator gives up.
    """
    motion = _Motion(scene)
    u, v = motion.solve(RTOL)
    looser_u, looser_v = motion.solve(LOOSER)
    error = max(_difference(looser_u, u), _difference(looser_v, v)) + (OPENINGS if motion.opened else 0.0)
    method = f"SciPy's DOP853 at rtol {RTOL:g}, restarted at every sample"
    return Reference(scene.time, u, v, error, method)


def expected_seconds(scene: Scene) -> float:
    """Return about how long `reference` will take, s."""
    from .engines.stepping import stiffest_frequency

    steps = scene.samples + scene.duration * stiffest_frequency(scene) / STEP
    return 2 * 12 * float(steps) * (40e-6 + 60e-9 * scene.chain.grains)


class _Motion:
    """Eq. (1) for one scene, with `length` and `time` as units."""

    def __init__(self, scene: Scene):
        chain, contacts = scene.chain, scene.chain.contacts
        u, v = scene.excitation.largest(chain)
        self.delta, self.drive = chain.exponent, scene.drive
        self.pressed = contacts.pressed
        m, k = chain.masses, contacts.constant
        if chain.compressed:
            stiffest = float(np.sqrt((chain.linear_stiffness / np.minimum(m[:-1], m[1:])).max()))
            self.time = 1 / stiffest
        else:  # the time in which a grain crosses the overlap that the strike makes
            deepest = float(first_overlaps(chain, scene.excitation).max()) or 1.0
            self.time = float(np.sqrt(m.min() / (k.max() * deepest ** (self.delta - 1))))
        self.length = max(float(np.abs(u).max()), float(np.abs(v).max()) * self.time) or 1.0
        u, v = scene.initial()
        self.start = np.concatenate((u / self.length, v * (self.time / self.length)))
        overlap = contacts.overlap
        self.closer = np.where(self.pressed, self.length / np.where(self.pressed, overlap, 1.0), 1.0)
        self.strength = np.where(self.pressed, contacts.force, k * self.length**self.delta)
        self.mobility = self.time**2 / (m * self.length)
        self.mobility[chain.movable :] = 0.0
        self.instants = scene.time / self.time
        self.opened = not self.pressed[contacts.exists].all()

    def rate(self, t: float, y: Array) -> Array:
        """Return y' (2N,) of displacements and velocities y (2N,)."""
        x, speed = self.driven(t, y)
        s = -np.diff(x, prepend=0.0, append=0.0) * self.closer
        shut = s > -1
        if not shut[self.pressed].all():
            self.opened = True
        held = np.where(shut, np.expm1(self.delta * np.log1p(np.where(shut, s, 0.0))), -1.0)
        force = self.strength * np.where(self.pressed, held, np.maximum(s, 0.0) ** self.delta)
        return np.concatenate((speed, (force[:-1] - force[1:]) * self.mobility))

    def driven(self, t: float, y: Array) -> tuple[Array, Array]:
        """Return displacements and velocities (N,) with those of a driven grain put in their place."""
        x, speed = y.reshape(2, -1)
        if self.drive:
            x, speed = x.copy(), speed.copy()
            u, v = self.drive.motion(t * self.time)
            x[0], speed[0] = u / self.length, v * (self.time / self.length)
        return x, speed

    def solve(self, rtol: float) -> tuple[Array, Array]:
        """Return displacement and velocity, (T, N) m and m/s."""
        from scipy.integrate import DOP853

        sampled = self.drive is not None and self.drive.times is not None
        knots = (self.drive.times / self.time).tolist() if sampled else []  # type: ignore[union-attr]
        y, step, states = self.start, None, [self.start]
        for begin, end in pairwise(self.instants):
            for left, right in pairwise([begin, *(knot for knot in knots if begin < knot < end), end]):
                first = None if step is None else min(step, right - left)
                solver = DOP853(self.rate, left, y, right, rtol=rtol, atol=1e-17, first_step=first)
                while solver.status == "running":
                    if message := solver.step():
                        raise RunFailed(f"the reference gave up at t = {solver.t * self.time:.4g} s: {message}")
                    step = solver.h_abs  # what it would take next, not cut at the end
                y = solver.y
            states.append(np.concatenate(self.driven(end, y)))
        y = np.array(states).reshape(len(states), 2, -1)
        return y[:, 0] * self.length, y[:, 1] * (self.length / self.time)


def _difference(x: Array, true: Array) -> float:
    return float(np.abs(x - true).max() / (np.abs(true).max() or 1.0))
