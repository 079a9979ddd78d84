"""A run folder: run specification, samples, and the state from which the run is resumed.

scene.toml, run.json
    The specification of the run (scene, engine, tolerance), and the command, host and versions of
    every session.
status.json
    The state of the run (running, stopped, finished or failed), its reason, and the progress. The
    function `status` also recognises a run that was killed.
trajectory.zarr
    The samples (`lmpchain.trajectory.zarr_store`). Any Zarr reader can open them, also during the
    run.
checkpoint, checkpoint-before
    The two newest states, from which a run is resumed.
deck, log.lammps
    For a run in LAMMPS: the input, which `lmp` can run without lmpchain, and the log of every
    session.
SHA256SUMS
    Hashes of final files: of the deck, and of all files of lmpchain when the run is finished.

Files that lmpchain did not write, and files that were changed since, are never replaced or removed
(`lmpchain.simulation.folder_files`). No new run starts in a folder with such files.
"""

from __future__ import annotations

import json
import math
import os
import platform
import signal
import threading
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from .. import engines
from ..engines.base import Engine, Run
from ..engines.step_control import Attempt, Outcome
from ..errors import EngineUnavailable, InputError, LmpchainError, shown
from ..scene.scene import Scene
from ..trajectory import zarr_store as store
from ..trajectory.record import Block, Cost, subject
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.files import SEALED, make_folder, path_of, replacing, sealed_json, take_lock
from ..util.provenance import now
from ..util.remarks import warn
from ..util.tables import finite
from . import folder_files as files
from .choice import record
from .folder_files import STATUS, check_run, resume_command

STATES = ("running", "stopped", "finished", "failed")
SIGNALS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}
SPENT = ("integration_s", "estimate_s", "setup_s")


class Intervals(NamedTuple):
    """Time intervals of periodic tasks in a run folder.

    Attributes
    ----------
    checkpoint_share : float
        Largest fraction of the time for checkpoints.
    checkpoint_s : float
        Shortest time between two checkpoints, s.
    lock_s : float
        Longest wait for the lock of the folder, s; `status` locks the folder for a shorter time.
    sample_s : float
        Longest time for which a requested stop waits for the next sample, s.
    """

    checkpoint_share: float = 0.01
    checkpoint_s: float = 1.0
    lock_s: float = 1.0
    sample_s: float = 5.0


INTERVALS = Intervals()


class Stopped(LmpchainError):
    """Raised when a run is stopped before its end; `lmpchain.resume` continues the run."""


class Requests:
    """Requests to stop; inside this context, a signal only sets a request.

    Parameters
    ----------
    max_wall : float, optional
        Time from now on after which the run is requested to stop, s.
    """

    def __init__(self, max_wall: float | None):
        # NumPy's numbers are real numbers, but so are Booleans.
        real = isinstance(max_wall, Real) and not isinstance(max_wall, bool)
        if max_wall is not None and not (real and max_wall > 0):
            raise InputError.at("max_wall", f"must be a time above 0 s (got {shown(max_wall)})")
        self._deadline = time.monotonic() + (math.inf if max_wall is None else max_wall)
        self._before: dict[int, Any] = {}
        self._number: int | None = None

    def __enter__(self) -> Requests:
        if threading.current_thread() is threading.main_thread():
            # Only the main thread receives signals. Signals that are ignored, for example by nohup,
            # stay ignored.
            handlers = {number: signal.getsignal(number) for number in SIGNALS}
            self._before = {n: h for n, h in handlers.items() if h not in (signal.SIG_IGN, None)}
            for number in self._before:
                signal.signal(number, self._note)
        return self

    def _note(self, number: int, _: Any) -> None:
        self._number = number

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @property
    def reason(self) -> str:
        """Cause of the stop request; empty without a request."""
        if self._number is not None:
            return f"stopped by {SIGNALS[signal.Signals(self._number)]}"
        return "stopped at the end of its time" if time.monotonic() >= self._deadline else ""

    def pass_on(self) -> None:
        """Raise the received signal again for the handler outside the context."""
        if self._number is not None:
            signal.raise_signal(self._number)


