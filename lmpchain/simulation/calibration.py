"""Measurement of the speed of the engines on this machine, for the cost model."""

from __future__ import annotations

import json
import platform
import time
from pathlib import Path

from .. import engines
from ..chain.chain import Chain
from ..engines.base import Engine
from ..engines.cost_model import PLAUSIBLE, cache_file, measured, speed
from ..scene.excitation import Impulse
from ..scene.scene import Scene
from ..util.files import replacing
from ..util.remarks import warnings_aside
from .api import simulate

REPEATS = 5  # Number of timed repetitions of each solution.


def calibrate() -> tuple[Path, float]:
    """Measure the speed of the engines on this machine, and store it.

    Returns
    -------
    path : Path
        File in which the speeds are stored.
    took : float
        Time of the measurement, s: a few tenths of a second after the kernels are compiled.

    Raises
    ------
    OSError
        If the result cannot be stored. It is then lost, and the earlier speeds stay in use.
    """
    # Number of grains, and duration in tens of time units.
    small = 2, 1
    large = 60, 40
    timed = [
        engine
        for engine in map(engines.get, engines.automatic())
        if not engine.refuses(_scene(*small))
    ]
    for engine in timed:
        _time(engine, *small)  # Compilation and imports happen in this first call.
    began = time.perf_counter()
    speeds = {}
    for engine in timed:
        (short, light), (long, heavy) = (_time(engine, *size) for size in (small, large))
        slowness = max((long - short) / (heavy - light), 2 / PLAUSIBLE)
        speeds[engine.name] = (
            max(short - slowness * light, 2 * engine.start_up_s / PLAUSIBLE),
            slowness,
        )
    took = time.perf_counter() - began
    # Engines that were not timed keep the results of an earlier measurement.
    speeds = dict(measured()) | speeds
    path = cache_file()
    measured.cache_clear()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as aside:
            aside.write_text(
                json.dumps({"host": platform.node(), "engines": speeds}, indent=2) + "\n",
                encoding="utf-8",
            )
    finally:
        measured.cache_clear()
    return path, took


def _scene(grains: int, periods: int) -> Scene:
    chain = Chain(grains=grains, diameter=1e-3, gravity=0.0, top_load=1e-3)
    return Scene(
        chain=chain,
        excitation=Impulse(velocity=1e-12),
        duration=periods * 10 * chain.time_scale,
        samples=11,
    )


def _time(engine: Engine, grains: int, periods: int) -> tuple[float, float]:
    """Return the shortest time of a solution, s, and its work on the reference machine, s."""
    scene = _scene(grains, periods)
    start, slowness = speed(engine.name, engine.start_up_s)
    work = (engine.propose(engine.part(scene), 1e-9).cost_s - start) / slowness
    times = []
    with warnings_aside():
        for _ in range(REPEATS):
            began = time.perf_counter()
            simulate(scene, engine, 1e-9)
            times.append(time.perf_counter() - began)
    return min(times), work
