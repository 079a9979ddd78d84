"""Spreading of energy: ordered chains against Bessel functions, averages against single chains."""

import tracemalloc
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck_in_units
from scipy.special import j0, jv, jvp

from lmpchain import Chain, Displacement, Drive, Impulse, InputError, Scene, simulate
from lmpchain.disorder import disordered, factors, realisation, spreading
from lmpchain.measure.energy import shares

ORDER = 1e26  # All factors are 1 to the last digit.


def scene(
    grains: int = 81, tau: float = 20.0, moved: bool = False, samples: int = 6, **chain: Any
) -> Scene:
    """Return a loaded chain between walls with its middle grain struck or displaced."""
    line = Chain(
        **{"grains": grains, "diameter": 1e-3, "gravity": 0.0, "top_load": 1.0, "top": "wall"}
        | chain
    )
    middle = (grains + 1) // 2
    excitation = (
        Displacement(displacement=1e-12, grain=middle)
        if moved
        else Impulse(velocity=1e-9, grain=middle)
    )
    return scene_of(line, excitation, tau * line.time_scale, samples)


@pytest.mark.parametrize("engine", ["chebyshev", "native"])
def test_an_ordered_chain_that_is_struck(engine):
    """Grain n moves with J_2n(2 tau), so that m2 = tau^2 / 2 + (1 - J_0(4 tau)) / 8."""
    case = scene()
    found = spreading(case, ORDER, 2, 1, engine, tolerance=1e-10)
    tau = case.time / case.chain.time_scale
    moment = tau**2 / 2 + (1 - j0(4 * tau)) / 8
    assert found.second_moment[1:] == pytest.approx(moment[1:], rel=2e-8)
    assert found.second_moment[0] == pytest.approx(0, abs=1e-30)  # Grains squared.
    k = np.arange(-81, 82)  # Even numbers are grains, odd ones contacts.
    energy = jv(k, 2 * tau[:, None]) ** 2
    of_grain = energy[:, 1:-1:2] + (energy[:, 0:-2:2] + energy[:, 2::2]) / 2
    assert found.participation == pytest.approx(1 / (of_grain**2).sum(1), rel=2e-8)
    assert found.profile == pytest.approx(of_grain, rel=0, abs=2e-8)
    assert found.profile.sum(1) == pytest.approx(1, rel=1e-14)
    assert found.growth(case.time[2])[0] == pytest.approx(2, abs=0.01)
    assert found.transmitted[:, -1] == pytest.approx(0, abs=1e-15)


def test_an_ordered_chain_that_is_displaced():
    """Velocities and forces are derivatives of the same Bessel functions."""
    case = scene(moved=True)
    found = spreading(case, ORDER, 1, 1)
    k = np.arange(-81, 82)
    energy = 2 * jvp(k, 2 * (case.time / case.chain.time_scale)[:, None]) ** 2
    of_grain = energy[:, 1:-1:2] + (energy[:, 0:-2:2] + energy[:, 2::2]) / 2
    assert found.second_moment == pytest.approx(of_grain @ np.arange(-40, 41) ** 2, rel=1e-9)
    assert found.participation == pytest.approx(1 / (of_grain**2).sum(1), rel=1e-9)
    assert np.isnan(found.second_moment_error).all()
    assert np.isnan(found.growth(case.time[1])[1])


def power(time: np.ndarray, moment: np.ndarray, begin: float, end: float) -> float:
    """Return the slope of log moment over log time by normal equations, with equal octaves."""
    within = (time >= begin) & (time <= end)
    x = np.log(time[within])
    y = np.log(moment[within])
    weight = np.gradient(x)
    mean = (weight * x).sum() / weight.sum()
    return float((weight * (x - mean) * y).sum() / (weight * (x - mean) ** 2).sum())


@pytest.mark.parametrize("of", ["stiffness", "constant", "mass", "diameter", "youngs_modulus"])
def test_means_and_errors(of):
    """Spreading agrees with the energies of every chain, solved by the nonlinear engine."""
    case = scene(grains=21, tau=6.0)
    count = 19
    found = spreading(case, 6, count, 5, "native", of=of, tolerance=1e-9)
    alone = [
        shares(simulate(realisation(case, 6, 5, i, of=of), "native", 1e-10)).of_grain
        for i in range(count)
    ]
    energy = np.array(alone)
    share = energy / energy.sum(2)[..., None]
    centre = share[:, 0] @ np.arange(21)
    moment = (share * (np.arange(21) - centre[:, None, None]) ** 2).sum(2)
    for name, each in {
        "second_moment": moment,
        "participation": 1 / (share**2).sum(2),
        "transmitted": 1 - np.cumsum(share, 2),
    }.items():
        assert getattr(found, name) == pytest.approx(each.mean(0), rel=1e-6, abs=1e-7)
        assert getattr(found, f"{name}_error") == pytest.approx(
            each.std(0, ddof=1) / np.sqrt(count), rel=1e-5, abs=1e-7
        )
    groups = np.array([moment[first::16].sum(0) for first in range(16)])
    begin = case.time[1]
    end = case.time[4]
    left_out = [power(case.time, groups.sum(0) - group, begin, end) for group in groups]
    error = np.sqrt(15 / 16 * np.square(left_out - np.mean(left_out)).sum())
    exact = power(case.time, moment.mean(0), begin, end), error
    assert found.growth(begin, end) == pytest.approx(exact, rel=1e-4)
    assert found.growth() == found.growth(case.time[1], case.time[-1])
    assert found.growth(begin, end)[0] != pytest.approx(found.growth()[0], rel=1e-3)
    with pytest.raises(InputError, match=r"^start: must leave three samples or more up to the end"):
        found.growth(begin, case.time[2])
    assert found.growth(begin, case.time[3])[1] > 0


