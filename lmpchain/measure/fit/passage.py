"""The front of a wave in any chain: arrival, speed, and largest velocity and force."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...trajectory.trajectory import Trajectory
from ..contact import contacts, known_contacts
from ..front import Front, track
from ..motion import Peaks, peaks
from .table import Fitted, FittedNumber

CONTACTS_AT_ONCE = 500  # Number of contacts whose forces are in memory together.


@dataclass(frozen=True, eq=False, repr=False)
class FrontPassage(Fitted):
    """The front of a wave with the largest velocity and force, without a theory.

    Attributes
    ----------
    front : Front
        Front of the velocity at each grain.
    peaks : Peaks
        Largest speed of each grain.
    contact : int
        Number of the contact with the largest force; -1 if no contact force is known.
    force : float
        Largest force of this contact at the samples, N.
    """

    front: Front
    peaks: Peaks
    contact: int
    force: float

    def rows(self) -> Iterator[FittedNumber]:
        """Yield the arrival and mean speed of the front, the largest velocity and force."""
        front = self.front
        last = front.grain[-1]
        yield FittedNumber(
            "front", f"arrival at grain {last}", front.time[-1], front.time_error[-1], unit="s"
        )
        duration = abs(front.time[-1] - front.time[0])
        if duration > 0:
            speed = (front.depth[-1] - front.depth[0]) / duration
            error = speed * (front.time_error[-1] + front.time_error[0]) / duration
            name = f"mean speed, grains {front.grain[0]} to {last}"
            yield FittedNumber("front", name, speed, error, unit="m/s")
        fastest = int(np.argmax(self.peaks.value))
        yield FittedNumber(
            "front",
            f"largest velocity, grain {self.peaks.grain[fastest]}",
            self.peaks.value[fastest],
            self.peaks.error[fastest],
            unit="m/s",
        )
        if self.contact >= 0:
            name = f"largest sampled force, contact {self.contact}"
            yield FittedNumber("front", name, self.force, unit="N")


def fit_passage(trajectory: Trajectory) -> FrontPassage:
    """Return the arrival and speed of the front, and the largest velocity and force.

    Parameters
    ----------
    trajectory : Trajectory
        Run of any scene, whether struck, forced, driven or damped.

    Returns
    -------
    FrontPassage

    Raises
    ------
    InputError
        If no front passes, or the samples do not resolve it.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=30, diameter=5e-3, gravity=0.0, top_load=10.0)
    >>> push = lmpchain.Force(grain=1, times=[0.0, 1e-5, 2e-5], force=[0.0, 5.0, 0.0])
    >>> scene = lmpchain.Scene(chain=chain, excitation=push, duration=2.5e-4, samples=251)
    >>> found = fit_passage(lmpchain.simulate(scene))
    >>> [row.quantity for row in found.rows()][:2]
    ['arrival at grain 29', 'mean speed, grains 1 to 29']
    """
    front = track(trajectory)
    known = known_contacts(trajectory).tolist()
    contact, force = -1, -math.inf
    for first in range(0, len(known), CONTACTS_AT_ONCE):
        history = contacts(trajectory, known[first : first + CONTACTS_AT_ONCE])
        largest = history.force.max(axis=0)
        place = int(np.argmax(largest))
        if largest[place] > force:
            contact, force = int(history.contact[place]), float(largest[place])
    return FrontPassage(front, peaks(trajectory), contact, force)
