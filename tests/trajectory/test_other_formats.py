"""Files of other programs are identified, with a remedy."""

from pathlib import Path

import ase
import ase.io
import h5py
import numpy as np
import pytest
import scipy.io
from helpers.example_scenes import scene_of

from lmpchain import Chain, Impulse, InputError, Trajectory, simulate
from lmpchain.cli.command_line import main
from lmpchain.engines.lammps.export import write_deck
from lmpchain.trajectory.other_formats import OTHER_FORMATS, describe_other_format

SCENE = scene_of(Chain(grains=6, diameter=1e-3), Impulse(velocity=1e-5), 2e-6, 3)
ATOMS = ase.Atoms("X3", positions=[[0, 0, 0], [0, 0, 1e-3], [0, 0, 2.5]], cell=[3, 3, 3])


def netcdf(path: Path) -> None:
    with scipy.io.netcdf_file(path, "w") as file:
        file.createDimension("atom", 3)


def h5md(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_group("h5md").attrs["version"] = [1, 1]


# Each file is written by the program's own writer, if there is one.
WRITERS = {
    "NumPy array": lambda path: np.save(path.open("wb"), np.ones(3)),
    "ZIP archive": lambda path: np.savez(path.open("wb"), a=np.ones(3)),
    "NetCDF 3": netcdf,
    "H5MD": h5md,
    "XYZ file": lambda path: ase.io.write(path, ATOMS, format="xyz"),
    "extended XYZ": lambda path: ase.io.write(path, ATOMS, format="extxyz"),
    "data file of LAMMPS": lambda path: ase.io.write(path, ATOMS, format="lammps-data"),
    "input of LAMMPS": lambda path: write_deck(SCENE, path.parent, step=1e-7).rename(path),
    "log of LAMMPS": "LAMMPS (22 Jul 2025 - Update 4)\nunits si\n",
    "VTK": "# vtk DataFile Version 3.0\nspheres\nASCII\nDATASET POLYDATA\n",
    " VTK file": '<?xml version="1.0"?>\n<VTKFile type="PolyData" version="0.1">\n',
    "YADE saved": '<?xml version="1.0"?>\n<!DOCTYPE boost_serialization>\n<boost_serialization>\n',
    "YADE exported": "#format x_y_z_r\n0 0 0 1e-3\n0 0 2e-3 1e-3\n",
    "data file of MercuryDPM": "2 0 0 0 0 1 1 1\n0 0 0 1 0 0 0.1 0 0 0 0 0 0 0\n"
    "0 0 1 1 0 0 0.1 0 0 0 0 0 0 0\n",
    "restart file of MercuryDPM": "restart_version 4 name Column\ndataFile\n",
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_of_another_program_is_named(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "file"
    writer = WRITERS[name]
    if isinstance(writer, str):
        path.write_text(writer)
    else:
        writer(path)
    for read in (Trajectory.load, lambda at: Trajectory.from_dump(at, SCENE)):
        with pytest.raises(InputError, match=f"{name}.*: .*(lmpchain reads|lmpchain check)") as no:
            read(path)
        assert "cut short" not in str(no.value)
    for verb in ("fit", "report", "check"):
        assert main([verb, str(path)]) == 2
        told = capsys.readouterr().err
        assert name in told
        assert told.count("\n") == 1


def test_files_of_lmpchain_are_not_foreign(tmp_path: Path):
    t = simulate(SCENE, "native")
    t.save(tmp_path / "run.nc")
    assert describe_other_format(tmp_path / "run.nc") == ""
    whole = (tmp_path / "run.nc").read_bytes()
    for length in (0, 10, 200, len(whole) // 2):
        (tmp_path / "run.nc").write_bytes(whole[:length])
        with pytest.raises(InputError, match="cut short"):
            Trajectory.load(tmp_path / "run.nc")
    t.to_extxyz(tmp_path / "run.extxyz")
    assert "extended XYZ" in describe_other_format(tmp_path / "run.extxyz")
    assert len(OTHER_FORMATS) <= len(WRITERS) + 1
