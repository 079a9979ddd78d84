"""Gradients against the linear propagator, tangents, and runs at higher accuracy."""

from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import random_scene, scene_of, struck, struck_in_units
from scipy.linalg import expm

from lmpchain import Chain, Impulse, InputError, Profile, Scene
from lmpchain.design import (
    KineticEnergy,
    Momentum,
    PeakForce,
    Traces,
    gradient,
)
from lmpchain.design.gradients import at_step
from lmpchain.design.unknowns import Problem
from lmpchain.errors import RunFailed
from lmpchain.integrators.methods import SPLITTINGS


def opening(exponent: float = 1.5) -> Scene:
    """Return a strike on a short column whose contacts open."""
    return struck_in_units(column(5, bottom="wall", exponent=exponent), 3.0, 12.0, 7)


def test_weak_waves_have_the_derivatives_of_the_linear_propagator():
    """A complex step through the matrix exponential gives the exact derivatives."""
    n = 6
    chain = Chain(grains=n, diameter=np.linspace(1e-3, 1.3e-3, n), top_load=0.05)
    scene = struck(chain, 1e-16, 3e-5, 2)

    def momentum(masses: Any, constants: Any, load: Any, velocity: Any) -> Any:
        """Return the final momentum of grain 3, with the duration as the unit of time."""
        k = 1.5 * constants ** (2 / 3) * (load + 9.81 * np.cumsum(masses)[:-1]) ** (1 / 3)
        k = k * scene.duration**2
        stiffness = np.diag(np.append(k, 0)) + np.diag(np.append(0, k))
        stiffness = (stiffness - np.diag(k, 1) - np.diag(k, -1)) / masses[:, None]
        slope = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, np.zeros((n, n))]])
        slope[n - 1] = slope[-1] = 0  # Grain N is fixed.
        return masses[2] * (expm(slope) @ np.append(np.zeros(n), velocity))[n + 2]

    at = {
        "masses": chain.masses,
        "contact_constants": chain.contact_constants,
        "top_load": np.array([0.05]),
        "velocity": scene.initial()[1],
    }
    method = SPLITTINGS["kahan-li8"]
    value, gradients, _ = at_step(scene, Momentum([3]), at, method, 1e-7)
    assert value == pytest.approx(momentum(*at.values()), rel=1e-12)
    for name, base in at.items():
        size = 1e-20 * base.max()
        steps = [at | {name: base + 1j * size * entry} for entry in np.eye(base.size)]
        true = np.array([momentum(*step.values()).imag for step in steps]) / size
        if name == "velocity":
            true[-1] = 0
        np.testing.assert_allclose(gradients[name], true, rtol=0, atol=1e-12 * np.abs(true).max())


@pytest.mark.parametrize("exponent", [1.5, 1.8])
def test_adaptive_steps_keep_the_order_where_contacts_open(exponent: float):
    """Gradients of adaptive steps converge in order where contacts open.

    The reference has very many equal steps. Four times as many equal steps as adaptive ones are
    fifty times less accurate.
    """
    scene = opening(exponent)
    objective = Momentum([2])
    names = ["masses", "contact_constants"]
    step = 1 / scene.highest_frequency
    true = at_step(scene, objective, names, SPLITTINGS["rkn6"], step / 6144)[1]

    def off(length: float, adaptive: bool) -> float:
        found = at_step(scene, objective, names, SPLITTINGS["rkn6"], length, adaptive)[1]
        return max(
            np.abs(found[name] - true[name]).max() / np.abs(true[name]).max() for name in names
        )

    assert off(step / 8, True) < 5e-9
    assert off(step / 8, True) < 0.02 * off(step / 32, False)


def test_adaptive_steps_reach_a_tolerance_and_are_rejected_without_a_gain():
    scene = opening()
    names = ["masses"]
    found = gradient(scene, Momentum([2]), names, 1e-6, adaptive=True)
    true = at_step(scene, Momentum([2]), names, SPLITTINGS["rkn6"], 1e-4 / scene.highest_frequency)[
        1
    ]
    assert np.abs(found["masses"] - true["masses"]).max() <= found.errors["masses"]
    assert (len(found), list(found)) == (1, names)
    with pytest.raises(InputError, match="adaptive"):
        gradient(scene, Momentum([2]), names, integrator="verlet", adaptive=True)


