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
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass

SHIPPED = {  # s for every answer, and the slowness
    "native": (8e-4, 1.0),
    "lammps": (7e-2, 1.0),
    "modes": (3e-4, 1.0),
    "chebyshev": (2e-4, 1.0),
    "bessel": (3e-4, 1.0),
    "continuum": (3e-4, 1.0),
}
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
