"""The registry of the methods of time integration."""

from __future__ import annotations

from .dop853 import DormandPrince
from .gear import Gear
from .method import Method
from .splittings import SPLITTINGS

_ALL: tuple[Method, ...] = (*SPLITTINGS.values(), DormandPrince(), Gear())
METHODS = {method.name: method for method in _ALL}
