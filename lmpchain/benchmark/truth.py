"""Reference solution for true errors: Taylor series, or a tight native run of a long scene."""

from __future__ import annotations

import math

import numpy as np

from ..engines.cost_model import announce
from ..errors import InputError, LmpchainError, ToleranceNotMet
from ..scene.excitation import Drive, Force
from ..scene.scene import Scene
from ..scene.trace_file import smooth
from ..simulation.api import simulate
from ..trajectory.record import Cost, ErrorEstimate
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.remarks import warnings_aside
from .reference import Reference, expected_seconds, reference

__dir__ = listed(__name__)

LONGEST_S = 60.0  # Longest expected time of the independent reference, s.
TIGHTEST = 1e-11  # Tolerance that the native engine reaches on ordinary scenes.


def truth(scene: Scene, tolerance: float = 1e-6, *, progress: bool = False) -> Reference:
    """Return the reference solution, from the native engine if Taylor series need over a minute.

    Parameters
    ----------
    scene : Scene
    tolerance : float
        Tolerance of the answers that are compared with the reference. The native engine runs at a
        hundredth of this tolerance.
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
    """Return a native run at a hundredth of the tolerance, or at it, and the tolerance met."""
    tight = max(tolerance / 100, TIGHTEST)
    try:
        return simulate(scene, "native", tight, progress=progress), tight
    except ToleranceNotMet as error:
        # A run that ends early because of chaos is no reference for the whole scene.
        if error.trajectory and error.trajectory.scene == scene:
            return error.trajectory, tight
    return simulate(scene, "native", tolerance, progress=progress), tolerance


def as_trajectory(scene: Scene, solution: Reference) -> Trajectory:
    """Return a reference solution as a trajectory with the recorded grains of its scene.

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


# Largest number of trace points; the steps of the reference end at each point.
MOST_POINTS = 2000


def thin_trace(scene: Scene, tolerance: float) -> tuple[Scene, str]:
    """Return a scene whose force or drive has fewer points, and a sentence about the difference.

    The trace is first filtered by a low pass at half of the highest frequency that the remaining
    points can represent. A scene with few points during the run is returned unchanged, with an
    empty sentence.

    Parameters
    ----------
    scene : Scene
    tolerance : float
        Tolerance of the two native runs that show how much the answer changes.

    Returns
    -------
    Scene and str
        Scene with fewer points; sentence about the difference.
    """
    excitation = scene.excitation
    if not isinstance(excitation, Drive | Force) or excitation.times is None:
        return scene, ""
    times = excitation.times
    points = int(np.searchsorted(times, scene.duration)) + 1
    every = math.ceil(points / MOST_POINTS)
    if every <= 1:
        return scene, ""
    name = excitation.strength[1]
    values: Array = getattr(excitation, name)
    lowpass = 0.25 * (times.size - 1) / (every * (times[-1] - times[0]))
    options = f"every={every}, lowpass={lowpass:.3g}"
    try:
        values = smooth(times, values[:, None], lowpass)[:, 0]
    except InputError:
        # The filter needs equally spaced points.
        options = f"every={every}"
    if scene.drive:
        # A drive starts at displacement 0.
        values = values - values[0]
    thinner = scene.replace(
        excitation=excitation.replace(times=times[::every], **{name: values[::every]})
    )
    kept = int(np.searchsorted(times[::every], scene.duration)) + 1
    return thinner, (
        f"trace: {kept} of the {points} points of this run are used ({options}), because steps of "
        f"the reference end at every point; {_change(scene, thinner, tolerance)}; to compare "
        "another trace, give every and lowpass with its file"
    )


def _change(scene: Scene, thinner: Scene, tolerance: float) -> str:
    """Return a sentence about the difference between native runs of two scenes."""
    try:
        with warnings_aside():
            whole, part = (simulate(each, "native", tolerance) for each in (scene, thinner))
    except LmpchainError as error:
        return f"the effect on the answer is unknown ({str(error).splitlines()[0]})"
    pairs = ((whole.displacement, part.displacement), (whole.velocity, part.velocity))
    change = max(np.abs(a - b).max() / (np.abs(a).max() or 1.0) for a, b in pairs)
    return f"this changes the answer by {change:.1e} (native)"
