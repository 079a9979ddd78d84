"""Scenes of users' LAMMPS runs: each scene moves like its dump."""

from pathlib import Path

import numpy as np
import pytest
from helpers.independent_integrators import distance
from helpers.own_inputs import COLUMN, INPUTS, LEVEL, TAPERED, run_input, silent_lammps

from lmpchain import InputError, Scene, Trajectory, simulate
from lmpchain.cli.command_line import main
from lmpchain.engines import Native
from lmpchain.scene.lammps_column import RunOptions, infer_scene
from lmpchain.scene.lammps_object import grains_of
from lmpchain.trajectory.lammps_dump import scene_of_run

UNITS = {"cgs": "cgs", "dimer": "micro", "springs": "nano"}
STEPS = {"column": 1e-7, "dimer": 1e-8, "harmonic": 1e-5, "lepton": 1e-5, "floor": 1e-8}
STEPS["springs"] = 1e-11
# Inputs whose grains are placed by a run only.
SETTLED = ("column", "floor")
# E of Poisson's ratio 0.3 with which grains have the k of a pair style.
SOFT = 1.365  # Factor on k.


def glass() -> RunOptions:
    return RunOptions(young=6.2e9, poisson=0.2, timestep=1e-7)


def difference(dump: Path, scene: Scene, step: float, units: str | None = None) -> float:
    """Return the relative distance of a native run with the same steps from a dump."""
    there = Trajectory.from_dump(dump, scene, units=units)
    method = "lagged-verlet" if scene.chain.damped else "verlet"
    here = simulate(scene, Native(method, step=step))
    assert here.cost.steps == there.cost.steps
    return distance(there, here)


@pytest.mark.parametrize("name", INPUTS)
def test_a_scene_moves_as_the_input_and_its_dump(name: str, tmp_path: Path):
    """Native steps differ from LAMMPS steps by the rounding of its positions."""
    dump = run_input(tmp_path, INPUTS[name])
    step = STEPS.get(name, 1e-7)
    both = Scene(**scene_of_run([dump, tmp_path / "in.own"]).fields)
    assert difference(dump, both, step, UNITS.get(name)) < 2e-8
    if name in SETTLED:
        return
    alone = Scene(**scene_of_run([tmp_path / "in.own"]).fields)
    assert difference(dump, alone, step, UNITS.get(name)) < 2e-8
    assert (alone.samples, alone.chain.grains) == (both.samples, both.chain.grains)


def test_the_command_writes_a_scene_that_check_accepts(tmp_path: Path, capsys):
    dump = run_input(tmp_path, COLUMN)
    scene = tmp_path / "scene.toml"
    options = ["--young", "6.2e9", "--poisson", "0.2", "--timestep", "1e-7"]
    assert main(["new", str(scene), "--from", str(dump), *options]) == 0
    said = capsys.readouterr().out.splitlines()
    facts = dict(line.split(": ", 1) for line in said if ": " in line)
    assert facts["column"].startswith("20 grains along z, which points up: grain 1 is atom 20")
    assert facts["gravity"].startswith("9.81 m/s2 (from overlaps")
    assert facts["load"] == "none (from 18 overlaps, assumed to be at rest)"
    assert facts["bottom"] == "grain 20 is held"
    assert facts["start"] == "grain 1 moves at 0.05 m/s, positive downward"
    assert float(facts["equilibrium"].split("at most ")[1].split(" N")[0]) < 1e-9
    assert facts["next"] == f"lmpchain check {dump} --scene {scene}"
    assert main(["check", str(dump), "--scene", str(scene), "--tolerance", "1e-6"]) == 0


def test_a_file_of_the_run_is_not_replaced_even_with_force(tmp_path: Path, capsys) -> None:
    run_input(tmp_path, TAPERED, "in.toml")
    path = tmp_path / "in.toml"
    assert main(["new", str(path), "--from", str(path), "--force"]) == 2
    assert "is a file of the run itself: name another file" in capsys.readouterr().err
    assert path.read_text(encoding="utf-8") == TAPERED


CASES: dict[str, tuple[str, RunOptions, str | None]] = {
    "column": (COLUMN, glass(), None),
    "level": (LEVEL, RunOptions(young=SOFT * 1e10, poisson=0.3, timestep=1e-7), None),
    "tapered": (TAPERED, RunOptions(young=SOFT * 5e9, poisson=0.3, timestep=1e-7), None),
    "cgs": (INPUTS["cgs"], RunOptions(young=SOFT * 1e10, poisson=0.3, timestep=1e-7), "cgs"),
}


