"""How a chain is set in motion: at t = 0, or by what acts on it afterwards."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from pydantic import Field

from ..chain.chain import Chain
from ..util.arrays import Array
from ..util.validation import NOT_GIVEN, Positive, Real, Vector, Whole
from .base import Excitation, Push

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Number = Annotated[Whole, Field(ge=1)]


class _OneGrain(Excitation):
    """An excitation of one grain, to be chosen."""

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
        return self.replace(grain=self.grain - first + 1)

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
    strength: ClassVar[tuple[str, ...]] = ("velocity",)
    velocity: Real
    grain: Number = 1

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        return np.zeros(chain.grains), self._at_grain(chain, self.velocity)

    @property
    def strike_velocity(self) -> float:
        """Velocity of the grain that is struck, m/s."""
        return self.velocity

    @property
    def strikes_top(self) -> bool:
        """Whether it is grain 1 that is struck."""
        return self.grain == 1

    @property
    def label(self) -> str:
        """Its name and how strong it is."""
        return f"an {self.kind} of {self.velocity * 1e3:g} mm/s"


class Displacement(_OneGrain):
    """One grain moved from its equilibrium and let go, m, positive downward."""

    kind: ClassVar[str] = "displacement"
    strength: ClassVar[tuple[str, ...]] = ("displacement",)
    displacement: Real
    grain: Number = 1

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        return self._at_grain(chain, self.displacement), np.zeros(chain.grains)


class Profile(Excitation):
    """Displacement (N,) m and velocity (N,) m/s of every grain at t = 0; what is left out is zero."""

    kind: ClassVar[str] = "profile"
    strength: ClassVar[tuple[str, ...]] = ("velocity", "displacement")
    columns: ClassVar[dict[str, str]] = {"displacement": "displacement", "velocity": "velocity"}
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
    """A prescribed motion of grain 1, whatever the chain does; positive downward, from 0 at t = 0.

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
    strength: ClassVar[tuple[str, ...]] = ("amplitude", "displacement")
    columns: ClassVar[dict[str, str]] = {"time": "times", "displacement": "displacement"}
    does_work: ClassVar[bool] = True
    driven: ClassVar[int] = 1
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

    @property
    def linear(self) -> bool:
        """Whether it is harmonic, as linear engines need it."""
        return self.times is None

    def energy_norm(self, chain: Chain, duration: float) -> float:
        """Bound sqrt(2 E) by the path of grain 1: ``d sqrt(2 E) / dt <= sqrt(k_1) |v_1|``."""
        if self.times is not None:
            return np.inf
        path = abs(self.amplitude) * (1 + 4 * self.frequency * duration)
        return float(np.sqrt(chain.contacts.stiffness[1]) * path)

    def push(self, chain: Chain, time: Array, force: Array, rate: Array) -> Push:
        """Return what keeps grain 1 on its path: the force of the contact below it, besides its inertia."""
        return Push(1, force[:, 1], rate[:, 1], self.acceleration(time), float(chain.masses[0]))


EXCITATIONS: dict[str, type[Excitation]] = {e.kind: e for e in (Impulse, Displacement, Profile, Drive)}
