"""Output of commands, number by number, with defaults, exit codes and refusals."""

import io
import json
import os
import re
import shlex
import signal
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.command_output import SCENE, keys, names, parsed
from helpers.faults import faults

from lmpchain import (
    Chain,
    EngineUnavailable,
    Impulse,
    InputError,
    Scene,
    Trajectory,
    doctor,
    orbits,
    simulate,
)
from lmpchain.cli import common, new
from lmpchain.cli.command_line import main
from lmpchain.cli.read import read_axis
from lmpchain.cli.verbs import VERBS
from lmpchain.report.document import origin
from lmpchain.simulation.run_folder import Stopped
from lmpchain.trajectory.record import ErrorEstimate
from lmpchain.util import mpi
from lmpchain.util.plotting import figure


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="module")
def answer() -> Trajectory:
    """A trajectory whose numbers are all different."""
    chain = Chain(grains=20, diameter=1e-3)
    scene = Scene(chain=chain, excitation=Impulse(velocity=8.57e-4), duration=20e-6, samples=11)
    run = simulate(scene, "native", 1e-6)
    cost = run.cost._replace(integration_s=1.25, estimate_s=0.5, setup_s=0.125, compile_s=9.0)
    cost = cost._replace(steps=1234, step_s=2.5e-8, ranks=2)
    return replace(run, error_estimate=ErrorEstimate(3e-3, 2e-5), cost=cost)


def start_under_mpirun(monkeypatch: pytest.MonkeyPatch, rank: int) -> list[Any]:
    """Pretend that this process is one of two under mpirun; return the list of worker events."""
    calls: list[Any] = []
    loops = "lmpchain.engines.lammps.communicators"
    monkeypatch.setenv("PMI_SIZE", "2")
    monkeypatch.setenv("PMI_RANK", str(rank))
    monkeypatch.setattr(mpi, "is_launched", lambda: True)
    monkeypatch.setattr(mpi, "count_idle", lambda: 0)
    monkeypatch.setattr(mpi, "leave", lambda: monkeypatch.setattr(mpi, "count_idle", lambda: 1))
    monkeypatch.setattr(mpi, "join", lambda: SimpleNamespace(rank=rank))
    monkeypatch.setattr(f"{loops}.worker_loop", lambda world: calls.append(("work", world.rank)))
    monkeypatch.setattr(
        f"{loops}.shutdown_workers", lambda world: calls.append(("end", world.rank))
    )
    return calls


def lines(text: str) -> dict[str, str]:
    return dict(re.split(r"  +", line, maxsplit=1) for line in text.splitlines())


# --- run


def test_the_summary_of_a_run_number_by_number(
    scene: Path, answer: Trajectory, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
):
    asked: dict[str, Any] = {}

    def simulated(what: Scene, engine: Any, tolerance: float, **options: Any) -> Trajectory:
        asked.update(options, scene=what, engine=engine, tolerance=tolerance)
        return answer

    monkeypatch.setattr("lmpchain.simulation.api.simulate", simulated)
    monkeypatch.setattr("lmpchain.util.tables.line_width", lambda: 200)
    assert main(["run", str(scene), "--tolerance", "1e-4"]) == 1  # The model error is 3e-3.
    said = lines(capsys.readouterr().out)
    assert said == {
        "engine": "native, which solves Eq. (1), on 2 ranks",
        "scene": "20 grains, 11 samples over 2e-05 s",
        "integrator": f"{answer.cost.integrator}, 1234 steps of 1.621e-08 s on average, "
        "2.5e-08 s at most",
        "estimated error": "0.003 = 0.003 (equation) + 2e-05 (solver) (tolerance 0.0001)",
        "time spent": "1.25 s integration, 0.5 s error estimate, 0.125 s set-up, 9 s compilation",
        "file": str(scene.with_suffix(".nc")),
    }
    assert asked["tolerance"] == 1e-4
    assert (asked["folder"], asked["max_wall"], asked["progress"]) == (None, None, False)
    assert asked["scene"] == Scene.from_toml(scene)
    exact = replace(
        answer, error_estimate=ErrorEstimate(0.0, 2e-5), cost=answer.cost._replace(ranks=1)
    )
    monkeypatch.setattr("lmpchain.simulation.api.simulate", lambda *_, **__: exact)
    assert main(["run", str(scene), "--force"]) == 0
    said = lines(capsys.readouterr().out)
    assert said["estimated error"] == "2e-05 (tolerance 1e-06)"
    assert said["engine"] == "native, which solves Eq. (1)"


