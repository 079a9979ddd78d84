"""How hard an excitation squeezes the contacts at first, and whether Hertz's law holds there."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..chain.chain import LARGEST_OVERLAP, Chain
from ..chain.contacts import FEW, Contacts
from ..chain.plausible import HERTZ_OVERLAP, beyond_hertz
from ..util.arrays import Array
from .base import Excitation


def first_overlaps(chain: Chain, excitation: Excitation) -> Array:
    """Return the largest overlap of every contact at t = 0 or in the first collision, (N+1,) m.

    Two bodies that approach with the relative velocity v, and nothing around them, come closer than at rest by r with
    ``K r^(delta+1) / (delta+1) = mu v^2 / 2``, mu their reduced mass.
    """
    return overlaps_of(chain, excitation, chain.contacts, chain.masses)


def overlaps_of(chain: Chain, excitation: Excitation, contacts: Contacts, masses: Array) -> Array:
    """Return the same, (..., N+1) m, for contacts and masses (..., N) kg of chains like this."""
    (u, begun), (_, v) = excitation.initial(chain), excitation.largest(chain)
    inverse_mass = 1 / masses
    inverse_mass[..., : excitation.driven] = 0.0  # what is driven does not give way,
    inverse_mass[..., chain.movable :] = 0.0  # nor does what is held, or a wall
    edge = np.zeros((*masses.shape[:-1], 1))
    inverse_mass = np.concatenate((edge, inverse_mass, edge), axis=-1)
    closer, approach = contacts.closer(u), contacts.closer(v)
    if excitation.does_work:  # either way
        closer, approach = np.abs(closer), np.abs(approach)
    approach = np.maximum(approach, 0.0)
    if excitation.wall:  # grain 1 rests when the wall comes, or meets it
        approach[..., 0] = excitation.wall.largest(1) + max(-begun[0], 0.0)
    collision = contacts.collision_overlap(approach, inverse_mass[..., :-1] + inverse_mass[..., 1:])
    return np.maximum(contacts.overlap + contacts.exists * closer, collision)


def pair_frequency(contacts: Contacts, masses: Array, overlaps: Array) -> Array:
    """Return the frequency of the lightest grains with the stiffest contact, (...) rad/s."""
    return np.asarray(np.sqrt(2 * contacts.stiffness_at(overlaps).max(-1) / masses.min(-1)))


def strike_number(chain: Chain, excitation: Excitation, contacts: Contacts, masses: Array) -> Array:
    """Return `Scene.strike_number`, (...), for contacts and masses (..., N) kg of chains like this."""
    if excitation.strike_velocity and chain.compressed:  # of one grain
        n = excitation.grain  # type: ignore[attr-defined]
        omega = (contacts.stiffness.T[n] / masses.T[n - 1]) ** 0.5
        return abs(excitation.strike_velocity) / (contacts.overlap.T[n] * omega)
    moving = slice(0, chain.movable)
    u, v = (np.abs(x[moving]) for x in excitation.largest(chain))
    if not chain.compressed:
        return np.full(masses.shape[:-1], np.inf if u.any() or v.any() else 0.0)
    eps, stiffness = (x[..., 1:][..., moving] for x in (contacts.overlap, contacts.stiffness))
    omega = np.sqrt(stiffness / masses[..., moving])
    return np.asarray(np.maximum((u / eps).max(-1), (v / (eps * omega)).max(-1)))


def surroundings(chain: Chain, excitation: Excitation) -> tuple[int, Chain, Excitation]:
    """Cut out the grains that an excitation moves and their neighbours, all that it acts on at first.

    Returns
    -------
    the number of the first of these grains, these grains as a chain, and the excitation of that chain; a chain of few
    grains, of which all contacts are known as soon, as a whole
    """
    if chain.grains <= FEW:
        return 1, chain, excitation
    first, last = excitation.reach(chain)
    first, last = max(1, first - 1), min(chain.grains, last + 2)
    return first, chain.part(first, last), excitation.part(first, last)


def squeezed(first: int, near: Chain, strike: Excitation) -> tuple[int, float]:
    """Return the contact in these surroundings that is squeezed most, and to what part of the diameter."""
    with np.errstate(over="ignore"):  # of a strike that is refused
        relative = first_overlaps(near, strike) / near.contact_lengths
    worst = int(relative.argmax())
    return worst + first - 1, float(relative[worst])


def strike_faults(
    excitation: Excitation, contact: int, relative: float
) -> Iterator[tuple[str, str]]:
    """Yield a fault if a contact is squeezed beyond the range of Hertz's law."""
    if not relative <= LARGEST_OVERLAP:
        yield (
            _strength(excitation),
            f"squeezes contact {contact} to {relative:.2g} of the diameter, more than {LARGEST_OVERLAP:g}: strike more "
            "gently",
        )


def strike_remarks(
    chain: Chain, excitation: Excitation, around: tuple[int, Chain, Excitation], relative: float
) -> Iterator[str]:
    """Yield what is hardly meant: overlaps beyond Hertz's law, grains faster than sound in them."""
    at_rest = (
        float((chain.contacts.overlap / chain.contact_lengths).max())
        if relative > HERTZ_OVERLAP
        else 0.0
    )
    if chain.exponent == 1.5 and at_rest < HERTZ_OVERLAP < relative:
        yield f"{_strength(excitation)}: {beyond_hertz(relative)}"
    first, near, strike = around
    speed, sound = np.abs(strike.largest(near)[1]), near.by_grain("sound_speed")
    worst = int((speed / sound).argmax())
    if speed[worst] > sound[worst]:
        yield (
            f"{_strength(excitation)}: grain {worst + first} moves at {speed[worst]:.3g} m/s, faster than sound "
            f"in its material, {sound[worst]:.3g} m/s"
        )


def _strength(excitation: Excitation) -> str:
    return "kind" if excitation.does_work else excitation.strength[0]
