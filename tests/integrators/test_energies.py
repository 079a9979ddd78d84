"""Energies that damped runs record, against quadratures of the power over their own motion."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import scene_of
from helpers.flying_grains import unlike
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from lmpchain import Chain, Drive, Force, Impulse, Law, Scene
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.methods import methods_of
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps

Array = NDArray[np.float64]
GRAINS = 6
EVERY_PART = {
    "viscoelastic": np.linspace(1e-7, 3e-7, GRAINS - 1),
    "drag": np.linspace(2e4, 0, GRAINS),
}
ENDS: dict[str, Any] = {"top": "wall", "bottom": "wall"}
CHAIN = unlike(GRAINS, damping=EVERY_PART, **ENDS)
EDGE = CHAIN.band_edge
OVERLAP = float(CHAIN.contacts.overlap.max())
SPEED = 0.2 * OVERLAP * EDGE
TONE = {"amplitude": 0.1 * OVERLAP, "frequency": 0.05 * EDGE}
# Displacements between which the speed jumps.
JUMPS = {
    "times": np.array([0.0, 7.0, 20.0]) / EDGE,
    "displacement": 0.1 * OVERLAP * np.array([0, 1, 0]),
    "interpolation": "linear",
}
LONG = Chain(grains=300, diameter=1e-3, top_load=0.02, damping={"viscoelastic": 1e-8, "drag": 1e3})
FIRST, SECOND = (Impulse(velocity=SPEED, grain=grain) for grain in (1, 2))
ROOTS = Law("k*max(o, 0)**p", p=[1.5] * (GRAINS - 1))
STOPS = Law("k*u + b*u**3", k=1e5, b=1e21)
SCENES = {
    "strike": (CHAIN, SECOND),
    "one viscosity": (unlike(GRAINS, damping={"viscoelastic": 2e-7}, **ENDS), FIRST),
    "touching wall": (CHAIN.replace(top_load=0.0), FIRST),
    "loose grains": (CHAIN.replace(gravity=0.0, load_grain=3, top="free"), FIRST),
    "formula": (CHAIN.replace(law=ROOTS), Drive(**TONE, grain=0)),
    "ground": (CHAIN.replace(ground=STOPS), SECOND),
    "long": (LONG, Impulse(velocity=1e-4, grain=150)),
    "force": (CHAIN, Force(amplitude=1e-3, frequency=0.05 * EDGE, grain=3)),
    "grain 1": (CHAIN, Drive(**TONE)),
    "wall": (CHAIN, Drive(**TONE, grain=0)),
    "jumps of grain 1": (CHAIN, Drive(**JUMPS)),
    "jumps of the wall": (CHAIN, Drive(**JUMPS, grain=0)),
}


def recorded(scene: Scene, method: str, each: int) -> tuple[Array, Array, Array]:
    """Return displacements, velocities, (T, N), and the energies of all samples, (2, T) J."""
    step = scene.sampling_interval / each
    stepper = NativeStepper(
        ChainBatch([scene]), methods_of(scene.chain)[method], Steps(each, 1, step), {}
    )
    stepper.balance = np.zeros((1, 1, scene.samples, 2))
    u, v = np.zeros((2, 1, scene.samples, scene.chain.grains))
    u[0, 0], v[0, 0] = scene.initial()
    while stepper.sample < scene.samples - 1:
        stepper.fill(u, v, 0, scene.samples - 1, 7)
    return u[0], v[0], stepper.balance[0, 0].T


def powers(scene: Scene, u: Array, v: Array, slopes: Array) -> Array:
    """Return the power of the losses and of the forcing at all samples, (2, T) W.

    `slopes` (T,) are the speeds of a driven body.
    """
    chain, excitation = scene.chain, scene.excitation
    contacts = chain.contacts
    v = v.copy()
    bodies, speeds = np.zeros((2, scene.samples, chain.grains + 2))
    if excitation.driven:
        v[:, 0] = slopes
    bodies[:, 1:-1], speeds[:, 1:-1] = u, v
    if excitation.wall:
        bodies[:, 0], speeds[:, 0] = excitation.waveform.at(scene.time), slopes
    overlap = np.maximum(contacts.overlap + bodies[:, :-1] - bodies[:, 1:], 0.0)
    closing = speeds[:, :-1] - speeds[:, 1:]
    stiffness = 1.5 * contacts.constant * np.sqrt(overlap)
    viscous = chain.contact_viscosity * stiffness * closing
    force = contacts.constant * overlap**1.5 - contacts.force + viscous
    free = (np.arange(chain.grains) < chain.movable) & (
        np.arange(chain.grains) >= excitation.driven
    )
    lost = (viscous * closing).sum(1) + v**2 @ np.where(free, chain.masses * chain.drag, 0.0)
    work = np.zeros(scene.samples)
    if excitation.kind == "force":
        work = excitation.waveform.at(scene.time) * v[:, excitation.grain - 1]
    elif excitation.wall:
        work = force[:, 0] * slopes
    elif excitation.driven:
        work = (force[:, 1] - force[:, 0]) * slopes
    return np.array([lost, work])


def integrated(scene: Scene, u: Array, v: Array) -> Array:
    """Return the lost energy and the work at all samples, (2, T) J, by splines between kinks."""
    kinks = scene.excitation.waveform.kinks if scene.excitation.does_work else ()
    inside = [t for t in kinks if 0 < t < 0.99 * scene.duration]
    ends = [0, *(round(t / scene.sampling_interval) for t in inside)]
    totals = np.zeros((2, scene.samples))
    for begin, end in pairwise([*ends, scene.samples - 1]):
        piece = slice(begin, end + 1)
        middle = (scene.time[begin] + scene.time[end]) / 2
        slopes = np.zeros(scene.samples)
        if scene.excitation.does_work:
            waveform = scene.excitation.waveform
            at = np.full(scene.samples, middle) if kinks else scene.time
            slopes = waveform.at(at, 1)
        power = powers(scene, u, v, slopes)[:, piece]
        spline = make_interp_spline(scene.time[piece], power, 5, axis=1).antiderivative()
        totals[:, piece] = totals[:, [begin]] + spline(scene.time[piece])
    return totals


@pytest.mark.parametrize("name", SCENES)
def test_recorded_energies_are_integrals_of_the_power(name: str):
    """They close the balance of energy; with velocity Verlet, their errors have its order."""
    chain, excitation = SCENES[name]
    scene = scene_of(chain, excitation, 20 / chain.band_edge, 401)
    u, v, found = recorded(scene, "dop853", 1)
    exact = integrated(scene, u, v)
    scale = np.abs(exact).max()
    # Splines lose their order where a contact opens.
    opens = name in ("touching wall", "loose grains")
    assert np.abs(found - exact).max() < (1e-4 if opens else 1e-10) * scale
    assert (np.abs(exact[:, -1]) > 0.1 * scale).sum() == 1 + scene.excitation.does_work
    if not scene.excitation.driven:
        top = scene.excitation.wall.at(scene.time) if scene.excitation.wall else None
        energy = chain.excess_energy(u, v, top)
        balance = energy - energy[0] + found[0] - found[1]
        assert np.abs(balance).max() < (1e-6 if opens else 1e-12) * scale
    for method, order in (("verlet", 2), ("lagged-verlet", 1)):
        errors = [np.abs(recorded(scene, method, n)[2] - exact).max() for n in (2, 4)]
        assert max(errors) < 0.01 * scale
        # The trapezoidal rule is of first order where the speed jumps.
        order = 1 if name.startswith("jumps") else order
        assert opens or np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)
