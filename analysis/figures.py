"""Shared parts of the figure scripts: arguments, panels with residuals, styles, printed numbers."""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import rc_context, rcParams
from matplotlib.collections import QuadMesh
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

import lmpchain
from lmpchain.engines import Lammps, Native
from lmpchain.util.files import write_aside
from lmpchain.util.plotting import COLOURS, LEAST_LETTER, PRINTED_WIDTH, figure, typeset

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HERE = Path(__file__).parent
TABLES = HERE / "tables"  # Tables that pages include.
# Colours of Okabe and Ito.
SHADES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
NATIVE, LAMMPS = (
    {"ls": "none", "marker": marker, "ms": size, "mfc": "none", "color": colour}
    for (colour, marker), size in ((Native.style, 3.5), (Lammps.style, 6.5))
)
THEORY = {"color": "0.2", "lw": 1.4}
LETTERS = {
    "font.size": 9,
    "axes.labelsize": 8.5,
    "xtick.labelsize": LEAST_LETTER,
    "ytick.labelsize": LEAST_LETTER,
    "legend.fontsize": LEAST_LETTER,
    "legend.title_fontsize": LEAST_LETTER,
    "legend.frameon": False,
}
OUTLINE = [withStroke(linewidth=2, foreground="white")]  # Outline of letters on maps.
DARK_OUTLINE = [withStroke(linewidth=4, foreground="black")]  # Outline of white lines on maps.
# Label of a panel that shows differences from the panel above, like matplotlib's <colorbar>.
DIFFERENCES = "<differences>"
SVG = "--svg"
PRINT_DPI = 300
PRINTED_NUMBERS: dict[str, float] = {}  # Numbers that `say` has printed.
# Style of the paper's formula where it is wrong.
PRINTED = {
    "color": COLOURS["green"],
    "lw": 1.4,
    "ls": "--",
}


def arguments(script: str, doc: str, **flags: str) -> argparse.Namespace:
    """Read --quick, -o and further flags, which are given with their help.

    The picture goes into `pictures/` beside the script, with --quick into this folder.
    """
    name = f"{Path(script).stem}.png"
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="smaller and faster, for tests; draws ./" + name
    )
    parser.add_argument(
        "-o", "--output", type=Path, help="the picture; by default pictures/" + name
    )
    prepare_drawing(parser)
    for flag, what in flags.items():
        parser.add_argument("--" + flag.replace("_", "-"), action="store_true", help=what)
    given = parser.parse_args()
    given.output = given.output or (
        Path(name) if given.quick else Path(script).resolve().parent / "pictures" / name
    )
    return given


def prepare_drawing(parser: argparse.ArgumentParser) -> None:
    """Set the letter sizes of all pictures, and allow --svg, which `finish` reads."""
    # A script that only imports this module leaves the pictures of its process as they are.
    rcParams.update(LETTERS)
    parser.add_argument(SVG, action="store_true", help="write the picture as SVG, too, for print")


def page(
    columns: int, rows: int = 1, width: float = 7.5, height: float = 5.0
) -> tuple[Figure, list[tuple[Axes, Axes]]]:
    """Return a figure and its pairs of panels, row by row: curves, and their differences below."""
    picture = figure(width, height)
    axes = picture.subplots(
        2 * rows, columns, sharex=False, squeeze=False, height_ratios=(3, 1.2) * rows
    )
    pairs = []
    for row in range(rows):
        for upper, lower in zip(axes[2 * row], axes[2 * row + 1], strict=True):
            lower.sharex(upper)
            lower.set_label(DIFFERENCES)
            lower.set_yscale("log")
            lower.yaxis.set_minor_formatter("")
            upper.tick_params(labelbottom=False)
            pairs.append((upper, lower))
    return picture, pairs


def one_above_two(width: float = 7.5, height: float = 6.5) -> tuple[Figure, Axes, Axes, Axes]:
    """Return a figure with one wide panel and two panels below it."""
    picture = figure(width, height)
    axes = picture.subplot_mosaic([["above", "above"], ["left", "right"]])
    return picture, axes["above"], axes["left"], axes["right"]


