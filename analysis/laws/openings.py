"""Order reduction of fixed-step methods where contacts open, and the drift of their energy."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from lmpchain import Scene, engines
from lmpchain.benchmark.reference import Reference
from lmpchain.integrators.methods import METHODS
from lmpchain.integrators.steps import Steps
from lmpchain.theory.modes import eigenmodes
from lmpchain.util.arrays import Array


def drift(scene: Scene, growth: Callable[[float], float], step: float) -> float:
    """Return the predicted relative rate, 1/s, at which a weak wave gains energy from a method.

    Every mode k gains 2 ln g(omega_k h) / h, and counts by the part of the energy that it is given.
    `growth` is g of the method, `Method.growth`: 1 for every splitting, above 1 for gear4, below 1
    for dop853.
    """
    modes = eigenmodes(scene.chain)
    moving = slice(scene.chain.movable)
    u, v = ((x[moving] * modes.mass) @ modes.shape for x in scene.initial())
    part = (u * modes.frequency) ** 2 + v**2
    rates = [2 * math.log(growth(omega * step)) / step for omega in modes.frequency]
    return float(part @ np.array(rates) / part.sum())


def order_through_openings(integrator: str, exponent: float) -> float:
    """Return the order of a fixed-step method where contacts open or close.

    There the force goes as t^delta. A step h that holds such a moment is wrong by some h^(delta+1)
    in the velocity, whatever the method, and there are so many such steps as openings: the error is
    h^(delta+1) or h^p.
    """
    return min(METHODS[integrator].order, exponent + 1)


def errors_through_openings(
    scene: Scene,
    integrator: str,
    counts: Iterable[int],
    reference: Reference,
    adaptive: bool = False,
    runs: int = 40,
) -> Array:
    """Return relative errors at the end of a scene at about these numbers of native steps.

    Steps are of one length, or adaptive, with short ones at openings. Each is the root of the mean
    square over so many `runs` of up to a fifth more steps, for the error of a step that crosses an
    opening depends on where in the step that falls. One error is the largest difference from the
    reference over the largest value in any of its samples, the larger one of displacement and
    velocity.
    """
    engine = engines.Native(integrator=integrator)
    scene = Scene(**scene.given() | {"samples": 2, "grains": "all"})
    proposed = engine.propose(scene, 0.5)
    true = reference.displacement, reference.velocity

    def error(count: int) -> float:
        steps = Steps.spread(scene.duration, count, adaptive=adaptive)
        candidate = proposed._replace(steps=steps)
        run = engine.start([scene], candidate)
        try:
            *_, last = run.blocks()
        finally:
            run.close()
        end = last.displacement[0, -1], last.velocity[0, -1]
        return float(
            max(np.abs(x - y[-1]).max() / np.abs(y).max() for x, y in zip(end, true, strict=True))
        )

    groups = [np.linspace(count, 1.2 * count, runs).astype(int) for count in counts]
    return np.array(
        [math.sqrt(np.mean([error(int(count)) ** 2 for count in group])) for group in groups]
    )
