"""A new engine is a separate module and a line in the registry.

Nothing else knows one engine from another.
"""

import sys
from types import ModuleType

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import struck

import lmpchain
from lmpchain import Scene, engines, simulate
from lmpchain.engines.base import Engine, ErrorBudget, Proposal, Run
from lmpchain.integrators.steps import Steps
from lmpchain.trajectory.record import Block, Cost

ROUNDING = 1e-14
REGISTERED = engines.names()


class Oscillator(Engine):
    """One grain on a spring that stays compressed: Eq. (1) solved by a sine."""

    name = "oscillator"
    equation = 1
    auto = "cheapest"
    start_up_s = 1e-6

    def refuses(self, scene):
        """Return the reason why a scene is not one grain on one spring."""
        if (
            scene.chain.movable != 1
            or scene.chain.exponent != 1
            or scene.drive
            or scene.largest_strain >= 1
        ):
            return [("grains", "oscillator knows one grain on one spring that stays pressed")]
        return []

    def propose(self, scene, tolerance):
        """Propose the formula."""
        steps = Steps.spread(scene.duration / (scene.samples - 1), 1)
        grains = scene.chain.grains
        return Proposal(self.name, self.equation, steps, grains, 0.0, ROUNDING, self.start_up_s)

    def refine(self, candidate, error, tolerance):
        """Return None, because the exact solution cannot be improved."""

    def start(self, scenes, candidate, state=None):
        """Start a run of one scene."""
        return Swing(scenes[0], int((state or {"sample": 0})["sample"]))

    def describe(self, scene, candidate):
        """Return the method of the engine."""
        return {"formula": "sine"}


class Swing(Run):
    """A run with the samples of the sine, two at a time."""

    def __init__(self, scene, sample):
        self.scene = scene
        self.sample = sample

    def blocks(self):
        """Yield the solution in blocks."""
        chain = self.scene.chain
        omega = chain.band_edge
        (u, v) = (x[0] for x in self.scene.initial())
        while self.sample < self.scene.samples:
            here = slice(self.sample, min(self.sample + 2, self.scene.samples))
            t = self.scene.time[here]
            block = np.zeros((2, 1, t.size, chain.grains))
            block[0, 0, :, 0] = u * np.cos(omega * t) + v / omega * np.sin(omega * t)
            block[1, 0, :, 0] = v * np.cos(omega * t) - u * omega * np.sin(omega * t)
            self.sample = here.stop
            yield Block(here, *block[:, :, :, self.scene.recorded - 1])

    @property
    def progress(self):
        """Fraction of the samples that are done."""
        return self.sample / self.scene.samples

    def errors(self):
        """Return the rounding error."""
        return [ErrorBudget(0.0, ROUNDING, 1.0)]

    def cost(self):
        """Return a negligible cost."""
        return Cost(1e-6, 0.0, 0.0, self.scene.samples, 0, self.scene.chain.grains, "sine", 0.0, 1)

    def state(self):
        """Return the number of finished samples."""
        return {"sample": np.array(self.sample)}

    def close(self):
        """Do nothing, because there are no resources."""


@pytest.fixture
def spring(monkeypatch: pytest.MonkeyPatch) -> Scene:
    """Register the engine, and return a scene for it."""
    module = ModuleType("lmpchain.engines.oscillator")
    module.Oscillator = Oscillator  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(engines.REGISTRY, "oscillator", ("oscillator", "Oscillator"))
    chain = column(2, gravity=0.0, top_load=1.0, exponent=1.0)
    speed = 0.3 * chain.length_scale / chain.time_scale
    return struck(chain, speed, 20 * chain.time_scale, 41)


def test_it_is_used_by_name_and_chosen_where_it_is_cheapest(spring: Scene):
    native = simulate(spring, "native", 1e-12)
    named = simulate(spring, "oscillator")
    chosen = simulate(spring)
    assert named.engine == chosen.engine == "oscillator"
    assert np.abs(named.velocity - native.velocity).max() < 1e-12 * np.abs(native.velocity).max()
    assert chosen.provenance["formula"] == "sine"
    plan = lmpchain.plan(spring)
    assert plan.engine == "oscillator"
    assert [proposal.kept for proposal in plan.candidates if proposal.engine == "oscillator"] == [
        True
    ]
    two = struck(column(3), 1e-4, 1e-5)
    with pytest.raises(lmpchain.InputError, match="oscillator knows one grain"):
        simulate(two, "oscillator")
    assert lmpchain.plan(two).engine == "native"


def test_it_joins_auto_only_on_request(spring: Scene, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Oscillator, "auto", "never")
    assert {each.engine for each in lmpchain.plan(spring).candidates} == set(REGISTERED)
    assert simulate(spring).engine != "oscillator"
    monkeypatch.setattr(Oscillator, "auto", "last")
    *_, one, other = lmpchain.plan(spring).candidates
    assert (one.engine, other.engine) == ("lammps", "oscillator")
    assert "only if requested by name" in other.why
    for name in REGISTERED:
        monkeypatch.setattr(engines.class_of(name), "refuses", lambda *_: [("grains", "not mine")])
    assert simulate(spring).engine == "oscillator"


def test_refusals_suggest_it_where_it_supports_more(spring: Scene, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Oscillator, "dissipates", True)
    damped = spring.replace(chain=spring.chain.replace(damping={"drag": 1.0}))
    cure = "leave damping out, or use native, modes, oscillator or lammps"
    with pytest.raises(lmpchain.InputError, match=f"chebyshev conserves energy: {cure}$"):
        simulate(damped, "chebyshev")


def test_it_works_in_a_run_folder(spring: Scene, tmp_path):
    with pytest.raises(lmpchain.Stopped):
        simulate(spring, "oscillator", folder=tmp_path / "run", max_wall=1e-9)
    resumed = lmpchain.resume(tmp_path / "run")
    plain = simulate(spring, "oscillator")
    assert resumed.engine == "oscillator"
    assert np.array_equal(resumed.velocity, plain.velocity)


def test_it_solves_a_sweep(spring: Scene, tmp_path):
    speed = spring.excitation.velocity
    source = {"scene": spring, "engine": "oscillator", "keep": ["velocity"]}
    swept = lmpchain.sweep(
        source | {"grid": {"excitation.velocity": [speed, 2 * speed]}}, tmp_path / "sweep"
    )
    assert (swept["solver_error"] == ROUNDING).all()
    assert np.allclose(swept["velocity"][1], 2 * swept["velocity"][0], rtol=1e-12, atol=0)
