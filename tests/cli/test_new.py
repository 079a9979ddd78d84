"""The command `new`: example scenes that agree with their comments."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lmpchain
from lmpchain import Scene, simulate
from lmpchain.cli.command_line import main
from lmpchain.cli.new import EXAMPLES
from lmpchain.scene.lammps_column import RunOptions

README = Path(__file__).parents[2] / "README.md"
each_example = pytest.mark.parametrize("example", EXAMPLES)


def made(folder: Path, example: str) -> Path:
    path = folder / f"{example}.toml"
    assert main(["new", str(path), "--example", example]) == 0
    return path


@each_example
def test_an_example_is_a_scene_that_moves(example: str, tmp_path: Path):
    """The wave travels down to the lower half of the grains within the recording."""
    scene = Scene.from_toml(made(tmp_path, example))
    run = simulate(scene, "native", 1e-6)
    largest = np.abs(run.velocity).max(0)
    assert largest[scene.chain.grains // 3] > 0.02 * largest.max()
    assert run.error_estimate.total < 1e-6


def test_examples_agree_with_their_descriptions(tmp_path: Path):
    scenes = {example: Scene.from_toml(made(tmp_path, example)) for example in EXAMPLES}
    column = scenes["column"].chain
    assert (column.material, column.gravity, column.bottom) == (lmpchain.GLASS, 9.81, "fixed")
    names = [material.name for material in scenes["dimer"].chain.material]
    assert names == ["steel", "aluminium"] * 40
    driven = scenes["driven"]
    assert round(driven.chain.band_edge / (2e3 * np.pi)) == 19
    assert driven.excitation.frequency < 19e3
    assert np.unique(scenes["disorder"].chain.diameters).size > 70
    assert np.abs(scenes["disorder"].chain.diameters / 5e-3 - 1).max() <= 0.05
    struck = scenes["striker"].chain
    assert struck.by_grain("density").tolist() == [2200.0] + [8000.0] * 60
    # The striker touches the row, which is compressed.
    assert struck.equilibrium_force == pytest.approx([0.0] + [2.38] * 59, rel=1e-12)


def test_examples_with_a_file_of_an_instrument(tmp_path: Path, monkeypatch, capsys):
    """Forces and motions equal those in the files beside the scenes."""
    path = made(tmp_path, "hammer")
    assert f"data: {tmp_path / 'hammer.csv'}" in capsys.readouterr().out
    push = Scene.from_toml(path).excitation
    # A half-sine of 1.5 V in 40 us, with 100 N/V.
    inside = push.times <= 40e-6
    exact = 150.0 * np.sin(np.pi * push.times[inside] / 40e-6)
    assert push.force[inside] == pytest.approx(exact, abs=2e-2)
    plate = Scene.from_toml(made(tmp_path, "vibrometer"))
    assert plate.excitation.grain == 0
    assert plate.chain.material == lmpchain.PTFE
    assert np.abs(plate.excitation.displacement).max() == pytest.approx(3.745e-7, rel=1e-4)
    # No file is replaced without --force, and data cannot go to standard output.
    (tmp_path / "other.csv").write_text("mine")
    assert main(["new", str(tmp_path / "other.toml"), "--example", "hammer"]) == 2
    assert "other.csv: already exists" in capsys.readouterr().err
    assert not (tmp_path / "other.toml").exists()
    assert main(["new", "-", "--example", "hammer"]) == 2
    assert "name a file" in capsys.readouterr().err
    # Any file name is allowed in the scene.
    odd = tmp_path / 'a "b" \\ é.toml'
    assert main(["new", str(odd), "--example", "hammer"]) == 0
    assert Scene.from_toml(odd) == Scene.from_toml(path)


def test_comments_name_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "my balls.toml"]) == 0
    text = Path("my balls.toml").read_text(encoding="utf-8")
    assert "lmpchain compare 'my balls.toml' -o 'my balls'.png\n" in text
    assert "lmpchain fit 'my balls'.nc" in text
    said = capsys.readouterr().out
    assert said.startswith("scene: my balls.toml (glass beads under gravity")
    assert said.splitlines()[1:3] == [
        "next: lmpchain compare 'my balls.toml' -o 'my balls.png'",
        "      lmpchain run 'my balls.toml'",
    ]
    others = [name for name in EXAMPLES if name != "column"]
    assert " ".join(said.split()).endswith(f"other examples: {', '.join(others)}")


@pytest.mark.parametrize(
    ("files", "options", "units", "following"),
    [
        (["in.own"], [], None, ["next: lmpchain run '{}'"]),
        (
            ["in.own", "own dump"],
            ["--young", "1e9", "--samples", "7", "--grain-diameter", "2e-3"],
            "real",
            [
                "next: lmpchain check 'own dump' --scene '{}' --units real",
                "      lmpchain run '{}'",
            ],
        ),
        (
            ["own dump"],
            ["--units", "si"],
            "si",
            ["next: lmpchain check 'own dump' --scene '{}'", "      lmpchain run '{}'"],
        ),
    ],
)
def test_a_scene_of_a_run_is_written_with_the_next_commands(
    files: list[str],
    options: list[str],
    units: str | None,
    following: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    Path("own dump").write_text("ITEM: TIMESTEP\n0\n")
    Path("in.own").write_text("units real\n")
    chain = lmpchain.Chain(grains=3, diameter=1e-3)
    scene = Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1e-3), duration=1e-6)
    asked: list[Any] = []
    facts = [("column", "3 grains"), ("load", "none")]
    found = SimpleNamespace(fields=scene.given(), facts=facts, units=units)
    monkeypatch.setattr(
        "lmpchain.trajectory.lammps_dump.scene_of_run", lambda *given: asked.extend(given) or found
    )
    name = "my own.toml"
    assert main(["new", name, "--from", *files, *options]) == 0
    said = ["column: 3 grains", "load: none", f"scene: {name}"]
    assert capsys.readouterr().out.splitlines() == [
        *said,
        *(line.format(name) for line in following),
    ]
    assert Scene.from_toml(name) == scene
    given = dict(zip(options[::2], options[1::2], strict=True))
    expected = {"young": 1e9, "samples": 7, "diameter": 2e-3} if "--young" in given else {}
    assert asked == [files, RunOptions(**expected), given.get("--units")]


def test_existing_files_are_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "scene.toml"
    path.write_text("mine")
    assert main(["new", str(path)]) == 2
    assert "already exists: name another file, or add --force" in capsys.readouterr().err
    assert path.read_text() == "mine"
    assert main(["new", str(path), "--force"]) == 0
    assert Scene.from_toml(path)
    for words, fault in (
        (["scene.txt"], "must end in .toml"),
        (["a\nb.toml"], "letters that can be printed"),
        (["none/scene.toml"], "there is no folder none"),
        (["scene.toml", "--example", "dime"], "did you mean 'dimer'"),
    ):
        assert main(["new", *words]) == 2
        assert fault in capsys.readouterr().err


def test_help_and_readme_begin_with_new(capsys: pytest.CaptureFixture[str]):
    main(["--help"])
    text = capsys.readouterr().out
    assert text.split("\nbegin:\n")[1].split()[0] == "new"
    assert "Begin with `lmpchain new scene.toml`." in " ".join(text.split())
    start = README.read_text(encoding="utf-8").split("## Quick start")[1]
    assert start.split("\nlmpchain ")[1].startswith("new scene.toml")


@pytest.mark.slow
@each_example
def test_engines_agree_on_an_example(example: str, tmp_path: Path):
    scene = Scene.from_toml(made(tmp_path, example))
    if example == "vibrometer":  # The first tenth, because the whole takes ten seconds in LAMMPS.
        scene = scene.replace(duration=scene.duration / 10)
    runs = [simulate(scene, engine, 1e-6) for engine in ("lammps", "native")]
    for field in ("displacement", "velocity"):
        values, others = (getattr(run, field) for run in runs)
        apart = np.abs(values - others).max() / np.abs(others).max()
        assert apart < sum(run.error_estimate.total for run in runs) < 2e-6
