"""The models of step and rounding errors.

What differences of runs say of it, what rounding makes of it, and how steps follow it.
"""

import math

import mpmath
import numba
import numpy as np
import pytest
from helpers.example_chains import column, random_column
from helpers.example_scenes import paper, scene_of, smooth, struck
from helpers.taylor_series import reference
from helpers.thinned import thinned
from helpers.whole_runs import blocks_of
from validation.random_trials import draw

from lmpchain import (
    Chain,
    Displacement,
    Drive,
    Impulse,
    Impurity,
    InputError,
    Law,
    engines,
    simulate,
)
from lmpchain.engines import Native
from lmpchain.engines.base import ErrorBudget
from lmpchain.engines.stepping.auxiliary_runs import LONGER, TRUST, estimate_truncation
from lmpchain.engines.stepping.rounding import (
    GROWTH,
    amplify_rounding,
    could_grow,
    perturb,
    rounded_energy,
)
from lmpchain.engines.stepping.step_choice import STEP_CONTROL
from lmpchain.stability.predictability import divergence
from lmpchain.trajectory.record import ErrorEstimate
from lmpchain.util.arrays import EPSILON


def differences(order: float, error: float, ratios=LONGER) -> np.ndarray:
    """Return the distances d12 and d24 of runs whose error has this order."""
    first, second = (error * ratio**order for ratio in ratios)
    return np.array([first - error, second - first])


@pytest.mark.parametrize("order", [2, 4, 6, 8])
def test_three_runs_give_twice_the_error(order: int):
    """The factor is exact if each step is twice the previous one.

    Else the gain follows from a rate that is not quite the order.
    """
    for seen in (order, 0.6 * order):
        told = estimate_truncation(differences(seen, 1e-7), LONGER, order)
        assert told == pytest.approx(2e-7, rel=1e-9)
    within = {2: 0.4, 4: 0.1, 6: 0.05, 8: 0.05}[order]
    for ratios in ((1.9, 3.7), (3.0, 6.0)):
        told = estimate_truncation(differences(order, 1e-7, ratios), ratios, order)
        assert 2e-7 * (1 - 1e-9) <= told <= 2e-7 * (1 + within)


def test_the_observed_rate_is_trusted_within_limits():
    """The rate is at most the order, because runs may agree by chance.

    Never less than one and a half times a doubling. An additional run confirms it.
    """
    fine, coarse = differences(4, 1e-7)
    for distances, nearby, expected in (
        ((fine, 1.001 * coarse), 0.0, 2e-7),
        # Only the coarse difference.
        ((fine / 100, coarse), 0.0, 1e-7),
        ((0.0, coarse), 0.0, 1e-7),
        ((1e-3, 0.0), 0.0, 4e-3),
        ((1e-3, 1.5e-3), 0.0, 4e-3),
        ((1e-3, 1.6e-3), 0.0, 2e-3 / 0.6),
        ((fine / 100, coarse), 1e-12, 2e-9),
        ((fine / 100, coarse), 1e-6, 2e-6),
        ((fine, coarse), 1e-8, 2e-7),
        ((1e-3, math.inf), 0.0, math.inf),
        ((math.inf, 1e-3), 0.0, math.inf),
    ):
        told = estimate_truncation(distances, LONGER, 4, nearby)
        assert told == pytest.approx(expected, rel=1e-9)
    flat = estimate_truncation((1e-3, 1e-3), (3.0, 6.0), 4)
    assert flat == pytest.approx(2e-3 / (1.5 ** np.log2(3) - 1), rel=1e-9)


@pytest.mark.parametrize(("fast", "slow"), [(1e-7, 0.0), (1e-8, 3e-8), (1e-9, 1e-5)])
def test_an_error_of_two_orders_is_estimated_from_both(fast: float, slow: float):
    """The observed rate alone underestimates the error, because h^6 hides h^2."""
    distances = differences(6, fast) + differences(2, slow)
    told = estimate_truncation(distances, LONGER, 6, slow_order=2)
    assert told == pytest.approx(2 * (fast + slow), rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "excitation"),
    [
        ({"exponent": 2.2, "load_grain": 2, "top_load": 1.0}, Impulse(velocity=0.1)),
        ({"exponent": 1.3}, Displacement(displacement=1e-7)),
        ({"exponent": 1.0}, Impulse(velocity=0.1)),
    ],
    ids=["striker", "touching grains are pushed", "springs in the vacuum"],
)
def test_errors_have_the_order_of_the_method_where_touching_grains_separate(changes, excitation):
    chain = Chain(**{"grains": 5, "diameter": 1e-3, "gravity": 0.0, "bottom": "wall"} | changes)
    scene = scene_of(chain, excitation, 1e-6, 2)
    scene = scene.replace(duration=30 / scene.highest_frequency)
    true, _ = reference(scene, 1e-17)
    engine = Native("rkn6")
    proposed = engine.propose(scene, 1e-6)
    errors = []
    for steps in (24, 192):
        run = engine.start([scene], proposed.with_steps(proposed.steps.sampled.shorten(steps)))
        motion = (x[0] for x in blocks_of(run))
        errors.append(true.error(*motion))
        assert errors[-1] <= run.errors()[0].solver
    assert errors[0] / errors[1] > 8**5.5


