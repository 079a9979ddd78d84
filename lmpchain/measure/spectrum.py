"""Spectra over frequency and wavenumber, with the dispersion relation, and space-time diagrams."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..chain.chain import Chain
from ..errors import InputError, shown
from ..theory.bands import Cell, branches, local_bands, repeating
from ..trajectory.trajectory import UNITS_OF_FIELDS, Trajectory
from ..util.arrays import Array, as_slice, whole_numbers
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, draw_map, legend
from ..util.tabular import Tabular
from .recorded import Field, check

__dir__ = listed(__name__)

FEWEST_GRAINS = 8  # Smallest number of grains that resolves wavenumbers.
# Vermilion of Okabe and Ito, visible on every colour of cividis with any colour vision.
LINE = "#D55E00"


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum(Shown, Tabular):
    """Amplitude spectra of the motion of G grains.

    Attributes
    ----------
    field : "velocity" or "displacement"
        Field x whose spectra these are.
    frequency : (F,) array
        Frequencies, Hz, from 0 to half the sampling rate.
    grain : (G,) array
        Numbers of the recorded grains from the top downward.
    bands : (G, B, 2) array
        Edges of the frequency bands of linear waves around each grain, Hz; a single band from 0
        where all grains are alike.
    amplitude : (F, G) array
        ``|integral of w x exp(-2 pi i f t) dt|`` with the window w, m/s or m per Hz. The spectrum
        of a pulse does not depend on the duration of the recording. A steady oscillation of
        amplitude A gives a line of height A / 2 times the integral of w. The integral of (w x)^2
        over time equals the integral of 2 amplitude^2 over frequency.
    """

    _units: ClassVar[dict[str, str]] = {"frequency": "Hz", "amplitude": "{field}/Hz"}
    _numbers: ClassVar[str] = "grain"

    field: Field
    frequency: Array
    grain: np.ndarray
    bands: Array
    amplitude: Array

    @property
    def cut_off(self) -> Array:
        """Highest frequency that propagates around each grain, (G,) Hz; 0 in a sonic vacuum."""
        return self.bands[:, -1, 1]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the amplitude over frequency and depth, with the local bands; return the axes."""
        ax = chart(ax, "frequency [Hz]", "grain, from the top")
        _draw_logarithmic(ax, self.frequency, self.grain, self.amplitude.T, self.field)
        if self.cut_off.any():
            ax.plot(self.cut_off, self.grain, color=LINE, label="local cut-off")
            for number, edge in enumerate(self.bands[:, :-1, 1].T):
                label = "" if number else "gap between branches"
                ax.plot(edge, self.grain, "--", color=LINE, label=label)
                ax.plot(self.bands[:, number + 1, 0], self.grain, "--", color=LINE)
            legend(ax, loc="lower left", frameon=True)
        ax.set(ylim=ax.get_ylim()[::-1])
        ax.set_xlim(0, min(self.frequency[-1], 1.5 * self.cut_off.max() or np.inf))
        ax.locator_params(axis="x", nbins=6)
        ax.locator_params(axis="y", integer=True, min_n_ticks=1)
        return ax


