"""Longest stable step of every integrator against the strength of the strike."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

import lmpchain
from lmpchain import engines
from lmpchain.engines import class_of
from lmpchain.integrators.methods import METHODS, Method
from lmpchain.stability.step_limit import blow_up, limit
from lmpchain.util.plotting import figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PERIODS = 100  # Duration in periods of the band edge, or of two struck grains in the vacuum.
LOADED = {"grains": 12, "diameter": 1e-3, "gravity": 0.0, "top_load": 1e-3}
STEEP = 1.05  # Growth factor per step at which every run breaks down.
LINE = {"color": "0.2", "lw": 1.5}
BEYOND = "predicted, if oscillators grow by 5 % a step"


def struck(number: float) -> lmpchain.Scene:
    """Return a loaded chain struck at the top with this strike number."""
    chain = lmpchain.Chain(**LOADED)
    impulse = lmpchain.Impulse(velocity=number * chain.length_scale / chain.time_scale)
    duration = PERIODS * 2 * np.pi / chain.band_edge
    return lmpchain.Scene(chain=chain, excitation=impulse, duration=duration)


def vacuum(velocity: float) -> lmpchain.Scene:
    """Return the chain without its load, struck with this velocity, m/s."""
    chain = lmpchain.Chain(**LOADED | {"top_load": 0.0})
    impulse = lmpchain.Impulse(velocity=velocity)
    frequency = lmpchain.Scene(chain=chain, excitation=impulse, duration=1.0).highest_frequency
    return lmpchain.Scene(chain=chain, excitation=impulse, duration=PERIODS * 2 * np.pi / frequency)


def steep(method: Method) -> float:
    """Return the omega h at which an oscillator grows by 5 % per step."""
    return float(next(y for y in np.arange(0.01, 20, 0.01) if method.growth(y) > STEEP))


def measure(quick: bool) -> dict[str, Any]:
    """Return steps in s: predicted, and found by bisection."""
    numbers = np.logspace(-2, 4, 13)[: 1 if quick else None]
    speeds = np.logspace(-4, -1, 1 if quick else 4)
    few = numbers[-1:] if quick else numbers[::6]
    smooth = np.logspace(-2.3, 4.3, 7 if quick else 67)
    return {
        "band_edge": struck(1.0).chain.band_edge,
        "numbers": numbers.tolist(),
        "few": few.tolist(),
        "smooth": smooth.tolist(),
        "speeds": speeds.tolist(),
        "predicted": {name: [limit(struck(s), name) for s in smooth] for name in METHODS},
        "steep": {name: steep(method) for name, method in METHODS.items()},
        "native": {name: [blow_up(struck(s), name) for s in numbers] for name in METHODS},
        "lammps": {
            name: [blow_up(struck(s), name, "lammps") for s in few]
            for name in engines.Lammps.integrators
            if not quick or name == "verlet"
        },
        "vacuum": {
            "predicted": {name: [limit(vacuum(v), name) for v in speeds] for name in METHODS},
            "native": {name: [blow_up(vacuum(v), name) for v in speeds] for name in METHODS},
            "lammps": {"verlet": [blow_up(vacuum(v), "verlet", "lammps") for v in speeds]},
        },
    }


def draw(data: dict[str, Any]) -> Figure:
    """Draw a panel for every integrator, and one for the sonic vacuum."""
    picture = figure(7.5, 9.5)
    panels = picture.subplots(4, 2).ravel()
    for place, (ax, name) in enumerate(zip(panels, METHODS, strict=False)):
        _panel(ax, data, name)
        ax.tick_params(labelleft=place % 2 == 0)
        if place % 2 == 0:
            ax.set_ylabel("longest step ×\nband edge at rest")
        if place > 4:
            ax.set_xlabel("strike number $v_0^*$")
    panels[0].annotate("predicted", (30, 1.5), color="0.2")
    panels[1].annotate("predicted", (2e-2, 2.1), color="0.2")
    panels[5].annotate("down to 0.7 of the prediction", (0.05, 0.06), xycoords="axes fraction")
    _vacuum(panels[7], data)
    panels[7].yaxis.tick_right()
    entries: dict[str, Any] = {}
    for ax in panels[:2]:
        entries |= {str(artist.get_label()): artist for artist in ax.get_legend_handles_labels()[0]}
    picture.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=2)
    return picture


def _panel(ax: Any, data: dict[str, Any], name: str) -> None:
    edge = data["band_edge"]
    limit = METHODS[name].stability_limit
    expected = np.array(data["predicted"][name]) * edge
    ax.axhspan(limit, 20, color="0.92", label="refused: unstable at rest")
    ax.loglog(data["smooth"], expected, **LINE, label="predicted, from the energy of the strike")
    if data["steep"][name] > 1.05 * limit:
        ax.loglog(
            data["smooth"],
            expected * data["steep"][name] / limit,
            **LINE | {"ls": "--"},
            label=BEYOND,
        )
    for engine, key, size in (("lammps", "few", 9), ("native", "numbers", 5)):
        if name in data[engine]:
            ax.loglog(data[key], np.array(data[engine][name]) * edge, **style(engine, size))
    ax.set(ylim=(0.12, 20), xlim=(6e-3, 1.7e4), yticks=(0.2, 0.5, 1, 2, 5, 10))
    ax.set_title(f"{name}: refused above {limit:.3g}")
    ax.yaxis.set_major_formatter("{x:g}")


def _vacuum(ax: Any, data: dict[str, Any]) -> None:
    """Draw steps in s against velocities in m/s, for two well separated methods."""
    speeds = data["speeds"]
    steps = data["vacuum"]
    for name, beyond in (("verlet", False), ("rkn6", True)):
        factor = data["steep"][name] / METHODS[name].stability_limit if beyond else 1.0
        expected = np.array(steps["predicted"][name]) * factor
        ax.loglog(speeds, expected, **LINE | {"ls": "--" if beyond else "-"})
        ax.loglog(speeds, steps["native"][name], **style("native", 5))
        ax.annotate(name, (speeds[0], expected[0]), (6, 4), textcoords="offset points")
    ax.loglog(speeds, steps["lammps"]["verlet"], **style("lammps", 9))
    ax.set(xlabel="strike velocity (m/s)", ylim=(1e-6, 1e-4))
    ax.set_title("Sonic vacuum: longest step (s)")


def style(engine: str, size: float) -> dict[str, Any]:
    """Return the plot style of an engine."""
    label = "measured, LAMMPS" if engine == "lammps" else f"measured, {engine}"
    drawn = {
        "color": class_of(engine).style[0],
        "marker": class_of(engine).style[1],
        "ms": size,
        "mfc": "none",
        "mew": 1.4,
    }
    return drawn | {"ls": "none", "label": label}
