"""Single contacts: force, energy and bounds, in 40 digits or in closed form."""

from pathlib import Path
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import struck

from lmpchain import Chain, Impurity, InputError, Law, Scene
from lmpchain.chain.bounds import bounds
from lmpchain.chain.contact_law import (
    Contacts,
    PowerForce,
    dynamical_matrix,
    pair_slopes,
    pair_value,
    together,
)
from lmpchain.chain.equilibrium import derive_chain
from lmpchain.chain.materials import GLASS, PTFE, STEEL, kinds

EXPONENTS = (1.0, 1.3, 1.5, 2.0, 3.0)
STRAINS = np.array([-3.0, -1.5, -1.0, -0.99, -0.5, -0.03, -0.019, -1e-5, -1e-12, 0.0])
STRAINS = np.append(STRAINS, [1e-14, 1e-7, 0.0199, 0.0201, 0.3, 1.0, 50.0, 1e6])


def by_formulas(exponent: float) -> Law:
    """Return a power law whose energy, overlaps and bounds are computed as for a formula."""
    return Law("k*max(o, 0)**delta", delta=exponent)


@pytest.mark.parametrize("kind", [PowerForce, by_formulas])
@pytest.mark.parametrize("exponent", EXPONENTS)
def test_force_and_energy_of_one_contact_to_the_last_digits(exponent: float, kind: Any) -> None:
    """Compressed, open and separated contacts: K [eps + r]^delta - F, and its integral over r."""
    size = STRAINS.size
    contacts = Contacts.at_rest(np.full(size, 3e9), np.full(size, 2e-4), kind(exponent))
    r = STRAINS * contacts.overlap
    with mp.workdps(40):
        k = mp.mpf(3e9)
        f = mp.mpf(2e-4)
        delta = mp.mpf(exponent)
        eps = (f / k) ** (1 / delta)
        closed = [max(eps + mp.mpf(x), 0) for x in r.tolist()]
        force = [float(k * o**delta - f) for o in closed]
        held = [(k * o ** (delta + 1) - k * eps ** (delta + 1)) / (delta + 1) for o in closed]
        energy = [float(e - f * mp.mpf(x)) for e, x in zip(held, r.tolist(), strict=True)]
    with np.errstate(all="raise"):  # No warning may occur.
        change = contacts.force_change(r)
        above_rest = contacts.energy(r)
    assert change == pytest.approx(force, rel=2e-14, abs=1e-40)
    assert above_rest == pytest.approx(
        energy, rel=1e-12 if kind is PowerForce else 1e-11, abs=1e-55
    )
    rows = np.stack((r, 0 * r, 2 * r))
    rows[:, 3] = 0.0
    each = np.stack([contacts.energy(row) for row in rows])
    assert contacts.energy(rows) == pytest.approx(each, rel=1e-15, abs=0)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_a_loose_contact_only_pushes(exponent: float) -> None:
    contacts = Contacts.at_rest(np.array([3e9, 0.0, 3e9]), np.zeros(3), PowerForce(exponent))
    r = np.array([2e-8, 1e-8, -1e-8])
    # A missing or open contact has exactly no force and energy, so 0 needs no absolute tolerance.
    force = [3e9 * 2e-8**exponent, 0.0, 0.0]
    assert contacts.force_change(r) == pytest.approx(force, rel=1e-14)
    assert contacts.force_at(r) == pytest.approx(force, rel=1e-14)
    energy = 3e9 * 2e-8 ** (exponent + 1) / (exponent + 1)
    assert contacts.energy(r) == pytest.approx([energy, 0.0, 0.0], rel=1e-14)
    # Virial theorem.
    assert contacts.law.elastic_share == pytest.approx(1 / (1 + (exponent + 1) / 2), rel=1e-15)


