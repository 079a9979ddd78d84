"""The command `averages`: a table, numbers and a picture."""

import json
from pathlib import Path

import pytest
from matplotlib import image

from lmpchain import Chain, Impulse, Scene
from lmpchain.cli.command_line import main


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    chain = Chain(grains=8, material="steel", diameter=6e-3, gravity=0, top="wall", bottom="wall")
    path = tmp_path / "scene.toml"
    Scene(chain=chain, excitation=Impulse(velocity=1.0), duration=0.01).to_toml(path)
    return path


def test_averages(scene: Path, capsys: pytest.CaptureFixture):
    numbers = scene.with_suffix(".json")
    picture = scene.with_suffix(".png")
    words = ["--of", "kinetic_energy, force:3", "--time", "0.02", "--tolerance", "1e-3", "--force"]
    picture.write_bytes(b"an older picture")
    assert main(["averages", str(scene), *words, "--json", str(numbers), "-o", str(picture)]) == 0
    shown = capsys.readouterr().out
    assert "kinetic_energy" in shown
    assert "s that is left out" in shown
    written = json.loads(numbers.read_text())
    low, high = written["quantities"]["kinetic_energy"]["interval"]
    energy = Scene.from_toml(scene).energy
    # The value (delta + 1) / (delta + 3) is exact for any motion between walls.
    assert low < 5 / 9 * energy < high
    assert written["quantities"]["force:3"]["unit"] == "N"
    assert written["time_s"] == pytest.approx(0.02, rel=0.01)
    # A panel of each quantity is 3 inches high, at 150 dots per inch.
    assert image.imread(picture).shape[:2] == (900, 1050)
    said = shown.splitlines()
    assert said[-2:] == [f"numbers: {numbers}", f"picture: {picture}"]


def test_wrong_quantities_are_reported_in_one_line(scene: Path, capsys: pytest.CaptureFixture):
    assert main(["averages", str(scene), "--of", "kinetic"]) == 2
    assert "error: quantities: must be kinetic_energy |" in capsys.readouterr().err
