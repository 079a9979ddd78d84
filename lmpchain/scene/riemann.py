"""A step of velocity and compression at t = 0: the Riemann problem of the chain."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from ..chain.chain import Chain
from ..util.arrays import Array
from ..util.validation import Vector
from .base import Excitation, Number


class Riemann(Excitation):
    """A step of velocity and compression between two grains at t = 0, from which shocks develop.

    Shock waves and rarefactions propagate from the step to both sides. The ends of the chain are
    held or free and emit waves, too, so place the step far from them. Positions of grains are
    measured from the bottom, which does not move if the strain on the right is 0.

    Parameters
    ----------
    velocity : (left, right)
        Velocities of grains 1 ... grain, and of the grains below, m/s; "left" is towards grain 1.
    strain : (left, right)
        Additional overlap of contacts 1 ... grain, and of the contacts below, over the mean
        diameter of the two grains. Positive values are compression. Negative values beyond the
        overlap at rest over the diameter are gaps.
    grain : int
        Last grain on the left side; contact ``grain`` below it also belongs to the left side.

    Examples
    --------
    >>> chain = Chain(grains=6, diameter=1e-3, gravity=0, top_load=1)
    >>> step = Riemann(velocity=(0.1, 0), strain=(1e-4, 0), grain=2)
    >>> u, v = step.initial(chain)
    >>> u.round(9).tolist(), v.tolist()
    ([2e-07, 1e-07, 0.0, 0.0, 0.0, 0.0], [0.1, 0.1, 0.0, 0.0, 0.0, 0.0])
    """

    kind: ClassVar[str] = "riemann"
    of_chain: ClassVar[bool] = True
    strength: ClassVar[tuple[str, ...]] = ("velocity", "strain")
    velocity: Vector
    strain: Vector
    grain: Number

    def _faults(self) -> Iterator[tuple[str, str]]:
        for key in self.strength:
            count = len(getattr(self, key))
            if count != 2:
                yield key, f"must have two entries, left and right of the step, not {count}"

    def faults(self, chain: Chain, duration: float) -> Iterator[tuple[str, str]]:
        """Yield a fault if no grain is below the step, or if a held grain would move."""
        if self.grain >= chain.grains:
            below = f"the step is below this grain, and the chain has {chain.grains} grains"
            yield "grain", f"must be at most {chain.grains - 1}: {below}"
        elif chain.bottom == "fixed" and self.velocity[1]:
            yield "velocity", f"must be 0 on the right, where grain {chain.grains} is held"

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        left = np.arange(1, chain.grains + 1) <= self.grain
        velocity = np.where(left, self.velocity[0], self.velocity[1])
        strain = np.where(left, self.strain[0], self.strain[1])
        closer = strain * chain.contact_lengths[1:]
        # No contact exists below a held grain or below a free end.
        closer[-1] *= chain.bottom == "wall"
        return np.cumsum(closer[::-1])[::-1].copy(), velocity

    def reach(self, chain: Chain) -> tuple[int, int]:
        """Return grain 1, and the last grain that is displaced or moves."""
        return 1, chain.grains if self.strain[1] or self.velocity[1] else self.grain

    def part(self, first: int, last: int) -> Riemann:
        """Return the step renumbered within grains first ... last."""
        return self if first == 1 else self.replace(grain=self.grain - first + 1)
