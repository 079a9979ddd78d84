"""The exact linear engines.

Against each other, against extended precision, and against what linearising leaves out.
"""

import mpmath
import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, stirred, struck
from helpers.independent_integrators import distance
from helpers.taylor_series import reference
from helpers.whole_runs import blocks_of

from lmpchain import Chain, Displacement, Drive, Impulse, InputError, Scene, engines, simulate
from lmpchain.engines import Modes
from lmpchain.engines.linear import engine as linear
from lmpchain.integrators.kernels.chebyshev import bessel, terms

# Linear engines warn that they neglect terms.
pytestmark = pytest.mark.filterwarnings("ignore:Eq. ")
ENGINES = ["modes", "chebyshev"]
both = pytest.mark.parametrize("engine", ENGINES)


def random_linear(seed: int, grains: int, strike: float = 1e-14) -> Scene:
    """Return a disordered chain with any ends, with all grains moved or driven."""
    rng = np.random.default_rng(seed)
    driven = bool(rng.random() < 0.4)
    between = bool(rng.random() < 0.5)
    chain = column(
        grains,
        gravity=9.81 * float(rng.random() < 0.5),
        top_load=10 ** rng.uniform(-4, -1),
        exponent=float(rng.choice([1.0, 1.5, 2.2])),
        top="wall" if between and not driven else "free",
        bottom="wall" if between else "fixed",
        masses=rng.uniform(1, 4, grains) * 1e-6,
        contact_constants=rng.uniform(1, 4, grains - 1) * 1e9,
    )
    length = strike * chain.length_scale
    moved = stirred(chain, length / chain.time_scale, length, seed)
    frequency = rng.uniform(0.05, 0.4) * chain.band_edge / 6
    shaken = Drive(amplitude=length, frequency=frequency)
    duration = rng.uniform(5, 60) / chain.band_edge * 6
    return scene_of(chain, shaken if driven else moved, duration, 7)


@pytest.mark.parametrize("z", [1e-3, 0.3, 1.0, 10.0, 300.0, 3000.0])
def test_bessel_functions_of_all_orders(z):
    """Miller's recurrence agrees with mpmath, and the truncated terms are negligible."""
    orders = 2 * terms(z) + 1
    values = bessel(np.array([z]), orders)[:, 0]
    some = np.unique(np.linspace(0, orders - 1, 12).astype(int))
    with mpmath.workdps(30):
        exact = [float(mpmath.besselj(int(n), z, maxprec=100_000)) for n in some]
    assert values[some] == pytest.approx(exact, rel=0, abs=1e-15)
    assert abs(values[-1]) < 1e-16


@pytest.mark.parametrize("seed", range(6))
def test_weak_motions_agree_with_taylor_series(seed):
    """The strain of the nonlinear motion is about 1e-14."""
    scene = random_linear(seed, 12)
    true, _ = reference(scene, 1e-18)
    for engine in ENGINES:
        t = simulate(scene, engine)
        error = true.error(t.displacement, t.velocity)
        assert error < 2e-13
        assert error < 3 * t.error_estimate.total


@pytest.mark.parametrize(
    ("seed", "grains"), [(seed, grains) for seed in range(4) for grains in (3, 40, 300)]
)
def test_modes_and_the_chebyshev_series_agree(seed, grains):
    """Both methods share no arithmetic, and agree to 1e-11 on random chains."""
    scene = random_linear(seed + 100, max(grains, 3))
    one, other = (simulate(scene, engine) for engine in ENGINES)
    assert distance(one, other) < 1e-11
    assert np.abs(one.velocity).max() > 0


@pytest.mark.parametrize("gravity", [0.981, 9.81, 98.1])
def test_model_error_over_the_map_of_strikes(gravity):
    """The paper's chain is struck at the top.

    The estimate is within a factor of 3 wherever the error is below 0.3.
    """
    chain = column(120, gravity=gravity)
    seen = 0
    for speed in 10.0 ** np.arange(-7, 0.5):
        scene = struck(chain, speed, 100e-6, 51)
        t = simulate(scene, "chebyshev", 0.999)
        truth = simulate(scene, "native", 1e-8)
        true = distance(t, truth)
        if 1e-6 < true < 0.3:
            seen += 1
            assert true / 3 < t.error_estimate.model < 3 * true
        elif true >= 0.3:
            assert t.error_estimate.model > 0.1
    assert seen >= 3