def test_two_runs_give_their_distance_unless_the_order_is_certain():
    """The order is certain if the force is smooth and the runs are close.

    A companion at half the step shows an order to nobody.
    """
    small = TRUST.settled
    for ratio, distance, settled, factor in (
        *((ratio, small, True, 2 / (ratio**6 - 1)) for ratio in (1.9, 2.0)),
        (2.0, 2 * small, True, 2),
        (2.0, small, False, 2),
        (0.5, small, True, 2),
        (2.0, math.inf, False, 2),
    ):
        told = estimate_truncation([distance], [ratio], 6, settled=settled)
        assert told == pytest.approx(factor * distance, rel=1e-12)


# --- rounding


@pytest.mark.slow
def test_thousands_of_periods_shift_the_phase_by_rounding(rng):
    """One ulp of mass, stiffness or step shifts the phase by the same relative amount.

    More than a walk of roundings makes.
    """
    for _ in range(2):
        stiffness, mass = (float(10 ** rng.uniform(low, high)) for low, high in ((6, 8), (-7, -4)))
        spring = {"masses": [mass, mass], "contact_constants": [stiffness], "exponent": 1.0}
        chain = column(2, gravity=0.0, top_load=10.0, **spring)
        periods = 4e3 + rng.random()
        scene = struck(chain, 1e-3, periods * 2 * np.pi / chain.band_edge, 2)
        t = simulate(scene, Native("rkn6", step=scene.duration / 1.2e6))
        shift = EPSILON * scene.chain.band_edge * scene.duration
        assert shift > 5 * EPSILON * math.sqrt(t.cost.force_evaluations)
        with mpmath.workdps(40):
            k, m = (mpmath.mpf(float(x[0])) for x in (chain.contact_constants, chain.masses))
            phase = mpmath.sqrt(k / m) * mpmath.mpf(scene.duration)
            exact = float(mpmath.sin(phase)), float(mpmath.cos(phase))
        found = t.displacement[-1, 0] * chain.band_edge / 1e-3, t.velocity[-1, 0] / 1e-3
        assert np.abs(np.subtract(found, exact)).max() <= t.error_estimate.solver
        assert shift < t.error_estimate.solver < 20 * shift


def test_the_loss_of_the_plain_force_is_in_the_estimate():
    """A weak wave under a large load.

    The last digit of the load at every step walks into the velocity.
    """
    ratios = []
    for grains in range(3, 9):
        chain = column(grains, gravity=0.0, top_load=1.0)
        strike = Impulse(velocity=1e-10 * chain.length_scale / chain.time_scale)
        scene = scene_of(chain, strike, 60 * chain.time_scale, 21)
        plain, exact = (
            simulate(scene, Native("rkn6", scene.duration / 2000, force=force))
            for force in ("plain", "exact")
        )
        lost = np.abs(plain.velocity - exact.velocity).max() / np.abs(exact.velocity).max()
        assert exact.error_estimate.solver < lost / 10
        ratios.append(lost / plain.error_estimate.solver)
    assert 0.3 < np.median(ratios) < 1.5
    assert max(ratios) < 3


def test_rounding_of_heights_adds_energy_to_contacts():
    """The added energy is half the stiffness times the squared rounding error of heights.

    The rounding error is a random walk of ulps of the chain's length. For springs this is exact.
    """
    chain = column(10, gravity=0.0, top_load=1.0, exponent=1.0)
    scene = scene_of(chain, Displacement(displacement=2e-5), 1e-5)
    digit = EPSILON * math.sqrt(1e4) * (10e-3 + 2e-5)
    expected = 0.5 * chain.contact_constants.sum() * digit**2
    assert rounded_energy(scene, 1e4) == pytest.approx(expected, rel=1e-9)


