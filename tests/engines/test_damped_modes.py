"""Modes of damped chains: decay, forcing, and the error of linearisation."""

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck
from helpers.taylor_series import reference, solve

from lmpchain import (
    Chain,
    Drive,
    Force,
    Impulse,
    InputError,
    Packet,
    Profile,
    Scene,
    plan,
    simulate,
)
from lmpchain.engines import Modes
from lmpchain.theory import modes

# Linear engines warn that they neglect terms.
pytestmark = pytest.mark.filterwarnings("ignore:Eq. ", "ignore:chain.damping")
# A weak and a strong viscosity, and a drag that overdamps the lowest modes.
DAMPINGS = [
    {"viscoelastic": 3e-8, "drag": 1e3},
    {"drag": 1e4},
    {"viscoelastic": 1e-6},
    {"viscoelastic": 6e-6, "drag": 1e4},
    {"drag": 8e5},
]
ROWS = {"grains": 12, "diameter": 1e-3, "bottom": "wall", "top_load": 0.1}
# Amplitudes for which the error of linearisation is negligible.
ACTS = {
    "strike": Impulse(velocity=1e-13, grain=3),
    "profile": Profile(displacement=np.cos(np.arange(12.0)) * 1e-19, velocity=np.zeros(12)),
    "force": Force(grain=2, amplitude=1e-13, frequency=2e4),
    "drive": Drive(amplitude=1e-19, frequency=2e4),
    "burst": Drive(amplitude=1e-19, frequency=5e4, cycles=2),
    "wall": Drive(grain=0, amplitude=1e-19, frequency=2e4),
}


def between_walls(**fields) -> Chain:
    return Chain(**ROWS | {"top": "wall"} | fields)


def drawn(seed: int) -> Scene:
    """Return a random damped chain with a forcing."""
    rng = np.random.default_rng(seed)
    grains = int(rng.integers(3, 30))
    load = 10 ** rng.uniform(-2, 0)
    act = rng.choice(["strike", "force", "drive", "wall"])
    top = {"drive": "free", "wall": "wall"}.get(act, rng.choice(["free", "wall"]))
    chain = column(
        grains,
        gravity=9.81 * float(rng.random() < 0.5),
        top_load=load,
        top=str(top),
        bottom="wall",
        exponent=float(rng.choice([1.2, 1.5, 2.5])),
        masses=rng.uniform(1, 4, grains) * 1e-6,
    )
    edge = chain.band_edge
    damping = {"viscoelastic": 10 ** rng.uniform(-3, 0.5) / edge}
    if rng.random() < 0.5:
        damping["drag"] = 10 ** rng.uniform(-4, 0) * edge
    strain = 10 ** rng.uniform(-3, -0.3)
    overlap = float(chain.equilibrium_overlap.min())
    grain = int(rng.integers(1, grains + 1))
    frequency = edge / (2 * np.pi) * rng.uniform(0.05, 0.6)
    excitation = {
        "strike": Impulse(velocity=strain * overlap * edge / 2, grain=grain),
        "force": Force(grain=grain, amplitude=0.3 * strain * load, frequency=frequency),
        "drive": Drive(amplitude=0.3 * strain * overlap, frequency=frequency),
        "wall": Drive(grain=0, amplitude=0.3 * strain * overlap, frequency=frequency),
    }[str(act)]
    duration = 10 ** rng.uniform(0.3, 2) / edge
    damped = chain.replace(damping=damping)
    return scene_of(damped, excitation, duration, 31)


@pytest.mark.parametrize("act", ACTS)
@pytest.mark.parametrize("damping", DAMPINGS, ids=str)
def test_weak_motion_is_exact(damping, act):
    top = "free" if act in ("drive", "burst") else "wall"
    chain = between_walls(top=top, damping=damping)
    scene = scene_of(chain, ACTS[act], 6e-5, 21)
    t = simulate(scene, engine="modes")
    true, _ = reference(scene, 1e-18)
    assert true.error(t.displacement, t.velocity) < 1e-12
    assert t.error_estimate.solver < 2e-10


