"""Quantities accumulated along a run: largest values and fronts of grains, forces of contacts.

The engine answers at finer times than are recorded. `GatheringRun` passes the recorded samples on
and gives all samples to one `Gatherer` for each realisation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from ..engines.base import Engine, ErrorBudget, Run
from ..scene.recording import OF_CONTACTS
from ..scene.scene import Scene
from ..trajectory.between.derivatives import (
    STILL,
    SampledBlock,
    by_body,
    derive,
    imposed_on,
    law_of,
)
from ..trajectory.between.fronts import Rules, arrivals
from ..trajectory.between.maxima import Largest, Log, Window, approach, events_of, reduce
from ..trajectory.between.viscous_forces import ViscousContact, largest_force
from ..trajectory.record import Block, Cost
from ..util.arrays import EPSILON, Array, as_slice

FRACTION = 0.5  # of the largest speed of a grain, that its front has at least
ROUNDED = 4  # last digits of a force that its power may cost
PEAK, TRACE = OF_CONTACTS
STATE = "gathered."  # before the names of what is kept, so that they never meet those of a run


class Gatherer:
    """Quantities of one realisation, gathered block by block.

    Parameters
    ----------
    scene : Scene
        As it was asked for.
    part : Scene
        What is computed of it, at fine times.
    first : int
        Grains of the scene above those of the part.
    linear : bool
        Whether its forces are those of the linearised chain.
    state : mapping
        Empty, or what `state` returned.
    """

    def __init__(
        self, scene: Scene, part: Scene, first: int, linear: bool, state: Mapping[str, Array]
    ):
        self._scene = scene
        self._part = part
        self._first = first
        self._final = part.intervals
        self._step = part.sampling_interval
        size = part.chain.grains
        # contacts by their numbers in the part
        self._peaks = self._contacts(PEAK)
        self._traces = self._contacts(TRACE)
        self._viscous = scene.chain.damping.longest_time > 0
        fronts = "arrival_time" in scene.quantities
        fast = fronts or "peak_velocity" in scene.quantities
        far = "peak_displacement" in scene.quantities
        start = {
            "fast": np.zeros((3, size if fast else 0)),
            "far": np.zeros((3, size if far else 0)),
            "latest": events_of(np.zeros(size if fronts else 0)),
            "log": events_of(np.zeros(0)),
            "closest": np.full((len(self._peaks), 3), -np.inf),
            "trace": np.zeros((len(self._traces), part.samples if self._traces else 0)),
            # of viscous contacts: rates of the traces, and largest force, error, approach and rate
            "rate": np.zeros((len(self._traces) * self._viscous, part.samples)),
            "strongest": np.full((len(self._peaks) * self._viscous, 4), -np.inf),
            "largest": np.zeros(2),
            "before": np.zeros((2, 0, size)),
            "interval": np.zeros((), dtype=np.int64),
            "start": np.zeros(size if fronts else 0),
        }
        self._state: dict[str, Any] = {
            name: np.array(state.get(name, values)) for name, values in start.items()
        }
        # these two grow; a state of another scene shows in the others
        fixed = start.keys() - {"log", "before"}
        if any(self._state[name].shape != start[name].shape for name in fixed):
            raise ValueError("the state that was kept does not fit")
        self._law = law_of(part.chain, linear)
        self._column = np.arange(-1, size + 1)
        self._column[-1] = STILL
        self._lawful = np.full(self._column.size, not part.chain.damped)
        self._lawful[part.chain.movable + 1 :] = True

    def _contacts(self, kind: str) -> list[int]:
        """Return the contacts of the part of which this is gathered, in the order asked for."""
        numbers = (
            number - self._first
            for name, number in self._scene.contacts.items()
            if name.partition(":")[0] == kind
        )
        return [number for number in numbers if 0 <= number <= self._part.chain.grains]

    def take(self, first: int, u: Array, v: Array) -> None:
        """Take in the samples of a block, (B, N) each, which begin with sample number `first`."""
        state = self._state
        count = len(u)
        if not count:
            return
        if first == 0 and state["start"].size:
            state["start"][:] = np.abs(v[0])
            state["latest"] = events_of(v[0])
        before = state["before"]
        base = first - before.shape[1]
        last = first + count - 1
        rows_u = np.concatenate((before[0], u))
        rows_v = np.concatenate((before[1], v))
        imposed = imposed_on(self._part, self._step, base, len(rows_u))
        begin = int(state["interval"])
        # the misfit of an interval is known when the sample behind the next one is
        end = self._final if last == self._final else max(last - 1, 0)
        # where no law gives accelerations, four samples do
        enough = not self._part.chain.damped or last == self._final or len(rows_u) > 3
        if begin < end and enough:
            block = SampledBlock(
                by_body(rows_u),
                by_body(rows_v),
                self._column,
                self._lawful,
                self._step,
                self._law,
                imposed,
            )
            window = Window(base, begin - base, end - base)
            self._take_intervals(block, window)
            for number, strongest in zip(self._peaks, state["strongest"], strict=False):
                relative = self._relative(number, rows_u, rows_v, imposed.wall)
                force = largest_force(self._contact(number), relative, self._step, window)
                strongest[:] = force if force[0] > strongest[0] else strongest
            state["interval"] = np.array(end)
        # the next interval is judged by its neighbours, too
        state["before"] = np.array([rows_u[-3:], rows_v[-3:]])
        state["largest"] = np.maximum(state["largest"], [np.abs(u).max(), np.abs(v).max()])
        for row, number in enumerate(self._traces):
            relative = self._relative(number, u, v, imposed.wall[:, -count:])
            state["trace"][row, first : last + 1] = relative[0]
            if self._viscous:
                state["rate"][row, first : last + 1] = relative[1]

    def _relative(self, number: int, u: Array, v: Array, wall: Array) -> Array:
        """Return how much closer the bodies of a contact of the part are, and its rate, (2, B)."""
        size = self._part.chain.grains
        pairs = zip((u, v), wall, strict=False)
        return np.array(
            [
                (x[:, number - 1] if number else of_wall) - (x[:, number] if number < size else 0.0)
                for x, of_wall in pairs
            ]
        )

    def _contact(self, number: int) -> ViscousContact:
        """Return a contact of the part."""
        chain = self._part.chain
        law = chain.contacts.of(np.array([number]))
        return ViscousContact(law, float(chain.contact_viscosity[number]))

    def _take_intervals(self, block: SampledBlock, window: Window) -> None:
        """Take in largest values, events and approaches of contacts in some intervals."""
        state = self._state
        size = self._part.chain.grains
        grains = np.arange(1, size + 1)
        derived = derive(block, grains)
        log = reduce(
            block,
            grains,
            derived,
            np.zeros((1, 0)),
            window,
            (Largest(*state["far"]), Largest(*state["fast"])),
            state["latest"],
            Log(state["log"], len(state["log"])),
        )
        for number, closest in zip(self._peaks, state["closest"], strict=True):
            # row -1 is that of a body at rest
            rows = (number - 1, number if number < size else -1)
            approach(block, number, derived, rows, np.zeros(0), window, Largest(*closest[:, None]))
        state["log"] = log.events[: log.used].copy()

    def state(self) -> dict[str, Array]:
        """Return the arrays from which another gatherer goes on with the same bits."""
        return {name: values.copy() for name, values in self._state.items()}

    def results(self, error: float) -> dict[str, Array]:
        """Return the quantities and their errors by name, for a relative error of the answer."""
        part = self._part
        state = self._state
        # between two samples a motion may be this much larger than at them
        beyond = 1 / math.cos(part.sampling_phase / 2)
        u_error, v_error = error * np.maximum(beyond * state["largest"], part.imposed)
        results: dict[str, Array] = {}
        for name in self._scene.quantities:
            if name == "peak_displacement":
                estimate = self._of_recorded(Largest(*state["far"]).estimate(u_error), 0.0)
            elif name == "peak_velocity":
                estimate = self._of_recorded(Largest(*state["fast"]).estimate(v_error), 0.0)
            elif name == "arrival_time":
                estimate = self._of_recorded(self._arrivals(v_error), np.nan)
            else:
                # of contacts, which follow
                continue
            results[name], results[f"{name}_error"] = estimate
        for name, number in self._scene.contacts.items():
            contact = number - self._first
            doubts = 2 * u_error, 2 * v_error
            if name.partition(":")[0] == PEAK:
                force, force_error = self._peak(contact, number, doubts)
                results[name] = force[0]
                results[f"{name}_error"] = force_error[0]
            else:
                motion, doubt = self._trace(contact, doubts)
                results[name], results[f"{name}_error"] = self._forces(number, motion, doubt)
                results["fine_time"] = part.time.copy()
        return results

    def _peak(self, contact: int, number: int, doubts: tuple[float, float]) -> tuple[Array, Array]:
        """Return the largest force of a contact, and its error, (1,) N.

        `contact` is its number in the part, `doubts` are errors of approach and rate, m and m/s.
        """
        # nothing moves outside of the part
        if contact not in self._peaks:
            return self._forces(number, np.zeros((2, 1)), (0.0, 0.0))
        row = self._peaks.index(contact)
        if not self._viscous:
            closest, doubt = Largest(*self._state["closest"][row][:, None]).estimate(doubts[0])
            return self._forces(number, np.array([closest, np.zeros(1)]), (doubt, 0.0))
        force, error, *motion = self._state["strongest"][row]
        off = self._forces(number, np.array(motion)[:, None], doubts)[1]
        return np.array([force]), error + off

    def _trace(
        self, contact: int, doubts: tuple[float, float]
    ) -> tuple[Array, tuple[float, float]]:
        """Return approaches and rates at fine times, (2, T) m and m/s, and the errors of either."""
        still = np.zeros(self._part.samples)
        if contact not in self._traces:
            return np.array([still, still]), (0.0, 0.0)
        row = self._traces.index(contact)
        rate = self._state["rate"][row] if self._viscous else still
        return np.array([self._state["trace"][row], rate]), doubts

    def _of_recorded(self, fields: Array | tuple[Array, Array], at_rest: float) -> Array:
        """Return two fields of the grains of the part, (2, N), as those of recorded grains."""
        extended = np.full((2, self._scene.chain.grains), at_rest)
        extended[:, self._first : self._first + self._part.chain.grains] = fields
        return extended[:, self._scene.recorded - 1]

    def _forces(self, number: int, motion: Array, doubts: Any) -> tuple[Array, Array]:
        """Return forces of a contact and their errors, N, from approaches and rates, (2, ...)."""
        chain = self._scene.chain
        law = chain.contacts.of(np.array([number]))
        contact = ViscousContact(law, float(chain.contact_viscosity[number]))
        closer, closing = motion
        force = contact.force(closer, closing)
        off = np.zeros(force.shape)
        for nearer, faster in product((-1, 1), (-1, 1) if self._viscous else (0,)):
            other = contact.force(closer + nearer * doubts[0], closing + faster * doubts[1])
            off = np.maximum(off, np.abs(other - force))
        return force, off + ROUNDED * EPSILON * np.abs(force)

    def _arrivals(self, error: float) -> Array:
        """Return when the front passes each grain of the part, and the error of that, (2, N) s."""
        state = self._state
        part = self._part
        events = np.concatenate([state["log"], state["latest"]])
        events = events[np.argsort(events["grain"], kind="stable")]
        bounds = np.searchsorted(events["grain"], np.arange(part.chain.grains + 1))
        rules = Rules(FRACTION, error, error, part.highest_frequency, self._step, part.duration)
        times: Array = arrivals(events, bounds, Largest(*state["fast"]), state["start"], rules)
        return times


class GatheringRun(Run):
    """A run at fine times, of which samples are handed on and quantities gathered.

    Parameters
    ----------
    run : Run
        Of `Scene.fine` of the scenes, or of the part of them that the engine computes.
    engine : Engine
    scenes : sequence of Scene
        As they were asked for.
    parts : sequence of Scene
        What the run computes of each.
    state : mapping
        Empty, or what `state` returned.
    """

    def __init__(
        self,
        run: Run,
        engine: Engine,
        scenes: Sequence[Scene],
        parts: Sequence[Scene],
        state: Mapping[str, Array],
    ):
        self._run = run
        scene = scenes[0]
        part = parts[0]
        # a batch computes the whole
        cone = scene.fine.light_cone if part is not scene.fine else None
        columns = cone.columns if cone else slice(0, None)
        first = columns.start if isinstance(columns, slice) else int(columns[0])
        states: list[dict[str, Array]] = [{} for _ in scenes]
        for key, values in state.items():
            if key.startswith(STATE):
                _, real, name = key.split(".")
                states[int(real)][name] = values
        linear = engine.equation == 3
        self.gatherers = [
            Gatherer(asked, computed, first, linear, before)
            for asked, computed, before in zip(scenes, parts, states, strict=True)
        ]
        inside = np.flatnonzero(
            (scene.recorded > first) & (scene.recorded <= first + part.chain.grains)
        )
        self._rows = as_slice(scene.recorded[inside] - 1 - first)
        self._columns = as_slice(inside)
        self._every = scene.finer

    def blocks(self) -> Iterator[Block]:
        """Yield the samples of the answer."""
        for block in self._run.blocks():
            for gatherer, u, v in zip(
                self.gatherers, block.displacement, block.velocity, strict=True
            ):
                gatherer.take(block.samples.start, u, v)
            begin = block.samples.start
            end = block.samples.stop
            # samples of the answer are every so many of the fine ones
            first = -(-begin // self._every)
            stop = -(-end // self._every)
            recorded = slice(first * self._every - begin, None, self._every)
            yield Block(
                slice(first, stop),
                block.displacement[:, recorded, self._rows],
                block.velocity[:, recorded, self._rows],
                self._columns,
                # a block may hold fine samples alone, and a checkpoint keeps them
                resumable=end > begin,
            )

    @property
    def progress(self) -> float:
        """Part of the work done, 0 to 1."""
        return self._run.progress

    def errors(self) -> list[ErrorBudget]:
        """Return the estimate for every realisation."""
        return self._run.errors()

    def cost(self) -> Cost:
        """Return the cost so far."""
        return self._run.cost()

    def state(self) -> dict[str, Array]:
        """Return the state of the run and of every gatherer."""
        state = dict(self._run.state())
        for real, gatherer in enumerate(self.gatherers):
            state |= {f"{STATE}{real}.{name}": values for name, values in gatherer.state().items()}
        return state

    def results(self, errors: Sequence[float]) -> list[dict[str, Array]]:
        """Return the quantities of every realisation with their errors, given those of answers."""
        return [
            gatherer.results(error) for gatherer, error in zip(self.gatherers, errors, strict=True)
        ]

    def close(self) -> None:
        """Release everything."""
        self._run.close()


def at_samples(scene: Scene, energies: Mapping[str, Array]) -> dict[str, Array]:
    """Return energies at the samples of a scene of those at the fine times of `Scene.fine`."""
    return {
        name: values[:: scene.finer] if values.ndim else values for name, values in energies.items()
    }


def of_engine(state: Mapping[str, Array] | None) -> Mapping[str, Array] | None:
    """Return the arrays of a state that belong to the run of the engine."""
    return state and {key: values for key, values in state.items() if not key.startswith(STATE)}
