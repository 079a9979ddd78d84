"""The choice of an engine, its expected cost and its reason.

Verdicts, words and numbers of a plan, the picture, calibration.
"""

import json
import math
import platform

import numpy as np
import pytest
from helpers.example_scenes import paper, scene_of

import lmpchain
from lmpchain import Chain, Impulse, InputError, Scene, ToleranceNotMet, engines, simulate
from lmpchain.engines import Native, cost_model
from lmpchain.engines.base import ErrorBudget, Proposal
from lmpchain.engines.step_control import Attempt
from lmpchain.integrators.steps import Steps
from lmpchain.simulation import planner
from lmpchain.simulation.choice import (
    cheapest,
    engine_for,
    fall_back,
    judge,
    percent,
    propose,
    reason,
    record,
)

SCENE = paper("fig5 g", 6)
NUMBER = f"{SCENE.strike_number:.2g}"


@pytest.fixture(autouse=True)
def shipped(tmp_path, monkeypatch):
    """Use the shipped costs."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    cost_model.measured.cache_clear()
    yield
    cost_model.measured.cache_clear()


def proposal(
    engine: str = "modes",
    equation: int = 3,
    model: float = 0.0,
    solver: float = 1e-9,
    cost: float = 1.0,
    **more,
) -> Proposal:
    return Proposal(engine, equation, Steps(1, 1, 1e-7), 10, model, solver, cost, **more)


def judged(equation: int = 3, tolerance: float = 1e-6, **errors) -> tuple[bool, str]:
    verdict = judge(proposal("modes", equation, **errors), SCENE, tolerance)
    return verdict.kept, verdict.why


def test_model_and_solver_error_together_must_meet_the_tolerance():
    assert judged(model=4e-7, solver=6e-7) == (True, "within the tolerance")
    left_out = f"strike number {NUMBER}: linear theory leaves out up to"
    assert judged(model=5e-7, solver=6e-7) == (False, f"{left_out} 5e-07 of the solution")
    assert judged(solver=2e-6) == (False, "its solver error is about 2e-06, above the tolerance")
    assert judged(model=0.25) == (False, f"{left_out} 25 %")
    assert judged(model=1.0) == (False, f"{left_out} 100 %")
    unknown = "the error of the homogeneous chain is not known before the run"
    assert judged(4, model=math.nan) == (False, unknown)
    assert "the continuum leaves out up to 50 %" in judged(27, model=0.5)[1]
    assert "Eq. (12) leaves out up to 50 %" in judged(12, model=0.5)[1]


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (9.9e-5, "0.0001 of the solution"),
        (3e-7, "3e-07 of the solution"),
        (1e-4, "0.01 %"),
        (0.0123, "1.2 %"),
        (0.099, "9.9 %"),
        (0.1, "10 %"),
        (0.234, "23 %"),
        (1.0, "100 %"),
    ],
)
def test_errors_are_given_in_per_cent(error, words):
    assert percent(error) == words


def test_reasons_for_the_cheapest_engine():
    kept = [
        proposal(name, eq, cost=c, kept=True)
        for name, eq, c in (("native", 1, 3.0), ("modes", 3, 1.0))
    ]
    native, modes = kept
    assert cheapest(kept).engine == "modes"
    assert reason(modes, kept) == "solves Eq. (3), the cheapest within the tolerance"
    dropped = proposal(model=0.5, why="too far off")
    plain = "solves Eq. (1), the cheapest within the tolerance"
    but = "; modes would cost less, but too far off"
    assert reason(native, [native, dropped]) == plain + but
    dearer = proposal(model=0.5, cost=4.0, why="too far off")
    refused = Proposal("bessel", 4, why="cannot do it")
    assert reason(native, [native, refused, dearer]) == plain
    with pytest.raises(ToleranceNotMet, match=r"^modes: too far off; native: too many digits$"):
        cheapest([dropped, refused, Proposal("native", 1, why="too many digits")])


def swinging(grains: int, radians: float, samples: int, strain: float = 1e-9) -> Scene:
    """Return a loaded chain with a strike on its top."""
    chain = Chain(grains=grains, diameter=1e-3, gravity=0.0, top_load=1e-2)
    scene = scene_of(chain, Impulse(velocity=1e-12), radians / chain.band_edge, samples)
    return scene.replace(excitation=scene.excitation.scaled(strain / scene.linear_strain))


@pytest.mark.parametrize(
    ("grains", "radians", "samples", "tolerance", "order"),
    [
        (20, 50.0, 11, 1e-6, "native chebyshev modes"),
        (1000, 30.0, 300, 1e-6, "native chebyshev modes"),
        (6, 1e4, 1000, 1e-6, "modes chebyshev native"),
        (6, 1e5, 11, 1e-6, "modes chebyshev native"),
        (40, 1e5, 11, 1e-3, "modes chebyshev native"),
        (1500, 5e3, 11, 1e-6, "chebyshev native modes"),
        (400, 1e4, 3, 1e-3, "chebyshev modes native"),
    ],
)
def test_the_cheapest_engine(grains, radians, samples, tolerance, order):
    """The cost of steps is per radian, of modes per grain, of the series per both."""
    scene = swinging(grains, radians, samples)
    costs = {
        name: engines.plain(name).propose(scene.reached, tolerance).cost_s
        for name in ("native", "modes", "chebyshev")
    }
    assert sorted(costs, key=lambda name: costs[name]) == order.split()


def test_engines_that_start_too_late_are_not_asked():
    short = swinging(50, 30.0, 11)
    long = swinging(50, 1e4, 11)
    every = {proposal.engine: proposal for proposal in propose(short, 1e-3, every=True)}
    assert set(every) == set(engines.names())
    native = every["native"].cost_s
    asked = [proposal.engine for proposal in propose(short, 1e-3) if proposal.possible]
    assert asked == ["native"]
    for name in ("modes", "chebyshev"):
        assert native < engines.plain(name).start_up_s < every[name].cost_s
        assert every[name].kept
        assert 0 < every[name].model_error < 1e-3
    assert {proposal.engine for proposal in propose(long, 1e-3)} == set(engines.names())
    strong = {proposal.engine: proposal for proposal in propose(SCENE, 1e-6, every=True)}
    assert strong["modes"].why.endswith("linear theory leaves out up to 100 %")
    weaker = swinging(50, 100.0, 11, strain=1e-16)
    kept = [proposal.engine for proposal in propose(weaker, 3e-14) if proposal.kept]
    assert kept == ["chebyshev"]  # Steps have a larger rounding error.


# --- the plan


def test_the_table_of_a_plan():
    choices = {"diameter": "gauge", "why": "it is finer"}
    plan = planner.Plan(
        engine="native", integrator="rkn4", active_grains=10, step=1e-7, expected_error=1e-9,
        expected_cost_s=0.5, why="is best", tolerance=1e-6, damping="it changes little",
        candidates=(
            Proposal("lammps", why="only by name; more is said in JSON"),
            proposal(model=0.5, cost=0.1, why="too far off"),
            Proposal("bessel", 4, why="cannot do it: bessel needs a strike: give one; and more"),
            proposal("lammps", 1, cost=0.7, why="within", kept=True, choices=choices),
            proposal("native", 1, cost=0.5, why="within", integrator="rkn4", kept=True),
        ),
    )  # fmt: skip
    assert [" ".join(line.split()) for line in plan.table().splitlines()] == [
        "engine Eq. model solver grains step cost",
        "* native rkn4 (1) 0 1e-09 10 1e-07 s 500 ms",
        "lammps (1) 0 1e-09 10 1e-07 s 700 ms",
        "lammps",
        "modes (3) 0.5 1e-09 10 1e-07 s 100 ms",
        "bessel (4)",
        "model and solver: expected errors of the equation and of its solution",
        "native rkn4: kept: within",
        "lammps: kept: within; gauge diameter: it is finer",
        "lammps: dropped: only by name",
        "modes: dropped: too far off",
        "bessel: needs a strike",
        "native is best",
        "damping: it changes little",
    ]


def test_the_picture_of_a_plan():
    """The picture shows the expected error against the cost on logarithmic scales.

    The tolerance is a line, the choice has a ring.
    """
    plan = lmpchain.plan(paper("weak", 6), 1e-2)
    ax = plan.plot()
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("expected cost", "expected error, at most")
    lines = {line.get_label(): line for line in ax.get_lines()}
    assert set(lines["tolerance 0.01"].get_ydata()) == {1e-2}
    for proposal in plan.candidates:
        error = proposal.model_error + proposal.solver_error
        labels = [label for label in lines if label.split(",")[0] == proposal.engine]
        if not np.isfinite([error, proposal.cost_s]).all():
            assert labels == []
            continue
        (label,) = labels
        assert label.endswith("dropped") != proposal.kept
        assert lines[label].get_xdata()[0] == pytest.approx(proposal.cost_s, rel=1e-12)
        assert lines[label].get_ydata()[0] == pytest.approx(error, rel=1e-12)
        assert (lines[label].get_markerfacecolor() == "none") != proposal.kept
    ring = lines["chosen"]
    assert ring.get_xdata()[0] == plan.expected_cost_s
    assert ring.get_ydata()[0] == pytest.approx(plan.expected_error, rel=1e-12)
    assert ring.get_markerfacecolor() == "none"
    assert ax.xaxis.get_major_formatter()(1e-3) == "1 ms"


# --- engines by name, and "auto"


def test_engines_by_name():
    assert engine_for("auto") is None
    named = engine_for("auto", step=1e-7)
    assert (named.name, named.step) == ("native", 1e-7)
    assert engine_for("modes").options() == {}
    given = Native("rkn4")
    assert engine_for(given) is given
    with pytest.raises(InputError, match=r"engine: must be auto \| lammps \| native"):
        engine_for("natve")


def test_a_record_states_the_request():
    made = Native().propose(SCENE, 1e-6)
    given = record(Native(step=1e-7), SCENE, made, 1e-6)
    assert given["tolerance"] == "none, for a step was given"
    kept = record(Native(), SCENE, made, 1e-6)
    assert kept["tolerance"] == "1e-06"
    assert kept["force"] == made.choices["force"]
    assert {"numba", "numpy", "lmpchain"} <= set(kept)


def test_linear_theory_with_a_large_model_error_is_replaced_by_eq_1():
    """The message states the model error, the expectation and the engine of the second run."""
    attempt = Attempt(proposal(model=3e-7), 1e-6)
    good = ErrorBudget(0.0, 1e-12, 1.0, model=5e-7, model_bound=9e-7)
    assert fall_back(SCENE, attempt, good) is None
    native = attempt._replace(proposal=attempt.proposal._replace(engine="native"))
    assert fall_back(SCENE, native, good._replace(model=1.0)) is None
    for error in (good._replace(model_bound=2e-6), good._replace(remark="contact 3 opens")):
        following = fall_back(SCENE, attempt, error)
        assert following.proposal.engine == "native"
        assert following.tolerance == 1e-6
        most = max(error.model, error.model_bound)
        remark = ", contact 3 opens" if error.remark else ""
        assert following.proposal.choices["redone"] == (
            f"Eq. (3) leaves out up to {most:.1g} of the solution{remark} in the run of modes "
            "(expected: 3e-07): run again with native, Eq. (1)"
        )
        assert (
            following.proposal.choices["plan"] == f"native: {following.proposal.choices['redone']}"
        )
    with pytest.raises(
        ToleranceNotMet, match=r"more than the tolerance of 1e-16; native: round-off alone"
    ):
        fall_back(SCENE, attempt._replace(tolerance=1e-16), good)


# --- calibration


class Answers:
    """A stand-in for `simulate` that advances a simulated clock.

    A result takes the start-up time, plus the slowness times its work on the reference machine.
    """

    def __init__(self, monkeypatch, start: float, slowness: float):
        self.now = 0.0
        self.start = start
        self.slowness = slowness
        self.count = 0
        monkeypatch.setattr(planner.time, "perf_counter", lambda: self.now)
        monkeypatch.setattr(planner, "simulate", self.simulate)

    def simulate(self, scene, engine, tolerance):
        """Advance the simulated clock; all repeats but the last take longer."""
        self.count += 1
        start, slowness = cost_model.speed(engine.name, engine.start_up_s)
        work = (engine.propose(engine.part(scene), tolerance).cost_s - start) / slowness
        late = 0.1 if self.count % planner.REPEATS else 0.0
        self.now += self.start + self.slowness * work + late


def test_a_calibration_finds_start_up_and_slowness_of_every_engine(monkeypatch):
    """The start-up time and slowness follow from a small and a large solution.

    It is written with the name of the machine.
    """
    Answers(monkeypatch, 3e-3, 2.5)
    path, took = planner.calibrate()
    assert took > 0
    kept = json.loads(path.read_text())
    assert kept["host"] == platform.node()
    assert set(kept["engines"]) >= {"native", "modes", "chebyshev"}
    for start, slowness in kept["engines"].values():
        assert start == pytest.approx(3e-3, rel=1e-6)
        assert slowness == pytest.approx(2.5, rel=1e-6)
    assert cost_model.speed("native", Native.start_up_s) == pytest.approx((3e-3, 2.5), rel=1e-6)
    assert cost_model.seconds("native", Native.start_up_s, 0.2) == pytest.approx(
        3e-3 + 0.5, rel=1e-6
    )
    assert cost_model.speed("no such engine", 1e-3) == (1e-3, 1.0)
    again = planner.calibrate()[0]
    assert json.loads(again.read_text())["engines"]["native"] == pytest.approx(
        [3e-3, 2.5], rel=1e-3
    )


def test_a_clock_that_stands_still_gives_plausible_speeds(monkeypatch):
    Answers(monkeypatch, 0.0, 0.0)
    planner.calibrate()
    start, slowness = cost_model.speed("native", Native.start_up_s)
    assert 0 < start < Native.start_up_s / 1000
    assert 0 < slowness < 1e-3


def test_a_plan_uses_the_speed_of_this_machine():
    scene = scene_of(Chain(grains=30, diameter=1e-3), Impulse(velocity=1e-4), 1e-4)
    shipped_s = lmpchain.plan(scene).expected_cost_s
    path = cost_model.cache_file()
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({"host": platform.node(), "engines": {"native": [0.5, 3.0]}}))
    cost_model.measured.cache_clear()
    native = next(each for each in planner.plan(scene).candidates if each.engine == "native")
    assert native.cost_s == pytest.approx(0.5 + 3 * (shipped_s - Native.start_up_s), rel=1e-9)


def test_auto_records_its_reason():
    t = simulate(SCENE, tolerance=1e-3)
    assert t.provenance["plan"] == "native: solves Eq. (1), the cheapest within the tolerance"
    assert t.provenance["plan"] == f"native: {lmpchain.plan(SCENE, 1e-3).why}"
