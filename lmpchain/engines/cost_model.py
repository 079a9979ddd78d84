"""The cost model: expected time of a solution on this machine.

An engine predicts how its work grows with the scene. Two numbers convert work to time: the start-up
time of every answer (`Engine.start_up_s`), and the slowness of this machine relative to the machine
on which the engine was timed, 1 unless it was measured. `lmpchain plan --calibrate` measures both
numbers (`lmpchain.simulation.planner`) and stores them in the user's cache folder. No other
command measures them, because plans should be reproducible. Without a measurement the shipped
numbers are sufficient: where the choice matters, engines differ by factors of ten, and machines by
factors of two.
"""

from __future__ import annotations

import json
import math
import platform
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from time import process_time

from ..errors import LmpchainError

PATIENCE_S = 30.0  # Work with a longer expected time is announced.
# Underestimated work ends after this multiple of its budget of CPU time.
OVERRUN = 2
PLAUSIBLE = 1e4  # Largest plausible factor between this machine and the reference machine.


def seconds(engine: str, start_up_s: float, work_s: float) -> float:
    """Return the expected time of a solution here, s, from its times on the reference machine."""
    start, slowness = speed(engine, start_up_s)
    return start + slowness * work_s


class TooLong(LmpchainError):
    """Raised for work that exceeds the budget of its caller (see `budget`)."""


# Largest expected time of work, s, and the CPU time of this process at which work is stopped, s.
_limits: ContextVar[tuple[float, float]] = ContextVar("limits", default=(math.inf, math.inf))
_announced: ContextVar[bool] = ContextVar("work that the caller has announced", default=False)


@contextmanager
def budget(budget_s: float) -> Iterator[None]:
    """Let `announce` and `check_time` raise `TooLong` for work beyond a time, s.

    Within another budget, the work may use half of the remaining CPU time, so that time remains for
    another attempt with a larger tolerance.
    """
    now = cpu_time()
    left_s = min(OVERRUN * budget_s, (_limits.get()[1] - now) / 2)
    token = _limits.set((min(budget_s, left_s), now + left_s))
    try:
        yield
    finally:
        _limits.reset(token)


def is_long(cost_s: float) -> bool:
    """Return whether work of this time, s, must be announced or exceeds the caller's budget."""
    return cost_s > min(PATIENCE_S, _limits.get()[0])


def announce(cost_s: float, work: str, cure: str, spent_s: float = 0.0) -> None:
    """Warn of long work before it begins, even if other warnings are collected.

    Parameters
    ----------
    cost_s : float
        Expected time of the work, s.
    work, cure : str
        Description of the work and why it takes long; the choice that takes less time.
    spent_s : float
        Time already spent on the same answer, s, which counts towards the budget.

    Raises
    ------
    TooLong
        If the work exceeds a `budget` of the caller.
    """
    check_budget(cost_s + spent_s, work)
    if cost_s > PATIENCE_S and not _announced.get():
        warnings.warn(f"{work} takes about {in_words(cost_s)}: {cure}", stacklevel=4)


@contextmanager
def announced(cost_s: float, work: str, cure: str) -> Iterator[None]:
    """Announce work as a whole and suppress the announcements of its parts."""
    announce(cost_s, work, cure)
    token = _announced.set(True)
    try:
        yield
    finally:
        _announced.reset(token)


def check_budget(cost_s: float, work: str) -> None:
    """Raise `TooLong` if the expected time of work, s, exceeds the budget of the caller."""
    if cost_s > _limits.get()[0]:
        raise TooLong(f"{work} would take about {in_words(cost_s)}")
    check_time()


def check_time() -> None:
    """Raise `TooLong` if the work has taken far more time than its budget."""
    limit_s = _limits.get()[1]
    # Without a budget no clock is read.
    if limit_s < math.inf and cpu_time() > limit_s:
        raise TooLong("the work took far longer than expected")


def cpu_time() -> float:
    """Return the CPU time of this process without compilation, s."""
    from ..util.compilation import compiled_cpu_s

    return process_time() - compiled_cpu_s()


def in_words(time_s: float) -> str:
    """Return a time as text with two digits.

    Examples
    --------
    >>> in_words(45), in_words(700), in_words(1e5)
    ('45 s', '12 minutes', '28 hours')
    """
    size, unit = next(
        (size, unit)
        for size, unit in ((86400, "days"), (3600, "hours"), (60, "minutes"), (0, "s"))
        if time_s >= 2 * size
    )
    number = time_s / (size or 1)
    return f"{number:.0f} {unit}" if number >= 10 else f"{number:.2g} {unit}"


def speed(engine: str, start_up_s: float) -> tuple[float, float]:
    """Return the start-up time, s, and the slowness relative to the reference machine."""
    # An edited or incomplete file must not make an engine the cheapest one forever.
    start, slowness = measured().get(engine, (start_up_s, 1.0))
    plausible = (
        start_up_s / PLAUSIBLE < start < start_up_s * PLAUSIBLE
        and 1 / PLAUSIBLE < slowness < PLAUSIBLE
    )
    return (start, slowness) if plausible else (start_up_s, 1.0)


@cache
def measured() -> Mapping[str, tuple[float, float]]:
    """Return measured start-up times, s, and slownesses of engines on this machine, by name."""
    try:
        table = json.loads(cache_file().read_text(encoding="utf-8"))
        pairs = {
            name: (float(start), float(slowness))
            for name, (start, slowness) in table["engines"].items()
        }
        # Several machines may share a home folder.
        if table["host"] != platform.node():
            return {}
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        # The file is missing, damaged or unreadable.
        return {}
    return pairs


def cache_file() -> Path:
    """Return the file with the measurements of this machine."""
    from platformdirs import user_cache_path

    return user_cache_path("lmpchain") / "speeds.json"
