"""The map of a damped chain against Taylor series, and its tangent against differences."""

import numpy as np
import pytest
from helpers.flying_grains import unlike
from helpers.taylor_series import reference

from lmpchain import Damping, Drive, Force, Profile, Scene
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.kernels.damped_tangent import Body, ImposedStages, RungeKutta, march
from lmpchain.integrators.kernels.layout import PAD
from lmpchain.integrators.kernels.tangent import BodyRow, Deviations
from lmpchain.integrators.methods import DormandPrince

GRAINS = 5
STEPS = 60
NODES, _, (_, WEIGHTS), INNER = DormandPrince().tables
METHOD = RungeKutta(np.ascontiguousarray(INNER), np.ascontiguousarray(WEIGHTS))
DAMPING = Damping(viscoelastic=2e-7, drag=np.linspace(1e3, 4e3, GRAINS))
CHAIN = unlike(GRAINS, top="wall", damping=DAMPING)
PERIOD = 1 / CHAIN.band_edge
LENGTH = CHAIN.contacts.overlap[1:-1].min()
FORCING = {
    "none": None,
    "force": Force(amplitude=0.01, frequency=0.1 / PERIOD, grain=3),
    "drive": Drive(amplitude=0.2 * LENGTH, frequency=0.1 / PERIOD, grain=1),
    "wall": Drive(amplitude=0.2 * LENGTH, frequency=0.1 / PERIOD, grain=0),
}


def moving(kind: str) -> Scene:
    """Return a damped chain in motion; a force starts from rest."""
    rng = np.random.default_rng(5)
    u = 0.1 * LENGTH * rng.uniform(-1, 1, GRAINS)
    v = 0.1 * LENGTH / PERIOD * rng.uniform(-1, 1, GRAINS)
    u[-1] = v[-1] = 0.0  # The last grain is fixed.
    forcing = FORCING[kind]
    if forcing is None:
        excitation = Profile(displacement=u, velocity=v)
    elif kind == "force":
        excitation = forcing
    else:
        first = forcing.grain
        u[:first] = v[:first] = 0.0
        excitation = forcing.replace(start=Profile(displacement=u, velocity=v))
    return Scene(chain=CHAIN, excitation=excitation, duration=4 * PERIOD, samples=2)


def creep(scene: Scene, u: np.ndarray, wall: float) -> np.ndarray:
    """Return the velocity minus the reduced velocity (N,)."""
    bodies = np.concatenate(([wall], u, [0.0]))
    closer = bodies[:-1] - bodies[1:]
    contacts = scene.chain.contacts
    overlap = np.maximum(contacts.overlap + closer, 0)
    force = contacts.constant * overlap**scene.chain.exponent - contacts.force
    viscous = scene.chain.contact_viscosity * force
    return (viscous[:-1] - viscous[1:]) / scene.chain.masses - scene.chain.drag * u


def advance(
    scene: Scene, u: np.ndarray, w: np.ndarray, longer: float = 0.0, columns: int = 0
) -> tuple[np.ndarray, Deviations]:
    """Return displacements and reduced velocities (2, N) at the end, and final deviations."""
    batch = ChainBatch([scene], "exact")
    inverse_mass = batch.arrays.inverse_mass[0]
    x, rates = np.zeros((2, inverse_mass.size))
    x[PAD : PAD + GRAINS] = u
    rates[PAD : PAD + GRAINS] = w
    steps = np.full(STEPS, scene.duration / STEPS)
    begin = np.cumsum(steps) - steps
    kind = scene.excitation.kind
    values = np.zeros((0, 0))
    if kind in ("drive", "force"):
        values = scene.excitation.waveform.at(begin[:, None] + steps[:, None] * NODES)
    place = PAD - 1 + (scene.excitation.grain if kind in ("drive", "force") else 0)
    dx, dw = np.zeros((2, GRAINS, columns))
    for column in range(columns - 1):
        (dx if column < GRAINS else dw)[column % GRAINS, column] = 1.0
    stretch = np.zeros(columns)
    stretch[-1:] = 1.0  # The last column is a relative change of the steps.
    deviations = Deviations(dx, dw, stretch)
    nodes = np.zeros((2, STEPS + 1, GRAINS))
    body = Body(inverse_mass, scene.chain.contact_viscosity, scene.chain.drag)
    course = ImposedStages(place, kind == "force", values)
    motion = BodyRow(x, rates)
    march(batch.arrays, body, motion, deviations, METHOD, steps * (1 + longer), course, nodes)
    assert np.array_equal(nodes[:, -1], [x[PAD : PAD + GRAINS], rates[PAD : PAD + GRAINS]])
    return nodes[:, -1], deviations


