"""Published numbers, or numbers from exact solutions, reproduced by the native engine.

Vacuum chains have unit masses and unit contact constants, so they are in the units of the
literature; a diameter of 100 only keeps overlaps small beside it.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers.example_chains import vacuum
from helpers.example_scenes import run
from helpers.interpolated_peak import find_peak
from numpy.typing import NDArray
from scipy.special import jv

import lmpchain

Array = NDArray[np.float64]


@pytest.mark.parametrize(
    ("strike_number", "grain", "ratio", "arrival"),
    [
        (1e-3, 10, 0.42463341, 8.347566),
        (1e-3, 50, 0.29624123, 31.889987),
        (1e-3, 100, 0.25174837, 56.526777),
        (1.0, 10, 0.43891187, None),
        (1.0, 50, 0.30375177, None),
        (1.0, 100, 0.25747592, None),
        (8.48, 10, 0.49907317, 7.284140),
    ],
)
def test_peak_velocity_in_a_column(
    strike_number: float, grain: int, ratio: float, arrival: float | None
) -> None:
    """Peak velocity over the strike, and its time over tau, for a Hertzian column struck on top.

    Source: two independent integrations (DOP853 at 1e-12) of the paper's Eq. (1), N >= 160.
    Tolerance 1e-6.
    """
    chain = lmpchain.Chain(grains=160, material=lmpchain.GLASS, diameter=1e-3)
    strike = strike_number * chain.length_scale / chain.time_scale
    end = 1.2 * grain ** (5 / 6) + 6
    t = run(
        chain,
        lmpchain.Impulse(velocity=strike),
        end * chain.time_scale,
        round(25 * end) + 1,
        1e-9,
        grains=[grain],
    )
    assert t.scene.strike_number == pytest.approx(strike_number, rel=1e-12)
    when, peak = find_peak(t.time / chain.time_scale, t.velocity[:, 0])
    assert peak / strike == pytest.approx(ratio, rel=1e-6)
    if arrival is not None:
        assert when == pytest.approx(arrival, rel=1e-6)


# The paper has Hertzian contacts and springs.
NATIVE = ("native", 1e-8, 1e-6)
LAMMPS = ("lammps", 1e-5, 1e-4)


@pytest.mark.parametrize(
    ("exponent", "factor", "engine", "tolerance", "off"),
    [
        (1.5, 0.9074700784, *NATIVE),
        (2.0, 0.855251932, *NATIVE),
        (3.0, 0.804760116, *NATIVE),
        pytest.param(1.5, 0.9074700784, *LAMMPS, marks=pytest.mark.slow),
    ],
)
def test_speed_of_a_soliton(
    exponent: float, factor: float, engine: str, tolerance: float, off: float
) -> None:
    """V = C v_m^((delta-1)/(delta+1)) for the pulse that a strike sends through a sonic vacuum.

    Source: C of the exact lattice soliton (fixed-point iteration as in Ahnert and Pikovsky 2009,
    English and Pego 2005), in m = K = D = 1. V from the peak times of two grains, v_m their peak
    velocity. Tolerance 1e-6, in LAMMPS 1e-4.
    """
    first = 60
    second = 80
    t = run(
        vacuum(90, exponent=exponent),
        lmpchain.Impulse(velocity=1.0),
        110.0,
        2751,
        tolerance,
        engine,
        grains=[first, second],
    )
    (early, low), (late, high) = (find_peak(t.time, v) for v in t.velocity.T)
    assert low == pytest.approx(high, rel=off), "the pulse must travel without change"
    speed = (second - first) / (late - early)
    assert speed / high ** ((exponent - 1) / (exponent + 1)) == pytest.approx(factor, rel=off)


@pytest.mark.parametrize(
    ("exponent", "peak", "energy", "momentum", "engine", "tolerance", "off"),
    [
        (1.5, 0.68163155, 0.99366104, 1.13830511, *NATIVE),
        (2.0, None, 0.99845214, None, *NATIVE),
        pytest.param(1.5, 0.68163155, 0.99366104, 1.13830511, *LAMMPS, marks=pytest.mark.slow),
    ],
)
def test_the_share_of_a_strike_in_its_first_soliton(
    exponent: float,
    peak: float | None,
    energy: float,
    momentum: float | None,
    engine: str,
    tolerance: float,
    off: float,
) -> None:
    """Peak velocity, energy and momentum of the leading pulse, relative to the striking grain.

    Source: 0.68 in the literature on Hertzian chains; the digits from the exact lattice soliton and
    direct impact runs. The fractions depend on the exponent alone (Deng et al., arXiv:2002.08499).
    Tolerance 1e-6, in LAMMPS 1e-4.
    """
    t = run(
        vacuum(110, exponent=exponent),
        lmpchain.Impulse(velocity=1.0),
        110.0,
        2751,
        tolerance,
        engine=engine,
    )
    when = int(t.velocity[:, 79].argmax())
    u, v = (x[when, 70:90] for x in (t.displacement, t.velocity))
    stored = (np.maximum(u[:-1] - u[1:], 0) ** (exponent + 1)).sum() / (exponent + 1)
    assert (v**2).sum() + 2 * stored == pytest.approx(energy, rel=off)
    if peak is not None:
        assert find_peak(t.time, t.velocity[:, 79])[1] == pytest.approx(peak, rel=off)
    if momentum is not None:
        assert v.sum() == pytest.approx(momentum, rel=off)


@pytest.mark.parametrize(
    ("exponent", "velocities"),
    [
        (1.5, [-0.07095235, 0.07640304, 0.99454931]),
        (1.5, [-0.07108502, -0.02962620, 0.10973864, 0.99097257]),
        (1.0, [-0.13026170, 0.15022957, 0.98003213]),
    ],
)
@pytest.mark.parametrize(
    ("engine", "tolerance", "off"),
    [("native", 1e-9, 1e-7), pytest.param("lammps", 1e-6, 1e-5, marks=pytest.mark.slow)],
)
def test_newtons_cradle(
    exponent: float, velocities: list[float], engine: str, tolerance: float, off: float
) -> None:
    """Final velocities of touching balls, the first of which strikes the others with velocity 1.

    Source: the problem of Hinch and Saint-Jean, Proc. R. Soc. A 455, 3201 (1999); digits by DOP853
    at 1e-12. Tolerance 1e-7, in LAMMPS 1e-5.
    """
    t = run(
        vacuum(len(velocities), exponent=exponent),
        lmpchain.Impulse(velocity=1.0),
        30.0,
        31,
        tolerance,
        engine=engine,
    )
    assert (np.diff(t.displacement[-1]) > 0).all(), "the balls must have parted"
    assert (np.diff(t.velocity[-1]) > 0).all(), "the balls must not meet again"
    assert t.velocity[-1] == pytest.approx(np.array(velocities), abs=off)


def test_column_of_linear_springs() -> None:
    """phi_n' = v0 (2n-1) J_(2n-1)(2 tau) / tau, and the displacement its integral, for delta = 1.

    Source: Eq. (13) of the paper, exact until the floor is felt and while no contact opens.
    Tolerance 1e-9.
    """
    chain = lmpchain.Chain(grains=60, material=lmpchain.GLASS, diameter=1e-3, exponent=1.0)
    strike = 0.1 * chain.length_scale / chain.time_scale
    t = run(chain, lmpchain.Impulse(velocity=strike), 25 * chain.time_scale, 126, 1e-10)
    tau = t.time[1:, None] / chain.time_scale
    n = np.arange(1, 61)
    velocity = (2 * n - 1) * jv(2 * n - 1, 2 * tau) / tau
    assert np.abs(t.velocity[1:] / strike - velocity).max() < 1e-9 * velocity.max()
    odd = jv(np.arange(1, 260, 2), 2 * tau)
    # Column n-1 contains J_(2n-1) + J_(2n+1) + ...
    above = np.cumsum(odd[:, ::-1], axis=1)[:, ::-1]
    displacement = above[:, :60] + above[:, 1:61]
    amplitude = strike * chain.time_scale
    assert np.abs(t.displacement[1:] / amplitude - displacement).max() < 1e-9 * displacement.max()


@pytest.mark.parametrize(
    ("exponent", "contact_time"),
    [
        (1.0, np.pi),
        (1.25, 3.0328176619),
        (1.5, 2.9432751843),
        (2.0, 2.8043642107),
        (3.0, 2.6220575543),
    ],
)
def test_contact_time_of_two_balls(exponent: float, contact_time: float) -> None:
    """Contact time of two colliding balls, t_c v / x_max, for any exponent.

    t_c v / x_max = 2 sqrt(pi) Gamma(1+q) / Gamma(1/2+q), q = 1/(delta+1), for two balls that
    collide.

    Source: classical; pi for springs, 2.9432751843 for Hertz. Tolerance 1e-8. Once parted the balls
    fly freely, so the moment at which the overlap was zero follows from any later sample.
    """
    strike = 1.0
    pair_mass = 0.5
    deepest = ((exponent + 1) / 2 * pair_mass * strike**2) ** (1 / (exponent + 1))
    t = run(
        vacuum(2, exponent=exponent),
        lmpchain.Impulse(velocity=strike),
        1.3 * contact_time * deepest / strike,
        261,
        1e-9,
    )
    overlap = t.displacement @ [1.0, -1.0]
    closing = t.velocity @ [1.0, -1.0]
    parted = np.flatnonzero(overlap < 0)
    assert len(parted) > 20
    assert closing[parted] == pytest.approx(-strike, rel=1e-8), "they part as fast as they met"
    moments = t.time[parted] - overlap[parted] / closing[parted]
    assert moments * strike / deepest == pytest.approx(contact_time, rel=1e-8)


@pytest.mark.parametrize("exponent", [1.5, 2.0, 3.0])
def test_a_sonic_vacuum_is_scale_invariant(exponent: float) -> None:
    """A motion of a vacuum chain is mapped to another by v -> s v, with powers of s for t and x.

    v -> s v, t -> s^(-(d-1)/(d+1)) t and x -> s^(2/(d+1)) x turn one motion of a vacuum chain into
    another.

    Source: exact similarity of Eq. (1) without gravity and load. Tolerance 1e-10, at steps that
    scale alike.
    """
    scale = 1e-3
    chain = vacuum(20, exponent=exponent)
    clock = scale ** (-(exponent - 1) / (exponent + 1))
    length = scale ** (2 / (exponent + 1))

    def motion(strike: float, duration: float) -> lmpchain.Trajectory:
        scene = lmpchain.Scene(
            chain=chain, excitation=lmpchain.Impulse(velocity=strike), duration=duration, samples=41
        )
        # This rounds to 500 steps per sample, independent of the last digit.
        step = duration / 40 / 499.5
        return lmpchain.simulate(scene, engine=lmpchain.engines.Native(step=step))

    one = motion(1.0, 40.0)
    other = motion(scale, 40.0 * clock)
    assert one.cost.steps == other.cost.steps
    assert np.abs(one.displacement[-1]).max() > 5, "the chain must have moved"
    for x, y in (
        (one.displacement * length, other.displacement),
        (one.velocity * scale, other.velocity),
    ):
        assert np.abs(x - y).max() < 1e-10 * np.abs(x).max()
