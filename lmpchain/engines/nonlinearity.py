"""How much is left out by linearising Eq. (1), from the overlaps along the linear solution.

A compressed contact is stiffer than one at rest: a wave of strain s, the change of the overlap over the overlap at
rest, is faster than a weak one by the fraction (delta - 1) s / 4. So it comes too early by the integral of that over
time, and a wave that is off by dt is wrong by its rate of change times dt. Reflections at a free end turn compression
into rarefaction, which makes up for it, hence the integral with its sign. Held against the nonlinear engine over
strike numbers from 1e-4 to 10, gravity from 0.1 to 10 g, exponents from 1.1 to 3, and chains that are struck at the
top, within or all over, the estimate is within a factor of 3 of the true difference up to 0.3.
"""

from __future__ import annotations

import numpy as np

from ..compiling import compiled_once
from ..fields import Array
from ..scene import Scene

EARLIEST, GROWTH, EVENLY = 0.5, 1.25, 64  # looks at the solution between samples: ever further apart, and evenly
AT_ONCE = 0.25  # of (delta - 1) s: the distortion that no phase accounts for


class Nonlinearity:
    """What the linear solution of a scene has come to, seen from time to time.

    Parameters
    ----------
    scene : Scene
    memory : array, optional
        What another one has seen, to go on from.
    """

    def __init__(self, scene: Scene, memory: Array | None = None):
        chain, contacts = scene.chain, scene.chain.contacts
        self._stiffness, self._inverse_mass = contacts.stiffness, 1 / chain.masses
        self._inverse_mass[chain.movable :] = 0.0
        self._inverse_overlap = np.divide(1.0, contacts.overlap, out=np.zeros(chain.grains + 1), where=contacts.pressed)
        self._excess = chain.exponent - 1
        nothing = np.zeros(0)  # only compiles, so that it is not timed as work
        _look(nothing, nothing, np.zeros(1), np.zeros(1), nothing)
        # time, strain and shift by then; largest strain, displacement, velocity and acceleration; largest effects of
        # the shift on displacement and velocity; a contact that opens, if any
        self.memory = np.array([0.0] * 9 + [np.nan]) if memory is None else memory.copy()

    def see(self, time: float, u: Array, v: Array, first: int = 0, recorded: bool = True) -> None:
        """Look at the solution: displacements and velocities of grains first, first + 1 ..., the others at rest.

        Looks that are not `recorded` tell how the wave has got there; errors are those of samples.
        """
        here, grains = slice(first, first + u.size + 1), slice(first, first + u.size)
        strain, *size, opened = _look(
            u, v, self._inverse_overlap[here], self._stiffness[here], self._inverse_mass[grains]
        )
        before, last, shift = self.memory[:3]
        shift += self._excess / 4 * (last + strain) / 2 * (time - before)
        self.memory[:3] = time, strain, shift
        self.memory[3:7] = np.maximum(self.memory[3:7], (abs(strain), *size))
        if recorded:
            self.memory[7:9] = np.maximum(self.memory[7:9], (abs(shift) * size[1], abs(shift) * size[2]))
        if opened >= 0 and np.isnan(self.memory[9]):
            self.memory[9] = first + opened

    @property
    def error(self) -> float:
        """Estimated relative error, as defined for a trajectory; near 1 it says no more than that."""
        time, (strain, u, v, acceleration), off = self.memory[0], self.memory[3:7], self.memory[7:9]
        if v == 0:
            return 0.0
        by_phase = float((off / (u or np.inf, v)).max())
        at_once = AT_ONCE * self._excess * strain * min(1.0, acceleration / v * time)
        return saturated(max(by_phase, at_once))

    @property
    def remark(self) -> str:
        """Why the linear solution does not hold at all, if it does not."""
        opened = self.memory[9]
        return "" if np.isnan(opened) else f"not linear here: contact {opened:.0f} opens"


@compiled_once("the check for what is not linear", 3)
def _look(u, v, inverse_overlap, stiffness, inverse_mass):
    """Return the strongest strain, the largest displacement, velocity and acceleration, and an open contact or -1."""
    largest = displacement = velocity = acceleration = before = 0.0
    opened = -1
    for n in range(u.size + 1):  # contacts; before and after these grains is one at rest
        r = (u[n - 1] if n > 0 else 0.0) - (u[n] if n < u.size else 0.0)
        strain, force = r * inverse_overlap[n], r * stiffness[n]
        if abs(strain) > abs(largest):
            largest = strain
        if strain <= -1.0:
            opened = n
        if n > 0:
            displacement, velocity = max(displacement, abs(u[n - 1])), max(velocity, abs(v[n - 1]))
            acceleration = max(acceleration, abs(before - force) * inverse_mass[n - 1])
        before = force
    return largest, displacement, velocity, acceleration, opened


def saturated(error: float) -> float:
    """Two waves that have nothing to do with each other differ by about 1, not by more."""
    return error / (1 + error)


def expected(scene: Scene) -> float:
    """Return about what the error of a linear answer will be, from the strike alone."""
    return saturated(AT_ONCE * (scene.chain.exponent - 1) * scene.strike_number)


def looks(scene: Scene) -> Array:
    """Return times, s, at which to look at a linear solution besides its samples."""
    first = EARLIEST / scene.chain.band_edge
    count = max(0, int(np.log(scene.duration / first) / np.log(GROWTH)) + 1)
    return np.union1d(first * GROWTH ** np.arange(count), np.linspace(0, scene.duration, EVENLY, endpoint=False))