@pytest.mark.parametrize("kind", [PowerForce, by_formulas])
@pytest.mark.parametrize("exponent", EXPONENTS)
def test_a_force_squeezes_a_contact_until_it_balances(exponent: float, kind: Any) -> None:
    pressed = Contacts.at_rest(np.array([3e9]), np.array([2e-4]), kind(exponent)).of(0)
    loose = Contacts.at_rest(np.array([3e9]), np.array([0.0]), kind(exponent)).of(0)
    for force in (1e-12, 1e-4, 0.3):
        with mp.workdps(40):
            k = mp.mpf(3e9)
            f = mp.mpf(2e-4)
            power = 1 / mp.mpf(exponent)
            closer = float(((f + mp.mpf(force)) / k) ** power - (f / k) ** power)
        assert pressed.squeezed_by(force) == pytest.approx(closer, rel=1e-13)
        assert loose.squeezed_by(force) == pytest.approx((force / 3e9) ** (1 / exponent), rel=1e-14)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_any_law_knows_how_far_an_energy_goes(exponent: float) -> None:
    """Contacts at their bound store the whole energy, and the curvature fits the stiffness."""
    law = by_formulas(exponent)
    contacts = Contacts.at_rest(np.array([3e9, 0.0, 1e9]), np.array([2e-4, 0.0, 0.0]), law)
    for energy in (1e-25, 1e-14, 1e-6):
        bound = contacts.approach_bound(energy)
        assert contacts.energy(bound) == pytest.approx([energy, 0, energy], rel=1e-11, abs=0)
        assert law.approach(energy, 3e9) == pytest.approx(
            PowerForce(exponent).approach(energy, 3e9)
        )
    assert contacts.overlap_bound(np.inf).tolist() == [np.inf, 0.0, np.inf]
    assert contacts.bend == pytest.approx([exponent - 1, 0.0, 0.0], abs=1e-15)
    power = Contacts.at_rest(contacts.constant, contacts.force, PowerForce(exponent))
    assert power.bend == pytest.approx([exponent - 1, 0.0, 0.0], rel=1e-14)
    o = np.array([1e-9, 2e-8])
    curvature = exponent * (exponent - 1) * 3e9 * o ** (exponent - 2)
    for each in (law, PowerForce(exponent)):
        assert each.curvature(o, 3e9) == pytest.approx(curvature, rel=1e-13)
    largest = law.largest_stiffness(o, 3e9)
    assert largest == pytest.approx(PowerForce(exponent).stiffness(o, 3e9))


def test_an_exponent_and_another_law_exclude_each_other(tmp_path: Path) -> None:
    law = by_formulas(2.0)
    chain = column(3, law=law)
    assert chain.law is law
    assert chain == chain.replace(gravity=9.81)
    assert chain != column(3)
    assert column(3, law=PowerForce(2.0)) == chain.replace(law=None, exponent=2.0)
    power = struck(column(3, law=PowerForce(2.0)), 1e-3, 1e-5, 3)
    power.to_toml(tmp_path / "power.toml")
    assert Scene.from_toml(tmp_path / "power.toml") == power
    with pytest.raises(InputError, match="law: takes the place of an exponent"):
        chain.replace(exponent=2.0)
    with pytest.raises(InputError, match="law: must be a power of the overlap for an exponent"):
        _ = chain.exponent
    with pytest.raises(InputError, match="law: is not a law"):
        column(3, law="hertz")