@pytest.mark.parametrize(
    ("grains", "name", "exponent"),
    [(21, "top_load", 1.5), (41, "top_load", 2.0), (20, "gravity", 1.0)],
)
def test_derivatives_that_are_zero_are_known_to_round_off(grains: int, name: str, exponent: float):
    """By mirror symmetry the middle grain rests under any load, and springs move alike."""
    chain = Chain(
        grains=grains,
        diameter=1e-3,
        gravity=0 if name == "top_load" else 9.81,
        top_load=0.1,
        top="wall",
        bottom="wall",
        exponent=exponent,
    )
    velocity = np.zeros(grains)
    middle = grains // 2
    velocity[[middle - 1, middle + 1]] = 1e-3, -1e-3
    still = Profile(displacement=np.zeros(grains), velocity=velocity)
    objective = Momentum([middle + 1]) if name == "top_load" else KineticEnergy([5])
    scene = Scene(chain=chain, excitation=still, duration=1e-5, samples=31)
    found = gradient(scene, objective, [name], 1e-9)
    # Size of the sum: the largest term of a contact over load or gravity, times the number of
    # contacts.
    scale = chain.masses[0] * (1e-3 if name == "top_load" else 1e-6) / getattr(chain, name)
    assert np.abs(found[name]).max() <= found.errors[name] <= 1e-13 * grains * scale
    assert found.error <= 1e-9


def test_steps_and_methods_that_cannot_work_are_refused():
    chain = Chain(
        grains=5, diameter=1e-3, gravity=0.0, top_load=1.0, exponent=3.0, top="wall", bottom="wall"
    )
    scene = scene_of(chain, Impulse(velocity=0.1), 2e-2, 3)
    for options, message in (
        ({"step": 1e-3}, r"^the motion breaks down with steps of 0\.002 s: use shorter ones"),
        ({"step": 1e-11}, r"^step: must be longer than 2e-11 s, because runs .* \(got 1e-11\)"),
        ({"integrator": "euler"}, r"^integrator: must be verlet \| .* \(got 'euler'\)"),
        # A negative step was once treated as the longest possible one.
        ({"step": -1e-7}, "^step: must be above 0"),
        ({"step": 0.0}, "^step: must be above 0"),
        ({"step": np.nan}, "^step: must be above 0"),
        ({"step": np.inf}, "^step: must be above 0"),
    ):
        with pytest.raises((InputError, RunFailed), match=message):
            gradient(scene, Momentum([2]), ["masses"], **options)
    problem = Problem(scene, [Traces(scene.time, [1], np.zeros(3))], {"masses": "common"})
    problem.looks = 20
    with pytest.raises(RunFailed, match=r"^the motion breaks down with steps of 0\.001 s"):
        problem.residuals(np.zeros(1))


def test_two_steps_that_agree_by_chance_are_no_bound():
    """Agreement of the gradients at h and 2h does not prove that they are accurate.

    With an opening, they are ten times closer to each other than to the true gradient.
    """
    chain = Chain(
        grains=2, material="steel", diameter=[0.00071311, 0.0009818], gravity=64.1506, bottom="wall"
    )
    scene = scene_of(chain, Impulse(velocity=5.12645e-3), 7.837051229587563e-6, 3)
    step = 0.4 / scene.highest_frequency
    names = ["masses"]
    method = SPLITTINGS["rkn6"]
    found = gradient(scene, Momentum([1]), names, integrator="rkn6", step=step)
    twice = at_step(scene, Momentum([1]), names, method, 2 * found.step_s)[1]["masses"]
    true = at_step(scene, Momentum([1]), names, method, step / 1024)[1]["masses"]
    off = np.abs(found["masses"] - true).max()
    assert np.abs(found["masses"] - twice).max() < off / 10
    assert off <= found.errors["masses"] < 0.03 * np.abs(true).max()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(11))
def test_error_estimates_cover_the_errors_of_random_scenes(rng: np.random.Generator, seed: int):
    # For springs that open, errors are of first order in the step.
    scene = random_scene(rng, (1.25, 1.5, 1.5, 2.0, 3.0))
    contact = int(rng.choice(np.flatnonzero(scene.chain.contacts.exists)))
    objective = [PeakForce(contact), KineticEnergy([1, 2]), Momentum([2])][seed % 3]
    method = "rkn4" if objective.dense else "rkn6"
    names = ["masses", "contact_constants"]
    found = gradient(scene, objective, names, 1e-3, method)
    true = gradient(scene, objective, names, 1e-5, method)
    for name in names:
        off = np.abs(found[name] - true[name]).max()
        assert off <= found.errors[name] + true.errors[name], name
    assert abs(found.value - true.value) <= found.value_error + true.value_error
