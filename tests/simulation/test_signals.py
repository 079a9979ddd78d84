"""Orderly stops: Ctrl-C, SIGTERM and the end of the allowed time."""

import os
import re
import signal
import subprocess
from pathlib import Path

import pytest
from helpers.child_processes import (
    COMMAND,
    at_work,
    ended,
    on_a_terminal,
    processes,
    start,
    until,
    write,
)
from helpers.example_scenes import scene_of

from lmpchain import Chain, Impulse, Stopped, Trajectory, simulate
from lmpchain.cli.command_line import main
from lmpchain.simulation.run_folder import status

ENDLESS = scene_of(Chain(grains=500, diameter=1e-3), Impulse(velocity=8.57e-3), 1.0, 20001)
# Many samples, so that a stop is quick on a busy machine.
OFTEN = ENDLESS.replace(samples=200_001)
VERLET = [
    "--engine",
    "lammps",
    "--integrator",
    "verlet",
    "--step",
    "1e-7",
    "--diameter",
    "physical",
]
NATIVE = ["--engine", "native", "--step", "1e-6"]
CASES = {
    "native": (NATIVE, 1),
    "lammps": (VERLET, 1),
    "two ranks": ([*VERLET, "--ranks", "2"], 1),
    "mpirun": (VERLET, 2),
}


@pytest.mark.parametrize(
    ("case", "number", "code"),
    [
        pytest.param("native", signal.SIGINT, 130, marks=pytest.mark.slow),
        pytest.param("two ranks", signal.SIGINT, 130, marks=pytest.mark.slow),
        pytest.param("native", signal.SIGTERM, 143, marks=pytest.mark.soak),
        pytest.param("lammps", signal.SIGINT, 130, marks=pytest.mark.soak),
        pytest.param("lammps", signal.SIGTERM, 143, marks=pytest.mark.soak),
        pytest.param("two ranks", signal.SIGTERM, 143, marks=pytest.mark.soak),
        pytest.param("mpirun", signal.SIGINT, 130, marks=pytest.mark.soak),
        pytest.param("mpirun", signal.SIGTERM, 143, marks=pytest.mark.soak),
    ],
)
def test_a_signal_stops_at_the_next_block(case: str, number: int, code: int, tmp_path: Path):
    folder = tmp_path / "run"
    mark = f"MARK={tmp_path}"
    options, ranks = CASES[case]
    environment = os.environ | {"MARK": str(tmp_path)}
    process = start(
        "run", write(OFTEN, tmp_path), "-o", f"{folder}/", *options, ranks=ranks, env=environment
    )
    try:
        at_work(folder, process)
        began = status(folder)["samples_done"]
        process.send_signal(number)
        ending, said = ended(process)
    finally:
        process.kill()
    assert ending == code, said
    assert f"continue with: lmpchain resume {folder}" in said
    assert "Traceback" not in said
    kept = status(folder)
    assert kept["state"] == "stopped"
    assert ("Ctrl-C" if number == signal.SIGINT else "SIGTERM") in kept["reason"]
    assert Trajectory.load(folder).time.size == kept["samples_done"] >= began > 0
    until(lambda: not processes(mark))  # No rank remains.
    again = start("resume", folder, ranks=ranks, env=environment)
    try:
        until(
            lambda: (
                again.poll() is not None or status(folder)["samples_done"] > kept["samples_done"]
            )
        )
        again.send_signal(number)
        assert ended(again)[0] == code
    finally:
        again.kill()
    assert status(folder)["samples_done"] > kept["samples_done"]


@pytest.mark.slow
def test_a_stop_waits_for_the_current_sample(tmp_path: Path):
    """If a sample takes many blocks, the stop occurs at its end, so that nothing is lost."""
    scene = ENDLESS.replace(samples=1001)
    folder = tmp_path / "run"
    process = start(
        "run", write(scene, tmp_path), "-o", f"{folder}/", "--engine", "native", "--step", "1e-7"
    )
    try:
        at_work(folder, process)
        process.send_signal(signal.SIGTERM)
        code, said = ended(process)
    finally:
        process.kill()
    assert code == 143, said
    kept = status(folder)
    assert Trajectory.load(folder).time.size == kept["samples_done"] > 0


@pytest.mark.slow
def test_a_signal_in_python_is_passed_on(tmp_path: Path):
    """The caller of `simulate` gets KeyboardInterrupt after all data are saved."""
    script = (
        "import lmpchain, sys\n"
        "try:\n"
        "    lmpchain.simulate(lmpchain.Scene.from_toml(sys.argv[1]), 'native', "
        "folder=sys.argv[2], step=1e-6)\n"
        "except KeyboardInterrupt:\n"
        "    print(lmpchain.simulation.run_folder.status(sys.argv[2])['state'])\n"
    ).replace("lmpchain, sys", "lmpchain, lmpchain.simulation.run_folder, sys")
    words = [COMMAND[0], "-c", script, str(write(ENDLESS, tmp_path)), str(tmp_path / "run")]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    at_work(tmp_path / "run", process)
    process.send_signal(signal.SIGINT)
    assert ended(process)[1] == "stopped\n"


def test_handlers_are_restored(tmp_path: Path):
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with pytest.raises(Stopped, match="stopped at the end of its time after"):
        simulate(ENDLESS, "native", folder=tmp_path / "run", step=1e-6, max_wall=1e-9)
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


@pytest.mark.slow
def test_max_wall_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    scene = write(ENDLESS, tmp_path)
    folder = tmp_path / "run"
    assert main(["run", str(scene), "-o", f"{folder}/", *NATIVE, "--max-wall", "0:00:01"]) == 75
    said = capsys.readouterr()
    assert said.out == ""
    assert re.fullmatch(
        r"stopped at the end of its time after \d+ of 20001 samples; continue with "
        rf"lmpchain resume {folder}/?\n",
        said.err,
    )
    assert status(folder)["state"] == "stopped"
    assert main(["resume", str(folder), "--max-wall", "0.5"]) == 75
    assert main(["run", str(scene), "-o", f"{tmp_path}/run.nc", *NATIVE, "--max-wall", "1"]) == 2


@pytest.mark.slow
def test_progress_on_a_terminal(tmp_path: Path):
    """The bar shows rate, remaining time and error, and nothing if stderr is not a terminal."""
    words = ["run", write(ENDLESS, tmp_path), "-o", f"{tmp_path}/run/"]
    with on_a_terminal(*COMMAND, *words, *NATIVE) as (_, read_until):
        read_until(r"native: +\d+% \|.*\| +[\d.]+ samples/s, [\d:]+ left, error \d")
