"""Data, labels and colours of the charts for given points and trajectories."""

import math
import re
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import scene_of

from lmpchain import Chain, Displacement, Impulse, Scene, Trajectory
from lmpchain.benchmark.chart import FRONT, front, time_to
from lmpchain.benchmark.comparison import Comparison, compare
from lmpchain.benchmark.curves import CurvePoint, EngineCurve, WorkPrecision, machine
from lmpchain.benchmark.reference import Reference
from lmpchain.engines import Bessel, Modes, class_of
from lmpchain.trajectory.record import Cost, ErrorEstimate
from lmpchain.util.plotting import COLOURS, figure, look_of
from lmpchain.util.provenance import processor

CHAIN = Chain(grains=8, diameter=1e-3)
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=2e-3), duration=4e-6, samples=5)
TRUTH = Reference(SCENE.time, np.zeros((5, 8)), np.zeros((5, 8)), 2e-15, "a series")


def point(
    engine: str, integrator: str, seconds: float, error: float, count: int, **more: Any
) -> CurvePoint:
    whole = {"tolerance": None, "setup_s": 0.5, "estimate_s": 0.25, "seconds": seconds,
             "step_s": 1e-8,
             "grain_steps_per_s": 1e6}  # fmt: skip
    row = {"engine": engine, "equation": 1, "integrator": integrator, "error": error,
           "error_displacement": error,
           "error_velocity": error / 2, "expected_error": 2 * error, "integration_s": seconds,
           "steps": count,
           "force_evaluations": 2 * count, "compile_s": 0.0}  # fmt: skip
    return CurvePoint(**row | whole | more)


def curve(
    engine: str, integrator: str, rows: list[tuple[float, float, int]], **more: Any
) -> EngineCurve:
    points = [point(engine, integrator, *row, longest=number == 0 and not more, **more)
              for number, row in enumerate(rows)]  # fmt: skip
    return EngineCurve(engine, "" if more else integrator, tuple(points))


CURVES = (
    curve("native", "rkn4", [(0.1, 1e-3, 40), (0.4, 1e-5, 80), (0.8, 1e-7, 160)], tolerance=1e-6),
    curve("native", "verlet", [(0.02, 1e-2, 10), (0.5, 1e-6, 500)]),
    curve("native", "rkn6", [(0.05, 1e-2, 20), (0.2, 1e-8, 60)]),
    curve("native", "dop853", [(0.06, 1e-2, 30), (0.3, 1e-9, 70)]),
    curve("lammps", "verlet", [(1.0, 1e-2, 50), (9.0, 1e-5, 600)]),
    curve("lammps", "rkn4", [(2.0, 1e-2, 50), (4.0, 1e-7, 900)]),
    curve("native", "gear4", [(0.9, 1e-2, 15), (5.0, 1e-7, 300)]),
    curve("modes", "", [(0.01, 1e-4, 0)]),
    curve("bessel", "", [(0.003, 1.05e-4, 0)]),
)
OTHERS = [{"code": "other", "error": 1e-5, "seconds": 0.05, "force_evaluations": 900},
          {"code": "other", "error": 1e-7, "seconds": 0.15, "force_evaluations": None}]  # fmt: skip
RESULT = WorkPrecision(
    SCENE, TRUTH, CURVES, 3, ("continuum: too short",), {"numpy": "2.0", "lammps": "7"}, "a box"
)
LEADING = [
    "native, to a tolerance",
    "native, rkn6",
    "native, dop853",
    "native, verlet",
    "lammps, rkn4",
]


@pytest.fixture
def panels() -> Any:
    return RESULT.plot(others=OTHERS).figure.axes[:3]


def lines_of(ax: Any) -> dict[str, Any]:
    return {line.get_label(): line for line in ax.lines if not line.get_label().startswith("_")}


