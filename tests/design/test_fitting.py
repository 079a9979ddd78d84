"""Fits against runs of another integrator, random noise, and the linear theory of errors."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from helpers import taylor_series

from lmpchain import Chain, Impulse, InputError, Profile, Scene, engines, simulate
from lmpchain.design import Traces, fit
from lmpchain.design.unknowns import Problem

CHAIN = Chain(grains=10, diameter=2e-3, top_load=0.5, gravity=0.0, material="steel", bottom="wall")
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=0.02), duration=1e-4, samples=201)
LOOKED_AT = [4, 7]


def measured(
    noise: float = 0.0, late: float = 0.0, scene: Scene = SCENE, places: Sequence[int] = LOOKED_AT
) -> np.ndarray:
    """Return noisy velocities (T, G) of an independent integrator, shifted in time."""
    run = simulate(scene, engine=engines.Native(integrator="dop853"), tolerance=1e-10)
    columns = run.velocity[:, [grain - 1 for grain in places]]
    steps = round(late / (run.time[1] - run.time[0]))
    moved = np.pad(columns, ((steps, 0), (0, 0)))[: len(columns)]
    return moved + noise * np.random.default_rng(0).standard_normal(columns.shape)


def guess(velocity: float = 0.02) -> Scene:
    chain = CHAIN.replace(material=CHAIN.material.replace(youngs_modulus=1.88e11))
    return SCENE.replace(chain=chain, excitation=Impulse(velocity=velocity), duration=1.05e-4)


def test_parameters_of_a_trace_are_recovered():
    late = 5e-6
    offsets = np.array([3e-4, -2e-4])
    traces = Traces(SCENE.time, LOOKED_AT, measured(late=late) + offsets, trigger=True, offset=True)
    found = fit(
        traces,
        guess(0.0196).replace(chain=guess().chain.replace(top_load=0.51)),
        ["youngs_modulus", "top_load", "velocity"],
    )
    truth = [193e9, 0.5, 0.02, late, *offsets]
    np.testing.assert_allclose(found.estimate, truth, rtol=1e-8)
    assert (np.abs(found.estimate - truth) <= 5 * found.error + found.bias).all()
    assert found.names == [
        "youngs_modulus",
        "top_load",
        "velocity",
        "trigger",
        "offset 4",
        "offset 7",
    ]
    assert found.scene.chain.top_load == pytest.approx(found.estimate[1], rel=1e-12)


def check_jacobian(problem: Problem, theta: np.ndarray, tolerance: float) -> None:
    """Check the derivatives of the residuals by central differences."""
    exact = problem.residuals(theta, True)[1]
    for k in range(theta.size):
        step = 1e-5 * (np.arange(theta.size) == k)
        slope = (problem.residuals(theta + step)[0] - problem.residuals(theta - step)[0]) / 2e-5
        error = np.abs(exact[:, k] - slope).max()
        assert error <= tolerance * np.abs(slope).max(), problem.names[k]


@pytest.mark.parametrize("field", ["velocity", "displacement", "force", "contact"])
def test_jacobians_agree_with_differences(field: str):
    traces = Traces(
        SCENE.time, [4, 10], np.zeros((201, 2)), field, trigger=True, gain=True, offset=True
    )  # type: ignore[arg-type]
    problem = Problem(
        SCENE.replace(duration=1.2e-4), [traces], {"youngs_modulus": "common", "masses": [3]}
    )
    check_jacobian(problem, np.array([0.01, -0.02, 0.013, 0.1, 0.0, 0.0]), 1e-5)


@pytest.mark.parametrize("field", ["velocity", "displacement", "contact"])
def test_a_displaced_grain_is_held_until_it_is_released(field: str):
    start = np.where(np.arange(10) == 3, 4e-8, 0.0)
    scene = SCENE.replace(excitation=Profile(displacement=start))
    time = SCENE.time[:41]
    traces = Traces(time, [4], 0 * time, field, trigger=True)  # type: ignore[arg-type]
    problem = Problem(scene, [traces], {"displacement": [4], "contact_constants": [4]})
    theta = np.array([0.01, 0.02, 0.0]) + problem.free(np.array([0.0, 0.0, 4.3e-6])) * [0, 0, 1]
    (held,) = problem.predict(theta)
    law = CHAIN.contacts
    overlap = law.overlap[4] / 1.02 ** (2 / 3) + 1.01 * 4e-8
    force = 1.02 * law.constant[4] * overlap**1.5 - law.force[4]
    exact = {"velocity": 0.0, "displacement": 1.01 * 4e-8, "contact": force}[field]
    np.testing.assert_allclose(held[:9, 0], exact, rtol=1e-9)
    check_jacobian(problem, theta, 1e-5)


def test_a_guess_that_is_far_too_large_is_refused():
    """A tenth of the guess was returned as the estimate, with an error of a few per cent."""
    short = SCENE.replace(duration=4e-5, samples=41)
    traces = Traces(short.time, LOOKED_AT, measured(scene=short), noise=1e-5)
    near, far = (short.replace(chain=CHAIN.replace(top_load=load)) for load in (4.0, 20.0))
    # A name alone is a list of one.
    assert fit(traces, near, "top_load").estimate[0] == pytest.approx(0.5, rel=1e-3)
    with pytest.raises(InputError, match=r"^top_load: the fit ends at a tenth of the guess"):
        fit(traces, far, ["top_load"])


def test_each_trace_has_its_own_strike_time():
    """Residuals are linear within the tiny noise, so that a profile is a parabola."""
    short = SCENE.replace(duration=4e-5, samples=41)
    velocity = measured(scene=short)
    late = 4e-6
    early, known, delayed = (
        Traces(short.time + shift, [4], velocity[:, 0], noise=1e-5, trigger=shift != 0)
        for shift in (-late, 0.0, late)
    )
    start = short.replace(excitation=Impulse(velocity=0.0199), duration=4.01e-5)
    found = fit([early, known, delayed], start, ["velocity"])
    assert found.names == ["velocity", "trigger 1", "trigger 3"]
    truth = np.array([0.02, -late, late])
    assert (np.abs(found.estimate - truth) <= found.bias + 1e-3 * found.error).all()
    assert found.freedom == 3 * 41 - 3
    at, growth = found.profile("trigger 3", reach=2.0, points=3)
    sides = 2 * np.array([-1, 0, 1])
    np.testing.assert_allclose((at - found.estimate[2]) / found.error[2], sides, atol=1e-6)
    np.testing.assert_allclose(growth, [4, 0, 4], rtol=1e-2, atol=1e-2)
    with pytest.raises(InputError, match=r"^name: must be one of velocity, trigger 1, trigger 3"):
        found.profile("trigger")
    rows = found.to_dataframe()
    assert rows["trace"].tolist() == np.repeat([1, 2, 3], 41).tolist()
    assert (rows["place"] == 4).all()
    times = np.concatenate([trace.time for trace in (early, known, delayed)])
    np.testing.assert_array_equal(rows["time [s]"], times)
    np.testing.assert_array_equal(rows["measured"], np.tile(velocity[:, 0], 3))
    np.testing.assert_allclose(rows["fitted"], rows["measured"], atol=1e-5)


def test_undetermined_parameters_are_rejected():
    traces = Traces(SCENE.time, LOOKED_AT, measured())
    for parameters, text in (
        (
            {"youngs_modulus": "common", "contact_constants": "common"},
            "distinguish these parameters",
        ),
        ({"youngs_modulus": [11]}, "1 to 10"),
        (["modulus"], "youngs_modulus"),
    ):
        with pytest.raises(InputError, match=text):
            fit(traces, guess(), parameters)
    whole = 'velocity: must be "common", "each" or numbers from 1 to 10'
    for choice in ("all", 3, None, [1.5], [True], ["1"], [0]):
        with pytest.raises(InputError, match=whole):
            fit(traces, guess(), {"velocity": choice})
    for names in (None, 3):
        with pytest.raises(InputError, match="parameters: must be one or more names"):
            fit(traces, guess(), names)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="has no 11"):
        fit(Traces(SCENE.time, [11], np.zeros(201)), guess(), ["top_load"])
    with pytest.raises(InputError, match="increasing"):
        Traces([0.0, 0.0], [1], np.zeros(2))
    with pytest.raises(InputError, match="leave out the times of 1"):
        Traces([0.0, 1.0], [1], [0.0, np.nan])
    for no_traces in ([], None, measured()):
        with pytest.raises(InputError, match="must be Traces"):
            fit(no_traces, guess(), ["top_load"])  # type: ignore[arg-type]


def test_a_posterior_is_reproducible_from_its_seed():
    short = SCENE.replace(duration=1.5e-5, samples=16)
    traces = Traces(short.time, [2], measured(1e-3, scene=short, places=[2]), noise=1e-3)
    fitted = fit(traces, guess().replace(duration=1.6e-5), ["velocity"])
    first, again, other = (fitted.posterior(12, walkers=4, seed=seed) for seed in (3, 3, 4))
    assert first.shape == (12, 1)
    assert (np.abs(first - fitted.estimate) < 6 * fitted.error).all()
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    wrong: Any
    for wrong in ({"samples": 0}, {"samples": 2.5}, {"walkers": "many"}, {"seed": -1}):
        with pytest.raises(InputError, match=f"^{next(iter(wrong))}: must be a whole number"):
            fitted.posterior(**wrong)
    for wrong in ({"points": 0}, {"points": 1.5}, {"reach": -1.0}, {"reach": "far"}):
        with pytest.raises(InputError, match=f"^{next(iter(wrong))}: must be a"):
            fitted.profile("velocity", **wrong)


@pytest.mark.soak
def test_a_posterior_is_as_wide_as_the_covariance():
    found = fit(
        Traces(SCENE.time, LOOKED_AT, measured(1e-3), noise=1e-3),
        guess(),
        ["youngs_modulus", "velocity"],
    )
    draws = found.posterior(samples=20000)
    np.testing.assert_allclose((draws.mean(0) - found.estimate) / found.error, 0.0, atol=0.2)
    np.testing.assert_allclose(
        np.cov(draws.T) / np.outer(found.error, found.error),
        found.covariance / np.outer(found.error, found.error),
        atol=0.15,
    )


DAMPED = CHAIN.replace(grains=8, damping={"viscoelastic": 3e-7})
# The strike is strong, because weak velocities would be proportional to it like a gain.
HARD = Scene(chain=DAMPED, excitation=Impulse(velocity=0.3), duration=6e-5, samples=151)
STEPS_LATE = 4
DAMPED_TRUTH = np.array([193e9, 0.3, 3e-7, STEPS_LATE * HARD.time[1], 1.1])
DAMPED_PLACES = [3, 6]


def damped_fits(sigma: float, draws: int) -> tuple[np.ndarray, np.ndarray]:
    """Return errors and standard deviations of fits to noisy Taylor series of a damped chain.

    Both are (draws, 5): modulus, strike, A, trigger and gain.
    """
    velocity = taylor_series.solve(HARD, 1e-17).velocity[:, [p - 1 for p in DAMPED_PLACES]]
    clean = 1.1 * np.pad(velocity, ((STEPS_LATE, 0), (0, 0)))[: len(velocity)]
    material = CHAIN.material.replace(youngs_modulus=1.9e11)
    start = HARD.replace(
        chain=DAMPED.replace(material=material, damping={"viscoelastic": 4e-7}),
        excitation=Impulse(velocity=0.32),
        duration=6.5e-5,
    )
    rng = np.random.default_rng(1)
    misses = []
    errors = []
    for _ in range(draws):
        noisy = clean + sigma * rng.standard_normal(clean.shape)
        traces = Traces(HARD.time, DAMPED_PLACES, noisy, noise=sigma, trigger=True, gain=True)
        found = fit(traces, start, ["youngs_modulus", "velocity", "damping.viscoelastic"])
        misses.append(found.estimate - DAMPED_TRUTH)
        errors.append(found.error)
    return np.array(misses), np.array(errors)


def test_parameters_of_a_damped_chain_are_recovered():
    misses, errors = damped_fits(1e-9, 1)
    assert (np.abs(misses) <= 4 * errors).all()
    assert (np.abs(misses[0]) <= 1e-6 * DAMPED_TRUTH).all()


@pytest.mark.parametrize(
    "draws", [pytest.param(50, marks=pytest.mark.slow), pytest.param(200, marks=pytest.mark.soak)]
)
def test_intervals_of_fits_to_damped_chains_cover_the_truth(draws: int):
    """The shares are within two standard deviations of the binomial distribution."""
    misses, errors = damped_fits(3e-3, draws)
    covered = (np.abs(misses) <= 1.96 * errors).mean(0)
    assert np.abs(covered - 0.95).max() <= 2 * np.sqrt(0.95 * 0.05 / draws), covered


@pytest.mark.parametrize("field", ["force", "contact"])
def test_jacobians_of_forces_of_damped_chains_agree_with_differences(field: str):
    traces = Traces(HARD.time, [3, 8], np.zeros((151, 2)), field)  # type: ignore[arg-type]
    chain = DAMPED.replace(damping={"viscoelastic": np.full(7, 3e-7), "drag": 1e3})
    scene = HARD.replace(chain=chain)
    chosen = {"youngs_modulus": "common", "damping.viscoelastic": [7], "damping.drag": "common"}
    problem = Problem(scene, [traces], chosen)
    check_jacobian(problem, np.array([0.01, -0.02, 0.1]), 1e-4)


def test_a_fit_of_damping_starts_above_0():
    traces = Traces(SCENE.time, LOOKED_AT, measured())
    with pytest.raises(InputError, match=r"damping\.viscoelastic: .*start from a guess above 0"):
        fit(traces, SCENE, ["damping.viscoelastic"])


def test_a_chain_without_damping_is_found_to_have_none():
    """The fitted A never falls below 0, whatever the noise is."""
    traces = Traces(SCENE.time, LOOKED_AT, measured(1e-4), noise=1e-4)
    start = SCENE.replace(chain=CHAIN.replace(damping={"viscoelastic": 1e-9}))
    found = fit(traces, start, ["damping.viscoelastic"])
    assert 0 <= found.estimate[0] <= 3 * found.error[0]


def fits_of_lammps(draws: int, sigma: float = 2e-4) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (draws, K) of fits to noisy LAMMPS runs, in standard deviations.

    The second result is their squared distance.
    """
    run = simulate(SCENE, engine="lammps", tolerance=1e-8)
    clean = run.velocity[:, [grain - 1 for grain in LOOKED_AT]]
    rng = np.random.default_rng(1)
    start = guess(0.0196).replace(chain=guess().chain.replace(top_load=0.51))
    off = []
    squares = []
    for _ in range(draws):
        noisy = clean + sigma * rng.standard_normal(clean.shape)
        traces = Traces(SCENE.time, LOOKED_AT, noisy, noise=sigma, trigger=True)
        found = fit(traces, start, ["youngs_modulus", "top_load", "velocity"])
        miss = found.estimate - [193e9, 0.5, 0.02, 0.0]
        off.append(np.abs(miss) / found.error)
        squares.append(miss @ np.linalg.solve(found.covariance, miss))
    return np.array(off), np.array(squares)


@pytest.mark.slow
def test_fits_to_noisy_runs_of_lammps_scatter_as_the_covariance_says():
    squares = fits_of_lammps(25, 2e-5)[1]  # Small noise.
    # Larger noise correlates unknowns.
    assert squares.sum() == pytest.approx(100, abs=3 * np.sqrt(200))


@pytest.mark.soak
def test_intervals_of_fits_to_noisy_lammps_runs_have_their_coverage():
    off = fits_of_lammps(1000)[0]
    for reach, share, slack in ((1.0, 0.683, 0.03), (1.96, 0.95, 0.02)):
        within = (off <= reach).mean(0)
        print(f"within {reach} standard deviations: {within}")
        assert np.abs(within - share).max() <= slack, (reach, within)
