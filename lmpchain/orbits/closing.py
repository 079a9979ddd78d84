"""Whether a family comes back to orbits that it has been through."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..util.arrays import Array
from .events import Place
from .shooting import Constraint, Equations, Point, Solution

BESIDE = 0.05  # of a step: how near it must pass by an earlier orbit for the two to be compared
AGAIN = 1e-8  # relative distance at which orbits are the same, and the errors of their steps
LOOKS = np.linspace(0.0, 1.0, 65)[:, None]  # on the way from one orbit to the next


class Aspect(NamedTuple):
    """An orbit as the unknowns (U,) show it from one of its moments of rest, and its relative error."""

    unknown: Array
    error: float


def aspects(equations: Equations, place: Place) -> list[Aspect]:
    """Return a place, and the same orbit half a period later if it rests there otherwise."""
    point, mesh = place.solution.point, place.solution.mesh
    seen = [Aspect(place.unknown, place.orbit.error)]
    if equations.reversible:
        flow = equations.flow_at(point.value)
        half = flow.run(point.state, point.period, mesh[: mesh.size // 2])
        state = flow.canonical(half.displacement[-1], half.velocity[-1])
        later = equations.pack(Point(state, point.period, point.value))
        if not _same(later, place.unknown, place.orbit.error):
            seen.append(Aspect(later, place.orbit.error))
    return seen


def returns(
    solved: Callable[[Point, Constraint, Place], Solution | None],
    equations: Equations,
    earlier: Sequence[Aspect],
    here: Place,
    there: Place,
) -> bool:
    """Return whether the family between two places goes through one of its earlier orbits.

    Each that lies beside the way is compared with the orbit solved for in the plane across the way through it.
    """
    apart = there.unknown - here.unknown
    length = float(np.linalg.norm(apart))
    middle = (here.unknown + there.unknown) / 2
    for known in earlier:
        if known.unknown is here.unknown or np.linalg.norm(known.unknown - middle) > length:
            continue
        way = _way(here, there, length)
        distance = np.linalg.norm(way - known.unknown, axis=1)
        nearest = int(distance.argmin())
        if distance[nearest] > BESIDE * length:
            continue
        found = solved(equations.unpack(way[nearest]), _plane(known.unknown, apart / length), there)
        if found and _same(
            equations.pack(found.point), known.unknown, there.orbit.error + known.error
        ):
            return True
    return False


def _plane(through: Array, normal: Array) -> Constraint:
    return Constraint(lambda unknown, _: (float(normal @ (unknown - through)), normal))


def _way(here: Place, there: Place, length: float) -> Array:
    """Return the cubic from one place to the next along the directions of the family, (65, U)."""
    t, left = LOOKS, 1 - LOOKS
    ends = left**2 * (1 + 2 * t) * here.unknown + t**2 * (1 + 2 * left) * there.unknown
    return np.asarray(ends + length * t * left * (left * here.direction - t * there.direction))


def _same(one: Array, other: Array, error: float) -> bool:
    return bool(np.abs(one - other).max() < (AGAIN + 10 * error) * np.abs(other).max())
