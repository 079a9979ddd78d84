"""The chain at rest, its band edge and its energy, against independent formulas and methods."""

import dataclasses
import tracemalloc

import numpy as np
import pytest
from helpers.example_chains import BETWEEN, CHAINS, DISORDERED, RIGID, WALLED, column
from helpers.example_scenes import random_scene, scene_of, struck
from helpers.faults import fault_keys, faults

import lmpchain
from lmpchain import (
    BRASS,
    GLASS,
    PTFE,
    STEEL,
    TUNGSTEN_CARBIDE,
    Chain,
    Displacement,
    Drive,
    Impulse,
    Impurity,
    InputError,
    Material,
    simulate,
)
from lmpchain.chain import bounds
from lmpchain.chain.contact_law import Contacts
from lmpchain.chain.materials import MATERIALS, SYNONYMS, kinds

EVERY = CHAINS | {f"{name}, walls": chain for name, chain in WALLED.items()}
each_chain = pytest.mark.parametrize("chain", EVERY.values(), ids=EVERY)


def test_the_chain_of_the_paper():
    chain = column(120, material=GLASS)
    gamma = 62e9 * np.sqrt(1e-3) / (3 * (2426 * np.pi / 6 * 1e-9) * (1 - 0.2**2))
    assert gamma == pytest.approx(5.3593e14, rel=1e-5, abs=0)
    assert chain.contact_constants / chain.masses[:-1] == pytest.approx(gamma, rel=1e-14, abs=0)
    n = np.arange(1, 120)
    assert chain.equilibrium_overlap == pytest.approx(
        (9.81 * n / gamma) ** (2 / 3), rel=1e-14, abs=0
    )
    assert chain.length_scale == pytest.approx(6.9456e-10, rel=1e-5, abs=0)
    assert 1 / chain.time_scale == pytest.approx(1.45555e5, rel=1e-5, abs=0)
    omega = np.sqrt(9.81 * 1.5) * (gamma / 9.81) ** (1 / 3)
    assert 1 / chain.time_scale == pytest.approx(omega, rel=1e-14, abs=0)
    assert chain.linear_stiffness / chain.masses[0] / omega**2 == pytest.approx(
        n ** (1 / 3), rel=1e-13, abs=0
    )


@pytest.mark.parametrize("exponent", [1.0, 1.2, 1.5, 2.0, 3.0])
def test_contact_constant_for_any_exponent(exponent: float):
    """K = (4/3) E* sqrt(R*) dbar^(1.5 - delta), with values from the two grains of the contact."""
    chain = Chain(
        grains=3, material=[GLASS, STEEL, PTFE], diameter=[1e-3, 2e-3, 5e-3], exponent=exponent
    )
    for n in (0, 1):
        one = chain.material[n]
        other = chain.material[n + 1]
        r1 = chain.diameters[n] / 2
        r2 = chain.diameters[n + 1] / 2
        soft = (1 - one.poissons_ratio**2) / one.youngs_modulus + (
            1 - other.poissons_ratio**2
        ) / other.youngs_modulus
        expected = 4 / 3 / soft * np.sqrt(r1 * r2 / (r1 + r2)) * (r1 + r2) ** (1.5 - exponent)
        assert chain.contact_constants[n] == pytest.approx(expected, rel=1e-14, abs=0)
    assert chain.masses == pytest.approx(
        [
            m.density * np.pi * d**3 / 6
            for m, d in zip(chain.material, [1e-3, 2e-3, 5e-3], strict=True)
        ],
        rel=1e-14,
        abs=0,
    )


@pytest.mark.parametrize("exponent", [1.0, 1.5, 3.0])
@pytest.mark.parametrize("walls", [{}, {"top": BRASS, "bottom": TUNGSTEN_CARBIDE}, {"top": RIGID}])
def test_wall_constants(exponent: float, walls: dict[str, Material]):
    """K = (4/3) E* sqrt(R) d^(1.5 - delta), with radius and diameter of the grain at the wall.

    By default a wall has the material of this grain.
    """
    chain = Chain(
        grains=3, material=[GLASS, STEEL, PTFE], diameter=[1e-3, 2e-3, 5e-3], exponent=exponent,
        **BETWEEN, **{f"{end}_material": material for end, material in walls.items()},
    )  # fmt: skip
    ends = [(GLASS, 1e-3, walls.get("top", GLASS)), (PTFE, 5e-3, walls.get("bottom", PTFE))]
    for constant, (grain, d, wall) in zip(chain.wall_constants, ends, strict=True):
        soft = sum((1 - m.poissons_ratio**2) / m.youngs_modulus for m in (grain, wall))
        assert constant == pytest.approx(
            4 / 3 / soft * np.sqrt(d / 2) * d ** (1.5 - exponent), rel=1e-14, abs=0
        )


