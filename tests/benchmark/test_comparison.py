"""The reference, and the errors of trajectories relative to it."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, smooth, struck

from lmpchain import Impulse, InputError, Profile, Trajectory, simulate
from lmpchain.benchmark.comparison import compare, error, error_over_time, errors
from lmpchain.benchmark.reference import Reference, expected_seconds, reference


def test_the_reference_starts_where_the_scene_does():
    start = Profile(displacement=[1e-10, -1e-10, 0], velocity=[0, 1e-5, 0])
    truth = reference(scene_of(column(3), start, 1e-6, 2))
    assert truth.displacement[0] == pytest.approx([1e-10, -1e-10, 0], rel=1e-15, abs=0)
    assert truth.velocity[0] == pytest.approx([0, 1e-5, 0], rel=1e-15, abs=0)
    assert not truth.displacement[:, 2].any()


def test_the_reference_is_accurate_for_weak_waves():
    """Halving a weak strike halves the motion, to the accuracy of linear theory."""
    chain = column(10)
    motion = [reference(struck(chain, v, 3e-5, 4)).velocity / v for v in (1e-16, 2e-16)]
    assert motion[0] == pytest.approx(motion[1], abs=1e-11)


def test_a_chain_without_excitation_stays_at_rest():
    chain = column(4)
    for quiet in (chain, column(4, gravity=0.0)):
        truth = reference(struck(quiet, 0.0, 1e-5, 3))
        assert not truth.displacement.any()
        assert not truth.velocity.any()
        assert truth.error < 1e-9


def test_a_long_scene_is_expected_to_take_longer():
    short = smooth()
    long = short.replace(duration=1e6 * short.duration)
    large = scene_of(column(10**5), Impulse(velocity=1e-6), 1e-2, 2)
    assert 0 < expected_seconds(short) < 1
    assert expected_seconds(long) > 1e3
    assert expected_seconds(large) > 60


# --- errors of trajectories made by hand

CHAIN = column(4)


def made_up(grains: Any = "all") -> tuple[Trajectory, Reference]:
    """Return a trajectory without error, and its reference.

    U = 1, 2, -4, 0 and v = 10 u at all times.
    """
    scene = scene_of(CHAIN, Impulse(velocity=1e-9), 1e-9, 3, grains=grains)
    answer = simulate(scene, "native", 1e-3)
    u = np.tile([1.0, 2.0, -4.0, 0.0], (3, 1))
    columns = scene.recorded - 1
    answer = replace(answer, displacement=u[:, columns].copy(), velocity=10 * u[:, columns])
    return answer, Reference(scene.time, u, 10 * u, 1e-12, "made up")


def test_equal_trajectories_have_no_error():
    answer, truth = made_up()
    assert errors(answer, truth) == (0.0, 0.0)
    assert error(answer, truth) == 0.0
    assert error_over_time(answer, truth).tolist() == [0, 0, 0]


def test_the_error_is_the_larger_of_both_relative_to_the_largest_motion():
    answer, truth = made_up()
    answer.displacement[1, 0] += 0.4
    answer.velocity[2, 1] -= 2.0
    assert errors(answer, truth) == pytest.approx((0.1, 0.05), rel=1e-14, abs=0)
    assert error(answer, truth) == pytest.approx(0.1, rel=1e-14, abs=0)
    assert error_over_time(answer, truth) == pytest.approx([0, 0.1, 0.05], rel=1e-14, abs=0)


def test_recorded_grains_are_compared_relative_to_the_whole_chain():
    answer, truth = made_up(grains=[2, 1])
    assert answer.displacement[0].tolist() == [2, 1]
    assert errors(answer, truth) == (0.0, 0.0)
    answer.displacement[0, 1] += 0.4  # The largest displacement is 4, of grain 3.
    assert errors(answer, truth)[0] == pytest.approx(0.1, rel=1e-14, abs=0)


def test_nan_is_propagated():
    answer, truth = made_up()
    answer.velocity[1, 1] = np.nan
    assert np.isnan(error(answer, truth))
    answer.velocity[1, 1] = 40
    answer.displacement[1, 1] = np.nan
    assert np.isnan(error(answer, truth))
    answer.displacement[1, 1] = np.inf
    assert error(answer, truth) == np.inf


def test_a_reference_at_rest():
    answer, truth = made_up()
    truth.displacement[:] = truth.velocity[:] = 0
    answer.displacement[:] = answer.velocity[:] = 0
    assert errors(answer, truth) == (0.0, 0.0)


def test_incomparable_trajectories_are_rejected():
    answer, truth = made_up()
    with pytest.raises(InputError, match="time"):
        errors(answer, replace(truth, time=truth.time * 1.001))
    with pytest.raises(InputError, match="time"):
        errors(answer, replace(truth, time=truth.time[:2]))
    with pytest.raises(InputError, match="grains"):
        errors(answer, replace(truth, displacement=np.zeros((3, 5)), velocity=np.zeros((3, 5))))
    for wrong in ([], answer, [answer, None]):
        with pytest.raises(InputError, match=r"^trajectories: must be a list of one trajectory"):
            compare(wrong, truth)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"^reference: must be a reference solution \(got None"):
        compare([answer], None)  # type: ignore[arg-type]


def test_rows_contain_the_numbers_of_the_trajectories():
    first, truth = made_up()
    second = replace(first, engine="lammps", velocity=1.5 * first.velocity)
    comparison = compare([first, second], truth)
    assert [row.engine for row in comparison.rows] == ["native", "lammps"]
    row = comparison.rows[1]
    assert (row.error, row.error_displacement, row.error_velocity) == (0.5, 0.0, 0.5)
    assert row.expected_error == second.error_estimate.total
    assert (row.steps, row.force_evaluations) == (second.cost.steps, second.cost.force_evaluations)
    assert (row.integration_s, row.integrator, row.equation) == (
        second.cost.integration_s,
        second.cost.integrator,
        1,
    )
    assert comparison.to_dataframe()["error"].tolist() == [0.0, 0.5]
    lines = comparison.table().splitlines()
    assert lines[0].split()[:3] == ["engine", "Eq.", "integrator"]
    assert lines[2].split()[:4] == ["lammps", "(1)", second.cost.integrator, "5.00e-01"]
    assert "made up" in comparison.table()


def test_the_effect_of_damping_has_its_own_row():
    answer, truth = made_up()
    damped = answer.scene.replace(chain=CHAIN.replace(damping={"drag": 1e3}))
    lossless = replace(answer, velocity=1.5 * answer.velocity)
    comparison = compare([replace(answer, scene=damped)], truth, lossless)
    row = comparison.lossless
    assert row is not None
    assert (row.engine, row.error, row.error_displacement) == ("without damping", 0.5, 0.0)
    assert row.expected_error == damped.damping_effect > 0
    lines = comparison.table().splitlines()
    cells = ["without", "(1)", answer.cost.integrator, "5.00e-01", f"{row.expected_error:.2e}"]
    assert lines[2].split()[:5] == cells  # The word damping is in the next line.
    assert "without damping: the change if damping is left out" in " ".join(lines)
    data = comparison.to_json()
    assert (len(data["rows"]), data["without_damping"]["error"]) == (1, 0.5)
    assert "without_damping" not in compare([answer], truth).to_json()


def test_json_has_the_documented_form_without_nan():
    answer, truth = made_up()
    broken = replace(answer, velocity=np.full_like(answer.velocity, np.nan))
    data = compare([answer, broken], truth).to_json()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert set(data) == {"reference", "rows"}
    assert data["reference"] == {"method": "made up", "error": 1e-12}
    for row in data["rows"]:
        assert list(row) == [
            "engine", "equation", "error", "error_displacement", "error_velocity", "expected_error",
            "integration_s",
            "steps", "force_evaluations", "compile_s",
        ]  # fmt: skip
    assert data["rows"][1]["error"] is None
    assert data["rows"][1]["error_displacement"] == 0.0


# --- the picture


def test_a_picture_of_a_chain_at_rest():
    scene = struck(CHAIN, 0.0, 1e-6, 3)
    ax = compare([simulate(scene, "native", 1e-6)], reference(scene)).plot()
    ax.figure.draw_without_rendering()
    assert all(not np.any(line.get_ydata()) for line in ax.lines)


def test_the_lammps_engine_is_compared():
    scene = smooth(samples=4)
    comparison = compare(
        [simulate(scene, "lammps", 1e-6), simulate(scene, "native", 1e-9)], reference(scene)
    )
    assert comparison.rows[0].error <= 1e-6
    assert comparison.rows[1].error <= 1e-9
    for row in comparison.rows:
        assert row.error <= row.expected_error
