"""Shocks, dispersive shocks and rarefactions of a uniform chain in the long-wave limit.

Over lengths of many grains the chain obeys ``m v_t = -F_x`` and ``R_t = -v_x`` with the overlap R
and the force ``F = K R^delta``. These are the equations of a gas with the speed of sound
``c(R) = (delta K R^(delta-1) / m)^(1/2)``, in grains per second. In a wave that travels in one
direction ``v - J(R)`` is constant, with ``J = 2 c R / (delta + 1)``. Positions are grain numbers.

Where such a wave would break, a dispersive shock forms in a lossless chain: a spreading train of
waves with a solitary wave at its leading edge and linear waves at its trailing edge. The speeds of
both edges follow from the dispersion ``w = 2 c sin(k/2)`` of the lattice by El's fitting method
(Chaos 15, 037103 (2005)), which is based on Whitham's modulation equations. With a ahead of the
shock and b behind it, they are

    trailing  2 c_a - c_b,    leading  2 c_a sinh(q/2) / q  with  cosh(q/4)^2 = c_b / c_a.

If ``c_b > 2 c_a``, no trailing edge leaves the piston. For Toda's force, (exp(beta R) - 1) / beta,
the speeds are exact. For weak waves, c_b = c_a (1 + a), they tend to the speeds of the Korteweg-de
Vries equation (Gurevich and Pitaevskii, Sov. Phys. JETP 38, 291 (1974)), c_a (1 + 2a/3) and
c_a (1 - a), with a leading wave twice as high as the jump.

Grains that are pulled away faster than J(R_a) separate, and their contacts have the overlap 0. The
trailing edge of this rarefaction does not move, because open contacts transmit no force.
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

    All methods raise `InputError` for an overlap that is negative, because open contacts have the
    overlap 0, or not finite.

    Attributes
    ----------
    exponent : float
        Exponent delta of the contact force.
    constant : float
        Contact constant K, N/m^delta.
    mass : float
        Mass of a grain, kg.

    Raises
    ------
    InputError
        If the exponent is not above 1, or if constant or mass is not above 0.

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

        Grains cannot follow a piston whose velocity is below v_a - J(R_a), with the velocity v_a
        and the overlap R_a ahead. They then fly at this velocity, and their contacts are open.
        """
        slowest = ahead.velocity - self.invariant(ahead.overlap)
        return State(max(velocity, slowest), self.overlap_at(velocity - slowest))

    def between(self, left: State, right: State) -> State:
        """Return the state between the simple or dispersive waves that a step emits to both sides.

        The velocity is NaN if the contacts open, because the two sides then fly apart at different
        velocities.
        """
        above = left.velocity + self.invariant(left.overlap)
        below = right.velocity - self.invariant(right.overlap)
        velocity = (above + below) / 2 if above >= below else np.nan
        return State(velocity, self.overlap_at((above - below) / 2))

    def rankine_hugoniot(self, ahead: State, velocity: float) -> tuple[State, float]:
        """Return the state behind a steady shock, and the shock speed, grains/s.

        The conservation of mass and momentum, ``V (R_b - R_a) = v_b - v_a`` and ``m V (v_b - v_a) =
        F_b - F_a``, determines both, whatever mechanism makes the shock steady.

        Raises
        ------
        InputError
            If the velocity behind does not exceed the velocity ahead.
        """
        jump = velocity - ahead.velocity
        require(
            ("velocity", np.isfinite(jump), "must be finite, as the velocity ahead"),
            ("velocity", jump > 0, "must exceed the velocity ahead: otherwise there is no shock"),
        )

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

        If contacts open (overlap 0), the trailing edge stays where the rarefaction began.
        """
        expands = overlap <= ahead.overlap
        rule = "must not exceed the overlap ahead: otherwise there is no rarefaction"
        require(("overlap", expands, rule))
        height = overlap - ahead.overlap
        return Edges(self.sound(ahead.overlap), self.sound(overlap), height)

    def dispersive(self, ahead: State, overlap: float) -> Edges:
        """Return the edges of a dispersive shock by El's fitting, with the exact solitary wave.

        The height is that of the solitary wave with the leading speed (`soliton.solve`). It is NaN
        without a load, and if the wave is too slow for `solve`. The trailing speed is NaN if no
        trailing edge forms.
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

        Burgers's equation gives ``8 nu / (c_b - c_a)`` with ``nu = A c_a^2 / 2``. The viscosity A
        is the viscoelastic time of `Damping`, s.
        """
        rule = "must exceed the overlap ahead: otherwise there is no shock"
        require(("overlap", overlap > ahead.overlap, rule))
        sound = self.sound(ahead.overlap)
        return 4 * viscosity * sound**2 / (self.sound(overlap) - sound)


def _require_overlap(overlap: float) -> None:
    """Raise `InputError` for infinite overlaps, and negative ones, whose powers are complex."""
    message = f"must be 0 or more (got {shown(overlap)}): an open contact has the overlap 0"
    require(("overlap", 0 <= overlap < np.inf, message))


def _require_compression(ahead: State, overlap: float) -> None:
    """Raise `InputError` if a dispersive shock would have to expand the chain."""
    compressed = overlap >= ahead.overlap
    rule = "must not be below the overlap ahead: otherwise there is no shock"
    require(("overlap", compressed, rule))


def _solitary_speed(cosh: float) -> float:
    """Return sinh(q/2) / (q/2) for a value of cosh(q/2)."""
    half = np.arccosh(cosh)
    return float(np.sinh(half) / half) if half else 1.0


def _above_zero(speed: float) -> float:
    return speed if speed > 0 else np.nan
