"""Scene files: every fault names its key, and a written scene is read as an equal one."""

from pathlib import Path

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of
from helpers.faults import fault_keys, faults

from lmpchain import (
    GLASS,
    PTFE,
    STEEL,
    Chain,
    Displacement,
    Drive,
    Impulse,
    Impurity,
    InputError,
    Material,
    Profile,
    Riemann,
    Scene,
)
from lmpchain.cli.command_line import main

GOOD = """
[chain]
grains = 20
material = "glass"
diameter = 1.0e-3
gravity = 9.81

[excitation]
kind = "impulse"
grain = 1
velocity = 8.57e-4

[recording]
duration = 10e-6
samples = 11
"""

STRIKE = 'kind = "impulse"\ngrain = 1\nvelocity = 8.57e-4'
SIZE = "diameter = 1.0e-3"
GLASS_BEADS = f'material = "glass"\n{SIZE}'
SINE = "amplitude = 1e-9\nfrequency = 1e5"
SOFT = "{density = 1.0, poissons_ratio = 0.0}"
SWELLING = "{density = 2000.0, youngs_modulus = 1e9, poissons_ratio = 0.6}"
ODD_SIZE = "impurity = [{grain = 3, diameter = 1}]"
FAULTS = [  # Text, its replacement, and the key that must be named.
    ("gravity =", "gravitation =", "chain.gravitation"),
    ("grain = 1\n", "grian = 1\n", "excitation.grian"),
    ("samples", "sample", "recording.sample"),
    ("[recording]", "[output]\n[recording]", "output"),
    (SIZE, "", "chain.diameter"),
    (f"[excitation]\n{STRIKE}", "", "excitation"),
    (GOOD[: GOOD.index("[excitation]")], "chain = 3\n", "chain"),
    ('"impulse"', '"hammer"', "excitation.kind"),
    ('kind = "impulse"', "", "excitation.kind"),
    ("gravity = 9.81", "gravity = true", "chain.gravity"),
    ("gravity = 9.81", "gravity = -9.81", "chain.gravity"),
    ('"glass"', "7", "chain.material"),
    ('"glass"', '"jelly"', "chain.material"),
    ('"glass"', SOFT, "chain.material.youngs_modulus"),
    ('"glass"', SWELLING, "chain.material.poissons_ratio"),
    ("grains = 20", "grains = 20.5", "chain.grains"),
    ("grains = 20", "grains = 0", "chain.grains"),
    ("grains = 20", "grains = 1", "chain.grains"),  # This grain would be held.
    (SIZE, "diameter = [1e-3, 2e-3]", "chain.diameter"),
    (SIZE, f"diameter = {[1e-3] * 19 + [-1e-3]}", "chain.diameter"),
    (SIZE, "diameter = 1e4", "chain.diameter"),  # The weight crushes the grains.
    ("velocity = 8.57e-4", "velocity = 1e3", "excitation.velocity"),
    ("velocity = 8.57e-4", "velocity = -inf", "excitation.velocity"),
    ("grain = 1\n", "grain = 21\n", "excitation.grain"),
    ("grain = 1\n", "grain = 0\n", "excitation.grain"),
    ("duration = 10e-6", "duration = [1e-6]", "recording.duration"),
    ("samples = 11", "samples = 1", "recording.samples"),
    ("samples = 11", "grains = [1, 21]", "recording.grains"),
    ("gravity =", "impurity = {grain = 3}\ngravity =", "chain.impurity"),
    (*("gravity =", f"contact_constants = {[1] * 19}\n{ODD_SIZE}\ngravity ="), "chain.impurity.0"),
    (GLASS_BEADS, 'file = "none.csv"', "chain.file"),
    (GLASS_BEADS, "file = 3", "chain.file"),
    (
        GOOD[GOOD.index("grains") : GOOD.index("[recording]")],
        f'grains = 2\ndiameter = 1e-3\n[excitation]\nkind = "drive"\n{SINE}\n',
        "excitation.kind",
    ),
]
CHAIN_FAULTS = {  # A line more of the chain, and its key.
    "exponent = 0.9": "exponent",
    "exponent = 3.1": "exponent",
    "masses = [1e-6]": "masses",
    f"contact_constants = {[-1e9] * 19}": "contact_constants",
    'bottom = "wall"\nwall_constants = [1.0, 2.0]': "wall_constants",
    'bottom = "wall"\nbottom_material = "steel"\nwall_constants = [0.0, 2.0]': "wall_constants",
    "top_load = -1.0": "top_load",
    "top_load = 1e6": "diameter",
    'bottom = "free"': "bottom",
    'bottom = "floating"': "bottom",
    f'top = "wall"\ntop_material = {SOFT}': "top_material.youngs_modulus",
    f'bottom = "wall"\nbottom_material = {SOFT[:-1]}, youngs_modulus = 1.0}}': "diameter",
    "[[chain.impurity]]\ngrain = 0\nmass = 1e-6": "impurity.0.grain",
    '[[chain.impurity]]\ngrain = 3\nmass = "heavy"': "impurity.0.mass",
    f"[[chain.impurity]]\ngrain = 3\nmaterial = {SWELLING}": "impurity.0.material.poissons_ratio",
}
EXCITATION_FAULTS = {  # Another excitation, and its key.
    f"drive\n{SINE}\ntimes = [0.0, 1e-5]\ndisplacement = [0.0, 1e-9]": "amplitude",
    f"drive\n{SINE}\ngrain = 2": "grain",
    f"drive\n{SINE}\ngrain = 0": "grain",
    "drive\namplitude = nan\nfrequency = 1e5": "amplitude",
    "drive\namplitude = 1e-9\nfrequency = 0.0": "frequency",
    "drive\namplitude = 1e-3\nfrequency = 1e6": "kind",
    "drive\ntimes = [0.0, 2e-5, 1e-5]\ndisplacement = [0.0, 1e-9, 0.0]": "times",
    'drive\nfile = "none.csv"': "file",
    "profile": "displacement",
    'profile\nfile = "none.csv"': "file",
    "profile\nvelocity = [1e-3, 0.0]": "velocity",
    f"profile\ndisplacement = {[1e-10] * 20}": "displacement",
    "force\namplitude = 1e-3": "amplitude",
    "packet\ngrain = 10\nfrequency = 1e4\nwidth = 5.0\namplitude = 1e-12": "width",
}
FAULTS += [
    ("[excitation]", f"{x}\n[excitation]", f"chain.{key}") for x, key in CHAIN_FAULTS.items()
]
for words, key in EXCITATION_FAULTS.items():
    kind, _, more = words.partition("\n")
    FAULTS.append((STRIKE, f'kind = "{kind}"\n{more}', f"excitation.{key}"))


