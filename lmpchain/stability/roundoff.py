"""Rounding floor of double precision: its law, and its measurement by runs in long double."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..chain.contact_law import Contacts, PowerForce
from ..chain.equilibrium import force_at_rest
from ..engines import Lammps, Native
from ..engines.stepping.time_stepping import TimeSteppingEngine
from ..errors import InputError, not_among
from ..integrators.methods import RKN6, Splitting
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..util.arrays import Array

Long = np.longdouble
STEP = 0.3  # Value of omega h for rkn6 at which its truncation error is about 1e-9.


def floor(
    scene: Scene, engine: str = "native", diameter: str = "physical", force: str = "auto"
) -> float:
    """Predict the relative rounding error for steps of rkn6 with omega h = 0.3.

    Each engine has its own law, its method `typical_round_off`. The laws were compared with 70
    random scenes over 13 decades, with LAMMPS for both diameters: half of the measured floors agree
    within a factor of 1.7, and nine in ten within a factor of 6
    (analysis/calibration/roundoff.py).

    Parameters
    ----------
    scene : Scene
        The scene to solve.
    engine : "native" or "lammps"
        Name of the engine.
    diameter : "physical" or "gauge"
        Option of the engine "lammps".
    force : "auto", "exact" or "plain"
        Option of the engine "native".

    Returns
    -------
    float
        Relative rounding error.

    Raises
    ------
    InputError
        If the engine or an option is unknown, or the chain has damping.
    """
    scene.chain.refuse_damping("the law of round-off")
    cone = scene.reached
    solver = _engine(engine, diameter, force)
    return solver.typical_round_off(cone, _steps(cone), _speed(cone))


def long_double(scene: Scene) -> tuple[Array, Array]:
    """Return the displacement and velocity of the light cone, (T, N) m and m/s, in long double.

    Parameters
    ----------
    scene : Scene
        The scene to solve.

    Returns
    -------
    displacement : (T, N) array
        Displacements, m.
    velocity : (T, N) array
        Velocities, m/s.

    Raises
    ------
    InputError
        If the scene is forced or damped, or its chain has a ground or a law by formula.
    """
    cone = scene.reached
    return _integrate(cone, RKN6, _steps(cone))


def measured_floor(
    scene: Scene,
    engine: str = "native",
    diameter: str = "physical",
    force: str = "auto",
    exact: tuple[Array, Array] | None = None,
) -> float:
    """Measure the rounding floor of an engine against the same steps in NumPy's long double.

    The truncation error is equal in both runs, even if contacts open.

    Parameters
    ----------
    scene : Scene
        The scene to solve.
    engine : "native" or "lammps"
        Name of the engine.
    diameter : "physical" or "gauge"
        Option of the engine "lammps".
    force : "auto", "exact" or "plain"
        Option of the engine "native".
    exact : two (T, N) arrays, optional
        The result of `long_double(scene)`, if it is already known.

    Returns
    -------
    float
        Relative rounding error.

    Raises
    ------
    InputError
        If the engine or an option is unknown, if the scene is forced or damped, or if the engine
        cannot solve it.
    """
    _check_free(scene)
    cone = scene.ungathered.reached
    steps = _steps(cone)
    h = cone.duration / steps * (1 + 1e-9)
    run = simulate(cone, _engine(engine, diameter, force, h))
    assert run.cost.steps == steps
    true = exact or long_double(scene)
    columns = run.grains - 1
    return max(
        float(np.abs(x - y[:, columns]).max() / np.abs(y).max())
        for x, y in zip((run.displacement, run.velocity), true, strict=True)
    )


def _check_free(scene: Scene) -> None:
    """Raise `InputError` unless grains move by lossless contacts and gravity alone."""
    _speed(scene)
    scene.chain.refuse_damping("measured round-off")
    scene.chain.refuse_ground("measured round-off")
    if scene.excitation.does_work:
        raise InputError.at("kind", "the rounding floor cannot be measured for a forced scene")


def _engine(
    engine: str, diameter: str, force: str, step: float | None = None
) -> TimeSteppingEngine:
    for key, value, allowed in (
        ("engine", engine, ("native", "lammps")),
        ("diameter", diameter, ("physical", "gauge")),
    ):
        if value not in allowed:
            raise InputError.at(key, not_among(value, allowed))
    if engine == "native":
        return Native("rkn6", step, force=force)
    return Lammps("rkn6", step, diameter)


def _steps(scene: Scene) -> int:
    """Return the number of steps with omega h = 0.3 for a scene."""
    return scene.intervals * math.ceil(scene.sampling_phase / STEP)


def _speed(scene: Scene) -> float:
    """Return an estimate of the largest velocity, m/s."""
    u, v = scene.imposed
    if not (u or v or scene.chain.compressed):
        raise InputError.at("excitation", "does not move the chain: strike or displace a grain")
    return max(v, u * scene.highest_frequency) or scene.chain.length_scale / scene.chain.time_scale


def _integrate(scene: Scene, splitting: Splitting, steps: int) -> tuple[Array, Array]:
    """Return the displacement and velocity, (T, N) m and m/s, by a splitting in long double."""
    _check_free(scene)
    chain = scene.chain
    mass = chain.masses.astype(Long)
    constant: Any = chain.contacts.constant.astype(Long)
    weight = Long(chain.gravity) * np.cumsum(mass)
    carried = force_at_rest(weight, chain.top_load, chain.load_grain)
    # For other contact laws, changes of forces are only computed in double precision.
    exponent: Any = Long(chain.law.power_of("measured round-off"))
    law = PowerForce(exponent)
    contacts = Contacts.at_rest(constant, np.where(constant > 0, carried, 0), law)
    mobility = np.where(np.arange(chain.grains) < chain.movable, 1 / mass, 0)
    u, v = (x.astype(Long) for x in scene.initial())
    h = Long(scene.duration) / steps
    samples = [(u, v)]

    def acceleration(u: NDArray[Any]) -> NDArray[Any]:
        return -np.diff(contacts.force_change(contacts.closer(u))) * mobility

    push = acceleration(u)
    for step in range(1, steps + 1):
        for kick, drift in zip(splitting.kicks, splitting.drifts, strict=False):
            v = v + kick * h * push
            u = u + drift * h * v
            push = acceleration(u)
        v = v + splitting.kicks[-1] * h * push
        if step % (steps // scene.intervals) == 0:
            samples.append((u, v))
    displacement, velocity = zip(*samples, strict=True)
    return np.array(displacement, dtype=float), np.array(velocity, dtype=float)
