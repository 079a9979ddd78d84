"""Fitted numbers as a table: quantity, value, error, theory and unit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from ...util.notebook import Shown
from ...util.tables import align, number, wrap

TITLES = ("quantity", "value", "error", "theory", "unit")


@dataclass(frozen=True)
class FittedNumber:
    """One fitted number.

    Attributes
    ----------
    fit, quantity, unit : str
        Names of the fit and of the quantity, and the unit.
    value : float
        Fitted value.
    error : float
        Error as defined by the fit; NaN if there is none.
    expected : float
        Value from the scene or theory; NaN if there is no prediction.
    """

    fit: str
    quantity: str
    value: float
    error: float = math.nan
    expected: float = math.nan
    unit: str = ""

    def cells(self) -> tuple[str, str, str, str, str]:
        """Return the quantity, value, error, theory and unit as text."""
        return (
            self.quantity,
            round_to_error(self.value, self.error),
            number(self.error, ".1g"),
            round_to_error(self.expected, self.error),
            self.unit,
        )


class Fitted(Shown):
    """A fit that prints as a table of its numbers."""

    def rows(self) -> Iterator[FittedNumber]:
        """Yield the fitted numbers, with their errors and theoretical values."""
        raise NotImplementedError

    def notes(self) -> Iterator[str]:
        """Yield further remarks, such as excluded grains and the asymptotic law."""
        yield from ()

    def _summary(self) -> Iterator[Sequence[str]]:
        # Notebooks display this table as well.
        yield from table_of(self.rows())

    def table(self) -> str:
        """Return the numbers as text, within 80 columns."""
        return "\n".join([*align(table_of(self.rows())), *wrap(*self.notes())])

    __str__ = table


def table_of(rows: Iterable[FittedNumber]) -> list[Sequence[str]]:
    """Return the cells of a table of numbers without empty columns."""
    cells = [TITLES, *(row.cells() for row in rows)]
    columns = [column for column in zip(*cells, strict=True) if any(column[1:])]
    return list(zip(*columns, strict=True))


def round_to_error(value: float, error: float = math.nan) -> str:
    """Return a number rounded to its significant digits, given its error.

    Examples
    --------
    >>> round_to_error(1.23456789, 0.00234), round_to_error(5.4321, 60.0)
    ('1.2346', '5.4')
    >>> round_to_error(5.4321), round_to_error(math.nan)
    ('5.4321', '')
    """
    if math.isnan(value):
        return ""
    if not error > 0 or not math.isfinite(error) or value == 0:
        # Show six digits if the error is unknown, and two if all or none are significant.
        return f"{value:.6g}" if math.isnan(error) else f"{value:.2g}"
    digits = max(2, min(10, 2 + math.floor(math.log10(abs(value))) - math.floor(math.log10(error))))
    return f"{value:.{digits}g}"
