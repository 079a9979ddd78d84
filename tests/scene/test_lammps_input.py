"""LAMMPS inputs that cannot be scenes are rejected by line; no physics is ignored."""

import math
import random
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.own_inputs import INPUTS, LEVEL, run_input, silent_lammps, tapered_data
from scipy.optimize import brentq

from lmpchain import Impulse, InputError, LmpchainError, Profile, Scene
from lmpchain.cli.command_line import main
from lmpchain.scene.base import Excitation
from lmpchain.scene.lammps_column import RunOptions, infer_scene
from lmpchain.scene.lammps_input import LammpsInput
from lmpchain.trajectory.lammps_dump import scene_of_run

START = """units si
atom_style sphere
boundary f f f
region box block -0.01 0.2 -0.01 0.01 -0.01 0.01
create_box 1 box
create_atoms 1 single 0.0 0 0
create_atoms 1 single 0.0099999 0 0
create_atoms 1 single 0.0199998 0 0
set group all diameter 0.01 density 7800
pair_style granular
pair_coeff * * hertz 1e10 0.0 tangential linear_nohistory 0 0 damping velocity
group beads id 1:2
fix 1 beads nve/sphere
velocity all set 0 0 0
set atom 1 vx 0.1
timestep 1e-7
run 100
"""


def read(folder: Path, text: str):
    """Return the fields of the scene of an input."""
    path = folder / "in.own"
    path.write_text(text, encoding="utf-8")
    source = LammpsInput(path)
    return infer_scene(source.grains(), source, RunOptions())


def test_the_plain_input_is_understood(tmp_path: Path):
    understood = read(tmp_path, START)
    chain = understood.fields["chain"]
    assert chain.contact_constants == pytest.approx(STIFF, rel=1e-14)
    assert chain.masses == pytest.approx(MASS, rel=1e-14)
    assert (chain.top, chain.bottom, chain.gravity, chain.top_load) == ("free", "fixed", 0.0, 0.0)
    # Without a load, the overlaps of the input are displacements from touching.
    u, v = understood.fields["excitation"].initial(chain)
    # Positions of millimetres have rounding errors of 1e-18 m.
    assert u == pytest.approx([2e-7, 1e-7, 0.0], rel=1e-8, abs=1e-17)
    assert v.tolist() == [0.1, 0.0, 0.0]
    assert understood.fields["duration"] == pytest.approx(1e-5, rel=1e-15)
    assert understood.fields["samples"] == 101
    off = f"{STIFF * 1e-7**1.5:.2g} N"
    assert understood.facts == [
        ("units", "si (line 1)"),
        ("column", "3 grains along x, which points down: grain 1 is atom 1, grain 3 atom 3"),
        ("gravity", "none (no fix gravity)"),
        ("contacts", f"Hertz, {STIFF:g} N/m^1.5 (line 10)"),
        ("load", "none (no fix addforce on a grain)"),
        ("top", "free"),
        ("bottom", "grain 3 is held"),
        ("grains", f"diameter 0.01 m, mass {MASS:.6g} kg"),
        ("equilibrium", f"forces of the first frame differ from those at rest by at most {off}"),
        ("start", "displacements from rest up to 2e-07 m, velocities up to 0.1 m/s"),
        ("recording", "101 samples to 1e-05 s"),
    ]


WALL = (
    "fix 8 all wall/gran granular hertz 1e10 0 tangential linear_nohistory 0 0 damping velocity "
    "xplane"
)
HELD_TOP = "set atom 1 vx 0\nset atom 2 vx 0.1\ngroup t id 1\nfix 8 t setforce 0 0 0"
MASS = 7800 * math.pi / 6 * 1e-6
# The force is F = k sqrt(R o) o, with R a quarter of the diameter, and half of it at a wall.
STIFF = 1e10 * math.sqrt(0.0025)
WALL_STIFF = 1e10 * math.sqrt(0.005)
WEIGHT = 9.81 * MASS
GRAVITY = "fix 9 all gravity 9.81 vector 1 0 0"
LET_GO = "group t id 3\nfix 7 t nve"
ANY_PAIR = next(line for line in START.splitlines() if line.startswith("pair_coeff"))
SECOND = "set atom 2 type 2\npair_coeff 2 2"
UNLIKE = "has another contact model than the other types: add a pair_coeff"


def squeezed(force: float, constant: float) -> float:
    """Return the overlap of a contact with this force, m."""
    return (force / constant) ** (2 / 3)


def excess(load: float) -> float:
    """Return the overlaps of a column between two walls minus the space that it lacks, m."""
    constants = (WALL_STIFF, STIFF, STIFF, WALL_STIFF)
    rest = sum(squeezed(load + n * WEIGHT, constant) for n, constant in enumerate(constants))
    return rest - 2e-5


# Lines that are added before the run; findings, and the forces of all contacts at rest, N.
PRESSED = float(brentq(excess, 0.0, 10.0, xtol=1e-15))
UNDERSTOOD: dict[str, tuple[str, dict[str, str], list[float]]] = {
    "gravity": (
        "fix 9 all gravity 9.81 vector 2 0 0",
        {"gravity": "9.81 m/s2 (line 16)", "load": "none (no fix addforce on a grain)"},
        [0.0, WEIGHT, 2 * WEIGHT, 0.0],
    ),
    "two parts of gravity": (
        "fix 7 all gravity 9 vector 1 0 0\nfix 9 beads gravity -0.81 vector -1 0 0",
        {"gravity": "9.81 m/s2 (line 17)"},
        [0.0, WEIGHT, 2 * WEIGHT, 0.0],
    ),
    "two loads": (
        # A restitution of 1 is no damping.
        "group t id 1 3\nfix 7 t addforce 1 0 0\nfix 9 t addforce 0.5 0 0\n"
        "pair_coeff * * hertz 1e10 1 damping coeff_restitution",
        {"load": "1.5 N on grain 1 (line 18)", "gravity": "none (no fix gravity)"},
        [0.0, 1.5, 1.5, 0.0],
    ),
    "gravity and a load": (
        f"group t id 1\nfix 7 t addforce 1 0 0\n{GRAVITY}",
        {"load": "1 N on grain 1 (line 17)"},
        [0.0, 1 + WEIGHT, 1 + 2 * WEIGHT, 0.0],
    ),
    "a wall far away": (
        # The limits are 1e-9 of the largest speed and 1e-6 of the diameter.
        f"{WALL} -0.00551 NULL\nset atom 2 vy 0.9e-10 y 0.9e-8",
        {"wall at -0.00551": "ignored: its nearest grain is 0.00051 m away", "top": "free"},
        [0.0] * 4,
    ),
    "a wall above": (
        f"{WALL} -0.00499 NULL",
        {"top": "a wall, 7.07107e+08 N/m^delta (line 16)", "bottom": "grain 3 is held"},
        [(1.02e-5 / (2 / STIFF ** (2 / 3) + 1 / WALL_STIFF ** (2 / 3))) ** 1.5] * 3 + [0.0],
    ),
    "gravity between walls": (
        f"{LET_GO}\n{GRAVITY}\n{WALL} -0.00499 0.02499",
        {"load": f"{PRESSED:.9g} N (from the distance of the ends, which do not move)"},
        [PRESSED + n * WEIGHT for n in range(4)],
    ),
    "a floor": (
        f"{LET_GO}\n{GRAVITY}\n{WALL} NULL 0.02499",
        {"top": "free", "bottom": "a wall, 7.07107e+08 N/m^delta (line 19)"},
        [0.0, WEIGHT, 2 * WEIGHT, 3 * WEIGHT],
    ),
    "stops at both ends": (
        # Other forces may precede a stop, and those on other grains may follow it.
        f"fix 6 all gravity 0 vector 1 0 0\n{HELD_TOP}\nset atom 3 x 0.0199997\n"
        "fix 7 t setforce 0 0 0\ngroup r id 2 3 123456789012345678\nfix 9 r gravity 0 vector 1 0 0",
        {"top": "grain 1 is held", "hold": "grain 1 does not move: a drive of amplitude 0"},
        [0.0, *[STIFF * 1.5e-7**1.5] * 2, 0.0],
    ),
    "drags": (
        "group b id 2\nfix 7 b viscous 1.0\nfix 9 all viscous 0.5",
        {"damping": "contacts 0 s, drag 122.427 to 367.281 1/s"},
        [0.0] * 4,
    ),
}


