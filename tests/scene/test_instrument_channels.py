"""Channels, times and binary files of instruments, in the layouts that their manuals document.

Every file holds the same force over time, in closed form, or is refused in one line.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from lmpchain import Drive, Force, InputError
from lmpchain.cli import main
from lmpchain.design import Traces
from lmpchain.util import array_files

TIME = np.arange(-20, 61) * 1e-6
LATER = TIME[20:]


def push(time: np.ndarray) -> np.ndarray:
    """Return a push of 3 N over 50 us, and nothing before and after it."""
    inside = (time > 0) & (time < 50e-6)
    return np.where(inside, 3.0 * np.sin(np.pi * time / 50e-6) ** 2, 0.0)


VOLTS = push(TIME) / 2
OTHER = 0.1 * np.cos(TIME * 1e5)


def rows(*columns: np.ndarray, between: str = ",", begin: str = "") -> str:
    """Return columns as lines of text."""
    lines = (between.join(f"{x:.9e}" for x in row) for row in zip(*columns, strict=True))
    return "".join(f"{begin}{line}\n" for line in lines)


TEKTRONIX = (
    "Model,MSO4034\nFirmware Version,2.48\n\nPoint Format,Y,Y,\nHorizontal Units,{time},,\n"
    "Sample Interval,1e-06\nRecord Length,81\nProbe Attenuation,10,1,\n"
    "Vertical Units,{units},\nLabel,,,\nTIME,CH1,CH2\n"
)
LVM = (
    "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\t{x}\n"
    "***End_of_Header***\t\n\t\nChannels\t2\t\nSamples\t{samples}\n"
    "Y_Unit_Label\t{units}\nX_Dimension\t{dimension}\nX0\t{x0}\nDelta_X\t{steps}\n"
    "***End_of_Header***\t\t\n"
)
YOKOGAWA = (
    '"Header Size","16"\n"Model Name","DL850"\n"TraceName","CH1","CH2"\n"VUnit","mV","V"\n'
    '"HResolution","2.0E-06","1.0E-06"\n"HOffset","0","-2.0E-05"\n"HUnit","s","s"\n\n'
)
TDS = [
    ("Record Length", "81"),
    ("Sample Interval", "1e-06"),
    ("Trigger Point", "20"),
    ("Vertical Units", "{unit}"),
    ("Horizontal Units", "s"),
]


def tds() -> str:
    """Return two channels of a Tektronix TDS side by side, each with its facts to the left."""
    text = ""
    for n, row in enumerate(zip(TIME, OTHER * 1e3, VOLTS, strict=True)):
        name, value = TDS[n] if n < len(TDS) else ("", "")
        first, second = (value.format(unit=unit) for unit in ("mV", "V"))
        text += f"{name},{first},,{row[0]:.9e},{row[1]:.9e},,"
        text += f"{name},{second},,{row[0]:.9e},{row[2]:.9e},\n"
    return text


# text of a file, and the options with which its push is that of `push`
FILES: dict[str, tuple[str, dict[str, Any]]] = {
    "Tektronix, second channel in V": (
        TEKTRONIX.format(time="s", units="mV,V") + rows(TIME, OTHER * 1e3, VOLTS),
        {"columns": ["CH2"], "scale": 2.0},
    ),
    "Tektronix, first channel in mV": (
        TEKTRONIX.format(time="s", units="mV,V") + rows(TIME, VOLTS * 1e3, OTHER),
        {"columns": {"force": "CH1"}, "scale": 2.0},
    ),
    "Tektronix, times in ms": (
        TEKTRONIX.format(time="ms", units="V,mV") + rows(TIME * 1e3, OTHER, VOLTS * 1e3),
        {"columns": ["TIME", "CH2"], "scale": 2.0},
    ),
    "Tektronix TDS, channels side by side": (tds(), {"columns": [11], "scale": 2.0}),
    "LabVIEW, one column of times": (
        LVM.format(
            x="One", samples="81\t81", units="mV\tVolts", dimension="Time\tTime",
            x0="-2.0E-5\t-2.0E-5", steps="1.0E-6\t1.0E-6",
        )
        + "X_Value\tA\tHammer (Trigger)\tComment\n" + rows(TIME, OTHER, VOLTS, between="\t"),
        {"columns": ["Hammer (Trigger)"], "scale": 2.0},
    ),
    "LabVIEW, no times, intervals that differ": (
        LVM.format(
            x="No", samples="81\t81", units="mV\tVolts", dimension="Time\tTime",
            x0="0\t-2.0E-5", steps="2.0E-6\t1.0E-6",
        )
        + "X_Value\tA\tB\tComment\n" + rows(OTHER, VOLTS, between="\t", begin="\t"),
        {"columns": ["B"], "scale": 2.0},
    ),
    "LabVIEW, times for each channel": (
        LVM.format(
            x="Multi", samples="81\t\t81", units="mV\t\tVolts", dimension="Time\t\tTime",
            x0="0\t\t-2.0E-5", steps="2.0E-6\t\t1.0E-6",
        )
        + "X_Value\tA\tX_Value\tB\tComment\n"
        + rows(2 * TIME + 4e-5, OTHER, TIME, VOLTS, between="\t"),
        {"columns": ["B"], "scale": 2.0},
    ),
    "Yokogawa, empty first cells": (
        YOKOGAWA + rows(OTHER, VOLTS, begin=","),
        {"columns": [3], "scale": 2.0},
    ),
    "Yokogawa, no empty cells": (YOKOGAWA + rows(OTHER, VOLTS), {"columns": [2], "scale": 2.0}),
    "Siglent": (
        "Record Length,Analog:81\nSample Interval,Analog:0.000001\n"
        "Vertical Units,CH1:mV,CH2:V\nHorizontal Units,s\nSource,CH1,CH2\nSecond,Value,Value\n"
        + rows(TIME, OTHER, VOLTS),
        {"columns": [3], "scale": 2.0},
    ),
    "Keysight, times not named": (
        "x-axis,1,2\nsecond,Volt,Volt\n" + rows(TIME, OTHER, VOLTS),
        {"columns": ["2"], "scale": 2.0},
    ),
    "a remark behind a unit, below it, and none": (
        "Time,Hammer (Trigger),Count\n(us),[mV],-\n" + rows(TIME * 1e6, VOLTS * 1e3, OTHER),
        {"columns": ["Time", "Hammer (Trigger)"], "scale": 2.0},
    ),
    "a remark behind a unit": (
        "Time in us (Trigger),Hammer [mV] (Trigger)\n" + rows(TIME * 1e6, VOLTS * 1e3),
        {"scale": 2.0},
    ),
    "Rigol, cropped": (
        "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-4.0e-05,1.0e-06\n"
        + "".join(f"{n + 20},{v:.9e},0,,\n" for n, v in enumerate(VOLTS)),
        {"columns": ["CH1"], "scale": 2.0},
    ),
    "Rigol, no times, facts behind the names": (
        "CH1(V),CH2(mV),t0 = -2e-05, tInc = 1e-06,\n" + rows(VOLTS, OTHER),
        {"columns": ["CH1"], "scale": 2.0},
    ),
    "times beside an interval": (
        "Sampling interval: 1e-6\nTime (us),Force (mN)\n" + rows(TIME * 1e6, push(TIME) * 1e3),
        {"columns": ["Force"]},
    ),
    "times that only the interval shows": (
        "Sample Interval,1e-06,\n,,\n" + rows(TIME, push(TIME), OTHER),
        {"columns": [2]},
    ),
    "an interval that is given as well": (
        "Time (s),Force (N)\n" + rows(TIME, push(TIME)),
        {"columns": ["Force"], "time_scale": 1e-6},
    ),
    "a unit of times that is given as well": (
        "t,F\n" + rows(TIME * 1e6, push(TIME)),
        {"columns": ["F"], "time_scale": 1e-6},
    ),
    "a counter": (
        "Sample #,F\n" + "".join(f"{n - 20},{f:.9e}\n" for n, f in enumerate(push(TIME))),
        {"columns": ["F"], "time_scale": 1e-6},
    ),
    "a rate": (
        "Sample Rate: 1000000\nt0: -2e-5\nForce (N),A\n" + rows(push(TIME), OTHER),
        {"columns": [1]},
    ),
    "empty cells at the end": (
        "t (s),F (N),,\n" + rows(TIME, push(TIME)) + ",,\n;;\n\x1a",
        {"columns": [1, 2]},
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "options"), FILES.values(), ids=FILES)
def test_a_channel_has_its_own_unit_and_times(text: str, options: dict[str, Any], tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_text(text)
    force = Force(grain=1, file=path, trigger=0.0, **options)
    np.testing.assert_allclose(force.times, LATER, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(force.force, push(LATER), rtol=1e-6, atol=1e-8)


def test_a_given_interval_holds_where_times_contradict_it(tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_text("Time (s),F\n0,1\n1,2\n2,4\n")
    force = Force(grain=1, file=path, columns=["F"], time_scale=1e-6)
    np.testing.assert_allclose(force.times, [0, 1e-6, 2e-6])


REFUSED = {  # text, options, and a part of what is said
    "a counter": ("Sample,F\n0,1\n1,2\n2,3\n", {}, "time_scale: .*counts the samples"),
    "numbers that count": ("0,1\n1,2\n2,4\n", {"columns": [1, 2]}, "time_scale: .*counts"),
    "a remark for a unit": ("t,F (Trigger)\n0,1\n1,2\n", {}, "scale: .*for each Trigger"),
    "empty cells within": ("t,F\n0,1\n,\n1,2\n2,3\n", {}, "file: .*line 3"),
    "a lowpass too high": ("t,F\n0,1\n1,2\n2,3\n", {"lowpass": 0.5}, "lowpass: must be below 0.5"),
    "a lowpass of few": ("t,F\n0,1\n1,2\n2,3\n", {"lowpass": 0.1}, "lowpass: needs more than"),
    "a lowpass between gaps": (
        "t,F\n0,1\n1,2\n9,3\n", {"lowpass": 0.1}, "lowpass: needs evenly spaced"
    ),
    "too few left": ("t,F\n0,1\n1,2\n", {"every": 2}, "every: must be below 2"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "options", "said"), REFUSED.values(), ids=REFUSED)
def test_what_is_unclear_is_refused(text: str, options: dict[str, Any], said: str, tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=f"^{said}"):
        Force(grain=1, file=path, **options)


def test_channels_with_times_of_their_own_are_not_mixed(tmp_path: Path):
    path = tmp_path / "scope.lvm"
    path.write_text(FILES["LabVIEW, times for each channel"][0])
    with pytest.raises(InputError, match="times of their own"):
        Traces.from_csv(path, [1, 2], columns=["A", "B"], scale=[1.0, 1.0], trigger=0.0)
    path.write_text(FILES["LabVIEW, no times, intervals that differ"][0])
    with pytest.raises(InputError, match="intervals of their own"):
        Traces.from_csv(path, [1, 2], columns=["A", "B"], scale=[1.0, 1.0], trigger=0.0)


def universal(kind: int, even: bool) -> str:
    """Return a universal file with two records of dataset 58, as its definition has them."""
    text = "    -1\n   151\nhammer test\n    -1\n"
    for node, unit, values in ((1, "mV", OTHER * 1e3), (2, "N", push(TIME))):
        text += f"    -1\n    58\nrecord {node}\nNONE\n28-Nov-26\nNONE\nNONE\n"
        text += (
            f"    1         0    0         0 {'NONE':10}{node:10d}{3:4d} {'NONE':10}{0:10d}{0:4d}\n"
        )
        step = 1e-6 if even else 0.0
        text += f"{kind:10d}{TIME.size:10d}{int(even):10d}{-2e-5:13.5E}{step:13.5E}{0.0:13.5E}\n"
        for number, label, units in (
            (17, "Time", "s"),
            (13, "Force", unit),
            (0, "", ""),
            (0, "", ""),
        ):
            text += f"{number:10d}{0:5d}{0:5d}{0:5d} {label or 'NONE':20} {units or 'NONE':20}\n"
        form = "{:13.5E}" if kind == 2 else "{:20.12E}"
        cells = [form.format(value) for value in values]
        if not even:
            cells = [f"{t:13.5E}{cell}" for t, cell in zip(TIME, cells, strict=True)]
        each = {(2, True): 6, (2, False): 3, (4, True): 4, (4, False): 2}[kind, even]
        lines = ("".join(cells[n : n + each]) for n in range(0, len(cells), each))
        text += "\n".join(lines) + "\n    -1\n"
    return text


def hdf5(path: Path) -> None:
    """Write data sets with units and sampling among their attributes."""
    with h5py.File(path, "w") as file:
        channel = file.create_group("Waveforms/Channel 1")
        channel.attrs.update({"XInc": 1e-6, "XOrg": -2e-5, "YUnits": "mV"})
        channel["data"] = VOLTS * 1e3
        file["Waveforms/Channel 2/data"] = OTHER
        file["link"] = h5py.ExternalLink("other.h5", "data")


def matlab(path: Path, **arrays: Any) -> None:
    """Write a file of MATLAB 5, with what holds no numbers beside the arrays."""
    structure = {"a": np.ones(3), "b": "word"}
    savemat(
        path, arrays | {"settings": structure, "text": "word", "cells": np.array([1, "a"], object)}
    )


def matlab_hdf5(path: Path) -> None:
    """Write a file of MATLAB 7.3: HDF5 behind a block of text, with vectors as rows."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("time", TIME * 1e6), ("force", push(TIME))):
            file[name] = values[None]
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")


