"""Lyapunov spectrum and alignment indices (GALI) of a chain, from the tangent map of its motion.

Small deviations of the state are advanced by the exact derivative of each step and are repeatedly
orthonormalised; see G. Benettin, L. Galgani, A. Giorgilli and J.-M. Strelcyn, Meccanica 15, 9 and
21 (1980). The mean growth rates of their lengths are the Lyapunov exponents. The product of the
triangular matrices R of all orthonormalisations gives the lengths and volumes that the deviations
would have without them. The generalised alignment index of k deviations is the volume spanned by k
unit vectors along them; see C. Skokos, T. Bountis and C. Antonopoulos, Physica D 231, 30 (2007).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..errors import InputError, RunFailed
from ..scene.scene import Scene, check_scene
from ..simulation.batch_means import BATCHING, estimate
from ..util.arrays import Array, whole_numbers
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish
from ..util.tabular import NamedColumn, Tabular
from .floquet import in_one_thread
from .flow import Flow

REACH = 0.1  # Step times the highest frequency, rad.
TURN = 128  # Largest number of steps between two orthonormalisations.
STEP_LIMIT = 20_000_000
# Numbers of time intervals: while the deviations align, and in total.
SETTLING = 64
STRETCHES = SETTLING + BATCHING.stretches
SMALLEST_INDEX = 1e-300


@dataclass(frozen=True, eq=False, repr=False)
class Chaos(Shown, Tabular):
    """Lyapunov exponents and alignment indices of one trajectory.

    Attributes
    ----------
    exponent : (C,) array
        Lyapunov exponents over the later four fifths of the time, the largest first, 1/s.
    half_width : (C,) array
        Half widths of the 95 % intervals of the exponents, 1/s, from the correlated growth in 256
        intervals of time. They include a growth in proportion to time, as in regular motion,
        because a finite run does not distinguish it from an exponent.
    time : (320,) array
        Times, s.
    running : (320, C) array
        Exponents over the time from 0, 1/s.
    log_gali : (320, C) array
        Natural logarithms of the alignment indices of the first 1, 2, ..., C deviations. In chaotic
        motion the logarithms decrease in proportion to time. In regular motion they stay constant
        up to the dimension of its torus; beyond it the indices decrease as a power of time.
    energy_drift : float
        Largest change of the energy relative to its value at t = 0.
    """

    _units: ClassVar[Mapping[str, str]] = {"exponent": "1/s", "half_width": "1/s"}

    exponent: Array
    half_width: Array
    time: Array
    running: Array
    log_gali: Array
    energy_drift: float

    @property
    def chaotic(self) -> bool:
        """Whether the interval of the largest exponent is above 0."""
        return bool(self.exponent[0] > self.half_width[0])

    def gali(self, count: int) -> Array:
        """Return the alignment index of the first `count` deviations, (320,); 0 if below 1e-300."""
        number = int(whole_numbers(count, "count"))
        if not 2 <= number <= self.exponent.size:
            raise InputError.at("count", f"must be 2 to {self.exponent.size} (got {count})")
        logarithm = self.log_gali[:, number - 1]
        return np.where(logarithm > math.log(SMALLEST_INDEX), np.exp(logarithm), 0.0)

    def _columns(self) -> Iterator[NamedColumn]:
        yield NamedColumn("time", "s", self.time)
        for number in range(self.exponent.size):
            yield NamedColumn(f"exponent_{number + 1}", "1/s", self.running[:, number])
        for number in range(1, self.exponent.size):
            yield NamedColumn(f"log_gali_{number + 1}", "", self.log_gali[:, number])

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the exponents over the time from 0, with the final intervals; return the axes."""
        ax = chart(ax, "time [s]", "Lyapunov exponents (1/s)")
        for number, exponent in enumerate(self.exponent):
            (line,) = ax.plot(self.time, self.running[:, number], lw=1)
            half = self.half_width[number]
            ax.errorbar(
                self.time[-1], exponent, half, color=line.get_color(), fmt=".", capsize=2, ms=3
            )
        ax.axhline(0.0, color="k", lw=0.5)
        # Deviations align with their directions in the first part of the time.
        later = self.running[SETTLING:]
        ax.set_ylim(1.3 * float(later.min()), 1.3 * float(later.max()))
        title = f"largest {self.exponent[0]:.4g} ± {self.half_width[0]:.1g} per second"
        return finish(ax, title)

    def plot_gali(self, ax: Axes | None = None) -> Axes:
        """Draw the alignment indices over time on logarithmic axes; return the axes."""
        ax = chart(ax, "time [s]", "generalised alignment index", "xy")
        for count in range(2, self.exponent.size + 1):
            index = self.gali(count)
            positive = index > 0
            ax.plot(self.time[positive], index[positive], lw=1, label=f"{count} deviations")
        return finish(ax, below=0.18, ncols=3)


