"""Bands of linear waves in periodic chains, and modes of finite chains in the gaps.

A cell is repeated without end, and a wave turns its phase by the wavenumber from cell to cell. The
rows of B are the extensions of the contacts, each by the root of its stiffness, of displacements by
the roots of the masses: frequencies are the singular values of B, the lowest as accurate as the
highest.

At a real frequency the wavenumber of a damped chain, or in a gap, is complex: its imaginary part is
what the amplitude falls by from cell to cell. Its springs then are ``k (1 - i w A)``, its masses
``m (1 + i gamma / w)``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..chain.chain import Chain
from ..chain.contacts import Contacts, pair_value
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish, prefixed
from ..util.tabular import NamedColumn, Tabular, number_columns
from .domain import real, require
from .modes import eigenmodes, ground_of

__dir__ = listed(__name__)
__all__ = [
    "Bands",
    "Cell",
    "GapModes",
    "Waves",
    "branches",
    "gap_modes",
    "gaps",
    "repeating",
    "waves",
]

# Relative width of a gap, and relative difference of grains, that count as 0.
NEGLIGIBLE = 1e-9


@dataclass(frozen=True, eq=False)
class Cell:
    """Masses and springs of a repeating cell: grains, the contact below each, and resonators.

    Parameters
    ----------
    masses, stiffness : (P,) array_like
        kg and N/m; the last contact is that with the next cell.
    resonators : (P, 2) array_like, optional
        Mass, kg, and stiffness, N/m, of an oscillator that each grain carries; mass 0 for none. For
        such chains L. Bonanomi, G. Theocharis and C. Daraio, Phys. Rev. E 91, 033208 (2015).
    viscoelastic, drag : float or (P,) array_like
        A of the contacts, s, and gamma of the grains, 1/s; resonators are not damped.
    ground : float or (P,) array_like
        Stiffness of a spring between each grain and the ground, N/m.

    Examples
    --------
    >>> branches(Cell([1.0, 3.0], [1.0, 1.0]), np.pi).frequency.ravel().round(12).tolist()
    [0.816496580928, 1.414213562373]
    """

    masses: ArrayLike
    stiffness: ArrayLike
    resonators: ArrayLike | None = None
    viscoelastic: ArrayLike = 0.0
    drag: ArrayLike = 0.0
    ground: ArrayLike = 0.0

    @property
    def damped(self) -> bool:
        """Whether contacts or a drag dissipate energy."""
        return bool(np.any(self.viscoelastic) or np.any(self.drag))

    @classmethod
    def of(cls, chain: Chain) -> Cell:
        """Return all grains of a chain as a cell, with a contact from the last to the first grain.

        Raises
        ------
        InputError
            If the chain is under gravity or not compressed.
        """
        uniform = "must be 0: contacts that stiffen with depth do not repeat"
        require(
            ("gravity", chain.gravity == 0, uniform),
            ("top_load", chain.top_load > 0, "must be above 0: nothing is linear without it"),
        )
        chain.refuse_loose("theory of bands")
        # The last contact has the ratio of given constants to those of Hertz's law; a single grain
        # has none.
        ends = [-2, -1, 0][-chain.grains - 1 :]
        d = chain.diameters[ends]
        modulus = chain.by_grain("plane_strain_modulus")[ends]
        length = (d[:-1] + d[1:]) / 2
        natural = chain.law.constant(pair_value(modulus), pair_value(d / 2), length)
        constant = natural[-1] * np.prod(chain.contact_constants[-1:] / natural[:-1])
        closing = Contacts.at_rest(np.array([constant]), np.array([chain.top_load]), chain.law)
        stiffness = np.append(chain.linear_stiffness, closing.stiffness)
        # The closing contact has the viscosity of the contact next to it, like a wall contact.
        viscosity = chain.contact_viscosity[1:]
        chain.refuse_moving_ground("theory of bands")
        damping = {"viscoelastic": viscosity, "drag": chain.drag}
        return cls(chain.masses, stiffness, **damping, ground=chain.ground_stiffness)


@dataclass(frozen=True, eq=False, repr=False)
class Bands(Shown, Tabular):
    """Frequencies of waves in a periodic chain, sorted by branch.

    Attributes
    ----------
    cell : Cell
    wavenumber : (K,) array
        Radians a cell.
    frequency : (B, K) array
        Frequencies, rad/s, ascending; numpy takes the object itself for this array.
    group_velocity : (B, K) array
        Cells a second; the limit from above at wavenumber 0, positive where the branch rises.
    gaps : (G, 2) array
        rad/s, between branches; `gaps` of the module.
    """

    cell: Cell
    wavenumber: Array
    frequency: Array
    group_velocity: Array
    gaps: Array

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray:
        return np.array(self.frequency, dtype=dtype)

    def __getitem__(self, key: Any) -> Any:
        return self.frequency[key]

    def density_of_states(self, frequency: ArrayLike) -> Array:
        """Return modes per cell and rad/s at frequencies, (F,) s: 0 in gaps, infinite at edges.

        ``1 / (pi |v|)`` with the group velocity v of the one branch that is there.
        """
        w = real(frequency, "frequency")
        cosine = _half_trace(self.cell, w)
        bands = branches(self.cell, np.arccos(np.clip(cosine, -1, 1)).ravel())
        nearest = np.abs(bands.frequency - w.ravel()).argmin(0)
        v = np.take_along_axis(bands.group_velocity, nearest[None], 0)[0].reshape(w.shape)
        # The wavenumber is complex in a gap, where the cosine exceeds 1.
        with np.errstate(divide="ignore"):
            return np.where(np.abs(cosine) <= 1, 1 / (np.pi * np.abs(v)), 0.0)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the branches over wavenumber and shade the gaps between them; return the axes."""
        ax = chart(ax, "wavenumber (radians a cell)", "frequency [Hz]")
        order = np.argsort(self.wavenumber)
        for number, branch in enumerate(self.frequency, 1):
            ax.plot(self.wavenumber[order], branch[order] / (2 * np.pi), label=f"branch {number}")
        for low, high in self.gaps / (2 * np.pi):
            ax.axhspan(low, high, color="0.9", lw=0)
        ax.set(ylim=(0, None))
        return finish(ax)

    def _columns(self) -> Iterator[NamedColumn]:
        branches = range(1, len(self.frequency) + 1)
        yield NamedColumn("wavenumber", "", self.wavenumber)
        yield from number_columns("frequency", "rad/s", branches, self.frequency.T)
        yield from number_columns("group_velocity", "cells/s", branches, self.group_velocity.T)


