"""Runs that come first: pilots that show which steps an answer needs, and companions at longer steps."""

import numpy as np
import pytest
from helpers.example_scenes import paper
from helpers.independent_integrators import relative_error

from lmpchain import Chain, Force, Impulse, Scene, ToleranceNotMet, resume, simulate, simulate_many
from lmpchain.benchmark.reference import reference
from lmpchain.engines import Native, step_control
from lmpchain.engines.base import ErrorBudget
from lmpchain.engines.companions import SAFE_STRAIN, Companions
from lmpchain.engines.native import PILOT
from lmpchain.engines.richardson import SAFETY, SMALL, extrapolate
from lmpchain.engines.step_control import first_attempt
from lmpchain.engines.time_stepping import LESS_GENTLE
from lmpchain.integrators.methods import METHODS

VACUUM = Scene(
    chain=Chain(grains=20, diameter=1e-3, gravity=0.0, bottom="wall"), excitation=Impulse(velocity=0.1),
    duration=1e-4, samples=6,
)  # fmt: skip


def test_a_pilot_comes_first_where_nothing_bounds_the_motion_or_the_answer_takes_long():
    engine, long = Native(), paper("weak", samples=3).replace(duration=5e-3)
    for scene in (VACUUM, long):
        candidate, attempt = engine.candidate(scene, 1e-9), first_attempt(engine, scene, 1e-9)
        assert attempt.pilot
        assert 2 <= attempt.candidate.step / candidate.step <= PILOT
        assert attempt.candidate.steps_per_landing * attempt.candidate.step == pytest.approx(
            candidate.steps_per_landing * candidate.step, rel=1e-12
        )
    for other, scene in (
        (engine, paper("fig1")),
        (engine, paper("weak")),
        (Native(step=1e-8), VACUUM),
    ):
        assert not first_attempt(other, scene, 1e-9).pilot
    assert not first_attempt(engine, VACUUM, 5e-3).pilot  # steps are as long as they may be


def test_what_a_pilot_shows_brings_the_error_near_the_tolerance(tmp_path):
    """In memory, in a batch and in a run folder alike; the truth is within the tolerance, and not far below."""
    truth = reference(VACUUM)
    for tolerance in (1e-6, 1e-9):
        answer = simulate(VACUUM, "native", tolerance)
        error = relative_error(
            answer.displacement, answer.velocity, truth.displacement, truth.velocity
        )
        assert tolerance / 100 < error <= tolerance
        assert error / 3 < answer.error_estimate.total <= tolerance
        others = (
            *simulate_many([VACUUM, VACUUM], tolerance),
            simulate(VACUUM, "native", tolerance, folder=tmp_path / f"{tolerance}"),
        )
        for other in others:
            assert np.array_equal(other.velocity, answer.velocity)
            assert other.error_estimate == answer.error_estimate
    assert np.array_equal(resume(tmp_path / f"{tolerance}").velocity, answer.velocity)


def test_a_pilot_is_no_attempt_by_which_an_answer_is_refused(monkeypatch):
    """Three attempts that do not help are enough; the pilot is none of them, and only numbers them."""
    said = []
    judge = step_control.next_attempt

    def told(engine, scene, attempt, error, patient=False):
        found = judge(engine, scene, attempt, error, patient)
        said.append((attempt.number, attempt.pilot, len(attempt.truncations)))
        return found

    monkeypatch.setattr(step_control, "next_attempt", told)
    simulate(VACUUM, "native", 1e-10)
    assert said[:2] == [(1, True, 0), (2, False, 0)]


def test_companions_of_a_calm_answer_have_steps_four_and_eight_times_as_long():
    """Where the order is sure and steps are short enough; their estimate is near the truth, and above it."""
    scene = Scene(
        chain=Chain(grains=20, diameter=1e-3),
        excitation=Impulse(velocity=1e-6),
        duration=1e-4,
        samples=11,
    )
    truth, engine = reference(scene), Native("rkn6")

    def ratios(tolerance: float, of: Scene = scene, **how) -> list[float]:
        candidate = Native("rkn6", **how).candidate(of, tolerance)
        return [
            schedule.ratio for schedule in Companions(METHODS["rkn6"], [of], candidate).schedules
        ]

    assert ratios(1e-10) == [4, 8]
    assert ratios(1e-6) == [2]  # 4h is unstable
    assert ratios(1e-13) == [2, 4]  # round-off would not show
    strong = scene.replace(excitation=Impulse(velocity=1e-2))
    assert ratios(1e-10, strong) == [
        3,
        6,
    ]  # in a column that is struck on its top, before the wave is back
    assert ratios(1e-10, strong.replace(excitation=Impulse(velocity=1e-2, grain=2))) == [2, 4]
    assert ratios(1e-10, strong.replace(duration=2e-3)) == [2, 4, 1.5]
    assert ratios(1e-10, strong, adaptive=False) == [2, 4]
    for tolerance in (1e-6, 1e-8, 1e-10):
        answer = simulate(scene, engine, tolerance)
        error = relative_error(
            answer.displacement, answer.velocity, truth.displacement, truth.velocity
        )
        assert error < answer.error_estimate.total < 4 * error


