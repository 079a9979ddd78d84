"""The chain at rest, its band edge and its energy, against formulas and methods that the package does not use."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from lmpchain import BRASS, GLASS, PTFE, STEEL, TUNGSTEN_CARBIDE, Chain, Impulse, InputError, Material, Scene, simulate

RNG = np.random.default_rng(7)
DISORDERED = Chain(
    grains=30,
    material=[GLASS, STEEL, PTFE] * 10,
    diameter=RNG.uniform(0.5e-3, 2e-3, 30),
    gravity=3.7,
    top_load=1e-4,
)
CHAINS = {
    "the paper's": Chain(grains=120, diameter=1e-3),
    "disordered": DISORDERED,
    "loaded and free of gravity": Chain(grains=25, material=STEEL, diameter=5e-3, gravity=0.0, top_load=1.0),
    "softer exponent": Chain(grains=40, diameter=1e-3, exponent=1.2),
    "harder exponent": Chain(grains=40, diameter=1e-3, exponent=2.7),
    "springs": Chain(grains=40, diameter=1e-3, exponent=1.0),
    "two grains": Chain(grains=2, diameter=1e-3),
    "own masses and constants": Chain(
        grains=4, diameter=1e-3, masses=[1e-6, 3e-6, 2e-6, 1e-6], contact_constants=[1e9, 3e9, 2e9]
    ),
}
each_chain = pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)


def test_the_chain_of_the_paper():
    chain = Chain(grains=120, material=GLASS, diameter=1e-3)
    gamma = 62e9 * np.sqrt(1e-3) / (3 * (2426 * np.pi / 6 * 1e-9) * (1 - 0.2**2))
    assert gamma == pytest.approx(5.3593e14, rel=1e-5)
    assert chain.contact_constants / chain.masses[:-1] == pytest.approx(gamma, rel=1e-14)
    n = np.arange(1, 120)
    assert chain.equilibrium_overlap == pytest.approx((9.81 * n / gamma) ** (2 / 3), rel=1e-14)
    assert chain.length_scale == pytest.approx(6.9456e-10, rel=1e-5)
    assert 1 / chain.time_scale == pytest.approx(1.45555e5, rel=1e-5)
    omega = np.sqrt(9.81 * 1.5) * (gamma / 9.81) ** (1 / 3)
    assert 1 / chain.time_scale == pytest.approx(omega, rel=1e-14)
    assert chain.linear_stiffness / chain.masses[0] / omega**2 == pytest.approx(n ** (1 / 3), rel=1e-13)


@pytest.mark.parametrize("exponent", [1.0, 1.2, 1.5, 2.0, 3.0])
def test_contact_constant_for_any_exponent(exponent: float):
    """K = (4/3) E* sqrt(R*) dbar^(1.5 - delta) with everything from the two grains of the contact."""
    chain = Chain(grains=3, material=[GLASS, STEEL, PTFE], diameter=[1e-3, 2e-3, 5e-3], exponent=exponent)
    for n in (0, 1):
        one, other = chain.material[n], chain.material[n + 1]
        r1, r2 = chain.diameters[n] / 2, chain.diameters[n + 1] / 2
        soft = (1 - one.poissons_ratio**2) / one.youngs_modulus + (1 - other.poissons_ratio**2) / other.youngs_modulus
        expected = 4 / 3 / soft * np.sqrt(r1 * r2 / (r1 + r2)) * (r1 + r2) ** (1.5 - exponent)
        assert chain.contact_constants[n] == pytest.approx(expected, rel=1e-14)
    assert chain.masses == pytest.approx(
        [m.density * np.pi * d**3 / 6 for m, d in zip(chain.material, [1e-3, 2e-3, 5e-3], strict=True)], rel=1e-14
    )


def test_uniform_is_the_same_as_all_equal():
    one = Chain(grains=5, material="steel", diameter=1e-3)
    many = Chain(grains=5, material=[STEEL] * 5, diameter=[1e-3] * 5)
    assert np.array_equal(one.masses, many.masses)
    assert np.array_equal(one.equilibrium_overlap, many.equilibrium_overlap)


@each_chain
def test_forces_balance_at_rest(chain: Chain):
    force = chain.contact_constants * chain.equilibrium_overlap**chain.exponent
    above = np.append(chain.top_load, force[:-1])
    assert force - above == pytest.approx(chain.masses[:-1] * chain.gravity, rel=1e-9, abs=1e-14 * force.max())
    assert chain.equilibrium_force == pytest.approx(force, rel=1e-14)


@each_chain
def test_stiffness_is_the_slope_of_the_force(chain: Chain):
    def force(overlap: np.ndarray) -> np.ndarray:
        return chain.contact_constants * overlap**chain.exponent

    h = 1e-4
    eps = chain.equilibrium_overlap
    slope = (
        8 * (force(eps * (1 + h)) - force(eps * (1 - h))) - force(eps * (1 + 2 * h)) + force(eps * (1 - 2 * h))
    ) / (12 * h * eps)
    assert chain.linear_stiffness == pytest.approx(slope, rel=1e-10)


@each_chain
def test_band_edge_against_a_dense_eigensolver(chain: Chain):
    k, m, size = chain.linear_stiffness, chain.masses, chain.grains
    matrix = np.zeros((size, size))
    for n, stiffness in enumerate(k):
        matrix[n : n + 2, n : n + 2] += stiffness * np.array([[1, -1], [-1, 1]])
    moving = matrix[:-1, :-1]  # grain N is held
    highest = np.sqrt(np.linalg.eigvals(moving / m[:-1, None]).real.max())
    assert chain.band_edge == pytest.approx(highest, rel=1e-11)


def test_band_edge_of_a_free_pair_and_of_a_vacuum():
    springs = Chain(grains=2, diameter=1e-3, exponent=1.0, gravity=0.0, bottom="free")
    m, k = springs.masses[0], springs.contact_constants[0]
    assert springs.movable == 2
    assert springs.band_edge == pytest.approx(np.sqrt(2 * k / m), rel=1e-12)
    vacuum = Chain(grains=5, diameter=1e-3, gravity=0.0)
    assert vacuum.band_edge == 0
    assert vacuum.time_scale == np.inf
    assert not vacuum.compressed


def contact_energy(chain: Chain, n: int, r: float) -> float:
    """Work done on contact n beyond that of its force at rest, as its grains come closer by r, J."""
    eps, force, delta = chain.equilibrium_overlap[n], chain.equilibrium_force[n], chain.exponent

    def change(s: float) -> float:  # (1 + s)^delta - 1, without cancellation, -1 where open
        return np.expm1(delta * np.log1p(s)) if s > -1 else -1.0

    total, s = 0.0, r / eps
    edges = [0.0, -1.0, s] if s < -1 else [0.0, s]
    for a, b in pairwise(edges):
        total += quad(change, a, b, epsabs=0, epsrel=1e-13, limit=200)[0]
    return force * eps * total


@pytest.mark.parametrize("exponent", [1.0, 1.2, 1.5, 2.0, 2.7])
@pytest.mark.parametrize(
    "stretch", [-7.0, -1.5, -1.0, -0.999, -0.3, -0.0201, -0.0199, -1e-5, -1e-9, 1e-12, 1e-6, 0.0199, 0.0201, 0.5, 40.0]
)
def test_excess_energy_of_one_contact(exponent: float, stretch: float):
    chain = Chain(grains=3, diameter=1e-3, exponent=exponent)
    r = stretch * chain.equilibrium_overlap[0]
    u, v = np.array([r, 0.0, 0.0]), np.zeros(3)
    assert chain.excess_energy(u, v) == pytest.approx(contact_energy(chain, 0, r), rel=2e-11)


def test_excess_energy_of_a_chain():
    rng = np.random.default_rng(3)
    v = rng.normal(size=30) * 1e-4
    for size in (1e-6, 0.1, 3.0):
        u = rng.normal(size=30) * size * DISORDERED.length_scale
        closer = u[:-1] - u[1:]
        expected = sum(contact_energy(DISORDERED, n, r) for n, r in enumerate(closer))
        assert DISORDERED.excess_energy(u, 0 * v) == pytest.approx(expected, rel=1e-11)
        moving = expected + (DISORDERED.masses * v**2).sum() / 2
        assert DISORDERED.excess_energy(u, v) == pytest.approx(moving, rel=1e-11)


def test_excess_energy_in_the_vacuum():
    chain = Chain(grains=3, diameter=1e-3, gravity=0.0)
    k = chain.contact_constants[0]
    energies = chain.excess_energy(np.array([[1e-8, 0, 0], [-1e-8, 0, 0], [0, 1e-8, 0]]), np.zeros(3))
    assert energies.shape == (3,)
    assert energies == pytest.approx([0.4 * k * 1e-20, 0.0, 0.4 * k * 1e-20], rel=1e-12, abs=1e-40)


def test_minus_its_slope_is_the_force():
    """-dU/dx from differences is what the integrators push with."""
    chain, rng = DISORDERED, np.random.default_rng(5)
    u = rng.normal(size=30) * chain.length_scale
    overlap = np.maximum(chain.equilibrium_overlap + u[:-1] - u[1:], 0.0)
    contact = chain.contact_constants * overlap**chain.exponent
    push = np.append(chain.top_load, contact) + chain.masses * chain.gravity
    push[:-1] -= contact
    for n in (0, 11, 28):
        h = 1e-3 * chain.length_scale * np.eye(30)[n]
        energies = [float(chain.excess_energy(u + k * h, 0 * u)) for k in (-2, -1, 1, 2)]
        slope = (energies[0] - 8 * energies[1] + 8 * energies[2] - energies[3]) / (12 * h[n])
        assert -slope == pytest.approx(push[n], rel=1e-6, abs=1e-9 * contact.max())


def random_scene(rng: np.random.Generator) -> Scene:
    while True:
        grains = int(rng.integers(2, 15))
        exponent = float(rng.choice([1.0, 1.3, 1.5, 2.0]))
        gravity, load = float(rng.choice([0.0, 9.81, 500.0])), float(rng.choice([0.0, 1e-5, 1e-2]))
        chain = Chain(
            grains=grains,
            diameter=rng.uniform(0.5e-3, 2e-3, grains),
            gravity=gravity,
            top_load=load,
            exponent=exponent,
        )
        strike = Impulse(velocity=float(10 ** rng.uniform(-6, -1)), grain=int(rng.integers(1, grains)))
        try:
            return Scene(chain=chain, excitation=strike, duration=float(10 ** rng.uniform(-5, -4.4)), samples=101)
        except InputError:
            continue


def test_no_contact_exceeds_the_bound_on_its_overlap():
    rng = np.random.default_rng(11)
    closest = 0.0
    for _ in range(30):
        scene = random_scene(rng)
        chain = scene.chain
        run = simulate(scene, "native", 1e-4)
        overlap = chain.equilibrium_overlap + run.displacement[:, :-1] - run.displacement[:, 1:]
        used = overlap / chain.contacts.overlap_bound(scene.energy)[1:-1]
        assert used.max() <= 1 + 1e-4
        closest = max(closest, used.max())
    assert closest > 0.9  # the bound is not so wide that it says nothing


def test_the_bound_is_met_by_a_grain_thrown_at_the_held_one():
    chain = Chain(grains=2, diameter=1e-3, gravity=0.0)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-2), duration=2e-5, samples=2001)
    run = simulate(scene, "native", 1e-9)
    deepest = (1.25 * chain.masses[0] * 1e-4 / chain.contact_constants[0]) ** 0.4
    assert chain.contacts.overlap_bound(scene.energy)[1:-1] == pytest.approx(deepest, rel=1e-12)
    assert run.displacement[:, 0].max() == pytest.approx(deepest, rel=1e-5)


def test_equality():
    a = Chain(grains=3, diameter=1e-3)
    assert a == Chain(grains=3, diameter=1e-3)
    assert a == Chain(grains=3, material="glass", diameter=np.float64(1e-3), gravity=9.81)
    assert a != Chain(grains=4, diameter=1e-3)
    assert a != Chain(grains=3, diameter=1e-3, gravity=9.80665)
    assert a != Chain(grains=3, diameter=1e-3, material=STEEL)
    assert a != Chain(grains=3, diameter=1e-3, masses=[1e-6] * 3)
    assert a != 3
    with pytest.raises(TypeError):
        hash(a)


def test_materials():
    assert (GLASS.density, GLASS.youngs_modulus, GLASS.poissons_ratio) == (2426.0, 62e9, 0.2)
    assert GLASS.plane_strain_modulus == pytest.approx(62e9 / 0.96, rel=1e-15)
    for material in (GLASS, STEEL, PTFE, BRASS, TUNGSTEN_CARBIDE):
        assert material.source
        assert Chain(grains=2, material=material.name, diameter=1e-3).material == material
    with pytest.raises(InputError) as caught:
        Material(density=0.0, youngs_modulus=np.inf, poissons_ratio=0.51)
    assert [key for key, _ in caught.value.faults] == ["density", "youngs_modulus", "poissons_ratio"]
