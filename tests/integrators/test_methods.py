"""Properties of methods, schedules of steps, and derivatives of the forcing."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of
from scipy.integrate import DOP853
from scipy.interpolate import make_interp_spline

from lmpchain import Drive, Force, Impulse
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.halving import HalvedAnswer, halve
from lmpchain.integrators.kernels.layout import LEAST_SHARE, STATE
from lmpchain.integrators.methods import METHODS, SPLITTINGS, Splitting
from lmpchain.integrators.observed_run import ImposedCourse
from lmpchain.integrators.stepper import NativeStepper, room_for
from lmpchain.integrators.steps import MANY_STEPS, Steps, first_growth, shorten_steps

# --- properties of methods


def test_methods_have_names_orders_and_evaluations():
    known = {name: (m.order, m.evaluations, m.adaptive) for name, m in METHODS.items()}
    assert known == {
        "verlet": (2, 1, False),
        "rkn4": (4, 6, True),
        "rkn6": (6, 11, True),
        "kahan-li6": (6, 9, True),
        "kahan-li8": (8, 17, True),
        "dop853": (8, 12, True),
        "gear4": (4, 1, False),
    }
    assert all(method.name == name for name, method in METHODS.items())
    assert [METHODS[name].spread for name in ("verlet", "gear4")] == [1.0, 1.0]
    assert METHODS["dop853"].spread == pytest.approx(np.linalg.norm(DOP853.B), rel=1e-15)


@pytest.mark.parametrize("name", SPLITTINGS)
def test_splittings_are_symmetric_and_consistent(name: str):
    splitting = SPLITTINGS[name]
    assert sum(splitting.kicks) == pytest.approx(1, rel=1e-14)
    assert sum(splitting.drifts) == pytest.approx(1, rel=1e-14)
    assert splitting.kicks == splitting.kicks[::-1]
    assert splitting.drifts == splitting.drifts[::-1]
    assert len(splitting.kicks) == len(splitting.drifts) + 1
    assert splitting.reach == pytest.approx(np.cumsum(splitting.drifts), rel=1e-14)
    assert splitting.reach[-1] == 1.0
    if splitting.substeps:
        padded = np.array([0.0, *splitting.substeps, 0.0])
        assert splitting.drifts == splitting.substeps
        assert splitting.kicks == pytest.approx((padded[1:] + padded[:-1]) / 2, rel=1e-15)


def oscillator_step(splitting: Splitting, reach: float) -> np.ndarray:
    """Return one step of x'' = -x of this length."""
    step = np.eye(2)
    for b, a in zip(splitting.kicks, (*splitting.drifts, 0.0), strict=True):
        step = (
            np.array([[1.0, a * reach], [0.0, 1.0]])
            @ np.array([[1.0, 0.0], [-b * reach, 1.0]])
            @ step
        )
    return step


@pytest.mark.parametrize("name", SPLITTINGS)
def test_the_growth_of_a_splitting_is_that_of_its_matrix(name: str):
    splitting = SPLITTINGS[name]
    limit = splitting.stability_limit
    for factor in (0.3, 0.999, 1.01, 1.05):
        largest = np.abs(np.linalg.eigvals(oscillator_step(splitting, factor * limit))).max()
        assert splitting.growth(factor * limit) == pytest.approx(largest, rel=1e-7)
    assert splitting.growth(0.5 * limit) == 1.0


def test_velocity_verlet_is_unstable_from_2_on():
    verlet = SPLITTINGS["verlet"]
    assert verlet.stability_limit == pytest.approx(2.0, abs=2e-4)
    for reach in (2.1, 2.5, 3.0):
        assert verlet.growth(reach) == pytest.approx(np.exp(2 * np.arccosh(reach / 2)), rel=1e-12)
    exactly = Splitting("exactly stable", 1, (0.0, 0.0), (1.0,), 1.0, "a drift alone")
    assert exactly.stability_limit == 8.0


def test_dop853_grows_like_its_stability_function():
    """R(z) = 1 + z b (1 - z A)^-1 1 at z = i omega h equals e^z up to order 8."""
    method = METHODS["dop853"]
    for reach in (0.5, 1.0, 3.0, 6.0):
        y = np.array([1.0 + 0j])
        z = 1j * reach
        slopes = []
        for row in DOP853.A[:12, :12]:
            slopes.append(z * (y + sum((a * k for a, k in zip(row, slopes, strict=False)), 0)))
        true = abs(y + sum(b * k for b, k in zip(DOP853.B, slopes, strict=True)))[0]
        assert method.growth(reach) == pytest.approx(true, rel=1e-10)
    limit = method.stability_limit
    assert method.growth(limit - 1e-3) <= 1 + 1e-12 < method.growth(limit)
    assert limit == pytest.approx(np.round(limit, 3), rel=1e-15)


def gear_growth(reach: float) -> float:
    """Return the largest growth factor per step of the five values for x'' = -x."""
    pascal = np.array(
        [[1, 1, 1, 1, 1], [0, 1, 2, 3, 4], [0, 0, 1, 3, 6], [0, 0, 0, 1, 4], [0, 0, 0, 0, 1.0]]
    )
    corrections = np.array([19 / 120, 3 / 4, 1, 1 / 2, 1 / 12])
    columns = []
    for values in np.eye(5):
        predicted = pascal @ values
        off = -(reach**2) / 2 * predicted[0] - predicted[2]
        columns.append(predicted + corrections * off)
    return float(np.abs(np.linalg.eigvals(np.array(columns).T)).max())


def test_gear_grows_by_a_hundredth_at_its_limit():
    method = METHODS["gear4"]
    for reach in (0.1, 0.5, 1.0, 2.0):
        assert method.growth(reach) == pytest.approx(gear_growth(reach), rel=1e-10)
    limit = method.stability_limit
    assert gear_growth(limit - 1e-3) <= 1.01 < gear_growth(limit)


def test_the_first_growth_is_found_on_a_grid_of_thousandths():
    assert first_growth(lambda reach: 1 + reach - 0.0015, 0.0) == 0.002
    assert first_growth(lambda reach: 1 + (reach > 2) * 0.5, 0.4) == 2.001
    assert first_growth(lambda reach: 1 + reach, 9.99) == pytest.approx(9.991, rel=1e-15)


# --- schedules


@pytest.mark.parametrize("stride", [1, 3, 4])
@pytest.mark.parametrize("steps", [1, 2, 7, 10])
def test_the_total_counts_steps_no_longer_than_those_between_landings(stride: int, steps: int):
    schedule = Steps(steps, stride, 1.0, False)
    for samples in range(1, 20):
        whole, rest = divmod(samples, stride)
        expected = whole * steps + int(np.ceil(Fraction(rest * steps, stride)))
        assert schedule.total(samples) == expected


FEW = Steps(3, 1, 1e-9, True, coarse_openings=True)
DENSE = [
    *((3, 6, 2, 4), (3, 5, 2, 2), (4, 8, 2, 4), (5, 8, 2, 2), (9, 8, 2, 1), (8, 8, 2, 2)),
    *((16, 8, 4, 2), (3, 2, 2, 1), (3, 3, 2, 2)),
]


def test_steps_of_auxiliary_runs():
    """Few steps land on fewer samples, many steps on all samples that the main run lands on.

    With interpolation every fourth, every second or every sample is compared, once a step or more.
    """
    many = MANY_STEPS
    odd = Steps(many // 2 + 1, 1, (many + 1) * 1e-9 / (many // 2 + 1), True, 2)
    cases: list[tuple[Steps, float, Steps]] = [
        (FEW, 2, Steps(3, 2, 2e-9, True, 2, True)),
        (FEW, 1.5, Steps(2, 1, 1.5e-9, True, 1.5, True)),
        (Steps(4, 1, 1e-9, True), 2, Steps(2, 1, 2e-9, True, 2)),
        (Steps(2, 1, 1e-9, True), 1.25, Steps(8, 5, 1.25e-9, True, 1.25)),
        (Steps(many - 1, 1, 1e-9, True), 2, Steps(many - 1, 2, 2e-9, True, 2)),
        (Steps(many, 1, 1e-9, True), 2, Steps(many // 2, 1, 2e-9, True, 2)),
        (Steps(many + 1, 1, 1e-9, True), 2, odd),
    ]
    for steps, stride, ratio, dense in DENSE:
        fewer = -(-steps // ratio)
        longer = Steps(fewer, stride, 1e-9 * steps / fewer, True, ratio, dense=dense)
        cases.append((Steps(steps, stride, 1e-9, True, dense=1), ratio, longer))
    for own, ratio, longer in cases:
        found = own.longer(ratio)
        assert found == longer._replace(step=found.step)
        assert found.step == pytest.approx(longer.step, rel=1e-15)


def test_half_the_step_doubles_the_number_of_steps():
    halved = Steps(3, 2, 1e-9, True, 1.0, True, 1).halved
    assert halved == Steps(6, 2, 5e-10, True, 0.5, True, 1)


def test_steps_that_land_on_every_sample_or_are_shorter():
    own = Steps(7, 3, 1e-9, True, coarse_openings=True, dense=1)
    assert own.filled == 1
    assert own._replace(dense=0).filled == 3
    sampled = own.sampled
    assert sampled == Steps(3, 1, sampled.step, True, coarse_openings=True)
    assert sampled.step == pytest.approx(7e-9 / 9, rel=1e-15)
    shorter = own.shorten(28)
    assert shorter == Steps(28, 3, shorter.step, True, dense=1)
    assert shorter.step == pytest.approx(2.5e-10, rel=1e-15)


def test_the_longest_step_between_kinks_is_that_of_equal_steps_between_landings(rng):
    landing = 2.0
    schedule = Steps(4, 2, landing / 4, True)
    begins = np.append(rng.uniform(0, 5, 50), [2.0, 2.0, 2.1, 0.0])
    ends = np.append(begins[:50] + rng.uniform(0.01, 6, 50), [4.0, 2.2, 2.2, 0.1])
    expected = []
    for begin, end in zip(begins, ends, strict=True):
        landings = [n * landing for n in range(10) if begin < n * landing < end]
        lengths = np.diff([begin, *landings, end])
        expected.append((lengths / np.ceil(lengths / schedule.step - 1e-6)).max())
    assert schedule.longest_between(begins, ends) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("exponent", "order"), [(1.5, 6), (2.0, 8)])
@pytest.mark.parametrize("coarse", [False, True])
def test_the_step_across_an_opening_has_a_lower_bound(coarse: bool, exponent: float, order: int):
    """Its error has the order of the other steps, or is below rounding; steps keep their ratio."""
    scenes = [
        scene_of(column(6, diameter=d, exponent=exponent), Impulse(velocity=1e-3), 1e-5)
        for d in (1e-3, 2e-3)
    ]
    batch = ChainBatch(scenes)
    omega = batch.arrays.omega
    shortened = 0.4 if coarse else 0.2
    falls = 1 / (exponent + 1)
    for phase in (1e-3, 0.3):
        own = Steps(4, 1, phase / omega[0], True, coarse_openings=coarse)
        found = shorten_steps(order, batch, [own, own.longer(2)])
        assert found.shortened == shortened
        assert found.close == pytest.approx(shortened ** (-14 / 3), rel=1e-14)
        reach = np.outer([own.step, 2 * own.step], omega)
        least = np.outer([1, 2], [0.1 * np.finfo(float).eps ** falls] * 2)
        expected = np.maximum(0.03 ** (2.5 * falls) * reach ** ((order + 1) * falls), least)
        assert (expected > least).all() == (phase == 0.3)
        # A step at the largest nearness n has the length h' = shortened n^(-9/14) h.
        crossing = shortened * found.nearest ** (-9 / 14) * reach
        assert crossing == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("excesses", "most", "best", "calls"),
    [
        ([8.0, 2.0, 1.0, 0.1], 9, 1.0, 3),
        ([8.0, 4.0, 5.0, 6.0, 0.1], 4, 4.0, 4),
        ([0.5, 0.1], 9, 0.5, 1),
        ([3.0, 0.1], 1, 3.0, 1),
    ],
)
def test_steps_are_halved_until_the_error_is_allowed(excesses, most, best, calls):
    """If no result is accurate enough, the best one is returned."""
    asked = []

    def solve(halvings: int) -> HalvedAnswer[int]:
        asked.append(halvings)
        return HalvedAnswer(halvings, excesses[halvings])

    assert halve(solve, most) == HalvedAnswer(excesses.index(best), best)
    assert asked == list(range(calls))


# --- the forcing as a function of amplitude and frequency, or of samples

TIMES = np.array([0.0, 1.0, 2.5, 4.0, 6.0]) * 1e-5
ACTS = {
    "sine": Drive(amplitude=2e-8, frequency=3e4),
    "burst": Force(amplitude=0.2, frequency=6e4, cycles=1.7),
    "half-sine": Force(shape="half-sine", amplitude=0.2, duration=3e-5),
    "piston": Drive(shape="piston", velocity=2e-3, rise=2e-5),
    "linear": Drive(
        times=TIMES, displacement=np.array([0, 1, -2, 3, 1]) * 1e-8, interpolation="linear"
    ),
    "spline": Drive(
        times=TIMES, displacement=np.array([0, 1, 3, 4, 5]) * 1e-8, interpolation="spline"
    ),
}


def changed(excitation: Drive | Force, place: int, value: float) -> Drive | Force:
    if excitation.times is None:
        return excitation.replace(**{("amplitude", "frequency")[place]: value})
    samples = np.array(excitation.displacement)
    samples[place] = value
    return excitation.replace(displacement=samples)


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("what", ACTS)
def test_derivatives_of_the_forcing_agree_with_differences(
    rng: np.random.Generator, what: str, order: int
):
    """Adjoint and tangent at samples before, between and after the given ones."""
    excitation = ACTS[what]
    course = ImposedCourse(excitation)
    times = np.array([0.0, 0.3, 1.0, 1.7, 2.4, 4.4, 5.9, 6.6]) * 1e-5
    samples = excitation.times is not None
    base = [excitation.amplitude, excitation.frequency or 0.0]
    if samples or what == "piston":
        base = excitation.displacement if samples else [excitation.velocity]
    base = np.array(base)
    assert course.size == base.size
    slopes = np.zeros((base.size, times.size))
    for place in range(base.size):
        if samples:  # Both curves are linear in their samples.
            degree = 1 if what == "linear" else 3
            curve = make_interp_spline(TIMES, np.eye(5)[place], degree)
            # The body keeps its position after the last sample.
            late = times > TIMES[-1]
            slopes[place] = np.where(late, (order == 0) * curve(TIMES[-1]), curve(times, order))
        elif place == 0:
            slopes[place] = excitation.waveform.at(times, order) / base[0]
        elif excitation.frequency:
            h = 1e-4 * excitation.frequency
            end = excitation.waveform.end
            values = []
            for sign in (1, -1, 2, -2):
                wave = changed(excitation, place, excitation.frequency + sign * h).waveform
                # A waveform that ends later is unchanged.
                wave = replace(wave, end=end if np.isinf(end) else 1.0)
                values.append(wave.at(times, order) * (times < end))
            slopes[place] = (8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * h)
    scale = np.abs(slopes).max(1, keepdims=True) + 1e-300
    assert (
        np.abs(course.push(times, np.eye(base.size), order) / scale - slopes / scale).max() < 1e-9
    )
    weights = rng.normal(size=times.size)
    assert course.pull(times, weights, order) / scale[:, 0] == pytest.approx(
        slopes @ weights / scale[:, 0], abs=1e-9
    )
    grid = times.reshape(1, -1)
    assert course.push(grid, np.ones((3, base.size)), order).shape == (3, 1, times.size)


# --- steppers

SCENES = [scene_of(column(6), Impulse(velocity=v), 2e-5, 9) for v in (1e-3, 2e-3)]


def stepper(companions: int = 0, state=None, **options) -> NativeStepper:
    own = Steps(3, 1, SCENES[0].duration / 24, False)
    beside = [own.longer(2), own.longer(4)][:companions]
    return NativeStepper(
        ChainBatch(SCENES), METHODS["verlet"], own, state or {}, auxiliary=beside, **options
    )


def test_progress_is_the_fraction_of_landings():
    """An auxiliary run with half as many landings has half the weight."""
    run = stepper(1)
    assert run.progress == 0
    assert run.own_part == 0
    fields = np.zeros((2, 2, 9, 6))
    beside = np.zeros((2, 1, 2, 9, 6))
    run.fill(*fields, 0, 4, 2**62, tuple(beside))
    assert run.sample == 4
    assert run.steps.tolist() == [12, 12]
    assert run.progress == pytest.approx(0.5, rel=1e-15)
    assert run.own_part == pytest.approx(2 / 3, rel=1e-15)
    run.fill(*fields, 0, 5, 3, tuple(beside))  # One more sample of the first chain.
    assert run.sample == 4
    assert run.progress == pytest.approx((4.5 + 2) / 12, rel=1e-15)
    assert run.stride == 1


def test_skipped_chains_keep_their_state():
    run = stepper()
    fields = np.zeros((2, 2, 9, 6))
    run.fill(*fields, 0, 3, 2**62)
    before = run.state()
    run.leave(np.array([[False, True]]), 8)
    assert run.sample == 3
    assert run.state()["state"]["sample"].tolist() == [3, 8]
    run.fill(*fields, 0, 8, 2**62)
    after = run.state()
    assert np.array_equal(before["u"][0, 1], after["u"][0, 1])
    assert not np.array_equal(before["u"][0, 0], after["u"][0, 0])
    assert not fields[:, 1, 4:].any()


def test_states_of_other_shapes_are_rejected():
    kept = stepper().state()
    assert stepper(state=kept).sample == 0
    narrow = kept | {"state": kept["state"][list(STATE.names[:-1])]}
    fewer = kept | {"state": kept["state"][:1]}
    whole = kept | {"state": kept["state"]["sample"]}
    history = kept | {"history": np.zeros((2, 1, kept["history"].shape[2]))}
    for wrong in (narrow, fewer, whole, history):
        with pytest.raises(ValueError, match="does not belong"):
            stepper(state=wrong)
    for place, value in (
        ("first", 4),
        ("first", 16),
        ("last", 24),
        ("last", 8),
        ("sample", 1),
        ("done", np.inf),
        ("done", np.nan),
    ):
        moved = kept | {"state": kept["state"].copy()}
        moved["state"][place][1] = value
        with pytest.raises(ValueError, match="does not belong"):
            stepper(state=moved)


def test_arrays_of_long_chains_are_zero():
    u, v = room_for(2, 3, 600)
    assert u.shape == v.shape == (2, 3, 600)
    assert not u.any()
    assert not v.any()
    assert [field.shape for field in room_for(4, 5)] == [(4, 5)] * 2


def test_threads_share_a_long_chain_or_a_batch():
    long = scene_of(column(2 * LEAST_SHARE), Impulse(velocity=1e-3), 1e-6)
    own = Steps(2, 1, 1e-8, False)
    for scenes, threads, teams, works in (
        ([long], 2, 2, 2),
        ([long], 3, 2, 2),
        (SCENES, 3, 1, 2),
        (SCENES, 1, 1, 1),
    ):
        run = NativeStepper(ChainBatch(scenes), METHODS["verlet"], own, {}, threads)
        assert len(run.teams) == teams
        assert len(run.shares) == works
        ranges = [share[1:] for share in run.shares]
        assert (
            ranges == [(0, 1), (1, 2)]
            if works == 2 and teams == 1
            else all(r[0] == 0 for r in ranges)
        )
        run.close()
