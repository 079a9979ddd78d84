"""Scene files: every fault is found under its key, and what is written is read back equal."""

from pathlib import Path

import numpy as np
import pytest

from lmpchain import GLASS, STEEL, Chain, Displacement, Impulse, InputError, Material, Profile, Scene, Trajectory
from lmpchain.cli import main

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

FAULTS = {  # what is replaced, what by, and the key that must be named
    "unknown key": ("gravity =", "gravitation =", "chain.gravitation"),
    "unknown key in the excitation": ("grain = 1\n", "grian = 1\n", "excitation.grian"),
    "unknown key in the recording": ("samples", "sample", "recording.sample"),
    "unknown section": ("[recording]", "[output]\n[recording]", "output"),
    "missing key": ("diameter = 1.0e-3", "", "chain.diameter"),
    "missing section": ('[excitation]\nkind = "impulse"\ngrain = 1\nvelocity = 8.57e-4', "", "excitation"),
    "section that is no table": (GOOD[: GOOD.index("[excitation]")], "chain = 3\n", "chain"),
    "kind that is not known": ('"impulse"', '"hammer"', "excitation.kind"),
    "kind that is missing": ('kind = "impulse"', "", "excitation.kind"),
    "word for a number": ("diameter = 1.0e-3", 'diameter = "1 mm"', "chain.diameter"),
    "true for a number": ("gravity = 9.81", "gravity = true", "chain.gravity"),
    "number for a word": ('"glass"', "7", "chain.material"),
    "part of a grain": ("grains = 20", "grains = 20.5", "chain.grains"),
    "word for a velocity": ("velocity = 8.57e-4", 'velocity = "fast"', "excitation.velocity"),
    "list for a duration": ("duration = 10e-6", "duration = [1e-6]", "recording.duration"),
    "negative diameter": ("diameter = 1.0e-3", "diameter = -1.0e-3", "chain.diameter"),
    "no diameter": ("diameter = 1.0e-3", "diameter = 0.0", "chain.diameter"),
    "one bad diameter of many": ("diameter = 1.0e-3", f"diameter = {[1e-3] * 19 + [-1e-3]}", "chain.diameter"),
    "too few diameters": ("diameter = 1.0e-3", "diameter = [1e-3, 2e-3]", "chain.diameter"),
    "too few masses": ("gravity", "masses = [1e-6]\ngravity", "chain.masses"),
    "negative constant": ("gravity", f"contact_constants = {[-1e9] * 19}\ngravity", "chain.contact_constants"),
    "NaN": ("diameter = 1.0e-3", "diameter = nan", "chain.diameter"),
    "infinity": ("gravity = 9.81", "gravity = inf", "chain.gravity"),
    "infinite velocity": ("velocity = 8.57e-4", "velocity = -inf", "excitation.velocity"),
    "NaN in time": ("duration = 10e-6", "duration = nan", "recording.duration"),
    "no grains": ("grains = 20", "grains = 0", "chain.grains"),
    "one grain": ("grains = 20", "grains = 1", "chain.grains"),
    "negative number of grains": ("grains = 20", "grains = -5", "chain.grains"),
    "strike on a grain that is not there": ("grain = 1\n", "grain = 21\n", "excitation.grain"),
    "strike on grain 0": ("grain = 1\n", "grain = 0\n", "excitation.grain"),
    "strike on the held grain": ("grain = 1\n", "grain = 20\n", "excitation.grain"),
    "one sample": ("samples = 11", "samples = 1", "recording.samples"),
    "no duration": ("duration = 10e-6", "duration = 0.0", "recording.duration"),
    "negative duration": ("duration = 10e-6", "duration = -1e-6", "recording.duration"),
    "recorded grain that is not there": ("samples = 11", "grains = [1, 21]", "recording.grains"),
    "recorded range backwards": ("samples = 11", 'grains = "9:3"', "recording.grains"),
    "recorded range that is none": ("samples = 11", 'grains = "some"', "recording.grains"),
    "grain recorded twice": ("samples = 11", "grains = [3, 3]", "recording.grains"),
    "exponent below 1": ("gravity =", "exponent = 0.9\ngravity =", "chain.exponent"),
    "exponent above 3": ("gravity =", "exponent = 3.1\ngravity =", "chain.exponent"),
    "gravity below 0": ("gravity = 9.81", "gravity = -9.81", "chain.gravity"),
    "pulling load": ("gravity =", "top_load = -1.0\ngravity =", "chain.top_load"),
    "free bottom under gravity": ("gravity =", 'bottom = "free"\ngravity =', "chain.bottom"),
    "end that is not known": ("gravity =", 'bottom = "floating"\ngravity =', "chain.bottom"),
    "crushed by its weight": ("diameter = 1.0e-3", "diameter = 1e4", "chain.diameter"),
    "crushed by its load": ("gravity =", "top_load = 1e6\ngravity =", "chain.diameter"),
    "crushed by the strike": ("velocity = 8.57e-4", "velocity = 1e3", "excitation.velocity"),
    "material that is not known": ('"glass"', '"jelly"', "chain.material"),
    "material without a modulus": (
        '"glass"', "{density = 2000.0, poissons_ratio = 0.2}", "chain.material.youngs_modulus"
    ),
    "material that swells": (
        '"glass"', "{density = 2000.0, youngs_modulus = 1e9, poissons_ratio = 0.6}", "chain.material.poissons_ratio"
    ),
    "profile that is too short": (
        'kind = "impulse"\ngrain = 1\nvelocity = 8.57e-4', 'kind = "profile"\nvelocity = [1e-3, 0.0]',
        "excitation.velocity",
    ),
    "profile that moves the held grain": (
        'kind = "impulse"\ngrain = 1\nvelocity = 8.57e-4', f'kind = "profile"\ndisplacement = {[1e-10] * 20}',
        "excitation.displacement",
    ),
    "profile with nothing in it": (
        'kind = "impulse"\ngrain = 1\nvelocity = 8.57e-4', 'kind = "profile"', "excitation.displacement"
    ),
    "profile file that is missing": (
        'kind = "impulse"\ngrain = 1\nvelocity = 8.57e-4', 'kind = "profile"\nfile = "none.csv"', "excitation.file"
    ),
}  # fmt: skip


