"""Closed-form solutions as engines, for comparison: uniform columns struck at the top."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

import numpy as np

from ...scene.scene import Scene
from ...trajectory.record import Block, Cost
from ...util.arrays import Array
from ...util.compilation import clock
from ...util.plotting import COLOURS
from ..base import ErrorBudget, Proposal, Run
from .engine import Chebyshev, LinearEngine, LinearRun
from .model_error import unlike
from .solutions import LinearSolution


class ClosedForm(LinearEngine):
    """A formula for the linear wave in a uniform column, compared with the exact solution.

    Eq. (3) is also solved. The model error is the difference from its solution plus the model error
    of Eq. (3).
    """

    batches: ClassVar[bool] = False
    start_up_s: ClassVar[float] = 1e-3
    whole = True
    _beside = Chebyshev()

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return the reasons why the formula does not hold for this scene."""
        reached = scene.reached
        chain = reached.chain
        cases = [
            (key, "equal grains") for key, difference in unlike(chain).items() if difference > 1e-12
        ]
        if not scene.excitation.strikes_top:
            cases.append(("excitation", "an impulse on grain 1"))
        if chain.top != "free":
            cases.append(("top", 'top = "free"'))
        reasons = [
            (key, f"{self.name} needs {case}; use modes or chebyshev") for key, case in cases
        ]
        return super().refuses(reached) + reasons

    def propose(self, scene: Scene, tolerance: float) -> Proposal:
        """Propose the formula; its error is known before the run only if the formula is exact."""
        proposal = super().propose(scene.reached, tolerance)
        proposal = proposal._replace(active_grains=scene.chain.grains)
        return proposal if self.exact(scene) else proposal._replace(model_error=math.nan)

    def exact(self, scene: Scene) -> bool:
        """Return whether the formula solves Eq. (3) for this scene."""
        return False

    def work(self, scene: Scene) -> float:
        """Return the expected time of the exact solution and of the formula, s."""
        return self._beside.work(scene) + 1e-6 * scene.samples * scene.recorded.size

    def solve(self, scene: Scene, state: Mapping[str, Array]) -> LinearSolution:
        """Return the exact solution with which the formula is compared."""
        return self._beside.solve(scene, state)

    def start(
        self,
        scenes: Sequence[Scene],
        proposal: Proposal,
        state: Mapping[str, Array] | None = None,
    ) -> ClosedFormRun:
        """Start a run of one scene, or of a batch of scenes with the same recording."""
        return ClosedFormRun(self, scenes, self._beside.start(scenes, proposal, state), state or {})

    @abstractmethod
    def wave(self, scene: Scene, times: Array) -> tuple[Array, Array]:
        """Return the displacement and velocity of the recorded grains, (T, G) m and m/s."""


class Bessel(ClosedForm):
    """The homogeneous chain of equally stiff contacts without a bottom, Eqs. (4) and (13)."""

    name: ClassVar[str] = "bessel"
    auto = "cheapest"
    style = (COLOURS["sky blue"], "v")
    equation: ClassVar[int] = 4

    def exact(self, scene: Scene) -> bool:
        """Return whether all contacts are equally stiff and the wave does not reach the bottom."""
        uniform = scene.chain.gravity == 0 and scene.chain.compressed
        return uniform and scene.reached is not scene

    def wave(self, scene: Scene, times: Array) -> tuple[Array, Array]:
        """Return the displacement and velocity of the recorded grains, (T, G) m and m/s."""
        from ...theory import bessel

        unit = scene.chain.time_scale
        strike = scene.strike_velocity
        n = scene.recorded
        T = times[:, None] / unit
        return strike * unit * bessel.free_end_impulse(n, T), strike * bessel.free_end(n, T)


class Continuum(ClosedForm):
    """The continuum limit, Eq. (27): its impulse response, Eq. (35), averaged over grains."""

    name: ClassVar[str] = "continuum"
    auto = "cheapest"
    style = (COLOURS["orange"], "P")
    equation: ClassVar[int] = 27

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return the reasons why the formula does not hold for this scene."""
        reasons = super().refuses(scene)
        if scene.chain.law.power is None:
            reasons.append(("law", "continuum needs a power law of the overlap; use modes"))
        if scene.chain.top_load > 0 or scene.chain.gravity == 0:
            why = "continuum needs a chain under gravity alone; use modes or chebyshev"
            reasons.append(("top_load", why))
        return reasons

    def wave(self, scene: Scene, times: Array) -> tuple[Array, Array]:
        """Return the displacement and velocity of the recorded grains, (T, G) m and m/s."""
        from ...theory import continuum

        unit = scene.chain.time_scale
        strike = scene.strike_velocity
        phi, speed = continuum.impulse_of_grain(
            scene.recorded, times[:, None] / unit, scene.chain.law.power_of("the continuum")
        )
        return strike * unit * phi, strike * speed


class ClosedFormRun(Run):
    """A run of a closed form, which also solves the linear chain exactly."""

    def __init__(
        self, engine: ClosedForm, scenes: Sequence[Scene], exact: Run, state: Mapping[str, Array]
    ):
        assert isinstance(exact, LinearRun)
        self._engine = engine
        self._scenes = scenes
        self._exact = exact
        self._times = scenes[0].time
        # Largest differences between formula and exact solution in displacement and velocity.
        self._apart = np.array(state.get("apart", np.zeros((2, len(scenes)))))
        # Imports happen now, so that the time of the first block is spent on the formula alone.
        engine.wave(scenes[0], self._times[:1])
        self._formula_s = 0.0

    def blocks(self) -> Iterator[Block]:
        """Yield the solution in blocks."""
        for block in self._exact.blocks():
            began = clock()
            times = self._times[block.samples]
            waves = np.stack([self._engine.wave(scene, times) for scene in self._scenes], axis=1)
            self._formula_s += clock() - began
            true = np.stack((block.displacement, block.velocity))
            self._apart = np.maximum(self._apart, np.abs(waves - true).max((2, 3)))
            yield Block(block.samples, *waves)

    @property
    def progress(self) -> float:
        """Fraction of the samples that are done."""
        return self._exact.progress

    def errors(self) -> list[ErrorBudget]:
        """Return the errors of the formula against Eq. (3) and of Eq. (3) against Eq. (1)."""
        distances = (self._apart / self._exact.scale).max(0)
        return [
            error._replace(model=error.model + distance, model_bound=error.model_bound + distance)
            for error, distance in zip(self._exact.errors(), distances.tolist(), strict=True)
        ]

    def cost(self) -> Cost:
        """Return the cost so far; the exact solution counts as the error estimate."""
        cost = self._exact.cost()
        return cost._replace(
            integration_s=self._formula_s,
            estimate_s=cost.integration_s + cost.estimate_s,
            force_evaluations=0,
            integrator=self._engine.name,
        )

    def state(self) -> dict[str, Array]:
        """Return the state of the exact solution, and the largest differences so far."""
        return {**self._exact.state(), "apart": self._apart.copy()}
