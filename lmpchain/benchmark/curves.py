"""Work-precision curves: time and force evaluations against true error, as table and chart."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

from ..scene.scene import Scene
from ..util.notebook import Shown
from ..util.plotting import Axes
from ..util.provenance import processor
from ..util.tables import align, duration, finite, number
from ..util.tabular import NamedColumn, Tabular, of_rows
from .chart import KNOWN as KNOWN
from .chart import draw
from .chart import front as front
from .chart import time_to as time_to
from .comparison import ComparisonRow
from .reference import Reference


def machine() -> str:
    """Return the name of the processor and the number of cores that this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{processor()}, {cores} core{'s' if cores != 1 else ''}"


@dataclass(frozen=True)
class CurvePoint(ComparisonRow):
    """Error and cost of one engine at one step or tolerance; the time is the least of several runs.

    Attributes
    ----------
    tolerance : float or None
        Requested tolerance; None for a given step.
    setup_s, estimate_s : float
        Time for setting up, s; time for the error estimate, s. `integration_s` includes neither.
    seconds : float
        Time in the chart, s: the integration time, and with a tolerance also the time of the error
        estimate.
    step_s : float
        Time step, s.
    grain_steps_per_s : float
        Number of force evaluations times number of computed grains, per second of integration.
    longest : bool
        Whether this is the longest stable step: at longer ones the run breaks down or its error
        exceeds 1.
    pareto : bool
        Whether the point is on the Pareto front: no other point is faster and as accurate.
    """

    tolerance: float | None
    setup_s: float
    estimate_s: float
    seconds: float
    step_s: float
    grain_steps_per_s: float
    longest: bool = False
    pareto: bool = False


class Choice(NamedTuple):
    """The cheapest measured way to an error.

    Attributes
    ----------
    target : float
        Requested error.
    engine, integrator : str
        Name of the engine, empty if no point reaches the error; name of the integrator, or empty.
    step_s : float
        Time step, s; NaN for a solution without steps.
    error : float
        Error of the choice; NaN without a choice.
    seconds : float
        Time as in `CurvePoint.seconds`, s.
    to_tolerance : bool
        Whether the engine chose the step itself, so that its time includes the error estimate.
    why : str
        Reason why no choice exists.
    """

    target: float
    engine: str
    integrator: str
    step_s: float
    error: float
    seconds: float
    to_tolerance: bool
    why: str


def _cells(choice: Choice, name: str) -> Sequence[str]:
    """Return the cells of a row: the choice and its cost, or the reason if no point reaches it."""
    target = f"{choice.target:.0e}"
    if not choice.engine:
        return target, name, "-", "-", "-", choice.why
    engine = f"{choice.engine} {choice.integrator}".rstrip()
    step = number(choice.step_s, unit="s", missing="-")
    remark = "with the estimate" if choice.to_tolerance else ""
    return target, engine, step, f"{choice.error:.0e}", duration(choice.seconds), remark


TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
WITHOUT = "{}, without the estimate"


@dataclass(frozen=True)
class EngineCurve:
    """The points of one engine and integrator, cheapest first.

    Attributes
    ----------
    engine, integrator : str
        Name of the engine; name of the integrator, empty if the engine has none or chooses one.
    points : tuple of CurvePoint
        Measured points, cheapest first.
    """

    engine: str
    integrator: str
    points: tuple[CurvePoint, ...]

    @property
    def to_tolerance(self) -> bool:
        """Whether the engine chose the steps itself to meet a tolerance."""
        return self.points[0].tolerance is not None

    @property
    def name(self) -> str:
        """Engine, and its integrator or "to a tolerance"."""
        choice = "to a tolerance" if self.to_tolerance else self.integrator
        return ", ".join(filter(None, (self.engine, choice)))


