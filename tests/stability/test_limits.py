"""Limits of scenes, theories and engines.

The laws of `stability.limits` against what is measured, and closed forms.
"""

from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from helpers.convergence import slope
from helpers.thinned import thinned
from laws import limits

from lmpchain import Chain, Impulse, InputError, Profile, RunFailed, Scene, simulate
from lmpchain.chain.bounds import LIMITS
from lmpchain.stability.linear_theory import linear_law
from lmpchain.stability.pre_run import deepest
from lmpchain.theory import bessel, dyson


@pytest.mark.parametrize("exponent", [1.5, 2.0])
@pytest.mark.parametrize("load", [0.0, 1e-3])
def test_solutions_converge_in_the_limit_of_no_gravity(exponent: float, load: float):
    gravity = np.logspace(-8, -4, 3)
    found = limits.from_vacuum(gravity, exponent, load)
    assert slope(gravity, found) == pytest.approx(limits.vacuum_power(exponent, load > 0), abs=0.05)


def law(scene: Scene) -> float:
    """Return the expected error of linear theory."""
    return linear_law(scene.strike_number, "package", scene.chain.exponent)


def test_linear_theory_becomes_invalid_without_gravity():
    gravity = np.logspace(-2, 3, 6)
    scenes = [limits.weak(1.5, float(g), 1e-5) for g in gravity]
    found, theory = (np.array([f(scene) for scene in scenes]) for f in (limits.from_linear, law))
    gentle = theory < 0.03
    assert slope(gravity[gentle], found[gentle]) == pytest.approx(-5 / 6, abs=0.05)
    assert found[gentle] == pytest.approx(theory[gentle], rel=0.05, abs=0)
    assert found[0] > 0.5


def test_hertz_becomes_springs():
    excess = np.array([1e-4, 1e-3, 1e-2])
    scenes = [limits.weak(1 + float(x)) for x in excess]
    springs = [limits.from_springs(scene) for scene in scenes]
    assert slope(excess, np.array(springs)) == pytest.approx(1, abs=0.05)
    assert springs == pytest.approx(limits.springs_error(30, excess), rel=0.05, abs=0)
    assert [limits.from_linear(s) for s in scenes] == pytest.approx(
        [law(s) for s in scenes], rel=0.05, abs=0
    )


@pytest.mark.parametrize("grains", [2, 3])
@pytest.mark.parametrize("number", [1e-3, 0.3, 5.0, 100.0])
def test_two_and_three_grains_oscillate_with_the_exact_period(grains: int, number: float):
    scene = limits.swinging(grains, number)
    assert limits.measured_period(scene) == pytest.approx(scene.duration, rel=1e-10, abs=0)
    end = simulate(scene, "native", 1e-9)
    assert end.velocity[-1] == pytest.approx(
        end.velocity[0], rel=1e-7, abs=1e-9 * np.abs(end.velocity[0]).max()
    )


def test_periods_in_closed_form():
    """A gentle oscillator.

    A bead that bounces, which flies for 2 v/g and touches for 2.87 (m / (k v^(1/2)))^(2/5).
    """
    gentle = limits.swinging(2, 1e-5)
    assert gentle.duration == pytest.approx(2 * np.pi / gentle.chain.band_edge, rel=1e-10, abs=0)
    hard = limits.swinging(2, 1e4)
    chain = hard.chain
    v = hard.initial()[1][0]
    touch = 3.218065 * (chain.masses[0] ** 2 / (chain.contact_constants[0] ** 2 * v)) ** 0.2
    assert hard.duration == pytest.approx(2 * v / chain.gravity + touch, rel=1e-6, abs=0)


