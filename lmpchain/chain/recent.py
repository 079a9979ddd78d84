"""Chains of equal grains that were made lately: loops that make one again for every strike derive its arrays once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .chain import Chain

KEPT = 16  # chains
OF_GRAINS = "density", "youngs_modulus", "poissons_ratio"
OF_CHAIN = "grains", "diameter", "gravity", "exponent", "top_load", "top", "bottom"

_recent: dict[tuple[Any, ...], Chain] = {}  # the latest one last


def made_before(chain: Chain) -> Chain:
    """Return the first chain made lately with the fields of this one, of equal grains and with walls like them.

    Chains never change, and neither do their arrays. That is this chain itself if there is no other.
    """
    key = *(getattr(chain.material, name) for name in OF_GRAINS), *(getattr(chain, name) for name in OF_CHAIN)
    first = _recent[key] = _recent.pop(key, chain)
    if len(_recent) > KEPT:
        _recent.pop(next(iter(_recent)), None)
    return first
