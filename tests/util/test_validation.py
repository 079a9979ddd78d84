"""Checked values: all faults at once in plain text, limits, and checked copies."""

import copy
import pickle
import sys
import warnings
from collections.abc import Iterator
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from helpers.faults import fault_keys, faults
from pydantic import Field

from lmpchain import Chain, Impulse, InputError, Scene
from lmpchain.util.validation import (
    NOT_GIVEN,
    Checked,
    OneOrMany,
    Positive,
    PositiveVector,
    Real,
    Vector,
    Whole,
    check_positive,
    check_whole,
    each,
    make_unchecked,
    non_negative,
)


class Inner(Checked):
    """A value inside another."""

    size: Positive


class Sample(Checked):
    """One field of each kind."""

    real: Real = 0.5
    positive: Positive = 1.0
    share: Annotated[float, Field(ge=0, le=1)] = 0.5
    below: Annotated[float, Field(lt=3)] = 2.0
    count: Whole = 1
    vector: Vector = NOT_GIVEN
    positives: PositiveVector = NOT_GIVEN
    diameter: OneOrMany = 1.0
    end: Literal["free", "wall"] = "free"
    inner: Inner | None = None
    chain: Chain | None = None
    note: str = ""

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.real > self.below:
            yield "real", "must not be above below"

    def _remarks(self) -> Iterator[str]:
        if self.share == 1:
            yield "a share of 1 is all"

    @cached_property
    def double(self) -> float:
        return 2 * self.real


class Given(Checked):
    first: Real
    second: Real
    third: Real = 3.0


LARGEST = sys.float_info.max
INT = 2**63


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("real", [-1.5, 0, np.float64(0.25), np.int64(-3), -LARGEST]),
        ("positive", [5e-324, 1, np.float32(0.5), LARGEST]),
        ("share", [0.0, 0, 1, 0.3]),
        ("below", [np.nextafter(3.0, 0.0), 2]),
        ("count", [-5, 0, INT - 1, np.int32(7)]),
        ("vector", [[0.0], (1, -2.5), np.array([3, 4]), range(3), [1e308]]),
        ("positives", [[5e-324], (1, 2)]),
        ("diameter", [5e-324, 1, LARGEST, [1e-3], np.array([1, 2]), np.float64(2.0)]),
        ("end", ["free", "wall"]),
    ],
)
@pytest.mark.filterwarnings("ignore:a share of 1")
def test_accepted_values(field: str, values: list[Any]):
    for value in values:
        kept = getattr(Sample(**{field: value}), field)
        assert np.array_equal(kept, value)
        if isinstance(kept, np.ndarray):
            assert kept.dtype == float
            assert not kept.flags.writeable
            assert kept.ndim == 1
        elif field not in ("count", "end"):
            assert type(kept) is float


