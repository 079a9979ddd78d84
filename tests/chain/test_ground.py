"""Ground forces: their formulas, parts of chains, files, and what rejects them."""

from __future__ import annotations

import numpy as np
import pytest

import lmpchain
from lmpchain import Chain, Impulse, InputError, Law, Scene, laws, simulate
from lmpchain.benchmark.reference import reference
from lmpchain.engines.lammps.export import write_deck
from lmpchain.measure import collision, dyson, energy, shock, solitary, spectrum, wavenumbers
from lmpchain.measure.fit import solitary as fit_solitary
from lmpchain.theory import scattering, soliton

HOST = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
SPRING = Law("k*u", k=1e6)


def on(ground: Law | None, grains: int = 12, **options) -> Chain:
    """Return a loaded chain on a ground."""
    fields = {**HOST, **options, "ground": ground}
    return Chain(grains=grains, **{key: x for key, x in fields.items() if x is not None})


def struck(chain: Chain, velocity: float = 1e-3, samples: int = 41) -> Scene:
    """Return the scene of a strike on the top."""
    duration = 30 * chain.time_scale
    strike = Impulse(velocity=velocity)
    return Scene(chain=chain, excitation=strike, duration=duration, samples=samples)


@pytest.mark.parametrize(
    ("law", "key", "message"),
    [
        (Law("c*o", c=1.0), "ground.force", "depends on the overlap o"),
        (Law("max(u, 0)"), "ground.force", "bends where u = 0"),
        (Law("u*step(t - c)", c=1e-5), "ground.force", "use a smooth formula"),
        (Law("u + c", c=1.0), "ground.force", "is not 0 at u = 0"),
        (Law("u*t + sin(t)"), "ground.force", "is not 0 at u = 0"),
        (Law("c*u**0.5", c=1.0), "ground.force", "no finite stiffness"),
        (Law("c*u", c=[1.0, 2.0]), "ground.c", "12, one per grain, not 2"),
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


def test_parts_and_files_preserve_the_ground(tmp_path):
    stiffness = np.linspace(1e5, 1e6, 12)
    chain = on(Law("k*u + b*u**3", k=stiffness.tolist(), b=1e15))
    part = chain.part(3, 7)
    np.testing.assert_array_equal(part.ground_stiffness, stiffness[2:7])
    struck(chain).to_toml(tmp_path / "scene.toml")
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
}


@pytest.mark.parametrize("name", GROUNDS)
@pytest.mark.parametrize("damping", [None, {"drag": 1e4}, {"viscoelastic": 1e-8}])
def test_a_run_meets_its_tolerance(name, damping):
    scene = struck(on(GROUNDS[name], damping=damping), velocity=3e-3)
    answer = simulate(scene, "native", tolerance=1e-8)
    exact = reference(scene)
    for field in ("displacement", "velocity"):
        size = exact.scale[int(field == "velocity")]
        off = np.abs(getattr(answer, field) - getattr(exact, field)).max() / size
        assert off < 1e-8 + exact.error


def test_a_batch_gives_the_bits_of_single_runs():
    scenes = [struck(on(Law("k*u + b*u**3", k=k, b=1e20))) for k in (1e5, 3e5, 1e6)]
    engine = lmpchain.engines.Native(integrator="dop853", step=scenes[0].sampling_interval / 2)
    together = lmpchain.simulate_many(scenes, engine=engine)
    for scene, answer in zip(scenes, together, strict=True):
        alone = simulate(scene, engine)
        np.testing.assert_array_equal(answer.displacement, alone.displacement)
        np.testing.assert_array_equal(answer.velocity, alone.velocity)


def test_quantities_between_samples_hold_their_errors():
    """They are computed from the samples alone, because the ground may depend on time."""
    scene = struck(on(GROUNDS["in time"]), samples=161)
    peaks, exact = (
        lmpchain.measure.motion.peaks(simulate(each, "native", tolerance=1e-9))
        for each in (scene, scene.replace(samples=1601))
    )
    assert (np.abs(peaks.value - exact.value) <= peaks.error + exact.error).all()
    assert (exact.error < 1e-3 * exact.value.max()).all()


REFUSING = {
    "lammps": lambda run: simulate(run.scene, "lammps"),
    "chebyshev": lambda run: simulate(run.scene, "chebyshev"),
    "verlet": lambda run: simulate(run.scene, lmpchain.engines.Native(integrator="verlet")),
    "energy": lambda run: energy.shares(run),
    "ledger": lambda run: energy.ledger(run),
    "losses": lambda run: energy.losses(run),
    "solitary": lambda run: solitary.find(run),
    "collision": lambda run: collision.find(run),
    "shock": lambda run: shock.find(run),
    "wavenumbers": lambda run: wavenumbers.bands(run),
    "travel time": lambda run: spectrum.travel_time(run.scene.chain),
    "relative stiffness": lambda run: dyson.relative_stiffness(run.scene.chain),
    "fit of solitary waves": lambda run: fit_solitary.fit_soliton(run),
    "stability": lambda run: lmpchain.stability.stability(run.scene),
    "averages": lambda run: lmpchain.averages(run.scene, ["kinetic_energy"]),
    "gradients": lambda run: lmpchain.design.gradient(
        run.scene, lmpchain.design.PeakForce(contact=3), ["masses"]
    ),
    "orbits": lambda run: lmpchain.orbits.normal_mode(run.scene.chain, 1, 1e-12),
    "scattering": lambda run: scattering.transmission(run.scene.chain, 1e5),
    "soliton": lambda run: soliton.solve(speed=1.2).on(run.scene.chain, 6),
    "deck": lambda run: write_deck(run.scene, "never"),
    "energy above rest": lambda run: run.scene.chain.excess_energy(*run.scene.initial()),
}


@pytest.fixture(scope="module")
def run():
    return simulate(struck(on(SPRING)), "native")


@pytest.mark.parametrize("name", REFUSING)
def test_functions_without_ground_support_reject_it(name, run):
    with pytest.raises(InputError, match="ground"):
        REFUSING[name](run)


def test_modes_allow_only_springs():
    simulate(struck(on(SPRING), velocity=1e-7), "modes")
    for name in ("periodic", "two wells", "in time"):
        with pytest.raises(InputError, match="no spring of one stiffness"):
            simulate(struck(on(GROUNDS[name])), "modes")
