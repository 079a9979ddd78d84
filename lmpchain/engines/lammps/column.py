"""A scene in LAMMPS's terms: grain types, pair coefficients, diameters, heights and box."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...chain.chain import Chain
from ...errors import InputError
from ...scene.excitation import Impulse
from ...scene.scene import Scene
from ...util.arrays import Array

PAIR_STYLES = ("granular", "gran/hertz/history")
MOST_TYPES = 128
LOSSLESS = "0.0 tangential linear_nohistory 0.0 0.0 damping velocity"


@dataclass(frozen=True)
class Wall:
    """A plane above or below a grain, with the arguments of `fix wall/gran`."""

    name: str
    grain: int
    constant: float
    lo: str
    hi: str

    @property
    def contact(self) -> str:
        """Arguments of the contact model."""
        return f"{self.constant!r} {LOSSLESS}"


@dataclass(frozen=True)
class Column:
    """A scene in the terms of LAMMPS.

    Parameters
    ----------
    scene : Scene
    gauge : float
        Diameter to draw all grains with, m, or 0 for the physical ones. Only overlaps enter the
        force, and the round-off of a height is proportional to the height, so a gauge diameter of a
        few times the largest overlap of the run lowers the round-off of the run in proportion.
    pair_style : str
        One of `PAIR_STYLES`.
    remarks : tuple of str
        Lines for the head of the deck.
    template, include : str
        The user's own text in place of the deck, and in a place of it.

    Raises
    ------
    InputError
        If grain types cannot express the contact constants.
    """

    scene: Scene
    gauge: float
    pair_style: str = "granular"
    remarks: tuple[str, ...] = ()
    template: str = ""
    include: str = ""

    @property
    def chain(self) -> Chain:
        """The chain of the scene."""
        return self.scene.chain

    @property
    def model(self) -> str:
        """Contact model of LAMMPS: hertz, with the root of the effective radius, or hooke."""
        return "hooke" if self.chain.exponent == 1 else "hertz"

    @property
    def mobile(self) -> tuple[int, int]:
        """First and last grain that move by the equation of motion: not driven, not held."""
        return 1 + self.scene.excitation.driven, self.chain.movable

    @property
    def load(self) -> float:
        """Constant force on grain 1, N; 0 for a driven grain, and below a wall, which presses."""
        imposed = self.chain.top == "wall" or self.scene.excitation.driven
        return 0.0 if imposed else self.chain.top_load

    @property
    def strike(self) -> Impulse | None:
        """Impulse of the scene, which a deck keeps as a variable."""
        return self.scene.excitation if isinstance(self.scene.excitation, Impulse) else None

    @cached_property
    def diameters(self) -> Array:
        """(N,) m."""
        return np.full(self.chain.grains, self.gauge) if self.gauge else self.chain.diameters

    @cached_property
    def densities(self) -> Array:
        """(N,) kg/m3, such that every grain has its mass."""
        return self.chain.masses / (np.pi / 6 * self.diameters**3)

    @cached_property
    def heights(self) -> Array:
        """Heights at rest, (N,) m: the running sum in extended precision, rounded once."""
        # sums of many diameters in double precision would lose digits of the overlaps
        d = self.diameters.astype(np.longdouble)
        distances = (d[:-1] + d[1:]) / 2 - self.chain.equilibrium_overlap
        return np.append(0.0, -np.cumsum(distances)).astype(float)

    @cached_property
    def start(self) -> tuple[Array, Array]:
        """Heights and upward velocities at t = 0, (N,) m and m/s."""
        u, v = self.scene.initial()
        return self.heights - u, -v

    @cached_property
    def walls(self) -> list[Wall]:
        """The walls, as planes that stand still."""
        radius = self.diameters[[0, -1]] / 2
        gaps = radius - self.chain.contacts.overlap[[0, -1]]
        above, below = (self.heights[[0, -1]] + [1, -1] * gaps).tolist()
        scale = 1.0 if self.model == "hooke" else np.sqrt(radius)
        top, bottom = (self.chain.wall_constants / scale).tolist()
        walls = (
            Wall("top", 1, top, "NULL", repr(above)),
            Wall("bottom", self.chain.grains, bottom, repr(below), "NULL"),
        )
        return [wall for wall in walls if wall.constant > 0]

    @cached_property
    def skin(self) -> float:
        """Neighbour skin, m, within which each gap of the start lies."""
        z, _ = self.start
        gap = z[:-1] - z[1:] - (self.diameters[:-1] + self.diameters[1:]) / 2
        return float(0.3 * self.diameters.max() + gap.max(initial=0.0))

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Lower and upper bound in x and y, and in z, m."""
        z, _ = self.start
        # the box holds a grain and its skin; nothing moves sideways
        side = float(self.diameters.max() + self.skin)
        # no wider than the column, so that ranks share it evenly; grains may leave, for lists are
        # never renewed
        return -side, side, float(z.min() - side), float(z.max() + side)

    @cached_property
    def types(self) -> list[int]:
        """Type of every grain, from 1."""
        return self._types_and_constants[0]

    @cached_property
    def coefficients(self) -> list[str]:
        """Arguments of the pair_coeff commands."""
        if self.pair_style != "granular":
            return ["* *"]
        pairs = self._types_and_constants[1]
        lines = [f"* * {self.model} {next(iter(pairs.values()), 1.0)!r} {LOSSLESS}"]
        if len(pairs) > 1:
            lines += [
                f"{i} {j} {self.model} {value!r} {LOSSLESS}" for (i, j), value in pairs.items()
            ]
        return lines

    @property
    def style(self) -> str:
        """Argument of the pair_style command."""
        if self.pair_style == "granular":
            return "granular"
        return (
            f"{self.pair_style} {self._types_and_constants[1].get((1, 1), 1.0)!r} 0.0 0.0 0.0 0.0 0"
        )

    @cached_property
    def _types_and_constants(self) -> tuple[list[int], dict[tuple[int, int], float]]:
        """Types of the grains, and the constant of each pair of types that touches.

        A grain takes a type whose pair with the grain above has the right constant already; or else
        the type with most pairs still free; or a new one. N unlike contacts then need about sqrt(2
        N) types.
        """
        chain = self.chain
        constants = chain.contact_constants
        if self.model == "hertz":
            d = self.diameters
            # hertz multiplies by the root of the effective radius d1 d2 / (2 (d1 + d2))
            constants = constants / np.sqrt(d[:-1] * d[1:] / (d[:-1] + d[1:]) / 2)
        limit = MOST_TYPES if self.pair_style == "granular" else 1
        pairs: dict[tuple[int, int], float] = {}
        # of each type: the types it touches, and the constants
        partners: dict[int, dict[int, float]] = {1: {}}
        types = [1]
        for constant in constants.tolist():
            above = types[-1]
            equal = [
                grain_type
                for grain_type, value in partners[above].items()
                if abs(value - constant) <= 1e-14 * constant
            ]
            if equal:
                below = equal[0]
            else:
                free = (key for key in partners if key not in partners[above])
                below = min(free, key=lambda key: len(partners[key]), default=len(partners) + 1)
            if below > limit:
                cure = (
                    "the engine native" if limit > 1 else "pair_style granular or the engine native"
                )
                raise InputError.at(
                    "contact_constants",
                    f"contact {len(types)} differs from those above it, and {limit} grain type(s) "
                    f"cannot express that in pair_style {self.pair_style}; use {cure}",
                )
            partners.setdefault(below, {})
            partners[above].setdefault(below, constant)
            partners[below].setdefault(above, constant)
            pairs.setdefault((min(above, below), max(above, below)), constant)
            types.append(below)
        return types, pairs
