"""Limits of validity of the theories.

Every law against what is measured, and its constants against other arithmetic.
"""

import numpy as np
import pytest
from helpers.convergence import slope
from helpers.example_scenes import paper, struck
from helpers.independent_integrators import extended_reference
from laws import theories
from laws.theory_errors import (
    bessel_error,
    column,
    continuum_error,
    far_field_error,
    fronts,
    harmonic_error,
    impulse_error,
    linear_error,
    local_error,
    phase_velocities,
    theory,
    uniform_error,
)

from lmpchain import Chain, Displacement, Impulse, InputError, Law
from lmpchain.engines.linear.engine import Chebyshev
from lmpchain.engines.linear.model_error import expected_error, passage
from lmpchain.stability import linear_theory
from lmpchain.stability.pre_run import hertz_excess
from lmpchain.stability.step_limit import limit
from lmpchain.theory import bessel, continuum, front

TAU = 14.555  # A time of 100 us at g.


def second_order(
    delta: float, tau: float, grains: int = 50, step: float = 0.02
) -> dict[str, float]:
    """Return the errors of Eq. (3) over v0* for v0* -> 0, from phi = v0* phi_1 + v0*^2 phi_2."""
    n = np.arange(1, grains)
    kappa = n ** (1 - 1 / delta)
    square = (delta - 1) / 2 * n ** (1 - 2 / delta)

    def pull(x):
        r = x[:, :-1] - x[:, 1:]
        force = kappa * r
        force[1] += square * r[0] ** 2
        return np.append(np.diff(-force, prepend=0.0), [[0.0], [0.0]], axis=1)

    x, v = np.zeros((2, 2, grains))
    v[0, 0] = 1
    largest = np.zeros((2, 2))
    for _ in range(round(tau / step)):
        a = pull(x)
        b = pull(x + step / 2 * v + step**2 / 8 * a)
        c = pull(x + step * v + step**2 / 2 * b)
        x = x + step * v + step**2 / 6 * (a + 2 * b)
        v = v + step / 6 * (a + 4 * b + c)
        largest = np.maximum(largest, np.abs([x, v]).max(2))
    displacement = largest[0, 1] / largest[0, 0]
    velocity = largest[1, 1]
    whole = np.linalg.norm(v[1]) / np.linalg.norm(v[0])
    return {
        "velocity": float(whole),
        "displacement": displacement,
        "package": max(displacement, velocity),
    }


@pytest.mark.parametrize("delta", [1.1, 1.2, 1.5, 2.0, 2.2])
def test_constants_of_linear_theory_agree_with_perturbation_theory(delta):
    exact = second_order(delta, TAU)
    for norm, value in exact.items():
        assert linear_theory.linear_law(1e-9, norm, delta) == pytest.approx(
            1e-9 * value, rel=0.1, abs=0
        )
        assert linear_error(column(1e-4, TAU, 50, delta))[norm] == pytest.approx(
            1e-4 * value, rel=5e-3, abs=0
        )


@pytest.mark.parametrize("norm", linear_theory.LINEAR)
@pytest.mark.parametrize("error", [0.01, 0.1])
def test_linear_theory_has_the_predicted_error(norm, error):
    """The error is compared at g after 100 us, when the wave has passed grain 19.

    1/6 and 6 times the gravity change nothing.
    """
    strike = linear_theory.strike_number_at(error, norm, grain=19)
    assert linear_theory.linear_law(strike, norm, grain=19) == pytest.approx(
        error, rel=1e-12, abs=0
    )
    assert linear_error(column(strike, TAU, 60))[norm] == pytest.approx(error, rel=0.06, abs=0)
    for gravity in (1.6, 60.0):
        assert linear_error(column(strike, TAU, 60, gravity=gravity))[norm] == pytest.approx(
            error, rel=0.06, abs=0
        )


def test_error_of_linear_theory_without_any_engine():
    """The exact series of Eq. (3) is compared with Taylor series for Eq. (1).

    (1), at the strike where the package's error is 1 %.
    """
    scene = column(linear_theory.strike_number_at(0.01, "package"), 6.0, 25)
    n = np.arange(1, 25)
    chain = scene.chain
    u, v, _ = extended_reference(scene)
    speed = scene.excitation.velocity
    tau = scene.time[:, None] / chain.time_scale
    kappa = n ** (1 / 3)
    phi = speed * chain.time_scale * bessel.finite_impulse(kappa, n, 1, tau)
    error = max(
        np.abs(phi - u[:, :-1]).max() / np.abs(u).max(),
        np.abs(speed * bessel.finite(kappa, n, 1, tau) - v[:, :-1]).max() / np.abs(v).max(),
    )
    assert error == pytest.approx(0.01, rel=0.06, abs=0)
    assert linear_error(scene)["package"] == pytest.approx(error, rel=1e-4, abs=0)


