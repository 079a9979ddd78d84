"""Limits of linear theory: laws for its error after a strike on the top of a column.

They are for columns of equal grains, in the paper's variables: tau, depths h in grains, strike
numbers v0*. They give relative errors, each in the norm that it names; `laws.theory_errors`
measures them. Constants are not fitted, unless a law says so.
"""

from __future__ import annotations

import numpy as np

from ..engines.linear.engine import Chebyshev
from ..engines.linear.model_error import passage, unlike
from ..errors import shown
from ..scene.scene import Scene
from ..theory.domain import exponents, require

WEAK = 1e-6  # strike number at which no contact comes near to opening
# norm: error of the linear theory over (delta - 1) v0* for weak strikes, and where it saturates;
# largest exponent for which the first holds: analysis/calibration/linear_model_error.py
LINEAR = {
    "velocity": (0.54, 2**0.5),
    "displacement": (0.186, 0.45),
    "package": (0.272, 0.69),
    "peak": (0.134, 0.3),
}
STEEPEST = 2.2


def linear_law(strike_number: float, norm: str, exponent: float = 1.5, grain: int = 20) -> float:
    """Return the error of Eq. (3) after a strike on the top of a column.

    It is x / (1 + x / limit) with x = c (delta - 1) v0*. A contact that is compressed by the
    fraction s of its overlap is stiffer, and the wave faster by (delta - 1) s / 4. The strain falls
    faster than 1/h, so that the lead is won at the first grains and stays: for tau above 6 the
    error depends neither on gravity nor on time, as long as the wave is on its way down. The
    constants c are those of perturbation theory to second order in v0*, right within 10 % for delta
    from 1.1 to 2.2; the limits are fitted to errors up to 0.1. A fixed bottom keeps a compression
    one, the free top turns it around: in ten passages of the column the error stays within a factor
    of 2.

    Parameters
    ----------
    strike_number : float
        v0*.
    norm : str
        "velocity": root of the sum of squares over grains, at the end of the run; "displacement":
        largest over all samples and grains, relative to the largest there; "package": the larger of
        that of displacement and of velocity, the error of this package; "peak": largest velocity of
        a grain, from grain 3 on, with x ~ w^(-3/2), w being the width of the front.
    exponent : float
        Delta, of the contact force.
    grain : int
        For the norm "peak".

    Returns
    -------
    float
        Relative error.

    Raises
    ------
    InputError
        If there is no such norm.
    """
    slope, limit = _linear_constants(norm, exponent, grain)
    return slope * strike_number / (1 + slope * strike_number / limit)


def strike_number_at(error: float, norm: str, exponent: float = 1.5, grain: int = 20) -> float:
    """Return the strike number at which Eq. (3) has an error, the inverse of `linear_law`.

    Parameters
    ----------
    error : float
        Relative, above 0.
    norm : str
        As for `linear_law`.
    exponent, grain : float, int
        As for `linear_law`.

    Returns
    -------
    float
        v0*.

    Examples
    --------
    >>> {norm: round(strike_number_at(0.01, norm), 3) for norm in LINEAR}
    {'velocity': 0.037, 'displacement': 0.11, 'package': 0.075, 'peak': 0.327}
    """
    slope, limit = _linear_constants(norm, exponent, grain)
    return error / slope / (1 - error / limit) if error < limit else np.inf


def strike_number_where(error: float, scene: Scene) -> float:
    """Return the strike number at which Eq. (3) would have this error, in a scene like this one.

    By `linear_law` for a column struck at its top, for any other scene by the estimate from its
    linear wave.

    Parameters
    ----------
    error : float
        Relative, above 0.
    scene : Scene

    Returns
    -------
    float
        v0*.
    """
    if struck_column(scene):
        delta = scene.chain.law.power_of("the law of struck columns")
        return strike_number_at(error, "package", delta)
    number = min(WEAK, scene.strike_number)
    for _ in range(20):
        excitation = scene.excitation.scaled(number / (scene.strike_number or 1.0))
        weaker = Scene(**scene.given() | {"excitation": excitation})
        estimate = Chebyshev().look(weaker.reached).error
        if not estimate:
            return np.inf
        # the estimate grows with the strike, or with its square
        number *= error / estimate
    return number


def struck_column(scene: Scene) -> bool:
    """Return whether a scene is a uniform column under gravity alone, struck at its top.

    It lasts for ten passages of the wave at most, and its exponent is at most 2.2: `linear_law`
    was measured up to there.

    Parameters
    ----------
    scene : Scene

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


def _linear_constants(norm: str, exponent: float, grain: int) -> tuple[float, float]:
    require(("norm", norm in LINEAR, f"must be one of {', '.join(LINEAR)} (got {shown(norm)})"))
    xi, _, _ = exponents(exponent)
    slope, limit = LINEAR[norm]
    spread = grain ** (0.75 * xi - 0.5) if norm == "peak" else 1.0
    return slope * (exponent - 1) * spread, limit
