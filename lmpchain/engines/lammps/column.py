"""A scene in LAMMPS's terms: grain types, pair coefficients, diameters, heights and box."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...chain import Chain
from ...errors import InputError
from ...excitation import Impulse
from ...fields import Array
from ...scene import Scene

PAIR_STYLES = ("granular", "gran/hertz/history")
MOST_TYPES = 128
HEADROOM = 3.0  # gauge diameter over the largest overlap: grain n + 2 is never touched


@dataclass(frozen=True)
class Column:
    """What LAMMPS is told about a scene.

    Parameters
    ----------
    scene : Scene
    gauge : bool
        Whether to draw the grains with the gauge diameter: a few times the largest overlap of the
        run instead of the physical diameter. Only overlaps enter the force, and the round-off of a
        height is proportional to the height, so this lowers the round-off of the run in proportion.
    pair_style : str
        One of `PAIR_STYLES`.
    remarks : tuple of str
        Lines for the head of the deck.

    Raises
    ------
    InputError
        If grain types cannot express the contact constants.
    """

    scene: Scene
    gauge: bool
    pair_style: str = "granular"
    remarks: tuple[str, ...] = ()

    @property
    def chain(self) -> Chain:
        """The chain of the scene."""
        return self.scene.chain

    @property
    def strike(self) -> Impulse | None:
        """The impulse, which a deck keeps as a variable."""
        return self.scene.excitation if isinstance(self.scene.excitation, Impulse) else None

    @cached_property
    def largest_overlap(self) -> float:
        """A bound on every overlap of the run, m."""
        return float(self.chain.contacts.overlap_bound(self.scene.energy).max())

    @cached_property
    def diameters(self) -> Array:
        """(N,) m."""
        physical = self.chain.diameters
        gauge = HEADROOM * self.largest_overlap
        return np.full(self.chain.grains, gauge) if self.gauge and 0 < gauge < physical.min() else physical

    @cached_property
    def densities(self) -> Array:
        """(N,) kg/m3, such that every grain has its mass."""
        return self.chain.masses / (np.pi / 6 * self.diameters**3)

    @cached_property
    def heights(self) -> Array:
        """Heights at rest, (N,) m: the running sum in extended precision, rounded once."""
        d = self.diameters.astype(np.longdouble)
        apart = (d[:-1] + d[1:]) / 2 - self.chain.equilibrium_overlap
        return np.append(0.0, -np.cumsum(apart)).astype(float)

    @cached_property
    def start(self) -> tuple[Array, Array]:
        """Heights and upward velocities at t = 0, (N,) m and m/s."""
        u, v = self.scene.initial()
        return self.heights - u, -v

    @cached_property
    def skin(self) -> float:
        """Neighbour skin, m: every gap of the start lies within it."""
        z, _ = self.start
        gap = z[:-1] - z[1:] - (self.diameters[:-1] + self.diameters[1:]) / 2
        return float(0.3 * self.diameters.max() + max(gap.max(), 0.0))

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Lower and upper bound in x and y, and in z, m."""
        z, _ = self.start
        side = float(self.diameters.max() + self.skin)
        return -side, side, float(z.min() - 5 * side), float(z.max() + 100 * side)

    @cached_property
    def types(self) -> list[int]:
        """Type of every grain, from 1."""
        return self._typed[0]

    @cached_property
    def coefficients(self) -> list[str]:
        """Arguments of the pair_coeff commands."""
        if self.pair_style != "granular":
            return ["* *"]
        model = "hooke" if self.chain.exponent == 1 else "hertz"
        pairs = self._typed[1]
        tail = "0.0 tangential linear_nohistory 0.0 0.0 damping velocity"
        lines = [f"* * {model} {next(iter(pairs.values()))!r} {tail}"]
        if len(pairs) > 1:
            lines += [f"{i} {j} {model} {value!r} {tail}" for (i, j), value in pairs.items()]
        return lines

    @property
    def style(self) -> str:
        """Argument of the pair_style command."""
        if self.pair_style == "granular":
            return "granular"
        return f"{self.pair_style} {self._typed[1][1, 1]!r} 0.0 0.0 0.0 0.0 0"

    @cached_property
    def _typed(self) -> tuple[list[int], dict[tuple[int, int], float]]:
        """Types of the grains, and the constant that LAMMPS needs for every pair of types that touches.

        A grain takes a type whose pair with the grain above has the right constant already; or else the
        type with most pairs still free; or a new one. N unlike contacts then need about sqrt(2 N) types.
        """
        chain = self.chain
        constants = chain.contact_constants
        if chain.exponent != 1:  # hertz multiplies by the square root of the effective radius
            d = self.diameters
            constants = constants / np.sqrt(d[:-1] * d[1:] / (d[:-1] + d[1:]) / 2)
        most = MOST_TYPES if self.pair_style == "granular" else 1
        pairs: dict[tuple[int, int], float] = {}
        partners: dict[int, dict[int, float]] = {1: {}}  # of each type: the types it touches, and the constants
        types = [1]
        for constant in constants.tolist():
            above = types[-1]
            known = (t for t, value in partners[above].items() if abs(value - constant) <= 1e-14 * constant)
            free = (t for t in partners if t not in partners[above])
            below = next(known, None) or min(free, key=lambda t: len(partners[t]), default=len(partners) + 1)
            if below > most:
                cure = "the engine native" if most > 1 else "pair_style granular or the engine native"
                raise InputError(
                    [
                        (
                            "contact_constants",
                            f"contact {len(types)} differs from those above it, and {most} grain type(s) cannot "
                            f"express that in pair_style {self.pair_style}; use {cure}",
                        )
                    ]
                )
            partners.setdefault(below, {})
            partners[above].setdefault(below, constant)
            partners[below].setdefault(above, constant)
            pairs.setdefault((min(above, below), max(above, below)), constant)
            types.append(below)
        return types, pairs
