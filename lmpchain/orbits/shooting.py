"""Newton's method for periodic orbits, with the exact tangent map of the steps taken.

The time mesh of an orbit has fixed fractions of its period, which are short where contacts open or
close. The force has a singular derivative where a contact opens, so that steps of equal length
would lose their order of accuracy there. Steps that are fixed in advance keep the map symplectic,
whatever their lengths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock
from typing import Any, NamedTuple
from warnings import catch_warnings

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import LinAlgError, LinAlgWarning, lstsq
from scipy.linalg import solve as solve_square

from ..errors import InputError, RunFailed
from ..integrators.halving import SAFETY, HalvedAnswer, halve
from ..util.arrays import EPSILON, Array
from .flow import Flow, Passage


@dataclass(frozen=True)
class Mesh:
    """Lengths of mesh steps.

    Attributes
    ----------
    reach : float
        Step times the highest frequency of the chain in its stiffest state, rad.
    grading : float
        Step relative to the time to the nearest opening.
    crossing : float
        Shortest step, at an opening, times the highest frequency, rad; the error of such a step is
        negligible.
    steps : int
        Largest number of steps in a period.
    """

    reach: float = 0.3
    grading: float = 0.35
    crossing: float = 1e-5
    steps: int = 20_000


MESH = Mesh()


def highest_frequency(flow: Flow, displacement: Array) -> float:
    """Return a bound on the frequencies of the chain linearised about states (K, N), rad/s."""
    contacts = flow.chain.contacts
    overlap = np.maximum(contacts.overlap + contacts.closer(displacement), 0.0).max(0)
    stiffness = contacts.stiffness_at(overlap)
    pull = (stiffness[:-1] + stiffness[1:])[flow.free]
    return float(np.sqrt(2 * (pull / flow.chain.masses[flow.free]).max()))


def openings(flow: Flow, passage: Passage, period: float, mesh: Array) -> Array:
    """Return the times at which contacts open or close, as ascending fractions of the period."""
    contacts = flow.chain.contacts
    overlap = contacts.overlap + contacts.closer(passage.displacement, passage.wall[0])
    # A contact pressed only by rounding errors does not count as closed.
    noise = 1e-9 * np.abs(overlap).max()
    crossing = contacts.exists & (overlap.min(0) < 0) & (overlap.max(0) > noise)
    if not crossing.any():
        return np.zeros(0)
    time = np.concatenate(([0.0], np.cumsum(mesh)))
    rate = contacts.closer(passage.velocity, passage.wall[1]) * period
    spline = CubicHermiteSpline(time, overlap[:, crossing], rate[:, crossing])
    times = np.concatenate([np.asarray(roots) for roots in spline.roots(extrapolate=False)])
    return np.sort(times[np.isfinite(times)])


def uniform(flow: Flow, period: float, displacement: Array, reach: float = MESH.reach) -> Array:
    """Return an even number of equal fractions that resolve the motion through states (K, N)."""
    count = highest_frequency(flow, displacement) * period / reach
    half = max(24, int(np.ceil(min(count, MESH.steps)))) // 2 + 1
    return np.full(2 * half, 0.5 / half)


def graded(
    flow: Flow, period: float, displacement: Array, times: Array, reach: float = MESH.reach
) -> Array:
    """Return fractions that decrease towards openings at `times` (E,).

    The fractions are symmetric in time unless there is a drive, because driven motion is not.
    """
    even = uniform(flow, period, displacement, reach)
    if not times.size:
        return even
    shortest = MESH.crossing / (highest_frequency(flow, displacement) * period)
    mirrored = flow.drive is None
    mirrors = (1 - times,) if mirrored else ()
    near = np.unique(np.concatenate((times, times - 1, times + 1, *mirrors)))
    # Openings closer together than the shortest step are merged.
    near = near[np.append(True, np.diff(near) > shortest)]
    # The density of steps is evaluated at close nodes on both sides of every opening.
    away = np.geomspace(shortest / 4, 4 * even[0] / MESH.grading, 600)
    beside = (*(near + away[:, None]), *(near - away[:, None]))
    end = 0.5 if mirrored else 1.0
    nodes = np.concatenate((np.linspace(0.0, end, 8 * even.size), near, *beside))
    nodes = np.unique(np.concatenate(([0.0], nodes[(nodes > 0) & (nodes < end)], [end])))
    after = np.searchsorted(near, nodes).clip(1, near.size - 1)
    distance = np.minimum(np.abs(near[after] - nodes), np.abs(near[after - 1] - nodes))
    density = 1 / np.clip(MESH.grading * reach / MESH.reach * distance, shortest, even[0])
    count = np.concatenate(([0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(nodes))))
    number = int(np.ceil(min(count[-1], MESH.steps * end)))
    steps = np.diff(np.interp(np.linspace(0.0, count[-1], number + 1), count, nodes))
    return np.concatenate((steps, steps[::-1])) if mirrored else steps


@dataclass(frozen=True)
class Newton:
    """Limits of Newton's method, and tolerances of an orbit.

    Attributes
    ----------
    closed : float
        Largest residual of an orbit, and error due to its steps, relative to the size of the orbit.
    iterations : int
        Largest number of Newton steps.
    useful : float
        Factor by which a step with derivatives of another point must reduce the residual.
    local : float
        Relative distance within which derivatives count as constant.
    nudge : float
        Change of a parameter, relative to its scale, for derivatives by finite differences.
    rounds : int
        Largest number of new meshes around openings, and of halvings of the steps.
    """

    closed: float = 1e-12
    iterations: int = 25
    useful: float = 0.1
    local: float = 1e-6
    nudge: float = 1e-6
    rounds: int = 4


NEWTON = Newton()
FILTERS = Lock()  # This lock protects the warning filters, which all threads share.


class OrbitPoint(NamedTuple):
    """Unknowns of an orbit: a canonical state (2, M), a period in s, and a parameter."""

    state: Array
    period: float
    value: float = 0.0


@dataclass(frozen=True, eq=False)
class Equations:
    """The equations of a periodic orbit in unknowns of order 1.

    Parameters
    ----------
    flow_at : function
        Function that returns the flow for a value of the parameter.
    reversible : bool
        Whether all grains rest at t = 0, and therefore also half a period later.
    unit : float
        Unit of the state.
    scale : float
        Unit of the parameter; 0 if there is no parameter.
    time : float
        Unit of the period, s.
    """

    flow_at: Callable[[float], Flow]
    reversible: bool
    unit: float
    scale: float = 0.0
    time: float = 1.0

    def pack(self, point: OrbitPoint) -> Array:
        """Return the unknowns (U,): state, log(period) and parameter."""
        state = point.state[0] if self.reversible else point.state.ravel()
        parameter = [point.value / self.scale] if self.scale else []
        return np.concatenate((state / self.unit, [np.log(point.period / self.time)], parameter))

    def unpack(self, unknown: Array) -> OrbitPoint:
        """Return the orbit point of these unknowns."""
        end = self.period_at(unknown)
        state = unknown[:end] * self.unit
        state = np.stack((state, np.zeros(end))) if self.reversible else state.reshape(2, -1)
        value = float(unknown[-1] * self.scale) if self.scale else 0.0
        return OrbitPoint(state, float(np.exp(unknown[end]) * self.time), value)

    def period_at(self, unknown: Array) -> int:
        """Return the index of log(period) in the unknowns, after the state."""
        return unknown.size - 1 - bool(self.scale)

    def closure(self, point: OrbitPoint, mesh: Array) -> Array:
        """Return the change of state over a period, or the momenta after half a period, (R,)."""
        return self._closure(self.flow_at(point.value), point, mesh)[0]

    def linearise(self, point: OrbitPoint, mesh: Array) -> tuple[Array, Array]:
        """Return the closure (R,) and its derivatives (R, U) by the unknowns."""
        flow = self.flow_at(point.value)
        # Displacements at t = 0 are unknown, and momenta unless all grains start from rest.
        size = flow.size if self.reversible else 2 * flow.size
        columns = np.zeros((2 * flow.size, size + 1))
        columns[:size, :size] = np.eye(size)
        residual, end = self._closure(flow, point, mesh, columns.reshape(2, flow.size, -1), 1)
        if self.reversible:
            slopes = np.hstack((end[size:, :size], end[size:, size:] / self.unit))
        else:
            # The closure of a whole period has the tangent map minus the identity as derivative.
            slopes = np.hstack((end[:, :size] - np.eye(size), end[:, size:] / self.unit))
            if flow.drive is None:
                # All states of an orbit close; the phase is fixed by a plane across the motion of
                # the last guess.
                across = flow.direction(point.state).ravel()
                slopes = np.vstack((slopes, np.append(across / np.linalg.norm(across), 0.0)))
                residual = np.append(residual, 0.0)
        if self.scale:
            by_value = np.zeros((residual.size, 1))
            change = self.by_value(point, lambda flow: self._closure(flow, point, mesh)[0])
            by_value[: change.size, 0] = change
            slopes = np.hstack((slopes, by_value))
        return residual, slopes

    def by_value(self, point: OrbitPoint, quantity: Callable[[Flow], Any]) -> Any:
        """Return the scaled derivative of a quantity by the parameter, by finite differences."""
        nudge = NEWTON.nudge
        for up, down in ((nudge, -nudge), (nudge, 0.0), (0.0, -nudge)):
            try:
                above = quantity(self.flow_at(point.value + up * self.scale))
                below = quantity(self.flow_at(point.value + down * self.scale))
            except InputError:
                # At the end of the allowed range the difference is one-sided.
                continue
            return (above - below) / (up - down)
        raise RunFailed(f"the parameter cannot differ from {point.value:g}")

    def _closure(
        self,
        flow: Flow,
        point: OrbitPoint,
        mesh: Array,
        columns: Array | None = None,
        stretch: int = 0,
    ) -> tuple[Array, Array]:
        passage = flow.run(point.state, point.period, self._steps(mesh), columns, stretch)
        end = passage.end
        residual = end[1] if self.reversible else (end - point.state).ravel()
        return residual / self.unit, passage.deviation.reshape(2 * flow.size, -1)

    def mesh(
        self, point: OrbitPoint, reach: float, before: Array | None = None
    ) -> tuple[Array, bool]:
        """Return steps for a point, shorter around openings, and whether contacts open."""
        flow = self.flow_at(point.value)
        if before is None:
            # The stiffest state of the motion, which determines the steps, is known only after a
            # run.
            before = uniform(flow, point.period, flow.physical(point.state)[0])
            motion = self._run(flow, point, before).displacement
            before = uniform(flow, point.period, motion)
        passage = self._run(flow, point, before)
        times = openings(flow, passage, point.period, self._steps(before))
        mesh = graded(flow, point.period, passage.displacement, times, reach)
        return mesh, bool(times.size)

    def _run(self, flow: Flow, point: OrbitPoint, mesh: Array) -> Passage:
        """Return the motion over a period, or over half of a time-reversible period."""
        return flow.run(point.state, point.period, self._steps(mesh))

    def _steps(self, mesh: Array) -> Array:
        return mesh[: mesh.size // 2] if self.reversible else mesh


class Constraint(NamedTuple):
    """A further equation: returns a residual and derivatives (U,) for unknowns and point."""

    of: Callable[[Array, OrbitPoint], tuple[float, Array]]


def plane(through: Array, normal: Array) -> Constraint:
    """Return the constraint that restricts the unknowns to a plane through a point, (U,) both."""
    return Constraint(lambda unknown, _: (float(normal @ (unknown - through)), normal))


class Solution(NamedTuple):
    """A solution of Newton's method: a periodic orbit, its steps and its derivatives.

    Attributes
    ----------
    point : OrbitPoint
        Unknowns of the orbit.
    mesh : (K,) array
        Steps, as fractions of the period.
    slopes : (R, U) array
        Derivatives of all equations with respect to the unknowns.
    residual : float
        Largest residual relative to the size of the orbit.
    iterations, relaid : int
        Number of steps of Newton's method, and the part of them after the first new mesh.
    """

    point: OrbitPoint
    mesh: Array
    slopes: Array
    residual: float
    iterations: int
    relaid: int = 0


def fixed(equations: Equations, name: str, value: float) -> Constraint:
    """Return the constraint that fixes "period", "frequency", "energy" or "value" to a number.

    "frequency" is the frequency of the drive.
    """

    def period(unknown: Array, point: OrbitPoint) -> tuple[float, Array]:
        row = np.zeros(unknown.size)
        row[equations.period_at(unknown)] = 1.0
        return float(np.log(point.period / value)), row

    def frequency(unknown: Array, point: OrbitPoint) -> tuple[float, Array]:
        row = np.zeros(unknown.size)
        row[equations.period_at(unknown)] = -1.0
        present = equations.flow_at(point.value).cycles / point.period
        return float(np.log(present / value)), row

    def parameter(unknown: Array, point: OrbitPoint) -> tuple[float, Array]:
        row = np.zeros(unknown.size)
        row[-1] = 1.0
        return (point.value - value) / equations.scale, row

    def energy(unknown: Array, point: OrbitPoint) -> tuple[float, Array]:
        present, slope = equations.flow_at(point.value).energy(point.state)
        row = np.zeros(unknown.size)
        inner = slope[0] if equations.reversible else slope.ravel()
        row[: inner.size] = inner * equations.unit / present
        if equations.scale:
            change = equations.by_value(point, lambda flow: flow.energy(point.state)[0])
            row[-1] = change / present
        return float(np.log(present / value)), row

    kinds = {"period": period, "frequency": frequency, "energy": energy, "value": parameter}
    return Constraint(kinds[name])


class OrbitSystem(NamedTuple):
    """All equations of an orbit with given steps: closure and constraints."""

    equations: Equations
    constraints: Sequence[Constraint]
    mesh: Array

    def evaluate(self, unknown: Array, slopes: Array | None = None) -> tuple[Array, Array]:
        """Return all residuals (R,) and their derivatives (R, U).

        Derivatives of the closure cost as much as M motions, so that given `slopes` are reused.
        """
        point = self.equations.unpack(unknown)
        pairs = [constraint.of(unknown, point) for constraint in self.constraints]
        if slopes is None:
            residual, slopes = self.equations.linearise(point, self.mesh)
        else:
            residual = self.equations.closure(point, self.mesh)
            slopes = slopes[: len(slopes) - len(pairs)]
        # The phase condition has the residual 0.
        phase = np.zeros(len(slopes) - residual.size)
        residual = np.concatenate((residual, phase, [value for value, _ in pairs]))
        return residual, np.vstack((slopes, *(row[None] for _, row in pairs)))

    def size(self, residual: Array, unknown: Array) -> float:
        """Return the largest residual relative to the size of the orbit."""
        state = unknown[: self.equations.period_at(unknown)]
        return float(np.abs(residual).max() / np.abs(state).max())


class Descent(NamedTuple):
    """Newton steps with stored derivatives.

    Attributes
    ----------
    unknown : (U,) array
        Unknowns with the smallest residual, including the start.
    residual : float
        Smallest residual, relative to the size of the orbit.
    slopes : (R, U) array
        Derivatives of all equations with respect to the unknowns.
    first : (U,) array or None
        Unknowns after the first step; None if no step was possible.
    steps : int
        Number of steps.
    """

    unknown: Array
    residual: float
    slopes: Array
    first: Array | None
    steps: int


def solve(
    equations: Equations,
    guess: OrbitPoint,
    constraints: Sequence[Constraint],
    reach: float = MESH.reach,
    near: Solution | None = None,
    exact: bool = False,
) -> Solution | None:
    """Return the orbit near a guess; None if Newton's method does not converge.

    The mesh is renewed around the openings of contacts until the orbit no longer changes. If
    `exact` is true, the returned derivatives belong to the final mesh; otherwise they may be off by
    the error of the steps. A nearby solution `near` makes the search faster, because its
    derivatives can be reused and its steps show where contacts open.
    """
    mesh, _ = equations.mesh(guess, reach, near and near.mesh)
    unknown = equations.pack(guess)
    slopes = None if near is None else near.slopes
    origin = None
    iterations = 0
    relaid = 0
    for number in range(NEWTON.rounds):
        system = OrbitSystem(equations, constraints, mesh)
        orbit = _newton(system, unknown, slopes, origin, near is not None)
        if orbit is None:
            return None
        solution = orbit
        unknown = origin = equations.pack(solution.point)
        slopes = solution.slopes
        iterations += solution.iterations
        relaid += solution.iterations if number else 0
        if solution.iterations <= 1:
            break
        mesh, opens = equations.mesh(solution.point, reach, mesh)
        if not opens:
            break
    # Derivatives of the previous round's steps may be reused.
    if exact and number:
        solution = solution._replace(slopes=system.evaluate(unknown)[1])
    return solution._replace(iterations=iterations, relaid=relaid)


def _newton(
    system: OrbitSystem, unknown: Array, slopes: Array | None, origin: Array | None, near: bool
) -> Solution | None:
    """Return the orbit with given steps; derivatives are recomputed when old ones fail.

    Given `slopes` are exact at `origin` if it is given. If an orbit is known to be `near`, the
    search stops when new derivatives do not halve the residual.
    """
    closed = NEWTON.closed
    steps = 0
    before = np.inf
    # Chord steps with the derivatives of a nearby orbit are used while they converge.
    if slopes is not None:
        descent = _descend(system, unknown, slopes)
        unknown = descent.unknown
        steps = descent.steps
        exact = origin is not None and _distance(unknown, origin) < NEWTON.local
        if exact and descent.residual < closed:
            return _solution(system, descent, steps)
    # Full Newton steps compute new derivatives whenever the old ones fail.
    while steps < NEWTON.iterations:
        residual, slopes = system.evaluate(unknown)
        size = system.size(residual, unknown)
        if near and size > max(before / 2, closed):
            return None
        before = size
        descent = _descend(system, unknown, slopes, residual)
        steps += descent.steps
        if descent.first is None:
            return _solution(system, descent, steps) if descent.residual < closed else None
        # Amplified rounding may keep the residual above the tolerance while steps vanish.
        still = _distance(descent.first, unknown) < 4 * EPSILON
        exact = _distance(descent.unknown, unknown) < NEWTON.local
        if exact and (still or descent.residual < closed):
            return _solution(system, descent, steps)
        # Far from an orbit a step may increase the residual before the next steps reduce it.
        unknown = descent.first if descent.unknown is unknown else descent.unknown
    return None


def _descend(
    system: OrbitSystem, unknown: Array, slopes: Array, residual: Array | None = None
) -> Descent:
    """Take Newton steps with fixed derivatives while each reduces the residual tenfold."""
    period_at = system.equations.period_at(unknown)
    best = unknown
    first = None
    smallest = np.inf
    last = np.inf
    steps = 0
    while True:
        if residual is None:
            residual, slopes = system.evaluate(unknown, slopes)
        size = system.size(residual, unknown)
        if size < smallest:
            best = unknown
            smallest = size
        if not np.isfinite(size) or size >= NEWTON.useful * last:
            break
        change = solve_step(slopes, residual)
        # A change of the period by more than a factor of e shows that no orbit is near.
        if not np.isfinite(change).all() or abs(change[period_at]) > 1:
            break
        unknown = unknown - change
        if first is None:
            first = unknown
        steps += 1
        last = size
        residual = None
    return Descent(best, smallest, slopes, first, steps)


def _distance(unknown: Array, other: Array) -> float:
    """Return the largest difference of two sets of unknowns relative to the largest unknown."""
    return float(np.abs(unknown - other).max() / np.abs(unknown).max())


def _solution(system: OrbitSystem, descent: Descent, steps: int) -> Solution:
    point = system.equations.unpack(descent.unknown)
    return Solution(point, system.mesh, descent.slopes, descent.residual, steps)


def solve_step(slopes: Array, residual: Array) -> Array:
    """Solve the linear equations of a Newton step; use least squares if they are singular."""
    if slopes.shape[0] == slopes.shape[1]:
        with (
            FILTERS,
            suppress(LinAlgError, LinAlgWarning),
            catch_warnings(action="error", category=LinAlgWarning),
        ):
            return np.asarray(solve_square(slopes, residual))
    return np.asarray(lstsq(slopes, residual, cond=1e-13, lapack_driver="gelsy")[0])


def estimate_error(
    equations: Equations, solution: Solution, constraints: Sequence[Constraint]
) -> float:
    """Return the relative error of an orbit and its period caused by the steps.

    The error is estimated by one Newton step for a mesh with steps of half the length.
    """
    unknown = equations.pack(solution.point)
    residual = equations.closure(solution.point, np.repeat(solution.mesh, 2) / 2)
    rows = len(solution.slopes) - residual.size
    change = solve_step(solution.slopes, np.append(residual, np.zeros(rows)))
    end = equations.period_at(unknown)
    size = np.abs(unknown[:end]).max()
    return SAFETY * float(max(np.abs(change[:end]).max() / size, *np.abs(change[end:])))


def solve_accurately(
    equations: Equations, guess: OrbitPoint, constraints: Sequence[Constraint], name: str
) -> tuple[Solution, float]:
    """Return an orbit and its step error, which is below 1e-12 unless rounding prevents it.

    Raises
    ------
    RunFailed
        If Newton's method finds no orbit.
    """
    start = guess
    iterations = 0

    def attempt(halvings: int) -> HalvedAnswer[Solution | None]:
        nonlocal start, iterations
        solution = solve(equations, start, constraints, MESH.reach / 2**halvings)
        if solution is None and not halvings:
            raise RunFailed(
                f"no periodic orbit found near {name}: give a guess or a period closer to an orbit"
            )
        if solution is None:
            return HalvedAnswer(solution, np.inf)
        start = solution.point
        iterations += solution.iterations
        return HalvedAnswer(
            solution, estimate_error(equations, solution, constraints) / NEWTON.closed
        )

    solution, excess = halve(attempt, NEWTON.rounds)
    assert solution is not None
    return solution._replace(iterations=iterations), excess * NEWTON.closed
