"""What engines that step through time share: their options and the choice of the step size."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from ..errors import InputError, shown
from ..integrators.methods import METHODS, Method
from ..integrators.step_schedule import StepSchedule
from ..integrators.stepper import Stepper
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.suggestions import not_among
from .base import Candidate, Engine, ErrorBudget
from .companions import KINKED_BELOW, SAFE_STRAIN, longer_steps, struck_from_above
from .cost_model import seconds
from .error_estimate import CompanionRun
from .richardson import SAFETY

PERIODS = 60.0  # omega T of the scene for which `Method.error_constant` is given
CHOICE = ("rkn4", "rkn6")  # of which the cheaper one is taken, if none is asked for
# analysis/calibration/opening_error_factor.py measures the next ones
LONGEST_STEP = 0.6  # longest step that is proposed, over the stability limit
# the same where the bound on the strain is finite but above that: longer steps are often too long there at first
LONGEST_AT_OPENINGS, STRONG_STRAIN = 0.45, 10.0
LONGEST_UNBOUNDED = 0.25  # and where there is no bound, for errors of longer ones scatter, and runs may agree by chance
# factors on the error where contacts may open: with steps of one length, of which nine in ten scenes need no more; with
# coarse ones near openings, on that of adaptive steps; and what that, `opening_error_factor`, is made of
OPENING_ERROR, COARSE_ERROR = 30.0, 16.0
ADAPTIVE_ERROR, LEAST_STRAIN, MOST_STRAIN, GROWS = 4.0, 3.0, 99.0, 0.5
# of a column that is struck on its top so gently that most have an answer at steps of one length: a bound on the
# strain, and a larger one for tolerances from so much on; the factor on the error at the first, least and most
GENTLE, LESS_GENTLE, LOOSE, GENTLE_ERROR = 4.5, 7.5, 1e-6, (10.0, 1.5, 12.0)
# of samples that are interpolated: their error at omega h = 1 and its order; what rounding adds a step of the run, for
# they take differences of displacements over a step; what one costs in evaluations of the force, and a step over one of
# equal ones; steps from landing to landing, and the most numbers of a field between; and steps a sample from which on
# none is interpolated after all
BETWEEN, ORDER_BETWEEN, LOST_BETWEEN, COST_BETWEEN, UNEVEN = 3e-8, 7, 5e-15, 5.0, 2.0
FEW_STEPS, FIELD, MANY = 8, 2**19, 3
LONGEST_RUN_S = 3e8  # ten years
EVALUATION_OVERHEAD = (
    40  # of a force evaluation, in grain-steps; analysis/calibration/cost_model.py
)


Steps = tuple[float, int, int, bool, bool]  # as `TimeSteppingEngine._steps` returns them


@dataclass(frozen=True)
class StepRefinement:
    """How a step is shortened after an attempt that missed its tolerance.

    The numbers are measured by analysis/calibration/step_refinement.py.

    Attributes
    ----------
    order_at_openings : float
        Order to which every method with steps of one length falls where contacts open.
    order_at_kinks : float
        The same with adaptive steps where the force has kinks.
    target : float
        Part of the tolerance that is left for the truncation error at which the next attempt aims.
    roundoff : float
        Part of the tolerance beyond which round-off cannot be made up for.
    least, least_erratic : float
        Smallest ratio of the old step to the new one, where the error falls regularly or not.
    most, most_far : float
        Largest ratio, where the error is below `far` or not: far off, the law does not hold yet.
    breakdown : float
        Ratio after a run that broke down.
    """

    order_at_openings: float = 2.5
    order_at_kinks: float = 4.0
    target: float = 0.7
    roundoff: float = 0.9
    least: float = 1.3
    least_erratic: float = 2.0
    most: float = 16.0
    most_far: float = 4.0
    far: float = 0.1
    breakdown: float = 4.0

    def ratio(
        self, error: ErrorBudget | None, order: float, tolerance: float, adaptive: bool = False
    ) -> float | None:
        """Return the ratio of the old step to the next one; None where round-off alone is too much."""
        if error is None:
            return self.breakdown
        if error.roundoff > self.roundoff * tolerance:
            return None
        if not math.isfinite(error.truncation):
            return self.breakdown
        room = max(tolerance - error.roundoff, tolerance / 4)
        order = (
            order
            if error.smooth
            else min(order, self.order_at_kinks if adaptive else self.order_at_openings)
        )
        most = self.most if error.truncation < self.far else self.most_far
        least = self.least if error.smooth else self.least_erratic
        return min(max((error.truncation / (self.target * room)) ** (1 / order), least), most)


REFINEMENT = StepRefinement()


class TimeSteppingEngine(Engine):
    """An engine that moves through time with one of the methods.

    Attributes
    ----------
    twin : bool
        Whether a native twin measures its round-off. Its steps must then be those of the native engine in exact
        arithmetic.
    dense : bool
        Whether it interpolates samples that adaptive steps pass over.
    """

    adaptive: bool = False  # whether steps shorten where contacts open, if the method allows
    twin: ClassVar[bool] = True
    dense: ClassVar[bool] = False

    def __init__(self, integrator: str, step: float | None):
        if integrator not in self.integrators:
            raise InputError([("integrator", not_among(integrator, self.integrators))])
        if step is not None and not (
            isinstance(step, int | float) and math.isfinite(step) and step > 0
        ):
            raise InputError([("step", f"must be a time above 0 s (got {shown(step)})")])
        self.integrator, self.step = integrator, step

    @property
    def methods(self) -> list[Method]:
        """The methods that it may take."""
        return [
            METHODS[name] for name in (CHOICE if self.integrator == "auto" else [self.integrator])
        ]

    @abstractmethod
    def stepper(
        self,
        scenes: Sequence[Scene],
        candidate: Candidate,
        schedules: Sequence[StepSchedule],
        state: Mapping[str, Array],
    ) -> Stepper:
        """Make the stepper of the answer, with its companions if native, from the start or a kept state."""

    def candidate(self, scene: Scene, tolerance: float) -> Candidate:
        """Propose a step size: the one given, or the longest that should meet the tolerance."""
        best, work = None, math.inf
        for method in reversed(self.methods):  # in most scenes the last one is the best
            if made := self._steps(scene, tolerance, method, work):
                best, work = (method, made), made[0]
        assert best
        return self.choose_step(scene, tolerance, *best)

    def choose_step(self, scene: Scene, tolerance: float, method: Method, made: Steps) -> Candidate:
        """Propose the step size of a method."""
        _, steps, stride, adapts, coarse = made
        cost = self.cost(scene, method, -(-steps * (scene.samples - 1) // stride))
        if cost > LONGEST_RUN_S:
            years = cost / 3.15e7
            raise InputError(
                [
                    (
                        "duration",
                        f"would take some {years:.1g} years: shorten it, or ask for less accuracy",
                    )
                ]
            )
        return Candidate(
            step=scene.duration / (scene.samples - 1) * stride / steps,
            active_grains=scene.chain.grains,
            model_error=0.0,
            solver_error=tolerance,
            cost_s=cost,
            steps_per_landing=steps,
            stride=stride,
            fixed=self.step is not None,
            adaptive=adapts,
            coarse_openings=coarse,
            integrator=method.name,
            choices=self.choices(scene),
        )

    def _steps(self, scene: Scene, tolerance: float, method: Method, most: float) -> Steps | None:
        """Return what a sample costs, in evaluations of the force, and the steps; None if it is more.

        These are the steps from landing to landing, how many samples that is, whether they adapt, and whether coarsely.
        """
        interval = scene.duration / (scene.samples - 1)
        limit = method.stability_limit
        if self.step is not None:
            if self.step * scene.chain.band_edge > limit:
                raise InputError(
                    [("step", f"must be below {limit / scene.chain.band_edge:.3g} s, where {method.name} "
                      f"stops being stable on this chain (got {self.step:g})")]
                )  # fmt: skip
            steps = math.ceil(interval / self.step * (1 - 1e-12))
            return method.evaluations * steps, steps, 1, False, False
        omega, strain = scene.highest_frequency, scene.largest_strain
        expected = method.error_constant * max(
            1.0, omega * scene.duration / PERIODS
        )  # phases drift apart with time
        shortens = method.adaptive == "openings"
        gentle = shortens and self.adaptive and _gently_struck(scene, tolerance)
        adapts = self.adapts(scene, method) and not gentle
        if strain > SAFE_STRAIN:
            factor = gentle_error_factor if gentle else opening_error_factor
            expected *= factor(strain) if adapts or gentle else OPENING_ERROR
        reach = (tolerance / SAFETY / expected) ** (1 / method.order)
        # one companion alone shows no order where contacts open, unless samples make steps shorter
        if adapts and shortens and limit / 4 < min(reach, interval * omega) and reach <= limit / 2:
            reach = max(
                limit / 4, reach * (SAFETY * ADAPTIVE_ERROR / 2**method.order) ** (1 / method.order)
            )
        longest = LONGEST_STEP * limit
        if STRONG_STRAIN < strain < math.inf:
            longest = LONGEST_AT_OPENINGS * limit
        elif adapts and shortens and strain == math.inf:
            longest = LONGEST_UNBOUNDED * limit
        if adapts:
            longest = min(longest, omega * scene.excitation.knot_spacing)  # knots cut longer steps
        needed = interval * omega / min(reach, longest)
        if method.evaluations * needed > most:
            return None
        steps = math.ceil(needed)
        work = method.evaluations * steps
        # in the vacuum a front grows so steeply that what lies between steps may get a wrong sign
        if self.dense and self.adaptive and shortens and scene.chain.compressed:
            smooth = (tolerance / SAFETY / BETWEEN) ** (1 / ORDER_BETWEEN)
            few = interval * omega / min(reach, longest, smooth)  # steps a sample
            landed, stride = landing(scene, few)
            cheaper = _work_between(method, few, adapts) < work
            exact = few * (scene.samples - 1) * LOST_BETWEEN < tolerance
            if cheaper and exact and 1 < stride <= FIELD // scene.chain.grains:
                work = _work_between(method, landed / stride, adapts)
                return (work, landed, stride, adapts, False) if work <= most else None
        # where samples hold steps short, shorter ones near openings would only cost
        coarse = adapts and shortens and scene.chain.exponent >= KINKED_BELOW
        if coarse:
            coarse = steps == math.ceil(
                interval * omega / min(reach / COARSE_ERROR ** (1 / method.order), longest)
            )
        return (work, steps, 1, adapts, coarse) if work <= most else None

    def adapts(self, scene: Scene, method: Method) -> bool:
        """Say whether steps of this method shorten where contacts open or close, or follow its own error."""
        how = method.adaptive
        return self.adaptive and (
            how == "error" or (how == "openings" and scene.largest_strain > SAFE_STRAIN)
        )

    def choices(self, scene: Scene) -> Mapping[str, str]:
        """Return what it chooses on behalf of the user."""
        return {}

    def cost(self, scene: Scene, method: Method, steps: int) -> float:
        """Return about how long so many steps take, s."""
        grain_steps = method.evaluations * steps * (self.computed(scene) + EVALUATION_OVERHEAD)
        return seconds(self.name, self.start_up_s, self.seconds_per_grain_step * grain_steps)

    @abstractmethod
    def typical_round_off(self, scene: Scene, steps: int, speed: float) -> float:
        """Predict the relative round-off of so many steps; `speed` is the largest velocity, m/s."""

    def computed(self, scene: Scene) -> float:
        """Return how many grains it computes in each step, on average."""
        return scene.chain.grains

    def refine(
        self, candidate: Candidate, error: ErrorBudget | None, tolerance: float
    ) -> Candidate | None:
        """Shorten the step by what the error asks for; where contacts open after all, let steps adapt."""
        method = METHODS[candidate.integrator]
        order, opens = (
            method.order,
            not (error and error.smooth) and self.adaptive and method.adaptive == "openings",
        )
        if opens and not candidate.adaptive:
            candidate = candidate._replace(adaptive=True)
        ratio = REFINEMENT.ratio(error, order, tolerance, candidate.adaptive)
        if ratio is None:
            return None
        if candidate.coarse_openings:
            ratio = max(1.0, ratio / COARSE_ERROR ** (1 / order))
        shorter = candidate.with_steps(math.ceil(candidate.steps_per_landing * ratio))
        if shorter.steps_per_landing > MANY * shorter.stride or error is None:
            return shorter.sampled
        return (
            shorter
            if shorter.steps(error.differences.size) * LOST_BETWEEN < tolerance
            else shorter.sampled
        )

    def start(
        self,
        scenes: Sequence[Scene],
        candidate: Candidate,
        state: Mapping[str, Array] | None = None,
    ) -> CompanionRun:
        """Start one scene, or a batch of scenes that differ in numbers only."""
        if len(scenes) > 1 and len({kind(scene) for scene in scenes}) > 1:
            raise ValueError("a batch needs chains of one kind and length, recorded alike")
        make = partial(self.stepper, scenes, candidate)
        try:
            return CompanionRun(
                make, METHODS[candidate.integrator], scenes, candidate, state, self.twin
            )
        except (LookupError, TypeError, ValueError) as error:
            if state is None or isinstance(error, InputError):
                raise
            raise InputError(
                [("checkpoint", "does not fit its run, or was changed: run the scene anew")]
            ) from error


def _gently_struck(scene: Scene, tolerance: float) -> bool:
    """Say whether a strike from above is so weak that contacts hardly open before the wave is back."""
    return scene.largest_strain <= (
        LESS_GENTLE if tolerance >= LOOSE else GENTLE
    ) and struck_from_above(scene)


def _work_between(method: Method, steps: float, adapts: bool) -> float:
    """Return what an interpolated sample costs, in evaluations of the force, at so many steps."""
    return method.evaluations * steps * (1.0 if adapts else UNEVEN) + COST_BETWEEN


def landing(scene: Scene, few: float) -> tuple[int, int]:
    """Return the steps from a sample on which one ends to the next, and how many samples that is.

    There are about so few steps a sample.
    """
    stride = min(scene.samples - 1, 4 * math.ceil(FEW_STEPS / few / 4))  # like blocks
    return math.ceil(few * stride), stride


def kind(scene: Scene) -> tuple:
    """Return what the scenes of a batch have in common: the kind of chain, and what is recorded."""
    chain, excitation = scene.chain, scene.excitation
    made = chain.grains, chain.top, chain.bottom, chain.exponent, chain.compressed
    return (
        *made,
        excitation.driven,
        excitation.does_work,
        scene.samples,
        scene.duration,
        scene.grains,
    )


def alike(scene: Scene, candidate: Candidate) -> tuple:
    """Return what scenes have in common that have the answer and error in a batch that they have alone."""
    longer = longer_steps(METHODS[candidate.integrator], [scene], candidate)
    steps = (
        candidate.steps_per_landing,
        candidate.stride,
        candidate.step,
        candidate.adaptive,
        candidate.coarse_openings,
    )
    own = candidate.integrator, scene.excitation.knot_spacing < math.inf  # which DOP853 asks
    return *kind(scene), *own, *steps, *longer, *candidate.choices.items()


def gentle_error_factor(strain: float) -> float:
    """Return how many times larger the estimated error is where a strike on the top is gentle."""
    factor, least, most = GENTLE_ERROR
    return min(max(factor * (strain / GENTLE) ** 2, least), most)


def opening_error_factor(strain: float) -> float:
    """Return how many times larger the estimated error is where contacts may open and steps are adaptive.

    What scenes need scatters over decades. With this all attempts together cost least in struck columns, one in ten of
    which takes a second one, and 5 % more than the least in random scenes.
    """
    return ADAPTIVE_ERROR * (min(max(strain, LEAST_STRAIN), MOST_STRAIN) / LEAST_STRAIN) ** GROWS
