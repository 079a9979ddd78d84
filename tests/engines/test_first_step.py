"""The first step of a run, auxiliary runs, and scenes that amplify rounding."""

import math
from itertools import pairwise

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import paper, scene_of, stirred, struck
from helpers.independent_integrators import distance, extended_reference
from helpers.taylor_series import reference as taylor

from lmpchain import (
    Chain,
    Displacement,
    Force,
    Impulse,
    ToleranceNotMet,
    resume,
    simulate,
    simulate_many,
)
from lmpchain.engines import Native
from lmpchain.engines.stepping import step_choice
from lmpchain.engines.stepping.auxiliary_runs import OPENINGS, AuxiliarySteps, recurs
from lmpchain.engines.stepping.step_choice import FIRST_STEP, choose_step, expected_reach, land
from lmpchain.integrators.methods import METHODS

VACUUM = struck(column(20, gravity=0.0, bottom="wall"), 0.1, 1e-4, 6)
RKN6 = METHODS["rkn6"]


@pytest.mark.parametrize("name", ["rkn4", "rkn6", "kahan-li8"])
def test_the_step_follows_from_error_constant_order_and_tolerance(name):
    """C (omega h)^p for 60 radians is half of the tolerance.

    For ten times the time it is ten times as large.
    """
    method = METHODS[name]
    weak = paper("weak", samples=3)
    radians = weak.highest_frequency * weak.duration
    weak = weak.replace(duration=weak.duration * 60 / radians)
    for scene, periods in ((weak, 1.0), (weak.replace(duration=10 * weak.duration), 10.0)):
        for tolerance in (1e-9, 1e-12):
            reach = expected_reach(scene, method, tolerance, adaptive=False)
            error = periods * method.error_constant * reach**method.order
            assert error == pytest.approx(tolerance / 2, rel=1e-6)
    assert expected_reach(weak, method, 1.0, False) == pytest.approx(
        min(method.stability_limit, math.pi) / 2, rel=1e-12
    )


def test_openings_increase_errors_and_shorten_steps():
    """The factor is the root of the strain, from 4 to 23, and 30 for equal steps.

    In a damped chain, it is proportional to the strain.
    """
    for strain, factor, damped in (
        (0.3, 1.0, 1.0), (0.31, 4.0, 60.0), (3.0, 4.0, 60.0), (6.0, 32**0.5, 120.0),
        (12.0, 8.0, 240.0), (1e9, 23.0, 1400.0), (math.inf, 23.0, 1400.0),
    ):  # fmt: skip
        assert FIRST_STEP.opening_factor(strain, adaptive=True) == pytest.approx(factor, rel=1e-9)
        assert FIRST_STEP.opening_factor(strain, True, True) == pytest.approx(damped, rel=1e-9)
        for chain in (False, True):
            assert FIRST_STEP.opening_factor(strain, False, chain) == (30.0 if strain > 0.3 else 1)
    strong = struck(column(120), 1e-2, 1e-4, 21)
    ratio = expected_reach(strong, RKN6, 1e-12, True) / expected_reach(strong, RKN6, 1e-12, False)
    factor = FIRST_STEP.opening_factor(strong.largest_strain, True)
    assert ratio == pytest.approx((30 / factor) ** (1 / 6), rel=1e-9)


def test_cost_never_falls_as_the_tolerance_falls():
    """The steps meet the tolerance in weak, strong and unbounded scenes, with any sample count.

    The work of the first attempt.
    """
    for scene in (
        paper("weak"),
        paper("fig1"),
        VACUUM,
        struck(column(120), 8.57e-4, 1e-4, 21),
        struck(column(120), 8.57e-4, 1e-4, 301),
    ):
        work = []
        for tolerance in 10.0 ** -np.arange(1, 12.6, 0.25):
            methods = METHODS["rkn4"], METHODS["rkn6"]
            work.append(
                min(step_choice.work(m, choose_step(scene, m, tolerance, True)) for m in methods)
            )
        assert all(later >= 0.999 * earlier for earlier, later in pairwise(work))


