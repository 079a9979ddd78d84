"""Breathers of every kind: closure by an independent integrator, and theoretical frequencies."""

from functools import cache

import numpy as np
import pytest
from helpers.independent_integrators import extended_reference
from helpers.oscillator_period import oscillator_period

from lmpchain import Chain, Material, orbits
from lmpchain.orbits import Orbit

LOADED = {"diameter": 1e-2, "gravity": 0.0, "top_load": 20.0}
WALLS = {"top": "wall", "bottom": "wall"}
RIGID = Material(density=1e3, youngs_modulus=1e30, poissons_ratio=0.0)
LIGHT = 1e-3
HEAVY = 3e-3


@cache
def gap() -> Orbit:
    """Return a bright breather in a dimer's gap: N. Boechler et al., PRL 104, 244302 (2010)."""
    masses = np.resize([HEAVY, LIGHT], 21)
    chain = Chain(grains=21, masses=masses, **LOADED, **WALLS)
    edge = np.sqrt(2 * stiffness(chain) / LIGHT)
    return orbits.breather(chain, 10, period=2 * np.pi / (0.985 * edge))


@cache
def surface() -> Orbit:
    """Return a breather at a light free end: G. Theocharis et al., PRE 82, 056604 (2010)."""
    chain = Chain(grains=20, masses=np.resize([LIGHT, HEAVY], 20), bottom="wall", **LOADED)
    return orbits.normal_mode(chain, 11, energy=2e-6)


@cache
def defect() -> Orbit:
    """Return a breather at a light grain among heavier ones, above their band.

    The breather is that of Theocharis et al., Phys. Rev. E 80, 066601 (2009).
    """
    masses = np.where(np.arange(21) == 10, LIGHT / 2, LIGHT)
    return orbits.normal_mode(Chain(grains=21, masses=masses, **LOADED, **WALLS), 21, energy=4e-6)


@cache
def dark(energy: float = 6.7e-4) -> Orbit:
    """Return a dark breather, a dip in a pi-mode: C. Chong et al., PRE 87, 042202 (2013).

    Rigid walls are mirrors, so the chain is the half of a ring.
    """
    rigid = {"top_material": RIGID, "bottom_material": RIGID}
    chain = Chain(grains=100, masses=np.full(100, LIGHT), **LOADED, **WALLS, **rigid)
    return orbits.normal_mode(chain, 99, energy=energy)


def strong() -> Orbit:
    """Return a dark breather with an almost free dip, so that derivatives are nearly singular."""
    return dark(5e-3)


def stiffness(chain: Chain) -> float:
    return float(chain.linear_stiffness[chain.grains // 2])


def share(orbit: Orbit) -> np.ndarray:
    """Return the fraction of the kinetic energy in every grain, averaged over a period."""
    held = orbit.chain.masses * orbit.motion()[2].std(0) ** 2
    return held / held.sum()


@pytest.mark.parametrize(
    "kind", [gap, surface, defect, dark, pytest.param(strong, marks=pytest.mark.slow)]
)
def test_a_breather_returns_after_a_period(kind):
    """The reference is a Taylor series in extended precision."""
    orbit = kind()
    u, v, error = extended_reference(orbit.scene(1, samples=9))
    assert error < 1e-14
    assert np.abs(u[-1] - orbit.displacement).max() < 1e-12 * orbit.amplitude
    fastest = np.abs(orbit.motion()[2]).max()
    assert np.abs(v[-1] - orbit.velocity).max() < 1e-12 * fastest


@pytest.mark.parametrize(
    ("kind", "low", "high", "limit", "grain"),
    [
        (gap, np.sqrt(2 / 3), np.sqrt(2), np.sqrt(2), 10),
        (surface, np.sqrt(2 / 3), np.sqrt(2), np.sqrt(4 / 3), 1),
        (defect, 2.0, np.inf, np.sqrt(4 / (0.5 * (2 - 0.5))), 11),
    ],
)
def test_bright_breathers_are_in_gaps_and_soften(
    kind, low: float, high: float, limit: float, grain: int
):
    """The frequency is between a band edge and the next edge or mode, as contacts soften.

    Bands of the dimer end at w^2 = 2K/M and 2K/m; that of the uniform chain at 4K/m. Linear modes
    at a light end have w^2 = K/m + K/M, at a grain of mass d among others of mass m w^2 = 4 K / (d
    (2 - d/m)). Units of sqrt(K/m).
    """
    orbit = kind()
    w = 2 * np.pi / orbit.period / np.sqrt(stiffness(orbit.chain) / LIGHT)
    assert low < w < min(high, limit)
    assert share(orbit).argmax() + 1 == grain
    assert 1 / (share(orbit) ** 2).sum() < 4


@pytest.mark.parametrize("kind", [pytest.param(surface, marks=pytest.mark.slow), defect])
def test_the_anticontinuous_limit_leads_to_the_same_breather(kind):
    orbit = kind()
    other = orbits.breather(orbit.chain, int(share(orbit).argmax()) + 1, orbit.period)
    assert other.energy == pytest.approx(orbit.energy, rel=1e-9)


def test_a_dark_breather_oscillates_with_its_background():
    """Far from the dip the motion is a pi-mode of that amplitude, with a frequency in the band."""
    orbit = dark()
    chain = orbit.chain
    swing = np.ptp(orbit.motion()[1], axis=0) / 2
    overlap = chain.contacts.overlap + chain.contacts.closer(orbit.displacement)
    # The overlap is smaller than at rest, because grains at the dip need more room.
    eps = overlap[10:12].mean()
    k = chain.contact_constants[0]
    assert 2 * np.pi / orbit.period < chain.band_edge
    background = oscillator_period(swing[0], k, eps, LIGHT, closing=2.0)
    assert background == pytest.approx(orbit.period, rel=1e-6)
    assert swing[49] < 0.1 * swing[0]
