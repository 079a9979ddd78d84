"""Trajectories of many scenes in memory; similar scenes are solved in batches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from typing import Any, Literal

import numpy as np

from ..engines.base import Engine
from ..engines.step_control import Attempt, next_attempt
from ..errors import InputError, LmpchainError, RunFailed, ToleranceNotMet, check_tolerance
from ..scene.scene import Scene, check_scene
from ..trajectory.record import Cost
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from .accumulation import GatheringRun, at_samples
from .api import check_on_miss, simulate
from .choice import choose, damping_record, engine_for, record, refusals

# Largest number of samples times grains in a batch that fits into the processor's cache.
BATCH_NUMBERS = 2**18


def simulate_many(
    scenes: Iterable[Scene],
    tolerance: float = 1e-6,
    engine: str | Engine = "native",
    *,
    on_miss: Literal["raise", "warn"] = "raise",
    **options: Any,
) -> list[Trajectory]:
    """Simulate many scenes; similar scenes are integrated together, several times faster.

    Scenes are similar if their chains have the same length, contact law and kind of ends, and if
    they record the same grains at the same times. The parameters of a contact law that is given by
    a formula may differ. Each scene has the step and the error estimate that it would have alone.
    Rounding errors may differ from `simulate`, which computes the light cone only.

    Parameters
    ----------
    scenes : iterable of R scenes
        The scenes to simulate. All trajectories are kept in memory, 16 bytes for each sample and
        grain. `lmpchain.sweep` stores trajectories on disk.
    tolerance : float
        Largest relative error, as in `simulate`.
    engine : str or Engine
        A name or an engine object. Only the native engine solves scenes in batches.
    on_miss : "raise" or "warn"
        Whether to raise an error or to warn if the tolerance cannot be met.
    **options
        Options of a named engine.

    Returns
    -------
    list of R Trajectory
        Trajectories in the order of the scenes. Each has an equal share of the cost of its batch.

    Raises
    ------
    InputError
        If an element is not a scene, if the engine cannot solve it, or if an option is wrong. The
        message has the index of the scene in the list, from 0.
    ToleranceNotMet, RunFailed
        If a scene fails, under the same conditions as in `simulate`. The error is that of the first
        such scene.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> chain = Chain(grains=40, diameter=1e-3)
    >>> speeds = [1e-6, 1e-5, 1e-4]
    >>> strikes = [Impulse(velocity=v) for v in speeds]
    >>> scenes = [Scene(chain=chain, excitation=strike, duration=50e-6) for strike in strikes]
    >>> answers = simulate_many(scenes, tolerance=1e-9)
    >>> [bool(t.velocity.max() == v) for t, v in zip(answers, speeds)]
    [True, True, True]
    """
    check_tolerance(tolerance)
    check_on_miss(on_miss)
    if isinstance(scenes, Scene) or not isinstance(scenes, Iterable):
        raise InputError.at("scenes", "must be a list of scenes; use simulate for one scene")
    chosen = engine_for(engine, **options)
    numbered = dict(enumerate(scenes))
    for number, scene in numbered.items():
        check_scene(scene, f"scenes.{number}")
        if reasons := refusals(scene, chosen):
            raise InputError(InputError(reasons).under(f"scenes.{number}"))
    batches = dict(in_batches(chosen, numbered, tolerance)) if chosen else {}
    answers = []
    for number, scene in numbered.items():
        answer = batches.pop(number, None)
        if answer is None or (isinstance(answer, ToleranceNotMet) and on_miss == "warn"):
            answer = simulate(scene, chosen or engine, tolerance, on_miss=on_miss)
        if isinstance(answer, ToleranceNotMet):
            raise answer
        answers.append(answer)
    return answers


def in_batches(
    engine: Engine, scenes: Mapping[int, Scene], tolerance: float
) -> Iterator[tuple[int, Trajectory | ToleranceNotMet]]:
    """Yield trajectories of similar scenes solved in batches; `simulate` solves the others.

    Scenes of a batch have the step that each of them would have alone.
    """
    attempts: dict[int, Attempt] = {}
    if not engine.batches or engine.equation != 1:
        # Linear engines solve the scenes of a batch one by one anyway.
        return
    for number, scene in scenes.items():
        with suppress(LmpchainError):
            attempt = choose(scene, engine, tolerance)
            # With fewer active grains, the light cone saves more time than a batch.
            if 2 * attempt.proposal.active_grains >= scene.chain.grains:
                attempts[number] = attempt
    while attempts:
        groups: dict[Any, list[int]] = {}
        for number, attempt in attempts.items():
            scene = scenes[number]
            key = scene.quantities, engine.batch_key(scene.fine, attempt.proposal)
            groups.setdefault(key, []).append(number)
        following: dict[int, Attempt] = {}
        for numbers in _split(scenes, groups.values()):
            batch = [scenes[number] for number in numbers]
            try:
                results = _solve(engine, batch, [attempts[n] for n in numbers], tolerance)
            except RunFailed:
                # One scene has failed; `simulate` will show the fault.
                continue
            for number, (answer, later, missed) in zip(numbers, results, strict=True):
                if later:
                    following[number] = later
                else:
                    yield number, ToleranceNotMet(missed, answer) if missed else answer
        attempts = following


def _split(scenes: Mapping[int, Scene], groups: Iterable[list[int]]) -> Iterator[list[int]]:
    """Yield groups of scenes in pieces of at most the size of a batch."""
    for numbers in groups:
        scene = scenes[numbers[0]]
        size = max(1, BATCH_NUMBERS // (scene.fine.samples * scene.chain.grains))
        yield from (numbers[first : first + size] for first in range(0, len(numbers), size))


def _solve(
    engine: Engine, scenes: Sequence[Scene], attempts: Sequence[Attempt], tolerance: float
) -> list[tuple[Trajectory, Attempt | None, str]]:
    """Run scenes together; return trajectory, next attempt and failure reason of each scene."""
    proposal = attempts[0].proposal
    parts = [scene.fine for scene in scenes]
    gathering = None
    with closing(engine.start(parts, proposal)) as answering:
        run = answering
        if scenes[0].quantities:
            run = gathering = GatheringRun(run, engine, scenes, parts, {})
        blocks = [block for block in run.blocks() if block.displacement.size]
        errors = run.errors()
        cost = run.cost()
        energies = answering.energies(errors)
    u = _join([block.displacement for block in blocks])
    v = _join([block.velocity for block in blocks])
    totals = [error.total for error in errors]
    gathered = gathering.results(totals) if gathering else [{} for _ in scenes]
    for scene, quantities, summed in zip(scenes, gathered, energies, strict=False):
        quantities |= at_samples(scene, summed)
    cost = _share(cost, attempts)
    provenance = record(engine, scenes[0], proposal, tolerance)
    results = []
    for row, (scene, attempt, error) in enumerate(zip(scenes, attempts, errors, strict=True)):
        following, missed = next_attempt(engine, scene.fine, attempt, error)
        if following:
            following = following._replace(spent_s=cost.integration_s + cost.estimate_s)
        answer = Trajectory(
            scene=scene,
            engine=engine.name,
            equation=engine.equation,
            time=scenes[0].time.copy(),
            grains=scenes[0].recorded.copy(),
            displacement=u[row],
            velocity=v[row],
            error_estimate=error.estimate,
            cost=cost,
            provenance=provenance | damping_record(scene),
            gathered=gathered[row],
        )
        results.append((answer, following, missed))
    return results


def _join(blocks: list[Array]) -> Array:
    """Return blocks of samples as one array, (R, T, G)."""
    return blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=1)


def _share(cost: Cost, attempts: Sequence[Attempt]) -> Cost:
    """Return the cost of one scene of a batch, including its part of earlier attempts."""
    size = len(attempts)
    estimate_s = cost.estimate_s + sum(attempt.spent_s for attempt in attempts)
    setup_s = cost.setup_s + sum(attempt.planned_s for attempt in attempts)
    return cost._replace(
        integration_s=cost.integration_s / size,
        estimate_s=estimate_s / size,
        setup_s=setup_s / size,
    )