def test_curves_that_reach_an_error_soonest_are_in_colour(panels: Any):
    for ax, cost in zip(panels, ("seconds", "force_evaluations"), strict=False):
        lines = lines_of(ax)
        for place, name in enumerate(LEADING):
            line = lines[name]
            (source,) = (each for each in CURVES if each.name == name)
            data = [(getattr(p, cost), p.error) for p in source.points]
            assert [tuple(row) for row in line.get_xydata()] == data
            if name.startswith("lammps"):
                continue
            first = place == 0
            look = {"color": "black", "marker": "*"} if first else look_of(source.integrator)
            assert {"color": line.get_color(), "marker": line.get_marker()} == look
            assert (line.get_markersize(), line.get_linewidth()) == (8 if first else 5.5, 1.8)
            assert line.get_zorder() == (4 if first else 3)
        assert set(lines) - set(LEADING) == {"Pareto front", "others", "lammps, verlet"}
        grey = [line for line in ax.lines if line.get_color() == "0.75"]
        names = ["native, gear4"] + ["other"] * (cost == "seconds")
        assert len(grey) == len(names)
        assert [line.get_label() for line in grey] == ["others", *["_others"] * (len(names) - 1)]
        assert all(line.get_marker() == "." and line.get_zorder() == 1 for line in grey)


def test_the_pareto_front_is_drawn(panels: Any):
    for ax, cost in zip(panels, ("seconds", "force_evaluations"), strict=False):
        points = [(getattr(p, cost), p.error) for p in RESULT.points] + [
            (r[cost], r["error"]) for r in OTHERS
        ]
        points = [p for p in points if p[0]]
        lead = sorted(
            p for p in points if not any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points)
        )
        line = lines_of(ax)["Pareto front"]
        assert [tuple(row) for row in line.get_xydata()] == lead
        assert line.get_color() == FRONT
        assert line.get_zorder() < 1


def test_rings_mark_the_longest_stable_steps_of_leading_curves(panels: Any):
    for ax, cost in zip(panels, ("seconds", "force_evaluations"), strict=False):
        rings = [line for line in ax.lines if line.get_markersize() == 14]
        ringed = {*LEADING[1:], "lammps, verlet"}
        firsts = [each.points[0] for each in CURVES if each.name in ringed]
        places = [tuple(line.get_xydata()[0]) for line in rings]
        assert places == [(getattr(p, cost), p.error) for p in firsts]
        names = [each.name for each in CURVES if each.name in ringed]
        assert [r.get_markeredgecolor() for r in rings] == [
            COLOURS["vermilion"]
            if name.startswith("lammps")
            else look_of(name.split()[-1])["color"]
            for name in names
        ]


def test_engines_with_one_point_are_labelled_together(panels: Any):
    over_time, over_evaluations, _ = panels
    alone = [
        line for line in over_time.lines if line.get_markersize() == 8 and line.get_marker() != "*"
    ]
    data = {line.get_marker(): tuple(line.get_xydata()[0]) for line in alone}
    assert data == {Modes.style[1]: (0.01, 1e-4), Bessel.style[1]: (0.003, 1.05e-4)}
    (label,) = (text for text in over_time.texts if "modes" in text.get_text())
    assert label.get_text() == "modes, bessel"
    assert label.xy == (0.01, 1e-4)  # To the right of the slowest one.
    assert not any("modes" in text.get_text() for text in over_evaluations.texts)


def test_axes_of_errors(panels: Any):
    over_time, over_evaluations, _ = panels
    assert (over_time.get_xlabel(), over_time.get_ylabel()) == ("time (s)", "relative error")
    assert over_evaluations.get_xlabel() == "force evaluations (each of all grains)"
    for ax in (over_time, over_evaluations):
        assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
        floor = 10 * TRUTH.error
        assert ax.get_ylim()[0] == pytest.approx(floor / 10, rel=1e-12)
        assert 1e-2 < ax.get_ylim()[1] <= 5
        (level,) = (
            line
            for line in ax.lines
            if len(set(line.get_ydata())) == 1 and line.get_color() == "0.6"
        )
        assert level.get_ydata()[0] == pytest.approx(floor, rel=1e-12)
        (words,) = (text for text in ax.texts if "error of the reference" in text.get_text())
        assert words.get_text() == "10 × error of the reference"
        assert words.xy == (0.01, floor)
        (better,) = (text for text in ax.texts if text.get_text() == "better")
        assert better.xy[0] < better.xyann[0]
        assert better.xy[1] < better.xyann[1]  # The arrow points to the lower left.
    assert over_evaluations.get_ylim() == over_time.get_ylim()


