"""Messages about faulty scene files and tables, word for word, and the content of valid ones."""

from pathlib import Path

import numpy as np
import pytest
from helpers.example_scenes import scene_of, struck
from helpers.faults import faults

from lmpchain import GLASS, Chain, Impurity, Material, Profile, Scene

CHAIN = {"grains": 3, "diameter": 1e-3}
IMPULSE = {"kind": "impulse", "velocity": 1e-6}
RECORDING = {"duration": 1e-5, "samples": 3}
GOOD = {"chain": CHAIN, "excitation": IMPULSE, "recording": RECORDING}


def test_missing_or_wrong_sections() -> None:
    assert faults(Scene.from_dict, {}) == [
        (key, f"is missing; add a [{key}] table") for key in ("chain", "excitation", "recording")
    ]
    kinds = "impulse | displacement | profile | packet | riemann | drive | force"
    sections = "the sections are chain, excitation, recording"
    for tables, fault in (
        ({"recording": 3}, ("recording", "must be a table, [recording]")),
        ({"chains": {}}, ("chains", f"unknown section (did you mean 'chain'?); {sections}")),
        ({"excitation": {"velocity": 1e-6}}, ("excitation.kind", f"is missing; {kinds}")),
        (
            {"excitation": {"knid": "impulse"}},
            ("excitation.kind", f"is missing; {kinds}; 'knid' is unknown (did you mean 'kind'?)"),
        ),
    ):
        assert faults(Scene.from_dict, GOOD | tables) == [fault]
    ((key, text),) = faults(Scene.from_dict, GOOD | {"excitation": IMPULSE | {"kind": "implse"}})
    assert (key, "did you mean 'impulse'?" in text) == ("excitation.kind", True)


HEADER = "{path} must have a header with some of material, diameter, mass"
TABLES = {
    "no such column": ("diametre\n1e-3\n", HEADER),
    "a strange column": ("diameter,colour\n1e-3,2\n", HEADER),
    "a column twice": ("diameter,diameter\n1,2\n", HEADER),
    "grains alone": ("grain\n1\n", HEADER),
    "a short line": (
        # Empty lines are ignored, but counted.
        "diameter,mass\n\n1e-3,1e-6\n1e-3\n",
        "{path}, line 4: must have 2 values, as the header has",
    ),
    "nothing": ("diameter\n", "{path} has a header but no rows below it"),
    "words": ("diameter\n1e-3\nwide\n", "{path}: the column diameter must contain numbers ("),
    "a count that skips": (
        "grain,diameter\n1,1e-3\n3,1e-3\n",
        "{path}: the column grain must count 1, 2, 3 ...",
    ),
    "a count from 0": (
        "grain,diameter\n0,1e-3\n1,1e-3\n",
        "{path}: the column grain must count 1, 2, 3 ...",
    ),
    "no table": ("", "{path} cannot be read as CSV: not a table with a header"),
    "no diameter": ("mass\n1e-6\n2e-6\n", "has no column diameter (m)"),
}


