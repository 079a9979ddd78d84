"""Memory layout of chains for the compiled loops."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..chain import ground
from ..chain.chain import Chain
from ..chain.contact_law import Contacts, together
from ..scene.scene import Scene
from ..util.arrays import Array, read_only
from .kernels import right_hand_side
from .kernels.contact_forces import FORMS, PLAIN, ROOTS, Form, address_of_ground, addresses
from .kernels.layout import PAD, WAVE, BatchArrays
from .kernels.table import aligned_rows, fill_batch, place_bodies

# From this strike number on, the plain form of the force loses no accuracy; see
# analysis/calibration/roundoff.py.
STRONG = 1.0
FORCES = ("auto", "exact", "plain")
# Overlap, m, given to contacts that only touch among pressed contacts. It is far below the rounding
# of overlaps in a wave, and its powers do not underflow.
TOUCHING = 1e-30
# Distances to a kink, over the scale of the motion, at which its bend is measured.
SIDES = (-1, -0.5, 0, 0.5, 1)
# Distance to a kink, m, from which on no motion reaches the kink.
MOST_DISTANT = 1e100
# Chains with at most this number of bodies are computed as a whole, which costs less than tracking
# the wave; see analysis/calibration/light_cone.py.
WINDOW_MIN = 14 * PAD


class ChainBatch:
    """A batch of chains of the same type in the memory layout of the compiled loops.

    Parameters
    ----------
    scenes : sequence of R scenes
        Scenes that differ only in numbers: chains of the same type and number of grains N.
    force : "auto", "exact" or "plain"
        Form in which the contact force is evaluated, see `Native`.
    initial : pair of (R, N) arrays, optional
        Displacement, m, and velocity, m/s, of every grain at t = 0; by default the initial values
        of the scenes.

    Attributes
    ----------
    arrays : BatchArrays
        Arrays of the compiled loops, in rows that begin at cache lines.
    masses : (R, N) array
        Masses, kg.
    contacts : Contacts
        Contacts of all chains, as (R, N+1) arrays.
    initial : pair of (R, N) arrays
        Displacement, m, and velocity, m/s, of every grain at t = 0.
    plain : list of R bool
        Whether the form of the force has a rounding error of one ulp of the force at rest.
    opening_power : float
        Lowest power of the distance to a kink with which a force bends there: of the overlap just
        after a contact closes, or of the distance to a kink of the force from the ground.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        force: str = "auto",
        initial: tuple[Array, Array] | None = None,
    ):
        self.scenes = scenes
        chain = scenes[0].chain
        chains = [scene.chain for scene in scenes]
        excitation = scenes[0].excitation
        self.grains = chain.grains
        self.driven = excitation.driven
        # Scenes with the same excitation share initial values, unless these depend on the chain.
        same = not excitation.of_chain and all(s.excitation is excitation for s in scenes)
        self._struck = scenes[:1] if same else scenes
        self.initial = initial or self._initial()
        self.masses = np.array([chain.masses for chain in chains])
        self.contacts = together([chain.contacts for chain in chains])
        forms = [force_form(scene, force) for scene in scenes]
        self.plain = [form in PLAIN and chain.compressed for form in forms]
        self.opening_power = chain.law.onset
        if chain.ground is not None:
            self.opening_power = min(self.opening_power, ground.onset(chain.ground))
        formulas = chain.law if chain.law.power is None else None
        kinks = self.contacts.law.kinks(self.contacts.constant)
        at_rest = _at_rest(self.contacts, chain.loose_grains, formulas is None)
        acts, reach, wave, knots, pieces, laws = self._impose()
        size = len(scenes)
        damped, viscosity, drag = self._damping()
        # With a ground or an applied force, creep is not proportional to the acceleration.
        pushed = chain.ground is not None or (wave["body"] < 0).any()
        alike = damped and not (pushed or drag.any() or np.ptp(viscosity, axis=1).any())
        rows = aligned_rows(8 if damped else 5, size, self.grains)
        of_damped = rows[5:] if damped else np.zeros((3, size, 0))
        openings: Any
        if formulas:
            openings = np.zeros((3, size, max(len(kinks), 1), rows.shape[2]))
        else:
            openings = rows[0][:, None], rows[3][:, None], rows[4][:, None]
        uncompressed, least_strain, omega, allowed = np.zeros((4, size))
        scale, units = np.empty((2, size, 2))
        self.arrays = BatchArrays(
            inverse_length=rows[0],
            strength=rows[1],
            inverse_mass=rows[2],
            opening_length=openings[0],
            opening_weight=openings[1],
            opening_reach=openings[2],
            opening_rest=1.0 if formulas else float(chain.compressed),
            ground_kinks=_ground_kink_rows(chains, rows.shape[2]),
            uncompressed=uncompressed,
            least_strain=least_strain,
            form=np.array(forms),
            loops=np.array([addresses(form, formulas) for form in forms]),
            precompressed=float(chain.compressed),
            coefficients=series(chain.law.onset),
            parameters=_in_rows(self.contacts, rows.shape[2])
            if formulas
            else np.zeros((size, 0, rows.shape[2])),
            ground=address_of_ground(ground.kernel_of(chain.ground)) if chain.ground else None,
            ground_parameters=_ground_rows(chains, rows.shape[2]),
            omega=omega,
            scale=scale,
            units=units,
            allowed=allowed,
            acts=acts,
            reach=reach,
            wave=wave,
            knots=knots,
            pieces=pieces,
            laws=laws,
            damped=damped,
            alike=alike,
            viscosity=of_damped[0],
            drag=of_damped[1],
            mass=of_damped[2],
        )
        fill_batch(
            self.arrays,
            at_rest,
            self.masses,
            np.array([(s.highest_frequency, s.energy, *s.imposed) for s in scenes]),
            (viscosity, drag),
            (self.driven, chain.movable),
            # A kink of the force from the ground has a weight of its own.
            chain.law.onset,
        )
        if formulas:
            self._weigh_kinks(kinks)
        if chain.ground is not None:
            self._weigh_ground_kinks()

    def _weigh_kinks(self, kinks: Array) -> None:
        """Let steps shorten near the kinks (K, R, N+1) of contacts, by how much the force bends."""
        arrays = self.arrays
        contacts = slice(PAD - 1, PAD + self.grains)
        inverse_length = arrays.inverse_length[:, contacts]
        # The smallest strain is defined for one kink only; contacts with several count as open.
        if len(kinks) > 1:
            arrays.least_strain[:] = -1.0
        arrays.opening_weight[:] = arrays.opening_reach[:] = 0.0
        if not len(kinks):
            inverse_length[:] = 0.0
            return
        overlap = self.contacts.overlap
        typical = arrays.scale[:, :1] + 1e-300
        mobility = np.maximum(
            *(arrays.inverse_mass[:, PAD - 1 + i :][:, : self.grains + 1] for i in (0, 1))
        )
        for row, kink in enumerate(kinks):
            bent = _bend([self.contacts.force_at(kink + side * typical) for side in SIDES])
            length, weight = self._length_and_weight(overlap - kink, bent, mobility)
            arrays.opening_length[:, row, contacts] = length
            arrays.opening_weight[:, row, contacts] = weight
        slow = math.sqrt(2.0) * (2.0 * arrays.omega[:, None, None]) ** 3
        arrays.opening_reach[:] = np.cbrt(arrays.opening_weight) / slow
        # A kink at a larger overlap than that at rest is reached by closing.
        inverse_length[overlap < nearest_kinks(self.contacts)] *= -1.0

    def _weigh_ground_kinks(self) -> None:
        """Let steps shorten near the kinks of the force from the ground on every grain."""
        arrays = self.arrays
        grains = slice(PAD, PAD + self.grains)
        kinks = arrays.ground_kinks[:, 0, :, grains].copy()
        if not kinks.shape[1]:
            return
        arrays.least_strain[:] = -1.0
        moments = ground.MOMENTS[::8] * self.scenes[0].duration
        typical = arrays.scale[:, :1] + 1e-300
        for real, scene in enumerate(self.scenes):
            law = scene.chain.ground
            assert law is not None
            for row, kink in enumerate(kinks[real]):
                places = [kink + side * typical[real] for side in SIDES]
                bends = [_bend([law.force(place, t) for place in places]) for t in moments]
                bent = np.max(bends, axis=0)
                mobility = arrays.inverse_mass[real, grains]
                length, weight = self._length_and_weight(
                    -kink, bent, mobility, slice(real, real + 1)
                )
                arrays.ground_kinks[real, 0, row, grains] = length
                arrays.ground_kinks[real, 1, row, grains] = weight

    def _length_and_weight(
        self, distance: Array, bent: Array, mobility: Array, reals: slice = slice(None)
    ) -> tuple[Array, Array]:
        """Return `opening_length` and `opening_weight` of kinks at a distance from rest, m.

        `bent` is the change of the force slope at a kink, times the scale of the motion, N.
        `mobility` is the inverse mass of the lighter grain that the force moves, 1/kg.
        """
        scale = self.arrays.scale[reals]
        # A distance of 0 has no inverse, and shorter ones have no effect.
        length = 1.0 / np.copysign(np.maximum(np.abs(distance), TOUCHING), distance)
        strain = (scale[:, :1] + 1e-300) * np.abs(length)
        changes = self.arrays.omega[reals, None] ** 2.5 * scale[:, 1:] + 1e-300
        with np.errstate(all="ignore"):
            effect = np.minimum(bent * strain**-1.5 * mobility / changes, 1e150) ** 2
        seen = (bent > 0) & (np.abs(distance) < MOST_DISTANT)
        return np.where(seen, length, 0.0), np.where(seen, effect, 0.0)

    def _of_each(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Broadcast one row, or R rows, to R rows."""
        return np.repeat(rows, len(self.scenes), axis=0) if len(rows) < len(self.scenes) else rows

    def _initial(self) -> tuple[Array, Array]:
        starts = [scene.initial() for scene in self._struck]
        u, v = (self._of_each(np.array(rows)) for rows in zip(*starts, strict=True))
        return u, v

    def place(self, u: Array, v: Array, copies: int = 1) -> tuple[Array, Array, NDArray[Any]]:
        """Return rows of bodies, (copies R, W) m and m/s, and their state at sample 0, (copies R,).

        u and v are displacements, m, and velocities, m/s, of all grains, (copies, R, N), or
        (1, R, N) for equal copies. The window of a long chain contains only the grains that move.
        """
        # With a ground a wave may grow unnoticed, so all grains are in the window.
        longest = WINDOW_MIN if self.scenes[0].chain.ground is None else sys.maxsize
        return place_bodies(u, v, copies, self.driven, self.arrays, longest)

    def _damping(self) -> tuple[bool, Array, Array]:
        """Return whether chains are damped, viscosities, (R, N+1) s, and drag, (R, N) 1/s.

        The arrays have the shape (R, 0) if no chain is damped.
        """
        chains = [scene.chain for scene in self.scenes]
        if not any([chain.damped for chain in chains]):
            nothing = np.zeros((len(chains), 0))
            return False, nothing, nothing
        viscosity = np.array([chain.contact_viscosity for chain in chains])
        return True, viscosity, np.array([chain.drag for chain in chains])

    def _impose(self) -> tuple[bool, NDArray[Any], NDArray[Any], Array, Array, NDArray[Any]]:
        """Return the forces or motions after t = 0: six fields of `BatchArrays`."""
        size = len(self.scenes)
        if not self.scenes[0].excitation.does_work:
            return _nothing_imposed(size, self.grains)
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
                # A negative index denotes a force on the body, see `layout.WAVE`.
                body = -body
            count = 0 if spline is None else len(spline.x)
            table[real] = wave.amplitude, wave.omega, wave.envelope, wave.end, count, body
            if spline is not None:
                knots[real, :count] = spline.x
                pieces[real, :, : count - 1] = spline.c
        return True, reach + (PAD - 1), table, knots, pieces, np.array(right_hand_side.addresses())


@lru_cache(maxsize=64)
def _nothing_imposed(
    size: int, grains: int
) -> tuple[bool, NDArray[Any], NDArray[Any], Array, Array, NDArray[Any]]:
    """Return the fields of `ChainBatch._impose` without a force or motion after t = 0.

    Batches may share these arrays, because the compiled loops do not write to them.
    """
    # No body is forced: the last body precedes the first one.
    reach = np.array([[PAD - 1 + grains, PAD]] * size)
    knots = np.zeros((size, 0))
    return False, reach, np.zeros(size, WAVE), knots, np.zeros((size, 4, 0)), np.zeros(2, np.int64)


def _at_rest(contacts: Contacts, loose: int, powers: bool) -> tuple[Array, Array, Array, Array]:
    """Return the overlap (m), force (N), constant and stiffness (N/m) at rest, (R, N+1) each.

    In a chain with pressed contacts, contacts that touch without a force get the overlap `TOUCHING`
    and no stiffness, because the compiled forms of the force require a length scale. The error of
    their force is below rounding. If the law is a power (`powers`), a wall that touches the first
    grain without a force is excluded: the loops treat it separately.
    """
    constant, force, overlap, stiffness = contacts.arrays
    if powers and not loose and not _touches_base(contacts):
        return overlap, force, constant, stiffness
    if not powers:
        # The length is the distance to a kink. The force is not used, and is set to that of a
        # spring.
        distance = np.abs(overlap - nearest_kinks(contacts))
        overlap = distance if len(contacts.law.kinks(constant)) else contacts.length
        force = np.where(contacts.pressed, stiffness * overlap, 0.0)
    touch = contacts.exists & ~contacts.pressed & contacts.pressed.any(-1, keepdims=True)
    touch[:, 0] &= not powers
    trace = np.maximum(contacts.law.force(TOUCHING, constant), np.finfo(float).tiny)
    # Read-only like the other arrays, so that the loops are compiled only once.
    return (
        read_only(np.where(touch, TOUCHING, overlap)),
        read_only(np.where(touch, trace, force)),
        constant,
        read_only(np.where(touch, 0.0, stiffness)),
    )


def _touches_base(contacts: Contacts) -> bool:
    """Return whether the last grain touches a wall that carries nothing at rest.

    A chain that was turned upside down has such a wall if a wall touched its first grain before.
    """
    carries_nothing = (contacts.constant[..., -1] > 0) & (contacts.force[..., -1] == 0)
    return bool(carries_nothing.any())


def nearest_kinks(contacts: Contacts) -> Array:
    """Return the kink nearest to the overlap at rest of every contact, (..., N+1) m; 0 if none."""
    kinks = contacts.law.kinks(contacts.constant)
    if not len(kinks):
        return np.zeros_like(contacts.overlap)
    nearest = np.abs(contacts.overlap - kinks).argmin(0)
    return np.take_along_axis(kinks, nearest[None], 0)[0]


def _bend(forces: Sequence[Array]) -> Array:
    """Return by how much forces at `SIDES` of a kink bend there, N."""
    far, near, at, after, beyond = forces
    # The force at a kink that no motion reaches may be infinite.
    with np.errstate(all="ignore"):
        even = far - 2 * at + beyond
        # Two sides of opposite sign, as of o |o|, have no second difference.
        odd = beyond - far - 2 * (after - near)
        return np.maximum(np.abs(even), 2 * np.abs(odd))  # type: ignore[no-any-return]


def parameter_rows(contacts: Contacts) -> Array:
    """Return `BatchArrays.parameters` of these contacts."""
    overlap = contacts.overlap
    law = contacts.law
    kept = law.kept_at_rest(overlap, contacts.constant)
    columns = np.broadcast_arrays(overlap, contacts.constant, *law.parameters, *kept)
    rows: Array = np.stack(columns, axis=-2)
    return rows


def _in_rows(contacts: Contacts, width: int) -> Array:
    """Return `BatchArrays.parameters` of R chains whose laws are formulas, (R, P, W)."""
    size, count = contacts.overlap.shape
    rows = parameter_rows(contacts)
    # Places without a contact need parameters as well, because a formula may divide by them.
    ends = np.zeros((size, rows.shape[1], width)) + rows[..., -1:]
    ends[:, :2] = 0.0
    ends[..., PAD - 1 : PAD - 1 + count] = rows
    return ends


def _ground_rows(chains: Sequence[Chain], width: int) -> Array:
    """Return `BatchArrays.ground_parameters` of R chains."""
    if chains[0].ground is None:
        return np.zeros((len(chains), 0, 0))
    rows = np.array([ground.parameter_rows(c.ground, c.grains) for c in chains if c.ground])
    # Places without a grain need parameters as well, because a formula may divide by them.
    behind = width - PAD - rows.shape[2]
    return np.pad(rows, ((0, 0), (0, 0), (PAD, behind)), mode="edge")


def _ground_kink_rows(chains: Sequence[Chain], width: int) -> Array:
    """Return `BatchArrays.ground_kinks` of R chains, with the places of kinks in the first row."""
    if chains[0].ground is None:
        return np.zeros((len(chains), 2, 0, width))
    kinks = [c.ground.kinks(np.zeros(c.grains)) for c in chains if c.ground]
    rows = np.zeros((len(chains), 2, max(map(len, kinks)), width))
    for row, places in zip(rows, kinks, strict=True):
        row[0, :, PAD : PAD + chains[0].grains] = MOST_DISTANT
        row[0, : len(places), PAD : PAD + chains[0].grains] = places
    return rows


@cache
def series(exponent: float) -> Array:
    """Return the first seven binomial coefficients of (1 + s)^delta - 1, and delta, (8,)."""
    k = np.arange(7)
    return np.append(np.cumprod((exponent - k) / (k + 1)), exponent)


@cache
def weakest(exponent: float) -> float:
    """Return the largest |r / length| for which seven terms of the binomial series are exact."""
    k = np.arange(8)
    eighth = abs(np.prod((exponent - k) / (k + 1)))
    return min(0.02, float(1e-16 * exponent / max(float(eighth), 1e-16)) ** (1 / 7))


def force_form(scene: Scene, force: str = "auto") -> int:
    """Return the form of the force: "plain" is fastest, "exact" is accurate for weak waves.

    The error of the plain form is one ulp of the force at rest, which is negligible in strong
    waves. "auto" selects a form by the largest strain of the scene.
    """
    exponent = scene.chain.law.power
    if exponent is None:
        return Form.FORMULAS
    roots = int(4 * exponent) if 4 * exponent in ROOTS else None
    if exponent == 1:
        return Form.SPRING
    if not scene.chain.compressed:
        return Form.UNCOMPRESSED_POWER if roots is None else roots
    if force == "auto" and scene.largest_strain < weakest(exponent):
        return Form.POLYNOMIAL
    # The plain form subtracts two forces, which loses digits below an ulp of the force at rest.
    if roots is not None and (force == "plain" or (force == "auto" and _strong(scene))):
        return roots
    # The "corrected" form uses strains, and the strain of a touching contact is unbounded.
    touches = scene.chain.loose_grains or _touches_base(scene.chain.contacts)
    if exponent == 1.5 and not touches:
        return Form.CORRECTED
    return Form.POWER


def _strong(scene: Scene) -> bool:
    """Return whether waves are so strong that ulps of the forces at rest are negligible."""
    chain = scene.chain
    if not chain.loose_grains:
        return scene.strike_number > STRONG
    # The strike number of a touching grain is infinite even if it strikes other grains gently.
    deepest = scene.first_overlaps.max()
    return bool(deepest > (1 + STRONG) * chain.contacts.overlap.max())


def name_of(form: int) -> str:
    """Return the name of a form of the force."""
    return FORMS[form][0] if form in FORMS else "formulas"
