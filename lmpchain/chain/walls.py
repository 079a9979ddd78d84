"""Walls at the ends of a chain: what may be said of them, and the constants of their contacts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..util.arrays import Array


def misfits(
    ends: Sequence[str], materials: Sequence[Any], given: Array | None
) -> Iterator[tuple[str, str]]:
    """Yield the faults of materials and constants of walls, top and bottom, where these are the ends."""
    for name, end, material in zip(("top", "bottom"), ends, materials, strict=True):
        if material is not None and end != "wall":
            yield f"{name}_material", f'is that of a wall; there is none unless {name} = "wall"'
    if given is None:
        return
    there = [end == "wall" for end in ends]
    if len(given) != 2 or any(
        k < 0 or (k > 0) != wall for k, wall in zip(given, there, strict=True)
    ):
        yield (
            "wall_constants",
            'must be two, of top and bottom: above 0 where the end is "wall", 0 where it is not',
        )
    elif any(material is not None for material in materials):
        yield (
            "wall_constants",
            "take the place of the materials of the walls: leave one of them out",
        )


def constants(natural: Array, given: Array) -> Array:
    """Return the constants of the contacts with top and bottom wall, (2,) N/m^delta.

    Parameters
    ----------
    natural : (N+1,) array
        Hertz constants of all contacts with a wall at either end.
    given : (N-1,) array
        Those of the contacts between grains, to whose own the walls are in the same proportion.
    """
    return natural[[0, -1]] * (given[[0, -1]] / natural[[1, -2]] if given.size else np.ones(2))
