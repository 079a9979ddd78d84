"""Files of instruments in their documented layouts, all with the same push.

Text and arrays hold the same force over time in closed form, `push`.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.io import savemat

TIME = np.arange(-20, 61) * 1e-6
LATER = TIME[20:]


def push(time: np.ndarray) -> np.ndarray:
    """Return a push of 3 N over 50 us, and nothing before and after it."""
    inside = (time > 0) & (time < 50e-6)
    return np.where(inside, 3.0 * np.sin(np.pi * time / 50e-6) ** 2, 0.0)


VOLTS = push(TIME) / 2
OTHER = 0.1 * np.cos(TIME * 1e5)


def rows(*columns: np.ndarray, between: str = ",", begin: str = "", form: str = "{:.9e}") -> str:
    """Return columns as lines of text."""
    lines = (between.join(form.format(x) for x in row) for row in zip(*columns, strict=True))
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
    """Return two channels of a Tektronix TDS side by side, each with its header on the left."""
    text = ""
    for n, row in enumerate(zip(TIME, OTHER * 1e3, VOLTS, strict=True)):
        name, value = TDS[n] if n < len(TDS) else ("", "")
        first, second = (value.format(unit=unit) for unit in ("mV", "V"))
        text += f"{name},{first},,{row[0]:.9e},{row[1]:.9e},,"
        text += f"{name},{second},,{row[0]:.9e},{row[2]:.9e},\n"
    return text


# Text of a file, and the options with which its push equals `push`.
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
    "a trigger point without times": (
        "Sample Interval,1e-06\nTrigger Point,20\nVertical Units,V\n" + rows(VOLTS),
        {"columns": [1], "scale": 2.0},
    ),
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
    "a counter beside an interval": (
        "Sampling interval: 1e-6\nSample #,F (N)\n"
        + "".join(f"{n - 20},{f:.9e}\n" for n, f in enumerate(push(TIME))),
        {},
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


def universal(kind: int, even: bool) -> str:
    """Return a universal file with two records of dataset 58, as defined by the format."""
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
    """Write data sets with units and sampling as attributes."""
    with h5py.File(path, "w") as file:
        channel = file.create_group("Waveforms/Channel 1")
        channel.attrs.update({"XInc": 1e-6, "XOrg": -2e-5, "YUnits": "mV"})
        channel["data"] = VOLTS * 1e3
        file["Waveforms/Channel 2/data"] = OTHER
        file["link"] = h5py.ExternalLink("other.h5", "data")


def matlab(path: Path, **arrays: Any) -> None:
    """Write a MATLAB 5 file that also contains objects other than numbers."""
    structure = {"a": np.ones(3), "b": "word"}
    savemat(
        path, arrays | {"settings": structure, "text": "word", "cells": np.array([1, "a"], object)}
    )


def matlab_hdf5(path: Path) -> None:
    """Write a MATLAB 7.3 file: HDF5 after a block of text, with vectors as rows."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("time", TIME * 1e6), ("force", push(TIME))):
            file[name] = values[None]
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")


# Function that writes a file, and the options with which its push equals `push`.
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
