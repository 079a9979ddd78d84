"""A run folder: contents, lock, and reading during the run."""

import hashlib
import json
import os
import resource
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import xarray
from helpers.child_processes import COMMAND, at_work, finish, same, start, write
from helpers.example_chains import column
from helpers.example_scenes import paper, scene_of, struck
from helpers.faults import fault_keys
from helpers.independent_integrators import distance
from helpers.thinned import thinned

import lmpchain
from lmpchain import (
    Impulse,
    InputError,
    Profile,
    Scene,
    Stopped,
    Trajectory,
    engines,
    resume,
    simulate,
)
from lmpchain.cli.command_line import main
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.simulation.run_folder import status

SCENE = scene_of(column(30), Impulse(velocity=1e-4), 2e-4, 301, grains=[1, 30, 7])
LONG = scene_of(column(2000), Impulse(velocity=8.57e-3), 1.0, 10001)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished") / "run"
    simulate(SCENE, "native", 1e-9, folder=folder)
    return folder


def contents(folder: Path) -> dict[str, tuple[int, int]]:
    # Some versions of filelock touch the lock themselves.
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != ".lock")
    return {str(path): (path.stat().st_mtime_ns, path.stat().st_size) for path in files}


# --- contents


def test_a_folder_contains_the_same_data_as_a_file(finished: Path):
    answer = Trajectory.load(finished)
    plain = simulate(SCENE, "native", 1e-9)
    assert same(answer, plain)
    assert (answer.engine, answer.equation, answer.provenance) == (
        plain.engine,
        plain.equation,
        plain.provenance,
    )
    assert answer.cost.steps == plain.cost.steps
    said = status(finished)
    assert (said["state"], said["samples_done"], said["reason"]) == ("finished", 301, "")
    assert said["error_estimate"] == answer.error_estimate.total


def test_the_folder_alone_reproduces_the_run(tmp_path: Path):
    """Data that the scene file needs from other files are copied to the folder."""
    (tmp_path / "grains.csv").write_text("diameter,material\n" + "1e-3,steel\n1.1e-3,glass\n" * 5)
    (tmp_path / "profile.csv").write_text("velocity\n" + "1e-5\n" * 9 + "0\n")
    (tmp_path / "in.toml").write_text(
        '[chain]\nfile = "grains.csv"\n[excitation]\nkind = "profile"\nfile = "profile.csv"\n'
        "[recording]\nduration = 2e-5\nsamples = 21\n"
    )
    assert main(["run", f"{tmp_path}/in.toml", "-o", f"{tmp_path}/run/", "--engine", "native"]) == 0
    (tmp_path / "away").mkdir()
    shutil.copy(tmp_path / "run" / "scene.toml", tmp_path / "away")
    asked = json.loads((tmp_path / "run" / "run.json").read_text())
    again = simulate(
        Scene.from_toml(tmp_path / "away" / "scene.toml"),
        asked["engine"],
        asked["tolerance"],
        **asked["options"],
    )
    assert same(Trajectory.load(tmp_path / "run"), again)
    assert isinstance(again.scene.excitation, Profile)


def test_provenance(finished: Path):
    (only,) = json.loads((finished / "run.json").read_text())["sessions"]
    assert only["packages"]["numpy"] == np.__version__
    assert only["command"]
    assert only["host"] == os.uname().nodename
    sums = (finished / "SHA256SUMS").read_text().splitlines()
    listed = dict(reversed(line.split("  ", 1)) for line in sums)
    assert {
        "scene.toml",
        "run.json",
        "trajectory.zarr/zarr.json",
        "trajectory.zarr/velocity/c/0/0",
    } <= set(listed)
    for name, digest in listed.items():
        assert hashlib.sha256((finished / name).read_bytes()).hexdigest() == digest


