"""Scenes that differ in numbers of their grains and contacts only, derived together."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..chain.band_edge import band_edges
from ..chain.chain import Chain
from ..chain.equilibrium import Equilibrium, derive_chain
from ..chain.plausible import LIMITS
from ..disorder.draws import OF_CONTACTS, drawn_constants
from ..errors import InputError
from ..scene.scene import Scene
from ..util.arrays import Array
from .axes import INDEX
from .file import Sweep
from .quantities import quantity, with_gathered

Made = Scene | InputError


def scenes(plan: Sweep, first: int, count: int, together: bool) -> list[Made]:
    """Return so many scenes of a sweep, or why they cannot be made.

    Those that are alike are made `together`, if that is asked for. Every grain is recorded that what is kept takes;
    such scenes answer, but do not describe themselves in full.
    """
    made: list[Made] = []
    length = len(plan.axes[-1]) if together and _alike(plan) else 1
    while len(made) < count:
        number = first + len(made)
        left = min(length - number % length, count - len(made))
        made += _together(plan, number, left) if left > 1 else [_alone(plan, number)]
    return made


def _alike(plan: Sweep) -> bool:
    """Say whether scenes differ along the last axis in numbers of grains and contacts only."""
    last = plan.axes[-1]
    return (
        last.drawn
        and set(last.columns) <= {INDEX}
        and not any(axis.arrays for axis in plan.axes[:-1])
    )


def _alone(plan: Sweep, number: int) -> Made:
    try:
        return _wider(plan.scene(plan.place(number)), plan)
    except InputError as error:
        return error


def _wider(scene: Scene, plan: Sweep) -> Scene:
    """Return the scene with those grains and forces recorded, too, that measuring what is kept takes."""
    keep = plan.keep
    scene = with_gathered(scene, keep, plan.moves_grains)
    if scene.grains == "all" or all(
        quantity(name).whole or name in scene.quantities for name in keep
    ):
        return scene
    last = scene.chain.grains
    more = {n for grain in scene.recorded.tolist() for n in (grain - 1, grain, grain + 1)}
    more |= {last - 1, last} if "wall_force" in keep else set()
    grains = tuple(sorted(more - {0, last + 1}))
    return Scene._unchecked(**scene.given() | {"grains": "all" if len(grains) == last else grains})


def _together(plan: Sweep, first: int, count: int) -> list[Made]:
    """Return neighbours along the last axis, of which the first stands for all that they share."""
    numbers = range(first, first + count)
    places = [plan.place(number) for number in numbers]
    try:
        common = _wider(plan.regular_scene(places[0]), plan)
        disorder = plan.disorder(places[0])
        chain = common.chain
        if not _derivable(common) or (disorder and disorder.of not in OF_CONTACTS):
            return [_alone(plan, number) for number in numbers]
        factors: Array | None = None
        if disorder:
            law = {key: value for key, value in disorder.given().items() if key != "index"}
            factors = drawn_constants(chain, indices=[place[-1] for place in places], **law)
    except InputError:
        return [_alone(plan, number) for number in numbers]
    values = [plan.draw_values(place, chain.grains) for place in places]
    drawn = {
        key.removeprefix("chain."): np.array([row[key] for row in values]) for key in values[0]
    }
    with np.errstate(all="ignore"):  # what is not sound is made alone, which says why
        equilibria = derive_chain(chain.grains_with(drawn))
        if factors is not None:
            constants = equilibria.contacts.constant[..., 1:-1] * factors
            changed = drawn | {"contact_constants": constants}
            equilibria = derive_chain(chain.grains_with(changed))
        sound = _sound(chain, equilibria, drawn)
        chains = _chains(chain, equilibria, "diameter" in drawn)
    made: list[Made] = []
    for number, like, acceptable in zip(numbers, chains, sound, strict=True):
        scene = _scene(common, like, bool(drawn)) if acceptable else None
        made.append(_alone(plan, number) if scene is None else scene)
    return made


def _derivable(scene: Scene) -> bool:
    """Say whether scenes like this differ in derived arrays only.

    Else each is cut to the grains that its wave reaches, or has an excitation of its own.
    """
    return scene.light_cone is None and scene.chain.grains > 1 and not scene.excitation.of_chain


def _sound(chain: Chain, equilibria: Equilibrium, drawn: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Say which of R chains like this `Chain` accepts beyond doubt, (R,)."""
    sound = equilibria.computable(chain.movable)
    sound &= (equilibria.contacts.constant[:, 1:-1] > 0).all(1)
    for key, values in drawn.items():
        least, most = (-1.0, 0.5) if key == "material.poissons_ratio" else (0.0, np.inf)
        sound &= ((values > least) & (values <= most) & np.isfinite(values)).all(1)
    if drawn:  # random contacts alone may be as soft as they come out
        sound &= (equilibria.compression <= LIMITS.compression).all(1)
    return sound


def _chains(chain: Chain, equilibria: Equilibrium, widths: bool) -> list[Chain]:
    """Return R chains like this with equilibria of their own, and with diameters if these differ."""
    fields = {key: value for key, value in chain.given().items() if key != "impurity"}
    edges = band_edges(*map(np.ascontiguousarray, equilibria.dynamical_matrix(chain.movable)))
    chains = []
    for row, edge in enumerate(edges.tolist()):
        equilibrium = equilibria.row(row)
        fields["masses"] = equilibrium.masses
        fields["contact_constants"] = equilibrium.contacts.constant[1:-1]
        if widths or chain.impurity:
            fields["diameter"] = equilibrium.diameters
        made = Chain._unchecked(**fields)
        chains.append(made._with_known(equilibrium=equilibrium, band_edge=edge))
    return chains


def _scene(common: Scene, chain: Chain, checked: bool) -> Scene | None:
    """Return a scene like another with this chain; None if it is struck too hard for that."""
    fields = common.given() | {"chain": chain}
    try:
        scene = Scene(**fields) if checked else Scene._unchecked(**fields)
    except InputError:
        return None
    return scene._with_known(light_cone=None)  # as of the first: all of them fit in one batch
