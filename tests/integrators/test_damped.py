"""Methods for damped chains: order, bits, and modes of linear chains."""

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import run, scene_of, struck
from helpers.taylor_series import reference

from lmpchain import (
    Chain,
    Displacement,
    Drive,
    Force,
    Impulse,
    Law,
    Profile,
    Scene,
    Trajectory,
    simulate,
)
from lmpchain.engines import Native
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.kernels.layout import PAD
from lmpchain.integrators.methods import methods_of
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps
from lmpchain.simulation.many import simulate_many
from lmpchain.theory import modes


def damped_chain(**options) -> Chain:
    fields = {"grains": 12, "diameter": 1e-3, "gravity": 0.0, "top_load": 1.0, "bottom": "wall"}
    return Chain(**fields | {"damping": {"viscoelastic": 1e-7, "drag": 2e4}} | options)


def displaced(chain: Chain, samples: int = 2, duration: float = 2e-5) -> Scene:
    strike = Displacement(displacement=0.05 * chain.equilibrium_overlap[0], grain=3)
    return scene_of(chain, strike, duration, samples)


def slope(scene: Scene, integrator: str, counts: list[int]) -> float:
    true, doubt = reference(scene, 1e-18)
    errors = []
    for count in counts:
        t = simulate(scene, engine=Native(integrator, step=scene.duration / count))
        assert t.cost.steps == count
        errors.append(true.error(t.displacement, t.velocity))
    assert min(errors) > 100 * doubt
    # Odd terms in addition to the first one.
    n = np.array(counts, dtype=float)
    laws = np.stack([np.ones(n.size), -np.log(n), 1 / n], axis=1)
    return np.linalg.lstsq(laws, np.log(errors), rcond=None)[0][1]


@pytest.mark.parametrize(
    "damping",
    [
        {"viscoelastic": 1e-7},
        {"drag": 2e5},
        {"viscoelastic": 2e-8, "drag": 5e4},
        {"viscoelastic": np.linspace(0, 2e-7, 11), "drag": np.linspace(0, 4e5, 12)},
    ],
)
def test_order_of_convergence(damping):
    scene = displaced(damped_chain(damping=damping))
    assert slope(scene, "dop853", [40, 50, 64, 80]) == pytest.approx(8, abs=0.05)
    counts = [4000, 8000, 16000, 32000]
    assert slope(scene, "verlet", counts) == pytest.approx(2, abs=0.05)
    # In fix nve of LAMMPS, forces use the velocities of the previous half step.
    assert slope(scene, "lagged-verlet", counts) == pytest.approx(1, abs=0.05)


def test_methods_have_their_orders_on_a_ground_that_changes_in_time():
    law = Law("k*u*(1 + 0.9*tanh(w*t - 3))", k=1e7, w=3e5)
    scene = displaced(damped_chain(ground=law, damping={"viscoelastic": 1e-7}))

    def end(integrator: str, count: int) -> np.ndarray:
        t = simulate(scene, engine=Native(integrator, step=scene.duration / count))
        return np.concatenate((t.displacement[-1] * scene.highest_frequency, t.velocity[-1]))

    true = end("dop853", 400)
    size = np.abs(true).max()
    assert np.abs(end("dop853", 200) - true).max() < 1e-8 * size
    for integrator, order in (("verlet", 2), ("lagged-verlet", 1)):
        errors = [np.abs(end(integrator, count) - true).max() for count in (2000, 4000)]
        assert errors[0] < 0.1 * size
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)


EXCITATIONS = {
    "impulse": Impulse(velocity=3e-2, grain=2),
    "displacement": Displacement(displacement=2e-7, grain=5),
    "drive": Drive(amplitude=1e-7, frequency=5e4),
    "wall": Drive(grain=0, amplitude=1e-7, frequency=5e4),
    "burst": Force(grain=4, amplitude=3.0, frequency=5e4, cycles=3),
    "hammer": Force(grain=2, shape="half-sine", amplitude=3.0, duration=2e-5),
    "profile": Profile(velocity=np.sin(np.arange(12.0))),
}


@pytest.mark.parametrize("kind", EXCITATIONS)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-11])
def test_a_run_meets_its_tolerance_and_its_estimate(kind, tolerance):
    top = "wall" if kind == "wall" else "free"
    drag = {"drag": 1e3} if kind != "hammer" else {}
    chain = damped_chain(top=top, damping={"viscoelastic": 3e-8} | drag)
    scene = scene_of(chain, EXCITATIONS[kind], 6e-5, 8)
    t = simulate(scene, engine="native", tolerance=tolerance)
    true, doubt = reference(scene, 1e-4 * tolerance)
    error = true.error(t.displacement, t.velocity)
    assert t.cost.integrator == "dop853"
    assert error - doubt < min(tolerance, 3 * t.error_estimate.total)


def test_all_execution_modes_give_the_same_bits():
    chain = damped_chain()
    strikes = [Impulse(velocity=speed) for speed in (1e-2, 3e-2)]
    scenes = [scene_of(chain, strike, 6e-5, 30) for strike in strikes]
    alone = [simulate(scene, engine="native", tolerance=1e-8) for scene in scenes]
    for engine in ("native", Native(threads=2)):
        batch = simulate_many(scenes, engine=engine, tolerance=1e-8)
        for one, other in zip(alone, batch, strict=True):
            assert one.displacement.tobytes() == other.displacement.tobytes()
            assert one.velocity.tobytes() == other.velocity.tobytes()


