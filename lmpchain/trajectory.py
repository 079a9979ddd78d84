"""The answer: arrays with their provenance, error estimate and cost; in and out of files."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .engines.base import Cost
from .errors import InputError
from .fields import Array
from .files import write_aside
from .scene import Scene

if TYPE_CHECKING:
    import xarray

FORMAT = 1


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
        return all(
            np.array_equal(mine[key], theirs[key]) if isinstance(mine[key], np.ndarray) else mine[key] == theirs[key]
            for key in mine
        )

    __hash__ = None  # type: ignore[assignment]

    def to_xarray(self) -> xarray.Dataset:
        """Return a self-describing dataset with the dimensions time and grain."""
        import xarray

        from .scenefile import dumps

        attributes = {
            "title": "Displacement and velocity of the grains of a chain",
            "lmpchain_format": FORMAT,
            "engine": self.engine,
            "equation": self.equation,
            "model_error": self.error_estimate.model,
            "solver_error": self.error_estimate.solver,
            "error_definition": "max|x - x_true| / max|x_true| over all samples and grains, the larger of "
            "displacement and velocity, x_true the solution of Eq. (1)",
            "scene": dumps(self.scene),
            "cost": json.dumps(asdict(self.cost)),
            "provenance": json.dumps(self.provenance),
        }
        return xarray.Dataset(
            {
                "displacement": (
                    ("time", "grain"),
                    self.displacement,
                    {"units": "m", "long_name": "displacement from equilibrium, positive downward"},
                ),
                "velocity": (("time", "grain"), self.velocity, {"units": "m s-1", "long_name": "velocity, downward"}),
            },
            {
                "time": ("time", self.time, {"units": "s", "long_name": "time since the strike"}),
                "grain": ("grain", self.grains, {"units": "1", "long_name": "number of the grain, from the top"}),
            },
            attributes,
        )

    def save(self, path: str | PathLike[str]) -> None:
        """Write one NetCDF file; nothing stands under its name until it is whole."""
        data = self.to_xarray()
        with write_aside(path) as aside:
            data.to_netcdf(aside, engine="h5netcdf")

    @classmethod
    def from_dump(cls, path: str | PathLike[str], scene: Scene) -> Trajectory:
        """Read a LAMMPS dump as the answer to a scene, such as the one that `lmpchain deck` lets LAMMPS write.

        Displacements are the column v_phi where there is one. Else they are how far the height z has fallen since the
        first frame, which must show the chain as the scene starts it, added to the displacement that the scene starts
        with; heights leave fewer digits. Nothing is known of the error: its estimate is infinite.

        Parameters
        ----------
        path : path
            A text dump with the columns id x y z vz, and v_phi if it can be had; a frame a sample of the scene.
        scene : Scene
            The one that the dump was made for.

        Raises
        ------
        InputError
            If it cannot be read, or is not of this scene.
        """
        from .dumps import read

        return read(path, scene)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Trajectory:
        """Read a file that `save` wrote; raises `InputError` for any other."""
        import xarray

        from .scenefile import loads

        path = Path(path)
        if not path.is_file():
            raise InputError([(str(path), "is a folder" if path.is_dir() else "there is no such file")])
        try:
            with xarray.open_dataset(path, engine="h5netcdf", decode_times=False) as opened:
                data = opened.load()
            if data.attrs["lmpchain_format"] != FORMAT:
                raise ValueError("of another version")
            scene = loads(data.attrs["scene"])
            shape = (scene.samples, scene.recorded.size)
            if any(data[name].shape != shape for name in ("displacement", "velocity")):
                raise ValueError(f"its arrays are not {shape[0]} samples of {shape[1]} grains")
            estimate = ErrorEstimate(float(data.attrs["model_error"]), float(data.attrs["solver_error"]))
            return cls(
                scene=scene,
                engine=data.attrs["engine"],
                equation=int(data.attrs["equation"]),
                time=data["time"].to_numpy(),
                grains=data["grain"].to_numpy(),
                displacement=data["displacement"].to_numpy(),
                velocity=data["velocity"].to_numpy(),
                error_estimate=estimate,
                cost=Cost(**json.loads(data.attrs["cost"])),
                provenance=json.loads(data.attrs["provenance"]),
            )
        except Exception as error:  # whatever a damaged file makes the readers raise
            raise InputError(
                [(str(path), f"is not a trajectory that lmpchain saved, or is cut short ({error})")]
            ) from None