@pytest.mark.parametrize(("table", "said"), TABLES.values(), ids=TABLES)
def test_a_faulty_table_is_named_with_its_line(table: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "grains.csv"
    path.write_text(table)
    ((key, text),) = faults(Scene.from_dict, GOOD | {"chain": {"file": "grains.csv"}}, tmp_path)
    assert key == "chain.file"
    assert text.startswith(said.format(path=path))


def test_missing_or_unnamed_tables(tmp_path: Path) -> None:
    ((key, text),) = faults(Scene.from_dict, GOOD | {"chain": {"file": "none.csv"}}, tmp_path)
    missing = f"{tmp_path / 'none.csv'} cannot be read as CSV: No such file or directory"
    assert (key, text) == ("chain.file", missing)
    without = "a scene without a folder cannot name a file: give the numbers themselves"
    for name, folder, said in (
        (3, tmp_path, "must be the name of a CSV file"),
        ("grains.csv", None, without),
    ):
        told = faults(Scene.from_dict, GOOD | {"chain": {"file": name}}, folder)
        assert told == [("chain.file", said)]
    (tmp_path / "grains.csv").write_text("diameter,mass\n1e-3,1e-6\n2e-3,2e-6\n")
    for twice in ("diameter", "masses"):
        table = {"file": "grains.csv", twice: [1e-3, 1e-3]}
        found = faults(Scene.from_dict, GOOD | {"chain": table}, tmp_path)
        key = "mass" if twice == "masses" else twice
        assert found == [(f"chain.{key}", "is in the file already; remove it from one of them")]


def test_tables_fill_the_fields_of_their_columns(tmp_path: Path) -> None:
    (tmp_path / "grains.csv").write_text(
        "\ufeffgrain , material, diameter,mass\n1,glass,1e-3,1e-6\n\n2, steel ,2e-3,2e-6\n",
        encoding="utf-8",
    )
    (tmp_path / "start.csv").write_text("grain,velocity,displacement\n1,1e-6,1e-12\n2,0,0\n")
    (tmp_path / "path.csv").write_text("time,displacement\n0,0\n1e-5,1e-12\n")
    tables = GOOD | {
        "chain": {"file": "grains.csv"},
        "excitation": {"kind": "profile", "file": "start.csv"},
    }
    scene = Scene.from_dict(tables, tmp_path)
    assert scene.chain.grains == 2
    assert [material.name for material in scene.chain.material] == ["glass", "steel"]
    assert scene.chain.diameters.tolist() == [1e-3, 2e-3]
    assert scene.chain.masses.tolist() == [1e-6, 2e-6]
    assert [x.tolist() for x in scene.initial()] == [[1e-12, 0.0], [1e-6, 0.0]]
    (tmp_path / "sizes.csv").write_text("diameter\n1e-3\n2e-3\n")
    keys = {"file": "sizes.csv", "grains": 2, "material": "ptfe"}
    plain = Scene.from_dict(GOOD | {"chain": keys}, tmp_path).chain
    assert plain == Chain(grains=2, diameter=[1e-3, 2e-3], material="ptfe")
    driven = Scene.from_dict(GOOD | {"excitation": {"kind": "drive", "file": "path.csv"}}, tmp_path)
    assert driven.excitation.times.tolist() == [0.0, 1e-5]
    assert driven.excitation.displacement.tolist() == [0.0, 1e-12]
    (tmp_path / "path.csv").write_text("grain,time,displacement\n1,0,0\n2,1e-5,1e-12\n")
    named = Scene.from_dict(GOOD | {"excitation": {"kind": "drive", "file": "path.csv"}}, tmp_path)
    assert named.excitation == driven.excitation


def test_the_start_of_a_forcing_is_a_profile(tmp_path: Path) -> None:
    (tmp_path / "start.csv").write_text("grain,velocity\n1,0\n2,1e-6\n3,0\n")
    drive = {"kind": "drive", "amplitude": 1e-12, "frequency": 1e5}
    for start in ({"file": "start.csv"}, {"velocity": [0.0, 1e-6, 0.0]}):
        tables = GOOD | {"excitation": drive | {"start": start}}
        scene = Scene.from_dict(tables, tmp_path)
        assert scene.excitation.start == Profile(velocity=[0, 1e-6, 0])
        # The tables of the caller are not changed.
        assert tables["excitation"]["start"] is start
    for wrong, key, said in (
        ({"velocity": [1e-6, 0, 0]}, "velocity", "must be 0 for grain 1, because it is driven"),
        ({"velocity": [0, 0, 1e-6]}, "velocity", "must be 0 for grain 3, which is held"),
        ({"velocity": [0, 0]}, "velocity", "must have one entry a grain, 3 in all, not 2"),
        ({"velocty": [0, 0, 0]}, "velocty", "unknown key (did you mean 'velocity'?)"),
        ({}, "displacement", "give displacement or velocity of every grain, or a file with both"),
        ({"file": 3}, "file", "must be the name of a CSV file"),
    ):
        found = faults(Scene.from_dict, GOOD | {"excitation": drive | {"start": wrong}}, tmp_path)
        assert found[0][0] == f"excitation.start.{key}"
        assert found[0][1].startswith(said)
    grains = {"file": "start.csv", "taper": 0.1}
    ((key, text),) = faults(Scene.from_dict, GOOD | {"chain": grains}, tmp_path)
    assert key == "chain.taper"
    assert text.startswith("the file describes every grain already;")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"a = 1.\n", "(numbers need a digit after the point)"),
        (b"a = '\xff'\n", "is not text in UTF-8; a scene file is a TOML text file"),
        (b"a = " + b"[" * 5000 + b"]" * 5000, "is not valid TOML"),
        (b"a = 1" + b"0" * 5000, "cannot be read: "),
    ],
)
def test_invalid_toml_is_named_by_its_path(text: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(text)
    ((key, message),) = faults(Scene.from_toml, path)
    assert key == str(path)
    assert said in message


def test_tables_of_a_scene_contain_plain_values_and_names_of_materials() -> None:
    own = Material(density=1000.0, youngs_modulus=1e9, poissons_ratio=0.3)
    glassy = GLASS.replace(density=2500.0)
    chain = Chain(
        grains=3,
        diameter=np.array([1e-3, 2e-3, 1e-3]),
        material=["glass", own, glassy],
        bottom="wall",
        impurity=[Impurity(grain=2, mass=1e-5)],
    )
    scene = struck(chain, np.float64(1e-6), 1e-5, grains=[1, 3])
    tables = scene.to_dict()
    plain = {"density": 1000.0, "youngs_modulus": 1e9, "poissons_ratio": 0.3}
    assert tables["chain"]["material"][:2] == ["glass", plain]
    assert tables["chain"]["material"][2]["density"] == 2500.0
    assert tables["chain"]["diameter"] == [1e-3, 2e-3, 1e-3]
    assert tables["chain"]["impurity"] == [{"grain": 2, "mass": 1e-5}]
    assert tables["chain"]["bottom"] == "wall"
    assert tables["excitation"] == {"kind": "impulse", "velocity": 1e-6}
    assert tables["recording"] == {"duration": 1e-5, "grains": [1, 3]}
    start = Profile(velocity=[0.0, 1e-6, 0.0])
    table = {"kind": "profile", "velocity": [0.0, 1e-6, 0.0]}
    assert scene_of(chain, start, 1e-5).to_dict()["excitation"] == table
    assert Scene.from_text(scene.to_text()) == scene
