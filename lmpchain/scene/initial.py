"""Excitations at t = 0: impulse, displacement, profile, packet of linear waves, Riemann problem."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..chain.chain import Chain
from ..errors import InputError
from ..util.arrays import Array
from ..util.validation import NOT_GIVEN, Positive, Real, Vector
from .base import Excitation, Number, OneGrain
from .file_columns import ColumnMeaning
from .trace_file import Measured, Reading, TableFile


class Impulse(OneGrain):
    """A velocity given to one grain, m/s, positive downward.

    Examples
    --------
    >>> Impulse(velocity=8.57e-4).grain
    1
    """

    kind: ClassVar[str] = "impulse"
    strength: ClassVar[tuple[str, ...]] = ("velocity",)
    velocity: Real
    grain: Number = 1

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return the displacement and velocity of every grain at t = 0."""
        return np.zeros(chain.grains), self.at_grain(chain, self.velocity)

    def strongest(self, chain: Chain, duration: float) -> tuple[float, float]:
        """Return the largest displacement, 0 m, and speed of the struck grain, m/s."""
        return 0.0, abs(self.velocity)

    def energy(self, chain: Chain) -> float:
        """Return the kinetic energy of the struck grain, J."""
        return 0.5 * chain.masses.item(self.grain - 1) * self.velocity**2

    @property
    def strike_velocity(self) -> float:
        """Velocity of the struck grain, m/s."""
        return self.velocity

    @property
    def strikes_top(self) -> bool:
        """Whether grain 1 is struck."""
        return self.grain == 1

    @property
    def label(self) -> str:
        """Name and strength of the excitation as text."""
        size = abs(self.velocity)
        factor, unit = (
            (1.0, "m/s") if size >= 1 else (1e3, "mm/s") if size >= 1e-5 else (1e6, "µm/s")
        )
        return f"an {self.kind} of {self.velocity * factor:g} {unit}"


class Displacement(OneGrain):
    """One grain displaced from its equilibrium and released, m, positive downward."""

    kind: ClassVar[str] = "displacement"
    strength: ClassVar[tuple[str, ...]] = ("displacement",)
    displacement: Real
    grain: Number = 1

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return the displacement and velocity of every grain at t = 0."""
        return self.at_grain(chain, self.displacement), np.zeros(chain.grains)


class Profile(Measured):
    """Displacement (N,) m and velocity (N,) m/s of every grain at t = 0, zero by default.

    Parameters
    ----------
    displacement : (N,) array, optional
        Displacements, m.
    velocity : (N,) array, optional
        Velocities, m/s. At least one of the two arrays is required.
    file : path, optional
        A text file with one row for each grain and columns of these names, given in place of
        arrays.
    columns, skip, scale, offset, optional
        Options for reading the file, as in `TableFile`.
    """

    kind: ClassVar[str] = "profile"
    strength: ClassVar[tuple[str, ...]] = ("velocity", "displacement")
    file_kind: ClassVar[type[TableFile]] = TableFile
    displacement: Vector = NOT_GIVEN
    velocity: Vector = NOT_GIVEN
    source: str = NOT_GIVEN

    @classmethod
    def _arrays(cls, file: TableFile) -> tuple[Reading, dict[str, Array]]:
        reading = file.read([ColumnMeaning("displacement", "m"), ColumnMeaning("velocity", "m/s")])
        return reading, dict(zip(reading.names, reading.values.T, strict=True))

    @property
    def fields(self) -> dict[str, Array]:
        """The given arrays by name."""
        arrays = {"displacement": self.displacement, "velocity": self.velocity}
        return {name: values for name, values in arrays.items() if values is not None}

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.displacement is None and self.velocity is None:
            cure = "give displacement or velocity of every grain, or a file with both"
            yield "displacement", cure

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield faults if the arrays do not match the chain."""
        for key, values in self.fields.items():
            if len(values) != chain.grains:
                yield key, f"must have one entry a grain, {chain.grains} in all, not {len(values)}"
            elif chain.bottom == "fixed" and values[-1] != 0:
                yield key, f"must be 0 for grain {chain.grains}, which is held"

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return the displacement and velocity of every grain at t = 0."""
        # The arrays are copied, because a drive overwrites the values of grain 1.
        displacement, velocity = (
            np.zeros(chain.grains) if values is None else values.copy()
            for values in (self.displacement, self.velocity)
        )
        return displacement, velocity

    def __add__(self, other: Profile) -> Profile:
        """Return the sum of two profiles, for example two solitary waves that will collide."""
        if not isinstance(other, Profile):
            return NotImplemented
        given = [*self.fields.values(), *other.fields.values()]
        if len({len(values) for values in given}) > 1:
            raise InputError.at("displacement", "profiles that are added must be of one chain")
        nothing = np.zeros(len(given[0]))

        def add(name: str) -> Array:
            return self.fields.get(name, nothing) + other.fields.get(name, nothing)

        return Profile(displacement=add("displacement"), velocity=add("velocity"))

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the first and the last grain that is moved; grain 1 for an empty profile."""
        moved = np.flatnonzero(np.any(self.initial(chain), axis=0))
        return (int(moved[0]) + 1, int(moved[-1]) + 1) if moved.size else (1, 1)

    def part(self, first: int, last: int) -> Profile:
        """Return the entries of grains first ... last."""
        fields = self.fields.items()
        return self.replace(**{name: values[first - 1 : last] for name, values in fields})


