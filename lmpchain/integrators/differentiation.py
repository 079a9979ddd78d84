"""Methods of time integration with exact derivatives, and differentiable runs by these methods."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from ..scene.scene import Scene
from .adjoint import DifferentiableRun
from .adjoint_dop853 import DifferentiableDampedRun
from .methods import SPLITTINGS, DormandPrince, Splitting
from .observed_run import adaptive_steps

AnyMethod = Splitting | DormandPrince
AnyRun = DifferentiableRun | DifferentiableDampedRun
DOP853 = DormandPrince()
DIFFERENTIABLE: dict[str, AnyMethod] = {**SPLITTINGS, DOP853.name: DOP853}


def method_for(scene: Scene, names: Collection[str], by_default: str) -> AnyMethod:
    """Return the method for the gradient over these parameters; DOP853 with any damping."""
    damped = scene.chain.damped or any(name.startswith("damping.") for name in names)
    return DOP853 if damped else DIFFERENTIABLE[by_default]


def differentiable(
    scene: Scene,
    method: AnyMethod,
    step: float,
    looks: int,
    grains: NDArray[np.intp],
    adaptive: bool = False,
) -> AnyRun:
    """Return a differentiable run by this method; see `adjoint.DifferentiableRun`.

    With `adaptive`, steps are shorter near the opening and closing of contacts.
    """
    if isinstance(method, DormandPrince):
        return DifferentiableDampedRun(scene, method, step, looks, grains, adaptive)
    steps = adaptive_steps(scene, method, step, looks) if adaptive else step
    return DifferentiableRun(scene, method, steps, looks, grains)
