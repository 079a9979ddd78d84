"""Saved trajectories are loaded equal, other tools read them, and files are never incomplete."""

import resource
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from helpers.example_scenes import run
from helpers.faults import fault_keys
from helpers.seals import seal_anew

from lmpchain import Chain, Impulse, InputError, Trajectory
from lmpchain.util.provenance import command


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    chain = Chain(grains=8, material=["glass", "steel"] * 4, diameter=np.linspace(1e-3, 2e-3, 8))
    return run(chain, Impulse(velocity=1e-4, grain=2), 2e-5, 31, 1e-9, grains=[5, 1, 2])


def test_saved_and_loaded_trajectories_are_equal(trajectory: Trajectory, tmp_path: Path):
    trajectory.save(tmp_path / "run.nc")
    again = Trajectory.load(tmp_path / "run.nc")
    assert again == trajectory
    for name in ("time", "grains", "displacement", "velocity"):
        assert getattr(again, name).dtype == getattr(trajectory, name).dtype


def test_unusual_numbers_are_preserved(trajectory: Trajectory, tmp_path: Path):
    odd = replace(
        trajectory,
        displacement=trajectory.displacement.copy(),
        provenance={"note": 'ä, µ and "quotes"\n'},
    )
    odd.displacement[0, :3] = [5e-324, -0.0, 1e308]
    odd.save(tmp_path / "run.nc")
    again = Trajectory.load(tmp_path / "run.nc")
    assert again == odd
    assert np.signbit(again.displacement[0, 1])


def test_xarray_reads_it(trajectory: Trajectory, tmp_path: Path):
    trajectory.save(tmp_path / "run.nc")
    with xarray.open_dataset(tmp_path / "run.nc", engine="h5netcdf", decode_times=False) as data:
        assert dict(data.sizes) == {"time": 31, "grain": 3}
        assert data["displacement"].dims == data["velocity"].dims == ("time", "grain")
        assert data["displacement"].attrs["units"] == "m"
        assert data["velocity"].attrs["units"] == "m s-1"
        assert data["time"].attrs["units"] == "s"
        assert data["velocity"].sel(grain=2, time=0.0).item() == 1e-4
        assert data.attrs["engine"] == "native"
        assert data.attrs["equation"] == 1
        assert data.attrs["solver_error"] == trajectory.error_estimate.solver
        assert 'kind = "impulse"' in data.attrs["scene"]
    assert data.attrs.pop("history").endswith(command())  # The command of the file.
    assert data.identical(trajectory.to_xarray())


def test_a_full_disk_preserves_the_earlier_file(trajectory: Trajectory, tmp_path: Path):
    before = tmp_path / "before.nc"
    trajectory.save(before)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (before.stat().st_size // 2, limits[1]))
    try:
        for path in (before, tmp_path / "new.nc"):
            with pytest.raises(InputError, match=r"\.nc: cannot be written: File too large"):
                trajectory.save(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == [before]
    assert Trajectory.load(before) == trajectory


def test_an_interrupted_write_leaves_no_file(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: Any
):
    def interrupted(_: Any) -> None:
        assert [path.name.startswith(".run.") for path in tmp_path.iterdir()] == [True]
        raise KeyboardInterrupt

    monkeypatch.setattr("lmpchain.trajectory.netcdf.seal", interrupted)
    with pytest.raises(KeyboardInterrupt):
        trajectory.save(tmp_path / "run.nc")
    assert list(tmp_path.iterdir()) == []


def test_unwritable_places(trajectory: Trajectory, tmp_path: Path):
    for path in (tmp_path, tmp_path / "none" / "run.nc"):
        assert fault_keys(trajectory.save, path) == [str(path)]


def test_a_file_without_a_part_is_rejected(trajectory: Trajectory, tmp_path: Path):
    whole = trajectory.to_xarray()
    damaged = [whole.drop_vars("velocity")]
    for name in ("lmpchain_format", "scene", "cost", "engine"):
        data = whole.copy()
        data.attrs = {key: value for key, value in whole.attrs.items() if key != name}
        damaged.append(data)
    damaged += [
        whole.assign_attrs(scene="[chain]\ngrains = 1"),
        whole.assign_attrs(lmpchain_format=99),
        whole.isel(time=slice(0, 5)),
    ]
    for number, data in enumerate(damaged):
        path = tmp_path / f"{number}.nc"
        data.to_netcdf(path, engine="h5netcdf")
        seal_anew(path)
        assert fault_keys(Trajectory.load, path) == [str(path)]
