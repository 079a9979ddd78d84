"""Paths that begin with ~."""

from pathlib import Path

import pytest

from lmpchain import Chain, Impulse, Scene, Trajectory, load_sweep, resume, simulate, sweep
from lmpchain.cli.command_line import main
from lmpchain.design import Traces
from lmpchain.util.files import expanded

SCENE = Scene(
    chain=Chain(grains=3, diameter=1e-3), excitation=Impulse(velocity=1e-4), duration=1e-6
)


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the home folder, and change to another folder."""
    home = tmp_path / "home"
    work = tmp_path / "work"
    home.mkdir()
    work.mkdir()
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(work)
    return home


def test_scenes_and_results_are_stored_at_home(home: Path):
    SCENE.to_toml("~/scene.toml")
    assert Scene.from_toml("~/scene.toml") == SCENE
    answer = simulate(SCENE)
    answer.save("~/run.nc")
    assert Trajectory.load("~/run.nc").scene == SCENE
    simulate(SCENE, folder="~/run")
    assert resume("~/run").scene == SCENE
    sweep({"scene": "~/scene.toml", "grid": {"chain.gravity": [1.0, 9.81]}}, "~/sweep")
    assert load_sweep("~/sweep").sizes["chain.gravity"] == 2
    assert {path.name for path in home.iterdir()} == {"scene.toml", "run.nc", "run", "sweep"}
    assert not list(Path().iterdir())


def test_tables_and_traces_are_read_at_home(home: Path):
    table = "time,force\n0,0\n1e-6,1\n2e-6,0\n"
    (home / "hammer.csv").write_text(table)
    tables = SCENE.to_dict() | {"excitation": {"kind": "force", "file": "~/hammer.csv"}}
    assert Scene.from_dict(tables).excitation.force.tolist() == [0, 1, 0]
    assert Traces.from_csv("~/hammer.csv", [1]).values.shape == (3, 1)


def test_commands_find_the_home_folder(home: Path, capsys: pytest.CaptureFixture[str]):
    SCENE.to_toml(home / "scene.toml")
    # A shell does not expand ~ in --output=~/run.nc.
    assert main(["run", "~/scene.toml", "--output=~/run.nc"]) == 0
    assert main(["run", "~/scene.toml", "--output=~/run/"]) == 0
    assert {path.name for path in home.iterdir()} == {"scene.toml", "run.nc", "run"}
    assert capsys.readouterr().err == ""


def test_a_name_may_begin_with_the_sign(home: Path):
    assert expanded("~") == home
    assert expanded("~nobody-of-this-name/run") == Path("~nobody-of-this-name/run")
    assert expanded("run~/a") == Path("run~/a")
