"""Steppers, which advance chains in time: the common protocol, and the native stepper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import Array
from .batch import ChainBatch
from .kernels.layout import (
    ALONE,
    GIVEN_UP,
    LEAST_SHARE,
    PAD,
    WHOLE_ROWS,
    Chains,
    Fields,
    Noted,
    team,
)
from .steps import March, Method, Steps, clocks

NOTHING = np.empty((0, 0, 0, 0))
UNFIT = "the stored state does not belong to this run"


def room_for(*shape: int) -> tuple[Array, Array]:
    """Return arrays for the displacements and velocities of grains, (..., N) each."""
    # In long rows steppers do not write grains at rest, so the arrays must contain zeros.
    make = np.empty if shape[-1] <= WHOLE_ROWS else np.zeros
    return make(shape), make(shape)


class Stepper(Protocol):
    """A batch of chains that can be advanced in time."""

    stride: int  # Number of samples from one landing to the next.
    guessed_rate: float  # Low estimate of grains times force evaluations per second.

    @property
    def ranks(self) -> int:
        """Number of processes that share a chain."""

    @property
    def sample(self) -> int:
        """Number of the last sample that all chains have reached."""

    @property
    def steps(self) -> NDArray[Any]:
        """Number of steps of each chain so far, (R,)."""

    def fill(self, u: Array, v: Array, offset: int, until: int, max_steps: int) -> int:
        """Advance to the sample `until`, or by about `max_steps` steps; return the number of steps.

        Samples from `offset` on are written to u and v, (R, B, N) m and m/s, which `room_for`
        allocated.
        """

    @property
    def progress(self) -> float:
        """Fraction of the work that is done, 0 to 1."""

    @property
    def own_part(self) -> float:
        """Fraction of all steps that were steps of the main run."""

    def state(self) -> dict[str, Array]:
        """Return the arrays from which a run continues bit for bit."""

    def close(self) -> None:
        """Release all resources."""


class NativeStepper:
    """A batch of chains in displacements from equilibrium, distributed over threads.

    If there are fewer long chains than threads, all threads share one chain after the other. The
    same compiled call advances the chains and their auxiliary runs, which have other steps.

    Parameters
    ----------
    chains : ChainBatch
        Chains to advance.
    method : Method
        Integration method of all runs.
    schedule : Steps
        Steps of the main run.
    state : mapping
        Arrays that the method `state` returned, or an empty mapping to start at t = 0.
    threads : int
        Number of threads.
    auxiliary : sequence of S Steps
        Steps of the auxiliary runs.

    Attributes
    ----------
    balance : (S + 1, R, T, 2) array
        Dissipated energy and work of the forcing at the samples, J, see `layout.STATE`. By default
        T = 0, and no energies are stored.
    teams : list of Team
        Members of the team of threads that share each chain; a single one if none is shared.
    shares : list of (arguments, int, int)
        Work of each thread: arguments of the compiled march, first chain, and end of chains.
    """

    ranks = 1
    guessed_rate = 1e8

    def __init__(
        self,
        chains: ChainBatch,
        method: Method,
        schedule: Steps,
        state: Mapping[str, Array],
        threads: int = 1,
        auxiliary: Sequence[Steps] = (),
    ):
        self.chains = chains
        self.threads = threads
        self._schedules = (schedule, *auxiliary)
        self._size = len(chains.scenes)
        count = len(self._schedules)
        u = chains.initial[0][None]
        v = chains.initial[1][None]
        # A state contains the bodies of the main run and of the auxiliary runs.
        if state:
            u, v = (
                np.array(state[name], dtype=float).reshape(count, self._size, chains.grains)
                for name in "uv"
            )
        self._x, self._v, self._state = chains.place(u, v, count)
        if state:
            self._check_state(state["state"])
            self._state[:] = state["state"]
        self.stride = schedule.stride
        march = method.march(chains, self._schedules)
        self._march = march.run
        self._by_step = march.by_step
        # Each thread advances its own chains, or all threads share each chain if there are few
        # chains.
        sharing = 1
        if march.shared and self._size < threads:
            sharing = min(threads, chains.grains // LEAST_SHARE)
        shares = min(threads, self._size) if sharing < 2 else 1
        self.teams = team(sharing) if sharing > 1 else [ALONE]
        # Each thread that shares a chain has its own state, which differs only in extreme values.
        self._states = [self._state, *(self._state.copy() for _ in self.teams[1:])]
        # The calling thread does a part of the work.
        others = shares * len(self.teams) - 1
        self._pool = ThreadPoolExecutor(others) if others else None
        self.balance = np.zeros((count, self._size, 0, 2))
        self._history = np.zeros((count * self._size, march.history, self._x.shape[1]))
        if state:
            if state["history"].shape != self._history.shape:
                raise ValueError(UNFIT)
            self._history[:] = state["history"]
        self.shares = self._share_out(march, shares)
        # Compile now, so that the first call of `fill` times the integration alone.
        if not self._march.overloads:  # type: ignore[attr-defined]
            none = np.empty((0, 1, 1))
            fields = Fields(none, none, NOTHING, NOTHING, 0, self.balance)
            self._march(*self.shares[0][0], fields, 0, 0, 0, 0)

    def _share_out(self, march: March, shares: int) -> list[tuple[tuple[Any, ...], int, int]]:
        """Return the work of each thread: arguments of the march, first chain, and end of chains.

        `shares` is the number of parts into which the chains of the batch are divided.
        """
        scene = self.chains.scenes[0]
        borders = [share * self._size // shares for share in range(shares + 1)]
        parts: list[tuple[tuple[Any, ...], int, int]] = []
        for state, member in zip(self._states, self.teams, strict=True):
            chains = Chains(self.chains.arrays, self._x, self._v, self._history, state, member)
            for begin, end in pairwise(borders):
                work = march.make_work(chains, march.method)
                times = clocks(self._schedules, scene.sampling_interval, scene.intervals)
                parts.append(((chains, march.method, work, times), begin, end))
        return parts

    def _check_state(self, state: NDArray[Any]) -> None:
        """Raise `ValueError` if a state does not fit, because compiled loops do not check it."""
        fits = state.shape == self._state.shape and state.dtype == self._state.dtype
        if fits:
            first, last, sample = (state[name] for name in ("first", "last", "sample"))
            width = self._x.shape[1]
            inside = (first >= PAD) & (first < last) & (last <= width - PAD) & (sample == sample[0])
            # Steps to a time that is NaN would never end. Extreme values may be NaN after a
            # breakdown.
            fits = bool(inside.all() and np.isfinite(state["done"]).all())
        if not fits:
            raise ValueError(UNFIT)

    def fill(
        self,
        u: Array,
        v: Array,
        offset: int,
        until: int,
        max_steps: int,
        beside: tuple[Array, Array] = (NOTHING, NOTHING),
    ) -> int:
        """Advance to the sample `until`, or by `max_steps` in each thread.

        Samples of the main run from `offset` on are written to u and v, (R, B, N) m and m/s.
        Samples of the auxiliary runs are written to `beside`, (S, R, B, N) each.
        """
        fields = Fields(u, v, *beside, offset, self.balance)
        if not self._pool:
            return self._move(self.shares[0], fields, until, max_steps)
        for state in self._states[1:]:
            state[:] = self._state
        try:
            others = [
                self._pool.submit(self._move, share, fields, until, max_steps)
                for share in self.shares[1:]
            ]
            steps = [
                self._move(self.shares[0], fields, until, max_steps),
                *(other.result() for other in others),
            ]
        except BaseException:
            # After any exception, including Ctrl-C, no thread may wait for another.
            self.teams[0].gate[GIVEN_UP] = 1
            raise
        if len(self.teams) == 1:
            return sum(steps)
        # Each thread has the extreme values of its own grains; all threads have made the same
        # steps.
        strains = [state["least_strain"] for state in self._states]
        self._state["least_strain"] = np.min(strains, axis=0)
        for name in ("largest_approach", "largest_displacement", "largest_speed"):
            self._state[name] = np.max([state[name] for state in self._states], axis=0)
        return steps[0]

    def fill_by_step(self, u: Array, v: Array, offset: int, until: int, noted: Noted) -> int:
        """Advance one chain as `fill` does, record its steps, and return their number.

        The method must be DOP853. The steps and checkpoints are written to `noted`.
        """
        assert self._by_step
        moved, begin, _ = self.shares[0]
        fields = Fields(u, v, NOTHING, NOTHING, offset, self.balance)
        return self._by_step(*moved, fields, begin, until, noted)

    def _move(self, share: tuple[Any, int, int], fields: Fields, until: int, max_steps: int) -> int:
        """Advance the chains of one thread."""
        moved, begin, end = share
        try:
            return self._march(*moved, fields, begin, end, until, max_steps)
        except BaseException:
            self.teams[0].gate[GIVEN_UP] = 1
            raise

    @property
    def sample(self) -> int:
        """Number of the last sample that all chains have reached."""
        return int(self._state["sample"].min())

    @property
    def steps(self) -> NDArray[Any]:
        """Number of steps of the main run so far, (R,)."""
        return self._state["steps"][: self._size]

    @property
    def own_part(self) -> float:
        """Fraction of all steps that were steps of the main run."""
        steps = self._state["steps"].tolist()
        return sum(steps[: self._size]) / max(sum(steps), 1)

    @property
    def progress(self) -> float:
        """Fraction of all landings that are done, 0 to 1."""
        samples = self._state["sample"].reshape(-1, self._size).mean(1)
        rates = [1 / schedule.stride for schedule in self._schedules]
        return float(samples @ rates) / (sum(rates) * self.chains.scenes[0].intervals)

    @property
    def watched(self) -> NDArray[Any]:
        """State of the main run and the auxiliary runs, (F R,) of `layout.STATE`."""
        return self._state

    def closest(self) -> Array:
        """Return the largest approach of two grains from rest, (S + 1, R) m."""
        return self._state["largest_approach"].copy().reshape(-1, self._size)

    def largest(self) -> Array:
        """Return the largest displacement and speed of any grain in the main run, (R, 2) m and m/s.

        Both are evaluated only at the ends of steps: at first once in every radian of the fastest
        motion, later less often.
        """
        state = self._state[: self._size]
        # The function np.stack would take four times as long.
        return np.array((state["largest_displacement"], state["largest_speed"])).T

    def state(self) -> dict[str, Array]:
        """Return the arrays from which a run continues bit for bit."""
        inside = slice(PAD, PAD + self.chains.grains)
        u, v = (
            bodies[:, inside].reshape(-1, self._size, inside.stop - PAD)
            for bodies in (self._x, self._v)
        )
        arrays = {"u": u, "v": v, "state": self._state, "history": self._history}
        return {name: array.copy() for name, array in arrays.items()}

    def leave(self, broken: NDArray[np.bool_], until: int) -> None:
        """Skip these chains, (S + 1, R) bool, without changes until the sample `until`."""
        broken = broken.ravel()
        self._state["sample"][broken] = until
        self._state["done"][broken] = 0.0

    def close(self) -> None:
        """End the threads."""
        if self._pool:
            self._pool.shutdown()
