"""Limits of methods on a scene, predicted by laws and measured by runs.

`step_limit` (unstable step, energy error), `roundoff`, `predictability` (chaos), `linear_theory`
and `pre_run` contain the laws and the measurements; this module evaluates all of them for one
scene. `analysis/stability_map.py` draws maps over many scenes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache, partial

import numpy as np

from .. import engines
from ..benchmark.reference import expected_seconds
from ..chain.bounds import LIMITS
from ..engines.base import Engine
from ..engines.cost_model import announced
from ..errors import InputError, LmpchainError
from ..integrators.methods import METHODS
from ..scene.scene import Scene, check_scene
from ..util.arrays import Array
from ..util.progress import ProgressBar
from ..util.remarks import warnings_aside
from .linear_theory import strike_number_where
from .pre_run import deepest
from .predictability import amplifies, growth, predictability_time_of, predicted_time
from .result import TOLERANCE, Boundary, Curve, Stability
from .roundoff import floor, long_double, measured_floor
from .step_limit import blow_up, energy_error, limit

LONGEST_S = 20.0  # Longest expected duration of a measurement, s; longer ones are not made.
PERIODS = 1000.0  # Duration of energy measurements, in periods of the band edge.
DIVISIONS = 40.0  # Number of steps per period; such steps are far below every stability limit.
STRENGTHS = np.logspace(-8, 2, 11)  # Strengths of the excitation relative to the scene.
# Engines and diameters with different rounding errors.
ROUNDINGS = (("native", "physical"), ("lammps", "physical"), ("lammps", "gauge"))


def stability(scene: Scene, *, progress: bool = False) -> Stability:
    """Find the limits of all methods on a scene.

    Limits that would take longer than some seconds to measure are only predicted.

    Parameters
    ----------
    scene : Scene
        A scene without damping and without a ground.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Stability
        Limits and curves, predicted and measured.
    """
    check_scene(scene)
    scene.chain.refuse_damping("the search for limits")
    scene.chain.refuse_ground("the search for limits")
    boundaries: list[Boundary] = []
    curves: list[Curve] = []
    left_out: list[str] = []
    tasks = list(_tasks(scene.ungathered))
    work = announced(
        _expected_s(scene), "the search for the limits", "a shorter duration or chain takes less"
    )
    with work, ProgressBar(len(tasks), shown=progress) as bar:
        for number, (name, task) in enumerate(tasks):
            bar.reach(number)
            bar.describe(name)
            try:
                for item in task():
                    if isinstance(item, Boundary):
                        boundaries.append(item)
                    else:
                        curves.append(item)
            # Only the first fault is shown, without its key, because the user did not set this
            # field.
            except InputError as error:
                left_out.append(f"{name}: {error.faults[0][1]}")
            except LmpchainError as error:
                left_out.append(f"{name}: {error}")
    return Stability(scene, tuple(boundaries), tuple(curves), tuple(left_out))


def _tasks(scene: Scene) -> Iterator[tuple[str, Callable[[], Iterator[Boundary | Curve]]]]:
    """Yield all causes of failure by name, with functions that yield their limits."""
    for integrator in METHODS:
        yield f"longest step, {integrator}", partial(_step, scene, "native", integrator)
    yield "longest step, lammps", partial(_step, scene, "lammps", "verlet")
    for integrator in METHODS:
        yield f"energy, {integrator}", partial(_energy, scene, integrator)
    exact = cache(partial(long_double, scene))
    for engine, diameter in ROUNDINGS:
        task = partial(_floor, scene, engine, diameter, exact)
        yield f"smallest error, {_name(engine, diameter)}", task
    yield "predictable", partial(_predictability, scene)
    yield "linear theory", partial(_linear, scene)
    yield "overlap", partial(_overlap, scene)
    yield "strength", partial(_strength, scene)


def _expected_s(scene: Scene) -> float:
    """Return the expected duration of all long measurements, s."""
    searches = [_search_s(scene, engines.get("native"), name) for name in METHODS]
    searches.append(_search_s(scene, engines.get("lammps"), "verlet"))
    follows = [_follow_s(scene, name) for name in METHODS]
    return sum(time_s for time_s in searches + follows if time_s < LONGEST_S)


def _search_s(scene: Scene, solver: Engine, integrator: str) -> float:
    """Return the expected duration of the search for the longest step, s: about 60 runs."""
    steps = scene.duration / limit(scene, integrator)
    work = METHODS[integrator].evaluations * steps * scene.chain.grains
    return 60 * work * solver.seconds_per_grain_step


def _follow_s(scene: Scene, integrator: str) -> float:
    """Return the expected duration of an energy measurement, s."""
    work = METHODS[integrator].evaluations * PERIODS * DIVISIONS * scene.chain.grains
    return work * engines.get("native").seconds_per_grain_step


def _step(scene: Scene, engine: str, integrator: str) -> Iterator[Boundary]:
    predicted = limit(scene, integrator)
    solver = engines.get(engine, integrator=integrator)
    measured = math.nan
    if _search_s(scene, solver, integrator) < LONGEST_S and not solver.refuses(scene):
        measured = blow_up(scene, integrator, engine)
    yield Boundary("longest step", f"{engine} {integrator}", "s", predicted, measured)


def _energy(scene: Scene, integrator: str) -> Iterator[Curve]:
    if scene.excitation.does_work:
        raise InputError.at("kind", "the energy is not conserved, because the excitation does work")
    if not scene.chain.compressed:
        raise InputError.at("gravity", "a chain without gravity and load has no band edge")
    step = 2 * math.pi / scene.highest_frequency / DIVISIONS
    if _follow_s(scene, integrator) > LONGEST_S:
        raise InputError.at("grains", "too many to follow the energy for a thousand periods")
    # Warnings are suppressed, because only the energy of this very long run is used, not its
    # motion.
    with warnings_aside():
        energy = energy_error(scene, integrator, step, PERIODS, samples=401)
    yield Curve("energy", integrator, energy.time, np.abs(energy.error))


def _floor(
    scene: Scene, engine: str, diameter: str, exact: Callable[[], tuple[Array, Array]]
) -> Iterator[Boundary]:
    measured = math.nan
    if not scene.excitation.does_work and not _too_long(scene):
        measured = measured_floor(scene, engine, diameter, exact=exact())
    predicted = floor(scene, engine, diameter)
    yield Boundary("smallest error", _name(engine, diameter), "", predicted, measured)


def _name(engine: str, diameter: str) -> str:
    return engine if engine == "native" else f"{engine}, {diameter} diameter"


def _predictability(scene: Scene) -> Iterator[Boundary | Curve]:
    predicted = predicted_time(scene, TOLERANCE) if amplifies(scene) else math.nan
    measured = math.nan
    if not _too_long(scene):
        times, apart = growth(scene)
        yield Curve("growth", "", times, apart)
        measured = predictability_time_of(times, apart, TOLERANCE)
    beyond = measured < scene.duration
    name = "predictable to 1e-6 until"
    yield Boundary(name, "any", "s", predicted, measured, scene.duration, beyond)


def _linear(scene: Scene) -> Iterator[Boundary]:
    if reasons := engines.Chebyshev().refuses(scene.reached):
        raise InputError(reasons)
    for error in (0.01, 0.1):
        bound = strike_number_where(error, scene)
        name = f"linear theory {100 * error:g} % off at v0*"
        number = scene.strike_number
        yield Boundary(name, "Eq. (3)", "", bound, here=number, beyond=number > bound)


def _overlap(scene: Scene) -> Iterator[Boundary]:
    strain = deepest(scene)
    # The bound is infinite for a forced scene.
    beyond = LIMITS.compression < strain < math.inf
    name = "Hertz's law: overlap over diameter"
    yield Boundary(name, "Eq. (1)", "", LIMITS.compression, here=strain, beyond=beyond)


def _strength(scene: Scene) -> Iterator[Curve]:
    linear = engines.Chebyshev()
    scenes = [scene.replace(excitation=scene.excitation.scaled(factor)) for factor in STRENGTHS]
    if not linear.refuses(scene.reached):
        looks = [linear.look(other.reached) for other in scenes]
        estimates = np.array([look.error for look in looks])
        bounds = np.array([look.at_most for look in looks])
        yield Curve("strength", "Eq. (3), estimate", STRENGTHS, estimates)
        yield Curve("strength", "Eq. (3), at most", STRENGTHS, bounds)
    for engine, diameter in ROUNDINGS:
        floors = np.array([floor(other, engine, diameter) for other in scenes])
        yield Curve("strength", f"{_name(engine, diameter)}, round-off", STRENGTHS, floors)


def _too_long(scene: Scene) -> bool:
    return expected_seconds(scene) > LONGEST_S
