"""Gradients of damped chains against differences of independent solutions.

The solutions are Taylor series in extended precision.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers import taylor_series
from helpers.trial_scenes import acted_trial_scene, damped, trial_scene

from lmpchain import Chain, Drive, Force, Impulse, InputError, Scene
from lmpchain.design import (
    ArrivalTime,
    DriveWork,
    Energy,
    KineticEnergy,
    Momentum,
    PeakForce,
    gradient,
    parameters,
)
from lmpchain.design.parameters import changed

GRAINS = 6
DAMPING = {"viscoelastic": 1e-7, "drag": 3e3}
EACH = {"viscoelastic": np.linspace(1e-7, 2e-7, GRAINS - 1), "drag": np.linspace(0, 5e3, GRAINS)}
CHAIN = Chain(grains=GRAINS, diameter=1e-3, top_load=0.02, bottom="wall", damping=DAMPING)
SHAPE = 1e-7 * np.sin(np.arange(7.0) / 3) ** 2
STRUCK = Impulse(velocity=0.02)


def scene(excitation: Any = STRUCK, duration: float = 8e-6, **options: Any) -> Scene:
    return Scene(
        chain=CHAIN.replace(**options), excitation=excitation, duration=duration, samples=5
    )


SCENES = {
    "struck": scene(),
    "exponent 3": scene(exponent=3.0, damping=EACH),
    "springs": scene(Impulse(velocity=0.005), exponent=1.0),
    "contacts that open": scene(Impulse(velocity=-0.1), damping=EACH),
    "vacuum": scene(Impulse(velocity=0.2), top_load=0, gravity=0),
    "vacuum of exponent 2.3": scene(Impulse(velocity=0.2), top_load=0, gravity=0, exponent=2.3),
    "top wall that touches": scene(Impulse(velocity=0.01), top="wall", top_load=0, gravity=500.0),
    "striker": scene(Impulse(velocity=0.1), load_grain=2),
    "driven": scene(Drive(amplitude=2e-8, frequency=2e5)),
    "driven wall": scene(
        Drive(grain=0, times=np.linspace(0, 8e-6, 7), displacement=SHAPE, interpolation="spline"),
        top="wall",
        damping=EACH,
    ),
    "pushed": scene(Force(grain=3, amplitude=0.02, frequency=2e5), bottom="fixed"),
}
START = ("velocity", "displacement")
NAMES = (
    "masses",
    "contact_constants",
    "wall_constants",
    "top_load",
    "velocity",
    "displacement",
    "drive",
    "amplitude",
    "frequency",
    "damping.viscoelastic",
    "damping.drag",
)


def energy_at_end(case: Scene) -> np.longdouble:
    """Return the kinetic energy of grains 3 and 4, J, in extended precision."""
    velocity = taylor_series.solve(case, 1e-18).velocity[-1, 2:4].astype(np.longdouble)
    return (case.chain.masses[2:4] * velocity**2).sum() / 2


def difference(answer: Callable[[float], np.longdouble], step: float) -> float:
    """Return the derivative at 0 by central differences of order 4."""
    near, far = ((answer(k * step) - answer(-k * step)) / (2 * k * step) for k in (1, 2))
    return float((4 * near - far) / 3)


def known(case: Scene) -> list[str]:
    """Return the parameters of a scene that remain valid when they change."""
    names = []
    for name in NAMES:
        try:
            parameters.check(case, [name])
        except InputError:
            continue
        # A displacement opens a contact that only touches, so that differences are wrong there.
        touches = not case.chain.contacts.pressed[1 - bool(case.chain.contacts.exists[0])]
        if name in START and (case.excitation.does_work or touches):
            continue
        names.append(name)
    return names


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (" of " in n)) for n in SCENES]
)
def test_gradients_agree_with_differences_of_taylor_series(name: str):
    case = SCENES[name]
    names = known(case)
    found = gradient(case, KineticEnergy([3, 4]), names, 1e-7)
    assert found.integrator == "dop853"
    energy = float(energy_at_end(case))
    assert abs(energy - found.value) <= found.value_error
    for key in names:
        base = parameters.values(case, key).astype(float)
        entry = 0 if key in ("velocity", "displacement") else min(2, base.size - 1)
        unit = np.eye(base.size)[entry]
        step = 1e-3 * (abs(base[entry]) or 1e-8)

        def answer(change: float, key=key, base=base, unit=unit) -> np.longdouble:
            return energy_at_end(changed(case, {key: base + change * unit}))

        # Samples of the reference are rounded to double precision.
        allowed = found.errors[key] + 1e-9 * np.abs(found[key]).max() + 1e-15 * energy / step
        assert abs(found[key][entry] - difference(answer, step)) <= allowed, key


@pytest.mark.parametrize(
    ("name", "objective"),
    [
        ("struck", PeakForce(3)),
        pytest.param("vacuum", PeakForce(1), marks=pytest.mark.slow),
        ("contacts that open", Energy([2, 3])),
        ("driven", DriveWork()),
        ("springs", Momentum([3])),
        ("struck", ArrivalTime(3, 1e-3)),
    ],
)
def test_errors_cover_what_a_finer_gradient_shows(name: str, objective: Any):
    case = SCENES[name]
    names = ["masses", "contact_constants", "damping.viscoelastic", "damping.drag"]
    found = gradient(case, objective, names, 1e-3)
    true = gradient(case, objective, names, 1e-6)
    assert found.error <= 1e-3
    for key in names:
        assert np.abs(found[key] - true[key]).max() <= found.errors[key] + true.errors[key], key
    assert abs(found.value - true.value) <= found.value_error + true.value_error


def small(seed: int) -> Scene:
    """Draw a short damped scene of a few grains, struck or forced."""
    rng = np.random.default_rng([77, seed])
    while True:
        case = damped(rng, acted_trial_scene(rng) if seed % 2 else trial_scene(rng))
        turns = case.highest_frequency * case.duration
        if case.chain.grains <= 40 and turns < 300 and case.chain.exponent > 1.01:
            return case


@pytest.mark.parametrize(
    "seed",
    [pytest.param(n, marks=pytest.mark.slow if n < 10 else pytest.mark.soak) for n in range(40)],
)
def test_errors_cover_what_a_finer_gradient_of_random_scenes_shows(seed: int):
    case = small(seed)
    objective = [Momentum([2]), KineticEnergy([1, 2]), PeakForce(1)][seed % 3]
    names = ["masses", "contact_constants", "damping.viscoelastic", "damping.drag"]
    found = gradient(case, objective, names, 1e-3)
    true = gradient(case, objective, names, 1e-5)
    for key in names:
        assert np.abs(found[key] - true[key]).max() <= found.errors[key] + true.errors[key], key
    assert abs(found.value - true.value) <= found.value_error + true.value_error


def test_peak_forces_have_the_slopes_of_peaks_of_taylor_series():
    """Peaks include the viscous part K (1 + A d/dt) o^delta, by parabolas through close samples."""
    case = SCENES["struck"].replace(samples=2001)

    def peak(viscoelastic: float) -> float:
        chain = CHAIN.replace(damping={**DAMPING, "viscoelastic": viscoelastic})
        run = taylor_series.solve(case.replace(chain=chain), 1e-18)
        contact = chain.contacts.of(3)
        overlap = contact.overlap + run.displacement[:, 2] - run.displacement[:, 3]
        closing = run.velocity[:, 2] - run.velocity[:, 3]
        force = contact.constant * overlap**0.5 * (overlap + 1.5 * viscoelastic * closing)
        below, at, above = force[force.argmax() + np.array([-1, 0, 1])]
        return at + (above - below) ** 2 / (8 * (2 * at - above - below))

    found = gradient(case, PeakForce(3, 1e5), ["damping.viscoelastic"], 1e-6)
    slope = (peak(1.01e-7) - peak(0.99e-7)) / 2e-9
    assert found.value == pytest.approx(peak(1e-7), rel=1e-5)
    assert found["damping.viscoelastic"][0] == pytest.approx(slope, rel=1e-3)


def test_a_chain_without_damping_has_a_derivative_by_it():
    """The method dop853 has this derivative; the splitting remains the default for masses."""
    case = scene(damping=None)
    names = ["masses", "damping.viscoelastic"]
    found = gradient(case, Momentum([4]), names, 1e-8)
    lossless = gradient(case, Momentum([4]), ["masses"], 1e-8)
    assert (found.integrator, lossless.integrator) == ("dop853", "rkn6")
    allowed = found.errors["masses"] + lossless.errors["masses"]
    assert np.abs(found["masses"] - lossless["masses"]).max() <= allowed
    slightly = case.replace(chain=case.chain.replace(damping={"viscoelastic": 1e-12}))
    more = gradient(slightly, Momentum([4]), names, 1e-8).value - found.value
    assert more / 1e-12 == pytest.approx(found["damping.viscoelastic"][0], rel=1e-4)


def test_unsupported_gradients_of_damped_chains_are_rejected():
    case = SCENES["struck"]
    with pytest.raises(InputError, match="integrator: must be dop853 with damping"):
        gradient(case, Momentum([2]), ["masses"], integrator="rkn6")
    far = scene(Drive(amplitude=1e-6, frequency=2e5))
    with pytest.raises(InputError, match="DriveWork needs a viscous contact that stays closed"):
        gradient(far, DriveWork(), ["masses"])
