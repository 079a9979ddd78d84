"""User commands in a run folder: they continue after every stop, or are rejected by name."""

import re
from pathlib import Path

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import struck

from lmpchain import Damping, InputError, Law, Stopped, resume, simulate
from lmpchain.engines import Lammps
from lmpchain.engines.lammps import deck
from lmpchain.engines.lammps.column import LammpsColumn
from lmpchain.engines.lammps.stepper import LammpsStepper
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.integrators.methods import VERLET

TEMPLATES = Path(__file__).parents[3] / "templates"

SCENE = struck(column(8, damping=Damping(viscoelastic=1e-8)), 1e-3, 2e-5, 41)
INCLUDE = """compute   energy all ke   # with a comment
variable  twice equal 2.0*c_energy
fix       average all ave/time 1 1 5 c_energy v_twice &
          file energy.txt
fix       said all print 5 "file said.txt: $(step) ${twice}" file said.txt screen no
dump      mine all custom 5 mine.dump id z vz
dump_modify mine format float %.17g sort id
thermo_style custom step ke
thermo    10
"""


def frames(path: Path) -> dict[str, str]:
    """Return frames of a dump, or lines of a table, by step."""
    text = path.read_text()
    if path.suffix == ".dump":
        found = text.split("ITEM: TIMESTEP\n")[1:]
        return {frame.split("\n")[0]: frame for frame in found}
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    place = 2 if path.name == "said.txt" else 0
    return {line.split()[place]: line for line in lines}


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_outputs_continue_after_a_stop(ranks: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "my.include").write_text(INCLUDE)
    for folder in ("elsewhere", "empty"):
        (tmp_path / folder).mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    options = {"integrator": "verlet", "step": 1e-7, "diameter": "physical", "ranks": ranks}
    engine = Lammps(**options, include="../my.include")
    whole = simulate(SCENE, engine, folder="../whole")
    monkeypatch.setattr(stepping_run, "BLOCK_S", 1e-9)
    at = tmp_path / "run"
    with pytest.raises(Stopped):
        simulate(SCENE, engine, folder=at, max_wall=1e-9)
    (tmp_path / "my.include").unlink()
    monkeypatch.chdir(tmp_path / "empty")
    for _ in range(3):
        with pytest.raises(Stopped):
            resume(at, max_wall=1e-9)
    answer = resume(at)
    plain = simulate(SCENE, Lammps(**options))
    for field in ("displacement", "velocity"):
        assert np.array_equal(getattr(answer, field)[:], getattr(plain, field))
        assert np.array_equal(getattr(whole, field)[:], getattr(plain, field))
    for name in ("mine.dump", "energy.txt", "said.txt"):
        parts = [frames(at / f"output-{n}" / name) for n in range(1, 6)]
        assert all(parts)
        wanted = frames(tmp_path / "whole" / "output-1" / name)
        assert all(frame == wanted[step] for part in parts for step, frame in part.items())
        assert {step for part in parts for step in part} == set(wanted)
    assert not list((tmp_path / "elsewhere").iterdir())
    assert not list((tmp_path / "empty").iterdir())


def test_commands_that_may_move_grains_are_rejected_by_name(tmp_path: Path):
    engine = Lammps("verlet", 1e-7, include="compute e all ke\nfix more all nve\n")
    with pytest.raises(InputError, match=r"^include: line 2 \(.* the fix nve"):
        simulate(SCENE, engine, folder=tmp_path / "run")
    assert not (tmp_path / "run").exists()