def test_warnings_are_printed_before_the_run(
    scene: Path, answer: Trajectory, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(
        "lmpchain.stability.pre_run.pre_run_warnings", lambda *_: ["it is rough", "it is long"]
    )
    monkeypatch.setattr("lmpchain.simulation.api.simulate", lambda *_, **__: answer)
    assert main(["run", str(scene), "--tolerance", "0.1"]) == 0
    assert capsys.readouterr().err == "warning: it is rough\nwarning: it is long\n"
    monkeypatch.setattr("lmpchain.stability.pre_run.pre_run_warnings", lambda *_: [])
    for engine, alone in (("auto", True), ("native", True), ("lammps", False)):
        start_under_mpirun(monkeypatch, 0)
        command = ["run", str(scene), "--force", "--tolerance", "0.1", "--engine", engine]
        assert main(command) == 0
        one = (
            f"warning: the engine {engine} runs on one rank; --engine lammps would use all ranks\n"
        )
        assert capsys.readouterr().err == (one if alone else "")


def test_a_run_stopped_by_max_wall_can_be_resumed(scene: Path, monkeypatch: Any, capsys: Any):
    asked: dict[str, Any] = {}

    def stops(*_: Any, **options: Any) -> None:
        asked.update(options)
        raise Stopped("out of time")

    monkeypatch.setattr("lmpchain.simulation.api.simulate", stops)
    folder = scene.parent / "run"
    assert main(["run", str(scene), "-o", f"{folder}/", "--max-wall", "0:01:30"]) == 75
    assert "out of time" in capsys.readouterr().err
    assert (asked["max_wall"], Path(asked["folder"])) == (90.0, folder)


def interrupt(*_: Any, **__: Any) -> None:
    raise KeyboardInterrupt


def terminate(*_: Any, **__: Any) -> None:
    os.kill(os.getpid(), signal.SIGTERM)
    signal.pause()


@pytest.mark.parametrize(
    ("stop", "code", "name"), [(interrupt, 130, "Ctrl-C"), (terminate, 143, "SIGTERM")]
)
def test_a_stopped_command_reports_saved_files(
    stop: Any, code: int, name: str, scene: Path, monkeypatch: Any, capsys: Any
):
    # The sweeps are imported first, because they import `simulate` by name and would keep the
    # stand-in.
    monkeypatch.setattr("lmpchain.sweeps.run.sweep", stop)
    monkeypatch.setattr("lmpchain.simulation.api.simulate", stop)
    monkeypatch.setattr("lmpchain.simulation.planner.plan", stop)
    before = signal.getsignal(signal.SIGTERM)
    nothing = "nothing unfinished was kept"
    hint = "with -o FOLDER/ a stopped run is kept and can be resumed"
    folder = scene.parent / "run"
    for words, kept in (
        (["run", str(scene)], f"{nothing}; {hint}"),
        (["run", str(scene), "-o", f"{folder}/"], f"{nothing}; {hint}"),
        (["plan", str(scene)], nothing),
        (
            ["sweep", str(scene), "-o", str(folder)],
            f"finished scenes are kept in {folder}; repeat the command to continue",
        ),
    ):
        assert main(words) == code
        assert capsys.readouterr().err.splitlines()[-1] == f"stopped by {name}; {kept}"
        assert signal.getsignal(signal.SIGTERM) == before


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (MemoryError(), 1, "memory ran out: record fewer grains or samples, or"),
        (RuntimeError("can't start new thread"), 1, "memory ran out: record fewer grains"),
        (FileNotFoundError(2, "No such file", "a.nc"), 1, "[Errno 2] No such file: 'a.nc'"),
        (
            InputError([(" ", "is blank"), ("b", "is wrong")]),
            2,
            "' ': is blank\nerror: b: is wrong",
        ),
        (RuntimeError("a fault of the program"), None, ""),
        (BrokenPipeError(32, "Broken pipe"), 141, None),
    ],
)
def test_an_error_during_a_command_has_its_message_and_code(
    error: Exception, code: int | None, said: str | None, scene: Path, monkeypatch: Any, capsys: Any
):
    """An error that has no message for the user is not hidden."""

    def fails(*_: Any) -> None:
        raise error

    monkeypatch.setattr("lmpchain.simulation.planner.plan", fails)
    if code is None:
        with pytest.raises(RuntimeError, match="a fault of the program"):
            main(["plan", str(scene)])
    else:
        assert main(["plan", str(scene)]) == code
        printed = capsys.readouterr().err
        assert printed == "" if said is None else printed.startswith(f"error: {said}")


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (None, 0, ""),
        (OSError(28, "No space left"), 1, "error: [Errno 28] No space left\n"),
        (BrokenPipeError(), 141, ""),
    ],
)
def test_buffered_output_is_flushed_before_the_end(
    error: Exception | None, code: int, said: str, monkeypatch: Any
):
    """A fault of the disk or of the reader is found while the command can still report it."""

    class Output(io.StringIO):
        def flush(self) -> None:
            if error:
                raise error

    beside = io.StringIO()
    for stream in (Output(), None):
        monkeypatch.setattr(sys, "stdout", stream)
        monkeypatch.setattr(sys, "stderr", beside)
        # A stream that was closed before the start is None.
        assert main(["--version"]) == (code if stream else 0)
    assert beside.getvalue() == said


def test_a_stopped_run_folder_names_the_resume_command(scene: Path, monkeypatch: Any, capsys: Any):
    folder = scene.parent / "run"
    assert main(["run", str(scene), "-o", f"{folder}/", "--engine", "native"]) == 0
    monkeypatch.setattr("lmpchain.simulation.api.resume", interrupt)
    capsys.readouterr()
    assert main(["resume", str(folder)]) == 130
    said = capsys.readouterr()
    assert said.out == f"{folder}: this run is finished; there is nothing left to do\n"
    assert said.err == f"stopped by Ctrl-C; continue with: lmpchain resume {folder}\n"


