"""The work-precision chart: what leads in colour, all else in grey, times to one error as bars."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, groupby
from typing import TYPE_CHECKING, Any

from ..scene.scene import Scene
from ..util.plotting import LEAST_ERROR, MARKERS, SHADES, SHAPES, legend, panels, window
from .pareto import KNOWN, front, time_to

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LABELLED, TARGET = 5, 1e-6  # curves in colour, those that reach this error soonest
FRONT = "#F0E442"
GREY: dict[str, Any] = {"color": "0.75", "lw": 0.8, "ms": 3, "zorder": 1}
ORDERS = (2, 4, 6, 8)
LETTERS = 235  # of the footer in a line


def draw(
    result: Any, ax: Axes | Sequence[Axes] | None = None, others: Sequence[Mapping[str, Any]] = ()
) -> Axes:
    """Draw error against time and force evaluations, and times to one error; see `WorkPrecision.plot`."""
    if ax is None:
        picture = window(14.0, 7.0)
        ax = picture.subplots(1, 3, width_ratios=(5, 5, 3.5))
        picture.suptitle(_title(result.scene), x=0.01, ha="left")
        picture.supxlabel(_footer(result), x=0.01, ha="left", fontsize="x-small", color="0.35")
    over_time, *rest = panels(ax)
    codes = {
        code: [row for row in others if row["code"] == code]
        for code in dict.fromkeys(r["code"] for r in others)
    }
    curves = {
        curve.name: [vars(point) for point in curve.points] for curve in result.curves
    } | codes
    times = {name: time_to(TARGET, _known(points, "seconds")) for name, points in curves.items()}
    stepped = [curve for curve in result.curves if len(curve.points) > 1 or curve.to_tolerance]
    soonest = sorted(
        stepped, key=lambda curve: (not curve.to_tolerance, _or_never(times[curve.name]))
    )[:LABELLED]
    styles = {curve.name: _style(place, curve) for place, curve in enumerate(soonest)}
    _draw_errors(over_time, "seconds", result, curves, styles)
    over_time.set(xlabel="time (s)", ylabel="relative error")
    legend(
        rest[0] if rest else over_time, *over_time.get_legend_handles_labels(), loc="upper right"
    )
    if rest:
        over_evaluations, bars = rest
        _draw_errors(over_evaluations, "force_evaluations", result, curves, styles)
        over_evaluations.set(
            xlabel="force evaluations (each of all grains)", ylim=over_time.get_ylim()
        )
        _draw_orders(over_evaluations)
        _draw_bars(bars, times, styles)
    return over_time


def _draw_errors(
    ax: Axes,
    cost: str,
    result: Any,
    curves: Mapping[str, Iterable[Mapping[str, Any]]],
    styles: Mapping[str, dict[str, Any]],
) -> None:
    """Draw errors against a cost: the Pareto front below, curves in grey, those with a style above them."""
    floor = KNOWN * result.reference.error
    ax.set(xscale="log", yscale="log")
    ax.grid(color="0.94", lw=0.6)
    ax.set_axisbelow(True)
    known = {name: _known(points, cost) for name, points in curves.items()}
    best = list(chain.from_iterable(known.values()))
    if best:
        ax.plot(*zip(*(best[place] for place in front(best)), strict=True), color=FRONT, lw=9, alpha=0.5, zorder=0.5,
                solid_capstyle="round", label="Pareto front")  # fmt: skip
    unnamed, alone = "others", []
    for name, points in known.items():
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
        longest = _known((vars(point) for point in curve.points if point.longest), cost)
        if longest and curve.name in styles:
            ax.plot(*longest[0], "o", ms=14, mfc="none", mec=styles[curve.name]["color"], mew=1.2)
    ax.set_ylim(floor / 4, min(ax.get_ylim()[1], 5))
    ax.axhline(floor, color="0.6", lw=0.8, ls=(0, (1, 3)))
    ax.annotate(f"{KNOWN:g} × error of the reference", (0.01, floor), (0, -3), xycoords=("axes fraction", "data"),
                textcoords="offset points", va="top", color="0.4", fontsize="x-small")  # fmt: skip
    foot = 0.1 if cost == "seconds" else 0.46  # there the orders are
    ax.annotate("better", (0.03, foot), (0.15, foot + 0.12), "axes fraction", "axes fraction", color="0.3", ha="center",
                arrowprops={"arrowstyle": "-|>", "color": "0.3", "lw": 1.5})  # fmt: skip


def _draw_alone(ax: Axes, points: Sequence[tuple[float, float, str]]) -> None:
    """Draw engines with one point each (error, cost, name), and name those of about one error together."""
    for _, same in groupby(
        points, key=lambda point: round(2 * math.log10(max(point[0], LEAST_ERROR)))
    ):
        errors, costs, names = zip(*same, strict=True)
        for error, cost, name in zip(errors, costs, names, strict=True):
            ax.plot(cost, error, MARKERS.get(name, "x"), color="0.8", mec="k", ms=8, zorder=5)
        label = textwrap.fill(", ".join(names), 20)
        ax.annotate(label, (max(costs), errors[0]), (8, 0), textcoords="offset points", va="center", fontsize="small",
                    zorder=6, bbox={"facecolor": "w", "lw": 0, "pad": 1, "alpha": 0.8})  # fmt: skip


def _draw_bars(ax: Axes, times: Mapping[str, float], styles: Mapping[str, dict[str, Any]]) -> None:
    """Draw the time that each curve takes to one error, and name those that never reach it."""
    reached = sorted((name for name in times if math.isfinite(times[name])), key=times.__getitem__)
    places = range(len(reached))
    colours = [styles.get(name, GREY)["color"] for name in reached]
    ax.barh(places, [1e3 * times[name] for name in reached], color=colours)
    for place, name in enumerate(reached):
        ax.annotate(f"{1e3 * times[name]:.3g}", (1e3 * times[name], place), (3, 0), textcoords="offset points",
                    va="center", fontsize="x-small")  # fmt: skip
    ax.set_yticks(places, reached, fontsize="x-small")
    ax.set(xscale="log", xlabel="ms", ylim=(len(reached) - 0.4, -0.6))
    ax.margins(x=0.15)
    ax.set_title(f"Time to an error of {TARGET:g}", loc="left", fontsize="medium")
    never = [name for name in times if name not in reached]
    if never:
        ax.set_xlabel(f"ms\n\nnever: {textwrap.fill(', '.join(never), 48)}", fontsize="x-small")


def _known(points: Iterable[Mapping[str, Any]], cost: str) -> list[tuple[float, float]]:
    return [(point[cost], point["error"]) for point in points if point[cost]]


def _or_never(seconds: float) -> float:
    return seconds if math.isfinite(seconds) else math.inf


def _style(place: int, curve: Any) -> dict[str, Any]:
    """Return how a curve that leads is drawn."""
    if curve.to_tolerance:
        return {"color": "black", "marker": "*", "ms": 8, "lw": 1.8, "zorder": 4}
    return {"color": SHADES[place], "marker": SHAPES[place], "ms": 5.5, "lw": 1.8, "zorder": 3}


def _draw_orders(ax: Axes) -> None:
    """Draw slopes of several orders of convergence, in the corner that no method reaches."""
    start, bottom = 1.3 * ax.get_xlim()[0], ax.get_ylim()[0]
    top, end = 1e6 * bottom, 30 * bottom
    for order in ORDERS:
        last = start * min((top / end) ** (1 / order), 10)
        low = top * (last / start) ** -order
        ax.plot([start, last], [top, low], color="0.5", lw=0.9)
        ax.annotate(
            f"{order}", (last, low), (2, -3), textcoords="offset points", va="top", color="0.35"
        )
    ax.annotate("order", (start, top), (0, 4), textcoords="offset points", color="0.35")


def _title(scene: Scene) -> str:
    column = scene.chain
    weight = f"g = {column.gravity:g} m/s²" if column.gravity else "no gravity"
    number = f"strike number {scene.strike_number:.2g}" if column.compressed else "sonic vacuum"
    return f"{column.grains} grains, {weight}, {scene.excitation.label} ({number}), at t = {scene.duration * 1e6:g} µs"


def _footer(result: Any) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in result.versions.items())
    said = (
        "Error: the larger of those of displacement and velocity, each the largest over samples and grains relative to "
        "the largest motion of any grain at any time. "
        f"Reference: {result.reference.method}; its error is {result.reference.error:.0e}, and "
        f"{result.dropped} points within {KNOWN:g} times of that are left out. Times: of the integration, to a "
        f"tolerance with the error estimate, and the least of several runs after a first, on {result.machine}; "
        f"{versions}."
    )
    return textwrap.fill(said, LETTERS)