def test_overlaps_within_a_millionth_of_rest_are_at_rest(tmp_path: Path) -> None:
    """The lower contact, and the floor in a second input, differ from rest."""
    upper, lower, floor = (squeezed(n * WEIGHT, STIFF) for n in (1, 2, 3))
    floor *= (STIFF / WALL_STIFF) ** (2 / 3)
    for ends, place in ((GRAVITY, 0), (f"{LET_GO}\n{GRAVITY}\n{WALL} NULL {{}}", 1)):
        for offset, rest in ((0.0, True), (0.9e-6, True), (-0.9e-6, True), (1.1e-6, False)):
            second = 0.01 - upper
            third = second + 0.01 - lower * (1 + offset * (place == 0))
            wall = third + 0.005 - floor * (1 + offset)
            lines = f"set atom 2 x {second!r}\nset atom 3 x {third!r}\n{ends.format(repr(wall))}"
            excitation = read(tmp_path, START.replace("timestep", f"{lines}\ntimestep")).fields[
                "excitation"
            ]
            assert (excitation == Impulse(velocity=0.1)) == rest


def test_grains_that_touch_between_held_ends_have_no_load(tmp_path: Path) -> None:
    lines = f"{HELD_TOP}\nset atom 2 x 0.01\nset atom 3 x 0.02\ntimestep"
    understood = read(tmp_path, START.replace("timestep", lines))
    assert dict(understood.facts)["load"] == "none"
    assert not understood.fields["chain"].contacts.force.any()


@pytest.mark.parametrize("name", UNDERSTOOD)
def test_forces_and_displacements_follow_from_the_lines(name: str, tmp_path: Path) -> None:
    """Forces at rest are those of the fixes, and displacements are overlaps beyond these forces."""
    lines, findings, forces = UNDERSTOOD[name]
    understood = read(tmp_path, START.replace("timestep", f"{lines}\ntimestep"))
    assert findings.items() <= dict(understood.facts).items()
    scene = Scene(**understood.fields)
    contacts = scene.chain.contacts
    # The first contact carries the load, even at a free end.
    assert contacts.force[1:] == pytest.approx(forces[1:], rel=1e-9, abs=1e-15)
    overlaps = [1.00e-5, 1e-7, 2e-7 if "set atom 3" in lines else 1e-7, 9.8e-6]
    constants = [WALL_STIFF, STIFF, STIFF, WALL_STIFF]
    off = [o - squeezed(f, k) for o, f, k in zip(overlaps, forces, constants, strict=True)]
    if scene.chain.bottom == "fixed":
        off[3] = 0.0
    expected = np.cumsum(off[:0:-1])[::-1]
    u = scene.initial()[0]
    assert u == pytest.approx(expected, rel=1e-8, abs=1e-16)
    if scene.chain.top == "wall":
        assert contacts.force[0] == pytest.approx(forces[0], rel=1e-9)
        assert u[0] == pytest.approx(-off[0], rel=1e-8)
        assert contacts.constant[0] == pytest.approx(WALL_STIFF, rel=1e-14)
    drag = 0.5 / MASS if name == "drags" else 0.0
    assert scene.chain.drag[:2] == pytest.approx([drag, 3 * drag], rel=1e-14, abs=0)


def opposite(word: str) -> str:
    """Return a number with the opposite sign; NULL has none."""
    if word in ("NULL", "0", "0.0"):
        return word
    return word.removeprefix("-") if word.startswith("-") else f"-{word}"


def upward(text: str) -> str:
    """Return an input along z, which points up, in place of x, which points down."""
    text = text.replace("-0.01 0.2 -0.01 0.01 -0.01 0.01", "-0.01 0.01 -0.01 0.01 -0.2 0.01")
    for pattern, turned in (
        (r"(single|vector|addforce) (\S+) 0 0", lambda m: f"{m[1]} 0 0 {opposite(m[2])}"),
        (r"xplane (\S+) (\S+)", lambda m: f"zplane {opposite(m[2])} {opposite(m[1])}"),
        (r"\b(v?)x (\S+)\n", lambda m: f"{m[1]}z {opposite(m[2])}\n"),
    ):
        text = re.sub(pattern, turned, text)
    return text


# A strike in the middle has no upper side, and the drag of a held grain is arbitrary.
@pytest.mark.parametrize(
    "name", [n for n in UNDERSTOOD if n not in ("stops at both ends", "drags")]
)
def test_a_column_upside_down_is_the_same_scene(name: str, tmp_path: Path) -> None:
    lines = UNDERSTOOD[name][0]
    text = START.replace("timestep", f"{lines}\ntimestep")
    down, up = (read(tmp_path, each) for each in (text, upward(text)))
    assert dict(up.facts)["column"].startswith(
        "3 grains along z, which points up: grain 1 is atom 1"
    )
    changed = {"column", "wall at -0.00551", "wall at 0.00551"}
    facts = [{key: x for key, x in each.facts if key not in changed} for each in (down, up)]
    assert facts[0] == facts[1]
    one, other = (Scene(**each.fields) for each in (down, up))
    assert one.chain == other.chain
    assert np.array_equal(one.initial(), other.initial())


STARTS = {  # Lines that are added before the run, a finding, and the excitation.
    "one grain": ("", "grain 1 moves at 0.1 m/s, positive downward", Impulse(velocity=0.1)),
    "grain 2": (
        "velocity all set 0 0 0\nset atom 2 vx -0.25",
        "grain 2 moves at -0.25 m/s, positive downward",
        Impulse(velocity=-0.25, grain=2),
    ),
    "two grains": (
        "set atom 2 vx -0.25",
        "velocities of 2 grains, up to 0.25 m/s",
        Profile(velocity=[0.1, -0.25, 0.0]),
    ),
    "nothing": ("set atom * vx 0", "nothing moves: change [excitation]", Impulse(velocity=0.0)),
    "a displacement": (
        "set atom 1 x -0.001",
        "displacements from rest up to 0.001 m, velocities up to 0.1 m/s",
        Profile(displacement=[-0.001, 0.0, 0.0], velocity=[0.1, 0.0, 0.0]),
    ),
}


@pytest.mark.parametrize(("lines", "finding", "excitation"), STARTS.values(), ids=STARTS)
def test_the_start_is_the_simplest_excitation(
    lines: str, finding: str, excitation: Excitation, tmp_path: Path
) -> None:
    """Grains that only touch are struck, and a profile contains displacements from touching."""
    touching = f"set atom 1 x 0\nset atom 2 x 0.01\nset atom 3 x 0.02\n{lines}\ntimestep"
    understood = read(tmp_path, START.replace("timestep", touching))
    assert dict(understood.facts)["start"] == finding
    found = understood.fields["excitation"]
    if finding.startswith("displacements"):
        assert found.displacement == pytest.approx(excitation.displacement, rel=1e-12, abs=0)
        found = found.replace(displacement=excitation.displacement)
    assert found == excitation


@pytest.mark.parametrize(
    ("lines", "samples", "duration"),
    [
        ("dump 1 all custom 20 a id x", 6, 1e-5),
        ("dump 1 all custom 30 a id x", 101, 1e-5),
        ("dump 1 all custom 200 a id x", 101, 1e-5),
        ("dump 1 all custom 50 a id x\nrun 0\nrun 50", 4, 1.5e-5),
        ("reset_timestep 40\nrun 100 upto\nlattice none 1.0", 101, 1.6e-5),
        ("reset_timestep 140\nrun 100 upto", 101, 1e-5),
    ],
)
def test_samples_are_the_frames_of_the_dump(
    lines: str, samples: int, duration: float, tmp_path: Path
) -> None:
    found = read(tmp_path, START.replace("run 100", f"{lines}\nrun 100")).fields
    assert (found["samples"], found["duration"]) == (samples, pytest.approx(duration, rel=1e-12))


