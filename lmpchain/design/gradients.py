"""Gradients of an objective by the parameters of a scene, with an estimate of their error."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engines.cost_model import announce
from ..engines.stepping.rounding import native_floor
from ..errors import InputError, RunFailed, ToleranceNotMet, check_tolerance, not_among
from ..integrators.adjoint import Inputs
from ..integrators.differentiation import (
    DIFFERENTIABLE,
    AnyMethod,
    AnyRun,
    differentiable,
    method_for,
)
from ..integrators.halving import SAFETY, HalvedAnswer, halve
from ..scene.scene import Scene
from ..util.arrays import Array, check_flags
from ..util.compilation import clock
from ..util.validation import check_positive
from . import parameters as params
from .differences import FixedRun, differentiate, scales_of
from .objectives import Objective, Seen, Slopes, check_objective


@dataclass(frozen=True)
class GradientRuns:
    """Settings of runs for gradients, with the values of an optimum.

    Attributes
    ----------
    look : float
        Largest phase of the fastest motion between two evaluations of a dense objective, rad.
    turn : float
        Largest phase of the fastest motion in a step of an optimisation, rad.
    halvings : int
        Largest number of halvings of the steps.
    nearby : float
        Ratio of the step of the third run to the step of the answer with which it is compared.
    """

    look: float = 0.25
    turn: float = 1.0
    halvings: int = 12
    nearby: float = 1.5


RUNS = GradientRuns()


@dataclass(frozen=True, eq=False)
class Gradient(Mapping[str, Array]):
    """An objective and its derivatives by parameter name.

    Attributes
    ----------
    value : float
        Value of the objective.
    gradients : dict
        Derivatives (P,) by parameter name: per kg, per N/m^delta and so on.
    errors : dict
        Estimated largest error of each gradient, in the same units.
    error : float
        Largest error, relative to the largest derivative with the same parameter name. If these
        derivatives are only rounding errors, it is relative to the terms whose sum they are.
    value_error : float
        Estimated error of the value, in its unit.
    step_s : float
        Longest time step, s.
    integrator : str
        Name of the integrator.
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
    """Return the number of evaluation times of an objective after t = 0."""
    looks = scene.intervals
    # A peak or a crossing may be between two samples.
    if objective.dense:
        looks *= finer * max(1, math.ceil(scene.sampling_phase / RUNS.look))
    return looks


class Answer(NamedTuple):
    """A value with its derivatives, by all inputs or by name, and the run behind it."""

    value: float
    slopes: Any
    run: AnyRun | FixedRun


class DifferenceSlopes(NamedTuple):
    """Derivatives of a value by the entries of one parameter, from differences, (P,) each.

    Attributes
    ----------
    slope : (P,) array
        Extrapolated derivatives.
    spread : (P,) array
        Difference between the derivatives for two changes of the parameter.
    terms : (P,) array
        Size of the terms of the value, divided by the size of the entry.
    rounding : (P,) array
        Rounding error of the derivatives.
    """

    slope: Array
    spread: Array
    terms: Array
    rounding: Array


