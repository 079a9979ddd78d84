"""Units: those of table headers, such as `CH1 (mV)` or `t / ms`, and the unit styles of LAMMPS."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from ..errors import InputError, not_among, shown

PREFIXES = {
    "": 1.0,
    "p": 1e-12,
    "n": 1e-9,
    "u": 1e-6,
    # Micro sign and Greek letter.
    "\u00b5": 1e-6,
    "\u03bc": 1e-6,
    "m": 1e-3,
    "k": 1e3,
}
SPELT = {"": 1.0, "nano": 1e-9, "micro": 1e-6, "milli": 1e-3, "kilo": 1e3}
WORDS = {"second": "s", "sec": "s", "volt": "V", "newton": "N", "metre": "m", "meter": "m"}
BRACKETS = re.compile(r"(.*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]")
IN_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]*?)\s*[\])]")
FIELD_UNITS = {"velocity": "m/s", "displacement": "m", "force": "N", "contact": "N"}
# Without brackets, a unit must be a known one.
OTHER_FORMS = [
    re.compile(form) for form in (r"(.*)\bin (\S+)", r"(.+?)\s*/\s*(\S+)", r"(.+)_(\w{1,2})")
]


class Unit(NamedTuple):
    """A unit as a multiple (`factor`) of an SI unit or of the volt (`base`)."""

    base: str
    factor: float


KNOWN_UNITS = {
    prefix + base: Unit(base, factor)
    for base in ("s", "V", "N", "m", "m/s")
    for prefix, factor in PREFIXES.items()
}
# Some oscilloscopes write units in this form.
KNOWN_UNITS |= {f"{prefix}sec": Unit("s", factor) for prefix, factor in PREFIXES.items()}
KNOWN_UNITS |= {"S": KNOWN_UNITS["s"], "v": KNOWN_UNITS["V"]}
KNOWN_UNITS |= {
    prefix + word + plural: Unit(base, factor)
    for word, base in WORDS.items()
    for prefix, factor in SPELT.items()
    for plural in ("", "s")
}


def unit_of(text: str) -> Unit | None:
    """Return the unit that a text names; None if it names no unit.

    Examples
    --------
    >>> unit_of("ms"), unit_of("Volts"), unit_of("counts")
    (Unit(base='s', factor=0.001), Unit(base='V', factor=1.0), None)
    """
    # Symbols are case-sensitive.
    return KNOWN_UNITS.get(text) or (KNOWN_UNITS.get(text.lower()) if len(text) > 2 else None)


def split_unit(cell: str) -> tuple[str, str]:
    """Return the name and the unit in a header cell; either may be empty.

    Examples
    --------
    >>> split_unit("time [us]"), split_unit("C1 in V"), split_unit("CH1")
    (('time', 'us'), ('C1', 'V'), ('CH1', ''))
    >>> split_unit("Second"), split_unit("Voltage")
    (('Second', 'Second'), ('Voltage', 'V'))
    >>> split_unit("hammer [mV] (trigger)"), split_unit("hammer (trigger)")
    (('hammer (trigger)', 'mV'), ('hammer', 'trigger'))
    """
    if match := BRACKETS.fullmatch(cell):
        # A remark in brackets must not hide a unit, so the last brackets with a unit are used.
        known = [found for found in IN_BRACKETS.finditer(cell) if unit_of(found[1])]
        if not known:
            name, unit = split_unit(match[1])
            return (f"{name} ({match[2]})", unit) if unit_of(unit) else (match[1], match[2])
        before, after = cell[: known[-1].start()].strip(), cell[known[-1].end() :].strip()
        return f"{before} {after}".strip(), known[-1][1]
    for form in OTHER_FORMS:
        if (match := form.fullmatch(cell)) and unit_of(match[2]):
            return match[1].strip(), match[2]
    # The column has the name of its unit; N may be a number.
    if cell.lower().startswith("volt") or (unit_of(cell) and len(cell) > 1):
        return cell, "V" if cell.lower() == "voltage" else cell
    return cell, ""


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
