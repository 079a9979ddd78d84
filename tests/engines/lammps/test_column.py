"""A scene in LAMMPS terms: heights, walls, constants and formulas of the forcing.

And what the engine chooses and refuses.
"""

import math
import sys
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import paper, scene_of, struck
from helpers.standalone_lammps import small

from lmpchain import (
    Chain,
    Displacement,
    Drive,
    EngineUnavailable,
    Impulse,
    InputError,
    Law,
    RunFailed,
    ToleranceNotMet,
)
from lmpchain.engines import Lammps
from lmpchain.engines.base import ErrorBudget
from lmpchain.engines.lammps import communicators, library, subprocess_ranks
from lmpchain.engines.lammps.column import Contact, LammpsColumn
from lmpchain.engines.lammps.engine import gauge_diameter
from lmpchain.engines.lammps.stepper import word
from lmpchain.engines.lammps.viscosity import LammpsGround
from lmpchain.integrators.methods import SPLITTINGS
from lmpchain.util import mpi

UNLIKE = Chain(
    grains=5,
    diameter=[1e-3, 2e-3, 1.5e-3, 1e-3, 3e-3],
    top="wall",
    bottom="wall",
    top_load=0.3,
    gravity=9.81,
)


def lammps_column(
    excitation=None, gauge: float = 0.0, style: str = "granular", **chain
) -> LammpsColumn:
    made = UNLIKE.replace(**chain)
    excitation = excitation or Impulse(velocity=1e-3, grain=2)
    return LammpsColumn(scene_of(made, excitation, 1e-5, 3), gauge, style)


def test_every_gap_is_within_the_skin_and_every_grain_within_the_box():
    for excitation in (None, Displacement(displacement=-1e-3), Displacement(displacement=2e-6)):
        made = lammps_column(excitation, gravity=0.0, top_load=0.0, top="free", bottom="free")
        z, _ = made.start
        gaps = z[:-1] - z[1:] - (made.diameters[:-1] + made.diameters[1:]) / 2
        margin = (made.skin - max(gaps.max(), 0)) / made.diameters.max()
        assert 0.2 <= margin * (1 + 1e-12) <= 0.5
        left, right, low, high = made.box
        assert left == -right
        assert right == pytest.approx(made.diameters.max() + made.skin, rel=1e-12)
        assert [z.min() - low, high - z.max()] == pytest.approx([right, right], rel=1e-9)


def test_each_kind_of_contact_below_each_type_is_looked_for_once(monkeypatch):
    """A column of a million grains has few kinds; comparing each contact would take 7 s."""
    compared = []
    same = Contact.same
    monkeypatch.setattr(Contact, "same", lambda *pair: compared.append(pair) or same(*pair))
    chain = column(3000, material=["steel", "ptfe", "ptfe"] * 1000)
    made = LammpsColumn(struck(chain, 1e-3, 1e-5), 0.0)
    lines = (line.split() for line in made.coefficients[1:])
    stiffness = {(int(i), int(j)): float(k) for i, j, _, k, *_ in lines}
    pairs = [tuple(sorted(pair)) for pair in pairwise(made.types)]
    np.testing.assert_allclose(
        [stiffness[pair] * math.sqrt(2.5e-4) for pair in pairs], chain.contact_constants, rtol=1e-13
    )
    assert made.type_count == max(made.types) <= 3
    assert len(compared) < 30


def test_contacts_that_differ_by_rounding_share_a_type():
    for change, types in ((5e-15, 1), (5e-14, 2)):
        constants = np.full(4, 1e9)
        constants[2] *= 1 + change
        made = lammps_column(contact_constants=constants, exponent=1.5, diameter=1e-3)
        assert made.type_count == types


def test_moving_grains_have_one_drag_and_one_mass():
    rates = np.array([9.0, 2.0, 2.0, 2.0, 7.0])
    driven = Drive(amplitude=1e-9, frequency=1e4)
    options = {"damping": {"drag": rates}, "top": "free", "bottom": "fixed", "top_load": 0.0}
    made = lammps_column(driven, **options)
    assert (made.drag, made.drag_on_all, made.mobile) == (2.0, None, (2, 4))
    for change, alike in ((1e-15, True), (1e-13, False)):
        masses = [5e-6, 1e-6, 1e-6 * (1 + change), 1e-6, 3e-6]
        heavy = lammps_column(driven, **options, masses=masses).drag_on_all
        assert heavy == (pytest.approx(2e-6) if alike else None)
    with pytest.raises(InputError, match=r"chain\.damping\.drag: LAMMPS supports one number"):
        _ = lammps_column(**options).drag
    # A load on a grain that is driven, or by a wall, is no force of the deck.
    for excitation, chain, load in (
        (None, {}, 0.0),
        (None, {"top": "free"}, 0.3),
        (driven, {"top": "free"}, 0.0),
        (driven, {"top": "free", "load_grain": 2}, 0.3),
    ):
        assert lammps_column(excitation, **chain).load == load


