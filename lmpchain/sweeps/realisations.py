"""Scenes that differ in numbers of their grains and contacts only, made as arrays and not one by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..chain.band_edge import band_edges
from ..chain.chain import LARGEST_OVERLAP, Chain
from ..chain.contacts import Contacts, dynamical_matrix, hertz_constant
from ..chain.impurities import with_impurities
from ..disorder.draws import OF_CONTACTS, drawn_constants
from ..errors import InputError
from ..scene.scene import Scene
from ..scene.strike import overlaps_of, pair_frequency, strike_number
from ..util.arrays import Array, read_only
from .axes import INDEX
from .file import Sweep
from .quantities import quantity, with_forces

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
        return _wider(plan.scene(plan.place(number)), plan.keep)
    except InputError as error:
        return error


def _wider(scene: Scene, keep: Sequence[str]) -> Scene:
    """Return the scene with those grains and forces recorded, too, that measuring what is kept takes."""
    scene = with_forces(scene, keep)
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
    """Return neighbours along the last axis, of which the first stands for what they have in common."""
    numbers = range(first, first + count)
    places = [plan.place(number) for number in numbers]
    try:
        common, disorder = (
            _wider(plan.regular_scene(places[0]), plan.keep),
            plan.disorder(places[0]),
        )
        chain = common.chain
        apart = (
            common.reached.chain.grains < chain.grains or chain.grains == 1
        )  # each is cut to its own
        apart |= common.excitation.of_chain or (
            disorder is not None and disorder.of not in OF_CONTACTS
        )
        if apart:
            return [_alone(plan, number) for number in numbers]
        change = np.ones((1, 1))
        if disorder:
            given = {key: value for key, value in disorder.given().items() if key != "index"}
            change = drawn_constants(chain, indices=[place[-1] for place in places], **given)
    except InputError:
        return [_alone(plan, number) for number in numbers]
    drawn = [plan.draw_values(place, chain.grains) for place in places]
    columns = {key: np.array([each[key] for each in drawn]) for key in drawn[0]}
    with np.errstate(all="ignore"):  # what is not sound is made alone, which says why
        parts = _chains(chain, columns, change, count)
        parts["first"] = overlaps_of(chain, common.excitation, parts["contacts"], parts["masses"])
        sound = _sound(parts, bool(columns))
        known = {key: values.tolist() for key, values in _known(common, parts).items()}
        parts |= _pattern(chain, parts)
    return [
        _scene(common, parts, known, row) if sound[row] else _alone(plan, n)
        for row, n in enumerate(numbers)
    ]


def _chains(
    chain: Chain, columns: Mapping[str, Array], change: Array, count: int
) -> dict[str, Any]:
    """Return masses, constants and contacts of chains like one, but for these columns, (R, ...) each."""

    def by_grain(key: str, otherwise: Array) -> Array:
        return columns[key] if key in columns else np.broadcast_to(otherwise, (count, chain.grains))

    def impure(values: Array, key: str) -> Array:
        return (
            np.array([with_impurities(row, chain.impurity, key) for row in values])
            if chain.impurity
            else values
        )

    def of_material(key: str) -> Array:
        if (drawn := columns.get(f"chain.material.{key}")) is None:
            return np.broadcast_to(chain.by_grain(key), (count, chain.grains))
        values = np.array(drawn)
        for impurity in chain.impurity:
            if impurity.material is not None:
                values[:, impurity.grain - 1] = getattr(impurity.material, key)
        return values

    diameter = impure(by_grain("chain.diameter", chain.diameters), "diameter")
    if "chain.masses" in columns or "masses" in chain.model_fields_set:
        masses = impure(by_grain("chain.masses", chain.masses), "mass")
    else:
        masses = impure(of_material("density") * np.pi / 6 * diameter**3, "mass")
    modulus = of_material("youngs_modulus") / (1 - of_material("poissons_ratio") ** 2)
    ends = [(chain.top_material, modulus[:, :1]), (chain.bottom_material, modulus[:, -1:])]
    above, below = (
        np.full_like(at, wall.plane_strain_modulus) if wall else at  # type: ignore[union-attr]
        for wall, at in ends
    )
    flat = np.zeros((count, 1))
    length = np.concatenate(
        (diameter[:, :1], (diameter[:, :-1] + diameter[:, 1:]) / 2, diameter[:, -1:]), axis=1
    )
    natural = hertz_constant(
        np.concatenate((above, modulus, below), axis=1),
        np.concatenate((flat, 2 / diameter, flat), axis=1),
        length,
        chain.exponent,
    )
    if "chain.contact_constants" in columns:
        between = columns["chain.contact_constants"]
    elif "contact_constants" in chain.model_fields_set:
        between = np.broadcast_to(chain.contact_constants, (count, chain.grains - 1))
    else:
        between = natural[:, 1:-1]
    between = between * change
    if "wall_constants" in chain.model_fields_set:
        walls = np.tile(chain.wall_constants, (count, 1))
    else:
        walls = np.array([chain.top == "wall", chain.bottom == "wall"], dtype=float)
        walls = walls * (natural[:, [0, -1]] * (between[:, [0, -1]] / natural[:, [1, -2]]))
    constant = np.concatenate((walls[:, :1], between, walls[:, 1:]), axis=1)
    weight = chain.gravity * np.cumsum(masses.astype(np.longdouble), axis=1)
    force = np.concatenate(
        (np.full((count, 1), chain.top_load), (chain.top_load + weight).astype(float)), axis=1
    )
    contacts = Contacts(constant, np.where(constant > 0, force, 0.0), chain.exponent)
    for each in (diameter, masses, between, walls, contacts.constant, contacts.force):
        read_only(each)  # as are the rows that chains get
    matrices = dynamical_matrix(contacts.stiffness, masses[:, : chain.movable])
    edges = band_edges(*map(np.ascontiguousarray, matrices)).tolist()
    return {"diameter": diameter, "masses": masses, "between": between, "walls": walls, "length": length,
            "contacts": contacts, "band_edge": edges, "given": {key.split(".")[1] for key in columns}}  # fmt: skip


def _sound(parts: Mapping[str, Any], drawn: bool) -> np.ndarray:
    """Say which of the chains `Chain` and `Scene` accept beyond doubt, (R,)."""
    contacts, masses, room = parts["contacts"], parts["masses"], LARGEST_OVERLAP * parts["length"]
    first = parts["first"]
    sound = np.isfinite(contacts.stiffness[:, :-1] / masses).all(1) & (masses > 0).all(1)
    sound &= (
        (parts["diameter"] > 0).all(1)
        & (parts["between"] > 0).all(1)
        & np.isfinite(parts["between"]).all(1)
    )
    if drawn:  # random contacts alone may be as soft as they come out
        sound &= (contacts.overlap <= room).all(1) & (first <= room).all(1)
    return np.asarray(sound)


def _pattern(chain: Chain, parts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields that all chains share, those of them that are given, and what all scenes share."""
    fields = {key: value for key, value in chain.given().items() if key != "impurity"}
    fields |= {"masses": parts["masses"][0], "contact_constants": parts["between"][0]}
    if chain.impurity or "diameter" in parts["given"]:
        fields["diameter"] = parts["diameter"][0]
    own = [
        name
        for name in Chain.model_fields
        if name not in ("masses", "contact_constants", "wall_constants")
    ]
    pattern = Chain._unchecked(**fields)
    return {
        "common": {name: getattr(pattern, name) for name in own},
        "fields": frozenset(pattern.model_fields_set),
    }