def apart(
    axes: Axes, x: np.ndarray, measured: np.ndarray, other: np.ndarray, unit: float, **style: object
) -> None:
    """Draw |measured - other| / unit on a logarithmic axis, leaving out zeros."""
    difference = np.abs(measured - other) / unit
    axes.plot(x, np.where(difference > 0, difference, np.nan), **{"ms": 3, **style})


def end_of_run(
    pair: tuple[Axes, Axes], scene: lmpchain.Scene, engine: str, unit: float, exact: np.ndarray
) -> float:
    """Run a scene, draw final and exact displacements over `unit`, and return the error."""
    wave, below = pair
    style, tolerance = {"lammps": (LAMMPS, 1e-6), "native": (NATIVE, 1e-12)}[engine]
    run = lmpchain.simulate(scene, engine, tolerance)
    n = run.grains[:-1]
    measured = run.displacement[-1, :-1] / unit
    off = distance(measured, exact)
    wave.plot(n, measured, **style)
    apart(below, n, measured, exact, np.abs(exact).max(), **style | {"ls": "-", "lw": 0.7})
    return off


def legends(picture: Figure, **keys: object) -> None:
    """Add a legend to every panel with labels."""
    for axes in picture.axes:
        if axes.get_legend_handles_labels()[0]:
            axes.legend(**keys)


def random_search(
    drawn: Callable[[np.random.Generator], lmpchain.Scene],
    value: Callable[[lmpchain.Scene], float],
    seconds: float,
) -> tuple[float, lmpchain.Scene | None, int]:
    """Return the best value, its scene, and the number of draws in this CPU time, s."""
    rng = np.random.default_rng(2)
    best = (np.inf, None)
    tried = 0
    end = time.process_time() + seconds
    while time.process_time() < end:
        tried += 1
        try:
            scene = drawn(rng)
            best = min(best, (value(scene), scene), key=lambda one: one[0])
        except lmpchain.InputError:  # The scene is invalid, or has no such value.
            continue
    return *best, tried


def finish(picture: Figure, path: Path) -> None:
    """Save the picture in full colour and in the common style, and print its location.

    The commit, the command and the printed numbers are in it.
    """
    restyle(picture)
    about = {"Commit": commit(), "Command": command(), "Numbers": json.dumps(PRINTED_NUMBERS)}
    with write_aside(path, overwrite=True) as aside:
        picture.savefig(aside, dpi=110, format="png", metadata=about, pil_kwargs={"optimize": True})
    if SVG in sys.argv:
        save_for_print(picture, path.with_suffix(".svg"))
    print(f"picture: {path}")


def save_for_print(picture: Figure, path: Path) -> None:
    """Save as SVG with letters as outlines, which look the same without our fonts.

    The cells of maps, which are thousands, become pixels that are fine enough for print.
    """
    for cells in picture.findobj(QuadMesh):
        cells.set_rasterized(True)
    # The same picture gives the same file, because no date is stored.
    with rc_context({"svg.hashsalt": "lmpchain"}), write_aside(path, overwrite=True) as aside:
        picture.savefig(aside, dpi=PRINT_DPI, format="svg", metadata={"Date": None})


def restyle(picture: Figure) -> None:
    """Move titles to the left, after the panel letters, and typeset numbers as formulas.

    No letters are smaller than `LEAST_LETTER` if the picture is printed 7 inches wide.
    """
    lettered = [axes for axes in picture.axes if not axes.get_label().startswith("<")]
    for axes in picture.axes:
        title = axes.get_title() or axes.get_title(loc="left")
        axes.set_title("")
        if len(lettered) > 1 and axes in lettered and not title.startswith("("):
            title = f"({ascii_lowercase[lettered.index(axes)]}) {title}"
        axes.set_title(title, loc="left", fontsize="medium")
    least = LEAST_LETTER * max(1.0, picture.get_figwidth() / PRINTED_WIDTH)
    for text in picture.findobj(Text):
        text.set_text(re.sub(r"\blammps\b", "LAMMPS", typeset(text.get_text())))
        text.set_fontsize(max(text.get_fontsize(), least))


