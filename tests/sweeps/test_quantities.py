"""Stored quantities of each scene: units, and numbers compared with Hertz's law."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import scene_of
from helpers.taylor_series import reference

from lmpchain import Chain, Impulse, InputError, Scene, simulate, sweep
from lmpchain.measure.energy import shares
from lmpchain.sweeps.file import read_sweep
from lmpchain.sweeps.quantities import (
    QUANTITIES,
    add_rest,
    leave_out_unsure,
    of_contact,
    quantity,
    with_gathered,
)
from lmpchain.sweeps.tasks import scenes

UNITS = {  # Unit and dimensions.
    "displacement": ("m", "time", "grain"),
    "velocity": ("m s-1", "time", "grain"),
    "peak_displacement": ("m", "grain"),
    "peak_velocity": ("m s-1", "grain"),
    "arrival_time": ("s", "grain"),
    "energy": ("J", "time"),
    "grain_energy": ("J", "time", "grain"),
    "contact_energy": ("J", "time", "grain"),
    "wall_force": ("N",),
}
GRAINS = [3, 4, 7]
CHAIN = Chain(grains=12, diameter=1e-3)
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=2e-3), duration=4e-5, samples=41)
ASKED = {
    "scene": SCENE.replace(grains=GRAINS).to_dict(),
    "keep": [*QUANTITIES, "peak_force:4"],
    "grid": {"chain.gravity": [9.81]},
}


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("quantities")
    return sweep(ASKED, folder).load()


@pytest.fixture(scope="module")
def whole() -> Any:
    """Return the scene with all grains recorded at many times."""
    return simulate(SCENE.replace(samples=4001), "native", 1e-10)


def test_every_quantity_has_its_unit_and_dimensions(swept: Any):
    assert UNITS.keys() == QUANTITIES.keys()
    for name, (unit, *dimensions) in UNITS.items():
        array = swept[name]
        assert array.attrs["units"] == unit
        assert array.dims == ("chain.gravity", *dimensions)
        whole = name in ("displacement", "velocity")
        assert (f"{name}_error" in swept) != whole
        if not whole:
            error = swept[f"{name}_error"]
            assert (error.attrs["units"], error.dims) == (unit, array.dims)
            text = f"uncertainty of {name} by sampling and by the error of the solution"
            assert error.attrs["long_name"] == text
    force = swept["peak_force_4"]
    assert (force.attrs["units"], force.dims) == ("N", ("chain.gravity",))
    assert force.attrs["long_name"].endswith("contact 4")
    for name, what in (("model", "the equation that was solved"), ("solver", "its solution")):
        title = f"estimated relative error of {what}"
        assert swept[f"{name}_error"].attrs == {"units": "1", "long_name": title}
    assert swept.reason.attrs == {"units": "1", "long_name": "why there is no result"}
    assert swept.time.attrs == {"units": "s", "long_name": "time since the strike"}
    assert swept.grain.attrs == {"units": "1", "long_name": "number of the grain, from the top"}
    assert swept.attrs == {"engine": "native", "tolerance": 1e-6}
    assert swept.grain.values.tolist() == GRAINS
    assert "downward" in swept.velocity.attrs["long_name"]
    assert "positive downward" in swept.displacement.attrs["long_name"]


def energies(run: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return kinetic energy of grains and energy of contacts above rest, (T, N) and (T, N-1) J."""
    chain = run.scene.chain
    kinetic = chain.masses * run.velocity**2 / 2
    rest = chain.equilibrium_overlap
    overlap = np.maximum(rest - np.diff(run.displacement), 0.0)
    force = chain.contact_constants * rest**1.5
    held = chain.contact_constants * (overlap**2.5 - rest**2.5) / 2.5 - force * (overlap - rest)
    return kinetic, held


