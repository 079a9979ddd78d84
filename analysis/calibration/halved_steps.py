"""Measure the factor SAFETY on differences between runs with other steps: gradients and orbits.

Gradients of a last velocity by the masses and the velocities at t = 0, at some lengths of the
steps, are held against differences of Taylor series in extended precision; orbits with long steps
against those of steps as short as round-off lets them be. A factor is supported from what 99 in 100
claimed errors need on, up to half again that or ten times what half need.

    python analysis/calibration/halved_steps.py           # two minutes
    python analysis/calibration/halved_steps.py --quick   # seconds
"""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import numpy as np
from common import ALL_BUT_ONE, Case, Row, command, quantile
from scenes import drawn

from lmpchain import Chain, LmpchainError, Profile, Scene
from lmpchain.design import Momentum, gradient
from lmpchain.integrators.halving import SAFETY
from lmpchain.integrators.methods import SPLITTINGS
from lmpchain.orbits import normal_mode, shooting
from lmpchain.orbits.shooting import NEWTON

REACHES = (0.8, 0.4, 0.2, 0.1)  # Values of omega h.
METHODS = ("verlet", "rkn4", "rkn6", "kahan-li8")
CHANGE = 1e-5  # Relative step of differences of Taylor series.
KNOWN = 1e-6, 0.3  # Range of gradient errors that are known and follow an order.
COARSE = (1.6, 1.2, 0.8, 0.6)  # Values of omega h of the orbits whose error is measured.
MARGIN = 1.5
LOOSE = 10.0


def momentum(scene: Scene) -> float:
    """Return the true final momentum of the first grain."""
    return float(scene.chain.masses[0] * Case(scene).motion[1, -1, 0])


def true_gradients(scene: Scene) -> dict[str, np.ndarray]:
    """Return the derivatives of this momentum by differences of Taylor series."""
    found = {}
    u, v = scene.initial()
    for name, values in (("masses", scene.chain.masses), ("velocity", v)):
        slopes = np.zeros(values.size)
        for k in range(scene.chain.movable if values.any() else 0):
            size = CHANGE * np.abs(values).max()
            ends = []
            for sign in (1.0, -1.0):
                moved = values.copy()
                moved[k] += sign * size
                if name == "masses":
                    ends.append(momentum(scene.replace(chain=scene.chain.replace(masses=moved))))
                else:
                    ends.append(
                        momentum(scene.replace(excitation=Profile(displacement=u, velocity=moved)))
                    )
            slopes[k] = (ends[0] - ends[1]) / (2 * size)
        found[name] = slopes
    return found


def needed(scene: Scene) -> list[float]:
    """Return the factors that the error estimates of a scene's gradients would need."""
    true = true_gradients(scene)
    factors = []
    for name in METHODS:
        for reach in REACHES:
            if 2 * reach > SPLITTINGS[name].stability_limit:
                continue
            step = reach / scene.highest_frequency
            found = gradient(scene, Momentum([1]), list(true), integrator=name, step=step)
            for key, slopes in true.items():
                moving = slice(scene.chain.movable)
                largest = np.abs(slopes[moving]).max()
                off = np.abs(found[key][moving] - slopes[moving]).max()
                if largest and KNOWN[0] * largest < off and found.errors[key] < KNOWN[1] * largest:
                    factors.append(SAFETY * float(off) / found.errors[key])
    return factors


def of_gradients(count: int) -> list[float]:
    """Return the factors needed by random scenes, half of which open contacts."""
    factors: list[float] = []
    ranges = {
        "grains": (2, 3, 5),
        "spans": (2.0, 12.0),
        "driven": 0.0,
        "samples": 3,
        "kinds": ("gravity", "load"),
    }
    for seed, strength in ((171, (-2.0, 0.0)), (172, (0.5, 2.0))):
        for scene in drawn(count, seed, strength=strength, **ranges):
            u, v = scene.initial()
            try:
                factors += needed(
                    scene.replace(excitation=Profile(displacement=u, velocity=v), grains="all")
                )
            except LmpchainError:
                continue
    return factors


def of_orbits(count: int) -> list[float]:
    """Return the factors needed by nonlinear normal modes of random chains."""
    rng = np.random.default_rng(173)
    factors = []
    for _ in range(count):
        grains = int(rng.choice([2, 3, 5, 8]))
        diameter = 1e-3 * rng.uniform(0.8, 1.25, grains)
        load = 10 ** rng.uniform(-2, 1)
        chain = Chain(grains=grains, diameter=diameter, gravity=0.0, top_load=load)
        rest = load * float(chain.equilibrium_overlap[0])
        mode = int(rng.integers(1, chain.movable + 1))
        energy = rest * 10 ** rng.uniform(-3, 0.7)
        try:
            true = normal_mode(chain, mode, energy)
        except LmpchainError:
            continue
        for reach in COARSE:
            with (
                mock.patch.object(shooting, "MESH", replace(shooting.MESH, reach=reach)),
                mock.patch.object(shooting, "NEWTON", replace(NEWTON, closed=1.0)),
            ):
                try:
                    found = normal_mode(chain, mode, energy)
                except LmpchainError:
                    continue
            apart = (
                np.abs(found.displacement - true.displacement).max()
                / np.abs(true.displacement).max()
            )
            off = max(float(apart), abs(np.log(found.period / true.period)))
            if 100 * NEWTON.closed < off < 0.01:
                factors.append(SAFETY * off / found.error)
    return factors


def row(name: str, shipped: float, factors: list[float], what: str) -> Row:
    """Return the row of a factor."""
    middle = quantile(factors, 0.5)
    low = quantile(factors, ALL_BUT_ONE)
    most = max(factors)
    enough = 100 * np.mean(np.array(factors) <= shipped)
    says = (
        f"{enough:.1f} % of {len(factors)} {what} are bounds; half need {middle:.2g}, 99 % "
        f"{low:.2g}, all {most:.2g}"
    )
    return Row(name, shipped, low, low, max(MARGIN * low, LOOSE * middle), says)


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    return [
        row(
            "SAFETY (gradients)",
            SAFETY,
            of_gradients(1 if quick else 30),
            "errors of gradients",
        ),
        row("SAFETY (orbits)", SAFETY, of_orbits(2 if quick else 60), "errors of orbits"),
    ]


if __name__ == "__main__":
    command(main, __doc__)
