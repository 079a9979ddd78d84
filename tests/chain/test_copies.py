"""A changed copy is checked and independent of the original; nothing else changes a value."""

import copy
import pickle

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import struck
from helpers.faults import faults

from lmpchain import (
    GLASS,
    Chain,
    Displacement,
    Drive,
    Impulse,
    Impurity,
    InputError,
    Profile,
    Scene,
    simulate,
)

ARRAYS = (
    *("masses", "contact_constants", "wall_constants", "diameters", "contact_lengths", "depths"),
    *("equilibrium_force", "equilibrium_overlap", "linear_stiffness"),
)


def used() -> Chain:
    """Return a chain after computing everything that is computed on first use."""
    chain = column(
        6, bottom="wall", masses=np.full(6, 2e-6), impurity=[Impurity(grain=2, mass=1e-6)]
    )
    assert chain.band_edge > 0
    assert all(getattr(chain, name).size for name in ARRAYS)
    return chain


def scene(chain: Chain) -> Scene:
    return struck(chain, 1e-3, 2e-5, 5)


@pytest.mark.parametrize(
    "changed",
    [
        lambda chain: chain.replace(gravity=98.1),
        lambda chain: chain.model_copy(update={"gravity": 98.1}),
        lambda chain: chain.model_copy(update={"gravity": 98.1}, deep=True),
        lambda chain: chain.copy(update={"gravity": 98.1}),
    ],
    ids=["replace", "model_copy", "model_copy deep", "copy"],
)
def test_a_changed_copy_of_a_used_chain_moves_like_a_new_chain(changed):
    before = used()
    after = changed(before)
    afresh = Chain(**before.given() | {"gravity": 98.1})
    assert after == afresh
    assert after.band_edge == afresh.band_edge > before.band_edge
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(after, name), getattr(afresh, name))
    moved, expected = (simulate(scene(chain), "native", 1e-9) for chain in (after, afresh))
    np.testing.assert_array_equal(moved.velocity, expected.velocity)


def test_a_changed_copy_of_a_used_scene_is_a_new_scene():
    before = scene(used())
    assert np.isfinite(
        [before.strike_number, before.highest_frequency, before.energy, before.largest_strain]
    ).all()
    chain = before.chain.replace(gravity=0.0, top_load=1.0)
    after = before.replace(
        chain=chain, duration=1e-5, excitation=before.excitation.replace(velocity=1e-2)
    )
    afresh = struck(chain, 1e-2, 1e-5, 5)
    assert after == afresh
    for name in ("strike_number", "highest_frequency", "energy", "largest_strain"):
        assert getattr(after, name) == getattr(afresh, name) != getattr(before, name)


@pytest.mark.parametrize(
    ("value", "changes", "key"),
    [
        (used(), {"gravity": -1.0}, "gravity"),
        (used(), {"grains": 7}, "masses"),
        (used(), {"gravty": 1.0}, "gravty"),
        (scene(used()), {"duration": -1.0}, "duration"),
        (scene(used()), {"excitation": Impulse(velocity=1e-3, grain=7)}, "grain"),
        (GLASS, {"poissons_ratio": 0.7}, "poissons_ratio"),
        (Drive(amplitude=1e-9, frequency=1e3), {"frequency": 0.0}, "frequency"),
        (Profile(velocity=[1.0, 0.0]), {"velocity": [np.nan, 0.0]}, "velocity"),
    ],
)
def test_a_changed_copy_is_checked(value, changes, key):
    for change in (value.replace, lambda **fields: value.model_copy(update=fields)):
        assert faults(change, **changes)[0][0] == key


def test_none_resets_an_optional_field():
    assert column(3, masses=[1e-6] * 3).replace(masses=None) == column(3)


@pytest.mark.parametrize(
    "value",
    [used(), scene(used()), GLASS, Impulse(velocity=1.0), Displacement(displacement=1e-9)],
    ids=type,
)
def test_checks_cannot_be_circumvented(value):
    field = next(iter(type(value).model_fields))
    for wrong in (
        lambda: setattr(value, field, -1),
        lambda: setattr(value, "colour", "red"),
        lambda: delattr(value, field),
        lambda: type(value).model_construct(**value.given()),
        lambda: value.copy(exclude={field}),
    ):
        with pytest.raises(InputError, match="replace") as caught:
            wrong()
        assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="unknown key"):
        type(value).model_validate(value.given() | {"colour": "red"})


@pytest.mark.parametrize(
    "copied",
    [
        lambda x: x,
        copy.copy,
        copy.deepcopy,
        lambda x: x.model_copy(deep=True),
        lambda x: pickle.loads(pickle.dumps(x)),
    ],
    ids=["itself", "copy", "deepcopy", "model_copy", "pickle"],
)
def test_arrays_of_a_chain_cannot_be_written_to(copied):
    for chain in (
        used(),
        Chain(grains=4, diameter=[1e-3, 2e-3, 1e-3, 2e-3], top="wall", top_load=1e-3),
    ):
        other = copied(chain)
        assert other == chain
        for name in ARRAYS:
            with pytest.raises(ValueError, match="read-only"):
                getattr(other, name)[0] = 1.0
    profile = copied(Profile(velocity=[1.0, 0.0]))
    with pytest.raises(ValueError, match="read-only"):
        profile.velocity[0] = 2.0


def test_arrays_of_the_user_are_copied():
    masses = np.full(3, 1e-6)
    moved = np.zeros(3)
    times = np.array([0.0, 1e-5])
    chain = column(3, masses=masses)
    profile = Profile(displacement=moved)
    drive = Drive(times=times, displacement=times)
    masses[1] = 5.0
    moved[0] = 1.0
    times[1] = 1.0
    assert chain.masses[1] == 1e-6
    assert profile.displacement[0] == 0
    assert drive.times[1] == drive.displacement[1] == 1e-5
