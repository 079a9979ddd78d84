"""Parts of a chain and costs of long chains, against the whole and against listed grains."""

import tracemalloc
from itertools import combinations

import numpy as np
import pytest
from helpers.example_chains import CHAINS, WALLED, column
from helpers.example_scenes import scene_of, struck

from lmpchain import (
    PTFE,
    STEEL,
    Chain,
    Displacement,
    Drive,
    Impulse,
    Impurity,
    InputError,
    Profile,
    simulate,
)

MORE = {
    "vacuum": column(9, gravity=0.0, bottom="free"),
    "springs with impurities": column(
        12,
        exponent=1.0,
        gravity=0.0,
        top_load=1e-3,
        top="wall",
        impurity=[
            Impurity(12, 2e-3),
            Impurity(grain=3, mass=1e-4),
            Impurity(grain=4, material=PTFE),
        ],
    ),
    "own masses with an impurity": column(
        5, masses=[1e-6, 3e-6, 2e-6, 1e-6, 2e-6], impurity=[Impurity(grain=3, mass=4e-6)]
    ),
}
ALL = CHAINS | {f"walled, {name}": chain for name, chain in WALLED.items()} | MORE
each_chain = pytest.mark.parametrize("chain", ALL.values(), ids=ALL)


def some_parts(chain: Chain) -> list[tuple[int, int]]:
    step = max(1, chain.grains // 7)
    ends = sorted({1, 2, *range(1, chain.grains, step), chain.grains - 1, chain.grains} - {0})
    return list(combinations(ends, 2))


@each_chain
def test_a_part_equals_the_whole_at_rest(chain: Chain):
    for first, last in some_parts(chain):
        part = chain.part(first, last)
        assert part.grains == last - first + 1
        assert part.movable == part.grains - (last < chain.grains or chain.bottom == "fixed")
        assert np.array_equal(part.masses, chain.masses[first - 1 : last])
        assert np.array_equal(part.diameters, chain.diameters[first - 1 : last])
        assert np.array_equal(part.contact_constants, chain.contact_constants[first - 1 : last - 1])
        kept = slice(1, last - first + (1 if last < chain.grains else 2))
        if first == 1:
            kept = slice(0, kept.stop)
            assert part.top_load == chain.top_load
        else:
            assert part.contacts.constant[0] == 0
            assert part.top_load == pytest.approx(chain.contacts.force[first - 1], rel=5e-16, abs=0)
        for what in ("constant", "force", "overlap", "stiffness"):
            mine = getattr(part.contacts, what)[kept]
            whole = getattr(chain.contacts, what)[first - 1 :][kept]
            if first == 1 or what == "constant":
                assert np.array_equal(mine, whole), what
            else:
                assert mine == pytest.approx(whole, rel=2e-15, abs=0), what
        if last < chain.grains:
            assert part.contacts.constant[-1] == 0


@each_chain
def test_the_largest_part_is_the_chain_and_parts_are_valid_chains(chain: Chain):
    assert chain.part(1, chain.grains) == chain
    for first, last in some_parts(chain):
        part = chain.part(first, last)
        assert Chain(**part.given()) == part
        assert part.part(1, part.grains - (part.grains > 2)) == chain.part(
            first, last - (part.grains > 2)
        )


@pytest.mark.parametrize(
    ("strike", "first", "last"),
    [
        (Impulse(velocity=3e-3), 1, 40),
        (Impulse(velocity=-3e-3, grain=50), 25, 75),
        (Displacement(displacement=2e-9, grain=110), 80, 120),
        (Drive(amplitude=1e-9, frequency=2e5), 1, 40),
        (Profile(velocity=1e-3 * (np.arange(120) == 59)), 35, 85),
    ],
    ids=["top", "middle", "near the wall", "driven", "profile"],
)
def test_a_part_moves_as_the_whole(strike, first: int, last: int):
    """The motions agree until the wave reaches the ends; there is an impurity and a wall."""
    chain = column(120, top="free", bottom="wall", impurity=[Impurity(grain=60, diameter=1.3e-3)])
    scene = scene_of(chain, strike, 20e-6, 11)
    small = scene.part(first, last)
    whole, part = (simulate(s, "native", 1e-11) for s in (scene, small))
    for what in ("displacement", "velocity"):
        one = getattr(whole, what)
        other = getattr(part, what)
        assert np.abs(one[:, first - 1 : last] - other).max() < 1e-11 * np.abs(one).max()
    beyond = np.delete(whole.velocity, np.s_[first - 1 : last], axis=1)
    assert np.abs(beyond).max() < 1e-11 * np.abs(whole.velocity).max()


@pytest.mark.parametrize(("first", "last"), [(0, 3), (3, 3), (4, 2), (2, 6), (-2, 3)])
def test_a_part_must_be_within_the_chain(first: int, last: int):
    with pytest.raises(InputError, match=r"part: must be two or more of grains 1 to 5 \(got"):
        column(5).part(first, last)


def test_no_grain_of_a_long_chain_is_laid_out_before_it_is_asked_for():
    """A hundred million grains, whose masses alone would take 800 MB."""
    tracemalloc.start()
    chain = column(10**8, gravity=0.01, impurity=[Impurity(grain=10**7, material=STEEL)])
    scene = struck(chain, 1e-5, 1e-4, grains="1:64")
    assert 0 < scene.strike_number < np.inf
    assert 0 < scene.energy < np.inf
    assert not scene.at_rest
    top = chain.part(1, 64)
    deep = chain.part(10**7 - 10, 10**7 + 10)
    assert deep.contacts.overlap[-2] > top.contacts.overlap[-2] > 0
    assert deep.masses[10] == STEEL.density * np.pi / 6 * 1e-3**3
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()


def test_a_strike_on_a_million_grains_is_that_on_ten_thousand():
    """Grains without a wave need no memory; an array of the whole chain takes 8 MB."""
    runs = []
    for grains in (10**4, 10**6):
        tracemalloc.start()
        chain = column(grains)
        runs.append(simulate(struck(chain, 8.57e-4, 100e-6, grains="1:64"), "native"))
        assert tracemalloc.get_traced_memory()[1] < 4e6
        tracemalloc.stop()
    assert np.array_equal(runs[0].displacement, runs[1].displacement)
    assert np.array_equal(runs[0].velocity, runs[1].velocity)
    assert runs[1].cost.active_grains < 200


def test_given_masses_and_constants_are_preserved():
    given = {"masses": [1e-6, 2e-6, 3e-6], "contact_constants": [1e9, 2e9]}
    chain = column(3, **given)
    assert {key: getattr(chain, key).tolist() for key in given} == given
    assert column(3).given() == {"grains": 3, "diameter": 1e-3}
    with pytest.raises(AttributeError, match="weights"):
        _ = chain.weights


@pytest.mark.parametrize(("bottom", "loaded"), [("fixed", 5), ("wall", 5), ("wall", 8)])
def test_a_load_below_the_top_is_kept_if_its_grain_moves_in_the_part(bottom: str, loaded: int):
    """The last grain of a part is fixed unless the chain ends with it."""
    chain = column(8, gravity=0.0, top_load=0.02, load_grain=loaded, bottom=bottom)
    for last in range(2, 8):
        part = chain.part(1, last)
        assert (part.top_load, part.load_grain) == ((0.02, loaded) if loaded < last else (0.0, 1))
    assert chain.part(1, 8) == chain
    below = chain.part(3, 8)
    assert (below.top_load, below.load_grain) == (0.02, loaded - 2)
