"""Chains on a ground against closed solutions: Mathieu, Jacobi, and the dispersion of springs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ellipj, ellipk, mathieu_a, mathieu_b

from lmpchain import (
    Chain,
    Displacement,
    Drive,
    Force,
    Impulse,
    InputError,
    Law,
    Profile,
    RunFailed,
    Scene,
    laws,
    simulate,
)
from lmpchain.benchmark.reference import reference
from lmpchain.theory import bands, modes, steady


def free_chain(ground: Law) -> Chain:
    """Return a chain whose contacts carry no force while its grains move in unison."""
    return Chain(grains=5, diameter=1e-3, gravity=0.0, bottom="free", ground=ground)


def moved_alike(
    chain: Chain, displacement: float, duration: float, tolerance: float = 1e-12
) -> np.ndarray:
    """Return the displacement of one grain, (33,) m, after equal displacements of all grains."""
    start = Profile(displacement=[displacement] * chain.grains, velocity=[0.0] * chain.grains)
    scene = Scene(chain=chain, excitation=start, duration=duration, samples=33)
    answer = simulate(scene, "native", tolerance=tolerance)
    np.testing.assert_array_equal(answer.displacement[:, 1], answer.displacement[:, 3])
    return answer.displacement[:, 2]


@pytest.mark.parametrize(("amplitude", "tolerance"), [(0.1, 1e-12), (1.0, 1e-12), (2.9, 1e-10)])
def test_a_pendulum(amplitude, tolerance):
    """Grains that move in unison on a periodic ground are pendulums.

    One that starts near its top amplifies rounding.
    """
    chain = free_chain(laws.frenkel_kontorova(1e3, period=2 * np.pi * 1e-6))
    rate = np.sqrt(1e3 / chain.masses[0])
    sine = np.sin(amplitude / 2)
    quarter = ellipk(sine**2)
    duration = 3 * 4 * quarter / rate
    phase = np.linspace(0, duration, 33) * rate + quarter
    exact = 2e-6 * np.arcsin(sine * ellipj(phase, sine**2)[0])
    moved = moved_alike(chain, amplitude * 1e-6, duration, tolerance)
    atol = 2 * tolerance * amplitude * 1e-6
    np.testing.assert_allclose(moved, exact, rtol=0, atol=atol)


def test_a_cubic_spring():
    """Duffing's oscillator: u = A cn(w t), w^2 = (k + beta A^2) / m."""
    a, k = 1e-6, 1e3
    chain = free_chain(laws.klein_gordon(k, beta=3 * k / a**2))
    rate = np.sqrt((k + 3 * k) / chain.masses[0])
    modulus = 3 * k / (2 * (k + 3 * k))
    duration = 3 * 4 * ellipk(modulus) / rate
    exact = a * ellipj(np.linspace(0, duration, 33) * rate, modulus)[1]
    np.testing.assert_allclose(moved_alike(chain, a, duration), exact, rtol=0, atol=2e-12 * a)


def trace_over_a_period(a: float, q: float) -> float:
    """Return the trace of the map over a period of Mathieu's equation, by two runs of one grain."""
    free = Chain(
        grains=1, diameter=1e-3, gravity=0.0, exponent=1, top_load=1.0, top="wall", bottom="wall"
    )
    mass = free.masses[0]
    springs = free.contacts.stiffness.sum()
    # u'' + (a - 2 q cos 2 tau) u = 0 with tau = w t / 2 has a = 4 (springs + k) / (m w^2).
    k = springs / 3
    w = np.sqrt(4 * (springs + k) / (mass * a))
    ground = laws.mathieu(k, depth=-q * mass * w**2 / (2 * k), frequency=w / (2 * np.pi))
    chain = free.replace(ground=ground)
    period = 2 * np.pi / w
    trace = 0.0
    for start, field in (
        (Displacement(displacement=1e-12), "displacement"),
        (Impulse(velocity=1e-12 * w), "velocity"),
    ):
        scene = Scene(chain=chain, excitation=start, duration=period, samples=2)
        values = getattr(simulate(scene, "native", tolerance=1e-12), field)[:, 0]
        trace += values[1] / values[0]
    return trace


