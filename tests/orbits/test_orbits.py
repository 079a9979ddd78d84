"""Periodic orbits against exact solutions, the linear limit, extended precision and the engines."""

from functools import cache

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of
from helpers.extended_precision import tangent_map
from helpers.oscillator_period import oscillator_period
from scipy.integrate import quad
from scipy.optimize import brentq

from lmpchain import Chain, Drive, Impulse, InputError, Law, Material, Profile, orbits, simulate
from lmpchain.engines import Native
from lmpchain.errors import RunFailed
from lmpchain.integrators.methods import KAHAN_LI8
from lmpchain.orbits import Orbit
from lmpchain.orbits.flow import Flow
from lmpchain.theory.modes import eigenmodes

RIGID = Material(density=1e3, youngs_modulus=1e30, poissons_ratio=0.0)
WALLS = {"top": "wall", "bottom": "wall", "top_material": RIGID, "bottom_material": RIGID}


def at_rest(chain: Chain, displacement: np.ndarray, period: float, **given: float) -> Orbit:
    return orbits.find(chain, (displacement, np.zeros(chain.grains)), period, **given)


@cache
def dimer(grains: int = 43) -> Chain:
    """Return a chain with mass ratio 3 : 1 between walls, and a light grain in the middle."""
    masses = np.where(np.arange(grains) % 2 == 0, 3e-3, 1e-3)
    return Chain(
        grains=grains,
        diameter=1e-2,
        gravity=0.0,
        top_load=20.0,
        top="wall",
        bottom="wall",
        masses=masses,
    )


@cache
def gap_breather() -> Orbit:
    """Return the lowest optical mode of the dimer, continued into the gap."""
    chain = dimer()
    u, period = orbits.linear_mode(chain, 23, 0.7)
    local = u * np.exp(-(((np.arange(43) - 21) / 8) ** 2))
    return at_rest(chain, local, period, energy=2.4e-4)


@pytest.mark.parametrize("load", [1.0, 0.0])
def test_the_tangent_map_agrees_with_the_native_engine_and_is_symplectic(
    rng: np.random.Generator, load: float
):
    chain = column(12, gravity=0.0, top_load=load, top="wall", bottom="wall")
    scale = chain.length_scale or 1e-7
    u, v = rng.normal(size=(2, 12)) * [[scale], [scale * 1e6]]
    flow = Flow(chain, 1e6)
    size = 24
    mesh = rng.uniform(0.5, 1.5, 40) / 40
    period = 1e-5
    passage = flow.run(flow.canonical(u, v), period, mesh, np.eye(size).reshape(2, 12, size))
    overlap = chain.contacts.overlap + chain.contacts.closer(passage.displacement)
    assert overlap.min() < -scale / 10  # Contacts open.
    matrix = passage.deviation.reshape(size, size)
    turn = np.kron([[0, 1], [-1, 0]], np.eye(12))
    assert np.abs(matrix.T @ turn @ matrix - turn).max() < 1e-12
    x, _, exact = tangent_map(chain, u, v, mesh * period, KAHAN_LI8)
    weight = np.concatenate((flow.weight, flow.weight / flow.rate))
    assert np.abs(passage.displacement[-1] - x).max() < 1e-13 * np.abs(u).max()
    assert np.abs(matrix - weight[:, None] * exact / weight).max() < 1e-12 * np.abs(matrix).max()
    even = flow.run(flow.canonical(u, v), period, np.full(40, 1 / 40))
    scene = scene_of(chain, Profile(displacement=u, velocity=v), period, 2)
    run = simulate(scene, engine=Native(integrator="kahan-li8", step=period / 40))
    assert (
        np.abs(run.displacement[-1] - even.displacement[-1]).max()
        < 1e-13 * np.abs(run.displacement).max()
    )


