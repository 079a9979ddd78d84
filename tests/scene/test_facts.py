"""Facts of a scene: each agrees with its definition, is computed once, and has one owner."""

import re
from pathlib import Path

import numpy as np
import pytest

import lmpchain
from lmpchain import Chain, Damping, Displacement, Drive, Force, Impulse, Law, Scene
from lmpchain.scene.base import Excitation
from lmpchain.scene.facts import SceneFacts
from lmpchain.util.lazy import cached_property

PACKAGE = Path(lmpchain.__file__).parent
COLUMN = Chain(grains=40, diameter=1e-3)
FORCE = Force(grain=2, times=[1e-6, 3e-6, 7e-6, 2e-5, 9e-5], force=[0, 1e-4, 0, 2e-4, 0])
SCENES = {
    "struck": Scene(chain=COLUMN, excitation=Impulse(velocity=1e-4), duration=5e-5, samples=8),
    "pushed": Scene(
        chain=COLUMN.replace(damping=Damping(viscoelastic=1e-8, drag=100.0)),
        excitation=FORCE,
        duration=5e-5,
        samples=8,
        grains=[7, 3],
    ),
}
# Formulas of facts that must not occur in other files.
DERIVATIONS = (
    r"duration / \(\S*samples - 1\)",
    r"highest_frequency \* \S*duration",
    r"duration \* \S*highest_frequency",
    r"max\(\S*band_edge, \S*fastest\)",
    r"\.decay\(\S*highest_frequency",
    r"linspace\(0(\.0)?, \S*duration, \S*samples\)",
    r"overlap_bound\(\S*scene\.energy\)",
)


@pytest.mark.parametrize("name", SCENES)
def test_times_and_phases_agree_with_their_definitions(name: str) -> None:
    scene = SCENES[name]
    assert scene.intervals == 7
    assert scene.sampling_interval == 5e-5 / 7
    assert scene.time == pytest.approx([k * 5e-5 / 7 for k in range(8)], rel=1e-15)
    assert scene.total_phase == pytest.approx(scene.highest_frequency * 5e-5, rel=1e-15)
    assert scene.sampling_phase == pytest.approx(scene.highest_frequency * 5e-5 / 7, rel=1e-15)
    damping = scene.chain.damping
    rate = damping.longest_time * scene.highest_frequency**2 + damping.largest_drag
    assert scene.sampling_decay == pytest.approx(rate * 5e-5 / 14, rel=1e-14, abs=0)


def test_a_scene_ends_at_its_last_sample_before_a_time() -> None:
    scene = SCENES["struck"]
    for share, samples in (
        (-1.0, 8), (0.0, 8), (0.5, 8), (1.0, 8), (1.01, 2), (2.0, 2), (6.0, 6), (6.9, 7), (7.0, 7),
        (7.1, 8), (np.inf, 8),
    ):  # fmt: skip
        # A sample at this very time is not before it.
        exact = share in range(8)
        part = scene.until(scene.time[int(share)] if exact else share * scene.sampling_interval)
        assert part.samples == samples, share
        assert part.time == pytest.approx(scene.time[:samples], rel=1e-14)
        assert (part is scene) == (samples == 8)


@pytest.mark.parametrize("top", ["free", "wall"])
@pytest.mark.parametrize("bottom", ["free", "wall"])
def test_no_strike_on_a_sonic_vacuum_is_weak(top: str, bottom: str) -> None:
    vacuum = Chain(grains=5, diameter=1e-3, gravity=0.0, top=top, bottom=bottom)
    for grain in range(1, 6):
        for speed, number in ((-1e-9, np.inf), (0.0, 0.0)):
            strike = Impulse(velocity=speed, grain=grain)
            assert Scene(chain=vacuum, excitation=strike, duration=1e-5).strike_number == number


def test_a_chain_upside_down_is_defined_by_its_reversed_fields() -> None:
    chain = Chain(
        grains=3, diameter=1e-3, top_load=1.0, top="wall", bottom="wall", wall_constants=[1e9, 4e9],
        masses=[1e-6, 2e-6, 4e-6], contact_constants=[2e9, 3e9],
    )  # fmt: skip
    shaken = Drive(end="bottom", amplitude=1e-9, frequency=1e3)
    turned = Scene(chain=chain, excitation=shaken, duration=1e-4).driven_from_above.chain
    assert turned.contacts.force == pytest.approx(chain.contacts.force[::-1], rel=1e-15)
    # A chain that is made anew from its fields has the same contacts and masses.
    for each in (turned, Chain(**turned.given())):
        assert each.contacts.constant.tolist() == [4e9, 3e9, 2e9, 1e9]
        assert each.masses.tolist() == [4e-6, 2e-6, 1e-6]


