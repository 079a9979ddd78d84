"""A run folder: the task, the samples so far, and the state to resume the run from bit for bit.

scene.toml, run.json
    The task (`lmpchain.simulation.task`), and every session that worked on it: command, host,
    versions.
status.json
    Running, stopped, finished or failed, why, and how far; see `status` for a run that was killed.
trajectory.zarr
    The samples (`lmpchain.trajectory.zarr_store`); any Zarr reader opens it, also while the run
    goes on.
checkpoint, checkpoint-before
    `lmpchain.simulation.checkpoints`.
deck, log.lammps
    Of a run in LAMMPS: input that `lmp` runs by itself; what LAMMPS said, session by session.
SHA256SUMS
    Of what is final, once it is finished.
"""

from __future__ import annotations

import json
import math
import os
import platform
import shutil
import time
import warnings
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict
from os import PathLike
from pathlib import Path
from typing import Any

from .. import engines
from ..engines.base import Engine, Run
from ..engines.step_control import Attempt, Outcome
from ..errors import EngineUnavailable, InputError, LmpchainError
from ..trajectory import zarr_store as store
from ..trajectory.record import Block, Cost, subject
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.files import make_folder, replacing
from ..util.provenance import checksums, now
from . import checkpoints
from . import task as tasks
from .policy import record
from .signals import Requests, Stopped
from .task import LOCK, STATUS, Task, resume_command

SUMS = "SHA256SUMS"
STATES = ("running", "stopped", "finished", "failed")
SHARE = 0.01  # of the time that checkpoints may take
OFTEN_S = 1.0  # shortest time between two
LOOK_S = 1.0  # more than `status` keeps the lock
PATIENCE_S = 5.0  # how long a stop waits for the sample at work, so that it need not be done again
SPENT = ("integration_s", "estimate_s", "setup_s")


def status(folder: str | PathLike[str]) -> dict[str, Any]:
    """Return what the status file of a run folder says, or that the run was killed.

    Raises
    ------
    InputError
        If this is not a run folder.
    """
    path = tasks.check_run(folder) / STATUS
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        if (
            said["state"] not in STATES
            or not 0 < said["tolerance"] < 1
            or not isinstance(said["reason"], str)
        ):
            raise ValueError("it does not say how the run stands")
        said |= {"best_effort": bool(said["best_effort"])}
    except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
        raise InputError.at(str(path), f"was changed and cannot be read: {error}") from None
    return said | _killed(path) if said["state"] == "running" else said


def _killed(path: Path) -> dict[str, str]:
    """Return what to say in place of "running" if no process is at work any more."""
    with suppress(OSError):  # perhaps it may be read only
        if lock := _lock(path.parent):
            try:
                # it may have come to its end just now
                state = json.loads(path.read_text(encoding="utf-8"))["state"]
            finally:
                lock.release()
            if state == "running":
                return {"state": "killed", "reason": "the process that was at work was killed"}
    return {}


def _lock(folder: Path, patience: float = 0.0) -> Any:
    """Return the lock of a run folder once it is free, None if another process keeps it."""
    from filelock import FileLock, Timeout

    lock = FileLock(folder / LOCK, timeout=patience)
    try:
        lock.acquire()
    except Timeout:
        return None
    return lock