@pytest.mark.parametrize("load", [1.0, 0.0])
@pytest.mark.parametrize("relative", [0.3, 0.7, 3.0])
def test_pi_modes_match_quadrature_with_contacts_that_open(load: float, relative: float):
    """Neighbours move in opposite directions between rigid walls."""
    chain = column(5, gravity=0.0, top_load=load, **WALLS)
    amplitude = relative * (chain.contacts.overlap[1] or 1e-7)
    numbers = chain.contact_constants[0], chain.contacts.overlap[1], chain.masses[0], 1.5, 2.0
    period = oscillator_period(amplitude, *numbers)
    orbit = at_rest(chain, amplitude * (-1.0) ** np.arange(5), period)
    found = np.abs(orbit.displacement).max()
    assert oscillator_period(found, *numbers) == pytest.approx(orbit.period, rel=1e-11)
    assert orbit.residual < 1e-13
    assert orbit.error < 1e-11
    assert orbit.displacement[:-1] == pytest.approx(-orbit.displacement[1:], rel=1e-12)


def test_a_mode_of_bonds_without_load_matches_quadrature():
    """One grain between two Toda bonds has the potential energy 2 k (cosh(b x) - 1) / b^2."""
    law = Law("k*(exp(b*o) - 1)/b", k=1e5, b=1e5)
    chain = column(1, gravity=0.0, top="wall", bottom="wall", law=law)
    energy = 2e-5
    found = orbits.normal_mode(chain, 1, energy)
    farthest = np.arccosh(1 + energy * 1e5**2 / 2e5) / 1e5
    # With x = farthest sin(s) the integrand is smooth.
    quarter, _ = quad(
        lambda s: (
            farthest
            * np.cos(s)
            / np.sqrt(2 * (energy - 2e5 / 1e5**2 * (np.cosh(1e5 * farthest * np.sin(s)) - 1)))
        ),
        *(0.0, np.pi / 2 * (1 - 1e-9)),
    )
    assert found.period == pytest.approx(4 * quarter * np.sqrt(chain.masses[0]), rel=1e-8)
    assert found.period < 0.95 * 2 * np.pi / chain.band_edge


def test_a_grain_with_long_flights_between_short_contacts():
    """The flight lasts 30 times as long as the contact, and needs compensated sums."""
    chain = column(1, bottom="wall")
    m = chain.masses[0]
    k = chain.wall_constants[1]
    eps = chain.contacts.overlap[1]
    g = chain.gravity
    orbit = orbits.normal_mode(chain, 1, 3e3 * m * g * eps)
    touching = orbit.energy - 0.6 * m * g * eps  # Kinetic energy at the beginning of the contact.
    deepest = brentq(
        lambda o: touching + m * g * o - 0.4 * k * o**2.5,
        eps,
        1e3 * eps,
        xtol=1e-16 * eps,
        rtol=1e-15,
    )

    def slowness(s: float) -> float:
        o = deepest * (1 - s**2)
        work = 0.4 * k * deepest**2.5 * -np.expm1(2.5 * np.log1p(-(s**2))) - m * g * deepest * s**2
        return (
            2 * deepest * s / np.sqrt(2 * work / m)
            if o
            else 2 * deepest * s / np.sqrt(2 * touching / m)
        )

    contact, _ = quad(slowness, 1e-300, 1, epsabs=0, epsrel=1e-13, limit=200)
    assert orbit.period == pytest.approx(2 * (np.sqrt(2 * touching / m) / g + contact), rel=1e-11)
    assert orbit.residual < 1e-12


def test_a_gap_breather_closes_and_has_the_multipliers_of_extended_precision():
    orbit = gap_breather()
    assert orbit.residual < 1e-13
    assert orbit.error < 1e-11
    share = orbit.chain.masses * orbit.motion()[2].std(0) ** 2
    assert share[15:28].sum() > 0.75 * share.sum()  # The breather is localised.
    _, _, exact = tangent_map(
        orbit.chain, orbit.displacement, orbit.velocity, orbit.mesh * orbit.period, KAHAN_LI8
    )
    scale = np.repeat([1.0, 1 / orbit.flow.rate], 43)
    eigenvalues = np.linalg.eigvals((scale[:, None] * exact / scale).astype(float))
    own = orbit.multipliers[:-2]
    assert np.abs(own[:, None] - eigenvalues).min(1).max() < 1e-8
    assert np.abs(own[::2] * own[1::2] - 1).max() < 1e-10
    # The directions along the orbit and to neighbouring orbits.
    assert np.sum(np.abs(eigenvalues - 1) < 1e-5) == 2


