"""The command `orbit`: numbers and picture of a nonlinear mode."""

import json
from pathlib import Path

import pytest

from lmpchain import Chain, Impulse, Scene, orbits
from lmpchain.cli.command_line import main


def test_orbit(tmp_path: Path):
    chain = Chain(grains=6, diameter=1e-3)
    scene = tmp_path / "scene.toml"
    energy = 1e-2 * chain.length_scale * chain.masses[0] * 9.81
    Scene(chain=chain, excitation=Impulse(velocity=1e-9), duration=1e-5, samples=2).to_toml(scene)
    picture = tmp_path / "family.png"
    numbers = tmp_path / "orbit.json"
    main(
        [
            "orbit",
            str(scene),
            "--mode",
            "2",
            "--energy",
            str(energy),
            "-o",
            str(picture),
            "--json",
            str(numbers),
        ]
    )
    assert picture.read_bytes()[:4] == b"\x89PNG"
    found = json.loads(numbers.read_text())
    own = orbits.normal_mode(chain, 2, energy)
    assert found["orbit"]["period_s"] == pytest.approx(own.period, rel=1e-10)
    assert found["energy_J"][-1] == pytest.approx(energy, rel=1e-10)
    assert found["parameter"] == "energy"


def test_a_mode_that_there_is_not(tmp_path: Path, capsys: pytest.CaptureFixture):
    scene = tmp_path / "scene.toml"
    chain = Chain(grains=6, diameter=1e-3)
    Scene(chain=chain, excitation=Impulse(velocity=1e-9), duration=1e-5, samples=2).to_toml(scene)
    assert main(["orbit", str(scene), "--mode", "9", "--energy", "1e-12"]) == 2
    assert "mode: must be a whole number from 1 to 5" in capsys.readouterr().err
