"""The ledger of energy and momentum, compared with exact and classical results."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.changed_recordings import of_error
from helpers.example_chains import column, vacuum
from helpers.example_scenes import run, struck
from scipy.special import jv

from lmpchain import Chain, Displacement, Drive, Impulse, Profile, engines, simulate
from lmpchain.measure.contact import contacts, drive_force
from lmpchain.measure.energy import ledger
from lmpchain.measure.flight import arrival
from lmpchain.scene.excitation import Excitation


def largest(values: Any) -> float:
    return float(np.abs(values).max())


COLUMN = column(20)
LOADED = column(15, top_load=1e-2, exponent=2.0, bottom="wall")
BETWEEN = Chain(
    grains=12,
    diameter=np.linspace(1e-3, 2e-3, 12),
    top_load=1e-2,
    top="wall",
    bottom="wall",
    exponent=1.25,
)
UNDRIVEN = {
    "weak": (COLUMN, Impulse(velocity=1e-9), 4e-5),
    "opening": (COLUMN, Impulse(velocity=1e-2), 4e-5),
    "pulled": (LOADED, Displacement(displacement=-2 * LOADED.length_scale, grain=4), 4e-5),
    "between walls": (BETWEEN, Impulse(velocity=1e-3, grain=5), 4e-5),
    "vacuum": (vacuum(15), Impulse(velocity=1.0), 20.0),
}


@pytest.mark.parametrize("case", UNDRIVEN.values(), ids=UNDRIVEN)
def test_energy_and_momentum_are_conserved(case: tuple[Chain, Excitation, float]) -> None:
    """Without a driver, energy is constant; the momentum changes by the impulse of the ends."""
    chain, excitation, duration = case
    t = run(chain, excitation, duration, 401, 1e-10)
    energy = ledger(t)
    assert largest(energy.drift) < 1e-9 * energy.total[0]
    assert not energy.drive.any()
    given = 0.5 * chain.masses @ t.velocity[0] ** 2
    assert energy.kinetic[0] == pytest.approx(given, rel=1e-14, abs=0)
    terms = energy.contact, energy.gravity, energy.load
    overlaps = contacts(t).overlap
    power = chain.exponent + 1
    elastic = (
        chain.contacts.constant[contacts(t).contact] / power * np.maximum(overlaps, 0.0) ** power
    )
    stored = elastic.sum(1)
    assert energy.contact - energy.contact[0] == pytest.approx(
        stored - stored[0], abs=1e-14 * largest(stored)
    )
    cancels = 1e-14 * sum(map(largest, terms))
    assert energy.kinetic + sum(terms) == pytest.approx(energy.total, rel=1e-9, abs=cancels)
    assert largest(energy.momentum_drift) < 1e-9 * largest(energy.momentum) + energy.impulse_error
    assert energy.impulse_error < 1e-4 * largest(energy.momentum)
    assert energy.impulse.any() == (chain.bottom != "free")


def test_a_single_spring_exchanges_its_energy() -> None:
    """A ball on a spring between walls: K = E cos^2, momentum m v cos, impulse m v (cos - 1)."""
    chain = column(2, exponent=1.0, gravity=3.0)
    omega = np.sqrt(chain.contact_constants[0] / chain.masses[0])
    t = run(chain, Impulse(velocity=1e-9), 10 / omega, 201, 1e-12)
    energy = ledger(t)
    swing = np.cos(omega * t.time)
    assert energy.kinetic == pytest.approx(energy.total[0] * swing**2, abs=1e-11 * energy.total[0])
    momentum = chain.masses[0] * 1e-9
    assert energy.momentum == pytest.approx(momentum * swing, abs=1e-11 * momentum)
    assert energy.impulse == pytest.approx(momentum * (swing - 1), abs=energy.impulse_error)
    assert 0 < energy.impulse_error < 1e-5 * momentum


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_a_lifted_grain_falls_freely(exponent: float) -> None:
    """An unsupported grain gains m g t, which the ledger adds as the missing support force."""
    chain = column(2, exponent=exponent)
    gap = 2 * chain.length_scale
    falls = np.sqrt(2 * gap / 9.81)
    t = run(chain, Displacement(displacement=-1.5 * gap), 0.9 * falls, 11, 1e-10)
    energy = ledger(t)
    gained = chain.masses[0] * 9.81 * t.time
    assert energy.impulse == pytest.approx(gained, rel=1e-13, abs=0)
    assert energy.momentum == pytest.approx(gained, rel=1e-9, abs=0)
    assert energy.contact == pytest.approx(np.full(11, energy.contact[0]), rel=1e-13, abs=0)
    assert energy.gravity - energy.gravity[0] == pytest.approx(
        -gained * 9.81 * t.time / 2, rel=1e-9, abs=0
    )


# --- driven chains

DRIVES = {
    "harmonic": Drive(amplitude=2e-9, frequency=1e5),
    "weak": Drive(amplitude=1e-17, frequency=1e5),
    "piston": Drive(times=[0, 4e-5], displacement=[0, 2e-8]),
    "sampled": Drive(
        times=np.linspace(0, 4e-5, 9),
        displacement=1e-8 * np.sin(np.linspace(0, 3, 9)) ** 2,
        interpolation="spline",
    ),
}


@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
def test_the_work_of_a_driver_closes_the_ledger(drive: Drive) -> None:
    """The residual falls with the fourth power of the interval, and is 1/15 of the estimate."""
    chain = column(20, top_load=1e-3)
    open_ends = []
    for samples in (129, 257, 513):
        energy = ledger(of_error(run(chain, drive, 4e-5, samples, 1e-12)))
        for drift, error, scale in [
            (energy.drift, energy.drive_error, energy.total),
            (energy.momentum_drift, energy.impulse_error, energy.momentum),
        ]:
            open_ends.append(largest(drift) / largest(scale))
            assert 1e-12 * largest(scale) + error / 10 > largest(drift)
    orders = np.log2(np.array(open_ends[:4]) / open_ends[2:])
    assert orders == pytest.approx(np.full(4, 4.0), abs=0.15)
    assert open_ends[4] < 1e-5


def test_a_driver_of_springs_does_the_work_of_theory() -> None:
    """The motion of grain 2 in an endless chain of springs is a convolution with 2 J_2(2 t) / t.

    Schroedinger, Annalen der Physik 44, 916 (1914), in units of sqrt(k/m); the integrals by Gauss
    and Legendre. Later the mean power is that of a running wave, k A^2 omega sin(q) / 2 with omega
    = 2 sqrt(k/m) sin(q/2).
    """
    chain = column(120, exponent=1.0, gravity=0.0, top_load=1e-3)
    k = chain.contact_constants[0]
    m = chain.masses[0]
    unit = chain.time_scale
    amplitude = 1e-12
    omega = 0.8
    drive = Drive(amplitude=amplitude, frequency=omega / unit / (2 * np.pi))
    period = 2 * np.pi / omega
    t = run(chain, drive, 14 * period * unit, 14 * 64 + 1, 1e-12)
    energy = ledger(t)
    tau = t.time / unit
    node, weight = np.polynomial.legendre.leggauss(160)

    def pull(time: np.ndarray) -> np.ndarray:
        """Return phi_1 - phi_2 in units of the amplitude, (n,) at times (n,)."""
        s = time[:, None] * (1 + node) / 2
        kernel = 2 * jv(2, 2 * s) / np.where(s > 0, s, 1.0)
        return np.sin(omega * time) - time / 2 * (
            (kernel * np.sin(omega * (time[:, None] - s))) @ weight
        )

    force = k * amplitude * pull(tau) - m * amplitude * (omega / unit) ** 2 * np.sin(omega * tau)
    assert drive_force(t) - 1e-3 == pytest.approx(force, abs=1e-9 * largest(force) + 1e-17)
    end = 4 * period
    s = end * (1 + node) / 2
    speed = amplitude * omega * np.cos(omega * s)
    # Grain 1 has the same speed as at t = 0.
    work = end / 2 * weight @ (k * amplitude * pull(s) * speed)
    at_end = energy.drive[4 * 64]
    assert at_end == pytest.approx(work, abs=energy.drive_error / 10)
    assert at_end == pytest.approx(work, rel=1e-5, abs=0)
    q = 2 * np.arcsin(omega / 2)
    power = (energy.drive[14 * 64] - energy.drive[4 * 64]) / (10 * period * unit)
    assert power == pytest.approx(k * amplitude**2 * omega / unit * np.sin(q) / 2, rel=3e-3, abs=0)


# --- the virial theorem


def test_energy_is_shared_5_to_4_between_walls() -> None:
    """The mean kinetic energy obeys the virial theorem.

    With G = sum m phi phi', K/E = (delta+1)/(delta+3) + [G(T) - G(0)] / ((delta+3) T E).
    """
    chain = vacuum(20, top="wall", bottom="wall")
    scene = struck(chain, 1.0, 400.0, 8001)
    # The motion is chaotic after 100, but the theorem holds for any motion.
    t = simulate(scene, engine=engines.Native(step=0.05))
    energy = ledger(t)
    g = (t.displacement * t.velocity).sum(1)
    for end in (100, 400):
        at = round(20 * end)
        finite = (g[at] - g[0]) / (4.5 * end * 0.5)
        assert energy.virial_ratio(end=end) == pytest.approx(5 / 9 + finite, abs=1e-7)
    assert energy.virial_ratio() == pytest.approx(5 / 9, abs=2e-3)


@pytest.mark.parametrize("exponent", [1.5, 2.0])
def test_energy_of_a_solitary_wave(exponent: float) -> None:
    """The time average of K/E is (delta+1)/(delta+3): Slepyan, arXiv:1410.8301."""
    struck = run(vacuum(70, exponent=exponent), Impulse(velocity=1.0), 70.0, 2, 1e-8)
    behind = int(struck.velocity[-1].argmax()) - 8
    u, v = (
        np.concatenate((x[-1, behind:], np.zeros(25)))
        for x in (struck.displacement, struck.velocity)
    )
    v[0] = 0.0
    t = run(vacuum(u.size, exponent=exponent), Profile(displacement=u, velocity=v), 24.0, 601, 1e-9)
    energy = ledger(t)
    passes = [arrival(t.time, t.velocity[:, n - 1]).time for n in (12, 22)]
    assert largest(energy.kinetic / energy.total - energy.virial_ratio(*passes)) > 1e-3, (
        "it breathes from grain to grain"
    )
    assert energy.virial_ratio(*passes) == pytest.approx((exponent + 1) / (exponent + 3), abs=1e-6)


def test_energy_of_a_chain_at_rest_is_zero() -> None:
    energy = ledger(run(COLUMN, Impulse(velocity=0.0), 1e-6, 5))
    assert not any(
        x.any()
        for x in (energy.total, energy.kinetic, energy.contact, energy.momentum, energy.impulse)
    )
    assert np.isnan(energy.virial_ratio())
    assert energy.plot().lines


# --- what was recorded


def test_two_samples_give_no_error_estimate() -> None:
    energy = ledger(of_error(run(COLUMN, DRIVES["piston"], 1e-6, 2)))
    assert energy.drive_error == energy.impulse_error == np.inf
    assert np.isfinite(energy.drive).all()
