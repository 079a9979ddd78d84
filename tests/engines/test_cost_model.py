"""Announcements of long work before it begins, and budgets that limit it."""

import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from lmpchain import Chain, Impulse, Scene, design, simulate
from lmpchain.benchmark.bench import work_precision
from lmpchain.benchmark.truth import truth
from lmpchain.disorder.averages import at_the_end
from lmpchain.engines import Lammps, Native
from lmpchain.engines.cost_model import TooLong, announce, announced, budget, check_time
from lmpchain.report.exploration import explore
from lmpchain.simulation.time_averages import averages
from lmpchain.stability.find import stability
from lmpchain.sweeps.run import sweep
from lmpchain.util.remarks import warnings_aside

CHAIN = Chain(grains=6, diameter=1e-3)
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=1e-3), duration=5e-6, samples=6)
GRID = {"scene": SCENE, "grid": {"excitation.velocity": [1e-4, 1e-3]}, "keep": ["peak_velocity"]}
SLIDER = {"scene": SCENE, "over": {"excitation.velocity": [1e-4, 1e-3]}}
OBJECTIVE = design.Momentum([1])
# Parts of the announcement, and the work that causes it.
WORK: dict[str, Callable[[Path], object]] = {
    "the run by native with .* steps of": lambda _: simulate(SCENE, "native"),
    "the reference by Taylor series": lambda _: truth(SCENE),
    "the chart with its reference": lambda _: work_precision(SCENE, 1e-3),
    "an adjoint run of .* steps": lambda _: design.gradient(SCENE, OBJECTIVE, ["masses"]),
    "the search for the limits": lambda _: stability(SCENE),
    "the mean over 2 chains": lambda _: at_the_end(SCENE, [0.1], 2, 0),
    "the average over .* steps": lambda _: averages(SCENE, ["kinetic_energy"], time=1e-4),
    "2 scenes by native": lambda folder: sweep(GRID, folder / "sweep"),
    "2 scenes by": lambda folder: explore(SLIDER, folder / "page.html"),
}


class Begun(Exception):
    """Raised when the announcement is made."""


@pytest.mark.parametrize("said", WORK)
def test_work_above_the_limit_is_announced(
    said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A limit of 0 makes all work long; the test ends at the first announcement."""
    monkeypatch.setattr("lmpchain.engines.cost_model.PATIENCE_S", 0.0)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="(the|an|2) .* takes about .*: .* takes less")
        with warnings_aside(), pytest.raises(UserWarning, match=said):
            WORK[said](tmp_path)


def test_parts_of_announced_work_are_not_announced():
    with (
        pytest.warns(UserWarning, match="a sweep takes about 40 s: fewer scenes") as told,
        announced(40.0, "a sweep", "fewer scenes takes less"),
    ):
        announce(50.0, "a run", "less")
    assert len(told) == 1


def test_work_beyond_a_budget_is_stopped(monkeypatch: pytest.MonkeyPatch):
    with budget(10.0), pytest.raises(TooLong, match="a run would take about 12 s"):
        announce(8.0, "a run", "", spent_s=4.0)
    monkeypatch.setattr("lmpchain.engines.cost_model.OVERRUN", 1e12)
    with budget(1e-9), pytest.raises(TooLong, match="the run by native with"):
        simulate(SCENE, "native")
    monkeypatch.undo()
    # Work with an underestimated time is stopped as well. Where CPU time is limited, its clock
    # moves in steps of 4 ms, and the work must be longer.
    monkeypatch.setattr(Native, "cost", lambda *_: 1e-12)
    with budget(1e-9), pytest.raises(TooLong, match="far longer than expected"):
        simulate(Scene(chain=CHAIN, excitation=Impulse(velocity=1e-3), duration=0.1), "native")


def test_work_within_a_budget_restores_half_of_its_time(monkeypatch: pytest.MonkeyPatch):
    used = [0.0]
    monkeypatch.setattr("lmpchain.engines.cost_model.cpu_time", lambda: used[0])
    ends = []

    def work() -> None:
        while used[0] < 100.0:
            used[0] += 0.5
            check_time()

    with budget(8.0):
        for _ in range(3):
            with budget(8.0), pytest.raises(TooLong, match="far longer"):
                work()
            ends.append(used[0])
        with budget(8.0), pytest.raises(TooLong, match=r"a run would take about 0\.8 s"):
            announce(0.8, "a run", "")
    assert ends == [8.5, 12.5, 14.5]


def test_a_trial_of_lammps_is_announced_at_every_attempt(monkeypatch: pytest.MonkeyPatch):
    """The first attempt expects far fewer steps than viscous contacts need in LAMMPS."""
    scene = SCENE.replace(chain=CHAIN.replace(damping={"viscoelastic": 2e-8}))
    monkeypatch.setattr("lmpchain.engines.cost_model.PATIENCE_S", 0.0)
    with pytest.warns(UserWarning, match="the native trial that finds the step") as told:
        steps = Lammps().propose(scene, 1e-5).steps.total(scene.intervals)
    announcements = [str(each.message) for each in told]
    assert len(announcements) > 1
    assert any(f"with {steps} steps of" in text for text in announcements)


def test_the_expected_time_grows_with_the_steps():
    candidate = Native("verlet").propose(SCENE, 1e-6)
    shorter = candidate.with_steps(candidate.steps.shorten(3 * candidate.steps.per_landing))
    assert shorter.cost_s == pytest.approx(3 * candidate.cost_s)