def test_walls_are_scaled_with_given_constants():
    common = {"grains": 4, "diameter": 10.0, "gravity": 0.0}
    given = {"masses": [1.0] * 4, "contact_constants": [1.0, 5.0, 3.0]}
    alike = Chain(**common, **given, **BETWEEN)
    assert alike.wall_constants == pytest.approx(
        np.sqrt(2) * np.array([1.0, 3.0]), rel=1e-15, abs=0
    )
    rigid = Chain(**common, **given, **BETWEEN, bottom_material=RIGID)
    assert rigid.wall_constants == pytest.approx(
        np.sqrt(2) * np.array([1.0, 6.0]), rel=1e-15, abs=0
    )
    mixed = Chain(**common, **given, top="wall", material=["glass", "steel", "steel", "steel"])
    soft = [(1 - m.poissons_ratio**2) / m.youngs_modulus for m in (GLASS, STEEL)]
    expected = np.sqrt(2) * (soft[0] + soft[1]) / (2 * soft[0])
    assert mixed.wall_constants == pytest.approx([expected, 0.0], rel=1e-14, abs=0)


def test_there_is_no_wall_unless_asked_for():
    for ends in ({"bottom": "fixed"}, {"bottom": "free", "gravity": 0.0}):
        chain = column(3, **ends)
        assert not chain.wall_constants.any()
        for what in ("constant", "force", "overlap", "stiffness"):
            assert not getattr(chain.contacts, what)[[0, -1]].any()
        assert not chain.contacts.exists[[0, -1]].any()
    assert [column(3, top=t, bottom="wall").movable for t in ("free", "wall")] == [3, 3]
    assert column(3, top="wall").movable == 2


@each_chain
def test_forces_balance_at_rest(chain: Chain):
    contacts = chain.contacts
    force = contacts.constant * contacts.overlap**chain.exponent
    push = force.copy()
    push[0] = chain.top_load  # The load acts with or without a wall.
    weight = chain.masses * chain.gravity
    last = chain.movable
    assert np.diff(push)[:last] == pytest.approx(weight[:last], rel=1e-9, abs=1e-14 * force.max())
    assert contacts.force == pytest.approx(force, rel=1e-14, abs=0)
    assert force[0] == pytest.approx(
        chain.top_load if chain.top == "wall" else 0.0, rel=1e-14, abs=0
    )
    bears = chain.top_load + weight.sum() if chain.bottom == "wall" else 0.0
    assert force[-1] == pytest.approx(bears, rel=1e-14, abs=0)
    slope = chain.exponent * contacts.constant * contacts.overlap ** (chain.exponent - 1)
    loose = contacts.force == 0
    assert contacts.stiffness == pytest.approx(slope, rel=1e-14, abs=0)
    assert loose[1:-1].sum() == 0
    assert np.array_equal(chain.equilibrium_overlap, contacts.overlap[1:-1])


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.3])
def test_the_contact_law_and_what_follows_from_it(exponent: float):
    """Stiffness is the slope of the force, a collision ends at its energy, and loads scale."""
    every = column(5, exponent=exponent).contacts
    contacts = every.of(np.flatnonzero(every.pressed))
    o = contacts.overlap
    h = 1e-4 * contacts.overlap
    alike = np.ones(4)
    slope = (contacts.force_at(o + h) - contacts.force_at(o - h)) / (2 * h)
    assert slope == pytest.approx(contacts.stiffness_at(o), rel=1e-7, abs=0)
    assert contacts.force_at(o) == pytest.approx(contacts.force, rel=1e-13, abs=0)
    assert not contacts.force_at(-o).any()
    deepest = contacts.collision_overlap(0.1 * alike, 2e6 * alike)
    vacuum = Contacts.at_rest(contacts.constant, 0 * alike, contacts.law)
    assert vacuum.energy(deepest) == pytest.approx(0.1**2 / 2 / 2e6 * alike, rel=1e-12, abs=0)
    assert contacts.of(2).stiffness == contacts.stiffness[2]
    # Missing walls, and bodies that are both held, do not collide.
    meets = np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    overlaps = every.collision_overlap(np.full(6, 0.1), 2e6 * meets)
    assert overlaps.tolist() == [0.0, deepest[0], 0.0, *deepest[2:], 0.0]


