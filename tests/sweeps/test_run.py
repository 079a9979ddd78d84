"""Executors of a sweep: parallel tasks, repetitions after faults, and messages."""

import errno
import logging
import os
import sys
import warnings
from concurrent.futures import BrokenExecutor, Future
from dataclasses import replace
from multiprocessing import current_process
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import pytest
from helpers.example_sweeps import SCENE
from helpers.faults import faults

from lmpchain import Chain, Impulse, InputError, RunFailed, Scene, engines, load_sweep, sweep
from lmpchain.engines.cost_model import TooLong, budget, in_words
from lmpchain.sweeps import run, store, tasks
from lmpchain.sweeps.file import read_sweep
from lmpchain.sweeps.results import find_recorded, make_labels
from lmpchain.sweeps.run import Here
from lmpchain.sweeps.tasks import count_scenes

GRAVITIES = [float(n) for n in range(1, 8)]
LONGER = {"recording": {"duration": 1e-4, "samples": 11}}
ASKED = {"scene": SCENE, "grid": {"chain.gravity": GRAVITIES}, "keep": ["wall_force"]}


@pytest.fixture
def in_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put two scenes into each task."""
    monkeypatch.setattr(tasks, "TASKS", tasks.TASKS._replace(scenes=2))


class Bar:
    """A stub that records the calls of a progress bar."""

    bars: ClassVar[list["Bar"]] = []

    def __init__(self, total: float, **options: Any):
        self.total = total
        self.options = options
        self.steps = []
        Bar.bars.append(self)

    def __enter__(self) -> "Bar":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def advance(self, amount: int) -> None:
        self.steps.append(amount)


class Faulty(Here):
    """A function that fails a given number of times at each task."""

    def __init__(self, failure: Exception, times: int):
        self.failure = failure
        self.times = times
        self.tried = []

    def submit(self, function: Any, /, *values: Any, **named: Any) -> Future:
        what = values[0].first if isinstance(values[0], tasks.SweepTask) else "gather"
        self.tried.append(what)
        if what != 2 or self.tried.count(2) > self.times:
            return super().submit(function, *values, **named)
        future: Future = Future()
        future.set_exception(self.failure)
        return future


@pytest.mark.usefixtures("in_pairs")
def test_a_task_is_tried_three_times_if_its_process_dies(tmp_path: Path):
    executor = Faulty(BrokenExecutor("dead"), 2)
    found = sweep(ASKED, tmp_path / "a", executor=executor)
    assert (found.reason == "").all()
    assert executor.tried.count(2) == 3
    assert executor.tried[-1] == "gather"
    executor = Faulty(BrokenExecutor("dead"), 3)
    with pytest.warns(UserWarning, match="some scenes could not be solved") as warned:
        found = sweep(ASKED, tmp_path / "b", executor=executor)
    died = "the process that solved it died 3 times"
    text = f"some scenes could not be solved this time; the first: {died}"
    assert [str(each.message) for each in warned] == [text]
    assert executor.tried.count(2) == 3
    assert "gather" not in executor.tried
    cause = f"not done: {died}"
    assert found.reason.values.tolist() == ["", "", cause, cause, "", "", ""]


@pytest.mark.usefixtures("in_pairs")
def test_faults_of_the_machine_are_reported_and_repeated_later(tmp_path: Path, monkeypatch: Any):
    monkeypatch.setattr(run, "ProgressBar", Bar)
    Bar.bars.clear()
    with pytest.warns(UserWarning, match="; the first: OSError full$"):
        sweep(ASKED, tmp_path, executor=Faulty(OSError("full"), 9), progress=True)
    (bar,) = Bar.bars
    assert (bar.total, bar.options) == (7, {"unit": " scenes", "done": 0, "shown": True})
    assert sorted(bar.steps) == [1, 2, 2, 2]
    executor = Faulty(OSError("full"), 0)
    assert (sweep(ASKED, tmp_path, executor=executor).reason == "").all()
    assert executor.tried == [2, "gather"]
    assert Bar.bars[1].options == {"unit": " scenes", "done": 5, "shown": False}
    assert Bar.bars[1].steps == [2]
    sweep(ASKED, tmp_path)
    assert Bar.bars[2].options["done"] == 7
    with pytest.warns(UserWarning, match="; the first: KeyError$"):
        sweep(ASKED, tmp_path / "b", executor=Faulty(KeyError(), 9))


@pytest.mark.usefixtures("in_pairs")
@pytest.mark.parametrize("most", [1, 3, 256])
def test_an_executor_has_a_limited_number_of_tasks(most: int, tmp_path: Path, monkeypatch: Any):
    counts: list[int] = []
    wait = run.wait

    def counted(pending: dict[Future, Any], **options: Any) -> Any:
        counts.append(len(pending))
        return wait(pending, **options)

    monkeypatch.setattr(run, "wait", counted)
    monkeypatch.setattr(run, "TASKS", run.TASKS._replace(pending=most))
    sweep(ASKED, tmp_path, executor=Here())
    assert max(counts) == min(most, 4)
    counts.clear()
    sweep(ASKED, tmp_path / "here")
    # In this process tasks are executed one after the other, so that Ctrl-C loses one at most.
    assert max(counts) == 1


@pytest.mark.parametrize("workers", [0, -1, True, 1.0, "2", None])
def test_workers_are_counted_from_1(workers: Any, tmp_path: Path):
    told = faults(sweep, ASKED, tmp_path, workers=workers)
    assert told == [("workers", f"must be a whole number from 1 (got {workers!r})")]


def test_executors_and_schedulers_of_other_types_are_rejected(tmp_path: Path):
    told = faults(sweep, ASKED, tmp_path, executor=5)
    assert told == [("executor", "must have a method submit (got 5)")]
    ((key, text),) = faults(sweep, ASKED, tmp_path, scheduler=5)
    assert key == "scheduler"
    assert text.startswith("no Dask scheduler answers at 5 (")
    ((key, text),) = faults(sweep, ASKED | {5: 1}, tmp_path)
    assert (key, text.partition(";")[0]) == ("5", "unknown key")


def test_warnings_are_given_once_for_all_scenes(tmp_path: Path):
    chain = SCENE["chain"] | {"diameter": 1.0}
    grid = {"excitation.velocity": [1e-4, 2e-4], "chain.diameter": [1.0, 2.0]}
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        sweep(ASKED | {"scene": SCENE | {"chain": chain}, "grid": grid}, tmp_path)
    remarks = [str(each.message) for each in warned if "wide for a grain" in str(each.message)]
    assert len(remarks) == 1
    assert remarks[0].startswith("diameter: 1 m is wide")
    assert remarks[0].endswith("; other scenes may be affected as well")


def test_small_scenes_share_a_task():
    """A task has at most 256 scenes, with 4 million numbers."""

    def scene(grains: int, samples: int) -> Scene:
        chain = Chain(grains=grains, diameter=1e-3)
        struck = Impulse(velocity=1e-9)
        return Scene(chain=chain, excitation=struck, duration=1e-9 * samples, samples=samples)

    assert count_scenes("native", scene(10, 11)) == 256
    for grains, samples in ((128, 256), (1000, 128), (1024, 4096), (1025, 4097), (2000, 5000)):
        one = scene(grains, samples)
        numbers = one.fine.samples * grains
        assert count_scenes("native", one) == max(1, min(256, 2**22 // numbers))
    assert count_scenes("lammps", scene(10, 11)) == 1


def test_dask_is_used_by_its_address(monkeypatch: pytest.MonkeyPatch):
    asked: list[Any] = []

    class Client:
        threads: ClassVar[dict[str, int]] = {"a": 1}

        def __init__(self, address: str, timeout: float):
            asked.append(address)
            assert timeout > 0

        def __enter__(self) -> "Client":
            return self

        def __exit__(self, *_: object) -> None:
            asked.append("closed")

        def nthreads(self) -> dict[str, int]:
            return self.threads

        def get_executor(self, pure: bool) -> str:
            return f"executor, pure {pure}"

    made = ModuleType("distributed")
    vars(made)["Client"] = Client
    monkeypatch.setitem(sys.modules, "distributed", made)
    loggers = [logging.getLogger(name) for name in ("distributed.worker", "tornado", "tornadoes")]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with run.dask("tcp://a:1") as executor:
            assert executor == "executor, pure False"
    # Exceptions report failures, so that these libraries need not write messages.
    quiet = [logger.getEffectiveLevel() == logging.CRITICAL for logger in loggers]
    assert quiet == [True, True, False]
    assert asked == ["tcp://a:1", "closed"]
    monkeypatch.setattr(Client, "threads", {})
    missing = "the scheduler has no workers yet; start some: dask worker tcp://a:1 --nthreads 1"
    with pytest.warns(UserWarning, match=missing), run.dask("tcp://a:1"):
        pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    cure = r'scheduler: requires Dask: pip install "lmpchain\[cluster\]"'
    with pytest.raises(InputError, match=cure), run.dask("tcp://a:1"):
        pass


def test_a_lost_scheduler_ends_the_sweep_and_keeps_its_results(tmp_path: Path) -> None:
    lost = Here()
    vars(lost)["_client"] = SimpleNamespace(status="closed")
    with pytest.raises(RunFailed, match="connection to the Dask scheduler is lost"):
        sweep(ASKED, tmp_path, executor=lost)
    assert (load_sweep(tmp_path).reason == "").all()
    vars(lost)["_client"].status = "running"
    assert (sweep(ASKED, tmp_path, executor=lost).reason == "").all()


def test_a_process_that_imports_the_script_of_its_parent_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python marks such a process; a sweep without processes is allowed there."""
    monkeypatch.setattr(current_process(), "_inheriting", True, raising=False)
    with pytest.raises(SystemExit):
        sweep(ASKED, tmp_path, workers=2)
    assert (sweep(ASKED, tmp_path, workers=1).reason == "").all()


