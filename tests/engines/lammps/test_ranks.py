"""One column on several ranks: identical bytes, and a message when a rank fails."""

import os
import signal
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from itertools import cycle, product
from pathlib import Path

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
    InputError,
    RunFailed,
    Trajectory,
    doctor,
    simulate,
)
from lmpchain.engines import Lammps
from lmpchain.engines.lammps import communicators
from lmpchain.engines.lammps import engine as lammps_engine
from lmpchain.engines.lammps.column import LammpsColumn
from lmpchain.engines.lammps.stepper import LammpsStepper
from lmpchain.engines.lammps.subprocess_ranks import Communicator, SubprocessRanks
from lmpchain.integrators.methods import SPLITTINGS
from lmpchain.integrators.steps import Steps
from lmpchain.util import mpi

MPIEXEC = mpi.launcher()
# The strike is beside the border between two ranks, and the wave crosses the border.
MIDDLE = scene_of(column(60, material="glass"), Impulse(velocity=8.57e-4, grain=29), 4e-5, 9)
LOADED = Chain(grains=30, material="steel", diameter=5e-3, top_load=5.0, bottom="wall")
SCENES = {
    "strike in the middle": MIDDLE,
    "walls": scene_of(
        Chain(grains=30, material="steel", diameter=5e-3, top_load=5.0, top="wall", bottom="wall"),
        Impulse(velocity=1e-2, grain=15),
        4e-5,
        5,
    ),
    "harmonic drive": scene_of(LOADED, Drive(amplitude=1e-7, frequency=2e4), 4e-5, 5),
    "sampled drive": scene_of(
        LOADED,
        Drive(times=np.linspace(0, 4e-5, 9), displacement=1e-7 * np.sin(np.arange(9.0)) ** 2),
        4e-5,
        5,
    ),
    "unequal grains": scene_of(
        Chain(grains=40, diameter=1e-3 * 0.97 ** np.arange(40)), Impulse(velocity=1e-3), 3e-5, 5
    ),
}
ENDLESS = scene_of(column(200, material="glass"), Impulse(velocity=1e-5, grain=100), 1.0, 101)


def same(one: Trajectory, other: Trajectory) -> bool:
    return np.array_equal(one.displacement, other.displacement) and np.array_equal(
        one.velocity, other.velocity
    )


ACTING = Drive(amplitude=1e-7, frequency=2e4), Force(amplitude=1.0, frequency=2e4, grain=25)


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


def test_a_launcher_that_fails_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    fake = tmp_path / "mpiexec"
    fake.write_text("#!/bin/sh\necho no such host >&2\nexit 3\n")
    fake.chmod(0o755)
    monkeypatch.setattr(mpi, "launcher", lambda: str(fake))
    with pytest.raises(EngineUnavailable, match="the ranks do not start: no such host"):
        simulate(MIDDLE, "lammps", ranks=2)


INTEGRATORS = ("verlet", "kahan-li6", "rkn6")
SLOW = list(zip(SCENES, cycle(INTEGRATORS)))  # Each scene once.


@pytest.mark.parametrize(
    ("name", "integrator"),
    [
        pytest.param(*each, marks=pytest.mark.slow if each in SLOW else pytest.mark.soak)
        for each in product(SCENES, INTEGRATORS)
    ],
)
def test_ranks_give_the_bytes_of_a_single_process(name, integrator):
    scene = SCENES[name]
    options = {"integrator": integrator, "step": 2e-7, "diameter": "physical"}
    one = simulate(scene, engine=Lammps(**options))
    two = simulate(scene, engine=Lammps(**options, ranks=2))
    assert (one.cost.ranks, two.cost.ranks) == (1, 2)
    assert np.abs(one.velocity[-1]).max() > 0
    assert same(one, two)


@pytest.mark.slow
def test_three_ranks_and_the_gauge_diameter():
    one, three = (
        simulate(MIDDLE, engine=Lammps(diameter="gauge", ranks=ranks)) for ranks in (1, 3)
    )
    assert three.cost.ranks == 3
    assert same(one, three)


@pytest.mark.slow
def test_more_ranks_than_grains_are_rejected():
    scene = scene_of(column(2), Impulse(velocity=1e-4), 1e-5, 3)
    with pytest.raises(InputError, match="ranks: must be at most one per grain"):
        simulate(scene, "lammps", ranks=3)
    for wrong in (0, -1, 2.0, True):
        with pytest.raises(InputError, match="ranks: must be a whole number"):
            Lammps(ranks=wrong)
    assert same(simulate(scene, "lammps"), simulate(scene, "lammps", ranks=2))


