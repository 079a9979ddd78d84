"""Scenes laid out in memory for the kernels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..scene.scene import Scene
from ..util.arrays import Array
from .kernels.contact_forces import CORRECTED, FORMS, LOOSE_POWER, POLYNOMIAL, POWER, ROOTS, SPRING
from .kernels.splitting import PAD

# analysis/calibration/roundoff.py
STRONG = 1.0  # strike number from which the fastest form of the force loses nothing
FORCES = ("auto", "exact", "plain")


class ChainBatch:
    """A batch of like chains: bodies, contacts and drives as arrays that begin at cache lines.

    Parameters
    ----------
    scenes : sequence of R scenes
        Of one kind and length.
    force : "auto", "exact" or "plain"
        Which form of the force.

    Attributes
    ----------
    table : (R, 3, W) array
        1 / length and strength of the contact below every body, and its inverse mass.
    loose : (R,) array
        Constant of a first contact that touches without pressing in a chain that is pressed otherwise, else 0.
    base : float
        1 if the chains are pressed, else 0.
    forms, shape : (R,) and (8,) arrays
        The form of the force of each, and its coefficients.
    drive, knots, pieces : arrays
        How grain 1 is moved, if it is.
    """

    def __init__(self, scenes: Sequence[Scene], force: str = "auto"):
        chains = [scene.chain for scene in scenes]
        self.scenes, self.grains = scenes, chains[0].grains
        self.driven = scenes[0].drive is not None
        contacts = [chain.contacts for chain in chains]
        overlap, carried, constant = (
            np.array([getattr(c, k) for c in contacts]) for k in ("overlap", "force", "constant")
        )
        self.base = float(chains[0].compressed)
        self.table = self._rows(3)
        held = slice(PAD - 1, PAD + self.grains)
        if chains[0].compressed:
            self.table[:, 0, held] = np.divide(1.0, overlap, out=np.zeros_like(overlap), where=overlap > 0)
            self.table[:, 1, held] = carried
            self.loose = np.where(carried[:, 0] > 0, 0.0, constant[:, 0])
        else:
            self.table[:, 0, held], self.table[:, 1, held] = 1.0, constant
            self.loose = np.zeros(len(scenes))
        self.table[:, 2, PAD : PAD + chains[0].movable] = [1 / chain.masses[: chain.movable] for chain in chains]
        if self.driven:
            self.table[:, 2, PAD] = 0.0
        self.forms = np.array([force_form(scene, force) for scene in scenes])
        self.shape = series(chains[0].exponent)
        self.drive, self.knots, self.pieces = self._drives()
        self.omega = np.array([scene.highest_frequency for scene in scenes])
        imposed = np.array([[np.abs(x).max() for x in scene.excitation.largest(scene.chain)] for scene in scenes])
        speed = np.maximum(imposed[:, 1], imposed[:, 0] * self.omega)
        self.scale = np.stack([speed / self.omega, speed], axis=1)

    def _rows(self, count: int) -> Array:
        """Return (R, count, W) zeros, or (R, W) for none, of which every row begins at a cache line."""
        width = -(-(2 * PAD + self.grains) // PAD) * PAD
        shape = (len(self.scenes), *([count] if count else []), width)
        memory = np.zeros(int(np.prod(shape)) + PAD)
        skip = -memory.ctypes.data // memory.itemsize % PAD
        return memory[skip : skip + memory.size - PAD].reshape(shape)

    def bodies(self, grains: Array | None = None) -> Array:
        """Return rows (R, W) of bodies, at rest or with these values (R, N) of the grains."""
        rows = self._rows(0)
        if grains is not None:
            rows[:, PAD : PAD + self.grains] = grains
        return rows

    def _drives(self) -> tuple[Array, Array, Array]:
        """Return how grain 1 of every chain is driven: (R, 3), (R, P) and (R, 4, P-1) arrays; see `kernels.place`."""
        drives = [scene.drive for scene in self.scenes if scene.drive]
        most = max((0 if d.times is None else len(d.times) for d in drives), default=0)
        table, knots = np.zeros((len(drives), 3)), np.zeros((len(self.scenes), most))
        pieces = np.zeros((len(self.scenes), 4, max(most - 1, 0)))
        for real, drive in enumerate(drives):
            if drive.times is None:
                table[real, :2] = drive.amplitude, 2 * np.pi * drive.frequency
            else:
                count = len(drive.spline.x)
                table[real, 2] = count
                knots[real, :count], pieces[real, :, : count - 1] = drive.spline.x, drive.spline.c
        return table, knots, pieces

    def weight(self) -> Array:
        """Return how much each contact that opens or closes changes the motion, (R, W); see `kernels._pace`."""
        inverse_mass = self.table[:, 2]
        mobility = np.maximum(inverse_mass, np.roll(inverse_mass, -1, axis=1))
        strength = self.table[:, 1].copy()
        strength[:, PAD - 1] += self.loose
        change = strength * mobility / (self.omega[:, None] ** 2.5 * self.scale[:, 1:] + 1e-300)
        return np.minimum(change, 1e150) ** 2


def series(exponent: float) -> Array:
    """Return the first seven binomial coefficients of (1 + s)^delta - 1, and delta, (8,)."""
    k = np.arange(7)
    return np.append(np.cumprod((exponent - k) / (k + 1)), exponent)


def weakest(exponent: float) -> float:
    """Return |r / length| up to which seven terms of the binomial series give every digit."""
    k = np.arange(8)
    eighth = abs(np.prod((exponent - k) / (k + 1)))
    return min(0.02, float(1e-16 * exponent / max(float(eighth), 1e-16)) ** (1 / 7))


def force_form(scene: Scene, force: str = "auto") -> int:
    """Choose the form of the force: "plain" is the fastest one, "exact" keeps the digits of the weakest wave.

    The plain form is wrong by the last digit of the force at rest, which is nothing in strong waves.
    """
    exponent = scene.chain.exponent
    roots = int(4 * exponent) if 4 * exponent in ROOTS else None
    if exponent == 1:
        return SPRING
    if not scene.chain.compressed:
        return LOOSE_POWER if roots is None else roots
    if force == "auto" and scene.largest_strain < weakest(exponent):
        return POLYNOMIAL
    if roots is not None and (force == "plain" or (force == "auto" and scene.strike_number > STRONG)):
        return roots
    return CORRECTED if exponent == 1.5 else POWER


def name_of(form: int) -> str:
    """Return what a form of the force is called."""
    return FORMS[form]
