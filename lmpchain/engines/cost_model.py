"""The cost model: how long an answer is expected to take on this machine.

An engine knows how its work grows with the scene; two numbers turn that into time: what every
answer takes (`Engine.start_up_s`), and how many times slower this machine is than the one on which
the engine was timed, 1 unless it was measured. `lmpchain.simulation.calibration` measures both,
once, when a user asks for it (`lmpchain plan --calibrate`), and keeps them in the user's cache
folder; never by itself, since planning should be reproducible. Without it the shipped numbers
serve: engines differ by factors of ten where the choice matters, machines by two.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from ..util.remarks import warn

PATIENCE_S = 60.0  # of work that is announced
PLAUSIBLE = 1e4  # largest factor between a machine and the one of the shipped numbers


def seconds(engine: str, start_up_s: float, work_s: float) -> float:
    """Return the expected time of an answer here, s, from its times on the reference machine."""
    start, slowness = speed(engine, start_up_s)
    return start + slowness * work_s


def announce(cost_s: float, work: str, keeps: str = ", a folder keeps what is done") -> None:
    """Warn of work that takes minutes, before it begins; `keeps` says what is not lost if stopped.

    Parameters
    ----------
    cost_s : float
        s.
    work, keeps : str
    """
    if cost_s > PATIENCE_S:
        cure = f"a shorter duration or a larger tolerance takes less{keeps}"
        warn(f"{work} takes some {cost_s / 60:.2g} minutes: {cure}", stacklevel=4)


def speed(engine: str, start_up_s: float) -> tuple[float, float]:
    """Return start-up time, s, and slowness over the reference machine, measured or as shipped."""
    # a file that was edited or half written must not make an engine the cheapest for ever
    start, slowness = measured().get(engine, (start_up_s, 1.0))
    plausible = (
        start_up_s / PLAUSIBLE < start < start_up_s * PLAUSIBLE
        and 1 / PLAUSIBLE < slowness < PLAUSIBLE
    )
    return (start, slowness) if plausible else (start_up_s, 1.0)


@cache
def measured() -> Mapping[str, tuple[float, float]]:
    """Return start-up time, s, and slowness of engines as measured on this machine, by name."""
    try:
        table = json.loads(cache_file().read_text(encoding="utf-8"))
        pairs = {
            name: (float(start), float(slowness))
            for name, (start, slowness) in table["engines"].items()
        }
        # a home folder may be that of many machines
        if table["host"] != platform.node():
            return {}
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        # none, damaged, out of reach
        return {}
    return pairs


def cache_file() -> Path:
    """Return where the numbers of this machine are kept."""
    from platformdirs import user_cache_path

    return user_cache_path("lmpchain") / "speeds.json"
