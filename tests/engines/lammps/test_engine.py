"""The LAMMPS engine: the deck in a run folder, what it supports, and the expected time."""

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import paper
from helpers.standalone_lammps import small

from lmpchain import Drive, Force, InputError, Law, Scene, laws, simulate
from lmpchain.engines import Lammps, Native
from lmpchain.engines.lammps.deck_reader import read_deck
from lmpchain.engines.lammps.engine import gauge_diameter
from lmpchain.engines.lammps.export import write_deck
from lmpchain.integrators.methods import SPLITTINGS

PUSHED = small(Force(grain=3, amplitude=1e-3, frequency=5e4))
TIMED = small(ground=laws.mathieu(1e6, depth=0.6, frequency=2e5))
DAMPED = small(damping={"viscoelastic": 1e-8})
# Scene, options, and the integrator and number of evaluations per step of the deck in a run folder.
INPUTS: dict[str, tuple[Scene, dict[str, Any], str]] = {
    "a deck cannot express the kicks": (small(), {"integrator": "rkn6"}, "verlet"),
    "a loop of velocity Verlet": (small(), {"integrator": "kahan-li6"}, "kahan-li6"),
    "a deck cannot set the time": (PUSHED, {"integrator": "kahan-li6"}, "verlet"),
    "a force": (PUSHED, {"integrator": "verlet"}, "verlet"),
    "a ground that depends on the time": (TIMED, {"integrator": "kahan-li6"}, "verlet"),
    "damping": (DAMPED, {}, "verlet"),
    "gauge": (small(), {"integrator": "verlet", "diameter": "gauge"}, "verlet"),
    # No bound on the overlaps is known without a trial.
    "gauge under a force": (PUSHED, {"integrator": "verlet", "diameter": "gauge"}, "verlet"),
    "pair style": (small(), {"integrator": "verlet", "pair_style": "gran/hertz/history"}, "verlet"),
}


@pytest.mark.parametrize("name", INPUTS)
def test_the_deck_in_a_run_folder_costs_as_much_as_the_run(name: str, tmp_path: Path):
    scene, options, integrator = INPUTS[name]
    engine = Lammps(step=1.1e-7, **{"diameter": "physical"} | options)
    proposal = engine.propose(scene, 1e-3)
    engine.write_inputs(scene, proposal, 1e-3, tmp_path)
    assert sorted(path.name for path in (tmp_path / "deck").iterdir()) == [
        "column.data", "in.column",
    ]  # fmt: skip
    deck = read_deck(tmp_path / "deck", scene)
    assert deck.integrator == integrator
    used = engine.splitting(scene).name
    evaluations = 1 if integrator == used else SPLITTINGS[used].evaluations
    interval = scene.sampling_interval
    # A whole number of steps covers the interval between two samples.
    count = math.ceil(interval / (proposal.step / evaluations) * (1 - 1e-9))
    assert deck.step == pytest.approx(interval / count, rel=1e-12)
    gauge = options.get("diameter") == "gauge" and scene is not PUSHED
    assert deck.gauge == (pytest.approx(gauge_diameter(scene), rel=1e-12) if gauge else 0.0)
    text = (tmp_path / "deck" / "in.column").read_text()
    assert f"pair_style      {options.get('pair_style', '')}" in text or scene is DAMPED
    # A deck of the user is not replaced.
    (tmp_path / "deck" / "in.column").write_text("# my own\n")
    with pytest.warns(UserWarning, match="the deck cannot be written: folder: .* was edited"):
        engine.write_inputs(scene, proposal, 1e-3, tmp_path)
    assert (tmp_path / "deck" / "in.column").read_text() == "# my own\n"


def test_a_log_in_a_folder_that_lammps_cannot_name_is_left_out(tmp_path: Path):
    engine = Lammps("verlet", 1e-7)
    with pytest.warns(UserWarning, match="log.lammps cannot be written: .* rename the folder"):
        prepared = engine.prepare(tmp_path / "a $x")
    assert (prepared.log, prepared.run_folder) == (None, tmp_path / "a $x")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        prepared = engine.prepare(tmp_path)
    assert (prepared.log, prepared.run_folder) == (tmp_path / "log.lammps", tmp_path)
    assert engine.log is engine.run_folder is None