def test_the_energy_is_that_of_recorded_grains_and_contacts(swept: Any, whole: Any):
    """If grains 3, 4 and 7 are recorded, only the contact between 3 and 4 is included."""
    kinetic, held = energies(whole)
    rows = slice(None, None, 100)
    of_grains = kinetic[rows][:, [2, 3, 6]].sum(1)
    expected = of_grains + held[rows, 2]
    size = expected.max()
    assert swept.energy[0].values == pytest.approx(expected, abs=2e-5 * size)
    assert held[rows, 3].max() > 0.01 * size
    error = swept.energy_error[0].values
    assert (np.abs(swept.energy[0].values - expected) <= error + 1e-9 * size).all()
    assert error.max() < 1e-3 * size


def test_energies_of_grains_and_contacts(swept: Any, whole: Any):
    kinetic, held = energies(whole)
    rows = slice(None, None, 100)
    size = kinetic.max()
    for place, grain in enumerate(GRAINS):
        below = held[rows, grain - 1]
        assert swept.contact_energy[0, :, place].values == pytest.approx(below, abs=1e-4 * size)
        share = kinetic[rows, grain - 1] + (held[rows, grain - 1] + held[rows, grain - 2]) / 2
        assert swept.grain_energy[0, :, place].values == pytest.approx(share, abs=1e-4 * size)


def test_errors_of_energies_are_those_of_their_grains_and_contacts(swept: Any):
    """The error of a sum is the sum of the errors of all recorded grains and contacts."""
    plan = read_sweep(ASKED)
    (scene,) = scenes(plan, 0, 1, together=False)
    assert isinstance(scene, Scene)
    energy = shares(simulate(scene))
    grains = np.searchsorted(energy.grain, GRAINS)
    below = energy.elastic_error[:, np.searchsorted(energy.contact, GRAINS)]
    whole = energy.kinetic_error[:, grains].sum(1) + below[:, 0]
    for name, error in (
        ("energy", whole),
        ("grain_energy", energy.of_grain_error[:, grains]),
        ("contact_energy", below),
    ):
        np.testing.assert_allclose(swept[f"{name}_error"][0], error, rtol=1e-6, atol=0)
    assert np.median(below[1:, 0] / whole[1:]) > 1e-3


def test_peaks_include_the_motion_between_samples(swept: Any, whole: Any):
    for name, motion in (("displacement", whole.displacement), ("velocity", whole.velocity)):
        peak = np.abs(motion[:, [2, 3, 6]]).max(0)
        found = swept[f"peak_{name}"][0].values
        assert found == pytest.approx(peak, rel=2e-4)
        assert (np.abs(found - peak) <= swept[f"peak_{name}_error"][0].values + 1e-6 * peak).all()
    overlap = CHAIN.equilibrium_overlap - np.diff(whole.displacement)
    force = CHAIN.contact_constants * np.maximum(overlap, 0.0) ** 1.5
    assert swept.peak_force_4.item() == pytest.approx(force[:, 3].max(), rel=1e-6)
    # The weight of the fixed grain is included.
    held = force[:, -1].max() + 9.81 * CHAIN.masses[-1]
    assert swept.wall_force.item() == pytest.approx(held, rel=1e-3)
    assert swept.wall_force_error.item() < 0.01 * swept.wall_force.item()


def test_the_front_arrives_at_half_of_the_peak(swept: Any):
    from lmpchain.measure.front import track

    alone = track(simulate(SCENE, "native", 1e-9))
    for place, grain in enumerate(GRAINS):
        (row,) = np.flatnonzero(alone.grain == grain)
        assert swept.arrival_time[0, place].item() == pytest.approx(alone.time[row], rel=1e-5)
    # The error is that of the same run in a table of fronts.
    (scene,) = scenes(read_sweep(ASKED), 0, 1, together=False)
    assert isinstance(scene, Scene)
    same = track(simulate(scene))
    rows = np.searchsorted(same.grain, GRAINS)
    errors = swept.arrival_time_error[0].values
    np.testing.assert_allclose(errors, same.time_error[rows], rtol=1e-6, atol=0)


