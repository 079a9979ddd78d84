"""The one front door: a scene and an engine in, a trajectory out."""

from __future__ import annotations

import platform
import warnings
from importlib.metadata import version
from typing import Any, Literal

import numpy as np

from . import engines
from .engines.attempts import until_tolerance
from .engines.base import Engine, Run
from .errors import InputError, ToleranceNotMet, check_tolerance
from .fields import Array
from .scene import Scene
from .trajectory import ErrorEstimate, Trajectory


def simulate(
    scene: Scene,
    engine: str | Engine = "auto",
    tolerance: float = 1e-6,
    *,
    on_miss: Literal["raise", "warn"] = "raise",
    progress: bool = False,
    **options: Any,
) -> Trajectory:
    """Answer a scene.

    Parameters
    ----------
    scene : Scene
    engine : str or Engine
        A name (see `engines.names()`), "auto", or an engine object.
    tolerance : float
        Largest relative solver error, as defined for `ErrorEstimate`; an engine with a given step
        enforces none.
    on_miss : "raise" or "warn"
        What to do if the tolerance cannot be met.
    progress : bool
        Whether to show a progress bar.
    **options
        For the engine if it is named.

    Returns
    -------
    Trajectory

    Raises
    ------
    InputError
        If the engine cannot do the scene, or an option is wrong.
    ToleranceNotMet
        With the reason, and the trajectory unless it was clear beforehand.
    RunFailed
        If the integration breaks down at a given step.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> chain = Chain(grains=40, material="glass", diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-6), duration=50e-6)
    >>> t = simulate(scene, engine="native", tolerance=1e-9)
    >>> t.displacement.shape, bool(t.error_estimate.total <= 1e-9)
    ((101, 40), True)
    """
    check_tolerance(tolerance)
    if on_miss not in ("raise", "warn"):
        raise InputError([("on_miss", f'must be "raise" or "warn" (got {on_miss!r})')])
    chosen = engines.get(engine, **options)
    if reasons := chosen.refuses(scene):
        raise InputError(reasons)
    outcome = until_tolerance(
        chosen,
        scene,
        tolerance,
        lambda run: _collect(run, scene, chosen.name, progress),
        best_effort=on_miss == "warn",
    )
    displacement, velocity = outcome.collected
    trajectory = Trajectory(
        scene=scene,
        engine=chosen.name,
        equation=chosen.equation,
        time=scene.time,
        grains=scene.recorded,
        displacement=displacement,
        velocity=velocity,
        error_estimate=ErrorEstimate(outcome.error.model, outcome.error.total),
        cost=outcome.cost,
        provenance=_versions() | chosen.describe(scene, outcome.candidate),
    )
    if outcome.error.model > tolerance:
        left_out = f"Eq. ({chosen.equation}) leaves out about {outcome.error.model:.2g} of the answer"
        warnings.warn(f"{left_out}, more than {tolerance:g}. {outcome.error.remark}".rstrip(". "), stacklevel=2)
    if outcome.missed and on_miss == "raise":
        raise ToleranceNotMet(outcome.missed, trajectory)
    if outcome.missed:
        warnings.warn(outcome.missed, stacklevel=2)
    return trajectory


def _collect(run: Run, scene: Scene, name: str, progress: bool) -> tuple[Array, Array]:
    """Gather the blocks of a run in memory, showing how far it is."""
    from tqdm.auto import tqdm

    shape = (scene.samples, scene.recorded.size)
    try:
        displacement, velocity = np.empty(shape), np.empty(shape)
    except (MemoryError, ValueError):
        need = 16e-9 * shape[0] * shape[1]
        raise InputError([("samples", f"{need:.3g} GB do not fit: record fewer samples or grains")]) from None
    layout = "{desc}: {percentage:3.0f}% |{bar}| {elapsed}, {remaining} left"
    with tqdm(total=100, desc=name, disable=not progress, leave=False, bar_format=layout) as bar:
        for block in run.blocks():
            displacement[block.samples] = block.displacement[0]
            velocity[block.samples] = block.velocity[0]
            bar.update(100 * run.progress - bar.n)
    return displacement, velocity


def _versions() -> dict[str, str]:
    return {
        "lmpchain": version("lmpchain"),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": f"{platform.system()} {platform.machine()}",
    }
