"""The work-precision chart: errors against times, and the cheapest engine for each error."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, groupby
from typing import Any

from ..engines import class_of
from ..scene.scene import Scene
from ..util.plotting import (
    COLOURS,
    LEAST_ERROR,
    LEAST_LETTER,
    PRINTED_WIDTH,
    Axes,
    legend,
    letter_panels,
    look_of,
    panels,
    window,
)

# Engine errors below this multiple of the reference error are not meaningful.
KNOWN = 10.0


def time_to(error: float, points: Iterable[tuple[float, float]]) -> float:
    """Return the time to reach an error, s, from points (seconds, error); NaN if none does.

    Between two points the time is interpolated as a power law.

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
            share = math.log(before[1] / error) / math.log(before[1] / reached)
            return float(before[0] * (seconds / before[0]) ** share)
        before = seconds, reached
    return math.nan


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the indices of the Pareto front of points (cost, error), cheapest first.

    Examples
    --------
    >>> front([(2.0, 0.1), (1.0, 0.5), (3.0, 0.2)])
    [1, 0]
    """
    smallest = math.inf
    indices = []
    for index in sorted(range(len(points)), key=points.__getitem__):
        if points[index][1] < smallest:
            smallest = points[index][1]
            indices.append(index)
    return indices


ROOM = 0.75  # Names of marks beyond this fraction of the axes' width stand on the left of the mark.
NAMES_WIDTH = 80  # Number of letters that fit below the axes of the times.
LABELLED = 5  # Number of curves in colour: those that reach the target error soonest.
TARGET = 1e-6  # Target error.
FRONT = "#F0E442"
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
LAMMPS: dict[str, Any] = {
    "color": COLOURS["vermilion"],
    "ms": 5,
    "lw": 1.3,
    "zorder": 3.5,
    "ls": "--",
}
GREY: dict[str, Any] = {"color": "0.75", "lw": 0.8, "ms": 3, "zorder": 1}


def draw(
    result: Any, ax: Axes | Sequence[Axes] | None = None, others: Sequence[Mapping[str, Any]] = ()
) -> Axes:
    """Draw error against time and force evaluations, and times to one error."""
    # A new figure has room for the legend below the axes, away from the curves.
    axes, below = _figure(result) if ax is None else (ax, None)
    over_time, *rest = panels(axes)
    curves: dict[str, list[Mapping[str, Any]]] = {
        curve.name: [vars(point) for point in curve.points] for curve in result.curves
    }
    for row in others:
        curves.setdefault(row["code"], []).append(row)
    times = {name: time_to(TARGET, _pairs(points, "seconds")) for name, points in curves.items()}
    styles = _styles(result, times)
    _draw_errors(over_time, "seconds", result, curves, styles)
    over_time.set(xlabel="time (s)", ylabel="relative error")
    explained = over_time.get_legend_handles_labels()
    if below:
        legend(below, *explained, loc="center", ncols=4)
    else:
        legend(rest[0] if rest else over_time, *explained, loc="upper right")
    if rest:
        over_evaluations, bars = rest
        _draw_errors(over_evaluations, "force_evaluations", result, curves, styles)
        over_evaluations.set(
            xlabel="force evaluations (each of all grains)", ylim=over_time.get_ylim()
        )
        _draw_orders(over_evaluations)
        _draw_bars(bars, times, styles)
    if below:
        letter_panels([over_time, *rest])
    return over_time


def _figure(result: Any) -> tuple[list[Axes], Axes]:
    """Create a figure; return its axes, and the axes below for the legend."""
    picture = window(PRINTED_WIDTH, 10.0)
    rooms = picture.subplot_mosaic(
        [["time", "evaluations"], ["bars"] * 2, ["legend"] * 2, ["ways"] * 2],
        height_ratios=(4.5, 2.2, 0.6, 1.4),
    )
    _write_ways(rooms.pop("ways"), result)
    below = rooms.pop("legend")
    below.set_axis_off()
    picture.suptitle(textwrap.fill(_title(result.scene), 92), x=0.01, ha="left", fontsize=10.0)
    picture.supxlabel(_footer(result), x=0.01, ha="left", fontsize=LEAST_LETTER, color="0.35")
    return list(rooms.values()), below


def _styles(result: Any, times: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Return the colours and lines of the curves on the Pareto front, and of LAMMPS."""
    stepped = [curve for curve in result.curves if len(curve.points) > 1 or curve.to_tolerance]

    # A curve to a tolerance is the usual way to run, so it is always in colour.
    def rank(curve: Any) -> tuple[bool, float]:
        seconds = times[curve.name]
        return not curve.to_tolerance, math.inf if math.isnan(seconds) else seconds

    soonest = sorted(stepped, key=rank)[:LABELLED]
    styles = {curve.name: _style(curve) for curve in soonest}
    # LAMMPS is always in colour, because users with a deck look for it.
    for curve in result.curves:
        if curve.engine == "lammps":
            styles[curve.name] = look_of(curve.integrator) | LAMMPS
    return styles


