"""The native engine."""

from __future__ import annotations

from typing import ClassVar

import numba

from ..errors import InputError, shown
from ..integrators.batch import FORCES
from ..integrators.methods import LAGGED
from ..scene.scene import Scene
from ..util.arrays import check_flags
from ..util.plotting import COLOURS
from ..util.suggestions import not_among
from .base import Proposal
from .stepping.time_stepping import CompiledSteps


class Native(CompiledSteps):
    """Integrate Eq. (1) in displacements with compiled loops.

    Parameters
    ----------
    integrator : "auto", "rkn6", "rkn4", "kahan-li8", "kahan-li6", "verlet", "dop853" or "gear4"
        auto takes the cheaper one of rkn4 and rkn6.
    step : float, optional
        s; the largest step up to it that divides the sample interval is used, and no tolerance is
        enforced.
    threads : int
        Over which a batch of chains is shared out, or one long chain, of which each takes at least
        4096 grains in motion; not with dop853 and gear4. The bits are those of one thread.
    force : "auto", "exact" or "plain"
        The form of the force: exact keeps the digits of the weakest wave, plain is faster and wrong
        by the last digit of the force at rest, auto takes what loses nothing.
    adaptive : bool
        Whether steps shorten where a contact is about to open or has just closed, which keeps the
        order of the method there; not with a given step.

    Raises
    ------
    InputError
        If an option is wrong.
    """

    auto = "cheapest"
    style = (COLOURS["blue"], "s")
    foreign: ClassVar[tuple[str, ...]] = (LAGGED.name,)
    batches: ClassVar[bool] = True

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
