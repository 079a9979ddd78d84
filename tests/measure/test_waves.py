"""Fits of Bessel functions and modes: fitted samples, and the effect of noise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.changed_recordings import part_of
from helpers.example_chains import column
from helpers.example_scenes import run
from helpers.independent_theory import dense_modes
from numpy.typing import NDArray
from scipy.special import jv

from lmpchain import Chain, Displacement, Impulse, InputError, Law, Trajectory
from lmpchain.measure.fit import waves
from lmpchain.measure.fit.table import FittedNumber
from lmpchain.measure.fit.waves import fit_bessel, fit_modes

Array = NDArray[np.float64]
UNIFORM = {"grains": 40, "diameter": 1e-3, "gravity": 0.0, "top_load": 0.1}


def linear_run(
    chain: Chain, excitation: Any, units: float = 30.0, samples: int = 61, **more: Any
) -> Trajectory:
    duration = units * chain.time_scale
    return run(chain, excitation, duration, samples, 1e-9, "chebyshev", **more)


@pytest.fixture(scope="module")
def late() -> Trajectory:
    """Return the wave of the first six grains by Eq. (11), delayed by 1 tau and 5 % faster."""
    chain = Chain(**UNIFORM)
    t = linear_run(chain, Impulse(velocity=-2e-9), grains="1:6")
    z = 2 * 1.05 * (t.time[:, None] / chain.time_scale - 1.0)
    n = t.grains
    return replace(t, velocity=-2e-9 * (jv(2 * n - 2, z) + jv(2 * n, z)))


def test_the_covariance_of_fitted_parameters(rng: np.random.Generator, late: Trajectory):
    """The covariance is s^2 (J^T J)^-1, with numerical derivatives and s^2 from n - 3 residuals."""
    noise = 2e-11 * rng.normal(size=late.velocity.shape)
    fit = fit_bessel(replace(late, velocity=late.velocity + noise))

    def wave(amplitude: float, rate: float, delay: float) -> Array:
        z = 2 * rate * (fit.time - delay)
        return amplitude * (jv(2 * fit.grain - 2, z) + jv(2 * fit.grain, z))

    place = np.array([fit.amplitude, fit.rate, fit.delay])
    tau = late.scene.chain.time_scale
    assert (np.abs(place - [-2e-9, 1.05 / tau, tau]) < 4 * fit.error[:3]).all()
    assert fit.model == pytest.approx(wave(*place), abs=1e-9 * 2e-9)
    columns = []
    for k in range(3):
        step = np.zeros(3)
        step[k] = 1e-5 * abs(place[k])
        columns.append((wave(*(place + step)) - wave(*(place - step))) / (2 * step[k]))
    jacobian = np.array(columns).T
    left = fit.values - fit.model
    spread = left @ left / (left.size - 3)
    scale = np.abs(place)
    inverse = np.linalg.inv((jacobian * scale).T @ (jacobian * scale))
    covariance = spread * inverse * scale[:, None] * scale
    assert fit.covariance == pytest.approx(covariance, rel=1e-5)
    assert fit.error[:3] == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-5)
    assert fit.error[3] / fit.kappa == pytest.approx(2 * fit.error[1] / fit.rate, rel=1e-12)
    assert fit.residual == pytest.approx(
        np.sqrt((left @ left) / (fit.values @ fit.values)), rel=1e-9
    )
    unit = late.scene.chain.time_scale
    assert fit.kappa == pytest.approx((fit.rate * unit) ** 2, rel=1e-12)
    assert fit.expected == pytest.approx([-2e-9, 1 / unit, 0.0, 1.0], rel=1e-12)
    assert (fit.struck, fit.field) == (1, "velocity")
    *rows, last = fit.rows()
    values = (fit.amplitude, fit.rate, fit.delay, fit.kappa)
    names = (("amplitude", "m/s"), ("wave speed", "grains/s"), ("delay", "s"), ("kappa", ""))
    for row, value, error, expected, (name, unit) in zip(
        rows, values, fit.error, fit.expected, names, strict=True
    ):
        assert row == FittedNumber("bessel", name, value, error, expected, unit)
    assert last == FittedNumber("bessel", "residual", fit.residual, expected=0.0)


@pytest.mark.parametrize(
    ("more", "struck", "first", "last"),
    [
        ({}, 1, 1, 40),
        ({}, 9, 1, 40),
        ({"top": "wall", "bottom": "wall"}, 15, 1, 40),
        ({"impurity": [{"grain": 30, "diameter": 1.2e-3}]}, 12, 1, 29),
        ({"impurity": [{"grain": 6, "diameter": 1.2e-3}]}, 20, 7, 40),
        ({"impurity": [{"grain": 40, "mass": 3e-6}], "bottom": "wall"}, 15, 1, 39),
    ],
)
def test_values_before_any_echo(more: dict[str, Any], struck: int, first: int, last: int):
    """The limit is 2 s <= m - 7.4 m^(1/3), with the order m of the nearest image."""
    chain = Chain(**UNIFORM | more)
    t = linear_run(chain, Impulse(velocity=1e-9, grain=struck), 25.0)
    fit = fit_bessel(t)
    rate = np.sqrt(chain.linear_stiffness[struck - 1] / chain.masses[struck - 1])
    expected = []
    for time in t.time:
        for n in range(first, last + 1):
            order = 2 * (2 * last - n - struck)
            if first > 1 or "top" in more:
                order = min(order, 2 * (n + struck - 2 * first))
            if 2 * rate * time <= order - 7.4 * np.cbrt(order):
                expected.append((time, n))
    assert list(zip(fit.time, fit.grain, strict=True)) == expected
    rows = np.searchsorted(t.time, fit.time)
    assert np.array_equal(fit.values, t.velocity[rows, fit.grain - 1])
    assert fit.kappa == pytest.approx((rate * chain.time_scale) ** 2, rel=1e-5)


def test_grains_that_are_equal_within_five_per_cent():
    """Contacts and masses within 5 % belong to the uniform part; the fixed grain is arbitrary."""
    masses = np.full(30, 1e-6)
    masses[[3, 21]] = 1.049e-6, 0.951e-6
    masses[[1, 25]] = 0.949e-6, 1.051e-6
    chain = column(30, gravity=0.0, top_load=0.1, masses=masses)
    t = linear_run(chain, Impulse(velocity=1e-9, grain=14), 4.0)
    end = t.time[-1]
    assert np.unique(fit_bessel(t, until=end).grain)[[0, -1]].tolist() == [3, 25]
    constants = np.full(29, 1e9)
    constants[[4, 20]] = 1e9 * 1.07, 1e9 * 0.93  # Stiffnesses scale with the power 2/3.
    constants[[2, 24]] = 1e9 * 0.92, 1e9 * 1.085
    constants[[12, 14, 15]] = 1e9 * 1.03  # Contact 14, below the struck grain, is the reference.
    held = np.full(30, 1e-6)
    held[-1] = 1e-3
    chain = column(30, gravity=0.0, top_load=0.1, masses=held)
    t = linear_run(chain, Impulse(velocity=1e-9, grain=14), 4.0)
    assert np.unique(fit_bessel(t, until=t.time[-1]).grain)[[0, -1]].tolist() == [1, 30]
    chain = column(30, gravity=0.0, top_load=0.1, masses=held, contact_constants=constants)
    t = linear_run(chain, Impulse(velocity=1e-9, grain=14), 4.0)
    assert np.unique(fit_bessel(t, until=t.time[-1]).grain)[[0, -1]].tolist() == [4, 25]


def test_a_given_window_is_used():
    chain = Chain(**UNIFORM)
    t = linear_run(chain, Impulse(velocity=1e-9, grain=5), 10.0)
    end = 4 * chain.time_scale * (1 + 1e-9)
    fit = fit_bessel(t, grains=(3, 9), until=end)
    assert np.unique(fit.grain).tolist() == list(range(3, 10))
    assert fit.time.max() == t.time[t.time <= end].max()
    assert fit.grain.size == 7 * (t.time <= end).sum()
    assert np.unique(fit_bessel(t, grains=(5, 40), until=end).grain)[0] == 5
    assert np.unique(fit_bessel(t, grains=(1, 5), until=end).grain)[-1] == 5
    for grains in ((6, 9), (1, 4), (0, 9), (3, 41), (3, 5, 9)):
        with pytest.raises(
            InputError, match=r"grains: must be .first, last. with 1 <= first <= 5 <= last"
        ):
            fit_bessel(t, grains=grains)  # type: ignore[arg-type]
    alone = column(1, gravity=0.0, top_load=0.1, top="wall", bottom="wall")
    with pytest.raises(InputError, match="grains: must be two or more"):
        fit_bessel(linear_run(alone, Impulse(velocity=1e-9)))


def test_a_subset_of_too_many_values_is_fitted(monkeypatch: pytest.MonkeyPatch):
    """With a limit of 300 values, every fifth of the 49 reached grains is used."""
    monkeypatch.setattr(waves, "REGION", waves.REGION._replace(most=300))
    chain = column(120, gravity=0.0, top_load=0.1)
    t = linear_run(chain, Impulse(velocity=1e-9), 5.0, 21)
    fit = fit_bessel(t)
    reach = 2 * 5.0
    near = int((reach + 12 * np.cbrt(reach) + 20) / 2) + 1
    every = -(-near * 21 // 300)
    assert np.unique(fit.grain).tolist() == list(range(1, near + 1, every))
    assert 250 < fit.grain.size <= 300
    assert fit.kappa == pytest.approx(1, abs=1e-6)
    few = fit_bessel(t, grains=(1, 14))
    assert np.unique(few.grain).tolist() == list(range(1, 15)), "294 values are not too many"


@pytest.mark.parametrize("excitation", [Impulse(velocity=0.0), Displacement(displacement=0.0)])
def test_nothing_to_fit(excitation: Any):
    with pytest.raises(InputError, match="excitation: nothing moves"):
        fit_bessel(linear_run(Chain(**UNIFORM), excitation, 5.0))


def test_enough_values_with_a_wave_in_them():
    """Twelve values are sufficient, eleven are not; the largest must exceed 1e-3 of the strike."""
    chain = Chain(**UNIFORM)
    t = linear_run(chain, Impulse(velocity=1e-9), 6.0, 25)
    unit = chain.time_scale
    assert fit_bessel(t, (1, 2), 1.26 * unit).grain.size == 12
    with pytest.raises(InputError, match="samples: the fit has 11 values"):
        fit_bessel(part_of(t, columns=slice(1)), (1, 1), 2.51 * unit)
    size = np.abs(t.velocity[1:, 9]).max()
    for factor, enough in ((1.01e-3 * 1e-9 / size, True), (0.99e-3 * 1e-9 / size, False)):
        only = part_of(t, columns=slice(9, 10))
        only = replace(only, velocity=factor * only.velocity)
        if enough:
            assert fit_bessel(only, (1, 40), 6.1 * unit).amplitude == pytest.approx(
                factor * 1e-9, rel=1e-5
            )
        else:
            with pytest.raises(InputError, match="do not show the wave"):
                fit_bessel(only, (1, 40), 6.1 * unit)


# --- modes


def test_amplitudes_and_energies_of_modes():
    """The motion is the sum of the modes; their energies agree with dense eigenvectors."""
    chain = Chain(grains=9, diameter=np.linspace(1e-3, 1.3e-3, 9), bottom="wall", top_load=1e-3)
    t = linear_run(chain, Impulse(velocity=1e-9, grain=3), 12.0, 31)
    fit = fit_modes(t)
    scale = np.sqrt(chain.masses)
    squares, vectors = dense_modes(chain)
    amplitude = (t.displacement * scale) @ vectors
    rate = (t.velocity * scale) @ vectors
    assert fit.frequency == pytest.approx(np.sqrt(squares), rel=1e-10)
    for seen, dense in ((fit.amplitude, amplitude), (fit.rate, rate)):
        sign = np.sign((seen * dense).sum(0))
        assert seen == pytest.approx(sign * dense, abs=1e-9 * np.abs(dense).max())
    energy = (rate**2 + squares * amplitude**2) / 2
    assert fit.energy == pytest.approx(energy[0], rel=1e-8)
    assert np.array_equal(fit.time, t.time)
    assert fit.given == pytest.approx(t.scene.energy, rel=1e-12)
    # A ground changes the modes, and its energy is unknown.
    grounded = chain.replace(ground=Law("k*u", k=0.1 * chain.linear_stiffness[0]))
    held = fit_modes(replace(t, scene=t.scene.replace(chain=grounded)))
    assert held.frequency == pytest.approx(np.sqrt(dense_modes(grounded)[0]), rel=1e-10)
    assert held.frequency[0] > 1.1 * fit.frequency[0]
    assert np.isnan(held.given)
    bent = replace(
        t,
        velocity=t.velocity * (1 + 0.1 * t.time[:, None] / t.time[-1]),
        displacement=0.9 * t.displacement,
    )
    other = fit_modes(bent)
    rate = (bent.velocity * scale) @ vectors
    amplitude = (bent.displacement * scale) @ vectors
    energy = (rate**2 + squares * amplitude**2) / 2
    assert other.energy_error == pytest.approx(energy.std(0), rel=1e-7)
    assert other.share_error == pytest.approx(energy.std(0) / energy[0].sum(), rel=1e-7)
    off = [
        np.abs(x - y).max(1) / np.abs(x).max()
        for x, y in ((bent.velocity, t.velocity), (bent.displacement, t.displacement))
    ]
    assert other.residual == pytest.approx(np.maximum(*off), abs=1e-8)
