"""The light cone: the grains that a wave can have reached. What lies outside is at rest and need not be computed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..engines.base import Candidate
from .scene import Scene

UNSEEN = math.log(1e-22)  # motion, over that of the grain that is struck, which no answer holds
WORTH = 0.7  # of the grains: more than that are not worth a cut; analysis/calibration/light_cone.py


def reached(scene: Scene) -> tuple[int, int]:
    """Return the first and the last grain that can have moved by 1e-22 of the strike when the scene ends.

    Springs no stiffer than k_max pass on a displacement of 1 by at most the modified Bessel function I_2d(W t) over d
    grains, W^2 = 4 k_max / m_min, whatever they do in between: all terms of the series of the exact solution are
    positive there. The stiffest contact is bounded by the energy; a driven chain has no such bound and is not cut.
    """
    grains = scene.chain.grains
    if scene.drive or grains < 64:
        return 1, grains
    top, bottom = scene.excitation.reach(scene.chain)
    away = 32
    while True:
        first, last = max(1, top - away), min(grains, bottom + away)
        if last - first + 1 > WORTH * grains:
            return 1, grains
        chain = scene.chain.part(first, last)
        squeezed = chain.contacts.overlap_bound(scene.energy)
        stiffness = chain.exponent * chain.contacts.constant * squeezed ** (chain.exponent - 1)
        needed = _distance(2 * math.sqrt(float(stiffness.max()) / chain.masses.min()) * scene.duration)
        if needed <= away:
            return max(1, top - needed), min(grains, bottom + needed)
        away = max(needed, 2 * away)


def _distance(x: float) -> int:
    """Return d from which I_2d(x) <= (x/2)^2d / (2d)! exp(x^2 / (8d + 4)) is too small to be seen."""
    d = max(8, int(x / 2))
    while 2 * d * math.log(x / 2 + 1e-300) - math.lgamma(2 * d + 1) + x**2 / (8 * d + 4) > UNSEEN:
        d += max(1, d // 16)
    return d + 2


def cut(scene: Scene) -> tuple[int, Scene]:
    """Return the first grain that is reached and all that are as a scene; found once, for every engine that asks."""
    if "cone" not in scene.notes:
        first, last = reached(scene)
        scene.notes["cone"] = first, None if last - first + 1 == scene.chain.grains else scene.part(first, last)
    first, part = scene.notes["cone"]
    return first, part or scene


def near(scene: Scene, candidate: Candidate) -> tuple[Scene, NDArray[np.intp], slice | NDArray[np.intp]]:
    """Return the part of a scene that a candidate computes.

    Returns
    -------
    that part as a scene, the indices in it of the grains that are recorded, and their columns in the record
    """
    if candidate.active_grains == scene.chain.grains:
        return scene, scene.recorded - 1, slice(None)
    first, last = candidate.first_grain, candidate.first_grain + candidate.active_grains - 1
    columns = np.flatnonzero((scene.recorded >= first) & (scene.recorded <= last))
    rows = scene.recorded[columns] - first
    together = columns.size and columns[-1] - columns[0] + 1 == columns.size
    begin, part = cut(scene)
    if (begin, part.chain.grains) != (first, candidate.active_grains):  # a candidate of another version, or time
        part = scene.part(first, last)
    return part, rows, slice(columns[0], columns[-1] + 1) if together else columns
