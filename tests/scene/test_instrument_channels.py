"""Channels, times and binary files of instruments: the push is read correctly or rejected."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.instrument_files import ARRAYS, FILES, LATER, TIME, matlab, push
from scipy.io import savemat

from lmpchain import Drive, Force, InputError, Profile
from lmpchain.cli import main
from lmpchain.design import Traces
from lmpchain.util import array_files


@pytest.mark.parametrize(("text", "options"), FILES.values(), ids=FILES)
def test_a_channel_has_its_own_unit_and_times(text: str, options: dict[str, Any], tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_text(text)
    force = Force(grain=1, file=path, trigger=0.0, **options)
    np.testing.assert_allclose(force.times, LATER, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(force.force, push(LATER), rtol=1e-6, atol=1e-8)


def test_a_given_interval_overrides_contradictory_times(tmp_path: Path):
    path = tmp_path / "scope.csv"
    for unit, interval in (("s", 1e-6), ("ns", 4e-9)):
        path.write_text(f"Time ({unit}),F\n0,1\n1,2\n2,4\n")
        force = Force(grain=1, file=path, columns=["F"], time_scale=interval)
        np.testing.assert_allclose(force.times, [0, interval, 2 * interval])
        assert f"by intervals of {interval:g} s" in force.source


@pytest.mark.parametrize(
    ("field", "column", "said"),
    [
        ("force", "change_contact_4", "of a contact, above its value at rest, not change_force_4"),
        ("force", "force_contact_4", "of a contact, including its value at rest, not change"),
        ("contact", "change_force_4", "of a grain, the mean of its two contacts, above its value"),
    ],
)
def test_tables_of_another_kind_of_force_are_rejected(
    field: str, column: str, said: str, tmp_path: Path
):
    path = tmp_path / "own.csv"
    path.write_text(f"time,{column}\n0,1\n1,2\n2,3\n")
    with pytest.raises(InputError, match=f"^columns: {column} is the force {said}"):
        Traces.from_csv(path, [4], field=field, columns=["time", column])
    path.write_text(f"time,change_{field}_4\n0,1\n1,2\n2,3\n")
    assert Traces.from_csv(path, [4], field=field).values.ravel().tolist() == [1, 2, 3]


def test_rows_of_a_profile_are_counted(tmp_path: Path):
    path = tmp_path / "state.csv"

    def written(numbers: str) -> Path:
        rows = "".join(f"{n};{v}\n" for n, v in zip(numbers, "567", strict=True))
        path.write_text(f"Grain;velocity [mm/s]\n{rows}")
        return path

    assert Profile(file=written("123")).velocity == pytest.approx([5e-3, 6e-3, 7e-3])
    for numbers in ("124", "012", "132"):
        with pytest.raises(InputError, match=r"^file: .*: the column grain must count 1, 2, 3"):
            Profile(file=written(numbers))
    path.write_text("A,B\n1,2\n3,4\n")
    with pytest.raises(InputError, match=r"^columns: .* is ambiguous: it has column 1 \(A\), col"):
        Profile(file=path)
    with pytest.raises(InputError, match=r"^file: must be the name of a CSV file"):
        Profile(file=3)


def test_channels_with_separate_times_are_not_mixed(tmp_path: Path):
    path = tmp_path / "scope.lvm"
    path.write_text(FILES["LabVIEW, times for each channel"][0])
    with pytest.raises(InputError, match="different times"):
        Traces.from_csv(path, [1, 2], columns=["A", "B"], scale=[1.0, 1.0], trigger=0.0)
    path.write_text(FILES["LabVIEW, no times, intervals that differ"][0])
    with pytest.raises(InputError, match="different intervals"):
        Traces.from_csv(path, [1, 2], columns=["A", "B"], scale=[1.0, 1.0], trigger=0.0)


@pytest.mark.parametrize(("write", "options"), ARRAYS.values(), ids=ARRAYS)
def test_arrays_are_read(
    write: Callable[[Path], Any],
    options: dict[str, Any],
    tmp_path: Path,
    request: pytest.FixtureRequest,
):
    path = tmp_path / request.node.callspec.id.split(",")[0]
    write(path)
    force = Force(grain=1, file=path, trigger=0.0, **options)
    # Records of single precision have six digits.
    np.testing.assert_allclose(force.times, LATER, rtol=1e-5, atol=1e-11)
    np.testing.assert_allclose(force.force, push(LATER), rtol=1e-5, atol=1e-8)
    assert force.source.startswith(f"{path.name}: 81 rows from row 1, ")


def test_a_worksheet_is_read(tmp_path: Path):
    pytest.importorskip("openpyxl")
    import pandas

    sheet = [
        ["Hammer", None],
        ["t (us)", "F (mN)"],
        *zip(TIME * 1e6, push(TIME) * 1e3, strict=True),
    ]
    pandas.DataFrame(sheet).to_excel(tmp_path / "a.xlsx", header=False, index=False)
    force = Force(grain=1, file=tmp_path / "a.xlsx", trigger=0.0)
    np.testing.assert_allclose(force.force, push(LATER), rtol=1e-12, atol=1e-12)


def test_nothing_in_a_file_is_executed(tmp_path: Path):
    class Bomb:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path.touch, (tmp_path / "executed",))

    path = tmp_path / "a.npz"
    np.savez(path, time=TIME, force=np.array([Bomb()] * TIME.size, object))
    (tmp_path / "executed").unlink(missing_ok=True)
    with pytest.raises(InputError, match=r"cannot be read as a file of NumPy: .*allow_pickle"):
        Force(grain=1, file=path)
    assert not (tmp_path / "executed").exists()
    savemat(tmp_path / "a.mat", {"settings": {"a": np.ones(3)}, "text": "word"})
    with pytest.raises(InputError, match="no table of numbers"):
        Force(grain=1, file=tmp_path / "a.mat")


def test_arrays_larger_than_memory_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("lmpchain.util.number_tables.LARGEST_FILE", 2**16)
    zeros = np.zeros(2**20)
    savemat(tmp_path / "a.mat", {"zeros": zeros}, do_compression=True)
    np.savez_compressed(tmp_path / "a.npz", zeros=zeros)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("zeros", data=zeros, compression="gzip")
    for name in ("a.mat", "a.npz", "a.h5"):
        with pytest.raises(InputError, match=r"arrays are larger than 0 MB"):
            Force(grain=1, file=tmp_path / name)


def test_levels_of_a_converter_need_a_scale(tmp_path: Path):
    """An oscilloscope stores levels of its converter, with their unit as an attribute."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        channel = file.create_group("Waveforms/Channel 1")
        channel.attrs["YInc"] = 2e-3
        channel.create_dataset("Data", data=np.array([0, 100, 200], np.int16))
    trace = {"file": tmp_path / "a.h5", "columns": [1], "time_scale": 1e-6}
    with pytest.raises(InputError, match=r"scale: .*level of 0.002"):
        Force(grain=1, **trace)
    force = Force(grain=1, **trace, scale=2e-3)
    np.testing.assert_allclose(force.force, [0, 0.2, 0.4])


