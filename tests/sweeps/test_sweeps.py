"""Sweeps: their axes, executors, interruptions and results."""

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import tomli_w
from filelock import FileLock
from helpers.child_processes import PATIENCE, until
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck
from helpers.example_sweeps import contents, done, long_sweep
from helpers.faults import fault_keys
from helpers.thinned import thinned

import lmpchain.sweeps.run as run
from lmpchain import Chain, Impulse, InputError, Packet, Scene, load_sweep, simulate, sweep
from lmpchain.cli.command_line import main
from lmpchain.disorder.averages import realisation
from lmpchain.sweeps import tasks
from lmpchain.sweeps.file import read_sweep
from lmpchain.sweeps.run import Here, Processes
from lmpchain.sweeps.tasks import scenes

SCENES = Path(__file__).parents[2] / "analysis" / "scenes"
SHORT: dict[str, Any] = {
    "chain": {"grains": 12, "material": "glass", "diameter": 1e-3},
    "excitation": {"kind": "impulse", "velocity": 1e-4},
    "recording": {"duration": 2e-5, "samples": 11},
}
GRAVITIES = [1.62, 9.81, 24.8]


def chains(count: int, **more: Any) -> dict[str, Any]:
    """Return a sweep over disordered chains."""
    return {"scene": SHORT, "disorder": {"m": 20, "seed": 1, "realisations": count}} | more


def command_line(path: Path, folder: Path, *options: str) -> int:
    """Sweep in this process by the command line, and return its exit code."""
    return main(["sweep", str(path), "-o", str(folder), *(options or ("--workers", "1"))])


def begun(folder: Path) -> bool:
    """Return whether a part of a sweep is done; this is faster than counting."""
    return any(folder.glob("*/parts/[0-9]*.npz")) or any(folder.glob("*/results.zarr/reason/c/*"))


# --- swept keys


def test_a_cell_and_a_taper_are_swept() -> None:
    """Scenes equal those with all grains written out; single entries of a cell are keys as well."""
    cells = [["steel", "pom"], ["steel", "ptfe"]]
    tapers = [0.0, 0.05]
    chain = {"grains": 6, "cell": cells[0], "diameter": 1e-3}
    grid = {"chain": {"cell": cells, "taper": tapers}}
    plan = read_sweep({"scene": SHORT | {"chain": chain}, "grid": grid})
    assert plan.shape == (2, 2)
    for place in product(range(2), range(2)):
        widths = [1e-3 * (1 - tapers[place[1]]) ** n for n in range(6)]
        written = Chain(grains=6, material=cells[place[0]] * 3, diameter=widths)
        swept = plan.scene(place).chain
        assert swept.diameters == pytest.approx(widths, rel=1e-14)
        assert swept.masses == pytest.approx(written.masses, rel=1e-13)
        assert swept.contact_constants == pytest.approx(written.contact_constants, rel=1e-13)
    key = "chain.cell.1.youngs_modulus"
    plan = read_sweep({"scene": SHORT | {"chain": chain}, "grid": {key: [1e9, 2e9]}})
    moduli = [plan.scene((n,)).chain.by_grain("youngs_modulus") for n in range(2)]
    assert [values[1::2].tolist() for values in moduli] == [[1e9] * 3, [2e9] * 3]


def test_moduli_of_the_grains_of_a_cell_are_drawn():
    law = {"mean": 1e10, "deviation": 1e9}
    chain = {"grains": 6, "cell": ["steel", "pom"], "diameter": 1e-3, "taper": 0.1}
    laws = {"realisations": 2, "seed": 1, "chain.material.youngs_modulus": law}
    drawn = read_sweep({"scene": SHORT | {"chain": chain}, "disorder": laws}).scene((1,)).chain
    assert drawn.by_grain("density").tolist() == [8000.0, 1410.0] * 3
    assert len(set(drawn.by_grain("youngs_modulus").tolist())) == 6
    assert drawn.diameters[5] == pytest.approx(1e-3 * 0.9**5, rel=1e-14)


def test_a_grid_is_every_combination(tmp_path):
    """Each position contains the result of `simulate` for its values, to the last bit."""
    speeds = [1e-5, 1e-3]
    grid = {"chain": {"gravity": GRAVITIES}, "excitation.velocity": speeds}
    found = sweep({"scene": SHORT, "grid": grid}, tmp_path)
    assert found.velocity.dims == ("chain.gravity", "excitation.velocity", "time", "grain")
    assert found.sizes == {"chain.gravity": 3, "excitation.velocity": 2, "time": 11, "grain": 12}
    for gravity in GRAVITIES:
        for speed in speeds:
            chain = column(12, gravity=gravity)
            alone = simulate(struck(chain, speed, 2e-5, 11), "native")
            here = found.sel({"chain.gravity": gravity, "excitation.velocity": speed})
            assert np.array_equal(here.velocity, alone.velocity)
            assert np.array_equal(here.displacement, alone.displacement)
            assert here.solver_error == alone.error_estimate.solver
    assert np.array_equal(found.time, alone.time)
    assert (found.reason == "").all()
    found.load()  # The next sweep reuses the folder.
    turned = sweep({"scene": SHORT, "grid": dict(reversed(grid.items()))}, tmp_path)
    # The order of the axes is that of their keys.
    assert turned.velocity.dims == ("excitation.velocity", "chain.gravity", "time", "grain")
    assert turned.velocity.transpose(*found.velocity.dims).equals(found.velocity)


