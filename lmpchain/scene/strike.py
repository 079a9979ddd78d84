"""How hard an excitation squeezes the contacts at first, and whether Hertz's law holds there."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..chain.chain import Chain
from ..chain.contacts import FEW_GRAINS
from ..chain.plausible import LIMITS, beyond_hertz
from ..util.arrays import Array
from .base import Excitation


def first_overlaps(chain: Chain, excitation: Excitation) -> Array:
    """Return the largest overlap of every contact at t = 0 or in the first collision, (N+1,) m.

    Two bodies that approach with the relative velocity v, and nothing around them, come closer than
    at rest by r with ``K r^(delta+1) / (delta+1) = mu v^2 / 2``, mu their reduced mass.
    """
    contacts = chain.contacts
    displacement, velocity = excitation.initial(chain)
    inverse_mass = np.zeros(chain.grains + 2)  # 0 of what does not give way: driven, held, a wall
    moving = slice(excitation.driven, chain.movable)
    inverse_mass[1:-1][moving] = 1 / chain.masses[moving]
    closer = contacts.closer(displacement)
    approach = contacts.closer(excitation.largest(chain)[1])
    if excitation.does_work:  # either way
        closer = np.abs(closer)
        approach = np.abs(approach)
    approach = np.maximum(approach, 0.0)
    if excitation.wall:  # grain 1 rests when the wall comes, or meets it
        approach[0] = excitation.wall.largest(1) + max(-velocity[0], 0.0)
    collision = contacts.collision_overlap(approach, inverse_mass[:-1] + inverse_mass[1:])
    return np.maximum(contacts.overlap + contacts.exists * closer, collision)


def strike_number(chain: Chain, excitation: Excitation) -> float:
    """Return `Scene.strike_number` of a chain that is struck so."""
    contacts = chain.contacts
    if excitation.strike_velocity and chain.compressed:  # of one grain
        n = excitation.grain  # type: ignore[attr-defined]
        omega = (contacts.stiffness[n] / chain.masses[n - 1]) ** 0.5
        return float(abs(excitation.strike_velocity) / (contacts.overlap[n] * omega))
    moving = slice(0, chain.movable)
    displacement, velocity = (np.abs(values[moving]) for values in excitation.largest(chain))
    if not chain.compressed:
        return np.inf if displacement.any() or velocity.any() else 0.0
    overlap = contacts.overlap[1:][moving]
    omega = np.sqrt(contacts.stiffness[1:][moving] / chain.masses[moving])
    return float(max((displacement / overlap).max(), (velocity / (overlap * omega)).max()))


def surroundings(chain: Chain, excitation: Excitation) -> tuple[int, Chain, Excitation]:
    """Cut out the grains that an excitation moves, and their neighbours.

    Returns ------- the number of the first of these grains, these grains as a chain, and the
    excitation of that chain; a chain of few grains, of which all contacts are known as soon, as a
    whole
    """
    if chain.grains <= FEW_GRAINS:
        return 1, chain, excitation
    first, last = excitation.reach(chain)
    first, last = max(1, first - 1), min(chain.grains, last + 2)
    return first, chain.part(first, last), excitation.part(first, last)


def squeezed(first: int, near: Chain, strike: Excitation) -> tuple[int, float]:
    """Return the contact that is squeezed most, and to what part of the diameter."""
    with np.errstate(over="ignore"):  # of a strike that is refused
        relative = first_overlaps(near, strike) / near.contact_lengths
    worst = int(relative.argmax())
    return worst + first - 1, float(relative[worst])


def strike_faults(
    excitation: Excitation, contact: int, relative: float
) -> Iterator[tuple[str, str]]:
    """Yield a fault if a contact is squeezed beyond the range of Hertz's law."""
    if not relative <= LIMITS.compression:
        than = f"of the diameter, more than {LIMITS.compression:g}: strike more gently"
        yield _strength(excitation), f"squeezes contact {contact} to {relative:.2g} {than}"


def strike_remarks(
    chain: Chain, excitation: Excitation, around: tuple[int, Chain, Excitation], relative: float
) -> Iterator[str]:
    """Yield what is hardly meant: overlaps beyond Hertz's law, grains faster than sound in them."""
    limit = LIMITS.hertz_compression
    if chain.exponent == 1.5 and relative > limit > chain.equilibrium.compression.max():
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
