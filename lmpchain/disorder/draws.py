"""Chains with random contacts or random grains.

The stiffness of each contact of the ordered chain is multiplied by an independent factor zeta_n
from Dyson's distribution: a gamma distribution of shape m, mean 1 and variance 1/m (F. J. Dyson,
Phys. Rev. 92, 1331, 1953). The chain becomes ordered as m increases. Masses, diameters and moduli
of grains are drawn in the same way. Eq. (23) as printed has an additional power of zeta, and
therefore shape m + 1, mean 1 + 1/m and variance (m+1)/m^2. The mean of 1/zeta is then 1 for every
m, so that disorder does not change the speed of the longest waves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np

from ..chain.chain import Chain
from ..chain.materials import Material
from ..errors import InputError, not_among, shown
from ..scene.scene import Scene, check_scene
from ..util.arrays import Array
from ..util.validation import make_unchecked

Law = Literal["dyson", "paper"]
Of = Literal["stiffness", "constant", "mass", "diameter", "youngs_modulus"]
OF_CONTACTS = ("stiffness", "constant")
# Largest number of chains in an average; the standard error is then 1e-3 of the scatter.
MOST_CHAINS = 10**6
# Smallest factor, drawn once in 10^9 at m = 0.1; a factor of 0 would remove the contact.
SOFTEST = 1e-90


def factors(m: float, size: int, rng: np.random.Generator, law: Law = "dyson") -> Array:
    """Return independent random factors zeta, (size,).

    Parameters
    ----------
    m : float
        Order of Eq. (23), above 0 and not necessarily an integer; large m means little disorder.
    size : int
        Number of factors.
    rng : numpy.random.Generator
    law : "dyson" or "paper"
        Distribution. "dyson" has mean 1 and variance 1/m (`theory.dyson.density`). "paper" is
        Eq. (23) as printed, with mean 1 + 1/m and variance (m+1)/m^2 (`theory.dyson.weight`).

    Returns
    -------
    (size,) array

    Raises
    ------
    InputError
        If m is not a number above 0, or if the law is unknown.

    Examples
    --------
    >>> zeta = factors(4, 100_000, np.random.default_rng(1))
    >>> bool(abs(zeta.mean() - 1) < 0.01), bool(abs(zeta.var() - 1 / 4) < 0.01)
    (True, True)
    """
    valid = isinstance(m, int | float | np.number) and not isinstance(m, bool) and 0 < m < math.inf
    check(
        None if valid else ("m", f"must be a number above 0 (got {shown(m)})"),
        fault_of_whole("size", size, 0),
        None if isinstance(rng, np.random.Generator) else ("rng", _no_generator(rng)),
        _fault_of_choice("law", law, get_args(Law)),
    )
    return np.maximum(rng.standard_gamma(m + (law == "paper"), size) / m, SOFTEST)


def _no_generator(rng: object) -> str:
    return f"must be a generator such as numpy.random.default_rng(1) (got {shown(rng)})"


def disordered(
    chain: Chain, m: float, rng: np.random.Generator, law: Law = "dyson", of: Of = "stiffness"
) -> Chain:
    """Return a copy of a chain in which each contact or grain is changed by a random factor.

    Parameters
    ----------
    chain : Chain
        The ordered chain. Load and kinds of ends stay the same, as do all quantities that do not
        depend on the drawn ones; the equilibrium is recomputed. If contacts are drawn, a wall
        contact has the factor of the adjacent contact.
    m, rng, law
        As for `factors`.
    of : str
        Quantity that is multiplied by zeta_n. "stiffness" is the linear stiffness kappa_n, as in
        Eqs. (3) and (23); at a given force it is proportional to K^(1/delta), so that K_n becomes
        K_n zeta_n^delta. "constant" is the contact constant K_n itself, so that the stiffness
        changes only by zeta_n^(1/delta). "mass", "diameter" and "youngs_modulus" have one factor
        for each grain; masses and contacts follow from the diameter, and contacts from the modulus.

    Returns
    -------
    Chain

    Raises
    ------
    InputError
        If an option is wrong; if "stiffness" is drawn in a sonic vacuum, where it is 0; if contact
        constants are given, which do not follow from diameters or moduli; or if a drawn contact is
        so soft that its overlap exceeds a tenth of the diameter, where Hertz's law does not hold.

    Examples
    --------
    >>> chain = Chain(grains=20, diameter=1e-3)
    >>> drawn = disordered(chain, 5, np.random.default_rng(1))
    >>> zeta = factors(5, 19, np.random.default_rng(1))
    >>> bool(abs(drawn.linear_stiffness / chain.linear_stiffness / zeta - 1).max() < 1e-13)
    True
    """
    return change_chain(chain, factors(m, _count(chain, of), rng, law), of)


def change_chain(chain: Chain, factor: Array, of: Of) -> Chain:
    """Return a copy of a chain whose contacts (N-1,) or grains (N,) are multiplied by factors."""
    _check_of(chain, of)
    return Chain(**_fields(chain, factor, of))


def realisation(
    scene: Scene, m: float, seed: int, index: int = 0, law: Law = "dyson", of: Of = "stiffness"
) -> Scene:
    """Return the scene with random chain number `index` (from 0) for this seed.

    The realisation depends only on seed and index, not on the number of realisations. Unlike
    `disordered`, this function accepts arbitrarily soft contacts, because rejecting chains with
    soft contacts would change the distribution; `Ensemble.squeezed` counts these chains.

    Parameters
    ----------
    scene : Scene
    m : float
        Shape parameter of the distribution, as for `factors`.
    seed, index : int
        Seed of the random numbers, 0 or more; number of the chain, 0 or more.
    law, of : str
        As for `disordered`.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        As for `disordered`, except for soft contacts.

    Examples
    --------
    >>> from lmpchain import Impulse
    >>> chain = Chain(grains=20, diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-9), duration=1e-5)
    >>> realisation(scene, 1, seed=7, index=3) == realisation(scene, 1, seed=7, index=3)
    True
    """
    check_scene(scene)
    _check_draw(scene.chain, seed, index, of)
    zeta = _draw(scene.chain, m, seed, index, law, of)
    chain = make_unchecked(Chain, **_fields(scene.chain, zeta, of))
    return make_unchecked(Scene, **(scene.given() | {"chain": chain}))


def drawn_constants(
    chain: Chain,
    m: float,
    seed: int,
    indices: Sequence[int],
    law: Law = "dyson",
    of: Of = "stiffness",
) -> Array:
    """Return factors on the contact constants of R realisations, (R, N-1)."""
    _check_draw(chain, seed, min(indices), of)
    zeta = np.array([_draw(chain, m, seed, index, law, of) for index in indices])
    return _change(chain, zeta, of)


def _check_draw(chain: Chain, seed: int, index: int, of: Of) -> None:
    """Raise `InputError` unless this realisation can be drawn."""
    check(fault_of_whole("seed", seed, 0), fault_of_whole("index", index, 0))
    _check_of(chain, of)


def _draw(chain: Chain, m: float, seed: int, index: int, law: Law, of: Of) -> Array:
    """Return the random factors of a realisation, one for each contact or each grain."""
    # Each index has its own random stream, so a realisation does not depend on the other ones.
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    return factors(m, _count(chain, of), rng, law)


def _count(chain: Chain, of: Of) -> int:
    return chain.grains - (of in OF_CONTACTS)


def _change(chain: Chain, zeta: Array, of: Of) -> Array:
    """Return the factors on contact constants that result from random factors zeta."""
    # At a given force the stiffness is proportional to K^(1/delta).
    return zeta ** chain.law.power_of("disorder of stiffnesses") if of == "stiffness" else zeta


def _fields(chain: Chain, zeta: Array, of: Of) -> dict[str, Any]:
    """Return the fields of a chain whose contacts or grains are multiplied by these factors."""
    fields = chain.given() | {"masses": chain.masses}
    if of in OF_CONTACTS:
        fields["contact_constants"] = chain.contact_constants * _change(chain, zeta, of)
    elif of != "youngs_modulus":
        # A grain with a changed diameter keeps its density.
        fields["masses"] = chain.masses * (zeta**3 if of == "diameter" else zeta)
    # Impurities cannot be combined with given constants, so all grains are given one by one.
    impure = fields.pop("impurity", ())
    if of == "diameter" or impure:
        fields["diameter"] = chain.diameters * (zeta if of == "diameter" else 1.0)
    if of == "youngs_modulus" or impure:
        materials = materials_of(chain)
        if of == "youngs_modulus":
            materials = [
                Material(
                    density=base.density,
                    youngs_modulus=base.youngs_modulus * factor,
                    poissons_ratio=base.poissons_ratio,
                )
                for base, factor in zip(materials, zeta.tolist(), strict=True)
            ]
        fields["material"] = tuple(materials)
    return fields


def materials_of(chain: Chain) -> list[Material]:
    """Return the material of each grain, including impurities."""
    material: Any = chain.material
    materials = list(material) if isinstance(material, tuple) else [material] * chain.grains
    for impurity in chain.given().get("impurity", ()):
        materials[impurity.grain - 1] = impurity.material or materials[impurity.grain - 1]
    return materials


Fault = tuple[str, str] | None


def check(*faults: Fault) -> None:
    """Raise `InputError` with the given faults, if there are any."""
    if present := [fault for fault in faults if fault]:
        raise InputError(present)


def fault_of_whole(key: str, value: object, low: int, most: int = 2**63 - 1) -> Fault:
    """Return the fault of a value that is not an integer from `low` to `most`; None if it is."""
    integer = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if integer and low <= int(value) <= most:  # type: ignore[call-overload]
        return None
    end = f" to {most}" if most < 2**63 - 1 else ""
    return key, f"must be a whole number from {low}{end} (got {shown(value)})"


def fault_of_count(value: object, low: int) -> Fault:
    """Return the fault of a number of chains in an average; None if it is valid."""
    return fault_of_whole("realisations", value, low, MOST_CHAINS)


def _fault_of_choice(key: str, value: object, options: Sequence[str]) -> Fault:
    return None if value in options else (key, not_among(value, options))


def _check_of(chain: Chain, of: Of) -> None:
    """Raise `InputError` unless this quantity can be drawn for a chain."""
    check(_fault_of_choice("of", of, get_args(Of)))
    if of == "stiffness" and not chain.compressed:
        reason = "without gravity and load the stiffness of contacts at rest is 0"
        cure = f'{reason}: use of="constant"'
        raise InputError.at("gravity", cure)
    if of in ("diameter", "youngs_modulus") and chain.given_contact_constants is not None:
        cure = f'contact constants are given and do not follow from {of}: use of="constant"'
        raise InputError.at("contact_constants", cure)
