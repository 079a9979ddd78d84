"""Display of a trajectory: picture, line in a notebook, and accumulated quantities."""

import re
from dataclasses import replace

import numpy as np
import pytest
from helpers.example_scenes import scene_of

from lmpchain import Chain, Impulse, Scene, Trajectory
from lmpchain.trajectory import gathered, trajectory
from lmpchain.trajectory.record import Cost, ErrorEstimate
from lmpchain.trajectory.trajectory import scale
from lmpchain.util.plotting import figure

SCENE = scene_of(Chain(grains=6, diameter=1e-3), Impulse(velocity=1e-3), 4e-6, 5, grains=[4, 1, 2])
COST = Cost(1.0, 0.25, 0.5, 80, 240, 6, "rkn4", 5e-8, 1, 3.0)


def made(scene: Scene = SCENE) -> Trajectory:
    rng = np.random.default_rng(4)
    shape = scene.samples, scene.recorded.size
    fields = {
        "displacement": 1e-9 * rng.normal(size=shape),
        "velocity": 1e-3 * rng.normal(size=shape),
    }
    return Trajectory(scene, "native", 1, scene.time, scene.recorded, **fields,
                      error_estimate=ErrorEstimate(2e-3, 1e-4), cost=COST)  # fmt: skip


@pytest.mark.parametrize(("field", "unit"), [("velocity", "m/s"), ("displacement", "m")])
def test_the_picture_shows_time_and_depth(field: str, unit: str):
    t = made()
    axes = figure().subplots()
    assert t.plot(axes, field) is axes
    (image,) = [*axes.images, *axes.collections]
    values = getattr(t, field)[:, [1, 2, 0]].T  # Grains 1, 2 and 4.
    assert np.array_equal(np.asarray(image.get_array()).reshape(values.shape), values)
    limit = np.median(np.abs(values).max(axis=1))
    assert image.get_clim() == (-limit, limit)
    assert image.get_cmap().name == "RdBu_r"  # Large values are red.
    assert axes.get_xlabel() == "time"
    assert axes.get_ylabel() == "grain, from the top"
    assert axes.get_xlim() == (0.0, 4e-6)
    bottom, top = axes.get_ylim()
    assert (top, bottom) == (0.5, 5.0)
    (bar,) = (other for other in axes.figure.axes if other is not axes)
    assert bar.get_ylabel() == f"{field}, downward"
    assert bar.yaxis.get_major_formatter()(1e-3) == f"1 m{unit}"
    assert axes.xaxis.get_major_formatter()(1e-6) == "1 µs"
    assert image.colorbar.extend == "both"
    assert all(tick == round(tick) for tick in axes.get_yticks())


def test_by_default_a_new_figure_shows_velocities():
    t = made()
    axes = t.plot()
    image = [*axes.images, *axes.collections][0]
    assert np.asarray(image.get_array()).ravel()[0] == t.velocity[0, 1]


def test_the_number_of_drawn_samples_is_limited():
    for samples, every in ((4000, 1), (4001, 2), (9000, 3)):
        scene = Scene(**SCENE.given() | {"samples": samples})
        t = made(scene)
        axes = figure().subplots()
        t.plot(axes)
        image = [*axes.images, *axes.collections][0]
        columns = np.asarray(image.get_array()).reshape(3, -1)
        assert np.array_equal(columns[0], t.velocity[::every, 1])
        assert axes.get_xlim() == (0.0, t.time[::every][-1])


def test_colours_saturate_at_the_median_of_moving_grains():
    largest = np.array([1.0, 0.5, 0.2, 1.1e-3, 0.9e-3, 0.0])
    motion = np.array([0.3, -1.0])[:, None] * largest
    assert scale(motion) == pytest.approx((0.5 + 0.2) / 2, rel=1e-12)
    assert scale(np.zeros((2, 3))) == 1.0


def table_of(t: Trajectory) -> dict[str, str]:
    """Return the rows of the table in a notebook."""
    return dict(re.findall("<tr><td.*?>(.*?)</td><td.*?>(.*?)</td>", t._repr_html_()))