def test_slopes_of_orders_are_correct(panels: Any):
    ax = panels[1]
    slopes = [line for line in ax.lines if line.get_color() == "0.5"]
    labels = [text.get_text() for text in ax.texts if text.get_text() in "2468"]
    assert labels == ["2", "4", "6", "8"]
    for line, order in zip(slopes, (2, 4, 6, 8), strict=True):
        (x, end), (y, low) = line.get_data()
        assert math.log(y / low) / math.log(end / x) == pytest.approx(order, rel=1e-9)
        assert ax.get_xlim()[0] < x < end <= 10 * x * (1 + 1e-12)
        assert end < ax.get_xlim()[1]
        assert low >= 30 * ax.get_ylim()[0] * (1 - 1e-9)
        assert (end == pytest.approx(10 * x, rel=1e-9)) or (
            low == pytest.approx(30 * ax.get_ylim()[0], rel=1e-9)
        )
        assert y == pytest.approx(1e6 * ax.get_ylim()[0], rel=1e-9)


def test_dots_are_times_to_one_error(panels: Any):
    bars = panels[2]
    times = {
        each.name: time_to(1e-6, [(p.seconds, p.error) for p in each.points]) for each in CURVES
    }
    times["other"] = time_to(1e-6, [(r["seconds"], r["error"]) for r in OTHERS])
    reached = sorted((name for name in times if math.isfinite(times[name])), key=times.__getitem__)
    assert [label.get_text() for label in bars.get_yticklabels()] == reached
    assert [dot.get_xydata()[0] for dot in bars.lines] == [
        pytest.approx([1e3 * times[name], row]) for row, name in enumerate(reached)
    ]
    colours = {name: look_of(name.split()[-1])["color"] for name in LEADING[1:]}
    colours |= {LEADING[0]: "black", "lammps, rkn4": COLOURS["vermilion"]}
    assert [dot.get_color() for dot in bars.lines] == [
        colours.get(name, "0.75") for name in reached
    ]
    assert [text.get_text() for text in bars.texts] == [
        f"{1e3 * times[name]:.3g}" for name in reached
    ]
    assert bars.get_title(loc="left") == "(c) Time to an error of $10^{-6}$"
    assert bars.get_xscale() == "log"
    assert " ".join(bars.get_xlabel().split()) == (
        "time (ms) not reached by lammps, verlet; modes; bessel"
    )
    low, high = bars.get_ylim()
    assert low > len(reached) - 1 + 0.4  # The fastest engine is at the top.
    assert high < -0.4


def test_title_and_footer_describe_the_measurement():
    picture = RESULT.plot(others=OTHERS).figure
    label = SCENE.excitation.label
    number = f"{SCENE.strike_number:.2g}"
    title = f"8 grains, g = 9.81 m/s², {label} (strike number {number}), at t = 4 µs"
    assert picture.get_suptitle() == title
    footer = " ".join(picture.get_supxlabel().split())
    for words in (
        "Reference: a series; its error is 2e-15, "
        "and 3 points below 10 times this error are left out",
        "on a box; numpy 2.0, lammps 7.",
    ):
        assert words in footer
    vacuum = scene_of(Chain(grains=8, diameter=1e-3, gravity=0.0), Impulse(velocity=2e-3), 4e-6)
    title = replace(RESULT, scene=vacuum).plot().figure.get_suptitle()
    assert title == f"8 grains, no gravity, {vacuum.excitation.label} (sonic vacuum), at t = 4 µs"


