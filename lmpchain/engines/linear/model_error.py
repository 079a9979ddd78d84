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

from ...integrators.kernels import phase_error as kernel
from ...integrators.kernels.phase_error import accumulate, start
from ...scene.scene import Scene
from ...util.arrays import Array

EARLIEST, GROWTH, EVENLY = 0.5, 1.25, 64  # extra evaluation times: geometric (ratio 1.25) and 64 uniform
# analysis/calibration/linear_model_error.py measures the next ones
AT_ONCE = 0.25  # of (delta - 1) s: the distortion that no phase accounts for
DOUBT, WANDER = 3.0, 0.5  # true error over the estimate; over that of phases that add up as a random walk
COLUMN, STEEPEST = 0.272, 2.2  # the error over (delta - 1) v0* of a column struck at the top; up to this delta
UNLUCKY = 16.0  # the sampled peak may underestimate the true peak by 1 + 16 / samples

# of displacement and velocity
MOST = slice(kernel.MOST_DISPLACEMENT, kernel.MOST_VELOCITY + 1)
OFF = slice(kernel.OFF_DISPLACEMENT, kernel.OFF_VELOCITY + 1)
SAMPLED = slice(kernel.SAMPLED_DISPLACEMENT, kernel.SAMPLED_VELOCITY + 1)


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
        self._inverse_overlap = np.divide(1.0, contacts.overlap, out=np.zeros(chain.grains + 1), where=contacts.pressed)
        self._excess, self._wall = chain.exponent - 1, scene.excitation.wall
        self._fastest, self._most = chain.band_edge, bounds(scene)[1]
        self.state = start() if state is None else state.copy()

    def add(self, times: Array, recorded: NDArray[np.bool_], u: Array, v: Array, reach: NDArray[np.intp]) -> None:
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
        walls = np.zeros(times.size) if self._wall is None else self._wall.at(times)
        accumulate(
            times, recorded, u, v, walls, reach, self._inverse_overlap, self._stiffness, self._inverse_mass,
            self._excess / 4, self.state,
        )  # fmt: skip

    @property
    def error(self) -> float:
        """Estimated relative error, as defined for a trajectory; near 1 it says no more than that."""
        time, strain, v = (self.state[k] for k in (kernel.TIME, kernel.MOST_STRAIN, kernel.MOST_VELOCITY))
        acceleration, off = self.state[kernel.MOST_ACCELERATION], self.state[OFF]
        if v == 0:
            return 0.0
        by_phase = float((off / self._sampled).max())
        at_once = AT_ONCE * self._excess * strain * min(1.0, acceleration / v * time) * self._missed
        return saturated(max(by_phase, at_once))

    @property
    def at_most(self) -> float:
        """Upper bound on that error: reflections or a drive may shift the phase either way.

        Measured on 400 random scenes with up to 500 periods, of every excitation.
        """
        if self.remark:
            return 1.0
        steps = self.state[kernel.MOST_STRAIN] + np.sqrt(self._fastest * self.state[kernel.SQUARED_STRAIN])
        return min(self._most, max(DOUBT * self.error, float(WANDER * self._excess * steps * self._missed)))

    @property
    def _sampled(self) -> Array:
        """Largest displacement and velocity in samples, to which errors are relative."""
        return np.where(self.state[SAMPLED] > 0, self.state[SAMPLED], np.inf)

    @property
    def _missed(self) -> float:
        """How much larger the wave was between samples, if few of them fell where it was small."""
        return max(1.0, float((self.state[MOST] / self._sampled).max()))

    @property
    def remark(self) -> str:
        """Why the linear solution does not hold at all, if it does not."""
        opened = self.state[kernel.OPENED]
        return "" if np.isnan(opened) else f"not linear here: contact {opened:.0f} opens"


def saturated(error: float) -> float:
    """Two waves that have nothing to do with each other differ by about 1, not by more."""
    return error / (1 + error)


def strain_bound(scene: Scene) -> float:
    """Return a bound on the strain of every contact in the linear chain, from the energy that is put in."""
    if not scene.excitation.does_work:
        return scene.largest_strain
    contacts = scene.chain.contacts
    weakest = (np.sqrt(contacts.stiffness) * contacts.overlap)[contacts.pressed].min()
    return float(scene.excitation.energy_norm(scene.chain, scene.duration) / weakest)


def bounds(scene: Scene) -> tuple[float, float]:
    """Return a lower and an upper bound on the model error of Eq. (3), from the strike alone.

    The upper bound takes the largest strain for that of the whole time, as if the shift of phase grew without end: far
    too much for a wave that spreads out, about right for a few grains that are hit hard. It is 1 where contacts may
    open. On 547 random scenes `PhaseError` gives 1.3 times the lower bound or more. After a strike on the top of a
    column the strain falls faster than 1/h, and `stability.linear_theory.linear_law` is right within a factor of
    `DOUBT`.
    """
    excess, strain, most = scene.chain.exponent - 1, strain_bound(scene), 1.0
    if strain < 1:
        periods = scene.chain.band_edge * scene.duration
        most = min(1.0, AT_ONCE * excess * strain * (1 + periods) * (1 + UNLUCKY / scene.samples))
        if _struck_column(scene):
            most = min(most, DOUBT * COLUMN * excess * scene.strike_number)
    return saturated(AT_ONCE * excess * scene.strike_number), most


def _struck_column(scene: Scene) -> bool:
    """Whether it is a uniform column under gravity alone, struck at its top, for at most ten passages."""
    chain, strike = scene.chain, scene.excitation
    if chain.grains == 1 or not (strike.strikes_top and chain.gravity > 0 and chain.top_load == 0):
        return False
    if chain.top != "free" or chain.exponent > STEEPEST or np.ptp(chain.masses) or np.ptp(chain.contact_constants):
        return False
    passage = np.sqrt(chain.masses[0] / chain.linear_stiffness).sum()
    return bool(scene.duration <= 10 * passage)


def evaluation_times(scene: Scene) -> Array:
    """Return times, s, at which a linear solution is evaluated besides its samples."""
    first = EARLIEST / scene.chain.band_edge
    count = max(0, int(np.log(scene.duration / first) / np.log(GROWTH)) + 1)
    return np.union1d(first * GROWTH ** np.arange(count), np.linspace(0, scene.duration, EVENLY, endpoint=False))


def dense(scene: Scene) -> bool:
    """Whether samples resolve the fastest oscillation, so that no other evaluations are needed."""
    return bool(scene.duration * scene.chain.band_edge < scene.samples - 1)
