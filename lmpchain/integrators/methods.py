"""The registry of the methods of time integration."""

from __future__ import annotations

from .damped_verlet import LAGGED, MODIFIED
from .dop853 import DormandPrince
from .gear import Gear
from .method import Method
from .splittings import SPLITTINGS

_DOP853 = DormandPrince()
_ALL: tuple[Method, ...] = (*SPLITTINGS.values(), _DOP853, Gear())
METHODS = {method.name: method for method in _ALL}
# of chains that lose energy, as they are asked for: forces that depend on velocities take others
DAMPED: dict[str, Method] = {_DOP853.name: _DOP853, "verlet": MODIFIED, LAGGED.name: LAGGED}
# of all chains, by the name that an answer states
BY_NAME = METHODS | {method.name: method for method in DAMPED.values()}


def methods_of(damped: bool) -> dict[str, Method]:
    """Return the methods of chains with or without damping, as they are asked for."""
    return DAMPED if damped else METHODS