def test_chains_of_one_grain(tmp_path):
    """Walls are swept by their constants; small motions depend on the stiffness at rest."""
    ends = {"top": "wall", "bottom": "wall", "top_load": 1.0, "gravity": 0.0}
    chain = {"grains": 1, "diameter": 1e-3} | ends
    constants = [[1e9, 1e9], [1e9, 4e9]]
    grid = {"chain.wall_constants": constants}
    found = sweep({"scene": SHORT | {"chain": chain}, "grid": grid}, tmp_path)
    made = Chain(**chain)
    for place, k in enumerate(constants):
        stiffness = 1.5 * np.power(k, 2 / 3).sum()  # The force is 1 N.
        exact = 1e-4 * np.cos(np.sqrt(stiffness / made.masses[0]) * found.time)
        assert found.velocity[place, :, 0].values == pytest.approx(exact, abs=1e-7)


def test_a_list_is_run_case_by_case(tmp_path):
    cases = {"chain.material": ["glass", "steel", "ptfe"], "chain.diameter": [1e-3, 2e-3, 3e-3]}
    found = sweep({"scene": SHORT, "list": cases}, tmp_path)
    assert found.velocity.dims == ("case", "time", "grain")
    assert found["chain.material"].values.tolist() == ["glass", "steel", "ptfe"]
    assert found["chain.diameter"].values.tolist() == [1e-3, 2e-3, 3e-3]
    chain = Chain(grains=12, material="steel", diameter=2e-3)
    alone = simulate(struck(chain, 1e-4, 2e-5, 11), "native")
    assert np.array_equal(found.velocity[1], alone.velocity)


def test_realisations_agree_with_the_disordered_chain(tmp_path):
    """The order m may be swept, and the first attempts may miss the tolerance."""
    strong = SHORT | {"excitation": {"kind": "impulse", "velocity": 0.02}}
    found = sweep(chains(12, scene=strong, grid={"disorder.m": [2, 30]}, tolerance=1e-8), tmp_path)
    assert found.velocity.dims == ("disorder.m", "realisation", "time", "grain")
    ordered = scene_of(column(12), Impulse(velocity=0.02), 2e-5, 11)
    for m in (2, 30):
        for index in (0, 11):
            alone = simulate(realisation(ordered, m, 1, index), "native", 1e-8)
            here = found.sel({"disorder.m": m, "realisation": index})
            assert np.array_equal(here.velocity, alone.velocity)
            assert here.solver_error == alone.error_estimate.solver


DRAWN: dict[str, dict[str, Any]] = {
    "chain.masses": {"mean": 1.3e-6, "deviation": 1e-7, "log": True},
    "chain.diameter": {"low": 0.9e-3, "high": 1.1e-3},
    "chain.contact_constants": {"low": 1e8, "high": 1e9, "log": True},
    "chain.material.density": {"mean": 2400.0, "deviation": 50.0},
    "chain.material.youngs_modulus": {"mean": 62e9, "deviation": 5e9, "log": True},
    "chain.material.poissons_ratio": {"low": 0.15, "high": 0.25},
}


@pytest.mark.parametrize(
    ("bottom", "keys"),
    thinned(
        product(["fixed", "wall"], [*([key] for key in DRAWN), list(DRAWN)[:2], list(DRAWN)[3:]]), 3
    ),
)
def test_numbers_of_every_grain_are_drawn(tmp_path, bottom, keys):
    """Each scene equals its scene file to the last bit; drawn numbers are a coordinate."""
    impurity = [{"grain": 4, "mass": 1e-6}]
    scene = SHORT | {"chain": SHORT["chain"] | {"bottom": bottom, "impurity": impurity}}
    table = {"seed": 4, "realisations": 5} | {key: DRAWN[key] for key in keys}
    found = sweep({"scene": scene, "disorder": table}, tmp_path)
    assert (found.reason == "").all()
    numbers = {key: found[key].values[3].tolist() for key in keys}
    tables = scene | {"chain": dict(scene["chain"])}
    glass = {"density": 2426.0, "youngs_modulus": 62e9, "poissons_ratio": 0.2}
    for key, values in numbers.items():
        name, _, own = key.removeprefix("chain.").partition(".")
        if own:
            before = tables["chain"][name]
            each = before if isinstance(before, list) else [glass] * 12
            values = [one | {own: value} for one, value in zip(each, values, strict=True)]
        tables["chain"][name] = values
    alone = simulate(Scene.from_dict(tables), "native")
    assert np.array_equal(found.velocity[3], alone.velocity)
    assert found.solver_error[3] == alone.error_estimate.solver


def test_a_packet_depends_on_each_chain():
    """The packet follows from the masses and stiffnesses of each chain, and so does its energy."""
    chain = column(60, gravity=0, top_load=1, top="wall", bottom="wall")
    packet = Packet(frequency=2e4, width=2, grain=30, amplitude=1e-9)
    scene = scene_of(chain, packet, 2e-5)
    plan = read_sweep({"scene": scene, "disorder": {"m": 20, "seed": 1, "realisations": 3}})
    made = scenes(plan, 0, 3, together=True)
    assert [each.energy for each in made] == [plan.scene((number,)).energy for number in range(3)]


