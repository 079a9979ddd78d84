"""How fast each engine is on this machine, so that the cheapest one can be told beforehand.

An engine knows how its work grows with the scene; two numbers turn that into time: what every answer takes, and how
many times slower the machine is than the one on which the engine was timed. `calibrate` measures both, once, when a
user asks for it (`lmpchain plan --calibrate`), and keeps them in the user's cache folder; never by itself, since a run
should take the time that it takes, and planning should be reproducible. Without it the shipped numbers serve: engines
differ by factors of ten where the choice matters, machines by two.
"""

from __future__ import annotations

import json
import math
import platform
import time
import warnings
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from ..files import replacing

if TYPE_CHECKING:
    from ..scene import Scene

SHIPPED = {  # s for every answer, and the slowness
    "native": (8e-4, 1.0),
    "lammps": (7e-2, 1.0),
    "modes": (3e-4, 1.0),
    "chebyshev": (2e-4, 1.0),
    "bessel": (3e-4, 1.0),
    "continuum": (3e-4, 1.0),
}
REPEATS, TOLERANCE = 5, 1e-9  # of the answers that are timed
PLAUSIBLE = 1e4  # largest factor between a machine and the one of the shipped numbers


def seconds(engine: str, work: float) -> float:
    """Return how long an answer takes on this machine, s, from its time on the machine of the shipped numbers."""
    start, slowness = speeds().get(engine, (0.0, 1.0))
    return start + slowness * work


@cache
def speeds() -> Mapping[str, tuple[float, float]]:
    """Return the kept numbers of this machine over the shipped ones."""
    try:
        kept = json.loads(cache_file().read_text(encoding="utf-8"))
        found = {name: (float(pair[0]), float(pair[1])) for name, pair in kept["engines"].items() if name in SHIPPED}
        here = kept["host"] == platform.node()  # a home folder may be that of many machines
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):  # none, damaged, out of reach
        return SHIPPED
    sound = all(_plausible(pair, SHIPPED[name]) for name, pair in found.items())
    return {**SHIPPED, **found} if here and sound else SHIPPED


def _plausible(pair: tuple[float, float], shipped: tuple[float, float]) -> bool:
    return all(math.isfinite(x) and y / PLAUSIBLE < x < y * PLAUSIBLE for x, y in zip(pair, shipped, strict=True))


def cache_file() -> Path:
    """Return where the numbers of this machine are kept."""
    from platformdirs import user_cache_path

    return user_cache_path("lmpchain") / "speeds.json"


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
    from .. import engines

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
    from ..chain import Chain
    from ..excitation import Impulse
    from ..scene import Scene

    chain = Chain(grains=grains, diameter=1e-3, gravity=0.0, top_load=1e-3)
    return Scene(chain=chain, excitation=Impulse(velocity=1e-12), duration=periods * 10 * chain.time_scale, samples=11)


def _timed(name: str, grains: int, periods: int) -> tuple[float, float]:
    """Return the shortest of some times that an answer takes, s, and what it should on the machine of `SHIPPED`."""
    from .. import engines
    from ..simulation import simulate

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