def refused(path: Path | str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Return the keys that the command line complains of."""
    code = main(["run", str(path)])
    said = capsys.readouterr()
    assert code == 2, said.err
    assert said.out == ""
    lines = said.err.splitlines()
    assert lines
    assert all(line.startswith("error: ") for line in lines), said.err
    return [line.removeprefix("error: ").split(": ")[0] for line in lines]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "scene.toml"


@pytest.mark.parametrize(("old", "new", "key"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_named_by_its_key(old: str, new: str, key: str, file: Path, capsys: pytest.CaptureFixture[str]):
    assert GOOD.count(old) == 1
    file.write_text(GOOD.replace(old, new))
    with pytest.raises(InputError) as caught:
        Scene.from_toml(file)
    assert key in [found for found, _ in caught.value.faults]
    assert key in refused(file, capsys)
    assert list(file.parent.iterdir()) == [file]


def test_all_faults_come_at_once(file: Path, capsys: pytest.CaptureFixture[str]):
    text = GOOD
    chosen = ("unknown key", "NaN", "one grain", "word for a velocity", "no duration", "one sample")
    for name in chosen:
        old, new, _ = FAULTS[name]
        text = text.replace(old, new)
    file.write_text(text)
    assert sorted(refused(file, capsys)) == sorted(FAULTS[name][2] for name in chosen)


def test_faults_between_sections_come_at_once(file: Path, capsys: pytest.CaptureFixture[str]):
    file.write_text(GOOD.replace("grain = 1\n", "grain = 21\n").replace("samples = 11", 'grains = "1:21"'))
    assert refused(file, capsys) == ["excitation.grain", "recording.grains"]


def test_a_file_that_is_not_a_scene_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("[chain\ngrains = ")
    latin = tmp_path / "latin.toml"
    latin.write_bytes(GOOD.replace("glass", "glas\u00e9").encode("latin-1"))
    nested = tmp_path / "nested.toml"
    nested.write_text("a = " + "[" * 20_000)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(bytes(range(128)))
    huge = tmp_path / "huge.toml"
    with huge.open("wb") as out:
        out.truncate(100 * 1024 * 1024)
    missing = tmp_path / "missing.toml"
    for path in (wrong, latin, nested, binary, huge, missing, tmp_path):
        with pytest.raises(InputError) as caught:
            Scene.from_toml(path)
        assert [key for key, _ in caught.value.faults] == [str(path)]
        assert refused(path, capsys) == [str(path)]
    for nothing in (".", ""):
        assert main(["run", nothing]) == 2


def test_a_number_without_a_digit_after_the_point_gets_a_hint(file: Path, capsys: pytest.CaptureFixture[str]):
    file.write_text(GOOD.replace("9.81", "9."))
    assert main(["run", str(file)]) == 2
    assert "digit after the point" in capsys.readouterr().err


def test_an_engine_that_does_not_know_the_exponent(file: Path, capsys: pytest.CaptureFixture[str]):
    file.write_text(GOOD.replace("gravity =", "exponent = 2.0\ngravity ="))
    assert main(["run", str(file), "--engine", "lammps"]) == 2
    assert capsys.readouterr().err.startswith("error: exponent: ")
    assert main(["run", str(file), "--engine", "native"]) == 0


def test_a_file_that_is_not_a_trajectory(tmp_path: Path):
    import xarray

    foreign = tmp_path / "foreign.nc"
    xarray.Dataset({"displacement": ("x", [1.0])}).to_netcdf(foreign, engine="h5netcdf")
    text = tmp_path / "text.nc"
    text.write_text(GOOD)
    empty = tmp_path / "empty.nc"
    empty.touch()
    for path in (foreign, text, empty, tmp_path, tmp_path / "missing.nc"):
        with pytest.raises(InputError, match=path.name):
            Trajectory.load(path)


WATER = Material(density=1000.0, youngs_modulus=2.2e9, poissons_ratio=0.5)
CHAINS = {
    "plain": Chain(grains=4, diameter=1e-3),
    "every key": Chain(
        grains=4, material=STEEL, diameter=0.1 + 0.2, gravity=1 / 3, exponent=1.25, top_load=1e-3, top="free",
        bottom="fixed", masses=[1e-6, 2e-6, 1 / 3e6, 1e-6], contact_constants=[1e9, 2e9, 1e10 / 3],
    ),
    "arrays": Chain(grains=4, diameter=np.array([1e-3, 2e-3, 1e-3, 1e-3 / 3])),
    "materials": Chain(grains=4, material=[GLASS, "steel", WATER, STEEL], diameter=1e-3),
    "own material": Chain(grains=4, material=WATER, diameter=1e-3),
    "a name that another material has": Chain(
        grains=4, material=Material(density=1.0, youngs_modulus=1e9, poissons_ratio=0.0, name="glass"), diameter=1e-3
    ),
    "free": Chain(grains=4, diameter=1e-3, gravity=0.0, bottom="free"),
}  # fmt: skip
EXCITATIONS = {
    "impulse": Impulse(velocity=np.float64(1 / 3) * 1e-3, grain=2),
    "displacement": Displacement(displacement=-1e-10 / 3, grain=np.int64(3)),
    "profile": Profile(displacement=np.array([1e-10, -1e-10 / 3, 0, 0])),
    "profile of both": Profile(displacement=[1e-10, 0, 0, 0], velocity=(0, 1e-6, 0.1e-6, 0)),
}
RECORDED = {"all": "all", "range": "2:3", "list": [4, 1], "array": np.array([1, 3])}


@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
@pytest.mark.parametrize("excitation", EXCITATIONS.values(), ids=EXCITATIONS)
@pytest.mark.parametrize("grains", RECORDED.values(), ids=RECORDED)
def test_what_is_written_is_read_back_equal(chain: Chain, excitation: Impulse, grains: str, file: Path):
    scene = Scene(chain=chain, excitation=excitation, duration=1e-5 / 3, samples=np.int64(7), grains=grains)
    scene.to_toml(file)
    again = Scene.from_toml(file)
    assert again == scene
    assert np.array_equal(again.chain.masses, chain.masses)
    assert np.array_equal(again.chain.contact_constants, chain.contact_constants)
    assert np.array_equal(again.recorded, scene.recorded)
    again.to_toml(file.with_name("again.toml"))
    assert file.with_name("again.toml").read_bytes() == file.read_bytes()


def test_a_changed_number_makes_another_scene(file: Path):
    file.write_text(GOOD)
    scene = Scene.from_toml(file)
    changes = [
        ("9.81", "9.80"), ("8.57e-4", "8.58e-4"), ("10e-6", "11e-6"), ("= 11", "= 12"), ('"glass"', '"steel"'),
        ("samples = 11", "samples = 11\ngrains = [1]"),
    ]  # fmt: skip
    for old, new in changes:
        file.write_text(GOOD.replace(old, new))
        assert Scene.from_toml(file) != scene


def test_a_profile_is_read_from_a_csv_file(file: Path):
    u, v = np.arange(20) * 1e-11, np.cos(np.arange(20.0)) * 1e-6
    u[-1] = v[-1] = 0
    rows = [f"{n},{float(a)!r},{float(b)!r}" for n, a, b in zip(range(1, 21), u, v, strict=True)]
    (file.parent / "profile.csv").write_text("\n".join(["grain,displacement,velocity", *rows]) + "\n")
    old = 'kind = "impulse"\ngrain = 1\nvelocity = 8.57e-4'
    file.write_text(GOOD.replace(old, 'kind = "profile"\nfile = "profile.csv"'))
    scene = Scene.from_toml(file)
    assert scene.excitation == Profile(displacement=u, velocity=v)
    scene.to_toml(file)  # now without the CSV file
    assert Scene.from_toml(file) == scene
    (file.parent / "profile.csv").unlink()
    assert Scene.from_toml(file) == scene


CSV = {
    "empty": "",
    "header only": "displacement\n",
    "no header": "1e-10\n0\n",
    "wrong header": "u,v\n1e-10,0\n",
    "numbers in the wrong order": "grain,velocity\n2,0\n1,0\n",
    "ragged": "displacement,velocity\n1e-10\n0,0\n",
    "words": "velocity\n" + "fast\n" * 20,
    "NaN": "velocity\n" + "nan\n" * 20,
    "too few rows": "velocity\n0\n0\n",
}


@pytest.mark.parametrize("text", CSV.values(), ids=CSV)
def test_a_faulty_csv_file_is_refused(text: str, file: Path, capsys: pytest.CaptureFixture[str]):
    (file.parent / "profile.csv").write_text(text)
    old = 'kind = "impulse"\ngrain = 1\nvelocity = 8.57e-4'
    file.write_text(GOOD.replace(old, 'kind = "profile"\nfile = "profile.csv"'))
    assert refused(file, capsys)[0].startswith("excitation.")


def test_python_finds_the_same_faults_as_a_file():
    with pytest.raises(InputError) as caught:
        Chain(grains=1, diameter=-1.0, gravity=np.nan, colour="red")
    assert {key for key, _ in caught.value.faults} == {"grains", "diameter", "gravity", "colour"}
    chain = Chain(grains=3, diameter=1e-3)
    with pytest.raises(InputError) as caught:
        Scene(chain=chain, excitation=Impulse(velocity=1e-3, grain=3), duration=1e-6, grains=[4])
    assert {key for key, _ in caught.value.faults} == {"grain", "grains"}


def test_a_scene_cannot_be_changed_once_it_is_checked():
    scene = Scene(chain=Chain(grains=3, diameter=[1e-3] * 3), excitation=Impulse(velocity=1e-3), duration=1e-6)
    with pytest.raises(Exception, match="frozen"):
        scene.duration = -1.0
    with pytest.raises(ValueError, match="read-only"):
        scene.chain.diameter[0] = -1.0


def test_samples_and_their_times_and_grains():
    chain = Chain(grains=5, diameter=1e-3)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-6), duration=1e-5, samples=11, grains="2:4")
    assert scene.time[0] == 0
    assert scene.time[-1] == 1e-5
    assert scene.time.size == 11
    assert scene.recorded.tolist() == [2, 3, 4]


def test_strike_number():
    chain = Chain(grains=20, diameter=1e-3)
    omega = np.sqrt(chain.linear_stiffness / chain.masses[:-1])
    for grain in (1, 7, 19):
        v0 = 0.1 * chain.equilibrium_overlap[grain - 1] * omega[grain - 1]
        scene = Scene(chain=chain, excitation=Impulse(velocity=v0, grain=grain), duration=1e-5)
        assert scene.strike_number == pytest.approx(0.1, rel=1e-14)
    moved = Displacement(displacement=-chain.length_scale / 2)
    assert Scene(chain=chain, excitation=moved, duration=1e-5).strike_number == pytest.approx(0.5, rel=1e-14)
    # the paper's unit of velocity, sqrt(delta g) (g / gamma)^(1 / (2 delta)), is 0.101096 mm/s here
    scene = Scene(chain=chain, excitation=Impulse(velocity=1.01096e-4), duration=1e-5)
    assert scene.strike_number == pytest.approx(1, rel=1e-5)
    vacuum = Chain(grains=20, diameter=1e-3, gravity=0.0)
    assert Scene(chain=vacuum, excitation=Impulse(velocity=1e-9), duration=1e-5).strike_number == np.inf


def test_a_faulty_chain_does_not_hide_what_is_wrong_elsewhere(tmp_path: Path):
    """An unknown key, a free bottom under gravity, a strike on no grain and a record of no grain: four lines."""
    path = tmp_path / "scene.toml"
    path.write_text(
        '[chain]\ngrains = 12\ndiameter = 1e-3\ncolour = "red"\nbottom = "free"\n'
        '[excitation]\nkind = "impulse"\nvelocity = 1e-3\ngrain = 13\n'
        '[recording]\nduration = 1e-4\ngrains = "5:20"\n'
    )
    with pytest.raises(InputError) as caught:
        Scene.from_toml(path)
    keys = [key for key, _ in caught.value.faults]
    assert keys == ["chain.colour", "chain.bottom", "excitation.grain", "recording.grains"]
