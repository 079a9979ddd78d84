"""The scene: a chain, how it is struck and what is recorded, whatever method solves it."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from ..chain.picture import DETAILED_GRAINS, DRAWN_POINTS
from ..chain.plausible import LIMITS, beyond_hertz
from ..errors import InputError, shown
from ..util.arrays import Array
from ..util.caching import cached_property
from ..util.files import write_aside
from ..util.plotting import axes_in_units, legend
from ..util.tables import counted
from ..util.validation import make_unchecked
from . import toml_file
from .excitation import Drive
from .facts import SceneFacts

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


class Scene(SceneFacts):
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
    >>> from lmpchain import GLASS, Chain, Impulse
    >>> scene = Scene(
    ...     chain=Chain(grains=120, material=GLASS, diameter=1e-3),
    ...     excitation=Impulse(velocity=8.57e-4),
    ...     duration=100e-6,
    ... )
    >>> round(scene.strike_number, 2)
    8.48
    """

    def _faults(self) -> Iterator[tuple[str, str]]:
        misfits = list(self.excitation.faults(self.chain, self.duration))
        yield from misfits
        # how far an excitation squeezes a chain that it does not fit cannot be computed
        if not misfits and not self._gentle:
            yield from self.strike_faults()
        yield from self.faults(self.chain)

    def _remarks(self) -> Iterator[str]:
        if self.duration > DURATION_OF_NARROW:
            narrowest = float(np.min(self.chain.diameter))
            if narrowest < NARROW or self.duration > LONGEST_DURATION:
                grains = f"a wave in grains of {1e3 * narrowest:.3g} mm"
                long = f"{self.duration:g} s is long for {grains}"
                yield f"duration: {long}; times are in seconds (100 us is 1e-4)"
        if self.chain.damped:
            turn = self.chain.damping.longest_time * self.fastest_motion
            if turn > DASHPOT:
                cure = "A is in seconds, 1e-9 to 1e-6 for most grains"
                yield f"chain.damping.viscoelastic: A omega is {turn:.2g}, a dashpot; {cure}"
        if not self._gentle:
            yield from self._strike_remarks()

    def _strike_remarks(self) -> Iterator[str]:
        """Yield remarks on overlaps beyond Hertz's law, and on grains faster than sound in them."""
        chain = self.chain
        _, compression = self.first_squeeze
        limit = LIMITS.hertz_compression
        # a chain that is squeezed so at rest says it of itself
        if chain.law.power == 1.5 and compression > limit > chain.equilibrium.compression.max():
            yield f"{self._strength}: {beyond_hertz(compression)}"
        first, near = self._surroundings
        speed = np.abs(near.excitation.largest(near.chain)[1])
        sound = near.chain.by_grain("sound_speed")
        worst = int((speed / sound).argmax())
        if speed[worst] > sound[worst]:
            grain = f"grain {worst + first} moves at {speed[worst]:.3g} m/s"
            faster = f"faster than sound in its material, {sound[worst]:.3g} m/s"
            yield f"{self._strength}: {grain}, {faster}"

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

    @cached_property
    def finer(self) -> int:
        """Intervals from sample to sample that quantities are gathered in: 1, 2, 3, 4, 6, 8 ...

        Few numbers are allowed, so that the scenes of a sweep share theirs.
        """
        if not self.quantities:
            return 1
        needed = self.sampling_phase / GATHERING_TURN
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
        samples = self.intervals * self.finer + 1
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

    def initial(self) -> tuple[Array, Array]:
        """Return displacement (N,) m and velocity (N,) m/s at t = 0."""
        return self.excitation.initial(self.chain)

    @property
    def drive(self) -> Drive | None:
        """The prescribed motion of grain 1 or of the top wall, if there is one."""
        return self.excitation if isinstance(self.excitation, Drive) else None

    @property
    def damping_remark(self) -> str:
        """What leaving damping out would change, in words; none without damping."""
        if not self.chain.damped:
            return ""
        effect = self.damping_effect
        size = f"at most about {100 * effect:.2g} %" if effect < 1 else "up to all of it"
        return f"leaving it out would change the answer by {size}"

    def until(self, time: float) -> Self:
        """Return the scene to the last sample before a time, s; itself where that is t = 0."""
        if time > self.duration:
            return self
        last = int(np.searchsorted(self.time, time)) - 1
        if last in (0, self.intervals):
            return self
        return self.replace(duration=float(self.time[last]), samples=last + 1)

    @classmethod
    def from_toml(cls, path: str | PathLike[str]) -> Self:
        """Read a scene file; raises `InputError` with every fault in it."""
        return cls(**toml_file.read_fields(path))

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


def _verdict(strike_number: float) -> str:
    """Return in words what a strike number says of linear theory."""
    if strike_number == math.inf:
        return "no contact is pressed: there is no linear theory"
    if strike_number > ERRS_BY_10_PERCENT:
        return "too strong for linear theory"
    if strike_number < ERRS_BY_1_PERCENT:
        return "weak enough for linear theory"
    return "almost linear"
