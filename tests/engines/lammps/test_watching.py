"""User commands in a run folder: they continue after every stop, or are rejected by name."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import struck

from lmpchain import Damping, InputError, Stopped, resume, simulate
from lmpchain.engines import Lammps
from lmpchain.engines.lammps.stepper import LammpsStepper
from lmpchain.engines.stepping import time_stepping as stepping_run

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
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    options = {"integrator": "verlet", "step": 1e-7, "diameter": "physical", "ranks": ranks}
    engine = Lammps(**options, include="../my.include")
    whole = simulate(SCENE, engine, folder="../whole")
    (tmp_path / "empty").mkdir()
    monkeypatch.setattr(stepping_run, "BLOCK_S", 1e-9)
    at = tmp_path / "run"
    for attempt in itertools.count():
        limit = None if attempt == 4 else 1e-9
        try:
            if attempt == 0:
                simulate(SCENE, engine, folder=at, max_wall=limit)
            (tmp_path / "my.include").unlink(missing_ok=True)
            monkeypatch.chdir(tmp_path / "empty")
            answer = resume(at, max_wall=limit)
            break
        except Stopped:
            continue
    plain = simulate(SCENE, Lammps(**options))
    for field in ("displacement", "velocity"):
        assert np.array_equal(getattr(answer, field)[:], getattr(plain, field))
        assert np.array_equal(getattr(whole, field)[:], getattr(plain, field))
    for name in ("mine.dump", "energy.txt", "said.txt"):
        parts = [frames(at / f"output-{n}" / name) for n in range(1, 6)]
        assert all(parts)
        wanted = frames(tmp_path / "whole" / "output-1" / name)
        merged: dict[str, str] = {}
        for part in parts:
            for step, frame in part.items():
                assert frame == wanted[step]
            merged |= part
        assert merged == wanted
    assert not list((tmp_path / "elsewhere").iterdir())
    assert not list((tmp_path / "empty").iterdir())


@pytest.mark.parametrize(
    ("command", "named"),
    [
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
    ],
)
def test_commands_that_may_move_grains_are_rejected_by_name(
    command: str, named: str, tmp_path: Path
):
    engine = Lammps("verlet", 1e-7, include=f"compute e all ke\n{command}\n")
    with pytest.raises(InputError, match=named) as refused:
        simulate(SCENE, engine, folder=tmp_path / "run")
    assert str(refused.value).startswith("include: line 2 (")
    assert not (tmp_path / "run").exists()


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