def test_the_pareto_front_equals_a_brute_force_search(rng):
    for _ in range(20):
        points = [tuple(row) for row in rng.integers(1, 7, (12, 2)).astype(float).tolist()]
        lead = {
            p for p in points if not any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points)
        }
        places = front(points)
        assert [points[place] for place in places] == sorted(lead)
        assert len(places) == len(lead)  # Only one of several equal points is listed.
    assert front([]) == []


def test_rows_and_tables_of_given_points():
    data = RESULT.to_json()
    assert data["reference"] == {"method": "a series", "error": 2e-15}
    assert (data["machine"], data["dropped"], data["versions"]) == ("a box", 3, RESULT.versions)
    assert [row["error"] for row in data["rows"]] == [p.error for p in RESULT.points]
    assert RESULT.to_dataframe()["seconds"].tolist() == [p.seconds for p in RESULT.points]
    first = data["rows"][0]
    assert (first["tolerance"], first["seconds"], first["setup_s"], first["estimate_s"]) == (
        1e-6,
        0.1,
        0.5,
        0.25,
    )
    assert [row["longest"] for row in data["rows"][:5]] == [False, False, False, True, False]
    assert not any(row["pareto"] for row in data["rows"])
    text = RESULT.table({"other": [(0.05, 1e-5), (0.15, 1e-7)]})
    lines = text.partition("\n\n")[2].splitlines()
    words = [line.split("  ") for line in lines]
    cells = {line[0]: [cell.strip() for cell in line[1:] if cell.strip()] for line in words}
    assert cells["time to an error of"] == ["1e-03", "1e-06", "1e-09", "1e-12"]
    assert cells["native, verlet"] == ["44.7 ms", "500 ms", "-", "-"]  # 20 ms 25^(1/4)
    assert cells["native, to a tolerance"][0] == "100 ms"
    assert cells["native, to a tolerance, without the estimate"] == cells["native, to a tolerance"]
    assert cells["modes"] == ["10 ms", "-", "-", "-"]
    assert cells["other"][1] == "86.6 ms"
    assert machine().startswith(f"{processor()}, ")


def test_each_tolerance_has_a_row_with_the_cheapest_engine_and_lammps():
    rows = [
        (each.target, each.engine, each.integrator, each.error, each.seconds)
        for each in RESULT.cheapest()
    ]
    assert rows[:2] == [
        (1e-3, "bessel", "", 1.05e-4, 0.003),
        (1e-6, "native", "rkn6", 1e-8, 0.2),
    ]
    beside = RESULT.cheapest("lammps")
    assert [each.engine for each in beside] == ["lammps", "lammps", "", ""]
    assert (beside[0].integrator, beside[0].seconds) == ("rkn4", 4.0)
    assert beside[2].why == "at best 1e-07: time over"
    lines = RESULT.table().splitlines()
    assert [line.split()[:3] for line in lines[1:5]] == [
        ["1e-03", "bessel", "-"],
        ["1e-03", "lammps", "rkn4"],
        ["1e-06", "native", "rkn6"],
        ["1e-06", "lammps", "rkn4"],
    ]
    assert max(map(len, lines)) <= 80
    (row,) = (line for line in lines if line.split()[:2] == ["1e-09", "lammps"])
    assert row.endswith("at best 1e-07: time over")
    data = RESULT.to_json()
    assert data["cheapest"][1]["step_s"] == 1e-8
    assert data["cheapest_lammps"][2]["engine"] == ""
    assert data["cheapest_lammps"][2]["error"] is None
    without = replace(RESULT, curves=CURVES[:4], left_out=("lammps: it is not installed",))
    assert {each.why for each in without.cheapest("lammps")} == {"it is not installed"}