@pytest.mark.parametrize("integrator", ["verlet", "rkn6"])
def test_the_log_of_a_run_folder(integrator: str, tmp_path: Path):
    """Each drift of a splitting is a run of LAMMPS, whose messages would fill the log."""
    scene = small(grains=5).replace(duration=4e-6, samples=3)
    for _ in range(2):
        prepared = Lammps(integrator, 1e-7).prepare(tmp_path)
        simulate(scene, prepared)
    log = (tmp_path / "log.lammps").read_text()
    assert log.count("\nread_data") == 2
    assert (log.count("\nrun") > 4) == (integrator == "verlet")


def test_scenes_and_options_that_are_refused():
    law = Law("k*max(o, 0)**1.5", k=1e9)
    open_law = Law("k*tanh(b*o)*exp(-(b*o)**2)*(1 + o**2)", k=1e3, b=1e3)
    history = {"pair_style": "gran/hertz/history"}
    refused: list[tuple[Scene, dict[str, Any], str, str]] = [
        (DAMPED, {"integrator": "rkn6"}, "integrator", "damping requires verlet"),
        (DAMPED, {"integrator": "kahan-li6"}, "integrator", "leave the integrator out"),
        (small(exponent=2.0), {}, "exponent", r"supports only 1\.5 and 1 \(got 2\)"),
        (small(exponent=1.0), history, "exponent", r"history in LAMMPS supports only 1\.5 \(got 1"),
        (small(law=law), history, "pair_style", "law by formula: leave it out"),
        (small(law=open_law), {}, "force", "no energy in closed form"),
        (small(), {"ranks": 26}, "ranks", r"at most one per grain, 25 \(got 26\)"),
        (small(law=law), {"ranks": 26}, "ranks", r"at most one per grain, 25 \(got 26\)"),
    ]
    for scene, options, key, reason in refused:
        engine = Lammps(**options)
        ((found, _),) = engine.refuses(scene)
        assert found == key
        with pytest.raises(InputError, match=f"{key}: .*{reason}"):
            simulate(scene, engine)
    for scene, options in (
        (DAMPED, {}),
        (DAMPED, {"integrator": "verlet", **history}),
        (small(exponent=1.0), {}),
        (small(), history),
        (small(law=law), {"integrator": "rkn6"}),
        (small(), {"ranks": 25}),
    ):
        assert Lammps(**options).refuses(scene) == []
    for ranks in (0, -1, True, 2.0, "2"):
        with pytest.raises(InputError, match=r"ranks: must be a whole number from 1 \(got "):
            Lammps(ranks=ranks)


def test_damping_selects_verlet_unless_an_integrator_is_given():
    assert Lammps().splitting(DAMPED).name == "verlet"
    assert Lammps().splitting(small()).name == Lammps().integrator == "rkn6"
    assert Lammps("kahan-li6").splitting(small()).name == "kahan-li6"
    assert Lammps().options()["integrator"] is None
    assert Lammps("kahan-li6").options()["integrator"] == "kahan-li6"


def test_the_expected_time_of_the_trial_is_that_of_a_native_run_to_half_the_tolerance():
    scene = paper("fig5 g", 3)
    for integrator in ("verlet", "rkn6"):
        native = Native(integrator, adaptive=False).propose(scene, 5e-5).cost_s
        expected = Lammps(integrator).trial_s(scene, 1e-4)
        assert expected == pytest.approx(native, rel=1e-12)
    assert math.isinf(Lammps().trial_s(scene, 1e-40))


def test_parts_of_the_expected_time():
    """A drift is a run of its own; formulas and viscosity take their time for every step."""

    def work(scene: Scene, integrator: str = "verlet") -> float:
        engine = Lammps(integrator, step=1e-7, diameter="physical")
        proposal = engine.propose(scene, 1e-3)
        steps = proposal.steps.total(scene.intervals) * SPLITTINGS[integrator].evaluations
        return (proposal.cost_s - engine.start_up_s) / steps

    law = Law("k*max(o, 0)**1.5", k=1e9)
    ground = Law("k*u", k=3e5)
    long, longer = (small(grains=grains) for grains in (2000, 4000))
    plain = work(long)
    assert work(longer) == pytest.approx(2 * plain, rel=0.1)
    assert 1.4e-5 < work(long, "rkn6") - plain < 1.8e-5
    viscous = long.replace(chain=long.chain.replace(law=law, damping={"viscoelastic": 1e-8}))
    elastic = long.replace(chain=long.chain.replace(law=law))
    assert work(viscous) - work(elastic) == pytest.approx(1e-6 * 2000, rel=0.1)
    on_ground = long.replace(chain=long.chain.replace(ground=ground))
    assert work(on_ground) == pytest.approx(2 * plain, rel=0.1)


