"""Scenes made in batches are equal to scenes made one by one, with all derived numbers."""

from typing import Any

import numpy as np
import pytest

from lmpchain import Chain, Scene
from lmpchain.chain.equilibrium import derive_chain
from lmpchain.sweeps import tasks
from lmpchain.sweeps.file import read_sweep
from lmpchain.sweeps.tasks import scenes

HARD = {"density": 7800.0, "youngs_modulus": 2e11, "poissons_ratio": 0.3}
LAWS: dict[str, dict[str, Any]] = {
    "chain.masses": {"mean": 1.3e-6, "deviation": 1e-7, "log": True},
    "chain.diameter": {"low": 0.9e-3, "high": 1.1e-3},
    "chain.contact_constants": {"low": 1e8, "high": 1e9, "log": True},
    "chain.material.density": {"mean": 2400.0, "deviation": 50.0},
    "chain.material.youngs_modulus": {"mean": 62e9, "deviation": 5e9, "log": True},
    "chain.material.poissons_ratio": {"low": 0.15, "high": 0.25},
    "chain.damping.viscoelastic": {"low": 1e-9, "high": 1e-7, "log": True},
    "chain.damping.drag": {"low": 10.0, "high": 1e3},
}
MATERIAL = [key for key in LAWS if "material" in key]
ORDER = {"m": 5}
UNTOLD = {"material", "diameter", "impurity"}
WALLS = {"top": "wall", "bottom": "wall"}
CHAINS: dict[str, dict[str, Any]] = {
    "column": {},
    "floor": {"bottom": "wall", "bottom_material": HARD},
    "walls": WALLS | {"top_load": 2.0, "top_material": HARD},
    "wall constants": WALLS | {"wall_constants": [1e9, 3e9], "gravity": 0.0, "top_load": 1.0},
    "exponent": {"exponent": 2.0, "bottom": "wall"},
    "vacuum": {"gravity": 0.0, "bottom": "free"},
    "given": {
        "masses": np.linspace(1e-6, 2e-6, 12).tolist(),
        "contact_constants": np.linspace(1e8, 2e8, 11).tolist(),
        "bottom": "wall",
    },
    "diameters": {"diameter": np.linspace(1e-3, 1.3e-3, 12).tolist(), "top": "wall"},
    "damped": {"damping": {"viscoelastic": 2e-8, "drag": 50.0}, "bottom": "wall"},
    "impurities": {
        "impurity": [
            {"grain": 4, "mass": 1e-6},
            {"grain": 6, "diameter": 1.4e-3},
            {"grain": 8, "material": HARD},
        ]
    },
}
EXCITATIONS: dict[str, dict[str, Any]] = {
    "first": {"kind": "impulse", "velocity": 1e-4},
    "inner": {"kind": "impulse", "velocity": -2e-4, "grain": 5},
    "last": {"kind": "impulse", "velocity": 1e-4, "grain": 11},
    "displaced": {"kind": "displacement", "displacement": 1e-10, "grain": 3},
    "profile": {"kind": "profile", "velocity": [1e-5] * 3 + [0.0] * 9},
    "force": {"kind": "force", "shape": "half-sine", "amplitude": 1e-3, "duration": 1e-5},
    "drive": {"kind": "drive", "amplitude": 1e-10, "frequency": 2e4},
}


def asked(chain: str, excitation: str, disorder: dict[str, Any], **more: Any) -> dict[str, Any]:
    tables = {
        "chain": {"grains": 12, "material": "glass", "diameter": 1e-3} | CHAINS[chain],
        "excitation": EXCITATIONS[excitation],
        "recording": {"duration": 2e-4, "samples": 11} | more.pop("recording", {}),
    }
    return {"scene": tables, "disorder": {"seed": 4, "realisations": 5} | disorder} | more


def numbers(scene: Scene) -> dict[str, Any]:
    """Return all numbers of a scene and its chain, by name.

    Materials, impurities and given diameters are left out, because chains that are made together
    have none.
    """
    chain = scene.chain
    derived = {"masses", "diameters", "wall_constants", "band_edge"}
    found = {name: getattr(chain, name) for name in (Chain.arguments.keys() - UNTOLD) | derived}
    for name in ("constant", "force", "law", "exists", "pressed", "overlap", "stiffness"):
        found[f"contacts.{name}"] = getattr(chain.contacts, name)
    of_scene = ("duration", "samples", "grains", "quantities", "excitation", "light_cone")
    for name in (*of_scene, "strike_number", "largest_strain", "fastest_motion"):
        found[name] = getattr(scene, name)
    found["imposed"] = np.array(scene.imposed)
    return found | {"energy": 0.0 if scene.excitation.does_work else scene.energy}


def alike(one: Any, other: Any) -> bool:
    if isinstance(one, float | np.ndarray) and not isinstance(one, bool):
        return np.shape(one) == np.shape(other) and np.allclose(
            one, other, rtol=1e-13, atol=0, equal_nan=True
        )
    return one == other


