"""Errors of the continuum, Eqs. (35) and (27), against depth, time and width."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from figures import DARK_OUTLINE, OUTLINE, no_answer
from laws.theories import behind_front, continuum_width, phase_velocity
from laws.theory_errors import continuum_error, fronts, impulse_error, phase_velocities
from matplotlib.colors import LogNorm

from lmpchain.theory import front
from lmpchain.theory.continuum import chi, depth
from lmpchain.util.plotting import COLOURS, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHADES = tuple(COLOURS.values())
FREQUENCIES = (0.5, 1.0, 1.5, 2.0, 2.4, 2.8)
# Width of the front over h^(1/6): full width at half of the largest velocity (`theory.front`).
WIDTH = 2.2346 / 4 ** (1 / 3)


def measure(quick: bool) -> dict[str, Any]:
    """Return errors for each depth, time and width, phase velocities, and the front by depth."""
    far = 40.0 if quick else 150.0
    times, h, impulse = impulse_error(far, 41 if quick else 76)
    h = h[::2]
    impulse = impulse[:, ::2]
    widths = np.geomspace(0.8, 12, 5 if quick else 14)
    tau = np.geomspace(4, 40 if quick else 150, 4 if quick else 9)
    waves = {str(f): phase_velocities(f, 80.0 if quick else 150.0) for f in FREQUENCIES}
    return {
        "time": times.tolist(),
        "h": h.tolist(),
        "impulse": [[None if np.isnan(x) else float(f"{x:.3g}") for x in row] for row in impulse],
        "width": depth(widths).tolist(),
        "tau": tau.tolist(),
        "spread": [continuum_error(s, tau).tolist() for s in widths],
        "waves": {f: [x.tolist() for x in pair] for f, pair in waves.items()},
        "front": [x.tolist() for x in fronts(60.0 if quick else 300.0)],
    }


def draw(data: dict[str, Any]) -> Figure:
    """Draw the two maps and two cuts."""
    picture = figure(7.5, 8.5)
    (plane, spread), (waves, edge) = picture.subplots(2, 2)
    draw_strike(plane, data, picture)
    _draw_spread(spread, data, picture)
    _draw_waves(waves, data)
    _draw_front(edge, data)
    return picture


def draw_strike(plane: Axes, data: dict[str, Any], picture: Figure) -> None:
    """Draw where Eq. (35) is accurate after a strike on grain 1."""
    grain = np.array(data["h"]) + 0.5
    times = np.array(data["time"])
    error = np.array([[np.nan if x is None else x for x in row] for row in data["impulse"]])
    shades = plane.pcolormesh(
        grain, times, error, norm=LogNorm(1e-4, 1), cmap="cividis", shading="nearest"
    )
    picture.colorbar(shades, ax=plane, label="error of Eq. (35) at a grain", extend="both")
    fine = np.linspace(0.5, depth(times[-1]) * 1.25, 300)
    plane.plot(fine, chi(fine), color="black", lw=1.6, label="light cone, τ = (6/5) h$^{5/6}$")
    plane.plot(
        fine,
        fine ** (5 / 6),
        color=SHADES[1],
        ls=":",
        lw=1.8,
        label="front of Eq. (7), τ = n$^{5/6}$",
    )
    law = "1 %, law: τ = χ + √h + 3.3 h$^{1/4}$"
    plane.plot(fine, behind_front(fine), color=SHADES[3], ls="--", lw=1.8, label=law)
    plane.set(
        xlim=(1, fine[-1]),
        ylim=(0, times[-1]),
        xlabel="grain, from the top",
        ylabel="time τ after the strike",
    )
    plane.set_title("Eq. (35) after a strike on grain 1")
    no_answer(plane)
    plane.legend(loc="upper left", bbox_to_anchor=(0, -0.18))


def _draw_spread(plane: Axes, data: dict[str, Any], picture: Figure) -> None:
    width = data["width"]
    tau = np.array(data["tau"])
    error = np.array(data["spread"]).T
    shades = plane.pcolormesh(
        width, tau, error, norm=LogNorm(1e-4, 1), cmap="cividis", shading="gouraud"
    )
    picture.colorbar(shades, ax=plane, label="error of the velocities", extend="both")
    plane.contour(
        width,
        tau,
        np.log10(error),
        levels=[-2, -1],
        colors="white",
        linestyles="solid",
        linewidths=2.5,
    ).set_path_effects(DARK_OUTLINE)
    for level in (0.01, 0.1):
        plane.loglog([continuum_width(level, t) for t in tau], tau, color="black", ls="--", lw=1.4)
        right = 1.15 * continuum_width(level, tau[0])
        plane.text(right, 1.15 * tau[0], f"{100 * level:.0f} %", path_effects=OUTLINE)
    plane.set(xlim=(width[0], width[-1]), ylim=(tau[0], tau[-1]))
    plane.set(xlabel="width of a strike spread over the top (grains)", ylabel="time τ")
    plane.set_title("Eq. (27): measured (solid) and law (dashed)")


def _draw_waves(axes: Axes, data: dict[str, Any]) -> None:
    for (frequency, (length, ratio)), colour in zip(data["waves"].items(), SHADES, strict=True):
        lag = 1 - np.array(ratio)
        axes.loglog(
            length[::3],
            lag[::3],
            "o",
            ms=4.5,
            mfc="none",
            color=colour,
            label=f"driven at ω = {frequency}",
        )
    fine = np.geomspace(2, 40, 200)
    axes.loglog(
        fine,
        1 - phase_velocity(fine),
        color="black",
        lw=1.3,
        label="law: 1 − sin(x)/x, x = π/λ",
    )
    for level in (0.01, 0.1):
        axes.axhline(level, color="0.7", lw=0.8, zorder=0)
    axes.set(xlabel="wavelength λ (grains)", ylabel="1 − phase velocity / that of long waves")
    axes.set_xticks([2, 4, 8, 12.8, 20, 40], labels=["2", "4", "8", "12.8", "20", "40"])
    axes.minorticks_off()
    axes.set_title("Dispersion")
    axes.set_ylim(5e-4, 100)
    axes.legend(loc="upper right")


def _draw_front(axes: Axes, data: dict[str, Any]) -> None:
    grain, arrival, width = (np.array(x, dtype=float) for x in data["front"])
    h = grain - 0.5
    some = np.unique(np.geomspace(1, grain.size - 1, 25).astype(int))
    for values, law, name, colour in (
        (arrival, front.peak_time(grain), "arrival", SHADES[0]),
        (width, WIDTH * h ** (1 / 6), "width", SHADES[1]),
    ):
        axes.loglog(
            grain[some],
            values[some],
            "o",
            ms=4.5,
            mfc="none",
            color=colour,
            label=f"{name}, measured",
        )
        label = {
            "arrival": "law: (6/5) h$^{5/6}$ + 0.57 h$^{1/6}$",
            "width": "law: 1.41 h$^{1/6}$",
        }[name]
        axes.loglog(grain, law, color=colour, lw=1.3, label=label)
    axes.loglog(
        grain, grain ** (5 / 6), color="black", ls=":", lw=1.5, label="the paper's τ = n$^{5/6}$"
    )
    axes.set(xlabel="grain, from the top", ylabel="time τ", ylim=(0.8, 3 * arrival[-1]))
    axes.set_title("Arrival and width of the front")
    axes.legend(loc="upper left")
