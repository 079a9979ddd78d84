"""Measure the growth rate of a small change in struck columns, and constants of the solitary wave.

The growth: two native runs that begin 1e-13 apart, in columns of 6 to 40 grains, strike numbers
from MEASURED.opening to MEASURED.flying N and 0.1 to 100 g; decades gained while a pulse runs down
and up are fitted by a (1 - exp(-N / b)). Beyond each of the four ends of that domain the law should
fail: stated is where measured and predicted growth part by more than a factor of two. The solitary
wave: a grain at rest and free at both ends is struck in an unloaded chain; peaks pass far down the
chain.

    python analysis/calibration/predictability.py           # a minute
    python analysis/calibration/predictability.py --quick   # seconds
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from common import Row, command, quantile
from scipy.optimize import curve_fit

from lmpchain import Chain, Impulse, Scene
from lmpchain.engines.native import Native
from lmpchain.errors import ToleranceNotMet
from lmpchain.simulation.api import simulate
from lmpchain.stability.predictability import (
    MEASURED,
    growth,
    growth_rate,
    reflection_time,
)

START, END = 1e-11, 1e-4  # Distances of the runs between which growth is fitted.


def column(
    grains: int, strike_number: float, gravity: float = 9.81, decades: float = 12.0
) -> Scene:
    """Return a struck column whose duration amplifies errors by this many decades, by the law."""
    chain = Chain(grains=grains, diameter=1e-3, gravity=gravity)
    strike = Impulse(velocity=strike_number * chain.length_scale / chain.time_scale)
    scene = Scene(chain=chain, excitation=strike, duration=1e-4, samples=401)
    return Scene(**scene.given() | {"duration": decades / growth_rate(scene)})


def decades(scene: Scene) -> float:
    """Return the growth of a change in decades while a pulse travels down and up."""
    try:
        time, apart = growth(scene, accuracy=1e-9)
    except ToleranceNotMet:
        return math.nan
    apart = np.maximum.accumulate(apart)
    inside = (apart > START) & (apart < END)
    if inside.sum() < 10:
        return 0.0
    return float(np.polyfit(time[inside], np.log10(apart[inside]), 1)[0] * reflection_time(scene))


def law(grains: np.ndarray, most: float, scale: float) -> np.ndarray:
    """Return the number of decades by the law."""
    return most * (1 - np.exp(-grains / scale))


def shipped() -> tuple[float, float]:
    """Return the two numbers of the law in the code, inferred from its results."""
    sizes = np.array([6, 12, 24, 40])
    values = [growth_rate(scene := column(int(n), 100.0)) * reflection_time(scene) for n in sizes]
    found, _ = curve_fit(law, sizes, values, [1.0, 10.0])
    return float(found[0]), float(found[1])


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    rng = np.random.default_rng(71)
    most_scale = shipped()
    sizes = (6, 12, 36) if quick else (6, 8, 10, 14, 20, 28, 40)
    found = []
    for grains in sizes:
        for _ in range(3 if quick else 8):
            number = math.exp(
                rng.uniform(math.log(MEASURED.opening), math.log(MEASURED.flying * grains))
            )
            found.append((grains, decades(column(grains, number, 9.81 * 10 ** rng.uniform(-1, 2)))))
    grains, grown = np.array([pair for pair in found if pair[1] > 0]).T
    (most, scale), spread = curve_fit(
        lambda n, a, b: np.log(law(n, a, b)), grains, np.log(grown), most_scale
    )
    off = np.abs(np.log(grown / law(grains, *most_scale)))
    errors = 2 * np.sqrt(np.diag(spread))
    says = (
        f"{grains.size} columns: within a factor {math.exp(quantile(off, 0.5)):.2g} "
        f"(half), {math.exp(quantile(off, 0.9)):.2g} (9 in 10) of "
        "the law"
    )
    rows = [
        Row(
            "growth_rate: 0.9",
            most_scale[0],
            most,
            most - errors[0],
            most + errors[0],
            f"decades a reflection; {says}",
        ),
        Row(
            "growth_rate: 20",
            most_scale[1],
            scale,
            scale - errors[1],
            scale + errors[1],
            "grains; two standard deviations of the fit",
        ),
    ]
    rows += [
        _end(
            "MEASURED.opening",
            MEASURED.opening,
            (1.0, 3.0, 10.0, 30.0, 100.0),
            lambda x: (column(n, x) for n in (10, 20)),
            False,
        ),
        _end(
            "MEASURED.flying",
            MEASURED.flying,
            (5.0, 15.0, 50.0, 150.0, 500.0),
            lambda x: (column(n, x * n) for n in (10, 20)),
            True,
        ),
        _end(
            "MEASURED.fewest",
            MEASURED.fewest,
            (3.0, 4.0, 6.0, 8.0),
            lambda x: (column(int(x), v) for v in (50.0, 100.0, 200.0)),
            False,
        ),
    ]
    long = (40.0,) if quick else (30.0, 40.0, 60.0)
    rows.append(
        _end(
            "MEASURED.most",
            MEASURED.most,
            long,
            lambda x: (column(int(x), v) for v in (50.0, 500.0)),
            True,
        )
    )
    return rows + _solitary()


def _end(name: str, shipped: float, values: tuple[float, ...], scenes: object, upper: bool) -> Row:
    """Return the row of one end of the law's domain.

    Values for which the law holds within a factor of two.
    """
    ratios = {}
    for value in values:
        made: Iterable[Scene] = scenes(value)  # type: ignore[operator]
        each = [decades(scene) / (growth_rate(scene) * reflection_time(scene)) for scene in made]
        ratios[value] = float(np.median(each))
    good = [value for value, ratio in ratios.items() if 0.5 < ratio < 2]
    listed = ", ".join(f"{value:g}: {ratio:.2f}" for value, ratio in ratios.items())
    best = (max if upper else min)(good, default=math.nan)
    low, high = (
        (min(good, default=math.nan), best) if upper else (best, max(good, default=math.nan))
    )
    return Row(name, shipped, best, low, high, f"growth over that of the law: {listed}")


def _solitary() -> list[Row]:
    """Return the rows of the solitary wave, in an unloaded chain of 80 grains struck at one end."""
    grains = (60, 70)
    velocity = 0.01
    chain = Chain(grains=100, diameter=1e-3, gravity=0.0, bottom="free")
    gamma = float(chain.contact_constants[0] / chain.masses[0])
    guess = gamma**0.4 * velocity**0.2  # Approximate speed in grains per second.
    scene = Scene(
        chain=chain,
        excitation=Impulse(velocity=velocity),
        duration=95 / guess,
        samples=8001,
        grains=grains,
    )
    run = simulate(scene, Native(), 1e-10)
    peaks = [_peak(run.time, run.velocity[:, column]) for column in (0, 1)]
    speed = (grains[1] - grains[0]) / (peaks[1][0] - peaks[0][0])
    height = peaks[1][1] / velocity
    # The law is reflection_time = 2 N / (a gamma^0.4 (b v)^0.2), so that only a b^0.2 can be
    # inferred.
    short = Chain(grains=10, diameter=1e-3)
    here = Scene(chain=short, excitation=Impulse(velocity=velocity), duration=1e-4, samples=2)
    constant = (
        2
        * 10
        / reflection_time(here)
        / (short.contact_constants[0] / short.masses[0]) ** 0.4
        / velocity**0.2
    )
    both = speed / gamma**0.4 / velocity**0.2
    wave = speed / gamma**0.4 / peaks[1][1] ** 0.2
    says = f"0.907470 0.681632^(1/5); alone {wave:.6f} and {height:.6f}"
    return [
        Row(
            "reflection_time: 0.907470, 0.681632",
            float(constant),
            both,
            0.9999 * both,
            1.0001 * both,
            says,
        )
    ]


def _peak(time: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Return the time and height of the largest value, by a parabola."""
    place = int(np.argmax(values))
    before, here, after = values[place - 1 : place + 2]
    shift = (before - after) / (before - 2 * here + after) / 2
    return float(time[place] + shift * (time[1] - time[0])), float(
        here - (before - after) * shift / 4
    )


if __name__ == "__main__":
    command(main, __doc__)