# how a file is written, and the options with which its push is that of `push`
ARRAYS: dict[str, tuple[Callable[[Path], Any], dict[str, Any]]] = {
    "a.mat, PicoScope": (
        lambda path: matlab(path, A=VOLTS, B=OTHER, Tstart=-2e-5, Tinterval=1e-6, Length=81),
        {"columns": ["A"], "scale": 2.0},
    ),
    "b.mat, a matrix": (
        lambda path: matlab(path, data=np.column_stack([TIME, VOLTS]), fs=1e6),
        {"columns": [1, 2], "scale": 2.0},
    ),
    "c.mat, version 4": (
        lambda path: savemat(path, {"t": TIME, "force": push(TIME)}, format="4"), {},
    ),
    "d.mat, version 7.3": (matlab_hdf5, {"time_scale": 1e-6}),
    "e.npz": (
        lambda path: np.savez(path, time_us=TIME * 1e6, force=push(TIME), some=OTHER[:9], n=3), {},
    ),
    "f.npy": (
        lambda path: np.save(path, np.column_stack([TIME, push(TIME)])), {"columns": [1, 2]},
    ),
    "g.h5": (hdf5, {"columns": ["Waveforms/Channel 1/data"], "scale": 2.0}),
    **{
        f"h{kind}{even}.uff": (
            lambda path, kind=kind, even=even: path.write_text(universal(kind, even)),
            {"columns": ["2:3"]},
        )
        for kind in (2, 4) for even in (True, False)
    },
}  # fmt: skip


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
    # records of single precision have six digits
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
    """Against the filter's amplitude in closed form, 1 / (1 + (f / f0)^8) for two passes."""
    time = np.arange(4001) * 1e-6
    slow, fast = (np.sin(2 * np.pi * f * time) for f in (1e3, 8e4))
    np.savez(tmp_path / "a.npz", time=time, force=slow + fast)
    force = Force(grain=1, file=tmp_path / "a.npz", lowpass=2e4, every=10)
    assert force.times[1] == pytest.approx(1e-5)
    assert "low pass of 20000 Hz" in force.source
    assert "every 10 samples one, 401 of them" in force.source
    middle = slice(50, -50)
    np.testing.assert_allclose(force.force[middle], slow[::10][middle], rtol=0, atol=2e-4)
    halved = Force(grain=1, file=tmp_path / "a.npz", lowpass=8e4)
    half = (slow + fast / 2)[500:-500]
    np.testing.assert_allclose(halved.force[500:-500], half, rtol=0, atol=1e-2)
    # a piston's path is counted from where it is at t = 0
    drive = Drive(file=tmp_path / "a.npz", columns=["time", "force"], lowpass=2e4, scale=1e-6)
    assert drive.displacement[0] == 0
