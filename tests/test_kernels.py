"""The compiled contact force: every form against high precision, and against the energy."""

import mpmath
import numpy as np
import pytest

from lmpchain import Chain
from lmpchain.engines.native import kernels

MAGNITUDES = [1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 1e-2, 0.1, 0.5, 0.9]


def forces(form: int, delta: float, s: np.ndarray) -> np.ndarray:
    """Return f(s) as the kernel computes it, one contact at a time."""
    values = []
    for value in s:
        force = np.zeros(1)
        kernels.contact_forces(force, np.array([value, 0.0]), np.ones(1), np.ones(1), 0.0, form, delta)
        values.append(force[0])
    return np.array(values)


def exact(delta: float, s: float) -> float:
    with mpmath.workdps(50):
        return float(mpmath.mpf(1 + mpmath.mpf(s)) ** mpmath.mpf(delta) - 1)


@pytest.mark.parametrize(
    ("form", "delta"), [(kernels.CORRECTED, 1.5), (kernels.SPRING, 1.0), (kernels.POWER, 1.25), (kernels.POWER, 3.0)]
)
def test_no_digits_are_lost_at_any_amplitude(form, delta):
    s = np.array([sign * size for size in MAGNITUDES for sign in (1, -1)] + [3.0, 30.0, 100.0])
    assert forces(form, delta, s) == pytest.approx([exact(delta, x) for x in s], rel=6e-15, abs=0)


def test_plain_form_is_as_good_where_it_is_used():
    s = np.array([0.5, 3.0, 30.0, 1e3, 1e5])
    assert forces(kernels.PLAIN, 1.5, s) == pytest.approx([exact(1.5, x) for x in s], rel=2e-15, abs=0)


@pytest.mark.parametrize("form", [kernels.CORRECTED, kernels.PLAIN, kernels.SPRING, kernels.POWER])
def test_open_contacts_and_rest_are_exact(form):
    delta = 1.0 if form == kernels.SPRING else 1.5
    assert np.array_equal(forces(form, delta, np.array([-1.0, -1.5, -1e6, 0.0])), [-1.0, -1.0, -1.0, 0.0])


def test_vacuum_has_no_tension():
    assert np.array_equal(forces(kernels.VACUUM, 2.0, np.array([-1.0, 0.0, 3.0])), [0.0, 0.0, 9.0])


@pytest.mark.parametrize("delta", [1.0, 1.3, 1.5, 2.5])
def test_force_is_the_derivative_of_the_energy(delta):
    """-dU/dx by central differences, compressed and open contacts alike."""
    chain = Chain(grains=6, material="glass", diameter=1e-3, exponent=delta)
    form = {1.0: kernels.SPRING, 1.5: kernels.CORRECTED}.get(delta, kernels.POWER)
    eps = chain.equilibrium_overlap
    u = np.append(0.0, np.cumsum([-0.5, 0.3, 2.0, -1.4, 0.1] * eps))
    force = np.zeros(7)
    kernels.contact_forces(force[1:-1], u, 1 / eps, chain.equilibrium_force, 0.0, form, delta)
    moved = 1e-5 * eps[0] * np.eye(6)
    rest = np.zeros(6)
    slope = [(chain.excess_energy(u + d, rest) - chain.excess_energy(u - d, rest)) / (2e-5 * eps[0]) for d in moved]
    assert -np.array(slope) == pytest.approx(force[:-1] - force[1:], rel=1e-6, abs=0)
