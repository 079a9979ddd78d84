"""Solitary waves behind a strike: speeds, heights, energies, and shares of the strike's energy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ..chain.chain import Chain
from ..errors import InputError
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import COLOURS, Axes, chart, finish
from ..util.tabular import Tabular
from . import crests
from .energy import shares
from .fit.column import is_uniform
from .fit.solitary import END_GRAINS, SOLITARY, check_chain, exact_wave, slope_error

__dir__ = listed(__name__)

FEWEST_SAMPLES = 4 * crests.HALF + 3  # Smallest number of samples that shows a crest.
UNCHANGED = 12  # Number of grains that a wave must have passed unchanged.


@dataclass(frozen=True, eq=False, repr=False)
class Train(Shown, Tabular):
    """Solitary waves after a strike, the leading one first, with the exact waves of equal height.

    Attributes
    ----------
    grain : (W,) array
        Positions of the centres of the waves at the end, in grains.
    speed : (W,) array
        Speeds, grains/s.
    speed_error : (W,) array
        Uncertainties of the speeds, grains/s: half the 95 % confidence interval, the effect of
        sampling, and the change along the way.
    velocity : (W,) array
        Largest velocities of a grain in each wave, m/s, averaged over the later half of the way.
    velocity_error : (W,) array
        Uncertainties of these velocities from the same three sources, m/s.
    energy : (W,) array
        Kinetic and potential energies above rest, from the trough ahead to the trough behind, J.
    energy_error : (W,) array
        Uncertainties of the energies, J: scatter and change over the later half of the way, the
        energy in the troughs, and the error of the trajectory.
    exact_speed, exact_energy : (W,) arrays
        Speeds, grains/s, and energies, J, of the exact solitary waves with these velocities
        (`theory.soliton`).
    total : float
        Energy that the strike gave to the chain, J.
    place : (N,) array
        Numbers of the grains.
    density : (N,) array
        Energies of the grains at the end, J.
    """

    _units: ClassVar[Mapping[str, str]] = {
        "grain": "",
        "speed": "grains/s",
        "speed_error": "grains/s",
        "velocity": "m/s",
        "velocity_error": "m/s",
        "energy": "J",
        "energy_error": "J",
        "exact_speed": "grains/s",
        "exact_energy": "J",
        "share": "",
        "share_error": "",
    }

    grain: Array
    speed: Array
    speed_error: Array
    velocity: Array
    velocity_error: Array
    energy: Array
    energy_error: Array
    exact_speed: Array
    exact_energy: Array
    total: float
    place: NDArray[np.intp]
    density: Array

    @property
    def share(self) -> Array:
        """Fraction of the strike's energy in each wave, (W,)."""
        return self.energy / self.total

    @property
    def share_error(self) -> Array:
        """Uncertainty of each fraction, (W,)."""
        return self.energy_error / self.total

    @property
    def all_share(self) -> tuple[float, float]:
        """Fraction of the strike's energy in all waves together, and its uncertainty."""
        return float(self.share.sum()), float(self.share_error.sum())

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the energy of each grain at the end, and mark each wave with its share."""
        ax = chart(ax, "grain, from the top", "energy of a grain (J)")
        ax.semilogy(self.place, np.maximum(self.density, 1e-12 * self.total), color="0.3", lw=1)
        for number, (grain, share) in enumerate(zip(self.grain, self.share, strict=True)):
            label = "solitary waves" if number == 0 else None
            height = float(np.interp(grain, self.place, self.density))
            ax.plot(grain, height, "v", color=COLOURS["vermilion"], ms=5, label=label)
            if number < 6:
                ax.text(
                    grain, 2 * height, f"{100 * share:.3g} %", rotation=90, ha="center", va="bottom"
                )
        # Room for these labels.
        ax.set_ylim(top=1e4 * self.density.max())
        whole, error = self.all_share
        count = self.grain.size
        waves = "1 solitary wave has" if count == 1 else f"{count} solitary waves have"
        title = f"{waves} {100 * whole:.6g} ± {100 * error:.1g} % of the energy"
        return finish(ax, title, loc="upper left")


class _FollowedWave(NamedTuple):
    """A solitary wave as in `Train`, with its width in grains and the time when tracking began."""

    grain: float
    speed: float
    speed_error: float
    velocity: float
    velocity_error: float
    exact_speed: float
    exact_energy: float
    width: float
    start: float


def find(trajectory: Trajectory, direction: Literal["down", "up"] = "down") -> Train:
    """Find the solitary waves behind a strike, and their share of its energy.

    A wave counts if it passes 12 or more grains with a constant height and with the speed of the
    exact solitary wave of this height, both within 2 %. Under a load such waves are faster than
    sound; a weak strike produces none, which raises an error.

    Parameters
    ----------
    trajectory : Trajectory
        Run of a chain without damping that is uniform except for a striker, until the first wave is
        near the end; all grains must be recorded.
    direction : "down" or "up"
        Direction in which the waves travel.

    Returns
    -------
    Train

    Raises
    ------
    InputError
        If the chain has gravity, damping or springs, was not fully recorded, or is not uniform
        where waves pass, or if no wave is solitary.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=60, diameter=1e-3, gravity=0.0)
    >>> strike = lmpchain.Impulse(velocity=0.1)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=1.5e-4, samples=901)
    >>> train = find(lmpchain.simulate(scene, engine="native"))
    >>> f"{train.share[0]:.5f}", bool(abs(train.speed[0] / train.exact_speed[0] - 1) < 1e-5)
    ('0.99366', True)
    """
    chain = trajectory.scene.chain
    _check(trajectory, direction)
    upward = direction == "up"
    velocity = np.asarray(trajectory.velocity)
    velocity = -velocity[:, ::-1] if upward else velocity
    last = _useful(velocity, direction)
    time = trajectory.time[:last]
    velocity = velocity[:last]
    energy = shares(trajectory)
    density = energy.of_grain[:last]
    unsure = energy.of_grain_error[:last]
    if upward:
        density = density[:, ::-1]
        unsure = unsure[:, ::-1]
    waves = _waves(chain, time, velocity, upward)
    if not waves:
        reason = "no wave keeps the height and the speed of a solitary wave"
        cure = "record longer, in a longer chain"
        if chain.compressed:
            reason += ", which is faster than sound under a load,"
            cure += ", or strike harder"
        raise InputError.at("duration", f"{reason} over {UNCHANGED} grains: {cure}")
    energies = [_energy(time, velocity, density, unsure, wave) for wave in waves]
    final = density[-1]
    place = np.arange(1, chain.grains + 1)
    grain = 1 + np.array([wave.grain for wave in waves])
    energy_of_wave, energy_error = np.array(energies).T
    return Train(
        grain=chain.grains + 1 - grain if upward else grain,
        speed=np.array([wave.speed for wave in waves]),
        speed_error=np.array([wave.speed_error for wave in waves]),
        velocity=np.array([wave.velocity for wave in waves]),
        velocity_error=np.array([wave.velocity_error for wave in waves]),
        energy=energy_of_wave,
        energy_error=energy_error,
        exact_speed=np.array([wave.exact_speed for wave in waves]),
        exact_energy=np.array([wave.exact_energy for wave in waves]),
        total=float(final.sum()),
        place=place,
        density=final[::-1] if upward else final,
    )


def _check(trajectory: Trajectory, direction: str) -> None:
    """Raise `InputError` unless the run can show solitary waves."""
    chain = trajectory.scene.chain
    if direction not in ("down", "up"):
        raise InputError.at("direction", 'must be "down" or "up"')
    check_chain(chain)
    if chain.damped:
        raise InputError.at("damping", "must be none, because a damped wave has no constant energy")
    recorded = trajectory.grains.size
    if recorded < chain.grains:
        raise InputError.at("grains", f"{recorded} of {chain.grains} were recorded: record all")
    least = UNCHANGED + 2 * END_GRAINS
    if chain.grains < least or len(trajectory.time) < FEWEST_SAMPLES:
        raise InputError.at(
            "chain",
            f"must have {least} grains or more, and the run {FEWEST_SAMPLES} samples or more",
        )


def _useful(velocity: Array, direction: str) -> int:
    """Return the number of samples until the first wave is near the end.

    Raises
    ------
    InputError
        If these samples are too few to show a crest.
    """
    near = velocity[:, -END_GRAINS:].max(1)
    arrived = np.flatnonzero(near > 1e-3 * velocity[len(velocity) // 2 :].max(initial=0.0))
    last = int(arrived[0]) if arrived.size else len(velocity)
    if last < FEWEST_SAMPLES:
        reason = f"motion reaches the end to which waves go {direction} after {last} samples"
        cure = "choose the other direction, or strike further from that end"
        raise InputError.at("direction", f"{reason}: {cure}")
    return last


def _waves(chain: Chain, time: Array, velocity: Array, upward: bool) -> list[_FollowedWave]:
    """Return the solitary waves, the leading one first."""
    final = velocity[-1]
    tops = crests.local_maxima(final)
    # Weaker waves cannot be distinguished from rounding errors and from the error of the run.
    tops = tops[final[tops] > 1e-6 * final.max(initial=0.0)]
    if not tops.size:
        return []
    found = crests.find(time, velocity, float(final[tops].min()) / 2)
    waves = []
    for top in tops[::-1]:
        wave = _wave(chain, found, int(top), float(time[-1]), float(final[top]), upward)
        if wave:
            waves.append(wave)
    return waves


def _wave(
    chain: Chain, found: crests.Crests, top: int, end: float, height: float, upward: bool
) -> _FollowedWave | None:
    """Return the wave whose crest is at a grain at the end, or None if it is not solitary."""
    piece = chain.part(*sorted((_number(chain, top - 1, upward), _number(chain, top + 1, upward))))
    if not is_uniform(piece):
        return None
    try:
        wave, unit = exact_wave(piece, height)
    except InputError:
        # The wave is slower than any solitary wave.
        return None
    # The final crest passed a grain or two before the end.
    pace = unit / wave.speed
    begin = found.first(top - 2, end - 3.5 * pace, end)
    if begin is None:
        return None
    chosen = found.follow(begin, pace, -1)
    if chosen.size < UNCHANGED:
        return None
    later = chosen[: max(UNCHANGED, chosen.size // 2)]
    grains = found.grain[later]
    ends = _number(chain, int(grains.min()), upward), _number(chain, int(grains.max()), upward)
    if not is_uniform(chain.part(*sorted(ends))):
        return None
    velocity = float(found.height[later].mean())
    wave, unit = exact_wave(piece, velocity)
    speed, error = _line(grains.astype(float), found.time[later], found.time_error[later].max())
    exact_speed = wave.speed / unit
    change = float(np.ptp(found.height[later])) / velocity
    if change > SOLITARY or abs(speed / exact_speed - 1) > SOLITARY:
        return None
    mass = float(piece.masses[0])
    # In a sonic vacuum the unit of velocity is 1 m/s.
    scale = mass * (piece.length_scale / unit) ** 2 if wave.loaded else mass
    return _FollowedWave(
        grain=float(grains[0] + speed * (end - found.time[later[0]])),
        speed=speed,
        speed_error=error,
        velocity=velocity,
        velocity_error=_spread(found.height[later]) + float(found.height_error[later].max()),
        exact_speed=exact_speed,
        exact_energy=scale * wave.energy,
        width=wave.width,
        start=float(found.time[later[-1]]),
    )


def _number(chain: Chain, column: int, upward: bool) -> int:
    """Return the number of the grain in a column; columns are mirrored for upward waves."""
    return chain.grains - column if upward else 1 + column


def _line(grain: Array, time: Array, off: float) -> tuple[float, float]:
    """Return the speed along a line, grains/s, and its error.

    Errors up to e of the times change the slope by up to 3 e divided by the length of the line.
    """
    half = len(grain) // 2
    line = stats.linregress(grain, time)
    halves = [stats.linregress(grain[s], time[s]).slope for s in (slice(half), slice(half, None))]
    scatter = slope_error(grain, time, line.slope)
    error = stats.t.ppf(0.975, len(grain) - 2) * scatter + abs(halves[0] - halves[1])
    error += 3 * off / np.ptp(grain)
    return float(1 / line.slope), float(error / line.slope**2)


def _spread(values: Array) -> float:
    """Return half the confidence interval of a mean, and its change between the two halves."""
    half = len(values) // 2
    interval = stats.t.ppf(0.975, len(values) - 1) * stats.sem(values)
    return float(interval + abs(values[:half].mean() - values[half:].mean()))


def _energy(
    time: Array, velocity: Array, density: Array, unsure: Array, wave: _FollowedWave
) -> tuple[float, float]:
    """Return the energy of a wave between its troughs, J, and its error."""
    samples = np.flatnonzero(time >= wave.start)
    samples = samples[:: max(1, samples.size // 64)]
    middle = np.rint(wave.grain - wave.speed * (time[-1] - time[samples])).astype(int)
    energies = []
    left = []
    off = []
    for k, centre in zip(samples, middle, strict=True):
        ahead = _trough(density[k, centre:])
        behind = _trough(density[k, centre::-1])
        inside = slice(centre - behind, centre + ahead + 1)
        ends = density[k, [centre - behind, centre + ahead]]
        energies.append(density[k, inside].sum() - ends.sum() / 2)
        left.append(ends.sum() * wave.width / 2)
        off.append(unsure[k, inside].sum())
    error = _spread(np.array(energies)) + float(np.mean(left)) + float(np.mean(off))
    return float(np.mean(energies)), error


def _trough(density: Array) -> int:
    """Return the distance from the middle of a wave to the first energy minimum, in grains."""
    # The energy is flat next to the middle of a wave between two grains.
    rises = np.flatnonzero(density[2:] >= density[1:-1])
    return 1 + int(rises[0]) if rises.size else density.size - 1
