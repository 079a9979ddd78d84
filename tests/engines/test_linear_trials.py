"""Random trials of the linear engines: what they say that linearising leaves out, against the nonlinear motion."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np

import lmpchain
from lmpchain import Chain, Displacement, Drive, Impulse, InputError, Profile, Scene, ToleranceNotMet, simulate
from lmpchain.engines import Modes
from lmpchain.errors import RunFailed
from lmpchain.theory.modes import eigenmodes

LINEAR = ("modes", "chebyshev", "bessel", "continuum")
MOST_POINTS = 40_000  # of time, at which the largest motion is looked for


def drawn(seed: int) -> Scene:
    """Return a compressed chain of any exponent and ends, moved in any way, seldom or often recorded."""
    rng = np.random.default_rng(seed)
    while True:
        try:
            return _drawn(rng)
        except InputError:
            continue


def _drawn(rng: np.random.Generator) -> Scene:
    grains, load = int(rng.choice([2, 3, 4, 6, 12, 30, 80])), rng.choice(["gravity", "load", "both"])
    bottom, even = str(rng.choice(["fixed", "wall"])), rng.random() < 0.6
    kind = str(rng.choice(["impulse", "impulse", "displacement", "profile", "drive"]))
    chain = Chain(
        grains=grains,
        diameter=1e-3 if even else rng.uniform(0.6e-3, 1.6e-3, grains),
        gravity=0.0 if load == "load" else 9.81,
        top_load=0.0 if load == "gravity" else 10 ** rng.uniform(-5, -1),
        exponent=float(rng.choice([1.0, 1.0, 1.0, rng.uniform(1.0, 1.3), 1.5, 1.5, 2.0, rng.uniform(1, 3), 3.0])),
        top="wall" if load != "gravity" and kind != "drive" and rng.random() < 0.3 else "free",
        bottom=bottom,
    )
    edge, frequencies = chain.band_edge, eigenmodes(chain).frequency
    grain = 1 if rng.random() < 0.5 else int(rng.integers(1, chain.movable + 1))
    length = float(chain.equilibrium_overlap[min(grain, chain.grains - 1) - 1])
    strength = 10 ** (rng.uniform(-12, 0.2) if rng.random() < 0.4 else rng.uniform(-3, 0.3))
    sign = float(rng.choice([-1.0, 1.0]))
    excitation: lmpchain.scene.base.Excitation
    frequency = float(rng.choice(frequencies)) * float(rng.choice([1.0, 1.0 + 1e-3, rng.uniform(0.1, 1.5)]))
    if kind == "impulse":
        omega = np.sqrt(chain.linear_stiffness[min(grain, chain.grains - 1) - 1] / chain.masses[grain - 1])
        excitation = Impulse(velocity=sign * strength * length * omega, grain=grain)
    elif kind == "displacement":
        excitation = Displacement(displacement=sign * strength * length, grain=grain)
    elif kind == "profile":
        v = strength * length * edge / 2 * rng.normal(size=grains)
        v[chain.movable :] = 0
        excitation = Profile(velocity=v)
    else:
        excitation = Drive(amplitude=strength * length * 0.3, frequency=frequency / (2 * np.pi))
    samples = int(rng.choice([2, 3, 4, 5, 11, 51, 101, 1001]))
    duration = 10 ** rng.uniform(-0.5, 3 if rng.random() < 0.5 else 2) / edge * 6
    if rng.random() < 0.25:  # sampled at the same phase of one oscillation
        half = np.pi / frequency
        duration = half * (samples - 1) * max(1, round(duration / half / (samples - 1)))
    return Scene(chain=chain, excitation=excitation, duration=float(duration), samples=samples)


class Truth(NamedTuple):
    """The motion in the samples, (2, T, N), and its largest values at any time, (2,)."""

    motion: np.ndarray
    scale: np.ndarray

    def error(self, answer: lmpchain.Trajectory) -> float:
        """Return the error of an answer, as the package defines it."""
        found = np.array([answer.displacement, answer.velocity])
        return float((np.abs(found - self.motion).max((1, 2)) / self.scale).max())


def truth(scene: Scene) -> Truth | None:
    """Return the motion by the native engine at 1e-10; None where it cannot be had."""
    span = scene.duration * max(scene.chain.band_edge, scene.excitation.fastest)
    finer = int(np.clip(np.ceil(4 * span / (scene.samples - 1)), 1, max(1, MOST_POINTS // scene.samples)))
    fine = Scene(**scene.given() | {"samples": finer * (scene.samples - 1) + 1})
    try:
        run = simulate(fine, "native", 1e-10)
    except ToleranceNotMet as error:
        if error.trajectory is None or error.trajectory.error_estimate.total > 1e-4:
            return None
        run = error.trajectory
    except RunFailed:
        return None
    motion = np.array([run.displacement, run.velocity])
    return Truth(motion[:, ::finer], np.abs(motion).max((1, 2)))


class Trial(NamedTuple):
    """One answer to a drawn scene: which engine, what it says and what is true."""

    seed: int
    engine: str
    tolerance: float
    true: float
    model: float
    solver: float
    bound: float


def trials(seed: int) -> list[Trial]:
    """Return the answers of every linear engine, and of "auto" where that is one of them."""
    scene, rng = drawn(seed), np.random.default_rng([seed, 1])
    known, rows = truth(scene), []
    if known is None:
        return []
    with warnings.catch_warnings(action="ignore"):
        for name in LINEAR:
            engine = lmpchain.engines.get(name)
            if engine.refuses(engine.part(scene)):
                continue
            t = simulate(scene, name, 0.9, on_miss="warn")
            modes = Modes()
            part = modes.part(scene)
            bound = modes.bound_model_error(part, modes.candidate(part, 0.9)) if name == "modes" else np.nan
            rows.append(
                Trial(seed, name, np.nan, known.error(t), t.error_estimate.model, t.error_estimate.solver, bound)
            )
        for _ in range(2):
            tolerance = float(10 ** rng.uniform(-9, -0.3))
            try:
                if lmpchain.plan(scene, tolerance).engine not in LINEAR:
                    continue
                t = simulate(scene, tolerance=tolerance, on_miss="warn")
            except ToleranceNotMet:
                continue
            estimate = t.error_estimate
            rows.append(
                Trial(seed, f"auto {t.engine}", tolerance, known.error(t), estimate.model, estimate.solver, np.nan)
            )
    return rows