def test_draws_without_a_valid_scene_are_recorded(tmp_path):
    table = {"seed": 4, "realisations": 30, "chain.masses": {"mean": 1e-6, "deviation": 6e-7}}
    found = sweep({"scene": SHORT, "disorder": table}, tmp_path)
    lost = found["chain.masses"].isnull().any("chain.masses.entry").values
    assert 0 < lost.sum() < 30
    assert all("masses: must be above 0" in reason for reason in found.reason.values[lost])
    assert (found.reason.values[~lost] == "").all()


def test_arrays_are_coordinates(tmp_path):
    masses = [[1e-6] * 12, [1e-7] * 6 + [2e-7] * 6]
    found = sweep({"scene": SHORT, "grid": {"chain.masses": masses}}, tmp_path)
    assert found["chain.masses"].dims == ("chain.masses", "chain.masses.entry")
    assert found["chain.masses"].values.tolist() == masses


def test_material_and_impurity_keys(tmp_path):
    """Constants of a named material, and the keys of an impurity, can be swept."""
    odd: list[dict[str, Any]] = [{"grain": 3, "mass": 1e-6}, {"grain": 5, "mass": 1e-6}]
    scene = SHORT | {"chain": SHORT["chain"] | {"impurity": odd}}
    swept = {
        "material": {"youngs_modulus": [5e10, 6e10]},
        "impurity": {"1": {"diameter": [1e-3, 2e-3]}},
    }
    found = sweep({"scene": scene, "grid": {"chain": swept}}, tmp_path)
    material = {"density": 2426.0, "youngs_modulus": 6e10, "poissons_ratio": 0.2}
    odd[1] = odd[1] | {"diameter": 2e-3}
    chain = column(12, material=material, impurity=odd)
    alone = simulate(struck(chain, 1e-4, 2e-5, 11), "native")
    assert np.array_equal(found.velocity[1, 1], alone.velocity)


@pytest.mark.parametrize("entry", ["2", "\N{SUPERSCRIPT ONE}", "1" * 5000])
def test_missing_entries(entry: str, tmp_path):
    """Python refuses to read numbers of 5000 digits."""
    scene = SHORT | {"chain": SHORT["chain"] | {"impurity": [{"grain": 3, "mass": 1e-6}]}}
    with pytest.raises(InputError, match=r"there is no entry .*: the scene has entries 0 to 0"):
        sweep({"scene": scene, "grid": {f"chain.impurity.{entry}.mass": [1e-6]}}, tmp_path)


def test_a_swept_key_may_be_missing_from_the_scene(tmp_path):
    scene = SHORT | {"excitation": {"kind": "impulse"}}
    found = sweep({"scene": scene, "grid": {"excitation.velocity": [1e-5, 1e-4]}}, tmp_path)
    assert found.velocity[:, 0, 0].values.tolist() == [1e-5, 1e-4]


def test_files_are_identified_by_their_contents(tmp_path):
    """A scene file and its CSV file are found beside the sweep file."""
    (tmp_path / "grains.csv").write_text("diameter\n" + "1e-3\n" * 8)
    scene = SHORT | {"chain": {"file": "grains.csv"}, "excitation": {"kind": "impulse"}}
    (tmp_path / "scene.toml").write_text(tomli_w.dumps(scene))
    begin = 'scene = "scene.toml"\n[grid]\n'
    (tmp_path / "sweep.toml").write_text(f"{begin}excitation.velocity = [1e-4, 2e-4]\n")
    assert command_line(tmp_path / "sweep.toml", tmp_path / "out") == 0
    before = load_sweep(tmp_path / "out").displacement.load()
    (tmp_path / "grains.csv").write_text("diameter\n" + "2e-3\n" * 8)
    after = sweep(tmp_path / "sweep.toml", tmp_path / "out").displacement
    assert len(list((tmp_path / "out").glob("*/results.zarr"))) == 2
    assert (before[:, -1, 1] != after[:, -1, 1]).all()
    (tmp_path / "sweep.toml").write_text(f'{begin}chain.file = ["more.csv", "none.csv"]\n')
    (tmp_path / "more.csv").write_text("diameter\n1e-3\n")
    found = read_sweep(tmp_path / "sweep.toml").source["files"]
    assert found.pop("none.csv") == ""
    for name in ("grains.csv", "more.csv"):
        content = (tmp_path / name).read_bytes()
        assert found.pop(name) == hashlib.sha256(content).hexdigest()
    assert not found


def test_traces_of_instruments_are_swept(tmp_path):
    """The calibration of a trace is swept like any key; a start file is known by its contents."""
    (tmp_path / "scope.csv").write_text("t (us);u (mV)\n-1;10\n0;10\n5;11,5\n20;13\n")
    (tmp_path / "start.csv").write_text("velocity\n" + "0\n" * 12)
    options = {"scale": 1e-6, "offset": 0.01, "trigger": 0.0, "start": {"file": "start.csv"}}
    excitation = {"kind": "drive", "file": "scope.csv"} | options
    scene = tomli_w.dumps(SHORT | {"excitation": excitation})
    (tmp_path / "scene.toml").write_text(scene, encoding="utf-8")
    grid = 'scene = "scene.toml"\n[grid]\nexcitation.scale = [1e-6, 2e-6]\n'
    (tmp_path / "sweep.toml").write_text(grid)
    found = sweep(tmp_path / "sweep.toml", tmp_path / "out")
    top = found.displacement.sel(grain=1).values
    np.testing.assert_allclose(top[:, -1], [3e-9, 6e-9], rtol=1e-12)
    (tmp_path / "start.csv").write_text("velocity\n0\n1e-4\n" + "0\n" * 10)
    after = sweep(tmp_path / "sweep.toml", tmp_path / "out")
    assert (after.velocity.sel(grain=2)[:, 0] == 1e-4).all()