def test_a_wall_that_just_touches_does_not_press():
    chain = WALLED["just touched above"]
    contacts = chain.contacts
    assert contacts.exists.all()
    assert contacts.constant[0] > 0
    assert (contacts.force[0], contacts.overlap[0], contacts.stiffness[0]) == (0, 0, 0)
    assert contacts.pressed.tolist() == [False, *[True] * 30]


@each_chain
def test_band_edge_against_a_dense_eigensolver(chain: Chain):
    """Walls are fixed bodies here; a wall that only touches does not act as a spring."""
    size = chain.grains
    k = chain.contact_constants
    delta = chain.exponent
    pressed = chain.top_load + chain.gravity * np.cumsum(chain.masses)
    springs = delta * k ** (1 / delta) * pressed[:-1] ** (1 - 1 / delta)
    above, below = chain.wall_constants
    top = (
        delta * above ** (1 / delta) * chain.top_load ** (1 - 1 / delta)
        if above and chain.top_load
        else 0.0
    )
    bottom = delta * below ** (1 / delta) * pressed[-1] ** (1 - 1 / delta)
    matrix = np.zeros((size + 2, size + 2))
    for n, stiffness in enumerate([top, *springs, bottom]):
        matrix[n : n + 2, n : n + 2] += stiffness * np.array([[1, -1], [-1, 1]])
    move = slice(1, chain.movable + 1)
    highest = np.sqrt(
        np.linalg.eigvals(matrix[move, move] / chain.masses[: chain.movable, None]).real.max()
    )
    assert chain.band_edge == pytest.approx(highest, rel=1e-11, abs=0)


def test_band_edge_of_a_free_pair_and_of_a_vacuum():
    springs = column(2, exponent=1.0, gravity=0.0, bottom="free")
    m = springs.masses[0]
    k = springs.contact_constants[0]
    assert springs.movable == 2
    assert springs.band_edge == pytest.approx(np.sqrt(2 * k / m), rel=1e-12, abs=0)
    vacuum = column(5, gravity=0.0)
    assert vacuum.band_edge == 0
    assert vacuum.time_scale == np.inf
    assert not vacuum.compressed


def test_the_energy_of_a_chain_is_that_of_its_contacts_and_grains(rng: np.random.Generator):
    """The integral of K o^delta over the overlap o, less the work of the force at rest."""
    for chain in (DISORDERED, WALLED["disordered"], WALLED["just touched above"]):
        contacts = chain.contacts
        power = chain.exponent + 1
        for size in (0.1, 3.0, -3.0):
            v = rng.normal(size=30) * 1e-4
            u = rng.normal(size=30) * size * chain.length_scale
            u[0] = np.sign(size) * abs(u[0])
            r = -np.diff(u, prepend=0.0, append=0.0)
            overlaps = np.maximum(contacts.overlap + r, 0.0), contacts.overlap
            held, rest = (contacts.constant * o**power / power for o in overlaps)
            elastic = held - rest - contacts.force * r
            assert contacts.energy(r) == pytest.approx(elastic, rel=1e-8, abs=1e-12 * elastic.max())
            expected = elastic.sum() + (chain.masses * v**2).sum() / 2
            assert chain.excess_energy(u, v) == pytest.approx(expected, rel=1e-11, abs=0)


def test_minus_its_slope_is_the_force(rng):
    """The forces of the integrators equal -dU/dx from differences."""
    chain = DISORDERED
    u = rng.normal(size=30) * chain.length_scale
    overlap = np.maximum(chain.equilibrium_overlap + u[:-1] - u[1:], 0.0)
    contact = chain.contact_constants * overlap**chain.exponent
    push = np.append(chain.top_load, contact) + chain.masses * chain.gravity
    push[:-1] -= contact
    for n in (0, 11, 28):
        h = 1e-3 * chain.length_scale * np.eye(30)[n]
        energies = [float(chain.excess_energy(u + k * h, 0 * u)) for k in (-2, -1, 1, 2)]
        slope = (energies[0] - 8 * energies[1] + 8 * energies[2] - energies[3]) / (12 * h[n])
        assert -slope == pytest.approx(push[n], rel=1e-6, abs=1e-9 * contact.max())


