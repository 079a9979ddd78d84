"""The tasks of a sweep: scenes are answered, like ones in batches, and what is kept is written."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from .. import engines
from ..engines.base import Engine
from ..errors import InputError, LmpchainError, RunFailed, ToleranceNotMet
from ..measure.motion import motion_of
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..simulation.many import in_batches
from ..trajectory.trajectory import Trajectory
from .file import Sweep, again
from .labels import recorded
from .quantities import measured
from .realisations import scenes
from .store import NAME, NOT_DONE, Layout, complete, part_of, read_part, write_part

# scenes in a task, and their samples x grains
MOST = 256
MOST_NUMBERS = 2**22


@dataclass(frozen=True, eq=False)
class Task:
    """Scenes to answer, from the number `first` on, and what their results look like.

    Attributes
    ----------
    folder, files : Path
        Where the results go, and where CSV files lie.
    layout : Layout
    grains : (G,) array
        Numbers of the grains that the arrays have places for.
    first : int
    """

    folder: Path
    files: Path
    layout: Layout
    grains: np.ndarray
    first: int

    @property
    def count(self) -> int:
        """How many scenes these are."""
        return min(self.layout.batch, self.layout.count - self.first)


def together(engine: str, scene: Scene) -> int:
    """Return how many scenes like this one make a task: one, unless it is small."""
    if not engines.get(engine).batches:
        return 1
    return max(1, min(MOST, MOST_NUMBERS // (scene.fine.samples * scene.chain.grains)))


def answer(task: Task) -> None:
    """Answer the scenes of a task, unless that was done before, and write down what is kept of them."""
    if part_of(task.folder, task.first).exists() or complete(
        task.folder, task.first // task.layout.shard
    ):
        return
    plan = again(_text(task.folder / NAME), task.files)
    engine = engines.get(plan.engine)
    alike = engine.batches and engine.equation == 1
    # what is hardly meant was said when the sweep began; how far off an answer is stands in the
    # result
    with warnings.catch_warnings(action="ignore"):
        made = scenes(plan, task.first, task.count, alike)
        columns = _columns(task)
        left = dict(enumerate(made))
        for row, found in in_batches(
            engine, {n: s for n, s in left.items() if isinstance(s, Scene)}, plan.tolerance
        ):
            del left[row]
            _put(columns, row, found, plan, task)
        for row, scene in left.items():
            _put(columns, row, _alone(scene, engine, plan.tolerance), plan, task)
    columns["reason"] = np.array(columns["reason"], dtype=str)
    write_part(task.folder, task.first, _with_known(columns, task))


def _with_known(columns: dict[str, Any], task: Task) -> dict[str, Any]:
    """Return the arrays with what an earlier sweep has found in its place.

    Those scenes were answered again, so that the others get the bits that they would have in the
    same company.
    """
    some = part_of(task.folder, task.first, whole=False)
    if some.exists():
        known = {
            name: read_part(some, name, column) for name, column in task.layout.columns.items()
        }
        there = known["reason"] != NOT_DONE
        for name, values in columns.items():
            columns[name] = np.array(
                np.where(there.reshape(-1, *[1] * (values.ndim - 1)), known[name], values)
            )
    return columns


@lru_cache(maxsize=2)
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def _columns(task: Task) -> dict[str, Any]:
    """Return an array of NaN for everything that is kept, (R, ...) each, and no reasons."""
    columns: dict[str, Any] = {
        name: np.full((task.count, *column.shape), np.nan)
        for name, column in task.layout.columns.items()
    }
    return columns | {"reason": [""] * task.count}


def _put(
    columns: Mapping[str, Any], row: int, found: Trajectory | LmpchainError, plan: Sweep, task: Task
) -> None:
    """Put what is kept of an answer where it belongs, or why there is none."""
    if isinstance(found, LmpchainError):
        columns["reason"][row] = str(found)
        return
    place = plan.place(task.first + row)
    motion = motion_of(found)
    wanted = recorded(plan, place, found.scene.chain.grains)
    spots = _spots(wanted.tobytes(), task.grains.tobytes())
    for name, values in measured(motion, plan.keep, wanted, found.gathered).items():
        into = columns[name][row]
        if values.ndim == 2:
            into[: len(values), spots] = values
        elif values.ndim:
            into[
                slice(len(values)) if task.layout.columns[name].dimensions == ("time",) else spots
            ] = values
        else:
            columns[name][row] = values
    columns["model_error"][row] = found.error_estimate.model
    columns["solver_error"][row] = found.error_estimate.solver
    if "time" in columns:
        columns["time"][row, : found.scene.samples] = found.scene.time
    for key, values in plan.drawn(place, found.scene.chain.grains).items():
        columns[key][row, : len(values)] = values


@lru_cache(maxsize=64)
def _spots(wanted: bytes, grains: bytes) -> Any:
    """Return where these grains stand among those that the arrays have places for."""
    if wanted == grains:
        return slice(None)
    numbers = np.frombuffer(wanted, int)
    every = np.frombuffer(grains, int)
    order = np.argsort(every)
    return order[np.searchsorted(every, numbers, sorter=order)]


def _alone(
    scene: Scene | InputError, engine: Engine, tolerance: float
) -> Trajectory | LmpchainError:
    """Answer one scene, or say why there is no answer."""
    if isinstance(scene, InputError):
        return scene
    try:
        return simulate(scene, engine, tolerance)
    except (InputError, ToleranceNotMet, RunFailed) as error:
        return error
