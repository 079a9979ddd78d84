"""What engines that step through time share: their options and the choice of the step."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..errors import InputError
from ..excitation import first_overlaps
from ..fields import Array
from ..scene import Scene
from .base import Candidate, Engine, SolverError
from .lockstep import SAFETY, LockstepRun, Stepper
from .splittings import SPLITTINGS, Splitting

ORDER_THROUGH_OPENINGS = 2.5
LONGEST_S = 3e8  # ten years


class SteppedEngine(Engine):
    """An engine that moves through time with one of the splittings at a fixed step."""

    seconds_per_grain_step: float

    def __init__(self, integrator: str, step: float | None):
        if integrator not in SPLITTINGS:
            raise InputError([("integrator", f"must be {' | '.join(SPLITTINGS)} (got {integrator!r})")])
        if step is not None and not (isinstance(step, int | float) and math.isfinite(step) and step > 0):
            raise InputError([("step", f"must be a time above 0 s (got {step!r})")])
        self.splitting: Splitting = SPLITTINGS[integrator]
        self.step = step

    @abstractmethod
    def stepper(self, scenes: Sequence[Scene], candidate: Candidate, state: Mapping[str, Array]) -> Stepper:
        """Make the stepper of the answer, from the start or from a kept state."""

    def candidate(self, scene: Scene, tolerance: float) -> Candidate:
        """Propose a step: the one given, or the one that should meet the tolerance."""
        interval = scene.duration / (scene.samples - 1)
        stiffest = stiffest_frequency(scene)
        limit = self.splitting.stability_limit
        if self.step is not None:
            if self.step * scene.chain.band_edge > limit:
                raise InputError(
                    [("step", f"must be below {limit / scene.chain.band_edge:.3g} s, where {self.splitting.name} "
                      f"stops being stable on this chain (got {self.step:g})")]
                )  # fmt: skip
            return self._at(scene, math.ceil(interval / self.step * (1 - 1e-12)), tolerance, fixed=True)
        reach = (tolerance / SAFETY / self.splitting.error_constant) ** (1 / self.splitting.order)
        longest = min(reach, 0.2 * limit)
        return self._at(scene, 4 * math.ceil(interval * stiffest / longest / 4), tolerance)

    def _at(self, scene: Scene, steps_per_sample: int, error: float, fixed: bool = False) -> Candidate:
        cost = self._cost(scene, steps_per_sample * (scene.samples - 1))
        if cost > LONGEST_S:
            years = cost / 3.15e7
            raise InputError([("duration", f"would take some {years:.1g} years: shorten it, or ask for less accuracy")])
        interval = scene.duration / (scene.samples - 1)
        return Candidate(steps_per_sample, interval / steps_per_sample, fixed, scene.chain.grains, 0.0, error, cost)

    def _cost(self, scene: Scene, steps: int) -> float:
        return self.seconds_per_grain_step * self.splitting.evaluations * steps * scene.chain.grains

    def refine(self, candidate: Candidate, error: SolverError | None, tolerance: float) -> Candidate | None:
        """Shorten the step by what the observed error asks for."""
        if error and error.roundoff > 0.9 * tolerance:
            return None
        factor = 4.0
        if error is not None and math.isfinite(error.truncation):
            order = self.splitting.order if error.smooth else min(self.splitting.order, ORDER_THROUGH_OPENINGS)
            room = max(tolerance - error.roundoff, tolerance / 4)
            most = 16.0 if error.truncation < 0.1 else 4.0  # far off, the law does not hold yet
            least = 1.3 if error.smooth else 2.0  # an erratic error tells nothing about small changes
            factor = min(max((error.truncation / (0.7 * room)) ** (1 / order), least), most)
        steps = 4 * math.ceil(candidate.steps_per_sample * factor / 4)
        step = candidate.step * candidate.steps_per_sample / steps
        return replace(candidate, steps_per_sample=steps, step=step)

    def start(
        self, scenes: Sequence[Scene], candidate: Candidate, state: Mapping[str, Array] | None = None
    ) -> LockstepRun:
        """Start one scene, or a batch of scenes that differ in numbers only."""
        kinds = {
            (c.grains, c.top, c.bottom, c.exponent, c.compressed, s.drive is None, s.samples, s.duration, s.grains)
            for s, c in ((s, s.chain) for s in scenes)
        }
        if len(kinds) != 1:
            raise ValueError("a batch needs chains of one kind and length, recorded alike")
        return LockstepRun(lambda kept: self.stepper(scenes, candidate, kept), self.splitting, scenes, candidate, state)


def stiffest_frequency(scene: Scene) -> float:
    """Return the highest frequency that the scene can excite, rad/s.

    The band edge of the chain at rest, that of two grains pressed together by the strike, or that of a drive.
    """
    chain = scene.chain
    pressed = first_overlaps(chain, scene.excitation)
    stiffness = chain.exponent * chain.contacts.constant * pressed ** (chain.exponent - 1)
    pair = math.sqrt(2 * float(stiffness.max()) / chain.masses.min())
    return max(chain.band_edge, pair, scene.drive.fastest if scene.drive else 0.0) or 1 / scene.duration
