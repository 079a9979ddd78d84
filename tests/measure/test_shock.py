"""Shocks that are measured are those of theory; mass and momentum are conserved in the mean."""

from functools import cache

import numpy as np
import pytest

from lmpchain import (
    Chain,
    Damping,
    Drive,
    Impulse,
    InputError,
    Riemann,
    Scene,
    Trajectory,
    simulate,
)
from lmpchain.measure import energy, shock
from lmpchain.theory.shock import Medium, State

CHAIN = Chain(
    grains=300,
    material="steel",
    diameter=9.5e-3,
    gravity=0.0,
    top_load=10.0,
    top="wall",
    bottom="wall",
)
OVERLAP = float(CHAIN.contacts.overlap[1])
SOUND = float(np.sqrt(CHAIN.contacts.stiffness[1] / CHAIN.masses[1]))  # grains/s
GAS = Medium(1.5, float(CHAIN.contacts.constant[1]), float(CHAIN.masses[1]))
REST = State(0.0, OVERLAP)


@cache
def piston(velocity: float, grains: int = 300, viscosity: float = 0.0) -> Trajectory:
    """Run a piston, its velocity in that of sound times the overlap, until the shock is near N."""
    damping = Damping(viscoelastic=viscosity / SOUND) if viscosity else None
    chain = CHAIN.replace(grains=grains, damping=damping)
    speed = velocity * OVERLAP * SOUND
    drive = Drive(shape="piston", velocity=speed, rise=10 / SOUND, grain=0)
    front = GAS.rankine_hugoniot(REST, speed)[1]
    scene = Scene(chain=chain, excitation=drive, duration=grains / front, samples=4 * grains + 1)
    return simulate(scene, engine="native", tolerance=1e-6)


def test_momentum_is_the_impulse_of_the_piston() -> None:
    """Momentum grows as wall and held forces say, energy as their work, to 1e-6."""
    ledger = energy.ledger(piston(1.0))
    assert np.abs(ledger.momentum_drift).max() < 1e-6 * ledger.momentum.max()
    assert np.abs(ledger.drift).max() < 1e-6 * ledger.total.max()


def test_rankine_and_hugoniot_hold_in_the_mean() -> None:
    """A step between the states of a steady shock moves at its speed, by mass and by momentum."""
    behind, speed = GAS.rankine_hugoniot(REST, 0.4 * OVERLAP * SOUND)
    strain = (behind.overlap - OVERLAP) / 9.5e-3
    step = Riemann(velocity=(behind.velocity, 0), strain=(strain, 0), grain=150)
    chain = CHAIN.replace(top="free")
    scene = Scene(chain=chain, excitation=step, duration=50 / SOUND, samples=101)
    run = simulate(scene, engine="native", tolerance=1e-9)
    # contacts that no wave from the top has reached
    closer = (run.displacement[:, 79:-1] - run.displacement[:, 80:]) / (behind.overlap - OVERLAP)
    moving = run.velocity[:, 79:] / behind.velocity
    for share in (closer, moving):
        place = share.sum(1)
        assert place[-1] - place[0] == pytest.approx(speed * scene.duration, rel=1e-6)


@pytest.mark.parametrize("velocity", [0.5, 1.0])
def test_edges_of_a_dispersive_shock(velocity: float) -> None:
    """Plateau and both edges are those of Whitham's theory as far as the run is old enough."""
    found = shock.find(piston(velocity))
    assert found.kind == "dispersive shock"
    assert found.behind.velocity == pytest.approx(velocity * OVERLAP * SOUND, rel=1e-4)
    assert found.behind.overlap == pytest.approx(found.simple.overlap, rel=3e-4)
    theory = found.predictions["whitham"]
    assert abs(found.leading.speed - theory.leading) < 2 * found.leading.error
    assert abs(found.trailing.speed - theory.trailing) < 3 * found.trailing.error
    assert found.leading.height == pytest.approx(theory.height, rel=0.1)
    # the crest is a solitary wave on the state ahead
    assert found.leading.speed == pytest.approx(found.solitary, rel=2e-3)


def test_weakest_shocks_have_edges_too() -> None:
    """Below the slowest solitary wave that is solved for, its speed is left out."""
    found = shock.find(piston(1e-5))
    assert np.isnan(found.solitary)
    assert found.leading.speed == pytest.approx(SOUND, rel=0.01)


