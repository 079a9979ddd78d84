"""Families of periodic orbits, and their pictures: energy or response against frequency."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..chain.chain import Chain
from ..errors import InputError
from ..scene.excitation import Force
from ..theory.bands import Cell, branches, repeating
from ..theory.modes import eigenmodes
from ..util.arrays import Array
from ..util.notebook import Shown
from ..util.plotting import COLOURS, Axes, axes_in_units, legend, set_title
from ..util.tabular import NamedColumn, Tabular
from .floquet import Complex
from .orbit import Orbit

SAME = 1e-6  # Relative distance in value, period and energy below which two orbits are equal.
DECADES = 50.0  # Ratio of sizes from which an axis is logarithmic.
MARKS = {"fold": "o", "period doubling": "s", "Neimark-Sacker": "^", "branch point": "D"}


@dataclass(frozen=True, eq=False, repr=False)
class Event(Shown):
    """A fold or a bifurcation of a family, at one of its orbits.

    Attributes
    ----------
    kind : "fold", "period doubling", "Neimark-Sacker" or "branch point"
        At a fold the parameter turns back. At a period doubling a multiplier passes -1. At a
        Neimark-Sacker bifurcation two pairs of multipliers meet on the unit circle and leave it, or
        return to it; in a damped chain a complex pair crosses the circle. At a branch point a
        multiplier passes 1.
    value : float
        Value of the parameter.
    orbit : Orbit
        Orbit just after the event.
    after : int
        Index, from 0, of the last orbit of the family before the event.
    parameter, hold
        Arguments of `follow`.
    """

    kind: str
    value: float
    orbit: Orbit
    after: int = -1
    parameter: str | Callable[[float], Chain] = ""
    hold: str = "period"

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
        Orbits in their order along the family.
    value : (P,) array
        Values of the parameter, in its SI unit.
    parameter : str
        Name of the parameter.
    events : tuple of Event
        Events in their order along the family.
    reached : bool
        Whether the family reached the requested value of the parameter.
    ended : str
        Reason for an early end; empty if the requested value was reached.
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
        """Whether each orbit is stable, (P,) bool."""
        return np.array([orbit.stable for orbit in self.orbits])

    def backwards(self) -> Family:
        """Return the family with its orbits and events in reverse order."""
        last = len(self) - 2
        events = (
            replace(event, after=last - event.after) if event.after >= 0 else event
            for event in self.events[::-1]
        )
        return replace(self, orbits=self.orbits[::-1], value=self.value[::-1], events=tuple(events))

    def join(self, *others: Family) -> Family:
        """Return one family joined from this one and others, each continuing the previous one.

        The common orbit of two successive families is included once. `reached` is true if it is
        true for all families; otherwise `ended` is the reason of the first family that ended early.

        Raises
        ------
        InputError
            If a family has another parameter, or does not begin where the previous family ends.

        Examples
        --------
        >>> lower = orbits.follow(orbit, "energy", 1e-6)                # doctest: +SKIP
        >>> upper = orbits.follow(orbit, "energy", 4e-6)                # doctest: +SKIP
        >>> lower.backwards().join(upper).plot()                        # doctest: +SKIP
        """
        joined = self
        for other in others:
            if other.parameter != self.parameter:
                raise InputError.at(
                    "parameter", f"must be {self.parameter} for all joined families"
                )
            end, start = (
                [f.value[n], f[n].period, f[n].energy] for f, n in ((joined, -1), (other, 0))
            )
            if not np.allclose(start, end, rtol=SAME, atol=0.0):
                raise InputError.at(
                    "others",
                    f"a family that begins at {self.parameter} = {start[0]:g} does not continue "
                    f"one that ends at {end[0]:g}: change their order, or use `backwards()`",
                )
            # Events count the orbits of their own family.
            earlier = len(joined) - 1
            events = (
                replace(event, after=event.after + earlier) if event.after >= 0 else event
                for event in other.events
            )
            joined = replace(
                joined,
                orbits=joined.orbits + other.orbits[1:],
                value=np.append(joined.value, other.value[1:]),
                events=(*joined.events, *events),
                reached=joined.reached and other.reached,
                ended=joined.ended or other.ended,
            )
        return joined

    def plot(self, ax: Axes | None = None, of: str = "") -> Axes:
        """Draw energy against frequency, or the response to a drive, and return the axes.

        Linear bands are shaded. If the family ended early, the title gives the reason. Unstable
        orbits are drawn dashed, or dotted for a driven chain.

        Parameters
        ----------
        ax : Axes, optional
            Axes to draw in; by default the axes of a new figure.
        of : str
            "energy", the default without a drive, or a quantity of `Orbit.response`, by default
            "amplitude". A response is drawn against the frequency of the drive, or against the
            parameter of the family if this frequency is constant.
        """
        from matplotlib.ticker import AutoMinorLocator, MaxNLocator

        driven = self.orbits[0].drive is not None
        of = of or ("amplitude" if driven else "energy")
        by_frequency = not driven or self.parameter in ("period", "drive.frequency")
        events = [event.orbit for event in self.events]
        place = self.value
        event_place = np.array([event.value for event in self.events])
        name = re.sub(r"drive\.(.*)", r"\1 of the drive", self.parameter)
        if by_frequency:
            place = self._frequencies(self.orbits)
            event_place = self._frequencies(events)
            name = "frequency of the drive" if driven else "frequency"
        curve = np.stack((place, self._sizes(self.orbits, of)))
        bifurcations = np.stack((event_place, self._sizes(events, of)))
        label, unit = _label(of)
        ax = axes_in_units(ax, "Hz" if by_frequency else self._unit(), unit)
        span = np.append(place, self._shade_bands(ax, place) if by_frequency else [])
        self._draw_curve(ax, curve, bifurcations, ":" if driven else "--")
        self._mark_events(ax, bifurcations)
        margin = max(0.08 * np.ptp(span), 1e-3 * span.max())
        ax.set(xlabel=name, xlim=(span.min() - margin, span.max() + margin))
        ax.xaxis.set_major_locator(MaxNLocator(5))
        if of == "energy" or (by_frequency and curve[1].max() > DECADES * curve[1].min()):
            self._scale_by_decades(ax, unit)
        else:
            ax.set_ylim(bottom=0.0)
            ax.yaxis.set_minor_locator(AutoMinorLocator())
        ax.set_ylabel(label)
        if self.ended:
            set_title(ax, self.ended[0].upper() + self.ended[1:])
        # The legend may overlap a band, whose patch has the same colour.
        legend(ax, frameon=True, edgecolor="none", framealpha=1.0)
        return ax

    def _shade_bands(self, ax: Axes, place: Array) -> Array:
        """Shade the linear bands, and return the band edges close to the family."""
        bands = self._bands()
        for number, (low, high) in enumerate(bands):
            label = "" if number else "linear waves"
            ax.axvspan(low, high, color="0.9", lw=0, zorder=0, label=label)
        return bands[(bands > 0.9 * place.min()) & (bands < 1.1 * place.max())]

    def _mark_events(self, ax: Axes, places: Array) -> None:
        """Draw events at places and heights (2, E)."""
        ring: dict[str, Any] = {"color": COLOURS["vermilion"], "mfc": "none", "ms": 4.5, "mew": 0.9}
        for kind, mark in MARKS.items():
            events = [number for number, event in enumerate(self.events) if event.kind == kind]
            if events:
                ax.plot(*places[:, events], mark, label=kind, **ring)

    def _draw_curve(self, ax: Axes, curve: Array, events: Array, broken: str) -> None:
        """Draw places and heights of orbits (2, P) and events (2, E); unstable orbits are dashed.

        Pieces of the curve end at events. Without an event, an unstable piece begins at the last
        stable orbit.
        """
        stable = self.stable
        numbers = np.arange(stable.size)
        known = [number for number, event in enumerate(self.events) if event.after >= 0]
        after = np.array([self.events[number].after for number in known], int)
        following = np.append(~stable[1:], False) & ~np.isin(numbers, after)
        both = stable[after] & stable[after + 1]
        order = np.argsort(np.concatenate((numbers, after + 0.5)))
        place, height = np.hstack((curve, events[:, known]))[:, order]
        solid = np.concatenate((stable, stable[after] | stable[after + 1]))[order]
        unstable = np.concatenate((~stable | following, ~both))[order]
        for chosen, some, style, label in (
            (solid, stable.any(), "-", "stable"),
            (unstable, (~stable).any(), broken, "unstable"),
        ):
            if some:
                # Markers would fill the gaps of a dotted line.
                marker = "" if style == ":" else "."
                shown = np.where(chosen, height, np.nan)
                ax.plot(place, shown, style, marker=marker, color=COLOURS["blue"], label=label)

    @staticmethod
    def _scale_by_decades(ax: Axes, unit: str) -> None:
        from matplotlib.ticker import LogLocator

        axes_in_units(ax, "", unit, "y")
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))

    @staticmethod
    def _sizes(orbits: Sequence[Orbit], of: str) -> Array:
        return np.array([o.energy if of == "energy" else o.response(of) for o in orbits])

    @staticmethod
    def _frequencies(orbits: Sequence[Orbit]) -> Array:
        """Return the frequencies of the drives, or of undriven orbits, Hz."""
        return np.array([1 / o.period if o.drive is None else o.drive.frequency for o in orbits])

    def _unit(self) -> str:
        """Return the unit of the parameter."""
        if self.parameter.endswith("amplitude"):
            return "N" if isinstance(self.orbits[0].drive, Force) else "m"
        units = {
            "frequency": "Hz",
            "drag": "1/s",
            "viscoelastic": "s",
            "top_load": "N",
            "gravity": "m/s²",
            "masses": "kg",
            "diameter": "m",
        }
        # An element of an array, such as drag[2], has the unit of the array.
        return units.get(self.parameter.rpartition(".")[2].partition("[")[0], "")

    def _bands(self) -> Array:
        """Return the bands of the linearised chain, (B, 2) Hz.

        A chain without a repeating cell has a single band from its slowest to its fastest mode.
        """
        chain = self.orbits[0].chain
        # The frequencies are those of the chain without damping.
        chain = chain.replace(damping=None) if chain.damped else chain
        if not chain.linearisable:
            return np.zeros((0, 2))
        period = repeating(chain)
        arrays = (chain.masses, chain.linear_stiffness)
        # The period is 1 for a uniform chain, and for a chain without repetition.
        uniform = all(np.ptp(array) < 1e-9 * array[0] for array in arrays)
        if chain.gravity == 0 and chain.grains > period and (period > 1 or uniform):
            cell = Cell(chain.masses[:period], chain.linear_stiffness[:period])
            edges = branches(cell, [0.0, np.pi]).frequency / (2 * np.pi)
            return np.sort(edges, axis=1)
        modes = eigenmodes(chain).frequency / (2 * np.pi)
        return np.array([[modes[0], modes[-1]]])

    def to_json(self) -> dict[str, Any]:
        """Return the numbers of the family and of its last orbit."""
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
        yield NamedColumn(self.parameter, self._unit(), self.value)
        yield NamedColumn("period", "s", self.period)
        yield NamedColumn("energy", "J", self.energy)
        if self.orbits[0].drive is not None:
            yield NamedColumn("amplitude", "m", self._sizes(self.orbits, "amplitude"))
        yield NamedColumn("stable", "", self.stable)


def _label(of: str) -> tuple[str, str]:
    """Return the label and the unit of an axis for a size of orbits."""
    kind, _, number = of.partition(":")
    if not number:
        return ("energy above rest", "J") if of == "energy" else ("largest displacement", "m")
    what, unit = ("force of contact", "N") if kind == "force" else ("displacement of grain", "m")
    return f"{what} {number}, half of its range", unit
