"""Laws as formulas: evaluation, printing, and rejected formulas."""

import pickle
import time
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from lmpchain import Chain, InputError, Law
from lmpchain.chain.formula import parse

LAWS = [
    ("k*max(o, 0)**1.5*(1 + c*o)", {"k": 2.0, "c": 3.0}),
    ("k*(exp(b*o) - 1)", {"k": 2.0, "b": -1.3}),
    ("k*o + a*o**2 + b*o**3", {"k": 1.0, "a": 0.3, "b": 2.0}),
    ("k*(step(o) + 0.3*step(-o))*o", {"k": 2.0}),
    ("k*max(o, 0)**0.6", {"k": 1.0}),
    ("k*(max(o, -0.3) + 0.3)**2.5*o**2", {"k": 2.0}),
    ("k*sin(w*o + 0.2)*o**3", {"k": 1.0, "w": 2.0}),
    ("k*tanh(2*o)", {"k": 1.0}),
    ("abs(o - 0.2)*o - min(o, 0.5, 0.1)", {}),
    ("k*max(max(o, 0) - 0.2, 0)", {"k": 1.0}),
    ("k*exp(-o)*exp(2*o)*o**2", {"k": 1.0}),
    ("k*(o - 3*o**2 + o**3)**2", {"k": 1.0}),
    ("log(3 + o)", {}),
    ("o/(1 + o)", {}),
    ("k*cos(o)*o**2", {"k": 1.0}),
    ("-o**2 - (-o)**2 + 2**-o/3*(4 - (o - 1))", {}),
    ("sqrt(4 + o)*o", {}),
]
UNKNOWN_ENERGY = ("-o**2 - (-o)**2 + 2**-o/3*(4 - (o - 1))",)
PLACES = np.array([-0.7, -0.1, 0.05, 0.3, 0.9])
LEPTON = {"max": max, "min": min, "abs": abs, "step": lambda x: float(x >= 0)}
LEPTON |= {key: getattr(np, key) for key in ("exp", "log", "sin", "cos", "tanh", "sqrt")}
LEPTON["select"] = lambda c, a, b: a if c else b


@pytest.mark.parametrize(("text", "parameters"), LAWS)
def test_a_law_is_printed_differentiated_and_integrated(
    text: str, parameters: dict[str, float]
) -> None:
    law = Law(text, **parameters)
    assert parse(law.text) is law.formula
    assert pickle.loads(pickle.dumps(law)) == law
    step = 1e-6
    slope = (law.force(PLACES + step) - law.force(PLACES - step)) / (2 * step)
    assert law.stiffness(PLACES) == pytest.approx(slope, rel=1e-7, abs=1e-8)
    for place, energy in zip(PLACES, law.energy(PLACES), strict=True):
        kinks = [-0.3, 0.0, 0.1, 0.2, 0.5]
        exact = quad(law.force, 0.0, place, points=kinks, epsabs=1e-13, limit=200)[0]
        assert energy == pytest.approx(exact, rel=1e-8, abs=1e-11)


@pytest.mark.parametrize(("text", "parameters"), LAWS)
def test_lepton_has_the_same_force_and_energy(text: str, parameters: dict[str, float]) -> None:
    law = Law(text, **parameters)
    force = law.lepton("force").replace("^", "**")
    closed = law.formula.substitute(parameters).integral("o") is not None
    energy = law.lepton().replace("^", "**") if closed else ""
    assert closed == (text not in UNKNOWN_ENERGY)
    for place in PLACES:
        names: dict[str, Any] = LEPTON | {"r": -place}
        assert eval(force, names) == pytest.approx(law.force(place), rel=1e-13)
        if energy:
            assert eval(energy, names) == pytest.approx(law.energy(place), rel=1e-8, abs=1e-13)


@pytest.mark.parametrize("key", ["r", "p", "n", "given", "q0"])
def test_a_parameter_may_have_the_name_of_an_internal_variable(key: str) -> None:
    law = Law(f"k*(max(o, 0) + {key}*min(o, 0))", k=1e5, **{key: 0.3})
    chain = Chain(grains=3, diameter=1e-3, top_load=1e-3, law=law)
    closer = np.array([0.0, -3e-8, 1e-7, 0.0])
    found = chain.contacts.force_change(closer)
    # The contacts are compressed by at least 10 nm.
    expected = law.force(chain.contacts.overlap + closer) - law.force(chain.contacts.overlap)
    assert found[1:3] == pytest.approx(expected[1:3], rel=1e-12)


