"""Where methods fail on a scene: a module for each cause; `stability` goes through all of them."""

from ..util.lazy import attributes

__all__ = ["Boundary", "Curve", "Stability", "stability"]
__getattr__ = attributes(__name__, names={"find": "stability", "result": "Boundary Curve Stability"})
