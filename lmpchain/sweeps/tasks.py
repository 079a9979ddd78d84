"""The tasks of a sweep: scenes are answered, like ones in batches, and results are written.

Every scene has a folder, whose name is a hash of all that shapes its answer:

    result.json     what was asked, why it failed if it did, the error estimate, and single numbers that are kept
    velocity.npy    an array that is kept, and so on

The folder is written under another name and then renamed: it is whole or not there.
"""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from typing import Any

import numpy as np

from .. import engines
from ..engines.base import Candidate, Engine, ErrorBudget
from ..engines.step_control import Attempt, first_attempt, next_attempt
from ..engines.time_stepping import kind
from ..errors import InputError, LmpchainError, RunFailed, ToleranceNotMet
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..trajectory.trajectory import Trajectory
from .file import name_of, scene_of
from .quantities import QUANTITIES

MOST, MOST_NUMBERS = 64, 2**20  # scenes in a task, and their samples x grains


@dataclass(frozen=True)
class Task:
    """Scenes to answer: what is asked of each, where CSV files lie, where results go.

    Those that are done stay in a task: the others get the same bits if they are answered in the same company.
    """

    asked: tuple[str, ...]
    files: Path
    results: Path


def together(engine: str, scene: Scene) -> int:
    """Return how many scenes like this one make a task: one, unless it is small."""
    if not engines.get(engine).batches:
        return 1
    return max(1, min(MOST, MOST_NUMBERS // (scene.samples * scene.chain.grains)))


def answer(task: Task) -> None:
    """Answer those scenes of a task that nobody has answered, and write down what is kept of them."""
    asked = {name_of(text): json.loads(text) for text in task.asked}
    missing = [name for name in asked if not (task.results / name).exists()]
    if not missing:
        return
    scenes: dict[str, Scene] = {}
    faults: dict[str, InputError] = {}
    for name, wanted in asked.items():
        try:
            with warnings.catch_warnings(action="ignore"):  # said of all scenes when the sweep began
                scenes[name] = scene_of(wanted, task.files)
        except InputError as error:
            faults[name] = error
    engine, tolerance = engines.get(wanted["engine"]), wanted["tolerance"]
    with warnings.catch_warnings(action="ignore"):  # how far off an answer is stands in the result
        answers = _in_batches(engine, scenes, tolerance)
        for name in missing:
            try:
                if name in faults:
                    raise faults[name]
                answer = answers.pop(name, None) or simulate(scenes[name], engine, tolerance)
                _record(task.results / name, asked[name], answer)
            except (InputError, ToleranceNotMet, RunFailed) as error:
                _record(task.results / name, asked[name], error)


def _in_batches(
    engine: Engine, scenes: Mapping[str, Scene], tolerance: float
) -> dict[str, Trajectory | ToleranceNotMet]:
    """Answer scenes that are like one another in batches; what no batch answers is left for `simulate`.

    A batch has the step that each of its scenes would have alone.
    """
    answers: dict[str, Trajectory | ToleranceNotMet] = {}
    attempts: dict[str, Attempt] = {}
    if not engine.batches or engine.equation != 1:
        return answers  # linear engines take one scene after the other anyway
    for name, scene in scenes.items():
        with suppress(LmpchainError):
            attempt = first_attempt(engine, engine.part(scene), tolerance)
            if 2 * attempt.candidate.active_grains >= scene.chain.grains:  # else the light cone saves more than a batch
                attempts[name] = attempt
    while attempts:
        groups: dict[Any, list[str]] = {}
        for name, attempt in attempts.items():
            made = attempt.candidate
            steps = made.integrator, made.steps_per_sample, made.step, made.adaptive
            groups.setdefault((*kind(scenes[name]), *steps, *made.choices.items()), []).append(name)
        before, attempts = attempts, {}
        for names in groups.values():
            try:
                runs = _batch(engine, [scenes[name] for name in names], before[names[0]].candidate)
            except RunFailed:  # one of them; alone it will show which
                continue
            for name, (trajectory, error) in zip(names, runs, strict=True):
                following, missed = next_attempt(engine, scenes[name], before[name], error)
                if following:
                    attempts[name] = following
                else:
                    answers[name] = ToleranceNotMet(missed, trajectory) if missed else trajectory
    return answers


def _batch(engine: Engine, scenes: Sequence[Scene], candidate: Candidate) -> Iterator[tuple[Trajectory, ErrorBudget]]:
    """Run scenes together; return the answer to each, and its error."""
    shape = len(scenes), scenes[0].samples, scenes[0].recorded.size
    displacement, velocity = np.zeros(shape), np.zeros(shape)
    run = engine.start(scenes, candidate)
    try:
        for block in run.blocks():
            displacement[:, block.samples, block.columns] = block.displacement
            velocity[:, block.samples, block.columns] = block.velocity
        errors, cost = run.errors(), run.cost()
    finally:
        run.close()
    answers = (
        Trajectory(
            scene=scene,
            engine=engine.name,
            equation=engine.equation,
            time=scene.time,
            grains=scene.recorded,
            displacement=u,
            velocity=v,
            error_estimate=error.estimate,
            cost=cost,
        )
        for scene, u, v, error in zip(scenes, displacement, velocity, errors, strict=True)
    )
    return zip(answers, errors, strict=True)


def _record(path: Path, asked: Mapping[str, Any], outcome: Trajectory | LmpchainError) -> None:
    """Write the folder of a scene: what is kept of its answer, or why there is none."""
    result: dict[str, Any] = {"asked": asked}
    arrays: dict[str, np.ndarray] = {}
    if isinstance(outcome, Trajectory):
        scene, error = outcome.scene, outcome.error_estimate
        result |= {
            "duration": scene.duration,
            "samples": scene.samples,
            "grains": f"1:{scene.chain.grains}" if scene.grains == "all" else scene.grains,
            "model_error": error.model,
            "solver_error": error.solver,
        }
        for name in asked["keep"]:
            value = QUANTITIES[name].measure(outcome)
            if QUANTITIES[name].dimensions:
                arrays[name] = value
            else:
                result[name] = float(value)
    else:
        result["failed"] = str(outcome)
    aside = path.with_name(f".{path.name}.{token_hex(4)}.partial")
    aside.mkdir()
    try:
        for name, array in arrays.items():
            np.save(aside / name, array)
        (aside / "result.json").write_text(json.dumps(result), encoding="utf-8")
        aside.rename(path)
    except OSError:
        if not path.exists():  # else another was faster
            raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)
