"""How much is left out by linearising Eq. (1), from the overlaps along the linear solution.

A compressed contact is stiffer than one at rest: a wave of strain s, the change of the overlap over the overlap at
rest, is faster than a weak one by the fraction (delta - 1) s / 4. So it comes too early by the integral of that over
time, and a wave that is off by dt is wrong by its rate of change times dt. Reflections at a free end turn compression
into rarefaction, which makes up for it, hence the integral with its sign. Held against the nonlinear engine over
strike numbers from 1e-4 to 10, gravity from 0.1 to 10 g, exponents from 1.1 to 3, and chains that are struck at the
top, within or all over, the estimate is within a factor of 3 of the true difference up to 0.3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...chain.chain import Chain
from ...integrators.kernels import phase_error as kernel
from ...integrators.kernels.phase_error import accumulate, start
from ...scene.packet import Packet
from ...scene.scene import Scene
from ...util.arrays import Array
from .resonance import FEW, Resonance

EARLIEST, GROWTH, EVENLY = (
    0.5,
    1.25,
    64,
)  # extra evaluation times: geometric (ratio 1.25) and 64 all over the run
SMALL = 1024  # values of one chain for which more of them cost next to nothing
# where contacts may open: evaluations in a unit of 1 / highest frequency, the most of them, and the most values
RESOLVED, MOST_TIMES, MOST_VALUES = 2.0, 2**18, 2**22
# analysis/calibration/linear_openings.py measures the next two
OPEN = -0.99  # strain, known to 1e-2 from evaluations so close, at which a contact counts as open
GRAZES = 1e-3  # of the largest velocity, which a contact that opens so little may take
SMALL_ERROR = 0.01  # of the largest motion, chosen: below it what acts is held to a bound, above to a factor of DOUBT
# analysis/calibration/linear_model_error.py measures the next ones
AT_ONCE = 0.25  # of (delta - 1) s: the distortion that no phase accounts for
DOUBT = 3.0  # true error over the estimate
LARGE = 0.6  # bound from which on it says no more than that the error is large
STRAYS, WANDER = (
    0.15,
    0.6,
)  # true error over strains that add up as a random walk: an estimate, and a bound
SLOWS = 0.05  # true error over (delta - 1) strain^2 periods: an oscillation is slower the stronger it is
STEEPENS = 0.35  # true error over (delta - 1) s omega t of a wave train, whose crests gain on its troughs; theory: 1/4
COLUMN, STEEPEST = (
    0.272,
    2.2,
)  # the error over (delta - 1) v0* of a column struck at the top; up to this delta

# of displacement and velocity
MOST = slice(kernel.MOST_DISPLACEMENT, kernel.MOST_VELOCITY + 1)
OFF = slice(kernel.OFF_DISPLACEMENT, kernel.OFF_VELOCITY + 1)


class PhaseError:
    """Phase error of the linear solution, accumulated along its evaluation times.

    Parameters
    ----------
    scene : Scene
    state : (13,) array, optional
        To go on from; see `lmpchain.integrators.kernels.phase_error`.
    """

    def __init__(self, scene: Scene, state: Array | None = None):
        chain, contacts = scene.chain, scene.chain.contacts
        self._stiffness, self._inverse_mass = contacts.stiffness, 1 / chain.masses
        self._inverse_mass[chain.movable :] = 0.0
        self._inverse_mass[: scene.excitation.driven] = 0.0
        self._inverse_overlap = np.divide(
            1.0, contacts.overlap, out=np.zeros(chain.grains + 1), where=contacts.pressed
        )
        self._excess, self._excitation = chain.exponent - 1, scene.excitation
        self._place = scene.excitation.reach(chain)[0] - 1
        self._fastest, self._most = fastest(scene), bounds(scene)[1]
        self._open_at = OPEN if may_open(scene) else -np.inf
        self._looked = decidable(scene)
        self._resonance = Resonance(scene)
        self._in_phase = scene.excitation.does_work or isinstance(scene.excitation, Packet)
        self._travels = travel(scene) if self._in_phase and chain.grains > FEW else 0.0
        self._spreads = struck_column(scene)  # where the lead is won at the first grains, and stays
        self.state = start() if state is None else state.copy()

    def add(
        self, times: Array, recorded: NDArray[np.bool_], u: Array, v: Array, reach: NDArray[np.intp]
    ) -> None:
        """Take in the solution at more times.

        Parameters
        ----------
        times : (T,) array
            s.
        recorded : (T,) array
            Whether they are samples: errors are those of samples, the others tell how the wave has got there.
        u, v : (T, N) arrays
            m and m/s.
        reach : (T, 2) array
            First grain, from 0, and the one after the last that moves.
        """
        walls, given = np.zeros((times.size, 3)), np.zeros(times.size)
        if (wave := self._excitation.waveform) and self._excitation.wall:
            walls = np.stack([wave.at(times, order) for order in range(3)], axis=1)
        elif wave:
            given = (
                wave.at(times, 2)
                if self._excitation.driven
                else wave.at(times) * self._inverse_mass[self._place]
            )
        accumulate(
            times, recorded, u, v, reach, walls, self._place, given, self._inverse_overlap, self._stiffness,
            self._inverse_mass, self._excess / 4, 0.6 / RESOLVED / self._fastest, self._open_at, self.state,
        )  # fmt: skip

    @property
    def error(self) -> float:
        """Estimated relative error, as defined for a trajectory; 1 says no more than that it is large.

        Below `SMALL_ERROR` it is the bound where something acts all the time or a packet runs: what their few
        frequencies do to each other may add up in phase, and random trials found estimates up to 8 times too low.
        """
        bound = min(self.at_most, SMALL_ERROR) if self._in_phase and self._looked else 0.0
        return max(self.estimate, bound)

    @property
    def estimate(self) -> float:
        """What is left out: the lead of the wave, waves in resonance, strains at random, steeper crests."""
        return max(self._scattered, self._steepens) if self._looked else 1.0

    @property
    def _scattered(self) -> float:
        """That of waves that are no long train."""
        slows = SLOWS * self._excess * self._typical * self.state[kernel.SQUARED_STRAIN]
        resonant = float((self._resonance.motion(self.state[kernel.TIME]) / self.scale).max())
        strayed = (
            0.0 if self._spreads else max(resonant, STRAYS * self._strays(self._typical)) + slows
        )
        return float(min(1.0, max(self._leads, strayed)))

    @property
    def at_most(self) -> float:
        """Upper bound on that error: reflections or a drive may shift the phase either way.

        It holds on all of 800 random scenes with up to 1000 periods, of every excitation.
        """
        if self.remark:
            return 1.0
        bound = max(DOUBT * self._scattered, WANDER * self._strays(self._fastest), self._steepens)
        return float(min(self._most, bound if bound < LARGE else 1.0))

    @property
    def _leads(self) -> float:
        """What the lead makes that the wave wins by its strain, and the pull of contacts that are open."""
        v = self.state[kernel.MOST_VELOCITY]
        if v == 0:
            return 0.0
        by_phase = (self.state[OFF] / self.scale).max()
        lead = max(by_phase, AT_ONCE * self._excess * self.state[kernel.MOST_STRAIN] * self._begun)
        grazes = 0.0 if np.isnan(self.state[kernel.OPENED]) else GRAZES
        return float(lead / (1 + lead) + max(self.state[kernel.PULLED] / v, grazes))

    def _strays(self, frequency: float) -> float:
        """Return the strains added up as if the phases that they shift went at random."""
        steps = self.state[kernel.MOST_STRAIN] + np.sqrt(
            frequency * self.state[kernel.SQUARED_STRAIN]
        )
        return float(self._excess * steps * self._begun)

    @property
    def _steepens(self) -> float:
        """What a train of waves gains where it is compressed, and loses where it is stretched.

        It does so as long as it travels, a packet until it is apart from its second harmonic and its mean strain.
        """
        if not self._travels:
            return 0.0
        frequency, time, squared = (
            self._typical,
            self.state[kernel.TIME],
            self.state[kernel.SQUARED_STRAIN],
        )
        travels, most = min(time, self._travels), self.state[kernel.MOST_STRAIN]
        if isinstance(self._excitation, Packet) and frequency > 0:
            ratio = min(1.0, frequency / self._fastest)
            apart = frequency * ratio**2 / (1 + np.sqrt(1 - ratio**2))
            travels = min(travels, (1 + 2 * ratio * self._excitation.width) / apart)
        grown = frequency * min(most * travels, np.sqrt(squared * time))
        return float(min(1.0, STEEPENS * self._excess * (most * self._begun + grown)))

    @property
    def _typical(self) -> float:
        """Frequency of the wave itself, rad/s: its largest acceleration over its largest velocity."""
        v, acceleration = self.state[kernel.MOST_VELOCITY], self.state[kernel.MOST_ACCELERATION]
        return min(self._fastest, float(acceleration / v)) if v > 0 else 0.0

    @property
    def _begun(self) -> float:
        """How much of its velocity the wave has changed: 1 unless the run ends while the motion begins."""
        return min(1.0, self._typical * float(self.state[kernel.TIME]))

    @property
    def scale(self) -> Array:
        """Largest displacement and velocity at any time, to which errors are relative, (2,) m and m/s."""
        return np.where(self.state[MOST] > 0, self.state[MOST], np.inf)

    @property
    def remark(self) -> str:
        """Why the linear solution does not hold at all, or is not known to, if so."""
        opened = self.state[kernel.OPENED]
        if not np.isnan(opened):
            return f"not linear here: contact {opened:.0f} opens"
        return (
            ""
            if self._looked
            else "contacts may open: the run is too long to look at every oscillation"
        )


def fastest(scene: Scene) -> float:
    """Return the highest frequency in the linear solution, rad/s."""
    return max(scene.chain.band_edge, scene.excitation.fastest)


def passage(scene: Scene) -> Array:
    """Return how long a weak wave takes from grain to grain, (N-1,) s."""
    chain = scene.chain
    return np.asarray(np.sqrt(chain.masses[:-1] / chain.linear_stiffness))


def travel(scene: Scene) -> float:
    """Return how long a wave train travels at its largest strain, s.

    A packet travels to an end. What acts makes the same strain all the time, which falls on the way as the flow of
    energy is kept (WKB): like 1 / (overlap sqrt(stiffness speed)).
    """
    if isinstance(scene.excitation, Packet):
        return float(passage(scene).sum())
    chain, place = scene.chain, max(0, scene.excitation.reach(scene.chain)[0] - 1)
    times = passage(scene)
    strain = np.sqrt(times / chain.linear_stiffness) / chain.equilibrium_overlap
    longest = 0.0
    for way in (slice(place, None), slice(place - 1, None, -1) if place else slice(0)):
        if times[way].size:
            longest = max(
                longest,
                float(
                    (np.cumsum(times[way] * strain[way]) / np.maximum.accumulate(strain[way])).max()
                ),
            )
    return longest


def may_open(scene: Scene) -> bool:
    """Whether the energy put in could open a contact of the linear chain."""
    return scene.linear_strain >= 1


def bounds(scene: Scene) -> tuple[float, float]:
    """Return a lower and an upper bound on the model error of Eq. (3), from the strike alone.

    The upper bound takes the largest strain for that of the whole time, as if the shift of phase grew without end: far
    too much for a wave that spreads out, about right for a few grains that are hit hard. It is 1 where contacts may
    open. On 547 random scenes `PhaseError` gives 1.3 times the lower bound or more. After a strike on the top of a
    column the strain falls faster than 1/h, and `stability.linear_theory.linear_law` is right within a factor of
    `DOUBT`.
    """
    excess, strain, least, most = (
        scene.chain.exponent - 1,
        scene.linear_strain,
        least_error(scene),
        1.0,
    )
    if strain < 1:
        periods = scene.chain.band_edge * scene.duration
        most = min(1.0, AT_ONCE * excess * strain * (1 + periods))
        if struck_column(scene):
            most = min(most, DOUBT * COLUMN * excess * scene.strike_number)
    return least, max(most, least)


def least_error(scene: Scene) -> float:
    """Return the lower one of these bounds."""
    return min(1.0, AT_ONCE * (scene.chain.exponent - 1) * scene.strike_number)


def struck_column(scene: Scene) -> bool:
    """Whether it is a uniform column under gravity alone, struck at its top, for at most ten passages."""
    chain, strike = scene.chain, scene.excitation
    if chain.grains == 1 or not (strike.strikes_top and chain.gravity > 0 and chain.top_load == 0):
        return False
    if chain.top != "free" or chain.exponent > STEEPEST or any(unlike(chain).values()):
        return False
    return bool(scene.duration <= 10 * passage(scene).sum())


def unlike(chain: Chain) -> dict[str, float]:
    """Return by what part of the largest one masses and contact constants differ, by name."""
    arrays = {"masses": chain.masses, "contact_constants": chain.contact_constants}
    return {name: float(np.ptp(x) / x.max()) for name, x in arrays.items() if x.size}


def evaluation_times(scene: Scene) -> Array:
    """Return times, s, at which a linear solution is evaluated besides its samples.

    They are close enough for every oscillation where contacts may open, unless that takes too many. Otherwise they are
    spread all over the run, and not evenly, lest all fall on the same phase of an oscillation.
    """
    first = EARLIEST / fastest(scene)
    count = max(0, int(np.log(scene.duration / first) / np.log(GROWTH)) + 1)
    places, close = _between(scene)
    if close:
        return np.linspace(0, scene.duration, places, endpoint=False)
    strewn = np.random.default_rng(0).random(places) * (np.arange(places) > 0)
    spread = (np.arange(places) + strewn) * (scene.duration / places)
    return np.union1d(first * GROWTH ** np.arange(count), spread)


def decidable(scene: Scene) -> bool:
    """Whether the energy excludes that contacts open, or every oscillation is looked at."""
    return not may_open(scene) or _resolved(scene) or _between(scene)[1]


def evaluations(scene: Scene) -> int:
    """Return about how many these are."""
    return _between(scene)[0] + 24


def _between(scene: Scene) -> tuple[int, bool]:
    """Return how many evaluations there are all over the run, and whether they resolve every oscillation."""
    grains, needed = scene.chain.grains, RESOLVED * scene.duration * fastest(scene) + 1
    if may_open(scene) and needed <= min(MOST_TIMES, MOST_VALUES / grains):
        return max(EVENLY, int(needed) + 1), True
    return min(max(EVENLY, SMALL // grains), max(EVENLY, int(needed))), False


def dense(scene: Scene) -> bool:
    """Whether samples resolve the fastest oscillation, so that no other evaluations are needed."""
    if may_open(scene):
        return _resolved(scene)
    return bool(scene.duration * fastest(scene) < scene.samples - 1)


def _resolved(scene: Scene) -> bool:
    """Whether samples are close enough to see every opening."""
    return bool(RESOLVED * scene.duration * fastest(scene) <= scene.samples - 1)
