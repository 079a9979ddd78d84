"""Tables of a sweep file: axes, laws, and both sides of each limit."""

import hashlib
import json

import numpy as np
import pytest
from helpers.faults import fault_keys, faults
from scipy import stats

from lmpchain import InputError
from lmpchain.sweeps import axes as module
from lmpchain.sweeps.axes import Axis, GrainLaw, Normal, Uniform, make_axes, make_law


def test_a_grid_has_an_axis_for_each_key():
    grid = {"chain": {"gravity": [1.0, 2.0]}, "excitation.velocity": np.array([1e-3, 2e-3, 3e-3])}
    first, second = make_axes({"grid": grid})
    assert (first.name, first.length, len(first)) == ("chain.gravity", 2, 2)
    assert first.columns == {"chain.gravity": [1.0, 2.0]}
    assert second.columns == {"excitation.velocity": [1e-3, 2e-3, 3e-3]}
    assert not first.drawn
    assert first.arrays == ()


def test_coordinates_are_numbers_or_texts():
    columns = {
        "chain.gravity": [1.0, 2],
        "chain.material": ["glass", {"density": 1.0}],
        "recording.grains": [[1, 2], [3]],
        "chain.top": [True, 1.0],
        "recording.mixed": [[1, 2], ["3:4"]],
    }
    labels = Axis("case", 2, columns).coordinates()
    assert labels["case"].tolist() == [0, 1]
    assert labels["chain.gravity"].tolist() == [1.0, 2.0]
    assert labels["chain.material"] == ["glass", '{"density": 1.0}']
    assert np.array_equal(labels["recording.grains"], [[1, 2], [3, np.nan]], equal_nan=True)
    assert labels["chain.top"] == ["true", "1.0"]
    assert labels["recording.mixed"] == ["[1, 2]", '["3:4"]']
    own = Axis("chain.gravity", 2, {"chain.gravity": [1.0, 2.0]}).coordinates()
    assert list(own) == ["chain.gravity"]
    assert Axis("realisation", 3, {"disorder.index": range(3)}).coordinates().keys() == {
        "realisation"
    }


def test_cases_have_equal_numbers_of_values():
    (axis,) = make_axes({"list": {"chain.gravity": (1.0, 2.0), "chain.top": ["free", "wall"]}})
    assert (axis.name, axis.length) == ("case", 2)
    told = faults(make_axes, {"list": {"chain.gravity": [1.0, 2.0], "chain.top": ["free"]}})
    assert told == [("list.chain.top", "must have 2 values, as many as chain.gravity (got 1)")]
    nothing = "is empty: name a key, such as chain.gravity = [1.62, 9.81]"
    assert faults(make_axes, {"grid": {}}) == [("grid", nothing)]
    told = faults(make_axes, {"grid": {"chain.gravity": []}})
    assert told == [("grid.chain.gravity", "must be a list of one or more values")]
    assert faults(make_axes, {"grid": [1]}) == [("grid", "must be a table, [grid]")]


def test_a_hypercube_is_reproducible_from_its_seed():
    low = {"low": 1.0, "high": 3.0}
    high = {"mean": 5.0, "deviation": 0.5}
    table = {"draws": 40, "seed": 3, "chain.gravity": low, "excitation.velocity": high}
    (axis,) = make_axes({"random": table})
    assert (axis.name, axis.length, axis.drawn) == ("draw", 40, True)
    parts = stats.qmc.LatinHypercube(2, seed=np.random.default_rng(3)).random(40)
    assert axis.columns["chain.gravity"] == pytest.approx(1.0 + 2.0 * parts[:, 0], rel=1e-14)
    normal = stats.norm.ppf(parts[:, 1], 5.0, 0.5)
    assert axis.columns["excitation.velocity"] == pytest.approx(normal, rel=1e-13)
    (other,) = make_axes({"random": table | {"seed": 4}})
    assert not set(other.columns["chain.gravity"]) & set(axis.columns["chain.gravity"])
    (grains,) = make_axes(
        {"random": {"draws": 2, "seed": 3, "chain.masses": {"low": 1e-6, "high": 2e-6}}}
    )
    assert not grains.columns
    assert [each.key for each in grains.arrays] == ["chain.masses"]
    (each,) = make_axes(
        {"random": {"draws": 2, "seed": 3, "chain.diameter": low | {"per_grain": True}}}
    )
    assert [one.key for one in each.arrays] == ["chain.diameter"]
    missing = "name a key, such as chain.gravity = {low = 1.0, high = 10.0}"
    assert faults(make_axes, {"random": {"draws": 2, "seed": 3}}) == [("random", missing)]


