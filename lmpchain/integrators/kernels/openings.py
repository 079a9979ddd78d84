"""Shorter steps near contacts that open or close, compiled.

A method of order p requires a force with p time derivatives, but the force behaves like t^delta
near the opening or closing of a contact. If steps are proportional to the power 9/14 of the time to
the opening, all steps have equal errors, and the order is preserved.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ...util.arrays import Array
from .compiling import bits, inlined, number
from .layout import PAD
from .team import largest, share

# Number of contacts that are examined together, so that they fit into a few vector registers.
GROUP = 16


class Near(NamedTuple):
    """One kink of each contact; the contact nearest to opening or closing shortens the step.

    Attributes
    ----------
    inverse_length : (W,) array
        1 / distance of the overlap at rest from the kink, 1/m, see `layout.BatchArrays`.
    weight : (W,) array
        Squared effect on the motion of passing the kink.
    reach : (W,) array
        Number for the test in `_may_shorten`.
    rest : float
        Distance from the kink at rest, in units of the length.
    touching : bool
        Whether the top wall touches grain 1 without a force in a compressed chain.
    close : float
        Number for the test in `_may_shorten`.
    omega : float
        Highest frequency, rad/s.
    nearest : float
        Upper bound on the nearness, which is the inverse time to an opening over omega.
    """

    inverse_length: Array
    weight: Array
    reach: Array
    rest: float
    touching: bool
    close: float
    omega: float
    nearest: float


@inlined
def _score(gap, rate, bend, weight, omega, nearest):
    """Return the squared nearness of a contact to opening or closing, weighted by its effect.

    The overlap `gap` and its first and second derivatives in time, `rate` and `bend`, define a
    quadratic in time. The force behaves like t^(3/2) around the nearest root. A complex root, at
    which a contact almost opens, counts, too. At the time `distance` from the root, the local error
    of a step h is proportional to (h / distance)^7 distance^(5/2).
    """
    inside = rate * rate - 2.0 * gap * bend
    size = inside if inside > 0.0 else -inside
    root = math.sqrt(size)
    modulus = math.sqrt(rate * rate + size)
    # An open contact that separates has no root ahead.
    towards = abs(rate) if gap > 0.0 else rate
    fast = towards + root if inside > 0.0 else modulus
    comes = gap if gap > inside else inside
    fast = fast if comes > 0.0 else 0.0
    # Grains that touch at rest: the overlap grows like t^2, and they were never nearer than this.
    least = abs(bend) / (2.0 * omega * nearest)
    fast = least if fast < least and gap >= 0.0 else fast
    # Two roots that are closer to each other than to this time act like one double root.
    double = fast * fast / 32.0
    size = double if size < double else size
    root = math.sqrt(size)
    # The term 1e-300 makes the nearness of a zero overlap the upper bound, not NaN.
    near = fast / (2.0 * omega * (abs(gap) + 1e-300))
    near = near if near > 0.0 else 0.0
    near = near if near < nearest else nearest
    near2 = near * near
    near4 = near2 * near2
    return weight * (size * root) * (near4 * near4) * near


@inlined
def _may_shorten(y, rates, bends, inverse_length, rest, reach, close):
    """Return whether any of these contacts may be near enough to opening to shorten the step.

    A contact shortens the step if its score is at least shortened^14. In `_score`, fast^2 is at
    most q = 4 (rate^2 + |gap bend|), and `size` is at most q / 2. With the numbers
    reach = weight^(1/3) / (sqrt(2) (2 omega)^3) and close = shortened^(-14/3), the score is below
    this limit if q^2 reach close < |gap|^3. This test requires neither a root nor a quotient.
    """
    # Numbers are compared as bit patterns, see `window.watch`.
    largest = -1
    for n in range(reach.size):
        il = inverse_length[n]
        gap = abs(rest + (y[n] - y[n + 1]) * il)
        rate = (rates[n] - rates[n + 1]) * il
        bend = abs((bends[n] - bends[n + 1]) * il)
        q = 4.0 * (rate * rate + gap * bend)
        largest = max(bits(q * q * (close * reach[n]) - gap * gap * gap), largest)
    return largest >= 0


@inlined
def _find_nearness(y, rates, bends, near):
    """Return the largest score of all contacts between the bodies y; 0 if none is near."""
    # Numbers are compared as bit patterns, see `window.watch`.
    largest = 0
    size = near.weight.size
    for begin in range(0, size, GROUP):
        end = min(begin + GROUP, size)
        contacts = slice(begin, end)
        ends = slice(begin, end + 1)
        yt = y[ends]
        rt = rates[ends]
        bt = bends[ends]
        il = near.inverse_length[contacts]
        wt = near.weight[contacts]
        if not _may_shorten(yt, rt, bt, il, near.rest, near.reach[contacts], near.close):
            continue
        for n in range(il.size):
            gap = near.rest + (yt[n] - yt[n + 1]) * il[n]
            rate = (rt[n] - rt[n + 1]) * il[n]
            bend = (bt[n] - bt[n + 1]) * il[n]
            largest = max(bits(_score(gap, rate, bend, wt[n], near.omega, near.nearest)), largest)
    nearness = number(largest)
    # The overlap of a wall that only touches is the displacement itself.
    if near.touching:
        gap = y[0] - y[1]
        rate = rates[0] - rates[1]
        bend = bends[0] - bends[1]
        score = _score(gap, rate, bend, near.weight[0], near.omega, near.nearest)
        nearness = score if score > nearness else nearness
    return nearness


@inlined
def _find_ground_nearness(y, rates, bends, inverse_length, weight, omega, nearest):
    """Return the largest score of one kink of the force from the ground on all bodies y."""
    largest = 0.0
    for n in range(y.size):
        il = inverse_length[n]
        gap = 1.0 + y[n] * il
        score = _score(gap, rates[n] * il, bends[n] * il, weight[n], omega, nearest)
        largest = score if score > largest else largest
    return largest


@inlined
def _add_ground(ground, chain, grains, moving, nearest, nearness):
    """Return the largest score including the kinks of the force from the ground.

    If there is no ground, `ground` is None, and the code below is not compiled.
    """
    if ground is not None:
        for kink in range(chain.ground_kinks.shape[1]):
            inverse_length = chain.ground_kinks[0, kink, grains]
            weight = chain.ground_kinks[1, kink, grains]
            held = *moving, inverse_length, weight, chain.omega, nearest
            nearness = max(nearness, _find_ground_nearness(*held))
    return nearness


@inlined
def shorten(chain, y, w, pull, openings):
    """Return the factor on the scheduled step that the contact with the largest score requires.

    Parameters
    ----------
    chain : BatchMember
        Chain, with its window and the kinks of its contacts.
    y : (W,) array
        Displacements, m.
    w : (W,) array
        Velocities, m/s.
    pull : (W,) array
        Accelerations, m/s2.
    openings : layout.Shortening
        Parameters of the lengths of steps near openings.
    """
    first, last = share(chain)
    bodies = slice(first - 1, last + 1)
    near = slice(first - 1, last)
    nearest = openings.nearest[chain.schedule, chain.number]
    nearness = 0.0
    for kink in range(chain.opening_weight.shape[0]):
        contacts = Near(
            inverse_length=chain.opening_length[kink, near],
            weight=chain.opening_weight[kink, near],
            reach=chain.opening_reach[kink, near],
            rest=chain.opening_rest,
            touching=first == PAD and chain.links.uncompressed > 0.0,
            close=openings.close,
            omega=chain.omega,
            nearest=nearest,
        )
        nearness = max(nearness, _find_nearness(y[bodies], w[bodies], pull[bodies], contacts))
    grains = slice(first, last)
    moving = y[grains], w[grains], pull[grains]
    nearness = _add_ground(chain.ground, chain, grains, moving, nearest, nearness)
    nearness = largest(chain.team, nearness)
    # The step of constant local error is proportional to score^(-1/14).
    return min(1.0, openings.shortened * nearness ** (-1 / 14)) if nearness > 0.0 else 1.0
