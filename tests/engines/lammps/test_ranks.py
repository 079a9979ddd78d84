"""One column on several ranks: identical bytes, and a message when a rank fails."""

import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from itertools import cycle, pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.child_processes import busy, ended, processes, until
from helpers.example_chains import column
from helpers.example_scenes import scene_of

from lmpchain import (
    Chain,
    Drive,
    EngineUnavailable,
    Force,
    Impulse,
    Law,
    RunFailed,
    Trajectory,
    doctor,
    laws,
    simulate,
)
from lmpchain.engines import Lammps
from lmpchain.engines.lammps import communicators, library, subprocess_ranks
from lmpchain.engines.lammps import engine as lammps_engine
from lmpchain.engines.lammps.column import LammpsColumn
from lmpchain.engines.lammps.stepper import LammpsStepper
from lmpchain.engines.lammps.subprocess_ranks import Communicator, SubprocessRanks
from lmpchain.engines.lammps.worker import StepPlan
from lmpchain.integrators.methods import SPLITTINGS
from lmpchain.integrators.steps import Steps
from lmpchain.util import mpi

MPIEXEC = mpi.launcher()
RANKS = subprocess_ranks.__name__
# The strike is beside the border between two ranks, and the wave crosses the border.
MIDDLE = scene_of(column(60, material="glass"), Impulse(velocity=8.57e-4, grain=29), 4e-5, 9)
LOADED = Chain(grains=30, material="steel", diameter=5e-3, top_load=5.0, bottom="wall")
SAMPLED = Drive(times=np.linspace(0, 4e-5, 9), displacement=1e-7 * np.sin(np.arange(9.0)) ** 2)
ACTING = Drive(amplitude=1e-7, frequency=2e4), Force(amplitude=1.0, frequency=2e4, grain=25)
LAW = Law("k*max(o, 0)**1.5*(1 + c*o)", k=5e8, c=1e4)
STRIKE = Impulse(velocity=1e-2, grain=15)
CHAINS: dict[str, tuple[Chain, Any]] = {
    "walls": (LOADED.replace(top="wall"), STRIKE),
    "harmonic drive": (LOADED, ACTING[0]),
    "sampled drive": (LOADED, SAMPLED),
    "unequal grains": (Chain(grains=40, diameter=1e-3 * 0.97 ** np.arange(40)), STRIKE),
    "damped": (LOADED.replace(bottom="fixed", damping={"viscoelastic": 3e-8, "drag": 3e3}), STRIKE),
    "formula": (LOADED.replace(law=LAW, damping={"viscoelastic": 3e-8}), STRIKE),
    "ground": (LOADED.replace(ground=laws.mathieu(1e6, depth=0.6, frequency=2e5)), STRIKE),
}
SCENES = {"strike in the middle": MIDDLE} | {
    name: scene_of(*each, 4e-5, 5) for name, each in CHAINS.items()
}
ENDLESS = scene_of(column(200, material="glass"), Impulse(velocity=1e-5, grain=100), 1.0, 101)


def same(one: Trajectory, other: Trajectory) -> bool:
    return np.array_equal(one.displacement, other.displacement) and np.array_equal(
        one.velocity, other.velocity
    )


def motion(communicator: Communicator, excitation: Drive | Force) -> list[np.ndarray]:
    """Return the samples and the last state of a short run on these ranks."""
    made = LammpsColumn(scene_of(LOADED.replace(bottom="fixed"), excitation, 4e-7, 3), 0.0)
    stepper = LammpsStepper(made, SPLITTINGS["rkn6"], Steps(2, 1, 1e-7), {}, communicator)
    u, v = np.zeros((2, 1, 3, 30))
    assert stepper.fill(u, v, 0, 2, 100) == 4
    assert stepper.ranks == communicator.ranks
    state = stepper.state()
    communicator.ask("commands", "clear")
    return [u, v, *state.values()]


