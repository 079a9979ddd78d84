"""A column whose base is shaken: all methods against references that do not turn it upside down."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import random_column
from helpers.example_scenes import scene_of
from helpers.independent_integrators import distance
from helpers.thinned import thinned
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import lmpchain
from lmpchain import Chain, Damping, Drive, Impulse, InputError, Profile, Scene, engines, simulate
from lmpchain.benchmark.reference import Reference, reference
from lmpchain.measure import contact, energy, power

SHAKEN = Drive(end="bottom", amplitude=3e-6, frequency=2000.0)
PATH = Drive(end="bottom", times=[0, 2e-4, 4e-4, 6e-4], displacement=[0, -1e-6, 1e-6, 0])
BOTTOMS = pytest.mark.parametrize("bottom", ["wall", "fixed"])


def steel_column(seed: int = 1, grains: int = 8, **keys: Any) -> Chain:
    """Return a column of random steel beads under gravity."""
    return random_column(grains, seed, diameter=5e-3, material="steel", **keys)


def own_solution(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the moving grains by SciPy, from weights and overlaps in the laboratory frame."""
    chain = scene.chain
    drive = scene.drive
    assert drive is not None
    moving = chain.movable
    masses = chain.masses[:moving]
    constant = chain.contacts.constant
    carried = chain.gravity * np.cumsum(masses)
    rest = np.zeros(moving + 1)
    rest[1:] = (carried / constant[1 : moving + 1]) ** (2 / 3)

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        base, speed = drive.motion(t)
        u = np.concatenate([[0.0], state[:moving], [base]])
        v = np.concatenate([[0.0], state[moving:], [speed]])
        overlap = np.maximum(rest - np.diff(u), 0.0)
        viscous = chain.contact_viscosity[: moving + 1] * 1.5 * np.sqrt(overlap) * -np.diff(v)
        force = constant[: moving + 1] * (overlap**1.5 + viscous)
        pull = np.diff(-force) / masses + chain.gravity - chain.drag[:moving] * v[1:-1]
        return np.concatenate([v[1:-1], pull])

    step = scene.sampling_interval
    run = solve_ivp(
        rates, (0, scene.duration), np.zeros(2 * moving), "DOP853", t_eval=scene.time,
        rtol=1e-13, atol=1e-19, max_step=step / 2,
    )  # fmt: skip
    return run.y[:moving].T, run.y[moving:].T


@cache
def solved(bottom: str, top: str, drive: Drive) -> tuple[Scene, Reference]:
    """Return a scene for all methods, and its reference."""
    scene = scene_of(steel_column(grains=5, bottom=bottom, top=top), drive, 4e-4, 41)
    return scene, reference(scene)


# The methods vary first, so that one process computes the reference of a scene.
@pytest.mark.parametrize(("bottom", "top"), [("wall", "free"), ("fixed", "wall")])
@pytest.mark.parametrize("drive", [SHAKEN, PATH], ids=["sine", "path"])
@pytest.mark.parametrize(
    ("method", "tolerance"),
    thinned(
        [("rkn6", 1e-9), ("rkn4", 1e-9), ("kahan-li8", 1e-9), ("dop853", 1e-9), ("gear4", 1e-6)], 3
    ),
)
def test_errors_of_all_methods_hold_where_contacts_open(
    bottom: str, top: str, drive: Drive, method: str, tolerance: float
) -> None:
    scene, exact = solved(bottom, top, drive)
    run = simulate(scene, engines.Native(method), tolerance=tolerance)
    off = distance(run, exact, exact.scale)
    assert scene.strike_number > 1
    assert off <= run.error_estimate.total + exact.error
    assert run.error_estimate.total <= tolerance


@pytest.mark.parametrize(("bottom", "seed"), [("wall", 0), ("fixed", 1)])
def test_damped_random_columns_agree_with_own_integration(bottom: str, seed: int) -> None:
    damping = Damping(viscoelastic=1e-6, drag=100.0)
    scene = scene_of(steel_column(seed, bottom=bottom, damping=damping), SHAKEN, 6e-4, 61)
    u, v = own_solution(scene)
    run = simulate(scene, "native", tolerance=1e-8)
    moving = slice(0, scene.chain.movable)
    off = max(
        np.abs(run.displacement[:, moving] - u).max() / np.abs(run.displacement).max(),
        np.abs(run.velocity[:, moving] - v).max() / np.abs(run.velocity).max(),
    )
    # The integration of this test steps over openings, with an error of up to 1e-8.
    assert off <= run.error_estimate.total + 1e-8


