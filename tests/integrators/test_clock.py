"""The clock of the integration is exact for any number of steps, and always advances."""

from fractions import Fraction
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

from lmpchain import Chain, Impulse, Scene
from lmpchain.engines.stepping.rounding import native_floor
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.kernels.layout import STATE
from lmpchain.integrators.kernels.sample_loop import end_of_step
from lmpchain.integrators.methods import METHODS
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps, clocks

SPEED = 1e-3


def oscillator(periods: float, samples: int = 3) -> tuple[Scene, float]:
    """Return a struck grain on a spring (grain 2 is fixed), and its frequency in rad/s."""
    chain = Chain(grains=2, diameter=1e-3, gravity=0.0, top_load=10.0, exponent=1.0)
    omega = np.sqrt(np.longdouble(chain.contact_constants[0]) / np.longdouble(chain.masses[0]))
    duration = periods * 2 * np.pi / float(omega)
    return Scene(
        chain=chain, excitation=Impulse(velocity=SPEED), duration=duration, samples=samples
    ), omega


def phase_error(periods: float, integrator: str, reach: float, adaptive: bool, samples: int = 3):
    """Return the error against the exact phase, and the stated rounding error."""
    scene, omega = oscillator(periods, samples)
    interval = scene.duration / (samples - 1)
    steps = int(np.ceil(interval * float(omega) / reach))
    schedule = Steps(steps, 1, interval / steps, adaptive)
    stepper = NativeStepper(ChainBatch([scene]), METHODS[integrator], schedule, {})
    u, v = np.zeros((2, 1, samples, 2))
    stepper.fill(u, v, 0, samples - 1, 2**62)
    phase = (omega * scene.time.astype(np.longdouble))[1:]
    x = u[0, 1:, 0] * omega / SPEED
    w = v[0, 1:, 0] / SPEED
    error = float(max(np.abs(x - np.sin(phase)).max(), np.abs(w - np.cos(phase)).max()))
    return error, native_floor(stepper.steps[0] * METHODS[integrator].evaluations, float(phase[-1]))


LONG = [
    ("rkn6", 0.03, True),
    ("rkn6", 0.03, False),
    ("kahan-li8", 0.06, True),
    ("dop853", 0.06, True),
]


@pytest.mark.parametrize(("integrator", "reach", "adaptive"), LONG)
def test_the_clock_does_not_drift(integrator, reach, adaptive):
    """Times summed step by step once drifted by 1e-12 per hundred periods, in all runs alike."""
    error, floor = phase_error(1000, integrator, reach, adaptive)
    assert error / 3 < floor < 1e-11


@pytest.mark.soak
@pytest.mark.parametrize(("integrator", "reach", "adaptive"), LONG)
@pytest.mark.parametrize("samples", [2, 3, 1001])
def test_the_clock_does_not_drift_in_a_hundred_thousand_periods(
    integrator, reach, adaptive, samples
):
    error, floor = phase_error(1e5, integrator, reach, adaptive, samples)
    assert error / 3 < floor < 1e-9


class Bodies(NamedTuple):
    state: np.void


@njit
def ends(bodies, clock, left, step):
    return end_of_step(bodies, clock, left, step)


def clock_of(length: float) -> np.void:
    clock = clocks([Steps(1, 1, length)], length, 1)[0]
    clock["length"] = length
    return clock


@pytest.mark.parametrize("step", [1e-30, 1e-19, 0.0])
def test_the_number_of_steps_never_overflows(step):
    """More than 2^63 remaining steps near an opening once became one giant step."""
    state = np.zeros(1, STATE)[0]
    clock = clock_of(3.0)
    after = ends(Bodies(state), clock, 3.0, step)
    assert 0 < after < 1e-14
    state["done"] = 3.0 - 2e-15
    assert state["done"] < ends(Bodies(state), clock, 3.0 - state["done"], step) <= 3.0


def test_steps_add_up_to_the_span_exactly():
    state = np.zeros(1, STATE)[0]
    clock = clock_of(0.7)
    sizes = []
    while state["done"] < clock["length"]:
        done = ends(Bodies(state), clock, clock["length"] - state["done"], 0.7 / 333.3)
        sizes.append(Fraction(done - state["done"]))
        state["done"] = done
    assert len(sizes) == 334
    assert abs(sum(sizes) - Fraction(0.7)) <= Fraction(0.7) / 2**53


def test_a_step_that_fills_the_remaining_time_ends_exactly_on_the_sample(rng: np.random.Generator):
    """The sum of both parts of the time may have a rounding error; a kink ends a step sooner."""
    state = np.zeros(1, STATE)[0]
    for length, part in rng.uniform(0.1, 1.0, (100, 2)):
        state["done"] = 0.5 * part * length
        left = length - state["done"]
        assert ends(Bodies(state), clock_of(length), left, left) == length
        assert ends(Bodies(state), clock_of(length), left, 0.5 * left) < 0.9 * length
        assert ends(Bodies(state), clock_of(length), 0.5 * left, left) < 0.9 * length