def test_unbounded_scenes_find_the_step_by_the_first_attempt(tmp_path):
    """Tolerances below 1e-6 start with the step of 1e-6.

    The answer is the same however it was asked for.
    """
    engine = Native("rkn6")
    strong = struck(column(120), 1e-2, 1e-4, 21)
    for scene, shorter in ((VACUUM, False), (strong, True)):
        steps = [engine.propose(scene, tolerance).step for tolerance in (1e-6, 1e-9)]
        assert (steps[1] < steps[0]) == shorter
    truth = extended_reference(VACUUM)
    for tolerance in (1e-6, 1e-9):
        answer = simulate(VACUUM, "native", tolerance)
        error = distance(answer, truth)
        assert error / 3 < answer.error_estimate.total <= tolerance
        folder = tmp_path / f"{tolerance}"
        others = simulate_many([VACUUM, VACUUM], tolerance)
        for other in (*others, simulate(VACUUM, "native", tolerance, folder=folder)):
            assert np.array_equal(other.velocity, answer.velocity)
            assert other.error_estimate == answer.error_estimate
        assert np.array_equal(resume(folder).velocity, answer.velocity)


def test_auxiliary_runs_have_steps_twice_and_four_times_as_long():
    """The steps must be stable; openings with reflections need one more run."""
    weak = struck(column(120), 1e-6, 1e-4, 21)
    strong = struck(column(120), 1e-2, 1e-4, 21)
    returning = strong.replace(chain=column(20), duration=2e-3)
    assert returning.highest_frequency * returning.duration > OPENINGS.returning * 20
    springs = strong.replace(chain=column(20, exponent=1.0))
    striker = strong.chain.replace(gravity=0.0, top_load=1.0, load_grain=2)
    for scene, tolerance, adaptive, ratios in (
        (weak, 1e-10, True, [2, 4]),
        (weak, 1e-2, True, [2]),
        (strong, 1e-10, True, [2, 4]),
        (returning, 1e-10, True, [2, 4, 1.5]),
        (returning, 1e-10, False, [2, 4]),
        (springs, 1e-10, True, [2, 4, 1.75]),
        # Contacts that only touch open and close from the beginning.
        (VACUUM, 1e-10, True, [2, 4, 1.5]),
        (strong.replace(chain=striker), 1e-10, True, [2, 4, 1.5]),
    ):
        steps = Native("rkn6", adaptive=adaptive).propose(scene, tolerance).steps
        schedules = AuxiliarySteps(RKN6, [scene], steps).schedules
        assert [schedule.ratio for schedule in schedules] == ratios


def test_the_trusted_order():
    """The order of the method is trusted if no contact opens.

    Six, four if coarse, and two at equal steps.
    """
    strong = struck(column(120), 1e-2, 1e-4, 21)
    steps = Native("kahan-li8").propose(strong, 1e-10).steps
    assert steps.adaptive
    equal = {"adaptive": False}
    for name, opens, smooth, changes, order in (
        ("kahan-li8", False, True, {}, 8),
        ("kahan-li8", True, True, {"coarse_openings": False}, 6),
        ("kahan-li8", True, True, {"coarse_openings": True}, 4),
        ("kahan-li8", True, True, equal, 2),
        ("kahan-li8", False, True, equal, 8),
        ("kahan-li8", False, False, equal, 2),
        ("verlet", True, True, equal, 2),
    ):
        companions = AuxiliarySteps(METHODS[name], [strong], steps._replace(**changes))
        assert companions.order(opens, smooth) == order


def test_estimates_of_smooth_runs_are_close_upper_bounds():
    scene = struck(column(20), 1e-6, 1e-4, 11)
    truth = extended_reference(scene)
    for tolerance in (1e-6, 1e-8, 1e-10):
        answer = simulate(scene, Native("rkn6"), tolerance)
        error = distance(answer, truth)
        assert error < answer.error_estimate.total < 4 * error


def test_the_longest_steps_of_auxiliary_runs_fit_between_two_kinks():
    """If all runs had equal steps between two kinks, an error of 5e-11 would seem 1e-12."""
    times = np.linspace(0, 7e-5, 15)
    push = Force(times=times, force=-2e-3 * np.cos(np.arange(15) ** 1.2), grain=1)
    half_sine = Force(shape="half-sine", amplitude=1e-3, duration=5e-6)
    for excitation, spacing in ((push, 5e-6), (half_sine, 5e-6)):
        scene = scene_of(VACUUM.chain, excitation, 6e-5, 2)
        candidate = Native("rkn6").propose(scene, 1e-3)
        assert candidate.steps.adaptive
        assert 4 * candidate.step <= spacing * (1 + 1e-9)
        schedules = AuxiliarySteps(RKN6, [scene], candidate.steps).schedules
        assert {2, 4} <= {schedule.ratio for schedule in schedules}