def test_a_held_top_grain_has_no_displacement(tmp_path: Path, rng: np.random.Generator) -> None:
    """Sums of seven overlaps that differ have rounding errors, which must not move a held grain."""
    row = np.concatenate([[0.0], np.cumsum(0.01 - rng.uniform(1e-7, 3e-7, (9, 6)), axis=1)[0]])
    for _ in range(5):
        row[1:] = np.cumsum(0.01 - rng.uniform(1e-7, 3e-7, 6))
        atoms = "\n".join(f"create_atoms 1 single {x!r} 0 0" for x in row.tolist())
        text = START.replace("create_atoms 1 single 0.0 0 0", atoms)
        text = "\n".join(line for line in text.split("\n") if " 0.0099999 " not in line)
        text = "\n".join(line for line in text.split("\n") if " 0.0199998 " not in line)
        text = text.replace("beads id 1:2", "beads id 2:6").replace("atom 1 vx", "atom 3 vx")
        scene = Scene(**read(tmp_path, text).fields)
        u = scene.initial()[0]
        assert u[[0, -1]].tolist() == [0.0, 0.0]
        rest = 0.01 - row[-1] / 6
        assert np.diff(u) == pytest.approx(np.diff(row) - 0.01 + rest, rel=0, abs=1e-16)


OLD_WALL = "fix 9 all wall/gran hertz/history 1e9 NULL 0 NULL 0 0"
REFUSED = {  # Lines that are added before the run, and a part of the message.
    "pair_style gran/hooke 1e5 NULL 3 NULL 0 0 limit_damping": "has limit_damp",
    "pair_style gran/hooke 0 NULL 0 NULL 0 0": "above 0 (got 0)",
    "pair_style gran/hooke 1e5 NULL 0 NULL 0 0 limit_damping 3": "has 3, which",
    "pair_style lj/cut 2.5": "is not a supported pair style",
    "pair_style gran/hertz 1 0 0 0 0 0": "use granular, gran/",
    "pair_modify shift yes": "is not understood, and could change the motion",
    "fix 9 all langevin 1 1 1 3": "is a fix that is not understood, and could",
    "fix 9 all move linear 0 0 1": '[excitation] kind = "drive"',
    'fix 9 all wall/lepton zlo 0 "r" 1': "use fix wall/gran with xplane",
    f"{OLD_WALL} zcylinder 0.005": "must end in xplane, yplane or zplane",
    f"{OLD_WALL} zplane -0.0049 NULL": "touches the column from the side",
    f"{OLD_WALL} xplane -1 NULL wiggle x 1 1": "must end in xplane, yplane or zplane and two posi",
    OLD_WALL.replace("hertz/history", "hooke") + " xplane -0.005 NULL": (
        "has hooke contacts, but the grains have hertz contacts"
    ),
    f"{WALL} -0.005 NULL\nfix 9 {WALL[6:]} -0.0049 NULL": "is a second wall",
    f"{WALL} -0.00549 NULL": "m shorter than the space between its ends",
    # The relaxation time is 3 m / (1.5 k).
    "fix 9 all wall/gran hertz/history 1e10 NULL 3 NULL 0 0 xplane -0.005 NULL": (
        "has the relaxation time 8.16814e-13 s: use the relaxation time of the contact beside it, "
        "0 s"
    ),
    f"{HELD_TOP}\nset atom 3 x 0.0201": "its column is 0.0001 m shorter than the space between its",
    f"{LET_GO}\n{GRAVITY}": "has no wall and no held grain at its bottom: it would fall",
    f"{LET_GO}\n{GRAVITY}\n{WALL} -0.00499 NULL": "has no wall and no held grain at its bottom: it",
    "fix 9 all gravity 9.81 vector -1 0 0": "no held grain at its bottom: it would fall",
    "fix 9 all gravity 9.81 vector 0 0 0": "must be along the column, x",
    "fix 9 all gravity 9.81 vector 1 0": "must be `gravity` with a magnitude and vector",
    "fix 9 all gravity 9.81 vector 0 0 -1": "must be along the column, x",
    "group two id 2\nfix 9 two gravity 9.81 vector 1 0 0": "must act on",
    "fix 9 all gravity 9.81 chute 20": "with a magnitude and vector x y z",
    "group t id 1\nfix 9 t addforce -1 0 0": "pulls grain 1 out of the column",
    "group t id 2\nfix 9 t addforce 1 0 0": "must press grain 1 alone",
    "group t id 1\nfix 9 t addforce 1 1 0": "must press grain 1 alone",
    "group t id 1\nfix 9 t addforce 1 0 0 every 2": "has options that are not read: give three",
    f"group t id 1\nfix 9 t addforce 1 0 0\n{WALL} -0.005 NULL": (
        "(fix 9 t addforce 1 0 0) presses grain 1, which touches a wall"
    ),
    "group t id 1\nfix 9 t addforce 1e9 0 0": "not define a valid",
    "group t id 1\nfix 9 t addforce v_f 0 0": "the variable f, whose",
    "fix 9 all setforce 1 0 0": "sets a force other than 0",
    "fix 9 all setforce 0 0 0 region box": "has options that are not read: give three numbers",
    "fix 9 all viscous 1 scale 1 2": "has options that are not read: give one number",
    "set atom * x 0.0": "has all grains at one place",
    "group t id 2\nfix 8 t setforce 0 0 0": "atom 2 is held within",
    "fix 1 beads freeze": "has no fix nve or nve/sphere",
    "fix 9 all nve": "moves grains that another fix moves",
    f"group t id 2\nfix 8 t setforce 0 0 0\n{GRAVITY}": (
        "acts on grains after the setforce of line 17 stopped them, so that they move"
    ),
    "fix 1 bears nve": "uses the group bears, which is not def",
    "fix 9 bears enforce2d": "uses the group bears, which is not def",
    "group beads region box": "uses the group beads, which is not",
    "create_atoms 1 random 20 1 NULL": "places grains that are not read",
    "set atom 2 vy 1.1e-10": "atom 2 moves sideways at 1.1e-10 m/s",
    "set atom 2 y 1.1e-8": "atom 2 is 1.1e-08 m beside the line of the other grains along x",
    "set atom 2 omega 1": "sets omega, which is not read",
    "velocity all create 300 1": "gives velocities that are not read",
    "set atom 3 vx 1.0": "atom 3 is held but has a velocity",
    "minimize 0 0 10 10": "is not understood",
    "neigh_modify exclude type 1 1": "removes forces between pairs",
    "label again": "is a loop or a condition, which is not executed",
    "units real": "is not a style for grains",
    "units lj": "has no scale: add --units LENGTH,TIME,MASS",
    "lattice none 2.0": "scales positions",
    "dimension 1": "must be 2 or 3",
    "boundary f f": "must have three words, such as boundary f f f",
    "run 100 every 10 NULL": "has options that are not understood",
    "create_atoms 1 single 0.2 0 0": "is outside of the box",
    "create_atoms 1 single 0.1 0 0 rotate 1": "has options that are not",
    "read_data a.data add append": "has options that are not read",
    "set mol 1 vx 0": "chooses grains by mol: use atom, type or group",
    "velocity all set 0 0 0 sum": "has options that are not read",
    "velocity all set 0 0 0 temp t": "has options that are not read",
    "velocity all set 0 0": "gives velocities that are not read: use set",
    "group g id": "is too short",
    "group g id 1234567890123456789": "has '1234567890123456789' in place of a whole number",
    "set atom 1:2:1:1 vx 0": "has a range that is not understood, '1:2:1:1'",
    "set atom 1*2*3 vx 0": "has a range that is not understood, '1*2*3'",
    "fix 9 all": "is too short",
    "atom_style ellipsoid": "must be sphere, bond",
    "timestep ${dt}": "uses the variable dt, whose value is not known",
    "variable a equal random(0,1,3)\nset atom 1 vx ${a}": "whose value is not known without LAMMPS",
    "variable a equal 1\nvariable a delete\ntimestep $a": "uses the variable a, whose value is not",
    "variable a loop 3\ntimestep $a": "uses the variable a, whose value",
    "variable a equal v_b\nvariable b equal v_a\ntimestep $a": "depend on each",
    "variable a equal -2^2\ntimestep $a": "in an unusual order",
    "variable a equal log(10)\ntimestep $a": "has the base 10",
    "timestep $(1e-7": "has a bracket that is not closed",
    "timestep fast": "has 'fast' in place of a number",
    "timestep 0": "must be a time above 0",
    "run 1e3": "has '1e3' in place of a whole number",
    "read_data no.data": "there is no such file",
    "bond_style fene": "is not a supported bond style",
}
MODELS = {  # Words after pair_coeff, and a part of the message.
    "1 1 hertz 1e10 0\npair_coeff 1 2 hooke 1e5 0\nset atom 3 type 2": "has both hertz and hooke",
    "* * jkr 1e10 0 0.3 0.1": "has cohesion (jkr)",
    "* * hurtz 1e10 0": "has no known contact model",
    "* * hertz 1e10 0 sticky 3": "has sticky",
    "* * hertz 1e10 0 cutoff 1": "has cutoff",
    "* * hertz 1e10": "is too short",
    "* *": "is too short: a contact model is missing",
    "* * hertz 1e10 0 heat area 3": "has heat, which a scene",
    "* * hertz 1e10 1 limit_damping": "has limit_damping",
    "* * hertz 1e10 0 rolling linear_history": "has rolling linear_",
    "* * hertz 1e10 0 tangential": "tangential ,",
    "* * hertz 1e10 0 tangential mindlin NULL 0": "is too short",
    "* * hertz/material 1e9 0 0.6": "of at most 0.5 (got 0.6",
    "* * hertz/material 1e9 0 -1": "0.5 (got -1)",
    "* * hertz -1 0": "stiffness above 0 (got -1)",
    "* * hertz 1e10 2 damping velocity": "has an unsupported damping velocity",
    # The coefficient is that of restitution; at 1, the polynomial of tsuji still dissipates.
    "* * hertz 1e10 0 damping tsuji": "has an unsupported damping tsuji",
    "* * hertz 1e10 1 damping tsuji": "has an unsupported damping tsuji",
    "* * hertz 1e10 0 damping coeff_restitution": "has an unsupported damping coeff_restitution",
}
REFUSED |= {f"pair_coeff {words}": message for words, message in MODELS.items()}
REPLACED = [  # A line, the lines in place of it, and a part of the message.
    (ANY_PAIR, "pair_coeff 2 2 hertz 1e10 0", "no pair_coeff for types 1"),
    (ANY_PAIR, f"{SECOND} hertz 1e10 0", "has no pair_coeff for types 1 and 2"),
    (ANY_PAIR, f"pair_coeff 1 1 hertz 1e10 0\n{SECOND} hooke 1e5 0", UNLIKE),
    (ANY_PAIR, f"pair_coeff 1 1 hertz 1e10 0\n{SECOND} hertz/material 1e9 0 0.3", UNLIKE),
    ("group beads id 1:2", "group beads id 1 3", "atom 2 is held within the column"),
    ("units si", "", "has no command units, so LAMMPS uses lj"),
    (
        *("region box block -0.01 0.2 -0.01 0.01 -0.01 0.01", "boundary p f f"),
        "has a periodic boundary along the column, x, in a box that is not read",
    ),
]


