"""Statistics of any measured quantity, against known distributions and laws."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.faults import fault_keys
from scipy import stats

from lmpchain import Chain, Impulse, InputError, Scene, simulate, sweep
from lmpchain.disorder import MeasuredEnsemble, measured_over, realisation, statistics, within
from lmpchain.measure import energy, flight, spectrum

CHAIN = Chain(grains=24, diameter=5e-3, material="steel", gravity=0.0, top_load=10.0)
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=1e-4), duration=2e-4, samples=201)
SHORT = SCENE.replace(chain=CHAIN.replace(grains=4), duration=1e-6, samples=2)


@pytest.mark.parametrize("chains", [10, 30, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize("law", [stats.uniform(), stats.gamma(2), stats.expon()])
def test_intervals_cover_the_mean_of_skewed_laws(law: Any, chains: int) -> None:
    """The intervals of 94 to 96 % of 20000 ensembles contain the mean; nearly so if small."""
    draws = 20000
    values = law.rvs((chains, draws), random_state=np.random.default_rng(chains))
    found = MeasuredEnsemble(values, None, 0.0, 0.0)
    low, high = found.interval
    covered = np.mean((low <= law.mean()) & (law.mean() <= high))
    student = stats.t.ppf(0.975, chains - 1) * found.error
    by_student = np.mean(np.abs(found.mean - law.mean()) <= student)
    slack = 3 * np.sqrt(0.05 * 0.95 / draws)
    lowest, highest = {10: (0.935, 0.97), 30: (0.945, 0.965), 100: (0.945, 0.96)}[chains]
    assert lowest - slack < covered < highest + slack
    if law.stats("s") > 1.9:
        assert covered > by_student + 0.003
    # The interval is only a little wider than that of Student.
    assert np.median(high - low) < 1.3 * np.median(2 * student)


def test_the_transformation_is_that_of_hall() -> None:
    """The ends solve ``t + a t^2 / 3 + a^2 t^3 / 27 + a / 6 = t_97.5``, for each skewness a."""
    for chains in (4, 10, 100):
        even = np.linspace(-1, 1, chains)
        # The skewness is large, near 0 in the second and third curve, and 0 in the last.
        curves = [np.sinh(8 * even - 4), even + 1e-12 * even**2, even - 1e-9 * even**2, even]
        found = MeasuredEnsemble(np.stack([-curves[0], *curves], axis=1), None, 0.0, 0.0)
        a = stats.skew(found.values) / np.sqrt(chains)
        ends = (found.mean - np.array(found.interval)) / found.error
        forth = ends + a * ends**2 / 3 + a**2 * ends**3 / 27 + a / 6
        quantile = stats.t.ppf(0.975, chains - 1)
        np.testing.assert_allclose(forth, [[quantile] * 5, [-quantile] * 5], rtol=1e-12)
    alike = MeasuredEnsemble(np.ones((5, 2)), None, 0.0, 0.0)
    np.testing.assert_array_equal(alike.interval, np.ones((2, 2)))


@pytest.mark.parametrize(
    ("chains", "low", "high"), [(5, -np.inf, np.inf), (10, 2, 9), (20, 6, 15), (40, 14, 27)]
)
def test_the_interval_of_a_median_is_that_of_tables(chains: int, low: float, high: float) -> None:
    """The ends are order statistics (W. J. Conover, Practical Nonparametric Statistics)."""
    found = MeasuredEnsemble(np.arange(chains, 0.0, -1.0), None, 0.0, 0.0)
    assert found.quantile_interval(0.5) == (low, high)
    # A value that is not a number may be anywhere in the order.
    curve = np.stack((found.values, np.append(found.values[1:], np.nan)), axis=1)
    ends = MeasuredEnsemble(curve, None, 0.0, 0.0).quantile_interval(0.5)
    np.testing.assert_array_equal(ends, [[low, np.nan], [high, np.nan]])


def test_drawn_factors_come_back() -> None:
    """The masses of random chains have the mean and quantiles of the gamma distribution."""
    found = measured_over(
        SHORT, lambda t: t.scene.chain.masses[1], 4, realisations=400, seed=3, of="mass"
    )
    law = stats.gamma(4, scale=SHORT.chain.masses[1] / 4)
    low, high = found.interval
    assert low < law.mean() < high
    assert found.deviation == pytest.approx(law.std(), rel=0.15)
    for share in (0.05, 0.5, 0.95):
        low, high = found.quantile_interval(share)
        assert low < law.ppf(share) < high
        assert low <= found.quantile(share) <= high
    few = MeasuredEnsemble(found.values[:5], None, 0, 0)
    assert few.quantile_interval(0.9)[1] == np.inf
    assert few.quantile_interval(0.1)[0] == -np.inf
    with pytest.raises(InputError, match="between 0 and 1"):
        few.quantile(1.0)


def test_curves_and_several_quantities_are_those_of_single_runs() -> None:
    """Values of every chain agree with single runs, and statistics with NumPy."""

    def measure(t):
        return {"spectrum": spectrum.spectrum(t).amplitude[:, 5], "top": t.velocity[-1, 0]}

    found = measured_over(SCENE, measure, 5, realisations=18, seed=4, x=np.arange(101))
    for index in (0, 17):
        alone = measure(simulate(realisation(SCENE, 5, seed=4, index=index), "native"))
        curve = found["spectrum"].values[index]
        assert curve == pytest.approx(alone["spectrum"], abs=1e-5 * curve.max())
    spread = found["spectrum"].values
    assert found["spectrum"].error == pytest.approx(spread.std(0, ddof=1) / np.sqrt(18))
    assert found["top"].values.shape == (18,)
    assert found["top"].solver_error < 1e-6
    table = found["spectrum"].to_dataframe()
    assert len(table) == 101
    low, high = found["spectrum"].interval
    columns = {"x": np.arange(101), "mean": spread.mean(0), "deviation": spread.std(0, ddof=1)}
    columns |= {"interval_low": low, "interval_high": high}
    columns |= {f"quantile_{q}": np.quantile(spread, q, axis=0) for q in (0.05, 0.5, 0.95)}
    assert set(table) == {*columns, "error"}
    for name, values in columns.items():
        assert table[name].to_numpy() == pytest.approx(values, rel=1e-12)


@pytest.mark.slow
def test_tolerances_of_modulus_and_load_follow_the_law_of_sound() -> None:
    """The speed is proportional to E^(1/3) F^(1/6), so that relative deviations add in squares."""
    modulus = CHAIN.material.youngs_modulus
    found = within(
        SCENE,
        {"youngs_modulus": 0.06 * modulus, "top_load": 0.9},
        lambda t: flight.time_of_flight(t, 4, 20).speed,
        realisations=300,
        seed=5,
    )
    expected = np.hypot(0.06 / 3, 0.09 / 6)
    assert found.deviation / found.mean == pytest.approx(expected, rel=0.12)
    exact = flight.time_of_flight(simulate(SCENE, "native"), 4, 20).speed
    low, high = found.interval
    # The mean of a concave function is a little below the function of the mean.
    assert low < exact * (1 - 1e-3) < high


def test_tolerances_of_diameters_add_up_to_first_order() -> None:
    """The scatter of an energy is the root of the summed squares of its derivatives."""
    width = 2e-6

    def kinetic(t):
        return energy.ledger(t).kinetic[-1]

    small = SCENE.replace(duration=5e-5, samples=2)
    found = within(
        small,
        {"diameter": width, "excitation.velocity": 1e-6},
        kinetic,
        realisations=300,
        seed=6,
        distribution="uniform",
        tolerance=1e-9,
    )
    slopes = []
    for grain in range(24):
        values = []
        for sign in (1, -1):
            diameters = np.full(24, 5e-3)
            diameters[grain] += sign * width
            chain = CHAIN.replace(diameter=diameters)
            values.append(kinetic(simulate(small.replace(chain=chain), "native", 1e-9)))
        slopes.append((values[0] - values[1]) / 2)
    nominal = kinetic(simulate(small, "native", 1e-9))
    # The energy is proportional to the squared velocity; a uniform law has a third of the square.
    expected = np.sqrt((np.sum(np.square(slopes)) + (2 * nominal * 1e-2) ** 2) / 3)
    assert found.deviation == pytest.approx(expected, rel=0.12)


def test_a_common_diameter_is_one_of_all_grains() -> None:
    """Common properties are drawn once, others for each grain, and seeds are reproducible."""
    options = {"realisations": 2, "seed": 0}

    def spread(t):
        return float(np.ptp(t.scene.chain.diameters))

    one = within(SHORT, {"diameter": 1e-5}, spread, common=("diameter",), **options)
    each = within(SHORT, {"diameter": 1e-5}, spread, **options)
    assert (one.values == 0).all()
    assert (each.values > 1e-6).all()
    again = within(SHORT, {"diameter": 1e-5}, spread, **options)
    assert (again.values == each.values).all()


def test_statistics_of_a_sweep_are_those_of_the_ensemble(tmp_path: Path) -> None:
    """Rows of a sweep over disorder give the same numbers as the same chains run here."""
    disorder = {"m": 5, "seed": 0, "realisations": 6}
    tables = {
        "chain": {"grains": 24, "diameter": 5e-3, "material": "steel", "gravity": 0.0}
        | {"top_load": 10.0},
        "excitation": {"kind": "impulse", "velocity": 1e-4},
        "recording": {"duration": 2e-4, "samples": 3},
    }
    stored = sweep({"scene": tables, "disorder": disorder, "keep": ["velocity"]}, tmp_path)
    found = statistics(stored.velocity, over="realisation")
    here = measured_over(SCENE.replace(samples=3), lambda t: t.velocity, 5, 6, seed=0)
    size = np.abs(here.values).max()
    assert found.values.shape == (6, 3, 24)
    assert found.mean == pytest.approx(here.mean, abs=1e-5 * size)
    assert found.error == pytest.approx(here.error, abs=1e-5 * size)
    with pytest.raises(InputError, match="over"):
        statistics(stored.velocity, over="draw")
    with pytest.raises(InputError, match="missing for 1 of 3"):
        statistics([1.0, np.nan, 2.0])
    with pytest.raises(InputError, match="two chains"):
        statistics([1.0])


def test_pictures_have_labels(rng: np.random.Generator) -> None:
    """A number is drawn as a histogram, a curve as a band; more dimensions are refused."""
    number = MeasuredEnsemble(rng.normal(size=30), None, 0.0, 0.0)
    axes = number.plot(label="speed (m/s)")
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("speed (m/s)", "number of chains")
    marks = [number.values.mean(), *np.quantile(number.values, (0.05, 0.95))]
    assert [line.get_xdata()[0] for line in axes.lines] == pytest.approx(marks, rel=1e-12)
    assert [line.get_label() for line in axes.lines] == ["mean", "5 % below", "95 % below"]
    assert sum(bar.get_height() for bar in axes.containers[0]) == 30
    ends = next(patch for patch in axes.patches if patch.get_label() == "95 %").get_extents()
    shown = axes.transData.inverted().transform_bbox(ends)
    assert (shown.x0, shown.x1) == pytest.approx(number.interval, rel=1e-9)
    curve = MeasuredEnsemble(rng.normal(size=(30, 5)), np.arange(5.0), 0.0, 0.0)
    axes = curve.plot(label="force (N)", x_label="time (s)")
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time (s)", "force (N)")
    np.testing.assert_allclose(axes.lines[0].get_ydata(), curve.values.mean(0), rtol=1e-12)
    bands = {band.get_label(): band.get_datalim(axes.transData) for band in axes.collections}
    quantiles = np.quantile(curve.values, (0.05, 0.95), axis=0)
    for label, (low, high) in (
        ("5 to 95 % of the chains", quantiles), ("mean, 95 %", curve.interval)
    ):  # fmt: skip
        assert (bands[label].y0, bands[label].y1) == pytest.approx((low.min(), high.max()))
        assert (bands[label].x0, bands[label].x1) == (0, 4)
    with pytest.raises(InputError, match="select a curve"):
        MeasuredEnsemble(rng.normal(size=(4, 3, 2)), None, 0.0, 0.0).plot()


@pytest.mark.parametrize(
    ("tolerances", "match"),
    [
        ({}, "dict of numbers"),
        ({"colour": 1.0}, "colour"),
        ({"excitation.times": 1.0}, "excitation.times"),
        ({"top_load": -1.0}, "0 or more"),
        ({"top_load": [1.0, 2.0]}, r"tolerances\.top_load: must be one number, 0 or more"),
        ({3: 1.0}, r"^tolerances: must be .* \(got 3\)"),
        ({"diameter": 1.0}, "so wide"),
    ],
)
def test_wrong_tolerances_are_refused(tolerances: dict, match: str) -> None:
    """The message contains the key."""
    with pytest.raises(InputError, match=match):
        within(SHORT, tolerances, lambda t: 0.0, realisations=3, seed=1)


def test_wrong_measures_are_refused() -> None:
    """A failing measure names the chain; ragged arrays and texts are rejected."""
    with pytest.raises(InputError, match=r"realisations\.0"):
        measured_over(SHORT, lambda t: flight.time_of_flight(t, 2, 3), 5, 3, seed=1)
    with pytest.raises(InputError, match="one shape"):
        measured_over(SHORT, lambda t: "word", 5, 3, seed=1)
    for realisations, seed, key in ((1, 1, "realisations"), (3, -1, "seed")):
        for call in (
            lambda *given: measured_over(SHORT, lambda t: 0.0, 5, *given),
            lambda *given: within(SHORT, {"top_load": 0.1}, lambda t: 0.0, *given),
        ):
            assert fault_keys(call, realisations, seed) == [key]
    for measure, match in (
        (lambda t: 1j * t.velocity[-1], "^measure: must return numbers, or arrays of one shape"),
        (lambda t: np.ma.masked_equal(t.displacement[0], 0.0), "^measure: .*entries are masked"),
        (None, r"^measure: must be a function of a trajectory \(got None\)"),
        (lambda t: None, r"^measure: must return numbers, .* \(got None\)"),
        (lambda t: {str(t.scene.chain.masses[0]): 1.0}, "^measure: must return the same names"),
        (lambda t: t.velocity[-1], r"^x: must be of shape \(4,\), as the values, not \(2,\)"),
    ):
        with pytest.raises(InputError, match=match):
            measured_over(SHORT, measure, 5, 2, seed=1, of="mass", x=[0.0, 1.0])


@pytest.mark.parametrize("common", [("diameters",), "masses", 3, None])
def test_common_properties_of_grains_are_known(common: Any) -> None:
    """A misspelt property was drawn for each grain."""
    with pytest.raises(InputError, match=r"^common: must be "):
        within(SHORT, {"diameter": 1e-6}, lambda t: 0.0, 3, seed=1, common=common)


@pytest.mark.parametrize(
    ("values", "x", "match"),
    [
        ("abc", None, r"^values: must be numbers, in rows of equal length \(got 'abc'\)"),
        ([[1.0, 2.0], [3.0]], None, "^values: must be numbers, in rows of equal length"),
        (np.array([1j, 2.0]), None, "^values: must be numbers, in rows of equal length"),
        (np.ma.array([1.0, 2.0, 9.0], mask=[0, 0, 1]), None, "^values: .*entries are masked"),
        ([[1.0, 2.0], [3.0, 4.0]], [1.0, 2.0, 3.0], r"^x: must be of shape \(2,\)"),
    ],
)
def test_values_without_statistics_are_refused(values: Any, x: Any, match: str) -> None:
    with pytest.raises(InputError, match=match):
        statistics(values, x=x)
    assert len(statistics([1.0, 2.0], x=[1.0, 2.0]).to_dataframe()) == 1
    for share in ("half", [0.5], 0.0, 1.0, np.nan):
        with pytest.raises(InputError, match=r"^share: must be"):
            statistics([1.0, 2.0]).quantile(share)  # type: ignore[arg-type]
