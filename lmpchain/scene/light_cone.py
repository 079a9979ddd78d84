"""The light cone: the grains that a wave can have reached; all others are at rest."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..chain.chain import Chain
from ..chain.contacts import FEW_GRAINS
from .base import Excitation


@dataclass(frozen=True)
class Cut:
    """When a chain is cut to the grains that the wave can have reached.

    Attributes
    ----------
    unseen : float
        Motion over that of the grain that is struck which no answer holds.
    share : float
        Of the grains: where more are reached, all are computed
        (analysis/calibration/light_cone.py).
    shortest : int
        Grains: a shorter chain is computed as a whole, for less than it takes to cut it.
    """

    unseen: float = 1e-22
    share: float = 0.7
    shortest: int = 128


CUT = Cut()


def reached(
    chain: Chain, excitation: Excitation, energy: float, duration: float
) -> tuple[int, int]:
    """Return the first and last grain that can have moved by 1e-22 of the strike at the end.

    Springs no stiffer than k_max pass on a displacement of 1 by at most the modified Bessel
    function I_2d(W t) over d grains, W^2 = 4 k_max / m_min, whatever they do in between: all terms
    of the series of the exact solution are positive there. The stiffest contact is bounded by the
    energy above rest; a driven chain has no such bound, and the light cone is all of it.

    Parameters
    ----------
    chain : Chain
    excitation : Excitation
    energy : float
        Above rest, J; infinite where it is not known beforehand.
    duration : float
        s.
    """
    grains = chain.grains
    if not math.isfinite(energy) or grains < CUT.shortest:
        return 1, grains
    top, bottom = excitation.reach(chain)
    few = chain.contacts if grains <= FEW_GRAINS else None  # of many only some are looked at
    known = None if few is None else few.stiffness_at(few.overlap_bound(energy))
    away = 32
    while True:
        first, last = max(1, top - away), min(grains, bottom + away)
        if last - first + 1 > CUT.share * grains:
            return 1, grains
        if known is None:
            part = chain.part(first, last)
            contacts, masses = part.contacts, part.masses
            stiffness = contacts.stiffness_at(contacts.overlap_bound(energy))
        else:
            stiffness, masses = (
                known[first - (first == 1) : last + (last == grains)],
                chain.masses[first - 1 : last],
            )
        needed = _distance(2 * math.sqrt(float(stiffness.max()) / masses.min()) * duration)
        if needed <= away:
            return max(1, top - needed), min(grains, bottom + needed)
        away = max(needed, 2 * away)


def _distance(x: float) -> int:
    """Return d from which I_2d(x) <= (x/2)^2d / (2d)! exp(x^2 / (8d + 4)) is too small to be seen.

    The logarithm of that is concave where it falls: Newton's method ends beyond its root, never
    before.
    """
    d, log, square, further = max(8.0, x / 2), math.log(x / 2 + 1e-300), x * x, 1.0
    while abs(further) > 0.5 and d >= 8:
        seen = 2 * d * log - math.lgamma(2 * d + 1) + square / (8 * d + 4) - math.log(CUT.unseen)
        further = seen / (2 * (math.log(2 * d + 0.5) - log) + 8 * square / (8 * d + 4) ** 2)
        d += further
    return max(8, math.ceil(d)) + 2
