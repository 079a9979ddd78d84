"""Solitary waves: published and independently computed numbers, and waves that travel unchanged."""

import numpy as np
import pytest

import lmpchain
from lmpchain.theory import soliton
from lmpchain.theory.soliton import Soliton, solve


@pytest.mark.parametrize(
    ("delta", "speed"), [(1.5, 0.9074700784), (2.0, 0.855251932), (3.0, 0.804760116)]
)
def test_speed_in_the_sonic_vacuum(delta: float, speed: float):
    """V = C v^((delta-1)/(delta+1)) for the exact lattice wave.

    Source: an independent Petviashvili iteration on Fourier series, and direct impacts. The long
    wave of Nesterenko is 0.78 % faster for Hertz.
    """
    for v in (1.0, 0.01):
        wave = solve(delta=delta, velocity=v)
        assert wave.speed / v ** ((delta - 1) / (delta + 1)) == pytest.approx(speed, abs=6e-10)
        assert float(wave.velocity(0.0)) == pytest.approx(v, rel=1e-12)
    if delta == 1.5:
        assert wave.speed / float(wave.force(0.0)) ** (1 / 6) == pytest.approx(
            0.9055157764, abs=1e-10
        )
        assert soliton.nesterenko_speed(0.01) / wave.speed == pytest.approx(1.0078, abs=1e-4)


def test_width_and_shape_in_the_sonic_vacuum():
    """FWHM 1.57914 grains, 1 % width 3.9459; Sen's fit of the displacement holds within 1e-3.

    Source: 3.96 and 13 % below cos^4 in the documentation of MOOSE; the digits by direct
    integration.
    """
    wave = solve(velocity=1.0)
    assert wave.width == pytest.approx(1.57914, abs=5e-6)
    assert 1 - wave.width / 1.8084 == pytest.approx(0.127, abs=5e-4)
    assert wave.velocity(3.9459 / 2) == pytest.approx(0.01, rel=2e-4)
    x = np.linspace(-3, 3, 61)
    assert wave.displacement(x) / wave.displacement(-9.0) == pytest.approx(
        soliton.sen_displacement(x), abs=3e-4
    )


@pytest.mark.parametrize("delta", [1.5, 2.0, 3.0])
def test_virial_share_of_kinetic_energy(delta: float):
    """The time mean of K / E is (delta + 1) / (delta + 3), 5/9 for Hertz's law.

    Source: Slepyan, arXiv:1410.8301.
    """
    wave = solve(delta=delta, velocity=1.0)
    x = np.linspace(-10, 10, 1281)[1:]
    assert (wave.velocity(x) ** 2 / 2).mean() * 20 / wave.energy == pytest.approx(
        (delta + 1) / (delta + 3), rel=1e-12
    )


def test_effective_mass():
    """P^2 / 2E is 1.304005 m for the lattice.

    Source: direct integration; 1.4 m in the literature is the continuum's.
    """
    wave = solve(velocity=3.0)
    assert wave.momentum**2 / (2 * wave.energy) == pytest.approx(1.304005, abs=5e-7)


@pytest.mark.parametrize(
    ("speed", "force", "overlap", "coste"),
    [
        (1.01, 1.18856858, 0.12206021, 3e-5),
        (1.05, 2.12584727, 0.65331158, 51e-5),
        (1.1, 3.76770634, 1.42131540, 150e-5),
        (2.0, 358.12577, 49.43016, None),
    ],
)
def test_under_a_load(speed: float, force: float, overlap: float, coste: float | None):
    """Largest force and overlap relative to rest, from an independent solver with residual 1e-14.

    The lattice is faster than Coste, Falcon and Fauve, Phys. Rev. E 56, 6104 (1997), by the share
    `coste`, a quoted number of thousandths of a percent.
    """
    wave = solve(speed=speed)
    found = float(wave.overlap(0.0))
    assert found == pytest.approx(overlap, rel=1e-7)
    assert (1 + found) ** 1.5 == pytest.approx(force, rel=1e-7)
    if coste:
        assert speed / soliton.coste_speed(force) - 1 == pytest.approx(coste, abs=0.6e-5)