def test_scenes_with_different_recordings(tmp_path):
    """Times become a coordinate, grains a union; unrecorded values are NaN."""
    cases = {
        "recording.duration": [1e-5, 2e-5],
        "recording.samples": [3, 5],
        "recording.grains": [[7, 2], "2:4"],
    }
    found = sweep({"scene": SHORT, "list": cases}, tmp_path)
    assert found.velocity.dims == ("case", "sample", "grain")
    assert found.grain.values.tolist() == [2, 3, 4, 7]
    assert np.array_equal(found.time[0], [0, 5e-6, 1e-5, np.nan, np.nan], equal_nan=True)
    chain = column(12)
    alone = simulate(struck(chain, 1e-4, 1e-5, 3), "native")
    assert np.array_equal(found.velocity[0, :3, [0, 3]], alone.velocity[:, [1, 6]])
    assert np.isnan(found.velocity[0, 3:]).all()
    assert np.isnan(found.velocity[0, :, [1, 2]]).all()
    assert np.isnan(found.velocity[1, :, 3]).all()
    assert np.isfinite(found.velocity[1, :, :3]).all()


def test_the_grains_of_a_file_count_if_its_first_scene_is_invalid(tmp_path):
    """Soft grains do not allow the first strike, but the next scenes need places for all grains."""
    for count in (3, 8):
        (tmp_path / f"{count}.csv").write_text("diameter\n" + "1e-3\n" * count)
    files = [str(tmp_path / f"{count}.csv") for count in (3, 8)]
    grid = {"excitation.velocity": [100.0, 1e-4], "chain.material": ["ptfe", "steel"]}
    grid = {"chain.file": files} | grid
    asked = {"scene": SHORT | {"chain": {}}, "grid": grid, "tolerance": 1e-3, "keep": ["velocity"]}
    with pytest.warns(UserWarning, match="Hertz's law"):
        found = sweep(asked, tmp_path / "out")
    assert found.grain.values.tolist() == list(range(1, 9))
    for row, count in enumerate((3, 8)):
        here = found.isel({"chain.file": row})
        invalid, *others = here.reason.values.flat
        assert "squeezes contact" in invalid
        assert others == ["", "", ""]
        stored = np.isfinite(here.velocity).all("time").sum("grain")
        assert stored.values.tolist() == [[0, count], [count, count]]


def test_results_of_other_grains_are_not_reused(tmp_path):
    """Both sweeps have the same scene and arrays of the same shape, but of other grains."""
    asked = {"scene": SHORT, "keep": ["velocity"]}
    grids = ({"recording.grains": [[2, 3], other]} for other in ([4, 5], [1, 6]))
    first, second = (sweep(asked | {"grid": grid}, tmp_path).velocity.load() for grid in grids)
    assert second.grain.values.tolist() == [1, 2, 3, 6]
    assert np.array_equal(second[0].sel(grain=[2, 3]), first[0].sel(grain=[2, 3]))
    assert np.isnan(second[0].sel(grain=[1, 6])).all()


def test_a_common_order_of_grains_is_preserved(tmp_path):
    scene = SHORT | {"recording": SHORT["recording"] | {"grains": [7, 2]}}
    found = sweep({"scene": scene, "grid": {"chain.gravity": [5.0]}}, tmp_path)
    assert found.grain.values.tolist() == [7, 2]
    assert np.abs(found.velocity[0, -1, 1]) > np.abs(found.velocity[0, -1, 0]) > 0


def test_the_example(tmp_path, capsys):
    """A weak wave in a Hertzian column has one time scale, which is g^(-1/6) for any disorder."""
    assert command_line(SCENES.parent / "sweep.toml", tmp_path) == 0
    assert "90 of 90" in capsys.readouterr().out
    arrival = load_sweep(tmp_path).arrival_time.sel(grain=5).transpose("chain.gravity", ...).values
    gravity = np.array(GRAVITIES)[:, None, None]
    assert np.isfinite(arrival).all()
    expected = np.tile(arrival[0] * 1.62 ** (1 / 6), (3, 1, 1))
    assert arrival * gravity ** (1 / 6) == pytest.approx(expected, rel=5e-3)


def test_arrays_are_read_on_use(tmp_path):
    """Only the required entries of the required files are read."""
    found = sweep({"scene": SHORT, "grid": {"chain.gravity": GRAVITIES}}, tmp_path)
    whole = load_sweep(tmp_path).velocity.load()
    for row, part in enumerate(
        [(slice(1, 5), [2, 2, 0]), (-1, slice(None, None, -3)), ([3, 1], 4)]
    ):
        assert np.array_equal(found.velocity[row][part], whole[row][part])
    (one,) = tmp_path.glob("*/results.zarr/velocity/c/0/0/0")
    one.write_bytes(bytes(one.stat().st_size))
    assert np.isfinite(load_sweep(tmp_path).displacement).all()