class GradientTask(NamedTuple):
    """An objective of a scene, parameter names, and the integration of the scene.

    Attributes
    ----------
    scene : Scene
    objective : Objective
    names : tuple of str
    method : Splitting or DormandPrince
    adaptive : bool
        Whether steps are shorter where contacts open or close.
    accuracy : float
        Desired relative error of differences, if a law by formula or a ground requires them.
    """

    scene: Scene
    objective: Objective
    names: tuple[str, ...]
    method: AnyMethod
    adaptive: bool = False
    accuracy: float = 1e-6

    def solve(self, step: float, finer: int = 1) -> Answer:
        """Return the value and its derivatives, with steps of at most this length.

        The derivatives are with respect to all inputs. With a law by formula or a ground, they are
        `DifferenceSlopes` by parameter name.

        Raises
        ------
        RunFailed
            If the motion breaks down.
        """
        scene = self.scene
        if params.by_differences(scene):
            return self._solve_by_differences(step, finer)
        grains = np.unique(self.objective.grains(scene))
        looks = looks_of(scene, self.objective, finer)
        run = differentiable(scene, self.method, step, looks, grains, self.adaptive)
        if not np.isfinite(run.velocity).all():
            message = f"the motion breaks down with steps of {run.step:.3g} s: use shorter ones"
            raise RunFailed(message)
        slopes = self._evaluate(scene, run, grains)
        # The gradient over the initial motion needs all grains, the others only the grains that
        # the wave reaches.
        everywhere = not {"displacement", "velocity"}.isdisjoint(self.names)
        inputs = run.pull(slopes.displacement, slopes.velocity, everywhere)
        zero = np.zeros(scene.chain.grains)
        direct = Inputs(
            masses=slopes.masses,
            constants=slopes.constants,
            forces=slopes.forces,
            displacement=zero,
            velocity=zero,
            drive=np.zeros(inputs.drive.size),
            viscosity=slopes.viscosity,
            drag=zero,
        )
        return Answer(slopes.value, inputs + direct, run)

    def _evaluate(self, scene: Scene, run: AnyRun | FixedRun, grains: NDArray[np.intp]) -> Slopes:
        """Return the objective of a run; raise `InputError` unless it is finite."""
        slopes = self.objective(Seen(scene, run.time, grains, run.displacement, run.velocity))
        parts = slopes.value, slopes.displacement, slopes.velocity
        if not all(np.isfinite(part).all() for part in parts):
            message = "has no finite value or derivative in this scene: use another one"
            raise InputError.at("objective", message)
        return slopes

    def _solve_by_differences(self, step: float, finer: int) -> Answer:
        """Return the value and its `DifferenceSlopes` by name, from runs of changed scenes."""
        grains = np.unique(self.objective.grains(self.scene))
        looks = looks_of(self.scene, self.objective, finer)

        def solve(scene: Scene) -> tuple[FixedRun, Slopes]:
            run = FixedRun.of(scene, self.method, step, looks, grains, self.adaptive)
            return run, self._evaluate(scene, run, grains)

        run, slopes = solve(self.scene)
        terms = (slopes.displacement * run.displacement, slopes.velocity * run.velocity)
        size = abs(slopes.value) + sum(float(np.abs(term).sum()) for term in terms)
        floor = _floor(self, run)
        by_name = {}
        for name in self.names:
            scales = scales_of(self.scene, name)
            free = scales > 0
            slope, spread, by_size, rounding = np.zeros((4, scales.size))
            found = differentiate(
                self.scene,
                name,
                np.diag(scales)[free],
                lambda scene: np.array(solve(scene)[1].value),
                floor * size,
                self.accuracy,
            )
            slope[free] = found.slope / scales[free]
            spread[free] = found.spread / scales[free]
            by_size[free] = size / scales[free]
            rounding[free] = found.rounding / scales[free]
            by_name[name] = DifferenceSlopes(slope, spread, by_size, rounding)
        return Answer(slopes.value, by_name, run)

    def slope(self, slopes: Any, name: str) -> Array:
        """Return the derivatives by the parameters of this name, (P,), of an answer's slopes."""
        if params.by_differences(self.scene):
            return slopes[name].slope  # type: ignore[no-any-return]
        return params.pull(self.scene, slopes, name)


def shortens(scene: Scene, method: AnyMethod) -> bool:
    """Return whether steps are shortened where contacts open or close, possibly by default.

    The derivatives depend on the stiffness of viscous contacts, which has a vertical tangent at an
    opening. With equal steps, derivatives would only be of order delta.
    """
    return method.name == "dop853" and scene.largest_strain >= 1


def at_step(
    scene: Scene,
    objective: Objective,
    names: Iterable[str],
    method: AnyMethod,
    step: float,
    adaptive: bool = False,
) -> Answer:
    """Return the value and its derivatives by name, with steps of at most this length.

    Raises
    ------
    RunFailed
        If the motion breaks down.
    """
    task = GradientTask(scene, objective, tuple(names), method, adaptive)
    value, slopes, run = task.solve(step)
    return Answer(value, {name: task.slope(slopes, name) for name in task.names}, run)


