"""Dissipated energy and work of linear runs, against quadrature and the balance of energy."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import scene_of
from scipy.integrate import cumulative_simpson

from lmpchain import Chain, Drive, Force, Impulse, Law, Scene, simulate
from lmpchain.engines import Modes
from lmpchain.engines.base import ErrorBudget
from lmpchain.engines.linear.solutions import GAUSS_NODES, sum_energies

pytestmark = pytest.mark.filterwarnings("ignore:Eq. ", "ignore:chain.damping")
# Springs that stay closed are linear.
SPRINGS: dict[str, Any] = {
    "grains": 4,
    "diameter": 1e-3,
    "exponent": 1.0,
    "gravity": 0.0,
    "top_load": 1.0,
    "bottom": "wall",
    "masses": np.array([1.0, 2.0, 1.5, 3.0]) * 1e-6,
}
EDGE = Chain(**SPRINGS).band_edge
HZ = EDGE / (2 * np.pi)
BOTH = {"viscoelastic": 0.03 / EDGE, "drag": 0.02 * EDGE}
SLOW = {"viscoelastic": 6.0 / EDGE, "drag": 0.5 * EDGE}
CASES: dict[str, tuple[dict[str, Any], Any]] = {
    "viscous": ({"damping": {"viscoelastic": 0.1 / EDGE}}, Impulse(velocity=1e-3, grain=2)),
    "drag": ({"damping": {"drag": 0.1 * EDGE}}, Impulse(velocity=1e-3)),
    "overdamped": ({"damping": SLOW}, Impulse(velocity=1e-3, grain=3)),
    "on the ground": (
        {"damping": {"drag": 0.05 * EDGE}, "ground": Law("s*u", s=2e5)},
        Drive(amplitude=1e-9, frequency=0.3 * HZ),
    ),
    "force": ({"damping": BOTH}, Force(grain=3, amplitude=1e-3, frequency=0.3 * HZ)),
    "burst": ({"damping": BOTH}, Force(grain=2, amplitude=1e-3, frequency=0.5 * HZ, cycles=2)),
    "drive": ({"damping": BOTH}, Drive(amplitude=1e-9, frequency=0.3 * HZ)),
    "tone": ({"damping": BOTH}, Drive(amplitude=1e-9, frequency=0.3 * HZ, cycles=3)),
    "wall": ({"damping": BOTH, "top": "wall"}, Drive(grain=0, amplitude=1e-9, frequency=0.3 * HZ)),
}
FINE = 4000  # A multiple of 8.


def scene_for(kind: str) -> Scene:
    changes, excitation = CASES[kind]
    return scene_of(Chain(**SPRINGS | changes), excitation, 35 / EDGE, 9)


def fine_motion(kind: str) -> tuple[Scene, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the scene, and the approach, closing speed, displacement and velocity at fine times.

    The contacts begin above grain 1 and end at the wall below, (T, N + 1).
    """
    scene = scene_for(kind)
    fine = simulate(scene.replace(samples=FINE + 1), "modes", 0.9)
    u, v, still = fine.displacement, fine.velocity, 0 * fine.time[:, None]
    wall = scene.excitation.wall
    top = [wall.at(fine.time, order)[:, None] for order in (0, 1)] if wall else [still, still]
    closer, closing = (
        -np.diff(np.hstack((above, x, still)), axis=1) for above, x in zip(top, (u, v), strict=True)
    )
    return scene, closer, closing, u, v