@pytest.mark.parametrize(
    ("engine", "workers"), [pytest.param("lammps", 2, marks=pytest.mark.slow), ("chebyshev", 1)]
)
def test_other_engines(tmp_path, engine, workers):
    asked = {"scene": SHORT, "engine": engine, "grid": {"chain.gravity": GRAVITIES}}
    found = sweep(asked, tmp_path, workers=workers)
    chain = column(12, gravity=24.8)
    scene = struck(chain, 1e-4, 2e-5, 11)
    with pytest.warns() if engine == "chebyshev" else contextmanager(lambda: (yield))():
        alone = simulate(scene, engine)
    assert np.array_equal(found.velocity[2], alone.velocity)
    assert found.model_error[2] == alone.error_estimate.model


# --- faults


ONE = {"chain.gravity": [1.0]}
TWO = {"draws": 2, "seed": 1}
ORDER = {"m": 2, "seed": 1, "realisations": 1000}
BOTH = {"realisations": 2, "seed": 1}
CONTACTS = SHORT | {"chain": SHORT["chain"] | {"contact_constants": [1e9] * 11}}
INVALID: list[tuple[dict[str, Any], str]] = [  # Tables, and the keys of their faults.
    ({}, "grid"),
    ({"scene": 5, "grid": ONE}, "scene"),
    ({"scene": "nowhere.toml", "grid": ONE}, "nowhere.toml"),
    ({"scene": {"chains": {}}, "grid": ONE}, "scene.chains"),
    (
        {"engine": "nativ", "tolerance": 2, "keep": ["speed"], "colour": 1, "grid": {"x": 1.0}},
        "engine tolerance keep colour grid.x",
    ),
    ({"engine": ["native"], "keep": "velocity", "grid": []}, "engine keep grid"),
    ({"keep": [], "grid": ONE}, "keep"),
    (
        {"grid": {"chain.gravty": [1.0], "chain.gravity": [1.0, -1.0, "g"]}},
        "chain.gravty chain.gravity",
    ),
    (
        {"grid": {"chain": {"gravity": [1.0, -2.0], "exponent": [1.5, 7.0]}}},
        "chain.gravity chain.exponent",
    ),
    ({"grid": {"gravity": [1.0]}, "list": {"chain.gravity": []}}, "gravity list.chain.gravity"),
    ({"grid": {"chain.impurity.0.mass": [1e-6]}}, "chain.impurity"),
    ({"grid": {"chain.gravity.x": [1.0]}}, "chain.gravity"),
    ({"grid": {"chain.grains.x": [1]}}, "chain.grains.x"),
    ({"scene": CONTACTS, "disorder": ORDER | {"of": "diameter"}}, "disorder.contact_constants"),
    ({"list": {"chain.gravity": [1.0, 2.0], "chain.grains": [5]}}, "list.chain.grains"),
    ({"grid": ONE, "list": {"chain.gravity": [2.0]}}, "chain.gravity"),
    (
        {"grid": {"chain.material": ["glass"], "chain.material.density": [2e3]}},
        "chain.material.density",
    ),
    ({"grid": {"disorder.m": [5.0]}}, "disorder.m"),
    (
        {"random": {"draws": 0, "chain.gravity": 9.81, "chain.top_load": {"low": 1.0}}},
        "random.draws random.seed random.chain.top_load.high random.chain.gravity",
    ),
    (
        {"random": TWO | {"chain": {"gravity": {"low": 0.0, "high": 9.0, "log": True}}}},
        "random.chain.gravity.low",
    ),
    ({"random": TWO | {"chain.gravity": {"low": -2.0, "high": -1.0}}}, "chain.gravity"),
    ({"random": TWO | {"chain.gravity": {"low": 2.0, "high": 1.0}}}, "random.chain.gravity.high"),
    ({"disorder": {"m": 2, "seed": 1}}, "disorder.realisations"),
    (
        {"disorder": BOTH | {"chain.masses": {"low": 1.0}, "chain.diameter": {"mean": 1.0}}},
        "disorder.chain.masses.high disorder.chain.diameter.deviation",
    ),
    (
        {"disorder": {"realisations": 2, "chain.masses": {"low": 1e-6, "high": 2e-6}}},
        "disorder.seed",
    ),
    ({"disorder": BOTH | {"chain.gravity": {"low": 1, "high": 2}}}, "disorder.chain.gravity"),
    (
        {"disorder": {"m": -2, "realisations": 3, "laws": "dyson"}},
        "disorder.m disorder.seed disorder.laws",
    ),
    ({"engine": "bessel", "disorder": ORDER}, "contact_constants"),
    ({"grid": {"chain.gravity": [1.0] * 1001}, "disorder": ORDER}, "grid"),
]


@pytest.mark.parametrize(("wrong", "keys"), INVALID)
def test_invalid_sweeps_are_rejected_before_the_run(
    tmp_path: Path, wrong: dict[str, Any], keys: str
) -> None:
    """All faults are reported at once, each under its key."""
    told = fault_keys(sweep, {"scene": SHORT} | wrong, tmp_path / "out")
    assert set(told) == set(keys.split())
    assert not (tmp_path / "out").exists()


