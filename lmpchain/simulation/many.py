"""Many scenes at once, in memory: like ones are answered in batches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Literal

import numpy as np

from ..engines.base import Engine
from ..engines.step_control import Attempt, first_attempt, next_attempt
from ..engines.time_stepping import alike
from ..errors import InputError, LmpchainError, RunFailed, ToleranceNotMet, check_tolerance, shown
from ..scene.scene import Scene
from ..trajectory.trajectory import Trajectory
from ..util.memory import keep_freed
from .api import check_on_miss, simulate
from .gathering import GatheringRun
from .policy import policy_for, record

# samples x grains of the scenes of a batch, which then stay in the cache of a processor
BATCH_NUMBERS = 2**18


def simulate_many(
    scenes: Iterable[Scene],
    tolerance: float = 1e-6,
    engine: str | Engine = "native",
    *,
    on_miss: Literal["raise", "warn"] = "raise",
    **options: Any,
) -> list[Trajectory]:
    """Answer many scenes; like ones are integrated together, several times faster than one by one.

    Scenes are alike if their chains have one length, exponent and kind of ends, and if they record
    the same grains at the same times. Each keeps the step that it would have alone, and has its own
    error estimate. Last digits may differ from those of `simulate`, which computes no more than the
    light cone.

    Parameters
    ----------
    scenes : iterable of R scenes
        All answers are held in memory: 16 bytes a sample and grain. `lmpchain.sweep` keeps those of
        more on the disk.
    tolerance : float
        As for `simulate`.
    engine : str or Engine
        A name or an engine object. All but the native engine, and "auto", take one scene after the
        other.
    on_miss, **options
        As for `simulate`.

    Returns
    -------
    list of R Trajectory
        In the order of the scenes. Costs are those of the batch, shared out evenly.

    Raises
    ------
    InputError
        If one of them is no scene, the engine cannot do it, or an option is wrong; with its place
        in the list, from 0.
    ToleranceNotMet, RunFailed
        As `simulate` does, for the first scene that has no answer.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> chain = Chain(grains=40, diameter=1e-3)
    >>> speeds = [1e-6, 1e-5, 1e-4]
    >>> struck = [Scene(chain=chain, excitation=Impulse(velocity=v), duration=50e-6) for v in speeds]
    >>> found = simulate_many(struck, tolerance=1e-9)
    >>> [bool(t.velocity.max() == v) for t, v in zip(found, speeds)]
    [True, True, True]
    """
    check_tolerance(tolerance)
    check_on_miss(on_miss)
    if isinstance(scenes, Scene) or not isinstance(scenes, Iterable):
        raise InputError.at("scenes", "must be a list of scenes; simulate takes one alone")
    policy = policy_for(engine, **options)
    every = list(scenes)
    for place, scene in enumerate(every):
        if not isinstance(scene, Scene):
            raise InputError.at(f"scenes.{place}", f"must be a scene (got {shown(scene)})")
        if reasons := policy.refuses(scene):
            raise InputError(InputError(reasons).under(f"scenes.{place}"))
    chosen = policy.chosen
    made: dict[int, Trajectory | ToleranceNotMet] = {}
    if chosen:
        made = dict(in_batches(chosen, dict(enumerate(every)), tolerance))
    found = []
    for place, scene in enumerate(every):
        answer = made.pop(place, None)
        if answer is None or (isinstance(answer, ToleranceNotMet) and on_miss == "warn"):
            answer = simulate(scene, chosen or engine, tolerance, on_miss=on_miss)
        if isinstance(answer, ToleranceNotMet):
            raise answer
        found.append(answer)
    return found


def in_batches(
    engine: Engine, made: Mapping[int, Scene], tolerance: float
) -> Iterator[tuple[int, Trajectory | ToleranceNotMet]]:
    """Answer scenes that are like one another in batches; what no batch answers is left for `simulate`.

    A batch has the step that each of its scenes would have alone.
    """
    attempts: dict[int, Attempt] = {}
    if not engine.batches or engine.equation != 1:
        return  # linear engines take one scene after the other anyway
    keep_freed()
    for name, scene in made.items():
        with suppress(LmpchainError):
            attempt = first_attempt(engine, engine.part(scene), tolerance)
            # else the light cone saves more than a batch
            if 2 * attempt.candidate.active_grains >= scene.chain.grains:
                attempts[name] = attempt
    while attempts:
        groups: dict[Any, list[int]] = {}
        for name, attempt in attempts.items():
            same = made[name].quantities, *alike(made[name].fine, attempt.candidate)
            groups.setdefault(same, []).append(name)
        before = attempts
        attempts = {}
        for names in _pieces(made, groups.values()):
            try:
                judged = _together(
                    engine,
                    [made[name] for name in names],
                    [before[name] for name in names],
                    tolerance,
                )
            except RunFailed:  # one of them; alone it will show which
                continue
            for name, (found, following, missed) in zip(names, judged, strict=True):
                if following:
                    attempts[name] = following
                else:
                    yield name, ToleranceNotMet(missed, found) if missed else found


def _pieces(made: Mapping[int, Scene], groups: Iterable[list[int]]) -> Iterator[list[int]]:
    """Yield groups of scenes in pieces that are no larger than a batch."""
    for names in groups:
        scene = made[names[0]]
        size = max(1, BATCH_NUMBERS // (scene.fine.samples * scene.chain.grains))
        yield from (names[first : first + size] for first in range(0, len(names), size))


def _together(
    engine: Engine, scenes: Sequence[Scene], attempts: Sequence[Attempt], tolerance: float
) -> list[tuple[Trajectory, Attempt | None, str]]:
    """Run scenes together; return of each the answer, the next attempt, and why it missed the tolerance."""
    first = scenes[0]
    candidate = attempts[0].candidate
    size = len(scenes)
    parts = [scene.fine for scene in scenes]
    run = engine.start(parts, candidate)
    try:
        run = GatheringRun(run, engine, scenes, parts, {}) if first.quantities else run
        blocks = [block for block in run.blocks() if block.displacement.size]
        errors = run.errors()
        whole = run.cost()
    finally:
        run.close()
    fields = [block.displacement for block in blocks], [block.velocity for block in blocks]
    u, v = (parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1) for parts in fields)
    found = (
        run.found([error.total for error in errors])
        if isinstance(run, GatheringRun)
        else [{} for _ in scenes]
    )
    estimate_s = whole.estimate_s + sum(attempt.spent_s for attempt in attempts)
    setup_s = whole.setup_s + sum(attempt.planned_s for attempt in attempts)
    share = whole._replace(
        integration_s=whole.integration_s / size,
        estimate_s=estimate_s / size,
        setup_s=setup_s / size,
    )
    about = record(engine, first, candidate, tolerance)
    time = first.time
    grains = first.recorded
    told = []
    for scene, attempt, error, displacement, velocity, gathered in zip(
        scenes, attempts, errors, u, v, found, strict=True
    ):
        following, missed = next_attempt(engine, scene.fine, attempt, error)
        if following:
            following = following._replace(spent_s=share.integration_s + share.estimate_s)
        answer = Trajectory(
            scene,
            engine.name,
            engine.equation,
            time,
            grains,
            displacement,
            velocity,
            error.estimate,
            share,
            about,
            gathered,
        )
        told.append((answer, following, missed))
    return told
