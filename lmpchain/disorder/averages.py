"""Averages over chains with random contacts, which `lmpchain.disorder.draws` draws."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from .. import engines
from ..chain.bounds import LIMITS
from ..engines.base import Engine, Run
from ..engines.cost_model import announce
from ..engines.step_control import Attempt, solve_to_tolerance
from ..errors import InputError, ToleranceNotMet, check_tolerance, shown
from ..scene.scene import Scene, check_scene
from ..simulation.api import simulate
from ..util.arrays import Array
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish, prefixed
from ..util.progress import ProgressBar
from ..util.remarks import warnings_aside
from ..util.tabular import Tabular
from .draws import Law, Of, check, disordered, factors, fault_of_count, fault_of_whole, realisation

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


__all__ = ["Ensemble", "at_the_end", "disordered", "ensemble", "factors", "realisation"]


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble(StreamedAverages, Tabular):
    """Mean motion of disordered chains of one scene, with standard errors.

    Attributes
    ----------
    scene : Scene
        The scene with the ordered chain.
    m : float
        Shape parameter of the distribution, as for `factors`.
    seed : int
        Seed of the random numbers.
    law, of : str
        Distribution of the random factors; quantity that they change, as for `disordered`.
    engine : str
        Name of the engine.
    equation : int
        Number of the equation of the paper that the engine solves.
    realisations : int
        Number R of chains.
    time : (T,) array
        Times, s.
    grains : (G,) array
        Numbers of the recorded grains.
    displacement, velocity : (T, G) arrays
        Mean displacement, positive downward, m; mean velocity, m/s.
    displacement_error, velocity_error : (T, G) arrays
        Standard error of the mean displacement, m, NaN for a single chain; standard error of the
        mean velocity, m/s.
    model_error, solver_error : float
        Largest model error of any chain, which shows how nonlinear the motion was; largest solver
        error of any chain. Both are defined as for a trajectory.
    squeezed : int
        Number of chains with a contact whose overlap at rest exceeds a tenth of the diameter.
    """

    _units: ClassVar[dict[str, str]] = {
        "time": "s",
        "displacement": "m",
        "velocity": "m/s",
        "displacement_error": "m",
        "velocity_error": "m/s",
    }
    _numbers: ClassVar[str] = "grains"

    grains: np.ndarray
    displacement: Array
    velocity: Array
    displacement_error: Array
    velocity_error: Array

    def plot(self, ax: Axes | None = None, sample: int = -1) -> Axes:
        """Draw the mean velocity against grain number at one sample, and return the axes.

        A band around the mean shows two standard errors.

        Raises
        ------
        InputError
            If there is no such sample.
        """
        check(fault_of_whole("sample", sample, -self.time.size, self.time.size - 1))
        ax = chart(ax, "grain number, from the top", "mean velocity, downward [m/s]")
        label = f"m = {self.m:g}: mean of {self.realisations} chains"
        order = np.argsort(self.grains)
        mean, error = (x[sample, order] for x in (self.velocity, self.velocity_error))
        draw_mean(ax, self.grains[order], mean, error, label, "± 2 st. errors")
        return finish(ax, f"t = {prefixed(self.time[sample], 's')}")


def ensemble(
    scene: Scene,
    m: float,
    realisations: int,
    seed: int,
    engine: str | Engine = "chebyshev",
    *,
    tolerance: float = 1e-6,
    law: Law = "dyson",
    of: Of = "stiffness",
    progress: bool = False,
) -> Ensemble:
    """Simulate a scene for many disordered chains and average.

    Memory contains only running means and variances, for any number of chains. Chain i is the one
    that `realisation` returns, and its solution does not depend on the number of chains.

    Parameters
    ----------
    scene : Scene
        The scene with the ordered chain.
    m : float
        Shape parameter of the distribution, as for `factors`.
    realisations : int
        Number of chains.
    seed : int
        Seed of the random numbers, 0 or more; the same seed gives the same bytes.
    engine : str or Engine
        "chebyshev" or "modes" for Eq. (3), "native" for Eq. (1), or one of these as an object with
        options.
    tolerance : float
        Largest relative solver error of any chain; not enforced for an engine with a given step.
    law, of : str
        As for `disordered`.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Ensemble
        Mean displacement and velocity with their standard errors.

    Raises
    ------
    InputError
        If an option is wrong, or if the engine cannot solve the scene with random chains.
    ToleranceNotMet
        If shorter steps do not reduce the error below the tolerance.
    RunFailed
        If an integration breaks down at a given step.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> scene = Scene(
    ...     chain=Chain(grains=30, diameter=1e-3),
    ...     excitation=Impulse(velocity=1e-9),
    ...     duration=3e-5,
    ...     samples=2,
    ... )
    >>> few = ensemble(scene, 2, realisations=20, seed=1)
    >>> few.velocity.shape, bool(few.velocity_error.max() > 0)
    ((2, 30), True)
    """
    check_scene(scene)
    first = Average(*np.zeros((2, 2, scene.samples, scene.recorded.size)))
    draw = Draw(scene, m, seed, law, of)
    average, options = take_average(draw, realisations, engine, tolerance, first, progress)
    errors = average.errors
    return Ensemble(
        **options,
        grains=scene.recorded.copy(),
        displacement=average.mean[0],
        velocity=average.mean[1],
        displacement_error=errors[0],
        velocity_error=errors[1],
    )


def at_the_end(
    scene: Scene, orders: Sequence[float], realisations: int, seed: int, progress: bool = False
) -> tuple[Array, list[Ensemble]]:
    """Return final velocities of the ordered chain, and averages over random chains for each m.

    Parameters
    ----------
    scene : Scene
    orders : sequence of M float
        Values of m.
    realisations, seed, progress
        As for `ensemble`, but at least two chains, so that the averages have standard errors.

    Returns
    -------
    (N,) array and list of M Ensemble
        Velocities of the ordered chain, m/s, and averages of all grains at two samples, the start
        and the end.

    Raises
    ------
    InputError
        As for `ensemble`.
    """
    check_scene(scene)
    check(fault_of_count(realisations, 2), fault_of_whole("seed", seed, 0))
    end = Scene(chain=scene.chain, excitation=scene.excitation, duration=scene.duration, samples=2)
    averages = [ensemble(end, m, realisations, seed, progress=progress) for m in orders]
    # Warnings are not repeated, because the averages contain the model error.
    with warnings_aside():
        return simulate(end, "chebyshev").velocity[-1], averages
