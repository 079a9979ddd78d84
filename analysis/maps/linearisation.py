"""Error of linear theory against strike and gravity, in four norms, and its estimate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from figures import DARK_OUTLINE, one_above_two
from laws.theory_errors import BEAD, column, linear_error, theory
from matplotlib.colors import LogNorm

from lmpchain import Chain
from lmpchain.engines.linear.engine import Chebyshev
from lmpchain.engines.linear.model_error import expected_error
from lmpchain.scene.excitation import Impulse
from lmpchain.scene.scene import Scene
from lmpchain.stability.linear_theory import LINEAR, linear_law, strike_number_at
from lmpchain.util.plotting import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DURATION, GRAINS, EARTH, TAU = (
    100e-6,
    120,
    9.81,
    14.555,
)  # Duration in s, gravity in m/s2, and 100 us in units of tau on Earth.
OPENS = 8.501  # Strike number v0* from which contact 1 of a Hertzian column opens.
NAMES = {
    "velocity": "velocities at the end",
    "displacement": "displacements, all samples",
    "package": "the package's: displacements and velocities",
    "peak": "peak velocity of the last grain passed",
}


def measure(quick: bool) -> dict[str, Any]:
    """Return the errors for each v0 and gravity after 100 us, and for each v0* on Earth."""
    strikes = np.geomspace(1e-8, 1, 5 if quick else 33)
    gravity = EARTH * np.geomspace(1e-3, 1e2, 3 if quick else 11)
    errors = [[linear_error(_scene(v, g))["velocity"] for v in strikes] for g in gravity]
    numbers = np.geomspace(1e-3, 1e3, 4 if quick else 25)
    scenes = [column(v, TAU, GRAINS) for v in numbers]
    norms = [linear_error(scene) for scene in scenes]
    engine = Chebyshev()
    return {
        "v0": strikes.tolist(),
        "gravity": gravity.tolist(),
        "error": errors,
        "strike number": numbers.tolist(),
        "norms": {norm: [error.get(norm, np.nan) for error in norms] for norm in LINEAR},
        "estimate": {
            "most": [expected_error(scene) for scene in scenes],
            "look": [engine.look(scene).at_most for scene in scenes],
            "after": [theory(scene, "chebyshev").error_estimate.model for scene in scenes],
        },
    }


def _scene(v0: float, gravity: float) -> Scene:
    chain = Chain(grains=GRAINS, diameter=BEAD, gravity=gravity)
    return Scene(chain=chain, excitation=Impulse(velocity=v0), duration=DURATION, samples=501)


def strike_unit(gravity: np.ndarray | float) -> np.ndarray | float:
    """Return v0 / v0* of glass beads, m/s, for Hertz: sqrt(delta g) (g / gamma)^(1/3).

    It grows as the 5/6 power of gravity.
    """
    chain = Chain(grains=2, diameter=BEAD, gravity=EARTH)
    return chain.length_scale / chain.time_scale * (gravity / EARTH) ** (5 / 6)


def draw(data: dict[str, Any]) -> Figure:
    """Draw the map and, at g, the norms and the package's estimates."""
    picture, plane, norms, own = one_above_two()
    gravity = data["gravity"]
    error = np.array(data["error"]).T
    shades = plane.pcolormesh(
        gravity, data["v0"], error, norm=LogNorm(1e-4, 1), cmap="cividis", shading="gouraud"
    )
    picture.colorbar(shades, ax=plane, label="error of the velocities at 100 µs", extend="both")
    plane.contour(
        gravity,
        data["v0"],
        np.log10(error),
        levels=[-2, -1],
        colors="white",
        linestyles="solid",
        linewidths=2.5,
    ).set_path_effects(DARK_OUTLINE)
    draw_boundaries(plane, gravity[0], gravity[-1])
    plane.set(ylim=(data["v0"][0], data["v0"][-1]))
    plane.text(300, 3e-8, "linear", color="white", ha="center")
    plane.text(3e-2, 5e-2, "as in the sonic vacuum")
    plane.set_title("Linear theory: measured (solid), law (dashed)")
    _draw_norms(norms, data)
    _draw_own(own, data)
    for axes, left in ((norms, -0.3), (own, 0.0)):
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="strike number v0*",
            ylabel="relative error",
            ylim=(1e-5, 3),
        )
        axes.legend(loc="upper left", bbox_to_anchor=(left, -0.24))
    return picture


def draw_boundaries(plane: Axes, least: float, most: float, background: str = "white") -> None:
    """Draw the boundary of linear theory against strike, between two values of gravity."""
    gravity = np.array([least, most])
    for name, number, style in (
        ("1 %", strike_number_at(0.01, "velocity"), "--"),
        ("10 %", strike_number_at(0.1, "velocity"), "--"),
        ("contact 1 opens", OPENS, ":"),
    ):
        line = number * strike_unit(gravity)
        plane.loglog(gravity, line, color="black", ls=style, lw=1.4)
        label = f"{name}: v0* = {number:.2g}"
        colour = background if number < 1 else "black"
        start = 1.3 * least, 1.7 * line[0]
        plane.text(
            *start, label, rotation=14, rotation_mode="anchor", color=colour, fontsize="small"
        )
    plane.set(xlim=(least, most), xlabel="gravity (m/s²)", ylabel="velocity of the strike (m/s)")


def _draw_norms(axes: Axes, data: dict[str, Any]) -> None:
    fine = np.geomspace(data["strike number"][0], data["strike number"][-1], 200)
    for (norm, error), colour in zip(data["norms"].items(), COLOURS.values(), strict=False):
        law = np.array([linear_law(v, norm, grain=19) for v in fine])
        axes.plot(fine, law, color=colour, lw=1.3)
        one = strike_number_at(0.01, norm, grain=19)
        label = f"{NAMES[norm]}: law 1 % at v0* = {one:.2g}"
        axes.plot(data["strike number"], error, "o", ms=4.5, mfc="none", color=colour, label=label)
    for level in (0.01, 0.1):
        axes.axhline(level, color="0.7", lw=0.8, zorder=0)
    axes.set_title("At g, four norms")


def _draw_own(axes: Axes, data: dict[str, Any]) -> None:
    numbers = data["strike number"]
    own = data["estimate"]
    axes.plot(numbers, own["most"], color="0.7", label="expected from the strike alone")
    axes.plot(
        numbers,
        own["look"],
        "--",
        color=COLOURS["vermilion"],
        label="bound from the linear solution",
    )
    axes.plot(numbers, own["after"], color=COLOURS["blue"], label="estimate after the run")
    axes.plot(
        numbers, data["norms"]["package"], "o", ms=4.5, mfc="none", color="black", label="measured"
    )
    axes.set_title("At g, the estimates")
