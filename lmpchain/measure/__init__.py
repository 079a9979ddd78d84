"""Quantities measured on trajectories; nothing here runs an engine."""

from ..util.lazy import attributes, listed

__all__ = [
    "collision",
    "contact",
    "dyson",
    "echo",
    "energy",
    "fit",
    "flight",
    "front",
    "harmonic",
    "motion",
    "planar",
    "power",
    "self_similar",
    "shock",
    "solitary",
    "spectrum",
    "traces",
    "wavenumbers",
]
__getattr__ = attributes(__name__, __all__)
__dir__ = listed(__name__)
