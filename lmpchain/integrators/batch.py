"""Chains laid out in memory for the compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property

import numpy as np

from ..scene.scene import Scene
from ..util.arrays import Array
from .kernels.contact_forces import CORRECTED, FORMS, POLYNOMIAL, POWER, ROOTS, SPRING, UNCOMPRESSED_POWER
from .kernels.layout import KNOTS, PAD, Chains

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
    uncompressed : (R,) array
        Constant of a first contact that touches without pressing in a chain that is pressed otherwise, else 0.
    precompressed : float
        1 if the chains are pressed, else 0.
    forms, coefficients : (R,) and (8,) arrays
        The form of the force of each, and the coefficients of the force.
    opening_power : float
        The force of a contact that opens goes as the overlap to this power.
    drive, knots, pieces : arrays
        How grain 1 or the top wall is moved, or a grain is pushed.
    omega : (R,) array
        Highest frequency, rad/s.
    scale : (R, 2) array
        Largest displacement and speed of the excitation, m and m/s.
    """

    def __init__(self, scenes: Sequence[Scene], force: str = "auto"):
        chains = [scene.chain for scene in scenes]
        self.scenes, self.grains = scenes, chains[0].grains
        self.imposed, self.driven = scenes[0].excitation.does_work, scenes[0].excitation.driven
        contacts = [chain.contacts for chain in chains]
        overlap, carried, constant = (
            np.array([getattr(c, k) for c in contacts]) for k in ("overlap", "force", "constant")
        )
        self.precompressed = float(chains[0].compressed)
        self.table = self._rows(3)
        held = slice(PAD - 1, PAD + self.grains)
        if chains[0].compressed:
            self.table[:, 0, held] = np.divide(1.0, overlap, out=np.zeros_like(overlap), where=overlap > 0)
            self.table[:, 1, held] = carried
            self.uncompressed = np.where(carried[:, 0] > 0, 0.0, constant[:, 0])
        else:
            self.table[:, 0, held], self.table[:, 1, held] = 1.0, constant
            self.uncompressed = np.zeros(len(scenes))
        self.table[:, 2, PAD : PAD + chains[0].movable] = [1 / chain.masses[: chain.movable] for chain in chains]
        self.table[:, 2, PAD : PAD + self.driven] = 0.0
        self.forms = np.array([force_form(scene, force) for scene in scenes])
        self.coefficients, self.opening_power = series(chains[0].exponent), chains[0].exponent
        self.drive, self.knots, self.pieces = self._imposed()
        reach = [scene.excitation.reach(scene.chain) if self.imposed else (self.grains, 1) for scene in scenes]
        self.acted = np.array(reach) + (PAD - 1)
        self.omega = np.array([scene.highest_frequency for scene in scenes])
        imposed = np.array([[np.abs(x).max() for x in scene.excitation.largest(scene.chain)] for scene in scenes])
        speed = np.maximum(imposed[:, 1], imposed[:, 0] * self.omega)
        self.scale = np.stack([speed / self.omega, speed], axis=1)

    @cached_property
    def initial(self) -> tuple[Array, Array]:
        """Displacement, m, and velocity, m/s, of every grain at t = 0, (R, N) each."""
        u, v = zip(*(scene.initial() for scene in self.scenes), strict=True)
        return np.array(u), np.array(v)

    def arrays(self, share: slice, x: Array, v: Array, history: Array, state: Array) -> Chains:
        """Return some of the chains, and where and how fast their bodies are, for the compiled loops."""
        return Chains(
            x[share], v[share], history[share], state[share], self.table[share], self.uncompressed[share],
            self.scale[share], self.forms[share], self.precompressed, self.coefficients,
            self.imposed, self.acted[share], self.drive[share], self.knots[share], self.pieces[share],
        )  # fmt: skip

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

    def _imposed(self) -> tuple[Array, Array, Array]:
        """Return what is imposed after t = 0, as (R, 6), (R, P) and (R, 4, P-1) arrays."""
        waves, size = [scene.excitation.waveform for scene in self.scenes], len(self.scenes)
        splines = [wave.spline if wave else None for wave in waves]
        knots_max = max(0 if spline is None else len(spline.x) for spline in splines)
        table, knots = np.zeros((size, 6)), np.zeros((size, knots_max))
        pieces = np.zeros((size, 4, max(knots_max - 1, 0)))
        for real, (scene, wave, spline) in enumerate(zip(self.scenes, waves, splines, strict=True)):
            if wave is None:
                continue
            first, _ = scene.excitation.reach(scene.chain)
            body = PAD + first - 1
            body = body if scene.excitation.driven else PAD - 1 if scene.excitation.wall else -body
            table[real] = wave.amplitude, wave.omega, wave.envelope, wave.end, 0.0, body
            if spline is not None:
                table[real, KNOTS] = count = len(spline.x)
                knots[real, :count], pieces[real, :, : count - 1] = spline.x, spline.c
        return table, knots, pieces

    @cached_property
    def opening_weight(self) -> Array:
        """The square of how much each contact that opens or closes changes the motion, (R, W)."""
        inverse_mass = self.table[:, 2]
        mobility = inverse_mass.copy()  # beyond the last body nothing moves
        np.maximum(mobility[:, :-1], inverse_mass[:, 1:], out=mobility[:, :-1])
        strength = self.table[:, 1].copy()
        strength[:, PAD - 1] += self.uncompressed
        change = strength * mobility / (self.omega[:, None] ** 2.5 * self.scale[:, 1:] + 1e-300)
        return np.minimum(change, 1e150) ** 2


def series(exponent: float) -> Array:
    """Return the first seven binomial coefficients of (1 + s)^delta - 1, and delta, (8,)."""
    k = np.arange(7)
    return np.append(np.cumprod((exponent - k) / (k + 1)), exponent)


@cache
def weakest(exponent: float) -> float:
    """Return |r / length| up to which seven terms of the binomial series give every digit."""
    k = np.arange(8)
    eighth = abs(np.prod((exponent - k) / (k + 1)))
    return min(0.02, float(1e-16 * exponent / max(float(eighth), 1e-16)) ** (1 / 7))


def force_form(scene: Scene, force: str = "auto") -> int:
    """Choose the form of the force: "plain" is fastest, "exact" keeps the digits of the weakest wave.

    The plain form is wrong by the last digit of the force at rest, which is nothing in strong waves.
    """
    exponent = scene.chain.exponent
    roots = int(4 * exponent) if 4 * exponent in ROOTS else None
    if exponent == 1:
        return SPRING
    if not scene.chain.compressed:
        return UNCOMPRESSED_POWER if roots is None else roots
    if force == "auto" and scene.largest_strain < weakest(exponent):
        return POLYNOMIAL
    if roots is not None and (force == "plain" or (force == "auto" and scene.strike_number > STRONG)):
        return roots
    return CORRECTED if exponent == 1.5 else POWER


def name_of(form: int) -> str:
    """Return what a form of the force is called."""
    return FORMS[form][0]
