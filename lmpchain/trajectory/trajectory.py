"""Trajectories with provenance, error estimate and cost, and their file formats."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from os import PathLike
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from ..errors import InputError, short
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.files import expanded
from ..util.notebook import Shown
from ..util.tables import counted
from ..util.tabular import Tabular
from .other_formats import describe_other_format
from .record import Record, read_result, select_gathered

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from MDAnalysis import Universe

DRAWN_VALUES = 4_000_000  # A notebook shows larger trajectories without a picture.


class Trajectory(Shown, Record, Tabular):
    """The solution of a scene by an engine: the arrays of `Record` with file formats.

    Attributes
    ----------
    scene : Scene
    engine : str
    equation : int
        Number in the paper of the equation solved.
    time : (T,) array
        Times, s.
    grains : (G,) array
        Numbers of the recorded grains, from 1 at the top.
    displacement, velocity : (T, G) arrays
        Motion from equilibrium, positive downward; m and m/s.
    error_estimate : ErrorEstimate
    cost : Cost
    provenance : dict
        Choices that shaped the solution, and versions.
    gathered : dict
        The `quantities` of the scene by name, and their errors, by name with "_error":
        (G,) arrays of grains, numbers of contacts, and forces over "fine_time", (D,). Of a chain
        with damping, runs that move by steps add "dissipated" and, with a force or drive, "drive",
        (T,) J: see `measure.energy.ledger`.
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

        The colours saturate at the median of the largest sizes of the grains that move, so that the
        wave can be seen where it has become weak.

        Parameters
        ----------
        ax : axes, optional
            By default those of a new figure.
        field : "velocity" or "displacement"
        """
        from .picture import draw_motion

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

        The columns are species (X), pos and velo in m and m/s with z up and grain 1 at rest at z =
        0 (as in a deck), id (number of the grain), radius in m, masses in kg, displacement in m,
        from equilibrium and positive downward, and momenta in kg m/s; every number is written with
        all its digits. OVITO takes velocities from velo. ASE takes them from momenta and masses:
        `get_velocities` returns m/s, as all of the file is in SI units, and not in those of ASE.
        The other columns are in its `arrays`. The file is written atomically. A file that lmpchain
        did not write is replaced only if `overwrite` is true.
        """
        from .other_formats import write_extxyz

        write_extxyz(self, path, overwrite)

    def universe(self) -> Universe:
        """Return an MDAnalysis Universe of the recorded grains, in SI units, read on demand.

        MDAnalysis holds positions and velocities in single precision, in which a height of 0.1 m
        has steps of 7e-9 m and most waves are lost. They are there to draw and select (z up, grain
        1 at rest at z = 0). To measure, take the columns that the time step carries besides, in
        double precision and as in this trajectory: `ts.data`, as MDAnalysis does with columns of a
        LAMMPS dump. Atoms have `ids` (numbers of the grains), `masses` (kg) and `radii` (m); times
        are in s.

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

        Grains are numbered by their heights in the first frame, from the top, whatever the numbers
        of their atoms. The column stands along the axis on which they are farthest apart; the gaps
        between them, which the weight narrows, and their velocities tell whether that axis points
        up or down. Displacements are the column v_phi where there is one (with z, it points up).
        Else they are how far a grain has fallen from its height at rest; heights leave fewer
        digits, and `provenance["precision"]` says what they leave unknown. The error is unknown:
        its estimate is infinite.

        Frames that a restarted run wrote twice are read once, the last time; a frame that a kill
        cut short, not at all. A dump of another scene is refused: distances, overlaps, velocities,
        radii and masses of the first frame must be those of the chain, and where samples resolve
        the motion, displacements must change as velocities say, and velocities as forces do.

        Parameters
        ----------
        path : path
            A text dump, or one compressed by gzip (.gz), with the columns id x y z, or
            id xu yu zu, and vz (vx, vy for a column along x, y), and v_phi if it can be had, in any
            order; a frame a sample of the scene. Of a periodic box, xu yu zu or image flags ix iy
            iz beside x y z; the lines of dump_modify units and time are read, too.
        scene : Scene
            The one that the dump was made for.
        equilibrium : (N,) array, optional
            Heights z of the grains at rest, m, from the top. By default they follow from the first
            frame, which differs from rest by the displacement that the scene starts with.
        axis : "x", "y" or "z", optional
            Along which the column stands, if the first frame does not say it.
        units : str or (length, time, mass), optional
            The unit style of LAMMPS, or its units in m, s and kg (of lj, which has no scale of its
            own). By default what the dump says, or si.

        Raises
        ------
        InputError
            If it cannot be read, or is not of this scene.
        """
        from .lammps_dump import read_dump

        return cls(**vars(read_dump(path, scene, equilibrium, axis, units)))

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Trajectory:
        """Read a file written by `save`, or a run folder; raise `InputError` for other files.

        The arrays of a run folder stay on the disk and are read on demand. Of an unfinished run,
        the complete samples are returned with the error estimate so far, relative to the motion so
        far, or infinite if that is not known.
        """
        from . import netcdf, zarr_store

        path = expanded(path)
        # `os.path.isdir` never raises.
        folder = os.path.isdir(path)
        if folder and not (path / zarr_store.NAME).is_dir():
            raise InputError.at(
                str(path), "is a folder without a run in it, or with one that has no samples yet"
            )
        if not folder and not os.path.isfile(path):
            device = os.path.lexists(path)
            raise InputError.at(
                str(path),
                "is no file, but a device or a pipe" if device else "there is no such file",
            )
        if not folder and (fault := describe_other_format(path)):
            raise InputError.at(str(path), fault)
        try:
            attributes, scene, arrays = (
                zarr_store.read_zarr(path) if folder else netcdf.read_netcdf(path)
            )
            time = arrays["time"]
            if not np.array_equal(time, scene.time[: time.size]):
                raise ValueError("its times are not those of its scene")
            if not np.array_equal(arrays["grain"], scene.recorded):
                raise ValueError("its grains are not those of its scene")
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
