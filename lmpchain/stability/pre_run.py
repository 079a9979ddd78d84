"""Warnings before a run about limits that the scene exceeds, one line each."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ..chain.plausible import LIMITS
from ..engines.base import Engine
from ..engines.stepping.step_choice import FIRST_STEP
from ..scene.scene import Scene
from .overlap import deepest, hertz_excess
from .predictability import amplifies, predicted_time
from .step_limit import limit

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
