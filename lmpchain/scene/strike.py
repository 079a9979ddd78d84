"""Strength of a strike: overlaps of the contacts at first, and whether Hertz's law holds there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..chain.chain import Chain
from ..chain.contacts import FEW_GRAINS
from ..chain.plausible import LIMITS, beyond_hertz
from ..util.arrays import Array
from .base import Excitation


class Surroundings(NamedTuple):
    """The grains that an excitation moves, with their neighbours.

    Attributes
    ----------
    first : int
        Number of the first of them in the whole chain.
    chain : Chain
        These grains alone.
    excitation : Excitation
        That of this chain.
    """

    first: int
    chain: Chain
    excitation: Excitation


class Squeeze(NamedTuple):
    """The contact that is squeezed most at first, and its overlap over the diameter."""

    contact: int
    compression: float


def first_overlaps(chain: Chain, excitation: Excitation) -> Array:
    """Return the largest overlap of every contact at t = 0 or in the first collision, (N+1,) m.

    Two bodies that approach with the relative velocity v, and nothing around them, come closer than
    at rest by r with ``K r^(delta+1) / (delta+1) = mu v^2 / 2``, mu their reduced mass.
    """
    contacts = chain.contacts
    displacement, velocity = excitation.initial(chain)
    # 0 of what does not give way: a driven grain, a held one, a wall
    inverse_mass = np.zeros(chain.grains + 2)
    moving = slice(excitation.driven, chain.movable)
    inverse_mass[1:-1][moving] = 1 / chain.masses[moving]
    closer = contacts.closer(displacement)
    approach = contacts.closer(excitation.largest(chain)[1])
    # what is driven goes both ways, and squeezes the contacts on either side of it in turn
    if excitation.does_work:
        closer = np.abs(closer)
        approach = np.abs(approach)
    approach = np.maximum(approach, 0.0)
    # grain 1 rests when the wall comes, or meets it
    if excitation.wall:
        approach[0] = excitation.wall.largest(1) + max(-velocity[0], 0.0)
    collision = contacts.collision_overlap(approach, inverse_mass[:-1] + inverse_mass[1:])
    return np.maximum(contacts.overlap + contacts.exists * closer, collision)


def strike_number(chain: Chain, excitation: Excitation) -> float:
    """Return the strength of a strike over what the contact below holds, `Scene.strike_number`."""
    contacts = chain.contacts
    loose = chain.loose_grains
    # of one grain, without arrays over all the others
    if excitation.strike_velocity and chain.compressed:
        n = excitation.grain  # type: ignore[attr-defined]
        if n <= loose:
            return np.inf
        omega = (contacts.stiffness[n] / chain.masses[n - 1]) ** 0.5
        return float(abs(excitation.strike_velocity) / (contacts.overlap[n] * omega))
    moving = slice(0, chain.movable)
    displacement, velocity = (np.abs(values[moving]) for values in excitation.largest(chain))
    # contacts that carry nothing at rest are as in the vacuum
    free = slice(0, loose if chain.compressed else None)
    if displacement[free].any() or velocity[free].any():
        return np.inf
    if not chain.compressed:
        return 0.0
    overlap = contacts.overlap[1:][moving][loose:]
    omega = np.sqrt(contacts.stiffness[1:][moving][loose:] / chain.masses[moving][loose:])
    shift = displacement[loose:] / overlap
    return float(max(shift.max(), (velocity[loose:] / (overlap * omega)).max()))


def surroundings(chain: Chain, excitation: Excitation) -> Surroundings:
    """Cut out the grains that an excitation moves, and their neighbours."""
    # all contacts of a short chain are known as soon as those of a piece of it
    if chain.grains <= FEW_GRAINS:
        return Surroundings(1, chain, excitation)
    top, bottom = excitation.reach(chain)
    first = chain.first_of_part(max(1, top - 1))
    last = min(chain.grains, bottom + 2)
    return Surroundings(first, chain.part(first, last), excitation.part(first, last))


def squeezed(around: Surroundings) -> Squeeze:
    """Return the contact that is squeezed most, and to what part of the diameter."""
    # a strike that is refused may be too strong for numbers
    with np.errstate(over="ignore"):
        overlaps = first_overlaps(around.chain, around.excitation)
        compression = overlaps / around.chain.contact_lengths
    worst = int(compression.argmax())
    return Squeeze(worst + around.first - 1, float(compression[worst]))


def strike_faults(excitation: Excitation, squeeze: Squeeze) -> Iterator[tuple[str, str]]:
    """Yield a fault if a contact is squeezed beyond the range of Hertz's law."""
    contact, compression = squeeze
    # a compression that is not a number is refused, too
    if not compression <= LIMITS.compression:
        than = f"of the diameter, more than {LIMITS.compression:g}: strike more gently"
        yield _strength(excitation), f"squeezes contact {contact} to {compression:.2g} {than}"


def strike_remarks(
    chain: Chain, excitation: Excitation, around: Surroundings, compression: float
) -> Iterator[str]:
    """Yield remarks on overlaps beyond Hertz's law, and on grains faster than sound in them."""
    limit = LIMITS.hertz_compression
    # a chain that is squeezed so at rest says it of itself
    if chain.law.power == 1.5 and compression > limit > chain.equilibrium.compression.max():
        yield f"{_strength(excitation)}: {beyond_hertz(compression)}"
    speed = np.abs(around.excitation.largest(around.chain)[1])
    sound = around.chain.by_grain("sound_speed")
    worst = int((speed / sound).argmax())
    if speed[worst] > sound[worst]:
        grain = f"grain {worst + around.first} moves at {speed[worst]:.3g} m/s"
        faster = f"faster than sound in its material, {sound[worst]:.3g} m/s"
        yield f"{_strength(excitation)}: {grain}, {faster}"


def _strength(excitation: Excitation) -> str:
    """Return the key that says how strong an excitation is, the one to blame."""
    return "kind" if excitation.does_work else excitation.strength[0]
