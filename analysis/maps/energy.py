"""Energy over a million steps or more: conserved by splittings, drifting with other methods."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from figures import one_above_two
from laws.openings import drift

import lmpchain
from lmpchain.integrators.methods import METHODS
from lmpchain.stability.step_limit import EnergyError, energy_error
from lmpchain.util.compilation import compiled_once
from lmpchain.util.plotting import look_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORK = 0.03  # Value of omega h per force evaluation, so that all methods do equal work.
PERIODS = 1e5  # Periods of the band edge, a million steps or more for every method.
SHORT = 100  # Periods for the error against the step, before chaos separates the runs.
SAMPLES = 201  # Number of samples in these runs.
THINNED = 10  # Every tenth sample of a long run is stored.
STEPS = {  # Values of omega h at which the error is a power law.
    "verlet": (0.02, 0.2),
    "rkn4": (0.04, 0.16),
    "rkn6": (0.2, 0.6),
    "kahan-li6": (0.1, 0.4),
    "kahan-li8": (0.24, 0.45),
}


def hot(grains: int) -> lmpchain.Scene:
    """Return a loaded chain with random velocities, large enough to be nonlinear.

    The last grain starts at rest. With more than four grains energy may stay localised for 1e5
    steps and then spread, which mimics a trend of 1e-6.
    """
    chain = lmpchain.Chain(grains=grains, diameter=1e-3, gravity=0.0, top_load=1e-2)
    speed = (
        np.append(np.random.default_rng(1).normal(size=grains - 1), 0.0)
        * 0.2
        * chain.length_scale
        / chain.time_scale
    )
    return lmpchain.Scene(chain=chain, excitation=lmpchain.Profile(velocity=speed), duration=1e-3)


@compiled_once("Runge and Kutta's method, to be compared with", 3)
def _runge_kutta(u, v, overlap, force, constant, inverse_mass, h, steps, samples):
    """Return the displacement and velocity (samples, N) by the classical Runge-Kutta method."""
    grains = u.size
    us = np.empty((samples, grains))
    vs = np.empty((samples, grains))
    du = np.zeros((4, grains))
    dv = np.zeros((4, grains))
    for sample in range(samples):
        us[sample] = u
        vs[sample] = v
        for _ in range(steps if sample < samples - 1 else 0):
            for stage in range(4):
                part = 0.0 if stage == 0 else (0.5 if stage < 3 else 1.0) * h
                x = u + part * du[stage - 1]
                w = v + part * dv[stage - 1]
                above = 0.0
                for n in range(grains):
                    closer = overlap[n + 1] + x[n] - (x[n + 1] if n + 1 < grains else 0.0)
                    below = constant[n + 1] * max(closer, 0.0) ** 1.5 - force[n + 1]
                    du[stage, n] = w[n]
                    dv[stage, n] = inverse_mass[n] * (above - below)
                    above = below
            u = u + h / 6 * (du[0] + 2 * du[1] + 2 * du[2] + du[3])
            v = v + h / 6 * (dv[0] + 2 * dv[1] + 2 * dv[2] + dv[3])
    return us, vs


def rk4_growth(reach: float) -> float:
    """Return the growth factor of an oscillator in a step of the classical Runge-Kutta method."""
    return abs(sum((1j * reach) ** k / math.factorial(k) for k in range(5)))


def runge_kutta(
    scene: lmpchain.Scene, step: float, periods: float, samples: int = 2001
) -> EnergyError:
    """Measure the energy error of the classical Runge-Kutta method, as `energy_error` does."""
    chain = scene.chain
    (u, v) = scene.initial()
    duration = periods * 2 * math.pi / chain.band_edge
    steps = math.ceil(duration / (samples - 1) / step)
    h = duration / (samples - 1) / steps
    mobility = np.where(np.arange(chain.grains) < chain.movable, 1 / chain.masses, 0.0)
    contacts = chain.contacts
    us, vs = _runge_kutta(
        u, v, contacts.overlap, contacts.force, contacts.constant, mobility, h, steps, samples
    )
    energy = chain.excess_energy(us, vs)
    return EnergyError(np.linspace(0, duration, samples), energy / energy[0] - 1, h)


def measure(quick: bool) -> dict[str, Any]:
    """Return relative energy errors over time, their trends, and their scatter against the step."""
    scene = hot(4)
    edge = scene.chain.band_edge
    periods = 2e3 if quick else PERIODS
    long: dict[str, Any] = {}
    for name in [*METHODS, "rk4"]:
        step = WORK * (4 if name == "rk4" else METHODS[name].evaluations) / edge
        record = (
            runge_kutta(scene, step, periods)
            if name == "rk4"
            else energy_error(scene, name, step, periods)
        )
        rate, sure = record.trend()
        long[name] = {
            "time": record.time[::THINNED].tolist(),
            "error": record.error[::THINNED].tolist(),
            "steps": round(record.time[-1] / record.step),
            "rate": rate,
            "sure": sure,
            "predicted": drift(
                scene, rk4_growth if name == "rk4" else METHODS[name].growth, record.step
            ),
        }
    spread = {}
    more = hot(8)
    for name, (least, most) in STEPS.items():
        reaches = np.geomspace(least, most, 3 if quick else 7)
        runs = [
            energy_error(more, name, reach / more.chain.band_edge, SHORT, SAMPLES)
            for reach in reaches
        ]
        spread[name] = {
            "reach": [run.step * more.chain.band_edge for run in runs],
            "error": [float(run.error.std()) for run in runs],
        }
    return {"band_edge": edge, "long": long, "spread": spread}


def draw(data: dict[str, Any]) -> Figure:
    """Draw the energy over time, its trend with its confidence, and its error against the step."""
    picture, over_time, trends, orders = one_above_two()
    styles = {name: look_of(name) for name in data["long"]}
    _over_time(over_time, data, styles)
    _trends(trends, data, styles)
    for name, record in data["spread"].items():
        slope = np.polyfit(np.log(record["reach"]), np.log(record["error"]), 1)[0]
        label = f"{name}: slope {slope:.2f}"
        orders.loglog(
            record["reach"], record["error"], **styles[name] | {"ms": 5, "lw": 1.4}, label=label
        )
    orders.set_xticks([0.02, 0.05, 0.1, 0.2, 0.5])
    orders.xaxis.set_major_formatter("{x:g}")
    orders.xaxis.set_minor_formatter("")
    orders.set(xlabel="step × band edge", ylabel="spread of the energy error")
    orders.set_title("Spread against the step")
    orders.set_ylim(top=1e5)
    orders.legend(loc="upper left")
    return picture


def _over_time(ax: Any, data: dict[str, Any], styles: dict[str, dict[str, str]]) -> None:
    """Draw the largest error so far, labelled at its end, and the predicted drift."""
    ends = {}
    for name, record in data["long"].items():
        time = np.array(record["time"][1:])
        error = np.abs(record["error"][1:])
        periods = time * data["band_edge"] / (2 * np.pi)
        largest = np.maximum.accumulate(error)
        ax.loglog(periods, largest, color=styles[name]["color"], lw=1.8)
        ends[name] = float(largest[-1])
        if record["predicted"]:
            ax.loglog(
                periods, np.abs(np.array(record["predicted"])) * time, color="0.2", lw=1, ls="--"
            )
    ax.plot([], [], color="0.2", lw=1, ls="--", label="drift predicted for a weak wave")
    height = -math.inf
    for name in sorted(ends, key=ends.__getitem__):
        height = max(height + 0.75, math.log10(ends[name]))  # Labels must not overlap.
        text = f"{name}, {data['long'][name]['steps'] / 1e6:.2g}"
        ax.annotate(text, (1.03, 10**height), xycoords=("axes fraction", "data"), va="center",
                    color=styles[name]["color"], annotation_clip=False)  # fmt: skip
    ax.annotate(
        "million steps", (1.03, 1.02), xycoords="axes fraction", color="0.35", fontsize="small"
    )
    ax.set(xlabel="periods of the band edge", ylabel="largest relative error of the energy so far")
    ax.set_title("Energy at equal work")
    ax.legend(loc="upper left")


def _trends(ax: Any, data: dict[str, Any], styles: dict[str, dict[str, str]]) -> None:
    """Draw the trend over the whole run in units of its fluctuation, with 99 % confidence."""
    for place, (name, record) in enumerate(data["long"].items()):
        time = np.array(record["time"])
        error = np.array(record["error"])
        unit = (error - record["rate"] * time).std() / time[-1]
        ax.errorbar(
            record["rate"] / unit,
            -place,
            xerr=record["sure"] / unit,
            fmt=styles[name]["marker"],
            color=styles[name]["color"],
            capsize=4,
            ms=6,
        )
    ax.axvline(0, color="0.6", lw=1, zorder=0)
    ax.set_xscale("symlog", linthresh=0.1)
    ax.set(xlim=(-1e7, 1e7), xticks=[-1e6, -1e3, -1, 0, 1, 1e3, 1e6])
    ax.set_yticks(-np.arange(len(data["long"])), list(data["long"]))
    ax.set_xlabel("trend ÷ fluctuation, 99 % confidence")
    ax.set_title("Trend of the energy")
