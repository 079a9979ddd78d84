"""Files of a run folder: the specification of the run, checkpoints and hashes.

Each file of lmpchain has a seal, by which it is recognised, or is listed in SHA256SUMS. Other files
are never replaced or removed.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from .. import engines
from ..engines.base import Engine, Proposal
from ..errors import InputError, check_tolerance, short
from ..integrators.steps import Steps
from ..scene.scene import Scene
from ..trajectory import zarr_store as store
from ..util import mpi
from ..util.arrays import Array
from ..util.files import (
    LOCK,
    SEALED,
    check_tree,
    describe_holder,
    is_aside,
    is_lock,
    path_of,
    read_sealed_json,
    replacing,
    sealed_json,
    take_lock,
    unpack,
)
from ..util.provenance import checksum, checksums, describe_session
from ..util.remarks import warn
from .choice import AUTO, engine_for, refusals

SCENE = "scene.toml"
RUN = "run.json"
STATUS = "status.json"
SUMS = "SHA256SUMS"
CHECKPOINT_FILES = ("checkpoint", "checkpoint-before")
# Fields of a proposal in the notes of older versions, in the order of the list form.
OLD_PROPOSAL = ("step", "active_grains", "model_error", "solver_error", "cost_s", "tolerance",
                "steps_per_landing", "stride", "fixed", "adaptive", "coarse_openings", "integrator",
                "choices")  # fmt: skip
UNSEALED = ("sha256", "sessions", SEALED)  # Keys outside the specification.
IN_STATE = "state."  # Prefix of the arrays of a state in a checkpoint.
HASH = hashlib.sha256
LENGTH = HASH().digest_size
SUM = re.compile(r"([0-9a-f]{64})  (.+)")  # Matches a line of SHA256SUMS.
# Files of the Zarr store: metadata and chunks, also incomplete ones.
IN_STORE = re.compile(
    rf"{re.escape(store.NAME)}/"
    r"(([^/]+/)?zarr(\.json|\.[0-9a-f]{32}\.partial)|[^/]+/c(/\d+)+(\.[0-9a-f]{32}\.partial)?)"
)
FOLDER_IN_STORE = re.compile(rf"{re.escape(store.NAME)}(/[^/]+(/c(/\d+)*)?)?")


def resume_command(folder: str | PathLike[str]) -> str:
    """Return the command that resumes a run."""
    return f"lmpchain resume {shlex.quote(str(folder))}"


def is_run(folder: str | PathLike[str]) -> bool:
    """Return whether this is a run folder."""
    path = path_of(folder)
    return (path / SCENE).exists() and (path / RUN).exists()


def is_sealed(folder: Path) -> bool:
    """Return whether the run specification in a folder is unchanged since lmpchain wrote it."""
    order = read_sealed_json(folder / RUN)
    try:
        text = (folder / SCENE).read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    return order is not None and order["sha256"] == order_hash(order, text)


def engine_of(folder: str | PathLike[str]) -> str:
    """Return the engine of a run folder; empty if none is stated."""
    try:
        return str(json.loads((path_of(folder) / RUN).read_bytes())["engine"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return ""


def at_work(folder: Path) -> str:
    """Return a message that another process has locked a run folder, with the remedy."""
    return f"{describe_holder(folder)} is running here; wait for it, or stop it"


def check_run(folder: str | PathLike[str]) -> Path:
    """Return the path of a run folder; raise `InputError` for any other folder."""
    if not is_run(folder):
        raise InputError.at(
            str(folder), "is not a run folder; create one with lmpchain run SCENE.toml -o FOLDER/"
        )
    try:
        check_tree(path_of(folder))
    except OSError as error:
        raise InputError.at(str(folder), error.strerror or str(error)) from None
    return path_of(folder)


def write_order(
    folder: Path, scene: Scene, engine: Engine | None, tolerance: float, best_effort: bool
) -> None:
    """Write the specification of a new run and this session; engine None stands for "auto".

    The scene is written last, because its file marks a run folder.
    """
    order: dict[str, Any] = {
        "engine": engine.name if engine else AUTO,
        "options": engine.options() if engine else {},
        "tolerance": tolerance,
        "best_effort": best_effort,
    }
    seal = order_hash(order, scene.to_text())
    sessions = [_session(order["options"])]
    _write_order(folder, order | {"sha256": seal, "sessions": sessions})
    scene.to_toml(folder / SCENE)


def order_hash(order: dict[str, Any], scene: str) -> str:
    """Return a hash of the run specification, which reveals a change to its files."""
    fixed = {key: value for key, value in order.items() if key not in UNSEALED}
    return hashlib.sha256(f"{json.dumps(fixed, sort_keys=True)}\n{scene}".encode()).hexdigest()


def check_known(engine: Engine | None) -> None:
    """Raise `InputError` if an engine cannot be used in a run folder."""
    if engine is None:
        return
    name = engine.name
    if name not in engines.names() or type(engine) is not type(engines.get(name)):
        raise InputError.at(
            "engine", "a run folder stores engines by name only: use an engine of lmpchain"
        )
    engine.options()


def read_order(folder: Path, ranks: int | None = None) -> tuple[Scene, Engine | None, float, bool]:
    """Return the arguments of `write_order` from a run folder, and record this session.

    Raises
    ------
    InputError
        If the files of the run specification were changed, or if the engine cannot use these ranks.
    """
    try:
        order = json.loads((folder / RUN).read_text(encoding="utf-8"))
        text = (folder / SCENE).read_bytes().decode("utf-8")
        scene = Scene.from_text(text)
        options = dict(order["options"])
        old_versions = dict(order["sessions"][-1]["packages"])
        # The folder may come from another person, so only a specification that lmpchain wrote is
        # run.
        if order["sha256"] != order_hash(order, text):
            raise ValueError("they differ from those at the start of the run")
        parallel = "ranks" in options
        if parallel and (ranks is not None or mpi.current_world()):
            # The ranks of the surrounding mpirun are used.
            options["ranks"] = ranks
        engine = engine_for(str(order["engine"]), **options)
        # Commands from the folder are never executed.
        check_known(engine)
        check_tolerance(order["tolerance"])
        if not isinstance(order["best_effort"], bool) or not isinstance(order["sessions"], list):
            raise ValueError("an entry is missing or invalid")
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise InputError.at(
            str(folder), f"its {RUN} or {SCENE} was changed and cannot be read: {error}"
        ) from None
    if ranks is not None and not parallel:
        raise InputError.at(
            "ranks", f"the engine {order['engine']} runs on one rank; leave the number of ranks out"
        )
    if reasons := refusals(scene, engine):
        raise InputError(reasons)
    session = _session(options)
    _compare_versions(old_versions, session["packages"])
    _write_order(folder, order | {"sessions": [*order["sessions"], session]})
    return scene, engine, order["tolerance"], order["best_effort"]


def _compare_versions(old: dict[str, Any], new: dict[str, Any]) -> None:
    """Warn of packages whose versions have changed since the last session."""
    changes = [
        f"{name} {new.get(name)}, not {version}"
        for name, version in old.items()
        if new.get(name) != version
    ]
    if changes:
        warn(
            f"the run began with other versions, and results may differ: {'; '.join(changes)}",
            stacklevel=3,
        )


def _session(options: dict[str, Any]) -> dict[str, Any]:
    """Return the record of this session, with its number of ranks if the engine can use several."""
    record = describe_session()
    if "ranks" in options:
        world = mpi.current_world()
        record["ranks"] = world.size if world else options["ranks"] or 1
    return record


def _write_order(folder: Path, order: dict[str, Any]) -> None:
    with replacing(folder / RUN) as aside:
        aside.write_text(sealed_json(order), encoding="utf-8")


def save_checkpoint(folder: Path, notes: Mapping[str, Any], state: Mapping[str, Array]) -> None:
    """Write a checkpoint with a hash, which reveals damage.

    At any time at least one of the two newest checkpoints is complete on the disk.
    """
    # The hash refers to the compressed bytes.
    packed = io.BytesIO()
    arrays = {IN_STATE + name: values for name, values in state.items()}
    np.savez(packed, notes=np.array(json.dumps(notes)), **arrays)  # type: ignore[arg-type]
    content = packed.getbuffer()
    newest, before = (folder / name for name in CHECKPOINT_FILES)
    with replacing(newest) as aside:
        with open(aside, "wb") as opened:
            opened.write(HASH(content).digest())
            opened.write(content)
        # The old checkpoint is renamed first, so that a kill leaves one complete checkpoint.
        if newest.exists():
            os.replace(newest, before)


def load_checkpoints(folder: Path) -> Iterator[tuple[dict[str, Any], dict[str, Array]] | None]:
    """Yield notes and state of the checkpoints, the newest first.

    The state is empty before the first sample. A damaged checkpoint is removed, and None is yielded
    in its place.
    """
    for path in (folder / name for name in CHECKPOINT_FILES):
        if path.exists():
            checkpoint = None
            if is_intact(path):
                checkpoint = _unpack(memoryview(path.read_bytes())[LENGTH:])
            if checkpoint is None:
                path.unlink()
            yield checkpoint


def is_intact(path: Path) -> bool:
    """Return whether a checkpoint is unchanged."""
    content = memoryview(path.read_bytes())
    return HASH(content[LENGTH:]).digest() == content[:LENGTH]


def _unpack(content: memoryview) -> tuple[dict[str, Any], dict[str, Array]] | None:
    try:
        arrays = unpack(content)
        notes = json.loads(str(arrays["notes"]))
        state = {
            name.removeprefix(IN_STATE): values
            for name, values in arrays.items()
            if name.startswith(IN_STATE)
        }
        return dict(notes), state
    except Exception:
        # The file has a valid hash but is not a checkpoint.
        return None


def renew(attempt: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the notes of an attempt from any version to the current format."""
    renewed = dict(attempt)
    if "candidate" in renewed:
        engine = renewed.pop("engine")
        renewed["proposal"] = _renew_proposal(engine, renewed.pop("candidate"))
        if renewed["best"]:
            error, best = renewed["best"]
            old = dict(zip(OLD_PROPOSAL, best, strict=True))
            renewed["best"] = error, _renew_proposal(engine, old)
    return renewed