@dataclass(frozen=True, eq=False, repr=False)
class Dispersion(Shown, Tabular):
    """Spectrum of neighbouring grains over frequency and wavenumber.

    Attributes
    ----------
    field : "velocity" or "displacement"
        Field x whose spectrum this is.
    frequency : (F,) array
        Frequencies, Hz, from 0 to half the sampling rate.
    wavenumber : (K,) array
        Wavenumbers k, radians per grain, from -pi to pi; positive for downward waves.
    amplitude : (F, K) array
        ``|sum over grains of integral of w x exp(i k n - 2 pi i f t) dt|`` with the window w, m/s
        or m per Hz.
    grain : (3,) array
        Numbers of the first, the middle and the last grain.
    relation : (3, B, K) array
        The B branches of the local dispersion relation at these three grains, Hz. They are the
        branches of the cell that repeats there, or `cut_off` times ``|sin(k / 2)|`` if all grains
        are alike or no cell is found.
    """

    _units: ClassVar[dict[str, str]] = {"frequency": "Hz", "amplitude": "{field}/Hz"}
    _numbers: ClassVar[str] = "wavenumber"

    field: Field
    frequency: Array
    wavenumber: Array
    amplitude: Array
    grain: np.ndarray
    relation: Array

    @property
    def ridge(self) -> Array:
        """Frequency with the largest amplitude at each wavenumber, (K,) Hz, from `frequency`."""
        return self.frequency[self.amplitude.argmax(0)]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the amplitude over wavenumber and frequency with the relation; return the axes."""
        ax = chart(ax, "wavenumber, downward (radians a grain)", "frequency [Hz]")
        _draw_logarithmic(ax, self.wavenumber, self.frequency, self.amplitude, self.field)
        styles = (":", "-", "--")
        for number, relation, style in zip(self.grain, self.relation, styles, strict=True):
            if relation.any():
                ax.plot(self.wavenumber, relation[0], style, color=LINE, label=f"grain {number}")
                ax.plot(self.wavenumber, relation[1:].T, style, color=LINE)
                legend(ax, title="local relation", loc="upper center", ncols=3, frameon=True)
        ax.set_ylim(0, min(self.frequency[-1], 1.5 * self.relation.max() or np.inf))
        return ax


def _sort(trajectory: Trajectory, field: Field) -> tuple[np.ndarray, Array]:
    """Return the recorded grains from the top downward, (G,), and their motion, (T, G) m/s or m."""
    check(trajectory, field)
    order = as_slice(np.argsort(trajectory.grains))
    return trajectory.grains[order], getattr(trajectory, field)[:, order]


def spectrum(trajectory: Trajectory, field: Field = "velocity", window: str = "boxcar") -> Spectrum:
    """Return the amplitude spectrum of every recorded grain.

    Record often enough, because frequencies above half the sampling rate appear at lower
    frequencies.

    Parameters
    ----------
    trajectory : Trajectory
    field : "velocity" or "displacement"
    window : str
        Name of a window of `scipy.signal.get_window`. Use "boxcar", which changes nothing, for
        pulses that end within the recording. Use "hann" for lasting oscillations, so that strong
        lines do not hide weak lines.

    Returns
    -------
    Spectrum

    Raises
    ------
    InputError
        If there are fewer than 16 samples, or the field or the window does not exist.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=30, diameter=1e-3)
    >>> strike = lmpchain.Impulse(velocity=1e-6)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=1e-3, samples=1001)
    >>> spectra = spectrum(lmpchain.simulate(scene, engine="native"))
    >>> spectra.amplitude.shape, f"{spectra.frequency[-1]:.0f} Hz", f"{spectra.cut_off[0]:.0f} Hz"
    ((501, 30), '499500 Hz', '46332 Hz')
    """
    grain, motion = _sort(trajectory, field)
    step = trajectory.time[1]
    samples = trajectory.time.size
    # The sum times the step approximates the integral over time.
    amplitude = step * np.abs(np.fft.rfft(_window(window, samples)[:, None] * motion, axis=0))
    bands = local_bands(trajectory.scene.chain)[grain - 1] / (2 * np.pi)
    return Spectrum(field, np.fft.rfftfreq(samples, step), grain, bands, amplitude)


def dispersion(
    trajectory: Trajectory, first: int, last: int, field: Field = "velocity", window: str = "hann"
) -> Dispersion:
    """Return the spectrum of the grains from `first` to `last` over frequency and wavenumber.

    Parameters
    ----------
    trajectory : Trajectory
    first, last : int
        First and last grain of a range of 8 or more grains, all of which were recorded.
    field : "velocity" or "displacement"
    window : str
        Name of a window of `scipy.signal.get_window`, which is applied over time and over grains.

    Returns
    -------
    Dispersion

    Raises
    ------
    InputError
        If grains are too few or were not recorded, there are fewer than 16 samples, or the field or
        the window does not exist.
    """
    grains, motion = _sort(trajectory, field)
    chosen = np.arange(first, last + 1)
    if chosen.size < FEWEST_GRAINS:
        raise InputError.at(
            "last", f"wavenumbers need {FEWEST_GRAINS} grains or more (got {first} to {last})"
        )
    missing = np.setdiff1d(chosen, grains)
    if missing.size:
        cure = f'choose others, or record grains = "{first}:{last}"'
        raise InputError.at(
            "grains",
            f"grain {missing[0]} was not recorded, but the range must have no gaps: {cure}",
        )
    step = trajectory.time[1]
    samples = trajectory.time.size
    windowed = motion[:, np.isin(grains, chosen)] * _window(window, chosen.size)
    windowed *= _window(window, samples)[:, None]
    # The transform over time has the factor exp(-2 pi i f t), the transform over grains exp(i k n).
    transform = np.fft.ifft(step * np.fft.rfft(windowed, axis=0), axis=1, norm="forward")
    wavenumber = 2 * np.pi * np.fft.fftshift(np.fft.fftfreq(chosen.size))
    chain = trajectory.scene.chain
    places = np.array([first, (first + last) // 2, last])
    period = repeating(chain, first, last)
    return Dispersion(
        field=field,
        frequency=np.fft.rfftfreq(samples, step),
        wavenumber=wavenumber,
        amplitude=np.abs(np.fft.fftshift(transform, axes=1)),
        grain=places,
        relation=np.array([_branches(chain, grain, period, wavenumber) for grain in places]),
    )


def _branches(chain: Chain, grain: int, period: int, wavenumber: Array) -> Array:
    """Return the branches (B, K), Hz, of a chain that repeats the grains from a given one."""
    if period == 1 or not chain.linearisable:
        return cut_off(chain)[grain - 1] * np.abs(np.sin(wavenumber / 2))[None]
    # Use the cell that begins here, or the last whole one above the end.
    start = min(grain, chain.grains - period)
    cell = Cell(chain.masses[start - 1 :][:period], chain.linear_stiffness[start - 1 :][:period])
    return branches(cell, period * wavenumber).frequency / (2 * np.pi)


def cut_off(chain: Chain) -> Array:
    """Return the highest frequency that propagates around each grain, (N,) Hz; 0 in a sonic vacuum.

    It is the top of the highest branch of the cell that repeats around the grain, such as a dimer.
    If no cell repeats, it is the value sqrt(k_n / m_n) / pi of a uniform chain of such grains with
    the contact below the grain.

    Parameters
    ----------
    chain : Chain

    Returns
    -------
    (N,) array
        Hz.
    """
    return local_bands(chain)[:, -1, 1] / (2 * np.pi)


def travel_time(chain: Chain, source: int = 1) -> Array:
    """Return the travel time of a weak, long wave from one grain to each, (N,) s.

    The travel time is the sum of sqrt(m / k) over the contacts in between. From grain 1 under a
    free top, half the time of the first contact is added, because the wave starts at the surface.
    The velocity is largest a little later, by a time that grows with the width of the front.

    Parameters
    ----------
    chain : Chain
    source : int
        Grain from which the wave starts.

    Returns
    -------
    (N,) array
        s.

    Raises
    ------
    InputError
        If the chain is not compressed, or the grain does not exist.
    """
    chain.refuse_ground("the time of travel of a weak wave")
    if not chain.compressed:
        raise InputError.at(
            "chain",
            "without gravity and load no weak wave travels, so its travel time is undefined",
        )
    chain.refuse_loose("the time of travel of a weak wave")
    number = int(whole_numbers(source, "source"))
    if not 1 <= number <= chain.grains:
        raise InputError.at("source", f"grains are numbered 1 to {chain.grains} (got {source})")
    delay = np.sqrt((chain.masses[1:] + chain.masses[:-1]) / 2 / chain.linear_stiffness)
    time = np.concatenate(([0.0], np.cumsum(delay)))
    surface = delay[:1].sum() / 2 if number == 1 and chain.top == "free" else 0.0
    return np.abs(time - time[number - 1]) + surface


def space_time(
    trajectory: Trajectory, field: Field = "velocity", ax: Axes | None = None, law: bool = False
) -> Axes:
    """Draw the motion over time and depth, downward in red, upward in blue; return the axes.

    The diagram is the one of `Trajectory.plot`. If `law` is true, a dashed line shows `travel_time`
    from the struck or driven grain.

    Parameters
    ----------
    trajectory : Trajectory
    field : "velocity" or "displacement"
    ax : Axes, optional
        Axes to draw in; by default the axes of a new figure.
    law : bool
        Whether to draw the arrival of a long weak wave.

    Returns
    -------
    Axes
    """
    check(trajectory, field)
    ax = trajectory.plot(ax, field)
    if law:
        chain = trajectory.scene.chain
        source = getattr(trajectory.scene.excitation, "grain", 1)
        grains = np.arange(1, chain.grains + 1)
        ax.plot(travel_time(chain, source), grains, "k--", lw=1, label="long weak wave")
        legend(ax, loc="lower left", frameon=True)
    return ax


def _window(name: str, size: int) -> Array:
    from scipy.signal import get_window

    try:
        window: Array = get_window(name, size)
        return window
    except ValueError:
        raise InputError.at(
            "window", f"must be the name of a window of scipy.signal.get_window (got {shown(name)})"
        ) from None


def _draw_logarithmic(ax: Axes, x: Array, y: Array, values: Array, field: Field) -> None:
    """Draw values (Y, X) as colours over three decades, with a colour bar."""
    from matplotlib.colors import LogNorm

    # A chain at rest would need the logarithm of 0.
    largest = values.max() or 1.0
    smallest = largest / 1e3
    scale = LogNorm(smallest, largest)
    values = np.maximum(values, smallest)
    label = f"{field} ({UNITS_OF_FIELDS[field]} per Hz)"
    draw_map(ax, x, y, values, label, extend="min", norm=scale, cmap="cividis")
