"""Messages and files of `simulate`, `resume` and `simulate_many`.

Warnings, files of a folder, costs of a batch.
"""

import hashlib
import itertools
import json
import math
import mmap
import re
import signal
import time
import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from filelock import FileLock

import lmpchain
from lmpchain import (
    Chain,
    Impulse,
    InputError,
    Profile,
    Scene,
    Stopped,
    ToleranceNotMet,
    engines,
    resume,
    simulate,
    simulate_many,
)
from lmpchain.engines import Native, step_control
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.simulation import api, folder_files, many, run_folder
from lmpchain.simulation.folder_files import (
    check_new,
    load_checkpoints,
    order_hash,
    remove,
    renew,
    resume_command,
    save_checkpoint,
    write_order,
)
from lmpchain.simulation.run_folder import Requests, status
from lmpchain.util import progress
from lmpchain.util.files import sealed_json

CHAIN = Chain(grains=12, diameter=1e-3)
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=1e-4), duration=6e-5, samples=61)


@pytest.fixture
def small_blocks(monkeypatch):
    """Make blocks of four samples."""
    monkeypatch.setattr(stepping_run, "BLOCK_S", 1e-9)


def stopped(folder, scene=SCENE, engine="native", tolerance=1e-6):
    with pytest.raises(Stopped) as stop:
        simulate(scene, engine, tolerance, folder=folder, max_wall=1e-9)
    return str(stop.value)


# --- messages


@pytest.mark.parametrize("velocity", [3e-5, 1e-2])
def test_a_warning_states_the_model_error(velocity):
    scene = SCENE.replace(excitation=Impulse(velocity=velocity))
    with pytest.warns(UserWarning, match=r"^Eq\. \(3\)") as said:
        t = simulate(scene, "chebyshev", 1e-3)
    model = t.error_estimate.model
    words = str(said[0].message)
    assert words.startswith(f"Eq. (3) leaves out about {model:.2g} of the solution")
    assert ", more than 0.001" in words
    assert said[0].filename == __file__
    if model < 1:
        most = float(words.split("(at most ")[1].split(")")[0])
        assert model < most <= 1
    else:
        assert words.endswith("opens")


def test_no_warning_for_a_model_error_within_the_tolerance():
    with warnings.catch_warnings(action="error"):
        t = simulate(SCENE.replace(excitation=Impulse(velocity=1e-9)), "chebyshev", 1e-3)
    assert 0 < t.error_estimate.model < 1e-3


def test_a_missed_tolerance_contains_the_trajectory():
    chain = Chain(grains=12, diameter=1e-3)
    chaotic = Scene(chain=chain, excitation=Impulse(velocity=0.05), duration=3e-3, samples=5)
    with pytest.raises(
        ToleranceNotMet, match=r"amplifies round-off(.|\n)*lmpchain\.averages"
    ) as missed:
        simulate(chaotic, "native", 1e-6)
    assert missed.value.trajectory.error_estimate.total > 1e-6
    with pytest.raises(ToleranceNotMet) as early:
        simulate(SCENE, "native", 1e-16)
    assert early.value.trajectory is None
    with pytest.warns(UserWarning, match="round-off alone may make") as said:
        best = simulate(SCENE, "native", 1e-16, on_miss="warn")
    assert said[0].filename == __file__
    assert best.error_estimate.total < 1e-11


def test_a_long_run_states_what_takes_less(monkeypatch):
    """A tenth of the accuracy costs less by the order of the method; other engines cost half."""

    class Begun(Exception):
        """The error is raised when the run begins."""

    def begin(*_):
        raise Begun

    monkeypatch.setattr(engines.Native, "start", begin)
    chain = Chain(grains=10_000, diameter=1e-3, gravity=0.0, top_load=1.0)
    long = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=1.0)
    weak = Scene(
        chain=chain.replace(grains=50),
        excitation=Impulse(velocity=1e-9),
        duration=300.0,
        samples=11,
    )
    for scene, engine, tolerance, order, others in (
        (long, Native(), 1e-6, 6, ""),
        (long, Native("verlet"), 1e-3, 2, "native"),
        (long, Native(), 0.2, 0, ""),
        (weak, Native(), 1e-3, 6, "modes"),
    ):
        with pytest.warns(UserWarning, match="takes about") as warned, pytest.raises(Begun):
            simulate(scene, engine, tolerance)
        (text,) = [str(each.message) for each in warned if "takes about" in str(each.message)]
        assert f"tolerance of {tolerance:g} takes about " in text
        assert (f"tolerance of {10 * tolerance:g} (about " in text) == (order > 0)
        first, *rest = (
            float(number) * {"minutes": 60, "s": 1, "hours": 3600}[unit]
            for number, unit in re.findall(r"about ([0-9.]+) (minutes|hours|s)\b", text)
        )
        expected_s = engine.propose(engine.part(scene), tolerance).cost_s
        assert first == pytest.approx(expected_s, rel=0.06)
        if order:
            assert first / rest[0] == pytest.approx(10 ** (1 / order), rel=0.06)
        assert ("the engine" in text) == bool(others)
        if others:
            assert f"the engine {others} (about" in text
            assert rest[-1] < first / 2
    longer = "duration, a longer step takes less"
    with pytest.warns(UserWarning, match=longer), pytest.raises(Begun):
        simulate(long, Native(step=1e-8))