def test_error_of_linear_theory_over_several_reflections():
    """The law holds to 10 % from tau = 6 to the bottom, and to a factor of 2.1 for ten passages."""
    for tau in (6, 10, 20, 40):
        assert linear_error(column(1e-3, tau, 80))["velocity"] == pytest.approx(
            2.7e-4, rel=0.1, abs=0
        )
    once = continuum.chi(11.5)
    for passages in (1.5, 3, 10):
        found = linear_error(column(1e-3, passages * float(once), 12))
        for norm in ("velocity", "displacement", "package"):
            assert 1 / 2.1 < found[norm] / linear_theory.linear_law(1e-3, norm) < 2.1


def test_error_of_the_peak_decreases_with_depth():
    """The error scales with the power -3/2 of the front's width, which is -1/4 for Hertz."""
    taus = {
        delta: [float(continuum.chi(n + 4, delta)) for n in (12, 110)] for delta in (1.2, 1.5, 2.0)
    }
    for delta, ends in taus.items():
        power = 0.75 * (1 - 1 / delta) - 0.5
        found = []
        for tau in ends:
            scene = column(1e-3, tau, 140, delta)
            grain = int(max(front_grains(scene)))
            found.append((grain, linear_error(scene)["peak"]))
            law = linear_theory.linear_law(1e-3, "peak", delta, grain)
            assert found[-1][1] == pytest.approx(law, rel=0.08, abs=0)
        assert slope(*zip(*found, strict=True)) == pytest.approx(power, abs=0.05)


def front_grains(scene) -> np.ndarray:
    from lmpchain.measure.front import track

    return track(theory(scene, "chebyshev")).grain


def test_the_package_predicts_the_error_of_linear_theory():
    """The expectation from the strike, the evaluated bound and the estimate agree at g."""
    for strike in (1e-3, 1e-2, 0.1, 1.0, 8.48):
        scene = column(strike, TAU, 60)
        true = linear_error(scene)["package"]
        assert true < Chebyshev().look(scene).at_most <= expected_error(scene)
        assert true / 2 < theory(scene, "chebyshev").error_estimate.model < 2 * true


def test_recognition_of_a_struck_column():
    chain = Chain(grains=40, diameter=1e-3)
    scene = struck(chain, 1e-6, 5e-5)
    lasts = float(passage(scene).sum())
    hops = np.sqrt(chain.masses[:-1] / chain.linear_stiffness)
    assert lasts == pytest.approx(hops.sum(), rel=1e-12)
    assert linear_theory.struck_column(scene)
    assert linear_theory.struck_column(scene.replace(duration=9.99 * lasts))
    assert linear_theory.struck_column(scene.replace(chain=chain.replace(exponent=2.2)))
    others = [
        {"exponent": 2.21},
        {"gravity": 0.0, "top_load": 1e-3},
        {"top_load": 1e-6},
        {"top": "wall", "top_load": 1e-6},
        {"masses": chain.masses * np.linspace(1, 1.1, 40)},
        {"contact_constants": chain.contact_constants * np.linspace(1, 1.1, 39)},
        {"grains": 1, "bottom": "wall"},
    ]
    for other in (
        scene.replace(duration=10.01 * lasts),
        scene.replace(excitation=Impulse(velocity=1e-6, grain=2)),
        scene.replace(excitation=Displacement(displacement=1e-12)),
        *(scene.replace(chain=chain.replace(**changes)) for changes in others),
    ):
        assert not linear_theory.struck_column(other)


@pytest.mark.parametrize(
    ("name", "error"), [("fig5 10g", 0.28), ("fig5 g", 0.99), ("fig5 g/10", 1.44)]
)
def test_fig_5_is_beyond_linear_theory(name, error):
    scene = paper(name, 101)
    assert linear_error(scene)["velocity"] == pytest.approx(error, abs=0.01)
    assert scene.strike_number > 3 * linear_theory.strike_number_at(0.1, "velocity")


