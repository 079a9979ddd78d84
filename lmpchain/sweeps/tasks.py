"""Tasks of a sweep: answer some scenes, like ones in batches, and write the results."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .. import engines
from ..engines.base import Engine
from ..errors import InputError, LmpchainError, RunFailed, ToleranceNotMet
from ..measure.motion import motion_of
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..simulation.many import in_batches
from ..trajectory.trajectory import Trajectory
from .file import Sweep, read_text
from .labels import find_recorded
from .quantities import measured
from .realisations import scenes
from .store import NAME, NOT_DONE, Layout, complete, part_of, read_part, write_part


class TaskLimits(NamedTuple):
    """Limits of the tasks of a sweep.

    Attributes
    ----------
    scenes : int
        Most scenes of a task.
    numbers : int
        Most samples x grains of all its scenes.
    pending : int
        Tasks that an executor has at a time.
    deaths : int
        Processes that die over a task before it is given up.
    scheduler_s : float
        Longest wait for an answer of a Dask scheduler, s.
    """

    scenes: int = 256
    numbers: int = 2**22
    pending: int = 256
    deaths: int = 3
    scheduler_s: float = 5.0


TASKS = TaskLimits()


@dataclass(frozen=True, eq=False)
class Task:
    """Scenes to answer, from the number `first` on, and the layout of their results.

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
        """Number of scenes."""
        return min(self.layout.batch, self.layout.count - self.first)


def count_scenes(engine: str, scene: Scene) -> int:
    """Return the number of scenes like this one in a task: one, unless it is small."""
    if not engines.get(engine).batches:
        return 1
    numbers = scene.fine.samples * scene.chain.grains
    return max(1, min(TASKS.scenes, TASKS.numbers // numbers))


def answer(task: Task) -> None:
    """Answer the scenes of a task, unless that was done before, and write their results."""
    shard = task.first // task.layout.shard
    if part_of(task.folder, task.first).exists() or complete(task.folder, shard):
        return
    plan = _read_plan(task.folder / NAME, task.files)
    engine = engines.get(plan.engine)
    alike = engine.batches and engine.equation == 1
    # warnings were given when the sweep began; the error of an answer stands in the result
    with warnings.catch_warnings(action="ignore"):
        columns = _make_columns(task)
        remaining = dict(enumerate(scenes(plan, task.first, task.count, alike)))
        # scenes that cannot be made are errors already
        batch = {row: scene for row, scene in remaining.items() if isinstance(scene, Scene)}
        for row, result in in_batches(engine, batch, plan.tolerance):
            del remaining[row]
            _put(columns, row, result, plan, task)
        for row, scene in remaining.items():
            _put(columns, row, _answer_alone(scene, engine, plan.tolerance), plan, task)
    columns["reason"] = np.array(columns["reason"], dtype=str)
    write_part(task.folder, task.first, _insert_earlier(columns, task))


def _insert_earlier(columns: dict[str, Any], task: Task) -> dict[str, Any]:
    """Return the arrays with the results of an earlier sweep in their place.

    Those scenes were answered again, so that the others get the bits that they would have in the
    same company.
    """
    path = part_of(task.folder, task.first, whole=False)
    if not path.exists():
        return columns
    earlier = {name: read_part(path, name, column) for name, column in task.layout.columns.items()}
    answered = earlier["reason"] != NOT_DONE
    # scenes are the first dimension, and numpy aligns the last ones
    return {
        name: np.where(answered, earlier[name].T, values.T).T for name, values in columns.items()
    }


# tasks of one sweep follow one another
@lru_cache(maxsize=2)
def _read_plan(path: Path, files: Path) -> Sweep:
    return read_text(path.read_text(encoding="utf-8"), files)


def _make_columns(task: Task) -> dict[str, Any]:
    """Return an array of NaN for each quantity, (R, ...) each, and no reasons."""
    columns: dict[str, Any] = {
        name: np.full((task.count, *column.shape), np.nan)
        for name, column in task.layout.columns.items()
    }
    return columns | {"reason": [""] * task.count}


def _put(
    columns: Mapping[str, Any],
    row: int,
    result: Trajectory | LmpchainError,
    plan: Sweep,
    task: Task,
) -> None:
    """Put the quantities of an answer in their row, or the reason why there is none."""
    if isinstance(result, LmpchainError):
        columns["reason"][row] = str(result)
        return
    position = plan.place(task.first + row)
    scene = result.scene
    grains = find_recorded(plan, position, scene.chain.grains)
    order = np.argsort(task.grains)
    places: dict[str, Any] = {
        "time": slice(scene.samples),
        "grain": order[np.searchsorted(task.grains, grains, sorter=order)],
    }
    for name, values in measured(motion_of(result), plan.keep, grains, result.gathered).items():
        index = tuple(places[dimension] for dimension in task.layout.columns[name].dimensions)
        # a view of the row, also where it is a single number
        columns[name][row, ...][index] = values
    columns["model_error"][row] = result.error_estimate.model
    columns["solver_error"][row] = result.error_estimate.solver
    if "time" in columns:
        columns["time"][row, : scene.samples] = scene.time
    for key, values in plan.draw_values(position, scene.chain.grains).items():
        columns[key][row, : len(values)] = values


def _answer_alone(
    scene: Scene | InputError, engine: Engine, tolerance: float
) -> Trajectory | LmpchainError:
    """Answer one scene, or return the reason why there is no answer."""
    if isinstance(scene, InputError):
        return scene
    try:
        return simulate(scene, engine, tolerance)
    except (InputError, ToleranceNotMet, RunFailed) as error:
        return error