def test_two_runs_show_the_error_where_the_force_is_smooth_and_they_are_near():
    assert extrapolate(6, True, None, SMALL, (2,), settled=True) == SAFETY * SMALL / 63
    assert extrapolate(6, True, None, 2 * SMALL, (2,), settled=True) == 2 * SMALL
    assert extrapolate(6, True, None, SMALL, (2,)) == SMALL


def test_no_companion_alone_has_the_steps_of_the_answer_where_knots_cut_them():
    """From 1.5 to 2 steps a knot, those of 1.5 times the length are cut into the same two; 1e-10 was hidden."""
    times = np.linspace(0, 7e-5, 15)
    push = Force(times=times, force=-2e-3 * np.cos(np.arange(15) ** 1.2), grain=1)
    scene = Scene(chain=VACUUM.chain, excitation=push, duration=6e-5, samples=2)
    engine = Native("rkn6")
    candidate, knots = engine.candidate(scene, 1e-9), scene.excitation.knot_spacing
    for parts in (1.6, 1.9, 2.1, 4.1):
        steps = round(parts * scene.duration / knots)
        schedules = Companions(METHODS["rkn6"], [scene], candidate.with_steps(steps)).schedules
        assert [schedule.ratio for schedule in schedules if schedule.ratio != 1.5] == (
            [0.5] if parts < 2 else [2] if parts < 4 else [2, 4]
        )
        assert parts > 2 or len(schedules) == 1


def test_chaos_that_one_attempt_does_not_show_is_looked_for_in_the_next(monkeypatch):
    """At one step a pair of runs may happen to stay near; shorter and shorter steps would be tried instead."""
    rng = np.random.default_rng(2)
    chain = Chain(grains=6, diameter=1e-3 * rng.uniform(0.7, 1.3, 6), gravity=9.81, top="wall")
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.3), duration=2e-3, samples=11)
    pairs = []
    honest = step_control.divergence

    def near_at_first(scene, candidate, change):
        pairs.append(candidate.step)
        return np.zeros(scene.samples) if len(pairs) == 1 else honest(scene, candidate, change)

    monkeypatch.setattr(step_control, "divergence", near_at_first)
    with pytest.raises(ToleranceNotMet, match="amplifies round-off") as refusal:
        simulate(scene, "native", 1e-7)
    assert pairs[1] < pairs[0]
    assert refusal.value.trajectory.cost.step_s > Native().candidate(scene, 1e-7).step / 20


def test_a_gentle_strike_on_the_top_is_first_answered_at_steps_of_one_length():
    """It presses contacts; they hardly open before the wave is back, and if they do, a miss lets the steps adapt."""
    chain = Chain(grains=120, diameter=1e-3)
    gentle = Scene(chain=chain, excitation=Impulse(velocity=8.57e-4), duration=1e-4, samples=21)
    assert SAFE_STRAIN < gentle.largest_strain < LESS_GENTLE
    assert not Native().candidate(gentle, 1e-6).adaptive
    for tolerance in (1e-3, 1e-6):
        answer, truth = simulate(gentle, "native", tolerance), reference(gentle)
        error = relative_error(
            answer.displacement, answer.velocity, truth.displacement, truth.velocity
        )
        assert error / 3 < answer.error_estimate.total <= tolerance
    for other, tolerance in (
        (gentle, 1e-9),
        (gentle.replace(excitation=Impulse(velocity=2e-3)), 1e-6),
        (gentle.replace(excitation=Impulse(velocity=-8.57e-4)), 1e-6),
        (gentle.replace(excitation=Impulse(velocity=1e-3, grain=2)), 1e-6),
        (gentle.replace(duration=1e-3), 1e-6),
        (gentle.replace(chain=chain.replace(top="wall")), 1e-6),
        (gentle.replace(chain=chain.replace(exponent=1.0)), 1e-6),
        (
            gentle.replace(chain=chain.replace(masses=chain.masses * np.linspace(1, 1.1, 120))),
            1e-6,
        ),  # reflects
    ):
        assert Native().candidate(other, tolerance).adaptive
    candidate = Native().candidate(gentle, 1e-6)
    missed = ErrorBudget(1e-5, 1e-15, False, np.zeros(21))
    refined = Native().refine(candidate, missed, 1e-6)
    assert refined is not None
    assert refined.adaptive
    assert refined.step < candidate.step
    regular = Native().refine(candidate, missed._replace(smooth=True), 1e-6)
    assert regular is not None
    assert not regular.adaptive