def test_no_contact_exceeds_the_bound_on_its_overlap(rng):
    # Equal steps, because adaptive steps compile a second loop.
    closest = 0.0
    for _ in range(40):
        scene = random_scene(rng).replace(samples=101)
        if scene.drive:  # A drive does work.
            continue
        chain = scene.chain
        run = simulate(scene, "native", 1e-4, adaptive=False)
        bodies = np.pad(run.displacement, ((0, 0), (1, 1)))
        overlap = chain.contacts.overlap + bodies[:, :-1] - bodies[:, 1:]
        there = chain.contacts.exists
        used = overlap[:, there] / chain.contacts.overlap_bound(scene.energy)[there]
        assert used.max() <= 1 + 1e-4
        closest = max(closest, used.max())
    assert closest > 0.9  # The bound is not so wide that it is useless.


@pytest.mark.parametrize(
    ("wall", "ends"),
    [(-1, {}), (0, {"top": "wall", "top_material": STEEL, "bottom": "free"})],
    ids=["fixed grain", "wall"],
)
def test_the_bound_is_reached_by_a_grain_thrown_at_the_end(wall: int, ends: dict):
    chain = column(2, gravity=0.0, **ends)
    speed = 1e-2 if wall else -1e-2
    scene = struck(chain, speed, 2e-5, 2001)
    run = simulate(scene, "native", 1e-9, adaptive=False)
    constant = chain.wall_constants[0] or chain.contact_constants[0]
    deepest = (1.25 * chain.masses[0] * 1e-4 / constant) ** 0.4
    bound = chain.contacts.overlap_bound(scene.energy)[:-1]
    assert bound[wall] == pytest.approx(deepest, rel=1e-12, abs=0)
    reached = (np.sign(speed) * run.displacement[:, 0]).max()
    assert reached == pytest.approx(deepest, rel=1e-5, abs=0)


def test_an_impurity_is_a_grain_given_by_itself():
    """An impurity by diameter, by material and by both equals listed grains."""
    odd = [
        Impurity(grain=2, diameter=3e-3),
        {"grain": 5, "material": "steel"},
        Impurity(6, 2e-3, PTFE),
    ]
    chain = column(6, gravity=5.0, top_load=1e-3, bottom="wall", impurity=odd)
    material = [GLASS] * 4 + [STEEL, PTFE]
    diameter = [1e-3, 3e-3, 1e-3, 1e-3, 1e-3, 2e-3]
    written = Chain(
        grains=6, diameter=diameter, material=material, gravity=5.0, top_load=1e-3, bottom="wall"
    )
    for what in (
        "masses",
        "contact_constants",
        "wall_constants",
        "diameters",
        "equilibrium_overlap",
    ):
        assert np.array_equal(getattr(chain, what), getattr(written, what)), what
    assert chain != written
    assert chain == Chain(**chain.given())


def test_an_impurity_by_its_mass_alone():
    plain = column(4)
    heavy = column(4, impurity=[Impurity(grain=3, mass=1e-4)])
    assert heavy.masses.tolist() == [*plain.masses[:2], 1e-4, plain.masses[3]]
    assert np.array_equal(heavy.contact_constants, plain.contact_constants)
    both = column(4, impurity=[Impurity(grain=3, mass=1e-4, diameter=2e-3)])
    assert both.masses.tolist() == heavy.masses.tolist()
    assert both.contact_constants[1] > plain.contact_constants[1]
    given = column(4, masses=[1e-6] * 4, impurity=[Impurity(grain=1, mass=2e-6)])
    assert given.masses.tolist() == [2e-6, 1e-6, 1e-6, 1e-6]
    own = column(2, contact_constants=[1e9], impurity=[Impurity(grain=1, mass=2e-6)])
    assert (own.masses[0], own.contact_constants[0]) == (2e-6, 1e9)


