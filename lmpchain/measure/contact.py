"""Contact forces, openings, and the forces on walls, drivers and sensors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ..chain.damping import viscous_force
from ..errors import InputError, shown
from ..trajectory.trajectory import Trajectory, scale
from ..util.arrays import Array, whole_numbers
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, draw_map, finish, legend, thin_rows
from ..util.tabular import NamedColumn, Tabular, number_columns
from .bodies import known_contacts, motion
from .motion import OF_DRIVER

__dir__ = listed(__name__)

LINES = 6  # Largest number of contacts drawn as lines; more contacts are drawn as a map.


@dataclass(frozen=True, order=True)
class ContactEvent:
    """An opening or closing of a contact at `time`, s; events sort by time."""

    time: float
    contact: int
    opens: bool


@dataclass(frozen=True, eq=False, repr=False)
class ContactHistory(Shown, Tabular):
    """Overlap and force of C contacts over time.

    Contact n is between grains n and n + 1; contacts 0 and N are those with the walls.

    Attributes
    ----------
    time : (T,) array
        Times, s.
    contact : (C,) array
        Numbers of the contacts.
    overlap : (T, C) array
        Overlaps, m; negative for a gap.
    closing : (T, C) array
        Rates of change of the overlaps, m/s.
    force : (T, C) array
        Forces, N; negative only if a viscous contact is about to open.
    change : (T, C) array
        Forces minus the forces at rest, N, accurate for weak waves as well.
    """

    time: Array
    contact: np.ndarray
    overlap: Array
    closing: Array
    force: Array
    change: Array

    def events(self) -> list[ContactEvent]:
        """Return openings and closings in the order of time.

        The times are roots of the cubic Hermite interpolant of overlap and rate; their error
        decreases with the fourth power of the sampling interval. A contact that touches without
        force counts as closed. If a contact is closed at two successive samples, it has opened in
        between only if the overlap decreases at the first and increases at the second sample. The
        reverse holds for two open samples. Thus neither an overshooting interpolant nor a rounding
        error produces an event.
        """
        events = []
        overlap = self.overlap
        rate = self.closing
        gap = overlap < 0
        changed = gap[1:] != gap[:-1]
        before = overlap[:-1]
        after = overlap[1:]
        # The contact approaches closing or opening, then recedes.
        turned = (before * rate[:-1] < 0) & (after * rate[1:] > 0) & ~changed
        # A cubic polynomial is between the smallest and the largest of its control points.
        third = np.diff(self.time)[:, None] / 3
        crosses_early = before * (before + third * rate[:-1]) <= 0
        crosses_late = after * (after - third * rate[1:]) <= 0
        turned &= crosses_early | crosses_late
        for i, c in np.argwhere(changed | turned):
            pair = slice(i, i + 2)
            cubic = CubicHermiteSpline(self.time[pair], overlap[pair, c], rate[pair, c])
            roots = cubic.roots(extrapolate=False)
            if changed[i, c]:
                # If rounding errors hide the root, use the sample nearer to contact.
                nearer = self.time[i + np.abs(overlap[pair, c]).argmin()]
                roots = roots[:1] if roots.size else [nearer]
            if changed[i, c] or len(roots) == 2:
                # The second of two events between samples reverses the first.
                for time, opens in zip(roots, (not gap[i, c], bool(gap[i, c])), strict=False):
                    events.append(ContactEvent(float(time), int(self.contact[c]), opens))
        return sorted(events)

    def plot(self, ax: Axes | None = None, above_rest: bool = False) -> Axes:
        """Draw the forces over time as lines or, if there are many, as a map; return the axes.

        Parameters
        ----------
        ax : axes, optional
            By default the axes of a new figure.
        above_rest : bool
            Whether to draw the forces minus the forces at rest.
        """
        from matplotlib.ticker import MaxNLocator

        label = "contact force above rest" if above_rest else "contact force"
        ax = chart(ax, "time [s]", f"{label} [N]")
        values = self.change if above_rest else self.force
        if len(self.contact) <= LINES:
            for number, force in zip(self.contact, values.T, strict=True):
                ax.plot(self.time, force, label=f"contact {number}")
            legend(ax)
        else:
            rows = np.argsort(self.contact)
            numbers, force = thin_rows(self.contact[rows], values.T[rows])
            colours: dict[str, Any] = {"cmap": "cividis"}
            if above_rest:
                # Changes have both signs. The colours saturate so that a weak wave remains visible.
                limit = scale(values)
                colours = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit, "extend": "both"}
            draw_map(ax, self.time, numbers, force, f"{label} [N]", **colours)
            ax.yaxis.set_major_formatter("{x:g}")
            ax.yaxis.set_major_locator(MaxNLocator(integer=True))
            ax.set(ylabel="contact, from the top", ylim=ax.get_ylim()[::-1])
        return ax

    def _columns(self) -> Iterator[NamedColumn]:
        yield NamedColumn("time", "s", self.time)
        units = {"overlap": "m", "closing": "m/s", "force": "N", "change": "N"}
        for name, unit in units.items():
            yield from number_columns(f"{name}_contact", unit, self.contact, getattr(self, name))


@dataclass(frozen=True, eq=False, repr=False)
class Signal(Shown, Tabular):
    """The signal of a force sensor inside a grain.

    Attributes
    ----------
    grain : int
        Number of the grain.
    time : (T,) array
        Times, s.
    force : (T,) array
        Mean of the two contact forces of the grain, N.
    change : (T,) array
        This force minus its value at rest, N, as a piezoelectric sensor measures it.
    """

    grain: int
    time: Array
    force: Array
    change: Array

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the force over time; return the axes."""
        ax = chart(ax, "time [s]", "force on the sensor [N]")
        ax.plot(self.time, self.force, label=f"grain {self.grain}")
        return finish(ax)

    def _columns(self) -> Iterator[NamedColumn]:
        yield NamedColumn("time", "s", self.time)
        yield NamedColumn(f"force_{self.grain}", "N", self.force)
        yield NamedColumn(f"change_force_{self.grain}", "N", self.change)


