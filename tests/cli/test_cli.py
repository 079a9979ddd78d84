"""The command line from the user's side: printed text, written files, and exit codes."""

import json
import os
import re
import shlex
import signal
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from helpers.child_processes import COMMAND, PATIENCE, on_a_terminal
from helpers.command_output import SCENE, keys, names
from helpers.thinned import thinned

from lmpchain import (
    Chain,
    EngineUnavailable,
    Impulse,
    RunFailed,
    Scene,
    ToleranceNotMet,
    Trajectory,
    engines,
    simulate,
)
from lmpchain.cli.command_line import main
from lmpchain.cli.verbs import GROUPS, VERBS
from lmpchain.engines.cost_model import TooLong


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


# --- help


def test_without_a_command_the_grouped_help_is_shown(capsys: pytest.CaptureFixture[str]):
    assert main([]) == 2
    shown = capsys.readouterr()
    assert shown.err == ""
    assert main(["--help"]) == 0
    assert capsys.readouterr().out == shown.out
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(VERBS)
    for title, commands in GROUPS.items():
        group = shown.out.split(f"\n{title}:\n")[1].split("\n\n")[0]
        assert tuple(re.findall(r"^  (\w+)", group, re.MULTILINE)) == commands


def test_version(capsys: pytest.CaptureFixture[str]):
    assert main(["--version"]) == 0
    assert re.fullmatch(r"lmpchain \d+\.\d+\S*\n", capsys.readouterr().out)


@pytest.mark.parametrize(
    "arguments",
    [["walk"], ["run"], ["run", "a", "b"], ["run", "a", "--step", "long"], ["deck", "a"],
     ["run", "a", "--diameter", "huge"], ["compare", "a", "--colour"], ["run", "a", "--tol", "1"]],
)  # fmt: skip
def test_invalid_arguments(arguments: list[str], capsys: pytest.CaptureFixture[str]):
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert len(keys(said)) == 1
    assert "--help" in said.err


# --- run


