"""After a kill of any part at any moment, a run continues and ends with the same bits."""

import itertools
import json
import os
import random
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import pytest
from helpers import hurried
from helpers.child_processes import (
    HURRIED,
    Fork,
    at_work,
    ended,
    finish,
    processes,
    same,
    start,
    until,
    write,
)
from helpers.example_chains import column
from helpers.example_scenes import paper, scene_of
from helpers.kill_moments import kill_moments

from lmpchain import EngineUnavailable, Impulse, Trajectory, engines, laws, resume, simulate
from lmpchain.engines.lammps import engine as lammps_engine
from lmpchain.engines.lammps.subprocess_ranks import SubprocessRanks
from lmpchain.engines.linear import engine as linear
from lmpchain.engines.stepping import time_stepping
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.integrators.steps import Steps
from lmpchain.simulation import run_folder
from lmpchain.simulation.folder_files import is_run
from lmpchain.simulation.run_folder import status

CHAIN = column(200)
STRIKE = Impulse(velocity=8.57e-3)
SHORT = scene_of(CHAIN, STRIKE, 1e-4, 13)
SMALL = scene_of(column(12), Impulse(velocity=0.05), 2e-5, 9)

# --- kills at every change of the disk


def native(_: pytest.MonkeyPatch):
    """Return several attempts with decreasing steps."""
    return SHORT, engines.Native(adaptive=False), 1e-4


def lammps(monkeypatch: pytest.MonkeyPatch):
    """Return an attempt with the physical diameter by an optimistic law, and one with the gauge."""
    heights = lammps_engine.HEIGHTS._replace(rounding=1e-6)
    monkeypatch.setattr(lammps_engine, "HEIGHTS", heights)
    return paper("weak", 13), engines.Lammps(), 1e-6


def breakdown(monkeypatch: pytest.MonkeyPatch):
    """Return a first attempt that breaks down because its steps are far too long."""
    honest = time_stepping.TimeSteppingEngine.propose

    def choose(*arguments):
        candidate = honest(*arguments)
        longer = candidate.steps.per_landing * candidate.step
        return candidate.with_steps(Steps(1, 1, longer))

    monkeypatch.setattr(time_stepping.TimeSteppingEngine, "propose", choose)
    scene = scene_of(SMALL.chain, SMALL.excitation, 1.5e-4, 13)
    return scene, engines.Native("verlet"), 1e-3


def by_formula(monkeypatch: pytest.MonkeyPatch):
    """Return a scene with a contact law by formula that has a kink."""
    chain = SMALL.chain.replace(law=laws.bilinear(0.3, k=1e5))
    return SMALL.replace(chain=chain), engines.Native("rkn4"), 1e-6


def fallback(monkeypatch: pytest.MonkeyPatch):
    """Return a scene for which "auto" tries linear theory, whose model error is too large."""
    monkeypatch.setattr(linear, "expected_error", lambda _: 0.0)
    monkeypatch.setattr(time_stepping, "seconds", lambda *_: 1.0)
    monkeypatch.setattr(linear, "seconds", lambda *_: 1e-6)
    chain = column(6, gravity=0.0, top_load=1e-3)
    strike = Impulse(velocity=0.1 * chain.length_scale / chain.time_scale)
    return (scene_of(chain, strike, 30.0 * chain.time_scale, 11), "auto", 1e-6)


@pytest.fixture
def busy_disk(monkeypatch: pytest.MonkeyPatch):
    """Save a checkpoint after every four samples, without waiting for the disk."""
    monkeypatch.setattr(os, "fsync", lambda _: None)
    monkeypatch.setattr(stepping_run, "BLOCK_S", 1e-9)
    intervals = run_folder.INTERVALS._replace(checkpoint_s=0.0, checkpoint_share=1e9)
    monkeypatch.setattr(run_folder, "INTERVALS", intervals)


CASES = native, by_formula, lammps, breakdown, fallback
EVERY = [
    *(
        pytest.param(case, 4, marks=() if case in (native, by_formula) else pytest.mark.slow)
        for case in CASES
    ),
    *(pytest.param(case, 60, marks=pytest.mark.soak) for case in CASES),
]