LOADED = Chain(grains=80, material="steel", diameter=5e-3, gravity=0, top_load=10.0)
OTHERS = {
    "struck within": (column(150), Impulse(velocity=1e-5, grain=75), 1e-4),
    "struck within, reflected": (column(60), Impulse(velocity=1e-6, grain=30), 1e-3),
    "pulled": (column(60), Displacement(displacement=-1e-11, grain=1), 1e-4),
    "loaded": (LOADED, Impulse(velocity=1e-3), 1e-3),
    "loaded for long": (LOADED.replace(grains=20), Impulse(velocity=1e-3, grain=7), 3e-3),
    "two grains": (column(2), Impulse(velocity=1e-6), 1e-4),
    "square law": (column(100, exponent=2.0), Impulse(velocity=1e-5), 1e-4),
    "nearly springs": (column(100, exponent=1.1), Impulse(velocity=1e-6), 1e-4),
}


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("samples", [3, 101])
def test_model_error_of_other_scenes(name, samples):
    """The estimate holds for few samples, because the solution is evaluated between them.

    It is an estimate of the largest error at any time, not of what is left of it at two moments:
    with 3 samples the wave that is reflected within is seen where it has made up for two thirds of
    it (1.05e-4; 3.1e-4 at any time; the estimate is 1.6e-3).
    """
    chain, excitation, duration = OTHERS[name]
    fine = scene_of(chain, excitation, duration, 1001)
    t = simulate(Scene(**fine.given() | {"samples": samples}), "chebyshev", 0.9)
    runs = simulate(fine, "chebyshev", 0.9), simulate(fine, "native", 1e-9)
    motions = [(run.displacement, run.velocity) for run in runs]
    every = 1000 // (samples - 1)
    scales = [np.abs(x).max() for x in motions[1]]
    off = np.array(
        [np.abs(x - y).max(1) / scale for x, y, scale in zip(*motions, scales, strict=True)]
    )
    assert off[:, ::every].max() / 3 < t.error_estimate.model < 7 * off.max()


def test_springs_have_no_model_error_until_they_open():
    chain = column(20, exponent=1.0)
    scene = struck(chain, 1e-9, 1e-4, 11)
    t = simulate(scene, "chebyshev")
    truth = simulate(scene, "native", 1e-11)
    assert t.error_estimate.model == 0
    assert distance(t, truth) < 1e-11


@both
def test_a_warning_where_the_chain_is_not_linear(engine):
    scene = scene_of(column(40), Impulse(velocity=1e-2), 1e-4, 11)
    with pytest.warns(
        UserWarning, match=r"Eq. \(3\) leaves out about .*not linear here: contact \d+ opens"
    ):
        t = simulate(scene, engine)
    assert t.error_estimate.model > 0.5
    assert t.equation == 3


@both
def test_batches_and_restarts(engine, monkeypatch):
    """Realisations equal single runs, and a run from a stored state ends with the same bytes."""
    drawn = [scene for scene in (random_linear(seed, 25) for seed in range(12)) if not scene.drive]
    scenes = [scene_of(s.chain, s.excitation, 1e-4, 9) for s in drawn[:3]]
    monkeypatch.setattr(linear, "BLOCK", 4)
    monkeypatch.setattr(linear, "SMALL_BLOCK", 4)
    made = engines.get(engine)
    candidate = made.propose(scenes[0], 1e-6)
    run = made.start(scenes, candidate)
    together = blocks_of(run)
    assert run.progress == 1
    for velocity, scene in zip(together[1], scenes, strict=True):
        assert np.array_equal(velocity, simulate(scene, engine, 0.9).velocity)
    broken = made.start(scenes, candidate)
    begun = next(broken.blocks())
    rest = made.start(scenes, candidate, broken.state())
    again = np.concatenate([begun.velocity, blocks_of(rest)[1]], axis=1)
    assert np.array_equal(again, together[1])
    assert [error.model for error in rest.errors()] == [error.model for error in run.errors()]


