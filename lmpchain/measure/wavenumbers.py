"""Energy in bands of wavenumber against distance, with exact conservation of the total energy.

The amplitude of a grain is sqrt(m/2) v. The amplitude of a contact is the square root of its energy
with the sign of the change of overlap. The sum of the squares is the energy above rest, also in
strong waves. Windows along the chain, whose squares add up to 1 everywhere, distribute this energy
over distance. The Fourier transform in each window distributes it over wavenumbers, by Parseval's
theorem. In a uniform linear chain, the amplitudes of a grain and of the contact half a grain below
are equal in downward waves and opposite in upward waves. Their sum and difference therefore give
the energies of downward and upward waves.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array, numbers, whole_numbers
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish, prefixed
from ..util.tabular import NamedColumn, Tabular
from .bodies import motion
from .energy import shares

__dir__ = listed(__name__)

NARROWEST = 8  # Smallest number of grains in a window.


@dataclass(frozen=True, eq=False, repr=False)
class EnergyBands(Shown, Tabular):
    """Energy above rest in B bands of wavenumber around P places at T times.

    Attributes
    ----------
    time : (T,) array
        Times, s.
    place : (P,) array
        Centres of the windows, in grains from the top.
    edges : (B+1,) array
        Edges of the bands, radians per grain, 0 to pi.
    energy : (T, P, B) array
        Energies, J; the sum over places and bands is the energy of the chain.
    error : (T, P, B) array
        Uncertainties of the energies due to the error of the trajectory, if it is known, J.
    downward : (T, P, B) array
        Energies of downward waves, J, by linear theory of a uniform chain.
    width : float
        Width of a window, grains.
    """

    time: Array
    place: Array
    edges: Array
    energy: Array
    error: Array
    downward: Array
    width: float

    @property
    def total(self) -> Array:
        """Energy of the chain above rest, (T,) J."""
        return self.energy.sum((1, 2))

    @property
    def resolution(self) -> float:
        """Smallest difference of wavenumbers that a window resolves, radians a grain."""
        return 4 * np.pi / self.width

    def _columns(self) -> Iterator[NamedColumn]:
        time, place = np.meshgrid(self.time, self.place, indexing="ij")
        yield NamedColumn("time", "s", time.ravel())
        yield NamedColumn("place", "", place.ravel())
        for name in ("energy", "error", "downward"):
            values = getattr(self, name)
            for band in range(self.edges.size - 1):
                low, high = self.edges[band : band + 2]
                yield NamedColumn(f"{name}_{low:.4g}_to_{high:.4g}", "J", values[..., band].ravel())

    def plot(self, ax: Axes | None = None, sample: int = -1) -> Axes:
        """Draw the energy per grain of each band against distance at a sample; return the axes."""
        ax = chart(ax, "grain, from the top", "energy per grain [J]")
        spacing = self.width / 2
        labels = [f"{low:.2g} to {high:.2g}" for low, high in itertools.pairwise(self.edges)]
        values = self.energy[sample].T / spacing
        ax.stackplot(self.place, values, labels=labels, lw=0)
        after = prefixed(self.time[sample], "s", 3)
        title = f"after {after}, by wavenumber (radians per grain)"
        return finish(ax, title)


def bands(trajectory: Trajectory, edges: ArrayLike | None = None, width: int = 48) -> EnergyBands:
    """Return the energy in bands of wavenumber against distance and time.

    K. Taghizadeh, R. K. Shrivastava and S. Luding, Materials 14, 1815 (2021), follow such energies
    through chains of random masses.

    Parameters
    ----------
    trajectory : Trajectory
        Run in which all grains were recorded.
    edges : (B+1,) array_like, optional
        Edges of the bands, radians per grain, from 0 to pi; by default four bands of equal width.
    width : int
        Width of the windows, grains, 8 or more; the centres of neighbouring windows are half a
        width apart.

    Returns
    -------
    EnergyBands

    Raises
    ------
    InputError
        If grains were not recorded, edges do not ascend from 0 to pi, or windows are too narrow or
        wider than the chain.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=200, diameter=1e-3, gravity=0.0, top_load=1.0)
    >>> strike = lmpchain.Impulse(velocity=1e-3)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=9e-5, samples=4)
    >>> split = bands(lmpchain.simulate(scene, engine="native", tolerance=1e-8))
    >>> (split.total / scene.energy).round(7).tolist()
    [1.0, 1.0, 1.0, 1.0]
    >>> (split.energy[-1].sum(0) / scene.energy).round(2).tolist()
    [0.47, 0.32, 0.18, 0.03]
    """
    trajectory.scene.chain.refuse_ground("energy by wavenumber")
    chain = trajectory.scene.chain
    recorded = trajectory.grains.size
    if recorded < chain.grains:
        raise InputError.at("grains", f"{recorded} of {chain.grains} were recorded: record all")
    limits = np.linspace(0, np.pi, 5) if edges is None else numbers(edges, "edges")
    ends = limits.ndim == 1 and limits.size > 1 and limits[0] == 0
    if not (ends and np.isclose(limits[-1], np.pi, rtol=1e-9) and (np.diff(limits) > 0).all()):
        raise InputError.at("edges", "must ascend from 0 to pi, in radians per grain")
    if not NARROWEST <= int(whole_numbers(width, "width")) <= chain.grains:
        raise InputError.at("width", f"must be {NARROWEST} to {chain.grains} grains (got {width})")
    energy = shares(trajectory)
    order = np.argsort(energy.grain)
    u, _ = motion(trajectory, np.stack([energy.contact, energy.contact + 1]))
    sign = np.sign(u[:, 0] - u[:, 1])
    of_grains = np.sign(trajectory.velocity[:, order]) * np.sqrt(energy.kinetic[:, order])
    of_contacts = sign * np.sqrt(np.maximum(energy.elastic, 0.0))
    off = (
        _root_error(energy.kinetic, energy.kinetic_error)[:, order],
        _root_error(energy.elastic, energy.elastic_error),
    )
    middles, windows_of_grains, windows_of_contacts = _windows(chain.grains, energy.contact, width)
    reach = 2 * (middles[0] - 0.5)
    size = int(np.ceil(reach)) + 2
    wavenumber = 2 * np.pi * np.fft.fftfreq(size)
    band = np.clip(np.searchsorted(limits, np.abs(wavenumber), "right") - 1, 0, limits.size - 2)
    shape = (len(trajectory.time), middles.size, limits.size - 1)
    sums, downward, error = np.zeros((3, *shape))
    half = np.exp(-0.5j * wavenumber)
    for number, middle in enumerate(middles):
        first = int(np.floor(middle - reach / 2))
        grains = _cut(windows_of_grains[number] * of_grains, 1, first, size)
        contacts = _cut(
            windows_of_contacts[number] * of_contacts, int(energy.contact[0]), first, size
        )
        moving = np.fft.fft(grains, axis=1)
        pressed = np.fft.fft(contacts, axis=1) * half
        down = np.abs(moving + pressed) ** 2 / (2 * size)
        up = np.abs(moving - pressed) ** 2 / (2 * size)
        square = (windows_of_grains[number] ** 2 * off[0] ** 2).sum(1)
        square += (windows_of_contacts[number] ** 2 * off[1] ** 2).sum(1)
        for b in range(limits.size - 1):
            downward[:, number, b] = down[:, band == b].sum(1)
            sums[:, number, b] = downward[:, number, b] + up[:, band == b].sum(1)
            error[:, number, b] = 2 * np.sqrt(sums[:, number, b] * square) + square
    return EnergyBands(trajectory.time, middles, limits, sums, error, downward, float(reach))


def _windows(grains: int, contact: np.ndarray, width: int) -> tuple[Array, Array, Array]:
    """Return middles of windows (P,), and normalised windows over grains and contacts.

    Each window rises over half of its width, while the previous window falls; the outermost windows
    are flat up to the ends.
    """
    count = max(1, round(2 * grains / width) - 1)
    hop = grains / (count + 1)
    middles: Array = 0.5 + hop * np.arange(1.0, count + 1)

    def at(place: Array) -> Array:
        far = (place - middles[:, None]) / hop
        far[0] = np.maximum(far[0], 0.0)
        far[-1] = np.minimum(far[-1], 0.0)
        return np.cos(np.pi / 2 * np.clip(far, -1, 1))

    return middles, at(np.arange(1.0, grains + 1)), at(contact + 0.5)


def _cut(values: Array, begin: int, first: int, size: int) -> Array:
    """Return the columns of numbers first ... first + size - 1, with 0 for missing ones."""
    cut = np.zeros((len(values), size))
    low = max(first, begin)
    high = min(first + size, begin + values.shape[1])
    cut[:, low - first : high - first] = values[:, low - begin : high - begin]
    return cut


def _root_error(energy: Array, error: Array) -> Array:
    """Return the error of the square root of an energy, given the error of the energy."""
    root = np.sqrt(np.maximum(energy, 0.0))
    lower = root - np.sqrt(np.maximum(energy - error, 0.0))
    return np.maximum(lower, np.sqrt(np.maximum(energy, 0.0) + error) - root)
