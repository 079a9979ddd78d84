"""Sentences of a page about a run: strike, linear theory, front, contacts, error."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from .. import engines
from ..errors import InputError
from ..measure import front
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..trajectory.trajectory import Trajectory
from ..util.plotting import si
from ..util.remarks import warnings_aside


class FrontLimits(NamedTuple):
    """Limits for the detection of a front.

    Attributes
    ----------
    reflected : int
        Number of last grains that are ignored, because the reflected wave adds to their peak.
    onward : float
        Smallest fraction of the grains that a front must pass later than the previous grain.
    """

    reflected: int = 3
    onward: float = 0.9


FRONT_LIMITS = FrontLimits()
# Units of keys by their last word; an amplitude is a force only if a force is applied.
UNITS_OF_KEYS = {
    "velocity": "m/s",
    "displacement": "m",
    "gravity": "m/s²",
    "top_load": "N",
    "diameter": "m",
    "duration": "s",
    "frequency": "Hz",
    "amplitude": "m",
    "rise": "s",
    "viscoelastic": "s",
    "drag": "1/s",
    "density": "kg/m³",
    "youngs_modulus": "Pa",
    "mass": "kg",
}


def unit_of_key(name: str, kind: str) -> str:
    """Return the unit of a key of a scene by its last word, for this kind of excitation."""
    return "N" if name == "amplitude" and kind == "force" else UNITS_OF_KEYS.get(name, "")


def linear_theory(run: Trajectory) -> Trajectory | None:
    """Solve the scene of a run by linear theory; return None if linear theory does not apply."""
    return _linear_run(run.scene)


# Several parts of the page need this run, so the last one is stored.
@lru_cache(maxsize=1)
def _linear_run(scene: Scene) -> Trajectory | None:
    linear = [engine for engine in map(engines.plain, engines.names()) if engine.equation == 3]
    able = [engine for engine in linear if not engines.obstacles(engine, scene)]
    if not able:
        return None
    cheapest = min(able, key=lambda engine: engine.propose(engine.part(scene), 0.5).cost_s)
    with warnings_aside():
        # The page shows the difference, so warnings are suppressed.
        return simulate(scene, cheapest)


def departure(run: Trajectory, linear: Trajectory) -> float:
    """Return the largest error of linear theory, relative to the largest velocity."""
    largest = np.abs(run.velocity).max(initial=0.0) or 1.0
    return float(np.abs(run.velocity - linear.velocity).max(initial=0.0) / largest)


def front_below(run: Trajectory) -> front.Front:
    """Return the front below the grain that is struck.

    Grains whose order of arrival the samples do not show are left out.

    Raises
    ------
    InputError
        If no front travels downward, or the samples are too few to show it.
    """
    scene = run.scene
    source = getattr(scene.excitation, "grain", None)
    if source is None or getattr(scene.excitation, "frequency", None):
        raise InputError.at(
            "excitation", "sends no single front: there is one after a strike or a push on a grain"
        )
    track = front.track(run).between(source + 1, scene.chain.grains - FRONT_LIMITS.reflected)
    fewest = front.FEWEST
    missing = InputError.at(
        "front", f"none travels downward from grain {source} past {fewest} grains or more"
    )
    if track.grain.size < fewest:
        raise missing
    step = scene.sampling_interval
    # Arrival times closer than the sampling error do not show their order.
    shown = track.time_error < step
    resolved = np.diff(track.time[shown])
    # An oscillating mode has maxima in no order, but a front passes the grains one by one.
    if shown.sum() >= fewest and np.mean(resolved > 0) >= FRONT_LIMITS.onward:
        return track.where(shown)
    needed = 1 + int(np.ceil(scene.total_phase / front.RESOLVED_TURN))
    if needed > scene.samples:
        raise InputError.at(
            "samples",
            f"{si(step, 's')} apart do not resolve the front: record at least {needed} samples",
        )
    raise missing


def short_power(number: float) -> str:
    """Return a small number in a short decimal form.

    Examples
    --------
    >>> short_power(1e-06), short_power(2.5e-12)
    ('1e-6', '2.5e-12')
    """
    return f"{number:.2g}".replace("e-0", "e-")


def strike_verdict(run: Trajectory, linear: Trajectory | None) -> str:
    """Return a sentence with the strike number and its meaning for this run."""
    number = run.scene.strike_number
    if not np.isfinite(number):
        return "Sonic vacuum: no contact is compressed at rest, and no linear theory applies."
    if linear is None:
        return f"Strike number {number:.3g}; no linear theory of this scene."
    return f"Strike number {number:.3g}; {linear_verdict(run, linear)}."


def linear_verdict(run: Trajectory, linear: Trajectory) -> str:
    """Return a sentence with the error of linear theory."""
    error = departure(run, linear)
    if error < 1e-5:
        return "linear theory holds to better than 0.001 % of the largest velocity"
    kind = "holds to" if error < 0.05 else "is off by"
    # The format gives 140 %, not 1.4e+02 %.
    percent = float(f"{100 * error:.2g}")
    return f"linear theory {kind} {percent:g} % of the largest velocity"


def facts(
    run: Trajectory, linear: Trajectory | None, passed: front.Front | str, tolerance: float
) -> Iterator[tuple[str, str]]:
    """Yield the name and text of the facts beside the live figure of a run.

    Parameters
    ----------
    run : Trajectory
    linear : Trajectory or None
        Run of the same scene by linear theory.
    passed : Front or str
        Front, or the reason why there is none.
    tolerance : float
        Requested tolerance.
    """
    number = run.scene.strike_number
    yield "strike number", f"{number:.3g}" if np.isfinite(number) else "∞ (sonic vacuum)"
    yield (
        "linear theory",
        linear_verdict(run, linear).removeprefix("linear theory ")
        if linear
        else "none of this scene",
    )
    error = run.error_estimate
    miss = "" if error.total <= tolerance else f", above the tolerance {short_power(tolerance)}"
    yield "estimated error", f"{short_power(error.total)} ({run.engine}){miss}{error.remark}"
    yield "front", passed if isinstance(passed, str) else _front_verdict(passed)
    yield "largest velocity", si(float(np.abs(run.velocity).max(initial=0.0)), "m/s", 1)
    yield "contacts", _contacts_verdict(run)
    if run.scene.chain.damped:
        yield "damping", run.scene.damping_remark


def _front_verdict(passed: front.Front) -> str:
    """Return a phrase with the last grain that a front reaches, and its speed there."""
    last = min(10, passed.grain.size)
    slope = np.polyfit(passed.depth[-last:], passed.time[-last:], 1)[0]
    return f"reaches grain {passed.grain[-1]}, at {1 / slope:.3g} m/s"


def _contacts_verdict(run: Trajectory) -> str:
    """Return a phrase with the number of contacts between recorded grains that ever open."""
    order = np.argsort(run.grains)
    grains = run.grains[order]
    neighbours = np.flatnonzero(np.diff(grains) == 1)
    if not neighbours.size:
        return "none between two recorded grains"
    u = np.asarray(run.displacement)[:, order]
    overlap = run.scene.chain.equilibrium_overlap[grains[neighbours] - 1]
    least = (overlap + u[:, neighbours] - u[:, neighbours + 1]).min(0, initial=np.inf)
    opened = int((least <= 0).sum())
    if not overlap.any():
        return "touch at rest"
    return f"{opened} of {neighbours.size} open" if opened else "none opens"