def test_invalid_options():
    for wrong in ("ignore", None, 3, np.array(["raise", "warn"])):
        with pytest.raises(InputError, match='on_miss: must be "raise" or "warn"'):
            simulate(SCENE, on_miss=wrong)
    with pytest.raises(InputError, match="max_wall: requires a run folder"):
        simulate(SCENE, max_wall=1.0)
    for name in (["native"], {}, 3, "nativ"):
        for ask in (simulate, lambda scene, name: lmpchain.plan(scene, 1e-6, name)):
            with pytest.raises(InputError, match=r"engine: must be .*native"):
                ask(SCENE, name)
    for wall in (0, -1.0, "1", True, math.nan):
        with pytest.raises(InputError, match="max_wall: must be a time above 0 s"):
            Requests(wall)
    assert Requests(None).reason == ""
    assert Requests(np.int64(10**6)).reason == ""
    with pytest.raises(InputError, match="tolerance"):
        simulate(SCENE, tolerance=1.0)


def test_a_result_larger_than_memory_states_its_size(monkeypatch, small_blocks):
    def full(*_):
        raise MemoryError

    monkeypatch.setattr(mmap, "mmap", full)
    scene = SCENE.replace(grains=range(1, 5001), chain=CHAIN.replace(grains=10_000))
    with pytest.raises(InputError, match=r"samples: 0\.00488 GB of samples do not fit into .* GB"):
        simulate(scene, "native")


def test_a_run_that_exceeds_the_memory_does_not_start(monkeypatch):
    monkeypatch.setattr(api, "free_memory", lambda: 1e3)
    monkeypatch.setattr(api, "LARGE_BYTES", 0)
    with pytest.raises(InputError, match="do not fit into 1e-06 GB of free memory: record fewer"):
        simulate(SCENE, "native")


def test_columns_beyond_the_wave_take_no_memory(small_blocks):
    """The condition is that fewer than half of many columns are written."""
    wide, narrow = (SCENE.replace(chain=CHAIN.replace(grains=n)) for n in (10_000, 200))
    moves = np.zeros(10_000)
    moves[[0, 5_000]] = 1e-4
    fast = wide.replace(excitation=Profile(velocity=moves))
    answers = [simulate(scene, "native") for scene in (wide, narrow, fast)]
    assert [t.velocity.shape for t in answers] == [(61, 10_000), (61, 200), (61, 10_000)]
    assert [t.velocity.flags.owndata for t in answers] == [False, True, True]
    assert np.array_equal(answers[0].velocity[:, :200], answers[1].velocity)
    assert not answers[0].velocity[:, 200:].any()


def test_the_progress_bar_shows_progress_and_error(monkeypatch, small_blocks):
    class Bar(progress.ProgressBar):
        reached, remarks, made = [], [], []

        def __init__(self, total, text="", unit="", **how):
            self.made.append((total, text, unit, how["done"]))
            super().__init__(total, text, unit, shown=False)

        def reach(self, done):
            self.reached.append(done)

        def remark(self, words):
            self.remarks.append(words)

    monkeypatch.setattr(api, "ProgressBar", Bar)
    monkeypatch.setattr(api, "ESTIMATE_S", 0.0)
    t = simulate(SCENE, "native", 1e-6, progress=True)
    assert Bar.made == [(61, "native", " samples", 0)]
    assert Bar.reached == sorted(Bar.reached)
    assert Bar.reached[-1] == 61
    assert 4 <= Bar.reached[0] < 20
    assert Bar.remarks[-1] == f"error {t.error_estimate.total:.1g}"
    Bar.remarks.clear()
    monkeypatch.setattr(api, "ESTIMATE_S", 1e9)
    Bar.reached.clear()
    # The bar also moves between two samples.
    simulate(SCENE.replace(samples=2, quantities=["peak_velocity"]), "native", progress=True)
    assert Bar.remarks == []
    assert Bar.reached == sorted(Bar.reached)
    assert any(1 < done < 2 for done in Bar.reached)