def test_grains_outside_the_light_cone_are_not_computed():
    """A chain of 10^6 grains costs as much as its reached part, and has the same result."""
    strike = Impulse(velocity=1e-6)
    some = [1, 10, 100, 500]
    long, short = (
        simulate(scene_of(column(n), strike, 1e-3, 5, grains=some), "chebyshev")
        for n in (10**6, 2000)
    )
    assert long.velocity == pytest.approx(
        short.velocity, rel=0, abs=1e-13 * np.abs(short.velocity).max()
    )
    assert long.velocity[-1, 3] == short.velocity[-1, 3]
    quick = simulate(scene_of(column(3000), strike, 1e-5, 3), "chebyshev")
    assert not quick.displacement[:, 200:].any()


def test_modes_of_many_grains_are_rejected_unless_the_wave_reaches_few():
    long = column(20_000)
    driven = Drive(amplitude=1e-12, frequency=1e4)
    with pytest.raises(InputError, match="use chebyshev"):
        simulate(scene_of(long, driven, 1e-5), "modes")
    # The wave reaches few of these grains.
    with pytest.warns(UserWarning, match=r"Eq. \(3\) leaves out"):
        t = simulate(struck(long, 1e-6, 1e-5), "modes")
    assert t.cost.active_grains < 200


@pytest.mark.parametrize("engine", ["bessel", "continuum"])
@pytest.mark.parametrize("duration", [2e-6, 1e-5, 1e-4])
def test_closed_forms_state_their_error(engine, duration):
    """Closed forms are rows for comparison.

    The model error they state is the true one, or its two parts partly cancel in truth.
    """
    chain = column(60)
    scene = scene_of(chain, Impulse(velocity=1e-6), duration, 11, grains="1:50")
    t = simulate(scene, engine, 0.999, on_miss="warn")
    truth = simulate(scene, "native", 1e-10)
    true = distance(t, truth)
    assert t.error_estimate.model / 4 < true < 1.05 * t.error_estimate.model
    assert true == pytest.approx(t.error_estimate.model, rel=0.05) or true < 0.1
    assert t.equation == {"bessel": 4, "continuum": 27}[engine]


def test_bessel_is_exact_for_a_loaded_chain_until_the_reflection():
    chain = Chain(grains=80, material="steel", diameter=5e-3, gravity=0, top_load=5.0)
    scene = scene_of(chain, Impulse(velocity=1e-9), 20 * chain.time_scale, 11)
    exact, formula = (simulate(scene, engine) for engine in ("modes", "bessel"))
    assert distance(formula, exact) < 1e-12


@pytest.mark.filterwarnings("ignore:Eq. ")
@both
def test_a_solution_larger_than_memory(engine, monkeypatch):
    """Evaluation in blocks changes only rounding errors."""
    scene = scene_of(column(40), Impulse(velocity=1e-4), 2e-4, 7)
    whole = simulate(scene, engine, 0.9)
    monkeypatch.setattr(linear, "BLOCK_VALUES", 90)
    pieces = simulate(scene, engine, 0.9)
    assert distance(pieces, whole) < 1e-13
    assert pieces.error_estimate.model == pytest.approx(whole.error_estimate.model, rel=1e-9, abs=0)


@pytest.mark.parametrize("grains", [2, 3, 5])
@pytest.mark.parametrize("frequency", [0.3, 3.0])
def test_a_moving_wall_drives_the_first_grain(grains, frequency):
    """The error is known to a factor of three, also for a single free grain."""
    chain = column(grains, gravity=0.0, top_load=1e-3, top="wall")
    drive = Drive(
        amplitude=1e-6 * chain.length_scale,
        frequency=frequency * chain.band_edge / (2 * np.pi),
        cycles=5,
        grain=0,
    )
    scene = scene_of(chain, drive, 200 * chain.time_scale, 1001)
    answer = simulate(scene, "modes")
    exact = simulate(scene, "native", 1e-11, integrator="dop853")
    left_out = distance(answer, exact)
    assert left_out < 3 * answer.error_estimate.total


@pytest.mark.parametrize("seed", range(15))
def test_the_scale_of_errors_is_the_largest_motion_of_the_run(seed):
    """For any number of samples, the scale is at most the largest motion, and never far below."""
    scene = random_linear(seed + 300, (3, 12, 40)[seed % 3]).replace(samples=2)
    t = simulate(scene.replace(samples=2001), "modes")
    largest = np.array([np.abs(x).max() for x in (t.displacement, t.velocity)])
    ratio = Modes().look(scene).scale / largest
    assert (ratio <= 1.001).all()
    assert (ratio >= 0.75).all()
