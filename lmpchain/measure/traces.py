"""Traces of a run as measured by instruments: forces, velocities, displacements, energies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ..errors import InputError, shown
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array, check_flags, whole_numbers
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.tabular import NamedColumn, Tabular
from .contact import contacts, sensor, wall_force
from .energy import ledger

__dir__ = listed(__name__)

WALLS = ("wall", "top", "bottom")
# Terms of the energy ledger, J.
ENERGIES = ("kinetic", "total", "drive", "dissipated")
Place = int | Literal["wall", "top", "bottom"]


@dataclass(frozen=True, eq=False, repr=False)
class TraceTable(Shown, Tabular):
    """Traces of one run at the same times, for `to_csv` and `to_dataframe`.

    Attributes
    ----------
    time : (T,) array
        Times, s.
    traces : dict of (T,) arrays
        Traces by names such as force_10, change_force_wall, velocity_5 and energy_total.
    units : dict of str
        Unit of each trace: N, m/s, m or J.
    """

    time: Array
    traces: dict[str, Array]
    units: dict[str, str]

    def _columns(self) -> Iterator[NamedColumn]:
        yield NamedColumn("time", "s", self.time)
        for name, values in self.traces.items():
            yield NamedColumn(name, self.units[name], values)


def gather(
    trajectory: Trajectory,
    *,
    force: Sequence[Place] = (),
    velocity: Sequence[int] = (),
    displacement: Sequence[int] = (),
    energy: bool = False,
    above_rest: bool = False,
) -> TraceTable:
    """Return traces of a run at the chosen grains and walls.

    Parameters
    ----------
    trajectory : Trajectory
    force : sequence of int, "wall", "top" or "bottom"
        Grains and walls; the sensor of a grain measures the mean of its two contact forces. "wall"
        is the bottom wall if there is one, else the top wall; a "fixed" bottom counts as a wall.
    velocity, displacement : sequences of int
        Numbers of recorded grains.
    energy : bool
        Whether to return kinetic energy, total energy, work of a drive and dissipated energy, all
        above rest.
    above_rest : bool
        Whether to subtract the forces at rest, as piezoelectric sensors do and `design.fit`
        requires; the names then begin with ``change_``.

    Returns
    -------
    TraceTable

    Raises
    ------
    InputError
        If a place does not exist or was not recorded, or nothing was chosen.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=8, diameter=5e-3, gravity=0.0, top_load=1.0, bottom="wall")
    >>> strike = lmpchain.Impulse(velocity=0.1)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=3e-5, samples=61)
    >>> table = gather(lmpchain.simulate(scene), force=[4, "wall"], velocity=[5])
    >>> list(table.to_dataframe().columns)
    ['time [s]', 'force_4 [N]', 'force_wall [N]', 'velocity_5 [m/s]']
    >>> f"{table.traces['force_wall'][0]:.3f} N"
    '1.000 N'
    """
    check_flags(energy=energy, above_rest=above_rest)
    traces: dict[str, Array] = {}
    units = {}
    start = "change_" if above_rest else ""
    for place in _as_list(force):
        name = f"{start}force_{place}"
        traces[name] = _force(trajectory, place, above_rest)
        units[name] = "N"
    for field, grains, unit in (
        ("velocity", velocity, "m/s"),
        ("displacement", displacement, "m"),
    ):
        for grain in whole_numbers(_as_list(grains), field):
            name = f"{field}_{grain}"
            column = np.flatnonzero(trajectory.grains == grain)
            if not column.size:
                raise InputError.at(field, f"grain {grain} was not recorded: choose another")
            traces[name] = np.asarray(getattr(trajectory, field)[:, column[0]])
            units[name] = unit
    if energy:
        terms = ledger(trajectory)
        for term in ENERGIES:
            traces[f"energy_{term}"] = getattr(terms, term)
            units[f"energy_{term}"] = "J"
    if not traces:
        raise InputError.at(
            "force", "choose at least one force, velocity or displacement, or the energy"
        )
    return TraceTable(trajectory.time, traces, units)


def _as_list(places: Any) -> list[Any]:
    """Return one place or several as a list."""
    one = isinstance(places, str) or not isinstance(places, Sequence | np.ndarray)
    return [places] if one else list(places)


def _force(trajectory: Trajectory, place: object, above_rest: bool) -> Array:
    """Return the force at a grain or a wall, (T,) N."""
    if isinstance(place, str):
        if place not in WALLS:
            raise InputError.at(
                "force", f"must be grains or {', '.join(WALLS)} (got {shown(place)})"
            )
        return _wall_force(trajectory, place, above_rest)
    grain = int(whole_numbers(place, "force"))
    try:
        signal = sensor(trajectory, grain)
    except InputError as error:
        raise InputError([("force", message) for _, message in error.faults]) from None
    return signal.change if above_rest else signal.force


def _wall_force(trajectory: Trajectory, place: str, above_rest: bool) -> Array:
    """Return the force of a wall, (T,) N."""
    chain = trajectory.scene.chain
    end = place
    if place == "wall":
        end = "top" if chain.bottom == "free" else "bottom"
    force = wall_force(trajectory, "top" if end == "top" else "bottom")
    if not above_rest:
        return force
    # A difference of two forces would lose the digits of a weak wave.
    return contacts(trajectory, [0 if end == "top" else chain.movable]).change[:, 0]
