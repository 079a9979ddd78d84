"""The unit styles of LAMMPS in SI units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from ..errors import InputError, shown
from .suggestions import not_among


class Units(NamedTuple):
    """Units of LAMMPS in SI units."""

    length: float
    time: float
    mass: float
    velocity: float

    @property
    def force(self) -> float:
        """Unit of force, N, in styles where it follows from mass, length and time."""
        return self.mass * self.length / self.time**2

    @property
    def pressure(self) -> float:
        """Unit of pressure, Pa, in these styles."""
        return self.force / self.length**2


MOLE = 6.02214076e23
BOHR = 5.29177210903e-11  # Bohr radius, m.
# Styles of the LAMMPS command `units`; lj has no scale.
STYLES = {
    "si": Units(1.0, 1.0, 1.0, 1.0),
    "cgs": Units(1e-2, 1.0, 1e-3, 1e-2),
    "micro": Units(1e-6, 1e-6, 1e-15, 1.0),
    "nano": Units(1e-9, 1e-9, 1e-21, 1.0),
    "real": Units(1e-10, 1e-15, 1e-3 / MOLE, 1e5),
    "metal": Units(1e-10, 1e-12, 1e-3 / MOLE, 1e2),
    "electron": Units(BOHR, 1e-15, 1e-3 / MOLE, BOHR / 1.03275e-15),
}
# Styles whose units of force and pressure follow from those of mass, length and time.
CONSISTENT = ("si", "cgs", "micro", "nano")


def read_units(units: str | Sequence[float] | None, said: str = "") -> Units:
    """Return the units of a dump, from the user's choice or from the dump.

    Raises
    ------
    InputError
        If the choice and the dump differ, or if the style is lj, which has no scale.
    """
    scales: Any = units
    if isinstance(units, str):
        words = units.split(",")
        scales = words if len(words) == 3 else None
    if scales is not None:
        try:
            length, time, mass = (float(scale) for scale in scales)
            if not (min(length, time, mass) > 0 and max(length, time, mass) < math.inf):
                raise ValueError
        except (TypeError, ValueError):
            fault = "must be a unit style of LAMMPS, or the units of length, time and mass"
            raise InputError.at(
                "units", f"{fault} in m, s and kg, above 0 (got {shown(units)})"
            ) from None
        return Units(length, time, mass, length / time)
    name = units or said or "si"
    if name == "lj":
        fault = "lj has no scale: give its units of length, time and mass in m, s and kg"
        raise InputError.at("units", f"{fault}, such as 1e-3,1e-6,1e-9")
    if name not in STYLES:
        raise InputError.at("units", not_among(name, ("lj", *STYLES)))
    if said and said != name:
        raise InputError.at("units", f"{name} contradicts ITEM: UNITS of the dump, {said}")
    return STYLES[name]
