"""Gradients of an objective with respect to what a scene is made of, with an estimate of their error."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from ..engines.native.round_off import native_floor
from ..errors import InputError, RunFailed, ToleranceNotMet, check_tolerance, shown
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
        The largest error relative to the largest derivative with respect to the same kind of parameter; where these are
        nothing but round-off, whose size is then their error, relative to the terms that they are the sum of.
    value_error : float
        Of the value, in its unit.
    step_s : float
    integrator : str
    """

    value: float
    gradients: Mapping[str, Array]
    errors: Mapping[str, float]
    error: float
    value_error: float
    step_s: float
    integrator: str

    def __getitem__(self, name: str) -> Array:
        return self.gradients[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.gradients)

    def __len__(self) -> int:
        return len(self.gradients)


def looks_of(scene: Scene, objective: Objective, finer: int = 1) -> int:
    """Return how often an objective looks at a scene after t = 0: at the samples, or a multiple of that."""
    interval = scene.duration / (scene.samples - 1)
    more = (
        finer * max(1, math.ceil(interval * scene.highest_frequency / TURN))
        if objective.dense
        else 1
    )
    return (scene.samples - 1) * more


Judged = TypeVar("Judged")
Answer = tuple[float, Any, DifferentiableRun]  # with derivatives by all inputs, or by name


def _answer(
    scene: Scene,
    objective: Objective,
    names: Iterable[str],
    method: Splitting,
    step: float,
    finer: int,
    adaptive: bool,
) -> Answer:
    """Return value, its derivatives by all inputs, and the run, of `at_step`."""
    grains = np.unique(objective.grains(scene))
    looks = looks_of(scene, objective, finer)
    held = adaptive_steps(scene, method, step, looks) if adaptive else step
    run = DifferentiableRun(scene, method, held, looks, grains)
    if not np.isfinite(run.velocity).all():
        raise RunFailed(f"the motion breaks down with steps of {run.step:.3g} s: use shorter ones")
    slopes = objective(Seen(scene, run.time, grains, run.displacement, run.velocity))
    everywhere = not {"displacement", "velocity"}.isdisjoint(names)
    inputs = run.pull(slopes.displacement, slopes.velocity, everywhere)
    nothing = (
        np.zeros(scene.chain.grains),
        np.zeros(scene.chain.grains),
        np.zeros(inputs.drive.size),
    )
    return (
        slopes.value,
        inputs + Inputs(slopes.masses, slopes.constants, slopes.forces, *nothing),
        run,
    )


def at_step(
    scene: Scene,
    objective: Objective,
    names: Iterable[str],
    method: Splitting,
    step: float,
    adaptive: bool = False,
) -> tuple[float, dict[str, Array], DifferentiableRun]:
    """Return value and gradients of a run by steps of this length at most, and the run.

    Raises
    ------
    RunFailed
        If the motion breaks down.
    """
    names = tuple(names)
    value, inputs, run = _answer(scene, objective, names, method, step, 1, adaptive)
    return value, {name: params.pull(scene, inputs, name) for name in names}, run


def halved(
    answer: Callable[[float, int], Answer],
    first: float,
    most: int,
    judged: Callable[[Answer, Sequence[Answer]], Judged],
    enough: Callable[[Judged], bool],
) -> Judged:
    """Halve steps until what others than the last one show of it is enough, or `most` times.

    Parameters
    ----------
    answer : function
        Of the longest step and of how much finer than at first an objective is to look.
    first : float
        The longest step of an answer, s; it is judged by one twice as long.
    judged : function
        Of the answer and of those at other steps: one twice as long, and if that is enough one half again as long or
        shorter, too, as where contacts open two may agree by chance.
    enough : function
        Of a judgement.

    Returns
    -------
    the last judgement
    """
    now = answer(2 * first, 1)
    for halving in range(1, most + 1):
        before, step, finer = now, min(first, now[2].step / 2), 2**halving
        now = answer(step, finer)
        found = judged(now, [before])
        if enough(found):
            run = now[2]
            near = run.step * NEARBY if run.steps > 2 * (run.time.size - 1) else run.step / NEARBY
            found = judged(now, [before, answer(near, finer)])
            if enough(found):
                break
        first = now[2].step / 2
    return found


def _with_errors(
    scene: Scene, names: Iterable[str], method: Splitting, now: Answer, others: Sequence[Answer]
) -> Gradient:
    """Return a gradient with its errors, from those at other steps and from round-off."""
    value, inputs, run = now
    floor = 10 * native_floor(
        run.steps * method.evaluations, scene.highest_frequency * scene.duration
    )
    terms, gradients, errors, relative = _terms(scene, value, inputs), {}, {}, {}
    for name in names:
        mine = gradients[name] = params.pull(scene, inputs, name)
        off = SAFETY * sum(
            float(np.abs(mine - params.pull(scene, other, name)).max()) for _, other, _ in others
        )
        size, whole = (
            float(np.abs(mine).max()),
            float(np.abs(params.pull(scene, terms, name)).max()),
        )
        if size <= floor * whole:
            size = whole
        errors[name] = off + floor * size
        relative[name] = errors[name] / size if size > 0 else 0.0
    off = SAFETY * sum(abs(value - other) for other, _, _ in others) + floor * abs(value)
    return Gradient(value, gradients, errors, max(relative.values()), off, run.step, method.name)


def _terms(scene: Scene, value: float, inputs: Inputs) -> Inputs:
    """Return how large the terms are whose sums are the derivatives of a value by all inputs.

    Such as that value over an input, or, as it may be 0 itself, what an initial motion or a drive adds to it.
    """
    own = params.inputs(scene)
    whole = abs(value) + sum(
        float(np.abs(slope) @ np.abs(x)) for slope, x in list(zip(inputs, own, strict=True))[3:]
    )
    return Inputs(
        *(
            np.abs(slope) + np.divide(whole, np.abs(x), out=np.zeros(x.size), where=x != 0)
            for slope, x in zip(inputs, own, strict=True)
        )
    )


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
    if step is not None and not 0 < step < math.inf:
        raise InputError([("step", f"must be above 0, in s (got {shown(step)})")])
    chosen = integrator or ("rkn4" if objective.dense else "rkn6")
    if chosen not in SPLITTINGS:
        raise InputError([("integrator", not_among(chosen, tuple(SPLITTINGS)))])
    method = SPLITTINGS[chosen]
    if adaptive and method.adaptive == "no":
        raise InputError([("adaptive", f"{chosen} has no adaptive steps: use rkn4 or rkn6")])
    first = step or min(1.5, method.stability_limit / 4) / scene.highest_frequency
    found = halved(
        lambda length, finer: _answer(scene, objective, names, method, length, finer, adaptive),
        first,
        1 if step else HALVINGS,
        lambda now, others: _with_errors(scene, names, method, now, others),
        lambda found: bool(step) or found.error <= tolerance,
    )
    if step or found.error <= tolerance:
        return found
    raise ToleranceNotMet(
        f"the gradient is known to {found.error:.2g} only; use a shorter time or less accuracy"
    )
