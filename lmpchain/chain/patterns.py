"""Chains with a pattern of grains (tapered, periodic, decorated), and absorbing boundaries.

Each function returns a `Chain`, and passes other keywords on to `Chain`. `repeated` and
`write_out` implement the keys `cell` and `taper` of scene files.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from ..errors import InputError, shown
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.validation import NOT_GIVEN, Checked, OneOrMany, Positive, Real, Whole, each
from . import sponge
from .chain import Chain
from .materials import GLASS, OneMaterial, OneOrManyMaterials, one_material

__dir__ = listed(__name__)
IN_FILES = ("cell", "taper")  # Keys of a scene file that define materials and diameters.


def tapered(grains: int, diameter: float, taper: float, **rest: Any) -> Chain:
    """Return a tapered chain, with diameters d_n = d_1 (1 - taper)^(n-1).

    Harbola, Rosas, Esposito and Lindenberg, Pulse propagation in tapered granular chains,
    arXiv:0905.4512.

    Parameters
    ----------
    grains : int
        Number of grains N.
    diameter : float
        Diameter of grain 1, m.
    taper : float
        Relative decrease of the diameter from grain to grain, below 1. A negative taper makes
        grains larger downward.
    **rest
        Other arguments of `Chain`.

    Returns
    -------
    Chain

    Raises
    ------
    InputError
        With the faults found, each under the name of its argument.

    Examples
    --------
    >>> (tapered(4, 1e-3, 0.1).diameters * 1e3).round(6).tolist()
    [1.0, 0.9, 0.81, 0.729]
    >>> (tapered(3, 1e-3, -0.5, material="steel").diameters * 1e3).round(6).tolist()
    [1.0, 1.5, 2.25]
    """
    checked = _Tapered(grains=grains, diameter=diameter, taper=taper)
    return _chain(checked.grains, rest, diameter=checked.diameters(checked.grains))


def decorated(grains: int, diameter: float, ratio: float, taper: float = 0.0, **rest: Any) -> Chain:
    """Return a decorated chain: large grains, tapered or not, with a small one below each.

    The diameter of a small grain is `ratio` times that of the large grain above it. The diameters
    of the large grains 1, 3, 5 ... decrease geometrically, so that the chain is d_1, ratio d_1, (1
    - taper) d_1, ratio (1 - taper) d_1, ...

    Harbola, Rosas, Romero, Esposito and Lindenberg, Pulse propagation in decorated granular chains,
    Phys. Rev. E 80, 051302 (2009).

    Parameters
    ----------
    grains : int
        Number N of large and small grains together.
    diameter : float
        Diameter of grain 1, m.
    ratio : float
        Diameter of a small grain divided by the diameter of the large grain above it, at most 1.
    taper : float
        Relative decrease of the diameter from one large grain to the next, below 1.
    **rest
        Other arguments of `Chain`.

    Returns
    -------
    Chain

    Raises
    ------
    InputError
        With the faults found, each under the name of its argument.

    Examples
    --------
    >>> (decorated(5, 1e-3, 0.2, taper=0.1).diameters * 1e3).round(6).tolist()
    [1.0, 0.2, 0.9, 0.18, 0.81]
    """
    checked = _Decorated(grains=grains, diameter=diameter, taper=taper, ratio=ratio)
    large = checked.diameters((checked.grains + 1) // 2)
    both = np.column_stack((large, checked.ratio * large)).ravel()
    return _chain(checked.grains, rest, diameter=both[: checked.grains])


def periodic(
    grains: int, diameters: Any, materials: Any = GLASS, counts: Any = 1, **rest: Any
) -> Chain:
    """Return a chain that repeats a cell of several kinds of grains (dimer, trimer ...).

    The first cell starts at grain 1; the last one may be incomplete.

    Porter, Daraio, Herbold, Szelengowicz and Kevrekidis, Highly nonlinear solitary waves in
    periodic dimer granular chains, arXiv:0705.3471.

    Parameters
    ----------
    grains : int
        Number of grains N.
    diameters : float or list of float
        Diameter of each kind, m; one number if all are equal.
    materials : Material, name, or list of them
        Material of each kind; one if all are equal.
    counts : int or list of int
        Number of consecutive grains of each kind in a cell.
    **rest
        Other arguments of `Chain`.

    Returns
    -------
    Chain

    Raises
    ------
    InputError
        With the faults found, each under the name of its argument.

    Examples
    --------
    >>> dimer = periodic(5, 4.76e-3, ["steel", "ptfe"])
    >>> [material.name for material in dimer.material]
    ['steel', 'ptfe', 'steel', 'ptfe', 'steel']
    >>> (periodic(7, [1e-3, 2e-3], counts=[2, 1]).diameters * 1e3).round(6).tolist()
    [1.0, 1.0, 2.0, 1.0, 1.0, 2.0, 1.0]
    """
    cell = _Cell(grains=grains, diameters=diameters, materials=materials, counts=counts)
    # Larger counts would only create arrays that are truncated again.
    repeats = np.resize(np.minimum(cell.counts, cell.grains), cell.kinds)
    kind = np.resize(np.repeat(np.arange(cell.kinds), repeats), cell.grains)
    material = cell.materials
    if isinstance(material, tuple):
        material = tuple(material[k % len(material)] for k in kind)
    return _chain(
        cell.grains, rest, diameter=np.resize(cell.diameters, cell.kinds)[kind], material=material
    )


def repeated(grains: int, cell: Any, taper: float = 0.0, **rest: Any) -> Chain:
    """Return a chain that repeats a cell of grains, as `cell` and `taper` do in a scene file.

    Parameters
    ----------
    grains : int
        Number of grains N.
    cell : list of materials, names or {material, diameter}
        One entry for each grain. The first cell starts at grain 1; the last one may be incomplete.
        The keywords `material` and `diameter` give the values that an entry does not specify.
    taper : float
        Relative decrease of the diameter from grain to grain, below 1. The diameter of grain n is
        its diameter in the cell times (1 - taper)^(n-1).
    **rest
        Other arguments of `Chain`.

    Returns
    -------
    Chain

    Raises
    ------
    InputError
        With the faults found, each under the name of its argument.

    Examples
    --------
    >>> dimer = repeated(4, ["steel", "aluminium"], diameter=5e-3)
    >>> [material.name for material in dimer.material]
    ['steel', 'aluminium', 'steel', 'aluminium']
    >>> shrinking = repeated(4, [{"diameter": 2e-3}, {"diameter": 1e-3}], taper=0.1)
    >>> (shrinking.diameters * 1e3).round(6).tolist()
    [2.0, 0.9, 1.62, 0.729]
    """
    return Chain(**write_out({"grains": grains, "cell": cell, "taper": taper} | rest))


def write_out(keys: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of a chain with `material` and `diameter` in place of `cell` and `taper`.

    Parameters
    ----------
    keys : dict
        Keys of the table `[chain]` of a scene file.

    Returns
    -------
    dict
        `keys` itself if it contains neither `cell` nor `taper`.

    Raises
    ------
    InputError
        With the faults of the pattern.
    """
    if keys.keys().isdisjoint(IN_FILES):
        return keys
    pattern = _Repeated(**{key: keys[key] for key in _Repeated.arguments if key in keys})
    rest = {key: value for key, value in keys.items() if key not in _Repeated.arguments}
    return rest | {"grains": pattern.grains} | pattern.by_grain()