def refused(folder: Path, text: str) -> str:
    """Return the message with which an input is rejected, in one line that names its file."""
    with pytest.raises(InputError) as raised:
        read(folder, text)
    said = str(raised.value)
    assert "\n" not in said
    assert said.startswith(str(folder))
    return said


@pytest.mark.parametrize(("lines", "message"), REFUSED.items())
def test_a_line_is_rejected_with_its_number(lines: str, message: str, tmp_path: Path) -> None:
    assert message in refused(tmp_path, START.replace("timestep", f"{lines}\ntimestep"))


@pytest.mark.parametrize(("line", "lines", "message"), REPLACED)
def test_an_input_without_a_required_line_is_rejected(
    line: str, lines: str, message: str, tmp_path: Path
) -> None:
    assert START.count(line) == 1
    assert message in refused(tmp_path, START.replace(line, lines))


@pytest.mark.parametrize(("units", "unit"), [("si", 1.0), ("cgs", 0.01)])
@pytest.mark.parametrize("axis", range(3))
def test_ends_that_touch_through_a_periodic_boundary_are_rejected(
    axis: int, units: str, unit: float, tmp_path: Path
) -> None:
    """Boundaries are periodic by default; the column has the length 0.0299998."""
    text = START.replace("boundary f f f\n", "").replace("si\n", f"{units}\n")
    text = text.replace("vx", f"v{'xyz'[axis]}")
    for x in ("0.0", "0.0099999", "0.0199998"):
        text = text.replace(f"single {x} 0 0", f"single {' '.join(np.roll([x, '0', '0'], axis))}")
    path = tmp_path / "in.own"
    for end, touch in ((0.0249, True), (0.0251, False)):
        sides = np.roll([f"-0.005 {end}", "-0.01 0.01", "-0.01 0.01"], axis)
        box = text.replace("-0.01 0.2 -0.01 0.01 -0.01 0.01", " ".join(sides))
        if touch:
            message = f"has end grains that touch through the periodic boundary {'xyz'[axis]}"
            assert message in refused(tmp_path, box)
        else:
            assert len(read(tmp_path, box).fields["chain"].masses) == 3
        period = unit * np.roll([end + 0.005, 0.02, 0.02], axis)
        assert LammpsInput(path).grains().period == pytest.approx(period, rel=1e-12)