def test_energy_bounds_overlaps_and_strains() -> None:
    """No contact stores more than the total energy, K r^(delta+1) / (delta+1) or k r^2 / 2."""
    constant = np.array([1e9, 2e9, 5e8])
    force = np.array([1e-4, 3e-4, 2e-4])
    contacts = Contacts.at_rest(constant, force, PowerForce(1.5))
    for energy in (1e-25, 1e-14, 1e-11, 1e-6):
        loose = (2.5 * energy / constant) ** 0.4
        pressed = np.sqrt(2 * energy / contacts.stiffness)
        further = np.minimum(loose, pressed)
        assert contacts.overlap_bound(energy) == pytest.approx(
            contacts.overlap + further, rel=1e-13
        )
        strain = (further / contacts.overlap).max()
        assert contacts.strain_bound(contacts.approach_bound(energy)) == pytest.approx(
            1.05 * strain, rel=1e-13
        )
    alike = Contacts.at_rest(np.full(3, 1e9), np.array([1e-4, 2e-4, 3e-4]), PowerForce(1.5))
    strain = min((2.5 * 1e-12 / 1e9) ** 0.4, np.sqrt(2e-12 / alike.stiffness[0])) / alike.overlap[0]
    assert alike.strain_bound(alike.approach_bound(1e-12)) == pytest.approx(
        1.05 * strain, rel=1e-13
    )
    mixed = Contacts.at_rest(np.array([1e9, 0.0, 1e9]), np.array([0.0, 0.0, 1e-4]), PowerForce(1.5))
    assert mixed.strain_bound(mixed.approach_bound(1e-12)) == np.inf
    bound = mixed.overlap_bound(1e-12)
    # The overlap of a missing contact is exactly 0.
    assert bound[:2] == pytest.approx([(2.5e-12 / 1e9) ** 0.4, 0.0], rel=1e-13)
    assert mixed.overlap_bound(np.inf).tolist() == [np.inf, 0.0, np.inf]
    rows = together([contacts, alike])
    energies = np.array([[1e-12], [np.inf]])
    both = rows.overlap_bound(energies)
    assert both[0] == pytest.approx(contacts.overlap_bound(1e-12), rel=1e-15)
    assert both[1].tolist() == [np.inf] * 3
    strains = rows.strain_bound(rows.approach_bound(np.array([[1e-12], [1e-13]])))
    expected = [
        contacts.strain_bound(contacts.approach_bound(1e-12)),
        alike.strain_bound(alike.approach_bound(1e-13)),
    ]
    assert strains == pytest.approx(expected, rel=1e-14)


def test_contacts_of_many_chains_are_rows() -> None:
    one, other = (column(4, gravity=g).contacts for g in (1.0, 9.81))
    rows = together([one, other])
    alone = together([one])
    for name in ("constant", "force", "overlap", "stiffness"):
        assert np.array_equal(getattr(rows, name), [getattr(one, name), getattr(other, name)])
        assert np.array_equal(getattr(alone, name), [getattr(one, name)])
    assert rows.law == PowerForce(1.5)


def test_values_of_pairs_and_their_slopes() -> None:
    """The value of a and b is a b / (a + b), with the logarithmic slopes b and a over a + b."""
    a = np.array([2.0, 3.0, np.inf, 5.0])
    assert pair_value(a) == pytest.approx([6 / 5, 3.0, 5.0], rel=1e-15)
    upper, lower = pair_slopes(a[[0, 1, 3]])
    assert upper == pytest.approx([3 / 5, 5 / 8], rel=1e-15)
    assert lower == pytest.approx([2 / 5, 3 / 8], rel=1e-15)


def test_contacts_above_a_fixed_grain() -> None:
    whole = column(6, top="wall", top_load=1e-3, bottom="wall").contacts
    above = whole.above(3)
    assert above.constant.tolist() == [*whole.constant[:3], 0.0]
    assert above.force.tolist() == [*whole.force[:3], 0.0]
    law = Law("k*o*c", k=1e5, c=[1.0, 2.0, 3.0, 4.0, 5.0])
    listed = column(6, top="wall", top_load=1e-3, bottom="wall", law=law).contacts
    assert listed.above(3).force_at(1e-6).tolist() == [*listed.force_at(1e-6)[:3], 0.0]


def test_the_dynamical_matrix_is_that_of_masses_and_springs() -> None:
    """For moving grains M^(-1/2) K M^(-1/2) is written out from the energy of springs."""
    stiffness = np.array([2.0, 3.0, 5.0, 7.0, 11.0])
    masses = np.array([1.0, 4.0, 9.0, 16.0])
    for moving in (3, 4):
        diagonal, beside = dynamical_matrix(stiffness, masses[:moving])
        matrix = np.zeros((moving, moving))
        for n, k in enumerate(stiffness[: moving + 1]):
            stretch = np.zeros(moving)
            stretch[n - 1 : n] = 1
            stretch[n : n + 1] = -1
            matrix += k * np.outer(stretch, stretch)
        matrix /= np.sqrt(np.outer(masses[:moving], masses[:moving]))
        assert diagonal == pytest.approx(np.diag(matrix), rel=1e-15)
        assert beside == pytest.approx(np.diag(matrix, 1), rel=1e-15)


