"""Parts of the linear engines.

Forced motion, waves in resonance, bounds before a run, costs, what closed forms say.
"""

from time import perf_counter

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck
from helpers.independent_integrators import distance

from lmpchain import Chain, Drive, Force, Impulse, Law, Packet, simulate
from lmpchain.engines import Bessel, Chebyshev, Continuum, Modes
from lmpchain.engines.linear import model_error
from lmpchain.engines.linear.model_error import Resonance
from lmpchain.util.arrays import EPSILON

pytestmark = pytest.mark.filterwarnings("ignore:Eq. ")
LOADED = column(7, gravity=0.0, top_load=1e-2, masses=np.linspace(1, 2, 7) * 1e-6)
EDGE = LOADED.band_edge
HZ = EDGE / (2 * np.pi)


# --- the solution


@pytest.mark.parametrize("engine", ["modes", "chebyshev"])
def test_the_cost_of_a_linear_solution(engine):
    scene = scene_of(LOADED, Impulse(velocity=1e-9, grain=2), 20 / EDGE, 9)
    began = perf_counter()
    cost = simulate(scene, engine).cost
    spent_s = perf_counter() - began
    assert cost.integration_s + cost.estimate_s + cost.setup_s + cost.compile_s < spent_s
    assert (cost.steps, cost.active_grains, cost.ranks, cost.integrator) == (8, 7, 1, engine)
    assert cost.step_s == pytest.approx(scene.duration / 8, rel=1e-12)
    assert min(cost.integration_s, cost.estimate_s, cost.setup_s) > 0
    # Six modes move. Terms of half a radian each are needed, because eigenvalues are 0 to 4.
    assert cost.force_evaluations == 6 if engine == "modes" else cost.force_evaluations > 10


@pytest.mark.parametrize("made", [Modes(), Chebyshev()])
def test_a_batch_needs_scenes_with_the_same_recording(made):
    scene = struck(LOADED, 1e-9, 1e-5, 9)
    candidate = made.propose(scene, 1e-6)
    with pytest.raises(ValueError, match="a batch needs chains of one length"):
        made.start([scene, scene.replace(samples=8)], candidate)
    run = made.start([scene, scene], candidate)
    assert run.progress == 0
    assert sum(block.displacement.shape[1] for block in run.blocks()) == 9
    assert run.progress == 1
    assert run.scale.shape == (2, 2)
    if made.name == "modes":
        assert run.cost().force_evaluations == 2 * 6


def test_rounding_of_linear_solutions():
    """The error of frequencies grows with the phase, the error of eigenvectors with their number.

    Relative to the motion of a burst that has hardly begun, both are far larger.
    """
    scene = struck(LOADED, 1e-9, 1e4 / EDGE, 2)
    series = Chebyshev().round_off(scene)
    modes = Modes().round_off(scene)
    assert series == pytest.approx(10_010 * EPSILON, rel=1e-9)
    assert modes - series == pytest.approx(28 * EPSILON, rel=0.01)
    burst = Force(grain=1, amplitude=1e-8, frequency=0.4 * HZ, cycles=2.6)
    long = scene.replace(excitation=burst)
    early = long.replace(duration=long.duration / 1e4)
    assert Modes().round_off(long) > modes
    extra = Modes().round_off(early) - Chebyshev().round_off(early) - 28 * EPSILON
    still = Modes().round_off(early.replace(duration=early.duration / 2))
    still -= Chebyshev().round_off(early.replace(duration=early.duration / 2)) + 28 * EPSILON
    begun = 0.4 * EDGE / 2 / 2.6 * early.duration
    assert begun < 1
    assert still == pytest.approx(4 * extra, rel=0.01)
    # The sines of this burst cancel to the share `begun`**2 of their rounding error.
    highest = 7 * burst.waveform.fastest / EDGE
    assert extra == pytest.approx(40 * EPSILON / begun**2 * (1 + highest), rel=0.01)
    damped = LOADED.replace(damping={"viscoelastic": 1e-3 / EDGE})
    tone = long.replace(chain=damped, excitation=Force(amplitude=1e-8, frequency=0.01 * HZ))
    slow = Modes().round_off(tone) - modes
    assert slow == pytest.approx(100 * series, rel=1e-6)
    brief = tone.replace(duration=0.1 / EDGE)
    slow = Modes().round_off(brief) - 28 * EPSILON - 10.1 * EPSILON
    assert slow == pytest.approx(100 * 1e3 * 10.1 * EPSILON, rel=1e-6)


