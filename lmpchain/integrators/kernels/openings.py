"""Shorter steps near contacts that open or close, compiled.

A method of order p needs p derivatives of the force, which goes like t^delta where a contact opens
or closes; steps that shorten like the distance to that time to the power 9/14 keep the error of
every step the same, and the order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ...util.arrays import Array
from .compiling import bits, inlined, number
from .layout import PAD
from .right_hand_side import slice_links
from .team import largest, share

# contacts that are looked at together: as many as a few vector registers hold
GROUP = 16


class Near(NamedTuple):
    """Contacts of a chain, of which the one nearest to opening or closing shortens the step.

    Attributes
    ----------
    weight, reach : (W,) arrays
        See `layout.BatchArrays`.
    close : float
        See `_may_matter`.
    omega : float
        Highest frequency, rad/s.
    nearest : float
        No step is shorter than where the inverse of the distance, over 2 omega, is this.
    """

    weight: Array
    reach: Array
    close: float
    omega: float
    nearest: float


@inlined
def _score(gap, rate, bend, weight, omega, nearest):
    """Return the squared nearness of a contact to opening or closing, weighed by its effect.

    For a contact with the overlap `gap` and its two rates, the force behaves like t^(3/2) around
    the time at which the overlap is 0; of a quadratic through them the nearest root counts, also a
    complex one (a contact that all but opens). The local error of a step h there goes as (h /
    distance)^7 distance^(5/2).
    """
    inside = rate * rate - 2.0 * gap * bend
    size = inside if inside > 0.0 else -inside
    root = math.sqrt(size)
    modulus = math.sqrt(rate * rate + size)
    # behind a contact that has just opened lies nothing
    towards = abs(rate) if gap > 0.0 else rate
    fast = towards + root if inside > 0.0 else modulus
    comes = gap if gap > inside else inside
    fast = fast if comes > 0.0 else 0.0
    # grains that touch at rest: the overlap grows like t^2, and they were never nearer than this
    least = abs(bend) / (2.0 * omega * nearest)
    fast = least if fast < least and gap >= 0.0 else fast
    # roots closer together than their distance act like one double root there
    double = fast * fast / 32.0
    size = double if size < double else size
    root = math.sqrt(size)
    # 1e-300: an overlap of nothing gives the nearest, not no number
    near = fast / (2.0 * omega * (abs(gap) + 1e-300))
    near = near if near > 0.0 else 0.0
    near = near if near < nearest else nearest
    near2 = near * near
    near4 = near2 * near2
    return weight * (size * root) * (near4 * near4) * near


@inlined
def _may_matter(y, rates, bends, links, reach, close):
    """Return whether any of these contacts may be so near to opening that it shortens the step.

    That is so from a score of shortened^14 on. In `_score` fast^2 is at most q and `size` at most q
    / 2, so that no root and no quotient is needed: with reach = weight^(1/3) / (sqrt(2) (2
    omega)^3) and close = shortened^(-14/3) no score is as large while q^2 reach close < |gap|^3.
    """
    # as bits, see `window.watch`
    largest = -1
    for n in range(reach.size):
        il = links.inverse_length[n]
        gap = abs(links.precompressed + (y[n] - y[n + 1]) * il)
        rate = (rates[n] - rates[n + 1]) * il
        bend = abs((bends[n] - bends[n + 1]) * il)
        q = 4.0 * (rate * rate + gap * bend)
        largest = max(bits(q * q * (close * reach[n]) - gap * gap * gap), largest)
    return largest >= 0


@inlined
def _find_nearness(y, rates, bends, links, near):
    """Return the largest score of all contacts between the bodies y; 0 if none is near."""
    # as bits, too
    largest = 0
    size = near.weight.size
    for begin in range(0, size, GROUP):
        end = min(begin + GROUP, size)
        contacts = slice(begin, end)
        ends = slice(begin, end + 1)
        yt = y[ends]
        rt = rates[ends]
        bt = bends[ends]
        il = links.inverse_length[contacts]
        wt = near.weight[contacts]
        if not _may_matter(
            yt, rt, bt, slice_links(links, contacts, 0.0), near.reach[contacts], near.close
        ):
            continue
        for n in range(il.size):
            gap = links.precompressed + (yt[n] - yt[n + 1]) * il[n]
            rate = (rt[n] - rt[n + 1]) * il[n]
            bend = (bt[n] - bt[n + 1]) * il[n]
            largest = max(bits(_score(gap, rate, bend, wt[n], near.omega, near.nearest)), largest)
    nearness = number(largest)
    # a wall that only touches, whose overlap is the displacement itself
    if links.uncompressed > 0.0:
        gap = y[0] - y[1]
        rate = rates[0] - rates[1]
        bend = bends[0] - bends[1]
        score = _score(gap, rate, bend, near.weight[0], near.omega, near.nearest)
        nearness = score if score > nearness else nearness
    return nearness


@inlined
def shorten(chain, y, w, pull, openings):
    """Return the next step over that of the schedule, for the contact that matters most.

    Parameters
    ----------
    y, w, pull : (W,) arrays
        Displacements, velocities and accelerations.
    openings : `layout.Shortening`
    """
    first, last = share(chain)
    bodies = slice(first - 1, last + 1)
    near = slice(first - 1, last)
    touches = chain.links.uncompressed if first == PAD else 0.0
    links = slice_links(chain.links, near, touches)
    contacts = Near(
        weight=chain.opening_weight[near],
        reach=chain.opening_reach[near],
        close=openings.close,
        omega=chain.omega,
        nearest=openings.nearest[chain.schedule, chain.number],
    )
    nearness = _find_nearness(y[bodies], w[bodies], pull[bodies], links, contacts)
    nearness = largest(chain.team, nearness)
    # the score goes as the 14th power of how much shorter the step must be for the same error
    return min(1.0, openings.shortened * nearness ** (-1 / 14)) if nearness > 0.0 else 1.0
