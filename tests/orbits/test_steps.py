"""Steps along a family in the linear limit, where it is straight, and changes of a chain."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from lmpchain import Chain, orbits
from lmpchain.orbits import Family, Orbit

CHAIN = Chain(grains=4, diameter=1e-3, gravity=0.0, top_load=1.0)


@cache
def small() -> Orbit:
    u, period = orbits.linear_mode(CHAIN, 2, 1e-7)
    rest = np.zeros(4)
    return orbits.find(CHAIN, (u, rest), period, energy=float(CHAIN.excess_energy(u, rest)))


def amplitudes(until: float, **given: Any) -> tuple[Family, np.ndarray]:
    """Return the family up to a multiple of the amplitude, and its relative amplitudes."""
    family = orbits.follow(small(), "energy", until**2 * small().energy, **given)
    return family, np.sqrt(family.energy / small().energy)


@pytest.mark.parametrize("events", [True, False])
def test_steps_grow_with_the_orbit_up_to_a_fraction(events: bool):
    """The first step is a fifth of the orbit; easy steps double, up to 0.4 of it."""
    family, sizes = amplitudes(12.0, events=events)
    expected = [1.0]
    length = 0.2
    while True:
        length = min(length, 0.4 * expected[-1])
        if expected[-1] + length > 12.0:
            break
        expected.append(expected[-1] + length)
        length *= 2
    assert sizes == pytest.approx([*expected, 12.0], rel=1e-4)
    assert family.reached
    assert (family.ended, family.parameter, family.events) == ("", "energy", ())
    assert family.value == pytest.approx(family.energy, rel=1e-12)
    assert family.value[-1] == pytest.approx(144 * small().energy, rel=1e-10)
    assert family.period == pytest.approx(np.full(len(family), small().period), rel=1e-6)


def test_steps_go_down_as_well():
    _, sizes = amplitudes(0.3, events=False)
    assert sizes == pytest.approx([1.0, 0.8, 0.48, 0.3], rel=1e-3)


def test_an_interrupted_family_states_its_position():
    family, sizes = amplitudes(12.0, points=3)
    assert sizes == pytest.approx([1.0, 1.2, 1.6], rel=1e-4)
    energy = family.energy[-1]
    period = family.period[-1]
    assert (
        family.ended
        == f"the limit of 3 orbits is reached at energy {energy:.6g} (period {period:.6g} s)"
    )
    heavier = orbits.follow(
        small(), lambda m: CHAIN.replace(masses=m * CHAIN.masses), 2.0, start=1.0, points=1
    )
    assert (
        heavier.ended
        == f"the limit of 1 orbits is reached at the parameter 1 (period {small().period:.6g} s)"
    )
    assert heavier.parameter == "parameter"
