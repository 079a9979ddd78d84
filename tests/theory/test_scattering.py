"""Scattering of linear waves: closed forms, a dense linear solve, conservation, refusals."""

from typing import Any
from warnings import catch_warnings

import numpy as np
import pytest
from helpers.faults import faults
from scipy.optimize import brentq

from lmpchain import Chain, Impulse, InputError, Law, Scene
from lmpchain.design.parameters import check
from lmpchain.disorder.draws import disordered
from lmpchain.theory.scattering import transmission, transparent

LOADED = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
HOST = Chain(grains=11, **LOADED)
EDGE = 2 / HOST.time_scale
RNG = np.random.default_rng(5)


def solved(chain: Chain, w: float) -> tuple[complex, complex]:
    """Return amplitudes by a dense linear solve for all grains and both outgoing waves.

    Beyond its band edge a lead has the wave that decays: z + 1/z = 2 - m w^2 / k with ``|z| < 1``.
    """
    m = chain.masses
    k = chain.linear_stiffness
    n = chain.grains
    q = []
    for end in (0, -1):
        sine = w / 2 * np.sqrt(m[end] / k[end])
        decay = 1j * np.arccosh(max(2 * sine**2 - 1, 1)) + np.pi
        q.append(2 * np.arcsin(sine) if sine <= 1 else decay)
    matrix = np.zeros((n, n), complex)
    right = np.zeros(n, complex)
    for i in range(n):  # The unknowns are all displacements, with phi_1 = 1 + r and phi_N = t.
        above = k[max(i - 1, 0)]
        below = k[min(i, n - 2)]
        matrix[i, i] = above + below - m[i] * w**2
        if i:
            matrix[i, i - 1] = -above
        if i < n - 1:
            matrix[i, i + 1] = -below
    matrix[0, 0] -= k[0] * np.exp(1j * q[0])
    right[0] = k[0] * (np.exp(-1j * q[0]) - np.exp(1j * q[0]))
    matrix[-1, -1] -= k[-1] * np.exp(1j * q[1])
    phi = np.linalg.solve(matrix, right)
    return phi[0] - 1, phi[-1]


def test_a_uniform_chain_transmits_everything():
    w = EDGE * np.linspace(1e-6, 1 - 1e-6, 7)
    found = transmission(HOST, w)
    assert np.abs(found.reflected).max() < 1e-20
    assert found.amplitude_transmitted == pytest.approx(
        np.exp(1j * 10 * found.wavenumber), abs=1e-12
    )


def test_energy_is_conserved_in_long_pieces():
    chain = Chain(
        grains=3000, diameter=RNG.uniform(0.7e-3, 1.3e-3, 3000), gravity=0.0, top_load=1.0
    )
    edge = 2 * min(np.sqrt(chain.linear_stiffness[end] / chain.masses[end]) for end in (0, -1))
    found = transmission(chain, edge * np.linspace(0.01, 0.9, 30))
    assert np.abs(found.reflected + found.transmitted - 1).max() < 1e-12
    assert found.transmitted.min() < 1e-100


def test_a_wave_that_cannot_propagate_is_reflected():
    """Amplitudes and phases on both sides of the band edge of the lower lead."""
    heavy = Chain(
        grains=9,
        material=["steel"] * 4 + ["tungsten_carbide"] * 5,
        diameter=[1e-3] * 4 + [3e-3] * 5,
        gravity=0.0,
        top_load=1.0,
    )
    edge = 2 * np.sqrt(heavy.linear_stiffness[-1] / heavy.masses[-1])
    w = edge * np.array([0.9, 0.9999, 1.0001, 1.1, 2.0])
    found = transmission(heavy, w)
    exact = np.array([solved(heavy, one) for one in w]).T
    assert found.amplitude_reflected == pytest.approx(exact[0], rel=1e-10)
    assert found.amplitude_transmitted == pytest.approx(exact[1], rel=1e-10)
    assert 0 < np.abs(found.amplitude_transmitted[4]) < 1e-3
    assert found.transmitted[0] > 0.01
    assert found.transmitted[2:].tolist() == [0.0, 0.0, 0.0]
    assert found.reflected == pytest.approx(1 - found.transmitted, abs=1e-13)
    assert found.frequency.tolist() == w.tolist()
    above = w / 2 * np.sqrt(heavy.masses[0] / heavy.linear_stiffness[0])
    assert found.wavenumber == pytest.approx(2 * np.arcsin(above), rel=1e-14)


