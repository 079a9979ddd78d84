"""The order of every method where contacts open and close, with steps of one length and with graded ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

import lmpchain
from lmpchain.engines.methods import METHODS
from lmpchain.plotting import figure
from lmpchain.reference import reference
from lmpchain.stability.steps import errors_through_openings, order_through_openings
from lmpchain.workprecision.chart import SHADES, SHAPES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXPONENT = 1.5
GRADED = [name for name in METHODS if name not in ("verlet", "gear4")]  # which can be, and have an order to lose
FIT = {False: (1e-3, 0.06), True: (0.02, 0.4)}  # step x frequency between which the slope is found, one length, graded
FLOOR = 3e-13  # error below which round-off has its part


def measure(quick: bool) -> dict[str, Any]:
    """Return the errors of a strong strike on 30 beads, in which three contacts open, against the step."""
    scene = lmpchain.Scene(
        chain=lmpchain.Chain(grains=30, diameter=1e-3, exponent=EXPONENT),
        excitation=lmpchain.Impulse(velocity=8.57e-3),
        duration=60e-6,
        samples=21,
    )
    truth = reference(scene)
    apart = lmpchain.simulate(scene, "native", 1e-9).displacement
    opened = (scene.chain.contacts.overlap + scene.chain.contacts.closer(apart))[:, 1:-1] < 0
    counts = np.geomspace(60, 6000 if quick else 20000, 5 if quick else 16).astype(int)
    few = counts[counts < 1000]
    angle = scene.highest_frequency * scene.duration
    return {
        "opened": int(opened.any(axis=0).sum()),
        "one length": {
            "reach": (angle / (1.1 * counts)).tolist(),
            "error": {name: errors_through_openings(scene, name, counts, truth).tolist() for name in METHODS},
        },
        "graded": {
            "reach": (angle / (1.1 * few)).tolist(),
            "error": {name: errors_through_openings(scene, name, few, truth, True).tolist() for name in GRADED},
        },
    }


def slope(reach: list[float], error: list[float], graded: bool) -> float:
    """Return the order that errors show where truncation, of short steps, is what makes them."""
    x, y, (least, most) = np.array(reach), np.array(error), FIT[graded]
    used = (x > least) & (x < most) & (y > FLOOR)
    return float(np.polyfit(np.log(x[used]), np.log(y[used]), 1)[0])


def draw(data: dict[str, Any]) -> Figure:
    """Draw error against step, with the slope of every method."""
    picture = figure(12, 6)
    axes = picture.subplots(1, 2, sharey=True)
    for ax, kind, said in zip(
        axes, ("one length", "graded"), ("Steps of one length", "Steps that shorten around openings"), strict=True
    ):
        reach, found = data[kind]["reach"], data[kind]["error"]
        for name, colour, shape in zip(METHODS, SHADES, SHAPES, strict=False):
            if name in found:
                label = f"{name}: {slope(reach, found[name], kind == 'graded'):.2f}"
                ax.loglog(reach, found[name], color=colour, marker=shape, ms=5, lw=1.3, label=label)
        ax.set_title(said, loc="left", fontsize="medium")
        ax.set_xlabel("step × highest frequency")
        ax.legend(title="slope", alignment="left", frameon=False, loc="lower right")
    x = np.array([2e-3, 0.2])
    for order, height in ((order_through_openings("rkn6", EXPONENT), 2e-13), (2, 3e-3)):
        axes[0].loglog(x, height * (x / x[0]) ** order, color="0.2", lw=1.2, ls="--")
    axes[0].set(ylabel="relative error at the end", ylim=(1e-14, 1))
    return picture