def test_realisations_have_random_contacts_if_an_order_is_given():
    (contacts,) = make_axes({"disorder": {"m": 2, "seed": 1, "realisations": 3}})
    assert (contacts.name, contacts.drawn, contacts.arrays) == ("realisation", True, ())
    assert list(contacts.columns["disorder.index"]) == [0, 1, 2]
    masses = {"chain.masses": {"low": 1e-6, "high": 2e-6}}
    (grains,) = make_axes({"disorder": {"seed": 1, "realisations": 3} | masses})
    assert not grains.columns
    assert grains.arrays[0].seed == 1
    (both,) = make_axes({"disorder": {"m": 2, "seed": 1, "realisations": 3} | masses})
    assert "disorder.index" in both.columns
    assert both.arrays
    swept, indexed = make_axes(
        {"grid": {"disorder.m": [1, 2]}, "disorder": {"seed": 1, "realisations": 3} | masses}
    )
    assert swept.name == "disorder.m"
    assert "disorder.index" in indexed.columns


def test_the_number_of_scenes_is_limited_to_a_million(monkeypatch: pytest.MonkeyPatch):
    assert module.MOST_SCENES == 10**6
    monkeypatch.setattr(module, "MOST_SCENES", 6)
    grid = {"chain.gravity": [1.0, 2.0], "chain.exponent": [1.5, 2.0, 3.0]}
    assert len(make_axes({"grid": grid})) == 2
    told = faults(make_axes, {"grid": grid | {"chain.exponent": [1.5] * 4}})
    assert told == [("grid", "8 scenes are too many: sweep at most 6")]


def test_numbers_of_draws_and_seeds_have_limits():
    ranges = {"chain.gravity": {"low": 1.0, "high": 2.0}}
    for draws, seed, wrong in ((10**6 + 1, 0, ["draws"]), (0, -1, ["draws", "seed"])):
        keys = fault_keys(make_axes, {"random": {"draws": draws, "seed": seed} | ranges})
        assert keys == [f"random.{key}" for key in wrong]
    assert make_axes({"random": {"draws": 1, "seed": 0} | ranges})[0].length == 1


def test_keys_must_belong_to_a_scene_and_be_unique():
    keys = "keys begin with chain, excitation, recording, as chain.gravity does"
    (fault,) = faults(make_axes, {"grid": {"chian.gravity": [1.0]}})
    assert fault == ("chian.gravity", f"is not a key of a scene (did you mean 'chain'?); {keys}")
    (fault,) = faults(make_axes, {"grid": {"disorder.m": [1.0]}})
    assert fault[0] == "disorder.m"
    grid = {"chain.gravity": [1.0]}
    cases = {"chain.gravity": [2.0]}
    assert faults(make_axes, {"grid": grid, "list": cases}) == [("chain.gravity", "is swept twice")]
    overlap = faults(
        make_axes,
        {"grid": {"chain.material.density": [1.0]}, "list": {"chain.material": ["glass"]}},
    )
    assert overlap == [("chain.material", "overlaps chain.material.density: sweep one of them")]
    # One key begins like the other, but is a different key.
    make_axes({"grid": {"chain.top": ["free"], "chain.top_load": [1.0]}})
    (fault,) = faults(make_axes, {})
    assert fault == ("grid", "nothing is swept: add a table [grid], [list], [random], [disorder]")