def test_lammps_has_its_colour_and_the_rows_are_below(panels: Any):
    for ax in panels[:2]:
        lines = lines_of(ax)
        for name in ("lammps, verlet", "lammps, rkn4"):
            assert lines[name].get_color() == COLOURS["vermilion"]
    ways = panels[0].figure.axes[-1]
    lines = [text.get_text() for text in ways.texts]
    assert [text.get_weight() for text in ways.texts] == ["bold", *["normal"] * (len(lines) - 1)]
    assert [line.split()[1:3] for line in lines] == [line.split()[1:3] for line in RESULT.best()]
    assert [line[:5].strip() for line in lines[1:4:2]] == ["10⁻³", "10⁻⁶"]
    # Columns of raised powers are aligned.
    start = lines[0].index("engine")
    assert all(re.fullmatch(r" \S", line[start - 1 : start + 1]) for line in lines)
    names = panels[0].figure.axes[-2].get_legend().get_texts()
    assert {text.get_text().replace("\n", " ") for text in names} == {
        *LEADING, "lammps, verlet", "Pareto front", "others"
    }  # fmt: skip
    assert {text.get_color() for text in ways.texts if "lammps" in text.get_text()} == {
        COLOURS["vermilion"]
    }


# --- the comparison of trajectories


def answer(engine: str, scene: Scene, off: float, **cost: Any) -> Trajectory:
    """Return a trajectory with an error only in its velocities, relative to the largest one."""
    u, v = wave(scene)
    counts = {"integrator": "rkn4", "steps": 40, "integration_s": 0.3} | cost
    paid = Cost(0.3, 0.1, 0.2, 40, 160, 8, "rkn4", 1e-8, 1, 2.0)._replace(**counts)
    columns = scene.recorded - 1
    speeds = v[:, columns] + off * np.abs(v).max()
    estimate = ErrorEstimate(1e-4, 2e-4)
    return Trajectory(
        scene, engine, 1, scene.time, scene.recorded, u[:, columns], speeds, estimate, paid
    )


