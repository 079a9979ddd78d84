"""Chains that a theory does not support, parts with two loads, and laws that do not fit a chain."""

from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.faults import faults

from lmpchain import Chain, Law, laws

PRESSED = {"gravity": 0.0, "top_load": 1.0}
PLAIN = column(9, **PRESSED)
IN_TIME = "x does not support a stiffness that changes in time: leave t out of its formula"
# A chain, the check that refuses it, and the fault with its remedy.
REFUSED: list[tuple[Chain, str, str, str]] = [
    (
        *(column(9, load_grain=2, **PRESSED), "refuse_loose", "chain.load_grain"),
        "x is linear, and grain 1 only touches grain 2: let the load act on grain 1",
    ),
    (
        *(column(9, load_grain=4, **PRESSED), "refuse_loose", "chain.load_grain"),
        "x is linear, and grains 1 to 3 only touch: let the load act on grain 1",
    ),
    (
        *(column(9, damping={"drag": 1.0}), "refuse_damping", "chain.damping"),
        "x does not support damping: leave it out, as chain.replace(damping=None) does",
    ),
    (
        *(PLAIN.replace(ground=Law("k*u", k=1e5)), "refuse_ground", "chain.ground"),
        "x does not support a force from the ground: leave it out, as chain.replace(ground=None) "
        "does",
    ),
    (
        *(PLAIN.replace(ground=Law("k*max(u, 0)", k=1e5)), "refuse_ground_without_modes"),
        "chain.ground",
        "x does not support a kink at rest: use a native run",
    ),
]


@pytest.mark.parametrize(("chain", "check", "key", "message"), REFUSED)
def test_a_theory_names_the_property_that_it_does_not_support(
    chain: Chain, check: str, key: str, message: str
) -> None:
    assert faults(getattr(chain, check), "x") == [(key, message)]
    getattr(PLAIN, check)("x")
    # The stiffness of a ground that changes in time is that at t = 0.
    moving = PLAIN.replace(ground=laws.mathieu(1e5, 0.1, 1000.25))
    assert moving.ground_stiffness.tolist() == pytest.approx([1.1e5] * 9, rel=1e-14)
    for refuse in (moving.refuse_moving_ground, moving.refuse_ground_without_modes):
        assert faults(refuse, "x") == [("chain.ground", IN_TIME)]
    # A ground that is smooth and constant does not move, nor does one with a kink.
    PLAIN.replace(ground=Law("k*u", k=1e5)).refuse_ground_without_modes("x")
    PLAIN.replace(ground=Law("k*max(u, 0)", k=1e5)).refuse_moving_ground("x")
    assert PLAIN.conservative
    assert chain.conservative == (key == "chain.load_grain")


def test_a_bond_holds_grains_that_would_only_touch() -> None:
    loose = column(9, load_grain=4, **PRESSED)
    bonded = loose.replace(law=laws.toda(1e6, k=1e5))
    assert (loose.loose_grains, loose.linearisable) == (3, False)
    assert (bonded.loose_grains, bonded.linearisable) == (0, True)
    assert column(9, load_grain=4, top_load=1.0).loose_grains == 0  # Their weight presses them.
    assert not column(9, gravity=0.0).compressed
    assert column(9, gravity=0.0, law=laws.toda(1e6, k=1e5)).compressed
    # The units of length and time are those of the first pressed contact and the grain above it.
    masses = np.linspace(1e-6, 3e-6, 9)
    for chain, first in ((loose, 3), (loose.replace(load_grain=1), 0)):
        of_mass = chain.replace(masses=masses)
        contacts = of_mass.contacts
        assert of_mass.length_scale == contacts.overlap[first + 1]
        scale = np.sqrt(masses[first] / contacts.stiffness[first + 1])
        assert of_mass.time_scale == pytest.approx(scale, rel=1e-15)
    single = column(1, top="wall", bottom="wall", gravity=0.0, top_load=1.0)
    assert single.length_scale == single.contacts.overlap[1]
    assert column(9, gravity=0.0).time_scale == np.inf