@pytest.mark.parametrize(
    ("radians", "samples", "within"),
    # The samples resolve every oscillation, or evaluations at random distances are added, or long
    # series of polynomials reach from one evaluation to the next.
    [(90.0, 101, 0.05), (900.0, 11, 0.3), (30_000.0, 3, 0.1)],
)
def test_the_expected_time_of_linear_solutions_is_that_of_their_work(
    radians: float, samples: int, within: float
) -> None:
    """The expected number of polynomials is the number that a run computes."""
    chain = column(60, gravity=0.0, top_load=1e-3)
    scene = struck(chain, 1e-12, radians / chain.band_edge, samples)
    evaluations = samples + (0 if samples > 100 else model_error.evaluations(scene))
    for engine in (Chebyshev(), Modes()):
        run = engine.start([scene], engine.propose(scene, 1e-6))
        for _ in run.blocks():
            pass
        work = run.cost().force_evaluations
        if engine.name == "modes":
            expected = 5.5e-11 * 60**3 + 6e-8 * 60 * evaluations
            assert work == 59
        else:
            grains = min(60, 30 + radians / 4)
            expected = 7e-10 * work * (grains + 100) + 1.3e-8 * evaluations * 60
        found = engine.propose(scene, 1e-6).cost_s - engine.start_up_s
        assert found == pytest.approx(expected, rel=within if engine.name == "chebyshev" else 1e-9)


# --- waves in resonance


def test_resonance_matters_for_few_grains_with_a_curved_force():
    strike = Impulse(velocity=1e-7)
    for chain in (LOADED.replace(exponent=1.0), column(13)):
        scene = scene_of(chain, strike, 1e-3)
        assert not Resonance(scene).motion(1e-3).any()
    twelve = scene_of(column(12), strike, 1e-3)
    assert Resonance(twelve).motion(1e-3).all()
    assert not Resonance(twelve).motion(0.0).any()


# --- estimates before a run


def test_the_expected_error_of_linear_theory_scales_with_strike_and_curvature():
    """The error is proportional to both, and to the root of time, or to time with a forcing."""
    scene = struck(column(40, gravity=0.0, top_load=1e-2), 1e-7, 5e-5, 11)
    driven = scene.replace(excitation=Drive(amplitude=1e-16, frequency=0.1 * HZ))
    for each, power in ((scene, 0.5), (driven, 1.0)):
        radians = each.linear_frequency * each.duration
        walk = (each.chain.exponent - 1) * each.linear_strain * (1 + radians**power)
        assert model_error.expected_error(each) == pytest.approx(4 * 0.15 * walk, rel=1e-9)
    springs = struck(column(40, gravity=0.0, top_load=1e-2, exponent=1.0), 1e-7, 5e-5, 11)
    assert model_error.expected_error(springs) == 0.0
    assert model_error.expected_error(scene.replace(excitation=Impulse(velocity=10.0))) == 1.0
    for part, opens in ((1.001, True), (0.999, False)):
        strike = Impulse(velocity=1e-7 / scene.linear_strain * part)
        assert model_error.may_open(scene.replace(excitation=strike)) == opens


def test_relative_scatter_of_grains():
    chain = column(3, masses=[1e-6, 4e-6, 2e-6], contact_constants=[1e9, 1e9])
    assert model_error.unlike(chain) == pytest.approx(
        {"masses": 0.75, "contact_constants": 0.0}, rel=1e-12
    )
    assert model_error.unlike(column(1, bottom="wall")) == {"masses": 0.0}


