"""Four limits of scenes and theories, each with its predicting law."""

from __future__ import annotations

from typing import Any

import numpy as np
from figures import SHADES
from laws import limits
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lmpchain import Scene
from lmpchain.stability.linear_theory import linear_law
from lmpchain.util.plotting import COLOURS, figure

BLUE, ORANGE, GREEN, PINK, SKY, RED = SHADES
POINT = {"ls": "none", "ms": 5, "mfc": "none"}


def measure(quick: bool) -> dict[str, Any]:
    """Return the numbers of all panels."""
    every = 3 if quick else 1
    gravity = np.logspace(-9, 1, 11)[::every]
    fields = np.logspace(-3, 3, 13)[::every]
    excess = np.logspace(-5, 0, 11)[::every]
    numbers = np.logspace(-2, 2, 13)[::every]
    weak = [limits.weak(1.5, float(g), 1e-5) for g in fields]
    near = [limits.weak(1 + float(x)) for x in excess]
    swings = {n: [limits.swinging(n, float(x)) for x in numbers] for n in (2, 3)}

    def law(scene: Scene) -> float:
        return linear_law(scene.strike_number, "package", scene.chain.exponent)

    return {
        "gravity": gravity.tolist(),
        "from_vacuum": {
            f"{exponent:g}, {load:g}": limits.from_vacuum(gravity, exponent, load).tolist()
            for exponent in (1.5, 2.0)
            for load in (0.0, 1e-3)
        },
        "fields": fields.tolist(),
        "strike_numbers": [scene.strike_number for scene in weak],
        "from_linear": [limits.from_linear(scene) for scene in weak],
        "linear_law": [law(scene) for scene in weak],
        "excess": excess.tolist(),
        "near_linear": [limits.from_linear(scene) for scene in near],
        "near_linear_law": [law(scene) for scene in near],
        "near_springs": [limits.from_springs(scene) for scene in near],
        "near_springs_law": limits.springs_error(30, excess).tolist(),
        "numbers": numbers.tolist(),
        "periods": {
            n: [s.duration * s.chain.band_edge / (2 * np.pi) for s in swung]
            for n, swung in swings.items()
        },
        "period_off": {
            n: max(abs(limits.measured_period(s) / s.duration - 1) for s in swung)
            for n, swung in swings.items()
        },
        "measured": {
            n: [limits.measured_period(s) * s.chain.band_edge / (2 * np.pi) for s in swung]
            for n, swung in swings.items()
        },
    }


def draw(data: dict[str, Any]) -> Figure:
    """Draw a panel per limit: laws are lines, measurements are points."""
    picture = figure(7.5, 7.5)
    panels = picture.subplots(2, 2).ravel()
    for axes, panel in zip(panels, (_vacuum, _fields, _springs, _periods), strict=True):
        axes.set(xscale="log", yscale="log")
        panel(axes, data)
        axes.title.set_fontsize("medium")
        axes.legend()
    return picture


def _vacuum(axes: Axes, data: dict[str, Any]) -> None:
    g = np.array(data["gravity"])
    for (key, values), colour in zip(
        data["from_vacuum"].items(), (BLUE, GREEN, ORANGE, RED), strict=True
    ):
        exponent, load = map(float, key.split(", "))
        power = limits.vacuum_power(exponent, load > 0)
        axes.plot(g, values[0] * (g / g[0]) ** power, color=colour, lw=1.2)
        name = f"δ = {exponent:g}, {'loaded' if load else 'no load'}: $g^{{{power:.2g}}}$"
        axes.plot(g, values, **POINT, marker="o", color=colour, label=name)
    axes.set(xlabel="gravity (m/s²)", ylabel="relative distance from g = 0", ylim=(None, 1e4))
    axes.set_title("Vanishing gravity")


def _fields(axes: Axes, data: dict[str, Any]) -> None:
    axes.plot(
        data["fields"],
        data["linear_law"],
        color=BLUE,
        lw=1.2,
        label="law of the weakly struck column",
    )
    axes.plot(
        data["fields"],
        data["from_linear"],
        **POINT,
        marker="^",
        color=COLOURS["green"],
        label="linear theory",
    )
    axes.set(xlabel="gravity (m/s²)", ylabel="relative error", ylim=(None, 30))
    axes.set_title("Linear theory, struck at 10 µm/s")


def _springs(axes: Axes, data: dict[str, Any]) -> None:
    for key, marker, colour, name in (
        ("near_springs", "o", BLUE, "from springs, δ = 1"),
        ("near_linear", "^", GREEN, "from linear theory at δ"),
    ):
        axes.plot(data["excess"], data[f"{key}_law"], color=colour, lw=1.2)
        axes.plot(data["excess"], data[key], **POINT, marker=marker, color=colour, label=name)
    axes.set(xlabel="δ - 1", ylabel="relative distance")
    axes.set_title("Towards springs, δ → 1")


def _periods(axes: Axes, data: dict[str, Any]) -> None:
    for (grains, law), marker, colour in zip(
        data["periods"].items(), "so", (BLUE, ORANGE), strict=True
    ):
        values = np.array(data["measured"][grains])
        name = "one bead on another" if int(grains) == 2 else "three between walls"
        axes.plot(data["numbers"], law, color=colour, lw=1.2)
        far = data["period_off"][grains]
        axes.plot(
            data["numbers"],
            values,
            **POINT,
            marker=marker,
            color=colour,
            label=f"{name}: {far:.0e} off",
        )
    axes.set(xlabel="strike number", ylabel="period / that of the top mode", ylim=(None, 300))
    axes.set_title("Period of two and three grains")
