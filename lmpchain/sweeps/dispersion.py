"""Dispersion of a driven chain by frequency and amplitude."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError, shown
from ..measure.harmonic import HarmonicWave, wave
from ..scene.acting import Drive, Force
from ..scene.scene import Scene, check_scene
from ..simulation.many import simulate_many
from ..util.arrays import Array, numbers
from ..util.notebook import Shown
from ..util.plotting import ERROR_BARS, Axes, chart, finish, prefixed
from ..util.tabular import NamedColumn, Tabular

SAMPLES_A_PERIOD = 24  # Number of samples per period.
NUMBERS_OF_A_WAVE = {
    "phase": "rad",
    "phase_error": "rad",
    "decay": "",
    "decay_error": "",
    "strain": "",
    "strain_error": "",
}


@dataclass(frozen=True, eq=False, repr=False)
class AmplitudeDispersion(Shown, Tabular):
    """Phase and decay per cell of a chain driven at F frequencies with A amplitudes.

    Attributes
    ----------
    frequency : (F,) array
        Frequencies, Hz.
    amplitude : (A,) array
        Amplitudes of the drive, m, or of the force, N.
    phase, phase_error, decay, decay_error, strain, strain_error : (F, A) arrays
        Phase lag per cell, radians, decay per cell, mean change of the overlap relative to the
        overlap at rest, and their uncertainties, as in `measure.harmonic.HarmonicWave`.
    linear_phase, linear_decay : (F,) arrays
        Phase lag and decay in the linearised chain.
    waves : F lists of A HarmonicWave
        Measured waves with the amplitudes of all grains.
    """

    frequency: Array
    amplitude: Array
    phase: Array
    phase_error: Array
    decay: Array
    decay_error: Array
    strain: Array
    strain_error: Array
    linear_phase: Array
    linear_decay: Array
    waves: list[list[HarmonicWave]]
    _unit: str

    def _columns(self) -> Iterator[NamedColumn]:
        shape = self.phase.shape
        yield NamedColumn("frequency", "Hz", np.repeat(self.frequency, shape[1]))
        yield NamedColumn("amplitude", self._unit, np.tile(self.amplitude, shape[0]))
        for name, unit in NUMBERS_OF_A_WAVE.items():
            yield NamedColumn(name, unit, getattr(self, name).ravel())
        for name in ("linear_phase", "linear_decay"):
            yield NamedColumn(name, "", np.repeat(getattr(self, name), shape[1]))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the phase relative to linear waves over frequency, by amplitude; return the axes."""
        ax = chart(ax, "frequency [Hz]", "phase per cell less that of linear waves (rad)")
        for number, amplitude in enumerate(self.amplitude):
            shift = self.phase[:, number] - self.linear_phase
            error = self.phase_error[:, number]
            label = prefixed(amplitude, self._unit)
            ax.errorbar(self.frequency, shift, error, label=label, **ERROR_BARS)
        ax.axhline(0.0, color="k", ls="--", lw=1, label="linear")
        return finish(ax, "Dispersion by amplitude of the drive")


def dispersion(
    scene: Scene,
    frequencies: ArrayLike,
    amplitudes: ArrayLike,
    *,
    tolerance: float = 1e-8,
    **options: Any,
) -> AmplitudeDispersion:
    """Drive a chain at several frequencies and amplitudes, and measure phase and decay per cell.

    Parameters
    ----------
    scene : Scene
        Scene with a harmonic `Drive` or `Force`, whose frequency and amplitude are replaced, and a
        uniform or periodic chain. The chain must have an absorbing boundary, or be so long that no
        wave returns within the duration. A long chain is more accurate for strong waves, because
        they slowly compress or stretch a chain with a fixed end. The number of samples is replaced
        by 24 per period.
    frequencies : (F,) array_like
        Frequencies, Hz; the duration must be 48 or more periods of each.
    amplitudes : (A,) array_like
        Amplitudes, m for a drive or N for a force.
    tolerance : float
        Tolerance of each run.
    **options
        Arguments first, last, cell and periods of `measure.harmonic.wave`.

    Returns
    -------
    AmplitudeDispersion

    Raises
    ------
    InputError
        If the scene has no harmonic drive, or a wave cannot be measured; the error then names the
        frequency.

    Examples
    --------
    >>> from lmpchain import Chain
    >>> chain = Chain(grains=200, material="steel", diameter=1e-2, gravity=0.0, top_load=20.0)
    >>> frequency = 0.4 * chain.band_edge / (2 * np.pi)
    >>> drive = Drive(amplitude=1e-9, frequency=frequency)
    >>> scene = Scene(chain=chain, excitation=drive, duration=55 / frequency)
    >>> found = dispersion(scene, [frequency], [1e-9, 2e-7])
    >>> found.phase.round(5).tolist(), found.linear_phase.round(5).tolist()
    ([[0.82301, 0.82247]], [0.82301])
    """
    check_scene(scene)
    drive = scene.excitation
    if not isinstance(drive, Drive | Force) or drive.frequency is None:
        raise InputError.at("excitation", "must be a Drive or a Force with a frequency")
    frequency = _read_list("frequencies", frequencies, "above 0")
    amplitude = _read_list("amplitudes", amplitudes, "other than 0")
    scenes = [
        scene.replace(
            excitation=drive.replace(amplitude=float(a), frequency=float(f)),
            samples=1 + int(np.ceil(SAMPLES_A_PERIOD * scene.duration * f)),
        )
        for f in frequency
        for a in amplitude
    ]
    answers = iter(simulate_many(scenes, tolerance))
    waves = []
    for f in frequency:
        try:
            waves.append([wave(next(answers), **options) for _ in amplitude])
        except InputError as error:
            raise InputError(error.under(f"frequency {f:g} Hz")) from None
    fields = {
        name: np.array([[getattr(each, name) for each in row] for row in waves])
        for name in NUMBERS_OF_A_WAVE
    }
    linear = np.array([(row[0].linear_phase, row[0].linear_decay) for row in waves]).T
    unit = "m" if isinstance(drive, Drive) else "N"
    return AmplitudeDispersion(
        frequency=frequency,
        amplitude=amplitude,
        **fields,
        linear_phase=linear[0],
        linear_decay=linear[1],
        waves=waves,
        _unit=unit,
    )


def _read_list(key: str, given: ArrayLike, rule: str) -> Array:
    """Return one or more finite numbers; raise `InputError` if one of them breaks the rule."""
    values = np.atleast_1d(numbers(given, key))
    allowed = np.isfinite(values) & (values > 0 if rule == "above 0" else values != 0)
    if values.ndim != 1 or not values.size or not allowed.all():
        message = f"must be one or more finite numbers {rule} (got {shown(given)})"
        raise InputError.at(key, message)
    return values
