"""Position shifts of two solitary waves in a collision, relative to undisturbed waves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.optimize import brentq

from ..chain.chain import Chain
from ..errors import InputError
from ..theory import collision as theory
from ..theory.soliton import Soliton
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import COLOURS, Axes, chart, finish
from ..util.tabular import Tabular
from . import crests
from .fit.column import is_uniform
from .fit.solitary import END_GRAINS, check_chain, exact_wave

__dir__ = listed(__name__)

APART = 1e-4  # Fraction of its height to which each wave has fallen in the middle between both.
ALONE = 8  # Number of grains that each wave passes alone, before and after.


@dataclass(frozen=True, eq=False, repr=False)
class Collision(Shown, Tabular):
    """Two solitary waves that have collided; the first is the upper one before the collision.

    Attributes
    ----------
    head_on : bool
        Whether the waves travel in opposite directions; else one wave overtakes the other.
    place : float
        Position at which the crest lines before the collision intersect, in grains.
    time : float
        Time at which these two lines intersect, s.
    way : (2,) array
        Direction of travel of each wave: +1 downward, -1 upward.
    speed, speed_after : (2,) arrays
        Speed of each wave before and after the collision, grains/s.
    velocity, velocity_after : (2,) arrays
        Largest grain velocity in each wave before and after the collision, m/s.
    shift : (2,) array
        Shift of each wave along its way, in grains: the distance at `time` from the crest line
        before the collision to the crest line after it.
    shift_error : (2,) array
        Error of the shift: scatter of the crests about both lines, and the uncertainty of both
        speeds in the extrapolation to `time`, for which their changes along the lines continue.
    exact_speed : (2,) array
        Speeds of exact solitary waves with the velocities before the collision, grains/s.
    toda, kdv : (2,) arrays
        Shifts predicted by `lmpchain.theory.collision` for the exact speeds, in grains; NaN in the
        sonic vacuum, and `kdv` is also NaN for head-on collisions.
    """

    _units: ClassVar[Mapping[str, str]] = {
        "way": "",
        "speed": "grains/s",
        "velocity": "m/s",
        "speed_after": "grains/s",
        "velocity_after": "m/s",
        "shift": "",
        "shift_error": "",
        "exact_speed": "grains/s",
        "toda": "",
        "kdv": "",
    }

    head_on: bool
    place: float
    time: float
    way: Array
    speed: Array
    velocity: Array
    speed_after: Array
    velocity_after: Array
    shift: Array
    shift_error: Array
    exact_speed: Array
    toda: Array
    kdv: Array
    _before: tuple[_CrestLine, _CrestLine]
    _after: tuple[_CrestLine, _CrestLine]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the distance of each wave ahead of its undisturbed position; return the axes."""
        ax = chart(ax, "time [s]", "grains ahead of where it would be")
        for k, colour in enumerate((COLOURS["blue"], COLOURS["vermilion"])):
            line = self._before[k]
            for piece in (line, self._after[k]):
                ahead = self.way[k] * (piece.grain - line.at(piece.time))
                ax.plot(piece.time, ahead, ".", ms=3, color=colour)
            label = f"wave {k + 1}: {self.shift[k]:.5g} ± {self.shift_error[k]:.1g} grains"
            ax.axhline(self.shift[k], color=colour, lw=1, label=label)
            if np.isfinite(self.toda[k]):
                law = f"wave {k + 1} in Toda's chain: {self.toda[k]:.5g}"
                ax.axhline(self.toda[k], color=colour, lw=1, ls="--", label=law)
        ax.axvline(self.time, color="0.6", lw=1)
        title = "head-on" if self.head_on else "overtaking"
        return finish(ax, title)


class _CrestLine(NamedTuple):
    """Crests of a wave while it travels alone, and the straight line through them."""

    grain: Array
    time: Array
    height: float
    speed: float
    origin: float
    middle: float
    off: float
    speed_off: float
    bend: float

    def error_at(self, time: float) -> float:
        """Return the error of the position of the line at a time, in grains.

        The speed is assumed to change outside the line as it changes between the halves of the
        line: the position of a wave that slows down steadily deviates with the square of the time.
        """
        away = abs(time - self.middle)
        bent = self.bend * max(1.0, away / float(np.ptp(self.time)))
        return self.off + (self.speed_off + bent) * away

    def at(self, time: Array | float) -> Array | float:
        """Return the position of the line at a time, in grains."""
        return self.origin + self.speed * (time - self.middle)


class _IncomingWave(NamedTuple):
    """A wave before the collision: position, counted from 0, direction, and exact solitary wave."""

    grain: float
    way: int
    exact: Soliton
    unit: float

    @property
    def speed(self) -> float:
        """Velocity along the chain, grains/s, positive downward."""
        return self.way * self.exact.speed / self.unit

    @property
    def reach(self) -> float:
        """Distance from the middle of the wave at which the wave has decayed, in grains."""
        top = float(self.exact.overlap(0.0))
        wave = self.exact
        return brentq(lambda x: float(wave.overlap(x)) / top - APART, 0.0, 2 * wave.reach)