@dataclass(frozen=True, eq=False, repr=False)
class WorkPrecision(Shown, Tabular):
    """Work-precision curves of one scene.

    Attributes
    ----------
    scene : Scene
    reference : Reference
    curves : tuple of EngineCurve
        One curve for each engine and integrator.
    dropped : int
        Number of points left out because their error is below ten times the reference error.
    left_out : tuple of str
        Engines that cannot solve the scene, with the reasons.
    versions : dict of str
        Versions of the engines and libraries that ran.
    machine : str
        Processor and number of available cores.
    """

    scene: Scene
    reference: Reference
    curves: tuple[EngineCurve, ...]
    dropped: int
    left_out: tuple[str, ...]
    versions: dict[str, str]
    machine: str = field(default_factory=machine)

    @property
    def points(self) -> list[CurvePoint]:
        """All points of all curves."""
        return [point for curve in self.curves for point in curve.points]

    def cheapest(self, engine: str = "") -> list[Choice]:
        """Return the cheapest measured point for each of the errors 1e-3, 1e-6, 1e-9 and 1e-12.

        Parameters
        ----------
        engine : str, optional
            Engine whose points are considered, such as "lammps"; by default all engines.
        """
        curves = [curve for curve in self.curves if engine in ("", curve.engine)]
        return [self._choose(curves, target, engine) for target in TARGETS]

    def _choose(self, curves: Sequence[EngineCurve], target: float, engine: str) -> Choice:
        """Return the cheapest point within an error; without one, a choice with the reason."""
        points = [point for curve in curves for point in curve.points]
        good = [point for point in points if point.error <= target]
        if good:
            best = min(good, key=lambda point: point.seconds)
            integrator = best.integrator if best.steps and best.integrator != best.engine else ""
            step = best.step_s if integrator else math.nan
            chosen = best.tolerance is not None
            return Choice(
                target, best.engine, integrator, step, best.error, best.seconds, chosen, ""
            )
        why = self._obstacle(points, engine)
        return Choice(target, "", "", math.nan, math.nan, math.nan, False, why)

    def _obstacle(self, points: Sequence[CurvePoint], engine: str) -> str:
        """Return the reason why no point of an engine reaches an error."""
        if points:
            least = min(points, key=lambda point: point.error)
            # If shorter steps did not help, rounding error limits the accuracy.
            finest = max(p.steps for p in points if p.integrator == least.integrator)
            end = "round-off" if least.steps < finest else "time over"
            return f"at best {least.error:.0e}: {end}"
        reasons = [text for text in self.left_out if engine and text.startswith(f"{engine}: ")]
        return next((text.partition(": ")[2] for text in reasons), "none was measured")

    def best(self) -> list[str]:
        """Return the lines of a table: the cheapest engine for each error, and LAMMPS beside it."""
        return align(self.ways())

    def ways(self) -> list[Sequence[str]]:
        """Return the rows of the table that `best` aligns."""
        rows: list[Sequence[str]] = [("to reach", "engine", "step", "error", "time", "")]
        for pair in zip(self.cheapest(), self.cheapest("lammps"), strict=True):
            for choice, name in zip(pair, ("none", "lammps"), strict=True):
                # LAMMPS has no second row if it is the cheapest engine.
                if name == "none" or choice.engine != pair[0].engine:
                    rows.append(_cells(choice, name))
        return rows

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
            "cheapest": [finite(choice._asdict()) for choice in self.cheapest()],
            "cheapest_lammps": [finite(choice._asdict()) for choice in self.cheapest("lammps")],
        }

    def table(self, others: Mapping[str, Iterable[tuple[float, float]]] = {}) -> str:
        """Return the cheapest way to several errors, and the time that each curve takes to them.

        `others` are the curves of other codes by name, as points (seconds, error).
        """
        curves: dict[str, Iterable[tuple[float, float]]] = {}
        for curve in self.curves:
            # Other codes have no error estimate, so only integration times are compared.
            curves[curve.name] = [(point.seconds, point.error) for point in curve.points]
            if curve.to_tolerance:
                curves[WITHOUT.format(curve.name)] = [
                    (point.integration_s, point.error) for point in curve.points
                ]
        lines = [["time to an error of", *(f"{target:.0e}" for target in TARGETS)]]
        for name, points in (curves | dict(others)).items():
            times = [time_to(target, points) for target in TARGETS]
            lines.append([name, *(duration(seconds) for seconds in times)])
        return "\n".join([*self.best(), "", *align(lines)])

    def plot(
        self, ax: Axes | Sequence[Axes] | None = None, others: Sequence[Mapping[str, Any]] = ()
    ) -> Axes:
        """Draw error against time, five curves in colour and the others in grey; return the axes.

        Parameters
        ----------
        ax : axes, or three of them, optional
            On a single axes only the errors against time are drawn. By default a new figure also
            shows the errors against force evaluations, and the times to reach an error of 1e-6.
        others : sequence of mappings
            Points of other codes: code, error, seconds, force_evaluations (or None).
        """
        return draw(self, ax, others)

    def _columns(self) -> Iterator[NamedColumn]:
        return of_rows([asdict(point) for point in self.points])
