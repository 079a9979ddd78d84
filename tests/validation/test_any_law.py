"""A force law that the package does not know, K o^1.5 (1 + c o), written as one object.

Its answers are compared with SciPy's DOP853 on the equations of motion themselves.
"""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import lmpchain
from lmpchain import Chain, Damping, Drive, Impulse, InputError, Scene
from lmpchain.chain.contact_law import ContactLaw
from lmpchain.engines import Lammps, Native
from lmpchain.measure import energy, motion


def force(o: Any, k: Any, p: Any) -> Any:
    x = np.maximum(o, 0.0)
    return k * x * np.sqrt(x) * (1 + p[0] * x)


def stiffness(o: Any, k: Any, p: Any) -> Any:
    x = np.maximum(o, 0.0)
    return k * np.sqrt(x) * (1.5 + 2.5 * p[0] * x)


def curvature(o: Any, k: Any, p: Any) -> Any:
    return k / np.sqrt(o) * (0.75 + 3.75 * p[0] * o)


C = 2e6  # the second term is as large as the first at an overlap of 0.5 um
LAW = ContactLaw(force, stiffness, curvature, onset=1.5, parameters=(C,))
COLUMN = Chain(grains=8, diameter=1e-3, law=LAW, bottom="wall", top_load=0.02)
SCENES = {
    # all contacts stay closed, are opened by a strong strike, or only touch at rest
    "weak": (COLUMN, Impulse(velocity=2e-5)),
    "strong": (COLUMN, Impulse(velocity=0.5)),
    "vacuum": (COLUMN.replace(top_load=0.0, gravity=0.0, top="wall"), Impulse(velocity=0.2)),
    "a wall that touches": (COLUMN.replace(top_load=0.0, top="wall"), Impulse(velocity=0.01)),
    "a striker": (COLUMN.replace(gravity=0.0, load_grain=2), Impulse(velocity=0.05)),
    "driven": (COLUMN, Drive(amplitude=2e-8, frequency=4e4)),
    "damped": (COLUMN.replace(damping=Damping(viscoelastic=2e-8, drag=300.0)), Impulse(velocity=0.1)),
}


def scene_of(name: str) -> Scene:
    chain, excitation = SCENES[name]
    return Scene(chain=chain, excitation=excitation, duration=6e-5, samples=61)


def reference(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements and velocities, (T, N) each, by SciPy."""
    chain = scene.chain
    constant = np.concatenate(
        (chain.wall_constants[:1], chain.contact_constants, chain.wall_constants[1:])
    )
    carried = np.cumsum(np.append(0.0, chain.masses)) * chain.gravity
    carried[chain.load_grain if chain.load_grain > 1 else int(chain.top == "free"):] += chain.top_load
    rest = [
        brentq(lambda o: force(o, k, (C,)) - f, 0.0, 1e-5, xtol=1e-24, rtol=1e-15) if k * f else 0.0
        for k, f in zip(constant, carried, strict=True)
    ]
    rest = np.array(rest)
    driven = isinstance(scene.excitation, Drive)

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        u, v = state.reshape(2, -1)
        if driven:
            omega = 2 * np.pi * scene.excitation.frequency
            u = np.append(scene.excitation.amplitude * np.sin(omega * t), u[1:])
        closer = -np.diff(u, prepend=0.0, append=0.0)
        closing = -np.diff(v, prepend=0.0, append=0.0)
        o = np.where(constant > 0, rest + closer, 0.0)
        viscous = chain.contact_viscosity * stiffness(o, constant, (C,)) * closing
        change = force(o, constant, (C,)) - force(rest, constant, (C,)) + viscous
        a = -np.diff(change) / chain.masses - chain.drag * v
        return np.concatenate((v, a))

    start = np.concatenate(scene.initial())
    scale = np.repeat((np.abs(start).max() or 1e-8) * np.array([1e-6, 1.0]), chain.grains)
    run = solve_ivp(
        rates, (0.0, scene.duration), start, "DOP853", scene.time, rtol=1e-13,
        atol=1e-13 * scale, max_step=1e-7,
    )
    u, v = run.y.reshape(2, chain.grains, -1).swapaxes(1, 2)
    if driven:
        omega = 2 * np.pi * scene.excitation.frequency
        u[:, 0] = scene.excitation.amplitude * np.sin(omega * scene.time)
        v[:, 0] = scene.excitation.amplitude * omega * np.cos(omega * scene.time)
    return u, v


def true_error(run: lmpchain.Trajectory, true: tuple[np.ndarray, np.ndarray]) -> float:
    found = run.displacement, run.velocity
    return max(np.abs(a - b).max() / np.abs(b).max() for a, b in zip(found, true, strict=True))


@pytest.fixture(scope="module")
def truths() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    return {name: reference(scene_of(name)) for name in SCENES}


CASES = [(name, "auto", 1e-8) for name in SCENES]
CASES += [(name, kind, 1e-6) for name in ("weak", "strong") for kind in ("rkn4", "rkn6", "dop853")]
CASES += [(name, kind, 1e-4) for name in ("weak", "strong") for kind in ("verlet", "gear")]


@pytest.mark.parametrize(("name", "integrator", "tolerance"), CASES)
def test_a_new_law_keeps_its_tolerance(
    name: str, integrator: str, tolerance: float, truths: dict[str, Any]
) -> None:
    run = lmpchain.simulate(scene_of(name), Native(integrator=integrator), tolerance=tolerance)
    off = true_error(run, truths[name])
    assert off < 3 * run.error_estimate.total + 1e-11
    assert run.error_estimate.total < tolerance
    print(name, integrator, off, run.error_estimate.total, run.cost.integrator)
