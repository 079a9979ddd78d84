"""Results keep their bits.

200 random scenes by "auto", after a stop and in batches against a stored table.

Where the table was made with other versions or on another kind of processor, engines, steps and
error estimates are compared. `tests/data/make_bits.py` made it.
"""

import json
from pathlib import Path

import pytest
from data import make_bits

from lmpchain.engines import cost_model


@pytest.fixture(autouse=True)
def _shipped_speeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Let "auto" use the shipped speeds instead of the measured speeds of this machine."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    cost_model.measured.cache_clear()
    yield
    cost_model.measured.cache_clear()


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(
            n, marks=() if n % 60 == 0 else pytest.mark.slow if n % 8 == 4 else pytest.mark.soak
        )
        for n in range(make_bits.SCENES)
    ],
)
def test_results_of_a_random_scene(number: int):
    assert not list(make_bits.differences(str(number), make_bits.choice_cases(number), some=True))


def test_results_in_batches():
    assert not list(make_bits.differences("batches", make_bits.batches()))


def test_without_bits_all_other_data_are_compared():
    row = ["0381219472dd48c4", "1.3667e-05", "4.4e-15", "chebyshev", 1000]
    same = [
        ["ffffffffffffffff", *row[1:]],
        [row[0], "1.3670e-05", "1e-13", *row[3:]],
        [*row[:4], 1015],
    ]
    other = [
        [*row[:3], "native", 1000],
        [row[0], "1.4e-05", *row[2:]],
        [*row[:4], 1030],
        ["ToleranceNotMet"],
        row[:4],
    ]
    assert all(make_bits.alike(row, each) for each in same)
    assert not any(make_bits.alike(row, each) for each in other)


def test_the_table_states_its_versions():
    table = json.loads(make_bits.TABLE.read_text(encoding="utf-8"))
    assert table["made with"].keys() == make_bits.fingerprint().keys()
    assert len(table) == make_bits.SCENES + 2
