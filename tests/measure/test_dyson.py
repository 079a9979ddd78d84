"""Eq. (22) of a trajectory: sums, table, JSON and picture, compared with Eq. (23) directly."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lmpchain import Chain, Impulse, InputError, Profile, Scene, simulate
from lmpchain.measure.dyson import DysonSums, orders, relative_stiffness, sums
from lmpchain.util.plotting import COLOURS, figure

Array = NDArray[np.float64]
GRAINS = 6
ORDERED = np.array([0.3, -0.8, 0.2, 0.1, 0.0, 0.0])


def dyson_weight(kappa: Array, m: float) -> Array:
    """Return D_m(kappa) = m^m / Gamma(m) kappa^m exp(-m kappa), Eq. (23)."""
    return m**m / math.gamma(m) * kappa**m * np.exp(-m * kappa)


def by_hand(unit: float, orders: tuple[float, ...] = (1.0, 5.0)) -> DysonSums:
    """Return the sums of a motion of six grains at two samples, by Eqs. (22) and (23)."""
    kappa = np.arange(1, GRAINS + 1) ** (1 / 3)
    velocity = np.array([[1.0, 0, 0, 0, 0, 0], [0.5, 0.25, -0.125, 1e-2, 4e-4, 0.0]]) * unit
    weight = np.array([dyson_weight(kappa, m) for m in orders])
    printed = weight @ velocity.T
    normalised = printed / weight.sum(1)[:, None]
    time = np.array([0.0, 2e-5])
    tau = np.array([0.0, 12.5])
    return DysonSums(
        np.array(orders), time, tau, kappa, velocity, weight, printed, normalised, unit
    )


def ensemble(sign: float, unit: float, model_error: float = 1e-3, squeezed: int = 0) -> Any:
    """Return means over random chains, largest at grain 2, recorded at grains 1, 2 and 4."""
    return SimpleNamespace(
        grains=np.array([1, 2, 4]),
        velocity=sign * unit * np.array([[9.0, 9.0, 9.0], [0.25, -0.5, 0.125]]),
        velocity_error=abs(unit) * np.array([[7.0, 7.0, 7.0], [0.01, 0.02, 0.04]]),
        realisations=30,
        model_error=model_error,
        squeezed=squeezed,
        seed=17,
    )


@pytest.mark.parametrize("bottom", ["fixed", "wall"])
def test_sums_over_the_grains_of_a_run(bottom: str):
    """Eq. (22) with the stiffness of Hertz's contacts, n^(1/3), and the weights of Eq. (23)."""
    chain = Chain(grains=30, diameter=1e-3, bottom=bottom)
    scene = Scene(
        chain=chain, excitation=Impulse(velocity=2e-12), duration=9 * chain.time_scale, samples=4
    )
    t = simulate(scene, "modes")
    velocity = np.zeros((4, 30))
    velocity[:, : chain.movable] = t.velocity[:, : chain.movable]
    seen = sums(t, [1, 2.5])
    kappa = np.arange(1.0, 31) ** (1 / 3)
    if bottom == "wall":  # K is 2^(1/2) times as large, so k is 2^(1/3) times as large.
        kappa[-1] *= 2 ** (1 / 3)
    weight = np.array([dyson_weight(kappa, m) for m in (1, 2.5)])
    assert seen.m.tolist() == [1, 2.5]
    assert seen.kappa == pytest.approx(kappa, rel=1e-13)
    assert seen.weight == pytest.approx(weight, rel=1e-12)
    assert np.array_equal(seen.velocity, velocity)
    assert seen.as_printed == pytest.approx(weight @ velocity.T, rel=1e-11)
    assert seen.normalised == pytest.approx(seen.as_printed / weight.sum(1)[:, None], rel=1e-12)
    assert seen.tau == pytest.approx(np.arange(4) * 3.0, rel=1e-13)
    assert np.array_equal(seen.time, t.time)
    assert (seen.unit, seen.unit_name) == (2e-12, "v0")