def test_parameters_may_be_given_for_each_contact() -> None:
    law = Law("k*max(o, 0)**n", n=[1.5, 1.3, 0.6], k=1e6)
    expected = 1e6 * np.float64(1e-6) ** np.array([1.5, 1.3, 0.6])
    assert law.force(1e-6) == pytest.approx(expected, rel=1e-14)
    assert law.energy(1e-6) == pytest.approx(expected * 1e-6 / [2.5, 2.3, 1.6], rel=1e-10)
    assert law.lepton("force", contact=2) == "(1000000.0*(max((-r),0.0)^0.6))"
    assert law == law.replace(k=1e6) != law.replace(k=2e6)
    assert len({law, law.replace(), law.replace(n=2)}) == 2


def test_a_wall_has_the_constant_of_the_contact_next_to_it() -> None:
    ends = {"top": "wall", "bottom": "wall", "gravity": 0.0, "top_load": 1.0}
    chain = Chain(grains=4, diameter=1e-3, law=Law("k*o", k=[1e6, 2e6, 3e6]), **ends)
    assert chain.contact_constants.tolist() == [1e6, 2e6, 3e6]
    assert chain.wall_constants.tolist() == [1e6, 3e6]
    alike = chain.replace(law=Law("k*o", k=2e6))
    assert alike.wall_constants.tolist() == [2e6, 2e6]


# Formulas are separated by | and by line ends.
WRONG = """a*o|k*o)|__import__('os')|o.real|o[0]|k*o+force|u*o|3|o if o else 1|lambda: 0|9**9**9*o
1e999*o|o^2|sin*o|max(o)|o+1j|True*o|None|nan*o|ö*o|o;o|o\nk|f(o)|exp(o, o)|exp(x=o)|max(*[o])|o@o
o//2|o%2|o and o|not o|~o|o<0|[o]|{o}|(o,o)|"o"|b"o"|f"{o}"|...|o:=1|__o*o|o**1e200|print(o)|eval(o)
exec(o)|open(o)|getattr(o, o)|o.__class__|globals()|().__class__|o if|yield o|await o|import os|o=1
1_0e400*o|0x10*o*'a'|o&o|o|||1/0*o|0/0*o|log(-1)*o|sqrt(-1)*o|(-1)**0.5*o|o is o
select(o,1,2)|where(o)|o!r|o->o|o:o|0o7*o or 1|k*o if 1 else 2""".replace("\n", "|").split("|")
WRONG = [text for text in WRONG if text not in ("", "o")]
WRONG += [
    "o" * 1001,
    "-" * 900 + "o",
    "o" + "+o" * 300,
    "o" + "**o" * 90,
]
WRONG += [
    "max(o, " * 60 + "1" + ")" * 60,
    "9" * 400 + "*o",
    "",
    " ",
    "#o",
    "o\x00",
    "o\\",
    "exp(" * 99,
]
WRONG += [
    f"{opening}o{closing}" for opening in "([{'\"`$!?@#&;:=<>~" for closing in "]}'\"`$!?@&;:=<>~"
]


@pytest.mark.parametrize("text", WRONG)
def test_invalid_formulas_are_rejected_at_once(text: str) -> None:
    begun = time.perf_counter()
    with pytest.raises(InputError):
        Law(text)
    assert time.perf_counter() - begun < 0.5


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "c: is not given"),
        ({"c": 1, "d": 2}, "d: is not in the formula"),
        ({"c": 1, "o": 2}, "o: is a variable"),
        ({"c": "1"}, "c: must be a number"),
        ({"c": [[1.0]]}, "c: must be a number"),
        ({"c": True}, "c: must be a number"),
        ({"c": np.nan}, "c: must be finite"),
        ({"c": [1.0, 2.0], "k": [1.0, 2.0, 3.0]}, "force: has parameters of lengths"),
    ],
)
def test_wrong_parameters_are_named(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Law("k*o*c", **parameters)
