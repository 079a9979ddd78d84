"""Restitution of two viscoelastic spheres, exactly and by a series.

The contact force is ``K (1 + A d/dt) o^delta``, and the contact ends when the overlap o returns to
0. For Hertz's delta = 3/2 the restitution depends only on ``x = delta A (K/m)^(2/5) v^(1/5)``, with
the reduced mass m and the relative velocity v: T. Schwager and T. Poeschel, Phys. Rev. E 57, 650
(1998); R. Ramirez et al., Phys. Rev. E 60, 4465 (1999). Faster spheres have a smaller restitution.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike

from ..chain.damping import Pair, check_exponent, rebound, two_spheres
from ..chain.materials import Material, one_material
from ..errors import InputError, shown
from ..util.arrays import Array
from ..util.lazy import listed
from .domain import real, require

__dir__ = listed(__name__)

# Coefficients of the series in x, from x^0. Even powers follow from odd ones, because a collision
# reversed in time has the damping -A.
COEFFICIENTS = (
    1.0,
    -1.153448858095,
    0.798266560945,
    -0.522882568088,
    0.348742675260,
    -0.233098132019,
    0.156682152388,
    -0.105818786079,
    0.071765284925,
)

OneOrTwo = Material | str | Sequence[Any]


class SphereCollision(NamedTuple):
    """Two colliding spheres: velocities, m/s, and times A, s."""

    pair: Pair
    velocity: Array
    viscoelastic: Array

    @property
    def viscosity(self) -> Array:
        """A relative to the unit of time of each collision."""
        units = [self.pair.time(speed) for speed in self.velocity.flat]
        return self.viscoelastic / np.reshape(units, self.velocity.shape)


def coefficient(
    velocity: ArrayLike,
    viscoelastic: ArrayLike,
    material: OneOrTwo,
    diameter: float | Sequence[float],
    exponent: float = 1.5,
) -> Array:
    """Return the restitution of two spheres: the ratio of relative velocities after and before.

    It is computed by integrating the motion, with an error of 1e-12. For linear springs it is
    ``exp(-pi z / sqrt(1 - z^2))`` with ``z = A omega / 2`` and ``omega^2 = K / m``. It is 0 if the
    spheres stick.

    Parameters
    ----------
    velocity : array_like
        Relative velocity before the collision, m/s, above 0.
    viscoelastic : array_like
        Viscoelastic time A of the contact, s.
    material : Material, name, or two of them
        Material of the spheres.
    diameter : float or two of them
        Diameter of the spheres, m.
    exponent : float
        Exponent delta of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If a material is unknown, or if an argument is out of range.

    Examples
    --------
    >>> coefficient([0.1, 1.0, 10.0], 1e-6, "steel", 1e-2).round(6).tolist()
    [0.89503, 0.8396, 0.759534]
    """
    collision = _collision(velocity, viscoelastic, material, diameter, exponent)
    values = [rebound(float(x), float(exponent)) for x in collision.viscosity.flat]
    return np.reshape(values, collision.velocity.shape)


def series(
    velocity: ArrayLike,
    viscoelastic: ArrayLike,
    material: OneOrTwo,
    diameter: float | Sequence[float],
    terms: int = 8,
) -> Array:
    """Return the restitution of two spheres of Hertz's law by its series 1 - 1.1534 x + 0.7983 x^2.

    The signs alternate up to x^8, so that for x below 1 the error is smaller than the first omitted
    term. Ramirez et al. print 0.4836 and 0.2853 for the next two coefficients, in place of 0.5229
    and 0.3487.

    Parameters
    ----------
    velocity : array_like
        Relative velocity before the collision, m/s, above 0.
    viscoelastic : array_like
        Viscoelastic time A of the contact, s.
    material : Material, name, or two of them
        Material of the spheres.
    diameter : float or two of them
        Diameter of the spheres, m.
    terms : int
        Number of powers of x, 1 to 8.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If a material is unknown, or if an argument is out of range.

    Examples
    --------
    >>> series([0.1, 1.0, 10.0], 1e-6, "steel", 1e-2).round(6).tolist()
    [0.89503, 0.8396, 0.759534]
    """
    most = len(COEFFICIENTS) - 1
    require(("terms", terms in range(1, most + 1), f"must be 1 to {most} (got {shown(terms)})"))
    collision = _collision(velocity, viscoelastic, material, diameter, 1.5)
    return np.asarray(polyval(1.5 * collision.viscosity, COEFFICIENTS[: int(terms) + 1]))


def _collision(
    velocity: ArrayLike,
    viscoelastic: ArrayLike,
    material: OneOrTwo,
    diameter: float | Sequence[float],
    exponent: float,
) -> SphereCollision:
    """Return the collision after checking the input."""
    speed = real(velocity, "velocity")
    times = real(viscoelastic, "viscoelastic")
    diameters = real(diameter, "diameter")
    materials = list(material) if isinstance(material, list | tuple) else [material] * 2
    require(
        ("velocity", (speed > 0) & np.isfinite(speed), "must be finite and above 0"),
        ("viscoelastic", (times >= 0) & np.isfinite(times), "must be finite, from 0"),
        ("diameter", (diameters > 0) & np.isfinite(diameters), "must be finite and above 0"),
        ("diameter", diameters.shape in ((), (2,)), "must be one number, or two"),
        ("material", len(materials) == 2, "must be one material, or two"),
    )
    exponent = check_exponent(exponent)
    try:
        known = [one_material(value) for value in materials]
    except ValueError as error:
        raise InputError.at("material", str(error)) from None
    try:
        speed, times = np.broadcast_arrays(speed, times)
    except ValueError:
        shapes = f"{times.shape} beside velocities of {speed.shape}"
        raise InputError.at("viscoelastic", f"does not broadcast: {shapes}") from None
    pair = two_spheres(known, np.broadcast_to(diameters, 2).tolist(), exponent)
    return SphereCollision(pair, speed, times)