def refused(path: Path | str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Return the keys of the faults that the command line reports."""
    code = main(["run", str(path)])
    said = capsys.readouterr()
    assert code == 2, said.err
    assert said.out == ""
    # A warning may name the slip behind a fault, and a note the interpretation of a file.
    lines = [line for line in said.err.splitlines() if not line.startswith(("warning: ", "note: "))]
    assert lines
    assert all(line.startswith("error: ") for line in lines), said.err
    return [line.removeprefix("error: ").split(": ")[0] for line in lines]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "scene.toml"


def test_keys_outside_their_sections_name_the_section(tmp_path: Path):
    path = tmp_path / "scene.toml"
    path.write_text(
        "samples = 3\nduration = 1e-5\nkind = 'impulse'\ngravity = 0\nchian = 1\n" + GOOD
    )
    ends = {
        key: message.partition("below the line ")[2]
        for key, message in faults(Scene.from_toml, path)
    }
    assert ends == {
        "samples": "[recording]",
        "duration": "[recording] or [excitation]",
        "kind": "[excitation]",
        "gravity": "[chain]",
        "chian": "",
    }


@pytest.mark.parametrize(("old", "new", "key"), FAULTS)
def test_a_fault_is_named_by_its_key(
    old: str, new: str, key: str, file: Path, capsys: pytest.CaptureFixture[str]
):
    assert GOOD.count(old) == 1
    file.write_text(GOOD.replace(old, new))
    assert key in fault_keys(Scene.from_toml, file)
    assert key in refused(file, capsys)
    assert list(file.parent.iterdir()) == [file]


def test_faults_of_walls_impurities_and_drives_are_reported_at_once(
    file: Path, capsys: pytest.CaptureFixture[str]
):
    impurities = (
        "[[chain.impurity]]\ngrain = 3\n[[chain.impurity]]\ngrain = 0\nmass = -1.0\ncolour = 1\n"
    )
    table = (
        'top = "wal"\ntop_material = "mud"\nbottom_material = {density = 1.0}\n'
        + impurities
        + "[excitation]"
    )
    drive = 'kind = "drive"\nfrequency = -1.0\ntimes = "all"\nmass = 1.0'
    file.write_text(
        GOOD.replace("[excitation]", table)
        .replace(STRIKE, drive)
        .replace("samples = 11", "samples = 1")
    )
    of_chain = "bottom_material.poissons_ratio bottom_material.youngs_modulus impurity.0.diameter "
    of_chain += "impurity.1.colour impurity.1.grain impurity.1.mass top top_material"
    others = ["excitation.frequency", "excitation.mass", "excitation.times", "recording.samples"]
    keys = [f"chain.{key}" for key in of_chain.split()]
    assert sorted(refused(file, capsys)) == [*keys, *others]


def test_combined_faults_are_reported_at_once(file: Path, capsys: pytest.CaptureFixture[str]):
    """Each value is valid by itself: walls and materials, impurities, a drive and its duration."""
    impurities = "".join(f"[[chain.impurity]]\ngrain = {n}\nmass = 1e-6\n" for n in (21, 4, 4))
    table = 'bottom_material = "steel"\n' + impurities + "[excitation]"
    drive = 'kind = "drive"\ntimes = [0.0, 9e-6]\ndisplacement = [0.0, 1e-9]\ngrain = 0'
    recorded = 'samples = 11\ngrains = "20:21"'
    file.write_text(
        GOOD.replace("[excitation]", table).replace(STRIKE, drive).replace("samples = 11", recorded)
    )
    assert refused(file, capsys) == [
        "chain.impurity.0.grain", "chain.impurity.2.grain", "chain.bottom_material",
        "excitation.grain", "recording.grains",
    ]  # fmt: skip


def test_a_file_that_is_not_a_scene_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    binary = tmp_path / "binary.toml"
    binary.write_bytes(bytes(range(128)))
    huge = tmp_path / "huge.toml"
    with huge.open("wb") as out:
        out.truncate(100 * 1024 * 1024)
    missing = tmp_path / "missing.toml"
    for path, said in (
        (binary, "is not valid TOML"),
        (huge, "cannot be read: is larger than 32 MB"),
        (missing, "there is no such file"),
        (tmp_path, "cannot be read: "),
    ):
        ((key, text),) = faults(Scene.from_toml, path)
        assert (key, text[: len(said)]) == (str(path), said)
        assert refused(path, capsys) == [str(path)]
    for nothing in (".", ""):
        assert main(["run", nothing]) == 2


WATER = Material(density=1000.0, youngs_modulus=2.2e9, poissons_ratio=0.5)
CHAINS = {
    "plain": column(4),
    "every key": Chain(
        grains=4,
        material=STEEL,
        diameter=0.1 + 0.2,
        gravity=1 / 3,
        exponent=1.25,
        top_load=1e-3,
        top="free",
        bottom="fixed",
        masses=[1e-6, 2e-6, 1 / 3e6, 1e-6],
        contact_constants=[1e9, 2e9, 1e10 / 3],
    ),
    "arrays": Chain(grains=4, diameter=np.array([1e-3, 2e-3, 1e-3, 1e-3 / 3])),
    "materials": column(4, material=[GLASS, "steel", WATER, STEEL]),
    "own material": column(4, material=WATER),
    "a name that another material has": column(
        4, material=Material(density=1.0, youngs_modulus=1e9, poissons_ratio=0.0, name="glass")
    ),
    "free": column(4, gravity=0.0, bottom="free"),
    "on a wall": column(4, bottom="wall", bottom_material=WATER),
    "impurities": column(
        4,
        top="free",
        bottom="wall",
        bottom_material="brass",
        impurity=[
            Impurity(grain=4, mass=1e-6 / 3),
            Impurity(grain=np.int64(1), diameter=np.float64(2e-3), material=WATER),
            {"grain": 2, "material": "ptfe"},
        ],
    ),
    "impurities beside own constants": column(
        4, masses=[1e-6] * 4, contact_constants=[1e9] * 3, impurity=[Impurity(grain=2, mass=2e-6)]
    ),
}
BETWEEN = {
    "walls": column(4, top="wall", bottom="wall", top_load=1e-3 / 3, top_material=STEEL),
    "a wall that just touches": column(4, top="wall", bottom="wall", top_material=WATER),
    "wall and nothing": column(4, gravity=0.0, top="wall", bottom="free"),
}
EXCITATIONS = {
    "impulse": Impulse(velocity=np.float64(1 / 3) * 1e-3, grain=2),
    "displacement": Displacement(displacement=-1e-10 / 3, grain=np.int64(3)),
    "profile": Profile(displacement=np.array([1e-10, -1e-10 / 3, 0, 0])),
    "profile of both": Profile(displacement=[1e-10, 0, 0, 0], velocity=(0, 1e-6, 0.1e-6, 0)),
    "step": Riemann(velocity=(1e-6 / 3, 0), strain=(2e-7, 0), grain=2),
}
DRIVES = {
    "sine": Drive(amplitude=-1e-10 / 3, frequency=np.float64(1e5) / 3),
    "piston": Drive(shape="piston", velocity=1e-6 / 3, rise=1e-5),
    "line": Drive(times=[0, 1e-4], displacement=[0.0, 1e-9 / 3]),
    "path": Drive(
        times=np.array([0, 1e-6 / 3, 2e-6, 4e-6]), displacement=(0, 1e-10, -1e-10 / 3, 0)
    ),
}
RECORDED = {"all": "all", "range": "2:3", "list": [4, 1], "array": np.array([1, 3])}


PAIRS = {
    f"{a}, {b}": (chain, excitation)
    for chains, excitations in ((CHAINS, EXCITATIONS | DRIVES), (BETWEEN, EXCITATIONS))
    for a, chain in chains.items()
    for b, excitation in excitations.items()
}


@pytest.mark.parametrize(
    ("chain", "excitation", "grains"),
    [
        pytest.param(*pair, grains, id=f"{name}, {recorded}")
        for number, (name, pair) in enumerate(PAIRS.items())
        for place, (recorded, grains) in enumerate(RECORDED.items())
        if number % len(RECORDED) == place
    ],
)
def test_a_written_scene_file_is_read_as_an_equal_scene(
    chain: Chain, excitation: Impulse, grains: str, file: Path
):
    scene = scene_of(chain, excitation, 1e-5 / 3, np.int64(7), grains=grains)
    scene.to_toml(file)
    again = Scene.from_toml(file)
    assert again == scene
    assert np.array_equal(again.chain.masses, chain.masses)
    assert np.array_equal(again.chain.contact_constants, chain.contact_constants)
    assert np.array_equal(again.chain.wall_constants, chain.wall_constants)
    assert np.array_equal(again.recorded, scene.recorded)
    again.to_toml(file.with_name("again.toml"))
    assert file.with_name("again.toml").read_bytes() == file.read_bytes()


def test_a_chain_is_read_from_a_csv_file(file: Path):
    table = file.with_name("grains.csv")
    table.write_text(
        "grain, material, diameter\n1,glass,1e-3\n2,steel,2e-3\n3,ptfe,1.5e-3\n4,glass,1e-3\n"
    )
    with_file = GOOD.replace(f"grains = 20\n{GLASS_BEADS}", 'file = "grains.csv"')
    odd = "[[chain.impurity]]\ngrain = 2\nmass = 1e-5\n[excitation]"
    file.write_text(
        with_file.replace("[excitation]", odd).replace("gravity", 'bottom = "wall"\ngravity')
    )
    scene = Scene.from_toml(file)
    expected = Chain(
        grains=4,
        material=[GLASS, STEEL, PTFE, GLASS],
        diameter=[1e-3, 2e-3, 1.5e-3, 1e-3],
        bottom="wall",
        impurity=[Impurity(grain=2, mass=1e-5)],
        gravity=9.81,
    )
    assert scene.chain == expected
    assert np.array_equal(scene.chain.masses, expected.masses)
    scene.to_toml(file, overwrite=True)  # Now without the CSV file.
    table.unlink()
    assert Scene.from_toml(file) == scene


CHAIN_FILES = [  # Contents of the file, additional keys of the table, and the key.
    ("diameter\n0\n1e-3\n", "", "chain.diameter"),
    ("diameter,mass\n1e-3,1e-6\n1e-3,-1e-6\n", "", "chain.masses"),
    ("diameter,material\n1e-3,glass\n1e-3,mud\n", "", "chain.material"),
    ("diameter\n1e-3\n", "", "chain.grains"),
    ("diameter,material\n1e-3,glass\n1e-3,glass\n", 'material = "glass"\n', "chain.material"),
    ("diameter\n1e-3\n1e-3\n", "grains = 3\n", "chain.diameter"),
]


@pytest.mark.parametrize(("text", "more", "key"), CHAIN_FILES)
def test_a_faulty_chain_file_is_rejected(
    text: str, more: str, key: str, file: Path, capsys: pytest.CaptureFixture[str]
):
    file.with_name("grains.csv").write_text(text)
    file.write_text(GOOD.replace(f"grains = 20\n{GLASS_BEADS}", f'file = "grains.csv"\n{more}'))
    assert key in refused(file, capsys)


def test_a_faulty_chain_does_not_hide_other_faults(tmp_path: Path):
    """Unknown key, free bottom under gravity, missing struck grain and missing recorded grain."""
    path = tmp_path / "scene.toml"
    path.write_text(
        '[chain]\ngrains = 12\ndiameter = 1e-3\ncolour = "red"\nbottom = "free"\n'
        '[excitation]\nkind = "impulse"\nvelocity = 1e-3\ngrain = 13\n'
        '[recording]\nduration = 1e-4\ngrains = "5:20"\n'
    )
    keys = fault_keys(Scene.from_toml, path)
    assert keys == ["chain.colour", "chain.bottom", "excitation.grain", "recording.grains"]
    # A packet fits into a chain of this length; its cut-off frequency is not known.
    packet = {"kind": "packet", "frequency": 1e9, "width": 2.0, "grain": 50, "amplitude": 1e-12}
    chain = {"grains": 100, "diameter": -1e-3, "top_load": 1.0}
    for width, found in ((2.0, []), (20.0, ["excitation.width"])):
        tables = {"chain": chain, "excitation": packet | {"width": width}}
        tables["recording"] = {"duration": 1e-4}
        assert fault_keys(Scene.from_dict, tables) == ["chain.diameter", *found]


@pytest.mark.parametrize(
    "given", [{"kind": "impulse", "velocity": 1e-5}, {}, None, 3, "impulse", [1e-5], Impulse]
)
def test_invalid_excitations_are_named(given: object):
    with pytest.raises(InputError, match="must be of the type Excitation") as caught:
        Scene(
            chain=column(12),
            excitation=given,  # type: ignore[arg-type]
            duration=1e-5,
        )
    assert [key for key, _ in caught.value.faults] == ["excitation"]


@pytest.mark.parametrize("value", [10**5000, [10**400], "1:" + "9" * 5000, [1.0] * 10**6], ids=type)
@pytest.mark.parametrize("key", ["duration", "samples", "grains"])
def test_values_of_any_length_are_rejected_in_one_line(key: str, value: object):
    fields = {"chain": column(12), "excitation": Impulse(velocity=1e-5), "duration": 1e-5}
    (fault,) = faults(Scene, **fields | {key: value})
    assert fault[0] == key
    assert len(fault[1]) < 250


def test_the_text_of_a_scene_refers_to_no_file(tmp_path: Path):
    (tmp_path / "grains.csv").write_text("diameter\n1e-3\n1e-3\n")
    text = GOOD.replace(f"grains = 20\n{GLASS_BEADS}", f'file = "{tmp_path / "grains.csv"}"')
    with pytest.raises(InputError, match=r"chain\.file: a scene without a folder"):
        Scene.from_text(text)