# --- run folders


def test_the_status_of_a_stopped_run(tmp_path, small_blocks):
    folder = tmp_path / "run"
    words = stopped(folder)
    kept = status(folder)
    done = kept["samples_done"]
    assert 0 < done < 61
    assert words == (
        f"stopped at the end of its time after {done} of 61 samples; continue with lmpchain resume "
        f"{folder}"
    )
    assert kept["reason"] == words
    assert (kept["state"], kept["samples"], kept["attempt"], kept["tolerance"]) == (
        "stopped",
        61,
        1,
        1e-6,
    )
    assert kept["best_effort"] is False
    assert kept["step_s"] == Native().propose(SCENE, 1e-6).step
    assert kept["error_estimate"] == lmpchain.Trajectory.load(folder).error_estimate.total
    assert kept["pid"] > 0
    first_s = kept["wall_s"]
    assert 0 < first_s < 100
    with pytest.raises(InputError, match="contains a run already: continue it with"):
        simulate(SCENE, "native", folder=folder)
    with pytest.raises(InputError, match="ranks: the engine native runs on one rank"):
        resume(folder, ranks=2)
    t = resume(folder)
    assert status(folder)["wall_s"] > first_s
    assert (status(folder)["state"], status(folder)["reason"], status(folder)["samples_done"]) == (
        "finished",
        "",
        61,
    )
    assert t.cost.steps == simulate(SCENE, "native", 1e-6).cost.steps


def test_both_checkpoints_belong_to_a_new_attempt(tmp_path, small_blocks):
    """No checkpoint of the previous attempt remains, because its samples are removed.

    After a second fault the right one goes on.
    """
    folder, engine = tmp_path / "run", Native(adaptive=False)
    scene = SCENE.replace(excitation=Impulse(velocity=8.57e-3), samples=21)
    stopped(folder, scene, engine, 1e-5)
    while status(folder)["attempt"] < 2:
        with pytest.raises(Stopped):
            resume(folder, max_wall=1e-9)
    kept = list(load_checkpoints(folder))
    assert [len(notes["attempt"]["truncations"]) for notes, _ in kept] == [1, 1]
    assert [notes["samples"] for notes, _ in kept] == [status(folder)["samples_done"], 0]
    assert kept[1][1] == {}
    assert [kept[1][0]["spent"][key] for key in run_folder.SPENT] == [0.0, 0.0, 0.0]
    # The hash is right, but the content is not a checkpoint.
    (folder / "checkpoint").write_bytes(hashlib.sha256(b"nothing").digest() + b"nothing")
    assert [checkpoint is None for checkpoint in load_checkpoints(folder)] == [True, False]
    (folder / "checkpoint").write_bytes(b"nothing")
    with pytest.warns(UserWarning, match="damaged; going on from the one before, at sample 0"):
        t = resume(folder)
    assert np.array_equal(t.velocity, simulate(scene, engine, 1e-5).velocity)
    assert t.cost.steps == simulate(scene, engine, 1e-5).cost.steps


def test_the_interval_of_checkpoints(tmp_path, monkeypatch, small_blocks):
    """The interval is at least a second, and checkpoints take a hundredth of the time.

    By a clock that this test sets.
    """
    now, saved = [0.0], []
    honest = save_checkpoint

    def save(folder, notes, state):
        now[0] += 0.05
        if state:
            saved.append((now[0], notes["samples"]))
        honest(folder, notes, state)

    class Clock:
        @staticmethod
        def monotonic():
            return now[0]

    monkeypatch.setattr(run_folder, "time", Clock)
    monkeypatch.setattr(folder_files, "save_checkpoint", save)
    honest_put = run_folder.store.Writer.put

    def put(self, block):
        now[0] += 0.5
        return honest_put(self, block)

    monkeypatch.setattr(run_folder.store.Writer, "put", put)
    simulate(SCENE, "native", 1e-6, folder=tmp_path / "run")
    moments = [moment for moment, _ in saved]
    # Two checkpoints are written at the beginning, and the next one after a second.
    assert moments[0] == pytest.approx(2 * 0.05 + 2 * 0.5 + 0.05, rel=1e-9)
    # Saving took 0.05 s, so the next checkpoint is 5 s later.
    assert moments[1] - moments[0] == pytest.approx(5.05, abs=0.51)
    assert status(tmp_path / "run")["wall_s"] == pytest.approx(now[0], rel=1e-9)


