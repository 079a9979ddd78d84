"""Colours, markers and figures of all charts, without global matplotlib state."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from .arrays import Array
from .files import write_aside

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Okabe and Ito, Color Universal Design (2008): distinct for every kind of colour vision
COLOURS = {
    "native": "#0072B2",
    "lammps": "#D55E00",
    "modes": "#009E73",
    "chebyshev": "#CC79A7",
    "bessel": "#56B4E9",
    "continuum": "#E69F00",
}
MARKERS = {"native": "s", "lammps": "o", "modes": "^", "chebyshev": "D", "bessel": "v", "continuum": "P"}
LOWEST = 1e-17  # below all round-off: drawn in place of 0 on a logarithmic axis
# colours and markers of integrators: Okabe and Ito, and two shades that differ in lightness
SHADES = ("#E69F00", "#56B4E9", "#0072B2", "#009E73", "#CC79A7", "#D55E00", "#6A3D00", "#999933")
SHAPES = ("o", "D", "s", "v", "^", "P", "X", "p")


def thinned(rows: Array, values: Array, most: int = 2000) -> tuple[Array, Array]:
    """Return fewer rows of a map: of every few, the one that differs most from its first value.

    Examples
    --------
    >>> rows, values = thinned(np.arange(6.0), np.array([[0, 0], [0, 9], [0, 1], [0, 0], [0, 0], [0, -4.0]]), most=2)
    >>> rows.tolist(), values.tolist()
    ([0.0, 3.0], [[0.0, 9.0], [0.0, -4.0]])
    """
    every = -(-len(rows) // most)
    if every == 1:
        return rows, values
    first = np.arange(0, len(rows), every)
    size = np.abs(values - values[:, :1]).max(1)
    loudest = [at + int(size[at : at + every].argmax()) for at in first]
    return rows[first], values[loudest]


def figure(width: float = 8.0, height: float = 7.0) -> Figure:
    """Return an empty figure of this size in inches, drawn with Agg."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    new = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(new)
    return new


def axes_in_units(ax: Axes | None, x: str, y: str) -> tuple[Axes, Figure]:
    """Return axes, given or new, labelled in these units with SI prefixes, and their figure."""
    from matplotlib.ticker import EngFormatter

    if ax is None:
        ax = figure(6.4, 4.2).subplots()
        ax.set_prop_cycle(color=list(COLOURS.values()))
    for axis, unit in ((ax.xaxis, x), (ax.yaxis, y)):
        if unit:
            axis.set_major_formatter(EngFormatter(unit))
    return ax, ax.figure.figure  # type: ignore[return-value]


def save(picture: Figure, path: str | PathLike[str], dpi: int = 150) -> None:
    """Write a picture, atomically."""
    with write_aside(path) as aside:
        picture.savefig(aside, dpi=dpi)
