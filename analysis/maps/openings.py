"""Order of every method through opening contacts with fixed and adaptive steps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from laws.openings import errors_through_openings, order_through_openings

import lmpchain
from lmpchain.benchmark.reference import reference
from lmpchain.integrators.methods import METHODS
from lmpchain.util.plotting import figure, look_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXPONENT = 1.5
ADAPTIVE = [name for name, method in METHODS.items() if method.adaptive]
# Largest product of step and frequency in the fit of the slope; no limit for other methods.
ASYMPTOTIC = {"gear4": 0.02}
RUNS = {"dop853": 120}  # Number of runs for an error; other methods have 40.
FLOOR = 3e-13  # Rounding contributes to errors below this one.


def measure(quick: bool) -> dict[str, Any]:
    """Return the errors of a strong strike on 30 beads, with three openings, against the step."""
    scene = lmpchain.Scene(
        chain=lmpchain.Chain(grains=30, diameter=1e-3, exponent=EXPONENT),
        excitation=lmpchain.Impulse(velocity=8.57e-3),
        duration=60e-6,
        samples=21,
    )
    solution = reference(scene)
    apart = lmpchain.simulate(scene, "native", 1e-9).displacement
    opened = (scene.chain.contacts.overlap + scene.chain.contacts.closer(apart))[:, 1:-1] < 0
    counts = np.geomspace(70, 6000 if quick else 20000, 6 if quick else 14).astype(int)
    few = counts[counts < 1500]
    angle = scene.highest_frequency * scene.duration
    return {
        "opened": int(opened.any(axis=0).sum()),
        "one length": {
            "reach": (angle / (1.1 * counts)).tolist(),
            "error": {
                name: errors_through_openings(
                    scene, name, counts, solution, runs=8 if quick else RUNS.get(name, 40)
                ).tolist()
                for name in METHODS
            },
        },
        "adaptive": {
            "reach": (angle / (1.1 * few)).tolist(),
            "error": {
                name: errors_through_openings(
                    scene, name, few, solution, True, 8 if quick else 40
                ).tolist()
                for name in ADAPTIVE
            },
        },
    }


def labelled(name: str, reach: list[float], error: list[float]) -> str:
    """Return a method's name with its order of convergence, if three errors or more show one.

    They are those of short steps above round-off.
    """
    x = np.array(reach)
    y = np.array(error)
    used = (x < ASYMPTOTIC.get(name, math.inf)) & (y > FLOOR)
    if used.sum() < 3:
        return name
    slope = np.polyfit(np.log(x[used]), np.log(y[used]), 1)[0]
    return f"{name}: {slope:.2f}"


def draw(data: dict[str, Any]) -> Figure:
    """Draw error against step, with the slope of every method."""
    picture = figure(7.5, 5)
    axes = picture.subplots(1, 2, sharey=True)
    for ax, kind, said in zip(
        axes,
        ("one length", "adaptive"),
        ("Fixed steps", "Adaptive step sizes around openings"),
        strict=True,
    ):
        reach = data[kind]["reach"]
        errors = data[kind]["error"]
        for name, error in errors.items():
            label = labelled(name, reach, error)
            ax.loglog(reach, error, **look_of(name), ms=4, lw=1.3, label=label)
        ax.set_title(said)
        ax.set_xlabel("step × highest frequency")
        place = "lower right" if kind == "one length" else "upper left"
        ax.legend(title="slope", alignment="left", loc=place, fontsize="small")
    x = np.array([2e-3, 0.1])
    shape = order_through_openings("rkn6", EXPONENT)
    for order, height, name in (
        (shape, 5e-13, f"predicted: δ + 1 = {shape}"),
        (2, 5e-6, "predicted: 2"),
    ):
        line = height * (x / x[0]) ** order
        axes[0].loglog(x, line, color="0.2", lw=1.2, ls="--")
        axes[0].annotate(
            name,
            (x[0], line[0]),
            (0, -14 if order > 2 else 34),
            textcoords="offset points",
            color="0.2",
        )
    axes[0].set(ylabel="relative error at the end", ylim=(1e-14, 1))
    axes[1].set_xticks([0.02, 0.05, 0.1, 0.2, 0.5])
    axes[1].xaxis.set_major_formatter("{x:g}")
    axes[1].xaxis.set_minor_formatter("")
    return picture
