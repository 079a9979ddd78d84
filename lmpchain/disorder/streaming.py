"""Running means over many random chains, computed in batches with constant memory."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .. import engines
from ..chain.plausible import LIMITS
from ..engines.base import Engine, Run
from ..engines.cost_model import announce
from ..engines.step_control import Attempt, solve_to_tolerance
from ..errors import InputError, ToleranceNotMet, check_tolerance, shown
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.notebook import Shown
from ..util.plotting import Axes
from ..util.progress import ProgressBar
from .draws import Law, Of, check, fault_of_count, realisation

BATCH = 16  # Number of chains in a batch.


class Draw(NamedTuple):
    """The random chains of a scene, numbered as by `realisation`."""

    scene: Scene
    m: float
    seed: int
    law: Law
    of: Of

    def number(self, index: int) -> Scene:
        """Return the scene with random chain number `index`."""
        return realisation(self.scene.ungathered, self.m, self.seed, index, self.law, self.of)


@dataclass(eq=False)
class Average:
    """Running means and sums of squared deviations of Q quantities of random chains, (Q, T, ...).

    The default quantities are displacement and velocity, (2, T, G). The method is from B. P.
    Welford, Technometrics 4, 419 (1962).
    """

    mean: Array
    square: Array
    count: int = 0
    model: float = 0.0
    solver: float = 0.0
    squeezed: int = 0

    def measure(self, scene: Scene, displacement: Array, velocity: Array) -> Array:
        """Return the quantities of a chain, (Q, t, ...), from its motion at t samples, (t, G)."""
        return np.stack((displacement, velocity))

    def keep(self, number: int, samples: slice, value: Array) -> None:
        """Store quantities of one chain that are not part of the mean; nothing by default."""

    def add(self, run: Run, scenes: Sequence[Scene], bar: ProgressBar) -> None:
        """Add the first chains of a batch to the average, one after the other."""
        for block in run.blocks():
            if block.samples.start < block.samples.stop:
                mean = self.mean[:, block.samples]
                square = self.square[:, block.samples]
                for number, scene in enumerate(scenes):
                    value = self.measure(scene, block.displacement[number], block.velocity[number])
                    # Welford's method uses the mean before and after, so that squared deviations do
                    # not cancel.
                    deviation = value - mean
                    mean += deviation / (self.count + number + 1)
                    square += deviation * (value - mean)
                    self.keep(self.count + number, block.samples, value)
            bar.reach(self.count + len(scenes) * run.progress)
        self.count += len(scenes)

    @property
    def errors(self) -> Array:
        """Standard errors of the means, (Q, T, ...); NaN for a single chain."""
        if self.count < 2:
            return np.full_like(self.square, np.nan)
        return np.sqrt(self.square / (self.count - 1) / self.count)


@dataclass(frozen=True, eq=False, repr=False)
class StreamedAverages(Shown):
    """Options and errors of averages over disordered chains; see `Ensemble`."""

    scene: Scene
    m: float
    seed: int
    law: Law
    of: Of
    engine: str
    equation: int
    realisations: int
    time: Array
    model_error: float
    solver_error: float
    squeezed: int


def draw_mean(
    ax: Axes, x: Array, mean: Array, error: Array, label: str, band_label: str | None = None
) -> None:
    """Draw a mean over chains in a band of two standard errors, if these are known."""
    (line,) = ax.plot(x, mean, label=label)
    if not np.isnan(error).all():
        shade: dict[str, Any] = {"color": line.get_color(), "alpha": 0.25, "lw": 0}
        ax.fill_between(x, mean - 2 * error, mean + 2 * error, label=band_label, **shade)


def take_average(
    draw: Draw,
    realisations: int,
    engine: str | Engine,
    tolerance: float,
    first: Average,
    progress: bool,
) -> tuple[Any, dict[str, Any]]:
    """Return the average over a number of chains, and its `StreamedAverages` fields.

    Parameters
    ----------
    draw : Draw
    realisations : int
        Number of chains.
    engine, tolerance, progress
        As for `ensemble`.
    first : Average
        Empty average to which the chains are added.

    Raises
    ------
    InputError, ToleranceNotMet, RunFailed
        As for `ensemble`.
    """
    check_tolerance(tolerance)
    check(fault_of_count(realisations, 1))
    solver = engines.get(engine)
    if not solver.batches:
        names = ", ".join(name for name in engines.names() if engines.get(name).batches)
        message = f"must be one of {names} for random chains (got {shown(solver.name)})"
        raise InputError.at("engine", message)
    if reasons := solver.refuses(draw.number(0)):
        raise InputError(reasons)
    part = solver.part(draw.number(0))
    announce(
        realisations * solver.propose(part, tolerance).cost_s,
        f"the mean over {realisations} chains by {solver.name}",
        "fewer realisations or a shorter duration takes less",
    )
    average = first
    # A block of a batch contains at most 2^24 numbers.
    batch = max(1, min(BATCH, 2**24 // (16 * draw.scene.chain.grains)))
    with ProgressBar(realisations, f"m = {draw.m:g}", " chains", shown=progress) as bar:
        while average.count < realisations:
            count = min(batch, realisations - average.count)
            # Every full batch has one step size, so that results do not depend on the size of the
            # ensemble.
            size = batch if solver.equation == 1 else count
            scenes = [draw.number(index) for index in range(average.count, average.count + size)]
            average = _add_batch(solver, scenes, count, tolerance, average, bar)
    return average, {
        **draw._asdict(),
        "engine": solver.name,
        "equation": solver.equation,
        "realisations": realisations,
        "time": draw.scene.time,
        "model_error": average.model,
        "solver_error": average.solver,
        "squeezed": average.squeezed,
    }


def _add_batch(
    engine: Engine,
    scenes: Sequence[Scene],
    count: int,
    tolerance: float,
    before: Average,
    bar: ProgressBar,
) -> Average:
    """Return the average after adding a batch, with steps short enough for all its scenes."""
    proposals = [engine.propose(engine.part(scene), tolerance) for scene in scenes]
    hardest = max(proposals, key=lambda proposal: proposal.cost_s)
    adaptive = any(proposal.steps.adaptive for proposal in proposals)
    proposal = hardest._replace(steps=hardest.steps._replace(adaptive=adaptive))

    def collect(run: Run) -> Average:
        # Each attempt starts from a copy of the previous average, because attempts with too long
        # steps are repeated.
        average = deepcopy(before)
        average.add(run, scenes[:count], bar)
        return average

    attempt = Attempt(proposal, tolerance)
    outcome = solve_to_tolerance(engine, scenes, attempt, collect)
    if outcome.missed:
        raise ToleranceNotMet(
            f"in chains {before.count + 1} to {before.count + len(scenes)} {outcome.missed}"
        )
    average = outcome.collected
    errors = outcome.errors[:count]
    average.model = max(average.model, *(error.model for error in errors))
    average.solver = max(average.solver, *(error.solver for error in errors))
    for scene in scenes[:count]:
        compression = scene.chain.equilibrium.compression
        average.squeezed += int((compression > LIMITS.compression).any())
    return average
