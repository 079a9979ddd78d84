"""Measure the choice of batches of time averages, and of the first step: BATCHING, ENERGY_ERRORS.

Sequences whose memory is known (autoregressive ones, over 0 to 4 stretches) have an interval or
none: BATCHING.resemblance is supported up to where of those with one 93 in 100 cover, from where
half of those that remember for a tenth of a stretch have one. Beads between walls, struck or with
speeds at random, show the error of the energy: ENERGY_ERRORS are supported within a factor of 4,
for they only set the first step, which is shortened if it is too long.

    python analysis/calibration/batch_means.py           # minutes
    python analysis/calibration/batch_means.py --quick   # seconds
"""

from __future__ import annotations

import math

import numpy as np
from common import Row, changed, command, label, quantile
from scipy.signal import lfilter

from lmpchain import Chain, Impulse, Profile, Scene, averages
from lmpchain.simulation.batch_means import BATCHING, estimate
from lmpchain.simulation.time_averages import ENERGY_ERRORS

THRESHOLDS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
COVERED = 0.93  # Required coverage of 95 % intervals, with scatter and the longest correlations.
PER_STRETCH = 8
FACTOR = 4.0  # Factor by which an energy error that only sets a first step may be wrong.


def sequence(rng: np.random.Generator, stretches: float) -> np.ndarray:
    """Return means over stretches of an AR(1) sequence with this correlation length, (1, S)."""
    memory = math.exp(-1 / (stretches * PER_STRETCH)) if stretches else 0.0
    noise = math.sqrt(1 - memory**2) * rng.normal(size=BATCHING.stretches * PER_STRETCH)
    values, _ = lfilter([1.0], [1.0, -memory], noise, zi=[memory * rng.normal()])
    return values.reshape(1, BATCHING.stretches, PER_STRETCH).mean(-1)


def resemblance(trials: int) -> Row:
    """Return the largest correlation of neighbours for which intervals cover the mean."""
    rng = np.random.default_rng(1)
    memories = rng.choice([0.0, 0.1, 0.3, 0.6, 1.2, 2.0], trials)
    means = [sequence(rng, memory) for memory in memories]
    good = []
    for threshold in THRESHOLDS:
        with changed(BATCHING, resemblance=threshold):
            found = [estimate(row) for row in means]
        known = [abs(each.mean) < each.half_width for each in found if each.batches]
        short = [bool(each.batches) for each, m in zip(found, memories, strict=True) if m == 0.1]
        if np.mean(known) >= COVERED and np.mean(short) >= 0.5:
            good.append(threshold)
    says = f"correlation up to which {100 * COVERED:.0f} % of the intervals of {trials} cover"
    bounds = (min(good), max(good)) if good else (math.nan, math.nan)
    return Row(label(BATCHING, "resemblance"), BATCHING.resemblance, bounds[1], *bounds, says)


def energy_errors(strengths: int) -> list[Row]:
    """Return the energy errors in units of the phase per step."""
    wobble, walk, smooth = [], [], []
    for number in range(strengths):
        grains = (8, 20, 38)[number % 3]
        vacuum = Chain(grains=grains, diameter=6e-3, gravity=0, top="wall", bottom="wall")
        speeds = np.random.default_rng(number).normal(size=grains)
        start = Profile(displacement=np.zeros(grains), velocity=speeds / np.linalg.norm(speeds))
        scene = Scene(chain=vacuum, excitation=start, duration=1e-2)
        for tolerance, sizes in ((1e-2, wobble), (1e-4, walk)):
            time = 1e-2 if sizes is wobble else 0.3
            found = averages(scene, ["kinetic_energy"], time=time, tolerance=tolerance)
            reach = found.step * scene.highest_frequency
            radians = scene.highest_frequency * time
            size = found.energy_error / reach**2
            sizes.append(
                size
                if sizes is wobble
                else max(size - ENERGY_ERRORS.wobble / 2, 0.0) / math.sqrt(radians)
            )
        pressed = vacuum.replace(top_load=10.0)
        gentle = Scene(chain=pressed, excitation=Impulse(velocity=1e-4), duration=1e-2)
        found = averages(gentle, ["kinetic_energy"], tolerance=1e-6)
        smooth.append(found.energy_error / (found.step * gentle.highest_frequency) ** 6)
    rows = []
    for name, sizes in (("wobble", wobble), ("walk", walk), ("smooth", smooth)):
        middle = quantile(sizes, 0.5)
        says = f"median of {len(sizes)} motions, within a factor of {FACTOR:g}"
        shipped = getattr(ENERGY_ERRORS, name)
        bounds = (middle / FACTOR, FACTOR * middle)
        rows.append(Row(label(ENERGY_ERRORS, name), shipped, middle, *bounds, says))
    return rows


def main(quick: bool) -> list[Row]:
    """Return the constants."""
    trials, strengths = (400, 2) if quick else (6000, 12)
    return [resemblance(trials), *energy_errors(strengths)]


if __name__ == "__main__":
    command(main, __doc__)
