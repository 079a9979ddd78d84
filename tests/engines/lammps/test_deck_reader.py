"""Decks that are read without LAMMPS: the scene of a deck, edits, and the reasons of refusals.

Edited decks are read as `lmp` runs them, or rejected in one line.
"""

import random
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.standalone_lammps import read_dump, small
from helpers.thinned import thinned

from lmpchain import (
    Displacement,
    Drive,
    Force,
    Impulse,
    Impurity,
    InputError,
    Law,
    Scene,
    laws,
    simulate,
)
from lmpchain.engines import Native
from lmpchain.engines.lammps.deck_reader import read_deck
from lmpchain.engines.lammps.export import write_deck

STEP = 1e-7
UNLIKE = np.linspace(1e-3, 1.8e-3, 25)
MASSES = np.linspace(1e-6, 3e-6, 25)
SINE: dict[str, Any] = {"amplitude": 1e-8, "frequency": 5e4}
POINTS: dict[str, Any] = {"times": np.linspace(0, 2.1e-5, 8)}
CURVE = 3e-8 * np.sin(np.arange(8.0)) ** 2
VISCOUS = {"viscoelastic": 1e-8}
GAUGE = {"diameter": "gauge"}
WALLS: dict[str, Any] = {"top": "wall", "bottom": "wall", "bottom_material": "steel"}
# Scenes that follow from a deck alone, with the options of the deck.
SCENES: dict[str, tuple[Scene, dict[str, Any]]] = {
    "struck": (small(), {}),
    "struck inside": (small(Impulse(velocity=-1e-3, grain=4), top_load=0.02, gravity=0.0), {}),
    "composed": (small(), {"integrator": "kahan-li6"}),
    "gauge": (small(diameter=UNLIKE, bottom="free", gravity=0.0), GAUGE),
    "pair style": (small(damping=VISCOUS), {"pair_style": "gran/hertz/history"}),
    "displaced": (small(Displacement(displacement=-3e-8, grain=7)), {}),
    "springs": (small(exponent=1.0, masses=MASSES, damping=VISCOUS, **WALLS), {}),
    "walls": (small(Impulse(velocity=1e-3, grain=3), diameter=UNLIKE, **WALLS), {}),
    "pressed by a wall": (small(top="wall", top_load=0.02, damping={"drag": 2e3}), {}),
    "load below a wall": (small(top="wall", top_load=0.02, load_grain=2), {}),
    "load inside": (small(top_load=0.02, load_grain=3), {}),
    "unlike": (
        small(
            diameter=UNLIKE,
            masses=MASSES,
            contact_constants=np.linspace(1e9, 2e9, 24),
            exponent=1.5,
            damping={"viscoelastic": 1e-8 * np.arange(1, 25), "drag": 1e3},
        ),
        {},
    ),
    "heavy": (small(diameter=UNLIKE, masses=1e3 * MASSES), {}),
    "driven": (small(Drive(**SINE), top_load=0.02), {}),
    "driven without a load": (small(Drive(**SINE), diameter=UNLIKE), {}),
    "driven springs in a burst": (
        small(Drive(**SINE, cycles=1.5), top_load=0.02, exponent=1.0, gravity=0.0),
        {},
    ),
    "load below a driven grain": (small(Drive(**SINE), top_load=0.02, load_grain=2), {}),
    "heavy driven grain": (
        small(
            Drive(**SINE), impurity=[Impurity(grain=1, mass=1e-5)], damping={"drag": 3e3, **VISCOUS}
        ),
        {},
    ),
    "driven wall": (small(Drive(grain=0, **SINE), top_load=0.02, **WALLS), {}),
    "viscous driven wall": (
        small(Drive(grain=0, **SINE), top_load=0.02, damping=VISCOUS, **WALLS, diameter=UNLIKE),
        GAUGE,
    ),
    "springs below a viscous driven wall": (
        small(Drive(grain=0, **SINE), top_load=0.02, damping=VISCOUS, exponent=1.0, **WALLS),
        {},
    ),
    "pushed": (small(Force(grain=3, **SINE), top_load=0.02), {}),
    "pushed in a burst": (small(Force(grain=3, **SINE, cycles=2.5)), {}),
    "half-sine": (small(Force(grain=5, shape="half-sine", amplitude=1e-3, duration=7.03e-6)), {}),
}
# Scenes that must be given, and the reason.
FORMULA, BY_POINTS, SINGLE = (
    "formula with numbers instead of parameters: give its scene",
    "is given by points, which the deck does not contain: give its scene",
    "has a single grain and no contact: give its scene",
)
TODA = laws.toda(1e5, k=1e3)
GIVEN: dict[str, tuple[Scene, dict[str, Any], str]] = {
    "formula": (small(law=TODA, gravity=0.0, masses=MASSES), {}, FORMULA),
    "formula and gauge": (small(law=TODA, gravity=0.0), GAUGE, FORMULA),
    # The gauge diameter is a third of the diameter.
    "large overlaps": (
        small(Impulse(velocity=30.0), law=laws.toda(1e3, k=1e5), gravity=0.0),
        GAUGE,
        FORMULA,
    ),
    "viscous formula between walls": (
        small(law=TODA, damping=VISCOUS, top="wall", bottom="wall"),
        {},
        FORMULA,
    ),
    "viscous formula below a moving wall": (
        small(Drive(grain=0, **SINE), law=TODA, damping=VISCOUS, **WALLS),
        {},
        FORMULA,
    ),
    "ground": (small(ground=Law("k*u", k=np.linspace(1e5, 2e5, 25).tolist())), {}, FORMULA),
    "ground of time": (small(ground=laws.mathieu(1e6, depth=0.6, frequency=2e5)), {}, FORMULA),
    "driven by points": (small(Drive(**POINTS, displacement=CURVE), top_load=0.02), {}, BY_POINTS),
    "pushed by points": (small(Force(**POINTS, force=CURVE, grain=3)), {}, BY_POINTS),
    "single": (small(grains=1, **WALLS, top_load=0.02), {}, SINGLE),
}


