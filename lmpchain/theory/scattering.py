"""Scattering of linear waves by a chain segment between two uniform leads.

The leads extend the ends of the chain: the upper lead repeats grain 1 and contact 1, and the lower
lead repeats grain N and contact N - 1. A wave of amplitude 1 comes from above. Transfer matrices
propagate displacement and force upward from the transmitted wave. This solution grows upward, so
that rounding errors stay small in long segments and in gaps.

The leads of a damped chain are lossless, so that the energy of waves is defined there. Energy that
is neither reflected nor transmitted is absorbed between grain 1 and grain N, by contacts
``k (1 - i w A)`` and grains ``m (1 + i gamma / w)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args
from warnings import catch_warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from ..chain import sponge
from ..chain.chain import Chain
from ..chain.materials import Impurity
from ..errors import not_among, shown
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish
from ..util.tabular import Tabular
from .domain import NEGLIGIBLE, real, require, whole

__dir__ = listed(__name__)

Complex = NDArray[np.complex128]
Property = Literal["diameter", "mass", "youngs_modulus"]


@dataclass(frozen=True, eq=False, repr=False)
class Transmission(Shown, Tabular):
    """Reflection and transmission of waves that come from above.

    Attributes
    ----------
    frequency : (F,) array
        Frequencies, rad/s.
    wavenumber : (F,) array
        Wavenumbers in the upper lead, radians per grain, 0 to pi.
    amplitude_reflected : (F,) complex array
        Displacement of grain 1 by the reflected wave, over its displacement by the incoming wave,
        with the time dependence exp(-i w t).
    amplitude_transmitted : (F,) complex array
        Displacement of grain N by the transmitted wave, over the displacement of grain 1 by the
        incoming wave.
    reflected : (F,) array
        Fraction of the energy that is reflected.
    transmitted : (F,) array
        Fraction of the energy that is transmitted.
    absorbed : (F,) array
        Fraction of the energy that damping absorbs; 0 without damping.
    """

    _units: ClassVar[dict[str, str]] = {
        "frequency": "rad/s",
        "wavenumber": "",
        "amplitude_reflected": "",
        "amplitude_transmitted": "",
        "reflected": "",
        "transmitted": "",
        "absorbed": "",
    }

    frequency: Array
    wavenumber: Array
    amplitude_reflected: Complex
    amplitude_transmitted: Complex
    reflected: Array
    transmitted: Array
    absorbed: Array

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the fractions of the energy over frequency, and return the axes."""
        ax = chart(ax, "frequency [Hz]", "share of the energy")
        names = ["transmitted", "reflected"]
        if self.absorbed.any():
            names.append("absorbed")
        for name in names:
            ax.plot(self.frequency / (2 * np.pi), getattr(self, name), label=name)
        ax.set(ylim=(-0.02, 1.02))
        return finish(ax)


def transmission(chain: Chain, frequency: ArrayLike) -> Transmission:
    """Return reflection and transmission of a chain between uniform leads that continue its ends.

    Walls at the ends of the chain are ignored, and a held grain moves as the others do. A. J.
    Martinez et al., Phys. Rev. E 93, 052224 (2016), give closed forms for one and two impurities.

    Parameters
    ----------
    chain : Chain
        A compressed chain.
    frequency : (F,) array_like
        Frequencies, rad/s, above 0 and within the band of the upper lead.

    Returns
    -------
    Transmission
        Amplitudes and fractions of the energy.

    Raises
    ------
    InputError
        If no contact is compressed, or if a frequency is outside the band of the upper lead.

    Examples
    --------
    >>> uniform = {"grains": 9, "diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
    >>> odd = Chain(**uniform, impurity=[{"grain": 5, "diameter": 2e-3}])
    >>> w = 2 / odd.time_scale * np.sin(1.0 / 2)  # one radian a grain
    >>> f"{transmission(odd, w).transmitted:.6f}"
    '0.071997'
    """
    load = "carries no force at rest: nothing linear travels without gravity or a load"
    leads = "must be two or more: the first and the last contact are those of the leads"
    require(("chain", chain.compressed, load), ("grains", chain.grains > 1, leads))
    chain.refuse_loose("theory of scattering")
    chain.refuse_ground("theory of scattering")
    return _scatter(chain, real(frequency, "frequency"))


