"""Scenes made as arrays are those that are made one by one, in all that they hold and derive."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lmpchain import Chain, InputError, Material, Scene
from lmpchain.sweeps import realisations
from lmpchain.sweeps.file import read
from lmpchain.sweeps.realisations import scenes

HARD = {"density": 7800.0, "youngs_modulus": 2e11, "poissons_ratio": 0.3}
LAWS: dict[str, dict[str, Any]] = {
    "chain.masses": {"mean": 1.3e-6, "deviation": 1e-7, "log": True},
    "chain.diameter": {"low": 0.9e-3, "high": 1.1e-3},
    "chain.contact_constants": {"low": 1e8, "high": 1e9, "log": True},
    "chain.material.density": {"mean": 2400.0, "deviation": 50.0},
    "chain.material.youngs_modulus": {"mean": 62e9, "deviation": 5e9, "log": True},
    "chain.material.poissons_ratio": {"low": 0.15, "high": 0.25},
}
MATERIAL = [key for key in LAWS if "material" in key]
ORDER = {"m": 5}
UNTOLD = {"material", "diameter", "impurity"}
CHAINS: dict[str, dict[str, Any]] = {
    "column": {},
    "floor": {"bottom": "wall", "bottom_material": HARD},
    "walls": {"top": "wall", "bottom": "wall", "top_load": 2.0, "top_material": HARD},
    "wall constants": {
        "top": "wall",
        "bottom": "wall",
        "wall_constants": [1e9, 3e9],
        "gravity": 0.0,
        "top_load": 1.0,
    },
    "exponent": {"exponent": 2.0, "bottom": "wall"},
    "vacuum": {"gravity": 0.0, "bottom": "free"},
    "given": {
        "masses": np.linspace(1e-6, 2e-6, 12).tolist(),
        "contact_constants": np.linspace(1e8, 2e8, 11).tolist(),
        "bottom": "wall",
    },
    "diameters": {"diameter": np.linspace(1e-3, 1.3e-3, 12).tolist(), "top": "wall"},
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
    "profile": {
        "kind": "profile",
        "velocity": [1e-5] * 3 + [0.0] * 9,
        "displacement": [1e-11] * 2 + [0.0] * 10,
    },
    "force": {
        "kind": "force",
        "shape": "half-sine",
        "amplitude": 1e-3,
        "duration": 1e-5,
        "grain": 2,
    },
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
    """Return what a scene and its chain hold and derive, by name.

    All but what chains made together do not say: their material, what they took from it, and impurities.
    """
    chain = scene.chain
    contacts = chain.contacts
    fields = {name: getattr(chain, name) for name in Chain.model_fields.keys() - UNTOLD}
    derived = {
        name: getattr(chain, name)
        for name in ("masses", "diameters", "wall_constants", "band_edge")
    }
    names = ("constant", "force", "exponent", "exists", "pressed", "overlap", "stiffness")
    held = {f"contacts.{name}": getattr(contacts, name) for name in names}
    found = {name: getattr(scene, name) for name in ("duration", "samples", "grains", "quantities")}
    found |= {"strike": scene.strike_number, "strain": scene.largest_strain}
    found |= {
        "pair": scene._pair_frequency,
        "energy": scene.energy if not scene.excitation.does_work else 0.0,
    }
    found |= {
        "excitation": scene.excitation,
        "imposed": scene.imposed is None,
        "cone": scene.light_cone,
    }
    return fields | derived | held | found


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
def test_scenes_made_together_are_those_made_alone(chain: str, excitation: str, drawn: Any):
    table = drawn if isinstance(drawn, dict) else {key: LAWS[key] for key in drawn}
    plan = read(asked(chain, excitation, table))
    together = scenes(plan, 0, 5, together=True)
    for number, scene in enumerate(together):
        alone = plan.scene((number,))
        ours, theirs = numbers(scene), numbers(alone)
        assert [name for name in ours if not alike(ours[name], theirs[name])] == []
        assert np.array_equal(scene.time, alone.time)


@pytest.mark.parametrize("chain", ["column", "walls", "impurities"])
@pytest.mark.parametrize("key", ["chain.diameter", "chain.masses"])
def test_a_copy_of_a_chain_made_together_has_its_grains(chain: str, key: str):
    plan = read(asked(chain, "first", {key: LAWS[key]}))
    for number, scene in enumerate(scenes(plan, 0, 5, together=True)):
        alone = plan.scene((number,)).chain
        copy = scene.chain.replace(top_load=0.7)
        assert copy.diameters == pytest.approx(alone.diameters, rel=1e-15)
        assert copy.masses == pytest.approx(alone.masses, rel=1e-15)
        assert copy.wall_constants == pytest.approx(alone.wall_constants, rel=1e-12)


@pytest.mark.parametrize("spoilt", ["stiffness", "masses"])
def test_a_chain_that_is_not_finite_is_made_alone(spoilt: str):
    """One by one, a chain is checked, and says what is wrong with it."""
    contacts = SimpleNamespace(stiffness=np.ones((3, 4)), overlap=np.zeros((3, 4)))
    parts: dict[str, Any] = {
        "contacts": contacts,
        "masses": np.ones((3, 3)),
        "length": np.ones((3, 4)),
        "first": np.zeros((3, 4)),
        "diameter": np.ones((3, 3)),
        "between": np.ones((3, 2)),
    }
    assert realisations._sound(parts, drawn=True).all()
    if spoilt == "stiffness":
        contacts.stiffness[1, 0] = np.inf
    else:
        parts["masses"][1, 0] = -1.0
    assert realisations._sound(parts, drawn=False).tolist() == [True, False, True]


TOGETHER = [
    ("column", "first", ["chain.masses"]),
    ("floor", "inner", MATERIAL),
    ("walls", "last", ORDER),
]


@pytest.mark.parametrize(("chain", "excitation", "drawn"), TOGETHER)
def test_like_scenes_are_made_in_one_go(chain: str, excitation: str, drawn: Any, monkeypatch: Any):
    """One by one they take fifty times as long."""
    table = drawn if isinstance(drawn, dict) else {key: LAWS[key] for key in drawn}
    plan = read(asked(chain, excitation, table))
    monkeypatch.setattr(realisations, "_alone", None)
    for scene in scenes(plan, 1, 4, together=True):
        assert not scene.chain.masses.flags.writeable
        assert not scene.chain.contact_constants.flags.writeable
        assert not scene.chain.wall_constants.flags.writeable
        assert not scene.chain.contacts.force.flags.writeable
        assert not scene.chain.contacts.constant.flags.writeable


def test_a_wave_that_does_not_reach_the_end_is_cut_to_its_cone():
    tables = asked("column", "first", {"m": 5}, recording={"duration": 1e-6})
    tables["scene"]["chain"]["grains"] = 200
    plan = read(tables)
    for number, scene in enumerate(scenes(plan, 0, 5, together=True)):
        alone = plan.scene((number,))
        assert scene == alone
        assert scene.reached.chain.grains == alone.reached.chain.grains < 200


def test_scenes_of_several_axes_come_in_the_order_of_their_numbers():
    grid = {"chain.gravity": [5.0, 9.81], "excitation.velocity": [1e-4, 2e-4]}
    plan = read(asked("column", "first", {"m": 5}, grid=grid))
    every = scenes(plan, 0, 20, together=True)
    for first, count in ((0, 20), (3, 9), (19, 1), (4, 2)):
        some = scenes(plan, first, count, together=True)
        assert some == every[first : first + count]
        assert [each.strike_number for each in some] == [
            each.strike_number for each in scenes(plan, first, count, together=False)
        ]
    gravities = [scene.chain.gravity for scene in every]
    assert gravities == [5.0] * 10 + [9.81] * 10
    assert [scene.excitation.velocity for scene in every[::5]] == [1e-4, 2e-4] * 2


@pytest.mark.parametrize(
    ("law", "key", "reason"),
    [
        ({"mean": 1e-6, "deviation": 6e-7}, "chain.masses", "masses: must be above 0"),
        ({"mean": 1e-3, "deviation": 7e-4}, "chain.diameter", "diameter: must be above 0"),
        (
            {"mean": 1e8, "deviation": 6e7},
            "chain.contact_constants",
            "contact_constants: must be above 0",
        ),
        ({"low": 1e-1, "high": 1e4, "log": True}, "chain.contact_constants", "contact"),
    ],
)
def test_draws_that_make_no_scene_say_why(law: dict[str, Any], key: str, reason: str):
    """The sound ones among them are made together all the same."""
    plan = read(asked("column", "first", {"realisations": 40, key: law}))
    together = scenes(plan, 0, 40, together=True)
    alone = scenes(plan, 0, 40, together=False)
    lost = [isinstance(scene, InputError) for scene in alone]
    assert [isinstance(scene, InputError) for scene in together] == lost
    assert any(lost)
    for one, other in zip(together, alone, strict=True):
        if isinstance(other, InputError):
            assert str(one) == str(other)
            assert reason in str(one)
        else:
            assert np.array_equal(one.chain.masses, other.chain.masses)
            assert np.array_equal(one.chain.contacts.overlap, other.chain.contacts.overlap)


def test_random_contacts_alone_may_be_as_soft_as_they_come_out():
    plan = read(asked("column", "first", {"m": 0.3, "realisations": 20}))
    assert all(isinstance(scene, Scene) for scene in scenes(plan, 0, 20, together=True))


@pytest.mark.parametrize(
    ("grains", "keep", "recorded"),
    [
        ([5], ["velocity"], (5,)),
        ([5], ["energy"], (4, 5, 6)),
        ([1], ["peak_velocity"], (1, 2)),
        ([12, 7], ["arrival_time"], (6, 7, 8, 11, 12)),
        ([3], ["wall_force"], (2, 3, 4, 11, 12)),
        ([3], ["velocity", "wall_force"], (2, 3, 4, 11, 12)),
        ([2, 5, 8, 11], ["energy"], "all"),
        ("all", ["energy"], "all"),
    ],
)
def test_grains_are_recorded_that_what_is_kept_takes(grains: Any, keep: list[str], recorded: Any):
    """Neighbours, for the motion between samples and for contacts; the last two for the force on the floor."""
    plan = read(asked("column", "first", {"m": 5}, recording={"grains": grains}, keep=keep))
    for together in (True, False):
        for scene in scenes(plan, 0, 2, together=together):
            expected = list(range(1, 13)) if recorded == "all" else list(recorded)
            assert scene.recorded.tolist() == expected


def test_what_is_gathered_all_along_takes_no_grains_more():
    recording = {"grains": [5], "quantities": ["peak_velocity"]}
    plan = read(
        asked(
            "column", "first", {"m": 5}, recording=recording, keep=["peak_velocity", "peak_force:7"]
        )
    )
    for scene in scenes(plan, 0, 2, together=True):
        assert scene.recorded.tolist() == [5]
        assert scene.quantities == ("peak_velocity", "peak_force:7")


def test_materials_of_impurities_stay_what_they_are():
    plan = read(asked("impurities", "first", {key: LAWS[key] for key in MATERIAL}))
    steel = Material(**HARD)
    for scene in scenes(plan, 0, 2, together=True):
        assert scene.chain.masses[3] == 1e-6
        assert scene.chain.masses[7] == pytest.approx(steel.density * np.pi / 6 * 1e-9, rel=1e-13)


def test_scenes_made_one_by_one_describe_themselves_in_full():
    plan = read(asked("impurities", "first", {key: LAWS[key] for key in MATERIAL}))
    assert scenes(plan, 0, 2, together=False) == [plan.scene((0,)), plan.scene((1,))]


def test_grains_drawn_along_an_axis_before_the_last():
    masses = {"draws": 2, "seed": 3, "chain.masses": {"low": 1e-6, "high": 2e-6}}
    plan = read(asked("column", "first", {"m": 5}, random=masses))
    assert plan.shape == (2, 5)
    for number, scene in enumerate(scenes(plan, 0, 10, together=True)):
        assert scene == plan.scene(plan.place(number))


def test_what_is_wrong_with_a_disorder_bears_its_key():
    plan = read(asked("given", "first", {"m": 4, "of": "diameter"}))
    with pytest.raises(InputError) as caught:
        plan.scene((0,))
    assert all(key.startswith("disorder") for key, _ in caught.value.faults)