@pytest.mark.filterwarnings("ignore:Eq. ")
@pytest.mark.parametrize(("case", "most"), EVERY)
@pytest.mark.slow
def test_a_kill_at_any_change_of_the_disk_is_recovered(
    case: Callable, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, busy_disk: None
):
    scene, engine, tolerance = case(monkeypatch)
    right = simulate(scene, engine, tolerance)
    run = tmp_path / "run"
    rng = random.Random(case.__name__)
    left = kill_moments(
        run, lambda: simulate(scene, engine, tolerance, folder=run), most, rng, tmp_path / "killed"
    )
    assert status(run)["attempt"] >= (1 if case in (fallback, by_formula) else 2)
    # A folder without a scene cannot be resumed.
    begun = [folder for folder in left if (folder / "scene.toml").exists()]
    assert len(begun) > most / 2
    for folder in begun:
        # The next session is killed as well.
        if status(folder)["state"] == "killed" and rng.random() < 0.5:
            again = kill_moments(
                folder, lambda at=folder: resume(at), 3, rng, tmp_path / f"again {folder.name}"
            )
            # If another thread moved a file at a kill moment, that moment has no copy.
            folder = rng.choice(again)
        answer = resume(folder)
        assert same(answer, right), folder
        assert answer.cost.steps == right.cost.steps
        assert names(folder) == names(run)


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


# --- ranks