def test_bounds_are_reached_where_grains_are_alike() -> None:
    """Mass, size and sound bounds are exact, as are constants between two grains and at a wall."""
    chain = Chain(
        grains=2,
        diameter=2e-3,
        material=STEEL,
        gravity=3.0,
        top_load=0.5,
        exponent=2.0,
        bottom="wall",
    )
    known = chain.bounds
    mass = 8000 * np.pi / 6 * 8e-9
    modulus = 193e9 / (1 - 0.09)
    between = 2 / 3 * modulus * np.sqrt(0.5e-3) * 2e-3**-0.5
    assert known.softest == pytest.approx(between, rel=1e-14)
    assert known.hardest == pytest.approx(np.sqrt(2) * between, rel=1e-14)
    assert (known.lightest, known.heaviest) == pytest.approx((mass, mass), rel=1e-14)
    assert known.narrowest == 2e-3
    assert known.slowest == pytest.approx(np.sqrt(193e9 / 8000), rel=1e-14)
    overlap = np.sqrt((0.5 + 3.0 * 3 * mass) / between)  # As if there were an additional grain.
    assert 0.9 * overlap < known.overlap <= overlap
    assert known.compression == known.overlap / 2e-3
    collision = (1.5 * mass * 0.04 / between) ** (1 / 3)
    assert known.struck(0.2) == pytest.approx(max(known.overlap, collision), rel=1e-8)
    assert known.struck(1e-9) == pytest.approx(known.overlap, rel=1e-8)
    assert known.struck(0.2) > collision
    pair = np.sqrt(2 * 2 * known.hardest * 1e-6 / mass)
    assert known.frequency(1e-6) == pytest.approx(pair, rel=1e-8)
    assert known.frequency(1e-6) > pair
    odd = (Impurity(grain=1, diameter=1e-3, material=PTFE), Impurity(grain=2, mass=1.0))
    mixed = bounds(kinds(GLASS, 2e-3, odd), 5, [STEEL], 0.0, 9.81, PowerForce(1.5))
    assert (mixed.lightest, mixed.heaviest) == pytest.approx(
        (2200 * np.pi / 6 * 1e-9, 1.0), rel=1e-14
    )
    soft = 2 / 3 * 1.46e9 / (1 - 0.46**2) * np.sqrt(0.25e-3)
    hard = 2 / 3 * 193e9 / 0.91 * np.sqrt(1e-3)
    assert (mixed.softest, mixed.hardest) == pytest.approx((soft, hard), rel=1e-14)
    assert (mixed.narrowest, mixed.slowest) == pytest.approx((1e-3, PTFE.sound_speed), rel=1e-14)
    weight = 9.81 * (5 * 2426 * np.pi / 6 * 8e-9 + 1.0)
    assert mixed.overlap == pytest.approx((weight / soft) ** (2 / 3), rel=1e-4)


def test_overflow_has_no_bounds() -> None:
    for diameter, density in ((1e-300, 1.0), (1e150, 1.0), (1e-120, 1e-10)):
        material = GLASS.replace(density=density)
        assert bounds(kinds(material, diameter, ()), 5, (), 0.0, 9.81, PowerForce(3.0)) is None


def test_depths_and_loads_from_grain_to_grain() -> None:
    d = np.array([1e-3, 2e-3, 3e-3, 1e-3])
    chain = Chain(grains=4, diameter=d, top_load=1.0, bottom="wall", top="wall")
    centres = np.cumsum([0.0, *((d[1:] + d[:-1]) / 2 - chain.equilibrium_overlap)])
    assert chain.depths == pytest.approx(centres, rel=1e-14)
    assert chain.contact_lengths == pytest.approx([1e-3, 1.5e-3, 2.5e-3, 2e-3, 1e-3], rel=1e-15)
    masses = 2426 * np.pi / 6 * d**3
    carried = 1.0 + 9.81 * np.append(0, np.cumsum(masses))
    assert chain.load_over_mass == pytest.approx((carried[:-1] / masses).max(), rel=1e-13)
    assert chain.equilibrium_force == pytest.approx(carried[1:-1], rel=1e-14)


