"""Work-precision curves: time and force evaluations against true error, as table and chart."""

from __future__ import annotations

import math
import os
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any

from ..scene.scene import Scene
from ..util.plotting import MARKERS, SHADES, SHAPES, figure
from ..util.provenance import processor
from ..util.tables import aligned, finite, number
from .comparison import Row
from .reference import Reference

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

KNOWN = 10.0  # times the error of the reference: smaller errors are not known well enough


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
        Time in the chart, s: of the integration, with that of the error estimate where a tolerance was asked for.
    step_s : float
        s.
    grain_steps_per_s : float
        Force evaluations times computed grains, per second of integration.
    longest : bool
        Whether this is the longest stable step: at longer ones the run breaks down or its error exceeds 1.
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
        return ", ".join(filter(None, (self.engine, "to a tolerance" if self.to_tolerance else self.integrator)))


@dataclass(frozen=True, eq=False)
class WorkPrecision:
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
    """

    scene: Scene
    reference: Reference
    curves: tuple[Curve, ...]
    dropped: int
    left_out: tuple[str, ...]
    versions: dict[str, str]

    @property
    def points(self) -> list[Point]:
        """All points, curve by curve."""
        return [point for curve in self.curves for point in curve.points]

    def to_json(self) -> dict[str, Any]:
        """Return what goes into a JSON file; numbers that are not finite become None."""
        rows = [finite(asdict(point)) for point in self.points]
        reference = {"method": self.reference.method, "error": self.reference.error}
        about = {"machine": machine(), "versions": self.versions, "dropped": self.dropped}
        return {"reference": reference, **about, "rows": rows}

    def table(self, others: Mapping[str, Iterable[tuple[float, float]]] = {}) -> str:
        """Return the time to reach several errors, as text, a line a curve.

        Curves of other codes are given as {name: (seconds, error) ...}.
        """
        curves: dict[str, Iterable[tuple[float, float]]] = {}
        for curve in self.curves:
            curves[curve.name] = [(point.seconds, point.error) for point in curve.points]
            if curve.to_tolerance:
                curves[WITHOUT.format(curve.name)] = [(point.integration_s, point.error) for point in curve.points]
        lines = [["time to an error of", *(f"{target:.0e}" for target in TARGETS)]]
        for name, points in (curves | dict(others)).items():
            times = [time_to(target, points) for target in TARGETS]
            lines.append([name, *(number(1e3 * t, unit="ms", missing="-") for t in times)])
        return "\n".join(aligned(lines))

    def plot(self, axes: Sequence[Axes] | None = None, others: Sequence[Mapping[str, Any]] = ()) -> Figure:
        """Draw error against time and against force evaluations.

        Parameters
        ----------
        axes : two axes, optional
            By default those of a new figure.
        others : sequence of mappings
            Points of other codes: code, error, seconds, force_evaluations (or None).
        """
        return draw(self, axes, others)


def time_to(error: float, points: Iterable[tuple[float, float]]) -> float:
    """Return the time to reach an error, s, from points (seconds, error); NaN if none does.

    Between two points it is interpolated as a power law.

    Examples
    --------
    >>> round(time_to(1e-4, [(1.0, 1e-2), (4.0, 1e-6)]), 9)
    2.0
    """
    before = None
    for seconds, reached in sorted(points):
        if reached <= error:
            if before is None:
                return seconds
            part = math.log(before[1] / error) / math.log(before[1] / reached)
            return float(before[0] * (seconds / before[0]) ** part)
        before = seconds, reached
    return math.nan


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the indices of the Pareto front of points (cost, error), cheapest first.

    Examples
    --------
    >>> front([(2.0, 0.1), (1.0, 0.5), (3.0, 0.2)])
    [1, 0]
    """
    least, places = math.inf, []
    for place in sorted(range(len(points)), key=points.__getitem__):
        if points[place][1] < least:
            least = points[place][1]
            places.append(place)
    return places


def machine() -> str:
    """Return the name of the processor and how many cores this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{processor()}, {cores} core{'s' if cores != 1 else ''}"


FRONT = "#F0E442"
OTHER_SHAPES, OTHER_MARKS = ("1", "2", "3", "4", "+", "x", "d", "h"), 12  # of other codes, in shades of grey
ORDERS = (2, 4, 6, 8)
LETTERS = 235  # of the footer in a line


def draw(result: WorkPrecision, axes: Sequence[Axes] | None, others: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw error against time and against force evaluations; see `WorkPrecision.plot`."""
    if axes is None:
        picture = figure(13, 7)
        axes = picture.subplots(1, 2, sharey=True)
        picture.suptitle(_title(result.scene), x=0.01, ha="left")
        picture.supxlabel(_footer(result), x=0.01, ha="left", fontsize="x-small", color="0.35")
    over_time, over_evaluations = axes
    kinds = list(dict.fromkeys(curve.integrator for curve in result.curves if curve.integrator))
    styles = {curve.name: _style(curve, kinds) for curve in result.curves}
    floor = KNOWN * result.reference.error
    for ax, cost in ((over_time, "seconds"), (over_evaluations, "force_evaluations")):
        ax.set(xscale="log", yscale="log")
        ax.grid(color="0.92", lw=0.6)
        ax.set_axisbelow(True)
        all_points = _known(chain(map(vars, result.points), others), cost)
        _draw_front(ax, all_points, color=FRONT, lw=11, alpha=0.5, solid_capstyle="round", label="Pareto front")
        for curve in result.curves:
            points, style = [vars(point) for point in curve.points], styles[curve.name]
            _draw_line(ax, points, cost, label=curve.name, **style)
            if curve.to_tolerance and ax is over_time:
                alone = style | {"label": WITHOUT.format(curve.name), "ls": ":", "mfc": "white"}
                _draw_line(ax, points, "integration_s", **alone)
            longest = [point for point in points if point["longest"]]
            _draw_line(ax, longest, cost, marker="o", ms=14, mfc="none", mec=style["color"], mew=1.2)
        for place, code in enumerate(dict.fromkeys(row["code"] for row in others)):
            known = _known((row for row in others if row["code"] == code), cost)
            _draw_front(ax, known, label=code, **_other_style(place, len(known)))
        ax.set_ylim(floor / 4, min(ax.get_ylim()[1], 5))
    over_time.set(xlabel="time (s)", ylabel="relative error")
    over_evaluations.set(xlabel="force evaluations (each of all grains)")
    _draw_floor(over_time, floor)
    _draw_orders(over_evaluations)
    over_time.plot([], [], "o", ms=10, mfc="none", mec="0.3", label="longest step that holds")
    over_evaluations.legend(
        *over_time.get_legend_handles_labels(),
        loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False, borderaxespad=0, fontsize="small",
    )  # fmt: skip
    return over_time.figure.figure  # type: ignore[return-value]


