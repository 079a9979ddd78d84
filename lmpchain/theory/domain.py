"""Domains of validity, exponents, depth and travel time shared by the formulas."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError, shown
from ..util.arrays import Array, numbers, whole_numbers

# Relative width of a gap, and relative difference of grains or contacts, that count as 0.
NEGLIGIBLE = 1e-9


def require(*rules: tuple[str, Any, str]) -> None:
    """Raise `InputError` for every rule (key, condition, message) that is violated anywhere."""
    if faults := [(key, message) for key, condition, message in rules if not np.all(condition)]:
        raise InputError(faults)


def real(value: ArrayLike, key: str = "values") -> Array:
    """Return the numbers as float64; raise `InputError` with this key for other values."""
    return numbers(value, key)


def finite(value: ArrayLike, key: str) -> Array:
    """Return finite numbers as float64; raise `InputError` with this key for other values."""
    number = real(value, key)
    require((key, np.isfinite(number), "must be finite"))
    return number


def whole(key: str, value: ArrayLike, lowest: int | None = None) -> NDArray[np.int64]:
    """Return integers as int64; raise `InputError` for other values and below `lowest`."""
    number = whole_numbers(value, key)
    if lowest is not None:
        require((key, number >= lowest, f"must be {lowest} or more"))
    return number


class PaperExponents(NamedTuple):
    """The paper's exponents, derived from the exponent of the contact force.

    ====== ======== ==================================================
    symbol variable meaning
    ====== ======== ==================================================
    xi     ``xi``   1 - 1/delta: stiffness grows with depth as h^xi
    eta    ``eta``  1 + 1/delta: the travel time is (2/eta) h^(eta/2)
    nu     ``nu``   1/(1 + delta): the order of the Bessel functions
    ====== ======== ==================================================
    """

    xi: float
    eta: float
    nu: float


def exponents(delta: float) -> PaperExponents:
    """Return xi, eta and nu for the exponent delta of the contact force.

    Raises
    ------
    InputError
        If delta is below 1 or not finite.

    Examples
    --------
    >>> exponents(1.0)
    PaperExponents(xi=0.0, eta=2.0, nu=0.5)
    """
    require(("delta", np.isfinite(delta) and delta >= 1, f"must be 1 or more (got {shown(delta)})"))
    return PaperExponents(xi=1 - 1 / delta, eta=1 + 1 / delta, nu=1 / (1 + delta))


def chi(h: ArrayLike, delta: float = 1.5) -> Array:
    """Return the travel time from the top, (2/eta) h^(eta/2), in units of tau.

    Parameters
    ----------
    h : array_like
        Depths, 0 or more.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If h < 0 or delta < 1.

    Examples
    --------
    >>> f"{chi(100.0):.4f}"
    '55.6991'
    """
    eta = exponents(delta).eta
    h = real(h, "h")
    require(("h", h >= 0, "must be 0 or more"))
    return 2 / eta * h ** (eta / 2)


def depth(tau: ArrayLike, delta: float = 1.5) -> Array:
    """Return the depth of the light cone at tau, (eta tau / 2)^(2/eta): the inverse of `chi`.

    For Hertz contacts it is (5 tau / 6)^(6/5); the tau^(6/5) after Eq. (9) lacks the factor.

    Parameters
    ----------
    tau : array_like
        Times, 0 or more.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If tau < 0 or delta < 1.

    Examples
    --------
    >>> f"{depth(150.0):.1f}"
    '328.3'
    """
    eta = exponents(delta).eta
    tau = real(tau, "tau")
    require(("tau", tau >= 0, "must be 0 or more"))
    return (eta / 2 * tau) ** (2 / eta)
