"""Families of periodic orbits by pseudo-arclength continuation, with located bifurcations.

A step follows the family instead of the parameter, so that it passes folds; see H. B. Keller, in
Applications of Bifurcation Theory, ed. P. H. Rabinowitz (1977).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from functools import lru_cache

import numpy as np
from scipy.linalg import svd

from ..chain.chain import Chain
from ..chain.damping import Damping
from ..engines.cost_model import PATIENCE_S, announce, is_long
from ..errors import InputError, RunFailed, shown
from ..scene.excitation import Drive, Force
from ..util.arrays import Array, check_flags
from ..util.compilation import clock
from ..util.progress import ProgressBar
from . import floquet
from .damped_flow import flow_of
from .events import EVENTS, Aspect, Member, aspects, locate, returns
from .family import Event, Family
from .floquet import in_one_thread
from .flow import Flow
from .orbit import Orbit, orbit_of
from .shooting import (
    Constraint,
    Equations,
    OrbitPoint,
    Solution,
    estimate_error,
    fixed,
    plane,
    solve,
    solve_step,
)

ELEMENT = re.compile(r"(\w+)\[(\d+)\]")


@dataclass(frozen=True)
class ContinuationSteps:
    """Lengths of steps along a family, and limits at which the continuation stops.

    Attributes
    ----------
    first, smallest : float
        First and smallest step length relative to the size of the orbit.
    longest : float
        Largest step length relative to the size of the orbit; a step of 1 could end at rest.
    straight : float
        Smallest cosine of the angle between two directions for which the next step may be longer.
    bent : float
        Value of this cosine below which a step is too long.
    easy : int
        Largest number of Newton iterations for which the next step may be longer.
    still : float
        Distance, in sizes of the orbit, that a family must cover in `patience` tries.
    patience : int
        Largest number of tries for this distance.
    crowded : float
        Largest cost of locating events, in unknowns times steps (about 15 s). Beyond it the family
        ends, because events crowd in resonances.
    """

    first: float = 0.2
    smallest: float = 1e-7
    longest: float = 0.4
    straight: float = 0.98
    bent: float = 0.9
    easy: int = 10
    still: float = 0.05
    patience: int = 60
    crowded: float = 5e6


STEPS = ContinuationSteps()


class Ending(Enum):
    """Why a family ended before the requested value of its parameter."""

    POINTS = "the limit of {orbits} orbits is reached at {position}"
    STILL = "its steps become too short at {position}"
    LOST = "it cannot be followed beyond {position}"
    MISSED = "no orbit of the family is found at {until:g}"
    CROWDED = "it has too many events, {events} up to {position}: use events=False"
    RETURNED = "it returns to its earlier orbits at {position}"


@dataclass(frozen=True, eq=False)
class SolutionBranch:
    """The family of periodic orbits that contains a given orbit.

    Attributes
    ----------
    equations : Equations
        Equations of its orbits.
    held : tuple of Constraint
        Constraint on the period or the energy, if another parameter changes.
    parameter : "energy", "period", "frequency" of the drive, or "value"
        Quantity that changes along the family; "value" stands for any property of the system.
    exact : bool
        Whether the derivatives are accurate enough to locate events.
    """

    equations: Equations
    held: tuple[Constraint, ...]
    parameter: str
    exact: bool = False

    def solve(
        self, guess: OrbitPoint, constraint: Constraint, near: Member | None = None
    ) -> Solution | None:
        """Return the family's orbit near a guess, selected by a constraint.

        A nearby member `near` makes the search faster.
        """
        constraints = [*self.held, constraint]
        neighbour = near and near.solution
        # Colliding pairs at 1 or -1 need more digits than multipliers of damped chains.
        exact = self.exact and self.equations.flow_at(guess.value).symplectic
        return solve(self.equations, guess, constraints, near=neighbour, exact=exact)

    def member(
        self, solution: Solution, constraint: Constraint, before: Array | None = None
    ) -> Member:
        """Return a solved orbit with the family's direction, oriented like the previous one."""
        point = solution.point
        unknown = self.equations.pack(point)
        if len(solution.slopes) == unknown.size:
            # Along the family only the last equation, the constraint, changes.
            direction = solve_step(solution.slopes, np.append(np.zeros(unknown.size - 1), 1.0))
            direction /= np.linalg.norm(direction)
        else:
            direction = svd(solution.slopes[:-1])[2][-1]
        if before is not None and direction @ before < 0:
            direction = -direction
        error = estimate_error(self.equations, solution, [*self.held, constraint])
        orbit = orbit_of(self.equations, solution, error)

        def rate(name: str) -> float:
            slope = fixed(self.equations, name, 1.0).of(unknown, point)[1]
            return float(slope @ direction)

        turning = np.nan
        if orbit.drive:
            turning = rate(self.parameter)
        elif self.parameter != "value":
            turning = rate("energy")
        multipliers = None
        if self.exact and not orbit.flow.symplectic:
            # The derivative of the closure is the tangent map minus the identity.
            size = point.state.size
            tangent = solution.slopes[:size, :size] + np.eye(size)
            multipliers = floquet.all_multipliers(tangent)
        speed = rate(self.parameter)
        return Member(orbit, unknown, direction, speed, turning, solution, multipliers)

    def along(
        self, member: Member, length: float, guess: Array | None = None, near: Member | None = None
    ) -> Member | None:
        """Return the member at this distance along the family; None if none is found.

        A guess, and a member `near` the guess, make the search faster.
        """
        # The orbit is in the plane across the family at this distance.
        ahead = member.unknown + length * member.direction
        across = plane(ahead, member.direction)
        start = self.equations.unpack(ahead if guess is None else guess)
        try:
            solution = self.solve(start, across, near or member)
        except InputError:
            # The parameter is outside the range that the chain allows.
            return None
        if solution is None:
            return None
        return self.member(solution, across, member.direction)

    def miss(self, member: Member, target: Constraint) -> float:
        """Return the signed difference between a member and a target."""
        return target.of(member.unknown, self.equations.unpack(member.unknown))[0]

    def meet(self, start: Member, end: Member, target: Constraint) -> Member | None:
        """Return the member between two members that meets a target, halving until one is found."""
        smallest = STEPS.smallest * self.size(start)
        while True:
            step = end.unknown - start.unknown
            length = np.linalg.norm(step)
            before = self.miss(start, target)
            after = self.miss(end, target)
            # The guess is the intersection of the line through both orbits with the target.
            guess = start.unknown + (before / (before - after) if after else 1.0) * step
            solution = self.solve(self.equations.unpack(guess), target, end)
            if solution and np.linalg.norm(self.equations.pack(solution.point) - guess) < length:
                return self.member(solution, target, start.direction)
            middle = self.along(start, float(start.direction @ step) / 2)
            if middle is None or length < smallest:
                return None
            if self.miss(middle, target) * before <= 0:
                end = middle
            else:
                start = middle

    def size(self, member: Member) -> float:
        """Return the size of an orbit's unknowns."""
        state = member.unknown[: self.equations.period_at(member.unknown)]
        return float(np.linalg.norm(state))

    def value(self, point: OrbitPoint) -> float:
        """Return the parameter value of an orbit."""
        if self.parameter == "energy":
            return self.equations.flow_at(point.value).energy(point.state)[0]
        if self.parameter == "frequency":
            return self.equations.flow_at(point.value).cycles / point.period
        return point.period if self.parameter == "period" else point.value

    def value_of(self, member: Member) -> float:
        """Return the parameter value of a member."""
        return self.value(self.equations.unpack(member.unknown))

    def position(self, member: Member) -> str:
        """Return the parameter and the period of a member as text."""
        name = "the parameter" if self.parameter == "value" else self.parameter
        return f"{name} {self.value_of(member):.6g} (period {member.orbit.period:.6g} s)"