def test_two_ranks_give_the_bits_of_one_and_report_errors():
    alone = communicators.Serial("none")
    expected = [motion(alone, excitation) for excitation in ACTING]
    alone.close()
    ranks = SubprocessRanks(2, "none")
    try:
        with pytest.raises(RunFailed, match=r"^LAMMPS stopped: ERROR: Unknown command: nonsense"):
            ranks.ask("commands", "nonsense")
        with pytest.raises(EngineUnavailable, match="no PIZZA package"):
            ranks.ask("require", ("PIZZA",))
        assert ranks.ask("commands", "units si") == [None, None]
        for excitation, fields in zip(ACTING, expected, strict=True):
            assert np.abs(fields[1]).max() > 0
            for one, other in zip(motion(ranks, excitation), fields, strict=True):
                assert np.array_equal(one, other)
        assert len(set(ranks.pids)) == 2
        os.kill(ranks.pids[1], signal.SIGKILL)
        died = r"a rank of LAMMPS died, and all 2 ranks with it: .*EXIT CODE: 9"
        with pytest.raises(EngineUnavailable, match=died):
            ranks.ask("share")
    finally:
        ranks.close()
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in ranks.pids))


class World:
    """An MPI world whose other ranks are messages in a list and lists of answers."""

    rank, size = 1, 3

    def __init__(self, *messages: tuple[str, tuple[Any, ...]]):
        self.messages = list(messages)
        self.sent: list[Any] = []
        self.answers: list[Any] = []
        self.others: list[Any] = [None, None]

    def iprobe(self, source: int) -> bool:
        assert source == 0
        return bool(self.messages)

    def recv(self, source: int) -> Any:
        assert source == 0
        return self.messages.pop(0)

    def send(self, message: Any, rank: int) -> None:
        self.sent.append((rank, message))

    def gather(self, answer: Any) -> list[Any]:
        self.answers.append(answer)
        return [answer, *self.others]

    def Abort(self, code: int) -> None:
        raise SystemExit(code)


class Obedient:
    """A worker that raises what it is told to, and is opened in a world with a log."""

    def __init__(self, *opened: Any):
        self.opened = opened

    def share(self) -> tuple[Any, ...]:
        return self.opened

    def commands(self, error: Exception) -> None:
        raise error

    def close(self) -> None:
        self.opened = ()


