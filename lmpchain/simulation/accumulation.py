"""Quantities accumulated along a run: largest values and fronts of grains, forces of contacts.

The engine solves the scene at more times than are recorded. `GatheringRun` passes on the recorded
samples, and passes all samples to one `Gatherer` for each realisation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from ..chain.law import Law
from ..engines.base import Engine, ErrorBudget, Run
from ..scene.recording import OF_CONTACTS
from ..scene.scene import Scene
from ..trajectory.accumulator import KINDS, STILL, Accumulator, viscous_contact
from ..trajectory.record import Block, Cost
from ..util.arrays import EPSILON, Array, as_slice

PEAK, TRACE = OF_CONTACTS
PREFIX = "gathered."  # Prefix of the names of arrays in a state; engines never use it.


class Gatherer:
    """The quantities of one realisation, accumulated block by block.

    Parameters
    ----------
    scene : Scene
        The requested scene.
    part : Scene
        The computed part of the scene, at fine times.
    first : int
        Number of grains above the part.
    linear : bool
        Whether the equation of motion is linear. Forces of contacts follow from the contact law.
    state : mapping
        Arrays from `state` of an earlier gatherer, which this one continues; empty at t = 0.
    """

    def __init__(
        self, scene: Scene, part: Scene, first: int, linear: bool, state: Mapping[str, Array]
    ):
        self._scene = scene
        self._part = part
        self._first = first
        size = part.chain.grains
        # Contacts, numbered as in the part.
        self._peaks = self._contacts(PEAK)
        self._traces = self._contacts(TRACE)
        self._linear = linear
        self._viscous = scene.chain.damping.longest_time > 0
        column = np.arange(-1, size + 1)
        column[-1] = STILL
        lawful = np.full(column.size, part.chain.conservative)
        lawful[part.chain.movable + 1 :] = True
        tracked = "velocity" if "arrival_time" in scene.quantities else None
        asked = {*scene.quantities, f"peak_{tracked}"}
        fields = [field for field in KINDS if f"peak_{field}" in asked]
        grains = np.arange(1, size + 1)
        motion = (part, linear, column, lawful, grains)
        self._accumulator = Accumulator(*motion, fields, tracked, self._peaks, state=state)
        start = {
            "trace": np.zeros((len(self._traces), part.samples if self._traces else 0)),
            # Rates of the traces, for viscous contacts.
            "rate": np.zeros((len(self._traces) * self._viscous, part.samples)),
            "largest": np.zeros(2),
        }
        self._state: dict[str, Any] = {
            name: np.array(state.get(name, values)) for name, values in start.items()
        }
        if any(self._state[name].shape != values.shape for name, values in start.items()):
            raise ValueError("the saved state does not match this run")

    def _contacts(self, kind: str) -> list[int]:
        """Return the contacts of the part for a kind of quantity, in the requested order."""
        numbers = (
            number - self._first
            for name, number in self._scene.contacts.items()
            if name.partition(":")[0] == kind
        )
        return [number for number in numbers if 0 <= number <= self._part.chain.grains]

    def take(self, first: int, u: Array, v: Array) -> None:
        """Add the samples of a block, (B, N) each; the first one has the number `first`."""
        state = self._state
        count = len(u)
        if not count:
            return
        self._accumulator.take(first, u, v)
        state["largest"] = np.maximum(state["largest"], [np.abs(u).max(), np.abs(v).max()])
        for row, number in enumerate(self._traces):
            closer, closing = self._accumulator.relative(number, first, u, v)
            state["trace"][row, first : first + count] = closer
            if self._viscous:
                state["rate"][row, first : first + count] = closing

    def state(self) -> dict[str, Array]:
        """Return the arrays from which another gatherer continues bit for bit."""
        state = self._state | self._accumulator.state
        return {name: values.copy() for name, values in state.items()}

    def results(self, error: float) -> dict[str, Array]:
        """Return the quantities and their errors by name, given the relative error of the run."""
        part = self._part
        largest = self._accumulator.largest
        # Factor by which a value between two samples may exceed the values at the samples.
        beyond = 1 / math.cos(part.sampling_phase / 2)
        u_error, v_error = error * np.maximum(beyond * self._state["largest"], part.imposed)
        results: dict[str, Array] = {}
        for name in self._scene.quantities:
            if name == "peak_displacement":
                estimate = self._of_recorded(largest("displacement", u_error), 0.0)
            elif name == "peak_velocity":
                estimate = self._of_recorded(largest("velocity", v_error), 0.0)
            elif name == "arrival_time":
                estimate = self._of_recorded(self._accumulator.arrivals(v_error), np.nan)
            else:
                # Quantities of contacts follow below.
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
        """Return the largest force of a contact and its error, (1,) N.

        `contact` is the number of the contact in the part, and `number` its number in the chain.
        `doubts` are the errors of its approach, m, and of the rate of the approach, m/s.
        """
        # Contacts outside the part are at rest.
        if contact not in self._peaks:
            return self._forces(number, np.zeros((2, 1)), (0.0, 0.0))
        row = self._peaks.index(contact)
        if not self._viscous:
            closest, doubt = self._accumulator.closest(row, doubts[0])
            force, off = self._forces(number, np.array([closest, np.zeros(1)]), (doubt, 0.0))
            if self._scene.chain.contact_law.grows or self._linear:
                return force, off
            # The force may be larger before the contact is closest.
            contacts = self._scene.chain.contacts
            begin = contacts.overlap + contacts.closer(self._scene.initial()[0])
            law = contacts.of(np.array([number])).law
            assert isinstance(law, Law)
            closest_overlap = contacts.overlap[number] + float(closest[0])
            largest, bound = law.largest_force(
                min(float(begin[number]), closest_overlap),
                closest_overlap,
                float(contacts.constant[number]),
            )
            force = np.maximum(force, largest)
            return force, np.maximum(off, bound - force)
        force, error, *motion = self._accumulator.state["strongest"][row]
        off = self._forces(number, np.array(motion)[:, None], doubts)[1]
        return np.array([force]), error + off

    def _trace(
        self, contact: int, doubts: tuple[float, float]
    ) -> tuple[Array, tuple[float, float]]:
        """Return approaches and rates at fine times, (2, T) m and m/s, and their errors."""
        still = np.zeros(self._part.samples)
        if contact not in self._traces:
            return np.array([still, still]), (0.0, 0.0)
        row = self._traces.index(contact)
        rate = self._state["rate"][row] if self._viscous else still
        return np.array([self._state["trace"][row], rate]), doubts

    def _of_recorded(self, fields: Array | tuple[Array, Array], at_rest: float) -> Array:
        """Return two fields of the part's grains, (2, N), at the positions of recorded grains."""
        extended = np.full((2, self._scene.chain.grains), at_rest)
        extended[:, self._first : self._first + self._part.chain.grains] = fields
        return extended[:, self._scene.recorded - 1]

    def _forces(self, number: int, motion: Array, doubts: Any) -> tuple[Array, Array]:
        """Return forces of a contact and their errors, N, from approaches and rates, (2, ...)."""
        contact = viscous_contact(self._scene.chain, number)
        closer, closing = motion
        force = contact.force(closer, closing)
        off = np.zeros(force.shape)
        for nearer, faster in product((-1, 1), (-1, 1) if self._viscous else (0,)):
            other = contact.force(closer + nearer * doubts[0], closing + faster * doubts[1])
            off = np.maximum(off, np.abs(other - force))
        # A power of the overlap loses four units in the last place.
        return force, off + 4 * EPSILON * np.abs(force)


