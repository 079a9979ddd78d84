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


class NativeStepper:
    """A batch of chains in displacements from equilibrium, shared out over threads."""

    def __init__(
        self, scenes: Sequence[Scene], splitting: Splitting, step: float, state: Mapping[str, Array], threads: int = 1
    ):
        shares = min(threads, len(scenes))
        self._shares = [slice(i * len(scenes) // shares, (i + 1) * len(scenes) // shares) for i in range(shares)]
        self._pool = ThreadPoolExecutor(shares) if shares > 1 else None
        chains = [scene.chain for scene in scenes]
        forms = {force_form(scene) for scene in scenes}
        self.form = forms.pop() if len(forms) == 1 else kernels.CORRECTED
        self._delta = chains[0].exponent
        self._movable = chains[0].movable
        if self.form == kernels.VACUUM:
            self._inverse_length = np.ones((len(chains), chains[0].grains - 1))
            self._strength = np.array([chain.contact_constants for chain in chains])
        else:
            self._inverse_length = 1 / np.array([chain.equilibrium_overlap for chain in chains])
            self._strength = np.array([chain.equilibrium_force for chain in chains])
        self._inverse_mass = 1 / np.array([chain.masses for chain in chains])
        self._kicks = np.array(splitting.kicks) * step
        self._drifts = np.array(splitting.drifts) * step
        initial = [scene.initial() for scene in scenes]
        self.u = np.array(state.get("u", [u for u, _ in initial]))
        self.v = np.array(state.get("v", [v for _, v in initial]))
        self._lowest = np.array(state.get("lowest", np.full(len(scenes), np.inf)))
        self._run(slice(0), 0)  # no chains: only compiles, so that it is not timed as work

    def advance(self, steps: int) -> None:
        """Move forward by `steps` steps."""
        over = self._pool.map if self._pool else map
        list(over(lambda share: self._run(share, steps), self._shares))

    def _run(self, share: slice, steps: int) -> None:
        kernels.advance(
            self.u[share],
            self.v[share],
            self._lowest[share],
            self._inverse_length[share],
            self._strength[share],
            self._inverse_mass[share],
            self._movable,
            self.form,
            self._delta,
            self._kicks,
            self._drifts,
            steps,
        )

    def lowest(self) -> Array:
        """Return the smallest r / eps that any contact of each chain has had, (R,); -1 is an opening."""
        return np.full_like(self._lowest, -1.0) if self.form == kernels.VACUUM else self._lowest

    def state(self) -> dict[str, Array]:
        """Return what is needed to go on with the same bits."""
        return {"u": self.u, "v": self.v, "lowest": self._lowest}

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
