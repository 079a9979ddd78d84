"""First compression of contacts by an excitation, against collisions of two bodies."""

import re
import tracemalloc
from itertools import product
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of
from helpers.faults import remarks

from lmpchain import (
    Chain,
    Displacement,
    Drive,
    Force,
    Impulse,
    Impurity,
    InputError,
    Material,
    Profile,
)
from lmpchain.scene.facts import SceneFacts
from lmpchain.util.validation import make_unchecked

STRIKES = {
    "grain 1": Impulse(velocity=2e-3),
    "grain 2": Impulse(velocity=-2e-3, grain=2),
    "inside": Displacement(displacement=-1e-8, grain=5),
    "last that moves": Impulse(velocity=2e-3, grain=8),
    "driven": Drive(amplitude=1e-8, frequency=1e5),
    "driven from motion": Drive(
        amplitude=-1e-8, frequency=1e5, start=Profile(velocity=[0, 0, 0, -2e-3, 0, 0, 0, 0, 0])
    ),
    "profile": Profile(
        displacement=[0, 0, 1e-8, 0, -2e-8, 0, 0, 0, 0], velocity=[0, 0, 0, 0, 0, 1e-3, 0, 0, 0]
    ),
    "upward": Profile(velocity=[-3e-3, 0, 0, 0, 0, 1e-3, 0, 0, 0]),
    "force": Force(grain=3, amplitude=-1e-3, frequency=1e4),
    "nothing": Profile(velocity=np.zeros(9)),
    "wall": Drive(amplitude=1e-8, frequency=1e5, grain=0),
    "wall and grain 1": Drive(
        amplitude=1e-8, frequency=1e5, grain=0, start=Profile(velocity=-1e-3 * np.eye(9)[0])
    ),
}
ENDS: dict[str, dict[str, Any]] = {
    "held": {},
    "walls": {"top": "wall", "bottom": "wall", "top_load": 1e-4},
    "wall that touches": {"top": "wall"},
    "vacuum": {"gravity": 0.0, "bottom": "free"},
    "various": {"diameter": np.linspace(1e-3, 2e-3, 9), "bottom": "wall"},
}
CASES = [
    pytest.param(STRIKES[strike], ENDS[ends], id=f"{strike}, {ends}")
    for strike, ends in product(STRIKES, ENDS)
    if "top" not in ENDS[ends] or not strike.startswith("driven")  # Grain 1 is behind a wall.
    if "top" in ENDS[ends] or not strike.startswith("wall")
]


def chain_of(ends: dict[str, Any]) -> Chain:
    return Chain(
        **{"grains": 9, "diameter": 1e-3, "impurity": [Impurity(grain=4, mass=1e-5)]} | ends
    )


def one_by_one(chain: Chain, strike: Any) -> list[float]:
    """Return the largest first overlap of each contact, m, from its two bodies alone."""
    contacts = chain.contacts
    delta = chain.exponent
    (u, begun) = strike.initial(chain)
    (_, v) = strike.largest(chain)
    deepest = []
    for n in range(chain.grains + 1):
        if not contacts.constant[n]:
            deepest.append(0.0)
            continue
        above = n >= 1 and not (strike.driven and n == 1)
        below = n < chain.movable and not (strike.driven and n == 0)
        gives_way = (1 / chain.masses[n - 1] if above else 0) + (
            1 / chain.masses[n] if below else 0
        )
        closer = (u[n - 1] if n >= 1 else 0) - (u[n] if n < chain.grains else 0)
        speed = (v[n - 1] if n >= 1 else 0) - (v[n] if n < chain.grains else 0)
        if strike.does_work:
            closer = abs(closer)
            speed = abs(speed)
        if n == 0 and strike.kind == "drive" and strike.grain == 0:
            speed = 2 * np.pi * strike.frequency * abs(strike.amplitude) + max(-begun[0], 0)
        energy = max(speed, 0) ** 2 / 2 / gives_way if gives_way else 0.0
        hit = ((delta + 1) * energy / contacts.constant[n]) ** (1 / (delta + 1))
        deepest.append(max(contacts.overlap[n] + closer, hit))
    return deepest


@pytest.mark.parametrize(("strike", "ends"), CASES)
@pytest.mark.parametrize("exponent", [1.5, 2.0])
def test_first_overlaps_agree_with_pairs_of_bodies(
    strike: Any, ends: dict[str, Any], exponent: float
) -> None:
    chain = chain_of(ends | {"exponent": exponent})
    scene = make_unchecked(SceneFacts, chain=chain, excitation=strike, duration=1e-5)
    assert scene.first_overlaps == pytest.approx(one_by_one(chain, strike), rel=1e-12, abs=1e-20)


