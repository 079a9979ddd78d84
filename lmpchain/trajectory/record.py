"""The data of a trajectory: samples, error estimate, cost, and the metadata of its files."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.tables import counted
from . import gathered

FORMAT = 1  # Version of the file format.
DIMENSIONS = ("time", "grain")
FIELDS = ("displacement", "velocity")
ROUNDED = 1e-9  # Rounding tolerance relative to the duration, by which equal steps may exceed it.
# An error of 2 means that nothing is known, because two motions differ by at most twice the larger
# one.
LARGEST_ERROR = 2.0
DATA_TYPES = {"grain": "int64"}  # All other arrays are of type float64.
# Metadata of a file.
ATTRIBUTES = (
    "lmpchain_format",
    "engine",
    "equation",
    "scene",
    "provenance",
    "model_error",
    "solver_error",
    "cost",
)
LABELS: dict[str, dict[str, Any]] = {
    "time": {"units": "s", "long_name": "time since the strike"},
    "grain": {"units": "1", "long_name": "number of the grain, from the top"},
    "displacement": {"units": "m", "long_name": "displacement from equilibrium, positive downward"},
    "velocity": {"units": "m s-1", "long_name": "velocity, downward"},
}


@dataclass(frozen=True)
class ErrorEstimate:
    """Estimated relative error against the exact solution of Eq. (1): model and solver.

    The error of the displacement is the largest ``|x - x_true|`` of all samples and grains, divided
    by the largest ``|x_true|`` of any grain at any time of the run, also between samples. The error
    of the velocity is defined in the same way, and the estimate is the larger of the two errors. If
    nothing moves, displacements are divided by the overlap of the first contact at rest, and
    velocities by this overlap times the frequency of the first grain; by 1 m and 1 m/s if there is
    no overlap.

    The estimate is at most 2, because two motions differ by at most twice the larger one. An
    estimate of 2 means that the solution may be completely wrong. The estimate is 0 only if no
    recorded grain can move, and infinite only if no error was estimated.

    Attributes
    ----------
    model : float
        Error of the equation that was solved; 0 for Eq. (1).
    solver : float
        Error of the numerical solution of this equation, by time steps and round-off.
    """

    model: float
    solver: float

    @property
    def total(self) -> float:
        """Model error plus solver error, at most 2."""
        return min(self.model + self.solver, max(self.model, self.solver, LARGEST_ERROR))

    @property
    def remark(self) -> str:
        """Explanation of an estimate of 0 or 2; empty for other values."""
        if self.total == 0:
            return ", because no recorded grain can move"
        if LARGEST_ERROR <= self.total < math.inf:
            return ", the largest possible value: nothing is known about the solution"
        return ""


class Cost(NamedTuple):
    """Computing time, steps and force evaluations of a trajectory.

    The native engine advances the main run together with its auxiliary runs. Their common time is
    divided into `integration_s` and `estimate_s` in proportion to the numbers of steps.

    Attributes
    ----------
    integration_s : float
        Wall time of the main run, s.
    estimate_s : float
        Wall time of the error estimate, s.
    setup_s : float
        Wall time before the first step, s.
    steps : int
        Number of steps of the main run.
    force_evaluations : int
        Number of evaluations of all forces in the main run.
    active_grains : int
        Number of grains that were computed.
    integrator : str
        Name of the integration method.
    step_s : float
        Largest step, s.
    ranks : int
        Number of processes.
    compile_s : float
        Wall time of compiling machine code or loading it, s. No other time includes it.
    """

    integration_s: float
    estimate_s: float
    setup_s: float
    steps: int
    force_evaluations: int
    active_grains: int
    integrator: str
    step_s: float
    ranks: int
    compile_s: float = 0.0

    @property
    def total_s(self) -> float:
        """Total wall time without compilation, s."""
        return self.integration_s + self.estimate_s + self.setup_s

    def steps_over(self, duration: float) -> str:
        """Return the number and the length of the steps of a run of this duration, s, as text.

        Examples
        --------
        >>> cost = Cost(0.0, 0.0, 0.0, 100, 300, 10, "verlet", 1e-6, 1)
        >>> cost.steps_over(1e-4)
        '100 steps of 1e-06 s'
        >>> cost.steps_over(5e-5)
        '100 steps of 5e-07 s on average, 1e-06 s at most'
        """
        return steps_over(self.steps, self.step_s, duration)


def steps_over(count: int, step: float, duration: float) -> str:
    """Return the number and length of a run's steps as text; `step` is the largest, s."""
    steps = counted(count, "step")
    # Adaptive steps are shorter while contacts open and close.
    if count * step > duration * (1 + ROUNDED):
        return f"{steps} of {duration / count:.4g} s on average, {step:.4g} s at most"
    return f"{steps} of {step:.4g} s"


class Block(NamedTuple):
    """A block of the solution: realisations, samples and recorded grains.

    A block without samples allows the caller to show progress or to stop the engine.

    Attributes
    ----------
    samples : slice
        Numbers of the samples.
    displacement : (R, B, C) array
        Displacements of R realisations, m.
    velocity : (R, B, C) array
        Velocities of R realisations, m/s.
    columns : slice or array
        Columns of the C grains among all recorded grains. The other recorded grains are still at
        rest.
    resumable : bool
        Whether the caller may store the state of the run after a block without samples.
    """

    samples: slice
    displacement: Array
    velocity: Array
    columns: slice | NDArray[np.intp] = slice(None)
    resumable: bool = False


