"""Quantities measured on trajectories; nothing here runs an engine."""

from ..util.lazy import attributes

__all__ = ["contact", "dyson", "energy", "fit", "flight", "front", "spectrum"]
__getattr__ = attributes(__name__, __all__)
