"""Waves in resonance: the motion that two waves drive in a third by the curvature of the force law.

Beside its stiffness k times the change s of its overlap D, a contact has the force k (delta - 1)
s^2 / (2 D), so two waves of frequencies a and b force every mode at a + b and |a - b|. A mode of
frequency w answers with the amplitude force / (2 w) times min(t, 2 / |w - a - b|). In many grains
so many answers go at random; in a few, modes fit each other by chance, and then the answer grows
for as long as they do.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ...scene.scene import Scene
from ...util.arrays import Array

# grains up to which all pairs of waves are gone through; analysis/calibration/linear_openings.py
FEW = 12


class Resonance:
    """Motion that pairs of waves drive in a chain of few grains, to leading order in their strain.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene):
        self._scene = scene

    def motion(self, time: float) -> Array:
        """Return its largest displacement and velocity by a time; 0 in more than `FEW` grains.

        Parameters
        ----------
        time : float
            s.

        Returns
        -------
        (2,) array
            m and m/s.
        """
        chain = self._scene.chain
        driven = self._scene.excitation.driven
        if not driven < chain.movable <= chain.grains <= FEW or chain.exponent == 1 or time <= 0:
            return np.zeros(2)
        shape, frequency, force, missed = self._answers
        lasting = np.minimum(time, 2 / np.maximum(missed, 1 / time))
        squared = (force * lasting / (2 * frequency)) ** 2  # (P, M)
        return np.sqrt(
            [(shape**2 @ (squared * power).sum(0)).max() for power in (1.0, frequency**2)]
        )

    @cached_property
    def _answers(self) -> tuple[Array, Array, Array, Array]:
        """Modes (G, M), frequencies; by pairs (P, M) forces on modes, and by how much they miss."""
        from ...theory.modes import between

        chain = self._scene.chain
        contacts = chain.contacts
        drive = self._scene.drive
        first = self._scene.excitation.driven
        last = chain.movable
        free = slice(first, last + 1)  # a wall that moves leaves all grains free
        modes = between(contacts.stiffness[free], chain.masses[first:last])
        squeezed = -np.diff(modes.shape, axis=0, prepend=0.0, append=0.0)  # contacts by modes
        u, v = (modes.shape.T @ (modes.mass * x[first:last]) for x in self._scene.initial())
        amplitudes = u - 1j * v / modes.frequency
        waves = squeezed
        frequencies = modes.frequency
        if drive:  # it makes a steady motion, and free waves that are its opposite at t = 0
            omega = 2 * np.pi * drive.frequency
            pull = contacts.stiffness[first] * drive.amplitude * modes.shape[0]
            apart = modes.frequency**2 - omega**2
            # at resonance an answer grows for no longer than the run lasts
            narrowest = modes.frequency / self._scene.duration
            steady = pull / np.copysign(np.maximum(np.abs(apart), narrowest), apart)
            top = drive.amplitude * (np.arange(len(squeezed)) == 0)
            amplitudes = np.append(amplitudes + 1j * steady * omega / modes.frequency, 1.0)
            waves = np.column_stack((waves, squeezed @ steady + top))
            frequencies = np.append(frequencies, omega)
        waves = waves * np.abs(amplitudes)
        overlap = np.where(contacts.pressed, contacts.overlap, np.inf)[free]
        curvature = contacts.stiffness[free] / overlap
        pairs = (waves[:, :, None] * waves[:, None]).reshape(len(waves), -1).T
        # each pair comes twice, as (a, b) and (b, a): twice the force, hence the root of 2
        factor = np.sqrt(2) * (chain.exponent - 1) / 4
        forces = factor * np.abs(pairs @ (curvature[:, None] * squeezed))
        beats = [np.abs(np.add.outer(frequencies, sign * frequencies)).ravel() for sign in (1, -1)]
        missed = np.abs(np.subtract.outer(beats, modes.frequency))
        return (
            modes.shape,
            modes.frequency,
            np.tile(forces, (2, 1)),
            missed.reshape(-1, modes.frequency.size),
        )