def test_small_orbits_have_the_multipliers_of_the_linear_chain():
    chain = column(9)
    u, period = orbits.linear_mode(chain, 3, 1e-6)
    orbit = at_rest(chain, u, period, energy=float(chain.excess_energy(u, 0 * u)))
    turn = np.exp(1j * eigenmodes(chain).frequency * orbit.period)
    assert orbit.period == pytest.approx(period, rel=1e-11)
    assert np.abs(np.delete(turn, 2)[:, None] - orbit.multipliers).min(1).max() < 1e-6
    assert orbit.stable


@pytest.mark.parametrize("exponent", [1.5, 2.5])
def test_frequency_shifts_with_energy_agree_with_perturbation_theory(exponent: float):
    chain = column(2, exponent=exponent)
    k = chain.contact_constants[0]
    m = chain.masses[0]
    eps = chain.length_scale
    d = exponent
    w = np.sqrt(k * d * eps ** (d - 1) / m)
    second = k * d * (d - 1) / 2 * eps ** (d - 2) / m
    third = k * d * (d - 1) * (d - 2) / 6 * eps ** (d - 3) / m
    energy = 0.5 * m * w**2 * (eps * np.array([1e-2, 2e-2])) ** 2
    # See Landau and Lifshitz, section 28.
    shift = (9 * third * w**2 - 10 * second**2) / (24 * w**3) * 2 / (m * w**2)
    slope = [(2 * np.pi / orbits.normal_mode(chain, 1, e).period - w) / e for e in energy]
    assert (4 * slope[0] - slope[1]) / 3 == pytest.approx(shift, rel=1e-6)


def test_an_orbit_with_initial_velocities_has_the_same_multipliers():
    chain = column(6)
    energy = 0.2 * chain.length_scale * chain.masses[0] * 9.81
    orbit = orbits.normal_mode(chain, 2, energy)
    _, u, v = orbit.motion()
    later = orbits.find(chain, (u[7], v[7]), orbit.period)
    assert not later.reversible
    assert later.residual < 1e-12
    assert later.energy == pytest.approx(energy, rel=1e-9)
    assert np.sort_complex(later.means) == pytest.approx(np.sort_complex(orbit.means), abs=1e-9)
    assert np.abs(later.multipliers[::2] * later.multipliers[1::2] - 1).max() < 1e-10


def test_an_orbit_runs_in_an_engine():
    orbit = gap_breather()
    run = simulate(orbit.scene(3, samples=4), "native", 1e-10)
    assert np.abs(run.displacement - orbit.displacement).max() < 1e-8 * orbit.amplitude


@pytest.mark.slow
def test_an_orbit_runs_in_lammps():
    """The accuracy is limited by the rounding of heights."""
    chain = column(10, gravity=0.0, top_load=1.0, top="wall", bottom="wall")
    orbit = orbits.normal_mode(chain, 6, 1e-7)
    run = simulate(orbit.scene(2, samples=3), "lammps", 1e-6)
    assert np.abs(run.displacement - orbit.displacement).max() < 1e-6 * orbit.amplitude


