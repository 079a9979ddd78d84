"""Trajectories with provenance, error estimate and cost, and their file formats."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from ..errors import InputError, short
from ..scene.scene import Scene
from ..util.arrays import Array, as_slice
from ..util.files import expanded
from ..util.notebook import Shown
from ..util.plotting import chart, draw_map, thin_rows
from ..util.tables import counted
from ..util.tabular import Tabular
from .other_formats import describe_other_format
from .record import Record, read_result, select_gathered

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from MDAnalysis import Universe

UNITS_OF_FIELDS = {"velocity": "m/s", "displacement": "m"}
MOVING = 1e-3  # Fraction of the largest motion below which a grain counts as at rest.


def draw_motion(
    trajectory: Record, field: Literal["velocity", "displacement"], ax: Axes | None
) -> Axes:
    """Draw the motion over time and depth; see `Trajectory.plot`."""
    from matplotlib.ticker import MaxNLocator

    ax = chart(ax, "time [s]", "grain, from the top")
    order = as_slice(np.argsort(trajectory.grains))
    # A picture has fewer columns than the trajectory has samples.
    stride = -(-trajectory.time.size // 4000)
    time = trajectory.time[::stride]
    motion = np.asarray(getattr(trajectory, field)[::stride])[:, order]
    rows, drawn = thin_rows(trajectory.grains[order], motion.T)
    limit = scale(motion)
    label = f"{field}, downward [{UNITS_OF_FIELDS[field]}]"
    colours: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
    draw_map(ax, time, rows, drawn, label, extend="both", **colours)
    ax.set(xlim=time[[0, -1]], ylim=ax.get_ylim()[::-1])
    ax.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    return ax


def scale(motion: Array) -> float:
    """Return the median peak of the moving grains, at which colours saturate."""
    largest = np.abs(motion).max(0)
    return float(np.median(largest[largest > MOVING * largest.max()])) if largest.any() else 1.0


DRAWN_VALUES = 4_000_000  # A notebook shows larger trajectories without a picture.


class Trajectory(Shown, Record, Tabular):
    """The solution of a scene by an engine: the arrays of `Record` with file formats.

    Attributes
    ----------
    scene : Scene
        Scene that was solved.
    engine : str
        Name of the engine.
    equation : int
        Number in the paper of the equation that was solved.
    time : (T,) array
        Times of the samples, s.
    grains : (G,) array
        Numbers of the recorded grains, from 1 at the top.
    displacement : (T, G) array
        Displacement of the grains from equilibrium, positive downward, m.
    velocity : (T, G) array
        Velocity of the grains, positive downward, m/s.
    error_estimate : ErrorEstimate
        Estimated error of displacements and velocities.
    cost : Cost
        Computing time and number of steps.
    provenance : dict
        Choices that affect the solution, and versions of the software.
    gathered : dict
        Values of the `quantities` of the scene by name, and their errors under the same names with
        "_error". Quantities of grains are (G,) arrays, quantities of contacts are numbers, and
        forces over time are (D,) arrays at the times "fine_time". For a damped chain, engines with
        time steps add "dissipated" and, with a force or drive, "drive", (T,) arrays in J; see
        `measure.energy.ledger`.
    """

    _units: ClassVar[dict[str, str]] = {"time": "s", "displacement": "m", "velocity": "m/s"}
    _numbers: ClassVar[str] = "grains"

    def __repr__(self) -> str:
        size = f"{self.time.size} samples x {counted(self.grains.size, 'grain')}"
        return (
            f"Trajectory({self.engine}, Eq. ({self.equation}), {size}, error "
            f"{self.error_estimate.total:.2g})"
        )

    def _summary(self) -> Iterator[Sequence[str]]:
        scene = self.scene
        error = self.error_estimate
        cost = self.cost
        yield "scene", f"{counted(scene.chain.grains, 'grain')}, {scene.excitation.label}"
        yield "engine", f"{self.engine}, which solves Eq. ({self.equation})"
        yield (
            "recorded",
            f"{self.time.size} times to {scene.duration:g} s, {counted(self.grains.size, 'grain')}",
        )
        yield (
            "error estimate",
            f"{error.total:.2g} = {error.model:.2g} (model) + {error.solver:.2g} (solver)"
            f"{error.remark}",
        )
        if scene.chain.damped:
            yield "damping", scene.damping_remark
        steps = counted(cost.steps, "step")
        if cost.integrator:
            steps = f"{cost.steps_over(scene.duration)} by {cost.integrator}"
        computed = counted(cost.active_grains, "grain")
        yield "cost", f"{cost.total_s:.3g} s, {steps}, {computed} computed"

    def _picture(self) -> str:
        return super()._picture() if self.time.size * self.grains.size <= DRAWN_VALUES else ""

    def plot(
        self, ax: Axes | None = None, field: Literal["velocity", "displacement"] = "velocity"
    ) -> Axes:
        """Draw the motion over time and depth, downward in red, upward in blue; return the axes.

        The colours saturate at the median of the largest values of the grains that move, so that
        the wave remains visible after it has become weak.

        Parameters
        ----------
        ax : axes, optional
            Axes to draw in; by default those of a new figure.
        field : "velocity" or "displacement"
            Field to draw.
        """

        return draw_motion(self, field, ax)

    def to_xarray(self) -> xarray.Dataset:
        """Return a labelled dataset over time and grain; stored arrays stay on disk."""
        import xarray

        variables = {
            name: (dimensions, getattr(values, "variable", values), attributes)
            for name, (dimensions, values, attributes) in self.variables().items()
        }
        return xarray.Dataset(variables, attrs=self.attributes())

    def save(self, path: str | PathLike[str], overwrite: bool = False) -> None:
        """Write a NetCDF file, atomically.

        A file that lmpchain did not write is replaced only if `overwrite` is true; otherwise
        `InputError` is raised.
        """
        from .netcdf import write_netcdf

        write_netcdf(self, path, overwrite)

    def to_extxyz(self, path: str | PathLike[str], overwrite: bool = False) -> None:
        """Write extended XYZ for OVITO, ASE and others: one text file with a frame per sample.

        The columns are species (X), pos (m) and velo (m/s), id (number of the grain), radius (m),
        masses (kg), displacement (m, from equilibrium, positive downward), and momenta (kg m/s).
        The z axis points up, and grain 1 is at z = 0 at rest, as in a deck. Every number is written
        with all its digits.

        OVITO reads velocities from velo. ASE computes them from momenta and masses, so that
        `get_velocities` returns m/s; all values are in SI units, not in the units of ASE. The other
        columns are in the `arrays` of an ASE frame.

        The file is written atomically. A file that lmpchain did not write is replaced only if
        `overwrite` is true; otherwise `InputError` is raised.
        """
        from .other_formats import write_extxyz

        write_extxyz(self, path, overwrite)

    def universe(self) -> Universe:
        """Return an MDAnalysis Universe of the recorded grains, in SI units, read on demand.

        MDAnalysis stores positions and velocities in single precision. Single precision resolves a
        height of 0.1 m to 7e-9 m, and most waves are smaller. Use these positions only to draw and
        to select grains; the z axis points up, and grain 1 is at z = 0 at rest. For measurements,
        use the displacement and velocity in `ts.data`, which are in double precision and equal to
        this trajectory. Atoms have `ids` (numbers of the grains), `masses` (kg) and `radii` (m);
        times are in s.

        Examples
        --------
        >>> import lmpchain
        >>> chain = lmpchain.Chain(grains=40, diameter=1e-3)
        >>> strike = lmpchain.Impulse(velocity=1e-6)
        >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=50e-6)
        >>> t = lmpchain.simulate(scene, engine="native")
        >>> top = t.universe().select_atoms("id 1:5")
        >>> peak = max(ts.data["velocity"][top.indices].max() for ts in top.universe.trajectory)
        >>> bool(peak == t.velocity[:, :5].max())
        True
        """
        from .mdanalysis import make_universe

        return make_universe(self)

    @classmethod
    def from_dump(
        cls,
        path: str | PathLike[str],
        scene: Scene,
        equilibrium: Sequence[float] | Array | None = None,
        axis: str | None = None,
        units: str | Sequence[float] | None = None,
    ) -> Trajectory:
        """Read a LAMMPS dump of `lmpchain deck` or another deck as the trajectory of a scene.

        Grains are numbered from the top by their heights in the first frame; the numbers of atoms
        do not matter. The axis of the column is the one along which the grains are farthest apart.
        Its direction, up or down, follows from the distances between grains, which decrease with
        the weight above, and from the velocities.

        Displacements are read from the column v_phi if there is one; with z, it points up.
        Otherwise they are the differences of the heights from the heights at rest. Heights have
        fewer significant digits, and `provenance["precision"]` states the resulting uncertainty.
        The error of the trajectory is unknown, and its estimate is infinite.

        If a restarted run wrote a frame twice, the last one is used. Incomplete frames are ignored.
        A dump of another scene is rejected: distances, overlaps, velocities, radii and masses in
        the first frame must agree with the scene. If the samples resolve the motion, changes of
        displacements must also agree with the velocities, and changes of velocities with the
        forces.

        Parameters
        ----------
        path : path
            A text dump, possibly compressed by gzip (.gz), with one frame for each sample of the
            scene. The columns id, x y z or xu yu zu, and vz are required, in any order; vx or vy
            replaces vz if the column stands along x or y. The column v_phi is recommended. In a
            periodic box, write xu yu zu, or the image flags ix iy iz with x y z. The lines that
            dump_modify units and time add are read, too.
        scene : Scene
            Scene for which the dump was made.
        equilibrium : (N,) array, optional
            Heights z of the grains at rest, m, from the top. By default they are computed from the
            first frame, which differs from rest by the initial displacements of the scene.
        axis : "x", "y" or "z", optional
            Axis of the column; needed only if the first frame does not determine it.
        units : str or (length, time, mass), optional
            Unit style of LAMMPS, or the units in m, s and kg, which are needed for the style lj. By
            default the units that the dump states, or si.

        Raises
        ------
        InputError
            If the dump cannot be read, or does not belong to the scene.
        """
        from .lammps_dump import read_dump

        return cls(**vars(read_dump(path, scene, equilibrium, axis, units)))

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Trajectory:
        """Read a file written by `save`, or a run folder; raise `InputError` for other files.

        The arrays of a run folder remain on disk and are read on demand. For an unfinished run, the
        complete samples are returned. The error estimate is then the one so far, relative to the
        motion so far, or infinite if there is none.
        """
        from . import netcdf, zarr_store

        path = expanded(path)
        # `os.path.isdir` never raises.
        folder = os.path.isdir(path)
        if folder and not (path / zarr_store.NAME).is_dir():
            raise InputError.at(
                str(path), "is a folder that contains no run, or a run without samples so far"
            )
        if not folder and not os.path.isfile(path):
            device = os.path.lexists(path)
            raise InputError.at(
                str(path),
                "is a device or a pipe, not a file" if device else "there is no such file",
            )
        if not folder and (fault := describe_other_format(path)):
            raise InputError.at(str(path), fault)
        try:
            attributes, scene, arrays = (
                zarr_store.read_zarr(path) if folder else netcdf.read_netcdf(path)
            )
            time = arrays["time"]
            if not np.array_equal(time, scene.time[: time.size]):
                raise ValueError("its times differ from those of its scene")
            if not np.array_equal(arrays["grain"], scene.recorded):
                raise ValueError("its grains differ from those of its scene")
            return cls(
                scene=scene,
                time=time,
                grains=arrays["grain"],
                displacement=arrays["displacement"],
                velocity=arrays["velocity"],
                gathered=select_gathered(scene, arrays),
                **read_result(attributes),
            )
        except Exception as error:
            # Readers of damaged files raise any kind of error.
            raise InputError.at(
                str(path),
                f"is not a trajectory that lmpchain saved, or is cut short ({short(error)})",
            ) from None
