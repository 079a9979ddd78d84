"""Chains in memory, moved forward by the compiled kernels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ...fields import Array
from ...scene import Scene
from ..splittings import Splitting
from . import kernels

STRONG = 1e3  # strike number above which the faster form of the force loses nothing
PATH = 2**18  # positions of a driven grain that are laid out at a time


class NativeStepper:
    """A batch of chains in displacements from equilibrium, shared out over threads."""

    ranks = 1

    def __init__(
        self, scenes: Sequence[Scene], splitting: Splitting, step: float, state: Mapping[str, Array], threads: int = 1
    ):
        shares = min(threads, len(scenes))
        self._shares = [slice(i * len(scenes) // shares, (i + 1) * len(scenes) // shares) for i in range(shares)]
        self._pool = ThreadPoolExecutor(shares) if shares > 1 else None
        self._drives = [scene.drive for scene in scenes if scene.drive]
        self._forms = np.array([force_form(scene) for scene in scenes])
        chains = [scene.chain for scene in scenes]
        self._delta = chains[0].exponent
        self._first, self._last = 2 if self._drives else 1, chains[0].movable + 1
        contacts = [chain.contacts for chain in chains]
        overlap, force, constant = (
            np.array([getattr(c, k) for c in contacts]) for k in ("overlap", "force", "constant")
        )
        if not chains[0].compressed:
            self._inverse_length, self._strength, self._loose = np.ones_like(constant), constant, np.zeros(len(chains))
        else:
            self._inverse_length = np.divide(1.0, overlap, out=np.zeros_like(overlap), where=overlap > 0)
            self._strength, self._loose = force, np.where(force[:, 0] > 0, 0.0, constant[:, 0])
        self._inverse_mass = self._bodies([1 / chain.masses for chain in chains])
        self._kicks = np.array(splitting.kicks) * step
        self._drifts = np.array(splitting.drifts) * step
        self._step, self._stages = step, np.array([0.0, *splitting.reach[:-1]])
        initial = [scene.initial() for scene in scenes]
        self._x = self._bodies(state.get("u", [u for u, _ in initial]))
        self._v = self._bodies(state.get("v", [v for _, v in initial]))
        self._seen = np.array(state.get("seen", np.tile([np.inf, 0.0], (len(scenes), 1))))
        self._done = int(state.get("done", 0))
        self.u, self.v = self._x[:, 1:-1], self._v[:, 1:-1]
        self._run(slice(0), 0, np.empty((0, 0)))  # no chains: only compiles, so that it is not timed as work

    @staticmethod
    def _bodies(grains: Array | list[Array]) -> Array:
        """Return values (R, N) of the grains between those of two walls, (R, N+2), which stand still."""
        return np.pad(np.asarray(grains), ((0, 0), (1, 1)))

    def advance(self, steps: int) -> None:
        """Move forward by `steps` steps."""
        most = PATH // (self._stages.size * len(self._drives)) + 1 if self._drives else steps
        over = self._pool.map if self._pool else map
        while steps > 0:
            piece = min(steps, most)
            path = self._path(piece)
            list(over(lambda share: self._run(share, piece, path), self._shares))  # noqa: B023
            self._done += piece
            steps -= piece
        for real, drive in enumerate(self._drives):
            self.v[real, 0] = drive.motion(self._done * self._step)[1]

    def _path(self, steps: int) -> Array:
        """Return where every driven grain is at each evaluation of the force, (R, steps S + 1) m, or (R, 0)."""
        if not self._drives:
            return np.empty((len(self.u), 0))
        index = self._done + np.arange(steps + 1)[:, None]
        times = ((index + self._stages) * self._step).ravel()[: steps * self._stages.size + 1]
        return np.array([drive.motion(times)[0] for drive in self._drives])

    def _run(self, share: slice, steps: int, path: Array) -> None:
        kernels.advance(
            self._x[share],
            self._v[share],
            self._seen[share],
            self._inverse_length[share],
            self._strength[share],
            self._loose[share],
            self._inverse_mass[share],
            self._first,
            self._last,
            self._forms[share],
            self._delta,
            self._kicks,
            self._drifts,
            steps,
            path[share],
        )

    def lowest(self) -> Array:
        """Return the smallest r / eps that any contact of each chain has had, (R,); -1 is an opening."""
        open_at_rest = (self._loose > 0) | (self._forms == kernels.VACUUM)
        return np.where(open_at_rest, -1.0, self._seen[:, 0])

    def closest(self) -> Array:
        """Return by how much two grains have come closer than at rest at most, (R,) m; seen after whole steps."""
        return self._seen[:, 1]

    def state(self) -> dict[str, Array]:
        """Return what is needed to go on with the same bits."""
        return {"u": self.u, "v": self.v, "seen": self._seen, "done": np.array(self._done)}

    def close(self) -> None:
        """End the threads."""
        if self._pool:
            self._pool.shutdown()


def force_form(scene: Scene) -> int:
    """Choose the form of the force: without cancellation unless the strike is strong."""
    chain = scene.chain
    if not chain.compressed:
        return kernels.VACUUM
    if chain.exponent == 1:
        return kernels.SPRING
    if chain.exponent == 1.5:
        return kernels.PLAIN if scene.strike_number > STRONG else kernels.CORRECTED
    return kernels.POWER
