"""Chains moved forward in time: what all engines do, and the compiled march of a method that does it."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import Array
from .batch import ChainBatch
from .kernels.layout import (
    ALONE,
    CLOSEST,
    DONE,
    FARTHEST,
    FASTEST,
    FIRST,
    GIVEN_UP,
    LAST,
    LEAST_SHARE,
    LOWEST,
    NEXT,
    PAD,
    SAMPLE,
    STEP,
    STEPS,
    Clock,
    Team,
    team,
)
from .method import Method
from .step_schedule import StepSchedule


class Stepper(Protocol):
    """A batch of chains that can be moved forward in time."""

    stride: int  # samples from one that it stops at to the next

    @property
    def ranks(self) -> int:
        """How many processes share a chain."""

    @property
    def sample(self) -> int:
        """The last sample that all chains have reached."""

    @property
    def steps(self) -> Array:
        """Steps that each chain has made, (R,)."""

    def fill(self, u: Array, v: Array, offset: int, until: int, max_steps: int) -> int:
        """Move on to the sample `until`, or by some `max_steps` steps.

        Samples from `offset` on are put into u and v, (R, B, N) m and m/s. Returns the steps made.
        """

    def state(self) -> dict[str, Array]:
        """Return what is needed to go on with the same bits."""

    def close(self) -> None:
        """Release everything."""


class NativeStepper:
    """A batch of chains in displacements from equilibrium, shared out over threads.

    If there are fewer chains than threads, and they are long, the threads share each of them.

    Parameters
    ----------
    chains : ChainBatch
    method : Method
    schedule : StepSchedule
    state : mapping
        Empty, or what `state` returned.
    threads : int
    """

    ranks = 1

    def __init__(
        self,
        chains: ChainBatch,
        method: Method,
        schedule: StepSchedule,
        state: Mapping[str, Array],
        threads: int = 1,
    ):
        self.chains, self.threads, scenes = chains, threads, chains.scenes
        u, v = chains.initial
        self._x, self._v = chains.bodies(state.get("u", u), state.get("v", v))
        self._v[:, PAD : PAD + chains.driven] = 0.0  # it is put where its motion says
        if "state" in state:
            self._state = state["state"].copy()
            self._check_state()
        else:
            self._state = np.zeros((len(scenes), STEP + 1))
            self._state[:, FIRST : LAST + 1] = chains.window
            self._state[:, LOWEST] = chains.lowest
        self.stride, final = schedule.stride, scenes[0].samples - 1
        interval, looks = scenes[0].duration / final, schedule.ratio == 1
        clock = Clock(interval, schedule.steps, schedule.step, schedule.stride, final, looks, schedule.dense)
        march = method.march(chains, schedule)
        self._march = march.run
        parts = min(threads, chains.grains // LEAST_SHARE) if march.shared and len(scenes) < threads else 1
        shares = min(threads, len(scenes)) if parts < 2 else 1
        self._shares = [slice(i * len(scenes) // shares, (i + 1) * len(scenes) // shares) for i in range(shares)]
        self._teams = team(parts) if parts > 1 else [ALONE]
        # each thread that shares a chain has a state of its own, in which only extremes differ
        self._states = [self._state, *(self._state.copy() for _ in self._teams[1:])]
        others = len(self._shares) * len(self._teams) - 1
        self._pool = ThreadPoolExecutor(others) if others else None
        self._history = np.zeros((len(scenes), march.history, self._x.shape[1]))
        if "history" in state:
            if state["history"].shape != self._history.shape:
                raise ValueError("the state that was kept does not fit")
            self._history[:] = state["history"]
        bodies = self._x, self._v, self._history

        def arguments(share: slice, state: Array, member: Team) -> tuple[Any, ...]:
            """Return what the compiled march takes of some of the chains."""
            method = *march.common, *(rows[share] for rows in march.each)
            return chains.arrays(share, *bodies, state, member), method, clock

        members = list(zip(self._states, self._teams, strict=True))
        self._work = [(share, arguments(share, *member)) for share in self._shares for member in members]
        if not self._march.overloads:  # type: ignore[attr-defined]
            nothing = arguments(slice(0), self._state, ALONE)
            self._march(*nothing, np.empty((0, 1, 1)), np.empty((0, 1, 1)), 0, 0, 0)  # only compiles

    def _check_state(self) -> None:
        """Raise `ValueError` if a kept state does not fit these chains: the compiled loops trust its window."""
        kept, width = self._state, self._x.shape[1]
        fits = kept.shape == (len(self._x), STEP + 1) and kept.dtype == float
        if fits:
            first, last, sample = kept[:, [FIRST, LAST, SAMPLE]].T
            inside = (first >= PAD) & (first < last) & (last <= width - PAD) & (sample == sample[0])
            counted = np.isfinite(kept[:, [SAMPLE, DONE, NEXT, STEPS]])  # extremes need not be, after a breakdown
            fits = bool(inside.all() and counted.all() and not (kept[:, [FIRST, LAST]] % 1).any())
        if not fits:
            raise ValueError("the state that was kept does not fit")

    def fill(self, u: Array, v: Array, offset: int, until: int, max_steps: int) -> int:
        """Step on to the sample `until`, or by `max_steps` a thread; samples from `offset` on go into u, v."""
        gate = self._teams[0].gate

        def move(share: slice, arguments: tuple[Any, ...]) -> int:
            try:
                return self._march(*arguments, u[share], v[share], offset, until, max_steps)
            except BaseException:
                gate[GIVEN_UP] = 1
                raise

        if not self._pool:
            return move(*self._work[0])
        for state in self._states[1:]:
            state[:] = self._state
        try:
            beside = [self._pool.submit(move, *work) for work in self._work[1:]]
            done = [move(*self._work[0]), *(other.result() for other in beside)]
        except BaseException:  # Ctrl-C between two of them, too: nobody is to wait for one who does not come
            gate[GIVEN_UP] = 1
            raise
        if len(self._teams) == 1:
            return sum(done)
        self._state[:, LOWEST] = np.min([state[:, LOWEST] for state in self._states], axis=0)
        most = [CLOSEST, FARTHEST, FASTEST]
        self._state[:, most] = np.max([state[:, most] for state in self._states], axis=0)
        return done[0]

    @property
    def sample(self) -> int:
        """The last sample that all chains have reached."""
        return int(self._state[:, SAMPLE].min())

    @property
    def steps(self) -> Array:
        """Steps that each chain has made, (R,)."""
        return self._state[:, STEPS]

    def lowest(self) -> Array:
        """Return the smallest r / eps that any contact of each chain has had, (R,); -1 is an opening."""
        return self._state[:, LOWEST]

    def closest(self) -> Array:
        """Return by how much two grains have come closer than at rest at most, (R,) m; seen after whole steps."""
        return self._state[:, CLOSEST]

    def largest(self) -> Array:
        """Return the largest displacement and speed that any grain of each chain has had, (R, 2) m and m/s.

        They are seen after steps, at first a radian of the fastest motion apart (or one step, if that is longer), later
        more rarely.
        """
        return self._state[:, FARTHEST : FASTEST + 1]

    def state(self) -> dict[str, Array]:
        """Return what is needed to go on with the same bits."""
        inside = slice(PAD, PAD + self.chains.grains)
        kept = {"u": self._x[:, inside], "v": self._v[:, inside], "state": self._state, "history": self._history}
        return {name: array.copy() for name, array in kept.items()}

    def leave(self, broken: NDArray[np.bool_], until: int) -> None:
        """Let those chains (R,) be at the sample `until` as they are."""
        self._state[broken, SAMPLE], self._state[broken, DONE] = until, 0.0

    def close(self) -> None:
        """End the threads."""
        if self._pool:
            self._pool.shutdown()