def test_files_that_are_no_inputs_are_rejected(tmp_path: Path) -> None:
    path = tmp_path / "in.own"
    with path.open("wb") as huge:
        huge.truncate(2**28 + 1)
    for place, message in (
        (tmp_path, "cannot be read: "),
        (tmp_path / "a", "no such file"),
        (path, "cannot be read: is larger than 256 MB"),
    ):
        with pytest.raises(InputError, match=message):
            LammpsInput(place)
    path.write_bytes(b"units si\n\xff\xfe")
    with pytest.raises(InputError, match="is not text: name an input, a data file or a dump"):
        LammpsInput(path)
    for text, message in (
        ("units si\nrun 10 &", "line 2 is continued, but its end is not found"),
        ("units si\nprint a" + 1002 * " &\n", "line 2 is continued, but its end is not found"),
        ("units si\nprint a" + 1001 * " &\n", "places no grains that can be read"),
        ("units si\natom_style hybrid\n", r"line 2 \(atom_style hybrid\) must be sphere, bond"),
        ("units si\natom_style hybrid sphere bond\n", "places no grains that can be read"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=message):
            LammpsInput(path)


def test_units_lj_need_a_scale(tmp_path: Path):
    """The input in units of 10 mm, 1 ms and 1 g agrees with that in SI units."""
    path = tmp_path / "in.own"
    path.write_text(START.replace("units si", "units lj"), encoding="utf-8")
    source = LammpsInput(path, units="1e-2,1e-3,1e-3")
    chain = infer_scene(source.grains(), source, RunOptions()).fields["chain"]
    assert chain.diameters == pytest.approx(1e-4)
    # K is k sqrt(R) for k in g/(cm ms2) and R in cm.
    assert chain.contact_constants == pytest.approx(1e10 * 1e-3 / 1e-2 / 1e-6 * math.sqrt(2.5e-5))
    path.write_text(START, encoding="utf-8")
    for units in ("cgs", "1e-2,1e-3,1e-3"):
        with pytest.raises(InputError, match=r"line 1 \(units si\) contradicts --units"):
            LammpsInput(path, units=units)


def test_a_change_between_runs_requires_a_dump(tmp_path: Path):
    later = "velocity all set 0 0 0\nset atom 1 vx 0.1\nrun 50\n"
    with pytest.raises(InputError, match=r"is between the runs of lines 17 and 20, where .*dump"):
        read(tmp_path, START + later)
    # Commands after the last run change nothing, and runs add up.
    more = read(tmp_path, START + "run 50\nundump 1\nunfix 1\n")
    assert more.fields["duration"] == 150 * 1e-7
    upto = read(tmp_path, START + "run 120 upto pre no post no\n")
    assert upto.fields["duration"] == pytest.approx(120e-7)


def test_fixes_act_on_the_members_that_their_groups_have_during_the_run(tmp_path: Path) -> None:
    plain = Scene(**read(tmp_path, START).fields)
    own = "group beads id 1:2\nfix 1 beads nve/sphere"
    first = START.replace(own, "group h id 3\nfix 2 h freeze")
    for text in (
        START.replace(own, "group beads id 1\nfix 1 beads nve/sphere\ngroup beads id 2"),
        START.replace(own, f"{own.replace('1:2', '3')}\ngroup beads clear\ngroup beads id 1:2"),
        first.replace("create_atoms", "fix 1 all nve/sphere\ncreate_atoms", 1),
    ):
        assert Scene(**read(tmp_path, text).fields) == plain
    for lines in (
        own.replace("group", "group beads region box\ngroup"),
        f"{own}\ngroup beads dynamic all every 1",
    ):
        with pytest.raises(InputError, match=r"fix 1 beads .* uses the group beads, which is not"):
            read(tmp_path, START.replace(own, lines))
    # A group that grows between two runs changes the second one.
    more = "group beads static\ngroup hit id 1\nrun 10\n"
    assert read(tmp_path, START + more).fields["duration"] == pytest.approx(110e-7)
    with pytest.raises(InputError, match=r"line 18 .*is between the runs of lines 17 and 21"):
        read(tmp_path, f"{START}group beads id 3\n{more}")


def test_variables_are_nested_to_a_depth_of_20(tmp_path: Path) -> None:
    lines = ["variable a0 equal 1e-6"]
    lines += [f"variable a{n} equal v_a{n - 1}/2" for n in range(1, 21)]
    for deepest in (19, 20):
        text = "\n".join([*lines, f"timestep v_a{deepest}"])
        changed = START.replace("timestep 1e-7", text)
        if deepest == 20:
            assert "depend on each other" in refused(tmp_path, changed)
        else:
            duration = read(tmp_path, changed).fields["duration"]
            assert duration == pytest.approx(1e-4 / 2**19, rel=1e-14)


def test_a_variable_that_the_command_line_can_set_is_named(tmp_path: Path):
    text = START.replace("set atom 1 vx 0.1", "variable v index 0.3\nset atom 1 vx $v")
    assert dict(read(tmp_path, text).facts)["variables"].startswith("v = 0.3, as in the file")


def test_variables_have_the_values_of_lammps(tmp_path: Path):
    """Each expression is also evaluated by LAMMPS."""
    expressions = {
        "a": "2*3+4",
        "b": "1/3",
        "c": "v_a*v_b-sqrt(2)",
        "d": "(v_a+1)^(2/3)*PI",
        "e": "ln(v_a)+exp(-v_b)+abs(-3)",
        "f": "1.0e-3*v_a^2",
    }
    lines = [f"variable {key} equal {text}" for key, text in expressions.items()]
    with silent_lammps("\n".join(lines)) as lmp:
        values = {key: lmp.extract_variable(key) for key in expressions}
    for key, value in values.items():
        for use in (f"$(v_{key}:%.17g)", f"${key}", f"${{{key}}}", f"$(v_{key})", f"v_{key}"):
            text = START.replace("vx 0.1", f"vx {use}")
            understood = read(tmp_path, text.replace("set atom", "\n".join(lines) + "\nset atom"))
            v = understood.fields["excitation"].initial(understood.fields["chain"])[1]
            assert v[0] == pytest.approx(value, rel=1e-14), (key, use)


CONTINUED = {
    "a comment joins the next line": "set atom 1 vx 0.1 # note &\nset atom 1 vx 0.2",
    "a command joins the next line": "set atom 1 &\n  vx 0.3 # note",
    "a comment": "set atom 1 vx 0.1 # set atom 1 vx 0.4",
    "quotes": "print \"set # vx\"\nset atom 1 vx '0.5'",
    "three quotes": 'print """\nset atom 1 vx 0.6\n"""',
    "sums": "velocity all set 0.1 0 0\nvelocity all set 0.2 NULL 0 sum yes\nset atom 3 vx 0",
    "two keywords": "set type 1 vx 0.7 vy 0\nset atom 2*3 vx 0",
    "a group by comparison": "group g id <> 1 2\nvelocity g set 0.8 0 0",
    "two indices": "variable v index 0.3 0.5\nvariable v index 0.4\nset atom 1 vx $v",
    "a new formula": 'variable v equal 0.3\nvariable v equal "1 + 2*(3 - 1)"\nset atom 1 vx $v',
    "a string": "variable v string 0.2\nset atom 1 vx ${v}",
    "a sum of words": "variable a string 2+1\nvariable v equal ${a}*2\nset atom 1 vx $v",
    "a formula in place of words": (
        "variable a index 2+1\nvariable a delete\nvariable a equal 2+1\n"
        "variable v equal v_a*$a*2\nset atom 1 vx $v"
    ),
    "words": 'variable a string "atom 1 vx"\nset $a 0.3',
    "a deleted index": (
        "variable v index 1\nvariable v delete\nvariable v index 9\nset atom 1 vx $v"
    ),
    "digits": "variable v equal 1/3\nset atom 1 vx ${v}\nset atom 2 vx $(v_v:%.3f)",
    "a name": "variable g string beads\nvelocity ${g} set 0.7 0 0",
    "a stride": "group g id 1:3:2\nvelocity g set 0.4 NULL NULL units box",
    "groups together": (
        "group a id < 2\ngroup b id >= 3\ngroup g union a b\ngroup h intersect g b\n"
        "velocity g set 0.1 0 0\nvelocity h set 0.2 NULL 0\nvelocity all zero angular"
    ),
    "groups that grow and shrink": (
        "group g id == 1\ngroup g id > 2\nvelocity g set 0.3 0 0\ngroup g clear\n"
        "group g id != 2\ngroup g id <= 1\nvelocity g set 0 0.4 0 sum yes\ngroup g delete"
    ),
    "groups that exist": (
        "group g id 1\ngroup b id 2\ngroup c id 2 3\ngroup g union b b\nvelocity g set 0.3 0 0\n"
        "group g subtract c b\nvelocity g set 0 0.4 0 sum yes\ngroup g intersect b c\n"
        "group g empty\nvelocity g set 0 0 0.5 sum yes"
    ),
    "stars": "set atom *1 vx 0.2\nset atom 2* vy 0.3\nset type * vz 0.1\nset group beads vz 0",
    "sizes": (
        "set atom 1 density 5000 diameter 0.02\nset atom 2 diameter 0.03 density 4000\n"
        "set atom 3 mass 0.1 x 0.02 y 0.001 z 0.002"
    ),
    "a default grain": "create_atoms 1 single 0.03 0 0.005 units box",
    "a difference of groups": "group g id 2 3\ngroup h subtract all g\nvelocity h set 0.9 0 0",
}


@pytest.mark.parametrize("name", CONTINUED)
def test_lines_are_read_as_in_lammps(name: str, tmp_path: Path):
    text = START.replace("set atom 1 vx 0.1", CONTINUED[name])
    source = tmp_path / "in.own"
    source.write_text(text, encoding="utf-8")
    source.with_name("in.lmp").write_text(text[: text.rindex("run 100")], encoding="utf-8")
    with silent_lammps() as lmp:
        lmp.file(str(source.with_name("in.lmp")))
        count = int(lmp.get_natoms())
        expected = {
            name: lmp.numpy.extract_atom(name)[:count].copy()
            for name in ("x", "v", "rmass", "radius", "type")
        }
    grains = LammpsInput(source).grains()
    assert grains.velocities.tolist() == expected["v"].tolist()
    assert grains.positions.tolist() == expected["x"].tolist()
    assert grains.types.tolist() == expected["type"].tolist()
    assert grains.masses == pytest.approx(expected["rmass"], rel=1e-14)
    assert grains.diameters == pytest.approx(2 * expected["radius"], rel=1e-14)


# Text in place of the last two lines, steps of the first and last frame, and a part of the message.
WITH_DUMP: dict[str, tuple[str, tuple[int, int], str]] = {
    "a loop": ("label a\nvariable i loop 3\nnext i\njump SELF a\nrun 100", (0, 100), ""),
    "a condition of a jump": ('if "$i > 3" then "jump SELF b"\nrun 100', (0, 100), ""),
    "a condition of an end": ("if 1>0 then quit\nrun 9", (0, 9), "commands on a condition"),
    "another jump": ("if 1>0 then 'jump SELF b' else \"print 'x'\"\nrun 9", (0, 9), ""),
    "a condition": ('if "1 > 0" then "pair_style none"\nrun 9', (0, 9), "commands on a condition"),
    "a loop of runs": ("label a\nrun 100\njump SELF a", (0, 100), r"\(jump SELF a\) is after a"),
    "a lattice": ("lattice sc 0.01\ncreate_atoms 1 box\nminimize 0 0 1 1\nrun 9", (0, 9), ""),
    "a change within": (
        "run 50\ntimestep 2e-7\nrun 50",
        (0, 100),
        r"\(timestep 2e-7\) changes the run at step 50, within the dump, .* from step 0 to 100",
    ),
    "a change before": ("run 50\ntimestep 2e-7\nrun 50", (50, 100), ""),
    "a change behind": ("run 50\nvelocity all set 0 0 0\nrun 50", (0, 50), ""),
    "a velocity within": ("run 9\nvelocity all set 0 0 0\nrun 9", (0, 18), "at step 9, within"),
    "no fix to remove": ("run 50\nunfix 7\nrun 50", (0, 100), ""),
    "an observer": ("run 50\nfix 7 all ave/time 1 1 1 v_a\nrun 50", (0, 100), ""),
    "counted anew": ("run 50\ntimestep 2e-7\nreset_timestep 0\nrun 100", (0, 100), ""),
    "a run up to a step": ("run 50\nrun 70 upto\ntimestep 2e-7\nrun 9", (0, 79), "at step 70,"),
    "a type": ("group g type 1\nrun 9", (0, 9), "depends on types, which the dump does not have"),
}
WITH_DUMP |= {
    command: (f"run 50\n{command}\nrun 50", (0, 100), "at step 50, within the dump")
    for command in (
        *("pair_style granular", "pair_coeff 1 1 hertz 1e9 0", "bond_style zero", "mass 1 2.0"),
        *("bond_coeff 1 1.0 0.01", "set atom 1 vx 0", "fix 7 all viscous 1", "unfix 1"),
        *("create_bonds single/bond 1 1 2", "displace_atoms all move 0 0 0", "read_data a.data"),
    )
}


@pytest.mark.parametrize(("text", "steps", "message"), WITH_DUMP.values(), ids=WITH_DUMP)
def test_a_dump_replaces_the_grains_of_its_input(
    text: str, steps: tuple[int, int], message: str, tmp_path: Path
) -> None:
    """Sizes come from the input if the dump has none; changes within the dump are rejected."""
    path = tmp_path / "in.own"
    path.write_text(START, encoding="utf-8")
    (tmp_path / "a.data").write_text(tapered_data(), encoding="utf-8")
    placed = LammpsInput(path).grains()
    unknown = np.full(3, math.nan)
    types = placed.types * (message[:16] != "depends on types")
    dumped = replace(placed, positions=2 * placed.positions, types=types, steps=steps)
    lines = START.replace("timestep 1e-7\nrun 100", f"set atom 1 density 7000\n{text}")
    path.write_text(lines, encoding="utf-8")
    if message:
        with pytest.raises(InputError, match=message):
            LammpsInput(path, dumped)
        return
    grains = LammpsInput(path, dumped).grains()
    assert grains.positions.tolist() == dumped.positions.tolist()
    assert grains.velocities.tolist() == placed.velocities.tolist()
    assert grains.masses == pytest.approx(MASS, rel=1e-14)
    bare = replace(dumped, diameters=unknown, masses=unknown)
    lines = lines.replace("set atom 1 density", "set atom * diameter 0.01 density")
    path.write_text(lines, encoding="utf-8")
    grains = LammpsInput(path, bare).grains()
    assert grains.diameters.tolist() == [0.01] * 3
    assert grains.masses == pytest.approx(MASS * 7000 / 7800, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "steps", "factor"),
    [
        ("run 50\n{change}\nrun 50", (0, 50), 1),
        ("run 50\n{change}\nrun 50", (50, 100), 2),
        ("run 50\n{change}\nreset_timestep 0\nrun 30", (0, 50), 1),
        ("run 50\n{change}\nreset_timestep 0\nrun 30", (0, 30), 2),
        ("run 50\n{change}\nrun 50\nreset_timestep 0\nrun 60", (0, 50), 2),
        ("run 50\nreset_timestep 0\n{change}\nrun 30\nrun 30", (30, 60), 2),
        ("run 50\nreset_timestep 0\nrun 50\n{change}\nrun 50\nreset_timestep 9", (0, 50), 1),
        ("run 50\nrun 50\n{change}", (0, 100), 1),
    ],
)
def test_forces_are_those_of_the_run_that_wrote_the_dump(
    text: str, steps: tuple[int, int], factor: int, tmp_path: Path
) -> None:
    """The change doubles the stiffness and the time step."""
    path = tmp_path / "in.own"
    path.write_text(START, encoding="utf-8")
    dumped = replace(LammpsInput(path).grains(), steps=steps, duration=math.nan)
    change = "timestep 2e-7\npair_coeff * * hertz 2e10 0"
    lines = START.replace("run 100", text.format(change=change))
    path.write_text(lines, encoding="utf-8")
    source = LammpsInput(path, dumped)
    fields = infer_scene(source.grains(), source).fields
    assert fields["chain"].contact_constants == pytest.approx(factor * STIFF, rel=1e-14)
    assert fields["duration"] == pytest.approx(factor * 1e-7 * (steps[1] - steps[0]), rel=1e-14)


