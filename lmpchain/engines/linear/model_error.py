"""Model error of linear theory: the effect of linearising Eq. (1), from the linear solution.

A compressed contact is stiffer than one at rest. Therefore a wave of strain s, the change of the
overlap over the overlap at rest, is faster than a weak wave by the fraction (delta - 1) s / 4. The
arrival is early by dt, the integral of this fraction over time, and the error is the rate of change
of the wave times dt. If waves are reflected and meet, their shifts add up as a random walk with one
step for each radian. In a chain of few grains, modes may be in resonance (`resonance`), and a train
of waves steepens as long as it travels. The estimate was compared with the nonlinear engine for
strike numbers from 1e-4 to 10, gravity from 0.1 to 10 g, exponents from 1.1 to 3, and strikes at
the top, inside, or on all grains. It is within a factor of 3 of the true difference if this
difference is below 0.3.

Resonance is the motion of a third wave that a pair of waves drives by the curved force law. If the
overlap D of a contact changes by s, its force has the linear part k s and the quadratic part
k c s^2 / (2 D), with the stiffness k, and c = delta - 1 for a power law (`ContactLaw.bend`).
Therefore two waves of frequencies a and b force every mode at a + b and |a - b|. A mode of
frequency w responds with the amplitude force / (2 w) times min(t, 2 / |w - a - b|). In a chain of
many grains these many responses have random phases. In a chain of few grains, modes may be in
resonance by chance, and then a response grows in time.

Contacts that harden or soften on both sides of the rest alike, as springs with a cubic force, have
c = 0. They change the frequency of waves in proportion to the square of the strain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...chain.chain import Chain
from ...integrators.kernels.phase_error import (
    STATE,
    Evaluations,
    ImposedMotion,
    LinearLinks,
    PhaseSums,
    StrainError,
    accumulate,
    start,
)
from ...scene.excitation import Packet
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


@dataclass(frozen=True)
class Factors:
    """Factors of the model error, measured by analysis/calibration/linear_model_error.py.

    Attributes
    ----------
    strays : float
        Ratio of the error to (delta - 1) times the sum of strains that add up as a random walk.
    steepens : float
        Ratio of the error to (delta - 1) s omega t for a train of waves, whose crests are faster
        than its troughs; theory gives 1/4.
    doubt : float
        Ratio of the upper bound to the estimate.
    large : float
        Largest upper bound that is returned. Beyond it contacts are close to opening, no factor is
        valid, and the bound is 1.
    small : float
        Relative error below which forced scenes get the upper bound as their estimate (chosen).
    """

    strays: float = 0.15
    steepens: float = 0.35
    doubt: float = 4.0
    large: float = 0.5
    small: float = 0.01


@dataclass(frozen=True)
class EvaluationTimes:
    """Times between the samples at which a linear solution is evaluated.

    Attributes
    ----------
    evenly : int
        Smallest number of evaluations; see analysis/calibration/linear_model_error.py.
    few_values : int
        Number of evaluations times grains that takes nearly no time. In a chain of few grains, more
        evaluations give a better mean of the phase shifts.
    earliest, growth : float
        Time of the first evaluation after the start, in radians; ratio of successive times. Early
        times are close to each other, because a spreading wave has its largest strain at first.
    resolved : float
        Number of evaluations for each radian of the highest frequency if contacts may open.
    most_values : int
        Largest number of evaluations times grains for resolving openings.
    opening : float
        Strain below which a contact counts as open, because the evaluations resolve the strain to
        1e-2; see analysis/calibration/linear_openings.py.
    """

    evenly: int = 64
    few_values: int = 1024
    earliest: float = 0.5
    growth: float = 1.25
    resolved: float = 2.0
    most_values: int = 2**22
    opening: float = -0.99


FACTORS = Factors()
LOOKS = EvaluationTimes()


class PhaseError:
    """Phase error of the linear solution, accumulated along its evaluation times.

    Parameters
    ----------
    scene : Scene
    state : array, optional
        State from which to continue.
    """

    def __init__(self, scene: Scene, state: Array | None = None):
        chain = scene.chain
        contacts = chain.contacts
        inverse_mass = 1 / chain.masses
        # Held and driven grains do not react to forces.
        inverse_mass[chain.movable :] = 0.0
        inverse_mass[: scene.excitation.driven] = 0.0
        length = np.where(contacts.pressed, contacts.length, np.inf)
        ground = np.array(chain.ground_stiffness)
        self._links = LinearLinks(contacts.stiffness, 1 / length, inverse_mass, ground)
        self._excess = excess(scene)
        self._viscous = _viscous_factor(scene)
        self._excitation = scene.excitation
        self._grain = first_moved(scene) - 1
        self._contacts = contacts
        self._fastest = scene.linear_frequency
        # A little more than half of the time between two close evaluations.
        near = 0.6 / LOOKS.resolved / self._fastest
        opening = LOOKS.opening if may_open(scene) else -np.inf
        self._law = StrainError(self._excess / 4, near, opening)
        self._decidable = decidable(scene)
        self._resonance = Resonance(scene)
        self._in_phase = in_phase(scene)
        self._travels = travel(scene) if self._in_phase and chain.grains > FEW else 0.0
        self._state = start() if state is None else np.array(state).view(STATE)

    def add(self, solution: Evaluations) -> None:
        """Add the solution at more times."""
        size = solution.time.size
        wall = np.zeros((size, 3))
        acceleration = np.zeros(size)
        wave = self._excitation.waveform
        if wave and self._excitation.wall:
            wall = np.stack([wave.at(solution.time, order) for order in range(3)], axis=1)
        elif wave and self._excitation.driven:
            acceleration = wave.at(solution.time, 2)
        elif wave:
            acceleration = wave.at(solution.time) * self._links.inverse_mass[self._grain]
        imposed = ImposedMotion(wall, self._grain, acceleration)
        accumulate(self._state, self._links, solution, imposed, self._law)

    @property
    def state(self) -> Array:
        """Copy of the sums, from which another object can continue."""
        return self._state.view(np.float64).copy()

    @property
    def error(self) -> float:
        """Estimated relative error, as defined for a trajectory; 1 represents any larger error.

        For forced scenes and packets, the upper bound is used up to `Factors.small`. The effects of
        their few frequencies may add up in phase, and in random trials the estimates were up to 8
        times too small.
        """
        bound = min(self.at_most, FACTORS.small) if self._in_phase else 0.0
        return max(self.estimate, bound)

    @property
    def estimate(self) -> float:
        """The largest part of the error, plus the contribution of open contacts."""
        if not self._decidable:
            return 1.0
        pulled = _over(self.sums.pulled, self.sums.velocity)
        return min(1.0, max(self.scattered, self.steepens) + pulled)

    @property
    def at_most(self) -> float:
        """Upper bound on the error; reflections or a drive may shift phases in either direction."""
        if self.remark:
            return 1.0
        bound = max(FACTORS.doubt * self.scattered, self.steepens)
        return bound if bound < FACTORS.large else 1.0

    @property
    def scattered(self) -> float:
        """Error of waves that do not form a long train: the largest of four parts.

        The error saturates below 1, because two unrelated waves differ by about their size.
        """
        error = max(self.shifted, self.resonant, self.strayed, self.detuned)
        return error / (1 + error)

    @property
    def shifted(self) -> float:
        """Error of the samples by the phase shift."""
        sums = self.sums
        displacement = _over(sums.displacement_error, sums.displacement)
        return max(displacement, _over(sums.velocity_error, sums.velocity))

    @property
    def resonant(self) -> float:
        """Error by resonance of modes of a few grains."""
        sums = self.sums
        displacement, velocity = self._resonance.motion(sums.time)
        return float(max(_over(displacement, sums.displacement), _over(velocity, sums.velocity)))

    @property
    def strayed(self) -> float:
        """Error by strains that accumulate as a random walk."""
        sums = self.sums
        walk = sums.largest_strain + math.sqrt(self._frequency * sums.squared_strain)
        return FACTORS.strays * self._excess * walk * self._begun

    @property
    def detuned(self) -> float:
        """Error of the frequency by contacts that harden or soften on both sides alike.

        Twice the relative change of the frequency is at most that of the mean stiffness, which is
        proportional to the square of the strain or grows faster.
        """
        sums = self.sums
        if not sums.largest_strain:
            return 0.0
        contacts = self._contacts
        hardening = self._viscous * contacts.law.hardening(contacts, sums.largest_strain)
        return hardening * self._frequency * sums.squared_strain / (2 * sums.largest_strain**2)

    @property
    def steepens(self) -> float:
        """Error by steepening of a wave train, whose crests are faster than its troughs.

        The error grows as long as the train travels. For a packet, it grows until the packet
        separates from its second harmonic and its mean strain.
        """
        if not self._travels:
            return 0.0
        sums = self.sums
        frequency = self._frequency
        travels = min(sums.time, self._travels)
        if isinstance(self._excitation, Packet) and frequency > 0:
            ratio = min(1.0, frequency / self._fastest)
            apart = frequency * ratio**2 / (1 + math.sqrt(1 - ratio**2))
            travels = min(travels, (1 + 2 * ratio * self._excitation.width) / apart)
        squared = math.sqrt(sums.squared_strain * sums.time)
        grown = frequency * min(sums.largest_strain * travels, squared)
        return FACTORS.steepens * self._excess * (sums.largest_strain * self._begun + grown)

    @property
    def _frequency(self) -> float:
        """Frequency of the wave, rad/s: its largest acceleration over its largest velocity."""
        return min(self._fastest, _over(self.sums.acceleration, self.sums.velocity))

    @property
    def _begun(self) -> float:
        """Fraction of an oscillation that the run contains, at most 1."""
        return min(1.0, self._frequency * self.sums.time)

    @property
    def scale(self) -> Array:
        """Largest displacement and velocity at any time, to which errors are relative, (2,)."""
        largest = np.array([self.sums.displacement, self.sums.velocity])
        return np.where(largest > 0, largest, np.inf)

    @property
    def sums(self) -> PhaseSums:
        """Sums along the solution so far."""
        return PhaseSums(*self._state[0].item())

    @property
    def remark(self) -> str:
        """The reason why the linear solution is invalid or may be invalid; empty if it is valid."""
        opened = self.sums.opened
        if not math.isnan(opened):
            return f"not linear here: contact {opened:.0f} opens"
        if self._decidable:
            return ""
        return "contacts may open: the run is too long to check every oscillation"


def _over(error: float, size: float) -> float:
    """Return an error relative to a size; 0 if nothing moves."""
    return error / size if size > 0 else 0.0


def expected_error(scene: Scene) -> float:
    """Return an expected bound on the model error of Eq. (3) from the energy of the excitation.

    The energy bounds the strain. The effects of the strain add up as a random walk, or in phase for
    forced scenes and packets. The bound is 1 if contacts may open. The run gives the final bound.
    """
    if may_open(scene):
        return 1.0
    radians = scene.linear_frequency * scene.duration
    # Strains in phase accumulate in proportion to omega t, others to its square root.
    walk = 1 + (radians if in_phase(scene) else math.sqrt(radians))
    strains = excess(scene) * scene.linear_strain * walk
    contacts = scene.chain.contacts
    hardening = _viscous_factor(scene) * contacts.law.hardening(contacts, scene.linear_strain)
    detuned = hardening * radians / 2
    return min(1.0, max(FACTORS.doubt * FACTORS.strays * strains, detuned))


def excess(scene: Scene) -> float:
    """Return k'(eps) l / k(eps) of the contacts, delta - 1 for a power; see `ContactLaw.bend`.

    With viscosity, the quadratic part of the force, (1 + A d/dt) s^2, is larger than s^2 by the
    factor |1 + i A omega|.
    """
    return _viscous_factor(scene) * float(np.abs(scene.chain.contacts.bend).max())


def _viscous_factor(scene: Scene) -> float:
    """Return |1 + i A omega|, the factor by which viscosity enlarges a change of the force."""
    return math.hypot(1.0, scene.chain.damping.longest_time * scene.linear_frequency)


def in_phase(scene: Scene) -> bool:
    """Return whether the wave has few frequencies that stay in phase: forced, or a packet."""
    return scene.excitation.does_work or isinstance(scene.excitation, Packet)


def may_open(scene: Scene) -> bool:
    """Return whether the energy of the excitation could open a contact of the linear chain."""
    return scene.linear_strain >= 1


def passage(scene: Scene) -> Array:
    """Return the travel time of a weak wave from grain to grain, (N-1,) s."""
    chain = scene.chain
    return np.asarray(np.sqrt(chain.masses[:-1] / chain.linear_stiffness))


def first_moved(scene: Scene) -> int:
    """Return the number of the forced grain or, without forcing, of the first moving grain."""
    return scene.excitation.acts_on or scene.excitation.reach(scene.chain)[0]


def travel(scene: Scene) -> float:
    """Return the time for which a wave train travels at its largest strain, s.

    A packet travels to an end of the chain. Along the chain, the energy flux of a forced wave is
    constant (WKB), so that its strain is proportional to 1 / (overlap sqrt(stiffness speed)).
    """
    times = passage(scene)
    if isinstance(scene.excitation, Packet):
        return float(times.sum())
    chain = scene.chain
    start_at = first_moved(scene) - 1
    strain = np.sqrt(times / chain.linear_stiffness) / chain.contacts.length[1:-1]
    longest = 0.0
    for path in (slice(start_at, None), slice(start_at - 1, None, -1) if start_at else slice(0)):
        if times[path].size:
            lasting = np.cumsum(times[path] * strain[path]) / np.maximum.accumulate(strain[path])
            longest = max(longest, float(lasting.max()))
    return longest


def unlike(chain: Chain) -> dict[str, float]:
    """Return the relative scatter of masses and contact constants, by name."""
    arrays = {"masses": chain.masses, "contact_constants": chain.contact_constants}
    return {name: float(np.ptp(x) / x.max()) for name, x in arrays.items() if x.size}


def evaluation_times(scene: Scene) -> Array:
    """Return times between the samples at which a linear solution is evaluated, s.

    If contacts may open, the times resolve every oscillation, unless too many times are needed.
    Otherwise they have random distances over the run, so that they sample different phases of an
    oscillation.
    """
    if close := _close(scene):
        return np.linspace(0, scene.duration, close, endpoint=False)
    first = LOOKS.earliest / scene.linear_frequency
    early = first * LOOKS.growth ** np.arange(_early(scene))
    spread = _spread(scene)
    # The seed is fixed, because a resumed run must have the same times.
    offsets = np.random.default_rng(0).random(spread)
    offsets[0] = 0.0
    return np.union1d(early, (np.arange(spread) + offsets) * (scene.duration / spread))


def evaluations(scene: Scene) -> int:
    """Return the number of `evaluation_times`."""
    return _close(scene) or _spread(scene) + _early(scene)


def decidable(scene: Scene) -> bool:
    """Return whether the run resolves openings of contacts, or the energy excludes them."""
    return not may_open(scene) or dense(scene) or bool(_close(scene))


def dense(scene: Scene) -> bool:
    """Return whether the samples resolve every oscillation, so that no other times are needed."""
    in_a_radian = LOOKS.resolved if may_open(scene) else 1.0
    return bool(in_a_radian * scene.duration * scene.linear_frequency <= scene.intervals)


def _early(scene: Scene) -> int:
    """Return the number of evaluations after the start at increasing distances."""
    radians = scene.duration * scene.linear_frequency
    return max(0, int(math.log(radians / LOOKS.earliest) / math.log(LOOKS.growth)) + 1)


def _spread(scene: Scene) -> int:
    """Return the number of evaluations at random times of the run."""
    resolving = math.ceil(LOOKS.resolved * scene.duration * scene.linear_frequency)
    return max(LOOKS.evenly, min(LOOKS.few_values // scene.chain.grains, resolving))


def _close(scene: Scene) -> int:
    """Return the number of evaluations that resolve contact openings; 0 if no contact may open."""
    needed = LOOKS.resolved * scene.duration * scene.linear_frequency + 1
    if may_open(scene) and needed * scene.chain.grains <= LOOKS.most_values:
        return max(LOOKS.evenly, math.ceil(needed))
    return 0
