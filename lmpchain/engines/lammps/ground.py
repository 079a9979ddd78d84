"""The force of the ground in LAMMPS: a spring, or a formula of the displacement.

If all grains have equal springs, `fix spring/self` is used, which pulls a grain back to its place
at the definition of the fix, and takes 7 % of the time of a step. Any other ground is an atom-style
variable for `fix addforce`, which takes 40 % or more of the time of a step. Both give the same bits
for the same spring. LAMMPS evaluates these forces at the end of a step or of a drift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...chain.formula import Formula, name
from ...chain.law import Law
from ...util.arrays import Array
from ...util.lazy import cached_property


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