def test_names_of_forces_of_contacts():
    assert of_contact("peak_force:4")
    for name in ("peak_force", "peak_force:", "peak_force:x", "peak_force:0.5", "wall_force"):
        assert not of_contact(name)
    assert not of_contact("force:4")
    assert quantity("velocity") is QUANTITIES["velocity"]
    assert quantity("peak_force:12").long_name.endswith(" 12")
    gathered = SCENE.replace(quantities=["peak_force:3", "peak_velocity"])
    wider = with_gathered(gathered, ["velocity", "peak_force:3", "peak_force:5"], True)
    assert wider.quantities == ("peak_force:3", "peak_velocity", "peak_force:5")
    assert with_gathered(gathered, ["velocity", "peak_force:3"], True) is gathered
    with pytest.raises(InputError, match="numbered 1 to 11"):
        with_gathered(SCENE, ["peak_force:12"], True)


def test_laws_and_times_are_labelled(tmp_path: Path):
    disorder = {"seed": 1, "realisations": 2, "chain.masses": {"low": 1e-6, "high": 2e-6}}
    disorder |= {"chain.contact_constants": {"low": 1e8, "high": 2e8}}
    asked = {"scene": SCENE.to_dict(), "keep": ["wall_force"], "disorder": disorder}
    found = sweep(asked, tmp_path)
    masses = found["chain.masses"]
    constants = found["chain.contact_constants"]
    assert masses.shape == (2, 12)
    assert constants.shape == (2, 11)
    assert masses.attrs == {"units": "1", "long_name": "drawn for every grain"}
    assert constants.attrs == {"units": "1", "long_name": "drawn for every contact"}
    assert masses.dims == ("realisation", "chain.masses.entry")
    assert found.realisation.values.tolist() == [0, 1]


@pytest.mark.parametrize("bottom", ["fixed", "wall"])
def test_quantities_between_distant_samples_are_stored(bottom: str, tmp_path: Path):
    """Contacts open, and the wave reaches the bottom, between two of six samples."""
    chain = Chain(grains=20, diameter=1e-3, bottom=bottom)
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.5), duration=6e-5, samples=6)
    names = ["wall_force", "peak_velocity", "peak_displacement", "arrival_time"]
    asked = {"scene": scene, "keep": names, "grid": {"excitation.velocity": [0.1, 0.5]}}
    kept = sweep(asked, tmp_path).load()
    for number, velocity in enumerate((0.1, 0.5)):
        struck = scene.replace(excitation=Impulse(velocity=velocity), samples=6001)
        best, doubt = reference(struck, 1e-14)
        assert doubt < 1e-9
        last = chain.movable
        bodies = np.pad(best.displacement.astype(float), ((0, 0), (0, 1)))
        contact = chain.contacts.of(np.array([last]))
        closer = bodies[:, last - 1] - (bodies[:, last] if bottom == "wall" else 0.0)
        force = contact.force_at(contact.overlap + closer).max()
        force += chain.masses[last:].sum() * chain.gravity
        row = kept.isel({kept.wall_force.dims[0]: number})
        truths = {
            "wall_force": force,
            "peak_velocity": np.abs(best.velocity).max(0),
            "peak_displacement": np.abs(best.displacement).max(0),
        }
        for name, truth in truths.items():
            value = row[name].values
            error = row[f"{name}_error"].values
            # The fixed grain has no motion, so that accuracy is undefined.
            assert np.atleast_1d(error <= 0.1 * np.abs(value))[:last].all()
            # The largest of 6001 samples has an error of 1e-5.
            assert (np.abs(value - truth) <= error + 1e-5 * truth).all(), name
        times = row.arrival_time.values
        assert np.isfinite(times).sum() > 10


TAPER = scene_of(
    Chain(grains=12, diameter=1e-3 * 0.95 ** np.arange(12), bottom="wall"),
    Impulse(velocity=0.05),
    3e-3,
    2,
)