def wave(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    n = np.arange(scene.chain.grains)
    t = np.linspace(0, 1, scene.samples)[:, None]
    bump = np.exp(-((n - 10 - 20 * t) ** 2) / 4)
    return 1e-9 * bump, 1e-3 * bump


def compared(
    scene: Scene,
    off: tuple[float, ...] = (1e-3, -0.5),
    names: tuple[str, ...] = ("native", "lammps"),
) -> Any:
    u, v = wave(scene)
    truth = Reference(scene.time, u, v, 1e-12, "made up")
    answers = [answer(name, scene, share) for name, share in zip(names, off, strict=True)]
    comparison: Comparison = compare(answers, truth)
    # The map is in the first axes, its colour bar in the last.
    _, over_time, motion, cost, _ = comparison.plot().figure.axes
    return comparison, (motion, over_time, cost)


LONG = scene_of(Chain(grains=200, diameter=1e-3), Impulse(velocity=2e-3), 5e-6, 6)


def test_the_wave_is_drawn_in_units_of_the_strike():
    comparison, (ax, _, _) = compared(LONG)
    _, v = wave(LONG)
    moving = 1 + np.flatnonzero(v[-1] > 1e-3 * v[-1].max())
    first = moving[0] - 4
    last = moving[-1] + 4
    assert ax.get_xlim() == (first - 0.5, last + 0.5)
    assert ax.get_title(loc="left") == "(c) Motion at t = 5 µs"
    assert ax.get_xlabel() == "grain number, from the top"
    assert ax.get_ylabel() == r"velocity / strike velocity $v_0$"
    lines = lines_of(ax)
    assert np.array_equal(lines["reference"].get_xdata(), np.arange(1, 201))
    assert lines["reference"].get_ydata() == pytest.approx(v[-1] / 2e-3, rel=1e-12)
    for place, (name, t) in enumerate(
        zip(("native", "lammps"), comparison.trajectories, strict=True)
    ):
        assert np.array_equal(lines[name].get_xdata(), np.arange(first, last + 1))
        assert lines[name].get_ydata() == pytest.approx(
            t.velocity[-1, first - 1 : last] / 2e-3, rel=1e-12
        )
        assert (lines[name].get_color(), lines[name].get_marker()) == class_of(name).style
        assert lines[name].get_linestyle() == "None"
        assert lines[name].get_markersize() == 7.5 - 3.5 * place
    span = v[-1].max() - v[-1].min()
    low = v[-1].min() - span / 4
    high = v[-1].max() + span / 4
    assert ax.get_ylim() == pytest.approx((low / 2e-3, high / 2e-3), rel=1e-9)
    assert [text.get_text() for text in ax.texts] == ["partly beyond the scale: lammps"]
    assert not compared(LONG, (1e-3, -0.2))[1][0].texts


def test_only_the_best_linear_engine_is_drawn_with_the_wave():
    u, v = wave(LONG)
    truth = Reference(LONG.time, u, v, 1e-12, "made up")
    answers = [answer("native", LONG, 1e-9), answer("modes", LONG, 1e-2)]
    answers += [answer("chebyshev", LONG, 1e-1)]
    answers[1:] = [replace(each, equation=3) for each in answers[1:]]
    picture = compare(answers, truth).plot().figure
    motion, over_time, drawn = picture.axes[:3]
    assert set(lines_of(drawn)) == {"reference", "native", "modes"}
    assert {text.get_text() for text in over_time.texts} == {
        "native", "modes", "chebyshev", "reference"
    }  # fmt: skip
    heights = [text.xyann[1] for text in over_time.texts]
    # Names of curves with nearby ends do not overlap.
    assert np.diff(sorted(heights)).min() >= 0.05
    # The map shows the moving grains, from the top down.
    assert motion.get_ylim() == (drawn.get_xlim()[1], 0.5)


def test_without_a_strike_velocities_are_in_m_per_s():
    scene = Scene(**LONG.given() | {"excitation": Displacement(displacement=1e-9)})
    _, (ax, _, _) = compared(scene)
    assert ax.get_ylabel() == "velocity downward (m/s)"
    assert lines_of(ax)["reference"].get_ydata() == pytest.approx(wave(scene)[1][-1], rel=1e-12)


def test_a_wide_wave_is_shown_around_its_fastest_grain():
    """At most 60 grains are shown: 30 on either side of the fastest, or up to an end."""
    truth = Reference(LONG.time, *wave(LONG), 1e-12, "made up")
    comparison = compare([answer("native", LONG, 1e-3)], truth)
    ax = figure().subplots()

    def drawn(velocity: np.ndarray) -> tuple[float, float]:
        ax.clear()
        replace(comparison, reference=replace(truth, velocity=velocity[None])).plot(ax)
        low, high = ax.get_xlim()
        return low + 0.5, high - 0.5

    velocity = np.ones(200)
    cases = {99: (70, 129), 3: (1, 60), 198: (141, 200), 29: (1, 60), 31: (2, 61)}
    for fastest, shown in cases.items():
        velocity[:] = 1.0
        velocity[fastest] = -2.0
        assert drawn(velocity) == shown
    for grains, shown in ((60, (1, 60)), (61, (1, 60)), (59, (1, 59))):
        assert drawn(np.append(2.0, np.ones(grains - 1))) == shown
    assert drawn(np.zeros(200)) == (1, 60)
    assert drawn(np.zeros(20)) == (1, 20)
    still = np.zeros(200)
    still[[100, 90, 80]] = 1.0, 1.1e-3, 0.9e-3
    assert drawn(still) == (87, 105)


def test_errors_over_time_and_cost_are_drawn_to_scale():
    comparison, (_, ax, cost) = compared(LONG)
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_yscale()) == (
        "time (µs)",
        "relative error",
        "log",
    )
    curves = lines_of(ax)
    for name, row, off in zip(("native", "lammps"), comparison.rows, (1e-3, 0.5), strict=True):
        v = wave(LONG)[1]
        errors = np.full(6, off) * np.abs(v).max() / np.abs(v).max()
        assert curves[name].get_xdata() == pytest.approx([1, 2, 3, 4, 5], rel=1e-9)
        assert curves[name].get_ydata() == pytest.approx(errors[1:], rel=1e-9)
        assert curves[name].get_color() == class_of(name).style[0]
        assert row.error == pytest.approx(off, rel=1e-9)
    levels = [(line.get_ydata()[0], line.get_color(), line.get_linestyle()) for line in ax.lines
              if len(line.get_ydata()) == 2]  # fmt: skip
    assert [level[0] for level in levels] == pytest.approx([3e-4, 3e-4, 1e-12], rel=1e-12)
    assert [level[1:] for level in levels] == [
        (COLOURS["blue"], "--"),
        (COLOURS["vermilion"], "--"),
        ("0.55", ":"),
    ]
    assert ax.get_title(loc="left") == "(b) Error (dashed: expected)"
    assert (cost.get_xlabel(), cost.get_ylabel()) == ("integration time (s)", "relative error")
    assert (cost.get_xscale(), cost.get_yscale()) == ("log", "log")
    named = lines_of(cost)
    assert set(named) == {"native, rkn4", "lammps, rkn4"}
    for name, off in (("native, rkn4", 1e-3), ("lammps, rkn4", 0.5)):
        assert named[name].get_xydata()[0] == pytest.approx([0.3, off], rel=1e-9)
        assert named[name].get_marker() == class_of(name.split(",")[0]).style[1]
    bars = [line for line in cost.lines if line.get_linestyle() == "--"]
    assert [list(line.get_ydata()) for line in bars] == [
        pytest.approx([1e-3, 3e-4]),
        pytest.approx([0.5, 3e-4]),
    ]
    ends = [line.get_xydata()[0] for line in cost.lines if line.get_marker() == "_"]
    assert ends == [pytest.approx([0.3, 3e-4])] * 2