def status(folder: str | PathLike[str]) -> dict[str, Any]:
    """Return the state of a run in a folder, with the reason and the samples done.

    Raises
    ------
    InputError
        If this is not a run folder.
    """
    path = check_run(folder) / STATUS
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        if report["state"] not in STATES or not isinstance(report["reason"], str):
            raise ValueError("the state of the run is missing or invalid")
        if not 0 < report["tolerance"] < 1:
            raise ValueError("its tolerance is invalid")
        report["best_effort"] = bool(report["best_effort"])
        # Older files have no horizon.
        horizon_s = report.setdefault("known_until", None)
        if horizon_s is not None and not horizon_s > 0:
            raise ValueError("its predictability horizon is invalid")
        report.pop(SEALED, None)
    except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
        raise InputError.at(str(path), f"was changed and cannot be read: {error}") from None
    return report | _find_kill(path) if report["state"] == "running" else report


def _find_kill(path: Path) -> dict[str, str]:
    """Return the state "killed" if no process has the lock of the folder."""
    # The folder may be read-only.
    with suppress(OSError):
        if lock := take_lock(path.parent):
            try:
                # The run may have ended just now.
                state = json.loads(path.read_text(encoding="utf-8"))["state"]
            finally:
                lock.release()
            if state == "running":
                return {"state": "killed", "reason": "the process of the run was killed"}
    return {}


