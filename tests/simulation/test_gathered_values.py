"""Accumulated peaks, arrivals and forces of chains of springs with exact motion."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import run, scene_of, stirred
from helpers.thinned import thinned
from scipy.optimize import minimize_scalar

from lmpchain import Chain, Displacement, Impulse, InputError, Law, Scene, engines, simulate
from lmpchain.engines import Native
from lmpchain.measure.motion import motion_of
from lmpchain.simulation.accumulation import GatheringRun, of_engine
from lmpchain.sweeps.quantities import with_gathered
from lmpchain.theory.modes import eigenmodes

ASKED = [
    "peak_velocity",
    "peak_displacement",
    "arrival_time",
    "peak_force:1",
    "force:1",
    "peak_force:3",
    "force:0",
]
CONTACTS = ("peak_force", 1), ("peak_force", 3), ("force", 0), ("force", 1)
pytestmark = pytest.mark.filterwarnings("ignore:Eq. ")


def springs(seed: int, samples: int = 3) -> Scene:
    """Return three unequal grains on closed springs between walls, moved in any way."""
    rng = np.random.default_rng(seed)
    chain = column(
        3,
        gravity=0.0,
        top_load=10.0,
        exponent=1.0,
        top="wall",
        bottom="wall",
        masses=rng.uniform(1, 3, 3) * 1e-6,
        contact_constants=rng.uniform(1, 3, 2) * 1e7,
        wall_constants=rng.uniform(1, 3, 2) * 1e7,
    )
    start = stirred(chain, 1e-3, 1e-3 / chain.band_edge, seed)
    duration = rng.uniform(20, 40) / chain.band_edge
    return scene_of(chain, start, duration, samples, quantities=ASKED)


def motion(scene: Scene, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return eigenmodes(scene.chain).response(times, *scene.initial())


def tops(scene: Scene, kind: int, grain: int) -> list[tuple[float, float]]:
    """Return the time and size of the largest displacement (0) or velocity (1) of a grain."""

    def values(t):
        return np.abs(motion(scene, np.atleast_1d(t))[kind][:, grain])

    grid = np.linspace(0, scene.duration, 4001)
    sizes = values(grid)
    step = grid[1]
    found = []
    for i in np.flatnonzero((sizes[1:-1] > sizes[:-2]) & (sizes[1:-1] >= sizes[2:])) + 1:
        best = minimize_scalar(
            lambda t: -float(values(t)[0]), bounds=(grid[i] - step, grid[i] + step),
            method="bounded",
            options={"xatol": 1e-6 * step},
        )  # fmt: skip
        found.append((float(best.x), -float(best.fun)))
    return [(0.0, float(sizes[0])), *found, (float(grid[-1]), float(sizes[-1]))]


def forces(scene: Scene, contact: int, times: np.ndarray) -> np.ndarray:
    u = np.column_stack([np.zeros(times.size), motion(scene, times)[0], np.zeros(times.size)])
    rest = scene.chain.contacts.force[contact]
    stiffness = scene.chain.contacts.stiffness[contact]
    return rest + stiffness * (u[:, contact] - u[:, contact + 1])


def check_within_errors(scene: Scene, gathered: dict[str, np.ndarray]) -> None:
    """Check that each accumulated quantity differs from the exact one by at most its error."""

    def check(name: str, exact: np.ndarray | float, rounding: float = 0.0, part: Any = ...) -> None:
        off = np.abs(gathered[name][part] - exact)
        assert (off <= gathered[f"{name}_error"][part] + rounding).all(), name

    for grain in range(3):
        for kind, name in enumerate(("peak_displacement", "peak_velocity")):
            top = max(size for _, size in tops(scene, kind, grain))
            check(name, top, 1e-9 * top, grain)
        maxima = tops(scene, 1, grain)
        largest = max(size for _, size in maxima)
        if abs(scene.initial()[1][grain]) >= largest / 2:
            assert np.isnan(gathered["arrival_time"][grain])
        else:
            fronts = [when for when, size in maxima[1:-1] if size >= largest / 2]
            check("arrival_time", fronts[0], 1e-6 / scene.chain.band_edge, grain)
    for contact in (0, 1):
        check(f"force:{contact}", forces(scene, contact, gathered["fine_time"]))
    for contact in (1, 3):
        dense = forces(scene, contact, np.linspace(0, scene.duration, 40_001)).max()
        check(f"peak_force:{contact}", dense, 1e-7 * dense)


@pytest.mark.parametrize(("engine", "seed"), thinned(product(["native", "modes"], range(6)), 2))
def test_accumulated_quantities_are_right_within_their_errors(engine, seed):
    scene = springs(seed)
    gathered = simulate(scene, engine, 1e-9).gathered
    check_within_errors(scene, gathered)
    fine = gathered["fine_time"]
    assert (fine[-1], fine.size) == (scene.duration, scene.fine.samples)
    speed, unit = 1e-3, 1 / scene.chain.band_edge
    force = scene.chain.contacts.stiffness * speed * unit
    for name, limit in {
        "peak_velocity": 1e-4 * speed,
        "peak_displacement": 1e-4 * speed * unit,
        "arrival_time": 1e-2 * unit,
        "force:0": 1e-6 * force[0],
        "force:1": 1e-6 * force[1],
        "peak_force:1": 1e-3 * force[1],
        "peak_force:3": 1e-3 * force[3],
    }.items():
        assert np.nanmax(gathered[f"{name}_error"]) < limit, name


@pytest.mark.parametrize("steps", [24, 40])
def test_errors_of_accumulated_quantities_include_that_of_the_run(steps):
    """The run has long steps, and a force has the errors of the two grains of its contact."""
    scene = springs(3, samples=2)
    t = simulate(scene, Native("verlet", step=2 * np.pi / scene.chain.band_edge / steps))
    error = t.error_estimate.total
    assert error > 1e-3
    check_within_errors(scene, t.gathered)
    u, v = (
        error * max(size for grain in range(3) for _, size in tops(scene, kind, grain))
        for kind in (0, 1)
    )
    stiffness = scene.chain.contacts.stiffness
    # Errors exceed that of the run, because samples may miss the largest value.
    for name, of_run, most in (
        ("peak_displacement", u, 1.1),
        ("peak_velocity", v, 2.0),
        *((f"{kind}:{n}", 2 * stiffness[n] * u, 1.1) for kind, n in CONTACTS),
    ):
        ratio = t.gathered[f"{name}_error"] / of_run
        assert np.min(ratio) > 1.0, name
        assert np.max(ratio) < most, name


def test_grains_that_start_fastest_or_never_move_have_no_arrival():
    chain = column(30)
    gathered = run(
        chain, Impulse(velocity=1e-4), 3e-5, 2, 1e-8, quantities=["arrival_time", "peak_velocity"]
    ).gathered
    assert np.isnan(gathered["arrival_time"][0])  # This grain is struck.
    assert np.isnan(gathered["arrival_time"][-1])
    assert gathered["arrival_time"][1] > 0
    assert gathered["peak_velocity"][0] == pytest.approx(1e-4, rel=1e-7)
    assert gathered["peak_velocity_error"][0] < 2e-8 * 1e-4 * 2
    assert gathered["peak_velocity"][-1] == 0


def test_only_requested_quantities_are_accumulated():
    scene = springs(1)
    for name in ASKED:
        gathered = simulate(scene.replace(quantities=[name]), "modes", 0.9).gathered
        assert set(gathered) - {"fine_time"} == {name, f"{name}_error"}
        assert ("fine_time" in gathered) == name.startswith("force")


def test_an_accumulating_run_passes_samples_on_and_keeps_its_state():
    scene = springs(2, samples=4)
    engine = engines.plain("modes")
    part = engine.part(scene)
    run = GatheringRun(engine.start([part], engine.propose(part, 0.9)), engine, [scene], [part], {})
    blocks = list(run.blocks())
    assert run.progress == 1
    assert blocks[0].samples.start == 0
    u = np.concatenate([block.displacement[0] for block in blocks])
    np.testing.assert_allclose(
        u, motion(scene, scene.time)[0], rtol=0, atol=1e-12 * np.abs(u).max()
    )
    state = run.state()
    own = of_engine(state)
    assert set(own) == {key for key in state if not key.startswith("gathered.")}
    assert len(state) > len(own)
    again = GatheringRun(
        engine.start([part], engine.propose(part, 0.9), own), engine, [scene], [part], state
    )
    one = run.results([1e-9])[0]
    other = again.results([1e-9])[0]
    assert one.keys() == other.keys()
    for name, values in one.items():
        assert np.array_equal(values, other[name], equal_nan=True)
    wrong = state | {"gathered.0.fast": np.zeros((3, 2))}
    with pytest.raises(ValueError, match="the stored state does not belong to this scene"):
        GatheringRun(
            engine.start([part], engine.propose(part, 0.9), own), engine, [scene], [part], wrong
        )
    assert run.cost().steps == part.samples - 1
    assert run.errors()[0].roundoff > 0


def test_a_released_grain_is_nearest_at_the_start():
    """The largest force may be that at t = 0.

    Of a grain that is pushed into its contact and let go.
    """
    chain = column(2, gravity=0.0, top_load=10.0)
    gathered = run(
        chain,
        Displacement(displacement=1e-2 * chain.length_scale),
        1 / chain.band_edge,
        2,
        1e-9,
        quantities=["peak_force:1", "peak_displacement"],
    ).gathered
    assert gathered["peak_force:1"] == pytest.approx(10.0 * 1.01**1.5, rel=1e-9)
    assert gathered["peak_displacement"][0] == pytest.approx(1e-2 * chain.length_scale, rel=1e-9)


def test_the_largest_force_of_a_contact_that_softens_is_passed_before_it_is_closest():
    """The force decreases beyond an overlap of 0.72 L, and a strong strike reaches 2 L."""
    length, k = 1e-6, 1e5
    law = Law("k*(o*exp(-(o/L)**2) + 0.02*o)", k=k, L=length)
    walls = {"top": "wall", "bottom": "wall", "gravity": 0.0}
    chain = Chain(grains=4, diameter=1.0, law=law, masses=np.full(4, 1e-3), **walls)
    top = minimize_scalar(lambda x: -law.force(x * length), bounds=(0, 1.2), method="bounded")
    rate = np.sqrt(k / 1e-3)
    for speed, passed in ((4.0, True), (0.3, False)):
        strike = Impulse(velocity=speed * length * rate)
        asked = ["peak_force:1", "force:1"]
        gathered = run(chain, strike, 20 / rate, 11, 1e-8, quantities=asked).gathered
        peak, error = gathered["peak_force:1"], gathered["peak_force:1_error"]
        assert error < 0.02 * peak
        assert 0.99 * peak - error <= gathered["force:1"].max() <= peak + error
        if passed:
            assert peak == pytest.approx(-top.fun, rel=1e-9)
        else:
            assert peak < -0.9 * top.fun
    # A sweep therefore accumulates the force on the wall, which samples alone do not show.
    hard = run(chain, strike, 20 / rate, 11)
    assert with_gathered(hard.scene, ["wall_force"], True).quantities == ("peak_force:4",)
    with pytest.raises(InputError, match="a softening contact is not at its closest approach"):
        motion_of(hard).largest_wall_force()
    # A bound that another overlap may exceed is part of the error.
    wave = Law("k*L*sin(o/L) + 0.1*k*o", k=k, L=length)
    weak = Impulse(velocity=0.1 * length * rate)
    gathered = run(chain.replace(law=wave), weak, 5 / rate, 5, quantities=["peak_force:1"]).gathered
    stretched = minimize_scalar(
        lambda x: -wave.force(x * length), bounds=(-6, -4), method="bounded"
    )
    bound = gathered["peak_force:1"] + gathered["peak_force:1_error"]
    assert bound == pytest.approx(-stretched.fun, rel=0.05)
    with pytest.raises(InputError, match=r"quantities: peak_force:1 is not found in viscous"):
        scene_of(
            chain.replace(damping={"viscoelastic": 1e-5}),
            weak,
            5 / rate,
            quantities=["peak_force:1"],
        )
