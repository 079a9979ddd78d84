"""Comparison of engines with a reference solution: errors, and work-precision curves."""

from ..util.lazy import attributes, listed

__all__ = ["bench", "comparison", "cures", "curves", "own_run", "reference", "truth"]
__getattr__ = attributes(__name__, __all__)
__dir__ = listed(__name__)
