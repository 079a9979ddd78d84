"""Damping of a chain: allowed values, and the rebound of two spheres."""

import math
from itertools import product

import numpy as np
import pytest
from helpers.thinned import thinned
from scipy.integrate import solve_ivp

from lmpchain import Chain, Damping, Impulse, InputError, Scene, laws
from lmpchain.chain.contact_law import ContactLaw, Contacts, power_law
from lmpchain.chain.damping import rebound, viscosity_of, viscous_force
from lmpchain.chain.materials import STEEL


def chain(**damping) -> Chain:
    return Chain(grains=5, diameter=1e-3, damping=damping)


def test_common_values_and_lists():
    one = chain(viscoelastic=2e-8, drag=3.0)
    assert one.contact_viscosity == pytest.approx(np.full(6, 2e-8))
    assert one.drag == pytest.approx(np.full(5, 3.0))
    many = chain(viscoelastic=[1e-8, 2e-8, 3e-8, 4e-8], drag=[1.0, 2.0, 3.0, 4.0, 5.0])
    # A wall contact has the viscosity of the contact next to it.
    assert many.contact_viscosity.tolist() == [1e-8, 1e-8, 2e-8, 3e-8, 4e-8, 4e-8]
    assert many.drag.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert many.part(2, 4).contact_viscosity.tolist() == [2e-8, 2e-8, 3e-8, 3e-8]
    assert many.part(2, 4).drag.tolist() == [2.0, 3.0, 4.0]


def test_a_dict_and_a_record_are_equal():
    assert chain(drag=2.0) == Chain(grains=5, diameter=1e-3, damping=Damping(drag=2.0))
    assert not Chain(grains=5, diameter=1e-3, damping={}).damped
    assert not chain(drag=2.0).replace(damping=None).damped


def test_a_scene_file_has_a_table():
    damped = chain(viscoelastic=[1e-8, 2e-8, 3e-8, 4e-8], drag=3.0)
    scene = Scene(chain=damped, excitation=Impulse(velocity=1e-3), duration=1e-5)
    text = scene.to_text()
    assert "[chain.damping]" in text
    assert Scene.from_text(text) == scene


@pytest.mark.parametrize(
    ("damping", "key", "words"),
    [
        ({"viscoelastic": -1.0}, "damping.viscoelastic", "from 0"),
        ({"drag": math.inf}, "damping.drag", "finite"),
        ({"drag": "much"}, "damping.drag", "number"),
        ({"viscoelastic": [1e-8, 2e-8]}, "damping.viscoelastic", "one number, or 4 for 5 grains"),
        ({"drag": [1.0] * 4}, "damping.drag", "one number, or 5 for 5 grains"),
        ({"drag": [1.0, -1.0, 1.0, 1.0, 1.0]}, "damping.drag", "entry 2 is -1"),
        ({"viscous": 1.0}, "damping.viscous", "the keys here are viscoelastic, drag"),
        (0.1, "damping", "lmpchain.Damping"),
    ],
)
def test_invalid_damping_is_rejected(damping, key, words):
    with pytest.raises(InputError, match=words) as raised:
        Chain(grains=5, diameter=1e-3, damping=damping)
    assert raised.value.faults[0][0] == key


def test_a_dashpot_causes_a_warning():
    damped = Chain(grains=5, diameter=1e-3, damping={"viscoelastic": 1e-4})
    with pytest.warns(UserWarning, match="A omega is 32, so that contacts act as rigid dashpots"):
        Scene(chain=damped, excitation=Impulse(velocity=1e-6), duration=1e-5)
    softer = damped.replace(damping={"viscoelastic": 3.5e-5})
    with pytest.warns(UserWarning, match="A omega is 11, so"):
        Scene(chain=softer, excitation=Impulse(velocity=1e-6), duration=1e-5)


@pytest.mark.parametrize("law", [power_law(1.0), power_law(1.5), laws.bilinear(0.3), laws.hertz()])
def test_a_viscous_force_is_the_rate_of_the_elastic_force(law: ContactLaw):
    """It is 0 in an open contact, unless the contact pulls."""
    contacts = Contacts.at_rest(np.full(3, 1e6), np.ones(3), law)
    overlap = np.array([[-2e-6, 1e-6, 3e-6], [4e-6, -1e-9, 1e-6]])
    closing = np.array([[1.0, -2.0, 3.0], [-1.0, 2.0, 0.5]])
    viscosity = np.array([1e-8, 2e-8, 3e-8])
    step = 1e-11
    ahead, behind = (contacts.force_at(overlap + sign * step * closing) for sign in (1, -1))
    rate = viscosity * (ahead - behind) / (2 * step)
    found = viscous_force(contacts, viscosity, overlap, closing)
    assert found == pytest.approx(rate, rel=1e-6, abs=0)


