"""Rounding error against the strike, for both engines and several lengths of column.

Every point is a run held against the same steps in extended precision; every line is the law.
Columns of glass beads of 1 mm under g, struck at the top, until the wave is at the floor.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lmpchain import Chain, Impulse, Scene
from lmpchain.stability.roundoff import floor, measured_floor
from lmpchain.util.plotting import COLOURS, figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LENGTHS = (10, 50, 250)
TOLERANCE = 1e-6
WAYS: dict[str, dict[str, str]] = {
    "LAMMPS, physical diameter": {"engine": "lammps", "diameter": "physical"},
    "LAMMPS, gauge diameter": {"engine": "lammps", "diameter": "gauge"},
    "native, plain force": {"engine": "native", "force": "plain"},
    "native, exact force": {"engine": "native", "force": "exact"},
}
STYLES = (
    (COLOURS["vermilion"], "o"),
    (COLOURS["orange"], "^"),
    (COLOURS["sky blue"], "v"),
    (COLOURS["blue"], "s"),
)


def scene(grains: int, strike: float) -> Scene:
    """Return a column with this strike number, until the wave reaches its bottom."""
    chain = Chain(grains=grains, material="glass", diameter=1e-3)
    speed = strike * chain.length_scale / chain.time_scale
    arrival = 1.2 * grains ** (5 / 6) * chain.time_scale
    return Scene(chain=chain, excitation=Impulse(velocity=speed), duration=arrival, samples=11)


def measure(quick: bool) -> dict:
    """Return rounding floors, measured at some strikes and predicted at many."""
    strikes = np.logspace(-5, 2, 3 if quick else 7)
    many = np.logspace(-5.5, 2.5, 33)
    panels = []
    for grains in LENGTHS[:1] if quick else LENGTHS:
        few = [scene(grains, strike) for strike in strikes]
        all_of_them = [scene(grains, strike) for strike in many]
        measured = {name: [measured_floor(s, **way) for s in few] for name, way in WAYS.items()}
        law = {name: [floor(s, **way) for s in all_of_them] for name, way in WAYS.items()}
        panels.append({"grains": grains, "measured": measured, "law": law})
    return {"strikes": strikes.tolist(), "many": many.tolist(), "panels": panels}


def draw(data: dict) -> Figure:
    """Draw a panel for each length of column."""
    panels = data["panels"]
    picture = figure(7.5, 4.4)
    axes = picture.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for ax, panel in zip(axes, panels, strict=True):
        for name, (colour, marker) in zip(WAYS, STYLES, strict=True):
            ax.loglog(data["many"], panel["law"][name], color=colour, lw=1.4, label=f"{name}: law")
            measured = panel["measured"][name]
            ax.loglog(
                data["strikes"],
                measured,
                color=colour,
                ls="none",
                marker=marker,
                ms=6,
                label="measured",
            )
        ax.axhline(TOLERANCE, color="0.5", lw=1, ls=":", zorder=0)
        ax.axvline(1, color="0.85", lw=0.8, zorder=0)
        ax.set_title(
            f"{panel['grains']} grains",
            fontsize="medium",
        )
        ax.set_xlabel("strike number $v_0^*$")
        ax.set_ylim(1e-15, 3)
    axes[0].set_ylabel("relative error from rounding alone")
    axes[0].text(
        data["many"][-1],
        TOLERANCE * 1.4,
        "default\ntolerance",
        color="0.4",
        fontsize="small",
        ha="right",
    )
    handles, labels = axes[0].get_legend_handles_labels()
    picture.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=2,
    )
    return picture
