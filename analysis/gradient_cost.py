"""Cost of all derivatives of a run, relative to the run itself at the same step.

    python analysis/gradient_cost.py

Every grain moves from the start, so that no run is spared what a wave has not reached. The run is
the stepper of the native engine alone, without the companions that show its error; both are timed
with their setting up. Times are seconds of the processor, so that others on the machine do not
count. Writes tables/gradient_cost.md, which docs/design.md shows.
"""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from figures import TABLES, write_table

from lmpchain import Chain, Profile, Scene
from lmpchain.design import Momentum
from lmpchain.design.gradients import at_step, shortens
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.differentiation import DIFFERENTIABLE
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps

SAMPLES = 11
REPEATS = 9
COLUMNS = {120: 30000, 10000: 1000}  # Steps by number of grains.
WAVES: dict[str, tuple[float, dict[str, Any]]] = {  # Velocities, m/s, and options of the chain.
    "strong": (1e-3, {}),
    "in a loaded chain": (1e-2, {"top_load": 1.0}),
    "between weak and strong": (4e-4, {"top_load": 1.0}),
    "weak": (1e-9, {}),
    "weak, exponent 1.75": (1e-9, {"exponent": 1.75}),
    "strong, exponent 2": (1e-3, {"exponent": 2.0}),
    "in a sonic vacuum": (1e-3, {"gravity": 0.0}),
}
DAMPED: dict[str, tuple[float, dict[str, Any]]] = {
    "damped": (1e-2, {"top_load": 1.0, "damping": {"viscoelastic": 1e-9, "drag": 1e2}}),
    "damped, exponent 2": (1e-3, {"exponent": 2.0, "damping": {"viscoelastic": 1e-9}}),
    # Steps are shorter where contacts open.
    "damped, in a sonic vacuum": (1e-2, {"gravity": 0.0, "damping": {"viscoelastic": 1e-9}}),
}


def costs(wave: str, grains: int, steps: int, integrator: str) -> tuple[float, float]:
    """Return the times of the run and of the gradient, s, each the least of several repeats."""
    speed, options = (WAVES | DAMPED)[wave]
    velocity = np.append(speed * np.random.default_rng(1).standard_normal(grains - 1), 0.0)
    chain = Chain(grains=grains, diameter=1e-3, **options)
    scene = Scene(chain=chain, excitation=Profile(velocity=velocity), duration=1e-5)
    method = DIFFERENTIABLE[integrator]
    turn = 0.2 if integrator == "verlet" else 1.0
    per = steps // (SAMPLES - 1)
    step = turn / scene.highest_frequency
    scene = scene.replace(duration=step * per * (SAMPLES - 1), samples=SAMPLES)
    adaptive = shortens(scene, method)
    bare = []
    gradient = []
    for _ in range(REPEATS):
        began = time.process_time()
        run = NativeStepper(ChainBatch([scene]), method, Steps(per, 1, step, adaptive), {})
        u, v = np.zeros((2, 1, SAMPLES, grains))
        run.fill(u, v, 0, SAMPLES - 1, 10**9)
        bare.append(time.process_time() - began)
        began = time.process_time()
        names = ["masses", "contact_constants"]
        at_step(scene, Momentum([grains // 2]), names, method, step, adaptive)
        gradient.append(time.process_time() - began)
    return min(bare), min(gradient)


def measure() -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table: the ratios of all integrators for each wave."""
    for wave in WAVES | DAMPED:
        integrators = ("verlet", "rkn4", "rkn6") if wave in WAVES else ("dop853",)
        cells = []
        for grains, steps in COLUMNS.items():
            ratios = []
            for integrator in integrators:
                bare, gradient = costs(wave, grains, steps, integrator)
                ratios.append(f"{gradient / bare:.1f}")
            ends = dict.fromkeys((min(ratios, key=float), max(ratios, key=float)))
            cells.append(" to ".join(ends))
        yield wave, ", ".join(integrators), *cells


if __name__ == "__main__":
    write_table(
        TABLES / "gradient_cost.md",
        ("wave", "integrators", *(f"{grains:,} grains" for grains in COLUMNS)),
        measure(),
    )