def refine(
    solve: Callable[[float, int], Answer],
    judge: Callable[[Answer, Sequence[Answer]], Any],
    excess: Callable[[Any], float],
    first: float,
    answers: int,
) -> Any:
    """Halve steps until the estimated error of an answer is within its tolerance.

    Parameters
    ----------
    solve : function
        Returns an answer for the longest step, s, and the factor by which the number of evaluation
        times of the objective increases.
    judge : function
        Returns a judgement of an answer, given answers with other steps: the first has steps twice
        as long. If the error is within the tolerance, a second one with steps 1.5 times as long or
        short is added, because two answers may agree by chance if contacts open.
    excess : function
        Returns the ratio of the error of a judgement to the allowed error.
    first : float
        Longest step of the first answer, s; the comparison uses a step twice as long.
    answers : int
        Largest number of answers.

    Returns
    -------
    the best judgement
    """
    began = clock()
    before = solve(2 * first, 1)
    spent_s = clock() - began

    def attempt(halvings: int) -> HalvedAnswer[Any]:
        nonlocal before
        finer = 2 ** (halvings + 1)
        # The answer of one attempt is the reference for the next.
        coarse = before
        kind = "differences between runs" if isinstance(coarse.run, FixedRun) else "an adjoint run"
        announce(
            2 ** (halvings + 1) * spent_s,
            f"{kind} of {2 * coarse.run.steps} steps for the tolerance",
            "a shorter duration or a larger tolerance takes less",
        )
        answer = before = solve(coarse.run.step / 2, finer)
        judgement = judge(answer, [coarse])
        if excess(judgement) <= 1:
            run = answer.run
            # Few steps between two evaluation times cannot be halved evenly, so shorter steps are
            # used.
            few = run.steps <= 2 * (run.time.size - 1)
            step = run.step / RUNS.nearby if few else run.step * RUNS.nearby
            judgement = judge(answer, [coarse, solve(step, finer)])
        return HalvedAnswer(judgement, excess(judgement))

    return halve(attempt, answers).answer


def _compare(task: GradientTask, answer: Answer, others: Sequence[Answer]) -> Gradient:
    """Return a gradient with its errors, from answers with different steps and from rounding."""
    value, slopes, run = answer
    floor = _floor(task, run)
    terms = None
    if not params.by_differences(task.scene):
        terms = _terms(task.scene, value, slopes)
    gradients = {}
    errors = {}
    relative = {}
    for name in task.names:
        slope = task.slope(slopes, name)
        difference = sum(
            float(np.abs(slope - task.slope(other.slopes, name)).max()) for other in others
        )
        size = float(np.abs(slope).max())
        if terms is None:
            sum_of_terms = float(slopes[name].terms.max())
            rounding = float(slopes[name].rounding.max())
            difference += float(slopes[name].spread.max()) / SAFETY
        else:
            sum_of_terms = float(np.abs(params.pull(task.scene, terms, name)).max())
            rounding = floor * sum_of_terms
        # The terms of this derivative cancel to rounding error.
        if size <= rounding:
            size = sum_of_terms
        gradients[name] = slope
        errors[name] = SAFETY * difference + (rounding if terms is None else floor * size)
        relative[name] = errors[name] / size if size > 0 else 0.0
    difference = sum(abs(value - other.value) for other in others)
    error = SAFETY * difference + floor * abs(value)
    return Gradient(
        value, gradients, errors, max(relative.values()), error, run.step, task.method.name
    )


def _floor(task: GradientTask, run: AnyRun | FixedRun) -> float:
    """Return the rounding error of a run, relative to the largest motion, with a safety factor."""
    return 10 * native_floor(run.steps * task.method.evaluations, task.scene.total_phase)


def _terms(scene: Scene, value: float, inputs: Inputs) -> Inputs:
    """Return the sums of the absolute terms of a value's derivatives with respect to all inputs.

    The sum for an input includes the value divided by the input. Because the value may be 0, the
    contributions of the initial motion and of the drive are added to it first.
    """
    present = params.inputs(scene)
    pairs = list(zip(inputs, present, strict=True))
    # Masses, constants and forces come first, then initial motion and drive.
    total = abs(value) + sum(float(np.abs(slope) @ np.abs(x)) for slope, x in pairs[3:])
    return Inputs(
        *(
            np.abs(slope) + np.divide(total, np.abs(x), out=np.zeros(x.size), where=x != 0)
            for slope, x in pairs
        )
    )


MOST_STEPS = 1e9  # Largest number of steps of a run.