def contacts(trajectory: Trajectory, numbers: Sequence[int] | None = None) -> ContactHistory:
    """Return overlaps and forces of contacts over time.

    Parameters
    ----------
    trajectory : Trajectory
        Run of any engine. Grains that are held at rest need not be recorded.
    numbers : (C,) sequence of int, optional
        Numbers of the contacts; by default all contacts between recorded grains, or between a
        recorded grain and a wall.

    Returns
    -------
    ContactHistory

    Raises
    ------
    InputError
        If a contact does not exist, or its grains were not recorded.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=3, diameter=1e-3)
    >>> strike = lmpchain.Impulse(velocity=1e-2)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=3e-5, samples=51)
    >>> history = contacts(lmpchain.simulate(scene, engine="native"))
    >>> history.contact.tolist(), history.force.shape
    ([1, 2], (51, 2))
    >>> [f"{event.contact} {'opens' if event.opens else 'closes'}" for event in history.events()]
    ['2 opens', '1 opens']
    """
    all_contacts = trajectory.scene.chain.contacts
    if numbers is None:
        chosen = known_contacts(trajectory)
    else:
        chosen = whole_numbers(numbers, "numbers").reshape(-1)
        existing = np.flatnonzero(all_contacts.exists)
        if not np.isin(chosen, existing).all():
            ends = f"{existing[0]} to {existing[-1]}"
            raise InputError.at("numbers", f"the contacts are numbered {ends} (got {numbers})")
    u, v = motion(trajectory, np.stack([chosen, chosen + 1]))
    closer = u[:, 0] - u[:, 1]
    closing = v[:, 0] - v[:, 1]
    law = all_contacts.of(chosen)
    overlap = law.overlap + closer
    viscosity = trajectory.scene.chain.contact_viscosity[chosen]
    viscous = viscous_force(law, viscosity, overlap, closing)
    return ContactHistory(
        time=trajectory.time,
        contact=chosen,
        overlap=overlap,
        closing=closing,
        force=law.force_at(overlap) + viscous,
        # A difference of two forces would lose the digits of a weak wave.
        change=law.force_change(closer) + viscous,
    )


def wall_force(trajectory: Trajectory, end: Literal["top", "bottom"] = "bottom") -> Array:
    """Return the force on the wall or held grain at one end of the chain, (T,) N, at least 0.

    At a wall this is the force of its contact. At a "fixed" bottom it is the force that holds
    grain N: the force of contact N - 1 plus the weight of grain N.

    Parameters
    ----------
    trajectory : Trajectory
    end : "top" or "bottom"

    Returns
    -------
    (T,) array
        N.

    Raises
    ------
    InputError
        If the end is free, the grain that touches the wall was not recorded, or the "fixed" grain
        is driven.
    """
    chain = trajectory.scene.chain
    kind = {"top": chain.top, "bottom": chain.bottom}.get(end, "free")
    if kind == "free":
        raise InputError.at("end", f"there is no wall at the end {shown(end)} of this chain")
    if end == "bottom" and kind == "fixed" and trajectory.scene.excitation.from_below:
        raise InputError.at("end", OF_DRIVER)
    force = contacts(trajectory, [0 if end == "top" else chain.movable]).force[:, 0]
    return force + chain.held_weight if kind == "fixed" else force


