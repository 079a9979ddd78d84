"""The scene: a chain, how it is struck and what is recorded, whatever method solves it."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import InstanceOf

from ..chain.chain import Chain
from ..chain.picture import DETAILED_GRAINS, DRAWN_POINTS
from ..chain.plausible import LIMITS
from ..errors import InputError, shown
from ..util.arrays import Array, as_slice
from ..util.caching import cached_property
from ..util.files import write_aside
from ..util.plotting import axes_in_units, legend
from ..util.tables import counted
from ..util.validation import make_unchecked
from . import toml_file
from .base import Excitation
from .excitation import Drive
from .light_cone import reached
from .recording import Recording
from .strike import (
    Squeeze,
    Surroundings,
    first_overlaps,
    squeezed,
    strike_faults,
    strike_number,
    strike_remarks,
    surroundings,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LONGEST_DURATION = 3600.0  # s: of one that may be meant
# s and m: of one that may be meant where grains are as narrow, in which a wave takes microseconds
DURATION_OF_NARROW = 1.0
NARROW = 0.05
DASHPOT = 10.0  # A omega beyond which a contact hardly gives way in a period
# omega h at most of the times at which quantities are gathered: then 1e-6 of the fastest motion is
# known between them
GATHERING_TURN = 0.5
# strike numbers at which linear theory errs by so much in the velocities after 100 us
ERRS_BY_1_PERCENT = 0.037
ERRS_BY_10_PERCENT = 0.4
DRAWN_AROUND = 10  # grains at rest drawn on either side of those that are moved


class Scene(Recording):
    """A chain, an excitation, and what is recorded.

    Parameters
    ----------
    chain : Chain
    excitation : Impulse, Displacement, Profile, Packet, Riemann, Drive or Force
    duration : float
        s.
    samples : int
        Number of recorded times, t = 0 and t = duration included.
    grains : "all", "first:last" or list of int
        Recorded grains.
    quantities : list of str, optional
        What is gathered all along the run, also between the samples, without keeping more of these;
        the answer has it as `Trajectory.gathered`, each with its error: "peak_displacement",
        "peak_velocity" and "arrival_time" of every recorded grain, "peak_force:40" and "force:40"
        of contact 40, the latter at times so close that no motion hides between them.

    Raises
    ------
    InputError
        With every fault found.

    Examples
    --------
    >>> from lmpchain import GLASS, Impulse
    >>> scene = Scene(
    ...     chain=Chain(grains=120, material=GLASS, diameter=1e-3),
    ...     excitation=Impulse(velocity=8.57e-4),
    ...     duration=100e-6,
    ... )
    >>> round(scene.strike_number, 2)
    8.48
    """

    chain: Chain
    excitation: InstanceOf[Excitation]

    def _faults(self) -> Iterator[tuple[str, str]]:
        misfits = list(self.excitation.faults(self.chain, self.duration))
        yield from misfits
        # how far an excitation squeezes a chain that it does not fit cannot be computed
        if not misfits and not self._gentle:
            yield from strike_faults(self.excitation, self._squeeze)
        yield from self.faults(self.chain)

    def _remarks(self) -> Iterator[str]:
        narrowest = float(np.min(self.chain.diameter))
        longest = DURATION_OF_NARROW if narrowest < NARROW else LONGEST_DURATION
        if self.duration > longest:
            long = f"{self.duration:g} s is long for a wave in grains of {1e3 * narrowest:.3g} mm"
            yield f"duration: {long}; times are in seconds (100 us is 1e-4)"
        if self.chain.damped:
            turn = self.chain.damping.longest_time * self.fastest_motion
            if turn > DASHPOT:
                cure = "A is in seconds, 1e-9 to 1e-6 for most grains"
                yield f"chain.damping.viscoelastic: A omega is {turn:.2g}, a dashpot; {cure}"
        if not self._gentle:
            yield from strike_remarks(
                self.chain, self.excitation, self._surroundings, self._squeeze.compression
            )

    @cached_property
    def _overlap_bound(self) -> float:
        """Bound on overlaps at rest and in the first collision, m; infinite where none is known."""
        bounds = self.chain.bounds
        speed = self.excitation.strike_velocity
        return bounds.struck(speed) if bounds and speed else np.inf

    @property
    def _gentle(self) -> bool:
        """Whether bounds show that Hertz's law holds, and that no grain is faster than sound."""
        # with arrays of all contacts in place of bounds, a run of 100 grains takes a fifth longer
        bounds = self.chain.bounds
        return (
            bounds is not None
            and self._overlap_bound <= LIMITS.hertz_compression * bounds.narrowest
            and abs(self.excitation.strike_velocity) <= bounds.slowest
        )

    @cached_property
    def _squeeze(self) -> Squeeze:
        """The contact that is squeezed most at first, and to what part of the diameter."""
        return squeezed(self._surroundings)

    def _summary(self) -> Iterator[Sequence[str]]:
        yield "chain", repr(self.chain), ""
        yield "excitation", repr(self.excitation), ""
        yield (
            "recorded",
            f"{self.samples} times to {self.duration:g} s, "
            f"{counted(self.count(self.chain), 'grain')}",
            "",
        )
        if self.chain.grains <= DETAILED_GRAINS:
            yield (
                "strike number",
                f"{self.strike_number:.4g}",
                _verdict(self.strike_number),
            )

    def _picture(self) -> str:
        return super()._picture() if self.chain.grains <= DETAILED_GRAINS else ""

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the excitation over time, or what it gives the grains at t = 0; returns the axes."""
        waveform = getattr(self.excitation, "waveform", None)
        if waveform:
            name = self.excitation.strength[1]
            ax = axes_in_units(ax, "s", "m" if name == "displacement" else "N")
            time = np.linspace(0.0, self.duration, DRAWN_POINTS)
            ax.plot(time, waveform.at(time))
            ax.set(xlabel="time", ylabel=f"{name}, downward")
            return ax
        return self._plot_start(axes_in_units(ax, "", ""))

    def _plot_start(self, ax: Axes) -> Axes:
        """Draw displacements and velocities at t = 0 of the grains around those that have any."""
        first, last = self.excitation.reach(self.chain)
        top = max(1, first - DRAWN_AROUND)
        near = np.arange(top, min(self.chain.grains, last + DRAWN_AROUND) + 1)
        fields = zip(("displacement", "velocity"), ("m", "m/s"), self.initial(), strict=True)
        excited = [(name, unit, values) for name, unit, values in fields if values.any()]
        for name, unit, values in excited:
            ax.plot(near, values[near - 1], ".-", lw=1, label=f"{name} ({unit})")
        ax.set(xlabel="grain, from the top", ylabel="at t = 0, downward")
        if len(excited) == 1:
            # which then names the axis
            name, unit, _ = excited[0]
            ax.set_ylabel(f"{name} at t = 0, downward")
            return axes_in_units(ax, "", unit)
        legend(ax)
        return ax

    @property
    def time(self) -> Array:
        """Recorded times, (T,) s."""
        return np.linspace(0.0, self.duration, self.samples)

    @cached_property
    def finer(self) -> int:
        """Intervals from sample to sample that quantities are gathered in: 1, 2, 3, 4, 6, 8 ...

        Few numbers are allowed, so that the scenes of a sweep share theirs.
        """
        if not self.quantities:
            return 1
        turn = self.highest_frequency * self.duration / (self.samples - 1)
        needed = turn / GATHERING_TURN
        power = 2 ** max(0, math.ceil(math.log2(needed)))
        # between two powers of 2, half as much again as the smaller one
        between = 3 * power // 4
        return between if power >= 4 and between >= needed else power

    @property
    def fine(self) -> Scene:
        """The scene that engines answer, with times and grains that gathering quantities takes."""
        return self._fine if self.quantities else self

    @cached_property
    def _fine(self) -> Scene:
        samples = (self.samples - 1) * self.finer + 1
        return make_unchecked(
            Scene,
            chain=self.chain,
            excitation=self.excitation,
            duration=self.duration,
            samples=samples,
        )

    @property
    def ungathered(self) -> Scene:
        """The scene with samples alone, for studies of the methods and not of the answer."""
        return self.replace(quantities=None) if self.quantities else self

    @property
    def recorded(self) -> np.ndarray:
        """Recorded grains, (G,) numbers from 1."""
        return self.numbers(self.chain)

    def initial(self) -> tuple[Array, Array]:
        """Return displacement (N,) m and velocity (N,) m/s at t = 0."""
        return self.excitation.initial(self.chain)

    @property
    def drive(self) -> Drive | None:
        """The prescribed motion of grain 1 or of the top wall, if there is one."""
        return self.excitation if isinstance(self.excitation, Drive) else None

    @cached_property
    def _surroundings(self) -> Surroundings:
        return surroundings(self.chain, self.excitation)

    @cached_property
    def imposed(self) -> tuple[float, float]:
        """The largest displacement and speed that the excitation imposes, m and m/s."""
        return self._surroundings.excitation.strongest(self._surroundings.chain)

    @property
    def at_rest(self) -> bool:
        """Whether the excitation is none at all."""
        return not any(self.imposed)

    @cached_property
    def energy(self) -> float:
        """Energy above rest, J: that at t = 0, or infinite if the excitation does work later."""
        return self._surroundings.excitation.energy(self._surroundings.chain)

    @cached_property
    def strike_number(self) -> float:
        """Strike over what the contact below holds: v0 / (eps_n omega_n) or phi_0 / eps_n.

        Linear theory needs it to be far below 1; it is infinite in the sonic vacuum.
        """
        return strike_number(self._surroundings.chain, self._surroundings.excitation)

    @cached_property
    def fastest_motion(self) -> float:
        """The highest frequency that can be excited without damping, rad/s; 0 if nothing moves.

        The band edge of the chain at rest, that of two grains pressed together by the strike, or
        that of a drive.
        """
        bounds = self.chain.bounds
        fastest = max(self.chain.band_edge, self.excitation.fastest)
        # a bound below the others spares the overlaps of all contacts
        if not (bounds and bounds.frequency(self._overlap_bound) <= fastest):
            fastest = max(fastest, self._pair_frequency)
        return float(fastest)

    @cached_property
    def highest_frequency(self) -> float:
        """What bounds the steps of every method, rad/s: the highest frequency that can be excited.

        Or the rate at which damping stops the fastest motion.
        """
        # nothing moves in a vacuum that is not struck: any frequency above 0 does
        return self.chain.damping.fastest_rate(self.fastest_motion) or 1 / self.duration

    @property
    def damping_effect(self) -> float:
        """About what leaving damping out would change at most, relative; 0 without damping."""
        return self.chain.damping.effect(self.fastest_motion, self.duration)

    @property
    def damping_remark(self) -> str:
        """What leaving damping out would change, in words; none without damping."""
        if not self.chain.damped:
            return ""
        effect = self.damping_effect
        size = f"at most about {100 * effect:.2g} %" if effect < 1 else "up to all of it"
        return f"leaving it out would change the answer by {size}"

    @property
    def _pair_frequency(self) -> float:
        """Bound on the frequency of two grains pressed together by the strike, rad/s."""
        overlap = first_overlaps(self.chain, self.excitation)
        stiffness = self.chain.contacts.stiffness_bound(overlap).max()
        return math.sqrt(2 * stiffness / self.chain.masses.min())

    @cached_property
    def largest_strain(self) -> float:
        """A bound on ``|r / eps|`` of all contacts, rigorous while it is small; else infinite."""
        return float(self.chain.contacts.largest_strain(self.energy))

    @cached_property
    def linear_strain(self) -> float:
        """A bound on ``|r / eps|`` of every contact of the linear chain at any time, or infinity.

        Of the energy E put in, a contact that is stretched by r takes at least ``r^2 / 2c``. Its
        compliance c is 1/k or, between two ends that stand still, where the others must give way,
        ``(1 - (1/k) / sum 1/k) / k``.
        """
        contacts = self.chain.contacts
        k = contacts.stiffness
        pressed = contacts.pressed
        # a contact that only touches opens at once: linear theory has no bound there
        if not (pressed == contacts.exists).all() or not pressed.any():
            return np.inf
        compliance = np.divide(1.0, k, out=np.zeros(k.size), where=pressed)
        # a wall at the top: both ends stand still, unless something drives it or works on the chain
        if pressed[0] and not self.excitation.does_work:
            compliance *= 1 - compliance / compliance.sum()
        norm = self.excitation.energy_norm(self.chain, self.duration)
        return float(norm * (np.sqrt(compliance[pressed]) / contacts.overlap[pressed]).max())

    @cached_property
    def light_cone(self) -> LightCone | None:
        """The grains that the wave can have reached at the end; None if that is all of them."""
        first, last = reached(self.chain, self.excitation, self.energy, self.duration)
        if last - first + 1 == self.chain.grains:
            return None
        recorded = self.recorded
        columns = np.flatnonzero((recorded >= first) & (recorded <= last))
        return LightCone(self.part(first, last), recorded[columns] - first, as_slice(columns))

    @property
    def reached(self) -> Scene:
        """The scene of the grains that the wave can have reached, recorded if not all."""
        return self.light_cone.scene if self.light_cone else self

    def until(self, time: float) -> Self:
        """Return the scene to the last sample before a time, s; itself where that is t = 0."""
        last = int(np.searchsorted(self.time, time)) - 1
        if last in (0, self.samples - 1):
            return self
        return self.replace(duration=float(self.time[last]), samples=last + 1)

    def part(self, first: int, last: int) -> Scene:
        """Return grains first ... last, all recorded: right until a wave meets their ends."""
        # a part of a valid scene is valid
        return make_unchecked(
            Scene,
            chain=self.chain.part(first, last),
            excitation=self.excitation.part(first, last),
            duration=self.duration,
            samples=self.samples,
        )

    @classmethod
    def from_toml(cls, path: str | PathLike[str]) -> Self:
        """Read a scene file; raises `InputError` with every fault in it."""
        return cls(**toml_file.read(path))

    @classmethod
    def from_dict(cls, tables: dict[str, Any], folder: Path | None = Path()) -> Self:
        """Make a scene from the tables of a scene file with CSV files in `folder`.

        Raises `InputError` with every fault. Without a folder the tables may name no files.
        """
        return cls(**toml_file.fields(tables, folder))

    @classmethod
    def from_text(cls, text: str) -> Self:
        """Make a scene from the text of a file that names no other file.

        Raises `InputError`, or `ValueError` if it is not TOML.
        """
        return cls.from_dict(tomllib.loads(text), None)

    def to_dict(self) -> dict[str, Any]:
        """Return the tables of a scene file."""
        return toml_file.tables(self.chain, self.excitation, self.given())

    def to_text(self) -> str:
        """Return the text of a scene file."""
        import tomli_w

        return tomli_w.dumps(self.to_dict())

    def to_toml(self, path: str | PathLike[str], overwrite: bool = False) -> None:
        """Write a scene file that `from_toml` reads back equal.

        A file that lmpchain did not write is replaced only if `overwrite` is true; otherwise
        `InputError` is raised.
        """
        with write_aside(path, overwrite) as aside:
            aside.write_text(self.to_text(), encoding="utf-8")


def check_scene(scene: object, key: str = "scene") -> None:
    """Raise `InputError` with this key unless this is a scene."""
    if not isinstance(scene, Scene):
        cure = "make one, or read its file with Scene.from_toml"
        raise InputError.at(key, f"must be a Scene (got {shown(scene)}): {cure}")


class LightCone(NamedTuple):
    """The part of a scene that a wave can have reached; the rest need not be computed.

    Attributes
    ----------
    scene : Scene
        That part with all of its grains recorded.
    rows : slice or (C,) array
        Indices, among the recorded grains of that part, of those that the whole scene records.
    columns : slice or (C,) array
        Their places among the recorded grains of the whole scene.
    """

    scene: Scene
    rows: slice | NDArray[np.intp]
    columns: slice | NDArray[np.intp]


def _verdict(strike_number: float) -> str:
    """Return in words what a strike number says of linear theory."""
    if strike_number == math.inf:
        return "no contact is pressed: there is no linear theory"
    if strike_number > ERRS_BY_10_PERCENT:
        return "too strong for linear theory"
    if strike_number < ERRS_BY_1_PERCENT:
        return "weak enough for linear theory"
    return "almost linear"