def masses_that_are_transparent(k: float, apart: int) -> float:
    """Return the factor on two distant masses at which a wavenumber passes."""
    return 1 + 1 / np.tan(k * apart) / np.tan(k / 2)


@pytest.mark.parametrize("apart", [1, 4])
def test_masses_of_two_impurities_that_are_transparent(apart: int):
    """For two point scatterers (mu - 1) w^2 m / k = 2 sin(k) cot(k d), within the bounds."""
    grains = {1: [5, 6], 4: [4, 8]}[apart]
    numbers = []
    for k in (0.2, 1.7):
        factor = masses_that_are_transparent(k, apart)
        expected = [factor] if 0.1 < factor < 10 else []
        found = transparent(HOST, EDGE * np.sin(k / 2), grains, "mass")
        assert found == pytest.approx(expected, rel=1e-9)
        numbers.append(len(expected))
    assert 0 in numbers
    assert 1 in numbers


@pytest.mark.parametrize(("factor", "count"), [(0.099, 0), (0.101, 1), (9.9, 1), (10.1, 0)])
def test_factors_are_searched_between_a_tenth_and_ten(factor: float, count: int):
    apart, grains = (1, [5, 6]) if factor > 1 else (4, [4, 8])
    k = np.linspace(0.3, 0.6, 300)
    off = masses_that_are_transparent(k, apart) - factor
    (turn, *_) = np.flatnonzero((off[:-1] * off[1:] < 0) & (np.abs(off[:-1]) < 1))
    k = brentq(
        lambda k: masses_that_are_transparent(k, apart) - factor, k[turn], k[turn + 1], xtol=1e-15
    )
    w = EDGE * np.sin(k / 2)
    assert transparent(HOST, w, grains, "mass").size == count


def test_diameter_and_modulus_of_the_factor():
    """The contacts and masses are written out: K ~ sqrt(R*) / E*, k ~ K^(2/3), m ~ d^3."""
    for vary in ("diameter", "youngs_modulus"):
        # Nothing warns of chains that the search alone has tried.
        with catch_warnings(action="error"):
            factors = transparent(HOST, 0.62 * EDGE, [5, 6], vary)
        assert factors.size > 0
        for factor in factors:
            grains = np.ones(11)
            grains[4:6] = factor
            pair = 2 / (1 / grains[1:] + 1 / grains[:-1])
            stiffness = (np.sqrt(pair) if vary == "diameter" else pair) ** (2 / 3)
            mass = grains**3 if vary == "diameter" else np.ones(11)
            chain = Chain(grains=11, diameter=1e6, gravity=0.0, top_load=1e-9, exponent=1.0,
                          masses=mass, contact_constants=stiffness)  # fmt: skip
            reflected, passed = solved(chain, 2 * 0.62)
            assert abs(reflected) < 1e-9
            assert abs(passed) == pytest.approx(1, rel=1e-9)


def test_allowed_positions_of_grains():
    """All but the two grains at either end may change; a single one has no resonance in mass."""
    w = 0.5 * EDGE
    transparent(HOST, w, [3, 4, 5, 6, 7, 8, 9], "mass", (0.9, 1.1))
    assert transparent(HOST, w, [6], "mass").size == 0
    for grains in ([2, 10], [2, 9], [3, 10], [5, 5], [4, 5, 7]):
        assert {key for key, _ in faults(transparent, HOST, w, grains, "mass")} == {"grains"}
    with pytest.raises(InputError, match=r"^grains: must be from 3 to 9, so that"):
        transparent(HOST, w, [2, 10], "mass")


def test_picture():
    found = transmission(
        Chain(grains=11, **LOADED, impurity=[{"grain": 5, "diameter": 2e-3}]),
        EDGE * np.array([0.1, 0.9]),
    )
    (axes,) = found.plot().figure.axes
    for line, name in zip(axes.lines, ("transmitted", "reflected"), strict=True):
        assert line.get_label() == name
        assert line.get_xdata() == pytest.approx(found.frequency / (2 * np.pi), rel=1e-15)
        assert line.get_ydata().tolist() == getattr(found, name).tolist()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("frequency", "share of the energy")
    assert axes.xaxis.get_major_formatter()(2e3) == "2 kHz"
    low, high = axes.get_ylim()
    assert -0.05 < low < 0
    assert 1 < high < 1.05
    assert len(axes.get_legend().get_texts()) == 2


