"""The native engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numba

from ...errors import InputError, ToleranceNotMet
from ...fields import Array
from ...scene import Scene
from ..base import Candidate
from ..lockstep import native_floor
from ..stepping import SteppedEngine
from .kernels import FORMS
from .stepper import NativeStepper, force_form


class Native(SteppedEngine):
    """Integrate Eq. (1) in displacements with compiled loops.

    Parameters
    ----------
    integrator : "rkn6", "verlet" or "kahan-li6"
    step : float, optional
        s; the largest step up to it that divides the sample interval is used, and no tolerance is
        enforced.
    threads : int
        Over which a batch of chains is shared out; one chain is never split.

    Raises
    ------
    InputError
        If an option is wrong.
    """

    name: ClassVar[str] = "native"
    equation: ClassVar[int] = 1
    seconds_per_grain_step = 1e-9

    def __init__(self, integrator: str = "rkn6", step: float | None = None, threads: int = 1):
        super().__init__(integrator, step)
        if isinstance(threads, bool) or not isinstance(threads, int) or threads < 1:
            raise InputError([("threads", f"must be a whole number from 1 (got {threads!r})")])
        self.threads = threads

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Every chain that can be described can be done."""
        return []

    def candidate(self, scene: Scene, tolerance: float) -> Candidate:
        """Propose a step, unless round-off alone exceeds the tolerance."""
        candidate = super().candidate(scene, tolerance)
        if not candidate.fixed:
            evaluations = candidate.steps_per_sample * (scene.samples - 1) * self.splitting.evaluations
            floor = native_floor(evaluations)
            if floor > tolerance:
                raise ToleranceNotMet(
                    f"round-off alone makes an error of about {floor:.1g}, above the tolerance; "
                    'use a higher order (integrator "rkn6") or less accuracy'
                )
        return candidate

    def stepper(self, scenes: Sequence[Scene], candidate: Candidate, state: Mapping[str, Array]) -> NativeStepper:
        """Make the stepper of the answer."""
        return NativeStepper(scenes, self.splitting, candidate.step, state, self.threads)

    def describe(self, scene: Scene, candidate: Candidate) -> dict[str, str]:
        """Return the form of the force and the version of the compiler."""
        return {"force": FORMS[force_form(scene)], "numba": numba.__version__}
