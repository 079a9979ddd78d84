"""Quantities accumulated during a run.

Two samples are enough for peaks, arrivals and forces at full resolution.
"""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from helpers.example_scenes import run, scene_of, stirred
from helpers.independent_integrators import extended_reference
from scipy.optimize import brentq

from lmpchain import (
    Chain,
    Displacement,
    Drive,
    Force,
    Impulse,
    InputError,
    Scene,
    Stopped,
    Trajectory,
    engines,
    resume,
    simulate,
    simulate_many,
)
from lmpchain.disorder.averages import ensemble
from lmpchain.engines.linear import engine as linear
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.simulation.run_folder import status
from lmpchain.stability.roundoff import measured_floor
from lmpchain.stability.step_limit import blow_up

OF_GRAINS = ["peak_velocity", "peak_displacement", "arrival_time"]
ALL = [*OF_GRAINS, "peak_force:4", "force:4"]
# Grain 2 is fixed, which makes an oscillator.
PAIR = Chain(grains=2, diameter=1e-3, gravity=0.0, top_load=10.0, exponent=1.0)
OMEGA = PAIR.band_edge
COLUMN = Chain(grains=30, diameter=1e-3)
STRUCK = scene_of(COLUMN, Impulse(velocity=8.57e-3), 6e-5, 2, quantities=ALL)
WEAK = STRUCK.replace(excitation=Impulse(velocity=1e-8))


def off(gathered: dict, name: str, truth: np.ndarray | float) -> np.ndarray:
    """Return the ratio of true to stated error of accumulated quantities."""
    return np.abs(gathered[name] - truth) / gathered[f"{name}_error"]


@pytest.mark.parametrize("engine", ["native", "modes", "chebyshev", "lammps"])
def test_an_oscillator_whose_samples_are_nodes(engine: str):
    """All quantities are known exactly, and no sample shows them."""
    length = 1e-9
    scene = scene_of(
        PAIR,
        Displacement(displacement=length),
        7.25 * 2 * np.pi / OMEGA,
        2,
        quantities=[*OF_GRAINS, "peak_force:1", "force:1"],
    )
    found = simulate(scene, engine, 1e-6).gathered
    rest = 10.0
    stiffness = float(PAIR.linear_stiffness[0])
    assert off(found, "peak_velocity", np.array([length * OMEGA, 0.0]))[0] < 1
    assert off(found, "peak_displacement", np.array([length, 0.0]))[0] < 1
    assert off(found, "arrival_time", np.pi / 2 / OMEGA)[0] < 1
    assert np.isnan(found["arrival_time"][1])
    assert off(found, "peak_force:1", rest + stiffness * length) < 1
    assert (
        off(found, "force:1", rest + stiffness * length * np.cos(OMEGA * found["fine_time"])) < 1
    ).all()
    assert found["peak_velocity_error"][0] < 3e-6 * length * OMEGA
    assert found["arrival_time_error"][0] < 1e-5 / OMEGA
    assert found["peak_force:1_error"] < 3e-6 * stiffness * length


@pytest.mark.filterwarnings("ignore:Eq. ")
@pytest.mark.parametrize("engine", ["modes", "chebyshev"])
def test_a_linear_motion_has_the_force_of_the_contact_law(engine: str):
    pair = PAIR.replace(exponent=1.5)
    start = Displacement(displacement=0.3 * float(pair.equilibrium_overlap[0]))
    asked = ["peak_force:1", "force:1"]
    found = run(pair, start, 20 / pair.band_edge, 2, engine=engine, quantities=asked).gathered
    exact = 10.0 * (1 + 0.3 * np.cos(pair.band_edge * found["fine_time"])) ** 1.5
    np.testing.assert_allclose(found["force:1"], exact, rtol=1e-9)
    assert found["peak_force:1"] == pytest.approx(10.0 * 1.3**1.5, rel=1e-9)


@pytest.mark.parametrize("exponent", [1.0, 1.25, 1.5, 2.0, 3.0])
def test_a_grain_that_bounces_off_a_wall(exponent: float):
    """The contact stores all of the energy at one moment.

    F = K x^delta, K x^(delta + 1) / (delta + 1) = m v^2 / 2.
    """
    chain = Chain(grains=1, diameter=1e-3, gravity=0.0, bottom="wall", exponent=exponent)
    mass = chain.masses[0]
    constant = chain.wall_constants[1]
    speed = 0.1
    deepest = ((exponent + 1) * mass * speed**2 / 2 / constant) ** (1 / (exponent + 1))
    scene = scene_of(
        chain,
        Impulse(velocity=speed),
        5 * deepest / speed,
        2,
        quantities=["peak_force:1", "peak_velocity"],
    )
    found = simulate(scene, "native", 1e-9).gathered
    assert off(found, "peak_force:1", constant * deepest**exponent) < 1
    assert found["peak_force:1_error"] < 2e-3 * constant * deepest**exponent
    assert off(found, "peak_velocity", speed)[0] < 1


