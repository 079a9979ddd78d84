"""Requirements on every integrator of both engines for any scene."""

from itertools import product

import numpy as np
import pytest
from helpers.example_scenes import paper, smooth
from helpers.independent_integrators import distance, extended_reference
from scipy.integrate import simpson

from lmpchain import Chain, Drive, Impulse, Profile, Scene, engines, simulate
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.integrators.methods import METHODS, SPLITTINGS

NATIVE = engines.Native.integrators[1:]  # Without "auto".
ENGINES = {"native": NATIVE, "lammps": engines.Lammps.integrators}
both = pytest.mark.parametrize("engine", ENGINES)
every = pytest.mark.parametrize("integrator", NATIVE)
PAIRS = [(engine, integrator) for engine, known in ENGINES.items() for integrator in known]
pairs = pytest.mark.parametrize(("engine", "integrator"), PAIRS)


def fixed_step(engine: str, integrator: str, step: float) -> engines.base.Engine:
    options = {"diameter": "gauge"} if engine == "lammps" else {}
    return engines.get(engine, integrator=integrator, step=step, **options)


@pairs
def test_order_of_convergence(engine, integrator):
    scene = smooth()
    u, v, own = extended_reference(scene)
    counts = {
        "verlet": [256, 512, 1024, 2048],
        "rkn4": [32, 48, 64, 96],
        "kahan-li6": [24, 34, 48, 68],
        "rkn6": [11, 15, 21, 30],
        "kahan-li8": [24, 29, 35, 42],
        # Shorter steps have errors below 1e-12, whose slope rounding (3e-15) changes by 0.05.
        "dop853": [36, 42, 48, 54],
        "gear4": [800, 1500, 2000, 3000, 4000],
    }[integrator]
    errors = []
    for count in counts:
        t = simulate(scene, engine=fixed_step(engine, integrator, scene.duration / count))
        assert t.cost.steps == count
        errors.append(distance(t, (u, v)))
    n = np.array(counts, dtype=float)
    # Methods that are not symmetric have odd terms as well.
    laws = [np.ones(n.size), -np.log(n)] + ([] if integrator in SPLITTINGS else [1 / n])
    slope = np.linalg.lstsq(np.stack(laws, axis=1), np.log(errors), rcond=None)[0][1]
    assert min(errors) > 100 * own
    assert slope == pytest.approx(METHODS[integrator].order, abs=0.05)


@pairs
def test_equilibrium_stays_at_rest(engine, integrator):
    chain = Chain(grains=20, material="glass", diameter=1e-3)
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.0), duration=50e-6, samples=6)
    t = simulate(scene, engine=fixed_step(engine, integrator, 1e-7))
    # The native engine is exact; LAMMPS rounds heights of 20 gauge diameters, each some 10
    # overlaps.
    rounding = 0.0 if engine == "native" else 1e-11
    assert np.abs(t.displacement).max() <= rounding * chain.length_scale
    assert np.abs(t.velocity).max() <= rounding * chain.length_scale / chain.time_scale
    assert t.error_estimate.total < 1e-10


@both
@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_energy_is_conserved(engine, exponent):
    scene = smooth(exponent=exponent, samples=21)
    t = simulate(scene, engine=engine, tolerance=1e-8)
    energy = scene.chain.excess_energy(t.displacement, t.velocity)
    assert energy == pytest.approx(scene.energy, rel=3e-8)


@both
def test_momentum_is_conserved_in_a_free_chain(engine):
    chain = Chain(grains=8, material="steel", diameter=5e-3, gravity=0.0, bottom="free")
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.1), duration=1e-4, samples=5)
    t = simulate(scene, engine=engine, tolerance=1e-7)
    momentum = t.velocity @ chain.masses
    assert momentum == pytest.approx(chain.masses[0] * 0.1, rel=1e-12)


def test_momentum_balances_gravity_and_floor():
    """The rate of the momentum is the weight of moving grains minus the last contact's force."""
    chain = Chain(grains=12, material="glass", diameter=1e-3)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-4), duration=60e-6, samples=1001)
    t = simulate(scene, tolerance=1e-10)
    overlap = chain.equilibrium_overlap[-1] + t.displacement[:, -2]
    force = chain.contact_constants[-1] * np.maximum(overlap, 0) ** 1.5
    weight = chain.gravity * chain.masses[:-1].sum()
    impulse = simpson(weight - force, x=t.time)
    gained = (t.velocity[-1] - t.velocity[0]) @ chain.masses
    assert gained == pytest.approx(impulse, rel=1e-6)


@pytest.mark.parametrize(
    ("engine", "integrator"), [pair for pair in PAIRS if pair[1] in SPLITTINGS]
)
def test_time_reversal(engine, integrator):
    """If all velocities are reversed at the end, the chain returns to its initial state."""
    chain = Chain(grains=20, material="glass", diameter=1e-3)
    there = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=40e-6, samples=2)
    solver = fixed_step(engine, integrator, 2e-7)
    t = simulate(there, engine=solver)
    turned = Profile(displacement=t.displacement[-1], velocity=-t.velocity[-1])
    back = simulate(Scene(chain=chain, excitation=turned, duration=40e-6, samples=2), engine=solver)
    rounding = 1e-11 if engine == "native" else 1e-6
    assert back.velocity[-1] == pytest.approx(-t.velocity[0], abs=rounding * 1e-3)
    assert back.displacement[-1] == pytest.approx(
        t.displacement[0], abs=rounding * np.abs(t.displacement).max()
    )


def test_opportunities_to_stop_do_not_change_the_bits(monkeypatch):
    """The number of steps between two opportunities to stop has no effect in any integrator."""
    struck = paper("fig1", samples=3).replace(duration=4e-5)
    bump = Drive(times=[0, 1.6e-5, 2e-5, 2.4e-5, 4e-5], displacement=[0, 0, 1e-7, 0, 0])
    driven = Scene(chain=struck.chain, excitation=bump, duration=struck.duration, samples=3)
    for engine in ENGINES:
        for integrator, scene in product(ENGINES[engine], (struck, driven)):
            solver = fixed_step(engine, integrator, 1e-7 if engine == "native" else 5e-7)
            whole = simulate(scene, engine=solver)
            monkeypatch.setattr(stepping_run, "PIECE_S", 1e-5)
            pieces = simulate(scene, engine=solver)
            monkeypatch.undo()
            assert np.array_equal(whole.displacement, pieces.displacement)
            assert np.array_equal(whole.velocity, pieces.velocity)
