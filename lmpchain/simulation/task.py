"""Tasks of runs, written to the run folder so that another process can go on."""

from __future__ import annotations

import hashlib
import json
import shlex
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from .. import engines
from ..errors import InputError, check_tolerance
from ..scene.scene import Scene
from ..util import mpi
from ..util.files import SEALED, check_tree, path_of, read_sealed_json, replacing, sealed_json
from ..util.provenance import describe_session
from ..util.remarks import warn
from .policy import Named, Policy, policy_for

AT_WORK = "{holder} is at work here; wait for it, or stop it"
SCENE = "scene.toml"
RUN = "run.json"
STATUS = "status.json"
UNSEALED = ("sha256", "sessions", SEALED)  # in run.json: what is no part of the task


class Task(NamedTuple):
    """A scene, the engine that answers, and the tolerance.

    Attributes
    ----------
    scene : Scene
    policy : Policy
        Choice of the engine.
    tolerance : float
    best_effort : bool
        Whether to return the best answer where the tolerance cannot be met.
    """

    scene: Scene
    policy: Policy
    tolerance: float
    best_effort: bool


def resume_command(folder: str | PathLike[str]) -> str:
    """Return the command that goes on with a run."""
    return f"lmpchain resume {shlex.quote(str(folder))}"


def is_run(folder: str | PathLike[str]) -> bool:
    """Return whether this is a run folder."""
    path = path_of(folder)
    return (path / SCENE).exists() and (path / RUN).exists()


def is_sealed(folder: Path) -> bool:
    """Return whether lmpchain wrote the task in a folder, and nobody has changed it since."""
    order = read_sealed_json(folder / RUN)
    try:
        text = (folder / SCENE).read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    return order is not None and order["sha256"] == _seal(order, text)


def engine_of(folder: str | PathLike[str]) -> str:
    """Return the engine that a run folder asks for, empty where it does not say."""
    try:
        return str(json.loads((path_of(folder) / RUN).read_bytes())["engine"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return ""


def check_run(folder: str | PathLike[str]) -> Path:
    """Return the path of a run folder; raises `InputError` if it is none."""
    if not is_run(folder):
        raise InputError.at(
            str(folder), "is no run folder; lmpchain run SCENE.toml -o FOLDER/ makes one"
        )
    try:
        check_tree(path_of(folder))
    except OSError as error:
        raise InputError.at(str(folder), error.strerror or str(error)) from None
    return path_of(folder)


def write(folder: Path, task: Task) -> None:
    """Write a new task and this session; the scene comes last, which makes a run folder of it."""
    order: dict[str, Any] = {
        "engine": task.policy.name,
        "options": task.policy.options(),
        "tolerance": task.tolerance,
        "best_effort": task.best_effort,
    }
    seal = _seal(order, task.scene.to_text())
    sessions = [_session(order["options"])]
    _write_order(folder, order | {"sha256": seal, "sessions": sessions})
    task.scene.to_toml(folder / SCENE)


def _seal(order: dict[str, Any], scene: str) -> str:
    """Return a hash of the task, by which a change to its files is noticed."""
    fixed = {key: value for key, value in order.items() if key not in UNSEALED}
    return hashlib.sha256(f"{json.dumps(fixed, sort_keys=True)}\n{scene}".encode()).hexdigest()


def check_policy(policy: Policy) -> None:
    """Raise `InputError` if an engine cannot work in a run folder."""
    if isinstance(policy, Named):
        name = policy.name
        names = engines.names()
        if name not in names or type(policy.chosen) is not type(engines.get(name)):
            raise InputError.at(
                "engine", "a run folder knows engines by name only, and this is none of lmpchain's"
            )
    policy.options()


def read(folder: Path, ranks: int | None = None) -> Task:
    """Return the task of a run folder, and note that this session works on it.

    Raises
    ------
    InputError
        If the files of the task were changed, or its engine cannot use these ranks.
    """
    try:
        order = json.loads((folder / RUN).read_text(encoding="utf-8"))
        text = (folder / SCENE).read_bytes().decode("utf-8")
        scene = Scene.from_text(text)
        options = dict(order["options"])
        old_versions = dict(order["sessions"][-1]["packages"])
        # a folder may come from elsewhere: what it asks for must be what lmpchain wrote
        if order["sha256"] != _seal(order, text):
            raise ValueError("they are not those that the run began with")
        parallel = "ranks" in options
        if parallel and (ranks is not None or mpi.current_world()):
            # those of mpirun serve
            options["ranks"] = ranks
        policy = policy_for(str(order["engine"]), **options)
        # no commands of whoever wrote this folder
        check_policy(policy)
        check_tolerance(order["tolerance"])
        if not isinstance(order["best_effort"], bool) or not isinstance(order["sessions"], list):
            raise ValueError("they do not say what was asked")
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise InputError.at(
            str(folder), f"its {RUN} or {SCENE} was changed and cannot be read: {error}"
        ) from None
    if ranks is not None and not parallel:
        raise InputError.at(
            "ranks", f"the engine {order['engine']} runs on one; leave the number of ranks out"
        )
    if reasons := policy.refuses(scene):
        raise InputError(reasons)
    session = _session(options)
    _compare_versions(old_versions, session["packages"])
    _write_order(folder, order | {"sessions": [*order["sessions"], session]})
    return Task(scene, policy, order["tolerance"], order["best_effort"])


def _compare_versions(old: dict[str, Any], new: dict[str, Any]) -> None:
    """Warn of packages with another version than in the last session."""
    changes = [
        f"{name} {new.get(name)}, not {version}"
        for name, version in old.items()
        if new.get(name) != version
    ]
    if changes:
        warn(
            f"the run went so far with other versions, and may now differ: {'; '.join(changes)}",
            stacklevel=3,
        )


def _session(options: dict[str, Any]) -> dict[str, Any]:
    """Return the record of this session, with its ranks where the engine can use several."""
    record = describe_session()
    if "ranks" in options:
        world = mpi.current_world()
        record["ranks"] = world.size if world else options["ranks"] or 1
    return record


def _write_order(folder: Path, order: dict[str, Any]) -> None:
    with replacing(folder / RUN) as aside:
        aside.write_text(sealed_json(order), encoding="utf-8")
