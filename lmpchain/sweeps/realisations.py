"""Batches of scenes that differ only in numbers of their grains and contacts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from .. import engines
from ..chain.band_edge import band_edges
from ..chain.chain import Chain
from ..chain.equilibrium import Equilibrium, derive_chain
from ..chain.plausible import LIMITS
from ..disorder.draws import OF_CONTACTS, drawn_constants
from ..errors import InputError
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.validation import make_unchecked, with_derived
from .axes import INDEX
from .file import Place, Sweep
from .laws import DAMPING
from .quantities import quantity, with_gathered

Result = Scene | InputError


def scenes(plan: Sweep, first: int, count: int, together: bool) -> list[Result]:
    """Return consecutive scenes of a sweep, or the errors that prevent them.

    If `together` is true, similar scenes are derived in one batch. The scenes record all grains
    that the stored quantities need. They can be solved, but their options do not describe them
    completely.
    """
    results: list[Result] = []
    length = len(plan.axes[-1]) if together and _alike(plan) else 1
    while len(results) < count:
        number = first + len(results)
        # A batch ends with the last axis, because scenes differ in other keys beyond it.
        end = min(number + length - number % length, first + count)
        results += _together(plan, range(number, end))
    return results


def _alike(plan: Sweep) -> bool:
    """Return whether scenes along the last axis differ only in numbers of grains and contacts."""
    last = plan.axes[-1]
    return (
        last.drawn
        and set(last.columns) <= {INDEX}
        and not any(axis.arrays for axis in plan.axes[:-1])
    )


def _together(plan: Sweep, numbers: range) -> list[Result]:
    """Return neighbours along the last axis, derived together if possible."""
    derived: list[Scene | None] = [None] * len(numbers)
    if len(numbers) > 1:
        # A fault of the common tables is a fault of every scene.
        with suppress(InputError):
            derived = _derive(plan, [plan.place(number) for number in numbers]) or derived
    return [
        _alone(plan, number) if scene is None else scene
        for number, scene in zip(numbers, derived, strict=True)
    ]


def _alone(plan: Sweep, number: int) -> Result:
    try:
        return _wider(plan.scene(plan.place(number)), plan)
    except InputError as error:
        return error


def _wider(scene: Scene, plan: Sweep) -> Scene:
    """Return the scene with all grains and forces recorded that the quantities need."""
    keep = plan.keep
    scene = with_gathered(scene, keep, engines.get(plan.engine).moves_grains)
    if scene.grains == "all" or all(
        quantity(name).recorded or name in scene.quantities for name in keep
    ):
        return scene
    last = scene.chain.grains
    # Forces and energies of contacts also need the neighbours of a grain.
    numbers = {n for grain in scene.recorded.tolist() for n in (grain - 1, grain, grain + 1)}
    numbers |= {last - 1, last} if "wall_force" in keep else set()
    grains = tuple(sorted(numbers - {0, last + 1}))
    return make_unchecked(
        Scene, **scene.given() | {"grains": "all" if len(grains) == last else grains}
    )


def _derive(plan: Sweep, places: Sequence[Place]) -> list[Scene | None] | None:
    """Return scenes whose chains are derived in one batch, or None if this is not possible.

    The first scene provides everything that the scenes share; `InputError` is raised if it is not
    valid. A scene is None if its chain is not certainly valid.
    """
    common = _wider(plan.regular_scene(places[0]), plan)
    disorder = plan.disorder(places[0])
    chain = common.chain
    # Each scene would have a different light cone or excitation.
    if common.light_cone is not None or common.excitation.of_chain:
        return None
    if chain.grains == 1 or (disorder and disorder.of not in OF_CONTACTS):
        return None
    values = [plan.draw_values(place, chain.grains) for place in places]
    # Damping is drawn with the chain, and does not change the equilibrium.
    if any(key in DAMPING for key in values[0]):
        return None
    drawn = {
        key.removeprefix("chain."): np.array([row[key] for row in values]) for key in values[0]
    }
    # A chain with invalid numbers is made alone, which raises an error with the reason.
    with np.errstate(all="ignore"):
        equilibria = derive_chain(chain, drawn)
        if disorder:
            law = {key: value for key, value in disorder.given().items() if key != "index"}
            factors = drawn_constants(chain, indices=[place[-1] for place in places], **law)
            # The random contacts multiply the contacts between the drawn grains.
            constants = equilibria.contacts.constant[..., 1:-1] * factors
            equilibria = derive_chain(chain, drawn | {"contact_constants": constants})
        sound = _sound(chain, equilibria, drawn)
        chains = _chains(chain, equilibria, "diameter" in drawn)
    return [
        _scene(common, chain, bool(drawn)) if accepted else None
        for chain, accepted in zip(chains, sound, strict=True)
    ]


def _sound(chain: Chain, equilibria: Equilibrium, drawn: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return a mask of the R chains that `Chain` certainly accepts, (R,)."""
    sound = equilibria.computable(chain.movable)
    sound &= (equilibria.contacts.constant[:, 1:-1] > 0).all(1)
    for key, values in drawn.items():
        low, high = (-1.0, 0.5) if key == "material.poissons_ratio" else (0.0, np.inf)
        sound &= ((values > low) & (values <= high) & np.isfinite(values)).all(1)
    # Random contacts have no lower limit of their stiffness.
    if drawn:
        sound &= (equilibria.compression <= LIMITS.compression).all(1)
    return sound


def _chains(chain: Chain, equilibria: Equilibrium, widths: bool) -> list[Chain]:
    """Return R chains like this one, with these equilibria and, if they differ, diameters."""
    fields = {key: value for key, value in chain.given().items() if key != "impurity"}
    edges = band_edges(*map(np.ascontiguousarray, equilibria.dynamical_matrix(chain.movable)))
    chains = []
    for row, edge in enumerate(edges.tolist()):
        equilibrium = equilibria.row(row)
        fields["masses"] = equilibrium.masses
        fields["contact_constants"] = equilibrium.contacts.constant[1:-1]
        if widths or chain.impurity:
            fields["diameter"] = equilibrium.diameters
        # Known results are passed on, because each chain would derive them again.
        derived = {"equilibrium": equilibrium, "band_edge": edge}
        chains.append(with_derived(make_unchecked(Chain, **fields), **derived))
    return chains


def _scene(common: Scene, chain: Chain, checked: bool) -> Scene | None:
    """Return the common scene with another chain; None if the strike is too strong for it."""
    fields = common.given() | {"chain": chain}
    try:
        scene = Scene(**fields) if checked else make_unchecked(Scene, **fields)
    except InputError:
        return None
    # All scenes share the grains of the first one, so that they fit in one batch.
    return with_derived(scene, light_cone=None)
