"""The answer: arrays with their provenance, error estimate and cost; in and out of files."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from .engines.base import Cost
from .errors import InputError
from .fields import Array
from .files import check_seal, seal, write_aside
from .scene import Scene

if TYPE_CHECKING:
    import xarray
    from MDAnalysis import Universe

FORMAT = 1
DIMENSIONS = ("time", "grain")
FIELDS = ("displacement", "velocity")
LABELS: dict[str, dict[str, Any]] = {
    "time": {"units": "s", "long_name": "time since the strike"},
    "grain": {"units": "1", "long_name": "number of the grain, from the top"},
    "displacement": {"units": "m", "long_name": "displacement from equilibrium, positive downward"},
    "velocity": {"units": "m s-1", "long_name": "velocity, downward"},
}


@dataclass(frozen=True)
class ErrorEstimate:
    """How far an answer is from the solution of Eq. (1).

    The error is the larger of those of displacement and velocity, each max|x - x_true| / max|x_true|
    over all samples and all grains of the chain.

    Attributes
    ----------
    model : float
        Because the equation solved is not Eq. (1).
    solver : float
        Because it was not solved exactly: step and round-off.
    """

    model: float
    solver: float

    @property
    def total(self) -> float:
        """Both together."""
        return self.model + self.solver


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What an engine answered.

    Attributes
    ----------
    scene : Scene
    engine : str
    equation : int
        Number in the paper of the equation solved.
    time : (T,) array
        s.
    grains : (G,) array
        Numbers of the recorded grains, from 1 at the top.
    displacement, velocity : (T, G) arrays
        From equilibrium, positive downward; m and m/s.
    error_estimate : ErrorEstimate
    cost : Cost
    provenance : dict
        Choices that shaped the answer, and versions.
    """

    scene: Scene
    engine: str
    equation: int
    time: Array
    grains: np.ndarray
    displacement: Array
    velocity: Array
    error_estimate: ErrorEstimate
    cost: Cost
    provenance: dict[str, str] = field(default_factory=dict)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Trajectory):
            return NotImplemented
        mine, theirs = self.__dict__, other.__dict__
        arrays = (*FIELDS, "time", "grains")
        return all(
            np.array_equal(mine[key], theirs[key]) if key in arrays else mine[key] == theirs[key] for key in mine
        )

    __hash__ = None  # type: ignore[assignment]

    def _attributes(self) -> dict[str, Any]:
        """Return what the file says about the whole."""
        known = subject(self.scene, self.engine, self.equation, self.provenance)
        return known | verdict(self.error_estimate, self.cost)

    def _variables(self) -> dict[str, tuple[tuple[str, ...], Any, dict[str, str]]]:
        """Return the dimensions, the values and what the file says of each array."""
        fields = {name: (DIMENSIONS, getattr(self, name), LABELS[name]) for name in FIELDS}
        return {
            "time": (("time",), self.time, LABELS["time"]),
            "grain": (("grain",), self.grains, LABELS["grain"]),
            **fields,
        }

    def to_xarray(self) -> xarray.Dataset:
        """Return a self-describing dataset with the dimensions time and grain; what is on the disk stays there."""
        import xarray

        variables = {
            name: (dimensions, getattr(values, "variable", values), attributes)
            for name, (dimensions, values, attributes) in self._variables().items()
        }
        return xarray.Dataset(variables, attrs=self._attributes())

    def save(self, path: str | PathLike[str]) -> None:
        """Write one NetCDF file; nothing stands under its name until it is whole."""
        import h5netcdf  # xarray would write the same, but takes longer to import than most scenes to answer

        memory = BytesIO()  # HDF5 crashes the process when a disk is full
        with h5netcdf.File(memory, "w") as file:
            file.dimensions = dict(zip(DIMENSIONS, self.displacement.shape, strict=True))
            file.attrs.update(self._attributes())
            for name, (dimensions, values, attributes) in self._variables().items():
                file.create_variable(name, dimensions, data=values).attrs.update(attributes)
        with write_aside(path) as aside, open(aside, "wb") as opened:
            opened.writelines((memory.getbuffer(), seal(memory.getbuffer())))

    def to_extxyz(self, path: str | PathLike[str]) -> None:
        """Write extended XYZ for OVITO, ASE and others: one text file, one frame a sample.

        The columns are species (X), pos and velo in m and m/s with z up and grain 1 at rest at z = 0 (as in a deck), id
        (number of the grain), radius in m, and displacement in m, from equilibrium and positive downward; every number
        is written with all its digits. Nothing stands under the name until the file is whole.
        """
        from .formats.extxyz import write

        write(self, path)

    def universe(self) -> Universe:
        """Return an MDAnalysis Universe of the recorded grains, in SI units; samples are read as they are asked for.

        MDAnalysis holds positions and velocities in single precision, in which a height of 0.1 m has steps of 7e-9 m
        and most waves are lost. They are there to draw and select (z up, grain 1 at rest at z = 0). To measure, take
        the columns that the time step carries besides, in double precision and as in this trajectory: `ts.data`, as
        MDAnalysis does with columns of a LAMMPS dump. Atoms have `ids` (numbers of the grains), `masses` (kg) and
        `radii` (m); times are in s.

        Examples
        --------
        >>> import lmpchain
        >>> chain = lmpchain.Chain(grains=40, diameter=1e-3)
        >>> scene = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1e-6), duration=50e-6)
        >>> t = lmpchain.simulate(scene, engine="native")
        >>> top = t.universe().select_atoms("id 1:5")
        >>> peak = max(ts.data["velocity"][top.indices].max() for ts in top.universe.trajectory)
        >>> bool(peak == t.velocity[:, :5].max())
        True
        """
        from .formats.universe import universe

        return universe(self)

    @classmethod
    def from_dump(
        cls, path: str | PathLike[str], scene: Scene, equilibrium: Sequence[float] | Array | None = None
    ) -> Trajectory:
        """Read a LAMMPS dump as the answer to a scene: of `lmpchain deck`, or of a deck of your own.

        Grains are numbered by their heights in the first frame, from the top, whatever the numbers of their atoms; the
        gaps between them, which the weight narrows, and their velocities tell whether z points up or down.
        Displacements are the column v_phi where there is one (and z points up). Else they are how far a grain has
        fallen from its height at rest; heights leave fewer digits. Nothing is known of the error: its estimate is
        infinite.

        Parameters
        ----------
        path : path
            A text dump, or one compressed by gzip (.gz), in units si, with the columns id x y z vz, or id xu yu zu vz,
            and v_phi if it can be had, in any order, and a frame a sample of the scene.
        scene : Scene
            The one that the dump was made for.
        equilibrium : (N,) array, optional
            Heights z of the grains at rest, m, from the top. By default they follow from the first frame, which
            differs from rest by the displacement that the scene starts with.

        Raises
        ------
        InputError
            If it cannot be read, or is not of this scene.
        """
        from .formats.dumps import read

        return read(path, scene, equilibrium)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Trajectory:
        """Read a file that `save` wrote, or a run folder; raises `InputError` for anything else.

        The arrays of a run folder stay on the disk: what is indexed is read. Of a run that is not finished, the samples
        are there that are complete, and the estimate of the error is infinite.
        """
        import xarray

        from .runs.store import NAME, OnDisk, open_dataset
        from .scenefile import loads

        path = Path(path)
        folder = os.path.isdir(path)  # which no name makes raise
        if folder and not (path / NAME).is_dir():
            raise InputError([(str(path), "is a folder without a run in it, or with one that has no samples yet")])
        if not folder and not os.path.isfile(path):
            raise InputError([(str(path), "there is no such file")])
        try:
            if not folder:
                check_seal(path)
            data = open_dataset(path) if folder else xarray.load_dataset(path, engine="h5netcdf", decode_times=False)
            if data.attrs["lmpchain_format"] != FORMAT:
                raise ValueError("of another version")
            scene = loads(data.attrs["scene"])
            shape = (data.sizes["time"] if folder else scene.samples, scene.recorded.size)
            if any(data[name].shape != shape for name in FIELDS):
                raise ValueError(f"its arrays are not {shape[0]} samples of {shape[1]} grains")
            if not (
                np.array_equal(data["time"], scene.time[: shape[0]]) and np.array_equal(data["grain"], scene.recorded)
            ):
                raise ValueError("its times or grains are not those of its scene")
            fields = {name: OnDisk(data[name].variable) if folder else data[name].to_numpy() for name in FIELDS}
            estimate = ErrorEstimate(float(data.attrs["model_error"]), float(data.attrs["solver_error"]))
            return cls(
                scene=scene,
                engine=data.attrs["engine"],
                equation=int(data.attrs["equation"]),
                time=data["time"].to_numpy(),
                grains=data["grain"].to_numpy(),
                error_estimate=estimate,
                cost=Cost(**json.loads(data.attrs["cost"])),
                provenance=json.loads(data.attrs["provenance"]),
                **cast(Mapping[str, Array], fields),
            )
        except Exception as error:  # whatever a damaged file makes the readers raise
            raise InputError(
                [(str(path), f"is not a trajectory that lmpchain saved, or is cut short ({error})")]
            ) from None


def subject(scene: Scene, engine: str, equation: int, provenance: Mapping[str, str]) -> dict[str, Any]:
    """Return what a file says of an answer that is still to come."""
    from .scenefile import dumps

    return {
        "title": "Displacement and velocity of the grains of a chain",
        "lmpchain_format": FORMAT,
        "engine": engine,
        "equation": equation,
        "scene": dumps(scene),
        "provenance": json.dumps(dict(provenance)),
    }


def verdict(error: ErrorEstimate, cost: Cost) -> dict[str, Any]:
    """Return what a file says of how good an answer is and what it cost."""
    return {
        "model_error": error.model,
        "solver_error": error.solver,
        "error_definition": "max|x - x_true| / max|x_true| over all samples and grains, the larger of "
        "displacement and velocity, x_true the solution of Eq. (1)",
        "cost": json.dumps(asdict(cost)),
    }