@pytest.mark.parametrize("name", CASES)
def test_a_dump_alone_gives_gravity_and_load(name: str, tmp_path: Path):
    text, options, units = CASES[name]
    dump = run_input(tmp_path, text)
    scene = Scene(**scene_of_run([dump], options, units).fields)
    assert difference(dump, scene, 1e-7, units) < 2e-8
    # The force at rest below the first grain, by hand.
    load = {"column": 0.0, "level": 5e8 * 1e-5**1.5, "tapered": 0.0, "cgs": 10.0}[name]
    assert scene.chain.top_load == pytest.approx(load, rel=1e-7, abs=1e-9)
    assert scene.chain.gravity == (9.81 if name == "column" else 0.0)
    # The masses of the dump follow from one density.
    assert "masses" not in scene.chain.given()


def frames_from(dump: Path, first: int) -> Path:
    """Return a dump without its first frames."""
    head, *frames = dump.read_text(encoding="utf-8").split("ITEM: TIMESTEP")
    part = dump.with_name("part.lammpstrj")
    text = head + "".join(f"ITEM: TIMESTEP{frame}" for frame in frames[first:])
    part.write_text(text, encoding="utf-8")
    return part


def test_a_dump_that_begins_during_a_wave(tmp_path: Path):
    """Load and gravity follow from grains that no wave has reached; the others get a profile."""
    text, options, units = CASES["cgs"]
    dump = run_input(tmp_path, text)
    part = frames_from(dump, 6)
    understood = scene_of_run([part], options, units)
    scene = Scene(**understood.fields)
    assert dict(understood.facts)["load"].startswith("10 N (from 6 overlaps")
    assert scene.chain.top_load == pytest.approx(10.0, rel=1e-7)
    # Grains count as at rest up to 1e-6 of the wave.
    assert difference(part, scene, 1e-7, units) < 2e-7
    # Later no grain is at rest.
    with pytest.raises(InputError, match="its first frame is not at rest, so its overlaps"):
        scene_of_run([frames_from(dump, 30)], options, units)


def test_a_strike_after_the_first_frame_is_reported(tmp_path: Path):
    later = LEVEL.replace("velocity        hit", "# velocity").replace("run             3000", "")
    later += "run 100\nvelocity hit set 0.1 0 0\nrun 2900\n"
    dump = run_input(tmp_path, later)
    with pytest.raises(InputError, match="grains move, but not in the first frame: begin the dump"):
        scene_of_run([dump, tmp_path / "in.own"])


def test_a_change_within_the_dump_is_rejected(tmp_path: Path):
    later = LEVEL + "fix 9 beads viscous 1.0\nrun 1000\n"
    dump = run_input(tmp_path, later)
    with pytest.raises(InputError, match=r"\(fix 9 .*changes the run at step 3000, within the d"):
        scene_of_run([dump, tmp_path / "in.own"])


def test_types_come_from_the_dump(tmp_path: Path):
    dump = run_input(tmp_path, INPUTS["springs"])
    text = dump.read_text(encoding="utf-8").replace("ATOMS id type", "ATOMS id kind")
    dump.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"pair_coeff.*depends on types.*dump type"):
        scene_of_run([dump, tmp_path / "in.own"])


def test_a_floor_is_inferred_from_the_dump_alone(tmp_path: Path):
    """Grain N moves under the weight, so that a wall of its material must carry it."""
    k = 6.2e9 / (2 * (1 - 0.2**2)) * 4 / 3
    text = INPUTS["floor"].replace("hertz 1e8 300.0", f"hertz {k} 300.0")
    text = text.replace("hertz 1e8 150.0", f"hertz {k} 150.0")
    settled, struck = text.split("velocity        all set 0 0 0")
    end = "tangential linear_nohistory 0 0 damping velocity"
    quiet = f"""unfix 4
unfix 3
pair_coeff * * hertz {k} 0 {end}
fix 3 all wall/gran granular hertz {k} 0 {end} xplane NULL 0.08
velocity all set 0 0 0
"""
    dump = run_input(tmp_path, settled + quiet + struck)
    options = RunOptions(young=6.2e9, poisson=0.2, timestep=1e-8)
    understood = scene_of_run([dump], options)
    assert dict(understood.facts)["bottom"].startswith("a wall of the grains' material is assumed")
    assert Scene(**understood.fields).chain.gravity == 9.81
    # The position of the wall is not in the dump: grain N is assumed at rest on it.
    assert difference(dump, Scene(**understood.fields), 1e-8) < 2e-6