def test_processes_that_cannot_start_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Processes cannot start without /dev/shm, which their semaphores need."""

    def refuse(*_: object, **__: object) -> None:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))

    monkeypatch.setattr("multiprocessing.synchronize.SemLock.__init__", refuse)
    cure = r"workers: processes cannot start here .*/dev/shm\?\): use --workers 1"
    with pytest.raises(InputError, match=cure):
        run.sweep(ASKED, tmp_path, workers=2)


def test_a_worker_without_access_to_the_folder_reports_it(tmp_path: Path):
    class Elsewhere(Here):
        """An executor on a machine where the folder does not exist."""

        def submit(self, function: Any, /, *values: Any, **named: Any) -> Any:
            if isinstance(values[0], tasks.SweepTask):
                values = (replace(values[0], folder=Path("/nowhere")), *values[1:])
            return super().submit(function, *values, **named)

    with pytest.warns(UserWarning, match="does not see the folder /nowhere: all machines must"):
        found = run.sweep(ASKED, tmp_path, executor=Elsewhere())
    assert "does not see the folder" in found["reason"].to_numpy()[0]
    with pytest.raises(InputError, match="cannot be combined with an executor"):
        run.sweep(ASKED, tmp_path, scheduler="tcp://a:1", executor=Here())


def test_a_folder_in_place_of_a_file_is_named(tmp_path: Path):
    run.sweep(ASKED, tmp_path)
    (file,) = tmp_path.glob("*/results.zarr/zarr.json")
    file.unlink()
    file.mkdir()
    with pytest.raises(InputError, match=r"is damaged .*: remove it, and sweep again"):
        run.sweep(ASKED, tmp_path)


@pytest.mark.usefixtures("in_pairs")
def test_the_expected_time_is_that_of_the_remaining_scenes(tmp_path: Path):
    engine = engines.Native()
    plan = read_sweep(ASKED)
    costs = [
        engine.propose(engine.part(scene), 1e-6).cost_s
        for scene in tasks.scenes(plan, 0, plan.count, together=False)
    ]
    few = ASKED | {"grid": {"chain.gravity": GRAVITIES[:4]}}
    sweep(few, tmp_path / "begun")
    for count, workers, folder in ((7, 1, "new"), (7, 4, "new"), (3, 1, "begun")):
        with budget(1e-9), pytest.raises(TooLong) as announced:
            sweep(ASKED, tmp_path / folder, workers=workers)
        text, _, time = str(announced.value).partition(" would take about ")
        assert text == f"{count} scenes by native for a tolerance of 1e-06"
        expected_s = count / 7 * sum(costs) / workers
        assert float(time.removesuffix(" s")) == pytest.approx(expected_s, rel=0.06)


def test_the_expected_time_of_many_scenes_is_extrapolated_from_some():
    """No more than 16 scenes at equal distances are priced, here every third one of 33."""
    engine = engines.Native()
    grid = {"chain.grains": [n * n for n in range(3, 36)]}
    plan = read_sweep(ASKED | {"grid": grid, "scene": SCENE | LONGER})
    made = [scene for scene in tasks.scenes(plan, 0, 33, False) if isinstance(scene, Scene)]
    costs = [engine.propose(engine.part(scene), 1e-6).cost_s for scene in made[::3]]
    with (
        budget(1e-9),
        pytest.raises(TooLong) as announced,
        tasks.announce_work(plan, made, 1000, 4),
    ):
        pass
    text, _, time = str(announced.value).partition(" would take about ")
    assert text == "1000 scenes by native for a tolerance of 1e-06"
    assert time == in_words(1000 / 4 * sum(costs) / 11)


# --- labels


def test_labels_cover_all_scenes():
    recording = {"recording.samples": [3, 5], "recording.grains": [[5, 2], [2, 3]]}
    recording["chain.grains"] = [6, 9]
    masses = {"seed": 1, "realisations": 2, "chain.masses": {"low": 1e-6, "high": 2e-6}}
    plan = read_sweep({"scene": SCENE, "list": recording, "disorder": masses})
    found = make_labels(plan)
    assert (found.samples, found.time, found.grains.tolist()) == (5, None, [2, 3, 5])
    assert found.extra["time"].shape == (5,)
    time = found.extra["time"]
    assert (time.units, time.long_name) == ("s", "time since the strike")
    assert found.extra["chain.masses"].shape == (9,)
    assert find_recorded(plan, (0, 1), 6).tolist() == [5, 2]
    assert find_recorded(plan, (1, 0), 9).tolist() == [2, 3]
    alike = make_labels(read_sweep(ASKED))
    assert (alike.samples, alike.grains.tolist()) == (3, [1, 2, 3, 4, 5, 6])
    assert alike.time is not None
    assert alike.time.tolist() == [0.0, 2.5e-6, 5e-6]
    assert not alike.extra
    # A chain of three grains has no grain 5, so its scene is not valid and contributes nothing.
    fewer = {"recording.grains": [[2, 5]], "chain.grains": [3, 6]}
    partly = make_labels(read_sweep({"scene": SCENE, "grid": fewer}))
    assert partly.grains.tolist() == [2, 5]
    walled = SCENE | {"chain": SCENE["chain"] | {"top": "wall"}}
    walled["recording"] = SCENE["recording"] | {"quantities": ["force:0"]}
    assert make_labels(read_sweep(ASKED | {"scene": walled})).grains.tolist() == [1, 2, 3, 4, 5, 6]
    later = make_labels(read_sweep(ASKED | {"grid": {"recording.duration": [5e-6, 6e-6]}}))
    assert later.extra["time"].shape == (3,)


# --- results of an earlier sweep


@pytest.mark.usefixtures("in_pairs")
def test_earlier_results_are_reused_at_any_position(tmp_path: Path, monkeypatch: Any):
    """Earlier results in several shards, and in parts, are reused."""
    monkeypatch.setattr(store, "STORE", store.STORE._replace(shard_scenes=1))
    few = ASKED | {"grid": {"chain.gravity": [3.0, 6.0, 1.0, 9.0, 2.0]}}
    first = sweep(few, tmp_path).load()
    solved: list[int] = []
    right = run.answer

    def answer(task: Any) -> None:
        solved.append(task.first)
        right(task)

    monkeypatch.setattr(run, "answer", answer)
    found = sweep(ASKED, tmp_path)
    anew = sweep(ASKED, tmp_path / "anew")
    assert found.load().identical(anew.load())
    assert solved == [2, 4, 6, 0, 2, 4, 6], "1 and 2 m/s² were known, the rest in halves at most"
    for gravity in (1.0, 2.0, 3.0, 6.0):
        assert found.sel({"chain.gravity": gravity}).equals(first.sel({"chain.gravity": gravity}))
    assert len(list(tmp_path.glob("*/results.zarr"))) == 2, "9 m/s² is in the first alone"
    other = ASKED | {"keep": ["peak_velocity"]}
    solved.clear()
    sweep(other, tmp_path)
    assert solved == [0, 2, 4, 6], "what was not kept is not known"
    # Results that cannot be read are left alone.
    earlier = tmp_path / read_sweep(few).name
    (earlier / "sweep.json").write_text("[1]")
    few["grid"]["chain.gravity"].append(7.0)
    assert (sweep(few, tmp_path).reason == "").all()
    assert (earlier / "results.zarr").exists()