class GatheringRun(Run):
    """A run at fine times that passes the samples on and accumulates the quantities.

    Parameters
    ----------
    run : Run
        Run of the scenes at fine times (`Scene.fine`), or of their computed parts.
    engine : Engine
        The engine of the run.
    scenes : sequence of Scene
        The requested scenes.
    parts : sequence of Scene
        The computed part of each scene, at fine times.
    state : mapping
        Arrays from `state` of an earlier run, which this run continues; empty at t = 0.
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
        # A batch always computes whole scenes.
        cone = scene.fine.light_cone if part is not scene.fine else None
        columns = cone.columns if cone else slice(0, None)
        first = columns.start if isinstance(columns, slice) else int(columns[0])
        states: list[dict[str, Array]] = [{} for _ in scenes]
        for key, values in state.items():
            if key.startswith(PREFIX):
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
        """Yield the recorded samples."""
        for block in self._run.blocks():
            for gatherer, u, v in zip(
                self.gatherers, block.displacement, block.velocity, strict=True
            ):
                gatherer.take(block.samples.start, u, v)
            begin = block.samples.start
            end = block.samples.stop
            # Every `self._every`-th fine sample is recorded.
            first = -(-begin // self._every)
            stop = -(-end // self._every)
            recorded = slice(first * self._every - begin, None, self._every)
            yield Block(
                slice(first, stop),
                block.displacement[:, recorded, self._rows],
                block.velocity[:, recorded, self._rows],
                self._columns,
                # A block may have fine samples only, which a checkpoint must not lose.
                resumable=end > begin,
            )

    @property
    def progress(self) -> float:
        """Fraction of the work that is done, 0 to 1."""
        return self._run.progress

    def errors(self) -> list[ErrorBudget]:
        """Return the error estimate of every realisation."""
        return self._run.errors()

    def cost(self) -> Cost:
        """Return the cost so far."""
        return self._run.cost()

    def state(self) -> dict[str, Array]:
        """Return the state of the run and of every gatherer."""
        state = dict(self._run.state())
        for real, gatherer in enumerate(self.gatherers):
            state |= {f"{PREFIX}{real}.{name}": values for name, values in gatherer.state().items()}
        return state

    def results(self, errors: Sequence[float]) -> list[dict[str, Array]]:
        """Return the quantities of every realisation; their errors follow from the runs' errors."""
        return [
            gatherer.results(error) for gatherer, error in zip(self.gatherers, errors, strict=True)
        ]

    def close(self) -> None:
        """Release all resources."""
        self._run.close()


def at_samples(scene: Scene, energies: Mapping[str, Array]) -> dict[str, Array]:
    """Return the energies at the samples of a scene, given those at the times of `Scene.fine`."""
    return {
        name: values[:: scene.finer] if values.ndim else values for name, values in energies.items()
    }


def of_engine(state: Mapping[str, Array] | None) -> Mapping[str, Array] | None:
    """Return the arrays of a state that belong to the engine's run."""
    return state and {key: values for key, values in state.items() if not key.startswith(PREFIX)}