@dataclass(frozen=True)
class Extent:
    """Half lengths of a packet in units of its width.

    Attributes
    ----------
    inside : float
        Half length of the part that must fit into the chain. The envelope at its ends is 1.5e-8 of
        the height.
    cut : float
        Half length at which the packet is truncated.
    """

    inside: float = 6.0
    cut: float = 9.0


EXTENT = Extent()


class Packet(Excitation):
    """A Gaussian packet of linear waves of one frequency that travels downward.

    Velocities of grains and strains of contacts are samples of one wave ``A(x) cos(theta(x))`` at
    integer and half-integer positions. In this alternating row each velocity or strain drives its
    two neighbours, and upgoing and downgoing waves have different wave numbers. The local wave
    number q of each contact is the root of ``w = 2 sqrt(k/m) sin(q/2)``. The amplitude follows
    from a constant energy flow, and the envelope from the travel time (WKB approximation). On a
    uniform chain a small upgoing wave remains: the tails of the Gaussian at q below 0 and above pi,
    with amplitudes of about ``exp(-(q width)^2/2)`` and ``exp(-((pi - q) width)^2/2)``. If
    stiffness and mass vary, the chain also reflects a part of the wave, and variations within a
    wavelength add an error.

    Parameters
    ----------
    frequency : float
        Frequency of the waves, Hz.
    width : float
        Standard deviation of the envelope ``exp(-x^2 / (2 width^2))`` at its centre, in grains.
    grain : int
        Number of the grain at the centre.
    amplitude : float
        Height of the envelope of displacements at its centre, m. The wave itself is 0 there, and
        velocities have their maximum; the largest displacement of a grain may be smaller. Linear
        theory holds if the amplitude is small.

    Examples
    --------
    >>> chain = Chain(grains=200, diameter=1e-3, gravity=0, top_load=1, top="wall", bottom="wall")
    >>> u, v = Packet(frequency=2e4, width=10, grain=80, amplitude=1e-12).initial(chain)
    >>> int(abs(v).argmax()) + 1
    80
    """

    kind: ClassVar[str] = "packet"
    of_chain: ClassVar[bool] = True
    strength: ClassVar[tuple[str, ...]] = ("amplitude",)
    frequency: Positive
    width: Positive
    grain: Number
    amplitude: Real

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield a fault if the packet does not fit into the chain or cannot propagate there."""
        if self.grain > chain.movable:
            yield "grain", f"must be a grain that moves, 1 to {chain.movable} (got {self.grain})"
        elif chain.loose_grains:
            yield "chain.load_grain", f"a packet requires a linear chain, but {chain.loose}"
        elif chain.ground is not None:
            cure = "leave it out, or give a profile"
            yield "chain.ground", f"a packet does not support a force from the ground: {cure}"
        elif not chain.compressed:
            yield "kind", "there are no linear waves without gravity and load: give a top_load"
        else:
            first, last = self._within(chain, EXTENT.inside)
            if first < 1 or last > chain.movable:
                length = f"{EXTENT.inside:g} widths to either side"
                yield "width", f"the packet extends {length} and does not fit into the chain"
                return
            hops = self._hops(chain, first, last)
            # A real wave number exists only below 2 sqrt(k/m), because w = 2 sqrt(k/m) sin(q/2).
            if (2 * np.pi * self.frequency >= 2 * hops).any():
                limit = f"{float(hops.min() / np.pi):.4g} Hz"
                # Each grain has two values: to the contact below, and on to the next grain.
                slowest = first + int(hops.argmin()) // 2
                yield (
                    "frequency",
                    f"must be below the cut-off frequency at grain {slowest}, {limit}",
                )

    def _within(self, chain: Chain, widths: float) -> tuple[int, int]:
        """Return the first and the last grain within a number of widths around the centre."""
        far = int(min(np.ceil(widths * self.width), chain.grains))
        return self.grain - far, self.grain + far

    @staticmethod
    def _hops(chain: Chain, first: int, last: int) -> Array:
        """Return sqrt(k/m), 1/s, from each grain to the contact below, and on to the next grain."""
        k = chain.contacts.stiffness[first:last]
        m = chain.masses[first - 1 : last]
        return np.sqrt(np.column_stack((k / m[:-1], k / m[1:]))).ravel()

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the first and the last grain that the packet moves."""
        first, last = self._within(chain, EXTENT.cut)
        return max(1, first), min(chain.movable, last)

    def part(self, first: int, last: int) -> Packet:
        """Return the packet with its centre renumbered within grains first ... last."""
        return self.replace(grain=self.grain - first + 1)

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return the displacement and velocity of every grain at t = 0."""
        first, last = self.reach(chain)
        omega = 2 * np.pi * self.frequency
        hops = self._hops(chain, first, last)
        # Positions count grains and contacts alternately.
        middle = 2 * (self.grain - first)
        # A turning point is far from the centre, where the packet vanishes, so any real wave number
        # suffices there.
        ratio = np.minimum(omega / (2 * hops), 0.999)
        speed = 2 * hops * np.sqrt(1 - ratio**2)  # Group velocity, positions per second.
        phase = np.append(0.0, np.cumsum(np.arcsin(ratio)))
        arrival = np.append(0.0, np.cumsum(1 / speed))
        # The speed at a position is the geometric mean of the speeds on either side.
        local_speed = np.sqrt(np.append(speed[:1], speed) * np.append(speed, speed[-1:]))
        distance = (arrival - arrival[middle]) * local_speed[middle] / (2 * self.width)
        envelope = np.exp(-(distance**2) / 2)
        # The energy flow, energy density times speed, is constant (WKB).
        flow = chain.masses[self.grain - 1] * local_speed[middle]
        height = self.amplitude * omega * np.sqrt(flow / local_speed)
        wave = height * envelope * np.cos(phase - phase[middle])
        v = wave[::2] / np.sqrt(chain.masses[first - 1 : last])
        strain = wave[1::2] / np.sqrt(chain.contacts.stiffness[first:last])
        # The net strain must be 0, otherwise grains beyond one end would be displaced permanently.
        strain -= strain.sum() * envelope[1::2] / envelope[1::2].sum()
        u = np.append(np.cumsum(strain[::-1])[::-1], 0.0)
        fields = np.zeros((2, chain.grains))
        fields[:, first - 1 : last] = u, v
        return fields[0], fields[1]


class Riemann(Excitation):
    """A step of velocity and compression between two grains at t = 0, from which shocks develop.

    Shock waves and rarefactions propagate from the step to both sides. The ends of the chain are
    held or free and emit waves, too, so place the step far from them. Displacements are summed from
    the bottom: if the strain on the right is 0, grains on the right are not displaced.

    Parameters
    ----------
    velocity : (left, right)
        Velocities of grains 1 ... grain, and of the grains below, m/s; "left" is towards grain 1.
    strain : (left, right)
        Additional overlap of contacts 1 ... grain, and of the contacts below, over the mean
        diameter of the two grains. Positive values are compression. A negative value opens a gap if
        it is larger in magnitude than the overlap at rest over the mean diameter.
    grain : int
        Last grain on the left side; contact ``grain`` below it also belongs to the left side.

    Examples
    --------
    >>> chain = Chain(grains=6, diameter=1e-3, gravity=0, top_load=1)
    >>> step = Riemann(velocity=(0.1, 0), strain=(1e-4, 0), grain=2)
    >>> u, v = step.initial(chain)
    >>> u.round(9).tolist(), v.tolist()
    ([2e-07, 1e-07, 0.0, 0.0, 0.0, 0.0], [0.1, 0.1, 0.0, 0.0, 0.0, 0.0])
    """

    kind: ClassVar[str] = "riemann"
    of_chain: ClassVar[bool] = True
    strength: ClassVar[tuple[str, ...]] = ("velocity", "strain")
    velocity: Vector
    strain: Vector
    grain: Number

    def _faults(self) -> Iterator[tuple[str, str]]:
        for key in self.strength:
            count = len(getattr(self, key))
            if count != 2:
                yield key, f"must have two entries, left and right of the step, not {count}"

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield a fault if no grain is below the step, or if a held grain would move."""
        if self.grain >= chain.grains:
            below = f"the step is below this grain, and the chain has {chain.grains} grains"
            yield "grain", f"must be at most {chain.grains - 1}: {below}"
        elif chain.bottom == "fixed" and self.velocity[1]:
            yield "velocity", f"must be 0 on the right, where grain {chain.grains} is held"

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return the displacement and velocity of every grain at t = 0."""
        left = np.arange(1, chain.grains + 1) <= self.grain
        velocity = np.where(left, self.velocity[0], self.velocity[1])
        strain = np.where(left, self.strain[0], self.strain[1])
        closer = strain * chain.contact_lengths[1:]
        # No contact exists below a held grain or below a free end.
        closer[-1] *= chain.bottom == "wall"
        return np.cumsum(closer[::-1])[::-1].copy(), velocity

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return grain 1, and the last grain that is displaced or moves."""
        return 1, chain.grains if self.strain[1] or self.velocity[1] else self.grain

    def part(self, first: int, last: int) -> Riemann:
        """Return the step renumbered within grains first ... last."""
        return self if first == 1 else self.replace(grain=self.grain - first + 1)
