"""Bounds without arrays: never violated by the arrays, and close for the paper's column."""

import numpy as np
import pytest

from lmpchain import Chain, Impulse, Impurity, Law, Scene
from lmpchain.chain.bounds import least_compression
from lmpchain.chain.contact_law import power_law
from lmpchain.chain.materials import GLASS, kinds
from lmpchain.util.validation import make_unchecked


@pytest.mark.parametrize("seed", range(40))
def test_arrays_are_within_the_bounds(seed: int):
    random = np.random.default_rng(seed)
    # Rubber would be crushed by most of these loads.
    materials = ["glass", "steel", "ptfe", "brass", "tungsten_carbide"]
    top = random.choice(["free", "wall"])
    bottom = random.choice(["fixed", "wall"])
    grains = int(random.integers(2, 60))
    odd = [
        Impurity(
            grain=n,
            **{key: value for key, value in (
                ("diameter", random.uniform(5e-4, 3e-3)),
                ("material", str(random.choice(materials))),
                ("mass", 10 ** random.uniform(-7, -4)),
            ) if key == "diameter" or random.random() < 0.5},
        )
        for n in random.permutation(grains)[: random.integers(0, 3)] + 1
    ]  # fmt: skip
    chain = Chain(
        grains=grains,
        material=str(random.choice(materials)),
        diameter=random.uniform(5e-4, 3e-3),
        gravity=random.choice([0.0, 9.81, 500.0]),
        top_load=random.choice([0.0, 1e-3, 1.0]),
        exponent=random.choice([1.0, 1.5, 2.0, 3.0]),
        top=top,
        bottom=bottom,
        impurity=odd,
        **({"top_material": "steel"} if top == "wall" and random.random() < 0.5 else {}),
    )
    known = chain.bounds
    contacts = chain.contacts
    masses = chain.masses
    constants = contacts.constant[contacts.exists]
    assert known.softest <= constants.min() * (1 + 1e-12)
    assert constants.max() <= known.hardest * (1 + 1e-12)
    assert (known.lightest, known.heaviest) == pytest.approx(
        (masses.min(), masses.max()), rel=1e-14, abs=0
    )
    assert known.narrowest == chain.diameters.min()
    assert known.slowest == chain.by_grain("sound_speed").min()
    assert contacts.overlap.max() <= known.overlap * (1 + 1e-12)
    speed = 10 ** random.uniform(-6, 0)
    strike = Impulse(velocity=speed, grain=int(random.integers(1, chain.movable + 1)))
    overlaps = make_unchecked(Scene, chain=chain, excitation=strike, duration=1e-4).first_overlaps
    assert overlaps.max() <= known.struck(speed)
    fastest = np.sqrt(2 * contacts.stiffness_at(overlaps).max() / masses.min())
    assert fastest <= known.frequency(known.struck(speed))


@pytest.mark.parametrize("velocity", [1e-6, 8.57e-4, 0.05, -0.05])
@pytest.mark.parametrize("gravity", [0.0, 9.81])
def test_the_frequency_of_a_scene_equals_that_of_its_arrays(velocity: float, gravity: float):
    chain = Chain(grains=40, diameter=1e-3, gravity=gravity)
    scene = Scene(chain=chain, excitation=Impulse(velocity=velocity), duration=1e-4)
    pair = np.sqrt(2 * chain.contacts.stiffness_at(scene.first_overlaps).max() / chain.masses.min())
    assert scene.highest_frequency == (max(chain.band_edge, pair) or 1e4)


def test_bounds_are_close_for_the_column_of_the_paper():
    chain = Chain(grains=120, diameter=1e-3)
    assert chain.bounds.overlap == pytest.approx(chain.contacts.overlap.max(), rel=0.01)
    assert chain.bounds.hardest == pytest.approx(
        np.sqrt(2) * chain.contact_constants.max(), rel=1e-12
    )


@pytest.mark.parametrize(
    "fields", [{"diameter": [1e-3] * 5}, {"masses": [1e-6] * 5}, {"contact_constants": [1e9] * 4}]
)
def test_listed_grains_have_no_bounds(fields: dict[str, list[float]]):
    assert Chain(**{"grains": 5, "diameter": 1e-3} | fields).bounds is None


def test_least_compressions_of_long_chains() -> None:
    """The bound is the compression by the load and the common grains; other laws may be stiffer."""
    odd = (Impurity(grain=3, mass=1.0),)
    few = kinds(GLASS, 1e-3, odd)
    hertz = power_law(1.5)
    modulus = 62e9 / (1 - 0.2**2)
    constant = 4 / 3 * modulus / 2 * np.sqrt(1e-3 / 4)
    force = 2.0 + 9.81 * (10**6 - 3 * 2) * 2426.0 * np.pi / 6 * 1e-9
    expected = (force / constant) ** (2 / 3) / 1e-3
    assert least_compression(few, 10**6, 2.0, 9.81, hertz) == pytest.approx(expected, rel=1e-12)
    assert least_compression(few, 10**6 - 1, 2.0, 9.81, hertz) == 0.0
    by_square = (force / (constant * 1e-3**-0.5)) ** 0.5 / 1e-3
    assert least_compression(few, 10**6, 2.0, 9.81, power_law(2.0)) == pytest.approx(
        by_square, rel=1e-12
    )
    text = "k*max(o, 0)**1.5*c"
    same = Law(text, c=1.0)
    assert least_compression(few, 10**6, 2.0, 9.81, same) == pytest.approx(expected, rel=1e-12)
    for own in (Law(text, c=1.0, k=1e12), Law(text, c=[1.0, 2.0])):
        assert least_compression(few, 10**6, 2.0, 9.81, own) == 0.0
