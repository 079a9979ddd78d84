"""The chain at rest: grains, contacts, equilibrium, stiffness, scales and band edge."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from .fields import NOT_GIVEN, Array, Checked, OneOrMany, Positive, PositiveVector, Real, Whole

LARGEST_OVERLAP = 0.1  # of the diameter: beyond it the Hertz law no longer describes a contact


class Material(Checked):
    """An elastic material.

    Parameters
    ----------
    density : float
        kg/m3.
    youngs_modulus : float
        Pa.
    poissons_ratio : float
        Between -1 and 0.5.
    name, source : str
        What it is called in scene files, and where the numbers come from.
    """

    density: Positive
    youngs_modulus: Positive
    poissons_ratio: Annotated[Real, Field(gt=-1, le=0.5)]
    name: str = ""
    source: str = ""

    @property
    def plane_strain_modulus(self) -> float:
        """E / (1 - nu^2), Pa."""
        return self.youngs_modulus / (1 - self.poissons_ratio**2)


def _material(name: str, density: float, youngs: float, poisson: float, source: str) -> Material:
    return Material(density=density, youngs_modulus=youngs, poissons_ratio=poisson, name=name, source=source)


GLASS = _material("glass", 2426.0, 62e9, 0.2, "Gerasymov and Spivak, caption of Fig. 5")
STEEL = _material("steel", 8000.0, 193e9, 0.3, "AISI 316; Daraio et al., Phys. Rev. E 73, 026610 (2006)")
PTFE = _material("ptfe", 2200.0, 1.46e9, 0.46, "Daraio et al., Phys. Rev. E 73, 026610 (2006)")
BRASS = _material("brass", 8500.0, 103e9, 0.34, "Porter et al., Physica D 238, 666 (2009)")
TUNGSTEN_CARBIDE = _material("tungsten_carbide", 14980.0, 628e9, 0.28, "manufacturers' data for WC-Co bearing balls")
MATERIALS = {m.name: m for m in (GLASS, STEEL, PTFE, BRASS, TUNGSTEN_CARBIDE)}


def _one_material(value: Any) -> Material:
    if isinstance(value, Material):
        return value
    if isinstance(value, dict):
        return Material(**value)
    if value in MATERIALS:
        return MATERIALS[value]
    raise ValueError(
        f"no material is called {value!r}; use {', '.join(MATERIALS)}, "
        "or give density, youngs_modulus and poissons_ratio"
    )


def _one_or_many_materials(value: Any) -> Material | tuple[Material, ...]:
    if isinstance(value, list | tuple):
        return tuple(_one_material(item) for item in value)
    return _one_material(value)


OneOrManyMaterials = Annotated[
    Material | str | dict | Sequence[Material | str | dict], BeforeValidator(_one_or_many_materials)
]


class Chain(Checked):
    """A vertical column of grains that touch, numbered 1 ... N from the top.

    Grain n obeys ``m_n z_n'' = K_(n-1) [o_(n-1)]^delta - K_n [o_n]^delta + m_n g`` (Eq. 1 of the
    paper), with no force where the overlap ``o_n`` is negative.

    Parameters
    ----------
    grains : int
        N, two or more.
    material : Material, name, or N of them
    diameter : float or (N,) array
        m.
    gravity : float
        m/s2; 0 for a horizontal chain.
    exponent : float
        delta, 1 (linear springs) to 3; 1.5 is Hertz.
    top_load : float
        Constant force pressing on grain 1, N.
    top, bottom : str
        top "free"; bottom "fixed" (grain N is held) or "free" (only without gravity and load).
    masses : (N,) array, optional
        kg; instead of those that follow from material and diameter.
    contact_constants : (N-1,) array, optional
        K_n, N/m^delta; instead of ``(4/3) E* sqrt(R*) dbar^(1.5 - delta)``.

    Raises
    ------
    InputError
        With every fault found.

    Examples
    --------
    >>> chain = Chain(grains=120, material=GLASS, diameter=1e-3)
    >>> f"{chain.length_scale:.5e} m"
    '6.94554e-10 m'
    """

    grains: Annotated[Whole, Field(ge=2, le=10**8)]
    material: OneOrManyMaterials = GLASS
    diameter: OneOrMany
    gravity: Annotated[Real, Field(ge=0)] = 9.81
    exponent: Annotated[Real, Field(ge=1, le=3)] = 1.5
    top_load: Annotated[Real, Field(ge=0)] = 0.0
    top: Literal["free"] = "free"
    bottom: Literal["fixed", "free"] = "fixed"
    masses: PositiveVector = NOT_GIVEN
    contact_constants: PositiveVector = NOT_GIVEN

    def _faults(self) -> Iterator[tuple[str, str]]:
        lengths = {"diameter": self.grains, "masses": self.grains, "contact_constants": self.grains - 1}
        wrong = False
        if isinstance(self.material, tuple) and len(self.material) != self.grains:
            wrong = True
            yield "material", f"must be one or {self.grains} (one a grain), not {len(self.material)}"
        for key, length in lengths.items():
            value = getattr(self, key)
            if isinstance(value, np.ndarray) and len(value) != length:
                wrong = True
                yield key, f"must have {length} entries for {self.grains} grains, not {len(value)}"
        if self.bottom == "free" and (self.gravity > 0 or self.top_load > 0):
            yield "bottom", 'must be "fixed" under gravity or a top load: a free chain would fall'
        if wrong:
            return
        self._fill_in()
        relative = self.equilibrium_overlap / self.mean_diameters
        if relative.max() > LARGEST_OVERLAP:
            worst = int(relative.argmax())
            yield (
                "diameter",
                f"contact {worst + 1} is compressed by {relative[worst]:.2g} of the diameter, more than "
                f"{LARGEST_OVERLAP:g}: use fewer grains, less gravity or load, or a stiffer material",
            )

    def _fill_in(self) -> None:
        """Put the masses and contact constants that follow from the grains where none were given."""
        if self.masses is None:
            density = self._per_grain([m.density for m in self._materials])
            self.__dict__["masses"] = density * np.pi / 6 * self.diameters**3
        if self.contact_constants is None:
            soft = 1 / self._per_grain([m.plane_strain_modulus for m in self._materials])
            d = self.diameters
            modulus = 1 / (soft[:-1] + soft[1:])
            radius = d[:-1] * d[1:] / (d[:-1] + d[1:]) / 2
            constants = 4 / 3 * modulus * np.sqrt(radius) * self.mean_diameters ** (1.5 - self.exponent)
            self.__dict__["contact_constants"] = constants

    @property
    def _materials(self) -> tuple[Material, ...]:
        return self.material if isinstance(self.material, tuple) else (self.material,)  # type: ignore[return-value]

    def _per_grain(self, values: Any) -> Array:
        return np.broadcast_to(np.asarray(values, dtype=float), (self.grains,)).copy()

    @cached_property
    def diameters(self) -> Array:
        """Diameter of every grain, (N,) m."""
        return self._per_grain(self.diameter)

    @cached_property
    def mean_diameters(self) -> Array:
        """Mean diameter of the two grains of every contact, (N-1,) m."""
        return (self.diameters[:-1] + self.diameters[1:]) / 2

    @cached_property
    def equilibrium_force(self) -> Array:
        """Force that every contact carries at rest, (N-1,) N."""
        weight = self.gravity * np.cumsum(self.masses[:-1].astype(np.longdouble))
        return (self.top_load + weight).astype(float)

    @cached_property
    def equilibrium_overlap(self) -> Array:
        """Overlap eps_n of every contact at rest, (N-1,) m."""
        return (self.equilibrium_force / self.contact_constants) ** (1 / self.exponent)

    @cached_property
    def linear_stiffness(self) -> Array:
        """Stiffness delta K_n eps_n^(delta-1) of every contact at rest, (N-1,) N/m."""
        return self.exponent * self.contact_constants * self.equilibrium_overlap ** (self.exponent - 1)

    @property
    def compressed(self) -> bool:
        """Whether contacts carry a force at rest; if not, the chain is a sonic vacuum."""
        return self.gravity > 0 or self.top_load > 0

    @property
    def movable(self) -> int:
        """Number of grains that move: N - 1 with a fixed bottom, N with a free one."""
        return self.grains - (self.bottom == "fixed")

    @cached_property
    def band_edge(self) -> float:
        """Highest eigenfrequency of the linearised chain, rad/s (0 in the sonic vacuum)."""
        from scipy.linalg import eigh_tridiagonal

        m, k = self.masses[: self.movable], self.linear_stiffness
        below = np.append(k, 0.0)[: self.movable]
        above = np.append(0.0, k)[: self.movable]
        diagonal = (above + below) / m
        if self.movable == 1:
            return float(np.sqrt(diagonal[0]))
        coupling = -k[: self.movable - 1] / np.sqrt(m[:-1] * m[1:])
        last = self.movable - 1
        top = eigh_tridiagonal(diagonal, coupling, eigvals_only=True, select="i", select_range=(last, last))
        return float(np.sqrt(max(top[0], 0.0)))

    @property
    def length_scale(self) -> float:
        """Overlap eps_1 of the top contact at rest, m."""
        return float(self.equilibrium_overlap[0])

    @property
    def time_scale(self) -> float:
        """Unit of the paper's tau, sqrt(m_1 / k_1), s (infinite in the sonic vacuum)."""
        k = float(self.linear_stiffness[0])
        return float(np.sqrt(self.masses[0] / k)) if k > 0 else np.inf

    def excess_energy(self, displacement: Array, velocity: Array) -> Array:
        """Energy above that of the chain at rest: kinetic, contacts and weight together, J.

        It is conserved by Eq. (1) and zero at rest; weak waves keep their relative accuracy.

        Parameters
        ----------
        displacement, velocity : (..., N) arrays
            m, positive downward; m/s.

        Returns
        -------
        (...) array
        """
        r = displacement[..., :-1] - displacement[..., 1:]
        kinetic = 0.5 * (self.masses * velocity**2).sum(-1)
        return kinetic + self._contact_energy(r).sum(-1)

    def _contact_energy(self, r: Array) -> Array:
        """W_n(r) = integral of K [eps + r]^delta - K eps^delta, for a contact closer by r, J."""
        power = self.exponent + 1
        if not self.compressed:
            return self.contact_constants / power * np.maximum(r, 0) ** power
        s = r / self.equilibrium_overlap
        y = np.log1p(np.where(s > -1, s, 0.0))
        exact = np.where(s > -1, np.expm1(power * y), -1.0) / power - s
        # the two terms cancel for small s: sum the binomial series instead
        term = np.ones_like(s)
        series = np.zeros_like(s)
        for k in range(2, 12):
            term = (power - k + 1) * term / k
            series += term * s**k
        small = np.abs(s) < 0.02
        scaled = np.where(small, series, exact)
        return self.equilibrium_force * self.equilibrium_overlap * scaled

    def overlap_bound(self, energy: float) -> Array:
        """Largest overlap that each contact can reach with this excess energy, (N-1,) m.

        The bound is rigorous: no contact can hold more than the whole conserved energy, and
        ``W_n(r)`` is at least ``K r^(delta+1) / (delta+1)`` and at least ``k_n r^2 / 2``.
        """
        power = self.exponent + 1
        closer = (power * energy / self.contact_constants) ** (1 / power)
        if self.compressed:
            closer = np.minimum(closer, np.sqrt(2 * energy / self.linear_stiffness))
        return self.equilibrium_overlap + closer