def collision(viscosity: float, exponent: float) -> float:
    """Return the restitution from the velocity form, integrated until the overlap is 0 again."""

    def move(_, state):
        o, rate = state
        o = max(o, 0.0)
        return rate, -(o**exponent) - viscosity * exponent * o ** (exponent - 1) * rate

    def apart(_, state):
        return state[0]

    apart.terminal = True
    apart.direction = -1
    # Steps are short at the end, where the force is not smooth.
    options = {"rtol": 1e-12, "atol": 1e-15, "max_step": 0.01, "events": apart}
    return -solve_ivp(move, (0.0, 1e3), (0.0, 1.0), method="DOP853", **options).y[1, -1]


@pytest.mark.parametrize(
    ("exponent", "viscosity"), thinned(product([1.2, 1.5, 2.0, 3.0], [1e-4, 1e-2, 0.3, 1.0]), 3)
)
def test_the_rebound_agrees_with_the_velocity_form(viscosity, exponent):
    assert rebound(viscosity, exponent) == pytest.approx(collision(viscosity, exponent), abs=1e-9)


@pytest.mark.parametrize("ratio", [1e-3, 0.1, 0.5, 0.9])
def test_springs_rebound_as_a_damped_oscillator(ratio):
    exact = math.exp(-math.pi * ratio / math.sqrt(1 - ratio**2))
    assert rebound(2 * ratio, 1.0) == pytest.approx(exact, rel=1e-12)
    assert rebound(2.0, 1.0) == 0.0


@pytest.mark.parametrize(
    ("exponent", "restitution"),
    thinned(product([1.0, 1.5, 2.5], [0.02, 0.5, 0.93, 0.9999, 1.0]), 2),
)
def test_a_restitution_determines_its_viscosity(restitution, exponent):
    assert rebound(viscosity_of(restitution, exponent), exponent) == pytest.approx(
        restitution, abs=1e-11
    )


def test_a_faster_collision_of_the_same_spheres_loses_more():
    spheres = {"material": "steel", "diameter": 1e-2}
    slow = Damping.from_restitution(0.93, velocity=0.3, **spheres)
    fast = Damping.from_restitution(0.93, velocity=3.0, **spheres)
    # Equal spheres have half the mass, half the modulus and a quarter of the diameter as radius.
    mass = STEEL.density * math.pi / 6 * 1e-6 / 2
    modulus = STEEL.youngs_modulus / (1 - STEEL.poissons_ratio**2) / 2
    rate = (4 / 3 * modulus * math.sqrt(1e-2 / 4) / mass) ** 0.4 * 0.3**0.2
    weak = Damping.from_restitution(0.9999, velocity=0.3, **spheres)
    # To first order, 1 - e is 1.1534 x with x = 1.5 A (K / m)^(2/5) v^(1/5).
    assert 1.153449 * 1.5 * weak.viscoelastic * rate == pytest.approx(1e-4, rel=2e-4)
    # Springs, whose constant has one more root of the diameter, are damped oscillators.
    decay = math.log(2) / math.pi
    spring = Damping.from_restitution(0.5, velocity=0.3, exponent=1.0, **spheres)
    constant = 4 / 3 * modulus * math.sqrt(1e-2 / 4) * 1e-2**0.5
    time = 2 * decay / math.sqrt(1 + decay**2) * math.sqrt(mass / constant)
    assert spring.viscoelastic == pytest.approx(time, rel=1e-12)
    # The loss is proportional to A v^(1/5).
    assert fast.viscoelastic == pytest.approx(slow.viscoelastic * 10**-0.2, rel=1e-9)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("restitution", 0.0),
        ("restitution", 1.1),
        ("restitution", "0.9"),
        ("velocity", 0.0),
        ("diameter", math.inf),
        ("material", "stel"),
        ("exponent", 0.9),
        ("exponent", math.nan),
        ("exponent", "1.5"),
    ],
)
def test_impossible_restitutions_are_rejected(key, value):
    options = {"restitution": 0.9, "velocity": 1.0, "material": "steel", "diameter": 1e-2}
    with pytest.raises(InputError, match=key):
        Damping.from_restitution(**options | {key: value})
