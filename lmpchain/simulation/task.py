"""What a run is to do, written to its folder so that another process can do it."""

from __future__ import annotations

import hashlib
import json
import shlex
import shutil
import warnings
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from .. import engines
from ..errors import InputError, check_tolerance
from ..scene.scene import Scene
from ..util import mpi
from ..util.files import check_tree, replacing
from ..util.provenance import session
from .policy import Named, Policy, policy_for

AT_WORK = "another process is at work here; wait for it, or stop it"
SCENE = "scene.toml"
RUN = "run.json"
STATUS = "status.json"
LOCK = ".lock"


class Task(NamedTuple):
    """What a run is to do.

    Attributes
    ----------
    scene : Scene
    policy : Policy
        Which engine answers.
    tolerance : float
    best_effort : bool
        Whether to do what can be done where the tolerance cannot be met.
    """

    scene: Scene
    policy: Policy
    tolerance: float
    best_effort: bool


def resume_command(folder: str | PathLike[str]) -> str:
    """Return the command that goes on with a run."""
    return f"lmpchain resume {shlex.quote(str(folder))}"


def is_run(folder: str | PathLike[str]) -> bool:
    """Say whether this is a run folder."""
    return (Path(folder) / SCENE).exists() and (Path(folder) / RUN).exists()


def check_run(folder: str | PathLike[str]) -> Path:
    """Return the path of a run folder; raises `InputError` if it is none."""
    if not is_run(folder):
        raise InputError.at(
            str(folder), "is no run folder; lmpchain run SCENE.toml -o FOLDER/ makes one"
        )
    try:
        check_tree(Path(folder))
    except OSError as error:
        raise InputError.at(str(folder), error.strerror or str(error)) from None
    return Path(folder)


def check_new(folder: str | PathLike[str]) -> Path:
    """Return the path of a run folder that is to be made; raises `InputError` if it cannot be."""
    path = Path(folder)
    if path.exists() and not path.is_dir():
        raise InputError.at(str(folder), "is a file; choose another name for the run folder")
    if is_run(path):
        cure = f"go on with it, {resume_command(folder)}, or choose another folder"
        raise InputError.at(str(folder), f"holds a run already: {cure}")
    before = {STATUS, RUN, LOCK}  # the scene, by a run that was killed as it began
    if path.exists() and any(
        p.name not in before and ".partial" not in p.suffixes for p in path.iterdir()
    ):
        raise InputError.at(str(folder), "is neither empty nor a run folder; choose another")
    return path


def remove(folder: Path) -> None:
    """Remove a run folder and the run in it; raises `InputError` if another process is at work there."""
    from filelock import FileLock, Timeout

    try:
        with FileLock(check_run(folder) / LOCK, timeout=0):
            shutil.rmtree(folder)
    except Timeout:
        raise InputError.at(str(folder), AT_WORK) from None


def write(folder: Path, task: Task) -> None:
    """Note a new task and this session; from the moment that the scene is there, `read` finds it."""
    asked: dict[str, Any] = {
        "engine": task.policy.name,
        "options": task.policy.options(),
        "tolerance": task.tolerance,
        "best_effort": task.best_effort,
    }
    seal = _seal(asked, task.scene.to_text())
    _note(folder, asked | {"sha256": seal, "sessions": [_session(asked["options"])]})
    task.scene.to_toml(folder / SCENE)


def _seal(asked: dict[str, Any], scene: str) -> str:
    """Return what the task hashes to, so that a change to its files is noticed."""
    fixed = {key: value for key, value in asked.items() if key not in ("sha256", "sessions")}
    return hashlib.sha256(f"{json.dumps(fixed, sort_keys=True)}\n{scene}".encode()).hexdigest()


def check_kept(policy: Policy) -> None:
    """Raise `InputError` if an engine cannot work in a run folder."""
    if isinstance(policy, Named):
        name = policy.name
        known = engines.names()
        if name not in known or type(policy.chosen) is not type(engines.get(name)):
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
        asked = json.loads((folder / RUN).read_text(encoding="utf-8"))
        text = (folder / SCENE).read_bytes().decode("utf-8")
        scene = Scene.from_text(text)
        options = dict(asked["options"])
        before = dict(asked["sessions"][-1]["packages"])
        if asked["sha256"] != _seal(asked, text):
            raise ValueError("they are not those that the run began with")
        ranked = "ranks" in options
        if ranked and (ranks is not None or mpi.joined()):  # those of mpirun serve
            options["ranks"] = ranks
        policy = policy_for(str(asked["engine"]), **options)
        check_kept(policy)  # no commands of whoever wrote this folder
        check_tolerance(asked["tolerance"])
        if not isinstance(asked["best_effort"], bool) or not isinstance(asked["sessions"], list):
            raise ValueError("they do not say what was asked")
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise InputError.at(
            str(folder), f"its {RUN} or {SCENE} was changed and cannot be read: {error}"
        ) from None
    if ranks is not None and not ranked:
        raise InputError.at(
            "ranks", f"the engine {asked['engine']} runs on one; leave the number of ranks out"
        )
    if reasons := policy.refuses(scene):
        raise InputError(reasons)
    now = _session(options)
    versions = {name: (now["packages"].get(name), version) for name, version in before.items()}
    if others := [
        f"{name} {new}, not {old}" for name, (new, old) in versions.items() if new != old
    ]:
        warnings.warn(
            f"the run went so far with other versions, and may now differ: {'; '.join(others)}",
            stacklevel=2,
        )
    _note(folder, asked | {"sessions": [*asked["sessions"], now]})
    return Task(scene, policy, asked["tolerance"], asked["best_effort"])


def _session(options: dict[str, Any]) -> dict[str, Any]:
    """Return what is noted of this session, with its ranks where the engine can use several."""
    world = mpi.joined()
    return session() | (
        {"ranks": world.size if world else options["ranks"] or 1} if "ranks" in options else {}
    )


def _note(folder: Path, what: dict[str, Any]) -> None:
    with replacing(folder / RUN) as aside:
        aside.write_text(json.dumps(what, indent=2) + "\n", encoding="utf-8")
