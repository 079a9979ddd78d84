"""A force law that the package does not have, K o^1.5 (1 + c o), written as one object.

Its answers are compared with SciPy's DOP853 on the equations of motion themselves.
"""

from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck
from helpers.independent_integrators import distance
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import lmpchain
from lmpchain import Damping, Drive, Impulse, InputError, Law, Scene
from lmpchain.engines import Native
from lmpchain.measure import energy


def force(o: Any, k: Any, p: Any) -> Any:
    x = np.maximum(o, 0.0)
    return k * x * np.sqrt(x) * (1 + p[0] * x)


def stiffness(o: Any, k: Any, p: Any) -> Any:
    x = np.maximum(o, 0.0)
    return k * np.sqrt(x) * (1.5 + 2.5 * p[0] * x)


C = 2e6  # The second term is as large as the first at an overlap of 0.5 um.
LAW = Law("k*max(o, 0)**1.5*(1 + c*o)", c=C)
COLUMN = column(8, law=LAW, bottom="wall", top_load=0.02)
SCENES = {
    # Contacts stay closed, are opened by a strong strike, or only touch at rest.
    "weak": (COLUMN, Impulse(velocity=2e-5)),
    "strong": (COLUMN, Impulse(velocity=0.5)),
    "vacuum": (COLUMN.replace(top_load=0.0, gravity=0.0, top="wall"), Impulse(velocity=0.2)),
    "a wall that touches": (COLUMN.replace(top_load=0.0, top="wall"), Impulse(velocity=0.01)),
    "a striker": (COLUMN.replace(gravity=0.0, load_grain=2), Impulse(velocity=0.05)),
    "driven": (COLUMN, Drive(amplitude=2e-8, frequency=4e4)),
    "damped": (
        COLUMN.replace(damping=Damping(viscoelastic=2e-8, drag=300.0)),
        Impulse(velocity=0.1),
    ),
}


def at_rest(constant: float, carried: float) -> float:
    """Return the overlap of a contact at rest, m."""
    if constant * carried == 0:
        return 0.0
    return brentq(lambda o: force(o, constant, (C,)) - carried, 0.0, 1e-5, xtol=1e-24, rtol=1e-15)


def reference(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements and velocities, (T, N) each, by SciPy, restarted at every opening."""
    chain = scene.chain
    top, bottom = chain.wall_constants
    constant = np.concatenate(([top], chain.contact_constants, [bottom]))
    carried = np.cumsum(np.append(0.0, chain.masses)) * chain.gravity
    loaded = chain.load_grain if chain.load_grain > 1 or chain.top == "free" else 0
    carried[loaded:] += chain.top_load
    rest = np.array([at_rest(*pair) for pair in zip(constant, carried, strict=True)])
    carried_force = force(rest, constant, (C,))
    masses, drag, viscosity = chain.masses, chain.drag, chain.contact_viscosity
    drive = scene.drive
    omega = 2 * np.pi * drive.frequency if drive else 0.0

    def place(t: float, u: np.ndarray) -> np.ndarray:
        return np.append(drive.amplitude * np.sin(omega * t), u[1:]) if drive else u

    def closer(x: np.ndarray) -> np.ndarray:
        between = np.zeros(chain.grains + 2)
        between[1:-1] = x
        return between[:-1] - between[1:]

    def overlap(t: float, state: np.ndarray) -> np.ndarray:
        return rest + closer(place(t, state[: chain.grains]))

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        v = state[chain.grains :]
        o = overlap(t, state)
        viscous = viscosity * stiffness(o, constant, (C,)) * closer(v)
        change = force(o, constant, (C,)) - carried_force + viscous
        return np.concatenate((v, (change[:-1] - change[1:]) / masses - drag * v))

    def crossing(contact: int) -> Any:
        def event(t: float, state: np.ndarray) -> float:
            return float(overlap(t, state)[contact])

        event.terminal = True  # type: ignore[attr-defined]
        return event

    events = [crossing(n) for n in np.flatnonzero(constant)]
    state = np.concatenate(scene.initial())
    # Scales of the tolerances: the largest speed, and the displacement in one period of the fastest
    # motion.
    speed = max(np.abs(state[chain.grains :]).max(), omega * (drive.amplitude if drive else 0.0))
    # In a loaded chain, weak waves lose digits to the force at rest.
    least = 1e-13 if chain.compressed else 1e-16
    atol = np.repeat(speed * np.array([1e-6 * least, least]), chain.grains)
    options: dict[str, Any] = {"method": "DOP853", "rtol": 1e-13, "atol": atol}
    rows = [state]
    now = 0.0
    for sample in scene.time[1:]:
        while now < sample:
            # A contact that has just opened or closed must not do so again within the first step.
            for end, watched in ((min(now + 1e-11, sample), None), (sample, events)):
                if now < end:
                    run = solve_ivp(rates, (now, end), state, events=watched, **options)
                    now, state = run.t[-1], run.y[:, -1]
        rows.append(state)
    u, v = np.array(rows).reshape(scene.samples, 2, chain.grains).swapaxes(0, 1)
    if drive:
        u[:, 0] = drive.amplitude * np.sin(omega * scene.time)
        v[:, 0] = drive.amplitude * omega * np.cos(omega * scene.time)
    return u, v


@pytest.fixture(scope="module")
def truths() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    return {name: reference(scene_of(*SCENES[name], 3e-5, 11)) for name in SCENES}


CASES = [(name, "auto", 1e-8) for name in SCENES]
CASES += [(name, kind, 1e-6) for name in ("weak", "strong") for kind in ("rkn4", "rkn6", "dop853")]
CASES += [(name, kind, 1e-4) for name in ("weak", "strong") for kind in ("verlet", "gear4")]


@pytest.mark.parametrize(("name", "integrator", "tolerance"), CASES)
def test_a_new_law_meets_its_tolerance(
    name: str, integrator: str, tolerance: float, truths: dict[str, Any]
) -> None:
    run = lmpchain.simulate(
        scene_of(*SCENES[name], 3e-5, 11), Native(integrator=integrator), tolerance=tolerance
    )
    off = distance(run, truths[name])
    assert off < 3 * run.error_estimate.total + 3e-12
    assert run.error_estimate.total < tolerance


def test_measures_and_linear_engines_use_the_law(truths: dict[str, Any]) -> None:
    scene = scene_of(*SCENES["strong"], 3e-5, 11)
    run = lmpchain.simulate(scene, "native", tolerance=1e-8)
    ledger = energy.ledger(run)
    assert ledger.total == pytest.approx(scene.energy, rel=1e-7)
    weak = scene_of(*SCENES["weak"], 3e-5, 11)
    run = lmpchain.simulate(weak, "modes", tolerance=0.9)
    assert distance(run, truths["weak"]) < run.error_estimate.total


@pytest.mark.parametrize(
    ("refused", "message"),
    [
        (lambda scene: lmpchain.simulate(scene, "continuum"), "law: continuum needs a power"),
        (lambda scene: scene.chain.exponent, "law: must be a power of the overlap for an exponent"),
    ],
)
def test_functions_for_powers_only_reject_the_law_by_name(refused: Any, message: str) -> None:
    scene = struck(column(8, law=LAW), 1e-4, 1e-5, 11)
    with pytest.raises(InputError, match=message):
        refused(scene)
