"""Families of periodic orbits, and their picture: energy against frequency."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..theory.bands import Cell, branches, repeating
from ..theory.modes import eigenmodes
from ..util.arrays import Array
from ..util.notebook import Shown
from ..util.plotting import COLOURS, axes_in_units, legend, set_title
from ..util.tabular import NamedColumn, Tabular
from .floquet import Complex
from .orbit import Orbit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKS = {"fold": "o", "period doubling": "s", "Neimark-Sacker": "^", "branch point": "D"}


@dataclass(frozen=True, eq=False)
class Event:
    """A fold or a bifurcation of a family, at one of its orbits.

    Attributes
    ----------
    kind : "fold", "period doubling", "Neimark-Sacker" or "branch point"
        The parameter turns back; a pair of multipliers passes -1; two pairs meet on the unit circle
        and leave it, or come back; a pair passes 1.
    value : float
        Of the parameter.
    orbit : Orbit
    """

    kind: str
    value: float
    orbit: Orbit

    def to_json(self) -> dict[str, Any]:
        """Return the numbers of the event."""
        return {
            "kind": self.kind,
            "value": self.value,
            "period_s": self.orbit.period,
            "energy_J": self.orbit.energy,
        }


@dataclass(frozen=True, eq=False, repr=False)
class Family(Shown, Tabular):
    """Periodic orbits along a parameter, as `follow` returns them.

    Attributes
    ----------
    orbits : tuple of P Orbit
    value : (P,) array
        Of the parameter, in its SI unit.
    parameter : str
    events : tuple of Event
        In their order.
    reached : bool
        Whether the family came to the value asked for.
    ended : str
        Why it did not; empty if it did.
    """

    orbits: tuple[Orbit, ...]
    value: Array
    parameter: str
    events: tuple[Event, ...]
    reached: bool
    ended: str = ""

    def __len__(self) -> int:
        return len(self.orbits)

    def __getitem__(self, number: int) -> Orbit:
        return self.orbits[number]

    @property
    def period(self) -> Array:
        """Periods (P,), s."""
        return np.array([orbit.period for orbit in self.orbits])

    @property
    def energy(self) -> Array:
        """Energies above rest at t = 0, (P,) J."""
        return np.array([orbit.energy for orbit in self.orbits])

    @property
    def multipliers(self) -> Complex:
        """Floquet multipliers, (P, 2M)."""
        return np.array([orbit.multipliers for orbit in self.orbits])

    @property
    def stable(self) -> np.ndarray:
        """Which orbits are stable, (P,) bool."""
        return np.array([orbit.stable for orbit in self.orbits])

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw energy against frequency, unstable orbits dashed, and return the axes.

        Behind them are the linear bands, above them stands why the family ended, if it did before
        the value asked for.
        """
        from matplotlib.ticker import EngFormatter, LogLocator, MaxNLocator, NullFormatter

        ax = axes_in_units(ax, "Hz", "")
        frequency = 1 / self.period
        energy = self.energy
        stable = self.stable
        bands = self._bands()
        for number, (low, high) in enumerate(bands):
            label = "" if number else "linear waves"
            ax.axvspan(low, high, color="0.9", lw=0, zorder=0, label=label)
        # edges of bands so near that the family can be seen beside them
        near = (bands > 0.9 * frequency.min()) & (bands < 1.1 * frequency.max())
        span = np.append(frequency, bands[near])
        colour = COLOURS["native"]
        # an unstable stretch begins at the last stable orbit
        beside = ~stable | np.append(~stable[1:], False)
        for chosen, style, label in ((stable, "-", "stable"), (beside, "--", "unstable")):
            if (chosen & (stable == (style == "-"))).any():
                height = np.where(chosen, energy, np.nan)
                ax.plot(frequency, height, style, marker=".", color=colour, label=label)
        ring: dict[str, Any] = {"color": COLOURS["lammps"], "mfc": "none", "ms": 4.5, "mew": 0.9}
        for kind, mark in MARKS.items():
            events = [event.orbit for event in self.events if event.kind == kind]
            if events:
                x = [1 / orbit.period for orbit in events]
                y = [orbit.energy for orbit in events]
                ax.plot(x, y, mark, label=kind, **ring)
        margin = max(0.08 * np.ptp(span), 1e-3 * span.max())
        limits = span.min() - margin, span.max() + margin
        ax.set(xlabel="frequency", ylabel="energy above rest", xlim=limits, yscale="log")
        ax.xaxis.set_major_locator(MaxNLocator(5))
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(EngFormatter("J"))
        ax.yaxis.set_minor_formatter(NullFormatter())
        if self.ended:
            set_title(ax, self.ended[0].upper() + self.ended[1:])
        # it may lie on a band, whose patch is of its colour
        legend(ax, frameon=True, edgecolor="none", framealpha=1.0)
        return ax

    def _bands(self) -> Array:
        """Return the bands of the linearised chain, (B, 2) Hz.

        A chain that does not repeat has one, from its slowest to its fastest mode.
        """
        chain = self.orbits[0].chain
        if not chain.linearisable:
            return np.zeros((0, 2))
        period = repeating(chain)
        arrays = (chain.masses, chain.linear_stiffness)
        # the period is 1 of a uniform chain, and of one that never repeats
        uniform = all(np.ptp(array) < 1e-9 * array[0] for array in arrays)
        if chain.gravity == 0 and chain.grains > period and (period > 1 or uniform):
            cell = Cell(chain.masses[:period], chain.linear_stiffness[:period])
            edges = branches(cell, [0.0, np.pi]).frequency / (2 * np.pi)
            return np.sort(edges, axis=1)
        modes = eigenmodes(chain).frequency / (2 * np.pi)
        return np.array([[modes[0], modes[-1]]])

    def to_json(self) -> dict[str, Any]:
        """Return the numbers of the family, and the last of its orbits."""
        return {
            "parameter": self.parameter,
            "value": self.value.tolist(),
            "period_s": self.period.tolist(),
            "energy_J": self.energy.tolist(),
            "stable": self.stable.tolist(),
            "events": [event.to_json() for event in self.events],
            "orbit": self.orbits[-1].to_json(),
        }

    def _columns(self) -> Iterator[NamedColumn]:
        yield NamedColumn(self.parameter, "", self.value)
        yield NamedColumn("period", "s", self.period)
        yield NamedColumn("energy", "J", self.energy)
        yield NamedColumn("stable", "", self.stable)
