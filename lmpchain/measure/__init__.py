"""Quantities measured on trajectories; nothing here runs an engine."""

from ..util.lazy import attributes, listed

__all__ = [
    "contact",
    "dyson",
    "energy",
    "fit",
    "flight",
    "front",
    "motion",
    "shock",
    "spectrum",
    "traces",
]
__getattr__ = attributes(__name__, __all__)
__dir__ = listed(__name__)