def test_equal_springs_of_the_ground_pull_grains_back_to_their_place():
    """Any other ground is a formula."""
    for law, rests, stiffness in (
        (Law("k*u", k=3e5), True, 3e5),
        (Law("k*u", k=3e5), False, 0.0),
        (Law("k*u", k=-3e5), True, 0.0),
        (Law("k*u", k=[3e5, 2e5]), True, 0.0),
        (Law("k*u + b*u**3", k=3e5, b=1e21), True, 0.0),
        (Law("k*u*cos(w*t)", k=3e5, w=1e4), True, 0.0),
    ):
        assert LammpsGround(law, rests).spring == stiffness


# --- choices


def test_the_gauge_diameter_is_three_times_the_largest_overlap_or_more():
    scene = paper("fig5 g", 3)
    deepest = scene.chain.contacts.overlap_bound(scene.energy).max()
    assert gauge_diameter(scene) == pytest.approx(3 * deepest, rel=1e-12)
    driven = small(Drive(amplitude=1e-9, frequency=3e4))
    expected = 3 * (driven.chain.contacts.overlap.max() + 2e-9)
    assert gauge_diameter(driven, 2e-9) == pytest.approx(expected, rel=1e-12)


def test_round_off_in_heights_is_predicted_from_their_last_digit():
    """The error is a random walk in the evaluations; in velocities it is times the frequency."""
    scene = paper("fig5 g", 3)
    omega = scene.highest_frequency
    digit, shrunk = (np.spacing(np.abs(LammpsColumn(scene, g).heights).max()) for g in (0.0, 1e-6))

    def lost(
        size: float, speed: float, gauge: float = 0.0, steps: int = 10_000, name: str = "verlet"
    ) -> float:
        return Lammps(name).round_off(scene, gauge, steps, np.array([size, speed]))

    alone = lost(1e-9, 0.0)
    assert 0.3 < alone / (100 * digit / 1e-9) < 1.0
    evaluations = SPLITTINGS["rkn6"].evaluations / SPLITTINGS["verlet"].evaluations
    for other, ratio in (
        (lost(1e-9, 0.0, steps=40_000), 2),
        (lost(0.0, 1e-3), 1e-9 * omega / 1e-3),
        (lost(1e-9, 0.0, gauge=1e-6), shrunk / digit),
        (lost(1e-9, 0.0, name="rkn6"), math.sqrt(evaluations)),
    ):
        assert other == pytest.approx(alone * ratio, rel=1e-12)
    typical = Lammps("verlet").typical_round_off(scene, 10_000, 1e-3)
    assert typical == pytest.approx(0.16 * 100 * digit * omega / 1e-3, rel=0.02)
    gauge = Lammps("verlet", diameter="gauge").typical_round_off(scene, 10_000, 1e-3)
    assert gauge < typical / 10


def test_the_gauge_diameter_is_used_if_the_physical_one_is_too_coarse():
    scene = paper("weak", 3)
    loose, tight = (Lammps().propose(scene, tolerance) for tolerance in (1e-2, 1e-6))
    assert (loose.choices["diameter"], loose.choices["drawn_m"]) == ("physical", 0.0)
    assert tight.choices["diameter"] == "gauge"
    assert tight.choices["drawn_m"] == tight.choices["gauge_m"] == gauge_diameter(scene)
    assert tight.record()["drawn_m"] == repr(gauge_diameter(scene))
    assert "the tolerance is 1e-06" in tight.choices["why"]
    assert "round-off in heights is about" in tight.choices["why"]
    assert tight.solver_error <= 1e-6
    # Half of the tolerance is for rounding, which is nearly all of the error here.
    for share, diameter in ((2.1, "physical"), (1.9, "gauge")):
        proposal = Lammps().propose(scene, share * loose.solver_error)
        assert proposal.choices["diameter"] == diameter
    cure = "above the tolerance of 1e-06: use the gauge diameter, with an error of .*, or use"
    with pytest.raises(ToleranceNotMet, match=cure):
        Lammps(diameter="physical").propose(scene, 1e-6)
    with pytest.raises(ToleranceNotMet, match=r'integrator "rkn6", which needs far fewer steps'):
        Lammps("verlet").propose(scene.replace(duration=1e-5), 1e-10)


def test_a_run_with_too_coarse_heights_is_repeated_with_the_gauge():
    engine = Lammps()
    candidate = engine.propose(paper("weak", 3), 1e-2)
    missed = ErrorBudget(1e-9, 0.6e-2, 6.0)
    better = engine.refine(candidate, missed, 1e-2)
    assert better.choices["diameter"] == "gauge"
    assert better.choices["why"] == "with the physical diameter, round-off was 0.006"
    assert better.steps.per_landing == candidate.steps.per_landing
    shorter = engine.refine(candidate, missed._replace(roundoff=0.4e-2, truncation=0.1), 1e-2)
    assert shorter.step < candidate.step
    rounded = missed._replace(roundoff=1.0)
    assert Lammps(diameter="physical").refine(candidate, rounded, 1e-2) is None