@pytest.mark.parametrize("q", [0.1, 0.7])
@pytest.mark.parametrize(
    ("edge", "order", "limit"),
    [(mathieu_a, 1, -2.0), (mathieu_b, 1, -2.0), (mathieu_b, 2, 2.0), (mathieu_a, 2, 2.0)],
)
def test_edges_of_stability_of_a_modulated_stiffness(edge, order, limit, q):
    """Parametric resonance begins at Mathieu's characteristic values, to 1e-8."""
    a = edge(order, q)
    trace = trace_over_a_period(a, q)
    slope = (trace_over_a_period(a * 1.001, q) - trace) / (0.001 * a)
    assert abs((trace - limit) / slope) < 1e-8 * a


@pytest.mark.parametrize("share", [1e-3, 0.5, 30.0])
def test_springs_to_the_ground_open_a_gap_below_the_band(share):
    """w^2 = (g + 4 k sin^2(q/2)) / m for bands, modes of a finite chain, waves and resonances."""
    host = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
    plain = Chain(grains=31, **host)
    k, m = plain.linear_stiffness[0], plain.masses[0]
    g = share * float(k)
    chain = plain.replace(ground=Law("g*u", g=g))

    def frequency(q):
        return np.sqrt((g + 4 * k * np.sin(q / 2) ** 2) / m)

    q = np.linspace(0.01, 3.1, 40)
    found = bands.branches(bands.Cell([m], [k], ground=g), q)
    np.testing.assert_allclose(found.frequency[0], frequency(q), rtol=1e-12)
    np.testing.assert_allclose(
        found.group_velocity[0], k * np.sin(q) / m / frequency(q), rtol=1e-12
    )
    waves = bands.waves(bands.Cell([m], [k], ground=g), frequency(q))
    np.testing.assert_allclose(waves.wavenumber, q, rtol=1e-10)
    # A free top and a fixed grain 31 give odd quarter waves.
    of_modes = (2 * np.arange(1, 31) - 1) * np.pi / 61
    np.testing.assert_allclose(modes.eigenmodes(chain).frequency, frequency(of_modes), rtol=1e-12)
    assert chain.band_edge == pytest.approx(frequency(of_modes[-1]), rel=1e-12)
    # Below the band the response to a drive is exp(-kappa n), whatever the far end is.
    long = Chain(grains=3001, **host, ground=Law("g*u", g=g))
    low = 0.9 * np.sqrt(g / m)
    answer = steady.displacements(long, Drive(amplitude=1.0, frequency=low / (2 * np.pi)))
    kappa = 2 * np.arcsinh(np.sqrt((g - m * low**2) / (4 * k)))
    assert abs(answer[6] / answer[1]) == pytest.approx(np.exp(-5 * kappa), rel=1e-9)


def test_modes_on_springs_agree_with_the_native_engine():
    host = {"diameter": 1e-3, "gravity": 9.81, "top_load": 0.1, "bottom": "wall"}
    plain = Chain(grains=12, **host)
    springs = plain.linear_stiffness[0] * np.linspace(0.0, 2.0, 12)
    chain = plain.replace(ground=Law("g*u", g=springs.tolist()))
    strike = Impulse(velocity=1e-6 * chain.length_scale / chain.time_scale, grain=4)
    scene = Scene(chain=chain, excitation=strike, duration=100 * chain.time_scale, samples=31)
    linear = simulate(scene, "modes")
    native = simulate(scene, "native", tolerance=1e-10)
    off = np.abs(linear.displacement - native.displacement).max()
    # The error of the linear equation, and that of the native run.
    assert off < (linear.error_estimate.total + 1e-10) * np.abs(native.displacement).max()
    assert linear.error_estimate.total < 1e-4


