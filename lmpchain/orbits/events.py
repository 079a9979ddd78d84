"""Folds and bifurcations along a family of orbits, and the closing of a family."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..util.arrays import Array
from .floquet import Complex
from .orbit import Orbit
from .shooting import Constraint, Equations, OrbitPoint, Solution, plane

EVENTS = ("fold", "period doubling", "Neimark-Sacker", "branch point")


@dataclass(frozen=True)
class Location:
    """Tolerances for locating an event.

    Attributes
    ----------
    split : float
        Largest imaginary part of a mean of multipliers that counts as real; rounding errors split
        double means.
    tries : int
        Largest number of orbits computed for an event.
    near : float
        Tolerance of the position of an event, relative to the step.
    circle : float
        Largest distance from the unit circle at which a multiplier of a damped chain counts as
        crossing it. Multipliers farther away only meet and part outside the circle.
    """

    split: float = 1e-6
    tries: int = 64
    near: float = 1e-6
    circle: float = 1e-3


LOCATION = Location()


class Member(NamedTuple):
    """An orbit of a family with the direction of the family there.

    Attributes
    ----------
    orbit : Orbit
        The orbit.
    unknown : (U,) array
        Unknowns of the orbit.
    direction : (U,) array
        Unit vector of their change along the family.
    rate : float
        Rate of change of the parameter along this direction.
    turning : float
        Number that passes 0 where a pair of multipliers passes 1 without a bifurcation; NaN if no
        such number is known.
    solution : Solution
        Solution of Newton's method.
    multipliers : (2M,) array or None
        Multipliers of a damped orbit, accurate to about 1e-6; None for other orbits, or if they are
        not needed.
    """

    orbit: Orbit
    unknown: Array
    direction: Array
    rate: float
    turning: float
    solution: Solution
    multipliers: Complex | None = None


def locate(
    kind: str, start: Member, end: Member, at: Callable[[float], Member | None]
) -> Member | None:
    """Return the orbit just after an event between two orbits of a family; None without an event.

    The method is regula falsi, and every third try halves the interval if it has shrunk slowly.

    Parameters
    ----------
    kind : str
        One of `EVENTS`.
    start, end : Member
        Orbits between which the event is sought.
    at : function
        Function that returns the orbit at a fraction of the step, or None if none is found.
    """
    before = _count(kind, start)
    after = _count(kind, end)
    if before == after or (kind == "branch point" and start.turning * end.turning < 0):
        return None
    larger = max(before, after)
    meeting = kind == "Neimark-Sacker"
    centre = _centre(start if before == larger else end) if meeting else 0.0
    bounds = [0.0, 1.0]
    values = [
        _distance(kind, start, centre, before == larger),
        _distance(kind, end, centre, after == larger),
    ]
    event = end
    for number in range(LOCATION.tries):
        gap = bounds[1] - bounds[0]
        if number % 3 == 0:
            width = gap
        # Regula falsi is slow if another pair is nearer than the colliding pair; then the interval
        # is halved.
        slow = number % 3 == 2 and gap > width / 4
        position = _propose(bounds, values, slow)
        member = at(position)
        if member is None:
            break
        count = _count(kind, member)
        if meeting and count == larger:
            centre = _centre(member)
        side = int(count != before)
        bounds[side] = position
        values[side] = _distance(kind, member, centre, count == larger)
        if side:
            event = member
        if bounds[1] - bounds[0] < LOCATION.near:
            break
    return _passing(kind, event)


def _passing(kind: str, event: Member) -> Member | None:
    """Return an event; None if multipliers meet outside the unit circle and none crosses it."""
    if kind == "fold" or event.multipliers is None:
        return event
    return event if _distance(kind, event, 0.0, True) < LOCATION.circle else None


def _propose(bounds: list[float], values: list[float], halve: bool) -> float:
    """Return the zero of the line through two values, at some distance from the bounds."""
    # The values are unsigned; they have opposite signs at the two bounds.
    total = sum(values)
    share = 0.5 if halve or not 0 < total < np.inf else values[0] / total
    return bounds[0] + (bounds[1] - bounds[0]) * min(max(share, 0.02), 0.98)


def _count(kind: str, member: Member) -> int:
    """Return an integer that changes at an event of this kind."""
    if kind == "fold":
        return int(member.rate > 0)
    values = _values(member)
    real = _real(values)
    if kind == "Neimark-Sacker":
        pairs = _complex(values)
        # Any complex mean of a pair l, 1/l is unstable.
        return pairs.size if member.multipliers is None else int((np.abs(pairs) > 1).sum())
    return int((real > 1).sum() if kind == "branch point" else (real < -1).sum())


def _values(member: Member) -> Complex:
    """Return the means of pairs of multipliers, or the multipliers themselves of a damped chain.

    In both cases, a real multiplier above 1 or below -1 gives a real value above 1 or below -1.
    """
    return member.orbit.means if member.multipliers is None else member.multipliers


def _centre(member: Member) -> float:
    """Return the mean (A + 1/A) / 2 at which two pairs of multipliers collided."""
    pairs = _complex(_values(member))
    return float(pairs.real[np.abs(pairs.imag).argmin()])


def _distance(kind: str, member: Member, centre: float, met: bool) -> float:
    """Return the size of a quantity that is zero at an event of this kind; infinite if unknown.

    For a Neimark-Sacker bifurcation it is the discriminant of the two pairs of multipliers that
    meet at the mean `centre`; `met` is true after they have met. In a damped chain it is the
    distance of the nearest complex multiplier from the unit circle.
    """
    if kind == "fold":
        return abs(member.rate)
    mean = _values(member)
    real = np.sort(_real(mean))
    if kind == "Neimark-Sacker" and member.multipliers is not None:
        return float(np.abs(np.abs(_complex(mean)) - 1).min(initial=np.inf))
    if kind == "Neimark-Sacker":
        if met:
            pairs = _complex(mean)
            return float((4 * pairs.imag**2).min(initial=np.inf))
        # The two neighbouring real means nearest to the meeting point.
        nearest = np.abs(real[1:] + real[:-1] - 2 * centre).argmin() if real.size > 1 else 0
        return float((np.diff(real) ** 2)[nearest]) if real.size > 1 else np.inf
    # Complex multipliers do not tell how far they are from becoming real.
    return float(np.abs(real - (1 if kind == "branch point" else -1)).min(initial=np.inf))


def _complex(mean: Complex) -> Complex:
    return mean[np.abs(mean.imag) > LOCATION.split]


def _real(mean: Complex) -> Array:
    return mean.real[np.abs(mean.imag) <= LOCATION.split]


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
