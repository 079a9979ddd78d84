"""Scattering of linear waves by a piece of chain between two uniform leads.

The leads are the chain's own ends, extended: above grain 1 as grain 1 and contact 1, below grain N as grain N and
contact N - 1. A wave of amplitude 1 comes from above. Transfer matrices carry displacement and force from the
transmitted wave upward, where that solution is the one that grows: long pieces and gaps cost no digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from ..chain.chain import Chain
from ..chain.impurities import Impurity
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import axes_in_units, legend
from .domain import real, require

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__dir__ = listed(__name__)

Complex = NDArray[np.complex128]
Property = Literal["diameter", "mass", "modulus"]
STEPS = 400  # in which a solution is searched for


@dataclass(frozen=True, eq=False, repr=False)
class Transmission(Shown):
    """Reflection and transmission of waves that come from above.

    Attributes
    ----------
    frequency : (F,) array
        rad/s.
    wavenumber : (F,) array
        Of the lead above, radians a grain, 0 to pi.
    amplitude_reflected, amplitude_transmitted : (F,) complex arrays
        Displacement of grain 1 by the wave that goes up, and of grain N by that which goes on, over that of grain 1 by
        the wave that comes; with the time dependence exp(-i w t).
    reflected, transmitted : (F,) arrays
        Shares of the energy; they add up to 1.
    """

    frequency: Array
    wavenumber: Array
    amplitude_reflected: Complex
    amplitude_transmitted: Complex
    reflected: Array
    transmitted: Array

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw both shares of the energy over frequency; returns the axes."""
        ax = axes_in_units(ax, "Hz", "")
        for name in ("transmitted", "reflected"):
            ax.plot(self.frequency / (2 * np.pi), getattr(self, name), label=name)
        ax.set(xlabel="frequency", ylabel="share of the energy", ylim=(-0.02, 1.02))
        legend(ax)
        return ax


def transmission(chain: Chain, frequency: ArrayLike) -> Transmission:
    """Return what a chain between two uniform leads, its own ends extended, reflects and transmits.

    What stands at its ends, a wall or a grain that is held, has no part in it. Martinez, Yasuda, Kim, Kevrekidis,
    Porter and Yang, Phys. Rev. E 93, 052224 (2016), have closed forms for one impurity and two.

    Parameters
    ----------
    chain : Chain
        Compressed.
    frequency : (F,) array_like
        rad/s, above 0 and within the band of the lead above.

    Returns
    -------
    Transmission

    Raises
    ------
    InputError
        If nothing is compressed, or a frequency does not travel in the lead above.

    Examples
    --------
    >>> uniform = {"grains": 9, "diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
    >>> odd = Chain(**uniform, impurity=[{"grain": 5, "diameter": 2e-3}])
    >>> w = 2 / odd.time_scale * np.sin(1.0 / 2)  # one radian a grain
    >>> f"{transmission(odd, w).transmitted:.6f}"
    '0.071997'
    """
    require(
        (
            "chain",
            chain.compressed,
            "carries no force at rest: nothing linear travels without gravity or a load",
        ),
        (
            "grains",
            chain.grains > 1,
            "must be two or more: the first and the last contact are those of the leads",
        ),
    )
    return _scatter(chain.masses, chain.linear_stiffness, real(frequency))


