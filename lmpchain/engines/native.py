"""The native engine."""

from __future__ import annotations

from typing import ClassVar

import numba

from ..errors import InputError, not_among, shown
from ..integrators.batch import FORCES
from ..integrators.methods import LAGGED
from ..scene.scene import Scene
from ..util.arrays import check_flags
from ..util.plotting import COLOURS
from .base import Proposal
from .stepping.time_stepping import CompiledSteps


class Native(CompiledSteps):
    """Integrate Eq. (1) in displacements with compiled loops.

    Parameters
    ----------
    integrator : "auto", "rkn6", "rkn4", "kahan-li8", "kahan-li6", "verlet", "dop853" or "gear4"
        Method of time integration. "auto" is the cheaper of rkn4 and rkn6, or dop853 for damped
        chains.
    step : float, optional
        Longest step, s. The largest step that divides the sampling interval and is at most `step`
        is used, and no tolerance is enforced.
    threads : int
        Number of threads. They share a batch of chains, or one long chain if each thread gets at
        least 4096 moving grains; with dop853 and gear4 they do not share a chain. The result has
        the same bits as with one thread.
    force : "auto", "exact" or "plain"
        Form of the force. "exact" keeps the relative accuracy of the weakest waves. "plain" is
        faster, with an error of one ulp of the force at rest. "auto" is the fastest form that does
        not increase the error.
    adaptive : bool
        Whether steps are shorter near the opening or closing of a contact, which keeps the order of
        the method. A given step is never adaptive.

    Raises
    ------
    InputError
        If an option is wrong.
    """

    auto = "cheapest"
    style = (COLOURS["blue"], "s")
    foreign: ClassVar[tuple[str, ...]] = (LAGGED.name,)
    batches: ClassVar[bool] = True
    knows_ground: ClassVar[bool] = True

    def __init__(
        self,
        integrator: str = "auto",
        step: float | None = None,
        threads: int = 1,
        force: str = "auto",
        adaptive: bool = True,
    ):
        super().__init__(integrator, step, adaptive)
        if isinstance(threads, bool) or not isinstance(threads, int) or threads < 1:
            raise InputError.at("threads", f"must be a whole number from 1 (got {shown(threads)})")
        if force not in FORCES:
            raise InputError.at("force", not_among(force, FORCES))
        check_flags(adaptive=adaptive)
        self.threads = threads
        self.force = force

    def describe(self, scene: Scene, proposal: Proposal) -> dict[str, str]:
        """Return the version of the compiler."""
        return {"numba": numba.__version__}
