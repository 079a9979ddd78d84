"""The tasks of a sweep: scenes are answered, like ones in batches, and what is kept is written."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from .. import engines
from ..engines.base import Candidate, Engine, ErrorBudget
from ..engines.step_control import Attempt, first_attempt, next_attempt
from ..engines.time_stepping import kind
from ..errors import InputError, LmpchainError, RunFailed, ToleranceNotMet
from ..measure.motion import Motion
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..trajectory.record import ErrorEstimate
from ..util.arrays import Array
from .file import Sweep, again
from .labels import recorded
from .quantities import measured
from .realisations import scenes
from .store import NAME, NOT_DONE, Layout, complete, part_of, read_part, write_part

MOST, MOST_NUMBERS = 256, 2**22  # scenes in a task, and their samples x grains


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


@dataclass(frozen=True)
class Answer:
    """The recorded motion of a scene, and its estimated error."""

    scene: Scene
    equation: int
    grains: np.ndarray
    displacement: Array
    velocity: Array
    error: ErrorEstimate


def together(engine: str, scene: Scene) -> int:
    """Return how many scenes like this one make a task: one, unless it is small."""
    if not engines.get(engine).batches:
        return 1
    return max(1, min(MOST, MOST_NUMBERS // (scene.samples * scene.chain.grains)))


def answer(task: Task) -> None:
    """Answer the scenes of a task, unless that was done before, and write down what is kept of them."""
    if part_of(task.folder, task.first).exists() or complete(task.folder, task.first // task.layout.shard):
        return
    plan = again(_text(task.folder / NAME), task.files)
    engine = engines.get(plan.engine)
    alike = engine.batches and engine.equation == 1
    # what is hardly meant was said when the sweep began; how far off an answer is stands in the result
    with warnings.catch_warnings(action="ignore"):
        made = scenes(plan, task.first, task.count, alike)
        answers = _in_batches(engine, {n: s for n, s in enumerate(made) if isinstance(s, Scene)}, plan.tolerance)
        columns = _columns(task)
        for row, scene in enumerate(made):
            try:
                if isinstance(scene, InputError):
                    raise scene
                found = answers.pop(row, None) or _alone(scene, engine, plan.tolerance)
                if isinstance(found, ToleranceNotMet):
                    raise found
                _put(columns, row, found, plan, task)
            except (InputError, ToleranceNotMet, RunFailed) as error:
                columns["reason"][row] = str(error)
    columns["reason"] = np.array(columns["reason"], dtype=str)
    write_part(task.folder, task.first, _with_known(columns, task))


def _with_known(columns: dict[str, Any], task: Task) -> dict[str, Any]:
    """Return the arrays with what an earlier sweep has found in its place.

    Those scenes were answered again, so that the others get the bits that they would have in the same company.
    """
    some = part_of(task.folder, task.first, whole=False)
    if some.exists():
        known = {name: read_part(some, name, column) for name, column in task.layout.columns.items()}
        there = known["reason"] != NOT_DONE
        for name, values in columns.items():
            columns[name] = np.array(np.where(there.reshape(-1, *[1] * (values.ndim - 1)), known[name], values))
    return columns


@lru_cache(maxsize=2)
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def _columns(task: Task) -> dict[str, Any]:
    """Return an array of NaN for everything that is kept, (R, ...) each, and no reasons."""
    columns: dict[str, Any] = {
        name: np.full((task.count, *column.shape), np.nan) for name, column in task.layout.columns.items()
    }
    return columns | {"reason": [""] * task.count}


def _put(columns: Mapping[str, Any], row: int, found: Answer, plan: Sweep, task: Task) -> None:
    """Put what is kept of an answer where it belongs."""
    place = plan.place(task.first + row)
    motion = Motion(found.scene, found.equation, found.grains, found.displacement, found.velocity, found.error.total)
    wanted = recorded(plan, place, found.scene.chain.grains)
    spots: Any = slice(None)
    if not np.array_equal(wanted, task.grains):
        order = np.argsort(task.grains)
        spots = order[np.searchsorted(task.grains, wanted, sorter=order)]
    for name, values in measured(motion, plan.keep, wanted).items():
        into = columns[name][row]
        if values.ndim == 2:
            into[: len(values), spots] = values
        elif values.ndim:
            into[slice(len(values)) if task.layout.columns[name].dimensions == ("time",) else spots] = values
        else:
            columns[name][row] = values
    columns["model_error"][row], columns["solver_error"][row] = found.error.model, found.error.solver
    if "time" in columns:
        columns["time"][row, : found.scene.samples] = found.scene.time
    for key, values in plan.drawn(place, found.scene.chain.grains).items():
        columns[key][row, : len(values)] = values


def _alone(scene: Scene, engine: Engine, tolerance: float) -> Answer:
    """Answer one scene; raises what `simulate` raises."""
    found = simulate(scene, engine, tolerance)
    u, v = np.asarray(found.displacement), np.asarray(found.velocity)
    return Answer(scene, found.equation, found.grains, u, v, found.error_estimate)


def _in_batches(engine: Engine, made: Mapping[int, Scene], tolerance: float) -> dict[int, Answer | ToleranceNotMet]:
    """Answer scenes that are like one another in batches; what no batch answers is left for `simulate`.

    A batch has the step that each of its scenes would have alone.
    """
    answers: dict[int, Answer | ToleranceNotMet] = {}
    attempts: dict[int, Attempt] = {}
    if not engine.batches or engine.equation != 1:
        return answers  # linear engines take one scene after the other anyway
    for name, scene in made.items():
        with suppress(LmpchainError):
            attempt = first_attempt(engine, engine.part(scene), tolerance)
            if 2 * attempt.candidate.active_grains >= scene.chain.grains:  # else the light cone saves more than a batch
                attempts[name] = attempt
    while attempts:
        groups: dict[Any, list[int]] = {}
        for name, attempt in attempts.items():
            chosen = attempt.candidate
            steps = chosen.integrator, chosen.steps_per_sample, chosen.step, chosen.adaptive
            groups.setdefault((*kind(made[name]), *steps, *chosen.choices.items()), []).append(name)
        before, attempts = attempts, {}
        for names in groups.values():
            try:
                runs = _batch(engine, [made[name] for name in names], before[names[0]].candidate)
            except RunFailed:  # one of them; alone it will show which
                continue
            for name, (found, error) in zip(names, runs, strict=True):
                following, missed = next_attempt(engine, made[name], before[name], error)
                if following:
                    attempts[name] = following
                else:
                    answers[name] = ToleranceNotMet(missed) if missed else found
    return answers


def _batch(engine: Engine, alike: Sequence[Scene], candidate: Candidate) -> list[tuple[Answer, ErrorBudget]]:
    """Run scenes together; return the answer to each, and its error."""
    grains = alike[0].recorded
    shape = len(alike), alike[0].samples, grains.size
    displacement, velocity = np.empty(shape), np.empty(shape)
    run = engine.start(alike, candidate)
    try:
        for block in run.blocks():
            displacement[:, block.samples, block.columns] = block.displacement
            velocity[:, block.samples, block.columns] = block.velocity
        errors = run.errors()
    finally:
        run.close()
    return [
        (Answer(scene, engine.equation, grains, u, v, error.estimate), error)
        for scene, u, v, error in zip(alike, displacement, velocity, errors, strict=True)
    ]
