"""Traces in the formats of instruments: each is read in one call, and acts as measured.

The two files of `make_traces.py` follow closed forms; the others are written here, from numbers
of closed forms too.
"""

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from data.make_traces import EXAMPLE, hammer, vibrometer
from helpers.faults import fault_keys, faults
from helpers.instrument_files import TIME, push, rows
from scipy.interpolate import PchipInterpolator

from lmpchain import Chain, Drive, Force, InputError, Profile, Scene, simulate
from lmpchain.cli import main
from lmpchain.design import Traces

DATA = Path(__file__).parents[1] / "data"


def lvm(column: bool) -> str:
    """Return a measurement file of LabVIEW with or without a time column."""
    times = rows(TIME, push(TIME) / 2, between="\t")
    if not column:
        times = "".join(f"\t{line.split(chr(9))[1]}\n" for line in times.splitlines())
    header = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
        f"Decimal_Separator\t,\nMulti_Headings\tNo\nX_Columns\t{'One' if column else 'No'}\n"
        "Time_Pref\tAbsolute\nOperator\tlab\nDate\t2026/11/26\nTime\t15:40:45,402\n"
        "***End_of_Header***\t\n\t\nChannels\t1\t\nSamples\t81\t\nDate\t2026/11/26\t\n"
        "Y_Unit_Label\tVolts\t\nX_Dimension\tTime\t\nX0\t-2,0E-5\t\nDelta_X\t1,0E-6\t\n"
        "***End_of_Header***\t\t\nX_Value\tVoltage\tComment\n"
    )
    return header + times.replace(".", ",")


# Text of the file, and the options with which its push equals `push`.
INSTRUMENTS: dict[str, tuple[str, dict[str, Any]]] = {
    "Keysight, two channels": (
        "x-axis,1,2\nsecond,Volt,Volt\n"
        + rows(TIME, push(TIME) / 2 + 0.25, np.cos(TIME * 1e5), form="{:+.9E}"),
        {"columns": [1, 2], "scale": 2.0, "baseline": (-20e-6, -1e-7), "trigger": 0.0},
    ),
    "Rigol, counted samples": (
        "X,CH1,Start,Increment,\nSequence,Volt,-2.000000e-05,1.000000e-06\n"
        + "".join(f"{n},{v:.9e},,\n" for n, v in enumerate(push(TIME) / 2)),
        {"scale": 2.0, "trigger": 0.0},
    ),
    "LabVIEW": (lvm(True), {"scale": 2.0, "trigger": 0.0}),
    "LabVIEW without times": (lvm(False), {"scale": 2.0, "trigger": 0.0}),
    "PicoScope, milliseconds and millivolts": (
        "Time,Channel A\n(ms),(mV)\n\n" + rows(TIME * 1e3, push(TIME) * 500),
        {"scale": 2.0, "trigger": 0.0},
    ),
    "a spreadsheet in Germany": (
        "\ufeffVersuch 12;;\nZeit [\u00b5s];Kraft [mN];Bemerkung\n"
        + rows(TIME * 1e6, push(TIME) * 1e3, form="{:.7f}", between=";").replace(".", ","),
        {"trigger": 0.0},
    ),
    "no header, blanks, microseconds": (
        rows(TIME * 1e6, push(TIME) * 10, between="   "),
        {"time_scale": 1e-6, "scale": 0.1, "trigger": 0.0},
    ),
    "numpy, trigger later": (
        "# time (s)  force (N)\n" + rows(TIME + 1.0, push(TIME), form="{:.12e}", between=" "),
        {"trigger": 1.0},
    ),
}


