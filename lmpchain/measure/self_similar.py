"""Shocks and rarefactions over x / t, on which the long waves of a step depend at all times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish, prefixed
from ..util.tabular import Tabular
from .shock import EDGE_COLOURS, Shock, find

__dir__ = listed(__name__)

# Moments at which the profile is compared, relative to the age of the wave at the end.
AGES = (0.4, 0.6, 0.8, 1.0)
PROFILE_POINTS = 400
BEYOND = 1.15  # Multiple of the speed of the leading edge up to which the profile is drawn.
NEIGHBOURHOOD = 0.03  # Fraction of the leading speed.


@dataclass(frozen=True, eq=False, repr=False)
class SelfSimilar(Shown, Tabular):
    """The overlaps of a shock or a rarefaction as a function of distance divided by time.

    Attributes
    ----------
    shock : Shock
        The wave with its edges and plateaus.
    speed : (P,) array
        Distance from the origin of the wave divided by the age of the wave, grains/s.
    moment : (4,) array
        Times of the profiles, s.
    overlap : (4, P) array
        Overlaps at these times, m.
    limit : (P,) array
        Overlaps in the simple wave, m, which an old rarefaction approaches; NaN for a shock.
    error : (P,) array
        Estimated distance of the last profile from its limit, m: the largest change since the first
        profile at nearby speeds. Oscillations of a dispersive shock keep their length in grains and
        have no limit, so that the error is their height.
    """

    _units: ClassVar[Mapping[str, str]] = {"speed": "grains/s", "limit": "m", "error": "m"}

    shock: Shock
    speed: Array
    moment: Array
    overlap: Array
    limit: Array
    error: Array

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the profiles at all moments, the limit and the edges; return the axes."""
        ax = chart(ax, "distance over time (grains/s)", "overlap [m]")
        shades = np.linspace(0.75, 0.0, len(self.moment))
        for moment, overlap, shade in zip(self.moment, self.overlap, shades, strict=True):
            label = f"at {prefixed(moment, 's', 3)}"
            ax.plot(self.speed, overlap, color=str(shade), lw=1, label=label)
        if np.isfinite(self.limit).any():
            ax.plot(self.speed, self.limit, "--", color="#009E73", label="simple wave")
        for name in ("leading", "trailing"):
            speed = getattr(self.shock, name).speed
            if np.isfinite(speed):
                label = f"{name} edge, {speed:.5g} grains/s"
                ax.axvline(speed, color=EDGE_COLOURS[name], lw=1.2, label=label)
        title = f"{self.shock.kind} over distance and time"
        return finish(ax, title, below=0.18, ncols=2)


def view(trajectory: Trajectory, direction: Literal["down", "up"] = "down") -> SelfSimilar:
    """Return the self-similar view of the shock or rarefaction of a piston or a step.

    Parameters
    ----------
    trajectory, direction
        See `shock.find`.

    Returns
    -------
    SelfSimilar

    Raises
    ------
    InputError
        For the reasons given in `shock.find`.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=300, diameter=1e-3, gravity=0.0, top_load=1.0, top="free")
    >>> less = -0.5 * chain.equilibrium_overlap[0] / 1e-3
    >>> step = lmpchain.Riemann(velocity=(0, 0), strain=(less, 0), grain=150)
    >>> duration = 120 * chain.time_scale
    >>> scene = lmpchain.Scene(chain=chain, excitation=step, duration=duration, samples=401)
    >>> seen = view(lmpchain.simulate(scene, engine="native"))
    >>> off = abs(seen.overlap[-1] - seen.limit)
    >>> seen.shock.kind, bool((off <= seen.error).mean() > 0.95)
    ('rarefaction', True)
    """
    wave = find(trajectory, direction)
    moments = wave.start + np.array(AGES) * (wave.time - wave.start)
    rows = np.abs(wave.moment[:, None] - moments).argmin(0)
    speed = np.linspace(0.0, BEYOND * wave.leading.speed, PROFILE_POINTS)
    profiles = np.array([_profile(wave, row, speed) for row in rows])
    limit = np.full(PROFILE_POINTS, np.nan)
    if wave.kind == "rarefaction":
        limit = _simple_wave(wave, trajectory.scene.chain.law.power_of("a shock"), speed)
    change = np.abs(profiles[-1] - profiles[0])
    near = max(1, int(NEIGHBOURHOOD * PROFILE_POINTS / BEYOND))
    largest = np.array(
        [change[max(0, n - near) : n + near + 1].max() for n in range(PROFILE_POINTS)]
    )
    return SelfSimilar(wave, speed, wave.moment[rows], profiles, limit, largest)


def _profile(wave: Shock, row: int, speed: Array) -> Array:
    """Return the overlaps at a time as a function of distance divided by time, (P,) m."""
    way = np.abs(wave.contact - wave.source)
    behind = wave.contact < wave.source if wave.downward else wave.contact > wave.source
    order = np.argsort(np.where(behind, -way, way))
    distance = np.where(behind, -way, way)[order]
    age = wave.moment[row] - wave.start
    return np.asarray(np.interp(speed, distance / age, wave.overlap_then[row][order]))


def _simple_wave(wave: Shock, exponent: float, speed: Array) -> Array:
    """Return the overlaps of a centred simple wave, each moving at its sound speed."""
    ahead = wave.ahead.overlap
    sound = wave.predictions["continuum"].leading
    fan = ahead * (speed / sound) ** (2 / (exponent - 1))
    return np.asarray(np.clip(fan, wave.behind.overlap, ahead))
