"""How chains are laid out for the compiled loops, and where they move at first, compiled."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from .contact_forces import compiled_filler
from .layout import PAD, STATE, Links

UNBOUNDED = 1e300  # J, where nothing bounds the energy


def _rows(kinds: int, count: int, grains: int) -> Array:
    """Return (kinds, count, W) zeros of which every row begins at a cache line."""
    width = (2 * PAD + grains + PAD - 1) // PAD * PAD
    size = kinds * count * width
    memory = np.zeros(size + PAD)
    skip = -(memory.ctypes.data // memory.itemsize) % PAD
    return memory[skip : skip + size].reshape((kinds, count, width))


class AtRest(NamedTuple):
    """Contacts of R chains at rest, (R, N+1) arrays, and whether the chains carry a force there.

    Overlap, m, force, N, constant, N/m^delta, and stiffness, N/m.
    """

    overlap: Array
    force: Array
    constant: Array
    stiffness: Array
    compressed: bool


class BatchLayout(NamedTuple):
    """R chains laid out for the compiled loops.

    Attributes
    ----------
    inverse_length, strength, inverse_mass : (R, W) arrays
        1 / length and strength of the contact below each body, see `layout.Links`, and 1/kg.
    uncompressed, omega, scale : (R,), (R,) and (R, 2) arrays
        See `layout.Links` and `layout.Chains`.
    units, allowed : (R, 2) and (R,) arrays
        See `ChainBatch`.
    """

    inverse_length: Array
    strength: Array
    inverse_mass: Array
    uncompressed: Array
    omega: Array
    scale: Array
    units: Array
    allowed: Array


def lay_out(at_rest: AtRest, masses: Array, strikes: Array, free: tuple[int, int]) -> BatchLayout:
    """Lay R chains out.

    Parameters
    ----------
    at_rest : AtRest
    masses : (R, N) array
        kg.
    strikes : (R, 4) array
        Highest frequency, rad/s, energy, J, and largest displacement and speed that the excitation
        imposes, m and m/s.
    free : pair of int
        First of the grains, from 0, whose motion is not prescribed, and the one behind the last.

    Returns
    -------
    Layout
    """
    batch, grains = masses.shape
    uncompressed, omega, allowed = np.zeros((3, batch))
    scale, units = np.empty((2, batch, 2))
    inverse_length, strength, inverse_mass = _rows(3, batch, grains)
    layout = BatchLayout(
        inverse_length, strength, inverse_mass, uncompressed, omega, scale, units, allowed
    )
    _fill_layout(layout, at_rest, masses, strikes, free)
    return layout


@compiled_filler()
def _fill_layout(layout, at_rest, masses, strikes, free):
    """Fill a layout, see `lay_out`."""
    inverse_length, strength, inverse_mass, uncompressed, omega, scale, units, allowed = layout
    overlap, force, constant, stiffness, compressed = at_rest
    first, stop = free
    batch, grains = masses.shape
    # the force of a contact in units of that at rest; where nothing is pressed, of K and 1 m
    carried = force if compressed else constant
    for real in range(batch):
        for n in range(grains + 1):
            length = overlap[real, n] if compressed else 1.0
            if length > 0.0:
                inverse_length[real, PAD - 1 + n] = 1.0 / length
                strength[real, PAD - 1 + n] = carried[real, n]
        weight = 0.0
        for n in range(grains):
            weight += masses[real, n]
            if first <= n < stop:
                inverse_mass[real, PAD + n] = 1.0 / masses[real, n]
        if compressed and force[real, 0] == 0.0:
            uncompressed[real] = constant[real, 0]
        fastest, energy, farthest, speed = strikes[real]
        speed = max(speed, farthest * fastest)
        omega[real] = fastest
        scale[real, 0] = speed / fastest
        scale[real, 1] = speed
        # a single grain has a contact with the wall above it, or one with that below
        below = 1 if constant[0, 1] > 0.0 else 0
        # a contact that only touches has no unit
        while compressed and stiffness[real, below] == 0.0 and below < grains:
            below += 1
        length = overlap[real, below]
        unit = length * math.sqrt(stiffness[real, below] / masses[real, 0])
        units[real, 0] = length
        units[real, 1] = unit
        # half as much again may be rounded, and slow motion that nothing puts in
        allowed[real] = min(3.0 * energy + weight * (1e-3 * unit) ** 2, UNBOUNDED)


def place_bodies(
    u: Array,
    v: Array,
    copies: int,
    driven: int,
    reach: NDArray[np.int64],
    links: Links,
    longest: int,
) -> tuple[Array, Array, NDArray[Any]]:
    """Put grains in their rows, and begin to watch them.

    Parameters
    ----------
    u, v : (C, R, N) arrays
        Displacement, m, and velocity, m/s, in R chains: of one copy for all, or of every one of C
        copies.
    copies : int
        How many there are to be.
    driven : int
        Number of grains, from the top, that are put where their motion says: their velocity is 0.
    reach : (R, 2) array
        First and last body that is acted on, the other way round if none is.
    links : layout.Links
    longest : int
        Longest row, in bodies, that is computed as a whole from the beginning; else the window
        begins around what moves.

    Returns
    -------
    x, v : (copies R, W) arrays
        See `layout.Chains`.
    state : (copies R,) array of `layout.STATE`
        At sample 0.
    """
    batch, grains = u.shape[1:]
    x, w = _rows(2, copies * batch, grains)
    state = np.zeros(copies * batch, STATE)
    _fill_places(x, w, state, u, v, driven, reach, links, longest)
    return x, w, state


@compiled_filler()
def _fill_places(x, w, state, u, v, driven, reach, links, longest):
    """Fill rows and state of bodies, see `place_bodies`."""
    sources, batch, grains = u.shape
    width = x.shape[1]
    for row in range(len(x)):
        copy = row // batch % sources
        real = row % batch
        first, last = reach[real]
        if first > last:
            first = width
            last = 0
        # whatever moves or is out of place belongs to the window
        for n in range(grains):
            x[row, PAD + n] = u[copy, real, n]
            if n >= driven:
                w[row, PAD + n] = v[copy, real, n]
            if x[row, PAD + n] != 0.0 or w[row, PAD + n] != 0.0:
                first = min(first, PAD + n)
                last = max(last, PAD + n)
        if first > last:
            first = PAD
            last = PAD
        # to follow the wave costs more than so few grains
        if width <= longest:
            first = PAD
            last = width - PAD - 1
        state[row].first = first // PAD * PAD
        state[row].last = min((last // PAD + 1) * PAD, width - PAD)
        # the smallest r / eps at rest: -1 where a contact is open
        closed = links.precompressed > 0.0 and links.uncompressed[real] == 0.0
        state[row].least_strain = 0.0 if closed else -1.0


def opening_weights(
    links: Links, inverse_mass: Array, omega: Array, scale: Array
) -> tuple[Array, Array]:
    """Return the effect of each contact on the motion as it opens or closes.

    Parameters
    ----------
    links, inverse_mass, omega, scale : Links and arrays
        See `layout.Chains`.

    Returns
    -------
    weight, reach : (R, W) arrays
        The square of that effect, and how near to it no step is shorter; see
        `adaptive_splitting._may_matter`.
    """
    weight, reach = np.zeros((2, *inverse_mass.shape))
    _fill_weights(weight, reach, links, inverse_mass, omega, scale)
    return weight, reach


@compiled_filler()
def _fill_weights(weight, reach, links, inverse_mass, omega, scale):
    """Fill the weights of contacts, see `opening_weights`."""
    batch, width = inverse_mass.shape
    # steps are those for a force that goes as t^(3/2): of one that goes as t^delta, the size of
    # the force at a typical overlap counts
    power = links.coefficients[-1] - 1.5
    for real in range(batch):
        changes = omega[real] ** 2.5 * scale[real, 1] + 1e-300
        typical = scale[real, 0] + 1e-300
        slow = math.sqrt(2.0) * (2.0 * omega[real]) ** 3
        for n in range(width):
            below = inverse_mass[real, n + 1] if n + 1 < width else 0.0
            mobility = max(inverse_mass[real, n], below)
            touching = links.uncompressed[real] if n == PAD - 1 else 0.0
            inverse_length = links.inverse_length[real, n]
            strain = typical * (inverse_length if inverse_length > 0.0 else 1.0)
            pull = (links.strength[real, n] + touching) * strain**power
            weight[real, n] = min(pull * mobility / changes, 1e150) ** 2
            reach[real, n] = np.cbrt(weight[real, n]) / slow
