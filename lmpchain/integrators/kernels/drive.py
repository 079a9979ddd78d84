"""The imposed motion of grain 1, compiled."""

from __future__ import annotations

import math

import numpy as np

from .contact_forces import compiled


@compiled
def place(chain, t, order):
    """Return displacement (order 0) or speed (order 1) of the driven grain at time t; a sine, or pieces of cubics.

    `chain.drive` holds amplitude, frequency in rad/s and the number of knots, 0 for a sine.
    """
    drive, pieces = chain.drive, chain.pieces
    count = int(drive[2])
    if count == 0:
        return drive[0] * math.sin(drive[1] * t) if order == 0 else drive[0] * drive[1] * math.cos(drive[1] * t)
    piece = min(max(np.searchsorted(chain.knots[:count], t, "right") - 1, 0), count - 2)
    s = t - chain.knots[piece]
    a, b, c, d = pieces[0, piece], pieces[1, piece], pieces[2, piece], pieces[3, piece]
    return ((a * s + b) * s + c) * s + d if order == 0 else (3 * a * s + 2 * b) * s + c


@compiled
def ahead(chain, t, end, resolution):
    """Return the time to the next knot of the imposed motion, if that clearly comes before `end`, else infinity."""
    count, knots = int(chain.drive[2]), chain.knots
    if count > 0:
        following = np.searchsorted(knots[:count], t + resolution, "right")
        if following < count and knots[following] < end - resolution:
            return knots[following] - t
    return 1e300
