"""Decks with user templates and includes, and text that must not enter a deck."""

import filecmp
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_output import SCENE, keys, names
from helpers.example_scenes import scene_of
from helpers.independent_integrators import distance
from helpers.standalone_lammps import lmp, small
from helpers.thinned import thinned

from lmpchain import (
    Chain,
    EngineUnavailable,
    Impulse,
    InputError,
    Scene,
    ToleranceNotMet,
    Trajectory,
    simulate,
)
from lmpchain.cli.command_line import main
from lmpchain.engines import Lammps
from lmpchain.engines.lammps.export import write_deck

TEMPLATES = Path(__file__).parents[3] / "templates"
VERLET = {"integrator": "verlet", "step": 1e-7, "diameter": "physical"}
INCLUDE = """# {{ no placeholder }} {% nor a block %} Größe
compute         energy all ke
fix             average all ave/time 1 1 10 c_energy file energy.txt
dump            mine all custom 10 mine.dump vz id z x y
dump_modify     mine format float %.17g
"""
TEMPLATE = """# {{ column.chain.grains }} grains of my own
{% macro in_us(time) %}{{ (1e6 * time) | round(3) }} us{% endmacro %}
# steps of {{ in_us(step) }}
{% include "setup.column" %}
fix             axis all setforce 0.0 0.0 NULL    # changes nothing
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to a new folder, because LAMMPS writes the files of an include to the current one."""
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(SCENE)
    Path("my.include").write_text(INCLUDE)
    Path("my.template").write_text(TEMPLATE + '{% include "run.column" %}\n')
    return tmp_path


# --- includes


