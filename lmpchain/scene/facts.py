"""Derived facts of a scene: times, strengths, frequencies and reach of the wave.

Each fact is defined only here, and is computed once, when it is first read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import InstanceOf

from ..chain import ground
from ..chain.bounds import LIMITS
from ..chain.chain import Chain
from ..chain.contact_law import FEW_GRAINS, Contacts
from ..chain.damping import Damping
from ..chain.equilibrium import Equilibrium
from ..chain.law import Law
from ..util.arrays import Array, as_slice, read_only
from ..util.lazy import cached_property
from ..util.validation import make_unchecked, with_derived
from .base import Excitation
from .recording import Recording


def turn_upside_down(chain: Chain) -> Chain:
    """Return the chain in reverse order, with the forces at rest that its contacts have.

    The reversed chain has the motion of the given chain with opposite signs, because the motion
    around rest depends on the forces at rest and not on gravity itself. A held last grain becomes a
    free first grain, whose motion a drive must prescribe.

    Parameters
    ----------
    chain : Chain
        A chain without a ground and without grains that only touch.
    """
    rest = chain.equilibrium
    constant, force, overlap, stiffness = (_reverse(values) for values in rest.contacts.arrays)
    lengths, diameters, masses = (
        _reverse(values) for values in (rest.contact_lengths, rest.diameters, rest.masses)
    )
    fields: dict[str, Any] = {
        "grains": chain.grains,
        "diameter": diameters,
        "gravity": chain.gravity,
        "exponent": chain.given_exponent,
        "top_load": chain.top_load,
        "top": "wall" if chain.bottom == "wall" else "free",
        "bottom": chain.top,
        "masses": masses,
        "contact_constants": constant[1:-1],
        "wall_constants": constant[[0, -1]],
        "damping": Damping(
            viscoelastic=_reverse(chain.damping.viscoelastic), drag=_reverse(chain.damping.drag)
        ),
    }
    law = chain.given_law
    if isinstance(law, Law):
        per_contact = {key: value for key, value in law.given.items() if isinstance(value, tuple)}
        fields["law"] = law.replace(**{key: value[::-1] for key, value in per_contact.items()})
    turned = make_unchecked(Chain, **fields)
    contacts = Contacts(turned.contact_law, constant, force, overlap, stiffness)
    return with_derived(turned, equilibrium=Equilibrium(contacts, lengths, diameters, masses))


def _reverse(values: Any) -> Any:
    """Return an array in reverse order, or the one number that all share."""
    if not isinstance(values, np.ndarray):
        return values
    turned: Array = values[::-1].copy()
    return read_only(turned)


Part = TypeVar("Part", bound="SceneFacts")


@dataclass(frozen=True)
class Cut:
    """Limits for restricting a chain to the grains that the wave can have reached.

    Attributes
    ----------
    unseen : float
        Grains that move by less than this fraction of the motion of the struck grain count as at
        rest.
    share : float
        Fraction of the grains. If the wave can have reached more of them, the whole chain is
        computed (analysis/calibration/light_cone.py).
    shortest : int
        Number of grains. Shorter chains are computed as a whole, because restricting them would
        cost more than it saves.
    """

    unseen: float = 1e-22
    share: float = 0.7
    shortest: int = 128


CUT = Cut()


class LightCone(NamedTuple, Generic[Part]):
    """The part of a scene that a wave can have reached; all other grains are at rest.

    Attributes
    ----------
    scene : Scene
        Scene of this part with all of its grains recorded.
    rows : slice or (C,) array
        Indices, among the recorded grains of this part, of the grains that the whole scene records.
    columns : slice or (C,) array
        Indices of the same grains among the recorded grains of the whole scene.
    """

    scene: Part
    rows: slice | NDArray[np.intp]
    columns: slice | NDArray[np.intp]


class SceneFacts(Recording):
    """A chain, an excitation and a recording, with all quantities derived from them before a run.

    `Scene` inherits these facts. Facts that depend on the chain alone are attributes of `Chain`.
    """

    chain: Chain
    excitation: InstanceOf[Excitation]

    # Times and grains.

    @cached_property
    def time(self) -> Array:
        """Recorded times, (T,) s."""
        # The times of np.linspace, at a tenth of its cost.
        time = np.arange(float(self.samples)) * self.sampling_interval
        time[-1] = self.duration
        return read_only(time)

    @cached_property
    def intervals(self) -> int:
        """Number of sampling intervals."""
        return self.samples - 1

    @cached_property
    def sampling_interval(self) -> float:
        """Time from one sample to the next, s."""
        return self.duration / self.intervals

    @cached_property
    def recorded(self) -> NDArray[np.int64]:
        """Recorded grains, (G,) numbers from 1."""
        return read_only(self.numbers(self.chain))

    @cached_property
    def kinks(self) -> tuple[float, ...]:
        """Times between t = 0 and the end at which the applied force or motion has a kink, s."""
        waveform = self.excitation.waveform
        if waveform is None:
            return ()
        return tuple(t for t in waveform.kinks if 0.0 < t < self.duration)

    @cached_property
    def kink_spacing(self) -> float:
        """Smallest time between kinks of the applied force or motion, s; infinite without kinks."""
        return self.excitation.kink_spacing

    @cached_property
    def driven_from_above(self) -> Self:
        """The scene itself, or one that is driven from below upside down, with all grains recorded.

        Engines compute this scene, because they can drive only the upper end of a chain.
        """
        drive = self.excitation
        if not drive.from_below:
            return self
        return make_unchecked(
            type(self),
            chain=turn_upside_down(self.chain),
            excitation=drive.upside_down(self.chain),  # type: ignore[attr-defined]
            duration=self.duration,
            samples=self.samples,
        )

    # Strength of the excitation.

    @property
    def strike_velocity(self) -> float:
        """Velocity given to one grain at t = 0, m/s; 0 for any other excitation."""
        return self.excitation.strike_velocity

    @property
    def _surroundings(self) -> tuple[int, Self]:
        """First grain and scene of the grains that the excitation moves, and their neighbours.

        For a short chain this is the whole scene, because computing all of its contacts costs no
        more.
        """
        # A scene that stored itself would remain in memory until the next garbage collection.
        return (1, self) if self.chain.grains <= FEW_GRAINS else self._struck_part

    @cached_property
    def _struck_part(self) -> tuple[int, Self]:
        """The part of a long chain that `_surroundings` returns."""
        top, bottom = self.excitation.reach(self.chain)
        first = self.chain.first_of_part(max(1, top - 1))
        return first, self.part(first, min(self.chain.grains, bottom + 2))

    @cached_property
    def imposed(self) -> tuple[float, float]:
        """The largest displacement and speed that the excitation imposes, m and m/s."""
        _, near = self._surroundings
        return near.excitation.strongest(near.chain, self.duration)

    @property
    def at_rest(self) -> bool:
        """Whether the excitation moves nothing."""
        return not any(self.imposed)

    @cached_property
    def energy(self) -> float:
        """Energy above rest at t = 0, J; infinite if that does not bound the energy of contacts.

        The result is infinite if the excitation does work after t = 0, or if the chain is on a
        ground that may not be a spring.
        """
        if self.chain.ground is not None and not ground.is_spring(self.chain.ground):
            return math.inf
        _, near = self._surroundings
        return near.excitation.energy(near.chain)

    @cached_property
    def strike_number(self) -> float:
        """Strike relative to the contact below the grain: v0 / (eps_n omega_n) or phi_0 / eps_n.

        Linear theory is valid if this number is far below 1. It is infinite in the sonic vacuum.
        """
        if self.excitation.from_below:
            return self.driven_from_above.strike_number
        _, near = self._surroundings
        chain = near.chain
        excitation = near.excitation
        contacts = chain.contacts
        loose = chain.loose_grains
        # For one struck grain no arrays over all others are needed.
        if self.strike_velocity and chain.compressed:
            n = excitation.grain  # type: ignore[attr-defined]
            if n <= loose:
                return np.inf
            omega = (contacts.stiffness[n] / chain.masses[n - 1]) ** 0.5
            return float(abs(self.strike_velocity) / (contacts.length[n] * omega))
        largest = [np.abs(values) for values in excitation.largest(chain)]
        if not chain.compressed:
            return np.inf if any(values.any() for values in largest) else 0.0
        # A last grain that hangs free, or only touches a wall, has no pressed contact below it.
        moving = slice(0, chain.movable - (not chain.contacts.pressed[chain.movable]))
        displacement, velocity = (values[moving] for values in largest)
        # Contacts without force at rest behave as in the sonic vacuum.
        if displacement[:loose].any() or velocity[:loose].any():
            return np.inf
        overlap = contacts.length[1:][moving][loose:]
        omega = np.sqrt(contacts.stiffness[1:][moving][loose:] / chain.masses[moving][loose:])
        shift = displacement[loose:] / overlap
        speed = velocity[loose:] / (overlap * omega)
        return float(max(shift.max(initial=0.0), speed.max(initial=0.0)))

    # Overlaps and strains.

    @cached_property
    def first_overlaps(self) -> Array:
        """The largest overlap of every contact at t = 0 or in the first collision, (N+1,) m.

        Two isolated bodies of the reduced mass mu that collide at the relative velocity v reach the
        overlap r with ``K r^(delta+1) / (delta+1) = mu v^2 / 2``.
        """
        if self.excitation.from_below:
            return read_only(self.driven_from_above.first_overlaps[::-1].copy())
        chain = self.chain
        excitation = self.excitation
        contacts = chain.contacts
        displacement, velocity = excitation.initial(chain)
        # Driven grains, fixed grains and walls have no inverse mass.
        inverse_mass = np.zeros(chain.grains + 2)
        moving = slice(excitation.driven, chain.movable)
        inverse_mass[1:-1][moving] = 1 / chain.masses[moving]
        closer = contacts.closer(displacement)
        approach = contacts.closer(excitation.largest(chain)[1])
        # A driven body moves both ways and squeezes the contacts on both sides in turn. A body that
        # is bonded to its neighbours does so as well.
        if excitation.does_work or contacts.law.bonds:
            closer = np.abs(closer)
            approach = np.abs(approach)
        approach = np.maximum(approach, 0.0)
        # Grain 1 rests when the wall arrives, or moves towards it.
        if excitation.wall:
            approach[0] = excitation.wall.largest(1) + max(-velocity[0], 0.0)
        collision = contacts.collision_overlap(approach, inverse_mass[:-1] + inverse_mass[1:])
        overlaps = np.maximum(contacts.overlap + contacts.exists * closer, collision)
        return read_only(overlaps)

    @cached_property
    def _first_overlap_bound(self) -> float:
        """Bound on `first_overlaps` without arrays, m; infinite if none is known."""
        bounds = self.chain.bounds
        speed = self.strike_velocity
        return bounds.struck(speed) if bounds and speed else np.inf

    @cached_property
    def _gentle(self) -> bool:
        """Whether bounds show that Hertz's law is valid and that no grain is faster than sound."""
        # Arrays of all contacts instead of bounds would make a run of 100 grains a fifth slower.
        bounds = self.chain.bounds
        return (
            bounds is not None
            and self._first_overlap_bound <= LIMITS.hertz_compression * bounds.narrowest
            and abs(self.strike_velocity) <= bounds.slowest
        )

    @cached_property
    def first_squeeze(self) -> tuple[int, float]:
        """The most compressed contact at first, and its overlap over the mean diameter."""
        first, near = self._surroundings
        # The values of a strike that is rejected may overflow.
        with np.errstate(over="ignore"):
            compression = near.first_overlaps / near.chain.contact_lengths
        worst = int(compression.argmax())
        return worst + first - 1, float(compression[worst])

    def strike_faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault if a contact is initially squeezed beyond the range of Hertz's law."""
        contact, compression = self.first_squeeze
        # A compression of NaN is rejected as well.
        if not compression <= LIMITS.compression:
            than = f"of the diameter, more than {LIMITS.compression:g}: strike more gently"
            yield self._strength, f"squeezes contact {contact} to {compression:.2g} {than}"

    @property
    def _strength(self) -> str:
        """The key of the scene file that sets the strength of the excitation."""
        return "kind" if self.excitation.does_work else self.excitation.strength[0]

    @cached_property
    def approach_bounds(self) -> Array:
        """Upper bounds on the increase of overlaps from rest, (N+1,) m, from the energy."""
        return read_only(self.chain.contacts.approach_bound(self.energy))

    @property
    def overlap_bounds(self) -> Array:
        """Upper bounds on the overlap of every contact at any time, (N+1,) m."""
        return self.chain.contacts.overlap + self.approach_bounds

    @cached_property
    def largest_strain(self) -> float:
        """Bound on ``|r / eps|`` of all contacts, rigorous if it is small; infinite without one."""
        return float(self.chain.contacts.strain_bound(self.approach_bounds))

    @cached_property
    def linear_strain(self) -> float:
        """Bound on ``|r / eps|`` of all contacts of the linear chain at any time, or infinity.

        If the excitation adds the energy E, a contact stretched by r stores at least ``r^2 / 2c``,
        so that r is at most ``sqrt(2 c E)``. The compliance c is 1/k. Between two fixed ends the
        other contacts must give way, and c is ``(1 - (1/k) / sum 1/k) / k``. An excitation that
        does work also acts against the viscous force of contacts, so its bound is larger by the
        factor ``1 + A omega``.
        """
        # A spring to the ground takes energy from contacts, but other ground laws may add energy.
        if self.chain.ground is not None and not ground.is_spring(self.chain.ground):
            return np.inf
        contacts = self.chain.contacts
        k = contacts.stiffness
        pressed = contacts.pressed
        # A contact that only touches opens at once, so that linear theory gives no bound.
        if not (pressed == contacts.exists).all() or not pressed.any():
            return np.inf
        compliance = np.divide(1.0, k, out=np.zeros(k.size), where=pressed)
        does_work = self.excitation.does_work
        # With a wall at the top both ends are fixed, unless the excitation does work.
        if pressed[0] and not does_work:
            compliance *= 1 - compliance / compliance.sum()
        norm = self.excitation.energy_norm(self.chain, self.duration)
        bound = float(norm * (np.sqrt(compliance[pressed]) / contacts.length[pressed]).max())
        if does_work:
            bound *= 1 + self.chain.damping.longest_time * self.linear_frequency
        return bound

    # Frequencies and phases.

    @cached_property
    def linear_frequency(self) -> float:
        """The highest frequency of the linear solution, rad/s: band edge or forcing."""
        return max(self.chain.band_edge, self.excitation.fastest)

    @cached_property
    def _ground_rate(self) -> float:
        """The largest frequency of a single grain on the ground, rad/s; 0 without a ground."""
        chain = self.chain
        if chain.ground is None:
            return 0.0
        displacement, speed = self.imposed
        # A free grain flies until the contacts or the ground reverse its motion.
        turns = max(self.linear_frequency, 1 / self.duration)
        reach = displacement + speed / turns
        stiffness = ground.largest_stiffness(chain.ground, reach, self.duration)
        return math.sqrt(float((stiffness / chain.masses).max()))

    @cached_property
    def fastest_motion(self) -> float:
        """The highest frequency that can be excited without damping, rad/s; 0 if nothing moves.

        The largest of three frequencies is used: the band edge of the chain at rest, the frequency
        of the two grains that the strike presses together, and the highest frequency of the
        forcing. The frequency of a grain on its ground is added in quadrature.
        """
        bounds = self.chain.bounds
        fastest = self.linear_frequency
        # If the bound is below the other frequencies, the overlaps of all contacts are not needed.
        if not (bounds and bounds.frequency(self._first_overlap_bound) <= fastest):
            stiffness = self.chain.contacts.stiffness_bound(self.first_overlaps).max()
            fastest = max(fastest, math.sqrt(2 * stiffness / self.chain.masses.min()))
        return math.hypot(fastest, self._ground_rate)

    @cached_property
    def highest_frequency(self) -> float:
        """Bound on the step of every method, rad/s: the highest frequency that can be excited.

        If damping stops the fastest motion at a larger rate, this rate is the bound.
        """
        # A chain without load and strike has no frequency; any positive value serves.
        return self.chain.damping.fastest_rate(self.fastest_motion) or 1 / self.duration

    @cached_property
    def total_phase(self) -> float:
        """Phase of the fastest motion over the whole run, rad."""
        return self.highest_frequency * self.duration

    @cached_property
    def sampling_phase(self) -> float:
        """Phase of the fastest motion in a sampling interval, rad."""
        return self.total_phase / self.intervals

    @cached_property
    def sampling_decay(self) -> float:
        """Exponent of the decay of the fastest motion by damping in a sampling interval."""
        return self.chain.damping.decay(self.highest_frequency, self.sampling_interval)

    @property
    def damping_effect(self) -> float:
        """Estimate of the relative change by neglecting damping, at most 1; 0 without damping."""
        return self.chain.damping.effect(self.fastest_motion, self.duration)

    # Reach of the wave.

    @cached_property
    def light_cone(self) -> LightCone[Self] | None:
        """The grains that the wave can have reached at the end; None if these are all grains."""
        first, last = find_reached(self)
        if last - first + 1 == self.chain.grains:
            return None
        recorded = self.recorded
        columns = np.flatnonzero((recorded >= first) & (recorded <= last))
        return LightCone(self.part(first, last), recorded[columns] - first, as_slice(columns))

    @property
    def reached(self) -> Self:
        """The scene restricted to the grains that the wave can have reached, all recorded."""
        return self.light_cone.scene if self.light_cone else self

    def part(self, first: int, last: int) -> Self:
        """Return grains first ... last, all recorded; valid until a wave reaches their ends."""
        # A part of a valid scene is valid.
        return make_unchecked(
            type(self),
            chain=self.chain.part(first, last),
            excitation=self.excitation.part(first, last),
            duration=self.duration,
            samples=self.samples,
        )