def _write_ways(ax: Axes, result: Any) -> None:
    """Write the cheapest engine for each error below the charts, with LAMMPS in its colour."""
    ax.set_axis_off()
    rows = [[typeset_cell(cell) for cell in row] for row in result.ways()]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    for row, line in enumerate(lines):
        colour = COLOURS["vermilion"] if "lammps" in line else "black"
        weight = "bold" if row == 0 else "normal"
        height = 1 - row / len(lines)
        text: dict[str, Any] = {"family": "monospace", "fontsize": LEAST_LETTER, "va": "top"}
        ax.text(0.0, height, line, transform=ax.transAxes, color=colour, weight=weight, **text)


def typeset_cell(cell: str) -> str:
    """Return a cell of a table with raised powers of ten, and with microseconds as on the axes.

    Examples
    --------
    >>> typeset_cell("2.17e-06 s"), typeset_cell("1e-06"), typeset_cell("22.4 us")
    ('2.17·10⁻⁶ s', '10⁻⁶', '22.4 µs')
    """

    def raise_one(found: re.Match[str]) -> str:
        factor = "" if found[1] == "1" else f"{found[1]}·"
        return f"{factor}10{str(int(found[2])).translate(RAISED)}"

    cell = re.sub(r"\b(\d(?:\.\d+)?)e([-+]\d+)", raise_one, cell)
    return re.sub(r"\bus\b", "µs", cell)


def _draw_errors(
    ax: Axes,
    cost: str,
    result: Any,
    curves: Mapping[str, Iterable[Mapping[str, Any]]],
    styles: Mapping[str, dict[str, Any]],
) -> None:
    """Draw errors against a cost: the Pareto front, grey curves, and styled curves above them."""
    floor = KNOWN * result.reference.error
    ax.set(xscale="log", yscale="log")
    ax.grid(color="0.94", lw=0.6)
    ax.set_axisbelow(True)
    # Points are sorted by cost, so that no curve runs backwards.
    lines = {name: sorted(_pairs(points, cost)) for name, points in curves.items()}
    pairs = list(chain.from_iterable(lines.values()))
    if pairs:
        best = zip(*(pairs[index] for index in front(pairs)), strict=True)
        band: dict[str, Any] = {"lw": 9, "alpha": 0.5, "zorder": 0.5, "solid_capstyle": "round"}
        ax.plot(*best, color=FRONT, label="Pareto front", **band)
    # All grey curves share one legend entry: matplotlib omits names that start with _.
    unnamed = _name_of_grey(curves, styles)
    alone = []
    for name, points in lines.items():
        if not points:
            continue
        if name in styles:
            ax.plot(*zip(*points, strict=True), label=name, **styles[name])
        elif len(points) > 1:
            ax.plot(*zip(*points, strict=True), marker=".", label=unnamed, **GREY)
            unnamed = "_others"
        else:
            alone.append((points[0][1], points[0][0], name.split(",")[0]))
    _draw_alone(ax, sorted(alone))
    for curve in result.curves:
        longest = _pairs((vars(point) for point in curve.points if point.longest), cost)
        if longest and curve.name in styles:
            ax.plot(*longest[0], "o", ms=14, mfc="none", mec=styles[curve.name]["color"], mew=1.2)
    # Errors below this floor may come from the reference as well as from the engine.
    ax.set_ylim(floor / 10, min(ax.get_ylim()[1], 5))
    ax.axhline(floor, color="0.6", lw=0.8, ls=(0, (1, 3)))
    ax.annotate(
        f"{KNOWN:g} × error of the reference",
        (0.01, floor),
        (0, -3),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        va="top",
        color="0.4",
        fontsize=LEAST_LETTER,
    )
    # The legend stands above the slopes of the orders if these are drawn.
    foot = 0.1 if cost == "seconds" else 0.46
    ax.annotate(
        "better",
        (0.03, foot),
        (0.15, foot + 0.12),
        "axes fraction",
        "axes fraction",
        color="0.3",
        ha="center",
        arrowprops={"arrowstyle": "-|>", "color": "0.3", "lw": 1.5},
    )


def _name_of_grey(
    curves: Mapping[str, Iterable[Mapping[str, Any]]], styles: Mapping[str, dict[str, Any]]
) -> str:
    """Return the legend entry of the grey curves: the name of a single curve, or "others"."""
    grey = [name for name, points in curves.items() if name not in styles and len(list(points)) > 1]
    return grey[0] if len(grey) == 1 else "others"


