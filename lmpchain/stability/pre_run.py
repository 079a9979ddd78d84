"""Warnings before a run: the boundaries that a scene lies beyond, each in a line."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ..chain.plausible import LIMITS
from ..engines.base import Engine
from ..engines.native.step_choice import FIRST_STEP
from ..scene.scene import Scene
from .overlap import deepest, hertz_excess
from .predictability import amplifies, predicted_time
from .step_limit import limit

# analysis/calibration/stability_limits.py
TRUSTED = 0.7  # of `step_limit.limit`: Verlet held for 300 periods


def pre_run_warnings(scene: Scene, engine: Engine | None, tolerance: float) -> Iterator[str]:
    """Yield what is beyond a boundary: overlaps, a given step, and time until which an answer can be had."""
    deep = deepest(scene)
    if LIMITS.compression < deep < math.inf:
        excess = f"Hertz's law is {100 * hertz_excess(min(deep, 0.5)):.2g} % off there by the shape of spheres alone"
        yield f"contacts may be squeezed to {100 * deep:.2g} % of the diameter: {excess}"
    if engine and engine.step is not None:
        method, edge = engine.methods[0], scene.reached.chain.band_edge
        longest = limit(scene, method.name) * (
            TRUSTED if scene.largest_strain > FIRST_STEP.safe_strain else 1.0
        )
        if (
            longest < engine.step and engine.step * edge <= method.stability_limit
        ):  # beyond, the engine refuses it
            yield (
                f"step: {engine.step:.3g} s is stable at rest, but while the strike squeezes the contacts only steps "
                f"below {longest:.3g} s are known to be"
            )
    if amplifies(scene) and (limit_s := predicted_time(scene, tolerance)) < scene.duration:
        yield (
            f"duration: contacts that open amplify round-off beyond {tolerance:g} at about {limit_s:.2g} s; what "
            f"comes later cannot be computed"
        )