def test_the_energy_by_a_moved_wall() -> None:
    chain = column(3, top="wall", top_load=1e-3)
    still = np.zeros(3)
    wall = np.array(2e-9)
    r = chain.contacts.overlap[0]
    k = chain.contacts.constant[0]
    energy = k / 2.5 * ((r + 2e-9) ** 2.5 - r**2.5) - 1e-3 * 2e-9
    assert chain.excess_energy(still, still, wall) == pytest.approx(energy, rel=1e-9)
    assert chain.excess_energy(still, still) == 0.0
    moving = np.array([1e-3, 0.0, 0.0])
    assert chain.excess_energy(still, moving) == pytest.approx(0.5e-6 * chain.masses[0], rel=1e-15)


def faults(**fields: object) -> list[tuple[str, str]]:
    try:
        Chain(**{"grains": 4, "diameter": 1e-3} | fields)  # type: ignore[arg-type]
    except InputError as error:
        return error.faults
    return []


@pytest.mark.parametrize("alike", [True, False])
def test_a_load_may_squeeze_by_a_tenth_of_the_diameter_at_most(alike: bool) -> None:
    constant = 2 / 3 * 62e9 / 0.96 * np.sqrt(0.25e-3)
    most = constant * 1e-4**1.5
    rest = {"gravity": 0.0} | ({} if alike else {"diameter": [1e-3] * 4})
    assert not faults(top_load=0.9999 * most, **rest)
    ((key, text),) = faults(top_load=1.0001 * most, **rest)
    assert key == "diameter"
    said = (
        "contact 1 is compressed by 0.1 of the diameter, more than 0.1: use fewer grains, "
        "less gravity or load"
    )
    assert text.startswith(said)
    ((_, text),) = faults(
        top_load=4 * most, impurity=[Impurity(grain=3, material=PTFE)], **({"gravity": 0.0})
    )
    soft = (1 / (1 / (62e9 / 0.96) + (1 - 0.46**2) / 1.46e9)) / (62e9 / 0.96 / 2)
    assert text.startswith(
        f"contact 2 is compressed by {0.1 * (4 / soft) ** (2 / 3):.2g} of the diameter"
    )


def test_forces_too_small_to_compute_with_are_refused() -> None:
    assert not faults(gravity=1e-100)
    assert not faults(gravity=0.0)
    ((key, text),) = faults(gravity=0.99e-100)
    assert (key, text[:30]) == ("gravity", "must be 0, or at least 1e-100 ")
    assert [key for key, _ in faults(gravity=1e-101, top_load=1e-101)] == ["gravity", "top_load"]
    assert not faults(gravity=0.0, top_load=1e-100)
    loaded = {"gravity": 0.0, "top_load": 1.0}  # Springs of some 1e7 N/m.
    assert not faults(masses=[1e-140] * 4, **loaded)
    assert [key for key, _ in faults(masses=[1e-145] * 4, **loaded)] == ["masses"]


