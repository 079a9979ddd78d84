"""Laws as formulas: evaluation, printing, and rejected formulas."""

import math
import pickle
import re
import time
import warnings
from types import SimpleNamespace
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from helpers.example_scenes import scene_of
from helpers.faults import faults
from scipy.integrate import quad

from lmpchain import Chain, Impulse, InputError, Law, laws, simulate
from lmpchain.chain.contact_law import Contacts, together
from lmpchain.chain.formula import parse
from lmpchain.chain.law import solve_growing

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
    ("tanh(2*o - 1) - 3*log(3 + 2*o) + 1/(3*o - 5)", {}),
    ("o**3*exp(0.5*o) + exp(o)**2*o + o**2*cos(2*o - 1) - o*sin(1 - 3*o)", {}),
    ("o**2*sqrt(3 + 2*o) - o**2/(3 + o)**3 + (o**2 - 1)**3/4 + (2*o - 3)**2*o", {}),
    ("(o + 1)**25 - 2*abs(o)**2.5 + min(o, 0.1)*max(o, -0.3)", {}),
    ("k*step(c)*o + step(-c) + max(0.2, c)*step(o - c)", {"k": 2.0, "c": 0.5}),
    ("o*(exp(0.5) - log(2) + sin(1) - cos(1) + tanh(1)*sqrt(2)/abs(-3))", {}),
    ("o*(max(1, 2) - min(3, 4)*step(-1) + 2**0.5 - step(0.3) - step(0))", {}),
    ("o*tanh(o)", {}),
    ("o*log(3 + o)", {}),
    ("exp(o**2)*o", {}),
    ("sin(o)*tanh(o)", {}),
    ("tanh(o)**2", {}),
    ("o**13*exp(o)", {}),
    ("sqrt(o + 1)/(o - 2)", {}),
    # Neither a product nor a sum is expanded to more than 200 terms.
    ("(1 + o + o**2)**6 - o**2", {}),
    ("o**2 - (1 + o + o**2)**6", {}),
]
UNKNOWN_ENERGY = (LAWS[15][0], *(text for text, _ in LAWS[-9:]))
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
    assert closed == (text not in UNKNOWN_ENERGY)
    if closed:
        energy = law.lepton().replace("^", "**")
    else:
        energy = ""
        fault = f"has no energy in closed form: {law.text}: use the native engine"
        assert faults(law.lepton) == [("force", fault)]
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
    assert law.onset == 0.6
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


def test_a_law_without_a_constant_has_those_of_hertz() -> None:
    fields: dict[str, Any] = {
        "material": ["steel", "ptfe", "glass"], "diameter": [1e-3, 2e-3, 3e-3]
    }  # fmt: skip
    own = Chain(grains=3, law=Law("k*max(o, 0)**1.5*(1 + c*o)", c=0.1), bottom="wall", **fields)
    hertz = Chain(grains=3, bottom="wall", **fields)
    assert own.contact_constants == pytest.approx(hertz.contact_constants, rel=1e-14)
    assert own.wall_constants == pytest.approx(hertz.wall_constants, rel=1e-14)


