"""The recording of a run: its times, grains and quantities."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from ..chain.chain import Chain
from ..errors import not_among, shown
from ..util.arrays import plain
from ..util.validation import Checked, Positive, Whole


def _selection(value: Any) -> Any:
    """Check grains to record: "all", "1:200" or a list of numbers."""
    cure = 'must be "all", a range such as "1:200", or a list of grains'
    if isinstance(value, str):
        # Numbers with more digits than any chain has grains are rejected.
        if value != "all" and not re.fullmatch("[0-9]{1,18}:[0-9]{1,18}", value):
            raise ValueError(f"{cure} (got {shown(value)})")
        return value
    try:
        numbers = [plain(number) for number in value]
    except TypeError:
        numbers = []
    # True is an integer in Python, but not a grain number.
    if not numbers or any(type(number) is not int for number in numbers):
        raise ValueError(cure)
    return tuple(numbers)


# Quantities that are accumulated for every recorded grain, and for one contact, such as "force:40".
OF_GRAINS = ("peak_displacement", "peak_velocity", "arrival_time")
OF_CONTACTS = ("peak_force", "force")


def contact_of(name: str) -> int | None:
    """Return the contact number in the name of a quantity, 40 for "force:40"; None without one."""
    number = name.partition(":")[2]
    # Only one spelling is allowed, otherwise "force:07" and "force:7" would be two arrays of one
    # contact.
    return int(number) if re.fullmatch("0|[1-9][0-9]{0,17}", number) else None


def _quantities(value: Any) -> Any:
    """Check the names of accumulated quantities, with contact numbers where required."""
    names = tuple(value) if isinstance(value, list | tuple) else ()
    if not names:
        raise ValueError(
            f'must be a list of names, such as ["peak_velocity", "force:40"] (got {shown(value)})'
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
    """Recorded times and grains: `samples` times from 0 to `duration`, both included.

    `quantities` are accumulated during the whole run, also between samples.
    """

    duration: Annotated[Positive, Field(le=1e12)]
    samples: Annotated[Whole, Field(ge=2, le=10**8)] = 101
    grains: Annotated[str | tuple[int, ...], BeforeValidator(_selection)] = "all"
    quantities: Annotated[tuple[str, ...], BeforeValidator(_quantities)] = ()

    def faults(self, chain: Chain) -> Iterator[tuple[str, str]]:
        """Yield the faults of times, grains and contacts for this chain."""
        if self.duration < (self.samples - 1) * sys.float_info.min:
            samples = f"{self.samples} samples in {self.duration:g} s"
            fault = f"{samples} are too close together for double precision"
            yield "duration", f"{fault}: record for longer"
        first, last = self._ends(chain)
        if not 1 <= first <= last <= chain.grains:
            got = f"got {shown(first)} to {shown(last)}"
            yield "grains", f"grains are numbered 1 to {chain.grains} ({got})"
        elif isinstance(self.grains, tuple) and len(set(self.grains)) < len(self.grains):
            yield "grains", "names a grain twice"
        if self.quantities:
            yield from self._contact_faults(chain)

    def _contact_faults(self, chain: Chain) -> Iterator[tuple[str, str]]:
        """Yield requested contacts that the chain does not have, and forces that are not found."""
        existing = np.flatnonzero(chain.contacts.exists)
        if missing := [number for number in self.contacts.values() if number not in existing]:
            numbers = "there is no contact"
            if existing.size:
                numbers = f"the contacts are numbered {existing[0]} to {existing[-1]}"
            yield "quantities", f"{numbers} (got {missing[0]})"
        peaks = [name for name in self.contacts if name.startswith(OF_CONTACTS[0])]
        if peaks and chain.damping.longest_time > 0 and not chain.contact_law.grows:
            cure = f"ask for force:{self.contacts[peaks[0]]}, the force over time"
            fault = "is not found in viscous contacts whose force may decrease with the overlap"
            yield "quantities", f"{peaks[0]} {fault}: {cure}"

    @property
    def contacts(self) -> dict[str, int]:
        """Contact numbers of the quantities that are accumulated for one contact, by name."""
        return {
            name: number for name in self.quantities if (number := contact_of(name)) is not None
        }

    def _ends(self, chain: Chain) -> tuple[int, int]:
        """Return the smallest and the largest number of a recorded grain."""
        if self.grains == "all":
            return 1, chain.grains
        if isinstance(self.grains, str):
            first, last = self.grains.split(":")
            return int(first), int(last)
        return min(self.grains), max(self.grains)

    def count(self, chain: Chain) -> int:
        """Return the number of recorded grains."""
        first, last = self._ends(chain)
        return len(self.grains) if isinstance(self.grains, tuple) else last - first + 1

    def numbers(self, chain: Chain) -> np.ndarray:
        """Return the recorded grains, (G,) numbers from 1."""
        if isinstance(self.grains, tuple):
            return np.array(self.grains)
        first, last = self._ends(chain)
        return np.arange(first, last + 1)