def test_the_message_about_the_band_edge():
    steel = Chain(grains=4, material=["steel"] * 2 + ["glass"] * 2, **LOADED)
    edge = 2 * np.sqrt(steel.linear_stiffness[0] / steel.masses[0])
    text = f"must be above 0 and below {edge:.6g} rad/s, the band edge of the lead above"
    for w in (0.0, edge, 1.0001 * edge):
        assert faults(transmission, steel, w) == [("frequency", text)]
    assert transmission(steel, 0.9999 * edge).reflected <= 1


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: transmission(Chain(grains=5, diameter=1e-3, gravity=0.0), 1.0), "chain"),
        (lambda: transmission(HOST, [0.5 * EDGE, EDGE * 1.001]), "frequency"),
        (lambda: transmission(HOST, 0.0), "frequency"),
        (lambda: transparent(HOST, 0.5 * EDGE, [4, 5, 7]), "grains"),
        (lambda: transparent(HOST, 0.5 * EDGE, []), "grains"),
        (lambda: transparent(HOST, 0.5 * EDGE, [1, 2]), "grains"),
        (lambda: transparent(HOST, 0.5 * EDGE, [5, 6], "colour"), "vary"),
        (lambda: transparent(HOST, 0.5 * EDGE, [5, 6], between=(2.0, 1.0)), "between"),
        (lambda: transparent(HOST, 0.5 * EDGE, [5, 6], between=(0.0, 1.0)), "between"),
        (
            lambda: transparent(
                Chain(**HOST.given() | {"impurity": [{"grain": 5, "mass": 1e-6}]}), 1e5, [5, 6]
            ),
            "chain",
        ),
        (lambda: transmission(Chain(grains=1, bottom="wall", **LOADED), 1.0), "grains"),
        (lambda: transparent(Chain(grains=11, diameter=1e-3), 1e5, [5, 6]), "gravity"),
        (
            lambda: transparent(Chain(grains=2, **LOADED, masses=[1e-6, 1e-6]), 1e5, [5, 6]),
            "grains",
        ),
    ],
)
def test_refusals(call, key: str):
    with pytest.raises(InputError, match=f"^{key}: "):
        call()


UNEVEN: list[dict[str, Any]] = [
    {"material": ["glass"] * 10 + ["steel"]},
    {"diameter": [*[1e-3] * 10, 1.01e-3]},
    {"masses": [*[1e-6] * 10, 1.01e-6]},
    {"contact_constants": [*[1e9] * 9, 1.01e9]},
    {"law": Law("k*o*c", c=[*[1.0] * 9, 1.01])},
]


@pytest.mark.parametrize("uneven", UNEVEN)
def test_only_equal_grains_and_contacts_are_a_uniform_chain(uneven: dict[str, Any]) -> None:
    chain = HOST.replace(**uneven)
    message = "must be uniform, with equal grains and contacts"
    assert faults(transparent, chain, 0.5 * EDGE, [5, 6]) == [("chain", message)]
    if "material" in uneven:  # Equal materials may be listed.
        listed = HOST.replace(material=["glass"] * 11)
        found, expected = (
            transparent(one, 0.62 * EDGE, [5, 6], "youngs_modulus") for one in (listed, HOST)
        )
        assert found == pytest.approx(expected, rel=1e-10)


def test_the_former_name_of_a_modulus_is_rejected_with_the_current_name(rng):
    chain = Chain(grains=10, diameter=1e-3, gravity=0.0, top_load=1.0)
    with pytest.raises(InputError, match="did you mean 'youngs_modulus'"):
        transparent(chain, 1e5, [5, 6], vary="modulus")
    with pytest.raises(InputError, match="did you mean 'youngs_modulus'"):
        disordered(chain, 9, rng, of="modulus")
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=1e-5)
    with pytest.raises(InputError, match="did you mean 'youngs_modulus'"):
        check(scene, ["youngs_moduli"])