def test_a_dump_with_few_digits_is_refused(tmp_path: Path):
    dump = run_input(tmp_path, LEVEL.replace("%.17g", "%.6g"))
    with pytest.raises(InputError, match=r"too few digits for overlaps of 1e-05 m: use dump_"):
        scene_of_run([dump], RunOptions(material="steel", timestep=1e-7))


def test_missing_information_is_requested(tmp_path: Path):
    dump = run_input(tmp_path, LEVEL)
    bare = tmp_path / "bare.lammpstrj"
    text = dump.read_text(encoding="utf-8").replace("radius mass", "spin charge")
    bare.write_text(text, encoding="utf-8")
    steel = RunOptions(material="steel", diameter=1e-2)
    asked = [
        (dump, RunOptions(), "material: is not in the run: give --material NAME"),
        (dump, RunOptions(material="steal"), r"is called 'steal' \(did you mean 'steel'"),
        (dump, RunOptions(material="steel"), r"--timestep, in s \(its velocities suggest 1e-07\)"),
        (dump, steel, "diameter: is in the run"),
        (dump, RunOptions(material="steel", timestep=-1.0), r"timestep: must be above 0 \(got -1"),
        (dump, RunOptions(material="steel", density=1.0), "density: is in the run"),
        (dump, RunOptions(material="steel", young=1e9), "young: follows from the material"),
        (dump, RunOptions(young=1e9, poisson=0.3, duration=1.0), "duration: follows from the dump"),
        (bare, RunOptions(material="steel"), "diameter: is not in the run: give --grain-diameter"),
        (bare, steel._replace(density=1.0), "density: follows from the material: leave it out"),
        (bare, RunOptions(young=1e9, poisson=0.3, diameter=1e-2), "density: is not in the run: gi"),
    ]
    for path, options, message in asked:
        with pytest.raises(InputError, match=message):
            scene_of_run([path], options)
    for given in ({"timestep": 1e-7}, {"material": "steel"}, {"young": 1e9}, {"diameter": 1e-2}):
        with pytest.raises(InputError, match=f"{min(given)}: is in .*leave it out"):
            scene_of_run([tmp_path / "in.own"], RunOptions(**given))
    known = RunOptions(young=SOFT * 1e10, poisson=0.3, density=7800.0, diameter=1e-2, timestep=1e-7)
    assert difference(dump, Scene(**scene_of_run([bare], known).fields), 1e-7) < 2e-8


def alike(one: Scene, other: Scene) -> bool:
    """Return whether two scenes have the same numbers up to rounding."""
    pairs = [
        (one.chain.masses, other.chain.masses),
        (one.chain.contacts.constant, other.chain.contacts.constant),
        (one.chain.contacts.force, other.chain.contacts.force),
        *zip(one.initial(), other.initial(), strict=True),
    ]
    kinds = [(scene.chain.top, scene.chain.bottom, scene.excitation.kind) for scene in (one, other)]
    close = [np.abs(a - b).max() <= 1e-9 * np.abs(b).max() for a, b in pairs]
    return all(close) and kinds[0] == kinds[1] and (one.time == other.time).all()


def before_the_run(text: str) -> str:
    return text[: text.rindex("dump            out")]


@pytest.mark.parametrize("name", ["level", "dimer", "cgs", "harmonic"])
def test_an_instance_gives_the_scene_of_its_input(name: str, tmp_path: Path):
    text = INPUTS[name]
    (tmp_path / "in.own").write_text(text, encoding="utf-8")
    expected = Scene(**scene_of_run([tmp_path / "in.own"]).fields)
    with silent_lammps(before_the_run(text)) as lmp:
        recording = {"duration": expected.duration, "samples": expected.samples}
        scene = Scene.from_lammps(lmp, input=tmp_path / "in.own", **recording)
        assert alike(scene, expected)
        if name != "level":
            with pytest.raises(InputError, match="name the input file, input="):
                Scene.from_lammps(lmp, material="steel", **recording)
            return
        alone = Scene.from_lammps(lmp, young=SOFT * 1e10, poisson=0.3, **recording)
        assert alone.chain.contact_constants == pytest.approx(expected.chain.contact_constants)
        assert alone.chain.top_load == pytest.approx(expected.chain.top_load)
        assert alone.excitation == expected.excitation