def test_a_killed_run_names_the_resume_command(
    tmp_path: Path, answer: Trajectory, monkeypatch: Any, capsys: Any
):
    about = {"state": "killed", "samples_done": 7, "samples": 11, "reason": "Killed."}
    about |= {"tolerance": 1e-4}
    monkeypatch.setattr("lmpchain.simulation.run_folder.status", lambda folder: about)
    monkeypatch.setattr("lmpchain.simulation.api.resume", lambda folder, **options: answer)
    assert main(["resume", str(tmp_path)]) == 1  # The model error exceeds the tolerance.
    first, *rest = capsys.readouterr().out.splitlines()
    assert (
        first
        == f"{tmp_path}: Killed. at sample 7 of 11 or later; continuing from its last checkpoint"
    )
    said = lines("\n".join(rest))
    assert said["folder"] == str(tmp_path)
    assert said["estimated error"].endswith("(tolerance 0.0001)")


def test_a_sweep_prints_the_number_of_solved_scenes(tmp_path: Path, monkeypatch: Any, capsys: Any):
    asked: dict[str, Any] = {}
    reasons = np.array([["", "too fast"], ["", "too slow"]], dtype=object)

    def sweep(source: str, folder: str, **options: Any) -> dict[str, Any]:
        asked.update(options)
        return {"reason": SimpleNamespace(to_numpy=lambda: reasons, size=reasons.size)}

    monkeypatch.setattr("lmpchain.sweeps.run.sweep", sweep)
    words = ["sweep", "s.toml", "-o", str(tmp_path)]
    assert main(words) == 1
    said = capsys.readouterr()
    assert said.out == f"2 of 4 scenes are solved in {tmp_path}\n"
    assert said.err == "error: 2 scenes failed, the first because: too fast\n"
    assert (asked["workers"], asked["scheduler"], asked["progress"]) == (
        len(os.sched_getaffinity(0)),
        None,
        False,
    )
    reasons[:] = ""
    assert main([*words, "--workers", "3"]) == 0
    assert asked["workers"] == 3
    assert capsys.readouterr().out == f"4 of 4 scenes are solved in {tmp_path}\n"
    start_under_mpirun(monkeypatch, 0)
    assert main(words) == 2
    assert keys(capsys.readouterr()) == ["sweep"]


# --- under mpirun


def test_under_mpirun_rank_0_runs_lammps_and_ends_the_others(monkeypatch: Any, capsys: Any):
    words = ["run", "none.toml", "--engine", "lammps"]
    for rank, expected, code in ((0, "end", 2), (1, "work", 0)):
        calls = start_under_mpirun(monkeypatch, rank)
        assert main(words) == code
        assert calls == [(expected, rank)]
        assert ("none.toml" in capsys.readouterr().err) == (rank == 0)

    def fails() -> None:
        raise EngineUnavailable("of another MPI")

    monkeypatch.setattr(mpi, "join", fails)
    assert main(words) == 1
    assert capsys.readouterr().err == "error: of another MPI\n"


def test_under_mpirun_only_rank_0_works_without_lammps(monkeypatch: Any, capsys: Any):
    for rank in (0, 1):
        calls = start_under_mpirun(monkeypatch, rank)
        assert main(["--version"]) == 0
        assert calls == []
        assert capsys.readouterr().out.startswith("lmpchain") == (rank == 0)


# --- options


NAMED_DEFAULTS = ("--engine", "--diameter", "--integrator", "--pair-style", "--example", "--draw")


@pytest.mark.parametrize("verb", VERBS)
def test_help_states_the_defaults(verb: str):
    """A number that the help calls a default is the default of the option."""
    for flags, options in [*VERBS[verb].arguments, *VERBS[verb].choice]:
        default = options.get("default")
        if told := re.search(r"\(default: ([\d.e-]+)\)", options.get("help", "")):
            assert float(told[1]) == default, flags
        elif flags[-1].startswith("-") and flags[-1] not in NAMED_DEFAULTS:
            assert default is None, flags


WORDS = {
    "new": ["s.toml"],
    "run": ["s.toml"],
    "resume": ["run/"],
    "compare": ["s.toml"],
    "plan": [],
    "averages": ["s.toml", "--of", "kinetic_energy"],
    "orbit": ["s.toml"],
    "sensitivity": ["r.nc", "--of", "momentum:3"],
    "deck": ["s.toml", "-o", "deck"],
    "dyson": ["r.nc", "--m", "1,2"],
    "export": ["r.nc", "-o", "t.csv"],
    "fit": ["r.nc"],
    "report": ["r.nc"],
    "explore": ["s.toml", "--over", "chain.gravity=1:9", "-o", "p.html"],
    "workprec": ["s.toml"],
    "stability": ["s.toml"],
    "sweep": ["w.toml", "-o", "out"],
    "check": [],
    "doctor": [],
    "docs": [],
}


def test_required_arguments(capsys: pytest.CaptureFixture[str]):
    assert WORDS.keys() == VERBS.keys()
    for verb, words in WORDS.items():
        assert VERBS[verb].command.__name__ == verb
        parsed(verb, *words)
        pairs = [words[:1], *(words[n : n + 2] for n in range(1, len(words), 2))]
        for left_out in [pair for pair in pairs if pair]:
            fewer = [word for word in words if word not in left_out]
            assert main([verb, *fewer]) == 2
            assert capsys.readouterr().err.endswith(f"; see lmpchain {verb} --help\n")
    run = parsed("run", "s.toml", "--step", "1e-8", "--threads", "2", "--ranks", "3")
    assert (run.step, run.threads, run.ranks, run.engine) == (1e-8, 2, 3, "auto")
    deck = parsed("deck", *WORDS["deck"])
    assert (deck.diameter, deck.integrator, deck.pair_style) == ("physical", "verlet", "granular")
    assert main(["sweep", *WORDS["sweep"], "--workers", "2", "--scheduler", "x"]) == 2
    assert "not allowed with" in capsys.readouterr().err


