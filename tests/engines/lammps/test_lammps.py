"""Features of the LAMMPS engine: decks, dumps, diameters, grain types and unreported faults."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from helpers.checked_lammps import check_deck
from helpers.example_chains import column
from helpers.example_scenes import paper, scene_of, struck
from helpers.standalone_lammps import lmp, read_dump, small
from helpers.thinned import thinned

from lmpchain import (
    Chain,
    Displacement,
    Drive,
    EngineUnavailable,
    Force,
    Impulse,
    Impurity,
    InputError,
    Profile,
    RunFailed,
    Scene,
    simulate,
)
from lmpchain.engines import Lammps, Native
from lmpchain.engines.lammps import communicators, deck, library
from lmpchain.engines.lammps.column import LammpsColumn
from lmpchain.engines.lammps.export import write_deck
from lmpchain.engines.lammps.stepper import LammpsStepper
from lmpchain.engines.lammps.subprocess_ranks import gather
from lmpchain.engines.lammps.worker import LocalState, Worker
from lmpchain.integrators.methods import VERLET
from lmpchain.integrators.steps import Steps

DECKS = {
    "impulse": small(),
    "load": small(gravity=0.0, top_load=0.02),
    "vacuum": small(gravity=0.0, bottom="free"),
    "displacement": small(Displacement(displacement=-3e-8, grain=7)),
    "springs": small(exponent=1.0),
    "unequal": small(
        Profile(velocity=np.linspace(1e-3, 0, 25)),
        diameter=np.linspace(1e-3, 2e-3, 25),
        material=["glass", "steel", "ptfe", "brass", "glass"] * 5,
        masses=np.linspace(1e-6, 3e-6, 25),
    ),
    "walls": small(top="wall", top_load=0.02, bottom="wall", bottom_material="steel"),
    "loose wall": small(Impulse(velocity=-8.57e-4, grain=3), top="wall", bottom="wall"),
    "springs between walls": small(
        exponent=1.0, top="wall", bottom="wall", gravity=0.0, top_load=0.02
    ),
    "impurity": small(
        impurity=[
            Impurity(grain=3, diameter=0.7e-3, material="steel"),
            Impurity(grain=9, mass=5e-6),
        ]
    ),
    "harmonic drive": small(Drive(amplitude=3e-8, frequency=5e4), top_load=0.02),
    "sampled drive": small(
        Drive(times=np.linspace(0, 2.1e-5, 8), displacement=3e-8 * np.sin(np.arange(8.0)) ** 2)
    ),
}


WAYS = [("verlet", "physical"), ("verlet", "gauge"), ("kahan-li6", "gauge")]


@pytest.mark.parametrize(
    ("name", "integrator", "diameter"),
    [
        # The default selection runs every other deck in one of the ways.
        pytest.param(
            name, *way, marks=() if place == number % 3 and number % 2 == 0 else pytest.mark.slow
        )
        for number, name in enumerate(DECKS)
        for place, way in enumerate(WAYS)
    ],
)
def test_a_complete_deck_gives_the_bytes_of_the_library(tmp_path, name, integrator, diameter):
    options = {"step": 1e-7, "integrator": integrator, "diameter": diameter}
    if DECKS[name].drive and integrator != "verlet":
        with pytest.raises(InputError, match="must be verlet in a deck with a drive or a force"):
            write_deck(DECKS[name], tmp_path, **options)
    else:
        check_deck(DECKS[name], tmp_path, **options)


AGREEING = {
    # The burst and the half-sine end within a step.
    "burst": small(Drive(amplitude=3e-8, frequency=1e5, cycles=1.303), top_load=0.02),
    **DECKS,
    "force": small(Force(grain=3, amplitude=1e-3, frequency=5e4), top_load=0.02),
    "half-sine": small(
        Force(grain=3, shape="half-sine", amplitude=1e-3, duration=7.03e-6), top_load=0.02
    ),
    "sampled force": small(
        Force(times=np.linspace(0, 2.1e-5, 8), force=1e-3 * np.sin(np.arange(8.0)) ** 2, grain=3)
    ),
    "driven wall": small(Drive(grain=0, amplitude=3e-8, frequency=5e4), top="wall", top_load=0.02),
}


@pytest.mark.parametrize("integrator", ["verlet", "kahan-li6", "rkn6"])
@pytest.mark.parametrize("name", thinned(AGREEING, 2))
def test_lammps_agrees_with_the_native_engine(name: str, integrator: str):
    """Masses, constants, walls, loads and forcing of a column are those of the scene."""
    engines = Native(integrator, 1e-7), Lammps(integrator, 1e-7, "gauge")
    ours, theirs = (simulate(AGREEING[name], engine) for engine in engines)
    for field in ("displacement", "velocity"):
        motion = getattr(ours, field)
        # The rounding of heights.
        off = 1e-10 * np.abs(motion).max()
        np.testing.assert_allclose(getattr(theirs, field), motion, rtol=0, atol=off)


def test_variables_of_a_deck_can_be_set_on_the_command_line(tmp_path):
    write_deck(small(), tmp_path, step=1e-7)
    t = simulate(small(Impulse(velocity=1e-5)), Lammps("verlet", 5e-8, "physical"))
    every = t.cost.steps // 5
    values = {"v0": 1e-5, "dt": t.cost.step_s, "every": every, "dump": "other.lammpstrj"}
    lmp(tmp_path, *(word for name, value in values.items() for word in ("-var", name, str(value))))
    u, v = read_dump(tmp_path / "other.lammpstrj")
    assert np.array_equal(u, t.displacement)
    assert np.array_equal(v, t.velocity)


def test_a_deck_states_the_choices_and_reasons(tmp_path):
    text = write_deck(paper("weak", samples=3), tmp_path / "weak").read_text()
    assert "physical diameter: round-off in heights is about" in text
    assert "the tolerance of 1e-06 cannot be met: LAMMPS stores heights" in text
    text = write_deck(paper("weak", samples=3), tmp_path / "auto", diameter="auto").read_text()
    assert "gauge diameter: round-off in heights is about" in text
    strong = paper("fig1", samples=3)
    text = write_deck(strong, tmp_path / "strong", tolerance=1e-4, diameter="auto").read_text()
    assert "physical diameter:" in text
    with pytest.raises(InputError, match=r"duration: would take some .* years"):
        write_deck(small().replace(duration=1e8), tmp_path / "refused", step=1e-7)
    assert not (tmp_path / "refused").exists()


@pytest.mark.parametrize(
    ("changes", "within"),
    # Unequal grains of one material have one constant with own radii, but many with gauges.
    [({}, 1e-15), ({"damping": {"viscoelastic": 3e-8}}, 1e-15),
     ({"diameter": np.linspace(1e-3, 2e-3, 25)}, 1e-14)],
)  # fmt: skip
def test_pair_styles_agree(changes: dict[str, Any], within: float):
    scene = small(Impulse(velocity=8.57e-3), **changes)
    one, other = (
        simulate(scene, Lammps("verlet", 5e-8, "physical", pair_style=style))
        for style in ("granular", "gran/hertz/history")
    )
    assert np.abs(one.displacement - other.displacement).max() < within
    assert np.abs(one.displacement).max() > 1e-8


def test_an_unsupported_splitting_leaves_no_deck(tmp_path):
    with pytest.raises(InputError, match="keep: a deck cannot contain"):
        Lammps(integrator="rkn6", keep=tmp_path)


def test_unlike_contacts_share_few_types(rng):
    """N different contacts need about sqrt(2 N) types; each contact has its own force."""
    constants = rng.uniform(1, 3, 199) * 1e9
    chain = Chain(grains=200, diameter=1e-3, contact_constants=constants, exponent=1.5)
    column = LammpsColumn(struck(chain, 1e-4, 1e-5), gauge=1e-6)
    assert max(column.types) < 40
    lines = (line.split() for line in column.coefficients[1:])
    stiffness = {(int(i), int(j)): float(k) for i, j, _, k, *_ in lines}
    given = [stiffness[min(pair), max(pair)] for pair in pairwise(column.types)]
    radius = column.diameters[0] / 4
    assert np.array(given) * np.sqrt(radius) == pytest.approx(constants, rel=1e-14)


def test_refusals_contain_the_remedy(rng):
    scene = small(contact_constants=[1e9, 1e9, 2e9, *[1e9] * 21], exponent=1.5)
    unlike = "contact_constants: contact 3 differs from those above it, and 1 grain type.*"
    with pytest.raises(InputError, match=f"{unlike} use pair_style granular"):
        simulate(scene, engine="lammps", pair_style="gran/hertz/history")
    drive = Drive(amplitude=1e-9, frequency=1e4)
    many = small(drive, grains=10_000, contact_constants=rng.uniform(1, 2, 9_999) * 1e9)
    with pytest.raises(InputError, match=r"contact_constants: .*use the native engine"):
        simulate(many, engine="lammps")
    wrong = {"diameter": "small", "pair_style": "gran", "integrator": "euler", "step": -1.0}
    for option, value in wrong.items():
        with pytest.raises(InputError, match=option):
            simulate(small(), engine="lammps", **{option: value})


def test_blow_up_is_noticed():
    """A strong strike stiffens its contact, so that a step that is stable at rest is unstable."""
    chain = column(10, material="glass")
    scene = struck(chain, 1.0, 1e-3, 11)
    step = 1.9 / chain.band_edge
    for diameter in ("physical", "gauge"):
        with pytest.raises(RunFailed, match="shorter step"):
            simulate(scene, engine=Lammps(integrator="verlet", step=step, diameter=diameter))


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_rounding_forces_in_a_vacuum_are_no_breakdown(exponent):
    """A grain is pulled away.

    There is no energy and nothing moves but the rest, by the last digits of heights.
    """
    vacuum = {"exponent": exponent, "gravity": 0.0, "bottom": "free"}
    chain = Chain(grains=9, diameter=np.linspace(1e-3, 2e-3, 9), **vacuum)
    scene = scene_of(chain, Displacement(displacement=-1e-9), 1e-5, 5)
    answer = simulate(scene, "lammps", 1e-6)
    np.testing.assert_allclose(answer.displacement[:, 0], -1e-9, rtol=1e-14)
    assert 0 < np.abs(answer.velocity).max() < 1e-6 * scene.highest_frequency * 1e-9
    assert answer.error_estimate.total >= np.abs(answer.displacement[:, 1:]).max() / 1e-9


@contextmanager
def stepping(scene: Scene, steps: int = 1, communicator: Any = None) -> Iterator[LammpsStepper]:
    """Yield a stepper of velocity Verlet with this number of steps for each sample."""
    made = LammpsColumn(scene, gauge=0.0)
    ranks = communicator or gather(1, "none")
    stepper = LammpsStepper(made, VERLET, Steps(steps, 1, 1e-7), {}, ranks)
    try:
        yield stepper
    finally:
        stepper.close()


def test_faults_that_lammps_does_not_report():
    """With a single neighbour list, LAMMPS would continue after all of these faults."""
    for spoil, message in (
        (lambda z, _: z.__setitem__(3, np.nan), "heights are not finite"),
        (lambda z, _: z.__setitem__(3, z[4]), "passed through another"),
        (lambda _, ranks: ranks.ask("commands", "set atom 4 x 1e-9"), "buckled sideways"),
    ):
        ranks = communicators.Serial("none")
        with stepping(small(), communicator=ranks) as column:
            spoil(ranks.ask("share")[0].z, ranks)
            with pytest.raises(RunFailed, match=message):
                column.fill(*np.zeros((2, 1, 1, 25)), offset=1, until=1, max_steps=1)


class Copies(communicators.Serial):
    """A communicator that returns copies of parts in any order, like that of other processes."""

    def ask(self, name: str, *values: Any) -> list[Any]:
        answers = deepcopy(super().ask(name, *values))
        if name != "share":
            return answers
        parts = [slice(7, None), slice(0), slice(7)]
        ((_, *fields, straight),) = answers
        return [LocalState(s.start or 0, *(f[s] for f in fields), straight) for s in parts]


def test_the_state_between_samples_is_that_of_the_last_step():
    """The motion of other processes is not read at every pause, and is joined from the top."""
    states = []
    for kind in (communicators.Serial, Copies):
        with stepping(small(), 100, kind("none")) as column:
            room = np.zeros((2, 1, 2, 25))
            for steps in (50, 3):
                column.fill(*room, offset=0, until=1, max_steps=steps)
            states.append(column.state())
            column.fill(*room, offset=0, until=1, max_steps=100)
            assert column.sample == 1
            states.append({"u": room[0, 0, 1], "v": room[1, 0, 1], "done": column.steps})
    for one, other in zip(states[:2], states[2:], strict=True):
        for key, values in one.items():
            assert np.array_equal(other[key], values)
    assert states[0]["done"] == 53


def test_a_breakdown_before_the_next_sample_is_detected():
    """Reading many grains costs a part of a step, so that not every pause is checked."""
    ranks = communicators.Serial("none")
    with stepping(small(), 10**6, ranks) as column:
        ranks.ask("share")[0].z[3] = np.nan
        room = np.zeros((2, 1, 1, 25))
        for _ in range(31):
            column.fill(*room, offset=1, until=1, max_steps=1)
        with pytest.raises(RunFailed, match="heights are not finite"):
            column.fill(*room, offset=1, until=1, max_steps=1)


def test_unused_data_are_not_written(tmp_path):
    """Velocities reach LAMMPS in memory; user commands and decks find them in the file."""
    scene = small()
    with deck.data_file(LammpsColumn(scene, 0.0), None) as path:
        bare = path.read_text()
    with deck.data_file(LammpsColumn(scene, 0.0, include="thermo 1"), None) as path:
        included = path.read_text()
    deck.write_data(LammpsColumn(scene, 0.0), tmp_path / "column.data")
    assert included == (tmp_path / "column.data").read_text()
    assert included.startswith(bare.rstrip())
    assert [line for line in included.splitlines() if line.isalpha()] == ["Velocities", "Rest"]
    assert "Velocities" not in bare


def test_grains_lost_during_reading_are_detected(monkeypatch):
    monkeypatch.setattr(LammpsColumn, "box", (-1e-3, 1e-3, -0.01, 0.2))
    serial, steps = communicators.Serial("none"), Steps(1, 1, 1e-7)
    closed: list[None] = []
    close = serial.close
    monkeypatch.setattr(serial, "close", lambda: closed.append(close()))
    with pytest.raises(RunFailed, match=r"LAMMPS stopped|lost grains"):
        LammpsStepper(LammpsColumn(small(), 0.0), VERLET, steps, {}, serial)
    # A run with shorter steps starts another instance.
    assert closed == [None]


def test_grains_that_an_include_deletes_are_missed():
    include = "group last id 24 25\ndelete_atoms group last\n"
    with pytest.raises(RunFailed, match="LAMMPS has lost grains: 23 of 25 are left"):
        simulate(small(), Lammps("verlet", step=1e-7, include=include))


@pytest.mark.parametrize("kind", [TimeoutError, RuntimeError, Exception])
def test_a_deadline_of_the_user_ends_a_run(kind, monkeypatch):
    """An error in a signal handler does not count as a LAMMPS failure: steps are not shortened."""
    tries = []

    def late(*_):
        tries.append(1)
        raise kind("a minute is over")

    monkeypatch.setattr(Worker, "advance", late)
    with pytest.raises(kind, match=r"^a minute is over$"):
        simulate(small(), "lammps", 1e-4)
    assert len(tries) == 1


def test_library_faults_contain_the_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "lammps", None)
    with pytest.raises(EngineUnavailable, match="pip install"):
        library.open_lammps()


def test_folder_names_cannot_contain_commands(tmp_path):
    with pytest.raises(InputError, match="rename the folder"):
        simulate(small(), engine=Lammps(integrator="verlet", keep=tmp_path / 'a" ${x}'))
    kept = tmp_path / "with blanks"
    simulate(small(), engine=Lammps(integrator="verlet", keep=kept))
    assert (kept / "column.lammpstrj").stat().st_size > 0


def test_an_edited_deck_is_not_overwritten(tmp_path):
    path = write_deck(small(), tmp_path, step=1e-7)
    write_deck(small(), tmp_path, step=5e-8)
    written = path.read_text()
    edited = written.replace("timestep", "# my own\ntimestep", 1)
    assert edited != written
    path.write_text(edited)
    with pytest.raises(InputError, match=r"folder: .*in\.column was edited"):
        write_deck(small(), tmp_path, step=1e-7)
    assert path.read_text() == edited
    path.write_text("# a deck of another origin")
    with pytest.raises(InputError, match="not written by lmpchain"):
        write_deck(small(), tmp_path, step=1e-7)
    write_deck(small(), tmp_path, step=1e-7, overwrite=True)
    assert path.read_text() != edited
    for name in ("column.data", "column.lammpstrj", "log.lammps"):
        foreign = tmp_path / f"with {name}" / name
        foreign.parent.mkdir()
        foreign.write_text("my own")
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            write_deck(small(), foreign.parent, step=1e-7)
        assert foreign.read_text() == "my own"
