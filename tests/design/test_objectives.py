"""Objectives and gradients with contact openings, against differences and accurate runs."""

from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck

from lmpchain import Drive, Impulse, InputError, simulate
from lmpchain.design import (
    ArrivalTime,
    DriveWork,
    Energy,
    Function,
    KineticEnergy,
    Misfit,
    Momentum,
    PeakForce,
    gradient,
    parameters,
)
from lmpchain.design.gradients import at_step
from lmpchain.design.parameters import changed
from lmpchain.engines import Native
from lmpchain.integrators.differentiation import method_for
from lmpchain.integrators.methods import SPLITTINGS
from lmpchain.measure.energy import shares


def square(time, u, v):
    return (
        float((u**2).sum() + (time[:, None] * v).sum()),
        2 * u,
        np.broadcast_to(time[:, None], v.shape),
    )


STRUCK = struck(column(8, top_load=0.02, bottom="wall", exponent=1.7), 5e-3, 2e-5, 9)
DRIVEN = STRUCK.replace(
    excitation=Drive(
        times=np.linspace(0, 2e-5, 6),
        displacement=2e-8 * np.sin(np.arange(6) / 4) ** 2,
        interpolation="spline",
    ),
)
BETWEEN_WALLS = STRUCK.chain.replace(top="wall")
DAMPED = {"damping": {"viscoelastic": 1e-7, "drag": 3e3}}
VACUUM = STRUCK.replace(
    chain=STRUCK.chain.replace(top_load=0.0, gravity=0.0), excitation=Impulse(velocity=0.1)
)
OBJECTIVES = {
    "peak force": (STRUCK, PeakForce(3)),
    "peak force at a wall": (STRUCK, PeakForce(8, sharpness=30)),
    "energy": (STRUCK, Energy([2, 3, 4], time=1e-5)),
    "energy with a wall": (
        STRUCK.replace(chain=BETWEEN_WALLS),
        Energy([1, 2, 7, 8]),
    ),
    "energy in a vacuum": (VACUUM, Energy([1, 2], time=2.5e-6)),
    "kinetic energy": (STRUCK, KineticEnergy([2, 3, 4], time=1e-5)),
    "momentum": (STRUCK, Momentum([2, 5])),
    "arrival": (STRUCK, ArrivalTime(4, 1e-3)),
    "misfit": (STRUCK, Misfit([3, 6], np.full((9, 2), 1e-3), scale=1e-4)),
    "misfit of displacements": (STRUCK, Misfit([3], np.full((9, 1), 1e-9), "displacement", 1e-9)),
    "work": (DRIVEN, DriveWork()),
    "peak force with damping": (STRUCK.replace(chain=STRUCK.chain.replace(**DAMPED)), PeakForce(3)),
    "work with damping": (DRIVEN.replace(chain=STRUCK.chain.replace(**DAMPED)), DriveWork()),
    "work against a wall": (DRIVEN.replace(chain=BETWEEN_WALLS), DriveWork()),
    "function": (DRIVEN, Function(square, [1, 4])),
}


@pytest.mark.parametrize("case", OBJECTIVES)
def test_objectives_have_the_derivatives_that_differences_show(rng: np.random.Generator, case: str):
    scene, objective = OBJECTIVES[case]
    names = ["masses", "contact_constants"] + ["drive"] * (scene.drive is not None)
    names += ["top_load"] * scene.chain.compressed
    names += ["damping.viscoelastic", "damping.drag"] * scene.chain.damped
    method = method_for(scene, names, "rkn4")
    _, gradients, _ = at_step(scene, objective, names, method, 2e-7)
    step = 1e-5
    for name in names:
        base = parameters.values(scene, name)
        along = rng.uniform(-1, 1, base.size) * np.abs(base).max()
        if name == "drive":
            along[0] = 0  # The change starts with 0.
        values = []
        for sign in (-2, -1, 1, 2):
            other = changed(scene, {name: base + sign * step * along})
            values.append(at_step(other, objective, [name], method, 2e-7)[0])
        slope = (8 * (values[2] - values[1]) - (values[3] - values[0])) / (12 * step)
        assert gradients[name] @ along == pytest.approx(
            slope, rel=1e-7, abs=1e-9 * abs(values[0])
        ), name


