"""Bands of linear waves in periodic chains, and modes of finite chains in the gaps.

A cell is repeated infinitely, and the phase of a wave changes by the wavenumber from cell to cell.
The matrix B maps displacements, times the roots of the masses, to extensions of the contacts, times
the roots of their stiffnesses. Frequencies are the singular values of B, so that the lowest is as
accurate as the highest.

At a real frequency the wavenumber is complex in a gap, and in a damped chain. Its imaginary part is
the decay of the amplitude from cell to cell, as an exponent. Damping is included by the springs
``k (1 - i w A)`` and the masses ``m (1 + i gamma / w)``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..chain.chain import Chain
from ..chain.contact_law import Contacts, pair_value
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish, prefixed
from ..util.tabular import NamedColumn, Tabular, number_columns
from .domain import NEGLIGIBLE, real, require
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


@dataclass(frozen=True, eq=False)
class Cell:
    """Masses and springs of a repeating cell: grains, the contact below each, and resonators.

    Parameters
    ----------
    masses : (P,) array_like
        Masses of the grains, kg.
    stiffness : (P,) array_like
        Stiffnesses of the contacts below the grains, N/m; the last one is the contact with the next
        cell.
    resonators : (P, 2) array_like, optional
        Mass, kg, and stiffness, N/m, of an oscillator on each grain; a mass of 0 stands for no
        oscillator. See L. Bonanomi, G. Theocharis and C. Daraio, Phys. Rev. E 91, 033208 (2015).
    viscoelastic : float or (P,) array_like
        Viscoelastic times A of the contacts, s. Resonators are not damped.
    drag : float or (P,) array_like
        Drag rates gamma of the grains, 1/s.
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
            If the chain is under gravity, or neither compressed nor bonded.
        """
        uniform = "must be 0: contacts that stiffen with depth do not repeat"
        require(
            ("gravity", chain.gravity == 0, uniform),
            ("top_load", chain.compressed, "must be above 0: nothing is linear without it"),
        )
        chain.refuse_loose("theory of bands")
        # The last contact has the ratio of given constants to those of Hertz's law; a single grain
        # has none. A law with its own constant and parameters applies them here as at a wall.
        ends = [-2, -1, 0][-chain.grains - 1 :]
        d = chain.diameters[ends]
        modulus = chain.by_grain("plane_strain_modulus")[ends]
        length = (d[:-1] + d[1:]) / 2
        natural = chain.law.constant(pair_value(modulus), pair_value(d / 2), length)
        constant = natural[-1:] * np.prod(chain.contact_constants[-1:] / natural[:-1])
        if chain.law.given_constant is not None:
            constant = chain.law.given_constant[-1:]
        law = chain.contact_law.of(np.array([chain.grains]))
        closing = Contacts.at_rest(constant, np.array([chain.top_load]), law)
        stiffness = np.append(chain.linear_stiffness, closing.stiffness)
        # The closing contact has the viscosity of the contact next to it, like a wall contact.
        viscosity = chain.contact_viscosity[1:]
        chain.refuse_ground_without_modes("theory of bands")
        damping = {"viscoelastic": viscosity, "drag": chain.drag}
        return cls(chain.masses, stiffness, **damping, ground=chain.ground_stiffness)


@dataclass(frozen=True, eq=False, repr=False)
class Bands(Shown, Tabular):
    """Frequencies of waves in a periodic chain, sorted by branch.

    Attributes
    ----------
    cell : Cell
        The repeating cell.
    wavenumber : (K,) array
        Wavenumbers, radians per cell.
    frequency : (B, K) array
        Frequencies, rad/s, ascending. In NumPy functions the object itself stands for this array.
    group_velocity : (B, K) array
        Group velocities, cells per second, positive where the branch rises. At wavenumber 0 they
        are the limits from above.
    gaps : (G, 2) array
        Edges of the gaps between branches, rad/s, as returned by the function `gaps`.
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
        """Return modes per cell and rad/s at frequencies, (F,) rad/s: 0 in gaps, infinite at edges.

        It is ``1 / (pi |v|)`` with the group velocity v of the only branch at this frequency.
        """
        w = real(frequency, "frequency")
        require(("frequency", np.isfinite(w), "must be finite"))
        cosine = _half_trace(self.cell, w)
        # The wavenumber is complex in a gap, where the cosine exceeds 1 or is no number.
        inside = np.abs(cosine) <= 1
        bands = branches(self.cell, np.arccos(np.where(inside, cosine, 0.0)).ravel())
        nearest = np.abs(bands.frequency - w.ravel()).argmin(0)
        v = np.take_along_axis(bands.group_velocity, nearest[None], 0)[0].reshape(w.shape)
        with np.errstate(divide="ignore"):
            return np.where(inside, 1 / (np.pi * np.abs(v)), 0.0)

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
        Displacements of every mode, orthonormal in mass.
    participation : (L,) array
        Effective number of grains that take part: the inverse of the sum of the squares of their
        shares in the kinetic energy.
    centre : (L,) array
        Mean number of the grains, weighted by these shares. It is near 1 or M for surface modes.
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
        The repeating cell.
    frequency : (F,) array
        Frequencies, rad/s.
    wavenumber : (F,) complex array
        Wavenumbers q, radians per cell. The real part is below 0 if phases travel upward; the
        imaginary part is 0 or more.
    attenuation : (F,) array
        Attenuation per grain: the amplitude falls by the factor ``exp(-attenuation)`` from a grain
        to the next, averaged over a cell.
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

    For weak damping with uniform A and gamma, the attenuation per cell is ``(A w^2 + gamma) / 2``
    divided by the group velocity.

    Parameters
    ----------
    cell : Cell or Chain
        All grains of the chain are one cell, under its load.
    frequency : (F,) array_like
        Frequencies, rad/s, above 0.

    Returns
    -------
    Waves
        Wavenumbers and attenuations.

    Raises
    ------
    InputError
        If a frequency is not above 0, or if the cell is not valid.

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
    # Nothing moves beyond a grain whose undamped resonator is driven at its own frequency.
    still = ~np.isfinite(square)
    q = 2 * np.arcsin(np.sqrt(np.where(still, 0.0, square) + 0j))
    q = np.where(q.imag < 0, -q, q) if cell.damped else np.abs(q.real) + 1j * np.abs(q.imag)
    q = np.where(still, complex(0.0, np.inf), q)
    return Waves(cell, w, q, q.imag / np.size(cell.masses))


