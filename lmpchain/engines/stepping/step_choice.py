"""The step of an answer: the longest that should meet the tolerance, and its correction.

The error of a method of order p is C (omega h)^p after the time for which C, its `error_constant`,
is given; it grows in proportion to time, and with how far contacts open. The first step makes it
half the tolerance, and the next one follows from the error estimate e,

    h' = h (0.7 tolerance / e)^(1/p),

with the order p that the estimate trusts; Hairer, Norsett and Wanner, Solving Ordinary Differential
Equations I, section II.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...errors import InputError
from ...integrators.method import Method
from ...integrators.steps import MANY_STEPS, Steps
from ...scene.scene import Scene
from ..base import ErrorBudget
from .auxiliary_runs import DIES, LONGER, OPENINGS, TRUST
from .rounding import interpolation_loss


@dataclass(frozen=True)
class FirstStep:
    """Where the first step comes from; analysis/calibration/opening_error_factor.py.

    Attributes
    ----------
    radians : float
        Phase of the fastest motion for which `Method.error_constant` is given.
    longest : float
        Longest step over the stability limit.
    longest_opening : float
        The same where contacts may open.
    longest_damped : float
        The same in a chain that loses energy.
    foreseen : float
        Tolerance up to which an error is foreseen where nothing bounds the strain: for a tighter
        one the first attempt shows how long steps may be.
    safe_strain : float
        Strain up to which no contact comes near to opening.
    opening_error : float
        Factor on the error where contacts open a little and steps are shorter there; it grows with
        the root of the strain.
    largest_opening_error : float
        The most that it is.
    damped_opening_error, largest_damped_opening_error : float
        The same two in a chain that loses energy, whose method has next to no error where nothing
        opens; it grows with the strain itself. analysis/damping_cost.py.
    equal_error : float
        Factor where contacts open and steps are equal.
    coarse_error : float
        Factor where steps near openings are coarse, over those that are not.
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
        """Return the factor on the error of a scene whose strains are at most this."""
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
    """Interpolation of samples that steps pass over; analysis/calibration/long_steps.py.

    Attributes
    ----------
    error : float
        Relative error at omega h = 1.
    order : float
        With which it falls with the step.
    evaluations : float
        Time that a sample takes, in evaluations of the force.
    steps : int
        From landing to landing, at least.
    values : int
        Samples times grains between two landings, at most: they are held in memory.
    """

    error: float = 3e-8
    order: float = 7.0
    evaluations: float = 5.0
    steps: int = 8
    values: int = 2**19


@dataclass(frozen=True)
class StepControl:
    """How a step is shortened; analysis/calibration/step_refinement.py.

    Attributes
    ----------
    target : float
        Share of the tolerance at which the next error is aimed.
    roundoff : float
        Share of the tolerance beyond which round-off cannot be made up for.
    least, most : float
        Bounds on the ratio of the old step to the new one; `most` after a breakdown, too.
    """

    target: float = 0.7
    roundoff: float = 0.9
    least: float = 1.3
    most: float = 8.0

    def ratio(self, error: ErrorBudget | None, tolerance: float) -> float | None:
        """Return the old step over the next one; None where round-off alone is too much.

        Parameters
        ----------
        error : ErrorBudget, optional
            None after a run that broke down.
        tolerance : float
        """
        if error is None:
            return self.most
        if error.roundoff > self.roundoff * tolerance:
            return None
        return min(max(self.aim(error, tolerance), self.least), self.most)

    def aim(self, error: ErrorBudget, tolerance: float) -> float:
        """Return the old step over the one at which the next error is aimed, without bounds."""
        room = max(tolerance - error.roundoff, tolerance / 4)
        return (error.truncation / (self.target * room)) ** (1 / error.order)


FIRST_STEP = FirstStep()
INTERPOLATION = Interpolation()
STEP_CONTROL = StepControl()


def work(method: Method, steps: Steps) -> float:
    """Return the time that steps take for each sample, in evaluations of the force."""
    evaluations = method.evaluations * steps.per_landing / steps.stride
    if steps.stride == 1:
        return evaluations
    # Steps that could all be equal cost half as much as those that look for samples between them.
    return evaluations * (1.0 if steps.adaptive else 2.0) + INTERPOLATION.evaluations


MOST_STEPS = 2**53  # from one sample to the next: larger numbers have no ones any more


def choose_given_step(scene: Scene, method: Method, step: float) -> Steps:
    """Return the largest step up to the one that was given, s, which divides the sample interval.

    Raises
    ------
    InputError
        If the method is not stable at it.
    """
    stable = method.stability_limit
    edge = scene.chain.fastest_rate
    if step * edge > stable:
        why = f"where {method.name} stops being stable on this chain (got {step:g})"
        raise InputError.at("step", f"must be below {stable / edge:.3g} s, {why}")
    interval = scene.sampling_interval
    if not interval / step < MOST_STEPS:
        least = f"longer than {interval / MOST_STEPS:.1g} s"
        raise InputError.at("step", f"must be {least}, or steps cannot be counted (got {step:g})")
    # a step that divides it but for round-off does
    steps = math.ceil(interval / step * (1 - 1e-12))
    return Steps.spread(interval, steps)