def write(name: str, folder: Path, pattern: str = "", text: str = "") -> Scene:
    """Write a deck, replace the first match in its files, and return its scene."""
    scene, options, *_ = SCENES[name] if name in SCENES else GIVEN[name]
    write_deck(scene, folder, step=STEP, overwrite=True, **options)
    edited = 0
    for path in (folder / "in.column", folder / "column.data"):
        if pattern and not edited:
            new, edited = re.subn(pattern, text, path.read_text(), count=1)
            path.write_text(new)
    assert edited or not pattern
    return scene


def check_same(read: Scene, scene: Scene, gauged: bool) -> None:
    """Check that two scenes have the same equation of motion, start and samples."""
    ours, theirs = scene.chain, read.chain
    first, last = 1 + scene.excitation.driven, ours.movable
    inner = slice(0 if ours.top == "wall" else 1, None if ours.bottom == "wall" else -1)
    for one, other in (
        (ours.masses, theirs.masses),
        (ours.contact_constants, theirs.contact_constants),
        (ours.wall_constants, theirs.wall_constants),
        (ours.contact_viscosity[inner], theirs.contact_viscosity[inner]),
        (ours.drag[first - 1 : last], theirs.drag[first - 1 : last]),
        (ours.equilibrium_overlap, theirs.equilibrium_overlap),
        (ours.top_load, theirs.top_load),
        (scene.duration, read.duration),
    ):
        # A load that no command contains has the rounding error of heights, 2e-19 m.
        np.testing.assert_allclose(other, one, rtol=1e-9)
    # Grains of a gauge diameter are read as spheres of glass.
    glass = np.cbrt(ours.masses / 2500 / (np.pi / 6))
    np.testing.assert_allclose(theirs.diameters, glass if gauged else ours.diameters, rtol=1e-12)
    for key in ("top", "bottom", "gravity", "load_grain", "movable"):
        assert getattr(theirs, key) == getattr(ours, key)
    assert theirs.law.power == ours.law.power
    assert read.samples == scene.samples
    for one, other in zip(scene.initial(), read.initial(), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-11 * np.abs(one).max())
    forced, found = scene.excitation, read.excitation
    for key in ("acts_on", "driven", "does_work", "strike_velocity"):
        assert getattr(found, key) == getattr(forced, key)
    assert bool(found.wall) == bool(forced.wall)
    if forced.waveform:
        curves = [wave.at(scene.time) for wave in (forced.waveform, found.waveform) if wave]
        np.testing.assert_allclose(curves[1], curves[0], atol=1e-14 * np.abs(curves[0]).max())


