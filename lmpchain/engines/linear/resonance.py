"""Resonance: the motion of a third wave that a pair of waves drives by the curved force law.

If the overlap D of a contact changes by s, its force has the linear part k s and the quadratic part
k c s^2 / (2 D), with the stiffness k, and c = delta - 1 for a power law (`ContactLaw.bend`).
Therefore two waves of frequencies a and b force every mode at a + b and |a - b|. A mode of
frequency w responds with the amplitude force / (2 w) times min(t, 2 / |w - a - b|). In a chain of
many grains these many responses have random phases. In a chain of few grains, modes may be in
resonance by chance, and then a response grows in time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...scene.scene import Scene
from ...util.arrays import Array
from ...util.lazy import cached_property

if TYPE_CHECKING:
    from ...theory.modes import Eigenmodes

# Largest number of grains for which all pairs of waves are computed; see
# analysis/calibration/linear_openings.py.
FEW = 12


class PairForces(NamedTuple):
    """Forces of P pairs of waves on the M modes of a chain.

    Attributes
    ----------
    shape : (G, M) array
        Modes, orthonormal in mass.
    frequency : (M,) array
        Frequencies of the modes, rad/s.
    force : (P, M) array
        Force of a pair on a mode, divided by the square root of the modal mass.
    detuning : (P, M) array
        Difference between the beat frequency of a pair and the frequency of a mode, rad/s.
    """

    shape: Array
    frequency: Array
    force: Array
    detuning: Array


class Resonance:
    """Motion driven by pairs of waves in a chain of few grains, to leading order in the strain.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene):
        self._scene = scene

    def motion(self, time: float) -> Array:
        """Return the largest displacement (m) and velocity (m/s) up to a time, (2,).

        Both are 0 in a chain of more than `FEW` grains.
        """
        chain = self._scene.chain
        driven = self._scene.excitation.driven
        free = driven < chain.movable <= chain.grains <= FEW
        if not free or not chain.contacts.bend.any() or time <= 0:
            return np.zeros(2)
        pairs = self._pairs
        # A response grows while the beat and the mode are in phase.
        lasting = np.minimum(time, 2 / np.maximum(pairs.detuning, 1 / time))
        squared = (pairs.force * lasting / (2 * pairs.frequency)) ** 2
        powers = (1.0, pairs.frequency**2)
        return np.sqrt([(pairs.shape**2 @ (squared * power).sum(0)).max() for power in powers])

    @cached_property
    def _pairs(self) -> PairForces:
        """The forces of all pairs of waves on all modes."""
        from ...theory.modes import between

        chain = self._scene.chain
        contacts = chain.contacts
        first = self._scene.excitation.driven
        last = chain.movable
        # All grains are free under a moving wall.
        free = slice(first, last + 1)
        ground = chain.ground_stiffness[first:last]
        modes = between(contacts.stiffness[free], chain.masses[first:last], ground)
        # Compression of each contact by each mode.
        squeezed = -np.diff(modes.shape, axis=0, prepend=0.0, append=0.0)
        waves, frequencies = self._waves(modes, squeezed)
        length = np.where(contacts.pressed, contacts.length, np.inf)[free]
        curvature = contacts.bend[free] * contacts.stiffness[free] / length
        products = (waves[:, :, None] * waves[:, None]).reshape(len(waves), -1).T
        # Each pair occurs twice, as (a, b) and (b, a), with twice the force, which explains the
        # root of 2.
        factor = np.sqrt(2) / 4
        forces = factor * np.abs(products @ (curvature[:, None] * squeezed))
        beats = [np.abs(np.add.outer(frequencies, sign * frequencies)).ravel() for sign in (1, -1)]
        detuning = np.abs(np.subtract.outer(beats, modes.frequency))
        return PairForces(
            shape=modes.shape,
            frequency=modes.frequency,
            force=np.tile(forces, (2, 1)),
            detuning=detuning.reshape(-1, modes.frequency.size),
        )

    def _waves(self, modes: Eigenmodes, squeezed: Array) -> tuple[Array, Array]:
        """Return the compression of each contact by each wave, and the frequencies of the waves."""
        drive = self._scene.drive
        first = self._scene.excitation.driven
        last = self._scene.chain.movable
        u, v = (modes.shape.T @ (modes.mass * x[first:last]) for x in self._scene.initial())
        amplitudes = u - 1j * v / modes.frequency
        if not drive:
            return squeezed * np.abs(amplitudes), modes.frequency
        # A drive makes a steady motion and free waves, which cancel at t = 0.
        omega = 2 * np.pi * drive.frequency
        pull = self._scene.chain.contacts.stiffness[first] * drive.amplitude * modes.shape[0]
        apart = modes.frequency**2 - omega**2
        # At resonance the growth is limited by the duration.
        narrowest = modes.frequency / self._scene.duration
        steady = pull / np.copysign(np.maximum(np.abs(apart), narrowest), apart)
        top = drive.amplitude * (np.arange(len(squeezed)) == 0)
        amplitudes = np.append(amplitudes + 1j * steady * omega / modes.frequency, 1.0)
        waves = np.column_stack((squeezed, squeezed @ steady + top))
        return waves * np.abs(amplitudes), np.append(modes.frequency, omega)