@pytest.mark.parametrize("engine", ["native", "modes"])
def test_a_resonance_has_many_fronts_until_the_last_is_known(engine: str):
    """The motion is v = F/2m t sin(omega t).

    The first maximum that is half of the largest is one of some hundred.
    """
    force = 1e-6
    end = 100.3 * np.pi
    scene = scene_of(
        PAIR,
        Force(grain=1, amplitude=force, frequency=OMEGA / (2 * np.pi)),
        end / OMEGA,
        2,
        quantities=["peak_velocity", "arrival_time"],
    )
    tops = np.array(
        [
            brentq(lambda x: np.sin(x) + x * np.cos(x), k * np.pi + 1.5, (k + 1) * np.pi)
            for k in range(100)
        ]
    )
    sizes = np.abs(tops * np.sin(tops)) * force / (2 * PAIR.masses[0] * OMEGA)
    found = simulate(scene, engine, 1e-7).gathered
    assert off(found, "peak_velocity", sizes.max())[0] < 1
    assert off(found, "arrival_time", tops[np.argmax(sizes >= sizes.max() / 2)] / OMEGA)[0] < 1
    assert found["arrival_time_error"][0] < 1e-4 / OMEGA


ACTING = {
    "force": Force(grain=3, shape="half-sine", amplitude=1e-4, duration=1.03e-5),
    "burst": Drive(amplitude=1e-9, frequency=1e5, cycles=1.3),
    "points": Drive(times=np.linspace(0, 2e-5, 4), displacement=[0, 1e-9, -1e-9, 2e-9]),
    "wall": Drive(amplitude=1e-9, frequency=1e5, cycles=1.3, grain=0),
}


@pytest.mark.parametrize(
    "what",
    [
        pytest.param(what, marks=pytest.mark.slow if what in ("burst", "wall") else ())
        for what in ACTING
    ],
)
def test_accumulated_quantities_of_forced_chains(what: str):
    """Grain 1 or a wall is driven, or a grain is pushed.

    Their contacts and neighbours, too.
    """
    chain = Chain(grains=6, diameter=1e-3)
    chain = chain.replace(top="wall", top_load=0.01) if what == "wall" else chain
    near = 0 if what == "wall" else 1
    asked = ["peak_velocity", "peak_displacement", f"peak_force:{near}", f"force:{near}"]
    scene = Scene(chain=chain, excitation=ACTING[what], duration=2e-5, samples=2, quantities=asked)
    found = simulate(scene, "native", 1e-9).gathered
    u, v, own = extended_reference(
        Scene(**scene.given() | {"samples": 20 * (scene.fine.samples - 1) + 1})
    )
    missed = 8e-5  # Relative error of a peak between two of these samples.
    for name, x in (("peak_velocity", v), ("peak_displacement", u)):
        most = np.abs(x).max(axis=0)
        error = found[f"{name}_error"] + own * np.abs(x).max()
        assert (most <= found[name] + error).all()
        assert (found[name] <= most * (1 + missed) + error).all()
    above = ACTING[what].waveform.at(np.linspace(0, 2e-5, len(u))) if what == "wall" else u[:, 0]
    contact = chain.contacts.of(np.array([near]))
    force = contact.force_at(contact.overlap + above - u[:, near])
    assert (
        np.abs(found[f"force:{near}"] - force[::20])
        <= found[f"force:{near}_error"] + 1e-9 * force.max()
    ).all()
    error = found[f"peak_force:{near}_error"]
    assert -error <= found[f"peak_force:{near}"] - force.max() <= error + missed * np.ptp(force)


@pytest.mark.parametrize(
    "engine", ["native", "modes", "chebyshev", pytest.param("lammps", marks=pytest.mark.slow)]
)
@pytest.mark.filterwarnings("ignore:Eq. ")
def test_interruptions_after_every_block_do_not_change_the_bits(
    engine: str, tmp_path: Path, monkeypatch
):
    scene = WEAK if engine in ("modes", "chebyshev") else STRUCK
    monkeypatch.setattr(linear, "BLOCK", 4)
    monkeypatch.setattr(linear, "SMALL_BLOCK", 1)
    whole = simulate(scene, engine, 1e-6)
    monkeypatch.setattr(stepping_run, "BLOCK_S", 1e-9)
    stops = 0
    while True:
        limit = 1e-9 if stops < 2 else None
        try:
            if not stops:
                found = simulate(scene, engine, 1e-6, folder=tmp_path / "run", max_wall=limit)
            else:
                found = resume(tmp_path / "run", max_wall=limit)
            break
        except Stopped:
            stops += 1
            assert status(tmp_path / "run")["samples_done"] == 1  # The run is between two samples.
    assert stops == 2
    assert found.gathered.keys() == whole.gathered.keys()
    for name, values in whole.gathered.items():
        assert np.array_equal(found.gathered[name], values, equal_nan=True), name
    assert np.array_equal(np.asarray(found.velocity), whole.velocity)


