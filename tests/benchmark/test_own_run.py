"""Errors of users' runs: dumps of `lmp`, causes, remedies, and decks before a run."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import taylor_series
from helpers.independent_integrators import distance
from helpers.standalone_lammps import lmp, read_dump, small
from helpers.thinned import thinned

import lmpchain
from lmpchain import (
    Damping,
    Force,
    Impulse,
    InputError,
    Scene,
    check,
    check_deck,
    simulate,
)
from lmpchain.benchmark import cures as remedies
from lmpchain.benchmark.reference import expected_seconds, reference
from lmpchain.cli.command_line import main
from lmpchain.engines import Native
from lmpchain.engines.lammps.column import LammpsColumn
from lmpchain.engines.lammps.export import write_deck
from lmpchain.integrators.methods import METHODS
from lmpchain.measure import front

STEP = 4e-7  # Too long a step, s.
VACUUM = small(Impulse(velocity=8.57e-3), gravity=0.0, bottom="wall")


def dump_of(scene: Scene, folder: Path, edit: tuple[str, str] = ("", ""), **options) -> Path:
    """Run an edited deck with the stand-alone LAMMPS, and return its dump."""
    deck = write_deck(scene, folder, **({"step": STEP} | options))
    text = deck.read_text()
    assert re.search(edit[0], text)
    deck.write_text(re.sub(*edit, text, count=1) if edit[0] else text)
    lmp(folder, "-screen", "none", "-log", "none")
    return folder / "column.lammpstrj"


def true_error(scene: Scene, motion: tuple[np.ndarray, np.ndarray]) -> float:
    solution, itself = taylor_series.reference(scene, 1e-17)
    assert itself < 1e-13
    return solution.error(*motion)


def causes(found) -> dict[str, float]:
    return {cause.name: cause.error for cause in found.causes}


def with_dense_samples(scene: Scene) -> Scene:
    return scene.replace(samples=200 * (scene.samples - 1) + 1)


@pytest.fixture(scope="module")
def dump(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return dump_of(small(), tmp_path_factory.mktemp("deck"))


def test_the_error_of_too_long_a_step_is_measured(dump: Path):
    found = check(dump, small())
    assert found.error == pytest.approx(true_error(small(), read_dump(dump)), rel=1e-9)
    assert found.error == max(found.error_displacement, found.error_velocity) > 1e-3
    assert (found.integrator, found.steps) == ("verlet", 50)
    assert found.step_s == pytest.approx(STEP, rel=1e-12)
    assert found.cause == "step"
    assert causes(found)["step"] == pytest.approx(found.error, rel=1e-4)
    assert causes(found)["digits"] < 1e-6


def test_each_cure_reaches_its_error_and_longer_steps_do_not(dump: Path):
    found = check(dump, small())
    assert {(cure.target, cure.integrator) for cure in found.cures} == {
        (target, name) for target in (1e-3, 1e-6) for name in ("verlet", "kahan-li6", "rkn6")
    }
    interval = 4e-6
    for cure in found.cures:
        t = simulate(small(), Native(cure.integrator, cure.step_s))
        assert t.cost.steps == cure.steps
        wrong = true_error(small(), (t.displacement, t.velocity))
        assert wrong == pytest.approx(cure.error, rel=1e-3, abs=1e-15)
        assert wrong <= cure.target
        per_sample = round(interval / cure.step_s)
        if cure.integrator == "verlet" and per_sample > 5:
            longer = simulate(small(), Native("verlet", interval / round(0.8 * per_sample)))
            assert true_error(small(), (longer.displacement, longer.velocity)) > cure.target


def test_an_error_that_no_short_run_reaches_has_no_step(monkeypatch: pytest.MonkeyPatch):
    """Without a limit, verlet needs 30 times as many steps for an error 1000 times smaller."""
    run = simulate(small(), Native("verlet", STEP))
    verlet = [cure for cure in check(run).cures if cure.integrator == "verlet"]
    between = round(np.sqrt(verlet[0].steps * verlet[1].steps))
    limit_s = Native("verlet").cost(small(), METHODS["verlet"], between)
    monkeypatch.setattr(remedies, "SEARCH", replace(remedies.SEARCH, cost_s=limit_s))
    found = check(run)
    missing = [cure for cure in found.cures if np.isnan(cure.step_s)]
    assert [(cure.target, cure.integrator) for cure in missing] == [(1e-6, "verlet")]
    assert all((cure.steps, cure.diameter) == (0, "physical") for cure in missing)
    assert np.isnan([(cure.error, cure.heights) for cure in missing]).all()
    lines = [line.split() for line in found.table().splitlines()]
    assert ["1e-06", "verlet", "none"] in lines


def test_the_energy_is_that_of_the_motion(tmp_path: Path):
    """In a vacuum nothing cancels, so that sums over grains and contacts show the energy."""
    found = check(dump_of(VACUUM, tmp_path), VACUUM)

    def total(u, v):
        chain = VACUUM.chain
        constants = np.append(chain.contact_constants, chain.wall_constants[1])
        overlap = np.maximum(u - np.append(u[:, 1:], np.zeros((len(u), 1)), axis=1), 0)
        return (chain.masses * v**2 / 2).sum(1) + (constants * overlap**2.5 / 2.5).sum(1)

    solution, _ = taylor_series.reference(VACUUM, 1e-17)
    energy, exact = total(*read_dump(tmp_path / "column.lammpstrj")), total(*solution[:2])
    assert found.error_energy == pytest.approx(np.abs(energy - exact).max() / exact.max(), rel=1e-6)
    assert found.limit_s == np.inf
    assert "no stability limit at rest" in found.table()


def test_the_delay_of_the_front_agrees_with_an_independent_solution(tmp_path: Path):
    scene = small().replace(samples=41, duration=4e-5)
    dump = dump_of(scene, tmp_path)
    found = check(dump, scene)
    fine = with_dense_samples(scene)
    velocity = taylor_series.reference(fine, 1e-17)[0].velocity
    n = found.arrival.grain
    # The peak of the parabola through the highest sample and its neighbours.
    k = int(velocity[:, n - 1].argmax())
    before, top, after = velocity[k - 1 : k + 2, n - 1]
    offset = (before - after) / (before - 2 * top + after) / 2
    exact = (k + offset) * fine.duration / (fine.samples - 1)
    tracked = front.track(lmpchain.Trajectory.from_dump(dump, scene))
    late = tracked.time[tracked.grain == n][0] - exact
    assert found.arrival.seconds == pytest.approx(abs(late), rel=1e-2)
    assert found.arrival.relative == pytest.approx(found.arrival.seconds / exact, rel=1e-6)


def test_few_digits_are_named_as_the_cause(tmp_path: Path):
    short = {"integrator": "kahan-li6", "step": 1e-7}
    all_digits = dump_of(small(), tmp_path / "all", **short)
    few = dump_of(small(), tmp_path / "few", (r"float %\.17g", "float %g"), **short)
    found = check(few, small())
    left_out = distance(read_dump(few), read_dump(all_digits))
    assert found.cause == "digits"
    assert found.integrator == "kahan-li6"
    assert causes(found)["digits"] == pytest.approx(left_out, rel=0.2)
    assert found.error == pytest.approx(true_error(small(), read_dump(few)), rel=1e-4)
    assert "%.17g" in found.causes[1].why
    fine = check(all_digits, small())
    assert causes(fine)["digits"] < 0.1 * left_out
    assert "rounding error of the heights" in fine.causes[1].why
    # The check of the deck predicts the largest rounding error of six digits before the run.
    (expected,) = (c.error for c in check_deck(tmp_path / "few").causes if c.name == "digits")
    assert expected == pytest.approx(0.5e-5, rel=1e-12)
    assert left_out < expected < 10 * left_out


def test_single_precision_has_too_few_digits(dump: Path, tmp_path: Path):
    rounded = []
    for line in dump.read_text().splitlines():
        words = line.split()
        if len(words) == 10 and words[0] != "ITEM:":
            numbers = [f"{np.float32(word):.17g}" for word in words[5:9]]
            line = " ".join([*words[:5], *numbers, words[9]])
        rounded.append(line)
    single = tmp_path / "single.lammpstrj"
    single.write_text("\n".join(rounded) + "\n")
    found = check(single, small())
    left_out = distance(read_dump(single), read_dump(dump))
    assert causes(found)["digits"] == pytest.approx(left_out, rel=0.5)
    assert re.search(r"about [78] digits", found.causes[1].why)


def test_errors_without_a_known_cause_are_reported(tmp_path: Path):
    damp = (r"\nfix +motion", r"\nfix damp mobile viscous 1e-4\g<0>")
    found = check(dump_of(small(), tmp_path, damp, step=1e-8), small())
    assert found.cause == "another cause"
    assert causes(found)["another cause"] == pytest.approx(found.error, rel=1e-2)
    assert "forces that the scene" in " ".join(found.table().split())
    with pytest.raises(InputError, match="fix damp mobile viscous"):
        check_deck(tmp_path)


@pytest.mark.parametrize(
    ("integrator", "pair_style"),
    [
        ("verlet", "granular"),
        pytest.param("verlet", "gran/hertz/history", marks=pytest.mark.slow),
        pytest.param("lagged-verlet", "granular", marks=pytest.mark.slow),
        pytest.param("lagged-verlet", "gran/hertz/history", marks=pytest.mark.slow),
    ],
)
def test_damped_dumps_and_decks(integrator: str, pair_style: str, tmp_path: Path, monkeypatch):
    scene = small(damping=Damping(viscoelastic=2e-7, drag=1e3))
    if integrator == "lagged-verlet":
        # Decks of earlier versions, and the fixes and atoms of most users.
        monkeypatch.setattr(LammpsColumn, "predicts", False)
    dump = dump_of(scene, tmp_path, step=1e-7, pair_style=pair_style)
    monkeypatch.undo()
    found = check(dump, scene)
    assert found.error == pytest.approx(true_error(scene, read_dump(dump)), rel=1e-6)
    assert (found.cause, found.integrator) == ("step", integrator)
    assert {cure.integrator for cure in found.cures} == {integrator, "verlet", "dop853"}
    assert ("`fix mvv/dpd 1.0`" in found.table()) == (integrator == "lagged-verlet")
    before = check_deck(tmp_path)
    assert before.integrator == integrator
    assert before.error == pytest.approx(found.error, rel=1e-3)


@pytest.mark.parametrize(
    "options",
    thinned(
        [{"integrator": "kahan-li6"}, {"diameter": "gauge"}, {"pair_style": "gran/hertz/history"}],
        3,
    ),
)
def test_every_kind_of_deck_is_read(options: dict[str, str], tmp_path: Path):
    dump = dump_of(small(), tmp_path, **options)
    before = check_deck(tmp_path)
    after = check(dump, small())
    assert before.error == pytest.approx(after.error, rel=5e-2)
    assert before.integrator == after.integrator == options.get("integrator", "verlet")
    assert causes(before)["step"] == pytest.approx(causes(after)["step"], rel=1e-6)


def test_a_deck_with_points_contains_its_scene(tmp_path: Path):
    times = [0.0, 1e-6, 2e-5]
    scene = small(Force(grain=1, times=times, force=[0.0, 1e-3, 0.0]), bottom="wall")
    write_deck(scene, tmp_path, step=1e-7)
    with pytest.raises(InputError, match=r"is given by points.*--scene"):
        check_deck(tmp_path)
    t = simulate(scene, Native("verlet", 1e-7))
    assert check_deck(tmp_path, scene).error == pytest.approx(
        true_error(scene, (t.displacement, t.velocity)), rel=1e-4
    )


def test_a_step_beyond_the_stability_limit_is_named(tmp_path: Path, capsys):
    write_deck(small(), tmp_path, step=1e-6)
    deck = tmp_path / "in.column"
    deck.write_text(deck.read_text().replace("timestep        ${dt}", "timestep 5e-6"))
    deck.write_text(re.sub(r"\nrun .*", "\nrun 20", deck.read_text()))
    found = check_deck(tmp_path)
    chain = small().chain
    # The exact solution of the linear chain, from its matrix.
    k = np.append(chain.linear_stiffness, 0.0)[: chain.movable]
    matrix = np.diag(k + np.append(0.0, k[:-1])) - np.diag(k[:-1], 1) - np.diag(k[:-1], -1)
    fastest = np.sqrt(np.linalg.eigvalsh(matrix / chain.masses[0])[-1])
    assert found.limit_s == pytest.approx(2 / fastest, rel=1e-9)
    assert found.error == np.inf
    assert "beyond the stability limit" in found.table()
    assert main(["check", "--deck", str(tmp_path), "--tolerance", "1e-3"]) == 1
    said = capsys.readouterr().out
    assert f"5e-06 s is beyond the stability limit of {found.limit_s:.3g} s" in said


def test_saved_runs_contain_their_scene(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    small().to_toml("scene.toml")
    small(Impulse(velocity=1e-3)).to_toml("other.toml")
    t = simulate(small(), Native("verlet", STEP))
    t.save("run.nc")
    given = ["--scene", "scene.toml", "--tolerance", "0.5", "--json", "check.json"]
    assert main(["check", "run.nc", *given]) == 0
    table = capsys.readouterr().out
    assert max(map(len, table.splitlines())) <= 80
    numbers = json.loads(Path("check.json").read_text())
    assert numbers["error"] == pytest.approx(true_error(small(), (t.displacement, t.velocity)))
    assert numbers["cause"] == "step"
    assert numbers["reference"]["error"] < 1e-15
    assert [cure["target"] for cure in numbers["cures"]] == 3 * [1e-3] + 3 * [1e-6]
    assert main(["check", "run.nc", "--tolerance", "1e-6"]) == 1
    simulate(small(), "lammps", 1e-4, folder="folder")
    assert main(["check", "folder", "--tolerance", "1e-4"]) == 0
    capsys.readouterr()
    text = write_deck(small(), "deck", step=1e-7).read_text()
    Path("deck/in.column").write_text(text.replace("%.17g", "%d"))
    for words, fault in (
        (["--deck", "deck"], "must end in a format"),
        (["run.nc", "--scene", "other.toml"], "scene: is not the scene of the run"),
        (["run.nc", "--deck", "deck"], "run: give either a dump"),
        ([], "run: give either a dump"),
        (["run.nc", "--tolerance", "2"], "tolerance: must be between 0 and 1"),
        (["none.nc"], "none.nc: there is no such file"),
    ):
        assert main(["check", *words]) == 2
        told = capsys.readouterr().err
        assert fault in told
        assert told.count("\n") == 1


def test_runs_and_scenes_of_the_wrong_type_are_refused(dump: Path):
    run = simulate(small(), Native("verlet", STEP))
    for call, message in (
        (lambda: check(None), r"run: must be a trajectory, or the path of a run \(got None\)"),
        (lambda: check(dump, "scene.toml"), r"scene: must be a Scene \(got 'scene\.toml'\)"),
        (lambda: check(run, units="si"), "units: is only for a LAMMPS dump"),
        (lambda: check(run, small(Impulse(velocity=1e-3))), "scene: is not the scene of the run"),
        (lambda: check_deck(3), r"folder: must be the path of a deck \(got 3\)"),
        (lambda: check_deck(dump.parent, "scene.toml"), r"scene: must be a Scene"),
        (lambda: reference(None), r"scene: must be a Scene \(got None\)"),
        (lambda: expected_seconds(None), r"scene: must be a Scene \(got None\)"),
    ):
        with pytest.raises(InputError, match=f"^{message}"):
            call()


def test_a_dump_needs_its_scene(dump: Path, capsys):
    assert main(["check", str(dump)]) == 2
    assert "scene: is missing" in capsys.readouterr().err


def test_a_solution_of_another_equation_has_a_model_error():
    scene = small(Impulse(velocity=1e-5))
    with pytest.warns(UserWarning, match="leaves out"):
        t = simulate(scene, "modes")
    found = check(t)
    assert found.cause == "equation"
    assert found.error == pytest.approx(true_error(scene, (t.displacement, t.velocity)), rel=1e-9)
    assert "Eq. (3)" in found.table()


def test_weak_waves_need_gauge_diameters_in_lammps():
    """Heights of 25 mm are rounded to 3e-18 m, 5e-5 of a motion of 7e-14 m."""
    found = check(simulate(small(Impulse(velocity=1e-8)), Native("verlet", STEP)))
    (fine,) = (c for c in found.cures if (c.target, c.integrator) == (1e-6, "verlet"))
    assert fine.diameter == "gauge"
    assert fine.heights < 1e-6
    assert "(gauge)" in found.table()


def test_unrecorded_grains_make_the_energy_unknown():
    found = check(simulate(small().replace(grains="1:5"), Native("verlet", STEP)))
    assert np.isnan(found.error_energy)
    assert found.to_json()["error_energy"] is None
    assert "moving grains were not recorded" in found.table()


def test_the_steps_of_a_saved_run_are_its_own(tmp_path: Path):
    """A run with adaptive steps around openings has more steps than one with equal steps."""
    scene = small(Impulse(velocity=8.57e-3)).replace(duration=4e-5, samples=11)
    t = simulate(scene, "native", 1e-4)
    t.save(tmp_path / "run.nc")
    found = check(tmp_path / "run.nc")
    assert found.steps == t.cost.steps > round(scene.duration / t.cost.step_s)
    assert f"{t.cost.steps} steps of" in " ".join(found.table().split())
    assert "on average" in found.table()
