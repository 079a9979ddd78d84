"""Pictures. They are made of matplotlib figures without global state, so notebooks and threads stay undisturbed."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from .excitation import Impulse
from .fields import Array
from .files import write_aside

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .measure.compare import Comparison

# Okabe and Ito, Color Universal Design (2008): told apart with every kind of colour vision
COLOURS = {
    "native": "#0072B2",
    "lammps": "#D55E00",
    "modes": "#009E73",
    "chebyshev": "#CC79A7",
    "bessel": "#56B4E9",
    "continuum": "#E69F00",
}
MARKERS = {"native": "s", "lammps": "o", "modes": "^", "chebyshev": "D", "bessel": "v", "continuum": "P"}
WIDEST, MARGIN = 60, 4  # grains of the wave shown, and grains at rest on either side
LOWEST = 1e-17  # below all round-off: what a logarithmic axis shows in place of 0


def figure(width: float = 8.0, height: float = 7.0) -> Figure:
    """Return an empty figure of this size in inches, drawn with Agg."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    new = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(new)
    return new


def axes_in_units(ax: Axes | None, x: str, y: str) -> tuple[Axes, Figure]:
    """Return axes, those given or new ones, and their figure; their numbers bear these units, with SI prefixes."""
    from matplotlib.ticker import EngFormatter

    if ax is None:
        ax = figure(6.4, 4.2).subplots()
        ax.set_prop_cycle(color=list(COLOURS.values()))
    for axis, unit in ((ax.xaxis, x), (ax.yaxis, y)):
        if unit:
            axis.set_major_formatter(EngFormatter(unit))
    return ax, ax.figure.figure  # type: ignore[return-value]


def save(picture: Figure, path: str | PathLike[str], dpi: int = 150) -> None:
    """Write a picture; nothing stands under its name until it is whole."""
    with write_aside(path) as aside:
        picture.savefig(aside, dpi=dpi)


def draw_comparison(comparison: Comparison, axes: Sequence[Axes] | None = None) -> Figure:
    """Draw the answers, their errors over time and what they cost.

    Parameters
    ----------
    comparison : Comparison
    axes : three axes, optional
        For the wave, the error over time and the cost; by default those of a new figure.

    Returns
    -------
    Figure
    """
    if axes is None:
        panels = figure().subplot_mosaic([["wave", "wave"], ["error", "cost"]])
        axes = [panels["wave"], panels["error"], panels["cost"]]
    wave, error, cost = axes
    _draw_wave(comparison, wave)
    _draw_errors(comparison, error)
    _draw_cost(comparison, cost)
    return wave.figure.figure  # type: ignore[return-value]


def _draw_wave(comparison: Comparison, axes: Axes) -> None:
    """Velocity against grain number at the end: the truth as a line, the answers as markers of falling size."""
    truth, scene = comparison.reference, comparison.trajectories[0].scene
    if isinstance(scene.excitation, Impulse) and scene.excitation.velocity:
        unit, label = scene.excitation.velocity, r"velocity / strike velocity $v_0$"
    else:
        unit, label = 1.0, "velocity downward (m/s)"
    last = truth.velocity[-1] / unit
    axes.plot(np.arange(1, last.size + 1), last, color="0.55", lw=2, label="reference")
    first, end = _window(truth.velocity[-1])
    count = len(comparison.trajectories)
    for place, answer in enumerate(comparison.trajectories):
        shown = (answer.grains >= first) & (answer.grains <= end)
        axes.plot(
            answer.grains[shown],
            answer.velocity[-1, shown] / unit,
            linestyle="none",
            marker=MARKERS.get(answer.engine, "x"),
            markersize=7.5 - 3.5 * place / max(1, count - 1),
            markerfacecolor="none",
            markeredgewidth=1.3,
            color=_colour(answer.engine),
            label=answer.engine,
        )
    axes.axhline(0, color="0.8", lw=0.8, zorder=0)
    axes.set(xlabel="grain number, from the top", ylabel=label, xlim=(first - 0.5, end + 0.5))
    axes.set_title(f"Grains {first} to {end} of {scene.chain.grains} at t = {scene.duration * 1e6:g} µs", loc="left")
    axes.legend(frameon=False)


def _window(velocity: Array) -> tuple[int, int]:
    """Return the first and last grain of the part that moves, at most `WIDEST` grains around the fastest."""
    speed = np.abs(velocity)
    moving = np.flatnonzero(speed > 1e-3 * speed.max())
    if moving.size == 0:
        return 1, min(WIDEST, velocity.size)
    first, last = max(0, moving[0] - MARGIN), min(velocity.size - 1, moving[-1] + MARGIN)
    if last - first >= WIDEST:
        first = int(np.clip(speed.argmax() - WIDEST // 2, first, last - WIDEST + 1))
        last = first + WIDEST - 1
    return int(first) + 1, int(last) + 1


def _draw_errors(comparison: Comparison, axes: Axes) -> None:
    """Error over time, with the expected error as a dashed line."""
    truth = comparison.reference
    time = truth.time * 1e6
    for answer, row, found in zip(comparison.trajectories, comparison.rows, comparison.errors_over_time(), strict=True):
        values = np.maximum(found, LOWEST)
        colour = _colour(answer.engine)
        axes.semilogy(time[1:], values[1:], color=colour, lw=1.3, label=answer.engine)  # at t = 0 nothing is wrong yet
        axes.axhline(max(row.expected_error, LOWEST), color=colour, ls="--", lw=1.3)
    axes.axhline(max(truth.error, LOWEST), color="0.55", ls=":", lw=1.5)
    axes.plot([], [], color="0.3", ls="--", label="expected by the engine")
    axes.plot([], [], color="0.55", ls=":", lw=1.5, label="error of the reference")
    axes.set(xlabel="time (µs)", ylabel="relative error")
    axes.set_title("Error over time", loc="left")
    axes.margins(y=0.12)
    axes.legend(frameon=False, fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)


def _draw_cost(comparison: Comparison, axes: Axes) -> None:
    """Error against the time that the integration took."""
    for row in comparison.rows:
        x, y = max(row.integration_s, 1e-9), max(row.error, LOWEST)
        expected = max(row.expected_error, LOWEST)
        colour = _colour(row.engine)
        axes.loglog([x, x], [y, expected], color=colour, ls="--", lw=1.3)
        axes.loglog(x, expected, marker="_", markersize=10, markeredgewidth=1.8, color=colour, ls="none")
        name = row.engine if row.integrator == row.engine else f"{row.engine}, {row.integrator}"
        axes.loglog(x, y, marker=MARKERS.get(row.engine, "x"), markersize=8, color=colour, ls="none", label=name)
    axes.set(xlabel="integration time (s)", ylabel="relative error")
    axes.set_title("Error and cost (bar: expected error)", loc="left")
    axes.margins(x=0.2, y=0.15)
    axes.legend(frameon=False, fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)


def _colour(engine: str) -> str:
    return COLOURS.get(engine, "#000000")
