"""The native engine as one of the codes, at given steps and to a tolerance."""

from __future__ import annotations

from functools import partial
from importlib.metadata import version
from time import perf_counter

from problem import Answer, Code, Problem

import lmpchain
from lmpchain.integrators.methods import METHODS

TO_TOLERANCE = "native to a tolerance, with estimate"
COUNTS = [round(8 * 2 ** (k / 4)) for k in range(53)]  # Numbers of steps, up to 65 536.
TOLERANCES = [10 ** (-k / 4) for k in range(8, 57)]  # 1e-2 to 1e-14.


def _at_step(integrator: str, problem: Problem, step: float) -> Answer:
    begin = perf_counter()
    run = lmpchain.simulate(problem.scene, lmpchain.engines.Native(integrator, step=step))
    return _answer(run, run.cost.integration_s, perf_counter() - begin)


def _to_tolerance(estimate: bool, problem: Problem, tolerance: float) -> Answer:
    begin = perf_counter()
    run = lmpchain.simulate(problem.scene, "native", tolerance)
    whole = perf_counter() - begin
    return _answer(run, run.cost.integration_s + estimate * run.cost.estimate_s, whole)


def _answer(run: lmpchain.Trajectory, seconds: float, whole: float) -> Answer:
    return Answer(
        run.displacement[-1], run.velocity[-1], seconds, run.cost.force_evaluations, whole
    )


def codes(problem: Problem) -> list[Code]:
    """Return every integrator, and the engine's own choice with and without error estimate."""
    steps = [problem.scene.duration / count for count in COUNTS]
    own = version("lmpchain")
    given = [Code(f"native {name}", own, steps, partial(_at_step, name)) for name in METHODS]
    chosen = {"native to a tolerance, integration alone": False, TO_TOLERANCE: True}
    return given + [
        Code(name, own, TOLERANCES, partial(_to_tolerance, estimate))
        for name, estimate in chosen.items()
    ]
