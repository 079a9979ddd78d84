"""The tangent map against differences of the same steps in plain NumPy, for every law."""

from typing import Any

import numpy as np
import pytest
from helpers import plain_methods as plain
from helpers.flying_grains import flying, unlike
from helpers.plain_methods import WIDE, Motion

from lmpchain import Drive, Law, Profile, Scene
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.kernels import tangent
from lmpchain.integrators.kernels.layout import PAD
from lmpchain.integrators.kernels.tangent import march
from lmpchain.integrators.methods import RKN4

GRAINS = 5
BETWEEN = {"top": "wall", "bottom": "wall", "top_material": "brass"}
FRACTIONS = np.array([0.05, 0.1, 0.07, 0.13, 0.06, 0.11, 0.08, 0.1, 0.12, 0.18])
CHANGE = WIDE(1e-7)
LAWS: dict[str, dict[str, Any]] = {
    "3/2": {},
    "2.3": {"exponent": 2.3, **BETWEEN},
    "springs": {"exponent": 1.0, **BETWEEN},
    "touching wall": {"top_load": 0.0, **BETWEEN},
    "touching wall, 2": {"top_load": 0.0, "exponent": 2.0, **BETWEEN},
    "formula": BETWEEN,
    "vacuum": {"top_load": 0.0, "gravity": 0.0, **BETWEEN},
    "vacuum, 3": {"top_load": 0.0, "gravity": 0.0, "exponent": 3.0, **BETWEEN},
    "driven": {"drive": 1},
    "driven wall": {"drive": 0, **BETWEEN},
}


def flying_or_driven(law: str) -> Scene:
    """Return a chain of flying grains, or a driven chain."""
    options = LAWS[law] | {}
    place = options.pop("drive", None)
    scene = flying(unlike(GRAINS, **options), 5, (1.0, 2.0), 4, 2)
    if place is None:
        return scene
    u, v = scene.initial()
    u[0] = v[0] = 0
    start = Profile(displacement=u, velocity=v)
    edge = 4 / scene.duration
    amplitude = scene.chain.contacts.overlap.max()
    drive = Drive(amplitude=amplitude, frequency=0.05 * edge, grain=place, start=start)
    return scene.replace(excitation=drive)


@pytest.mark.parametrize("law", LAWS)
def test_deviations_grow_as_differences_of_two_runs(law: str):
    scene = flying_or_driven(law)
    base = plain.column_of(scene)
    motion = Motion(base)
    moving = np.flatnonzero(motion.mobile)
    steps = FRACTIONS * scene.duration
    if law == "formula":
        # The formula states the power 3/2.
        formula = Law("k*max(o, 0)**p", p=[1.5] * (GRAINS - 1))
        scene = scene.replace(chain=scene.chain.replace(law=formula))
    batch = ChainBatch([scene], "exact")
    inverse_mass = batch.arrays.inverse_mass[0]
    assert inverse_mass[PAD + moving] == pytest.approx(1 / scene.chain.masses[moving], rel=1e-15)
    columns = 2 * moving.size + 1  # A changed displacement or velocity, and longer steps.
    dx, dv = np.zeros((2, GRAINS, columns))
    unit = float(np.abs(motion.x).max()), float(np.abs(motion.v).max())
    for column, grain in enumerate(moving):
        dx[grain, column], dv[grain, moving.size + column] = unit
    stretch = np.zeros(columns)
    driven = motion.wall or motion.driven
    stretch[-1] = not driven  # The time of a forcing remains unchanged.
    x, v = np.zeros((2, inverse_mass.size))
    x[PAD : PAD + GRAINS] = motion.x
    v[PAD : PAD + GRAINS] = motion.v
    path = np.empty(0)
    body = PAD
    if driven:
        offsets = np.array([*np.cumsum(RKN4.drifts[:-1]), 1.0])
        begins = np.cumsum(steps) - steps
        times = np.append(0.0, (begins[:, None] + steps[:, None] * offsets).ravel())
        path = scene.excitation.waveform.at(times)
        body = PAD - 1 + scene.excitation.grain
    nodes = np.zeros((2, steps.size + 1, GRAINS))
    states = []
    for sign in (0, 1, -1):
        many = [np.repeat(field[None], columns, 0) for field in (motion.x, motion.v)]
        each = np.array([WIDE(h) * (1 + sign * CHANGE * stretch)[:, None] for h in steps])
        for column, grain in enumerate(moving):
            many[0][column, grain] += sign * CHANGE * WIDE(unit[0])
            many[1][moving.size + column, grain] += sign * CHANGE * WIDE(unit[1])
        other = Motion(base._replace(displacement=many[0], velocity=many[1]))
        if driven:
            each = [WIDE(h) for h in steps]
        states.append(plain.by_splitting(other, RKN4, each))
    march(
        batch.arrays,
        inverse_mass,
        tangent.BodyRow(x, v),
        tangent.Deviations(dx, dv, stretch),
        tangent.TangentSteps(np.array(RKN4.kicks), np.array(RKN4.drifts), steps),
        tangent.Held(body, path),
        nodes,
    )
    for order, field in enumerate(nodes):
        true = states[0][:, order, 0].astype(float)
        columns_seen = moving if driven else slice(None)
        scale = np.abs(true).max()
        assert np.abs(field - true)[:, columns_seen].max() < 1e-13 * scale
    slopes = (states[1][-1] - states[2][-1]) / (2 * CHANGE)  # Shape (2, columns, N).
    for order, field in enumerate((dx, dv)):
        true = slopes[order].T
        assert np.abs(field - true)[moving].max() < 1e-9 * np.abs(true).max()
        assert np.abs(true[moving][:, -1]).max() > 0.1 * np.abs(true).max() or driven
    assert x[PAD : PAD + GRAINS][moving] == pytest.approx(nodes[0, -1][moving], rel=1e-15)


def test_a_flight_of_many_steps_accumulates_no_rounding():
    """A grain that flies alone through 10^5 steps ends at the exact position."""
    scene = flying_or_driven("vacuum")
    batch = ChainBatch([scene], "exact")
    inverse_mass = batch.arrays.inverse_mass[0]
    links = batch.arrays._replace(
        strength=0 * batch.arrays.strength, uncompressed=0 * batch.arrays.uncompressed
    )
    x, v = np.zeros((2, inverse_mass.size))
    v[PAD + 2] = 0.1
    steps = np.full(100_000, 1e-7)
    none = np.zeros((GRAINS, 0))
    march(
        links,
        inverse_mass,
        tangent.BodyRow(x, v),
        tangent.Deviations(none, none.copy(), np.zeros(0)),
        tangent.TangentSteps(np.array([0.5, 0.5]), np.array([1.0]), steps),
        tangent.Held(0, np.empty(0)),
        np.zeros((2, steps.size + 1, GRAINS)),
    )
    assert x[PAD + 2] == pytest.approx(0.1 * 1e-7 * 100_000, rel=3e-16)
