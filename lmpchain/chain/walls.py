"""Walls at the ends of a chain: which materials and constants they may have."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from ..util.arrays import Array


def misfits(
    ends: Sequence[str], materials: Sequence[Any], constants: Array | None
) -> Iterator[tuple[str, str]]:
    """Yield the faults of materials and constants of the walls at these ends."""
    for name, end, material in zip(("top", "bottom"), ends, materials, strict=True):
        if material is not None and end != "wall":
            yield f"{name}_material", f'is that of a wall; there is none unless {name} = "wall"'
    if constants is None:
        return
    if len(constants) != 2 or any(
        k < 0 or (k > 0) != (end == "wall") for k, end in zip(constants, ends, strict=True)
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
