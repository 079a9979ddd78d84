"""Steady motion of a chain driven at one frequency: wavenumber and decay, drive-point response.

The amplitude of each grain at the frequency of the drive is ``2 sum(w x exp(-i w t)) / sum(w)``
with the window ``sin^8`` over the last periods, whose side lobes fall with the ninth power of the
frequency. This suppresses harmonics, the static displacement of strong waves and transients. In a
uniform chain the amplitudes of a wave, of its reflection and of their sum all obey

    a[n - c] + a[n + c] = 2 cos(k) a[n]

for a cell of c grains. A least-squares fit gives cos(k), without a model of the ends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..chain.chain import Chain
from ..errors import InputError
from ..scene.acting import Drive, Force
from ..scene.base import Excitation
from ..theory.steady import drive_stiffness, dynamic_stiffness
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array, whole_numbers
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish, prefixed
from ..util.tabular import Tabular
from .bodies import motion
from .contact import force_above_rest
from .motion import motion_of

__dir__ = listed(__name__)

Complex = NDArray[np.complex128]
LEAST_SAMPLES = 12  # Smallest number of samples in a period.
LEAST_PERIODS = 24  # Smallest number of periods in a window.
FEWEST_GRAINS = 8  # Smallest number of grains between which a wavenumber is measured.
END_MARGIN = 3  # Number of grains next to a source or an end whose motion is affected by it.
ENOUGH = 24  # With this number of grains, only the steadier ones are used.
# Relative changes of an amplitude from the window to its later half, below which a grain is steady.
STEADY = (1e-4, 1e-3, 1e-2)
# Transient in the window of a drive point, relative to its change to the later half of the window,
# if a third of it decays in between. Waves leave a uniform piece faster.
LEFT = 3.0
LEAST_DECAY = 1e-12  # A smaller decay of the linear wave is a rounding error.
# The largest amplitude of a harmonic of an error of size 1, which a square wave has.
SQUARE = 4 / np.pi


@dataclass(frozen=True, eq=False, repr=False)
class HarmonicWave(Shown, Tabular):
    """The wave of a harmonic drive in a uniform piece of a chain.

    Attributes
    ----------
    frequency : float
        Frequency, Hz.
    grain : (G,) array
        Grains between which the wave is measured.
    amplitude : (G,) complex array
        Amplitude of the displacement ``Re(a exp(i w t))`` at the drive frequency, m.
    phase : float
        Phase lag per cell downward, radians, from -pi to pi.
    phase_error : float
        Uncertainty of the phase lag: its changes from the window to the later half of the window,
        between two parts of the grains and with every second sample, and the error of the
        trajectory.
    decay, decay_error : float
        Decay per cell downward, by which the amplitude falls by the factor exp(-decay), and its
        uncertainty.
    cell : int
        Number of grains in a cell.
    strain, strain_error : float
        Mean change of the overlap relative to the overlap at rest, and its uncertainty. Strong
        waves compress or stretch the chain, which changes its dispersion as well.
    linear_phase, linear_decay : float
        Phase lag and decay in the linearised chain.
    """

    _units: ClassVar[Mapping[str, str]] = {"grain": "", "amplitude": "m"}

    frequency: float
    grain: NDArray[np.intp]
    amplitude: Complex
    phase: float
    phase_error: float
    decay: float
    decay_error: float
    cell: int
    strain: float
    strain_error: float
    linear_phase: float
    linear_decay: float

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the phase lag of the grains minus the phase lag of linear waves; return the axes."""
        ax = chart(ax, "grain, from the top", "phase lag less that of linear waves (rad)")
        lag = -np.unwrap(np.angle(self.amplitude))
        cells = (self.grain - self.grain[0]) / self.cell
        ax.plot(self.grain, lag - lag[0] - self.linear_phase * cells, ".", label="grains")
        slope = self.phase - self.linear_phase
        error = f"{self.phase:.7g} ± {self.phase_error:.1g} rad a cell"
        ax.plot(self.grain, slope * cells, label=f"measured, {error}")
        ax.axhline(0.0, color="k", ls="--", lw=1, label=f"linear, {self.linear_phase:.7g}")
        title = f"{prefixed(self.frequency, 'Hz')}, {prefixed(float(abs(self.amplitude[0])), 'm')}"
        return finish(ax, title)


