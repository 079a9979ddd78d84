"""The command `export`: traces of a saved run or a run folder as a table."""

from pathlib import Path

import numpy as np
import pandas
import pytest
from helpers.example_chains import column
from helpers.example_scenes import struck

from lmpchain import simulate
from lmpchain.cli import main
from lmpchain.measure import contact


@pytest.mark.parametrize("source", ["run.nc", "run"])
def test_traces_are_exported(source: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = None if source.endswith(".nc") else tmp_path / source
    scene = struck(column(12, top_load=2.0, bottom="wall"), 0.1, 2e-5, 31)
    run = simulate(scene, "native", folder=folder)
    if folder is None:
        run.save(tmp_path / source)
    path = tmp_path / "trace.csv"
    command = ["export", str(tmp_path / source), "-o", str(path)]
    chosen = "--contact-force 10,wall --velocity 5 --displacement 5 --energies"
    assert main([*command, *chosen.split()]) == 0
    assert capsys.readouterr().out == f"traces: {path}\n"
    frame = pandas.read_csv(path, float_precision="round_trip")
    first = ["time [s]", "force_10 [N]", "force_wall [N]", "velocity_5 [m/s]", "displacement_5 [m]"]
    assert list(frame.columns)[:5] == first
    np.testing.assert_array_equal(frame["force_wall [N]"], contact.wall_force(run))
    np.testing.assert_array_equal(frame["velocity_5 [m/s]"], run.velocity[:, 4])
    assert main(command) == 0
    assert pandas.read_csv(path).shape == (31, 25)
    assert main([*command, "--velocity", "99"]) == 2
    assert capsys.readouterr().err.startswith("error: velocity: grain 99 was not recorded")