def test_a_resumed_run_has_the_same_bits(tmp_path):
    scene = struck(damped_chain(), 3e-2, 6e-5, 10)
    schedule = Steps(7, 1, scene.duration / 9 / 7, adaptive=True)
    for method in methods_of(scene.chain).values():
        fields = np.empty((2, 2, 1, scene.samples, 12))
        whole = NativeStepper(ChainBatch([scene]), method, schedule, {})
        whole.fill(*fields[0], 0, 9, 10**6)
        stopped = NativeStepper(ChainBatch([scene]), method, schedule, {})
        # Each call makes one step with a new stepper.
        while stopped.sample < 9:
            stopped.fill(*fields[1], 0, 9, 1)
            state = stopped.state()
            stopped = NativeStepper(ChainBatch([scene]), method, schedule, state)
        assert fields[0, :, :, 1:].tobytes() == fields[1, :, :, 1:].tobytes()


@pytest.mark.parametrize(
    ("viscoelastic", "drag"), [(1e-8, 0.0), (3e-7, 0.0), (0.0, 3e4), (1e-7, 1e4), (1e-6, 0.0)]
)
@pytest.mark.filterwarnings("ignore:.*rigid dashpots")
def test_a_mode_decays_at_the_exact_rate(viscoelastic, drag):
    """With one viscosity and one drag modes keep their shape, even if they are overdamped."""
    chain = damped_chain(
        exponent=1.0, damping={"viscoelastic": viscoelastic, "drag": drag}, bottom="wall"
    )
    shapes = modes.eigenmodes(chain)
    omega = shapes.frequency[4]
    shape = 1e-3 * chain.equilibrium_overlap[0] * shapes.shape[:, 4] / abs(shapes.shape[:, 4]).max()
    t = run(chain, Profile(displacement=shape), 20 / omega, 41, 1e-11)
    decay = viscoelastic * omega**2 / 2 + drag / 2
    turn = np.emath.sqrt(omega**2 - decay**2)
    course = np.exp(-decay * t.time) * (
        np.cos(turn * t.time) + decay / turn * np.sin(turn * t.time)
    )
    assert np.abs(t.displacement / shape - course.real[:, None]).max() < 1e-10


@pytest.mark.parametrize("damping", [{"viscoelastic": 3e-8}, {"viscoelastic": 1e-8, "drag": 1e3}])
def test_a_window_follows_a_damped_wave_in_a_long_chain(damping):
    """The motion is that of the middle of a short chain, which is computed as a whole."""
    for method in ("dop853", "verlet", "lagged-verlet"):
        found = []
        for grains in (61, 301):
            strike = Impulse(velocity=1e-2, grain=(grains + 1) // 2)
            scene = scene_of(damped_chain(grains=grains, damping=damping), strike, 4e-6, 5)
            schedule = Steps(20, 1, scene.duration / 80)
            stepper = NativeStepper(
                ChainBatch([scene]), methods_of(scene.chain)[method], schedule, {}
            )
            fields = np.zeros((2, 1, 5, grains))
            while stepper.sample < 4:
                stepper.fill(*fields, 0, 4, 3)
            found.append((fields[:, 0, 1:], stepper.watched[0]))
        (short, _), (long, state) = found
        size = np.abs(short).max((1, 2), keepdims=True)
        assert (np.abs(long[..., 120:181] - short) < 1e-18 * size).all()
        first, last = (state[name] - PAD for name in ("first", "last"))
        assert 60 < first < 145
        assert 155 < last < 240
        assert not long[..., :first].any()
        assert not long[..., last:].any()


def test_a_motion_that_dies_at_once_has_an_estimate():
    """The error is in the first samples, on which auxiliary runs must also land."""
    chain = damped_chain(damping={"drag": 2e6})
    scene = displaced(chain, samples=60, duration=1e-4)
    true, _ = reference(scene, 1e-18)
    for tolerance in (1e-2, 1e-6, 1e-9):
        t = simulate(scene, engine="native", tolerance=tolerance)
        error = true.error(t.displacement, t.velocity)
        assert error < min(tolerance, 3 * t.error_estimate.total)
    for steps in range(1, 10):
        t = simulate(scene, engine=Native(step=scene.duration / 59 / steps))
        error = true.error(t.displacement, t.velocity)
        assert error < 3 * t.error_estimate.total


def test_grains_at_rest_stay_at_rest():
    """A grain is moved away from an uncompressed chain, so that only rounding remains."""
    chain = column(5, gravity=0.0, damping={"viscoelastic": 1e-8, "drag": 1e4})
    away = Displacement(displacement=-1e-9, grain=1)
    t = simulate(scene_of(chain, away, 1e-4, 9), engine="native")
    assert abs(t.displacement - t.displacement[0]).max() < 1e-12 * 1e-9
    assert abs(t.velocity).max() < 1e-12 * 1e-9 * 1e4


def test_a_reference_is_finite_for_overlaps_below_rounding():
    """For delta slightly above 1, a closing viscous contact has a force at unresolved overlaps."""
    chain = damped_chain(grains=3, exponent=1.001, top_load=1e-3, damping={"viscoelastic": 1e-9})
    overlap = chain.equilibrium_overlap[0]
    apart = Profile(displacement=[300 * overlap * (1 - 1e-4) - overlap, 300 * overlap, 0.0])
    scene = scene_of(chain, apart, 5e-7, 3)
    true, doubt = reference(scene, 1e-18)
    assert doubt < 1e-9
    t = simulate(scene, engine="native", tolerance=1e-6)
    assert true.error(t.displacement, t.velocity) < 1e-6


@pytest.mark.parametrize("name", ["verlet", "dop853", "lagged-verlet"])
def test_an_answer_states_the_name_that_was_requested(name: str, tmp_path):
    scene = displaced(damped_chain(), 4)
    engine = Native(name, step=0.05 / scene.highest_frequency)
    assert simulate(scene, engine, folder=tmp_path).cost.integrator == name
    assert Trajectory.load(tmp_path).cost.integrator == name
