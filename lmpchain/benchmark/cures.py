"""Find the longest step with which an integrator reaches an error, and the rounding of heights."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from ..engines.lammps.engine import HEIGHTS, Lammps, gauge_diameter
from ..engines.native import Native
from ..errors import InputError, RunFailed
from ..integrators.methods import LAGGED, methods_of
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..trajectory.trajectory import Trajectory
from ..util.remarks import warnings_aside
from .comparison import error
from .reference import Reference

TARGETS = (1e-3, 1e-6)
# Methods that LAMMPS users have, and the most accurate ones. Chains with damping use those of them
# that support forces that depend on velocities.
INTEGRATORS = ("verlet", "kahan-li6", "rkn6", "dop853")
MOST_INTEGRATORS = 3


@dataclass(frozen=True)
class Search:
    """Settings of the search for the longest step.

    Attributes
    ----------
    cost_s : float
        Longest expected time of a trial run, s.
    growth : float
        Largest factor by which the number of steps grows between two runs.
    room : float
        Fraction of the target error for which the next step is chosen.
    better : float
        An error below this multiple of the best one counts as an improvement.
    patience : int
        Number of consecutive runs without an improvement after which rounding error dominates.
    """

    cost_s: float = 3.0
    growth: float = 8.0
    room: float = 0.8
    better: float = 0.8
    patience: int = 3


SEARCH = Search()


class Cure(NamedTuple):
    """A step with which an integrator reaches an error.

    Attributes
    ----------
    target : float
        Requested error.
    integrator : str
        Name of the integrator.
    step_s : float
        Time step, s; NaN if no step reaches the error in a run of some seconds.
    steps : int
        Number of steps of the run.
    error : float
        Measured error of the native engine with this step; NaN without a step.
    heights : float
        Expected relative rounding error of heights in LAMMPS; NaN if LAMMPS lacks the integrator.
    diameter : str
        Diameter in LAMMPS that this rounding error assumes: "physical", or "gauge" if the rounding
        error with the physical diameter is too large.
    """

    target: float
    integrator: str
    step_s: float
    steps: int
    error: float
    heights: float
    diameter: str


def twin_run(scene: Scene, integrator: str, step: float) -> Trajectory | None:
    """Return the native run of all grains with this step, s; None where it breaks down."""
    everything = scene.ungathered.replace(grains="all")
    try:
        # The errors are measured here, so warnings about expected errors are suppressed.
        with warnings_aside():
            return simulate(everything, Native(integrator, step), on_miss="warn")
    except (InputError, RunFailed):
        return None


def stability_limit(scene: Scene, integrator: str) -> float:
    """Return the longest stable step on the chain at rest, s; infinite if nothing presses it."""
    rate = scene.chain.fastest_rate
    return methods_of(scene.chain)[integrator].stability_limit / rate if rate else math.inf


def height_round_off(
    scene: Scene, integrator: str, steps: int, solution: Reference, gauge: float = 0.0
) -> float:
    """Return the expected relative rounding error of heights in LAMMPS after a number of steps.

    `gauge` is the gauge diameter of the grains in LAMMPS, m; 0 for their physical diameters.
    """
    # Both damped methods use the step sequence of velocity Verlet.
    name = "verlet" if integrator == LAGGED.name else integrator
    if name not in Lammps.integrators:
        return math.nan
    bound = Lammps(name).round_off(scene, gauge, steps, solution.scale)
    return HEIGHTS.typical * bound


def cures(scene: Scene, solution: Reference, integrator: str) -> tuple[Cure, ...]:
    """Return the longest steps with which several integrators reach each target error."""
    methods = methods_of(scene.chain)
    names = [name for name in dict.fromkeys((integrator, *INTEGRATORS)) if name in methods]
    rows = [cure for name in names[:MOST_INTEGRATORS] for cure in _cures_of(scene, solution, name)]
    return tuple(sorted(rows, key=lambda cure: -cure.target))


def _cures_of(scene: Scene, solution: Reference, integrator: str) -> Iterator[Cure]:
    interval = scene.sampling_interval
    # The overlaps of a driven scene, and so its gauge diameter, are not known beforehand.
    gauge = 0.0 if scene.excitation.does_work else gauge_diameter(scene)
    measured: dict[int, float] = {}
    for target in TARGETS:
        per_sample = _fewest_steps(scene, solution, integrator, target, measured)
        if per_sample is None:
            yield Cure(target, integrator, math.nan, 0, math.nan, math.nan, "physical")
            continue
        steps = per_sample * scene.intervals
        heights = height_round_off(scene, integrator, steps, solution)
        small = heights > target / 2 and gauge > 0
        if small:
            heights = height_round_off(scene, integrator, steps, solution, gauge)
        yield Cure(
            target,
            integrator,
            interval / per_sample,
            steps,
            measured[per_sample],
            heights,
            "gauge" if small else "physical",
        )


def _fewest_steps(
    scene: Scene, solution: Reference, integrator: str, target: float, measured: dict[int, float]
) -> int | None:
    """Return about the fewest steps per sample that reach the target error; None if none does.

    `measured` stores the measured error for each number of steps.
    """
    method = methods_of(scene.chain)[integrator]
    engine = Native(integrator)
    interval = scene.sampling_interval
    failing = 0

    def measure(steps: int) -> float:
        if steps not in measured:
            run = twin_run(scene, integrator, interval / steps)
            measured[steps] = math.inf if run is None else error(run, solution)
        return measured[steps]

    def steps_for(steps: int, aim: float) -> int:
        """Extrapolate a measured error by the order of the method to the steps that reach `aim`."""
        return math.ceil(steps * (measured[steps] / aim) ** (1 / method.order))

    steps = max(1, math.ceil(interval / stability_limit(scene, integrator)))
    steps = max([steps, *(count for count in measured if measured[count] > target)])
    best = math.inf
    stalled = 0
    while not measure(steps) <= target:
        failing = steps
        stalled = 0 if measured[steps] < SEARCH.better * best else stalled + 1
        best = min(best, measured[steps])
        coarse = not measured[steps] < 1
        most = math.ceil(SEARCH.growth * steps)
        steps = (
            2 * steps
            if coarse
            else max(steps + 1, min(steps_for(steps, SEARCH.room * target), most))
        )
        cost = engine.cost(scene, method, steps * scene.intervals)
        if cost > SEARCH.cost_s or (stalled > SEARCH.patience and not coarse):
            return None
    # The last extrapolation was too optimistic, so this attempt moves by a single step.
    fewer = max(steps_for(steps, target), failing + 1)
    return fewer if fewer < steps and measure(fewer) <= target else steps


def distance(answer: Trajectory, twin: Trajectory, solution: Reference) -> float:
    """Return the relative difference of two runs, scaled by the largest motion of the solution."""
    other = Reference(twin.time, twin.displacement, twin.velocity, 0.0, "", solution.scale)
    return error(answer, other)