def test_long_waves_compared_with_the_lattice():
    """Speed of the solitary wave from its velocity and its force, for any exponent.

    V = [2/(delta+1)]^(1/(delta+1)) v^((delta-1)/(delta+1)) and [2/(delta+1)]^(1/2) F^((delta-1)/(2
    delta)); cos^4.

    Source: Nesterenko as in Job et al. (2008), and Daraio et al., Phys. Rev. E 73, 026610 (2006),
    whose prefactors are the same number. FWHM 1.8084 and support 4.967 grains; the effective mass
    of the long wave is 1.419, the lattice's 1.304.
    """
    for delta in (1.5, 2.0, 3.0):
        prefactor = (2 / (delta + 1)) ** (1 / (delta + 1))
        speed = soliton.nesterenko_speed(0.3, delta)
        assert speed == pytest.approx(prefactor * 0.3 ** ((delta - 1) / (delta + 1)), rel=1e-12)
        force = float(soliton.nesterenko_overlap(0.0, speed, delta)) ** delta
        assert speed == pytest.approx(
            np.sqrt(2 / (delta + 1)) * force ** ((delta - 1) / (2 * delta)), rel=1e-12
        )
    assert soliton.nesterenko_speed(1.0) == pytest.approx(0.914610, abs=5e-7)
    assert np.sqrt(2 / 2.5) == pytest.approx(0.894427, abs=5e-7)
    x = np.linspace(-2.5, 2.5, 500_001)
    speed = float(soliton.nesterenko_speed(1.0))
    r = soliton.nesterenko_overlap(x, speed)
    assert np.ptp(x[r > 0]) == pytest.approx(4.967, abs=5e-4)
    assert np.ptp(x[r > r.max() / 2]) == pytest.approx(1.8084, abs=1e-4)
    momentum = (speed * r).sum() * 1e-5
    kinetic = ((speed * r) ** 2 / 2).sum() * 1e-5
    # 5/9 of the energy is kinetic.
    assert momentum**2 / (2 * 9 / 5 * kinetic) == pytest.approx(1.419, abs=5e-4)


@pytest.mark.parametrize(
    ("speed", "off", "digit"),
    [(1.2, 3.6e-3, 5e-5), (1.5, 8.01e-3, 5e-6), (100.0, 0.9055157764 / 0.8**0.5 - 1, 1e-9)],
)
def test_coste_formula_is_slower_than_the_lattice(speed: float, off: float, digit: float):
    """The relative differences agree to half of their last digit.

    The last is that of the strongest waves, from the speed V = 0.9055157764 F^(1/6) in the sonic
    vacuum by an independent solver, where Coste's is sqrt(4/5) F^(1/6). That solver quoted 0.81 %
    at 1.5; 0.80 % is right: a wave of this speed of ours travels a hundred grains in the native
    engine unchanged to 1e-10 (below).
    """
    force = float(1 + solve(speed=speed).overlap(0.0)) ** 1.5
    assert speed / soliton.coste_speed(force) - 1 == pytest.approx(off, abs=digit)


def test_limit_of_korteweg_and_de_vries():
    """To second order in w, c/c0 - 1 = (delta - 1) w / (6 r0); 1.001002 by another solver.

    c/c0 - 1 = (delta - 1) w / (6 r0) to 2e-6 at 1.001 (1.001002 in an independent solver), second
    order in w.
    """
    off = [
        speed - 1 - 0.5 * float(solve(speed=speed).overlap(0.0)) / 6 for speed in (1.001, 1.0005)
    ]
    assert off[0] == pytest.approx(-2e-6, abs=1e-6)
    assert off[0] / off[1] == pytest.approx(4, rel=0.05)


def changed(wave: Soliton, engine: str, tolerance: float) -> float:
    """Return the change of a wave over a hundred grains, relative to its largest values."""
    far = int(wave.reach) + 2
    load = 1.0 if wave.loaded else 0.0
    steel = {"diameter": 1e-3, "material": "steel", "gravity": 0.0, "exponent": wave.delta}
    chain = lmpchain.Chain(grains=100 + 2 * far, top_load=load, **steel)
    start = wave.on(chain, far)
    end = wave.on(chain, far + 100)
    unit = (
        chain.time_scale
        if load
        else (chain.masses[0] / chain.contact_constants[0]) ** (1 / (1 + wave.delta))
    )
    scene = lmpchain.Scene(
        chain=chain, excitation=start, duration=100 / wave.speed * unit, samples=2
    )
    t = lmpchain.simulate(scene, engine=engine, tolerance=tolerance)
    u, v = end.initial(chain)
    return max(
        np.abs(t.displacement[-1] - u).max() / u.max(), np.abs(t.velocity[-1] - v).max() / v.max()
    )


@pytest.mark.parametrize(
    "wave",
    [solve(speed=1.05), solve(speed=1.5), solve(velocity=0.1)],
    ids=lambda w: f"{w.speed:.2g}",
)
def test_travels_a_hundred_grains_unchanged(wave: Soliton):
    assert changed(wave, "native", 1e-10) < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("delta", [2.0, 3.0])
def test_travels_unchanged_for_other_exponents(delta: float):
    assert changed(solve(delta=delta, velocity=0.1), "native", 1e-9) < 1e-9
    assert changed(solve(delta=delta, speed=1.5), "native", 1e-9) < 1e-9


@pytest.mark.slow
def test_travels_in_lammps():
    """The rounding of heights in LAMMPS leaves an error of 1e-11.

    With grains drawn no larger than overlaps need.
    """
    for wave in (solve(speed=1.05), solve(speed=1.2), solve(velocity=0.1)):
        assert changed(wave, "lammps", 1e-9) < 3e-10
