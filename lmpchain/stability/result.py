"""The limits of methods on a scene: table, numbers and picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator

from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.notebook import Shown
from ..util.plotting import (
    COLOURS,
    LEAST_ERROR,
    PRINTED_WIDTH,
    Axes,
    chart,
    finish,
    letter_panels,
    look_of,
    panels,
    typeset,
    window,
)
from ..util.tables import align, finite, number
from ..util.tabular import NamedColumn, Tabular, of_rows

# Place of the legend, beside the axes.
LEGEND_BELOW: dict[str, Any] = {"below": 0.24, "ncols": 4}
TOLERANCE = 1e-6  # Tolerance that defines the predictability horizon.


@dataclass(frozen=True)
class Boundary:
    """A limit of a method on a scene; unknown numbers are NaN.

    Attributes
    ----------
    what : str
        Name of the limit, such as "longest step" or "smallest error".
    method : str
        Name of the engine, the integrator or the equation.
    unit : str
        Unit of the numbers; empty for ratios.
    predicted : float
        The limit predicted by a law.
    measured : float
        The limit measured on this scene.
    here : float
        The value of this scene; NaN if the user chooses it, such as a step.
    beyond : bool
        Whether the scene exceeds the limit.
    """

    what: str
    method: str
    unit: str
    predicted: float
    measured: float = math.nan
    here: float = math.nan
    beyond: bool = False


@dataclass(frozen=True, eq=False)
class Curve:
    """A measured curve for the picture.

    Attributes
    ----------
    panel : "energy", "growth" or "strength"
        Panel of the picture in which the curve is drawn.
    name : str
        Label of the curve.
    x : array
        Values on the horizontal axis of the panel.
    y : array
        Values on the vertical axis of the panel.
    """

    panel: str
    name: str
    x: Array
    y: Array


@dataclass(frozen=True, eq=False, repr=False)
class Stability(Shown, Tabular):
    """The limits of all methods on a scene.

    Attributes
    ----------
    scene : Scene
        The scene.
    boundaries : tuple of Boundary
        Limits, predicted and measured.
    curves : tuple of Curve
        Measured curves for the picture.
    left_out : tuple of str
        Measurements that could not be made, each with the reason.
    """

    scene: Scene
    boundaries: tuple[Boundary, ...]
    curves: tuple[Curve, ...]
    left_out: tuple[str, ...]

    def table(self) -> str:
        """Return the limits as a table; limits that the scene exceeds are marked."""
        return "\n".join(align(self._summary()))

    def _summary(self) -> Iterator[Sequence[str]]:
        yield "", "", "", "predicted", "measured", "this scene"
        for row in self.boundaries:
            numbers = (
                number(x, unit=row.unit, infinite="none")
                for x in (row.predicted, row.measured, row.here)
            )
            yield "!" if row.beyond else "", row.what, row.method, *numbers

    def to_json(self) -> dict[str, Any]:
        """Return rows and curves for a JSON file; numbers that are not finite become None."""
        rows = [finite(vars(boundary)) for boundary in self.boundaries]
        curves = [
            vars(curve) | {key: _list(getattr(curve, key)) for key in "xy"} for curve in self.curves
        ]
        return {"rows": rows, "curves": curves, "left_out": list(self.left_out)}

    def plot(self, ax: Axes | Sequence[Axes] | None = None) -> Axes:
        """Draw longest steps, energy error, divergence of two runs, and errors against strength.

        Parameters
        ----------
        ax : axes, or four of them, optional
            One axes to draw the longest steps alone, or four for all panels; by default a new
            figure with four.

        Returns
        -------
        Axes
            The axes of the longest steps.
        """
        own = window(PRINTED_WIDTH, 12.0).subplots(4) if ax is None else []
        steps, *others = panels(own if ax is None else ax)
        _draw_steps(steps, self)
        for draw, panel in zip((_draw_energy, _draw_growth, _draw_strength), others, strict=False):
            draw(panel, self)
        letter_panels(own)
        return steps

    def _columns(self) -> Iterator[NamedColumn]:
        return of_rows([vars(boundary) for boundary in self.boundaries])


def _list(values: Array) -> list[float | None]:
    return [float(x) if np.isfinite(x) else None for x in values]


STRENGTHS = {
    "Eq. (3), estimate": COLOURS["green"],
    "Eq. (3), at most": "0.6",
    "native, round-off": COLOURS["blue"],
}


def _draw_steps(axes: Axes, result: Stability) -> None:
    chart(axes, "longest step before a run of this duration breaks down [s]", "", "x")
    rows = [row for row in result.boundaries if row.what == "longest step"][::-1]
    heights = range(len(rows))
    predicted = [row.predicted for row in rows]
    measured = [row.measured for row in rows]
    axes.plot(predicted, heights, "|", ms=16, mew=2, color="0.3", label="predicted")
    axes.plot(measured, heights, "o", ms=6, color=COLOURS["vermilion"], label="measured")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.set_yticks(heights, [row.method for row in rows])
    axes.grid(axis="x", color="0.92", lw=0.6)
    finish(axes, "Time step", **LEGEND_BELOW)


def _draw_energy(axes: Axes, result: Stability) -> None:
    chart(axes, "time [s]", "relative error of the energy", "xy")
    for curve in (curve for curve in result.curves if curve.panel == "energy"):
        colour = look_of(curve.name)["color"]
        error = np.maximum(curve.y[1:], LEAST_ERROR)
        axes.plot(curve.x[1:], error, color=colour, lw=1.2, label=curve.name)
    finish(axes, "Energy, with forty steps a period of the fastest oscillation", **LEGEND_BELOW)


def _draw_growth(axes: Axes, result: Stability) -> None:
    chart(axes, "time [s]", "distance / largest value", "y")
    for curve in result.curves:
        if curve.panel == "growth":
            axes.plot(curve.x, np.maximum(curve.y, LEAST_ERROR), color=COLOURS["blue"], lw=1.3)
    end = result.scene.duration
    for level in (1e-3, TOLERANCE, 1e-9):
        axes.axhline(level, color="0.75", lw=0.8)
        text: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "color": "0.4"}
        axes.annotate(typeset(f"{level:g}"), (1, level), (-2, 2), ("axes fraction", "data"), **text)
    for row in result.boundaries:
        if row.what.startswith("predictable"):
            for value, style, label in (
                (row.predicted, "--", "predicted"),
                (row.measured, "-", "measured"),
            ):
                if np.isfinite(value) and value <= 1.2 * end:
                    name = typeset(f"predictable to {TOLERANCE:g}, {label}")
                    axes.axvline(value, color="0.3", ls=style, lw=1.2, label=name)
    axes.locator_params(axis="x", nbins=5)
    axes.set_ylim(top=10.0)
    finish(axes, "Divergence of two runs, 1e-13 apart at the start", **LEGEND_BELOW)


def _draw_strength(axes: Axes, result: Stability) -> None:
    chart(axes, "strength of the strike, over that of the scene", "relative error", "xy")
    styles = iter(("--", ":"))
    for curve in result.curves:
        if curve.panel == "strength":
            colour = STRENGTHS.get(curve.name, COLOURS["vermilion"])
            style = "-" if curve.name in STRENGTHS else next(styles)
            error = np.maximum(curve.y, LEAST_ERROR)
            axes.plot(curve.x, error, color=colour, ls=style, lw=1.4, label=curve.name)
    axes.axvline(1.0, color="0.3", lw=1)
    axes.annotate(
        "this scene", (1.0, 0.6), (-4, 0), ("data", "axes fraction"), "offset points", ha="right"
    )
    finish(axes, "Model error and round-off", **LEGEND_BELOW | {"ncols": 2})