@pytest.mark.parametrize("integrator", thinned(["verlet", "rkn6"], 2))
def test_the_deck_of_a_run_in_lammps(integrator: str, tmp_path: Path):
    """With velocity Verlet the deck is the run itself; otherwise it solves the same scene."""
    scene = paper("fig5 g", 11)
    engine = lmpchain.engines.Lammps(integrator=integrator, step=1e-7, diameter="physical")
    answer = simulate(scene, engine, folder=tmp_path / "run")
    shutil.copytree(tmp_path / "run" / "deck", tmp_path / "deck")
    lmp = Path(sys.executable).with_name("lmp")
    subprocess.run(
        [lmp, "-in", "in.column"], cwd=tmp_path / "deck", check=True, capture_output=True
    )
    dumped = Trajectory.from_dump(tmp_path / "deck" / "column.lammpstrj", scene)
    apart = np.abs(dumped.velocity - answer.velocity).max()
    assert (
        apart == 0 if integrator == "verlet" else 0 < apart < 1e-4 * np.abs(answer.velocity).max()
    )


@pytest.mark.parametrize("integrator", ["rkn6", pytest.param("verlet", marks=pytest.mark.slow)])
def test_the_log_of_lammps(integrator: str, tmp_path: Path):
    """Every session appends to the log; its size does not depend on the drifts of a splitting."""
    engine = lmpchain.engines.Lammps(integrator=integrator, step=1e-7, diameter="physical")
    scene = paper("fig5 g", 61)
    with pytest.raises(Stopped):
        simulate(scene, engine, folder=tmp_path / "run", max_wall=1e-9)
    first = (tmp_path / "run" / "log.lammps").read_text()
    answer = resume(tmp_path / "run", ranks=1)
    sessions = json.loads((tmp_path / "run" / "run.json").read_text())["sessions"]
    assert [session["ranks"] for session in sessions] == [1, 1]
    log = (tmp_path / "run" / "log.lammps").read_text()
    assert log.startswith(first)
    assert [text.count("read_data CPU") for text in (first, log)] == [1, 2]
    runs = log.count("Loop time")
    assert runs >= scene.samples if integrator == "verlet" else runs == 2
    simulate(scene, engine)
    assert (tmp_path / "run" / "log.lammps").read_text() == log, "an engine is not tied to a folder"
    assert same(answer, simulate(scene, engine))


def test_a_missed_tolerance_is_stored_and_repeated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    chain = column(12)
    strong = struck(chain, 0.05, 3e-3, 51)
    options = f"-o {tmp_path}/run/ --tolerance 1e-3 --engine native"
    assert main(["run", str(write(strong, tmp_path)), *options.split()]) == 1
    first = capsys.readouterr()
    assert "amplifies round-off" in first.err
    assert main(["resume", f"{tmp_path}/run"]) == 1
    # The warnings about the scene are not repeated.
    assert capsys.readouterr().err == first.err.splitlines(keepends=True)[-1]


# --- reading it


def test_a_lazy_trajectory_is_a_trajectory(finished: Path, tmp_path: Path):
    lazy = Trajectory.load(finished)
    assert lazy == Trajectory.load(finished)
    data = lazy.to_xarray()
    assert "values with dtype=float64]" in repr(data["velocity"]), "they are not read yet"
    lazy.save(tmp_path / "run.nc")
    assert Trajectory.load(tmp_path / "run.nc") == lazy
    assert data.identical(Trajectory.load(tmp_path / "run.nc").to_xarray())


def test_folders_without_a_run_are_rejected(tmp_path: Path):
    with pytest.raises(InputError, match="contains no run"):
        Trajectory.load(tmp_path)
    (tmp_path / "trajectory.zarr").mkdir()
    with pytest.raises(InputError, match="not a trajectory"):
        Trajectory.load(tmp_path)


