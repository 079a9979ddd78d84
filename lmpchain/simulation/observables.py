"""Quantities of a moving chain that can be averaged over time, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..chain import ground
from ..chain.chain import Chain
from ..chain.contact_law import Contacts
from ..errors import InputError, not_among, shown
from ..scene.recording import contact_of
from ..util.arrays import Array

# Quantities of the whole chain, and of one grain or contact, whose number follows a colon.
OF_CHAIN = ("kinetic_energy", "potential_energy", "temperature", "equipartition")
OF_GRAIN = ("kinetic_energy", "velocity", "displacement")
OF_CONTACT = ("force",)


class Observable(NamedTuple):
    """A quantity of a chain at one time.

    Attributes
    ----------
    unit : str
        Unit of the quantity; empty for a ratio.
    at_rest : float
        Value of the quantity for a chain at rest.
    measure : function
        Function of the displacements, (..., N) m, and velocities, (..., N) m/s, of all grains that
        returns the quantity, (...).
    """

    unit: str
    at_rest: float
    measure: Callable[[Array, Array], Array]


def observable(chain: Chain, name: object) -> Observable:
    """Return the quantity of this name.

    Raises
    ------
    InputError
        If there is no such quantity, grain or contact.
    """
    if not isinstance(name, str):
        raise InputError.at("quantities", f"must be names (got {shown(name)})")
    if name in OF_CHAIN:
        return _of_chain(chain, name)
    kind, colon, _ = name.partition(":")
    if not colon or kind not in (*OF_GRAIN, *OF_CONTACT):
        numbered = [f"{each}:10" for each in (*OF_GRAIN, *OF_CONTACT)]
        raise InputError.at("quantities", not_among(name, [*OF_CHAIN, *numbered]))
    number = contact_of(name)
    if kind in OF_CONTACT:
        existing = np.flatnonzero(chain.contacts.exists)
        if number is None or number not in existing:
            numbers = f"the contacts are numbered {existing[0]} to {existing[-1]}"
            raise InputError.at("quantities", f"{numbers} (got {name!r})")
        return _of_contact(chain, number)
    if number is None or not 1 <= number <= chain.movable:
        numbers = f"the grains that move are numbered 1 to {chain.movable}"
        raise InputError.at("quantities", f"{numbers} (got {name!r})")
    return _of_grain(chain, kind, number - 1)


def _of_chain(chain: Chain, name: str) -> Observable:
    movable = chain.movable
    half_masses = chain.masses / 2

    def kinetic(_: Array, v: Array) -> Array:
        energy: Array = v**2 @ half_masses
        return energy

    def potential(u: Array, _: Array) -> Array:
        energy: Array = chain.contacts.energy(Contacts.closer(u)).sum(-1)
        if chain.ground is not None:
            energy += ground.energy(chain.ground, u).sum(-1)
        return energy

    def temperature(u: Array, v: Array) -> Array:
        return 2 / movable * kinetic(u, v)

    def equipartition(_: Array, v: Array) -> Array:
        square = v**2 * half_masses
        total = square.sum(-1)
        # For a chain at rest, equipartition counts as perfect.
        moves = total > 0
        spread = (square**2).sum(-1) / np.where(moves, total, 1.0) ** 2
        return np.where(moves, (movable + 2) / 3 * spread, 1.0)

    return {
        "kinetic_energy": Observable("J", 0.0, kinetic),
        "potential_energy": Observable("J", 0.0, potential),
        "temperature": Observable("J", 0.0, temperature),
        "equipartition": Observable("", 0.0, equipartition),
    }[name]


def _of_grain(chain: Chain, name: str, row: int) -> Observable:
    half_mass = chain.masses[row] / 2
    return {
        "kinetic_energy": Observable("J", 0.0, lambda _, v: half_mass * v[..., row] ** 2),
        "velocity": Observable("m/s", 0.0, lambda _, v: v[..., row]),
        "displacement": Observable("m", 0.0, lambda u, _: u[..., row]),
    }[name]


def _of_contact(chain: Chain, number: int) -> Observable:
    contact = chain.contacts.of(number)

    def force(u: Array, _: Array) -> Array:
        above = u[..., number - 1] if number else 0.0
        below = u[..., number] if number < chain.grains else 0.0
        return contact.force_at(contact.overlap + (above - below))

    return Observable("N", float(contact.force), force)
