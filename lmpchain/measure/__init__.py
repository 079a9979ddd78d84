"""What one reads off a trajectory: pure functions of arrays, which never run an engine."""

from ..lazy import submodules

__all__ = ["compare", "contact", "dyson", "energy", "fit", "flight", "front", "spectrum"]
__getattr__ = submodules(__name__, __all__)
