"""Largest overlaps of a scene, and warnings before a run about limits that the scene exceeds."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from ..chain.bounds import LIMITS
from ..engines.base import Engine
from ..engines.stepping.step_choice import FIRST_STEP
from ..errors import InputError, shown
from ..scene.scene import Scene
from ..util.arrays import Array, numbers
from .predictability import amplifies, predicted_time
from .step_limit import limit


def deepest(scene: Scene) -> float:
    """Return an upper bound on overlap over diameter; infinite if the scene is forced.

    The bound holds because no contact can store more than the energy of the strike, see
    `Contacts.overlap_bound`. `Scene` rejects strikes whose first collision causes an overlap above
    a tenth of the diameter, but lighter grains or a wall further down may have larger overlaps
    later.
    """
    reached = scene.reached
    return float((reached.overlap_bounds / reached.chain.contact_lengths).max())


def hertz_excess(strain: ArrayLike) -> Array:
    """Return the relative excess of Hertz's force over the force of spheres, at overlap / diameter.

    The excess is due to the shape alone, because Hertz's theory replaces spheres by paraboloids.
    Spheres of radius R with the contact radius a have ``o = 2 a artanh(a/R)`` and
    ``F = 2 E* [(a^2 + R^2) artanh(a/R) - a R]``; I. N. Sneddon, Int. J. Eng. Sci. 3, 47 (1965). The
    excess is about ``strain / 10``. Deviations from half-spaces and yielding are not included.

    Raises
    ------
    InputError
        If the overlap is not between 0 and the diameter.
    """
    strain = numbers(strain, "strain")
    if not ((strain > 0) & (strain < 1)).all():
        raise InputError.at("strain", f"must be between 0 and 1 (got {shown(strain)})")
    # Newton's method for x = a / R.
    x = np.sqrt(strain)
    for _ in range(20):
        x = x - (x * np.arctanh(x) - strain) / (np.arctanh(x) + x / (1 - x * x))
    # The difference cancels for small x, where the series is used.
    series = 4 / 3 * x**3 * (1 + 2 / 5 * x**2)
    force = np.where(x > 1e-2, (1 + x * x) * np.arctanh(x) - x, series)
    return 1 - force / (4 / 3 * strain**1.5)


# See analysis/calibration/stability_limits.py.
TRUSTED = 0.7  # Fraction of `step_limit.limit` at which Verlet was stable for 300 periods.


def pre_run_warnings(scene: Scene, engine: Engine | None, tolerance: float) -> Iterator[str]:
    """Yield warnings about overlaps, a given step, and unpredictable durations."""
    deep = deepest(scene)
    if LIMITS.compression < deep < math.inf:
        percent = f"{100 * hertz_excess(min(deep, 0.5)):.2g} %"
        excess = f"Hertz's law then has an error of {percent} or more"
        yield f"contacts may be compressed by {100 * deep:.2g} % of the diameter: {excess}"
    if engine and engine.step is not None:
        method = engine.methods(scene)[0]
        edge = scene.reached.chain.band_edge
        longest = limit(scene, method.name)
        if scene.largest_strain > FIRST_STEP.safe_strain:
            longest *= TRUSTED
        # The engine itself rejects steps that are unstable at rest.
        if longest < engine.step and engine.step * edge <= method.stability_limit:
            rest = f"step: {engine.step:.3g} s is stable at rest"
            strike = "may be unstable while contacts are compressed by the strike"
            yield f"{rest}, but {strike}: use a step below {longest:.3g} s"
    if amplifies(scene) and (end := predicted_time(scene, tolerance)) < scene.duration:
        opening = f"duration: opening contacts amplify rounding errors beyond {tolerance:g}"
        yield f"{opening} at about {end:.2g} s; the later motion is unpredictable"
