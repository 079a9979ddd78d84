"""Limits of methods on a scene, with a module for each cause; `stability` evaluates all of them."""

from ..util.lazy import attributes, listed

_MODULES = ["linear_theory", "predictability", "roundoff", "step_limit"]
__all__ = ["Boundary", "Curve", "Stability", "stability", *_MODULES]
__getattr__ = attributes(
    __name__, _MODULES, {"find": "stability", "result": "Boundary Curve Stability"}
)
__dir__ = listed(__name__)