class _March:
    """A family during its continuation to a value of its parameter.

    Parameters
    ----------
    curve : SolutionBranch
        Equations of the family.
    start : Member
        First orbit.
    target : Constraint
        Constraint that holds at the requested value.
    points : int
        Largest number of orbits.
    events : bool
        Whether events are located.
    """

    def __init__(
        self, curve: SolutionBranch, start: Member, target: Constraint, points: int, events: bool
    ) -> None:
        self.curve = curve
        self.target = target
        self.points = points
        self.events: list[Event] | None = [] if events else None
        self.miss = curve.miss(start, target)
        if start.rate * self.miss > 0:
            start = start._replace(
                direction=-start.direction, rate=-start.rate, turning=-start.turning
            )
        self.members = [start]
        self.earlier: list[Aspect] = aspects(curve.equations, start)
        self.reached = self.miss == 0
        self.ending: Ending | None = None
        self.length = STEPS.first * curve.size(start)
        # Steps tried, and the distance covered by them, since the family last advanced.
        self.tries = 0
        self.distance = 0.0
        # Cost of locating events, in unknowns times steps.
        self.work = 0.0

    @property
    def done(self) -> bool:
        """Whether the family has ended."""
        return self.reached or self.ending is not None

    def advance(self) -> None:
        """Take a step along the family, or end it."""
        start = self.members[-1]
        if len(self.members) >= self.points:
            self.ending = Ending.POINTS
            return
        end = self._step(start)
        if end is not None and self.curve.miss(end, self.target) * self.miss <= 0:
            end = self.curve.meet(start, end, self.target)
            self.reached = end is not None
            if end is None:
                self.ending = Ending.MISSED
        if self.ending is Ending.LOST:
            end = self._meet_border(start)
        if end is None:
            return
        if self.events is not None:
            self._locate_events(start, end, self.events)
        self.members.append(end)
        self.miss = self.curve.miss(end, self.target)
        self.distance += float(np.linalg.norm(end.unknown - start.unknown)) / self.curve.size(end)
        # A family that advances gets a new number of tries.
        if self.distance > STEPS.still:
            self.tries = 0
            self.distance = 0.0
        equations = self.curve.equations
        if not self.reached and returns(self.curve.solve, equations, self.earlier, start, end):
            self.ending = Ending.RETURNED
        self.earlier += aspects(equations, end)

    def _step(self, start: Member) -> Member | None:
        """Return the next member, and set the next step length; None ends the family."""
        size = self.curve.size(start)
        self.length = min(self.length, STEPS.longest * size)
        while self.length > STEPS.smallest * size and self.tries < STEPS.patience:
            end = self.curve.along(start, self.length)
            self.tries += 1
            turn = 0.0 if end is None else float(end.direction @ start.direction)
            if end is not None and turn > STEPS.bent:
                iterations = end.solution.iterations
                if self.events is None:
                    # A new mesh around openings does not count as slow convergence.
                    iterations -= end.solution.relaid
                if turn < STEPS.straight:
                    self.length *= 0.8
                elif iterations <= STEPS.easy:
                    self.length *= 2
                return end
            self.length /= 4 if end is None else 2
        self.ending = Ending.STILL if self.tries == STEPS.patience else Ending.LOST
        return None

    def _meet_border(self, start: Member) -> Member | None:
        """Return the member at a target that steps cannot pass, for example damping 0."""
        way = -self.miss / start.rate if start.rate else np.inf
        if abs(way) > STEPS.longest * self.curve.size(start):
            return None
        guess = start.unknown + way * start.direction
        solution = self.curve.solve(self.curve.equations.unpack(guess), self.target, start)
        distance = self.curve.equations.pack(solution.point) - guess if solution else np.inf
        if solution is None or np.linalg.norm(distance) > abs(way):
            return None
        self.ending = None
        self.reached = True
        return self.curve.member(solution, self.target, start.direction)

    def _locate_events(self, start: Member, end: Member, events: list[Event]) -> None:
        """Add the events of a step in order along the family."""
        length = float(start.direction @ (end.unknown - start.unknown))
        # Orbits computed for one event serve as guesses for the others.
        members = {0.0: start, 1.0: end}

        def at(share: float) -> Member | None:
            low = max(other for other in members if other < share)
            high = min(other for other in members if other > share)
            weight = (share - low) / (high - low)
            guess = (1 - weight) * members[low].unknown + weight * members[high].unknown
            near = members[high if weight > 0.5 else low]
            member = self.curve.along(start, share * length, guess, near)
            self.work += end.unknown.size * (member or end).solution.mesh.size
            if member:
                members[share] = member
            return member

        located = []
        for kind in EVENTS:
            member = locate(kind, start, end, at)
            if member is not None:
                after = len(self.members) - 1
                event = Event(kind, self.curve.value_of(member), member.orbit, after)
                located.append((float(start.direction @ member.unknown), event))
        events += [event for _, event in sorted(located, key=lambda pair: pair[0])]
        if self.work > STEPS.crowded and not self.reached:
            self.ending = Ending.CROWDED

    def family(self, name: str, until: float) -> Family:
        """Return the orbits with their events, and the reason why the family ended."""
        members = self.members
        reason = ""
        if self.ending:
            reason = self.ending.value.format(
                orbits=self.points,
                position=self.curve.position(members[-1]),
                until=until,
                events=len(self.events or ()),
            )
        return Family(
            tuple(member.orbit for member in members),
            np.array([self.curve.value_of(member) for member in members]),
            name,
            tuple(self.events or ()),
            self.reached,
            reason,
        )


