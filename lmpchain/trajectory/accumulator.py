"""Accumulation of largest values, fronts and closest approaches along the samples of a motion.

The largest force of a viscous contact does not occur where the contact is closest. The approach is
interpolated by a polynomial of degree 7 through the approach and its rate at four samples, and the
force is computed from this polynomial. A polynomial of degree 5 through three samples shows the
error.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cache
from typing import Any, Literal, NamedTuple

import numpy as np

from ..chain.chain import Chain
from ..chain.contact_law import Contacts
from ..chain.damping import viscous_force
from ..scene.scene import Scene
from ..util.arrays import Array
from .between.derivatives import STILL as STILL
from .between.derivatives import UNKNOWN as UNKNOWN
from .between.derivatives import SampledBlock, by_body, derive, imposed_on, law_of
from .between.fronts import Rules, arrivals, fronts
from .between.hermite import DISPLACEMENT, VELOCITY
from .between.maxima import EVENT, Window, estimate, events_of, levels_of, reduce, table_of

# Number of points of an interval at which forces are compared, and number of refinements around the
# largest force.
POINTS = 33
ZOOMS = 4
# Safety factor on the difference of two polynomials, because either may span an opening of the
# contact.
SAFETY = 4.0
# Fraction of the largest force at the samples; intervals that are lower at both ends stay below it.
HIGH = 0.8


class ViscousContact(NamedTuple):
    """A contact, as arrays (1,), and its viscosity, s."""

    law: Contacts
    viscosity: float

    def force(self, closer: Array, closing: Array) -> Array:
        """Return forces, N, for approaches from rest, m, and their rates, m/s."""
        overlap = self.law.overlap + closer
        viscous = viscous_force(self.law, np.array([self.viscosity]), overlap, closing)
        return self.law.force_at(overlap) + viscous


@cache
def _hermite(nodes: tuple[int, ...]) -> Array:
    """Return the matrix (2Q, 2Q) from values and slopes at Q nodes to coefficients."""
    at = np.array(nodes, float)[:, None]
    powers = np.arange(2 * len(nodes))
    slopes = powers * at ** np.maximum(powers - 1, 0)
    return np.linalg.inv(np.concatenate((at**powers, slopes)))


class Polynomials(NamedTuple):
    """Approaches, m, in I intervals of length h, s, as polynomials of time over h, (I, 2Q)."""

    coefficients: Array
    h: float

    def at(self, when: Array) -> tuple[Array, Array]:
        """Return approaches and rates, (I, P) m and m/s, at (I, P) times from 0 to 1."""
        value = np.zeros(when.shape)
        slope = np.zeros(when.shape)
        # The sum is evaluated term by term, because the bits of a matrix product depend on the
        # number of intervals.
        for coefficient in self.coefficients.T[::-1]:
            slope = slope * when + value
            value = value * when + coefficient[:, None]
        return value, slope / self.h


def _between(motion: Array, h: float, first: Array, nodes: range) -> Polynomials:
    """Return polynomials through the samples from these numbers, at these nodes."""
    near = motion[:, first[:, None] + np.arange(len(nodes))]
    # Slopes are in units of the interval.
    data = np.concatenate((near[0], h * near[1]), axis=1)
    terms = (data[:, [k]] * row for k, row in enumerate(_hermite(tuple(nodes)).T))
    return Polynomials(sum(terms, np.zeros((1, 1))), h)


def largest_force(contact: ViscousContact, motion: Array, h: float, window: Window) -> Array:
    """Return the largest force in some intervals: value, N, its error, approach and rate, (4,).

    Parameters
    ----------
    contact : ViscousContact
        Contact with its law and viscosity.
    motion : (2, R) array
        Approach from rest, m, and its rate, m/s, at the samples.
    h : float
        Time between two samples, s.
    window : Window
        Intervals to search.
    """
    sampled = contact.force(*motion)
    numbers = np.arange(window.begin, window.end)
    higher = np.maximum(sampled[numbers], sampled[numbers + 1])
    numbers = numbers[higher >= HIGH * higher.max()]
    best = np.full(4, -np.inf)
    count = motion.shape[1]
    # At the ends of a run, intervals are at the ends of their samples.
    begins = np.clip(numbers - 1, 0, max(count - 4, 0))
    for offset in np.unique(numbers - begins).tolist():
        first = begins[numbers - begins == offset]
        size = min(4, count)
        fine = _between(motion, h, first, range(-offset, size - offset))
        # Three samples around the interval, or one sample less than the run has.
        few = min(3, size - 1)
        skip = max(offset + 2 - few, 0)
        begin = skip - offset
        rough = _between(motion, h, first + skip, range(begin, begin + few))
        row = np.arange(first.size)
        middle = np.full((first.size, 1), 0.5)
        reach = 0.5
        for _ in range(ZOOMS):
            when = np.clip(middle + reach * np.linspace(-1.0, 1.0, POINTS), 0.0, 1.0)
            force = contact.force(*fine.at(when))
            point = force.argmax(1)
            middle = when[row, point][:, None]
            reach *= 2 / (POINTS - 1)
        top = int(force.max(1).argmax())
        value = force[top].max()
        if value > best[0]:
            at = middle[[top]]
            closer, closing = (x[0, 0] for x in Polynomials(fine.coefficients[[top]], h).at(at))
            other = Polynomials(rough.coefficients[[top]], h).at(at)
            # If the contact closes, add the decrease of the force from the nearest point.
            fall = np.abs(np.diff(force[top]))[max(point[top] - 1, 0) : point[top] + 1].min()
            error = SAFETY * abs(value - contact.force(*other)[0, 0]) + fall
            best[:] = value, error, closer, closing
    return best


Field = Literal["velocity", "displacement"]
KINDS = {"displacement": DISPLACEMENT, "velocity": VELOCITY}
FRACTION = 0.5  # Default fraction of a grain's largest size that a front must reach.


def viscous_contact(chain: Chain, number: int) -> ViscousContact:
    """Return a contact of a chain together with its viscosity."""
    law = chain.contacts.of(np.array([number]))
    return ViscousContact(law, float(chain.contact_viscosity[number]))


class Accumulator:
    """The largest sizes and the maxima of grains, and the largest forces of contacts.

    The size of a displacement or velocity is its magnitude. Samples are added block by block with
    `take`, or all at once with `take_all`.

    Parameters
    ----------
    scene : Scene
        Scene of the samples.
    linear : bool
        Whether the samples solve the linearised equation of motion.
    column : (N+2,) array
        Column of each body in the samples, or a negative number; see
        `between.derivatives.SampledBlock`.
    lawful : (N+2,) array of bool
        Whether the acceleration of each body is computed from the contact law.
    grains : (G,) array
        Numbers of the grains that are followed.
    fields : collection of str
        "displacement" and "velocity", or one of them: the fields whose largest sizes are computed.
    tracked : str, optional
        One of these fields, from which fronts are computed.
    contacts : sequence of int
        Numbers of the contacts for which the largest force is computed.
    ceiling : (G, T-1) or (1, T-1) or (1, 0) array, optional
        Upper bounds on speeds between samples, m/s; see `between.maxima.follow`.
    state : mapping, optional
        The attribute `state` of an earlier accumulator, which this one continues.

    Attributes
    ----------
    state : dict of arrays
        Arrays from which another accumulator continues with the same bits.
    """

    def __init__(
        self,
        scene: Scene,
        linear: bool,
        column: np.ndarray,
        lawful: np.ndarray,
        grains: np.ndarray,
        fields: Collection[str],
        tracked: str | None = None,
        contacts: Sequence[int] = (),
        ceiling: Array | None = None,
        state: Mapping[str, Array] | None = None,
    ):
        self.scene = scene
        self.step = scene.sampling_interval
        self.contacts = list(contacts)
        self._law = law_of(scene.chain, linear)
        self._column = column
        self._lawful = lawful
        self._grains = grains
        self._tracked = tracked
        self._kind = KINDS[tracked or "velocity"]
        self._ceiling = np.zeros((1, 0)) if ceiling is None else ceiling
        self._viscous = scene.chain.damping.longest_time > 0
        kinds = [KINDS[field] for field in fields]
        self._table = table_of(grains, kinds, self.contacts)
        followed = grains.size if tracked else 0
        start = {
            "fast": np.zeros((3, grains.size if "velocity" in fields else 0)),
            "far": np.zeros((3, grains.size if "displacement" in fields else 0)),
            "latest": np.zeros(followed, EVENT),
            "log": np.zeros(0, EVENT),
            "closest": np.full((len(self.contacts), 3), -np.inf),
            # For viscous contacts: the largest force, its error, approach and rate.
            "strongest": np.full((len(self.contacts) * self._viscous, 4), -np.inf),
            "before": np.zeros((2, 0, int(column.max()) + 1)),
            "interval": np.zeros((), dtype=np.int64),
            "start": np.zeros(followed),
        }
        self.state: dict[str, Any] = start
        if state:
            self.state = {name: np.array(state.get(name, start[name])) for name in start}
            # These two arrays grow. The shapes of the others reveal a state of a different scene.
            fixed = start.keys() - {"log", "before"}
            if any(self.state[name].shape != start[name].shape for name in fixed):
                raise ValueError("the stored state does not belong to this scene")

    def take(self, first: int, u: Array, v: Array) -> None:
        """Add the samples of a block, (B, C) each, beginning with sample number `first`."""
        state = self.state
        if first == 0:
            self._begin(v if self._tracked == "velocity" else u)
        before = state["before"]
        base = first - before.shape[1]
        last = first + len(u) - 1
        u = np.concatenate((before[0], u))
        v = np.concatenate((before[1], v))
        begin = int(state["interval"])
        ends = last == self.scene.intervals
        # The misfit of an interval needs the sample after the next one.
        end = last if ends else max(last - 1, 0)
        # Four samples suffice if accelerations are computed from the samples.
        if begin < end and (ends or len(u) > 3 or self.scene.chain.conservative):
            self._take_intervals(u, v, Window(base, begin - base, end - base))
            state["interval"] = np.array(end)
        # The next interval also needs its neighbours for its error.
        state["before"] = np.array([u[-3:], v[-3:]])

    def take_all(self, u: Array, v: Array, levels: Array) -> None:
        """Add all samples, (T, C) each; store only the maxima above a level of each grain."""
        self._begin(v if self._tracked == "velocity" else u)
        self.state["latest"] = levels_of(levels)
        self._take_intervals(u, v, Window(0, 0, len(u) - 1))

    def _begin(self, field: Array) -> None:
        """Add the first sample of the field for which fronts are computed."""
        if self._tracked:
            first = field[0, self._column[self._grains]]
            self.state["start"] = np.abs(first)
            self.state["latest"] = events_of(first)

    def _take_intervals(self, u: Array, v: Array, window: Window) -> None:
        """Add some intervals of a block."""
        state = self.state
        imposed = imposed_on(self.scene, self.step, window.first, len(u))
        self._block = SampledBlock(
            by_body(u), by_body(v), self._column, self._lawful, self.step, self._law, imposed
        )
        self._derived = derive(self._block, self._grains)
        closest = np.ascontiguousarray(state["closest"].T)
        state["log"] = reduce(
            self._block,
            self._table,
            self._derived,
            self._ceiling,
            window,
            (state["far"], state["fast"], closest),
            self._kind,
            state["latest"],
            state["log"],
        )
        state["closest"] = closest.T.copy()
        for number, strongest in zip(self.contacts, state["strongest"], strict=False):
            motion = self.relative(number, window.first, u, v)
            contact = viscous_contact(self.scene.chain, number)
            force = largest_force(contact, motion, self.step, window)
            strongest[:] = force if force[0] > strongest[0] else strongest

    def relative(self, number: int, first: int, u: Array, v: Array) -> Array:
        """Return the change of an overlap since rest and its rate at samples, (2, B).

        The contact `number` connects the bodies `number` and `number` + 1. The samples u, m, and v,
        m/s, (B, C), begin with sample number `first`.
        """
        imposed = imposed_on(self.scene, self.step, first, len(u))

        def motion(body: int) -> Array:
            column = self._column[body]
            if body == imposed.wall_body:
                return imposed.wall[:2]
            return np.array([u[:, column], v[:, column]]) if column >= 0 else np.zeros((2, len(u)))

        return motion(number) - motion(number + 1)

    def largest(self, field: str, error: float) -> tuple[Array, Array]:
        """Return the largest sizes of a field and their errors, (G,), given the samples' error."""
        return estimate(self.state["fast" if field == "velocity" else "far"], error)

    def closest(self, row: int, error: float) -> tuple[Array, Array]:
        """Return the closest approach of a contact from rest, and its error, (1,) m."""
        return estimate(self.state["closest"][row][:, None], error)

    def arrivals(self, error: float) -> Array:
        """Return the arrival time of the front at each grain, and its error, (2, G) s."""
        log = self.state["log"]
        # The log contains the events of all grains, block after block.
        log = log[np.argsort(log["grain"], kind="stable")]
        return arrivals(*self._maxima(log), self._rules(FRACTION, error, error))

    def fronts(self, fraction: float, error: float, fall: float, width: bool) -> Array:
        """Return the time, height and width of the front and their errors, (G, 6).

        `take_all` must be called first. The parameters are fields of `between.fronts.Rules`.
        """
        rules = self._rules(fraction, error, fall, width)
        motion = (self._block, self._grains, self._derived)
        return fronts(*motion, *self._maxima(self.state["log"]), rules)

    def _maxima(self, log: np.ndarray) -> tuple[np.ndarray, np.ndarray, Array, Array]:
        """Return the data of fronts, with events sorted by grain."""
        state = self.state
        largest = state["fast" if self._tracked == "velocity" else "far"]
        return log, state["latest"], largest, state["start"]

    def _rules(self, fraction: float, error: float, fall: float, width: bool = False) -> Rules:
        """Return the definition of a front."""
        scene = self.scene
        return Rules(
            fraction=fraction,
            error=error,
            fall=fall,
            frequency=scene.highest_frequency,
            step=self.step,
            duration=scene.duration,
            kind=self._kind,
            width=width,
        )