def test_travel_time_of_a_wave_train_at_its_largest_strain():
    """In a uniform chain the train travels to the farther end.

    In a column as far as its strain, less and less, counts.
    """
    chain = column(30, gravity=0.0, top_load=1e-2)
    hop = float(np.sqrt(chain.masses[0] / chain.linear_stiffness[0]))
    for grain, hops in ((1, 29), (10, 20), (25, 24)):
        force = Force(grain=grain, amplitude=1e-8, frequency=1e4)
        scene = scene_of(chain, force, 1e-4)
        assert model_error.travel(scene) == pytest.approx(hops * hop, rel=1e-9)
    packet = Packet(frequency=0.1 / hop, width=2, grain=15, amplitude=1e-12)
    assert model_error.travel(scene_of(chain, packet, 1e-4)) == pytest.approx(29 * hop, rel=1e-9)
    chain = column(30)
    scene = scene_of(chain, Drive(amplitude=1e-12, frequency=1e4), 1e-4)
    times = np.sqrt(chain.masses[:-1] / chain.linear_stiffness)
    # The energy flux is constant along the column.
    strain = 1 / (chain.equilibrium_overlap * np.sqrt(chain.linear_stiffness / times))
    assert np.all(np.diff(strain) < 0)
    assert model_error.travel(scene) == pytest.approx(
        float((times * strain).sum() / strain[0]), rel=1e-9
    )


def test_evaluation_times_between_samples():
    """The times are spread over the run, never evenly spaced, from half a radian on.

    Every half radian where contacts may open.
    """
    chain = column(40, gravity=0.0, top_load=1e-2)
    calm = struck(chain, 1e-8, 1e3 / chain.band_edge, 11)
    times = model_error.evaluation_times(calm)
    fastest = calm.linear_frequency
    assert times.size == model_error.evaluations(calm)
    assert np.all(np.diff(times) > 0)
    assert times[0] == 0.0
    assert calm.duration * 0.97 < times[-1] < calm.duration
    early = times[(times > 0) & (times < 10 / fastest)]
    assert early[0] == pytest.approx(0.5 / fastest, rel=1e-9)
    assert np.all(early[1:] / early[:-1] < 1.26)
    gaps = np.diff(times[times > calm.duration / 10])
    assert gaps.max() < 2 * calm.duration / 64
    assert gaps.std() > 0.2 * gaps.mean()
    open_ = calm.replace(excitation=Impulse(velocity=1e-8 / calm.linear_strain * 1.5))
    close = model_error.evaluation_times(open_)
    np.testing.assert_allclose(np.diff(close), close[1], rtol=1e-9)
    assert 0.49 / fastest < close[1] <= 0.5 / fastest
    assert close[-1] + close[1] == pytest.approx(open_.duration, rel=1e-9)


def test_close_samples_need_no_other_evaluation_times():
    """One sample per radian suffices if no contact can open.

    Two where something may, and then every opening is seen.
    """
    chain = column(40, gravity=0.0, top_load=1e-2)
    scene = struck(chain, 1e-8, 200.5 / chain.band_edge, 2)
    wild = scene.replace(excitation=Impulse(velocity=1e-8 / scene.linear_strain * 1.5))
    for each, enough in ((scene, 202), (wild, 402)):
        for samples in (enough - 1, enough):
            assert model_error.dense(each.replace(samples=samples)) == (samples == enough)
        assert model_error.decidable(each)
        long = each.replace(duration=1e7 / chain.band_edge)
        assert model_error.decidable(long) == (each is scene)
    assert Modes().propose(long, 0.9).model_error == 1.0


# --- closed forms


def test_expected_errors_of_closed_forms():
    """The error is unknown unless contacts are equal and the end is out of reach."""
    scene = struck(column(40), 1e-7, 5e-5, 11)
    for made in (Bessel(), Continuum()):
        candidate = made.propose(scene, 0.9)
        assert np.isnan(candidate.model_error)
        assert candidate.active_grains == 40
        assert made.part(scene) is scene.fine  # The whole scene, not the light cone.
        assert not made.batches
    loaded = struck(column(400, gravity=0.0, top_load=1e-2), 1e-9, 2e-5, 11)
    series = Chebyshev().propose(loaded.reached, 0.9)
    candidate = Bessel().propose(loaded, 0.9)
    assert (candidate.model_error, candidate.active_grains) == (series.model_error, 400)
    back = loaded.replace(duration=5e-3)
    assert np.isnan(Bessel().propose(back, 0.9).model_error)