def find_reached(scene: SceneFacts) -> tuple[int, int]:
    """Return the first and last grain that may have moved by more than 1e-22 of the strike.

    If all springs are at most as stiff as k_max, a unit displacement of one grain moves a grain
    d grains away by at most the modified Bessel function I_2d(W t), with W^2 = 4 k_max / m_min.
    This bound holds however the stiffness varies, because all terms of the series of the bounding
    solution are positive. The energy above rest gives an upper bound on the stiffness of contacts.
    A driven chain, a chain on a ground and contacts that are infinitely stiff at a kink have no
    such bound, and their light cone is the whole chain. A drag does not change the bound; viscous
    contacts have the bound of `_damped_distance`.
    """
    chain = scene.chain
    grains = chain.grains
    if not math.isfinite(scene.energy) or grains < CUT.shortest or chain.ground is not None:
        return 1, grains
    if chain.law.onset < 1:
        return 1, grains
    top, bottom = scene.excitation.reach(chain)
    # The stiffest contact within reach determines the reach, so the range is doubled until it
    # suffices.
    reach = 32
    while True:
        first = chain.first_of_part(max(1, top - reach))
        last = min(grains, bottom + reach)
        if last - first + 1 > CUT.share * grains:
            return 1, grains
        omega = _fastest(scene, first, last)
        if not math.isfinite(omega):
            return 1, grains
        viscosity = chain.damping.longest_time
        if viscosity > 0:
            needed = _damped_distance(omega * viscosity, omega * scene.duration)
        else:
            needed = _lossless_distance(2 * omega * scene.duration)
        if needed <= reach:
            return chain.first_of_part(max(1, top - needed)), min(grains, bottom + needed)
        reach = max(needed, 2 * reach)


