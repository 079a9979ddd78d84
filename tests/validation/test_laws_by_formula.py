"""Laws that pull, have kinks or soften, against SciPy's DOP853 and closed forms."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import struck
from helpers.independent_integrators import distance
from helpers.thinned import thinned
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import lmpchain
from lmpchain import Chain, InputError, Law, Profile, Scene, laws

ROW = {"grains": 12, "diameter": 1e-3, "gravity": 0.0}
N = ROW["grains"]
B = 1e5
EXPONENTS = np.linspace(1.3, 1.7, N - 1)
PLACES = np.linspace(0.5e-6, 1.5e-6, N - 1)
K = 1e3

# Chains and strikes, and the force of all contacts for SciPy.
CASES: dict[str, tuple[dict[str, Any], float, float, Callable[[Any], Any]]] = {
    "toda": ({"law": laws.toda(B, k=K)}, 0.2, 4e-4, lambda o: K * np.expm1(B * o) / B),
    "toda under gravity": (
        {"law": laws.toda(B, k=K), "gravity": 9.81},
        *(0.2, 4e-4, lambda o: K * np.expm1(B * o) / B),
    ),
    "fput": (
        {"law": laws.fput(1e7, 1e14, k=K)},
        *(0.02, 1e-3, lambda o: K * o - 1e7 * o**2 + 1e14 * o**3),
    ),
    "spring": ({"law": Law("k*o", k=K)}, 0.02, 1e-3, lambda o: K * o),
    "bilinear": (
        {"law": laws.bilinear(0.3, k=K)},
        *(0.02, 4e-4, lambda o: K * np.where(o > 0, o, 0.3 * o)),
    ),
    "bilinear under load": (
        {"law": laws.bilinear(0.3, k=K), "top_load": 1e-3},
        *(0.02, 4e-4, lambda o: K * np.where(o > 0, o, 0.3 * o)),
    ),
    "an exponent below 1": (
        {"law": laws.power(0.6, k=10.0), "top_load": 1e-3},
        *(0.002, 3e-4, lambda o: 10.0 * np.maximum(o, 0) ** 0.6),
    ),
    "softening": (
        {"law": laws.softening(1e-6, k=K), "top_load": 3e-4},
        *(0.005, 5e-4, lambda o: 1e-3 * np.tanh(o * 1e6)),
    ),
    "a kink of its own in each contact": (
        {"law": Law("k*o + q*max(o - e, 0)", k=K, q=2 * K, e=PLACES.tolist())},
        *(0.02, 4e-4, lambda o: K * o + 2 * K * np.maximum(o - PLACES, 0)),
    ),
    "two kinks in each contact": (
        {"law": Law("k*o + q*max(o - e, 0) + k*min(o + e, 0)/2", k=K, q=2 * K, e=PLACES.tolist())},
        *(0.02, 4e-4),
        lambda o: K * (o + 2 * np.maximum(o - PLACES, 0) + np.minimum(o + PLACES, 0) / 2),
    ),
    "one exponent a contact": (
        {"law": Law("k*max(o, 0)**p", k=1e6, p=EXPONENTS.tolist()), "gravity": 9.81},
        *(0.01, 4e-4, lambda o: 1e6 * np.maximum(o, 0) ** EXPONENTS),
    ),
}


def reference(scene: Scene, force: Callable[[Any], Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements and velocities, (T, N) each, with short steps across kinks."""
    chain = scene.chain
    carried = chain.top_load + chain.gravity * np.cumsum(chain.masses)[:-1]

    def lacking(overlap: float, contact: int) -> float:
        forces = np.broadcast_to(force(np.full(N - 1, overlap)), N - 1)
        return float(forces[contact] - carried[contact])

    rest = np.zeros(N - 1)
    for n in np.flatnonzero(carried):
        rest[n] = brentq(lacking, 0.0, 1e-4, args=(n,), xtol=1e-26, rtol=1e-15)

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        f = force(rest + state[: N - 1] - state[1:N]) - carried
        slopes = np.zeros(2 * N)
        slopes[:N] = state[N:]
        # The last grain is fixed.
        slopes[N:-1] -= f
        slopes[N + 1 : -1] += f[:-1]
        slopes[N:] /= chain.masses
        return slopes

    start = np.concatenate(scene.initial())
    size = np.abs(start).max() * np.repeat([1e-20, 1e-14], N)
    options: dict[str, Any] = {"method": "DOP853", "rtol": 3e-14, "atol": size}
    kinked = len(chain.law.kinks(1.0)) > 0
    longest = 0.03 / scene.highest_frequency if kinked else np.inf
    times = scene.time
    run = solve_ivp(rates, (0.0, times[-1]), start, t_eval=times, max_step=longest, **options)
    return run.y[:N].T, run.y[N:].T


@pytest.mark.parametrize("case", thinned(CASES, 2))
def test_the_estimate_covers_the_error_for_any_law(case: str) -> None:
    options, speed, duration, _ = CASES[case]
    scene = struck(Chain(**ROW | options), speed, duration, 21)
    run = lmpchain.simulate(scene, "native", tolerance=1e-8)
    off = distance(run, reference(scene, CASES[case][3]))
    assert off < 3 * run.error_estimate.total + 3e-12
    assert run.error_estimate.total < 1e-8


def test_a_toda_soliton_keeps_its_shape() -> None:
    """Toda's soliton exp(b o) - 1 = sinh(kappa)^2 / cosh(kappa n - sinh(kappa) t')^2 (1967)."""
    grains, kappa, middle, later = 80, 0.8, 25.0, 20.0
    # Bonds of the far end are at rest to the last digit.
    law = laws.toda(B, k=K)
    chain = Chain(grains=grains, diameter=1e-3, gravity=0.0, law=law)
    m = chain.masses[0]
    unit = np.sqrt(m / K)
    n = np.arange(1, grains + 1)

    def place(t: float) -> np.ndarray:
        """Return b u_n, from log(cosh) of two neighbouring bonds."""
        phase = kappa * (n - middle) - np.sinh(kappa) * t
        return np.logaddexp(phase - kappa, kappa - phase) - np.logaddexp(phase, -phase)

    def speed(t: float) -> np.ndarray:
        phase = kappa * (n - middle) - np.sinh(kappa) * t
        return np.sinh(kappa) * (np.tanh(phase) - np.tanh(phase - kappa))

    start = (place(0.0) - place(0.0)[-1]) / B
    velocity = speed(0.0) / (B * unit)
    excitation = Profile(displacement=start, velocity=velocity)
    scene = Scene(chain=chain, excitation=excitation, duration=later * unit, samples=11)
    run = lmpchain.simulate(scene, "native", tolerance=1e-10)
    exact = (place(later) - place(later)[-1]) / B
    assert np.abs(run.displacement[-1] - exact).max() < 1e-9 * np.ptp(exact)


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (laws.softening(1e-6, k=K), "law: has no equilibrium under"),
        (Law("k*o*(1 - o/1e-6)*(1 - o/2e-6)", k=K), "law: has 2 equilibria under"),
        (Law("k*step(o)*(1 + o)", k=K), "law.force: has a jump"),
        (Law("k*u", k=K), "law.force: depends on u or t"),
    ],
)
def test_laws_without_an_equilibrium_are_rejected(law: Law, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Chain(**ROW | {"top_load": 1.1e-4 if "2" in message else 1e-2, "law": law})


def test_an_infinite_stiffness_is_rejected() -> None:
    with pytest.raises(InputError, match="law: is infinitely stiff where contacts only touch"):
        Chain(**ROW, law=laws.power(0.6, k=1e4))
