"""Colours, markers and figures of all charts."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Sequence
from os import PathLike
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from .arrays import Array
from .files import write_aside

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure
else:
    # Matplotlib is imported only if something is drawn, so annotations use this name.
    Axes = Any


# Okabe and Ito, Color Universal Design (2008): distinct for all types of colour vision.
COLOURS = {
    "blue": "#0072B2",
    "vermilion": "#D55E00",
    "green": "#009E73",
    "pink": "#CC79A7",
    "sky blue": "#56B4E9",
    "orange": "#E69F00",
}
# Means with their errors, joined by a line.
ERROR_BARS: dict[str, Any] = {"fmt": "o-", "ms": 3, "capsize": 2}
NARROW = 3.5  # Width in inches of axes that share a page with others.
PRINTED_WIDTH = 7.0  # Width in inches of a picture on a printed page.
LEAST_LETTER = 8.0  # Size in points of the smallest letters of a picture of this width.
LEAST_ERROR = 1e-17  # Drawn in place of 0 on a logarithmic axis; below all rounding errors.
# Colours and markers of integrators: Okabe and Ito, and two shades that differ in lightness.
SHADES = ("#E69F00", "#56B4E9", "#0072B2", "#009E73", "#CC79A7", "#D55E00", "#6A3D00", "#999933")
SHAPES = ("o", "D", "s", "v", "^", "P", "X", "p")
# Each integrator has the same colour and marker in every picture.
INTEGRATORS = ("kahan-li6", "kahan-li8", "verlet", "rkn6", "rkn4", "dop853", "gear4")
# A number in computer notation, such as 2e-08.
POWER = re.compile(r"(?<![\w.$])(\d(?:\.\d+)?)e\+?(-?)0*(\d+)(?!\w)")
PLAIN = (1e-3, 1e3)  # Between these bounds, numbers are written without a power of ten.
# A hyphen that is a minus sign, between two terms or before one.
MINUS = re.compile(r"(?<=\S )-(?= \S)|(?<![^\s(])-(?=[\w.])")
LABEL_HEIGHT = 0.055  # Height of a line of small letters as a fraction of the axes.


def look_of(integrator: str) -> dict[str, Any]:
    """Return the colour and the marker of an integrator.

    Examples
    --------
    >>> look_of("verlet")
    {'color': '#0072B2', 'marker': 's'}
    """
    place = INTEGRATORS.index(integrator) if integrator in INTEGRATORS else len(SHADES) - 1
    return {"color": SHADES[place], "marker": SHAPES[place]}


def typeset(text: str) -> str:
    """Return text with powers of ten, strike numbers and signs in mathematical notation.

    Examples
    --------
    >>> print(typeset("v0* = 1e-06, 2e-08 off"))
    $v_0^*$ = $10^{-6}$, $2\\times 10^{-8}$ off
    >>> print(typeset("1.2e-01 and 0.0e+00"))
    0.12 and 0
    >>> print(typeset("n - 1/2, (-0.08), kahan-li6"))
    n − 1/2, (−0.08), kahan-li6
    """
    text = re.sub(r"v0\*|v\$_0\$\*", "$v_0^*$", text)
    text = POWER.sub(_typeset_number, text)
    return MINUS.sub("\N{MINUS SIGN}", text)


def _typeset_number(said: re.Match[str]) -> str:
    """Return a number of the form 2e-08 in plain or scientific notation."""
    number = float(said[0])
    if number == 0 or PLAIN[0] <= number < PLAIN[1]:
        return f"{number:g}"
    factor = "" if float(said[1]) == 1 else rf"{said[1]}\times "
    return f"${factor}10^{{{said[2]}{said[3]}}}$"


def label_ends(ax: Axes, ends: Sequence[tuple[float, str, str]]) -> None:
    """Write names at the right of axes at the heights of the curve ends, without overlap.

    Parameters
    ----------
    ends : list of (height, name, colour)
        Height of the end of each curve, in units of the vertical axis, and its name and colour.
    """
    # This call fixes the limits, on which positions depend.
    ax.get_ylim()
    place = ax.transData.transform
    low, high = ax.transAxes.transform([(0, 0), (0, 1)])[:, 1]
    heights = [(place((1, height))[1] - low) / (high - low) for height, _, _ in ends]
    below = -np.inf
    for share, (height, name, colour) in sorted(zip(heights, ends, strict=True)):
        below = max(share, below + LABEL_HEIGHT)
        ax.annotate(
            name,
            (1.0, height),
            (1.02, below),
            ("axes fraction", "data"),
            "axes fraction",
            color=colour,
            va="center",
            fontsize="small",
        )


def thin_rows(rows: Array, values: Array, most: int = 2000) -> tuple[Array, Array]:
    """Return fewer rows of a map: from each group, the row that deviates most from its first value.

    Examples
    --------
    >>> values = np.array([[0, 0], [0, 9], [0, 1], [0, 0], [0, 0], [0, -4.0]])
    >>> rows, values = thin_rows(np.arange(6.0), values, most=2)
    >>> rows.tolist(), values.tolist()
    ([0.0, 3.0], [[0.0, 9.0], [0.0, -4.0]])
    """
    first, largest = loudest_rows(values, most)
    return rows[first], values[largest]


def loudest_rows(values: Array, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Return two rows of each group: the first one, and the one that deviates most from it.

    Examples
    --------
    >>> loudest_rows(np.array([[0, 0], [0, 9], [0, 1], [0, 0], [0, 0], [0, -4.0]]), most=2)
    (array([0, 3]), array([1, 5]))
    """
    stride = -(-len(values) // most)
    first = np.arange(0, len(values), stride)
    if stride == 1:
        return first, first
    size = np.abs(values - values[:, :1]).max(1)
    return first, np.array([row + int(size[row : row + stride].argmax()) for row in first])


def choose_few(count: int, few: int = 4) -> Array:
    """Return the indices of a few of `count` items, evenly spaced.

    Examples
    --------
    >>> choose_few(10).tolist(), choose_few(2).tolist()
    ([0, 3, 6, 9], [0, 1])
    """
    return np.unique(np.linspace(0, count - 1, few).round().astype(int))


def edges(middles: Array) -> Array:
    """Return the edges of cells with these centres.

    Examples
    --------
    >>> edges(np.array([1.0, 2.0, 4.0])).tolist()
    [0.5, 1.5, 3.0, 5.0]
    """
    # A single cell has the width 1.
    half = np.diff(middles) / 2 if len(middles) > 1 else np.array([0.5])
    return np.concatenate(
        ([middles[0] - half[0]], (middles[1:] + middles[:-1]) / 2, [middles[-1] + half[-1]])
    )


def figure(width: float = 8.0, height: float = 7.0) -> Figure:
    """Return an empty figure of this size in inches for saving, not registered in `pyplot`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    picture = Figure(figsize=(width, height), layout="constrained")
    # Without pyplot, the figure is freed with its last reference.
    FigureCanvasAgg(picture)
    return picture


def si(value: float, unit: str, places: int | None = None) -> str:
    """Return a number with its unit and an SI prefix, rounded to some decimal places."""
    from matplotlib.ticker import EngFormatter

    return EngFormatter(unit, places=places)(value)


def prefixed(value: float, unit: str, digits: int = 4) -> str:
    """Return a number with its unit and an SI prefix, rounded to some significant digits.

    Examples
    --------
    >>> prefixed(1.0310392e-4, "s"), prefixed(2.0032e-4, "N", 2)
    ('103.1 µs', '200 µN')
    """
    return si(float(f"{value:.{digits}g}"), unit)


def with_error(value: float, error: float, unit: str) -> str:
    """Return a number rounded to the first digit of its error, both with one SI prefix.

    Examples
    --------
    >>> with_error(7.998059e-4, 6.651e-7, "m/s"), with_error(0.05, 0.0, "N")
    ('799.8 ± 0.7 µm/s', '50 mN')
    """
    from matplotlib.ticker import EngFormatter

    power = 3 * math.floor(math.log10(abs(value)) / 3) if value else 0
    prefix = EngFormatter.ENG_PREFIXES.get(power)
    if prefix is None or not (0 < error < math.inf):
        return prefixed(value, unit)
    places = max(0, -math.floor(math.log10(error) - power))
    numbers = (f"{number / 10.0**power:.{places}f}" for number in (value, error))
    return f"{' ± '.join(numbers)} {prefix}{unit}"


def window(width: float = 6.4, height: float = 4.2) -> Figure:
    """Return an empty figure of this size in inches for `pyplot.show` and notebooks."""
    from matplotlib import pyplot

    return pyplot.figure(figsize=(width, height), layout="constrained")


def axes_in_units(ax: Axes | None, x: str, y: str, logarithmic: str = "") -> Axes:
    """Return axes, given or new, in our style, with labels in these units with SI prefixes.

    `logarithmic` ("x", "y" or "xy") names the logarithmic axes. Their scale must be set here,
    because matplotlib removes the unit of an axis if its scale is set later.
    """
    from .ticks import UnitFormatter

    ax = window().subplots() if ax is None else ax
    if not ax.has_data():
        ax.set_prop_cycle(color=list(COLOURS.values()))
    narrow = _inches(ax) < NARROW
    names: tuple[Literal["x", "y"], ...] = ("x", "y")
    for name, axis, unit in zip(names, (ax.xaxis, ax.yaxis), (x, y), strict=True):
        if name in logarithmic:
            ax.set(**{f"{name}scale": "log"})
        if unit:
            axis.set_major_formatter(UnitFormatter(unit))
            if axis.get_scale() == "log":
                # Minor ticks ignore the prefix.
                axis.set_minor_formatter("")
        if axis.get_scale() == "linear" and (narrow or (name == "x" and unit)):
            ax.locator_params(axis=name, nbins=5 if narrow else 6)
        if narrow:
            axis.label.set_fontsize(LEAST_LETTER)
            axis.set_tick_params(labelsize=LEAST_LETTER)
    return ax


def panels(ax: Axes | Sequence[Axes]) -> list[Axes]:
    """Return the given axes, one or several, in our style."""
    several = ax if isinstance(ax, Sequence | np.ndarray) else [ax]
    return [axes_in_units(single, "", "") for single in several]


def set_title(ax: Axes, text: str) -> None:
    """Put a title above axes, on the left, wrapped to their width."""
    # Text with a power of ten is a little wider than its source.
    wide = 11.0 if typeset(text) != text else 10.0
    ax.set_title(typeset(_fold(ax, text, wide)), loc="left", fontsize=10.0)


def letter_panels(axes: Sequence[Axes]) -> None:
    """Put (a), (b) ... before the titles of the panels of one picture, if there are several."""
    if len(axes) > 1:
        for letter, ax in zip(ascii_lowercase, axes, strict=False):
            set_title(ax, f"({letter}) {ax.get_title(loc='left')}".rstrip())


def legend(ax: Axes, *handles: Any, below: float | None = None, **keys: Any) -> None:
    """Add a legend of lines and markers, if there are any, with a font that fits the axes.

    If `below` is given, the legend is placed under the axes, at this fraction of their height.
    """
    if below is not None:
        keys |= {"loc": "upper center", "bbox_to_anchor": (0.5, -below)}
    handles = handles or ax.get_legend_handles_labels()
    if handles[0]:
        size = LEAST_LETTER if _inches(ax) < NARROW else 9.0
        labels = [typeset(_fold(ax, label, size + 2.0)) for label in handles[1]]
        ax.legend(
            handles[0], labels, **{"frameon": False, "fontsize": size, "handlelength": 1.5} | keys
        )


def split_label(text: str) -> tuple[str, str]:
    """Return the name and the unit of a label, "" if it has none.

    Examples
    --------
    >>> split_label("time [s]"), split_label("share"), split_label("force []")
    (('time', 's'), ('share', ''), ('force', ''))
    """
    name, _, unit = text.partition(" [")
    return name, unit.removesuffix("]")


def chart(ax: Axes | None, x: str, y: str, logarithmic: str = "") -> Axes:
    """Return axes, given or new, in our colours, with these labels.

    Parameters
    ----------
    ax : Axes, optional
        Axes to draw in; by default those of a new figure.
    x : str
        Label of the horizontal axis. A unit in brackets, as in "time [s]", is written with the SI
        prefix that suits the values.
    y : str
        Label of the vertical axis, with a unit in the same form.
    logarithmic : str
        Logarithmic axes: "x", "y" or "xy".
    """
    (x_name, x_unit), (y_name, y_unit) = (split_label(text) for text in (x, y))
    ax = axes_in_units(ax, x_unit, y_unit, logarithmic)
    ax.set(xlabel=x_name, ylabel=y_name)
    return ax


def finish(ax: Axes, title: str = "", **keys: Any) -> Axes:
    """Add a title, if any, and a legend of the lines with labels, and return the axes.

    Parameters
    ----------
    ax : Axes
        Axes that `chart` returned.
    title : str
        Text above the axes.
    **keys
        Options of the legend; see `legend`.
    """
    if title:
        set_title(ax, title)
    legend(ax, **keys)
    return ax


def mark_decades(ax: Axes) -> None:
    """Write plain numbers at 1, 2 and 5 of each decade of a logarithmic horizontal axis."""
    from matplotlib.ticker import LogLocator

    ax.xaxis.set(
        major_locator=LogLocator(subs=(1, 2, 5)), major_formatter="{x:g}", minor_formatter=""
    )


def draw_map(
    ax: Axes, x: Array, y: Array, values: Array, label: str, extend: str = "neither", **colours: Any
) -> None:
    """Draw values (Y, X) as the colours of cells with centres x and y, beside a bar of colours."""
    mesh = ax.pcolorfast(edges(x), edges(y), values, **colours)
    colour_bar(ax, mesh, label, extend=extend)


def colour_bar(ax: Axes, shown: ScalarMappable, label: str, **keys: Any) -> None:
    """Add a colour bar beside axes, with letters of equal size.

    The unit in brackets in `label`, as in "force [N]", is written with an SI prefix.
    """
    from .ticks import UnitFormatter

    # Measure the width before the bar reduces it.
    narrow = _inches(ax) < NARROW
    name, unit = split_label(label)
    ticks = UnitFormatter(unit) if unit else None
    bar = ax.figure.figure.colorbar(shown, ax=ax, label=name, format=ticks, **keys)
    bar.ax.yaxis.label.set_fontsize(ax.yaxis.label.get_fontsize())
    if narrow:
        bar.ax.tick_params(labelsize=LEAST_LETTER)


def _inches(ax: Axes) -> float:
    """Return the width of axes before the layout, in inches."""
    return float(ax.get_position().width * ax.figure.figure.get_size_inches()[0])


def _fold(ax: Axes, text: str, size: float) -> str:
    """Return text wrapped to the width of axes, for a font size in points."""
    # A letter is about half as wide as high.
    return textwrap.fill(text, max(12, int(72 * _inches(ax) / (0.52 * size))))


def save(
    picture: Figure | Axes, path: str | PathLike[str], dpi: int = 150, overwrite: bool = False
) -> None:
    """Write a figure, or the figure of some axes, atomically; see `write_aside`."""
    with write_aside(path, overwrite) as aside:
        picture.figure.figure.savefig(aside, dpi=dpi)
