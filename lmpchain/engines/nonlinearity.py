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
FAINTEST = 0.01  # of what a strike distorts at once: what is left of it wherever it is recorded
DOUBT, WANDER = 3.0, 0.5  # the true error over the estimate along the solution; over the strain and root of periods
UNLUCKY = 16.0  # over the number of samples: how much smaller than between them the wave may be in all of them


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
        self._fastest = chain.band_edge
        # time, strain and shift by then; largest strain, displacement, velocity and acceleration; largest effects of
        # the shift on displacement and velocity; a contact that opens, if any; largest displacement and velocity in
        # samples
        self.memory = np.array([0.0] * 9 + [np.nan, 0.0, 0.0]) if memory is None else memory.copy()

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
            self.memory[10:] = np.maximum(self.memory[10:], size[:2])
        if opened >= 0 and np.isnan(self.memory[9]):
            self.memory[9] = first + opened

    @property
    def error(self) -> float:
        """Estimated relative error, as defined for a trajectory; near 1 it says no more than that."""
        time, (strain, _, v, acceleration), off = self.memory[0], self.memory[3:7], self.memory[7:9]
        if v == 0:
            return 0.0
        by_phase = float((off / self._sampled).max())
        at_once = AT_ONCE * self._excess * strain * min(1.0, acceleration / v * time) * self._missed
        return saturated(max(by_phase, at_once))

    @property
    def at_most(self) -> float:
        """A bound on that error: phases may wander either way where a wave goes to and fro or a drive adds to it.

        Measured on 400 random scenes with up to 500 periods, of every excitation.
        """
        wandering = (
            WANDER * self._excess * self.memory[3] * (1 + np.sqrt(self._fastest * self.memory[0])) * self._missed
        )
        return min(1.0, max(DOUBT * self.error, float(wandering)))

    @property
    def _sampled(self) -> Array:
        """Largest displacement and velocity in samples, to which errors are relative."""
        return np.where(self.memory[10:] > 0, self.memory[10:], np.inf)

    @property
    def _missed(self) -> float:
        """How much larger the wave was between samples, if few of them fell where it was small."""
        return max(1.0, float((self.memory[4:6] / self._sampled).max()))

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


def strain_bound(scene: Scene) -> float:
    """Return a bound on the strain of every contact in the linear chain, from the energy that is put in.

    A driven grain does work: ``d sqrt(2 E) / dt <= sqrt(k_1) |v_1|``.
    """
    if not scene.drive:
        return scene.largest_strain
    contacts, drive = scene.chain.contacts, scene.drive
    path = drive.amplitude * (1 + 4 * drive.frequency * scene.duration)
    weakest = (np.sqrt(contacts.stiffness) * contacts.overlap)[contacts.pressed].min()
    return float(np.sqrt(contacts.stiffness[1]) * path / weakest)


def bounds(scene: Scene) -> tuple[float, float]:
    """Return what the error of a linear answer surely exceeds and what it stays below, from the strike alone.

    The upper bound takes the largest strain for that of the whole time, as if the shift of phase grew without end: far
    too much for a wave that spreads out, about right for a few grains that are hit hard. It is 1 where contacts may
    open.
    """
    excess, strain = scene.chain.exponent - 1, strain_bound(scene)
    least = FAINTEST * saturated(AT_ONCE * excess * scene.strike_number)
    if not strain < 1:
        return least, 1.0
    periods = scene.chain.band_edge * scene.duration
    return least, min(1.0, AT_ONCE * excess * strain * (1 + periods) * (1 + UNLUCKY / scene.samples))


def looks(scene: Scene) -> Array:
    """Return times, s, at which to look at a linear solution besides its samples."""
    first = EARLIEST / scene.chain.band_edge
    count = max(0, int(np.log(scene.duration / first) / np.log(GROWTH)) + 1)
    return np.union1d(first * GROWTH ** np.arange(count), np.linspace(0, scene.duration, EVENLY, endpoint=False))