class RunFolder:
    """A run folder, locked inside its context: either new, or of a run to resume.

    Attributes
    ----------
    scene : Scene
        The requested scene.
    engine : Engine or None
        The requested engine; None stands for "auto".
    tolerance : float
        The requested tolerance.
    best_effort : bool
        Whether to return the best answer if the tolerance cannot be met.
    attempt : Attempt or None
        The attempt to continue; None if the run starts from the beginning.
    samples : int
        Number of samples computed so far.
    requests : Requests
        Requests to stop.
    """

    scene: Scene

    def __init__(
        self,
        folder: str | PathLike[str],
        requests: Requests,
        scene: Scene | None = None,
        engine: Engine | None = None,
        tolerance: float = math.nan,
        best_effort: bool = False,
        ranks: int | None = None,
    ):
        self._ranks = ranks
        self.name = str(folder)
        self.path = path_of(folder)
        self.requests = requests
        self._is_new = scene is not None
        if scene:
            self.scene = scene
        self.engine = engine
        self.tolerance = tolerance
        self.best_effort = best_effort
        self.attempt: Attempt | None = None
        self.samples = 0
        self._state: Mapping[str, Array] = {}
        # Times of earlier sessions, s.
        self._before = dict.fromkeys(("wall_s", *SPENT), 0.0)
        self._estimate: float | None = None
        self._horizon = math.inf
        self._began = time.monotonic()

    def __enter__(self) -> RunFolder:
        if self._is_new:
            files.check_known(self.engine)
            self._made = not files.check_new(self.path).exists()
            make_folder(self.path)
        else:
            check_run(self.path)
        self._lock = self._take_lock()
        try:
            for path in files.half_written(self.path):
                path.unlink()
            if self._is_new:
                # Another process may have created the run meanwhile.
                files.check_new(self.path)
                self._write_status("running")
                asked = self.scene, self.engine, self.tolerance, self.best_effort
                files.write_order(self.path, *asked)
            else:
                asked = files.read_order(self.path, self._ranks)
                self.scene, self.engine, self.tolerance, self.best_effort = asked
                self._load_checkpoint()
                # The times in the status include the work after the last checkpoint.
                with suppress(InputError, LookupError):
                    wall_s = float(status(self.path)["wall_s"])
                    if math.isfinite(wall_s):
                        self._before["wall_s"] = max(self._before["wall_s"], wall_s)
                self._write_status("running")
        except BaseException:
            self._lock.release()
            raise
        return self

    def _take_lock(self) -> Any:
        """Lock the folder and return its lock; raise `InputError` if another process has it."""
        try:
            lock = take_lock(self.path, INTERVALS.lock_s)
        except OSError as error:
            raise LmpchainError(f"{self.name}: cannot be written: {error.strerror}") from None
        if not lock:
            raise InputError.at(self.name, files.at_work(self.path))
        return lock

    @property
    def _known(self) -> Scene:
        """The scene up to its predictability horizon."""
        return self.scene.until(self.attempt.known_until) if self.attempt else self.scene

    def _load_checkpoint(self) -> None:
        """Load the newest complete checkpoint whose samples are stored."""
        damaged = False
        for checkpoint in files.load_checkpoints(self.path):
            if checkpoint:
                notes, state = checkpoint
                self.attempt = _read_attempt(notes, self._before)
                if store.usable(self.path, self._known, notes.get("samples")):
                    self._state = state
                    self.samples = notes["samples"]
                    self._before = notes["spent"]
                    break
                self.attempt = None
            damaged = True
        if damaged:
            start = f"the one before, at sample {self.samples}" if self.attempt else "the start"
            warn(
                f"{self.name}: the newest checkpoint is damaged; going on from {start}",
                stacklevel=2,
            )

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        # Without samples there is no run to resume.
        if isinstance(error, InputError) and self._is_new and not self.samples:
            files.clear(self.path)
            if self._made:
                # The folder stays if it contains other files.
                with suppress(OSError):
                    self.path.rmdir()
        elif error:
            stopped = isinstance(error, Stopped) or not isinstance(error, Exception)
            # The disk may be full.
            with suppress(OSError):
                reason = str(error) or self.requests.reason or "interrupted"
                self._write_status("stopped" if stopped else "failed", reason)
        self._lock.release()
        # Ctrl-C ends the program only after all files are written.
        self.requests.pass_on()
        if isinstance(error, OSError | EngineUnavailable):
            fault = str(error)
            kind: type[LmpchainError] = EngineUnavailable
            if isinstance(error, OSError):
                path = error.filename or self.name
                fault = f"{path}: cannot be written: {error.strerror or error}"
                kind = LmpchainError
            done = f"{self.samples} of {self._known.samples} samples were computed"
            cure = f"remove the cause, then continue with {resume_command(self.name)}"
            raise kind(f"{fault}; {done} and most are kept; {cure}") from error

    def prepare(self, engine: Engine) -> Engine:
        """Return the engine that solves the scene; it writes its messages to this folder."""
        self._answering = engine.prepare(self.path)
        return self._answering

    def begin(self, attempt: Attempt) -> Mapping[str, Array] | None:
        """Prepare the files of an attempt; return the state if the run is continued from it."""
        state = self._state
        self._state = {}
        self.attempt = attempt
        if not state:
            self.samples = 0
            self._before = self._before | dict.fromkeys(SPENT, 0.0)
            # Both checkpoints are replaced, because the samples of an earlier attempt are removed.
            for _ in files.CHECKPOINT_FILES:
                files.save_checkpoint(self.path, self._notes(self._before), {})
            engine = self._answering
            scene = self._known
            choices = record(engine, scene, attempt.proposal, self.tolerance)
            store.create_zarr(
                self.path, scene, subject(scene, engine.name, engine.equation, choices)
            )
            engine.write_inputs(scene.fine, attempt.proposal, self.tolerance, self.path)
            files.write_sums(self.path, finished=False)
        self._writer = store.Writer(self.path, self._known, self.samples)
        self._next = time.monotonic() + INTERVALS.checkpoint_s
        return state or None

    def collect(self, run: Run, blocks: Iterable[Block]) -> None:
        """Write the blocks of a run to disk, with checkpoints.

        Raises
        ------
        Stopped
            After a request to stop, once the samples so far are written.
        """
        request = math.inf
        for block in blocks:
            # A block without samples only returns control while the engine is working.
            fresh = block.samples.stop > block.samples.start or block.resumable
            if fresh:
                self._writer.put(block)
                self.samples = block.samples.stop
            reason = self.requests.reason
            moment = time.monotonic()
            if fresh and (reason or moment >= self._next):
                self._checkpoint(run)
            if reason:
                request = min(request, moment)
                if fresh or moment >= request + INTERVALS.sample_s:
                    done = f"after {self.samples} of {self._known.samples} samples"
                    raise Stopped(f"{reason} {done}; continue with {resume_command(self.name)}")
        self._writer.flush()

    def _checkpoint(self, run: Run) -> None:
        began = time.monotonic()
        self._writer.flush()
        error = run.errors()[0]
        self._estimate = error.estimate.total
        # Samples are written before the checkpoint that counts them.
        self._writer.note(error.estimate)
        files.save_checkpoint(self.path, self._notes(self._spent(run.cost())), run.state())
        self._write_status("running")
        now = time.monotonic()
        pause = (now - began) / INTERVALS.checkpoint_share
        self._next = now + max(INTERVALS.checkpoint_s, pause)

    def _notes(self, spent: Mapping[str, float]) -> dict[str, Any]:
        assert self.attempt
        proposal = self.attempt.proposal
        noted = proposal._asdict() | {"steps": proposal.steps._asdict()}
        return {
            "attempt": self.attempt._asdict() | {"proposal": noted},
            "samples": self.samples,
            "spent": spent,
        }

    def _spent(self, cost: Cost) -> dict[str, float]:
        """Return the times of this attempt in all sessions, and the total wall time, s."""
        session = cost._asdict() | {"wall_s": time.monotonic() - self._began}
        return {key: value + session[key] for key, value in self._before.items()}

    def finish(self, outcome: Outcome[None], gathered: Mapping[str, Array]) -> Trajectory:
        """Write the final files; return the trajectory, whose arrays stay on disk."""
        spent: Any = self._spent(outcome.cost)
        cost = outcome.cost._replace(**{key: spent[key] for key in SPENT})
        self._estimate = outcome.error.estimate.total
        self._horizon = outcome.known_until
        self._writer.conclude(outcome.error.estimate, cost, gathered)
        files.write_sums(self.path, finished=True)
        self._write_status("finished", outcome.missed)
        return Trajectory.load(self.path)

    def _write_status(self, state: str, reason: str = "") -> None:
        attempt = self.attempt
        report = {
            "state": state,
            "reason": reason,
            "samples_done": self.samples,
            "samples": self._known.samples,
            "attempt": attempt.number if attempt else 0,
            "step_s": attempt.proposal.step if attempt else None,
            "tolerance": self.tolerance,
            "best_effort": self.best_effort,
            "error_estimate": self._estimate,
            "known_until": self._horizon,
            "wall_s": self._before["wall_s"] + time.monotonic() - self._began,
            "updated": now(),
            "host": platform.node(),
            "pid": os.getpid(),
        }
        with replacing(self.path / STATUS) as aside:
            # JSON cannot represent infinity.
            aside.write_text(sealed_json(finite(report)), encoding="utf-8")