@pytest.mark.parametrize(("top", "grain"), [("free", 1), ("wall", 1), ("wall", 0)])
def test_a_driven_orbit_runs_in_an_engine(top: str, grain: int):
    """The state returns after each of three periods, while the drive continues."""
    chain = column(12, gravity=0.0, top_load=1.0, top=top, bottom="wall")
    sine = {"frequency": 0.3 * chain.band_edge / (2 * np.pi), "grain": grain}
    orbit = orbits.find(chain, drive=Drive(amplitude=0.02 * chain.length_scale, **sine))
    assert orbit.residual < 1e-12
    run = simulate(orbit.scene(3, samples=4), "native", 1e-11)
    assert np.abs(run.displacement - orbit.displacement).max() < 1e-11 * orbit.amplitude
    again = orbits.find(chain, drive=orbit.scene().excitation)
    assert again.velocity == pytest.approx(orbit.velocity, rel=1e-10)
    linear = orbits.find(chain, drive=Drive(amplitude=1e-9 * chain.length_scale, **sine))
    for engine in ("modes", "chebyshev"):
        run = simulate(linear.scene(3, samples=4), engine, 1e-7)
        assert np.abs(run.displacement - linear.displacement).max() < 1e-8 * linear.amplitude


@pytest.mark.slow
def test_a_driven_orbit_runs_in_lammps():
    chain = column(12, gravity=0.0, top_load=1.0, bottom="wall")
    drive = Drive(
        amplitude=0.02 * chain.length_scale, frequency=0.3 * chain.band_edge / (2 * np.pi)
    )
    orbit = orbits.find(chain, drive=drive)
    run = simulate(orbit.scene(3, samples=4), "lammps", 1e-6)
    assert np.abs(run.displacement - orbit.displacement).max() < 1e-7 * orbit.amplitude


def test_impossible_orbits_are_rejected_in_one_line():
    vacuum = column(5, gravity=0.0, top="wall", bottom="wall")
    chain = column(5)
    small = orbits.normal_mode(chain, 1, 1e-20)
    free = column(5, gravity=0.0)
    long = Profile(displacement=np.ones(6))
    ground = chain.replace(ground=Law("k*u", k=1.0))
    push = np.array([1e-9, 0, 0, 0, 0])
    burst = Drive(times=[0, 1], displacement=[0, 1e-9])
    wrong = {
        "chain: carries no force at rest": lambda: orbits.normal_mode(vacuum, 1, 1e-9),
        "chain: flies apart": lambda: at_rest(free, np.array([1e-9, 0, 0, 0, 0]), 1e-4),
        "mode: must be a whole number from 1 to 4": lambda: orbits.normal_mode(chain, 5, 1e-9),
        "energy: must be a number above 0": lambda: orbits.normal_mode(chain, 1, -1.0),
        "period: must be a number above 0": lambda: orbits.find(chain, Impulse(velocity=1e-3)),
        "guess: is the chain at rest": lambda: at_rest(chain, np.zeros(5), 1e-4),
        "guess: is missing": lambda: orbits.find(chain, period=1e-4),
        "guess.displacement: must have one entry a grain": lambda: orbits.find(chain, long, 1e-4),
        "drive: must be a sine": lambda: orbits.find(chain, period=1e-4, drive=burst),
        "parameter: must be energy, period": lambda: orbits.follow(small, "colour", 1.0),
        "until: must be above 0": lambda: orbits.follow(small, "energy", -1.0),
        "chain.ground: the search": lambda: orbits.linear_mode(ground, 1),
        "chain.ground: the search for": lambda: orbits.normal_mode(ground, 1, 1e-9),
        "chain.ground: an orbit or its tangent map": lambda: at_rest(ground, push, 1e-4),
        "chain.ground: an orbit or": lambda: orbits.follow(
            small, lambda k: chain.replace(ground=Law("k*u", k=k)), 1.0, start=0.0
        ),
    }
    for message, call in wrong.items():
        with pytest.raises(InputError) as caught:
            call()
        assert str(caught.value).startswith(message)
        assert "\n" not in str(caught.value)
    with pytest.raises(RunFailed, match=r"orbit found near|at rest is found"):
        at_rest(chain, chain.length_scale * np.array([3.0, -2.0, 5.0, 1.0, 0.0]), 1e-5)
