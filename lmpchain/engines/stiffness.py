"""How fast a scene can make grains oscillate and how far it strains contacts, which bounds every step."""

from __future__ import annotations

import math

import numpy as np

from ..excitation import first_overlaps
from ..scene import Scene

GENTLE = 0.3  # strain below which no contact comes near to opening


def stiffest_frequency(scene: Scene) -> float:
    """Return the highest frequency that the scene can excite, rad/s.

    The band edge of the chain at rest, that of two grains pressed together by the strike, or that of a drive.
    """
    chain = scene.chain
    pressed = first_overlaps(chain, scene.excitation)
    stiffness = chain.exponent * chain.contacts.constant * pressed ** (chain.exponent - 1)
    pair = math.sqrt(2 * float(stiffness.max()) / chain.masses.min())
    return max(chain.band_edge, pair, scene.drive.fastest if scene.drive else 0.0) or 1 / scene.duration


def largest_strain(scene: Scene) -> float:
    """Return a bound on |r / length| of every contact, rigorous while it is small; infinite where there is none."""
    contacts = scene.chain.contacts
    if not (contacts.pressed == contacts.exists).all():
        return np.inf
    pressed = contacts.overlap[contacts.pressed]
    closer = contacts.overlap_bound(scene.energy)[contacts.pressed] - pressed
    return float((closer / pressed).max()) * 1.05  # an opening contact is a little softer