@pytest.mark.parametrize("name", SCENES)
def test_the_scene_follows_from_a_deck_alone(name: str, tmp_path: Path):
    scene = write(name, tmp_path)
    deck = read_deck(tmp_path)
    gauged = "diameter" in SCENES[name][1]
    check_same(deck.scene, scene, gauged)
    assert deck.integrator == SCENES[name][1].get("integrator", "verlet")
    assert deck.step == pytest.approx(STEP, rel=1e-14)
    assert deck.digits == 17
    if name != "heavy":  # No number of a heavy grain tells which diameter is meant.
        assert (deck.gauge > 0) == gauged


@pytest.mark.parametrize("name", GIVEN)
def test_a_deck_that_lacks_parameters_is_read_with_its_scene(name: str, tmp_path: Path):
    scene, options, reason = GIVEN[name]
    write(name, tmp_path)
    with pytest.raises(InputError, match=reason):
        read_deck(tmp_path)
    longer = scene.replace(samples=3, duration=1e-3)
    deck = read_deck(tmp_path, longer)
    assert deck.scene.chain is scene.chain
    assert (deck.scene.samples, deck.scene.duration) == (6, pytest.approx(2e-5, rel=1e-12))
    assert (deck.gauge > 0) == ("diameter" in options)


# Each case: deck, pattern, text, changes of the scene that is given, and the reason of the refusal.
OTHERS: list[tuple[str, str, str, dict[str, Any], str]] = [
    ("formula", r"(\n3 1 0 0 \S+ \S+) \S+", r"\1 5000.0", {}, "grain 3 differs in the densities"),
    ("formula", r"(\n3 1 0 0 \S+) \S+", r"\1 0.0011", {}, "overlap by|differs in the diameters"),
    ("formula", r"\n2 (\d+) 2 3\n", r"\n2 \1 2 4\n", {}, "other bonds than the contacts"),
    ("formula", r"\n24 (\d+) 24 25\n", r"\n", {}, "does not have the header|other bonds than the"),
    ("formula", "24 bonds", "23 bonds", {}, "does not have the header of a column of 25 grains"),
    ("formula", r"\n1 bond types", "", {}, "does not have the header of a column of 25 grains"),
    ("ground", r"(Own\n\n1) \S+", r"\1 100001.0", {}, "other parameters of the grains under Own"),
    ("ground", r"(Own\n\n1) \S+", r"\1 100000.00001", {}, ""),
    ("ground", r"\n\nOwn\n[\s\S]*", "\n", {}, "other parameters of the grains under Own"),
    ("ground", r"(Own\n\n1) \S+\n", r"\1\n", {}, "is not a column's data file"),
    ("formula and gauge", "", "", {"chain": {"grains": 24}}, "has 25 grains, the scene 24"),
    ("formula", "", "", {"chain": {"law": laws.toda(1.1e5, k=1e3)}}, "can be predicted"),
    ("ground", "", "", {"chain": {"ground": Law("k*u", k=1e4)}}, "write the deck again"),
    ("formula", "", "", {"chain": {"gravity": 9.81}}, "grains 24 and 25 overlap by"),
    ("formula", "", "", {"excitation": Impulse(velocity=1e-3)}, "v0 index .* is not known"),
    ("formula", "", "", {"excitation": Displacement(displacement=1e-9)}, "starts with 0, in the"),
    ("driven by points", r"(pair_coeff.*hertz)", r"\1 0", {}, "is not `pair_coeff"),
    ("driven by points", r"(c1 string \S+)\d\n", r"\1\n", {}, ""),
    ("driven by points", r"(\nvariable c1 string \S+)", r"\1e1", {}, "is not `variable c1 string"),
    ("driven by points", r"\nrun .*", "\nrun 10", {}, r"\(run 10\) is not `run "),
    (
        "pushed by points",
        "",
        "",
        {"excitation": Force(**POINTS, force=1.00001 * CURVE, grain=3)},
        "is not `variable c",
    ),
    ("driven by points", "", "", {"chain": {"top_load": 0.03}}, "overlap by"),
    ("single", r"\n1 1 0.001 \S+", "\n1 1 0.001 5000.0", {}, "grain 1 differs in the densities"),
]


