"""Tables of measures that depend on time: a column for each grain, contact or order."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import run

from lmpchain import Impulse, Trajectory
from lmpchain.measure import contact, dyson, energy
from lmpchain.measure.fit.inverse import ParameterFit, Trace

GRAINS = [3, 1, 2, 5, 4]
TIME = np.arange(3) * 1e-6
VALUES = np.arange(6.0).reshape(3, 2)


@pytest.fixture(scope="module")
def damped() -> Trajectory:
    chain = column(6, damping={"viscoelastic": 1e-7, "drag": 1e3})
    return run(chain, Impulse(velocity=1e-3), 2e-5, 9, 1e-6, grains=GRAINS)


def fitted(_: Trajectory) -> ParameterFit:
    trace = Trace(TIME, [4, 2], VALUES, "force")
    scene: Any = None
    return ParameterFit("top_load", 1.0, 0.1, trace, 2 * VALUES, 0.1, scene, 20)


CONTACTS = [1, 2, 3, 4, 5]
# The measure; the name of each array with its unit, the words of its columns, and their numbers.
TABLES: dict[str, tuple[Callable[[Trajectory], Any], dict[str, tuple[str, str, list[Any]]]]] = {
    "shares": (
        energy.shares,
        {
            "kinetic": ("J", "kinetic", GRAINS),
            "elastic": ("J", "elastic_contact", CONTACTS),
            "of_grain": ("J", "of_grain", GRAINS),
        },
    ),
    "losses": (
        energy.losses,
        {
            "of_contact": ("J", "of_contact", [0, *CONTACTS, 6]),
            "of_grain": ("J", "of_grain", [1, 2, 3, 4, 5, 6]),
        },
    ),
    "contacts": (
        contact.contacts,
        {
            "overlap": ("m", "overlap_contact", CONTACTS),
            "closing": ("m/s", "closing_contact", CONTACTS),
            "force": ("N", "force_contact", CONTACTS),
            "change": ("N", "change_contact", CONTACTS),
        },
    ),
    "sensor": (
        lambda t: contact.sensor(t, 3),
        {"force": ("N", "force", [3]), "change": ("N", "change_force", [3])},
    ),
    "orders": (
        lambda t: dyson.sums(t, [2.0, 0.5]),
        {
            "as_printed": ("m/s", "as_printed", ["2", "0.5"]),
            "normalised": ("m/s", "normalised", ["2", "0.5"]),
        },
    ),
    "a fit": (fitted, {"model": ("N", "force_fitted", [4, 2])}),
}


@pytest.mark.parametrize("name", TABLES)
def test_columns_are_named_by_numbers_with_units(name: str, damped: Trajectory) -> None:
    """Every number has its column, in the order of the arrays, behind the times."""
    measure, arrays = TABLES[name]
    found = measure(damped)
    frame = found.to_dataframe()
    time = TIME if name == "a fit" else damped.time
    expected = {"time [s]": time}
    if name == "a fit":
        expected |= {"force_4 [N]": VALUES[:, 0], "force_2 [N]": VALUES[:, 1]}
    for array, (unit, words, numbers) in arrays.items():
        values = np.asarray(getattr(found, array))
        values = values.T if name == "orders" else values.reshape(time.size, -1)
        for number, each in zip(numbers, values.T, strict=True):
            expected[f"{words}_{number} [{unit}]"] = each
    assert list(frame.columns) == list(expected)
    for key, values in expected.items():
        assert np.array_equal(frame[key], values, equal_nan=True)
