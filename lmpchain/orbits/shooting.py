"""Newton's method for periodic orbits, with the exact tangent map of the steps taken."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple
from warnings import catch_warnings

import numpy as np
from scipy.linalg import LinAlgError, LinAlgWarning, lstsq
from scipy.linalg import solve as solve_linear

from ..errors import InputError, RunFailed
from ..util.arrays import EPSILON, Array
from . import mesh as meshes
from .flow import Flow, Passage

CLOSED = 1e-12  # residual over the size of the orbit
ITERATIONS = 25
STALLS = 0  # steps with exact derivatives that may leave half of the residual, near an orbit that is known
USEFUL = 0.1  # factor on the residual by which old derivatives must still bring it down
SAME = 1e-6  # relative distance over which derivatives are taken as the same
TUNED = 4  # times that steps are laid anew around openings
NUDGE = 1e-6  # of a parameter, for the derivative by it
SHORTER = 0.6  # factor on the steps until their error is below CLOSED
ROUNDS = 3
ROUNDED = 4  # residual of half the steps over that of the steps, up to which both are round-off
SAFETY = 2.0  # on the error that half the steps show; analysis/calibration/halved_steps.py


class Point(NamedTuple):
    """What is solved for: a state (2, M) in canonical variables, a period, s, and a parameter."""

    state: Array
    period: float
    value: float = 0.0


@dataclass(frozen=True, eq=False)
class Equations:
    """The equations of a periodic orbit, in unknowns that are all of order 1.

    Parameters
    ----------
    flow_at : function
        Of the parameter.
    reversible : bool
        Whether all grains rest at t = 0, and so half a period later.
    unit : float
        Of the state.
    scale : float
        Of the parameter; 0 if there is none.
    time : float
        Unit of the period, s.
    """

    flow_at: Callable[[float], Flow]
    reversible: bool
    unit: float
    scale: float = 0.0
    time: float = 1.0

    def pack(self, point: Point) -> Array:
        """Return the unknowns (U,): state, log(period) and parameter."""
        state = point.state[0] if self.reversible else point.state.ravel()
        last = [point.value / self.scale] if self.scale else []
        return np.concatenate((state / self.unit, [np.log(point.period / self.time)], last))

    def unpack(self, unknown: Array) -> Point:
        """Return the point of these unknowns."""
        end = self.period_at(unknown)
        state = unknown[:end] * self.unit
        state = np.stack((state, np.zeros(end))) if self.reversible else state.reshape(2, -1)
        return Point(
            state,
            float(np.exp(unknown[end]) * self.time),
            float(unknown[-1] * self.scale) if self.scale else 0.0,
        )

    def period_at(self, unknown: Array) -> int:
        """Return the place of log(period) among the unknowns, behind those of the state."""
        return unknown.size - 1 - bool(self.scale)

    def closure(self, point: Point, mesh: Array) -> Array:
        """Return what keeps the orbit from closing, (R,)."""
        return self._closure(self.flow_at(point.value), point, mesh)[0]

    def linearised(self, point: Point, mesh: Array) -> tuple[Array, Array]:
        """Return closure (R,) and its derivatives (R, U)."""
        flow = self.flow_at(point.value)
        size = (
            flow.size if self.reversible else 2 * flow.size
        )  # of the displacements alone, or with the momenta
        columns = np.zeros((2 * flow.size, size + 1))
        columns[:size, :size] = np.eye(size)
        residual, end = self._closure(flow, point, mesh, columns.reshape(2, flow.size, -1), 1)
        if self.reversible:
            slopes = np.hstack((end[size:, :size], end[size:, size:] / self.unit))
        else:
            slopes = np.hstack((end[:, :size] - np.eye(size), end[:, size:] / self.unit))
            if (
                flow.drive is None
            ):  # of all states of an orbit, the one across the motion from the last guess
                across = flow.direction(point.state).ravel()
                slopes = np.vstack((slopes, np.append(across / np.linalg.norm(across), 0.0)))
                residual = np.append(residual, 0.0)
        if self.scale:
            by_value = np.zeros((residual.size, 1))
            change = self.by_value(point, lambda flow: self._closure(flow, point, mesh)[0])
            by_value[: change.size, 0] = change
            slopes = np.hstack((slopes, by_value))
        return residual, slopes

    def by_value(self, point: Point, quantity: Callable[[Flow], Any]) -> Any:
        """Return the derivative of a quantity by the parameter, over its scale, by differences."""
        for up, down in ((NUDGE, -NUDGE), (NUDGE, 0.0), (0.0, -NUDGE)):
            try:
                above, below = (
                    quantity(self.flow_at(point.value + step * self.scale)) for step in (up, down)
                )
            except (
                InputError
            ):  # of a chain that there is not, at the end of what the parameter may be
                continue
            return (above - below) / (up - down)
        raise RunFailed(f"the parameter can be nothing but {point.value:g}")

    def _closure(
        self, flow: Flow, point: Point, mesh: Array, columns: Array | None = None, stretch: int = 0
    ) -> tuple[Array, Array]:
        passage = flow.run(point.state, point.period, self._steps(mesh), columns, stretch)
        end = flow.canonical(passage.displacement[-1], passage.velocity[-1])
        residual = end[1] if self.reversible else (end - point.state).ravel()
        return residual / self.unit, passage.deviation.reshape(2 * flow.size, -1)

    def mesh(self, point: Point, reach: float, before: Array | None = None) -> tuple[Array, bool]:
        """Return steps for a point, and whether they were laid around openings."""
        flow = self.flow_at(point.value)
        if before is None:
            before = meshes.uniform(flow, point.period, flow.physical(point.state)[0])
            before = meshes.uniform(
                flow, point.period, self._passed(flow, point, before).displacement
            )
        passage = self._passed(flow, point, before)
        times = meshes.openings(flow, passage, point.period, self._steps(before))
        return meshes.graded(flow, point.period, passage.displacement, times, reach), bool(
            times.size
        )

    def _passed(self, flow: Flow, point: Point, mesh: Array) -> Passage:
        """Return the motion over a period, or over half of one that is symmetric in time."""
        return flow.run(point.state, point.period, self._steps(mesh))

    def _steps(self, mesh: Array) -> Array:
        return mesh[: mesh.size // 2] if self.reversible else mesh


class Constraint(NamedTuple):
    """A further equation: from the unknowns and their point, a residual and its derivatives (U,)."""

    of: Callable[[Array, Point], tuple[float, Array]]


class Solution(NamedTuple):
    """A solved point, its steps, the derivatives of all equations, and what round-off leaves of them.

    And Newton's iterations, of them those after steps were laid anew.
    """

    point: Point
    mesh: Array
    slopes: Array
    residual: float
    iterations: int
    relaid: int = 0


def fixed(equations: Equations, what: str, value: float) -> Constraint:
    """Return the constraint that "period", "energy" or "value" is this number."""

    def period(unknown: Array, point: Point) -> tuple[float, Array]:
        row = np.zeros(unknown.size)
        row[equations.period_at(unknown)] = 1.0
        return float(np.log(point.period / value)), row

    def parameter(unknown: Array, point: Point) -> tuple[float, Array]:
        row = np.zeros(unknown.size)
        row[-1] = 1.0
        return (point.value - value) / equations.scale, row

    def energy(unknown: Array, point: Point) -> tuple[float, Array]:
        here, slope = equations.flow_at(point.value).energy(point.state)
        row = np.zeros(unknown.size)
        inner = slope[0] if equations.reversible else slope.ravel()
        row[: inner.size] = inner * equations.unit / here
        if equations.scale:
            row[-1] = equations.by_value(point, lambda flow: flow.energy(point.state)[0]) / here
        return float(np.log(here / value)), row

    return Constraint({"period": period, "energy": energy, "value": parameter}[what])


def solve(
    equations: Equations,
    guess: Point,
    constraints: Sequence[Constraint],
    reach: float = meshes.REACH,
    near: Solution | None = None,
    exact: bool = False,
) -> Solution | None:
    """Return the orbit near a guess, or None where Newton's method does not find one.

    Steps are laid anew around the openings of what was found until these stay where they are; with `exact` derivatives
    these are taken at the last ones, else they may be off by the error of the steps. A solution nearby saves work: its
    derivatives may serve, and its steps show where contacts open.
    """
    mesh, _ = equations.mesh(guess, reach, near and near.mesh)
    slopes, taken, stalls = near and near.slopes, None, STALLS if near else ITERATIONS
    found, point, iterations, relaid = None, guess, 0, 0
    for again in range(TUNED):
        found = _newton(equations, point, constraints, mesh, slopes, taken, stalls)
        if found is None:
            return None
        point, slopes, iterations = found.point, found.slopes, iterations + found.iterations
        taken, relaid = equations.pack(point), relaid + (found.iterations if again else 0)
        if found.iterations <= 1:
            break
        tuned, open_ = equations.mesh(point, reach, mesh)
        if not open_:
            break
        mesh = tuned
    if exact and found and again:
        rows = [constraint.of(equations.pack(point), point)[1][None] for constraint in constraints]
        found = found._replace(
            slopes=np.vstack((equations.linearised(point, found.mesh)[1], *rows))
        )
    return found and found._replace(iterations=iterations, relaid=relaid)


def _newton(
    equations: Equations,
    guess: Point,
    constraints: Sequence[Constraint],
    mesh: Array,
    slopes: Array | None,
    taken: Array | None,
    stalls: int,
) -> Solution | None:
    """Return the solution at given steps; derivatives are taken anew only where old ones no longer serve.

    Old ones cost nothing, new ones as much as M motions, so those of an orbit nearby, `slopes`, are tried first; they
    are exact where they were `taken`. After so many `stalls` of exact ones it is given up.
    """
    unknown, last = equations.pack(guess), np.inf
    best, least = unknown, np.inf  # where the residual was the least
    size, period_at, steps = np.abs(unknown).max(), equations.period_at(unknown), 0
    before, exactly = (
        unknown,
        np.inf,
    )  # where the last step began, and the last residual with exact slopes
    taken = np.full(unknown.size, np.inf) if taken is None else taken
    closed, settled = (
        False,
        None,
    )  # whether old derivatives led to round-off, and that orbit with exact ones
    while steps < ITERATIONS:
        point = equations.unpack(unknown)
        more = [constraint.of(unknown, point) for constraint in constraints]
        rows = [row[None] for _, row in more]
        if fresh := slopes is None:
            residual, slopes = equations.linearised(point, mesh)
            slopes, taken = np.vstack((slopes, *rows)), unknown
        else:
            residual = equations.closure(point, mesh)
            slopes = np.vstack((slopes[: len(slopes) - len(rows)], *rows))
        residual = np.concatenate(
            (residual, np.zeros(len(slopes) - residual.size - len(more)), [r for r, _ in more])
        )
        here = float(np.abs(residual).max() / np.abs(unknown[:period_at]).max())
        exact = np.abs(unknown - taken).max() < SAME * np.abs(unknown).max()
        lost = not np.isfinite(here) or here > 1e3 * max(last, 1.0)
        if here < least:
            best, least = unknown, here
        done = here > last / 4 and least < CLOSED  # round-off is what is left
        if exact and done:
            return Solution(equations.unpack(best), mesh, slopes, least, steps)
        if (
            settled and not here <= settled.residual
        ):  # where derivatives are all but singular a step more leads away
            return settled
        if fresh and closed:
            settled = Solution(point, mesh, slopes, here, steps)
        if not fresh and (lost or done or here > USEFUL * last):
            worse = (lost or here > last) and before is not taken  # old derivatives led astray
            slopes, unknown, last, closed = (
                None,
                best if done else before if worse else unknown,
                np.inf,
                done,
            )
            continue
        if fresh:
            stalls, exactly = stalls - (here > max(exactly / 2, CLOSED)), here
        if lost or stalls < 0:
            return None
        last = here
        change = solved(slopes, residual)
        wild = np.abs(change[period_at]) > 1 or not np.isfinite(change).all()
        if not wild:
            before, unknown, steps = unknown, unknown - change, steps + 1
            wild = bool(np.abs(unknown).max() > 1e3 * size)
        if wild and fresh:
            break
        if wild:
            slopes = None
        elif fresh and np.abs(change).max() < 4 * EPSILON * np.abs(unknown).max():
            return Solution(point, mesh, slopes, least, steps)
    return settled


def solved(slopes: Array, residual: Array) -> Array:
    """Solve the linear equations of a Newton step, by least squares if they are singular."""
    if slopes.shape[0] == slopes.shape[1]:
        with (
            suppress(LinAlgError, LinAlgWarning),
            catch_warnings(action="error", category=LinAlgWarning),
        ):
            return np.asarray(solve_linear(slopes, residual))
    return np.asarray(lstsq(slopes, residual, cond=1e-13, lapack_driver="gelsy")[0])


def discretisation(
    equations: Equations, solution: Solution, constraints: Sequence[Constraint]
) -> tuple[float, bool]:
    """Return how far, in relative terms, the orbit and its period move if all steps are halved.

    And whether that is no more than round-off moves them.
    """
    point, unknown = solution.point, equations.pack(solution.point)
    half = np.repeat(solution.mesh, 2) / 2
    residual = equations.closure(point, half)
    rows = len(solution.slopes) - residual.size
    change = solved(solution.slopes, np.append(residual, np.zeros(rows)))
    end = equations.period_at(unknown)
    size = np.abs(unknown[:end]).max()
    error = SAFETY * float(max(np.abs(change[:end]).max() / size, *np.abs(change[end:])))
    return error, float(np.abs(residual).max() / size) < ROUNDED * solution.residual


def accurate(
    equations: Equations, guess: Point, constraints: Sequence[Constraint], what: str
) -> tuple[Solution, float]:
    """Return an orbit whose steps err by less than `CLOSED`, if round-off lets them, and that error.

    Raises
    ------
    RunFailed
        If Newton's method finds no orbit.
    """
    reach, best, error, iterations = meshes.REACH, None, np.inf, 0
    for _ in range(ROUNDS):
        solution = solve(equations, guess, constraints, reach)
        if solution is None:
            break
        iterations += solution.iterations
        left, rounded = discretisation(equations, solution, constraints)
        if best is None or left < error:
            best, error = solution, left
        if rounded or error < CLOSED / 4:
            break
        guess, reach = solution.point, reach * SHORTER
    if best is None:
        raise RunFailed(
            f"no periodic orbit found near {what}: give a guess or a period closer to one"
        )
    return best._replace(iterations=iterations), error