def wall_at(scene: Scene, time: float) -> float:
    """Return the displacement of the top wall."""
    moved = scene.excitation.kind == "drive" and scene.excitation.grain == 0
    return float(scene.excitation.waveform.at(np.array([time]))[0]) if moved else 0.0


@pytest.mark.parametrize("kind", FORCING)
def test_the_map_follows_the_damped_motion(kind: str):
    scene = moving(kind)
    u, v = (np.array(field) for field in scene.initial())
    free = np.flatnonzero(ChainBatch([scene]).arrays.inverse_mass[0][PAD : PAD + GRAINS])
    (x, w), _ = advance(scene, u, v - creep(scene, u, 0.0))
    end = scene.duration
    true, _ = reference(scene, 1e-17)
    x[np.setdiff1d(np.arange(GRAINS), free)] = true.displacement[-1][
        np.setdiff1d(np.arange(GRAINS), free)
    ]
    velocity = w + creep(scene, x, wall_at(scene, end))
    assert x[free] == pytest.approx(true.displacement[-1][free], rel=0, abs=1e-8 * true.largest[0])
    assert velocity[free] == pytest.approx(
        true.velocity[-1][free], rel=0, abs=1e-7 * true.largest[1]
    )


@pytest.mark.parametrize("kind", FORCING)
def test_the_tangent_is_the_derivative_of_the_map(kind: str):
    scene = moving(kind)
    u, v = (np.array(field) for field in scene.initial())
    w = v - creep(scene, u, 0.0)
    free = np.flatnonzero(ChainBatch([scene]).arrays.inverse_mass[0][PAD : PAD + GRAINS])
    _, deviations = advance(scene, u, w, columns=2 * GRAINS + 1)
    found = np.array([deviations.x, deviations.v])
    sizes = [1e-5 * LENGTH, 1e-5 * LENGTH / PERIOD]
    for order, size in enumerate(sizes):
        for grain in free:
            state = [
                np.array([u, w])
                + sign * size * (np.arange(2) == order)[:, None] * (np.arange(GRAINS) == grain)
                for sign in (1, -1)
            ]
            forth, back = (advance(scene, *each)[0] for each in state)
            slope = (forth - back) / (2 * size)
            column = order * GRAINS + grain
            for row in range(2):
                largest = np.abs(slope[row, free]).max()
                assert found[row, free, column] == pytest.approx(
                    slope[row, free], rel=0, abs=1e-6 * largest
                )
    if kind == "none":  # A longer step leaves the times of a forcing unchanged.
        forth, back = (advance(scene, u, w, longer=sign * 1e-5)[0] for sign in (1, -1))
        slope = (forth - back) / 2e-5
        for row in range(2):
            largest = np.abs(slope[row, free]).max()
            assert found[row, free, -1] == pytest.approx(
                slope[row, free], rel=0, abs=1e-6 * largest
            )


def test_a_chain_that_is_its_own_mirror_image_has_such_a_tangent():
    """The first and the last grain of a chain between two walls obey the same equation."""
    chain = CHAIN.replace(diameter=2e-3, gravity=0.0, bottom="wall", damping={"viscoelastic": 2e-7})
    rest = np.zeros(GRAINS)
    excitation = Profile(displacement=rest, velocity=rest + 1e-9)
    scene = Scene(chain=chain, excitation=excitation, duration=4 * PERIOD, samples=2)
    _, deviations = advance(scene, rest, rest, columns=2 * GRAINS + 1)
    for field in (deviations.x, deviations.v):
        for columns in (field[:, :GRAINS], field[:, GRAINS:-1]):
            largest = np.abs(columns).max()
            assert columns == pytest.approx(columns[::-1, ::-1], rel=0, abs=1e-13 * largest)
