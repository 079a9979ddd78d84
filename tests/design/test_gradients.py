"""Gradients against the linear propagator, tangents, and runs at higher accuracy."""

from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import scene_of
from scipy.linalg import expm, expm_frechet

from lmpchain import Chain, Drive, Impulse, InputError, Profile, Scene
from lmpchain.design import (
    KineticEnergy,
    Momentum,
    PeakForce,
    Traces,
    gradient,
    parameters,
)
from lmpchain.design.gradients import at_step
from lmpchain.design.unknowns import Problem
from lmpchain.errors import RunFailed
from lmpchain.integrators.adjoint import DifferentiableRun, economise
from lmpchain.integrators.methods import SPLITTINGS


def drawn(seed: int) -> Scene:
    """Draw a scene with contact openings, and any exponent, ends, excitation and grains."""
    rng = np.random.default_rng(seed)
    while True:
        try:
            return draw(rng)
        except InputError:  # The strike is beyond Hertz's law.
            continue


def draw(rng: np.random.Generator) -> Scene:
    grains = int(rng.integers(3, 9))
    vacuum = rng.random() < 0.25
    top = "wall" if rng.random() < 0.4 else "free"
    chain: dict[str, Any] = {
        "grains": grains,
        "material": str(rng.choice(["glass", "steel", "ptfe"])),
        "diameter": rng.uniform(0.7, 1.3, grains) * 2e-3,
        "exponent": float(rng.choice([1.5, 1.5, 1.5, 1.0, 2.0, 3.0, rng.uniform(1.05, 3)])),
        "gravity": 0.0 if vacuum or rng.random() < 0.3 else rng.uniform(1, 100),
        "top": top,
        "bottom": str(rng.choice(["free", "fixed", "wall"] if vacuum else ["fixed", "wall"])),
    }
    if not vacuum and (chain["gravity"] == 0 or rng.random() < 0.5):
        chain["top_load"] = rng.uniform(0.01, 1)
    if top == "wall" and rng.random() < 0.5:
        chain["top_material"] = "brass"
    if rng.random() < 0.2:
        chain["masses"] = rng.uniform(1, 3, grains) * 1e-5
    if rng.random() < 0.2:
        chain["contact_constants"] = (
            rng.uniform(1, 3, grains - 1) * Chain(**chain).contact_constants[0]
        )
    made = Chain(**chain)
    scale = made.contacts.overlap.max() or 1e-7
    omega = made.band_edge or float(
        np.sqrt(
            made.contacts.stiffness_at(np.full(grains + 1, scale)).max() * 4 / made.masses.min()
        )
    )
    duration = 12 / omega
    # Contacts in a vacuum start exactly at their opening.
    if top == "free" and not vacuum and rng.random() < 0.4:
        time = np.linspace(0, duration, 6)
        shape = 2 * scale * np.sin(np.linspace(0, 3, 6)) ** 2
        sampled = rng.random() < 0.5
        what: Any = (
            Drive(times=time, displacement=shape, interpolation="linear")
            if sampled
            else Drive(amplitude=2 * scale, frequency=omega / 10)
        )
    else:
        still = made.movable < grains
        u, v = rng.uniform(-1, 1, (2, grains)) * [[0.5 * scale], [2 * scale * omega]]
        # No contact is exactly at its opening at t = 0.
        u -= np.linspace(0, 0.7 * scale * grains, grains) * vacuum
        if still:
            u[-1] = v[-1] = 0
        what = Profile(displacement=u, velocity=v)
    return Scene(chain=made, excitation=what, duration=duration, samples=7)


