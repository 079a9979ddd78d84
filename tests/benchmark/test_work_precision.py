"""Work-precision curves.

What is measured, what is marked, the picture, the command and the script.
"""

import contextlib
import io
import json
import math
import re
import signal
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise, takewhile
from pathlib import Path

import numpy as np
import pytest
from helpers.child_processes import COMMAND, PATIENCE, on_a_terminal
from helpers.example_scenes import scene_of, smooth
from helpers.independent_integrators import distance, extended_reference

from lmpchain import Chain, Impulse, InputError, RunFailed, Scene, engines, simulate
from lmpchain.benchmark.bench import Bench, work_precision
from lmpchain.benchmark.chart import LABELLED, TARGET
from lmpchain.benchmark.curves import front, time_to
from lmpchain.benchmark.reference import reference
from lmpchain.cli.command_line import main
from lmpchain.engines import cost_model
from lmpchain.integrators.methods import METHODS
from lmpchain.util.plotting import figure, save

SCRIPT = Path(__file__).parents[2] / "analysis" / "work_precision.py"
SCENE = smooth()
PEERS = [
    {"code": "other", "parameter": 1e-6, "error": 1e-5, "seconds": 1e-2, "force_evaluations": 900},
    {"code": "other", "parameter": 1e-9, "error": 1e-9, "seconds": 3e-2, "force_evaluations": 2000},
    {
        "code": "silent",
        "parameter": 1e-9,
        "error": 1e-8,
        "seconds": 2e-2,
        "force_evaluations": None,
    },
]


