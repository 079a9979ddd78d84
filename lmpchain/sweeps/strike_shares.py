"""Fraction of a strike's energy in solitary waves, by the exponent of the contact force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..chain.chain import Chain
from ..errors import InputError, RunFailed, shown
from ..measure.solitary import Train, find
from ..scene.excitation import Impulse
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..theory.soliton import solve
from ..util.arrays import Array, numbers
from ..util.notebook import Shown
from ..util.plotting import ERROR_BARS, Axes, chart, finish
from ..util.tabular import Tabular
from ..util.validation import check_positive

# Numbers of grains of the first chain and of the longest one. Waves separate slowly if the exponent
# is near 1.
SHORTEST_CHAIN = 100
LONGEST_CHAIN = 800
SAMPLES_A_GRAIN = 12  # Number of samples in the time from grain to grain.
STRIKE = 0.1  # Strike velocity, m/s; the shares do not depend on it.
# Velocity of the leading wave relative to the strike, smaller than any observed ratio.
SLOWEST = 0.35
BETWEEN = "between 0 and 1"
MASS = 1e-6
CONSTANT = 1e9


@dataclass(frozen=True, eq=False, repr=False)
class StrikeShares(Shown, Tabular):
    """Fraction of a strike's energy in solitary waves, for E exponents and chains without load.

    Attributes
    ----------
    exponent : (E,) array
        Exponents of the contact force.
    share, share_error : (E,) arrays
        Energy of all solitary waves relative to the energy of the strike, and its uncertainty, as
        in `measure.solitary.Train`.
    velocity, velocity_error : (E,) arrays
        Largest velocity of a grain in the leading wave relative to the strike velocity, and its
        uncertainty.
    waves : (E,) array
        Number of solitary waves.
    grains : (E,) array
        Number of grains of the chain that gave the required accuracy.
    """

    _units: ClassVar[Mapping[str, str]] = {
        "exponent": "",
        "share": "",
        "share_error": "",
        "velocity": "",
        "velocity_error": "",
        "waves": "",
        "grains": "",
    }

    exponent: Array
    share: Array
    share_error: Array
    velocity: Array
    velocity_error: Array
    waves: NDArray[np.intp]
    grains: NDArray[np.intp]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the fraction of the energy outside solitary waves over the exponent."""
        ax = chart(ax, "exponent of the contact force", "1 - share", "y")
        ax.errorbar(self.exponent, 1 - self.share, self.share_error, **ERROR_BARS)
        title = "Share of a strike that no solitary wave has"
        return finish(ax, title)


def strike_shares(exponents: ArrayLike, accuracy: float = 1e-5) -> StrikeShares:
    """Strike a uniform chain without load, and measure its solitary waves.

    The share depends on the exponent alone; see G. Deng, G. Biondini, S. Sen and P. G. Kevrekidis,
    arXiv:2002.08499. The duration follows from the speed of the exact solitary wave. The chain is
    made longer until the share is accurate.

    Parameters
    ----------
    exponents : (E,) array_like
        Exponents above 1 and at most 3. An exponent close to 1 requires a long chain, because its
        waves separate slowly.
    accuracy : float
        Largest error of a share.

    Returns
    -------
    StrikeShares

    Raises
    ------
    InputError
        If an exponent or the accuracy is out of range.
    RunFailed
        If no chain of up to 800 grains reaches the accuracy.

    Examples
    --------
    >>> found = strike_shares([1.5, 2.0])
    >>> found.share.round(7).tolist()
    [0.993661, 0.9984521]
    """
    chosen = np.atleast_1d(numbers(exponents, "exponents"))
    if chosen.ndim != 1 or not chosen.size or not ((chosen > 1) & (chosen <= 3)).all():
        raise InputError.at("exponents", f"must be above 1 and at most 3 (got {shown(exponents)})")
    if check_positive("accuracy", accuracy, BETWEEN) >= 1:
        raise InputError.at("accuracy", f"must be {BETWEEN} (got {accuracy})")
    trains = [_train(float(exponent), accuracy) for exponent in chosen]
    shares = np.array([train.all_share for train in trains])
    return StrikeShares(
        exponent=chosen,
        share=shares[:, 0],
        share_error=shares[:, 1],
        velocity=np.array([train.velocity[0] / STRIKE for train in trains]),
        velocity_error=np.array([train.velocity_error[0] / STRIKE for train in trains]),
        waves=np.array([train.grain.size for train in trains]),
        grains=np.array([train.place.size for train in trains]),
    )


def _train(exponent: float, accuracy: float) -> Train:
    """Return the waves of the shortest chain that gives sufficiently accurate shares."""
    grains = SHORTEST_CHAIN
    reason = ""
    while grains <= LONGEST_CHAIN:
        try:
            train = find(simulate(_scene(exponent, grains), "native", min(accuracy, 1e-6) / 100))
        except InputError as error:
            # The waves have not separated yet.
            reason = str(error)
        else:
            error_of_share = train.all_share[1]
            if error_of_share <= accuracy:
                return train
            reason = f"the error of the share is {error_of_share:.1g}"
        grains *= 2
    cure = "choose a larger exponent, or a larger accuracy"
    raise RunFailed(f"exponent {exponent:g}: after {grains // 2} grains {reason}; {cure}")


def _scene(exponent: float, grains: int) -> Scene:
    """Return a strike on a uniform chain, until its leading wave has reached the end."""
    chain = Chain(
        grains=grains,
        diameter=1e-3,
        masses=np.full(grains, MASS),
        contact_constants=np.full(grains - 1, CONSTANT),
        gravity=0.0,
        bottom="free",
        exponent=exponent,
    )
    power = 1 / (exponent + 1)
    unit = (CONSTANT / MASS) ** power * STRIKE ** ((exponent - 1) * power)
    speed = unit * solve(delta=exponent, velocity=SLOWEST).speed
    strike = Impulse(velocity=STRIKE)
    # `find` ignores what is recorded after the leading wave has come near the end.
    return Scene(
        chain=chain, excitation=strike, duration=grains / speed, samples=SAMPLES_A_GRAIN * grains
    )
