"""Text, JSON and pictures of sensitivities, optima and boxes; random draws against closed forms."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import scene_of
from scipy.optimize import minimize
from scipy.special import roots_hermitenorm

from lmpchain import Chain, Drive, Impulse, InputError, Profile, Scene
from lmpchain.design import (
    ArrivalTime,
    Energy,
    Function,
    KineticEnergy,
    Momentum,
    PeakForce,
    optimise,
)
from lmpchain.design.gradients import Answer, Gradient, refine
from lmpchain.design.optimisation import Box, Optimum
from lmpchain.design.sensitivities import Sensitivity, objective, sensitivity
from lmpchain.errors import RunFailed, ToleranceNotMet
from lmpchain.util.plotting import COLOURS

FLYING = Scene(  # One grain in free flight, whose velocity is that at t = 0.
    chain=Chain(grains=2, diameter=1e-3, gravity=0.0, bottom="free"),
    excitation=Profile(displacement=[0.0, 1e-3], velocity=[-2.0, 0.0]),
    duration=1e-5,
    samples=3,
)


def cubed(_: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    slope = np.zeros(v.shape)
    slope[-1, 0] = 3 * v[-1, 0] ** 2
    return float(v[-1, 0] ** 3), np.zeros(u.shape), slope


@pytest.mark.parametrize("share", [0.02, 0.2])
def test_scatter_and_shift_are_those_of_a_cubic_answer(share: float):
    """The result is -8 (1 + s z)^3 for a normal z: exact for given draws, close for 16 pairs."""
    answer = sensitivity(FLYING, Function(cubed, [1]), {"velocity": share})
    assert answer.value == pytest.approx(-8, rel=1e-12)
    assert answer.relative["velocity"] == pytest.approx([-24.0, 0.0], rel=1e-9, abs=1e-12)
    assert answer.deviation == pytest.approx(24 * share, rel=1e-9)
    assert answer.uncertainty == pytest.approx({"velocity": 24 * share}, rel=1e-9)
    z, weight = roots_hermitenorm(20)
    cubic = -8 * (1 + share * z) ** 3
    weight /= weight.sum()
    spread = np.sqrt(weight @ cubic**2 - (weight @ cubic) ** 2)
    assert answer.scatter == pytest.approx(spread, rel=0.2)
    assert answer.shift == pytest.approx(weight @ cubic + 8, rel=0.5)
    draws = np.random.default_rng(0).standard_normal((16, 2))[:, 0]
    up, down = (-8 * (1 + side * share * draws) ** 3 for side in (1, -1))
    odd = (up - down) / 2
    even = (up + down) / 2 + 8
    slope = (24 * share) ** 2 * (odd**2).sum() / ((24 * share * draws) ** 2).sum()
    assert answer.scatter == pytest.approx(np.sqrt(slope + even.var(ddof=1)), rel=1e-6)
    assert answer.shift == pytest.approx(even.mean(), rel=1e-6)


def test_no_uncertainty_gives_no_scatter_and_invalid_draws_give_nan():
    exact = sensitivity(FLYING, Function(cubed, [1]))
    assert (exact.scatter, exact.shift, exact.deviation) == (0.0, 0.0, 0.0)
    with pytest.raises(
        InputError, match=r"^velocity: must be from 0 to 1, relative to each entry \(got 1\)"
    ):
        sensitivity(FLYING, Function(cubed, [1]), {"velocity": 1})
    with pytest.raises(InputError, match=r"^velocity: must be from 0"):
        sensitivity(FLYING, Function(cubed, [1]), {"velocity": -0.1})
    assert sensitivity(FLYING, Function(cubed, [1]), {"velocity": 0.0}).scatter == 0
    # No grain reaches the threshold of half the velocity.
    column = scene_of(Chain(grains=3, diameter=1e-3), Impulse(velocity=1e-4, grain=1), 2e-5, 9)
    often = sensitivity(column, ArrivalTime(2, 3e-5), {"velocity": 0.9})
    assert np.isnan([often.scatter, often.shift]).all()
    assert "beyond first order: unknown" in often.table()


def test_a_contact_beyond_the_wave_causes_a_remark():
    column = scene_of(Chain(grains=60, diameter=1e-3), Impulse(velocity=1e-4), 2e-6, 9)
    # The force at rest is the weight of the 50 grains above.
    weight = 50 * column.chain.masses[0] * 9.81
    far = sensitivity(column, "peak_force:50")
    assert far.value == pytest.approx(weight, rel=1e-12)
    said = (
        "no wave reaches contact 50 within 2e-06 s: use a longer duration; "
        "this is its force at rest"
    )
    assert far.table().splitlines()[1] == far.remark == said
    assert far.to_json()["remark"] == said
    for of in ("momentum:50", "kinetic_energy:40-50", "energy:40-50"):
        assert sensitivity(column, of).remark.startswith("no wave reaches these grains within 2e-0")
    for of in ("peak_force:1", "momentum:2", "energy:1-60"):
        assert sensitivity(column, of).remark == ""
    with pytest.raises(
        InputError, match="grain 50 is not reached by any wave: use a longer duration"
    ):
        sensitivity(column, "arrival_time:50@1e-6")


def shown(scatter: float = 0.25, **uncertainty: float) -> Sensitivity:
    """Return a sensitivity with given numbers."""
    relative = {
        "diameters": np.array([0.5, -2.0, 1e-4, 0.0]),
        "contact_constants": np.array([0.1, 0.2, 0.3]),
        "gravity": np.array([0.7]),
    }
    gradient = Gradient(
        2.0, {"masses": np.array([3.0])}, {"masses": 1e-9}, 2e-5, 3e-6, 1e-7, "rkn4"
    )
    return Sensitivity("peak_force:3", "N", gradient, relative, uncertainty, scatter, -0.0125)


def test_a_table_is_sorted_by_influence():
    table = shown(diameters=0.3, gravity=0.4)
    ranks = table.ranked()
    names = [
        "diameters 2",
        "gravity",
        "diameters 1",
        "contact_constants 3",
        "contact_constants 2",
        "contact_constants 1",
        "diameters 3",
        "diameters 4",
    ]
    assert [name for name, _ in ranks] == names
    rows = table.to_dataframe()
    assert rows["parameter"].tolist() == names
    assert rows["change [N]"].tolist() == [part for _, part in ranks]
    assert [part for _, part in ranks][:3] == pytest.approx([-0.02, 0.007, 0.005], rel=1e-12)
    lines = [" ".join(line.split()) for line in table.table().splitlines()]
    assert lines == [
        "peak_force:3: 2 N (error 3.0e-06)",
        "",
        "for 1 % more N %",
        "diameters 2 -0.02 -1.0000",
        "gravity +0.007 +0.3500",
        "diameters 1 +0.005 +0.2500",
        "contact_constants 3 +0.003 +0.1500",
        "contact_constants 2 +0.002 +0.1000",
        "contact_constants 1 +0.001 +0.0500",
        "diameters 3 +1e-06 +0.0000",
        "diameters 4 +0 +0.0000",
        "all diameters -0.015 -0.7500",
        "all contact_constants +0.006 +0.3000",
        "relative error of the derivatives: 2.0e-05",
        "by the uncertainty of diameters: 0.3 N",
        "by the uncertainty of gravity: 0.4 N",
        "uncertainty to first order: 0.5 N (25 %)",
        "by 32 random chains: 0.25 N, the mean shifted by -0.013",
    ]
    assert shown().table().splitlines()[-1] == "relative error of the derivatives: 2.0e-05"
    unknown = shown(float("nan"), gravity=0.4).table().splitlines()[-1]
    assert unknown == "beyond first order: unknown, because some random chains have no value"
    many = shown()
    many.relative["diameters"] = np.arange(20.0)
    assert sum(line.startswith("diameters") for line in many.table().splitlines()) == 12


def test_all_numbers_are_written():
    assert json.loads(json.dumps(shown(diameters=0.3, gravity=0.4).to_json())) == {
        "of": "peak_force:3",
        "unit": "N",
        "value": 2.0,
        "value_error": 3e-6,
        "derivatives": {"masses": [3.0]},
        "derivative_errors": {"masses": 1e-9},
        "per_relative_change": {
            "diameters": [0.5, -2.0, 1e-4, 0.0],
            "contact_constants": [0.1, 0.2, 0.3],
            "gravity": [0.7],
        },
        "uncertainty": {"diameters": 0.3, "gravity": 0.4, "all": 0.5},
        "scatter": 0.25,
        "shift": -0.0125,
        "remark": "",
    }


def test_a_picture_has_the_change_in_percent_along_the_chain():
    """Contacts are drawn between grains, up to the last change above a thousandth."""
    ax = shown().plot()
    drawn = {line.get_label(): line for line in ax.lines[:-1]}
    assert list(drawn) == ["diameters", "contact constants"]
    np.testing.assert_array_equal(drawn["diameters"].get_xdata(), [1, 2, 3, 4])
    np.testing.assert_array_equal(drawn["contact constants"].get_xdata(), [1.5, 2.5, 3.5])
    np.testing.assert_allclose(drawn["diameters"].get_ydata(), [0.25, -1.0, 5e-5, 0.0], rtol=1e-12)
    np.testing.assert_allclose(
        drawn["contact constants"].get_ydata(), [0.05, 0.1, 0.15], rtol=1e-12
    )
    assert [line.get_color() for line in ax.lines[:2]] == list(COLOURS.values())[:2]
    np.testing.assert_array_equal(ax.lines[-1].get_ydata(), [0, 0])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("grain", "change for 1 % more, %")
    assert ax.get_xlim() == (0.5, 4.5)
    assert ax.get_title("left") == "peak force, contact 3: 2 N"
    assert ax.get_legend() is not None
    far = shown()
    far.relative["diameters"] = np.array([1.0, 0.0, 0.9e-3, 0.0, 1.1e-3, 0.9e-3])
    assert far.plot().get_xlim() == (0.5, 4 + 2.5)
    # There may be more parameters than colours.
    far.relative.update({f"chain.law.c{n}": np.ones(3) for n in range(len(COLOURS))})
    assert len(far.plot().lines) == len(COLOURS) + 3


@pytest.mark.parametrize(
    ("of", "exact", "unit"),
    [
        ("peak_force:0", PeakForce(0), "N"),
        ("energy:2-4", Energy([2, 3, 4]), "J"),
        ("energy:3", Energy([3]), "J"),
        ("kinetic_energy:1-2", KineticEnergy([1, 2]), "J"),
        ("momentum:5", Momentum([5]), "kg m/s"),
        ("arrival_time:4@-1e-3", ArrivalTime(4, -1e-3), "s"),
    ],
)
def test_objectives_are_named_in_one_word(of: str, exact: Any, unit: str):
    assert objective(of) == (exact, unit)


@pytest.mark.parametrize(
    ("of", "form"),
    [
        ("peak_force:x", "peak_force:CONTACT"), ("arrival_time:4", "arrival_time:GRAIN@VELOCITY"),
        ("energy:3-", "energy:GRAIN or energy:FIRST-LAST"),
        ("momentum:3-2", "momentum:GRAIN or momentum:FIRST-LAST"),
    ],
)  # fmt: skip
def test_the_form_of_an_objective_is_explained(of: str, form: str):
    with pytest.raises(InputError) as error:
        objective(of)
    assert str(error.value) == f"of: must be {form} (got '{of}')"


def test_a_result_depends_on_given_parameters_that_are_not_0():
    drive = Drive(amplitude=1e-9, frequency=1e5)
    plain = Chain(grains=3, diameter=1e-3, bottom="wall")
    for chain, excitation, names in (
        (plain, Impulse(velocity=1e-6), {"diameters", "youngs_modulus", "gravity", "velocity"}),
        (
            plain,
            drive,
            {"diameters", "youngs_modulus", "gravity", "velocity", "amplitude", "frequency"},
        ),
        (
            plain.replace(
                masses=np.full(3, 1e-6), wall_constants=(0.0, 1e9), gravity=0.0, top_load=0.1
            ),
            Profile(displacement=[1e-12, 0, 0]),
            {"diameters", "youngs_modulus", "masses", "wall_constants", "top_load", "displacement"},
        ),
    ):
        scene = Scene(chain=chain, excitation=excitation, duration=1e-6, samples=3)
        assert set(sensitivity(scene, "momentum:2").relative) == names


def test_steps_are_halved_until_two_comparisons_are_enough():
    """Steps are halved until two comparisons confirm the result.

    The first comparison is with twice the step, the second with at most 1.5 times the step.
    """
    asked: list[tuple[float, int]] = []

    class Run:
        def __init__(self, step: float, steps: int):
            self.step = step
            self.steps = steps
            self.time = np.zeros(5)

    def solve(step: float, finer: int) -> Answer:
        asked.append((round(step, 12), finer))
        return Answer(1 + step**2, None, Run(step, round(8 / step)))

    def judge(answer: Answer, others: Any) -> float:
        return sum(abs(answer.value - other.value) for other in others)

    error = refine(solve, judge, lambda off: off / 0.05, 1.0, 12)
    # The value 3 h^2 is small enough at 1/8, but not with 1.25 h^2 added; at 1/16 both are.
    last = [(0.125, 16), (0.1875, 16), (0.0625, 32), (0.09375, 32)]
    assert asked == [(2.0, 1), (1.0, 2), (0.5, 4), (0.25, 8), *last]
    assert error == pytest.approx(4.25 / 256, rel=1e-12)
    asked.clear()
    refine(solve, judge, lambda _: 0.0, 1.0, 1)
    # There are 8 steps between 4 times, so a shorter step is used.
    assert asked == [(2.0, 1), (1.0, 2), (round(1 / 1.5, 12), 2)]
    asked.clear()
    error = refine(solve, judge, lambda off: 1e9 * off, 1.0, 3)
    assert asked == [(2.0, 1), (1.0, 2), (0.5, 4), (0.25, 8)]
    assert error == pytest.approx(3 / 16, rel=1e-12)


def test_a_box_scales_parameters_to_numbers_from_0_to_1():
    chain = Chain(grains=3, diameter=1e-3, masses=[1e-3, 2e-3, 9e-3], top_load=0.2)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=1e-5)
    bounds = {"masses": ([1e-3, 1e-3, 10e-3], [1e-3, 6e-3, 12e-3]), "top_load": (0.1, 0.5)}
    box = Box(scene, ("masses", "top_load"), bounds)
    np.testing.assert_allclose(box.start, [0.2, 0.0, 0.25], rtol=1e-12)
    values = box.values(np.array([0.5, 1.0, 0.75]))
    np.testing.assert_allclose(values["masses"], [1e-3, 3.5e-3, 12e-3], rtol=1e-12)
    np.testing.assert_allclose(values["top_load"], [0.4], rtol=1e-12)
    slopes = box.slopes({"masses": np.array([7.0, 2.0, 3.0])})
    np.testing.assert_allclose(slopes, [2.0 * 5e-3, 3.0 * 2e-3, 0.0], rtol=1e-12)
    slopes = box.slopes({"top_load": np.array([3.0])})
    np.testing.assert_allclose(slopes, [0.0, 0.0, 1.2], rtol=1e-12)
    for wrong, message in (
        ({"masses": (0, 1)}, "^bounds: give a lower and an upper bound of top_load"),
        (bounds | {"gravity": (1, 2)}, "^bounds: 'gravity' is not one of the parameters"),
        (bounds | {"top_load": (0.5, 0.1)}, "^bounds: must be finite, and no lower bound above"),
        (bounds | {"top_load": (0.1, np.inf)}, "^bounds: must be finite"),
        (bounds | {"top_load": (-np.inf, 0.1)}, "^bounds: must be finite"),
    ):
        with pytest.raises(InputError, match=message):
            Box(scene, ("masses", "top_load"), wrong)


@pytest.mark.parametrize("maximise", [True, False])
def test_a_picture_has_the_best_value_so_far_of_every_start(maximise: bool):
    history = [np.array([3.0, 1.0, 4.0, 2.0]), np.array([2.0, 5.0])]
    best = Optimum(FLYING, 5.0 if maximise else 1.0, 1e-9, {}, history)
    assert best.runs == 6
    rows = best.to_dataframe()
    assert rows["start"].tolist() == [1] * 4 + [2] * 2
    assert rows["run"].tolist() == [1, 2, 3, 4, 1, 2]
    assert rows["value"].tolist() == [3, 1, 4, 2, 2, 5]
    ax = best.plot()
    expected = [[3, 3, 4, 4], [2, 5]] if maximise else [[3, 1, 1, 1], [2, 2]]
    assert [line.get_ydata().tolist() for line in ax.lines] == expected
    assert [line.get_xdata().tolist() for line in ax.lines] == [[1, 2, 3, 4], [1, 2]]
    assert [line.get_label() for line in ax.lines] == ["start 1", "start 2"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("runs", "best value")
    assert ax.get_legend() is not None
    many = Optimum(FLYING, 5.0, 1e-9, {}, history * 4)
    assert many.plot().get_legend() is None
    assert Optimum(FLYING, 5.0, 1e-9, {}, history * 3).plot().get_legend() is not None


def pulled(target: float) -> Function:
    """Return the squared distance of the velocity of a flying grain from a target."""

    def square(_: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        slope = np.zeros(v.shape)
        slope[-1, 0] = 2 * (v[-1, 0] - target)
        return float((v[-1, 0] - target) ** 2 + 1), np.zeros(u.shape), slope

    return Function(square, [1])


VELOCITY = {"velocity": ([-4.0, 0.0], [-1.0, 0.0])}


def test_starts_go_down_to_the_least_value_and_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The value is (v - t)^2 + 1 in a box; finished starts are reused after an interruption."""
    task: Any = dict(
        scene=FLYING, objective=pulled(-3.0), parameters=["velocity"], bounds=VELOCITY, starts=3
    )
    begun: list[Any] = []

    def counted(*arguments: Any, **options: Any) -> Any:
        begun.append(arguments)
        if len(begun) == 3:
            raise KeyboardInterrupt
        return minimize(*arguments, **options)

    monkeypatch.setattr("scipy.optimize.minimize", counted)
    with pytest.raises(KeyboardInterrupt):
        optimise(**task, folder=tmp_path / "new" / "folder")
    best = optimise(**task, folder=tmp_path / "new" / "folder")
    assert len(begun) == 4
    assert best.value == pytest.approx(1, rel=1e-9)
    assert best.values["velocity"] == pytest.approx([-3.0, 0.0], rel=1e-4)
    assert best.scene.excitation.velocity.tolist() == best.values["velocity"].tolist()
    assert best.error < 1e-12
    assert len(best.history) == 3
    assert best.history[0][0] == pytest.approx(2.0, rel=1e-12)  # The first start is the scene.
    begins = {round(float(part[0]), 9) for part in best.history}
    assert len(begins) == 3
    assert all(part.min() == pytest.approx(1, rel=1e-6) for part in best.history)
    assert [part.tolist() for part in optimise(**task).history] == [
        part.tolist() for part in best.history
    ]
    other = optimise(**task, seed=1)
    assert other.history[1][0] != best.history[1][0]
    begun.clear()
    again = optimise(**task, folder=tmp_path / "new" / "folder")
    assert not begun
    assert again.value == best.value
    assert [part.tolist() for part in again.history] == [part.tolist() for part in best.history]