def test_zero_error_and_zero_time_are_drawn_at_the_end_of_the_scale():
    scene = LONG
    u, v = wave(scene)
    exact = replace(answer("modes", scene, 0.0, integrator="modes", integration_s=0.0),
                    error_estimate=ErrorEstimate(0.0, 0.0))  # fmt: skip
    _, ax, _, cost, _ = (
        compare([exact], Reference(scene.time, u, v, 0.0, "exact")).plot().figure.axes
    )
    assert set(lines_of(ax)["modes"].get_ydata()) == {1e-17}
    assert [line.get_ydata()[0] for line in ax.lines if len(line.get_ydata()) == 2] == [
        1e-17,
        1e-17,
    ]
    assert lines_of(cost)["modes"].get_xydata()[0].tolist() == [1e-9, 1e-17]


def test_the_table_of_a_comparison_in_numbers():
    comparison, _ = compared(LONG)
    lines = comparison.table().splitlines()
    cells = [" ".join(line.split()) for line in lines]
    assert cells[0] == "engine Eq. integrator error expected integration steps evaluations"
    assert cells[1] == "native (1) rkn4 1.00e-03 3.00e-04 0.3 s 40 160"
    assert cells[2] == "lammps (1) rkn4 5.00e-01 3.00e-04 0.3 s 40 160"
    assert cells[3] == "reference: made up; its own error is about 1.0e-12"
    assert cells[4].startswith(
        "error: max|x - x_true| over samples and grains, divided by max|x_true| at any"
    )
    assert comparison.rows[0].compile_s == 2.0
    assert comparison.to_json()["rows"][1]["compile_s"] == 2.0


def test_in_one_set_of_axes_only_the_first_panel_is_drawn():
    comparison, _ = compared(LONG)
    ax = figure().subplots()
    assert comparison.plot(ax) is ax
    assert set(lines_of(ax)) == {"reference", "native", "lammps"}
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["reference", "native", "lammps"]
    # A run to a tolerance is named even if it has a single point.
    few = replace(CURVES[0], points=CURVES[0].points[:1])
    axes = replace(RESULT, curves=(few, *CURVES[1:])).plot(figure().subplots())
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert {"native, to a tolerance", "native, rkn6"} <= set(labels)
    for plot in (comparison.plot, partial(RESULT.plot, others=OTHERS)):
        several = figure().subplots(1, 3)
        assert plot(several) is several[0]
        assert all(ax.lines for ax in several)
