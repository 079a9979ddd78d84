"""Gradients of an objective with respect to what a scene is made of, with an estimate of their error."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..engines.round_off import native_floor
from ..errors import InputError, RunFailed, ToleranceNotMet, check_tolerance
from ..integrators.adjoint import DifferentiableRun, Inputs
from ..integrators.held_steps import adaptive_steps
from ..integrators.splittings import SPLITTINGS, Splitting
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.suggestions import not_among
from . import parameters as params
from .objectives import Objective, Seen

TURN = 0.25  # of the fastest motion between two looks of a dense objective, rad
HALVINGS = 12
# on the differences of a gradient from those at two other steps, where the order of the method may be lost
SAFETY = 2.5  # analysis/calibration/halved_steps.py
NEARBY = 1.5  # ratio of one of them: where contacts open, two steps often agree by chance


@dataclass(frozen=True, eq=False)
class Gradient(Mapping[str, Array]):
    """An objective and its derivatives by name of the parameters.

    Attributes
    ----------
    value : float
    gradients : dict
        Arrays (P,) by name: per kg, per N/m^delta and so on.
    errors : dict
        Estimated largest error of each gradient, in the same units.
    error : float
        The largest error relative to the largest derivative with respect to the same kind of parameter.
    value_error : float
        Of the value, in its unit.
    step_s : float
    integrator : str
    """

    value: float
    gradients: Mapping[str, Array]
    errors: Mapping[str, float]
    value_error: float
    step_s: float
    integrator: str

    @property
    def error(self) -> float:
        """The largest error relative to the largest derivative with respect to the same kind of parameter."""
        return max(_relative(self.errors[name], self.gradients[name]) for name in self.gradients)

    def __getitem__(self, name: str) -> Array:
        return self.gradients[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.gradients)

    def __len__(self) -> int:
        return len(self.gradients)


def _relative(error: float, gradient: Array) -> float:
    largest = float(np.abs(gradient).max())
    return error / largest if largest > 0 else (0.0 if error == 0 else math.inf)


def looks_of(scene: Scene, objective: Objective, finer: int = 1) -> int:
    """Return how often an objective looks at a scene after t = 0: at the samples, or a multiple of that."""
    interval = scene.duration / (scene.samples - 1)
    more = finer * max(1, math.ceil(interval * scene.highest_frequency / TURN)) if objective.dense else 1
    return (scene.samples - 1) * more


def at_step(
    scene: Scene,
    objective: Objective,
    names: Iterable[str],
    method: Splitting,
    step: float,
    finer: int = 1,
    adaptive: bool = False,
) -> tuple[float, dict[str, Array], DifferentiableRun]:
    """Return value and gradients of a run by steps of one length, or of this length at most, and the run.

    Raises
    ------
    RunFailed
        If the motion breaks down.
    """
    grains = np.unique(objective.grains(scene))
    looks = looks_of(scene, objective, finer)
    held = adaptive_steps(scene, method, step, looks) if adaptive else step
    run = DifferentiableRun(scene, method, held, looks, grains)
    if not np.isfinite(run.velocity).all():
        raise RunFailed(f"the motion breaks down with steps of {run.step:.3g} s: use shorter ones")
    slopes = objective(Seen(scene, run.time, grains, run.displacement, run.velocity))
    names = tuple(names)
    everywhere = not {"displacement", "velocity"}.isdisjoint(names)
    inputs = run.pull(slopes.displacement, slopes.velocity, everywhere)
    nothing = np.zeros(scene.chain.grains), np.zeros(scene.chain.grains), np.zeros(inputs.drive.size)
    inputs += Inputs(slopes.masses, slopes.constants, slopes.forces, *nothing)
    return slopes.value, {name: params.pull(scene, inputs, name) for name in names}, run


def nearby(run: DifferentiableRun) -> float:
    """Return a step half again as long as that of a run, or as much shorter where there is no such step."""
    return run.step * NEARBY if run.steps > 2 * (run.time.size - 1) else run.step / NEARBY


def _with_errors(
    value: float,
    gradients: dict[str, Array],
    others: Sequence[tuple[float, dict[str, Array]]],
    floor: float,
    method: str,
    step: float,
) -> Gradient:
    """Return a gradient with its errors, from those at other steps and from relative round-off."""
    errors = {
        name: SAFETY * sum(float(np.abs(now - other[name]).max()) for _, other in others)
        + floor * float(np.abs(now).max())
        for name, now in gradients.items()
    }
    off = SAFETY * sum(abs(value - other) for other, _ in others) + floor * abs(value)
    return Gradient(value, gradients, errors, off, step, method)


def gradient(
    scene: Scene,
    objective: Objective,
    parameters: Iterable[str],
    tolerance: float = 1e-6,
    integrator: str | None = None,
    step: float | None = None,
    adaptive: bool = False,
) -> Gradient:
    """Return an objective and its exact derivatives with respect to what a scene is made of.

    The adjoint of the native integrator is run at the step of the answer and at one twice as long, whose difference is
    the error; steps are halved until it is within the tolerance. Where contacts open, the two may agree by chance: what
    a third one differs, at a step half again as long, is added. An objective that looks between samples looks half as
    often in the run of the longest steps, so that the difference shows what it misses in between, too.

    Parameters
    ----------
    scene : Scene
    objective : Objective
        Such as `PeakForce(40)`.
    parameters : names
        Of "masses", "contact_constants", "wall_constants", "diameters", "youngs_moduli", "top_load", "gravity",
        "displacement" and "velocity" (at t = 0), "drive" (its samples), "amplitude" and "frequency".
    tolerance : float
        Of the gradient, relative to its largest entry of each name.
    integrator : "verlet", "rkn4", "rkn6", "kahan-li6" or "kahan-li8", optional
        By default rkn6, or rkn4 where the objective looks between samples.
    step : float, optional
        s; no tolerance is enforced then.
    adaptive : bool
        Whether steps are shorter where contacts open or close, which keeps the order of the method; in the derivatives
        they are held. Not of verlet.

    Returns
    -------
    Gradient
        Its `value`, arrays by name, `error` and `errors`.

    Raises
    ------
    InputError
        If a parameter is unknown, or has no derivative in this scene.
    ToleranceNotMet
        If halving steps does not help any more.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse, Scene
    >>> from lmpchain.design import PeakForce
    >>> chain = Chain(grains=10, diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=2e-5, samples=21)
    >>> found = gradient(scene, PeakForce(5), ["masses", "gravity"], tolerance=1e-5)
    >>> found["masses"].shape, found.error < 1e-5
    ((10,), True)
    """
    names = params.check(scene, parameters)
    check_tolerance(tolerance)
    chosen = integrator or ("rkn4" if objective.dense else "rkn6")
    if chosen not in SPLITTINGS:
        raise InputError([("integrator", not_among(chosen, tuple(SPLITTINGS)))])
    method = SPLITTINGS[chosen]
    if adaptive and method.adaptive == "no":
        raise InputError([("adaptive", f"{chosen} has no adaptive steps: use rkn4 or rkn6")])
    first = step or min(1.5, method.stability_limit / 4) / scene.highest_frequency
    value, gradients, run = at_step(scene, objective, names, method, 2 * first, 1, adaptive)
    for halving in range(1, 2 if step else HALVINGS + 1):
        others, longer, finer = [(value, gradients)], run.step, 2**halving
        value, gradients, run = at_step(scene, objective, names, method, min(first, longer / 2), finer, adaptive)
        floor = 10 * native_floor(run.steps * method.evaluations, scene.highest_frequency * scene.duration)
        found = _with_errors(value, gradients, others, floor, method.name, run.step)
        if step or found.error <= tolerance:
            others.append(at_step(scene, objective, names, method, nearby(run), finer, adaptive)[:2])
            found = _with_errors(value, gradients, others, floor, method.name, run.step)
        if step or found.error <= tolerance:
            return found
        first = run.step / 2
    raise ToleranceNotMet(f"the gradient is known to {found.error:.2g} only; use a shorter time or less accuracy")
