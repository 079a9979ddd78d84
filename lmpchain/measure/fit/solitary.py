"""Fit of a solitary wave: speed, amplitude and width compared with the exact wave."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import stats

from ...chain.chain import Chain
from ...errors import InputError
from ...theory.soliton import Soliton, coste_speed, nesterenko_speed, solve, struck
from ...trajectory.trajectory import Trajectory
from ...util.arrays import Array
from ...util.plotting import Axes, chart, finish
from ...util.tabular import Tabular
from ..front import FEWEST, track
from .column import is_uniform
from .table import Fitted, FittedNumber

END_GRAINS = 5  # Number of grains at an end where a wave meets its own reflection.
# Largest relative scatter of the height, and errors of speed and width, of a solitary wave.
SOLITARY = 0.02  # See analysis/calibration/fit_thresholds.py.


@dataclass(frozen=True, eq=False, repr=False)
class SolitonFit(Fitted, Tabular):
    """A wave of constant height, compared with the exact solitary wave of that height.

    Attributes
    ----------
    grain : (P,) array
        Numbers of the fitted grains.
    time : (P,) array
        Times of the largest velocity of each grain, s.
    velocity : (P,) array
        Magnitudes of these velocities, m/s.
    amplitude : float
        Mean of these velocities, m/s.
    speed : float
        Wave speed, grains/s.
    width : float
        Full width at half maximum of the velocity, in grains.
    error : (3,) array
        Errors of amplitude, speed and width: half the 95 % interval, plus the effect of sampling.
    wave : Soliton
        Exact solitary wave of this amplitude.
    expected : (3,) array
        Amplitude, speed and width of the exact wave, in the same units.
    formula : float
        Speed of this wave by the long-wave formula of Coste under a load, or of Nesterenko in a
        sonic vacuum, grains/s.
    """

    _units: ClassVar[dict[str, str]] = {"grain": "", "time": "s", "velocity": "m/s"}

    grain: np.ndarray
    time: Array
    velocity: Array
    amplitude: float
    speed: float
    width: float
    error: Array
    wave: Soliton
    expected: Array
    formula: float

    def rows(self) -> Iterator[FittedNumber]:
        """Yield the height, speed and width, and the speed by the long-wave formula."""
        _, speed, width = self.expected.tolist()
        errors = self.error.tolist()
        # The exact wave has the measured height by definition.
        yield FittedNumber("soliton", "largest velocity", self.amplitude, errors[0], unit="m/s")
        yield FittedNumber("soliton", "speed", self.speed, errors[1], speed, "grains/s")
        yield FittedNumber("soliton", "width", self.width, errors[2], width, "grains")
        formula = "speed by long-wave formula"
        yield FittedNumber("soliton", formula, self.formula, expected=speed, unit="grains/s")

    def notes(self) -> Iterator[str]:
        """Yield the range of fitted grains."""
        yield (
            f"grains {self.grain.min()} to {self.grain.max()}; grains within {END_GRAINS} of an "
            "end, where the wave meets its reflection, are left out"
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the relative deviations of peak velocity and local speed from the exact wave."""
        ax = chart(ax, "grain, from the top", "|relative difference|")
        local = np.abs(1 / np.gradient(self.time, self.grain.astype(float)))
        height = np.abs(self.velocity / self.amplitude - 1)
        speed = np.abs(local / self.expected[1] - 1)
        formula = abs(self.formula / self.expected[1] - 1)
        author = "Coste" if self.wave.loaded else "Nesterenko"
        ax.plot(self.grain, height, ".", label="largest velocity, over its mean")
        ax.plot(self.grain, speed, ".", label="local speed, over that of the solitary wave")
        ax.axhline(formula, color="0.4", lw=1, ls="--", label=f"speed by {author}'s formula")
        ax.set_yscale("log")
        return finish(ax)