def _known(common: Scene, parts: Mapping[str, Any]) -> dict[str, Array]:
    """Return what `Scene` derives from contacts and masses, of all scenes at once, (R,) each, by name."""
    contacts, masses, chain, excitation = (
        parts["contacts"],
        parts["masses"],
        common.chain,
        common.excitation,
    )
    known: dict[str, Any] = {"_pair_frequency": pair_frequency(contacts, masses, parts["first"])}
    if not excitation.does_work:
        u, v = common.initial()
        first, last = excitation.reach(chain)
        near, above = slice(max(first - 2, 0), last + 2), slice(max(first - 2, 0), last + 3)
        held = Contacts(
            contacts.constant[:, above], contacts.force[:, above], contacts.exponent
        ).energy
        known["energy"] = 0.5 * (masses[:, near] * v[near] ** 2).sum(-1) + held(
            contacts.closer(u)[above]
        ).sum(-1)
    known["strike_number"] = strike_number(chain, excitation, contacts, masses)
    energy = known.get("energy", np.full(len(masses), np.inf))
    known["largest_strain"] = contacts.largest_strain(energy[:, None])
    return known


def _scene(
    common: Scene, parts: Mapping[str, Any], known: Mapping[str, list[float]], row: int
) -> Scene:
    """Return one of the scenes, with what is known of all of them filled in."""
    contacts = parts["contacts"]
    own = Contacts(contacts.constant[row], contacts.force[row], contacts.exponent)
    derived = {
        name: getattr(contacts, name)[row] for name in ("exists", "pressed", "overlap", "stiffness")
    }
    own.__dict__.update(derived)
    fields = parts["common"] | {
        "masses": parts["masses"][row],
        "contact_constants": parts["between"][row],
        "diameters": parts["diameter"][row],
        "contacts": own,
        "wall_constants": parts["walls"][row],
        "band_edge": parts["band_edge"][row],
    }
    if "diameter" in parts["given"]:
        fields["diameter"] = parts["diameter"][row]
    chain = Chain._filled(fields, set(parts["fields"]))
    recorded = {
        name: getattr(common, name)
        for name in ("excitation", "duration", "samples", "grains", "quantities")
    }
    scene = Scene._filled({"chain": chain} | recorded, set(common.model_fields_set))
    shared = {
        "imposed": common.imposed,
        "light_cone": None,
        "_surroundings": (1, chain, scene.excitation),
    }
    scene.__dict__.update(shared, **{key: values[row] for key, values in known.items()})
    return scene
