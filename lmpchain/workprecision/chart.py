"""The picture of speed against accuracy."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

from ..excitation import Impulse
from ..plotting import MARKERS, figure
from ..scene import Scene
from . import WITHOUT, Curve, WorkPrecision, front, machine
from .bench import KNOWN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# of integrators, the same for every engine; Okabe and Ito, and two shades that differ from these in lightness
SHADES = ("#E69F00", "#56B4E9", "#0072B2", "#009E73", "#CC79A7", "#D55E00", "#6A3D00", "#999933")
SHAPES = ("o", "D", "s", "v", "^", "P", "X", "p")
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
    """Draw those points (cost, error) that no other beats in both."""
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
    """Say below which errors nothing is known."""
    ax.axhline(floor, color="0.6", lw=0.8, ls=(0, (1, 3)))
    ax.annotate(f"{KNOWN:g} × error of the reference", (0.01, floor), (0, -3), xycoords=("axes fraction", "data"),
                textcoords="offset points", va="top", color="0.4", fontsize="x-small")  # fmt: skip


def _draw_orders(ax: Axes) -> None:
    """Draw how the error falls for several orders, in the corner that no method reaches."""
    start, bottom = 1.3 * ax.get_xlim()[0], ax.get_ylim()[0]
    top, end = 1e6 * bottom, 30 * bottom
    for order in ORDERS:
        last = start * min((top / end) ** (1 / order), 10)
        low = top * (last / start) ** -order
        ax.plot([start, last], [top, low], color="0.5", lw=0.9)
        ax.annotate(f"{order}", (last, low), (2, -3), textcoords="offset points", va="top", color="0.35")
    ax.annotate("order", (start, top), (0, 4), textcoords="offset points", color="0.35")


def _title(scene: Scene) -> str:
    column, excitation = scene.chain, scene.excitation
    struck = (
        f"an {excitation.kind} of {excitation.velocity * 1e3:g} mm/s"
        if isinstance(excitation, Impulse)
        else f"a {excitation.kind}"
    )
    weight = f"g = {column.gravity:g} m/s²" if column.gravity else "no gravity"
    number = f"strike number {scene.strike_number:.2g}" if column.compressed else "sonic vacuum"
    return f"{column.grains} grains, {weight}, {struck} ({number}), at t = {scene.duration * 1e6:g} µs"


def _footer(result: WorkPrecision) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in result.versions.items())
    said = (
        "Error: the larger of those of displacement and velocity, each the largest over samples and grains relative to "
        f"the largest there is. Reference: {result.reference.method}; its error is {result.reference.error:.0e}, and "
        f"{result.dropped} points within {KNOWN:g} times of that are left out. Times: of the integration, to a "
        f"tolerance with the error estimate, and the least of several runs after a first, on {machine()}; {versions}."
    )
    return textwrap.fill(said, LETTERS)