def test_a_refused_deck_is_not_written(tmp_path: Path):
    scene = paper("weak", 3)
    assert "cannot be met" not in write_deck(scene, tmp_path / "a", tolerance=1e-2).read_text()
    for options, key in (
        ({"tolerance": 0.0}, "tolerance"),
        ({"integrator": "rkn6"}, "integrator: a deck cannot contain the kicks of rkn6"),
        ({"pair_style": "gran"}, "pair_style"),
    ):
        with pytest.raises(InputError, match=f"^{key}: "):
            write_deck(scene, tmp_path / "c", **options)
    with pytest.raises(InputError, match="exponent: "):
        write_deck(small(exponent=2.0), tmp_path / "c")
    assert not (tmp_path / "c").exists()


def test_a_deck_has_as_many_steps_as_lammps_counts_in_a_run(tmp_path: Path):
    most = 2**31 - 1
    pair = small(grains=2)
    write_deck(pair.replace(duration=most * 1e-9, samples=2), tmp_path / "most", step=1e-9)
    assert read_deck(tmp_path / "most").scene.samples == 2
    for count, samples, options, message in (
        (
            most + 1,
            3,
            {},
            f"duration: {most + 1} steps are more than LAMMPS counts in a run, {most}",
        ),
        (
            most + 1,
            2,
            {},
            f"samples: must be more: {most + 1} steps per sample exceed the limit of",
        ),
        # Each step of this method of Kahan and Li is nine steps of LAMMPS.
        (4e8, 2, {"integrator": "kahan-li6"}, "duration: 3600000000 steps are more than LAMMPS"),
    ):
        long = pair.replace(duration=count * 1e-9, samples=samples)
        with pytest.raises(InputError, match=f"^{message}"):
            write_deck(long, tmp_path / "more", step=1e-9, **options)
        assert not (tmp_path / "more" / "in.column").exists()


@pytest.mark.parametrize("alike", ["physical", "gauge"])
def test_the_choice_of_the_diameter_requires_both(alike: str):
    """Unlike grains have one stiffness with equal materials, or at one gauge diameter."""
    unlike = np.linspace(1e-3, 2e-3, 25)
    one_constant = {"contact_constants": np.full(24, 1e9), "exponent": 1.5}
    scene = small(diameter=unlike, **(one_constant if alike == "gauge" else {}))
    for diameter in ("physical", "gauge", "auto"):
        engine = Lammps("verlet", 1e-7, diameter, "gran/hertz/history")
        assert [key for key, _ in engine.refuses(scene)] == (
            [] if diameter == alike else ["contact_constants"]
        )


def test_the_rounding_error_of_a_given_step_may_equal_its_truncation_error():
    for step, diameter in ((1e-7, "physical"), (3e-10, "gauge")):
        proposal = Lammps("verlet", step=step).propose(small(), 1e-6)
        assert proposal.choices["diameter"] == diameter
        assert "the error of the given step is" in str(proposal.choices["why"])
        assert math.isinf(proposal.tolerance)


def test_what_a_run_records():
    for engine, recorded in (
        (Lammps("verlet", 1e-7), {"pair_style": "granular"}),
        (Lammps("verlet", 1e-7, include="thermo 5\n"), {"include": "thermo 5\n"}),
    ):
        scene = small(Drive(amplitude=1e-8, frequency=5e4))
        found = engine.describe(scene, engine.propose(scene, 1e-3))
        assert recorded.items() <= found.items()
        assert set(found) - set(recorded) <= {"pair_style", "lammps"}
        assert found["lammps"] >= "20250722"