def _draw_alone(ax: Axes, points: Sequence[tuple[float, float, str]]) -> None:
    """Draw engines with a single point each (error, cost, name), and label groups of them."""

    def height(point: tuple[float, float, str]) -> int:
        return round(2 * math.log10(max(point[0], LEAST_ERROR)))

    # This call fixes the axis limits, on which the positions of the labels depend.
    ax.get_xlim()
    for _, group in groupby(points, key=height):
        errors, costs, names = zip(*group, strict=True)
        for error, cost, name in zip(errors, costs, names, strict=True):
            ax.plot(cost, error, class_of(name).style[1], color="0.8", mec="k", ms=8, zorder=5)
        label = textwrap.fill(", ".join(names), 20)
        place = ax.transAxes.inverted().transform(ax.transData.transform((max(costs), errors[0])))
        # The label is on the side with more room.
        late = place[0] > ROOM
        ax.annotate(
            label,
            (max(costs), errors[0]),
            (-8 if late else 8, 0),
            textcoords="offset points",
            ha="right" if late else "left",
            va="center",
            fontsize="small",
            zorder=6,
            bbox={"facecolor": "w", "lw": 0, "pad": 1, "alpha": 0.8},
        )


def _draw_bars(ax: Axes, times: Mapping[str, float], styles: Mapping[str, dict[str, Any]]) -> None:
    """Mark the time of each curve to reach one error, and name the curves that never reach it."""
    reached = sorted((name for name in times if math.isfinite(times[name])), key=times.__getitem__)
    rows = range(len(reached))
    for row, name in enumerate(reached):
        # A dot is drawn because the length of a bar has no meaning on a logarithmic axis.
        look = styles.get(name, GREY)
        mark = {"color": look["color"], "marker": look.get("marker", "."), "ms": 7}
        ax.plot(1e3 * times[name], row, ls="none", **mark)
        text: dict[str, Any] = {
            "textcoords": "offset points",
            "va": "center",
            "fontsize": LEAST_LETTER,
        }
        ax.annotate(f"{1e3 * times[name]:.3g}", (1e3 * times[name], row), (7, 0), **text)
    ax.set_yticks(rows, reached, fontsize=LEAST_LETTER)
    ax.set(xscale="log", xlabel="time (ms)", ylim=(len(reached) - 0.4, -0.6))
    ax.margins(x=0.3)
    ax.grid(axis="x", color="0.92", lw=0.6)
    exponent = round(math.log10(TARGET))
    ax.set_title(f"Time to an error of $10^{{{exponent}}}$", loc="left", fontsize="medium")
    never = [name for name in times if name not in reached]
    if never:
        names = textwrap.fill(f"not reached by {'; '.join(never)}", NAMES_WIDTH)
        ax.set_xlabel(f"time (ms)\n\n{names}")


def _pairs(points: Iterable[Mapping[str, Any]], cost: str) -> list[tuple[float, float]]:
    return [(point[cost], point["error"]) for point in points if point[cost]]


def _style(curve: Any) -> dict[str, Any]:
    """Return the line style of a curve on the Pareto front."""
    if curve.to_tolerance:
        return {"color": "black", "marker": "*", "ms": 8, "lw": 1.8, "zorder": 4}
    return look_of(curve.integrator) | {"ms": 5.5, "lw": 1.8, "zorder": 3}


def _draw_orders(ax: Axes) -> None:
    """Draw slopes of several orders of convergence, in the corner that no method reaches."""
    start = 1.3 * ax.get_xlim()[0]
    bottom = ax.get_ylim()[0]
    top = 1e6 * bottom
    end = 30 * bottom
    for order in (2, 4, 6, 8):
        last = start * min((top / end) ** (1 / order), 10)
        low = top * (last / start) ** -order
        ax.plot([start, last], [top, low], color="0.5", lw=0.9)
        # The two steepest lines end close together, so the last number is on the left.
        side = {"ha": "right"} if order == 8 else {}
        place: dict[str, Any] = {"textcoords": "offset points", "va": "top", "color": "0.35"}
        ax.annotate(f"{order}", (last, low), (2, -3), **place | side)
    ax.annotate("order", (start, top), (0, 4), textcoords="offset points", color="0.35")


def _title(scene: Scene) -> str:
    column = scene.chain
    weight = f"g = {column.gravity:g} m/s²" if column.gravity else "no gravity"
    number = f"strike number {scene.strike_number:.2g}" if column.compressed else "sonic vacuum"
    strike = f"{scene.excitation.label} ({number})"
    return f"{column.grains} grains, {weight}, {strike}, at t = {scene.duration * 1e6:g} µs"


def _footer(result: Any) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in result.versions.items())
    dropped = f"{result.dropped} points below {KNOWN:g} times this error are left out"
    left_out = dropped if result.dropped else f"no point is below {KNOWN:g} times this error"
    text = (
        "Error: the larger of the errors of displacement and velocity, each the largest over "
        "samples and grains relative to the largest motion of any grain at any time. "
        f"Reference: {result.reference.method}; its error is {result.reference.error:.0e}, and "
        f"{left_out}. To a tolerance, the engine chooses integrator and step, so that time "
        "and error jump where its choice changes; points are connected in order of tolerance. "
        "Times: the shortest of several runs after a first run, for the integration and, to a "
        f"tolerance, the error estimate, on {result.machine}; {versions}."
    )
    return textwrap.fill(text, 110)