def draw(rng: np.random.Generator) -> tuple[Scene, float]:
    """Return a random scene on a random ground, and a tolerance."""
    grains = int(rng.integers(1, 30))
    alone = grains == 1
    ends = {
        "top": "wall" if alone or rng.random() < 0.3 else "free",
        "bottom": "wall" if alone or rng.random() < 0.5 else "fixed",
    }
    gravity = float(rng.choice([0.0, 9.81]))
    load = 0.0 if gravity or rng.random() < 0.1 else 10 ** rng.uniform(-2, 1)
    fields = {"grains": grains, "diameter": 1e-3, "gravity": gravity, "top_load": load, **ends}
    if rng.random() < 0.3:
        fields["exponent"] = float(rng.choice([1, 1.25, 2, 2.5]))
    chain = Chain(**fields)
    w = chain.band_edge or 1e5
    size = chain.length_scale or 1e-9
    k = chain.masses.mean() * w**2 / 4 * 10 ** rng.uniform(-3, 0.7)
    b = k / size**2 * 10 ** rng.uniform(-1, 1)
    stiffness = (k * (1 + rng.random(grains))).tolist() if rng.random() < 0.3 else k
    rate = w * 10 ** rng.uniform(-1, 0.5)
    ground = [
        Law("k*u + b*u**3", k=stiffness, b=b),
        laws.frenkel_kontorova(stiffness, period=2 * np.pi * size),
        Law("b*u**3 - k*u", k=k / 10, b=b),
        laws.mathieu(stiffness, depth=rng.uniform(0, 1.5), frequency=rate / (2 * np.pi)),
        Law("k*u*(1 + 0.9*tanh(w*t - 3))", k=k, w=rate),
        Law("k*(exp(b*u) - 1)/b", k=k, b=rng.uniform(0.1, 1) / size),
    ][rng.integers(6)]
    if rng.random() < 0.3:
        drag = {"drag": w * 10 ** rng.uniform(-3, -0.5)}
        viscous = {"viscoelastic": 10 ** rng.uniform(-3, -1) / w}
        fields["damping"] = drag if rng.random() < 0.5 else viscous
    chain = Chain(**fields, ground=ground)
    speed = size * w * 10 ** rng.uniform(-2, 1.3)
    grain = int(rng.integers(1, chain.movable + 1))
    shaken = {"frequency": w / (2 * np.pi) * rng.uniform(0.1, 0.9)}
    excitation = [
        Impulse(velocity=speed, grain=grain),
        Displacement(displacement=speed / w, grain=grain),
        Force(amplitude=speed * w * chain.masses[0], grain=grain, **shaken),
        Drive(amplitude=speed / w, **shaken) if grains > 2 else Impulse(velocity=speed),
    ][rng.integers(4)]
    duration = 2 * np.pi / w * 10 ** rng.uniform(0, 1.5)
    samples = int(rng.integers(2, 80))
    scene = Scene(chain=chain, excitation=excitation, duration=duration, samples=samples)
    return scene, 10 ** rng.uniform(-10, -3)


def excess(seed: int) -> float:
    """Return the error of a random scene over its estimate or tolerance, whichever is larger.

    The error is what the reference leaves no doubt about; 0 for scenes that are refused.
    """
    try:
        scene, tolerance = draw(np.random.default_rng(seed))
    except InputError:
        return 0.0
    answer = simulate(scene, "native", tolerance=tolerance, on_miss="warn")
    try:
        exact = reference(scene)
    except RunFailed:
        return 0.0
    off = [
        np.abs(getattr(answer, field) - getattr(exact, field)).max() / size
        for field, size in zip(("displacement", "velocity"), exact.scale, strict=True)
    ]
    return (max(off) - exact.error) / max(tolerance, answer.error_estimate.solver)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "seeds",
    [
        range(0, 1),
        pytest.param(range(1, 8), marks=pytest.mark.slow),
        pytest.param(range(8, 40), marks=pytest.mark.soak),
    ],
)
def test_random_scenes_on_a_ground(seeds):
    """No error exceeds both the tolerance and the estimate of the run."""
    assert {seed: ratio for seed in seeds if (ratio := excess(seed)) > 1} == {}
