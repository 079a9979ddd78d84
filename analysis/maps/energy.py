"""The energy over a million steps and more: kept by splittings, lost or gained by the others."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

import lmpchain
from lmpchain.compiling import compiled_once
from lmpchain.engines.methods import METHODS
from lmpchain.engines.splittings import SPLITTINGS
from lmpchain.plotting import figure
from lmpchain.stability.steps import EnergyError, drift, energy_error
from lmpchain.workprecision.chart import SHADES, SHAPES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORK = 0.03  # omega h a force evaluation, the same for all: each is given the steps that it can afford
PERIODS = 1e5  # of the band edge: a million steps and more for every method
SHORT = 100  # periods in which the error is measured against the step, before chaos tells one step from another
STEPS = {  # omega h where the error goes as its power
    "verlet": (0.02, 0.3),
    "rkn4": (0.1, 0.4),
    "rkn6": (0.2, 0.6),
    "kahan-li6": (0.1, 0.4),
    "kahan-li8": (0.3, 0.6),
}


def hot() -> lmpchain.Scene:
    """Return a loaded chain of eight grains that all move, compressed by up to a half of what holds them."""
    chain = lmpchain.Chain(grains=8, diameter=1e-3, gravity=0.0, top_load=1e-2)
    speed = np.append(np.random.default_rng(1).normal(size=7), 0.0) * 0.2 * chain.length_scale / chain.time_scale
    return lmpchain.Scene(chain=chain, excitation=lmpchain.Profile(velocity=speed), duration=1e-3)


@compiled_once("Runge and Kutta's method, to be compared with", 3)
def _runge_kutta(u, v, overlap, force, constant, inverse_mass, h, steps, samples):
    """Return displacement and velocity (samples, N) of the classical method of order 4 for Hertz's contacts."""
    grains = u.size
    us, vs = np.empty((samples, grains)), np.empty((samples, grains))
    du, dv = np.zeros((4, grains)), np.zeros((4, grains))
    for sample in range(samples):
        us[sample], vs[sample] = u, v
        for _ in range(steps if sample < samples - 1 else 0):
            for stage in range(4):
                part = 0.0 if stage == 0 else (0.5 if stage < 3 else 1.0) * h
                x, w = u + part * du[stage - 1], v + part * dv[stage - 1]
                above = 0.0
                for n in range(grains):
                    closer = overlap[n + 1] + x[n] - (x[n + 1] if n + 1 < grains else 0.0)
                    below = constant[n + 1] * max(closer, 0.0) ** 1.5 - force[n + 1]
                    du[stage, n], dv[stage, n] = w[n], inverse_mass[n] * (above - below)
                    above = below
            u = u + h / 6 * (du[0] + 2 * du[1] + 2 * du[2] + du[3])
            v = v + h / 6 * (dv[0] + 2 * dv[1] + 2 * dv[2] + dv[3])
    return us, vs


def runge_kutta(scene: lmpchain.Scene, step: float, periods: float, samples: int = 2001) -> EnergyError:
    """Do as `energy_error` does, by the classical Runge-Kutta method, which is no part of the package."""
    chain, (u, v) = scene.chain, scene.initial()
    duration = periods * 2 * math.pi / chain.band_edge
    steps = math.ceil(duration / (samples - 1) / step)
    h = duration / (samples - 1) / steps
    mobility = np.where(np.arange(chain.grains) < chain.movable, 1 / chain.masses, 0.0)
    contacts = chain.contacts
    us, vs = _runge_kutta(u, v, contacts.overlap, contacts.force, contacts.constant, mobility, h, steps, samples)
    energy = chain.excess_energy(us, vs)
    return EnergyError(np.linspace(0, duration, samples), energy / energy[0] - 1, h)


def measure(quick: bool) -> dict[str, Any]:
    """Return relative errors of the energy over time, their trends, and their spread against the step."""
    scene = hot()
    edge, periods = scene.chain.band_edge, 2e3 if quick else PERIODS
    long: dict[str, Any] = {}
    for name in [*METHODS, "rk4"]:
        step = WORK * (4 if name == "rk4" else METHODS[name].evaluations) / edge
        found = runge_kutta(scene, step, periods) if name == "rk4" else energy_error(scene, name, step, periods)
        rate, sure = found.trend()
        long[name] = {
            "time": found.time.tolist(),
            "error": found.error.tolist(),
            "steps": round(found.time[-1] / found.step),
            "rate": rate,
            "sure": sure,
            "predicted": 0.0 if name == "rk4" else drift(scene, name, found.step),
        }
    spread = {}
    for name, (least, most) in STEPS.items():
        reaches = np.geomspace(least, most, 3 if quick else 7)
        runs = [energy_error(scene, name, reach / edge, SHORT) for reach in reaches]
        spread[name] = {"reach": [run.step * edge for run in runs], "error": [float(run.error.std()) for run in runs]}
    return {"band_edge": edge, "long": long, "spread": spread}
