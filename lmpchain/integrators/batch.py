"""Chains laid out in memory for the compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..chain.contacts import together
from ..scene.scene import Scene
from ..util.arrays import Array
from .kernels.contact_forces import (
    CORRECTED,
    FORMS,
    POLYNOMIAL,
    POWER,
    ROOTS,
    SPRING,
    UNCOMPRESSED_POWER,
)
from .kernels.layout import ALONE, KNOTS, PAD, Chains, Team
from .kernels.table import laid_out, opening_weights, placed

# analysis/calibration/roundoff.py
STRONG = 1.0  # strike number from which the fastest form of the force loses nothing
FORCES = ("auto", "exact", "plain")
# bodies: shorter chains are computed as a whole, for less than it costs to follow the wave
WINDOW_MIN = 14 * PAD  # analysis/calibration/light_cone.py


class ChainBatch:
    """A batch of like chains: bodies, contacts and drives as arrays that begin at cache lines.

    Parameters
    ----------
    scenes : sequence of R scenes
        Of one kind and length.
    force : "auto", "exact" or "plain"
        Which form of the force.
    initial : pair of (R, N) arrays, optional
        Displacement, m, and velocity, m/s, of every grain at t = 0, in place of those of the scenes.

    Attributes
    ----------
    masses : (R, N) array
        kg.
    contacts : Contacts
        Of all chains, (R, N+1) arrays.
    table : (R, 3, W) array
        1 / length and strength of the contact below every body, and its inverse mass.
    uncompressed : (R,) array
        Constant of a first contact that touches without pressing in a chain that is pressed otherwise, else 0.
    precompressed : float
        1 if the chains are pressed, else 0.
    initial : pair of (R, N) arrays
        Displacement, m, and velocity, m/s, of every grain at t = 0.
    forms, coefficients : (R,) and (8,) arrays
        The form of the force of each, and its coefficients.
    plain : list of R bool
        Whether that form loses the last digit of the force at rest.
    opening_power : float
        The force of a contact that opens goes as the overlap to this power.
    acted : (R, 2) array
        First and last body that is acted on after t = 0, the other way round if none is.
    drive, knots, pieces : arrays
        How grain 1 or the top wall is moved, or a grain is pushed.
    omega : (R,) array
        Highest frequency, rad/s.
    scale : (R, 2) array
        Largest displacement and speed of the excitation, m and m/s.
    units : (R, 2) array
        Overlap of the contact below grain 1 (that above it if there is none below), and the speed of that in the unit
        of time, m and m/s; no speed in the sonic vacuum.
    allowed : (R,) array
        What twice the kinetic energy cannot exceed, J: contacts never hold less energy than at rest.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        force: str = "auto",
        initial: tuple[Array, Array] | None = None,
    ):
        self.scenes, chain, excitation = scenes, scenes[0].chain, scenes[0].excitation
        self.grains, self.imposed, self.driven = (
            chain.grains,
            excitation.does_work,
            excitation.driven,
        )
        each = len(scenes) > 1 and (
            excitation.of_chain or any(scene.excitation is not excitation for scene in scenes)
        )
        self._struck = (
            scenes if each else scenes[:1]
        )  # that are set in motion in a way of their own
        self.initial = initial or self._initial()
        self._compressed, self.precompressed = chain.compressed, float(chain.compressed)
        masses = [scene.chain.masses for scene in scenes]
        self.masses = np.array(masses) if len(masses) > 1 else masses[0].copy()[None]
        self.contacts = own = together([scene.chain.contacts for scene in scenes])
        strikes = np.array(
            [(scene.highest_frequency, scene.energy, *scene.imposed) for scene in scenes]
        )
        self.table, self.uncompressed, self.omega, self.scale, self.units, self.allowed = laid_out(
            own.overlap, own.force, own.constant, own.stiffness, self.masses, strikes, self.driven, chain.movable,
            chain.compressed,
        )  # fmt: skip
        forms = [force_form(scene, force) for scene in scenes]
        self.forms, self.plain = (
            np.array(forms),
            [form in ROOTS and self._compressed for form in forms],
        )
        self.coefficients, self.opening_power = series(chain.exponent), chain.exponent
        self.acted, self.drive, self.knots, self.pieces = self._imposed()

    def _of_each(self, found: NDArray[Any]) -> NDArray[Any]:
        """Return an array with a row for each of the R scenes, from one for all or one for each."""
        return (
            np.repeat(found, len(self.scenes), axis=0) if len(found) < len(self.scenes) else found
        )

    def _initial(self) -> tuple[Array, Array]:
        if len(self.scenes) == 1:
            u, v = self.scenes[0].initial()
            return u[None], v[None]
        u, v = np.array([scene.initial() for scene in self._struck]).swapaxes(0, 1)
        return self._of_each(np.ascontiguousarray(u)), self._of_each(np.ascontiguousarray(v))

    def placed(self, u: Array, v: Array, copies: int = 1) -> tuple[Array, Array, NDArray[Any]]:
        """Return rows of bodies, (copies R, W) m and m/s, and their state at sample 0, (copies R,).

        Grains are at u and move with v, (copies, R, N) or (1, R, N) for all. Around what moves there is a window; a
        short chain is computed as a whole.
        """
        about = self.driven, self.acted, self.uncompressed, self._compressed
        x, w, state = placed(u, v, copies, *about, WINDOW_MIN)
        return x, w, state

    def arrays(
        self, x: Array, v: Array, history: Array, state: NDArray[Any], team: Team = ALONE
    ) -> Chains:
        """Return the chains, and where and how fast their bodies are, for the loops of a thread."""
        return Chains(
            x, v, history, state, self.table, self.uncompressed, self.scale, self.omega, self.forms,
            self.precompressed, self.coefficients, self.imposed, self.acted, self.drive, self.knots, self.pieces, team,
        )  # fmt: skip

    def _imposed(self) -> tuple[NDArray[Any], Array, Array, Array]:
        """Return on which bodies something acts after t = 0, (R, 2), and what, (R, 6), (R, P) and (R, 4, P-1)."""
        size = len(self.scenes)
        if not self.imposed:
            return _nothing(size, self.grains)
        acted = self._of_each(np.array([s.excitation.reach(s.chain) for s in self._struck])) + (
            PAD - 1
        )
        waves = [scene.excitation.waveform for scene in self.scenes]
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
        return acted, table, knots, pieces

    @cached_property
    def openings(self) -> tuple[Array, Array]:
        """What `kernels.adaptive_splitting` takes of each contact, (R, W): its weight, and its reach."""
        return opening_weights(self.table, self.uncompressed, self.omega, self.scale)


@lru_cache(maxsize=64)
def _nothing(size: int, grains: int) -> tuple[NDArray[Any], Array, Array, Array]:
    acted = np.tile([PAD - 1 + grains, PAD], (size, 1))  # the last before the first
    return acted, np.zeros((size, 6)), np.zeros((size, 0)), np.zeros((size, 4, 0))


@cache
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
    if roots is not None and (
        force == "plain" or (force == "auto" and scene.strike_number > STRONG)
    ):
        return roots
    return CORRECTED if exponent == 1.5 else POWER


def name_of(form: int) -> str:
    """Return what a form of the force is called."""
    return FORMS[form][0]