def test_a_folder_used_by_another_process_is_left_unchanged(tmp_path, small_blocks, monkeypatch):
    folder = tmp_path / "run"
    stopped(folder)
    monkeypatch.setattr(run_folder, "INTERVALS", run_folder.INTERVALS._replace(lock_s=0.0))
    with FileLock(folder / ".lock"):
        with pytest.raises(InputError, match=r"running here; wait for it, or stop it$"):
            resume(folder)
        with pytest.raises(InputError, match="another process is running here"):
            remove(folder)
    remove(folder)
    assert list(folder.iterdir()) == []


def test_a_killed_run_has_the_status_killed(tmp_path, small_blocks):
    """A killed run leaves a file that says "running", but no process has the lock."""
    folder = tmp_path / "run"
    stopped(folder)
    file = folder / "status.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"state": "running", "reason": ""}))
    assert (status(folder)["state"], status(folder)["reason"]) == (
        "killed", "the process of the run was killed",
    )  # fmt: skip
    with FileLock(folder / ".lock"):
        assert status(folder)["state"] == "running"
    for wrong in (
        {"state": "asleep"},
        {"tolerance": 0},
        {"tolerance": 1},
        {"reason": 3},
        {"known_until": 0.0},
        {"known_until": "1"},
    ):
        file.write_text(
            json.dumps(
                {"state": "stopped", "tolerance": 1e-6, "reason": "", "best_effort": 0} | wrong
            )
        )
        with pytest.raises(InputError, match="was changed and cannot be read"):
            status(folder)


def test_a_failure_is_recorded_with_its_reason(tmp_path, monkeypatch, small_blocks):
    honest = run_folder.store.Writer.put
    puts = []

    states = []

    def full(self, block):
        states.append(status(tmp_path / "run")["state"])
        puts.append(block.samples)
        if len(puts) == 3:
            raise OSError(28, "No space left on device", str(tmp_path / "run" / "x"))
        honest(self, block)

    monkeypatch.setattr(run_folder.store.Writer, "put", full)
    with pytest.raises(lmpchain.LmpchainError) as failed:
        simulate(SCENE, "native", 1e-6, folder=tmp_path / "run")
    done = puts[1].stop
    assert str(failed.value) == (
        f"{tmp_path}/run/x: cannot be written: No space left on device; {done} of 61 samples were "
        f"computed and most are kept; remove the cause, then continue with "
        f"lmpchain resume {tmp_path}/run"
    )
    assert status(tmp_path / "run")["state"] == "failed"
    assert "No space left" in status(tmp_path / "run")["reason"]
    # Three more blocks fit until the disk is full again, and this run says that it is running.
    puts[:] = []
    with pytest.raises(lmpchain.LmpchainError):
        resume(tmp_path / "run")
    assert states == ["running"] * 6
    monkeypatch.undo()
    assert np.array_equal(
        resume(tmp_path / "run").velocity, simulate(SCENE, "native", 1e-6).velocity
    )


def test_a_checkpoint_of_another_version_is_rejected(tmp_path, small_blocks):
    folder = tmp_path / "run"
    stopped(folder)
    kept, state = next(load_checkpoints(folder))
    whole = kept["attempt"]

    def noted(**changed):
        notes = kept | changed
        for _ in range(2):
            save_checkpoint(folder, notes, state)
        with pytest.raises(
            InputError, match="checkpoint: was written by another version of lmpchain"
        ):
            resume(folder)

    proposal = whole["proposal"]
    for wrong in ({"step": 0.0}, {"per_landing": 0}):
        noted(attempt=whole | {"proposal": proposal | {"steps": proposal["steps"] | wrong}})
    noted(attempt=whole | {"tolerance": 1.0})
    noted(attempt=whole | {"tolerance": 0.0})
    noted(attempt=whole | {"proposal": proposal | {"engine": "fast"}})
    noted(attempt=whole | {"proposal": proposal | {"colour": 1}})
    noted(spent=kept["spent"] | {"wall_s": -1.0})
    noted(spent=kept["spent"] | {"more_s": 1.0})
    save_checkpoint(folder, kept, state)
    assert resume(folder).time.size == 61