def test_default_time_steps_are_those_of_lammps(tmp_path: Path):
    from lmpchain.scene.lammps_input import DEFAULT_STEPS

    for style, step in DEFAULT_STEPS.items():
        with silent_lammps(f"units {style}") as lmp:
            assert lmp.extract_global("dt") == step
    without = read(tmp_path, START.replace("timestep 1e-7\n", ""))
    assert without.fields["duration"] == pytest.approx(1e-6)


FORCES = {
    "hertz": ("hertz 1e8 0 {t}", "hertz 4e8 0 {t}"),
    "hertz/material": ("hertz/material 2e9 0 0.3 {t}", "hertz/material 7e8 0 0.33 {t}"),
    "hooke": ("hooke 1e5 0 {t}", "hooke 3e5 0 {t}"),
}


@pytest.mark.parametrize("model", FORCES)
@pytest.mark.parametrize("pair", [(1, 1), (1, 2), (2, 2)])
def test_forces_agree_with_lammps(model: str, pair: tuple[int, int], tmp_path: Path):
    """LAMMPS may mix the coefficients of two types, and grains may have unequal sizes."""
    t = "tangential linear_nohistory 0 0 damping velocity"
    one, other = (text.format(t=t) for text in FORCES[model])
    text = START.replace("create_box 1", "create_box 2")
    text = text.replace("pair_coeff * *", "#")
    text = text.replace("create_atoms 1 single 0.0 ", f"create_atoms {pair[0]} single 0.0 ")
    text = text.replace("1 single 0.0099999", f"{pair[1]} single 0.0099999")
    text = text.replace("1 single 0.0199998", f"{pair[1]} single 0.0199998")
    text = text.replace("density 7800", "density 7800\nset atom 1 diameter 0.0101 density 7000")
    text = text.replace("group beads", f"pair_coeff 1 1 {one}\npair_coeff 2 2 {other}\ngroup beads")
    chain = read(tmp_path, text).fields["chain"]
    overlap = 0.01005 - 0.0099999
    force = chain.law.force(overlap, chain.contact_constants[0])
    lines = text.replace("run 100", "run 0").replace("units si\n", "units si\nnewton off\n")
    lines = lines.replace("timestep", "comm_modify vel yes\nneighbor 0.003 bin\ntimestep")
    with silent_lammps(lines) as lmp:
        assert -lmp.numpy.extract_atom("f")[0, 0] == pytest.approx(force, rel=1e-9)