# --- runs from nearby initial states


def test_a_nearby_scene_differs_by_a_fraction_of_the_largest_motion():
    turns = np.array([1.0, -1.0, 1.0, -1.0, 0.0])  # The last grain is fixed.
    for excitation, moved, fast in (
        (Impulse(velocity=-2e-4, grain=2), 0.0, 2e-7),
        (Displacement(displacement=-3e-9, grain=2), 3e-12, 0.0),
    ):
        scene = scene_of(column(5), excitation, 1e-5, 5)
        u, v = np.subtract(perturb(scene, 1e-3).initial(), scene.initial())
        np.testing.assert_allclose([u, v], [moved * turns, fast * turns], rtol=1e-9, atol=0)
    driven = scene.replace(excitation=Drive(amplitude=1e-9, frequency=1e4))
    assert perturb(driven, 1e-3).excitation.amplitude == pytest.approx(1.001e-9, rel=1e-12)


def test_the_divergence_of_two_runs_is_relative_to_the_largest_motion():
    """The divergence is computed at all samples and for unrecorded grains as well."""
    scene = smooth(samples=6).replace(grains=[2])
    candidate = Native("rkn6").propose(scene.replace(grains="all"), 1e-10)
    apart = divergence(scene, candidate, 1e-4)
    whole = scene.replace(grains="all")
    dense = simulate(whole.replace(samples=501), "native", 1e-12)
    one, other = (simulate(each, "native", 1e-12) for each in (whole, perturb(whole, 1e-4)))
    expected = [
        np.abs(getattr(other, name) - getattr(one, name)).max(axis=1)
        / np.abs(getattr(dense, name)).max()
        for name in ("displacement", "velocity")
    ]
    np.testing.assert_allclose(apart, np.max(expected, axis=0), rtol=0.02, atol=0)
    assert apart[0] == pytest.approx(1e-4, rel=0.02)


def test_amplification_of_an_ulp_equals_that_of_a_small_change():
    """Contacts of this chain open again and again.

    Of a change that is a million times as large, a millionth.
    """
    chain = random_column(6, 2, 0.3, top="wall")
    scene = struck(chain, 0.1, 4e-4, 9)
    candidate = Native("rkn6").propose(scene, 1e-9)
    grown = amplify_rounding(scene, 1.0)
    near = [divergence(scene, candidate, change).max() / 1e-9 for change in (1e-9, -1e-9, 0.5e-9)]
    assert max(near) > 20
    assert max(near) / 10 < grown.max() / GROWTH.digit < 30 * max(near)
    assert grown[0] <= 1.01 * GROWTH.digit
    digits = EPSILON / GROWTH.digit * 1e3
    np.testing.assert_allclose(amplify_rounding(scene, 1e6), digits * grown, rtol=1e-12, atol=0)


def test_runs_that_break_down_show_no_growth():
    """The drive compresses contacts so strongly that shorter steps are needed for the growth."""
    scene, *_ = draw("native", 20865)
    # Two solutions of an independent integrator from states one ulp apart differ by 7e-9.
    assert 1e-9 < amplify_rounding(scene, 1.0).max() < 3e-8


def test_amplification_is_limited_by_the_phase():
    """The exponent is 0.06 per radian, and rounding accumulates."""
    scene = struck(column(6), 1e-3, 1e-3, 3)
    growth = math.exp(0.06 * scene.highest_frequency * scene.duration)
    assert could_grow(scene, 1.0) == pytest.approx(1e-15 * growth, rel=1e-9)
    assert could_grow(scene, 1e8) == pytest.approx(EPSILON * 1e4 * growth, rel=1e-9)
    # No scene amplifies more than exp(99); a ground may do so at any rate.
    grounded = scene.replace(chain=scene.chain.replace(ground=Law("s*u", s=1.0)))
    for each in (scene.replace(duration=10.0), grounded):
        assert could_grow(each, 1.0) == pytest.approx(1e-15 * math.exp(99), rel=1e-9)


# --- proposals, budgets and the next step


