"""Laws by formula against exact and published results: Toda, FPUT, bilinear springs, a cradle."""

from math import asinh, log, pi, sinh, sqrt

import numpy as np
import pytest
from helpers.example_scenes import scene_of, struck

import lmpchain
from lmpchain import Chain, Impulse, Law, Profile, laws
from lmpchain.engines import Native

B, K = 1e5, 1e3  # In 1/m and N/m.
ROW = {"diameter": 1e-2, "gravity": 0.0}
WALLS = {**ROW, "top": "wall", "bottom": "wall"}
Long = np.longdouble


def flaschka(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the traces of L^2 to L^M of Flaschka's matrix, of displacements b u and momenta.

    Phys. Rev. B 9, 1924 (1974). A chain between walls is half of a ring of M = 2N + 2 grains, in
    which the other half moves in the opposite direction and two grains rest.
    """
    q, p = (np.concatenate(([0], x, [0], -x[::-1])).astype(Long) for x in (u, v))
    a = np.exp((q - np.roll(q, -1)) / 2) / 2
    matrix = np.diag(p / 2)
    for n, coupling in enumerate(a):
        beside = (n + 1) % a.size
        matrix[n, beside] += coupling
        matrix[beside, n] += coupling
    power = matrix
    traces = []
    for _ in range(a.size - 1):
        power = power.dot(matrix)
        traces.append(np.trace(power))
    return np.array(traces)


@pytest.mark.slow
def test_flaschkas_integrals_are_conserved_for_100_periods() -> None:
    grains = 8
    chain = Chain(grains=grains, **WALLS, law=laws.toda(B, k=K))
    unit = sqrt(chain.masses[0] / K)
    slowest = pi / np.sin(pi / 2 / (grains + 1)) * unit  # Longest period of weak waves, s.
    # The strike is as fast as a wave: bonds are stretched by more than 1 / b.
    strike = Impulse(velocity=1 / (B * unit), grain=3)
    scene = scene_of(chain, strike, 100 * slowest, 51)
    run = lmpchain.simulate(scene, "native", tolerance=1e-11)
    states = zip(run.displacement * B, run.velocity * (B * unit), strict=True)
    integrals = np.array([flaschka(u, v) for u, v in states])
    change = np.abs(integrals - integrals[0]).max(axis=0)
    # Traces of odd powers are 0, because both halves of the ring are opposite.
    size = np.abs(integrals).max(axis=0)
    assert (change[0::2] / size[0::2]).max() < 1e-12
    assert change[1::2].max() < 1e-12 * size.max()
    # The energy of the linear chain is no integral: the scene is far from linear.
    linear = (run.velocity * B * unit) ** 2 + np.diff(run.displacement * B, prepend=0) ** 2
    assert np.ptp(linear.sum(axis=1)) > 0.1 * linear[0].sum()


KAPPA = 2.0, 0.8


def solitons(n: np.ndarray, t: float, starts: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return b u and its rate for Toda's two solitons, up to a constant (Toda, 1967)."""
    rates = [sinh(kappa) for kappa in KAPPA]
    meeting = (sinh((KAPPA[0] - KAPPA[1]) / 2) / sinh((KAPPA[0] + KAPPA[1]) / 2)) ** 2

    def logarithm(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        phases = [
            2 * (kappa * (n - start) - rate * t)
            for kappa, start, rate in zip(KAPPA, starts, rates, strict=True)
        ]
        terms = np.array([0 * n, phases[0], phases[1], phases[0] + phases[1] + log(meeting)])
        total = np.logaddexp.reduce(terms, axis=0)
        speeds = -2 * np.array([0, rates[0], rates[1], sum(rates)])
        return total, speeds @ np.exp(terms - total)

    before, after = logarithm(n - 1), logarithm(n)
    return before[0] - after[0], before[1] - after[1]


def phase(strain: np.ndarray, kappa: float) -> float:
    """Return kappa times the position of a soliton, given overlaps of its bonds times b."""
    peak = int(strain.argmax()) + 2
    # For a bond before the peak, exp(b o) - 1 = (sinh kappa / cosh theta)^2.
    root = sinh(kappa) / sqrt(np.expm1(strain[peak]))
    return kappa * peak - asinh(sqrt(root**2 - 1))


def test_a_collision_of_two_toda_solitons() -> None:
    grains, starts, later = 180, (40.0, 62.0), 60.0
    chain = Chain(grains=grains, **ROW, law=laws.toda(B, k=K))
    unit = sqrt(chain.masses[0] / K)
    n = np.arange(1, grains + 1, dtype=float)
    place, rate = solitons(n, 0.0, starts)
    start = Profile(displacement=(place - place[-1]) / B, velocity=rate / (B * unit))
    scene = scene_of(chain, start, later * unit, 2)
    run = lmpchain.simulate(scene, "native", tolerance=1e-11)
    exact = solitons(n, later, starts)[0]
    off = run.displacement[-1] * B - (exact - exact[-1])
    assert np.abs(off).max() < 1e-9
    before, after = (-np.diff(u * B) for u in run.displacement)
    # The slower soliton is ahead at first, the faster one at the end.
    meets = 51
    fast = phase(before[:meets], KAPPA[0])
    crossed = int(after.argmax()) - 15
    fast_later = phase(after[crossed:], KAPPA[0]) + KAPPA[0] * crossed
    slow = phase(before[meets:], KAPPA[1]) + KAPPA[1] * meets
    slow_later = phase(after[:crossed], KAPPA[1])
    shift = -log(sinh((KAPPA[0] - KAPPA[1]) / 2) / sinh((KAPPA[0] + KAPPA[1]) / 2))
    assert fast_later - fast - sinh(KAPPA[0]) * later == pytest.approx(shift, abs=1e-9)
    assert slow_later - slow - sinh(KAPPA[1]) * later == pytest.approx(-shift, abs=1e-9)


SINE = np.sin(pi * np.arange(1, 32) / 32)


def fput(duration: float, step: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the time and mode energies of the Fermi-Pasta-Ulam-Tsingou chain in their units.

    31 grains between walls, alpha = 1/4, a sine of amplitude 1: Fig. 1 of report LA-1940 (1955).
    The figure has 4000 times the energies, and the step of the report is sqrt(1/8).
    """
    size = 1e-6  # Unit of length of Fermi et al., m.
    chain = Chain(grains=31, **WALLS, law=laws.fput(0.25 * K / size, k=K))
    unit = sqrt(chain.masses[0] / K)
    engine = Native("verlet", step=step * unit * (1 + 1e-9)) if step else Native()
    scene = scene_of(
        chain,
        Profile(displacement=size * SINE),
        duration * unit,
        round(duration / (step or 1.0)) + 1,
    )
    run = lmpchain.simulate(scene, engine, tolerance=1e-8)
    number = np.arange(1, 32)
    modes = np.sin(pi * np.outer(number, number) / 32) / 4
    omega = 2 * np.sin(pi * number / 64)
    amplitude = run.displacement / size @ modes
    speed = run.velocity * unit / size @ modes
    return run.time / unit, 2000 * (speed**2 + (omega * amplitude) ** 2)


def test_the_recurrence_of_fermi_pasta_ulam_and_tsingou() -> None:
    """With the published step sqrt(1/8), 97.8 % of the energy is in mode 1 after 157 periods.

    Such is the published result (Weissert, The Genesis of Simulation in Dynamics, 1997, and
    others). In exact time the energy returns after 146.4 periods, because a long step weakens the
    dispersion.
    """
    period = pi / np.sin(pi / 64)
    step = sqrt(1 / 8)
    own, energies = fput(30000 * step, step)
    late = own > 5000
    back = energies[late, 0].argmax()
    assert own[late][back] / period == pytest.approx(157, abs=0.5)
    assert energies[late, 0][back] / energies[0, 0] == pytest.approx(0.978, abs=1e-3)
    assert energies[0, 0] == pytest.approx(308.18, abs=0.01)
    # No other mode than the first five ever has more than 7 % of the energy.
    assert energies[:, 5:].max() < 0.07 * energies[0, 0]
    time, exact = fput(11000.0)
    late = time > 5000
    back = exact[late, 0].argmax()
    assert time[late][back] / period == pytest.approx(146.44, abs=0.02)
    assert exact[late, 0][back] / exact[0, 0] == pytest.approx(0.9813, abs=1e-4)


@pytest.mark.parametrize("ratio", [0.1, 0.5, 3.0])
def test_a_bilinear_oscillator(ratio: float) -> None:
    """Shaw and Holmes, J. Sound Vib. 90, 129 (1983): its period is the mean of two."""
    law = laws.bilinear(ratio, k=K)
    chain = Chain(grains=1, **ROW, bottom="wall", law=law)
    pressed = sqrt(K / chain.masses[0])
    stretched = pressed * sqrt(ratio)
    speed = 1e-3
    period = pi / pressed + pi / stretched
    scene = struck(chain, speed, 10 * period, 401)
    run = lmpchain.simulate(scene, "native", tolerance=1e-10)
    phase = run.time % period
    later = phase > pi / pressed
    exact = np.where(
        later,
        -np.cos(stretched * (phase - pi / pressed)),
        np.cos(pressed * phase),
    )
    assert np.abs(run.velocity[:, 0] / speed - exact).max() < 1e-9


@pytest.mark.parametrize(
    ("grains", "speeds"),
    [
        (3, [-0.07095235, 0.07640304, 0.99454931]),
        (4, [-0.07108502, -0.02962620, 0.10973864, 0.99097257]),
    ],
)
def test_newtons_cradle(grains: int, speeds: list[float]) -> None:
    """Grains that touch separate with the speeds of Hinch and Saint-Jean (1999)."""
    law = Law("k*max(o, 0)**1.5", k=1e9)
    chain = Chain(grains=grains, **ROW, bottom="free", law=law)
    scene = struck(chain, 0.1, 5e-3, 3)
    run = lmpchain.simulate(scene, "native", tolerance=1e-9)
    assert run.velocity[-1] / 0.1 == pytest.approx(speeds, abs=1.5e-8)