def test_a_checkpoint_without_a_record_of_steps_continues_with_the_same_bits(
    tmp_path, small_blocks
):
    """Earlier versions stored the fields of the steps beside the others, and diameters as text."""
    folder = tmp_path / "run"
    stopped(folder)
    kept, state = next(load_checkpoints(folder))
    attempt = kept["attempt"]
    new = attempt.pop("proposal")
    steps = new["steps"]
    old = {
        "step": steps["step"],
        **{key: new[key] for key in ("active_grains", "model_error", "solver_error", "cost_s")},
        "tolerance": new["tolerance"],
        "steps_per_landing": steps["per_landing"],
        "stride": steps["stride"],
        "fixed": new["fixed"],
        "adaptive": steps["adaptive"],
        "coarse_openings": steps["coarse_openings"],
        "integrator": new["integrator"],
        "choices": new["choices"] | {"drawn_m": "1.5e-07"},
    }
    attempt |= {"engine": new["engine"], "candidate": old, "best": [1e-3, list(old.values())]}
    save_checkpoint(folder, kept, state)
    renewed = renew(attempt)
    assert renewed["proposal"]["choices"].pop("drawn_m") == 1.5e-7
    assert renewed["proposal"] == new
    assert renewed["best"][1]["steps"] == steps
    assert renew(attempt | {"best": None})["best"] is None
    assert np.array_equal(resume(folder).velocity, simulate(SCENE, "native", 1e-6).velocity)


def test_a_finished_run_with_a_missed_tolerance_repeats_the_error(tmp_path):
    with pytest.warns(UserWarning, match="round-off alone"):
        simulate(SCENE, "native", 1e-16, folder=tmp_path / "run", on_miss="warn")
    kept = status(tmp_path / "run")
    assert kept["best_effort"] is True
    assert "round-off alone" in kept["reason"]
    assert resume(tmp_path / "run").time.size == 61  # The best possible result was requested.


def test_names_of_folders():
    assert resume_command("a b") == "lmpchain resume 'a b'"
    assert resume_command("run") == "lmpchain resume run"


def test_allowed_contents_of_a_new_folder(tmp_path):
    """Only files of a run that was killed at its start are allowed."""
    for name in ("status.json", "run.json"):
        (tmp_path / name).write_text(sealed_json({"state": "running"}))
    (tmp_path / ".lock").touch()
    (tmp_path / ".run.node-1-01234567.partial.json").touch()
    assert check_new(tmp_path) == tmp_path
    (tmp_path / "notes.txt").touch()
    with pytest.raises(InputError, match=r"is neither empty nor a run folder: notes\.txt was not"):
        check_new(tmp_path)
    for name in "abcdef":
        (tmp_path / name).touch()
    with pytest.raises(InputError, match=r": a, b, c, d, e and 2 more were not written by"):
        check_new(tmp_path)
    with pytest.raises(InputError, match="is a file"):
        check_new(tmp_path / "notes.txt")
    assert check_new(tmp_path / "new") == tmp_path / "new"


def test_a_changed_task_is_detected(tmp_path, small_blocks):
    folder = tmp_path / "run"
    stopped(folder)
    file, scene = (folder / name for name in ("run.json", "scene.toml"))
    asked, text = json.loads(file.read_text()), scene.read_text()
    assert (asked["engine"], asked["tolerance"], asked["best_effort"]) == ("native", 1e-6, False)
    assert len(asked["sessions"]) == 1
    differ = "they differ from those at the start of the run"
    changes = (
        {"tolerance": 1e-5},
        {"engine": "modes"},
        {"best_effort": True},
        {"options": asked["options"] | {"threads": 2}},
    )
    unusual = asked | {"best_effort": 0}
    sealed = json.dumps(unusual | {"sha256": order_hash(unusual, text)})
    for path, changed, fault in (
        *((file, json.dumps(asked | change), differ) for change in changes),
        (file, sealed, "an entry is .* invalid"),
        (file, "{}", ""),
        (scene, text.replace("samples = 61", "samples = 62"), differ),
        (scene, text.replace("grains", "grain"), ""),
        (scene, "[chain", ""),
    ):
        before = path.read_text()
        path.write_text(changed)
        with pytest.raises(InputError, match=rf"or scene\.toml was changed .*{fault}"):
            resume(folder)
        path.write_text(before)
    assert resume(folder).time.size == 61
    assert len(json.loads(file.read_text())["sessions"]) == 2