def test_a_faulty_sweep_file_gives_a_line_per_fault(tmp_path, capfd, monkeypatch):
    # No scheduler listens there.
    monkeypatch.setattr(run, "TASKS", run.TASKS._replace(scheduler_s=0.2))
    path = tmp_path / "sweep.toml"
    path.write_text("[grid\n")
    assert command_line(path, tmp_path / "out") == 2
    path.write_text(
        f'scene = "{SCENES / "weak.toml"}"\n[grid]\nchain.gravity = [1, -1]\nchain.top = ["open"]\n'
    )
    assert command_line(path, tmp_path / "out", "--workers", "0") == 2
    assert command_line(path, tmp_path / "out") == 2
    told = capfd.readouterr().err.splitlines()
    assert [line.split(":")[0] for line in told] == ["error"] * 4
    assert {line.split(":")[1].strip() for line in told[-2:]} == {"chain.gravity", "chain.top"}
    path.write_text(f'scene = "{SCENES / "weak.toml"}"\n[grid]\nchain.gravity = [1]\n')
    assert command_line(path, tmp_path / "out", "--scheduler", "tcp://127.0.0.1:1") == 2
    assert "scheduler" in capfd.readouterr().err
    (tmp_path / "file").touch()
    assert command_line(path, tmp_path / "file") == 2


def test_failing_scenes_are_recorded_and_the_others_are_solved(tmp_path, capfd):
    """Only hard grains allow the strike, and the duration is beyond predictability."""
    path = tmp_path / "sweep.toml"
    path.write_text(
        """
        tolerance = 1e-13
        [scene.chain]
        grains = 12
        diameter = 1e-3
        [scene.excitation]
        kind = "impulse"
        [scene.recording]
        samples = 3
        [grid]
        chain.material = ["steel", "ptfe"]
        excitation.velocity = [1e-6, 100.0]
        recording.duration = [1e-6, 1.0]
        """
    )
    assert command_line(path, tmp_path / "out") == 1
    out, err = capfd.readouterr()
    assert "of 8 scenes" in out
    # The hard strike gives a warning, the failed scenes an error.
    assert [line.partition(":")[0] for line in err.splitlines()] == ["warning", "error"]
    found = load_sweep(tmp_path / "out")
    reasons = found.reason.values
    assert "squeezes contact" in reasons[1, 1, 0]
    assert "round-off" in reasons[0, 0, 1]
    assert reasons[:, 0, 0].tolist() == ["", ""]
    assert reasons[0, 1, 0] == ""
    lost = found.isel({"chain.material": 1, "excitation.velocity": 1})
    assert np.isnan(lost.velocity).all()
    assert np.isnan(lost.solver_error).all()
    assert np.isfinite(found.velocity.where(found.reason == "", 0.0)).all()
    before = contents(tmp_path / "out")
    # A second call repeats the warning without running anything.
    assert command_line(path, tmp_path / "out") == 1
    assert contents(tmp_path / "out") == before


def test_an_invalid_file_name():
    scene = SHORT | {"excitation": {"kind": "profile", "file": ["a.csv"]}}
    with pytest.raises(InputError, match=r"^excitation\.file: must be the name of a CSV file"):
        list(read_sweep({"scene": scene, "grid": ONE}).trials())


@pytest.mark.parametrize("name", [None, 5, b"x", "a" * 300, "a\0b"])
def test_invalid_names_of_files_and_folders(name: Any, tmp_path):
    with pytest.raises(InputError, match=r"^folder: "):
        load_sweep(name)
    with pytest.raises(InputError, match=r"^source: "):
        sweep(name, tmp_path)


def test_folders_without_a_sweep(tmp_path):
    with pytest.raises(InputError, match="contains no sweep"):
        load_sweep(tmp_path)
    sweep(chains(2), tmp_path)
    one = next(tmp_path.glob("*/results.zarr/velocity/c/0/0/0"))
    one.write_bytes(bytes(one.stat().st_size))
    with pytest.raises(InputError, match="velocity: is damaged"):
        load_sweep(tmp_path).velocity.load()
    options = next(tmp_path.glob("*/sweep.json"))
    for text, fault in (("[1]", "cannot be read"), ("{", "cannot be read"), ("{}", "is missing")):
        options.write_text(text)
        with pytest.raises(InputError, match=rf"^{options}: {fault}.*remove its folder"):
            load_sweep(tmp_path)
    options.unlink()
    with pytest.raises(InputError, match=rf"^{options}: is missing"):
        load_sweep(tmp_path)
    (tmp_path / "sweep.json").write_text("[1")
    with pytest.raises(InputError, match=r"sweep\.json"):
        load_sweep(tmp_path)


# --- persistence


def test_the_rest_of_a_batch_has_the_same_bits(tmp_path):
    """The error estimate depends on the other scenes if steps are barely stable."""
    scene = {
        "chain": {"grains": 60, "diameter": 1e-3},
        "excitation": {"kind": "impulse", "velocity": 0.0857},
        "recording": {"duration": 1e-4, "samples": 101},
    }
    asked = {"scene": scene, "tolerance": 1e-2, "disorder": {"m": 5, "seed": 1, "realisations": 40}}
    sweep(asked | {"disorder": asked["disorder"] | {"realisations": 30}}, tmp_path)
    found = sweep(asked, tmp_path)
    assert (found.reason == "").all()
    anew = sweep(asked, tmp_path / "new")
    assert found.velocity[30:].equals(anew.velocity[30:])
    assert found.solver_error[30:].equals(anew.solver_error[30:])