@dataclass(frozen=True)
class DrivePoint:
    """Response of a chain at the grain or wall that is driven at one frequency.

    Force and motion are the complex amplitudes a of ``Re(a exp(i w t))``. The force is that of the
    driver on the chain and includes the inertia of a driven grain.

    Attributes
    ----------
    frequency : float
        Frequency, Hz.
    stiffness : complex
        Dynamic stiffness, force over displacement, N/m.
    error : float
        Error in magnitude, N/m: three times the change from the window to its later half, the
        change with every second sample, and the error of the trajectory. This error is not valid
        for a chain that bounces without becoming periodic.
    linear : complex
        Stiffness of the linearised chain, N/m; NaN without a load.
    """

    frequency: float
    stiffness: complex
    error: float
    linear: complex

    @property
    def impedance(self) -> complex:
        """Force over velocity, N s/m; the real part is positive if the chain absorbs energy."""
        return self.stiffness / (2j * np.pi * self.frequency)

    @property
    def impedance_error(self) -> float:
        """Uncertainty of the impedance in magnitude, N s/m."""
        return self.error / (2 * np.pi * self.frequency)

    @property
    def apparent_mass(self) -> complex:
        """Force over acceleration, kg."""
        return -self.stiffness / (2 * np.pi * self.frequency) ** 2

    @property
    def apparent_mass_error(self) -> float:
        """Uncertainty of the apparent mass in magnitude, kg."""
        return self.error / (2 * np.pi * self.frequency) ** 2

    @property
    def loss_factor(self) -> float:
        """Imaginary part of the dynamic stiffness over the magnitude of its real part."""
        return self.stiffness.imag / abs(self.stiffness.real)

    @property
    def loss_factor_error(self) -> float:
        """Uncertainty of the loss factor; infinite where the real part may be 0."""
        least = abs(self.stiffness.real) - self.error
        if least <= 0:
            return np.inf
        return self.error * (1 + abs(self.loss_factor)) / least


def wave(
    trajectory: Trajectory,
    first: int | None = None,
    last: int | None = None,
    *,
    cell: int = 1,
    periods: int | None = None,
) -> HarmonicWave:
    """Measure the phase and decay per cell of the wave in a chain driven at one frequency.

    Parameters
    ----------
    trajectory : Trajectory
        Run with a `Drive` or `Force` of one amplitude and frequency, with 12 or more samples per
        period. Below the source the chain must be uniform or repeat a cell. It must have an
        absorbing boundary (`patterns.absorbing`), or be so long that no reflection has returned.
    first, last : int, optional
        First and last grain between which the wave is measured; by default all grains below the
        source that repeat the cell, are recorded and move steadily.
    cell : int
        Number of grains in a cell, such as 2 for a dimer.
    periods : int, optional
        Number of periods at the end of the run for the average; by default half of all periods.

    Returns
    -------
    HarmonicWave

    Raises
    ------
    InputError
        If nothing drives the chain at one frequency, the run has too few periods or samples, or too
        few grains repeat the cell and move steadily.

    Examples
    --------
    >>> import lmpchain
    >>> from lmpchain import patterns
    >>> chain = lmpchain.Chain(grains=50, diameter=1e-3, gravity=0.0, top_load=1.0, bottom="wall")
    >>> endless = patterns.absorbing(chain, bottom=40)
    >>> drive = lmpchain.Drive(amplitude=1e-12, frequency=0.3 * chain.band_edge / np.pi)
    >>> scene = lmpchain.Scene(chain=endless, excitation=drive, duration=90 / drive.frequency,
    ...                        samples=1081)
    >>> found = wave(lmpchain.simulate(scene, "native", tolerance=1e-8))
    >>> bool(abs(found.phase - found.linear_phase) < found.phase_error < 1e-6)
    True
    """
    chain = trajectory.scene.chain
    size = int(whole_numbers(cell, "cell"))
    drive, window = _window(trajectory, periods)
    numbers = _choose(trajectory, drive, first, last, size)
    u, _ = motion(trajectory, numbers)
    omega = 2 * np.pi * drive.frequency
    motion_error = SQUARE * motion_of(trajectory).known_error("displacement")
    whole, later, rough, _ = amplitudes(trajectory.time, u, omega, window)
    count = _steady(whole, later, motion_error)
    if count < FEWEST_GRAINS + 2 * size:
        few = f"{count} of the chosen grains move steadily, fewer than {FEWEST_GRAINS + 2 * size}"
        raise InputError.at("duration", f"{few}: record longer, or in a longer chain")
    whole, later, rough = (each[:count] for each in (whole, later, rough))
    cosine = _cosine(whole, size)
    weight = np.cumsum(np.abs(whole[size:-size]) ** 2)
    split = int(np.searchsorted(weight, weight[-1] / 2))
    split = min(max(split, 2), weight.size - 2)
    parts = (_cosine(whole[: split + 2 * size], size), _cosine(whole[split:], size))
    inner = np.abs(whole[size:-size])
    off = motion_error * (1 + abs(cosine)) * inner.sum() / (inner**2).sum()
    changes = (_cosine(later, size) - cosine, _cosine(rough, size) - cosine, parts[0] - parts[1])
    error = off + sum(map(abs, changes))
    number = _wavenumber(cosine, whole, size)
    # Near the edges of a band the wavenumber depends on its cosine as a square root.
    moved = [_wavenumber(cosine + error * turn, whole, size) - number for turn in (1, -1, 1j, -1j)]
    linear = _linear(chain, int(numbers[0]), size, omega, number.real)
    overlap = chain.contacts.overlap[numbers[:-1]]
    strain, strain_error = _strain(u[:, :count], overlap[: count - 1], window)
    return HarmonicWave(
        frequency=drive.frequency,
        grain=numbers[:count],
        amplitude=whole,
        phase=number.real,
        phase_error=float(max(abs(np.angle(np.exp(1j * change.real))) for change in moved)),
        decay=-number.imag,
        decay_error=float(max(abs(change.imag) for change in moved)),
        cell=size,
        strain=strain,
        strain_error=strain_error + 2 * motion_error / float(overlap.min()),
        linear_phase=linear.real,
        linear_decay=-linear.imag,
    )


