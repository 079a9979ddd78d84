"""Quantities gathered along a run, whose engine answers at finer times than are recorded."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ..engines.base import Engine, ErrorBudget, Run
from ..scene.scene import Scene
from ..trajectory.record import Block, Cost
from ..util.arrays import Array, as_slice
from .gatherer import Gatherer

STATE = "gathered."  # before the names of what is kept, so that they never meet those of a run


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