def test_any_executor_with_the_interface_of_concurrent_futures(tmp_path):
    sweep(chains(5), tmp_path / "serial")
    with ThreadPoolExecutor(2) as threads:
        sweep(chains(5), tmp_path / "threads", executor=threads)
        assert threads.submit(int).result() == 0  # The executor was not shut down.
    assert contents(tmp_path / "threads") == contents(tmp_path / "serial")


@pytest.mark.slow
def test_a_dying_process_loses_only_its_own_task():
    """One process solves all tasks; after it has died, another one solves the next tasks."""
    with Processes(1) as processes:
        first = processes.submit(os.getpid).result()
        dying = processes.submit(os._exit, 3)
        other = processes.submit(os.getpid)
        power = processes.submit(pow, 3, exp=4)
        with pytest.raises(BrokenExecutor):
            dying.result()
        assert other.result() not in (first, os.getpid())
        assert power.result() == 81
        children = psutil.Process().children()
        assert other.result() in [child.pid for child in children]
    with pytest.raises(RuntimeError):
        processes.submit(os.getpid)
    assert not psutil.pid_exists(other.result())


@pytest.mark.slow
@pytest.mark.parametrize("how", ["shutdown", "kill"])
def test_processes_end_within_a_task(how):
    """Worker processes end with their pool, and with the process of the pool, however it ends."""
    script = (
        "import os, sys, time\n"
        "from lmpchain.sweeps.run import Processes\n"
        "pool = Processes(1)\n"
        "print(pool.submit(os.getpid).result(), flush=True)\n"
        "pool.submit(time.sleep, 600)\n"
        "sys.stdin.readline()\n"
        "pool.shutdown(cancel_futures=True)\n"
    )
    line = [sys.executable, "-c", script]
    with subprocess.Popen(
        line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin
        assert process.stdout
        worker = psutil.Process(int(process.stdout.readline()))
        try:
            if how == "kill":
                process.kill()
            else:
                process.stdin.write("\n")
                process.stdin.flush()
            until(lambda: not worker.is_running())
            assert process.wait(PATIENCE) == (-signal.SIGKILL if how == "kill" else 0)
        finally:
            process.kill()


def children(parent: int) -> list[psutil.Process]:
    """Return the worker processes of a sweep."""
    found = []
    with suppress(psutil.Error):  # The process has just ended.
        for child in psutil.Process(parent).children(recursive=True):
            if "spawn_main" in " ".join(child.cmdline()):
                found.append(child)
    return found


@contextmanager
def command(*arguments: Any, **options: Any) -> Iterator[subprocess.Popen]:
    """Run `lmpchain sweep`, and end all of its processes afterwards."""
    line = [sys.executable, "-m", "lmpchain.cli", "sweep", *map(str, arguments)]
    process = subprocess.Popen(
        line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


SCENES_OF_A_SWEEP = 200  # Enough scenes for an interruption in between.


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    """Return a sweep for interruptions, and its results without interruptions."""
    folder = tmp_path_factory.mktemp("serial")
    path = long_sweep(folder, SCENES_OF_A_SWEEP)
    sweep(path, folder / "out")
    return path, contents(folder / "out")


ALL_DONE = f"{SCENES_OF_A_SWEEP} of {SCENES_OF_A_SWEEP}"


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(tmp_path, serial):
    path, expected = serial
    with command(path, "-o", tmp_path, "--workers", 2) as process:
        until(lambda: begun(tmp_path))
        random.choice(children(process.pid)).kill()
        out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, err) == (0, "")
    assert ALL_DONE in out
    assert contents(tmp_path) == expected


@pytest.mark.parametrize(
    "how",
    [
        pytest.param(signal.SIGINT, marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, marks=pytest.mark.soak),
        pytest.param(signal.SIGKILL, marks=pytest.mark.slow),
    ],
)
def test_a_stopped_sweep_continues(tmp_path, serial, how):
    """Ctrl-C reaches all processes of a terminal; finished scenes remain, but no process."""
    path, expected = serial
    with command(path, "-o", tmp_path, "--workers", 2, start_new_session=True) as process:
        until(lambda: begun(tmp_path))
        workers = children(process.pid)
        os.killpg(process.pid, how) if how == signal.SIGINT else process.send_signal(how)
        _, err = process.communicate(timeout=PATIENCE)
    until(lambda: not any(worker.is_running() for worker in workers))
    if how != signal.SIGKILL:
        assert process.returncode == 128 + how
        assert str(tmp_path) in err.splitlines()[0]
        assert "Traceback" not in err
    assert 0 < done(tmp_path) < SCENES_OF_A_SWEEP
    assert command_line(path, tmp_path) == 0
    assert contents(tmp_path) == expected


def test_one_sweep_at_a_time_in_a_folder(tmp_path):
    with FileLock(tmp_path / ".lock"), pytest.raises(InputError, match="another process"):
        sweep(chains(2), tmp_path)
    assert (sweep(chains(2), tmp_path).reason == "").all()


def test_unfinished_files_of_a_killed_worker_are_removed(tmp_path):
    class Deadly(Here):
        def submit(self, function, /, *values, **named):
            for task in values:
                if isinstance(task, tasks.SweepTask):
                    (task.folder / "parts" / f".{task.first:07d}.12345678.partial").touch()
            return super().submit(function, *values, **named)

    for folder, executor in ((tmp_path / "alone", Here()), (tmp_path / "killed", Deadly())):
        sweep(chains(2), folder, executor=executor)
    assert contents(tmp_path / "killed") == contents(tmp_path / "alone")


@pytest.mark.slow
def test_a_full_disk(tmp_path, serial):
    """No file may exceed 16 kB, so that arrays do not fit.

    Nothing is half written, and later all is done.
    """
    path, expected = serial
    words = f"{sys.executable} -m lmpchain.cli sweep {path} -o {tmp_path} --workers 1"
    line = f"ulimit -f 16; exec {words}"
    ended = subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=PATIENCE)
    assert ended.returncode == 1
    assert "could not be solved this time" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert not list(tmp_path.glob("*/parts/*"))
    assert command_line(path, tmp_path) == 0
    assert contents(tmp_path) == expected