def drive_point(trajectory: Trajectory, periods: int | None = None) -> DrivePoint:
    """Measure the dynamic stiffness, impedance and apparent mass of a chain where it is driven.

    Parameters
    ----------
    trajectory : Trajectory
        Run as for `wave`; the driven grain and the grains that touch the driven body must be
        recorded.
    periods : int, optional
        See `wave`.

    Returns
    -------
    DrivePoint

    Raises
    ------
    InputError
        If nothing drives the chain at one frequency, grains were not recorded, or the run has too
        few periods or samples.

    Examples
    --------
    >>> import lmpchain
    >>> lossy = {"viscoelastic": 2e-6}
    >>> chain = lmpchain.Chain(grains=8, diameter=5e-3, top="wall", bottom="wall", damping=lossy,
    ...                        gravity=0.0, top_load=1.0)
    >>> shaker = lmpchain.Drive(grain=0, amplitude=1e-11, frequency=0.1 * chain.band_edge / np.pi)
    >>> scene = lmpchain.Scene(chain=chain, excitation=shaker, duration=200 / shaker.frequency,
    ...                        samples=3201)
    >>> found = drive_point(lmpchain.simulate(scene, "native", tolerance=1e-8))
    >>> bool(abs(found.stiffness - found.linear) < found.error < 1e-6 * abs(found.linear))
    True
    """
    chain = trajectory.scene.chain
    drive, window = _window(trajectory, periods)
    time = trajectory.time
    omega = 2 * np.pi * drive.frequency
    body = drive.grain if isinstance(drive, Force) else drive.body(chain)
    moved = amplitudes(time, motion(trajectory, np.array([body]))[0], omega, window)
    known = motion_of(trajectory)
    part = known.known_error("displacement") / max(known.sampled[0], 1e-300)
    if isinstance(drive, Force):
        # The waveform is a sine.
        force = [np.full(1, -1j * drive.amplitude)] * len(moved)
        off = part * SQUARE * known.sampled[0] / abs(moved[0][0])
    else:
        pushed = force_above_rest(trajectory, body)
        force = amplitudes(time, pushed[:, None], omega, window)
        mass = float(chain.masses[body - 1]) if 1 <= body <= chain.grains else 0.0
        inertia = mass * omega**2
        force = [each - inertia * u for each, u in zip(force, moved, strict=True)]
        moved = [np.full(1, -1j * drive.amplitude)] * len(force)
        size = float(np.abs(pushed).max())
        off = 2 * part * SQUARE * size / max(abs(force[0][0]), 1e-300)
    ratios = [complex(f[0] / u[0]) for f, u in zip(force, moved, strict=True)]
    whole, _, rough, _ = ratios
    linear = complex(np.nan, np.nan)
    if chain.linearisable:
        linear = drive_stiffness(chain, drive)
    error = transient(ratios) + abs(rough - whole) + off * abs(whole)
    return DrivePoint(drive.frequency, whole, float(error), linear)