@pytest.mark.parametrize(("text", "options"), INSTRUMENTS.values(), ids=INSTRUMENTS)
def test_a_trace_acts_as_measured(
    text: str, options: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "scope.csv"
    path.write_text(text, encoding="utf-8")
    force = Force(grain=2, file=path, **options)
    said = capsys.readouterr().err
    assert said.startswith("note: scope.csv: 81 rows from line ")
    assert said == f"note: {force.source}\n"
    assert "20 rows before it dropped" in said
    later = TIME[20:]
    np.testing.assert_allclose(force.times, later, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(force.waveform.at(later), push(later), rtol=0, atol=3e-6)
    # The scene file also contains the values, so that it can be written without the file.
    table = {"kind": "force", "grain": 2, "file": "scope.csv"} | options
    chain = {"grains": 6, "diameter": 5e-3, "gravity": 0.0, "top_load": 5.0}
    tables = {"chain": chain, "excitation": table, "recording": {"duration": 6e-5}}
    scene = Scene.from_dict(tables, tmp_path)
    assert scene.excitation == force
    path.unlink()
    scene.to_toml(tmp_path / "scene.toml")
    again = Scene.from_toml(tmp_path / "scene.toml")
    assert again == scene
    assert again.excitation.source == force.source


POINTS = "-1e-6,0.5\n0,0.25\n1e-6,0.75\n2e-6,1\n"
LAYOUTS: dict[str, tuple[str, dict[str, Any]]] = {  # Each layout contains the same four points.
    "LeCroy": (
        "LECROYWS64Xs,12345,Waveform\nSegments,1,SegmentSize,1002\n"
        "Segment,TrigTime,TimeSinceSegment1\n#1,13-Jul-2012 15:15:30,0\nTime,Ampl\n" + POINTS,
        {},
    ),
    "Rigol, with times": ("Time(s),CH1(V),t0 =-6.0e-05, tInc = 2e-08,\n" + POINTS, {"scale": 1.0}),
    "Rohde and Schwarz": ("in s,CH1 in V\n" + POINTS, {"scale": 1.0}),
    "Tektronix, names": (
        "Model,MSO4034\nFirmware Version,2.48\n\nPoint Format,Y,\nHorizontal Units,S,\n"
        "Sample Interval,4e-09\nRecord Length,10000\nGating,0.0% to 100.0%\n"
        "Vertical Units,V\nLabel,,\nTIME,CH1\n" + POINTS,
        {"scale": 1.0},
    ),
    "Yokogawa, microseconds": (
        '"Header Size","16"\n"VUnit","V"\n"HResolution","1.0"\n"HOffset","-1.0"\n'
        '"HUnit","us"\n"TraceName","CH1"\n\n,0.5,\n,0.25,\n,0.75,\n,1,\n',
        {"scale": 1.0},
    ),
    "Polytec": (
        "Source File Name: a.pvd\nSignal: 1\nTime\tForce\n[ us ]\t[ kN ]\n"
        "-1\t0.5e-3\n0\t0.25e-3\n1\t0.75e-3\n2\t1e-3\n",
        {},
    ),
    "Hantek, counted": ("nr,time,ch1\n0,-1e-06,0.5\n1,0,0.25\n2,1e-06,0.75\n3,2e-06,1\n", {}),
    "Excel": ("sep=;\nt / us;F_mN\n-1,0;500\n0,0;250\n1,0;750,0\n2,0;1000\n", {}),
    "values alone": ("0.5\n0.25\n0.75\n1\n", {"columns": 1, "time_scale": 1e-6, "trigger": 1e-6}),
}


@pytest.mark.parametrize(("text", "options"), LAYOUTS.values(), ids=LAYOUTS)
def test_layouts_are_recognised(text: str, options: dict[str, Any], tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_text(text)
    force = Force(grain=1, file=path, **{"trigger": 0.0} | options)
    np.testing.assert_allclose(force.times, [0, 1e-6, 2e-6], rtol=1e-12, atol=1e-20)
    np.testing.assert_allclose(force.force, [0.25, 0.75, 1.0], rtol=1e-12)


@pytest.mark.parametrize("header", ["time_us,voltage_V", "Time,Voltage", "Time,volts", "s,V"])
def test_volts_need_a_calibration(header: str, tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_text(f"{header}\n0,1\n1,2\n")
    with pytest.raises(InputError, match="give it in N for each V"):
        Force(grain=1, file=path)
    force = Force(grain=1, file=path, scale=1.0)
    assert force.force.tolist() == [1, 2]
    assert "times 1 N/V" in force.source


def test_a_hammer_trace_of_an_oscilloscope_moves_a_chain():
    """The impulse of the example `hammer` is in the chain, by an independent interpolation."""
    assert EXAMPLE.read_text() == hammer()
    force = Force(grain=1, file=EXAMPLE, scale=2.0, baseline=(-40e-6, -2e-7), trigger=0.0)
    time = np.arange(400) * 4e-7
    newtons = np.where(time <= 40e-6, 3.0 * np.sin(np.pi * time / 40e-6), 0.0)
    np.testing.assert_allclose(force.waveform.at(time), newtons, rtol=0, atol=3e-6)
    chain = Chain(grains=12, diameter=5e-3, gravity=0.0, bottom="free")
    scene = Scene(chain=chain, excitation=force, duration=60e-6, samples=7)
    run = simulate(scene, engine="native", tolerance=1e-8)
    impulse = PchipInterpolator(time, newtons).integrate(0.0, 60e-6)
    assert run.velocity[-1] @ chain.masses == pytest.approx(impulse, rel=1e-6)
    assert impulse == pytest.approx(2 * 3.0 * 40e-6 / np.pi, rel=1e-4)


def test_a_vibrometer_trace_drives_a_chain():
    """The file in `tests/data` has decimal commas, milliseconds, millivolts and a BOM."""
    content = (DATA / "vibrometer.csv").read_bytes().decode("utf-8-sig")
    assert content == vibrometer()
    drive = Drive(file=DATA / "vibrometer.csv", scale=5e-6, trigger=1e-3, offset=0.25)
    time = np.arange(201) * 1e-5
    path, speed = drive.motion(time)
    np.testing.assert_allclose(path, 5e-6 * 0.04 * (time * 1e3) ** 2, rtol=1e-6, atol=1e-14)
    assert speed[100] == pytest.approx(5e-6 * 0.08 * 1e6 * time[100], rel=1e-3)
    assert "decimal commas" in drive.source


@pytest.mark.parametrize("between", [0.3, 1.5])
def test_a_trigger_between_two_samples_is_interpolated(between: float, tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_text("t,F\n-1,0\n0,1\n1,3\n2,4\n3,8\n")
    time, values = np.arange(-1.0, 4.0), np.array([0.0, 1.0, 3.0, 4.0, 8.0])
    later = time > between
    force = Force(grain=1, file=path, trigger=between)
    np.testing.assert_allclose(force.times, [0, *(time[later] - between)])
    begin = np.interp(between, time, values)
    np.testing.assert_allclose(force.force, [begin, *values[later]])
    assert f"{int(between) + 2} rows before it dropped" in force.source
    # A sample within rounding errors of the trigger is at t = 0.
    for first in (-1.0, -1.0 - 0.9e-6, -1.0 + 0.9e-6):
        force = Force(grain=1, file=path, trigger=first)
        np.testing.assert_allclose(force.times, time + 1, rtol=0, atol=1e-6)
        assert (force.times[0], force.force.tolist()) == (0.0, values.tolist())
        assert "0 rows before it dropped" in force.source
    beyond = Force(grain=1, file=path, trigger=-1.0 + 1.1e-6)
    assert beyond.force[:2] == pytest.approx([1.1e-6, 1.0])
    assert fault_keys(Force, file=path, trigger=-1.0 - 1.1e-6) == ["trigger"]
    # Measured values of a fit are only those of the file.
    traces = Traces.from_csv(path, [3], trigger=between)
    np.testing.assert_allclose(traces.time, time[later] - between)


def test_profiles_are_read_from_columns(tmp_path: Path):
    path = tmp_path / "state.csv"
    path.write_text("grain;u [nm];v [mm/s]\n1;1,5;2\n2;0,5;1\n3;0;0\n")
    profile = Profile(file=path, columns=[2, 3])
    np.testing.assert_allclose(profile.displacement, [1.5e-9, 5e-10, 0], rtol=1e-15)
    np.testing.assert_allclose(profile.velocity, [2e-3, 1e-3, 0], rtol=1e-15)
    # A scale may repeat the prefixes of the header, but offsets are in m and m/s.
    same = {"columns": [2, 3], "scale": [1e-9, 1e-3], "offset": [5e-10, 1e-3]}
    shifted = Profile(file=path, **same)
    np.testing.assert_allclose(shifted.displacement, [1e-9, 0, -5e-10], rtol=1e-15, atol=1e-24)
    np.testing.assert_allclose(shifted.velocity, [1e-3, 0, -1e-3], rtol=1e-15, atol=1e-18)
    assert "less 5e-10 m; " in shifted.source
    assert Profile(file=path, columns={"velocity": "v"}) == Profile(velocity=[2e-3, 1e-3, 0])
    piece = profile.part(1, 2)
    assert piece.velocity.tolist() == profile.velocity[:2].tolist()


def test_traces_of_several_places(tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_text("Time,A,B\n(us),(mV),(mV)\n0,1,2\n1,3,4\n2,5,6\n")
    options = {"scale": [1.0, 2.0], "offset": [1e-3, 0.0], "trigger": True}
    traces = Traces.from_csv(path, [4, 9], field="force", **options)
    assert traces.trigger
    np.testing.assert_allclose(traces.time, [0, 1e-6, 2e-6])
    np.testing.assert_allclose(traces.values, [[0, 4e-3], [2e-3, 8e-3], [4e-3, 12e-3]])


ROWS = "0,1\n1,2\n"
PLAIN = f"t,F\n{ROWS}2,3\n"
REFUSED: list[tuple[str, dict[str, Any], str]] = [  # Content, options, and begin of the message.
    ("", {}, "file: .* no table of numbers"),
    ("\x89PNG\0\0", {}, "file: .* is not a text file"),
    ("t,A,B\n0,1,2\n1,2,3\n", {}, "columns: .* is ambiguous"),
    ("t,force,force\n0,1,2\n1,2,3\n", {}, "columns: .* 2 columns force"),
    (f"t,A\n{ROWS}", {"columns": [1, 3]}, "columns: .* no column 3"),
    (f"t,A\n{ROWS}", {"columns": ["t", "B"]}, "columns: .* no column 'B'"),
    (f"t,A\n{ROWS}", {"columns": [0, 1]}, "columns: are counted from 1"),
    (f"t,A\n{ROWS}", {"columns": [1, 1]}, "columns: must name one or more different"),
    (f"t,A\n{ROWS}", {"columns": [1, 2, 3]}, "columns: must name 2"),
    (PLAIN, {"columns": {"forces": 1}}, "columns: .forces. is not one of time"),
    (PLAIN, {"columns": {"time": 1}}, "columns: has no entry for force: add it"),
    (PLAIN, {"columns": []}, "columns: must name one or more different columns"),
    (PLAIN, {"columns": [True, 2]}, r"columns: must be numbers, .* \(got True\)"),
    (PLAIN, {"columns": 1.5}, r"columns: must be numbers, .* \(got 1.5\)"),
    (PLAIN, {"columns": [1, 2.5]}, r"columns: must be numbers, .* \(got 2.5\)"),
    (f"t,A (V)\n{ROWS}", {}, "scale: .* give it in N for each V"),
    (f"t,A [counts]\n{ROWS}", {}, "scale: .* for each counts"),
    (f"t,F (Trigger)\n{ROWS}", {}, "scale: .*for each Trigger"),
    (f"t,F (nN)\n{ROWS}", {"scale": 2e-9}, "scale: .* a second factor"),
    (f"t,F (mN)\n{ROWS}", {"scale": 2.0}, "scale: .* a second factor"),
    (PLAIN, {"scale": 0.0}, "scale: must not be 0"),
    (PLAIN, {"scale": [1.0, 2.0]}, "scale: must be one number, or 1 numbers, one"),
    (PLAIN, {"scale": []}, "scale: must be a finite number, or one for each column"),
    (PLAIN, {"scale": [[1.0]]}, "scale: must be a finite number"),
    (PLAIN, {"offset": [1.0, 2.0]}, "offset: must be one number, or 1 numbers"),
    (PLAIN, {"offset": float("inf")}, "offset: must be a finite number"),
    (f"time (V),force\n{ROWS}", {}, "time_scale: .* not a unit of time"),
    (f"t (ms),F\n{ROWS}", {"time_scale": 1e-6}, "time_scale: .* says 'ms', not 1e-06 s"),
    (f"t (ns),F\n{ROWS}", {"time_scale": 4e-9}, "time_scale: .* says 'ns', not 4e-09 s"),
    ("force\n1.5\n2.5\n", {"columns": [1]}, "time_scale: .* has no times"),
    (f"Sample,F\n{ROWS}2,3\n", {}, "time_scale: .*counts the samples"),
    (f"{ROWS}2,4\n", {"columns": [1, 2]}, "time_scale: .*counts"),
    ("Sample,Index,F\n0,1,2\n1,3,4\n3,4,5\n", {"columns": ["F"]}, "time_scale: .*has no times"),
    ("t,F\n0,1\n1,NaN\n2,3\n", {}, "file: .* line 3: 'NaN' in column 2"),
    ("t,F\n0,NaN\n1,1\n2,3\n", {}, "file: .* line 2: 'NaN' in column 2"),
    ("t;F\n0;1\n1;\n2;3\n3;3\n", {}, "file: .* line 3: '' in column 2"),
    ("t,F\n0,1\n,\n1,2\n2,3\n", {}, "file: .*line 3"),
    (f"t,F\n{ROWS}pause\n2,3\n3,3\n", {}, "file: .* line 4: 'pause'"),
    (f"t,F\n{ROWS}end\n", {}, "file: .* line 4: 'end'"),
    ("t,F\n0,1\n", {}, "file: .* two lines"),
    ("t,F\n0,1\n2,2\n1,3\n", {}, "file: .* line 4: time does not increase"),
    ("t,F\n0,1\n0,2\n1,3\n", {}, "file: .* line 3: time does not increase"),
    (
        *("1.5\n2.5\n\n3.5\n", {"columns": [1], "time_scale": 1e-6}),
        "file: .*line 3: is empty, but lines are counted as samples: fill it in or remove it",
    ),
    (f"time (us) CH 1 (V)\n{ROWS}", {}, "file: .* has units"),
    (PLAIN, {"skip": 4}, "file: .* no table"),
    (PLAIN, {"skip": -1}, "skip: must be"),
    ("t,F\n-1,1\n0,2\n1,3\n", {}, "trigger: .* begins at -1 s"),
    (PLAIN, {"trigger": 3.0}, "trigger: .* covers 0 to 2 s"),
    (PLAIN, {"trigger": -1e-3}, "trigger: .* covers 0 to 2 s"),
    (PLAIN, {"trigger": 2 - 1e-9}, "trigger: must be within the trace"),
    (PLAIN, {"baseline": [3, 4]}, "baseline: .* covers 0 to 2 s"),
    (PLAIN, {"baseline": [1, 0]}, "baseline: must be two times, s, the first"),
    (PLAIN, {"baseline": [1, 1]}, "baseline: must be two times, s, the first"),
    (PLAIN, {"baseline": [0, 1, 2]}, "baseline: must be two times, s, the first"),
    (PLAIN, {"baseline": [0, 1], "offset": 1.0}, "baseline: .* remove one"),
    (PLAIN, {"times": [0, 1]}, "times: is in the file"),
    (PLAIN, {"every": 0}, "every: must be"),
    (PLAIN, {"every": 3}, "every: must be below 3, the number of samples"),
    (PLAIN, {"lowpass": 0.5}, "lowpass: must be below 0.5 Hz, half the"),
    (PLAIN, {"lowpass": 0.1}, "lowpass: needs more than"),
    (f"t,F\n{ROWS}2.018,3\n", {"lowpass": 0.1}, "lowpass: needs more than"),
    (f"t,F\n{ROWS}2.022,3\n", {"lowpass": 0.1}, "lowpass: needs evenly spaced"),
]


@pytest.mark.parametrize(("text", "options", "said"), REFUSED)
def test_files_without_required_information_are_rejected(
    text: str, options: dict[str, Any], said: str, tmp_path: Path
):
    path = tmp_path / "scope.csv"
    path.write_text(text)
    ((key, message),) = faults(Force, grain=1, file=path, **options)
    assert re.match(said, f"{key}: {message}")


def test_options_of_a_file_require_a_file(tmp_path: Path):
    with pytest.raises(InputError, match="scale: requires a file"):
        Force(grain=1, times=[0, 1], force=[0, 1], scale=2.0)
    with pytest.raises(InputError, match="No such file"):
        Force(grain=1, file=tmp_path / "none.csv")
    with pytest.raises(InputError, match="did you mean 'time_scale'"):
        Force(grain=1, file=tmp_path / "none.csv", time_scal=1.0)
    with pytest.raises(InputError, match="trigger: unknown key"):
        Profile(file=tmp_path / "none.csv", trigger=0.0)


def test_commands_name_the_key_of_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "scope.csv").write_text("t,F (V)\n0,1\n1e-6,2\n")
    (tmp_path / "scene.toml").write_text(
        '[chain]\ngrains = 4\ndiameter = 1e-3\n[excitation]\nkind = "force"\n'
        'file = "scope.csv"\n[recording]\nduration = 1e-5\n'
    )
    assert main(["plan", str(tmp_path / "scene.toml")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: excitation.scale: ")
    assert said.count("\n") == 1


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_encodings_of_instruments(encoding: str, tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_text("t [\u00b5s],F\n0,1\n1,2\n", encoding=encoding)
    assert Force(grain=1, file=path).times.tolist() == [0.0, 1e-6]


@pytest.mark.parametrize("ending", [b"\n", b"\r\n", b"\r"])
def test_ends_of_lines(ending: bytes, tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_bytes(ending.join([b'"t / us","F_kN"', b'"0","0,5"', b'"1","1,5"', b""]))
    force = Force(grain=1, file=os.fspath(path))
    assert (force.times.tolist(), force.force.tolist()) == ([0.0, 1e-6], [500.0, 1500.0])


def test_equal_forces_may_come_from_different_files(tmp_path: Path):
    forces = []
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text("t,F\n0,1\n1,2\n")
        forces.append(Force(grain=1, file=tmp_path / name))
    points = Force(grain=1, times=[0, 1], force=[1, 2])
    assert forces[0] == forces[1] == points
    assert len({*forces, points}) == 1
    assert forces[0].source != forces[1].source
    assert "time: column 1 (t) in s; " in forces[0].source
    scaled = Force(grain=1, file=tmp_path / "a.csv", time_scale=1e-6)
    assert "time: column 1 (t), times 1e-06 s; " in scaled.source
    assert forces[0].replace(grain=2).source == forces[0].source
    # A changed force no longer names its file.
    assert forces[0].scaled(2.0).source is None
    assert forces[0].scaled(2.0) == points.replace(force=[2, 4])
