"""What a sweep can keep of each scene: its motion, or numbers read off it with their errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from ..measure.motion import Motion
from ..util.arrays import Array

FRACTION = 0.5  # of the largest speed of a grain that the front has at least, as in measure.front.track


class Quantity(NamedTuple):
    """Something read off a motion: its dimensions, unit and name, and how it and its error are found."""

    dimensions: tuple[str, ...]
    units: str
    long_name: str
    measure: Callable[[Motion], tuple[Array, Array] | Array]

    @property
    def whole(self) -> bool:
        """Whether it is the recorded motion itself, with the error of the trajectory and no other."""
        return "time" in self.dimensions


def _arrival_time(motion: Motion) -> tuple[Array, Array]:
    rows = motion.fronts("velocity", FRACTION, width=False)
    return rows[:, 0], rows[:, 3]


def _peak_displacement(motion: Motion) -> tuple[Array, Array]:
    return motion.peaks("displacement")[1:]


def _peak_velocity(motion: Motion) -> tuple[Array, Array]:
    return motion.peaks("velocity")[1:]


def _wall_force(motion: Motion) -> tuple[Array, Array]:
    force, error = motion.largest_wall_force()
    return np.array(force), np.array(error)


def _energy(which: str) -> Callable[[Motion], Array]:
    def measure(motion: Motion) -> Array:
        from ..measure.energy import shares

        energy = shares(motion)
        if which == "all":
            return energy.kinetic.sum(1) + energy.elastic.sum(1)
        if which == "grain":
            return energy.of_grain
        below = np.full(energy.kinetic.shape, np.nan)
        there = np.isin(energy.grain, energy.contact)
        places = {number: place for place, number in enumerate(energy.contact.tolist())}
        below[:, there] = energy.elastic[:, [places[number] for number in energy.grain[there].tolist()]]
        return below

    return measure


QUANTITIES = {
    "displacement": Quantity(
        ("time", "grain"), "m", "displacement from equilibrium, positive downward", lambda m: m.displacement
    ),
    "velocity": Quantity(("time", "grain"), "m s-1", "velocity, downward", lambda m: m.velocity),
    "peak_displacement": Quantity(("grain",), "m", "largest size of the displacement at any time", _peak_displacement),
    "peak_velocity": Quantity(("grain",), "m s-1", "largest size of the velocity at any time", _peak_velocity),
    "arrival_time": Quantity(
        ("grain",), "s", "when the front passes, by the velocity (measure.front.track)", _arrival_time
    ),
    "energy": Quantity(
        ("time",), "J", "energy above rest of the recorded grains and the contacts between them", _energy("all")
    ),
    "grain_energy": Quantity(
        ("time", "grain"),
        "J",
        "energy above rest of a grain and its share of contacts (measure.energy.shares)",
        _energy("grain"),
    ),
    "contact_energy": Quantity(
        ("time", "grain"), "J", "energy above rest of the contact below a grain; NaN if unknown", _energy("contact")
    ),
    "wall_force": Quantity(
        (), "N", "largest force on what holds the bottom, at any time (measure.contact.wall_force)", _wall_force
    ),
}


def measured(motion: Motion, keep: Iterable[str], grains: np.ndarray) -> dict[str, Array]:
    """Return what is kept of a motion, by name, at these of its grains; errors under the name with _error."""
    rows = motion.rows(grains)
    found: dict[str, Array] = {}
    for name in keep:
        quantity = QUANTITIES[name]
        values = quantity.measure(motion)
        for key, each in zip((name, f"{name}_error"), values if isinstance(values, tuple) else (values,), strict=False):
            found[key] = each[..., rows] if "grain" in quantity.dimensions else each
    return found