@pytest.mark.parametrize(("strike", "ends"), CASES)
def test_facts_about_a_strike_agree_with_the_whole_chain(strike: Any, ends: dict[str, Any]) -> None:
    chain = chain_of(ends)
    scene = scene_of(chain, strike, 1e-5)
    energy = np.inf if strike.does_work else chain.excess_energy(*scene.initial())
    assert scene.energy == pytest.approx(energy, rel=1e-14)
    u, v = (np.abs(x[: chain.movable]) for x in strike.largest(chain))
    assert scene.at_rest == (not u.any() and not v.any())
    assert scene.imposed == pytest.approx((u.max(), v.max()), rel=1e-14)
    if chain.compressed:
        below = np.append(chain.equilibrium_overlap, chain.contacts.overlap[-1])[: chain.movable]
        stiffness = np.append(chain.linear_stiffness, chain.contacts.stiffness[-1])[: chain.movable]
        number = max(
            (u / below).max(),
            (v / (below * np.sqrt(stiffness / chain.masses[: chain.movable]))).max(),
        )
    else:
        number = 0.0 if scene.at_rest else np.inf
    assert scene.strike_number == pytest.approx(number, rel=1e-14)
    overlaps = np.array(one_by_one(chain, strike))
    stiffest = (chain.exponent * chain.contacts.constant * np.sqrt(overlaps)).max()
    pair = np.sqrt(2 * stiffest / chain.masses.min())
    expected = max(chain.band_edge, strike.fastest, pair) or 1 / scene.duration
    assert scene.highest_frequency == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("grain", [1, 2, 5, 7, 8])
def test_too_hard_a_strike_names_the_contact_and_its_compression(grain: int) -> None:
    """The energy v^2 / 2 times the reduced mass gives (2/5) K depth^(5/2); grain 9 is fixed."""
    rubber = Material(density=1000, youngs_modulus=1e5, poissons_ratio=0.49)
    chain = column(9, material=rubber, gravity=0.0)
    inertia = chain.masses[0] * (1 if grain == 8 else 0.5)
    depth = (1.25 * inertia * 3.0**2 / chain.contact_constants[0]) ** 0.4
    message = (
        f"squeezes contact {grain} to {depth / 1e-3:.2g} of the diameter, more than 0.1: strike "
        "more gently"
    )
    with pytest.raises(InputError, match=re.escape(message)):
        scene_of(chain, Impulse(velocity=3.0, grain=grain), 1e-5)
    least = 3.0 * (0.1 / (depth / 1e-3)) ** 1.25
    scene_of(chain, Impulse(velocity=0.999 * least, grain=grain), 1e-5)
    with pytest.raises(InputError, match=r"more than 0\.1"):
        scene_of(chain, Impulse(velocity=1.001 * least, grain=grain), 1e-5)


def test_facts_about_a_strike_come_from_the_grains_around_it() -> None:
    """Facts about a strike on a long chain cost no arrays over all of its grains."""
    many = column(20_000, bottom="wall")
    wide = np.zeros(20_000)
    wide[[99, 101]] = 1e-4
    for strike, first, last in (
        (Impulse(velocity=1e-4), 1, 3),
        (Impulse(velocity=1e-4, grain=2), 1, 4),
        (Impulse(velocity=1e-4, grain=300), 299, 302),
        (Impulse(velocity=1e-4, grain=19_999), 19_998, 20_000),
        (Profile(velocity=wide), 99, 104),
    ):
        scene = make_unchecked(SceneFacts, chain=many, excitation=strike, duration=1e-5)
        tracemalloc.start()
        contact, relative = scene.first_squeeze
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        # An array over the chain takes 160 kB; a profile consists of such arrays.
        assert most < (1e6 if strike.kind == "profile" else 2e4)
        largest = [np.abs(values).max() for values in strike.largest(many)]
        assert scene.imposed == pytest.approx(largest, rel=1e-14)
        assert scene.energy == pytest.approx(strike.energy(many), rel=1e-9)
        overlaps = scene.first_overlaps[first - 1 : last + 1]
        inside = overlaps[1:-1] if last < 20_000 else overlaps[1:]
        assert contact == first + int(np.argmax(inside))
        assert relative == pytest.approx(inside.max() / 1e-3, rel=1e-12)


def test_hits_beyond_hertz_and_faster_than_sound_cause_remarks() -> None:
    """The limits are a hundredth of the diameter and the speed of sound of the grain."""

    def said(chain: Chain, excitation: Any) -> list[str]:
        return remarks(scene_of, chain, excitation, 1e-5, 11)

    chain = column(9, gravity=0.0)
    depth = (1.25 * chain.masses[0] / 2 * 1.0**2 / chain.contact_constants[0]) ** 0.4 / 1e-3
    limit = (0.01 / depth) ** 1.25
    assert not said(chain, Impulse(velocity=0.999 * limit, grain=4))
    (text,) = said(chain, Impulse(velocity=1.1 * limit, grain=4))
    deepest = f"{0.01 * 1.1**0.8:.2g}"
    assert text.startswith(
        f"velocity: a contact is compressed by {deepest} of the diameter; Hertz's"
    )
    (text,) = said(chain, Force(grain=4, amplitude=300.0, frequency=1.0))
    assert text.startswith("kind: a contact is compressed by ")
    soft = column(9, gravity=0.0, exponent=1.0, top_load=1e-3, masses=[1e-20] * 9)
    sound = np.sqrt(62e9 / 2426)
    assert not said(soft, Impulse(velocity=0.999 * sound, grain=4))
    (text,) = said(soft, Profile(velocity=sound * np.array([0, 0, 1.001, 0, 1.2, 0, 0, 0, 0])))
    fast = f"grain 5 moves at {1.2 * sound:.3g} m/s, faster than sound in its material, {sound:.3g}"
    assert text == f"velocity: {fast} m/s"
    pressed = column(9, gravity=0.0, top_load=30.0)
    assert pressed.contacts.overlap.max() > 1e-5
    assert not said(pressed, Impulse(velocity=1e-3))
    steep = column(9, gravity=0.0, exponent=2.0)
    assert not said(steep, Impulse(velocity=20.0))