@pytest.fixture(scope="module")
def chart():
    """Return the chart, and what the runs said on stderr."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        return work_precision(SCENE, 2.5, progress=True), said.getvalue()


@pytest.fixture(scope="module")
def found(chart):
    return chart[0]


def test_the_bar_names_the_engine_and_its_integrator(chart):
    shown = re.findall(r"((?:native|lammps) [\w-]+): (\d+) of (\d+) ", chart[1])
    names, numbers, totals = zip(*shown, strict=True)
    assert {"native verlet", "lammps verlet"} <= set(names)
    assert max(map(int, numbers)) > len(set(names)) / 2
    assert len(set(totals)) == 1


def stepped(found):
    return [curve for curve in found.curves if curve.integrator]


def test_every_engine_and_integrator_is_listed(found):
    names = {curve.name for curve in found.curves}
    kinds = {
        (engine, kind)
        for engine in ("native", "lammps")
        for kind in engines.get(engine).integrators
    }
    pairs = {f"{engine}, {kind}" for engine, kind in kinds if kind in METHODS}
    assert names == pairs | {"native, to a tolerance", "modes", "chebyshev", "bessel"}
    assert found.left_out == (f"continuum: {engines.get('continuum').refuses(SCENE)[0][1]}",)


def test_errors_are_true(found):
    """Repeat the runs of the points, and compare them with an independent integrator."""
    u, v, itself = extended_reference(SCENE)
    for curve in stepped(found):
        point = curve.points[len(curve.points) // 2]
        engine = engines.get(curve.engine, integrator=curve.integrator, step=point.step_s)
        again = simulate(SCENE, engine)
        assert again.cost.steps == point.steps
        assert point.error == pytest.approx(distance(again, (u, v)), rel=1e-2, abs=0)
        assert point.error == max(point.error_displacement, point.error_velocity) > 100 * itself
        assert point.expected_error == again.error_estimate.total


def native(name, until):
    """Return the points of an integrator down to an error, without a time limit."""
    points = Bench(SCENE, reference(SCENE)).over_steps("native", name)
    return list(takewhile(lambda point: point.error > until, points))


@pytest.mark.parametrize("name", METHODS)
def test_the_slope_is_the_order(name):
    falling = [p for p in native(name, until=1e-9) if p.error < 1e-3]
    assert len(falling) > 3
    slope = np.polyfit(
        np.log([p.force_evaluations for p in falling]), np.log([p.error for p in falling]), 1
    )[0]
    assert -0.35 < -slope - METHODS[name].order < (0.9 if name == "gear4" else 0.35)


def test_steps_shorten_until_round_off():
    points = native("rkn6", until=0)
    assert all(1.2 < b.steps / a.steps < 1.7 for a, b in pairwise(points))
    assert [point.longest for point in points] == [True, *[False] * (len(points) - 1)]
    least = min(point.error for point in points)
    assert least < 1e-12
    # The curve ends where the error stops falling.
    assert all(point.error > 0.5 * least for point in points[-4:])


def breaks_down(scene, engine, integrator, step):
    try:
        answer = simulate(scene, engines.get(engine, integrator=integrator, step=step))
    except (InputError, RunFailed):
        return True
    truth = reference(scene)
    return distance(answer, truth) >= 1


def longest_holds(scene, name):
    point = next(Bench(scene, reference(scene)).over_steps("native", name))
    wider = scene.duration / math.floor(point.steps / 1.1 - 1e-9)
    return point.longest and point.error < 1 and breaks_down(scene, "native", name, wider)


@pytest.mark.parametrize("name", METHODS)
def test_no_longer_step_is_stable(name):
    assert longest_holds(SCENE, name)


def test_in_the_sonic_vacuum_the_longest_step_is_found_by_trials():
    """The sonic vacuum has no band edge, so that no step is refused beforehand."""
    chain = Chain(grains=8, diameter=1e-3, gravity=0.0)
    scene = Scene(chain=chain, excitation=Impulse(velocity=8.57e-3), duration=3e-5, samples=2)
    assert longest_holds(scene, "verlet")


def test_times_are_stored_separately(found):
    for curve in found.curves:
        for p in curve.points:
            assert 0 < p.integration_s < 60
            assert p.setup_s >= 0
            assert p.estimate_s >= 0
            if curve.to_tolerance:
                assert p.seconds >= p.integration_s + p.estimate_s
                assert p.error <= p.expected_error <= p.tolerance
            else:
                assert p.seconds == p.integration_s
                assert p.tolerance is None
    native = next(curve.points[-1] for curve in stepped(found) if curve.engine == "native")
    rate = native.force_evaluations * SCENE.chain.grains / native.integration_s
    assert native.grain_steps_per_s == pytest.approx(rate, rel=0.3)


def test_points_below_the_reference_error_are_dropped():
    truth = reference(SCENE)
    bench = Bench(SCENE, replace(truth, error=1e-8))
    points = list(bench.over_steps("native", "rkn6"))
    assert min(point.error for point in points) >= 1e-7
    assert bench.dropped == 4  # The search then stops, because no point improves.


def test_the_pareto_front(found):
    points = found.points
    for p in points:
        beaten = any(q.seconds <= p.seconds and q.error < p.error for q in points) or any(
            q.seconds < p.seconds and q.error <= p.error for q in points
        )
        assert p.pareto is not beaten
    assert front([]) == []
    assert front([(1, 1), (1, 1), (2, 1)]) == [0]


def test_time_to_an_error():
    points = [(1.0, 1e-2), (4.0, 1e-6), (8.0, 1e-5), (9.0, 1e-8)]
    assert time_to(1e-2, points) == 1.0
    assert time_to(1e-4, points) == pytest.approx(2.0, rel=1e-12)
    assert time_to(1e-1, points) == 1.0
    assert 8 < time_to(1e-7, points) < 9
    assert math.isnan(time_to(1e-9, points))
    assert math.isnan(time_to(1e-9, []))


def test_json_has_the_documented_form(found):
    data = found.to_json()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert data["reference"]["error"] == found.reference.error < 1e-14
    assert {"lmpchain", "python", "numpy", "numba", "lammps"} <= set(data["versions"])
    assert re.search(r", \d+ cores$", data["machine"])
    asked = {
        "engine", "integrator", "equation", "error", "error_displacement", "error_velocity",
        "expected_error",
        "integration_s", "setup_s", "estimate_s", "steps", "force_evaluations", "step_s",
        "grain_steps_per_s", "pareto",
    }  # fmt: skip
    assert all(asked <= set(row) for row in data["rows"])
    assert len(data["rows"]) == sum(len(curve.points) for curve in found.curves)


def test_the_picture(found, tmp_path):
    picture = found.plot(others=PEERS).figure
    over_time, over_evaluations, bars, names, ways = picture.axes
    assert {ax.get_xscale() for ax in picture.axes[:3]} | {
        ax.get_yscale() for ax in picture.axes[:2]
    } == {"log"}
    assert over_time.get_xlabel() == "time (s)"
    assert over_time.get_ylabel() == "relative error"
    # The legend is away from the curves.
    assert over_evaluations.get_legend() is None
    shown = [text.get_text().replace("\n", " ") for text in names.get_legend().get_texts()]
    # On a busy machine there may be no other curves.
    assert {"native, to a tolerance", "Pareto front"} <= set(shown)
    assert len(shown) == len(set(shown)) <= LABELLED + 5
    assert {"lammps, verlet", "lammps, rkn6"} <= set(shown)
    lines = [text.get_text() for text in ways.texts]
    assert lines[1].startswith("10⁻³")
    # Columns of raised powers are aligned.
    start = lines[0].index("engine")
    assert all(re.fullmatch(r" \S", line[start - 1 : start + 1]) for line in lines)
    assert not any(" us" in line for line in lines)
    rings = [line for line in over_evaluations.lines if line.get_markersize() == 14]
    assert 1 <= len(rings) <= LABELLED + 3
    guides = [text.get_text() for text in over_evaluations.texts]
    assert {"better", "2", "4", "6", "8", "order"} <= set(guides)
    times = {
        name.get_text(): dot.get_xdata()[0]
        for name, dot in zip(bars.get_yticklabels(), bars.lines, strict=True)
    }
    for curve in found.curves:
        seconds = time_to(TARGET, [(point.seconds, point.error) for point in curve.points])
        assert times.get(curve.name, math.nan) == pytest.approx(1e3 * seconds, nan_ok=True)
    assert list(times.values()) == sorted(times.values())
    save(picture, tmp_path / "chart.png")
    footer = picture._supxlabel.get_text().replace("\n", " ")
    assert f"the error estimate, on {found.machine}; " in footer


def test_runs_to_a_tolerance_are_named_however_few(found):
    """On a busy machine the time may end after the first point."""
    curves = tuple(
        replace(curve, points=curve.points[: 1 if curve.to_tolerance else None])
        for curve in found.curves
    )
    axes = replace(found, curves=curves).plot()
    assert "native, to a tolerance" in axes.figure.axes[1].get_legend_handles_labels()[1]


def test_a_picture_in_axes_of_the_user(found):
    mine = figure()
    axes = mine.subplots(1, 3)
    # On a busy machine no curve may reach the target, but the other codes do.
    assert found.plot(axes, PEERS) is axes[0]
    assert found.plot(ax=figure().subplots()).lines
    assert all(ax.has_data() for ax in axes)


def test_the_table_lists_the_time_to_each_error(found):
    lines = found.table({"other": [(1e-2, 1e-5), (3e-2, 1e-9)]}).splitlines()
    assert max(map(len, lines)) <= 80
    head = lines[lines.index("") + 1]
    assert head.split()[-4:] == ["1e-03", "1e-06", "1e-09", "1e-12"]
    assert re.fullmatch(r"other +10 ms +\S+ ms +30 ms +-", lines[-1])
    assert any(line.startswith("native, to a tolerance, without the estimate") for line in lines)


def test_the_cheapest_way_to_an_error_has_it(found):
    """A run with the step of a row has the stated error, compared with another integrator."""
    truth = extended_reference(SCENE)
    ways = [*found.cheapest(), *found.cheapest("lammps")]
    # On a busy machine the time limit may be reached early.
    assert ways[0].engine
    for way in ways:
        points = [p for p in found.points if p.error <= way.target and way.engine in ("", p.engine)]
        if way.engine and not way.to_tolerance and way.integrator:
            assert way.seconds == min(p.seconds for p in points)
            engine = engines.get(way.engine, integrator=way.integrator, step=way.step_s)
            t = simulate(SCENE, engine)
            assert distance(t, truth) <= 1.01 * way.target
    assert [way.target for way in ways] == 2 * [1e-3, 1e-6, 1e-9, 1e-12]


@pytest.mark.parametrize("budget", [0.0, -1.0, math.nan, math.inf, "2", True])
def test_a_budget_limits_the_time(budget):
    with pytest.raises(InputError, match="budget"):
        work_precision(SCENE, budget)


def test_charts_that_take_too_long_are_rejected():
    with pytest.raises(InputError, match=r"^duration: the reference alone would take about "):
        work_precision(Scene(**SCENE.given() | {"duration": 1e3}))
    # The time of the reference is short, so that the budget is most of the announced time.
    with cost_model.budget(90), pytest.raises(cost_model.TooLong, match=r"^the chart .* 100 s"):
        work_precision(SCENE, 100.0)


def test_engines_beyond_the_time_limit_are_left_out():
    scene = scene_of(Chain(grains=3000, diameter=1e-3), Impulse(velocity=1e-6), 1e-5, 2)
    found = work_precision(scene, 1e-3)
    assert "modes" not in {curve.engine for curve in found.curves}
    assert any(
        re.match(r"modes: a run would take about \S+ s", reason) for reason in found.left_out
    )


@pytest.mark.slow
def test_the_command(tmp_path, capsys):
    SCENE.to_toml(tmp_path / "scene.toml")
    chart = tmp_path / "chart.png"
    assert (
        main(["workprec", str(tmp_path / "scene.toml"), "--budget", "0.1", "-o", str(chart)]) == 0
    )
    assert chart.read_bytes()[:4] == b"\x89PNG"
    assert json.loads((tmp_path / "chart.json").read_text())["rows"]
    assert "native, rkn6" in capsys.readouterr().out
    assert main(["workprec", str(tmp_path / "scene.toml"), "--budget", "0"]) == 2
    assert capsys.readouterr().err.startswith("error: budget: must be a time above 0 s")
    assert main(["workprec", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "chart.gif")]) == 2
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.slow
def test_ctrl_c_leaves_nothing_behind(tmp_path):
    SCENE.to_toml(tmp_path / "scene.toml")
    words = ["workprec", "scene.toml", "--budget", 600, "-o", "chart.png"]
    with on_a_terminal(*COMMAND, *words, cwd=tmp_path) as (process, read_until):
        read_until(r" [1-9]\d* of \d+ \|")  # The progress bar has appeared.
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) in (130, -signal.SIGINT)  # A shell reports 130 for either.
        assert "Traceback" not in read_until("stopped by Ctrl-C")
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]


@pytest.mark.slow
def test_the_script(tmp_path):
    command = [sys.executable, SCRIPT, "weak", "--budget", "0.1", "-o", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("weak\nto reach ")
    rows = json.loads((tmp_path / "work_precision_weak.json").read_text())["rows"]
    assert {row["engine"] for row in rows} == {
        "native",
        "lammps",
        "modes",
        "chebyshev",
        "bessel",
        "continuum",
    }
    assert 10_000 < (tmp_path / "work_precision_weak.png").stat().st_size < 400_000
