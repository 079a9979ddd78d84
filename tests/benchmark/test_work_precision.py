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
from pathlib import Path

import pytest
from helpers.child_processes import COMMAND, PATIENCE, on_a_terminal
from helpers.example_scenes import scene_of, smooth
from helpers.independent_integrators import distance, extended_reference

from lmpchain import Chain, Impulse, InputError, RunFailed, Scene, engines, simulate
from lmpchain.benchmark.bench import Bench, work_precision
from lmpchain.benchmark.curves import time_to
from lmpchain.benchmark.reference import reference
from lmpchain.cli.command_line import main
from lmpchain.engines import cost_model
from lmpchain.integrators.methods import METHODS

SCRIPT = Path(__file__).parents[2] / "analysis" / "work_precision.py"
SCENE = smooth()


@pytest.fixture(scope="module")
def chart():
    """Return the chart, and what the runs said on stderr."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        return work_precision(SCENE, 0.5, progress=True), said.getvalue()


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
        assert again.cost.force_evaluations == point.force_evaluations
        assert point.error == pytest.approx(distance(again, (u, v)), rel=1e-2, abs=0)
        assert point.error == max(point.error_displacement, point.error_velocity) > 100 * itself
        assert point.expected_error == again.error_estimate.total


def breaks_down(scene, engine, integrator, step):
    try:
        answer = simulate(scene, engines.get(engine, integrator=integrator, step=step))
    except (InputError, RunFailed):
        return True
    truth = reference(scene)
    return distance(answer, truth) >= 1


# The sonic vacuum has no band edge, so that no step is refused beforehand.
VACUUM = scene_of(Chain(grains=8, diameter=1e-3, gravity=0.0), Impulse(velocity=8.57e-3), 3e-5, 2)


@pytest.mark.parametrize(("scene", "name"), [(SCENE, "rkn6"), (VACUUM, "verlet")])
def test_no_longer_step_is_stable(scene, name):
    point = next(Bench(scene, reference(scene)).over_steps("native", name))
    assert point.longest
    assert point.error < 1
    wider = scene.duration / math.floor(point.steps / 1.1 - 1e-9)
    assert breaks_down(scene, "native", name, wider)


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


def test_the_pareto_front(found):
    points = found.points
    for p in points:
        beaten = any(q.seconds <= p.seconds and q.error < p.error for q in points) or any(
            q.seconds < p.seconds and q.error <= p.error for q in points
        )
        assert p.pareto is not beaten


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


def test_a_budget_limits_the_time():
    for budget in (0.0, -1.0, math.nan, math.inf, "2", True):
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
