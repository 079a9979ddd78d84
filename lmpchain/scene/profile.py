"""Displacement and velocity of every grain at t = 0."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from ..chain.chain import Chain
from ..util.arrays import Array
from ..util.validation import NOT_GIVEN, Vector
from .base import Excitation


class Profile(Excitation):
    """Displacement (N,) m and velocity (N,) m/s of every grain at t = 0, by default zero."""

    kind: ClassVar[str] = "profile"
    strength: ClassVar[tuple[str, ...]] = ("velocity", "displacement")
    columns: ClassVar[dict[str, str]] = {"displacement": "displacement", "velocity": "velocity"}
    displacement: Vector = NOT_GIVEN
    velocity: Vector = NOT_GIVEN

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.displacement is None and self.velocity is None:
            cure = "give displacement or velocity of every grain, or a file with both"
            yield "displacement", cure

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield the faults of arrays that do not fit the chain."""
        for key, values in self.given().items():
            if len(values) != chain.grains:
                yield key, f"must have one entry a grain, {chain.grains}, not {len(values)}"
            elif chain.bottom == "fixed" and values[-1] != 0:
                yield key, f"must be 0 for grain {chain.grains}, which is held"

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        # copies: a drive writes that of grain 1 into them
        displacement, velocity = (
            np.zeros(chain.grains) if values is None else values.copy()
            for values in (self.displacement, self.velocity)
        )
        return displacement, velocity

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the first and the last grain that it moves; grain 1 if there is none."""
        moved = np.flatnonzero(np.any(self.initial(chain), axis=0))
        return (int(moved[0]) + 1, int(moved[-1]) + 1) if moved.size else (1, 1)

    def part(self, first: int, last: int) -> Profile:
        """Return the entries of grains first ... last."""
        return Profile(**{key: values[first - 1 : last] for key, values in self.given().items()})