TEXT = "must be numbers, not text: read it with float first"
TRUTH = "must be numbers, not truth values: give 0 and 1 if these are meant"
ONE_OR_MANY = "must be a number or a list of numbers"


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("real", "1", "must be a number (got '1')"),
        ("real", True, "must be a number (got True)"),
        ("real", None, "must be a number (got a NoneType)"),
        ("real", float("nan"), "must be a finite number (got nan)"),
        ("real", -np.inf, "must be a finite number (got -inf)"),
        ("positive", 0, "must be above 0 (got 0)"),
        ("positive", -5e-324, "must be above 0 (got -5e-324)"),
        ("share", -5e-324, "must be at least 0.0 (got -5e-324)"),
        ("share", 1.0000000000000002, "must be at most 1.0 (got 1.0000000000000002)"),
        ("below", 3.0, "must be below 3.0 (got 3.0)"),
        ("count", 1.0, "must be a whole number (got 1.0)"),
        ("count", 1.5, "must be a whole number (got 1.5)"),
        ("count", "many", "must be a whole number (got 'many')"),
        ("count", INT, f"must be below {INT} (got {INT})"),
        ("vector", None, "must be a list of numbers: leave it out if it is not given"),
        ("vector", [1.0, True], TRUTH),
        ("vector", ["1", 2.0], TEXT),
        ("vector", ("1",), TEXT),
        ("vector", {"a": 1}, "must be numbers (got {'a': 1})"),
        ("vector", [1.0, None, object()], "must be numbers (got None)"),
        ("vector", [10**400], "must be numbers below 1.8e308"),
        ("vector", [], "must be a list of numbers, not of shape (0,)"),
        ("vector", [[1.0, 2.0]], "must be a list of numbers, not of shape (1, 2)"),
        ("vector", 1.0, "must be a list of numbers, not of shape ()"),
        ("vector", [1.0, 2.0, np.inf, np.nan], "must be finite, but entry 3 is not"),
        ("positives", [1.0, 0.0, -1.0], "must be above 0, but entry 2 is 0"),
        ("positives", [-1.25, 1.0], "must be above 0, but entry 1 is -1.25"),
        ("positives", [1.0, np.nan], "must be finite, but entry 2 is not"),
        ("diameter", 0, "must be a finite number above 0 (got 0)"),
        ("diameter", -1.0, "must be a finite number above 0 (got -1.0)"),
        ("diameter", np.inf, "must be a finite number above 0 (got inf)"),
        ("diameter", np.nan, "must be a finite number above 0 (got nan)"),
        ("diameter", True, f"{ONE_OR_MANY} (got True)"),
        ("diameter", np.bool_(True), f"{ONE_OR_MANY} (got True)"),
        ("diameter", "1", f"{ONE_OR_MANY} (got '1')"),
        ("diameter", [1.0, 0.0], "must be above 0, but entry 2 is 0"),
        ("end", "fre", "must be 'free' or 'wall' (got 'fre') (did you mean 'free'?)"),
        ("end", 5, "must be 'free' or 'wall' (got 5)"),
        ("inner", 5, "must be of the type Inner (got 5): make one, or read a scene file"),
        ("note", 5, "input should be a valid string (got 5)"),
        ("note", Sample, "input should be a valid string (got a ModelMetaclass)"),
    ],
)
def test_each_fault_is_described_in_plain_text(field: str, value: Any, message: str):
    assert faults(Sample, **{field: value}) == [(field, message)]


def test_all_faults_are_reported_at_once():
    told = dict(faults(Sample, positive=0, counts=3, end="open", share=2))
    assert list(told) == ["counts", "positive", "share", "end"]
    keys = ", ".join(Sample.model_fields)
    assert told["counts"] == f"unknown key (did you mean 'count'?); the keys here are {keys}"
    assert faults(Sample, real=2.5) == [("real", "must not be above below")]
    assert faults(Sample, real=2.5, colour=1)[0][0] == "colour"
    assert [key for key, _ in faults(Sample, real=2.5, colour=1)] == ["colour", "real"]


def test_faults_of_a_nested_value_have_its_key():
    assert faults(Sample, inner={"size": 0}) == [("inner.size", "must be above 0 (got 0)")]
    assert faults(Sample, inner={}) == [("inner.size", "is missing; add it")]
    missing = "is missing; add it"
    assert faults(Given) == [("first", missing), ("second", missing)]


def test_fields_by_position():
    assert Given(1.0, 2.0) == Given(first=1.0, second=2.0)
    assert Given(1.0, 2.0, 4.0).third == 4.0
    many = "accepts first, second, third: 4 values are too many"
    assert faults(Given, 1.0, 2.0, 3.0, 4.0) == [("", many)]
    twice = "is given twice, by position and by name: give every argument by name"
    assert faults(Given, 1.0, 2.0, first=3.0) == [("first", twice)]