def _method(
    scene: Scene,
    objective: Objective,
    names: tuple[str, ...],
    integrator: str | None,
    adaptive: bool,
) -> AnyMethod:
    """Return the given method, or the best one; raise `InputError` if it is unsuitable."""
    by_default = "rkn4" if objective.dense else "rkn6"
    chosen = integrator or method_for(scene, names, by_default).name
    if chosen not in DIFFERENTIABLE:
        raise InputError.at("integrator", not_among(chosen, tuple(DIFFERENTIABLE)))
    method = DIFFERENTIABLE[chosen]
    if method_for(scene, names, chosen) != method:
        raise InputError.at("integrator", f"must be dop853 with damping (got {chosen})")
    if adaptive and not method.adaptive:
        raise InputError.at("adaptive", f"{chosen} has no adaptive steps: use rkn4 or rkn6")
    return method


def gradient(
    scene: Scene,
    objective: Objective,
    parameters: Iterable[str],
    tolerance: float = 1e-6,
    integrator: str | None = None,
    step: float | None = None,
    adaptive: bool = False,
) -> Gradient:
    """Return an objective and its derivatives with respect to parameters, exact for powers.

    The adjoint of the native integrator is run with the step of the answer and with a step twice as
    long. The difference is the error estimate, and steps are halved until it is within the
    tolerance. Because two runs may agree by chance if contacts open, the difference from a third
    run with a step 1.5 times as long is included. An objective with evaluation times between the
    samples has half as many of them in the run with the longest steps, so that the difference also
    includes the error of these times.

    With a law by formula or a ground, derivatives are extrapolated central differences of native
    runs with two changes of each entry (four runs per entry). The error then includes the
    difference between the derivatives for both changes, and the rounding error of the runs divided
    by the change.

    Parameters
    ----------
    scene : Scene
    objective : Objective
        Objective, such as `PeakForce(40)`.
    parameters : names
        Any of "masses", "contact_constants", "wall_constants", "diameters", "youngs_modulus",
        "top_load", "gravity", "displacement" and "velocity" (at t = 0), "drive" and "force" (their
        samples), "amplitude", "frequency", "damping.viscoelastic" and "damping.drag"; also
        "chain.law.NAME" for each parameter NAME of a law by formula, and "chain.ground.NAME" for
        each parameter of a ground.
    tolerance : float
        Largest error of the gradient, relative to the largest entry with the same name.
    integrator : "verlet", "rkn4", "rkn6", "kahan-li6", "kahan-li8" or "dop853", optional
        By default dop853 for a damped chain or a damping parameter; otherwise rkn4 if the objective
        has evaluation times between the samples, or rkn6.
    step : float, optional
        Longest step, s. If it is given, no tolerance is enforced.
    adaptive : bool
        Whether steps are shorter where contacts open or close, which keeps the order of the
        method. The steps count as constant in the derivatives. verlet does not support this option;
        dop853 always uses it if contacts may open.

    Returns
    -------
    Gradient
        Derivatives by parameter name, with `value`, `error` and `errors`.

    Raises
    ------
    InputError
        If a parameter is unknown, or if it has no derivative in this scene.
    ToleranceNotMet
        If the error remains too large after several halvings of the steps.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse, Scene
    >>> from lmpchain.design import PeakForce
    >>> chain = Chain(grains=10, diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=2e-5, samples=21)
    >>> slopes = gradient(scene, PeakForce(5), ["masses", "gravity"], tolerance=1e-5)
    >>> slopes["masses"].shape, slopes.error < 1e-5
    ((10,), True)
    """
    names = params.check(scene, parameters)
    check_objective(objective)
    check_tolerance(tolerance)
    check_flags(adaptive=adaptive)
    if step is not None:
        step = check_positive("step", step, "above 0, in s")
    if step is not None and not scene.duration / step < MOST_STEPS:
        least = f"longer than {scene.duration / MOST_STEPS:.1g} s, because runs would take hours"
        raise InputError.at("step", f"must be {least} (got {step:g})")
    method = _method(scene, objective, names, integrator, adaptive)
    adaptive = adaptive or shortens(scene, method)
    task = GradientTask(scene, objective, names, method, adaptive, tolerance / 4)
    answer: Gradient = refine(
        task.solve,
        lambda answer, others: _compare(task, answer, others),
        lambda judgement: 0.0 if step else judgement.error / tolerance,
        step or min(1.5, method.stability_limit / 4) / scene.highest_frequency,
        RUNS.halvings,
    )
    if step or answer.error <= tolerance:
        return answer
    raise ToleranceNotMet(
        f"the error of the gradient is {answer.error:.2g}: use a shorter time or a larger tolerance"
    )