@pytest.fixture
def handlers() -> Iterator[None]:
    """Restore the handlers of signals."""
    before = {number: signal.getsignal(number) for number in library.SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def _obedient(monkeypatch: pytest.MonkeyPatch, handlers: None) -> None:
    monkeypatch.setattr(communicators, "Worker", Obedient)
    monkeypatch.setattr(mpi, "MESSAGE_S", 0.0)


@pytest.mark.usefixtures("_obedient")
def test_ranks_answer_each_call_until_they_are_shut_down(capsys: pytest.CaptureFixture[str]):
    """Errors that all ranks raise are answers; any other error aborts all ranks."""
    failures = Exception("ERROR: Lost atoms"), EngineUnavailable("order"), RunFailed("lost grains")
    world = World(
        ("open", ("file.log",)),
        ("share", ()),
        *(("commands", (error,)) for error in failures),
        *(("close", ()), ("close", ()), ("shutdown_workers", ()), ("share", ())),
    )
    communicators.worker_loop(world)
    assert world.answers == [None, (world, "file.log"), *failures, None, None]
    assert world.messages == [("share", ())]
    assert {signal.getsignal(number) for number in library.SIGNALS} == {signal.SIG_IGN}
    for error, message in (
        (OSError("ERROR: disk"), "ERROR: disk"),
        (Exception("a fault"), "a fault"),
        (ZeroDivisionError(), "ZeroDivisionError"),
    ):
        with pytest.raises(SystemExit):
            communicators.worker_loop(World(("open", ("none",)), ("commands", (error,))))
        assert capsys.readouterr().err == f"error: rank 1: {message}\n"


@pytest.mark.usefixtures("_obedient")
def test_the_first_rank_sends_each_call_to_the_others_and_raises_their_errors():
    world = World()
    ranks = communicators.MpiRanks(world, "none")
    assert ranks.ranks == 3
    world.others = ["two", "three"]
    assert ranks.ask("share") == [(world, "none"), "two", "three"]
    calls = ("open", ("none",)), ("share", ())
    assert world.sent == [(rank, call) for call in calls for rank in (1, 2)]
    unavailable = EngineUnavailable("no PIZZA package")
    world.others = [None, unavailable]
    with pytest.raises(EngineUnavailable) as raised:
        ranks.ask("share")
    assert raised.value is unavailable
    world.others = [Exception("ERROR: Lost atoms"), None]
    with pytest.raises(RunFailed, match=r"^LAMMPS stopped: ERROR: Lost atoms$"):
        ranks.ask("share")
    world.others = [None, None]
    world.sent.clear()
    ranks.close()
    communicators.shutdown_workers(world)
    last = ("close", ()), ("shutdown_workers", ())
    assert world.sent == [(rank, call) for call in last for rank in (1, 2)]


def test_signals_wait_for_the_end_of_a_block_unless_they_are_ignored(handlers: None):
    arrived = []
    for number in library.SIGNALS:
        signal.signal(number, lambda number, _: arrived.append(number))
    with library.signals_blocked():
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGTERM):
            signal.raise_signal(number)
        assert arrived == []
    # The first signal ends the run.
    assert arrived == [signal.SIGTERM]
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with library.signals_blocked():
        signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    assert arrived == [signal.SIGTERM]
    # Other threads cannot handle signals.
    entered = []
    block = library.signals_blocked()
    thread = threading.Thread(target=lambda: entered.append(block.__enter__()))
    thread.start()
    thread.join()
    assert entered == [None]
    signal.raise_signal(signal.SIGTERM)
    assert len(arrived) == 2


def test_another_user_cannot_answer_for_the_ranks(monkeypatch: pytest.MonkeyPatch):
    """Data from the socket can run any code."""
    ours, theirs = socket.socketpair()
    with theirs:
        line = subprocess_ranks.trusted_connection(ours)
        theirs.sendall(b"\0\0\0\4" + pickle.dumps(7, 0)[:4])
        assert line.recv() == 7
        line.close()
    ours, theirs = socket.socketpair()
    monkeypatch.setattr(os, "getuid", lambda: -1)
    with ours, theirs, pytest.raises(EngineUnavailable, match="another user answers"):
        subprocess_ranks.trusted_connection(ours)


