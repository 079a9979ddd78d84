"""Scenes and chains as keys of a dictionary, by their values."""

import pickle
from copy import deepcopy
from typing import Any

import numpy as np
import pytest

from lmpchain import GLASS, STEEL, Chain, Drive, Force, Impulse, Impurity, Packet, Profile, Scene

COLUMN = Chain(grains=4, diameter=1e-3)
WAVE = Profile(velocity=[0.0, 1e-9, 0.0, 0.0])
SCENE = Scene(chain=COLUMN, excitation=WAVE, duration=1e-5)
PAIRS: list[tuple[Any, Any]] = [
    (GLASS, GLASS.replace(name="glass")),
    (COLUMN, Chain(grains=4, diameter=1e-3, gravity=9.81, material="glass")),
    (COLUMN, COLUMN.replace(masses=COLUMN.masses)),
    (COLUMN.replace(diameter=[1e-3] * 4), COLUMN.replace(diameter=np.full(4, 1e-3))),
    (WAVE, Profile(velocity=[-0.0, 1e-9, -0.0, 0])),
    (Impulse(velocity=0.0), Impulse(velocity=-0.0, grain=1)),
    (Force(times=[0, 1], force=[0, 1]), Force(times=np.arange(2), force=(0.0, 1.0))),
    (Drive(amplitude=1, frequency=2), Drive(amplitude=1.0, frequency=2.0, grain=1)),
    (SCENE, Scene(chain=COLUMN, excitation=WAVE, duration=1e-5, samples=101, grains="all")),
    (SCENE, deepcopy(SCENE)),
    (SCENE, pickle.loads(pickle.dumps(SCENE))),
    (Impurity(grain=2, material="steel"), Impurity(grain=2, material=STEEL)),
]


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_equal_values_are_one_key(one: Any, other: Any):
    assert one == other
    assert hash(one) == hash(other)
    assert {one: "found"}[other] == "found"


def test_different_values_are_different_keys():
    values = [
        COLUMN,
        COLUMN.replace(diameter=1.1e-3),
        COLUMN.replace(material="steel"),
        COLUMN.replace(impurity=[Impurity(grain=2, material="steel")]),
        WAVE,
        Profile(displacement=WAVE.velocity),
        Packet(frequency=1e3, width=3, grain=2, amplitude=1e-9),
        SCENE,
        SCENE.replace(samples=102),
        SCENE.replace(grains=[1, 2]),
        SCENE.replace(duration=1.1e-5),
        SCENE.replace(excitation=Impulse(velocity=1e-9)),
        SCENE.replace(chain=COLUMN.replace(top="wall")),
        SCENE.replace(chain=COLUMN.replace(bottom="wall")),
    ]
    assert len(set(values)) == len(values)
    assert len({hash(value) for value in values}) == len(values)