def branches(cell: Cell | Chain, wavenumber: ArrayLike) -> Bands:
    """Return the Bloch branches of the periodic chain of a cell.

    See L. Brillouin, Wave Propagation in Periodic Structures (1946), and for dimers of spheres N.
    Boechler et al., Phys. Rev. Lett. 104, 244302 (2010).

    Parameters
    ----------
    cell : Cell or Chain
        All grains of the chain are one cell, under its load.
    wavenumber : (K,) array_like
        Wavenumbers, radians per cell.

    Returns
    -------
    Bands
        Frequencies and group velocities of all branches.

    Raises
    ------
    InputError
        If there is not one positive mass and stiffness for each grain, if the chain is not a cell,
        or if it is damped. Damped chains have complex wavenumbers at real frequencies, see `waves`.

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
    require(("wavenumber", np.isfinite(q), "must be finite"))
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

    Each branch rises or falls from the wavenumber 0 to pi, so that the edges of the bands are at
    these two wavenumbers.

    Parameters
    ----------
    cell : Cell or Chain
        All grains of the chain are one cell, under its load.

    Returns
    -------
    (G, 2) array
        Lower and upper edges, rad/s.
    """
    outside = _outside(cell)
    between: Array = outside[(outside[:, 0] > 0) & (outside[:, 1] < np.inf)]
    return between