@pytest.fixture
def launch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that makes a script the launcher of ranks."""
    fake = tmp_path / "mpiexec"

    def install(script: str) -> None:
        fake.write_text(script)
        fake.chmod(0o755)
        monkeypatch.setattr(mpi, "launcher", lambda: str(fake))

    return install


@pytest.mark.parametrize(
    ("answer", "output", "message"),
    [
        ([1], "", "starts 2 processes that cannot communicate: it belongs to another MPI"),
        (EngineUnavailable("no LAMMPS"), "", "^no LAMMPS$"),
        (None, "error: no memory\nmore", "LAMMPS died, and all 2 ranks with it: no memory$"),
        (None, "", ": the reason is unknown$"),
        (None, "first\nlast |\n", ": last$"),
        (None, "== BAD TERMINATION ==\n= EXIT CODE: 9 =\nlast", ": EXIT CODE: 9$"),
        (None, "one\nValueError: two\nOSError: three", ": ValueError: two$"),
    ],
)
def test_answers_of_ranks_that_do_not_run(answer: Any, output: str, message: str, launch: Any):
    data = pickle.dumps(answer)
    send = f"end.sendall({len(data).to_bytes(4)!r} + {data!r}); end.recv(1)\n"
    launch(
        f"#!{sys.executable} -ES\n"
        "import socket, sys\n"
        f"assert sys.argv[1:3] == ['-n', '2'] and sys.argv[4:6] == ['-m', {RANKS!r}]\n"
        f"sys.stderr.write({output!r})\n"
        "end = socket.socket(socket.AF_UNIX)\n"
        f"end.connect('\\0' + sys.argv[-1])\n{'' if answer is None else send}"
    )
    with pytest.raises(EngineUnavailable, match=message):
        SubprocessRanks(2, "none")


@pytest.mark.parametrize("end", [2.5, 3.0, 3.0 + 1e-13, 3.25, 3.999, 4.0 - 1e-13, 4.0, 4.5])
def test_a_step_is_split_where_the_waveform_ends_within_it(end: float):
    method = SPLITTINGS["rkn6"]
    wave = Force(shape="half-sine", amplitude=1.0, duration=end).waveform
    parts = StepPlan(5, 0, 4, method, 1.0, 0, (), 0.0, wave, False, 2, False).intervals(3)
    borders = [3.0, end, 4.0] if end in (3.25, 3.999) else [3.0, 4.0]
    assert [length for length, _ in parts] == pytest.approx(np.diff(borders), rel=1e-12)
    for (_, times), (first, last) in zip(parts, pairwise(borders), strict=True):
        drifts = (last - first) * np.cumsum(method.drifts)
        np.testing.assert_allclose(times, [first, *(first + drifts)], rtol=1e-12)


def test_a_launcher_that_fails_is_reported(launch: Any):
    launch("#!/bin/sh\necho no such host >&2\nexit 3\n")
    with pytest.raises(EngineUnavailable, match="the ranks do not start: no such host"):
        simulate(MIDDLE, "lammps", ranks=2)


INTEGRATORS = ("verlet", "kahan-li6", "rkn6")
SLOW = list(zip(SCENES, cycle(INTEGRATORS)))  # Each scene once.
OPTIONS: dict[str, Any] = {"integrator": "verlet", "step": 1e-7, "diameter": "physical"}


@pytest.mark.parametrize(
    ("name", "integrator", "options", "ranks"),
    [
        *(
            pytest.param(*each, {}, 2, marks=pytest.mark.slow if each in SLOW else pytest.mark.soak)
            for each in product(SCENES, INTEGRATORS)
        ),
        pytest.param("strike in the middle", "rkn6", {"diameter": "gauge"}, 3,
                     marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_ranks_give_the_bytes_of_a_single_process(name, integrator, options, ranks):
    integrator = "verlet" if SCENES[name].chain.damped else integrator
    options = OPTIONS | {"integrator": integrator, "step": 2e-7} | options
    one, more = (simulate(SCENES[name], Lammps(**options, ranks=n)) for n in (1, ranks))
    assert (one.cost.ranks, more.cost.ranks) == (1, ranks)
    assert np.abs(one.velocity[-1]).max() > 0
    assert same(one, more)


@pytest.mark.slow
def test_each_grain_may_have_its_own_rank():
    scene = scene_of(column(2), Impulse(velocity=1e-4), 1e-5, 3)
    assert same(simulate(scene, "lammps"), simulate(scene, "lammps", ranks=2))


@pytest.mark.slow
def test_dump_of_two_ranks(tmp_path):
    """The files of a run do not depend on the number of ranks."""
    for ranks in (1, 2):
        simulate(MIDDLE, Lammps(**OPTIONS, keep=tmp_path / str(ranks), ranks=ranks))
    for name in ("column.lammpstrj", "in.column", "column.data"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()


@pytest.fixture
def middle(tmp_path: Path) -> str:
    """Return a scene file."""
    MIDDLE.to_toml(tmp_path / "scene.toml")
    return str(tmp_path / "scene.toml")


def mpirun(*words: str | Path, ranks: int = 2, **options) -> subprocess.Popen[str]:
    command = [MPIEXEC, "-n", str(ranks), sys.executable, *map(str, words)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )


@pytest.mark.slow
def test_plain_mpirun_of_the_command_line(middle, tmp_path):
    def run(*words: str | Path, scene: str = middle) -> tuple[int, str]:
        return ended(mpirun("-m", "lmpchain.cli", "run", scene, *words))

    code, said = run("--engine", "lammps", "-o", tmp_path / "two.nc")
    assert code == 0, said
    assert said.count("engine ") == 1, "one rank speaks for all"
    two = Trajectory.load(tmp_path / "two.nc")
    assert two.cost.ranks == 2
    assert same(two, simulate(MIDDLE, "lammps"))
    for words, scene, fails, message in (
        (("-o", tmp_path / "native.nc"), middle, 0, "the engine auto runs on one rank"),
        ((), str(tmp_path / "none.toml"), 2, "there is no such file"),
        (("--engine", "lammps", "--ranks", "3"), middle, 2, "leave the number of ranks out"),
    ):
        code, said = run(*words, scene=scene)
        assert code == fails
        assert said.count(message) == 1


MPICH = {"PMI_SIZE": "4", "PMI_RANK": "1", "PMI_FD": "99"}
OPEN_MPI = {"OMPI_COMM_WORLD_SIZE": "4", "OMPI_COMM_WORLD_RANK": "3"}
SLURM = {"SLURM_PROCID": "2", "SLURM_STEP_ID": "0", "SLURM_STEP_NUM_TASKS": "4"}


def alone(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a command without a launcher, with these variables."""
    command = [sys.executable, "-m", "lmpchain.cli", *words]
    environment = os.environ | variables
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_the_variables_of_another_program(middle, tmp_path):
    """A command started by another MPI program runs on its own on each rank, as does LAMMPS."""
    for words, output in (
        (("run", middle, "--engine", "native", "-o"), "run.nc"),
        (("run", middle, "-o"), "folder/"),
        (("compare", middle, "--engines", "lammps,native", "--json"), "compared.json"),
    ):
        done = alone(*words, f"{tmp_path}/{output}", **MPICH, **OPEN_MPI, **SLURM)
        assert done.returncode == 0, done.stderr
        assert "rank" not in done.stderr
        assert (tmp_path / output).exists()
    assert same(Trajectory.load(tmp_path / "run.nc"), simulate(MIDDLE, "native"))