COEFFICIENTS = {  # Words after pair_coeff, and for a wall: stiffness k and damping eta in SI units.
    "hertz": "hertz {k} {eta} tangential linear_history 0 0 0 damping viscoelastic",
    "hertz by default": "hertz {k} {eta} rolling none tangential linear_nohistory 0 0",
    "material": "hertz/material {k} {eta} 0.3 tangential mindlin NULL 0 0 twisting none",
    "springs": "hooke {k} {eta} tangential linear_nohistory 0 0 damping mass_velocity heat none",
    "springs by velocity": "hooke {k} {eta} rolling sds 0 0 0 damping velocity",
    "old": "gran/hertz/history {k} NULL {eta} NULL 0 0",
    "old springs": "gran/hooke {k} NULL {eta} NULL 0 0",
    "old springs with history": "gran/hooke/history {k} NULL {eta} NULL 0 0",
}
SCALES = {"si": (1.0, 1.0, 1.0), "cgs": (1e-2, 1.0, 1e-3), "micro": (1e-6, 1e-6, 1e-15)}


@pytest.mark.parametrize("units", SCALES)
@pytest.mark.parametrize("name", COEFFICIENTS)
def test_coefficients_are_converted_from_the_units_of_the_input(
    name: str, units: str, tmp_path: Path
) -> None:
    """Contacts have k sqrt(R) and eta m / 1.5 k, or k and eta m / k, of R = d/4 and half a mass.

    A wall has R = d/2 and the whole mass, so that half of eta gives it the same relaxation time.
    """
    length, time, mass = SCALES[units]
    spring, velocity = "springs" in name, name == "springs by velocity"
    k, eta = (1e5, 70.0) if spring else (2e9, 7e4)
    if spring:
        words = [k * time**2 / mass, eta * time / (mass if velocity else 1.0)]
    else:
        words = [k * length * time**2 / mass, eta * length * time]
    pair, wall = (
        COEFFICIENTS[name].format(k=repr(words[0]), eta=repr(words[1] * share))
        for share in (1.0, 1.0 if velocity else 0.5)
    )
    old = name.startswith("old")
    forces = f"pair_style {pair}\n" if old else f"pair_style granular\npair_coeff * * {pair}\n"
    wall = wall.removeprefix("gran/") if old else f"granular {wall}"
    push, pull = 1.5 * time**2 / (mass * length), 9.81 * time**2 / length
    lines = [
        *(f"units {units}", "atom_style sphere", "region box block -1e6 1e6 -1e6 1e6 -1e6 1e6"),
        *("boundary f f f", "create_box 1 box"),
        *(f"create_atoms 1 single {x / length!r} 0 0" for x in (0.0, 0.0099999, 0.0199998)),
        f"set group all diameter {0.01 / length!r} density {7800 * length**3 / mass!r}",
        *(forces, "fix 1 all nve/sphere", "group t id 1", f"fix 2 t addforce {push!r} 0 0"),
        f"fix 3 all gravity {pull!r} vector 1 0 0",
        f"fix 4 all wall/gran {wall} xplane NULL {0.0249997 / length!r}",
        f"set atom 1 vx {0.1 * time / length!r}",
        *(f"fix 5 all viscous {0.2 * time / mass!r}", f"timestep {1e-7 / time!r}", "run 100"),
    ]
    scene = Scene(**read(tmp_path, "\n".join(lines)).fields)
    chain = scene.chain
    if name == "material":
        assert chain.given()["material"].youngs_modulus == pytest.approx(k, rel=1e-12)
        k *= 4 / 3 / (2 * (1 - 0.3**2))
    roots = [0.05, 0.05, math.sqrt(0.005)] if not spring else [1.0] * 3
    assert chain.contacts.constant[1:] == pytest.approx([k * root for root in roots], rel=1e-12)
    assert chain.exponent == (1.0 if spring else 1.5)
    heavy = 1.0 if velocity else MASS / 2
    relaxation = eta * heavy / k / (1 if spring else 1.5)
    assert chain.damping.viscoelastic == pytest.approx(relaxation, rel=1e-12)
    assert chain.drag == pytest.approx(0.2 / MASS, rel=1e-12)
    assert chain.masses == pytest.approx(MASS, rel=1e-11)
    assert chain.diameters == pytest.approx(0.01, rel=1e-12)
    assert (chain.top_load, chain.gravity) == pytest.approx((1.5, 9.81), rel=1e-12)
    assert scene.duration == pytest.approx(1e-5, rel=1e-12)
    assert scene.initial()[1] == pytest.approx([0.1, 0.0, 0.0], rel=1e-12, abs=0)
    below = 1e-7 - (1.5 + 3 * WEIGHT) ** (1 / chain.exponent) / (k * roots[2]) ** (
        1 / chain.exponent
    )
    assert scene.initial()[0][-1] == pytest.approx(below, rel=1e-6)


BONDS = """units {units}
atom_style bond
boundary f f f
region box block -100 100 -100 100 -100 100
create_box 1 box bond/types 3
{atoms}
mass 1 {mass}
bond_style harmonic
{coefficients}
create_bonds single/bond 1 1 2
create_bonds single/bond 2 2 3
create_bonds single/bond 3 4 3
group free id 1:3
fix 1 free nve
set atom 1 vx 0.1
timestep 1e-6
run 100
"""


def bonds(units: str, lengths: list[float], mass: str = "1e-3") -> str:
    """Return an input of bonds with these lengths, and with 500, 700 and 600 in its units."""
    places = np.concatenate([[0.0], np.cumsum(lengths)]).tolist()
    rows = zip((500.0, 700.0, 600.0), lengths, strict=True)
    return BONDS.format(
        units=units,
        mass=mass,
        atoms="\n".join(f"create_atoms 1 single {x!r} 0 0" for x in places),
        coefficients="\n".join(f"bond_coeff {n} {k} {d!r}" for n, (k, d) in enumerate(rows, 1)),
    )


@pytest.mark.parametrize(("units", "length", "mass"), [("si", 1.0, 1.0), ("cgs", 1e-2, 1e-3)])
@pytest.mark.parametrize("lengths", [[0.01, 0.012, 0.011], [0.01, 0.019, 0.01], [0.01] * 3])
def test_rest_lengths_of_bonds_are_distances_of_touching_grains(
    units: str, length: float, mass: float, lengths: list[float], tmp_path: Path
) -> None:
    """Bonds of the energy K (r - r0)^2 have the stiffness 2 K."""
    chain = read(tmp_path, bonds(units, lengths)).fields["chain"]
    assert chain.contact_lengths[1:-1] == pytest.approx(np.multiply(lengths, length), rel=1e-12)
    assert chain.diameters.min() > 0
    assert chain.masses == pytest.approx(1e-3 * mass, rel=1e-14)
    pull = -2e-4 * mass * np.array([1000.0, 1400.0, 1200.0])
    assert chain.law.force(-2e-4, chain.contact_constants) == pytest.approx(pull, rel=1e-12)


def test_bonded_spheres_keep_diameters_that_agree_with_their_bonds(tmp_path: Path) -> None:
    text = bonds("si", [0.01, 0.012, 0.011]).replace("style bond", "style hybrid sphere bond")
    for last, kept in ((0.009, True), (0.0091, False)):
        sizes = [0.009, 0.011, 0.013, last]
        lines = [f"set atom {n} diameter {d} density 2500" for n, d in enumerate(sizes, 1)]
        spheres = text.replace("mass 1 1e-3", "\n".join(lines))
        chain = read(tmp_path, spheres).fields["chain"]
        assert (chain.diameters.tolist() == sizes) == kept
        assert chain.contact_lengths[1:-1] == pytest.approx([0.01, 0.012, 0.011], rel=1e-12)
        masses = 2500 * math.pi / 6 * np.array(sizes) ** 3
        assert chain.masses == pytest.approx(masses, rel=1e-13)


