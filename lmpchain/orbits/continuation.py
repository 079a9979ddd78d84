"""Families of periodic orbits, by pseudo-arclength continuation, with their bifurcations located.

A step goes along the family, not along the parameter, so that folds are passed; H. B. Keller, in Applications of
Bifurcation Theory, ed. P. H. Rabinowitz (1977).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.linalg import svd

from ..chain.chain import Chain
from ..errors import InputError, RunFailed, shown
from ..util.arrays import Array
from ..util.linear_algebra import in_one_thread
from ..util.progress import ProgressBar
from .closing import aspects, returns
from .events import EVENTS, Place, between
from .family import Event, Family
from .flow import Flow
from .orbit import Orbit, orbit_of
from .shooting import Constraint, Equations, Point, Solution, discretisation, fixed, solve, solved

FIRST, SMALLEST = 0.2, 1e-7  # steps along the family, over the size of the orbit
LARGEST = {
    True: 0.4,
    False: 0.7,
}  # the longest where events are sought, and where not; 1 goes down to rest
REGROWN = {
    True: 0.02,
    False: 1.0,
}  # up to which steps laid anew make no step a hard one: long ones jump over events
STRAIGHT, BENT = (
    0.98,
    0.9,
)  # cosine of the angle between two tangents: a longer step, and a shorter one
EASY = 10  # iterations
STILL, PATIENCE = (
    0.05,
    60,
)  # a family must go so many sizes of its orbit in so many tries, or is given up
CROWDED = 5e6  # unknowns times steps, some 15 s, to locate events, then it is given up: in resonances they crowd
HALVINGS = 12  # of the last step, to come to the orbit asked for
ELEMENT = re.compile(r"(\w+)\[(\d+)\]")


@dataclass(frozen=True, eq=False)
class Curve:
    """The family that an orbit belongs to: its equations, what is held, and what its parameter is.

    With `exact` its directions are good enough to locate events by.
    """

    equations: Equations
    held: tuple[Constraint, ...]
    of: str
    exact: bool = False

    def solved(
        self, guess: Point, constraint: Constraint, near: Place | None = None
    ) -> Solution | None:
        """Return the orbit of the family near a guess that a constraint selects; a place nearby saves work."""
        return solve(
            self.equations,
            guess,
            [*self.held, constraint],
            near=near and near.solution,
            exact=self.exact,
        )

    def place(
        self, solution: Solution, constraint: Constraint, before: Array | None = None
    ) -> Place:
        """Return a solved orbit with the direction of the family, turned as that of the place before."""
        unknown, point = self.equations.pack(solution.point), solution.point
        if (
            len(solution.slopes) == unknown.size
        ):  # the way on which only the last equation, the constraint, changes
            direction = solved(solution.slopes, np.append(np.zeros(unknown.size - 1), 1.0))
            direction /= np.linalg.norm(direction)
        else:
            direction = svd(solution.slopes[:-1])[2][-1]
        if before is not None and direction @ before < 0:
            direction = -direction
        error, _ = discretisation(self.equations, solution, [*self.held, constraint])
        orbit = orbit_of(self.equations, solution, error)

        def rate(what: str) -> float:
            return float(fixed(self.equations, what, 1.0).of(unknown, point)[1] @ direction)

        turning = rate(self.of) if orbit.drive else np.nan if self.of == "value" else rate("energy")
        return Place(orbit, unknown, direction, rate(self.of), turning, solution)

    def along(
        self, place: Place, length: float, guess: Array | None = None, near: Place | None = None
    ) -> Place | None:
        """Return the place at this distance along the family, or None where none is found.

        A guess and a place nearer to it than the one to begin with save work.
        """
        ahead = place.unknown + length * place.direction
        arc = Constraint(
            lambda unknown, _: (float(place.direction @ (unknown - ahead)), place.direction)
        )
        try:
            solution = self.solved(
                self.equations.unpack(ahead if guess is None else guess), arc, near or place
            )
        except (
            InputError
        ):  # of a chain that there is not, beyond the end of what the parameter may be
            return None
        return None if solution is None else self.place(solution, arc, place.direction)

    def missed(self, place: Place, target: Constraint) -> float:
        """Return by how much a place misses a target, with its sign."""
        return target.of(place.unknown, self.equations.unpack(place.unknown))[0]

    def meeting(self, here: Place, there: Place, target: Constraint) -> Place | None:
        """Return the place between two where a target is met; what lies between is halved until it is found."""
        for _ in range(HALVINGS):
            before, after, apart = (
                self.missed(here, target),
                self.missed(there, target),
                there.unknown - here.unknown,
            )
            guess = here.unknown + (before / (before - after) if after else 1.0) * apart
            found = self.solved(self.equations.unpack(guess), target, there)
            if found and np.linalg.norm(self.equations.pack(found.point) - guess) < np.linalg.norm(
                apart
            ):
                return self.place(found, target, here.direction)
            middle = self.along(here, float(here.direction @ apart) / 2)
            if middle is None:
                break
            here, there = (
                (here, middle) if self.missed(middle, target) * before <= 0 else (middle, there)
            )
        return None


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
    """Follow a periodic orbit as its energy, its period or a number of the chain changes, folds included.

    Parameters
    ----------
    orbit : Orbit
    parameter : str, or function of a number that returns a chain
        "energy" (J), "period" (s), "amplitude" (of the drive, m), a number of the chain such as "top_load" or
        "exponent", or one of many, such as "masses[7]" (from 1).
    until : float
        Value of the parameter where the family ends.
    start : float, optional
        For a function: the value that gives the chain of the orbit.
    hold : "period" or "energy"
        What stays as it is while the chain or the drive changes.
    points : int
        Most orbits of the family.
    events : bool
        Whether folds and bifurcations are located. Two that undo each other within one step are not seen; follow
        the family in shorter pieces to see them. Without events steps are longer, and may jump over a narrow
        resonance to where the family goes on beyond its folds.
    progress : bool

    Returns
    -------
    Family
        With `reached` false if the family never came to `until`; why is said by `ended`. Where events crowd, as in
        resonances, it ends too, and goes on with `events=False`.

    Raises
    ------
    InputError
        If the parameter is none of this orbit, or a value is wrong.
    RunFailed
        If the orbit is not one of the family at `start`.
    """
    curve, first = _curve(orbit, parameter, start, until, hold)
    curve = replace(curve, exact=events)
    target = fixed(curve.equations, curve.of, until)
    # at a given period the amplitude of a small orbit is next to free
    anchor = fixed(
        curve.equations,
        *(
            ("energy", orbit.energy)
            if curve.of == "period" and orbit.drive is None
            else (curve.of, _value(curve, first))
        ),
    )
    begun = curve.solved(first, anchor)
    if begun is None:
        raise RunFailed(
            "the orbit to begin with does not solve these equations: is it that of `start`?"
        )
    here = curve.place(begun, anchor)
    left = curve.missed(here, target)
    if here.rate * left > 0:
        here = here._replace(direction=-here.direction, rate=-here.rate, turning=-here.turning)
    length = FIRST * _size(curve, here)
    places, whole, reached, ended = [here], max(abs(left), 1e-300), left == 0, ""
    earlier, tried, gone, sought = aspects(curve.equations, here), 0, 0.0, 0.0
    found: list[Event] = []
    with ProgressBar(
        1.0, "orbits", layout="{desc}: {percentage:3.0f}% |{bar}| {elapsed}", shown=progress
    ) as bar:
        while not reached and not ended:
            here = places[-1]
            if len(places) >= points:
                ended = f"its first {points} orbits end at {_where(curve, here)}"
                break
            there, length, tries = _step(curve, here, length, events, PATIENCE - tried)
            if there is None:
                stuck = (
                    "hardly moves on from"
                    if tries == PATIENCE - tried
                    else "cannot be followed beyond"
                )
                ended = f"it {stuck} {_where(curve, here)}"
            elif curve.missed(there, target) * left <= 0:
                there = curve.meeting(here, there, target)
                reached = there is not None
                ended = "" if reached else f"no orbit of it is found at {until:g}"
            if there is None:
                break
            if events:
                located, work = _events(curve, here, there)
                found, sought = found + located, sought + work
                if sought > CROWDED and not reached:
                    ended = f"its events crowd, {len(found)} up to {_where(curve, there)}: events=False leaves them out"
            places.append(there)
            left = curve.missed(there, target)
            bar.reach(max(0.0, 1 - abs(left) / whole))
            gone += float(np.linalg.norm(there.unknown - here.unknown)) / _size(curve, there)
            tried, gone = (0, 0.0) if gone > STILL else (tried + tries, gone)
            if not reached and returns(curve.solved, curve.equations, earlier, here, there):
                ended = f"it comes back to orbits that it has been through, from {_where(curve, there)} on"
            earlier += aspects(curve.equations, there)
    return Family(
        tuple(place.orbit for place in places),
        np.array([_value(curve, curve.equations.unpack(place.unknown)) for place in places]),
        parameter if isinstance(parameter, str) else "parameter", tuple(found), reached, ended,
    )  # fmt: skip


def _where(curve: Curve, place: Place) -> str:
    """Return where on a family a place is, in words."""
    value = _value(curve, curve.equations.unpack(place.unknown))
    return f"{'the parameter' if curve.of == 'value' else curve.of} {value:.6g} (period {place.orbit.period:.6g} s)"


def _size(curve: Curve, place: Place) -> float:
    """Return the size of an orbit among the unknowns."""
    return float(np.linalg.norm(place.unknown[: curve.equations.period_at(place.unknown)]))


def _step(
    curve: Curve, here: Place, length: float, events: bool, most: int
) -> tuple[Place | None, float, int]:
    """Return the next place, how long a step from it may be, and how many of at most `most` were tried."""
    size = _size(curve, here)
    length, tries = min(length, LARGEST[events] * size), 0
    while length > SMALLEST * size and tries < most:
        there, tries = curve.along(here, length), tries + 1
        if there is not None and (turn := float(there.direction @ here.direction)) > BENT:
            relaid = there.solution.relaid if length < REGROWN[events] * size else 0
            easy = there.solution.iterations - relaid <= EASY and turn > STRAIGHT
            return there, length * (2.0 if easy else 0.8 if turn < STRAIGHT else 1.0), tries
        length /= 4 if there is None else 2
    return None, length, tries


def _events(curve: Curve, here: Place, there: Place) -> tuple[list[Event], float]:
    """Return what happens between two places, located along the family, and the work that took."""
    length = float(here.direction @ (there.unknown - here.unknown))
    found, meshes, known = [], [], {0.0: here, 1.0: there}

    def at(part: float) -> Place | None:
        low, high = max(p for p in known if p < part), min(p for p in known if p > part)
        share = (part - low) / (high - low)
        guess = (1 - share) * known[low].unknown + share * known[high].unknown
        place = curve.along(here, part * length, guess, known[high if share > 0.5 else low])
        meshes.append((place or there).solution.mesh.size)
        if place:
            known[part] = place
        return place

    for kind in EVENTS:
        where = between(kind, here, there, at)
        if where is not None:
            value = _value(curve, curve.equations.unpack(where.unknown))
            found.append((float(here.direction @ where.unknown), Event(kind, value, where.orbit)))
    return [event for _, event in sorted(found, key=lambda pair: pair[0])], float(
        there.unknown.size * sum(meshes)
    )


def _value(curve: Curve, point: Point) -> float:
    """Return the parameter of a point."""
    if curve.of == "energy":
        return curve.equations.flow_at(point.value).energy(point.state)[0]
    return point.period if curve.of == "period" else point.value


def _curve(
    orbit: Orbit,
    parameter: str | Callable[[float], Chain],
    start: float | None,
    until: float,
    hold: str,
) -> tuple[Curve, Point]:
    """Return the family of an orbit and where on it the orbit is."""
    if isinstance(until, bool) or not isinstance(until, int | float) or not np.isfinite(until):
        raise InputError([("until", f"must be a number (got {shown(until)})")])
    if hold not in ("period", "energy") or (hold == "energy" and orbit.drive is not None):
        raise InputError([("hold", 'must be "period", or "energy" of an orbit that is not driven')])
    if parameter in ("energy", "period"):
        if parameter == "energy" and orbit.drive is not None:
            raise InputError(
                [
                    (
                        "parameter",
                        "energy is not conserved in a driven chain: follow period or amplitude",
                    )
                ]
            )
        if until <= 0:
            raise InputError([("until", f"must be above 0 for the {parameter} (got {until:g})")])
        equations = _equations(orbit, lambda _: orbit.flow, 0.0)
        return Curve(equations, (), str(parameter)), Point(orbit.state, orbit.period)
    chain_at, value, drive_at = _varied(orbit, parameter, start)

    @lru_cache(maxsize=8)
    def flow_at(number: float) -> Flow:
        return Flow(chain_at(number), orbit.flow.rate, drive_at(number), orbit.flow.cycles)

    flow_at(until)  # what the chain does not allow is said at once
    equations = _equations(orbit, flow_at, max(abs(value), abs(until)))
    kept = orbit.period if hold == "period" else orbit.energy
    state = flow_at(value).canonical(orbit.displacement, orbit.velocity)
    return Curve(equations, (fixed(equations, hold, kept),), "value"), Point(
        state, orbit.period, value
    )


def _equations(orbit: Orbit, flow_at: Callable[[float], Flow], scale: float) -> Equations:
    return Equations(
        flow_at, orbit.reversible, float(np.linalg.norm(orbit.state)), scale, orbit.period
    )


def _varied(
    orbit: Orbit, parameter: str | Callable[[float], Chain], start: float | None
) -> tuple[Callable[[float], Chain], float, Callable]:
    """Return chain and drive as functions of the parameter, and its value for this orbit."""
    chain, drive = orbit.chain, orbit.drive
    if not isinstance(parameter, str):
        if start is None:
            raise InputError(
                [
                    (
                        "start",
                        "is missing: the value for which the function gives the chain of the orbit",
                    )
                ]
            )
        return parameter, float(start), lambda _: drive
    if parameter == "amplitude":
        if drive is None:
            raise InputError(
                [("parameter", "amplitude is that of a drive, and the orbit is not driven")]
            )
        return (
            lambda _: chain,
            float(drive.amplitude),
            lambda number: drive.replace(amplitude=number),
        )
    element = ELEMENT.fullmatch(parameter)
    name, place = (element[1], int(element[2]) - 1) if element else (parameter, None)
    arrays = {
        "masses": chain.masses,
        "diameter": chain.diameters,
        "contact_constants": chain.contact_constants,
    }
    given = arrays[name] if element and name in arrays else getattr(chain, name, None)
    if (
        place is not None
        and isinstance(given, np.ndarray)
        and 0 <= place < given.size
        and name in type(chain).model_fields
    ):

        def with_element(number: float) -> Chain:
            changed = given.copy()
            changed[place] = number
            return chain.replace(**{name: changed})

        return with_element, float(given[place]), lambda _: drive
    if place is not None or name not in type(chain).model_fields or type(given) is not float:
        raise InputError(
            [
                (
                    "parameter",
                    f"must be energy, period, amplitude or a number of the chain (got {shown(parameter)})",
                )
            ]
        )
    return lambda number: chain.replace(**{name: number}), given, lambda _: drive
