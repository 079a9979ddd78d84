"""The scene: a chain, its excitation and its recording, independent of the engine."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..chain.bounds import LIMITS, beyond_hertz
from ..chain.picture import DETAILED_GRAINS, DRAWN_POINTS
from ..errors import InputError, shown
from ..util.arrays import Array
from ..util.files import expanded, write_aside
from ..util.lazy import cached_property
from ..util.plotting import Axes, chart, finish
from ..util.tables import counted
from ..util.validation import make_unchecked
from . import toml_file
from .excitation import Drive
from .facts import SceneFacts
from .lammps_column import RunOptions, infer_scene
from .lammps_input import LammpsInput
from .lammps_object import grains_of

LONGEST_DURATION = 3600.0  # Limit in s; longer runs are probably given in different units.
# Longest plausible duration, s, for grains narrower than NARROW, m, in which a wave takes
# microseconds.
DURATION_OF_NARROW = 1.0
NARROW = 0.05
DASHPOT = 10.0  # A omega above which a contact hardly deforms within a period
# Largest omega h of the times at which quantities are accumulated; they resolve the fastest motion
# to 1e-6.
GATHERING_TURN = 0.5
# Strike numbers at which the velocities of linear theory have this error after 100 us.
ERRS_BY_1_PERCENT = 0.037
ERRS_BY_10_PERCENT = 0.4
DRAWN_AROUND = 10  # Number of resting grains drawn on either side of the excited ones.


class Scene(SceneFacts):
    """A chain, its excitation and its recording.

    Parameters
    ----------
    chain : Chain
        The column of grains.
    excitation : Impulse, Displacement, Profile, Packet, Riemann, Drive or Force
        The cause of the motion.
    duration : float
        Time from the first to the last recorded sample, s.
    samples : int
        Number of recorded times, including t = 0 and t = duration.
    grains : "all", "first:last" or list of int
        Recorded grains.
    quantities : list of str, optional
        Quantities that are accumulated during the whole run, also between the recorded samples:
        "peak_displacement", "peak_velocity" and "arrival_time" of every recorded grain, and
        "peak_force:40" and "force:40" of contact 40. "force:40" has enough times to resolve the
        fastest motion. `Trajectory.gathered` contains each quantity with its error.

    Raises
    ------
    InputError
        If the scene has faults. The message lists all of them.

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
        # Compression by an excitation that does not fit the chain cannot be computed.
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
                cure = "A is given in seconds, 1e-9 to 1e-6 for most grains"
                rigid = f"A omega is {turn:.2g}, so that contacts act as rigid dashpots"
                yield f"chain.damping.viscoelastic: {rigid}; {cure}"
        if not self._gentle:
            yield from self._strike_remarks()

    def _strike_remarks(self) -> Iterator[str]:
        """Yield remarks on overlaps beyond Hertz's law, and on grains faster than sound."""
        chain = self.chain
        _, compression = self.first_squeeze
        limit = LIMITS.hertz_compression
        # A chain with such a compression at rest has a remark of its own.
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
        """Draw the excitation over time, or the initial state of the grains; return the axes."""
        waveform = getattr(self.excitation, "waveform", None)
        if waveform:
            name = self.excitation.strength[1]
            unit = "m" if name == "displacement" else "N"
            ax = chart(ax, "time [s]", f"{name}, downward [{unit}]")
            time = np.linspace(0.0, self.duration, DRAWN_POINTS)
            ax.plot(time, waveform.at(time))
            return ax
        return self._plot_start(ax)

    def _plot_start(self, ax: Axes | None) -> Axes:
        """Draw initial displacements and velocities of the excited grains and their neighbours."""
        first, last = self.excitation.reach(self.chain)
        top = max(1, first - DRAWN_AROUND)
        near = np.arange(top, min(self.chain.grains, last + DRAWN_AROUND) + 1)
        fields = zip(("displacement", "velocity"), ("m", "m/s"), self.initial(), strict=True)
        excited = [(name, unit, values) for name, unit, values in fields if values.any()]
        # A single quantity is named on the axis, several in the legend.
        alone = len(excited) == 1
        name = "{} at t = 0, downward [{}]".format(*excited[0]) if alone else "at t = 0, downward"
        ax = chart(ax, "grain, from the top", name)
        for name, unit, values in excited:
            label = "" if alone else f"{name} ({unit})"
            ax.plot(near, values[near - 1], ".-", lw=1, label=label)
        return finish(ax)

    @cached_property
    def finer(self) -> int:
        """Number of fine intervals between two samples for quantities: 1, 2, 3, 4, 6, 8 ...

        Only these numbers are used, so that most scenes of a sweep share the same number.
        """
        if not self.quantities:
            return 1
        needed = self.sampling_phase / GATHERING_TURN
        power = 2 ** max(0, math.ceil(math.log2(needed)))
        # The value 1.5 times the smaller power of 2 is used if it suffices.
        between = 3 * power // 4
        return between if power >= 4 and between >= needed else power

    @property
    def fine(self) -> Scene:
        """The scene that engines solve, with the times and grains that quantities require."""
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
        """The scene without accumulated quantities, for studies of methods."""
        return self.replace(quantities=None) if self.quantities else self

    def initial(self) -> tuple[Array, Array]:
        """Return the displacement (N,) m and velocity (N,) m/s at t = 0."""
        return self.excitation.initial(self.chain)

    @property
    def drive(self) -> Drive | None:
        """The prescribed motion of grain 1 or of the top wall, or None."""
        return self.excitation if isinstance(self.excitation, Drive) else None

    @property
    def damping_remark(self) -> str:
        """The effect of neglecting damping, as text; empty without damping."""
        if not self.chain.damped:
            return ""
        effect = self.damping_effect
        size = f"at most about {100 * effect:.2g} %" if effect < 1 else "up to all of it"
        return f"leaving it out would change the answer by {size}"

    def until(self, time: float) -> Self:
        """Return the scene up to the last sample before a time, s.

        The whole scene is returned if it ends before this time, if no sample is before this time,
        or if the last sample before this time is its first or its last one.
        """
        if time > self.duration:
            return self
        last = int(np.searchsorted(self.time, time)) - 1
        if last <= 0 or last == self.intervals:
            return self
        return self.replace(duration=float(self.time[last]), samples=last + 1)

    @classmethod
    def from_toml(cls, path: str | PathLike[str]) -> Self:
        """Read a scene file; raise `InputError` with every fault in it."""
        return cls(**toml_file.read_fields(path))

    @classmethod
    def from_lammps(
        cls,
        lmp: Any,
        *,
        duration: float,
        samples: int = 101,
        input: str | PathLike[str] | None = None,
        units: str | Sequence[float] | None = None,
        **options: Any,
    ) -> Self:
        """Create the scene of a column in a LAMMPS instance in its current state.

        Positions, radii, masses, velocities and the set of moving grains are read from the
        instance. If both ends of the column are held, their distance determines the load. If there
        is a `fix gravity`, the overlaps of the grains at rest determine gravity. The coefficients
        of contacts cannot be read from LAMMPS, so give the material or the input file.

        Parameters
        ----------
        lmp : lammps.lammps
            An instance that runs on one rank.
        duration : float
            Duration of the scene, s.
        samples : int
            Number of recorded times, including t = 0 and t = duration.
        input : path, optional
            The input file; it is read for contacts, walls, gravity and loads, and not executed. Its
            fixes, at the end of the file or at its last run, must be those of the instance.
        units : str or (length, time, mass), optional
            Unit style of LAMMPS, or its units in m, s and kg. Units are required if the instance
            has units lj.
        options
            In place of an input file: `material`, or `young` (Pa) with `poisson` and `density`
            (kg/m3). Also `diameter` (m) if the grains have no radius.

        Raises
        ------
        InputError
            If the grains are not one column that a scene can describe, or if information is
            missing.
        """
        if unknown := options.keys() - set(RunOptions._fields):
            raise InputError([(key, "is not an option of from_lammps") for key in sorted(unknown)])
        grains = grains_of(lmp, units, read=input is not None)
        source = None
        if input is not None:
            source = LammpsInput(expanded(input), grains, units)
            grains = source.grains()
        given = RunOptions(duration=duration, samples=samples, **options)
        return cls(**infer_scene(grains, source, given).fields)

    @classmethod
    def from_dict(cls, tables: dict[str, Any], folder: Path | None = Path()) -> Self:
        """Create a scene from the tables of a scene file, with CSV files in `folder`.

        Raises `InputError` with every fault. If `folder` is None, the tables must not name files.
        """
        return cls(**toml_file.fields(tables, folder))

    @classmethod
    def from_text(cls, text: str) -> Self:
        """Create a scene from the text of a scene file that refers to no other file.

        Raises `InputError` with every fault, or `ValueError` if the text is not TOML.
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
        """Write a scene file, from which `from_toml` reads an equal scene.

        A file that lmpchain did not write is replaced only if `overwrite` is true; otherwise
        `InputError` is raised.
        """
        with write_aside(path, overwrite) as aside:
            aside.write_text(self.to_text(), encoding="utf-8")


def check_scene(scene: object, key: str = "scene") -> None:
    """Raise `InputError` with this key unless the argument is a scene."""
    if not isinstance(scene, Scene):
        cure = "make one, or read its file with Scene.from_toml"
        raise InputError.at(key, f"must be a Scene (got {shown(scene)}): {cure}")


def _verdict(strike_number: float) -> str:
    """Return the validity of linear theory for a strike number, as text."""
    if strike_number == math.inf:
        return "no contact is compressed: linear theory does not apply"
    if strike_number > ERRS_BY_10_PERCENT:
        return "too strong for linear theory"
    if strike_number < ERRS_BY_1_PERCENT:
        return "weak enough for linear theory"
    return "almost linear"