def test_a_motion_that_no_single_strike_began_is_shown_in_metres_a_second():
    chain = Chain(grains=8, diameter=1e-3)
    start = Profile(velocity=np.append(np.full(7, 1e-12), 0.0))
    scene = Scene(chain=chain, excitation=start, duration=chain.time_scale, samples=2)
    seen = sums(simulate(scene, "modes"), [3])
    assert (seen.unit, seen.unit_name) == (1.0, "m/s")
    assert seen.as_printed.shape == (1, 2)


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0])
def test_stiffness_over_that_of_the_first_contact(exponent: float):
    """The ratio is (F_n / F_1)^(1 - 1/delta), with the weight of grain N for the last contact."""
    masses = np.linspace(1e-6, 2e-6, 5)
    chain = Chain(grains=5, diameter=1e-3, masses=masses, exponent=exponent, top_load=1e-5)
    weight = 1e-5 + 9.81 * np.cumsum(masses)
    kappa = (weight / weight[0]) ** (1 - 1 / exponent)
    assert relative_stiffness(chain) == pytest.approx(kappa, rel=1e-13)
    with pytest.raises(
        InputError, match="gravity: without gravity and load, contacts have no stiffness"
    ):
        relative_stiffness(Chain(grains=5, diameter=1e-3, gravity=0.0))


@pytest.mark.parametrize("unit", [1.0, -0.5])
def test_the_table(unit: float, monkeypatch: pytest.MonkeyPatch):
    """The table has two orders, in units of the strike if there was one."""
    seen = by_hand(unit)
    others = [ensemble(1.0, unit), ensemble(-1.0, unit, 2e-2)]
    monkeypatch.setattr("lmpchain.util.tables.line_width", lambda: 120)
    lines = seen.table(ORDERED * unit, others).splitlines()
    name = "m/s" if unit == 1 else "v0 = -0.5 m/s"
    assert lines[0] == f"t = 2e-05 s (tau = 12.5); velocities in {name}"
    assert lines[1].startswith("Eq. (22): a sum over the grains of one chain")
    assert "over 30 linear chains" in lines[2]
    head, one, other, ordered = (line.split() for line in lines[3:7])
    assert (
        " ".join(head)
        == "m as printed sum of weights normalised random chains standard error grain"
    )
    for row, m, mean in ((one, 1, -0.5), (other, 5, 0.5)):
        weight = dyson_weight(np.arange(1, 7) ** (1 / 3), m)
        printed = weight @ np.array([0.5, 0.25, -0.125, 1e-2, 4e-4, 0.0])
        numbers = [m, printed, weight.sum(), printed / weight.sum(), mean, 0.02, 2]
        assert [float(word) for word in row] == pytest.approx(numbers, rel=1e-4)
    assert ordered == ["ordered", "-0.8", "2"]
    assert lines[7] == "model error of Eq. (3) in random chains: up to 0.02"
    assert len(lines) == 8
    soft = [ensemble(1.0, unit, squeezed=2), ensemble(1.0, unit, squeezed=3)]
    assert seen.table(ORDERED, soft).splitlines()[8].startswith("in 5 chains a contact is so soft")
    monkeypatch.undo()
    narrow = seen.table(ORDERED, soft).splitlines()
    assert max(map(len, narrow)) <= 80
    assert "in 5 chains a contact is so soft that" in "\n".join(narrow)


def test_the_json():
    seen = by_hand(-0.5)
    others = [ensemble(1.0, -0.5, 3e-3, 4), ensemble(-1.0, -0.5)]
    data = seen.to_json(ORDERED, others)
    assert data["velocity_unit_m_per_s"] == -0.5
    assert data["time_s"] == [0.0, 2e-5]
    assert data["tau"] == [0.0, 12.5]
    assert data["kappa"] == pytest.approx(np.arange(1, 7) ** (1 / 3), rel=1e-15)
    assert data["ordered_velocity"] == pytest.approx(-2 * ORDERED, rel=1e-15)
    assert (data["realisations"], data["seed"]) == (30, 17)
    first, _ = data["rows"]
    weight = dyson_weight(np.arange(1, 7) ** (1 / 3), 1)
    printed = weight @ np.array([[1.0, 0, 0, 0, 0, 0], [0.5, 0.25, -0.125, 1e-2, 4e-4, 0.0]]).T
    assert first["m"] == 1
    assert first["as_printed_over_time"] == pytest.approx(printed, rel=1e-13)
    assert first["normalised_over_time"] == pytest.approx(printed / weight.sum(), rel=1e-13)
    chains = first["random_chains"]
    assert chains["mean_velocity"] == [0.25, -0.5, 0.125]
    assert chains["standard_errors"] == [0.01, 0.02, 0.04]
    assert (chains["model_error"], chains["squeezed_chains"]) == (3e-3, 4)