@contextmanager
def cluster(
    folder: Path, workers: int = 2
) -> Iterator[tuple[str, list[psutil.Process], subprocess.Popen]]:
    """Start a Dask scheduler and workers; yield the address, the workers and the scheduler."""
    tool = str(Path(sys.executable).with_name("dask"))
    quiet: dict[str, Any] = dict.fromkeys(("stdout", "stderr"), subprocess.DEVNULL)
    quiet["cwd"] = folder
    file = folder / "scheduler.json"
    where = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", file]
    started = [subprocess.Popen([tool, "scheduler", *map(str, where)], **quiet)]
    try:
        until(lambda: file.exists() and file.read_text().endswith("}"))
        address = json.loads(file.read_text())["address"]
        asked = ["--nworkers", workers, "--nthreads", 1, "--no-dashboard"]
        asked += ["--local-directory", folder]
        started.append(subprocess.Popen([tool, "worker", address, *map(str, asked)], **quiet))
        until(lambda: len(children(started[1].pid)) == workers)
        yield address, children(started[1].pid), started[0]
    finally:
        every = [
            process
            for each in started
            for process in psutil.Process(each.pid).children(recursive=True)
        ]
        for each in reversed(started):
            each.terminate()
            each.wait(PATIENCE)
        for process in every:
            if process.is_running():
                process.kill()


# --- soak


@pytest.mark.soak
def test_dask_with_a_killed_worker(tmp_path, serial):
    path, expected = serial
    with (
        cluster(tmp_path) as (address, workers, _),
        command(path, "-o", tmp_path / "out", "--scheduler", address) as process,
    ):
        until(lambda: begun(tmp_path / "out"))
        random.choice(workers).kill()
        out, _ = process.communicate(timeout=PATIENCE)
    assert (process.returncode, ALL_DONE in out) == (0, True)
    assert contents(tmp_path / "out") == expected


@pytest.mark.soak
def test_a_scheduler_that_dies_ends_the_sweep(tmp_path):
    path = long_sweep(tmp_path, SCENES_OF_A_SWEEP)
    folder = tmp_path / "out"
    with (
        cluster(tmp_path) as (address, _, scheduler),
        command(path, "-o", folder, "--scheduler", address) as process,
    ):
        until(lambda: begun(folder))
        scheduler.kill()
        _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert said.startswith("error: the connection to the Dask scheduler is lost")
    assert said.count("\n") == 1  # No messages of Dask.
    assert done(folder)  # Computed results are preserved.
    assert command_line(path, folder) == 0


@pytest.mark.soak
def test_many_scenes_soak(tmp_path):
    """10^4 scenes: neither memory nor open files grow, here or in the workers."""
    path = tmp_path / "sweep.toml"
    path.write_text(
        f'scene = "{SCENES / "weak.toml"}"\nkeep = ["peak_velocity"]\n'
        "[disorder]\nm = 20\nseed = 1\nrealisations = 10000\n"
    )
    seen: list[tuple[int, list[tuple[int, int]]]] = []
    with command(path, "-o", tmp_path / "out", "--workers", 2) as process:
        while process.poll() is None:
            count = done(tmp_path / "out")
            if count > 1000:
                with suppress(psutil.Error):  # The process is ending.
                    all_three = [psutil.Process(process.pid), *children(process.pid)]
                    seen.append(
                        (count, [(each.memory_info().rss, each.num_fds()) for each in all_three])
                    )
            time.sleep(0.05)
        assert "10000 of 10000" in process.communicate()[0]
    early = [each for count, each in seen if count < 9900 and len(each) == 3]
    memory, files = np.array(early).T  # Shape (3, T).
    part = memory.shape[1] // 3
    # Memory varies with the batches.
    assert (memory[:, -part:].min(1) - memory[:, :part].min(1) < 8e6).all()
    assert (files[:, -part:].min(1) <= files[:, :part].min(1)).all()
    assert np.isfinite(load_sweep(tmp_path / "out").peak_velocity).all()
