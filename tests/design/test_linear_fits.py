"""Fits of linear unknowns against closed-form least squares, and traces against plain NumPy."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from lmpchain import Chain, Impulse, InputError, Scene, simulate
from lmpchain.design import Traces, fit
from lmpchain.design.unknowns import Problem
from lmpchain.engines import Native
from lmpchain.measure.fit.table import round_to_error

WEAK = 1e-9  # Strike velocity, m/s, for which the motion is linear to 1e-7.
CHAIN = Chain(grains=6, diameter=2e-3, top_load=0.5, gravity=9.81, top="wall", bottom="wall")
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=WEAK), duration=6e-5, samples=61)
NOISE = np.array([2e-2, 5e-2]) * WEAK


@cache
def wave() -> np.ndarray:
    """Return velocities (T, 2) of grains 2 and 5 for a strike of 1 m/s on the linear chain."""
    return simulate(SCENE, "modes").velocity[:, [1, 4]] / WEAK


def noisy(seed: int, offset: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    drawn = np.random.default_rng(seed).standard_normal((61, 2))
    return 1.1 * WEAK * wave() + np.array(offset) + NOISE * drawn


def columns() -> np.ndarray:
    """Return the derivatives (R, 3) of all residuals by velocity and both offsets."""
    rows = np.zeros((61, 2, 3))
    rows[..., 0] = wave()
    rows[:, 0, 1] = 1.0
    rows[:, 1, 2] = 1.0
    return (rows / NOISE[:, None]).reshape(-1, 3)


@pytest.mark.parametrize("known", [True, False])
def test_a_linear_fit_is_that_of_the_normal_equations(known: bool):
    """Estimate, covariance, chi square and profiles, with known or unknown noise.

    Without it residuals are in m/s, 1e-9, and the search for the least squares stopped where it
    began.
    """
    offset = (0.3 * WEAK, -0.2 * WEAK)
    values = noisy(1, offset)
    matrix = columns()
    if not known:
        matrix = matrix * np.tile(NOISE, 61)[:, None]
    scale = NOISE if known else 1.0
    right = (values / scale).ravel()
    estimate, square, _, _ = np.linalg.lstsq(matrix / [1.0, 1.0, 1.0], right, rcond=None)
    inverse = np.linalg.inv(matrix.T @ matrix)
    variance = 1.0 if known else square[0] / 119
    answer = fit(
        Traces(SCENE.time, [2, 5], values, noise=NOISE if known else None, offset=True),
        SCENE,
        ["velocity"],
    )
    assert answer.names == ["velocity", "offset 2", "offset 5"]
    deviation = np.sqrt(variance * np.diag(inverse))
    assert np.abs(answer.estimate - estimate).max() < 1e-3 * deviation.max()
    rtol = 5e-4  # The error of steps that are as long as the noise allows.
    np.testing.assert_allclose(answer.covariance, variance * inverse, rtol=rtol)
    np.testing.assert_allclose(answer.error, deviation, rtol=rtol)
    assert answer.chi_square == pytest.approx(square[0] if known else 119, rel=1e-4)
    assert answer.freedom == 119
    assert (answer.bias < 0.05 * deviation + 1e-9 * WEAK).all()
    assert answer.values["velocity"][0] == pytest.approx(answer.estimate[0], rel=1e-12)
    assert answer.scene.excitation.initial(CHAIN)[1][0] == pytest.approx(
        answer.estimate[0], rel=1e-12
    )
    for place in (0, 2):
        at, growth = answer.profile(answer.names[place], reach=2.0, points=3)
        np.testing.assert_allclose(
            at, answer.estimate[place] + deviation[place] * np.array([-2, 0, 2]), rtol=rtol
        )
        np.testing.assert_allclose(growth, [4.0, 0.0, 4.0], rtol=1e-3, atol=1e-5)


def test_a_profile_of_a_single_parameter_is_a_parabola():
    answer = fit(Traces(SCENE.time, [2, 5], noisy(2), noise=NOISE), SCENE, ["velocity"])
    at, growth = answer.profile("velocity")
    offsets = np.linspace(-3, 3, 13)
    np.testing.assert_allclose(
        (at - answer.estimate[0]) / answer.error[0], offsets, rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(growth, offsets**2, rtol=1e-4, atol=1e-6)
    with pytest.raises(InputError, match=r"^name: must be one of velocity \(got 'offset'\)"):
        answer.profile("offset")


def test_a_fit_is_written_and_drawn_with_its_data():
    values = noisy(3)
    answer = fit(Traces(SCENE.time, [2, 5], values, noise=NOISE), SCENE, ["velocity"])
    lines = answer.table().splitlines()
    assert [line.split() for line in lines] == [
        ["quantity", "value", "error", "unit"],
        [
            "velocity",
            round_to_error(answer.estimate[0], answer.error[0]),
            f"{answer.error[0]:.1g}",
            "m/s",
        ],
        f"chi square: {answer.chi_square:.5g} of 121".split(),
    ]
    assert str(answer) == answer.table()
    ax = answer.plot()
    names = ["velocity of grain 2", "velocity of grain 5"]
    assert [line.get_label() for line in ax.lines][1::2] == names
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time", "velocity, downward")
    assert ax.yaxis.get_major_formatter()(2e-3) == "2 mm/s"
    for column, (dots, line) in enumerate(zip(ax.lines[::2], ax.lines[1::2], strict=True)):
        np.testing.assert_array_equal(dots.get_xdata(), SCENE.time)
        np.testing.assert_array_equal(line.get_xdata(), SCENE.time)
        np.testing.assert_array_equal(dots.get_ydata(), values[:, column])
        exact = answer.estimate[0] * wave()[:, column]
        np.testing.assert_allclose(line.get_ydata(), exact, rtol=0, atol=1e-4 * np.abs(exact).max())
        assert (dots.get_marker(), dots.get_linestyle(), line.get_linestyle()) == (".", "None", "-")
        assert dots.get_color() == line.get_color()
    assert ax.lines[0].get_color() != ax.lines[2].get_color()
    assert ax.xaxis.get_major_formatter()(2e-5).endswith("s")
    assert ax.get_legend() is not None


def test_traces_of_several_units_have_separate_axes():
    force = Traces(SCENE.time, [3], 1e-3 * noisy(4)[:, 0], field="contact", noise=1e-3)
    answer = fit([Traces(SCENE.time, [2, 5], noisy(3), noise=NOISE), force], SCENE, ["velocity"])
    upper, lower = answer.plot()
    assert (upper.get_ylabel(), lower.get_ylabel()) == ("velocity, downward", "force above rest")
    assert lower.yaxis.get_major_formatter()(2e-3) == "2 mN"
    assert [line.get_label() for line in lower.lines][1::2] == ["contact 3"]
    with pytest.raises(InputError, match="give 2 axes"):
        answer.plot(upper)
    silent = Traces(SCENE.time, [2, 5], noisy(3))
    with pytest.raises(InputError, match=r"noise: .* squares of N and m/s cannot be added"):
        fit([silent, force], SCENE, ["velocity"])
    known = Traces(SCENE.time, [3], noisy(4)[:, 0], noise=NOISE[0])
    with pytest.raises(InputError, match=r"^noise: must be given for each trace or for none"):
        fit([silent, known], SCENE, ["velocity"])
    with pytest.raises(InputError, match=r"^scene: must be a Scene \(got None\)"):
        fit(known, None, ["velocity"])  # type: ignore[arg-type]


def test_as_many_unknowns_as_values_need_a_given_noise():
    """Residuals of 0 do not show the noise; the errors were 0, too."""
    options = {"time": SCENE.time[[20, 40]], "places": [2], "values": noisy(1)[[20, 40], 0]}
    with pytest.raises(
        InputError,
        match=r"^noise: must be given, because 2 values do not show it beside 2 ",
    ):
        fit(Traces(**options, offset=True), SCENE, ["velocity"])
    exact = fit(Traces(**options, offset=True, noise=NOISE[0]), SCENE, ["velocity"])
    response = wave()[[20, 40], 0]
    # The noise of a difference over the difference of the responses.
    assert exact.error[0] == pytest.approx(2**0.5 * NOISE[0] / abs(np.ptp(response)), rel=1e-3)
    assert exact.freedom == 0
    # A third value shows the noise.
    more = options | {"time": SCENE.time[20:41:10], "values": noisy(1)[20:41:10, 0]}
    assert fit(Traces(**more, offset=True), SCENE, ["velocity"]).freedom == 1


def test_estimates_have_their_units():
    """Common values have a unit; a factor of different entries has none."""
    sizes = SCENE.replace(chain=CHAIN.replace(masses=CHAIN.masses * np.linspace(1, 2, 6)))
    for scene, unit in ((SCENE, "kg"), (sizes, "")):
        problem = Problem(scene, [Traces(SCENE.time, [2, 5], noisy(2))], {"masses": "common"})
        assert problem.symbols == [unit]
    trace = Traces(SCENE.time, [2, 5], noisy(2), trigger=True, gain=True, offset=True)
    problem = Problem(SCENE, [trace], {"velocity": "common", "masses": [3]})
    assert problem.names[:4] == ["velocity", "masses 3", "trigger", "gain"]
    assert problem.symbols == ["m/s", "kg", "s", "", "m/s", "m/s"]


def test_numbers_of_several_traces_have_names_units_and_begins():
    """Each fitted number of a trace has a name, a unit and an initial value.

    Triggers are in durations, gains in 1, offsets in the largest value, and entries in their units.
    """
    one = Traces(SCENE.time, [2, 5], noisy(1), trigger=True, gain=True, offset=True)
    two = Traces(SCENE.time[5:], [3], 4 * noisy(1)[5:, :1], offset=True)
    wanted = {
        "masses": [2, 4],
        "displacement": [3],
        "top_load": "common",
        "diameters": "common",
        "velocity": "each",
    }
    problem = Problem(SCENE, [one, two], wanted)
    velocity = [f"velocity {n}" for n in range(1, 7)]
    assert problem.names == [
        "masses 2",
        "masses 4",
        "displacement 3",
        "top_load",
        "diameters",
        *velocity,
        "trigger 1",
        "gain 1",
        "offset 1 2",
        "offset 1 5",
        "offset 2 3",
    ]
    m = CHAIN.masses[0]
    largest = np.abs(noisy(1)).max()
    second = 4 * np.abs(noisy(1)[5:, 0]).max()
    origin = [m, m, 0.0, 0.5, 2e-3, WEAK, 0, 0, 0, 0, 0, 0.0, 1.0, 0.0, 0.0, 0.0]
    units = [m, m, 1.0, 0.5, 2e-3, *[WEAK] * 6, 6e-5, 1.0, largest, largest, second]
    np.testing.assert_allclose(problem.origin, origin, rtol=1e-12)
    np.testing.assert_allclose(problem.units, units, rtol=1e-12)
    theta = np.arange(16.0) / 100
    np.testing.assert_allclose(
        problem.estimates(theta), np.array(origin) + np.array(units) * theta, rtol=1e-12
    )
    np.testing.assert_allclose(problem.free(problem.estimates(theta)), theta, rtol=1e-9, atol=1e-15)
    values = problem.by_name(theta)
    masses = CHAIN.masses.copy()
    masses[[1, 3]] *= [1.0, 1.01]
    np.testing.assert_allclose(values["masses"], masses, rtol=1e-12)
    np.testing.assert_allclose(values["displacement"], [0, 0, 0.02, 0, 0, 0], rtol=1e-12)
    np.testing.assert_allclose(values["top_load"], [0.5 * 1.03], rtol=1e-12)
    np.testing.assert_allclose(values["diameters"], np.full(6, 2e-3 * 1.04), rtol=1e-12)
    np.testing.assert_allclose(
        values["velocity"], WEAK * (np.arange(6) == 0) + WEAK * theta[5:11], rtol=1e-12
    )
    uneven = SCENE.replace(chain=CHAIN.replace(diameter=[1e-3, 2e-3, 1e-3, 2e-3, 1e-3, 1e-3]))
    common = Problem(uneven, [one], {"diameters": "common"})
    assert (common.origin[0], common.units[0]) == (1.0, 1.0)  # A factor.
    np.testing.assert_allclose(
        common.by_name(np.array([0.1, 0, 0, 0, 0]))["diameters"], 1.1 * uneven.chain.diameters
    )
    turn = SCENE.duration * SCENE.highest_frequency / problem.looks
    assert 0.45 < turn <= 0.5
    np.testing.assert_array_equal(problem.grains, [2, 3, 5])
    assert Problem(SCENE.replace(duration=1e-9), [one], {"masses": "common"}).looks == 8
    for how in ("all", [0], [7], [1, 9]):
        with pytest.raises(
            InputError, match=r'^masses: must be "common", "each" or numbers from 1 to 6'
        ):
            Problem(SCENE, [one], {"masses": how})
    with pytest.raises(InputError, match=r"^displacement: is 0 everywhere"):
        Problem(SCENE, [one], {"displacement": "common"})


@pytest.mark.parametrize("field", ["velocity", "displacement", "force", "contact"])
def test_traces_are_what_another_integrator_says(field: str):
    """Traces are delayed by a trigger, scaled by a gain and shifted by an offset.

    Before the strike the grains rest.
    """
    chain = CHAIN.replace(top_load=0.05)
    late = 7.3e-6
    gain = 1.3
    scene = SCENE.replace(chain=chain, excitation=Impulse(velocity=0.02), samples=601)
    run = simulate(scene, engine=Native(integrator="dop853"), tolerance=1e-10)
    u = run.displacement
    law = chain.contacts
    closer = -np.diff(u, axis=1, prepend=0.0, append=0.0)
    force = law.constant * np.maximum(law.overlap + closer, 0.0) ** 1.5 - law.force
    places = [1, 4, 6] if field != "contact" else [0, 3, 6]
    whole = {
        "velocity": run.velocity[:, [0, 3, 5]],
        "displacement": u[:, [0, 3, 5]],
        "force": ((force[:, :-1] + force[:, 1:]) / 2)[:, [0, 3, 5]],
        "contact": force[:, [0, 3, 6]],
    }[field]
    size = np.abs(whole).max()
    time = scene.time[::10] + late
    time = np.concatenate(([late / 2], time))
    offset = size * np.array([0.1, -0.2, 0.3])
    expected = gain * np.concatenate((np.zeros((1, 3)), whole[::10])) + offset
    traces = Traces(
        time, places, np.zeros((62, 3)), field, noise=2.0, trigger=True, gain=True, offset=True
    )  # type: ignore[arg-type]
    problem = Problem(scene, [traces], {"masses": [2]})
    problem.looks *= 16
    theta = problem.free(np.array([chain.masses[1], late, gain, *offset]))
    (model,) = problem.predict(theta)
    assert np.abs(model - expected).max() < 3e-5 * size
    left, _ = problem.residuals(theta)
    np.testing.assert_allclose(left, model.ravel() / 2.0, rtol=1e-12)


def test_invalid_places_and_values_are_rejected():
    scene = SCENE.replace(chain=CHAIN.replace(top="free"))
    zeros = np.zeros(3)
    for field, place, allowed in (
        ("velocity", 0, "1 to 6"), ("force", 7, "1 to 6"), ("contact", 7, "1 to 6"),
        ("contact", -1, "1 to 6"),
        ("contact", 0, "1 to 6"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=f"^places: the chain has no {place}: use {allowed}$"):
            Traces([0, 1, 2], [place], zeros, field).grains(scene)  # type: ignore[arg-type]
    three = np.zeros((3, 2))
    assert Traces([0, 1, 2], [1, 6], three).grains(scene) == [1, 6]
    assert Traces([0, 1, 2], [1, 4], three, "force").grains(scene) == [1, 2, 3, 4, 5]
    assert Traces([0, 1, 2], [1, 6], three, "contact").grains(scene) == [1, 2, 6]
    assert Traces([0, 1, 2], [0, 3], three, "contact").grains(SCENE) == [1, 3, 4]
    for given, message in (
        (([0.0], [1], [0.0]), "^time: must be two or more increasing numbers"),
        (([0.0, np.inf], [1], [0.0, 0.0]), "^time: must be two"),
        (([1.0, 0.0], [1], [0.0, 0.0]), "^time: must be two"),
        (([[0.0, 1.0]], [1], [0.0, 0.0]), "time: must be two"),
        (
            ([0.0, 1.0], [1, 2], [0.0, 0.0]),
            r"^values: must be of shape \(2, 2\), times and places, not \(2, 1\)",
        ),
        (
            ([0.0, 1.0], [1], [0.0, 0.0], "speed"),
            "^field: must be one of velocity, displacement, force, contact",
        ),
        (([0.0, 1.0], [1], [0.0, 0.0], "force", 0.0), "^noise: must be above 0"),
        (([0.0, 1.0], [1, 2], np.zeros((2, 2)), "force", [1.0, -1.0]), "^noise: must be above 0"),
        (([0.0, 1.0], [1], [0.0, 0.0], "force", np.inf), "^noise: must be above 0"),
        (([0.0, 1.0], [1, 2], np.zeros((2, 2)), "force", [1.0]), "^noise: must be one number or 2"),
        (([0.0, 1.0], [], np.zeros((2, 0))), "^places: must name a grain or a contact"),
    ):
        with pytest.raises(InputError, match=message):
            Traces(*given)  # type: ignore[arg-type]
    assert Traces([0, 1], 3, [5, 6]).values.tolist() == [[5.0], [6.0]]
    defaults = Traces([0, 1], [3], [5, 6])
    assert (defaults.field, defaults.noise) == ("velocity", None)
    assert (defaults.trigger, defaults.gain, defaults.offset) == (False, False, False)


def test_a_table_of_numbers_needs_two_complete_lines(tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_text("Source;CH1\ntime,CH1,CH2\n0.0,1e-3,2\n1e-6,2e-3,3,\n\n2e-6,3e-3,4\n")
    traces = Traces.from_csv(path, [1, 5], field="force", noise=0.1)
    np.testing.assert_array_equal(traces.time, [0, 1e-6, 2e-6])
    np.testing.assert_array_equal(traces.values, [[1e-3, 2], [2e-3, 3], [3e-3, 4]])
    assert (traces.field, traces.noise) == ("force", 0.1)
    rows = traces.to_dataframe()
    assert list(rows) == ["time [s]", "force_1 [N]", "force_5 [N]"]
    np.testing.assert_array_equal(rows, np.c_[traces.time, traces.values])
    for text, message in (
        ("", "no table of numbers"),
        ("a,b\n1,2\n", "needs two lines of numbers: time, velocity_4"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            Traces.from_csv(path, [4])
    path.write_text("0.0,1.0\n0.5,2.0\n")
    assert Traces.from_csv(path, [4]).time.size == 2
    with pytest.raises(InputError, match="No such file"):
        Traces.from_csv(tmp_path / "none.csv", [1])


def test_a_scene_must_reach_to_the_last_value():
    """The tolerance is a millionth; with a trigger, the strike may shift the last value."""
    time = SCENE.time * (1 + 1e-4)
    with pytest.raises(
        InputError, match=r"^duration: must reach the last value of the traces: use 6.0006e-05 s"
    ):
        fit(Traces(time, [2, 5], noisy(1)), SCENE, ["velocity"])
    nearly = fit(Traces(SCENE.time * (1 + 1e-7), [2, 5], noisy(1)), SCENE, ["velocity"])
    assert nearly.estimate[0] == pytest.approx(1.1 * WEAK, rel=0.02)
    late = Traces(SCENE.time - 1e-6, [2, 5], 1.1 * WEAK * wave(), trigger=True)
    with pytest.raises(
        InputError, match=r"^duration: must reach the last value of the traces: use 6.00"
    ):
        fit(late, SCENE.replace(duration=5.95e-5), ["velocity"])
