"""Data files of LAMMPS as LAMMPS reads them, and gravity and load from forces at rest."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers.own_inputs import silent_lammps, tapered_data
from scipy.optimize import brentq

from lmpchain import Impulse, InputError, Scene
from lmpchain.scene.lammps_column import RunOptions, Understood, infer_scene
from lmpchain.scene.lammps_input import LammpsInput
from lmpchain.scene.lammps_state import (
    Line,
    RunGrains,
    fit_line,
    gravity_of,
    is_data,
    load_between,
    mean_load,
)

HEAD = """a row of grains

3 atoms
2 atom types
2 bonds
1 bond types
-1 1 xlo xhi
-1 1 ylo yhi
-1 1 zlo zhi

"""
MASSES = "Masses\n\n1 2e-3 # light\n2 4e-3\n\n"
VELOCITIES = "Velocities\n\n2 0.1 0.2 0.3{turn}\n7 0 1 2{turn}\n3 -1 0 0{turn}\n\n"
BONDS = "Bonds\n\n1 1 7 3\n2 1 3 2\n\n"
BEADS = ["7 1 0.01 7800 0.0 0.1 0.2", "3 2 0.02 2500 0.02 0.1 0.2", "2 1 0.03 900 0.04 0.1 0.2"]
POINTS = ["7 1 0.0 0.1 0.2", "3 2 0.02 0.1 0.2", "2 1 0.04 0.1 0.2"]
HYBRID = ["0.01 7800 5", "0.02 2500 5", "0.03 900 6"]
TURN = " 0 0 0"


def atoms(rows: list[str], style: str = "") -> str:
    return f"Atoms{style and f' # {style}'}\n\n" + "\n".join(rows) + "\n\n"


def numbered(rows: list[str], molecule: str) -> Iterator[str]:
    """Yield rows with the number of a molecule behind the number of the atom."""
    for row in rows:
        number, rest = row.split(" ", 1)
        yield f"{number} {molecule} {rest}"


BONDED = atoms(list(numbered(POINTS, "9")))
PLAIN = HEAD.replace("2 bonds\n1 bond types\n", "")
DATA = {  # Atom style of the input, and text of its data file.
    "sphere": ("sphere", PLAIN + atoms(BEADS) + VELOCITIES.format(turn=TURN)),
    "images": ("sphere", PLAIN + atoms([f"{row} 0 0 0" for row in BEADS], "sphere")),
    "bond": ("bond", HEAD + MASSES + BONDED + VELOCITIES.format(turn="") + BONDS),
    "molecular": ("molecular", HEAD + MASSES + BONDED + BONDS),
    "atomic": ("atomic", PLAIN + MASSES + atoms(POINTS, "atomic") + VELOCITIES.format(turn="")),
    "hybrid": (
        "hybrid sphere bond",
        HEAD
        + atoms([f"{row} {more}" for row, more in zip(POINTS, HYBRID, strict=True)], "hybrid")
        + VELOCITIES.format(turn=TURN)
        + BONDS,
    ),
}


@pytest.mark.parametrize(("style", "text"), DATA.values(), ids=DATA)
def test_data_files_are_read_as_in_lammps(style: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "a.data").write_text(text, encoding="utf-8")
    path = tmp_path / "in.own"
    lines = f"units si\natom_style {style}\natom_modify map array\nboundary f f f\n"
    more = " extra/bond/per/atom 2 extra/special/per/atom 3" if "bond" in style else ""
    lines += f"read_data {tmp_path / 'a.data'}{more}\n"
    path.write_text(lines, encoding="utf-8")
    with silent_lammps(lines) as lmp:
        number = lmp.numpy.extract_atom("id")[:3]
        order = np.argsort(number)
        names = ("x", "v", "type", "rmass", "radius")
        found = {name: lmp.numpy.extract_atom(name) for name in names}
        expected = {
            name: values[:3][order].copy() for name, values in found.items() if values is not None
        }
        of_types = lmp.numpy.extract_atom("mass")
        if "rmass" not in expected:
            expected["rmass"] = of_types[expected["type"]]
    source = LammpsInput(path)
    grains = source.grains()
    assert grains.numbers.tolist() == [2, 3, 7]
    assert grains.positions.tolist() == expected["x"].tolist()
    assert grains.velocities.tolist() == expected["v"].tolist()
    assert grains.types.tolist() == expected["type"].tolist()
    assert grains.masses == pytest.approx(np.ravel(expected["rmass"]), rel=1e-14)
    if "radius" in expected:
        assert grains.diameters == pytest.approx(2 * expected["radius"], rel=1e-14)
    else:
        assert np.isnan(grains.diameters).all()
    bonds = [(bond.first, bond.second) for bond in source.state.bonds]
    assert bonds == ([(7, 3), (3, 2)] if "Bonds" in text else [])


def test_a_dump_places_the_grains_of_a_data_file(tmp_path: Path) -> None:
    """Masses are those of the file; positions are twice those, with one grain less."""
    (tmp_path / "a.data").write_text(DATA["bond"][1].replace(BONDS, ""), encoding="utf-8")
    path = tmp_path / "in.own"
    text = "units cgs\natom_style bond\nboundary f f f\nread_data a.data\n"
    path.write_text(text, encoding="utf-8")
    placed = LammpsInput(path).grains()
    assert placed.positions[:, 0] == pytest.approx([4e-4, 2e-4, 0.0], rel=1e-15)
    few = slice(1, 3)
    unknown = np.full(2, math.nan)
    dumped = RunGrains(
        "own.lammpstrj", placed.numbers[few], np.zeros(2, dtype=int), 2 * placed.positions[few],
        7 * placed.velocities[few], unknown, unknown, 0.0,
    )  # fmt: skip
    path.write_text(f"{text}create_bonds many all all 1 0.03 0.05\n", encoding="utf-8")
    source = LammpsInput(path, dumped)
    grains = source.grains()
    assert grains.masses == pytest.approx([4e-6, 2e-6], rel=1e-15)
    assert grains.types.tolist() == [2, 1]
    assert grains.positions.tolist() == dumped.positions.tolist()
    assert grains.velocities.tolist() == dumped.velocities.tolist()
    assert [(bond.first, bond.second) for bond in source.state.bonds] == [(7, 3)]


def understood(path: Path, options: RunOptions) -> Understood:
    source = LammpsInput(path)
    return infer_scene(source.grains(), source, options)


SPHERES = PLAIN + atoms(BEADS)
REFUSED = {
    "an image": (SPHERES.replace("0.02 0.1 0.2", "0.02 0.1 0.2 0 0 1"), "line 12 .*image flags"),
    "two flags": (SPHERES.replace("0.02 0.1 0.2", "0.02 0.1 0.2 0 0"), "must have number, kind, "),
    "one column less": (SPHERES.replace("0.04 0.1 0.2", "0.04 0.1"), "line 13 .* must have number"),
    "twice": (SPHERES.replace("2 1 0.03", "7 1 0.03"), "line 13 .* defines grain 7 a second time"),
    "angles": (SPHERES + "Angles\n\n1 1 1 2 3\n", "has a section 'Angles', which is not read"),
    "another style": (SPHERES.replace("Atoms", "Atoms # full"), "has the atom style 'full': use s"),
    "a hybrid alone": (SPHERES.replace("Atoms", "Atoms # hybrid"), "name the input that reads"),
    "no section": (PLAIN, "has no section Atoms"),
    "a rotation": (SPHERES + VELOCITIES.format(turn=" 1 0 0"), "three velocities, without a rot"),
    "two velocities": (
        SPHERES + "Velocities\n\n2 0 0\n",
        "must have a number and three velocities",
    ),
    "no such grain": (SPHERES + "Velocities\n\n5 0 0 0\n", "names a grain that does not exist"),
    "a short bond": (SPHERES + "Bonds\n\n1 1 2\n", "must have a number, a type and two atoms"),
    "a short mass": (SPHERES + "Masses\n\n1\n", "is too short"),
    "bonds": (SPHERES + BONDS, "has bonds, whose style its input names: name the input, too"),
}


@pytest.mark.parametrize(("text", "message"), REFUSED.values(), ids=REFUSED)
def test_rows_that_cannot_be_read_are_rejected(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "a.data"
    path.write_text(text, encoding="utf-8")
    options = RunOptions(young=1e9, poisson=0.3, duration=1e-4)
    with pytest.raises(InputError, match=message):
        understood(path, options)


def test_a_data_file_alone_is_a_scene_of_a_material(tmp_path: Path) -> None:
    """The diameters fall by 5 % from grain to grain, and the first one is struck."""
    path = tmp_path / "a.data"
    path.write_text(tapered_data(), encoding="utf-8")
    options = RunOptions(young=1e9, poisson=0.3, duration=1e-4, samples=7)
    # The first 40 lines are searched for the number of atoms.
    for empty, data in ((38, True), (39, False)):
        assert is_data("row\n" + empty * "\n" + " 12  atoms # of glass\n") == data
    grains, in_cm = (LammpsInput(path, units=units).grains() for units in (None, "cgs"))
    assert in_cm.positions == pytest.approx(grains.positions / 100, rel=1e-12)
    assert in_cm.masses == pytest.approx(grains.masses / 1000, rel=1e-12)
    found = understood(path, options)
    scene = Scene(**found.fields)
    sizes = 0.01 * 0.95 ** np.arange(12)
    assert scene.chain.diameters == pytest.approx(sizes, rel=1e-12)
    assert scene.chain.masses == pytest.approx(2700 * math.pi / 6 * sizes**3, rel=1e-12)
    radii = 0.5 / (1 / sizes[:-1] + 1 / sizes[1:])
    constants = 4 / 3 * 1e9 / (2 * (1 - 0.09)) * np.sqrt(radii)
    assert scene.chain.contact_constants == pytest.approx(constants, rel=1e-12)
    assert scene.initial()[1].tolist() == [0.2] + 11 * [0.0]
    assert (scene.samples, scene.duration) == (7, 1e-4)
    assert found.facts[0][0] == "column"
    assert dict(found.facts)["contacts"] == "Hertz, of E = 1e+09 Pa (given)"
    with pytest.raises(InputError, match="duration: is not in the run: give --duration"):
        understood(path, options._replace(duration=None))
    with pytest.raises(InputError, match=r"^samples: must be at least 2"):
        Scene(**understood(path, options._replace(samples=0)).fields)
    assert understood(path, options._replace(samples=None)).fields["samples"] == 101


BEAD = 2500 * math.pi / 6 * 1e-6


def beads(
    folder: Path,
    forces: np.ndarray,
    speeds: dict[int, float],
    sign: float = 1.0,
    fourth: float = 2500.0,
) -> Understood:
    """Return the scene of beads along z with these forces, speeds, and density of grain 4."""
    stiffness = 4 / 3 * 1e9 / (2 * (1 - 0.09)) * math.sqrt(0.0025)
    depth = np.concatenate([[0.0], np.cumsum(0.01 - (forces / stiffness) ** (2 / 3))])
    rows = [
        f"{n} 1 0.01 {fourth if n == 4 else 2500.0!r} 0 0 {sign * z!r}"
        for n, z in enumerate(depth.tolist(), 1)
    ]
    moving = "".join(f"{n} 0 0 {sign * speed!r} 0 0 0\n" for n, speed in speeds.items())
    path = folder / "a.data"
    path.write_text(f"{PLAIN}{atoms(rows)}Velocities\n\n{moving}", encoding="utf-8")
    return understood(path, RunOptions(young=1e9, poisson=0.3, duration=1e-4))


@pytest.mark.parametrize("up", [False, True])
@pytest.mark.parametrize(
    ("gravity", "load", "count"),
    [(0.5, 0.0, 8), (9.81, 0.3, 4), (3.7, 2e-4, 8), (0.0, 0.3, 8), (0.0, 0.3, 3)],
)
def test_positions_at_rest_give_gravity_load_and_direction(
    gravity: float, load: float, count: int, up: bool, tmp_path: Path
) -> None:
    """The force below grain n is the load and the weight of n grains.

    The last grain is struck under gravity; otherwise the top is the end next to the struck grain.
    """
    forces = load + gravity * BEAD * np.arange(1, count)
    struck = count if gravity else count // 2
    found = beads(tmp_path, forces, {struck: 0.01}, -1.0 if up else 1.0)
    points = "up" if up else "down"
    facts = dict(found.facts)
    column = f"{count} grains along z, which points {points}: grain 1 is atom 1"
    assert facts["column"].startswith(column)
    assert ("too few contacts at rest to infer it" in facts["gravity"]) == (count == 3)
    scene = Scene(**found.fields)
    assert scene.chain.gravity == pytest.approx(gravity, rel=1e-7, abs=0)
    assert scene.chain.top_load == pytest.approx(load, rel=1e-5, abs=0)
    # The last grain is not known to be held, so that a wall must carry it.
    assert scene.chain.bottom == "wall"
    assert scene.excitation == Impulse(velocity=0.01, grain=struck)


def test_small_deviations_from_rest_and_from_one_density_have_limits(tmp_path: Path) -> None:
    """Forces scatter by 1 %, slow grains move by 1e-6 of the wave, and masses differ by 5e-6."""
    forces = np.full(7, 0.3)
    for place, offset, speed, load in (
        (3, 0.0095, 0.0, 0.3 * (1 + 0.0095 / 6)),
        (3, 0.0105, 0.0, None),
        (3, 0.5, 0.9e-8, None),
        (3, 0.5, 1.1e-8, 0.3),
    ):
        forces[place] = 0.3 * (1 + offset)
        speeds = {1: 0.01, place + 1: speed}
        if load is None:
            with pytest.raises(InputError, match="its first frame is not at rest, so its overlaps"):
                beads(tmp_path, forces, speeds)
            continue
        chain = beads(tmp_path, forces, speeds).fields["chain"]
        assert chain.top_load == pytest.approx(load, rel=1e-4 if offset < 0.1 else 1e-7)
    forces[:] = 0.3
    for excess, own in ((4.5e-6, False), (5.5e-6, True)):
        chain = beads(tmp_path, forces, {1: 0.01}, fourth=2500 * (1 + excess)).fields["chain"]
        assert ("masses" in chain.given()) == own
        assert chain.masses[3] == pytest.approx(BEAD * (1 + excess * own), rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_lines_and_means_agree_with_weighted_least_squares(
    rng: np.random.Generator, seed: int
) -> None:
    """NumPy's fit has the same slope and standard error, for scatter above and below the errors."""
    x = rng.uniform(0, 1, 9)
    errors = rng.uniform(0.1, 0.3, 9)
    for scatter, covariance in ((10.0, True), (1e-3, "unscaled")):
        y = 3 - 2 * x + scatter * errors * rng.normal(size=9)
        (slope, _), spread = np.polyfit(x, y, 1, w=1 / errors, cov=covariance)
        line = fit_line(x, y, errors)
        assert line == pytest.approx((slope, math.sqrt(spread[0, 0])), rel=1e-9)
        flat = 3 + scatter * errors * rng.normal(size=9)
        (mean,), spread = np.polyfit(x, flat, 0, w=1 / errors, cov=covariance)
        error = math.sqrt(spread[0, 0])
        for load, found in ((2.9 * error, 0.0), (3.1 * error, 3.1 * error)):
            assert mean_load(flat - mean + load, errors, 0.0) == pytest.approx(found, rel=1e-8)
            assert mean_load(mean - flat - load, errors, 0.0) == pytest.approx(-found, rel=1e-8)
    assert fit_line(np.ones(4), np.arange(4.0), np.ones(4)) == (0.0, math.inf)
    for largest, found in ((0.99e9, 1.0), (1.01e9, 0.0)):
        assert mean_load(np.ones(4), np.full(4, 1e-9), largest) == found


