"""A scene as an ODE problem for general solvers, and the common form of solutions.

Displacements and velocities in units of the largest excursion and of the time scale of the chain,
so that a weak wave keeps all its digits and tolerances mean the same in every scene. Only the state
at the end is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np

from lmpchain import InputError, Scene
from lmpchain.benchmark.reference import Reference
from lmpchain.util.arrays import Array

TOLERANCES = (10.0 ** -np.arange(1, 16.1, 0.25)).tolist()
FASTMATH = {"nnan", "ninf", "nsz", "contract"}


@dataclass(frozen=True)
class Answer:
    """The solution of one code.

    Attributes
    ----------
    displacement, velocity : (N,) arrays
        At the end, m and m/s; positive downward.
    seconds : float
        Of the integration: without compiling and setting up.
    force_evaluations : int, optional
        Of all grains, where the code counts them.
    whole_s : float, optional
        Of the whole call, where it does more than integrate.
    """

    displacement: Array
    velocity: Array
    seconds: float
    force_evaluations: int | None = None
    whole_s: float | None = None


@dataclass(frozen=True)
class Code:
    """One code with its settings, run at a series of parameters: a curve of the chart.

    Attributes
    ----------
    name, version : str
    parameters : sequence of float
        Tolerances or steps (s), from the cheapest on.
    solve : callable
        (problem, parameter) -> Answer; the first call may compile.
    """

    name: str
    version: str
    parameters: Sequence[float]
    solve: Callable[[Problem, float], Answer]


@dataclass(frozen=True, eq=False)
class Problem:
    """Eq. (1) for a scene in which M grains move below a free top.

    Attributes
    ----------
    scene : Scene
        With two samples, at the start and at the end.
    closer, strength : (M,) arrays
        Of contact n: ``x_n - x_(n+1)`` times closer is the change of its overlap over that at rest,
        s, and ``(1 + s)^(3/2) - 1`` times strength is the change of its force over the mass of a
        grain.
    start : (2M,) array
        Displacements, then velocities.
    duration : float
    length, time : float
        The units, m and s.

    Raises
    ------
    InputError
        If the scene is not of the kind that all codes here can do.
    """

    scene: Scene

    def __post_init__(self) -> None:
        chain = self.scene.chain
        scene = self.scene
        uniform = np.ptp(chain.masses) == 0 and np.ptp(chain.contact_constants) == 0
        if not (
            uniform and chain.exponent == 1.5 and chain.top == "free" and chain.bottom == "fixed"
        ):
            raise InputError(
                [
                    (
                        "chain",
                        "must be uniform, Hertzian, free at the top and fixed at the bottom here",
                    )
                ]
            )
        if not chain.gravity or chain.top_load or scene.drive:
            raise InputError([("scene", "must have gravity, no top load and no drive here")])
        object.__setattr__(
            self,
            "scene",
            Scene(chain=chain, excitation=scene.excitation, duration=scene.duration, samples=2),
        )

    @cached_property
    def time(self) -> float:
        """Unit of time, s."""
        return self.scene.chain.time_scale

    @cached_property
    def length(self) -> float:
        """Unit of length, m."""
        u, v = self.scene.initial()
        return float(max(np.abs(u).max(), np.abs(v).max() * self.time))

    @property
    def duration(self) -> float:
        """Duration in units of time."""
        return self.scene.duration / self.time

    @property
    def start(self) -> Array:
        """Initial state, (2M,)."""
        moving = self.scene.chain.movable
        u, v = self.scene.initial()
        return np.concatenate((u[:moving] / self.length, v[:moving] * (self.time / self.length)))

    @property
    def closer(self) -> Array:
        """Overlaps in excess of rest, (M,)."""
        return self.length / self.scene.chain.equilibrium_overlap

    @property
    def strength(self) -> Array:
        """Strengths of the contacts, (M,)."""
        chain = self.scene.chain
        return chain.equilibrium_force * (self.time**2 / (chain.masses[0] * self.length))

    def answer(self, state: Array, seconds: float, force_evaluations: int | None = None) -> Answer:
        """Convert a state (2M,) to SI units, with the fixed grain."""
        u, v = np.pad(np.reshape(state, (2, -1)), ((0, 0), (0, 1)))
        return Answer(u * self.length, v * (self.length / self.time), seconds, force_evaluations)

    def table(self) -> Array:
        """Return the arguments of `fill_rate`.

        M, its call count, closer, strength, room for forces.
        """
        moving = self.scene.chain.movable
        return np.concatenate(([moving, 0.0], self.closer, self.strength, np.zeros(moving)))

    def cut(self, grains: int) -> Problem:
        """Return the problem restricted to grains 1 ... `grains`."""
        return Problem(self.scene.part(1, grains))


def error(answer: Answer, solution: Reference) -> float:
    """Return the error as lmpchain defines it, over the two samples.

    Larger of displacement and velocity.

    Grains below those of a chain that was cut count as at rest.
    """
    missing = solution.displacement.shape[1] - answer.displacement.size
    pairs = ((answer.displacement, solution.displacement), (answer.velocity, solution.velocity))
    both = [
        np.abs(np.pad(x, (0, missing)) - true[-1]).max() / np.abs(true).max() for x, true in pairs
    ]
    return float(max(both)) if np.isfinite(both).all() else math.inf


@numba.njit(error_model="numpy", fastmath=FASTMATH)
def fill_rate(y, rate, table):
    """Fill the rate (2M,) of a state y (2M,).

    Forces as differences from rest that do not cancel.
    """
    moving = int(table[0])
    table[1] += 1.0
    closer, strength, force = (
        table[2 : 2 + moving], table[2 + moving : 2 + 2 * moving],
        table[2 + 2 * moving : 2 + 3 * moving]
    )  # fmt: skip
    x = y[:moving]
    gain = rate[moving:]
    last = moving - 1
    below = x[1:]
    for n in range(last):
        force[n] = strength[n] * _relative_force((x[n] - below[n]) * closer[n])
    force[last] = strength[last] * _relative_force(x[last] * closer[last])
    rate[:moving] = y[moving:]
    gain[0] = -force[0]
    push = force[1:]
    inner = gain[1:]
    for n in range(last):
        inner[n] = force[n] - push[n]


@numba.njit(error_model="numpy", fastmath=FASTMATH)
def _relative_force(s):
    s = s if s > -1.0 else -1.0
    u = math.sqrt(1.0 + s) - 1.0
    u += 0.5 * ((s - 2.0 * u) - u * u)  # This step restores the digits lost in 1 + s.
    return u * (3.0 + u * (3.0 + u))