def commit() -> str:
    """Return the current commit, marked if files differ from it; empty outside a repository."""
    said = [
        subprocess.run(
            ["git", *words.split()], cwd=HERE, capture_output=True, text=True, check=False
        ).stdout.strip()
        for words in (
            "rev-parse HEAD",
            "status --porcelain --untracked-files=no -- ../lmpchain . :!*pictures/*",
        )
    ]
    return f"{said[0]}{' and changes' if said[1] else ''}"


def command() -> str:
    """Return the command that draws, relative to the folder above, without the output option."""
    options = [
        word
        for word in sys.argv[1:]
        if word != SVG and (word.startswith("--") or not re.search(r"[/.]|^-o$", word))
    ]
    return " ".join(["python", os.path.relpath(sys.argv[0], HERE.parent), *options])


def say(label: str, value: float, unit: str = "") -> None:
    """Print a number in the form that the tests read: label, colon, number, unit."""
    PRINTED_NUMBERS[label] = float(f"{value:.6g}")
    print(f"{label}: {value:.6g} {unit}".rstrip())


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table in Markdown, row by row, and write it for a page."""
    lines = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    print("\n".join(lines), flush=True)
    for row in rows:
        # Exponents are written as on the pages: 1e-6.
        lines.append(f"| {' | '.join(map(str, row))} |".replace("e-0", "e-"))
        print(lines[-1], flush=True)
    with write_aside(path, overwrite=True) as aside:
        aside.write_text("\n".join(lines) + "\n", encoding="utf-8")


def no_answer(axes: Axes) -> None:
    """Hatch the empty parts of a map, and add their meaning."""
    axes.patch.set(facecolor="0.93", hatch="////", edgecolor="0.75")
    axes.plot([], [], "s", color="0.93", mec="0.6", ms=9, label="no answer here")


def distance(measured: np.ndarray, reference: np.ndarray) -> float:
    """Return the relative distance |measured - reference| / |reference| in the Euclidean norm."""
    return float(np.linalg.norm(measured - reference) / np.linalg.norm(reference))


def summit(profile: np.ndarray) -> float:
    """Return the position of the maximum of a profile of grains 1, 2 ..., by a parabola."""
    top = int(profile.argmax())
    before, here, after = profile[top - 1 : top + 2]
    return top + 1 + 0.5 * (before - after) / (before - 2 * here + after)


def shorter(scene: lmpchain.Scene, grains: int) -> lmpchain.Scene:
    """Return the scene with fewer grains."""
    chain = lmpchain.Chain(**scene.chain.given() | {"grains": grains})
    return lmpchain.Scene(**scene.given() | {"chain": chain})


def weak_scene(
    grains: int,
    tau: float,
    samples: int,
    strength: float,
    delta: float = 1.5,
    moved: int = 0,
    recorded: str | Iterable[int] = "all",
) -> lmpchain.Scene:
    """Return a column of the paper's glass beads with a strike or displacement of this strength.

    The strength is relative to what its first contact can hold.

    Parameters
    ----------
    tau : float
        Duration in the unit of the paper's tau.
    strength : float
        Of a velocity of grain 1, in eps_1 / time unit; with `moved`, of a displacement of that
        grain, in its eps_n.
    recorded
        Grains.
    """
    chain = lmpchain.Chain(grains=grains, diameter=1e-3, exponent=delta)
    excitation = (
        lmpchain.Displacement(
            displacement=strength * chain.equilibrium_overlap[moved - 1], grain=moved
        )
        if moved
        else lmpchain.Impulse(velocity=strength * chain.length_scale / chain.time_scale)
    )
    return lmpchain.Scene(
        chain=chain,
        excitation=excitation,
        duration=tau * chain.time_scale,
        samples=samples,
        grains=recorded,
    )


def kappa(grains: int, delta: float = 1.5) -> np.ndarray:
    """Return kappa_1 ... kappa_(N-1) of Eq. (3)."""
    return np.arange(1, grains) ** (1 - 1 / delta)