def test_kinks_are_those_of_the_force_within_the_run() -> None:
    assert SCENES["struck"].kinks == ()
    assert SCENES["struck"].kink_spacing == np.inf
    pushed = SCENES["pushed"]
    assert pushed.kinks == pytest.approx((1e-6, 3e-6, 7e-6, 2e-5))
    # The smallest spacing is from t = 0 to the first kink.
    assert pushed.kink_spacing == pytest.approx(1e-6)
    assert pushed.recorded.tolist() == [7, 3]


def test_no_overlap_exceeds_its_bound() -> None:
    """A contact with all of the energy E has K o^2.5 / 2.5 - F (o - eps) - rest = E."""
    scene = SCENES["struck"]
    chain = scene.chain
    energy = chain.masses[0] * 1e-8 / 2
    rest = chain.contacts.overlap[1:-1]
    constant = chain.contact_constants
    bound = scene.overlap_bounds[1:-1]
    held = constant * (0.4 * (bound**2.5 - rest**2.5) - rest**1.5 * (bound - rest))
    assert (held >= energy).all()
    run = lmpchain.simulate(scene, "native")
    assert (rest - np.diff(run.displacement) <= bound).all()


def test_the_linear_strain_of_a_driven_chain_grows_with_its_viscosity() -> None:
    """A motion of frequency omega feels at most k (1 + A omega) instead of k."""
    drive = Drive(amplitude=1e-12, frequency=2e4)
    plain = Scene(chain=COLUMN, excitation=drive, duration=5e-5)
    viscous = plain.replace(chain=COLUMN.replace(damping=Damping(viscoelastic=2e-6)))
    turn = 2e-6 * max(COLUMN.band_edge, 2 * np.pi * 2e4)
    assert viscous.linear_strain == pytest.approx(plain.linear_strain * (1 + turn), rel=1e-12)


@pytest.mark.parametrize("gravity", [0.0, 9.81])
@pytest.mark.parametrize("strike", [Impulse(velocity=-1e-4), Displacement(displacement=-2e-9)])
def test_a_ground_adds_its_largest_frequency(gravity: float, strike: Excitation) -> None:
    """A grain on the ground c u^3 has the stiffness 3 c u^2, and flies on until it turns."""
    chain = COLUMN.replace(gravity=gravity)
    plain = Scene(chain=chain, excitation=strike, duration=5e-5)
    for law, power in ((Law("c*u", c=1e6), 1), (Law("c*u**3", c=1e22), 3)):
        scene = plain.replace(chain=chain.replace(ground=law))
        turns = max(scene.chain.band_edge, 1 / 5e-5)
        reach = 2e-9 if strike.kind == "displacement" else 1e-4 / turns
        stiffness = 1e6 if power == 1 else 3e22 * reach**2
        edges = max(plain.fastest_motion, scene.chain.band_edge)
        expected = np.hypot(edges, np.sqrt(stiffness / chain.masses[0]))
        assert scene.fastest_motion == pytest.approx(expected, rel=1e-12)
        assert scene.light_cone is None
        u = strike.initial(chain)[0]
        spring = plain.energy + 1e6 * (u**2).sum() / 2
        assert scene.energy == (pytest.approx(spring, rel=1e-9) if power == 1 else np.inf)
        if power == 3 or not gravity:
            assert scene.linear_strain == np.inf
            continue
        # The last grain is held, and the top is free, so that each spring may stretch alone.
        contacts = chain.contacts
        k, rest = contacts.stiffness[1:-1], contacts.overlap[1:-1]
        elastic = (k * np.diff(u) ** 2).sum() + 1e6 * (u**2).sum()
        size = elastic + (chain.masses * strike.initial(chain)[1] ** 2).sum()
        assert scene.linear_strain == pytest.approx((np.sqrt(size / k) / rest).max(), rel=1e-12)


@pytest.mark.parametrize("name", SCENES)
def test_facts_are_computed_once_and_cannot_be_changed(name: str) -> None:
    scene = SCENES[name].replace(samples=9)
    facts = [key for key, value in vars(SceneFacts).items() if isinstance(value, cached_property)]
    assert len(facts) > 20
    for fact in facts:
        value = getattr(scene, fact)
        assert getattr(scene, fact) is value
        if isinstance(value, np.ndarray):
            with pytest.raises(ValueError, match="read-only"):
                value[0] = 1


def test_no_other_file_derives_facts() -> None:
    for path in PACKAGE.rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        found = [formula for formula in DERIVATIONS if re.search(formula, source)]
        assert not found or path.name == "facts.py", f"{path}: {found}"
