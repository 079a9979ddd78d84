"""What a sweep can keep of each scene: the whole trajectory, or a few numbers read off it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array


class Quantity(NamedTuple):
    """Something read off a trajectory: its dimensions, unit and name, and how."""

    dimensions: tuple[str, ...]
    units: str
    long_name: str
    measure: Callable[[Trajectory], Array]


def _arrival_time(trajectory: Trajectory) -> Array:
    from ..measure.front import track

    front = track(trajectory)
    times = dict(zip(front.grain.tolist(), front.time, strict=True))
    return np.array([times.get(grain, np.nan) for grain in trajectory.grains.tolist()])


def _wall_force(trajectory: Trajectory) -> Array:
    from ..measure.contact import wall_force

    return wall_force(trajectory).max()


def _energy(which: str) -> Callable[[Trajectory], Array]:
    def measure(trajectory: Trajectory) -> Array:
        from ..measure.energy import shares

        energy = shares(trajectory)
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
        ("time", "grain"), "m", "displacement from equilibrium, positive downward", lambda t: t.displacement
    ),
    "velocity": Quantity(("time", "grain"), "m s-1", "velocity, downward", lambda t: t.velocity),
    "peak_displacement": Quantity(
        ("grain",), "m", "largest size of the displacement in any sample", lambda t: np.abs(t.displacement).max(0)
    ),
    "peak_velocity": Quantity(
        ("grain",), "m s-1", "largest size of the velocity in any sample", lambda t: np.abs(t.velocity).max(0)
    ),
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
        (), "N", "largest force on what holds the bottom, in any sample (measure.contact.wall_force)", _wall_force
    ),
}
