"""The round-off floor of double precision: the law, and its measurement in long double.

Laws say it beforehand, measurements compare with runs in NumPy's long double.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..chain.contacts import Contacts
from ..engines import Lammps, Native
from ..engines.native.time_stepping import TimeSteppingEngine
from ..errors import InputError
from ..integrators.splittings import RKN6, Splitting
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..util.arrays import Array
from ..util.suggestions import not_among

Long = np.longdouble
STEP = 0.3  # highest frequency times the step of rkn6 at which floors are given: its own error is some 1e-9 there


def floor(
    scene: Scene, engine: str = "native", diameter: str = "physical", force: str = "auto"
) -> float:
    """Predict the relative error from round-off alone, at steps of rkn6 with omega h = 0.3.

    The laws are those of the engines, `typical_round_off`. Measured over 13 decades, on 70 random scenes, LAMMPS with
    both diameters: half of the floors are within a factor of 1.7 of it, nine in ten within 6
    (analysis/calibration/roundoff.py).

    Parameters
    ----------
    scene : Scene
    engine : "native" or "lammps"
    diameter : "physical" or "gauge"
        Of lammps.
    force : "auto", "exact" or "plain"
        Of native.

    Returns
    -------
    float
        Relative error.

    Raises
    ------
    InputError
        If the engine is neither, or an option is none of its own.
    """
    part = scene.reached
    steps = _steps(part)
    speed = _speed(part)
    return _engine(engine, diameter, force).typical_round_off(part, steps, speed)


def long_double(scene: Scene) -> tuple[Array, Array]:
    """Return displacement and velocity of the light cone, (T, N) m and m/s, in long double.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    two (T, N) arrays
        m, m/s.
    """
    part = scene.reached
    return _same_steps(part, RKN6, _steps(part))


def measured_floor(
    scene: Scene,
    engine: str = "native",
    diameter: str = "physical",
    force: str = "auto",
    exact: tuple[Array, Array] | None = None,
) -> float:
    """Measure what `floor` predicts: an engine against the same steps in NumPy's long double.

    The two take the same steps, so the error of the method is the same in both, whether contacts open or not.
    `exact` is `long_double(scene)`, where that is known already.

    Parameters
    ----------
    scene : Scene
    engine, diameter, force : str
        As for `floor`.
    exact : two (T, N) arrays, optional

    Returns
    -------
    float
        Relative error.

    Raises
    ------
    InputError
        As `floor`; and if the chain is driven, or the engine cannot do it.
    """
    if scene.excitation.does_work:
        raise InputError([("kind", "the floor of round-off is not measured for a driven chain")])
    part = scene.ungathered.reached
    steps = _steps(part)
    h = part.duration / steps * (1 + 1e-9)
    run = simulate(part, _engine(engine, diameter, force, h))
    assert run.cost.steps == steps
    true = exact or long_double(scene)
    values = run.displacement, run.velocity
    columns = run.grains - 1
    pairs = ((x, y[:, columns], np.abs(y).max()) for x, y in zip(values, true, strict=True))
    return max(float(np.abs(x - y).max() / most) for x, y, most in pairs)


def _engine(
    engine: str, diameter: str, force: str, step: float | None = None
) -> TimeSteppingEngine:
    known = (
        ("engine", engine, ("native", "lammps")),
        ("diameter", diameter, ("physical", "gauge")),
    )
    for key, value, allowed in known:
        if value not in allowed:
            raise InputError([(key, not_among(value, allowed))])
    return (
        Native("rkn6", step, force=force) if engine == "native" else Lammps("rkn6", step, diameter)
    )


def _steps(scene: Scene) -> int:
    """Return the steps with omega h = 0.3 that a scene takes."""
    intervals = scene.samples - 1
    return intervals * math.ceil(scene.duration / intervals * scene.highest_frequency / STEP)


def _speed(scene: Scene) -> float:
    """Return about the largest velocity, m/s."""
    u, v = (float(np.abs(x).max()) for x in scene.excitation.largest(scene.chain))
    return max(v, u * scene.highest_frequency) or scene.chain.length_scale / scene.chain.time_scale


def _same_steps(scene: Scene, splitting: Splitting, steps: int) -> tuple[Array, Array]:
    """Integrate by a splitting in long double; return displacement and velocity, (T, N) m and m/s."""
    chain = scene.chain
    mass, constant = chain.masses.astype(Long), chain.contacts.constant.astype(Long)
    carried = Long(chain.top_load) + Long(chain.gravity) * np.append(Long(0), np.cumsum(mass))
    contacts = Contacts.at_rest(constant, np.where(constant > 0, carried, 0), Long(chain.exponent))  # type: ignore[arg-type]
    mobility = np.where(np.arange(chain.grains) < chain.movable, 1 / mass, 0)
    u, v = (x.astype(Long) for x in scene.initial())
    h = Long(scene.duration) / steps
    kept = [(u, v)]

    def acceleration(u: NDArray[Any]) -> NDArray[Any]:
        return -np.diff(contacts.force_change(contacts.closer(u))) * mobility

    push = acceleration(u)
    for step in range(1, steps + 1):
        for kick, drift in zip(splitting.kicks, splitting.drifts, strict=False):
            v = v + kick * h * push
            u = u + drift * h * v
            push = acceleration(u)
        v = v + splitting.kicks[-1] * h * push
        if step % (steps // (scene.samples - 1)) == 0:
            kept.append((u, v))
    return tuple(np.array(x, dtype=float) for x in zip(*kept, strict=True))  # type: ignore[return-value]
