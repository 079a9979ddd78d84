"""Predictability of a struck column: growth of a change in the last digits, and its limit.

Columns of glass beads of 1 mm under g. Reflections through contacts that open and close amplify any
change of the start until two runs are uncorrelated; the predictability time of a tolerance is when
rounding has grown to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from figures import OUTLINE

from lmpchain import Chain, Impulse, Scene
from lmpchain.stability.predictability import SEED, growth, predicted_time
from lmpchain.util.plotting import figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LENGTHS = (10, 20, 40)
TOLERANCES = (1e-9, 1e-6, 1e-3)
NAMES = ("$10^{-9}$", "$10^{-6}$", "$10^{-3}$")
CHANGE = 1e-13
SHOWN = 16  # Number of decades that double precision resolves.
MOST = 12  # Decades of growth after which two runs are uncorrelated.
HOLDS = 30.0, 50.0  # Strike numbers between which the law is valid; the second one is per grain.


def scene(grains: int, velocity: float, duration: float = 5e-3, samples: int = 126) -> Scene:
    """Return a column with a strike on top, m/s, for a duration, s."""
    chain = Chain(grains=grains, material="glass", diameter=1e-3)
    return Scene(
        chain=chain, excitation=Impulse(velocity=velocity), duration=duration, samples=samples
    )


def measure(quick: bool) -> dict:
    """Return the decades of growth for each strike, time and length, and predicted horizons."""
    velocities = np.logspace(-3.5, -0.5, 3 if quick else 10)
    panels = []
    for grains in LENGTHS[:1] if quick else LENGTHS:
        scenes = [scene(grains, v, 1e-3 if quick else 5e-3) for v in velocities]
        grown = [
            np.maximum.accumulate(growth(s, CHANGE, accuracy=1e-9)[1]) / CHANGE for s in scenes
        ]
        unit = scenes[0].chain.length_scale / scenes[0].chain.time_scale
        valid = np.logspace(np.log10(HOLDS[0] * unit), np.log10(HOLDS[1] * grains * unit), 9)
        law = {
            f"{tol:g}": [predicted_time(scene(grains, v), tol) for v in valid] for tol in TOLERANCES
        }
        decades = np.log10(np.maximum(grown, 1.0)).round(2)
        panels.append(
            {"grains": grains, "decades": decades.tolist(), "valid": valid.tolist(), "law": law}
        )
    return {"velocities": velocities.tolist(), "times": scenes[0].time.tolist(), "panels": panels}


def draw(data: dict) -> Figure:
    """Draw growth as colours over strike and time, with measured and predicted horizons."""
    panels = data["panels"]
    velocities = np.array(data["velocities"])
    times = 1e3 * np.array(data["times"])
    picture = figure(7.5, 4.6)
    axes = picture.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for ax, panel in zip(axes, panels, strict=True):
        decades = np.array(panel["decades"]).T
        mesh = ax.pcolormesh(
            velocities, times, decades, vmin=0, vmax=SHOWN, cmap="cividis", shading="gouraud"
        )
        levels = [np.log10(tol / SEED) for tol in TOLERANCES]
        lines = ax.contour(velocities, times, decades, levels=levels, colors="black")
        names = dict(zip(levels, NAMES, strict=True))
        for text in ax.clabel(lines, fmt=names):
            text.set_path_effects(OUTLINE)
        for predicted in panel["law"].values():
            law = 1e3 * np.array(predicted)
            ax.plot(panel["valid"], law, color="white", lw=3.5)
            ax.plot(panel["valid"], law, color="#D55E00", lw=1.8, ls="--")
        ax.set(xscale="log", xlim=velocities[[0, -1]], ylim=times[[0, -1]], xlabel="strike (m/s)")
        ax.set_title(f"{panel['grains']} grains")
    axes[0].set_ylabel("time after the strike (ms)")
    axes[0].plot(
        [],
        [],
        color="black",
        label="measured: time at which a change in the last digit has grown to the number",
    )
    axes[0].plot(
        [],
        [],
        color="#D55E00",
        lw=1.8,
        ls="--",
        label="predicted: 0.9 (1 - exp(-N/20)) decades per reflection",
    )
    picture.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=1)
    picture.colorbar(mesh, ax=axes, label="growth of a small change (decades)", pad=0.01)
    return picture
