"""Effect of neglecting damping against strike and A omega, after 20, 100 and 500 grains."""

from __future__ import annotations

from typing import Any

import numpy as np
from figures import DARK_OUTLINE, SHADES
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from lmpchain import Chain, Impulse, Scene, simulate
from lmpchain.benchmark.comparison import error
from lmpchain.benchmark.reference import Reference
from lmpchain.util.plotting import figure

PASSED = (20, 100, 500)  # Number of grains that the front has passed.
LOAD = 0.01  # Load, N, on glass beads of 1 mm.
LEVELS = {0.01: "white", 0.1: SHADES[5]}  # Errors of the contours and their colours.
STYLES = {"measured": "solid", "law": "dashed"}


def measure(quick: bool) -> dict[str, Any]:
    """Return errors of lossless chains, and the laws, for each distance."""
    strikes = np.geomspace(1e-2, 1e2, 2 if quick else 9)
    viscosities = np.geomspace(1e-5, 1.0, 2 if quick else 11)
    passed = PASSED[:1] if quick else PASSED
    return {
        "strike number": strikes.tolist(),
        "A omega": viscosities.tolist(),
        "error": {
            grains: [_errors(grains, number, viscosities) for number in strikes]
            for grains in passed
        },
        "law": {
            grains: [
                [_scene(grains, number, x).damping_effect for x in viscosities]
                for number in strikes
            ]
            for grains in passed
        },
    }


def _scene(passed: int, number: float, viscosity: float) -> Scene:
    """Return a loaded chain with this A omega (at the band edge) whose front passes n grains."""
    chain = Chain(grains=int(1.5 * passed) + 20, diameter=1e-3, gravity=0.0, top_load=LOAD)
    damped = chain.replace(damping={"viscoelastic": viscosity / chain.band_edge})
    # The travel time of sound from grain to grain is 2 / omega.
    duration = 2 * passed / chain.band_edge
    strike = Impulse(velocity=1.0)
    unit = Scene(chain=chain, excitation=strike, duration=duration).strike_number
    return Scene(
        chain=damped,
        excitation=Impulse(velocity=number / unit),
        duration=duration,
        samples=5 * passed + 1,
    )


def _errors(passed: int, number: float, viscosities: np.ndarray) -> list[float]:
    scenes = [_scene(passed, number, x) for x in viscosities]
    free = scenes[0].replace(chain=scenes[0].chain.replace(damping=None))
    lossless = simulate(free, "native", 1e-6, on_miss="warn")
    errors = []
    for scene in scenes:
        true = simulate(scene, "native", 1e-6, on_miss="warn")
        truth = Reference(true.time, true.displacement, true.velocity, 1e-6, "native")
        errors.append(error(lossless, truth))
    return errors


def draw(data: dict[str, Any]) -> Figure:
    """Draw a map per distance, with contours of the measured error and of the law."""
    distances = list(data["error"])
    picture = figure(7.5, 4.0)
    panels = picture.subplots(1, len(distances), sharey=True, squeeze=False)[0]
    x = np.array(data["A omega"])
    for axes, grains in zip(panels, distances, strict=True):
        errors = np.array(data["error"][grains])
        axes.set(xscale="log", yscale="log", xlabel="A ω, of the band edge ω")
        shades = axes.pcolormesh(
            x, data["strike number"], errors, norm=LogNorm(1e-4, 1), cmap="cividis",
            shading="gouraud",
        )  # fmt: skip
        for values, style in zip((errors, data["law"][grains]), STYLES.values(), strict=True):
            for level, colour in LEVELS.items():
                axes.contour(
                    x, data["strike number"], np.log10(values), levels=[np.log10(level)],
                    colors=colour, linestyles=style, linewidths=2,
                ).set_path_effects(DARK_OUTLINE)  # fmt: skip
        axes.set_xlim(x[0], x[-1])
        axes.set_title(f"After {grains} grains")
    panels[0].set_ylabel("strike number v0*")
    label = "error of the lossless model"
    picture.colorbar(shades, ax=list(panels), label=label, extend="both")
    lines = [
        Line2D([], [], color=colour, ls=style, lw=2, path_effects=DARK_OUTLINE)
        for style in STYLES.values()
        for colour in LEVELS.values()
    ]
    names = [f"{100 * level:.0f} %, {kind}" for kind in STYLES for level in LEVELS]
    picture.legend(lines, names, loc="outside lower center", ncols=4)
    return picture