def fit_soliton(
    trajectory: Trajectory, first: int | None = None, last: int | None = None
) -> SolitonFit:
    """Identify a solitary wave by its speed and width, which its height determines.

    Parameters
    ----------
    trajectory : Trajectory
        Run of any engine that solves Eq. (1).
    first, last : int, optional
        First and last grain of the fit; by default the later half of the grains that the wave
        passes, without the 5 grains at either end, where a wave meets its reflection.

    Returns
    -------
    SolitonFit

    Raises
    ------
    InputError
        If the chain is under gravity or not uniform there, or the wave is not solitary.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=40, diameter=1e-3, gravity=0.0)
    >>> strike = lmpchain.Impulse(velocity=0.1)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=1e-4, samples=601)
    >>> fit = fit_soliton(lmpchain.simulate(scene, engine="native"))
    >>> f"{fit.amplitude:.5f} m/s, {fit.speed / fit.expected[1] - 1:.0e}, {fit.width:.3f} grains"
    '0.06816 m/s, -5e-08, 1.579 grains'
    """
    chain = trajectory.scene.chain
    check_chain(chain)
    front = track(trajectory, "velocity")
    if first is None and last is None:
        front = front.between(1 + END_GRAINS, chain.grains - END_GRAINS)
        later = front.grain[np.argsort(front.time)[front.grain.size // 2 :]]
        first = int(later.min(initial=chain.grains))
        last = int(later.max(initial=1))
    front = front.between(first or 1, last or chain.grains)
    # A striker, or a different grain on the way, may be excluded.
    chain = _uniform_piece(chain, front.grain)
    # The recording may end within the wave.
    complete = np.isfinite(front.width) & np.isfinite(front.width_error)
    if complete.sum() < FEWEST:
        need = f"must pass {FEWEST} or more recorded grains completely (got {complete.sum()})"
        raise InputError.at("front", f"{need}: record for longer, or more grains")
    line = stats.linregress(front.grain, front.time)
    # Compression moves grains in the direction of the wave.
    if (front.amplitude * line.slope <= 0).any():
        raise InputError.at(
            "front", "grains move against the wave: this is not a compressive solitary wave"
        )
    amplitude = float(np.abs(front.amplitude).mean())
    scatter = float(np.ptp(np.abs(front.amplitude))) / amplitude
    if scatter > SOLITARY:
        grains = f"from grain {front.grain[0]} to {front.grain[-1]}"
        raise InputError.at(
            "front", f"its height changes by {scatter:.1%} {grains}: this is not a solitary wave"
        )
    wave, time = exact_wave(chain, amplitude)
    speed = float(1 / np.abs(line.slope))
    width = float(front.width[complete].mean() * speed)
    expected = np.array([amplitude, wave.speed / time, wave.width])
    ratios = np.array([speed, width]) / expected[1:]
    if np.abs(ratios - 1).max() > SOLITARY:
        raise InputError.at(
            "front",
            f"has {ratios[0]:.3g} times the speed and {ratios[1]:.3g} times the width of a "
            "solitary wave",
        )
    if wave.loaded:
        formula = coste_speed((1 + wave.overlap(0.0)) ** wave.delta, wave.delta)
    else:
        formula = nesterenko_speed(amplitude, wave.delta)
    quantile = stats.t.ppf(0.975, complete.sum() - 2)
    # If each time has the error e, the slope over the length L has the error 3 e / L.
    sampling = np.array(
        [
            front.amplitude_error.max(),
            3 * front.time_error.max() / np.ptp(front.grain) * speed**2,
            front.width_error[complete].max() * speed,
        ]
    )
    deviation = np.array(
        [
            stats.sem(front.amplitude),
            slope_error(front.grain, front.time, line.slope) * speed**2,
            stats.sem(front.width[complete]) * speed,
        ]
    )
    return SolitonFit(
        grain=front.grain,
        time=front.time,
        velocity=np.abs(front.amplitude),
        amplitude=amplitude,
        speed=speed,
        width=width,
        error=quantile * deviation + sampling,
        wave=wave,
        expected=expected,
        formula=float(formula) / time,
    )


def slope_error(x: Array, y: Array, slope: float) -> float:
    """Return the standard error of the slope of a line of least squares."""
    # `linregress` computes this error from 1 - r^2, which rounding destroys.
    distance = x - x.mean()
    residual = y - y.mean() - slope * distance
    return float(np.sqrt(residual @ residual / (residual.size - 2) / (distance @ distance)))


def check_chain(chain: Chain) -> None:
    """Raise `InputError` unless solitary waves travel unchanged in this chain."""
    chain.refuse_ground("a solitary wave")
    if chain.gravity > 0:
        raise InputError.at(
            "gravity", "must be 0, because contacts that stiffen with depth change a wave"
        )
    if chain.law.power_of("a solitary wave") == 1:
        raise InputError.at(
            "exponent", "must be above 1, because linear springs have no solitary waves"
        )
    if chain.grains == 1:
        raise InputError.at("grains", "must be two or more: a single grain has no wave")


def _uniform_piece(chain: Chain, grains: np.ndarray) -> Chain:
    """Return the part of the chain with these grains; raise `InputError` if it is not uniform."""
    # Too few grains are rejected with the rest of the front.
    piece = chain.part(int(grains[0]), int(grains[-1])) if grains.size > 1 else chain
    if not is_uniform(piece):
        raise InputError.at("chain", "must be uniform where the wave passes: choose first and last")
    return piece


def exact_wave(chain: Chain, velocity: float) -> tuple[Soliton, float]:
    """Return the solitary wave with this largest grain velocity, m/s, and its unit of time, s."""
    delta = chain.law.power_of("a solitary wave")
    if chain.compressed:
        speed = velocity * chain.time_scale / chain.length_scale
        return struck(speed, delta), chain.time_scale
    # A sonic vacuum has no time of linear waves; use (m / K)^(1 / (1 + delta)).
    unit = (chain.masses[0] / chain.contact_constants[0]) ** (1 / (1 + delta))
    return solve(delta, velocity=velocity), float(unit)
