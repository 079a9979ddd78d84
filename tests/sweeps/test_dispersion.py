"""Dispersion by frequency and amplitude in one call."""

from typing import Any

import numpy as np
import pytest

from lmpchain import Chain, Drive, Impulse, InputError, Scene, dispersion


def chain_and_scene() -> tuple[Chain, Scene]:
    """Return a long loaded chain with a harmonic drive."""
    chain = Chain(grains=400, material="steel", diameter=1e-2, gravity=0.0, top_load=20.0)
    frequency = 0.5 * chain.band_edge / 2 / np.pi
    drive = Drive(amplitude=1e-9, frequency=frequency)
    return chain, Scene(chain=chain, excitation=drive, duration=60 / frequency)


def test_phase_decreases_with_the_square_of_the_amplitude() -> None:
    """Weak waves have the phase of linear theory; the shift grows with the amplitude squared."""
    chain, scene = chain_and_scene()
    omega = np.array([0.4, 0.45]) * chain.band_edge
    found = dispersion(scene, omega / 2 / np.pi, [1e-12, 1e-7, 2e-7])
    exact = 2 * np.arcsin(omega / 2 * np.sqrt(chain.masses[0] / chain.linear_stiffness[0]))
    assert found.linear_phase == pytest.approx(exact, rel=1e-12)
    assert (np.abs(found.phase[:, 0] - exact) < found.phase_error[:, 0]).all()
    shift = found.phase[:, 1:] - found.phase[:, :1]
    error = found.phase_error.max(1)
    assert (shift < 0).all()
    assert (np.abs(shift[:, 1] - 4 * shift[:, 0]) < 5 * error + 0.02 * np.abs(shift[:, 1])).all()
    table = found.to_dataframe()
    assert len(table) == 6
    assert list(table.columns)[:3] == ["frequency [Hz]", "amplitude [m]", "phase [rad]"]
    axes = found.plot()
    assert axes.get_xlabel() == "frequency"
    assert "(rad)" in axes.get_ylabel()
    for number, bars in enumerate(axes.containers):
        drawn = bars.lines[0].get_xydata()
        shift = found.phase[:, number] - found.linear_phase
        np.testing.assert_allclose(drawn, np.column_stack([found.frequency, shift]), rtol=1e-12)
    assert len(axes.containers) == 3
    (line,) = (line for line in axes.get_lines() if line.get_label() == "linear")
    assert set(line.get_ydata()) == {0.0}
    assert table["frequency [Hz]"].tolist() == np.repeat(found.frequency, 3).tolist()
    assert table["amplitude [m]"].tolist() == [1e-12, 1e-7, 2e-7] * 2
    assert table["phase [rad]"].tolist() == found.phase.ravel().tolist()
    assert table["linear_phase"].tolist() == np.repeat(found.linear_phase, 3).tolist()


def test_a_scene_without_a_harmonic_drive_is_rejected() -> None:
    """A strike has no frequency, and a drive beyond the band sends no steady wave far enough."""
    chain, scene = chain_and_scene()
    with pytest.raises(InputError, match="Drive or a Force"):
        dispersion(scene.replace(excitation=Impulse(velocity=1e-3)), [1e3], [1e-9])
    wrong: Any
    with pytest.raises(InputError, match=r"^frequencies: .* above 0 \(got \[-1000"):
        dispersion(scene, [-1e3], [1e-9])
    for wrong in ([], [0.0], [np.nan], [np.inf], [[1e3]]):
        with pytest.raises(InputError, match=r"^frequencies: must be one or more finite numbers"):
            dispersion(scene, wrong, [1e-9])
        with pytest.raises(InputError, match=r"^amplitudes: must be one or more finite numbers"):
            dispersion(scene, [1e3], wrong)
    with pytest.raises(InputError, match=r"frequency .* Hz"):
        dispersion(scene, [1e-2 * chain.band_edge], [1e-9])