def test_a_missing_library_is_named_with_a_recipe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def missing(name: str) -> Any:
        raise ImportError(name)

    monkeypatch.setattr(array_files, "import_module", missing)
    matlab(tmp_path / "a.mat", time=TIME, force=push(TIME))
    (tmp_path / "scene.toml").write_text(
        '[chain]\ngrains = 4\ndiameter = 1e-3\n[excitation]\nkind = "force"\n'
        'file = "a.mat"\n[recording]\nduration = 1e-5\n'
    )
    assert main(["plan", str(tmp_path / "scene.toml")]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert "which scipy.io reads: install it, or give its points by Force(times=, force=)" in said
    with pytest.raises(InputError) as caught:
        Force(grain=1, file=tmp_path / "a.mat")
    _, *recipe = str(caught.value).splitlines()
    assert [line.split()[0] for line in recipe] == ["import", "data", "lmpchain.Force(grain=1,"]


def test_a_dense_trace_is_smoothed_and_thinned(tmp_path: Path):
    """The filter's amplitude is 1 / (1 + (f / f0)^8) for two passes."""
    time = np.arange(4001) * 1e-6
    slow, fast = (np.sin(2 * np.pi * f * time) for f in (1e3, 8e4))
    np.savez(tmp_path / "a.npz", time=time, force=slow + fast)
    force = Force(grain=1, file=tmp_path / "a.npz", lowpass=2e4, every=10)
    assert force.times[1] == pytest.approx(1e-5)
    assert "low pass of 20000 Hz" in force.source
    assert "1 of 10 samples kept, 401 in total" in force.source
    middle = slice(50, -50)
    np.testing.assert_allclose(force.force[middle], slow[::10][middle], rtol=0, atol=2e-4)
    halved = Force(grain=1, file=tmp_path / "a.npz", lowpass=8e4)
    half = (slow + fast / 2)[500:-500]
    np.testing.assert_allclose(halved.force[500:-500], half, rtol=0, atol=1e-2)
    # A piston's path starts from its position at t = 0.
    drive = Drive(file=tmp_path / "a.npz", columns=["time", "force"], lowpass=2e4, scale=1e-6)
    assert drive.displacement[0] == 0