@dataclass(frozen=True, eq=False, repr=False)
class Reflection(Shown, Tabular):
    """Reflection of waves by an end of a chain.

    Attributes
    ----------
    frequency : (F,) array
        Frequencies, rad/s.
    amplitude : (F,) complex array
        Displacement of the last grain before the end by the reflected wave, over its displacement
        by the incoming wave, with the time dependence exp(-i w t).
    reflected : (F,) array
        Fraction of the energy that is reflected.
    bands : (B, 2) array
        Edges of the bands of the repeating cell, rad/s.
    """

    _units: ClassVar[dict[str, str]] = {"frequency": "rad/s", "amplitude": "", "reflected": ""}

    frequency: Array
    amplitude: Complex
    reflected: Array
    bands: Array

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the reflected fraction of the energy over frequency, and return the axes."""
        ax = chart(ax, "frequency [Hz]", "share of the energy that comes back")
        for low, high in self.bands:
            inside = (self.frequency >= low) & (self.frequency <= high)
            ax.semilogy(self.frequency[inside] / (2 * np.pi), self.reflected[inside], "C0")
        return ax


def reflection(
    chain: Chain,
    grains: int = 60,
    end: Literal["bottom", "top"] = "bottom",
    frequency: ArrayLike | None = None,
) -> Reflection:
    """Return the reflection by the last grains of a chain, such as an absorbing boundary.

    The wave comes from an infinite lossless chain that repeats the first cell of these grains. The
    end of the chain remains: a wall, a held grain, or a free end.

    Parameters
    ----------
    chain : Chain
        A chain whose contacts are compressed at this end.
    grains : int
        Number of grains at the end that reflect the wave.
    end : "bottom" or "top"
        End of the chain.
    frequency : (F,) array_like, optional
        Frequencies, rad/s, within the bands of the cell; by default 61 in the middle 80 % of each
        band.

    Returns
    -------
    Reflection
        Amplitudes and fractions of the energy.

    Raises
    ------
    InputError
        If contacts at this end are not compressed, if the chain has fewer grains, or if a frequency
        is outside the bands.

    Examples
    --------
    >>> from lmpchain import patterns
    >>> chain = Chain(grains=100, diameter=1e-3, gravity=0.0, top_load=1.0, bottom="wall")
    >>> wave = reflection(patterns.absorbing(chain, bottom=60), 60)
    >>> f"amplitude {abs(wave.amplitude).max():.1e}, energy {wave.reflected.max():.1e}"
    'amplitude 1.2e-03, energy 1.5e-06'
    """
    cell = sponge.period(chain, end)
    grains = int(whole("grains", grains))
    least = 3 * cell
    fits = f"must be {least} (three cells) to {chain.grains} of the chain (got {shown(grains)})"
    sides = f'must be "bottom" or "top" (got {shown(end)})'
    require(
        ("end", end in ("bottom", "top"), sides), ("grains", least <= grains <= chain.grains, fits)
    )
    ending = sponge.layer(chain, end, grains, cell)
    require(("chain", chain.compressed and ending.stiffness[:-1].all(), sponge.NOT_PRESSED))
    omega = ending.middle if frequency is None else real(frequency, "frequency")
    low, high = ending.bands.T[:, :, None]
    within = ((omega > low) & (omega < high)).any(0)
    bands = " or ".join(f"{a:.6g} to {b:.6g}" for a, b in ending.bands)
    require(("frequency", within, f"must lie within a band, {bands} rad/s"))
    drag = chain.drag[: chain.movable]
    drag = drag[::-1] if end == "top" else drag
    amplitude = sponge.reflection(ending, drag[-ending.masses.size :], omega)
    return Reflection(omega, amplitude, np.abs(amplitude) ** 2, ending.bands)


def transparent(
    chain: Chain,
    frequency: float,
    grains: Sequence[int],
    vary: Property = "diameter",
    between: tuple[float, float] = (0.1, 10.0),
) -> Array:
    """Return factors of a grain property at which a wave passes the grains unreflected.

    Two equal impurities side by side have such a Ramsauer-Townsend resonance, but a single impurity
    has none; A. J. Martinez et al., Phys. Rev. E 93, 052224 (2016).

    Parameters
    ----------
    chain : Chain
        A uniform chain without impurities, under a load and without gravity.
    frequency : float
        Frequency, rad/s, in the band.
    grains : list of int
        Numbers of the grains that are changed, all by the same factor. Their arrangement must be
        its own mirror image.
    vary : str
        Property that is changed: "diameter" (which changes mass and contacts), "mass" or
        "youngs_modulus".
    between : (float, float)
        Smallest and largest factor of the search.

    Returns
    -------
    (S,) array
        Factors in ascending order; empty if there are none. The factor 1 (no change) is omitted.

    Raises
    ------
    InputError
        If the chain is not as described, if the grains are too close to its ends or are not
        symmetric, or if the frequency is outside the band.

    Examples
    --------
    >>> chain = Chain(grains=10, diameter=1e-3, gravity=0.0, top_load=1.0)
    >>> w = 2 / chain.time_scale * 0.6229566659
    >>> [f"{factor:.8f}" for factor in transparent(chain, w, [5, 6])]
    ['1.10000000']
    """
    chain.refuse_damping("an impurity that reflects nothing")
    numbers = sorted(grains)
    mirror = [numbers[0] + numbers[-1] - n for n in numbers[::-1]] if numbers else None
    symmetric = numbers == mirror and len(set(numbers)) == len(numbers)
    inside = all(3 <= n <= chain.grains - 2 for n in numbers)
    # Contacts under gravity are reported as a fault of their own.
    rows = [chain.masses] if chain.gravity else [chain.masses, chain.linear_stiffness]
    even = all(np.abs(x - x[:1]).max(initial=0.0) <= NEGLIGIBLE * x.max(initial=0.0) for x in rows)
    uniform = not chain.impurity and even
    low, high = between
    leads = f"must be from 3 to {chain.grains - 2}, so that the leads begin where the chain is"
    kinds = not_among(vary, get_args(Property))
    factors = f"must be two factors above 0, the smaller one first (got {between!r})"
    require(
        ("chain", uniform, "must be uniform, with equal grains and contacts"),
        ("gravity", chain.gravity == 0, "must be 0, so that the leads are alike"),
        ("grains", symmetric, "must be their own mirror image, as 5 and 6, or 4, 5, 6"),
        ("grains", inside, f"{leads} uniform"),
        ("vary", vary in get_args(Property), kinds),
        ("between", 0 < low < high, factors),
    )

    def reflection(logarithm: float) -> float:
        """Return a real number that is 0 without reflection: r / t of symmetric grains, rotated."""
        wave = transmission(_change(chain, numbers, vary, np.exp(logarithm)), frequency)
        turn = np.exp(1j * wave.wavenumber * (chain.grains + 1 - numbers[0] - numbers[-1]))
        return float(np.imag(wave.amplitude_reflected / wave.amplitude_transmitted * turn))

    # Some resonances are narrow, so the factor increases by 1 % from step to step by default.
    nodes = np.linspace(np.log(low), np.log(high), 401)
    # The search tries factors that no real grain has.
    with catch_warnings(action="ignore"):
        values = np.array([reflection(x) for x in nodes])
        roots = [
            brentq(reflection, nodes[i], nodes[i + 1], xtol=1e-14, rtol=1e-14)
            for i in np.flatnonzero(values[:-1] * values[1:] < 0)
        ]
    factor = np.exp(roots)
    # A uniform chain has no reflection.
    return factor[np.abs(factor - 1) > 1e-9]


def _change(chain: Chain, grains: Sequence[int], vary: Property, factor: float) -> Chain:
    """Return the chain with a property of these grains multiplied by a factor."""
    if vary == "mass":
        impurities = [Impurity(grain=n, mass=float(chain.masses[n - 1]) * factor) for n in grains]
    elif vary == "diameter":
        diameters = chain.diameters
        impurities = [Impurity(grain=n, diameter=float(diameters[n - 1]) * factor) for n in grains]
    else:
        material: Any = chain.material
        # A uniform chain has a single material, which may be listed for every grain.
        material = material[0] if isinstance(material, tuple) else material
        modulus = material.youngs_modulus * factor
        stiffer = material.replace(youngs_modulus=modulus)
        impurities = [Impurity(grain=n, material=stiffer) for n in grains]
    return chain.replace(impurity=impurities)


def _scatter(chain: Chain, frequency: Array) -> Transmission:
    """Return reflection and transmission of a chain at frequencies, rad/s."""
    mass = chain.masses
    stiffness = chain.linear_stiffness
    square = frequency**2
    # Values of sin(k/2) and exp(i k/2) in the upper and in the lower lead.
    above = frequency / 2 * np.sqrt(mass[0] / stiffness[0])
    below = frequency / 2 * np.sqrt(mass[-1] / stiffness[-1])
    half_above = _half_turn(above)
    half_below = _half_turn(below)
    edge = 2 * np.sqrt(stiffness[0] / mass[0])
    message = f"must be above 0 and below {edge:.6g} rad/s, the band edge of the lead above"
    require(("frequency", (above > 0) & (above < 1), message))
    inertias: Sequence[Array | Complex] = list(mass)
    springs: Sequence[Array | Complex] = list(stiffness)
    if chain.damped:
        inertias = [m * (1 + 1j * g / frequency) for m, g in zip(mass, chain.drag, strict=True)]
        viscosity = chain.contact_viscosity[1:-1]
        springs = [k * (1 - 1j * a * frequency) for k, a in zip(stiffness, viscosity, strict=True)]
    # Displacement and force on the contact below, from the transmitted wave upward. The logarithm
    # of their size is stored separately, because the size may overflow in a gap.
    displacement = np.ones(frequency.shape, complex)
    force = -2j * stiffness[-1] * below * half_below
    logarithm = np.zeros(frequency.shape)
    for inertia, stiff in zip(inertias[:0:-1], springs[::-1], strict=True):
        force = force - inertia * square * displacement
        displacement = displacement + force / stiff
        size = np.maximum(np.abs(displacement), np.abs(force / stiff))
        displacement = displacement / size
        force = force / size
        logarithm = logarithm + np.log(size)
    force = (force - inertias[0] * square * displacement) / stiffness[0]
    # Values of exp(i k) - 1 and sin(k) in the upper lead.
    step = 2j * above * half_above
    sine = 2 * above * half_above.real
    incoming = (displacement * step - force) / (2j * sine)
    reflected = (force - displacement * step.conj()) / (2j * sine) / incoming
    transmitted = np.exp(-logarithm) / incoming
    # The energy flow is k sin(wavenumber) times the squared amplitude.
    share = stiffness[-1] * below * half_below.real / (stiffness[0] * above * half_above.real)
    returned = np.abs(reflected) ** 2
    passed = np.abs(transmitted) ** 2 * share
    return Transmission(
        frequency=frequency,
        wavenumber=2 * np.arcsin(above),
        amplitude_reflected=reflected,
        amplitude_transmitted=transmitted,
        reflected=returned,
        transmitted=passed,
        absorbed=1 - returned - passed if chain.damped else np.zeros(frequency.shape),
    )


def _half_turn(sine: Array) -> Complex:
    """Return exp(i k/2) for sin(k/2); for sin(k/2) > 1, the value of the decaying wave."""
    travelling = np.sqrt(np.maximum(1 - sine**2, 0))
    decaying = -1j * np.sqrt(np.maximum(sine**2 - 1, 0))
    return np.where(sine <= 1, travelling, decaying) + 1j * sine