def test_a_ball_that_bounces_on_a_plate_lands_when_its_parabola_meets_the_plate() -> None:
    chain = Chain(grains=1, diameter=1e-2, material="steel", bottom="wall")
    shaker = Drive(end="bottom", amplitude=2e-4, frequency=50.0)
    peak = (2 * np.pi * 50) ** 2 * 2e-4
    assert peak > 2 * chain.gravity

    def last(duration: float) -> tuple[float, float]:
        """Return the overlap with the plate at the end, and its rate."""
        run = simulate(scene_of(chain, shaker, duration, 2001), "native", tolerance=1e-7)
        base, speed = shaker.motion(duration)
        overlap = chain.contacts.overlap[1] + run.displacement[-1, 0] - base
        return float(overlap), float(run.velocity[-1, 0] - speed)

    run = simulate(scene_of(chain, shaker, 0.019, 3801), "native", tolerance=1e-7)
    flies = contact.contacts(run, [1]).force[:, 0] == 0
    # The last flight follows small bounces that the sudden start of the plate causes.
    above = np.arange(1 + np.flatnonzero(~flies)[-1], flies.size)
    assert above.size > 500
    middle = above[above.size // 2]
    # Nothing but its weight acts on the ball in flight.
    since = run.time[above] - run.time[middle]
    start = run.displacement[middle, 0], run.velocity[middle, 0]
    flight = start[0] + start[1] * since + chain.gravity * since**2 / 2
    assert np.abs(run.displacement[above, 0] - flight).max() < 1e-7 * shaker.amplitude

    def gap(t: float) -> float:
        fall = t - run.time[middle]
        ball = start[0] + start[1] * fall + chain.gravity * fall**2 / 2
        return float(shaker.motion(t)[0] - ball - chain.contacts.overlap[1])

    landing = brentq(gap, run.time[middle], 0.03, xtol=1e-15)
    overlap, rate = last(landing)
    assert rate > 0.05
    assert abs(overlap / rate) < 1e-7 * landing
    assert last(landing * (1 + 1e-5))[0] > 0 > last(landing * (1 - 1e-5))[0]


@BOTTOMS
@pytest.mark.parametrize(("top", "lossy"), [("free", False), ("wall", False), ("wall", True)])
def test_the_balance_of_energy_and_momentum_closes(bottom: str, top: str, lossy: bool) -> None:
    damping = {"viscoelastic": 1e-6, "drag": 100.0} if lossy else {}
    chain = steel_column(bottom=bottom, top=top, damping=damping)
    for drive in (SHAKEN, Drive(end="bottom", shape="piston", velocity=-0.01, rise=1e-4)):
        run = simulate(scene_of(chain, drive, 1e-3, samples=4001), "native", tolerance=1e-8)
        ledger = energy.ledger(run)
        size = np.abs(ledger.total).max()
        parts = ledger.kinetic + ledger.contact + ledger.gravity + ledger.load - ledger.total
        np.testing.assert_allclose(parts, parts[0], atol=1e-13 * size)
        # The work of the driver, by the force at its end and its motion, in another way.
        base, speed, _ = contact.drive_motion(run)
        force = contact.drive_force(run)
        support = chain.contacts.force[chain.movable] + chain.held_weight
        own = np.append(0, np.cumsum(np.diff(run.time) * np.convolve(force * speed, [0.5, 0.5],
                                                                     "valid")))  # fmt: skip
        np.testing.assert_allclose(own + support * base, ledger.drive, atol=3e-4 * size)
        assert ledger.drive_error < 1e-5 * size
        # The change of momentum is the impulse of the driver, the weight, and the top wall.
        pushed = force + chain.masses.sum() * chain.gravity
        if bottom == "wall":
            pushed = contact.drive_force(run) + chain.masses.sum() * chain.gravity
        if top == "wall":
            pushed = pushed + contact.contacts(run, [0]).force[:, 0]
        if not lossy:
            own = np.append(0, np.cumsum(np.diff(run.time) * np.convolve(pushed, [0.5, 0.5],
                                                                         "valid")))  # fmt: skip
            change = ledger.momentum - ledger.momentum[0]
            np.testing.assert_allclose(own, change, atol=3e-4 * np.abs(ledger.momentum).max())


@BOTTOMS
def test_quantities_between_samples_and_recorded_grains(bottom: str) -> None:
    chain = steel_column(bottom=bottom, top="wall")
    last = chain.movable
    names = [f"peak_force:{last}", "peak_force:0", f"force:{last}", "peak_velocity"]
    fine = simulate(scene_of(chain, SHAKEN, 1e-3, samples=8001), "native", tolerance=1e-8)
    scene = scene_of(chain, SHAKEN, 1e-3, samples=21).replace(quantities=names, grains=[2, 8])
    run = simulate(scene, "native", tolerance=1e-8)
    np.testing.assert_allclose(
        run.displacement, fine.displacement[::400][:, [1, 7]], atol=1e-7 * 3e-6
    )
    forces = contact.contacts(fine, [0, last]).force
    for number, force in ((0, forces[:, 0]), (last, forces[:, 1])):
        gathered, error = (run.gathered[f"peak_force:{number}{end}"] for end in ("", "_error"))
        # A peak between fine samples is higher by the curvature at most.
        beyond = np.abs(np.diff(force, 2)).max() / 8
        assert force.max() - error <= gathered <= force.max() + beyond + error
    every = (run.gathered["fine_time"].size - 1) // 20
    np.testing.assert_allclose(
        run.gathered[f"force:{last}"][::every], forces[::400, 1], atol=1e-5 * forces.max()
    )
    speeds = np.abs(fine.velocity[:, [1, 7]]).max(0)
    np.testing.assert_allclose(run.gathered["peak_velocity"], speeds, rtol=1e-4)


def test_batches_files_and_starts_of_their_own(tmp_path: Path) -> None:
    chain = steel_column(bottom="wall")
    velocity = np.linspace(1e-3, -1e-3, 8)
    drive = SHAKEN.replace(start=Profile(velocity=velocity))
    scene = scene_of(chain, drive, duration=3e-4)
    scene.to_toml(tmp_path / "scene.toml")
    assert Scene.from_toml(tmp_path / "scene.toml") == scene
    alone = simulate(scene, "native", tolerance=1e-8)
    exact = reference(scene)
    np.testing.assert_array_equal(alone.velocity[0], velocity)
    off = np.abs(alone.velocity - exact.velocity).max() / exact.scale[1]
    assert off <= alone.error_estimate.total
    other = scene.replace(excitation=drive.replace(amplitude=2e-6))
    both = lmpchain.simulate_many([scene, other], tolerance=1e-8)
    assert np.abs(both[0].velocity - alone.velocity).max() < 1e-7 * exact.scale[1]
    assert both[1].velocity[50, -1] != both[0].velocity[50, -1]


@pytest.mark.parametrize(
    ("fields", "drive", "key"),
    [
        ({"bottom": "free", "gravity": 0.0}, {}, "end"),
        ({"ground": lmpchain.Law("k0*u", k0=1e3)}, {}, "end"),
        ({"gravity": 0.0, "top_load": 1.0, "load_grain": 2}, {}, "end"),
        ({}, {"grain": 1}, "grain"),
    ],
)
def test_what_cannot_be_shaken_is_refused(
    fields: dict[str, Any], drive: dict[str, Any], key: str
) -> None:
    chain = steel_column(**fields)

    def shake() -> Scene:
        return scene_of(chain, Drive(end="bottom", amplitude=1e-6, frequency=1e3, **drive), 1e-3)

    with pytest.raises(InputError, match=f"^{key}: "):
        shake()


def test_engines_without_a_moving_base_refuse_it() -> None:
    scene = scene_of(steel_column(bottom="wall"), SHAKEN.replace(amplitude=1e-12), 1e-3)
    for engine in ("lammps", "modes", "chebyshev"):
        with pytest.raises(InputError, match="cannot drive the base; use the native engine"):
            simulate(scene, engine)
    assert simulate(scene).engine == "native"
    with pytest.raises(InputError, match="whose base is driven"):
        lmpchain.design.gradient(scene, lmpchain.design.PeakForce(3), ["masses"])
    with pytest.raises(InputError, match="must act on the top"):
        lmpchain.orbits.find(scene.chain, Profile(velocity=np.zeros(8)), drive=SHAKEN)


def test_drives_from_above_and_below_are_mirror_images_without_gravity() -> None:
    fields = {"gravity": 0.0, "top_load": 2.0, "top": "wall", "bottom": "wall"}
    chain = steel_column(**fields)
    assert isinstance(chain.diameter, np.ndarray)
    mirror = chain.replace(diameter=chain.diameter[::-1])
    below = simulate(scene_of(chain, SHAKEN, 1e-3), "native", tolerance=1e-9)
    above = Drive(grain=0, amplitude=-3e-6, frequency=2000.0)
    other = simulate(scene_of(mirror, above, 1e-3), "native", tolerance=1e-9)
    size = np.abs(other.velocity).max()
    assert np.abs(below.velocity + other.velocity[:, ::-1]).max() < 2e-9 * size
    assert Impulse(velocity=1.0).from_below is False


@BOTTOMS
def test_power_of_a_shaker_below(bottom: str) -> None:
    """The input power of a weak shaker agrees with linear theory and with the ledger."""
    damping = Damping(viscoelastic=4e-6)
    chain = Chain(grains=6, material="steel", diameter=1e-2, bottom=bottom, damping=damping)
    shaker = Drive(end="bottom", amplitude=1e-10, frequency=300.0)
    run = simulate(scene_of(chain, shaker, 0.2, 4801), "native", tolerance=1e-8)
    passed = power.through(run, 5)
    assert passed.input == pytest.approx(passed.linear_input, rel=1e-6)
    assert passed.mean == pytest.approx(passed.linear, rel=1e-6)
    work = energy.ledger(run).drive
    mean = (work[-1] - work[2400]) / 0.1
    assert passed.input == pytest.approx(mean, rel=1e-3)
