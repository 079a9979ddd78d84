"""When and which grains are recorded."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from ..chain.chain import Chain
from ..errors import shown
from ..util.suggestions import not_among
from ..util.validation import Checked, Positive, Whole


def _selection(value: Any) -> Any:
    """Grains to record: "all", "1:200" or a list of numbers."""
    if isinstance(value, str):
        parts = value.split(":")
        if value != "all" and not (
            len(parts) == 2 and all(p.isascii() and p.isdigit() and len(p) < 19 for p in parts)
        ):
            raise ValueError(
                f'must be "all", a range such as "1:200", or a list of grains (got {shown(value)})'
            )
        return value
    try:
        numbers = [v.item() if isinstance(v, np.generic) else v for v in value]
    except TypeError:
        numbers = []
    if not numbers or any(isinstance(v, bool) or not isinstance(v, int) for v in numbers):
        raise ValueError('must be "all", a range such as "1:200", or a list of grains')
    return tuple(numbers)


# what is gathered of every recorded grain
OF_GRAINS = (
    "peak_displacement",
    "peak_velocity",
    "arrival_time",
)
OF_CONTACTS = ("peak_force", "force")  # and of a contact, as in "force:40"


def contact_of(name: str) -> int | None:
    """Return the contact that a quantity names, 40 of "force:40"; None if it names none."""
    number = name.partition(":")[2]
    plain = number.isascii() and number.isdigit() and str(int(number[:18])) == number
    return int(number) if plain else None


def _asked(value: Any) -> Any:
    """Quantities to gather: names, those of a contact with its number."""
    names = tuple(value) if isinstance(value, list | tuple) else ()
    if not names:
        raise ValueError(
            f'must be a list of names, as ["peak_velocity", "force:40"] (got {shown(value)})'
        )
    for name in names:
        kind = name.partition(":")[0] if isinstance(name, str) else name
        if kind in OF_CONTACTS and contact_of(name) is None:
            raise ValueError(
                f'needs the number of a contact, as in "{kind}:40" (got {shown(name)})'
            )
        if kind not in OF_CONTACTS and name not in OF_GRAINS:
            raise ValueError(not_among(name, (*OF_GRAINS, *(f"{kind}:40" for kind in OF_CONTACTS))))
    if len(set(names)) < len(names):
        raise ValueError("names a quantity twice")
    return names


class Recording(Checked):
    """When and which grains are recorded: `samples` times from 0 to `duration`, both included.

    Besides, `quantities` are gathered all along the run, between the samples too.
    """

    duration: Annotated[Positive, Field(le=1e12)]
    samples: Annotated[Whole, Field(ge=2, le=10**8)] = 101
    grains: Annotated[str | tuple[int, ...], BeforeValidator(_selection)] = "all"
    quantities: Annotated[tuple[str, ...], BeforeValidator(_asked)] = ()

    def faults(self, chain: Chain) -> Iterator[tuple[str, str]]:
        """Yield what this chain does not allow."""
        if self.duration / (self.samples - 1) < sys.float_info.min:
            apart = f"{self.samples} samples in {self.duration:g} s are too close for numbers of full precision"
            yield "duration", f"{apart}: record for longer"
        first, last = self._ends(chain)
        if not 1 <= first <= last <= chain.grains:
            yield (
                "grains",
                f"grains are numbered 1 to {chain.grains} (got {shown(first)} to {shown(last)})",
            )
        elif isinstance(self.grains, tuple) and len(set(self.grains)) < len(self.grains):
            yield "grains", "names a grain twice"
        if self.quantities:
            yield from self._strangers(chain)

    def _strangers(self, chain: Chain) -> Iterator[tuple[str, str]]:
        """Yield the first contact that is asked for and not there."""
        there = np.flatnonzero(chain.contacts.exists)
        if missing := [number for number in self.contacts.values() if number not in there]:
            known = (
                f"the contacts are numbered {there[0]} to {there[-1]}"
                if there.size
                else "there is no contact"
            )
            yield "quantities", f"{known} (got {missing[0]})"

    @property
    def contacts(self) -> dict[str, int]:
        """The contact of each of the quantities that are gathered of one."""
        return {
            name: number for name in self.quantities if (number := contact_of(name)) is not None
        }

    def _ends(self, chain: Chain) -> tuple[int, int]:
        if self.grains == "all":
            return 1, chain.grains
        if isinstance(self.grains, str):
            first, last = self.grains.split(":")
            return int(first), int(last)
        return min(self.grains), max(self.grains)

    def count(self, chain: Chain) -> int:
        """Return how many grains are recorded."""
        first, last = self._ends(chain)
        return len(self.grains) if isinstance(self.grains, tuple) else last - first + 1

    def numbers(self, chain: Chain) -> np.ndarray:
        """Return the recorded grains, (G,) numbers from 1."""
        if isinstance(self.grains, tuple):
            return np.array(self.grains)
        first, last = self._ends(chain)
        return np.arange(first, last + 1)
