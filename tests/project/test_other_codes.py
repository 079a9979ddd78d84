"""Other codes in `analysis/other_codes`: their accuracy, and the table of their measurements."""

import shutil
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from helpers.example_scenes import paper
from helpers.independent_integrators import extended_reference
from helpers.thinned import thinned

import lmpchain
from lmpchain.benchmark.reference import Reference

PEERS = Path(__file__).parents[2] / "analysis" / "other_codes"


@pytest.fixture(scope="module")
def peer():
    """Return a module of the folder, which is not a package."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(PEERS)
        patch.setenv("OPENBLAS_NUM_THREADS", "1")
        yield import_module
    for path in PEERS.glob("*.py"):
        sys.modules.pop(path.stem, None)


def short(velocity: float, grains: int = 12) -> lmpchain.Scene:
    """Return a column with a strike so short that the wave stays near the top."""
    chain = lmpchain.Chain(grains=grains, material="glass", diameter=1e-3)
    return lmpchain.Scene(
        chain=chain, excitation=lmpchain.Impulse(velocity=velocity), duration=20e-6, samples=2
    )


def truth(scene: lmpchain.Scene) -> Reference:
    """Return a solution that shares only Eq. (1) with the other codes."""
    u, v, error = extended_reference(scene)
    return Reference(scene.time, u, v, error, "Taylor series in extended precision")


@pytest.mark.parametrize(
    ("velocity", "within"), thinned([(8.57e-3, 1e-9), (1e-9, 1e-11), (8.57e-4, 1e-11)], 3)
)
@pytest.mark.slow
def test_scipy_is_accurate_for_weak_waves_and_openings(peer, velocity, within):
    problem = peer("problem").Problem(short(velocity))
    known = truth(problem.scene)
    for code in peer("with_scipy").codes(problem):
        errors = [
            peer("problem").error(code.solve(problem, tolerance), known)
            for tolerance in (1e-4, 1e-15)
        ]
        assert errors[1] < within < errors[0] < 0.1, code.name
        assert 20 < code.solve(problem, 1e-4).force_evaluations < 1000


def test_lammps_as_users_write_it_is_accurate(peer):
    problem = peer("problem").Problem(short(8.57e-4))
    (code,) = peer("with_lammps").codes(problem)
    answers = [code.solve(problem, problem.scene.duration / steps) for steps in (250, 500)]
    coarse, fine = (peer("problem").error(answer, truth(problem.scene)) for answer in answers)
    assert answers[1].force_evaluations == 500
    assert coarse / fine == pytest.approx(4, rel=0.02)
    assert fine < 1e-4


def test_yade_is_as_accurate_as_lammps(peer):
    """Leapfrog equals velocity Verlet: both have the same errors of second order."""
    if not shutil.which("yade"):
        pytest.skip("there is no program yade here")
    problem = peer("problem").Problem(short(8.57e-4))
    (lammps,) = peer("with_lammps").codes(problem)
    (yade,) = peer("with_yade").codes(problem)
    known = truth(problem.scene)
    steps = [problem.scene.duration / count for count in (250, 500)]
    coarse, fine = (peer("problem").error(yade.solve(problem, step), known) for step in steps)
    assert coarse / fine == pytest.approx(4, rel=0.02)
    assert fine == pytest.approx(
        peer("problem").error(lammps.solve(problem, steps[1]), known), rel=1e-3
    )
    displaced = problem.scene.replace(excitation=lmpchain.Displacement(displacement=1e-9))
    with pytest.raises(lmpchain.RunFailed, match="strike grains at rest"):
        peer("with_yade").codes(peer("problem").Problem(displaced))


@pytest.mark.slow
def test_codes_are_timed_alternately_with_lammps(peer, monkeypatch):
    """The time per step is the stored LAMMPS time, scaled by the ratio of shortest times."""
    run = peer("run")
    scene = short(8.57e-4)
    code = peer("with_scipy").codes(peer("problem").Problem(scene))[1]

    def within(seconds: float):
        def solve(problem, _):
            return replace(code.solve(problem, 1e-6), seconds=seconds, force_evaluations=100)

        return solve

    step = scene.duration / 100
    module = type(run)("with_other")
    module.codes = lambda _: [replace(code, name="other", parameters=[step], solve=within(6e-3))]
    yardstick = type(run)("with_lammps")
    yardstick.codes = lambda _: [replace(code, name="LAMMPS granular", solve=within(2e-3))]
    monkeypatch.setitem(sys.modules, "with_other", module)
    monkeypatch.setitem(sys.modules, "with_lammps", yardstick)
    row = {"code": "LAMMPS granular", "parameter": step, "seconds": 1e-3, "force_evaluations": 100}
    kept = run.add(scene, ["other"], {"rows": [row], "versions": {}})
    assert [row["code"] for row in kept["rows"]] == ["LAMMPS granular", "other"]
    assert kept["rows"][1]["seconds"] == pytest.approx(3e-3, rel=1e-12)
    assert kept["added"]["other"]["over_lammps"] == pytest.approx(3, rel=1e-12)
    assert kept["added"]["other"]["lammps_now_over_then"] == pytest.approx(2, rel=1e-12)


@pytest.mark.slow
def test_a_chain_cut_by_hand_agrees_with_the_whole(peer):
    problem = peer("problem").Problem(short(8.57e-4, grains=60))
    code = peer("with_scipy").codes(problem)[1]
    known = truth(problem.scene)
    assert peer("problem").error(code.solve(problem.cut(30), 1e-13), known) < 1e-11
    assert peer("problem").error(code.solve(problem.cut(5), 1e-13), known) > 1e-4


def test_the_table_gives_the_least_time_to_each_error(peer):
    run = peer("run")

    def row(code: str, error: float, seconds: float) -> dict[str, object]:
        return {"code": code, "error": error, "seconds": seconds, "whole_s": 3 * seconds}

    native = [
        row("native rkn6", 1e-4, 1e-5),
        row("native rkn6", 5e-7, 4e-5),
        row(run.TO_TOLERANCE, 1e-7, 1e-4),
    ]
    others = [
        row("one", 1e-3, 2e-4),
        row("one", 1e-6, 8e-4),
        row("one", 1e-6, 7e-4),
        row("LAMMPS granular", 1e-4, 1e-2),
    ]
    text = run.table({"rows": native + others, "rows_cut": []})
    lines = dict(line.strip("| ").split(" | ", 1) for line in text.splitlines() if " | " in line)
    assert lines["native rkn6"] == "10 | 40 | - | -"
    assert lines["one"] == "200 | 700 | - | -"
    assert lines["best of the others / native"] == "20 | 17.5 | - | -"
    assert lines["LAMMPS / native"] == "1,000 | - | - | -"
    assert lines[f"best of the others / {run.TO_TOLERANCE}"] == "2 | 7 | - | -"
    assert lines[f"{run.TO_TOLERANCE}, the whole call"] == "300 | 300 | - | -"


def test_a_failing_code_leaves_a_gap(peer, capsys):
    problem = peer("problem").Problem(short(8.57e-4))
    code = peer("with_scipy").codes(problem)[1]

    def fails_once(given, tolerance):
        if tolerance == 1e-5:
            raise lmpchain.RunFailed("it gave up")
        return code.solve(given, tolerance)

    rows = peer("run").scan(
        replace(code, parameters=[1e-4, 1e-5, 1e-6], solve=fails_once),
        problem,
        truth(problem.scene),
    )
    assert [row["parameter"] for row in rows] == [1e-4, 1e-6]
    assert rows[1]["error"] < rows[0]["error"]
    assert all(row["seconds"] > 0 for row in rows)
    assert "1 failed, the last one: it gave up" in capsys.readouterr().out


@pytest.mark.parametrize(
    "change", [{"exponent": 1.0}, {"gravity": 0.0, "top_load": 1.0}, {"bottom": "wall"}]
)
def test_unsupported_scenes_are_rejected(peer, change):
    scene = paper("weak")
    chain = lmpchain.Chain(**{"grains": 5, "diameter": 1e-3, **change})
    with pytest.raises(lmpchain.InputError, match="here"):
        peer("problem").Problem(
            lmpchain.Scene(chain=chain, excitation=scene.excitation, duration=1e-5)
        )


def test_the_compiled_right_hand_side_is_linear_at_small_amplitudes(rng, peer):
    problem = peer("problem").Problem(short(1e-9, grains=6))
    diagonal, coupling = problem.scene.chain.dynamical_matrix()
    matrix = (np.diag(diagonal) + np.diag(coupling, 1) + np.diag(coupling, -1)) * problem.time**2
    y, rate = rng.normal(size=(2, 10))
    peer("problem").fill_rate(y, rate, problem.table())
    np.testing.assert_allclose(rate, np.concatenate((y[5:], -matrix @ y[:5])), rtol=1e-4)