@in_one_thread
def follow(
    orbit: Orbit,
    parameter: str | Callable[[float], Chain],
    until: float,
    *,
    start: float | None = None,
    hold: str = "period",
    points: int = 400,
    events: bool = True,
    progress: bool = False,
) -> Family:
    """Follow a periodic orbit while its energy, its period or a parameter of the chain changes.

    The family continues beyond folds, where the parameter turns back.

    Parameters
    ----------
    orbit : Orbit
        First orbit of the family.
    parameter : str, or function of a number that returns a chain
        "energy" (J), "period" (s), "drive.frequency" (Hz), "drive.amplitude" (m or N),
        "damping.drag" (1/s), "damping.viscoelastic" (s), a property of the chain such as
        "chain.top_load" or "chain.exponent", or an element of an array such as "chain.masses[7]",
        counted from 1. "chain." may be left out, and so may "drive." before the amplitude.
    until : float
        Value of the parameter at which the family ends.
    start : float, optional
        Value for which a function `parameter` returns the chain of the orbit.
    hold : "period" or "energy"
        Quantity that stays constant while the chain or the drive changes.
    points : int
        Largest number of orbits of the family.
    events : bool
        Whether to locate folds and bifurcations. Two events that cancel within one step are missed;
        follow the family in shorter pieces to find them. Without events, steps are longer and may
        jump over the folds of a narrow resonance.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Family
        Orbits and events. If the family did not reach `until`, `reached` is false and `ended` gives
        the reason. A family also ends where events crowd, as in resonances; use `events=False` to
        continue it.

    Raises
    ------
    InputError
        If the orbit has no such parameter, or a value is not valid.
    RunFailed
        If the orbit does not solve the equations at `start`.
    """
    check_flags(events=events)
    curve, first = family_curve(orbit, parameter, start, until, hold)
    curve = replace(curve, exact=events)
    # A fixed period hardly determines the amplitude of a small orbit, so its energy is fixed.
    if curve.parameter == "period" and orbit.drive is None:
        anchor = fixed(curve.equations, "energy", orbit.energy)
    else:
        anchor = fixed(curve.equations, curve.parameter, curve.value(first))
    solution = curve.solve(first, anchor)
    if solution is None:
        raise RunFailed(
            "the first orbit does not solve these equations: does it belong to `start`?"
        )
    target = fixed(curve.equations, curve.parameter, until)
    march = _March(curve, curve.member(solution, anchor), target, points, events)
    # The progress bar shows the covered fraction of the parameter, whose range may be 0.
    distance = max(abs(march.miss), 1e-300)
    layout = "{desc}: {percentage:3.0f}% |{bar}| {elapsed}"
    began = clock()
    times = [(began, march.miss)]
    told = False
    with ProgressBar(1.0, "orbits", layout=layout, shown=progress) as bar:
        while not march.done:
            march.advance()
            bar.reach(max(0.0, 1 - abs(march.miss) / distance))
            times = [*times[-2:], (clock(), march.miss)]
            # The first steps are short, so that their pace does not predict the later ones.
            settled = times[-1][0] - began > PATIENCE_S / 3
            left_s = _left_s(times)
            if settled and not march.done and not told and is_long(left_s):
                told = True
                position = curve.position(march.members[-1])
                announce(
                    left_s,
                    f"the family of orbits from {position} to {until:g}",
                    "a nearer end, a shorter chain, or events=False in Python takes less",
                )
    family = march.family(parameter if isinstance(parameter, str) else "parameter", until)
    found = tuple(replace(event, parameter=parameter, hold=hold) for event in family.events)
    return replace(family, events=found)


