"""How much is left out by linearising Eq. (1), from the overlaps along the linear solution.

A compressed contact is stiffer than one at rest: a wave of strain s, the change of the overlap over
the overlap at rest, is faster than a weak one by the fraction (delta - 1) s / 4. So it comes too
early by the integral of that over time, and a wave that is off by dt is wrong by its rate of change
times dt. Where waves meet and come back, their leads add up at random: like a random walk, with a
step a radian. In few grains they may fit each other (`resonance`), and a train of waves steepens
for as long as it travels. Held against the nonlinear engine over strike numbers from 1e-4 to 10,
gravity from 0.1 to 10 g, exponents from 1.1 to 3, and chains that are struck at the top, within or
all over, the estimate is within a factor of 3 of the true difference up to 0.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

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
from ...scene.packet import Packet
from ...scene.scene import Scene
from ...util.arrays import Array
from .resonance import FEW, Resonance


@dataclass(frozen=True)
class Factors:
    """Factors of the model error; analysis/calibration/linear_model_error.py measures them.

    Attributes
    ----------
    strays : float
        Error over (delta - 1) times the strains of a wave added up as a random walk.
    steepens : float
        Error over (delta - 1) s omega t of a train of waves, whose crests gain on its troughs;
        theory gives 1/4.
    doubt : float
        Bound over estimate.
    large : float
        Bound from which on it says no more than that the error is large: there are contacts near to
        opening, where no factor holds.
    small : float
        Of the largest motion, chosen: below this error what acts all the time is given the bound.
    """

    strays: float = 0.15
    steepens: float = 0.35
    doubt: float = 4.0
    large: float = 0.5
    small: float = 0.01


@dataclass(frozen=True)
class EvaluationTimes:
    """When a linear solution is evaluated besides its samples.

    Attributes
    ----------
    evenly : int
        Least evaluations all over the run; analysis/calibration/linear_model_error.py.
    few_values : int
        Evaluations times grains all over the run that take next to no time: in few grains more of
        them show better what the shifts of the phase come to.
    earliest, growth : float
        First one after the start, in radians, and ratio of each of the next ones to it: a wave that
        spreads has most of its strain at first.
    resolved : float
        Evaluations in a radian of the highest frequency where contacts may open.
    most_values : int
        Evaluations times grains beyond which a run is too long for that.
    opening : float
        Strain, known to 1e-2 from evaluations so close, from which on a contact counts as open;
        analysis/calibration/linear_openings.py.
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
        To go on from, as `state` was.
    """

    def __init__(self, scene: Scene, state: Array | None = None):
        chain = scene.chain
        contacts = chain.contacts
        inverse_mass = 1 / chain.masses
        # what is held or driven answers no force
        inverse_mass[chain.movable :] = 0.0
        inverse_mass[: scene.excitation.driven] = 0.0
        length = np.where(contacts.pressed, contacts.length, np.inf)
        self._links = LinearLinks(contacts.stiffness, 1 / length, inverse_mass)
        self._excess = excess(scene)
        self._excitation = scene.excitation
        self._grain = first_moved(scene) - 1
        self._fastest = scene.linear_frequency
        # a little more than half of the time from one close evaluation to the next
        near = 0.6 / LOOKS.resolved / self._fastest
        opening = LOOKS.opening if may_open(scene) else -np.inf
        self._law = StrainError(self._excess / 4, near, opening)
        self._decidable = decidable(scene)
        self._resonance = Resonance(scene)
        self._in_phase = in_phase(scene)
        self._travels = travel(scene) if self._in_phase and chain.grains > FEW else 0.0
        self._state = start() if state is None else np.array(state).view(STATE)

    def add(self, solution: Evaluations) -> None:
        """Take in the solution at more times."""
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
        """Copy of the sums, from which another one goes on."""
        return self._state.view(np.float64).copy()

    @property
    def error(self) -> float:
        """Estimated relative error, as defined for a trajectory; 1 says that it is large.

        Below `Factors.small` it is the bound where something acts all the time or a packet runs:
        what their few frequencies do to each other may add up in phase, and random trials found
        estimates up to 8 times too low.
        """
        bound = min(self.at_most, FACTORS.small) if self._in_phase else 0.0
        return max(self.estimate, bound)

    @property
    def estimate(self) -> float:
        """Largest of these parts, and what open contacts add by pulling."""
        if not self._decidable:
            return 1.0
        pulled = _over(self.sums.pulled, self.sums.velocity)
        return min(1.0, max(self.scattered, self.steepens) + pulled)

    @property
    def at_most(self) -> float:
        """Upper bound on that error: reflections or a drive may shift the phase either way."""
        if self.remark:
            return 1.0
        bound = max(FACTORS.doubt * self.scattered, self.steepens)
        return bound if bound < FACTORS.large else 1.0

    @property
    def scattered(self) -> float:
        """Error of waves that are no long train, by the largest of three parts.

        It saturates: waves that have nothing in common differ by about their size.
        """
        error = max(self.shifted, self.resonant, self.strayed)
        # small errors as they are, large ones below 1
        return error / (1 + error)

    @property
    def shifted(self) -> float:
        """Error that the shift of the phase makes in samples."""
        sums = self.sums
        displacement = _over(sums.displacement_error, sums.displacement)
        return max(displacement, _over(sums.velocity_error, sums.velocity))

    @property
    def resonant(self) -> float:
        """Error of few grains whose waves fit each other."""
        sums = self.sums
        displacement, velocity = self._resonance.motion(sums.time)
        return float(max(_over(displacement, sums.displacement), _over(velocity, sums.velocity)))

    @property
    def strayed(self) -> float:
        """Error by strains that add up as a random walk."""
        sums = self.sums
        walk = sums.largest_strain + math.sqrt(self._frequency * sums.squared_strain)
        return FACTORS.strays * self._excess * walk * self._begun

    @property
    def steepens(self) -> float:
        """Steepening of a train of waves, which gains where compressed and loses where stretched.

        It does so as long as it travels, a packet until it is apart from its second harmonic and
        its mean strain.
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
        """Part of its velocity that the wave has changed: 1 unless the run ends before."""
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
        """Why the linear solution does not hold at all, or is not known to, if so."""
        opened = self.sums.opened
        if not math.isnan(opened):
            return f"not linear here: contact {opened:.0f} opens"
        if self._decidable:
            return ""
        return "contacts may open: the run is too long to look at every oscillation"


