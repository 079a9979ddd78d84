"""Warnings before a run: the boundaries that a scene lies beyond, each in a line."""

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

# analysis/calibration/stability_limits.py
TRUSTED = 0.7  # of `step_limit.limit`, with which Verlet held for 300 periods


def pre_run_warnings(scene: Scene, engine: Engine | None, tolerance: float) -> Iterator[str]:
    """Yield warnings of overlaps, of a given step, and of a duration beyond predictability."""
    deep = deepest(scene)
    if LIMITS.compression < deep < math.inf:
        percent = f"{100 * hertz_excess(min(deep, 0.5)):.2g} %"
        excess = f"Hertz's law is {percent} off there by the shape of spheres alone"
        yield f"contacts may be squeezed to {100 * deep:.2g} % of the diameter: {excess}"
    if engine and engine.step is not None:
        method = engine.methods(scene)[0]
        edge = scene.reached.chain.band_edge
        longest = limit(scene, method.name)
        if scene.largest_strain > FIRST_STEP.safe_strain:
            longest *= TRUSTED
        # a step that is not stable at rest the engine refuses
        if longest < engine.step and engine.step * edge <= method.stability_limit:
            rest = f"step: {engine.step:.3g} s is stable at rest"
            strike = "while the strike squeezes the contacts only steps below"
            yield f"{rest}, but {strike} {longest:.3g} s are known to be"
    if amplifies(scene) and (end := predicted_time(scene, tolerance)) < scene.duration:
        opening = f"duration: contacts that open amplify round-off beyond {tolerance:g}"
        yield f"{opening} at about {end:.2g} s; what comes later cannot be computed"