def test_an_impurity_is_mixed_with_other_materials_and_diameters():
    """Both contacts of the impurity are computed by hand, as is a wall contact of an impurity."""
    chain = Chain(
        grains=3, material=[GLASS, STEEL, STEEL], diameter=[1e-3, 2e-3, 4e-3], bottom="wall",
        impurity=[Impurity(grain=2, material=BRASS), Impurity(grain=3, diameter=3e-3)],
    )  # fmt: skip
    soft = [(1 - m.poissons_ratio**2) / m.youngs_modulus for m in (GLASS, BRASS, STEEL, STEEL)]
    radii = [1e-3 * 0.5 * 1.0 / 1.5, 1e-3 * 1.0 * 1.5 / 2.5, 1e-3 * 1.5]
    expected = [4 / 3 / (soft[n] + soft[n + 1]) * np.sqrt(radii[n]) for n in range(3)]
    assert [*chain.contact_constants, chain.wall_constants[1]] == pytest.approx(
        expected, rel=1e-14, abs=0
    )
    assert chain.masses[1:] == pytest.approx(
        [8500 * np.pi / 6 * 8e-9, 8000 * np.pi / 6 * 27e-9], rel=1e-14, abs=0
    )


OWN = {"contact_constants": [1e9] * 4}
SOFT = Material(density=1.0, youngs_modulus=1.0, poissons_ratio=0.0)
# Arguments, the key in the message, and a part of the message.
FAULTY = [
    ({"impurity": [2]}, "impurity", "must be a list of impurities"),
    ({"impurity": {"grain": 2, "mass": 1e-6}}, "impurity", "must be a list of impurities"),
    (OWN | {"impurity": [{"grain": 2, "diameter": 2e-3}]}, "impurity.0", "change these constants"),
    (OWN | {"impurity": [{"grain": 2, "material": "ptfe"}]}, "impurity.0", "only have its own"),
    ({"top_material": "steel"}, "top_material", 'there is none unless top = "wall"'),
    ({"bottom_material": STEEL}, "bottom_material", 'there is none unless bottom = "wall"'),
    ({"top": "wall", "top_material": "air"}, "top_material", "no material is called"),
    ({"top": "fixed"}, "top", "must be 'free' or 'wall'"),
    ({"top": "wall", "bottom": "free"}, "bottom", "a free chain would fall"),
    ({"bottom": "free", "gravity": 0.0, "top_load": 1.0}, "bottom", "a free chain would fall"),
    ({"bottom": "wall", "bottom_material": SOFT}, "diameter", "contact 5 is compressed by"),
    (
        {"top": "wall", "top_load": 1e-3, "top_material": SOFT},
        "diameter",
        "contact 0 is compressed",
    ),
    ({"wall_constants": None}, "wall_constants", "leave it out if it is not given"),
]
FAULTY_IMPURITIES = [
    ([Impurity(grain=6, mass=1e-6)], "0.grain", "no grain 6"),
    ([{"grain": 0, "mass": 1e-6}], "0.grain", "at least 1"),
    ([{"grain": 2, "mass": 1e-6}, {"grain": 2, "diameter": 1e-3}], "1.grain", "repeats grain"),
    ([{"grain": 2}], "0.diameter", "give a diameter, a material or"),
    ([{"mass": 1e-6}], "0.grain", "is missing"),
    ([{"grain": 2, "material": "jelly"}], "0.material", "no material is called"),
    ([{"grain": 2, "mass": -1.0}], "0.mass", "above 0"),
    ([{"grain": 2, "colour": 1}], "0.colour", "unknown key"),
]
FAULTY += [
    ({"impurity": given}, f"impurity.{key}", message) for given, key, message in FAULTY_IMPURITIES
]


@pytest.mark.parametrize(("keys", "key", "message"), FAULTY)
def test_a_fault_names_its_key_and_says_what_to_do(keys: dict, key: str, message: str):
    messages = [text for found, text in faults(column, 5, **keys) if found == key]
    assert len(messages) == 1
    assert message in messages[0]


