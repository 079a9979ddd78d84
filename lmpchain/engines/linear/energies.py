"""Dissipated energy and work of the forcing in a damped linearised chain, by quadrature.

The powers are integrated along the solution itself, so that the energies depend neither on the
samples nor on the balance of energy.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.polynomial import legendre

from ...scene.scene import Scene
from ...util.arrays import Array
from ..base import ErrorBudget
from .solutions import LinearSolution

GAUSS_NODES, _WEIGHTS = legendre.leggauss(32)
# Coefficients of the Legendre series (32,) from the values at the nodes.
PROJECT = (np.arange(32) + 0.5)[:, None] * _WEIGHTS * legendre.legvander(GAUSS_NODES, 31).T
# A panel is halved at most so often: an overdamped mode decays within a small part of a panel.
HALVINGS = 12


def sum_energies(
    scene: Scene,
    solve: Callable[[], LinearSolution],
    budget: ErrorBudget,
    scale: Array,
    most: int,
) -> dict[str, Array]:
    """Return the dissipated energy and the work at the samples, (T,) J, with their errors.

    Parameters
    ----------
    scene : Scene
    solve : callable
        Returns the solution at t = 0.
    budget : ErrorBudget
        Estimated error of the solution.
    scale : (2,) array
        Largest displacement and velocity, m and m/s.
    most : int
        Largest number of evaluations.

    Returns
    -------
    dict of arrays
        Empty without damping, because the balance of energy then gives the work, and if the
        quadrature takes more evaluations.
    """
    excitation = scene.excitation
    left = most // GAUSS_NODES.size
    # A product of two oscillations over a panel of 10 rad is a Legendre series of 32 terms to
    # rounding.
    count = math.ceil(scene.linear_frequency * scene.duration / 10.0)
    if not scene.chain.damped or count > left:
        return {}
    corners = excitation.waveform.corners if excitation.waveform else ()
    edges = np.linspace(0.0, scene.duration, count + 1)
    edges = np.union1d(edges, [t for t in corners if 0 < t < scene.duration])
    begin, width = edges[:-1], np.diff(edges)
    accepted = []
    largest = np.zeros(2)
    for halvings in range(HALVINGS + 1):
        left -= begin.size
        if left < 0:
            return {}
        times = begin[:, None] + width[:, None] / 2 * (1 + GAUSS_NODES)
        powers = _powers(scene, solve(), times.ravel(), budget.total * scale)
        series = PROJECT @ powers.reshape(*times.shape, 4)
        largest = np.maximum(largest, np.abs(powers[:, :2]).max(0))
        tails = np.abs(series[:, -2:, :2]).max(1)
        poor = (tails > 10 * budget.solver * largest).any(1) & (halvings < HALVINGS)
        accepted.append((begin[~poor], width[~poor], series[~poor], tails[~poor]))
        if not poor.any():
            break
        width = np.repeat(width[poor] / 2, 2)
        begin = np.repeat(begin[poor], 2)
        begin[1::2] += width[1::2]
    begin, width, series, tails = map(np.concatenate, zip(*accepted, strict=True))
    order = np.argsort(begin)
    panel = np.searchsorted(begin[order], scene.time, side="right") - 1
    position = 2 * (scene.time - begin[order][panel]) / width[order][panel] - 1
    errors = width @ (2 * tails + series[:, 0, 2:])
    energies = {}
    for column, name in enumerate(("dissipated", "drive")):
        if column and not excitation.does_work:
            continue
        integral = legendre.legint(series[order, :, column].T, lbnd=-1) * width[order] / 2
        before = np.cumsum(integral.sum(0)) - integral.sum(0)
        within = legendre.legval(position, integral[:, panel], tensor=False)
        energies[name] = before[panel] + within
        energies[f"{name}_error"] = np.array(errors[column])
    if excitation.driven and excitation.waveform:
        # The force on a driven grain accelerates the grain itself, too.
        speed = excitation.waveform.at(scene.time, 1)
        energies["drive"] += scene.chain.masses[0] / 2 * (speed**2 - speed[0] ** 2)
    return energies


def _powers(scene: Scene, solution: LinearSolution, times: Array, off: Array) -> Array:
    """Return the powers of damping and of the forcing, and their errors, (T, 4) W.

    Displacements and velocities of the solution have the errors `off`, m and m/s.
    """
    chain = scene.chain
    excitation = scene.excitation
    wall = excitation.wall
    moved = (wall.at(times), wall.at(times, 1)) if wall else (None, None)
    u, v, _ = solution.at(times)
    closing = chain.contacts.closer(v, moved[1])
    stiffness = chain.contacts.stiffness
    viscosity = stiffness * chain.contact_viscosity
    drag = chain.masses * chain.drag
    drag[: excitation.driven] = 0.0
    closing_off, fast = 2 * off[1], off[1]
    lost = closing**2 @ viscosity + v**2 @ drag
    lost_off = (2 * np.abs(closing) + closing_off) @ viscosity * closing_off
    lost_off += (2 * np.abs(v) + fast) @ drag * fast
    force = stiffness * chain.contacts.closer(u, moved[0]) + viscosity * closing
    push = excitation.push(chain, times, force, np.zeros(force.shape), v)
    if push is None:
        return np.stack([lost, np.zeros(lost.shape), lost_off, np.zeros(lost.shape)], axis=1)
    given_off = np.abs(push.force) * fast
    if excitation.driven or wall:
        touched = slice(0, 1 + excitation.driven)
        force_off = stiffness[touched].sum() * 2 * off[0] + viscosity[touched].sum() * closing_off
        given_off = np.abs(push.speed) * force_off
    return np.stack([lost, push.force * push.speed, lost_off, given_off], axis=1)
