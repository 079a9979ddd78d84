"""Chains of equal grains that are made again and again."""

import pickle

import numpy as np
import pytest

from lmpchain import Chain, Impurity
from lmpchain.chain import recent

FIELDS = {"grains": 40, "diameter": 1e-3}
OTHERS = [
    {"grains": 41}, {"diameter": 2e-3}, {"material": "steel"}, {"gravity": 1.0}, {"exponent": 1.4}, {"top_load": 1.0},
    {"top": "wall"}, {"bottom": "wall"}, {"masses": np.full(40, 1e-6)}, {"contact_constants": np.full(39, 1e9)},
    {"impurity": [Impurity(grain=3, mass=1e-5)]}, {"diameter": np.full(40, 1.1e-3)}, {"material": ["steel"] * 40},
    {"top": "wall", "top_material": "steel"}, {"bottom": "wall", "bottom_material": "steel"},
    {"bottom": "wall", "wall_constants": [0.0, 1e9]},
]  # fmt: skip


def arrays(chain: Chain) -> list[np.ndarray]:
    contacts = chain.contacts
    return [
        chain.masses,
        contacts.constant,
        contacts.force,
        contacts.overlap,
        np.array(chain.band_edge),
    ]


def test_one_made_again_has_the_arrays_of_the_first():
    first, again = Chain(**FIELDS), Chain(**FIELDS)
    assert again.contacts is first.contacts
    assert again.masses is first.masses
    assert again.contact_constants is first.contact_constants
    assert again == first
    assert pickle.loads(pickle.dumps(again)) == first


@pytest.mark.parametrize("other", OTHERS, ids=lambda other: " ".join(other))
def test_any_other_field_makes_arrays_of_its_own(other):
    one = arrays(Chain(**FIELDS))
    beside = arrays(Chain(**FIELDS | other))
    recent._place.cache_clear()
    alone = arrays(Chain(**FIELDS | other))
    assert all(np.array_equal(x, y) for x, y in zip(beside, alone, strict=True))
    assert not all(np.array_equal(x, y) for x, y in zip(beside, one, strict=True))


def test_only_the_latest_are_kept():
    made = [Chain(grains=40 + n, diameter=1e-3) for n in range(recent.KEPT + 1)]
    assert all(chain.contacts.force.size == chain.grains + 1 for chain in made)
    last, first = (Chain(grains=made[n].grains, diameter=1e-3) for n in (-1, 0))
    assert last.contacts is made[-1].contacts
    assert first.contacts is not made[0].contacts
    assert np.array_equal(first.contacts.overlap, made[0].contacts.overlap)