def test_the_strike_is_held_against_walls_too():
    """Grain 1 thrown at a rubber wall, or driven into grain 2, is beyond Hertz's law."""
    rubber = Material(density=1000, youngs_modulus=1e5, poissons_ratio=0.49)
    chain = column(5, top="wall", top_material=rubber)
    strikes = [
        (Impulse(velocity=-1.0), "velocity"),
        (Displacement(displacement=-2e-4), "displacement"),
    ]
    for strike, key in strikes:
        with pytest.raises(InputError, match="squeezes contact 0 to") as caught:
            scene_of(chain, strike, 1e-5)
        assert [found for found, _ in caught.value.faults] == [key]
    soft = column(5, material=rubber, gravity=0.0)
    with pytest.raises(InputError, match="squeezes contact 1 to") as caught:
        scene_of(soft, Drive(amplitude=5e-5, frequency=1e4), 1e-5)
    assert [found for found, _ in caught.value.faults] == ["kind"]


def test_equality():
    a = column(3)
    assert a == column(3)
    assert a == Chain(grains=3, material="glass", diameter=np.float64(1e-3), gravity=9.81)
    assert a != column(4)
    assert a != column(3, gravity=9.80665)
    assert a != column(3, material=STEEL)
    assert a != column(3, masses=[1e-6] * 3)
    assert a != 3
    assert hash(a) == hash(column(3, material="glass", gravity=9.81))


def test_materials():
    assert (GLASS.density, GLASS.youngs_modulus, GLASS.poissons_ratio) == (2426.0, 62e9, 0.2)
    assert GLASS.plane_strain_modulus == pytest.approx(62e9 / 0.96, rel=1e-15, abs=0)
    for material in MATERIALS.values():
        assert material.source
        assert getattr(lmpchain, material.name.upper()) is material
        assert column(2, material=material.name).material == material
    assert fault_keys(Material, density=0.0, youngs_modulus=np.inf, poissons_ratio=0.51) == [
        "density",
        "youngs_modulus",
        "poissons_ratio",
    ]


def test_names_of_materials():
    """Capitals, spaces and punctuation are ignored, and synonyms are known."""
    for name, material in {
        "Steel": STEEL,
        "316": STEEL,
        "AISI 302": lmpchain.STEEL_302,
        "440C": lmpchain.STEEL_440C,
        "steel 440c": lmpchain.STEEL_440C,
        "Aluminum": lmpchain.ALUMINIUM,
        "Delrin": lmpchain.POM,
        "Teflon": PTFE,
        "Soda-lime glass": lmpchain.SODA_LIME_GLASS,
        "tungsten carbide": TUNGSTEN_CARBIDE,
    }.items():
        assert column(2, material=name).material is material
    assert set(SYNONYMS.values()) <= set(MATERIALS)
    for wrong, meant in (("delrn", "delrin"), ("alumnium", "aluminium"), ("nilon", "nylon")):
        with pytest.raises(InputError, match=f"did you mean '{meant}'"):
            column(2, material=wrong)
    with pytest.raises(InputError, match=r"E: unknown key \(did you mean 'youngs_modulus'"):
        column(2, material={"rho": 1e3, "E": 1e9, "nu": 0.3})


def test_rubber_warns_beyond_hertz():
    with pytest.warns(UserWarning, match="Hertz's law holds"):
        Chain(grains=30, material="rubber", diameter=1e-2)


@pytest.mark.parametrize(
    "odd", [[], [Impurity(grain=7, mass=1e-9), Impurity(grain=9, diameter=3e-3)]]
)
def test_a_long_squeezed_column_is_refused_before_memory_is_taken(odd: list[Impurity], monkeypatch):
    """A column of a hundred million grains is rejected without allocating gigabytes.

    The bound on the compression agrees with the arrays of long chains.
    """
    tracemalloc.start()
    try:
        with pytest.raises(
            InputError, match=r"diameter: a contact is compressed by at least .* fewer grains"
        ):
            column(10**8, impurity=odd)
        assert tracemalloc.get_traced_memory()[1] < 2e6
    finally:
        tracemalloc.stop()
    limits = dataclasses.replace(bounds.LIMITS, long_chain=1000)
    monkeypatch.setattr(bounds, "LIMITS", limits)
    long = column(1000, impurity=odd, top="wall", bottom="wall", top_load=1e-3)
    relative = (long.contacts.overlap / long.contact_lengths)[-2]
    few = kinds(long.material, 1e-3, long.impurity)
    assert 0.95 < bounds.least_compression(few, 1000, 1e-3, 9.81, long.law) / relative <= 1
