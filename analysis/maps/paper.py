"""Where the paper's own figures lie on the maps: Figs. 1 and 5 linearised, Fig. 2 homogeneous, Figs. 8 and 9 continuous."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lmpchain.plotting import COLOURS, figure
from lmpchain.scene import Scene
from lmpchain.stability.theories import harmonic_law
from lmpchain.stability.theory_errors import harmonic_error, linear_error, uniform_error

from . import homogeneous, linearisation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SCENES = {"Fig. 1": "fig1", "Fig. 5, 10 g": "fig5_10g", "Fig. 5, g": "fig5_1g", "Fig. 5, g / 10": "fig5_0.1g"}
MOVED, TIMES = 50, (1, 5, 10, 12)  # Fig. 2
LAMBDA = 0.5  # Fig. 8
POINT = {"marker": "o", "ls": "none", "color": COLOURS["lammps"], "ms": 6}


def measure(quick: bool) -> dict[str, Any]:
    """Return what the paper's scenes are like, and how far off the theory is that it uses for them."""
    scenes = {
        name: Scene.from_toml(Path(__file__).parents[1] / "scenes" / f"{file}.toml") for name, file in SCENES.items()
    }
    h, error = harmonic_error(LAMBDA, 80.0 if quick else 250.0)
    return {
        "strikes": {
            name: {
                "v0": scene.excitation.velocity,
                "gravity": scene.chain.gravity,
                "strike number": scene.strike_number,
                **linear_error(scene),
            }
            for name, scene in scenes.items()
        },
        "Fig. 2": [[tau, tau * MOVED ** (1 / 6), uniform_error(MOVED, tau * MOVED ** (1 / 6))] for tau in TIMES],
        "Fig. 8": [h.tolist(), error.tolist()],
    }


def draw(data: dict[str, Any]) -> Figure:
    """Draw the figures as points on the maps."""
    picture = figure(15, 5.2)
    linear, uniform, continuous = picture.subplots(1, 3)
    linearisation.draw_boundaries(linear, 0.3, 300, background="black")
    for name, found in data["strikes"].items():
        label = f"{name}: {100 * found['velocity']:.0f} % off"
        _point(linear, found["gravity"], found["v0"], label, -1 if "10 g" in name else 1)
    linear.set(ylim=(1e-7, 0.1))
    linear.set_title("Linear theory: velocities at 100 µs", loc="left", fontsize="medium")
    homogeneous.draw_boundaries(uniform, 10, 1000, background="black")
    for tau, travelled, error in data["Fig. 2"]:
        _point(uniform, MOVED, travelled, f"Fig. 2, τ = {tau}: {100 * error:.2g} % off", 1)
    uniform.set_title("Eq. (6), one κ for all grains", loc="left", fontsize="medium")
    _draw_continuum(continuous, *(np.array(x) for x in data["Fig. 8"]))
    return picture


def _point(axes: Axes, x: float, y: float, label: str, side: int) -> None:
    axes.plot(x, y, **POINT)
    align = "left" if side > 0 else "right"
    axes.annotate(label, (x, y), xytext=(8 * side, 0), textcoords="offset points", ha=align, va="center")


def _draw_continuum(axes: Axes, h: np.ndarray, error: np.ndarray) -> None:
    depth, frequency = np.geomspace(1, 1000, 60), np.geomspace(0.1, 3, 60)
    law = np.log10(harmonic_law(frequency[:, None], depth))
    axes.contour(depth, frequency, law, levels=[-2, -1], colors="black", linestyles="--", linewidths=1.4)
    axes.loglog(depth, 2 * depth ** (1 / 6), color="black", ls=":")
    axes.text(300, 2.2 * 300 ** (1 / 6) * 0.75, "no waves above", ha="center", fontsize="small")
    axes.loglog(depth, 4 ** (1 / 3) * depth ** (-1 / 6), color=COLOURS["native"])
    axes.text(1.3, 1.75, "Fig. 9: front of a strike", color=COLOURS["native"])
    axes.loglog([1, h[-1]], [LAMBDA, LAMBDA], color=COLOURS["lammps"])
    for row in np.unique([0, int(np.abs(error - 0.1).argmin()), h.size - 1]):
        label = f"{100 * error[row]:.0f} %"
        axes.plot(h[row], LAMBDA, **POINT)
        axes.annotate(label, (h[row], LAMBDA), xytext=(0, 8), textcoords="offset points", ha="center")
    axes.text(1.3, 0.53, "Fig. 8: driven top", color=COLOURS["lammps"])
    for level in (0.01, 0.1):
        axes.text(1.3, 0.93 * (12 * level / 1.3**0.5) ** (1 / 3), f"{100 * level:.0f} %", va="top", fontsize="small")
    axes.set(xlim=(1, 1000), ylim=(0.1, 4), xlabel="depth h (grains)", ylabel="frequency ω of τ")
    axes.set_title("Continuum, Eq. (27): phase ω³√h / 12", loc="left", fontsize="medium")
