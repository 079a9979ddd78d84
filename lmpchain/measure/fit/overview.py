"""Front of a wave in any chain, and a summary of all fits of the theory to a trajectory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any

import numpy as np

from ...errors import InputError
from ...trajectory.trajectory import Trajectory
from ...util.notebook import Shown
from ...util.tables import align, finite, wrap
from ..contact import contacts, known_contacts
from ..front import Front, track
from ..motion import Peaks, peaks
from .column import fit_continuum, fit_exponents
from .solitary import fit_soliton
from .table import TITLES, Fitted, FittedNumber
from .waves import ModeFit, fit_bessel, fit_modes

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
        # A wave from the middle or the bottom also goes up: its longest way counts.
        first = int(np.argmin(front.time))
        last = 0 if 2 * first >= front.grain.size else front.grain.size - 1
        name = f"arrival at grain {front.grain[last]}"
        yield FittedNumber("front", name, front.time[last], front.time_error[last], unit="s")
        duration = front.time[last] - front.time[first]
        if duration > 0:
            speed = abs(front.depth[last] - front.depth[first]) / duration
            error = speed * (front.time_error[last] + front.time_error[first]) / duration
            name = f"mean speed, grains {front.grain[first]} to {front.grain[last]}"
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


# Strike number up to which linear theory has errors of about 1 % in peak velocities.
WEAK_STRIKE = 0.3  # See analysis/calibration/fit_thresholds.py.
MOST_MODES = 3000  # Largest number of grains for which computing all eigenmodes takes only seconds.


@dataclass(frozen=True, repr=False)
class Summary(Shown):
    """All fits that apply to a trajectory.

    Attributes
    ----------
    strike_number : float
        Strike number of the scene.
    rows : tuple of FittedNumber
        Fitted numbers of all fits.
    left_out : tuple of (fit, reason)
        Fits that do not apply, with the reasons.
    notes : tuple of str
        Remarks of the fits, such as excluded grains and asymptotic laws.
    """

    strike_number: float
    rows: tuple[FittedNumber, ...]
    left_out: tuple[tuple[str, str], ...]
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the rows for a JSON file; numbers that are not finite become None."""
        return finite({"strike_number": self.strike_number}) | {
            "rows": [finite(asdict(row)) for row in self.rows],
            "notes": list(self.notes),
            "left_out": [{"fit": fit, "reason": reason} for fit, reason in self.left_out],
        }

    def cells(self) -> Iterator[Sequence[str]]:
        """Yield the rows of the table as text, titles first."""
        yield "fit", *TITLES
        for _, rows in groupby(self.rows, key=lambda row: row.fit):
            for first, row in enumerate(rows):
                yield "" if first else row.fit, *row.cells()

    _summary = cells

    def table(self) -> str:
        """Return the numbers as text, within 80 columns."""
        lines = align(self.cells()) if self.rows else []
        lines += wrap(*self.notes, *self._brief_reasons())
        remark = (
            ""
            if self.strike_number <= WEAK_STRIKE
            else ", so linear theory is not expected to hold"
        )
        return "\n".join([*lines, f"strike number {self.strike_number:.3g}{remark}"])

    __str__ = table

    def _brief_reasons(self) -> Iterator[str]:
        """Yield the main reason why fits are left out, one line for all fits that share it."""
        names: dict[str, list[str]] = {}
        for fit, reason in self.left_out:
            names.setdefault(reason.partition("; ")[0], []).append(fit)
        for reason, fits in names.items():
            yield f"left out: {', '.join(fits)} ({reason})"


def summary(trajectory: Trajectory) -> Summary:
    """Apply every suitable fit to a trajectory.

    Parameters
    ----------
    trajectory : Trajectory
        Run of any engine, or a trajectory that was read from a dump.

    Returns
    -------
    Summary
        Fitted numbers, and the reasons why other fits were left out.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=30, diameter=1e-3, gravity=0.0, top_load=0.1)
    >>> duration = 20 * chain.time_scale
    >>> strike = lmpchain.Impulse(velocity=1e-7)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=duration)
    >>> fits = summary(lmpchain.simulate(scene, engine="native"))
    >>> sorted({row.fit for row in fits.rows}), [fit for fit, _ in fits.left_out]
    (['bessel', 'front', 'modes'], ['continuum', 'exponents', 'soliton'])
    """
    rows: list[FittedNumber] = []
    notes: list[str] = []
    left_out = []
    fits: dict[str, Callable[[Trajectory], Fitted]] = {
        "front": fit_passage,
        "modes": _modes,
        "bessel": fit_bessel,
        "continuum": fit_continuum,
        "exponents": fit_exponents,
        "soliton": fit_soliton,
    }
    for name, make in fits.items():
        try:
            fit = make(trajectory)
        except InputError as error:
            left_out.append((name, "; ".join(f"{key}: {message}" for key, message in error.faults)))
            continue
        rows += fit.rows()
        notes += [f"{name}: {note}" for note in fit.notes()]
    strike = float(trajectory.scene.strike_number)
    return Summary(strike, tuple(rows), tuple(left_out), tuple(notes))


def _modes(trajectory: Trajectory) -> ModeFit:
    if trajectory.scene.chain.movable > MOST_MODES:
        raise InputError.at("grains", f"more than {MOST_MODES} take long: call fit_modes directly")
    fit = fit_modes(trajectory)
    if not fit.energy.any():
        raise InputError.at("excitation", "nothing moves")
    return fit
