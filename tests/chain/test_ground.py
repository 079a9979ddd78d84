"""Ground forces: their formulas, parts of chains, files, and what rejects them."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from helpers.example_scenes import stirred, struck
from helpers.thinned import thinned

import lmpchain
from lmpchain import Chain, Drive, Force, InputError, Law, Scene, laws, simulate
from lmpchain.benchmark.reference import reference
from lmpchain.chain import ground
from lmpchain.engines import Native
from lmpchain.measure import energy
from lmpchain.theory import scattering, soliton

HOST = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
SPRING = Law("k*u", k=1e6)


def on(law: Law | None, grains: int = 12, **options) -> Chain:
    """Return a loaded chain on a ground."""
    fields = {**HOST, **options, "ground": law}
    return Chain(grains=grains, **{key: x for key, x in fields.items() if x is not None})


def struck_on(law: Law, velocity: float = 1e-3, samples: int = 41, **options) -> Scene:
    """Return the scene of a strike on the top of a chain on a ground."""
    chain = on(law, **options)
    return struck(chain, velocity, 30 * chain.time_scale, samples)


@pytest.mark.parametrize(
    ("law", "key", "message"),
    [
        (Law("c*o", c=1.0), "ground.force", "depends on the overlap o"),
        (Law("u*step(t - c)", c=1e-5), "ground.force", "of the displacement u alone"),
        (Law("u + c", c=1.0), "ground.force", "is not 0 at u = 0"),
        (Law("u*t + sin(t)"), "ground.force", "is not 0 at u = 0"),
        (Law("max(u**2 - c, 0)", c=1e-12), "ground.force", "which is not linear in u"),
        (Law("c*u**0.5", c=1.0), "ground.force", "no finite stiffness"),
        (Law("c*u", c=[1.0, 2.0]), "ground.c", r"12 \(one per grain\), not 2"),
    ],
)
def test_an_invalid_ground_is_rejected(law, key, message):
    with pytest.raises(InputError, match=message) as raised:
        on(law)
    assert raised.value.faults[0][0] == key


def test_a_ground_force_depends_on_displacement_and_time():
    law = laws.mathieu(1e3, depth=0.5, frequency=1e4)
    u = np.array([0.0, 1e-6, -2e-6])
    np.testing.assert_allclose(law.force(u, 25e-6), 1e3 * u, atol=1e-18)
    np.testing.assert_allclose(law.force(u), 1.5e3 * u)
    assert law.stiffness(1e-6, 50e-6) == pytest.approx(500.0)
    # s (1 + r t) + 3 b u^2 is largest at the end and at the largest displacement of either sign.
    hardening = {"force": "s*(1 + r*t)*u + b*u**3", "r": 500.0, "b": 1e15}
    for stiffness in (1e3, [1e3, 2e3, 0.0]):
        growing = Law.from_table(hardening | {"s": stiffness})
        expected = np.array(stiffness) * (1 + 500.0 * 4e-3) + 3e15 * 1e-6**2
        found = ground.largest_stiffness(growing, 1e-6, duration=4e-3)
        assert found == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "onset"),
    [
        ("k*u", 1.5), ("k*(u + max(u, 0)**2)", 1.5), ("k*max(u, 0)", 1.0), ("k*t*max(u, 0)", 1.0),
        ("k*max(abs(u) - 1e-6, 0)**1.2 + u", 1.2), ("u + k*u*step(u - 1e-6)", 0.0),
    ],
)  # fmt: skip
@pytest.mark.parametrize("k", [1e5, [1e5, 0.0], [0.0, 1e5]])
def test_the_onset_of_a_ground_is_that_of_its_sharpest_kink(text, onset, k):
    assert ground.onset(Law(text, k=k)) == pytest.approx(onset, abs=1e-6)


def test_parts_and_files_preserve_the_ground(tmp_path):
    stiffness = np.linspace(1e5, 1e6, 12)
    chain = on(Law("k*u + b*u**3", k=stiffness.tolist(), b=1e15))
    part = chain.part(3, 7)
    np.testing.assert_array_equal(part.ground_stiffness, stiffness[2:7])
    struck(chain, 1e-3, 1e-5).to_toml(tmp_path / "scene.toml")
    again = Scene.from_toml(tmp_path / "scene.toml").chain
    assert again == chain
    assert again.ground == chain.ground
    assert chain != on(None) == chain.replace(ground=None)


GROUNDS = {
    "spring": SPRING,
    "of each grain": Law("k*u", k=np.linspace(0, 1e6, 12).tolist()),
    "periodic": laws.frenkel_kontorova(1e6, period=1e-8),
    "two wells": Law("b*u**3 - k*u", k=1e5, b=1e22),
    "in time": laws.mathieu(1e6, depth=0.6, frequency=2e5),
    "on one side": Law("k*max(u, 0)", k=1e6),
}


@pytest.mark.parametrize(
    ("name", "damping"),
    thinned(product(GROUNDS, [None, {"drag": 1e4}, {"viscoelastic": 1e-8}]), 4),
)
def test_a_run_meets_its_tolerance(name, damping):
    scene = struck_on(GROUNDS[name], damping=damping, velocity=3e-3, samples=21)
    scene = scene.replace(duration=scene.duration / 2)
    answer = simulate(scene, "native", tolerance=1e-8)
    exact = reference(scene)
    for field in ("displacement", "velocity"):
        size = exact.scale[int(field == "velocity")]
        off = np.abs(getattr(answer, field) - getattr(exact, field)).max() / size
        assert off < 1e-8 + exact.error


# The order of each method, and two numbers of steps between samples that show it.
ORDERS = {
    "verlet": (2, 96, 192),
    "rkn4": (4, 48, 96),
    "rkn6": (6, 12, 24),
    "kahan-li6": (6, 24, 48),
    "kahan-li8": (8, 12, 24),
}


@pytest.mark.parametrize("name", ["two wells", "in time"])
@pytest.mark.parametrize("integrator", ORDERS)
def test_splittings_keep_their_order(name, integrator):
    scene = struck_on(GROUNDS[name], samples=11)
    exact = simulate(scene, "native", tolerance=1e-12).velocity
    order, *counts = ORDERS[integrator]
    coarse, fine = (
        np.abs(
            simulate(scene, Native(integrator, scene.sampling_interval / n)).velocity - exact
        ).max()
        for n in counts
    )
    assert fine > 1e-11 * np.abs(exact).max()
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.05)


def test_a_batch_gives_the_bits_of_single_runs():
    scenes = [struck_on(Law("k*u + b*u**3", k=k, b=1e20)) for k in (1e5, 3e5, 1e6)]
    engine = Native(integrator="dop853", step=scenes[0].sampling_interval / 2)
    together = lmpchain.simulate_many(scenes, engine=engine)
    for scene, answer in zip(scenes, together, strict=True):
        alone = simulate(scene, engine)
        np.testing.assert_array_equal(answer.displacement, alone.displacement)
        np.testing.assert_array_equal(answer.velocity, alone.velocity)


def test_quantities_between_samples_hold_their_errors():
    """Motion between samples is computed from the samples alone, as the ground may vary."""
    scene = struck_on(GROUNDS["in time"], samples=161)
    peaks, exact = (
        lmpchain.measure.motion.peaks(simulate(each, "native", tolerance=1e-9))
        for each in (scene, scene.replace(samples=1601))
    )
    assert (np.abs(peaks.value - exact.value) <= peaks.error + exact.error).all()
    assert (exact.error < 1e-3 * exact.value.max()).all()


ENERGIES = {
    "strike": {},
    "push": {"excitation": Force(grain=3, amplitude=0.1, frequency=1e5)},
    "drive": {"excitation": Drive(amplitude=1e-8, frequency=1e5)},
}


CONSERVATIVE = ("spring", "of each grain", "periodic", "two wells", "on one side")


@pytest.mark.parametrize("name", CONSERVATIVE)
@pytest.mark.parametrize("damping", [None, {"drag": 1e4, "viscoelastic": 1e-8}])
def test_the_balance_of_energy_and_momentum(name, damping):
    scene = struck_on(GROUNDS[name], damping=damping, samples=201)
    run = simulate(scene.replace(duration=scene.duration / 2), "native", tolerance=1e-9)
    ledger = energy.ledger(run)
    size = ledger.total.max()
    assert np.abs(ledger.ground).max() > 1e-3 * size
    assert np.abs(ledger.drift).max() <= ledger.dissipated_error + 1e-7 * size
    momentum = np.abs(ledger.momentum).max()
    assert np.abs(ledger.momentum_drift).max() < ledger.impulse_error + 1e-7 * momentum
    shares = energy.shares(run)
    np.testing.assert_allclose(shares.of_grain.sum(1), ledger.total, atol=1e-12 * size)
    if damping:
        lost = energy.losses(run)
        np.testing.assert_allclose(lost.total, ledger.dissipated, atol=lost.error)
    above_rest = scene.chain.excess_energy(run.displacement, run.velocity)
    np.testing.assert_allclose(above_rest, ledger.total, rtol=1e-12, atol=1e-13 * size)


def test_the_energy_of_a_ground():
    u = np.array([0.0, 1e-15, 3e-8, -1e-6])
    k, period = 1e6, 1e-8
    wave = 2 * np.pi / period
    exact = 2 * k / wave**2 * np.sin(wave * u / 2) ** 2
    held = ground.energy(laws.frenkel_kontorova(k, period=period), u)
    np.testing.assert_allclose(held, exact, rtol=1e-11, atol=1e-13 * k / wave**2)
    assert held[1] == pytest.approx(k * 1e-30 / 2, rel=1e-13)


def test_averages_of_springs_on_springs():
    """Kinetic and potential energy of linear springs have the same mean."""
    chain = on(SPRING, exponent=1.0, top="wall", bottom="wall")
    start = stirred(chain, 1e-6)
    scene = Scene(chain=chain, excitation=start, duration=3e4 * chain.time_scale, samples=2)
    average = lmpchain.averages(scene, ["kinetic_energy", "potential_energy"], tolerance=1e-5)
    assert scene.energy == pytest.approx((chain.masses * np.square(start.velocity)).sum() / 2)
    for name in ("kinetic_energy", "potential_energy"):
        low, high = average.interval[name]
        assert low <= scene.energy / 2 <= high
        assert high - low < 0.02 * scene.energy


def test_a_ground_in_time_has_no_balance_of_energy():
    scene = struck_on(GROUNDS["in time"])
    with pytest.raises(InputError, match="does not support a stiffness that changes in time"):
        scene.chain.excess_energy(*scene.initial())


REFUSING = {
    "chebyshev": lambda run: simulate(run.scene, "chebyshev"),
    "stability": lambda run: lmpchain.stability.stability(run.scene),
    "orbits": lambda run: lmpchain.orbits.normal_mode(run.scene.chain, 1, 1e-12),
    "scattering": lambda run: scattering.transmission(run.scene.chain, 1e5),
    "soliton": lambda run: soliton.solve(speed=1.2).on(run.scene.chain, 6),
}


@pytest.fixture(scope="module")
def sprung():
    return simulate(struck_on(SPRING), "native")


@pytest.mark.parametrize("name", REFUSING)
def test_functions_without_ground_support_reject_it(name, sprung):
    with pytest.raises(InputError, match="ground"):
        REFUSING[name](sprung)


def test_modes_allow_only_springs():
    simulate(struck_on(SPRING, velocity=1e-7), "modes")
    for name in ("periodic", "two wells", "in time", "on one side"):
        with pytest.raises(InputError, match="not a linear spring"):
            simulate(struck_on(GROUNDS[name]), "modes")


@pytest.mark.parametrize("acting", ["strike", "push", "drive"])
def test_modes_of_viscous_contacts_on_a_spring(acting):
    """The ground is not viscous, so only the energy in contacts damps a mode."""
    scene = struck_on(SPRING, damping={"viscoelastic": 1e-8, "drag": 1e3}, velocity=1e-8)
    weak = {
        key: excitation.replace(amplitude=1e-5 * excitation.amplitude)
        for key, excitation in ENERGIES[acting].items()
    }
    scene = scene.replace(**weak)
    linear = simulate(scene, "modes")
    native = simulate(scene, "native", tolerance=1e-9)
    off = np.abs(linear.velocity - native.velocity).max() / np.abs(native.velocity).max()
    assert off <= linear.error_estimate.total + 1e-9
    assert linear.error_estimate.total < 1e-6
    ledger = energy.ledger(linear)
    assert np.abs(ledger.drift).max() < 1e-6 * ledger.total.max()


def test_a_ground_that_couples_viscous_modes_is_refused():
    scene = struck_on(GROUNDS["of each grain"], damping={"viscoelastic": 1e-8}, velocity=1e-8)
    with pytest.raises(InputError, match="couples viscous modes: use drag alone"):
        simulate(scene, "modes")
    dragged = scene.replace(chain=on(GROUNDS["of each grain"], damping={"drag": 1e3}))
    simulate(dragged, "modes")