@dataclass(frozen=True, eq=False)
class Record:
    """The solution of a scene by an engine, with the fields of `lmpchain.Trajectory`."""

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
    gathered: dict[str, Array] = field(default_factory=dict)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Record):
            return NotImplemented
        if self.gathered.keys() != other.gathered.keys():
            return False
        arrays = (*FIELDS, "time", "grains")
        values = (name for name in vars(self) if name not in (*arrays, "gathered"))
        return (
            all(getattr(self, name) == getattr(other, name) for name in values)
            and all(np.array_equal(getattr(self, name), getattr(other, name)) for name in arrays)
            and all(
                np.array_equal(array, other.gathered[name], equal_nan=True)
                for name, array in self.gathered.items()
            )
        )

    __hash__ = None  # type: ignore[assignment]

    def attributes(self) -> dict[str, Any]:
        """Return the metadata of the file."""
        known_before = subject(self.scene, self.engine, self.equation, self.provenance)
        return known_before | verdict(self.error_estimate, self.cost)

    def variables(self) -> dict[str, tuple[tuple[str, ...], Any, dict[str, str]]]:
        """Return dimensions, values and metadata of each array."""
        fields = {name: (DIMENSIONS, getattr(self, name), LABELS[name]) for name in FIELDS}
        return {
            "time": (("time",), self.time, LABELS["time"]),
            "grain": (("grain",), self.grains, LABELS["grain"]),
            **fields,
            **gathered.variables(self.scene, self.gathered),
        }


def subject(
    scene: Scene, engine: str, equation: int, provenance: Mapping[str, str]
) -> dict[str, Any]:
    """Return the metadata known before a run: scene, engine and provenance."""
    return {
        "title": "Displacement and velocity of the grains of a chain",
        "lmpchain_format": FORMAT,
        "engine": engine,
        "equation": equation,
        "scene": scene.to_text(),
        "provenance": json.dumps(dict(provenance)),
    }


def verdict(error: ErrorEstimate, cost: Cost) -> dict[str, Any]:
    """Return the metadata known after a run: error estimate and cost."""
    return {
        "model_error": error.model,
        "solver_error": error.solver,
        "error_definition": "max|x - x_true| over all samples and grains / max|x_true| of any grain"
        " at any time of the run, the larger of displacement and velocity, x_true the solution of "
        "Eq. (1); at most 2, which means that nothing is known",
        "cost": json.dumps(cost._asdict()),
    }


def read_scene(attributes: Mapping[str, Any]) -> Scene:
    """Return the scene in the metadata of a file; raise `ValueError` if the metadata has none."""
    if attributes["lmpchain_format"] != FORMAT:
        raise ValueError("it was written by another version of lmpchain")
    return Scene.from_text(attributes["scene"])


def shapes(scene: Scene, present: Collection[str]) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the arrays of a scene by name, without allocating them.

    Arrays of energies are included only if `present`, the names in the file, contains them.
    """
    samples = scene.samples
    grains = scene.count(scene.chain)
    optional = gathered.energies(scene).keys() - set(present)
    extra = {
        gathered.file_name(name): layout.shape
        for name, layout in gathered.arrays(scene).items()
        if name not in optional
    }
    return {
        "time": (samples,),
        "grain": (grains,),
        **dict.fromkeys(FIELDS, (samples, grains)),
        **extra,
    }


def select_gathered(scene: Scene, arrays: Mapping[str, Any]) -> dict[str, Array]:
    """Return the accumulated quantities of a scene from the arrays of a file, by name."""
    return {
        name: arrays[gathered.file_name(name)]
        for name in gathered.arrays(scene)
        if gathered.file_name(name) in arrays
    }


def read_result(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return engine, equation, error, cost and provenance; raise `ValueError` if invalid."""
    error = ErrorEstimate(float(attributes["model_error"]), float(attributes["solver_error"]))
    cost = json.loads(attributes["cost"])
    provenance = json.loads(attributes["provenance"])
    engine = attributes["engine"]
    equation = attributes["equation"]
    # JSON may store the float 1.0 as 1.
    kinds: dict[Any, Any] = {float: int | float, int: int, str: str}
    if not (error.model >= 0 and error.solver >= 0):
        raise ValueError("its error estimate must be a non-negative number")
    if not all(isinstance(cost[name], kinds[kind]) for name, kind in get_type_hints(Cost).items()):
        raise ValueError("its cost does not consist of numbers")
    if not isinstance(engine, str) or not isinstance(equation, int | float):
        raise ValueError("its engine or equation is invalid")
    if not all(isinstance(value, str) for value in dict(provenance).values()):
        raise ValueError("its provenance does not consist of text")
    return {
        "engine": engine,
        "equation": int(equation),
        "error_estimate": error,
        "cost": Cost(**cost),
        "provenance": provenance,
    }
