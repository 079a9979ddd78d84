"""Chains upside down, so that engines only need to drive the upper end of a chain."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..util.arrays import Array, read_only
from ..util.validation import make_unchecked, with_derived
from .chain import Chain
from .contacts import Contacts
from .damping import Damping
from .equilibrium import Equilibrium
from .law import Law


def turn_upside_down(chain: Chain) -> Chain:
    """Return the chain in reverse order, with the forces at rest that its contacts have.

    The reversed chain has the motion of the given chain with opposite signs, because the motion
    around rest depends on the forces at rest and not on gravity itself. A held last grain becomes a
    free first grain, whose motion a drive must prescribe.

    Parameters
    ----------
    chain : Chain
        A chain without a ground and without grains that only touch.
    """
    rest = chain.equilibrium
    constant, force, overlap, stiffness = (_reverse(values) for values in rest.contacts.arrays)
    lengths, diameters, masses = (
        _reverse(values) for values in (rest.contact_lengths, rest.diameters, rest.masses)
    )
    fields: dict[str, Any] = {
        "grains": chain.grains,
        "diameter": diameters,
        "gravity": chain.gravity,
        "exponent": chain.given_exponent,
        "top_load": chain.top_load,
        "top": "wall" if chain.bottom == "wall" else "free",
        "bottom": chain.top,
        "masses": masses,
        "contact_constants": constant[1:-1],
        "wall_constants": constant[[0, -1]],
        "damping": Damping(
            viscoelastic=_reverse(chain.damping.viscoelastic), drag=_reverse(chain.damping.drag)
        ),
    }
    law = chain.given_law
    if isinstance(law, Law):
        per_contact = {key: value for key, value in law.given.items() if isinstance(value, tuple)}
        fields["law"] = law.replace(**{key: value[::-1] for key, value in per_contact.items()})
    turned = make_unchecked(Chain, **fields)
    contacts = Contacts(turned.contact_law, constant, force, overlap, stiffness)
    return with_derived(turned, equilibrium=Equilibrium(contacts, lengths, diameters, masses))


def _reverse(values: Any) -> Any:
    """Return an array in reverse order, or the one number that all share."""
    if not isinstance(values, np.ndarray):
        return values
    turned: Array = values[::-1].copy()
    return read_only(turned)
