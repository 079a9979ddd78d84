"""Scenes made in batches are equal to scenes made one by one, with all derived numbers."""

from typing import Any

import numpy as np
import pytest

from lmpchain import Chain, InputError, Scene
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


POISSON = "chain.material.poissons_ratio"
INVALID: list[tuple[str, str, dict[str, Any]]] = [
    ("column", "chain.masses", {"low": -6e-8, "high": 2e-6}),
    ("column", "chain.diameter", {"low": -3e-5, "high": 1e-3}),
    ("column", "chain.contact_constants", {"low": 30.0, "high": 1e9, "log": True}),
    ("column", "chain.contact_constants", {"low": 1e8, "high": 1e224, "log": True}),
    ("vacuum", "chain.contact_constants", {"low": -3e7, "high": 1e9}),
    ("column", "chain.material.density", {"low": -90.0, "high": 3e3}),
    ("column", "chain.material.youngs_modulus", {"low": -3e9, "high": 1e11}),
    # Some are infinite.
    ("vacuum", "chain.material.youngs_modulus", {"mean": 8e307, "deviation": 4e307, "log": True}),
    ("column", POISSON, {"low": -1.03, "high": 0.0}),
    ("column", POISSON, {"low": 0.5 - 2e-15, "high": float(np.nextafter(0.5, 1.0))}),
]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("chain", "key", "law"), INVALID)
def test_an_invalid_chain_is_derived_alone(chain: str, key: str, law: dict[str, Any]):
    """A chain made alone is checked, and an error names its fault; others are made together."""
    plan = read_sweep(asked(chain, "first", {"seed": 5, "realisations": 20, key: law}))
    alone = scenes(plan, 0, 20, together=False)
    # Scenes are made together if the first one is valid.
    first = next((n for n, scene in enumerate(alone) if isinstance(scene, Scene)), 0)
    alone = alone[first:]
    assert any(isinstance(scene, InputError) for scene in alone)
    together = scenes(plan, first, len(alone), together=True)
    for ours, theirs in zip(together, alone, strict=True):
        if isinstance(theirs, InputError):
            assert str(ours) == str(theirs)
        else:
            assert isinstance(ours, Scene)
            assert {"masses", "contact_constants"} <= ours.chain.given().keys()
            single = numbers(theirs)
            assert all(alike(value, single[name]) for name, value in numbers(ours).items())


@pytest.mark.filterwarnings("ignore")
def test_random_contacts_may_be_soft():
    """Random contacts alone may be compressed by more than a tenth of the diameter."""
    table = asked("column", "displaced", {"m": 1, "of": "constant", "realisations": 10})
    table["scene"]["chain"]["material"] = HARD | {"youngs_modulus": 3e5}
    chains = [scene.chain for scene in scenes(read_sweep(table), 0, 10, together=True)]
    assert max(chain.contacts.overlap.max() for chain in chains) > 0.1 * 1e-3