def find(trajectory: Trajectory, start: float = 0.0) -> Collision:
    """Measure the shifts of two solitary waves that meet, head-on or overtaking.

    The two highest waves at `start` are measured, such as those of a `Profile` that is the sum of
    two exact waves (`theory.soliton`, `Soliton.on`). Crests within the tails of the other wave are
    ignored, and so is the first half of the crests after the collision. Under a load, a wave with
    the tail exp(-kappa n) needs about 24 / kappa^3 grains to separate from the radiation of the
    collision.

    Parameters
    ----------
    trajectory : Trajectory
        Run of a uniform chain without damping until the waves are apart again; all grains must be
        recorded.
    start : float
        Time at which both waves exist, s: 0, or a time after strikes at the ends have produced
        them.

    Returns
    -------
    Collision

    Raises
    ------
    InputError
        If the chain is not uniform, has gravity, damping or springs, or was not fully recorded. If
        the run does not start with two separate solitary waves that will meet, if `start` is not
        within the run, or if a wave passes fewer than 8 grains alone before or after the collision.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=120, diameter=1e-3, gravity=0.0, top_load=1.0)
    >>> wave = lmpchain.theory.soliton.solve(speed=1.2)
    >>> pair = wave.on(chain, 30) + wave.on(chain, 90, downward=False)
    >>> scene = lmpchain.Scene(
    ...     chain=chain, excitation=pair, duration=60 * chain.time_scale, samples=1201)
    >>> met = find(lmpchain.simulate(scene, engine="native"))
    >>> met.head_on, f"{met.shift[0]:.3f}, in Toda's chain {met.toda[0]:.3f}"
    (True, "0.303, in Toda's chain 0.455")
    """
    chain = trajectory.scene.chain
    check_chain(chain)
    if chain.damped:
        raise InputError.at(
            "damping", "must be none, because damping changes the speeds of the waves"
        )
    if not is_uniform(chain):
        raise InputError.at(
            "chain", "must be uniform, because a wave changes where the grains change"
        )
    recorded = trajectory.grains.size
    if recorded < chain.grains:
        raise InputError.at("grains", f"{recorded} of {chain.grains} were recorded: record all")
    time = trajectory.time
    velocity = np.asarray(trajectory.velocity)
    if not 0 <= start <= time[-1]:
        raise InputError.at("start", f"must be 0 to {time[-1]:.4g} s, the run (got {start})")
    first = int(np.searchsorted(time, start))
    start = float(time[first])
    waves = _two_waves(chain, velocity[first])
    gap = waves[1].grain - waves[0].grain
    closing = waves[0].speed - waves[1].speed
    if not closing * gap > 0:
        raise InputError.at("excitation", "the two highest waves move apart: they never meet")
    meeting = start + gap / closing
    apart = sum(wave.reach for wave in waves) / closing
    if meeting - apart <= start:
        raise InputError.at(
            "excitation", "the waves overlap at the start: place them further apart"
        )
    heights = [float(wave.exact.velocity(0.0)) for wave in waves]
    # Fit lines before and after the collision, in which a wave may lose height.
    least: dict[int, float] = {}
    for wave, height in zip(waves, heights, strict=True):
        least[wave.way] = min(least.get(wave.way, np.inf), 0.3 * _in_si(chain, wave, height))
    # Two waves in one direction share a threshold, which depends on the lower wave.
    passages = {way: crests.find(time, way * velocity, low) for way, low in least.items()}
    before = [
        _line(passages[wave.way], wave, chain, start, meeting - apart, (wave.grain, start))
        for wave in waves
    ]
    place = _crossing(*before)
    after = [
        _line(passages[wave.way], wave, chain, meeting + apart, float(time[-1]), place)
        for wave in waves
    ]
    return _compare(chain, waves, before, after, place)


def _two_waves(chain: Chain, velocity: Array) -> tuple[_IncomingWave, _IncomingWave]:
    """Return the two highest waves of a snapshot, from the top downward."""
    size = np.abs(velocity)
    tops = crests.local_maxima(size)
    tops = np.sort(tops[np.argsort(size[tops])[-2:]])
    if tops.size < 2 or size[tops].min() < 1e-3 * size.max():
        raise InputError.at("excitation", "must produce two solitary waves")
    waves = []
    for top in tops:
        # The logarithm of a wave is a parabola near the crest.
        low, high, next_one = np.log(np.maximum(size[top - 1 : top + 2], 1e-300))
        bend = low + next_one - 2 * high
        place = (low - next_one) / (2 * bend)
        height = float(np.exp(high - (low - next_one) ** 2 / (8 * bend)))
        exact, unit = exact_wave(chain, height)
        waves.append(_IncomingWave(top + float(place), int(np.sign(velocity[top])), exact, unit))
    return waves[0], waves[1]