@in_one_thread
def chaos_of(scene: Scene, exponents: int | None = None, seed: int = 0) -> Chaos:
    """Compute the Lyapunov spectrum and the alignment indices of the motion of a scene.

    Parameters
    ----------
    scene : Scene
        Scene without damping or a drive, whose chain is held together by walls, gravity or a load.
        The duration should be many times 1 / exponent.
    exponents : int, optional
        Number of exponents, 2 or more; by default all, two for each grain that moves.
    seed : int
        Seed of the random directions of the deviations at t = 0.

    Returns
    -------
    Chaos

    Raises
    ------
    InputError
        If the scene is damped, driven or at rest, has a force from the ground, flies apart, or
        needs more than 2e7 steps.
    RunFailed
        If the motion or a deviation becomes infinite.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> chain = Chain(grains=4, diameter=5e-3, gravity=0.0, top="wall", bottom="wall")
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=0.1), duration=0.1)
    >>> found = chaos_of(scene)
    >>> found.chaotic, bool(abs(found.exponent.sum()) < 1e-9 * found.exponent[0])
    (True, True)
    """
    check_scene(scene)
    if scene.excitation.does_work:
        raise InputError.at("excitation", "must give the motion at t = 0 and not act afterwards")
    flow = Flow(scene.chain, scene.fastest_motion)
    size = 2 * flow.size
    count = size if exponents is None else int(whole_numbers(exponents, "exponents"))
    if not 2 <= count <= size:
        raise InputError.at("exponents", f"must be 2 to {size} (got {exponents})")
    stretch = scene.duration / STRETCHES
    steps = max(1, math.ceil(stretch * scene.fastest_motion / REACH))
    if steps * STRETCHES > STEP_LIMIT:
        raise InputError.at("duration", f"needs {steps * STRETCHES:.2g} steps: shorten it")
    turns = math.ceil(steps / TURN)
    mesh = np.full(math.ceil(steps / turns), 1 / math.ceil(steps / turns))
    state = flow.canonical(*scene.initial())
    begin, _ = flow.energy(state)
    if not begin > 0:
        raise InputError.at("excitation", "does not move the chain: strike or displace a grain")
    random = np.random.default_rng(seed).standard_normal((size, count))
    deviation = np.linalg.qr(random)[0]
    # The triangular matrix from t = 0 has normalised columns; the logarithms of their lengths are
    # stored separately.
    total = np.eye(count)
    volume = np.zeros(count)
    length = np.zeros(count)
    grown = np.zeros((STRETCHES, count))
    log_gali = np.zeros((STRETCHES, count))
    drift = 0.0
    for number in range(STRETCHES):
        for _ in range(turns):
            passage = flow.run(state, stretch / turns, mesh, deviation.reshape(2, flow.size, count))
            state = passage.end
            if not np.isfinite(passage.deviation).all():
                raise RunFailed("the motion or its deviations are no longer finite")
            deviation, triangle = np.linalg.qr(passage.deviation.reshape(size, count))
            added = np.log(np.abs(np.diag(triangle)))
            grown[number] += added
            volume += added
            total = triangle @ total
            longer = np.linalg.norm(total, axis=0)
            total /= longer
            length += np.log(longer)
        drift = max(drift, abs(flow.energy(state)[0] / begin - 1))
        log_gali[number] = np.cumsum(volume) - np.cumsum(length)
    time: Array = stretch * np.arange(1.0, STRETCHES + 1)
    rates = grown[SETTLING:] / stretch
    exponent, half_width = _intervals(rates, float(time[SETTLING - 1]), float(time[-1]))
    return Chaos(
        exponent=exponent,
        half_width=half_width,
        time=time,
        running=np.cumsum(grown, axis=0) / time[:, None],
        log_gali=log_gali,
        energy_drift=drift,
    )


def _intervals(rates: Array, begin: float, end: float) -> tuple[Array, Array]:
    """Return the means of rates (S, C), 1/s, and the half widths of their confidence intervals."""
    # Deviations of regular motion grow in proportion to time.
    resolved = math.log(end / begin) / (end - begin)
    found = [estimate(column[None]) for column in rates.T]
    mean = np.array([each.mean for each in found])
    return mean, np.array([each.half_width for each in found]) + resolved