def test_loads_of_walls_and_of_held_grains() -> None:
    walled = column(9, top="wall", top_load=0.5)
    assert (walled.wall_load, walled.constant_load) == (0.5, 0.0)
    for chain in (column(9, top_load=0.5), walled.replace(load_grain=2)):
        assert (chain.wall_load, chain.constant_load) == (0.0, 0.5)
    # Contacts above the loaded grain carry only the weight of the grains above them.
    for grain in (1, 2, 3, 8):
        loaded = column(9, top_load=0.5, load_grain=grain, bottom="wall", top="wall").contacts
        weight = 9.81 * walled.masses[0] * np.arange(10)
        carries = np.arange(10) >= (grain if grain > 1 else 0)
        assert loaded.force == pytest.approx(weight + 0.5 * carries, rel=1e-14)
    masses = np.linspace(1e-6, 3e-6, 9)
    assert walled.replace(masses=masses).held_weight == pytest.approx(9.81 * 3e-6, rel=1e-15)
    assert walled.replace(bottom="wall").held_weight == 0.0
    assert walled.load_over_mass == pytest.approx(
        (0.5 + 9.81 * walled.masses[0] * 8) / walled.masses[0], rel=1e-14
    )


def test_a_part_has_one_load() -> None:
    chain = column(9, top_load=0.5, load_grain=4, law=Law("k*o", k=1e6 * np.arange(1, 9)))
    fault = "would have two loads, the weight of the grains above it and the top load"
    for first in (2, 3):
        cure = "begin with grain 1, or with grain 4 or a later one"
        assert faults(chain.part, first, 9) == [("part", f"{fault}: {cure}")]
        assert chain.first_of_part(first) == 1
    for first in (4, 6):
        part = chain.part(first, 8)
        assert chain.first_of_part(first) == first
        assert part.contact_constants.tolist() == chain.contact_constants[first - 1 : 7].tolist()
        # The weight of the grains above is a load.
        weight = 9.81 * chain.masses[: first - 1].sum() + 0.5
        assert (part.top_load, part.load_grain) == (pytest.approx(weight, rel=1e-14), 1)
        inside = slice(first, 8)
        assert part.contacts.overlap[1:-1] == pytest.approx(
            chain.contacts.overlap[inside], rel=1e-14
        )
    for first, last in ((0, 3), (3, 10), (5, 5), (5, 4)):
        ((key, message),) = faults(chain.part, first, last)
        assert (key, message) == (
            "part",
            f"must be two or more of grains 1 to 9 (got {first} to {last})",
        )


MISFITS: list[tuple[dict[str, Any], str, str]] = [
    ({"law": Law("k*u", k=1e5)}, "law.force", "may only depend on the overlap o"),
    ({"law": Law("k*step(o)*(o + 1)")}, "law.force", "replace it by a ramp"),
    ({"law": Law("k*o", k=1e5), "contact_constants": [1e5] * 3}, "contact_constants", "by law.k"),
    ({"law": Law("k*o*c", c=[1.0, 2.0])}, "law.c", "one number, or 3 for 4 grains, not 2"),
    ({"law": Law("k*max(o, 0)**0.6"), "gravity": 0.0}, "law", "by gravity or a load"),
    ({"masses": [1e-300] * 4}, "masses", "are too small or too large to compute with"),
    ({"load_grain": 4, "top_load": 1.0}, "load_grain", "at most 3 of 4 grains, and the last one"),
    ({"load_grain": 5, "top_load": 1.0, "bottom": "wall"}, "load_grain", "at most 4 of 4 grains"),
]


@pytest.mark.parametrize(("fields", "key", "words"), MISFITS)
def test_misfits_of_laws_and_loads_are_named(fields: dict[str, Any], key: str, words: str) -> None:
    ((found, message),) = faults(column, 4, **fields)
    assert found == key
    assert words in message