def test_the_parts_of_an_error_budget():
    budget = ErrorBudget(1e-6, 2e-7, 4.0, model=1e-5, model_bound=4e-5)
    for bound, total in ((4e-5, 4.12e-5), (0.0, 1.12e-5)):
        each = budget._replace(model_bound=bound)
        parts = (each.solver, each.total, each.bound)
        assert parts == pytest.approx((1.2e-6, 1.12e-5, total), rel=1e-12)
    assert budget.estimate == ErrorEstimate(1e-5, budget.solver)
    assert ErrorBudget(3.0, 1.0, 4.0, model=5.0).estimate == ErrorEstimate(2.0, 2.0)
    time = np.arange(4.0)
    assert budget.last_known(1e-9, time) == math.inf
    grown = budget._replace(amplified=np.array([0.0, 1e-7, 3e-7, 1e-3]))
    for tolerance, known in ((2e-7, 2.0), (3e-7, 3.0), (1e-3, math.inf)):
        assert grown.last_known(tolerance, time) == known


def test_the_next_step_aims_at_seven_tenths_of_the_tolerance_left_by_rounding():
    """The ratio of steps is 1.3 to 8, and rounding takes three quarters of the room at most."""
    for order, truncation, roundoff, ratio in (
        *((p, 2e-5, 2e-7, (2e-5 / (0.7 * 0.8e-6)) ** (1 / p)) for p in (2, 4, 6)),
        *((p, 5e-6, 0.89e-6, (5e-6 / (0.7 * 0.25e-6)) ** (1 / p)) for p in (2, 4, 6)),
        (6, 1.01e-6, 0.0, 1.3),
        (2, 0.1, 0.0, 8.0),
        (6, math.inf, 0.0, 8.0),
    ):
        found = STEP_CONTROL.ratio(ErrorBudget(truncation, roundoff, order), 1e-6)
        assert found == pytest.approx(ratio, rel=1e-9)
    assert STEP_CONTROL.ratio(None, 1e-6) == 8.0
    assert STEP_CONTROL.ratio(ErrorBudget(2e-5, 0.91e-6, 6), 1e-6) is None


def test_a_proposal_is_refined_to_the_steps_that_its_error_requires():
    engine = Native("rkn6")
    scene = smooth(samples=6)
    candidate = engine.propose(scene, 1e-9)
    missed = ErrorBudget(64 * 0.7e-9, 0.0, 6)
    better = engine.refine(candidate, missed, 1e-9)
    assert better.steps.per_landing == math.ceil(2 * candidate.steps.per_landing - 1e-9)
    total = better.step * better.steps.per_landing / better.steps.stride
    assert total == pytest.approx(scene.duration / 5, rel=1e-12)
    assert not better.steps.adaptive
    opened = missed._replace(order=2)
    assert engine.refine(candidate, opened, 1e-9).steps.adaptive
    assert not Native("rkn6", adaptive=False).refine(candidate, opened, 1e-9).steps.adaptive
    broken = engine.refine(candidate, None, 1e-9)
    assert broken.steps.stride == 1
    assert broken.step <= candidate.step / 8
    # Rounding of interpolated samples is avoided without interpolation.
    candidate = engine.propose(smooth(samples=1001), 1e-6)
    assert candidate.steps.stride > 1
    rounded = engine.refine(candidate, ErrorBudget(0.0, 1e-5, 6), 1e-6)
    assert rounded.steps.stride == 1
    assert engine.refine(rounded, ErrorBudget(0.0, 1e-5, 6), 1e-6) is None


# --- options


def test_options_of_the_native_engine_are_rejected_with_alternatives():
    for options, message in (
        *(({"threads": n}, "must be a whole number from 1") for n in (0, -1, 1.0, True, "two")),
        ({"force": "rough"}, r"must be auto \| exact \| plain \(got 'rough'\)"),
        *(({"step": h}, "must be a time above 0 s") for h in (0.0, -1e-9, math.inf, math.nan, "1")),
        ({"adaptive": 1}, "must be"),
    ):
        with pytest.raises(InputError, match=f"{next(iter(options))}: {message}"):
            Native(**options)
    assert Native(threads=2, step=1).options() == {
        "integrator": "auto", "step": 1, "threads": 2, "force": "auto", "adaptive": True,
    }  # fmt: skip
    for engine, options, message in (
        ("native", {"colour": 1}, "colour: .* native has no such option; it has integrator, step"),
        (Native(), {"step": 1e-7}, "step: belongs to the engine"),
        ("nativ", {}, "engine: must be"),
    ):
        with pytest.raises(InputError, match=message):
            engines.get(engine, **options)
    scene = smooth()
    assert Native().describe(scene, Native().propose(scene, 1e-6)) == {"numba": numba.__version__}