def test_a_packet_is_exact():
    chain = column(80, gravity=0.0, top_load=1.0, damping={"viscoelastic": 3e-8, "drag": 1e3})
    frequency = 0.4 * chain.band_edge / (2 * np.pi)
    packet = Packet(frequency=frequency, width=5.0, grain=40, amplitude=1e-19)
    scene = scene_of(chain, packet, 1e-5, 5)
    t = simulate(scene, engine="modes")
    true, _ = reference(scene, 1e-18)
    assert true.error(t.displacement, t.velocity) < 1e-11


@pytest.mark.parametrize("viscoelastic", [0.0, 1e-9, 1e-7, 1e-6, 2.5e-6])
@pytest.mark.parametrize("drag", [0.0, 1e2, 1e5])
def test_a_mode_decays_like_an_oscillator(viscoelastic, drag):
    lossless = modes.eigenmodes(between_walls())
    damped = modes.eigenmodes(between_walls(damping={"viscoelastic": viscoelastic, "drag": drag}))
    assert damped.shape.tolist() == lossless.shape.tolist()
    time = np.linspace(0.0, 3e-5, 7)
    for number, w in enumerate(lossless.frequency):
        decay = (viscoelastic * w**2 + drag) / 2
        root = np.sqrt(complex(decay**2 - w**2))
        slow = -decay + root
        fast = -decay - root
        # Decay from rest at displacement 1.
        amplitude = (slow * np.exp(fast * time) - fast * np.exp(slow * time)) / (slow - fast)
        u, _ = damped.response(time, displacement=lossless.shape[:, number])
        share = u @ (damped.mass * lossless.shape[:, number])
        assert share == pytest.approx(amplitude.real, abs=1e-10)


def test_a_critical_mode_causes_no_division_by_zero():
    chain = between_walls()
    lowest = float(modes.eigenmodes(chain).frequency[0])
    damped = chain.replace(damping={"drag": 2 * lowest})
    shape = modes.eigenmodes(chain).shape[:, 0]
    u, _ = modes.eigenmodes(damped).response([1 / lowest], displacement=shape)
    assert u @ (chain.masses * shape) == pytest.approx([2 / np.e], abs=1e-9)
    shaken = scene_of(damped, ACTS["wall"], 6e-5, 21)
    t = simulate(shaken, engine="modes")
    true, _ = reference(shaken, 1e-18)
    error = true.error(t.displacement, t.velocity)
    assert error < t.error_estimate.model + t.error_estimate.solver


def test_the_error_of_linearisation_is_within_its_estimate():
    ratios = []
    for seed in range(60):
        scene = drawn(seed)
        t = simulate(scene, engine="modes")
        error = solve(scene, 1e-12).error(t.displacement, t.velocity)
        foreseen = Modes().propose(Modes().part(scene), 1e-6).model_error
        assert error <= max(3 * foreseen, 1e-9)
        ratios.append(error / (t.error_estimate.model + 1e-10))
    assert max(ratios) < 3
    assert np.median(ratios) > 0.03


def test_modes_are_chosen_where_they_are_cheapest():
    chain = between_walls(damping={"viscoelastic": 1e-9})
    long = struck(chain, 1e-13, 0.1, 11)
    assert plan(long).engine == "modes"
    strong = long.replace(excitation=Impulse(velocity=1e-2), duration=1e-4)
    assert plan(strong).engine == "native"


@pytest.mark.parametrize(
    ("key", "damping"),
    [
        ("viscoelastic", {"viscoelastic": np.linspace(1e-8, 2e-8, 11)}),
        ("drag", {"drag": np.linspace(1.0, 2.0, 12)}),
    ],
)
def test_damping_that_couples_modes_is_rejected(key, damping):
    chain = between_walls(damping=damping)
    scene = struck(chain, 1e-9, 1e-5)
    words = f"damping.{key}: differs from .* one number"
    with pytest.raises(InputError, match=f"{words}, or use the native engine"):
        simulate(scene, engine="modes")
    with pytest.raises(InputError, match=f"{words}$"):
        modes.eigenmodes(chain)
    alike = {key: np.full(11 if key == "viscoelastic" else 12, 1e-8) for key in damping}
    simulate(scene.replace(chain=between_walls(damping=alike)), engine="modes")