@pytest.mark.slow
@pytest.mark.parametrize("victim", [0, 1, "mpiexec"])
def test_a_killed_rank_does_not_shorten_the_step(
    victim: int | str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Whichever rank dies, an attempt with a given step continues."""
    scene = SMALL
    engine = engines.Lammps("kahan-li6", ranks=2)
    right = simulate(scene, engines.Lammps("kahan-li6"), 1e-4)
    rng = random.Random(str(victim))
    honest = SubprocessRanks.ask
    left = [0]

    def ask(self: SubprocessRanks, name: str, *values: object) -> list:
        left[0] -= name == "advance"
        if name == "advance" and not left[0]:
            os.kill(self._mpiexec.pid if victim == "mpiexec" else self.pids[victim], signal.SIGKILL)
            until(lambda: not any(alive(pid) for pid in self.pids))
        return honest(self, name, *values)

    monkeypatch.setattr(SubprocessRanks, "ask", ask)
    left[0] = rng.randint(1, 5)
    with pytest.raises(EngineUnavailable, match=r"a rank of LAMMPS died.*lmpchain resume"):
        simulate(scene, engine, 1e-4, folder=tmp_path / "run")
    said = status(tmp_path / "run")
    assert (said["state"], said["attempt"]) == ("failed", 1)
    left[0] = rng.randint(1, 5)
    with pytest.raises(EngineUnavailable):
        resume(tmp_path / "run")
    answer = resume(tmp_path / "run", ranks=1)
    assert same(answer, right)
    assert (answer.cost.steps, answer.cost.ranks) == (right.cost.steps, 1)
    sessions = json.loads((tmp_path / "run" / "run.json").read_text())["sessions"]
    assert [session["ranks"] for session in sessions] == [2, 2, 1]


def alive(pid: int) -> bool:
    """Return whether a process exists and is not a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.mark.slow
def test_ranks_name_no_shared_memory_and_end_with_their_launcher(tmp_path: Path):
    """No kill leaves processes or shared memory behind.

    A name in /dev/shm, or a rank whose launcher was killed with all that watches it.
    """
    scene = scene_of(CHAIN, STRIKE, 1.0, 20001)
    mark = {"MARK": str(tmp_path), "TMPDIR": str(tmp_path / "scratch")}
    (tmp_path / "scratch").mkdir()
    words = ["run", write(scene, tmp_path), "-o", f"{tmp_path}/run/", *FIXED, *TWO]
    process = start(*words, env=os.environ | mark)
    try:
        at_work(tmp_path / "run", process)
        there = processes(f"MARK={tmp_path}")
        assert len(there) >= 5, "lmpchain, mpiexec, its proxy and two ranks"
        shared = [
            line
            for pid in there
            for line in Path(f"/proc/{pid}/maps").read_text().splitlines()
            if "mpich" in line
        ]
        assert [
            line for line in shared if "/dev/shm" in line and not line.endswith("(deleted)")
        ] == []
        assert os.listdir(tmp_path / "scratch") == []
        for pid in there:
            if (
                b"hydra" in Path(f"/proc/{pid}/cmdline").read_bytes()
                or b"mpiexec" in Path(f"/proc/{pid}/cmdline").read_bytes()
            ):
                os.kill(pid, signal.SIGKILL)
        code, said = ended(process)
    finally:
        process.kill()
    assert code == 1
    assert "a rank of LAMMPS died" in said
    until(lambda: not processes(f"MARK={tmp_path}"))


# --- kills at random moments

LONGER = scene_of(CHAIN, STRIKE, 1e-3, 1001)
# The middle grain moves up, across the border between two ranks.
FEW = scene_of(column(31), Impulse(velocity=-0.05, grain=16), 5e-5, 61)
VERLET = ["--engine", "lammps", "--integrator", "verlet"]
FIXED = [*VERLET, "--step", "1e-7", "--diameter", "physical"]
FREE = [*VERLET, "--tolerance", "3e-3"]
TWO = ["--ranks", "2"]
# Scene, options of `run`, and numbers of processes of mpirun for the first and later commands in
# turn.
CASES = {
    "native": (LONGER, ["--engine", "native", "--step", "1e-9"], [1]),
    "native to a tolerance": (LONGER, ["--engine", "native", "--tolerance", "1e-9"], [1]),
    "lammps": (FEW, FREE, [1]),
    "two ranks": (FEW, [*FIXED, *TWO], [1]),
    "two ranks to a tolerance": (FEW, [*FREE, *TWO], [1]),
    "mpirun": (FEW, FIXED, [2, 1, 2]),
    "two ranks, then mpirun": (FEW, [*FIXED, *TWO], [1, 2, 1]),
}
# Cases that need a second attempt.
SEVERAL = {"native to a tolerance", "lammps", "two ranks to a tolerance"}
# An idle rank sleeps, so that with fewer cores than ranks the others can run.
DOZE = {"MPIR_CVAR_POLLS_BEFORE_YIELD": "1", "MPIR_CVAR_ENABLE_HEAVY_YIELD": "1"}


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Trajectory]:
    """Return a function that computes the uninterrupted result of a case on one rank."""

    @cache
    def answer(case: str) -> Trajectory:
        scene, words, _ = CASES[case]
        simulate(scene, "native", 1e-2)  # Every fork then has these kernels.
        at = tmp_path_factory.mktemp("truth")
        alone = words[: -len(TWO)] if words[-len(TWO) :] == TWO else words
        code, said = finish("run", write(scene, at), "-o", f"{at}/run/", *alone, command=HURRIED)
        assert code == 0, said
        return Trajectory.load(at / "run")

    return answer


def reached(folder: Path) -> float:
    """Return the number of finished attempts of a run folder, plus the fraction of the current."""
    if not (folder / "scene.toml").exists():
        return -1.0
    said = status(folder)
    return max(said["attempt"] - 1, 0) + said["samples_done"] / said["samples"]


class Command:
    """A process of lmpchain that a test kills.

    Hurried, in a fork of this process or under mpirun.
    """

    def __init__(self, words: tuple[object, ...], ranks: int, folder: Path):
        self._mark = f"MARK={folder}"
        environment = os.environ | DOZE | {"MARK": str(folder), "TMPDIR": str(folder / "scratch")}
        self._process: Fork | subprocess.Popen[str]
        if ranks > 1:
            self._process = start(*words, ranks=ranks, command=HURRIED, env=environment)
        else:
            self._process = Fork(
                hurried.main, words, environment, folder.with_name(f"{folder.name} said")
            )
        self.pid = self._process.pid

    def at_work(self) -> bool:
        return self._process.poll() is None

    def processes(self) -> list[int]:
        """Return the live processes of the command and its children."""
        return [*processes(self._mark), *([self.pid] if self.at_work() else [])]

    def ended(self) -> tuple[int | None, str]:
        """Wait until the process and all its children have ended.

        Return its exit code and what it said.
        """
        code, said = (
            self._process.ended() if isinstance(self._process, Fork) else ended(self._process)
        )
        until(lambda: not processes(self._mark))
        return code, said


