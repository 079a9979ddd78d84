"""Averages over chains with random contacts, which `lmpchain.disorder.draws` draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..engines.base import Engine
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..util.arrays import Array
from ..util.plotting import Axes, chart, finish, prefixed
from ..util.remarks import warnings_aside
from ..util.tabular import Tabular
from .draws import Law, Of, check, disordered, factors, fault_of_count, fault_of_whole, realisation
from .streaming import Average, Draw, StreamedAverages, draw_mean, take_average

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
        """
        ax = chart(ax, "grain number, from the top", "mean velocity, downward [m/s]")
        label = f"m = {self.m:g}: mean of {self.realisations} chains"
        mean = self.velocity[sample]
        draw_mean(ax, self.grains, mean, self.velocity_error[sample], label, "± 2 st. errors")
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
    check(fault_of_count(realisations, 2), fault_of_whole("seed", seed, 0))
    end = Scene(chain=scene.chain, excitation=scene.excitation, duration=scene.duration, samples=2)
    averages = [ensemble(end, m, realisations, seed, progress=progress) for m in orders]
    # Warnings are not repeated, because the averages contain the model error.
    with warnings_aside():
        return simulate(end, "chebyshev").velocity[-1], averages