def test_an_instance_without_a_load_fix_has_no_load():
    text = before_the_run(LEVEL).replace("id 1 12", "id 12")
    # A frozen grain is held, although it belongs to the group of the later fix that moves grains.
    fixes = "fix             1 beads nve/sphere", "fix             2 ends freeze"
    text = text.replace("\n".join(fixes), f"{fixes[1]}\n{fixes[0].replace('beads', 'all')}")
    with silent_lammps(text) as lmp:
        given = RunOptions(young=SOFT * 1e10, poisson=0.3, duration=1e-4)
        facts = dict(infer_scene(grains_of(lmp), None, given).facts)
        assert facts["gravity"] == "none (no fix gravity)"
        assert facts["load"] == "none (no fix addforce on a grain)"
        scene = Scene.from_lammps(lmp, young=SOFT * 1e10, poisson=0.3, duration=1e-4)
        assert (scene.chain.top, scene.chain.top_load, scene.chain.gravity) == ("free", 0.0, 0.0)
        # The overlaps of 1e-5 m push the grains apart.
        assert scene.initial()[0] == pytest.approx(1e-5 * np.arange(11, -1, -1), rel=1e-9)
        lmp.command("fix down beads gravity 9.81 vector 1 0 0")
        scene = Scene.from_lammps(lmp, young=SOFT * 1e10, poisson=0.3, duration=1e-4)
        assert (scene.chain.bottom, scene.chain.gravity, scene.samples) == ("fixed", 0.0, 101)
        lmp.command("fix push beads addforce 1 0 0")
        with pytest.raises(InputError, match="has fix addforce, whose effect cannot be read"):
            Scene.from_lammps(lmp, young=SOFT * 1e10, poisson=0.3, duration=1e-4)
        lmp.command("unfix push")
        lmp.command("pair_style gran/hooke 1e5 NULL 0 NULL 0 0")
        with pytest.raises(InputError, match="has pair_style gran/hooke, whose effect"):
            Scene.from_lammps(lmp, young=SOFT * 1e10, poisson=0.3, duration=1e-4)


def test_an_instance_has_the_forces_at_the_end_of_its_input(tmp_path: Path):
    """A drag that settles the grains is removed after the run of the input."""
    settled = before_the_run(LEVEL) + "fix 9 beads viscous 1.0\nrun 0\n"
    path = tmp_path / "in.own"
    path.write_text(f"{settled}run 10\nunfix 9\nvelocity hit set 0.1 0 0\n", encoding="utf-8")
    with silent_lammps() as lmp:
        lmp.file(str(path))
        scene = Scene.from_lammps(lmp, input=path, duration=1e-4)
        assert not scene.chain.damped
        path.write_text(f"{settled}run 10\n", encoding="utf-8")
        with pytest.raises(InputError, match="fixes of the instance, freeze, nve/sphere: name"):
            Scene.from_lammps(lmp, input=path, duration=1e-4)
        lmp.command("fix 9 beads viscous 0.5")
        assert Scene.from_lammps(lmp, input=path, duration=1e-4).chain.damped


def test_an_instance_without_grains_or_motion_is_refused():
    with pytest.raises(InputError, match=r"lmp: must be a lammps\.lammps object \(got 3\)"):
        Scene.from_lammps(3, duration=1e-4)
    with silent_lammps(
        "units si\natom_style sphere\nregion b block 0 1 0 1 0 1\ncreate_box 1 b"
    ) as lmp:
        with pytest.raises(InputError, match="has no grains"):
            Scene.from_lammps(lmp, duration=1e-4)
        lmp.commands_string("create_atoms 1 single .5 .5 .5\ncreate_atoms 1 single .5 .5 .6")
        with pytest.raises(InputError, match="has no fix nve"):
            Scene.from_lammps(lmp, duration=1e-4)
        with pytest.raises(InputError, match="matrial: is not an option"):
            Scene.from_lammps(lmp, duration=1e-4, matrial="steel")
