"""What linear engines say that linearising leaves out, against the nonlinear motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck
from helpers.independent_integrators import distance

import lmpchain
from lmpchain import Chain, Drive, Impulse, Packet, Scene, simulate
from lmpchain.engines import Chebyshev, Modes
from lmpchain.stability.linear_theory import strike_number_where
from lmpchain.theory.modes import between

MOST_POINTS = 40_000  # Number of times at which the largest motion is searched.


class Truth(NamedTuple):
    """Motion at the samples, (2, T, N), and its largest values at any time, (2,)."""

    motion: np.ndarray
    scale: np.ndarray

    def error(self, answer: lmpchain.Trajectory) -> float:
        """Return the error of a run as defined by the package."""
        found = np.array([answer.displacement, answer.velocity])
        return float((np.abs(found - self.motion).max((1, 2)) / self.scale).max())


def truth(scene: Scene) -> Truth:
    """Return the motion by the native engine at 1e-10."""
    span = scene.duration * max(scene.chain.band_edge, scene.excitation.fastest)
    most = max(1, MOST_POINTS // scene.samples)
    finer = int(np.clip(np.ceil(4 * span / scene.intervals), 1, most))
    run = simulate(scene.replace(samples=finer * scene.intervals + 1), "native", 1e-10)
    motion = np.array([run.displacement, run.velocity])
    return Truth(motion[:, ::finer], np.abs(motion).max((1, 2)))


def test_springs_that_open_between_samples_are_solved_by_eq_1():
    """A contact opens between the samples, where Eq. (3) differs from Eq. (1)."""
    chain = column(4, gravity=0.0, top_load=3.3e-3, top="wall", exponent=1.0)
    omega = np.sqrt(chain.linear_stiffness[2] / chain.masses[2])
    strike = Impulse(velocity=float(1.05 * chain.equilibrium_overlap[2] * omega), grain=3)
    scene = scene_of(chain, strike, 978 / chain.band_edge, 5)
    known = truth(scene)
    t = simulate(scene)
    assert t.equation == 1
    assert known.error(t) < 1e-6
    said = r"leaves out about .* \(at most 1\).*contact \d opens"
    for engine in ("modes", "chebyshev"):
        with pytest.warns(UserWarning, match=said):
            t = simulate(scene, engine)
        assert known.error(t) > 0.1
        assert t.error_estimate.model > known.error(t) / 3


def test_linear_theory_is_rejected_for_springs_that_cannot_be_resolved():
    """A run of 10^6 periods is not evaluated in full.

    It may be right, and is not said to be, unless the energy says so.
    """
    chain = column(40, gravity=0.0, top_load=3.3e-3, exponent=1.0)
    strike = Impulse(velocity=1.005 * chain.length_scale / chain.time_scale)
    scene = scene_of(chain, strike, 1e7 / chain.band_edge, 5)
    assert 1 <= scene.linear_strain < 1.01
    candidate = Modes().propose(scene, 1e-6)
    assert candidate.model_error == 1.0
    with pytest.warns(UserWarning, match="contacts may open"):
        assert simulate(scene, "modes").error_estimate.model == 1
    weak = scene.replace(excitation=strike.scaled(0.98))
    assert Modes().propose(weak, 1e-6).model_error == 0
    assert simulate(weak, "modes").error_estimate.model == 0


@pytest.mark.filterwarnings("ignore:Eq. ")
@pytest.mark.parametrize("samples", [2, 3, 5])
@pytest.mark.parametrize("engine", ["modes", "chebyshev"])
def test_errors_are_relative_to_the_largest_motion_also_between_samples(engine, samples):
    """The oscillation is sampled where it is at rest.

    What is off there is no large part of nothing.
    """
    chain = column(2, gravity=0.0, top_load=10.0)
    unit = chain.length_scale / chain.time_scale
    periods = 64 * (samples - 1) * np.pi / chain.band_edge
    scene = struck(chain, 1e-3 * unit, periods, samples)
    known = truth(scene)
    t = simulate(scene, engine, 0.9)
    assert known.error(t) / 3 < t.error_estimate.model < 0.2
    assert Modes().look(scene).scale == pytest.approx(known.scale, rel=0.01, abs=0)


@pytest.mark.filterwarnings("ignore:Eq. ")
@pytest.mark.parametrize("engine", ["modes", "chebyshev"])
@pytest.mark.parametrize("length", [0.2, 1.0, 4.0])
def test_waves_in_resonance_add_up(engine, length):
    """In four grains below a driven one, the third mode and the drive force the fourth.

    The beat is at 1.005 of its frequency.
    """
    chain = Chain(
        grains=5,
        diameter=3.551440346790556e-4,
        material="steel",
        gravity=1.31,
        bottom="wall",
        masses=[2.70978955e-07, 5.79985779e-08, 6.36250134e-08, 7.30518761e-07, 6.01909071e-07],
    )
    drive = Drive(amplitude=4.6e-15, frequency=54370.746)
    third, fourth = between(chain.contacts.stiffness[1:], chain.masses[1:]).frequency[2:]
    assert third + 2 * np.pi * drive.frequency == pytest.approx(1.005 * fourth, rel=1e-3, abs=0)
    scene = scene_of(chain, drive, length * 2.61e-4, 199)
    known = truth(scene)
    t = simulate(scene, engine, 0.9)
    assert known.error(t) / 1.3 < Modes().look(scene).estimate < 1.3 * known.error(t)
    # The bound is used while the force acts.
    assert known.error(t) < t.error_estimate.model < 6 * known.error(t)


@pytest.mark.filterwarnings("ignore:Eq. ")
@pytest.mark.parametrize("kind", ["packet", "short packet", "drive"])
def test_waves_that_travel_far_become_steeper(kind):
    """A crest is always faster than a trough, unlike strains of alternating sign."""
    grains = 1500
    chain = column(grains, gravity=0, top_load=1.0, exponent=2.0)
    hop = np.sqrt(chain.linear_stiffness[0] / chain.masses[0])
    amplitude = 2e-4 * chain.equilibrium_overlap[0]
    if kind == "drive":
        excitation = Drive(frequency=0.6 * hop / np.pi, amplitude=amplitude)
        grains_passed = 1400
    else:
        # A short packet of high frequency soon separates from its second harmonic.
        ratio, width = (0.7, 50) if kind == "short packet" else (0.25, grains // 14)
        wave = {"frequency": ratio * hop / np.pi, "amplitude": amplitude}
        excitation = Packet(**wave, grain=grains // 2, width=width)
        grains_passed = 600
    scene = scene_of(chain, excitation, grains_passed / hop, 41)
    t = simulate(scene, "chebyshev", 0.9)
    true = distance(t, simulate(scene, "native", 1e-6))
    assert 1e-3 < true < t.error_estimate.model < 5 * true


@pytest.mark.parametrize(("amplitude", "frequency"), [(1.5e-9, 3e3), (1e-9, 1e4), (1e-10, 3e4)])
def test_estimates_of_linear_theory_agree_for_a_driven_column(amplitude, frequency):
    """Evaluation, run and stability give the same estimate.

    At least a third of the truth, at most five times.

    Estimates are 0.21, 0.57 and 0.15, the truth 0.10, 0.23 and 0.070.
    """
    drive = Drive(amplitude=amplitude, frequency=frequency)
    scene = scene_of(column(120), drive, 5e-4, 101)
    planned = next(p for p in lmpchain.plan(scene).candidates if p.engine == "chebyshev")
    with pytest.warns(UserWarning, match=r"leaves out about .* of the solution \(at most "):
        t = simulate(scene, "chebyshev")
    known = truth(scene)
    true = known.error(t)
    said = t.error_estimate.model
    assert true / 3 < said < 5 * true
    assert planned.model_error > true
    estimate = Chebyshev().look(scene.reached).error
    assert estimate == pytest.approx(said, rel=0.15, abs=0)
    for error in (0.01, 0.1):
        assert (scene.strike_number > strike_number_where(error, scene)) == (said > error)