def killed(
    case: str, folder: Path, parts: list[float], rng: random.Random
) -> tuple[Trajectory, int]:
    """Run a case, and kill one of its processes at random after this number of attempts.

    Returns the answer, and how often something was killed. A part below 0 is of the time before the
    first sample.
    """
    scene, words, ranks = CASES[case]
    scratch = folder / "scratch"
    scratch.mkdir(parents=True)
    line: tuple[object, ...] = ("run", write(scene, folder), "-o", f"{folder}/run/", *words)
    counts = itertools.cycle(ranks)
    kills = 0
    for part in parts:
        command = Command(line, next(counts), folder)
        while command.at_work() and reached(folder / "run") < part:
            time.sleep(0.01)
        # The kill is not always just after a sample.
        time.sleep(rng.uniform(0, 1) if part < 0 else rng.uniform(0, 0.1))
        there = command.processes()
        alive_still = command.at_work()
        victim = command.pid if rng.random() < 0.5 or not there else rng.choice(there)
        with suppress(ProcessLookupError):
            os.kill(victim, signal.SIGKILL)
        code, said = command.ended()
        assert "Traceback" not in said, said
        if is_run(folder / "run"):  # Otherwise the kill was too early for a resumable run.
            line = ("resume", folder / "run")
            kills = kills + (alive_still and code != 0)
    code, said = Command(line, next(counts), folder).ended()
    assert code == 0, said
    assert os.listdir(scratch) == []
    assert sorted(os.listdir(folder)) == ["in.toml", "run", "scratch"]
    assert [name for name in names(folder) if "partial" in name] == []
    return Trajectory.load(folder / "run"), kills


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "times"), [("native", 1), ("lammps", 1), ("two ranks, then mpirun", 2)]
)
def test_repeated_kills(case: str, times: int, tmp_path: Path, truth: Callable):
    rng = random.Random(case)
    parts = sorted(rng.uniform(0.01, 0.5) for _ in range(times))
    answer, kills = killed(case, tmp_path / "here", parts, rng)
    assert kills >= 1
    assert same(answer, truth(case))
    assert status(tmp_path / "here" / "run")["state"] == "finished"


SOAK = {
    "native": 50,
    "native to a tolerance": 50,
    "two ranks": 40,
    "two ranks to a tolerance": 60,
    "lammps": 30,
    "mpirun": 30,
}


@pytest.mark.soak
@pytest.mark.timeout(0)
@pytest.mark.parametrize(
    ("case", "piece"),
    [(case, piece) for case, times in SOAK.items() for piece in range(times // 10)],
)
def test_random_kills(case: str, piece: int, tmp_path: Path, truth: Callable):
    """A run that is killed at random moments and resumed gives the same result."""
    right = truth(case)
    rng = random.Random(f"{case} {piece}")
    count = 0
    attempts = 2 if case in SEVERAL else 1
    for again in itertools.count():
        parts = sorted(rng.uniform(-0.2, attempts) for _ in range(rng.choice([1, 2, 3, 4])))
        answer, kills = killed(case, tmp_path / str(again), parts, rng)
        assert same(answer, right), f"{parts} after {count} kills that went well"
        assert answer.cost.steps == right.cost.steps
        assert status(tmp_path / str(again) / "run")["attempt"] >= attempts
        count += kills
        print(
            f"{case} {piece}: {count} kills, parts {[round(part, 2) for part in parts]}", flush=True
        )
        if count >= 10:
            break
