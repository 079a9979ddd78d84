"""Excitations that act after t = 0: motion of an end of the chain, force on a grain."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from ..chain.chain import Chain
from ..errors import InputError
from ..util.arrays import Array
from ..util.lazy import cached_property
from ..util.validation import NOT_GIVEN, Positive, Real, Vector, Whole
from .base import Excitation, Number, OneGrain, Push
from .file_columns import ColumnMeaning
from .initial import Profile
from .trace_file import Measured, Reading, TraceFile
from .waveform import Interpolation, Waveform


@dataclass(frozen=True)
class WaveformLimits:
    """Limits of waveforms; values beyond them are not in SI units, or numbers overflow.

    Attributes
    ----------
    frequency : float
        Highest frequency, and inverse of the smallest time between two points, rad/s.
    value : float
        Largest displacement or force, m or N.
    spacing : float
        Smallest time between two points, relative to the time of the last point.
    overshoot : float
        Largest distance by which a spline may leave the range of its points, relative to the width
        of the range. A spline through a step or through noise exceeds this limit and does not
        represent the data.
    """

    frequency: float = 1e20
    value: float = 1e100
    spacing: float = 1e-12
    overshoot: float = 0.1


WAVEFORM_LIMITS = WaveformLimits()


class _Acting(Measured):
    """A motion or a force over time, given by a formula or by points."""

    does_work: ClassVar[bool] = True
    file_kind: ClassVar[type[TraceFile]] = TraceFile
    unit: ClassVar[str]
    if TYPE_CHECKING:
        grain: Whole
        amplitude: Real
        frequency: Positive
        cycles: Positive
        times: Vector
        start: Profile
        interpolation: Interpolation
    holds: ClassVar[bool]

    @classmethod
    def _arrays(cls, file: TraceFile) -> tuple[Reading, dict[str, Array]]:
        name = cls.strength[1]
        reading = file.read([ColumnMeaning(name, cls.unit)], from_zero=True)
        if reading.time[0] < 0:
            begins = f"the trace begins at {reading.time[0]:g} s, before t = 0"
            cure = "set trigger to its time of t = 0, for example 0.0, to drop earlier samples"
            raise InputError.at("trigger", f"{begins}: {cure}")
        return reading, {"times": reading.time, name: reading.values[:, 0]}

    @property
    def acts_on(self) -> int:
        """Number of the grain that is driven or forced; 0 for the top wall."""
        return self.grain

    @cached_property
    def waveform(self) -> Waveform:
        """The motion, m, or the force, N, over time."""
        if self.times is not None:
            values = getattr(self, self.strength[1])
            return Waveform.through(self.times, values, self.interpolation, self.holds)
        return Waveform.sine(self.amplitude, self.frequency, self.cycles)

    @property
    def numbers(self) -> Array:
        """Parameters of the waveform: the values at points, or amplitude and frequency."""
        if self.times is not None:
            return np.asarray(getattr(self, self.strength[1]))
        return np.array([self.amplitude, self.frequency or 0.0])

    def _begin(self, chain: Chain) -> tuple[Array, Array]:
        """Return the displacement and velocity (N,) at t = 0, as given by `start`."""
        if self.start is None:
            return np.zeros(chain.grains), np.zeros(chain.grains)
        return self.start.initial(chain)

    def _start_faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield the faults of the displacement and velocity at t = 0."""
        if self.start is not None:
            for key, message in self.start.faults(chain, duration):
                yield f"start.{key}", message

    def scaled(self, factor: float) -> Self:
        """Return the excitation, and its start, multiplied by a factor."""
        scaled = super().scaled(factor)
        return scaled if self.start is None else scaled.replace(start=self.start.scaled(factor))

    def energy_norm(self, chain: Chain, duration: float) -> float:
        """Return an upper bound on sqrt(2 E): its initial value plus the largest increase."""
        initial = 0.0 if self.start is None else self.start.energy_norm(chain, duration)
        return initial + self._added_norm(chain, duration)

    @abstractmethod
    def _added_norm(self, chain: Chain, duration: float) -> float:
        """Return an upper bound on the increase of sqrt(2 E) of a linear chain, J^(1/2)."""

    def _faults(self) -> Iterator[tuple[str, str]]:
        values = self.strength[1]
        others = {"grain", "end", "start", "interpolation", "source"}
        fields = {key for key, value in self if value is not None} - others
        if fields not in self._ways(values):
            yield "amplitude", f"give {self._words(values)} (or a file with both)"
        elif self.times is not None:
            yield from self._point_faults(values, getattr(self, values))
        elif not self.waveform.fastest < WAVEFORM_LIMITS.frequency:
            # The envelope of a burst of few cycles, or of a short push, may have a high frequency.
            # The error then names its key.
            key = "frequency"
            if 2 * np.pi * (self.frequency or 0.0) < WAVEFORM_LIMITS.frequency:
                # These fields set the envelope of a burst, a half-sine or a piston.
                key = next(key for key in ("cycles", "duration", "rise") if key in fields)
            frequency = f"corresponds to {self.waveform.fastest:.2g} rad/s"
            yield key, f"{frequency}, which is too fast to compute: use SI units"

    def _ways(self, values: str) -> list[set[str]]:
        """Return the sets of fields that define a waveform."""
        return [{"amplitude", "frequency"}, {"amplitude", "frequency", "cycles"}, {"times", values}]

    def _words(self, values: str) -> str:
        """Return the sets of fields that define a waveform, as text."""
        return f"amplitude and frequency, with or without cycles, or times and {values}"

    def _point_faults(self, key: str, values: Array) -> Iterator[tuple[str, str]]:
        """Yield the faults of the points of a curve."""
        if (np.abs(values) > WAVEFORM_LIMITS.value).any():
            yield key, f"must be at most {WAVEFORM_LIMITS.value:g} in magnitude"
            return
        if len(self.times) != len(values) or len(self.times) < 2:
            yield key, f"must have one entry for each of two or more times, not {len(values)}"
            return
        steps = np.diff(self.times)
        # The curve overflows if some points are much closer to each other than others.
        if self.times[0] < 0 or not (steps > WAVEFORM_LIMITS.spacing * self.times[-1]).all():
            smallest = f"{WAVEFORM_LIMITS.spacing:g} of the last"
            yield "times", f"must be 0 or more, and increase by more than {smallest}"
        elif (steps < 1 / WAVEFORM_LIMITS.frequency).any():
            apart = f"are {steps.min():.2g} s apart"
            yield "times", f"{apart}, which is too little to compute: use SI units"
        elif self.interpolation == "spline":
            yield from self._overshoot(values)

    def _overshoot(self, values: Array) -> Iterator[tuple[str, str]]:
        """Yield a fault if the spline leaves the range of its points."""
        low, high = self.waveform.range
        slack = WAVEFORM_LIMITS.overshoot * np.ptp(values)
        if low < values.min() - slack or high > values.max() + slack:
            span = f"goes from {low:.3g} to {high:.3g}"
            points = f"through points from {values.min():.3g} to {values.max():.3g}"
            cure = 'use interpolation = "pchip" or "linear"'
            yield "interpolation", f"the spline {span} {points}: {cure}"