WATCHING = """
# velocity all set 0 0 1
compute   top_speed all reduce max vz # velocity
compute_modify e dynamic/dof no
compute   moving mobile ke
dump      a all atom 5 a-*.dump
dump      c all custom 5 &
          c.dump id vz
dump      i all image 5 i.%.png type type
dump_modify c sort id
fix       a all ave/chunk 1 1 5 c vz file chunk.txt
fix       h all ave/histo 1 1 5 0 1 9 c_e mode vector ave one file histo.txt
fix       p all print 5 'at ${my_time}' append said.txt
group     upper id 1 2
group     fast dynamic all var quick every 5
print     "${my_time} $(step)" file once.txt
print     lost
thermo    5
thermo_modify line one
thermo_style custom step ke
variable  my_time equal time
variable  squares atom vz^2
variable  list index 1 2
variable  text string "a b"
variable  v vector [1,2]
variable  f format my_time %g
"""
CHANGING = [
    ("fix more all nve", "the fix nve"),
    ("fix hold all setforce 0 0 0", "the fix setforce"),
    ("fix all all vector 1 c_energy", "the fix vector"),
    ("fix a all ave/time 1 1 5 c_e ave running file a.txt", "use ave one"),
    ("fix motion all print 5 hello", "the name motion"),
    ("variable g equal 0", "the name g"),
    ("variable z equal $(x[1])", "the state at the start"),
    ("variable z python f", "another program"),
    ("compute far all msd", "the compute msd"),
    ("velocity all set 0 0 1", "the command velocity"),
    ("shell rm -r /", "the command shell"),
    ("timestep 1", "the command timestep"),
    ("include other", "the command include"),
    ("dump d all custom 5 /tmp/d.dump id", "give a plain file name"),
    ("dump d all custom 5 ../d.dump id", "give a plain file name"),
    ('print "x" file "a b"', "give a plain file name"),
    ("dump d all movie 5 d.mp4 type type", "the dump movie"),
    ("dump d all custom 5 d.gz id", "give a plain file name"),
    ("fix p all print 5 hello ${key} /tmp/hello", "contains the variable"),
    ('print "x" "append" /tmp/x', "give a plain file name"),
    ("thermo_modify lost ignore", "lost grains"),
    ('print "x', "quotes that are not closed"),
    ("print 'x", "quotes that are not closed"),
    ('print """x"""', "triple quotes"),
    *((f"compute c all {style}", f"the compute {style}") for style in (
        "msd/chunk", "vacf", "displace/atom", "fep", "born/matrix"
    )),
    ("compute $x all ke", r"the name \$x"),
    ("fix f all", "has the fix "),
    # LAMMPS removes quotes.
    ('variable "ground" atom 0', "the name ground"),
    ("fix 'motion' all print 5 hello", "the name motion"),
    ('fix a all ave/time 1 1 5 c_e ave "running"', "use ave one"),
    ('thermo_modify "lost" ignore', "lost grains"),
    ("thermo_modify lost/bond ignore", "lost grains"),
    # Values at the definition would be others after a stop.
    ("variable z equal 2*${twice}", "the state at the start"),
    ("group fast variable quick", "the state at the start"),
    ("group fast region above", "the state at the start"),
    ("compute c all chunk/atom v_quick ids once", "the state at the start"),
    ("fix a all ave/time 1 1 5 c_e ave window 3", "use ave one"),
    ("variable z file numbers.txt", "from a file"),
    ("variable z getenv HOME", "another program"),
    ("variable z internal 0", "the state at the start"),
    *((f"dump d all custom 5 {name} id", "give a plain file name") for name in (
        "d.bz2", "d.lz4", "d.lzma", "d.xz", "d.zst", "..", "~/d", "a/d", '"a d"'
    )),
    ("dump d all custom 5 ${name} id", "contains the variable"),
    ("print $x", "contains the variable"),
    ("print x file a&b", "give a plain file name"),
]  # fmt: skip


def test_only_commands_that_watch_are_allowed():
    assert deck.find_fault(WATCHING) == ""
    lines = deck.move_outputs(WATCHING, Path("/at"))
    files = ["a-*.dump", "c.dump", "i.%.png", "chunk.txt", "histo.txt", "said.txt", "once.txt"]
    assert re.findall(r'"/at/"?(.*?)"', lines.replace("'", '"')) == files
    assert lines.count("/at/") == len(files)
    for command, reason in CHANGING:
        assert re.search(f"line 2 .* {reason}", deck.find_fault(f"thermo 5\n{command}\n"))


def test_no_name_of_the_set_up_is_allowed():
    """A second definition of a variable would replace a force of the ground or of viscosity."""
    law = Law("k*max(o, 0)**1.5*(1 + c*o)", k=1e9, c=1e4)
    chain = column(8, damping=SCENE.chain.damping, law=law, top="wall")
    made = LammpsColumn(SCENE.replace(chain=chain), 0.0)
    text = (TEMPLATES / "setup.column").read_text() + deck.script(made, 1e-7, VERLET)
    commands = re.findall(r"\n(compute|fix|group|region|variable) +(\w+) ", text)
    names = {name for _, name in commands}
    assert {"ground", "now_at", "viscous", "sum_odd", "of_even", "at_top", "wall_z", "v0"} < names
    for name in names - {"dump"}:
        for command in (
            "compute {} all ke",
            "fix {} all print 5 x",
            "group {} id 1",
            "variable {} equal 1",
        ):
            assert f"has the name {name}, which" in deck.find_fault(command.format(name))


def test_the_first_piece_of_work_is_sized_for_lammps(monkeypatch: pytest.MonkeyPatch):
    """LAMMPS advances some 1e6 grains by a step per second, and a stop waits for a chunk."""
    asked = []
    fill = LammpsStepper.fill

    def note(self, u, v, offset, until, max_steps):
        asked.append(max_steps)
        return fill(self, u, v, offset, until, max_steps)

    monkeypatch.setattr(LammpsStepper, "fill", note)
    simulate(SCENE, Lammps("verlet", 1e-7))
    assert 1e2 < asked[0] <= 0.1 * 1e7 / SCENE.chain.grains