def test_three_free_grains_separate_as_in_closed_form():
    """The outer two hit the middle one from both sides.

    Each is as on a wall of its own, and goes back as it came.
    """
    chain = Chain(grains=3, diameter=1e-3, gravity=0.0, bottom="free")
    v = 1e-2
    touch = 3.218065 * (chain.masses[0] ** 2 / (chain.contact_constants[0] ** 2 * v)) ** 0.2
    for part, still in ((0.9999, False), (1.0001, True)):
        scene = Scene(
            chain=chain, excitation=Profile(velocity=[v, 0, -v]), duration=part * touch, samples=3
        )
        end = simulate(scene, "native", 1e-10)
        assert (end.displacement[-1, 0] <= 0) == still
    assert end.velocity[-1] == pytest.approx([-v, 0, v], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("strain", thinned([0.0999, 1e-5], 2))
def test_overlaps_are_bounded_and_both_engines_agree(strain: float):
    scene = limits.squeezing(strain)
    found, apart = limits.squeezed(scene)
    assert found <= deepest(scene) < 1.2 * found
    assert apart < 1e-6


def test_a_tenth_of_the_diameter_is_rejected_at_first_but_not_later():
    """A taper squeezes its last grains more than the first, which is allowed within the bound."""
    with pytest.raises(
        InputError, match=r"squeezes contact 1 to 0.1 of the diameter, more than 0.1"
    ):
        limits.squeezing(1.001 * LIMITS.compression)
    chain = Chain(grains=8, diameter=np.linspace(10e-3, 1e-3, 8))
    scene = Scene(chain=chain, excitation=Impulse(velocity=50.0), duration=1e-4, samples=501)
    contacts = chain.contacts
    t = simulate(scene, "native", 1e-4)
    found = ((contacts.overlap + contacts.closer(t.displacement)) / chain.contact_lengths)[
        :, contacts.exists
    ].max()
    assert LIMITS.compression < found < deepest(scene)


def test_bends_grow_in_lammps_because_the_column_is_unstable():
    """Growth rates scale as d^(-1/2), and are equal for all small bends."""
    chain = Chain(grains=12, diameter=1e-3)
    gauges = np.array([1e-6, 1e-5, 1e-4])
    law = [float(limits.buckling(chain, float(d)).frequency[-1]) for d in gauges]
    found = [limits.growth(chain, float(d)) for d in gauges]
    assert found == pytest.approx(law, rel=1e-5, abs=0)
    assert slope(gauges, np.array(found)) == pytest.approx(-0.5, abs=0.05)
    assert [limits.growth(chain, 1e-5, x) for x in (1e-18, 1e-12)] == pytest.approx(
        [law[1]] * 2, rel=1e-4, abs=0
    )
    alike = Chain(grains=200, diameter=1e-3, gravity=0.0, top_load=1e-3)
    most = 2 * np.sqrt(alike.top_load / alike.masses[0] / (1e-3 - alike.length_scale))
    assert limits.buckling(alike).frequency[-1] == pytest.approx(most, rel=1e-4, abs=0)


@pytest.mark.parametrize("diameter", ["physical", "gauge"])
def test_the_engine_keeps_to_the_axis_and_detects_the_smallest_bend(diameter: str, tmp_path: Path):
    """No sideways force acts, so that a straight column stays straight to the last bit.

    A bend of 1e-18 m is an error.
    """
    chain = Chain(grains=20, diameter=1e-3)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-4), duration=2e-4, samples=5)
    options = {"integrator": "verlet", "step": 1e-7, "diameter": diameter}
    simulate(scene, "lammps", **options)
    (tmp_path / "bend").write_text("set atom 10 x 1e-18\n")
    with pytest.raises(RunFailed, match="buckled sideways"):
        simulate(scene, "lammps", **options, include=tmp_path / "bend")


@pytest.mark.parametrize("m", [1.0, 10.0, 143.0, 1e3, 1e6, 1e12])
def test_dysons_weight_is_as_accurate_as_its_argument(m: float):
    kappa = 1 + np.array([-0.9, -0.3, 0.0, 0.7, 2.0, 5.0]) / np.sqrt(m)
    with mp.workdps(60):
        true = [
            mp.exp(m * mp.log(m) - mp.loggamma(m) + m * mp.log(k) - m * k)
            for k in map(mp.mpf, kappa.tolist())
        ]
        off = [
            float(abs(f / t - 1))
            for f, t in zip(dyson.weight(kappa, m).tolist(), true, strict=True)
        ]
    assert (np.array(off) <= 2 * limits.dyson_rounding(kappa, m)).all()


def test_dysons_weight_as_printed_overflows():
    with np.errstate(over="ignore"):
        most, beyond = (np.float64(m) ** m for m in (limits.MOST_PRINTED, limits.MOST_PRINTED + 1))
    assert np.isfinite(most)
    assert np.isinf(beyond)


def test_bessel_functions_of_large_order():
    n = np.array([10**3, 10**4, 10**5, 10**6, 10**8])
    off = np.abs(bessel.free_end(n, n - 0.5) / limits.front_of_springs(n) - 1)
    assert (off <= limits.bessel_rounding(n)).all()
    with mp.workdps(30):
        true = float(2 * mp.besselj(1999, 1999))
    assert limits.front_of_springs(1000) == pytest.approx(true, rel=1e-14, abs=0)
