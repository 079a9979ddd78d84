"""Limits of linear theory: laws for its error after an impulse on the top of a column.

The laws hold for columns of equal grains. They use the paper's variables: the time tau, the depth h
in grains, and the strike number v0*. Each law gives a relative error in a stated norm;
analysis/laws/theory_errors.py measures these errors. Constants are not fitted, unless a law states
it.
"""

from __future__ import annotations

import math

import numpy as np

from ..engines.linear.engine import Chebyshev
from ..engines.linear.model_error import passage, unlike
from ..errors import InputError, shown
from ..scene.scene import Scene, check_scene
from ..theory.domain import exponents, require
from ..util.arrays import numbers

WEAK = 1e-6  # Strike number far below the opening of any contact.
# For each norm: the error of linear theory over (delta - 1) v0* for weak strikes, and its
# saturation value. STEEPEST is the largest exponent for which the first one holds
# (analysis/calibration/linear_model_error.py).
LINEAR = {
    "velocity": (0.54, 2**0.5),
    "displacement": (0.186, 0.45),
    "package": (0.272, 0.69),
    "peak": (0.134, 0.3),
}
STEEPEST = 2.2


def linear_law(strike_number: float, norm: str, exponent: float = 1.5, grain: int = 20) -> float:
    """Return the error of Eq. (3) after an impulse on the top of a column.

    The error is x / (1 + x / limit) with x = c (delta - 1) v0*. A contact that is compressed
    further by the fraction s of its overlap is stiffer, and the wave is faster by (delta - 1) s /
    4. The strain decreases faster than 1/h, so that the phase error arises at the first grains and
    then remains constant: for tau above 6 the error depends neither on gravity nor on time, until
    the wave is reflected. The constants c are those of perturbation theory to second order in v0*,
    accurate to 10 % for delta from 1.1 to 2.2; the limits are fitted to errors up to 0.1. A fixed
    bottom reflects a compression as a compression, and the free top inverts it. During ten passages
    of the column the error therefore stays within a factor of 2.

    Parameters
    ----------
    strike_number : float
        Strike number v0*.
    norm : str
        Definition of the error. "velocity": root of the sum of squares over grains, at the end of
        the run. "displacement": largest error of all samples and grains, relative to the largest
        displacement. "package": the larger of the errors of displacement and velocity, as in
        `ErrorEstimate`. "peak": error of the largest velocity of a grain, from grain 3 on, with
        x ~ w^(-3/2) for a front of width w.
    exponent : float
        Exponent delta of the contact force.
    grain : int
        Number of the grain for the norm "peak".

    Returns
    -------
    float
        Relative error.

    Raises
    ------
    InputError
        If the norm is unknown, or if a number is outside its range.
    """
    positive = numbers(strike_number, "strike_number") >= 0
    require(("strike_number", positive, f"must be 0 or more (got {shown(strike_number)})"))
    slope, limit = _linear_constants(norm, exponent, grain)
    return slope * strike_number / (1 + slope * strike_number / limit)


def strike_number_at(error: float, norm: str, exponent: float = 1.5, grain: int = 20) -> float:
    """Return the strike number at which Eq. (3) has an error, the inverse of `linear_law`.

    Parameters
    ----------
    error : float
        Relative error, above 0.
    norm : str
        Definition of the error, as in `linear_law`.
    exponent : float
        Exponent delta of the contact force.
    grain : int
        Number of the grain for the norm "peak".

    Returns
    -------
    float
        Strike number v0*; infinite if the error never becomes so large.

    Examples
    --------
    >>> {norm: round(strike_number_at(0.01, norm), 3) for norm in LINEAR}
    {'velocity': 0.037, 'displacement': 0.11, 'package': 0.075, 'peak': 0.327}
    """
    _check_error(error)
    slope, limit = _linear_constants(norm, exponent, grain)
    # Springs have no model error while they are closed.
    return error / slope / (1 - error / limit) if slope and error < limit else np.inf


def strike_number_where(error: float, scene: Scene) -> float:
    """Return the strike number at which Eq. (3) has this error, in a scene of this type.

    For a column struck at its top the result is that of `linear_law`. For other scenes it is
    computed from error estimates of linear waves.

    Parameters
    ----------
    error : float
        Relative error, above 0.
    scene : Scene
        Scene whose excitation is scaled.

    Returns
    -------
    float
        Strike number v0*.

    Raises
    ------
    InputError
        If nothing compresses the chain at rest, so that linear theory does not apply.
    """
    check_scene(scene)
    _check_error(error)
    if not math.isfinite(scene.strike_number):
        message = "without gravity and load linear theory does not apply: add one of them"
        raise InputError.at("gravity", message)
    if struck_column(scene):
        delta = scene.chain.law.power_of("the law of struck columns")
        return strike_number_at(error, "package", delta)
    # Without a motion there is no error.
    if not scene.strike_number:
        return np.inf
    number = min(WEAK, scene.strike_number)
    # The estimate is proportional to the strike number; or to its square, if the force is an odd
    # function of the displacement from rest. The secant in logarithms meets both.
    power = 2.0
    before = None
    for _ in range(20):
        excitation = scene.excitation.scaled(number / scene.strike_number)
        weaker = Scene(**scene.given() | {"excitation": excitation})
        estimate = Chebyshev().look(weaker.reached).error
        if not estimate:
            return np.inf
        if abs(estimate / error - 1) < 1e-12:
            break
        if before is not None:
            growth = math.log(number / before[0])
            power = float(np.clip(math.log(estimate / before[1]) / growth, 1.0, 2.0))
        before = number, estimate
        number *= (error / estimate) ** (1 / power)
    return number


def struck_column(scene: Scene) -> bool:
    """Return whether a scene is a uniform column under gravity alone, struck at its top.

    The duration must be at most ten passages of the wave, and the exponent at most 2.2, because
    `linear_law` was measured within these limits.

    Parameters
    ----------
    scene : Scene
        The scene to check.

    Returns
    -------
    bool
    """
    chain = scene.chain
    strike = scene.excitation
    if chain.grains == 1 or not (strike.strikes_top and chain.gravity > 0 and chain.top_load == 0):
        return False
    if chain.top != "free" or (chain.law.power or np.inf) > STEEPEST or any(unlike(chain).values()):
        return False
    return bool(scene.duration <= 10 * passage(scene).sum())


def _check_error(error: float) -> None:
    """Raise `InputError` unless a relative error is above 0."""
    require(("error", numbers(error, "error") > 0, f"must be above 0 (got {shown(error)})"))


def _linear_constants(norm: str, exponent: float, grain: int) -> tuple[float, float]:
    require(
        ("norm", norm in LINEAR, f"must be one of {', '.join(LINEAR)} (got {shown(norm)})"),
        ("grain", numbers(grain, "grain") >= 1, f"must be 1 or more (got {shown(grain)})"),
    )
    xi, _, _ = exponents(exponent)
    slope, limit = LINEAR[norm]
    spread = grain ** (0.75 * xi - 0.5) if norm == "peak" else 1.0
    return slope * (exponent - 1) * spread, limit
