"""Draw the figure of `contributing.md`: what happens from a call to a picture, and in which files.

python docs/call_to_picture.py          # writes docs/_static/call_to_picture.svg
"""

import sys
from pathlib import Path
from typing import NamedTuple

from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

PICTURE = Path(__file__).parent / "_static" / "call_to_picture.svg"
WIDTH, HEIGHT, GAP = 2.05, 2.0, 0.32  # of a box, inches
INK = "#222222"


class Station(NamedTuple):
    """One box: its name, what happens there, the files to open, and its colour."""

    name: str
    about: str
    files: tuple[str, ...]
    colour: str


STATIONS = (
    Station(
        "Scene",
        "a chain, what strikes it,\nwhat is recorded",
        ("scene/scene.py", "chain/chain.py", "scene/excitation.py"),
        "#0072B2",
    ),
    Station(
        "Engine",
        "proposes a step, with\nits error and its cost",
        ("engines/base.py", "engines/stepping/\n    step_choice.py", "simulation/choice.py"),
        "#B34E00",
    ),
    Station(
        "Run",
        "yields samples, and\nestimates their error",
        (
            "engines/stepping/\n    time_stepping.py\n    monitor.py",
            "integrators/stepper.py",
            "integrators/kernels/",
        ),
        "#007A57",
    ),
    Station(
        "Trajectory",
        "samples, their error,\nwhat they cost",
        ("trajectory/\n    trajectory.py\n    netcdf.py", "trajectory/between/"),
        "#A0527F",
    ),
    Station(
        "Picture",
        "a measurement, a chart,\na page about the run",
        ("measure/", "trajectory/trajectory.py", "report/"),
        "#56606B",
    ),
)


def draw_station(axes: Axes, left: float, station: Station) -> None:
    """Draw one box with its left edge at this place."""
    box = FancyBboxPatch(
        (left, 0),
        WIDTH,
        HEIGHT,
        boxstyle="round,pad=0,rounding_size=0.08",
        facecolor="white",
        edgecolor=station.colour,
        linewidth=2,
    )
    axes.add_patch(box)
    inset = left + 0.12
    axes.text(inset, 1.78, station.name, size=13, weight="bold", color=station.colour, va="center")
    axes.text(inset, 1.58, station.about, size=9, color=INK, va="top", linespacing=1.35)
    files = "\n".join(station.files)
    axes.text(inset, 1.08, files, size=8, color=INK, va="top", family="monospace", linespacing=1.4)


def draw_arrow(axes: Axes, begin: tuple[float, float], end: tuple[float, float], bend: str) -> None:
    """Draw an arrow, straight or bent."""
    axes.add_patch(
        FancyArrowPatch(
            begin,
            end,
            connectionstyle=bend,
            arrowstyle="-|>",
            mutation_scale=13,
            color=INK,
            linewidth=1.3,
        )
    )


def draw() -> Figure:
    """Draw the boxes from left to right, the call that spans the first four, and step control."""
    pitch = WIDTH + GAP
    length = len(STATIONS) * pitch - GAP
    figure = Figure(figsize=(length + 0.4, 3.9))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(-0.2, length + 0.2)
    axes.set_ylim(-0.55, 3.35)
    axes.axis("off")
    call = FancyBboxPatch(
        (-0.1, -0.42),
        4 * pitch - GAP + 0.2,
        3.62,
        boxstyle="round,pad=0,rounding_size=0.1",
        facecolor="#F4F4F4",
        edgecolor="#888888",
        linestyle="--",
    )
    axes.add_patch(call)
    axes.text(0.05, 2.98, "simulate(scene, engine, tolerance)", size=12, weight="bold", color=INK)
    where = "simulation/api.py; a folder that can be resumed: simulation/run_folder.py"
    axes.text(3.75, 2.98, where, size=9, color=INK)
    middle = WIDTH / 2
    for number, station in enumerate(STATIONS):
        left = number * pitch
        draw_station(axes, left, station)
        if number:
            draw_arrow(axes, (left - GAP, 1.78), (left, 1.78), "arc3")
    draw_arrow(axes, (2 * pitch + 0.5, HEIGHT), (pitch + WIDTH - 0.5, HEIGHT), "arc3,rad=0.5")
    again = "shorter steps until the estimate meets\nthe tolerance: engines/step_control.py"
    axes.text(pitch + middle + pitch / 2, 2.4, again, size=9, color=INK, ha="center")
    blocks = (
        "Samples go from block to block: progress, checkpoints and files take what a run yields, "
        "and no engine knows of them."
    )
    axes.text(0.05, -0.27, blocks, size=9, color=INK)
    return figure


if __name__ == "__main__":
    # letters stay letters, and the same drawing gives the same file
    rcParams["svg.fonttype"] = "none"
    rcParams["svg.hashsalt"] = "lmpchain"
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURE
    draw().savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None, dpi=100)
