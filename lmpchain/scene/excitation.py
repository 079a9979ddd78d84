"""How a chain is set in motion."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from pydantic import Field

from ..chain.chain import LARGEST_OVERLAP, Chain
from ..util.arrays import Array
from ..util.validation import NOT_GIVEN, Checked, Positive, Real, Vector, Whole

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


class Excitation(Checked):
    """How the chain is set in motion."""

    kind: ClassVar[str]

    @abstractmethod
    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement (N,) m and velocity (N,) m/s at t = 0, positive downward."""

    @abstractmethod
    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield what this chain, or a scene that lasts so long, does not allow."""

    def largest(self, chain: Chain) -> tuple[Array, Array]:
        """Return the displacement (N,) m and velocity (N,) m/s that it imposes, at their largest."""
        return self.initial(chain)

    @abstractmethod
    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the first and the last grain that it moves."""

    @abstractmethod
    def part(self, first: int, last: int) -> Excitation:
        """Return what it does to the grains of `Chain.part(first, last)`, all that it moves among them."""


Number = Annotated[Whole, Field(ge=1)]


class _OneGrain(Excitation):
    grain: int

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        if self.grain > chain.grains:
            yield "grain", f"there is no grain {self.grain}: the chain has {chain.grains}"
        elif self.grain > chain.movable:
            yield "grain", f"grain {self.grain} is held; choose one of 1 to {chain.movable}"

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the grain that it moves, as the first and the last."""
        return self.grain, self.grain

    def part(self, first: int, last: int) -> Excitation:
        """Return the same with the grain as it is numbered among grains first ... last."""
        return type(self)(**self.given() | {"grain": self.grain - first + 1})

    def _at_grain(self, chain: Chain, value: float) -> Array:
        array = np.zeros(chain.grains)
        array[self.grain - 1] = value
        return array


class Impulse(_OneGrain):
    """A velocity given to one grain, m/s, positive downward.

    Examples
    --------
    >>> Impulse(velocity=8.57e-4).grain
    1
    """

    kind: ClassVar[str] = "impulse"
    velocity: Real
    grain: Number = 1

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        return np.zeros(chain.grains), self._at_grain(chain, self.velocity)


class Displacement(_OneGrain):
    """One grain moved from its equilibrium and let go, m, positive downward."""

    kind: ClassVar[str] = "displacement"
    displacement: Real
    grain: Number = 1

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        return self._at_grain(chain, self.displacement), np.zeros(chain.grains)


class Profile(Excitation):
    """Displacement (N,) m and velocity (N,) m/s of every grain at t = 0; what is left out is zero."""

    kind: ClassVar[str] = "profile"
    displacement: Vector = NOT_GIVEN
    velocity: Vector = NOT_GIVEN

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.displacement is None and self.velocity is None:
            yield "displacement", "give displacement or velocity of every grain, or a file with both"

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield what this chain does not allow."""
        for key in ("displacement", "velocity"):
            value = getattr(self, key)
            if value is None:
                continue
            if len(value) != chain.grains:
                yield key, f"must have one entry a grain, {chain.grains}, not {len(value)}"
            elif chain.bottom == "fixed" and value[-1] != 0:
                yield key, f"must be 0 for grain {chain.grains}, which is held"

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        rest = np.zeros(chain.grains)
        return (
            rest.copy() if self.displacement is None else self.displacement.copy(),
            rest.copy() if self.velocity is None else self.velocity.copy(),
        )

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the first and the last grain that it moves; grain 1 if there is none."""
        moved = np.flatnonzero(np.any(self.initial(chain), axis=0))
        return (int(moved[0]) + 1, int(moved[-1]) + 1) if moved.size else (1, 1)

    def part(self, first: int, last: int) -> Profile:
        """Return the entries of grains first ... last."""
        return Profile(**{key: values[first - 1 : last] for key, values in self.given().items()})


class Drive(Excitation):
    """A motion that grain 1 is made to follow, whatever the chain does; positive downward, from 0 at t = 0.

    Parameters
    ----------
    amplitude, frequency : float
        m and Hz, for ``phi_1 = A sin(2 pi f t)``; or else
    times, displacement : arrays
        s and m: the cubic spline (not-a-knot) through these points; two of them make a piston of constant speed.

    Examples
    --------
    >>> piston = Drive(times=[0, 1e-4], displacement=[0, 1e-6])
    >>> [round(float(x), 9) for x in piston.motion(5e-5)]
    [5e-07, 0.01]
    """

    kind: ClassVar[str] = "drive"
    amplitude: Real = NOT_GIVEN
    frequency: Positive = NOT_GIVEN
    times: Vector = NOT_GIVEN
    displacement: Vector = NOT_GIVEN

    def _faults(self) -> Iterator[tuple[str, str]]:
        harmonic = [self.amplitude is not None, self.frequency is not None]
        sampled = [self.times is not None, self.displacement is not None]
        if not (all(harmonic) and not any(sampled)) and not (all(sampled) and not any(harmonic)):
            yield "amplitude", "give amplitude and frequency, or times and displacement (or a file with both)"
        elif all(sampled):
            if len(self.times) != len(self.displacement) or len(self.times) < 2:
                yield "displacement", f"must have one entry for each of two or more times, not {len(self.displacement)}"
            if self.times[0] != 0 or not (np.diff(self.times) > 1e-12 * self.times[-1]).all():
                yield "times", "must begin with 0 and increase, each by more than 1e-12 of the last"
            if self.displacement[0] != 0:
                yield "displacement", "must begin with 0, where grain 1 rests"

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield what this chain, or a scene that lasts so long, does not allow."""
        if chain.top == "wall":
            yield "kind", 'grain 1 cannot be driven behind a wall: use top = "free"'
        if chain.movable < 2:
            yield "kind", "with grain 1 driven nothing is left to move: use more grains"
        if self.times is not None and self.times[-1] < duration:
            yield "times", f"end at {self.times[-1]:g} s, before the recording does at {duration:g} s"

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        return np.zeros(chain.grains), self._at_top(chain, self.motion(0.0)[1])

    def largest(self, chain: Chain) -> tuple[Array, Array]:
        """Return the largest displacement and speed of grain 1, at its place in (N,) arrays."""
        if self.times is None:
            size, speed = abs(self.amplitude), abs(self.amplitude) * 2 * np.pi * self.frequency
        else:
            dense = np.interp(np.arange(8 * len(self.times)) / 8, np.arange(len(self.times)), self.times)
            size, speed = (np.abs(x).max() for x in self.motion(dense))
        return self._at_top(chain, size), self._at_top(chain, speed)

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return grain 1, as the first and the last."""
        return 1, 1

    def part(self, first: int, last: int) -> Drive:
        """Return the same: it moves grain 1, which must be among the grains."""
        return self

    @staticmethod
    def _at_top(chain: Chain, value: float | Array) -> Array:
        array = np.zeros(chain.grains)
        array[0] = value
        return array

    def motion(self, t: float | Array) -> tuple[Array, Array]:
        """Return displacement, m, and velocity, m/s, of grain 1 at these times, s."""
        t = np.asarray(t, dtype=float)
        if self.times is None:
            omega = 2 * np.pi * self.frequency
            return self.amplitude * np.sin(omega * t), self.amplitude * omega * np.cos(omega * t)
        return self.spline(t), self.spline(t, 1)

    def acceleration(self, t: Array) -> Array:
        """Return the acceleration of grain 1 at these times, m/s2."""
        if self.times is None:
            return -((2 * np.pi * self.frequency) ** 2) * self.motion(t)[0]
        return self.spline(t, 2)

    @cached_property
    def spline(self) -> CubicSpline:
        """The cubic spline of a sampled motion."""
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.times, self.displacement)

    @property
    def smooth(self) -> bool:
        """Whether it has no knots, where the third derivative jumps."""
        return self.times is None or len(self.times) <= 4

    @property
    def fastest(self) -> float:
        """Highest frequency that a step must resolve, rad/s."""
        return float(2 * np.pi * self.frequency if self.times is None else 1 / np.diff(self.times).min())


EXCITATIONS: dict[str, type[Excitation]] = {e.kind: e for e in (Impulse, Displacement, Profile, Drive)}


def first_overlaps(chain: Chain, excitation: Excitation) -> Array:
    """Overlap of every contact at the start, or when its two bodies meet alone, (N+1,) m."""
    contacts = chain.contacts
    (u, _), (_, v) = excitation.initial(chain), excitation.largest(chain)
    inertia = 1 / chain.masses
    inertia[0] *= not isinstance(excitation, Drive)  # what is driven does not give way,
    inertia[chain.movable :] = 0.0  # nor does what is held, or a wall
    inertia = np.concatenate(([0.0], inertia, [0.0]))
    two_body = contacts.collision_overlap(np.maximum(contacts.closer(v), 0.0), inertia[:-1] + inertia[1:])
    return np.maximum(contacts.overlap + contacts.exists * contacts.closer(u), two_body)


def surroundings(chain: Chain, excitation: Excitation) -> tuple[int, Chain, Excitation]:
    """Return what an excitation moves at first, and all that the first push depends on, as a chain of its own.

    Returns
    -------
    number of the first of these grains, these grains as a chain, and the excitation of these
    """
    first, last = excitation.reach(chain)
    first, last = max(1, first - 1), min(chain.grains, last + 2)
    return first, chain.part(first, last), excitation.part(first, last)


def strike_faults(chain: Chain, excitation: Excitation) -> Iterator[tuple[str, str]]:
    """Yield a fault if the excitation squeezes a contact beyond what Hertz's law describes."""
    first, near, strike = surroundings(chain, excitation)
    relative = first_overlaps(near, strike) / near.contact_lengths
    if not relative.max() <= LARGEST_OVERLAP:
        worst = int(relative.argmax())
        key = "displacement" if isinstance(excitation, Displacement) else "velocity"
        yield (
            "kind" if isinstance(excitation, Drive) else key,
            f"squeezes contact {worst + first - 1} to {relative[worst]:.2g} of the diameter, more than "
            f"{LARGEST_OVERLAP:g}: strike more gently",
        )
