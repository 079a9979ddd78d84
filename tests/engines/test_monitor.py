"""Error estimates of a run from given distances between its runs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column, random_column
from helpers.example_scenes import scene_of, smooth, struck

from lmpchain import Drive, Force, Impulse, Law, RunFailed, Scene, simulate
from lmpchain.engines import Lammps, Native
from lmpchain.engines.base import ErrorBudget, Proposal
from lmpchain.engines.stepping.monitor import place_looks
from lmpchain.engines.stepping.rounding import (
    amplify_rounding,
    could_grow,
    count_digits,
    free_flights,
    grow_digit,
    perturb,
    reduced_loss,
    repeat_rounding,
    separate,
)
from lmpchain.engines.stepping.time_stepping import SteppingRun
from lmpchain.integrators.methods import METHODS
from lmpchain.util.arrays import EPSILON

LOOSE = struck(column(12), 1e-2, 1e-4, 101)
# Contacts open again and again, which amplifies rounding by about 1e6.
CHAOTIC = struck(random_column(6, 2, 0.3, top="wall"), 0.1, 4e-4, 21)


def finished(engine: Native, *scenes: Scene, tolerance: float = 1e-6) -> SteppingRun:
    """Return a run that has reached its end."""
    return complete(engine, engine.propose(scenes[0], tolerance), *scenes)


def complete(engine: Native, proposal: Proposal, *scenes: Scene) -> SteppingRun:
    """Return a run of this proposal that has reached its end."""
    run = engine.start(scenes, proposal)
    for _ in run.blocks():
        pass
    return run


def given(
    run: SteppingRun, differences: Any, peaks: Any = (1.0, 1.0), sample: int | None = None
) -> SteppingRun:
    """Replace the distances between the runs, (S, T, R, 2), and the largest motion, m and m/s."""
    state = run.monitor.state()
    shape = state["differences"].shape
    state["differences"] = np.broadcast_to(np.asarray(differences, float), shape)
    state["peaks"] = np.broadcast_to(np.asarray(peaks, float), state["peaks"].shape)
    state["sample"] = np.array(shape[1] - 1 if sample is None else sample)
    run.monitor.restore(state)
    return run


def pairs(*distances: Any) -> np.ndarray:
    """Return distances of each auxiliary run that are the same at all samples."""
    return np.array(distances, float)[:, None, None]


def test_the_larger_of_two_relative_errors_is_the_truncation_error() -> None:
    """Distances of order 6 between runs with h, 2h and 4h show twice the error."""
    run = finished(Native("rkn6", step=smooth(samples=5).duration / 32), smooth(samples=5))
    errors = np.array([2e-9, 3e-6])
    distances = pairs(errors * 63, errors * 63 * 64)
    (error,) = given(run, distances, (0.5, 1000.0)).errors()
    assert error.truncation == pytest.approx(2 * 4e-9, rel=1e-9)
    (error,) = given(run, distances, (0.5, 10.0)).errors()
    assert error.truncation == pytest.approx(2 * 3e-7, rel=1e-9)
    assert error.order == 6
    # An auxiliary run that broke down shows nothing.
    for broken in (np.inf, np.nan):
        distances[1, 0, 0, 1] = broken
        assert given(run, distances).errors()[0].truncation == np.inf


def test_the_rounding_error_is_a_walk_and_a_phase() -> None:
    scene = smooth(samples=5)
    for name in ("rkn6", "verlet", "kahan-li8"):
        method = METHODS[name]
        run = finished(Native(name, step=scene.duration / 400), scene)
        (error,) = given(run, 0.0).errors()
        walk = math.sqrt(400 * max(method.evaluations, method.spread**2))
        expected = EPSILON * (2 + walk + 1.5 * scene.total_phase)
        assert error.roundoff == pytest.approx(expected, rel=1e-9)
        assert (error.truncation, error.amplified.size) == (0.0, 0)
    # The plain form of the force adds an error of the velocity.
    plain, exact = (
        finished(Native("rkn6", scene.duration / 400, force=force), scene)
        for force in ("plain", "exact")
    )
    one, other = (given(run, 0.0, (1.0, 1e-3)).errors()[0].roundoff for run in (plain, exact))
    weight = 1e-3 / scene.chain.masses.min()
    walk = 0.9 * EPSILON * weight * scene.duration / math.sqrt(400)
    assert one - other == pytest.approx(METHODS["rkn6"].spread * walk / 1e-3, rel=1e-6)


def test_interpolated_velocities_have_the_error_of_a_difference() -> None:
    scene = smooth(samples=1001)
    engine = Native("rkn6")
    run = finished(engine, scene)
    assert run.proposal.steps.stride > 1
    steps = run.cost().steps
    landed = finished(Native("rkn6", adaptive=False, step=scene.duration / 1000), scene)
    for speed, flown in ((1e3, 1e3 * scene.duration), (1e5, 1e5 * scene.duration)):
        extra = given(run, 0.0, (1.0, speed)).errors()[0].roundoff
        walk = math.sqrt(steps * METHODS["rkn6"].evaluations)
        extra -= EPSILON * (2 + walk + 1.5 * scene.total_phase)
        assert extra == pytest.approx(8 * EPSILON * steps / flown, rel=1e-6)
    assert landed.proposal.steps.stride == 1


def test_open_contacts_let_rounding_grow_over_free_flights() -> None:
    engine = Native("rkn6", step=LOOSE.duration / 400, adaptive=False)
    run = finished(engine, LOOSE)
    assert run.monitor.lowest[0] < -1
    evaluations = 400 * METHODS["rkn6"].evaluations
    # The flights are as long as the path of the fastest grain, but turn as often as it can.
    for size, speed, flights in (
        (1.0, 5 / LOOSE.duration, 5.0),
        (1.0, 0.1 / LOOSE.duration, 1.0),
        (1.0, 1e9, LOOSE.total_phase),
    ):
        assert free_flights(LOOSE, size, speed) == pytest.approx(flights, rel=1e-12)
        # The run with its given step also measures amplified rounding, unless it is a part only.
        (error,) = given(run, 0.0, (size, speed), sample=50).errors()
        walk = max(math.sqrt(evaluations * flights), evaluations / 8 / flights)
        expected = EPSILON * (2 + walk + 1.5 * LOOSE.total_phase)
        assert error.roundoff == pytest.approx(expected, rel=1e-9)
        assert error.order == 2


def test_damped_velocities_have_the_rounding_error_of_their_parts() -> None:
    """The largest damping rate of a grain times the largest displacement, in ulps."""
    chain = column(4, gravity=0.0, top_load=1.0, exponent=1.0, bottom="wall")
    edge = chain.band_edge
    a, gamma = 0.3 / edge, 0.2 * edge
    chain = chain.replace(damping={"viscoelastic": a, "drag": gamma})
    scene = struck(chain, 1e-6, 20 / edge, 5)
    k = chain.contacts.stiffness
    rate = (a * (k[:-1] + k[1:]) / chain.masses).max() + gamma
    loss = reduced_loss(scene, 3.0, 1e-9)
    assert loss == pytest.approx(8 * EPSILON * rate * 3.0, rel=1e-9)
    run = finished(Native("dop853", step=scene.duration / 80), scene)
    phase = 2 + 1.5 * scene.total_phase
    walk = math.sqrt(80 * max(METHODS["dop853"].evaluations, METHODS["dop853"].spread ** 2))
    (error,) = given(run, 0.0, (1e-3, 1e-3)).errors()
    expected = EPSILON * (phase + walk) + reduced_loss(scene, 1e-3, 0.0) / 1e-3
    assert error.roundoff == pytest.approx(expected, rel=1e-9)
    # With Hertz's law, closer grains have stiffer contacts.
    hertz = scene.replace(chain=chain.replace(exponent=1.5, damping={"viscoelastic": a}))
    overlap = float(hertz.chain.contacts.overlap.max())
    assert reduced_loss(hertz, 1.0, 3 * overlap) > 1.9 * reduced_loss(hertz, 1.0, 0.0)
    assert reduced_loss(hertz, 1.0, -overlap) == reduced_loss(hertz, 1.0, 0.0)


@pytest.mark.parametrize("power", [0.0, 1.0, 3.0, 20.0, -2.0])
def test_an_error_is_extrapolated_to_the_end_with_its_power_of_time(power: float) -> None:
    """The power is at most 12, and an error never falls."""
    scene = LOOSE.replace(samples=201)
    run = finished(Native("rkn6", step=scene.duration / 800, adaptive=False), scene)
    grown = 1e-9 * (np.fmax(np.arange(201.0), 1) / 100) ** power
    grown[101:] = 0.0
    distances = np.zeros((2, 201, 1, 2))
    distances[0, :, 0, 1] = grown
    # The other field has a smaller error, which does not grow.
    distances[0, :, 0, 0] = 0.1 * grown.max()
    distances[1] = distances[0] * 2
    scale = np.array([1e-3, 8.0])
    run = given(run, distances * scale, scale, sample=100)
    (now,), (then,) = run.errors(), run.outlook()
    assert now.truncation == pytest.approx(2 * grown.max(), rel=1e-9)
    seen = {20.0: 12.0, -2.0: 0.0}.get(power, power)
    assert then.truncation == pytest.approx(now.truncation * 2**seen, rel=1e-9)
    assert (then.roundoff, then.order) == (now.roundoff, now.order)


def test_errors_after_openings_are_expected_to_have_the_order_of_coarse_steps() -> None:
    run = finished(Native("kahan-li8"), struck(column(120), 1e-2, 1e-4, 21))
    run = given(run, 1e-9, sample=10)
    assert run.proposal.steps.adaptive
    assert (run.errors()[0].order, run.outlook()[0].order) == (6.0, 4.0)


def test_the_error_of_energies_includes_truncation_and_rounding() -> None:
    """Four times the truncation error, plus the rounding error of all velocities."""
    masses = np.array([1, 2, 1, 4, 1, 1]) * 1e-6
    damping = {"viscoelastic": 3e-8, "drag": 1e3}
    chain = column(6, gravity=0.0, top_load=0.1, bottom="wall", masses=masses, damping=damping,
                   ground=Law("s*u", s=1e4))  # fmt: skip
    for excitation in (Impulse(velocity=1e-5), Drive(amplitude=1e-11, frequency=2e4)):
        scene = scene_of(chain, excitation, 6e-5, 5)
        run = finished(Native("dop853", step=scene.duration / 160), scene)
        balance = run.monitor.native.balance
        balance[:] = 0.0
        # Losses of the answer, and of the runs with 2h and 4h, with an error of order 8.
        size = 1e6 * chain.excess_energy(*scene.initial()) + 1e-9
        wrong = 1e-7 * np.array([1.0, 2.0**8, 4.0**8])
        balance[:, 0, -1, 0] = size * (1 + wrong)
        roundoff = 1e-9
        (energies,) = run.energies([ErrorBudget(0.0, roundoff, 8.0)])
        spread = math.sqrt(10e-6 / 1e-6)
        expected = size * (1 + 1e-7) * (4 * 2e-7 / (1 + 1e-7) + 2 * spread * roundoff)
        assert energies["dissipated_error"] == pytest.approx(expected, rel=1e-5)
        assert energies["dissipated"][-1] == pytest.approx(size, rel=1e-6)
        if excitation.does_work:
            # The force on the driven grain also accelerates it, and moves it on the ground.
            omega = 2 * np.pi * 2e4
            speed = 1e-11 * omega * np.cos(omega * scene.time)
            energy = 1e-6 / 2 * (speed**2 - speed[0] ** 2)
            energy += 1e4 / 2 * (1e-11 * np.sin(omega * scene.time)) ** 2
            np.testing.assert_allclose(energies["drive"], energy, rtol=1e-9, atol=1e-30)
            assert energies["drive_error"] == energies["dissipated_error"]
        else:
            assert "drive" not in energies
    still = finished(Native("rkn6", step=1e-7), smooth(samples=5))
    assert still.energies(still.errors()) == []


def test_a_run_is_judged_at_times_that_grow_by_a_tenth() -> None:
    """The last time is a tenth before the end, the first one after 10 ms of work."""
    assert place_looks(0.0109, 1000, 4) == frozenset()
    assert place_looks(0.0111, 1000, 4) == {908}
    looks = sorted(place_looks(1.0, 100_000, 10))
    fractions = 1.1 ** -np.arange(1.0, 49)
    fractions = fractions[fractions > 0.01]
    assert looks == sorted(int(100_000 * x) // 10 * 10 for x in fractions)
    # A sample at which not all runs land is none, nor is the start.
    assert place_looks(0.03, 8, 4) == {4}


GIVEN = Native("rkn6", step=CHAOTIC.duration / 2000, adaptive=False)
EVALUATIONS = 2000 * METHODS["rkn6"].evaluations


@pytest.mark.parametrize(
    ("tolerance", "truncation", "how"),
    # Both are in units of the bound by a random walk times growth, which is about 4e-7. Runs one
    # ulp apart differ by 7e-10.
    [
        (math.inf, 0.0, "repeated"),
        (math.inf, 0.9, "repeated"),
        (math.inf, 1.1, "bound"),
        (math.inf, 1e6, "no"),
        (0.03, 0.0, "repeated"),
        # The tolerance is met anyway, shorter steps follow anyway, or rounding is hopeless.
        (1.2, 0.1, "bound"),
        (1.2, 0.9, "repeated"),
        (1.2, 1.9, "repeated"),
        (1.2, 2.1, "bound"),
        (0.9e-3, 0.0, "bound"),
        (1.1e-3, 0.0, "repeated"),
    ],
)
def test_amplified_rounding_is_measured_as_well_as_it_matters(
    tolerance: float, truncation: float, how: str
) -> None:
    bound = amplify_rounding(CHAOTIC, EVALUATIONS)
    # The bound of the phase alone decides whether growth is measured at all.
    assert 1e-8 < bound.max() < 1e-5 < 0.01 < could_grow(CHAOTIC, EVALUATIONS) < 0.1
    tolerance *= bound.max()
    truncation *= bound.max()
    proposal = GIVEN.propose(CHAOTIC, 1e-6)._replace(tolerance=tolerance)
    run = complete(Native("rkn6"), proposal, CHAOTIC)
    # Errors of order 1 with h, 2h and 4h.
    peaks = np.array([1e-5, 1.0])
    distances = pairs(0.5 * truncation * peaks, truncation * peaks)
    (error,) = given(run, distances, peaks).errors()
    assert error.truncation == pytest.approx(truncation, rel=1e-9)
    if how == "no":
        assert error.amplified.size == 0
        return
    expected = bound
    if how == "repeated":
        repeated = repeat_rounding(CHAOTIC, METHODS["rkn6"], run.proposal.steps)
        assert repeated.max() < bound.max()
        expected = np.fmin(bound, repeated)
    np.testing.assert_allclose(error.amplified, expected, rtol=1e-9, atol=0)
    assert error.roundoff == pytest.approx(expected.max(), rel=1e-9)
    # It is measured at the end only.
    assert given(run, distances, peaks, sample=19).errors()[0].amplified.size == 0


@pytest.mark.parametrize(("part", "hopeless"), [(1.3e-3, True), (1.5e-3, False)])
def test_hopeless_rounding_is_foreseen(part: float, hopeless: bool) -> None:
    """A thousand times the tolerance is exceeded by twice the evaluations so far."""
    tolerance = part * float(amplify_rounding(CHAOTIC, EVALUATIONS).max())
    proposal = GIVEN.propose(CHAOTIC, 1e-6)._replace(tolerance=tolerance)
    run = complete(Native("rkn6"), proposal, CHAOTIC)
    (then,) = given(run, 0.0, (1e-5, 1.0), sample=10).outlook()
    amplified = count_digits(2 * EVALUATIONS) * grow_digit(CHAOTIC, 1e3 * tolerance)
    assert (amplified.max() > 1e3 * tolerance) == hopeless
    if hopeless:
        np.testing.assert_allclose(then.amplified, amplified, rtol=1e-9, atol=0)
        assert then.roundoff == pytest.approx(amplified.max(), rel=1e-9)
    else:
        assert (then.amplified.size, then.roundoff < 1e-12) == (0, True)


def test_distances_of_runs_with_changed_initial_values() -> None:
    """They end where they are large enough, and the last distance is that of later samples."""
    scene = struck(random_column(6, 2, 0.3, top="wall"), 0.1, 2e-4, 101)
    method = METHODS["rkn6"]
    engine = Native("rkn6", step=scene.duration / 1000, adaptive=False)
    steps = engine.propose(scene, 1e-6).steps
    changes = (1e-9, -2e-9)
    found = separate(scene, changes, method, steps)
    runs = [simulate(each, engine) for each in (scene, *(perturb(scene, c) for c in changes))]
    for row, other in zip(found, runs[1:], strict=True):
        u, v = (
            np.abs(getattr(other, name) - getattr(runs[0], name)).max(1)
            / np.abs(getattr(runs[0], name)).max()
            for name in ("displacement", "velocity")
        )
        np.testing.assert_allclose(row, np.maximum(u, v), rtol=0.1, atol=1e-14)
    enough = 20 * found[:, 0].max()
    assert found.max() > 2 * enough
    ended = separate(scene, changes, method, steps, enough)
    first = int(np.flatnonzero((found > enough).any(0))[0])
    assert first < 90
    np.testing.assert_allclose(ended[:, : first + 1], found[:, : first + 1], rtol=0.3, atol=1e-14)
    assert (ended[:, -1:] == ended[:, first + 3 :]).all()
    assert (ended[:, -1] < found.max(1)).any()


def test_a_scene_at_rest_has_the_units_of_its_chain() -> None:
    """If nothing moves, errors are relative to lengths and speeds of a strike of strength 1."""
    scene = smooth(samples=5).replace(excitation=Impulse(velocity=0.0))
    run = finished(Native("rkn6", step=scene.duration / 40), scene)
    length, speed = run.monitor.native.chains.arrays.units[0]
    for unit in (np.array([length, 0.0]), np.array([0.0, speed])):
        (error,) = given(run, pairs(63e-9 * unit, 63 * 64e-9 * unit), 0.0).errors()
        assert error.truncation == pytest.approx(2e-9, rel=1e-6)


@pytest.mark.parametrize(("part", "order"), [(0.49, 6.0), (0.51, 2.0)])
def test_contacts_that_nearly_open_lower_the_order_of_equal_steps(
    part: float, order: float
) -> None:
    """An overlap that falls below a half of that at rest counts."""
    chain = column(2, gravity=0.0, top_load=1e-2, exponent=1.0)
    speed = -part * float(chain.equilibrium_overlap[0]) * chain.band_edge
    scene = struck(chain, speed, 20 / chain.band_edge, 5)
    run = finished(Native("rkn6", step=scene.duration / 400, adaptive=False), scene)
    assert run.monitor.lowest[0] == pytest.approx(-part, rel=5e-3)
    assert run.errors()[0].order == order


def test_the_distance_from_a_native_twin_is_the_rounding_error() -> None:
    scene = smooth(samples=9)
    run = finished(Lammps("verlet", step=scene.duration / 800), scene)
    try:
        assert run.monitor.runs == 3
        distances = np.zeros((3, 9, 1, 2))
        distances[0, :, 0, 0] = 1e-9 * np.arange(9)
        distances[0, 3, 0, 1] = 5e-5
        # The twin and the runs with 2h and 4h show the truncation error of order 2.
        distances[1, :, 0, 0] = 3e-7
        distances[2, :, 0, 0] = 12e-7
        (error,) = given(run, distances, (1.0, 1e3)).errors()
        walk = EPSILON * (2 + math.sqrt(800) + 1.5 * scene.total_phase)
        assert error.roundoff == pytest.approx(walk + 5e-8, rel=1e-9)
        expected = 1e-9 * np.arange(9)
        expected[3] = 5e-8
        np.testing.assert_allclose(error.amplified, expected, rtol=1e-12, atol=0)
        assert error.truncation == pytest.approx(2e-7, rel=1e-9)
        # The run is judged at its end only.
        assert run.monitor.choose_looks(1e3, 4) == frozenset()
    finally:
        run.close()


@pytest.mark.parametrize("driven", [False, True])
def test_grains_closer_than_their_energy_allows_end_a_run(driven: bool) -> None:
    """Without a bound on the energy, a million lengths of the chain are too close."""
    chain = column(2, gravity=0.0, top_load=10.0, exponent=1.0)
    scene = struck(chain, 1e-3, 20 / chain.band_edge, 5)
    # The bound includes the overlap at rest.
    largest = 1e-3 / chain.band_edge
    part = 1.1 * float(chain.equilibrium_overlap[0]) / largest
    if driven:
        scene = scene.replace(excitation=Force(amplitude=1e-6, frequency=1e3))
        largest, part = 0.9e6 * float(chain.diameters.sum()), 1.2
    run = finished(Native("rkn6", step=scene.duration / 80), scene)
    watched = run.monitor.native.watched
    for row in (0, 1):
        watched["largest_approach"][row] = largest
        run.monitor.leave_broken(0, 2)
        assert watched["sample"].tolist() == [4, 4, 4]
        watched["largest_approach"][row] = part * largest
        if row == 0:
            with pytest.raises(RunFailed, match="a contact overlaps more than the total energy"):
                run.monitor.leave_broken(0, 2)
            watched["largest_approach"][row] = 0.0
        else:
            # An auxiliary run waits for the others.
            run.monitor.leave_broken(0, 2)
            assert watched["sample"].tolist() == [4, 2, 4]
