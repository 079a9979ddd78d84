"""The solution for true errors: the reference, or a tight native run of a long scene."""

from __future__ import annotations

from ..engines.cost_model import announce
from ..errors import ToleranceNotMet
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..trajectory.record import Cost, ErrorEstimate
from ..trajectory.trajectory import Trajectory
from ..util.lazy import listed
from .reference import Reference, expected_seconds, reference

__dir__ = listed(__name__)

LONGEST_S = 60.0  # expected time of the independent reference
TIGHTEST = 1e-11  # a tolerance that the native engine reaches on ordinary scenes


def truth(scene: Scene, tolerance: float = 1e-6, *, progress: bool = False) -> Reference:
    """Return the reference solution, by the native engine if Taylor series took over a minute.

    Parameters
    ----------
    scene : Scene
    tolerance : float
        Of the answers that are compared with it: the native engine is a hundred times as accurate.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Reference
    """
    needed_s = expected_seconds(scene)
    if needed_s <= LONGEST_S:
        announce(needed_s, "the reference by Taylor series", "a shorter duration takes less")
        return reference(scene)
    # Errors are relative to the largest motion of any grain, so all grains must be recorded.
    all_grains = Scene(
        chain=scene.chain,
        excitation=scene.excitation,
        duration=scene.duration,
        samples=scene.samples,
    )
    run, tight = _solve_tightly(all_grains, tolerance, progress)
    reason = "the scene is too long for the independent integrator"
    method = f"the native engine at a tolerance of {tight:g} ({reason})"
    return Reference(run.time, run.displacement, run.velocity, run.error_estimate.total, method)


def _solve_tightly(scene: Scene, tolerance: float, progress: bool) -> tuple[Trajectory, float]:
    """Return a native run at a hundredth of the tolerance, or at the tolerance, and its name."""
    tight = max(tolerance / 100, TIGHTEST)
    try:
        return simulate(scene, "native", tight, progress=progress), tight
    except ToleranceNotMet as error:
        # A run that ends early because of chaos is no reference for the whole scene.
        if error.trajectory and error.trajectory.scene == scene:
            return error.trajectory, tight
    return simulate(scene, "native", tolerance, progress=progress), tolerance


def as_trajectory(scene: Scene, solution: Reference) -> Trajectory:
    """Return a reference solution as the trajectory of a scene, of the grains that it records.

    Parameters
    ----------
    scene : Scene
    solution : Reference

    Returns
    -------
    Trajectory
    """
    columns = scene.recorded - 1
    return Trajectory(
        scene=scene,
        engine="reference",
        equation=1,
        time=solution.time,
        grains=scene.recorded.copy(),
        displacement=solution.displacement[:, columns],
        velocity=solution.velocity[:, columns],
        error_estimate=ErrorEstimate(0.0, solution.error),
        cost=Cost(0.0, 0.0, 0.0, 0, 0, scene.chain.grains, "", 0.0, 1),
    )