def test_runs_of_more_than_ten_years_are_rejected():
    scene = paper("weak", samples=3).replace(duration=1e12)
    with pytest.raises(InputError, match=r"duration: would take some \d.* years: shorten it"):
        Native().propose(scene, 1e-6)


@pytest.mark.parametrize("engine", ["native", "auto"])
def test_recording_only_fixed_grains_has_no_error(engine: str):
    """A scene that records fixed grains was once rejected because of rounding elsewhere."""
    chain = column(8)
    answer = simulate(struck(chain, 0.3, 2e-3, grains=[8]), engine, 1e-13)
    assert not answer.displacement.any()
    assert not answer.velocity.any()
    assert answer.error_estimate.solver == 0


@pytest.mark.parametrize("duration", [2e-4, 2.5e-4])
def test_rounding_is_measured_by_runs_with_the_steps_of_the_main_run(duration):
    """Random walk times growth can be hundreds of times too large."""
    chain = column(2, gravity=0, top="wall", bottom="wall")
    scene = struck(chain, 0.1, duration, 21)
    # Rounding errors are random and differ between versions of NumPy.
    tolerance = 1e-11 if duration == 2e-4 else 1e-10
    answer = simulate(scene, "native", tolerance)
    error = reference(scene, 1e-20)[0].error(answer.displacement, answer.velocity)
    assert error <= answer.error_estimate.solver <= tolerance
    assert amplify_rounding(scene, answer.cost.force_evaluations).max() > tolerance


@pytest.mark.parametrize(
    ("family", "seed"),
    thinned(
        [
            ("acted", 31887),
            ("acted", 30469),
            ("native", 40056),
            ("loose", 300634),
            ("loose", 301966),
        ],
        2,
    ),
)
def test_rounding_of_free_flights_is_measured_if_bounds_would_reject(family: str, seed: int):
    """The bounds were 5 to 20 times the true error, and rejected reachable tolerances."""
    scene, engine, tolerance, options = draw(family, seed)
    answer = simulate(scene, engine, tolerance, **options)
    error = reference(scene, 1e-20)[0].error(answer.displacement, answer.velocity)
    assert error <= answer.error_estimate.solver <= tolerance


@pytest.mark.parametrize(
    ("exponent", "integrator", "place", "steps"),
    [(1.5, "rkn6", 0, 1), (1.5, "rkn6", 5, 2), (1.5, "kahan-li6", 10, 1), (1.0, "rkn6", 7, 1)],
)
def test_the_opening_of_a_striker_within_a_step_is_in_the_estimate(
    exponent: float, integrator: str, place: int, steps: int
):
    """Errors scatter after the first opening; estimates were once 0.34 to 0.68 of the error."""
    chain = Chain(
        grains=6, material="steel", diameter=4.76e-3, gravity=0, top_load=2.38, load_grain=2,
        bottom="wall", exponent=exponent, impurity=[Impurity(grain=1, material="ptfe")],
    )  # fmt: skip
    duration = (1e-4 if exponent == 1.5 else 4e-5) * (1 + 0.03 * place)
    scene = struck(chain, 0.44, duration, 201)
    step = duration / 200 / steps * (1 + 1e-9)
    answer = simulate(scene, Native(integrator, step, adaptive=False))
    true = reference(scene, 1e-13)[0]
    assert true.events >= 2
    error = true.error(answer.displacement, answer.velocity)
    assert error < answer.error_estimate.solver < 100 * error


@pytest.mark.parametrize("steps", [5, 8])
def test_nearly_open_contacts_are_in_the_estimate_of_equal_steps(steps: int):
    """No contact opens, but the force is not smooth; an estimate was once 0.4 of the error."""
    chain = Chain(
        grains=3, material="steel", diameter=5e-3, gravity=0, top_load=2e-3, bottom="wall"
    )
    scene = struck(chain, 1.0, 1e-5, 3)
    scene = scene.replace(duration=7.5 / scene.highest_frequency)
    assert scene.largest_strain > 10
    step = scene.duration / 2 / steps * (1 + 1e-9)
    answer = simulate(scene, Native("rkn6", step, adaptive=False))
    error = reference(scene, 1e-13)[0].error(answer.displacement, answer.velocity)
    assert error < answer.error_estimate.solver < 100 * error