@pytest.mark.parametrize("group", [[2, 3, 4], [1, 2, 3, 4, 5, 6, 7, 8]])
def test_energy_equals_the_measured_energy_of_a_part(group: list[int]):
    run = simulate(STRUCK, engine=Native(integrator="dop853"), tolerance=1e-10)
    found = gradient(STRUCK, Energy(group), ["masses"], 1e-7)
    assert found.value == pytest.approx(shares(run).part(group[0], group[-1])[-1], rel=1e-8)


def test_weak_waves_lose_no_digits_of_the_energy():
    """Energies and their derivatives are quadratic: 1e-20 for a strike weaker by 1e10."""
    names = ["masses", "contact_constants", "top_load"]
    values = [
        at_step(
            STRUCK.replace(excitation=Impulse(velocity=v)),
            Energy([2, 3]),
            names,
            SPLITTINGS["rkn6"],
            1e-7,
        )
        for v in (1e-9, 1e-19)
    ]
    assert values[1][0] == pytest.approx(1e-20 * values[0][0], rel=1e-6)
    for name in names:
        np.testing.assert_allclose(values[1][1][name], 1e-20 * values[0][1][name], rtol=1e-5)


def test_a_moving_wall_is_rejected():
    chain = column(6, top_load=0.02, top="wall", bottom="wall")
    wall = Drive(grain=0, amplitude=2e-7, frequency=2e5)
    scene = scene_of(chain, wall, 1e-5, 7)
    for objective in (PeakForce(0), Energy([1, 2])):
        with pytest.raises(InputError, match="moving wall"):
            gradient(scene, objective, ["masses"])
    with pytest.raises(InputError, match="grain 1 is driven"):
        gradient(scene, DriveWork(), ["masses"])
    assert gradient(scene, Energy([2, 3]), ["masses"], 1e-3).value > 0


@pytest.mark.parametrize("case", ["peak force", "energy", "arrival", "work"])
def test_error_estimates_cover_the_errors(case: str):
    scene, objective = OBJECTIVES[case]
    names = ["masses", "contact_constants", "diameters"]
    true = gradient(scene, objective, names, 1e-10, integrator="rkn6")
    for tolerance in (1e-3, 1e-5, 1e-7):
        found = gradient(scene, objective, names, tolerance)
        assert found.error <= tolerance
        for name in names:
            off = np.abs(found[name] - true[name]).max()
            assert off <= found.errors[name] + true.errors[name]
        assert abs(found.value - true.value) <= found.value_error + true.value_error


def test_a_peak_is_a_maximum():
    found = gradient(STRUCK, PeakForce(3, sharpness=1000), ["top_load"], 1e-4)
    dense = STRUCK.replace(samples=4001)
    run = simulate(dense, "native", 1e-9)
    contacts = dense.chain.contacts
    force = contacts.force_at(contacts.overlap + contacts.closer(run.displacement))[:, 3]
    assert found.value == pytest.approx(force.max(), rel=1e-3)
    assert found.value < force.max()


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("mass", {}),
        ("top_load", {"top_load": 0.0, "gravity": 0.0}),
        ("wall_constants", {"bottom": "fixed"}),
        ("amplitude", {}),
        ("drive", {}),
    ],
)
def test_objectives_without_derivatives_are_rejected_by_name(name: str, change: dict[str, Any]):
    with pytest.raises(InputError) as error:
        gradient(STRUCK.replace(chain=STRUCK.chain.replace(**change)), PeakForce(3), [name])
    assert name in str(error.value)
    assert "\n" not in str(error.value)
