"""Commands in separate processes: start, observation, stop and output."""

import os
import pty
import re
import select
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import psutil

from lmpchain import Scene, Trajectory
from lmpchain.simulation.run_folder import status
from lmpchain.util import mpi

COMMAND = (sys.executable, "-m", "lmpchain.cli")
HURRIED = (sys.executable, str(Path(__file__).with_name("hurried.py")))
# Time in s after which a process counts as hanging; everything is slow on a busy machine.
PATIENCE = 600.0


def start(
    *words: object, ranks: int = 1, command: Sequence[str] = COMMAND, **options
) -> subprocess.Popen[str]:
    """Start a command of lmpchain, under mpirun if there are several ranks."""
    under = [mpi.launcher(), "-n", str(ranks)] if ranks > 1 else []
    command = [*under, *command, *map(str, words)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options
    )


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Return the exit code and output of a process; kill the process if it hangs."""
    try:
        out, err = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return process.returncode, out + (err or "")


def finish(*words: object, **options) -> tuple[int, str]:
    """Run a command of lmpchain and return its exit code and output."""
    return ended(start(*words, **options))


class Fork:
    """A command in a fork of this process, which avoids imports and compilation."""

    def __init__(
        self,
        main: Callable[[list[str]], int],
        words: Sequence[object],
        environment: Mapping[str, str],
        said: Path,
    ):
        self._said = said
        self._process = get_context("fork").Process(
            target=self._child, args=(main, words, environment)
        )
        self._process.start()
        self.pid: int = self._process.pid or 0

    def _child(
        self,
        main: Callable[[list[str]], int],
        words: Sequence[object],
        environment: Mapping[str, str],
    ) -> None:
        os.setsid()
        os.environ.clear()
        os.environ.update(environment)
        tempfile.tempdir = None  # The folder is determined anew from the environment.
        with open(self._said, "w", encoding="utf-8", buffering=1) as file:
            for number in (1, 2):
                os.dup2(file.fileno(), number)
            sys.stdout = sys.stderr = file
            code = main([str(word) for word in words])
            file.flush()
        os._exit(code)

    def poll(self) -> int | None:
        """Return the exit code of the process after its end, otherwise None."""
        return self._process.exitcode

    def ended(self) -> tuple[int | None, str]:
        """Wait for the end of the process and return its exit code and output."""
        self._process.join(PATIENCE)
        return self.poll(), self._said.read_text(encoding="utf-8") if self._said.exists() else ""


def until(condition: Callable[[], object], every: float = 0.01) -> None:
    """Wait until a condition is true."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(every)


def recorded(folder: Path) -> int:
    """Return the number of samples in a run folder, or -1 if the folder does not exist."""
    return status(folder)["samples_done"] if (folder / "scene.toml").exists() else -1


def at_work(folder: Path, process: subprocess.Popen[str], samples: int = 1) -> None:
    """Wait until a run has stored this number of samples."""

    def reached() -> bool:
        assert process.poll() is None, "it ended too early"
        return recorded(folder) >= samples

    until(reached)


def busy(process: int, seconds: float) -> None:
    """Wait until a process with LAMMPS has used this CPU time, however busy the machine is."""
    watched = psutil.Process(process)

    def spent() -> float:
        times = watched.cpu_times()
        return times.user + times.system

    until(lambda: any("liblammps" in each.path for each in watched.memory_maps()))
    begun = spent()
    until(lambda: spent() > begun + seconds)


@contextmanager
def on_a_terminal(
    *command: object, **options
) -> Iterator[tuple[subprocess.Popen[str], Callable[[str], str]]]:
    """Run a command whose stderr is a terminal, so that it shows its progress.

    Yields the process and a function that reads from the terminal until a pattern is found and
    returns what was read.
    """
    terminal, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 120))
    process = subprocess.Popen(
        [*map(str, command)], stdout=subprocess.PIPE, stderr=theirs, text=True, **options
    )
    os.close(theirs)

    def read_until(wanted: str) -> str:
        said = ""
        while not re.search(wanted, said):
            assert select.select([terminal], [], [], PATIENCE)[0], said
            said += os.read(terminal, 4096).decode()
        return said

    try:
        yield process, read_until
    finally:
        process.kill()
        process.communicate()
        os.close(terminal)


def same(answer: Trajectory, truth: Trajectory) -> bool:
    """Return whether two trajectories agree to the last bit."""
    names = ("time", "displacement", "velocity", "grains")
    bits = all(
        getattr(answer, name)[:].tobytes() == getattr(truth, name)[:].tobytes() for name in names
    )
    return bits and answer.error_estimate == truth.error_estimate and answer.scene == truth.scene


def write(scene: Scene, folder: Path) -> Path:
    """Write a scene file."""
    scene.to_toml(folder / "in.toml")
    return folder / "in.toml"


def processes(mark: str) -> list[int]:
    """Return the processes with this text in their environment."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and mark.encode() in (entry / "environ").read_bytes().split(
                b"\0"
            ):
                found.append(int(entry.name))
        except OSError:
            continue
    return [pid for pid in found if pid != os.getpid()]