def test_the_maximum_is_at_the_far_bound_and_runs_are_counted():
    far = optimise(FLYING, pulled(-3.0), ["velocity"], VELOCITY, maximise=True, starts=2)
    assert far.value == pytest.approx(5, rel=1e-9)
    assert far.values["velocity"][0] == -1.0
    few = optimise(FLYING, pulled(-3.0), ["velocity"], VELOCITY, starts=2, runs=2)
    assert [len(part) for part in few.history] == [2, 2]
    assert few.runs == 4


def test_constraints_hold_and_failed_starts_are_reported():
    # The tolerance of a constraint does not depend on its unit.
    for unit in (1.0, 1e-7):

        def slow(
            by_name: dict[str, np.ndarray], unit: float = unit
        ) -> tuple[float, dict[str, np.ndarray]]:
            return unit * (2.5 + by_name["velocity"][0]), {"velocity": unit * np.array([1.0, 0.0])}

        bound = optimise(FLYING, pulled(-3.0), ["velocity"], VELOCITY, [slow], starts=2)
        assert bound.values["velocity"][0] == pytest.approx(-2.5, rel=1e-5)
        assert bound.value == pytest.approx(1.25, rel=1e-5)

    def never(by_name: dict[str, np.ndarray]) -> tuple[float, dict[str, np.ndarray]]:
        return -1.0, {"velocity": np.zeros(2)}

    with pytest.raises(RunFailed, match=r"^no start converged"):
        optimise(FLYING, pulled(-3.0), ["velocity"], VELOCITY, [never], starts=1, runs=3)


