"""Absorbing boundaries: layers of grains at an end of a chain, with gradually increasing drag.

The reflection of linear waves is exact: displacement and force are propagated upward from the last
grain, and decomposed into the two waves of the periodic chain above the layer. In a layer of S
grains, the drag of grain j, counted away from the chain, is

    gamma_j = gamma_S x_j^p,    x_j = (j - 1/2) / S,    j = 1 ... S.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple
from warnings import warn

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..util.arrays import Array
from .chain import Chain
from .damping import Damping
from .law import Law

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Grading:
    """Candidates for the drag of an absorbing layer; see analysis/sponges.py.

    Attributes
    ----------
    powers : tuple of int
        Candidates for p; short layers are best with the first, long ones with the last.
    weakest, strongest : float
        Smallest and largest ratio of gamma_S to the highest frequency of the cell.
    middle : float
        Central fraction of every band in which the largest reflection is minimised.
    frequencies : int
        Number of frequencies in each band.
    longest_cell : int
        Largest number of grains in a cell that is detected.
    remarked : float
        Fraction of the energy above which a reflection causes a warning.
    """

    powers: tuple[int, ...] = (2, 3, 4)
    weakest: float = 3e-3
    strongest: float = 3.0
    middle: float = 0.8
    frequencies: int = 61
    longest_cell: int = 8
    remarked: float = 1e-3


GRADING = Grading()
NOT_PRESSED = "contacts there carry no force at rest, so no wave is linear: give a top load"


class Layer(NamedTuple):
    """The last S grains of a chain, counted away from it, and the chain's cell in front of them.

    Attributes
    ----------
    masses, stiffness, viscosity, ground : (S,) arrays
        Mass of each grain, kg; stiffness of the contact beyond it, N/m; viscosity of this contact,
        s; stiffness of the ground under the grain, N/m. Stiffness and viscosity are 0 if there is
        no contact.
    cell : int
        Period P: the first P grains and contacts are the cell that repeats before the layer.
    """

    masses: Array
    stiffness: Array
    viscosity: Array
    ground: Array
    cell: int

    @property
    def bands(self) -> Array:
        """Edges of the bands of the cell, (P, 2) rad/s."""
        m = self.masses[: self.cell]
        k = self.stiffness[: self.cell]
        edges = []
        for turn in (1.0, -1.0):
            matrix = np.diag(k + np.roll(k, 1) + self.ground[: self.cell])
            for n in range(self.cell):
                below = (n + 1) % self.cell
                # The last grain of the cell touches the first grain of the next cell.
                coupling = k[n] * (turn if below == 0 else 1.0)
                matrix[n, below] -= coupling
                matrix[below, n] -= coupling
            edges.append(np.linalg.eigvalsh(matrix / np.sqrt(np.outer(m, m))))
        return np.sqrt(np.maximum(np.sort(np.transpose(edges), axis=1), 0.0))

    @property
    def middle(self) -> Array:
        """Frequencies in the middle of every band, (F,) rad/s."""
        margin = (1 - GRADING.middle) / 2
        share = np.linspace(margin, 1 - margin, GRADING.frequencies)
        low, high = self.bands.T[:, :, None]
        return (low + share * (high - low)).ravel()


def layer(chain: Chain, end: str, grains: int, cell: int) -> Layer:
    """Return the layer of `grains` grains at the "top" or "bottom" of a chain."""
    chain.refuse_ground_without_modes("reflection")
    ground = chain.ground_stiffness[: chain.movable]
    if (ground < 0).any():
        raise InputError.at("chain.ground", "pushes grains away from rest: no wave is linear")
    masses = chain.masses[: chain.movable]
    contacts = slice(0, chain.movable + 1)
    stiffness = chain.contacts.stiffness[contacts]
    viscosity = chain.contact_viscosity[contacts]
    size = grains - (chain.grains - chain.movable)
    if end == "top":
        size = grains
        masses = masses[::-1]
        stiffness = stiffness[::-1]
        viscosity = viscosity[::-1]
        ground = ground[::-1]
    return Layer(masses[-size:], stiffness[-size:], viscosity[-size:], ground[-size:], cell)


def reflection(sponge: Layer, drag: Array, frequency: Array) -> Complex:
    """Return the reflected amplitude of a wave of amplitude 1, (F,), without its phase in time.

    Parameters
    ----------
    sponge : Layer
    drag : (S,) array
        Drag gamma of each grain of the layer, 1/s.
    frequency : (F,) array
        Angular frequencies within the bands of the cell, rad/s.
    """
    square = frequency**2
    inertia = [
        m * (square + 1j * g * frequency) - k
        for m, g, k in zip(sponge.masses, drag, sponge.ground, strict=True)
    ]
    springs = [
        k * (1 - 1j * a * frequency)
        for k, a in zip(sponge.stiffness, sponge.viscosity, strict=True)
    ]
    # Start with displacement 1 of the last grain, and the force on the wall or grain beyond it.
    displacement = np.ones(frequency.shape, complex)
    force = springs[-1] * displacement
    last = sponge.cell - 1
    before = [sponge.stiffness[last], *springs[:-1]]
    for mass, spring in zip(inertia[::-1], before[::-1], strict=True):
        force = force - mass * displacement
        displacement = displacement + force / spring
        # Only the ratio of displacement and force matters, so that both are normalised.
        size = np.abs(displacement) + np.abs(force / spring)
        displacement = displacement / size
        force = force / size
    # The transfer matrix of a cell without losses has determinant 1; its eigenvectors are the two
    # waves.
    a = np.ones(frequency.shape)
    b = np.zeros(frequency.shape)
    c = np.zeros(frequency.shape)
    d = np.ones(frequency.shape)
    for n in range(last, -1, -1):
        inert = sponge.masses[n] * square - sponge.ground[n]
        c = c - inert * a
        d = d - inert * b
        a = a + c / sponge.stiffness[n - 1 if n else last]
        b = b + d / sponge.stiffness[n - 1 if n else last]
    turn = np.sqrt(np.maximum(1 - ((a + d) / 2) ** 2, 0.0))
    # The eigenvalue of the wave that carries energy away from the chain.
    onward = (a + d) / 2 - 1j * np.sign(b) * turn
    share = displacement / b
    outgoing = force + (a - onward.conj()) * share
    incoming = force + (a - onward) * share
    return np.asarray(-incoming / outgoing)


def drag_profile(size: int, strongest: float, power: int) -> Array:
    """Return the drag of the S grains of a layer, counted away from the chain, (S,) 1/s."""
    return strongest * ((np.arange(size) + 0.5) / size) ** power


def match_drag(sponge: Layer) -> Array:
    """Return the drag, (S,) 1/s, with the least reflection in the middle of all bands."""
    from scipy.optimize import minimize_scalar

    frequency = sponge.middle
    highest = float(sponge.bands.max())
    size = sponge.masses.size
    bounds = [math.log(highest * x) for x in (GRADING.weakest, GRADING.strongest)]

    def worst(strongest: float, power: int) -> float:
        drag = drag_profile(size, math.exp(strongest), power)
        return float(np.log(np.abs(reflection(sponge, drag, frequency))).max())

    best: list[Any] = []
    for power in GRADING.powers:
        least = minimize_scalar(worst, bounds=bounds, args=(power,), method="bounded")
        best.append((least.fun, power, math.exp(least.x)))
    _, power, strongest = min(best)
    return drag_profile(size, strongest, power)


def period(chain: Chain, end: str) -> int:
    """Return the period of the grains at an end; 1 if they are not periodic."""
    # The drag of an existing absorbing layer is not periodic, so it is ignored.
    fields = _values_of_all(chain) | {"drag": 0.0, "ground": chain.ground_stiffness}
    of_laws = [value for law in _laws(chain).values() for value in law.given.values()]
    rows = [x for x in (*fields.values(), *of_laws) if isinstance(x, tuple | np.ndarray)]
    window = 2 * GRADING.longest_cell
    tails = [list(row[::-1] if end == "top" else row)[-window:] for row in rows]
    for length in range(1, GRADING.longest_cell + 1):
        if all(len(tail) >= 2 * length - 1 and tail[length:] == tail[:-length] for tail in tails):
            return length
    return 1


def add(chain: Chain, top: int, bottom: int) -> Chain:
    """Return `patterns.absorbing` for these numbers of grains."""
    cells = {"top": period(chain, "top"), "bottom": period(chain, "bottom")}
    sizes = {"top": top, "bottom": bottom}
    longer = _longer(chain, sizes, cells)
    drag = longer.drag.copy()
    for end, size in sizes.items():
        if not size:
            continue
        if size < 3 * cells[end]:
            least = f"must be three cells or more, {3 * cells[end]} grains (got {size})"
            raise InputError.at(end, least)
        ending = layer(longer, end, size, cells[end])
        if not (longer.compressed and ending.stiffness[:-1].all()):
            raise InputError.at(end, NOT_PRESSED)
        gamma = match_drag(ending)
        _remark(end, size, ending, gamma)
        if end == "top":
            drag[:size] += gamma[::-1]
        else:
            # A fixed grain has no drag.
            drag[longer.movable - gamma.size : longer.movable] += gamma
    return longer.replace(damping=Damping(viscoelastic=longer.damping.viscoelastic, drag=drag))


def _remark(end: str, size: int, ending: Layer, drag: Array) -> None:
    """Warn if a large fraction of a wave is reflected."""
    share = float(np.abs(reflection(ending, drag, ending.middle)).max() ** 2)
    if share > GRADING.remarked:
        warn(
            f"{end}: an absorbing layer of {size} grains reflects {100 * share:.2g} % of the "
            "energy in the middle of the bands: use more grains",
            stacklevel=4,
        )


def _values_of_all(chain: Chain) -> dict[str, Any]:
    """Return the fields of a chain with a common value or a list for grains or contacts."""
    fields = chain.given()
    keys = ("material", "diameter", "masses", "contact_constants")
    lists = {key: fields[key] for key in keys if key in fields}
    return lists | {"viscoelastic": chain.damping.viscoelastic, "drag": chain.damping.drag}


def _laws(chain: Chain) -> dict[str, Law]:
    """Return the laws of contacts and ground that are given by formulas, by the name of the field.

    Their parameters may be lists for contacts or grains.
    """
    laws = {"law": chain.law, "ground": chain.ground}
    return {key: law for key, law in laws.items() if isinstance(law, Law)}


def _longer(chain: Chain, sizes: dict[str, int], cells: dict[str, int]) -> Chain:
    """Return a chain whose pattern is continued by these numbers of grains."""
    top = sizes["top"]

    def go_on(values: Any) -> Any:
        if not isinstance(values, tuple | np.ndarray):
            return values
        size = len(values)
        number = np.arange(-top, size + sizes["bottom"])
        cell = size - cells["bottom"]
        number = np.where(number < 0, number % cells["top"], number)
        number = np.where(number >= size, cell + (number - cell) % cells["bottom"], number)
        return values[number] if isinstance(values, np.ndarray) else [values[n] for n in number]

    lists = {key: go_on(values) for key, values in _values_of_all(chain).items()}
    for key, law in _laws(chain).items():
        lists[key] = law.replace(**{name: go_on(value) for name, value in law.given.items()})
    damping = Damping(viscoelastic=lists.pop("viscoelastic"), drag=lists.pop("drag"))
    impurity = [one.replace(grain=one.grain + top) for one in chain.impurity]
    fields = chain.given() | lists | {"grains": chain.grains + top + sizes["bottom"]}
    return Chain(**fields | {"impurity": impurity, "damping": damping})