def _over(error: float, size: float) -> float:
    """Return an error relative to a size, 0 where nothing moves."""
    return error / size if size > 0 else 0.0


def expected_error(scene: Scene) -> float:
    """Predict the bound on the model error of Eq. (3) from the energy put in.

    The energy bounds the strain. It adds up as a random walk, or in phase where something acts all
    the time or a packet runs. 1 where contacts may open. The run itself gives the bound.
    """
    if may_open(scene):
        return 1.0
    radians = scene.linear_frequency * scene.duration
    # strains that keep step add up to omega t of them, others to its root
    walk = 1 + (radians if in_phase(scene) else math.sqrt(radians))
    strains = excess(scene) * scene.linear_strain * walk
    return min(1.0, FACTORS.doubt * FACTORS.strays * strains)


def excess(scene: Scene) -> float:
    """Return by how much a force bends away from a straight line; viscosity adds to it.

    It is delta - 1 for a power, see `ContactLaw.bend`.
    Its force (1 + A d/dt) s^2 is larger by the modulus of 1 + i A omega than that of s^2 alone.
    """
    turn = scene.chain.damping.longest_time * scene.linear_frequency
    return math.hypot(1.0, turn) * float(np.abs(scene.chain.contacts.bend).max())


def in_phase(scene: Scene) -> bool:
    """Whether something acts all the time, or a packet runs: few frequencies, which keep step."""
    return scene.excitation.does_work or isinstance(scene.excitation, Packet)


def may_open(scene: Scene) -> bool:
    """Whether the energy put in could open a contact of the linear chain."""
    return scene.linear_strain >= 1


def passage(scene: Scene) -> Array:
    """Return how long a weak wave takes from grain to grain, (N-1,) s."""
    chain = scene.chain
    return np.asarray(np.sqrt(chain.masses[:-1] / chain.linear_stiffness))


def first_moved(scene: Scene) -> int:
    """Return the number of the grain that is acted on, or of the first that moves at t = 0."""
    return scene.excitation.acts_on or scene.excitation.reach(scene.chain)[0]


def travel(scene: Scene) -> float:
    """Return how long a wave train travels at its largest strain, s.

    A packet travels to an end. What acts makes the same strain all the time, which falls on the way
    as the flow of energy is kept (WKB): like 1 / (overlap sqrt(stiffness speed)).
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
    """Return by what part of the largest one masses and contact constants differ, by name."""
    arrays = {"masses": chain.masses, "contact_constants": chain.contact_constants}
    return {name: float(np.ptp(x) / x.max()) for name, x in arrays.items() if x.size}


def evaluation_times(scene: Scene) -> Array:
    """Return times, s, at which a linear solution is evaluated besides its samples.

    They are close enough for every oscillation where contacts may open, unless that takes too many.
    Otherwise they are spread all over the run, and not evenly, lest all fall on the same phase of
    an oscillation.
    """
    if close := _close(scene):
        return np.linspace(0, scene.duration, close, endpoint=False)
    first = LOOKS.earliest / scene.linear_frequency
    early = first * LOOKS.growth ** np.arange(_early(scene))
    spread = _spread(scene)
    # a fixed seed: a run that goes on must look at the same times
    offsets = np.random.default_rng(0).random(spread)
    offsets[0] = 0.0
    return np.union1d(early, (np.arange(spread) + offsets) * (scene.duration / spread))


def evaluations(scene: Scene) -> int:
    """Return how many these are."""
    return _close(scene) or _spread(scene) + _early(scene)


def decidable(scene: Scene) -> bool:
    """Whether the energy excludes that contacts open, or every oscillation is looked at."""
    return not may_open(scene) or dense(scene) or bool(_close(scene))


def dense(scene: Scene) -> bool:
    """Whether samples resolve every oscillation, so that no other evaluations are needed."""
    in_a_radian = LOOKS.resolved if may_open(scene) else 1.0
    return bool(in_a_radian * scene.duration * scene.linear_frequency <= scene.intervals)


def _early(scene: Scene) -> int:
    """Return how many evaluations follow the beginning more and more slowly."""
    radians = scene.duration * scene.linear_frequency
    return max(0, int(math.log(radians / LOOKS.earliest) / math.log(LOOKS.growth)) + 1)


def _spread(scene: Scene) -> int:
    """Return how many evaluations are spread all over the run."""
    resolving = math.ceil(LOOKS.resolved * scene.duration * scene.linear_frequency)
    return max(LOOKS.evenly, min(LOOKS.few_values // scene.chain.grains, resolving))


def _close(scene: Scene) -> int:
    """Return how many evaluations resolve every oscillation where contacts may open, or 0."""
    needed = LOOKS.resolved * scene.duration * scene.linear_frequency + 1
    if may_open(scene) and needed * scene.chain.grains <= LOOKS.most_values:
        return max(LOOKS.evenly, math.ceil(needed))
    return 0
