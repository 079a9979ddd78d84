"""The error of an answer, from how far it is from companion runs at longer steps.

The estimate of the largest relative error of an answer at steps h is

    e = max(2 d12 / (g - 1),  b)                                 truncation
        + max(eps (2 + w(n) + 1.5 omega T), w(n) A)      round-off, as it is or amplified
        + 8 eps D x / v                                  and of reduced velocities

with b = 2 dn where a companion runs at 1.5 h, else b = d24 / (r2^p - r1^p). One companion alone,
at 2 h or h / 2, shows no rate: there the truncation error is 2 d12, or 2 d12 / (r1^p - 1) where
nothing opens and steps are equal. Where equal steps press contacts to far beyond their overlap at
rest, these began as good as open: a part of the error falls with h^2 alone, and with the share s of
d12 that follows from the gain, e is at least 2 d12 ((1 - s) / (r1^p - 1) + s / (r1^2 - 1)).

========  ==========  =========================================================================
symbol    variable    meaning
========  ==========  =========================================================================
d12       fine        distance of the answer from an auxiliary run at steps r1 h = 2 h, over the
                      largest motion
d24       coarse      distance of that run from one at steps r2 h = 4 h
dn        nearby      distance of the answer from one at 1.5 h, which runs where errors may scatter;
                      over 1.5^p - 1 if no contact opened
r1, r2    ratios      steps of the auxiliary runs over h
p         order       order that is trusted, see `AuxiliarySteps.truncation`
g         gain        error at steps r1 h over that at h, as observed:
                      (d24 / d12)^(ln r1 / ln(r2 / r1)), at most r1^p, and at least 1.5 for steps
                      of twice the length; g^(ln r / ln r1) where corners of a force cut steps, and
                      r, `least_ratio`, is the smallest ratio of steps between two corners
s         share       (r1^p - g) / (r1^p - r1^2), the part of d12 that falls with h^2, at most 1
eps       EPSILON     unit of the last place of 1
n, w(n)   rounding    evaluations of the force, and the last digits that they lose, sqrt(n), or
                      max(sqrt(n k), n / (8 k)) where contacts open, see `round_off`
k         flights     how far the fastest grain would fly, over the largest displacement
omega T   radians     phase of the fastest motion in the duration
A         amplified   what the scene makes of one last digit, see `amplification`; near the
                      tolerance, or with a given step if they exceed the truncation error, it and
                      the rounding of free flights are 2 times the distance of runs with the
                      steps of the answer that begin a last digit apart
========  ==========  =========================================================================

The estimate of a trajectory is e or 2, see `ErrorEstimate`. Step control uses e, however large.

Sources: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section II.4; the
observed rate is that of Roache, Annu. Rev. Fluid Mech. 29, 123 (1997).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Trust:
    """Trust in the differences between runs.

    Measured by analysis/calibration/richardson_estimate.py.

    Attributes
    ----------
    safety : float
        Factor on the extrapolated error, and on the distance from a companion at 1.5 h.
    least_gain : float
        Of steps of twice the length: differences that shrink by less show no order at all.
    settled : float
        Difference up to which two runs alone show the error: phases that are far off lose the
        order.
    """

    safety: float = 2.0
    least_gain: float = 1.5
    settled: float = 0.01


TRUST = Trust()


def estimate_truncation(
    distances: Sequence[float],
    ratios: Sequence[float],
    order: float,
    nearby: float = 0.0,
    settled: bool = False,
    slow_order: float = math.inf,
    least_ratio: float = 0.0,
) -> float:
    """Return the truncation error of an answer by Richardson's extrapolation at the observed rate.

    Parameters
    ----------
    distances : sequence of one or two float
        Relative distances d12 and d24, d12 alone where there is one companion.
    ratios : sequence of as many float
        Steps of these companions over that of the answer; below 1 for one at shorter steps.
    order : float
        That is trusted.
    nearby : float
        dn; 0 where there is no companion at 1.5 h.
    settled : bool
        Whether the force is a smooth function of time, so that the order is sure.
    slow_order : float
        Lowest order that a part of the error may have.
    least_ratio : float
        Ratio r of steps that the first companion has at least everywhere; 0: ratios[0].
    """
    fine = distances[0]
    if not math.isfinite(fine):
        # no rate follows from a companion that broke down
        return math.inf
    if len(distances) == 1:
        # the distance alone bounds the error at the longer steps, and no rate is seen; a companion
        # at shorter ones shows no order either
        gain = max(ratios[0] ** order, 2.0) if settled and fine <= TRUST.settled else 2.0
        return TRUST.safety * fine / (gain - 1)
    coarse = distances[1]
    first, second = ratios
    gain = observe_gain(fine, coarse, first, second, order)
    if 1 < least_ratio < first:
        gain **= math.log(least_ratio) / math.log(first)
    extrapolated = TRUST.safety * fine / (gain - 1)
    if slow_order < order and first > 1:
        steep = first**order
        flat = first**slow_order
        share = min((steep - gain) / (steep - flat), 1.0)
        mean = (1 - share) / (steep - 1) + share / (flat - 1)
        extrapolated = max(extrapolated, TRUST.safety * fine * mean)
    # one more companion confirms the rate; without it, the coarse difference alone is a bound, too
    bound = TRUST.safety * nearby if nearby > 0 else coarse / (second**order - first**order)
    return max(extrapolated, bound)


def observe_gain(fine: float, coarse: float, first: float, second: float, order: float) -> float:
    """Return the factor by which the error grows at steps `first` times as long, as observed."""
    doublings = math.log2(second / first)
    # from two differences that are both round-off, no rate above the order follows, nor one below 1
    rate = math.log2(max(coarse, 1e-300) / max(fine, 1e-300)) / doublings
    rate = min(max(rate, math.log2(TRUST.least_gain)), order)
    return first**rate
