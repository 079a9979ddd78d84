"""Displacement and velocity of every grain at t = 0."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from ..chain.chain import Chain
from ..errors import InputError
from ..util.arrays import Array
from ..util.validation import NOT_GIVEN, Vector
from .file_columns import ColumnMeaning
from .measured import Measured
from .trace_file import Reading, TableFile


class Profile(Measured):
    """Displacement (N,) m and velocity (N,) m/s of every grain at t = 0, zero by default.

    Parameters
    ----------
    displacement, velocity : (N,) arrays, optional
        m and m/s; one or both of them.
    file : path
        A text file with one row for each grain and columns of these names, given in place of
        arrays.
    columns, skip, scale, offset, optional
        Options of the file, see `TableFile`.
    """

    kind: ClassVar[str] = "profile"
    strength: ClassVar[tuple[str, ...]] = ("velocity", "displacement")
    file_kind: ClassVar[type[TableFile]] = TableFile
    displacement: Vector = NOT_GIVEN
    velocity: Vector = NOT_GIVEN
    source: str = NOT_GIVEN

    @classmethod
    def _arrays(cls, file: TableFile) -> tuple[Reading, dict[str, Array]]:
        reading = file.read([ColumnMeaning("displacement", "m"), ColumnMeaning("velocity", "m/s")])
        return reading, dict(zip(reading.names, reading.values.T, strict=True))

    @property
    def fields(self) -> dict[str, Array]:
        """The given arrays by name."""
        arrays = {"displacement": self.displacement, "velocity": self.velocity}
        return {name: values for name, values in arrays.items() if values is not None}

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.displacement is None and self.velocity is None:
            cure = "give displacement or velocity of every grain, or a file with both"
            yield "displacement", cure

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield a fault if the arrays do not fit the chain."""
        for key, values in self.fields.items():
            if len(values) != chain.grains:
                yield key, f"must have one entry a grain, {chain.grains} in all, not {len(values)}"
            elif chain.bottom == "fixed" and values[-1] != 0:
                yield key, f"must be 0 for grain {chain.grains}, which is held"

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        # The arrays are copied, because a drive overwrites the values of grain 1.
        displacement, velocity = (
            np.zeros(chain.grains) if values is None else values.copy()
            for values in (self.displacement, self.velocity)
        )
        return displacement, velocity

    def __add__(self, other: Profile) -> Profile:
        """Return the sum of two profiles, for example two solitary waves that will collide."""
        if not isinstance(other, Profile):
            return NotImplemented
        given = [*self.fields.values(), *other.fields.values()]
        if len({len(values) for values in given}) > 1:
            raise InputError.at("displacement", "profiles that are added must be of one chain")
        nothing = np.zeros(len(given[0]))

        def add(name: str) -> Array:
            return self.fields.get(name, nothing) + other.fields.get(name, nothing)

        return Profile(displacement=add("displacement"), velocity=add("velocity"))

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the first and the last grain that is moved; grain 1 for an empty profile."""
        moved = np.flatnonzero(np.any(self.initial(chain), axis=0))
        return (int(moved[0]) + 1, int(moved[-1]) + 1) if moved.size else (1, 1)

    def part(self, first: int, last: int) -> Profile:
        """Return the entries of grains first ... last."""
        fields = self.fields.items()
        return self.replace(**{name: values[first - 1 : last] for name, values in fields})
