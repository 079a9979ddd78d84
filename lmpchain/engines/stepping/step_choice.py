"""The choice of the first step, and the step of the next attempt.

The error of a method of order p with steps h is C (omega h)^p for a run of 60 rad of the fastest
motion omega, where C is the `error_constant` of the method. The error grows in proportion to longer
times, and with the strain if contacts may open. The first step is chosen so that the expected error
is half the tolerance. The next step h' follows from the error estimate e,

    h' = h (0.7 tolerance / e)^(1/p),

with the order p that the estimate trusts; Hairer, Norsett and Wanner, Solving Ordinary Differential
Equations I, section II.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ...errors import InputError
from ...integrators.steps import MANY_STEPS, Method, Steps
from ...scene.scene import Scene
from ..base import ErrorBudget
from .auxiliary_runs import DIES, LONGER, OPENINGS, TRUST
from .rounding import interpolation_loss


@dataclass(frozen=True)
class FirstStep:
    """Parameters of the first step (see analysis/calibration/opening_error_factor.py).

    Attributes
    ----------
    radians : float
        Phase of the fastest motion, rad, for which `Method.error_constant` is given.
    longest : float
        Longest step over the stability limit of the method, if no contact can open.
    longest_opening : float
        Longest step over the stability limit, if contacts may open.
    longest_damped : float
        Longest step over the stability limit, if contacts may open in a damped chain.
    foreseen : float
        Smallest tolerance for which the first step is predicted if the strain has no upper bound.
        For a smaller tolerance, the error of the first attempt determines the step.
    safe_strain : float
        Largest strain for which no contact comes near to opening.
    opening_error : float
        Factor on the error if contacts open a little and steps are shorter near openings. The
        factor grows with the square root of the strain.
    largest_opening_error : float
        Upper bound on this factor.
    damped_opening_error : float
        Factor on the error if contacts open a little in a damped chain. The factor is large because
        the method has nearly no error if no contact opens, and it grows with the strain (see
        analysis/damping_cost.py).
    largest_damped_opening_error : float
        Upper bound on the factor in a damped chain.
    equal_error : float
        Factor on the error if contacts open and all steps are equal.
    coarse_error : float
        Factor on the error if steps near openings are coarse.
    """

    radians: float = 60.0
    longest: float = 0.5
    longest_opening: float = 0.45
    longest_damped: float = 0.25
    foreseen: float = 1e-6
    safe_strain: float = 0.3
    opening_error: float = 4.0
    largest_opening_error: float = 23.0
    damped_opening_error: float = 60.0
    largest_damped_opening_error: float = 1400.0
    equal_error: float = 30.0
    coarse_error: float = 16.0

    def opening_factor(self, strain: float, adaptive: bool, damped: bool = False) -> float:
        """Return the factor on the error of a scene with this bound on its strains."""
        if strain <= self.safe_strain:
            return 1.0
        if not adaptive:
            return self.equal_error
        beyond = max(strain / 3, 1.0)
        if damped:
            return min(self.damped_opening_error * beyond, self.largest_damped_opening_error)
        grown = self.opening_error * math.sqrt(beyond)
        return min(grown, self.largest_opening_error)


@dataclass(frozen=True)
class Interpolation:
    """Parameters of interpolation between steps (see analysis/calibration/long_steps.py).

    Attributes
    ----------
    error : float
        Relative error of interpolation at a phase step omega h = 1.
    order : float
        Order of convergence of the interpolation with the step.
    evaluations : float
        Cost of interpolating one sample, in evaluations of the force.
    steps : int
        Smallest number of steps between two landings, which are the steps that end on a sample.
    values : int
        Largest number of samples times grains between two landings, because these samples are
        stored in memory.
    """

    error: float = 3e-8
    order: float = 7.0
    evaluations: float = 5.0
    steps: int = 8
    values: int = 2**19


@dataclass(frozen=True)
class StepControl:
    """Parameters of the next step (see analysis/calibration/step_refinement.py).

    Attributes
    ----------
    target : float
        Expected error of the next attempt, as a fraction of the tolerance.
    roundoff : float
        Fraction of the tolerance that the rounding error must not exceed.
    least : float
        Lower bound on the ratio of the old step to the new one.
    most : float
        Upper bound on this ratio, and the ratio after a breakdown.
    """

    target: float = 0.7
    roundoff: float = 0.9
    least: float = 1.3
    most: float = 8.0

    def ratio(self, error: ErrorBudget | None, tolerance: float) -> float | None:
        """Return the ratio of the old step to the next one; None if rounding alone is too large.

        Parameters
        ----------
        error : ErrorBudget, optional
            Estimated error of the last attempt; None if the run broke down.
        tolerance : float
            Requested relative error.
        """
        if error is None:
            return self.most
        if error.roundoff > self.roundoff * tolerance:
            return None
        return min(max(self.aim(error, tolerance), self.least), self.most)

    def aim(self, error: ErrorBudget, tolerance: float) -> float:
        """Return the ratio of the old step to the next one, without bounds."""
        room = max(tolerance - error.roundoff, tolerance / 4)
        return (error.truncation / (self.target * room)) ** (1 / error.order)


FIRST_STEP = FirstStep()
INTERPOLATION = Interpolation()
STEP_CONTROL = StepControl()


def work(method: Method, steps: Steps) -> float:
    """Return the cost of the steps for each sample, in evaluations of the force."""
    evaluations = method.evaluations * steps.per_landing / steps.stride
    if steps.stride == 1:
        return evaluations
    # The search for samples between steps doubles the cost of equal steps.
    return evaluations * (1.0 if steps.adaptive else 2.0) + INTERPOLATION.evaluations


# Largest number of steps between samples; larger doubles do not count single steps.
MOST_STEPS = 2**53


def choose_given_step(scene: Scene, method: Method, step: float) -> Steps:
    """Return the largest step that divides the sampling interval and is at most the given one, s.

    Raises
    ------
    InputError
        If the method is unstable at the given step, or if the step is too short to count steps.
    """
    stable = method.stability_limit
    edge = scene.chain.fastest_rate
    if step * edge > stable:
        why = f"the stability limit of {method.name} on this chain (got {step:g})"
        raise InputError.at("step", f"must be below {stable / edge:.3g} s, {why}")
    interval = scene.sampling_interval
    if not interval / step < MOST_STEPS:
        least = f"longer than {interval / MOST_STEPS:.1g} s"
        raise InputError.at("step", f"must be {least}, or steps cannot be counted (got {step:g})")
    # A step that divides the interval up to rounding is taken as it is.
    steps = math.ceil(interval / step * (1 - 1e-12))
    return Steps.spread(interval, steps)


def choose_steps(
    scene: Scene,
    methods: Sequence[Method],
    tolerance: float,
    adaptive: bool,
    step: float | None = None,
) -> tuple[Method, Steps]:
    """Return the method of least cost, with a given step, s, or with the longest steps."""
    ways = [
        (method, choose_step(scene, method, tolerance, adaptive))
        if step is None
        else (method, choose_given_step(scene, method, step))
        for method in methods
    ]
    return min(ways, key=lambda way: work(*way)) if len(ways) > 1 else ways[0]


def choose_step(scene: Scene, method: Method, tolerance: float, adaptive: bool) -> Steps:
    """Return the longest steps of a method that should meet the tolerance.

    Parameters
    ----------
    scene : Scene
        Scene to compute.
    method : Method
        Integration method.
    tolerance : float
        Requested relative error.
    adaptive : bool
        Whether steps may be shorter near openings, and may pass over samples.
    """
    may_open = scene.largest_strain > FIRST_STEP.safe_strain
    shortens = adaptive and method.adaptive and may_open
    reach = expected_reach(scene, method, tolerance, shortens)
    interval = scene.sampling_interval
    phase = scene.sampling_phase
    steps = math.ceil(phase / reach)
    # Two auxiliary runs land on every sample with a half, a third or a quarter of these steps.
    while 2 < steps < MANY_STEPS and steps % 4 and steps % 6 and scene.sampling_decay > DIES:
        steps += 1
    coarse = False
    if shortens and not OPENINGS.kinks(scene.chain.law.onset):
        # If the samples require such short steps anyway, steps near openings need not be shorter.
        shorter = expected_reach(scene, method, tolerance / FIRST_STEP.coarse_error, shortens)
        coarse = steps == math.ceil(phase / shorter)
    sampled = Steps.spread(interval, steps, 1, shortens, coarse)
    if adaptive and method.interpolates and _interpolates(scene):
        passing = _pass_samples(scene, tolerance, shortens, phase, reach)
        if passing and work(method, passing) < work(method, sampled):
            return passing
    return sampled


def _interpolates(scene: Scene) -> bool:
    """Return whether samples of a scene may be interpolated between steps.

    In a sonic vacuum, fronts are so steep that interpolated values may have a wrong sign.
    Polynomial interpolation also fails at kinks of the applied force. In addition, it requires the
    time derivative of all forces, which the kernel of a ground does not compute.
    """
    acts = scene.excitation.does_work or scene.chain.ground is not None
    return scene.chain.linearisable and not acts


def expected_reach(scene: Scene, method: Method, tolerance: float, adaptive: bool) -> float:
    """Return omega h of the longest step whose error is expected to be half the tolerance."""
    strain = scene.largest_strain
    if strain == math.inf:
        tolerance = max(tolerance, FIRST_STEP.foreseen)
    radians = scene.total_phase
    error = method.error_constant
    # A method of order 1 loses no order if contacts open. The motion decays as its error grows.
    if method.order > 1:
        error *= max(1.0, radians / FIRST_STEP.radians)
        error *= FIRST_STEP.opening_factor(strain, adaptive, scene.chain.damped)
    reach = (tolerance / TRUST.safety / error) ** (1 / method.order)
    # Some methods are stable but inaccurate for steps beyond half a period of the fastest motion.
    stable = min(method.stability_limit, math.pi)
    if strain <= FIRST_STEP.safe_strain:
        reach = min(reach, FIRST_STEP.longest * stable)
    else:
        # Two auxiliary runs, with up to four times the step, show the order of convergence. With a
        # single auxiliary run the estimate is its distance, which is 2^order times the error. If
        # nothing bounds the strain, the errors of longer steps scatter, and two runs may agree by
        # chance.
        longest = FIRST_STEP.longest_damped if scene.chain.damped else FIRST_STEP.longest_opening
        alone = min(reach / 2, longest * stable) if strain < math.inf else 0.0
        reach = max(min(reach, stable / 4), alone)
    if adaptive:
        # All runs end steps on the kinks of an applied force. The longest steps of an auxiliary
        # run must fit between two kinks, or kinks would cut the steps of all runs alike.
        spacing = scene.kink_spacing / LONGER[-1]
        reach = min(reach, scene.highest_frequency * spacing)
    return reach


def _pass_samples(
    scene: Scene, tolerance: float, adaptive: bool, phase: float, reach: float
) -> Steps | None:
    """Return steps that pass over samples.

    Return None if interpolated samples would be inaccurate, if they would not fit into memory, or
    if steps would end on every sample.
    """
    smooth = (tolerance / TRUST.safety / INTERPOLATION.error) ** (1 / INTERPOLATION.order)
    rate = phase / min(reach, smooth)  # Number of steps per sample.
    if interpolation_loss(rate * scene.intervals) > tolerance / TRUST.safety:
        return None
    steps, stride = land(scene, rate)
    if not 1 < stride <= INTERPOLATION.values // scene.chain.grains:
        return None
    return Steps.spread(scene.sampling_interval, steps, stride, adaptive)


def land(scene: Scene, rate: float) -> tuple[int, int]:
    """Return steps and samples per landing at about this number of steps per sample."""
    # The lengths of blocks are multiples of 4 samples.
    stride = min(scene.intervals, 4 * math.ceil(INTERPOLATION.steps / rate / 4))
    return math.ceil(rate * stride), stride