@pytest.mark.slow
def test_dump_of_two_ranks(tmp_path):
    """The files of a run do not depend on the number of ranks."""
    for ranks in (1, 2):
        simulate(
            MIDDLE,
            engine=Lammps(
                "verlet", step=1e-7, diameter="physical", keep=tmp_path / str(ranks), ranks=ranks
            ),
        )
    for name in ("column.lammpstrj", "in.column", "column.data"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()


def mpirun(*words: str | Path, ranks: int = 2, **options) -> subprocess.Popen[str]:
    command = [MPIEXEC, "-n", str(ranks), sys.executable, *map(str, words)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )


@pytest.mark.slow
def test_plain_mpirun_of_the_command_line(tmp_path):
    MIDDLE.to_toml(tmp_path / "scene.toml")
    words = ("-m", "lmpchain.cli", "run", tmp_path / "scene.toml", "--engine", "lammps", "-o")
    code, said = ended(mpirun(*words, tmp_path / "two.nc"))
    assert code == 0, said
    assert said.count("engine ") == 1, "one rank speaks for all"
    two = Trajectory.load(tmp_path / "two.nc")
    assert two.cost.ranks == 2
    assert same(two, simulate(MIDDLE, "lammps"))
    code, said = ended(
        mpirun("-m", "lmpchain.cli", "run", tmp_path / "scene.toml", "-o", tmp_path / "native.nc")
    )
    assert code == 0
    assert said.count("the engine auto runs on one rank") == 1
    code, said = ended(mpirun("-m", "lmpchain.cli", "run", tmp_path / "none.toml"))
    assert code == 2
    assert said.count("there is no such file") == 1
    code, said = ended(mpirun(*words, tmp_path / "three.nc", "--ranks", "3"))
    assert code == 2
    assert "leave the number of ranks out" in said


MPICH = {"PMI_SIZE": "4", "PMI_RANK": "1", "PMI_FD": "99"}
OPEN_MPI = {"OMPI_COMM_WORLD_SIZE": "4", "OMPI_COMM_WORLD_RANK": "3"}
SLURM = {"SLURM_PROCID": "2", "SLURM_STEP_ID": "0", "SLURM_STEP_NUM_TASKS": "4"}


@pytest.mark.slow
def test_the_variables_of_another_program(tmp_path):
    """A command started by another MPI program runs on its own on each rank, as does LAMMPS."""
    MIDDLE.to_toml(tmp_path / "scene.toml")
    scene = f"{tmp_path}/scene.toml"
    for words, output in (
        (("run", scene, "--engine", "native", "-o"), "run.nc"),
        (("run", scene, "-o"), "folder/"),
        (("compare", scene, "--engines", "lammps,native", "--json"), "compared.json"),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "lmpchain.cli", *words, f"{tmp_path}/{output}"],
            env=os.environ | MPICH | OPEN_MPI | SLURM,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert "rank" not in done.stderr
        assert (tmp_path / output).exists()
    assert same(Trajectory.load(tmp_path / "run.nc"), simulate(MIDDLE, "native"))


@pytest.mark.slow
def test_scripts_under_mpirun_run_alone(tmp_path):
    """A script that every rank runs separately, such as a sweep, gets one LAMMPS per rank."""
    script = tmp_path / "script.py"
    script.write_text(
        "import lmpchain, sys\n"
        f"scene = lmpchain.Scene.from_toml({str(tmp_path / 'scene.toml')!r})\n"
        "t = lmpchain.simulate(scene, 'lammps')\n"
        "sys.stdout.write(f'{t.cost.ranks} {t.velocity[-1].sum()!r}\\n')\n"
    )
    MIDDLE.to_toml(tmp_path / "scene.toml")
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
        simulate(
            ENDLESS, engine=Lammps(integrator="verlet", step=1e-7, diameter="physical", ranks=2)
        )
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
    words = [
        "run",
        tmp_path / "endless.toml",
        "--engine",
        "lammps",
        "--integrator",
        "verlet",
        "--step",
        "1e-7",
    ]
    mark = f"MARK={os.getpid()}-{tmp_path.name}"
    environment = os.environ | dict([mark.split("=")])
    process = mpirun(
        "-m",
        "lmpchain.cli",
        *words,
        "--diameter",
        "physical",
        "-o",
        tmp_path / "x.nc",
        env=environment,
    )
    ranks: dict[int, int] = {}

    def started() -> bool:
        assert process.poll() is None, "it ended too early"
        for each in processes(mark):
            with suppress(OSError):
                entries = Path(f"/proc/{each}/environ").read_bytes().split(b"\0")
                ranks.update(
                    {int(entry[9:]): each for entry in entries if entry.startswith(b"PMI_RANK=")}
                )
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
def test_an_error_on_one_rank_ends_all_ranks_with_its_message(tmp_path):
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
        f"sys.exit(cli.main(['run', {str(tmp_path / 'scene.toml')!r}, '--engine', 'lammps']))\n"
    )
    MIDDLE.to_toml(tmp_path / "scene.toml")
    code, said = ended(mpirun(script))
    assert code == 1
    assert "error: rank 1: the third digit of pi" in said


@pytest.mark.slow
def test_a_foreign_mpirun_is_recognised(monkeypatch, tmp_path):
    MIDDLE.to_toml(tmp_path / "scene.toml")
    words = ["run", str(tmp_path / "scene.toml"), "--engine", "lammps"]
    done = subprocess.run(
        [sys.executable, "-m", "lmpchain.cli", *words],
        env=os.environ | {"OMPI_COMM_WORLD_SIZE": "2"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "mpirun has started 2 processes, but MPI finds 1," in done.stderr
    fake = tmp_path / "mpiexec"
    # The script starts one process, whatever number is requested.
    fake.write_text('#!/bin/sh\nshift 2\nexec "$@"\n')
    fake.chmod(0o755)
    monkeypatch.setattr(mpi, "launcher", lambda: str(fake))
    with pytest.raises(EngineUnavailable, match="cannot communicate"):
        simulate(MIDDLE, "lammps", ranks=2)
