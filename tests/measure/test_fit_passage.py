"""The front, velocity and force of any run, against its samples ten times as dense."""

import numpy as np
import pytest
from helpers.example_scenes import run

from lmpchain import Chain, Drive, Force, Impulse, Trajectory
from lmpchain.measure.fit import fit_passage
from lmpchain.measure.fit import overview as module
from lmpchain.measure.fit.overview import FrontPassage
from lmpchain.measure.fit.table import FittedNumber
from lmpchain.measure.front import Front
from lmpchain.measure.motion import Peaks

CHAIN = Chain(grains=40, material="steel", diameter=10e-3, gravity=0.0, top_load=20.0)
EXCITATIONS = {
    "push": Force(grain=1, times=[0.0, 2e-5, 4e-5], force=[0.0, 150.0, 0.0]),
    "drive": Drive(amplitude=1e-8, frequency=5e3, cycles=2),
    "strike": Impulse(velocity=0.1),
    "strike in the middle": Impulse(grain=15, velocity=0.1),
    "strike from below": Impulse(grain=39, velocity=-0.1),
}


def ran(name: str, samples: int) -> Trajectory:
    return run(CHAIN, EXCITATIONS[name], 4e-4, samples, 1e-9)


@pytest.mark.parametrize("name", EXCITATIONS)
def test_front_velocity_and_force_agree_with_dense_samples(name: str):
    found = {row.quantity: row for row in fit_passage(ran(name, 801)).rows()}
    dense = ran(name, 16001)
    speeds = np.abs(dense.velocity)
    (arrival,) = (row for row in found.values() if row.quantity.startswith("arrival"))
    grain = int(arrival.quantity.split()[-1])
    (column,) = np.flatnonzero(dense.grains == grain)
    # The front is the first maximum above half of the largest speed of the grain.
    own = speeds[:, column]
    rises = (own[1:-1] >= own[:-2]) & (own[1:-1] > own[2:]) & (own[1:-1] > own.max() / 2)
    step = dense.time[1]
    first = dense.time[1 + np.argmax(rises)]
    assert arrival.value == pytest.approx(first, abs=step + arrival.error)
    largest = next(row for row in found.values() if row.quantity.startswith("largest velocity"))
    assert largest.value == pytest.approx(speeds.max(), rel=1e-4)
    # F = a overlap^(3/2), with the overlap at rest from the load.
    law = CHAIN.contacts.of(np.arange(1, 40))
    overlap = law.overlap - np.diff(dense.displacement, axis=1)
    force = (law.constant * np.maximum(overlap, 0.0) ** 1.5).max(axis=0)
    contact = 1 + int(np.argmax(force))
    sampled = found[f"largest sampled force, contact {contact}"]
    assert sampled.value == pytest.approx(force.max(), rel=2e-3)
    speed = next(row for row in found.values() if row.quantity.startswith("mean speed"))
    ends = [int(word) for word in speed.quantity.replace("grains ", "").split() if word.isdecimal()]
    assert ends[1] == grain
    assert 0.9 * 600 < speed.value < 800


@pytest.mark.parametrize(
    ("time", "first", "last"),
    [
        ([0, 1, 2, 4, 7], 0, 4),
        ([7, 4, 2, 1, 0.5], 4, 0),
        ([2, 1, 3, 4, 6], 1, 4),
        ([5, 3, 1, 2, 6], 2, 4),
        ([6, 5, 2, 1, 3, 4], 3, 0),
        ([3], 0, 0),
    ],
)
def test_the_front_goes_its_longest_way(time: list[float], first: int, last: int):
    """Mean speed over the longer way from the first grain, with the errors of both times."""
    size = len(time)
    grain = np.arange(4, 4 + 2 * size, 2)
    passed = 1e-5 * np.array(time)
    error = 1e-7 * np.arange(1, 1 + size)
    one = np.ones(size)
    front = Front("velocity", grain, 0.01 * grain**1.1, passed, one, one, error, one, one)
    peaks = Peaks(np.array([2, 5, 7]), np.array([0.1, 0.3, 0.2]), np.array([1e-3, 2e-3, 3e-3]))
    rows = [
        FittedNumber(
            "front", f"arrival at grain {grain[last]}", passed[last], error[last], unit="s"
        ),
        FittedNumber("front", "largest velocity, grain 5", 0.3, 2e-3, unit="m/s"),
        FittedNumber("front", "largest sampled force, contact 9", 12.5, unit="N"),
    ]
    found = list(FrontPassage(front, peaks, 9, 12.5).rows())
    if size > 1:
        speed = found.pop(1)
        assert speed.quantity == f"mean speed, grains {grain[first]} to {grain[last]}"
        duration = passed[last] - passed[first]
        value = abs(0.01 * (grain[last] ** 1.1 - grain[first] ** 1.1)) / duration
        assert speed.value == pytest.approx(value, rel=1e-12)
        assert speed.error == pytest.approx(value * error[[first, last]].sum() / duration, rel=1e-9)
        assert speed.unit == "m/s"
    assert [row.cells() for row in found] == [row.cells() for row in rows]
    *_, final = FrontPassage(front, peaks, -1, -np.inf).rows()
    assert final.cells() == rows[1].cells()


def test_forces_of_blocks_of_contacts_equal_those_of_all(monkeypatch: pytest.MonkeyPatch):
    t = ran("push", 401)
    whole = fit_passage(t)
    monkeypatch.setattr(module, "CONTACTS_AT_ONCE", 7)
    again = fit_passage(t)
    assert (again.contact, again.force) == (whole.contact, whole.force)
