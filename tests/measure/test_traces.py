"""Traces of a run by name: forces, motion and energies of grains and walls."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import run
from helpers.faults import faults

from lmpchain import Drive, Impulse
from lmpchain.measure.energy import ledger
from lmpchain.measure.traces import gather

PLACES = ["top", 3, "wall", "bottom"]


@pytest.mark.parametrize(
    ("ends", "wall", "places"),
    [
        ({"bottom": "wall"}, 5, PLACES),
        ({}, 4, PLACES),
        ({"bottom": "free", "gravity": 0.0}, 0, ["top", 3, "wall"]),
    ],
    ids=["wall", "fixed", "free"],
)
def test_forces_of_sensors_and_walls(ends: dict[str, Any], wall: int, places: list[Any]) -> None:
    """A sensor measures the mean of two forces K o^(3/2); "wall" is the bottom, or else the top."""
    chain = column(5, top="wall", **ends)
    t = run(chain, Impulse(velocity=1e-4, grain=2), 2e-5, 11)
    still = np.zeros((11, 1))
    u = np.hstack((still, t.displacement, still))
    contacts = chain.contacts
    force = contacts.constant * np.maximum(contacts.overlap + u[:, :-1] - u[:, 1:], 0.0) ** 1.5
    change = force - force[0]
    held = chain.masses[-1] * 9.81 if wall == 4 else 0.0
    columns = {"top": [0], 3: [2, 3], "wall": [wall], "bottom": [wall]}
    size = np.abs(change).max()
    plain, above = (gather(t, force=places, above_rest=rest) for rest in (False, True))
    assert list(plain.traces) == [f"force_{place}" for place in places]
    assert list(above.traces) == [f"change_force_{place}" for place in places]
    for place in places:
        weight = held if place in ("wall", "bottom") else 0.0
        seen = plain.traces[f"force_{place}"]
        near = columns[place]
        assert seen == pytest.approx(force[:, near].mean(1) + weight, abs=1e-9 * size)
        seen = above.traces[f"change_force_{place}"]
        assert seen == pytest.approx(change[:, near].mean(1), abs=1e-9 * size)
    assert set(plain.units.values()) == {"N"}
    one = gather(t, force="wall").traces
    assert np.array_equal(one["force_wall"], plain.traces["force_wall"])


def test_motion_and_energies_are_columns_with_units() -> None:
    """Motion and energies are those of the run; a place that was not recorded is rejected."""
    chain = column(6, top="wall", damping={"drag": 1e3})
    shaker = Drive(grain=0, amplitude=1e-9, frequency=1e5)
    t = run(chain, shaker, 2e-5, 41, grains=[5, 2, 3, 4, 1])
    table = gather(t, velocity=3, displacement=np.array([5, 2]), energy=True)
    terms = ledger(t)
    expected = {
        "time [s]": t.time,
        "velocity_3 [m/s]": t.velocity[:, 2],
        "displacement_5 [m]": t.displacement[:, 0],
        "displacement_2 [m]": t.displacement[:, 1],
        "energy_kinetic [J]": terms.kinetic,
        "energy_total [J]": terms.total,
        "energy_drive [J]": terms.drive,
        "energy_dissipated [J]": terms.dissipated,
    }
    frame = table.to_dataframe()
    assert list(frame.columns) == list(expected)
    for name, values in expected.items():
        assert np.array_equal(frame[name], values)
        assert np.any(values)
    for choice, key, words in (
        ({}, "force", "at least one force"),
        ({"force": "left"}, "force", "must be grains or wall, top, bottom"),
        ({"force": 7}, "force", "does not exist"),
        ({"force": 2.5}, "force", ""),
        ({"velocity": 6}, "velocity", "grain 6 was not recorded"),
        ({"displacement": [2, 6]}, "displacement", "grain 6 was not recorded"),
        ({"energy": 1}, "energy", ""),
    ):
        ((found, message),) = faults(gather, t, **choice)
        assert found == key
        assert words in message