def test_accumulated_quantities_are_stored_in_files(tmp_path: Path):
    t = simulate(STRUCK, "native", folder=tmp_path / "run")
    t.save(tmp_path / "run.nc")
    again = Trajectory.load(tmp_path / "run.nc")
    assert again == t
    assert again.gathered.keys() == t.gathered.keys() > set(ALL)
    data = again.to_xarray()
    assert data["peak_velocity"].dims == ("grain",)
    assert data["force_4"].dims == data["force_4_error"].dims == ("fine_time",)
    assert data["peak_force_4"].attrs == {
        "units": "N",
        "long_name": "largest force at any time of contact 4",
    }
    STRUCK.to_toml(tmp_path / "scene.toml")
    assert Scene.from_toml(tmp_path / "scene.toml") == STRUCK
    other = simulate(STRUCK.replace(quantities=["peak_velocity"]), "native")
    assert other != t


def test_recorded_grains_and_the_light_cone():
    """Only the grains that the wave can reach are computed; all others are at rest."""
    chain = COLUMN.replace(grains=400)
    whole = STRUCK.replace(chain=chain)
    some = STRUCK.replace(
        chain=chain, grains=[7, 3, 350], quantities=[*ALL, "peak_force:399", "force:399"]
    )
    every = simulate(whole, "native")
    few = simulate(some, "native")
    assert every.cost.active_grains < 400
    for name in OF_GRAINS:
        assert np.array_equal(few.gathered[name], every.gathered[name][[6, 2, 349]], equal_nan=True)
    assert few.displacement.shape == (2, 3)
    assert few.gathered["peak_velocity"][2] == 0.0
    assert few.gathered["force:399"] == pytest.approx(chain.contacts.force[399], rel=1e-12)
    assert few.gathered["peak_force:4"] == every.gathered["peak_force:4"]


def test_a_batch_accumulates_in_the_whole_chain():
    """The wave reaches 111 of 200 grains, around the struck grain."""
    chain = Chain(grains=200, diameter=1e-3, gravity=0.0, top_load=0.05, top="wall", bottom="wall")
    struck = [Impulse(velocity=velocity, grain=100) for velocity in (1e-5, 2e-5)]
    names = [*OF_GRAINS, "peak_force:95", "force:95"]
    asked = {"duration": 4e-5, "samples": 41, "quantities": names}
    scenes = [Scene(chain=chain, excitation=strike, **asked) for strike in struck]
    assert 100 < scenes[0].reached.chain.grains < 140
    for scene, t in zip(scenes, simulate_many(scenes, 1e-6), strict=True):
        alone = simulate(scene, "native")
        within = scene.excitation.velocity * 1e-6
        np.testing.assert_allclose(t.velocity, alone.velocity, rtol=0, atol=within)
        for name in names:
            one, other = t.gathered[name], alone.gathered[name]
            known = np.isfinite(other)
            assert known.any()
            assert np.array_equal(np.isfinite(one), known)
            errors = t.gathered[f"{name}_error"] + alone.gathered[f"{name}_error"]
            assert (np.abs(one - other) <= errors)[known].all()


def test_invalid_requests_are_rejected_in_one_line():
    chain = Chain(grains=200, diameter=1e-3)
    scene = scene_of(chain, Impulse(velocity=1e-8), 3e-5, quantities=["peak_velocity"])
    for name in ("bessel", "continuum"):
        with pytest.raises(
            InputError, match=f"quantities: {name} does not compute accelerations .* use native"
        ):
            simulate(scene, name)


def test_studies_of_methods_accumulate_nothing():
    """The steps of these studies are between samples."""
    plain = WEAK.ungathered
    assert plain.quantities == ()
    assert WEAK.fine.samples > plain.fine.samples == 2
    assert measured_floor(WEAK) == measured_floor(plain)
    assert blow_up(WEAK, "rkn4") == blow_up(plain, "rkn4")
    one, other = (ensemble(scene, 5, 3, 1, "native") for scene in (WEAK, plain))
    assert np.array_equal(one.velocity, other.velocity)


def test_auto_accumulates_quantities():
    hardly = Impulse(velocity=1e-16)
    long = WEAK.replace(excitation=hardly, duration=30 * WEAK.duration)
    t = simulate(long, tolerance=1e-9)
    assert t.equation == 3
    assert t.gathered["peak_velocity"][0] == pytest.approx(1e-16, rel=1e-3)


@pytest.mark.slow
def test_accumulation_needs_the_memory_of_its_results():
    """All samples together would take a gigabyte."""
    size = 50_000
    chain = Chain(grains=size, diameter=1e-3, gravity=0.0, top_load=1.0)
    start = stirred(chain, 1e-3)
    scene = scene_of(chain, start, 1.6e-4, 2, quantities=["peak_velocity"])
    assert 16 * size * scene.fine.samples > 4e8
    simulate(STRUCK, "native")
    tracemalloc.start()
    try:
        t = simulate(scene, engines.Native("rkn4", step=2e-7))
        assert tracemalloc.get_traced_memory()[1] < 1.5e8
    finally:
        tracemalloc.stop()
    assert t.displacement.nbytes + t.velocity.nbytes == 32 * size
    assert (t.gathered["peak_velocity"] >= np.abs(start.velocity)).all()
