"""Saved trajectories are loaded equal, other tools read them, and files are never incomplete."""

import resource
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray
from helpers.example_scenes import run
from helpers.faults import fault_keys
from helpers.seals import seal_anew

from lmpchain import Chain, Impulse, InputError, Profile, Scene, Trajectory, simulate
from lmpchain.util.provenance import command


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    chain = Chain(grains=8, material=["glass", "steel"] * 4, diameter=np.linspace(1e-3, 2e-3, 8))
    return run(chain, Impulse(velocity=1e-4, grain=2), 2e-5, 31, 1e-9, grains=[5, 1, 2])


def test_saved_and_loaded_trajectories_are_equal(trajectory: Trajectory, tmp_path: Path):
    trajectory.save(tmp_path / "run.nc")
    again = Trajectory.load(tmp_path / "run.nc")
    assert again == trajectory
    assert again.scene == trajectory.scene
    assert again.displacement.dtype == again.velocity.dtype == np.float64
    for name in ("time", "grains", "displacement", "velocity"):
        assert getattr(again, name).tobytes() == getattr(trajectory, name).tobytes()
    assert again.error_estimate == trajectory.error_estimate
    assert again.cost == trajectory.cost
    assert again.provenance == trajectory.provenance


def test_a_profile_is_preserved(rng: np.random.Generator, tmp_path: Path):
    chain = Chain(grains=8, diameter=1e-3)
    start = Profile(
        displacement=[1e-10 / 3] * 7 + [0],
        velocity=np.append(rng.random(7), 0) * 1e-5,
    )
    run = simulate(Scene(chain=chain, excitation=start, duration=1e-5, samples=3), "native", 1e-8)
    run.save(tmp_path / "run.nc")
    assert Trajectory.load(tmp_path / "run.nc") == run


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


def test_equality(trajectory: Trajectory):
    assert trajectory == replace(trajectory, velocity=trajectory.velocity.copy())
    other = trajectory.velocity.copy()
    other[-1, -1] = np.nextafter(other[-1, -1], np.inf)
    assert trajectory != replace(trajectory, velocity=other)
    assert trajectory != replace(trajectory, velocity=other[:-1])
    assert trajectory != replace(trajectory, engine="lammps")
    assert trajectory != replace(trajectory, provenance={})
    assert trajectory != replace(trajectory, cost=trajectory.cost._replace(steps=1))
    assert trajectory != 3
    with pytest.raises(TypeError):
        hash(trajectory)


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


def test_h5py_reads_it(trajectory: Trajectory, tmp_path: Path):
    trajectory.save(tmp_path / "run.nc")
    with h5py.File(tmp_path / "run.nc") as file:
        assert set(file) == {"time", "grain", "displacement", "velocity"}
        assert np.array_equal(file["velocity"][:], trajectory.velocity)
        assert np.array_equal(file["grain"][:], [5, 1, 2])
        assert file.attrs["engine"] == "native"
        assert file.attrs["equation"].item() == 1
        assert "max|x - x_true|" in file.attrs["error_definition"]
        for name in ("time", "displacement", "velocity"):
            assert file[name].attrs["units"]
            assert file[name].attrs["long_name"]


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


def test_a_truncated_file_is_rejected(trajectory: Trajectory, tmp_path: Path):
    trajectory.save(tmp_path / "run.nc")
    whole = (tmp_path / "run.nc").read_bytes()
    short = tmp_path / "short.nc"
    for length in (0, 10, len(whole) // 4, len(whole) // 2, len(whole) - 1):
        short.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"short\.nc.*cut short"):
            Trajectory.load(short)


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
    ]
    for number, data in enumerate(damaged):
        path = tmp_path / f"{number}.nc"
        data.to_netcdf(path, engine="h5netcdf")
        seal_anew(path)
        assert fault_keys(Trajectory.load, path) == [str(path)]


def test_arrays_that_do_not_match_the_scene_are_rejected(trajectory: Trajectory, tmp_path: Path):
    data = trajectory.to_xarray().isel(time=slice(0, 5))
    data.to_netcdf(tmp_path / "part.nc", engine="h5netcdf")
    seal_anew(tmp_path / "part.nc")
    with pytest.raises(InputError):
        Trajectory.load(tmp_path / "part.nc")