@pytest.mark.parametrize("ranks", thinned([1, 2], 2))
def test_an_include_works_in_the_library(ranks: int):
    plain = simulate(small(), engine=Lammps(**VERLET))
    t = simulate(small(), engine=Lammps(**VERLET, include="my.include", ranks=ranks))
    assert np.array_equal(t.displacement, plain.displacement)
    assert t.provenance["include"] == INCLUDE
    # The file contains every 10th step, so that it contains every sample.
    every = t.cost.steps // 50
    energy = np.loadtxt("energy.txt")[::every, 1]
    assert energy == pytest.approx(0.5 * (t.velocity**2) @ t.scene.chain.masses, rel=1e-5)
    mine = Trajectory.from_dump("mine.dump", small().replace(samples=t.cost.steps // 10 + 1))
    assert np.array_equal(mine.velocity[::every], t.velocity)


RENEWED = "neigh_modify once no every 1 delay 0 check no\n"


@pytest.mark.parametrize(
    ("commands", "ranks"),
    [
        (f"{RENEWED}atom_modify sort 1 1e-3\n", 1),
        pytest.param(RENEWED, 2, marks=pytest.mark.slow),
        pytest.param("balance 1.0 shift z 10 1.0001\n", 2, marks=pytest.mark.slow),
    ],
)
def test_an_include_that_reorders_the_grains_is_rejected(commands: str, ranks: int):
    Path("order.include").write_text(commands)
    # The middle grain moves up to the other rank.
    chain = Chain(grains=31, top_load=10.0, material="steel", diameter=5e-3)
    scene = scene_of(chain, Impulse(velocity=-0.1, grain=16), 5e-5, 11)
    with pytest.raises(EngineUnavailable, match="changed the order of the grains: leave out"):
        simulate(scene, Lammps(**VERLET, include="order.include", ranks=ranks))


@pytest.mark.parametrize("integrator", ["verlet", "kahan-li6"])
def test_the_clock_of_lammps_continues_after_a_stop(integrator: str):
    """A user's force that depends on time is equal for chunks of any size."""
    Path("clock.include").write_text("print           $(time:%.17g) append clock.txt screen no\n")
    engine = Lammps(integrator=integrator, step=1e-7, include="clock.include")
    scene = small()
    candidate = engine.propose(scene, 1.0)
    state: dict[str, Any] = {}
    for _ in range(2):
        stepper = engine.stepper([scene], candidate, [candidate.steps], state)
        u, v = np.zeros((2, 1, scene.samples, scene.chain.grains))
        stepper.fill(u, v, 0, scene.intervals, 7)
        state = stepper.state()
        stepper.close()
    # The clock starts at exactly 0.
    assert np.loadtxt("clock.txt") == pytest.approx([0.0, 7 * candidate.step], rel=1e-12)


def test_an_include_is_copied_to_the_deck_unchanged():
    write_deck(small(), "deck", step=1e-7, include="my.include")
    text = Path("deck/in.column").read_text()
    assert INCLUDE in text
    lmp(Path("deck"))
    assert names(Path("deck")) == [
        "column.data", "column.lammpstrj", "energy.txt", "in.column", "log.lammps", "mine.dump",
    ]  # fmt: skip
    simulate(small(), engine=Lammps(**VERLET, include="my.include", keep="kept"))
    assert filecmp.cmp("deck/in.column", "kept/in.column", shallow=False)
    assert filecmp.cmp("deck/column.lammpstrj", "kept/column.lammpstrj", shallow=False)
    assert filecmp.cmp("deck/mine.dump", "mine.dump", shallow=False)


def test_an_include_that_changes_the_motion_causes_an_error():
    Path("my.include").write_text("fix drag all viscous 1e-3\n")
    t = simulate(small(), engine=Lammps(**VERLET | {"step": 1e-8}, include="my.include"))
    error = distance(t, simulate(small(), "native", 1e-9))
    assert t.error_estimate.total == pytest.approx(error, rel=0.1)
    assert error > 1e-3
    suspect = "^the commands of your include may move .*: run without them to compare; the error"
    with pytest.raises(ToleranceNotMet, match=suspect):
        simulate(small(), engine=Lammps(include="my.include"))
    Path("my.include").write_text("compute ke all ke\n")
    assert simulate(small(), engine=Lammps(include="my.include")).error_estimate.total < 1e-6


# --- templates


def test_the_template_of_the_package_is_a_valid_user_template():
    shutil.copy(TEMPLATES / "in.column", "my.template")
    write_deck(small(), "own", step=1e-7, template="my.template")
    write_deck(small(), "ours", step=1e-7)
    assert filecmp.cmp("own/in.column", "ours/in.column", shallow=False)
    t = simulate(small(), engine=Lammps(**VERLET, template="my.template"))
    assert np.array_equal(t.velocity, simulate(small(), engine=Lammps(**VERLET)).velocity)


def test_one_template_for_a_deck_and_the_library():
    options = {"template": "my.template", "include": "my.include"}
    write_deck(small(), "deck", step=1e-7, **options)
    head = "# 25 grains of my own\n# steps of 0.1 us\n"
    assert Path("deck/in.column").read_text().startswith(head)
    lmp(Path("deck"))
    t = simulate(small(), engine=Lammps(**VERLET, **options))
    dumped = Trajectory.from_dump("deck/column.lammpstrj", small())
    assert np.array_equal(dumped.velocity, t.velocity)
    assert t.provenance["template"] == Path("my.template").read_text()


def test_a_deck_template_may_run_but_a_library_template_may_not():
    dump = "dump out all custom {{ every }} own.dump id x y z vz\ndump_modify out format float"
    Path("my.template").write_text(f"{TEMPLATE}{dump} %.17g\nrun {{{{ every * samples }}}}\n")
    write_deck(small(), "deck", step=1e-7, template="my.template")
    lmp(Path("deck"))
    dumped = Trajectory.from_dump("deck/own.dump", small())
    assert np.array_equal(dumped.velocity, simulate(small(), engine=Lammps(**VERLET)).velocity)
    refusal = r'template: the command run \(line 8\) cannot be used here: use .*"run.column"'
    with pytest.raises(InputError, match=refusal):
        simulate(small(), engine=Lammps(**VERLET, template="my.template"))


RUNS = 'run 10|  run\t10|if "1 > 0" then "run 10"|minimize 0 0 1 1|clear|quit|rerun a.dump'


@pytest.mark.parametrize("commands", RUNS.split("|"))
def test_an_include_may_not_run(commands: str, capsys: pytest.CaptureFixture[str]):
    text = f"# run 10\nvariable run equal 1\nfix runs all nve # run\n{commands}\n"
    Path("my.include").write_text(text)
    for verb in (["deck", "-o", "deck"], ["run", "--engine", "lammps"]):
        assert main([verb[0], "scene.toml", "--include", "my.include", *verb[1:]]) == 2
        assert "(line 4)" in (said := capsys.readouterr()).err
        assert keys(said) == ["include"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{{ colour }}", "no placeholder 'colour'; there are alone, column, cycles, data, "),
        ("{{ colour }} {{ size }} {{ column.chain.grains }}", "there is no placeholder 'size'"),
        ("{{ column.colour }}", "has no attribute 'colour'"),
        ("{% if false %}{{ colour }}{% endif %}", "no placeholder 'colour'"),
        ("{{ 1 / 0 }}", "division by zero"),
        ("one\n{% if %}", "line 2 is not valid Jinja2"),
        ("{% include 'my.include' %}", "cannot include 'my.include'; there are column.data, "),
        ("{% include '../pyproject.toml' %}", "cannot include"),
        ("{% extends '/etc/passwd' %}", "cannot include"),
        ("{% import 'os' as os %}", "cannot include"),
        ("{{ ().__class__.__base__.__subclasses__() }}", "templates cannot access"),
        ("{{ column.scene.to_toml('spoilt') }}", "templates cannot access"),
        ("{{ column.chain.contacts.energy(1) }}", "templates cannot access"),
        ("{{ '%s'.format(column) }}", "templates cannot access"),
        ("{{ column | attr('__init__') }}", "templates cannot access"),
        ("{{ column['__class__'] }}", "templates cannot access"),
        ("{{ column._types_and_contacts }}", "templates cannot access"),
        ("{{ column.chain.material.name }}", "templates cannot access"),
        ("{% set x = column.scene.to_toml %}{{ x('spoilt') }}", "templates cannot access"),
        ("{{ namespace(a=1).a }}", "no placeholder 'namespace'"),
        ("{{ lipsum.__globals__['os'].system('touch spoilt') }}", "no placeholder 'lipsum'"),
        ("{{ self.__init__.__globals__ }}", "templates cannot access"),
        ("{% for i in range(10 ** 9) %}{% endfor %}", "cannot be filled in"),
        ("{{ colour }}\0", "not text in UTF-8"),
    ],
)
def test_templates_that_cannot_be_rendered(
    text: str, says: str, here: Path, capsys: pytest.CaptureFixture[str]
):
    Path("my.template").write_text(text)
    before = names(here)
    for verb in (["deck", "-o", "deck"], ["run", "--engine", "lammps"]):
        assert main([verb[0], "scene.toml", "--template", "my.template", *verb[1:]]) == 2
        said = capsys.readouterr()
        assert set(keys(said)) == {"template"}
        assert says in said.err
        assert names(here) == before


def test_incompatible_options(capsys: pytest.CaptureFixture[str]):
    Path("bare").write_text("units si\n")
    Path("binary").write_bytes(b"\xff\xfe")
    for options, key in (
        (["--include", "none"], "include"),
        (["--include", "."], "include"),
        (["--template", "binary"], "template"),
        # The template has no place for an include file.
        (["--template", "bare", "--include", "my.include"], "include"),
        (["--template", "my.template", "--integrator", "rkn6"], "template"),
        (["--template", "my.template", "--engine", "native"], "template"),
        (["--include", "my.include", "--engine", "native"], "include"),
    ):
        assert main(["run", "scene.toml", "--engine", "lammps", *options]) == 2
        assert keys(capsys.readouterr()) == [key]


def test_on_the_command_line(capsys: pytest.CaptureFixture[str]):
    own = ["--step", "1e-8", "--template", "my.template", "--include", "my.include"]
    assert main(["run", "scene.toml", "--engine", "lammps", "-o", "run.nc", *own]) == 0
    assert "verlet" in capsys.readouterr().out
    assert Path("mine.dump").stat().st_size > 0
    assert main(["deck", "scene.toml", "-o", "deck", *own]) == 0
    lmp(Path("deck"))
    dumped = Trajectory.from_dump("deck/column.lammpstrj", Scene.from_toml("scene.toml"))
    assert np.array_equal(dumped.velocity, Trajectory.load("run.nc").velocity)


# --- no text of a scene becomes a command

HOSTILE = [
    '"; shell touch spoilt; "', "x\nshell touch spoilt\n", "$(touch spoilt)", "`touch spoilt`",
    "${HOME}", "a & b",
    "'; touch spoilt; '", "{{ 7 * 7 }}", "# > spoilt", "../../spoilt", "\x1b[2J", "\u202e\u00e9",
    "a\tb", "%s%n", "*",
]  # fmt: skip
NAMED = (
    "{{density = 2426.0, youngs_modulus = 62e9, poissons_ratio = 0.2, name = {0}, source = {0}}}"
)
TAME = 'grains = 20\nmaterial = "glass"\ndiameter = 1.0e-3'
ROW = "grains = 20\ndiameter = 1e-3\n"
CHAINS = {
    "material": ROW + "material = {0}",
    "material.name": f"{ROW}material = {NAMED}",
    "top": ROW + "top = {0}",
    "bottom": ROW + "bottom = {0}",
    "bottom_material": f'{ROW}bottom = "wall"\nbottom_material = {NAMED}',
    "file": "file = {0}",
    "grains": "grains = {0}\ndiameter = 1e-3",
    "impurity": ROW + "impurity = [{{grain = 3, material = {0}}}]",
    "impurity.name": f"{ROW}impurity = [{{{{grain = 3, material = {NAMED}}}}}]",
    "key": ROW + "{0} = 1",
}
# Places of a scene file in which text is allowed: what is replaced, and by what.
FIELDS = {f"chain.{key}": (TAME, form) for key, form in CHAINS.items()} | {
    "excitation.kind": ('kind = "impulse"', "kind = {0}"),
    "excitation.file": ('kind = "impulse"\nvelocity = 8.57e-4', 'kind = "profile"\nfile = {0}'),
    "recording.grains": ("samples = 11", "samples = 11\ngrains = {0}"),
    "section": ("[recording]", "[{0}]\na = 1\n[recording]"),
}


def toml(text: str) -> str:
    """Return a text as a TOML string."""
    import tomli_w

    return tomli_w.dumps({"a": text}).removeprefix("a = ").strip()


def scenes(text: str) -> dict[str, str]:
    """Return scene files that contain this text wherever text is allowed."""
    return {
        field: SCENE.replace(old, new.format(toml(text))) for field, (old, new) in FIELDS.items()
    }


def deck_bytes(folder: str) -> list[bytes]:
    return [Path(folder, name).read_bytes() for name in ("in.column", "column.data")]


@pytest.mark.parametrize("text", thinned(HOSTILE, 15))
def test_text_of_a_scene_does_not_enter_decks(
    text: str, here: Path, capsys: pytest.CaptureFixture[str]
):
    reference = {}
    for field, tame in scenes("harmless").items():
        Path("scene.toml").write_text(tame)
        if main(["deck", "scene.toml", "-o", f"tame {field}", "--step", "1e-7"]) == 0:
            reference[field] = deck_bytes(f"tame {field}")
    assert set(reference) == {"chain.material.name", "chain.bottom_material", "chain.impurity.name"}
    before = names(here)
    capsys.readouterr()
    for field, scene in scenes(text).items():
        Path("scene.toml").write_text(scene)
        code = main(["deck", "scene.toml", "-o", "deck", "--step", "1e-7"])
        said = capsys.readouterr()
        assert code == (0 if field in reference else 2), (field, said.err)
        if code == 0:
            assert deck_bytes("deck") == reference[field]
            shutil.rmtree("deck")
        else:
            assert all(line.startswith("error: ") for line in said.err.splitlines())
        assert names(here) == before


@pytest.mark.parametrize("name", thinned(HOSTILE, 6))
def test_names_of_files_and_folders(name: str, here: Path, capsys: pytest.CaptureFixture[str]):
    """Text for a shell is quoted, and text that LAMMPS could take for a command is rejected."""
    name = name.replace("/", "_")
    Path(name).write_text("displacement,velocity\n" + "0,1e-4\n" + 19 * "0,0\n")
    Path("scene.toml").write_text(scenes(name)["excitation.file"])
    folder = f"folder {name}"
    assert main(["deck", "scene.toml", "-o", folder, "--step", "1e-7"]) == 0
    line = capsys.readouterr().out.split("to run them:\n")[1]
    before = names(here)
    path = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    subprocess.run(["bash", "-c", line], env=os.environ | path, check=True, capture_output=True)
    assert (Path(folder) / "column.lammpstrj").stat().st_size > 0
    kept = f"kept {name}"
    engine = Lammps(**VERLET, keep=kept)
    if set(name) & set("\"'$&#{}*%\n\t\x1b") or not name.isascii():
        with pytest.raises(InputError, match="rename the folder"):
            simulate(Scene.from_toml("scene.toml"), engine)
        assert names(here) == before
    else:
        simulate(Scene.from_toml("scene.toml"), engine)
        assert names(here) == sorted([*before, kept])
        assert filecmp.cmp(f"{folder}/column.lammpstrj", f"{kept}/column.lammpstrj", shallow=False)


# --- the job script


@pytest.fixture
def cluster(here: Path) -> dict[str, str]:
    """Return the environment of a SLURM job, with an `srun` that records its arguments."""
    (here / "bin").mkdir()
    srun = here / "bin" / "srun"
    srun.write_text('#!/bin/sh\nprintf "%s\\n" "$@" >> "$0.log"\n')
    srun.chmod(0o755)
    return os.environ | {
        "PATH": f"{here / 'bin'}:{os.environ['PATH']}",
        "SLURM_JOB_END_TIME": "99999999999",
    }


def job(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    script = [str(TEMPLATES / "slurm.sh"), *arguments]
    return subprocess.run(
        ["bash", *script], env=environment, capture_output=True, text=True, check=False
    )


def test_the_job_script(cluster: dict[str, str], here: Path):
    subprocess.run(["bash", "-n", str(TEMPLATES / "slurm.sh")], check=True)
    log = here / "bin" / "srun.log"
    for folder in ("run/", "a $(touch spoilt); `x` run"):
        wanted = f"{folder.rstrip('/')}/"
        assert job(cluster, "my scene.toml", folder, "--template", "my deck").returncode == 0
        words = log.read_text().splitlines()
        run = ["run", "my scene.toml", "-o", wanted, "--engine", "lammps", "--max-wall"]
        assert words[:8] == ["lmpchain", *run]
        assert float(words[8]) > 9e10
        assert words[9:] == ["--template", "my deck"]
        log.unlink()
        Path(wanted).mkdir()
        assert job(cluster, "my scene.toml", folder).returncode == 0
        assert log.read_text().splitlines()[:4] == ["lmpchain", "resume", wanted, "--max-wall"]
        log.unlink()
    assert "spoilt" not in names(here)
    del cluster["SLURM_JOB_END_TIME"]
    failed = job(cluster, "scene.toml", "run")
    assert failed.returncode != 0
    assert "SLURM_JOB_END_TIME" in failed.stderr
    assert not log.exists()