def test_unlikely_values_cause_warnings():
    with pytest.warns(UserWarning, match="a share of 1 is all"):
        Sample(share=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Sample(share=0.9)


def test_copies_are_checked_or_are_the_value_itself():
    sample = Sample(real=0.25, vector=[1.0, 2.0], inner={"size": 2.0})
    changed = sample.replace(count=5)
    assert (changed.real, changed.count, changed.vector.tolist()) == (0.25, 5, [1.0, 2.0])
    assert sample.replace(real=None).given().keys() == {"vector", "inner"}
    wrong = [("positive", "must be above 0 (got -1)")]
    assert faults(sample.replace, real=9.0, positive=-1) == wrong
    for same in (sample.model_copy(), copy.copy(sample), copy.deepcopy(sample), sample.copy()):
        assert same is sample
    assert sample.model_copy(update={"count": 5}) == changed
    assert sample.copy(update={"count": 5}) == changed
    assert sample.copy(deep=True) is sample
    with pytest.raises(InputError, match="copy: copies all fields"):
        sample.copy(include={"real"})
    with pytest.raises(InputError, match="Sample: must be checked"):
        Sample.model_construct(real=1.0)
    with pytest.raises(InputError, match=r"real: cannot be changed: use .replace\(real=...\)"):
        sample.real = 1.0
    with pytest.raises(InputError, match="real: cannot be deleted"):
        del sample.real
    assert sample.real == 0.25


def test_values_with_equal_contents_are_equal():
    sample = Sample(vector=[1.0, 2.0])
    assert sample == Sample(vector=(1, 2))
    assert sample != Sample(vector=[1.0, 2.5])
    assert sample != Sample()
    assert Given(1.0, 2.0) != Sample()
    assert Inner(size=1.0) != 1.0
    assert hash(sample) == hash(Sample(vector=(1, 2)))
    zero, other = Sample(vector=[0.0, 2.0]), Sample(vector=[-0.0, 2.0])
    assert (zero == other, hash(zero) == hash(other)) == (True, True)
    assert len({hash(each) for each in (sample, zero, Sample(), Sample(vector=[2.0]))}) == 4


def test_a_pickled_value_is_equal_and_immutable():
    sample = Sample(real=0.25, vector=[1.0, 2.0])
    assert sample.double == 0.5
    loaded = pickle.loads(pickle.dumps(sample))
    assert loaded == sample
    assert loaded.given().keys() == {"real", "vector"}
    assert not loaded.vector.flags.writeable
    assert "double" in vars(sample)
    assert "double" not in vars(loaded)


def test_an_unchecked_value_equals_a_checked_one():
    chain = Chain(grains=3, diameter=1e-3)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=1e-6)
    quick = make_unchecked(Scene, **scene.given())
    assert quick == scene
    assert quick.given().keys() == scene.given().keys()
    assert quick.model_fields_set == {"chain", "excitation", "duration"}


def test_help_lists_fields_and_defaults():
    signature = Given.__signature__
    assert str(signature) == "(*, first, second, third=3.0)"
    assert Given(1.0, 2.0).given() == {"first": 1.0, "second": 2.0}
    assert repr(Given(1.0, 2.0)) == str(Given(1.0, 2.0)) == "Given(first=1, second=2)"


def test_names_of_a_value_are_its_own_and_those_of_every_object():
    class Summed(Sample):
        def total(self) -> float:
            return self.real + self.positive

    names = set(dir(Summed()))
    assert {"real", "positive", "total", "replace"} <= names
    assert {"__class__", "__eq__", "__doc__"} <= names
    assert not {"model_dump", "model_fields", "__pydantic_fields__", "__class_vars__"} & names
    assert not {name for name in names if name.startswith("__")} - set(dir(object))


def test_numbers_from_0_and_above_0():
    assert (non_negative(0), non_negative(np.float64(2.5))) == (0.0, 2.5)
    assert non_negative([0.0, 3.0]).tolist() == [0.0, 3.0]
    for value, message in (
        (-5e-324, "must be a finite number from 0"), (np.inf, "must be a finite number from 0"),
        (True, "must be a number or a list"), ("1", "must be a number or a list"),
        ([0.5, -0.5], "must be from 0, but entry 2 is -0.5"), ([], "not of shape"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            non_negative(value)
    assert check_positive("key", np.float32(0.5)) == 0.5
    assert check_positive("key", 3) == 3.0
    for value in (0, -1.0, np.inf, np.nan, True, "1", None):
        with pytest.raises(InputError, match=r"^key: must be a number above 0 \(got "):
            check_positive("key", value)
    assert (check_whole("key", 1, 1), check_whole("key", np.int64(7), 0)) == (1, 7)
    for value in (0, -1, 1.0, True, "1", None):
        with pytest.raises(InputError, match=r"^key: must be a whole number from 1 \(got "):
            check_whole("key", value, 1)


def test_unknown_keys_are_reported_with_the_other_faults():
    (unknown, text), wrong = faults(Sample, real="1", rael=1.0)
    assert (unknown, text.partition(";")[0]) == ("rael", "unknown key (did you mean 'real'?)")
    assert wrong == ("real", "must be a number (got '1')")
    assert each([1, 2.5], float) == (1.0, 2.5)

    def make(item: Any) -> Any:
        return Inner(**item) if isinstance(item, dict) else float(item)

    assert fault_keys(each, [1.0, "a", {"size": 0}], make) == ["1", "2.size"]