def test_the_strike_of_an_error_that_grows_with_its_square():
    """The force of the contacts is an odd function around rest, and linear for Hertz's law."""
    hertz = Chain(grains=20, diameter=1e-3, gravity=0.0, top_load=0.1)
    odd = hertz.replace(law=Law("k*o + c*(o - b)**3", k=1e6, c=1e18, b=1e-7))
    for chain, power in ((hertz, 1), (odd, 2)):
        scene = struck(chain, 1e-5, 3e-5)
        scene = scene.replace(excitation=Impulse(velocity=1e-5, grain=3))
        numbers = [linear_theory.strike_number_where(error, scene) for error in (1e-4, 1e-2)]
        assert numbers[1] / numbers[0] == pytest.approx(100 ** (1 / power), rel=0.3)
        for number, error in zip(numbers, (1e-4, 1e-2), strict=True):
            stronger = scene.excitation.scaled(number / scene.strike_number)
            found = Chebyshev().look(scene.replace(excitation=stronger).reached).error
            assert found == pytest.approx(error, rel=1e-6)


def test_numbers_outside_their_range_are_refused():
    law = linear_theory.linear_law
    inverse = linear_theory.strike_number_at
    scene = paper("weak", 3)
    vacuum = struck(Chain(grains=5, diameter=1e-3, gravity=0.0), 0.1, 1e-5)
    for call, message in (
        (lambda: law(-1.0, "velocity"), r"strike_number: must be 0 or more \(got -1\.0\)"),
        (lambda: law(np.nan, "velocity"), "strike_number: must be 0 or more"),
        (lambda: law("1", "velocity"), "strike_number: must be numbers, not text"),
        (lambda: law(1.0, "peak", grain=0), r"grain: must be 1 or more \(got 0\)"),
        (lambda: inverse(0.0, "velocity"), r"error: must be above 0 \(got 0\.0\)"),
        (lambda: inverse(-0.1, "velocity"), "error: must be above 0"),
        (lambda: linear_theory.strike_number_where(-0.1, scene), "error: must be above 0"),
        (
            lambda: linear_theory.strike_number_where(0.1, vacuum),
            "gravity: without gravity and load",
        ),
        (lambda: linear_theory.strike_number_where(0.1, None), "scene: must be a Scene"),
        (lambda: limit(scene, "euler"), r"integrator: must be verlet \| .* \(got 'euler'\)"),
        (lambda: theories.behind_front(10.0, 0.05), "error: must be one of"),
        *((lambda s=s: hertz_excess(s), "strain: must be between 0") for s in (0.0, -0.1, 1.0)),
    ):
        with pytest.raises(InputError, match=f"^{message}"):
            call()
    assert law(0.0, "peak", grain=1) == law(7.0, "velocity", 1.0) == 0
    # Linear theory of springs that stay closed is exact.
    assert inverse(1e-9, "velocity", 1.0) == np.inf


@pytest.mark.parametrize("level", [0.01, 0.1])
@pytest.mark.parametrize("grain", [100, 1000])
@pytest.mark.parametrize("width", [0.0, 3.0])
def test_the_homogeneous_chain_has_the_predicted_error(level, grain, width):
    gradient = 1 / (3 * grain)
    far = np.geomspace(1, 200, 400)
    foretold = far[np.argmax([theories.uniform_law(gradient, T, width) > level for T in far])]
    assert uniform_error(grain, foretold, width) == pytest.approx(level, rel=0.07, abs=0)
    if not width:
        assert theories.uniform_reach(level, gradient) == pytest.approx(foretold, rel=0.1, abs=0)


def test_fig_2_holds_for_ten_grains_at_most():
    for tau, error in {1: 0.0056, 5: 0.106, 10: 0.425, 12: 0.658}.items():
        travelled = tau * 50 ** (1 / 6)
        assert uniform_error(50, travelled) == pytest.approx(error, rel=0.01, abs=0)
        assert theories.uniform_law(1 / 150, travelled) == pytest.approx(error, rel=0.02, abs=0)


@pytest.mark.parametrize("load", [0, 10, 1000])
def test_bessel_solutions_have_the_predicted_error(load):
    compared = 0
    for tau in (0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0):
        contrast, error = bessel_error(load, tau)
        if error < 0.1:
            compared += 1
            assert theories.bessel_law(contrast, tau) == pytest.approx(error, rel=0.4, abs=0)
    assert compared >= 4


