"""Running means over many random chains, batch by batch: the memory of a few serves any number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from .. import engines
from ..chain.chain import Chain
from ..chain.plausible import LIMITS
from ..engines.base import Engine, Run
from ..engines.step_control import Attempt, solve_to_tolerance
from ..errors import InputError, ToleranceNotMet, check_tolerance, shown
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.progress import ProgressBar
from .draws import Law, Of, check, fault_of_whole, realisation

BATCH, BATCH_VALUES = 16, 2**24  # chains at a time, and the numbers that a block of them may hold


class Draw(NamedTuple):
    """The random chains of a scene, as `realisation` numbers them."""

    scene: Scene
    m: float
    seed: int
    law: Law
    of: Of

    def number(self, index: int) -> Scene:
        """Return the scene with this chain."""
        return realisation(self.scene.ungathered, self.m, self.seed, index, self.law, self.of)


@dataclass(eq=False)
class Average:
    """Running means and sums of squared deviations (Welford) of what is measured, (Q, T, ...).

    By default these are displacement and velocity, (2, T, G).
    """

    mean: Array
    square: Array
    count: int = 0
    model: float = 0.0
    solver: float = 0.0
    squeezed: int = 0

    def measured(self, scene: Scene, displacement: Array, velocity: Array) -> Array:
        """Return what is averaged of a chain, (Q, t, ...), from its motion at some samples, (t, G)."""
        return np.stack((displacement, velocity))

    def keep(self, number: int, samples: slice, value: Array) -> None:
        """Take note of what was measured of one chain beyond its part in the mean."""

    def add(self, run: Run, scenes: Sequence[Scene], bar: ProgressBar) -> None:
        """Take in the first chains of a batch, one after the other."""
        for block in run.blocks():
            if block.samples.start < block.samples.stop:
                mean, square = self.mean[:, block.samples], self.square[:, block.samples]
                for place, scene in enumerate(scenes):
                    value = self.measured(scene, block.displacement[place], block.velocity[place])
                    off = value - mean
                    mean += off / (self.count + place + 1)
                    square += off * (value - mean)
                    self.keep(self.count + place, block.samples, value)
            bar.reach(self.count + len(scenes) * run.progress)
        self.count += len(scenes)

    def copy(self) -> Average:
        """Return one to go on with while this one is kept."""
        return replace(self, mean=self.mean.copy(), square=self.square.copy())

    @property
    def errors(self) -> Array:
        """Standard errors of the means, (Q, T, ...); NaN for a single chain."""
        if self.count < 2:
            return np.full_like(self.square, np.nan)
        return np.sqrt(self.square / (self.count - 1) / self.count)


A = TypeVar("A", bound=Average)


def averaged(
    draw: Draw, realisations: int, engine: str | Engine, tolerance: float, first: A, progress: bool
) -> tuple[Engine, A]:
    """Return the engine, and the average over so many chains; what is raised stands at `ensemble`.

    Parameters
    ----------
    first : Average
        Of no chain, to begin with.
    """
    check_tolerance(tolerance)
    check(fault_of_whole("realisations", realisations, 1))
    chosen = engines.get(engine)
    if not chosen.batches:
        able = ", ".join(name for name in engines.names() if engines.get(name).batches)
        raise InputError([("engine", f"random chains are for {able} (got {shown(chosen.name)})")])
    if reasons := chosen.refuses(draw.number(0)):
        raise InputError(reasons)
    average, batch = first, max(1, min(BATCH, BATCH_VALUES // (16 * draw.scene.chain.grains)))
    with ProgressBar(realisations, f"m = {draw.m:g}", " chains", shown=progress) as bar:
        while average.count < realisations:
            wanted = min(batch, realisations - average.count)
            # one step per full batch, so that results do not depend on the size of the ensemble
            size = batch if chosen.equation == 1 else wanted
            scenes = [draw.number(index) for index in range(average.count, average.count + size)]
            average = _answer(chosen, scenes, wanted, tolerance, average, bar)
    return chosen, average


def _answer(
    engine: Engine,
    scenes: Sequence[Scene],
    wanted: int,
    tolerance: float,
    before: A,
    bar: ProgressBar,
) -> A:
    """Return the average with the first `wanted` scenes of a batch, at steps short enough for all."""
    proposed = [engine.candidate(engine.part(scene), tolerance) for scene in scenes]
    hardest = max(proposed, key=lambda candidate: candidate.cost_s)
    candidate = hardest._replace(adaptive=any(each.adaptive for each in proposed))

    def collect(run: Run) -> A:
        average = before.copy()
        average.add(run, scenes[:wanted], bar)
        return average  # type: ignore[return-value]

    outcome = solve_to_tolerance(
        engine, scenes, Attempt(engine.name, candidate, tolerance), collect
    )
    if outcome.missed:
        raise ToleranceNotMet(
            f"in chains {before.count + 1} to {before.count + len(scenes)} {outcome.missed}"
        )
    average, errors = outcome.collected, outcome.errors[:wanted]
    average.model = max(average.model, *(error.model for error in errors))
    average.solver = max(average.solver, *(error.solver for error in errors))
    average.squeezed += sum(_squeezed(scene.chain) for scene in scenes[:wanted])
    return average


def _squeezed(chain: Chain) -> bool:
    return bool((chain.equilibrium.compression > LIMITS.compression).any())
