"""Closed families of orbits, which return to orbits that they have already passed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..util.arrays import Array
from .events import Member
from .shooting import Constraint, Equations, OrbitPoint, Solution, plane


@dataclass(frozen=True)
class Closing:
    """Tolerances within which an orbit of a family equals an earlier one.

    Attributes
    ----------
    near : float
        Largest distance of an earlier orbit from the path of the family, relative to the step, for
        which the two are compared.
    equal : float
        Largest relative distance of two equal orbits, in addition to ten times their errors.
    """

    near: float = 0.05
    equal: float = 1e-8


CLOSING = Closing()


class Aspect(NamedTuple):
    """Unknowns (U,) of an orbit from one of its moments of rest, and its relative error."""

    unknown: Array
    error: float


def aspects(equations: Equations, member: Member) -> list[Aspect]:
    """Return the orbit from t = 0, and from half a period later if it rests there too."""
    point = member.solution.point
    mesh = member.solution.mesh
    states = [Aspect(member.unknown, member.orbit.error)]
    if equations.reversible:
        flow = equations.flow_at(point.value)
        half = flow.run(point.state, point.period, mesh[: mesh.size // 2])
        later = equations.pack(OrbitPoint(half.end, point.period, point.value))
        if not _equal(later, member.unknown, member.orbit.error):
            states.append(Aspect(later, member.orbit.error))
    return states


def returns(
    solver: Callable[[OrbitPoint, Constraint, Member], Solution | None],
    equations: Equations,
    earlier: Sequence[Aspect],
    start: Member,
    end: Member,
) -> bool:
    """Return whether the family passes one of its earlier orbits between two orbits.

    Each earlier orbit near the path of the family is compared with the orbit of the family in the
    plane through the earlier orbit and across the path.
    """
    step = end.unknown - start.unknown
    length = float(np.linalg.norm(step))
    middle = (start.unknown + end.unknown) / 2
    for aspect in earlier:
        # Orbits farther from the middle than the step length are not between the two orbits.
        far = np.linalg.norm(aspect.unknown - middle) > length
        if aspect.unknown is start.unknown or far:
            continue
        curve = _curve(start, end, length)
        distance = np.linalg.norm(curve - aspect.unknown, axis=1)
        nearest = int(distance.argmin())
        if distance[nearest] > CLOSING.near * length:
            continue
        across = plane(aspect.unknown, step / length)
        solution = solver(equations.unpack(curve[nearest]), across, end)
        error = end.orbit.error + aspect.error
        if solution and _equal(equations.pack(solution.point), aspect.unknown, error):
            return True
    return False


def _curve(start: Member, end: Member, length: float) -> Array:
    """Return points (65, U) of the cubic curve between two orbits along the family directions."""
    t = np.linspace(0.0, 1.0, 65)[:, None]
    s = 1 - t
    ends = s**2 * (1 + 2 * t) * start.unknown + t**2 * (1 + 2 * s) * end.unknown
    return np.asarray(ends + length * t * s * (s * start.direction - t * end.direction))


def _equal(unknown: Array, other: Array, error: float) -> bool:
    difference = np.abs(unknown - other).max()
    return bool(difference < (CLOSING.equal + 10 * error) * np.abs(other).max())