DURATIONS = {
    "1:02:03": 3723,
    "0:00:01": 1,
    "90": 90,
    "0.5": 0.5,
    "100:59:59.5": 363599.5,
}


@pytest.mark.parametrize("text", DURATIONS)
def test_times_as_hours_minutes_and_seconds(text: str):
    assert parsed("resume", "run", "--max-wall", text).max_wall == DURATIONS[text]


@pytest.mark.parametrize(
    "text",
    ["0", "0:00:00", "1:60:00", "1:00:60", "1:00", "-5", "1h", "", "٣", "1:0:5", "nan", "1e400"],
)
def test_invalid_times(text: str, capsys: pytest.CaptureFixture[str]):
    assert main(["resume", "run", f"--max-wall={text}"]) == 2
    assert "must be a time above 0, as H:MM:SS or in seconds" in capsys.readouterr().err


# --- compare


def test_short_runs_are_timed_again(
    scene: Path, answer: Trajectory, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
):
    """A short run has the time of its fastest repetition; a long run is not repeated."""
    cost = answer.cost._replace(estimate_s=0.5, setup_s=0.6)
    words = ["compare", str(scene), "--engines", "native", "--tolerance", "1e-5", "--json", "-"]
    monkeypatch.setattr("lmpchain.benchmark.bench.repeat", lambda run: [run(), run()])
    # The run with 0.95 s takes more than 2 s with its estimate and its set-up.
    for given, listed, left in (([0.7, 0.75, 0.5, 9], 0.5, [9]), ([0.95, 0.75], 0.95, [0.75])):
        times = iter(given)

        def simulated(_: Scene, *asked: Any, times: Any = times, **__: Any) -> Trajectory:
            assert asked == ("native", 1e-5)
            return replace(answer, cost=cost._replace(integration_s=next(times)))

        monkeypatch.setattr("lmpchain.simulation.api.simulate", simulated)
        assert main(words) == 0
        (row,) = json.loads(capsys.readouterr().out)["rows"]
        assert (row["integration_s"], list(times)) == (listed, left)


@pytest.mark.parametrize("verb", ["workprec", "stability"])
def test_charts_report_omissions_and_their_location(
    verb: str, scene: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
):
    asked: list[Any] = []
    result = SimpleNamespace(
        table=lambda: "the table",
        left_out=["lammps: not here"],
        to_json=lambda: {"answer": 42},
        plot=lambda: figure(2.0, 1.0).subplots(),
    )

    def work(scene: Scene, *values: Any, progress: bool) -> Any:
        asked.extend([*values, progress])
        return result

    monkeypatch.setattr("lmpchain.benchmark.bench.work_precision", work)
    monkeypatch.setattr("lmpchain.stability.find.stability", work)
    picture = scene.parent / "c.png"
    numbers = scene.parent / "c.json"
    words = [verb, str(scene), "-o", str(picture)]
    assert main(words if verb == "workprec" else [*words, "--json", str(numbers)]) == 0
    printed = capsys.readouterr().out.splitlines()
    told = ["the table", "left out: lammps: not here", f"numbers: {numbers}", f"picture: {picture}"]
    assert printed == told
    assert json.loads(numbers.read_text()) == {"answer": 42}
    assert numbers.read_text() == '{\n  "answer": 42\n}\n'
    assert asked == ([60.0, False] if verb == "workprec" else [False])
    assert main([verb, str(scene), "--json"]) == 0
    said = capsys.readouterr()
    assert (json.loads(said.out), said.err.splitlines()) == ({"answer": 42}, told[:2])


# --- plan, docs, orbit