def _fastest(scene: SceneFacts, first: int, last: int) -> float:
    """Return an upper bound on sqrt(k_max / m_min) of grains first ... last, rad/s."""
    chain = scene.chain
    if chain.grains <= FEW_GRAINS:
        stiffness = chain.contacts.stiffness_bound(scene.overlap_bounds)
        # These are the contacts between these grains, and the contacts with the walls of the chain.
        stiffness = stiffness[first - (first == 1) : last + (last == chain.grains)]
        masses = chain.masses[first - 1 : last]
    else:
        # The arrays of a long chain are expensive; those of the part suffice.
        piece = chain.part(first, last)
        stiffness = piece.contacts.stiffness_bound(piece.contacts.overlap_bound(scene.energy))
        masses = piece.masses
    return math.sqrt(float(stiffness.max()) / masses.min())


def _lossless_distance(x: float) -> int:
    """Return d from which I_2d(x) <= (x/2)^2d / (2d)! exp(x^2 / (8d + 4)) is negligible.

    The logarithm of this upper bound is concave where it decreases, so Newton's method approaches
    the root from larger d and never ends below it.
    """
    d = max(8.0, x / 2)
    log = math.log(x / 2 + 1e-300)
    square = x * x
    correction = 1.0
    while abs(correction) > 0.5 and d >= 8:
        excess = 2 * d * log - math.lgamma(2 * d + 1) + square / (8 * d + 4) - math.log(CUT.unseen)
        # The derivative of log (2d)! is approximately 2 log(2d + 1/2).
        slope = 2 * (math.log(2 * d + 0.5) - log) + 8 * square / (8 * d + 4) ** 2
        correction = excess / slope
        d += correction
    return max(8, math.ceil(d)) + 2


def _damped_distance(viscosity: float, time: float) -> int:
    """Return the number of grains beyond which viscous contacts transmit no motion.

    Masses m between springs k (1 + A d/dt) move at most as far as the solution of x'' = (k/m) (1 +
    A d/dt) (x_(n-1) + 2 x_n + x_(n+1)), in which all terms are positive. From grain to grain, the
    Laplace transform of this solution decreases by the factor q, where q + 1/q + 2 = s^2 / (k/m) /
    (1 + A s). A grain d grains away therefore moves by at most s exp(s t) q^d, for every s that has
    a root q < 1.

    Parameters
    ----------
    viscosity : float
        The relaxation time A, in units of sqrt(m / k).
    time : float
        The time t, in units of sqrt(m / k).
    """
    rates = np.geomspace(2.0, 1e6, 400)
    # The expression q + 1/q - 2 is positive where the transform decreases.
    excess = rates**2 / (1 + viscosity * rates) - 4
    falls = excess > 0
    rates = rates[falls]
    exponent = rates * time + np.log(rates) - math.log(CUT.unseen)
    needed = exponent / np.arccosh(1 + excess[falls] / 2)
    return max(8, math.ceil(float(needed.min(initial=2.0**31)))) + 2