def test_run(scene: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["run", str(scene)]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert names(scene.parent) == ["scene.nc", "scene.toml"]
    saved = Trajectory.load(scene.with_suffix(".nc"))
    direct = simulate(Scene.from_toml(scene), "native", 1e-6)
    assert saved.scene == direct.scene
    assert np.array_equal(saved.displacement, direct.displacement)
    assert np.array_equal(saved.velocity, direct.velocity)
    assert f"{saved.error_estimate.total:.2g}" in said.out


def test_run_with_every_option(scene: Path, tmp_path: Path):
    out = tmp_path / "there.nc"
    options = "--engine native --integrator verlet --step 1e-8 --tolerance 1e-3"
    assert main(["run", str(scene), "-o", str(out), *options.split()]) == 0
    saved = Trajectory.load(out)
    assert (saved.engine, saved.cost.integrator) == ("native", "verlet")
    assert saved.cost.step_s == pytest.approx(1e-8, rel=1e-12)
    assert names(tmp_path) == ["scene.toml", "there.nc"]


@pytest.mark.parametrize("diameter", ["physical", "gauge"])
def test_run_with_lammps(diameter: str, scene: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["run", str(scene), "--engine", "lammps", "--diameter", diameter]) == 0
    assert "lammps" in capsys.readouterr().out
    saved = Trajectory.load(scene.with_suffix(".nc"))
    assert saved.engine == "lammps"
    assert saved.provenance["diameter"] == diameter
    native = simulate(Scene.from_toml(scene), "native", 1e-10)
    assert np.abs(saved.velocity - native.velocity).max() <= 1e-6 * np.abs(native.velocity).max()


def test_a_run_replaces_a_run_folder_only_by_force(scene: Path, capsys: pytest.CaptureFixture[str]):
    folder = scene.parent / "run"
    run = ["run", str(scene), "-o", f"{folder}/", "--engine"]
    assert main([*run, "native"]) == 0
    said = (folder / "status.json").read_bytes()
    capsys.readouterr()
    assert main([*run, "modes"]) == 2
    assert "replace it with --force" in capsys.readouterr().err
    assert main([*run, "bessel", "--step", "1", "--force"]) == 2  # An invalid step.
    assert main(["resume", str(folder)]) == 0
    assert (folder / "status.json").read_bytes() == said
    assert main([*run, "modes", "--force"]) == 1  # Its tolerance is missed.
    assert Trajectory.load(folder).engine == "modes"
    (folder / "mine").touch()
    (folder / "run.json").unlink()
    capsys.readouterr()
    assert main([*run, "modes", "--force"]) == 2
    assert "neither empty nor a run folder" in capsys.readouterr().err
    assert (folder / "mine").exists()


@pytest.mark.parametrize(
    ("options", "key"),
    [
        (["--engine", "native", "--diameter", "gauge"], "diameter"),
        (["--diameter", "auto"], "diameter"),
        (["--engine", "abacus"], "engine"),
        (["--integrator", "euler"], "integrator"),
        (["--step", "0"], "step"),
        (["--step=-1e-8"], "step"),
        (["--step", "nan"], "step"),
        (["--step", "inf"], "step"),
        (["--step", "1e-3"], "step"),
        (["--tolerance", "0"], "tolerance"),
        (["--tolerance=-1e-6"], "tolerance"),
        (["--tolerance", "nan"], "tolerance"),
        (["--tolerance", "2"], "tolerance"),
    ],
)
def test_options_that_are_wrong(
    options: list[str], key: str, scene: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["run", str(scene), *options]) == 2
    assert keys(capsys.readouterr()) == [key]
    assert names(scene.parent) == ["scene.toml"]


def test_faults_of_scene_options_and_output_come_at_once(
    scene: Path, capsys: pytest.CaptureFixture[str]
):
    scene.write_text(
        SCENE.replace("grains = 20", "grains = 0").replace("samples = 11", "samples = 0")
    )
    arguments = ["run", str(scene), "-o", "none/run.nc", "--diameter", "gauge", "--tolerance", "7"]
    assert main(arguments) == 2
    assert set(keys(capsys.readouterr())) == {
        "chain.grains", "recording.samples", "none/run.nc", "diameter", "tolerance",
    }  # fmt: skip


def test_outputs_that_cannot_be_written_are_found_before_the_run(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def never(*_: Any, **__: Any) -> None:
        raise AssertionError("it ran")

    monkeypatch.setattr("lmpchain.simulation.api.simulate", never)
    folder = tmp_path / "folder"
    folder.mkdir()
    before = names(tmp_path)
    os.mkfifo(folder / "pipe")
    for output in (
        f"{folder}", f"{folder}/", f"{folder}/pipe", f"{tmp_path}/none/run.nc", f"{scene}",
    ):  # fmt: skip
        assert main(["run", str(scene), "-o", output]) == 2
        assert keys(capsys.readouterr()) == [output]
        assert main(["compare", str(scene), "--json", output]) == 2
        assert keys(capsys.readouterr()) == [output]
    # The output of `run` may be a run folder.
    assert main(["compare", str(scene), "--json", f"{tmp_path}/new/"]) == 2
    assert keys(capsys.readouterr()) == [f"{tmp_path}/new/"]
    assert main(["compare", str(scene), "-o", f"{tmp_path}/picture.txt"]) == 2
    assert ".png" in capsys.readouterr().err
    scene.with_suffix(".nc").mkdir()
    assert main(["run", str(scene)]) == 2
    assert keys(capsys.readouterr()) == [str(scene.with_suffix(".nc"))]
    assert names(tmp_path) == sorted([*before, "scene.nc"])


def test_a_missed_tolerance_preserves_the_file(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    answer = simulate(Scene.from_toml(scene), "native", 1e-3)

    def misses(*_: Any, **__: Any) -> None:
        raise ToleranceNotMet("the error is too large; ask for less", answer)

    monkeypatch.setattr("lmpchain.simulation.api.simulate", misses)
    assert main(["run", str(scene)]) == 1
    said = capsys.readouterr()
    assert said.err == "error: the error is too large; ask for less\n"
    assert "estimated error" in said.out
    assert Trajectory.load(scene.with_suffix(".nc")) == answer


def test_a_tolerance_known_to_be_unreachable(scene: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["run", str(scene), "--tolerance", "1e-17"]) == 1
    said = capsys.readouterr()
    assert said.err.startswith("error: ")
    assert len(said.err.splitlines()) == 1
    assert names(scene.parent) == ["scene.toml"]


@pytest.mark.parametrize(
    "failure", [RunFailed("it broke down\nat once"), EngineUnavailable("not here")]
)
def test_a_run_that_fails(
    failure: Exception,
    scene: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    def fails(*_: Any, **__: Any) -> None:
        raise failure

    monkeypatch.setattr("lmpchain.simulation.api.simulate", fails)
    assert main(["run", str(scene)]) == 1
    assert capsys.readouterr().err == f"error: {' '.join(str(failure).split())}\n"
    assert names(scene.parent) == ["scene.toml"]


def test_a_step_on_which_the_run_breaks_down(scene: Path, capsys: pytest.CaptureFixture[str]):
    scene.write_text(SCENE.replace("8.57e-4", "1.0").replace("20e-6", "200e-6"))
    assert main(["run", str(scene), "--integrator", "verlet", "--step", "2e-6"]) == 1
    assert "shorter step" in capsys.readouterr().err


def test_warnings_are_one_line(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    import warnings

    answer = simulate(Scene.from_toml(scene), "native", 1e-3)

    def warns(*_: Any, **__: Any) -> Trajectory:
        warnings.warn("the model is rough", stacklevel=2)
        return answer

    monkeypatch.setattr("lmpchain.simulation.api.simulate", warns)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert main(["run", str(scene)]) == 0
    assert capsys.readouterr().err == "warning: the model is rough\n"


# --- compare


def test_compare(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    picture = tmp_path / "c.png"
    numbers = tmp_path / "c.json"
    assert main(["compare", str(scene), "-o", str(picture), "--json", str(numbers)]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert "reference: Taylor series of order 32" in said.out
    rows = json.loads(numbers.read_text())["rows"]
    assert tuple(row["engine"] for row in rows) == engines.names()
    for row in rows:
        assert row["error"] <= (1e-6 if row["equation"] == 1 else 2)
        assert row["error"] == max(row["error_displacement"], row["error_velocity"])
        assert f"{row['error']:.2e}" in said.out
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert names(tmp_path) == ["c.json", "c.png", "scene.toml"]


def test_compare_loosens_the_tolerance_of_an_engine_above_the_budget(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
):
    """An engine that exceeds the budget at every tolerance is left out."""

    def tell(cost_s: float, work: str, *_: object) -> None:
        if "modes" in work or re.search("tolerance of 1e-0[56]$", work):
            raise TooLong(f"{work} would take about a year")

    monkeypatch.setattr("lmpchain.simulation.api.announce", tell)
    monkeypatch.setattr("lmpchain.simulation.api.is_long", lambda _: True)
    numbers = tmp_path / "c.json"
    options = ["--engines", "native,modes", "--json", str(numbers), "--budget", "7"]
    assert main(["compare", str(scene), *options]) == 0
    (row,) = json.loads(numbers.read_text())["rows"]
    assert row["engine"] == "native"
    said = " ".join(capsys.readouterr().out.split())
    assert "native: ran with a tolerance of 0.0001 and not 1e-06, because the run by" in said
    assert "modes: left out at any tolerance" in said
    assert "above the budget of 7 s; --budget SECONDS allows more" in said
    assert main(["compare", str(scene), "--engines", "modes"]) == 1
    assert main(["compare", str(scene), "--budget", "0"]) == 2


def test_compare_some_engines_without_files(scene: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["compare", str(scene), "--engines", "native, native,", "--tolerance", "1e-9"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines].count("native") == 1
    assert names(scene.parent) == ["scene.toml"]


@pytest.mark.slow
def test_the_predictable_part_of_a_chaotic_scene_is_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    chain = Chain(grains=12, diameter=1e-3, exponent=1.05)
    strong = Scene(chain=chain, excitation=Impulse(velocity=0.05), duration=4e-3, samples=201)
    path = tmp_path / "strong.toml"
    strong.to_toml(path)
    numbers = tmp_path / "c.json"
    options = ["--engines", "native,modes", "--json", str(numbers)]
    assert main(["compare", str(path), *options]) == 1
    said = capsys.readouterr().err
    assert "error: native: the error is estimated at" in said
    assert "amplifies round-off, which may exceed the tolerance at t = " in said
    native, modes = json.loads(numbers.read_text())["rows"]
    assert native["error"] <= 1e-6
    assert modes["error"] > 0.1


@pytest.mark.parametrize("words", ["native,abacus", "", ","])
def test_compare_with_unavailable_engines(
    words: str, scene: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["compare", str(scene), "--engines", words]) == 2
    assert keys(capsys.readouterr()) == ["engines"]


def test_a_refusal_of_an_engine_is_one_short_line(scene: Path, capsys: pytest.CaptureFixture[str]):
    pushed = SCENE.replace('kind = "impulse"', 'kind = "impulse"\ngrain = 3')
    assert pushed != SCENE
    scene.write_text(pushed)
    assert main(["plan", str(scene)]) == 0
    assert "bessel: needs an impulse on grain 1" in capsys.readouterr().out.splitlines()
    assert main(["compare", str(scene), "--engines", "native,bessel"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "left out: bessel: needs an impulse on grain 1"


def test_compare_leaves_out_an_engine_that_refuses(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    scene.write_text(SCENE.replace("diameter", "exponent = 2.0\ndiameter"))
    assert main(["compare", str(scene), "--json", str(tmp_path / "c.json")]) == 0
    assert "left out: lammps: " in capsys.readouterr().out
    rows = json.loads((tmp_path / "c.json").read_text())["rows"]
    assert tuple(row["engine"] for row in rows) == engines.names()[1:]
    assert [row["equation"] for row in rows] == [1, 3, 3, 4, 27]
    assert all(row["error"] / 3 < row["expected_error"] < 3 * row["error"] for row in rows[1:])
    assert main(["compare", str(scene), "--engines", "lammps"]) == 2
    assert keys(capsys.readouterr()) == ["exponent"]


def test_compare_with_an_engine_that_fails(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def simulated(what: Scene, engine: str, *_: Any, **__: Any) -> Trajectory:
        if engine == "lammps":
            raise EngineUnavailable("LAMMPS is not here")
        answer = simulate(what, "native", 1e-3)
        raise ToleranceNotMet("missed", answer)

    monkeypatch.setattr("lmpchain.simulation.api.simulate", simulated)
    numbers = tmp_path / "c.json"
    words = ["compare", str(scene), "--engines", "lammps,native", "--json", str(numbers)]
    assert main(words) == 1
    said = capsys.readouterr()
    assert said.err.splitlines() == ["error: lammps: LAMMPS is not here", "error: native: missed"]
    assert [row["engine"] for row in json.loads(numbers.read_text())["rows"]] == ["native"]
    assert main(["compare", str(scene), "--engines", "lammps"]) == 1


def test_compare_says_when_the_native_engine_is_the_reference(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr("lmpchain.benchmark.truth.LONGEST_S", 0.0)
    scene.write_text(SCENE.replace("samples = 11", "samples = 11\ngrains = [1, 3]"))
    assert main(["compare", str(scene), "--engines", "native"]) == 0
    out = capsys.readouterr().out
    assert "reference: the native engine at a tolerance of 1e-08" in out
    assert "Taylor" not in out


# --- deck


@pytest.mark.parametrize(
    "options", [[], ["--integrator", "kahan-li6"], ["--pair-style", "gran/hertz/history"]]
)
def test_deck(options: list[str], scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = tmp_path / "a deck"
    assert main(["deck", str(scene), "-o", str(folder), "--tolerance", "1e-4", *options]) == 0
    assert "lmp -in in.column" in capsys.readouterr().out
    assert names(folder) == ["column.data", "in.column"]


def test_decks_that_cannot_be_written(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["deck", str(scene), "-o", str(scene)]) == 2
    assert keys(capsys.readouterr()) == [str(scene)]
    assert scene.read_text() == SCENE
    for options, key in ((["--step", "0"], "step"), (["--tolerance", "nan"], "tolerance")):
        assert main(["deck", str(scene), "-o", f"{tmp_path}/deck", *options]) == 2
        assert keys(capsys.readouterr()) == [key]
    scene.write_text(SCENE.replace("diameter", "exponent = 2.0\ndiameter"))
    assert main(["deck", str(scene), "-o", f"{tmp_path}/deck"]) == 2
    assert keys(capsys.readouterr()) == ["exponent"]
    assert names(tmp_path) == ["scene.toml"]


# --- as a process


@pytest.mark.slow
def test_exit_codes_of_the_process(scene: Path):
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, check=False)

    done = run("run", str(scene))
    assert (done.returncode, done.stderr) == (0, "")  # Without a progress bar.
    missed = run("run", str(scene), "--tolerance", "1e-17", "--force")
    assert (missed.returncode, missed.stdout) == (1, "")
    wrong = run("run", str(scene.with_name("none.toml")))
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert "Traceback" not in missed.stderr + wrong.stderr


LONG = {
    "native": ("10.0", []),
    "lammps": ("1.0", ["--integrator", "verlet", "--step", "1e-7", "--diameter", "physical"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("engine", LONG)
@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_long_run_stops_at_once(engine: str, sent: int, code: int, scene: Path):
    duration, options = LONG[engine]
    scene.write_text(SCENE.replace("grains = 20", "grains = 2000").replace("20e-6", duration))
    with on_a_terminal(*COMMAND, "run", scene, "--engine", engine, *options) as (
        process,
        read_until,
    ):
        read_until(f"{engine}:")  # The progress bar.
        process.send_signal(sent)
        assert process.wait(PATIENCE) == code
        assert "Traceback" not in read_until("stopped by")
    assert names(scene.parent) == ["scene.toml"]


def test_from_another_thread(scene: Path):
    """Only the main thread may handle signals, but main works in any thread."""
    import threading

    codes: list[int] = []
    worker = threading.Thread(target=lambda: codes.append(main(["run", str(scene)])))
    worker.start()
    worker.join()
    assert codes == [0]


def test_accumulated_quantities_are_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "scene.toml"
    text = tomli_w.dumps(tomllib.loads(SCENE) | {
        "chain": {"grains": 20, "diameter": 1e-3},
        "recording": {
            "duration": 2e-5,
            "samples": 3,
            "quantities": ["peak_velocity", "arrival_time", "peak_force:3"],
        },
    })  # fmt: skip
    path.write_text(text)
    assert main(["run", str(path)]) == 0
    said = dict(re.split(r"  +", line, maxsplit=1) for line in capsys.readouterr().out.splitlines())
    found = Trajectory.load(path.with_suffix(".nc")).gathered
    force = found["peak_force:3"]
    error = found["peak_force:3_error"]
    assert said["peak_force:3"] == f"{force:.6g} N, off by {error:.2g} at most"
    arrived = np.isfinite(found["arrival_time"])
    assert 0 < arrived.sum() < 20
    assert f"s in {arrived.sum()} of 20 grains, off by" in said["arrival_time"]
    first, last = found["arrival_time"][arrived][[0, -1]]
    assert said["arrival_time"].startswith(f"{first:.6g} to {last:.6g} s")
    assert re.match(r"0 to \S+ m/s, off by", said["peak_velocity"])

    path.write_text(text.replace("2e-05", "1e-07").replace("peak_velocity", "peak_displacement"))
    assert main(["run", str(path), "--force"]) == 0
    assert re.search(r"arrival_time +nothing: no front has passed\n", capsys.readouterr().out)


# --- closed pipes, and values in error lines


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", [["run", "scene.toml", "--engine", "modes"], ["plan", "scene.toml"], ["--help"]]
)
def test_nothing_is_said_where_nobody_reads(words: list[str], tmp_path: Path):
    """A closed reader, such as `| head`, leads to the exit code of SIGPIPE without a message."""
    (tmp_path / "scene.toml").write_text(SCENE)
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as nobody:
        done = subprocess.run(
            [*COMMAND, *words], cwd=tmp_path, stdout=nobody, stderr=subprocess.PIPE, text=True
        )
    assert done.returncode == 141
    assert all(line.startswith("warning: ") for line in done.stderr.splitlines()), done.stderr
    assert (tmp_path / "scene.nc").exists() == (words[0] == "run")


@pytest.mark.slow
def test_a_full_disk_behind_stdout_is_an_error(tmp_path: Path):
    (tmp_path / "scene.toml").write_text(SCENE)
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*COMMAND, "plan", "scene.toml"],
            cwd=tmp_path,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert done.returncode == 1
    assert re.fullmatch(r"error: .*No space left on device\n", done.stderr)


@pytest.mark.slow
def test_closed_streams_are_allowed(tmp_path: Path):
    (tmp_path / "scene.toml").write_text(SCENE)
    command = f"{shlex.join(COMMAND)} run scene.toml --engine modes --tolerance 0.5 >&- 2>&-"
    assert subprocess.run(command, shell=True, cwd=tmp_path).returncode == 0
    assert (tmp_path / "scene.nc").exists()


@pytest.mark.parametrize(
    "key", thinned(["gravity", "top", "diameter", "g" * 10**5, "grains", "material", "impurity"], 3)
)
def test_error_lines_show_the_beginning_of_long_values(
    key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for value in ("x" * 10**5, ["y"] * 10**4, {"z" * 10**4: 1}, [[[0.5] * 10**4]]):
        tables = tomllib.loads(SCENE)
        tables["chain"][key] = value
        (tmp_path / "scene.toml").write_text(tomli_w.dumps(tables))
        assert main(["run", str(tmp_path / "scene.toml")]) == 2
        said = capsys.readouterr().err
        for line in said.splitlines():
            # The list of keys is not shortened.
            message, _, _ = line.partition("; the keys here are")
            assert message.startswith("error: ")
            assert len(message) < 300, said[:1000]


@pytest.mark.parametrize(
    "option", ["--engine", "--tolerance", "--integrator", "--step", "--ranks", "--max-wall"]
)
def test_error_lines_show_the_beginning_of_long_options(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "scene.toml").write_text(SCENE)
    assert main(["run", str(tmp_path / "scene.toml"), option, "9x" * 10**4]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert len(line) < 300