class Drive(_Acting):
    """A prescribed motion of an end of the chain; positive downward, from 0 at t = 0.

    The end is grain 1, the top wall, or, from below, the bottom wall or the held last grain.

    Parameters
    ----------
    amplitude : float
        Amplitude A of a sine ``phi_1 = A sin(2 pi f t)``, m.
    frequency : float
        Frequency f of the sine, Hz.
    cycles : float, optional
        Number of cycles of a Hann tone burst ``A sin(2 pi f t) sin(pi f t / cycles)^2``, followed
        by rest.
    shape : "piston", optional
        In place of amplitude and frequency: a motion at constant speed after a smooth start. During
        the start the acceleration increases and decreases linearly. Afterwards the position is
        ``velocity (t - rise / 2)``.
    velocity : float
        Constant speed of a piston, m/s.
    rise : float
        Duration of the start of a piston, s.
    times : array
        Times of the points of a curve, s, given in place of amplitude and frequency. The body rests
        before the first point, and keeps its position after the last point.
    displacement : array
        Displacements at these times, m.
    interpolation : "pchip", "linear" or "spline"
        The curve: monotone between points (SciPy's PCHIP), straight lines, or a cubic spline
        (not-a-knot). A spline is rejected if it leaves the range of its points by more than a
        tenth of this range.
    file : path, optional
        A file of an instrument, given in place of times and displacement. Its options are columns,
        skip, time_scale, scale (m/V), offset or baseline, trigger, lowpass and every; see
        `TraceFile`. If offset, baseline, trigger or lowpass is given, displacements are measured
        from the position at t = 0.
    grain : 0 or 1
        1 drives the first grain, and 0 the top wall of a chain with ``top = "wall"``.
    end : "top" or "bottom"
        "bottom" moves the base of the column, as a shaker does: the wall of a chain with
        ``bottom = "wall"``, or the last grain of a chain with ``bottom = "fixed"``. In this case
        `grain` must be omitted.
    start : Profile, optional
        Displacement and velocity of the other grains at t = 0. By default they are at rest.

    Examples
    --------
    >>> piston = Drive(shape="piston", velocity=0.01, rise=2e-5)
    >>> [round(float(x), 9) for x in piston.motion(5e-5)]
    [4e-07, 0.01]
    >>> burst = Drive(amplitude=1e-9, frequency=1e4, cycles=5, grain=0)
    >>> float(burst.motion(5e-4)[0])
    0.0
    """

    kind: ClassVar[str] = "drive"
    holds: ClassVar[bool] = True
    strength: ClassVar[tuple[str, ...]] = ("amplitude", "displacement", "velocity")
    unit: ClassVar[str] = "m"
    amplitude: Real = NOT_GIVEN
    frequency: Positive = NOT_GIVEN
    times: Vector = NOT_GIVEN
    displacement: Vector = NOT_GIVEN
    cycles: Positive = NOT_GIVEN
    shape: Literal["piston"] = NOT_GIVEN
    velocity: Real = NOT_GIVEN
    rise: Positive = NOT_GIVEN
    grain: Annotated[Whole, Field(ge=0, le=1)] = 1
    end: Literal["top", "bottom"] = "top"
    start: Profile = NOT_GIVEN
    interpolation: Interpolation = "pchip"
    source: str = NOT_GIVEN

    @classmethod
    def _arrays(cls, file: TraceFile) -> tuple[Reading, dict[str, Array]]:
        reading, arrays = super()._arrays(file)
        # An instrument may measure displacements from an arbitrary origin.
        if not {"trigger", "baseline", "offset", "lowpass"}.isdisjoint(file.given()):
            begin = arrays["displacement"][0]
            arrays["displacement"] = arrays["displacement"] - begin
            text = f"{reading.text}; less {begin:.6g} m, the position at t = 0"
            reading = replace(reading, text=text)
        return reading, arrays

    def _ways(self, values: str) -> list[set[str]]:
        return [*super()._ways(values), {"shape", "velocity", "rise"}]

    def _words(self, values: str) -> str:
        # The alternatives end with points, because a file may contain these.
        return f'shape = "piston", velocity and rise, or {super()._words(values)}'

    @cached_property
    def waveform(self) -> Waveform:
        """The motion over time, m."""
        if self.shape is not None:
            return Waveform.piston(self.velocity, self.rise)
        return super().waveform

    @property
    def numbers(self) -> Array:
        """Parameters of the waveform; for a piston, its velocity."""
        return super().numbers if self.shape is None else np.array([self.velocity])

    def _faults(self) -> Iterator[tuple[str, str]]:
        yield from super()._faults()
        if self.from_below and "grain" in self.model_fields_set:
            yield "grain", 'applies only to a drive from above: leave it out with end = "bottom"'

    def _point_faults(self, key: str, values: Array) -> Iterator[tuple[str, str]]:
        yield from super()._point_faults(key, values)
        if values[0] != 0:
            top = "grain 1" if self.grain else "the wall"
            body = "the base" if self.from_below else top
            yield key, f"must begin with 0, the position of {body} at rest"

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield the faults of the drive for this chain and duration, s."""
        if self.from_below:
            yield from self._faults_from_below(chain)
        elif self.grain == 0 and chain.top != "wall":
            cure = 'use top = "wall", or drive grain 1'
            yield "grain", f"0 moves the top wall, but the chain has no top wall: {cure}"
        elif self.grain == 1 and chain.movable < 2:
            yield "kind", "no other grain can move if grain 1 is driven: use more grains"
        yield from self._start_faults(chain, duration)

    def _faults_from_below(self, chain: Chain) -> Iterator[tuple[str, str]]:
        """Yield the faults of the drive of a base for this chain."""
        if chain.bottom == "free":
            cure = 'use bottom = "wall" or bottom = "fixed"'
            yield "end", f"the chain has no base to be moved: {cure}"
        if chain.ground is not None:
            cure = "leave the ground out, or drive the top"
            yield "end", f"a base cannot be driven together with a force from the ground: {cure}"
        if chain.loose_grains:
            yield "end", f"a base cannot be driven if {chain.loose}"

    def _start_faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        faults = list(super()._start_faults(chain, duration))
        yield from faults
        # The arrays of a profile with a wrong length may be empty.
        for key, values in self.start.fields.items() if self.start and not faults else ():
            if self.driven and values[0]:
                yield f"start.{key}", "must be 0 for grain 1, because it is driven"

    @property
    def from_below(self) -> bool:
        """Whether the motion of the bottom wall or of the held last grain is prescribed."""
        return self.end == "bottom"

    @property
    def acts_on(self) -> int:
        """Number of the driven grain; 0 for a wall or a base."""
        return self.driven

    @property
    def driven(self) -> int:
        """Number of driven grains, from the top; a driven wall or base is not counted."""
        return 0 if self.from_below else self.grain

    @property
    def wall(self) -> Waveform | None:
        """Motion of the top wall, m; None if the wall does not move."""
        return None if self.grain or self.from_below else self.waveform

    def body(self, chain: Chain) -> int:
        """Return the number of the driven body: 0 of the top wall, N + 1 of the bottom wall."""
        return chain.movable + 1 if self.from_below else self.grain

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return the displacement and velocity of every grain at t = 0."""
        u, v = self._begin(chain)
        if 1 <= self.body(chain) <= chain.grains:
            v[self.body(chain) - 1] = self.motion(0.0)[1]
        return u, v

    def largest(self, chain: Chain) -> tuple[Array, Array]:
        """Return the largest displacement and velocity (N,) of the start and of the drive.

        The value of the first grain, or of the last grain for a drive from below, includes the
        motion of the driven body.
        """
        fields = self._begin(chain)
        place = -1 if self.from_below else 0
        for order, values in enumerate(fields):
            values[place] = max(abs(values[place]), self.waveform.largest(order))
        return fields

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the first and the last grain that is driven, displaced or moves at t = 0."""
        first, last = self.start.reach(chain) if self.start else (chain.grains, 1)
        if self.from_below:
            return first, chain.grains
        return 1, last

    def upside_down(self, chain: Chain) -> Drive:
        """Return the drive of the upper end that moves the chain upside down in the same way."""
        turned = self.scaled(-1.0)
        fields: dict[str, object] = {"end": "top", "grain": int(chain.bottom == "fixed")}
        if turned.start is not None:
            backwards: dict[str, Any] = {
                key: values[::-1] for key, values in turned.start.fields.items()
            }
            fields["start"] = Profile(**backwards)
        return turned.replace(**fields)

    def part(self, first: int, last: int) -> Drive:
        """Return the drive of grains first ... last; they must include the driven end."""
        return self if self.start is None else self.replace(start=self.start.part(first, last))

    def motion(self, t: float | Array) -> tuple[Array, Array]:
        """Return the displacement (m) and velocity (m/s) of the driven body at these times (s)."""
        return self.waveform.at(t), self.waveform.at(t, 1)

    def acceleration(self, t: Array) -> Array:
        """Return the acceleration of the driven body at these times, m/s2."""
        return self.waveform.at(t, 2)

    def _added_norm(self, chain: Chain, duration: float) -> float:
        """Return an upper bound from the path, because ``d sqrt(2 E) / dt <= sqrt(k) |v|``."""
        stiffness = chain.contacts.stiffness[chain.movable if self.from_below else self.grain]
        return float(np.sqrt(stiffness) * self.waveform.path(duration))

    def push(self, chain: Chain, time: Array, force: Array, rate: Array, velocity: Array) -> Push:
        """Return the external force that maintains the prescribed motion."""
        motion = self.motion(time)[1], self.acceleration(time)
        if self.from_below:
            # The base transmits the force of the contact above it, and of no other one.
            held = chain.bottom == "fixed"
            inertia = held * float(chain.masses[-1])
            return Push(-force[:, chain.movable], -rate[:, chain.movable], *motion, inertia, held)
        # A driven wall transmits the force of contact 0; contacts 0 and 1 act on a driven grain 1.
        if not self.grain:
            return Push(force[:, 0], rate[:, 0], *motion, 0.0, False)
        force = force[:, 1] - force[:, 0]
        rate = rate[:, 1] - rate[:, 0]
        return Push(force, rate, *motion, float(chain.masses[0]), True)


class Force(OneGrain, _Acting):
    """A force on one grain over time, N, positive downward.

    Parameters
    ----------
    grain : int
        Number of the grain.
    amplitude : float
        Amplitude A of a sine ``A sin(2 pi f t)`` or of a half-sine, N.
    frequency : float
        Frequency f of the sine, Hz.
    cycles : float, optional
        Number of cycles of a Hann tone burst ``A sin(2 pi f t) sin(pi f t / cycles)^2``, without a
        force afterwards.
    shape : "half-sine", optional
        In place of a frequency: the force ``A sin(pi t / duration)``, as exerted by a hammer,
        without a force afterwards.
    duration : float
        Duration of a half-sine, s.
    times : array
        Times of the points of a curve, s. There is no force before the first point. After the last
        point the force falls to 0 within the time between the last two points.
    force : array
        Forces at these times, N.
    file : path, optional
        A file of an instrument, given in place of times and force. Its options are columns, skip,
        time_scale, scale (N/V), offset or baseline, trigger, lowpass and every; see `TraceFile`.
    interpolation : "pchip", "linear" or "spline"
        The curve through the points, as in `Drive`.
    start : Profile, optional
        Displacement and velocity of every grain at t = 0. By default all grains are at rest.

    Examples
    --------
    >>> hammer = Force(grain=1, shape="half-sine", amplitude=0.1, duration=5e-5)
    >>> [round(float(hammer.waveform.at(t)), 9) for t in (0.0, 2.5e-5, 6e-5)]
    [0.0, 0.1, 0.0]
    """

    kind: ClassVar[str] = "force"
    holds: ClassVar[bool] = False
    of_chain: ClassVar[bool] = True
    strength: ClassVar[tuple[str, ...]] = ("amplitude", "force")
    unit: ClassVar[str] = "N"
    grain: Number = 1
    amplitude: Real = NOT_GIVEN
    frequency: Positive = NOT_GIVEN
    cycles: Positive = NOT_GIVEN
    shape: Literal["half-sine"] = NOT_GIVEN
    duration: Positive = NOT_GIVEN
    times: Vector = NOT_GIVEN
    force: Vector = NOT_GIVEN
    start: Profile = NOT_GIVEN
    interpolation: Interpolation = "pchip"
    source: str = NOT_GIVEN

    def _ways(self, values: str) -> list[set[str]]:
        return [*super()._ways(values), {"shape", "amplitude", "duration"}]

    def _words(self, values: str) -> str:
        return f"{super()._words(values)}, or shape, amplitude and duration"

    @cached_property
    def waveform(self) -> Waveform:
        """The force over time, N."""
        if self.shape is not None:
            return Waveform.half_sine(self.amplitude, self.duration)
        return super().waveform

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield the faults of the force for this chain and duration, s."""
        yield from super().faults(chain, duration)
        yield from self._start_faults(chain, duration)

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return the displacement and velocity of every grain at t = 0."""
        return self._begin(chain)

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return the first and the last grain that moves at t = 0 or is forced."""
        first, last = (self.grain, self.grain) if self.start is None else self.start.reach(chain)
        return min(first, self.grain), max(last, self.grain)

    def part(self, first: int, last: int) -> Excitation:
        """Return the force on grains first ... last, which must include all that move at t = 0."""
        cut = super().part(first, last)
        return cut if self.start is None else cut.replace(start=self.start.part(first, last))

    def largest(self, chain: Chain) -> tuple[Array, Array]:
        """Estimate displacement and velocity of the forced grain from its contacts and inertia.

        The values of all grains are at least those at t = 0. The later motion of other grains is
        not estimated.
        """
        displacement, velocity = (np.abs(x) for x in self._begin(chain))
        pushed = self._pushed(chain)
        return np.maximum(displacement, pushed[0]), np.maximum(velocity, pushed[1])

    def strongest(self, chain: Chain, duration: float) -> tuple[float, float]:
        """Return the largest displacement and speed of any grain, m and m/s."""
        displacement, speed = super().strongest(chain, duration)
        # A contact that cannot hold the force lets its grain fly: the time limits the distance.
        if displacement > speed * duration:
            start = float(np.abs(self._begin(chain)[0]).max())
            displacement = min(displacement, start + speed * duration)
        return displacement, speed

    def _pushed(self, chain: Chain) -> tuple[Array, Array]:
        """Estimate the motion of the forced grain from rest, (N,) m and m/s; 0 for other grains."""
        size = self.waveform.largest()
        mass = chain.masses[self.grain - 1]
        # A force of 0 causes no motion.
        if not size:
            return np.zeros(chain.grains), np.zeros(chain.grains)
        contacts = chain.contacts.of(slice(self.grain - 1, self.grain + 1))
        distance = max(contacts.of(n).squeezed_by(size) for n in np.flatnonzero(contacts.exists))
        # Two bounds on the speed: the impulse on a free grain, and the work over `distance`.
        speed = min(self.waveform.gained / mass, float(np.sqrt(2 * size * distance / mass)))
        displacement = self.at_grain(chain, speed * np.sqrt(mass * distance / size))
        return displacement, self.at_grain(chain, speed)

    def _added_norm(self, chain: Chain, duration: float) -> float:
        """Return an upper bound from the impulse, because ``d sqrt(2 E) / dt <= |F| / sqrt(m)``."""
        return float(self.waveform.area(duration) / np.sqrt(chain.masses[self.grain - 1]))

    def push(self, chain: Chain, time: Array, force: Array, rate: Array, velocity: Array) -> Push:
        """Return the applied force as the external force on the grain."""
        n = self.grain
        applied = self.waveform.at(time)
        acceleration = (applied + force[:, n - 1] - force[:, n]) / chain.masses[n - 1]
        return Push(applied, self.waveform.at(time, 1), velocity[:, n - 1], acceleration, 0.0, True)