def test_chaotic_scenes_are_rejected_with_the_predictability_horizon(rng):
    """The scene can be solved if it is recorded up to this time."""
    chain = Chain(grains=6, diameter=1e-3 * rng.uniform(0.7, 1.3, 6), gravity=9.81, top="wall")
    scene = struck(chain, 0.3, 2e-3, 101)
    with pytest.raises(ToleranceNotMet, match="amplifies round-off") as refusal:
        simulate(scene, "native", 1e-7)
    assert refusal.value.trajectory.cost.step_s > Native().propose(scene, 1e-7).step / 20
    known_s = float(refusal.value.reason.split("at t = ")[1].split(" s;")[0])
    assert 2e-4 < known_s < 1.9e-3
    samples = int(100 * known_s / scene.duration) - 4
    shorter = scene.replace(duration=samples * scene.duration / 100, samples=samples + 1)
    assert simulate(shorter, "native", 1e-7).error_estimate.total <= 1e-7


def test_landings_are_at_least_eight_steps_apart():
    """Landings are at multiples of four samples, where blocks end, or at the last sample."""
    many = struck(column(120), 1e-6, 1e-4, 2001)
    for rate in (0.03, 0.1, 0.34, 0.7, 1.9):
        steps, stride = land(many, rate)
        assert stride % 4 == 0
        assert rate * stride <= steps < rate * stride + 1
        assert steps >= 8
        assert (stride - 4) * rate < 8
    assert land(many.replace(samples=6), 0.1) == (1, 5)


def test_motion_of_many_grains_opens_contacts_without_a_reflection():
    """An error of 2.1e-11 was once estimated as 7.1e-12, as for a wave from one grain."""
    chain = column(60, gravity=9.81)
    start = stirred(chain, 0.1, seed=8, last=20)
    scene = scene_of(chain, start, 1e-4, 4)
    assert scene.highest_frequency * scene.duration < OPENINGS.returning * 60
    assert recurs(scene)
    assert not recurs(scene.replace(excitation=Impulse(velocity=0.1)))
    answer = simulate(scene, "native", 1e-9)
    error = taylor(scene, 1e-17)[0].error(answer.displacement, answer.velocity)
    assert error <= answer.error_estimate.solver <= 1e-9


@pytest.mark.slow
def test_a_wave_returns_from_the_nearer_end():
    """An error of 5.8e-12 was once estimated as 3.0e-12; the wall is 14 grains away, not 40."""
    diameters = np.random.default_rng(7).uniform(0.025, 0.045, 40)
    chain = Chain(
        grains=40, diameter=diameters, material="tungsten_carbide", bottom="wall", gravity=19.0
    )
    strike = Impulse(grain=26, velocity=-4.3)
    scene = scene_of(chain, strike, 2e-3, 400)
    angle = scene.highest_frequency * scene.duration
    assert 14 < angle / OPENINGS.returning < 40
    assert recurs(scene)
    assert not recurs(scene.replace(excitation=Impulse(velocity=4.3)))
    with pytest.warns(UserWarning, match="above the tolerance of 5e-12"):
        answer = simulate(scene, "native", 5e-12, on_miss="warn")
    error = taylor(scene, 1e-19)[0].error(answer.displacement, answer.velocity)
    assert error <= answer.error_estimate.solver


@pytest.mark.parametrize(
    ("masses", "grain", "radians", "samples", "pressed"),
    [
        ([2e-3, 1e-6, 2e-3], 2, 46.0, 11, {"gravity": 9.81}),
        ([1e-6, 1e-6, 2e-3], 1, 10.0, 11, {"gravity": 9.81}),
        ([2e-3, 1e-6, 2e-3], 3, 100.0, 2, {"gravity": 0.0, "top_load": 0.1}),
    ],
)
def test_a_tighter_tolerance_rarely_costs_less(masses, grain, radians, samples, pressed):
    """With springs of unequal masses that open, attempts after the first one once overshot."""
    chain = column(3, exponent=1.0, masses=masses, bottom="wall", **pressed)
    lifted = Displacement(
        displacement=-10 * chain.equilibrium_overlap[min(grain, 2) - 1], grain=grain
    )
    scene = scene_of(chain, lifted, 1e-6, samples)
    scene = scene.replace(duration=radians / scene.highest_frequency)
    work = [
        simulate(scene, "native", tolerance).cost.force_evaluations
        for tolerance in 10.0 ** -np.arange(5, 11.1, 0.5)
    ]
    assert (work > 0.8 * np.maximum.accumulate(work)).all()
