"""The light cone: the grains that a wave can have reached; all others are at rest."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..chain.chain import Chain
from ..chain.contacts import FEW_GRAINS
from .base import Excitation


@dataclass(frozen=True)
class Cut:
    """Limits of the cut of a chain to the grains that the wave can have reached.

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
    energy above rest; a driven chain has no such bound, and the light cone is all of it. A drag
    leaves the bound as it is; with viscous contacts it is that of `_damped_distance`.

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
    # the stiffest contact within reach decides how far that is: look further until it suffices
    reach = 32
    while True:
        first = chain.first_of_part(max(1, top - reach))
        last = min(grains, bottom + reach)
        if last - first + 1 > CUT.share * grains:
            return 1, grains
        omega = _fastest(chain, first, last, energy)
        viscosity = chain.damping.longest_time
        if viscosity > 0:
            needed = _damped_distance(omega * viscosity, omega * duration)
        else:
            needed = _distance(2 * omega * duration)
        if needed <= reach:
            return chain.first_of_part(max(1, top - needed)), min(grains, bottom + needed)
        reach = max(needed, 2 * reach)


def _fastest(chain: Chain, first: int, last: int, energy: float) -> float:
    """Bound sqrt(k_max / m_min), rad/s, of grains first ... last with this energy above rest, J."""
    if chain.grains <= FEW_GRAINS:
        stiffness = chain.contacts.stiffness_bound(chain.contacts.overlap_bound(energy))
        # contacts between these grains, and those with the walls of the chain
        stiffness = stiffness[first - (first == 1) : last + (last == chain.grains)]
        masses = chain.masses[first - 1 : last]
    else:
        # the arrays of a long chain take long: those of the piece suffice
        piece = chain.part(first, last)
        stiffness = piece.contacts.stiffness_bound(piece.contacts.overlap_bound(energy))
        masses = piece.masses
    return math.sqrt(float(stiffness.max()) / masses.min())


def _distance(x: float) -> int:
    """Return d from which I_2d(x) <= (x/2)^2d / (2d)! exp(x^2 / (8d + 4)) is too small to be seen.

    The logarithm of that is concave where it falls: Newton's method ends beyond its root, never
    before.
    """
    d = max(8.0, x / 2)
    log = math.log(x / 2 + 1e-300)
    square = x * x
    correction = 1.0
    while abs(correction) > 0.5 and d >= 8:
        excess = 2 * d * log - math.lgamma(2 * d + 1) + square / (8 * d + 4) - math.log(CUT.unseen)
        # the derivative of log (2d)! is nearly 2 log(2d + 1/2)
        slope = 2 * (math.log(2 * d + 0.5) - log) + 8 * square / (8 * d + 4) ** 2
        correction = excess / slope
        d += correction
    return max(8, math.ceil(d)) + 2


def _damped_distance(viscosity: float, time: float) -> int:
    """Return d from which no displacement behind viscous contacts is large enough to be seen.

    Springs k (1 + A d/dt) between masses m pass on at most what follows from x'' = (k/m) (1 + A
    d/dt) (x_(n-1) + 2 x_n + x_(n+1)), whose terms are all positive. Its Laplace transform falls by
    the factor q a grain, with q + 1/q + 2 = s^2 / (k/m) / (1 + A s), so that no more than s exp(s
    t) q^d arrives over d grains, for any s at which q < 1 exists.

    Parameters
    ----------
    viscosity, time : float
        A and t in units of sqrt(m / k).
    """
    rates = np.geomspace(2.0, 1e6, 400)
    # q + 1/q - 2, which is above 0 where the transform falls
    excess = rates**2 / (1 + viscosity * rates) - 4
    falls = excess > 0
    rates = rates[falls]
    exponent = rates * time + np.log(rates) - math.log(CUT.unseen)
    needed = exponent / np.arccosh(1 + excess[falls] / 2)
    return max(8, math.ceil(float(needed.min(initial=2.0**31)))) + 2