def _draw_line(ax: Axes, points: Iterable[Mapping[str, Any]], cost: str, **style: Any) -> None:
    """Draw errors against a cost, where that is known."""
    if known := _known(points, cost):
        ax.plot(*zip(*known, strict=True), **style)


def _draw_front(ax: Axes, points: Sequence[tuple[float, float]], **style: Any) -> None:
    """Draw the Pareto front of points (cost, error)."""
    if points:
        ax.plot(*zip(*(points[place] for place in front(points)), strict=True), **style)


def _known(points: Iterable[Mapping[str, Any]], cost: str) -> list[tuple[float, float]]:
    return [(point[cost], point["error"]) for point in points if point[cost]]


def _style(curve: Curve, kinds: Sequence[str]) -> dict[str, Any]:
    """Return how a curve is drawn: integrators by colour and marker, engines by the line."""
    if curve.integrator:
        place = kinds.index(curve.integrator) % len(SHADES)
        line = {"ls": "-", "lw": 1.8} if curve.engine == "native" else {"ls": "--", "lw": 1.1, "mfc": "white"}
        return {"color": SHADES[place], "marker": SHAPES[place], "ms": 5.5} | line
    if curve.to_tolerance:
        return {"color": "black", "marker": "*", "ms": 8, "lw": 1.8}
    return {"color": "0.8", "marker": MARKERS.get(curve.engine, "x"), "ms": 9, "ls": "none", "mec": "black"}


def _other_style(place: int, points: int) -> dict[str, Any]:
    shape, grey = OTHER_SHAPES[place % len(OTHER_SHAPES)], f"{0.2 + 0.2 * (place % 3):g}"
    return {
        "color": grey,
        "marker": shape,
        "ls": ":",
        "lw": 1.2,
        "ms": 7,
        "markevery": max(1, points // (2 * OTHER_MARKS)),
    }


def _draw_floor(ax: Axes, floor: float) -> None:
    """Shade the errors that the reference is not accurate enough to measure."""
    ax.axhline(floor, color="0.6", lw=0.8, ls=(0, (1, 3)))
    ax.annotate(f"{KNOWN:g} × error of the reference", (0.01, floor), (0, -3), xycoords=("axes fraction", "data"),
                textcoords="offset points", va="top", color="0.4", fontsize="x-small")  # fmt: skip


def _draw_orders(ax: Axes) -> None:
    """Draw slopes of several orders of convergence, in the corner that no method reaches."""
    start, bottom = 1.3 * ax.get_xlim()[0], ax.get_ylim()[0]
    top, end = 1e6 * bottom, 30 * bottom
    for order in ORDERS:
        last = start * min((top / end) ** (1 / order), 10)
        low = top * (last / start) ** -order
        ax.plot([start, last], [top, low], color="0.5", lw=0.9)
        ax.annotate(f"{order}", (last, low), (2, -3), textcoords="offset points", va="top", color="0.35")
    ax.annotate("order", (start, top), (0, 4), textcoords="offset points", color="0.35")


def _title(scene: Scene) -> str:
    column = scene.chain
    weight = f"g = {column.gravity:g} m/s²" if column.gravity else "no gravity"
    number = f"strike number {scene.strike_number:.2g}" if column.compressed else "sonic vacuum"
    return f"{column.grains} grains, {weight}, {scene.excitation.label} ({number}), at t = {scene.duration * 1e6:g} µs"


def _footer(result: WorkPrecision) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in result.versions.items())
    said = (
        "Error: the larger of those of displacement and velocity, each the largest over samples and grains relative to "
        "the largest motion of any grain at any time. "
        f"Reference: {result.reference.method}; its error is {result.reference.error:.0e}, and "
        f"{result.dropped} points within {KNOWN:g} times of that are left out. Times: of the integration, to a "
        f"tolerance with the error estimate, and the least of several runs after a first, on {machine()}; {versions}."
    )
    return textwrap.fill(said, LETTERS)