def dampers(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return stiffnesses and viscosities of contacts, and friction of grains that may move."""
    chain = scene.chain
    stiffness = chain.contacts.stiffness
    viscosity = stiffness * float(chain.damping.viscoelastic)
    friction = chain.masses * float(chain.damping.drag)
    # The drag on a driven grain is work that neither energy includes.
    friction[: scene.excitation.driven] = 0.0
    return stiffness, viscosity, friction


@pytest.mark.parametrize("kind", CASES)
def test_energies_are_integrals_of_the_powers(kind: str) -> None:
    """The work is the change of kinetic and elastic energy plus the loss."""
    scene, closer, closing, u, v = fine_motion(kind)
    stiffness, viscosity, friction = dampers(scene)
    chain = scene.chain
    lost = cumulative_simpson(
        closing**2 @ viscosity + v**2 @ friction, dx=scene.duration / FINE, initial=0
    )
    stored = (v**2 @ chain.masses + closer**2 @ stiffness) / 2
    if chain.ground is not None:
        stored += (u**2).sum(1) * 2e5 / 2
    work = stored - stored[0] + lost
    shown = slice(None, None, FINE // 8)
    energies = simulate(scene, "modes", 1e-9).gathered
    put_in = max(stored.max(), lost.max())
    # The fast decay limits the accuracy of Simpson's rule.
    within = 1e-6 if kind == "overdamped" else 1e-8
    assert lost[-1] > 0.05 * put_in
    assert np.abs(energies["dissipated"] - lost[shown]).max() < within * put_in
    assert energies["dissipated_error"] < 1e-9 * put_in
    if scene.excitation.does_work:
        assert np.abs(energies["drive"] - work[shown]).max() < within * put_in
        assert energies["drive_error"] < 1e-9 * put_in
    else:
        assert "drive" not in energies
    if kind == "overdamped":
        # If the solution is inaccurate, the quadrature of the first fast decay may be so, too.
        solve = partial(Modes().solve, scene, {})
        rough = sum_energies(scene, solve, ErrorBudget(1e-2, 0.0, 1.0), np.zeros(2), 10**6)
        off = np.abs(rough["dissipated"] - lost[shown]).max()
        assert off <= rough["dissipated_error"] < 0.2 * put_in
        assert rough["dissipated_error"] > 1e-6 * put_in


@pytest.mark.parametrize("kind", [kind for kind in CASES if kind != "overdamped"])
def test_an_error_of_the_solution_causes_errors_of_energies(kind: str) -> None:
    """Each velocity may be wrong by dv, and each approach by twice the error of a displacement."""
    scene, _, closing, u, v = fine_motion(kind)
    stiffness, viscosity, friction = dampers(scene)
    budget = ErrorBudget(6e-4, 1e-4, 1.0, model=3e-4)
    scale = np.array([np.abs(u).max(), np.abs(v).max()])
    du, dv = 1e-3 * scale
    solve = partial(Modes().solve, scene, {})
    count = int(np.ceil(max(EDGE, scene.linear_frequency) * scene.duration / 10))
    energies = sum_energies(scene, solve, budget, scale, 100 * GAUSS_NODES.size)
    loss = ((np.abs(closing) + 2 * dv) ** 2 - closing**2) @ viscosity
    loss += ((np.abs(v) + dv) ** 2 - v**2) @ friction
    h = scene.duration / FINE
    assert energies["dissipated_error"] == pytest.approx(np.trapezoid(loss, dx=h), rel=2e-3)
    excitation = scene.excitation
    if excitation.does_work:
        time = np.linspace(0, scene.duration, FINE + 1)
        assert excitation.waveform
        if excitation.driven or excitation.wall:
            contact = excitation.driven
            off = 2 * stiffness[contact] * du + 2 * viscosity[contact] * dv
            off += 2e5 * du if scene.chain.ground is not None else 0.0
            power = np.abs(excitation.waveform.at(time, 1)) * off
        else:
            power = np.abs(excitation.waveform.at(time)) * dv
        expected = np.trapezoid(power, dx=h)
        assert energies["drive_error"] == pytest.approx(expected, rel=2e-3)
    # A quadrature of more than the largest number of evaluations is left out.
    assert not sum_energies(scene, solve, budget, scale, count * GAUSS_NODES.size - 1)
    free = scene.replace(chain=scene.chain.replace(damping=None))
    assert not sum_energies(free, solve, budget, scale, 10**6)