def repeating(chain: Chain, first: int = 1, last: int | None = None, most: int = 8) -> int:
    """Return the period of masses, contacts and ground in grains; 1 if they never repeat.

    Parameters
    ----------
    chain : Chain
        The chain to check.
    first : int
        Number of the first grain that is considered.
    last : int
        Number of the last grain that is considered; by default the last of the chain.
    most : int
        Longest period that is tried, in grains.

    Returns
    -------
    int

    Examples
    --------
    >>> repeating(Chain(grains=9, material=["steel", "ptfe", "glass"] * 3, diameter=1e-3))
    3
    """
    last = chain.grains if last is None else last
    grains = slice(first - 1, last)
    contacts = slice(first - 1, last - 1)
    rows = [np.log(chain.masses[grains]), np.log(chain.contact_constants[contacts])]
    # Parameters and stiffnesses may be 0 or negative.
    listed_values = [x[contacts] for x in chain.law.parameters if np.ndim(x)]
    for x in (*listed_values, chain.ground_stiffness[grains]):
        rows.append(x / (np.abs(x).max(initial=0.0) or 1.0))
    for period in range(1, min(most, (last - first + 1) // 2) + 1):
        if all(np.abs(x[period:] - x[:-period]).max(initial=0.0) < NEGLIGIBLE for x in rows):
            return period
    return 1


def gap_modes(chain: Chain, cell: Cell | Chain) -> GapModes:
    """Return a chain's eigenmodes in the gaps, above or below the bands of a repeating cell.

    Parameters
    ----------
    chain : Chain
        A compressed chain with any ends and defects.
    cell : Cell or Chain
        The repeating cell. All grains of a chain are one cell, under its load.

    Returns
    -------
    GapModes
        Frequencies and shapes of the modes.

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
    """Return the gaps and the range above the highest band, (G + 1, 2) rad/s.

    On a ground, the range below the lowest band comes first, (G + 2, 2).
    """
    cell = _lossless(cell)
    b, _ = _extensions(cell, np.array([0.0, np.pi]))
    edges = np.sort(np.linalg.svd(b, compute_uv=False), axis=1)
    # A branch may increase or decrease between the two wavenumbers.
    low = edges.min(0)
    high = edges.max(0)
    between = np.column_stack((np.append(0.0, high), np.append(low, np.inf)))
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
    carried = resonators.shape == (m.size, 2) and _not_negative(resonators)
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
    masses : (..., P) array
        Masses, kg.
    stiffness : (..., P) array
        Stiffnesses, N/m.
    turn : (K,) array
        Phase factors exp(i wavenumber) from a cell to the next.
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

    The result is real without damping.
    """
    m, k, resonators = _check_cell(cell)
    w_flat = w.ravel()
    square = w_flat**2
    # The inertia of a grain, force over displacement, includes its resonator and the ground.
    inertias = m[:, None] * square - _check_ground(cell)[:, None]
    springs = np.broadcast_to(k[:, None], (k.size, w.size))
    if cell.damped:
        viscosity, drag = _check_damping(cell)
        inertias = inertias + 1j * (m * drag)[:, None] * w_flat
        springs = springs * (1 - 1j * viscosity[:, None] * w_flat)
    # The result is infinite or no number at the frequency of a resonator.
    with np.errstate(divide="ignore", invalid="ignore"):
        for grain, mass, stiffness in resonators:
            inertias[int(grain)] += mass * square / (1 - square * mass / stiffness)
        return _trace(inertias, springs).reshape(w.shape)


def _trace(inertias: NDArray[Any], springs: NDArray[Any]) -> NDArray[Any]:
    """Return the trace of the transfer matrix minus the identity, (F,), for P grains (P, F)."""
    # The identity is subtracted from the transfer matrix of displacement and force, because it
    # would hide the digits of long waves.
    change = np.zeros((inertias.shape[1], 2, 2), inertias.dtype)
    for inertia, stiff in zip(inertias, springs, strict=True):
        force = np.zeros_like(change)
        force[:, 1, 0] = inertia
        stretch = np.zeros_like(change)
        stretch[:, 0, 1] = -1 / stiff
        for step in (force, stretch):
            change = change + step + step @ change
    return change.trace(axis1=1, axis2=2)


def _not_negative(values: Array) -> bool:
    """Return whether all values are finite and 0 or more."""
    return bool((values >= 0).all() and np.isfinite(values).all())


def _check_ground(cell: Cell) -> Array:
    """Return the stiffness of the ground under the grains of a cell, (P,)."""
    size = np.size(cell.masses)
    ground = real(cell.ground, "ground")
    fits = ground.shape in ((), (size,)) and _not_negative(ground)
    require(("ground", fits, f"must be 0 or more, one number or {size}"))
    return np.broadcast_to(ground, size)


def _check_damping(cell: Cell) -> tuple[Array, Array]:
    """Return A and gamma of a cell, (P,) each."""
    size = np.size(cell.masses)
    values = []
    for key in ("viscoelastic", "drag"):
        x = real(getattr(cell, key), key)
        fits = x.shape in ((), (size,)) and _not_negative(x)
        require((key, fits, f"must be 0 or more, one number or {size}"))
        values.append(np.broadcast_to(x, size))
    return values[0], values[1]


def local_bands(chain: Chain) -> Array:
    """Return the edges of the bands around every grain, (N, B, 2) rad/s.

    They are the band edges of the cell that repeats around the grain. If no cell repeats, the bands
    are those of a uniform chain of such grains with the contact below, or above for the last grain.
    All edges are 0 in a sonic vacuum. For a single grain both edges are its frequency between the
    walls.
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
