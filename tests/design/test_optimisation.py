"""Optima against those of colliding balls, which are known exactly."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lmpchain import Chain, InputError, Profile, Scene
from lmpchain.design import Momentum, optimise
from lmpchain.design.changes import changed
from lmpchain.design.parameters import values

# three balls with gaps: m_2 = sqrt(m_1 m_3) gives the third one most (Huygens)
BALLS = Scene(
    chain=Chain(grains=3, diameter=1e-2, gravity=0, bottom="free", masses=[1e-3, 2e-3, 9e-3]),
    excitation=Profile(displacement=[0.0, 4e-5, 8e-5], velocity=[1.0, 0.0, 0.0]),
    duration=4e-4,
    samples=2,
)
BOUNDS = {"masses": ([1e-3, 1.2e-3, 9e-3], [1e-3, 8e-3, 9e-3])}


@pytest.mark.parametrize("tolerance", [1e-5, 1e-7])
def test_an_optimum_is_as_flat_as_its_value_is_exact(tolerance: float):
    """By a share e beside the mean the momentum is less by 3/16 e^2: a value within its tolerance
    says no more.
    """
    found = optimise(
        BALLS, Momentum([3]), ["masses"], BOUNDS, maximise=True, starts=1, tolerance=tolerance
    )
    assert abs(found.values["masses"][1] / 3e-3 - 1) < np.sqrt(tolerance / (3 / 16))
    assert found.value == pytest.approx(9e-3 / 4, rel=tolerance)


@pytest.mark.slow
def test_the_ball_between_two_is_their_geometric_mean(tmp_path: Path):
    task: Any = dict(bounds=BOUNDS, maximise=True, starts=2, tolerance=1e-7, folder=tmp_path)
    found = optimise(BALLS, Momentum([3]), ["masses"], **task)
    np.testing.assert_allclose(found.values["masses"], [1e-3, 3e-3, 9e-3], rtol=1e-4)
    assert found.value == pytest.approx(9e-3 * 4 * 3 / (4 * 12), rel=1e-7)
    assert len(found.history) == 2
    assert found.scene.chain.masses[1] == found.values["masses"][1]
    again = optimise(BALLS, Momentum([3]), ["masses"], **task)
    assert again.value == found.value
    assert [part.tolist() for part in again.history] == [part.tolist() for part in found.history]
    with pytest.raises(InputError, match="another task"):
        optimise(BALLS, Momentum([2]), ["masses"], **task)


def test_constraints_are_kept():
    def light(by_name):
        return 2e3 * (2e-3 - by_name["masses"][1]), {"masses": np.array([0, -2e3, 0])}

    found = optimise(BALLS, Momentum([3]), ["masses"], BOUNDS, [light], maximise=True, starts=1)
    assert found.values["masses"][1] == pytest.approx(2e-3, rel=1e-5)


@pytest.mark.slow
def test_what_was_finished_is_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    whole = optimise(BALLS, Momentum([3]), ["masses"], BOUNDS, maximise=True, starts=3)

    def stop(*_):
        raise KeyboardInterrupt

    from lmpchain.design import optimisation

    descend = optimisation._descend
    done = []

    def two_of_them(*arguments):
        if len(done) == 2:
            stop()
        done.append(1)
        return descend(*arguments)

    monkeypatch.setattr(optimisation, "_descend", two_of_them)
    with pytest.raises(KeyboardInterrupt):
        optimise(BALLS, Momentum([3]), ["masses"], BOUNDS, maximise=True, starts=3, folder=tmp_path)
    monkeypatch.setattr(optimisation, "_descend", descend)
    found = optimise(
        BALLS, Momentum([3]), ["masses"], BOUNDS, maximise=True, starts=3, folder=tmp_path
    )
    assert found.value == whole.value
    (tmp_path / "starts.json").write_text('{"task": 3')
    with pytest.raises(InputError, match="damaged"):
        optimise(BALLS, Momentum([3]), ["masses"], BOUNDS, maximise=True, starts=3, folder=tmp_path)


def test_scenes_change_by_name():
    new = {
        "diameters": [1e-3, 2e-3, 1e-3],
        "youngs_moduli": [1e9, 2e9, 3e9],
        "gravity": [1.0],
        "velocity": [1, 2, 0],
    }
    scene = Scene(
        chain=Chain(grains=3, diameter=1e-3), excitation=Profile(velocity=[0, 1, 0]), duration=1e-5
    )
    made = changed(scene, {name: np.array(value, dtype=float) for name, value in new.items()})
    for name, value in new.items():
        np.testing.assert_array_equal(values(made, name), value)


def test_what_cannot_be_is_refused():
    with pytest.raises(InputError, match="bounds"):
        optimise(BALLS, Momentum([3]), ["masses"], {})
    with pytest.raises(InputError, match="nothing free"):
        optimise(
            BALLS, Momentum([3]), ["masses"], {"masses": (BALLS.chain.masses, BALLS.chain.masses)}
        )
    with pytest.raises(InputError, match="shape"):
        changed(BALLS, {"masses": np.ones(2)})
