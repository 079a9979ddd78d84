"""Dissipation: viscoelastic contacts and drag, and the coefficient of restitution of two spheres.

A closed contact with the overlap o exerts the force ``K (1 + A d/dt) o^delta`` (Kuwabara and Kono,
Jpn. J. Appl. Phys. 26, 1230, 1987; Brilliantov et al., Phys. Rev. E 53, 5382, 1996), and drag
exerts the force ``-m gamma v`` on a grain. Instead of v, the methods integrate the reduced velocity

    w = v - b(x) + gamma x,    b_n = (A_(n-1) F_(n-1) - A_n F_n) / m_n,

where F_n are the elastic forces alone. Then no force depends on a velocity:

    x' = w + b(x) - gamma x,    w' = (F_(n-1) - F_n) / m_n + g.

The viscous force of a law by formula is A dF/dt at every overlap, so that it also acts in an open
contact that pulls.

========  =============  ===============================================
symbol    variable       meaning
========  =============  ===============================================
A         viscoelastic   relaxation time of a contact, s
gamma     drag           decay rate of the velocity of a single grain, 1/s
w         reduced        the velocity that the method integrates, m/s
b         creep          contribution of viscosity to the velocity, m/s
========  =============  ===============================================
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from pydantic import BeforeValidator

from ..errors import InputError, shown
from ..util.arrays import Array, read_only
from ..util.lazy import cached_property
from ..util.validation import Checked, check_positive, non_negative
from .contact_law import Contacts, pair_value, power_law
from .materials import Material, one_material, sphere_mass

# Relative error of a step of the rebound; the sum over all steps stays below 1e-12.
COLLISION_ERROR = 1e-13
# Above this ratio of A to the collision time, two spheres practically stick together.
STICKS = 1e6

Rates = Annotated[float | Array, BeforeValidator(non_negative)]


class Damping(Checked):
    """Dissipation of a chain: viscoelastic contacts and a drag on its grains.

    A closed contact exerts the force ``K (1 + A d/dt) o^delta``, and drag exerts ``-m gamma v`` on
    a grain. Other dissipation (plasticity, adhesion, friction, rotation) is not modelled.

    Parameters
    ----------
    viscoelastic : float or (N-1,) array
        Relaxation time A of all contacts, or of each contact between grains, from the top, s. A
        wall contact has the value of the adjacent contact.
    drag : float or (N,) array
        Decay rate gamma of all grains or of each grain, 1/s.

    Raises
    ------
    InputError
        If a value is negative or not finite.

    Examples
    --------
    >>> Damping(viscoelastic=2e-8)
    Damping(viscoelastic=2e-08)
    """

    viscoelastic: Rates = 0.0
    drag: Rates = 0.0

    @cached_property
    def acts(self) -> bool:
        """Whether there is any dissipation."""
        return bool(np.any(self.viscoelastic) or np.any(self.drag))

    @cached_property
    def longest_time(self) -> float:
        """The largest A of all contacts, s."""
        return float(np.max(self.viscoelastic))

    @cached_property
    def largest_drag(self) -> float:
        """The largest gamma of all grains, 1/s."""
        return float(np.max(self.drag))

    def decay_rate(self, omega: float) -> float:
        """Return A omega^2 + gamma, the rate at which the energy of a motion decays, 1/s."""
        return self.longest_time * omega**2 + self.largest_drag

    def fastest_rate(self, omega: float) -> float:
        """Return the larger of omega and its decay rate A omega^2 + gamma, 1/s.

        The larger one limits the steps of explicit methods.
        """
        return max(omega, self.decay_rate(omega))

    def decay(self, omega: float, time: float) -> float:
        """Return (A omega^2 + gamma) t / 2, the exponent of the decay of a motion in time t, s."""
        return self.decay_rate(omega) * time / 2

    def effect(self, omega: float, duration: float) -> float:
        """Return an estimate of the relative change of a solution by damping, at most 1.

        In linear theory, relative to the largest damped motion, the change is exp(x) - 1 with
        x = (A omega^2 + gamma) T / 2: in the time T a mode of frequency omega decays by the factor
        exp(-x), and all slower modes decay less. At a change of 1, the lossless solution is
        unrelated to the damped one. If contacts open, frequencies depend on amplitudes, and phases
        in long runs deviate sooner.

        Parameters
        ----------
        omega : float
            The highest frequency of the undamped motion, rad/s.
        duration : float
            Duration T, s.

        Examples
        --------
        >>> round(Damping(viscoelastic=1e-9, drag=10.0).effect(omega=1e6, duration=1e-4), 6)
        0.051797
        """
        # A change of more than a factor of 2 counts as a change of 100 %.
        return math.expm1(min(self.decay(omega, duration), math.log(2.0)))

    def misfits(self, grains: int) -> Iterator[tuple[str, str]]:
        """Yield faults of arrays whose length does not match this number of grains."""
        for key, values, length in (
            ("viscoelastic", self.viscoelastic, grains - 1),
            ("drag", self.drag, grains),
        ):
            if isinstance(values, np.ndarray) and len(values) != length:
                cure = f"one number, or {length} for {grains} grains"
                yield f"damping.{key}", f"must be {cure}, not {len(values)}"

    def part(self, first: int, last: int) -> Damping:
        """Return the damping of grains first ... last."""
        return Damping(
            viscoelastic=_cut(self.viscoelastic, first, last - 1), drag=_cut(self.drag, first, last)
        )

    def times(self, grains: int) -> Array:
        """Return A of every contact of a chain, wall contacts included, (N+1,) s."""
        between = np.broadcast_to(self.viscoelastic, grains - 1 or 1)
        return read_only(np.concatenate((between[:1], between, between[-1:]))[: grains + 1])

    def rates(self, grains: int) -> Array:
        """Return gamma of every grain, (N,) 1/s."""
        return read_only(np.array(np.broadcast_to(self.drag, grains)))

    @classmethod
    def from_restitution(
        cls,
        restitution: float,
        velocity: float,
        material: Material | str,
        diameter: float,
        exponent: float = 1.5,
    ) -> Self:
        """Return the damping that gives two equal spheres this coefficient of restitution.

        Parameters
        ----------
        restitution : float
            Relative velocity after the collision divided by the relative velocity before it, above
            0, at most 1.
        velocity : float
            Relative velocity before the collision, m/s.
        material : Material or name
            Material of both spheres.
        diameter : float
            Diameter of both spheres, m.
        exponent : float
            Exponent delta of the contact force.

        Raises
        ------
        InputError
            If a number is out of its range, or if no viscosity gives this restitution.

        Examples
        --------
        >>> damping = Damping.from_restitution(0.93, velocity=0.3, material="steel", diameter=1e-2)
        >>> f"{damping.viscoelastic:.3g} s"
        '5.24e-07 s'
        """
        limits = "above 0, at most 1"
        if check_positive("restitution", restitution, limits) > 1:
            raise InputError.at("restitution", f"must be {limits} (got {shown(restitution)})")
        for key, value in (("velocity", velocity), ("diameter", diameter)):
            check_positive(key, value, "a finite number above 0")
        exponent = check_exponent(exponent)
        try:
            sphere = one_material(material)
        except ValueError as error:
            raise InputError.at("material", str(error)) from None
        pair = two_spheres([sphere] * 2, [diameter] * 2, exponent)
        viscosity = viscosity_of(float(restitution), exponent)
        return cls(viscoelastic=viscosity * pair.time(velocity))


def check_exponent(exponent: Any) -> float:
    """Return the exponent of a contact force; raise `InputError` unless it is finite and from 1."""
    if check_positive("exponent", exponent, "1 or more") < 1:
        raise InputError.at("exponent", f"must be 1 or more (got {shown(exponent)})")
    return float(exponent)


def viscous_force(contacts: Contacts, viscosity: Array, overlap: Array, closing: Array) -> Array:
    """Return the viscous force A dF/dt = A k(o) o' of contacts, (..., C) N.

    Parameters
    ----------
    contacts : Contacts
    viscosity : (C,) array
        Relaxation time A of each contact, s.
    overlap, closing : (..., C) arrays
        Overlap o, m; its rate of change o', m/s.
    """
    if contacts.law.power is None:
        # The stiffness of a law by formula is 0 in an open contact, unless the contact pulls.
        return np.asarray(viscosity * contacts.stiffness_at(overlap) * closing)
    # An open contact exerts no viscous force.
    stiffness = contacts.stiffness_at(np.maximum(overlap, 0.0))
    return np.where(overlap > 0, viscosity * stiffness * closing, 0.0)


def _cut(values: float | Array, first: int, last: int) -> float | Array:
    """Return the values numbered first ... last, or the value that all share."""
    return values[first - 1 : last] if isinstance(values, np.ndarray) else values


class Pair(NamedTuple):
    """Two colliding bodies: constant of their contact, N/m^delta, reduced mass, kg, and delta."""

    constant: float
    mass: float
    exponent: float

    def time(self, velocity: float) -> float:
        """Return the unit of time of a collision at a velocity v, s: (m v^2 / K)^(1/(delta+1)) / v.

        A collision lasts about 3 units.
        """
        # The square of a tiny velocity would underflow.
        power = self.exponent + 1
        return (self.mass / self.constant) ** (1 / power) * velocity ** (2 / power - 1)


def two_spheres(materials: Sequence[Material], diameters: Sequence[float], exponent: float) -> Pair:
    """Return the colliding pair of two spheres with these materials and diameters, m."""
    modulus = pair_value(np.array([material.plane_strain_modulus for material in materials]))
    radius = pair_value(np.array(diameters) / 2)
    densities = np.array([material.density for material in materials])
    mass = pair_value(sphere_mass(densities, np.array(diameters)))
    length = sum(diameters) / 2
    constant = power_law(exponent).constant(float(modulus[0]), float(radius[0]), length)
    return Pair(constant, float(mass[0]), exponent)


@lru_cache(maxsize=1024)
def rebound(viscosity: float, exponent: float) -> float:
    """Return the restitution of two bodies for A in units of `Pair.time`; 0 if they stick.

    The equations y' = w - A y^delta, w' = -y^delta are integrated from y = 0, w = 1 until y returns
    to 0. The coefficient is the final value of -w, with an error of about 1e-12.
    """
    from scipy.integrate import solve_ivp

    if viscosity == 0:
        return 1.0
    if exponent == 1:
        ratio = viscosity / 2
        if ratio >= 1:
            return 0.0
        return math.exp(-math.pi * ratio / math.sqrt(1 - ratio**2))

    def move(_: float, state: Array) -> tuple[float, float]:
        force = max(state[0], 0.0) ** exponent
        return state[1] - viscosity * force, -force

    def parts(_: float, state: Array) -> float:
        return state[0]

    parts.terminal = True  # type: ignore[attr-defined]
    parts.direction = -1  # type: ignore[attr-defined]
    options: dict[str, Any] = {"rtol": COLLISION_ERROR, "atol": 1e-3 * COLLISION_ERROR}
    # A strong viscosity makes the equation stiff, so that an implicit method is faster.
    method = "DOP853" if viscosity < 100 else "Radau"
    run = solve_ivp(move, (0.0, STICKS), (0.0, 1.0), method=method, events=parts, **options)
    return max(-float(run.y[1, -1]), 0.0)


def viscosity_of(restitution: float, exponent: float) -> float:
    """Return A, in units of `Pair.time`, for a coefficient of restitution in 0 ... 1."""
    from scipy.optimize import brentq

    if restitution == 1:
        return 0.0
    if exponent == 1:
        decay = -math.log(restitution) / math.pi
        return 2 * decay / math.sqrt(1 + decay**2)
    highest = 1.0
    while rebound(highest, exponent) > restitution:
        highest *= 2
        if highest > STICKS:
            raise InputError.at("restitution", f"is too close to 0 (got {restitution:g})")
    root = brentq(lambda a: rebound(a, exponent) - restitution, 0.0, highest, xtol=1e-15)
    return float(root)


def _damping(value: Any) -> Damping:
    if isinstance(value, Damping):
        return value
    if isinstance(value, dict):
        return Damping(**value)
    cure = "give lmpchain.Damping(viscoelastic=..., drag=...), or a table with these keys"
    raise ValueError(f"must be a Damping (got {shown(value)}): {cure}")


OneDamping = Annotated[Damping, BeforeValidator(_damping)]
NO_DAMPING = Damping()