def test_remarks_at_the_head_of_a_deck():
    engine = Lammps("verlet", step=1e-7, diameter="physical")
    scene = paper("weak", 3)
    made = engine.column(scene, engine.propose(scene, 1e-6), "one more")
    assert made.remarks == (
        "physical diameter: as asked", "verlet, expected error not estimated beforehand",
        "one more",
    )  # fmt: skip
    estimated = Lammps().propose(scene, 1e-6)
    assert (
        Lammps().column(scene, estimated).remarks[1]
        == f"rkn6, expected error {estimated.solver_error:.1g}"
    )


def test_invalid_options():
    with pytest.raises(InputError, match="diameter: must be auto"):
        Lammps(diameter="small")
    for options in ({"keep": "x"}, {"keep": "x", "include": __file__}):
        kept = Lammps("verlet", **options)
        assert kept.whole
        fault = "LAMMPS cannot continue with this option after a stop"
        with pytest.raises(InputError, match=fault) as refused:
            kept.options()
        assert [key for key, _ in refused.value.faults] == list(options)
    assert not Lammps().whole
    assert Lammps(include=__file__).integrator == "verlet"
    assert Lammps(step=1e-7).options() == {
        "integrator": None, "step": 1e-7, "diameter": "auto", "pair_style": "granular",
        "ranks": None,
    }  # fmt: skip


def test_escaping_of_command_words(tmp_path):
    assert word(tmp_path) == str(tmp_path)
    for character in "\"'$&#{}*%\n\té":
        with pytest.raises(InputError, match="rename the folder"):
            word(tmp_path / f"a{character}b")


# --- ranks and the library


def test_choice_of_communicator(monkeypatch):
    for kind in ("Serial", "SubprocessRanks", "MpiRanks"):
        monkeypatch.setattr(subprocess_ranks, kind, lambda *given, kind=kind: (kind, *given))
    gather = subprocess_ranks.gather
    assert gather(None, "none") == gather(1, "none") == ("Serial", "none")
    assert gather(2, "none") == ("SubprocessRanks", 2, "none")
    world = SimpleNamespace(size=3)
    monkeypatch.setattr(mpi, "count_processes", lambda: 3)
    monkeypatch.setattr(mpi, "current_world", lambda: world)
    assert gather(None, "none") == gather(3, "none") == ("MpiRanks", world, "none")
    fault = "ranks: mpirun has started 3 processes: leave the number of ranks out"
    with pytest.raises(InputError, match=fault):
        gather(2, "none")
    monkeypatch.setattr(mpi, "current_world", lambda: None)
    assert gather(1, "none") == ("Serial", "none")
    with pytest.raises(InputError, match=fault):
        gather(3, "none")


def test_errors_of_lammps_are_distinguished_from_others(monkeypatch):
    closed = []

    class Failing:
        def __init__(self, *_):
            pass

        def commands(self, text):
            raise Exception(text)

        def close(self):
            closed.append(self)

    monkeypatch.setattr(communicators, "Worker", Failing)
    monkeypatch.setattr(mpi, "alone", lambda: None)
    serial = communicators.Serial("none")
    assert serial.ranks == 1
    for kind, text, message in (
        (RunFailed, "ERROR: Lost atoms", r"^LAMMPS stopped: ERROR: Lost atoms$"),
        (Exception, "a minute is over", r"^a minute is over$"),
    ):
        with pytest.raises(kind, match=message):
            serial.ask("commands", text)
    serial.close()
    assert len(closed) == 1


def test_requirements_on_the_library(monkeypatch):
    class Old:
        tested = library.TESTED
        packages = True
        closed = 0

        def __init__(self, cmdargs, comm):
            assert cmdargs == ["-log", "none", "-screen", "none", "-nocite"]

        def has_package(self, name):
            assert name == "GRANULAR"
            return self.packages

        def version(self):
            return self.tested

        def close(self):
            Old.closed += 1

    monkeypatch.setitem(sys.modules, "lammps", SimpleNamespace(lammps=Old))
    cleaned: list[str] = []
    for name in ("unname_shared_memory", "remove_leftovers"):
        monkeypatch.setattr(mpi, name, lambda name=name: cleaned.append(name))
    for processes in (1, 2):
        monkeypatch.setattr(mpi, "count_processes", lambda number=processes: number)
        assert isinstance(library.open_lammps(), Old)
    # Other processes may still need the name of the shared memory.
    assert cleaned == ["unname_shared_memory", "remove_leftovers", "remove_leftovers"]
    Old.tested -= 1
    older = f"LAMMPS {library.TESTED - 1} is older than the tested {library.TESTED}"
    with pytest.warns(UserWarning, match=older):
        library.open_lammps()
    Old.packages = False
    with pytest.raises(EngineUnavailable, match="has no GRANULAR package"):
        library.open_lammps()
    assert Old.closed == 1