def _in_si(chain: Chain, wave: _IncomingWave, velocity: float) -> float:
    """Convert a velocity of the exact wave to m/s."""
    return velocity * (chain.length_scale / wave.unit if wave.exact.loaded else 1.0)


def _line(
    passages: crests.Crests,
    wave: _IncomingWave,
    chain: Chain,
    begin: float,
    end: float,
    through: tuple[float, float],
) -> _CrestLine:
    """Fit the line of a wave between two times, close to the exact wave through a given point.

    After the collision, only the later half of the crests is used.
    """
    grain, time = through
    expected = grain + wave.speed * (passages.time - time)
    height = _in_si(chain, wave, float(wave.exact.velocity(0.0)))
    # The distance to the other wave is larger than the shift.
    near = np.abs(passages.grain - expected) < wave.reach
    near &= np.abs(passages.height / height - 1) < crests.NEAR
    near &= (passages.time > begin) & (passages.time < end)
    near &= (passages.grain >= END_GRAINS) & (passages.grain < chain.grains - END_GRAINS)
    if near.sum() < ALONE:
        when = "after" if begin > time else "before"
        raise InputError.at(
            "duration",
            f"each wave must pass {ALONE} grains alone {when} they meet (got {near.sum()}): "
            "start the waves further apart in a longer chain, and record longer",
        )
    x = passages.grain[near].astype(float)
    t = passages.time[near]
    order = np.argsort(t)
    # The radiation of the collision separates slowly from the wave.
    settled = order[order.size // 2 :] if begin > time else order
    x = x[settled]
    t = t[settled]
    half = x.size // 2
    slope = np.polyfit(x - x.mean(), t - t.mean(), 1)[0]
    pieces = [
        np.polyfit(x[s] - x.mean(), t[s] - t.mean(), 1)[0] for s in (slice(half), slice(half, None))
    ]
    speed = 1 / float(slope)
    noise = float(
        passages.time_error[near].max() + np.abs(t - t.mean() - slope * (x - x.mean())).max()
    )
    return _CrestLine(
        grain=x,
        time=t,
        height=float(passages.height[near].mean()),
        speed=speed,
        # The line of least squares passes through the mean of the crests.
        origin=float(x.mean()),
        middle=float(t.mean()),
        off=noise * abs(speed),
        speed_off=3 * noise / float(np.ptp(x)) * speed**2,
        bend=abs(float(pieces[0] - pieces[1])) * speed**2,
    )


def _crossing(first: _CrestLine, second: _CrestLine) -> tuple[float, float]:
    """Return the place, counted from 0, and the time at which two lines cross."""
    gap = float(second.at(first.middle)) - first.origin
    time = first.middle + gap / (first.speed - second.speed)
    return float(first.at(time)), time


def _compare(
    chain: Chain,
    waves: tuple[_IncomingWave, _IncomingWave],
    before: list[_CrestLine],
    after: list[_CrestLine],
    place: tuple[float, float],
) -> Collision:
    """Return the measured shifts together with the predictions of Toda and KdV theory."""
    time = place[1]
    way = np.array([wave.way for wave in waves], dtype=float)
    shift = [
        s * float(late.at(time) - early.at(time))
        for s, early, late in zip(way, before, after, strict=True)
    ]
    error = [sum(line.error_at(time) for line in pair) for pair in zip(before, after, strict=True)]
    exact = [exact_wave(chain, line.height) for line in before]
    speeds = [wave.speed for wave, _ in exact]
    head_on = waves[0].way != waves[1].way
    toda, kdv = _laws(speeds, head_on) if chain.compressed else np.full((2, 2), np.nan)
    return Collision(
        head_on=head_on,
        place=1 + place[0],
        time=time,
        way=way,
        speed=np.abs([line.speed for line in before]),
        velocity=np.array([line.height for line in before]),
        speed_after=np.abs([line.speed for line in after]),
        velocity_after=np.array([line.height for line in after]),
        shift=np.array(shift),
        shift_error=np.array(error),
        exact_speed=np.array([wave.speed / unit for wave, unit in exact]),
        toda=toda,
        kdv=kdv,
        _before=(before[0], before[1]),
        _after=(after[0], after[1]),
    )


def _laws(speeds: list[float], head_on: bool) -> Array:
    """Return the shifts of two waves in Toda and KdV theory, (2, 2); speeds are Mach numbers."""
    first, second = speeds
    pairs = [(first, second), (second, first)]
    toda = [theory.toda(*pair, head_on) for pair in pairs]
    return np.array([toda, [np.nan, np.nan] if head_on else [theory.kdv(*pair) for pair in pairs]])