CASES = [
    *(("column", "first", [key]) for key in LAWS),
    *(("impurities", "first", [key]) for key in LAWS if key != "chain.contact_constants"),
    *((chain, "first", list(LAWS)[:2]) for chain in CHAINS if chain != "given"),
    ("given", "first", ["chain.masses"]),
    *((chain, "inner", MATERIAL) for chain in CHAINS),
    *((chain, "last", ORDER) for chain in CHAINS if chain != "vacuum"),
    *(
        ("floor", excitation, ["chain.masses", "chain.contact_constants"])
        for excitation in EXCITATIONS
    ),
    *(
        ("walls", excitation, {"m": 3, "chain.masses": LAWS["chain.masses"]})
        for excitation in EXCITATIONS
    ),
    ("column", "first", {"m": 4, "law": "paper", "of": "constant"}),
    ("column", "inner", {"m": 4, "of": "mass"}),
]


@pytest.mark.parametrize(("chain", "excitation", "drawn"), CASES)
def test_scenes_derived_together_equal_single_scenes(chain: str, excitation: str, drawn: Any):
    table = drawn if isinstance(drawn, dict) else {key: LAWS[key] for key in drawn}
    plan = read_sweep(asked(chain, excitation, table))
    together = scenes(plan, 0, 5, together=True)
    for number, scene in enumerate(together):
        alone = plan.scene((number,))
        ours = numbers(scene)
        theirs = numbers(alone)
        assert [name for name in ours if not alike(ours[name], theirs[name])] == []
        assert np.array_equal(scene.time, alone.time)


@pytest.mark.parametrize("chain", ["column", "walls", "impurities"])
@pytest.mark.parametrize("key", ["chain.diameter", "chain.masses"])
def test_a_copy_of_a_chain_derived_together_has_its_grains(chain: str, key: str):
    plan = read_sweep(asked(chain, "first", {key: LAWS[key]}))
    for number, scene in enumerate(scenes(plan, 0, 5, together=True)):
        alone = plan.scene((number,)).chain
        copy = scene.chain.replace(top_load=0.7)
        assert copy.diameters == pytest.approx(alone.diameters, rel=1e-15)
        assert copy.masses == pytest.approx(alone.masses, rel=1e-15)
        assert copy.wall_constants == pytest.approx(alone.wall_constants, rel=1e-12)


@pytest.mark.parametrize("spoilt", ["stiffness", "masses", "compression", "drawn"])
def test_an_invalid_chain_is_derived_alone(spoilt: str):
    """A chain made alone is checked, and an error names its fault."""
    chain = Chain(grains=3, diameter=1e-3)
    masses = np.full((3, 3), 1e-6)
    constants = np.full((3, 2), 1e9)
    drawn = {"masses": masses, "contact_constants": constants}
    checked = {"material.poissons_ratio": np.full((3, 3), 0.2)}
    if spoilt == "stiffness":
        constants[1, 0] = np.inf
    elif spoilt == "masses":
        masses[1, 0] = -1.0
    elif spoilt == "compression":
        constants[1, 0] = 1.0
    else:
        checked["material.poissons_ratio"][1, 2] = 0.6
    with np.errstate(all="ignore"):
        equilibria = derive_chain(chain, drawn)
        sound = tasks._sound(chain, equilibria, checked)
        undrawn = tasks._sound(chain, equilibria, {})
    assert sound.tolist() == [True, False, True]
    # Random contacts alone may be soft.
    expected = [True, spoilt in ("compression", "drawn"), True]
    assert undrawn.tolist() == expected


def test_the_limits_of_drawn_numbers_are_those_of_a_chain():
    chain = Chain(grains=3, diameter=1e-3)
    constants = np.full((2, 2), 1e9)
    poisson = "material.poissons_ratio"
    with np.errstate(all="ignore"):
        equilibria = derive_chain(chain, {"contact_constants": constants})
        for key, value, allowed in (
            (poisson, -1.0, False),
            (poisson, -0.999, True),
            (poisson, 0.5, True),
            (poisson, 0.501, False),
            ("material.density", 0.0, False),
            ("material.density", 1e-3, True),
            ("material.density", np.inf, False),
            ("masses", np.nan, False),
            ("diameter", 3.0, True),
        ):
            values = np.full((2, 3), 0.2)
            values[1, 2] = value
            sound = tasks._sound(chain, equilibria, {key: values})
            assert sound.tolist() == [True, allowed], (key, value)
        # Without gravity and load, a contact without stiffness has an equilibrium.
        constants[1, 1] = 0.0
        loose = chain.replace(gravity=0.0)
        equilibria = derive_chain(loose, {"contact_constants": constants})
        assert tasks._sound(loose, equilibria, {}).tolist() == [True, False]
