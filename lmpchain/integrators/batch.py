"""Chains laid out in memory for the compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..chain.contacts import Contacts, together
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.caching import cached_property
from .kernels import waveform
from .kernels.contact_forces import FORMS, ROOTS, Form, addresses
from .kernels.layout import ALONE, PAD, WAVE, Chains, Dissipation, Imposed, Links, Team
from .kernels.table import AtRest, lay_out, opening_weights, place_bodies

# strike number from which the fastest form of the force loses nothing;
# analysis/calibration/roundoff.py
STRONG = 1.0
FORCES = ("auto", "exact", "plain")
# overlap, m, of contacts that only touch among others that are pressed: far below the rounding of
# one that a strike makes, and its powers are numbers
TOUCHING = 1e-30
# of the largest speed that is imposed: more than the rounding of a velocity
ROUNDED = 1e-6
# bodies: shorter chains are computed as a whole, for less than it costs to follow the wave;
# analysis/calibration/light_cone.py
WINDOW_MIN = 14 * PAD


class ChainBatch:
    """A batch of like chains: bodies, contacts and drives as arrays that begin at cache lines.

    Parameters
    ----------
    scenes : sequence of R scenes
        Of one kind and length.
    force : "auto", "exact" or "plain"
        Which form of the force.
    initial : pair of (R, N) arrays, optional
        Displacement, m, and velocity, m/s, of every grain at t = 0, in place of those of the
        scenes.

    Attributes
    ----------
    masses : (R, N) array
        kg.
    contacts : Contacts
        Of all chains, (R, N+1) arrays.
    links : Links
        Of all chains, for the compiled loops.
    inverse_mass : (R, W) array
        1/kg, of every body; 0 of what is held.
    initial : pair of (R, N) arrays
        Displacement, m, and velocity, m/s, of every grain at t = 0.
    plain : list of R bool
        Whether the form of the force loses the last digit of that at rest.
    opening_power : float
        The force of a contact that opens goes as the overlap to this power.
    imposed : Imposed
        How grain 1 or the top wall is moved, or a grain is pushed, after t = 0.
    omega : (R,) array
        Highest frequency, rad/s.
    scale : (R, 2) array
        Largest displacement and speed of the excitation, m and m/s.
    units : (R, 2) array
        Overlap of the contact below grain 1 (that above it if there is none below), and the speed
        of that in the unit of time, m and m/s; no speed in the sonic vacuum.
    allowed : (R,) array
        What twice the kinetic energy cannot exceed, J: contacts never hold less energy than at
        rest.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        force: str = "auto",
        initial: tuple[Array, Array] | None = None,
    ):
        self.scenes = scenes
        chain = scenes[0].chain
        excitation = scenes[0].excitation
        self.grains = chain.grains
        self.driven = excitation.driven
        self._loose = chain.loose_grains
        # one start serves all scenes of one excitation, unless it depends on the chain
        differ = excitation.of_chain or any(s.excitation is not excitation for s in scenes)
        self._struck = scenes if differ else scenes[:1]
        self.initial = initial or self._initial()
        self.masses = np.array([scene.chain.masses for scene in scenes])
        self.contacts = together([scene.chain.contacts for scene in scenes])
        overlap, force_at_rest, stiffness = _with_touching(self.contacts, self._loose)
        at_rest = AtRest(
            overlap=overlap,
            force=force_at_rest,
            constant=self.contacts.constant,
            stiffness=stiffness,
            compressed=chain.compressed,
        )
        strikes = np.array([(s.highest_frequency, s.energy, *s.imposed) for s in scenes])
        layout = lay_out(at_rest, self.masses, strikes, (self.driven, chain.movable))
        self.inverse_mass = layout.inverse_mass
        self.omega = layout.omega
        self.scale = layout.scale
        self.units = layout.units
        self.allowed = layout.allowed
        if any(scene.chain.damped for scene in scenes):
            # reduced velocities leave their rounding, also where nothing moves
            self.allowed = self.allowed + self.masses.sum(1) * (ROUNDED * self.scale[:, 1]) ** 2
        forms = [force_form(scene, force) for scene in scenes]
        self.links = Links(
            inverse_length=layout.inverse_length,
            strength=layout.strength,
            uncompressed=layout.uncompressed,
            form=np.array(forms),
            loops=np.array([addresses(form) for form in forms]),
            precompressed=float(chain.compressed),
            coefficients=series(chain.exponent),
        )
        self.plain = [form in ROOTS and chain.compressed for form in forms]
        self.opening_power = chain.exponent
        self.imposed = self._imposed()

    def _of_each(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Return an array with a row for each of the R scenes, from one for all or one for each."""
        return np.repeat(rows, len(self.scenes), axis=0) if len(rows) < len(self.scenes) else rows

    def _initial(self) -> tuple[Array, Array]:
        u, v = np.array([scene.initial() for scene in self._struck]).swapaxes(0, 1)
        return self._of_each(np.ascontiguousarray(u)), self._of_each(np.ascontiguousarray(v))

    def place(self, u: Array, v: Array, copies: int = 1) -> tuple[Array, Array, NDArray[Any]]:
        """Return rows of bodies, (copies R, W) m and m/s, and their state at sample 0, (copies R,).

        Grains are at u and move with v, (copies, R, N) or (1, R, N) for all. Around what moves
        there is a window; a short chain is computed as a whole.
        """
        reach = self.imposed.reach
        x, w, state = place_bodies(u, v, copies, self.driven, reach, self.links, WINDOW_MIN)
        if self._loose:
            # contacts that touch may be taken to have opened, as in the vacuum
            state["least_strain"] = -1.0
        return x, w, state

    def arrays(
        self, x: Array, v: Array, history: Array, state: NDArray[Any], team: Team = ALONE
    ) -> Chains:
        """Return the chains, and where and how fast their bodies are, for the loops of a thread."""
        return Chains(
            x=x,
            v=v,
            history=history,
            state=state,
            inverse_mass=self.inverse_mass,
            links=self.links,
            imposed=self.imposed,
            scale=self.scale,
            omega=self.omega,
            team=team,
        )

    def _imposed(self) -> Imposed:
        """Return the imposed motions or forces of the chains after t = 0."""
        size = len(self.scenes)
        if not self.scenes[0].excitation.does_work:
            # the last body that is acted on lies before the first
            none = np.array([[PAD - 1 + self.grains, PAD]] * size)
            knots = np.zeros((size, 0))
            pieces = np.zeros((size, 4, 0))
            nowhere = np.zeros(2, np.int64)
            return Imposed(False, none, np.zeros(size, WAVE), knots, pieces, nowhere)
        reach = self._of_each(np.array([s.excitation.reach(s.chain) for s in self._struck]))
        waves = [scene.excitation.waveform for scene in self.scenes]
        splines = [wave.spline if wave else None for wave in waves]
        knots_max = max(0 if spline is None else len(spline.x) for spline in splines)
        table = np.zeros(size, WAVE)
        knots = np.zeros((size, knots_max))
        pieces = np.zeros((size, 4, max(knots_max - 1, 0)))
        for real, (scene, wave, spline) in enumerate(zip(self.scenes, waves, splines, strict=True)):
            if wave is None:
                continue
            body = PAD - 1 + scene.excitation.acts_on
            if not scene.excitation.wall and not scene.excitation.driven:
                # below 0: the body is pushed, see `layout.WAVE`
                body = -body
            count = 0 if spline is None else len(spline.x)
            table[real] = wave.amplitude, wave.omega, wave.envelope, wave.end, count, body
            if spline is not None:
                knots[real, :count] = spline.x
                pieces[real, :, : count - 1] = spline.c
        laws = np.array(waveform.addresses())
        return Imposed(True, reach + (PAD - 1), table, knots, pieces, laws)

    @cached_property
    def openings(self) -> tuple[Array, Array]:
        """Weight and reach of each contact, (R, W), see `layout.Openings`."""
        return opening_weights(self.links, self.inverse_mass, self.omega, self.scale)

    @cached_property
    def dissipation(self) -> Dissipation:
        """Viscosity of all contacts and drag on all grains, for the compiled loops."""
        chains = [scene.chain for scene in self.scenes]
        acts = any(chain.damped for chain in chains)
        viscosity = np.zeros((len(chains), self.inverse_mass.shape[1] if acts else 0))
        drag = np.zeros_like(viscosity)
        mass = np.zeros_like(viscosity)
        if acts:
            viscosity[:, PAD - 1 : PAD + self.grains] = [c.contact_viscosity for c in chains]
            drag[:, PAD : PAD + self.grains] = [c.drag for c in chains]
            # what is held or driven moves as it is told
            drag[self.inverse_mass == 0.0] = 0.0
            mass[:, PAD : PAD + self.grains] = self.masses
            mass[self.inverse_mass == 0.0] = 0.0
        of_contacts = viscosity[:, PAD - 1 : PAD + self.grains]
        pushed = self.imposed.acts and bool((self.imposed.wave["body"] < 0).any())
        one_each = bool((of_contacts == of_contacts[:, :1]).all()) and not drag.any()
        return Dissipation(acts, viscosity, drag, acts and one_each and not pushed, mass)


def _with_touching(contacts: Contacts, loose: int) -> tuple[Array, Array, Array]:
    """Return overlap, m, force, N, and stiffness, N/m, at rest, (R, N+1) arrays each.

    Loose contacts have a trace of overlap and force, and no stiffness, springs either. The compiled
    forms of the force need a length: with that of `TOUCHING` they are Hertz's law without load but
    for less than their rounding.
    """
    if not loose:
        return contacts.overlap, contacts.force, contacts.stiffness
    overlap = contacts.overlap.copy()
    force = contacts.force.copy()
    stiffness = contacts.stiffness.copy()
    stiffness[:, 1 : loose + 1] = 0.0
    overlap[:, 1 : loose + 1] = TOUCHING
    force[:, 1 : loose + 1] = contacts.constant[:, 1 : loose + 1] * TOUCHING**contacts.exponent
    return overlap, force, stiffness


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
    """Choose the form of the force: "plain" is fastest, "exact" keeps all digits of weak waves.

    The plain form is wrong by the last digit of the force at rest, which is nothing in strong
    waves.
    """
    exponent = scene.chain.exponent
    roots = int(4 * exponent) if 4 * exponent in ROOTS else None
    if exponent == 1:
        return Form.SPRING
    if not scene.chain.compressed:
        return Form.UNCOMPRESSED_POWER if roots is None else roots
    if force == "auto" and scene.largest_strain < weakest(exponent):
        return Form.POLYNOMIAL
    # the plain form subtracts two forces, and loses what is below the last digit of that at rest
    if roots is not None and (force == "plain" or (force == "auto" and _strong(scene))):
        return roots
    # the correction is one for strains, and that of a contact that only touches has no bound
    if exponent == 1.5 and not scene.chain.loose_grains:
        return Form.CORRECTED
    return Form.POWER


def _strong(scene: Scene) -> bool:
    """Return whether waves are so strong that the last digits of the forces at rest are nothing."""
    chain = scene.chain
    if not chain.loose_grains:
        return scene.strike_number > STRONG
    # the strike number of a grain that only touches is infinite, however gently it strikes others
    deepest = scene.first_overlaps.max()
    return bool(deepest > (1 + STRONG) * chain.contacts.overlap.max())


def name_of(form: int) -> str:
    """Return the name of a form of the force."""
    return FORMS[form][0]
