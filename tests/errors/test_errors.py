"""Values in error messages, and valid tolerances."""

import numpy as np
import pytest

from lmpchain.errors import (
    InputError,
    LmpchainError,
    ToleranceNotMet,
    check_tolerance,
    short,
    shown,
)

WIDEST = 80  # Letters of a value in an error line, the width of a terminal.


def test_texts_are_shown_up_to_the_width_of_a_terminal():
    assert short("g" * WIDEST) == "g" * WIDEST
    assert short("g" * (WIDEST + 1)) == "g" * (WIDEST - 3) + "..."
    assert short(1.5) == "1.5"


class Mute:
    """A value whose `repr` raises an error."""

    def __repr__(self) -> str:
        raise ValueError


class Talker:
    def __repr__(self) -> str:
        return "<" + "talk " * 100 + ">"


def test_values_are_shown_as_in_python_within_one_line():
    for value in (1.5, "glass", [0.5, None], True, "x" * (WIDEST - 2), 10 ** (WIDEST - 1)):
        assert shown(value) == repr(value)
    for value in ("x" * (WIDEST - 1), 10**WIDEST, Talker(), list("abcdefghij")):
        assert len(shown(value)) <= WIDEST
        assert "..." in shown(value)
    assert shown(Mute()).startswith("<Mute instance at ")
    assert shown(10**5000) == "a int too long to show"


def test_keys_are_shortened_unless_they_are_paths():
    path = "/data/" + "run" * 100
    long = "g" * 200
    error = InputError([(path, "is there"), (long, "unknown"), ("a" * 85 + "/b", "unknown")])
    keys = [key for key, _ in error.faults]
    assert keys == [path, short(long), short("a" * 85 + "/b")]
    assert str(error) == "\n".join(f"{key}: {message}" for key, message in error.faults)
    assert InputError([("", "x"), ("m", "y")]).under("chain") == [("chain", "x"), ("chain.m", "y")]
    assert isinstance(error, ValueError)
    assert isinstance(error, LmpchainError)


def test_a_missed_tolerance_contains_the_trajectory():
    error = ToleranceNotMet("too chaotic", "the trajectory")
    assert (str(error), error.reason, error.trajectory) == (
        "too chaotic",
        "too chaotic",
        "the trajectory",
    )
    assert ToleranceNotMet("no").trajectory is None
    assert ToleranceNotMet("no").known_until == np.inf
    assert ToleranceNotMet("too chaotic", None, 2e-3).known_until == 2e-3


@pytest.mark.parametrize("tolerance", [1e-300, 1e-6, 0.5, np.nextafter(1.0, 0.0)])
def test_tolerances_between_0_and_1(tolerance: float):
    check_tolerance(tolerance)


@pytest.mark.parametrize(
    "tolerance", [0, 0.0, 1, 1.0, 1.5, -1e-6, float("nan"), True, False, "1e-6", None]
)
def test_invalid_tolerances(tolerance: object):
    with pytest.raises(InputError) as caught:
        check_tolerance(tolerance)
    message = f"must be between 0 and 1 (got {tolerance!r})"
    assert caught.value.faults == [("tolerance", message)]