def absorbing(chain: Chain, bottom: int = 60, top: int = 0) -> Chain:
    """Return a chain with absorbing boundaries: additional layers of grains with graded drag.

    A layer continues the last cell of up to 8 grains (uniform, dimer, trimer ...), or repeats the
    last grain if there is no cell. The drag increases as x^p with the relative depth x in the
    layer, 0 < x < 1. The power p (2, 3 or 4) and the strength minimise the reflection of weak waves
    in the middle 80 % of all bands. The end of the layer is the former end of the chain: a wall, a
    held grain or a free end. `theory.scattering.reflection` computes the reflection; the page on
    scenes lists it for usual chains.

    Under gravity a layer at the bottom continues the column, so that the load increases in the
    layer, too. The cell before the layer is evaluated with the load at the beginning of the layer.

    Parameters
    ----------
    chain : Chain
        Chain that is compressed by a load or gravity. Its grain numbers increase by `top`.
    bottom, top : int
        Numbers of grains of the layers: three cells or more, or 0 for no layer.

    Returns
    -------
    Chain

    Raises
    ------
    InputError
        If an end is not compressed, if a layer is too short, or if a layer at the top would load
        the chain by its weight or separate it from a striker.

    Warns
    -----
    UserWarning
        If more than 1e-3 of the energy of a wave is reflected.

    Examples
    --------
    >>> chain = Chain(grains=100, diameter=1e-3, gravity=0.0, top_load=1.0, bottom="wall")
    >>> endless = absorbing(chain, bottom=60)
    >>> endless.grains, endless.damped
    (160, True)
    """
    for key, grains in (("bottom", bottom), ("top", top)):
        if isinstance(grains, bool) or not isinstance(grains, int | np.integer) or grains < 0:
            raise InputError.at(key, f"must be a whole number of grains (got {shown(grains)})")
    if not (bottom or top):
        raise InputError.at("bottom", "must be positive if top is 0: give a number of grains")
    if top and chain.gravity > 0:
        raise InputError.at("top", "would load the chain by its weight: use bottom alone")
    if top and chain.load_grain > 1:
        raise InputError.at("top", "would not be pressed above the load grain: use bottom alone")
    return sponge.add(chain, int(top), int(bottom))