@pytest.mark.parametrize(("name", "pattern", "text", "changes", "message"), OTHERS)
def test_a_deck_must_fit_the_given_scene(
    name: str, pattern: str, text: str, changes: dict[str, Any], message: str, tmp_path: Path
):
    """Numbers may differ by their rounding to eight digits."""
    scene = write(name, tmp_path, pattern, text)
    changes = dict(changes)
    chain = scene.chain.replace(**changes.pop("chain", {}))
    scene = scene.replace(chain=chain, **changes)
    if not message:
        assert read_deck(tmp_path, scene).scene.chain is scene.chain
        return
    with pytest.raises(InputError, match=message):
        read_deck(tmp_path, scene)


def test_an_earlier_deck_with_damping_lags(tmp_path: Path):
    """Decks of earlier versions integrate damped chains with `fix nve`."""
    scene = small(damping={"drag": 2e3})
    drag = 2e3 * scene.chain.masses[0]
    write("struck", tmp_path, r"\nfix +weight .*", rf"\g<0>\nfix drag mobile viscous {drag}")
    deck = read_deck(tmp_path)
    assert deck.integrator == "lagged-verlet"
    check_same(deck.scene, scene, gauged=False)


TIMESTEP, RUN, DUMP = r"\ntimestep .*", r"\nrun  .*", r"\ndump_modify .*"
DT, EVERY, V0 = (rf"\nvariable +{name} .*" for name in ("dt", "every", "v0"))
FORMAT = "dump_modify out format float"
HALVED = {"step": 5e-8, "duration": 1e-5}
# The deck has 5 intervals of 40 steps. Each edit: deck, pattern, text, and what becomes different.
ACCEPTED: list[tuple[str, str, str, dict[str, Any]]] = [
    ("struck", TIMESTEP, r"\g<0>\ntimestep 5e-8", HALVED),
    ("struck", TIMESTEP, r"\ntimestep 5e-8\g<0>", {}),
    ("struck", RUN, r"\g<0>\ntimestep 5e-8", {}),
    ("struck", RUN, r"\g<0>\g<0>", {"samples": 11, "duration": 4e-5}),
    ("struck", RUN, "\nrun 130", {"samples": 4, "duration": 1.2e-5}),
    ("struck", RUN, "\nrun 40", {"samples": 2, "duration": 4e-6}),
    ("struck", RUN, "\nrun 60\nrun 140 upto", {"samples": 4, "duration": 1.2e-5}),
    ("struck", RUN, "\nrun 120\nrun 120 upto pre no", {"samples": 4, "duration": 1.2e-5}),
    ("struck", RUN, "\nrun 0\nrun $(2*v_every)", {"samples": 3, "duration": 8e-6}),
    ("struck", "\nunits", "\nvariable dt index 5e-8\nunits", HALVED),
    ("struck", DT, r"\g<0>\nvariable dt index 5e-8", {}),
    ("struck", EVERY, "\nvariable every index 20", {"duration": 1e-5}),
    ("struck", V0, "\nvariable v0 index +1.E-03", {"excitation": Impulse(velocity=1e-3)}),
    ("struck", V0, "\nvariable v0 index .001\\g<0>", {"excitation": Impulse(velocity=1e-3)}),
    (
        "struck",
        r"group +struck id 1\b",
        "group struck id 3",
        {"excitation": Impulse(velocity=8.57e-4, grain=3)},
    ),
    ("struck", DUMP, rf"\g<0>\n{FORMAT} %.4g", {"digits": 4}),
    ("struck", DUMP, rf"\n{FORMAT} %.4g\g<0>", {}),
    ("struck", RUN, rf"\n{FORMAT} %.12g\g<0>", {"digits": 12}),
    ("struck", r"%\.17g\n\n", "%g\n\n", {"digits": 6}),
    ("struck", r"%\.17g\n\n", "%.0g\n\n", {"digits": 1}),
    ("struck", r"\nthermo  .*", "\nthermo 0", {}),
    ("struck", "# time step, s", "\f# time step", {}),
    ("struck", "index column.data", "index ./column.data", {}),
    # The heights at rest may belong to contacts whose constants differ by 1e-5.
    ("struck", r"hertz \S+", "hertz 43056e6",
     {"chain": small(contact_constants=np.full(24, 43056e6 * 2.5e-4**0.5), exponent=1.5).chain}),
    ("struck", r"\n3 (0 0 .*)\n4 .*", r"\n4 \1\n3 \1", {}),
    ("composed", DT, "\nvariable dt index 5e-8", HALVED),
    ("composed", r"\nvariable +samples .*", "\nvariable samples index 3",
     {"samples": 4, "duration": 1.2e-5}),
    ("composed", DUMP, rf"\g<0>\n{FORMAT} %.4g", {"digits": 4}),
    ("composed", r"\nrun  +0 .*", rf"\g<0>\n{FORMAT} %.17g", {}),
    ("driven", DT, "\nvariable dt index 5e-8", HALVED),
    ("pushed", r"\nvariable +amplitude .*", "\nvariable amplitude index 2e-3",
     {"excitation": Force(grain=3, amplitude=2e-3, frequency=5e4)}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "pattern", "text", "changes"), ACCEPTED)
