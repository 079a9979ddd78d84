"""Measuring how fast the engines are on this machine."""

from __future__ import annotations

import json
import platform
import time
import warnings
from pathlib import Path

from .. import engines
from ..chain.chain import Chain
from ..engines.cost_model import PLAUSIBLE, SHIPPED, cache_file, speeds
from ..scene.excitation import Impulse
from ..scene.scene import Scene
from ..util.files import replacing

REPEATS, TOLERANCE = 5, 1e-9  # of the answers that are timed


def calibrate() -> tuple[Path, float]:
    """Measure how fast the engines are here, and keep it.

    Returns
    -------
    the file, and how long the measurement took, s: some tenths, after kernels are compiled

    Raises
    ------
    OSError
        If it cannot be kept; it is used in this process all the same.
    """

    names = [name for name in engines.LADDER if not engines.get(name).refuses(_scene(2, 1))]
    for name in names:
        _timed(name, 2, 1)  # compiles and imports
    began = time.perf_counter()
    found = {}
    for name in names:
        (small, light), (large, heavy) = (_timed(name, *size) for size in ((2, 1), (60, 40)))
        start, shipped = SHIPPED[name]
        slowness = max((large - small) / (heavy - light), shipped / PLAUSIBLE * 2)
        found[name] = max(small - slowness * light, start / PLAUSIBLE * 2), slowness
    took = time.perf_counter() - began
    known = {**SHIPPED, **found}
    path = cache_file()
    speeds.cache_clear()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as aside:
            aside.write_text(json.dumps({"host": platform.node(), "engines": known}, indent=2) + "\n", encoding="utf-8")
    finally:
        speeds.cache_clear()
    return path, took


def _scene(grains: int, periods: int) -> Scene:
    from ..scene.scene import Scene

    chain = Chain(grains=grains, diameter=1e-3, gravity=0.0, top_load=1e-3)
    return Scene(chain=chain, excitation=Impulse(velocity=1e-12), duration=periods * 10 * chain.time_scale, samples=11)


def _timed(name: str, grains: int, periods: int) -> tuple[float, float]:
    """Return the shortest of some times that an answer takes, s, and what it should on the machine of `SHIPPED`."""
    from ..simulation.api import simulate

    scene, engine = _scene(grains, periods), engines.get(name)
    start, slowness = speeds()[name]
    work = (engine.candidate(scene, TOLERANCE).cost_s - start) / slowness
    times = []
    with warnings.catch_warnings(action="ignore"):
        for _ in range(REPEATS):
            began = time.perf_counter()
            simulate(scene, engine, TOLERANCE)
            times.append(time.perf_counter() - began)
    return min(times), work