def test_a_calibration_prints_its_results(
    tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(
        "lmpchain.simulation.planner.calibrate", lambda: (tmp_path / "speeds", 12.345)
    )
    speeds = {"native": (0.0123, 1.5), "lammps": (0.5, 0.75)}
    monkeypatch.setattr("lmpchain.engines.cost_model.measured", lambda: speeds)
    assert main(["plan", "--calibrate"]) == 0
    first, *table = capsys.readouterr().out.splitlines()
    assert first == f"measured in 12 s how fast the engines are here: {tmp_path / 'speeds'}"
    rows = [re.split(r"  +", line) for line in table]
    assert rows == [
        ["engine", "overhead of a run", "cost over the shipped one"],
        ["native", "12.3 ms", "1.5"],
        ["lammps", "500 ms", "0.75"],
    ]

    def fails() -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("lmpchain.simulation.planner.calibrate", fails)
    assert main(["plan", "--calibrate"]) == 1
    assert capsys.readouterr().err.endswith(": cannot be written: No space left on device\n")


def test_documentation_is_opened_where_it_was_built(tmp_path: Path, monkeypatch: Any, capsys: Any):
    opened: list[str] = []
    monkeypatch.setattr(new.webbrowser, "open", opened.append)
    assert (new.SOURCES / "index.md").exists()
    monkeypatch.setattr(new, "SOURCES", tmp_path / "docs")
    assert main(["docs"]) == 1
    assert "this installation has no pages" in capsys.readouterr().err
    (tmp_path / "docs").mkdir()
    assert main(["docs"]) == 1
    said = capsys.readouterr().err
    assert f"sphinx-build {tmp_path}/docs {tmp_path}/docs/build" in said
    assert f"or read {tmp_path}/docs/index.md" in said
    (tmp_path / "docs" / "build").mkdir()
    page = tmp_path / "docs" / "build" / "index.html"
    page.touch()
    assert main(["docs"]) == 0
    assert capsys.readouterr().out == f"{page.as_uri()}\n"
    assert opened == [page.as_uri()]


def test_an_orbit_is_described_in_numbers(scene: Path, monkeypatch: Any, capsys: Any):
    first = SimpleNamespace(period=4e-6)
    last = SimpleNamespace(period=5e-6, energy=1.25e-14, amplitude=2.5e-9, drive=None, stable=False)
    last.residual, last.error, last.unstable = 3e-13, 4.56e-10, np.array([1.5 + 2j, 1.0])

    class Family(list):
        parameter = "energy"
        events = (SimpleNamespace(kind="period doubling", value=1.5e-14, orbit=first),)
        reached = False
        ended = "it turns back"

    family: Any = Family([first, last])
    told = [
        "period: 5e-06 s (200000 Hz; linear: 250000 Hz)",
        "energy: 1.25e-14 J",
        "largest displacement: 2.5e-09 m",
        "residual after a period: 3.0e-13; error of the steps: 4.6e-10",
        "Floquet multipliers: unstable, largest multiplier 2.5",
        "period doubling: at 1.5e-14 J, 250000 Hz",
        "the family does not reach the requested energy: it turns back",
    ]
    monkeypatch.setattr("lmpchain.orbits.modes.mode_family", lambda *_, **__: family)
    words = ["orbit", str(scene), "--mode", "1", "--energy", "1e-14"]
    assert main(words) == 1
    assert capsys.readouterr().out.splitlines() == told
    last.stable, last.drive, family.reached = True, "a drive", True
    told[0] = "period: 5e-06 s (200000 Hz; at the start: 250000 Hz)"
    told[4:] = ["Floquet multipliers: stable", "period doubling: at 1.5e-14 of energy, 250000 Hz"]
    assert main(words) == 0
    assert capsys.readouterr().out.splitlines() == told


def test_the_picture_of_an_orbit_shows_the_requested_size_and_the_last_orbit(
    scene: Path, monkeypatch: Any
):
    chain = Chain(grains=3, diameter=1e-3)
    family = orbits.follow(orbits.normal_mode(chain, 1, 1e-14), "energy", 2e-14)
    monkeypatch.setattr("lmpchain.orbits.modes.mode_family", lambda *_, **__: family)
    drawn: list[Any] = []
    monkeypatch.setattr(
        "lmpchain.util.plotting.save", lambda picture, *_, **__: drawn.append(picture)
    )
    words = ["orbit", str(scene), "--mode", "1", "--energy", "2e-14", "-o", f"{scene}.png"]
    for of, label in {"": "energy above rest", "displacement:2": "displacement of grain 2"}.items():
        assert main([*words, "--of", of]) == 0
        panels = drawn.pop().axes
        assert len(panels) == 2
        assert panels[0].get_ylabel().startswith(label)
        assert len(panels[1].lines) == 5
        assert [ax.get_title("left")[:3] for ax in panels] == ["(a)", "(b)"]


@pytest.mark.parametrize("arguments", [[], ["--compile"]])
def test_the_doctor_compiles_on_request(arguments: list[str], monkeypatch: Any, capsys: Any):
    compiled = []
    monkeypatch.setattr(doctor, "diagnose", lambda tell: doctor.Diagnosis(()))
    monkeypatch.setattr(doctor, "compile_all", lambda progress: compiled.append(progress))
    assert main(["doctor", *arguments]) == 0
    assert len(compiled) == len(arguments)
    assert capsys.readouterr().out == "all is well\n"


# --- files and texts


def test_invalid_outputs(tmp_path: Path):
    scene = tmp_path / "scene.toml"
    scene.touch()
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")

    def fault(name: str, suffixes: tuple[str, ...] = ()) -> str:
        ((key, message),) = faults(common.output, name, str(scene), suffixes)
        assert key == name
        return message

    folder = str(tmp_path / "folder")
    assert fault(folder) == f"is a folder; name a file, such as {folder}/run.nc"
    assert fault(f"{tmp_path}/new/") == f"is a folder; name a file, such as {tmp_path}/new/run.nc"
    assert fault(folder, (".png",)).endswith(f"such as {folder}")
    assert fault(f"{tmp_path}/pipe") == "is a device or a pipe, not a file; name a file"
    assert fault(f"{tmp_path}/a.txt", (".png", ".pdf", ".svg")) == "must end in .png, .pdf or .svg"
    assert fault(str(scene)) == "is the input file: name another file"
    assert fault(f"{tmp_path}/no/a.nc") == f"there is no folder {tmp_path}/no: create it first"
    assert common.output(f"{tmp_path}/a.PNG", str(scene), (".png",)) == tmp_path / "a.PNG"
    (tmp_path / "there.nc").touch()
    assert common.output(f"{tmp_path}/there.nc", f"{tmp_path}/none.toml") == tmp_path / "there.nc"
    assert common.beside("a/run.v2.nc", ".html") == "a/run.v2.html"


def test_a_folder_without_write_permission(tmp_path: Path, monkeypatch: Any):
    (tmp_path / "there.nc").touch()
    for locked in (tmp_path, tmp_path / "there.nc"):
        monkeypatch.setattr(os, "access", lambda path, mode, locked=locked: Path(path) != locked)
        with pytest.raises(InputError, match="you may not write there"):
            common.output(f"{tmp_path}/there.nc", "")
    monkeypatch.setattr(os, "access", lambda path, mode: mode in (os.W_OK | os.X_OK, os.W_OK))
    assert common.output(f"{tmp_path}/there.nc", "")
    assert common.output(f"{tmp_path}/new.nc", "")


def test_the_example_of_each_command_is_valid(capsys: pytest.CaptureFixture[str]):
    for name, verb in VERBS.items():
        words = shlex.split(verb.example)
        assert words[0] == name
        parsed(*words)
        main([name, "--help"])
        shown = " ".join(capsys.readouterr().out.split())
        assert f"Example: lmpchain {verb.example}" in shown
        assert verb.summary[1:] in shown


def test_a_terminal_shows_faults_in_colour(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    terminal = io.StringIO()
    terminal.isatty = lambda: True  # type: ignore[method-assign]
    common.show("error", ": no such [file]", terminal)
    monkeypatch.setenv("NO_COLOR", "1")
    common.show("error", ": no such [file]", terminal)
    coloured, plain = terminal.getvalue().splitlines()
    assert "\x1b[1;31merror" in coloured
    assert coloured.endswith(": no such [file]")
    assert "31m" not in plain
    assert "error" in plain
    monkeypatch.setattr("sys.stderr", aside := io.StringIO())
    common.complain("no such file")
    assert aside.getvalue() == "error: no such file\n"


def test_complaints_are_one_printable_line(capsys: pytest.CaptureFixture[str]):
    common.complain("one\n  two\x1b[31m é", "warning")
    assert capsys.readouterr().err == "warning: one two\\x1b[31m é\n"
    common.complain("bad")
    assert capsys.readouterr().err == "error: bad\n"


def test_progress_is_shown_only_on_a_terminal(monkeypatch: Any):
    for stream, shown in (
        (None, False),
        (SimpleNamespace(isatty=lambda: True), True),
        (SimpleNamespace(isatty=lambda: False), False),
    ):
        monkeypatch.setattr(sys, "stderr", stream)
        assert common.on_terminal() is shown


def test_nan_and_infinity_become_null_in_json(tmp_path: Path):
    with pytest.raises(ValueError, match="JSON"):
        common.write_json({"a": float("nan")}, tmp_path / "a.json")
    assert names(tmp_path) == []


# --- saved runs


def test_options_of_a_sensitivity_are_passed_on(scene: Path, monkeypatch: Any, capsys: Any):
    asked: list[Any] = []
    result = SimpleNamespace(
        table=lambda: "the table",
        to_json=lambda: {"rank": 1},
        plot=lambda: figure(2.0, 1.0).subplots(),
    )
    monkeypatch.setattr(
        "lmpchain.design.sensitivities.sensitivity", lambda *values: asked.extend(values) or result
    )
    options = "--answer momentum:3 --sigma-mass 0.02 --sigma-constant 0"
    words = ["sensitivity", str(scene), *options.split()]
    numbers = scene.parent / "n.json"
    picture = scene.parent / "p.png"
    assert main([*words, "--json", str(numbers), "-o", str(picture)]) == 0
    told = f"the table\nnumbers: {numbers}\npicture: {picture}\n"
    assert capsys.readouterr().out == told
    assert json.loads(numbers.read_text()) == {"rank": 1}
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert asked == [
        Scene.from_toml(scene),
        "momentum:3",
        {"masses": 0.02, "contact_constants": 0.0},
        1e-4,
    ]


def test_options_for_saved_runs_are_passed_on(
    scene: Path, answer: Trajectory, monkeypatch: Any, capsys: Any
):
    file = scene.parent / "run.nc"
    numbers = scene.parent / "n.json"
    answer.save(file)
    asked: list[Any] = []
    result = SimpleNamespace(
        table=lambda *chains: f"the table of {len(chains)} chains",
        to_json=lambda *chains: {"chains": len(chains)},
    )
    monkeypatch.setattr(
        "lmpchain.measure.dyson.sums", lambda run, m: asked.append((run.engine, list(m))) or result
    )

    def chains(*values, progress):
        asked.append((*values[1:], progress))
        return "mean", "error"

    monkeypatch.setattr("lmpchain.disorder.averages.at_the_end", chains)
    words = ["dyson", str(file), "--m", "1,5", "--json", str(numbers)]
    assert main([*words, "--realisations", "7", "--seed", "3"]) == 0
    assert capsys.readouterr().out == f"the table of 2 chains\nnumbers: {numbers}\n"
    assert json.loads(numbers.read_text()) == {"chains": 2}
    assert asked == [("native", [1, 5]), ([1, 5], 7, 3, False)]
    monkeypatch.setattr("lmpchain.measure.fit.overview.summary", lambda run: result)
    assert main(["fit", str(file), "--json", str(numbers)]) == 0
    assert capsys.readouterr().out == f"the table of 0 chains\nnumbers: {numbers}\n"
    assert json.loads(numbers.read_text()) == {"chains": 0}
    pages: list[Any] = []
    monkeypatch.setattr(
        "lmpchain.report.write", lambda *given, **named: pages.append((given, named))
    )
    assert main(["report", str(file)]) == 0
    page = file.with_suffix(".html")
    named = {"progress": False, "origin": origin(file), "overwrite": True}
    assert pages == [((answer, page), named)]
    assert capsys.readouterr().out == f"page: {page}\n"
    # A run that has just started has one sample.
    for samples, code in ((1, 2), (2, 0)):
        short = SimpleNamespace(time=answer.time[:samples])
        monkeypatch.setattr(Trajectory, "load", lambda _, short=short: short)
        assert main(["fit", str(file)]) == code
    assert "has too few samples so far" in capsys.readouterr().err


# Function, command line, positional arguments after the scene (S), and keywords.
QUIET = {"progress": False}
AVERAGES = "lmpchain.simulation.time_averages.averages"
DECK = "lmpchain.engines.lammps.export.write_deck"
CALLS: list[tuple[str, str, list[Any], dict[str, Any]]] = [
    (
        DECK,
        "deck s.toml -o deck --step 1e-8 --diameter gauge --integrator kahan-li6 --force "
        "--pair-style gran/hertz/history --template a --include b --tolerance 1e-3",
        ["S", Path("deck")],
        {
            "step": 1e-8, "diameter": "gauge", "integrator": "kahan-li6", "overwrite": True,
            "pair_style": "gran/hertz/history", "template": "a", "include": "b", "tolerance": 1e-3,
        },
    ),
    (
        DECK,
        "deck s.toml -o deck",
        ["S", Path("deck")],
        {
            "step": None, "diameter": "physical", "integrator": "verlet", "overwrite": False,
            "pair_style": "granular", "template": None, "include": None, "tolerance": 1e-6,
        },
    ),
    (
        AVERAGES,
        "averages s.toml --of b --time 2 --warm-up 0.5 --copies 3 --energy-tolerance 1e-3",
        ["S", ["b"]],
        {"time": 2.0, "warm_up": 0.5, "copies": 3, "tolerance": 1e-3} | QUIET,
    ),
    (
        AVERAGES,
        "averages s.toml --of b",
        ["S", ["b"]],
        {"time": None, "warm_up": None, "copies": 1, "tolerance": 1e-4} | QUIET,
    ),
    (
        "lmpchain.benchmark.own_run.check",
        "check run.dump --units real --scene s.toml",
        ["run.dump", "S"],
        {"units": "real"} | QUIET,
    ),
    ("lmpchain.benchmark.own_run.check", "check a.nc", ["a.nc", None], {"units": None} | QUIET),
    ("lmpchain.benchmark.own_run.check_deck", "check --deck d", ["d", None], QUIET),
    (
        "lmpchain.report.exploration.explore",
        "explore s.toml --over chain.gravity=1:9:2 --over chain.grains=3:5:3 -o page.html",
        [
            {
                "scene": "s.toml",
                "over": {"chain.gravity": [1, 9], "chain.grains": [3, 4, 5]},
                "tolerance": 1e-6,
            },
            Path("page.html"),
        ],
        {"overwrite": True} | QUIET,
    ),
    (
        "lmpchain.simulation.planner.plan",
        "plan s.toml --engine lammps --tolerance 1e-9",
        ["S", 1e-9, "lammps"],
        {},
    ),
]  # fmt: skip


@pytest.mark.parametrize(("name", "line", "values", "named"), CALLS)
def test_a_command_passes_on_its_options(
    name: str,
    line: str,
    values: list[Any],
    named: dict[str, Any],
    tmp_path: Path,
    monkeypatch: Any,
    capsys: Any,
):
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(SCENE)
    asked: list[Any] = []
    result = SimpleNamespace(table=lambda: "the table")

    def called(*given: Any, **keywords: Any) -> Any:
        asked.extend([*given, keywords])
        Path("page.html").write_text("x" * 1234)
        return result

    monkeypatch.setattr(name, called)
    assert main(line.split()) == 0
    scene = Scene.from_toml("s.toml")
    assert asked == [*(scene if value == "S" else value for value in values), named]
    assert capsys.readouterr().out == {
        "deck": "wrote deck/in.column and deck/column.data; to run them:\n"
        "  cd deck && lmp -in in.column\n",
        "explore": "page: page.html (6 runs, 0.0012 MB)\n",
    }.get(line.split()[0], "the table\n")


def test_a_check_compares_with_its_tolerance(scene: Path, monkeypatch: Any, capsys: Any):
    result = SimpleNamespace(table=lambda: "the table", exceeds=lambda tolerance: tolerance < 1e-3)
    result.to_json = lambda: {"error": 1e-3}
    monkeypatch.setattr("lmpchain.benchmark.own_run.check", lambda *_, **__: result)
    for words, code in (([], 0), (["--tolerance", "1e-3"], 0), (["--tolerance", "9e-4"], 1)):
        assert main(["check", "run.nc", *words]) == code
    assert main(["check", "run.nc", "--tolerance", "0"]) == 2
    assert capsys.readouterr().err.startswith("error: tolerance: ")
    assert main(["check", "run.nc", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"error": 1e-3}


def test_a_slider_is_read_from_its_range_number_and_scale():
    assert read_axis("chain.grains=10:40:4") == ("chain.grains", [10, 20, 30, 40])
    _, values = read_axis("chain.gravity=1.62:9.81")
    assert len(values) == 15
    assert values[7] == pytest.approx((1.62 + 9.81) / 2)
    key, values = read_axis("excitation.velocity=1e-6:1e-2:3:log")
    assert key == "excitation.velocity"
    assert values == pytest.approx([1e-6, 1e-4, 1e-2], rel=1e-12)
    for text, values in {
        "1:4": [1, 2, 3, 4],  # No integer appears twice.
        "1:1000:4:log": [1, 10, 100, 1000],
        "1:10:3:log": [1, 3, 10],
        "-1:+2:2": [-1, 2],
        "1:10:3": [1.0, 5.5, 10.0],
        "1.0:3:3": [1.0, 2.0, 3.0],
    }.items():
        assert [*map(repr, read_axis(f"a.b={text}")[1])] == [*map(repr, values)]
    for text, key, message in (
        ("=1:2", "over", "must be KEY=LOW:HIGH"),
        ("a", "over", "must be KEY=LOW:HIGH"),
        ("a=1", "over", "must be KEY=LOW:HIGH"),
        ("a=1:2:3:4", "over", "must be KEY=LOW:HIGH"),
        ("a=1:log", "over", "must be KEY=LOW:HIGH"),
        ("a=2:1", "a", "the range must ascend (got 2:1)"),
        ("a=2:2", "a", "the range must ascend (got 2:2)"),
        ("a=0:2:log", "a", "a range in equal ratios must begin above 0 (got 0)"),
        ("a=1:2:1", "a", "the number of runs must be 2 or more (got '1')"),
        ("a=1:2:2.5", "a", "the number of runs must be 2 or more (got '2.5')"),
        ("a=x:2", "a", "the ends of the range must be numbers (got 'x')"),
        ("a=1:inf", "a", "the ends of the range must be numbers (got 'inf')"),
    ):
        ((found, said),) = faults(read_axis, text)
        assert found == key
        assert said.startswith(message)


def test_files_and_grains_that_do_not_fit_a_command_are_rejected(
    answer: Trajectory, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    run, dump = str(tmp_path / "run.nc"), str(tmp_path / "run.lammpstrj")
    answer.save(run)
    Path(dump).write_text("ITEM: TIMESTEP\n0\n")
    for command, message in {
        ("fit", dump): "is a LAMMPS dump: give its scene as well, --scene SCENE.toml",
        ("fit", run, "--scene", str(scene)): "scene: is only for a LAMMPS dump, which",
        ("fit", run, "--axis", "x"): "axis: is only for a LAMMPS dump and its scene",
        ("fit", run, "--units", "si"): "units: is only for a LAMMPS dump and its scene",
        ("report", f"{run}x", "--scene", str(scene)): f"error: {run}x: ",
        ("sensitivity", dump, "--of", "momentum:3"): (
            f"error: {dump}: is a LAMMPS dump: give its scene, SCENE.toml, in its place"
        ),
        ("plan", "nowhere.toml"): "error: nowhere.toml: ",
        ("plan",): "scene: is missing; name a scene file, or use --calibrate alone",
        ("plan", "--calibrate", "--json"): "json: needs a scene file: name one",
        ("plan", str(scene), "--json", str(scene)): "is the input file: name another file",
        ("compare", str(scene), "-o", "-", "--json"): "-: names standard output twice",
        ("new", f"{run}.toml", "--from", dump, "--example", "dimer"): (
            "example: cannot be combined with --from: leave one of them out"
        ),
        ("new", f"{run}.toml", "--young", "1", "--units", "si"): (
            "young: is only for --from: leave it out error: units: is only for --from: leave it out"
        ),
        ("explore", str(scene), "-o", f"{run}.html", "--over", "a.b=1:2", "--over", "a.b=3:4"): (
            "a.b: has two sliders: name each key once"
        ),
        ("explore", str(scene), "-o", f"{run}.txt", "--over", "a", "--over", "b=2:1"): (
            f"{run}.txt: must end in .html or .htm error: over: must be KEY=LOW:HIGH"
        ),
        ("report", run, "-o", f"{run}.txt"): "must end in .html or .htm",
        ("export", run, "-o", f"{run}.png"): "must end in .csv or .txt",
        ("check",): "run: give either a dump or saved run, or --deck FOLDER",
        ("check", run, "--deck", str(tmp_path)): "run: give either a dump or saved run",
        ("check", "--deck", str(tmp_path), "--units", "si"): "units: is only for a LAMMPS dump",
        ("fit", run, "--json", run): "is the input file: name another file",
        ("export", run, "-o", "-", "--velocity", "1,wall"): (
            "velocity: must be numbers of grains, with commas between (got 'wall')"
        ),
        ("export", run, "-o", "-", "--contact-force", "floor"): (
            "contact-force: must be numbers of grains or wall, top, bottom, with commas"
        ),
        ("export", run, "-o", "-", "--velocity", "1", "--above-rest"): (
            "above-rest: is only for forces: add --contact-force, or leave it out"
        ),
    }.items():
        assert main([*command]) == 2
        assert message in " ".join(capsys.readouterr().err.split())
