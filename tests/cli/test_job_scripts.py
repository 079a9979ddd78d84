"""Job scripts for PBS and for a Dask cluster, each run once with a stand-in for the queue."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.command_output import SCENE

from lmpchain import Trajectory, load_sweep, simulate
from lmpchain.scene.scene import Scene

TEMPLATES = Path(__file__).parents[2] / "templates"
# A cluster on this machine instead of a queue; it records the requested resources.
STAND_IN = """
from dask.distributed import LocalCluster

class SLURMCluster(LocalCluster):
    def __init__(self, cores, processes, memory, walltime):
        print("asked for", cores, processes, memory, walltime)
        super().__init__(n_workers=1, threads_per_worker=1, dashboard_address=None)

    def scale(self, jobs):
        # A cluster that is closed asks for none.
        if jobs:
            print("jobs", jobs)
        super().scale(min(jobs, 2))
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "scene.toml").write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def submitted(here: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run the script like PBS: in a different folder, with the variables of `qsub -v`."""
    elsewhere = here / "spool"
    elsewhere.mkdir(exist_ok=True)
    # `mpiexec` starts one process, whose engine is the native one, because LAMMPS is slow to start.
    (elsewhere / "mpiexec").write_text(
        '#!/bin/bash\nprintf "%s\\n" "$*" >> "$0.log"\n'
        f'shift; exec {sys.executable} -m lmpchain.cli "${{@/lammps/native}}"\n'
    )
    (elsewhere / "mpiexec").chmod(0o755)
    environment = os.environ | variables | {"PBS_O_WORKDIR": str(here)}
    environment["PATH"] = f"{elsewhere}:{os.environ['PATH']}"
    return subprocess.run(
        ["bash", str(TEMPLATES / "pbs.sh")],
        env=environment,
        cwd=elsewhere,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
def test_the_pbs_script_runs_and_resumes(here: Path):
    asked = {"scene": "scene.toml", "folder": "run", "options": "--tolerance 1e-7"}
    done = submitted(here, **asked)
    assert done.returncode == 0, done.stderr
    run = Trajectory.load(here / "run")
    assert run.error_estimate.total < 1e-7
    again = submitted(here, **asked, max_wall="0:10:00")
    assert "is finished; there is nothing left to do" in again.stdout
    assert (here / "spool" / "mpiexec.log").read_text().splitlines() == [
        "lmpchain run scene.toml -o run/ --engine lammps --max-wall 23:55:00 --tolerance 1e-7",
        "lmpchain resume run/ --max-wall 0:10:00",
    ]


def test_the_pbs_script_requires_qsub(here: Path):
    environment = {key: value for key, value in os.environ.items() if key != "PBS_O_WORKDIR"}
    done = subprocess.run(
        ["bash", str(TEMPLATES / "pbs.sh")],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "submit with qsub" in done.stderr


@pytest.mark.slow
def test_a_sweep_runs_on_a_cluster_of_dask(here: Path):
    (here / "dask_jobqueue.py").write_text(STAND_IN)
    (here / "sweep.toml").write_text(
        'scene = "scene.toml"\nkeep = ["peak_velocity"]\n[grid]\nchain.gravity = [1.62, 9.81]\n'
    )
    done = subprocess.run(
        [sys.executable, str(TEMPLATES / "dask_sweep.py"), "sweep.toml", "results"],
        env=os.environ | {"PYTHONPATH": str(here), "DASK_TEMPORARY_DIRECTORY": str(here)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "asked for 16 16 32GB 04:00:00",
        "jobs 10",
        "2 of 2 scenes are solved",
    ]
    peaks = load_sweep("results").peak_velocity.sel({"chain.gravity": 1.62})
    scene = Scene.from_toml("scene.toml")
    alone = simulate(scene.replace(chain=scene.chain.replace(gravity=1.62)), "native", 1e-9)
    # The strike itself is the largest velocity of grain 1.
    assert float(peaks[0]) == pytest.approx(8.57e-4)
    assert float(peaks[4]) >= abs(alone.velocity[:, 4]).max() * (1 - 1e-5)