@pytest.mark.slow
def test_scripts_under_mpirun_run_alone(middle, tmp_path):
    """A script that every rank runs separately, such as a sweep, gets one LAMMPS per rank."""
    script = tmp_path / "script.py"
    script.write_text(
        "import lmpchain, sys\n"
        f"t = lmpchain.simulate(lmpchain.Scene.from_toml({middle!r}), 'lammps')\n"
        "sys.stdout.write(f'{t.cost.ranks} {t.velocity[-1].sum()!r}\\n')\n"
    )
    code, said = ended(mpirun(script))
    assert code == 0, said
    first, second = said.split("\n")[:2]
    assert first == second
    assert first.startswith("1 ")


@pytest.mark.slow
def test_a_killed_rank_ends_the_run_with_a_message(monkeypatch):
    started = []

    def kill():
        busy(started[0].pids[1], 0.3)
        os.kill(started[0].pids[1], signal.SIGKILL)

    def gather(*arguments):
        started.append(SubprocessRanks(*arguments))
        threading.Thread(target=kill).start()
        return started[0]

    monkeypatch.setattr(lammps_engine, "gather", gather)
    with pytest.raises(EngineUnavailable, match=r"a rank of LAMMPS died.*EXIT CODE: 9"):
        simulate(ENDLESS, Lammps(**OPTIONS, ranks=2))
    assert not Path(f"/proc/{started[0].pids[0]}").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [("-m", "lmpchain.engines.lammps.subprocess_ranks", "nowhere"), ("-c", doctor.SIZES_SEEN)],
)
def test_a_rank_whose_peer_never_comes_ends_with_its_launcher(words, tmp_path):
    """The rank waits inside MPI_Init, not in Python, and the pipe to the launcher stays open."""
    ours, theirs = socket.socketpair()
    launcher = (
        f"import subprocess; subprocess.run({[sys.executable, *words]}, "
        f"pass_fds=[{theirs.fileno()}])"
    )
    mark = f"MARK={os.getpid()}-{tmp_path.name}"
    of_mpi = {"PMI_SIZE": "2", "PMI_RANK": "0", "PMI_FD": str(theirs.fileno())}
    environment = os.environ | of_mpi | dict([mark.split("=")])
    started = subprocess.Popen(
        [sys.executable, "-c", launcher], env=environment, pass_fds=[theirs.fileno()]
    )
    with ours, theirs:
        assert ours.recv(8) == b"cmd=init"
        started.kill()
        started.wait()
        until(lambda: not processes(mark))


