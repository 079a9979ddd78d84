"""Branches of orbits of twice the period, which begin where a family doubles its period."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import svd

from ..errors import InputError, RunFailed, shown
from ..util.arrays import Array
from ..util.linear_algebra import in_one_thread
from .continuation import family_curve
from .family import Event
from .flow import Flow
from .orbit import Orbit, orbit_of
from .shooting import OrbitPoint, estimate_error, plane


@dataclass(frozen=True)
class Branching:
    """Distance from a period doubling at which the first orbit of its branch is sought.

    Attributes
    ----------
    distances : tuple of float
        Distances relative to the size of the orbit, which are tried one after the other.
    still : float
        Largest change of a momentum, relative to the change of the state, for which all grains
        begin at rest.
    """

    distances: tuple[float, ...] = (0.02, 0.05, 0.005)
    still: float = 1e-6


BRANCHING = Branching()


@in_one_thread
def switch(event: Event) -> Orbit:
    """Return an orbit of twice the period on the branch that starts at a period doubling.

    The orbit is displaced a little from the orbit of the event along the Floquet direction of the
    multiplier -1, and the parameter of the family changes accordingly. Use `follow` to continue the
    branch from this orbit.

    Parameters
    ----------
    event : Event
        Period doubling of a family.

    Returns
    -------
    Orbit

    Raises
    ------
    InputError
        If the event is not a period doubling.
    RunFailed
        If no orbit of twice the period is found.
    """
    if not isinstance(event, Event) or event.kind != "period doubling":
        kind = event.kind if isinstance(event, Event) else event
        raise InputError.at("event", f'must be a "period doubling" of a family (got {shown(kind)})')
    single = event.orbit
    direction = svd(single.monodromy + np.eye(len(single.monodromy)))[2][-1]
    momenta = direction[single.flow.size :]
    twice = replace(
        single,
        period=2 * single.period,
        flow=replace(single.flow, cycles=2 * single.flow.cycles),
        mesh=np.tile(single.mesh, 2) / 2,
        # Either of two orbits half a period apart may begin with all grains at rest.
        reversible=single.reversible and bool(np.abs(momenta).max() < BRANCHING.still),
    )
    curve, first = family_curve(twice, event.parameter, event.value, event.value, event.hold)
    curve = replace(curve, exact=True)
    equations = curve.equations
    begin = equations.pack(first)
    row = np.zeros(begin.size)
    inner = direction[: equations.period_at(begin)]
    row[: inner.size] = inner / np.linalg.norm(inner)
    for share in BRANCHING.distances:
        ahead = begin + share * np.linalg.norm(begin[: inner.size]) * row
        beside = plane(ahead, row)
        solution = curve.solve(equations.unpack(ahead), beside)
        if solution is None:
            continue
        point = solution.point
        if _differs(equations.flow_at(point.value), single.mesh, point, share):
            error = estimate_error(equations, solution, [*curve.held, beside])
            return orbit_of(equations, solution, error)
    raise RunFailed(f"no orbit of twice the period was found near {event.value:g}")


def _differs(flow: Flow, mesh: Array, point: OrbitPoint, share: float) -> bool:
    """Return whether an orbit differs from itself half a period later by more than rounding."""
    half = replace(flow, cycles=max(flow.cycles // 2, 1))
    later = half.run(point.state, point.period / 2, mesh).end
    return bool(np.linalg.norm(later - point.state) > share * np.linalg.norm(point.state))
