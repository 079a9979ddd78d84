"""Step limits: predictions against runs, exact motions and closed forms."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from helpers.convergence import slope
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck
from helpers.independent_integrators import extended_reference
from laws.openings import drift, errors_through_openings, order_through_openings
from scipy.linalg import eigvalsh_tridiagonal

from lmpchain import Chain, Displacement, Drive, InputError, Profile, Scene, engines, patterns
from lmpchain.benchmark.reference import Reference
from lmpchain.integrators.methods import METHODS, SPLITTINGS
from lmpchain.stability.step_limit import blow_up, energy_error, limit, struck_frequency, suspect
from lmpchain.theory.modes import eigenmodes

LOADED = column(12, gravity=0.0, top_load=1e-3)
LONG = {"rkn4": 400, "rkn6": 2000}  # Number of periods, because growth beyond the limit is slow.
every = pytest.mark.parametrize("integrator", METHODS)
soak = pytest.mark.soak


def speed(chain: Chain) -> float:
    return chain.length_scale / chain.time_scale


def struck_for_periods(chain: Chain, number: float, periods: float = 100) -> Scene:
    return struck(chain, number * speed(chain), periods * 2 * np.pi / chain.band_edge)


# --- the longest step


def fastest_mode(periods: float) -> Scene:
    """Return a chain that oscillates in its highest mode, too weakly to stiffen."""
    chain = column(6, gravity=0.0, top_load=1e-2)
    shape = np.append(eigenmodes(chain).shape[:, -1], 0.0)
    start = Profile(displacement=1e-2 * chain.length_scale * shape / np.abs(shape).max())
    return scene_of(chain, start, periods * 2 * np.pi / chain.band_edge)


@pytest.mark.parametrize(
    ("engine", "integrator"),
    [("native", name) for name in METHODS]
    + [pytest.param("lammps", "verlet", marks=pytest.mark.slow)]
    + [pytest.param("lammps", name, marks=soak) for name in ("kahan-li6", "rkn6")],
)
def test_every_method_breaks_down_at_its_limit_on_the_band_edge(
    engine: str, integrator: str
) -> None:
    scene = fastest_mode(LONG.get(integrator, 60))
    found = blow_up(scene, integrator, engine)
    assert found == pytest.approx(limit(scene, integrator), rel=0.02, abs=0)
    # Gear's method grows with every step, so that its limit depends on the duration.
    if integrator != "gear4":
        assert found * scene.chain.band_edge == pytest.approx(
            METHODS[integrator].stability_limit, rel=0.004
        )


@pytest.mark.parametrize("integrator", ["rkn4", "rkn6", "kahan-li8"])
def test_the_first_unstable_band_is_narrow(integrator: str) -> None:
    """A run of a hundred periods passes this band, and breaks down far beyond the limit."""
    method = METHODS[integrator]
    assert method.growth(suspect(integrator)) > 1.0004
    assert method.growth(1.02 * method.stability_limit) == 1
    found = blow_up(struck_for_periods(LOADED, 1.0), integrator)
    assert found > 1.25 * limit(struck_for_periods(LOADED, 1.0), integrator)


def stiffest(scene: Scene) -> float:
    """Return the highest eigenfrequency of the chain during the exact motion, rad/s."""
    chain = scene.chain
    contacts = scene.chain.contacts
    u, _, _ = extended_reference(scene, 1e-10)
    mass = chain.masses[: chain.movable]
    moving = chain.movable
    highest = 0.0
    for overlap in np.maximum(contacts.overlap + contacts.exists * contacts.closer(u), 0):
        k = chain.exponent * contacts.constant * overlap ** (chain.exponent - 1)
        diagonal = (k[:-1] + k[1:])[:moving] / mass
        beside = -k[1:moving] / np.sqrt(mass[:-1] * mass[1:])
        highest = max(highest, eigvalsh_tridiagonal(diagonal, beside).max())
    return float(np.sqrt(highest))


COLUMN = column(20)
CHAINS = {  # Chain, strike number, and largest deviation of the law.
    "weak": (LOADED, 0.1, 0.01),
    "medium": (LOADED, 10, 0.03),
    "strong": (LOADED, 1e3, 0.03),
    "column, medium": (COLUMN, 30, 0.03),
    "column, strong": (COLUMN, 1e4, 0.03),
    "exponent 2": (column(12, gravity=0.0, top_load=1e-2, exponent=2.0), 30, 0.05),
    "dimer": (
        patterns.periodic(12, 4.76e-3, ["steel", "ptfe"], gravity=0, top_load=2.38),
        10,
        0.07,
    ),
}


@pytest.mark.parametrize("case", CHAINS.values(), ids=CHAINS)
def test_the_frequency_of_a_struck_chain(case: tuple[Chain, float, float]) -> None:
    chain, number, off = case
    periods = 30 if number < 1 else 8
    quick = struck(
        chain,
        number * speed(chain),
        periods * 2 * np.pi / struck_frequency(struck_for_periods(chain, number)),
        30 * periods + 1,
    )
    assert struck_frequency(quick) == pytest.approx(stiffest(quick), rel=off, abs=0)


def test_the_frequency_of_two_grains_pressed_together() -> None:
    """The result agrees with a closed form.

    All the energy is in one contact, delta K o^(delta-1) (1/m + 1/m) with K o^(5/2) / (5/2) = E.
    """
    chain = column(2, gravity=0.0, bottom="free")
    scene = scene_of(chain, Displacement(displacement=1e-8), 1e-5)
    stiffness = 1.5 * chain.contact_constants[0] * np.sqrt(1e-8)
    assert struck_frequency(scene) == pytest.approx(
        np.sqrt(2 * stiffness / chain.masses[0]), rel=1e-12, abs=0
    )


def test_the_frequency_of_a_driven_chain_is_that_of_the_drive_or_the_band_edge() -> None:
    scene = scene_of(LOADED, Drive(amplitude=1e-9, frequency=1e6), 1e-5)
    assert struck_frequency(scene) == scene.highest_frequency


def test_the_step_is_unlimited_if_nothing_moves() -> None:
    chain = column(3, gravity=0.0)
    assert limit(struck(chain, 0.0, 1e-5), "verlet") == np.inf


@pytest.mark.parametrize("number", [1e-2, 1.0, 1e2, 1e4])
@pytest.mark.parametrize(
    ("integrator", "least"), [("verlet", 0.92), ("kahan-li6", 0.86), ("dop853", 0.66)]
)
def test_the_longest_step_falls_as_the_strike_stiffens_the_chain(
    integrator: str, least: float, number: float
) -> None:
    scene = struck_for_periods(LOADED, number)
    assert least < blow_up(scene, integrator) / limit(scene, integrator) < 1.03


@soak
@pytest.mark.parametrize("integrator", engines.Lammps.integrators)
@pytest.mark.parametrize("number", [1e-2, 10])
def test_both_engines_break_down_at_the_same_step(integrator: str, number: float) -> None:
    scene = struck_for_periods(LOADED, number)
    assert blow_up(scene, integrator, "lammps") == pytest.approx(
        blow_up(scene, integrator), rel=0.02, abs=0
    )


@pytest.mark.parametrize("exponent", [1.5, 2.0])
def test_in_the_vacuum_the_step_scales_with_the_energy(exponent: float) -> None:
    """The law h ~ E^(-(delta-1)/(2 delta+2)) is exact, because there is no other time scale."""
    chain = column(12, gravity=0.0, exponent=exponent)
    speeds = np.array([1e-4, 1e-2]) if exponent == 1.5 else np.array([1e-2, 0.1])
    found = []
    predicted = []
    for v in speeds:
        alone = struck(chain, v, 1e-6)
        scene = Scene(**alone.given() | {"duration": 500 / alone.highest_frequency})
        found.append(blow_up(scene, "verlet"))
        predicted.append(limit(scene, "verlet"))
    power = -(exponent - 1) / (exponent + 1)
    assert np.diff(np.log(found)) / np.diff(np.log(speeds)) == pytest.approx(power, abs=1e-3)
    assert np.array(found) / predicted == pytest.approx(0.93 if exponent == 1.5 else 0.87, abs=0.01)


# --- energy


def hot(number: float, grains: int = 4) -> Scene:
    """Return a loaded chain with random speeds, by default of three moving grains.

    More of them may keep their energy in one place for 1e5 steps and then let go: a trend in a
    million that is none.
    """
    chain = column(grains, gravity=0.0, top_load=1e-2)
    speeds = (
        np.append(np.random.default_rng(1).normal(size=grains - 1), 0.0) * number * speed(chain)
    )
    return scene_of(chain, Profile(velocity=speeds), 1e-3)


STEPS = {"verlet": (0.02, 0.2), "rkn4": (0.05, 0.12), "rkn6": (0.2, 0.4), "kahan-li6": (0.1, 0.3),
         "kahan-li8": (0.25, 0.5)}  # fmt: skip


@pytest.mark.parametrize("integrator", SPLITTINGS)
def test_the_energy_error_has_the_order_of_the_method(integrator: str) -> None:
    """The duration is short, so that all steps give the same motion before chaos sets in."""
    scene = hot(0.2, 8)
    runs = [
        energy_error(scene, integrator, reach / scene.chain.band_edge, 100, 201)
        for reach in np.geomspace(*STEPS[integrator], 5)
    ]
    order = slope([run.step for run in runs], [run.error.std() for run in runs])
    assert order == pytest.approx(METHODS[integrator].order, abs=0.05)


@pytest.mark.slow
@every
def test_the_energy_over_a_million_steps(integrator: str) -> None:
    """Splittings have a bounded fluctuation; the other methods lose or gain energy steadily."""
    scene = hot(0.2)
    reach = {"gear4": 0.1, "dop853": 0.5}.get(integrator, 0.1 * METHODS[integrator].stability_limit)
    steps = 2e5 if integrator == "dop853" else 1e6
    run = energy_error(
        scene, integrator, reach / scene.chain.band_edge, steps * reach / (2 * np.pi)
    )
    assert run.time[-1] / run.step >= steps * 0.999
    rate, sure = run.trend()
    half = run.time.size // 2
    largest = np.abs(run.error[:half]).max()
    if integrator in SPLITTINGS:
        assert abs(rate) < sure
        assert (abs(rate) + sure) * run.time[-1] < largest
        assert np.abs(run.error[half:]).max() < 1.3 * largest
    else:
        assert np.sign(rate) == (-1 if integrator == "dop853" else 1)
        assert abs(rate) > 10 * sure
        assert np.abs(run.error[half:]).max() > 1.8 * largest


@pytest.mark.parametrize(("integrator", "reach"), [("gear4", 0.05), ("dop853", 0.6)])
def test_a_weak_wave_drifts_like_its_modes(integrator: str, reach: float) -> None:
    scene = hot(1e-4)
    run = energy_error(scene, integrator, reach / scene.chain.band_edge, 3000)
    expected = drift(scene, METHODS[integrator].growth, run.step)
    (rate, sure) = run.trend()
    assert sure < 0.1 * abs(rate)
    assert rate == pytest.approx(expected, rel=0.02, abs=0)


def test_the_energy_of_a_sonic_vacuum_has_no_period():
    vacuum = scene_of(
        Chain(grains=4, gravity=0.0, diameter=1e-3), Profile(velocity=[1, 0, 0, 0]), 1e-4
    )
    with pytest.raises(InputError, match="has no band edge"):
        energy_error(vacuum, "rkn6", 1e-8, 10)
    with pytest.raises(InputError, match="excitation: gives the chain no energy"):
        energy_error(struck(LOADED, 0.0, 1e-5), "rkn6", 1e-8, 10)
    with pytest.raises(InputError, match=r"samples: must be 50 or more .* \(got 21\)"):
        energy_error(struck(LOADED, 1e-6, 1e-5), "rkn6", 1e-7, 1, 21).trend()


# --- contacts that open


@cache
def opening(exponent: float) -> tuple[Scene, Reference, float]:
    """Return a strike on 30 beads that opens contacts, its reference, and the reference error."""
    velocity, duration = {1.5: (8.57e-3, 60e-6), 1.25: (8.57e-3, 30e-6), 2.0: (1.0, 60e-6)}[
        exponent
    ]
    chain = column(30, exponent=exponent)
    scene = struck(chain, velocity, duration, 21)
    u, v, own = extended_reference(scene)
    assert (chain.contacts.overlap + chain.contacts.closer(u))[:, 1:-1].min() < 0
    return scene, Reference(scene.time, u, v, own, "extrapolated"), own


@pytest.mark.parametrize(
    ("integrator", "exponent"),
    [("rkn4", 1.5), ("rkn6", 1.5)]
    + [
        pytest.param(*pair, marks=pytest.mark.slow)
        for pair in (("verlet", 1.5), ("kahan-li6", 1.5), ("kahan-li8", 1.5), ("rkn6", 1.25))
    ]
    + [
        pytest.param(*pair, marks=soak) for pair in (("dop853", 1.5), ("gear4", 1.5), ("rkn6", 2.0))
    ],
)
def test_equal_steps_have_the_order_of_the_opening(integrator: str, exponent: float) -> None:
    scene, truth, own = opening(exponent)
    first, last = (2000, 20000) if integrator == "gear4" else (70, 6000)
    counts = np.geomspace(first, last, 10).astype(int)
    errors = errors_through_openings(
        scene, integrator, counts, truth, runs=150 if integrator == "dop853" else 40
    )
    assert errors.min() > 10 * own
    assert -slope(counts, errors) == pytest.approx(
        order_through_openings(integrator, exponent), abs=0.05
    )


@pytest.mark.parametrize("integrator", ["rkn4", "kahan-li6"])
def test_adaptive_steps_keep_the_order(integrator: str) -> None:
    scene, truth, own = opening(1.5)
    counts = np.array([70, 100, 140, 200, 280, 400, 560])
    errors = errors_through_openings(scene, integrator, counts, truth, adaptive=True, runs=1)
    assert errors.min() > 20 * own  # And above rounding errors.
    assert -slope(counts, errors) == pytest.approx(METHODS[integrator].order, abs=0.05)


@pytest.mark.parametrize("integrator", ["rkn6", "kahan-li8", "dop853"])
def test_adaptive_steps_are_of_order_6_or_better(integrator: str) -> None:
    """The error of openings dominates here, and has about the seventh order."""
    scene, truth, own = opening(1.5)
    counts = np.array([50, 70, 100, 140] if integrator == "dop853" else [70, 100, 140, 200])
    errors = errors_through_openings(scene, integrator, counts, truth, adaptive=True, runs=20)
    assert errors.min() > 10 * own
    assert -slope(counts, errors) > 6