def transparent(
    chain: Chain,
    frequency: float,
    grains: Sequence[int],
    vary: Property = "diameter",
    between: tuple[float, float] = (0.1, 10.0),
) -> Array:
    """Return by what factors to change grains so that a wave of this frequency passes them unreflected.

    Two like impurities side by side have such a Ramsauer-Townsend resonance where one has none: Martinez et al., Phys.
    Rev. E 93, 052224 (2016).

    Parameters
    ----------
    chain : Chain
        Uniform and with no impurities, under a load and without gravity.
    frequency : float
        rad/s, in the band.
    grains : list of int
        Those that are changed, all by the same factor; such that their mirror image is the same.
    vary : str
        "diameter" (which changes mass and contacts), "mass" or "modulus" (Young's modulus).
    between : (float, float)
        Factors between which to search.

    Returns
    -------
    (S,) array
        Ascending; empty if there is none. The factor 1, no change, is left out.

    Raises
    ------
    InputError
        If the chain is not as above, the grains do not fit in, or the frequency does not travel.

    Examples
    --------
    >>> chain = Chain(grains=10, diameter=1e-3, gravity=0.0, top_load=1.0)
    >>> w = 2 / chain.time_scale * 0.6229566659
    >>> [f"{factor:.8f}" for factor in transparent(chain, w, [5, 6])]
    ['1.10000000']
    """
    numbers = sorted(grains)
    mirrored = (
        numbers == [numbers[0] + numbers[-1] - n for n in numbers[::-1]] if numbers else False
    )
    inside = all(3 <= n <= chain.grains - 2 for n in numbers)
    low, high = between
    require(
        (
            "chain",
            not chain.impurity and isinstance(chain.diameter, float),
            "must be uniform, with no impurity",
        ),
        ("gravity", chain.gravity == 0, "must be 0, so that the leads are alike"),
        (
            "grains",
            mirrored and len(set(numbers)) == len(numbers),
            "must be their own mirror image, as 5 and 6, or 4, 5, 6",
        ),
        (
            "grains",
            inside,
            f"must be from 3 to {chain.grains - 2}, so that the leads begin where the chain is uniform",
        ),
        (
            "vary",
            vary in get_args(Property),
            f'must be "diameter", "mass" or "modulus" (got {vary!r})',
        ),
        (
            "between",
            0 < low < high,
            f"must be two factors above 0, the smaller one first (got {between!r})",
        ),
    )

    def reflected(logarithm: float) -> float:
        """Return a real number that is 0 where nothing is reflected: r / t of a symmetric piece is imaginary."""
        found = transmission(_changed(chain, numbers, vary, np.exp(logarithm)), frequency)
        turn = np.exp(1j * found.wavenumber * (chain.grains + 1 - numbers[0] - numbers[-1]))
        return float(np.imag(found.amplitude_reflected / found.amplitude_transmitted * turn))

    places = np.linspace(np.log(low), np.log(high), STEPS + 1)
    values = np.array([reflected(x) for x in places])
    turns = np.flatnonzero(values[:-1] * values[1:] < 0)
    found = np.exp(
        [brentq(reflected, places[i], places[i + 1], xtol=1e-14, rtol=1e-14) for i in turns]
    )
    return found[np.abs(found - 1) > 1e-9]


def _changed(chain: Chain, grains: Sequence[int], vary: Property, factor: float) -> Chain:
    """Return the chain with a property of these grains changed by a factor."""
    if vary == "mass":
        odd = [Impurity(grain=n, mass=float(chain.masses[n - 1]) * factor) for n in grains]
    elif vary == "diameter":
        odd = [Impurity(grain=n, diameter=float(chain.diameters[n - 1]) * factor) for n in grains]
    else:
        one: Any = chain.material
        stiffer = type(one)(**one.given() | {"youngs_modulus": one.youngs_modulus * factor})
        odd = [Impurity(grain=n, material=stiffer) for n in grains]
    return Chain(**chain.given() | {"impurity": odd})


def _scatter(mass: Array, stiffness: Array, frequency: Array) -> Transmission:
    """Return what grains, (N,) kg, with contacts between, (N-1,) N/m, reflect and transmit."""
    square = frequency**2
    (above, half_above), (below, half_below) = (
        _lead(frequency / 2 * np.sqrt(mass[end] / stiffness[end])) for end in (0, -1)
    )
    require(("frequency", (above > 0) & (above < 1), _band(mass[0], stiffness[0])))
    # displacement and force on the contact below, from the wave that goes on; their size is kept apart
    moved, force = np.ones(frequency.shape, complex), -2j * stiffness[-1] * below * half_below
    logarithm = np.zeros(frequency.shape)
    for own, stiff in zip(mass[:0:-1], stiffness[::-1], strict=True):
        force = force - own * square * moved
        moved = moved + force / stiff
        size = np.maximum(np.abs(moved), np.abs(force) / stiff)
        moved, force, logarithm = moved / size, force / size, logarithm + np.log(size)
    force = (force - mass[0] * square * moved) / stiffness[0]
    step = 2j * above * half_above  # exp(i k) - 1
    sine = 2 * above * half_above.real  # sin(k)
    comes = (moved * step - force) / (2j * sine)
    reflected = (force - moved * step.conj()) / (2j * sine) / comes
    transmitted = np.exp(-logarithm) / comes
    share = stiffness[-1] * below * half_below.real / (stiffness[0] * above * half_above.real)
    return Transmission(
        frequency=frequency,
        wavenumber=2 * np.arcsin(above),
        amplitude_reflected=reflected,
        amplitude_transmitted=transmitted,
        reflected=np.abs(reflected) ** 2,
        transmitted=np.abs(transmitted) ** 2 * share,
    )


def _lead(sine: Array) -> tuple[Array, Complex]:
    """Return sin(k/2) and exp(i k/2) of a lead, of the wave that decays away if sin(k/2) > 1."""
    cosine = np.where(
        sine <= 1, np.sqrt(np.maximum(1 - sine**2, 0)), -1j * np.sqrt(np.maximum(sine**2 - 1, 0))
    )
    return sine, cosine + 1j * sine


def _band(mass: float, stiffness: float) -> str:
    """Return what a frequency in the lead above must be."""
    return f"must be above 0 and below {2 * np.sqrt(stiffness / mass):.6g} rad/s, the band edge of the lead above"
