"""Contact laws by formula: what is read, what is refused, and what follows from a formula."""

import pickle
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import lmpchain
from lmpchain import Chain, Impulse, InputError, Law, Scene, laws

LAWS = {
    "hertz": (laws.hertz(1e9), lambda o: 1e9 * np.maximum(o, 0) ** 1.5),
    "softening": (laws.power(0.6, 1e4), lambda o: 1e4 * np.maximum(o, 0) ** 0.6),
    "corrected": (
        Law("k*max(o, 0)**1.5*(1 + c*o)", k=1e9, c=1e5),
        lambda o: 1e9 * np.maximum(o, 0) ** 1.5 * (1 + 1e5 * o),
    ),
    "fput": (laws.fput(1e6, 1e11, 1e17), lambda o: 1e6 * o + 1e11 * o**2 + 1e17 * o**3),
    "toda": (laws.toda(1.0, 1e6), lambda o: np.exp(1e6 * o) - 1),
    "bilinear": (
        laws.bilinear(1e6, 0.3),
        lambda o: 1e6 * np.maximum(o, 0) + 3e5 * np.minimum(o, 0),
    ),
    "dmt": (laws.dmt(0.1, 1e9), lambda o: 1e9 * np.maximum(o, 0) ** 1.5 - 0.1),
    "bistable": (
        laws.bistable(1e6, 1e-5, 3e-5),
        lambda o: 1e6 * o * (1 - o / 1e-5) * (1 - o / 3e-5),
    ),
    "functions": (
        Law("a*tanh(b*o) + a*sin(b*o)/(2 + cos(b*o)) + sqrt(1 + (b*o)**2)*b*o", a=1.0, b=1e5),
        lambda o: (
            np.tanh(1e5 * o)
            + np.sin(1e5 * o) / (2 + np.cos(1e5 * o))
            + np.sqrt(1 + (1e5 * o) ** 2) * 1e5 * o
        ),
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_force_stiffness_energy_and_overlap_follow_from_the_formula(name: str) -> None:
    law, force = LAWS[name]
    o = np.array([-2e-6, -3e-7, 2e-7, 1e-6, 2.5e-6])
    assert law.force(o) == pytest.approx(force(o), rel=1e-13, abs=1e-18)
    # Central differences over h, whose error is h^4.
    h = 1e-3 * np.abs(o)
    slope = (8 * (force(o + h) - force(o - h)) - force(o + 2 * h) + force(o - 2 * h)) / (12 * h)
    assert law.stiffness(o) == pytest.approx(slope, rel=1e-8, abs=1e-6)
    energies = [quad(force, 0.0, end, epsabs=0, epsrel=1e-12)[0] for end in o]
    assert law.energy(o) == pytest.approx(energies, rel=1e-9, abs=1e-24)
    rest = law.overlap(0.0)
    load = 0.05 if name == "bistable" else 1.0
    root = brentq(lambda x: force(x) - load, rest, 5e-6 if name == "bistable" else 1e-3, xtol=1e-22)
    assert law.overlap(load) == pytest.approx(root, rel=1e-12)
    assert pickle.loads(pickle.dumps(law)) == law


@pytest.mark.parametrize(
    ("kinks", "power", "law"),
    [
        ((0.0,), 1.5, LAWS["dmt"][0]),
        ((0.0,), 1.0, LAWS["bilinear"][0]),
        ((0.0,), 2.0, Law("k*o + a*max(o, 0)**2", k=1e6, a=1.0)),
        ((2e-6,), 1.0, Law("k*abs(o - d)", k=1.0, d=2e-6)),
        ((), 20.0, LAWS["toda"][0]),
    ],
)
def test_kinks_are_found_with_their_power(kinks: tuple[float, ...], power: float, law: Law) -> None:
    assert law.kinks == pytest.approx(kinks)
    assert law.onset == pytest.approx(power, abs=1e-4)


HOSTILE = [
    "__import__('os').system('true')",
    "o.__class__",
    "(lambda: o)()",
    "[o for o in o]",
    "o if o else 0",
    "max(o)",
    "max(o, 0, 0)",
    "max(*o, 0)",
    "max(o, b=0)",
    "open('x')",
    "o @ o",
    "o // 1",
    "o % 2",
    "o and 1",
    "o < 1",
    "~o",
    "not o",
    "True",
    "None",
    "'o'",
    "b'o'",
    "1j",
    "1e400",
    "1e101",
    "...",
    "o[0]",
    "{o}",
    "f'{o}'",
    "(o := 1)",
    "yield o",
    "await o",
    "o; o",
    "o = 1",
    "",
    "   ",
    "\0",
    "o\n+ o)",
    "(" * 300 + "o" + ")" * 300,
    "-" * 400 + "o",
    "o" * 501,
    "sin(" * 100 + "o" + ")" * 100,
    "o**" * 150 + "o",
    "eval(o)",
    "exec",
    "k*step(o)",
    "k*o**1.5",
    "log(o)",
    "1/o",
    "k*max(o**2 - 1, 0)",
]


@pytest.mark.parametrize("text", HOSTILE)
def test_anything_but_a_formula_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(InputError) as refused:
        Chain(grains=3, diameter=1e-3, law={"force": text})
    assert str(refused.value).startswith("law."), str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"c": 1.0}, "law.force: is missing"),
        ({"force": "k*max(o, 0)*c"}, "law.c: has no value"),
        ({"force": "k*max(o, 0)", "c": 1.0}, "law.c: does not occur"),
        ({"force": "k*max(o, 0)*c", "c": [1.0, 2.0, 3.0]}, "law.c: must be one number, or have 2"),
        ({"force": "k*max(o, 0)*c", "c": "1"}, "law.c: must be numbers, not text"),
        ({"force": "k*max(o - d, 0)", "d": 1e-6}, "law.force: has a kink at o = 1e-06 m"),
        ({"force": "k*max(o, 0)/(1 + abs(o/d))**2", "d": 1e-20}, "law: has no stable equilibrium"),
        ({"force": 3}, "law.force: must be a formula in quotes"),
    ],
)
def test_a_wrong_table_is_named_by_its_key(table: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Chain(grains=3, diameter=1e-3, law=table).equilibrium_overlap  # noqa: B018


def test_a_formula_of_hertz_is_hertz(tmp_path: Any) -> None:
    scene = Scene(
        chain=Chain(grains=9, diameter=1e-3, bottom="wall"),
        excitation=Impulse(velocity=0.01),
        duration=5e-5,
        samples=11,
    )
    formula = scene.replace(chain=scene.chain.replace(law=Law("k*max(o, 0)**1.5")))
    one, other = (lmpchain.simulate(s, "native", tolerance=1e-9) for s in (scene, formula))
    assert np.abs(one.velocity - other.velocity).max() < 1e-11
    assert abs(one.cost.steps - other.cost.steps) < 5
    other.save(tmp_path / "run.nc")
    formula.to_toml(tmp_path / "scene.toml")
    assert lmpchain.Trajectory.load(tmp_path / "run.nc").scene == formula
    assert Scene.from_toml(tmp_path / "scene.toml") == formula


def test_parameters_may_differ_from_contact_to_contact() -> None:
    c = np.linspace(1e4, 5e4, 5)
    chain = Chain(grains=6, diameter=1e-3, law=Law("k*max(o, 0)**1.5*(1 + c*o)", c=c), top="wall")
    o = chain.equilibrium_overlap
    carried = chain.contact_constants * o**1.5 * (1 + c * o)
    assert carried == pytest.approx(np.cumsum(chain.masses)[:-1] * 9.81, rel=1e-12)
    assert chain.part(2, 5).law == Law("k*max(o, 0)**1.5*(1 + c*o)", c=c[1:4])
