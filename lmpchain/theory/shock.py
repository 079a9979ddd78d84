"""Shocks, dispersive shocks and rarefactions of a uniform chain in the long-wave limit.

Over many grains ``m v_t = -F_x, R_t = -v_x`` with the overlap R and ``F = K R^delta``: a gas whose
sound has the speed ``c(R) = (delta K R^(delta-1) / m)^(1/2)``, grains a second, and whose waves
that travel one way keep ``v - J(R)``, ``J = 2 c R / (delta + 1)``. Places are counted in grains,
which waves do not carry along. Where such a wave would break, a lossless chain makes a train of
solitary waves that spreads: it ends, behind, in linear waves, and begins with a solitary wave. By
El's fitting (Chaos 15, 037103 (2005)), which Whitham's modulation equations imply, the dispersion
``w = 2 c sin(k/2)`` of the lattice gives both edges in closed form, a ahead and b behind,

    trailing  2 c_a - c_b,    leading  2 c_a sinh(q/2) / q  with  cosh(q/4)^2 = c_b / c_a;

behind ``c_b > 2 c_a`` no trailing edge leaves the piston. Grains that are pulled away faster than
J(R_a) part: their contacts are open, their overlap is 0, and so is the speed of the trailing edge
of that rarefaction, because no force passes an open contact. For Toda's force, (exp(beta R) - 1) /
beta, they are exact. For weak waves, c_b = c_a (1 + a), they tend to those of Korteweg and de Vries
(Gurevich and Pitaevskii, Sov. Phys. JETP 38, 291 (1974)), c_a (1 + 2a/3) and c_a (1 - a), with a
leading wave twice as high as the jump.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from ..errors import InputError, shown
from ..util.lazy import listed
from .domain import require
from .soliton import SLOWEST, solve

__dir__ = listed(__name__)


class State(NamedTuple):
    """A uniform state of the chain: velocity, m/s, and overlap of its contacts, m.

    The overlap of open contacts is 0, however wide their gaps are.
    """

    velocity: float
    overlap: float


class Edges(NamedTuple):
    """Edges of a wave: speeds, grains/s, and the additional overlap in the leading crest, m."""

    leading: float
    trailing: float
    height: float


@dataclass(frozen=True)
class Medium:
    """A uniform chain in analogy to a gas.

    All methods raise `InputError` for a negative overlap: that of an open contact is 0.

    Attributes
    ----------
    exponent : float
        delta.
    constant : float
        K, N/m^delta.
    mass : float
        Mass of a grain, kg.

    Raises
    ------
    InputError
        Unless the exponent is above 1, and constant and mass are above 0.

    Examples
    --------
    >>> gas = Medium(exponent=1.5, constant=1.0, mass=1.5)
    >>> rest = State(0.0, 1.0)
    >>> gas.sound(1.0), round(gas.behind(rest, 0.1).overlap, 6)
    (1.0, 1.098809)
    >>> edges = gas.dispersive(rest, gas.behind(rest, 0.1).overlap)
    >>> [round(speed, 6) for speed in edges[:2]]
    [1.015841, 0.976164]
    """

    exponent: float
    constant: float
    mass: float

    def __post_init__(self) -> None:
        faults = []
        if not self.exponent > 1:
            faults.append(("exponent", "must be above 1: linear waves make no shocks"))
        faults += [
            (key, "must be above 0") for key in ("constant", "mass") if not getattr(self, key) > 0
        ]
        if faults:
            raise InputError(faults)

    def force(self, overlap: float) -> float:
        """Return the force of a contact, N."""
        _require_overlap(overlap)
        return self.constant * overlap**self.exponent

    def sound(self, overlap: float) -> float:
        """Return the speed of sound, grains/s."""
        _require_overlap(overlap)
        slope = self.exponent * self.constant * overlap ** (self.exponent - 1)
        return float(np.sqrt(slope / self.mass))

    def invariant(self, overlap: float) -> float:
        """Return J, m/s: the velocity behind a simple wave into a chain without overlap."""
        return 2 / (self.exponent + 1) * self.sound(overlap) * overlap

    def overlap_at(self, invariant: float) -> float:
        """Return the overlap at which J has this value, m; 0 for open contacts."""
        power = 2 / (self.exponent + 1)
        return float((max(invariant, 0.0) / self.invariant(1.0)) ** power)

    def behind(self, ahead: State, velocity: float) -> State:
        """Return the state behind a simple or dispersive wave that a piston drives.

        Grains cannot follow a piston that withdraws faster than the velocity ahead less J. They fly
        at that velocity, and their contacts are open.
        """
        slowest = ahead.velocity - self.invariant(ahead.overlap)
        return State(max(velocity, slowest), self.overlap_at(velocity - slowest))

    def between(self, left: State, right: State) -> State:
        """Return the state between the simple or dispersive waves that a step emits to both sides.

        The velocity is NaN if the contacts open: both sides fly apart, each as `behind` says.
        """
        above = left.velocity + self.invariant(left.overlap)
        below = right.velocity - self.invariant(right.overlap)
        velocity = (above + below) / 2 if above >= below else np.nan
        return State(velocity, self.overlap_at((above - below) / 2))

    def rankine_hugoniot(self, ahead: State, velocity: float) -> tuple[State, float]:
        """Return the state behind a steady shock, and the shock speed, grains/s.

        Mass and momentum are conserved: ``V (R_b - R_a) = v_b - v_a``, ``m V (v_b - v_a) = F_b -
        F_a``, whatever makes the shock steady.

        Raises
        ------
        InputError
            Unless the velocity behind exceeds that ahead: nothing is compressed.
        """
        jump = velocity - ahead.velocity
        require(("velocity", jump > 0, "must exceed that ahead, or there is no shock"))

        def excess(overlap: float) -> float:
            rise = self.force(overlap) - self.force(ahead.overlap)
            return (overlap - ahead.overlap) * rise / self.mass - jump**2

        # Upper bound: K R^(delta+1) = m v^2 in a vacuum; a load reduces the jump.
        power = 1 / (self.exponent + 1)
        jump_in_vacuum = float((self.mass * jump**2 / self.constant) ** power)
        low = ahead.overlap
        overlap = brentq(excess, low, low + 2 * jump_in_vacuum, xtol=1e-300, rtol=1e-15)
        return State(velocity, overlap), jump / (overlap - ahead.overlap)

    def rarefaction(self, ahead: State, overlap: float) -> Edges:
        """Return the edges of a rarefaction, which are the sound speeds ahead and behind.

        The trailing edge of a rarefaction that opens contacts, overlap 0, stays where it began.
        """
        expands = overlap <= ahead.overlap
        require(("overlap", expands, "must not exceed that ahead, or there is no rarefaction"))
        height = overlap - ahead.overlap
        return Edges(self.sound(ahead.overlap), self.sound(overlap), height)

    def dispersive(self, ahead: State, overlap: float) -> Edges:
        """Return the edges of a dispersive shock by El's fitting, with the exact solitary wave.

        The height is that of the solitary wave of this speed, by `soliton.solve`; NaN where it is
        too slow for that, and without a load. The trailing speed is NaN where no edge forms.
        """
        _require_compression(ahead, overlap)
        sound = self.sound(ahead.overlap)
        behind = self.sound(overlap)
        if sound == 0:
            return Edges(np.nan, np.nan, np.nan)
        leading = _solitary_speed(2 * behind / sound - 1)
        height = np.nan
        if self.exponent > 1 and leading > SLOWEST:
            height = ahead.overlap * float(solve(self.exponent, speed=leading).overlap(0.0))
        return Edges(sound * leading, _above_zero(2 * sound - behind), height)

    def toda(self, ahead: State, overlap: float) -> Edges:
        """Return the exact edges in a Toda chain with equal first two terms of the force."""
        _require_compression(ahead, overlap)
        sound = self.sound(ahead.overlap)
        if sound == 0:
            return Edges(np.nan, np.nan, np.nan)
        length = ahead.overlap / (self.exponent - 1)
        ratio = float(np.exp((overlap - ahead.overlap) / (2 * length)))
        leading = sound * _solitary_speed(2 * ratio - 1)
        return Edges(leading, _above_zero(sound * (2 - ratio)), 2 * length * np.log(2 * ratio - 1))

    def kdv(self, ahead: State, overlap: float) -> Edges:
        """Return the edges by the Korteweg-de Vries equation, for weak waves."""
        _require_compression(ahead, overlap)
        sound = self.sound(ahead.overlap)
        if sound == 0:
            return Edges(np.nan, np.nan, np.nan)
        jump = overlap - ahead.overlap
        excess = (self.exponent - 1) / 2 * jump / ahead.overlap
        trailing = _above_zero(sound * (1 - excess))
        return Edges(sound * (1 + 2 * excess / 3), trailing, 2 * jump)

    def thickness(self, ahead: State, overlap: float, viscosity: float) -> float:
        """Return the jump over the steepest slope of a weak viscous shock, grains.

        Burgers's: ``8 nu / (c_b - c_a)`` with ``nu = A c_a^2 / 2``, A the time of `Damping`, s.
        """
        rule = "must exceed that ahead, or there is no shock"
        require(("overlap", overlap > ahead.overlap, rule))
        sound = self.sound(ahead.overlap)
        return 4 * viscosity * sound**2 / (self.sound(overlap) - sound)


def _require_overlap(overlap: float) -> None:
    """Raise `InputError` for negative overlaps, whose powers would be complex."""
    message = f"must be 0 or more (got {shown(overlap)}): an open contact has the overlap 0"
    require(("overlap", overlap >= 0, message))


def _require_compression(ahead: State, overlap: float) -> None:
    """Raise `InputError` if a dispersive shock would have to expand the chain."""
    compressed = overlap >= ahead.overlap
    require(("overlap", compressed, "must not be below that ahead, or there is no shock"))


def _solitary_speed(cosh: float) -> float:
    """Return sinh(q/2) / (q/2) for a value of cosh(q/2)."""
    half = np.arccosh(cosh)
    return float(np.sinh(half) / half) if half else 1.0


def _above_zero(speed: float) -> float:
    return speed if speed > 0 else np.nan