@dataclass(frozen=True, eq=False, repr=False)
class GapModes(Shown, Tabular):
    """Eigenmodes of a finite chain outside the bands of its cell, at ends or irregular grains.

    Attributes
    ----------
    frequency : (L,) array
        Frequencies, rad/s, ascending.
    shape : (L, M) array
        Displacements, orthonormal in mass.
    participation : (L,) array
        Number of grains that take part, 1 / sum of the squares of their shares in the kinetic
        energy.
    centre : (L,) array
        Mean grain, weighted by these shares: near 1 or M for surface modes.
    """

    _units: ClassVar[dict[str, str]] = {"frequency": "rad/s", "participation": "", "centre": ""}

    frequency: Array
    shape: Array
    participation: Array
    centre: Array

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw each mode's displacements relative to the largest one; return the axes."""
        ax = chart(ax, "grain", "displacement over the largest")
        for w, shape, number in zip(self.frequency, self.shape, self.participation, strict=True):
            label = f"{prefixed(w / (2 * np.pi), 'Hz')}, {number:.1f} grains"
            grain = np.arange(1, shape.size + 1)
            ax.plot(grain, shape / np.abs(shape).max(), ".-", lw=1, label=label)
        return finish(ax)


@dataclass(frozen=True, eq=False, repr=False)
class Waves(Shown, Tabular):
    """Waves ``exp(i (q n - w t))`` of real frequencies with energy flow or decay downward.

    Attributes
    ----------
    cell : Cell
    frequency : (F,) array
        Frequencies, rad/s.
    wavenumber : (F,) complex array
        q, radians a cell; its real part is below 0 where phases run upward, its imaginary part 0 or
        more.
    attenuation : (F,) array
        A grain: the amplitude falls by ``exp(-attenuation)`` from each to the next, in the mean
        over a cell.
    """

    _units: ClassVar[dict[str, str]] = {"frequency": "rad/s", "wavenumber": "", "attenuation": ""}

    cell: Cell
    frequency: Array
    wavenumber: NDArray[np.complex128]
    attenuation: Array

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the attenuation over frequency, and return the axes."""
        ax = chart(ax, "frequency [Hz]", "attenuation a grain")
        ax.plot(self.frequency / (2 * np.pi), self.attenuation)
        ax.set(ylim=(0, None))
        return ax


def waves(cell: Cell | Chain, frequency: ArrayLike) -> Waves:
    """Return the wave at each real frequency in a periodic chain, with damping or in a gap.

    Where damping is weak, the attenuation a cell is ``(A w^2 + gamma) / 2`` over the group
    velocity, for one A and one gamma.

    Parameters
    ----------
    cell : Cell or Chain
        All grains of the chain are one cell, under its load.
    frequency : (F,) array_like
        rad/s, above 0.

    Returns
    -------
    Waves

    Raises
    ------
    InputError
        If a frequency is not above 0, or what is given is not a cell.

    Examples
    --------
    >>> ends = {"gravity": 0.0, "top_load": 20.0, "damping": {"viscoelastic": 1e-7}}
    >>> steel = Chain(grains=1, material="steel", diameter=1e-2, bottom="wall", **ends)
    >>> waves(steel, 2 * np.pi * np.array([1e3, 5e3])).attenuation.round(6).tolist()
    [3.3e-05, 0.000855]
    """
    cell = Cell.of(cell) if isinstance(cell, Chain) else cell
    w = np.atleast_1d(real(frequency, "frequency"))
    require(("frequency", (w > 0) & np.isfinite(w), "must be finite and above 0"))
    # The formula with sin^2(q / 2) is accurate for long waves.
    square = -_excess_trace(cell, w) / 4
    q = 2 * np.arcsin(np.sqrt(square + 0j))
    q = np.where(q.imag < 0, -q, q) if cell.damped else np.abs(q.real) + 1j * np.abs(q.imag)
    return Waves(cell, w, q, q.imag / np.size(cell.masses))


def branches(cell: Cell | Chain, wavenumber: ArrayLike) -> Bands:
    """Return the Bloch branches of the periodic chain of a cell.

    L. Brillouin, Wave Propagation in Periodic Structures (1946); for dimers of spheres N. Boechler
    et al., Phys. Rev. Lett. 104, 244302 (2010).

    Parameters
    ----------
    cell : Cell or Chain
        All grains of the chain are one cell, under its load.
    wavenumber : (K,) array_like
        Radians a cell.

    Returns
    -------
    Bands

    Raises
    ------
    InputError
        If masses or stiffnesses are not above 0 or not one a grain, or a chain is not a cell. If it
        is damped: its waves have real frequencies and complex wavenumbers, see `waves`.

    Examples
    --------
    >>> ends = {"gravity": 0.0, "top_load": 20.0}
    >>> dimer = Chain(grains=2, material=["steel", "ptfe"], diameter=1e-2, **ends)
    >>> bands = branches(dimer, [0.0, np.pi])
    >>> (bands.gaps / (2 * np.pi)).round().tolist()
    [[3484.0, 6644.0]]
    """
    cell = _lossless(cell)
    q = np.atleast_1d(real(wavenumber, "wavenumber"))
    b, slope = _extensions(cell, q)
    left, frequency, right = np.linalg.svd(b, full_matrices=False)
    # First-order perturbation of a singular value.
    product = np.einsum("kis,kij,ksj->ks", left.conj(), slope, right.conj())
    # The phases of both vectors are arbitrary at frequency 0.
    soft = frequency <= NEGLIGIBLE * np.abs(slope).max(initial=0.0)
    velocity = np.where(soft, np.abs(product), product.real)
    # Singular values are in descending order, branches in ascending order.
    return Bands(cell, q, frequency.T[::-1], velocity.T[::-1], gaps(cell))


def gaps(cell: Cell | Chain) -> Array:
    """Return the gaps between the bands of the periodic chain of a cell, (G, 2) rad/s.

    The edges of the bands are at the wavenumbers 0 and pi, a branch rising from one to the other or
    falling.

    Parameters
    ----------
    cell : Cell or Chain

    Returns
    -------
    (G, 2) array
        rad/s.
    """
    return _outside(cell)[:-1]


def repeating(chain: Chain, first: int = 1, last: int | None = None, most: int = 8) -> int:
    """Return the period in grains of masses and contact constants; 1 if they never repeat.

    Parameters
    ----------
    chain : Chain
    first, last : int
        Grains between which to look; by default all.
    most : int
        Longest period that is looked for.

    Returns
    -------
    int

    Examples
    --------
    >>> repeating(Chain(grains=9, material=["steel", "ptfe", "glass"] * 3, diameter=1e-3))
    3
    """
    last = chain.grains if last is None else last
    rows = [
        np.log(chain.masses[first - 1 : last]),
        np.log(chain.contact_constants[first - 1 : last - 1]),
    ]
    for period in range(1, min(most, (last - first + 1) // 2) + 1):
        if all(np.abs(x[period:] - x[:-period]).max(initial=0.0) < NEGLIGIBLE for x in rows):
            return period
    return 1


def gap_modes(chain: Chain, cell: Cell | Chain) -> GapModes:
    """Return a chain's eigenmodes in the gaps or above the bands of a repeating cell.

    Parameters
    ----------
    chain : Chain
        Compressed, with any ends and defects.
    cell : Cell or Chain

    Returns
    -------
    GapModes

    Examples
    --------
    >>> host = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
    >>> light = Chain(grains=41, **host, impurity=[{"grain": 20, "diameter": 0.7e-3}])
    >>> modes = gap_modes(light, Chain(grains=2, **host))
    >>> f"{modes.participation[0]:.2f} grains around {modes.centre[0]:.0f}"
    '1.57 grains around 20'
    """
    chain.refuse_damping("a mode in a gap")
    modes = eigenmodes(chain)
    low, high = _outside(cell).T[..., None]
    # Modes at a band edge belong to the band.
    margin = NEGLIGIBLE * modes.frequency[-1]
    inside = ((modes.frequency > low + margin) & (modes.frequency < high - margin)).any(0)
    shape = modes.shape[:, inside].T
    share = modes.mass * shape**2
    grain = np.arange(1, modes.mass.size + 1)
    return GapModes(modes.frequency[inside], shape, 1 / (share**2).sum(1), share @ grain)


def _lossless(cell: Cell | Chain) -> Cell:
    """Return the cell; raise `InputError` if it has damping, so that frequencies are complex."""
    if isinstance(cell, Chain):
        cell.refuse_damping("a band")
        return Cell.of(cell)
    cure = "must have no damping: leave it out, or see waves at real frequencies"
    require(("cell", not cell.damped, cure))
    return cell


def _outside(cell: Cell | Chain) -> Array:
    """Return the gaps and the range above the highest band, (G + 1, 2) rad/s."""
    cell = _lossless(cell)
    b, _ = _extensions(cell, np.array([0.0, np.pi]))
    edges = np.sort(np.linalg.svd(b, compute_uv=False), axis=1)
    # A branch may increase or decrease between the two wavenumbers.
    low = edges.min(0)
    high = edges.max(0)
    between = np.column_stack((high, np.append(low[1:], np.inf)))
    return between[between[:, 1] - between[:, 0] > NEGLIGIBLE * high[-1]]


def _check_cell(cell: Cell) -> tuple[Array, Array, Array]:
    """Return masses and stiffness, (P,), and resonators, (R, 3): grain index, mass, stiffness."""
    m = real(cell.masses, "masses")
    k = real(cell.stiffness, "stiffness")
    resonators = (
        np.zeros((m.size, 2)) if cell.resonators is None else real(cell.resonators, "resonators")
    )

    def positive(x: Array) -> bool:
        return bool((x > 0).all() and np.isfinite(x).all())

    masses = m.ndim == 1 and m.size > 0 and positive(m)
    carried = resonators.shape == (m.size, 2) and (resonators >= 0).all()
    require(
        ("masses", masses, "must be above 0, one per grain"),
        ("stiffness", k.shape == m.shape and positive(k), "must be above 0, one per grain"),
        ("resonators", carried, "must be (mass, stiffness), one per grain"),
    )
    # Mass 0 represents a grain without a resonator.
    grains = np.flatnonzero(resonators[:, 0])
    return m, k, np.column_stack((grains, resonators[grains]))


def _extensions(cell: Cell, q: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return B and dB/dq for wavenumber q, (K, P + R + G, P + R) for G ground springs."""
    m, k, resonators = _check_cell(cell)
    ground = _check_ground(cell)
    size = m.size
    total = size + len(resonators)
    turn = np.exp(1j * q)
    held = np.flatnonzero(ground)
    b, slope = np.zeros((2, q.size, total + held.size, total), complex)
    b[:, :size, :size] = extensions(m, k, turn)
    # Only the last contact depends on the wavenumber.
    slope[:, size - 1, 0] = -1j * (np.sqrt(k[-1] / m[0]) * turn)
    for row, (grain, mass, stiffness) in enumerate(resonators, size):
        b[:, row, row] = np.sqrt(stiffness / mass)
        b[:, row, int(grain)] = -np.sqrt(stiffness / m[int(grain)])
    b[:, np.arange(total, total + held.size), held] = np.sqrt(ground[held] / m[held])
    return b, slope