def _left_s(times: list[tuple[float, float]]) -> float:
    """Return the expected time to the end of a family, s, at the pace of its last two steps.

    0 is returned before there are two steps, and in a fold, where the distance to the end does not
    decrease.
    """
    (began, before), *_, (now, miss) = times
    gained = abs(before) - abs(miss)
    return (now - began) * abs(miss) / gained if len(times) == 3 and gained > 0 else 0.0


def family_curve(
    orbit: Orbit,
    parameter: str | Callable[[float], Chain],
    start: float | None,
    until: float,
    hold: str,
) -> tuple[SolutionBranch, OrbitPoint]:
    """Return the family that contains an orbit, and the point of the orbit on it."""
    if isinstance(until, bool) or not isinstance(until, int | float) or not np.isfinite(until):
        raise InputError.at("until", f"must be a number (got {shown(until)})")
    if hold not in ("period", "energy") or (hold == "energy" and orbit.drive is not None):
        raise InputError.at("hold", 'must be "period", or "energy" for an orbit that is not driven')
    if parameter in ("energy", "period", "drive.frequency"):
        if parameter == "energy" and orbit.drive is not None:
            message = "energy is not conserved in a driven chain: follow period or amplitude"
            raise InputError.at("parameter", message)
        if parameter == "drive.frequency" and orbit.drive is None:
            message = "drive.frequency requires a drive, and the orbit is not driven"
            raise InputError.at("parameter", message)
        if until <= 0:
            raise InputError.at("until", f"must be above 0 for the {parameter} (got {until:g})")
        equations = _equations(orbit, lambda _: orbit.flow, 0.0)
        name = str(parameter).removeprefix("drive.")
        return SolutionBranch(equations, (), name), OrbitPoint(orbit.state, orbit.period)
    system_at, value = _vary(orbit, parameter, start)

    # All residuals at one value of the parameter use the same flow.
    @lru_cache(maxsize=8)
    def flow_at(number: float) -> Flow:
        chain, drive = system_at(number)
        return flow_of(chain, orbit.flow.rate, drive, orbit.flow.cycles)

    # Values that the chain does not allow are rejected at once.
    flow_at(until)
    equations = _equations(orbit, flow_at, max(abs(value), abs(until)) or 1.0)
    constraint = fixed(equations, hold, orbit.period if hold == "period" else orbit.energy)
    state = flow_at(value).canonical(orbit.displacement, orbit.velocity)
    return SolutionBranch(equations, (constraint,), "value"), OrbitPoint(state, orbit.period, value)


