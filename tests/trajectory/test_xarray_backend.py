"""Results of lmpchain open in xarray without further imports."""

from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest
import xarray

import lmpchain
from lmpchain.trajectory.xarray_backend import RunFolderBackend

SCENE = lmpchain.Scene(
    chain=lmpchain.Chain(grains=12, diameter=1e-3),
    excitation=lmpchain.Impulse(velocity=1e-4),
    duration=1e-5,
    samples=5,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the run of `SCENE`."""
    place = tmp_path_factory.mktemp("runs") / "run"
    lmpchain.simulate(SCENE, "native", folder=place)
    return place


def test_a_run_folder_is_a_dataset(folder: Path):
    t = lmpchain.Trajectory.load(folder)
    with xarray.open_dataset(folder, engine=RunFolderBackend) as dataset:
        np.testing.assert_array_equal(dataset.displacement, t.displacement)
        assert dataset.displacement.attrs["units"] == "m"
        assert dataset.velocity.attrs["units"] == "m s-1"
        assert dataset.attrs["solver_error"] == t.error_estimate.solver
        assert lmpchain.Scene.from_text(dataset.attrs["scene"]) == SCENE
    with xarray.open_dataset(
        folder, engine=RunFolderBackend, drop_variables="velocity"
    ) as displacements:
        assert list(displacements) == ["displacement"]
    with pytest.raises(TypeError, match="lmpchain has no option colour"):
        xarray.open_dataset(folder, engine=RunFolderBackend, colour=1)


@pytest.mark.parametrize(
    "option", ["decode_times", "mask_and_scale", "decode_timedelta", "decode_coords", "decode_cf"]
)
def test_options_of_xarray_act_as_on_netcdf_files(option: str, folder: Path, tmp_path: Path):
    lmpchain.Trajectory.load(folder).save(tmp_path / "run.nc")
    options = {option: False}
    with (
        xarray.open_dataset(folder, engine=RunFolderBackend, **options) as dataset,
        xarray.open_dataset(tmp_path / "run.nc", **options) as same,
    ):
        xarray.testing.assert_equal(dataset, same)


def test_xarray_recognises_run_folders(folder: Path, tmp_path: Path):
    backend = RunFolderBackend()
    assert backend.guess_can_open(folder)
    assert backend.guess_can_open(str(folder))
    assert not backend.guess_can_open(tmp_path)
    assert not backend.guess_can_open(b"CDF")
    (entry,) = entry_points(group="xarray.backends", name="lmpchain")
    assert entry.load() is RunFolderBackend