def extensions(masses: Array, stiffness: Array, turn: NDArray[Any]) -> NDArray[Any]:
    """Return B of cells without resonators, (..., K, P, P).

    Parameters
    ----------
    masses, stiffness : (..., P) arrays
        kg and N/m.
    turn : (K,) array
        exp(i wavenumber), by which the next cell is ahead.
    """
    size = masses.shape[-1]
    b = np.zeros((*masses.shape[:-1], turn.size, size, size), turn.dtype)
    for i in range(size):
        below = (i + 1) % size
        b[..., i, i] += np.sqrt(stiffness[..., i] / masses[..., i])[..., None]
        coupling = np.sqrt(stiffness[..., i] / masses[..., below])[..., None]
        # Both terms share one entry if the cell has one grain.
        b[..., i, below] -= coupling * (turn if i == size - 1 else 1.0)
    return b


def _half_trace(cell: Cell, w: Array) -> Array:
    """Return cos(wavenumber) at frequencies, half the trace of a cell's transfer matrix."""
    return 1 + _excess_trace(cell, w) / 2


def _excess_trace(cell: Cell, w: Array) -> NDArray[Any]:
    """Return 2 cos(wavenumber) - 2 at frequencies, from the transfer matrix minus the identity.

    Real without damping.
    """
    m, k, resonators = _check_cell(cell)
    w_flat = w.ravel()
    square = w_flat**2
    # The dynamic mass of a grain includes the force of its resonator.
    dynamic = np.broadcast_to(m[:, None], (m.size, w.size)).copy()
    springs = np.broadcast_to(k[:, None], (k.size, w.size))
    if cell.damped:
        viscosity, drag = _check_damping(cell)
        dynamic = dynamic * (1 + 1j * drag[:, None] / w_flat)
        springs = springs * (1 - 1j * viscosity[:, None] * w_flat)
    ground = _check_ground(cell)
    if ground.any():
        dynamic = dynamic - ground[:, None] / square
    with np.errstate(divide="ignore", invalid="ignore"):
        for grain, mass, stiffness in resonators:
            dynamic[int(grain)] += mass / (1 - square * mass / stiffness)
    # The identity is subtracted from the transfer matrix of displacement and force, because it
    # would hide the digits of long waves.
    change = np.zeros((w.size, 2, 2), dynamic.dtype)
    for inertia, stiff in zip(dynamic, springs, strict=True):
        force = np.zeros_like(change)
        force[:, 1, 0] = inertia * square
        stretch = np.zeros_like(change)
        stretch[:, 0, 1] = -1 / stiff
        for step in (force, stretch):
            change = change + step + step @ change
    return change.trace(axis1=1, axis2=2).reshape(w.shape)


