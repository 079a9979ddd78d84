"""The command `orbit`: numbers and picture of a nonlinear mode."""

import json
from pathlib import Path

import pytest

from lmpchain import Chain, Drive, Impulse, Scene, orbits
from lmpchain.cli.command_line import main


def test_orbit(tmp_path: Path, capsys: pytest.CaptureFixture):
    chain = Chain(grains=6, diameter=1e-3)
    scene = tmp_path / "scene.toml"
    energy = 1e-2 * chain.length_scale * chain.masses[0] * 9.81
    Scene(chain=chain, excitation=Impulse(velocity=1e-9), duration=1e-5, samples=2).to_toml(scene)
    picture = tmp_path / "family.png"
    numbers = tmp_path / "orbit.json"
    options = ["--mode", "2", "--energy", str(energy)]
    assert main(["orbit", str(scene), *options, "-o", str(picture), "--json", str(numbers)]) == 0
    assert picture.read_bytes()[:4] == b"\x89PNG"
    found = json.loads(numbers.read_text())
    own = orbits.normal_mode(chain, 2, energy)
    assert found["orbit"]["period_s"] == pytest.approx(own.period, rel=1e-10)
    assert found["energy_J"][-1] == pytest.approx(energy, rel=1e-10)
    assert found["parameter"] == "energy"
    said = capsys.readouterr().out.splitlines()
    assert said[-2:] == [f"numbers: {numbers}", f"picture: {picture}"]


def test_an_unknown_mode_is_rejected(tmp_path: Path, capsys: pytest.CaptureFixture):
    scene = tmp_path / "scene.toml"
    chain = Chain(grains=6, diameter=1e-3)
    Scene(chain=chain, excitation=Impulse(velocity=1e-9), duration=1e-5, samples=2).to_toml(scene)
    assert main(["orbit", str(scene), "--mode", "9", "--energy", "1e-12"]) == 2
    assert "mode: must be a whole number from 1 to 5" in capsys.readouterr().err


@pytest.mark.slow
def test_the_answer_to_a_drive_is_followed(tmp_path: Path, capsys: pytest.CaptureFixture):
    """The scene file has damping, and the response curve passes two folds."""
    level = {"diameter": 1e-2, "gravity": 0.0, "top_load": 20.0, "bottom": "wall"}
    chain = Chain(grains=2, material="steel", damping={"drag": 2000.0}, **level)
    drive = Drive(amplitude=1e-7, frequency=1.2e4)
    scene = tmp_path / "scene.toml"
    Scene(chain=chain, excitation=drive, duration=1e-3, samples=2).to_toml(scene)
    picture = tmp_path / "curve.png"
    numbers = tmp_path / "curve.json"
    command = ["orbit", str(scene), "--follow", "drive.frequency=1.8e4", "--of", "force:1"]
    assert main([*command, "-o", str(picture), "--json", str(numbers)]) == 0
    assert picture.read_bytes()[:4] == b"\x89PNG"
    said = capsys.readouterr().out
    assert said.count("fold: at 13") == 2
    assert "of drive.frequency" in said
    found = json.loads(numbers.read_text())
    assert found["value"][-1] == pytest.approx(1.8e4, rel=1e-12)
    last = orbits.find(chain, drive=drive.replace(frequency=1.8e4))
    assert found["orbit"]["displacement_m"] == pytest.approx(
        last.displacement.tolist(), abs=1e-10 * last.amplitude
    )


def test_requests_without_one_goal_are_rejected(tmp_path: Path, capsys: pytest.CaptureFixture):
    scene = tmp_path / "scene.toml"
    chain = Chain(grains=2, bottom="wall", material="steel", diameter=1e-2, damping={"drag": 2000})
    drive = Drive(amplitude=1e-9, frequency=1.2e4)
    Scene(chain=chain, excitation=drive, duration=1e-3, samples=2).to_toml(scene)
    follow = ("--follow", "drive.frequency=1.201e4")
    goal = "orbit: needs a mode or a drive to follow, not both"
    for wrong, message in {
        ("--follow", "drive.frequency"): "--follow: must be a number and its last value",
        ("--follow", "=1.2e4"): "--follow: must be a number and its last value",
        ("--follow", "drive.speed=1"): "parameter: must be period, a number of the drive",
        (*follow, "--of", "force:9"): "of: the contacts are numbered",
        (): goal,
        ("--mode", "1"): goal,
        ("--energy", "1e-9"): goal,
        ("--mode", "1", *follow): goal,
        ("--energy", "1e-9", *follow): goal,
        ("--mode", "1", "--energy", "1e-9", *follow): goal,
    }.items():
        assert main(["orbit", str(scene), *wrong]) == 2
        assert message in capsys.readouterr().err