def endless(tmp_path: Path) -> tuple[subprocess.Popen[str], dict[int, int]]:
    """Start a long run under mpirun; return the working run and its ranks."""
    ENDLESS.to_toml(tmp_path / "endless.toml")
    options = ("--engine", "lammps", *(f"--{key}={value}" for key, value in OPTIONS.items()))
    words = ("run", tmp_path / "endless.toml", *options, "-o", tmp_path / "x.nc")
    mark = f"MARK={os.getpid()}-{tmp_path.name}"
    process = mpirun("-m", "lmpchain.cli", *words, env=os.environ | dict([mark.split("=")]))
    ranks: dict[int, int] = {}

    def started() -> bool:
        assert process.poll() is None, "it ended too early"
        for each in processes(mark):
            with suppress(OSError):
                entries = Path(f"/proc/{each}/environ").read_bytes().split(b"\0")
                rank = [int(entry[9:]) for entry in entries if entry.startswith(b"PMI_RANK=")]
                ranks.update(dict.fromkeys(rank, each))
        return len(ranks) == 2

    until(started)
    for rank in ranks.values():
        busy(rank, 1.0)
    return process, ranks


@pytest.mark.parametrize(
    "rank", [pytest.param(0, marks=pytest.mark.soak), pytest.param(1, marks=pytest.mark.slow)]
)
def test_a_killed_rank_ends_mpirun(tmp_path, rank):
    process, ranks = endless(tmp_path)
    os.kill(ranks[rank], signal.SIGKILL)
    code, said = ended(process)
    assert code != 0
    assert "EXIT CODE: 9" in said
    assert not (tmp_path / "x.nc").exists()


@pytest.mark.slow
def test_ctrl_c_stops_all_ranks(tmp_path):
    """SIGTERM to ranks is tested in `tests/simulation/test_signals.py`."""
    process, ranks = endless(tmp_path)
    process.send_signal(signal.SIGINT)
    ending, said = ended(process)
    assert ending == 130, said
    assert "stopped by" in said
    assert not any(Path(f"/proc/{pid}").exists() for pid in ranks.values())


@pytest.mark.slow
def test_an_error_on_one_rank_ends_all_ranks_with_its_message(middle, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import sys\n"
        "from lmpchain import cli\n"
        "from lmpchain.util import mpi\n"
        "from lmpchain.engines.lammps.worker import Worker\n"
        "def fail(*_):\n"
        "    raise FloatingPointError('the third digit of pi')\n"
        "if mpi.library().COMM_WORLD.rank == 1:\n"
        "    Worker._split = fail\n"
        f"sys.exit(cli.main(['run', {middle!r}, '--engine', 'lammps']))\n"
    )
    code, said = ended(mpirun(script))
    assert code == 1
    assert "error: rank 1: the third digit of pi" in said


@pytest.mark.slow
def test_a_foreign_mpirun_is_recognised(middle, launch):
    done = alone("run", middle, "--engine", "lammps", OMPI_COMM_WORLD_SIZE="2")
    assert done.returncode == 1
    assert "mpirun has started 2 processes, but MPI finds 1," in done.stderr
    # The script starts one process, whatever number is requested.
    launch('#!/bin/sh\nshift 2\nexec "$@"\n')
    with pytest.raises(EngineUnavailable, match="cannot communicate"):
        simulate(MIDDLE, "lammps", ranks=2)
