"""Errors of the homogeneous chain: Eq. (6), the engine "bessel", and Eqs. (7), (8)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from figures import DARK_OUTLINE
from laws.theories import bessel_law, far_field_law, uniform_law, uniform_reach
from laws.theory_errors import bessel_error, far_field_error, local_error, uniform_error
from matplotlib.colors import LogNorm

from lmpchain.util.plotting import COLOURS, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHADES = tuple(COLOURS.values())
DEEP = 1000  # Grain at the centre of wide initial disturbances.
LABELLED = 80  # Grain at which the labels of the boundaries begin.
LEVELS = (0.01, 0.1)
XI = 1 / 3


def measure(quick: bool) -> dict[str, Any]:
    """Return errors for depth and distance, width and distance, time and load, and time."""
    grains = np.unique(np.geomspace(5, 2000, 3 if quick else 14).astype(int))
    travelled = np.geomspace(1, 100, 4 if quick else 25)
    widths = [0.0, *np.geomspace(1, 30, 2 if quick else 7)]
    far = np.geomspace(2, 400, 4 if quick else 24)
    loads = (0, 10, 100, 1000)
    tau = np.geomspace(0.5, 10 if quick else 30, 4 if quick else 20)
    beads = (1, 3, 10)
    late = np.geomspace(10, 1e5, 5 if quick else 17)
    local = np.geomspace(1, 60, 4 if quick else 20)
    return {
        "grain": grains.tolist(),
        "travelled": travelled.tolist(),
        "error": [[uniform_error(int(n), T) for n in grains] for T in travelled],
        "width": [float(s) for s in widths],
        "far": far.tolist(),
        "reach": {str(level): [_reach(s, far, level) for s in widths] for level in LEVELS},
        "tau": tau.tolist(),
        "bessel": {str(load): [bessel_error(load, t) for t in tau] for load in loads},
        "local": [local.tolist(), [local_error(t) for t in local]],
        "late": late.tolist(),
        "far field": {str(n): [far_field_error(n, t) for t in late] for n in beads},
    }


def _reach(width: float, travelled: np.ndarray, level: float) -> float:
    """Return the distance at which the error of Eq. (6) reaches this value, by interpolation."""
    errors = np.maximum.accumulate([uniform_error(DEEP, T, width) for T in travelled])
    return float(np.exp(np.interp(np.log(level), np.log(errors), np.log(travelled))))


def draw(data: dict[str, Any]) -> Figure:
    """Draw the map and three cuts."""
    picture = figure(7.5, 7.5)
    (plane, width), (strike, eight) = picture.subplots(2, 2)
    grains = data["grain"]
    travelled = data["travelled"]
    error = np.array(data["error"])
    shades = plane.pcolormesh(
        grains, travelled, error, norm=LogNorm(1e-3, 1), cmap="cividis", shading="gouraud"
    )
    picture.colorbar(shades, ax=plane, label="error of the displacements", extend="both")
    plane.contour(
        grains,
        travelled,
        np.log10(error),
        levels=[-2, -1],
        colors="white",
        linestyles="solid",
        linewidths=2.5,
    ).set_path_effects(DARK_OUTLINE)
    draw_boundaries(plane, grains[0], grains[-1])
    plane.set_title("Eq. (6), one κ for all grains")
    _draw_width(width, data)
    _draw_strike(strike, data)
    _draw_seven_and_eight(eight, data)
    width.legend()
    for axes in (strike, eight):
        axes.legend(loc="upper center", bbox_to_anchor=(0.45, -0.2))
    return picture


def draw_boundaries(plane: Axes, first: float, last: float, background: str = "white") -> None:
    """Draw the distance from a grain at which Eq. (6) fails, between two grains."""
    grains = np.geomspace(first, last, 60)
    travelled = np.geomspace(1, 100, 150)
    law = np.log10([[uniform_law(XI / n, T) for n in grains] for T in travelled])
    plane.contour(
        grains, travelled, law, levels=[-2, -1], colors="black", linestyles="--", linewidths=1.4
    )
    for level in LEVELS:
        label = f"{100 * level:.0f} %: T = √(12√2 · {level:g} n)"
        below = 0.6 * uniform_reach(level, XI / LABELLED)
        plane.text(
            LABELLED,
            below,
            label,
            rotation=29,
            rotation_mode="anchor",
            color=background,
            fontsize="small",
        )
    plane.set(xscale="log", yscale="log", xlim=(first, last), ylim=(1, 100))
    plane.set(xlabel="grain that is moved, n", ylabel="grains that the wave has gone, T = τ√κ")


def _draw_width(axes: Axes, data: dict[str, Any]) -> None:
    widths = np.array(data["width"])
    shown = np.where(widths > 0, widths, 0.5)  # One grain.
    fine = np.geomspace(1, data["far"][-1], 200)
    for level, colour in zip(LEVELS, SHADES, strict=False):
        laws = np.array([[uniform_law(XI / DEEP, T, s) for T in fine] for s in widths])
        law = [
            np.exp(np.interp(np.log(level), np.log(np.maximum.accumulate(e)), np.log(fine)))
            for e in laws
        ]
        axes.loglog(shown, law, color=colour, label=f"{100 * level:.0f} %, law")
        values = data["reach"][str(level)]
        axes.loglog(
            shown, values, "o", mfc="none", color=colour, label=f"{100 * level:.0f} %, measured"
        )
    axes.set_xticks([0.5, 1, 3, 10, 30], labels=["one grain", "1", "3", "10", "30"])
    axes.set_yticks([10, 20, 50, 100, 200], labels=["10", "20", "50", "100", "200"])
    axes.minorticks_off()
    axes.set(
        xlabel="width of the displacement (grains)",
        ylabel="grains that the wave may go",
    )
    axes.set_title(f"Eq. (6) around grain {DEEP}")


def _draw_strike(axes: Axes, data: dict[str, Any]) -> None:
    fine = np.geomspace(data["tau"][0], data["tau"][-1], 200)
    for (load, values), colour in zip(data["bessel"].items(), SHADES, strict=False):
        contrast = values[0][0]
        axes.loglog(fine, [bessel_law(contrast, t) for t in fine], color=colour, lw=1.3)
        label = f"load of {load} grains, κ₂/κ₁ − 1 = {contrast:.2g}"
        axes.loglog(
            data["tau"],
            [error for _, error in values],
            "o",
            ms=4.5,
            mfc="none",
            color=colour,
            label=label,
        )
    for level in LEVELS:
        axes.axhline(level, color="0.7", lw=0.8, zorder=0)
    axes.set(xlabel="time τ", ylabel="error (package's norm)", ylim=(1e-6, 30))
    axes.set_title('Engine "bessel", strike on top')


def _draw_seven_and_eight(axes: Axes, data: dict[str, Any]) -> None:
    tau, errors = data["local"]
    axes.loglog(
        tau,
        errors,
        "s",
        ms=4.5,
        mfc="none",
        color="black",
        label="Eq. (7) against Eq. (3), top grain moved",
    )
    for (grain, off), colour in zip(data["far field"].items(), SHADES, strict=False):
        late = np.array(data["late"])
        axes.loglog(late, far_field_law(int(grain), late), color=colour, lw=1.3)
        axes.loglog(
            late,
            off,
            "o",
            ms=4.5,
            mfc="none",
            color=colour,
            label=f"Eq. (8) against Eq. (7), grain {grain}",
        )
    for level in LEVELS:
        axes.axhline(level, color="0.7", lw=0.8, zorder=0)
    axes.set(xlabel="time τ", ylabel="relative error", ylim=(1e-5, 30))
    axes.set_title("Eqs. (7) and (8)")
