"""Chains in memory, moved forward by the compiled kernels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from ..util.arrays import Array
from .batch import ChainBatch
from .kernels import dop853, gear
from .kernels import splitting as kernels
from .kernels.splitting import PAD
from .methods import DormandPrince, Gear, Method
from .splittings import Splitting
from .step_schedule import StepSchedule

# analysis/calibration/adaptive_steps.py
ADAPTIVE = (
    0.4  # length of the steps near an opening contact, and of the one that crosses the opening: small enough that
)
CROSSING = 0.03  # both leave as little as the other steps do

SHORT = 14 * PAD  # bodies; analysis/calibration/light_cone.py
# analysis/calibration/adaptive_steps.py
ALLOWED = 1e-9  # error of a step of DOP853 for omega h = 1, from which it finds its steps
LEAST = 2e-18  # of that error: less is round-off, and would stop it


class NativeStepper:
    """A batch of chains in displacements from equilibrium, shared out over threads.

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
        shares = min(threads, len(scenes))
        self._shares = [slice(i * len(scenes) // shares, (i + 1) * len(scenes) // shares) for i in range(shares)]
        self._pool = ThreadPoolExecutor(shares) if shares > 1 else None
        initial = [scene.initial() for scene in scenes]
        self._x = chains.bodies(state.get("u", np.array([u for u, _ in initial])))
        self._v = chains.bodies(state.get("v", np.array([v for _, v in initial])))
        if chains.driven:
            self._v[:, PAD] = 0.0  # it is put where its motion says
        if "memo" in state:
            self._memo = state["memo"].copy()
        else:
            self._memo = np.zeros((len(scenes), kernels.STEP + 1))
            self._memo[:, kernels.FIRST], self._memo[:, kernels.LAST] = self._window()
        self.stride = schedule.stride
        self._extra = np.array(state.get("extra", np.zeros((len(scenes), 3, self._x.shape[1]))))
        self._advance, self._by = self._plan(method, schedule)
        self._arrays = [self._of(share) for share in self._shares]
        self._advance(*self._of(slice(0)), np.empty((0, 1, 1)), np.empty((0, 1, 1)), 0, 0, 0)  # only compiles

    def _plan(
        self, method: Method, schedule: StepSchedule
    ) -> tuple[Callable[..., int], Callable[[slice], tuple[Array, ...]]]:
        """Return the compiled loop of a method, and what it takes beside the chains."""
        scene, chains = self.chains.scenes[0], self.chains
        final = scene.samples - 1
        interval = scene.duration / final
        clock = np.array([interval, schedule.steps, schedule.stride, final])
        if isinstance(method, Gear):
            corrections = np.array(method.corrections)
            return gear.march_gear, lambda share: (corrections, self._extra[share], clock)
        if isinstance(method, DormandPrince):
            allowed = (
                max(LEAST, ALLOWED * (schedule.step * chains.omega.max()) ** method.order) if schedule.adaptive else 0.0
            )
            clock = np.array([interval, schedule.step, schedule.stride, final, allowed, schedule.steps])
            return dop853.march_dop853, lambda _: (*method.tables, clock)
        assert isinstance(method, Splitting)
        kicks, drifts = np.array(method.kicks), np.array(method.drifts)
        if not schedule.adaptive:
            return kernels.march, lambda _: (kicks, drifts, clock)
        reach = schedule.step * chains.omega
        crossing = CROSSING * reach ** ((method.order + 1) / (chains.shape[7] + 1))
        adaptivity = np.stack([chains.omega, (ADAPTIVE * reach / crossing) ** (14 / 9)], axis=1)
        clock, weight = np.array([interval, schedule.step, schedule.stride, final, ADAPTIVE]), chains.weight()
        return kernels.march_adaptive, lambda share: (kicks, drifts, clock, adaptivity[share], weight[share])

    def _window(self) -> tuple[Array, Array]:
        """Return where the window of each chain begins and ends: at the lines that hold what moves at t = 0.

        A short chain is computed as a whole, which costs less than to look where the wave is.
        """
        if self._x.shape[1] <= SHORT:
            return np.array([PAD]), np.array([self._x.shape[1] - PAD])
        moves = (self._x != 0) | (self._v != 0)
        if self.chains.driven:
            moves[:, PAD] = True
        first = np.where(moves.any(1), moves.argmax(1), PAD)
        last = moves.shape[1] - np.where(moves.any(1), moves[:, ::-1].argmax(1), moves.shape[1] - PAD)
        return first // PAD * PAD, np.minimum(-(-np.maximum(last, first + 1) // PAD) * PAD, moves.shape[1] - PAD)

    def fill(self, u: Array, v: Array, offset: int, until: int, most: int) -> int:
        """Move on to the sample `until`, or by some `most` steps a thread, and put samples from `offset` into u, v."""

        def move(share: slice, arrays: tuple[Any, ...]) -> int:
            return self._advance(*arrays, u[share], v[share], offset, until, most)

        over = self._pool.map if self._pool else map
        return sum(over(move, self._shares, self._arrays))

    def _of(self, share: slice) -> tuple[Any, ...]:
        """Return what the compiled loop takes of some of the chains."""
        chains = self.chains
        return (
            self._x[share], self._v[share], self._memo[share], chains.table[share], chains.loose[share],
            chains.scale[share], chains.forms[share], chains.base, chains.shape,
            chains.drive[share] if chains.driven else chains.drive, chains.knots[share], chains.pieces[share],
            *self._by(share),
        )  # fmt: skip

    @property
    def sample(self) -> int:
        """The last sample that all chains have reached."""
        return int(self._memo[:, kernels.SAMPLE].min())

    @property
    def steps(self) -> Array:
        """Steps that each chain has made, (R,)."""
        return self._memo[:, kernels.STEPS]

    def lowest(self) -> Array:
        """Return the smallest r / eps that any contact of each chain has had, (R,); -1 is an opening."""
        opens = (self.chains.loose > 0) | (self.chains.base == 0)
        return np.where(opens, -1.0, self._memo[:, kernels.LOWEST])

    def closest(self) -> Array:
        """Return by how much two grains have come closer than at rest at most, (R,) m; seen after whole steps."""
        return self._memo[:, kernels.CLOSEST]

    def state(self) -> dict[str, Array]:
        """Return what is needed to go on with the same bits."""
        inside = slice(PAD, PAD + self.chains.grains)
        kept = {"u": self._x[:, inside], "v": self._v[:, inside], "memo": self._memo, "extra": self._extra}
        return {name: array.copy() for name, array in kept.items()}

    def close(self) -> None:
        """End the threads."""
        if self._pool:
            self._pool.shutdown()