def harmonic_drive(excitation: Excitation) -> Drive | Force:
    """Return a drive or force of one amplitude, other than 0, and frequency.

    Parameters
    ----------
    excitation : Excitation

    Returns
    -------
    Drive or Force

    Raises
    ------
    InputError
        If the excitation is anything else.
    """
    if (
        isinstance(excitation, Drive | Force)
        and excitation.frequency is not None
        and excitation.cycles is None
        and excitation.amplitude
    ):
        return excitation
    rule = "must be a drive or a force of one amplitude and frequency, without cycles"
    raise InputError.at("excitation", f"{rule}, because only then the motion becomes steady")


def averaged_periods(recorded: float, periods: int | None, least: int) -> int:
    """Return the number of periods, `least` or more, over which a measure averages.

    It is the given number or half of the recorded one, so that the motion becomes steady before.

    Parameters
    ----------
    recorded : float
        Number of recorded periods.
    periods : int, optional
        Given number of periods.
    least : int
        Smallest number of periods for an average.

    Returns
    -------
    int

    Raises
    ------
    InputError
        If the recording has too few periods, or the given number is not from `least` to all.
    """
    most = int(recorded * (1 + 1e-9))
    if periods is None and most // 2 < least:
        need = f"must be {2 * least} periods of the drive or more (got {most})"
        raise InputError.at("duration", f"{need}: record longer, or give periods")
    count = most // 2 if periods is None else int(whole_numbers(periods, "periods"))
    if not least <= count <= most:
        raise InputError.at(
            "periods", f"must be {least} to {most}, the periods of the run (got {count})"
        )
    return count


def _window(trajectory: Trajectory, periods: int | None) -> tuple[Drive | Force, int]:
    """Return the drive, and the number of samples over which the motion is averaged."""
    drive = harmonic_drive(trajectory.scene.excitation)
    period = 1 / drive.frequency
    end = float(trajectory.time[-1])
    count = averaged_periods(end / period, periods, LEAST_PERIODS)
    step = trajectory.scene.sampling_interval
    if period < LEAST_SAMPLES * step * (1 - 1e-9):
        least = 1 + int(np.ceil(LEAST_SAMPLES * end / period))
        raise InputError.at(
            "samples", f"must be {least} or more: {LEAST_SAMPLES} per period of the drive"
        )
    return drive, int(count * period / step * (1 + 1e-9))


def amplitudes(time: Array, signals: Array, omega: float, window: int) -> list[Complex]:
    """Return amplitudes at one frequency in the window, its halves and every second sample.

    Parameters
    ----------
    time : (T,) array
        Times, s.
    signals : (T, G) array
        Signals.
    omega : float
        Angular frequency, rad/s.
    window : int
        Number of intervals between samples at the end over which the signals are averaged.

    Returns
    -------
    list of (G,) complex array
        Amplitudes a of ``Re(a exp(i w t))`` in the window, in its later half, with every second
        sample, and in the earlier half.
    """

    def amplitude(size: int, stride: int = 1, end: int = len(time)) -> Complex:
        samples = slice(end - size - 1, end, stride)
        t = time[samples]
        shape = np.sin(np.pi * (t - t[0]) / (t[-1] - t[0])) ** 8
        turned: Complex = (shape * np.exp(-1j * omega * t)) @ signals[samples]
        return 2 * turned / shape.sum()

    half = window // 2
    earlier = amplitude(half, end=len(time) - half)
    return [amplitude(window), amplitude(half), amplitude(window, stride=2), earlier]


def transient(amplitudes: Sequence[Complex | complex]) -> Array:
    """Return a bound on what is left of a transient in the amplitudes of a window.

    A transient that hardly decays, or turns, changes little from one window to another.

    Parameters
    ----------
    amplitudes : sequence of (G,) complex array
        Amplitudes, or ratios of them, in the order of `amplitudes`.

    Returns
    -------
    (G,) array
    """
    whole, later, _, earlier = amplitudes
    return np.asarray(LEFT * np.abs(later - whole) + np.abs(later - earlier))