def test_bessel_at_early_times():
    taus = np.array([0.1, 0.14, 0.2])
    found = [bessel_error(0, tau) for tau in taus]
    assert slope(taus, [error for _, error in found]) == pytest.approx(4, abs=0.05)
    assert found[0][0] == pytest.approx(2 ** (1 / 3) - 1, rel=1e-9)
    assert found[0][1] == pytest.approx(found[0][0] * 1e-4 / 24, rel=0.01, abs=0)


def test_eqs_7_and_8():
    """Eq. (7) is off by a third of the wave or more at any time.

    (8) tends to it as n^2 / tau.
    """
    assert min(local_error(tau) for tau in (1.0, 4.0, 10.0, 30.0)) > 0.33
    for grain in (1, 3, 10):
        late = 16 * grain**2 / (16 * grain ** (1 / 6) * 0.01)
        assert far_field_error(grain, late) == pytest.approx(
            theories.far_field_law(grain, late), rel=0.05, abs=0
        )


@pytest.mark.parametrize("level", [0.01, 0.1])
def test_the_continuum_has_the_predicted_error(level):
    """Widths agree to 12 % and errors to 35 %, better at later times."""
    off = []
    for tau in (10.0, 100.0):
        width = float(continuum.chi(theories.continuum_width(level, tau)))
        assert theories.continuum_law(width, tau) == pytest.approx(level, rel=1e-9, abs=0)
        (found,) = continuum_error(width, np.array([tau]))
        off.append(1 - found / level)
    assert 0 < off[1] < off[0] < 0.35
    assert off[1] < 0.16


def test_continuum_over_width():
    """The error decreases as the third power of the width in time, also for other exponents."""
    widths = np.array([4.0, 5.0, 6.5])
    for delta in (1.2, 1.5):
        errors = [continuum_error(s, np.array([60.0]), delta)[0] for s in widths]
        assert slope(widths, errors) == pytest.approx(-3, abs=0.05)
        assert errors[0] == pytest.approx(
            theories.continuum_law(widths[0], 60.0, delta), rel=0.12, abs=0
        )


def test_the_impulse_response_agrees_with_the_chain_behind_the_front():
    for tau in (30.0, 100.0, 300.0):
        _, h, off = impulse_error(tau)
        for error, tail in theories.SLOWEST_TAIL.items():
            behind = theories.behind_front(h, error)
            assert off[-1][behind < tau].max() < error
            assert off[-1][(behind >= tau) & (behind - 0.4 * tail * h**0.25 < tau)].max() > error
        assert np.nanmax(off[-1]) > 0.3  # It is infinite at the front.


def test_dispersion():
    """The error of phase velocities is 1 % below 12.8 grains and 10 % below 4 for a driven top."""
    for frequency in (1.0, 1.5, 2.4):
        wavelength, ratio = phase_velocities(frequency)
        deep = wavelength > 3
        assert ratio[deep] == pytest.approx(
            theories.phase_velocity(wavelength[deep]), rel=1e-3, abs=0
        )
    assert theories.phase_velocity([12.82, 3.994]) == pytest.approx([0.99, 0.9], abs=1e-4)


def test_a_driven_wave_gets_out_of_phase():
    for frequency in (0.3, 0.5, 0.7):
        h, error = harmonic_error(frequency, 250.0)
        law = theories.harmonic_law(frequency, h)
        assert h.size > 20
        assert np.ptp(error) == pytest.approx(np.ptp(law), rel=0.05, abs=0)
        assert (error < law).all()
        assert error == pytest.approx(law, abs=0.035, rel=0)


def test_light_cone_and_width_of_the_front():
    """The arrival is (6/5) h^(5/6), not n^(5/6), which is a sixth too early; width is h^(1/6)."""
    grain, arrival, width = fronts(300.0)
    deep = (grain > 200) & np.isfinite(width)
    h = grain[deep] - 0.5
    assert arrival[deep] == pytest.approx(front.peak_time(grain[deep]), rel=2e-3, abs=0)
    assert slope(h, arrival[deep]) == pytest.approx(5 / 6, abs=0.05)
    assert slope(h, width[deep]) == pytest.approx(1 / 6, abs=0.05)
    assert width[deep][-1] == pytest.approx(1.4077 * h[-1] ** (1 / 6), rel=0.02, abs=0)
    assert (grain[deep] ** (5 / 6) / arrival[deep]).max() < 0.84