def test_a_trajectory_describes_itself(monkeypatch: pytest.MonkeyPatch):
    """A notebook draws trajectories of moderate size."""
    t = made()
    for most, drawn in ((15, True), (14, False)):
        monkeypatch.setattr(trajectory, "DRAWN_VALUES", most)
        assert ("<img" in t._repr_html_()) == drawn
    assert repr(t) == "Trajectory(native, Eq. (1), 5 samples x 3 grains, error 0.0021)"
    rows = table_of(t)
    assert rows["scene"] == f"6 grains, {SCENE.excitation.label}"
    assert rows["engine"] == "native, which solves Eq. (1)"
    assert rows["recorded"] == "5 times to 4e-06 s, 3 grains"
    assert rows["error estimate"] == "0.0021 = 0.002 (model) + 0.0001 (solver)"
    assert rows["cost"] == "1.75 s, 80 steps of 5e-08 s by rkn4, 6 grains computed"
    stepless = replace(t, cost=COST._replace(integrator="", steps=1))
    assert table_of(stepless)["cost"] == "1.75 s, 1 step, 6 grains computed"
    assert t.cost.total_s == 1.75
    assert t.error_estimate.total == pytest.approx(2.1e-3, rel=1e-15)


QUANTITIES = ["peak_velocity", "peak_displacement", "arrival_time", "peak_force:3", "force:2"]


def test_accumulated_quantities_have_labels_units_and_shapes():
    scene = Scene(**SCENE.given() | {"quantities": QUANTITIES})
    fine = scene.fine.samples
    arrays = gathered.arrays(scene)
    table = {
        "peak_velocity": (("grain",), (3,), "m s-1"),
        "peak_displacement": (("grain",), (3,), "m"),
        "arrival_time": (("grain",), (3,), "s"),
        "peak_force:3": ((), (), "N"),
        "force:2": (("fine_time",), (fine,), "N"),
    }
    assert set(arrays) == {*table, *(f"{name}_error" for name in table), "fine_time"}
    for name, (dimensions, shape, units) in table.items():
        about = arrays[name].labels["long_name"]
        assert about.endswith(name.partition(":")[2])
        error_of = {"units": units, "long_name": f"error of the {about}"}
        assert arrays[name] == (dimensions, shape, {"units": units, "long_name": about})
        assert arrays[f"{name}_error"] == (dimensions, shape, error_of)
    assert arrays["fine_time"][:2] == (("fine_time",), (fine,))
    assert arrays["fine_time"].labels["units"] == "s"
    assert gathered.arrays(SCENE) == {}
    values = {
        name: np.arange(float(np.prod(kind.shape))).reshape(kind.shape)
        for name, kind in arrays.items()
    }
    stored = gathered.variables(scene, values)
    assert set(stored) == {name.replace(":", "_") for name in arrays}
    dimensions, kept, labels = stored["force_2_error"]
    assert (dimensions, labels["units"]) == (("fine_time",), "N")
    assert kept is values["force:2_error"]


def test_accumulated_quantities_as_text():
    scene = Scene(**SCENE.given() | {"quantities": QUANTITIES[:4]})
    values = {
        "peak_velocity": np.array([1.25e-3, 3e-4, 5e-4]),
        "peak_velocity_error": np.array([1e-6, 2.5e-6, 0]),
        "peak_displacement": np.full(3, np.nan),
        "peak_displacement_error": np.full(3, np.nan),
        "arrival_time": np.array([np.nan, 2e-6, 1e-6]),
        "arrival_time_error": np.array([np.nan, 1e-9, 3e-9]),
        "peak_force:3": np.array(1.5),
        "peak_force:3_error": np.array(0.02),
    }
    assert gathered.describe_gathered(scene, values) == {
        "peak_velocity": "0.0003 to 0.00125 m/s, off by 2.5e-06 at most",
        "peak_displacement": "nothing: no front has passed",
        "arrival_time": "1e-06 to 2e-06 s in 2 of 3 grains, off by 3e-09 at most",
        "peak_force:3": "1.5 N, off by 0.02 at most",
    }