def test_an_edit_that_lammps_accepts_is_taken_over(
    name: str, pattern: str, text: str, changes: dict[str, Any], tmp_path: Path
):
    """The last of several commands is valid, but the first of several index variables."""
    scene = write(name, tmp_path, pattern, text)
    deck = read_deck(tmp_path)
    expected = dict(changes)
    assert deck.step == pytest.approx(expected.pop("step", STEP), rel=1e-14)
    assert deck.digits == expected.pop("digits", 17)
    check_same(deck.scene, scene.replace(**expected), gauged=False)


ROUNDED = 1e-7  # Rounding of heights in LAMMPS, relative to the largest motion.
SPOILT = ["", "$", "&", "nan", "1e308", "-1", "0", "2.5", "x", "${dt}", "# ", "\f", "index", "é"]


def spoil(folder: Path, turn: random.Random) -> None:
    """Change words or lines of the commands or of the data file."""
    path = folder / turn.choice(["in.column", "in.column", "column.data"])
    lines = path.read_text().split("\n")
    for _ in range(turn.choice([1, 1, 2, 4])):
        place = turn.choice([n for n, line in enumerate(lines) if line[:1] not in ("", "#")])
        words = re.split(r"(\s+)", lines[place])
        word = turn.randrange(len(words))
        how = turn.choice(["word", "word", "end", "lose", "line", "double", "number"])
        if how == "word":
            words[word] = turn.choice(SPOILT)
        elif how == "end":
            del words[word:]
        elif how == "lose":
            del words[word]
        elif how == "number":
            words[word] = re.sub(r"\d", str(turn.randrange(10)), words[word], count=1)
        lines[place] = "".join(words)
        if how == "line":
            del lines[place]
        elif how == "double":
            lines.insert(turn.randrange(len(lines)), lines[place])
    path.write_text("\n".join(lines))


def agree(folder: Path) -> None:
    """Check that `lmp` gives the motion that the reader of decks predicts."""
    deck = read_deck(folder)
    given = {*folder.iterdir(), folder / "log.lammps"}
    program = shutil.which("lmp") or str(Path(sys.executable).with_name("lmp"))
    done = subprocess.run([program, "-in", "in.column", "-screen", "none"], cwd=folder, check=False)
    assert done.returncode == 0
    (dump,) = set(folder.iterdir()) - given  # An edit may change its name.
    u, v = read_dump(dump)
    t = simulate(deck.scene, Native(deck.integrator, deck.step))
    assert len(u) == deck.scene.samples
    for field, dumped in (("displacement", u), ("velocity", v)):
        expected = getattr(t, field)
        close = max(ROUNDED, 10.0 ** (1 - deck.digits)) * np.abs(expected).max()
        assert np.abs(dumped[:, : expected.shape[1]] - expected).max() <= close


# LAMMPS starts near the equilibrium of the changed constants, not at it.
RUN_BY_LAMMPS = [edit[:3] for edit in ACCEPTED if "hertz" not in edit[1]]


