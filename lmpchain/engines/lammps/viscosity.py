"""Viscous forces of contacts by formula, and forces of the ground, as variables of a deck.

LAMMPS has no pair or bond style with damping by formula. Neighbouring grains are therefore chunks
of two: "odd" ones of grains 1 and 2, 3 and 4, ..., and "even" ones of grains 2 and 3, 4 and 5, ...
Their sums over displacements and velocities, with a minus for even grains, are changes of overlaps
and the rates of these. Steps take 1.4 times as long for 100 grains, 7 times for 10,000.

If all grains have equal ground springs, `fix spring/self` is used, which pulls a grain back to its
place at the definition of the fix, and takes 7 % of the time of a step. Any other ground is an
atom-style variable for `fix addforce`, which takes 40 % or more of the time of a step. Both give
the same bits for the same spring. LAMMPS evaluates these forces at the end of a step or of a drift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...chain.chain import Chain
from ...chain.formula import Formula, add, name, negative
from ...chain.law import Law
from ...util.arrays import Array
from ...util.lazy import cached_property

# Key of the viscosity A among the parameters of a formula, whose names contain no space.
RELAXATION = "relaxation time"


@dataclass(frozen=True)
class LammpsViscosity:
    """The viscosity of contacts by formula in the terms of LAMMPS.

    Parameters
    ----------
    chain : Chain
    wall_moves : bool
        Whether the top wall moves.
    """

    chain: Chain
    wall_moves: bool

    @cached_property
    def _values(self) -> dict[str, Array]:
        """Viscosity A, s, and for the stiffness: overlap o at rest, m, constants, (N+1,) each."""
        assert isinstance(self.chain.law, Law)
        contacts = self.chain.contacts
        law = self.chain.law.with_walls(self.chain.grains)
        viscosity = np.where(contacts.exists, self.chain.contact_viscosity, 0.0)
        constants = zip(law.names, law.parameters, strict=True)
        values = {"k": contacts.constant, **dict(constants)}
        # A missing wall has the stiffness of the next contact, which has a value.
        numbers = np.arange(viscosity.size)
        near = np.clip(numbers, *np.flatnonzero(contacts.exists)[[0, -1]])
        used = {key: values[key] for key in self._slope.names if key != "o"}
        return {RELAXATION: viscosity, "o": contacts.overlap[near]} | {
            key: np.broadcast_to(value, numbers.shape)[near] for key, value in used.items()
        }

    @cached_property
    def _slope(self) -> Formula:
        """The stiffness of a contact."""
        assert isinstance(self.chain.law, Law)
        return self.chain.law.formula.derivative("o")

    @property
    def own(self) -> dict[str, Array]:
        """The values of the contacts of each grain, (N,) each, by their names in LAMMPS."""
        n = np.arange(self.chain.grains) + 1
        contacts = {"odd": n - 1 + n % 2, "even": n - n % 2}
        return {
            f"d_{pair}{number}": values[contacts[pair]]
            for pair in contacts
            for number, values in enumerate(self._values.values())
        }

    @property
    def force(self) -> str:
        """The upward force on a grain, N, in variables of LAMMPS."""
        return f"v_side*({self._part('odd')}+{self._part('even')})"

    def _part(self, pair: str) -> str:
        """Return the part of a chunk of two in the force on its upper, odd grain."""
        change, rate = (f"c_of_{pair}[{column}]" for column in (1, 2))
        if pair == "even" and self.wall_moves:
            # The wall has no chunk: it is above grain 1, which is alone in the first even one.
            change, rate = f"({change}+(id==1)*v_wall_z)", f"({rate}+(id==1)*v_wall_vz)"
        places = {key: name(f"d_{pair}{number}") for number, key in enumerate(self._values)}
        grown = name(change) if pair == "odd" else negative(name(change))
        values = places | {"o": add(places["o"], grown)}
        return f"{places[RELAXATION].text}*({self._slope.substitute(values).lammps})*{rate}"


@dataclass(frozen=True)
class LammpsGround:
    """A ground in the terms of LAMMPS.

    Parameters
    ----------
    law : Law
    rests : bool
        Whether all grains are at their rest positions at t = 0.
    """

    law: Law
    rests: bool

    @property
    def own(self) -> dict[str, Array]:
        """The parameters that differ from grain to grain, (N,) each, by their names in LAMMPS."""
        own = (key for key, value in self.law.given.items() if isinstance(value, tuple))
        return {f"d_own{n}": np.array(self.law.given[key]) for n, key in enumerate(own, 1)}

    @cached_property
    def spring(self) -> float:
        """Stiffness of `fix spring/self`, N/m; 0 if that is another force."""
        stiffness = self.law.formula.derivative("u").substitute(self._values).number
        return stiffness if self.rests and stiffness and stiffness > 0 else 0.0

    @property
    def pull(self) -> str:
        """The upward force on a grain, N, in variables of LAMMPS."""
        # Displacements are positive downward, so a restoring force is upward.
        values = self._values | {"u": name("v_phi"), "t": name("v_now")}
        return self.law.formula.substitute(values).lammps

    @cached_property
    def _values(self) -> dict[str, Formula | float]:
        """The parameters: a number, or the name of a property of each grain."""
        names = iter(self.own)
        return {
            key: name(next(names)) if isinstance(value, tuple) else value
            for key, value in self.law.given.items()
        }
