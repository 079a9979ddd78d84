"""Requests to stop a run: Ctrl-C, SIGTERM and the wall-time limit."""

from __future__ import annotations

import math
import signal
import threading
import time
from typing import Any

from ..errors import InputError, LmpchainError, shown

NAMES = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}


class Stopped(LmpchainError):
    """The run was stopped before its end; `lmpchain.resume` goes on with what its folder holds."""


class Requests:
    """Requests to stop; inside the context, signals do nothing but make one.

    Parameters
    ----------
    max_wall : float, optional
        Time allowed from now on, s.
    """

    def __init__(self, max_wall: float | None):
        if max_wall is not None and not (isinstance(max_wall, int | float) and max_wall > 0):
            raise InputError.at("max_wall", f"must be a time above 0 s (got {shown(max_wall)})")
        self._deadline = time.monotonic() + (math.inf if max_wall is None else max_wall)
        self._before: dict[int, Any] = {}
        self._number: int | None = None

    def __enter__(self) -> Requests:
        if threading.current_thread() is threading.main_thread():
            # signals reach no other
            # handlers that ignore a signal, as of nohup, stay
            handlers = {number: signal.getsignal(number) for number in NAMES}
            self._before = {n: h for n, h in handlers.items() if h not in (signal.SIG_IGN, None)}
            for number in self._before:
                signal.signal(number, self._note)
        return self

    def _note(self, number: int, _: Any) -> None:
        self._number = number

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @property
    def reason(self) -> str:
        """Cause of the request to stop; empty if there is none."""
        if self._number is not None:
            return f"stopped by {NAMES[signal.Signals(self._number)]}"
        return "stopped at the end of its time" if time.monotonic() >= self._deadline else ""

    def pass_on(self) -> None:
        """Raise the signal that came, for the handler outside of the context."""
        if self._number is not None:
            signal.raise_signal(self._number)
