"""Waves in resonance: the motion that two waves drive in a third by the curvature of the force law.

Beside its stiffness k times the change s of its overlap D, a contact has the force k (delta - 1) s^2 / (2 D), so two
waves of frequencies a and b force every mode at a + b and |a - b|. A mode of frequency w answers with the amplitude
force / (2 w) times min(t, 2 / |w - a - b|). In many grains so many answers go at random; in a few, modes fit each other
by chance, and then the answer grows for as long as they do.
"""

from __future__ import annotations

import numpy as np

from ...scene.scene import Scene
from ...util.arrays import Array
from ...util.cached import cached_property

FEW = 12  # grains up to which all pairs of waves are gone through; analysis/calibration/linear_openings.py


class Resonance:
    """Motion that pairs of waves drive in a chain of few grains, to leading order in their strain.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene):
        self._scene = scene

    def motion(self, time: float) -> Array:
        """Return about the largest displacement and velocity of it by a time; 0 in more than `FEW` grains.

        Parameters
        ----------
        time : float
            s.

        Returns
        -------
        (2,) array
            m and m/s.
        """
        chain, driven = self._scene.chain, self._scene.excitation.driven
        if not driven < chain.movable <= chain.grains <= FEW or chain.exponent == 1 or time <= 0:
            return np.zeros(2)
        shape, frequency, force, missed = self._answers
        grown = (
            force * np.minimum(time, 2 / np.maximum(missed, 1 / time)) / (2 * frequency)
        ) ** 2  # (P, M)
        return np.sqrt([(shape**2 @ (grown * power).sum(0)).max() for power in (1.0, frequency**2)])

    @cached_property
    def _answers(self) -> tuple[Array, Array, Array, Array]:
        """Modes (G, M), their frequencies; by pairs (P, M) the forces on them and how far they miss them."""
        from ...theory.modes import between

        chain, drive = self._scene.chain, self._scene.drive
        first, last = (
            self._scene.excitation.driven,
            chain.movable,
        )  # a wall that moves leaves all grains free
        here, contacts = slice(first, last + 1), chain.contacts
        modes = between(contacts.stiffness[here], chain.masses[first:last])
        squeezed = -np.diff(modes.shape, axis=0, prepend=0.0, append=0.0)  # contacts by modes
        u, v = (modes.shape.T @ (modes.mass * x[first:last]) for x in self._scene.initial())
        amplitudes, waves, frequencies = u - 1j * v / modes.frequency, squeezed, modes.frequency
        if drive:
            w, pull = (
                2 * np.pi * drive.frequency,
                contacts.stiffness[first] * drive.amplitude * modes.shape[0],
            )
            apart, least = modes.frequency**2 - w**2, modes.frequency / self._scene.duration
            steady = pull / np.copysign(np.maximum(np.abs(apart), least), apart)
            top = drive.amplitude * (np.arange(len(squeezed)) == 0)
            amplitudes = np.append(amplitudes + 1j * steady * w / modes.frequency, 1.0)
            waves, frequencies = (
                np.column_stack((waves, squeezed @ steady + top)),
                np.append(frequencies, w),
            )
        waves = waves * np.abs(amplitudes)
        curvature = np.zeros(len(squeezed))
        np.divide(
            contacts.stiffness[here],
            contacts.overlap[here],
            out=curvature,
            where=contacts.pressed[here],
        )
        # each pair comes twice, as (a, b) and (b, a), and adds up to twice the force, hence the root of 2
        pairs = (waves[:, :, None] * waves[:, None]).reshape(len(waves), -1).T
        forces = (
            np.sqrt(2) * (chain.exponent - 1) / 4 * np.abs(pairs @ (curvature[:, None] * squeezed))
        )
        at = [np.abs(np.add.outer(frequencies, sign * frequencies)).ravel() for sign in (1, -1)]
        return (
            modes.shape,
            modes.frequency,
            np.tile(forces, (2, 1)),
            np.abs(np.subtract.outer(at, modes.frequency).reshape(-1, modes.frequency.size)),
        )