def test_engines_of_the_user_cannot_use_a_run_folder(tmp_path):
    class Mine(Native):
        name = "mine"

    for engine in (Mine(), type("Native", (Native,), {})()):
        with pytest.raises(InputError, match="a run folder stores engines by name only"):
            simulate(SCENE, engine, folder=tmp_path / "run")
    assert not (tmp_path / "run").exists()
    # A folder of another person may have commands for LAMMPS, which are not executed.
    (tmp_path / "other").mkdir()
    commands = tmp_path / "commands"
    commands.write_text("shell touch here\n")
    hostile: Any = SimpleNamespace(name="lammps", options=lambda: {"include": str(commands)})
    write_order(tmp_path / "other", SCENE, hostile, 1e-6, False)
    said = {"state": "stopped", "reason": "", "tolerance": 1e-6, "best_effort": False}
    (tmp_path / "other" / "status.json").write_text(sealed_json(said))
    with pytest.raises(InputError, match=r"include: .*shell"):
        resume(tmp_path / "other")


# --- signals


def test_a_signal_is_recorded_and_passed_on():
    heard = []
    before = signal.signal(signal.SIGTERM, lambda number, _: heard.append(number))
    try:
        with Requests(None) as requests:
            assert requests.reason == ""
            signal.raise_signal(signal.SIGTERM)
            assert requests.reason == "stopped by SIGTERM"
            assert heard == []
        requests.pass_on()
        assert heard == [signal.SIGTERM]
        with Requests(1e-9) as late:
            time.sleep(1e-6)
            assert late.reason == "stopped at the end of its time"
        late.pass_on()
        assert heard == [signal.SIGTERM]
    finally:
        signal.signal(signal.SIGTERM, before)


# --- many scenes


def test_the_cost_of_a_batch_is_divided(monkeypatch):
    """The times of a batch, including earlier attempts, are divided by its size.

    Counts are of the batch.
    """
    engine = Native()
    honest, propose = engine.start, engine.propose
    costs = []

    def start(parts, candidate):
        assert len(parts) == 3
        run = honest(parts, candidate)
        cost = run.cost

        def timed():
            costs.append(cost()._replace(integration_s=3.0, estimate_s=1.5, setup_s=0.9))
            return costs[-1]

        monkeypatch.setattr(run, "cost", timed)
        return run

    monkeypatch.setattr(engine, "start", start)
    # The steps of the first attempts are too long.
    monkeypatch.setattr(engine, "propose", lambda scene, _: propose(scene, 1e-2))
    # Each proposal takes 0.3 s.
    monkeypatch.setattr(step_control, "clock", itertools.count(0.0, 0.3).__next__)
    answers = simulate_many([SCENE] * 3, 1e-10, engine)
    earlier = len(costs) - 1
    assert earlier > 0
    for t in answers:
        assert t.cost.integration_s == pytest.approx(1.0, rel=1e-12)
        assert t.cost.estimate_s == pytest.approx(1.5 / 3 + earlier * (3.0 + 1.5) / 3, rel=1e-12)
        assert t.cost.setup_s == pytest.approx((0.9 + 3 * 0.3) / 3, rel=1e-12)
        assert t.cost.steps == costs[-1].steps


def test_batches_fit_into_the_cache(monkeypatch):
    engine = Native()
    honest = engine.start
    sizes = []
    monkeypatch.setattr(engine, "start", lambda *of: sizes.append(len(of[0])) or honest(*of))
    scenes = [SCENE.replace(excitation=Impulse(velocity=1e-4 + n * 1e-12)) for n in range(7)]
    one = SCENE.samples * 12
    for numbers, expected in (3 * one, [3, 3, 1]), (3 * one - 1, [2, 2, 2, 1]), (one - 1, [1] * 7):
        monkeypatch.setattr(many, "BATCH_NUMBERS", numbers)
        answers = simulate_many(scenes, engine=engine)
        assert [t.scene for t in answers] == scenes
        assert sizes == expected
        sizes.clear()


def test_scenes_with_a_narrow_light_cone_are_solved_alone():
    """If fewer than half of the grains are reached, a batch would compute more."""
    long = SCENE.replace(chain=CHAIN.replace(grains=400), duration=2.4e-4, samples=11)
    reached = long.reached.chain.grains
    assert 2 * reached < 400 < 3 * reached
    assert dict(many.in_batches(Native(), {0: long, 1: long}, 1e-6)) == {}
    short = long.replace(chain=CHAIN.replace(grains=2 * reached))
    assert set(dict(many.in_batches(Native(), {3: short, 7: short}, 1e-6))) == {3, 7}
    assert dict(many.in_batches(engines.Modes(), {0: SCENE}, 1e-6)) == {}