def _choose(
    trajectory: Trajectory, drive: Drive | Force, first: int | None, last: int | None, cell: int
) -> NDArray[np.intp]:
    """Return the numbers of the grains between which the wave may be measured."""
    chain = trajectory.scene.chain
    recorded = np.sort(trajectory.grains)
    low = max(drive.grain, 1) + END_MARGIN if first is None else int(whole_numbers(first, "first"))
    high = chain.movable - END_MARGIN if last is None else int(whole_numbers(last, "last"))
    if not 1 <= low < high <= chain.movable:
        raise InputError.at("first", f"must leave grains to measure (got {low} to {high})")
    stiffness = chain.contacts.stiffness
    kinds = [chain.masses, stiffness[:-1], stiffness[1:], chain.drag, chain.dynamical_matrix()[0]]
    kinds += [chain.contact_viscosity[:-1], chain.contact_viscosity[1:]]
    number = low
    while number < high and number + 1 in recorded:
        # Python counts from 0: this is the grain after `number`.
        if number >= low + cell and not all(
            np.isclose(values[number], values[number - cell], rtol=1e-9, atol=0.0)
            for values in kinds
        ):
            break
        number += 1
    if not cell >= 1 or low not in recorded or number - low + 1 < FEWEST_GRAINS + 2 * cell:
        few = f"{max(number - low + 1, 0)} grains from grain {low} are recorded and repeat a cell"
        cure = f"{FEWEST_GRAINS + 2 * cell} or more are needed"
        raise InputError.at("chain", f"{few} of {cell}: {cure}")
    return np.arange(low, number + 1)


def _steady(whole: Complex, later: Complex, error: float) -> int:
    """Return the number of grains, from the first, that move steadily."""
    size = np.abs(whole)
    count = 0
    for share in STEADY:
        moves = (np.abs(later - whole) <= share * size) & (size > 10 * error)
        count = int(moves.size if moves.all() else moves.argmin())
        if count >= ENOUGH:
            break
    return count


def _cosine(amplitude: Complex, cell: int) -> complex:
    """Return the cosine of the complex wavenumber by least squares."""
    inner = amplitude[cell:-cell]
    neighbours = amplitude[: -2 * cell] + amplitude[2 * cell :]
    return complex(np.vdot(inner, neighbours) / (2 * np.vdot(inner, inner)))


def _wavenumber(cosine: complex, amplitude: Complex, cell: int) -> complex:
    """Return the wavenumber k of exp(-i k n) with this cosine that fits the amplitudes."""
    root = complex(np.arccos(complex(cosine)))
    later = amplitude[cell:]
    misfits = [
        float((np.abs(later - np.exp(-1j * k) * amplitude[:-cell]) ** 2).sum())
        for k in (root, -root)
    ]
    return root if misfits[0] <= misfits[1] else -root


def _linear(chain: Chain, grain: int, cell: int, omega: float, phase: float) -> complex:
    """Return the wavenumber per cell of the linear wave that decays downward.

    If the two waves do not decay, the wave whose phase has the sign of `phase` is returned.
    """
    if not chain.linearisable:
        return complex(np.nan, np.nan)
    springs = dynamic_stiffness(chain, omega)
    # Force on a grain for a unit displacement of it, without damping.
    pull = chain.masses[: chain.movable] * chain.dynamical_matrix()[0]
    transfer = np.eye(2, dtype=complex)
    for n in range(grain, grain + cell):
        inertia = chain.masses[n - 1] * (omega**2 - 1j * omega * chain.drag[n - 1])
        above, below = springs[n - 1], springs[n]
        middle = pull[n - 1] + 1j * (above + below).imag - inertia
        transfer = np.array([[middle / below, -above / below], [1, 0]]) @ transfer
    root = complex(np.arccos(np.trace(transfer) / 2))
    decays = abs(root.imag) > LEAST_DECAY
    other = root.imag > 0 if decays else root.real * phase < 0
    return -root if other else root


def _strain(u: Array, overlap: Array, window: int) -> tuple[float, float]:
    """Return the mean change of overlaps relative to rest, and its change within the window."""

    def mean(size: int) -> Array:
        t = np.arange(size + 1) / size
        shape = np.sin(np.pi * t) ** 8
        return np.asarray(shape @ u[len(u) - size - 1 :] / shape.sum())

    with np.errstate(divide="ignore", invalid="ignore"):
        whole, later = (-np.diff(mean(size)) / overlap for size in (window, window // 2))
    half = whole.size // 2
    change = abs(whole.mean() - later.mean()) + abs(whole[:half].mean() - whole[half:].mean())
    return float(whole.mean()), float(change)
