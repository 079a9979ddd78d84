"""Optima against the exact solutions for colliding balls."""

import sys
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from lmpchain import Chain, InputError, Profile, Scene
from lmpchain.design import Momentum, optimise
from lmpchain.design.optimisation import fingerprint
from lmpchain.design.parameters import changed, values

# Three balls with gaps: m_2 = sqrt(m_1 m_3) maximises the momentum of the third (Huygens).
BALLS = Scene(
    chain=Chain(grains=3, diameter=1e-2, gravity=0, bottom="free", masses=[1e-3, 2e-3, 9e-3]),
    excitation=Profile(displacement=[0.0, 4e-5, 8e-5], velocity=[1.0, 0.0, 0.0]),
    duration=4e-4,
    samples=2,
)
TASK: dict[str, Any] = {
    "scene": BALLS,
    "objective": Momentum([3]),
    "parameters": ["masses"],
    "bounds": {"masses": ([1e-3, 1.2e-3, 9e-3], [1e-3, 8e-3, 9e-3])},
    "maximise": True,
    "starts": 1,
}


@pytest.mark.parametrize("tolerance", [1e-5, 1e-7])
def test_an_optimum_is_as_flat_as_its_value_is_exact(tolerance: float):
    """At a relative distance e from the geometric mean the momentum is smaller by 3/16 e^2."""
    found = optimise(**TASK, tolerance=tolerance)
    assert abs(found.values["masses"][1] / 3e-3 - 1) < np.sqrt(tolerance / (3 / 16))
    assert found.value == pytest.approx(9e-3 / 4, rel=tolerance)


LIMIT = 2e-3


def below(limit: float):
    def light(by_name):
        return 2e3 * (limit - by_name["masses"][1]), {"masses": np.array([0, -2e3, 0])}

    return light


def below_a_global(by_name):
    return 2e3 * (LIMIT - by_name["masses"][1]), {"masses": np.array([0, -2e3, 0])}


def test_a_folder_is_of_one_task_constraints_included(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """With an additional constraint, the old optimum of 3 g was once returned instead of 2 g."""
    task = TASK | {"runs": 12, "folder": tmp_path / "starts"}
    free = optimise(**task)
    assert free.values["masses"][1] > 2.5e-3
    others = [
        {"objective": Momentum([2])},
        {"constraints": [below(2e-3)]},
        {"constraints": [below_a_global]},
        {"tolerance": 1e-6},
        {"runs": 13},
        {"seed": 1},
        {"maximise": False},
        {"starts": 2},
        {"bounds": {"masses": (1e-4, 1e-2)}},
    ]
    for change in others:
        with pytest.raises(InputError, match="to another task: use another folder"):
            optimise(**task | change)
    task = task | {"folder": tmp_path / "light", "constraints": [below(2e-3)]}
    light = optimise(**task)
    assert light.values["masses"][1] == pytest.approx(2e-3, rel=1e-5)
    # The same constraint, defined again, is the same task.
    assert optimise(**task | {"constraints": [below(2e-3)]}).value == light.value
    for constraints in ([], [below(2.1e-3)], [below(2e-3), below(4e-3)]):
        with pytest.raises(InputError, match="to another task"):
            optimise(**task | {"constraints": constraints})
    task |= {"folder": tmp_path / "global", "constraints": [below_a_global]}
    optimise(**task)
    monkeypatch.setattr(sys.modules[__name__], "LIMIT", 2.5e-3)
    with pytest.raises(InputError, match="to another task"):
        optimise(**task)


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[" * 100_000,
        '{"task": ' + "[" * 100_000,
        "[1]",
        '{"task": "a"}',
        '{"task": "a", "starts": [{}]}',
        '{"task": "a", "starts": [{"value": "x", "at": [], "history": []}]}',
        '{"mine": 1}',
        '{"task": 3, "starts": []}',
        '{"task": "a", "starts": [{"value": 1, "at": [0], "history": 1}]}',
    ],
)
def test_a_foreign_starts_json_is_rejected_and_preserved(content: str, tmp_path: Path):
    (tmp_path / "starts.json").write_text(content)
    with pytest.raises(
        InputError, match=r"^folder: .*starts\.json is damaged, or lmpchain did not"
    ):
        optimise(**TASK, folder=tmp_path)
    assert (tmp_path / "starts.json").read_text() == content


@pytest.mark.parametrize("name", [3, 1.5, True, "a" * 300, "a\0b", ["a"], b"a"])
def test_names_that_no_folder_can_bear(name: Any):
    with pytest.raises(InputError, match=r"^folder: "):
        optimise(**TASK, folder=name)


def test_a_file_is_not_a_folder(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="is not a folder and cannot be made one"):
        optimise(**TASK, folder=tmp_path / "file")


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (lambda x: x + 1, lambda x: x + 2),
        (lambda x: np.sin(x), lambda x: np.cos(x)),
        (numba.njit(lambda x: x + 1), numba.njit(lambda x: x + 2)),
        ({1, 2}, {1, 3}),
        (lambda x, a=1: x, lambda x, a=2: x),
        (below(1.0), below(2.0)),
        (partial(max, 1), partial(max, 2)),
        (np.zeros(2000), np.append(np.zeros(1999), 1e-9)),
        ([1, 2], [2, 1]),
        ([1, 2], (1, 2)),
        (1, 1.0),
        (["a", "bc"], ["ab", "c"]),
        ({"a": 1}, {"a": 2}),
        (Momentum([3]), Momentum([2])),
        (Momentum([3]).grains, Momentum([2]).grains),
    ],
)
def test_a_fingerprint_distinguishes_values(one: Any, other: Any):
    assert fingerprint(one) != fingerprint(other)
    assert fingerprint(one) == fingerprint(deepcopy(one))


def test_a_fingerprint_depends_on_the_contents():
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
    assert fingerprint(lambda x: x + LIMIT) == fingerprint(lambda x: x + LIMIT)

    def endless(x):
        return endless(x)

    assert fingerprint(endless) == fingerprint(endless)


def test_scenes_change_by_name():
    new = {
        "diameters": [1e-3, 2e-3, 1e-3],
        "youngs_modulus": [1e9, 2e9, 3e9],
        "gravity": [1.0],
        "velocity": [1, 2, 0],
    }
    scene = Scene(
        chain=Chain(grains=3, diameter=1e-3), excitation=Profile(velocity=[0, 1, 0]), duration=1e-5
    )
    made = changed(scene, {name: np.array(value, dtype=float) for name, value in new.items()})
    for name, value in new.items():
        np.testing.assert_array_equal(values(made, name), value)


def test_invalid_tasks_are_rejected():
    with pytest.raises(InputError, match="bounds"):
        optimise(**TASK | {"bounds": {}})
    with pytest.raises(InputError, match="no parameter free"):
        optimise(**TASK | {"bounds": {"masses": (BALLS.chain.masses, BALLS.chain.masses)}})
    with pytest.raises(InputError, match="shape"):
        changed(BALLS, {"masses": np.ones(2)})
