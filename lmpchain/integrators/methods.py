"""The registry of the methods of time integration."""

from __future__ import annotations

from .damped_verlet import LAGGED
from .dop853 import DormandPrince
from .gear import Gear
from .method import Method
from .splittings import SPLITTINGS

_ALL: tuple[Method, ...] = (*SPLITTINGS.values(), DormandPrince(), Gear(), LAGGED)
BY_NAME = {method.name: method for method in _ALL}
_OF_CHAINS = {
    damped: {method.name: method for method in _ALL if damped in method.damping}
    for damped in (False, True)
}
METHODS = _OF_CHAINS[False]


def methods_of(damped: bool) -> dict[str, Method]:
    """Return the methods that move chains with damping, or without it, by name."""
    return _OF_CHAINS[damped]