def test_a_measured_model_error_is_below_the_expected_one():
    scene = struck(column(40, gravity=0.0, top_load=1e-2), 1e-8, 5e-5, 11)
    for made in (Modes(), Chebyshev()):
        candidate = made.propose(scene, 1e-6)
        assert candidate.model_error == model_error.expected_error(scene)
        assert candidate.step == pytest.approx(scene.duration / 10, rel=1e-12)
        assert candidate.active_grains == 40
        assert candidate.solver_error == made.round_off(scene)
        look = made.look(scene)
        assert 0 < look.error <= look.at_most <= candidate.model_error
        assert made.refine(candidate, None, 1e-6) is None
    assert look.remark == ""


ACTING = {
    "half a sine": Force(grain=4, shape="half-sine", amplitude=0.05, duration=5e-5),
    "sine": Force(grain=4, amplitude=0.1, frequency=1e4),
    "drive": Drive(amplitude=2e-9, frequency=2e4, cycles=2),
    "wall": Drive(grain=0, amplitude=2e-9, frequency=2e4, cycles=2),
}


@pytest.mark.parametrize("kind", ACTING)
def test_the_model_error_of_forced_motion(kind: str):
    top = "wall" if kind == "wall" else "free"
    chain = Chain(
        grains=20, material="steel", diameter=5e-3, gravity=0, top_load=5.0, top=top, bottom="wall"
    )
    scene = scene_of(chain, ACTING[kind], 2e-4, 41)
    answer = simulate(scene, "modes", 1e-2, on_miss="warn")
    error = distance(answer, simulate(scene, "native", 1e-9))
    assert 1e-4 < error < 0.05
    assert error <= answer.error_estimate.model < 6 * error


def test_the_model_error_of_a_wave_train():
    """Crests overtake troughs by (delta - 1) s omega t / 4.

    The estimate covers that, and is no bound.
    """
    chain = Chain(
        grains=300, material="steel", diameter=5e-3, gravity=0, top_load=5.0, bottom="wall"
    )
    hertz = 0.4 * chain.band_edge / (2 * np.pi)
    packet = Packet(frequency=hertz, width=20, grain=130, amplitude=1e-9)
    scene = scene_of(chain, packet, 150 / chain.band_edge, 31)
    answer = simulate(scene, "modes", 1e-2, on_miss="warn")
    exact = simulate(scene, "native", 1e-9)
    error = distance(answer, exact)
    assert 1e-3 < error < 1e-2
    assert error <= answer.error_estimate.model < 4 * error


# Contacts that harden or soften on both sides of the rest alike, in N/m and m.
SYMMETRIC = {
    "cubic": Law("k*(o + o**3/L**2)", k=1e5, L=1e-6),
    "quintic": Law("k*(o + o**5/L**4)", k=1e5, L=1e-6),
    "saturating": Law("k*L*tanh(o/L)", k=1e5, L=1e-6),
    "inflected": Law("k*((o - L)**3/L**2 + 0.3*o)", k=1e5, L=1e-6),  # The load compresses it by L.
}


@pytest.mark.parametrize("name", SYMMETRIC)
def test_the_model_error_includes_contacts_without_a_slope_of_the_stiffness(name: str) -> None:
    load, end = (0.03, "free") if name == "inflected" else (0.0, "wall")
    law = SYMMETRIC[name]
    chain = Chain(
        grains=20, diameter=1e-2, gravity=0.0, top_load=load, law=law, top=end, bottom="wall"
    )
    assert np.abs(chain.contacts.bend).max() < 1e-6
    assert chain.contacts.length[1:] == pytest.approx(np.full(20, 1e-6), rel=0.7)
    for speed in (3e-4, 3e-3):
        strike = Impulse(velocity=speed, grain=5)
        scene = scene_of(chain, strike, 60 * chain.time_scale, 31)
        run = simulate(scene, "modes", tolerance=0.99)
        error = distance(run, simulate(scene, "native", tolerance=1e-9))
        assert min(error, 0.5) <= run.error_estimate.model <= 12 * error
        # The engine is chosen by an error that is expected before a run.
        assert model_error.expected_error(scene) >= min(error, 0.5)