def propagator(
    scene: Scene, masses: np.ndarray, constants: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the generator of the linear chain and its propagator over the duration, (2N, 2N)."""
    chain = scene.chain
    n = masses.size
    carried = chain.top_load + chain.gravity * np.cumsum(masses)[:-1]
    k = chain.exponent * constants ** (1 / chain.exponent) * carried ** (1 - 1 / chain.exponent)
    stiffness = np.diag(np.append(k, 0)) + np.diag(np.append(0, k)) - np.diag(k, 1) - np.diag(k, -1)
    slope = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-stiffness / masses[:, None], np.zeros((n, n))]]
    )
    slope[n - 1] = slope[-1] = 0  # Grain N is fixed.
    return slope, expm(slope * scene.duration)


def test_weak_waves_have_the_derivatives_of_the_linear_propagator():
    n = 6
    chain = Chain(grains=n, diameter=np.linspace(1e-3, 1.3e-3, n), top_load=0.05)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-16), duration=3e-5, samples=2)
    objective = Momentum([3])
    found = at_step(
        scene,
        objective,
        ["masses", "contact_constants", "top_load", "velocity"],
        SPLITTINGS["kahan-li8"],
        1e-7,
    )
    value, gradients, _ = found
    start = np.concatenate(scene.initial())
    slope = propagator(scene, chain.masses, chain.contact_constants)[0]

    def derivative(masses: np.ndarray, constants: np.ndarray) -> float:
        """Return the directional derivative of grain 3's velocity by Frechet's formula."""
        carried = chain.contacts.force[1:-1]
        growth = (
            constants / chain.contact_constants / 1.5 + 9.81 * np.cumsum(masses)[:-1] / carried / 3
        )
        k = chain.linear_stiffness * growth
        change = np.zeros((2 * n, 2 * n))
        change[n:, :n] = (
            np.diag(k, 1) + np.diag(k, -1) - np.diag(np.append(k, 0)) - np.diag(np.append(0, k))
        )
        change[n:] /= chain.masses[:, None]
        change[n:] -= slope[n:] * (masses / chain.masses)[:, None]
        change[-1] = 0
        unit = np.append(np.ones(n), np.full(n, 1 / chain.band_edge))  # Scales.
        scaled = [unit[:, None] * matrix * scene.duration / unit for matrix in (slope, change)]
        moved = expm_frechet(*scaled, compute_expm=False) / unit[:, None] * unit
        return float((moved @ start)[n + 2])

    end = propagator(scene, chain.masses, chain.contact_constants)[1] @ start
    m = chain.masses[2]
    assert value == pytest.approx(m * end[n + 2], rel=1e-12)
    by_mass = np.array([m * derivative(e, np.zeros(n - 1)) + e[2] * end[n + 2] for e in np.eye(n)])
    by_constant = np.array([m * derivative(np.zeros(n), e) for e in np.eye(n - 1)])
    np.testing.assert_allclose(
        gradients["masses"], by_mass, rtol=0, atol=1e-12 * np.abs(by_mass).max()
    )
    np.testing.assert_allclose(
        gradients["contact_constants"], by_constant, rtol=0, atol=1e-12 * np.abs(by_constant).max()
    )
    by_velocity = m * propagator(scene, chain.masses, chain.contact_constants)[1][n + 2, n:]
    by_velocity[-1] = 0
    np.testing.assert_allclose(
        gradients["velocity"], by_velocity, rtol=0, atol=1e-12 * np.abs(by_velocity).max()
    )


@pytest.mark.parametrize(
    ("velocity", "struck", "options"),
    [
        (1e-2, 1, {}),
        (1e-2, 899, {}),
        (1e-2, 899, {"top_load": 1.0}),
        (1.8e-2, 1, {"top_load": 1.0}),
        (3e-4, 899, {"top_load": 1.0}),
        (1e-4, 899, {"top_load": 1.0}),
        (1e-9, 1, {}),
        pytest.param(1e-9, 899, {"exponent": 1.05}, marks=pytest.mark.slow),
        (1e-8, 1, {"exponent": 2.5}),
        (1e-6, 899, {"exponent": 2.5}),
        (1e-2, 1, {"gravity": 0}),
        (1e-2, 10, {"gravity": 0}),
        (1e-2, 1, {"gravity": 0, "exponent": 2.5}),
    ],
)
def test_adjoints_of_long_chains_agree_with_tangents(
    rng: np.random.Generator, velocity: float, struck: int, options: dict[str, float]
):
    """Windows grow or form tiles, for every law and both ways of undoing rows."""
    start = np.zeros(900)
    start[:struck] = velocity * rng.uniform(0.5, 1, struck)
    scene = scene_of(Chain(grains=900, diameter=1e-3, **options), Profile(velocity=start), 2e-4)
    run = DifferentiableRun(
        scene,
        SPLITTINGS["rkn4"],
        0.3 / scene.highest_frequency,
        20,
        np.array([1, 2, 150, 400, 800]),
    )
    weights = rng.standard_normal((2, *run.velocity.shape))
    weights[0] *= scene.highest_frequency
    inputs = run.pull(*weights)
    for name in ("masses", "contact_constants", "velocity"):
        back = parameters.pull(scene, inputs, name)
        change = np.zeros((1, back.size))
        change[0, :-1] = rng.standard_normal(back.size - 1)
        u, v = run.push(parameters.push(scene, name, change))
        terms = np.array([weights[0] * u[0], weights[1] * v[0]])
        assert abs(terms.sum() - change[0] @ back) <= 1e-12 * np.abs(terms).sum(), name


@pytest.mark.parametrize("exponent", [0.05, 0.5, 0.75, 1.0, 1.5, 2.0])
@pytest.mark.parametrize(("reach", "terms"), [(0.0, 4), (1e-5, 4), (1e-4, 4), (1e-3, 6), (5e-3, 6)])
def test_few_terms_give_every_digit_of_weak_waves(exponent: float, reach: float, terms: int):
    found = economise(exponent, reach)
    s = np.linspace(-1, 1, 42, dtype=np.longdouble) * max(reach, 1e-15)
    true = np.expm1(exponent * np.log1p(s)) / s
    assert found.size == terms or exponent in (1.0, 2.0)  # Fewer terms are exact.
    assert np.abs(np.polynomial.polynomial.polyval(s, found) - true).max() < 3e-16 * exponent


@pytest.mark.parametrize("seed", [0, 3])  # Exponents 1.5 and 1.8.
def test_adaptive_steps_keep_the_order_where_contacts_open(seed: int):
    """Gradients of adaptive steps converge in order where contacts open.

    The reference has very many equal steps. Four times as many equal steps as adaptive ones are
    fifty times less accurate.
    """
    scene = drawn(seed)
    objective = Momentum([2])
    names = ["masses", "contact_constants"]
    step = 1 / scene.highest_frequency
    true = at_step(scene, objective, names, SPLITTINGS["rkn6"], step / 16384)[1]

    def off(length: float, adaptive: bool) -> float:
        found = at_step(scene, objective, names, SPLITTINGS["rkn6"], length, adaptive)[1]
        return max(
            np.abs(found[name] - true[name]).max() / np.abs(true[name]).max() for name in names
        )

    assert off(step / 8, True) < 5e-9
    assert off(step / 8, True) < 0.02 * off(step / 32, False)


def test_adaptive_steps_reach_a_tolerance_and_are_rejected_without_a_gain():
    scene = drawn(3)
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


@pytest.mark.parametrize("step", [-1e-7, 0.0, float("nan"), float("inf")])
def test_steps_that_are_none_are_refused(step: float):
    """A negative step was once treated as the longest possible one."""
    with pytest.raises(InputError, match="step: must be above 0"):
        gradient(drawn(3), Momentum([2]), ["masses"], step=step)


def test_steps_and_methods_that_cannot_work_are_refused():
    chain = Chain(
        grains=5, diameter=1e-3, gravity=0.0, top_load=1.0, exponent=3.0, top="wall", bottom="wall"
    )
    scene = scene_of(chain, Impulse(velocity=0.1), 2e-2, 3)
    for options, message in (
        ({"step": 1e-3}, r"^the motion breaks down with steps of 0\.002 s: use shorter ones"),
        ({"step": 1e-11}, r"^step: must be longer than 2e-11 s, because runs .* \(got 1e-11\)"),
        ({"integrator": "euler"}, r"^integrator: must be verlet \| .* \(got 'euler'\)"),
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
@pytest.mark.parametrize("seed", range(40))
def test_error_estimates_cover_the_errors_of_random_scenes(rng: np.random.Generator, seed: int):
    scene = drawn(seed)
    while scene.chain.exponent == 1.0:  # For exponent 1, estimates are only of first order.
        scene = drawn(seed := seed + 1000)
    contact = int(rng.choice(np.flatnonzero(scene.chain.contacts.exists)))
    objective = [PeakForce(contact), KineticEnergy([1, 2]), Momentum([2])][seed % 3]
    method = "rkn4" if objective.dense else "rkn6"
    names = ["masses", "contact_constants"]
    found = gradient(scene, objective, names, 1e-3, method)
    true = gradient(scene, objective, names, 1e-5, method)
    for name in names:
        assert np.abs(found[name] - true[name]).max() <= found.errors[name] + true.errors[name], (
            name
        )
    assert abs(found.value - true.value) <= found.value_error + true.value_error