def _chain(grains: int, rest: dict[str, Any], **pattern: Any) -> Chain:
    if twice := pattern.keys() & rest.keys():
        raise InputError([(key, "follows from the pattern: leave it out") for key in sorted(twice)])
    return Chain(grains=grains, **pattern, **rest)


class _Pattern(Checked):
    grains: Annotated[Whole, Field(ge=2, le=10**8)]


class _Tapered(_Pattern):
    diameter: Positive
    taper: Annotated[Real, Field(lt=1)]

    def diameters(self, count: int) -> Array:
        """Return the diameters of `count` neighbouring grains, (count,) m."""
        return _shrunk(np.full(count, self.diameter), self.taper)


def _shrunk(diameters: Array, taper: float) -> Array:
    """Return diameters (N,) that decrease geometrically from grain to grain, m."""
    with np.errstate(over="ignore", under="ignore"):
        diameters = diameters * (1 - taper) ** np.arange(diameters.size, dtype=float)
        volumes = diameters**3
    unsound = np.flatnonzero(~((volumes > 0) & (volumes < np.inf)))
    # The error names `taper`, because otherwise a mass of 0 or infinity would be reported as a
    # fault of `masses`.
    if unsound.size:
        last = int(unsound[-1])
        width = f"grain {last + 1} would be {diameters[last]:.2g} m wide"
        raise InputError.at("taper", f"{width}: use a taper nearer to 0, or fewer grains")
    return diameters


class _Decorated(_Tapered):
    ratio: Annotated[Real, Field(gt=0, le=1)]


def _counts(value: Any) -> tuple[int, ...]:
    numbers = tuple(value) if np.iterable(value) else (value,)
    if not numbers or any(
        isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1 for n in numbers
    ):
        raise ValueError(f"must be a whole number above 0, or a list of them (got {shown(value)})")
    return tuple(int(n) for n in numbers)


class _Cell(_Pattern):
    diameters: OneOrMany
    materials: OneOrManyMaterials
    counts: Annotated[tuple[int, ...], BeforeValidator(_counts)]

    @property
    def _lengths(self) -> dict[str, int]:
        """Numbers of listed diameters, materials and counts."""
        materials = self.materials if isinstance(self.materials, tuple) else (self.materials,)
        return {
            "diameters": np.size(self.diameters),
            "materials": len(materials),
            "counts": len(self.counts),
        }

    @property
    def kinds(self) -> int:
        """Number of kinds of grains in a cell."""
        return max(self._lengths.values())

    def _faults(self) -> Iterator[tuple[str, str]]:
        for key, length in self._lengths.items():
            if length not in (1, self.kinds):
                yield key, f"must be one or {self.kinds} (one per kind), not {length}"


class CellGrain(Checked):
    """A grain of a cell: its material, its diameter, or both."""

    material: OneMaterial = NOT_GIVEN
    diameter: Positive = NOT_GIVEN


def _cell_grain(item: Any) -> CellGrain:
    # A table is a grain, unless it contains the constants of a material.
    if isinstance(item, dict) and not item.keys() & {"density", "youngs_modulus", "poissons_ratio"}:
        return CellGrain(**item)
    return CellGrain(material=one_material(item))


def _cell(value: Any) -> tuple[CellGrain, ...]:
    if not isinstance(value, list | tuple) or not value:
        example = 'cell = ["steel", "aluminium"]'
        raise ValueError(f"must be a list of grains, as {example} (got {shown(value)})")
    return each(value, _cell_grain)


class _Repeated(Checked):
    """A repeated cell with a default material, a default diameter and a taper."""

    grains: Annotated[Whole, Field(ge=1, le=10**8)]
    cell: Annotated[tuple[CellGrain, ...], BeforeValidator(_cell)] = (CellGrain(),)
    taper: Annotated[Real, Field(lt=1)] = 0.0
    material: OneMaterial = NOT_GIVEN
    diameter: Positive = NOT_GIVEN

    def _faults(self) -> Iterator[tuple[str, str]]:
        for key in ("material", "diameter"):
            open_ends = [place for place, grain in enumerate(self.cell) if not getattr(grain, key)]
            if not open_ends and getattr(self, key):
                yield key, "is in the cell already: take it out of one of them"
            if open_ends and key == "diameter" and not self.diameter:
                yield key, "is missing; add it, or give every grain of the cell its own"

    def by_grain(self) -> dict[str, Any]:
        """Return the material and diameter of the chain, either common or one for each grain."""
        materials = [grain.material or self.material or GLASS for grain in self.cell]
        widths = [grain.diameter or self.diameter for grain in self.cell]
        kind = np.arange(self.grains) % len(self.cell)
        diameters = _shrunk(np.array(widths)[kind], self.taper)
        alike = all(material == materials[0] for material in materials)
        even = not self.taper and len(set(widths)) == 1
        return {
            "material": materials[0] if alike else tuple(materials[k] for k in kind.tolist()),
            # A uniform chain needs only one diameter.
            "diameter": widths[0] if even else diameters,
        }