@pytest.mark.slow
def test_reading_during_a_run_and_after_a_kill(tmp_path: Path):
    """xarray and `load` see only complete samples, correct ones, and increasingly many."""
    folder = tmp_path / "run"
    process = start(
        "run", write(LONG, tmp_path), "-o", f"{folder}/", "--engine", "native", "--step", "1e-6"
    )
    seen: list[int] = []
    try:
        at_work(folder, process)
        while len(set(seen)) < 4:
            data = xarray.open_zarr(folder / "trajectory.zarr", chunks=None)
            complete = int(np.isfinite(data["time"]).sum())
            assert np.array_equal(data["time"][:complete], LONG.time[:complete])
            assert np.isfinite(data["velocity"][:complete]).all()
            answer = Trajectory.load(folder)
            assert answer.displacement.shape[0] == answer.time.size >= complete
            assert np.isfinite(answer.displacement[-1]).all()
            seen.append(complete)
            assert process.poll() is None, "it ended too early"
        assert seen == sorted(seen)
    finally:
        process.kill()
        process.communicate()
    partial = Trajectory.load(folder)
    assert partial.time.size >= seen[-1]
    noted = json.loads((folder / "status.json").read_text())
    # The error of samples after the last checkpoint is unknown.
    assert partial.error_estimate.total in (np.inf, noted["error_estimate"])
    first = scene_of(LONG.chain, LONG.excitation, LONG.duration / 1000, 11)
    there = simulate(first, lmpchain.engines.Native(step=1e-6))
    assert np.allclose(partial.velocity[:11], there.velocity, rtol=0, atol=1e-12)
    assert noted["state"] == "running", "a kill leaves no time to say more"
    assert (status(folder)["state"], status(folder)["reason"]) == (
        "killed",
        "the process of the run was killed",
    )


# --- access


def test_resume_of_a_finished_run(finished: Path, capsys: pytest.CaptureFixture[str]):
    before = contents(finished)
    assert main(["resume", str(finished)]) == 0
    assert "this run is finished" in capsys.readouterr().out
    assert same(resume(finished), Trajectory.load(finished))
    assert contents(finished) == before


@pytest.mark.parametrize("word", ["run", "resume"])
def test_invalid_folders_are_rejected(
    word: str, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    scene = write(SCENE, tmp_path)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").touch()
    wanted = {
        "run": {
            f"{finished}/": "contains a run already: continue it, lmpchain resume",
            f"{finished}": "contains a run already",
            f"{tmp_path}/other": "is neither empty nor a run folder",
            f"{scene}/": "is a file",
            "/proc/none/": "cannot be made",
        },
        "resume": {
            f"{tmp_path}/other": "is not a run folder",
            f"{tmp_path}/none": "is not a run folder",
            f"{scene}": "is not a run folder",
        },
    }[word]
    for folder, why in wanted.items():
        assert (
            main(["resume", folder] if word == "resume" else ["run", str(scene), "-o", folder]) == 2
        )
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"error: {folder.rstrip('/')}")
        assert why in line
    assert os.listdir(tmp_path / "other") == ["file"]


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"engine": "native", "step": 1.0}, "step"),
        ({"engine": lmpchain.engines.Lammps(integrator="verlet", keep="kept")}, "keep"),
        ({"engine": "native", "max_wall": 0}, "max_wall"),
        ({"engine": "native", "tolerance": 7}, "tolerance"),
    ],
)
def test_wrong_input_leaves_no_folder(options: dict, key: str, tmp_path: Path):
    assert fault_keys(simulate, SCENE, folder=tmp_path / "run", **options) == [key]
    assert os.listdir(tmp_path) == []


def test_a_folder_without_a_run_can_be_used(tmp_path: Path):
    """Incomplete files of a killed process are removed."""
    parts = [
        tmp_path / "run" / ".run.node-1-01234567.partial.json",
        tmp_path / "run" / "trajectory.zarr" / "time" / "c" / f"0.{'a' * 32}.partial",
    ]
    parts[1].parent.mkdir(parents=True)
    for part in parts:
        part.touch()
    assert (
        main(["run", str(write(SCENE, tmp_path)), "-o", f"{tmp_path}/run", "--engine", "native"])
        == 0
    )
    assert status(tmp_path / "run")["state"] == "finished"
    assert not any(part.exists() for part in parts)


@pytest.mark.parametrize("said", ["Infinity", "NaN", "-1e999"])
def test_an_invalid_elapsed_time(said: str, tmp_path: Path):
    """An invalid elapsed time is ignored and does not end the run."""
    with pytest.raises(Stopped):
        simulate(SCENE, "native", folder=tmp_path, max_wall=1e-9)
    path = tmp_path / "status.json"
    path.write_text(
        json.dumps(json.loads(path.read_text()) | {"wall_s": 0}).replace(
            '"wall_s": 0', f'"wall_s": {said}'
        )
    )
    assert resume(tmp_path).velocity.shape == (301, 3)
    assert status(tmp_path)["wall_s"] > 0