# --- laws


PARTS = np.array([1e-6, 0.1, 0.5, 0.9, 1 - 1e-6])


def test_laws_agree_with_scipy():
    uniform = Uniform(low=2.0, high=5.0)
    normal = Normal(mean=3.0, deviation=0.5)
    assert uniform.at(PARTS) == pytest.approx(stats.uniform.ppf(PARTS, 2.0, 3.0), rel=1e-14)
    assert normal.at(PARTS) == pytest.approx(stats.norm.ppf(PARTS, 3.0, 0.5), rel=1e-13)
    even = Uniform(low=2.0, high=5.0, log=True)
    assert even.at(PARTS) == pytest.approx(stats.loguniform.ppf(PARTS, 2.0, 5.0), rel=1e-13)
    lognormal = Normal(mean=3.0, deviation=0.5, log=True)
    sigma = np.sqrt(np.log(1 + (0.5 / 3.0) ** 2))
    scale = 3.0 * np.exp(-(sigma**2) / 2)
    expected = stats.lognorm(s=sigma, scale=scale)
    assert lognormal.at(PARTS) == pytest.approx(expected.ppf(PARTS), rel=1e-12)
    assert (expected.mean(), expected.std()) == pytest.approx((3.0, 0.5), rel=1e-12)


def test_a_table_is_a_range_or_a_distribution():
    assert make_law({"low": 1.0, "high": 2.0}) == Uniform(low=1.0, high=2.0)
    assert make_law({"mean": 1.0, "deviation": 2.0}) == Normal(mean=1.0, deviation=2.0)
    for half, key in (
        ({"mean": 1.0}, "deviation"),
        ({"deviation": 1.0}, "mean"),
        ({"low": 1.0}, "high"),
    ):
        with pytest.raises(InputError, match=f"{key}: is missing"):
            make_law(half)
    with pytest.raises(InputError, match="must be a range or a distribution"):
        make_law([1.0, 2.0])


def test_invalid_laws():
    logarithm = "must be above 0 where log is true (got {:g})"
    for table, key, message in (
        ({"low": 2.0, "high": 2.0}, "high", "must be above low, 2 (got 2)"),
        ({"low": 0.0, "high": 2.0, "log": True}, "low", logarithm.format(0)),
        ({"low": -1.0, "high": 2.0, "log": True}, "low", logarithm.format(-1)),
        ({"mean": 0.0, "deviation": 2.0, "log": True}, "mean", logarithm.format(0)),
        ({"mean": 1.0, "deviation": 0.0}, "deviation", "must be above 0 (got 0.0)"),
    ):
        assert faults(make_law, table) == [(key, message)]


def test_laws_at_their_limits():
    make_law({"low": 2.0, "high": float(np.nextafter(2.0, 3.0))})
    make_law({"low": 5e-324, "high": 2.0, "log": True})
    make_law({"low": -2.0, "high": -1.0})
    make_law({"mean": 5e-324, "deviation": 1.0, "log": True})
    make_law({"mean": 0.0, "deviation": 1.0})


def test_numbers_of_grains_depend_on_seed_scene_and_key():
    """The documented recipe reproduces the numbers."""
    uniform = Uniform(low=1.0, high=2.0)
    for key, fewer in (("chain.masses", 0), ("chain.diameter", 0), ("chain.contact_constants", 1)):
        mark = int.from_bytes(hashlib.sha256(key.encode()).digest()[:4], "big")
        sequence = np.random.SeedSequence(7, spawn_key=(3, mark))
        expected = 1.0 + np.random.default_rng(sequence).random(9 - fewer)
        assert np.array_equal(GrainLaw(key, uniform, 7).values(3, 9), expected)
    with pytest.raises(InputError, match=r"^chain\.gravity: has no separate value for each grain"):
        module.bind_laws({"chain.gravity": uniform}, 1)
    assert json.dumps(uniform.given()) == '{"low": 1.0, "high": 2.0}'