def test_arguments_that_contradict_the_ends_are_rejected() -> None:
    for fields, key in (
        ({"wall_constants": [-1.0, 1e9], "bottom": "wall"}, "wall_constants"),
        ({"wall_constants": [0.0, 0.0], "bottom": "wall"}, "wall_constants"),
        ({"wall_constants": [1e9, 1e9], "bottom": "wall"}, "wall_constants"),
        ({"wall_constants": [1e9], "bottom": "wall"}, "wall_constants"),
        (
            {"wall_constants": [0.0, 1e9], "bottom": "wall", "bottom_material": STEEL},
            "wall_constants",
        ),
        ({"bottom_material": STEEL, "top": "wall"}, "bottom_material"),
    ):
        assert [key for key, _ in faults(**fields)] == [key], fields
    assert not faults(wall_constants=[0.0, 1e9], bottom="wall")
    assert not faults(bottom="free", gravity=0.0)
    given = column(4, top="wall", bottom="wall", wall_constants=[1e9, 3e9])
    assert given.contacts.constant[[0, -1]].tolist() == [1e9, 3e9]
    for fields, text in (
        ({"masses": [1e-6] * 5}, "must have 4 entries for 4 grains, not 5"),
        ({"contact_constants": [1e9] * 4}, "must have 3 entries for 4 grains, not 4"),
        ({"material": [STEEL] * 3}, "must be one or 4 (one per grain), not 3"),
    ):
        assert faults(**fields) == [(*fields, text)]


@pytest.mark.parametrize("numbers", [2, slice(1, 4), np.array([3, 1])])
def test_a_selection_of_contacts_keeps_its_parameters(numbers: Any) -> None:
    law = Law("k*max(o, 0)**p", k=1e6, p=[1.2, 1.4, 1.6, 1.8, 2.0])
    contacts = column(6, law=law).contacts
    overlap = np.full(contacts.overlap.shape, 1e-6)
    assert np.array_equal(
        contacts.of(numbers).force_at(overlap[numbers]), contacts.force_at(overlap)[numbers]
    )


def test_each_of_many_chains_has_the_contacts_of_that_chain_alone(rng: np.random.Generator) -> None:
    """Drawn masses or constants, and parameters of a law and an impurity that all chains share."""
    law = Law("k*max(o, 0)**p*(1 + c*o)", p=[1.5, 1.6, 1.7, 1.8], c=2.0)
    odd = [Impurity(grain=2, mass=3e-6)]
    ends = {"top_load": 1.0, "bottom": "wall"}
    chain = column(5, law=law, contact_constants=[1e10] * 4, impurity=odd, **ends)
    for key, size in (("masses", 1e-6), ("contact_constants", 1e10)):
        drawn = size * rng.uniform(0.5, 2.0, (3, 5 - (key == "contact_constants")))
        many = derive_chain(chain, {key: drawn})
        for number, values in enumerate(drawn):
            alone = chain.replace(**{key: values}).contacts
            row = many.row(number).contacts
            for mine, expected in zip(row.arrays, alone.arrays, strict=True):
                assert mine.tolist() == expected.tolist()
            assert row.force_at(row.overlap).tolist() == alone.force_at(alone.overlap).tolist()


LENGTH = 1e-6
STIFFEST = [
    ("k*L*tanh(o/L)", lambda o: 1.0),
    ("k*L*log(1 + max(0, o)/L)", lambda o: 1.0),
    ("k*(max(o, 0) + 3*min(o, 0))", lambda o: 3.0),
    ("k*(o + 0.5*o**3/L**2)", lambda o: 1 + 1.5 * (o / LENGTH) ** 2),
    ("k*(o + 8*(max(o - L, 0) - max(o - 1.001*L, 0)))", lambda o: 1 + 8.0 * (o > LENGTH)),
    ("k*(max(o, 0) - min(1, max(0, 1 + o/L))*1e-9)", lambda o: 1.0),
    ("k*max(o, 0)**3/L**2", lambda o: 3 * (o / LENGTH) ** 2),
]


@pytest.mark.parametrize(("text", "exact"), STIFFEST)
def test_the_largest_stiffness_may_be_that_of_a_small_overlap(text: str, exact: Any) -> None:
    law = Law(text, **({"L": LENGTH} if "L" in text else {}))
    for overlap in LENGTH * np.array([0.3, 1.5, 40.0, 1e4]):
        assert law.largest_stiffness(overlap, 1e3) == pytest.approx(1e3 * exact(overlap))
    # The overlap has no bound.
    if "**3" not in text:
        assert law.largest_stiffness(np.inf, 1e3) == pytest.approx(1e3 * exact(np.inf))