def test_starts_in_scenes_that_do_not_exist_are_not_the_best():
    """Half of the box has a negative mass, which does not matter to a flying grain."""
    mass = FLYING.chain.masses
    bounds = VELOCITY | {"masses": ([-mass[0], mass[1]], [mass[0], mass[1]])}
    found = optimise(FLYING, pulled(-3.0), ["velocity", "masses"], bounds, starts=4)
    assert found.value == pytest.approx(1, rel=1e-9)
    assert found.values["velocity"][0] == pytest.approx(-3, rel=1e-4)
    assert found.values["masses"][0] > 0
    failed = [part for part in found.history if np.isinf(part[0])]
    assert len(failed) == 2  # A Latin hypercube has equally many points in both halves.
    assert all(np.isinf(part).all() for part in failed)


def test_an_unreachable_tolerance_is_reported_with_the_best_value():
    from lmpchain.design import gradient

    scene = FLYING.replace(chain=Chain(grains=2, diameter=1e-3), excitation=Impulse(velocity=1e-3))
    with pytest.raises(
        ToleranceNotMet, match=r"^the error of the gradient is [0-9.e-]+: use a shorter time"
    ):
        gradient(scene, Momentum([1]), ["masses"], 1e-16)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"starts": 0}, r"starts: must be a whole number from 1 \(got 0\)"),
        ({"starts": 1.5}, r"starts: must be a whole number from 1 \(got 1.5\)"),
        ({"starts": True}, r"starts: must be a whole number from 1 \(got True\)"),
        ({"runs": 0}, r"runs: must be a whole number from 1 \(got 0\)"),
        ({"seed": -1}, r"seed: must be a whole number from 0 \(got -1\)"),
        ({"tolerance": 0.0}, r"tolerance: must be between 0 and 1"),
        ({"tolerance": np.nan}, r"tolerance: must be between 0 and 1"),
        ({"bounds": 3.0}, r"bounds: must be two bounds for each parameter, by name \(got 3.0\)"),
        ({"bounds": {"velocity": 3.0}}, r"bounds: give a lower and an upper bound of velocity"),
        ({"bounds": {"velocity": (1, 2, 3)}}, r"bounds: give a lower and an upper bound of velo"),
        (
            {"bounds": {"velocity": ([1, 2, 3], 4)}},
            r"bounds: of velocity must be one number or 2 \(got 3\)",
        ),
        ({"objective": "momentum:1"}, r"objective: must be an objective, such as PeakForce\(40\)"),
        ({"objective": Momentum}, r"objective: must be an objective, such as PeakForce\(40\)"),
        ({"parameters": None}, r"parameters: must be one or more names of parameters"),
        ({"constraints": 3}, r"constraints: must be a list of functions \(got 3\)"),
        ({"constraints": [3]}, r"constraints: must be a list of functions"),
        ({"constraints": [lambda v: 1.0]}, r"constraints: must return a number and its deriva"),
        ({"constraints": [lambda v: ([1.0, 2.0], {})]}, r"constraints: must return a number and"),
        (
            {"constraints": [lambda v: (1.0, {"velocty": 1.0})]},
            r"constraints: return a derivative by 'velocty', which is not one of the parameters",
        ),
        (
            {"constraints": [lambda v: (1.0, {"velocity": [1.0, 2.0, 3.0]})]},
            r"constraints: must return 2 derivatives by velocity \(got 3\)",
        ),
        ({"bounds": {"velocity": np.array(3.0)}}, r"bounds: give a lower and an upper bound of v"),
    ],
)
def test_tasks_that_are_none_are_refused(change: dict[str, Any], message: str):
    task: dict[str, Any] = {
        "scene": FLYING, "objective": pulled(-3.0), "parameters": ["velocity"], "bounds": VELOCITY,
        "starts": 1,
    }  # fmt: skip
    with pytest.raises(InputError, match=f"^{message}"):
        optimise(**task | change)


def test_gradients_and_sensitivities_of_nothing_are_refused():
    from lmpchain.design import gradient

    for change, message in (
        ({"step": "1e-7"}, "step: must be above 0, in s"),
        ({"step": True}, "step: must be above 0, in s"),
        ({"objective": "momentum:1"}, "objective: must be an objective"),
    ):
        task: dict[str, Any] = {"objective": Momentum([1]), "parameters": ["masses"]}
        with pytest.raises(InputError, match=f"^{message}"):
            gradient(FLYING, **task | change)
    with pytest.raises(InputError, match=r"^objective: must be an objective"):
        sensitivity(FLYING, 3)  # type: ignore[arg-type]
    for uncertain in ({"velocity": "0.1"}, {"velocity": True}):
        with pytest.raises(InputError, match=r"^velocity: must be from 0 to 1"):
            sensitivity(FLYING, Momentum([1]), uncertain)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"^uncertain: must be uncertainties by parameter name"):
        sensitivity(FLYING, Momentum([1]), 0.1)  # type: ignore[arg-type]
    # A name that is given twice counts once.
    twice = gradient(FLYING, Momentum([1]), ["masses", "masses"])
    assert list(twice) == ["masses"]
