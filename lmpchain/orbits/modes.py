"""Nonlinear normal modes from linear ones, and breathers from the limit of fixed heavy grains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import roots_legendre

from ..chain.chain import Chain
from ..errors import InputError, RunFailed
from ..util.arrays import Array
from ..util.validation import check_positive
from .continuation import follow
from .family import Family
from .orbit import Orbit
from .search import check_number, find, linear_mode


@dataclass(frozen=True)
class KnownLimits:
    """Parameters of the known limits from which families start.

    Attributes
    ----------
    strain : float
        Strain of a small orbit.
    slow : float
        Frequency relative to the band edge, below which harmonics are nearly resonant and smaller
        orbits are used.
    heavy : float
        Factor by which masses are increased so that grains hardly move.
    alone : tuple of float
        Smallest and largest amplitude of a grain between two fixed grains, relative to the overlap.
    """

    strain: float = 1e-2
    slow: float = 0.2
    heavy: float = 1e3
    alone: tuple[float, float] = (1e-4, 1e2)


ORBIT_LIMITS = KnownLimits()


def normal_mode(chain: Chain, mode: int, energy: float, *, progress: bool = False) -> Orbit:
    """Return the nonlinear normal mode of this energy that continues a linear mode.

    See A. F. Vakakis et al., Normal Modes and Localization in Nonlinear Systems (1996). If the mode
    at the edge of a band softens, it becomes a breather in the gap below; see G. Theocharis et al.,
    Phys. Rev. E 82, 056604 (2010).

    Parameters
    ----------
    chain : Chain
    mode : int
        Number of the mode, from 1 in the order of frequencies, as in `lmpchain.theory.modes`.
    energy : float
        Energy above rest, J.
    progress : bool
        Whether to show a progress bar; low modes of long chains take the longest.

    Returns
    -------
    Orbit

    Raises
    ------
    InputError
        If the mode does not exist, no contact is compressed, or the energy is not above 0.
    RunFailed
        If the family of the mode does not reach this energy.

    Examples
    --------
    >>> chain = Chain(grains=10, diameter=1e-3, gravity=0.0, top_load=1.0)
    >>> orbit = normal_mode(chain, 9, energy=1e-6)
    >>> orbit.residual < 1e-12, orbit.error < 1e-11
    (True, True)
    """
    family = mode_family(chain, mode, energy, events=False, progress=progress)
    if not family.reached:
        raise RunFailed(f"the family of mode {mode} does not reach {energy:g} J: {family.ended}")
    return find(chain, family[-1], energy=energy)


def mode_family(
    chain: Chain, mode: int, energy: float, *, events: bool = True, progress: bool = False
) -> Family:
    """Return the family of a nonlinear normal mode, from the linear mode up to an energy.

    Parameters
    ----------
    chain : Chain
    mode, energy
        See `normal_mode`.
    events, progress : bool
        See `follow`.

    Returns
    -------
    Family

    Raises
    ------
    InputError
        If the mode does not exist, no contact is compressed, or the energy is not above 0.
    """
    check_positive("energy", energy)
    displacement, period = linear_mode(chain, mode, ORBIT_LIMITS.strain)
    # A slow mode becomes nearly resonant with its harmonics at smaller amplitudes.
    displacement *= min(1.0, 2 * np.pi / period / (ORBIT_LIMITS.slow * chain.band_edge)) ** 2
    rest = np.zeros(chain.grains)
    linear = float(chain.excess_energy(displacement, rest))
    # The family starts below the requested energy, so that it is continued upward.
    small = min(1.0, float(np.sqrt(0.5 * energy / linear)))
    first = find(chain, (small * displacement, rest), period, energy=linear * small**2)
    return follow(first, "energy", energy, events=events, progress=progress)


def breather(chain: Chain, grain: int, period: float, *, progress: bool = False) -> Orbit:
    """Return the breather around a grain, continued from the limit of fixed heavier grains.

    In this limit the grain oscillates alone. The masses of the heavier grains are then reduced to
    their values in the chain. See R. S. MacKay and S. Aubry, Nonlinearity 7, 1623 (1994).

    Parameters
    ----------
    chain : Chain
    grain : int
        Number of the grain, from 1: a light grain of a dimer, or a light defect.
    period : float
        Period, s; the frequency and its multiples must be outside the linear bands.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Orbit

    Raises
    ------
    InputError
        If the chain is under gravity or not compressed, no neighbour is heavier, or the period is
        impossible for the grain alone.
    RunFailed
        If the breather cannot be continued to the masses of the chain.

    Examples
    --------
    >>> ends = {"gravity": 0.0, "top_load": 20.0, "top": "wall", "bottom": "wall"}
    >>> dimer = Chain(grains=11, diameter=1e-2, material=["steel", "ptfe"] * 5 + ["steel"], **ends)
    >>> orbit = breather(dimer, 6, period=1.53e-4)
    >>> int(np.abs(orbit.displacement).argmax()) + 1, orbit.residual < 1e-12
    (6, True)
    """
    check_positive("period", period)
    check_number("grain", grain, chain.movable)
    mass = chain.masses[grain - 1]
    heavier = chain.masses > mass
    if chain.gravity > 0 or not chain.linearisable:
        message = (
            "must be compressed by a top load without gravity, which would change with the masses"
        )
        raise InputError.at("chain", message)
    if not heavier[max(grain - 2, 0) : grain + 1].any():
        message = "has no heavier neighbour, so that no limit exists in which it moves alone"
        raise InputError.at("grain", f"{grain} {message}")

    def chain_at(share: float) -> Chain:
        factor = np.where(heavier, ORBIT_LIMITS.heavy ** (1 - share), 1.0)
        return chain.replace(masses=factor * chain.masses)

    rest = np.zeros(chain.grains)
    displacement = np.zeros(chain.grains)
    stiffness = float(chain.contacts.stiffness[grain - 1 : grain + 1].sum())
    slowest = float(2 * np.pi / np.sqrt(stiffness / mass))
    # A gentle motion with fixed neighbours is slower than the period, but becomes faster when they
    # move.
    gentle = period < slowest
    if gentle:
        displacement[grain - 1] = ORBIT_LIMITS.strain * chain.contacts.overlap[grain]
        energy = float(chain.excess_energy(displacement, rest))
        limit = find(chain_at(0.0), (displacement, rest), slowest, energy=energy)
    else:
        displacement[grain - 1] = amplitude_alone(chain, grain, period)
        limit = find(chain_at(0.0), (displacement, rest), period)
    hold = "energy" if gentle else "period"
    family = follow(limit, chain_at, 1.0, start=0.0, hold=hold, events=False, progress=progress)
    if gentle and family.reached:
        family = follow(family[-1], "period", period, events=False, progress=progress)
    if not family.reached:
        raise RunFailed(
            f"the breather of {period:g} s does not reach the masses of the chain: {family.ended}"
        )
    return find(chain, family[-1], period)


def amplitude_alone(chain: Chain, grain: int, period: float) -> float:
    """Return the amplitude of a grain with this period while all others are fixed, m."""
    unit = np.zeros(chain.grains)
    unit[grain - 1] = 1.0
    contacts = chain.contacts
    mass = chain.masses[grain - 1]
    overlap = float(contacts.overlap[grain - 1 : grain + 1].max())
    node, weight = roots_legendre(64)

    def potential(x: Array | float) -> Array:
        return contacts.energy(contacts.closer(np.multiply.outer(x, unit))).sum(-1)

    def excess(logarithm: float) -> float:
        high = overlap * np.exp(logarithm)
        energy = float(potential(high))
        low = brentq(lambda x: float(potential(x)) - energy, -1e3 * high, 0.0, xtol=1e-15 * high)
        # T = 2 int dx / speed; the substitution x = middle + half sin(angle) removes the end
        # singularities.
        half = (high - low) / 2
        angle = np.pi / 2 * node
        x = (high + low) / 2 + half * np.sin(angle)
        # Rounding may make the kinetic energy negative at the ends.
        speed = np.sqrt(2 * np.maximum(energy - potential(x), 1e-30 * energy) / mass)
        return float(2 * (half * np.cos(angle) / speed) @ weight * np.pi / 2 / period - 1)

    amplitudes = np.log(np.geomspace(*ORBIT_LIMITS.alone, 100))
    misses = np.array([excess(amplitude) for amplitude in amplitudes])
    crossing = np.flatnonzero(misses[1:] * misses[:-1] <= 0)
    if not crossing.size:
        shortest = period * (1 + misses.min())
        longest = period * (1 + misses.max())
        message = f"must be between {shortest:.5g} and {longest:.5g} s for grain {grain} alone"
        raise InputError.at("period", f"{message} (got {period:g})")
    return float(overlap * np.exp(brentq(excess, *amplitudes[crossing[0] : crossing[0] + 2])))
