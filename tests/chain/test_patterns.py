"""Patterned chains: single grains, and derived values by formulas written out here."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.faults import fault_keys, faults

import lmpchain
from lmpchain import GLASS, STEEL, Chain, Impulse, InputError, Scene
from lmpchain.chain.patterns import decorated, periodic, repeated, tapered, write_out


def test_every_name_is_public():
    assert lmpchain.patterns.tapered is tapered
    assert "patterns" in dir(lmpchain)


@pytest.mark.parametrize("taper", [0.1, 0.0, -0.1, np.float32(0.25)])
def test_tapered(taper: float):
    chain = tapered(grains=20, diameter=3e-3, taper=taper)
    assert chain.diameters == pytest.approx(
        [3e-3 * (1 - float(taper)) ** (n - 1) for n in range(1, 21)], rel=1e-14, abs=0
    )
    assert chain.diameters[0] == 3e-3
    assert chain.material == GLASS


@pytest.mark.parametrize("grains", [2, 7, 8])
def test_decorated(grains: int):
    chain = decorated(grains, 3e-3, ratio=0.25, taper=0.1)
    expected: list[float] = []
    for k in range((grains + 1) // 2):
        large = 3e-3 * 0.9**k
        expected += [large, 0.25 * large]
    assert chain.grains == grains
    assert chain.diameters == pytest.approx(expected[:grains], rel=1e-14, abs=0)
    plain = decorated(grains, 3e-3, 0.25)
    assert plain.diameters.tolist() == ([3e-3, 0.75e-3] * 4)[:grains]


def test_cells_of_several_kinds():
    chain = periodic(10, [1e-3, 2e-3, 3e-3], ["glass", "steel", "ptfe"], [2, 1, 3])
    assert (chain.diameters * 1e3).round(9).tolist() == [1, 1, 2, 3, 3, 3, 1, 1, 2, 3]
    names = [material.name for material in chain.material]
    assert names == [*["glass"] * 2, "steel", *["ptfe"] * 3, *["glass"] * 2, "steel", "ptfe"]


def test_one_value_applies_to_all_kinds():
    assert periodic(6, 1e-3, ["steel", "ptfe"]).diameters.tolist() == [1e-3] * 6
    assert periodic(6, [1e-3, 2e-3], "steel").material == STEEL
    assert periodic(4, [1e-3, 2e-3], ["steel"]) == periodic(4, [1e-3, 2e-3], ["steel", "steel"])
    twice = periodic(6, [1e-3, 2e-3], counts=2)
    assert twice.diameters.tolist() == [*[1e-3] * 2, *[2e-3] * 2, *[1e-3] * 2]
    # A single kind, whatever the count.
    assert periodic(5, 1e-3, counts=10**12).diameters.tolist() == [1e-3] * 5
    assert periodic(5, np.array([1e-3, 2e-3]), counts=np.array([1, 2])).diameters[2] == 2e-3


def test_patterned_chains_are_written_and_read(tmp_path: Path):
    for chain in (
        tapered(12, 4e-3, 0.08, material="steel", gravity=0.0, top_load=2.0),
        decorated(9, 5e-3, 0.3, taper=0.05, material="ptfe"),
        periodic(14, [1e-3, 2e-3, 3e-3], ["glass", "steel", "brass"], [2, 1, 3], exponent=1.3),
    ):
        scene = Scene(chain=chain, excitation=Impulse(velocity=1e-5), duration=1e-5, samples=3)
        scene.to_toml(tmp_path / "scene.toml")
        assert Scene.from_toml(tmp_path / "scene.toml") == scene


def test_patterns_accept_all_arguments_of_a_chain():
    material = ["steel", "ptfe", "steel", "ptfe", "steel"]
    rest = {"gravity": 0.0, "top_load": 0.5, "bottom": "wall", "material": material}
    chain = tapered(5, 1e-3, 0.1, **rest)
    assert chain == Chain(grains=5, diameter=1e-3 * 0.9 ** np.arange(5.0), **rest)
    assert periodic(4, 1e-3, impurity=[{"grain": 2, "diameter": 2e-3}]).diameters[1] == 2e-3


@pytest.mark.parametrize(
    ("made", "keys"),
    [
        ((tapered, 1, -1e-3, 1.0), ["grains", "diameter", "taper"]),
        ((tapered, 5, 1e-3, np.nan), ["taper"]),
        ((tapered, 5, "1 mm", 0.1), ["diameter"]),
        ((tapered, 2.5, 1e-3, 0.1), ["grains"]),
        ((tapered, 10**9, 1e-3, 0.1), ["grains"]),
        ((tapered, 1000, 1e-3, -0.9), ["taper"]),
        ((decorated, 5, 1e-3, 1.5, 2.0), ["taper", "ratio"]),
        ((decorated, 5, 1e-3, 0.0), ["ratio"]),
        ((periodic, 5, [1e-3, 0.0]), ["diameters"]),
        ((periodic, 5, []), ["diameters"]),
        ((periodic, 5, 1e-3, ["steel", "cheese"]), ["materials"]),
        (
            (periodic, 5, [1e-3, 2e-3, 3e-3], ["steel", "ptfe"], [1, 2, 3, 4]),
            ["diameters", "materials"],
        ),
        *[
            ((periodic, 5, 1e-3, "steel", counts), ["counts"])
            for counts in (0, [1, -1], [], 1.5, [True], "12", [1, [2]], None)
        ],
    ],
)
def test_faults_are_named(made: tuple, keys: list[str]):
    assert fault_keys(*made) == keys


def test_faults_of_the_chain_inside_a_pattern():
    assert fault_keys(tapered, 5, 1e-3, 0.1, gravity=-1.0, colour="red") == ["colour", "gravity"]
    assert fault_keys(periodic, 5, 1e-3, material="steel", diameter=1e-3) == [
        "diameter",
        "material",
    ]
    # Crushed at rest.
    assert fault_keys(decorated, 100, 1e-3, 0.01, material="ptfe", gravity=1e7) == ["diameter"]


def test_faults_of_patterns_contain_their_numbers():
    nearer = "use a taper nearer to 0, or fewer grains"
    few = [1e-3, 2e-3, 3e-3], ["steel", "ptfe"]
    for make, key, message in (
        (
            partial(periodic, 5, 1e-3, material="steel"),
            "material",
            "follows from the pattern: leave it out",
        ),
        (partial(tapered, 1000, 1e-3, 0.9), "taper", f"grain 1000 would be 0 m wide: {nearer}"),
        (partial(tapered, 200, 1e-3, -9.0), "taper", f"grain 200 would be 1e+196 m wide: {nearer}"),
        (partial(periodic, 5, *few), "materials", "must be one or 3 (one per kind), not 2"),
        (
            *(partial(periodic, 5, 1e-3, "steel", 0), "counts"),
            "must be a whole number above 0, or a list of them (got 0)",
        ),
    ):
        assert faults(make) == [(key, message)]
    assert tapered(2, 1e-3, 0.999).diameters == pytest.approx([1e-3, 1e-6], rel=1e-9)
    doubled = decorated(4, 1e-3, 1.0, taper=-1.0).diameters
    assert doubled == pytest.approx([1e-3, 1e-3, 2e-3, 2e-3], rel=1e-12)


FILE = """
[chain]
grains = 5
{}

