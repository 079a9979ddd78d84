"""Work-precision curves: time and force evaluations against true error, as table and chart."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from ..scene.scene import Scene
from ..util.notebook import Shown
from ..util.provenance import processor
from ..util.tables import align, finite, number
from ..util.tabular import NamedColumn, Tabular, of_rows
from .chart import draw
from .comparison import Row
from .pareto import KNOWN as KNOWN
from .pareto import front as front
from .pareto import time_to as time_to
from .reference import Reference

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def machine() -> str:
    """Return the name of the processor and the number of cores that this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{processor()}, {cores} core{'s' if cores != 1 else ''}"


@dataclass(frozen=True)
class Point(Row):
    """Error and cost of one engine at one step or tolerance, the least time of several runs.

    Attributes
    ----------
    tolerance : float or None
        The tolerance, None for a given step.
    setup_s, estimate_s : float
        Time for setting up and for the error estimate, s; not part of `integration_s`.
    seconds : float
        Time in the chart, s: of the integration, with that of the error estimate where a tolerance
        was asked for.
    step_s : float
        s.
    grain_steps_per_s : float
        Force evaluations times computed grains, per second of integration.
    longest : bool
        Whether this is the longest stable step: at longer ones the run breaks down or its error
        exceeds 1.
    pareto : bool
        Whether the point is on the Pareto front: no other is faster and as accurate.
    """

    tolerance: float | None
    setup_s: float
    estimate_s: float
    seconds: float
    step_s: float
    grain_steps_per_s: float
    longest: bool = False
    pareto: bool = False


TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
WITHOUT = "{}, without the estimate"


@dataclass(frozen=True)
class Curve:
    """The points of one engine and integrator, from the cheapest on.

    Attributes
    ----------
    engine, integrator : str
        The integrator is empty where the engine has none or chooses one.
    points : tuple of Point
    """

    engine: str
    integrator: str
    points: tuple[Point, ...]

    @property
    def to_tolerance(self) -> bool:
        """Whether the engine chose the steps itself, to a tolerance."""
        return self.points[0].tolerance is not None

    @property
    def name(self) -> str:
        """Engine, and integrator or "to a tolerance"."""
        choice = "to a tolerance" if self.to_tolerance else self.integrator
        return ", ".join(filter(None, (self.engine, choice)))


@dataclass(frozen=True, eq=False, repr=False)
class WorkPrecision(Shown, Tabular):
    """Work-precision curves of one scene.

    Attributes
    ----------
    scene : Scene
    reference : Reference
    curves : tuple of Curve
    dropped : int
        Points left out because their error is below ten times that of the reference.
    left_out : tuple of str
        Engines that cannot solve the scene, and why.
    versions : dict of str
    machine : str
        Processor, and cores that could be used.
    """

    scene: Scene
    reference: Reference
    curves: tuple[Curve, ...]
    dropped: int
    left_out: tuple[str, ...]
    versions: dict[str, str]
    machine: str = field(default_factory=machine)

    @property
    def points(self) -> list[Point]:
        """All points, curve by curve."""
        return [point for curve in self.curves for point in curve.points]

    def to_json(self) -> dict[str, Any]:
        """Return the points for a JSON file; numbers that are not finite become None."""
        rows = [finite(asdict(point)) for point in self.points]
        reference = {"method": self.reference.method, "error": self.reference.error}
        return {
            "reference": reference,
            "machine": self.machine,
            "versions": self.versions,
            "dropped": self.dropped,
            "rows": rows,
        }

    def table(self, others: Mapping[str, Iterable[tuple[float, float]]] = {}) -> str:
        """Return the time to reach several errors, as text, a line a curve.

        Curves of other codes are given as {name: (seconds, error) ...}.
        """
        curves: dict[str, Iterable[tuple[float, float]]] = {}
        for curve in self.curves:
            # two codes are compared by what both do: integrate
            curves[curve.name] = [(point.seconds, point.error) for point in curve.points]
            if curve.to_tolerance:
                curves[WITHOUT.format(curve.name)] = [
                    (point.integration_s, point.error) for point in curve.points
                ]
        lines = [["time to an error of", *(f"{target:.0e}" for target in TARGETS)]]
        for name, points in (curves | dict(others)).items():
            times = [time_to(target, points) for target in TARGETS]
            lines.append([name, *(number(1e3 * t, unit="ms", missing="-") for t in times)])
        return "\n".join(align(lines))

    def plot(
        self, ax: Axes | Sequence[Axes] | None = None, others: Sequence[Mapping[str, Any]] = ()
    ) -> Axes:
        """Draw error against time, five curves in colour, others in grey, and return the axes.

        Parameters
        ----------
        ax : axes, or three of them, optional
            In one the errors against time alone are drawn; by default, in a figure of their own,
            those against force evaluations too, and the times to reach an error of 1e-6.
        others : sequence of mappings
            Points of other codes: code, error, seconds, force_evaluations (or None).
        """
        return draw(self, ax, others)

    def _columns(self) -> Iterator[NamedColumn]:
        return of_rows([asdict(point) for point in self.points])