def choose_step(scene: Scene, method: Method, tolerance: float, adaptive: bool) -> Steps:
    """Return the longest step of a method that should meet the tolerance.

    Parameters
    ----------
    scene : Scene
    method : Method
    tolerance : float
    adaptive : bool
        Whether steps may be shorter near openings, and pass over samples.
    """
    may_open = scene.largest_strain > FIRST_STEP.safe_strain
    shortens = adaptive and method.adaptive and may_open
    reach = expected_reach(scene, method, tolerance, shortens)
    interval = scene.sampling_interval
    phase = scene.sampling_phase
    steps = math.ceil(phase / reach)
    # Two auxiliary runs land on every sample, by halves, thirds or quarters of its steps.
    while 2 < steps < MANY_STEPS and steps % 4 and steps % 6 and scene.sampling_decay > DIES:
        steps += 1
    coarse = False
    if shortens and not OPENINGS.kinks(scene.chain.law.onset):
        # where samples hold steps short, shorter ones near openings would only cost
        shorter = expected_reach(scene, method, tolerance / FIRST_STEP.coarse_error, shortens)
        coarse = steps == math.ceil(phase / shorter)
    sampled = Steps.spread(interval, steps, 1, shortens, coarse)
    # in the vacuum a front grows so steeply that what lies between steps may get a wrong sign, and
    # polynomials know nothing of the corners of what acts all along
    smooth = scene.chain.linearisable and not scene.excitation.does_work
    if adaptive and smooth and method.interpolates:
        passing = _pass_samples(scene, tolerance, shortens, phase, reach)
        if passing and work(method, passing) < work(method, sampled):
            return passing
    return sampled


def expected_reach(scene: Scene, method: Method, tolerance: float, adaptive: bool) -> float:
    """Return omega h of the longest step whose error is expected to be half the tolerance."""
    strain = scene.largest_strain
    if strain == math.inf:
        tolerance = max(tolerance, FIRST_STEP.foreseen)
    radians = scene.total_phase
    error = method.error_constant
    # an order of 1 loses nothing where contacts open, and the motion dies away as its error grows
    if method.order > 1:
        error *= max(1.0, radians / FIRST_STEP.radians)
        error *= FIRST_STEP.opening_factor(strain, adaptive, scene.chain.damped)
    reach = (tolerance / TRUST.safety / error) ** (1 / method.order)
    # some methods are stable for longer steps than half a period of the fastest motion, and no good
    # there
    stable = min(method.stability_limit, math.pi)
    if strain <= FIRST_STEP.safe_strain:
        reach = min(reach, FIRST_STEP.longest * stable)
    else:
        # Two auxiliary runs, at up to four times the step, show the rate at which the error falls.
        # If there is one alone, the distance itself counts, which is 2^order times the error. If
        # nothing bounds the strain, errors of longer steps scatter, and two runs may agree by
        # chance.
        longest = FIRST_STEP.longest_damped if scene.chain.damped else FIRST_STEP.longest_opening
        alone = min(reach / 2, longest * stable) if strain < math.inf else 0.0
        reach = max(min(reach, stable / 4), alone)
    if adaptive:
        # All runs end steps on the corners of an applied force. The longest steps of an auxiliary
        # run must fit between two corners, or corners would cut the steps of all runs alike.
        spacing = scene.corner_spacing / LONGER[-1]
        reach = min(reach, scene.highest_frequency * spacing)
    return reach


def _pass_samples(
    scene: Scene, tolerance: float, adaptive: bool, phase: float, reach: float
) -> Steps | None:
    """Return steps that pass over samples, if there are such steps.

    There is none where interpolated samples would be wrong, or too many to hold.
    """
    smooth = (tolerance / TRUST.safety / INTERPOLATION.error) ** (1 / INTERPOLATION.order)
    rate = phase / min(reach, smooth)  # steps a sample
    if interpolation_loss(rate * scene.intervals) > tolerance / TRUST.safety:
        return None
    steps, stride = land(scene, rate)
    if not 1 < stride <= INTERPOLATION.values // scene.chain.grains:
        return None
    return Steps.spread(scene.sampling_interval, steps, stride, adaptive)


def land(scene: Scene, rate: float) -> tuple[int, int]:
    """Return steps and samples from one landing to the next, at about so many steps a sample."""
    # blocks of samples are multiples of 4 long
    stride = min(scene.intervals, 4 * math.ceil(INTERPOLATION.steps / rate / 4))
    return math.ceil(rate * stride), stride
