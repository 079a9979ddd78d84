"""Where methods fail on a scene: a module for each cause; `stability` goes through all of them."""

from ..util.lazy import attributes, listed

__all__ = ["Boundary", "Curve", "Stability", "stability"]
__getattr__ = attributes(
    __name__, names={"find": "stability", "result": "Boundary Curve Stability"}
)
__dir__ = listed(__name__)