def test_quantities_known_before_chaos_are_stored(tmp_path: Path):
    """A wall force at 0.02 ms was once lost, because the motion is unknown after 1.5 ms."""
    kept = ["wall_force", "peak_velocity", "peak_displacement", "velocity"]
    durations = [TAPER.duration, 1e-5]
    scene = TAPER.replace(samples=4).to_dict()
    plan = {"scene": scene, "keep": kept, "grid": {"recording.duration": durations}}
    results = sweep(plan, tmp_path).load()
    assert "amplifies round-off" in str(results.reason[0].values)
    assert results.reason[1] == ""
    for row, duration in enumerate(durations):
        times = np.linspace(0.0, duration, 4)
        np.testing.assert_allclose(results.time[row], times, rtol=1e-12)
    early = TAPER.replace(duration=1.4e-3, samples=28001)
    truth, _ = reference(early, 1e-14)
    overlap = TAPER.chain.contacts.overlap[-1] + truth.displacement[:, -1]
    force = TAPER.chain.wall_constants[1] * max(overlap.max(), 0.0) ** 1.5
    error = float(results.wall_force_error[0])
    assert float(results.wall_force[0]) == pytest.approx(force, rel=1e-5, abs=error)
    assert error < 1e-3 * force
    speeds = np.abs(truth.velocity).max(0)
    assert results.peak_velocity[0].values == pytest.approx(speeds, rel=1e-3)
    # Grain 1 flies on, so that its maxima over all times are unknown.
    assert np.isnan(results.peak_displacement[0, 0])
    assert np.isnan(results.velocity[0]).all()


def test_quantities_with_a_large_error_are_omitted_with_the_reason(tmp_path: Path):
    """The continuum engine accumulates no quantities."""
    scene = scene_of(Chain(grains=60, diameter=1e-3), Impulse(velocity=1e-7), 5e-5, 4)
    plan = {"scene": scene.to_dict(), "engine": "continuum", "tolerance": 1e-3}
    plan |= {"keep": ["velocity", "peak_velocity"], "grid": {"chain.gravity": [9.81]}}
    results = sweep(plan, tmp_path).load()
    assert "too far apart to show peak_velocity" in str(results.reason[0].values)
    assert np.isnan(results.peak_velocity).any()
    assert np.isfinite(results.velocity).all()


def test_the_rest_of_a_run_makes_values_unsure():
    """A value differs by the difference of two runs; one that the other run lacks is unknown."""
    nan = np.nan
    arrays = {
        "arrival_time": np.array([1.0, 2.0, 3.0, 4.0, nan]),
        "arrival_time_error": np.array([0.1, 0.1, 0.1, 0.1, nan]),
        "peak_force_3": np.array(2.0),
        "peak_force_3_error": np.array(0.125),
    }
    whole = {"arrival_time": np.array([1.0, 2.25, 3.5, nan, nan]), "peak_force_3": np.array(2.0625)}
    add_rest(arrays, whole)
    np.testing.assert_allclose(arrays["arrival_time_error"], [0.1, 0.35, 0.6, nan, nan])
    assert arrays["peak_force_3_error"] == 0.1875
    # The limit is a tenth of the largest value, 0.4.
    assert leave_out_unsure(arrays, ["arrival_time", "peak_force:3"]) == ["arrival_time"]
    np.testing.assert_allclose(arrays["arrival_time"], [1.0, 2.0, nan, nan, nan])
    np.testing.assert_allclose(arrays["arrival_time_error"], [0.1, 0.35, nan, nan, nan])
    assert arrays["peak_force_3"] == 2.0
    arrays["peak_force_3_error"] = np.array(0.201)
    assert leave_out_unsure(arrays, ["peak_force:3"]) == ["peak_force:3"]
    assert np.isnan(arrays["peak_force_3"])