class RunFolder:
    """A run folder at work, locked inside its context: new for a task, or with the one that it holds.

    Attributes
    ----------
    task : Task
    attempt : Attempt or None
        The one to go on with.
    samples : int
        That are done.
    requests : Requests
        To stop.
    """

    task: Task

    def __init__(
        self,
        folder: str | PathLike[str],
        requests: Requests,
        task: Task | None = None,
        ranks: int | None = None,
    ):
        self._ranks = ranks
        self.name = str(folder)
        self.path = Path(folder)
        self.requests = requests
        self._new = task
        self.attempt: Attempt | None = None
        self.samples = 0
        self._state: Mapping[str, Array] = {}
        self._before = dict.fromkeys(("wall_s", *SPENT), 0.0)  # spent by the sessions before, s
        self._estimate: float | None = None
        self._began = time.monotonic()

    def __enter__(self) -> RunFolder:
        if self._new:
            tasks.check_kept(self._new.policy)
            make_folder(tasks.check_new(self.path))
        else:
            tasks.check_run(self.path)
        self._lock = self._locked()
        try:
            # by a kill
            for left in (
                *self.path.rglob(".*.partial*"),
                *(self.path / store.NAME).rglob("*.partial"),
            ):
                left.unlink()
            if self._new:
                self.task = self._new
                tasks.check_new(self.path)  # another may have been faster
                self._say("running")
                tasks.write(self.path, self.task)
            else:
                self.task = tasks.read(self.path, self._ranks)
                self._find()
                # what the sessions before did after their last checkpoint
                with suppress(InputError, LookupError):
                    wall_s = float(status(self.path)["wall_s"])
                    self._before["wall_s"] = max(
                        self._before["wall_s"], wall_s if math.isfinite(wall_s) else 0.0
                    )
                self._say("running")
        except BaseException:
            self._lock.release()
            raise
        return self

    def _locked(self) -> Any:
        """Return the lock of the folder, which nobody else has now."""
        try:
            lock = _lock(self.path, LOOK_S)
        except OSError as error:
            raise LmpchainError(f"{self.name}: cannot be written: {error.strerror}") from None
        if not lock:
            raise InputError.at(self.name, tasks.AT_WORK)
        return lock

    def _find(self) -> None:
        """Find the newest checkpoint that is whole, and whose samples are there."""
        lost = False
        for checkpoint in checkpoints.load(self.path):
            if checkpoint and store.usable(
                self.path, self.task.scene, checkpoint.notes.get("samples")
            ):
                notes, self._state = checkpoint
                self.attempt = _attempt(notes, self._before)
                self.samples = notes["samples"]
                self._before = notes["spent"]
                break
            lost = True
        if lost:
            where = f"the one before, at sample {self.samples}" if self.attempt else "the start"
            warnings.warn(
                f"{self.name}: the newest checkpoint is damaged; going on from {where}",
                stacklevel=2,
            )

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        # no run that could be gone on with
        if isinstance(error, InputError) and self._new and not self.samples:
            shutil.rmtree(self.path, ignore_errors=True)
        elif error:
            stopped = isinstance(error, Stopped) or not isinstance(error, Exception)
            with suppress(OSError):  # the disk may be full
                self._say(
                    "stopped" if stopped else "failed",
                    str(error) or self.requests.reason or "interrupted",
                )
        self._lock.release()
        self.requests.pass_on()
        if isinstance(error, OSError | EngineUnavailable):
            what = str(error)
            if isinstance(error, OSError):
                what = (
                    f"{error.filename or self.name}: cannot be written: {error.strerror or error}"
                )
            kept = (
                f"{self.samples} of {self.task.scene.samples} samples were done and most are kept"
            )
            kind = type(error) if isinstance(error, LmpchainError) else LmpchainError
            raise kind(
                f"{what}; {kept}; when that is put right, {resume_command(self.name)} goes on"
            ) from error

    def prepare(self, engine: Engine) -> Engine:
        """Return the engine that answers, which writes what it says on the way into this folder."""
        self._engine = engine.prepare(self.path)
        return self._engine

    def begin(self, attempt: Attempt) -> Mapping[str, Array] | None:
        """Make ready for an attempt; return the state to go on from if it is the one that was at work before."""
        state = self._state
        self._state = {}
        self.attempt = attempt
        if not state:
            self.samples = 0
            self._before = self._before | dict.fromkeys(SPENT, 0.0)
            # both: none may tell of the attempt before, whose samples go
            for _ in checkpoints.NAMES:
                checkpoints.save(self.path, self._notes(self._before), {})
            engine = self._engine
            scene = self.task.scene
            choices = record(engine, scene, attempt.candidate, self.task.tolerance)
            store.create(self.path, scene, subject(scene, engine.name, engine.equation, choices))
            engine.write_inputs(scene.fine, attempt.candidate, self.task.tolerance, self.path)
        self._writer = store.Writer(self.path, self.task.scene, self.samples)
        self._next = time.monotonic() + OFTEN_S
        return state or None

    def collect(self, run: Run, blocks: Iterable[Block]) -> None:
        """Bring the blocks of a run to the disk, with a checkpoint now and then.

        Raises
        ------
        Stopped
            As soon as it is asked for, and what is done is kept.
        """
        asked = math.inf
        for block in blocks:
            fresh = block.samples.stop > block.samples.start or block.resumable
            if fresh:
                self._writer.put(block)
                self.samples = block.samples.stop
            reason = self.requests.reason
            moment = time.monotonic()
            if fresh and (reason or moment >= self._next):
                self._checkpoint(run)
            if reason:
                asked = min(asked, moment)
                if fresh or moment >= asked + PATIENCE_S:
                    done = f"after {self.samples} of {self.task.scene.samples} samples"
                    raise Stopped(f"{reason} {done}; {resume_command(self.name)} goes on")
        self._writer.flush()

    def _checkpoint(self, run: Run) -> None:
        began = time.monotonic()
        self._writer.flush()
        error = run.errors()[0]
        self._estimate = error.total
        self._writer.note(error.estimate)
        checkpoints.save(self.path, self._notes(self._spent(run.cost())), run.state())
        self._say("running")
        self._next = time.monotonic() + max(OFTEN_S, (time.monotonic() - began) / SHARE)

    def _notes(self, spent: Mapping[str, float]) -> dict[str, Any]:
        assert self.attempt
        attempt = self.attempt._asdict()
        candidate = self.attempt.candidate._asdict()
        if sharper := self.attempt.candidate.sharper:
            candidate["sharper"] = asdict(sharper)
        return {
            "attempt": attempt | {"candidate": candidate},
            "samples": self.samples,
            "spent": spent,
        }

    def _spent(self, cost: Cost) -> dict[str, float]:
        """Return what all sessions have spent on this attempt, s; on the wall, on all of them."""
        now = cost._asdict() | {"wall_s": time.monotonic() - self._began}
        return {key: value + now[key] for key, value in self._before.items()}

    def finish(self, outcome: Outcome[None], gathered: Mapping[str, Array]) -> Trajectory:
        """Note how the run ended; return the answer, which stays on the disk."""
        spent: Any = self._spent(outcome.cost)
        self._estimate = outcome.error.total
        self._writer.conclude(
            outcome.error.estimate,
            outcome.cost._replace(**{key: spent[key] for key in SPENT}),
            gathered,
        )
        with replacing(self.path / SUMS) as aside:
            aside.write_text(
                checksums(self.path, {STATUS, SUMS, *checkpoints.NAMES}), encoding="utf-8"
            )
        self._say("finished", outcome.missed)
        return Trajectory.load(self.path)

    def _say(self, state: str, reason: str = "") -> None:
        """Write the status file."""
        attempt = self.attempt
        said = {
            "state": state,
            "reason": reason,
            "samples_done": self.samples,
            "samples": self.task.scene.samples,
            "attempt": attempt.number if attempt else 0,
            "step_s": attempt.candidate.step if attempt else None,
            "tolerance": self.task.tolerance,
            "best_effort": self.task.best_effort,
            "error_estimate": self._estimate
            if self._estimate is not None and math.isfinite(self._estimate)
            else None,
            "wall_s": self._before["wall_s"] + time.monotonic() - self._began,
            "updated": now(),
            "host": platform.node(),
            "pid": os.getpid(),
        }
        with replacing(self.path / STATUS) as aside:
            aside.write_text(json.dumps(said, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _attempt(notes: Mapping[str, Any], spent: Mapping[str, float]) -> Attempt:
    """Return the attempt that a checkpoint tells of, after checking all that it notes."""
    from pydantic import TypeAdapter, ValidationError

    try:
        attempt = TypeAdapter(Attempt).validate_json(json.dumps(notes["attempt"]))
        candidate = attempt.candidate
        known = dict(TypeAdapter(dict[str, float]).validate_python(notes["spent"]))
        if not (
            0 < candidate.step < math.inf
            and candidate.steps_per_landing > 0
            and 0 < attempt.tolerance < 1
        ):
            raise ValueError("it has no steps")
        same = candidate._asdict().keys() == notes["attempt"]["candidate"].keys()
        if not same or known.keys() != spent.keys() or attempt.engine not in engines.names():
            raise ValueError("it is not of this version")
        if not all(0 <= value < math.inf for value in known.values()):
            raise ValueError("it took no time that there is")
    except (ValidationError, TypeError, ValueError, LookupError):
        cure = "go on with that one, or run the scene anew"
        raise InputError.at(
            "checkpoint",
            f"was written by a version of lmpchain that this one does not know: {cure}",
        ) from None
    return attempt