def _read_attempt(notes: Mapping[str, Any], spent: Mapping[str, float]) -> Attempt:
    """Return the attempt of a checkpoint; raise `InputError` if its notes are invalid."""
    from pydantic import TypeAdapter, ValidationError

    try:
        noted = files.renew(notes["attempt"])
        attempt = TypeAdapter(Attempt).validate_json(json.dumps(noted))
        proposal = attempt.proposal
        times = dict(TypeAdapter(dict[str, float]).validate_python(notes["spent"]))
        if not (0 < proposal.step < math.inf and proposal.steps.per_landing > 0):
            raise ValueError("it has no steps")
        if not 0 < attempt.tolerance < 1:
            raise ValueError("it has no tolerance")
        fields = noted["proposal"].keys()
        # Other versions may have more or fewer fields.
        if proposal._asdict().keys() != fields or times.keys() != spent.keys():
            raise ValueError("it has other fields")
        if attempt.proposal.engine not in engines.names():
            raise ValueError("it has no engine")
        if not all(0 <= time_s < math.inf for time_s in times.values()):
            raise ValueError("its times are invalid")
    except (ValidationError, TypeError, ValueError, LookupError):
        cure = "resume with that version, or start the run again"
        raise InputError.at(
            "checkpoint", f"was written by another version of lmpchain: {cure}"
        ) from None
    return attempt
