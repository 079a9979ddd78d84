"""Measure the error of the motion between samples.

SHAPE.safety, RESOLVED and RESOLVED_BY_DIFFERENCES.

Random scenes of all kinds are answered to 1e-9 with so many samples that nothing is hidden between
them. Of these, every k-th is left, omega h being between 0.3 and 12, and what is then read off (the
largest displacement and speed of every grain, arrival, height and width of the front, the largest
force on the bottom) is compared with what the dense samples show. The true error over the claimed
one must be below 3 always, and below 1 in all but one of a hundred scenes; each constant is varied,
and the interval is that in which it is so.

    python analysis/calibration/between_samples.py           # ten seconds
    python analysis/calibration/between_samples.py --quick   # a few seconds
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from unittest import mock

import numpy as np
from common import ALL_BUT_ONE, Row, command
from scenes import draw

from lmpchain import LmpchainError, Scene, Trajectory, simulate
from lmpchain.measure import motion
from lmpchain.measure.motion import Motion
from lmpchain.trajectory.between.hermite import SHAPE

DENSE = 0.12  # Value of omega h of the reference.
TOLERANCE = 1e-9
FRACTION = 0.5


def trials(count: int, seed: int) -> Iterator[tuple[Trajectory, Trajectory]]:
    """Yield trajectories with many samples, and the same trajectories with few samples."""
    rng = np.random.default_rng(seed)
    found = 0
    while found < count:
        scene = draw(rng, grains=(2, 3, 5, 12, 30), spans=(2.0, 20.0))
        swift = scene.highest_frequency * scene.duration
        few = max(1, round(swift / 10 ** rng.uniform(-0.5, 1.08)))
        every = math.ceil(swift / few / DENSE)
        if few * every > 4000:
            continue
        dense = Scene(**scene.given() | {"samples": few * every + 1})
        try:
            with warnings.catch_warnings(action="ignore"):
                many = simulate(dense, "native", TOLERANCE)
        except LmpchainError:
            continue
        found += 1
        yield many, thin_rows(many, every)


def thin_rows(trajectory: Trajectory, every: int) -> Trajectory:
    """Return the trajectory with every n-th sample."""
    time = trajectory.time[::every]
    scene = Scene(**trajectory.scene.given() | {"samples": time.size})
    u = trajectory.displacement[::every]
    v = trajectory.velocity[::every]
    return replace(trajectory, scene=scene, time=time, displacement=u, velocity=v)


def read_off(t: Trajectory, equation: int = 1) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return quantities interpolated from a trajectory and their error bounds, by name."""
    between = Motion(
        t.scene, equation, t.grains, t.displacement, t.velocity, t.error_estimate.total
    )
    front = between.fronts("velocity", FRACTION)
    found = {f"peak {field}": between.peaks(field)[1:] for field in ("displacement", "velocity")}
    found |= {
        name: (front[:, k], front[:, k + 3])
        for k, name in enumerate(("arrival", "height", "width"))
    }
    if t.scene.chain.bottom != "free":
        forces = (np.atleast_1d(value) for value in between.largest_wall_force())
        found["force"] = tuple(forces)  # type: ignore[assignment]
    return found


def ratios(many: Trajectory, few: Trajectory, equation: int = 1) -> dict[str, float]:
    """Return the largest ratio of true and stated error of every quantity."""
    true = read_off(many, equation=1)
    seen = read_off(few, equation)
    worst = {}
    for name, (value, claimed) in seen.items():
        size = np.abs(true[name][0])
        off = np.abs(np.abs(value) - size) - true[name][1]
        known = np.isfinite(off) & (off > 1e-12 * np.nanmax(size, initial=0.0))
        worst[name] = float(np.max(off[known] / np.maximum(claimed[known], 1e-300), initial=0.0))
    return worst


def main(quick: bool) -> list[Row]:
    """Return the rows of the table."""
    pairs = list(trials(30 if quick else 400, seed=5))
    rows = []
    for name, module, equation, values in (
        ("RESOLVED", motion, 1, (1.0, 2.0, 3.0, 4.0, 6.0)),
        ("RESOLVED_BY_DIFFERENCES", motion, 0, (0.4, 0.7, 1.0, 1.5, 2.5)),
    ):
        shipped = float(getattr(module, name))
        holds = []
        for value in values:
            with mock.patch.object(module, name, value):
                worst = np.array([max(ratios(*pair, equation).values()) for pair in pairs])
            low = (worst > 1).mean()
            above = worst.max()
            says = f"{value:g}: {100 * low:.2g} % above 1, worst {above:.2g}"
            holds.append((value, low <= 0.01 and above <= 3, says))
        good = [value for value, fine, _ in holds if fine]
        told = "true over claimed errors; " + ", ".join(says for _, _, says in holds)
        rows.append(Row(name, shipped, max(good, default=0.0), 0.0, max(good, default=0.0), told))
    worst = np.array([max(ratios(*pair).values()) for pair in pairs])
    least = SHAPE.safety * max(float(np.quantile(worst, ALL_BUT_ONE)), float(worst.max()) / 3)
    seen = f"median {np.median(worst):.2g}, worst {worst.max():.2g}"
    told = f"factor on the misfit of the way; true over claimed errors: {seen}"
    return [*rows, Row("SHAPE.safety", SHAPE.safety, least, least, math.inf, told)]


if __name__ == "__main__":
    command(main, __doc__)