def test_in_another_thread(tmp_path: Path):
    """A thread, such as a worker, cannot wait for signals."""
    worker = threading.Thread(target=lambda: simulate(SCENE, "native", folder=tmp_path / "run"))
    worker.start()
    worker.join()
    assert status(tmp_path / "run")["state"] == "finished"


# --- the disk


@pytest.mark.slow
@pytest.mark.parametrize("limit", [2_000, 150_000])
def test_a_full_disk(limit: int, tmp_path: Path):
    """No file may exceed the limit.

    One line, what is done is kept, and it goes on where there is room.
    """
    chain = column(100)
    scene = struck(chain, 8.57e-3, 2e-3, 2001)
    options = f"-o {tmp_path}/run/ --engine native --tolerance 1e-2"
    done = subprocess.run(
        [*COMMAND, "run", str(write(scene, tmp_path)), *options.split()],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
        check=False,
    )
    assert done.returncode == 1, done.stderr
    (line,) = done.stderr.splitlines()
    assert "cannot be written: File too large" in line
    assert f"lmpchain resume {tmp_path}/run" in line
    assert not list((tmp_path / "run").rglob("*.partial*"))
    assert same(resume(tmp_path / "run"), simulate(scene, "native", 1e-2))


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write anywhere")
def test_a_folder_without_write_permission(finished: Path, tmp_path: Path):
    folder = shutil.copytree(finished, tmp_path / "run")
    (folder / "status.json").write_text(
        (folder / "status.json").read_text().replace("finished", "stopped")
    )
    folder.chmod(0o555)
    code, said = finish("resume", folder)
    folder.chmod(0o755)
    assert code == 1
    assert "cannot be written: Permission denied" in said


@pytest.mark.soak
def test_memory_does_not_grow_with_the_samples(tmp_path: Path):
    """10^5 moving grains with 100 and 2,000 samples, which are 3.2 GB."""
    script = """
import resource, sys, lmpchain, numpy
samples = int(sys.argv[1])
chain = lmpchain.Chain(grains=100_000, diameter=1e-3)
speeds = numpy.append(numpy.random.default_rng(1).normal(0, 1e-3, 99_999), 0.0)
start = lmpchain.Profile(velocity=speeds)
duration = 2e-7 * (samples - 1)
scene = lmpchain.Scene(chain=chain, excitation=start, duration=duration, samples=samples)
lmpchain.simulate(scene, "native", 0.01, folder=sys.argv[2])
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""
    peaks = []
    for samples in (100, 2000):
        words = [sys.executable, "-c", script, str(samples), str(tmp_path / str(samples))]
        peaks.append(
            float(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
        )
    assert peaks[1] < 1000
    assert peaks[1] < peaks[0] + 60


def test_a_stopped_run_loads_with_its_current_estimate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The estimate refers to the existing samples, and covers their error.

    Later samples make it unknown.
    """
    monkeypatch.setattr(stepping_run, "BLOCK_S", 1e-9)  # Four samples per block.
    scene = scene_of(column(12), Impulse(velocity=1e-4), 6e-5, 61)
    truth = simulate(scene, "native", 1e-12)
    with pytest.raises(Stopped):
        simulate(scene, engines.Native(step=1e-6), folder=tmp_path / "run", max_wall=1e-9)
    for _ in range(3):
        with pytest.raises(Stopped):
            resume(tmp_path / "run", max_wall=1e-9)
        part = Trajectory.load(tmp_path / "run")
        done = part.time.size
        assert 1 < done < 61
        off = distance(part, (truth.displacement[:done], truth.velocity[:done]))
        assert off <= part.error_estimate.total < 100 * off
    about = json.loads((tmp_path / "run" / "trajectory.zarr" / "zarr.json").read_text())
    about["attributes"]["error_so_far"]["samples"] -= 1  # As if samples had been added since.
    (tmp_path / "run" / "trajectory.zarr" / "zarr.json").write_text(json.dumps(about))
    assert Trajectory.load(tmp_path / "run").error_estimate.total == np.inf
    whole = resume(tmp_path / "run")
    assert (
        whole.error_estimate.total
        == Trajectory.load(tmp_path / "run").error_estimate.total
        < np.inf
    )
