"""Spectra of known motions, eigenfrequencies, dispersion and space-time pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import run, scene_of
from helpers.faults import fault_keys
from numpy.typing import NDArray

from lmpchain import Chain, Impulse, Trajectory, simulate
from lmpchain.measure.front import track
from lmpchain.measure.spectrum import cut_off, dispersion, space_time, spectrum, travel_time

Array = NDArray[np.float64]


def made_up(
    motion: Callable[[Array, Array], Array],
    samples: int = 400,
    duration: float = 399e-6,
    grains: int = 16,
) -> Trajectory:
    """Return a trajectory with velocity and displacement motion(t, n), t in s."""
    chain = column(grains)
    scene = scene_of(chain, Impulse(velocity=1e-9), duration, samples)
    values = motion(scene.time[:, None], np.arange(1.0, grains + 1))
    return replace(
        simulate(scene, engine="native", tolerance=1e-3), velocity=values, displacement=values
    )


def noise(t: Array, n: Array) -> Array:
    return np.random.default_rng(3).normal(size=(t.size, n.size))


def loaded(grains: int, **given: Any) -> Chain:
    return column(grains, gravity=0.0, top_load=1e-3, **given)


# --- in time


# --- in space and time


def test_a_uniform_chain_has_its_dispersion_relation():
    """The ridge is omega = 2 sqrt(k/m) sin(q/2), to half the resolution in frequency."""
    chain = loaded(121)
    omega = 2 * np.sqrt(chain.linear_stiffness[0] / chain.masses[0])
    speed = 1e-4 * chain.length_scale * omega
    t = run(chain, Impulse(velocity=speed, grain=61), 110 / omega, 401, 1e-8)
    found = dispersion(t, 1, 121)
    assert found.grain.tolist() == [1, 61, 121]
    exact = omega / (2 * np.pi) * np.abs(np.sin(found.wavenumber / 2))
    assert found.relation == pytest.approx(np.tile(exact, (3, 1, 1)), rel=1e-12)
    assert np.abs(found.ridge - exact).max() < 0.6 * found.frequency[1]
    assert found.amplitude == pytest.approx(
        found.amplitude[:, ::-1], abs=0.03 * found.amplitude.max()
    )


def test_waves_in_a_column_move_downward_on_the_local_relation():
    chain = column(200)
    speed = 1e-4 * chain.length_scale / chain.time_scale
    t = run(chain, Impulse(velocity=speed), 110 * chain.time_scale, 1001, 1e-8)
    found = dispersion(t, 60, 140)
    down, up = (
        found.amplitude[:, side].max() for side in (found.wavenumber > 0.1, found.wavenumber < -0.1)
    )
    assert up < 0.02 * down
    assert (found.relation[0] <= found.relation[1]).all()
    assert (found.relation[1] <= found.relation[2]).all()
    seen = (found.wavenumber > 0.15) & (found.wavenumber < 0.8)
    assert found.ridge[seen] == pytest.approx(
        found.relation[1, 0, seen], abs=2 * found.frequency[1]
    )


def test_a_dimer_has_two_branches():
    """The spectrum of a dimer chain has waves on both branches of the dispersion relation.

    w^2 = K (1/m + 1/M) -+ K [(1/m + 1/M)^2 - 4 sin^2(k) / (m M)]^(1/2)
    """
    masses = np.resize([1e-6, 3e-6], 160)
    chain = column(160, masses=masses, gravity=0.0, top_load=1e-3)
    stiffness = chain.linear_stiffness[0]
    unit = chain.time_scale
    scene = scene_of(
        chain, Impulse(velocity=1e-5 * chain.length_scale / unit, grain=81), 150 * unit, 601
    )
    found = dispersion(simulate(scene, engine="native", tolerance=1e-7), 1, 160)
    both = 1e6 * (1 + 1 / 3)
    k = found.wavenumber
    root = np.sqrt(both**2 - 4 * np.sin(k) ** 2 * 1e12 / 3)
    exact = np.sqrt(stiffness * np.maximum([both - root, both + root], 0)) / (2 * np.pi)
    assert found.relation == pytest.approx(
        np.tile(exact, (3, 1, 1)), rel=1e-9, abs=1e-9 * exact.max()
    )
    gap = (found.relation[1, 0].max() + found.relation[1, 1].min()) / 2
    near = (np.abs(found.wavenumber) > 0.3) & (np.abs(found.wavenumber) < 1.4)
    for branch, side in zip(
        found.relation[1], (found.frequency < gap, found.frequency > gap), strict=True
    ):
        ridge = found.frequency[side][found.amplitude[side].argmax(0)]
        assert np.abs(ridge - branch)[near].max() < 1.5 * found.frequency[1]
    axes = found.plot().figure.axes[0]
    assert len(axes.lines) == 6
    assert axes.get_ylim()[1] > found.relation.max()


# --- what the chain lets pass, and how fast


def test_cut_off():
    assert 2 * np.pi * cut_off(loaded(500)) == pytest.approx(loaded(500).band_edge, rel=1e-4)
    column = Chain(grains=100, diameter=1e-3)
    rise = np.append(np.arange(1, 100), 99) ** (1 / 6)
    assert cut_off(column) == pytest.approx(rise / (np.pi * column.time_scale), rel=1e-12)
    assert not cut_off(Chain(grains=5, diameter=1e-3, gravity=0.0)).any()


def test_cut_off_of_a_dimer():
    """The optical branch ends at 2K (1/m + 1/M); the gap is from 2K/M to 2K/m, with the local K."""
    masses = np.resize([1e-6, 3e-6], 60)
    chain = Chain(grains=60, diameter=1e-3, masses=masses, gravity=0.0, top_load=1e-3)
    k = chain.linear_stiffness[0]
    assert (2 * np.pi * cut_off(chain)) ** 2 == pytest.approx(2 * k * 1e6 * (1 + 1 / 3), rel=1e-12)
    scene = scene_of(chain, Impulse(velocity=1e-9), 20 * chain.time_scale, 64)
    found = spectrum(simulate(scene, "modes"))
    assert (2 * np.pi * found.bands[:, 0, 1]) ** 2 == pytest.approx(2 * k * 1e6 / 3, rel=1e-12)
    assert (2 * np.pi * found.bands[:, 1, 0]) ** 2 == pytest.approx(2 * k * 1e6, rel=1e-12)
    assert found.bands[:, 0, 0] == pytest.approx(0, abs=1e-9 * found.cut_off[0])
    axes = found.plot()
    assert [line.get_label() for line in axes.lines[:2]] == [
        "local cut-off",
        "gap between branches",
    ]
    assert axes.get_xlim()[1] == pytest.approx(1.5 * found.cut_off[0])
    one = Chain(grains=1, diameter=1e-3, gravity=0.0, top_load=1.0, top="wall", bottom="wall")
    assert cut_off(one) == pytest.approx(
        np.sqrt(one.contacts.stiffness.sum() / one.masses[0]) / (2 * np.pi)
    )
    column = Chain(grains=200, diameter=1e-3, masses=np.resize([1e-6, 3e-6], 200))
    local = column.linear_stiffness[99]
    assert (2 * np.pi * cut_off(column)[99]) ** 2 == pytest.approx(
        2 * local * 1e6 * (1 + 1 / 3), rel=5e-3
    )


def test_travel_time_in_a_column():
    """The time is (6/5) (n - 1/2)^(5/6); the velocity peaks some 0.9 h^(1/6) / 4^(1/3) later."""
    chain = column(240)
    n = np.arange(1, 241)
    assert travel_time(chain) / chain.time_scale == pytest.approx(
        1.2 * (n - 0.5) ** (5 / 6), abs=0.19
    )
    speed = 1e-4 * chain.length_scale / chain.time_scale
    scene = scene_of(chain, Impulse(velocity=speed), 106 * chain.time_scale, 801, grains="20:200")
    front = track(simulate(scene, engine="native", tolerance=1e-8))
    assert front.grain[-1] == 200
    late = (front.time - travel_time(chain)[front.grain - 1]) / chain.time_scale
    width = (front.grain - 0.5) ** (1 / 6) / 4 ** (1 / 3)
    assert late / width == pytest.approx(0.89, abs=0.06)


# --- faults and pictures


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda t: spectrum(t, "energy"), "field"),
        (lambda t: space_time(t, "energy"), "field"),
        (lambda t: spectrum(made_up(noise, samples=15)), "samples"),
        (lambda t: spectrum(t, window="house"), "window"),
        (lambda t: space_time(ringing(gravity=0.0), law=True), "chain"),
        (lambda t: travel_time(t.scene.chain, 0), "source"),
        (lambda t: travel_time(t.scene.chain, 2.5), "source"),
        (lambda t: dispersion(t, 1, 7), "last"),
        (lambda t: dispersion(t, 9, 2), "last"),
        (lambda t: dispersion(t, 5, 20), "grains"),
        (lambda t: dispersion(t, 0, 10), "grains"),
        (lambda t: dispersion(replace(t, grains=np.delete(np.arange(1, 18), 8)), 1, 16), "grains"),
    ],
)
def test_faults_name_their_key(call: Callable[[Trajectory], object], key: str):
    assert fault_keys(call, made_up(noise)) == [key]


def ringing(**given: Any) -> Trajectory:
    chain = column(12, **given)
    scene = scene_of(chain, Impulse(velocity=1e-6, grain=3), 1e-4, 201)
    return simulate(scene, engine="native", tolerance=1e-6)