def test_gravity_is_a_usual_value_or_the_slope() -> None:
    weights = np.array([1.0, 3.0])
    for slope, error, largest, gravity in (
        (9.7, 0.0, 30.0, 9.7),
        (-20.0, 3.0, 60.0, 20.0),
        (20.0, 6.7, 60.0, 0.0),
        (9.81 * (1 + 9e-6), 0.0, 30.0, 9.81),
        (9.81 * (1 + 1.1e-5), 0.0, 30.0, 9.81 * (1 + 1.1e-5)),
        (9.806, 2.3e-4, 30.0, 9.80665),
        (9.806, 2.1e-4, 30.0, 9.80665),
        (9.79, 4e-3, 30.0, 9.8),
        (1.0, 0.0, 1.9e7, 1.0),
        (1.0, 0.0, 2.1e7, 0.0),
    ):
        assert gravity_of(Line(slope, error), weights, np.array([0.0, largest])) == gravity


def test_the_load_is_the_root_of_the_excess() -> None:
    for load in (1e-9, 0.3, 7e5):
        root = load_between(lambda x, load=load: x**1.5 - load**1.5)
        assert root == pytest.approx(brentq(lambda x, load=load: x - load, 0, 1e6), rel=1e-15)
    assert load_between(lambda _: -1.0) == math.inf