def _equations(orbit: Orbit, flow_at: Callable[[float], Flow], scale: float) -> Equations:
    unit = float(np.linalg.norm(orbit.state))
    return Equations(flow_at, orbit.reversible, unit, scale, orbit.period)


System = tuple[Chain, Drive | Force | None]


def _vary(
    orbit: Orbit, parameter: str | Callable[[float], Chain], start: float | None
) -> tuple[Callable[[float], System], float]:
    """Return the chain and drive as a function of the parameter, and the orbit's value."""
    chain = orbit.chain
    drive = orbit.drive
    if not isinstance(parameter, str):
        if start is None:
            message = (
                "is missing: give the value for which the function returns the chain of the orbit"
            )
            raise InputError.at("start", message)
        return lambda number: (parameter(number), drive), float(start)
    if parameter in ("amplitude", "drive.amplitude"):
        if drive is None:
            message = f"{parameter} requires a drive, and the orbit is not driven"
            raise InputError.at("parameter", message)
        return lambda number: (chain, drive.replace(amplitude=number)), float(drive.amplitude)
    return _vary_number(orbit, parameter)


def _vary_number(orbit: Orbit, parameter: str) -> tuple[Callable[[float], System], float]:
    """Return the chain and drive as a function of a chain or damping property, and its value."""
    chain = orbit.chain
    drive = orbit.drive
    room, _, name = parameter.removeprefix("chain.").rpartition(".")
    owner: Chain | Damping = chain.damping if room == "damping" else chain
    element = ELEMENT.fullmatch(name)
    field = element[1] if element else name
    value = chain.diameters if element and field == "diameter" else getattr(owner, field, None)
    known = room in ("", "damping") and field in owner.arguments

    def vary(number: float | Array) -> System:
        if isinstance(owner, Damping):
            return chain.replace(damping=owner.given() | {field: number}), drive
        return owner.replace(**{field: number}), drive

    if element and known and isinstance(value, np.ndarray) and 1 <= int(element[2]) <= value.size:
        index = int(element[2]) - 1

        def with_element(number: float) -> System:
            values = value.copy()
            values[index] = number
            return vary(values)

        return with_element, float(value[index])
    if element or not known or type(value) is not float:
        message = "must be energy, period, amplitude or a number of the chain"
        if drive is not None:
            message = "must be period, a number of the drive, of damping or of the chain"
        raise InputError.at("parameter", f"{message} (got {shown(parameter)})")
    return vary, value