def test_a_longer_series_begins_with_the_shorter_one():
    """The third chain has the same steps, also if the step is determined for a batch."""
    case = scene(grains=13, tau=4.0, samples=3, gravity=9.81)
    short, long = (spreading(case, 1, count, 2, "native", tolerance=1e-9) for count in (3, 18))
    assert np.array_equal(short.groups[2], long.groups[2])
    assert not np.array_equal(short.groups[1], long.groups[1])


def test_memory_does_not_grow_with_the_number_of_chains():
    case = scene(grains=401, tau=1.0)
    spreading(case, 3, 2, 1)
    peaks = []
    for count in (16, 64):
        tracemalloc.start()
        spreading(case, 3, count, 1)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


@pytest.mark.parametrize("of", ["mass", "diameter", "youngs_modulus"])
def test_chains_with_random_grains(of):
    odd = (
        {"grain": 5, "diameter": 1.3e-3},
        {"grain": 8, "material": "steel"},
        {"grain": 9, "mass": 2e-6},
    )
    chain = column(12, gravity=0, top_load=1e-3, top="wall", bottom="wall", impurity=odd)
    zeta = factors(30, 12, np.random.default_rng(1))
    drawn = disordered(chain, 30, np.random.default_rng(1), of=of)
    power = {"mass": 1, "diameter": 3, "youngs_modulus": 0}[of]
    assert drawn.masses / chain.masses == pytest.approx(zeta**power, rel=1e-13)
    assert drawn.diameters / chain.diameters == pytest.approx(zeta ** (of == "diameter"), rel=1e-13)
    stiff = chain.by_grain("plane_strain_modulus") * zeta ** (of == "youngs_modulus")
    assert drawn.by_grain("plane_strain_modulus") == pytest.approx(stiff, rel=1e-13)
    radius = drawn.diameters / 2
    expected = 4 / 3 / (1 / stiff[1:] + 1 / stiff[:-1]) / np.sqrt(1 / radius[1:] + 1 / radius[:-1])
    assert drawn.contact_constants == pytest.approx(expected, rel=1e-12)
    walls = 4 / 3 * stiff[[0, -1]] / 2 * np.sqrt(radius[[0, -1]])
    assert drawn.wall_constants == pytest.approx(walls, rel=1e-12)


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: spreading(scene(), 3, 0, 1), "realisations"),
        (lambda: spreading(scene(), 3, "many", 1), "realisations"),  # type: ignore[arg-type]
        (lambda: spreading(None, 3, 2, 1), "scene"),  # type: ignore[arg-type]
        (lambda: spreading(scene(), 3, 2, 1, of="colour"), "of"),
        (lambda: spreading(scene(), 3, 2, 1, "lammps"), "engine"),
        (lambda: spreading(scene(), 3, 2, 1).growth(1.0), "start"),
        (lambda: spreading(scene(), 3, 2, 1).growth(0.0, "1"), "end"),
        (
            lambda: spreading(
                scene(contact_constants=np.full(80, 1e9)), 3, 2, 1, of="youngs_modulus"
            ),
            "contact_constants",
        ),
        (
            lambda: spreading(scene().replace(excitation=Impulse(velocity=0.0)), 3, 2, 1),
            "excitation",
        ),
        (
            lambda: spreading(
                scene().replace(excitation=Drive(amplitude=1e-12, frequency=1e3)), 3, 2, 1
            ),
            "excitation",
        ),
    ],
)
def test_what_is_wrong_is_named(call, key):
    with pytest.raises(InputError, match=f"^{key}:"):
        call()


def test_picture_of_spreading():
    found = spreading(scene(), 3, 5, 1)
    axes = found.plot()
    names = ("second_moment", "participation")
    for line, band, name in zip(axes.lines, axes.collections, names, strict=True):
        mean = getattr(found, name)[1:]
        error = getattr(found, f"{name}_error")[1:]
        assert line.get_xdata().tolist() == found.time[1:].tolist()
        assert line.get_ydata().tolist() == mean.tolist()
        (path,) = band.get_paths()
        last = path.vertices[path.vertices[:, 0] == found.time[-1], 1]
        assert [last.min(), last.max()] == pytest.approx(
            [mean[-1] - 2 * error[-1], mean[-1] + 2 * error[-1]]
        )
    assert [line.get_label() for line in axes.lines] == [
        "second moment (grains²)",
        "participation (grains)",
    ]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time", "mean of 5 chains, m = 3")
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert len(axes.get_legend().get_texts()) == 2
    for count, bands in ((1, 0), (2, 2)):
        found = spreading(scene(), 3, count, 1)
        assert len(found.plot().collections) == bands
        assert np.isnan(found.growth()[1]) == (count == 1)


def test_metadata_of_spreading():
    case = scene(grains=21, tau=3.0)
    found = spreading(case.replace(grains=[1, 2]), 3, 4, 7, of="constant", law="paper")
    assert (found.m, found.seed, found.law, found.of) == (3, 7, "paper", "constant")
    assert (found.engine, found.equation, found.realisations) == ("chebyshev", 3, 4)
    assert found.scene == case.replace(grains="all")
    assert found.transmitted.shape == (6, 21)
    alone = [
        simulate(realisation(case, 3, 7, i, "paper", "constant"), "chebyshev") for i in range(4)
    ]
    assert found.model_error == max(t.error_estimate.model for t in alone)
    largest = max(t.error_estimate.solver for t in alone)
    assert found.solver_error == pytest.approx(largest, rel=0.3)  # Only rounding.
    assert found.squeezed == 0
    assert spreading(struck_in_units(column(40), 1e-6, 2.0, 3), 0.05, 20, 1).squeezed == 20
