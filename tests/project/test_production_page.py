"""Every command of the page on production, executed in order and unchanged.

The launchers of a cluster are stood in for by scripts that start real ranks; Dask is real. A
command beside which the page says "press Ctrl-C" is really stopped, and "exit code N" is what it
must end with.
"""

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.child_processes import PATIENCE, at_work, same, until
from helpers.example_scenes import scene_of, stirred

from lmpchain import Chain, Impulse, Scene, Trajectory, load_sweep, simulate
from lmpchain.simulation.run_folder import status
from lmpchain.util import mpi

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "production.md").read_text(encoding="utf-8")
COMMANDS = "".join(re.findall(r"^```sh\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)).splitlines()
# Two cores are enough, so that runs to be stopped last.
CORES = sorted(os.sched_getaffinity(0))[:2]
PROGRAMS = "lmpchain|mpiexec|mpirun|srun|sbatch|dask"

STRIKE = Impulse(velocity=1e-5)
LONG = Chain(grains=4000, diameter=1e-3)
SHORT = Scene(chain=Chain(grains=30, diameter=1e-3), excitation=STRIKE, duration=4e-5, samples=101)
# The page stops this run, so the run must be long. Its steps are slow, because ranks synchronise at
# each step.
MOVING = scene_of(LONG, stirred(LONG, 1e-5), 4e-4, 1801, grains=range(1, 101))
LASTING = {
    "-o run/": MOVING,
    "job/": MOVING,
    "sweep.toml": scene_of(Chain(grains=60, diameter=1e-3), STRIKE, 1e-4, 3001),
}

STANDING_IN = {
    "mpiexec": f'exec {mpi.launcher()} "$@"',
    # A job that requests the cores of one task starts one process.
    "srun": '[ "$1" != -n ] || { SLURM_NTASKS=$2; shift 2; }; '
    '[ -z "$SLURM_CPUS_PER_TASK" ] || exec "$@"; exec mpiexec -n "$SLURM_NTASKS" "$@"',
    "date": "echo 1000000",  # The remaining time of a job is then certain.
    # The first job has one second more than the job script reserves; the others have enough time.
    "sbatch": """
export SLURM_NTASKS=2 SLURM_JOB_END_TIME=$([ -e jobs ] && echo 1000900 || echo 1000301)
tasks=
for option; do case $option in
--array=*) tasks=$(seq -s " " "${option#--array=1-}"); shift;;
--cpus-per-task=*) export SLURM_CPUS_PER_TASK="${option#*=}"; shift;;
--*) shift;;
*) break;;
esac; done
for task in ${tasks:-none}; do
[ "$task" = none ] || export SLURM_ARRAY_TASK_ID=$task
code=0; bash "$@" || code=$?
echo $code >> jobs
done""",
}


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to a folder in which the page can be followed."""
    (tmp_path / "bin").mkdir()
    for name, text in STANDING_IN.items():
        (tmp_path / "bin" / name).write_text(f"#!/bin/bash\n{text}\n")
        (tmp_path / "bin" / name).chmod(0o755)
    monkeypatch.setenv(
        "PATH", f"{tmp_path / 'bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    )
    monkeypatch.setenv("DASK_TEMPORARY_DIRECTORY", str(tmp_path))
    (tmp_path / "templates").symlink_to(ROOT / "templates")
    (sweep,) = re.findall(r"^```toml\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    (tmp_path / "sweep.toml").write_text(sweep)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def begun(command: str, process: subprocess.Popen[str]) -> None:
    """Wait until a command has stored something."""
    folder = Path(re.search(r"-o (\S+)", command)[1])
    if " run " in command:
        at_work(folder, process)
    else:
        until(
            lambda: (
                any(folder.glob("*/parts/[0-9]*")) or any(folder.glob("*/results.zarr/reason/c/*"))
            )
        )


@pytest.mark.slow
def test_every_command_of_the_page(here: Path):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    behind: list[subprocess.Popen[str]] = []
    try:
        for line in COMMANDS:
            next((s for key, s in LASTING.items() if key in line), SHORT).to_toml(
                here / "scene.toml"
            )
            command, _, remark = line.replace("8786", port).partition("  # ")
            process = subprocess.Popen(
                ["bash", "-c", command.rstrip(" &")],
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
                preexec_fn=lambda: os.sched_setaffinity(0, CORES),
            )
            behind.append(process)
            if command.endswith("&"):
                continue
            wanted = int((re.search(r"exit code (\d+)", remark) or [0, 0])[1])
            if "press Ctrl-C" in remark:
                wanted = 130
                begun(command, process)
                os.killpg(process.pid, signal.SIGINT)
            said, _ = process.communicate(timeout=PATIENCE)
            assert process.returncode == wanted, f"{line}\n{said}"
            assert "Traceback" not in said, f"{line}\n{said}"
            assert "nothing unfinished was kept" not in said, f"{line}\n{said}"
    finally:
        for process in behind:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)
                process.communicate(timeout=PATIENCE)

    for names, scene in ((("run", "job"), MOVING), (("other",), SHORT)):
        undisturbed = simulate(scene, "lammps")
        for name in names:
            assert status(name)["state"] == "finished"
            answer = Trajectory.load(name)
            assert same(answer, undisturbed), name
            assert answer.cost.ranks == 2
    assert (here / "jobs").read_text().split() == ["75", "0", "0", "0", "0", "0"], (
        "the first job was stopped, the next went on"
    )
    one, other, queued = (
        {
            str(p.relative_to(here / name)): p.read_bytes()
            for p in (here / name).rglob("*")
            if p.is_file()
        }
        for name in ("sweep", "again", "queued")
    )
    assert len(one) > 10
    assert one == other == queued
    assert same(Trajectory.load("runs/one.nc"), Trajectory.load("runs/two.nc"))
    found = load_sweep("sweep")
    assert (found.reason == "").all()
    assert found.peak_velocity.dims == ("chain.gravity", "disorder.m", "realisation", "grain")
    assert np.isfinite(found.peak_velocity).all()


def test_every_line_of_the_page_is_executed():
    """Text between the lines is executed as well, and every kind of command occurs."""
    assert set(re.findall(r"^```(\w+)$", PAGE, re.MULTILINE)) == {"python", "sh", "toml"}
    assert "+SKIP" not in PAGE, "the examples in Python are run by test_pages"
    for command in re.findall(rf"`((?:{PROGRAMS}) [^`]+)`", PAGE):
        assert any(command in line for line in COMMANDS), command
    for program in (
        "lmpchain run",
        "lmpchain resume",
        "lmpchain sweep",
        "mpiexec",
        "srun",
        "sbatch",
        "dask",
    ):
        assert any(program in line for line in COMMANDS), program