@pytest.mark.parametrize(("name", "pattern", "text"), thinned(RUN_BY_LAMMPS, 9))
def test_lammps_runs_an_edited_deck_as_it_is_read(
    name: str, pattern: str, text: str, tmp_path: Path
):
    write(name, tmp_path, pattern, text)
    agree(tmp_path)


@pytest.mark.parametrize(
    ("count", "is_run"),
    [(20, False), *(pytest.param(2000, run, marks=pytest.mark.soak) for run in (False, True))],
)
@pytest.mark.slow
def test_decks_spoilt_at_random_are_read_right_or_refused(count: int, is_run: bool, tmp_path: Path):
    """In a separate soak test, `lmp` runs every deck that is accepted."""
    turn = random.Random(count)
    for case in range(count):
        folder = tmp_path / f"{case}"
        write(turn.choice(list(SCENES)), folder)
        spoil(folder, turn)
        refusal = ""
        try:
            read_deck(folder)
            if is_run:
                agree(folder)
        except InputError as error:
            refusal = str(error)
        except Exception as error:
            raise AssertionError(f"{folder}: {error}") from error
        assert all(problem.isprintable() for problem in refusal.split("\n"))
        shutil.rmtree(folder)


NO_DATA = "is not a column's data file: it needs Atoms # sphere or Atoms # hybrid, Velocities"
OFF_AXIS = r"grain 3 does not move on the axis \({}\): x, y and their velocities must be 0"
WHOLE = r"must contain a whole number from {} to 2147483647 \(got {}\)"
NO_NUMBER = "contains no number that can be read without LAMMPS"
OTHER_RUN = r"has another time step or dump format than the previous run: use the same"
ONLY = "only a deck as lmpchain deck writes it can be predicted"
REFUSED: list[tuple[str, str, str, str]] = [
    ("struck", "# time step, s", "# time step &", "must be a line of plain ASCII, without &"),
    ("struck", r"\nunits .*", r"\g<0> é", "must be a line of plain ASCII"),
    ("struck", r"(\nvariable +dump .*)\n\n(dump .*)", r"\n\2\1", "uses the variable dump before"),
    ("struck", r"\ntimestep.*", "", "has no command timestep: use a deck that lmpchain deck wrote"),
    ("struck", r"\ndump .*", "", "has no command dump out all custom"),
    ("struck", r"\ndump_modify .*", "", "has no command dump_modify out"),
    ("struck", RUN, "", "has no command run"),
    ("struck", r"\ngroup +mobile .*", "", "has no command group mobile id"),
    ("struck", r"\npair_style .*", "", "has no command pair_style"),
    ("composed", r"\nvariable +macro .*", "", "has no command variable macro"),
    ("struck", TIMESTEP, "\ntimestep 1_0e-8", NO_NUMBER),
    ("struck", TIMESTEP, "\ntimestep ${v0", NO_NUMBER),
    ("struck", TIMESTEP, "\ntimestep 1e999", "must contain a finite number"),
    ("struck", TIMESTEP, "\ntimestep", r"\(timestep\) is too short"),
    ("struck", TIMESTEP, "\ntimestep 0", r"must be a time above 0 \(got 0\)"),
    ("struck", TIMESTEP, "\ntimestep -1e-7", r"must be a time above 0 \(got -1e-07\)"),
    ("struck", RUN, "\nrun 1e2", WHOLE.format(0, 100)),
    ("struck", RUN, "\nrun 100.0", WHOLE.format(0, 100)),
    ("struck", RUN, "\nrun -100", WHOLE.format(0, -100)),
    ("struck", RUN, "\nrun 2147483648", WHOLE.format(0, r"2.14748e\+09")),
    ("struck", EVERY, "\nvariable every index 0", WHOLE.format(1, 0)),
    ("struck", EVERY, "\nvariable every index 4e1", WHOLE.format(1, 40)),
    ("struck", r"\nthermo  .*", "\nthermo -1", WHOLE.format(0, -1)),
    ("struck", RUN, "\nrun 39", r"\(run 39\) ends before the first dump, after 40 steps"),
    ("struck", RUN, "\nrun 100 every 10 NULL", "must be `run` with a number of steps"),
    ("struck", RUN, "\nrun 60\nrun 40 upto", "ends before it begins, at step 60"),
    ("struck", RUN, r"\g<0>\ntimestep 5e-8\nrun 40", rf"\(run 40\) {OTHER_RUN}"),
    ("struck", RUN, rf"\g<0>\n{FORMAT} %.9g\nrun 40", rf"\(run 40\) {OTHER_RUN}"),
    ("struck", DUMP, rf"\n{FORMAT} %.17f", r"must end in a format such as %\.17g"),
    ("composed", DUMP, rf"\g<0>\n{FORMAT} %.17f", r"must end in a format such as %\.17g"),
    ("composed", r"\nrun  +0 .*", rf"\g<0>\n{FORMAT} %.4g", "another dump format than the first"),
    ("driven", TIMESTEP, r"\g<0>\ntimestep 5e-8", "is not the variable dt, from which forces and"),
    ("struck", "index column.data", "index $data", "must be a plain path"),
    ("struck", "index column.data", "index other.data", r"there is no file .*other\.data"),
    # Commands.
    ("struck", r"mobile id 1:24", "mobile id 1:23", "moves other grains than a column of lmpchain"),
    ("struck", r"mobile id 1:24", "mobile id 3:24", "moves other grains than a column of lmpchain"),
    ("struck", r"mobile id 1:24", "mobile id 2:24", "is not `group mobile id 1:24`"),
    ("struck", r"(pair_coeff.*hertz \S+) .*", r"\1", "is not a contact that lmpchain writes"),
    ("struck", r"hertz ", "dmt ", "is not a contact that lmpchain writes"),
    ("struck", r"pair_style +granular", "pair_style gran", "is not a force that lmpchain writes"),
    ("struck", r"\npair_coeff.*", "", "is not a force that lmpchain writes"),
    ("pair style", r"(history .*) 0 dpd", r"\1 dpd", "is not a contact that lmpchain writes"),
    ("struck", r"pair_style +granular", "pair_style", "is too short"),
    ("pair style", "overlay gran.* dpd", "overlay dpd", "is too short"),
    ("pair style", r"(overlay gran.*) dpd .*", r"\1", "is not a contact that lmpchain writes"),
    ("pair style", r"hybrid/overlay", "hybrid", "is not a contact that lmpchain writes"),
    ("walls", r"(fix +bottom .*hertz ).*", r"\1x", NO_NUMBER),
    ("struck", r"\nvelocity .*", r"\g<0>\nvelocity all set 0 0 1", rf"is not `.*`: {ONLY}"),
    ("struck", RUN, "\nrun 80\nvelocity all set 0 0 1", f"is not known: {ONLY}"),
    ("struck", r"\nboundary .*", "", r"is not `boundary f f f`"),
    ("struck", r"\nboundary .*", r"\g<0>\g<0>", r"boundary f f f\) is not `newton off`"),
    ("struck", r"\nthermo  .*", r"\nrun 40\g<0>", r"\(run 40\) is not `thermo"),
    ("struck", r"\nthermo  .*", "", r"run .* is not `thermo"),
    ("struck", r"\nthermo  .*", "\nthermo 10 20", r"\(thermo 10 20\) is not `thermo"),
    ("struck", DUMP, "\ndump_modify out every 3 format float %.17g", "is not `dump_modify out"),
    ("composed", r"\njump +SELF step\n", "\n", "lacks `jump SELF step`"),
    ("composed", r"\nrun  +0 .*", r"\g<0>\nrun 5", r"\(run 5\) is not "),
    ("composed", r"\nrun  +0 .*", r"\g<0>\ntimestep 5e-8", r"\(timestep 5e-8\) is not "),
    ("struck", DT, r"\g<0>\nvariable x index 3", rf"\(variable x index 3\) is not known: {ONLY}"),
    ("struck", DT, "\nvariable dt equal 5e-8", NO_NUMBER),
    ("struck", DT, "\nvariable dt index 5e-8 1e-8", NO_NUMBER),
    ("struck", r"\nvariable +dump .*", "", "is not known|lacks `variable dump|is not `"),
    ("driven", r"\nvariable +amplitude .*", "", "grain 1 .*|is not|lacks"),
    # The data file.
    ("struck", r"(1 atom types)\n", r"\1\nx\n", "does not have the header of a column of 25"),
    ("struck", r"(densities in .*)\n", r"\1 and\nmore\n", NO_DATA),
    ("struck", "\n\nRest\n", "\n\nCharges\n", NO_DATA),
    ("struck", "\n\nRest\n", "\n\n1 2\n\nRest\n", NO_DATA),
    ("struck", r"\n\nRest\n[\s\S]*", "\n", NO_DATA),
    ("struck", "Atoms # sphere", "Atoms # disc", NO_DATA),
    ("struck", r"\n3 0 0 (.*)\n", r"\n30 0 0 \1\n", NO_DATA),
    ("struck", r"\n3 0 0 ", "\n3.0 0 0 ", NO_DATA),
    ("struck", r"\n3 0 0 .*", "", NO_DATA),
    ("struck", r"\n3 0 0 .*", r"\g<0> 0", NO_DATA),
    ("struck", r"\n3 0 0 \S+", "\n3 0 0 nan", NO_DATA),
    ("struck", r"\n3 0 0 \S+", "\n3 0 0 1e999", NO_DATA),
    ("struck", r"(\n3 1 \S+ \S+ 0 0 .*)", r"\1 0", NO_DATA),
    ("struck", r"(\n3 1 \S+ \S+) 0 0", r"\1 1e-5 0", OFF_AXIS.format("Atoms")),
    ("struck", r"(\n3 1 \S+ \S+) 0 0", r"\1 0 1e-5", OFF_AXIS.format("Atoms")),
    *(
        ("struck", r"\n3 0 0 -0.0 0 0 0", f"\n3 {row}", OFF_AXIS.format("Velocities"))
        for row in ("9 0 0 0 0 0", "0 9 0 0 0 0", "0 0 0 9 0 0", "0 0 0 0 9 0", "0 0 0 0 0 9")
    ),
    *(
        ("pair style", r"(\n3 1) 0 0 (\S+ \S+ \S+) 0 0 0", rf"\1 {row}", OFF_AXIS.format("Atoms"))
        for row in (r"9 0 \2 0 0 0", r"0 9 \2 0 0 0", r"0 0 \2 9 0 0", r"0 0 \2 0 0 9")
    ),
    ("struck", r"\n3 0 0 -0.0 ", "\n3 0 0 1e-4 ", "grain 3 starts with -0.0001, in the scene 0"),
    ("pushed", r"\n3 0 0 \S+ ", "\n3 0 0 -2.0 ", "grain 3 starts with 2, in the scene 0: give"),
    ("struck", r"hertz \S+", "hertz 43100e6", r"overlap by \S+ m at rest, but by .* gravity, load"),
    ("struck", r"(\n[34] 1 \S+) 2426.0 ", r"\1 5000.0 ", "grains 3 and 4 overlap by"),
    ("struck", r"\nvariable +g .*", "\nvariable g index 9.9", "grains 1 and 2 overlap|overlap by"),
    ("struck", "25 atoms", "24 atoms", "does not have the header of a column of 25 grains"),
    ("struck", "1 atom types", "2 atom types", "does not have the header of a column"),
    ("struck", r"(\S+) (\S+) xlo xhi", r"\1 1.0 xlo xhi", "does not have the header of a column"),
    ("struck", r"(\S+) (\S+) ylo yhi", r"-1.0 \2 ylo yhi", "does not have the header of a column"),
    ("struck", r"(\S+) (\S+) zlo zhi", r"\1 1.0 zlo zhi", "does not have the header of a column"),
    ("struck", r"\n1 atom types", "", "does not have the header of a column"),
    ("struck", r"\n3 1 ", "\n3 2 ", "grain 3 differs in the types from lmpchain's deck, 1"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "pattern", "text", "message"), REFUSED)
def test_other_edits_are_refused_with_their_place(
    name: str, pattern: str, text: str, message: str, tmp_path: Path
):
    write(name, tmp_path, pattern, text)
    with pytest.raises(InputError, match=message) as refused:
        read_deck(tmp_path)
    assert str(refused.value).isprintable()
    assert re.match(r".*/(in\.column|column\.data): |deck: ", str(refused.value))
