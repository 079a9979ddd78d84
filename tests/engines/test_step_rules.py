"""Rules for steps: those of an attempt, of its auxiliary runs and of the next attempt."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import paper, scene_of, smooth, stirred, struck

from lmpchain import Displacement, Force, Impulse, InputError, Law, Scene, ToleranceNotMet
from lmpchain.engines import Native
from lmpchain.engines.base import ErrorBudget
from lmpchain.engines.stepping.auxiliary_runs import AuxiliarySteps, longer_steps, recurs
from lmpchain.engines.stepping.rounding import interpolation_loss
from lmpchain.engines.stepping.step_choice import (
    FIRST_STEP,
    choose_given_step,
    choose_step,
    choose_steps,
    expected_reach,
    land,
    work,
)
from lmpchain.engines.stepping.time_stepping import fit_block, restrict
from lmpchain.integrators.methods import LAGGED, METHODS
from lmpchain.integrators.steps import Steps
from lmpchain.util.arrays import EPSILON

RKN6 = METHODS["rkn6"]
DOP853 = METHODS["dop853"]
LOADED = column(6, gravity=0.0, top_load=1e-2, bottom="wall")
EDGE = LOADED.band_edge
LOOSE = struck(column(20, gravity=0.0, bottom="wall"), 0.1, 1e-4, 25)


def calm(radians: float, samples: int = 2, **chain: Any) -> Scene:
    """Return a scene in which no contact opens, of this phase of the fastest motion."""
    return struck(LOADED.replace(**chain), 1e-9, radians / EDGE, samples)


def equal_steps(scene: Scene, number: int) -> Steps:
    """Return this number of equal steps for each sample."""
    return Steps.spread(scene.sampling_interval, number)


# --- auxiliary runs


def test_steps_of_auxiliary_runs_are_stable_and_not_too_few() -> None:
    """Few steps have one at half the step; the limit of rkn6 is 5 / 3 rad."""
    scene = calm(0.5)
    for steps, longer, ratios in ((7, [], [0.5]), (8, [2, 4], [2, 4]), (9, [2, 4], [9 / 5, 3])):
        assert longer_steps(RKN6, scene, equal_steps(scene, steps)) == longer
        auxiliary = AuxiliarySteps(RKN6, [scene], equal_steps(scene, steps))
        assert list(auxiliary.ratios) == pytest.approx(ratios, rel=1e-12)
    for part, longer in ((0.249, [2, 4]), (0.251, [2]), (0.51, [])):
        scene = calm(part * RKN6.stability_limit * 40, 41)
        assert longer_steps(RKN6, scene, equal_steps(scene, 1)) == longer


def test_auxiliary_runs_of_damped_motions_land_on_every_sample() -> None:
    """Motions that decay between samples are seen at samples only."""
    scene = calm(8.0, 5, damping={"drag": 0.3 * EDGE})
    assert scene.sampling_decay == pytest.approx(0.3, rel=1e-9)
    lasting = calm(8.0, 5, damping={"drag": 0.2 * EDGE})
    pushed = scene.replace(excitation=Force(shape="half-sine", amplitude=1e-6, duration=3 / EDGE))
    fits = {8: [2, 4], 12: [2, 3], 9: [], 10: [], 14: [], 32: [2, 4], 33: [2, 4]}
    for steps, longer in fits.items():
        assert longer_steps(DOP853, scene, equal_steps(scene, steps)) == longer
        assert longer_steps(DOP853, lasting, equal_steps(lasting, steps)) == [2, 4]
        # All runs may have the same last step between a kink and a sample.
        assert longer_steps(DOP853, pushed, equal_steps(scene, steps)) == []
    # The first steps of damped motions are chosen such that they can.
    for radians in (8.0, 80.0):
        scene = calm(radians, 5, damping={"drag": 0.3 * EDGE})
        for tolerance in 10.0 ** -np.arange(7.0, 11, 0.25):
            least = math.ceil(
                scene.sampling_phase / expected_reach(scene, DOP853, tolerance, False)
            )
            fit = next(n for n in range(least, 99) if n in (1, 2) or n > 31 or 0 in (n % 4, n % 6))
            assert choose_step(scene, DOP853, tolerance, True).per_landing == fit


def test_each_run_is_compared_with_that_of_the_next_shorter_steps() -> None:
    auxiliary = AuxiliarySteps(RKN6, [LOOSE], equal_steps(LOOSE, 1)._replace(adaptive=True), 1)
    # The runs are the answer, its twin, 2h, 4h and 1.5h.
    assert [schedule.ratio for schedule in auxiliary.schedules] == [2, 4, 1.5]
    assert auxiliary.against.tolist() == [0, 1, 2, 0]
    # The runs of longer steps land on every 2nd, 4th and 3rd sample.
    assert (auxiliary.strides.tolist(), auxiliary.together) == ([1, 2, 4, 3], 12)
    assert auxiliary.ratios == (2, 4, 1.5)
    other = AuxiliarySteps(RKN6, [calm(0.5)], equal_steps(calm(0.5), 40))
    assert (other.against.tolist(), other.strides.tolist(), other.together) == ([0, 1], [1, 1], 4)


def test_energies_are_compared_where_both_runs_have_landed() -> None:
    loose = LOOSE.replace(samples=26)
    auxiliary = AuxiliarySteps(RKN6, [loose], equal_steps(loose, 1)._replace(adaptive=True))
    balance = np.full((4, 1, 26, 2), 1e9)  # No run has this energy where it has landed.
    for run, (landing, size) in enumerate(zip((1, 2, 4, 3), (1.0, 1.5, 4.0, 7.0), strict=True)):
        balance[run, :, [*range(0, 26, landing), 25]] = 0.0
        balance[run, 0, 12] = size
    for final, expected in ((0.0, 2.5), (100.0, 100.0)):
        balance[2, 0, 25, 1] = final
        differences = auxiliary.compare_energies(balance)
        assert differences[:, 0].tolist() == [[0.5, 0.5], [2.5, expected], [6.0, 6.0]]


def test_the_run_of_one_and_a_half_steps_bounds_the_error() -> None:
    """Without openings, its distance from the answer shrinks with the order, too."""
    auxiliary = AuxiliarySteps(RKN6, [LOOSE], equal_steps(LOOSE, 1)._replace(adaptive=True))
    assert auxiliary.recurrent == [True]
    for opens, bound in ((True, 2e-6), (False, 2e-6 / (1.5**6 - 1))):
        for nearby in ((1e-6, 0.0), (0.0, 1e-6)):
            distances = [(1e-9, 2e-9), (64e-9, 128e-9), nearby]
            found = auxiliary.truncation(0, distances, 6, opens)
            assert found == pytest.approx(bound, rel=1e-9)


def test_equal_steps_are_trusted_less_if_contacts_open() -> None:
    """Errors of order 1, or partly of order 2 if a contact is pressed far beyond its rest.

    A strain of 10 is where a contact counts as nearly open at first.
    """
    steps = equal_steps(calm(0.5), 40)
    share = (64 - 8) / (64 - 4)
    mixed = 2e-6 * ((1 - share) / 63 + share / 3)
    for strain, opens, expected in (
        # The gain is at most that of the first order.
        (99.0, True, max(2e-6 / (2 - 1), 8e-6 / (4 - 2))),
        (99.0, False, mixed),
        (10.1, False, mixed),
        (9.9, False, 2e-6 / 7),
        (0.1, False, 2e-6 / 7),
    ):
        scene = struck(LOADED, 1e-2, 1e-5, 2)
        for _ in range(20):
            strike = scene.excitation.scaled(strain / scene.largest_strain)
            scene = scene.replace(excitation=strike)
        auxiliary = AuxiliarySteps(RKN6, [scene], steps)
        error = auxiliary.truncation(0, [(1e-6, 0.0), (8e-6, 0.0)], 6, opens)
        assert error == pytest.approx(expected, rel=1e-9)
    # A single auxiliary run is trusted if steps are equal and the force is smooth.
    long = calm(0.4 * RKN6.stability_limit * 12, 13)
    strong = struck(LOADED, 1.0, 1e-5, 13)
    for each, expected in ((long, 2e-6 / 63), (strong, 2e-6)):
        alone = AuxiliarySteps(RKN6, [each], equal_steps(long, 1))
        assert alone.ratios == (2.0,)
        assert alone.truncation(0, [(1e-6, 0.0)], 6, False) == pytest.approx(expected, rel=1e-9)


def test_steps_between_kinks_have_smaller_ratios() -> None:
    """Both runs end steps on kinks: the ratio is that of whole numbers of steps."""
    chain = column(8, gravity=0.0, bottom="wall")
    end = 1e-5
    push = Force(shape="half-sine", amplitude=1e-2, duration=end)
    scene = scene_of(chain, push, 4 * end, 2)
    # The push takes 7 steps, or 4 steps of about twice the length.
    steps = Steps.spread(scene.duration, 28)._replace(adaptive=True)
    auxiliary = AuxiliarySteps(RKN6, [scene], steps)
    distances = [(7e-6, 0.0), (56e-6, 0.0), (0.0, 0.0)]
    # The observed gain of 8 for twice the step is less for 7 / 4 of the step.
    gain = 8 ** (math.log(7 / 4) / math.log(2))
    found = auxiliary.truncation(0, distances, 6, False)
    assert found == pytest.approx(2 * distances[0][0] / (gain - 1), rel=1e-9)
    equal = AuxiliarySteps(RKN6, [scene], steps._replace(adaptive=False))
    assert equal.truncation(0, distances[:2], 3, False) == pytest.approx(
        max(2 * distances[0][0] / 7, distances[1][0] / (4**3 - 2**3)), rel=1e-9
    )


def test_errors_scatter_if_contacts_open_again() -> None:
    def strong(radians: float, excitation: Any = None, **options: Any) -> Scene:
        scene = scene_of(column(21, **options), excitation or Impulse(velocity=0.1), 1e-4, 2)
        return scene.replace(duration=scene.duration * radians / scene.total_phase)

    # A wave from an end returns after it has crossed the chain, 10 rad for each grain.
    for excitation, crossed in (
        (Impulse(velocity=0.1), 21),
        (Impulse(velocity=0.1, grain=4), 3),
        (Impulse(velocity=0.1, grain=16), 5),
        (Displacement(displacement=1e-6, grain=4), 3),
        (Force(amplitude=1.0, frequency=1e4), 1),
        (stirred(column(21), 0.1), 1),
    ):
        assert recurs(strong(10.1 * crossed, excitation))
        assert not recurs(strong(9.9 * crossed, excitation))
    # Errors scatter from the first opening on with a kink of the force, or on the ground.
    assert not recurs(strong(20.0, exponent=1.26))
    for options in ({"exponent": 1.24}, {"gravity": 0.0}, {"ground": Law("s*u", s=1e3)}):
        assert recurs(strong(20.0, **options))
    # No contact opens if its overlap changes by less than a half.
    scene = struck(LOADED, 1e-9, 100 / EDGE, 2)
    for part, opens in ((0.49, False), (0.52, True)):
        strike = Impulse(velocity=1e-9 * part / scene.linear_strain)
        assert recurs(scene.replace(excitation=strike)) == opens


# --- the first step


def test_the_cost_of_steps_counts_evaluations_for_each_sample() -> None:
    assert work(RKN6, Steps(10, 1, 1e-7)) == 10 * RKN6.evaluations
    # Interpolation costs five evaluations a sample; the search for samples doubles equal steps.
    assert work(RKN6, Steps(10, 4, 1e-7, adaptive=True)) == 2.5 * RKN6.evaluations + 5
    assert work(RKN6, Steps(10, 4, 1e-7)) == 5 * RKN6.evaluations + 5
    scene = calm(100.0, 11)
    methods = [METHODS[name] for name in ("verlet", "rkn4", "rkn6")]
    for tolerance, name in ((1e-11, "rkn6"), (0.1, "verlet")):
        method, steps = choose_steps(scene, methods, tolerance, False)
        assert method.name == name
        assert steps == choose_step(scene, method, tolerance, False)
    method, steps = choose_steps(scene, methods, 1e-9, True, scene.sampling_interval / 100)
    assert (method.name, steps.per_landing, steps.adaptive) == ("verlet", 100, False)


def test_a_given_step_divides_the_time_between_samples() -> None:
    """The stability limit is 2 / omega for velocity Verlet and the highest frequency."""
    scene = calm(20.0, 11)
    interval = scene.sampling_interval
    for divisor, steps in ((4.0, 4), (4.0 * (1 - 1e-14), 4), (4.001, 5), (3.999, 4), (50.0, 50)):
        chosen = choose_given_step(scene, RKN6, interval / divisor)
        assert chosen == Steps.spread(interval, steps)
    with pytest.raises(InputError, match=r"step: must be longer than .* steps cannot be counted"):
        choose_given_step(scene, RKN6, interval / 2.0**53.01)
    assert choose_given_step(scene, RKN6, interval / 2.0**52.99).per_landing < 2**53
    damped = calm(20.0, 11, damping={"drag": 5 * EDGE})
    for each, method, longest in (
        (scene, METHODS["verlet"], 2 / EDGE),
        (damped, DOP853, DOP853.stability_limit / (5 * EDGE)),
    ):
        assert choose_given_step(each, method, 0.999 * longest).step <= longest
        limit = f"below {longest:.3g} s, the stability limit of {method.name} on this chain"
        with pytest.raises(InputError, match=limit):
            choose_given_step(each, method, 1.001 * longest)


@pytest.mark.parametrize("damped", [False, True])
def test_first_steps_are_bounded_by_stability(damped: bool) -> None:
    """Two auxiliary runs are stable, or the distance of a single one meets the tolerance."""
    damping = {"viscoelastic": 1e-3 / EDGE} if damped else {}
    method = DOP853 if damped else RKN6
    scene = struck(LOADED.replace(damping=damping), 0.1, 60 / EDGE, 2)
    assert 0.3 < scene.largest_strain < math.inf
    limit = min(method.stability_limit, math.pi)
    constant = method.error_constant * max(1, scene.total_phase / 60)
    constant *= FIRST_STEP.opening_factor(scene.largest_strain, True, damped)
    for tolerance in (1e-10, 1e-6, 1e-4, 1e-2, 0.1, 1e4, 1e12):
        reach = (tolerance / 2 / constant) ** (1 / method.order)
        longest = (0.25 if damped else 0.45) * limit
        alone = min(reach / 2, longest)
        expected = max(min(reach, limit / 4), alone)
        found = expected_reach(scene, method, tolerance, True)
        assert found == pytest.approx(expected, rel=1e-9)
    # If nothing bounds the strain, one auxiliary run is not enough.
    vacuum = struck(column(20, gravity=0.0, bottom="wall"), 0.1, 1e-4, 6)
    assert vacuum.largest_strain == math.inf
    if not damped:
        assert expected_reach(vacuum, RKN6, 1e12, True) == RKN6.stability_limit / 4
    # A method of order 1 does not lose its order at openings.
    if damped:
        reach = 1e-3 / 2 / LAGGED.error_constant
        assert expected_reach(scene, LAGGED, 1e-3, False) == pytest.approx(reach, rel=1e-9)


def test_steps_near_openings_are_coarse_where_samples_need_short_steps_anyway() -> None:
    strong = struck(column(120), 1e-2, 1e-4, 21)
    for samples, tolerance, coarse in ((21, 1e-8, False), (101, 1e-6, True), (101, 1e-8, False)):
        steps = choose_step(strong.replace(samples=samples), METHODS["kahan-li8"], tolerance, True)
        assert (steps.adaptive, steps.coarse_openings) == (True, coarse)
    springs = strong.replace(chain=column(120, exponent=1.1), samples=2001)
    for tolerance in (1e-4, 1e-6, 1e-8):
        assert not choose_step(springs, METHODS["kahan-li8"], tolerance, True).coarse_openings
    assert not choose_step(strong, METHODS["kahan-li8"], 1e-5, False).adaptive


def test_samples_are_interpolated_if_this_is_cheap_and_accurate() -> None:
    """The error of interpolation is 3e-8 (omega h)^7, and it rounds in proportion to the steps."""
    scene = smooth(samples=1001)
    tolerance = 1e-6
    steps = choose_step(scene, RKN6, tolerance, True)
    assert steps.stride > 1
    reach = min(expected_reach(scene, RKN6, tolerance, False), (tolerance / 6e-8) ** (1 / 7))
    assert (steps.per_landing, steps.stride) == land(scene, scene.sampling_phase / reach)
    assert work(RKN6, steps) < RKN6.evaluations
    fine = (1e-12 / 6e-8) ** (1 / 7)
    tight = choose_step(scene.replace(samples=100_001), RKN6, 1e-12, True)
    assert tight.stride > 1
    assert tight.step * scene.highest_frequency <= fine * (1 + 1e-9)
    # Rounding of interpolated velocities would exceed half of the tolerance.
    many = scene.replace(duration=4e5 / scene.highest_frequency, samples=1_000_001)
    assert interpolation_loss(4e5 / 0.2) > 1e-9 / 2
    assert choose_step(many, RKN6, 1e-9, True).stride == 1
    # Samples between two landings are stored: at most 2^19 values.
    wide = scene.replace(chain=scene.chain.replace(grains=2**18), samples=1001)
    assert choose_step(wide, RKN6, tolerance, True).stride == 1
    for change in (
        {"chain": scene.chain.replace(top_load=0.0)},
        {"chain": scene.chain.replace(ground=Law("s*u", s=1.0))},
        {"excitation": Force(amplitude=1e-9, frequency=1e3)},
    ):
        assert choose_step(scene.replace(**change), RKN6, tolerance, True).stride == 1
    assert choose_step(scene, METHODS["verlet"], 1e-2, True).stride == 1


# --- the next step


def test_a_run_that_opens_contacts_is_refined_near_openings() -> None:
    engine = Native("kahan-li8")
    strong = struck(column(120), 1e-2, 1e-4, 101)
    proposal = engine.propose(strong, 1e-6)
    assert proposal.steps.coarse_openings
    coarse = FIRST_STEP.coarse_error ** (1 / 8)
    number = proposal.steps.per_landing
    for ratio in (1.35, 1.5, 4.0, 7.9):
        missed = ErrorBudget(0.7e-6 * ratio**4, 0.0, 4.0)
        better = engine.refine(proposal, missed, 1e-6)
        assert better is not None
        assert not better.steps.coarse_openings
        expected = max(1.0, ratio / coarse)
        assert better.steps.per_landing == math.ceil(number * expected - 1e-9)
        assert better.cost_s == pytest.approx(
            proposal.cost_s * better.steps.per_landing / number, rel=1e-9
        )


def test_short_steps_land_on_every_sample() -> None:
    engine = Native("rkn6")
    proposal = engine.propose(smooth(samples=1001), 1e-6)
    number, stride = proposal.steps.per_landing, proposal.steps.stride
    for ratio in (1.5, 7.9):
        better = engine.refine(proposal, ErrorBudget(0.7e-6 * ratio**6, 0.0, 6.0), 1e-6)
        assert better is not None
        shorter = math.ceil(number * ratio - 1e-9)
        every = (1, math.ceil(shorter / stride)) if shorter > stride else (stride, shorter)
        assert (better.steps.stride, better.steps.per_landing) == every


def test_a_proposal_is_lengthened_as_far_as_its_error_allows() -> None:
    """The step grows by 1.3 at least, and auxiliary runs of four times the step are stable."""
    engine = Native("verlet")
    scene = calm(100.0, 11)
    proposal = engine.propose(scene, 1e-6)
    number = proposal.steps.per_landing
    assert number > 1000
    limit = METHODS["verlet"].stability_limit / 4 / scene.highest_frequency
    longest = math.ceil(scene.sampling_interval / limit)
    for truncation, fewer in (
        (0.7e-6 / 2.0**2, number / 2.0),
        (0.7e-6 / 1.5**2, number / 1.5),
        (1e-30, longest),
        (0.7e-6 / 1.29**2, None),
        (math.inf, None),
    ):
        error = ErrorBudget(truncation, 0.0, 2.0)
        longer = engine.lengthen(scene, proposal, error, 1e-6)
        assert not engine.lengthen(scene, proposal._replace(fixed=True), error, 1e-6)
        if fewer is None:
            assert longer is None
        else:
            assert longer is not None
            within = 1e-9 if fewer == longest else 1.1
            assert longer.steps.per_landing == pytest.approx(fewer, abs=within)


def test_steps_that_must_round_too_often_are_refused() -> None:
    """The random walk of all evaluations and the phase error exceed the tolerance."""
    scene = paper("weak", 3)
    for name, cure in (("rkn6", ""), ("verlet", 'use integrator "rkn6", which takes fewer')):
        engine = Native(name)
        steps = Steps.spread(scene.sampling_interval, 5000)
        evaluations = 10_000 * METHODS[name].evaluations
        floor = EPSILON * (2 + math.sqrt(evaluations) + 1.5 * scene.total_phase)
        proposal = engine.propose_steps(scene, 1.001 * floor, METHODS[name], steps)
        assert proposal.steps == steps
        with pytest.raises(ToleranceNotMet, match=f"round-off alone may make.*{cure}"):
            engine.propose_steps(scene, 0.999 * floor, METHODS[name], steps)


# --- blocks


def test_blocks_are_whole_runs_or_multiples_of_common_samples() -> None:
    assert fit_block(101, 101, 12) == 100
    assert fit_block(100, 101, 12) == 96
    assert fit_block(24, 101, 12) == 24
    assert fit_block(5, 101, 12) == 12
    state = {"native.u": np.zeros(1), "answer.u": np.ones(1), "natives.v": np.ones(1)}
    assert restrict("native", state) == {"u": np.zeros(1)}
    assert restrict("native", None) == {}