def _renew_proposal(engine: str, old: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the notes of a proposal from older versions, which did not record steps."""
    new = {key: old[key] for key in OLD_PROPOSAL}
    steps = Steps(
        per_landing=new.pop("steps_per_landing"),
        stride=new.pop("stride"),
        step=new.pop("step"),
        adaptive=new.pop("adaptive"),
        coarse_openings=new.pop("coarse_openings"),
        dense=int(old["stride"] > 1),
    )
    # Diameters were stored as text.
    choices = {
        key: float(text) if key.endswith("_m") else text for key, text in old["choices"].items()
    }
    equation = engines.get(engine).equation
    fields = {"engine": engine, "equation": equation, "steps": steps._asdict(), "choices": choices}
    return Proposal(**new | fields)._asdict()


def check_new(folder: str | PathLike[str]) -> Path:
    """Return the path of a new run folder; raise `InputError` if it cannot be created."""
    path = path_of(folder)
    if path.exists() and not path.is_dir():
        raise InputError.at(str(folder), "is a file; choose another name for the run folder")
    if is_run(path) and is_sealed(path):
        cure = f"continue it with {resume_command(folder)}, or choose another folder"
        raise InputError.at(str(folder), f"contains a run already: {cure}")
    # Files of a run that was killed before it wrote its scene may be replaced.
    if foreign := strangers(path):
        raise InputError.at(
            str(folder),
            f"is neither empty nor a run folder: {_in_words(foreign)} {_were(foreign)} not written "
            "by lmpchain, or changed since; choose another folder",
        )
    return path


def check_replaceable(folder: str | PathLike[str]) -> Path:
    """Return the path of a run folder; raise `InputError` if it contains foreign files."""
    path = check_run(folder)
    if foreign := strangers(path):
        raise InputError.at(
            str(folder),
            f"is not replaced: {_in_words(foreign)} there {_were(foreign)} not written by "
            "lmpchain, or changed since; move them away, or name another folder",
        )
    return path


def _in_words(paths: list[Path]) -> str:
    """Return the names of at most five files, and the number of other files, as text."""
    names = [short(path) for path in paths[:5]]
    others = len(paths) - len(names)
    return ", ".join(names) + (f" and {others} more" if others else "")


def _were(paths: list[Path]) -> str:
    return "were" if len(paths) > 1 else "was"


def strangers(folder: Path) -> list[Path]:
    """Return the files in a folder that are not files of lmpchain's runs."""
    sums = _read_sums(folder)
    return [
        path.relative_to(folder)
        for path in sorted(folder.rglob("*"))
        if not _is_own(folder, path.relative_to(folder), sums)
    ]


def _is_own(folder: Path, name: Path, sums: dict[str, str]) -> bool:
    """Return whether a file or folder is unchanged since lmpchain wrote it."""
    path = folder / name
    text = name.as_posix()
    if path.is_symlink() or not (path.is_dir() or path.is_file()):
        return False
    if path.is_dir():
        parents = {Path(file).parent for file in _inputs()}
        return FOLDER_IN_STORE.fullmatch(text) is not None or name in parents
    # Zarr files have separate hashes.
    if IN_STORE.fullmatch(text) or _is_aside(name):
        return True
    checks: dict[str, Callable[[], bool]] = {
        SCENE: lambda: is_sealed(folder),
        SUMS: lambda: bool(sums),
        LOCK: lambda: is_lock(path),
        **dict.fromkeys((RUN, STATUS), lambda: read_sealed_json(path) is not None),
        **dict.fromkeys(CHECKPOINT_FILES, lambda: is_intact(path)),
    }
    if check := checks.get(text):
        return check()
    if text in sums:
        return text in _names() and checksum(path) == sums[text]
    # A log grows until the run is finished.
    return text in _logs()


def _is_aside(name: Path) -> bool:
    finals = (Path(final) for final in _names())
    return any(name.parent == final.parent and is_aside(name.name, final.name) for final in finals)


def _inputs() -> set[str]:
    return {name for engine in engines.names() for name in engines.class_of(engine).inputs}


def _logs() -> set[str]:
    return {name for engine in engines.names() for name in engines.class_of(engine).logs}


def _names() -> set[str]:
    """Return all possible names of files in a run folder outside the store."""
    return {SCENE, RUN, STATUS, SUMS, *CHECKPOINT_FILES, *_inputs(), *_logs()}


def _read_sums(folder: Path) -> dict[str, str]:
    """Return the hashes that a run folder lists, by name; empty without a list of lmpchain."""
    try:
        lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return {}
    matches = [SUM.fullmatch(line) for line in lines]
    return {match[2]: match[1] for match in matches if match} if all(matches) else {}


def write_sums(folder: Path, finished: bool) -> None:
    """Write the hashes of files: of engine inputs, or, when finished, of all but the status."""
    names = _inputs()
    if finished:
        names |= _names() - {STATUS, SUMS, *CHECKPOINT_FILES}
    by_name = {
        path.relative_to(folder).as_posix(): path
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    paths = [
        path
        for name, path in by_name.items()
        if name in names or (finished and IN_STORE.fullmatch(name))
    ]
    if paths:
        with replacing(folder / SUMS) as aside:
            aside.write_text(checksums(folder, paths), encoding="utf-8")


def half_written(folder: Path) -> Iterator[Path]:
    """Yield incomplete files of a run folder, left by a killed process."""
    for path in folder.rglob("*.partial*"):
        name = path.relative_to(folder)
        if (name.suffix == ".partial" and IN_STORE.fullmatch(name.as_posix())) or _is_aside(name):
            yield path


def clear(folder: Path) -> None:
    """Remove the files of lmpchain from a run folder; keep the folder and other files."""
    sums = _read_sums(folder)
    present = [path.relative_to(folder) for path in sorted(folder.rglob("*"))]
    own = [name for name in present if _is_own(folder, name, sums)]
    # The run specification is removed last, so that after a kill the folder is still replaceable.
    last = [Path(name) for name in (SCENE, RUN, LOCK)]
    files = [name for name in own if not (folder / name).is_dir() and name not in last]
    for name in (*files, *(name for name in last if name in own)):
        (folder / name).unlink(missing_ok=True)
    for name in reversed(own):
        if (folder / name).is_dir():
            # The folder stays if it contains new files.
            with suppress(OSError):
                (folder / name).rmdir()


def remove(folder: Path) -> None:
    """Remove a run from its folder, and keep the folder.

    Raises
    ------
    InputError
        If another process uses the folder, or if it contains files that lmpchain did not write.
    """
    check_replaceable(folder)
    lock = take_lock(folder)
    if lock is None:
        raise InputError.at(str(folder), at_work(folder))
    try:
        # The lock prevents other processes from writing to the folder.
        clear(folder)
    finally:
        lock.release()