[excitation]
kind = "impulse"
velocity = 1e-3

[recording]
duration = 1e-5
samples = 3
"""


def from_file(folder: Path, lines: str) -> Chain:
    path = folder / "scene.toml"
    path.write_text(FILE.format(lines))
    return Scene.from_toml(path).chain


def test_a_cell_in_a_file(tmp_path):
    """Materials and diameters equal those written out by hand."""
    steel, soft = lmpchain.STEEL, lmpchain.ALUMINIUM
    chain = from_file(tmp_path, 'cell = ["steel", "Aluminum"]\ndiameter = 5e-3')
    assert chain == Chain(grains=5, material=[steel, soft, steel, soft, steel], diameter=5e-3)
    grain = 'cell = ["steel", {material = "Delrin", diameter = 2e-3}]\ndiameter = 5e-3'
    chain = from_file(tmp_path, f"{grain}\ntaper = 0.05")
    pom = lmpchain.POM
    assert list(chain.material) == [steel, pom, steel, pom, steel]
    by_hand = [5e-3, 2e-3 * 0.95, 5e-3 * 0.95**2, 2e-3 * 0.95**3, 5e-3 * 0.95**4]
    assert chain.diameters == pytest.approx(by_hand, rel=1e-15, abs=0)
    # The chain supplies keys that a grain lacks.
    sizes = from_file(tmp_path, 'cell = [{diameter = 1e-3}, {diameter = 2e-3}]\nmaterial = "pom"')
    assert sizes == periodic(5, [1e-3, 2e-3], pom)
    assert repeated(5, [{"diameter": 1e-3}, {"diameter": 2e-3}], material="pom") == sizes
    own = "{density = 1000.0, youngs_modulus = 1e9, poissons_ratio = 0.3}"
    made = from_file(tmp_path, f'cell = [{own}, "pom"]\ndiameter = 1e-3')
    assert made.by_grain("density").tolist() == [1000.0, 1410.0, 1000.0, 1410.0, 1000.0]
    assert Scene.from_toml(tmp_path / "scene.toml").to_dict()["chain"]["material"][1] == "pom"


def test_a_taper_in_a_file(tmp_path):
    chain = from_file(tmp_path, "diameter = 5e-3\ntaper = 0.05\ngravity = 0.0\ntop_load = 1.0")
    assert chain == tapered(5, 5e-3, 0.05, gravity=0.0, top_load=1.0)
    assert (chain.diameters[1:] / chain.diameters[:-1]) == pytest.approx([0.95] * 4, rel=1e-14)


def test_a_cell_of_one_kind_needs_no_arrays():
    plain = write_out({"grains": 10**6, "cell": ["steel"], "diameter": 1e-3})
    assert plain == {"grains": 10**6, "material": STEEL, "diameter": 1e-3}


def test_python_names_the_function_that_replaces_a_cell(tmp_path):
    with pytest.raises(InputError) as caught:
        Chain(grains=4, cell=["steel", "pom"], taper=0.1, diameter=1e-3)
    assert dict(caught.value.faults) == {
        "cell": "is not a key here: use lmpchain.patterns.repeated, or a scene file",
        "taper": "is not a key here: use lmpchain.patterns.tapered or repeated, or a scene file",
    }
    with pytest.raises(InputError, match="did you mean 'cell'"):
        from_file(tmp_path, 'cells = ["steel", "pom"]\ndiameter = 1e-3')


def test_faults_of_cells(tmp_path):
    (tmp_path / "grains.csv").write_text("diameter\n1e-3\n1e-3\n1e-3\n1e-3\n1e-3\n")
    for lines, keys, text in (
        ('cell = ["stel", "glas"]\ndiameter = 1e-3', ["cell.0", "cell.1"], "mean 'steel'"),
        ('cell = ["steel", "pom"]\nmaterial = "glass"\ndiameter = 1e-3', ["material"], "out of"),
        ('cell = ["steel", "pom"]', ["diameter"], "is missing"),
        ('cell = "steel"\ndiameter = 1e-3', ["cell"], 'cell = ["steel", "aluminium"]'),
        ("cell = []\ndiameter = 1e-3", ["cell"], "must be a list of grains"),
        ('cell = [{materal = "pom"}]\ndiameter = 1e-3', ["cell.0.materal"], "mean 'material'"),
        ("taper = 1.0\ndiameter = 1e-3", ["taper"], "must be below 1"),
        ("taper = 0.1\ndiameter = [1e-3, 1e-3]", ["diameter"], "must be a number"),
        ('taper = 0.1\ncell = ["pom"]\nfile = "grains.csv"', ["cell", "taper"], "remove this key"),
    ):
        with pytest.raises(InputError, match=text.replace("[", r"\[")) as caught:
            from_file(tmp_path, lines)
        assert [key for key, _ in caught.value.faults] == [f"chain.{key}" for key in keys]
