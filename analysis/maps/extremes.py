"""Extreme overlaps, gauges and orders: loss of accuracy of engines and functions, and laws."""

from __future__ import annotations

from typing import Any

import mpmath as mp
import numpy as np
from figures import SHADES
from laws import limits
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lmpchain import Chain
from lmpchain.chain.bounds import LIMITS
from lmpchain.stability.pre_run import deepest, hertz_excess
from lmpchain.theory import bessel, dyson
from lmpchain.util.plotting import figure

BLUE, ORANGE, GREEN, PINK, SKY, RED = SHADES
POINT = {"ls": "none", "ms": 5, "mfc": "none"}


def measure(quick: bool) -> dict[str, Any]:
    """Return the numbers of all panels."""
    every = 5 if quick else 1
    strains = np.append(np.logspace(-6, -1.5, 10)[::every], 0.0999)
    gauges = np.logspace(-7, -3, 9)[::every]
    orders = np.logspace(0, 15, 16)[::every]
    grains = np.round(np.logspace(3, 8, 11)).astype(int)[::every]
    pressed = [limits.squeezing(float(x)) for x in strains]
    column = Chain(grains=20, diameter=limits.BEAD)
    return {
        "strains": strains.tolist(),
        "deepest": [deepest(scene) for scene in pressed],
        "squeezed": [limits.squeezed(scene) for scene in pressed],
        "hertz": hertz_excess(strains).tolist(),
        "gauges": gauges.tolist(),
        "rates": [float(limits.buckling(column, float(d)).frequency[-1]) for d in gauges],
        "growth": [limits.growth(column, float(d)) for d in gauges],
        "band_edge": column.band_edge,
        "orders": orders.tolist(),
        "dyson": [_dyson(float(m)) for m in orders],
        "grains": grains.tolist(),
        "bessel": np.abs(
            bessel.free_end(grains, grains - 0.5) / limits.front_of_springs(grains) - 1
        ).tolist(),
        "bessel_law": limits.bessel_rounding(grains).tolist(),
    }


def _dyson(m: float) -> tuple[float, float, float]:
    """Return the largest error of Eq. (23).

    (23) within 3 standard deviations, its law, and the printed form's.
    """
    kappa = 1 + np.linspace(-0.9, 3, 14) / np.sqrt(m)
    with mp.workdps(60):
        true = [
            mp.exp(m * mp.log(m) - mp.loggamma(m) + m * mp.log(k) - m * k)
            for k in map(mp.mpf, kappa.tolist())
        ]

    def off(values: np.ndarray) -> float:
        return max(float(abs(f / t - 1)) for f, t in zip(values.tolist(), true, strict=True))

    with np.errstate(all="ignore"):
        plain = np.float64(m) ** m / np.float64(mp.gamma(m)) * kappa**m * np.exp(-m * kappa)
    printed = off(plain) if np.isfinite(plain).all() and (plain > 0).all() else np.inf
    return off(dyson.weight(kappa, m)), float(limits.dyson_rounding(kappa, m).max()), printed


def draw(data: dict[str, Any]) -> Figure:
    """Draw a panel per limit: laws are lines, measurements are points."""
    picture = figure(7.5, 7.5)
    panels = picture.subplots(2, 2).ravel()
    for axes, panel in zip(panels, (_overlaps, _bending, _weights, _functions), strict=True):
        axes.set(xscale="log", yscale="log")
        panel(axes, data)
        axes.title.set_fontsize("medium")
        axes.legend()
    return picture


def _overlaps(axes: Axes, data: dict[str, Any]) -> None:
    strains = data["strains"]
    squeezed = np.array(data["squeezed"])
    axes.plot(
        strains, data["deepest"], color=BLUE, lw=1.2, label="deepest overlap: bound by energy"
    )
    axes.plot(strains, squeezed[:, 0], **POINT, marker="s", color=BLUE, label="... in the run")
    axes.plot(strains, data["hertz"], color=ORANGE, lw=1.2, label="Hertz too hard, by shape alone")
    axes.plot(strains, squeezed[:, 1], **POINT, marker="o", color=RED, label="LAMMPS from native")
    axes.axvline(LIMITS.compression, color="0.4", ls="--", lw=1)
    axes.annotate(
        "refused",
        (LIMITS.compression, 1e-11),
        (-3, 0),
        "data",
        "offset points",
        ha="right",
        color="0.4",
    )
    axes.set(
        xlabel="overlap / diameter as struck",
        ylabel="overlap / diameter; relative difference",
        ylim=(1e-12, 1e5),
    )
    axes.set_title("Deep overlaps")


def _bending(axes: Axes, data: dict[str, Any]) -> None:
    axes.plot(
        data["gauges"], data["rates"], color=BLUE, lw=1.2, label="linear stability of a column"
    )
    axes.plot(data["gauges"], data["growth"], **POINT, marker="o", color=RED, label="LAMMPS")
    axes.axhline(data["band_edge"], color="0.4", ls="--", lw=1)
    axes.annotate(
        "band edge",
        (data["gauges"][-1], data["band_edge"]),
        (0, 4),
        "data",
        "offset points",
        ha="right",
    )
    axes.set(xlabel="diameter drawn (m)", ylabel="growth of a bend (1/s)", ylim=(None, 2e6))
    axes.set_title("Bending of a column in LAMMPS")


def _weights(axes: Axes, data: dict[str, Any]) -> None:
    values, law, printed = np.array(data["dyson"], dtype=float).T
    axes.plot(data["orders"], law, color=BLUE, lw=1.2, label="rounding of κ: ε m |κ - 1|")
    axes.plot(data["orders"], values, **POINT, marker="o", color=BLUE, label="theory.dyson.weight")
    axes.plot(
        data["orders"],
        np.where(np.isfinite(printed), printed, np.nan),
        **POINT,
        marker="x",
        color=RED,
        label="as printed",
    )
    axes.axvline(limits.MOST_PRINTED, color=RED, ls="--", lw=1)
    axes.annotate(
        "overflows", (limits.MOST_PRINTED, 1e-6), (4, 0), "data", "offset points", color=RED
    )
    axes.set(xlabel="order m", ylabel="relative error", ylim=(1e-17, 1e-3))
    axes.set_title(f"Dyson's weight, Eq. (23): overflow at m = {limits.MOST_PRINTED:.0f}")


def _functions(axes: Axes, data: dict[str, Any]) -> None:
    axes.plot(
        data["grains"],
        data["bessel_law"],
        color=BLUE,
        lw=1.2,
        label="rounding of T: ε (2n)$^{2/3}$",
    )
    floor = np.maximum(data["bessel"], 1e-16)
    axes.plot(
        data["grains"],
        floor,
        **POINT,
        marker="o",
        color=BLUE,
        label="theory.bessel.free_end at T = n - 1/2",
    )
    axes.set(xlabel="grain n", ylabel="relative error", ylim=(1e-17, 1e-8))
    axes.set_title("Bessel functions of large order")
