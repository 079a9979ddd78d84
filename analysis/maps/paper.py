"""The paper's figures on the maps: Figs. 1 and 5 on linear theory, 2, 8 and 9 on the others."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from figures import one_above_two
from laws.theories import harmonic_law
from laws.theory_errors import harmonic_error, linear_error, uniform_error

from lmpchain.scene.scene import Scene
from lmpchain.util.plotting import COLOURS

from . import homogeneous, linearisation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SCENES = {
    "Fig. 1": "fig1",
    "Fig. 5, 10 g": "fig5_10g",
    "Fig. 5, g": "fig5_1g",
    "Fig. 5, g / 10": "fig5_0.1g",
}
MOVED, TIMES = 50, (1, 5, 10, 12)  # Fig. 2.
LAMBDA = 0.5  # Fig. 8.
BOX = {"facecolor": "w", "lw": 0, "pad": 0.6}  # Background of labels that lines pass.
POINT = {"marker": "o", "ls": "none", "color": COLOURS["vermilion"], "ms": 6}


def measure(quick: bool) -> dict[str, Any]:
    """Return the parameters of the paper's scenes and the errors of the theory used for them."""
    scenes = {
        name: Scene.from_toml(Path(__file__).parents[1] / "scenes" / f"{file}.toml")
        for name, file in SCENES.items()
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
        "Fig. 2": [
            [tau, tau * MOVED ** (1 / 6), uniform_error(MOVED, tau * MOVED ** (1 / 6))]
            for tau in TIMES
        ],
        "Fig. 8": [h.tolist(), error.tolist()],
    }


def draw(data: dict[str, Any]) -> Figure:
    """Draw the figures as points on the maps."""
    picture, linear, uniform, continuous = one_above_two()
    linearisation.draw_boundaries(linear, 0.1, 1000, background="black")
    for name, strike in data["strikes"].items():
        label = f"{name}\n{100 * strike['velocity']:.0f} % off"
        _point(
            linear,
            strike["gravity"],
            strike["v0"],
            label,
            (8, -10),
            "left",
        )
    linear.set(ylim=(3e-8, 0.1))
    linear.set_title("Linear theory: velocities at 100 µs")
    homogeneous.draw_boundaries(uniform, 10, 1000, background="black")
    for tau, travelled, error in data["Fig. 2"]:
        label = f"τ = {tau}: {100 * error:.2g} %"
        _point(
            uniform,
            MOVED,
            travelled,
            label,
            (-8, 2 if tau > 10 else -8),
            "right",
        )
    uniform.set_title("Fig. 2 and Eq. (6), one κ")
    _draw_continuum(continuous, *(np.array(x) for x in data["Fig. 8"]))
    return picture


def _point(
    axes: Axes, x: float, y: float, label: str, away: tuple[float, float], side: str
) -> None:
    axes.plot(x, y, **POINT)
    axes.annotate(
        label,
        (x, y),
        xytext=away,
        textcoords="offset points",
        ha=side,
        fontsize="small",
        bbox=BOX,
        zorder=2.5,
    )


def _draw_continuum(axes: Axes, h: np.ndarray, error: np.ndarray) -> None:
    depth = np.geomspace(1, 1000, 60)
    frequency = np.geomspace(0.1, 3, 60)
    law = np.log10(harmonic_law(frequency[:, None], depth))
    axes.contour(
        depth, frequency, law, levels=[-2, -1], colors="black", linestyles="--", linewidths=1.4
    )
    axes.loglog(depth, 2 * depth ** (1 / 6), color="black", ls=":")
    axes.text(15, 2.6, "band edge of the chain", fontsize="small")
    axes.loglog(depth, 4 ** (1 / 3) * depth ** (-1 / 6), color=COLOURS["blue"])
    axes.text(5, 1.35, "Fig. 9: front of a strike", color=COLOURS["blue"])
    axes.loglog([1, h[-1]], [LAMBDA, LAMBDA], color=COLOURS["vermilion"])
    for row, below in ((0, 8), (-1, 8)):
        _point(axes, h[row], LAMBDA, f"{100 * error[row]:.0f} %", (0, below), "center")
    axes.text(1.3, 0.53, "Fig. 8: driven top", color=COLOURS["vermilion"], bbox=BOX)
    tenth = float(np.interp(0.1, error, h))
    _point(axes, tenth, LAMBDA, f"measured: 10 %\nat h = {tenth:.0f}", (0, -28), "center")
    for level in (0.01, 0.1):
        place = 5.0, (12 * level / 5.0**0.5) ** (1 / 3)
        axes.text(*place, f"law: {100 * level:.0f} %", ha="center", va="center", bbox=BOX)
    axes.set_yticks([0.1, 0.2, 0.5, 1, 2, 4], labels=["0.1", "0.2", "0.5", "1", "2", "4"])
    axes.minorticks_off()
    axes.set(xlim=(1, 1000), ylim=(0.1, 4), xlabel="depth h (grains)", ylabel="frequency ω of τ")
    axes.set_title("Continuum, Eq. (27): phase ω³√h / 12")