@pytest.mark.parametrize(
    ("words", "pairs"),
    [
        ("e o 1 0.0105 0.0125", [(2, 3), (3, 4)]),
        ("o e 2 0.0105 0.04", [(1, 4), (2, 3), (3, 4)]),
        ("all all 1 0.0099 0.0225", [(1, 2), (1, 3), (2, 3), (3, 4)]),
        ("e e 3 0.0 1.0", [(1, 3)]),
    ],
)
def test_bonds_within_a_distance_join_two_groups(
    words: str, pairs: list[tuple[int, int]], tmp_path: Path
) -> None:
    """The four atoms are at 0, 10, 22 and 33 mm; the groups are the odd and the even ones."""
    text = bonds("si", [0.01, 0.012, 0.011])
    head, _, tail = text.partition("create_bonds single/bond 1 1 2\n")
    path = tmp_path / "in.own"
    groups = "group e id 1 3\ngroup o id 2 4\n"
    path.write_text(f"{head}{groups}create_bonds many {words}\n{tail[tail.index('group') :]}")
    found = LammpsInput(path).state.bonds
    assert sorted((bond.first, bond.second) for bond in found) == pairs
    assert {bond.kind for bond in found} == {int(words.split()[2])}


def test_impossible_bonds_are_rejected(tmp_path: Path) -> None:
    text = bonds("si", [0.01, 0.012, 0.011])
    for changed, message in (
        (bonds("si", [0.01, 0.02, 0.01]), "rest lengths that are impossible in a row"),
        (text.replace("bond_coeff 1 500.0 0.01", "bond_coeff 1 500.0 0.0"), "not above 0"),
        (text.replace("mass 1 1e-3", ""), "bonds grains without a mass"),
        (text.replace("mass 1 1e-3", "mass 1 0"), "bonds grains without a mass"),
        (text.replace("bond_coeff 2 700.0 0.012", "bond_coeff 2 700.0"), "has no readable bond_co"),
        (text.replace("bond 3 4 3", "bond 3 4 9"), "names a grain that does not exist"),
        (text.replace("single/bond 3", "some 3"), "is not read: use many or single/bond"),
        *(
            (f"{text}create_bonds {words}\nrun 1\n", "is not read: use many or single/bond")
            for words in ("many all all 1 0.009", "some all all 1 0.009 0.011", "single/bond 1 2")
        ),
    ):
        with pytest.raises(InputError, match=message):
            read(tmp_path, changed)


def test_a_formula_of_bonds_is_converted_from_the_units_of_the_input(tmp_path: Path):
    """The energy k r^2 / 2 + a r^4 in erg, of r in cm, has the force k r + 4 a r^3 in dyn."""
    chain = read(tmp_path, INPUTS["lepton"].replace(" si\n", " cgs\n")).fields["chain"]
    overlap = np.array([1e-7, 1e-5, 1e-3])
    r = overlap / 1e-2
    force = chain.law.force(overlap, chain.contact_constants[0])
    assert force == pytest.approx(1e-5 * (1e3 * r + 4e9 * r**3), rel=1e-12)
    assert chain.masses == pytest.approx(1e-6, rel=1e-14)
    assert chain.diameters == pytest.approx(1e-4, rel=1e-12)


def test_bonds_need_neighbours_and_one_law(tmp_path: Path):
    text = INPUTS["lepton"].replace("create_bonds    many all all 1 0.009 0.011", "{bonds}")
    row = "\n".join(f"create_bonds single/bond 1 {n} {n + 1}" for n in range(1, 10))
    cases = {
        "create_bonds single/bond 1 1 3": "bonds atoms 1 and 3, which are not neighbours",
        f"{row}\ncreate_bonds single/bond 1 1 2": "bonds atoms 1 and 2 twice",
        row[: row.rindex("\n")]: "has no readable bond between atom 9 and atom 10",
        row.replace("1 1 2", "2 1 2"): "has no readable bond_coeff for type 2",
        f'{row}\nbond_coeff 1 0.01 "r^2 + __import__(1)"': "has a formula that is not understood",
        f'{row}\nbond_coeff 1 0.01 "r^2 + q"': "has a formula with q, which is not defined",
        f'{row}\nbond_coeff 1 0.01 "r^2^2"': "has a power of a power: add brackets",
        f'{row}\nbond_coeff 1 0.01 "3; q=2*r"': "does not define a contact law: depends on neither",
        f'{row}\nbond_coeff 1 0.01 "r/0"': "has a formula that is not understood: divides by 0",
        f"{row}\npair_style granular": "acts in addition to bonds",
    }
    for bonds, message in cases.items():
        with pytest.raises(InputError, match=message):
            read(tmp_path, text.format(bonds=bonds))
    chain = read(tmp_path, text.format(bonds=row)).fields["chain"]
    o = np.array([-2e-3, 1e-3])
    assert chain.law.force(o, 1.0) == pytest.approx(1000 * o + 4e9 * o**3, rel=1e-12)


# Words of hostile lines.
WORDS = ["NULL", "-1", "1e400", "nan", "*", "$x", "${", "$(", "$(1/0)", '"', "'", '"""', "&", "#"]
WORDS += ["all", "0", "99999999999999999999", "1*", "v_v", "\x00", "µ", "x" * 5000]
WORDS += ["1:2:0", "(" * 60]


def mutated(random_: random.Random, text: str) -> str:
    """Return a text with a few of its lines damaged."""
    lines = text.split("\n")
    for _ in range(random_.randint(1, 3)):
        n = random_.randrange(len(lines))
        words = lines[n].split(" ")
        kind = random_.randrange(6)
        if kind == 0:
            words[random_.randrange(len(words))] = random_.choice(WORDS)
        elif kind == 1:
            del words[random_.randrange(len(words)) :]
        elif kind == 2:
            words.insert(random_.randrange(len(words) + 1), random_.choice(WORDS))
        elif kind == 3:
            words = lines[random_.randrange(len(lines))].split(" ")
        elif kind == 4:
            letters = list(lines[n] or " ")
            letters[random_.randrange(len(letters))] = chr(random_.randrange(256))
            words = ["".join(letters)]
        else:
            del lines[n]
            continue
        lines[n] = " ".join(words)
    return "\n".join(lines)


def attempts(paths: list[Path], options: RunOptions | None) -> bool:
    """Return whether files give a scene, and not an error with a message."""
    try:
        scene_of_run(paths, options)
    except LmpchainError:
        return False
    return True


@pytest.mark.timeout(600)
def test_damaged_files_are_scenes_or_faults_of_one_line(tmp_path: Path) -> None:
    """Damaged inputs, data files and dumps cause neither a traceback nor a hang."""
    random_ = random.Random(61)
    texts = [text for name, text in INPUTS.items() if name != "column"] + [START, tapered_data()]
    path = tmp_path / "in.own"
    of_data = RunOptions(duration=1e-4, young=1e9, poisson=0.3)
    made = []
    for _ in range(200):
        text = random_.choice(texts)
        path.write_text(mutated(random_, text), encoding="utf-8")
        (tmp_path / "tapered.data").write_text(tapered_data(), encoding="utf-8")
        made.append(attempts([path], of_data if text is texts[-1] else None))
    dump = tmp_path / "damaged.lammpstrj"
    frames = run_input(tmp_path, LEVEL).read_text(encoding="utf-8").split("ITEM: TIMESTEP")
    text = "ITEM: TIMESTEP".join(frames[:4])
    of_dump = RunOptions(material="steel", timestep=1e-7)
    for _ in range(120):
        dump.write_text(mutated(random_, text), encoding="utf-8")
        made += [attempts([dump], of_dump), attempts([dump, path], None)]
    # Damage to comments and output leaves a valid scene.
    assert 20 < sum(made) < len(made) - 20


def test_a_refusal_is_one_line_and_exit_code_2(tmp_path: Path, capsys):
    path = tmp_path / "in.own"
    path.write_text(LEVEL.replace("thermo ", "fix 9 all langevin 1 1 1 3\nthermo "), "utf-8")
    assert main(["new", str(tmp_path / "s.toml"), "--from", str(path)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert "(fix 9 all langevin 1 1 1 3) is a fix that is not understood" in said.err
    assert not (tmp_path / "s.toml").exists()
    command = ["new", str(tmp_path / "s.toml"), "--from", str(path)]
    assert main([*command, "--example", "dimer"]) == 2
    assert "example: cannot be combined with --from" in capsys.readouterr().err
    assert main([*command[:-1], str(tmp_path), "nothing.in"]) == 2
    assert "is a folder; name a file in it" in capsys.readouterr().err
    assert main(["new", str(tmp_path / "s.toml"), "--material", "steel"]) == 2
    assert "material: is only for --from: leave it out" in capsys.readouterr().err
