"""All limits of a scene: the command, its table and picture, and warnings of `run`."""

import contextlib
import io
import json
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.example_scenes import paper

from lmpchain import Chain, Impulse, Scene
from lmpchain.cli.command_line import main
from lmpchain.engines import Lammps, Modes, Native
from lmpchain.stability import find
from lmpchain.stability.find import stability
from lmpchain.stability.pre_run import pre_run_warnings
from lmpchain.stability.result import Stability
from lmpchain.stability.step_limit import limit

FEW = Chain(grains=12, material="steel", diameter=3e-3)
STRUCK = Scene(chain=FEW, excitation=Impulse(velocity=0.05), duration=1e-3, samples=101)


@pytest.fixture(scope="module")
def search() -> tuple[Stability, str]:
    """Return the limits of a strong strike on a few grains, and what the search said.

    The runs that show the boundaries give no warnings, because the user did not ask for them.
    """
    said = io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stderr(said):
        warnings.simplefilter("error")
        return stability(STRUCK, progress=True), said.getvalue()


@pytest.fixture(scope="module")
def found(search: tuple[Stability, str]) -> Stability:
    """Return the boundaries alone."""
    return search[0]


def test_the_search_says_how_far_it_is(search: tuple[Stability, str]):
    shown = re.findall(r"(longest step, \w+|energy, \w+): (\d+) of (\d+) ", search[1])
    names, numbers, totals = zip(*shown, strict=True)
    assert {"longest step, verlet", "longest step, rkn4", "energy, verlet"} <= set(names)
    assert int(numbers[-1]) > len(set(names)) / 2
    assert len(set(totals)) == 1


def by_method(found: Stability, what: str) -> dict:
    return {row.method: row for row in found.boundaries if row.what == what}


def test_every_limit_is_found_and_predicted(found: Stability):
    steps = by_method(found, "longest step")
    assert len(steps) == 8
    for row in steps.values():
        assert row.predicted / 1.6 < row.measured < 3.5 * row.predicted
    verlet = steps["native verlet"]
    lammps = steps["lammps verlet"]
    assert verlet.predicted == limit(STRUCK, "verlet")
    assert lammps.measured == pytest.approx(verlet.measured, rel=0.02, abs=0)
    floors = by_method(found, "smallest error")
    assert (
        floors["lammps, gauge diameter"].predicted < floors["lammps, physical diameter"].predicted
    )
    assert all(0 < row.measured < 1e-3 for row in floors.values())
    linear = by_method(found, "linear theory 10 % off at v0*")["Eq. (3)"]
    assert linear.beyond
    assert linear.here == STRUCK.strike_number
    assert not found.left_out


def test_curves(found: Stability):
    names = {curve.name for curve in found.curves if curve.panel == "energy"}
    assert {"verlet", "rkn6", "gear4"} <= names
    for curve in found.curves:
        if curve.panel == "energy":
            assert curve.x.size == 401
            assert curve.x[-1] == pytest.approx(1000 * 2 * np.pi / FEW.band_edge, rel=1e-12)
    growth = next(curve for curve in found.curves if curve.panel == "growth")
    assert growth.y[0] == pytest.approx(1e-13, rel=1e-2, abs=0)
    assert growth.y[-1] > 1e-12
    rounding = next(curve for curve in found.curves if curve.name.startswith("lammps, physical"))
    assert np.all(np.diff(rounding.y[:5]) < 0)


def test_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(find, "LONGEST_S", 0.0)  # Measurements are compared with their laws above.
    scene, chart, numbers = (tmp_path / name for name in ("scene.toml", "chart.png", "found.json"))
    paper("weak").to_toml(scene)
    assert main(["stability", str(scene), "-o", str(chart), "--json", str(numbers)]) == 0
    said = capsys.readouterr().out
    assert "predicted" in said.splitlines()[0]
    assert "!" not in said  # A weak strike exceeds no limit.
    assert chart.read_bytes()[:4] == b"\x89PNG"
    rows = json.loads(numbers.read_text())["rows"]
    assert {"what", "method", "unit", "predicted", "measured", "here", "beyond"} == set(rows[0])


def test_a_weak_scene_causes_no_warning():
    for engine in (Native(), Lammps(), Modes(), Native(integrator="verlet", step=1e-7)):
        assert not list(pre_run_warnings(paper("weak"), engine, 1e-6))


def test_the_warning_of_a_run_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    STRUCK.to_toml(tmp_path / "scene.toml")
    step = f"{1.9 / FEW.band_edge}"
    options = ["--engine", "native", "--integrator", "verlet", "--step", step]
    main(["run", str(tmp_path / "scene.toml"), *options])
    lines = capsys.readouterr().err.splitlines()
    assert sum(line.startswith("warning: step: ") for line in lines) == 1