def drive_motion(trajectory: Trajectory) -> tuple[Array, Array, Array]:
    """Return the displacement, velocity and acceleration of the driven body, m, m/s, m/s2.

    Parameters
    ----------
    trajectory : Trajectory

    Returns
    -------
    three (T,) arrays
        m, m/s, m/s2.

    Raises
    ------
    InputError
        If nothing is driven.
    """
    drive = trajectory.scene.drive
    if drive is None:
        raise InputError.at("excitation", "nothing is driven in this scene")
    return *drive.motion(trajectory.time), drive.acceleration(trajectory.time)


def drive_force(trajectory: Trajectory) -> Array:
    """Return the force of the driver on the driven end, (T,) N, positive downward.

    On grain 1 the force is m_1 phi_1'' + F_1 - m_1 g without the drag, minus the force of a wall
    above the grain. On the top wall it is the force of the contact. At rest it is the load on the
    driven body, or 0 on grain 1 below a wall. The impulse that starts a motion with nonzero
    velocity at t = 0 is left out.

    A driver below supports the column, so that its force at rest is negative. On the bottom wall it
    is minus the force of the contact; on the last grain it is m_N (phi_N'' - g) - F_(N-1).

    Parameters
    ----------
    trajectory : Trajectory

    Returns
    -------
    (T,) array
        N.

    Raises
    ------
    InputError
        If the chain is not driven, or the grain next to the driven body was not recorded.
    """
    chain = trajectory.scene.chain
    acceleration = drive_motion(trajectory)[2]
    if trajectory.scene.excitation.wall:
        return contacts(trajectory, [0]).force[:, 0]
    if trajectory.scene.excitation.from_below:
        force = -contacts(trajectory, [chain.movable]).force[:, 0]
        held = chain.bottom == "fixed"
        return force + held * (chain.masses[-1] * acceleration - chain.held_weight)
    force = chain.masses[0] * acceleration + contacts(trajectory, [1]).change[:, 0]
    # At rest the wall carries the load, so that the driver exerts no force.
    if chain.top == "wall":
        return force - contacts(trajectory, [0]).change[:, 0]
    return force + (chain.top_load if chain.load_grain == 1 else 0.0)


def force_above_rest(trajectory: Trajectory, body: int) -> Array:
    """Return the force of the driver on a driven body less that at rest, (T,) N.

    The force that accelerates a driven grain is left out.

    Parameters
    ----------
    trajectory : Trajectory
    body : int
        Number of the driven body, as `Drive.body` returns it.

    Returns
    -------
    (T,) array
        N, positive downward.

    Raises
    ------
    InputError
        If a grain that touches the body was not recorded.
    """
    exists = trajectory.scene.chain.contacts.exists
    force = np.zeros(trajectory.time.size)
    if body < exists.size and exists[body]:
        force += contacts(trajectory, [body]).change[:, 0]
    if body and exists[body - 1]:
        force -= contacts(trajectory, [body - 1]).change[:, 0]
    return force


def sensor(trajectory: Trajectory, grain: int) -> Signal:
    """Return the signal of a force sensor inside a grain: the mean of its two contact forces.

    See Job et al., Phys. Rev. Lett. 94, 178002 (2005), and Daraio et al., Phys. Rev. E 73, 026610
    (2006).

    Parameters
    ----------
    trajectory : Trajectory
    grain : int
        Number of the grain, which must be recorded together with both neighbours.

    Returns
    -------
    Signal

    Raises
    ------
    InputError
        If the grain does not have two contacts, or the grain or a neighbour was not recorded.
    """
    exists = trajectory.scene.chain.contacts.exists
    if grain not in np.flatnonzero(exists[:-1] & exists[1:]) + 1:
        raise InputError.at(
            "grain",
            f"grain {grain} does not exist or lacks a contact on one side: choose another",
        )
    both = contacts(trajectory, [grain - 1, grain])
    return Signal(grain, both.time, both.force.mean(1), both.change.mean(1))