def test_piston_in_a_sonic_vacuum() -> None:
    """The leading wave is the exact solitary wave, of twice the speed of the piston."""
    chain = CHAIN.replace(grains=200, top_load=0.0)
    drive = Drive(shape="piston", velocity=0.05, rise=1e-4, grain=0)
    scene = Scene(chain=chain, excitation=drive, duration=3e-3, samples=901)
    found = shock.find(simulate(scene, engine="native", tolerance=1e-5))
    assert found.leading.velocity == pytest.approx(2 * 0.05, rel=0.01)
    assert found.leading.speed == pytest.approx(found.solitary, rel=1e-3)
    assert found.behind.overlap == pytest.approx(found.rankine_hugoniot[0].overlap, rel=0.01)
    assert np.isnan(found.trailing.speed)


def test_steady_shock_of_a_damped_chain() -> None:
    """It travels as Rankine and Hugoniot say, about as thick as Burgers has it."""
    found = shock.find(piston(0.3, viscosity=0.3))
    theory, speed = found.rankine_hugoniot
    assert found.kind == "steady shock"
    assert found.leading.speed == pytest.approx(speed, rel=5e-4)
    assert found.behind.overlap == pytest.approx(theory.overlap, rel=1e-4)
    assert found.thickness == pytest.approx(found.predictions["burgers"].height, rel=0.25)


@pytest.mark.parametrize("direction", ["down", "up"])
def test_rarefaction_is_that_of_the_characteristics(direction: str) -> None:
    """A step to less compression opens at the speeds of sound on either side, both ways."""
    less = -0.5 * OVERLAP / 9.5e-3
    down = direction == "down"
    strain = (less, 0) if down else (0, less)
    grain = 250 if down else 150
    chain = CHAIN.replace(grains=400, top="free")
    step = Riemann(velocity=(0, 0), strain=strain, grain=grain)
    scene = Scene(chain=chain, excitation=step, duration=150 / SOUND, samples=601)
    found = shock.find(simulate(scene, engine="native", tolerance=1e-5), direction)
    assert found.kind == "rarefaction"
    sides = State(0, OVERLAP), State(0, OVERLAP / 2)
    between = GAS.between(*sides)
    assert found.behind.overlap == pytest.approx(between.overlap, rel=2e-3)
    theory = found.predictions["continuum"]
    for edge, speed in ((found.leading, theory.leading), (found.trailing, theory.trailing)):
        assert abs(edge.speed - speed) < 2 * edge.error
        assert edge.speed == pytest.approx(speed, rel=0.03)


def test_picture_names_edges_and_plateaus() -> None:
    """Every line of the picture is named, and axes have units."""
    ax = shock.find(piston(1.0)).plot()
    labels = " ".join(ax.get_legend_handles_labels()[1])
    for word in ("leading edge", "trailing edge", "Whitham", "plateau ahead", "plateau behind"):
        assert word in labels
    assert ax.get_xlabel() == "contact, from the top"


@pytest.mark.parametrize("direction", ["down", "up"])
def test_map_has_the_same_edges_and_names_the_plateaus(direction: str) -> None:
    """Lines run from where the wave began to where an edge is at the end."""
    step = Riemann(
        velocity=(0, 0), strain=(2e-5, 0) if direction == "down" else (0, 2e-5), grain=150
    )
    chain = CHAIN.replace(top="free")
    scene = Scene(chain=chain, excitation=step, duration=110 / SOUND, samples=441)
    found = shock.find(simulate(scene, "native", 1e-5), direction)
    ax = found.plot_map()
    line = ax.get_lines()[0]
    assert line.get_label() == f"leading edge: {found.leading.speed:.5g} grains/s"
    slope = np.diff(line.get_xdata()) / np.diff(line.get_ydata())
    assert slope == pytest.approx((1 if direction == "down" else -1) * found.leading.speed)
    words = [text.get_text() for text in ax.texts]
    assert [word.split(":")[0] for word in words] == ["behind", "ahead"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gravity": 9.81}, "chain: a shock is measured with no gravity"),
        ({"diameter": np.linspace(9e-3, 1e-2, 30)}, "chain: must be uniform"),
        ({}, "duration: "),
    ],
)
def test_what_is_no_shock_says_why(changes: dict, message: str) -> None:
    """A strike, a column and a taper are refused in one line."""
    chain = CHAIN.replace(grains=30, **changes)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=1e-4)
    run = simulate(scene, engine="native")
    with pytest.raises(InputError, match=message):
        shock.find(run)