# Formulas are separated by | and by line ends.
WRONG = """a*o|k*o)|__import__('os')|o.real|o[0]|k*o+force|u*o|3|o if o else 1|lambda: 0|9**9**9*o
1e999*o|o^2|sin*o|max(o)|o+1j|True*o|None|nan*o|ö*o|o;o|o\nk|f(o)|exp(o, o)|exp(x=o)|max(*[o])|o@o
o/0|(-2)**o|0**o|o//2|o%2|o and o|not o|~o|o<0|[o]|{o}|(o,o)|"o"|b"o"|f"{o}"|...|o:=1|__o*o
o**1e200|print(o)|eval(o)|exec(o)|open(o)|getattr(o, o)|o.__class__|globals()|().__class__|o if
yield o|await o|import os|o=1
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


def test_every_limit_of_a_formula_is_as_documented() -> None:
    """Length, length of names, size of numbers, depth, operations and conditions."""

    def at(limit: int) -> tuple[str, ...]:
        return (
            "o" + " " * (999 + limit),
            "a" * (30 + limit) + "*o",
            f"{10 + limit}e99*o",
            "-" * (40 + limit) + "o",
            "max(" + ", ".join(["o"] * (199 + limit)) + ")",
            "+".join(f"max(o, {n})" for n in range(6 + limit)),
        )

    # Long formulas are shown in part, without warnings of Python about them.
    long = "1or o" + " or o" * 12
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for text, part in ((f"{long[:59]})", f"{long[:59]})"), (f"{long})", f"{long[:57]}...")):
            assert faults(Law, text) == [("force", f"is not a valid formula: {part!r}")]
    assert not caught
    words = ("1001 characters", "up to 30 letters", "above 1e+100", "40 levels", "200 numbers")
    for text, wrong, said in zip(at(0), at(1), (*words, "than 6 different"), strict=True):
        assert "o" in parse(text).names
        with pytest.raises(InputError, match=re.escape(said)):
            parse(wrong)


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
    for text, fault in (
        ("o*force", "has a parameter named force: give it another name"),
        ("o + u", "contains both o (of a contact) and u or t (of the ground): use one kind"),
        ("3*force", "depends on neither the overlap o nor the displacement u"),
    ):
        assert ("force", fault) in faults(Law, text, force=1.0)
    missing = "is missing: a formula such as 'k*max(o, 0)**1.5'"
    assert faults(Law.from_table, parameters) == [("force", missing)]


EXACT = {key: getattr(mp, key) for key in ("exp", "log", "sin", "cos", "tanh", "sqrt")}
EXACT |= {"max": max, "min": min, "abs": abs, "step": lambda x: mp.mpf(x >= 0)}
# The language of variables of LAMMPS; the parser of LAMMPS has no other conditional function.
LAMMPS = {key: getattr(math, key) for key in ("exp", "sin", "cos", "sqrt")}
LAMMPS |= {"abs": abs, "ln": math.log, "ternary": lambda c, a, b: a if c else b}
FORMULAS = """o**5 - o|-o**3|(o - 2)**-3|(2*o + 3)**7|(o - 0.07)**2|max(o, 0)**0.6|max(0, o)**0.6
max(o, 0)**3.5|max(o, 0)**0.25|2**o|(2 + o)**(o - 3)|max(0, o)**(1 + o)|3**(2*o)/(4 - o)|sqrt(2 + o)
exp(-2*o)|log(2 + o)|sin(3*o)|cos(3*o - 1)|tanh(2*o)|(1 + o)*(2 - o)|o/(2 + o)**2|1/(o - 4)
-(o - 0.3)|step(o - 0.2)|step(o)*(o + 1)|max(o, 0.2)|min(0.2, o)|max(0.3, 2*o)*min(2*o, o - 1)
abs(o - 0.2)|abs(o)*o|abs(max(o, 0) - 0.4)|max(o, 0)**1.5*(1 + 3*o)
max(max(o, -0.4), 3*o, 2*o + 0.02)|0.1*min(o, -o) - 2*-o|step(0.2 - o)*exp(o)
sqrt(3 + max(o, 0)*o)|tanh(o)**2 - log(3 - o)*o|sin(step(o) + o)
o*(max(1, 2) - min(3, 4)*step(-1) + 2**0.5 - step(0.3) - 3*step(0))
o*(exp(0.5) - log(2) + sin(1) - cos(1) + tanh(1)*sqrt(2)/abs(-3) - (-2))"""


@pytest.mark.parametrize("text", FORMULAS.replace("\n", "|").split("|"))
def test_values_slopes_and_changes_equal_those_in_40_digits(text: str) -> None:
    """The relative accuracy of a change of force does not depend on the size of the change."""
    law = Law(text)
    lammps = law.formula.lammps.replace("^", "**")
    changes = [1e-17, -1e-11, 0.021, 0.34, -0.37, -1.2]
    with mp.workdps(40):

        def exact(overlap: float, change: Any = 0) -> Any:
            return eval(text, EXACT | {"o": mp.mpf(overlap) + change})

        values = [exact(o) for o in PLACES]
        h = mp.mpf("1e-12")
        slopes = [(exact(o, h) - exact(o, -h)) / (2 * h) for o in PLACES]
        differences = [[float(exact(o, r) - exact(o)) for r in changes] for o in PLACES]
    assert law.force(PLACES) == pytest.approx(np.array(values, float), rel=1e-13)
    assert law.stiffness(PLACES) == pytest.approx(np.array(slopes, float), rel=1e-12)
    for o, value in zip(PLACES.tolist(), values, strict=True):
        assert eval(lammps, LAMMPS | {"o": o}) == pytest.approx(float(value), rel=1e-13)
    rest = SimpleNamespace(overlap=PLACES[:, None], constant=1.0)
    found = law.force_change(rest, np.array(changes))
    # The slopes of some formulas are 0 or almost 0 at one of the places.
    assert found == pytest.approx(np.array(differences), rel=3e-12, abs=1e-30)


def test_parts_that_do_not_change_are_computed_once() -> None:
    outer, kept = parse("sin(o)**2*r + sin(o)*(o + r)").without(["o"], "q")
    assert outer.text == "q1*r + q0*(o + r)"
    assert [part.text for part in kept] == ["sin(o)", "sin(o)**2"]


@pytest.mark.parametrize("power", [3, 2, 1, -3])
def test_a_whole_power_may_be_a_parameter(power: int) -> None:
    """Bases of either sign, which may change their sign, have real whole powers."""
    law = Law("k*(2*o - 0.3)**p", k=K, p=[power, 1.5, power])
    rests = np.array([-0.4, 0.2, 0.9])[:, None, None] * np.ones(3)
    changes = np.array([-1.7, -1e-9, 1e-12, 0.3, 1.1])[:, None]
    contacts = SimpleNamespace(overlap=rests, constant=K)
    written = Law(f"k*(2*o - 0.3)**{power}", k=K).force_change(contacts, changes)
    found = law.force_change(contacts, changes)
    assert found[..., [0, 2]] == pytest.approx(written[..., [0, 2]], rel=1e-9)


def test_energies_beyond_distant_kinks_have_closed_forms() -> None:
    law = Law("max(o - 3, 0)**2 - 2*max(-2 - o, 0) + min(o, 7)")
    energy = law.lepton(overlap="r").replace("^", "**")
    for o in (-6.0, -2.5, -1.0, 2.0, 4.0, 9.0):
        exact = max(o - 3, 0) ** 3 / 3 + max(-2 - o, 0) ** 2 + min(o, 7) ** 2 / 2
        exact += 7 * max(o - 7, 0)
        assert eval(energy, LEPTON | {"r": o}) == pytest.approx(exact, rel=1e-14)
        assert law.energy(o) == pytest.approx(exact, rel=1e-12)


SHAPES = [  # Onset, and whether contacts pull and bond.
    ("max(o, 0)**1.5*(1 + 3*o)", 1.5, False, False),
    ("max(o, 0)**0.6", 0.6, False, False),
    ("max(o, 0)**3 + max(o - 1e-3, 0)**2", 2.0, False, False),
    ("max(o, 0)**2.7", 2.7, False, False),
    ("max(o, 0)**3", 3.0, False, False),
    ("max(o, 0)**7", 4.0, False, False),  # Smoother than every method needs.
    ("step(o)*(1 + o)", 0.0, False, False),
    ("step(o)*o", 1.0, False, False),
    ("exp(o) - 1", 1.5, True, True),
    ("exp(o)", 1.5, True, False),  # It never rests.
    ("o - o**2 + o**3", 1.5, True, True),
    ("max(o, 0) + 0.3*min(o, 0)", 1.0, True, False),  # It rests at a kink.
    ("o**3", 1.5, True, False),
    ("o + max(o + 0.2, 0)**2.5", 2.5, True, True),
    ("max(o, 0)**1.5 - 1e-3*min(1, max(0, 1 + 20*o))", 1.0, True, True),
    ("abs(o - 0.2)*o + min(o, 0.5)", 1.0, True, True),
]


@pytest.mark.parametrize(("text", "onset", "pulls", "bonds"), SHAPES)
def test_the_shape_of_a_law_follows_from_its_formula(
    text: str, onset: float, pulls: bool, bonds: bool
) -> None:
    law = Law(text)
    assert (law.onset, law.pulls, law.bonds) == (onset, pulls, bonds)
    # Every contact counts.
    scaled = Law(f"c*({text})", c=[2.0, 1.0, 3.0])
    assert (scaled.onset, scaled.pulls, scaled.bonds) == (onset, pulls, bonds)


K = 1e4
WIDTH = 1e-6
CLOSED = np.array([1e-9, 3e-7, 2e-6])  # Overlaps, m.
STRETCHED = -CLOSED
# Laws of the literature, their forces, and places.
LITERATURE = [
    (laws.hertz, {}, lambda o: K * o**1.5, CLOSED),
    (laws.hertz, {}, lambda o: 0 * o, STRETCHED),
    (laws.power, {"exponent": 2.5}, lambda o: K * o**2.5, CLOSED),
    (laws.fput, {}, lambda o: K * o, STRETCHED),
    (laws.fput, {"alpha": 3e9, "beta": 2e15}, lambda o: K * o - 3e9 * o**2 + 2e15 * o**3, CLOSED),
    (laws.toda, {"b": 1e6}, lambda o: K * np.expm1(1e6 * o) / 1e6, STRETCHED),
    (laws.bilinear, {"tension": 0.3}, lambda o: 0.3 * K * o, STRETCHED),
    (laws.bilinear, {"tension": 0.3}, lambda o: K * o, CLOSED),
    (laws.softening, {"length": WIDTH}, lambda o: K * WIDTH * np.tanh(o / WIDTH), STRETCHED),
    (laws.dmt, {"pull": 1e-6, "reach": 1e-6}, lambda o: K * o**1.5 - 1e-6, CLOSED),
    (
        *(laws.dmt, {"pull": 1e-6, "reach": WIDTH}),
        *(lambda o: -1e-6 * np.maximum(1 + o / WIDTH, 0), STRETCHED),
    ),
    (
        *(laws.bistable, {"a": 1e-6, "b": 3e-6}),
        *(lambda o: K * o * (1 + o / 1e-6) * (1 + o / 3e-6), STRETCHED),
    ),
    (laws.klein_gordon, {}, lambda u: K * u, STRETCHED),
    (laws.klein_gordon, {"beta": 1e15}, lambda u: K * u + 1e15 * u**3, STRETCHED),
    (
        *(laws.frenkel_kontorova, {"period": 1.7e-6}),
        *(lambda u: K * np.sin(2 * np.pi * u / 1.7e-6) * 1.7e-6 / (2 * np.pi), CLOSED),
    ),
    (laws.mathieu, {"depth": 0.4, "frequency": 1e3}, lambda u: 1.4 * K * u, CLOSED),
]


@pytest.mark.parametrize(("law", "parameters", "force", "places"), LITERATURE)
def test_laws_of_the_literature(law: Any, parameters: Any, force: Any, places: Any) -> None:
    given = law(**parameters, k=K)
    assert given.force(places) == pytest.approx(force(places), rel=1e-9, abs=1e-30)
    if not given.of_ground:
        # Without k, the constants are those of the chain.
        own = law(**parameters)
        assert own.force(places, K).tolist() == given.force(places).tolist()
        assert own.given_constant is None
        assert given.given_constant.tolist() == [K]


def test_overlaps_under_a_force_and_an_energy_have_closed_forms() -> None:
    """Bounded, exponential, bilinear, adhesive, cubic and bistable contacts."""
    force = np.array([1e-7, 2e-3, 9e-3])
    tanh, toda, adhesive = laws.softening(WIDTH, K), laws.toda(2e6, K), laws.dmt(1e-5, WIDTH, K)
    assert tanh.overlap(force) == pytest.approx(WIDTH * np.arctanh(force / (K * WIDTH)), rel=1e-13)
    assert toda.overlap(-force / 2) == pytest.approx(np.log1p(-1e6 * force / K) / 2e6, rel=1e-11)
    assert adhesive.overlap(force) == pytest.approx(((force + 1e-5) / K) ** (2 / 3), rel=1e-13)
    assert adhesive.overlap(-5e-6) == pytest.approx((5e-6 / K) ** (2 / 3), rel=1e-13)
    cubic = laws.fput(-3e9, 2e15, K)
    roots = [np.roots([2e15, 3e9, K, -f]) for f in force]
    real = [float(x[np.argmin(np.abs(x.imag))].real) for x in roots]
    assert cubic.overlap(force) == pytest.approx(real, rel=1e-9)
    with pytest.raises(InputError, match=r"has no equilibrium under 0\.011 N"):
        tanh.overlap(0.011)
    with pytest.raises(InputError, match="has 2 equilibria under 0 N"):
        Law("k*(o + L)*o*(o - L)/L**2", k=K, L=WIDTH).overlap(0.0)
    with pytest.raises(InputError, match="has no equilibrium under -2e-05 N"):
        adhesive.overlap(-2e-5)
    with pytest.raises(InputError, match="has an undefined stiffness at an overlap of 0: use"):
        Law("k*(o + sqrt(o**2))**1.5", k=K).overlap(0.0)
    with pytest.raises(InputError, match="has no equilibrium under 0 N"):
        Law("-k*o", k=K).overlap(0.0)
    # The overlap at which a contact stores an energy, and the stretch of a bond that is stiffer.
    energy = np.array([1e-18, 1e-9, 1e-6])
    with mp.workdps(40):
        cosh = [WIDTH * mp.acosh(mp.exp(e / (K * WIDTH**2))) for e in energy.tolist()]
        # exp(x) - 1 - x = y has the solutions x = -y - 1 - W(-exp(-y - 1)).
        ys = [mp.mpf(e) * mp.mpf(2e6) ** 2 / K for e in energy.tolist()]
        closing = [(-y - 1 - mp.lambertw(-mp.exp(-y - 1), -1)).real / 2e6 for y in ys]
        opening = [(y + 1 + mp.lambertw(-mp.exp(-y - 1))).real / 2e6 for y in ys]
    assert tanh.approach(energy, K) == pytest.approx(np.array(cosh, float), rel=1e-5)
    assert toda.approach(energy, K) == pytest.approx(np.array(closing, float), rel=1e-8)
    assert laws.toda(-2e6, K).approach(energy, K) == pytest.approx(
        np.array(opening, float), rel=1e-5
    )
    for tension in (0.3, 3.0):
        bilinear = laws.bilinear(tension, K)
        assert bilinear.approach(energy, K) == pytest.approx(np.sqrt(2 * energy / K), rel=1e-12)
    assert laws.hertz(K).approach(energy, K) == pytest.approx((2.5 * energy / K) ** 0.4, rel=1e-12)
    # Beyond its largest force, nothing holds a contact.
    pressed = Contacts.at_rest(np.array([K]), np.array([4e-3]), tanh).of(0)
    more = WIDTH * (np.arctanh(0.9) - np.arctanh(0.4))
    assert pressed.squeezed_by(5e-3) == pytest.approx(more, rel=1e-12)
    assert pressed.squeezed_by(7e-3) == np.inf
    # A contact whose force decreases anywhere may receive any energy from others.
    for law, bounded in ((tanh, True), (adhesive, False)):
        contacts = Contacts.at_rest(np.array([K]), np.array([4e-3]), law)
        assert np.isfinite(contacts.approach_bound(1e-12)).all() == bounded


def test_a_growing_function_is_inverted_between_0_and_infinity() -> None:
    """Powers, exponentials and saturating functions; a jump is found where it passes the value."""
    target = np.array([0.0, 1e-12, 0.3, 0.999, 7.0, 1e200, np.inf])
    with np.errstate(all="ignore"):
        exact = {
            "power": (lambda x: x**2.5, lambda x: 2.5 * x**1.5, target**0.4),
            "exponential": (np.expm1, np.exp, np.log1p(target)),
            "saturating": (np.tanh, lambda x: np.cosh(x) ** -2.0, np.arctanh(target)),
            "jump": (lambda x: x + 10.0 * (x >= 1), np.ones_like, np.minimum(target, 1.0)),
        }
        exact["saturating"][2][4:] = np.inf
        exact["jump"][2][5:] = target[5:]
    for function, slope, x in exact.values():
        for start in (1e-6, 1e5):
            assert solve_growing(function, slope, target, start) == pytest.approx(x, rel=1e-12)
    # Springs have overlaps up to 100 m.
    ends = np.array([-99.0, 99.0])
    assert Law("k*o", k=2.0).overlap(2 * ends) == pytest.approx(ends, rel=1e-14)
    for force in (-201.0, 201.0):
        with pytest.raises(InputError, match="has no equilibrium under"):
            Law("k*o", k=2.0).overlap(force)


def test_only_the_powers_of_the_package_replace_a_formula() -> None:
    for exponent in (1, 1.5, 2.7, 3):
        assert Law(f"k*max(o, 0)**{exponent}").as_exponent == exponent
    assert Law("k*sqrt(max(o, 0)**3)").as_exponent == 1.5
    # The root of a square is a magnitude, and has no slope at 0.
    assert Law("k*sqrt(o**2)", k=K).force(np.array([-2.0, 2.0])).tolist() == [2 * K, 2 * K]
    others = [
        "k*max(o, 0)**0.9",
        "k*max(o, 0)**3.1",
        "k*max(o, 0)**p",
        "k*max(0, o)",
        "max(o, 0)*k",
    ]
    others += ["k*max(o, 0)*o", "k*max(o, 1e-9)", "max(o, 0)**2", "k + max(o, 0)", "2*max(o, 0)"]
    for text in others:
        assert Law(text, **({"p": 1.5} if "p" in text else {})).as_exponent is None
    assert Law("k*max(o, 0)**1.5", k=1.0).as_exponent is None


def test_energies_of_large_overlaps_are_exact() -> None:
    """The force changes over lengths that may be a small part of the overlap."""
    x = np.array([1.0, 3.0, 30.0, 100.0, 300.0])
    unit = K * WIDTH**2
    bent = Law("k*(o + 0.5*sin(b*o)/b)", k=K, b=1 / WIDTH)
    for law, energy in (
        (laws.softening(WIDTH, K), x + np.log1p(np.exp(-2 * x)) - np.log(2)),
        (laws.toda(1 / WIDTH, K), np.expm1(x) - x),
        (laws.toda(-1 / WIDTH, K), np.expm1(-x) + x),
        (bent, x**2 / 2 + 0.5 * (1 - np.cos(x))),
        (Law("k*o/sqrt(1 + (b*o)**2)", k=K, b=1 / WIDTH), np.sqrt(1 + x**2) - 1),
    ):
        each = [law.energy(overlap) for overlap in x * WIDTH]
        assert each == pytest.approx(unit * energy, rel=1e-7)
        loose = Contacts.at_rest(np.array([K]), np.zeros(1), law)
        assert loose.energy(x[:, None] * WIDTH)[:, 0] == pytest.approx(unit * energy, rel=1e-7)


@pytest.mark.parametrize("text", ["o/d", "o*(1/d)", "k*o*d**-1", "k*o*d**-0.7", "k*o*log(d)"])
@pytest.mark.parametrize("zero", [0, 0.0, [1.0, 0.0]])
def test_a_parameter_of_0_under_a_fraction_gives_no_equilibrium(text: str, zero: Any) -> None:
    law = Law(text, d=zero)
    assert not np.isfinite(law.force(1e-6, 1e3)).all()
    with pytest.raises(InputError, match=r"law: has no equilibrium|law: is infinitely stiff"):
        _ = Chain(grains=3, diameter=1e-3, law=law)
    ground = Law(text.replace("o", "u").replace("lug", "log").replace("k*", ""), d=zero)
    with pytest.raises(InputError, match=r"ground\.force: has no finite stiffness"):
        Chain(grains=2, diameter=1e-3, top_load=1.0, gravity=0.0, ground=ground)


def test_hardening_on_both_sides_is_that_of_the_mean_stiffness() -> None:
    """The mean stiffness over -r ... r of k (o + o^3 / L^2) is k (1 + r^2 / L^2)."""
    cubic = Law("k*(o + o**3/L**2)", k=K, L=WIDTH)
    contacts = Contacts.at_rest(np.array([K, 0.0, K]), np.zeros(3), cubic)
    # The second derivative of the stiffness, 6 k / L^2, changes it by k within L / sqrt(3).
    assert contacts.length[[0, 2]] == pytest.approx(WIDTH / np.sqrt(3), rel=1e-12)
    for strain in (1e-3, 0.3):
        assert cubic.hardening(contacts, strain) == pytest.approx(strain**2 / 3, rel=1e-9)
    assert cubic.hardening(contacts, 1e-12) == 0.0
    # A higher power changes the stiffness by half of its value at 5 x^4 = 0.5.
    quintic = Law("k*(o + o**5/L**4)", k=K, L=WIDTH)
    alone = Contacts.at_rest(np.array([K]), np.zeros(1), quintic)
    assert 0.5 <= alone.length.item() / (0.1**0.25 * WIDTH) <= 2.0
    r = 0.5 * alone.length.item() / WIDTH
    assert quintic.hardening(alone, 0.5) == pytest.approx(r**4, rel=1e-9)
    springs = Contacts.at_rest(np.array([K]), np.zeros(1), Law("k*o", k=K))
    assert (springs.length.item(), springs.law.hardening(springs, 0.5)) == (1.0, 0.0)


def test_the_largest_force_of_a_contact_may_be_at_a_smaller_overlap() -> None:
    """The force k o exp(-o / L) is largest at o = L, where it is k L / e."""
    law = Law("k*max(o, 0)*exp(-o/L)", k=K, L=WIDTH)
    for first, closest, place in ((0.0, 4.7, 1.0), (0.0, 0.5, 0.5), (2.0, 3.0, 2.0)):
        force, bound = law.largest_force(first * WIDTH, closest * WIDTH, K)
        assert force == pytest.approx(K * WIDTH * place * np.exp(-place), rel=1e-12)
        # A motion may also pass smaller overlaps, which are sampled every 6 %.
        assert force <= bound
        assert bound == pytest.approx(
            K * WIDTH * min(closest, 1.0) * np.exp(-min(closest, 1.0)),
            rel=1e-3 if closest > 1 else 1e-12,
        )
    # The force may be largest at a kink between the sampled overlaps.
    peaked = Law("k*(max(o, 0) - 9*max(o - L, 0))", k=K, L=0.12345 * WIDTH)
    assert peaked.largest_force(0.0, WIDTH, K)[0] == pytest.approx(0.12345 * K * WIDTH, rel=1e-14)


def test_the_shape_of_a_law_is_that_for_the_constants_of_its_contacts() -> None:
    """The force may decrease for some constants only; its largest value is then before the end."""
    common: dict[str, Any] = {"grains": 4, "diameter": 0.1, "masses": [1e-6] * 4, "gravity": 0.0}
    # The slope of k o - a o^2 + b o^3 has no sign if a^2 > 3 b k, which is 1500 here.
    for constants, grows in (([K, 2e3, K], True), ([1e3, K, K], False), ([K, K, 1e3], False)):
        by_chain = Chain(**common, law=laws.fput(3e9, 2e15), contact_constants=constants)
        by_law = Chain(**common, law=laws.fput(3e9, 2e15, constants))
        for chain in (by_chain, by_law, by_chain.part(1, 4)):
            assert chain.strongest_when_closest == chain.contact_law.grows == grows
        both = together([by_chain.contacts, by_chain.replace(contact_constants=[K] * 3).contacts])
        assert np.isfinite(both.approach_bound(1e-20)).all() == grows
    # Constants and parameters are those of the same contact.
    paired = laws.fput([3e9, 0.0, 3e9], 2e15, [K, 1.0, K])
    assert Chain(**common, law=paired).contact_law.grows
    assert Chain(**common, law=laws.fput(3e9, 2e15), contact_constants=[K] * 3).compressed
    dip = Law("c*max(o, 0) - k*max(o - L, 0) + 2*k*max(o - 3*L, 0)", c=K, L=WIDTH)
    weak = Chain(**common | {"grains": 2, "masses": [1e-6] * 2}, law=dip, contact_constants=[1.5e4])
    speed = np.sqrt(1.8 * K * WIDTH**2 / 1e-6)
    scene = scene_of(weak, Impulse(velocity=speed), 1e-4, 11).replace(quantities=["peak_force:1"])
    peak = simulate(scene, "native", tolerance=1e-8).gathered["peak_force:1"]
    assert peak == pytest.approx(K * WIDTH, rel=1e-12)


def test_a_bond_that_is_stretched_far_does_not_shorten_the_steps() -> None:
    """A contact of Toda's chain stores the energy of a strike in a long stretch, but is soft."""
    law = laws.toda(1 / WIDTH, K)
    ends = {"top": "wall", "bottom": "wall", "gravity": 0.0}
    chain = Chain(grains=8, diameter=1.0, law=law, masses=np.full(8, 1e-3), **ends)
    rate = np.sqrt(K / 1e-3)
    scene = scene_of(chain, Impulse(velocity=10 * WIDTH * rate, grain=4), 10 / rate, 5)
    run = simulate(scene, "native", tolerance=1e-6)
    assert run.cost.steps < 2000
    energy = chain.excess_energy(run.displacement, run.velocity)
    assert energy == pytest.approx(np.full(5, scene.energy), rel=1e-5)
