"""Forces and drives that are sampled more densely than a comparison of engines can follow."""

from __future__ import annotations

import math

import numpy as np

from ..errors import InputError, LmpchainError
from ..scene.excitation import Drive, Force
from ..scene.scene import Scene
from ..scene.trace_file import smooth
from ..simulation.api import simulate
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.remarks import warnings_aside

__dir__ = listed(__name__)

# Points of a trace at each of which the steps of the reference end.
MOST_POINTS = 2000


def thin_trace(scene: Scene, tolerance: float) -> tuple[Scene, str]:
    """Return a scene whose force or drive has fewer points, and a sentence about the difference.

    A low pass at half of the highest frequency that the remaining points can show comes first. The
    scene itself and no words are returned if it has few points during the run.

    Parameters
    ----------
    scene : Scene
    tolerance : float
        Of the two native runs that show how much the answer changes.
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
        f"trace: through {kept} of the {points} points of this run ({options}), because steps of "
        f"the reference end at every point; {_change(scene, thinner, tolerance)}; to compare "
        "another trace, give every and lowpass with its file"
    )


def _change(scene: Scene, thinner: Scene, tolerance: float) -> str:
    """Return a sentence with the difference of two scenes in runs of the native engine."""
    try:
        with warnings_aside():
            whole, part = (simulate(each, "native", tolerance) for each in (scene, thinner))
    except LmpchainError as error:
        return f"how much this changes the answer is not known ({str(error).splitlines()[0]})"
    pairs = ((whole.displacement, part.displacement), (whole.velocity, part.velocity))
    change = max(np.abs(a - b).max() / (np.abs(a).max() or 1.0) for a, b in pairs)
    return f"this changes the answer by {change:.1e} (native)"