@pytest.mark.parametrize("unit", [1.0, -0.5])
def test_the_picture(unit: float):
    seen = by_hand(unit)
    others = [ensemble(1.0, unit), ensemble(-1.0, unit)]
    axes = seen.plot(ORDERED * unit, others)
    means, terms = axes.figure.axes
    assert means is axes
    shown = r"$v_0$" if unit != 1 else "m/s"
    assert means.get_ylabel() == f"mean velocity ({shown})"
    assert terms.get_ylabel() == rf"$D_m(\kappa_n)\,\dot\varphi_n$ ({shown})"
    assert "Mean over 30 random linear chains, ± 2 standard errors" in means.get_title("left")
    assert "tau = 12.5" in terms.get_title("left")
    ordered, one, other, zero = means.lines
    assert [line.get_label() for line in (ordered, one, other)] == ["ordered", "m = 1", "m = 5"]
    assert ordered.get_xydata() == pytest.approx(
        np.stack((np.arange(1, 7), ORDERED), axis=1), rel=1e-15
    )
    assert one.get_xdata().tolist() == [1, 2, 4]
    assert one.get_ydata().tolist() == [0.25, -0.5, 0.125]
    assert other.get_ydata().tolist() == [-0.25, 0.5, -0.125]
    assert (zero.get_ydata()[0], terms.lines[-1].get_ydata()[0]) == (0, 0)
    band = means.collections[0].get_paths()[0].vertices
    for grain, mean, error in zip([1, 2, 4], [0.25, -0.5, 0.125], [0.01, 0.02, 0.04], strict=True):
        edges = np.unique(band[band[:, 0] == grain, 1].round(12))
        assert edges[[0, -1]] == pytest.approx([mean - 2 * error, mean + 2 * error], rel=1e-9)
    velocity = np.array([0.5, 0.25, -0.125, 1e-2, 4e-4, 0.0])
    for line, m in zip(terms.lines[:2], (1, 5), strict=True):
        weight = dyson_weight(np.arange(1, 7) ** (1 / 3), m)
        assert line.get_xdata().tolist() == [1, 2, 3, 4, 5, 6]
        assert line.get_ydata() == pytest.approx(weight * velocity, rel=1e-13)
        assert line.get_label() == f"m = {m}: sum {weight @ velocity:.4g}"
    assert means.get_xlim() == terms.get_xlim() == (0.5, 6.5)
    assert len({line.get_color() for line in (one, other)}) == 2


def test_the_picture_ends_four_grains_below_the_wave():
    """Grain 40 of 90 is the last that moves by 1e-3 of the largest motion; 44 are shown."""
    size = 90
    wave = np.zeros(size)
    wave[[3, 20, 39, 59]] = 1.0, 0.5, -2e-3, 0.9e-3
    whole = by_hand(1.0)
    kappa = np.ones(size)
    motion = np.stack((wave, wave))
    seen = replace(whole, kappa=kappa, velocity=motion, weight=np.ones((2, size)))
    mine = figure().subplots()
    assert seen.plot(np.zeros(size), [ensemble(1.0, 1.0)] * 2, mine) is mine
    assert mine.get_xlim() == (0.5, 44.5)
    still = replace(seen, velocity=0 * motion)
    axes = still.plot(np.zeros(size), [ensemble(1.0, 1.0)] * 2, figure().subplots())
    assert axes.get_xlim() == (0.5, 90.5)


def test_no_two_of_many_lines_look_alike():
    number = 2 * len(COLOURS) + 2
    seen = by_hand(1.0, tuple(range(1, number + 1)))
    axes = seen.plot(ORDERED, [ensemble(1.0, 1.0)] * number, figure().subplots())
    styles = [(line.get_color(), line.get_linestyle()) for line in axes.lines[1 : number + 1]]
    assert len(set(styles)) == number
    assert [style for _, style in styles[:2]] == ["-", "--"]


def test_orders_that_a_user_writes():
    assert orders("1, 2.5,20 ,1") == [1.0, 2.5, 20.0]
    for text, fault in (
        ("1,two", "m: must be numbers separated by commas"),
        ("1,0", "m: must be above 0 (got 0)"),
        ("-2,3", "m: must be above 0 (got -2)"),
        ("inf", "m: must be above 0 (got inf)"),
        ("nan", "m: must be above 0 (got nan)"),
    ):
        with pytest.raises(InputError) as error:
            orders(text)
        assert fault in str(error.value)