def _check_ground(cell: Cell) -> Array:
    """Return the stiffness of the ground under the grains of a cell, (P,)."""
    size = np.size(cell.masses)
    ground = real(cell.ground, "ground")
    fits = ground.shape in ((), (size,)) and bool((ground >= 0).all())
    require(("ground", fits, f"must be 0 or more, one number or {size}"))
    return np.broadcast_to(ground, size)


def _check_damping(cell: Cell) -> tuple[Array, Array]:
    """Return A and gamma of a cell, (P,) each."""
    size = np.size(cell.masses)
    values = []
    for key in ("viscoelastic", "drag"):
        x = real(getattr(cell, key), key)
        fits = x.shape in ((), (size,)) and bool((x >= 0).all() and np.isfinite(x).all())
        require((key, fits, f"must be 0 or more, one number or {size}"))
        values.append(np.broadcast_to(x, size))
    return values[0], values[1]


def local_bands(chain: Chain) -> Array:
    """Return the edges of the bands around every grain, (N, B, 2) rad/s.

    They are those of the cell that repeats around it. Where no cell repeats it is a uniform chain
    of such grains with the contact below, for the last grain that above. All are 0 in a sonic
    vacuum. A single grain has its frequency between the walls.
    """
    if chain.grains == 1:
        stiffness = chain.contacts.stiffness.sum() + ground_of(chain)[0]
        return np.full((1, 1, 2), np.sqrt(stiffness / chain.masses[0]))
    number = np.arange(chain.grains)
    period = repeating(chain)
    start = np.minimum(number, chain.grains - 1 - period)[:, None] + np.arange(period)
    grains = start if period > 1 else number[:, None]
    m = chain.masses[grains]
    k = chain.linear_stiffness[start]
    # Bands have their edges at the wavenumbers 0 and pi.
    b = extensions(m, k, np.array([1.0, -1.0]))
    if chain.ground is not None:
        held = np.sqrt(ground_of(chain)[grains] / m)[:, None, :, None] * np.eye(m.shape[1])
        b = np.concatenate((b, np.broadcast_to(held, b.shape)), axis=2)
    edges = np.sort(np.linalg.svd(b, compute_uv=False), axis=2)
    return np.sort(edges.transpose(0, 2, 1), axis=2)
